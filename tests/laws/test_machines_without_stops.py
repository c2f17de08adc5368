"""Machines without stops: a relay loop, a rimless wheel, a mass on a spring that it leaves.

Each law has a closed form or a motion by SciPy. What needs a stop is refused in one line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

import zeno_orbits as zo
from tests.support.commands import MISUSE, ask
from tests.support.contactless import wheel, wheel_motion
from tests.support.mechanisms import machine_of
from zeno_orbits.arrays import Vector
from zeno_orbits.continuation import SpecialPointKind
from zeno_orbits.errors import InputError
from zeno_orbits.maps import attractors_at

HYSTERESIS, DAMPING = 0.2, 0.5
G = 9.81


def _loop(p: Mapping[str, ca.SX], *, is_past_armed: bool) -> zo.CompletedSystem:
    """Return a spring and damper under a force of unit size, which a relay with hysteresis sets."""
    x, v, side = ca.SX.sym("x"), ca.SX.sym("v"), ca.SX.sym("side")
    plant = zo.HybridLagrangian.from_energies(
        q=x, v=v, kinetic=v**2 / 2, potential=x**2 / 2, passive_force=-DAMPING * v
    )
    relay = zo.Auxiliary(states=side, rate=ca.SX(0), force=side, input_power=side * v)
    # By its side a switch is armed before it occurs, by the speed also just after that.
    armed = v if is_past_armed else side
    switches = (
        zo.Switch(name="on", guard=x + p["h"], armed=-armed, others_after=ca.SX(1)),
        zo.Switch(name="off", guard=p["h"] - x, armed=armed, others_after=ca.SX(-1)),
    )
    return zo.hybrid_system(plant, relay, switches=switches)


loop_model, armed_by_speed = (partial(_loop, is_past_armed=one) for one in (False, True))


def relay_loop(model: Any = loop_model) -> zo.Problem:
    return machine_of(model, {"x": "m", "v": "m/s", "side": "1"}, {"h": HYSTERESIS})


def loop_orbit() -> tuple[float, float, float]:
    """Return period, speed at a switch, and multiplier of the relay loop by its half-period map."""
    flow, middle, eye = np.array([[0.0, 1.0], [-1.0, -DAMPING]]), np.array([1.0, 0.0]), np.eye(2)

    def after_on(half: float) -> Vector:
        # The orbit is odd: half a period takes -start to start.
        moved = expm(flow * half)
        return np.asarray(np.linalg.solve(eye + moved, middle - moved @ middle))

    half = brentq(lambda t: after_on(t)[0] - HYSTERESIS, 1.2, 2.5, xtol=1e-15)
    end = after_on(half)
    rate = flow @ end + np.array([0.0, 1.0])
    saltation = eye - np.outer(rate, [1.0, 0.0]) / rate[0]
    return 2 * half, end[1], float((saltation @ expm(flow * half))[1, 1] ** 2)


def spring_model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a mass that falls onto a spring, which pushes only."""
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    mass = zo.HybridLagrangian.from_energies(
        q=x,
        v=v,
        kinetic=v**2 / 2,
        potential=G * x,
        passive_force=p["k"] * ca.fmax(-x, 0),
        stops=(),
    )
    return zo.hybrid_system(mass, zo.no_drive(mass))


@pytest.mark.usefixtures("both_loops")
@pytest.mark.parametrize("stiffness", [10.0, 1e3, 1e7])
def test_a_mass_meets_and_leaves_its_spring_at_the_times_of_the_closed_form(
    stiffness: float,
) -> None:
    height, w = 1.0, math.sqrt(stiffness)
    speed = math.sqrt(2 * G * height)
    fall = speed / G
    contact = 2 * (math.pi - math.atan(speed * w / G)) / w
    problem = machine_of(spring_model, {"x": "m", "v": "m/s"}, {"k": stiffness})
    found = zo.simulate(problem, start={"x": height}, until=5 * (2 * fall + contact))
    times = np.array([one.time for one in found.events])
    n = np.arange(5)
    meets = fall + n * (2 * fall + contact)
    expected = np.sort(np.concatenate([meets, meets + contact]))
    assert len(times) == 10
    assert not found.impacts
    assert times == pytest.approx(expected, rel=1e-11)


@pytest.mark.usefixtures("both_loops")
def test_a_smooth_motion_has_no_event() -> None:
    problem = machine_of(spring_model, {"x": "m", "v": "m/s"}, {"k": 10.0})
    found = zo.simulate(problem, start={"x": 1.0}, until=0.4)
    assert not found.events
    assert found.end_state == pytest.approx([1 - G * 0.08, -G * 0.4], rel=1e-12)


@pytest.mark.parametrize("model", [loop_model, armed_by_speed])
def test_the_relay_loop_has_the_period_and_multiplier_of_its_half_period_map(model: Any) -> None:
    period, speed, multiplier = loop_orbit()
    problem = relay_loop(model)
    orbit = zo.find_orbit(problem, start={"x": 0.0, "v": 0.5, "side": 1.0}).unwrap()
    assert orbit.period == pytest.approx(period, rel=1e-11)
    assert abs(orbit.start_state["v"]) == pytest.approx(speed, rel=1e-11)
    found = np.abs(orbit.floquet_multipliers)
    assert np.max(found) == pytest.approx(multiplier, rel=1e-9)
    assert zo.verify(orbit, problem=problem).passed
    returns = zo.return_map(orbit, "switch on", problem=problem)
    assert abs(returns.multipliers[0]) == pytest.approx(multiplier, rel=1e-9)


