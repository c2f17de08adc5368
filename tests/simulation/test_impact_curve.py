"""The curve of the impacts, function by function, on laws that are linear or known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
import pytest

from tests.support.mechanisms import bead_on_disc, fading_ball
from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import RungeKutta, Tolerance, doubled_nodes, radau_nodes
from zeno_orbits.model import CharacteristicScales, HybridDynamics
from zeno_orbits.simulation.zeno import impact_curve
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
from zeno_orbits.simulation.zeno.rescaled_flight import Flight, rescaled_flights

FINE = Tolerance(relative=1e-14, absolute=1e-15)
ROUNDING = 1e-12
WEIGHT, E = 10.0, 0.75


def _curve(
    dynamics: HybridDynamics, flight: Flight | None = None, most_flights: int = 100
) -> ImpactCurve:
    usual = rescaled_flights(dynamics, RungeKutta(), FINE)
    return ImpactCurve(dynamics, flight or usual, most_flights)


def _no_flight(state_plus: Vector, speed: float) -> tuple[float, Vector, float] | None:
    del state_plus, speed
    raise AssertionError


# Points.


def test_points_are_measured_in_the_sizes_of_the_problem() -> None:
    own = CharacteristicScales(time=100.0, sizes=(10.0, 1.0, 5.0))
    curve = _curve(replace(fading_ball(WEIGHT, 0.0, E), scaling=lambda: own))
    x = np.array([20.0, 3.0, -10.0, 4.0])
    point = curve.scaled(x, 300.0)
    assert point.tolist() == [2.0, 3.0, -2.0, 4.0, 3.0]
    assert curve.plain(point).tolist() == [*x, 300.0]


@dataclass
class _Falling:
    """A stop onto which every move leaves one more of some gaps."""

    gaps: tuple[float, ...]
    own: CharacteristicScales
    moves: int = 0
    state_names: tuple[str, ...] = ("x", "v")

    def on_stop(self, x: Vector) -> Vector:
        self.moves += 1
        return x.copy()

    def gap(self, x: Vector) -> float:
        del x
        return self.gaps[self.moves - 1]


@pytest.mark.parametrize(
    ("gaps", "moves"),
    [
        # The rounding of numbers eleven times as large as usual: 4e-16 times 2 times 11.
        ((8.7e-15,), 1),
        ((4e-16 * 2.0 * 11.0,), 1),
        ((8.9e-15, 0.0), 2),
        ((-8.9e-15, -8.7e-15), 2),
        ((1.0, 1.0, 1.0, 1.0), 4),
    ],
)
def test_a_state_is_moved_onto_the_stop_until_its_gap_is_rounding(
    gaps: tuple[float, ...], moves: int
) -> None:
    stop = _Falling(gaps=gaps, own=CharacteristicScales(time=7.0, gap=2.0, sizes=(10.0, 5.0)))
    curve = ImpactCurve(cast("HybridDynamics", stop), _no_flight, 0)
    assert curve.on_stop(np.array([30.0, -50.0])).tolist() == [30.0, -50.0]
    assert stop.moves == moves


# The slope.


@pytest.mark.parametrize("w", [0.0, 1e-2, 0.3])
def test_the_slope_of_a_ball_of_constant_weight_is_the_same_at_every_speed(w: float) -> None:
    own = CharacteristicScales(time=4.0, sizes=(1.0, 2.0, 1.0, 1.0))
    dynamics = replace(fading_ball(WEIGHT, 0.0, E), scaling=lambda: own)
    curve = _curve(dynamics)
    slope, fall = curve.slope(np.array([0.0, 0.7, 0.0, 1.5, 9.0]), w)
    # A flight of 2 w / g takes (1 - e) w away; the clock runs at 1.5.
    rate = 2 / (WEIGHT * (1 - E))
    expected = [0.0, 1.5 * rate / 2, 0.0, 0.0, rate / 4]
    # A rounding of the clock is divided by the fall.
    rounding = 1e-12
    assert slope == pytest.approx(expected, abs=rounding)
    assert fall == pytest.approx((1 - E) * w, rel=1e-13, abs=0.0)
    assert curve.n_flights == (0 if w == 0.0 else 1)
    # What a state had of a gap and a gap rate does not count.
    off = np.array([1e-3, 0.7, 0.2, 1.5, 9.0])
    assert curve.slope(off, w)[0] == pytest.approx(slope, abs=rounding)


def test_a_flight_begins_with_the_speed_and_its_end_is_moved_onto_the_stop() -> None:
    dynamics = bead_on_disc(E)
    begun: list[tuple[Vector, float]] = []
    # At the top, moving along the disc: the flight comes down 0.1 farther with the speed -0.2.
    landed = np.array([0.6, 0.8, 0.5, -0.3])

    def flight(state_plus: Vector, speed: float) -> tuple[float, Vector, float]:
        begun.append((state_plus, speed))
        return 0.25, landed, float(dynamics.gap_rate(landed))

    curve = _curve(dynamics, flight)
    slope, fall = curve.slope(np.array([0.0, 1.0, 0.5, 0.0, 0.0]), 0.3)
    ((state, speed),) = begun
    assert speed == 0.3
    # The gap rate is twice the velocity off the disc.
    assert state == pytest.approx([0.0, 1.0, 0.5, 0.15], abs=1e-15)
    # 2 (0.3 - 0.24) = 0.12 opens: the law of impact gives -e times that.
    assert fall == pytest.approx(0.3 + E * 0.12, rel=1e-14)
    along = 0.8 * 0.5 + 0.6 * 0.3
    after = np.array([0.6, 0.8, 0.8 * along, -0.6 * along])
    change = np.append(after - [0.0, 1.0, 0.5, 0.0], 0.25)
    assert slope == pytest.approx(change / fall, abs=1e-14)


def test_the_slope_ends_where_the_stop_lets_go_speeds_do_not_fall_or_flights_run_out() -> None:
    fading = fading_ball(WEIGHT, 5.0, 0.5)
    # The weight is gone at the clock 2, exactly.
    gone = np.array([0.0, 2.0, 0.0, 1.0, 0.0])
    here = np.array([0.0, 1.0, 0.0, 1.0, 0.0])
    for w in (0.0, 0.1):
        with pytest.raises(CurveLostError):
            _curve(fading, _no_flight).slope(gone, w)
    with pytest.raises(CurveLostError):
        _curve(fading, lambda _x, _w: None).slope(here, 0.1)
    # Back at -0.2, it leaves with the 0.1 that it had.
    with pytest.raises(CurveLostError):
        _curve(fading, lambda x, _w: (0.1, x, -0.2)).slope(here, 0.1)
    curve = _curve(fading, most_flights=2)
    curve.slopes(np.array([here, here]), np.array([0.1, 0.2]))
    with pytest.raises(CurveLostError):
        curve.slope(here, 0.1)
    assert curve.n_flights == 2
    # At no speed no flight is needed.
    assert curve.slope(here, 0.0)[1] == 0.0


def test_the_slopes_at_several_points_are_those_of_each() -> None:
    curve = _curve(fading_ball(WEIGHT, 5.0, E))
    points = np.array([[0.0, clock, 0.0, 1.0, 0.0] for clock in (0.1, 0.5, 0.9)])
    speeds = np.array([0.2, 0.1, 0.0])
    slopes, falls = curve.slopes(points, speeds)
    for point, w, slope, fall in zip(points, speeds, slopes, falls, strict=True):
        one = curve.slope(point, float(w))
        assert slope.tolist() == one[0].tolist()
        assert fall == one[1]
    with pytest.raises(ValueError, match="shorter"):
        curve.slopes(points, speeds[:2])


# Directions on the stop and derivatives along them.


@pytest.mark.parametrize("clock", [0.5, 1.0, -1.0, -1e12])
def test_directions_on_the_stop_are_seen_however_large_the_state(clock: float) -> None:
    curve = _curve(fading_ball(WEIGHT, 0.0, E))
    basis = curve.tangents(np.array([0.0, clock, 0.0, 0.25, 3.0]))
    # Gap and gap rate are the first and third entry.
    assert basis.shape == (4, 2)
    assert basis[[0, 2]] == pytest.approx(np.zeros((2, 2)), abs=1e-9)
    assert basis.T @ basis == pytest.approx(np.eye(2), abs=ROUNDING)


def test_directions_on_a_curved_stop_keep_gap_and_gap_rate_in_the_sizes_of_the_problem() -> None:
    sizes = np.array([2.0, 0.5, 4.0, 0.25])
    own = CharacteristicScales(time=8.0, sizes=tuple(sizes.tolist()))
    curve = _curve(replace(bead_on_disc(E), scaling=lambda: own))
    x, y, along = 0.6, 0.8, 0.5
    basis = curve.tangents(np.append(np.array([x, y, along * y, -along * x]) / sizes, 3.0))
    assert basis.shape == (4, 2)
    gradients = np.array([[x, y, 0.0, 0.0], [along * y, -along * x, x, y]])
    # Differences of first order at 1e-5, on a disc of curvature 1.
    assert gradients @ (sizes[:, None] * basis) == pytest.approx(np.zeros((2, 2)), abs=1e-3)


@pytest.mark.parametrize("clock", [0.0, 1.0, -1.0, -1e12])
@pytest.mark.parametrize("w", [0.0, 1e-3])
def test_the_derivative_of_the_slope_is_that_of_differences(clock: float, w: float) -> None:
    # The weight is 10 - b y, and changes by a tenth when the clock goes on by its own size.
    b = 1.0 / max(abs(clock), 1.0)
    curve = _curve(fading_ball(WEIGHT, b, E))
    z, basis = np.array([0.0, clock, 0.0, 0.25, 3.0]), np.eye(4)[:, [1, 3]]
    slope, _ = curve.slope(z, w)
    found = curve.derivative(z, w, slope, basis)
    assert found.shape == (5, 2)
    # Of 2 / (a (1 - e)) (0, dy, 0, 0, 1) but for the speed, which counts by w b dy / a^2.
    rate = 2 / ((WEIGHT - b * clock) * (1 - E))
    by_clock = rate * b / (WEIGHT - b * clock)
    expected = np.zeros((5, 2))
    expected[1] = 0.25 * by_clock, rate
    expected[4, 0] = by_clock
    # Differences of first order at 1e-5 of the state.
    assert found[1] == pytest.approx(expected[1], rel=1e-3)
    assert found[4, 0] == pytest.approx(expected[4, 0], rel=1e-3)


def test_a_curve_is_grown_from_its_slope_and_the_derivative_along_the_stop() -> None:
    curve = _curve(fading_ball(WEIGHT, 1.0, E))
    z = np.array([0.0, 0.5, 0.0, 1.0, 2.0])
    start = start_at(curve, z, 0.1)
    # A flight, and one for each of the two directions on the stop.
    assert curve.n_flights == 3
    slope, fall = curve.slope(z, 0.1)
    assert start.z is z
    assert start.w == 0.1
    assert start.slope.tolist() == slope.tolist()
    assert start.fall == fall
    along = curve.derivative(z, 0.1, slope, np.eye(4)[:, [1, 3]])
    assert start.derivative @ start.basis[[1, 3]].T == pytest.approx(along, abs=1e-9)


# A law that is linear in the state, on a stop of two dimensions among three states.

BASIS = np.linalg.qr(np.array([[1.0, 0.3], [0.2, -1.0], [0.5, 0.4]]))[0]
LAW = np.zeros((4, 4))
LAW[:3, :3] = BASIS @ np.array([[0.7, -0.4], [0.2, 0.5]]) @ BASIS.T
LAW[3, :3] = BASIS @ (0.3, -0.6)
"""Of the slope by the point: only the state on the stop counts, and the slope keeps to it."""
LOSS = 0.4
Z = np.append(BASIS @ (0.8, -1.7), 0.5)


def _forcing(w: float) -> Vector:
    return np.append(BASIS @ (np.sin(3 * w), 1 - w**2), np.cos(2 * w))


@dataclass
class _Linear:
    """A curve whose slope is linear in the point."""

    asked: list[int] = field(default_factory=list[int])
    scale: float = 1.0

    def slopes(self, z: Vector, w: Vector) -> tuple[Vector, Vector]:
        self.asked.append(len(w))
        forcing = np.array([_forcing(float(speed)) for speed in w])
        return self.scale * (z @ LAW.T + forcing), LOSS * w

    def derivative(self, z: Vector, w: float, slope: Vector, basis: Vector) -> Vector:
        assert slope == pytest.approx(LAW @ z + _forcing(w), abs=ROUNDING)
        return LAW[:, :3] @ basis


def _linear(**values: Any) -> ImpactCurve:
    return cast("ImpactCurve", _Linear(**values))


def _start(w: float = 0.9) -> CurveEnd:
    return CurveEnd(
        z=Z,
        w=w,
        basis=BASIS,
        slope=LAW @ Z + _forcing(w),
        fall=LOSS * w,
        derivative=LAW[:, :3] @ BASIS,
    )


def _places(piece: CurvePiece) -> Vector:
    """Return the points at the nodes of a piece."""
    return piece.start.z + piece.length * piece.nodes.integral @ piece.slopes


def _off(piece: CurvePiece) -> float:
    """Return by how much a piece misses the law at its nodes."""
    speeds = piece.speeds(piece.nodes.places)
    slopes, falls = _linear().slopes(_places(piece), speeds)
    means = piece.nodes.means(piece.nodes.places, falls / piece.length)
    return float(np.max(np.abs(means @ piece.slopes - slopes)))


def test_a_straight_piece_has_its_slope_and_the_numbers_of_its_start_at_every_node() -> None:
    start = _start()
    slope = np.array([1.0, -2.0, 0.5, 3.0])
    piece = straight_piece(start, 0.6, 5, slope)
    assert piece.nodes is radau_nodes(5)
    assert piece.slopes.tolist() == [slope.tolist()] * 5
    assert piece.derivatives.tolist() == [start.derivative.tolist()] * 5
    assert piece.falls.tolist() == [start.fall] * 5
    assert piece.end == pytest.approx(Z + 0.6 * slope, abs=1e-15)
    assert piece.speeds(np.array([0.0, 0.5, 1.0])) == pytest.approx([0.9, 0.6, 0.3], abs=1e-15)


def test_a_speed_that_rounding_has_below_zero_is_zero() -> None:
    piece = straight_piece(_start(0.3), 3 * 0.1, 4, Z)
    assert 0.3 - 3 * 0.1 < 0.0
    assert piece.speeds(np.array([0.0, 1.0])).tolist() == [0.3, 0.0]


@pytest.mark.parametrize("length", [0.6, 0.9])
def test_one_iteration_keeps_a_linear_law_at_every_node(length: float) -> None:
    piece = straight_piece(_start(), length, 5, np.array([0.3, -1.0, 0.5, 2.0]))
    assert _off(piece) > 0.1
    curve = _Linear()
    once = iterated(cast("ImpactCurve", curve), piece)
    assert _off(once) < ROUNDING
    assert curve.asked == [5]
    assert once.falls == pytest.approx(LOSS * piece.speeds(piece.nodes.places), abs=1e-15)
    moved = np.abs(_places(once) - _places(piece)) / (1 + np.abs(_places(piece)))
    assert once.changes == pytest.approx([np.max(moved)], rel=1e-12)
    twice = iterated(_linear(), once)
    assert twice.changes[0] == once.changes[0]
    assert twice.changes[1] < ROUNDING
    assert twice.end == pytest.approx(once.end, abs=ROUNDING)
    assert twice.derivatives is once.derivatives


def test_derivatives_that_are_no_good_are_taken_at_the_nodes_themselves() -> None:
    start = replace(_start(), derivative=np.zeros((4, 2)))
    piece = straight_piece(start, 0.6, 5, np.array([0.3, -1.0, 0.5, 2.0]))
    assert _off(iterated(_linear(), piece)) > 1e-3
    found = differentiated(_linear(), piece)
    assert _off(found) < ROUNDING
    assert found.derivatives == pytest.approx(np.tile(LAW[:, :3] @ BASIS, (5, 1, 1)), abs=1e-15)


def test_an_iteration_that_is_not_finite_is_lost() -> None:
    piece = straight_piece(_start(), 0.6, 4, Z)
    with pytest.raises(CurveLostError):
        iterated(_linear(scale=np.nan), piece)


def test_a_piece_at_more_nodes_is_the_same_polynomial() -> None:
    nodes = radau_nodes(4)
    powers = np.arange(4)
    random = np.random.default_rng(1)
    slopes, derivatives = random.normal(size=(4, 4)), random.normal(size=(4, 4, 2))

    def at(places: Vector, coefficients: Vector) -> Vector:
        return np.tensordot(places[:, None] ** powers, coefficients, axes=(1, 0))

    piece = replace(
        straight_piece(_start(), 0.6, 4, Z),
        slopes=at(nodes.places, slopes),
        derivatives=at(nodes.places, derivatives),
        falls=at(nodes.places, np.array([0.4, -0.3, 0.0, 0.0])),
        changes=(1.0, 0.5),
    )
    finer = refined_piece(piece, 7)
    places = radau_nodes(7).places
    assert finer.nodes is radau_nodes(7)
    assert finer.slopes == pytest.approx(at(places, slopes), abs=ROUNDING)
    assert finer.derivatives == pytest.approx(at(places, derivatives), abs=ROUNDING)
    assert finer.falls == pytest.approx(0.4 - 0.3 * places, abs=ROUNDING)
    assert finer.changes == ()
    assert finer.end == pytest.approx(piece.end, abs=ROUNDING)


def test_the_correction_of_a_piece_is_what_twice_as_many_nodes_change_at_its_end() -> None:
    s, length = 3, 0.6
    piece = iterated(_linear(), straight_piece(_start(), length, s, Z))
    curve = _Linear()
    found = correction(cast("ImpactCurve", curve), piece)
    assert curve.asked == [s]
    # The law at all nodes at once, for every entry of the slopes there.
    nodes = doubled_nodes(s)
    speeds = 0.9 - length * nodes.places
    means = nodes.means(nodes.places, LOSS * speeds / length)
    matrix = np.kron(means, np.eye(4)) - length * np.kron(nodes.integral, LAW)
    forcing = [LAW @ Z + _forcing(float(w)) for w in speeds]
    slopes = np.linalg.solve(matrix, np.ravel(forcing)).reshape(2 * s, 4)
    expected = Z + length * nodes.whole @ slopes - piece.end
    assert np.max(np.abs(expected)) > 1e-5
    assert found == pytest.approx(expected, abs=ROUNDING)


# How far iterations have come.


def test_a_change_is_relative_to_one_and_the_number() -> None:
    assert relative(np.array([0.1, -0.6, 0.3]), np.array([0.0, -3.0, 1.0])) == pytest.approx(0.15)
    assert relative(np.array([0.1, -0.9, 0.3]), np.array([0.0, -3.0, 1.0])) == pytest.approx(0.225)


@pytest.mark.parametrize(
    ("changes", "rest"),
    [
        # Nothing is known of the rate.
        ((0.1,), 0.1),
        # The sum of a geometric series, but no more than the last change.
        ((0.1, 0.02), 0.005),
        ((9.0, 0.1, 0.02), 0.005),
        ((9.0, 0.1, 0.08), 0.08),
        ((0.1, 0.1), 0.1),
        ((0.1, 0.2), 0.2),
    ],
)
def test_further_iterations_change_what_a_series_of_the_last_two_would(
    changes: tuple[float, ...], rest: float
) -> None:
    piece = replace(straight_piece(_start(), 0.6, 4, Z), changes=changes)
    assert piece.rest == pytest.approx(rest, rel=1e-12)


Scripted = Callable[[ImpactCurve, CurvePiece], CurvePiece]


def _scripted(*changes: float) -> Scripted:
    left = list(changes)

    def one(_curve: ImpactCurve, piece: CurvePiece) -> CurvePiece:
        return replace(piece, changes=(*piece.changes, left.pop(0)))

    return one


@pytest.mark.parametrize(
    ("tolerance", "changes", "n"),
    [
        # A fifth of the tolerance is left, at most.
        (1.25, (0.25, 9.0), 1),
        (1.25, (0.26, 0.01, 9.0), 2),
        # Slower than by halves, but below the tolerance: rounding.
        (0.75, (1.0, 0.75, 9.0), 2),
        (1e-6, (3e-6, 0.9e-6, 0.8e-6, 9.0), 3),
        (1e-6, (2e-6, 1.5e-6, 0.9e-6, 9.0), 3),
        # One slow iteration may be the first guess's fault.
        (1e-6, (1.0, 0.6, 1e-3, 1e-6, 1e-9, 9.0), 4),
    ],
)
def test_iterations_end_at_the_tolerance_or_at_rounding_below_it(
    monkeypatch: pytest.MonkeyPatch, tolerance: float, changes: tuple[float, ...], n: int
) -> None:
    monkeypatch.setattr(impact_curve, "iterated", _scripted(*changes))
    piece = straight_piece(_start(), 0.6, 4, Z)
    assert converged(_linear(), piece, tolerance).changes == changes[:n]


@pytest.mark.parametrize(
    ("changes", "n"),
    [
        ((1.0, 0.6, 0.4), 3),
        ((1.0, 0.1, 0.06), 3),
        # Falling by halves is no slowness, but eight iterations are enough.
        (tuple(0.5**k for k in range(8)), 8),
    ],
)
def test_iterations_that_do_not_converge_are_lost(
    monkeypatch: pytest.MonkeyPatch, changes: tuple[float, ...], n: int
) -> None:
    made: list[float] = []
    one = _scripted(*changes)

    def counted(curve: ImpactCurve, piece: CurvePiece) -> CurvePiece:
        after = one(curve, piece)
        made.append(after.changes[-1])
        return after

    monkeypatch.setattr(impact_curve, "iterated", counted)
    with pytest.raises(CurveLostError):
        converged(_linear(), straight_piece(_start(), 0.6, 4, Z), 1e-9)
    assert len(made) == n
