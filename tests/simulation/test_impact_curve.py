"""The curve of the impacts, function by function, on laws that are linear or known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
import pytest
from scipy.integrate import DOP853, LSODA

from tests.reference.closed_forms import FORCED
from tests.support.mechanisms import (
    bead_on_disc,
    fading_ball,
    falling_away,
    forced_oscillator,
    oscillator_state,
)
from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import RungeKutta, SciPy, Stepper, Tolerance, radau_nodes
from zeno_orbits.model import CharacteristicScales, HybridDynamics
from zeno_orbits.simulation.zeno.impact_curve import (
    CurveEnd,
    CurveLostError,
    CurvePiece,
    ImpactCurve,
    iterated,
    refined_piece,
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


# How far iterations have come.


@pytest.mark.parametrize("speed", [1.0, 1e-3, 1e-9, 1e-200])
def test_a_flight_of_a_ball_lasts_as_long_as_in_the_textbook(speed: float) -> None:
    flight = rescaled_flights(fading_ball(10.0, 0.0, 0.9), RungeKutta(), FINE)
    landing = flight(np.array([0.0, 0.0, speed, 1.0]), speed)
    assert landing is not None
    duration, state, rate = landing
    assert duration == pytest.approx(speed / 5, rel=1e-14)
    assert rate == pytest.approx(-speed, rel=1e-14)
    assert state[1] == pytest.approx(speed / 5, rel=1e-14)


@pytest.mark.parametrize("engine", [RungeKutta(), SciPy(method=DOP853), SciPy(method=LSODA)])
@pytest.mark.parametrize("speed", [0.3, 1e-2, 1e-6])
def test_a_flight_ends_where_its_power_series_does(engine: Stepper, speed: float) -> None:
    dynamics = forced_oscillator(FORCED, FORCED.restitution)
    tolerance = Tolerance(relative=1e-12, absolute=1e-13)
    flight = rescaled_flights(dynamics, engine, tolerance)
    landing = flight(np.array(oscillator_state(0.4, FORCED.stop, -speed)), speed)
    assert landing is not None
    duration, approach = FORCED.short_flight(0.4, speed)
    assert landing[0] == pytest.approx(duration, rel=1e-9)
    assert -landing[2] == pytest.approx(approach, rel=1e-9)


def test_a_flight_that_the_stop_does_not_pull_back_is_given_up() -> None:
    flight = rescaled_flights(falling_away(1.0), RungeKutta(), FINE)
    assert flight(np.array([0.0, 0.1]), 0.1) is None


def test_a_flight_along_which_the_pull_ends_is_given_up() -> None:
    # The weight is gone after 0.1 s, the flight would last 0.2 s and more.
    flight = rescaled_flights(fading_ball(10.0, 100.0, 0.9), RungeKutta(), FINE)
    assert flight(np.array([0.0, 0.0, 1.0, 1.0]), 1.0) is None


def test_a_flight_of_too_many_steps_is_given_up() -> None:
    flight = rescaled_flights(fading_ball(10.0, 0.0, 0.9), RungeKutta(largest_step=1e-5), FINE)
    assert flight(np.array([0.0, 0.0, 1.0, 1.0]), 1.0) is None
    coarse = rescaled_flights(fading_ball(10.0, 0.0, 0.9), RungeKutta(largest_step=1e-3), FINE)
    assert coarse(np.array([0.0, 0.0, 1.0, 1.0]), 1.0) is not None


def test_a_state_that_is_not_finite_gives_no_flight() -> None:
    flight = rescaled_flights(fading_ball(10.0, 1.0, 0.9), RungeKutta(), FINE)
    assert flight(np.array([0.0, np.nan, 1.0, 1.0]), 1.0) is None


@dataclass
class Made:
    """A system, its engine and its steps in one: a scaled gap as a function of time and its rate.

    The state is the gap's acceleration, which each step gives at its end.
    """

    gap: Callable[[float], float]
    rate: Callable[[float], float]
    size: float = 1.0
    accelerations: tuple[float, ...] = (-1.0,)
    state_names: tuple[str, ...] = ("acceleration",)
    start: float = 0.0

    def gap_acceleration(self, x: Vector) -> float:
        (acceleration,) = x
        return float(acceleration)

    def flight(self, speed: float) -> None:
        """A flow that nobody follows."""

    def steps(self, *_: object) -> Any:
        for k, acceleration in enumerate(self.accelerations):
            yield Made(self.gap, self.rate, self.size, (acceleration,), start=k * self.size)

    @property
    def after(self) -> Vector:
        return self.state_at(self.size)

    def state_at(self, offset: float) -> Vector:
        time = self.start + offset
        return np.array([*self.accelerations, self.gap(time), self.rate(time)])


def landing_of(made: Any) -> tuple[float, Vector, float] | None:
    """The end of the flight at a gap rate of 3."""
    return rescaled_flights(made, made, FINE)(np.array([-1.0]), 3.0)


@pytest.mark.parametrize("acceleration", [0.0, 0.5])
def test_a_flight_is_given_up_where_the_stop_does_not_pull_at_the_end_of_a_step(
    acceleration: float,
) -> None:
    def found(*accelerations: float) -> tuple[float, Vector, float] | None:
        made = Made(lambda t: t - 0.5 * t**2, lambda t: 1.0 - t, accelerations=accelerations)
        return landing_of(made)

    landing = found(-1.0, -1.0, -1.0)
    assert landing is not None
    assert (landing[0], landing[2]) == pytest.approx((3.0 * 2.0, 3.0 * -1.0), rel=1e-14)
    assert found(-1.0, acceleration, -1.0) is None


def test_a_flight_may_land_at_the_very_end_of_a_step() -> None:
    made = Made(lambda t: t - t**2, lambda t: 1.0 - 2.0 * t)
    landing = landing_of(made)
    assert landing is not None
    assert (landing[0], landing[2]) == (3.0, -3.0)
    assert landing_of(Made(lambda t: t, lambda _: 1.0)) is None


@pytest.mark.parametrize("duration", [1e-4, 1.0, 1e4])
def test_a_landing_is_as_exact_in_a_short_flight_as_in_a_long_one(duration: float) -> None:
    # A parabola of that duration in a step by half as long: Newton's method squares what is left.
    made = Made(
        lambda t: t - t**2 / duration, lambda t: 1.0 - 2.0 * t / duration, size=1.5 * duration
    )
    landing = landing_of(made)
    assert landing is not None
    assert landing[0] == pytest.approx(3.0 * duration, rel=1e-14)


def test_a_landing_is_found_from_either_side() -> None:
    # The gap is flat at the end of the step, and the first correction goes far back.
    made = Made(lambda t: 1.5 - t + 0.8 * (t - 1.5) ** 2, lambda t: -1 + 1.6 * (t - 1.5), size=2.0)
    landing = landing_of(made)
    assert landing is not None
    assert (landing[0], landing[2]) == pytest.approx((3.0 * 1.5, -3.0), rel=1e-14)
