r"""The Jacobian of a program whose rows are mostly one function, applied to many columns.

CasADi differentiates such a program with one seed per colour of the sparsity pattern, and each seed
doubles the code of the function. Here the chain rule is applied explicitly: with rows
:math:`g_k = S^{-1} f(c_k(u))` of the columns :math:`c_k` of a matrix,

.. math:: \partial g_k / \partial u = S^{-1}\, f'(c_k)\; \partial c_k / \partial u,

where :math:`f'` is derived once and the columns are unknowns themselves, except for a few entries.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True, slots=True, kw_only=True)
class MappedRows:
    """Rows made of one function at many columns.

    Attributes:
        function: Function of a column, with one input per part of the column. Its first output is
            the column's rows before scaling.
        parts: The parts of all columns. A part of ``m`` entries is a matrix of ``n m`` entries.
        n_columns: Number of columns, ``n``.
        scale: Divisor of each row, ``(n n_rows,)``.
    """

    function: ca.Function
    parts: tuple[ca.MX, ...]
    n_columns: int
    scale: ca.DM

    def columns(self) -> ca.MX:
        """Return the complete columns, ``(n_column, n)``."""
        n = self.n_columns
        return ca.vertcat(*(ca.reshape(part, part.numel() // n, n) for part in self.parts))


def rows_jacobian(rows: list[ca.MX | MappedRows], unknowns: ca.MX) -> ca.MX:
    """Return the sparse Jacobian of rows in order, ``(n_rows, n_unknowns)``.

    Args:
        rows: Plain columns of rows, or mapped rows.
        unknowns: The unknowns, ``(n_unknowns,)``.
    """
    inner = [ca.vec(r.columns()) if isinstance(r, MappedRows) else r for r in rows]
    offsets = [0]
    for expression in inner:
        offsets.append(offsets[-1] + expression.numel())
    pieces = ca.vertsplit(ca.jacobian(ca.vertcat(*inner), unknowns), offsets)
    derivatives: dict[int, ca.Function] = {}
    blocks = [
        ca.mtimes(_outer(row, derivatives), piece) if isinstance(row, MappedRows) else piece
        for row, piece in zip(rows, pieces, strict=True)
    ]
    return ca.vertcat(*blocks)


def _outer(rows: MappedRows, known: dict[int, ca.Function]) -> ca.MX:
    """Return the block-diagonal derivative of scaled rows with respect to their columns."""
    key = hash(rows.function)
    if key not in known:
        known[key] = _derivative(rows.function)
    columns = rows.columns()
    blocks = known[key].map(rows.n_columns)(columns)
    diagonal = ca.diagcat(*ca.horzsplit(blocks, columns.shape[0]))
    return ca.mtimes(ca.diag(1 / rows.scale), diagonal)


def _derivative(function: ca.Function) -> ca.Function:
    """Return the Jacobian of a function's first output as a function of the whole column."""
    parts = [ca.SX.sym(f"part{k}", *function.size_in(k)) for k in range(function.n_in())]
    column = ca.veccat(*parts)
    rows = ca.vec(function.call(parts)[0])
    return ca.Function(f"{function.name()}_derivative", [column], [ca.jacobian(rows, column)])
