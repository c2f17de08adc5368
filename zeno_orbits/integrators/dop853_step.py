"""The tableau of the Dormand-Prince method of order 8, sparse: pairs of a stage and its weight.

Source: [HairerNorsettWanner1993]_, section II.10, with its error estimates of order 5 and 3.

One step of the Dormand-Prince method of order 8, for values or symbols.

Source: [HairerNorsettWanner1993]_, section II.10. The error combines its estimates of order 5 and
3.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, TypeVar

Row = tuple[tuple[int, float], ...]

STAGES: tuple[Row, ...] = (
    ((0, 0.05260015195876773),),
    (
        (0, 0.0197250569845379),
        (1, 0.0591751709536137),
    ),
    (
        (0, 0.02958758547680685),
        (2, 0.08876275643042054),
    ),
    (
        (0, 0.2413651341592667),
        (2, -0.8845494793282861),
        (3, 0.924834003261792),
    ),
    (
        (0, 0.037037037037037035),
        (3, 0.17082860872947386),
        (4, 0.12546768756682242),
    ),
    (
        (0, 0.037109375),
        (3, 0.17025221101954405),
        (4, 0.06021653898045596),
        (5, -0.017578125),
    ),
    (
        (0, 0.03709200011850479),
        (3, 0.17038392571223998),
        (4, 0.10726203044637328),
        (5, -0.015319437748624402),
        (6, 0.008273789163814023),
    ),
    (
        (0, 0.6241109587160757),
        (3, -3.3608926294469414),
        (4, -0.868219346841726),
        (5, 27.59209969944671),
        (6, 20.154067550477894),
        (7, -43.48988418106996),
    ),
    (
        (0, 0.47766253643826434),
        (3, -2.4881146199716677),
        (4, -0.590290826836843),
        (5, 21.230051448181193),
        (6, 15.279233632882423),
        (7, -33.28821096898486),
        (8, -0.020331201708508627),
    ),
    (
        (0, -0.9371424300859873),
        (3, 5.186372428844064),
        (4, 1.0914373489967295),
        (5, -8.149787010746927),
        (6, -18.52006565999696),
        (7, 22.739487099350505),
        (8, 2.4936055526796523),
        (9, -3.0467644718982196),
    ),
    (
        (0, 2.273310147516538),
        (3, -10.53449546673725),
        (4, -2.0008720582248625),
        (5, -17.9589318631188),
        (6, 27.94888452941996),
        (7, -2.8589982771350235),
        (8, -8.87285693353063),
        (9, 12.360567175794303),
        (10, 0.6433927460157636),
    ),
)
"""Weights of the earlier slopes in stages 1 to 11."""

STEP: Row = (
    (0, 0.054293734116568765),
    (5, 4.450312892752409),
    (6, 1.8915178993145003),
    (7, -5.801203960010585),
    (8, 0.3111643669578199),
    (9, -0.1521609496625161),
    (10, 0.20136540080403034),
    (11, 0.04471061572777259),
)
"""Weights of the slopes in the step."""

FIFTH: Row = (
    (0, 0.01312004499419488),
    (5, -1.2251564463762044),
    (6, -0.4957589496572502),
    (7, 1.6643771824549864),
    (8, -0.35032884874997366),
    (9, 0.3341791187130175),
    (10, 0.08192320648511571),
    (11, -0.022355307863886294),
)
"""Weights of the slopes, including the slope after the step, in the error of order 5."""

THIRD: Row = (
    (0, -0.18980075407240762),
    (5, 4.450312892752409),
    (6, 1.8915178993145003),
    (7, -5.801203960010585),
    (8, -0.4226823213237919),
    (9, -0.1521609496625161),
    (10, 0.20136540080403034),
    (11, 0.02265179219836082),
)
"""The same in the error of order 3."""


State = TypeVar("State", bound=Any)
"""A NumPy vector or a CasADi column, or any type with addition and scaling."""

_LEAST_RATIO = 0.02
"""Part of the order-5 estimate that an error estimate keeps at least."""


def explicit_attempt(
    rate: Callable[[State], State], y: State, size: Any
) -> tuple[State, State, State]:
    """Return the state after a step and the two error estimates per unit of step size.

    Args:
        rate: The vector field, autonomous.
        y: State before the step, ``(n_y,)``.
        size: Step size, a value or a symbol.
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

    Without the second entry it is the usual estimate, which is a hundred times too small at the
    step size where a damped component becomes unstable.

    Args:
        fifth_squared: Sum of squares of the order-5 estimate per unit of step, scaled.
        third_squared: Sum of squares of the order-3 estimate per unit of step, scaled.
        size: Size of the step, positive.
        n_y: Number of states.
        functions: ``numpy`` or ``casadi``, for ``sqrt`` and ``fmax``.

    Returns:
        The error. It is NaN if a stage overflowed. Such a step must be rejected.
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
