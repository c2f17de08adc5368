"""Derivatives of events, one by one, against differences of the simulation and closed forms."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import pytest
from scipy.integrate import DOP853

from tests.support.families import BALL, CART, OSCILLATOR
from tests.support.mechanisms import oscillator_state
from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import Engine, Radau, RungeKutta, SciPy, SteppedTrajectory
from zeno_orbits.integrators.flow import Tolerance
from zeno_orbits.model.numeric.derivatives import FlowDifferential
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.simulation.completion import Completion, FixedImpacts, ZenoExtrapolation
from zeno_orbits.simulation.execution import Arc, Ending, Execution, Impact
from zeno_orbits.simulation.sensitivity import Bounce, EventShift, Perturbations
from zeno_orbits.simulation.simulator import SimulationSettings, simulate
from zeno_orbits.simulation.state_transition import carried, courses

OF_DIFFERENCES = 1e-8
"""Fourth order at 1e-4: 1e-16 of truncation, 1e-12 / 1e-4 of integration."""


def _walk(machine: HybridDynamics, chosen: tuple[int, ...]) -> Perturbations:
    assert machine.differentiation is not None
    return Perturbations(
        dynamics=machine,
        differentials=machine.differentiation.by(chosen),
        n_parameters=len(chosen),
        tolerance=Tolerance(),
    )


def _settings(completion: Completion, engine: Engine | None = None) -> SimulationSettings:
    plain = SimulationSettings(completion=completion)
    return plain if engine is None else SimulationSettings(completion=completion, engine=engine)


# Every event of a forced oscillator from a flight to the release.

START = np.array([-1.1, math.cos(-1.5), 0.4, math.sin(1.5)])
NUMBERS = np.array([1.1, 1.9, 1.05, 1.0, -0.8, 0.5])
"""``k``, ``c``, ``force``, ``omega``, ``stop`` and ``e``."""


def _run(x: Vector, p: Vector, settings: SimulationSettings) -> tuple[HybridDynamics, Execution]:
    machine = OSCILLATOR.at(**dict(zip(OSCILLATOR.parameters, p.tolist(), strict=True)))
    return machine, simulate(machine, x, until=9.0, releases=1, settings=settings)


def _events(machine: HybridDynamics, run: Execution) -> Vector:
    """Return times, states and rates of two impacts (before, after), Zeno point and release."""
    (zeno,), (release,) = run.zeno_points, run.releases
    numbers: list[float] = []
    for impact in run.impacts[:2]:
        speed = machine.speed_after(impact.approach_rate)
        numbers += [impact.time, *impact.state_minus, impact.approach_rate]
        numbers += [impact.time, *impact.state_plus, speed]
    numbers += [zeno.time, *zeno.state, 0.0, machine.gap_acceleration(zeno.state)]
    return np.array([*numbers, release.time, *release.state, 0.0])


def _shifts(machine: HybridDynamics, run: Execution) -> Vector:
    """Return the derivatives of the same, a row each, by the states and all parameters."""
    walk = _walk(machine, tuple(range(6)))
    here, bounces, found = walk.at_start(), list[Bounce](), list[EventShift]()
    flights = [arc for arc in run.arcs if arc.ending is Ending.IMPACT]
    for arc, impact in zip(flights, run.impacts, strict=True):
        before = walk.flown(arc, here)
        here = walk.struck(impact, before)
        found += [before, here]
        bounces = walk.joined(bounces, impact, here)
    assert len(bounces) == len(run.impacts)
    point = run.zeno_points[0].state
    zeno = walk.limit(bounces, point)
    rows = [np.vstack([s.time, s.state, s.rate]) for s in [*found[:4], zeno]]
    rows += [walk.of_gap_acceleration(point, zeno)[None, :]]
    end = walk.released(run.arcs[-1], zeno)
    return np.vstack([*rows, end.time, end.state, end.rate])


def _differences(f: Callable[[float], Vector], step: float = 1e-4) -> Vector:
    """Return the derivative of a function of a number at zero, to fourth order."""
    near = (f(step) - f(-step)) / (2 * step)
    far = (f(2 * step) - f(-2 * step)) / (4 * step)
    return (4 * near - far) / 3


@pytest.mark.parametrize("completion", [ZenoExtrapolation(), FixedImpacts(n_impacts=2)])
def test_events_move_with_start_and_parameters_as_differences_say(completion: Completion) -> None:
    settings = _settings(completion)
    slopes = _shifts(*_run(START, NUMBERS, settings))
    assert slopes.shape == (37, 10)
    for seed in range(2):
        way = np.random.default_rng(seed).normal(size=10)

        def moved(part: float, way: Vector = way) -> Vector:
            step = part * way
            return _events(*_run(START + step[:4], NUMBERS + step[4:], settings))

        assert slopes @ way == pytest.approx(_differences(moved), abs=30 * OF_DIFFERENCES)


@pytest.mark.parametrize("engine", [Radau(), SciPy(method=DOP853)], ids=["implicit", "SciPy"])
def test_the_derivatives_do_not_depend_on_the_steps_that_the_arcs_were_made_of(
    engine: Engine,
) -> None:
    few = FixedImpacts(n_impacts=1)
    usual = _shifts(*_run(START, NUMBERS, _settings(few)))
    other = _shifts(*_run(START, NUMBERS, _settings(few, engine)))
    assert other == pytest.approx(usual, abs=1e-9)


def test_the_zeno_point_of_a_plastic_impact_moves_as_the_impact() -> None:
    p = np.append(NUMBERS[:-1], 0.0)
    machine, run = _run(START, p, _settings(ZenoExtrapolation()))
    walk = _walk(machine, (1, 5))
    impact = run.impacts[0]
    after = walk.struck(impact, walk.flown(run.arcs[0], walk.at_start()))
    (bounce,) = walk.joined([], impact, after)
    zeno = walk.limit([bounce], run.zeno_points[0].state)
    # Restitution adds a tail: a time 2 w / |h''| and the way of the locked flow in it.
    tail = -2 * impact.approach_rate / abs(machine.gap_acceleration(impact.state_plus))
    way = machine.locked.rate(impact.state_plus)
    assert zeno.time == pytest.approx(after.time + tail * np.eye(6)[5], abs=1e-12)
    resting = after.state.copy()
    resting[:, 5] += tail * way
    # The speed after the impact is none of the state on the stop.
    resting[2] = 0.0
    assert zeno.state == pytest.approx(resting, abs=1e-12)
    assert zeno.rate.tolist() == [0.0] * 6


def test_a_start_moves_as_it_is_told_to_and_its_gap_rate_as_the_state_and_the_machine() -> None:
    numbers = {"M": 1.0, "m": 0.5, "l": 0.7, "g": 9.81, "wall": -0.2, "e": 0.3}
    walk = _walk(CART.at(**numbers), (2, 4))
    angle, turn = 0.4, 1.7
    x = np.array([0.1, angle, 0.2, turn])
    start, launched = walk.at_start(), walk.launched(x)
    for shift in (start, launched):
        assert shift.time.tolist() == [0.0] * 6
        assert shift.state.tolist() == np.eye(4, 6).tolist()
    assert start.rate.tolist() == [0.0] * 6
    # The bob's speed is dx + l dtheta cos(theta).
    sine, cosine = math.sin(angle), math.cos(angle)
    expected = [0.0, -0.7 * turn * sine, 1.0, 0.7 * cosine, turn * cosine, 0.0]
    assert launched.rate == pytest.approx(expected, rel=1e-14)


# Which impacts belong to a sequence.


def _impact(walk: Perturbations, time: float, phase: float, approach: float) -> Impact:
    e = walk.dynamics.restitution
    return Impact(
        time=time,
        state_minus=np.array(oscillator_state(phase, -0.8, approach)),
        state_plus=np.array(oscillator_state(phase, -0.8, -e * approach)),
        approach_rate=-approach,
    )


def test_a_sequence_goes_on_while_its_speeds_fall_and_ends_where_the_stop_repels() -> None:
    walk = _walk(OSCILLATOR.at(k=1.0, c=1.9, force=1.0, omega=1.0, stop=-0.8, e=0.5), ())
    shift = walk.at_start()
    first, slower = _impact(walk, 1.0, 0.1, 0.6), _impact(walk, 1.5, 0.2, 0.3)
    one = walk.joined([], first, shift)
    both = walk.joined(one, slower, shift)
    assert [bounce.impact for bounce in both] == [first, slower]
    assert both[1].shift is shift
    assert both[1].estimate.speed == 0.15
    assert both[1].estimate.impact_time == 1.5
    # As fast as the last one, or faster: a new sequence.
    again, faster = _impact(walk, 2.0, 0.2, 0.3), _impact(walk, 2.0, 0.2, 0.4)
    assert [bounce.impact for bounce in walk.joined(both, again, shift)] == [again]
    assert [bounce.impact for bounce in walk.joined(both, faster, shift)] == [faster]
    # The forcing pulls off the stop at the phase pi.
    assert walk.joined(both, _impact(walk, 2.0, math.pi, 0.1), shift) == []


# Perturbations along an arc: a ball in air, which slows it down.

G, DRAG = 9.81, 1.3
BY = (2, 1)
"""Places of drag and weight among the parameters of the ball, in this order."""


def _fallen(numbers: Sequence[complex], time: float) -> list[complex]:
    """Return height and velocity of a ball after a time, of numbers that may be complex."""
    height, velocity, drag, weight = numbers
    slack = velocity + weight / drag
    decayed = cmath.exp(-drag * time)
    fall = slack * (1 - decayed) / drag - weight / drag * time
    return [height + fall, slack * decayed - weight / drag]


def _fall_slopes(x: Vector, drag: float, time: float) -> Vector:
    """Return the derivatives of the same by height, velocity, drag and weight, by complex steps."""
    tiny, slopes = 1e-30, list[list[float]]()
    for one in np.eye(4):
        numbers = [complex(at, tiny * way) for at, way in zip((*x, drag, G), one, strict=True)]
        slopes.append([value.imag / tiny for value in _fallen(numbers, time)])
    return np.array(slopes).T


def _falling(engine: Engine, x: Vector, drag: float, until: float) -> tuple[Perturbations, Arc]:
    machine = BALL.at(m=0.7, g=G, c=drag, e=0.5)
    run = simulate(machine, x, until=until, settings=SimulationSettings(engine=engine))
    return _walk(machine, BY), run.arcs[0]


ENGINES = [RungeKutta(largest_step=0.3), Radau(), SciPy(method=DOP853)]


@pytest.mark.parametrize("engine", ENGINES, ids=["explicit", "implicit", "SciPy"])
@pytest.mark.parametrize("until", [0.41, 3.0])
@pytest.mark.parametrize("parts", [1, 3])
def test_perturbations_of_a_falling_ball_are_those_of_its_closed_form(
    engine: Engine, until: float, parts: int
) -> None:
    x = np.array([2.0, 1.5])
    walk, arc = _falling(engine, x, DRAG, until)
    v, q = np.eye(2, 4), walk.parameters
    free = walk.dynamics.free
    given = (free, walk.differentials.free, arc, walk.tolerance, v, q)
    passed = list(courses(*given, parts=parts))
    times = np.array([0.0, *(time for time, _ in passed)])
    assert times[-1] == pytest.approx(arc.duration, rel=1e-15)
    # Steps are parted evenly.
    sizes = np.diff(times)
    assert np.all(sizes > 0.0)
    assert len(sizes) % parts == 0
    each = sizes.reshape(-1, parts)
    assert each == pytest.approx(np.repeat(each[:, :1], parts, axis=1), rel=1e-9)
    if not isinstance(engine, SciPy):
        assert times[::parts] == pytest.approx(arc.flow_times, rel=1e-14)
        assert len(list(courses(*given))) == len(arc.flow_times) - 1
    for time, found in passed:
        assert found == pytest.approx(_fall_slopes(x, DRAG, time), abs=1e-10)
    assert carried(*given).tolist() == list(courses(*given))[-1][1].tolist()
    assert carried(*given) == pytest.approx(passed[-1][1], abs=1e-10)


class _Distrusted:
    """A variational equation none of whose explicit steps is any good."""

    def __init__(self, right: FlowDifferential) -> None:
        self.linear = right.linear

    def step(self, y: Vector, size: float, v: Vector, q: Vector) -> tuple[Vector, float]:
        del y, size, q
        return np.full_like(v, 1e6), 1.0


def test_where_explicit_steps_are_no_good_implicit_ones_follow_the_same_states() -> None:
    x = np.array([2.0, 1.5])
    walk, arc = _falling(RungeKutta(largest_step=0.2), x, DRAG, 0.41)
    differential = cast("FlowDifferential", _Distrusted(walk.differentials.free))
    given = (walk.dynamics.free, differential, arc, walk.tolerance, np.eye(2, 4), walk.parameters)
    for time, found in courses(*given, parts=2):
        # Order 13 at h c = 0.26.
        assert found == pytest.approx(_fall_slopes(x, DRAG, time), abs=1e-12)


@dataclass
class _Whole:
    """A step of no known kind, as long as its arc."""

    size: float
    before: Vector
    after: Vector
    start: float = 0.0

    def state_at(self, offset: float) -> Vector:
        return self.before if offset == 0.0 else self.after

    def end_at(self, offset: float) -> Vector:
        return self.state_at(offset)


def test_an_arc_of_steps_that_are_not_known_is_stepped_once_more() -> None:
    x = np.array([2.0, 1.5])
    walk, arc = _falling(RungeKutta(), x, DRAG, 3.0)
    whole = _Whole(size=arc.duration, before=arc.start_state, after=arc.end_state)
    assert isinstance(arc.trajectory, SteppedTrajectory)
    other = SteppedTrajectory(
        steps=(arc.trajectory.steps[0], whole), duration=arc.duration, end=arc.end_state
    )
    arc.trajectory = other  # type: ignore[misc]
    given = (walk.dynamics.free, walk.differentials.free, arc, walk.tolerance)
    found = carried(*given, np.eye(2, 4), walk.parameters)
    assert found == pytest.approx(_fall_slopes(x, DRAG, arc.duration), abs=1e-10)


class _Claimed:
    """A variational equation whose explicit steps claim an error: 7 after them, else no change."""

    def __init__(self, error: float) -> None:
        self.error = error

    def step(self, y: Vector, size: float, v: Vector, q: Vector) -> tuple[Vector, float]:
        del y, size, q
        return np.full_like(v, 7.0), self.error

    def linear(self, states: Vector) -> Vector:
        return np.zeros((len(states), states.shape[1], states.shape[1] + 2))


@pytest.mark.parametrize(
    ("relative", "error", "explicit"),
    [
        # Above 1e-8, and a thousand times the tolerance of the state, steps are not trusted.
        (1e-12, 0.9e-8, True),
        (1e-12, 1e-8, True),
        (1e-12, 1.1e-8, False),
        (1e-9, 0.9e-6, True),
        (1e-9, 1.1e-6, False),
        (1e-12, math.nan, False),
    ],
)
def test_an_explicit_step_serves_perturbations_up_to_an_error(
    relative: float, error: float, explicit: bool
) -> None:
    walk, arc = _falling(RungeKutta(), np.array([2.0, 1.5]), DRAG, 0.1)
    claimed = cast("FlowDifferential", _Claimed(error))
    v = np.array([[1.0, 2.0], [3.0, 4.0]])
    tolerance = Tolerance(relative=relative)
    found = carried(walk.dynamics.free, claimed, arc, tolerance, v, np.zeros((2, 2)))
    assert found == pytest.approx(np.full((2, 2), 7.0) if explicit else v, abs=1e-14)


def test_columns_are_of_states_first_and_then_of_the_chosen_parameters() -> None:
    walk = _walk(BALL.at(m=0.7, g=G, c=DRAG, e=0.4), (3, 1))
    assert walk.n_x == 2
    assert walk.parameters.tolist() == [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    # Only `e` itself moves the restitution.
    assert walk.restitution.tolist() == [0.0, 0.0, 1.0, 0.0]