@pytest.mark.usefixtures("both_loops")
def test_a_map_names_a_relay_loop_whose_switches_stay_armed() -> None:
    problem = replace(relay_loop(armed_by_speed), starts=({"side": 1.0},))
    (found,) = attractors_at(problem, [problem.values()])
    assert found.period == pytest.approx(loop_orbit()[0], rel=1e-9)


@pytest.mark.usefixtures("both_loops")
def test_a_start_at_a_switch_that_may_be_due_or_past_is_refused() -> None:
    start = {"x": -HYSTERESIS, "v": -1.0, "side": 1.0}
    with pytest.raises(zo.SimulationError, match="Start a little before or beyond it"):
        zo.simulate(relay_loop(armed_by_speed), start=start, until=1.0)


@pytest.mark.parametrize("slope", [0.07, 0.08, 0.2])
def test_the_rimless_wheel_has_the_period_of_its_energy_balance(slope: float) -> None:
    period, _ = wheel_motion(slope)
    orbit = zo.find_orbit(wheel(), parameters={"slope": slope}).unwrap()
    assert orbit.period == pytest.approx(period, rel=1e-9)
    found = np.abs(orbit.floquet_multipliers)
    assert np.max(found) == pytest.approx(math.cos(math.pi / 4) ** 2, rel=1e-8)


@pytest.mark.slow
def test_walking_ends_where_the_wheel_stands_on_one_spoke() -> None:
    half = math.pi / 8

    def surplus(slope: float) -> float:
        # The speed after a strike, squared, over that which reaches the top.
        return math.cos(slope - half) - math.cos(slope + half) - (1 - math.cos(slope - half))

    slope = brentq(surplus, 0.01, 0.2, xtol=1e-15)
    orbit = zo.find_orbit(wheel()).unwrap()
    found = zo.continue_orbit(orbit, ("slope", 0.03, 0.1), problem=wheel())
    first = found.families[0].first
    assert first.kind is SpecialPointKind.PERIOD_INFINITE
    assert first.at.value == pytest.approx(slope, rel=1e-9)


def test_what_needs_a_stop_is_refused() -> None:
    with pytest.raises(InputError, match="lacks a stop, so no Zeno point exists"):
        zo.zeno_condition(wheel())
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    energies = {"q": x, "v": v, "kinetic": v**2 / 2, "potential": ca.SX(0)}
    free = zo.HybridLagrangian.from_energies(**energies)
    with pytest.raises(ValueError, match="must be left out of a machine without a stop"):
        zo.hybrid_system(free, zo.no_drive(free), 0.3)
    stop = zo.Stop(name="wall", gap=x, restitution=0.3)
    with pytest.raises(ValueError, match="Give either the argument `gap` or the argument `stops`"):
        zo.HybridLagrangian.from_energies(**energies, gap=x, stops=(stop,))
    one = zo.HybridLagrangian.from_energies(**energies, gap=x)
    with pytest.raises(ValueError, match="`restitution` is missing"):
        zo.hybrid_system(one, zo.no_drive(one))


def test_the_zeno_condition_reads_the_restitution_of_a_stop_with_a_name() -> None:
    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        x, v = ca.SX.sym("x"), ca.SX.sym("v")
        floor = zo.Stop(name="floor", gap=x, restitution=p["e"] / 2)
        ball = zo.HybridLagrangian.from_energies(
            q=x, v=v, kinetic=v**2 / 2, potential=G * x, stops=(floor,)
        )
        return zo.hybrid_system(ball, zo.no_drive(ball))

    found = zo.zeno_condition(machine_of(model, {"x": "m", "v": "m/s"}, {"e": 0.5}))
    assert found.as_json()["restitution"] == 0.25
    assert found.always


@pytest.mark.slow
def test_a_recording_of_a_relay_loop_shows_its_orbit() -> None:
    problem = relay_loop()
    start = {"v": 0.5, "side": 1.0}
    orbit = zo.find_orbit(problem, start=start).unwrap()
    run = zo.simulate_rig(problem, until=40.0, start=orbit.start_state)
    assert run.stop_names == ()
    assert run.gap.shape == (len(run.times), 0)
    x = run.states[:, 0]
    expected = np.interp(run.times, *_sampled(problem, orbit.start_state))
    assert np.max(np.abs(x - expected)) < 1e-4


def _sampled(problem: zo.Problem, start: Mapping[str, float]) -> tuple[Vector, Vector]:
    times, states = zo.simulate(problem, start=start, until=40.0).sampled(20000)
    return times, states[:, 0]


@pytest.mark.slow
def test_the_pages_and_commands_serve_a_machine_without_a_stop(tmp_path: Path) -> None:
    file = tmp_path / "wheel.py"
    file.write_text("from tests.support.contactless import wheel\n\nPROBLEM = wheel()\n")
    orbit = tmp_path / "orbit.json"
    assert ask("search", file, "-o", orbit).code == 0
    assert ask("verify", orbit).code == 0
    assert ask("stability", orbit).code == 0
    assert ask("plot", orbit, "-o", tmp_path / "pictures").code == 0
    assert ask("report", orbit, "-o", tmp_path / "page.html").code == 0
    assert ask("export", file, "-o", tmp_path / "c").code == 0
    assert ask("rig", file, "--until", "3", "-o", tmp_path / "recording.csv").code == 0
    refused = ask("zeno-condition", file)
    assert refused.code == MISUSE
    assert "`wheel` lacks a stop, so no Zeno point exists" in refused.err
