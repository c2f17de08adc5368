r"""A Zeno passage at a cost that does not grow as :math:`e \to 1` (theory (2.8)).

A resolved impact sequence needs about :math:`\ln 1000 / (1 - e)` flights to lose three decades of
speed. But its impacts lie on an analytic curve, which is found without the impacts. The curve is a
polynomial in the speed that satisfies the law of a flight at its nodes, down to :math:`w = 0`. For
any nodes along the curve, the curve has a single end: the Zeno point.

A single polynomial with 4, then 8, then 16 nodes is tried for the whole curve. If that is not
enough, the curve is computed piece by piece. Pieces are needed just after a sequence has begun with
an arbitrary current, which relaxes to the current of the curve within a few `L/R`. This is a
boundary layer at the start of the curve.

The skipped impacts are never computed one by one, and intermediate ends of pieces do not belong to
the sequence. If the end is not reached, for instance because contact ends before the speed has
decreased to zero, the result is ``None``. Then the sequence must be followed flight by flight.
`is_settled` decides from the impacts so far whether their curve is worth a try.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import UNIT_SCALES, CharacteristicScales, HybridDynamics
from zeno_orbits.simulation.zeno.impact_curve import (
    CurveEnd,
    CurveLostError,
    CurvePiece,
    ImpactCurve,
    converged,
    correction,
    differentiated,
    iterated,
    refined_piece,
    relative,
    start_at,
    straight_piece,
)
from zeno_orbits.simulation.zeno.rescaled_flight import Flight
from zeno_orbits.simulation.zeno.zeno_limit import TailEstimate, ZenoLimit

_FEW, _SOME, _MANY = 4, 8, 16
"""Nodes of a piece: to see its shape, usually enough, and most."""

_FEWEST_IMPACTS = 16
"""A piece that passes fewer impacts costs more than they."""

_MOST_PIECES = 8
"""Largest number of pieces of a curve. Pieces become ever shorter if the curve ends in a
release."""

_SHAPE = 1e-3
"""Relative error of a piece with few nodes before more are tried."""
_HOPELESS_FEW, _HOPELESS_SOME = 3e-3, 3e-5
"""A larger error at few, and at some nodes, will not fall below 1e-12 at many."""

_CAUTION = 2.0
"""Claimed over estimated error: near a layer the estimate has been seen a fifth too small."""

_LATER = 3.0
"""Contraction of later iterations over that of the first two, at most about: 2.5 has been seen."""

_LAYER = 20.0
"""Decay along a piece, as a power of e, above which a layer at its start may be to blame."""
_FIRST_DECAY, _NEXT_DECAY = 6.0, 5.4
"""Decay along the first piece of a layer, and additional decay per decade already passed."""
_PASSED = 8.0
"""Number of decades after which a layer has decayed."""

_ROUNDING = 16 * float(np.finfo(np.float64).eps)
"""Rounding error of the limit, in units of `1 / (1 - e)`. Measured errors stay four times below."""

_LOST = 0.25
"""Factor of the length of a piece after a diverged iteration."""
_ORDER = 6
"""Order at which errors are taken to fall with the length of a piece."""
_MAY_BEND = 0.5
"""A straight line along which d2h/dt2 changes by more than this factor is a bad first guess."""


def pass_through(
    dynamics: HybridDynamics,
    flight: Flight,
    time: float,
    state: Vector,
    speed: float,
    tolerance: float,
    *,
    most_flights: int,
) -> ZenoLimit | None:
    """Return the Zeno point after an impact, or ``None`` if it could not be found.

    Args:
        dynamics: The system.
        flight: One rescaled flight. Its errors are magnified by ``1 / (1 - e)``, so it should be
            accurate to rounding.
        time: Time of the impact [s].
        state: State just after the impact, with or without its gap rate.
        speed: Exact gap rate just after the impact.
        tolerance: Largest estimated error of a piece, relative to ``1 + |x|``. The error of the
            limit is twice the sum over its few pieces, with the doubt of each. It is at least
            ``1e-14 / (1 - e)``, due to rounding.
        most_flights: Largest number of flights.
    """
    curve = ImpactCurve(dynamics, flight, most_flights)
    rounding = _ROUNDING / (1 - dynamics.restitution)
    allowed = max(tolerance, 2 * rounding)
    z, w, error = curve.scaled(dynamics.on_stop(state), 0.0), speed, rounding
    layer = _Layer(decades=math.inf)
    path: list[CurveStep] = []
    try:
        for _ in range(_MOST_PIECES):
            passed = _longest_piece(curve, start_at(curve, z, w), layer, allowed)
            z, layer = passed.step.end, passed.layer
            error += _CAUTION * (passed.error + passed.doubt)
            path.append(passed.step)
            w -= passed.step.piece.length
            if w == 0.0:
                break
    except CurveLostError:
        return None
    *end, passed_time = curve.plain(z)
    resting = dynamics.on_stop(np.array(end))
    if w > 0.0 or not dynamics.gap_acceleration(resting) < 0.0:
        return None
    return ZenoLimit(time=time + float(passed_time), state=resting, error=error, path=tuple(path))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Layer:
    """A layer at the start of the curve.

    Attributes:
        decades: Decay of the layer, infinite without evidence of a layer.
    """

    decades: float

    def length(self, start: CurveEnd) -> float:
        """Return the largest length of a piece that the layer permits."""
        if self.decades > _PASSED or start.fastest == 0.0:
            return start.w
        return min(start.w, (_FIRST_DECAY + _NEXT_DECAY * self.decades) / start.fastest)

    def behind(self, start: CurveEnd, length: float) -> _Layer:
        """Return the layer after a piece."""
        return _Layer(decades=self.decades + start.fastest * length / math.log(10))


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveStep:
    """A piece of the curve, read along time: the state on the stop, below the flights.

    Attributes:
        curve: The curve.
        piece: The polynomial.
        missed: Correction of the end, ``(n_x + 1,)``, applied linearly along the piece.
    """

    curve: ImpactCurve
    piece: CurvePiece
    missed: Vector

    @property
    def end(self) -> Vector:
        """The point at its end, ``(n_x + 1,)``."""
        return self.piece.end + self.missed

    @property
    def start(self) -> float:
        """Time at its start, from the impact at which the curve starts."""
        return float(self.curve.plain(self.piece.start.z)[-1])

    @property
    def size(self) -> float:
        """Its length in time."""
        return float(self.curve.plain(self.end)[-1]) - self.start

    @property
    def before(self) -> Vector:
        """State at its start, ``(n_x,)``."""
        return self.curve.plain(self.piece.start.z)[:-1]

    @property
    def after(self) -> Vector:
        """State at its end, ``(n_x,)``."""
        return self.curve.plain(self.end)[:-1]

    def state_at(self, offset: float) -> Vector:
        """Return the state ``offset`` after its start, ``(n_x,)``."""
        if offset <= 0.0:
            return self.before
        if offset >= self.size:
            return self.after
        from scipy.optimize import brentq

        place = brentq(lambda at: self._point(at)[-1] - self.start - offset, 0.0, 1.0, xtol=1e-15)
        return self._point(float(place))[:-1]

    def end_at(self, offset: float) -> Vector:
        """Return the same: the polynomial is as good everywhere."""
        return self.state_at(offset)

    def _point(self, place: float) -> Vector:
        piece = self.piece
        along = piece.nodes.integrals(np.array([place]))[0] @ piece.slopes
        return self.curve.plain(piece.start.z + piece.length * along + place * self.missed)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Passed:
    """A converged piece, its estimated relative error with its doubt, and the layer after it."""

    step: CurveStep
    error: float
    doubt: float
    layer: _Layer


@dataclass(frozen=True, slots=True, kw_only=True)
class _TooLong:
    """A piece that failed.

    Attributes:
        part: Fraction of its length for the next trial.
        rough: Whether it failed even with few nodes, possibly because of a boundary layer.
    """

    part: float
    rough: bool


def _longest_piece(curve: ImpactCurve, start: CurveEnd, layer: _Layer, tolerance: float) -> _Passed:
    """Return a converged piece, as long as possible.

    Raises:
        CurveLostError: If the piece would be so short that its cost is too high.
    """
    length = layer.length(start)
    while length >= _FEWEST_IMPACTS * start.fall and curve.n_flights < curve.most_flights:
        try:
            outcome = _attempt(curve, start, length, layer, tolerance)
        except CurveLostError:
            outcome = _TooLong(part=_LOST, rough=True)
        if isinstance(outcome, _Passed):
            return outcome
        in_layer = outcome.rough and start.fastest * length > _LAYER
        if in_layer and layer.decades > _PASSED:
            layer = _Layer(decades=0.0)
        length = min(outcome.part * length, layer.length(start))
    raise CurveLostError


def _attempt(
    curve: ImpactCurve, start: CurveEnd, length: float, layer: _Layer, tolerance: float
) -> _Passed | _TooLong:
    """Return a piece of a length, or a shorter length.

    Raises:
        CurveLostError: If an iteration diverges or leaves the curve.
    """
    piece = _shaped(curve, start, length)
    piece = iterated(curve, refined_piece(piece, _SOME))
    shape = piece.changes[0]
    if shape > _HOPELESS_FEW:
        return _shorter(_HOPELESS_FEW / 3, shape, rough=True)
    if shape**2 <= 100 * tolerance:
        piece = converged(curve, piece, tolerance)
        passed = _passed(curve, piece, layer)
        if passed.error <= tolerance:
            return passed
    elif shape > _HOPELESS_SOME / 3:
        piece = iterated(curve, piece)
    piece = iterated(curve, refined_piece(piece, _MANY))
    if piece.changes[0] > _HOPELESS_SOME:
        return _shorter(_HOPELESS_SOME / 10, piece.changes[0], rough=True)
    passed = _passed(curve, converged(curve, piece, tolerance), layer)
    if passed.error <= tolerance:
        return passed
    return _shorter(tolerance, passed.error, rough=False)


def _shaped(curve: ImpactCurve, start: CurveEnd, length: float) -> CurvePiece:
    """Return a rough piece with few nodes and good derivatives."""
    dynamics = curve.dynamics
    end = dynamics.on_stop(curve.plain(start.z + length * start.slope)[:-1])
    begin = curve.plain(start.z)[:-1]
    bend = dynamics.gap_acceleration(end) / dynamics.gap_acceleration(begin)
    slope = start.slope if _MAY_BEND < bend < 1 / _MAY_BEND else np.zeros_like(start.slope)
    piece = iterated(curve, straight_piece(start, length, _FEW, slope))
    piece = differentiated(curve, piece)
    for _ in range(2):
        if piece.rest <= _SHAPE:
            return piece
        piece = iterated(curve, piece)
    if piece.rest > _SHAPE:
        raise CurveLostError
    return piece


def _passed(curve: ImpactCurve, piece: CurvePiece, layer: _Layer) -> _Passed:
    missed, doubt = correction(curve, piece)
    return _Passed(
        step=CurveStep(curve=curve, piece=piece, missed=missed),
        error=relative(missed, piece.end) + piece.rest,
        doubt=_LATER * doubt,
        layer=layer.behind(piece.start, piece.length),
    )


def _shorter(wanted: float, error: float, *, rough: bool) -> _TooLong:
    """Return the factor for a shorter piece. Errors of layers decrease at least this fast."""
    return _TooLong(part=min(max((wanted / error) ** (1 / _ORDER), 0.1), 0.6), rough=rough)


_DIFFERENCES = 4
"""Number of differences of successive impacts that separate a transient from the curve."""
_SEEN = 3e-14
"""A relative difference below this is rounding."""
_SMOOTH = 0.01
"""Fourth difference along a curve, for a unit of `(1 - e)^4`, at most about."""
_DECAYED = 1e-12
"""Amplitude of a transient that is over."""
_WORTH_WAITING = 150
"""Impacts that cost less than the pieces of a layer."""


def is_settled(
    estimates: Sequence[TailEstimate], restitution: float, own: CharacteristicScales = UNIT_SCALES
) -> bool:
    r"""Return True if the curve of the impacts is worth a try, judged by the last six impacts.

    Along the curve a state changes smoothly over :math:`1 / (1 - e)` impacts, and the fourth
    difference of successive states is of the order :math:`(1 - e)^4`. A transient :math:`a \mu^k`
    adds :math:`a (1 - \mu)^4 \mu^k`, and two such differences determine `a` and :math:`\mu`. If the
    transient decays in a few impacts, these impacts are better simulated. A transient over many
    impacts is a boundary layer of the curve.

    Args:
        estimates: One estimate per impact.
        restitution: :math:`e`.
        own: Characteristic scales of the problem.
    """
    if len(estimates) < _DIFFERENCES + 2:
        return False
    states = np.array([estimate.resting for estimate in estimates[-_DIFFERENCES - 2 :]])
    states = states / own.states(states.shape[1])
    differences = np.diff(states, n=_DIFFERENCES, axis=0)
    before, now = (relative(difference, states[-1]) for difference in differences)
    if now <= _SEEN + _SMOOTH * (1 - restitution) ** _DIFFERENCES or now >= before:
        return True
    ratio = now / before
    amplitude = now / (1 - ratio) ** _DIFFERENCES
    return math.log(amplitude / _DECAYED) > -_WORTH_WAITING * math.log(ratio)
