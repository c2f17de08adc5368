"""One step of the Dormand-Prince method of order 8, in numbers or in symbols.

The tableau is the public one of ``scipy.integrate.DOP853``. Source: [HairerNorsettWanner1993]_,
section II.10; the error combines its estimates of order 5 and 3.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from scipy.integrate import DOP853

State = TypeVar("State", bound=Any)
"""A NumPy vector or a CasADi column: whatever adds and scales."""

N_STAGES: int = DOP853.n_stages
_A = DOP853.A
_B = DOP853.B
_E5 = DOP853.E5
_E3 = DOP853.E3


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
    for stage in range(1, N_STAGES):
        slopes.append(rate(y + size * _weighted(_A[stage, :stage], slopes)))
    after = y + size * _weighted(_B, slopes)
    slopes.append(rate(after))
    return after, _weighted(_E5, slopes), _weighted(_E3, slopes)


def _weighted(weights: np.ndarray[Any, Any], slopes: list[Any]) -> Any:
    return sum(
        (float(weight) * slope for weight, slope in zip(weights, slopes, strict=True) if weight),
        0.0,
    )
