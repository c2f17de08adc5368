"""Checkpoints: finished chunks on disk, each written atomically and tied to one work."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import socket
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from zeno_orbits.errors import CheckpointError
from zeno_orbits.work.files import UNFINISHED, read_object, replace_file, utf8
from zeno_orbits.work.locks import file_lock, is_regular
from zeno_orbits.work.plan import FailedPoint

FORMAT = 1
"""Version of the files in the folder."""
_IDENTITY = "identity.json"
_SHOWN = 70
"""Largest number of characters of a value in a message."""


_LOCK, _OWNER = ".lock", ".owner"


@contextlib.contextmanager
def folder_lock(folder: Path) -> Generator[None]:
    """Lock a folder against other processes within a context.

    The operating system frees the lock when its process ends. This process may lock its folder
    again.

    Args:
        folder: The folder. A missing folder is created.

    Raises:
        CheckpointError: If another process has locked the folder.
    """
    _require_folder(folder)
    place = folder.resolve()
    if place in _held:
        yield
        return
    with contextlib.ExitStack() as lock:
        try:
            folder.mkdir(exist_ok=True)
            lock.enter_context(file_lock(folder / _LOCK))
            owner = f"process {os.getpid()} on {socket.gethostname()}"
            replace_file(folder / _OWNER, (utf8(owner),))
        except TimeoutError as error:
            help_ = "Wait until it ends, or choose another output or checkpoint"
            raise CheckpointError(folder, f"{_owner(folder)} is working on it. {help_}") from error
        except OSError as error:
            raise CheckpointError(folder, f"it cannot be written ({error.strerror})") from error
        lock.callback((folder / _OWNER).unlink, missing_ok=True)
        _held.add(place)
        lock.callback(_held.discard, place)
        yield


_held: set[Path] = set()
"""Folders that this process has locked."""


def _owner(folder: Path) -> str:
    """Return the name of the process that has locked a folder."""
    path = folder / _OWNER
    try:
        text = path.read_text(encoding="utf-8") if is_regular(path) else ""
    except (OSError, ValueError):
        text = ""
    return text[:_SHOWN].strip() or "another process"


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkpoint:
    """A folder of finished chunks.

    Attributes:
        folder: The folder.
        work: Digest of the identity of the work.
        sizes: Number of points of each chunk.
    """

    folder: Path
    work: str
    sizes: tuple[int, ...]

    def save(self, chunk: int, results: Sequence[Any]) -> None:
        """Store a finished chunk.

        Args:
            chunk: Index of the chunk.
            results: One result per point.

        Raises:
            CheckpointError: If the folder cannot be written.
        """
        lost = [k for k, result in enumerate(results) if isinstance(result, FailedPoint)]
        kept = [None if isinstance(result, FailedPoint) else result for result in results]
        body = {"chunk": chunk, "lost": lost, "results": kept}
        entries = {"format": FORMAT, "work": self.work, "checksum": _digest(body)} | body
        _write(self._file(chunk), json.dumps(entries, allow_nan=False) + "\n")

    def finished(self) -> dict[int, list[Any]]:
        """Return the results of every stored chunk.

        Raises:
            CheckpointError: If a file is damaged or belongs to other work.
        """
        chunks = range(len(self.sizes))
        return {k: self._read(k) for k in chunks if self._file(k).exists()}

    def _file(self, chunk: int) -> Path:
        return self.folder / f"chunk-{chunk:06d}.json"

    def _read(self, chunk: int) -> list[Any]:
        path = self._file(chunk)
        entries = _object(path)
        body = {name: entries.get(name) for name in ("chunk", "lost", "results")}
        if entries.get("work") != self.work or body["chunk"] != chunk:
            raise _broken(path, "it belongs to other work or another chunk")
        if entries.get("checksum") != _digest(body):
            raise _broken(path, "its checksum is wrong")
        lost, kept = cast("list[int]", body["lost"]), cast("list[Any]", body["results"])
        if len(kept) != self.sizes[chunk]:
            raise _broken(path, f"it has {len(kept)} results in place of {self.sizes[chunk]}")
        return [FailedPoint() if k in lost else result for k, result in enumerate(kept)]


def open_checkpoint(folder: Path, identity: Mapping[str, Any], sizes: Sequence[int]) -> Checkpoint:
    """Open the checkpoint of a work, new or with the chunks of an earlier run.

    Args:
        folder: The folder. A missing folder is created.
        identity: Run fingerprint, which distinguishes this work from other work, as plain data.
        sizes: Number of points of each chunk.

    Raises:
        CheckpointError: If the folder holds other files or other work. The folder is left
            unchanged.
    """
    # Convert through JSON, since the stored identity has been through JSON as well.
    wanted = json.loads(json.dumps({"format": FORMAT, **identity}, allow_nan=False))
    path = folder / _IDENTITY
    _require_own(folder)
    if path.exists():
        found = _object(path)
        if found != wanted:
            raise CheckpointError(folder, _difference(found, wanted))
    else:
        _require_empty(folder)
        folder.mkdir(exist_ok=True)
        _write(path, json.dumps(wanted, indent=2) + "\n")
    return Checkpoint(folder=folder, work=_digest(wanted), sizes=tuple(sizes))


def remove_checkpoint(folder: Path) -> None:
    """Delete the checkpoint of finished work. Other files and links stay, and so do their folders.

    Args:
        folder: The folder, which may be missing.
    """
    for path in _entries(folder):
        if _is_folder(path) and is_regular(path / _IDENTITY):
            remove_checkpoint(path)
        elif is_regular(path) and _OWN.fullmatch(path.name):
            path.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        folder.rmdir()


_OWN = re.compile(rf"chunk-.*\.json|{re.escape(UNFINISHED)}.*|{re.escape(_IDENTITY)}")
"""Names of the files of a checkpoint."""


def _entries(folder: Path) -> list[Path]:
    """Return the paths in a folder, none for a link or a missing folder."""
    return sorted(folder.iterdir()) if _is_folder(folder) else []


def _is_folder(path: Path) -> bool:
    """Return True if a path is a folder, and not a link to one."""
    return path.is_dir() and not path.is_symlink()


def keeps_nothing(folder: Path) -> bool:
    """Return True if no chunk of a checkpoint is finished, in any of its stages."""
    return not any(folder.rglob("chunk-*.json"))


def _require_folder(folder: Path) -> None:
    if folder.is_symlink():
        raise CheckpointError(folder, "it is a link. Name the folder itself")
    if not folder.parent.is_dir() or (folder.exists() and not folder.is_dir()):
        raise CheckpointError(folder, "it is not a folder and cannot become one")


def _require_own(folder: Path) -> None:
    """Refuse a folder that leads to files elsewhere."""
    _require_folder(folder)
    for path in _entries(folder):
        if not (is_regular(path) or _is_folder(path)):
            raise CheckpointError(folder, f"`{path.name}` in it is a link, or not a file")


def _write(path: Path, text: str) -> None:
    try:
        replace_file(path, (utf8(text),))
    except OSError as error:
        reason = f"`{path.name}` in it cannot be written ({error.strerror})"
        raise CheckpointError(path.parent, reason) from error


def _require_empty(folder: Path) -> None:
    # A process that ends while it writes leaves a file whose name begins with a dot.
    strange = [path.name for path in _entries(folder) if path.name[0] != "."]
    if strange:
        raise CheckpointError(folder, f"it is not a checkpoint: it holds `{strange[0]}`")


def _object(path: Path) -> dict[str, Any]:
    try:
        return read_object(path)
    except ValueError as error:
        raise _broken(path, str(error)) from error


def _broken(path: Path, reason: str) -> CheckpointError:
    if path.name == _IDENTITY:
        help_ = "Its work is unknown: name another folder, or remove it"
    else:
        help_ = "Remove that file alone and start again: only its points are computed again"
    return CheckpointError(path.parent, f"`{path.name}` is broken: {reason}. {help_}")


def _digest(data: Any) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def _difference(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """Return a clause about the first entry in which two identities differ."""
    there, here = dict(_leaves(found)), dict(_leaves(wanted))
    missing = object()
    names = (
        name for name in {**here, **there} if there.get(name, missing) != here.get(name, missing)
    )
    name = next(names)
    old, new = (_short(json.dumps(side.get(name, "nothing"))) for side in (there, here))
    help_ = "Finish that work with its own settings, name another folder, or remove it"
    return f"its `{name}` is {old}, not {new}. {help_}"


def _short(text: str) -> str:
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."


def _leaves(data: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in data.items():
        if isinstance(value, dict) and value:
            yield from _leaves(cast("dict[str, Any]", value), f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
