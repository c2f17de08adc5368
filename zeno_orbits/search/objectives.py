"""Objectives of a search with free numbers: one class an objective.

Each adds its rows to a program and returns the cost to minimise. One that asks for a property keeps
the free numbers near where they started, each in units of its own size, so that the answer is
unique. What was reached is measured on a simulation.

Another objective is one class here and one row of `OBJECTIVES`, the words of the command line.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

from zeno_orbits.errors import InputError

if TYPE_CHECKING:
    # Help and misuse of the command line need the words, not CasADi.
    import casadi as ca

    from zeno_orbits.model import Problem
    from zeno_orbits.orbits import Cycle
    from zeno_orbits.search.transcription.nearness import Nearness
    from zeno_orbits.search.transcription.transcribe import OrbitTerms
    from zeno_orbits.simulation import Extent

LEAST_RADIUS = 1e-4
"""A spectral radius below this is as good as zero: a perturbation is gone after one period."""


class Objective(ABC):
    """An objective of a search."""

    __slots__ = ()

    @property
    @abstractmethod
    def wish(self) -> str:
        """The objective as a clause for the user."""

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of what has to be measured of an orbit to score it."""
        return ()

    @property
    def least(self) -> float:
        """The least score that there can be."""
        return -math.inf

    @abstractmethod
    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Add rows to the program of an orbit and return the cost to minimise."""

    @property
    def goal(self) -> Mapping[str, float]:
        """The free numbers that are wanted; what is not named stays near where it started."""
        return {}

    def rank(self, extent: Extent) -> float:
        """Return the score of the first of `quantities`; less is better."""
        return extent.highest

    def score(
        self,
        numbers: Mapping[str, float],
        nearness: Nearness,
        extents: Mapping[str, Extent],
    ) -> float:
        """Return the score of an orbit; less is better.

        Args:
            numbers: Name to value of what is free, at the orbit.
            nearness: How their distance from what is wanted is measured.
            extents: The measured quantities.
        """
        if self.quantities:
            return self.rank(extents[self.quantities[0]])
        return float(nearness.distance(numbers, self.goal))

    def check(self, problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
        """Raise `InputError` if the objective makes no sense for a problem."""
        del problem, free


@dataclass(frozen=True, slots=True, kw_only=True)
class NearestGains(Objective):
    """Gains as near as possible to given ones, each in units of its own size.

    Attributes:
        target: Name to value; a free gain without one stays near its start.
    """

    target: Mapping[str, float]

    @property
    def wish(self) -> str:
        """The objective in words."""
        wanted = ", ".join(f"{name} = {value:g}" for name, value in self.target.items())
        return f"gains near {wanted}" if wanted else "gains near the start"

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return half the squared distance of the free numbers from the target."""
        return terms.nearness.distance(terms.free, self.goal)

    @property
    def goal(self) -> Mapping[str, float]:
        """The target."""
        return self.target

    def check(self, problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
        """Refuse names that are neither gains nor free, and targets that are not finite."""
        known = dict.fromkeys([*(gain.name for gain in problem.gains), *free])
        for name, value in self.target.items():
            if name not in known:
                listed = ", ".join(known) or "none"
                wanted = f"must name gains of the problem or what is free ({listed})"
                raise InputError(f"Argument `objective` {wanted}, but it names `{name}`.")
            if not math.isfinite(value):
                message = f"must be finite for `{name}`, but it is {value}"
                raise InputError(f"Argument `objective` {message}.")


@dataclass(frozen=True, slots=True, kw_only=True)
class Target(Objective):
    """An objective that prescribes the value of a quantity.

    Attributes:
        target: The value, positive, in the unit of the quantity.
    """

    target: float

    @abstractmethod
    def value(self, terms: OrbitTerms) -> ca.MX:
        """Return the quantity in the unknowns of the program."""

    @abstractmethod
    def measured(self, cycle: Cycle) -> float:
        """Return the quantity of a simulated cycle."""

    def miss(self, cycle: Cycle) -> float:
        """Return the distance of a simulated cycle from the target, relative."""
        return abs(self.measured(cycle) - self.target) / self.target

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Require the value; return the squared distance of the free numbers from their start."""
        terms.program.equal(self.wish, self.value(terms) - self.target)
        return terms.nearness.distance(terms.free, self.goal)

    def check(self, problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
        """Refuse a target that is not positive."""
        del problem, free
        if not 0.0 < self.target < math.inf:
            message = f"must have a positive target, but it is {self.target:g}"
            raise InputError(f"Argument `objective` {message}.")


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetPeriod(Target):
    """A prescribed period [s]."""

    @property
    def wish(self) -> str:
        """The objective in words."""
        return f"a period of {self.target:.10g} s"

    def value(self, terms: OrbitTerms) -> ca.MX:
        """Return the period [s]."""
        return terms.period

    def measured(self, cycle: Cycle) -> float:
        """Return the period of a simulated cycle [s]."""
        return cycle.period


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetAmplitude(Target):
    """A prescribed amplitude of a state: half its range over a period.

    Attributes:
        state: Name of the state.
    """

    state: str

    @property
    def wish(self) -> str:
        """The objective in words."""
        return f"an amplitude of {self.target:.10g} of {self.state}"

    def value(self, terms: OrbitTerms) -> ca.MX:
        """Return the amplitude, in the unit of the state."""
        from zeno_orbits.search.transcription.constraints import extreme

        index = terms.state_names.index(self.state)
        return (extreme(terms, index, 1.0) - extreme(terms, index, -1.0)) / 2

    def measured(self, cycle: Cycle) -> float:
        """Return the amplitude of a simulated cycle."""
        from zeno_orbits.simulation import extent_of

        index = cycle.state_names.index(self.state)
        extent = extent_of(lambda x: float(x[index]), cycle.arcs)
        return (extent.highest - extent.lowest) / 2

    def check(self, problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
        """Refuse an unknown state and a target that is not positive."""
        if self.state not in problem.state_names:
            wanted = f"must name a state ({', '.join(problem.state_names)})"
            raise InputError(f"Argument `objective` {wanted}, but it names `{self.state}`.")
        Target.check(self, problem, free)


@dataclass(frozen=True, slots=True, kw_only=True)
class TowardTarget(Objective):
    """An orbit as near as possible to a target: the steps on the way to it.

    Attributes:
        target: The target.
    """

    target: Target

    @property
    def wish(self) -> str:
        """The objective in words."""
        return f"{self.target.wish}, or near it"

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return half the squared relative distance from the target."""
        wanted = self.target.target
        return ((self.target.value(terms) - wanted) / wanted) ** 2 / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class LeastEnergy(Objective):
    """The least electrical work in a period."""

    @property
    def wish(self) -> str:
        """The objective in words."""
        return "the least electrical energy a period"

    @property
    def quantities(self) -> tuple[str, ...]:
        """The electrical work."""
        return ("energy",)

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return the electrical work of one period, in units of the guess's."""
        size = abs(float(terms.guessed(terms.electrical_work)[0, 0]))
        return terms.electrical_work / (size or 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class LeastPeak(Objective):
    """The least peak of a signal: its largest absolute value in a period.

    Attributes:
        signal: Name of the signal.
    """

    signal: str

    @property
    def wish(self) -> str:
        """The objective in words."""
        return f"the least peak of {self.signal}"

    @property
    def quantities(self) -> tuple[str, ...]:
        """The signal."""
        return (self.signal,)

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return an unknown that the signal does not exceed anywhere, in units of its size."""
        from zeno_orbits.search.transcription.constraints import largest
        from zeno_orbits.simulation import signal

        quantity = signal(terms.compiled, self.signal)
        peak = largest(terms, quantity, terms.arcs, f"peak of {self.signal}")
        return peak / (float(terms.guessed(peak)[0, 0]) or 1.0)

    def rank(self, extent: Extent) -> float:
        """Return the peak, in the unit of the signal."""
        return extent.largest

    def check(self, problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
        """Refuse an unknown signal."""
        from zeno_orbits.verification import require_quantities

        del free
        require_quantities([self.signal], problem, "objective")


@dataclass(frozen=True, slots=True, kw_only=True)
class FastestContraction(Objective):
    """The fastest return after a disturbance: the least spectral radius of the return map."""

    @property
    def wish(self) -> str:
        """The objective in words."""
        return "the fastest contraction"

    @property
    def quantities(self) -> tuple[str, ...]:
        """The spectral radius."""
        return ("spectral_radius",)

    @property
    def least(self) -> float:
        """As good as zero."""
        return LEAST_RADIUS

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return an unknown that no multiplier exceeds in size (theory (31))."""
        from zeno_orbits.search.transcription.spectral_radius import keep_radius_below, radius_of

        if terms.return_slope is None:
            raise ValueError("Argument `terms` must carry the return map, but it has none.")
        first = radius_of(terms.guessed(terms.return_slope))
        radius = terms.program.variable(
            "spectral radius", 1.01 * max(first, LEAST_RADIUS), lower=LEAST_RADIUS
        )[0, 0]
        keep_radius_below(terms.program, terms.return_slope, radius)
        return radius

    def rank(self, extent: Extent) -> float:
        """Return the spectral radius, or `LEAST_RADIUS` if that is larger."""
        return max(extent.highest, LEAST_RADIUS)


@dataclass(frozen=True, slots=True, kw_only=True)
class WidestMargin(Objective):
    """The widest margin to losing the orbit: the largest smallest share (theory (32))."""

    @property
    def wish(self) -> str:
        """The objective in words."""
        return "the widest margin to losing the orbit"

    @property
    def quantities(self) -> tuple[str, ...]:
        """The margin."""
        return ("margin",)

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return minus the smallest share."""
        from zeno_orbits.search.transcription.constraints import smallest_share

        return -smallest_share(terms)

    def rank(self, extent: Extent) -> float:
        """Return minus the smallest share."""
        return -extent.lowest


class Operand(Enum):
    """Operand of an objective on the command line."""

    NOTHING = ""
    NUMBER = "a positive number"
    SIGNAL = "the name of a signal"
    NUMBERS = "names with numbers, or nothing"


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectiveWord:
    """An objective on the command line.

    Attributes:
        usage: The words as typed.
        meaning: Explanation for the help, if the name is not enough.
        operand: Kind of the operand.
        objective: From the problem and the operand to the objective.
    """

    usage: str
    meaning: str = ""
    operand: Operand = Operand.NOTHING
    objective: Callable[[Problem, Any], Objective]


OBJECTIVES: Mapping[str, ObjectiveWord] = {
    "nearest": ObjectiveWord(
        usage="nearest",
        meaning=" (to the problem's gains), nearest:NAME=VALUE,...",
        operand=Operand.NUMBERS,
        objective=lambda _, target: NearestGains(target=target),
    ),
    "period": ObjectiveWord(
        usage="period=SECONDS",
        operand=Operand.NUMBER,
        objective=lambda _, target: TargetPeriod(target=target),
    ),
    "amplitude": ObjectiveWord(
        usage="amplitude=VALUE",
        operand=Operand.NUMBER,
        objective=lambda problem, target: TargetAmplitude(
            state=problem.amplitude_of, target=target
        ),
    ),
    "energy": ObjectiveWord(usage="energy", objective=lambda _, __: LeastEnergy()),
    "peak": ObjectiveWord(
        usage="peak=SIGNAL",
        meaning=" (least peak of current, voltage or a state)",
        operand=Operand.SIGNAL,
        objective=lambda _, signal: LeastPeak(signal=signal),
    ),
    "contraction": ObjectiveWord(
        usage="contraction",
        meaning=" (least spectral radius)",
        objective=lambda _, __: FastestContraction(),
    ),
    "margin": ObjectiveWord(
        usage="margin",
        meaning=" (widest before the orbit is lost)",
        objective=lambda _, __: WidestMargin(),
    ),
}
"""The words of ``--objective``, in the order of its help."""


def objective_help() -> str:
    """Return the words of ``--objective`` with their meanings, for its help."""
    *most, last = (word.usage + word.meaning for word in OBJECTIVES.values())
    return f"{', '.join(most)}, or {last}"
