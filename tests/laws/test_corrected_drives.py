"""A corrected drive serves machines with several stops and kinks, to second order in L / R."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.mechanisms import machine_of
from zeno_orbits.simulation import Impact, event_name

Symbols = Mapping[str, ca.SX]
DRIVES = {
    "full": zo.full_drive,
    "quasi-static": zo.quasi_static_drive,
    "corrected": zo.corrected_drive,
}
R, K, KP, KD = 2.0, 0.8, -2.0, 1.5
Q, V = 0.1, -2.0
INDUCTANCES = (4e-3, 2e-3, 1e-3)


def _bank(p: Symbols, q: ca.SX, v: ca.SX, selection: ca.SX) -> zo.MotorBank:
    return zo.MotorBank(
        selection=selection,
        resistance=ca.SX(R),
        inductance=p["L"],
        torque_constant=ca.SX(K),
        emf_constant=ca.SX(K),
        voltage=KP * ca.mtimes(selection.T, q) + KD * ca.mtimes(selection.T, v),
    )


def _cart(p: Symbols, kind: str) -> zo.CompletedSystem:
    """Return a cart on a spring between two walls, with friction of two slopes, a kink."""
    q, v = ca.SX.sym("q", 1), ca.SX.sym("v", 1)
    cart = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=1.3 * v**2 / 2,
        potential=5.0 * q**2 / 2,
        passive_force=-0.4 * ca.fmax(v, 0) - 0.1 * ca.fmin(v, 0),
        stops=(
            zo.Stop(name="left", gap=q + 0.3, restitution=0.6),
            zo.Stop(name="right", gap=0.2 - q, restitution=0.8),
        ),
    )
    return zo.hybrid_system(cart, DRIVES[kind](cart, _bank(p, q, v, ca.SX(1))))


def _masses(p: Symbols, kind: str) -> zo.CompletedSystem:
    """Return two masses, a motor between them; the first is pressed on a stop and stays there."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    masses = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=(1.3 * v[0] ** 2 + 0.9 * v[1] ** 2) / 2,
        potential=60.0 * q[0] + 5.0 * (q[1] - q[0]) ** 2 / 2,
        stops=(
            zo.Stop(name="floor", gap=q[0], restitution=0.2),
            zo.Stop(name="wall", gap=q[1] + 0.3, restitution=0.7),
        ),
    )
    return zo.hybrid_system(masses, DRIVES[kind](masses, _bank(p, q, v, ca.SX([-1, 1]))))


MACHINES: dict[str, tuple[Callable[[Symbols, str], zo.CompletedSystem], int, int]] = {
    "two walls and a kink": (_cart, 1, 4),
    "a closed stop": (_masses, 2, 3),
}
"""The model, its coordinates, and the impact that is compared."""


def _problem(machine: str, kind: str, inductance: float) -> zo.Problem:
    model, n, _ = MACHINES[machine]
    states = {f"q{k}": "m" for k in range(n)} | {f"v{k}": "m/s" for k in range(n)}
    states |= {"i": "A"} if kind == "full" else {}
    return machine_of(lambda p: model(p, kind), states, {"L": inductance})


def _start(machine: str) -> dict[str, float]:
    last = MACHINES[machine][1] - 1
    return {f"q{last}": Q, f"v{last}": V}


def _impact(machine: str, kind: str, inductance: float) -> tuple[str, float]:
    """Return the name and the time of the impact that is compared, from the slow manifold."""
    model, n, number = MACHINES[machine]
    start = _start(machine)
    if kind == "full":
        system, at = model({"L": ca.SX(inductance)}, "full"), np.zeros(2 * n + 1)
        at[[n - 1, 2 * n - 1]] = Q, V
        at[-1] = (KP * Q + (KD - K) * V) / R
        flow = ca.Function("flow", [system.state], [system.free_flow])
        acceleration = float(np.array(flow(at)).ravel()[2 * n - 1])
        # To first order in L, where the slow motion is.
        start["i"] = at[-1] - inductance / R * (KP * V + (KD - K) * acceleration) / R
    problem = _problem(machine, kind, inductance)
    run = zo.simulate(problem, until=6.0, start=start)
    struck = [event for event in run.events if isinstance(event, Impact)]
    return event_name(struck[number - 1]), struck[number - 1].time


