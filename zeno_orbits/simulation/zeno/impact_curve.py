r"""The curve on which the impacts of one sequence lie, as a polynomial (theory (2.8)).

Let :math:`z = (x_\circ, t)` be the state moved onto the stop just after an impact and its time,
in the problem's own sizes, and :math:`w` the gap rate after it. A flight leads from :math:`(z, w)`
to :math:`(z', w')`. The impacts of one sequence lie on an analytic curve :math:`z(w)` that ends in
their Zeno point, and

.. math:: \frac{z(w') - z(w)}{w - w'} = g(z(w), w), \qquad g(z, w) = \frac{z' - z}{w - w'},
    \qquad g(z, 0) = \frac{2}{|\ddot h|\,(1 - e)} \binom{f_\mathrm{locked}}{1}

On a piece :math:`[w_0 - \Delta, w_0]` the curve is a polynomial, represented by the values of its
slope :math:`q = -dz/dw` at Radau nodes. The law is required at the nodes. Its left side is the mean
of :math:`q` between the two speeds, which is free of cancellation for any distance of the speeds.
For :math:`e \to 1` it is the value of :math:`q`, and the scheme is Radau IIA.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import Nodes, doubled_nodes, radau_nodes
from zeno_orbits.model import HybridDynamics
from zeno_orbits.simulation.zeno.rescaled_flight import Flight
from zeno_orbits.simulation.zeno.zeno_limit import tail_time

_NUDGE = 1e-5
"""Relative step of the differences. It is far above the rounding of a slope, which `1 - e`
magnifies."""

_PROJECTED_OUT = 1e-3
"""A singular value of the projection onto the stop below this belongs to a direction it removes."""

_ON_STOP = 4e-16
"""A gap below this, relative to the state, is rounding."""
_MOST_MOVES = 4

_SLOW = 0.5
"""An iteration that converges no faster than this does not converge."""


class CurveLostError(Exception):
    """The curve was followed to where a speed does not fall, or further than was allowed."""


@dataclass(slots=True)
class ImpactCurve:
    """The curve of the impacts, defined by its flights. The flights are counted.

    Attributes:
        dynamics: The system.
        flight: One rescaled flight.
        most_flights: Largest number of flights.
        n_flights: Number of flights so far.
    """

    dynamics: HybridDynamics
    flight: Flight
    most_flights: int
    n_flights: int = 0
    _unit: Vector = field(init=False)

    def __post_init__(self) -> None:
        """Look up the sizes."""
        own = self.dynamics.own
        self._unit = np.append(own.states(len(self.dynamics.state_names)), own.time)

    def scaled(self, x: Vector, time: float) -> Vector:
        """Return a point of the curve from its state and time, ``(n_x + 1,)``."""
        return np.append(x, time) / self._unit

    def plain(self, z: Vector) -> Vector:
        """Return state and time of a point, ``(n_x + 1,)``."""
        return z * self._unit

    def on_stop(self, x: Vector) -> Vector:
        """Return a state projected onto the stop to rounding, as the slope magnifies a gap.

        A single projection leaves an error of the square of the gap if the stop is curved.
        """
        for _ in range(_MOST_MOVES):
            x = self.dynamics.on_stop(x)
            size = 1 + float(np.max(np.abs(x / self._unit[:-1])))
            if abs(self.dynamics.gap(x)) <= _ON_STOP * self.dynamics.own.gap * size:
                break
        return x

    def slope(self, z: Vector, w: float) -> tuple[Vector, float]:
        """Return :math:`g(z, w)`, ``(n_x + 1,)``, and the fall of the speed :math:`w - w'`.

        Raises:
            CurveLostError: If the stop repels there, the speed does not fall, or flights run out.
        """
        dynamics = self.dynamics
        resting = self.on_stop(self.plain(z)[:-1])
        acceleration = dynamics.gap_acceleration(resting)
        if not acceleration < 0.0:
            raise CurveLostError
        if w == 0.0:
            rate = tail_time(1.0, acceleration, dynamics.restitution)
            return rate * self.scaled(dynamics.locked.rate(resting), 1.0), 0.0
        if self.n_flights >= self.most_flights:
            raise CurveLostError
        self.n_flights += 1
        landing = self.flight(resting + w * dynamics.impulse_direction(resting), w)
        if landing is None:
            raise CurveLostError
        duration, state_minus, approach_rate = landing
        fall = w - dynamics.speed_after(approach_rate)
        if not fall > 0.0:
            raise CurveLostError
        after = self.on_stop(dynamics.reset_map(state_minus, approach_rate))
        return self.scaled(after - resting, duration) / fall, fall

    def slopes(self, z: Vector, w: Vector) -> tuple[Vector, Vector]:
        """Return the slopes, ``(s, n_x + 1)``, and falls, ``(s,)``, at several points."""
        pairs = [self.slope(point, float(speed)) for point, speed in zip(z, w, strict=True)]
        return np.array([slope for slope, _ in pairs]), np.array([fall for _, fall in pairs])

    def tangents(self, z: Vector) -> Vector:
        """Return an orthonormal basis of the states on the stop near one of them, ``(n_x, m)``."""
        x, unit = z[:-1], self._unit[:-1]
        nudge = _NUDGE * (1 + float(np.max(np.abs(x))))
        columns = [
            (self.dynamics.on_stop((x + nudge * one) * unit) / unit - x) / nudge
            for one in np.eye(len(x))
        ]
        left, sizes, _ = np.linalg.svd(np.array(columns).T)
        return left[:, sizes > _PROJECTED_OUT]

    def derivative(self, z: Vector, w: float, slope: Vector, basis: Vector) -> Vector:
        """Return the derivative of the slope along a basis of states, ``(n_x + 1, m)``.

        Args:
            z: The point, ``(n_x + 1,)``.
            w: Its speed.
            slope: The slope there, ``(n_x + 1,)``.
            basis: Directions, ``(n_x, m)``.
        """
        nudge = _NUDGE * (1 + float(np.max(np.abs(z[:-1]))))
        columns = [self.slope(z + nudge * np.append(one, 0.0), w)[0] - slope for one in basis.T]
        return np.reshape(columns, (len(columns), len(z))).T / nudge


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveEnd:
    """The end of a piece from which it is grown.

    Attributes:
        z: The point, ``(n_x + 1,)``.
        w: The speed.
        basis: Basis of the states on the stop, ``(n_x, m)``.
        slope: :math:`g` there, ``(n_x + 1,)``.
        fall: Fall of the speed in one flight.
        derivative: Derivative of the slope along the basis, ``(n_x + 1, m)``.
    """

    z: Vector
    w: float
    basis: Vector
    slope: Vector
    fall: float
    derivative: Vector

    @property
    def fastest(self) -> float:
        """Largest rate, for a unit of speed, at which neighbouring curves approach each other."""
        rates = np.linalg.eigvals(self.basis.T @ self.derivative[:-1])
        return float(np.max(np.abs(rates), initial=0.0))


def start_at(curve: ImpactCurve, z: Vector, w: float) -> CurveEnd:
    """Return the start of a piece, at the cost of a flight plus one per direction on the stop.

    Args:
        curve: The curve.
        z: The point, ``(n_x + 1,)``.
        w: Speed at the point.

    Raises:
        CurveLostError: If the curve cannot be followed from there.
    """
    basis = curve.tangents(z)
    slope, fall = curve.slope(z, w)
    derivative = curve.derivative(z, w, slope, basis)
    return CurveEnd(z=z, w=w, basis=basis, slope=slope, fall=fall, derivative=derivative)


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvePiece:
    """A polynomial piece of the curve, more or less converged.

    Attributes:
        start: Start of the piece.
        length: Decrease of the speed along the piece.
        nodes: Nodes of the piece, 0 at the start and 1 at its end.
        slopes: :math:`q` at the nodes, ``(s, n_x + 1)``.
        derivatives: Derivatives of :math:`g` at the nodes along the basis, ``(s, n_x + 1, m)``.
        falls: Decrease of the speed in one flight from every node, ``(s,)``.
        changes: Change in every iteration, relative to ``1 + |z|``.
    """

    start: CurveEnd
    length: float
    nodes: Nodes
    slopes: Vector
    derivatives: Vector
    falls: Vector
    changes: tuple[float, ...] = ()

    @property
    def contraction(self) -> float:
        """Least ratio of successive changes, 1 without two. Rounding hides it at the end."""
        return min((then / first for first, then in pairwise(self.changes)), default=1.0)

    @property
    def rest(self) -> float:
        """Change that further iterations would still make, at most."""
        last = self.changes[-1]
        rate = last / self.changes[-2] if len(self.changes) > 1 else 1.0
        return last * min(rate / (1 - rate), 1.0) if rate < 1.0 else last

    @property
    def end(self) -> Vector:
        """The point at its end, ``(n_x + 1,)``."""
        return self.start.z + self.length * self.nodes.whole @ self.slopes

    def speeds(self, places: Vector) -> Vector:
        """Return the speeds at points in ``[0, 1]``. The last speed is exact if it is zero."""
        return np.maximum(self.start.w - self.length * places, 0.0)


def straight_piece(start: CurveEnd, length: float, n: int, slope: Vector) -> CurvePiece:
    """Return a first guess of a piece, a straight line.

    Args:
        start: Start of the piece.
        length: Decrease of the speed along the piece.
        n: Number of nodes.
        slope: Slope of the line.
    """
    return CurvePiece(
        start=start,
        length=length,
        nodes=radau_nodes(n),
        slopes=np.tile(slope, (n, 1)),
        derivatives=np.tile(start.derivative, (n, 1, 1)),
        falls=np.full(n, start.fall),
    )


def refined_piece(piece: CurvePiece, n: int) -> CurvePiece:
    """Return the same polynomial at more nodes, before the next iteration."""
    nodes = radau_nodes(n)
    values = piece.nodes.values(nodes.places)
    return replace(
        piece,
        nodes=nodes,
        slopes=values @ piece.slopes,
        derivatives=np.tensordot(values, piece.derivatives, axes=(1, 0)),
        falls=values @ piece.falls,
        changes=(),
    )


def differentiated(curve: ImpactCurve, piece: CurvePiece) -> CurvePiece:
    """Return the piece after an iteration with derivatives taken at its own nodes."""
    return _iterated(curve, piece, afresh=True)


def iterated(curve: ImpactCurve, piece: CurvePiece) -> CurvePiece:
    r"""Return the piece after one Newton iteration, at the cost of a flight per node.

    .. math:: (A - \Delta\,g_z\,B)\,\delta q = g - A q

    `A` takes means, `B` integrals from the start. Only directions along the stop change `g`, so
    the equations are solved for those first.
    """
    return _iterated(curve, piece, afresh=False)


def converged(
    curve: ImpactCurve, piece: CurvePiece, tolerance: float, *, most: int = 8
) -> CurvePiece:
    """Return the piece iterated until the rest is below a tolerance.

    Args:
        curve: The curve.
        piece: The piece.
        tolerance: Largest remaining relative change.
        most: Largest number of iterations.

    Raises:
        CurveLostError: If the iteration does not converge.
    """
    for _ in range(most):
        piece = iterated(curve, piece)
        if piece.rest <= tolerance / 5:
            return piece
        changes = piece.changes
        if len(changes) > 1 and changes[-1] > _SLOW * changes[-2]:
            # The iteration stopped at rounding level, or the derivatives are inaccurate.
            if changes[-1] <= tolerance:
                return piece
            if len(changes) > 2:
                break
    raise CurveLostError


def correction(curve: ImpactCurve, piece: CurvePiece) -> tuple[Vector, float]:
    """Return the change of the end if the law holds at twice as many points, and its error.

    This is one Newton step from the piece, which has converged at its original nodes. The step
    propagates the defect between the nodes to the end. The result is the error of the piece to
    first order. The step is as inaccurate as the derivatives are, by the part of a change that
    remained in the last iteration. Of the change inside the piece this part may remain at the end.

    Returns:
        The change, ``(n_x + 1,)``, and its error relative to ``1 + |z|``.
    """
    s = len(piece.slopes)
    nodes = doubled_nodes(s)
    between = nodes.places[s:]
    z = piece.start.z + piece.length * piece.nodes.integrals(between) @ piece.slopes
    slopes, falls = curve.slopes(z, piece.speeds(between))
    means = piece.nodes.means(between, falls / piece.length)
    defect = slopes - means @ piece.slopes
    values = piece.nodes.values(between)
    interpolated = np.tensordot(values, piece.derivatives, axes=(1, 0))
    change = _newton(
        nodes,
        nodes.means(nodes.places, np.append(piece.falls, falls) / piece.length),
        piece.length * np.concatenate([piece.derivatives, interpolated]),
        piece.start.basis,
        np.concatenate([np.zeros_like(piece.slopes), defect]),
    )
    inside = relative(piece.length * nodes.integral @ change, piece.end)
    return piece.length * nodes.whole @ change, piece.contraction * inside


def relative(change: Vector, z: Vector) -> float:
    """Return the largest change, relative to ``1 + |z|``."""
    return float(np.max(np.abs(change) / (1 + np.abs(z))))


def _iterated(curve: ImpactCurve, piece: CurvePiece, *, afresh: bool) -> CurvePiece:
    start, nodes, length = piece.start, piece.nodes, piece.length
    speeds = piece.speeds(nodes.places)
    z = start.z + length * nodes.integral @ piece.slopes
    slopes, falls = curve.slopes(z, speeds)
    derivatives = piece.derivatives
    if afresh:
        points = zip(z, speeds, slopes, strict=True)
        derivatives = np.array(
            [curve.derivative(point, float(w), g, start.basis) for point, w, g in points]
        )
    means = nodes.means(nodes.places, falls / length)
    residual = slopes - means @ piece.slopes
    change = _newton(nodes, means, length * derivatives, start.basis, residual)
    size = relative(length * nodes.integral @ change, z)
    if not math.isfinite(size):
        raise CurveLostError
    return replace(
        piece,
        slopes=piece.slopes + change,
        derivatives=derivatives,
        falls=falls,
        changes=(*piece.changes, size),
    )


def _newton(
    nodes: Nodes, means: Vector, derivatives: Vector, basis: Vector, residual: Vector
) -> Vector:
    """Return Newton's change of the slopes at the nodes, ``(s, n_x + 1)``."""
    s, m = len(residual), basis.shape[1]
    on_stop = np.einsum("nm,snk->smk", basis, derivatives[:, :-1])
    blocks = np.einsum("ij,kl->ikjl", means, np.eye(m))
    blocks -= np.einsum("ij,ikl->ikjl", nodes.integral, on_stop)
    matrix: Vector = np.reshape(blocks, (s * m, s * m))
    change = np.reshape(_solved(matrix, np.ravel(residual[:, :-1] @ basis)), (s, m))
    carried = np.einsum("snk,sk->sn", derivatives, nodes.integral @ change)
    return _solved(means, residual + carried)


def _solved(matrix: Vector, right: Vector) -> Vector:
    return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
