"""Files, written atomically."""

from __future__ import annotations

import errno
import gc
import json
import os
import re
import secrets
import shutil
import stat
import tempfile
import time
from collections import Counter
from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast

from zeno_orbits.errors import CONTROLS, InputError, shortened

UNFINISHED = ".unfinished-"
"""Prefix of the name of a file that is being written."""

PICTURES = (".png", ".pdf", ".svg")
"""Suffixes of the pictures that can be written."""


def require_picture(path: Path, argument: str = "output") -> None:
    """Raise an error for a path that cannot become a picture, before any computation.

    Args:
        path: The path.
        argument: Name of the argument, for the message.

    Raises:
        InputError: If the suffix of the path is not in ``PICTURES``, or the path cannot become a
            file.
    """
    require_writable(path, argument)
    if path.suffix.lower() not in PICTURES:
        message = f"Argument `{argument}` must end in .png, .pdf or .svg, but it is `{path.name}`."
        raise InputError(message)


def require_writable(path: Path, argument: str = "output") -> None:
    """Raise an error for a path that cannot become a file, before any computation.

    Devices and pipes are written to directly.

    Args:
        path: The path.
        argument: Name of the argument, for the message.

    Raises:
        InputError: If the folder of the path is missing or not writable, or the path is a folder.
    """
    try:
        path.stat()
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        message = f"must be a file that can be written, but `{path}` is not ({reason})"
        raise InputError(f"Argument `{argument}` {message}.") from error
    folder = _target(path).parent
    if path.is_dir():
        raise InputError(f"Argument `{argument}` must be a file, but `{path}` is a folder.")
    if _is_special(path):
        return
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        why = "" if folder.is_dir() else f": the folder `{path.parent}` does not exist"
        message = f"must be in a writable folder, but `{path}` is not{why}"
        raise InputError(f"Argument `{argument}` {message}.")


_WRITABLE_BY_ALL, _WRITABLE_BY_GROUP = 0o002, 0o020


def others_may_write(path: Path) -> bool:
    """Return True if a user other than this one and root owns or may write to a file or folder.

    A group of the same number as the owner is the owner's own group. Windows is not asked: False.

    Args:
        path: The file or folder. The owner of a link to it counts as well.

    Raises:
        OSError: If it does not exist.
    """
    if not hasattr(os, "geteuid"):
        return False
    # Who owns a link chooses its target.
    link, found = path.lstat(), path.stat()
    shared = found.st_mode & _WRITABLE_BY_GROUP and found.st_gid != found.st_uid
    foreign = not {link.st_uid, found.st_uid} <= {os.geteuid(), 0}
    return bool(foreign or shared or found.st_mode & _WRITABLE_BY_ALL)


MOST_BYTES = 1 << 29
"""Largest size of a JSON file [B]: a map of a million points has about 2e8."""

_ESCAPED = re.compile(
    r"(?<!\\)(?:\\\\)*\\(?:[bfr]|u00(?:0[0-8bcefBCEF]|1|7[fF]|[89])|u20(?:0[eEfF]|2[89a-eA-E]|6[6-9]))"
)
"""Escapes of the characters in ``CONTROLS``, after any number of escaped backslashes."""


