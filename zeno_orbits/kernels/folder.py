"""The folder on disk in which compiled kernels are kept: private, and every file whole.

A library is named by the digest of what it was made of and by that of its bytes, so a file that
was cut is never loaded. Files appear by renaming: two processes that write one do no harm.
"""

from __future__ import annotations

import hashlib
import os
import sys
from dataclasses import dataclass
from pathlib import Path

from zeno_orbits.errors import KernelError

_SUFFIX = ".kernels"
_FAILED = ".failed"
JOB = ".job"
"""Suffix of a request that somebody works on."""

_MOST = 400
"""Libraries that are kept; the oldest go."""

_OTHERS_MAY_WRITE = 0o022


@dataclass(frozen=True, slots=True)
class KernelFolder:
    """The folder of kernels.

    Attributes:
        path: Where it is, or will be.
    """

    path: Path

    def make(self) -> None:
        """Make the folder if it is not there, for its owner alone.

        Raises:
            KernelError: If it cannot be made, or others may write to it.
        """
        try:
            self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise KernelError(f"`{self.path}` cannot be made ({error.strerror})") from error
        self.require_private(self.path)

    @staticmethod
    def require_private(path: Path) -> None:
        """Refuse a file or folder that others own or may write to: it would be run as code.

        Raises:
            KernelError: If that is so.
        """
        if not hasattr(os, "geteuid"):
            # Windows: the folder is in the user's profile, which the system guards.
            return
        try:
            stat = path.stat()
        except OSError as error:
            raise KernelError(f"`{path}` cannot be read ({error.strerror})") from error
        if stat.st_uid not in {os.geteuid(), 0} or stat.st_mode & _OTHERS_MAY_WRITE:
            raise KernelError(f"`{path}` must be the user's alone, but others may write to it")

    def find(self, key: str) -> Path | None:
        """Return a library that can be trusted, if there is one.

        Args:
            key: Digest of what it is made of.

        Raises:
            KernelError: If there is one, but others may have written it.
        """
        found = sorted(self.path.glob(f"{key}-*{_SUFFIX}"))
        if not found:
            return None
        self.require_private(self.path)
        for file in found:
            self.require_private(file)
            if _digest_of(file) == file.stem.partition("-")[2]:
                return file
        return None

    def store(self, key: str, library: Path) -> Path:
        """Move a library to its place, whole, and return it.

        Args:
            key: Digest of what it was made of.
            library: The file, on the same disk.
        """
        target = self.path / f"{key}-{_digest_of(library)}{_SUFFIX}"
        library.chmod(0o600)
        library.replace(target)
        self.failure_of(key).unlink(missing_ok=True)
        libraries = sorted(self.libraries(), key=lambda file: file.stat().st_mtime_ns)
        for old in libraries[: max(len(libraries) - _MOST, 0)]:
            old.unlink(missing_ok=True)
        return target

    @property
    def lock(self) -> Path:
        """The file that whoever compiles here holds."""
        return self.path / ".lock"

    def failure_of(self, key: str) -> Path:
        """Return the file that says why a library could not be made."""
        return self.path / f"{key}{_FAILED}"

    def job_of(self, key: str) -> Path:
        """Return the file that says that somebody makes a library, and from what."""
        return self.path / f"{key}{JOB}"

    def libraries(self) -> list[Path]:
        """Return the libraries that are there."""
        return list(self.path.glob(f"*-*{_SUFFIX}"))

    def failures(self) -> list[str]:
        """Return why libraries could not be made, one sentence each, without repetition."""
        files = sorted(self.path.glob(f"*{_FAILED}"))
        return list(dict.fromkeys(file.read_text(encoding="utf-8").strip() for file in files))

    def size(self) -> int:
        """Return how many bytes the libraries take."""
        return sum(file.stat().st_size for file in self.libraries())

    def clear(self) -> int:
        """Remove everything that was made, and return how many libraries there were."""
        libraries = self.libraries()
        kinds = (_SUFFIX, _FAILED, JOB)
        for file in (file for kind in kinds for file in self.path.glob(f"*{kind}")):
            file.unlink(missing_ok=True)
        self.lock.unlink(missing_ok=True)
        return len(libraries)


def kernel_folder() -> KernelFolder:
    """Return the folder: that of the variable `ZENO_ORBITS_CACHE`, else the system's place."""
    chosen = os.environ.get("ZENO_ORBITS_CACHE", "")
    if chosen:
        return KernelFolder(Path(chosen).expanduser().absolute() / "kernels")
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return KernelFolder(base / "zeno_orbits" / "kernels")


def _digest_of(file: Path) -> str:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()[:32]
    except OSError:
        return ""
