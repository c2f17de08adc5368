"""Nonlinear programs whose unknowns and rows have names.

A block is declared together with its guess, bounds and scale, so they are always consistent. A
failed solve is reported with the names of the problem.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Array
from zeno_orbits.search.transcription.jacobian import MappedRows, rows_jacobian


@dataclass(frozen=True, slots=True, kw_only=True)
class NonlinearProgram:
    """A nonlinear program in scaled unknowns.

    Attributes:
        unknowns: All unknowns, each divided by its scale, ``(n,)``.
        objective: Expression to minimise.
        rows: Scaled constraint expressions, ``(m,)``.
        jacobian: Sparse derivative of the rows, ``(m, n)``.
        reports: Name to an expression that is evaluated at the solution.
        names: Name to first index and shape of each block of unknowns.
        row_names: Name of each row.
        scales: Scale of each unknown.
        guess: First iterate, scaled.
        lower: Lower bounds of the unknowns, scaled.
        upper: Upper bounds, scaled.
        row_lower: Lower bounds of the rows.
        row_upper: Upper bounds of the rows.
    """

    unknowns: ca.MX
    objective: ca.MX
    rows: ca.MX
    jacobian: ca.MX
    reports: Mapping[str, ca.MX]
    names: Mapping[str, tuple[int, tuple[int, int]]]
    row_names: tuple[str, ...]
    scales: Array
    guess: Array
    lower: Array
    upper: Array
    row_lower: Array
    row_upper: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Along:
    """The first output of a function at many columns of arguments.

    Attributes:
        function: Function of a column, with one input per part. The first output is its rows.
        parts: The parts of all columns, side by side.
    """

    function: ca.Function
    parts: tuple[ca.MX, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Equation:
    """Rows that have to vanish, as declared.

    Attributes:
        names: One name for all columns, or one name per column.
        origin: The expression that vanishes.
        scale: Unit of the expression.
    """

    names: str | Sequence[str]
    origin: ca.MX | Along
    scale: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A block of unknowns, as declared.

    Attributes:
        name: Name of the block.
        symbol: Scaled unknowns, as one column.
        scale: Scale of each row.
        guess: First values, in the block's own units and shape.
    """

    name: str
    symbol: ca.MX
    scale: Array
    guess: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Derived:
    """A quantity that follows from the unknowns by linear equations, with its derivative.

    Attributes:
        value: The quantity, ``(n, m)``.
        slope: Derivative of the stacked columns with respect to the unknowns that were declared
            before the quantity, ``(n m, k)``.
    """

    value: ca.MX
    slope: ca.MX


