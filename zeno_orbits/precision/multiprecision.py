r"""Flows and functions of a model in numbers of any length, by Taylor's method.

A flow is followed step by step; every step is a polynomial in time that holds to the last digit,
for the states and for the guard, which is carried along as one more state. The guard's root is
isolated on that polynomial and polished by Newton's method in full length.

A number here is heyoka's ``real`` (MPFR). Parameters are the doubles that they are, exactly.
Source: [JorbaZou2005]_ for the method.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.errors import InputError, SimulationError, StepSizeError
from zeno_orbits.integrators.casadi_to_heyoka import load_heyoka, translate
from zeno_orbits.precision.series_roots import first_root

Real = Any
"""A number of many digits; heyoka has no types to name."""

_GUARD_BITS = 8
_FEWEST_BITS = 64
"""Least length of a result of heyoka's numbers and Python's."""
_MOST_STEPS = 1_000_000
_POLISHES = 12
"""Newton steps for a root; from a double each doubles the digits, so a few are enough."""
_POLISHED = 1e-15
"""Largest last change of a root, as a part of the step: beyond it the root is not simple."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Arithmetic:
    """Numbers of a length.

    Attributes:
        digits: Decimal digits that a number holds at least.
    """

    digits: int

    @property
    def bits(self) -> int:
        """Length of the mantissa."""
        return max(math.ceil(self.digits * math.log2(10.0)) + _GUARD_BITS, _FEWEST_BITS)

    def number(self, value: float | str | Decimal | Real) -> Real:
        """Return a value in this length, exactly if it fits."""
        heyoka = load_heyoka()
        if isinstance(value, heyoka.real):
            return heyoka.real(value, self.bits)
        return heyoka.real(str(value) if isinstance(value, Decimal) else value, self.bits)

    def numbers(self, values: Sequence[Any]) -> list[Real]:
        """Return values in this length."""
        return [self.number(value) for value in values]


def decimal(value: Real) -> Decimal:
    """Return a number as a decimal that holds all its digits."""
    return Decimal(str(value))


class Formula:
    """A CasADi function of ``(x, p)`` in many digits at fixed ``p``."""

    def __init__(
        self, arithmetic: Arithmetic, function: ca.Function, values: Sequence[float]
    ) -> None:
        heyoka = load_heyoka()
        x, p = _variables(function.numel_in(0)), _parameters(function.numel_in(1))
        outputs = translate(function, [x, p], number=arithmetic.number)
        self._splits = [function.numel_out(k) for k in range(function.n_out())]
        self._call: Any = _nothing
        self._pars: dict[str, Any] = {}
        # heyoka compiles no function without outputs, and a problem may have no constraint.
        if outputs:
            self._call = heyoka.cfunc(outputs, vars=x, **_options(arithmetic))
            # heyoka counts parameters up to the last one that the function uses.
            used = arithmetic.numbers(values[: self._call.nparams])
            self._pars = {"pars": np.array(used)} if used else {}

    def __call__(self, x: Sequence[Real]) -> list[list[Real]]:
        """Return the entries of every output."""
        entries = iter(self._call(np.array(x), **self._pars))
        return [[next(entries) for _ in range(n)] for n in self._splits]


def _nothing(*_: Any, **__: Any) -> list[Real]:
    return []


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesStep:
    """One step of a flow.

    Attributes:
        start: Where it starts, in the flow's time from its own start.
        size: Its length.
        coefficients: Of the states, lowest power of time first, ``(n_y, order + 1)``.
    """

    start: Real
    size: Real
    coefficients: Any

    def state(self, time: Real) -> list[Real]:
        """Return the state at a time from the start of the step, by Horner's rule."""
        rows = self.coefficients
        value = rows[:, -1]
        for k in range(rows.shape[1] - 2, -1, -1):
            value = value * time + rows[:, k]
        return list(value)

    def fall(self, row: int, order: int) -> Real | None:
        """Return when a state, positive before, falls to zero in the step, if it does.

        Args:
            row: Which state.
            order: Order of the root at the start of the step that does not count.

        Raises:
            SimulationError: If the state is not positive just after such a root, or grazes zero.
        """
        series = [*self.coefficients[row, order:]]
        scaled = np.array([float(c * self.size**k) for k, c in enumerate(series)])
        largest = float(np.max(np.abs(scaled)))
        if order > 0 and not scaled[0] > 0.0:
            raise self._failure("The state leaves the admissible set from its boundary")
        try:
            root = first_root(scaled / largest) if largest > 0.0 else 0.0
        except InputError as error:
            raise self._failure("The guard grazes zero") from error
        return None if root is None else self._polished(series, root)

    def _polished(self, series: list[Real], root: float) -> Real:
        time, change = self.size * root, self.size
        for _ in range(_POLISHES):
            value, slope = series[-1], 0 * series[-1]
            for coefficient in reversed(series[:-1]):
                slope = slope * time + value
                value = value * time + coefficient
            if slope == 0:
                break
            before, change = change, value / slope
            time = time - change
            if abs(change) >= abs(before) / 2:
                break
        if not abs(change) <= _POLISHED * self.size:
            raise self._failure("The guard grazes zero")
        return time

    def _failure(self, reason: str) -> SimulationError:
        state = tuple(float(value) for value in self.coefficients[:, 0])
        return SimulationError(reason, time=float(self.start), state=state)


