"""A scene as words that another process can follow: its file, and what the file must hold."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from zeno_orbits.errors import InputError
from zeno_orbits.problem import Problem, bundled_problems, load_problem, split_fidelity

_MOST = 16
"""Scenes that a process remembers; their compiled models hang on them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneFile:
    """Where a scene comes from. A scene itself holds functions, which cannot be sent.

    Attributes:
        word: Its name, or the absolute path of its file, with ``@fidelity`` if it has one.
        digest: Of the source.
    """

    word: str
    digest: str

    def load(self) -> Problem:
        """Return the scene, the same object every time in one process.

        Raises:
            InputError: If its file is missing here, or is another one.
        """
        return _loaded(self)


def scene_file(name_or_path: str | Path) -> SceneFile:
    """Return where a scene comes from.

    Raises:
        InputError: If there is no such scene.
        ProblemFileError: If its file does not define one.
    """
    load_problem(name_or_path)
    scene, fidelity = split_fidelity(name_or_path)
    word = scene if scene in bundled_problems() else str(Path(scene).resolve())
    whole = word if fidelity is None else f"{word}@{fidelity}"
    return SceneFile(word=whole, digest=_digest(whole))


def _digest(word: str) -> str:
    """Return a digest of the Python files that a scene may be made of."""
    scene, _ = split_fidelity(word)
    path = bundled_problems().get(scene, Path(scene))
    files = sorted(path.glob("*.py")) if path.is_dir() else [path]
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.name}\n".encode() + file.read_bytes())
    return digest.hexdigest()


@lru_cache(maxsize=_MOST)
def _loaded(scene: SceneFile) -> Problem:
    problem = load_problem(scene.word)
    if _digest(scene.word) != scene.digest:
        raise InputError(
            f"Argument `problem` must be the same file for everybody who works on it, but "
            f"`{scene.word}` is another one here."
        )
    return problem
