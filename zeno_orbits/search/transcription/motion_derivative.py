r"""The derivative of a program's motion with respect to its start (theory (5.1)).

The equations :math:`G(z) = 0` of a transcribed motion also hold for neighbouring motions. A
direction :math:`\delta z` of the motion therefore solves :math:`G'(z)\,\delta z = 0`. This is the
variational equation of the discretised motion, including impacts and the Zeno limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Array
from zeno_orbits.search.transcription.jacobian import MappedRows, rows_jacobian
from zeno_orbits.search.transcription.program import (
    Along,
    Block,
    Derived,
    Equation,
    ProgramBuilder,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramMotion:
    """A motion in a program: its unknowns and its equations.

    Attributes:
        blocks: Blocks of unknowns of the motion.
        equations: Equations of the motion. Their number is the number of unknowns minus the
            dimension of the start.
    """

    blocks: tuple[Block, ...]
    equations: tuple[Equation, ...]


def derivative_along(
    program: ProgramBuilder, motion: ProgramMotion, start: ca.MX, targets: Array, end: ca.MX
) -> Derived:
    r"""Return the derivative of a motion's end with respect to its start, and its own derivative.

    .. math:: A = C\,\delta z, \quad \begin{pmatrix} G' \\ s' \end{pmatrix} \delta z
        = \begin{pmatrix} 0 \\ E \end{pmatrix}, \qquad
        \frac{dA_{jk}}{du} = \frac{\partial}{\partial u} \Bigl( c_j\,\delta z_k
        - w_j^\top \begin{pmatrix} G' \\ s' \end{pmatrix} \delta z_k \Bigr), \quad
        w_j^\top \begin{pmatrix} G' \\ s' \end{pmatrix} = c_j

    Args:
        program: The program of the motion.
        motion: The motion.
        start: Expressions :math:`s` whose derivatives along a direction are prescribed, ``(m,)``.
        targets: These derivatives :math:`E`, ``(m, n_directions)``.
        end: Expressions with derivatives :math:`C`, ``(n_end,)``.

    Returns:
        :math:`A`, ``(n_end, n_directions)``, and its derivative with respect to all unknowns
        declared so far.
    """
    moving = ca.vertcat(*(block.symbol for block in motion.blocks))
    unknowns = ca.vertcat(*(block.symbol for block in program.blocks))
    matrix = _jacobian(motion, start, moving)
    by_end = ca.jacobian(end, moving)
    right = ca.DM(matrix.shape[0], targets.shape[1])
    right[-targets.shape[0] :, :] = targets
    directions = ca.solve(matrix, ca.MX(right), _LINEAR)
    weights = ca.solve(matrix.T, ca.densify(by_end.T), _LINEAR)
    bend = _bend(motion, start, end, moving, unknowns)
    rows = [
        bend(unknowns, directions[:, k], weights[:, j], ca.DM.eye(end.numel())[:, j]).T
        for k in range(targets.shape[1])
        for j in range(end.numel())
    ]
    return Derived(value=ca.mtimes(by_end, directions), slope=ca.vertcat(*rows))


_LINEAR = "qr"
"""CasADi's sparse QR. Its sparse LU without pivoting had residuals of 1e-7 and more."""


def _bend(
    motion: ProgramMotion, start: ca.MX, end: ca.MX, moving: ca.MX, unknowns: ca.MX
) -> ca.Function:
    """Return the gradient of ``c end' v - w (G', start') v`` with respect to the unknowns u.

    The gradient is a function of u, v, w and c.
    """
    along = ca.MX.sym("v", moving.numel())
    weights = ca.MX.sym("w", moving.numel())
    chosen = ca.MX.sym("c", end.numel())
    total = ca.dot(chosen, ca.jtimes(end, moving, along))
    derivatives: dict[int, ca.Function] = {}
    place = 0
    for equation in motion.equations:
        rows = _moved(equation, moving, along, derivatives)
        total -= ca.dot(weights[place : place + rows.numel()], rows)
        place += rows.numel()
    total -= ca.dot(weights[place:], ca.jtimes(start, moving, along))
    inputs = [unknowns, along, weights, chosen]
    return ca.Function("bend", inputs, [ca.densify(ca.gradient(total, unknowns))])


def _moved(
    equation: Equation, moving: ca.MX, along: ca.MX, derivatives: dict[int, ca.Function]
) -> ca.MX:
    """Return the derivative of scaled rows along a direction, ``(n,)``."""
    origin = equation.origin
    if not isinstance(origin, Along):
        scaled: ca.MX = origin / equation.scale
        return ca.vec(ca.jtimes(ca.vec(scaled), moving, along))
    key = hash(origin.function)
    if key not in derivatives:
        derivatives[key] = _directional(origin.function)
    n = origin.parts[0].numel() // origin.function.numel_in(0)
    moves = [
        ca.densify(ca.reshape(ca.jtimes(part, moving, along), *part.shape)) for part in origin.parts
    ]
    rows = derivatives[key].map(n)(*origin.parts, *moves)
    return ca.vec(rows) / _scales(origin, equation.scale, n)


def _jacobian(motion: ProgramMotion, extra: ca.MX, unknowns: ca.MX) -> ca.MX:
    rows: list[ca.MX | MappedRows] = []
    for equation in motion.equations:
        origin = equation.origin
        if isinstance(origin, Along):
            n = origin.parts[0].numel() // origin.function.numel_in(0)
            scales = _scales(origin, equation.scale, n)
            rows.append(
                MappedRows(function=origin.function, parts=origin.parts, n_columns=n, scale=scales)
            )
        else:
            scaled: ca.MX = origin / equation.scale
            rows.append(ca.vec(scaled))
    return rows_jacobian([*rows, extra], unknowns)


def _scales(origin: Along, scale: Any, n: int) -> ca.DM:
    column = np.broadcast_to(np.asarray(scale, dtype=np.float64), origin.function.size_out(0))
    return ca.DM(np.tile(column.flatten(order="F"), n))


def _directional(function: ca.Function) -> ca.Function:
    """Return the derivative of a function's first output along a direction of its inputs."""
    parts = [ca.SX.sym(f"part{k}", *function.size_in(k)) for k in range(function.n_in())]
    moves = [ca.SX.sym(f"move{k}", *function.size_in(k)) for k in range(function.n_in())]
    rows = function.call(parts)[0]
    moved = ca.jtimes(rows, ca.veccat(*parts), ca.veccat(*moves))
    return ca.Function(
        f"{function.name()}_along",
        [*parts, *moves],
        [ca.reshape(moved, *rows.shape)],
        {"cse": True},
    )
