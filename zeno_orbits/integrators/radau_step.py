r"""One step of Radau IIA in symbols: Newton's matrices, Newton's step and the error.

In the variables :math:`W = T^{-1} Z` the simplified Newton iteration separates into systems of the
size of the state, one system for every eigenvalue :math:`\mu` of :math:`A^{-1}`. A conjugate pair
counts once:

.. math:: \left(\frac{\mu}{h} I - J\right) \Delta w =
    \left(T^{-1}\,(F(y + Z) - A^{-1} Z / h)\right)_\mu

Source: [HairerWanner1996]_, IV.8.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from zeno_orbits.integrators.collocation import Collocation
from zeno_orbits.integrators.triangular import TriangularFactors, factorized_matrix


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
    factorized = [factorized_matrix(_shifted(jacobian, mu, size)) for mu in spectrum.values]
    symbols = [
        TriangularFactors.symbols(n_y, is_complex=factors.is_complex) for factors in factorized
    ]
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


def n_factors(n_y: int, scheme: Collocation) -> int:
    """Return the number of entries of the factors: twice as many of a complex matrix."""
    return sum(n_y**2 * (1 if mu.imag == 0.0 else 2) for mu in scheme.spectrum.values)


def _shifted(jacobian: ca.SX, mu: complex, size: ca.SX) -> TriangularFactors:
    """Return ``(mu / size) I - J``, entry by entry."""
    n = jacobian.shape[0]
    eye = np.eye(n)
    real = [[eye[i, j] * (mu.real / size) - jacobian[i, j] for j in range(n)] for i in range(n)]
    if mu.imag == 0.0:
        return TriangularFactors(real=real, imaginary=None)
    imaginary = [[ca.SX(eye[i, j]) * (mu.imag / size) for j in range(n)] for i in range(n)]
    return TriangularFactors(real=real, imaginary=imaginary)
