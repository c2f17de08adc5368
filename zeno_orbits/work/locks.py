"""Locks between processes."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def file_lock(path: Path, *, patience: float = 0.0) -> Generator[None]:
    """Hold the lock of a file within a context. The file is removed afterwards.

    The operating system frees the lock when its process ends.

    Args:
        path: The file. A missing file is created, and an existing one keeps its content.
        patience: Longest wait [s], without limit if it is negative.

    Raises:
        TimeoutError: If another process holds the lock.
        OSError: If the file cannot be created, or is not a regular file.
    """
    # Imported here, since few commands lock anything.
    from filelock import FileLock

    if not is_regular(path) and os.path.lexists(path):
        raise OSError(errno.EINVAL, f"`{path.name}` is a link, or not a file")
    # The library does not follow a link that takes the place of the file after this check.
    with FileLock(path, timeout=patience):
        try:
            yield
        finally:
            # Windows removes the file itself when the lock is free.
            with suppress(OSError):
                path.unlink()


def is_regular(path: Path) -> bool:
    """Return True if a path is a regular file, and not a link to one."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False
