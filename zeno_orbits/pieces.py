"""The pieces of a continuation that know nothing of each other.

A direction of a family, the branch that a flip throws off, one direction of a curve in two
parameters: each follows from its start alone. So it is the same wherever it is done.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np

from zeno_orbits.boundaries import half_boundary
from zeno_orbits.branch_data import branch_from_json, branch_to_json, half_from_json, half_to_json
from zeno_orbits.branches import Branch, Tell, follow
from zeno_orbits.corrector import BranchPoint, correct
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.families import HalfCurve, Kind
from zeno_orbits.plane import Plane
from zeno_orbits.problem import Problem
from zeno_orbits.singular_points import Located
from zeno_orbits.tracks import ContinuationSettings, Course, Track

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
