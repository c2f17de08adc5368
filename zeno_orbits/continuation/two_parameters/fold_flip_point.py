r"""Folds and flips as roots of one system in the state and two parameters.

.. math:: P(y, p) - y = 0, \qquad \psi = \det(\partial_y P \mp 1) = 0

The system is regular at a fold of a family and at a point where two folds meet. So its solutions
form a smooth curve there as well. Theory (5.8).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.corrector import CLOSED, STALLED, FamilyMetric, linearized, returned
from zeno_orbits.continuation.return_maps import DifferentiatedReturn
from zeno_orbits.continuation.two_parameters.plane import CurveSetup
from zeno_orbits.errors import SimulationError, ZenoOrbitsError

_MOST_ITERATIONS = 10
_WIDTH = 1e-6
"""Half the width of the differences for the gradient, in scaled coordinates."""
_SMALL = 1e-9
"""Largest correction after which only rounding errors remain, since convergence is superlinear."""
_STUCK = 1e-7
"""Largest correction that rounding may cause if the test function is flat."""
_FARTHEST = 0.5
_ROUNDING = 1e-15
_DIAGONALS = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2.0)
"""Directions of two lines through a point of the plane, as rows. On both, both parameters change.
"""


@dataclass(frozen=True, kw_only=True)
class _Look:
    """The equations at a point: the return, its residual and the test function.

    Attributes:
        x: State, ``(n_x,)``.
        at: Both parameters in units of the ranges, ``(2,)``.
        z: State and parameters in scaled coordinates, ``(n_x + 2,)``.
        missed: Difference of the return from the state in coordinates, ``(d,)``.
        test: Value of the test function.
        rows: Derivative of `missed` with respect to the coordinates and the positions on both
            lines, ``(d, d + 2)``.
        basis: Derivative of `z` with respect to the same variables, ``(n_x + 2, d + 2)``.
        found: The return.
    """

    x: Vector
    at: Vector
    z: Vector
    missed: Vector
    test: float
    rows: Vector
    basis: Vector
    found: DifferentiatedReturn


@dataclass(frozen=True, kw_only=True)
class FoldFlipPoint:
    r"""A fold or a flip in the plane of two parameters.

    Attributes:
        x: State, ``(n_x,)``.
        at: Both parameters in units of the ranges, ``(2,)``.
        z: State and parameters in scaled coordinates, ``(n_x + 2,)``.
        tangent: Unit tangent of the curve, ``(n_x + 2,)``.
        gradient: Gradient of the test function, in the same coordinates, ``(n_x + 2,)``.
        normal: Direction in the plane normal to the curve, ``(2,)``. At a cusp of a fold it still
            turns smoothly.
        found: The return.
        error: Change of `at` if the return is computed less accurately.
    """

    x: Vector
    at: Vector
    z: Vector
    tangent: Vector
    gradient: Vector
    normal: Vector
    found: DifferentiatedReturn
    error: float


@dataclass(frozen=True, kw_only=True)
class FoldFlipSystem:
    """The equations of a fold or a flip.

    Attributes:
        setup: The plane, the return map and units. The unit of the parameter is one range.
        multiplier: 1 for a fold, -1 for a flip.
    """

    setup: CurveSetup
    multiplier: float

    @property
    def metric(self) -> FamilyMetric:
        """Units."""
        return self.setup.metric

    def point_at(self, x: Vector, at: Vector, along: Vector) -> FoldFlipPoint:
        """Return the point near a state and two parameters, without a prescribed plane.

        Args:
            x: The state, ``(n_x,)``.
            at: The parameters in units of the ranges, ``(2,)``.
            along: Vector with which the tangent has a positive product, ``(n_x + 2,)``.

        Raises:
            ZenoOrbitsError: If the iteration finds no point nearby.
        """
        start = _seen(self, x, at)
        gradient = self._gradient(start)
        tangent = _tangent(start, gradient, along)
        return self.corrected(start.z, tangent, gradient, along)

    def corrected(
        self, z: Vector, normal: Vector, gradient: Vector, along: Vector
    ) -> FoldFlipPoint:
        r"""Return the point in the plane through a given point with a given normal.

        Newton's method uses exact derivatives of `P`. After each step the derivatives of the test
        function are corrected by its change [Broyden1965]_. At the result they are recomputed.

        Args:
            z: The given point, ``(n_x + 2,)``.
            normal: The normal, ``(n_x + 2,)``.
            gradient: Gradient of the test function nearby, ``(n_x + 2,)``.
            along: Vector with which the tangent has a positive product, ``(n_x + 2,)``.

        Raises:
            ZenoOrbitsError: If a return fails, or Newton's method does not converge.
        """
        look, before = _seen(self, *self._of_place(z)), np.inf
        for _ in range(_MOST_ITERATIONS):
            off = float(normal @ (look.z - z))
            matrix = _matrix(look, gradient, normal)
            change = _solved(matrix, -np.concatenate([look.missed, [look.test, off]]))
            step = look.basis @ change
            size = float(np.linalg.norm(step))
            if size > _FARTHEST:
                break
            x, at = look.x + self.metric.scale * step[:-2], look.at + step[-2:]
            miss = float(np.max(np.abs(look.missed), initial=0.0))
            there = _seen(self, x, at)
            if miss <= CLOSED and size <= _SMALL:
                return self._finished(there, along)
            if miss <= STALLED and size <= _STUCK and size > before / 2:
                return self._finished(there, along)
            moved = there.z - look.z
            surprise = there.test - look.test - float(gradient @ moved)
            gradient = gradient + surprise / float(moved @ moved or 1.0) * moved
            look, before = there, size
        raise SimulationError("Newton's method does not converge to the point", time=0.0, state=())

    def _of_place(self, z: Vector) -> tuple[Vector, Vector]:
        return z[:-2] * self.metric.scale, z[-2:]

    def _gradient(self, look: _Look) -> Vector:
        """Return the gradient of the test function by central differences, ``(n_x + 2,)``."""
        slopes: list[float] = []
        for column in look.basis.T:
            sides: list[float] = []
            for width in (_WIDTH, -_WIDTH):
                x, at = self._of_place(look.z + width * column)
                returns = self.setup.returns_on(at, _DIAGONALS[0])
                x = returns.projected(x, 0.0, self.metric.scale)
                here = returns.frame(x, 0.0, self.metric.scale)
                found = returned(returns, x, 0.0, self.metric)
                rows = linearized(here, found, self.metric)[0]
                sides.append(_test(rows, self.multiplier))
            slopes.append((sides[0] - sides[1]) / (2 * _WIDTH))
        return np.asarray(np.array(slopes) @ np.linalg.pinv(look.basis), dtype=np.float64)

    def _finished(self, look: _Look, along: Vector) -> FoldFlipPoint:
        gradient = self._gradient(look)
        tangent = _tangent(look, gradient, along)
        d = len(look.rows)
        left = np.linalg.svd(look.rows[:, :d])[0][:, -1]
        normal = (left @ look.rows[:, d:]) @ _DIAGONALS
        return FoldFlipPoint(
            x=look.x,
            at=look.at,
            z=look.z,
            tangent=tangent,
            gradient=gradient,
            normal=normal / (np.linalg.norm(normal) or 1.0),
            found=look.found,
            error=self._doubt(look, gradient, tangent),
        )

    def _doubt(self, look: _Look, gradient: Vector, tangent: Vector) -> float:
        """Return the change of the point in the plane at a looser tolerance."""
        loose = replace(self.setup, returns=self.setup.returns.loosened())
        try:
            again = _seen(replace(self, setup=loose), look.x, look.at)
        except ZenoOrbitsError:
            return float("inf")
        matrix = _matrix(look, gradient, tangent)
        moved = 0.0
        for other in (look, again):
            missed = np.concatenate([other.missed, [other.test, 0.0]])
            moved += float(np.linalg.norm((look.basis @ _solved(matrix, -missed))[-2:]))
        return moved + _ROUNDING * max(1.0, float(np.max(np.abs(look.at))))


def _seen(system: FoldFlipSystem, x: Vector, at: Vector) -> _Look:
    """Return the equations at a state and two parameters."""
    scale, size = system.metric.scale, x.size
    first, second = (system.setup.returns_on(at, way) for way in _DIAGONALS)
    x = first.projected(x, 0.0, scale)
    here, other = first.frame(x, 0.0, scale), second.frame(x, 0.0, scale)
    d = here.dimension
    # A chart may have any rotation, but both lines must use the same chart.
    other = replace(here, drift=other.drift)
    lift = np.column_stack([here.lift, other.drift])
    found = returned(first, x, 0.0, system.metric)
    beside = returned(second, x, 0.0, system.metric)
    rows = linearized(here, found, system.metric)[0]
    rows = np.column_stack([rows, linearized(other, beside, system.metric)[0][:, d]])
    basis = np.zeros((size + 2, d + 2))
    basis[:size] = lift / scale[:, None]
    basis[size:, d:] = _DIAGONALS.T
    return _Look(
        x=x,
        at=at,
        z=np.concatenate([x / scale, at]),
        missed=here.components(found.end - x),
        test=_test(rows, system.multiplier),
        rows=rows,
        basis=basis,
        found=found,
    )


def _test(rows: Vector, multiplier: float) -> float:
    """Return the test function from the derivative of `P - y`."""
    d = len(rows)
    return float(np.linalg.det(rows[:, :d] + (1.0 - multiplier) * np.eye(d)))


def _matrix(look: _Look, gradient: Vector, normal: Vector) -> Vector:
    return np.concatenate([look.rows, [gradient @ look.basis, normal @ look.basis]])


def _solved(matrix: Vector, right: Vector) -> Vector:
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise SimulationError(str(error), time=0.0, state=()) from error


def _tangent(look: _Look, gradient: Vector, along: Vector) -> Vector:
    rows = np.concatenate([look.rows, (gradient @ look.basis)[None, :]])
    # The rows have very different sizes. Only their directions matter.
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    tangent = look.basis @ np.linalg.svd(rows)[2][-1]
    tangent = np.asarray(tangent / np.linalg.norm(tangent), dtype=np.float64)
    if tangent @ along < 0.0:
        return -tangent
    return tangent
