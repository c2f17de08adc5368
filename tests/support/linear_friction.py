"""Linear machines with dry friction as problems, and their events in the words of the reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

import zeno_orbits as zo
from tests.reference.friction_loop import LinearMachine
from tests.support.mechanisms import machine_of
from zeno_orbits.integrators import RungeKutta
from zeno_orbits.simulation import SimulationSettings, SimulationTask

PLASTIC = 1e-4
"""The other loop ends a sequence of impacts at a speed of 1e-6 m/s, so its Zeno times are early."""
_AT_ONCE, _LATE = 1e-9, 1e-6
"""Times of two events below which they are one, and of a limit from which the other loop is at rest
[s]."""
_KINDS = {"Impact": "impact", "ZenoPoint": "zeno", "Release": "release"}


def problem_of(machine: LinearMachine, *, is_bare: bool = False) -> zo.Problem:
    """Return a linear machine as a problem.

    Args:
        machine: The machine.
        is_bare: True without its stop and its friction.
    """

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        n = machine.n
        q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
        constant, inductance, resistance, voltage = map(ca.SX, machine.circuit)
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.bilin(ca.DM(machine.mass), v) / 2,
            potential=ca.bilin(ca.DM(machine.stiffness), q) / 2 - ca.dot(machine.load, q),
            passive_force=-ca.mtimes(ca.DM(machine.damping), v),
            **({} if is_bare else {"gap": ca.dot(machine.normal, q)}),
        )
        bank = zo.MotorBank(
            selection=ca.SX(machine.motor),
            resistance=resistance,
            inductance=inductance,
            torque_constant=constant,
            emf_constant=constant,
            voltage=voltage,
        )
        if is_bare:
            return zo.hybrid_system(mechanism, zo.full_drive(mechanism, bank))
        frictions = [
            zo.DryFriction(f"f{k}", rate=ca.dot(row, v) - belt, torque=torque, static=static)
            for k, (row, belt, torque, static) in enumerate(
                zip(
                    machine.rows,
                    machine.belts.tolist(),
                    machine.torques.tolist(),
                    machine.statics.tolist(),
                    strict=True,
                )
            )
        ]
        parts = (zo.full_drive(mechanism, bank), *frictions)
        return zo.hybrid_system(mechanism, parts, p["e"])

    units = {
        f"{part}{k}": unit
        for part, unit in zip("qv", ("m", "m/s"), strict=True)
        for k in range(machine.n)
    }
    units |= {"i": "A"}
    if is_bare:
        return machine_of(model, units, {})
    units |= {f"side_f{k}": "1" for k in range(len(machine.rows))}
    return machine_of(model, units, {"e": machine.restitution})


def start_of(machine: LinearMachine, seed: int) -> np.ndarray:
    """Return a random state without contact, ``(2 n,)``."""
    random = np.random.default_rng(seed)
    q = random.normal(size=machine.n)
    q = q if machine.normal @ q > 0.0 else -q
    return np.concatenate([q, random.normal(size=machine.n)])


def without_impacts(events: Sequence[tuple[float, str]]) -> list[tuple[float, str]]:
    """Return the other events, those at one time by their names."""
    others = [one for one in events if one[1] != "impact"]
    return sorted(others, key=lambda one: (round(one[0], 7), one[1]))


def task_of(machine: LinearMachine, seed: int, until: float) -> SimulationTask:
    """Return the simulation of a machine from a random start.

    Args:
        machine: The machine.
        seed: Seed of its start.
        until: Length [s].
    """
    problem = problem_of(machine)
    rest = np.zeros(1 + len(machine.rows))
    return SimulationTask(
        dynamics=problem.graph_dynamics(problem.values()),
        state=np.concatenate([start_of(machine, 1000 + seed), rest]),
        until=until,
        settings=SimulationSettings(engine=RungeKutta()),
    )


def events_of(found: zo.Execution) -> list[tuple[float, str]]:
    """Return the events of an execution but its impacts, those at one time by their names."""
    return without_impacts(
        [
            (one.time, _KINDS.get(type(one).__name__) or str(getattr(one, "name", "")))
            for one in found.events
            if one.time > 0.0
        ]
    )


def before_limits(
    found: zo.Execution, wanted: Sequence[tuple[float, str]]
) -> tuple[list[tuple[float, str]], list[tuple[float, str]]]:
    """Return the events of an execution and of the reference, without omitted ones.

    Where impacts move a part in every flight, its events accumulate with them. Either loop has
    those up to its last impact.
    """
    known, tails = events_of(found), list[tuple[float, float]]()
    for zeno in found.zeno_points:
        first = zeno.time - max(zeno.tail, _LATE) - _AT_ONCE
        if any(" " in name and first < time < zeno.time for time, name in (*known, *wanted)):
            tails.append((first, zeno.time + PLASTIC))

    def kept(events: Sequence[tuple[float, str]]) -> list[tuple[float, str]]:
        return [
            (time, name)
            for time, name in events
            if " " not in name or not any(low < time < high for low, high in tails)
        ]

    return kept(known), kept(wanted)


def events_of_reference(machine: LinearMachine, seed: int, until: float) -> list[tuple[float, str]]:
    """Return the same of the other event loop."""
    y = np.concatenate([start_of(machine, 1000 + seed), [0.0, 1.0]])
    return without_impacts(list(machine.events(y, until)))
