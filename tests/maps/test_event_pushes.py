"""Pushes of machines with several stops and switches: the law, and brute-force simulations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference.event_loop import Accuracy, Contact, Machine, complementary, simulated
from tests.reference.kneed_walker import motors, walker
from tests.support.cases import fast
from tests.support.orbits import event_orbit
from zeno_orbits.cli import main
from zeno_orbits.maps import pushed, read_pushes

BISTABLE = {"omega": 2.09, "c": 0.2, "A": 1.47, "restitution": 0.64}
"""A clapper that either strikes both stops, or stays between them."""
TURN = 2 * math.pi / BISTABLE["omega"]


@cache
def _clapper() -> zo.Orbit:
    return zo.find_orbit(
        "clapper", parameters=BISTABLE, start={"speed": 4.0, "cosine": 1.0}
    ).unwrap()


@cache
def _pushes() -> zo.Pushes:
    settings = zo.PushSettings(phases=4, steps=48, reach=2.0, error=1e-4)
    return zo.largest_push(_clapper(), settings=settings)


def _state_at(orbit: zo.Orbit, phase: float) -> dict[str, float]:
    run = zo.simulate(
        orbit.problem,
        until=orbit.period,
        start=orbit.start_state,
        parameters=orbit.parameters,
        gains=orbit.gains,
    )
    state = run.state_at(phase * orbit.period).tolist()
    return dict(zip(run.state_names, state, strict=True))


def _strikes_after(phase: float, impulse: float) -> bool:
    """Return whether a clapper of 1 kg strikes its stops, long after an impulse."""
    start = _state_at(_clapper(), phase)
    start["speed"] += impulse
    run = zo.simulate("clapper", until=80 * TURN, parameters=BISTABLE, start=start)
    return any(event.time > 79 * TURN for event in run.events)


@pytest.mark.slow
def test_impulses_below_the_largest_return_and_those_just_above_are_lost() -> None:
    rng, found = np.random.default_rng(3), _pushes()
    assert len(found.pushes) == 8
    lost = [push for push in found.pushes if math.isfinite(push.largest)]
    assert lost
    for push in found.pushes:
        sense = push.direction["place"]
        end = push.searched if math.isnan(push.largest) else push.largest
        for part in rng.uniform(0.0, 0.99, size=12):
            assert _strikes_after(push.phase, sense * part * end)
    for push in lost:
        assert push.beyond == "another periodic orbit without a Zeno point"
        sense = push.direction["place"]
        assert not _strikes_after(push.phase, sense * (push.largest + 1.01 * push.error))
        assert push.error <= 1e-4 * push.largest * (1 + 1e-3)
    assert found.least is not None
    assert found.least.largest == min(push.largest for push in lost)


def test_an_orbit_that_starts_at_another_event_has_the_same_pushes() -> None:
    settings = zo.PushSettings(phases=1, steps=1, reach=1e-3)
    for section in ("impact upper", "impact lower"):
        orbit = zo.find_orbit(
            "clapper",
            parameters=BISTABLE,
            start={"speed": 4.0, "cosine": 1.0},
            section=section,
        ).unwrap()
        found = zo.largest_push(orbit, settings=settings)
        assert found.least is None
        assert found.spectral_radius == pytest.approx(0.30324777, abs=1e-7)


@pytest.mark.slow
def test_a_push_on_a_closed_knee_follows_the_law_of_contact() -> None:
    orbit = event_orbit("powered_walker")
    problem = zo.load_problem("powered_walker")
    graph = problem.graph_dynamics(orbit.values(problem))
    # Just before heel strike the knee is on its stop: the gap is q2 - q3.
    state = np.array(problem.state_vector(orbit.events[-1].state))
    inverse = np.linalg.inv(walker(0.2, slope=0.0).mass(state[:3]))
    normal = np.array([0.0, 1.0, -1.0])
    opened = set[bool]()
    for force in np.array([(1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0.3, 0, -1)], dtype=float):
        change = inverse @ force * 0.05
        after = pushed(graph, state, change, (0,))[3:6]
        free = state[3:6] + change
        (impulse,) = complementary(
            np.array([[normal @ inverse @ normal]]), np.array([normal @ free])
        )
        assert after == pytest.approx(free + inverse @ normal * impulse, abs=1e-12)
        assert normal @ after >= -1e-12
        opened.add(bool(normal @ after > 1e-6))
    assert opened == {True, False}


@pytest.mark.weekly
@pytest.mark.slow
def test_an_independent_event_loop_walks_on_or_falls_beside_the_largest_push() -> None:
    orbit = event_orbit("powered_walker")
    settings = zo.PushSettings(phases=1, steps=6, error=1e-2)
    found = zo.largest_push(orbit, directions=[{"q1": 1.0}], settings=settings)
    machine = walker(0.2, slope=0.0, drive=motors)
    names = zo.load_problem("powered_walker").state_names
    start = np.array([orbit.start_state[name] for name in names])
    response, normal = np.linalg.inv(machine.mass(start[:3])), np.array([0.0, 1.0, -1.0])
    for push in found.pushes:
        assert push.beyond == "it falls"
        force = np.array([push.direction["q1"], 0.0, 0.0])
        for impulse in (push.largest - push.error, push.largest + 2 * push.error):
            v = start[3:] + response @ force * impulse
            blocked = min(normal @ v, 0.0) / (normal @ response @ normal)
            begin = (*start[:3], *(v - response @ normal * blocked), 0.0)
            run = simulated(
                machine,
                begin,
                15 * orbit.period,
                closed=("knee",),
                accuracy=Accuracy(tolerance=1e-9),
            )
            falls = abs(run.end_state[0]) > 1.2
            assert falls == (impulse > push.largest)


def test_a_push_into_a_corner_is_carried_by_both_stops() -> None:
    def corner(p: Any) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        mass = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=(v[0] ** 2 + v[1] ** 2 + p["c"] * v[0] * v[1]) / 2,
            potential=q[0] + q[1],
            stops=(
                zo.Stop(name="floor", gap=q[1], restitution=0.5),
                zo.Stop(name="wall", gap=q[0], restitution=0.5),
            ),
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    problem = zo.Problem(
        name="corner",
        title="mass in a corner",
        source="here",
        state_names=("x", "y", "dx", "dy"),
        state_units=("m", "m", "m/s", "m/s"),
        parameters=(zo.Quantity.positive("c", 1.2, "1", "coupling"),),
        gains=(),
        model=corner,
        starts=({},),
        portraits=(("x", "dx"),),
        amplitude_of="x",
    ).checked()
    graph = problem.graph_dynamics(problem.values())
    inverse = np.linalg.inv(np.array([[1.0, 0.6], [0.6, 1.0]]))
    gaps = np.array([[0.0, 1.0], [1.0, 0.0]])
    delassus = gaps @ inverse @ gaps.T
    rng, kept = np.random.default_rng(2), set[int]()
    for force in rng.normal(size=(40, 2)):
        free = inverse @ force
        impulses = complementary(delassus, gaps @ free)
        after = pushed(graph, np.zeros(4), free, (0, 1))
        assert after[2:] == pytest.approx(free + inverse @ gaps.T @ impulses, abs=1e-12)
        kept.add(int(np.sum(impulses > 0.0)))
    assert kept == {0, 1, 2}


def test_an_orbit_that_its_motion_leaves_is_refused() -> None:
    orbit = event_orbit("hopper")
    settings = zo.PushSettings(phases=1, steps=1)
    with pytest.raises(zo.InputError, match="must be stable"):
        zo.largest_push(replace(orbit, period=1.1 * orbit.period), settings=settings)
    faster = {**orbit.start_state, "speed": 1.2 * orbit.start_state["speed"]}
    with pytest.raises(zo.InputError, match="ends on another orbit"):
        zo.largest_push(replace(orbit, start_state=faster), settings=settings)


@pytest.mark.slow
def test_the_command_pushes_an_orbit_of_events(tmp_path: Path) -> None:
    orbit, file = tmp_path / "orbit.json", tmp_path / "pushes.json"
    zo.write_orbit(event_orbit("hopper"), orbit)
    words = ["--phases", "2", "--steps", "2", "-o", str(file)]
    # Every hopper returns, v^2 maps to e^2 v^2 + 2 a s, but for the one that an impulse m e v just
    # after the impact stops on the ground. The late returns beside it lead to this impulse.
    assert main(["push", str(orbit), *words]) == 0
    found = read_pushes(file)
    assert len(found.pushes) == 4
    assert found.least is not None
    assert found.least.beyond == "rest"
    launch = math.sqrt(2 * 20.0 * 0.1 / (1 - 0.5**2)) * 0.5
    assert found.least.largest == pytest.approx(launch, rel=2e-3)
    assert sum(math.isfinite(one.largest) for one in found.pushes) == 1


# Orbits of events of machines that declare one stop.


@pytest.mark.parametrize("name", fast(1, ["vibrating_table", "torque_pendulum", "motor_cart"]))
def test_an_orbit_is_pushed_from_its_zeno_point_as_well(name: str) -> None:
    orbit = zo.find_orbit(name, section="zeno stop").unwrap()
    found = zo.largest_push(orbit, settings=zo.PushSettings(phases=1, steps=1, reach=0.1))
    radius = zo.verify(zo.find_orbit(name).unwrap()).spectral_radius
    assert found.spectral_radius == pytest.approx(radius, abs=1e-6)


def _oscillator(place: float, speed: float, angle: float, turns: int) -> list[float]:
    """Return the times of the impacts of the oscillator, from an own event loop [turns]."""
    values = RESONANT
    stop = Contact(
        name="stop",
        gap=lambda q: float(q[0]),
        normal=lambda _: np.array([1.0]),
        restitution=0.8,
    )
    turn = 2 * math.pi / values["omega"]

    def force(t: float, q: np.ndarray, v: np.ndarray, *_: object) -> np.ndarray:
        return values["stop"] - q - 0.1 * v - math.cos(values["omega"] * t + angle)

    machine = Machine(n=1, mass=lambda _: np.eye(1), force=force, contacts=(stop,))
    run = simulated(machine, (place, speed), turns * turn, accuracy=Accuracy(tolerance=1e-8))
    assert run.refused is None
    return [event.time / turn for event in run.events]


RESONANT = {"omega": 1.2, "stop": 1.7 / math.hypot(1 - 1.2**2, 0.12)}
"""An oscillator that either strikes its stop, or stays below it."""


@pytest.mark.weekly
@pytest.mark.slow
def test_the_largest_push_of_an_orbit_of_events_with_one_stop_separates_the_motions() -> None:
    orbit = zo.find_orbit(
        "impact_oscillator", parameters=RESONANT, start={"cosine": 1.0, "speed": 5.0}
    ).unwrap()
    settings = zo.PushSettings(phases=6, steps=24, reach=2.0, error=1e-3)
    found = zo.largest_push(orbit, settings=settings)
    lost = [push for push in found.pushes if math.isfinite(push.largest)]
    assert len(lost) >= 2
    for push in sorted(lost, key=lambda one: one.largest)[:2]:
        state = _state_at(orbit, push.phase)
        angle = math.atan2(state["sine"], state["cosine"])
        for impulse in (0.99 * push.largest, push.largest + 3 * push.error):
            speed = state["speed"] + push.direction["distance"] * impulse
            strikes = _oscillator(state["distance"], speed, angle, 30)
            assert (max(strikes, default=0.0) > 29) == (impulse < push.largest)


def _valley(mirrored: bool) -> zo.Problem:
    """Return a mass in two valleys between two stops, which starts in one of the valleys."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        clock = zo.Clock.at(p["omega"])
        mass = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=(q**2 - 1) ** 2,
            passive_force=-0.3 * v,
            applied_force=0.5 * clock.cosine,
            clock=clock,
            stops=(
                zo.Stop(name="right", gap=1.1 - q, restitution=0.5),
                zo.Stop(name="left", gap=1.1 + q, restitution=0.5),
            ),
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    side = -1.0 if mirrored else 1.0
    return zo.Problem(
        name="valley",
        title="mass in two valleys",
        source="tests",
        state_names=("q", "v", "cosine", "sine"),
        state_units=("m", "m/s", "1", "1"),
        parameters=(zo.Quantity.positive("omega", 2.0, "rad/s", "frequency"),),
        gains=(),
        model=model,
        starts=({"q": side, "cosine": side},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )


@pytest.mark.slow
def test_mirror_images_of_an_orbit_have_the_same_pushes() -> None:
    settings = zo.PushSettings(phases=2, steps=6, reach=1.0, error=1e-3)
    found: list[list[float]] = []
    for mirrored in (False, True):
        problem = _valley(mirrored)
        orbit = zo.find_orbit(problem).unwrap()
        assert {name.partition(" ")[2] for name in orbit.sequence} == {
            "left" if mirrored else "right"
        }
        pushes = zo.largest_push(orbit, problem=problem, settings=settings).pushes
        found.append([push.largest for push in (pushes[::-1] if mirrored else pushes)])
    # A mirrored push has the other sense. Both senses of a phase follow each other.
    first = np.array(found[0]).reshape(-1, 2)
    second = np.array(found[1]).reshape(-1, 2)[::-1]
    assert second == pytest.approx(first, rel=2e-3, nan_ok=True)
