r"""One step of a Rosenbrock method of order 5 in symbols: linear solves, and no iteration.

For an autonomous flow, with :math:`W = I - h \gamma\,f'(y)`,

.. math:: W u_i = \gamma h\,f\Bigl(y + \sum_{j<i} a_{ij} u_j\Bigr) + \gamma \sum_{j<i} c_{ij} u_j,
    \qquad y_1 = y + \sum_i b_i u_i

and the last :math:`u_i` is the difference from a solution of order 4. The method is L-stable, so a
fast decay costs nothing, and a step is one evaluation of one expression, which is what many
trajectories in lockstep need. Source: [Steinebach2023]_, Rodas5P; [HairerWanner1996]_, IV.7.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from zeno_orbits.integrators.triangular import TriangularFactors, factorized_matrix

_GAMMA = 0.21193756319429014

_STAGE = (
    (),
    (3.0,),
    (2.849394379747939, 0.45842242204463923),
    (-6.954028509809101, 2.489845061869568, -10.358996098473584),
    (2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641),
    (
        -7.502846399306121,
        2.561846144803919,
        -11.627539656261098,
        -0.18268767659942256,
        0.030198172008377946,
    ),
)
"""Weights `a` of the earlier stages; each later row is the last one and a 1 more."""

_COUPLING = (
    (),
    (-14.155112264123755,),
    (-17.97296035885952, -2.859693295451294),
    (147.12150275711716, -1.41221402718213, 71.68940251302358),
    (165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306),
    (
        24.854864614690072,
        -3.0009227002832186,
        47.4931110020768,
        5.5814197821558125,
        -0.6610691825249471,
    ),
    (
        30.91273214028599,
        -3.1208243349937974,
        77.79954646070892,
        34.28646028294783,
        -19.097331116725623,
        -28.087943162872662,
    ),
    (
        37.80277123390563,
        -3.2571969029072276,
        112.26918849496327,
        66.9347231244047,
        -40.06618937091002,
        -54.66780262877968,
        -9.48861652309627,
    ),
)
"""Weights `c` of the earlier stages in the right-hand sides."""


def rosenbrock_step(
    rate: Callable[[ca.SX], ca.SX], jacobian: ca.SX, y: ca.SX, size: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Return the state after one step, and its difference from a solution of order 4.

    Args:
        rate: The vector field, autonomous.
        jacobian: Its derivative at ``y``, ``(n_y, n_y)``.
        y: State before the step, ``(n_y,)``.
        size: Step size; at zero the state stays.
    """
    n, matrix = y.numel(), ca.SX.eye(y.numel()) - _GAMMA * size * jacobian
    entries = [[matrix[i, j] for j in range(n)] for i in range(n)]
    # At small steps the matrix is near one; a zero pivot gives NaN, and the step is refused.
    factors = factorized_matrix(TriangularFactors(real=entries, imaginary=None))
    stages: list[ca.SX] = []
    inside = y
    for k, coupling in enumerate(_COUPLING):
        if k < len(_STAGE):
            inside = y
            for weight, stage in zip(_STAGE[k], stages, strict=True):
                inside += weight * stage
        else:
            inside += stages[-1]
        right = _GAMMA * size * rate(inside)
        for weight, stage in zip(coupling, stages, strict=True):
            right += _GAMMA * weight * stage
        stages.append(factors.solve(right, None)[0])
    return inside + stages[-1], stages[-1]
