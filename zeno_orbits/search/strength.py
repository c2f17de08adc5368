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
from zeno_orbits.orbits import Cycle, Orbit, excess
from zeno_orbits.search.cycles import orbit_of
from zeno_orbits.search.homotopy.best_on_line import all_kept, bounded_extents
from zeno_orbits.search.homotopy.homotopy import follow
from zeno_orbits.search.objectives import MaxPush
from zeno_orbits.search.search_problem import SearchProblem, listed
from zeno_orbits.simulation import Extent

_PUSHES = PushSettings(phases=6, steps=24, error=1e-3)
"""Phases and impulses of one evaluation."""
_REGION, _SMALLEST_REGION = 0.2, 2e-3
"""First and last radius of the trust region, in units of the ranges."""
_EVALUATIONS = 24
"""Largest number of evaluations for each free value."""


@dataclass(frozen=True, kw_only=True)
class Strength:
    """The least push of an orbit.

    Attributes:
        values: Values of the orbit.
        cycle: One simulated period of the orbit.
        place: Values at which the least push occurs: a corner of the uncertain ranges, or
            ``values``.
        push: The least push, or ``None`` if an orbit is missing at ``place``.
        reason: Reason why an orbit is missing. Empty otherwise.
    """

    values: ParameterValues
    cycle: Cycle | Orbit
    place: ParameterValues
    push: Push | None
    reason: str = ""

    @property
    def impulse(self) -> float:
        """The least impulse. Zero without an orbit, infinite if no scanned impulse is lost."""
        if self.push is None:
            return 0.0
        return self.push.largest if math.isfinite(self.push.largest) else math.inf

    @property
    def extent(self) -> Extent:
        """The least impulse with its error. Without a loss, its lower bound and infinity."""
        if self.push is not None and math.isinf(self.impulse):
            return Extent(lowest=self.push.searched, highest=math.inf)
        error = 0.0 if self.push is None else self.push.error
        return Extent(lowest=self.impulse, highest=self.impulse, error=error)

    @property
    def text(self) -> str:
        """The least push, where it occurs, and the motion beyond it, as sentences."""
        changed = {
            name: value
            for name, value in self.place.numbers.items()
            if value != self.values.number(name)
        }
        at = f" (at {listed(changed)})" if changed else ""
        if self.push is None:
            return f"The orbit is not kept{at}: {self.reason}."
        return said_of(self.push, at)


def said_of(push: Push, at: str = "") -> str:
    """Return a least push and the motion beyond it, as sentences.

    Args:
        push: The push.
        at: Where it occurs, in words that begin with a blank.
    """
    if not math.isfinite(push.largest):
        return f"No push up to {push.searched:.4g} {push.unit} is lost."
    said = f"{push.largest:.4g} {push.unit} along {push.name}"
    return f"The least push is {said} at phase {push.phase:.4g}{at}. Beyond it: {push.beyond}."


