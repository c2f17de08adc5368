"""A machine whose reset renames its coordinates: it stays in its place, and walks forward."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, partial

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.orbits import event_orbit
from zeno_orbits.report import orbit_motion
from zeno_orbits.report.motion import MachineMotion, frame_of, machine_motion

STEPS = 3


_orbit = partial(event_orbit, "kneed_walker")


@cache
def _walk(n: int = 600) -> MachineMotion:
    orbit, problem = _orbit(), zo.load_problem("kneed_walker")
    values = orbit.values(problem)
    execution = orbit_motion(orbit, problem, problem.graph_dynamics(values), periods=STEPS)
    return machine_motion(problem, values, execution, STEPS * orbit.period, n=n)


def _step() -> np.ndarray:
    """Return the vector of a step: from the stance foot to the swing foot at heel strike."""
    # Both legs are straight: the feet are at the hip minus the leg, of length 1 m.
    strike = _orbit().events[-1].state
    legs = [np.array([-np.sin(strike[name]), np.cos(strike[name])]) for name in ("q1", "q2")]
    return legs[0] - legs[1]


def test_a_walker_advances_by_a_step_down_its_slope_at_each_heel_strike() -> None:
    walk, step = _walk(), _step()
    slope = _orbit().parameters["slope"]
    assert step[1] / step[0] == pytest.approx(-np.tan(slope), abs=1e-9)
    hip = walk.lines["hip"][:, 0]
    per_step = len(walk.times) // STEPS
    for k in range(STEPS - 1):
        assert hip[(k + 1) * per_step] - hip[k * per_step] == pytest.approx(step, abs=1e-8)
    # The speed of the hip is below L |dq1| < 2 m/s, so nothing jumps.
    steps = np.linalg.norm(np.diff(hip, axis=0), axis=1)
    assert np.max(steps) < 2.0 * (walk.times[1] - walk.times[0])


def test_every_leg_keeps_its_lengths_and_stands_on_its_foot_for_every_other_step() -> None:
    walk = _walk()
    per_step = len(walk.times) // STEPS
    assert set(walk.renamed) == {"stance leg", "swing leg", "stance knee", "swing knee"}
    for name in ("stance leg", "swing leg"):
        corners = walk.lines[name]
        sides = np.linalg.norm(np.diff(corners, axis=1), axis=2)
        assert sides == pytest.approx(np.full_like(sides, 0.5), abs=1e-9)
    feet = {name: walk.lines[name][:, 0] for name in ("stance leg", "swing leg")}
    for k, name in enumerate(("stance leg", "swing leg", "stance leg")):
        standing = feet[name][k * per_step + 1 : (k + 1) * per_step]
        assert standing == pytest.approx(np.broadcast_to(k * _step(), standing.shape), abs=1e-8)
    knees = walk.lines["stance knee"][:, 0]
    assert knees == pytest.approx(walk.lines["stance leg"][:, 1], abs=1e-9)


def test_the_frame_holds_the_walk_but_not_the_ground() -> None:
    (left, right), (low, high) = frame_of(_walk(), square=False)
    feet = _walk().lines["stance leg"][:, 0]
    assert left < feet[:, 0].min()
    assert feet[:, 0].max() < right < 3.0
    assert low < feet[:, 1].min()
    assert high < 1.2


def test_a_reset_that_moves_a_machine_moves_its_drawing() -> None:
    def lifted(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        height, speed = ca.SX.sym("height"), ca.SX.sym("speed")
        ball = zo.HybridLagrangian.from_energies(
            q=height, v=speed, kinetic=speed**2 / 2, potential=p["g"] * height, gap=height
        )
        lift = zo.Switch(name="lift", guard=height - 1, armed=-speed, q_after=height + 2)
        return zo.hybrid_system(ball, zo.no_drive(ball), p["restitution"], switches=(lift,))

    def drawing(x: Mapping[str, ca.SX], _: Mapping[str, ca.SX]) -> zo.Drawing:
        return {"stop": [(-1, 0), (1, 0)], "ball": [(0, x["height"])]}

    problem = zo.Problem(
        name="lifted",
        title="ball that is lifted",
        source="here",
        state_names=("height", "speed"),
        state_units=("m", "m/s"),
        parameters=(
            zo.Quantity.positive("g", 10.0, "m/s^2", "gravity"),
            zo.Quantity.restitution(0.5),
        ),
        gains=(),
        model=lifted,
        starts=({"height": 1.45},),
        portraits=(("height", "speed"),),
        amplitude_of="height",
        drawing=drawing,
    )
    run = zo.simulate(problem, until=0.4)
    # It falls by 0.45 m in 0.3 s, and is then 3 m high.
    motion = machine_motion(problem, problem.values(), run, 0.4, n=40)
    heights = motion.lines["ball"][:, 0, 1]
    assert heights == pytest.approx([run.state_at(time)[0] for time in motion.times.tolist()])
    assert np.max(heights) > 2.9
    assert not motion.renamed


def test_the_drawings_of_machines_with_two_stops_touch_the_stop_that_is_closed() -> None:
    clapper = zo.load_problem("clapper")
    right, left = np.array([[1.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 1.0, 0.0]])
    lines = clapper.drawn_lines(clapper.values(), np.array([right, left]))
    wall = np.max(lines["stop"][0, :, 0])
    assert np.max(lines["mass"][0, :, 0]) == pytest.approx(wall, abs=1e-12)
    assert np.min(lines["mass"][1, :, 0]) == pytest.approx(-wall, abs=1e-12)
    relay = zo.load_problem("relay")
    opening = relay.values().parameters["d"]
    states = np.array([[0.0, 0, 0, 1, 0], [opening, 0, 0, 1, 0]])
    lines = relay.drawn_lines(relay.values(), states)
    assert np.min(lines["armature"][0, :, 1]) == pytest.approx(np.min(lines["stop"][0, :, 1]))
    assert np.max(lines["armature"][1, :, 1]) == pytest.approx(np.max(lines["stop"][0, :, 1]))
