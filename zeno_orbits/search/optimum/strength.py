r"""Least pushes of orbits, and the orbit with the largest least push.

The least push of an orbit is the smallest impulse, over phases and directions, after which the
motion is lost. With uncertain parameters it is the smallest of the least pushes at the search's own
values and at all corners of the uncertain ranges. If the orbit does not exist or does not attract
at one of them, the search first maximizes the part of the way to the corners up to which it does.

The least push is continuous, but has kinks where another phase or direction becomes the weakest. It
is maximised without derivatives, by the trust-region method COBYQA [Ragonneau2022]_. The
optimum is local.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.maps import Push, PushSettings, least_push
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import EventReturn, Orbit
from zeno_orbits.search.closing.closing import event_orbit_of
from zeno_orbits.search.objectives import MaxPush
from zeno_orbits.search.optimum.paths import TO_VALUES, OrbitPaths
from zeno_orbits.search.outcome import said_of
from zeno_orbits.search.search_problem import listed
from zeno_orbits.simulation import Extent

_PUSHES = PushSettings(phases=6, steps=24, error=1e-3)
"""Phases and impulses of one evaluation."""
_REGION, _SMALLEST_REGION = 0.2, 2e-3
"""First and last radius of the trust region, in units of the ranges."""
_EVALUATIONS = 24
"""Largest number of evaluations for each free value."""


@dataclass(frozen=True, kw_only=True)
class LeastPush:
    """The least push of an orbit at one corner of uncertain ranges.

    Attributes:
        corner: Name to value of the uncertain parameters, empty at the search's own.
        push: The least push, or ``None`` if the orbit is missing there.
        reason: Reason why it is missing. Empty otherwise.
        slack: Distance of each bounded quantity from its bounds there, positive inside.
    """

    corner: Mapping[str, float]
    push: Push | None
    reason: str = ""
    slack: Vector

    @property
    def impulse(self) -> float:
        """The least impulse. Zero without an orbit, infinite if no scanned impulse is lost."""
        if self.push is None:
            return 0.0
        return self.push.largest if math.isfinite(self.push.largest) else math.inf


@dataclass(frozen=True, kw_only=True)
class Strength:
    """The least pushes of an orbit.

    Attributes:
        values: Values of the orbit.
        found: The orbit.
        pushes: The least push at the search's own values, and at every corner of uncertain ranges,
            up to the first corner where the orbit is missing.
    """

    values: ParameterValues
    found: EventReturn
    pushes: tuple[LeastPush, ...]

    @property
    def least(self) -> LeastPush:
        """The least of all pushes."""
        return min(self.pushes, key=lambda one: one.impulse)

    @property
    def is_kept(self) -> bool:
        """True if the orbit exists and attracts at every corner."""
        return all(one.push is not None for one in self.pushes)

    @property
    def impulse(self) -> float:
        """The least impulse."""
        return self.least.impulse

    @property
    def extent(self) -> Extent:
        """The least impulse with its error. Without a loss, its lower bound and infinity."""
        push = self.least.push
        if push is not None and math.isinf(self.impulse):
            return Extent(lowest=push.searched, highest=math.inf)
        error = 0.0 if push is None else push.error
        return Extent(lowest=self.impulse, highest=self.impulse, error=error)

    @property
    def text(self) -> str:
        """The least push, where it occurs, and the motion beyond it, as sentences."""
        least = self.least
        at = f" (at {listed(least.corner)})" if least.corner else ""
        if least.push is None:
            return f"The orbit is not kept{at}: {least.reason}."
        return said_of(least.push, at)


def push_of(problem: Problem, orbit: Orbit, objective: MaxPush) -> tuple[Push | None, str]:
    """Return the least push of an orbit, or ``None`` and the reason why it is missing.

    Args:
        problem: The problem.
        orbit: The orbit.
        objective: The objective.
    """
    directions = (objective.direction,) if objective.direction else ()
    try:
        return least_push(problem, orbit, directions=directions, settings=_PUSHES), ""
    except InputError as error:
        # The orbit may cease to attract. A direction that moves nothing is the user's.
        if not str(error).startswith("Argument `orbit`"):
            raise
        return None, str(error).removesuffix(".")


def strength(
    paths: OrbitPaths, objective: MaxPush, values: ParameterValues, found: EventReturn
) -> Strength:
    """Compute the least push of an orbit, over all corners of the uncertain ranges.

    Args:
        paths: The orbits over the free values.
        objective: The objective.
        values: Values of the orbit.
        found: The orbit.
    """
    pushes: list[LeastPush] = []
    outside = np.full(len(paths.bounds), -1.0)
    for corner, there, reason in orbits_at_corners(paths, objective, values, found):
        push: Push | None = None
        slack = outside
        if there is not None:
            place = values.replaced(corner)
            slack = paths.slack(place, there) if paths.bounds else outside
            orbit = event_orbit_of(paths.problem, place, there)
            push, reason = push_of(paths.problem, orbit, objective)
        pushes.append(LeastPush(corner=corner, push=push, reason=reason, slack=slack))
        if push is None:
            break
    return Strength(values=values, found=found, pushes=tuple(pushes))


def orbits_at_corners(
    paths: OrbitPaths, objective: MaxPush, values: ParameterValues, found: EventReturn
) -> Iterator[tuple[Mapping[str, float], EventReturn | None, str]]:
    """Yield corner, orbit and reason of its absence, at an orbit and at all uncertain corners.

    Args:
        paths: The orbits over the free values.
        objective: The objective, with the uncertain ranges.
        values: Values of the orbit.
        found: The orbit.
    """
    for corner in ({}, *objective.corners):
        place = values.replaced(corner)
        path = paths.follow(found, values, place, steps=TO_VALUES)
        if path.orbit is not None and path.arrived:
            yield corner, path.orbit, ""
        else:
            yield corner, None, path.loss or "no orbit is near"


def strongest(
    paths: OrbitPaths, objective: MaxPush, values: ParameterValues, found: EventReturn
) -> Strength:
    """Return the orbit with the largest least push within the bounds. The optimum is local.

    Args:
        paths: The orbits over the free values.
        objective: The objective.
        values: Values of an orbit that satisfies the bounds.
        found: The orbit.
    """
    best = strength(paths, objective, values, found)
    if not best.is_kept and paths.free:
        values, found = _most_kept(paths, objective, values, found)
        best = strength(paths, objective, values, found)
    if not best.is_kept or math.isinf(best.impulse) or not paths.free:
        # There is nothing to compare. A longer scan of another orbit is no larger push.
        return best
    size = best.impulse or 1.0
    n_rows = len(paths.bounds) * (1 + len(objective.corners))
    outside = np.full(n_rows, -1.0)
    start = _in_unit_box(paths, values)
    kept = {start.tobytes(): (best.impulse, _rows(best, outside))}

    def evaluated(z: Vector) -> tuple[float, Vector]:
        """Return the least push and the distances from the bounds, negative outside."""
        nonlocal best
        key = np.asarray(z).tobytes()
        if key not in kept:
            there = _moved(paths, objective, best, z)
            if there is None:
                return kept.setdefault(key, (0.0, outside))
            slack = _rows(there, outside)
            kept[key] = there.extent.lowest, slack
            if there.impulse > best.impulse and np.all(slack >= 0.0):
                best = there
            paths.tell(f"{len(kept)} gains tried: least push {best.extent.lowest:.4g}")
            if math.isinf(best.impulse):
                raise _EnoughError
        return kept[key]

    with suppress(_EnoughError):
        _highest(
            lambda z: evaluated(z)[0] / size,
            start,
            (lambda z: evaluated(z)[1]) if n_rows else None,
        )
    return best


def _rows(one: Strength, outside: Vector) -> Vector:
    """Return the distances from the bounds at all corners, negative where an orbit is missing."""
    rows = np.concatenate([push.slack for push in one.pushes])
    return np.append(rows, outside[len(rows) :])


def _in_unit_box(paths: OrbitPaths, values: ParameterValues) -> Vector:
    """Return the free values in units of their ranges, ``(k,)``."""
    low, high = np.array(list(paths.free.values())).T
    return (np.array([values.number(name) for name in paths.free]) - low) / (high - low)


def _from_unit_box(paths: OrbitPaths, values: ParameterValues, z: Vector) -> ParameterValues:
    """Return the values with free values in units of their ranges."""
    low, high = np.array(list(paths.free.values())).T
    numbers = np.clip(low + z * (high - low), low, high)
    return values.replaced(dict(zip(paths.free, numbers.tolist(), strict=True)))


def _most_kept(
    paths: OrbitPaths, objective: MaxPush, values: ParameterValues, found: EventReturn
) -> tuple[ParameterValues, EventReturn]:
    """Return the orbit that is kept for the largest part of the way to each uncertain corner.

    The search ends at the first orbit that all corners keep, with the bounds.
    """
    first = _kept_part(paths, objective, values, found)
    best, farthest = (values, found), first
    if first >= 1.0:
        return best
    start = _in_unit_box(paths, values)

    def kept(z: Vector) -> float:
        nonlocal best, farthest
        if np.array_equal(z, start):
            return first
        here, near = best
        wanted = _from_unit_box(paths, here, z)
        path = paths.follow(near, here, wanted, steps=TO_VALUES)
        if path.orbit is None or not path.arrived or not paths.keeps(wanted, path.orbit):
            return -path.left
        part = _kept_part(paths, objective, wanted, path.orbit)
        if part > farthest:
            best, farthest = (wanted, path.orbit), part
            paths.tell(f"orbits kept up to {100 * part:.0f} % of the uncertain ranges")
        if part >= 1.0:
            raise _EnoughError
        return part

    with suppress(_EnoughError):
        _highest(kept, start, None)
    return best


def _kept_part(
    paths: OrbitPaths, objective: MaxPush, values: ParameterValues, found: EventReturn
) -> float:
    """Return the smallest part of the way to an uncertain corner at which the orbit is stable."""
    ways = (
        paths.follow(found, values, values.replaced(corner), steps=TO_VALUES)
        for corner in objective.corners
    )
    return min((way.end for way in ways), default=1.0)


def _highest(
    value: Callable[[Vector], float], start: Vector, inside: Callable[[Vector], Vector] | None
) -> None:
    """Evaluate a function near its largest value in the unit box, without derivatives.

    Args:
        value: The function, about one at the start. It keeps its best value itself.
        start: The start, ``(k,)``.
        inside: Numbers that must not be negative, ``(m,)``, or ``None``.
    """
    # The import of SciPy's optimizers is slow, and few searches need them.
    from scipy.optimize import Bounds, NonlinearConstraint, minimize

    minimize(
        lambda z: -value(z),
        start,
        method="COBYQA",
        bounds=Bounds(np.zeros(start.size), np.ones(start.size)),
        constraints=[] if inside is None else [NonlinearConstraint(inside, 0.0, np.inf)],
        options={
            "initial_tr_radius": _REGION,
            "final_tr_radius": _SMALLEST_REGION,
            "maxfev": _EVALUATIONS * start.size,
        },
    )


class _EnoughError(Exception):
    """An orbit was found that ends the search."""


def _moved(paths: OrbitPaths, objective: MaxPush, best: Strength, z: Vector) -> Strength | None:
    """Return the least pushes at other values, or ``None`` if the orbit is lost on the way."""
    wanted = _from_unit_box(paths, best.values, z)
    path = paths.follow(best.found, best.values, wanted, steps=TO_VALUES)
    if path.orbit is None or not path.arrived:
        return None
    try:
        return strength(paths, objective, wanted, path.orbit)
    except ZenoOrbitsError:
        return None