def read_json(path: Path, *, most: int = MOST_BYTES, constants: bool = False) -> Any:
    """Return the data of a JSON file, whose objects must not repeat a name.

    Texts must not contain characters that command a terminal.

    Args:
        path: The file, in UTF-8.
        most: Largest size of the file [B].
        constants: True to read NaN and infinity, for a caller that names their entries.

    Raises:
        ValueError: If the file cannot be read as such. The message is a clause about the file.
    """
    try:
        text = _read_text(path, most)
        return json.loads(
            text, object_pairs_hook=_once, parse_constant=float if constants else _refused
        )
    except OSError as error:
        raise ValueError(f"it cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise ValueError("it is not UTF-8 text") from error
    except _ContentError:
        raise
    except (ValueError, RecursionError) as error:
        if getattr(error, "pos", 1) == 0:
            raise ValueError("it is not JSON") from error
        raise ValueError(f"it is not complete JSON ({error})") from error


def _read_text(path: Path, most: int) -> str:
    """Return the text of a file, which is a regular file: a pipe or a device may not end."""
    found = path.stat()
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(found.st_mode):
        raise _ContentError("it is a pipe or a device, and not a file")
    if found.st_size > most:
        raise _ContentError(f"it is larger than {most} bytes")
    # Editors of Windows begin a file with a byte order mark.
    text = path.read_text(encoding="utf-8-sig")
    commands = "\x7f" in text or not (text.isascii() or CONTROLS.search(text) is None)
    if commands or ("\\" in text and _ESCAPED.search(text)):
        raise _ContentError("it holds control characters in a text")
    if not text.strip():
        raise _ContentError("it is empty")
    return text


@contextmanager
def without_collection() -> Generator[None]:
    """Pause the collection of garbage in cycles, while a large file becomes values without any.

    Every collection would visit all values that were made before.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def read_object(path: Path) -> dict[str, Any]:
    """Return the names and values of a JSON file.

    Args:
        path: The file, in UTF-8.

    Raises:
        ValueError: If the file cannot be read as such. The message is a clause about the file.
    """
    entries = read_json(path)
    if not isinstance(entries, dict):
        raise ValueError("it is not a JSON object")  # noqa: TRY004 (a fault of the file)
    return cast("dict[str, Any]", entries)


class _ContentError(ValueError):
    """A file repeats a name, or contains what no file of results contains."""


def _refused(word: str) -> Any:
    """Raise an error for a constant that Python reads and JSON does not define."""
    raise _ContentError(f"it holds {word}, which is not a JSON number")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) != len(pairs):
        (twice, _), *_ = Counter(word for word, _ in pairs).most_common(1)
        raise _ContentError(f"it names `{shortened(twice)}` twice in one object")
    return entries


def require_folder(folder: Path) -> None:
    """Raise an error for a path that cannot become a folder of files, before any computation.

    Raises:
        InputError: If the path is a file, or the folder or its nearest existing parent is not
            writable.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"Argument `output` must be a folder, but `{folder}` is a file.")
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not there.is_dir() or not os.access(there, os.W_OK):
        message = f"must be a folder that can be made, but `{folder}` is not"
        raise InputError(f"Argument `output` {message}.")


