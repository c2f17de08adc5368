"""Identity of the software: versions of packages for files, a digest of the code for workers."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path


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


@cache
def code_digest() -> str:
    """Return a digest of the package's own source, by which two installations can be compared."""
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        name = file.relative_to(package)
        # Problems are installed inside the package, and stand beside it in the source.
        if name.parts[0] != "problems":
            digest.update(f"{name.as_posix()}\n".encode() + file.read_bytes())
    return digest.hexdigest()
