"""Impacts that move a part with dry friction: derivatives, orbits, and another event loop."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference.friction_loop import LinearMachine
from tests.support.linear_friction import PLASTIC, before_limits, without_impacts
from tests.support.mechanisms import machine_of
from zeno_orbits.integrators import RungeKutta, Tolerance
from zeno_orbits.simulation import (
    EventDerivatives,
    SimulationSettings,
    SimulationTask,
    ZenoExtrapolation,
)
from zeno_orbits.simulation.compiled.executions import by_loop

OMEGA, GRAVITY, HAMMER, DAMPING, MAGNET, E = 25.0, 9.81, 0.5, 10.0, 7.0, 0.4
"""Numbers of a hammer that a magnet lifts above an anvil with dry friction."""


def rocking_model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a ball above a curved table on a spring, whose coupling depends on its place."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    pair = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=ca.sumsqr(v) / 2 + p["c"] * ca.cos(q[0]) * v[0] * v[1],
        potential=9.81 * q[1] + 3.0 * q[0] ** 2,
        gap=q[1] + 0.1 * q[0] ** 2,
    )
    table = zo.DryFriction("table", rate=v[0], torque=0.5, static=9.0)
    return zo.hybrid_system(pair, (zo.no_drive(pair), table), p["e"])


@pytest.mark.slow
@pytest.mark.parametrize(("c", "until", "last"), [(0.05, 1.2, "ZenoPoint"), (0.4, 0.5, "Impact")])
def test_derivatives_past_impacts_that_move_a_part_are_differences_of_runs(
    c: float, until: float, last: str
) -> None:
    units = {"x": "m", "y": "m", "vx": "m/s", "vy": "m/s", "side_table": "1"}
    problem = machine_of(rocking_model, units, {"c": c, "e": 0.5})
    graph = problem.graph_dynamics(problem.values())

    def end(x: np.ndarray) -> zo.Execution:
        settings = SimulationSettings(engine=RungeKutta(), completion=ZenoExtrapolation())
        task = SimulationTask(dynamics=graph, state=x, until=until, settings=settings)
        found = by_loop(task)
        assert found is not None
        return found

    start, step = np.array([0.1, 0.3, 0.0, 0.2, 0.0]), 1e-6
    found = end(start)
    assert type(found.events[-1]).__name__ == last
    derivatives = EventDerivatives(graph, (), Tolerance(relative=1e-12, absolute=1e-13))
    *_, passage = derivatives.passages(found)
    # A start along the rate of the table slips. The others stick until the first impact.
    for k in (0, 1, 3):
        moved = step * np.eye(5)[k]
        wanted = (end(start + moved).end_state - end(start - moved).end_state) / (2.0 * step)
        assert passage.after.state[:, k] == pytest.approx(wanted, abs=1e-7)


def struck_anvil(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a hammer that a magnet lifts above an anvil on a spring, which sticks or slips."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    clock = zo.Clock.at(ca.SX(OMEGA))
    pair = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=(HAMMER * v[0] ** 2 + p["M"] * v[1] ** 2) / 2,
        potential=GRAVITY * (HAMMER * q[0] + p["M"] * q[1]) + p["k"] * q[1] ** 2 / 2,
        gap=q[0] - q[1],
        passive_force=ca.vertcat(0, -DAMPING * v[1]),
        applied_force=ca.vertcat(MAGNET * clock.cosine, 0),
        clock=clock,
    )
    pad = zo.DryFriction("f0", rate=v[1], torque=p["T"], static=1.3 * p["T"])
    return zo.hybrid_system(pair, (zo.no_drive(pair), pad), p["restitution"])


def anvil_of(numbers: Mapping[str, float]) -> zo.Problem:
    units = {"x": "m", "y": "m", "vx": "m/s", "vy": "m/s", "side_f0": "1", "cosine": "1"}
    return machine_of(struck_anvil, {**units, "sine": "1"}, {**numbers, "restitution": E})


def linear_anvil(numbers: Mapping[str, float]) -> LinearMachine:
    """Return the same, whose magnet is a third coordinate that swings freely."""
    mass, spring, torque = (numbers[name] for name in ("M", "k", "T"))
    stiffness = np.diag([0.0, spring, OMEGA**2])
    stiffness[0, 2] = -MAGNET
    return LinearMachine(
        mass=np.diag([HAMMER, mass, 1.0]),
        stiffness=stiffness,
        damping=np.diag([0.0, DAMPING, 0.0]),
        load=-GRAVITY * np.array([HAMMER, mass, 0.0]),
        normal=np.array([1.0, -1.0, 0.0]),
        restitution=E,
        motor=np.zeros(3),
        circuit=(0.0, 1.0, 1.0, 0.0),
        rows=np.array([[0.0, 1.0, 0.0]]),
        belts=np.zeros(1),
        torques=np.array([torque]),
        statics=np.array([1.3 * torque]),
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("numbers", "word"),
    [({"M": 4.0, "k": 3e4, "T": 25.0}, "stick"), ({"M": 2.0, "k": 8e3, "T": 12.0}, "turn")],
)
def test_an_anvil_that_the_impacts_move_follows_another_event_loop(
    numbers: Mapping[str, float], word: str
) -> None:
    until = 0.6
    found = zo.simulate(anvil_of(numbers), start={"x": 0.01, "cosine": 1.0}, until=until)
    start = np.array([0.01, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    wanted = without_impacts(list(linear_anvil(numbers).events(start, until)))
    events, wanted = before_limits(found, wanted)
    assert [name for _, name in events] == [name for _, name in wanted]
    assert [time for time, _ in events] == pytest.approx([t for t, _ in wanted], abs=PLASTIC)
    assert len(found.zeno_points) == 2
    assert sum(name.startswith(word) for _, name in events) > 6


@pytest.mark.slow
def test_an_orbit_whose_impacts_turn_a_part_forgets_as_its_multiplier_says() -> None:
    problem = anvil_of({"M": 2.0, "k": 8e3, "T": 12.0})
    orbit = zo.find_orbit_by_shooting(problem, start={"x": 0.01, "cosine": 1.0}).unwrap()
    assert orbit.period == pytest.approx(2.0 * np.pi / OMEGA, rel=1e-13)
    assert zo.verify(orbit, problem=problem).passed
    largest, *others = zo.floquet_multipliers(orbit, problem=problem).values
    assert others == [0.0, 0.0]
    start = dict(orbit.start_state) | {"vx": orbit.start_state["vx"] + 1e-5}
    motion = zo.simulate(problem, start=start, until=5.0 * orbit.period)
    late = np.diff([one.time for one in motion.zeno_points]) - orbit.period
    assert late[2] / late[1] == pytest.approx(largest.real, rel=1e-2)
