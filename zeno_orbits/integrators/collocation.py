r"""Radau IIA collocation: the scheme, and the data of its Newton iteration.

The stages of an implicit step solve :math:`Z = h (A \otimes I) F(y + Z)`. The eigenvectors of
:math:`A^{-1}` split the linear systems of Newton's iteration into one of the size of the state for
every real eigenvalue and one complex one for every pair. Source: [HairerWanner1996]_, IV.8.

Polynomials through Radau nodes: their values, integrals and means as matrices.

A polynomial on :math:`[0, 1]` is held by its values at the nodes. Everything is computed in
Legendre's basis, which keeps its condition at any number of nodes. Source: [HairerWanner1996]_,
section IV.5.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from zeno_orbits.arrays import Array, Vector


def lagrange_basis(points: Sequence[float], at: Any) -> list[Any]:
    r"""Return the Lagrange basis of points at an argument, one entry per point.

    .. math:: \ell_k(x) = \prod_{j \ne k} \frac{x - x_j}{x_k - x_j}

    Args:
        points: The points :math:`x_j`, all different.
        at: The argument :math:`x`, a value or a symbol.
    """
    places = [float(point) for point in points]
    return [
        math.prod((at - other) / (point - other) for j, other in enumerate(places) if j != k)
        for k, point in enumerate(places)
    ]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Collocation:
    """An implicit Runge-Kutta scheme whose last stage is the end of its interval.

    Attributes:
        nodes: Stage positions in the unit interval, ``(n_stages,)``, with 1 as the last position.
        matrix: Runge-Kutta matrix, ``(n_stages, n_stages)``, whose last row holds the weights.
    """

    nodes: Array
    matrix: Array

    def __repr__(self) -> str:
        """Return the number of stages."""
        return f"<Collocation with {self.n_stages} stages>"

    def __reduce__(self) -> tuple[Any, ...]:
        """Return a recipe for pickle, by which Radau IIA is the same object in every process."""
        if self is radau_scheme(self.n_stages):
            return radau_scheme, (self.n_stages,)
        return _scheme, (self.nodes, self.matrix)

    @property
    def n_stages(self) -> int:
        """Number of stages."""
        return len(self.nodes)

    @property
    def weights(self) -> Array:
        """Quadrature weights, ``(n_stages,)``."""
        return self.matrix[-1]

    @cached_property
    def inverse(self) -> Array:
        """:math:`A^{-1}`, ``(n_stages, n_stages)``."""
        return np.asarray(np.linalg.inv(self.matrix), dtype=np.float64)

    @cached_property
    def spectrum(self) -> Spectrum:
        """The eigenvalues of :math:`A^{-1}` and their vectors."""
        values, vectors = np.linalg.eig(self.inverse.astype(np.complex128))
        rows = np.asarray(np.linalg.inv(vectors), dtype=np.complex128)
        order = np.argsort(np.abs(np.imag(values)))
        kept = [int(k) for k in order if np.imag(values[k]) > -_REAL]
        return Spectrum(
            values=tuple(_tidy(complex(values[k])) for k in kept),
            columns=tuple(vectors[:, k] for k in kept),
            rows=tuple(rows[k, :] for k in kept),
        )

    @cached_property
    def embedded(self) -> tuple[float, Array]:
        r"""The part :math:`\gamma` of the slope at the start, and weights of the stages.

        :math:`\gamma h f(y) + \sum_i e_i Z_i` is the difference from an embedded quadrature of
        order ``n_stages`` that also uses the start. :math:`1/\gamma` is the real eigenvalue, so the
        matrix of Newton's iteration filters the difference.
        """
        gamma = 1.0 / self.spectrum.values[0].real
        powers = np.arange(self.n_stages)
        moments = 1.0 / (powers + 1.0)
        moments[0] -= gamma
        embedded = np.linalg.solve((self.nodes[:, None] ** powers).T, moments)
        return gamma, np.asarray((embedded - self.weights) @ self.inverse, dtype=np.float64)

    @cached_property
    def monomials(self) -> Array:
        """Weights of the stage increments in the polynomial through them, one row per power.

        The polynomial is zero at the start of the interval: the powers are 1 to ``n_stages``.
        """
        return np.asarray(np.linalg.inv(self.nodes[:, None] ** self.powers), dtype=np.float64)

    @cached_property
    def powers(self) -> Array:
        """The powers 1 to ``n_stages``, ``(n_stages,)``."""
        return np.arange(1.0, self.n_stages + 1.0)

    def coefficients(self, stages: Array) -> Array:
        """Return the coefficients of the collocation polynomial, powers 1 up, ``(n_stages, n_y)``.

        Args:
            stages: Stage increments, ``(n_stages, n_y)``.
        """
        # In the order of `follow.c`, because a matrix product may add in a different order.
        terms = self.monomials.T[:, :, None] * stages[:, None, :]
        return np.add.accumulate(terms, axis=0)[-1]

    def increment(self, coefficients: Array, position: float) -> Array:
        """Return the increment of the polynomial at a position in [0, 1], ``(n_y,)``."""
        return self.increments(coefficients[None], np.array([position]))[0]

    def increments(self, coefficients: Array, positions: Array) -> Array:
        """Return the increments of one polynomial at each position in [0, 1], ``(n, n_y)``.

        Args:
            coefficients: Coefficients, powers 1 up, ``(n, n_stages, n_y)``.
            positions: ``(n,)``.
        """
        value = np.zeros((len(coefficients), coefficients.shape[2]))
        for power in range(self.n_stages - 1, -1, -1):
            value = (value + coefficients[:, power]) * positions[:, None]
        return value

    def continued(self, coefficients: Array, start: float, ratio: float) -> Array:
        """Return the stage increments of a step from the continued polynomial of another step.

        Args:
            coefficients: Coefficients of the other step's polynomial.
            start: Start of the step, in units of the other step: 1 for the next step, 0 for another
                step from the same start.
            ratio: Size of the step in units of the other step.
        """
        at = start + ratio * self.nodes
        values = at[:, None] ** self.powers @ coefficients
        return values if start == 0.0 else values - self.increment(coefficients, start)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spectrum:
    """Eigenvalues of :math:`A^{-1}`, the real one first, then one of each conjugate pair.

    Attributes:
        values: The eigenvalues.
        columns: Right eigenvectors, each ``(n_stages,)``.
        rows: Left eigenvectors, each ``(n_stages,)``, inverse to the columns.
    """

    values: tuple[complex, ...]
    columns: tuple[NDArray[np.complex128], ...]
    rows: tuple[NDArray[np.complex128], ...]


_REAL = 1e-9
"""An imaginary part below this is rounding."""


def _tidy(value: complex) -> complex:
    return complex(value.real) if abs(value.imag) < _REAL else value


def _scheme(nodes: Array, matrix: Array) -> Collocation:
    return Collocation(nodes=nodes, matrix=matrix)


@cache
def radau_scheme(n_stages: int) -> Collocation:
    """Return Radau IIA, of order ``2 n_stages - 1``: stiffly accurate, so layers decay."""
    nodes = radau_nodes(n_stages)
    return Collocation(nodes=nodes.places, matrix=nodes.integral)


def radau_abscissae(n_stages: int) -> Array:
    """Return the zeros of :math:`P_{s-1} - P_s` on [0, 1], P the Legendre polynomials."""
    series = np.zeros(n_stages + 1)
    series[-2:] = (1.0, -1.0)
    slope = legendre.legder(series)
    nodes = np.sort(legendre.legroots(series).real)
    for _ in range(3):
        nodes = nodes - legendre.legval(nodes, series) / legendre.legval(nodes, slope)
    nodes[-1] = 1.0
    return (nodes + 1.0) / 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Nodes:
    """Nodes of a polynomial on ``[0, 1]``.

    Attributes:
        places: The nodes, ``(s,)``.
        coefficients: Matrix from values at the nodes to Legendre coefficients, ``(s, s)``.
        integral: Matrix from values at the nodes to integrals from 0 to the nodes, ``(s, s)``.
        whole: Weights of the values at the nodes in the integral over ``[0, 1]``, ``(s,)``.
    """

    places: Vector
    coefficients: Vector
    integral: Vector
    whole: Vector

    def values(self, at: Vector) -> Vector:
        """Return the matrix from values at the nodes to values at other points, ``(m, s)``."""
        return _basis(at, len(self.places)) @ self.coefficients

    def integrals(self, at: Vector) -> Vector:
        """Return the matrix to integrals from 0 to other points, ``(m, s)``."""
        return _integrated_basis(at, len(self.places)) @ self.coefficients

    def means(self, start: Vector, width: Vector) -> Vector:
        r"""Return the matrix to the means over ``[start, start + width]``, ``(m, s)``.

        .. math:: \frac1d \int_a^{a+d} q(u)\,du

        by an exact Gauss rule: the difference of two integrals would lose digits for a small
        `width`. At zero width the mean is the value.
        """
        n = len(self.places)
        points, weights = legendre.leggauss(n // 2 + 1)
        places = start[:, None] + width[:, None] * (points + 1) / 2
        basis = _basis(places.ravel(), n).reshape(len(start), len(points), n)
        return np.tensordot(weights / 2, basis, axes=(0, 1)) @ self.coefficients


@cache
def radau_nodes(n: int) -> Nodes:
    """Return the nodes of the Radau IIA method with `n` stages, with 1 as the last node."""
    return _nodes(radau_abscissae(n))


@cache
def doubled_nodes(n: int) -> Nodes:
    """Return the Radau nodes, then the same number of check points between the nodes and 0."""
    own = radau_nodes(n).places
    angles = np.concatenate([[0.0], np.arccos(1 - 2 * own)])
    return _nodes(np.concatenate([own, (1 - np.cos((angles[1:] + angles[:-1]) / 2)) / 2]))


def _nodes(places: Vector) -> Nodes:
    n = len(places)
    coefficients = np.asarray(np.linalg.inv(_basis(places, n)), dtype=np.float64)
    return Nodes(
        places=places,
        coefficients=coefficients,
        integral=_integrated_basis(places, n) @ coefficients,
        whole=coefficients[0],
    )


def _basis(at: Vector, n: int) -> Vector:
    return np.asarray(legendre.legvander(2 * at - 1, n - 1), dtype=np.float64)


def _integrated_basis(at: Vector, n: int) -> Vector:
    r"""Return :math:`\int_0^u P_k(2v-1)dv = (P_{k+1} - P_{k-1})(2u-1) / (4k+2)`, ``(m, n)``."""
    values = np.asarray(legendre.legvander(2 * at - 1, n))
    degrees = np.arange(1, n)
    rest = (values[:, 2:] - values[:, :-2]) / (4 * degrees + 2)
    return np.concatenate([at[:, None], rest], axis=1)