def push_of(problem: Problem, orbit: Orbit, objective: MaxPush) -> tuple[Push | None, str]:
    """Return the least push of an orbit, or ``None`` and the reason why it has none.

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


def strength(search: SearchProblem, values: ParameterValues, near: Cycle | Orbit) -> Strength:
    """Compute the least push of an orbit, over all corners of the uncertain ranges.

    Args:
        search: The search, with the objective `MaxPush`.
        values: Values of the orbit.
        near: The orbit.
    """
    objective = _objective(search)
    least: Strength | None = None
    for place, orbit, reason in orbits_at_corners(search, values, near):
        push: Push | None = None
        if orbit is not None:
            push, reason = push_of(search.problem, orbit, objective)
        here = Strength(values=values, cycle=near, place=place, push=push, reason=reason)
        if least is None or here.impulse < least.impulse:
            least = here
        if push is None:
            break
    if least is None:
        raise ValueError("Argument `values` must have an orbit.")
    return least


def orbits_at_corners(
    search: SearchProblem, values: ParameterValues, near: Cycle | Orbit
) -> Iterator[tuple[ParameterValues, Orbit | None, str]]:
    """Yield values, orbit and reason of its absence, at an orbit and at all uncertain corners.

    Args:
        search: The search, with the objective `MaxPush`.
        values: Values of the orbit.
        near: The orbit.
    """
    for corner in ({}, *_objective(search).corners):
        place = values.replaced(corner)
        path = follow(search, near, values, place, attracting=True)
        if path.orbit is not None and path.arrived:
            yield place, orbit_of(path.orbit, search.problem, place), ""
        else:
            yield place, None, path.loss or "no orbit is near"


def _objective(search: SearchProblem) -> MaxPush:
    if not isinstance(search.objective, MaxPush):
        raise TypeError("Argument `search` must have the objective `MaxPush`.")
    return search.objective


def strongest(search: SearchProblem, values: ParameterValues, cycle: Cycle) -> Strength:
    """Return the orbit with the largest least push within the bounds. The optimum is local.

    Args:
        search: The search, with the objective `MaxPush`.
        values: Values of an orbit that satisfies the bounds.
        cycle: One simulated period of the orbit.
    """
    best, slack = _measured(search, values, cycle)
    if best.push is None:
        values, cycle = _most_kept(search, values, cycle)
        best, slack = _measured(search, values, cycle)
    if best.push is None or math.isinf(best.impulse):
        # There is nothing to compare. A longer scan of another orbit is no larger push.
        return best
    size = best.impulse or 1.0
    start = _in_unit_box(search, values)
    kept = {start.tobytes(): (best.impulse, slack)}

    def evaluated(z: Vector) -> tuple[float, Vector]:
        """Return the least push and the distances from the bounds, negative outside."""
        nonlocal best
        key = np.asarray(z).tobytes()
        if key not in kept:
            there = _moved(search, best, z)
            if there is None:
                return kept.setdefault(key, (0.0, np.full(len(search.bounds), -1.0)))
            found, slack = there
            kept[key] = found.extent.lowest, slack
            if found.impulse > best.impulse and np.all(slack >= 0.0):
                best = found
            search.tell(f"{len(kept)} gains tried: least push {best.extent.lowest:.4g}")
            if math.isinf(best.impulse):
                raise EnoughError
        return kept[key]

    with suppress(EnoughError):
        highest(
            lambda z: evaluated(z)[0] / size,
            start,
            (lambda z: evaluated(z)[1]) if search.bounds else None,
        )
    return best


def _in_unit_box(search: SearchProblem, values: ParameterValues) -> Vector:
    """Return the free values in units of their ranges, ``(k,)``."""
    low, high = np.array(list(search.free.values())).T
    return (np.array([values.number(name) for name in search.free]) - low) / (high - low)


def _from_unit_box(search: SearchProblem, values: ParameterValues, z: Vector) -> ParameterValues:
    """Return the values with free values in units of their ranges."""
    low, high = np.array(list(search.free.values())).T
    numbers = np.clip(low + z * (high - low), low, high)
    return values.replaced(dict(zip(search.free, numbers.tolist(), strict=True)))


def _most_kept(
    search: SearchProblem, values: ParameterValues, cycle: Cycle
) -> tuple[ParameterValues, Cycle]:
    """Return the orbit that is kept for the largest part of the way to each uncertain corner.

    The search ends at the first orbit that all corners keep, with the bounds.
    """
    first = _kept_part(search, values, cycle)
    best, farthest = (values, cycle), first
    if first >= 1.0:
        return best
    start = _in_unit_box(search, values)

    def kept(z: Vector) -> float:
        nonlocal best, farthest
        if np.array_equal(z, start):
            return first
        here, near = best
        wanted = _from_unit_box(search, here, z)
        path = follow(search, near, here, wanted, attracting=True)
        if path.orbit is None or not path.arrived or not all_kept(search, wanted, path.orbit):
            return -path.left
        part = _kept_part(search, wanted, path.orbit)
        if part > farthest:
            best, farthest = (wanted, path.orbit), part
            search.tell(f"orbits kept up to {100 * part:.0f} % of the uncertain ranges")
        if part >= 1.0:
            raise EnoughError
        return part

    with suppress(EnoughError):
        highest(kept, start, None)
    return best


def _kept_part(search: SearchProblem, values: ParameterValues, cycle: Cycle) -> float:
    """Return the smallest part of the way to an uncertain corner at which the orbit is stable."""
    paths = (
        follow(search, cycle, values, values.replaced(corner), attracting=True)
        for corner in _objective(search).corners
    )
    return min((path.end for path in paths), default=1.0)


def highest(
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


class EnoughError(Exception):
    """An orbit was found that ends the search."""


def _moved(search: SearchProblem, best: Strength, z: Vector) -> tuple[Strength, Vector] | None:
    """Return the least push at other values, and the distances from the bounds.

    Return ``None`` if the orbit is lost on the way there.
    """
    wanted = _from_unit_box(search, best.values, z)
    path = follow(search, best.cycle, best.values, wanted, attracting=True)
    if path.orbit is None or not path.arrived:
        return None
    try:
        return _measured(search, wanted, path.orbit)
    except ZenoOrbitsError:
        return None


def _measured(
    search: SearchProblem, values: ParameterValues, cycle: Cycle
) -> tuple[Strength, Vector]:
    """Return the least push of an orbit, and the distances from the bounds."""
    extents: Mapping[str, Extent] = {}
    if search.bounds:
        extents = bounded_extents(search, values, cycle)
    slack = [-excess(bound, extents[bound.name]) for bound in search.bounds]
    return strength(search, values, cycle), np.array(slack)
