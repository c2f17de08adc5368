"""Derivatives of executions, in the loop and in Python, against differences and closed forms."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import DOP853
from scipy.linalg import expm

from tests.support.cases import fast
from tests.support.families import BALL, OSCILLATOR
from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import Engine, Radau, RungeKutta, SciPy, Tolerance
from zeno_orbits.model import GAP_ACCELERATION, HybridDynamics
from zeno_orbits.orbits import differentials_of
from zeno_orbits.simulation import (
    ArcPassage,
    Completion,
    Ending,
    EventDerivatives,
    Execution,
    FixedImpacts,
    PlasticAfter,
    SimulationSettings,
    SimulationTask,
    ZenoExtrapolation,
    by_reference,
    change_of,
    simulate,
)

OF_DIFFERENCES = 1e-8
"""Fourth order at 1e-4: 1e-16 of truncation, 1e-12 / 1e-4 of integration."""

Run = Callable[[HybridDynamics, Vector, float, SimulationSettings], Execution]
"""From a system, a start, a time and settings to an execution that ends at the first release."""


def _by_loop(machine: HybridDynamics, x: Vector, until: float, s: SimulationSettings) -> Execution:
    return simulate(machine, x, until=until, releases=1, settings=s)


def _by_python(
    machine: HybridDynamics, x: Vector, until: float, s: SimulationSettings
) -> Execution:
    task = SimulationTask(dynamics=machine, state=x, until=until, most_releases=1, settings=s)
    return by_reference(task)


both_paths = pytest.mark.parametrize("run", [_by_loop, _by_python], ids=["loop", "Python"])
"""Derivatives in the loop, and in Python along an execution that Python followed."""


def _walk(machine: HybridDynamics, chosen: tuple[int, ...]) -> EventDerivatives:
    return EventDerivatives(machine, chosen, Tolerance())


def _motions(walk: EventDerivatives, run: Execution) -> list[ArcPassage]:
    return list(walk.passages(run))


def _settings(completion: Completion, engine: Engine | None = None) -> SimulationSettings:
    plain = SimulationSettings(completion=completion)
    return plain if engine is None else replace(plain, engine=engine)


# Every event of a forced oscillator from a flight to the release.

START = np.array([-1.1, math.cos(-1.5), 0.4, math.sin(1.5)])
NUMBERS = np.array([1.1, 1.9, 1.05, 1.0, -0.8, 0.5])
"""``k``, ``c``, ``force``, ``omega``, ``stop`` and ``e``."""


def _oscillator(p: Vector) -> HybridDynamics:
    return OSCILLATOR.at(**dict(zip(OSCILLATOR.parameters, p.tolist(), strict=True)))


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
    motions = _motions(walk, run)
    assert len(motions) == len(run.arcs)
    locked = motions[-1]
    found = [shift for one in motions[:2] for shift in one.crossings[0][1:]]
    rows = [np.vstack([s.time, s.state, s.rate]) for s in [*found, locked.start]]
    slopes = differentials_of(machine, walk.chosen).contact(run.zeno_points[0].state)
    rows += [change_of(slopes[GAP_ACCELERATION], locked.start.state)[None, :]]
    end = locked.after
    return np.vstack([*rows, end.time, end.state, end.rate])


def _differences(f: Callable[[float], Vector], step: float = 1e-4) -> Vector:
    """Return the derivative of a function of a number at zero, to fourth order."""
    near = (f(step) - f(-step)) / (2 * step)
    far = (f(2 * step) - f(-2 * step)) / (4 * step)
    return (4 * near - far) / 3


@both_paths
@pytest.mark.parametrize(
    "completion",
    [ZenoExtrapolation(), FixedImpacts(n_impacts=2), PlasticAfter(n_impacts=2)],
)
def test_events_move_with_start_and_parameters_as_differences_show(
    run: Run, completion: Completion
) -> None:
    settings = _settings(completion)

    def ended(x: Vector, p: Vector) -> tuple[HybridDynamics, Execution]:
        machine = _oscillator(p)
        return machine, run(machine, x, 9.0, settings)

    slopes = _shifts(*ended(START, NUMBERS))
    assert slopes.shape == (37, 10)
    for seed in range(2):
        way = np.random.default_rng(seed).normal(size=10)

        def moved(part: float, way: Vector = way) -> Vector:
            step = part * way
            return _events(*ended(START + step[:4], NUMBERS + step[4:]))

        assert slopes @ way == pytest.approx(_differences(moved), abs=30 * OF_DIFFERENCES)


@pytest.mark.parametrize("engine", [Radau(), SciPy(method=DOP853)], ids=["implicit", "SciPy"])
def test_the_derivatives_do_not_depend_on_the_steps_that_the_arcs_were_made_of(
    engine: Engine,
) -> None:
    machine, few = _oscillator(NUMBERS), FixedImpacts(n_impacts=1)
    settings = _settings(few), _settings(few, engine)
    usual, other = (_by_loop(machine, START, 9.0, one) for one in settings)
    # One impact: the arcs are a flight, the tail of the sequence and the contact phase.
    found, expected = (_events_shift(machine, run) for run in (other, usual))
    assert found == pytest.approx(expected, abs=1e-9)


def _events_shift(machine: HybridDynamics, run: Execution) -> Vector:
    first, *_, last = _motions(_walk(machine, tuple(range(6))), run)
    shifts = (*first.crossings[0][1:], last.start, last.after)
    return np.vstack([np.vstack([s.time, s.state, s.rate]) for s in shifts])


@both_paths
def test_the_zeno_point_of_a_plastic_impact_moves_as_the_impact(run: Run) -> None:
    machine = _oscillator(np.append(NUMBERS[:-1], 0.0))
    ended = run(machine, START, 9.0, _settings(ZenoExtrapolation()))
    flight, locked = _motions(_walk(machine, (1, 5)), ended)
    impact, after, zeno = ended.impacts[0], flight.crossings[0][2], locked.start
    # Restitution adds a tail: a time 2 w / |h''| and the way of the constrained flow in it.
    tail = -2 * impact.approach_rate / abs(machine.gap_acceleration(impact.state_plus))
    way = machine.locked.rate(impact.state_plus)
    assert zeno.time == pytest.approx(after.time + tail * np.eye(6)[5], abs=1e-12)
    resting = after.state.copy()
    resting[:, 5] += tail * way
    # The speed after the impact is none of the state on the stop.
    resting[2] = 0.0
    assert zeno.state == pytest.approx(resting, abs=1e-12)
    assert zeno.rate.tolist() == [0.0] * 6


@both_paths
def test_a_start_on_the_stop_moves_by_itself_also_off_the_stop(run: Run) -> None:
    g, v, e = 10.0, 2.0, 0.5
    machine = BALL.at(m=0.7, g=g, c=0.0, e=e)
    for sign in (1.0, -1.0):
        ended = run(machine, np.array([0.0, sign * v]), 0.9, _settings(ZenoExtrapolation()))
        passages = _motions(_walk(machine, ()), ended)
        times = [before.time for one in passages for _, before, _ in one.crossings]
        # With u^2 = v^2 + 2 g q: t = (v + u) / g, then flights of 2 e^k u / g.
        factors = 1 + 2 * np.cumsum([0.0, *(e**k for k in range(1, len(times) - 1))])
        expected = [(factor / v, (1 + sign * factor) / g) for factor in factors]
        assert np.array(times[:-1]) == pytest.approx(np.array(expected), abs=1e-12)
        limit = (1 + e) / (1 - e)
        assert times[-1] == pytest.approx([limit / v, (1 + sign * limit) / g], abs=1e-10)


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


@both_paths
@pytest.mark.parametrize(
    "engine",
    [RungeKutta(largest_step=0.3), Radau(), SciPy(method=DOP853)],
    ids=["explicit", "implicit", "SciPy"],
)
@pytest.mark.parametrize("until", [0.41, 3.0])
@pytest.mark.parametrize("parts", fast(1, [1, 3]))
def test_the_course_of_a_falling_ball_moves_as_its_closed_form(
    run: Run, engine: Engine, until: float, parts: int
) -> None:
    x = np.array([2.0, 1.5])
    ended = run(BALL.at(m=0.7, g=G, c=DRAG, e=0.5), x, until, SimulationSettings(engine=engine))
    walk, arc = _walk(BALL.at(m=0.7, g=G, c=DRAG, e=0.5), BY), ended.arcs[0]
    times, found = walk.course(_motions(walk, ended)[0], parts=parts)
    assert times[[0, -1]] == pytest.approx([0.0, arc.duration], rel=1e-15)
    # Steps are parted evenly.
    sizes = np.diff(times)
    assert np.all(sizes > 0.0)
    assert len(sizes) % parts == 0
    each = sizes.reshape(-1, parts)
    assert each == pytest.approx(np.repeat(each[:, :1], parts, axis=1), rel=1e-9)
    if not isinstance(engine, SciPy):
        assert times[::parts] == pytest.approx(arc.flow_times, rel=1e-14)
    for time, shift in zip(times.tolist(), found, strict=True):
        assert shift == pytest.approx(_fall_slopes(x, DRAG, time), abs=1e-10)


@both_paths
def test_perturbations_decay_where_explicit_steps_of_a_state_at_rest_do_not_see_it(
    run: Run,
) -> None:
    drag = 12.0
    x = np.array([30.0, -G / drag])
    machine = BALL.at(m=0.7, g=G, c=drag, e=0.5)
    # At its final speed the ball moves uniformly: steps of DOP853 are as long as they may be, and
    # at h c = 2.4 a perturbation would be wrong by 1e-4.
    engine = RungeKutta(largest_step=0.2)
    ended = run(machine, x, 2.0, SimulationSettings(engine=engine))
    assert max(np.diff(ended.arcs[0].flow_times)) == pytest.approx(0.2)
    walk = _walk(machine, BY)
    times, found = walk.course(_motions(walk, ended)[0], parts=2)
    for time, shift in zip(times.tolist(), found, strict=True):
        # Order 13 at h c = 2.4.
        assert shift == pytest.approx(_fall_slopes(x, drag, time), abs=1e-9)


@both_paths
@pytest.mark.parametrize("engine", [RungeKutta(), Radau()], ids=["explicit", "implicit"])
def test_a_linear_motion_moves_at_a_given_time_as_the_exponential_of_its_matrix(
    run: Run, engine: Engine
) -> None:
    k, c, force, omega = 1.7, 0.3, 0.6, 1.3
    machine = OSCILLATOR.at(k=k, c=c, force=force, omega=omega, stop=5.0, e=0.5)
    matrix = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-k, force, -c, 0], [0, -(omega**2), 0, 0]])
    until = 2.9
    ended = run(machine, START, until, SimulationSettings(engine=engine))
    (only,) = ended.arcs
    assert only.ending is Ending.HORIZON
    assert matrix @ START == pytest.approx(machine.free.rate(START), abs=1e-14)
    (motion,) = _motions(_walk(machine, ()), ended)
    assert motion.end.state == pytest.approx(expm(until * matrix), abs=1e-11)
    assert motion.end.time.tolist() == [0.0] * 4


@both_paths
def test_volumes_shrink_by_damping_and_by_the_square_of_the_restitution(run: Run) -> None:
    k, c, e = 1.7, 0.3, 0.6
    machine = OSCILLATOR.at(k=k, c=c, force=0.6, omega=1.3, stop=0.5, e=e)
    x = np.array([0.1, 1.0, 1.5, 0.0])
    ended = run(machine, x, 5.0, SimulationSettings())
    n = len(ended.impacts)
    assert n >= 1
    assert not ended.zeno_points
    motion = _motions(_walk(machine, ()), ended)[-1]
    volume = np.linalg.det(motion.end.state)
    # Liouville: the divergence is -c.
    assert volume == pytest.approx(e ** (2 * n) * math.exp(-c * 5.0), rel=1e-10)
