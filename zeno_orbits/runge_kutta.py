"""One step of the Dormand-Prince method of order 8, in numbers or in symbols.

Source: [HairerNorsettWanner1993]_, section II.10; the error combines its estimates of order 5
and 3.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, TypeVar

from zeno_orbits.tableau import FIFTH, STAGES, STEP, THIRD, Row

State = TypeVar("State", bound=Any)
"""A NumPy vector or a CasADi column: whatever adds and scales."""

_LEAST_RATIO = 0.02
"""Part of the order-5 estimate that an error estimate keeps at least."""


def explicit_attempt(
    rate: Callable[[State], State], y: State, size: Any
) -> tuple[State, State, State]:
    """Return the state after one step and the two error estimates per unit of step size.

    Args:
        rate: The vector field, autonomous.
        y: State before the step, ``(n_y,)``.
        size: Step size, a number or a symbol.
    """
    slopes: list[State] = [rate(y)]
    for stage in STAGES:
        slopes.append(rate(y + size * _weighted(stage, slopes)))
    after = y + size * _weighted(STEP, slopes)
    slopes.append(rate(after))
    return after, _weighted(FIFTH, slopes), _weighted(THIRD, slopes)


def error_norm(fifth_squared: Any, third_squared: Any, size: Any, n_y: int, functions: Any) -> Any:
    r"""Return the error of a step in units of its tolerance.

    .. math:: \epsilon = \epsilon_5 \max\left(\frac{\epsilon_5}
        {\sqrt{\epsilon_5^2 + 0.01\,\epsilon_3^2}},\; 0.02\right)

    Without the second entry it is the usual estimate, which promises a hundred times too much
    where a damped component is about to limit the step.

    Args:
        fifth_squared: Sum of squares of the order-5 estimate per unit of step, scaled.
        third_squared: The same of order 3.
        size: Size of the step, positive.
        n_y: Number of states.
        functions: ``numpy`` or ``casadi``, for ``sqrt`` and ``fmax``.

    Returns:
        The error. NaN if a stage overflowed: such a step must be refused.
    """
    mixed = functions.sqrt(fifth_squared + 0.01 * third_squared)
    # The tiny number only keeps a flow without any error from 0 / 0.
    ratio = functions.sqrt(fifth_squared) / (mixed + 1e-300)
    largest = functions.fmax(ratio, _LEAST_RATIO)
    # A sum passes NaN on, where the larger of two may not.
    return size * functions.sqrt(fifth_squared / n_y) * (largest + 0 * mixed)


def overflow(total: Any, functions: Any) -> Any:
    """Return infinity if a sum of states is infinite, else zero: such a step must be refused.

    Args:
        total: Sum of the entries of a state.
        functions: ``numpy`` or ``casadi``, for ``fabs`` and ``fmax``.
    """
    return functions.fmax(functions.fabs(total) - sys.float_info.max, 0.0)


def _weighted(row: Row, slopes: list[Any]) -> Any:
    return sum((weight * slopes[stage] for stage, weight in row), 0.0)
