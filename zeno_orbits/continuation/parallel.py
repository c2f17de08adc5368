"""The pieces of a continuation that know nothing of each other.

A direction of a family, the branch that a flip throws off, one direction of a curve in two
parameters: each follows from its start alone. So it is the same wherever it is done.

Who has the pieces of a continuation done: this process, or a crew of workers.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from zeno_orbits.continuation.branch import Branch, Tell, follow
from zeno_orbits.continuation.branch_data import (
    branch_from_json,
    branch_to_json,
    half_from_json,
    half_to_json,
)
from zeno_orbits.continuation.corrector import BranchPoint, correct
from zeno_orbits.continuation.families import HalfCurve, Kind
from zeno_orbits.continuation.setup import ContinuationSettings, Course, Track
from zeno_orbits.continuation.special_points import Located
from zeno_orbits.continuation.two_parameters.boundary import half_boundary
from zeno_orbits.continuation.two_parameters.plane import Plane
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.model.library import ProblemFile
from zeno_orbits.model.problem import Problem
from zeno_orbits.work import Lost, Plan, Pool, claim, spread
from zeno_orbits.work.serialization import plain

R = TypeVar("R")


class Piece(Protocol[R]):
    """A piece of a continuation; it can be sent, and so can its result."""

    def done(self, problem: Problem, settings: ContinuationSettings, tell: Tell) -> R:
        """Return what comes of it.

        Raises:
            ZenoOrbitsError: If nothing does.
        """
        ...

    def lost(self, reason: str) -> R:
        """Return what there is without it."""
        ...

    def to_json(self, result: R) -> Any:
        """Return a result as plain data."""
        ...

    def from_json(self, data: Any) -> R:
        """Return a result from plain data."""
        ...


@dataclass(frozen=True, kw_only=True)
class Direction:
    """Follow a family from a point along its tangent.

    Attributes:
        course: What it is followed on.
        start: The point.
    """

    course: Course
    start: BranchPoint

    def done(self, problem: Problem, settings: ContinuationSettings, tell: Tell) -> Branch:
        """Return the family in that direction."""
        return _followed(Track(problem=problem, course=self.course), self.start, settings, tell)

    def lost(self, reason: str) -> Branch:
        """Return the start alone."""
        return _given_up(self.start, reason)

    def to_json(self, result: Branch) -> Any:
        """Return a family as plain data."""
        return branch_to_json(result)

    def from_json(self, data: Any) -> Branch:
        """Return a family from plain data."""
        return branch_from_json(data)


_AWAY = (1e-3, 4e-3, 1.6e-2)
"""Distances from a flip at which the branch of twice the period is looked for."""
_APART = 0.2
"""Part of that distance by which a point must differ from its own first return."""


@dataclass(frozen=True, kw_only=True)
class Doubling:
    r"""Follow the family of twice the period that a flip throws off.

    It leaves at right angles to the parameter, along the multiplier's own direction `v`:
    :math:`z = z_* \pm \epsilon v + O(\epsilon^2)`. One sense is enough, as a return leads from
    either half of the family to the other.

    Attributes:
        course: What the family with the flip was followed on.
        flip: The flip.
    """

    course: Course
    flip: Located

    def done(self, problem: Problem, settings: ContinuationSettings, tell: Tell) -> Branch | None:
        """Return the branch, or nothing if there is none near the flip."""
        track, point = Track(problem=problem, course=self.course), self.flip.point
        doubled, metric = track.doubled(), self.course.metric
        values, vectors = np.linalg.eig(point.jacobian)
        v = np.real(vectors[:, int(np.argmin(np.abs(values + 1)))])
        here = track.returns.frame(point.x, point.s, metric.scale)
        direction = np.append(here.tangent @ v, 0.0)
        direction /= np.linalg.norm(direction)

        def alien(other: BranchPoint) -> bool:
            """Tell an orbit that closes after half the returns."""
            once = track.returns.follow(other.x, other.s, horizon=metric.horizon)
            away = float(np.linalg.norm(other.z - point.z))
            return float(np.max(np.abs(once.end - other.x) / metric.scale)) < min(
                _APART * away, _APART * _AWAY[0]
            )

        for away in _AWAY:
            try:
                start = correct(doubled.returns, metric, point.z + away * direction, direction)
            except ZenoOrbitsError:
                continue
            if not alien(start) and float(start.tangent @ direction) > 0.0:
                tell(f"branch of {doubled.n_returns} returns at {start.s:.6g}", None)
                return _followed(doubled, start, settings, tell, alien)
        return None

    def lost(self, reason: str) -> Branch | None:
        """Return the flip alone."""
        return _given_up(self.flip.point, reason)

    def to_json(self, result: Branch | None) -> Any:
        """Return a branch as plain data."""
        return None if result is None else branch_to_json(result)

    def from_json(self, data: Any) -> Branch | None:
        """Return a branch from plain data."""
        return None if data is None else branch_from_json(data)


@dataclass(frozen=True, kw_only=True)
class Half:
    """Follow a special point in two parameters, in one direction.

    Attributes:
        course: What its family was followed on.
        plane: The two parameters.
        found: The point.
        value: Both parameters there.
        leading: The last points of the family before an end.
        upwards: Whether the second parameter rises at first.
    """

    course: Course
    plane: Plane
    found: Located
    value: tuple[float, float]
    leading: tuple[BranchPoint, ...]
    upwards: bool

    def done(self, problem: Problem, settings: ContinuationSettings, tell: Tell) -> HalfCurve:
        """Return the curve in that direction."""
        return half_boundary(
            self.plane,
            Track(problem=problem, course=self.course).on_line,
            self.course.metric,
            self.found,
            self.value,
            leading=self.leading,
            upwards=self.upwards,
            steps=settings.curve,
            tell=tell,
        )

    def lost(self, reason: str) -> HalfCurve:
        """Return the point alone."""
        return HalfCurve(
            x=self.value[:1],
            y=self.value[1:],
            errors=(self.found.error / float(self.plane.units[0]),),
            end=f"{Kind.GAVE_UP.value}: {reason}",
        )

    def to_json(self, result: HalfCurve) -> Any:
        """Return half a curve as plain data."""
        return half_to_json(result)

    def from_json(self, data: Any) -> HalfCurve:
        """Return half a curve from plain data."""
        return half_from_json(data)


def _followed(
    track: Track,
    start: BranchPoint,
    settings: ContinuationSettings,
    tell: Tell,
    alien: Callable[[BranchPoint], bool] | None = None,
) -> Branch:
    return follow(
        track.returns,
        track.metric,
        start,
        track.course.box,
        settings.steps,
        restitution=track.restitution,
        tell=tell,
        alien=alien,
    )


def _given_up(point: BranchPoint, reason: str) -> Branch:
    return Branch(points=(point,), special=(), ending=Kind.GAVE_UP, detail=reason)


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
        problem: Where they find the problem; a continuation is told ``problem.load()``.
        plan: Where finished pieces are kept. Its identity is filled in.
        pool: The workers, of `open_pool`.
        tell: Told how many pieces of a stage are done, and which part of the time it takes.
    """

    problem_file: ProblemFile
    plan: Plan
    pool: Pool
    tell: Tell