class SeriesFlow:
    """An autonomous flow ``y' = f(y, p)``, compiled once and followed from anywhere."""

    def __init__(
        self,
        arithmetic: Arithmetic,
        rate: Callable[[list[Any], list[Any]], list[Any]],
        n_y: int,
        values: Sequence[float],
    ) -> None:
        """Compile the flow.

        Args:
            arithmetic: Length of its numbers.
            rate: From expressions for ``y`` and ``p`` to those for ``y'``.
            n_y: Number of states.
            values: ``p``.
        """
        heyoka = load_heyoka()
        self._arithmetic = arithmetic
        y = _variables(n_y)
        self._taylor = heyoka.taylor_adaptive(
            list(zip(y, rate(y, _parameters(len(values))), strict=True)),
            np.array(arithmetic.numbers([0.0] * n_y)),
            **_options(arithmetic),
        )
        # heyoka counts parameters up to the last one that the flow uses.
        for k in range(len(self._taylor.pars)):
            self._taylor.pars[k] = arithmetic.number(values[k])
        self._succeeded = (heyoka.taylor_outcome.success, heyoka.taylor_outcome.time_limit)

    def set_parameter(self, index: int, value: Real) -> None:
        """Set an entry of ``p``."""
        self._taylor.pars[index] = value

    def steps(self, y: Sequence[Real], duration: Real) -> Iterator[SeriesStep]:
        """Yield the steps from a state until a duration is over.

        A step's coefficients are gone when the next one is asked for.

        Raises:
            StepSizeError: If the flow ceases to be finite.
            SimulationError: If it takes too many steps.
        """
        taylor = self._taylor
        time = self._arithmetic.number(0.0)
        taylor.time = time
        taylor.state[:] = np.array(y)
        for _ in range(_MOST_STEPS):
            # A polynomial flow has steps of any length; one no longer than the time so far keeps
            # the guard's root well inside the step.
            longest = min(duration - time, max(self._arithmetic.number(1.0), time))
            outcome, size = taylor.step(max_delta_t=longest, write_tc=True)
            if outcome not in self._succeeded:
                state = tuple(float(value) for value in y)
                raise StepSizeError("The flow is not finite", time=float(time), state=state)
            yield SeriesStep(start=time, size=size, coefficients=taylor.tc)
            time = time + size
            if not time < duration:
                return
        state = tuple(float(value) for value in taylor.state)
        raise SimulationError("The flow takes too many steps", time=float(time), state=state)


def flow_of(
    arithmetic: Arithmetic,
    rate: ca.Function,
    values: Sequence[float],
    carried: ca.Function | None = None,
) -> SeriesFlow:
    """Return the flow of a function ``(y, p) -> y'``.

    Args:
        arithmetic: Length of its numbers.
        rate: The function.
        values: ``p``.
        carried: ``(y, p) -> (guard, its rate)``: the guard becomes one more state.
    """
    n_y = rate.numel_in(0)

    def expressions(y: list[Any], p: list[Any]) -> list[Any]:
        rates = translate(rate, [y[:n_y], p], number=arithmetic.number)
        if carried is not None:
            rates.append(translate(carried, [y[:n_y], p], number=arithmetic.number)[1])
        return rates

    return SeriesFlow(arithmetic, expressions, n_y + (carried is not None), values)


def _options(arithmetic: Arithmetic) -> dict[str, Any]:
    # The time goes into calls of MPFR, which no optimizer of the code around them makes faster:
    # at level 0 a flow compiles in 0.2 s instead of 0.8 s, and runs a sixth longer.
    fp_type = load_heyoka().real
    return {"fp_type": fp_type, "prec": arithmetic.bits, "compact_mode": True, "opt_level": 0}


def _variables(n: int) -> list[Any]:
    heyoka = load_heyoka()
    return [heyoka.expression(f"y{k}") for k in range(n)]


def _parameters(n: int) -> list[Any]:
    heyoka = load_heyoka()
    return [heyoka.par[k] for k in range(n)]
