"""Held states: machines with closed forms, and wrong declarations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.mechanisms import machine_of
from zeno_orbits.integrators import RungeKutta
from zeno_orbits.simulation import SimulationSettings, SimulationTask, by_reference, simulate

W, G_FALL, E = 2.0, 12.0, 0.5
"""Speed after an impact of the juggled ball's orbit, acceleration of its fall, and restitution."""
HEIGHT, GRAVITY, RATE, MEMORY = 0.3, 9.81, 60.0, 0.4
"""The thrown mass: height of the throw, gravity, rate of the force, and multiplier."""


def juggler_model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    r"""Return a ball with an acceleration that is set at its impact and at its top.

    It rises with :math:`e^2 g (w / w_0)^{2 \alpha}` and falls with `g`. So the speed `w` after an
    impact becomes :math:`w\,(w_0 / w)^\alpha`.
    """
    x, v, push = ca.SX.sym("x"), ca.SX.sym("v"), ca.SX.sym("push")
    ball = zo.HybridLagrangian.from_energies(
        q=x,
        v=v,
        kinetic=v**2 / 2,
        potential=ca.SX(0),
        passive_force=-push,
        stops=(zo.Stop(name="table", gap=x, restitution=p["e"]),),
    )
    rise = p["e"] ** 2 * G_FALL * (v / W) ** (2 * p["alpha"])
    parts = (
        zo.no_drive(ball),
        zo.Hold(states=push, at="impact table", after=rise),
        zo.Hold(states=(seen := ca.SX.sym("seen")), at="impact table", after=v + 0 * seen),
    )
    top = zo.Switch(name="top", guard=v, others_after=ca.vertcat(G_FALL, seen))
    return zo.hybrid_system(ball, parts, switches=(top,))


def juggler(alpha: float = 0.7) -> zo.Problem:
    return machine_of(
        juggler_model,
        {"x": "m", "v": "m/s", "push": "m/s^2", "seen": "m/s"},
        {"e": E, "alpha": alpha},
    )


