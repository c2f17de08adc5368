"""Laws that hold for all numbers: reversal, energy, units, closed forms, symmetry, Zeno limits.

Hypothesis draws the numbers, the same ones every time. Problems are compiled once with symbols for
their parameters (`families.py`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import takewhile
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import assume, example, given, reject, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from tests.support.families import BALL, BOWL, CART, LENGTH, OSCILLATOR, Family
from tests.support.units import PENDULUM, PENDULUM_STATE, Units
from zeno_orbits.arrays import Vector
from zeno_orbits.model import HybridDynamics, Problem, bind, load_problem
from zeno_orbits.precision import execution_with_error
from zeno_orbits.simulation import (
    Execution,
    Mode,
    SimulationSettings,
    TailEstimate,
    Truncation,
    estimate_tail,
    extrapolate,
    simulate,
)

EPS = 2.0**-52
DRIFT = 1e-14
"""Of an impact speed, relative, an impact: the root of a flight and its slope round thrice."""


def examples(n: int) -> Callable[[Any], Any]:
    """Return how often a property is tried; what else is asked of it stands in `conftest.py`."""
    return settings(max_examples=max(n // 2, 4) if settings().derandomize else 20 * n)


def between(lowest: float, highest: float) -> st.SearchStrategy[float]:
    """Return numbers of an interval."""
    return st.floats(lowest, highest, allow_subnormal=False)


def magnitudes(lowest: float, highest: float) -> st.SearchStrategy[float]:
    """Return positive numbers, even in their logarithm."""
    exponents = st.floats(math.log10(lowest), math.log10(highest))
    return exponents.map(lambda exponent: 10.0**exponent)


restitutions = between(0.0, 0.95)


# Time reversal of conservative arcs.


def _reversed(dynamics: HybridDynamics, start: Sequence[float], until: float) -> Vector:
    """Return where a motion ends that is run forward, turned round and run again."""
    there = simulate(dynamics, start, until=until)
    if len(there.arcs) > 1:
        reject()
    turned = there.end_state.copy()
    turned[dynamics.n_q :] *= -1
    back = simulate(dynamics, turned, until=until)
    assert [arc.mode for arc in back.arcs] == [there.arcs[0].mode]
    end = back.end_state.copy()
    end[dynamics.n_q :] *= -1
    return end


@examples(60)
@given(
    p=st.fixed_dictionaries(
        {
            "M": magnitudes(0.1, 10),
            "m": magnitudes(0.1, 10),
            "l": between(0.2, 2),
            "g": between(0, 20),
        }
    ),
    start=st.tuples(between(-1, 1), between(-3, 3), between(0, 3), between(-5, 5)),
)
def test_a_flight_run_back_returns_to_its_start(
    p: Mapping[str, float], start: tuple[float, ...]
) -> None:
    end = _reversed(CART.at(**p, wall=-5.0, e=0.5), start, 0.5)
    # Local errors of 1e-12 in some ten steps; a pendulum at 5 rad/s spreads them by less than 100.
    assert end == pytest.approx(np.array(start), abs=1e-9)


@examples(60)
@given(a=between(0.1, 3), g=between(1, 20), x=between(-1, 1), rate=between(-3, 3))
def test_a_locked_arc_without_friction_run_back_returns_to_its_start(
    a: float, g: float, x: float, rate: float
) -> None:
    # A ball in a bowl never leaves it: the bowl turns it inwards, and weight adds to that.
    start = (x, a * x**2 / 2, rate, a * x * rate)
    dynamics = BOWL.at(m=1.0, g=g, a=a, e=0.5)
    end = _reversed(dynamics, start, 1.0)
    assert simulate(dynamics, start, until=1.0).arcs[0].mode is Mode.LOCKED
    assert end == pytest.approx(np.array(start), abs=1e-9)


def test_friction_is_seen_when_a_flight_is_run_back() -> None:
    start = (5.0, 1.0)
    end = _reversed(BALL.at(m=1.0, g=9.81, c=1e-4, e=0.5), start, 0.5)
    assert np.max(np.abs(end - np.array(start))) > 1e-5


# Energy at an impact.


@cache
def _pendulum() -> tuple[Problem, Callable[[Sequence[float]], HybridDynamics]]:
    problem = load_problem("motor_pendulum")
    compiled = problem.compiled()
    return problem, lambda values: bind(compiled, values)


machines = st.fixed_dictionaries(
    {
        "L1": between(0.05, 0.5),
        "lc1": between(0.01, 0.3),
        "m1": magnitudes(0.01, 10),
        "I1": magnitudes(1e-5, 1e-2),
        "lc2": between(0.02, 0.3),
        "m2": magnitudes(0.01, 10),
        "I2": magnitudes(1e-5, 1e-2),
        "J_rotor": magnitudes(1e-4, 1e-1),
        "K_torque": magnitudes(1e-3, 1),
        "R": between(0.5, 10),
        "L": magnitudes(1e-3, 1e-1),
        "restitution": restitutions,
    }
)


def _loss_error(dynamics: HybridDynamics, x: Vector) -> float:
    """Return by how much the loss at an impact misses the law, in parts of the energy at stake."""
    rate = dynamics.gap_rate(x)
    after = dynamics.reset_map(x, rate)
    law = (1 - dynamics.restitution**2) / 2 * dynamics.normal_inertia(x) * rate**2
    before = dynamics.energy(x)
    still = x.copy()
    still[dynamics.n_q :] = 0.0
    stake = abs(before) + abs(dynamics.energy(still)) + law
    loss = before - dynamics.energy(after)
    assert loss >= -1e-12 * stake, "an impact creates no energy"
    return abs(loss - law) / stake


@examples(150)
@given(
    machine=machines,
    state=st.tuples(between(-3, 3), between(-20, 20), magnitudes(1e-6, 1e2), between(-5, 5)),
)
def test_an_impact_of_the_pendulum_loses_what_the_law_says(
    machine: Mapping[str, float], state: tuple[float, ...]
) -> None:
    angle, rate, approach, current = state
    problem, at = _pendulum()
    dynamics = at(problem.values(parameters=machine).vector)
    # The condition of the mass matrix multiplies rounding, and stays below 1e5 here.
    assert _loss_error(dynamics, np.array([angle, 0.0, rate, -approach, current])) < 1e-11


@examples(150)
@given(
    a=between(-2, 2),
    m=magnitudes(1e-3, 1e3),
    e=restitutions,
    x=between(-2, 2),
    along=between(-10, 10),
    approach=magnitudes(1e-6, 1e3),
)
def test_an_impact_on_a_curved_surface_loses_what_the_law_says(
    a: float, m: float, e: float, x: float, along: float, approach: float
) -> None:
    dynamics = BOWL.at(m=m, g=9.81, a=a, e=e)
    # h = y - a x^2 / 2, so dh/dt = dy - a x dx.
    state = np.array([x, a * x**2 / 2, along, a * x * along - approach])
    assert _loss_error(dynamics, state) < 1e-12


@examples(150)
@given(
    heavy=magnitudes(1e-3, 1e3),
    light=magnitudes(1e-3, 1e3),
    length=between(0.1, 3),
    e=restitutions,
    angle=between(-3, 3),
    turn=between(-10, 10),
    approach=magnitudes(1e-6, 1e3),
)
def test_an_impact_of_the_cart_loses_what_the_law_says(
    heavy: float, light: float, length: float, e: float, angle: float, turn: float, approach: float
) -> None:
    dynamics = CART.at(M=heavy, m=light, l=length, g=9.81, wall=0.3, e=e)
    drive = -approach - length * math.cos(angle) * turn
    state = np.array([0.3 - length * math.sin(angle), angle, drive, turn])
    # Mass ratios to 1e6 multiply rounding.
    assert _loss_error(dynamics, state) < 1e-9


def test_an_impulse_along_the_wrong_direction_is_seen_in_the_energy() -> None:
    problem, at = _pendulum()
    right = at(problem.values().vector)
    # Newton's law for the gap alone, as if the links were not coupled.
    direction = np.array([0.0, 0.0, 0.0, 1.0, 0.0])
    wrong = replace(right, reset_map=lambda x, rate: x - (1 + right.restitution) * rate * direction)
    state = np.array([0.3, 0.0, 1.0, -5.0, 0.2])
    assert _loss_error(right, state) < 1e-14
    assert _loss_error(wrong, state) > 1e-3


# Change of units.

units = st.builds(
    Units,
    mass=st.integers(-3, 3).map(lambda k: 10.0**k),
    length=st.integers(-3, 3).map(lambda k: 10.0**k),
    time=st.integers(-3, 3).map(lambda k: 10.0**k),
)


def _cut_in_an_event(execution: Execution, within: float) -> bool:
    """Return True if rounding decides on which side of the end an event lies."""
    events = [*execution.impacts, *execution.zeno_points, *execution.releases]
    until = execution.end_time
    return any(abs(until - event.time) <= within * max(1.0, until) for event in events)


WEAK = 1e-3 / math.pi
"""Of the fastest impact: slower ones may be left to the tail. No power of a round restitution."""


def _same_motion(plain: Execution, other: Execution, within: float) -> None:
    """Hold events and end together, but for weak impacts."""
    if _cut_in_an_event(plain, within) or _cut_in_an_event(other, within):
        reject()
    fastest = max((-impact.approach_rate for impact in plain.impacts), default=0.0)

    def strong(execution: Execution) -> list[Any]:
        return [i for i in execution.impacts if -i.approach_rate > WEAK * fastest]

    assert len(plain.zeno_points) == len(other.zeno_points)
    assert len(plain.releases) == len(other.releases)
    events = [*strong(plain), *plain.zeno_points, *plain.releases]
    others = [*strong(other), *other.zeno_points, *other.releases]
    for event, same in zip(events, others, strict=True):
        assert same.time == pytest.approx(event.time, rel=within, abs=within)
    for event, same in zip(strong(plain), strong(other), strict=True):
        assert same.approach_rate == pytest.approx(event.approach_rate, rel=within, abs=within)
    assert other.end_state == pytest.approx(plain.end_state, rel=within, abs=within)


def _in_units(
    family: Family, numbers: Mapping[str, float], start: Vector, until: float, units: Units
) -> tuple[Execution, Execution]:
    plain = simulate(family.at(**numbers), start, until=until)
    other = simulate(
        family.at(**units.numbers(numbers, family.parameters)),
        start * units.state(family.states),
        until=until * units.time,
    )
    return plain, units.in_si(other, family.states, family.gap)


@examples(30)
@given(
    units=units,
    kp=between(1, 6),
    kd=between(-1.5, 1),
    e=between(0, 0.5),
    angle=between(-1, 1),
    knee=between(0.05, 0.5),
)
def test_the_pendulum_moves_alike_in_all_units(
    units: Units, kp: float, kd: float, e: float, angle: float, knee: float
) -> None:
    problem, at = _pendulum()
    values = problem.values(gains={"Kp": kp, "Kd": kd}, parameters={"restitution": e})
    start = np.array([angle, knee, 0.0, 0.0, 0.0])
    plain = simulate(at(values.vector), start, until=1.0)
    entries = {**values.gains, **values.parameters}
    other = simulate(
        at(tuple(units.numbers(entries, PENDULUM).values())),
        start * units.state(PENDULUM_STATE),
        until=units.time,
    )
    _same_motion(plain, units.in_si(other, PENDULUM_STATE, (0, 0, 0)), 1e-9)


@examples(30)
@given(
    units=units,
    height=between(0.1, 5),
    speed=between(-3, 3),
    c=between(0, 2),
    e=between(0, 0.8),
)
def test_the_ball_moves_alike_in_all_units(
    units: Units, height: float, speed: float, c: float, e: float
) -> None:
    numbers = {"m": 0.3, "g": 9.81, "c": c, "e": e}
    plain, other = _in_units(BALL, numbers, np.array([height, speed]), 3.0, units)
    # Absolute tolerances of 1e-12 in kilometres and kiloseconds are up to 1e-9 m and 1e-9 s.
    _same_motion(plain, other, 1e-8)


# The gap acceleration after the first impact is nearly zero, and grows during the flight.
@pytest.mark.slow
@example(units=Units(mass=1.0, length=1.0, time=10.0), turn=0.0, drive=-1.0, e=0.5)
@examples(30)
@given(units=units, turn=between(-3, 3), drive=between(-2, 0), e=between(0, 0.8))
def test_the_cart_moves_alike_in_all_units(
    units: Units, turn: float, drive: float, e: float
) -> None:
    numbers = {"M": 1.0, "m": 0.5, "l": 0.7, "g": 9.81, "wall": -0.2, "e": e}
    plain, other = _in_units(CART, numbers, np.array([0.3, 0.0, drive, turn]), 1.0, units)
    _same_motion(plain, other, 1e-8)


def test_a_quantity_that_is_not_converted_is_seen() -> None:
    wrong = replace(BALL, parameters={**BALL.parameters, "c": LENGTH})
    numbers = {"m": 0.3, "g": 9.81, "c": 0.1, "e": 0.5}
    start = np.array([1.0, 0.0])
    _same_motion(*_in_units(BALL, numbers, start, 3.0, Units(time=1e3)), 1e-8)
    with pytest.raises(AssertionError):
        _same_motion(*_in_units(wrong, numbers, start, 3.0, Units(time=1e3)), 1e-8)


# Closed forms at random numbers.


@examples(80)
@given(
    height=magnitudes(1e-6, 1e6),
    fall=between(-2, 2),
    g=magnitudes(1e-3, 1e3),
    e=restitutions,
    m=magnitudes(1e-6, 1e6),
)
def test_the_ball_keeps_its_closed_form(
    height: float, fall: float, g: float, e: float, m: float
) -> None:
    speed = fall * math.sqrt(g * height)
    first_speed = math.sqrt(speed**2 + 2 * g * height)
    first = (speed + first_speed) / g if speed > 0 else 2 * height / (first_speed - speed)
    unit = 2 * first_speed / g
    zeno_time = first + unit * e / (1 - e)
    dynamics = BALL.at(m=m, g=g, c=0.0, e=e)
    execution = simulate(dynamics, (height, speed), until=1.5 * zeno_time)
    (zeno,) = execution.zeno_points
    within = DRIFT * (10 + len(execution.impacts)) / (1 - e)
    assert zeno.time == pytest.approx(zeno_time, rel=within)
    assert execution.end_state == pytest.approx(np.zeros(2), abs=0.0)
    for k, impact in enumerate(execution.impacts):
        time = first + unit * e * (1 - e**k) / (1 - e)
        assert impact.time == pytest.approx(time, rel=within)
        assert -impact.approach_rate == pytest.approx(first_speed * e**k, rel=within)


def _next_impact(
    numbers: Mapping[str, float], matrix: Vector, start: Vector, latest: float
) -> tuple[float, Vector] | None:
    """Return when and where ``x`` reaches the stop, by the matrix exponential alone.

    Only clear impacts count: a swing that nearly grazes asks for more digits than there are.
    """
    width = 0.05 / (1 + numbers["omega"] + math.sqrt(numbers["k"]))
    step = expm(matrix * width)
    stop, time, z = numbers["stop"], 0.0, start
    while time < latest:
        after = step @ z
        turns = z[1] > 0.0 > after[1]
        assume(not (turns and abs(z[0] - stop) < 1e-2 and after[0] < stop))
        if after[0] > stop and after[1] > 0.0:
            offset = width
            for _ in range(8):
                landing = expm(matrix * offset) @ z
                offset -= (landing[0] - stop) / landing[1]
            return time + offset, landing
        time, z = time + width, after
    return None


@examples(30)
@given(
    numbers=st.fixed_dictionaries(
        {
            "k": between(0.2, 4),
            "c": between(0.05, 1.9),
            "force": between(0.5, 3),
            "omega": between(0.5, 2),
            "stop": between(-0.3, 0.5),
            "e": between(0.3, 0.9),
        }
    ),
    phase=between(0, 6.28),
    speed=between(1, 4),
)
def test_the_forced_oscillator_keeps_its_closed_form(
    numbers: dict[str, float], phase: float, speed: float
) -> None:
    omega, stop = numbers["omega"], numbers["stop"]
    matrix = np.zeros((4, 4))
    matrix[0, 1] = matrix[2, 3] = 1.0
    matrix[1] = -numbers["k"], -numbers["c"], numbers["force"], 0.0
    matrix[3, 2] = -(omega**2)
    z = np.array([stop, -speed, math.cos(phase), -omega * math.sin(phase)])
    exact: list[tuple[float, float]] = []
    time, until = 0.0, 8.0
    while time < until and len(exact) < 6:
        found = _next_impact(numbers, matrix, z, until - time)
        # Below this speed the matrix exponential cannot tell stop and flight apart well enough.
        if found is None or found[1][1] < 0.05:
            break
        time, z = time + found[0], found[1].copy()
        exact.append((time, float(z[1])))
        z[:2] = stop, -numbers["e"] * z[1]
    assume(exact)
    start = (stop, math.cos(phase), -speed, -omega * math.sin(phase))
    end = exact[-1][0] + 1e-3
    execution = simulate(OSCILLATOR.at(**numbers), start, until=end)
    # An error of a state counts by the inverse of the speed, at each impact, and e brings it back.
    for impact, (time, rate) in zip(execution.impacts, exact, strict=False):
        assert impact.time == pytest.approx(time, abs=1e-9)
        assert -impact.approach_rate == pytest.approx(rate, rel=1e-8)
    assert len(execution.impacts) >= len(exact)


# Symmetry.


@examples(30)
@given(
    a=between(-1, 2),
    e=between(0, 0.8),
    x=between(-1, 1),
    height=between(0.1, 2),
    along=between(-2, 2),
    rate=between(-2, 2),
)
def test_the_mirror_image_of_a_bounce_on_a_bowl_is_a_bounce(
    a: float, e: float, x: float, height: float, along: float, rate: float
) -> None:
    dynamics = BOWL.at(m=1.0, g=9.81, a=a, e=e)
    mirror = np.array([-1.0, 1.0, -1.0, 1.0])
    start = np.array([x, a * x**2 / 2 + height, along, rate])
    plain = simulate(dynamics, start, until=2.0)
    other = simulate(dynamics, mirror * start, until=2.0)
    # The same operations with other signs: not even rounding differs.
    assert [i.time for i in other.impacts] == [i.time for i in plain.impacts]
    assert other.end_state.tolist() == (mirror * plain.end_state).tolist()


@examples(30)
@given(shift=between(-100, 100), turn=between(-3, 3), drive=between(-2, 0), e=between(0, 0.8))
def test_a_cart_moved_along_with_its_wall_moves_alike(
    shift: float, turn: float, drive: float, e: float
) -> None:
    numbers = {"M": 1.0, "m": 0.5, "l": 0.7, "g": 9.81, "e": e}
    start, moved = np.array([0.3, 0.0, drive, turn]), np.array([shift, 0.0, 0.0, 0.0])
    plain = simulate(CART.at(**numbers, wall=-0.2), start, until=1.0)
    other = simulate(CART.at(**numbers, wall=-0.2 + shift), start + moved, until=1.0)
    back = replace(other.arcs[-1], end_state=other.end_state - moved)
    # Coordinates of 100 m carry 1e-14 m of rounding, and 1e-10 m of relative tolerance.
    _same_motion(plain, replace(other, arcs=(*other.arcs[:-1], back)), 1e-8)


# The Zeno limit.


def _flight(speed: Any, g: Any, c: Any) -> tuple[Any, Any]:
    r"""Return duration and final speed of a hop in air, in mpmath.

    With :math:`u = cT` and :math:`a = cw/g` the landing is :math:`a = u/(1 - e^{-u}) - 1`, and the
    ball lands at :math:`(g/c)(u - a)`. Short hops use the series of that function.
    """
    a = c * speed / g

    def launch(u: Any) -> Any:
        if u < mpmath.mpf("1e-3"):
            return u / 2 + u**2 / 12 - u**4 / 720 + u**6 / 30240 - u**8 / 1209600
        return u / -mpmath.expm1(-u) - 1

    u = 2 * a
    for _ in range(60):
        width = u * mpmath.mpf("1e-12")
        slope = (launch(u + width) - launch(u - width)) / (2 * width)
        change = (launch(u) - a) / slope
        u -= change
        if abs(change) < u * mpmath.mpf("1e-28"):
            break
    # u - a loses no digits: u is about 2 a.
    return u / c, g / c * (u - a)


def _hops(speed: float, g: float, c: float, e: float, until: float) -> list[tuple[Any, Any]]:
    """Return time and speed after every impact of a ball launched at `speed`, in mpmath."""
    time, w = mpmath.mpf(0), mpmath.mpf(speed)
    hops = [(time, w)]
    while w > until:
        duration, landing = _flight(w, mpmath.mpf(g), mpmath.mpf(c))
        time, w = time + duration, e * landing
        hops.append((time, w))
    return hops


@pytest.mark.slow
@examples(25)
@given(e=between(0.05, 0.8), c=magnitudes(1e-3, 10), g=between(1, 30), speed=magnitudes(1e-3, 30))
def test_the_error_of_a_zeno_limit_is_at_most_its_estimate(
    e: float, c: float, g: float, speed: float
) -> None:
    with mpmath.workdps(40):
        hops = _hops(speed, g, c, e, 1e-20)
        zeno_time = hops[-1][0]
        dynamics = BALL.at(m=1.0, g=g, c=c, e=e)
        estimates: list[TailEstimate] = []
        for time, w in hops:
            estimate = estimate_tail(dynamics, float(time), np.array([0.0, float(w)]), float(w))
            assert estimate is not None
            estimates.append(estimate)
            limit = extrapolate(dynamics, estimates)
            error = float(abs(limit.time - zeno_time) / (1 + zeno_time))
            # The sum of five weights of size below 10, rounded.
            assert error <= limit.error + 50 * EPS


@pytest.mark.slow
@examples(25)
@given(e=between(0.05, 0.8), c=magnitudes(1e-3, 10), g=between(1, 30), speed=magnitudes(1e-3, 30))
def test_the_simulated_zeno_time_is_as_good_as_it_says(
    e: float, c: float, g: float, speed: float
) -> None:
    with mpmath.workdps(40):
        zeno_time = float(_hops(speed, g, c, e, 1e-20)[-1][0])
    ball = BALL.at(m=1.0, g=g, c=c, e=e)
    assured = execution_with_error(ball, (0.0, speed), until=2 * zeno_time)
    (zeno,) = assured.execution.zeno_points
    assert zeno.limit_error <= 1e-12
    assert abs(zeno.time - zeno_time) <= assured.zeno_errors[0] * (1 + zeno_time)
    assert assured.zeno_errors[0] < 1e-10


@pytest.mark.slow
@examples(4)
@given(e=between(0.1, 0.7), c=magnitudes(1e-3, 10), g=between(1, 30), speed=magnitudes(1e-3, 30))
def test_impacts_keep_their_speed_down_to_the_smallest_floats(
    e: float, c: float, g: float, speed: float
) -> None:
    slowest = 1e-300
    with mpmath.workdps(40):
        exact = [float(w) / e for _, w in _hops(speed, g, c, e, slowest)[1:]]
    completion = SimulationSettings(completion=Truncation(delta=slowest))
    execution = simulate(
        BALL.at(m=1.0, g=g, c=c, e=e), (0.0, speed), until=100.0, settings=completion
    )
    speeds = [-impact.approach_rate for impact in execution.impacts]
    followed = list(takewhile(lambda w: w > slowest, exact))
    assert len(speeds) >= len(followed)
    for k, (w, truth) in enumerate(zip(speeds, followed, strict=False)):
        assert w == pytest.approx(truth, rel=1e-12 + DRIFT * k)
