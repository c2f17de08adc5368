"""Who has the pieces of a continuation done: this process, or a crew of workers."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from zeno_orbits.branches import Branch, Tell
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.families import HalfCurve, Kind
from zeno_orbits.pieces import Piece
from zeno_orbits.plain import plain
from zeno_orbits.problem import Problem
from zeno_orbits.scenes import SceneFile
from zeno_orbits.tracks import ContinuationSettings
from zeno_orbits.work import Lost, Plan, Pool, claim, spread

R = TypeVar("R")


def _attempted(piece: Piece[R], problem: Problem, settings: ContinuationSettings, tell: Tell) -> R:
    """Return what comes of a piece; if nothing does, the others go on."""
    try:
        return piece.done(problem, settings, tell)
    except ZenoOrbitsError as error:
        return piece.lost(str(error))


@dataclass(frozen=True, kw_only=True)
class Crew:
    """Workers that follow pieces.

    Attributes:
        scene: Where they find the scene; a continuation is told ``scene.load()``.
        plan: Where finished pieces are kept. Its identity is filled in.
        pool: The workers, of `open_pool`.
        tell: Told how many pieces of a stage are done, and which part of the time it takes.
    """

    scene: SceneFile
    plan: Plan
    pool: Pool
    tell: Tell


@dataclass(frozen=True, kw_only=True)
class Dispatch:
    """Has pieces done: by this process, or by a crew.

    Attributes:
        problem: The scene.
        settings: How families and curves are followed.
        tell: Told what happens here.
        crew: The workers, if there are any.
    """

    problem: Problem
    settings: ContinuationSettings
    tell: Tell
    crew: Crew | None = None

    def claimed(self, own: dict[str, Any]) -> Dispatch:
        """Return the same for one work, whose checkpoint it is.

        Args:
            own: What tells the work from another, as plain data.

        Raises:
            InputError: If the crew has another scene, or the checkpoint is another's.
        """
        if self.crew is None:
            return self
        if self.crew.scene.load() is not self.problem:
            wanted = "must be what the `scene` of `crew` loads"
            raise InputError(f"Argument `problem` {wanted}, but it is another scene.")
        identity = {"work": "continuation", **own, "scene": self.crew.scene.digest}
        plan = replace(self.crew.plan, chunk=1, identity={**identity, **self.crew.plan.identity})
        claim(plan)
        return replace(self, crew=replace(self.crew, plan=plan))

    def done(self, stage: str, noun: str, groups: Sequence[Sequence[Piece[R]]]) -> list[list[R]]:
        """Return what comes of pieces, in their groups.

        In a group each follows what the one before left over: after a family or a curve that
        closes there is nothing.

        Args:
            stage: A name for all of them, by which finished ones are kept.
            noun: What they are called in words of progress.
            groups: The pieces.
        """
        if self.crew is not None:
            flat = [piece for group in groups for piece in group]
            results = iter(_sent(self.crew, stage, noun, self.settings, flat))
            return [_until_closed([next(results) for _ in group]) for group in groups]
        found: list[list[R]] = []
        for group in groups:
            found.append([])
            for piece in group:
                found[-1].append(_attempted(piece, self.problem, self.settings, self.tell))
                if _closes(found[-1][-1]):
                    break
        return found


def _closes(result: Any) -> bool:
    if isinstance(result, Branch):
        return result.ending is Kind.CLOSED
    return isinstance(result, HalfCurve) and result.closes


def _until_closed(results: list[R]) -> list[R]:
    closed = next((k for k, result in enumerate(results) if _closes(result)), len(results))
    return results[: closed + 1]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task(Generic[R]):
    """Does pieces by their numbers; it holds all that a worker has to know."""

    scene: SceneFile
    settings: ContinuationSettings
    pieces: tuple[Piece[R], ...]

    def __call__(self, numbers: Sequence[int]) -> list[Any]:
        """Return what comes of pieces, as plain data."""
        problem = self.scene.load()
        chosen = [self.pieces[number] for number in numbers]
        results = [_attempted(piece, problem, self.settings, _nobody) for piece in chosen]
        return [piece.to_json(result) for piece, result in zip(chosen, results, strict=True)]


def _sent(
    crew: Crew,
    stage: str,
    noun: str,
    settings: ContinuationSettings,
    pieces: Sequence[Piece[R]],
) -> list[R]:
    """Return what comes of pieces that a crew does."""
    if not pieces:
        return []
    task = _Task(scene=crew.scene, settings=settings, pieces=tuple(pieces))
    plan = replace(crew.plan, noun=noun)
    if plan.checkpoint is not None:
        words = json.dumps([plain(piece) for piece in pieces])
        digest = hashlib.sha256(words.encode()).hexdigest()
        plan = replace(
            plan,
            checkpoint=plan.checkpoint / stage,
            identity={**plan.identity, "stage": stage, "pieces": digest},
        )
    results = spread(task, range(len(pieces)), plan, tell=_Clock(crew.tell), pool=crew.pool)
    pairs = zip(pieces, results, strict=True)
    return [
        piece.lost(result.reason) if isinstance(result, Lost) else piece.from_json(result)
        for piece, result in pairs
    ]


class _Clock:
    """Tells the time that is left of a stage, however long those before it took."""

    def __init__(self, tell: Tell) -> None:
        self._tell, self._started = tell, time.monotonic()
        self._part, self._ready = 0.0, self._started

    def __call__(self, what: str, part: float) -> None:
        """Tell how much is done."""
        now = time.monotonic()
        if part > self._part:
            # Pieces are few and not alike: what is done tells the others' time but roughly.
            self._part, self._ready = part, now + (now - self._started) * (1 - part) / part
        left = self._ready - now
        self._tell(f"{what}, about {left:.0f} s left of these" if left > 1.0 else what, None)


def _nobody(stage: str, part: float | None) -> None:
    """Tell nobody."""
