"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from zeno_orbits.errors import InputError

PICTURES = (".png", ".pdf", ".svg")
"""Suffixes of the pictures that can be written."""


def require_picture(path: Path) -> None:
    """Refuse a path that cannot become a picture, before any work is done for it.

    Raises:
        InputError: If its suffix is none of ``PICTURES``, or it cannot become a file.
    """
    require_writable(path)
    if path.suffix.lower() not in PICTURES:
        message = f"Argument `output` must end in .png, .pdf or .svg, but it is `{path.name}`."
        raise InputError(message)


def require_writable(path: Path) -> None:
    """Refuse a path that cannot become a file, before any work is done for it.

    Raises:
        InputError: If its folder is missing or closed, or the path is a folder.
    """
    folder = path.parent
    if path.is_dir():
        raise InputError(f"Argument `output` must be a file, but `{path}` is a folder.")
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise InputError(f"Argument `output` must be in a writable folder, but `{path}` is not.")


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file through a temporary neighbour, so that nobody ever sees half of it.

    Args:
        path: Where; an existing file is replaced.
        content: Text (UTF-8) or bytes.

    Raises:
        InputError: If the folder does not exist or cannot be written.
    """
    write_pieces(path, (content.encode() if isinstance(content, str) else content,))


def write_pieces(path: Path, pieces: Iterable[bytes]) -> None:
    """Write a file piece by piece, as `write_whole` does: for what is too long to hold twice.

    Args:
        path: Where; an existing file is replaced.
        pieces: What it holds, in order.

    Raises:
        InputError: If the folder does not exist or cannot be written.
    """
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        message = f"Argument `output` must be in a writable folder, but `{path}` is not"
        raise InputError(f"{message} ({error.strerror}).") from error
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            for piece in pieces:
                file.write(piece)
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        message = f"Argument `output` must be a file that can be written, but `{path}` is not"
        raise InputError(f"{message} ({error.strerror}).") from error
    finally:
        temporary.unlink(missing_ok=True)
