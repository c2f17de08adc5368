"""Kinks at the time of another kink, of a release or of an impact, and kinks that are undefined.

A force that depends on the time alone has integrals as its truth: the speed is the integral of the
force, the height the integral of the speed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import casadi
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.mechanisms import machine_of
from zeno_orbits.simulation import EventDerivatives

ca: Any = casadi

_integral: Any = quad
LOCATED = 1e-10
"""Of times and states: a hundred times the tolerance of the integrator."""
T0, UNTIL, G = 0.7, 1.2, 9.81
"""Time at which events meet, end of the runs [s], and a weight [m/s2]."""
S0, C0 = math.sin(T0), math.cos(T0)
Force = Callable[[Any, Any, zo.Clock], Any]
Truth = Callable[[float], float]


pytestmark = pytest.mark.usefixtures("both_loops")


def driven(force: Force, *start: float, e: float = 0.5) -> zo.Problem:
    """Return masses over a floor each, at rest at some heights, under forces of a clock."""
    n = len(start)

    def model(p: Mapping[str, Any]) -> zo.CompletedSystem:
        q, v, clock = ca.SX.sym("q", n), ca.SX.sym("v", n), zo.Clock.at(ca.SX(1.0))
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=ca.SX(0),
            applied_force=force(q, v, clock) + 0 * q,
            clock=clock,
            stops=tuple(zo.Stop(name=f"s{k}", gap=q[k], restitution=p["e"]) for k in range(n)),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    states = {f"x{k}": "m" for k in range(n)} | {f"v{k}": "m/s" for k in range(n)}
    problem = machine_of(model, states | {"cosine": "1", "sine": "1"}, {"e": e})
    heights = {f"x{k}": height for k, height in enumerate(start)}
    return replace(problem, starts=({"cosine": 1.0, **heights},))


def moved(force: Truth, height: float, begin: float = 0.0, speed: float = 0.0) -> list[float]:
    """Return height and speed at the end of a run under a force of the time."""
    options: dict[str, Any] = {"points": [T0], "epsabs": 1e-13, "epsrel": 1e-13}
    gained: Any = _integral(force, begin, UNTIL, **options)[0]

    def moment(time: float) -> float:
        return (UNTIL - time) * force(time)

    rise: Any = _integral(moment, begin, UNTIL, **options)[0]
    return [height + speed * (UNTIL - begin) + rise, speed + gained]


def step(condition: Any, high: float = 1.0) -> Any:
    """Return a level where a condition holds, and else zero."""
    return ca.if_else(condition, high, 0)


def wave(clock: zo.Clock, time: float, level: float) -> Any:
    """Return a piecewise input with a level from a time on."""
    return zo.piecewise(clock, (0.0, level), (time,))


# Two kinks of the clock at one time.

MEETING: dict[str, tuple[Force, Truth]] = {
    "steps": (
        lambda _q, _v, c: step(c.sine > S0) + step(c.cosine < C0, 2),
        lambda t: 3.0 * (t > T0),
    ),
    "step and corner": (
        lambda _q, _v, c: step(c.cosine < C0) + ca.fabs(c.sine - S0),
        lambda t: (t > T0) + abs(math.sin(t) - S0),
    ),
    "corners": (
        lambda _q, _v, c: ca.fmax(c.sine, S0) - ca.fmin(c.cosine, C0),
        lambda t: max(math.sin(t), S0) - min(math.cos(t), C0),
    ),
    "three": (
        lambda _q, _v, c: (
            step(c.sine > S0) + step(c.cosine < C0, 2) + step(c.sine > S0 / C0 * c.cosine, 4)
        ),
        lambda t: 7.0 * (t > T0),
    ),
    "waveforms": (
        lambda _q, _v, c: wave(c, T0, 2.0) + zo.piecewise(c, (0.0, 1.0, 3.0), (T0, 5.0)),
        lambda t: 3.0 * (t > T0),
    ),
    "one within the other": (
        lambda _q, _v, c: ca.fmin(2, step(c.sine > S0, 5)) * step(c.cosine < C0),
        lambda t: 2.0 * (t > T0),
    ),
}


@pytest.mark.parametrize("name", fast(3, MEETING))
def test_kinks_of_the_clock_may_meet(name: str) -> None:
    force, truth = MEETING[name]
    run = zo.simulate(driven(force, 2.0), until=UNTIL)
    assert run.end_state[:2] == pytest.approx(moved(truth, 2.0), abs=LOCATED)
    assert [one.time for one in run.switches] == pytest.approx([T0], abs=LOCATED)


def test_an_orbit_with_waveforms_that_meet_has_the_multipliers_of_its_flow() -> None:
    def force(q: Any, v: Any, clock: zo.Clock) -> Any:
        both = wave(clock, 2.0, 1.0) * (1 + 0.2 * q) + wave(clock, 2.0, 3.0)
        return both - q - 0.3 * v - 5

    orbit = zo.find_orbit(driven(lambda q, v, c: force(q - 9, v, c), 9.0)).unwrap()
    turn = 2 * math.pi
    flows = [np.array([[0, 1], [-1 + 0.2 * up, -0.3]]) for up in (0, 1)]
    period: Any = expm(flows[1] * (turn - 2.0)) @ expm(flows[0] * 2.0)
    eigenvalues: Any = np.linalg.eigvals
    wanted: Any = np.sort(np.abs(eigenvalues(period)))
    assert sorted(map(abs, orbit.floquet_multipliers)) == pytest.approx(wanted.tolist(), abs=1e-9)
    assert orbit.certificate["passed"]


MATTERS: dict[str, tuple[Force, float]] = {
    "clock and speed": (lambda _q, v, c: 1 + step(c.sine > S0) + step(v > T0), 2.0),
    "clock and height": (lambda q, _v, c: 2 + step(c.sine > S0) + step(q > 2 + T0**2), 2.0),
    "speed and height": (lambda q, v, _c: 2 + step(v > 2 * T0) + step(q > 2 + T0**2), 2.0),
}


@pytest.mark.parametrize("name", MATTERS)
def test_kinks_of_other_states_that_meet_are_refused(name: str) -> None:
    force, height = MATTERS[name]
    with pytest.raises(zo.SimultaneousEventsError, match="coincide to rounding: switch kink"):
        zo.simulate(driven(force, height), until=UNTIL)


# A release at a kink.


DRAGS = {
    "fabs": (lambda v: -0.2 * ca.fabs(v) * v, 0.2, 0.2),
    "if_else": (lambda v: ca.if_else(v > 0, -0.2, 0.1) * v**2, 0.2, 0.1),
    "fmax": (lambda v: -0.2 * ca.fmax(v, 0) ** 2, 0.2, 0.0),
}
"""Drags whose kink is the rest of their mass, with their factors on the way up and down."""


def thrown(names: tuple[str, ...], jump: float, *, rests: bool) -> zo.Problem:
    """Return masses with a drag each and a force that jumps at rest.

    Args:
        names: Drag of each mass.
        jump: Size of the jump of every force.
        rests: Whether every mass rests on the one below. Otherwise they are apart.
    """
    n = len(names)

    def model(_: Mapping[str, Any]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
        drags = [DRAGS[name][0](v[k]) - jump * ca.sign(v[k]) for k, name in enumerate(names)]
        press = 50 * (q[n - 1] - q[0]) if rests else 0.0
        gaps = [q[0] + 1, *(q[k] - (q[k - 1] if rests else -1) for k in range(1, n))]
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=G * ca.sum1(q) + press,
            passive_force=ca.vertcat(*drags),
            stops=tuple(
                zo.Stop(name=f"s{k}", gap=gap, restitution=0.5) for k, gap in enumerate(gaps)
            ),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    states = {f"x{k}": "m" for k in range(n)} | {f"v{k}": "m/s" for k in range(n)}
    return machine_of(model, states, {})


def _thrown_speed(speed: float, up: float, down: float, jump: float, time: float) -> float:
    """Return the speed of a mass that is thrown up, by ``tan`` and ``tanh``."""
    rising, falling = G + jump, G - jump
    apex = math.atan(speed * math.sqrt(up / rising)) / math.sqrt(up * rising)
    if down == 0.0:
        return -falling * (time - apex)
    return -math.sqrt(falling / down) * math.tanh(math.sqrt(falling * down) * (time - apex))


THROWN = [("fabs", "fabs"), ("if_else", "fmax"), ("fmax", "fabs", "if_else")]


@pytest.mark.parametrize("jump", [0.0, 0.7])
@pytest.mark.parametrize("names", THROWN)
def test_kinks_at_rest_of_masses_in_contact_are_crossed_together(
    names: tuple[str, ...], jump: float
) -> None:
    n, until = len(names), 0.3
    problem = thrown(names, jump, rests=True)
    run = zo.simulate(problem, until=until, start={f"v{k}": 1.0 for k in range(n)})
    up, down = (sum(DRAGS[name][side] for name in names) / n for side in (1, 2))
    speed = _thrown_speed(1.0, up, down, jump, until)
    assert run.end_state[n:] == pytest.approx(n * [speed], abs=LOCATED)
    assert {arc.closed for arc in run.arcs} == {tuple(f"s{k}" for k in range(1, n))}
    graph, settings = problem.graph_dynamics(problem.values()), zo.SimulationSettings()
    *_, last = EventDerivatives(graph, (), settings.tolerance).passages(run)
    # All masses are thrown faster together.
    near = [_thrown_speed(1.0 + step, up, down, jump, until) for step in (1e-5, -1e-5)]
    found = last.end.state[n:, n : 2 * n].sum(axis=1)
    assert found == pytest.approx(n * [(near[0] - near[1]) / 2e-5], abs=1e-8)


@pytest.mark.parametrize("name", DRAGS)
def test_kinks_that_leave_the_flow_as_it_is_may_meet(name: str) -> None:
    until = 0.3
    run = zo.simulate(thrown((name, name), 0.0, rests=False), until=until, start={"v0": 1, "v1": 1})
    _, up, down = DRAGS[name]
    speed = _thrown_speed(1.0, up, down, 0.0, until)
    assert run.end_state[2:] == pytest.approx([speed, speed], abs=LOCATED)


def test_jumps_that_meet_by_chance_are_refused() -> None:
    # Masses that are thrown a little faster meet their jumps one after the other.
    with pytest.raises(zo.SimultaneousEventsError, match="coincide"):
        zo.simulate(thrown(("fabs", "fabs"), 0.7, rests=False), until=0.3, start={"v0": 1, "v1": 1})


def pull(clock: zo.Clock) -> Any:
    """Return a force that presses a mass to its floor until the time at which events meet."""
    return 3 * (clock.sine - S0)


def pulled(t: float) -> float:
    """Return the same force at a time."""
    return 3 * (math.sin(t) - S0)


RELEASES: dict[str, tuple[Force, Truth]] = {
    "corner": (
        lambda _q, _v, c: pull(c) + 2 * ca.fmax(c.sine - S0, 0),
        lambda t: pulled(t) + 2 * max(math.sin(t) - S0, 0),
    ),
    "size": (
        lambda _q, _v, c: pull(c) + ca.fabs(c.sine - S0),
        lambda t: pulled(t) + abs(math.sin(t) - S0),
    ),
    "corner of the cosine": (
        lambda _q, _v, c: pull(c) - ca.fmin(c.cosine - C0, 0),
        lambda t: pulled(t) - min(math.cos(t) - C0, 0),
    ),
    "a step upwards": (
        lambda _q, _v, c: pull(c) + step(c.sine > S0, 2),
        lambda t: pulled(t) + 2.0 * (t > T0),
    ),
}


@pytest.mark.parametrize("name", RELEASES)
def test_a_stop_may_open_at_a_kink(name: str) -> None:
    force, truth = RELEASES[name]
    run = zo.simulate(driven(force, 0.0), until=UNTIL)
    assert [one.time for one in run.releases] == pytest.approx([T0], abs=LOCATED)
    assert run.end_state[:2] == pytest.approx(moved(truth, 0.0, begin=T0), abs=LOCATED)


def test_a_kink_of_another_mass_may_meet_a_release() -> None:
    def force(_q: Any, _v: Any, clock: zo.Clock) -> Any:
        return ca.vertcat(pull(clock), step(clock.cosine < C0, 4))

    run = zo.simulate(driven(force, 0.0, 1.0), until=UNTIL)
    low, high = (
        moved(pulled, 0.0, begin=T0),
        moved(lambda t: 4.0 * (t > T0), 1.0),
    )
    wanted = [low[0], high[0], low[1], high[1]]
    assert run.end_state[:4] == pytest.approx(wanted, abs=LOCATED)
    assert [one.time for one in run.releases] == pytest.approx([T0], abs=LOCATED)


PRESSED: dict[str, Force] = {
    "step": lambda _q, _v, c: pull(c) + step(c.sine > S0, -2),
    "corner": lambda _q, _v, c: pull(c) - 7 * ca.fmax(c.sine - S0, 0),
    "size": lambda _q, _v, c: pull(c) - 4 * ca.fabs(c.sine - S0) + 4 * ca.fmax(S0 - c.sine, 0),
}


@pytest.mark.parametrize("name", PRESSED)
def test_a_release_at_a_kink_beyond_which_the_stop_is_pressed_is_refused(name: str) -> None:
    with pytest.raises(zo.SimultaneousEventsError, match="release s0"):
        zo.simulate(driven(PRESSED[name], 0.0), until=UNTIL)


# An impact at a kink.

FALL = math.sqrt(2 / G)
"""Time of a fall from one meter [s]."""
IMPACTS: dict[str, Force] = {
    "clock": lambda _q, _v, c: step(c.sine > math.sin(FALL)) - G,
    "corner of the clock": lambda _q, _v, c: step(c.cosine < math.cos(FALL)) - G,
    "speed and clock": lambda _q, v, c: (
        step(c.sine > math.sin(FALL)) - 5 * ca.fmin(v + G * FALL, 0) - G
    ),
}


@pytest.mark.parametrize("name", IMPACTS)
def test_a_mass_may_strike_its_floor_at_a_kink(name: str) -> None:
    run = zo.simulate(driven(IMPACTS[name], 1.0), until=0.8)
    later, speed = 0.8 - FALL, 0.5 * G * FALL
    wanted = [speed * later - (G - 1) * later**2 / 2, speed - (G - 1) * later]
    assert [one.time for one in run.impacts] == pytest.approx([FALL], abs=LOCATED)
    assert run.end_state[:2] == pytest.approx(wanted, abs=LOCATED)


# Kinks that are undefined.

UNDEFINED: dict[str, tuple[Force, Truth]] = {
    "root": (
        lambda _q, _v, c: ca.if_else(c.sine > S0, ca.fmin(1, 9 * ca.sqrt(c.sine - 0.3)), 0),
        lambda t: 1.0 * (t > T0),
    ),
    "logarithm": (
        lambda _q, _v, c: ca.if_else(c.sine < S0, 2, ca.fmax(-3, ca.log(c.sine - 0.6) - 9)),
        lambda t: 2.0 if t < T0 else -3.0,
    ),
    "arc sine": (
        lambda _q, _v, c: ca.if_else(c.cosine > C0, ca.fabs(c.cosine), ca.fabs(ca.asin(c.cosine))),
        lambda t: math.cos(t) if t < T0 else math.asin(math.cos(t)),
    ),
    "never chosen": (
        lambda q, _v, _c: ca.if_else(q > -1, 1, ca.fmax(ca.sqrt(-1 - q), 2)),
        lambda _t: 1.0,
    ),
    "two levels": (
        lambda _q, _v, c: ca.if_else(
            c.sine > S0,
            ca.if_else(ca.sqrt(c.sine - 0.4) > 0.1, ca.fmin(ca.log(c.sine - 0.4), 5), 7),
            1,
        ),
        lambda t: math.log(math.sin(t) - 0.4) if t > T0 else 1.0,
    ),
}


@pytest.mark.parametrize("name", UNDEFINED)
def test_a_kink_may_be_undefined_where_it_has_no_effect(name: str) -> None:
    force, truth = UNDEFINED[name]
    run = zo.simulate(driven(force, 9.0), until=UNTIL)
    assert run.end_state[:2] == pytest.approx(moved(truth, 9.0), abs=LOCATED)


NOT_A_NUMBER: dict[str, Force] = {
    "root": lambda _q, _v, c: step(ca.sqrt(c.sine - 0.3) > 0.1),
    "logarithm": lambda _q, _v, c: ca.if_else(c.sine < S0, step(ca.log(c.sine - 0.6) < 9), 1),
    "arc sine": lambda _q, _v, c: ca.sign(ca.asin(2 * c.cosine)),
}


@pytest.mark.parametrize("name", NOT_A_NUMBER)
def test_an_undefined_kink_that_has_an_effect_is_refused(name: str) -> None:
    with pytest.raises(zo.SimulationError, match="must be a number, but it is NaN"):
        zo.simulate(driven(NOT_A_NUMBER[name], 9.0), until=UNTIL)


def bouncing(step: str, t0: float) -> zo.Problem:
    """Return an oscillator at a wall, driven by a cosine and a step or corner at a time."""

    def model(p: Mapping[str, Any]) -> zo.CompletedSystem:
        q, v, clock = ca.SX.sym("q"), ca.SX.sym("v"), zo.Clock.at(ca.SX(1.0))
        turned = clock.sine * ca.cos(p["t0"]) - clock.cosine * ca.sin(p["t0"])
        force = zo.piecewise(clock, (0.0, 1.0), (p["t0"],)) if step == "jump" else ca.fabs(turned)
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=q**2 / 2,
            applied_force=-0.3 * v + 3 * clock.cosine + force,
            clock=clock,
            stops=(zo.Stop(name="wall", gap=q, restitution=0.6),),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    states = {"q": "m", "v": "m/s", "cosine": "1", "sine": "1"}
    problem = machine_of(model, states, {"t0": t0})
    return replace(problem, starts=({"cosine": 1.0, "q": 0.5},))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("step", "guess", "is_known"), [("jump", 2.921833619, False), ("corner", 3.160339081, True)]
)
def test_a_jump_at_the_time_of_an_impact_leaves_the_multipliers_unknown(
    step: str, guess: float, is_known: bool
) -> None:
    def orbit_at(t0: float) -> tuple[zo.Stability, float]:
        problem = bouncing(step, t0)
        orbit = zo.find_orbit(problem, allow_unstable=True).unwrap()
        phase = math.atan2(orbit.start_state["sine"], orbit.start_state["cosine"])
        return zo.floquet_multipliers(orbit, problem=problem), phase % (2 * math.pi)

    t0 = guess
    for _ in range(4):
        # The phase of the impact changes by little with the time of the step.
        t0 = orbit_at(t0)[1]
    met, phase = orbit_at(t0)
    assert phase == pytest.approx(t0, abs=1e-12)
    refused = "" if is_known else "stability of the orbit is unknown: its spectral radius is 0.3"
    assert refused in zo.find_orbit(bouncing(step, t0)).detail
    assert met.stable is is_known
    assert not met.unstable
    earlier, later = (orbit_at(t0 + apart)[0] for apart in (-1e-6, 1e-6))
    assert earlier.stable
    assert later.stable
    # The two orders have multipliers of their own, or at a corner the same ones.
    apart = abs(earlier.spectral_radius - later.spectral_radius)
    assert (apart < 1e-6) is is_known


@pytest.mark.slow
def test_a_release_that_a_jump_causes_keeps_the_stability() -> None:
    def model(_: Mapping[str, Any]) -> zo.CompletedSystem:
        q, v, clock = ca.SX.sym("q"), ca.SX.sym("v"), zo.Clock.at(ca.SX(1.0))
        mass = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=q**2 / 2,
            passive_force=-0.8 * v,
            applied_force=3 * ca.sign(clock.sine),
            clock=clock,
            stops=(zo.Stop(name="wall", gap=q, restitution=0.1),),
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    problem = machine_of(model, {"q": "m", "v": "m/s", "cosine": "1", "sine": "1"})
    orbit = zo.find_orbit(replace(problem, starts=({"cosine": 1.0, "q": 0.5},))).unwrap()
    assert "release wall" in [event.name for event in orbit.events]
    assert zo.floquet_multipliers(orbit, problem=problem).stable
