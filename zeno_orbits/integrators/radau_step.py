r"""One step of Radau IIA in symbols: Newton's matrices, Newton's step and the error.

With :math:`W = T^{-1} Z` the simplified Newton iteration falls apart into systems of the size of
the state, one for every eigenvalue :math:`\mu` of :math:`A^{-1}` (one of each conjugate pair):

.. math:: \left(\frac{\mu}{h} I - J\right) \Delta w =
    \left(T^{-1}\,(F(y + Z) - A^{-1} Z / h)\right)_\mu

Source: [HairerWanner1996]_, IV.8.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from zeno_orbits.integrators.collocation import Collocation


@dataclass(frozen=True, slots=True, kw_only=True)
class ImplicitExpressions:
    """The pieces of an implicit step as expressions.

    Attributes:
        y: State before the step, ``(n_y,)``.
        size: Step size.
        stages: Stage increments :math:`Z`, ``(n_y, n_stages)``.
        factors: Triangular factors of Newton's matrices, as symbols, flat.
        factorized: The same as expressions of ``y`` and ``size``.
        correction: Newton's step of the stages, ``(n_y, n_stages)``.
        error: Difference from the embedded solution, filtered, ``(n_y,)``.
    """

    y: ca.SX
    size: ca.SX
    stages: ca.SX
    factors: ca.SX
    factorized: ca.SX
    correction: ca.SX
    error: ca.SX


def implicit_expressions(rate: ca.Function, p: ca.SX, scheme: Collocation) -> ImplicitExpressions:
    """Return the pieces of an implicit step of a vector field.

    Args:
        rate: ``(y, p) -> dy/dt``.
        p: Symbols of its parameters.
        scheme: The collocation scheme, of an odd number of stages.
    """
    n_y, spectrum = rate.size1_in(0), scheme.spectrum
    y, size = ca.SX.sym("y", n_y), ca.SX.sym("size")
    stages = ca.SX.sym("stages", n_y, scheme.n_stages)
    slope = rate(y, p)
    jacobian = ca.densify(ca.jacobian(slope, y))
    factorized = [_factorize(_shifted(jacobian, mu, size)) for mu in spectrum.values]
    symbols = [_Factors.symbols(n_y, is_complex=factors.is_complex) for factors in factorized]
    rates = ca.horzcat(*(rate(y + stage, p) for stage in ca.horzsplit(stages)))
    residual = rates - ca.mtimes(stages, ca.DM(scheme.inverse).T) / size
    correction = ca.SX.zeros(n_y, scheme.n_stages)
    for column, row, factors in zip(spectrum.columns, spectrum.rows, symbols, strict=True):
        real = ca.mtimes(residual, ca.DM(row.real))
        imaginary = ca.mtimes(residual, ca.DM(row.imag)) if factors.is_complex else None
        real, imaginary = factors.solve(real, imaginary)
        if imaginary is None:
            correction += ca.mtimes(real, ca.DM(column.real).T)
            continue
        # The conjugate eigenvalue brings the conjugate part.
        correction += 2 * ca.mtimes(real, ca.DM(column.real).T)
        correction -= 2 * ca.mtimes(imaginary, ca.DM(column.imag).T)
    gamma, weights = scheme.embedded
    raw = slope + ca.mtimes(stages, ca.DM(weights)) / (gamma * size)
    error, _ = symbols[0].solve(raw, None)
    return ImplicitExpressions(
        y=y,
        size=size,
        stages=stages,
        factors=ca.vertcat(*(factors.flat() for factors in symbols)),
        factorized=ca.vertcat(*(factors.flat() for factors in factorized)),
        correction=correction,
        error=error,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Factors:
    """A matrix as lower times upper triangle, without pivoting, each entry real and imaginary.

    Attributes:
        real: Lower triangle below the diagonal, upper above, inverse pivots on it.
        imaginary: Likewise; ``None`` for a real matrix.
    """

    real: list[list[ca.SX]]
    imaginary: list[list[ca.SX]] | None

    @classmethod
    def symbols(cls, n: int, *, is_complex: bool) -> _Factors:
        def square(name: str) -> list[list[ca.SX]]:
            return [[ca.SX.sym(f"{name}{i}_{j}") for j in range(n)] for i in range(n)]

        return cls(real=square("re"), imaginary=square("im") if is_complex else None)

    @property
    def is_complex(self) -> bool:
        return self.imaginary is not None

    def flat(self) -> ca.SX:
        parts = [self.real] if self.imaginary is None else [self.real, self.imaginary]
        return ca.vertcat(*(entry for part in parts for row in part for entry in row))

    def entry(self, i: int, j: int) -> _Number:
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


def _shifted(jacobian: ca.SX, mu: complex, size: ca.SX) -> _Factors:
    """Return ``(mu / size) I - J``, entry by entry."""
    n = jacobian.shape[0]
    eye = np.eye(n)
    real = [[eye[i, j] * (mu.real / size) - jacobian[i, j] for j in range(n)] for i in range(n)]
    if mu.imag == 0.0:
        return _Factors(real=real, imaginary=None)
    imaginary = [[ca.SX(eye[i, j]) * (mu.imag / size) for j in range(n)] for i in range(n)]
    return _Factors(real=real, imaginary=imaginary)


def _factorize(matrix: _Factors) -> _Factors:
    """Return the triangular factors; a zero pivot gives NaN, and the step is refused."""
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
        return _Factors(real=real, imaginary=None)
    return _Factors(
        real=real,
        imaginary=[[_imaginary(number) for number in row] for row in rows],
    )


def _imaginary(number: _Number) -> ca.SX:
    return ca.SX(0) if number.imaginary is None else number.imaginary
