"""Versions of the software that computes results, for their files."""

from __future__ import annotations

from functools import cache


def versions() -> dict[str, str]:
    """Return name to version of the packages that compute a result."""
    return dict(_versions())


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    """Ask the installation once: it takes longer than a period of simulation."""
    # Both take as long to import as a small module of ours, and a reader needs neither.
    import platform
    from importlib.metadata import PackageNotFoundError, version

    found = {"python": platform.python_version()}
    for name in ("zeno_orbits", "casadi", "numpy", "scipy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return tuple(found.items())
