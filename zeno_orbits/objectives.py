"""What a search may ask of an orbit when numbers are free: one small value an objective.

Each adds its rows to a program and returns the cost to minimise. Where an orbit is asked to have
a property, the cost keeps the free numbers near where they started, so that the answer is unique.
What was reached is measured on a simulation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np

from zeno_orbits.bounds import Extent
from zeno_orbits.cycle import Cycle
from zeno_orbits.dynamics import Vector
from zeno_orbits.execution import Arc
from zeno_orbits.restraints import largest, smallest_share
from zeno_orbits.return_map import LEAST_RADIUS, keep_radius_below, radius_of
from zeno_orbits.shooting import OrbitTerms
from zeno_orbits.signals import signal
from zeno_orbits.stretches import Stretch


class Objective(Protocol):
    """What a search asks for."""

    @property
    def wish(self) -> str:
        """What is asked, as a clause for the user."""
        ...

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of what has to be measured of an orbit to tell how good it is."""
        ...

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return how good an orbit is; less is better.

        Args:
            numbers: Name to value of what is free, at the orbit.
            first: The same where the search started.
            extents: The measured quantities.
        """
        ...

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Add rows to the program and return what to minimise.

        Args:
            terms: The orbit in the unknowns of the program.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class NearestGains:
    """Gains as near as may be to given ones, each in units of its own size.

    Attributes:
        target: Name to wanted value; a free gain without one stays near its start.
    """

    target: Mapping[str, float]

    @property
    def wish(self) -> str:
        """What is asked."""
        wanted = ", ".join(f"{name} = {value:g}" for name, value in self.target.items())
        return f"gains near {wanted}" if wanted else "gains near the start"

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return half the squared distance of the gains."""
        return _distance(terms, {**terms.first, **self.target})

    @property
    def quantities(self) -> tuple[str, ...]:
        """Nothing but the free numbers tells how good it is."""
        return ()

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return half the squared distance of the free numbers."""
        del extents
        return _how_far(numbers, {**first, **self.target})


@dataclass(frozen=True, slots=True, kw_only=True)
class WantedPeriod:
    """A period.

    Attributes:
        target: [s].
    """

    target: float

    @property
    def wish(self) -> str:
        """What is asked."""
        return f"a period of {self.target:.10g} s"

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Require the period; return the squared distance of the gains from their start."""
        terms.program.equal(self.wish, self.value(terms) - self.target)
        return _distance(terms, terms.first)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Nothing but the free numbers tells how good it is."""
        return ()

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return half the squared distance of the free numbers."""
        del extents
        return _how_far(numbers, first)

    def value(self, terms: OrbitTerms) -> ca.MX:
        """Return the period [s]."""
        return terms.period

    def measured(self, cycle: Cycle) -> float:
        """Return the period of a simulated cycle [s]."""
        return cycle.period


