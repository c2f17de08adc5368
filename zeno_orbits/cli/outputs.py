"""Outputs of commands: what kind of file each is, and the checks before any work."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from zeno_orbits.errors import InputError
from zeno_orbits.work import PICTURES, require_folder, require_picture, require_writable


@dataclass(frozen=True, slots=True)
class FileKind:
    """A kind of output.

    Attributes:
        noun: Noun with its article, for messages.
        endings: Endings of its names, the usual one first. Empty for a folder.
        only: True if names must have one of these endings.
    """

    noun: str
    endings: tuple[str, ...]
    only: bool = False

    def require(self, path: Path, argument: str, *, draws: bool = False) -> None:
        """Refuse a name whose ending belongs to another kind of file.

        Args:
            path: The output.
            argument: Name of the argument that gives it.
            draws: True if another option of the command draws a picture.

        Raises:
            InputError: If the ending belongs to another kind of file.
        """
        ending = path.suffix.lower()
        if ending in self.endings or not (self.only or ending in _ENDINGS):
            return
        if self is FOLDER and path.is_dir():
            return
        usual = path.with_suffix(next(iter(self.endings), "")).name
        hint = ": --json prints JSON" if ending == ".json" else ""
        if ending in _IMAGES and draws:
            hint = ": --plot draws pictures"
        raise InputError(f"Argument `{argument}` must name {self.noun}, such as {usual}{hint}.")


JSON = FileKind("a JSON file", (".json",))
SAMPLES = FileKind("a table of samples", (".csv", ".tsv", ".txt", ".dat"))
PYTHON = FileKind("a Python file", (".py",), only=True)
PAGE = FileKind("a web page", (".html", ".htm"), only=True)
PICTURE = FileKind("a picture", PICTURES, only=True)
FOLDER = FileKind("a folder", ())

_IMAGES = {*PICTURE.endings, ".gif", ".jpg", ".jpeg", ".eps", ".tif", ".tiff", ".mp4"}
_ENDINGS = {
    *(*JSON.endings, *SAMPLES.endings[:2], *PAGE.endings, *_IMAGES),
    *(".xlsx", ".xls", ".ods", ".mat", ".h5", ".hdf5", ".parquet", ".npz", ".npy", ".pkl"),
    *(".yaml", ".yml", ".toml", ".xml", ".py", ".c", ".h", ".fmu", ".zip"),
}
"""Endings of kinds of files. Other endings, such as `.old`, name no kind."""


def require_outputs(
    options: argparse.Namespace,
    outputs: Mapping[str, FileKind],
    reads: Sequence[Path] = (),
) -> None:
    """Reject outputs that cannot all be written, before any work is done for them.

    Args:
        options: The parsed options.
        outputs: Option to the kind of its output.
        reads: Files that are read, and must stay.

    Raises:
        InputError: If the name of an output is one of another kind of file, an output cannot be
            written, or would overwrite another output or an input.
    """
    # `Path.resolve` raises an error for links in a circle.
    taken = {os.path.realpath(path): "the one that is read" for path in reads}
    for name, kind in outputs.items():
        path: Path | None = getattr(options, name)
        if path is None:
            continue
        if kind is not FOLDER:
            _require_no_folder(path, name, options.words)
        if kind is PICTURE:
            require_picture(path, name)
        elif kind is FOLDER:
            require_folder(path)
        else:
            require_writable(path, name)
        other = taken.setdefault(os.path.realpath(path), f"`{name}`")
        if other != f"`{name}`":
            wanted = f"must be another file than {other}, but both are `{path}`"
            raise InputError(f"Argument `{name}` {wanted}.")
        kind.require(path, name, draws=PICTURE in outputs.values())


def _require_no_folder(path: Path, argument: str, words: Sequence[str]) -> None:
    """Refuse a file whose name was typed with a slash at its end, which a path drops.

    Raises:
        InputError: If it was.
    """
    for word in words:
        glued = word[2:] if word.startswith("-") else word
        typed = word.partition("=")[2] if word.startswith("--") else glued
        if typed.endswith(("/", os.sep)) and Path(typed) == path:
            raise InputError(
                f"Argument `{argument}` must be a file, but `{typed}` names a folder: "
                f"add the name of the file."
            )