def thrower_model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a mass whose force begins to rise at its Zeno point, at a rate of its last release.

    The force is the weight until the Zeno point, zero at the release, and the weight again from a
    height on. The rate has a memory.
    """
    x, v, force = ca.SX.sym("x"), ca.SX.sym("v"), ca.SX.sym("force")
    is_on, rate = ca.SX.sym("is_on"), ca.SX.sym("rate")
    mass = zo.HybridLagrangian.from_energies(
        q=x,
        v=v,
        kinetic=v**2 / 2,
        potential=ca.SX(0),
        stops=(zo.Stop(name="floor", gap=x, restitution=p["e"]),),
    )
    parts = (
        zo.Auxiliary(states=force, rate=is_on * rate, force=force, input_power=force * v),
        zo.Hold(states=is_on, at="zeno floor", after=ca.SX(1)),
        zo.Hold(states=rate, at="release floor", after=p["k"] + p["m"] * (rate - p["k"])),
    )
    rise = zo.Switch(
        name="high",
        guard=HEIGHT - x,
        armed=v,
        others_after=ca.vertcat(-GRAVITY, 0, rate),
    )
    return zo.hybrid_system(mass, parts, switches=(rise,))


def thrower() -> zo.Problem:
    units = {"x": "m", "v": "m/s", "force": "N", "is_on": "1", "rate": "N/s"}
    return machine_of(thrower_model, units, {"e": E, "k": RATE, "m": MEMORY})


@pytest.mark.usefixtures("both_loops")
def test_a_ball_is_juggled_by_accelerations_that_are_set_at_its_events() -> None:
    alpha, speed = 0.7, 1.2 * W
    start = {"v": speed, "push": E**2 * G_FALL * (speed / W) ** (2 * alpha), "seen": speed}
    found = zo.simulate(juggler(alpha), start=start, until=9.0)
    time = 0.0
    assert len(found.impacts) > 5
    for impact in found.impacts:
        rise = E**2 * G_FALL * (speed / W) ** (2 * alpha)
        fall = speed * math.sqrt(G_FALL / rise)
        time += speed / rise + fall / G_FALL
        speed *= (W / speed) ** alpha
        assert impact.time == pytest.approx(time, rel=1e-11)
        assert impact.state_plus[1] == pytest.approx(speed, rel=1e-11)
    for event in found.switches:
        assert event.name in ("top", "hold at impact table")
        assert event.state_plus[:2] == pytest.approx(event.state_minus[:2], abs=1e-15)
    held = [one for one in found.switches if one.name == "hold at impact table"]
    assert [one.time for one in held] == [one.time for one in found.impacts]
    assert all(one.state_plus[3] == one.state_plus[1] for one in held)


@pytest.mark.parametrize("alpha", [0.7, 1.6])
def test_a_juggled_orbit_has_the_multiplier_of_its_law(alpha: float) -> None:
    problem = juggler(alpha)
    start = {"v": W, "push": E**2 * G_FALL, "seen": W}
    orbit = zo.find_orbit_by_shooting(problem, start=start).unwrap()
    assert orbit.sequence == ("switch top", "impact table", "switch hold at impact table")
    assert orbit.period == pytest.approx(W / (E**2 * G_FALL) + W / E / G_FALL, rel=1e-12)
    stability = zo.floquet_multipliers(orbit, problem=problem)
    assert stability.values[0] == pytest.approx(1 - alpha, rel=1e-9)
    certificate = zo.verify(orbit, problem=problem)
    assert certificate.passed, certificate.verdict()


@pytest.mark.usefixtures("both_loops")
def test_a_mass_is_thrown_from_its_zeno_point_and_release() -> None:
    time, rate = 0.0, 2 * RATE
    found = zo.simulate(thrower(), start={"is_on": 1.0, "rate": rate}, until=8.0)
    assert len(found.releases) > 3
    for zeno, release in zip(found.zeno_points, found.releases, strict=False):
        throw = (6 * HEIGHT / rate) ** (1 / 3)
        up = rate * throw**2 / 2
        down = math.sqrt(up**2 + 2 * GRAVITY * HEIGHT)
        time += throw + (up + down) / GRAVITY + 2 * E * down / (GRAVITY * (1 - E))
        assert zeno.time == pytest.approx(time, rel=1e-10)
        time += GRAVITY / rate
        assert release.time == pytest.approx(time, rel=1e-10)
        rate = RATE + MEMORY * (rate - RATE)


@pytest.mark.slow
def test_a_thrown_orbit_remembers_what_is_held() -> None:
    problem = thrower()
    start = {"is_on": 1.0, "rate": RATE}
    orbit = zo.find_orbit_by_shooting(problem, start=start, section="release floor").unwrap()
    assert orbit.sequence == (
        "switch high",
        "zeno floor",
        "switch hold at zeno floor",
        "release floor",
        "switch hold at release floor",
    )
    for section in ("release floor", "zeno floor", "switch high"):
        returns = zo.return_map(orbit, problem=problem, section=section)
        assert returns.multipliers[0] == pytest.approx(MEMORY, rel=1e-9)
    certificate = zo.verify(orbit, problem=problem)
    assert certificate.passed, certificate.verdict()
    # A rate that the release would not keep.
    changed = replace(orbit, start_state={**orbit.start_state, "rate": 1.001 * RATE})
    refused = zo.verify(changed, problem=problem)
    assert not refused.passed
    assert refused.residuals["closure"] > 1e-4


@pytest.mark.parametrize("problem", [juggler(), thrower()], ids=["juggler", "thrower"])
def test_the_compiled_loop_and_its_reference_have_equal_events(problem: zo.Problem) -> None:
    start = {"v": W, "push": 3.1} if "push" in problem.state_names else {"is_on": 1.0, "rate": 80.0}
    machine, x = problem.graph_dynamics(problem.values()), np.array(problem.state_vector(start))
    settings = SimulationSettings(engine=RungeKutta())
    found = simulate(machine, x, until=6.0, settings=settings)
    task = SimulationTask(dynamics=machine, state=x, until=6.0, settings=settings)
    reference = by_reference(task)
    assert len(found.events) == len(reference.events) > 10
    for one, other in zip(found.events, reference.events, strict=True):
        assert (one.kind, one.what, one.time) == (other.kind, other.what, other.time)
        assert np.array_equal(one.after, other.after)


@pytest.mark.parametrize(
    ("at", "told"),
    [
        ("release flor", "Did you mean `release floor`?"),
        ("switch up", "impact floor, zeno floor, release floor"),
        ("release", "`release NAME`"),
        ("landing floor", "`impact NAME`"),
    ],
)
def test_an_unknown_event_is_refused(at: str, told: str) -> None:
    x, v, u = ca.SX.sym("x"), ca.SX.sym("v"), ca.SX.sym("u")
    stop = zo.Stop(name="floor", gap=x, restitution=0.5)
    mass = zo.HybridLagrangian.from_energies(
        q=x, v=v, kinetic=v**2 / 2, potential=GRAVITY * x, stops=(stop,)
    )
    with pytest.raises(ValueError, match="Argument `at`") as refusal:
        zo.hybrid_system(mass, (zo.no_drive(mass), zo.Hold(states=u, at=at, after=v)))
    assert told in str(refusal.value)


def test_wrong_held_states_are_refused() -> None:
    x, v, u = ca.SX.sym("x"), ca.SX.sym("v"), ca.SX.sym("u")
    stop = zo.Stop(name="floor", gap=x, restitution=0.5)
    mass = zo.HybridLagrangian.from_energies(
        q=x, v=v, kinetic=v**2 / 2, potential=GRAVITY * x, stops=(stop,)
    )
    with pytest.raises(ValueError, match="one is a velocity"):
        zo.hybrid_system(mass, zo.Hold(states=v, at="zeno floor", after=x))
    with pytest.raises(ValueError, match="must hold symbols"):
        zo.Hold(states=2 * u, at="zeno floor", after=x)
    with pytest.raises(ValueError, match="must have 1 entries"):
        zo.Hold(states=u, at="zeno floor", after=ca.vertcat(x, v))
    switch = zo.Switch(name="hold at zeno floor", guard=x - 1)
    with pytest.raises(ValueError, match="must not begin with `hold at`"):
        zo.hybrid_system(mass, zo.no_drive(mass), switches=(switch,))


@pytest.mark.usefixtures("both_loops")
def test_states_that_are_set_at_impacts_that_accumulate_are_named() -> None:
    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        x, v, u = ca.SX.sym("x"), ca.SX.sym("v"), ca.SX.sym("u")
        stop = zo.Stop(name="floor", gap=x, restitution=p["e"])
        mass = zo.HybridLagrangian.from_energies(
            q=x, v=v, kinetic=v**2 / 2, potential=GRAVITY * x, stops=(stop,)
        )
        hold = zo.Hold(states=u, at="impact floor", after=v)
        return zo.hybrid_system(mass, (zo.no_drive(mass), hold))

    problem = machine_of(model, {"x": "m", "v": "m/s", "u": "m/s"}, {"e": E})
    with pytest.raises(zo.SimulationError, match="`hold at impact floor` accumulate") as refusal:
        zo.simulate(problem, start={"x": 1.0}, until=5.0)
    # The sum of all flights.
    limit = math.sqrt(2 / GRAVITY) * (1 + E) / (1 - E)
    assert refusal.value.time == pytest.approx(limit, rel=1e-4)
