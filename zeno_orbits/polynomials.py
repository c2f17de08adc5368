r"""Polynomials through Radau nodes: their values, integrals and means as matrices.

A polynomial on :math:`[0, 1]` is held by its values at the nodes. Everything is computed in
Legendre's basis, which keeps its condition at any number of nodes. Source: [HairerWanner1996]_,
section IV.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import legendre

from zeno_orbits.collocation import Array as Vector
from zeno_orbits.collocation import radau_abscissae


@dataclass(frozen=True, slots=True, kw_only=True)
class Nodes:
    """Nodes of a polynomial on ``[0, 1]``.

    Attributes:
        places: The nodes, ``(s,)``.
        coefficients: From values at the nodes to Legendre coefficients, ``(s, s)``.
        integral: From values at the nodes to integrals from 0 to the nodes, ``(s, s)``.
        whole: From values at the nodes to the integral over ``[0, 1]``, ``(s,)``.
    """

    places: Vector
    coefficients: Vector
    integral: Vector
    whole: Vector

    def values(self, at: Vector) -> Vector:
        """Return the matrix from values at the nodes to values at other places, ``(m, s)``."""
        return _basis(at, len(self.places)) @ self.coefficients

    def integrals(self, at: Vector) -> Vector:
        """Return the matrix to integrals from 0 to other places, ``(m, s)``."""
        return _integrated_basis(at, len(self.places)) @ self.coefficients

    def means(self, start: Vector, width: Vector) -> Vector:
        r"""Return the matrix to the means over ``[start, start + width]``, ``(m, s)``.

        .. math:: \frac1d \int_a^{a+d} q(u)\,du

        by a Gauss rule that is exact: the difference of two integrals would lose
        what `width` is smaller than one. At zero width the mean is the value.
        """
        n = len(self.places)
        points, weights = legendre.leggauss(n // 2 + 1)
        places = start[:, None] + width[:, None] * (points + 1) / 2
        basis = _basis(places.ravel(), n).reshape(len(start), len(points), n)
        return np.tensordot(weights / 2, basis, axes=(0, 1)) @ self.coefficients


@cache
def radau_nodes(n: int) -> Nodes:
    """Return the nodes of the Radau IIA method with `n` stages; the last is 1."""
    return _nodes(radau_abscissae(n))


@cache
def doubled_nodes(n: int) -> Nodes:
    """Return the Radau nodes, then as many places between them and 0 where they are checked."""
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
