r"""Completed executions in many digits: truth for everything that is computed in doubles.

Gains and parameters enter exactly as the doubles that a ``ParameterValues`` holds, calibrated ones
too, and so do the constants of the model: ``0.1`` means the double next to it.

An execution is run in two lengths of numbers, with their own orders, steps and Zeno limits; what
they differ by is the error of the shorter one. The longer one is returned.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal

from flint import ctx

from tests.reference.many_digits.gauss import followed_no_further
from tests.reference.many_digits.gauss_scheme import Real
from tests.reference.many_digits.run import ExtendedRun, Trace
from tests.reference.many_digits.system import ExtendedSystem, State, relative_difference
from zeno_orbits.errors import InputError
from zeno_orbits.model import UNIT_SCALES, CharacteristicScales, ParameterValues, Problem

SPARE_DIGITS = (5, 12)
"""Digits of the two runs beyond the wanted ones."""

_FEWEST_DIGITS, _MOST_DIGITS = 10, 100


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtendedImpact:
    """An impact.

    Attributes:
        time: When [s].
        approach_rate: Gap rate just before it.
    """

    time: Decimal
    approach_rate: Decimal


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtendedPoint:
    """A state at a time.

    Attributes:
        time: When [s].
        state: Where, ``(n_x,)``.
    """

    time: Decimal
    state: tuple[Decimal, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtendedExecution:
    """A completed execution in many digits; the last ten or so are not certain.

    Attributes:
        state_names: Name of each state.
        samples: The states at the times that were asked for, rising; the later one where an
            impact gives two.
        impacts: The impacts that were resolved one by one.
        zeno_points: Where impacts accumulated.
        releases: Where the stop let go.
        error: Estimate: the largest difference between the two runs in any time, rate or state,
            relative to one plus its size.
        wall_time: What it took [s].
    """

    state_names: tuple[str, ...]
    samples: tuple[ExtendedPoint, ...]
    impacts: tuple[ExtendedImpact, ...]
    zeno_points: tuple[ExtendedPoint, ...]
    releases: tuple[ExtendedPoint, ...]
    error: float
    wall_time: float


def extended_execution(
    problem: Problem,
    values: ParameterValues,
    state: Sequence[float | Decimal],
    *,
    until: float,
    times: Sequence[float | Decimal] = (),
    digits: int = 20,
) -> ExtendedExecution:
    """Return the completed execution from an admissible state, to the wanted digits.

    Takes, for a double pendulum with a motor at 20 digits, about 0.7 s a period.

    Args:
        problem: The problem.
        values: Its numbers, taken exactly as they are.
        state: Initial state, ``(n_x,)``, taken exactly as it is; within 1e-12 of the stop it is
            moved onto it along the impulse.
        until: When to stop [s].
        times: Where the state is wanted, in ``[0, until]`` [s].
        digits: Wanted digits.

    Raises:
        InputError: If an argument is out of range or the state not admissible.
        TranslationError: If the model is not analytic.
        SimulationError: If the execution cannot be continued, or misses the wanted digits.
    """
    started = clock.perf_counter()
    check_digits(digits)
    if not 0.0 < until < math.inf:
        message = f"Argument `until` must be a positive number of seconds, but it is {until}."
        raise InputError(message)
    if not all(0 <= time <= until for time in times):
        raise InputError(f"Argument `times` must lie in [0, {until:g}], but one does not.")
    compiled = problem.compiled()
    check_state(state, compiled.n_x)
    systems = [ExtendedSystem(problem, values, digits + spare) for spare in SPARE_DIGITS]
    traces = [
        ExtendedRun(system, until=until, times=sorted(times)).follow(state) for system in systems
    ]
    shorter, trace = traces
    error = trace_difference(shorter, trace, systems[-1].own)
    if not error < 10.0**-digits:
        message = f"The execution is certain to {error:.1g} only, not to {digits} digits"
        raise followed_no_further(message, until, state)
    with ctx.workprec(systems[-1].bits):
        return ExtendedExecution(
            state_names=compiled.state_names,
            samples=points(trace.samples),
            impacts=impacts(trace),
            zeno_points=points(trace.zeno_points),
            releases=points(trace.releases),
            error=error,
            wall_time=clock.perf_counter() - started,
        )


def trace_difference(
    shorter: Trace, longer: Trace, own: CharacteristicScales = UNIT_SCALES
) -> float:
    """Return how far two runs are apart: the largest difference, relative to size and value.

    Impacts near a Zeno point that only one of them resolved do not count.

    Args:
        shorter: One run.
        longer: The other.
        own: Sizes of the problem's numbers.
    """
    differences = [0.0]
    for mine, others in zip(shorter.sequences(), longer.sequences(), strict=False):
        sizes = [own.time, own.gap_rate]
        differences += [
            relative_difference(a, b, sizes) for a, b in zip(mine, others, strict=False)
        ]
    for mine, others in zip(shorter.points(), longer.points(), strict=True):
        if len(mine) != len(others):
            return math.inf
        for (time, x), (other_time, other) in zip(mine, others, strict=True):
            sizes = [own.time, *own.states(len(x))]
            differences.append(relative_difference([time, *x], [other_time, *other], sizes))
    return max(differences)


def decimal(value: Real) -> Decimal:
    """Return a number as a decimal that holds all its digits."""
    return Decimal(value.mid().str(ctx.dps, radius=False))


def impacts(trace: Trace) -> tuple[ExtendedImpact, ...]:
    """Return the impacts of a run as decimals."""
    return tuple(
        ExtendedImpact(time=decimal(time), approach_rate=decimal(rate))
        for time, rate in trace.impacts
    )


def points(pairs: Sequence[tuple[Real, State]]) -> tuple[ExtendedPoint, ...]:
    """Return states at times as decimals."""
    return tuple(
        ExtendedPoint(time=decimal(time), state=tuple(map(decimal, state))) for time, state in pairs
    )


def check_digits(digits: int) -> None:
    """Raise ``InputError`` if the wanted digits are out of range."""
    if not _FEWEST_DIGITS <= digits <= _MOST_DIGITS:
        wanted = f"lie in [{_FEWEST_DIGITS}, {_MOST_DIGITS}]"
        raise InputError(f"Argument `digits` must {wanted}, but it is {digits}.")


def check_state(state: Sequence[float | Decimal], n_x: int) -> None:
    """Raise ``InputError`` if a state has the wrong length or is not finite."""
    if len(state) != n_x:
        raise InputError(f"Argument `state` must have {n_x} entries, but it has {len(state)}.")
    if not all(math.isfinite(value) for value in state):
        raise InputError("Argument `state` must be finite, but it holds NaN or infinity.")
