r"""The derivative of a program's motion by its start, as more unknowns and rows of the program.

The equations :math:`G(z) = 0` of a transcribed motion hold for its neighbours, too, so a direction
:math:`\delta z` in which the motion may move solves :math:`G'(z)\,\delta z = 0`: the variational
equation of the discretised motion, impacts and Zeno limit included (theory (30)).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import casadi as ca
import numpy as np

from zeno_orbits.program import Along, Array, Block, Equation, ProgramBuilder
from zeno_orbits.sensitivity import MappedRows, rows_jacobian


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """A motion in a program: which unknowns move with it and which equations it meets.

    Attributes:
        blocks: Its blocks of unknowns.
        equations: Its equations; as many as its unknowns, less the dimension of its start.
    """

    blocks: tuple[Block, ...]
    equations: tuple[Equation, ...]


def tangent(
    program: ProgramBuilder,
    motion: Motion,
    *,
    label: str,
    first: Mapping[str, Array],
) -> tuple[ca.MX, ca.MX]:
    """Declare a direction in which a motion may move, and its equations.

    Args:
        program: The program of the motion.
        motion: The motion.
        label: How the direction is called; it goes before the names of blocks and rows.
        first: Name of each block to first values of its part of the direction.

    Returns:
        All unknowns of the motion, scaled, and the direction, scaled alike, each ``(n,)``.
    """
    unknowns = ca.vertcat(*(block.symbol for block in motion.blocks))
    parts: list[ca.MX] = []
    for block in motion.blocks:
        name = f"{label}: {block.name}"
        part = program.variable(name, first[block.name], scale=block.scale)
        parts.append(ca.vec(part / ca.DM(np.repeat(block.scale[:, None], part.shape[1], axis=1))))
    direction = ca.vertcat(*parts)
    derivatives: dict[int, ca.Function] = {}
    for equation in motion.equations:
        origin = equation.origin
        if not isinstance(origin, Along):
            row = ca.jtimes(origin, unknowns, direction)
            program.equal(_named(label, equation.names), row, scale=equation.scale)
            continue
        key = hash(origin.function)
        if key not in derivatives:
            derivatives[key] = _directional(origin.function)
        moves = [ca.jtimes(part, unknowns, direction) for part in origin.parts]
        shaped = [
            ca.densify(ca.reshape(move, *part.shape))
            for move, part in zip(moves, origin.parts, strict=True)
        ]
        program.equal_along(
            _named(label, equation.names),
            derivatives[key],
            (*origin.parts, *shaped),
            scale=equation.scale,
        )
    return unknowns, direction


def first_directions(
    program: ProgramBuilder, motion: Motion, extra: ca.MX, targets: Array
) -> list[Mapping[str, Array]]:
    """Return the directions at the guess, one for every column of targets.

    Args:
        program: The program of the motion.
        motion: The motion.
        extra: Expressions whose derivatives along a direction are prescribed, ``(m,)``.
        targets: These derivatives, ``(m, n_directions)``.
    """
    from scipy.sparse.linalg import splu

    unknowns = ca.vertcat(*(block.symbol for block in motion.blocks))
    jacobian = _jacobian(motion, extra, unknowns)
    matrix = program.at_guess(jacobian).sparse().tocsc()
    right = np.zeros((matrix.shape[0], targets.shape[1]))
    right[-targets.shape[0] :] = targets
    found = np.asarray(cast("Any", splu(matrix)).solve(right), dtype=np.float64)
    return [_in_blocks(motion, found[:, k]) for k in range(targets.shape[1])]


def _in_blocks(motion: Motion, column: Array) -> dict[str, Array]:
    """Return the parts of a scaled direction, in the units and shapes of its blocks."""
    parts: dict[str, Array] = {}
    start = 0
    for block in motion.blocks:
        piece = column[start : start + block.guess.size]
        parts[block.name] = piece.reshape(block.guess.shape, order="F") * block.scale[:, None]
        start += block.guess.size
    return parts


def _jacobian(motion: Motion, extra: ca.MX, unknowns: ca.MX) -> ca.MX:
    rows: list[ca.MX | MappedRows] = []
    for equation in motion.equations:
        origin = equation.origin
        if isinstance(origin, Along):
            n = origin.parts[0].numel() // origin.function.numel_in(0)
            shape = origin.function.size_out(0)
            column = np.broadcast_to(np.asarray(equation.scale, dtype=np.float64), shape)
            scales = ca.DM(np.tile(column.flatten(order="F"), n))
            rows.append(
                MappedRows(function=origin.function, parts=origin.parts, n_columns=n, scale=scales)
            )
        else:
            scaled: ca.MX = origin / equation.scale
            rows.append(ca.vec(scaled))
    return rows_jacobian([*rows, extra], unknowns)


def _named(label: str, names: str | Sequence[str]) -> str | list[str]:
    if isinstance(names, str):
        return f"{label}: {names}"
    return [f"{label}: {name}" for name in names]


def _directional(function: ca.Function) -> ca.Function:
    """Return the derivative of a function's first output along a move of its inputs."""
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