@pytest.mark.slow
@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize(("kind", "order"), [("quasi-static", 1), ("corrected", 2)])
def test_impacts_of_several_stops_show_the_order_of_the_drive(
    machine: str, kind: str, order: int
) -> None:
    errors: list[float] = []
    for inductance in INDUCTANCES:
        (name, time), (same, exact) = (_impact(machine, one, inductance) for one in (kind, "full"))
        assert name == same
        errors.append(abs(time - exact))
    slopes = [math.log2(one / two) for one, two in pairwise(errors)]
    assert slopes == pytest.approx([order] * 2, abs=0.1)


def _period(machine: str, kind: str, inductance: float) -> float:
    """Return the period of the orbit near the start, which must be verified."""
    problem = replace(_problem(machine, kind, inductance), starts=(_start(machine),))
    orbit = zo.find_orbit(problem).unwrap()
    assert orbit.certificate["passed"]
    return orbit.period


@pytest.mark.slow
@pytest.mark.parametrize("machine", MACHINES)
def test_periods_of_verified_orbits_show_the_second_order(machine: str) -> None:
    errors = [
        abs(_period(machine, "corrected", inductance) - _period(machine, "full", inductance))
        for inductance in INDUCTANCES
    ]
    slopes = [math.log2(one / two) for one, two in pairwise(errors)]
    assert slopes == pytest.approx([2] * 2, abs=0.1)


def test_a_stop_that_a_closed_stop_holds_keeps_its_restitution() -> None:
    problem = _problem("two walls and a kink", "corrected", 1e-3)
    graph = problem.graph_dynamics(problem.values())
    closed = graph.view(((0,), graph.open_mode[1]), 1)
    # The cart at the left wall cannot strike the right one, and there is no ratio of inertias.
    assert closed.restitution == pytest.approx(0.8, abs=1e-15)
    assert graph.open_views[1].restitution != pytest.approx(0.8, abs=1e-6)


def test_a_restitution_that_the_current_layer_raises_above_one_is_refused_with_its_value() -> None:
    def model(p: Symbols) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 1), ca.SX.sym("v", 1)
        ball = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=9.81 * q,
            stops=(zo.Stop(name="floor", gap=q, restitution=1.0),),
        )
        motor = replace(_bank(p, q, v, ca.SX(1)), voltage=-0.2 * v)
        return zo.hybrid_system(ball, zo.corrected_drive(ball, motor))

    problem = machine_of(model, {"q": "m", "v": "m/s"}, {"L": 1e-3})
    with pytest.raises(zo.InputError, match=r"is 1\.000\d+ \(a corrected drive adds its current"):
        zo.simulate(problem, until=1.0, start={"q": 1.0})


def test_a_correction_that_varies_on_the_stop_is_refused_with_every_stop() -> None:
    def model(p: Symbols) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        arm = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=(ca.sumsqr(v) + ca.cos(q[0]) * v[0] * v[1]) / 2,
            potential=ca.SX(0),
            stops=(
                zo.Stop(name="base", gap=q[0] + 1, restitution=0.5),
                zo.Stop(name="tip", gap=q[1] + 1, restitution=0.5),
            ),
        )
        drive = zo.corrected_drive(arm, _bank(p, q, v, ca.SX([0, 1])))
        return zo.hybrid_system(arm, drive)

    problem = machine_of(model, {"q0": "m", "q1": "m", "v0": "m/s", "v1": "m/s"}, {"L": 1e-3})
    with pytest.raises(ValueError, match="must leave the restitution constant on the stop"):
        zo.simulate(problem, until=1.0)