class ProgramBuilder:
    """Collects unknowns and rows. It is the only mutable class of this module."""

    def __init__(self) -> None:
        self._blocks: list[Block] = []
        self._names: dict[str, tuple[int, tuple[int, int]]] = {}
        self._scales: list[Array] = []
        self._guess: list[Array] = []
        self._bounds: list[tuple[Array, Array]] = []
        self._rows: list[ca.MX] = []
        self._origins: list[ca.MX | MappedRows] = []
        self._row_names: list[str] = []
        self._row_bounds: list[tuple[float, float]] = []
        self._equations: list[Equation] = []
        self._reports: dict[str, ca.MX] = {}
        self._derived: list[tuple[ca.MX, Derived]] = []
        self._size = 0

    def variable(
        self,
        name: str,
        guess: Array | float,
        *,
        scale: Array | float = 1.0,
        lower: Array | float = -math.inf,
        upper: Array | float = math.inf,
    ) -> ca.MX:
        """Declare a block of unknowns and return it, in its own units and the shape of its guess.

        Args:
            name: Name of the block.
            guess: First values, as a scalar, a vector or a matrix.
            scale: Typical size, as a scalar or one value per row.
            lower: Lower bound, like ``scale``.
            upper: Upper bound, like ``scale``.
        """
        values = np.atleast_1d(np.asarray(guess, dtype=np.float64))
        matrix = values.reshape(values.shape[0], -1)
        if name in self._names:
            raise ValueError(f"Argument `name` must be new, but `{name}` is a block already.")

        def spread(number: Array | float) -> Array:
            column = np.broadcast_to(np.asarray(number, dtype=np.float64), values.shape[:1])
            return np.repeat(column[:, None], matrix.shape[1], axis=1)

        sizes = spread(scale)
        symbol = ca.MX.sym(name, *matrix.shape)
        self._blocks.append(
            Block(name=name, symbol=ca.vec(symbol), scale=sizes[:, 0], guess=matrix)
        )
        self._names[name] = (self._size, (matrix.shape[0], matrix.shape[1]))
        self._size += matrix.size
        for store, block in ((self._scales, sizes), (self._guess, matrix / sizes)):
            store.append(block.flatten(order="F"))
        self._bounds.append(
            (
                (spread(lower) / sizes).flatten(order="F"),
                (spread(upper) / sizes).flatten(order="F"),
            )
        )
        return symbol * ca.DM(sizes)

    def equal(self, names: str | Sequence[str], expression: ca.MX, *, scale: Any = 1.0) -> None:
        """Require an expression to vanish, in units of its scale."""
        self._constrain(names, expression, scale, (0.0, 0.0))
        if expression.numel():
            self._equations.append(Equation(names=names, origin=expression, scale=scale))

    def at_least_zero(
        self, names: str | Sequence[str], expression: ca.MX, *, scale: Any = 1.0
    ) -> None:
        """Require an expression to be non-negative, in units of its scale."""
        self._constrain(names, expression, scale, (0.0, math.inf))

    def equal_along(
        self,
        names: str | Sequence[str],
        function: ca.Function,
        parts: Sequence[ca.MX],
        *,
        scale: Array | float = 1.0,
    ) -> list[ca.MX]:
        """Require the first output of a function to vanish at many columns of arguments.

        Args:
            names: One name for all columns, or one name per column.
            function: Function of a column, with one input per part. The first output is its rows.
            parts: The parts of all columns, side by side.
            scale: Unit of the rows of a column, in the shape of the output.

        Returns:
            The other outputs, concatenated horizontally.
        """
        others = self._constrain_along(names, function, parts, scale, (0.0, 0.0))
        along = Along(function=function, parts=tuple(parts))
        self._equations.append(Equation(names=names, origin=along, scale=scale))
        return others

    def at_least_zero_along(
        self,
        names: str | Sequence[str],
        function: ca.Function,
        parts: Sequence[ca.MX],
        *,
        scale: Array | float = 1.0,
    ) -> None:
        """Require the first output of a function to be non-negative at many columns."""
        self._constrain_along(names, function, parts, scale, (0.0, math.inf))

    @property
    def blocks(self) -> tuple[Block, ...]:
        """The blocks of unknowns declared so far."""
        return tuple(self._blocks)

    @property
    def equations(self) -> tuple[Equation, ...]:
        """The equations declared so far."""
        return tuple(self._equations)

    def derived(self, name: str, quantity: Derived) -> ca.MX:
        """Name a derived quantity and return it for use in rows."""
        symbol = ca.MX.sym(name, *quantity.value.shape)
        self._derived.append((symbol, quantity))
        return symbol

    def at_guess(self, expression: ca.MX) -> ca.DM:
        """Return the value of an expression at the first values of the unknowns."""
        unknowns = ca.vertcat(*(block.symbol for block in self._blocks))
        guess = np.concatenate(self._guess)
        (plain,) = self._resolved([expression])
        return ca.DM(ca.Function("at_guess", [unknowns], [plain])(guess))

    def report(self, name: str, expression: ca.MX) -> None:
        """Declare an expression that is evaluated at the solution."""
        self._reports[name] = expression

    def build(self, objective: ca.MX | None = None) -> NonlinearProgram:
        """Return the program. Without an objective, any feasible point is a solution."""
        bounds = np.array([np.concatenate(side) for side in zip(*self._bounds, strict=True)])
        rows = np.array(self._row_bounds)
        unknowns = ca.vertcat(*(block.symbol for block in self._blocks))
        cost = ca.MX(0) if objective is None else objective
        asked = [ca.vertcat(*self._rows), self._jacobian(unknowns), cost]
        plain, jacobian, cost, *reports = self._resolved([*asked, *self._reports.values()])
        return NonlinearProgram(
            reports=dict(zip(self._reports, reports, strict=True)),
            unknowns=unknowns,
            objective=cost,
            rows=plain,
            jacobian=jacobian,
            names=dict(self._names),
            row_names=tuple(self._row_names),
            scales=np.concatenate(self._scales),
            guess=np.concatenate(self._guess),
            lower=bounds[0],
            upper=bounds[1],
            row_lower=rows[:, 0],
            row_upper=rows[:, 1],
        )

    def _jacobian(self, unknowns: ca.MX) -> ca.MX:
        """Return the derivative of the rows in the unknowns, including derived quantities."""
        symbols = [ca.vec(symbol) for symbol, _ in self._derived]
        whole = rows_jacobian(self._origins, ca.vertcat(unknowns, *symbols))
        n = unknowns.numel()
        slopes = [
            ca.horzcat(one.slope, ca.MX(one.slope.shape[0], n - one.slope.shape[1]))
            for _, one in self._derived
        ]
        return whole[:, :n] + ca.mtimes(whole[:, n:], ca.vertcat(ca.MX(0, n), *slopes))

    def _resolved(self, expressions: Sequence[ca.MX]) -> list[ca.MX]:
        """Return expressions in the unknowns, with all derived quantities substituted."""
        if not self._derived:
            return list(expressions)
        symbols = [symbol for symbol, _ in self._derived]
        values = [one.value for _, one in self._derived]
        return ca.graph_substitute(list(expressions), symbols, values)

    def _constrain_along(
        self,
        names: str | Sequence[str],
        function: ca.Function,
        parts: Sequence[ca.MX],
        scale: Array | float,
        bounds: tuple[float, float],
    ) -> list[ca.MX]:
        """Add the rows of a function at many columns, and return its other outputs."""
        n = parts[0].numel() // function.numel_in(0)
        if n == 0:
            return []
        rows, *others = function.map(n).call(list(parts))
        shape = function.size_out(0)
        column = np.broadcast_to(np.asarray(scale, dtype=np.float64), shape)
        scales = ca.DM(np.tile(column.flatten(order="F"), n))
        self._constrain(names, ca.vec(rows), scales, bounds)
        self._origins[-1] = MappedRows(
            function=function, parts=tuple(parts), n_columns=n, scale=scales
        )
        return others

    def _constrain(
        self,
        names: str | Sequence[str],
        expression: ca.MX,
        scale: Any,
        bounds: tuple[float, float],
    ) -> None:
        """Add rows. A matrix has one name per column."""
        labels = [names] if isinstance(names, str) else list(names)
        n_rows = expression.numel()
        if n_rows == 0:
            return
        scaled: ca.MX = expression / scale
        self._rows.append(ca.vec(scaled))
        self._origins.append(self._rows[-1])
        self._row_names += [labels[k * len(labels) // n_rows] for k in range(n_rows)]
        self._row_bounds += [bounds] * n_rows
