"""The independent jobs of a continuation.

A job computes one direction of a family, the branch that bifurcates at a flip, or one direction of
a curve in two parameters. Each job depends on its start alone. So its result is the same in every
process.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol, TypeVar

import numpy as np

from zeno_orbits.continuation.branch import Branch, follow_branch
from zeno_orbits.continuation.corrector import BranchPoint, correct
from zeno_orbits.continuation.families import HalfCurve, SpecialPointKind
from zeno_orbits.continuation.return_maps import FamilyMap
from zeno_orbits.continuation.setup import ContinuationSettings, Setup
from zeno_orbits.continuation.two_parameters.boundary import half_boundary
from zeno_orbits.continuation.two_parameters.plane import CurveSetup, CurveStart, ParameterPlane
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import Problem
from zeno_orbits.work import Progress

R = TypeVar("R", covariant=True)


class Job(Protocol[R]):
    """A part of a continuation that can be sent to a worker, as a frozen dataclass.

    Attributes:
        result: Type of its result, another frozen dataclass or ``None``.
    """

    result: ClassVar[object]

    def run(self, problem: Problem, settings: ContinuationSettings, on_progress: Progress, /) -> R:
        """Return the result.

        Args:
            problem: The problem.
            settings: Settings of the continuation.
            on_progress: Called with each point.

        Raises:
            ZenoOrbitsError: If the job fails.
        """
        ...

    def failed(self, reason: str, /) -> R:
        """Return the result of a failed job, which contains only its start."""
        ...


@dataclass(frozen=True, kw_only=True)
class FollowDirection:
    """Follow a family from a point along its tangent.

    Attributes:
        setup: The setup of the family.
        start: The point.
    """

    result: ClassVar[object] = Branch
    setup: Setup
    start: BranchPoint

    def run(
        self, problem: Problem, settings: ContinuationSettings, on_progress: Progress
    ) -> Branch:
        """Return the family in that direction."""
        returns = self.setup.returns(problem)
        return _followed(self.setup, returns, self.start, settings, on_progress)

    def failed(self, reason: str) -> Branch:
        """Return a branch that contains only the start."""
        return _given_up(self.start, reason)


_AWAY = (1e-3, 4e-3, 1.6e-2)
"""Distances from a flip at which the branch of twice the period is searched."""
_APART = 0.2
"""Least distance of a point from its own first return, relative to its distance from the flip."""


@dataclass(frozen=True, kw_only=True)
class FollowDoubling:
    r"""Follow the family of twice the period that bifurcates at a flip (period doubling).

    It starts normal to the parameter axis, along the eigenvector `v` of the multiplier:
    :math:`z = z_* \pm \epsilon v + O(\epsilon^2)`. One sense is enough, because a return maps
    either half of the family to the other.

    Attributes:
        setup: Problem, fixed values and settings of the family with the flip.
        flip: The flip.
    """

    result: ClassVar[object] = Branch | None
    setup: Setup
    flip: BranchPoint

    def run(
        self, problem: Problem, settings: ContinuationSettings, on_progress: Progress
    ) -> Branch | None:
        """Return the branch, or ``None`` if no branch starts near the flip."""
        point, metric = self.flip, self.setup.metric
        once, setup = self.setup.returns(problem), self.setup.doubled()
        returns = setup.returns(problem)
        values, vectors = np.linalg.eig(point.jacobian)
        v = np.real(vectors[:, int(np.argmin(np.abs(values + 1)))])
        here = once.frame(point.x, point.s, metric.scale)
        direction = np.append(here.tangent @ v, 0.0)
        # An eigenvector has any sign: its largest component falls, so that returns are numbered.
        direction /= -np.sign(direction[np.argmax(np.abs(direction))]) * np.linalg.norm(direction)

        def closes_earlier(other: BranchPoint) -> bool:
            """Return True for an orbit that already closes after half the returns."""
            x = once.projected(other.x, other.s, metric.scale)
            half = once.follow(x, other.s, horizon=metric.horizon)
            away = float(np.linalg.norm(other.z - point.z))
            return float(np.max(np.abs(half.end - other.x) / metric.scale)) < min(
                _APART * away, _APART * _AWAY[0]
            )

        for away in _AWAY:
            try:
                start = correct(returns, metric, point.z + away * direction, direction)
            except ZenoOrbitsError:
                continue
            if not closes_earlier(start) and float(start.tangent @ direction) > 0.0:
                on_progress(f"branch of period {setup.n_returns} at {start.s:.6g}", None)
                return _followed(setup, returns, start, settings, on_progress, closes_earlier)
        return None

    def failed(self, reason: str) -> Branch | None:
        """Return a branch that contains only the flip."""
        return _given_up(self.flip, reason)


@dataclass(frozen=True, kw_only=True)
class FollowHalfCurve:
    """Follow a special point in two parameters, in one direction.

    Attributes:
        setup: The setup of its family.
        plane: The two parameters.
        start: The point.
        upwards: True if the second parameter rises at first.
    """

    result: ClassVar[object] = HalfCurve
    setup: Setup
    plane: ParameterPlane
    start: CurveStart
    upwards: bool

    def run(
        self, problem: Problem, settings: ContinuationSettings, on_progress: Progress
    ) -> HalfCurve:
        """Return the curve in that direction."""
        setup = CurveSetup(
            plane=self.plane,
            returns=self.setup.returns(problem),
            metric=self.setup.metric,
            steps=settings.curve,
            on_progress=on_progress,
        )
        return half_boundary(setup, self.start, upwards=self.upwards)

    def failed(self, reason: str) -> HalfCurve:
        """Return a curve that contains only the point."""
        return HalfCurve(
            x=self.start.value[:1],
            y=self.start.value[1:],
            errors=(self.start.found.error / float(self.plane.units[0]),),
            end=f"{SpecialPointKind.GAVE_UP.value}: {reason}",
        )


def _followed(
    setup: Setup,
    returns: FamilyMap,
    start: BranchPoint,
    settings: ContinuationSettings,
    on_progress: Progress,
    excluded: Callable[[BranchPoint], bool] | None = None,
) -> Branch:
    return follow_branch(
        returns,
        setup.metric,
        start,
        setup.box,
        settings.steps,
        on_progress=on_progress,
        excluded=excluded,
    )


def _given_up(point: BranchPoint, reason: str) -> Branch:
    return Branch(points=(point,), special=(), ending=SpecialPointKind.GAVE_UP, detail=reason)