@dataclass(frozen=True, kw_only=True)
class Dispatch:
    """Has pieces done: by this process, or by a crew.

    Attributes:
        problem: The problem.
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
            InputError: If the crew has another problem, or the checkpoint is another's.
        """
        if self.crew is None:
            return self
        if self.crew.problem_file.load() is not self.problem:
            wanted = "must be what the `problem` of `crew` loads"
            raise InputError(f"Argument `problem` {wanted}, but it is another problem.")
        identity = {"work": "continuation", **own, "problem_digest": self.crew.problem_file.digest}
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

    problem_file: ProblemFile
    settings: ContinuationSettings
    pieces: tuple[Piece[R], ...]

    def __call__(self, numbers: Sequence[int]) -> list[Any]:
        """Return what comes of pieces, as plain data."""
        problem = self.problem_file.load()
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
    task = _Task(problem_file=crew.problem_file, settings=settings, pieces=tuple(pieces))
    plan = replace(crew.plan, noun=noun)
    if plan.checkpoint is not None:
        words = json.dumps([plain(piece) for piece in pieces])
        digest = hashlib.sha256(words.encode()).hexdigest()
        plan = replace(
            plan,
            checkpoint=plan.checkpoint / stage,
            identity={**plan.identity, "stage": stage, "pieces": digest},
        )
    results = spread(task, range(len(pieces)), plan, on_progress=_Clock(crew.tell), pool=crew.pool)
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

    def __call__(self, what: str, part: float | None, /) -> None:
        """Tell how much is done."""
        now = time.monotonic()
        if part is not None and part > self._part:
            # Pieces are few and not alike: what is done tells the others' time but roughly.
            self._part, self._ready = part, now + (now - self._started) * (1 - part) / part
        left = self._ready - now
        self._tell(f"{what}, about {left:.0f} s left of these" if left > 1.0 else what, None)


def _nobody(stage: str, part: float | None) -> None:
    """Tell nobody."""
