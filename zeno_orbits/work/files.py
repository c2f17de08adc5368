"""Files that appear whole or not at all."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

from zeno_orbits.errors import InputError

PICTURES = (".png", ".pdf", ".svg")
"""Suffixes of the pictures that can be written."""


def require_picture(path: Path, argument: str = "output") -> None:
    """Refuse a path that cannot become a picture, before any work is done for it.

    Args:
        path: The path.
        argument: Name of the argument, for the message.

    Raises:
        InputError: If its suffix is not one of ``PICTURES``, or it cannot become a file.
    """
    require_writable(path, argument)
    if path.suffix.lower() not in PICTURES:
        message = f"Argument `{argument}` must end in .png, .pdf or .svg, but it is `{path.name}`."
        raise InputError(message)


def require_writable(path: Path, argument: str = "output") -> None:
    """Refuse a path that cannot become a file, before any work is done for it.

    Devices and pipes are written to as they are.

    Args:
        path: The path.
        argument: Name of the argument, for the message.

    Raises:
        InputError: If its folder is missing or closed, or the path is a folder.
    """
    folder = path.parent
    if path.is_dir():
        raise InputError(f"Argument `{argument}` must be a file, but `{path}` is a folder.")
    if _is_special(path):
        return
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        message = f"must be in a writable folder, but `{path}` is not"
        raise InputError(f"Argument `{argument}` {message}.")


def read_json(path: Path) -> Any:
    """Return the data of a JSON file; a name may stand in an object only once.

    Args:
        path: The file, in UTF-8.

    Raises:
        ValueError: Why it has none, as a clause about the file.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=_once)
    except OSError as error:
        raise ValueError(f"it cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise ValueError("it is not UTF-8 text") from error
    except _TwiceError:
        raise
    except (ValueError, RecursionError) as error:
        raise ValueError(f"it is not complete JSON ({error})") from error


def read_object(path: Path) -> dict[str, Any]:
    """Return the names and values of a JSON file.

    Args:
        path: The file, in UTF-8.

    Raises:
        ValueError: Why it has none, as a clause about the file.
    """
    entries = read_json(path)
    if not isinstance(entries, dict):
        raise ValueError("it is not an object with names")  # noqa: TRY004 (a fault of the file)
    return cast("dict[str, Any]", entries)


class _TwiceError(ValueError):
    """A name stands twice in an object."""


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) != len(pairs):
        words = [word for word, _ in pairs]
        twice = next(word for word in words if words.count(word) > 1)
        raise _TwiceError(f"it names `{twice}` twice in one object")
    return entries


def require_folder(folder: Path) -> None:
    """Refuse a path that cannot become a folder of files, before any work is done for it.

    Raises:
        InputError: If it is a file, or it or what is there of it is closed.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"Argument `output` must be a folder, but `{folder}` is a file.")
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not there.is_dir() or not os.access(there, os.W_OK):
        message = f"must be a folder that can be made, but `{folder}` is not"
        raise InputError(f"Argument `output` {message}.")


def write_all(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files into a folder, all of them or none: they are put in place when all are written.

    If one of them cannot be put in place, those that were are taken back, and what stood there
    before is as it was.

    Args:
        folder: Where; it is made if it is not there. Other files in it are left alone.
        files: Name to content.

    Raises:
        InputError: If the folder cannot be made or written.
    """
    for name in files:
        if (folder / name).is_dir():
            message = f"must be a file, but `{folder / name}` is a folder"
            raise InputError(f"Argument `output` {message}.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=".unfinished.") as name:
            new, old = Path(name) / "new", Path(name) / "old"
            new.mkdir()
            old.mkdir()
            for file, content in files.items():
                (new / file).write_bytes(content)
                (new / file).chmod(0o644)
            _exchange(folder, new, old, files)
    except OSError as error:
        message = f"Argument `output` must be a folder that can be written, but `{folder}` is not"
        raise InputError(f"{message} ({error.strerror}).") from error


def _exchange(folder: Path, new: Path, old: Path, names: Iterable[str]) -> None:
    """Move files from one folder into another, and those of their names there into a third one."""
    try:
        for name in names:
            if (folder / name).exists():
                (folder / name).replace(old / name)
            (new / name).replace(folder / name)
    except BaseException:
        for name in names:
            if not (new / name).exists():
                (folder / name).unlink(missing_ok=True)
            if (old / name).exists():
                (old / name).replace(folder / name)
        raise


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file through a temporary neighbour, so that no reader ever sees half of it.

    Args:
        path: Where; an existing file is replaced.
        content: Text (UTF-8) or bytes.

    Raises:
        InputError: If the folder does not exist or cannot be written.
    """
    write_pieces(path, (content.encode() if isinstance(content, str) else content,))


_SYSTEM = (Path("/dev"), Path("/proc"))
"""Folders whose files are the system's own: `/dev/stdout` may well lead to a regular file."""


def _is_special(path: Path) -> bool:
    """Return True if a path is a device or a pipe, which is written to and never replaced."""
    own = any(folder in path.absolute().parents for folder in _SYSTEM)
    return path.exists() and not path.is_dir() and (own or not path.is_file())


def write_pieces(path: Path, pieces: Iterable[bytes]) -> None:
    """Write a file piece by piece, as `write_whole` does: for what is too long to hold twice.

    Args:
        path: Where; an existing file is replaced.
        pieces: What it holds, in order.

    Raises:
        InputError: If the folder does not exist or cannot be written.
    """
    if _is_special(path):
        _write_through(path, pieces)
        return
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


def _write_through(path: Path, pieces: Iterable[bytes]) -> None:
    """Write to a device or a pipe; what has gone there cannot be taken back."""
    try:
        with path.open("ab") as file:
            for piece in pieces:
                file.write(piece)
    except OSError as error:
        message = f"Argument `output` must be a file that can be written, but `{path}` is not"
        raise InputError(f"{message} ({error.strerror}).") from error
