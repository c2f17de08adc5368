"""Linear systems in symbols: a matrix as triangular factors, real or complex, without pivoting."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True, slots=True, kw_only=True)
class TriangularFactors:
    """A matrix as lower times upper triangle, without pivoting, each entry real and imaginary.

    Attributes:
        real: Lower triangle below the diagonal, upper above, inverse pivots on it.
        imaginary: The same for the imaginary part, or ``None`` for a real matrix.
    """

    real: list[list[ca.SX]]
    imaginary: list[list[ca.SX]] | None

    @classmethod
    def symbols(cls, n: int, *, is_complex: bool) -> TriangularFactors:
        """Return factors of symbols, ``(n, n)``."""

        def square(name: str) -> list[list[ca.SX]]:
            return [[ca.SX.sym(f"{name}{i}_{j}") for j in range(n)] for i in range(n)]

        return cls(real=square("re"), imaginary=square("im") if is_complex else None)

    @property
    def is_complex(self) -> bool:
        """True if the entries have imaginary parts."""
        return self.imaginary is not None

    def flat(self) -> ca.SX:
        """Return all entries row by row, real parts first, ``(n^2,)`` or ``(2 n^2,)``."""
        parts = [self.real] if self.imaginary is None else [self.real, self.imaginary]
        return ca.vertcat(*(entry for part in parts for row in part for entry in row))

    def entry(self, i: int, j: int) -> _Number:
        """Return an entry with its imaginary part, if there is one."""
        return _Number(self.real[i][j], None if self.imaginary is None else self.imaginary[i][j])

    def solve(self, real: ca.SX, imaginary: ca.SX | None) -> tuple[ca.SX, ca.SX | None]:
        """Return the solution for a right-hand side."""
        n = len(self.real)
        x = [_Number(real[i], None if imaginary is None else imaginary[i]) for i in range(n)]
        for i in range(n):
            for j in range(i):
                x[i] = x[i] - self.entry(i, j) * x[j]
        for i in reversed(range(n)):
            for j in range(i + 1, n):
                x[i] = x[i] - self.entry(i, j) * x[j]
            x[i] = x[i] * self.entry(i, i)
        found = ca.vertcat(*(entry.real for entry in x))
        if imaginary is None:
            return found, None
        return found, ca.vertcat(*(_imaginary(entry) for entry in x))


@dataclass(frozen=True, slots=True)
class _Number:
    """A symbolic number, complex if it has an imaginary part."""

    real: ca.SX
    imaginary: ca.SX | None

    @property
    def is_zero(self) -> bool:
        return self.real.is_zero() and (self.imaginary is None or self.imaginary.is_zero())

    def __sub__(self, other: _Number) -> _Number:
        if self.imaginary is None or other.imaginary is None:
            return _Number(self.real - other.real, self.imaginary)
        return _Number(self.real - other.real, self.imaginary - other.imaginary)

    def __mul__(self, other: _Number) -> _Number:
        if self.imaginary is None or other.imaginary is None:
            return _Number(self.real * other.real, None)
        return _Number(
            self.real * other.real - self.imaginary * other.imaginary,
            self.real * other.imaginary + self.imaginary * other.real,
        )

    def inverse(self) -> _Number:
        if self.imaginary is None:
            return _Number(1 / self.real, None)
        size = self.real**2 + self.imaginary**2
        return _Number(self.real / size, -self.imaginary / size)


def factorized_matrix(matrix: TriangularFactors) -> TriangularFactors:
    """Return the triangular factors. A zero pivot gives NaN, which rejects the step."""
    n = len(matrix.real)
    rows = [[matrix.entry(i, j) for j in range(n)] for i in range(n)]
    for k in range(n):
        rows[k][k] = rows[k][k].inverse()
        right = [j for j in range(k + 1, n) if not rows[k][j].is_zero]
        for i in range(k + 1, n):
            if rows[i][k].is_zero:
                continue
            rows[i][k] = rows[i][k] * rows[k][k]
            for j in right:
                rows[i][j] = rows[i][j] - rows[i][k] * rows[k][j]
    real = [[number.real for number in row] for row in rows]
    if not matrix.is_complex:
        return TriangularFactors(real=real, imaginary=None)
    return TriangularFactors(
        real=real,
        imaginary=[[_imaginary(number) for number in row] for row in rows],
    )


def _imaginary(number: _Number) -> ca.SX:
    return ca.SX(0) if number.imaginary is None else number.imaginary