@dataclass(frozen=True, slots=True, kw_only=True)
class WantedAmplitude:
    """An amplitude of a state: half its travel from peak to peak.

    Attributes:
        state: Its name.
        target: In the unit of the state.
    """

    state: str
    target: float

    @property
    def wish(self) -> str:
        """What is asked."""
        return f"an amplitude of {self.target:.10g} of {self.state}"

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Require the amplitude; return the squared distance of the gains from their start."""
        terms.program.equal(self.wish, self.value(terms) - self.target)
        return _distance(terms, terms.first)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Nothing but the free numbers tells how good it is."""
        return ()

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return half the squared distance of the free numbers."""
        del extents
        return _how_far(numbers, first)

    def value(self, terms: OrbitTerms) -> ca.MX:
        """Return the amplitude, in the unit of the state."""
        index = terms.state_names.index(self.state)
        return (_peak(terms, index, 1.0) - _peak(terms, index, -1.0)) / 2

    def measured(self, cycle: Cycle) -> float:
        """Return the amplitude of a simulated cycle."""
        index = cycle.state_names.index(self.state)
        return (_highest(cycle, index, 1.0) + _highest(cycle, index, -1.0)) / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Approach:
    """As near to a wanted value as may be: what leads to it, or as far as it goes.

    Attributes:
        wanted: The value.
    """

    wanted: WantedPeriod | WantedAmplitude

    @property
    def wish(self) -> str:
        """What is asked."""
        return f"{self.wanted.wish}, or near it"

    @property
    def quantities(self) -> tuple[str, ...]:
        """What the wanted value needs."""
        return self.wanted.quantities

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return what the wanted value says."""
        return self.wanted.score(numbers, first, extents)

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return half the squared relative distance from the value."""
        return ((self.wanted.value(terms) - self.wanted.target) / self.wanted.target) ** 2 / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class LeastEnergy:
    """The least electrical work in a period."""

    @property
    def wish(self) -> str:
        """What is asked."""
        return "the least electrical energy a period"

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return the electrical work of one period, in units of the guess's."""
        size = abs(float(terms.guessed(terms.electrical_work)[0, 0]))
        return terms.electrical_work / max(size, 1e-9)

    @property
    def quantities(self) -> tuple[str, ...]:
        """What tells how good it is."""
        return ("energy",)

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return the electrical work [J]."""
        del numbers, first
        return extents["energy"].highest


@dataclass(frozen=True, slots=True, kw_only=True)
class LeastPeak:
    """The least peak of a signal: its largest absolute value in a period.

    Attributes:
        signal: Its name.
    """

    signal: str

    @property
    def wish(self) -> str:
        """What is asked."""
        return f"the least peak of {self.signal}"

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return an unknown that the signal does not exceed anywhere, in units of its size."""
        size = self._size(terms)
        quantity = signal(terms.compiled, self.signal)
        return largest(terms, quantity, terms.stretches, f"peak of {self.signal}") / size

    def _size(self, terms: OrbitTerms) -> float:
        value = signal(terms.compiled, self.signal).at(terms.numbers)
        ends = [abs(value(stretch.arc.start_state)) for stretch in terms.stretches]
        return max(*ends, 1e-6)

    @property
    def quantities(self) -> tuple[str, ...]:
        """What tells how good it is."""
        return (self.signal,)

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return the peak, in the unit of the signal."""
        del numbers, first
        return extents[self.signal].largest


@dataclass(frozen=True, slots=True, kw_only=True)
class FastestContraction:
    """The fastest return after a disturbance: the least spectral radius of the return map."""

    @property
    def wish(self) -> str:
        """What is asked."""
        return "the fastest contraction"

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return an unknown that no multiplier exceeds in size (theory (31))."""
        if terms.return_slope is None:
            raise ValueError("Argument `terms` must carry the return map, but it has none.")
        first = radius_of(terms.guessed(terms.return_slope))
        radius = terms.program.variable(
            "spectral radius", 1.01 * max(first, LEAST_RADIUS), lower=LEAST_RADIUS
        )[0, 0]
        keep_radius_below(terms.program, terms.return_slope, radius)
        return radius

    @property
    def quantities(self) -> tuple[str, ...]:
        """What tells how good it is."""
        return ("spectral_radius",)

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return the spectral radius; below the least that is asked for, that."""
        del numbers, first
        return max(extents["spectral_radius"].highest, LEAST_RADIUS)


@dataclass(frozen=True, slots=True, kw_only=True)
class WidestMargin:
    """The widest margin to losing the orbit: the largest smallest share (theory (32))."""

    @property
    def wish(self) -> str:
        """What is asked."""
        return "the widest margin to losing the orbit"

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return minus the smallest share."""
        return -smallest_share(terms)

    @property
    def quantities(self) -> tuple[str, ...]:
        """What tells how good it is."""
        return ("margin",)

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return minus the smallest share."""
        del numbers, first
        return -extents["margin"].lowest


def _distance(terms: OrbitTerms, target: Mapping[str, float]) -> ca.MX:
    """Return half the squared distance of what is free from a target, each in units of its size."""
    cost = ca.MX(0)
    for name, unknown in terms.free.items():
        cost += ((unknown - target[name]) / _size_of(target[name])) ** 2 / 2
    return cost


def _how_far(numbers: Mapping[str, float], target: Mapping[str, float]) -> float:
    """Return the same of numbers."""
    return sum(
        ((value - target[name]) / _size_of(target[name])) ** 2 / 2
        for name, value in numbers.items()
    )


def _size_of(value: float) -> float:
    return max(abs(value), 1e-3)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Summit:
    """Where the guess has its extreme value: an interval of a stretch and a place in it."""

    stretch: Stretch
    interval: int
    place: float


def _peak(terms: OrbitTerms, index: int, sign: float) -> ca.MX:
    """Return the largest value of a state (smallest, if ``sign`` is -1) over the orbit.

    Inside an interval it is where the derivative of the collocation polynomial vanishes, and the
    place is an unknown; at an impact, where the rate may turn round, it is a node.
    """
    summit = max(
        (_summit(stretch, index, sign) for stretch in terms.stretches),
        key=lambda found: found[0],
    )[1]
    n = terms.scheme.n_stages
    first = summit.interval * n
    start = summit.stretch.start if first == 0 else summit.stretch.stages[:, first - 1]
    values = ca.horzcat(start[index], summit.stretch.stages[index, first : first + n])
    if summit.place in (0.0, 1.0):
        return values[0, 0] if summit.place == 0.0 else values[0, -1]
    label = "highest" if sign > 0 else "lowest"
    name = f"place where {terms.state_names[index]} is {label}"
    place = terms.program.variable(name, summit.place, lower=-0.5, upper=1.5)
    points = np.concatenate([[0.0], terms.scheme.nodes])
    height = ca.mtimes(values, _basis(points, place))
    slope = ca.jacobian(height, place)
    size = float(np.max(np.abs([_value(summit.stretch.arc, index, f) for f in (0.0, 0.5, 1.0)])))
    terms.program.equal(
        f"{terms.state_names[index]} is {label} there", slope, scale=max(size, 1e-3)
    )
    return height


def _summit(stretch: Stretch, index: int, sign: float) -> tuple[float, _Summit]:
    """Return the extreme of the guess over a stretch, and where it is."""
    fractions = np.linspace(0.0, 1.0, 400 if stretch.arc.duration > 0 else 1)
    values = [sign * _value(stretch.arc, index, float(fraction)) for fraction in fractions]
    best = int(np.argmax(values))
    at = float(fractions[best])
    interval = int(np.clip(np.searchsorted(stretch.mesh, at) - 1, 0, len(stretch.mesh) - 2))
    left, right = stretch.mesh[interval], stretch.mesh[interval + 1]
    place = 0.0 if best == 0 else 1.0 if best == len(values) - 1 else (at - left) / (right - left)
    return values[best], _Summit(stretch=stretch, interval=interval, place=float(place))


def _value(arc: Arc, index: int, fraction: float) -> float:
    state: Vector = arc.flow_state_at(fraction * arc.duration)
    return float(state[index])


def _basis(points: Vector, place: ca.MX) -> ca.MX:
    """Return the Lagrange basis of the points at a place, ``(n_points, 1)``."""
    entries: list[ca.MX] = []
    for k, point in enumerate(points):
        entry = ca.MX(1)
        for j, other in enumerate(points):
            if j != k:
                entry *= (place - float(other)) / float(point - other)
        entries.append(entry)
    return ca.vertcat(*entries)


def _highest(cycle: Cycle, index: int, sign: float) -> float:
    """Return the largest value of ``sign`` times a state over a simulated cycle."""
    return max(_highest_of(arc, index, sign) for arc in cycle.arcs)


def _highest_of(arc: Arc, index: int, sign: float) -> float:
    # SciPy's optimizers take longer to import than an amplitude to compute, and few ask for one.
    from scipy.optimize import minimize_scalar

    grid = np.linspace(0.0, 1.0, 65)
    values = [sign * _value(arc, index, float(fraction)) for fraction in grid]
    best = int(np.argmax(values))
    if best in (0, len(grid) - 1):
        return values[best]

    def depth(fraction: float) -> float:
        return -sign * _value(arc, index, fraction)

    around = (float(grid[best - 1]), float(grid[best + 1]))
    inside = minimize_scalar(depth, bounds=around, method="bounded", options={"xatol": 1e-9})
    return max(values[best], -float(inside.fun))
