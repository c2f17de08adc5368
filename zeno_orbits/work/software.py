"""Identity of the software: versions of packages for files, a digest of the code for workers."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path


def versions() -> dict[str, str]:
    """Return the versions of the packages that compute a result, keyed by name."""
    return dict(_versions())


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    """Query the installation once, since the query takes longer than a period of simulation."""
    # Imported here for a faster start, since readers of files do not need these modules.
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
    """Return a digest of the package's source code, to compare two installations."""
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    sources = (file for kind in ("*.py", "*.c", "*.h") for file in package.rglob(kind))
    for file in sorted(sources):
        name = file.relative_to(package)
        # Problems are installed inside the package. In the source tree they are next to it.
        if name.parts[0] != "problems":
            digest.update(f"{name.as_posix()}\n".encode() + file.read_bytes())
    return digest.hexdigest()
