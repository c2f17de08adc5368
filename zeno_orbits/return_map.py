r"""The derivative of the return map inside a program, and its spectral radius as rows.

Theory (30) and (31). The whole section map is carried, not one Floquet vector: its trace and
determinant are smooth where two multipliers meet, and bound all of them at once.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.linear_algebra import null_space
from zeno_orbits.program import Array, ProgramBuilder
from zeno_orbits.shooting import OrbitTerms
from zeno_orbits.tangents import first_directions, tangent

MOST_COORDINATES = 2
"""Dimension of the release section up to which trace and determinant tell the spectral radius."""

LEAST_RADIUS = 1e-4
"""A spectral radius below this is as good as zero: a perturbation is gone after one period."""


def section_map(terms: OrbitTerms) -> ca.MX:
    r"""Declare the directions of a neighbouring motion; return :math:`\partial P/\partial y`.

    Args:
        terms: The orbit.

    Returns:
        The derivative of the return map in coordinates of the section, ``(d, d)``.

    Raises:
        InputError: If the section has no or too many coordinates.
    """
    program = terms.program
    slope = _multiplier_slope(terms)
    basis = _section_basis(terms, slope)
    d = basis.shape[1]
    if not 1 <= d <= MOST_COORDINATES:
        wanted = f"must leave the contraction alone where the section has {d} coordinates"
        reason = f"one to {MOST_COORDINATES} can be asked for"
        raise InputError(f"Argument `objective` {wanted}, but {reason}.")
    end, chart = terms.end, ca.mtimes(ca.DM(basis).T, terms.start / ca.DM(terms.scale))
    # Where the stop lets go is told by the multiplier; an impact ends its flight by itself.
    ends = ca.MX(0, 1)
    if terms.shape.starts_at_release:
        ends = terms.compiled.contact(end, terms.p)[3] / float(np.max(np.abs(slope)))
    n_ends = ends.numel()
    extra = ca.vertcat(ends, chart)
    targets = np.vstack([np.zeros((n_ends, d)), np.eye(d)])
    firsts = first_directions(program, terms.motion, extra, targets)
    columns: list[ca.MX] = []
    for k, first in enumerate(firsts):
        label = f"neighbour {k + 1}"
        moved, direction = tangent(program, terms.motion, label=label, first=first)
        along = ca.jtimes(ca.vertcat(extra, end / ca.DM(terms.scale)), moved, direction)
        program.equal(f"{label}: multiplier = 0 at its release", along[:n_ends])
        place = along[n_ends : n_ends + d]
        program.equal(f"{label}: its start", place - ca.DM(targets[n_ends:, k]))
        columns.append(ca.mtimes(ca.DM(basis).T, along[n_ends + d :]))
    return ca.horzcat(*columns)


def keep_radius_below(program: ProgramBuilder, jacobian: ca.MX, radius: ca.MX | float) -> None:
    r"""Require all multipliers to be at most a radius in size.

    .. math:: 1 \pm \frac{\operatorname{tr} A}{\rho} + \frac{\det A}{\rho^2} \ge 0, \qquad
        \frac{\det A}{\rho^2} \le 1

    Jury's conditions on :math:`A / \rho` (theory (31)); one coordinate needs the first two alone.
    """
    one = jacobian.shape[0] == 1
    trace = ca.trace(jacobian) / radius
    # CasADi differentiates its own determinant by the inverse, and one multiplier is often zero.
    determinant = ca.MX(0) if one else _determinant(jacobian) / radius**2
    for sign, word in ((1, "not below -"), (-1, "not above ")):
        name = f"multipliers: real ones {word}the spectral radius"
        program.at_least_zero(name, 1 + sign * trace + determinant)
    if not one:
        name = "multipliers: complex ones not above the spectral radius"
        program.at_least_zero(name, 1 - determinant)


def _determinant(matrix: ca.MX) -> ca.MX:
    return matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]


def radius_of(jacobian: Array) -> float:
    """Return the spectral radius of a matrix of numbers."""
    return float(np.max(np.abs(np.linalg.eigvals(jacobian))))


def _section_basis(terms: OrbitTerms, slope: Array) -> Array:
    """Return a basis of the section at the guess, in scaled states, ``(n_x, d)``."""
    if not terms.shape.starts_at_release:
        return terms.tangent
    return np.asarray(terms.tangent @ null_space(slope @ terms.tangent), dtype=np.float64)


def _multiplier_slope(terms: OrbitTerms) -> Array:
    """Return the derivative of the multiplier by the scaled states at the release, ``(1, n_x)``."""
    x, p = ca.SX.sym("x", terms.compiled.n_x), ca.SX.sym("p", terms.p.numel())
    multiplier = terms.compiled.contact(x, p)[3]
    gradient = ca.Function("gradient", [x, p], [ca.jacobian(multiplier, x)])
    return terms.guessed(gradient(terms.start, terms.p)) * terms.scale
