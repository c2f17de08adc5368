r"""A Zeno periodic orbit in many digits, with an estimate of its own error.

The release state is a fixed point of the return map :math:`P` on the release section,
:math:`h = \dot h = \lambda = 0`. From a guess :math:`x`, in section coordinates :math:`s`,

.. math:: s \leftarrow s + (1 - P')^{-1} (P(s) - s)

with a :math:`P'` measured by central differences, at the guess and, if that was rough, once more at
the point it led to. Then it is right to some ten digits, and every pass gains as many; passes in
short numbers come first, as they are the cheapest.
"""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import numpy as np
from flint import ctx

from tests.reference.many_digits.execution import (
    SPARE_DIGITS,
    ExtendedImpact,
    ExtendedPoint,
    check_digits,
    check_state,
    decimal,
    impacts,
    points,
    trace_difference,
)
from tests.reference.many_digits.gauss import followed_no_further
from tests.reference.many_digits.run import ExtendedRun, Trace
from tests.reference.many_digits.system import ExtendedSystem, State, relative_difference
from zeno_orbits.arrays import Array
from zeno_orbits.errors import InputError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import RELEASE_ROWS, Section, section_around

_SCOUT_DIGITS = 20
"""Length of the numbers in which the derivative is measured."""
_DIFFERENCE = 1e-6
"""Displacement in scaled section coordinates; its square is the error of the derivative."""
_PASSES = 20
_CORRECTIONS = 40
_CLOSED = 1
"""Digits that a closure loses against a condition on the stop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtendedOrbit:
    """A Zeno periodic orbit in many digits; times count from release. The last ten are not certain.

    Attributes:
        state_names: Name of each state.
        period: [s].
        release_state: ``(n_x,)``.
        impacts: The impacts that were resolved one by one.
        zeno_points: Where impacts accumulate.
        multipliers: Of the return map, the largest first; to about ten digits.
        closure: What one period of the longer run leaves, relative to one plus the state.
        error: Estimate for every number above but the multipliers: the largest difference
            between the two runs, or the closure times the gain of ``(1 - P')^-1``, if larger;
            relative to one plus the number.
        wall_time: What it took [s].
    """

    state_names: tuple[str, ...]
    period: Decimal
    release_state: tuple[Decimal, ...]
    impacts: tuple[ExtendedImpact, ...]
    zeno_points: tuple[ExtendedPoint, ...]
    multipliers: tuple[complex, ...]
    closure: float
    error: float
    wall_time: float


def extended_orbit(
    problem: Problem,
    values: ParameterValues,
    release_guess: Sequence[float | Decimal],
    *,
    digits: int = 25,
    horizon: float = 100.0,
) -> ExtendedOrbit:
    """Return the orbit near a release state, to the wanted digits.

    Takes about 5 s for a double pendulum with a motor at 25 digits.

    Args:
        problem: The problem.
        values: Its numbers, taken exactly as they are.
        release_guess: Release state, ``(n_x,)``, to a few digits.
        digits: Wanted digits.
        horizon: Longest time to wait for a return [s].

    Raises:
        InputError: If an argument is out of range.
        TranslationError: If the model is not analytic.
        SimulationError: If there is no return, the map does not close, or misses the digits.
    """
    started = clock.perf_counter()
    check_digits(digits)
    compiled = problem.compiled()
    check_state(release_guess, compiled.n_x)
    x = np.array([float(value) for value in release_guess])
    dynamics = problem.dynamics(values)
    size = dynamics.own.states(len(x)) + np.abs(x)
    section = section_around(dynamics, RELEASE_ROWS, x, size)
    lengths = (_SCOUT_DIGITS, *(digits + spare for spare in SPARE_DIGITS))
    maps = [
        _ReturnMap(ExtendedSystem(problem, values, length), section, horizon) for length in lengths
    ]
    scout, shorter, longer = maps
    start = scout.release(release_guess)
    jacobian = scout.jacobian(start)
    near, _, _ = scout.close(start, jacobian)
    if scout.off(near, start) > _DIFFERENCE:
        jacobian = scout.jacobian(near)
    near, other, _ = shorter.close(near, jacobian)
    release, trace, closure = longer.close(near, jacobian)
    sizes = np.linalg.svd(np.eye(len(jacobian)) - jacobian, compute_uv=False)
    gain = 1 / float(np.min(sizes, initial=np.inf))
    apart = trace_difference(other, trace, longer.system.own)
    error = max(apart, longer.off(near, release), gain * closure)
    if not error < 10.0**-digits:
        message = f"The orbit is certain to {error:.1g} only, not to {digits} digits"
        raise followed_no_further(message, *trace.releases[-1])
    multipliers = sorted(map(complex, np.linalg.eigvals(jacobian)), key=abs, reverse=True)
    with ctx.workprec(longer.system.bits):
        return ExtendedOrbit(
            state_names=compiled.state_names,
            period=decimal(trace.releases[-1][0]),
            release_state=tuple(map(decimal, release)),
            impacts=impacts(trace),
            zeno_points=points(trace.zeno_points),
            multipliers=tuple(multipliers),
            closure=closure,
            error=error,
            wall_time=clock.perf_counter() - started,
        )


class _ReturnMap:
    """The return map in numbers of one length."""

    def __init__(self, system: ExtendedSystem, section: Section, horizon: float) -> None:
        self.system = system
        self._section = section
        self._horizon = horizon

    def release(self, x: Sequence[Any]) -> State:
        """Return the release state nearest to a state, to all digits."""
        system, own = self.system, self.system.own
        weights = self._section.scale[:, None] * self._section.normal
        off = float("inf")
        with ctx.workprec(system.bits):
            here = system.numbers(x)
            for _ in range(_CORRECTIONS):
                conditions = system.conditions(here)
                sizes = np.ones(len(conditions))
                sizes[:3] = own.gap, own.gap_rate, own.multiplier
                before = off
                off = max(float(abs(c)) / s for c, s in zip(conditions, sizes, strict=True))
                if off == 0.0 or (off <= system.smallest and off >= before / 2):
                    return here
                here = [
                    (value - sum(float(w) * c for w, c in zip(row, conditions, strict=True))).mid()
                    for value, row in zip(here, weights, strict=True)
                ]
        message = "Argument `release_guess` must be near a release state"
        raise InputError(f"{message}, but the conditions stay off by {off:.3g}.")

    def image(self, x: State) -> Trace:
        """Return what happens until the next release."""
        trace = ExtendedRun(self.system, until=self._horizon, releases=1).follow(x)
        if not trace.releases:
            raise followed_no_further("No release follows", self._horizon, x)
        return trace

    def off(self, x: State, other: State) -> float:
        """Return the largest difference of two states, relative to size and value."""
        return relative_difference(x, other, self.system.sizes)

    def jacobian(self, x: State) -> Array:
        """Return the derivative of the map in section coordinates, by central differences."""
        n_section = self._section.dimension
        jacobian = np.zeros((n_section, n_section))
        for k in range(n_section):
            shift = _DIFFERENCE * np.eye(n_section)[k]
            ahead, behind = (
                self.image(self._moved(x, sign * shift)).releases[-1][1] for sign in (1.0, -1.0)
            )
            jacobian[:, k] = self._coordinates(ahead, behind) / (2 * _DIFFERENCE)
        return jacobian

    def close(self, guess: Sequence[Any], jacobian: Array) -> tuple[State, Trace, float]:
        """Return the fixed point near a guess, its period, and what that leaves."""
        left = np.eye(len(jacobian)) - jacobian
        x, before = self.release(guess), float("inf")
        for _ in range(_PASSES):
            trace = self.image(x)
            image = trace.releases[-1][1]
            closure = self.off(image, x)
            if closure <= 10.0**_CLOSED * self.system.smallest:
                return x, trace, closure
            if not closure < before:
                break
            before = closure
            x = self._moved(
                x, np.asarray(np.linalg.solve(left, self._coordinates(image, x)), float)
            )
        message = f"The return map does not close: it leaves {before:.3g}"
        raise followed_no_further(message, self._horizon, x)

    def _coordinates(self, x: State, origin: State) -> Array:
        """Return the section coordinates of a small difference of states."""
        # The difference is taken in full length; as a double it keeps 16 of its own digits.
        with ctx.workprec(self.system.bits):
            apart = np.array([float(a - b) for a, b in zip(x, origin, strict=True)])
        return self._section.components(apart)

    def _moved(self, x: State, coordinates: Array) -> State:
        shifts = self._section.scale * (self._section.tangent @ coordinates)
        with ctx.workprec(self.system.bits):
            return self.release([(a + float(b)).mid() for a, b in zip(x, shifts, strict=True)])
