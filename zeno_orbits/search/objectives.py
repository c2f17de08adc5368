"""Objectives of a search with free values: one class per objective.

An objective that prescribes a property keeps the free values near their start, each in units of its
own size, so that the solution is unique. The result is measured on a simulation.

To add an objective, add a class here and a row to `OBJECTIVES`, the words of the command line.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING, Any, ClassVar

from zeno_orbits.errors import InputError, any_number, named_numbers, not_known, number_range
from zeno_orbits.work import Checked, require_kinds

if TYPE_CHECKING:
    # The help and the error messages of the command line need the words, not CasADi.
    from zeno_orbits.model import Problem
    from zeno_orbits.search.measures import MeasuredOrbit, ProgramTerms, Slope, Trial
    from zeno_orbits.search.nearness import Nearness
    from zeno_orbits.simulation import Extent

LEAST_RADIUS = 1e-4
"""A spectral radius below this value counts as zero: a perturbation vanishes after one period."""

PERSISTENCE = "persistence"
"""Name of the smallest distance in the free values to the loss of an orbit, in units of ranges."""
PUSH = "push"
"""Name of the least push: the smallest impulse on an orbit after which the motion is lost."""


class Objective(ABC):
    """An objective of a search.

    A subclass states what differs from the nearest values: its numbers at an orbit (`costs`,
    `miss`) and its terms in a program (`aim`).
    """

    __slots__ = ()

    is_sampled: ClassVar[bool] = False
    """True if the quantity is computed from many simulations and is not part of a program."""
    is_maximized: ClassVar[bool] = False
    """True if a larger value is better."""
    is_in_program: ClassVar[bool] = True
    """True if a program has the objective."""
    needs_source: ClassVar[bool] = False
    """True if the objective needs the work of a source."""
    has_edges: ClassVar[bool] = False
    """True if the objective is the largest of several numbers, so that it has edges."""
    prescribes: ClassVar[bool] = False
    """True if the objective prescribes the value of a quantity."""
    least: ClassVar[float] = -math.inf
    """Lower bound of the score."""

    @property
    @abstractmethod
    def wish(self) -> str:
        """The objective in words for the user."""

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the quantities that the score of an orbit needs."""
        return ()

    @property
    def is_measured(self) -> bool:
        """True if the objective is a quantity of the orbit, and not a distance of values."""
        return bool(self.quantities or self.is_sampled)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals whose extremes the objective contains."""
        return ()

    @property
    def parameter_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Name to range of uncertain parameters."""
        return {}

    @property
    def trial_corners(self) -> list[dict[str, float]]:
        """The corners of the ranges at which every trial has an orbit, name to value."""
        from zeno_orbits.model import corners_of

        return corners_of(self.parameter_ranges)

    @property
    def goal(self) -> Mapping[str, float]:
        """Target of free values by name. A free value without a target stays near its start."""
        return {}

    def rank(self, extent: Extent) -> float:
        """Return the score of the first of `quantities`. A lower score is better."""
        return extent.highest

    def score(
        self,
        numbers: Mapping[str, float],
        nearness: Nearness,
        extents: Mapping[str, Extent],
    ) -> float:
        """Return the score of an orbit. A lower score is better.

        Args:
            numbers: Name to free value at the orbit.
            nearness: Measure of the distance between free values and their targets.
            extents: The measured quantities.
        """
        if self.quantities:
            return self.rank(extents[self.quantities[0]])
        return float(nearness.distance(numbers, self.goal))

    def costs(self, trial: Trial) -> tuple[Slope, ...]:
        """Return the numbers whose largest is minimized.

        Args:
            trial: The orbit.

        Raises:
            NoEventError: If an event of the objective does not occur.
        """
        return (trial.nearness(self.goal),)

    def misses(self, point: MeasuredOrbit) -> tuple[Slope, ...]:
        """Return the relative deviations of prescribed quantities, zero at the optimum.

        Args:
            point: The orbit.
        """
        del point
        return ()

    def reached(self, point: MeasuredOrbit) -> str:
        """Return the prescribed quantity of an orbit in words, empty without one.

        Args:
            point: The orbit.
        """
        del point
        return ""

    def struck(self, point: MeasuredOrbit) -> dict[str, float]:
        """Return the fastest first impact of every stop of the objective, by its name.

        Args:
            point: The orbit.
        """
        del point
        return {}

    def require_near(self, periods: Sequence[float]) -> None:
        """Refuse an objective that is far from the periods of all orbits that were seen.

        Args:
            periods: Periods of the orbits [s]. Without an orbit nothing is refused.

        Raises:
            InputError: If the objective is far from every period.
        """
        del periods

    def aim(self, terms: ProgramTerms, *, is_wish: bool) -> None:
        """Add the objective to a program, other than the distance of free values.

        Args:
            terms: The terms of the program.
            is_wish: Whether a target counts by its distance only, beside the free values.
        """
        del terms, is_wish

    def check(self, problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
        """Raise `InputError` if the objective is not valid for a problem."""
        del problem, free


@dataclass(frozen=True, slots=True, kw_only=True)
class WorstCase(Objective, Checked):
    """Base of objectives that may hold over ranges of uncertain parameters.

    Attributes:
        uncertain: Name to range of uncertain parameters. The objective is then the worst value at
            the search's own values and at all corners of the ranges. The orbit must exist at each
            of them.
    """

    uncertain: Mapping[str, tuple[float, float]] = field(
        default_factory=dict[str, tuple[float, float]]
    )

    has_edges = True

    def __post_init__(self) -> None:
        """Refuse values of a wrong kind. `check` refuses values without a meaning."""
        Checked.__post_init__(self)
        for name, ends in named_numbers("uncertain", self.uncertain).items():
            number_range("uncertain", ends, name)

    @property
    def parameter_ranges(self) -> Mapping[str, tuple[float, float]]:
        """The uncertain ranges."""
        return self.uncertain

    @property
    def corners(self) -> list[dict[str, float]]:
        """The corners of the uncertain ranges, name to value. Empty without a range."""
        from zeno_orbits.model import corners_of

        return corners_of(self.uncertain)

    @property
    def ranges(self) -> str:
        """The ranges in words, empty without a range."""
        ranges = [f"{name} = {low:g} to {high:g}" for name, (low, high) in self.uncertain.items()]
        return ", ".join(ranges)

    @property
    def in_worst_case(self) -> str:
        """The ranges as the end of a wish, empty without a range."""
        return f" in the worst case for {self.ranges}" if self.uncertain else ""

    def check(self, problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
        """Reject ranges without a meaning."""
        from zeno_orbits.model import check_uncertain

        check_uncertain(self.uncertain, problem, free)


@dataclass(frozen=True, slots=True, kw_only=True)
class NearestGains(Objective, Checked):
    """Gains as near as possible to given values, each in units of its own size.

    Attributes:
        target: Name to target value. A free gain without a target stays near its start.
    """

    target: Mapping[str, float]

    @property
    def wish(self) -> str:
        """The objective in words."""
        wanted = ", ".join(f"{name} = {value:g}" for name, value in self.target.items())
        return f"gains near {wanted}" if wanted else "gains near the start"

    @property
    def goal(self) -> Mapping[str, float]:
        """The target."""
        return self.target

    def check(self, problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
        """Reject names that are neither gains nor free, and targets that are not finite."""
        known = dict.fromkeys([*(gain.name for gain in problem.gains), *free])
        for name, value in self.target.items():
            if name not in known:
                listed = ", ".join(known) or "none"
                wanted = f"must name gains of the problem or free parameters ({listed})"
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

    prescribes = True

    def __post_init__(self) -> None:
        """Refuse a target of a wrong kind. `check` refuses values without a meaning."""
        require_kinds(self)

    @abstractmethod
    def prescribed(self, point: MeasuredOrbit) -> Slope:
        """Return the quantity of an orbit."""

    def misses(self, point: MeasuredOrbit) -> tuple[Slope, ...]:
        """Return the relative deviation from the target."""
        return (self.prescribed(point).scaled(1 / self.target, self.target),)

    def reached(self, point: MeasuredOrbit) -> str:
        """Return the quantity of an orbit in words."""
        return replace(self, target=self.prescribed(point).value).wish

    def check(self, problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
        """Reject a target that is not positive."""
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

    def prescribed(self, point: MeasuredOrbit) -> Slope:
        """Return the period of an orbit [s]."""
        return point.slopes("period")[0]

    def aim(self, terms: ProgramTerms, *, is_wish: bool) -> None:
        """Prescribe the period, or wish for it."""
        terms.reach("period", self.target, is_wish=is_wish)

    def is_far_from(self, period: float) -> bool:
        """Return True if a period or time scale [s] differs by more than a factor of 100."""
        return not 1.0 / _FARTHEST < self.target / period < _FARTHEST

    def require_near(self, periods: Sequence[float]) -> None:
        """Refuse a period that is far from the periods of all orbits that were seen.

        Args:
            periods: Periods of the orbits [s]. Without an orbit nothing is refused.

        Raises:
            InputError: If no period is within a factor of 100.
        """
        if not periods or not all(map(self.is_far_from, periods)):
            return
        seen = " to ".join(dict.fromkeys(f"{one:.4g}" for one in (min(periods), max(periods))))
        raise InputError(
            f"Argument `objective` asks for a period of {self.target:g} s, but the orbits seen "
            f"have periods of {seen} s. Give the period in seconds."
        )


_FARTHEST = 100.0
"""Ratio beyond which a prescribed period is taken for a slip of the unit."""


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

    @property
    def signals(self) -> tuple[str, ...]:
        """The state."""
        return (self.state,)

    def prescribed(self, point: MeasuredOrbit) -> Slope:
        """Return half the range of the state, in its unit."""
        return point.amplitude(self.state)

    def aim(self, terms: ProgramTerms, *, is_wish: bool) -> None:
        """Prescribe the amplitude, or wish for it."""
        terms.reach_amplitude(self.state, self.target, is_wish=is_wish)

    def check(self, problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
        """Reject an unknown state and a target that is not positive."""
        if self.state not in problem.state_names:
            wanted = f"must name a state ({', '.join(problem.state_names)})"
            raise InputError(f"Argument `objective` {wanted}, but it names `{self.state}`.")
        Target.check(self, problem, free)


@dataclass(frozen=True, slots=True, kw_only=True)
class MinEnergy(WorstCase):
    """The least work of sources and external forces in a period."""

    needs_source = True

    @property
    def wish(self) -> str:
        """The objective in words."""
        return f"the least electrical energy per period{self.in_worst_case}"

    @property
    def quantities(self) -> tuple[str, ...]:
        """The electrical work."""
        return ("energy",)

    def costs(self, trial: Trial) -> tuple[Slope, ...]:
        """Return the work of a period [J]."""
        return tuple(trial.point.slopes("energy"))

    def aim(self, terms: ProgramTerms, *, is_wish: bool) -> None:
        """Minimize the work of a period."""
        del is_wish
        terms.least_work()


@dataclass(frozen=True, slots=True, kw_only=True)
class MinPeak(WorstCase):
    """The least peak of a signal: its largest absolute value in a period.

    Attributes:
        signal: Name of the signal.
    """

    signal: str

    @property
    def wish(self) -> str:
        """The objective in words."""
        return f"the least peak of {self.signal}{self.in_worst_case}"

    @property
    def quantities(self) -> tuple[str, ...]:
        """The signal."""
        return (self.signal,)

    @property
    def signals(self) -> tuple[str, ...]:
        """The signal."""
        return (self.signal,)

    def costs(self, trial: Trial) -> tuple[Slope, ...]:
        """Return the largest absolute extremes of the signal, in its unit."""
        return trial.point.peak_costs(self.signal)

    def aim(self, terms: ProgramTerms, *, is_wish: bool) -> None:
        """Minimize the peak."""
        del is_wish
        terms.least_peak(self.signal)

    def rank(self, extent: Extent) -> float:
        """Return the peak, in the unit of the signal."""
        return extent.largest

    def check(self, problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
        """Reject an unknown signal, and ranges without a meaning."""
        from zeno_orbits.orbits import course_signal_names

        known = course_signal_names(problem.compiled_graph())
        if self.signal not in known:
            raise InputError(f"Argument `objective`: {not_known(self.signal, known)}")
        WorstCase.check(self, problem, free)


@dataclass(frozen=True, slots=True, kw_only=True)
class MinSpectralRadius(Objective):
    """The fastest return after a disturbance: the least spectral radius of the return map."""

    # A program has no multipliers.
    is_in_program = False
    least = LEAST_RADIUS

    @property
    def wish(self) -> str:
        """The objective in words."""
        return "the fastest contraction"

    @property
    def quantities(self) -> tuple[str, ...]:
        """The spectral radius."""
        return ("spectral_radius",)

    def costs(self, trial: Trial) -> tuple[Slope, ...]:
        """Return the spectral radius."""
        return (trial.differenced("spectral_radius"),)

    def rank(self, extent: Extent) -> float:
        """Return the spectral radius, or `LEAST_RADIUS` if that is larger."""
        return max(extent.highest, LEAST_RADIUS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampled(Objective):
    """Base of objectives whose quantity follows from many motions."""

    is_sampled = True

    def rank(self, extent: Extent) -> float:
        """Return minus the quantity."""
        return -extent.lowest


@dataclass(frozen=True, slots=True, kw_only=True)
class MaxMargin(Sampled):
    """The widest margin to a loss of the orbit: the largest smallest distance (theory (5.3)).

    Each free value is changed alone, in both directions, until the orbit loses its shape or becomes
    unstable. Distances are in units of the ranges, at most one, and are comparable between shapes.
    """

    is_maximized = True
    # The distance follows from many orbits.
    is_in_program = False
    least = -1.0

    @property
    def wish(self) -> str:
        """The objective in words."""
        return "the widest margin to losing the orbit"

    @property
    def quantities(self) -> tuple[str, ...]:
        """The smallest distance."""
        return (PERSISTENCE,)

    def check(self, problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
        """Reject a search without a free value."""
        del problem
        if not free:
            raise InputError(
                "Argument `objective` asks for the widest margin, which needs a free value: name "
                "its range in `vary`."
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class MaxPush(Sampled, WorstCase):
    """The largest value of the smallest impulse after which the motion leaves the orbit.

    With uncertain parameters it is the smallest one of all corners. The orbit must be stable at
    each of them.

    Attributes:
        direction: Coordinate to entry of the generalized force of the impulse. The default is one
            unit along each coordinate. Its sense has no effect.
    """

    direction: Mapping[str, float] = field(default_factory=dict[str, float])

    is_maximized = True
    # The push follows from many motions.
    is_in_program = False

    def __post_init__(self) -> None:
        """Refuse values of a wrong kind. `check` refuses values without a meaning."""
        WorstCase.__post_init__(self)
        for entry in named_numbers("direction", self.direction).values():
            any_number("direction", entry)

    @property
    def wish(self) -> str:
        """The objective in words."""
        return f"the largest push for {self.ranges}" if self.uncertain else "the largest push"

    @property
    def quantities(self) -> tuple[str, ...]:
        """The least push."""
        return (PUSH,)

    @property
    def trial_corners(self) -> list[dict[str, float]]:
        """None: the least push over the corners follows from the search's own orbit."""
        return []

    def check(self, problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
        """Reject impulses of different units, and ranges without a meaning."""
        from zeno_orbits.maps import push_units

        units = push_units(problem, self.direction, "objective")
        if len(units) > 1:
            wanted = "must name a direction, such as push:NAME=1"
            said = f"the impulses along the coordinates have the units {', '.join(sorted(units))}"
            raise InputError(f"Argument `objective` {wanted}, as {said}.")
        WorstCase.check(self, problem, free)


@dataclass(frozen=True, slots=True, kw_only=True)
class OfImpacts(Sampled, WorstCase):
    """Base of objectives about impacts.

    Attributes:
        stop: Name of the stop, or an empty text for all stops. The one stop of a machine without
            ``stops`` is named `stop`.
    """

    stop: str = ""

    quantity: ClassVar[str]
    """Word of the quantity of a stop, such as ``energy_lost``."""
    what: ClassVar[str]
    """The quantity in words."""

    @property
    def wish(self) -> str:
        """The objective in words."""
        where = f" on {self.stop}" if self.stop else ""
        return f"the least {self.what}{where} in a period{self.in_worst_case}"

    def costs(self, trial: Trial) -> tuple[Slope, ...]:
        """Return the quantity, summed over stops and sequences."""
        return (trial.point.impact_cost(self.stop, self.quantity),)

    def struck(self, point: MeasuredOrbit) -> dict[str, float]:
        """Return the fastest first impact of every stop of the objective that is struck."""
        return point.impact_speed(self.stop)

    def aim(self, terms: ProgramTerms, *, is_wish: bool) -> None:
        """Minimize the quantity."""
        del is_wish
        terms.least_of_impacts(self.stop, self.quantity)

    def check(self, problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
        """Reject an unknown stop, and ranges without a meaning."""
        from zeno_orbits.model import unknown

        stops = tuple(stop.name for stop in problem.compiled_graph().graph.stops)
        if self.stop and self.stop not in stops:
            raise InputError(unknown("objective", self.stop, stops))
        WorstCase.check(self, problem, free)


@dataclass(frozen=True, slots=True, kw_only=True)
class MinImpactLoss(OfImpacts):
    """The least kinetic energy lost in impacts per period."""

    quantity = "energy_lost"
    what = "energy lost in impacts"


@dataclass(frozen=True, slots=True, kw_only=True)
class MinBounceTime(OfImpacts):
    """The least time from first impacts to their Zeno points per period."""

    quantity = "bounce_time"
    what = "bounce time"


class Operand(Enum):
    """Operand of an objective on the command line."""

    NOTHING = ""
    NUMBER = "a positive number"
    SIGNAL = "the name of a signal"
    NUMBERS = "names with numbers, or nothing"
    DIRECTION = "coordinates with numbers, or nothing"
    STOP = "the name of a stop, or nothing"


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectiveWord:
    """An objective on the command line.

    Attributes:
        usage: The words as typed.
        meaning: Explanation for the help, if the name is not enough.
        operand: Kind of the operand.
        objective: Function of the problem and the operand that returns the objective.
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
    "energy": ObjectiveWord(
        usage="energy",
        meaning=" (least electrical energy per period; the worst case with --uncertain)",
        objective=lambda _, __: MinEnergy(),
    ),
    "peak": ObjectiveWord(
        usage="peak=SIGNAL",
        meaning=" (least peak of current, voltage or a state, likewise)",
        operand=Operand.SIGNAL,
        objective=lambda _, signal: MinPeak(signal=signal),
    ),
    "contraction": ObjectiveWord(
        usage="contraction",
        meaning=" (least spectral radius)",
        objective=lambda _, __: MinSpectralRadius(),
    ),
    "margin": ObjectiveWord(
        usage="margin",
        meaning=" (widest range of the free values before the orbit is lost)",
        objective=lambda _, __: MaxMargin(),
    ),
    "push": ObjectiveWord(
        usage="push",
        meaning=" or push:NAME=VALUE,... (largest least push, along a direction)",
        operand=Operand.DIRECTION,
        objective=lambda _, direction: MaxPush(direction=direction),
    ),
    "robustness": ObjectiveWord(
        usage="robustness",
        meaning=" (the same over all corners of the ranges of --uncertain)",
        operand=Operand.DIRECTION,
        objective=lambda _, direction: MaxPush(direction=direction),
    ),
    "impacts": ObjectiveWord(
        usage="impacts",
        meaning=" or impacts=STOP (least energy lost in impacts per period, on one stop, likewise)",
        operand=Operand.STOP,
        objective=lambda _, stop: MinImpactLoss(stop=stop),
    ),
    "bounce": ObjectiveWord(
        usage="bounce",
        meaning=" or bounce=STOP (least time from first impacts to Zeno points, likewise)",
        operand=Operand.STOP,
        objective=lambda _, stop: MinBounceTime(stop=stop),
    ),
}
"""The words of ``--objective``, in the order of its help."""


def objective_help() -> str:
    """Return the words of ``--objective`` with their meanings, for its help."""
    *most, last = (word.usage + word.meaning for word in OBJECTIVES.values())
    return f"{', '.join(most)}, or {last}"
