r"""The derivative of the return map inside a program, and its spectral radius as rows.

See theory (5.1) and (5.2). The program contains the whole section map, not a single Floquet vector:
the map's trace and determinant are smooth at a collision of two multipliers, and bound all
multipliers at once.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Array, null_space
from zeno_orbits.errors import InputError
from zeno_orbits.search.transcription.motion_derivative import derivative_along
from zeno_orbits.search.transcription.program import ProgramBuilder
from zeno_orbits.search.transcription.transcribe import OrbitTerms

MOST_COORDINATES = 6
"""Largest dimension of the release section for rows on the spectral radius."""


def section_map(terms: OrbitTerms) -> ca.MX:
    r"""Declare the directions of a neighbouring motion, and return :math:`\partial P/\partial y`.

    Args:
        terms: The orbit.

    Returns:
        The derivative of the return map in coordinates of the section, ``(d, d)``.

    Raises:
        InputError: If the section has zero or too many coordinates.
    """
    program = terms.program
    slope = _multiplier_slope(terms)
    basis = _section_basis(terms, slope)
    d = basis.shape[1]
    if not 1 <= d <= MOST_COORDINATES:
        wanted = f"or `bounds` cannot use the multipliers of a section with {d} coordinates"
        reason = f"one to {MOST_COORDINATES} are supported"
        raise InputError(f"Argument `objective` {wanted}, but {reason}.")
    end, chart = terms.end, ca.mtimes(ca.DM(basis).T, terms.start / ca.DM(terms.scale))
    # The multiplier determines the release. An impact ends its flight without a further equation.
    ends = ca.MX(0, 1)
    if terms.shape.starts_at_release:
        ends = terms.compiled.contact_at(end, terms.p).multiplier / float(np.max(np.abs(slope)))
    n_ends = ends.numel()
    targets = np.vstack([np.zeros((n_ends, d)), np.eye(d)])
    arrival = ca.mtimes(ca.DM(basis).T, end / ca.DM(terms.scale))
    slope_of_map = derivative_along(
        program, terms.motion, ca.vertcat(ends, chart), targets, arrival
    )
    return program.derived("slope of the return map", slope_of_map)


def keep_radius_below(program: ProgramBuilder, jacobian: ca.MX, radius: ca.MX | float) -> None:
    r"""Require the modulus of all multipliers to be at most a radius.

    The rows are Jury's conditions on the characteristic polynomial of :math:`A / \rho`
    (theory (5.2)). For two or more multipliers they hold if and only if all multipliers lie in the
    unit disc.

    Args:
        program: The program to which the rows are added.
        jacobian: Derivative of the return map in section coordinates, ``(d, d)``.
        radius: The radius, as a value or an unknown.
    """
    d = jacobian.shape[0]
    entries, size = ca.SX.sym("A", d, d), ca.SX.sym("radius")
    coefficients = _characteristic(entries)
    scaled = [one / size ** (d - k) for k, one in enumerate(coefficients)]
    rows = ca.Function("jury", [entries, size], [ca.vertcat(*_jury(scaled))])(jacobian, radius)
    names = [f"real multipliers not {word} the spectral radius" for word in _REAL]
    names += [_COMPLEX] * (rows.numel() - 2)
    for k, name in enumerate(names):
        program.at_least_zero(name, rows[k])


_REAL = ("above", "below -")
_COMPLEX = "multipliers: complex values not above the spectral radius"


def _characteristic(matrix: ca.SX) -> list[ca.SX]:
    r"""Return the coefficients of :math:`\det(z - A)` from :math:`z^0` on. The last is 1.

    The recurrence of Faddeev and LeVerrier does not divide by entries, as a multiplier is often
    zero.
    """
    d = matrix.shape[0]
    found = [ca.SX(1)]
    power = ca.SX.eye(d)
    for k in range(1, d + 1):
        moved = ca.mtimes(matrix, power)
        found.insert(0, -ca.trace(moved) / k)
        power = moved + found[0] * ca.SX.eye(d)
    return found


def _jury(a: list[ca.SX]) -> list[ca.SX]:
    r"""Return expressions that are positive if and only if all roots lie inside the unit circle.

    .. math:: p(1), \quad (-1)^d p(-1), \quad \text{and the inners of}\quad
        X \pm Y, \quad X_{ij} = a_{d-j+i}, \quad Y_{ij} = a_{i+j-d+2}

    with :math:`i, j` from 0 to :math:`d - 2`, and zero for an index outside of :math:`a`. The
    inners follow from repeated removal of the first and last rows and columns.
    """
    d = len(a) - 1
    rows = [sum(a, ca.SX(0)), sum(((-1) ** (d - k) * one for k, one in enumerate(a)), ca.SX(0))]
    for sign in (-1, 1):
        whole = ca.SX(d - 1, d - 1)
        for i in range(d - 1):
            for j in range(d - 1):
                whole[i, j] = (a[d - j + i] if j >= i else 0) + (
                    sign * a[i + j - d + 2] if i + j >= d - 2 else 0
                )
        # For two multipliers, the row of the other sign is the sum of the first two rows.
        if d == 2 and sign > 0:
            continue
        for cut in range(d // 2):
            inner = whole[cut : d - 1 - cut, cut : d - 1 - cut]
            rows.append(ca.det(inner))
    return rows


def radius_of(jacobian: Array) -> float:
    """Return the spectral radius of a numerical matrix."""
    return float(np.max(np.abs(np.linalg.eigvals(jacobian))))


def _section_basis(terms: OrbitTerms, slope: Array) -> Array:
    """Return a basis of the section at the guess, in scaled states, ``(n_x, d)``."""
    if not terms.shape.starts_at_release:
        return terms.tangent
    return np.asarray(terms.tangent @ null_space(slope @ terms.tangent), dtype=np.float64)


def _multiplier_slope(terms: OrbitTerms) -> Array:
    """Return the gradient of the multiplier in the scaled states at the release, ``(1, n_x)``."""
    x, p = ca.SX.sym("x", terms.compiled.n_x), ca.SX.sym("p", terms.p.numel())
    multiplier = terms.compiled.contact_at(x, p).multiplier
    gradient = ca.Function("gradient", [x, p], [ca.jacobian(multiplier, x)])
    return terms.guessed(gradient(terms.start, terms.p)) * terms.scale
