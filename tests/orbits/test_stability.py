"""Stability of orbits: closed forms, forward simulations of disturbances, and times to recover."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.orbits.test_event_multipliers import Pressed
from tests.reference.several_stops import impact_pair, two_sided
from tests.support.contactless import wheel
from zeno_orbits.orbits import SlowDirection, Stability, orbit_event_name
from zeno_orbits.simulation import SwitchEvent, state_after, state_before

OBSERVED = Path(__file__).parents[1] / "support" / "machines" / "observed_valve.py"

Orbit = zo.Orbit
Known = tuple[Orbit, zo.Problem, Sequence[complex]]


# Errors of the multipliers.


def _hopper(e: float) -> Known:
    orbit = zo.find_orbit("hopper", parameters={"restitution": e}).unwrap()
    return orbit, zo.load_problem("hopper"), [e**2]


def _two_sided(seed: int) -> Known:
    rng = np.random.default_rng(seed)
    made = two_sided(rng)
    while max(abs(made.multipliers)) > 0.9:
        made = two_sided(rng)
    values = {"c": made.c, "k": 1.0, "d": made.stop, "A": made.amplitude, "omega": made.omega}
    problem = zo.load_problem("clapper")
    place, speed = made.state(0.0)
    cosine, sine = math.cos(made.phase), math.sin(made.phase)
    start = {"place": place, "speed": speed, "cosine": cosine, "sine": sine}
    orbit = zo.find_orbit(
        problem, parameters={**values, "restitution": made.restitution}, start=start
    ).unwrap()
    return orbit, problem, list(made.multipliers**2)


def _impact_pair() -> Known:
    # Half a period takes the phase t and the speed v after an impact on the lower end to
    # ds = ((V - A cos p) dt - pi dv) / (V + A cos p),  dv' = (1 + e) A sin(p) ds - e dv,
    # and is repeated with the speed reversed.
    rng = np.random.default_rng(1)
    while True:
        made = impact_pair(rng)
        a, p, v, e = made.amplitude, made.phase, made.speed, made.restitution
        before, after = v + a * math.cos(p), v - a * math.cos(p)
        ds = np.array([after / before, -math.pi / before])
        half = np.array([ds, -(1 + e) * a * math.sin(p) * ds + np.array([0.0, e])])
        values = np.linalg.eigvals(half) ** 2
        if max(abs(values)) < 0.9:
            break
    problem = zo.load_problem("clapper")
    # In the frame of the ends, the force is A sin t = A cos(t - pi / 2).
    given = {"c": 0.0, "k": 0.0, "d": made.length / 2, "A": a, "omega": 1.0, "restitution": e}
    start = {"place": -made.length / 2, "speed": after, "cosine": math.sin(p), "sine": -math.cos(p)}
    orbit = zo.find_orbit(problem, parameters=given, start=start).unwrap()
    return orbit, problem, list(values)


def _published_oscillator() -> Known:
    # DankowiczSchilder2013, chapter 15.
    problem = zo.load_problem("impact_oscillator")
    known = complex(-0.58429531434153, 0.00560035149247)
    return zo.find_orbit_by_shooting(problem).unwrap(), problem, [known, known.conjugate()]


def _pressed(*slopes: float, damping: float = 0.3, decay: float = 0.0) -> Known:
    machine = Pressed(slopes=slopes, damping=damping, decay=decay)
    orbit = zo.find_orbit(machine.problem, until=200.0).unwrap()
    return orbit, machine.problem, machine.multipliers


def _rimless_wheel() -> Known:
    # A spoke keeps the part cos(2 alpha)^2 of the squared speed, 1/2 for eight spokes.
    problem = wheel()
    return zo.find_orbit(problem).unwrap(), problem, [0.5]


def _observer() -> Known:
    problem = zo.load_problem(OBSERVED)
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    return orbit, problem, [math.exp(-3.0 * orbit.period)]


def _point() -> Known:
    problem = zo.load_problem("forced_oscillator")
    return zo.find_orbit_by_shooting(problem).unwrap(), problem, []


KNOWN: dict[str, Callable[[], Known]] = {
    "hopper, e = 0.5": lambda: _hopper(0.5),
    "hopper, e = 0.95": lambda: _hopper(0.95),
    "oscillator between stops": lambda: _two_sided(1),
    "another oscillator between stops": lambda: _two_sided(2),
    "impact pair": _impact_pair,
    "impact oscillator": _published_oscillator,
    "mass on a stop": lambda: _pressed(0.7),
    "masses on two stops": lambda: _pressed(0.5, -1.2),
    "mass on a stop, strongly damped": lambda: _pressed(0.4, damping=4.0),
    "mass on a stop, with a further state": lambda: _pressed(0.4, decay=0.2),
    "rimless wheel": _rimless_wheel,
    "observer of a valve": _observer,
    "forced oscillator": _point,
}


SLOW = ("masses on two stops", "mass on a stop, strongly damped")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n in SLOW)) for n in KNOWN]
)
def test_every_multiplier_is_within_its_error_of_the_closed_form(name: str) -> None:
    orbit, problem, exact = KNOWN[name]()
    found = zo.floquet_multipliers(orbit, problem=problem)
    # Further multipliers are those of disturbances that vanish.
    every = [*exact, *[0j] * (len(found.values) - len(exact))]
    assert len(found.values) >= len(exact)
    for value, error in zip(found.values, found.errors, strict=True):
        assert min(abs(value - one) for one in every) <= error < 1e-7
    for one in exact:
        assert min(abs(value - one) for value in found.values) <= found.error


@pytest.mark.parametrize("off", [1e-8, 1e-6, 1e-4])
def test_the_errors_of_an_orbit_that_is_not_closed_cover_its_distance(off: float) -> None:
    # The speed of each impact decides: v'^2 = e^2 v^2 + 2 a s, so the slope is e^2 v / v'.
    orbit = zo.find_orbit("hopper", parameters={"restitution": 0.95}).unwrap()
    speed = orbit.start_state["speed"] * (1.0 + off)
    start = {**orbit.start_state, "speed": speed}
    found = zo.floquet_multipliers(
        zo.Orbit(
            problem=orbit.problem,
            parameters=orbit.parameters,
            gains=orbit.gains,
            period=orbit.period,
            start_state=start,
            events=orbit.events,
        )
    )
    away = abs(found.values[0] - 0.95**2)
    assert 1e-2 * off < away <= found.error < 100 * off


# The return map and the times, against forward simulations.

MACHINES = (
    "motor_pendulum",
    "impact_oscillator",
    "hopper",
    pytest.param("kneed_walker", marks=pytest.mark.slow),
    pytest.param("motor_cart", marks=pytest.mark.slow),
    pytest.param("two_motors", marks=pytest.mark.slow),
    pytest.param("limited_pendulum", marks=pytest.mark.slow),
    pytest.param("sampled_pendulum", marks=pytest.mark.slow),
)


@cache
def _orbit(name: str) -> Orbit:
    problem = zo.load_problem(name)
    if problem.has_graph:
        return zo.find_orbit(problem).unwrap()
    return zo.find_orbit_by_shooting(problem).unwrap()


def _sections(problem: zo.Problem, found: Stability, state: np.ndarray, until: float) -> np.ndarray:
    """Return the states at the events of the section in a forward simulation, one per row."""
    names = problem.state_names
    run = zo.simulate(
        problem,
        until=until,
        gains=found.gains,
        parameters=found.parameters,
        start=dict(zip(names, state.tolist(), strict=True)),
    )
    # A simulated machine with one stop does not name it.
    names = (found.event, found.event.removesuffix(" stop"))
    after_zeno = [event for event in run.events if orbit_event_name(event) in names]
    at = state_before if isinstance(after_zeno[0], SwitchEvent) else state_after
    return np.array([at(event) for event in after_zeno])


def _disturbed(
    problem: zo.Problem, found: Stability, orbit: Orbit, change: np.ndarray, size: float, n: int
) -> np.ndarray:
    """Return half the differences at the next `n` sections of two motions from a flight.

    The motions start where the longest flight has its middle, displaced by plus and minus a change.
    """
    names = problem.state_names
    start = np.array([orbit.start_state[name] for name in names])
    run = zo.simulate(
        problem,
        until=orbit.period,
        gains=found.gains,
        parameters=found.parameters,
        start=dict(orbit.start_state),
    )
    flights = [arc for arc in run.arcs if not arc.closed] or list(run.arcs)
    arc = max(flights, key=lambda one: one.end_time - one.start_time)
    middle = np.array(run.state_at((arc.start_time + arc.end_time) / 2))
    moved = size * change * (1e-3 + np.abs(middle) + np.abs(start))
    for cosine in problem.clock[::2]:
        # A clock stays on its circle.
        turn = moved[cosine]
        moved[[cosine, cosine + 1]] = 0.0
        moved[cosine : cosine + 2] = turn * np.array([-middle[cosine + 1], middle[cosine]])
    until = (n + 0.9) * orbit.period
    both = [_sections(problem, found, middle + sign * moved, until)[:n] for sign in (1, -1)]
    return (both[0] - both[1]) / 2


@pytest.mark.parametrize("name", MACHINES)
def test_the_return_map_leads_from_one_section_to_the_next(name: str) -> None:
    problem, orbit = zo.load_problem(name), _orbit(name)
    found = zo.floquet_multipliers(orbit)
    rows = [problem.state_names.index(one) for one in found.coordinates]
    rng = np.random.default_rng(4)
    for _ in range(len(rows) + 1):
        change = rng.normal(size=len(problem.state_names))
        moved = _disturbed(problem, found, orbit, change, 1e-6, 2)[:, rows]
        size = np.max(np.abs(moved), axis=0) + 1e-12
        assert (found.jacobian @ moved[0] - moved[1]) / size == pytest.approx(
            np.zeros(len(rows)), abs=1e-4
        )


@pytest.mark.parametrize("name", MACHINES)
def test_eigenvalues_of_the_return_map_are_the_multipliers(name: str) -> None:
    found = zo.floquet_multipliers(_orbit(name))
    values = np.linalg.eigvals(found.jacobian)
    for value in found.values:
        assert min(abs(values - value)) < 1e-7
    scaled = zo.floquet_multipliers(_orbit(name)).norm
    assert scaled >= found.spectral_radius - found.error


# Times to recover.


def _measured(name: str, n: int, orbit: Orbit | None = None) -> tuple[Stability, np.ndarray]:
    """Return the stability of an orbit, and a disturbance at the next `n` sections."""
    problem, orbit = zo.load_problem(name), orbit or _orbit(name)
    found = zo.floquet_multipliers(orbit)
    change = np.random.default_rng(7).normal(size=len(problem.state_names))
    return found, _disturbed(problem, found, orbit, change, 1e-5, n)


PERIODS = {"impact_oscillator": 14, "kneed_walker": 16, "sampled_pendulum": 18, "hopper": 10}
SEVERAL_SECONDS = ("kneed_walker", "sampled_pendulum")


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow] * (n in SEVERAL_SECONDS)) for n in PERIODS],
)
def test_a_disturbance_in_a_long_simulation_decays_in_the_printed_time(name: str) -> None:
    found, moved = _measured(name, PERIODS[name])
    # Faster directions vanish first. Two multipliers remain: x(n + 2) = a x(n + 1) + b x(n).
    moved = moved[PERIODS[name] // 3 :]
    size = np.max(np.abs(moved), axis=0) + 1e-15
    rows = [k for k in range(len(size)) if size[k] > 1e-9]
    x = (moved / size)[:, rows]
    if found.values[0].imag:
        past = np.stack([x[1:-1].ravel(), x[:-2].ravel()], axis=1)
        fitted: Any = np.linalg.lstsq(past, x[2:].ravel(), rcond=None)[0]
        modulus = math.sqrt(-float(fitted[1]))
    else:
        assert found.slowest is not None
        first = zo.load_problem(name).state_names.index(next(iter(found.slowest.ratios)))
        modulus = abs(moved[-1, first] / moved[0, first]) ** (1 / (len(x) - 1))
    periods = math.log(0.01) / math.log(modulus)
    assert found.periods_to(0.01) == pytest.approx(periods, rel=0.01)
    assert found.milestones["1/e"] == pytest.approx(periods / math.log(100), rel=0.01)


@pytest.mark.parametrize("e", [0.9, 0.95])
def test_the_hopper_takes_the_periods_of_its_closed_form_to_recover(e: float) -> None:
    orbit = zo.find_orbit("hopper", parameters={"restitution": e}).unwrap()
    found = zo.floquet_multipliers(orbit)
    speed = orbit.start_state["speed"]
    start = {**orbit.start_state, "speed": speed * (1 + 1e-6)}
    periods = found.periods_to(0.01)
    assert periods > 10
    run = zo.simulate(
        "hopper", until=(periods + 2) * orbit.period, parameters=orbit.parameters, start=start
    )
    speeds = np.array([abs(event.state_plus[1]) for event in run.impacts]) / speed - 1
    first = int(np.argmax(speeds < 1e-2 * 1e-6)) + 1
    assert math.ceil(periods) == first
    assert found.time_to(0.01) == pytest.approx(periods * orbit.period)


def test_a_disturbance_of_an_unstable_orbit_doubles_in_the_printed_time(
    repelling: zo.Orbit,
) -> None:
    found, moved = _measured("motor_pendulum", 6, repelling)
    # The multiplier of an independent program.
    assert found.values[0].real == pytest.approx(2.910917734, abs=1e-8)
    assert found.unstable
    growth = float(np.linalg.norm(moved[-1]) / np.linalg.norm(moved[0])) ** (1 / 5)
    assert found.milestones == {"twice": pytest.approx(math.log(2) / math.log(growth), rel=1e-3)}


def test_the_slowest_direction_is_that_of_a_late_disturbance() -> None:
    for name in ("motor_pendulum", "hopper"):
        problem = zo.load_problem(name)
        found, moved = _measured(name, 3)
        slow = found.slowest
        assert slow is not None
        first, *others = slow.ratios
        at = {state: moved[1][k] for k, state in enumerate(problem.state_names)}
        for other in others:
            assert at[other] / at[first] == pytest.approx(slow.ratios[other], rel=1e-3)
        assert slow.words.startswith(f"mostly {first}, with" if others else f"{first} alone")


def test_an_orbit_without_multipliers_recovers_within_a_period() -> None:
    found = zo.floquet_multipliers(_orbit("forced_oscillator"))
    assert found.values == found.coordinates == ()
    assert found.slowest is None
    assert found.stable
    assert found.periods_to(0.01) == 1.0
    assert found.periods_to(2.0) == math.inf


def test_a_direction_names_units_that_differ_and_none_that_are_equal() -> None:
    slow = SlowDirection(
        multiplier=0.5,
        ratios={"x": 1.0, "sine": 6.11, "y": -2.0, "current": 3.0},
        units={"x": "m", "sine": "1", "y": "m", "current": "A"},
    )
    assert slow.words == "mostly x, with sine (6.11 per m), y (-2), current (3 A per m)"