def write_all(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files into a folder, all or none: they are moved into the folder when all are written.

    If a file cannot be moved, the files that were already moved are removed and the previous files
    are restored.

    Args:
        folder: The folder. A missing folder is created. Other files in it are left unchanged.
        files: Name to content.

    Raises:
        InputError: If the folder cannot be created or written.
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
                _keep_mode(folder / file, new / file)
            _exchange(folder, new, old, files)
    except OSError as error:
        message = f"Argument `output` must be a folder that can be written, but `{folder}` is not"
        raise InputError(f"{message} ({error.strerror}).") from error


def _exchange(folder: Path, new: Path, old: Path, names: Iterable[str]) -> None:
    """Move files into a folder, and its previous files of the same names into a third folder.

    A link stays, and its target is exchanged.
    """
    places = {name: _target(folder / name) for name in names}
    try:
        for name, place in places.items():
            if place.exists():
                shutil.move(place, old / name)
            shutil.move(new / name, place)
    except BaseException:
        for name, place in places.items():
            if not (new / name).exists():
                place.unlink(missing_ok=True)
            if (old / name).exists():
                shutil.move(old / name, place)
        raise


_SCRATCH = "zeno-orbits-scratch-"
_ABANDONED = 3600.0
"""Age at which a folder for temporary files counts as abandoned [s]. None is used so long."""


@contextmanager
def scratch_folder(parent: Path | None = None) -> Generator[Path]:
    """Yield a folder for temporary files, which is removed at the end.

    Folders in the same place that killed processes left more than an hour ago are removed as well.

    Args:
        parent: Folder in which the folder is created, by default the system's temporary folder.
    """
    place = Path(tempfile.gettempdir()) if parent is None else parent
    remove_abandoned(place, f"{_SCRATCH}*", _ABANDONED)
    # A program that was killed may still write its last file.
    with tempfile.TemporaryDirectory(
        dir=place, prefix=_SCRATCH, ignore_cleanup_errors=True
    ) as name:
        yield Path(name)


def remove_abandoned(place: Path, pattern: str, age: float) -> None:
    """Remove old folders of this user, which runs left that the system ended.

    Args:
        place: Folder in which the folders are.
        pattern: Pattern of their names.
        age: Time since their last change at which they are removed [s].
    """
    if not hasattr(os, "geteuid"):
        return
    for folder in place.glob(pattern):
        with suppress(OSError):
            facts = folder.lstat()
            own = stat.S_ISDIR(facts.st_mode) and facts.st_uid == os.geteuid()
            if own and time.time() - facts.st_mtime > age:
                shutil.rmtree(folder, ignore_errors=True)


def write_whole(path: Path, content: str | bytes, argument: str = "output") -> None:
    """Write a file through a temporary file in the same folder, so that readers see it complete.

    Args:
        path: The file. An existing file is replaced.
        content: Text (UTF-8) or bytes.
        argument: Name of the argument that gives the path, for the message.

    Raises:
        InputError: If the folder does not exist or cannot be written.
    """
    pieces = (utf8(content) if isinstance(content, str) else content,)
    write_pieces(path, pieces, argument)


def utf8(text: str) -> bytes:
    """Return a text in UTF-8, with escapes for bytes of file names that are not valid UTF-8."""
    return text.encode("utf-8", "backslashreplace")


_SYSTEM = (Path("/dev"), Path("/proc"))
"""Folders of the operating system: `/dev/stdout` may be a link to a regular file."""


def _is_special(path: Path) -> bool:
    """Return True if a path is a device or a pipe, which is written to but not replaced."""
    own = any(folder in path.absolute().parents for folder in _SYSTEM)
    return path.exists() and not path.is_dir() and (own or not path.is_file())


def write_pieces(path: Path, pieces: Iterable[bytes], argument: str = "output") -> None:
    """Write a file like `write_whole`, but piece by piece.

    For content that is too long to hold twice in memory.

    Args:
        path: The file. An existing file is replaced.
        pieces: Content of the file, in order.
        argument: Name of the argument that gives the path, for the message.

    Raises:
        InputError: If the folder does not exist or cannot be written.
    """
    if _is_special(path):
        _write_through(path, pieces)
        return
    target = _target(path)
    if target.is_dir():
        raise InputError(f"Argument `{argument}` must be a file, but `{path}` is a folder.")
    try:
        replace_file(target, pieces)
    except OSError as error:
        folder = target.parent
        writable = folder.is_dir() and os.access(folder, os.W_OK)
        kind = "a file that can be written" if writable else "in a writable folder"
        message = f"Argument `{argument}` must be {kind}, but `{path}` is not"
        raise InputError(f"{message} ({error.strerror}).") from error


def replace_file(path: Path, pieces: Iterable[bytes]) -> None:
    """Write a file through a temporary file in the same folder. A link at its path is replaced.

    Args:
        path: The file. An existing file is replaced and keeps its permissions.
        pieces: Content of the file, in order.

    Raises:
        OSError: If the folder does not exist or cannot be written.
    """
    # The temporary name is short, since the name of the file may have the largest allowed length.
    temporary = path.with_name(f"{UNFINISHED}{secrets.token_hex(8)}")
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    try:
        with os.fdopen(handle, "wb") as file:
            for piece in pieces:
                file.write(piece)
        _keep_mode(path, temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _target(path: Path) -> Path:
    """Return the target of a link, or the path itself, since links are kept when written to."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def _keep_mode(old: Path, new: Path) -> None:
    """Copy the permissions of the replaced file to the new file. The umask applies otherwise."""
    if old.is_file():
        new.chmod(stat.S_IMODE(old.stat().st_mode))


def _write_through(path: Path, pieces: Iterable[bytes]) -> None:
    """Write to a device or a pipe, which cannot be undone."""
    try:
        with path.open("ab") as file:
            for piece in pieces:
                file.write(piece)
    except OSError as error:
        message = f"Argument `output` must be a file that can be written, but `{path}` is not"
        raise InputError(f"{message} ({error.strerror}).") from error
