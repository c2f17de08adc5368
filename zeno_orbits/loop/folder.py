"""The folder on disk in which compiled libraries are kept: private, and every file whole.

The name of a library contains the digest of its source and the digest of its bytes, so a truncated
file is never loaded. Files are created by renaming. Two processes that write the same library do
not conflict.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Generator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from zeno_orbits.errors import KernelError
from zeno_orbits.work import file_lock, others_may_write

_SUFFIX = ".kernels"
_OF_EARLIER_RELEASES = (".failed", ".job")
"""Suffixes of files that `clear` removes as well."""

_MOST = 400
"""Largest number of libraries. The oldest libraries are removed."""


@dataclass(frozen=True, slots=True)
class LibraryFolder:
    """The folder of libraries.

    Attributes:
        path: Path of the folder, which may not exist yet.
    """

    path: Path

    def make(self) -> None:
        """Create the folder if it does not exist, accessible to its owner alone.

        Raises:
            KernelError: If the folder cannot be created, or others may write to it.
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
        try:
            # On Windows the folder is in the user's profile, which the system guards.
            open_to_others = others_may_write(path)
        except OSError as error:
            raise KernelError(f"`{path}` cannot be read ({error.strerror})") from error
        if open_to_others:
            raise KernelError(f"other users can write to `{path}`")

    def find(self, key: str) -> Path | None:
        """Return a trusted library, if one exists.

        Args:
            key: Digest of the library's source.

        Raises:
            KernelError: If the library exists, but other users may have written it.
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
        """Move a library to its final path, atomically, and return the path.

        Args:
            key: Digest of the library's source.
            library: The file, on the same disk.
        """
        target = self.path / f"{key}-{_digest_of(library)}{_SUFFIX}"
        library.chmod(0o600)
        library.replace(target)
        libraries = sorted(self.libraries(), key=lambda file: file.stat().st_mtime_ns)
        for old in libraries[: max(len(libraries) - _MOST, 0)]:
            old.unlink(missing_ok=True)
        return target

    @contextmanager
    def held(self) -> Generator[None]:
        """Hold the lock of the folder: one process compiles, and the others find its library.

        The operating system releases the lock if the process ends.

        Raises:
            KernelError: If the folder cannot be locked.
        """
        with ExitStack() as lock:
            try:
                lock.enter_context(file_lock(self.lock, patience=-1.0))
            except OSError as error:
                reason = f"`{self.lock}` cannot be locked ({error.strerror})"
                raise KernelError(reason) from error
            yield

    @property
    def lock(self) -> Path:
        """Lock file of the process that compiles in this folder."""
        return self.path / ".loop-lock"

    def libraries(self) -> list[Path]:
        """Return the libraries that are there."""
        return list(self.path.glob(f"*-*{_SUFFIX}"))

    def size(self) -> int:
        """Return the total size of the libraries in bytes."""
        return sum(file.stat().st_size for file in self.libraries())

    def clear(self) -> int:
        """Remove everything that was made, and return how many libraries there were.

        Raises:
            KernelError: If others may write to the folder.
        """
        libraries = self.libraries()
        if self.path.exists():
            self.require_private(self.path)
        kinds = (_SUFFIX, *_OF_EARLIER_RELEASES)
        for file in (file for kind in kinds for file in self.path.glob(f"*{kind}")):
            # A folder of that name is not ours.
            with suppress(OSError):
                file.unlink(missing_ok=True)
        self.lock.unlink(missing_ok=True)
        return len(libraries)


def library_folder() -> LibraryFolder:
    """Return the folder from the variable `ZENO_ORBITS_CACHE`, else the system's cache folder."""
    chosen = os.environ.get("ZENO_ORBITS_CACHE", "")
    if chosen:
        return LibraryFolder(Path(chosen).expanduser().absolute() / "kernels")
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return LibraryFolder(base / "zeno_orbits" / "kernels")


def _digest_of(file: Path) -> str:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()[:32]
    except OSError:
        return ""
