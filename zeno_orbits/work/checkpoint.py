"""Finished chunks on disk: each is written whole, and belongs to one work only."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from zeno_orbits.errors import CheckpointError
from zeno_orbits.work.files import read_object, write_whole
from zeno_orbits.work.plan import LostPoint

FORMAT = 1
"""Version of the files in the folder."""
_IDENTITY = "identity.json"
_SHOWN = 70
"""Characters of a value that a message shows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkpoint:
    """A folder of finished chunks.

    Attributes:
        folder: Where.
        work: Digest of the identity of the work.
        sizes: Number of points of each chunk.
    """

    folder: Path
    work: str
    sizes: tuple[int, ...]

    def save(self, chunk: int, results: Sequence[Any]) -> None:
        """Keep a finished chunk.

        Args:
            chunk: Its index.
            results: One a point.

        Raises:
            InputError: If the folder cannot be written.
        """
        lost = [k for k, result in enumerate(results) if isinstance(result, LostPoint)]
        kept = [None if isinstance(result, LostPoint) else result for result in results]
        body = {"chunk": chunk, "lost": lost, "results": kept}
        entries = {"format": FORMAT, "work": self.work, "checksum": _digest(body)} | body
        write_whole(self._file(chunk), json.dumps(entries, allow_nan=False) + "\n")

    def finished(self) -> dict[int, list[Any]]:
        """Return the results of every chunk that is kept.

        Raises:
            CheckpointError: If a file is broken or does not belong here.
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
        return [LostPoint() if k in lost else result for k, result in enumerate(kept)]


def open_checkpoint(folder: Path, identity: Mapping[str, Any], sizes: Sequence[int]) -> Checkpoint:
    """Return the checkpoint of a work, new or as it was left.

    Args:
        folder: Where; made if it is missing.
        identity: What tells the work from another, as plain data.
        sizes: Number of points of each chunk.

    Raises:
        CheckpointError: If the folder holds something else; it is left as it is.
    """
    # What comes back from a file is compared with what would come back.
    wanted = json.loads(json.dumps({"format": FORMAT, **identity}, allow_nan=False))
    path = folder / _IDENTITY
    if path.exists():
        found = _object(path)
        if found != wanted:
            raise CheckpointError(folder, _difference(found, wanted))
    else:
        _require_empty(folder)
        folder.mkdir(exist_ok=True)
        write_whole(path, json.dumps(wanted, indent=2) + "\n")
    return Checkpoint(folder=folder, work=_digest(wanted), sizes=tuple(sizes))


def remove_checkpoint(folder: Path) -> None:
    """Delete a checkpoint whose work is done; what else is in the folder stays, and so it does."""
    for stage in folder.glob(f"*/{_IDENTITY}"):
        remove_checkpoint(stage.parent)
    kept = (*folder.glob("chunk-*.json"), *folder.glob(".*.json.*"), folder / _IDENTITY)
    for file in kept:
        file.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        folder.rmdir()


def keeps_nothing(folder: Path) -> bool:
    """Return True if no chunk of a checkpoint is finished, in any of its stages."""
    return not any(folder.rglob("chunk-*.json"))


def _require_empty(folder: Path) -> None:
    if not folder.parent.is_dir() or (folder.exists() and not folder.is_dir()):
        raise CheckpointError(folder, "it is not a folder and cannot become one")
    # A process that is killed while it writes leaves a file with a dot behind.
    strange = [] if not folder.exists() else [p.name for p in folder.iterdir() if p.name[0] != "."]
    if strange:
        raise CheckpointError(folder, f"it is not a checkpoint: it holds `{sorted(strange)[0]}`")


def _object(path: Path) -> dict[str, Any]:
    try:
        return read_object(path)
    except ValueError as error:
        raise _broken(path, str(error)) from error


def _broken(path: Path, reason: str) -> CheckpointError:
    if path.name == _IDENTITY:
        help_ = "It does not tell what it belongs to: name another folder, or remove it"
    else:
        help_ = "Remove that file alone and start again; only its points are computed again"
    return CheckpointError(path.parent, f"`{path.name}` is broken: {reason}. {help_}")


def _digest(data: Any) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def _difference(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """Return a clause that says where two identities differ first."""
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
