"""Special points of random families, counted by a stroboscopic map that the package does not use.

Each machine has a clock. Its map over a period starts in the midst of a flight, so it knows nothing
of sections, events and charts. Central differences of `simulate` give its derivative at every orbit
of a family. A special point lies between two orbits exactly if its condition changes sign there.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.one_mass import Motion, one_mass
from zeno_orbits.arrays import Vector
from zeno_orbits.continuation import (
    ContinuationSettings,
    Family,
    FamilyPoint,
    SpecialPointKind,
    family_of_orbit,
)
from zeno_orbits.model import GraphDynamics
from zeno_orbits.search import settled_event_orbit
from zeno_orbits.simulation import simulate

Kind = SpecialPointKind


def _forced(m: Motion) -> ca.SX:
    return -m.x - m.p["c"] * m.v + m.p["A"] * m.cosine


FORCES: dict[str, Callable[[Motion], ca.SX]] = {
    "spring": _forced,
    "hard spring": lambda m: _forced(m) - 0.3 * m.x**3,
    "two wells": lambda m: _forced(m) + 1.5 * m.x - 0.5 * m.x**3,
    "two tones": lambda m: _forced(m) + 0.5 * m.p["A"] * m.cosine * m.sine,
    "ball": lambda m: -1 - m.p["c"] * m.v - m.p["A"] * m.cosine,
    "second spring": lambda m: _forced(m) + 2 * ca.fmax(-m.x - 0.6, 0),
    "one-sided damper": lambda m: _forced(m) - 0.5 * ca.fmax(m.v - 0.4, 0),
    "limited drive": lambda m: _forced(m) - ca.fmax(m.p["A"] * m.cosine - 0.9, 0),
}
"""Forces without kinks, then those with kinks."""
MACHINES = [*FORCES, "two walls", "latch"]


@dataclass(frozen=True, kw_only=True)
class Machine:
    """A machine with random values.

    Attributes:
        problem: The problem.
        values: Name to value of its parameters.
    """

    problem: zo.Problem
    values: dict[str, float]

    def at(self, name: str, value: float) -> GraphDynamics:
        return self.problem.graph_dynamics(
            self.problem.values(parameters={**self.values, name: value})
        )


def _machine(name: str, dice: random.Random) -> Machine:
    values = {
        "omega": dice.uniform(0.7, 2.8),
        "A": dice.uniform(0.6, 2.5),
        "c": dice.uniform(0.03, 0.4),
        "e": dice.uniform(0.1, 0.85),
        "place": 0.0 if name == "ball" else dice.uniform(-0.5, 0.6),
    }
    side = -1 if name == "ball" else 1

    def stops(m: Motion) -> tuple[zo.Stop, ...]:
        first = zo.Stop(name="up", gap=side * (m.p["place"] - m.x), restitution=m.p["e"])
        low = zo.Stop(name="low", gap=m.x - m.p["place"] + 1.2, restitution=0.5)
        return (first, low) if name == "two walls" else (first,)

    def switches(m: Motion) -> tuple[zo.Switch, ...]:
        latch = zo.Switch(name="latch", guard=m.x + 0.4, armed=1.0, v_after=0.9 * m.v)
        return (latch,) if name == "latch" else ()

    problem = one_mass(
        FORCES.get(name, _forced),
        stops=stops,
        switches=switches,
        has_clock=True,
        start={"cosine": 1.0, "x": values["place"] - 0.3 * side},
        **values,
    )
    return Machine(problem=problem, values=values)


def _family(name: str, seed: int) -> tuple[Machine, str, Family]:
    """Return a random family of a kind of machine, of which most have special points or ends."""
    dice = random.Random(f"{name} {seed}")
    for _ in range(40):
        machine = _machine(name, dice)
        try:
            orbit = settled_event_orbit(machine.problem, machine.problem.values())
        except zo.ZenoOrbitsError:
            continue
        parameter = dice.choice(["omega", "A", "c", "e"])
        value, part = machine.values[parameter], dice.choice([0.1, 0.3, 0.6])
        box = (value * (1 - part), min(value * (1 + part), 0.95 if parameter == "e" else math.inf))
        once = ContinuationSettings(doublings=0)
        found = family_of_orbit(machine.problem, orbit, parameter, box, settings=once)
        return machine, parameter, found.families[0]
    raise AssertionError("No motion settled.")


def _slope(machine: Machine, parameter: str, point: FamilyPoint, width: float) -> Vector:
    """Return the derivative of the stroboscopic map at an orbit, ``(2, 2)``."""
    there = machine.at(parameter, point.value)
    start = np.array(machine.problem.state_vector(point.state))
    run = simulate(there, start, until=0.999999 * point.period)
    flights = [arc for arc in run.arcs if arc.trajectory is not None and not arc.closed]
    longest = max(flights, key=lambda arc: arc.end_time - arc.start_time)
    y = longest.state_at((longest.start_time + longest.end_time) / 2)
    columns: list[Vector] = []
    for k in range(2):
        shift = np.zeros(y.size)
        shift[k] = width
        ends = [
            np.array(simulate(there, y + sign * shift, until=point.period).end_state)[:2]
            for sign in (1, -1)
        ]
        columns.append((ends[0] - ends[1]) / (2 * width))
    return np.stack(columns, axis=1)


def _conditions(slope: Vector) -> dict[Kind, float]:
    """Return conditions that vanish at folds and branch points, at flips, and at pairs."""
    return {
        Kind.FOLD: float(np.linalg.det(slope - np.eye(2))),
        Kind.FLIP: float(np.linalg.det(slope + np.eye(2))),
        Kind.TORUS: 1.0 - float(np.linalg.det(slope)),
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_random_families_have_the_special_points_of_their_stroboscopic_map(name: str) -> None:
    machine, parameter, family = _family(name, 1)
    ends = {family.first.kind, family.last.kind}
    assert Kind.GAVE_UP not in ends
    seen: list[Vector | None] = []
    for point in family.points:
        try:
            one, other = (_slope(machine, parameter, point, width) for width in (1e-6, 3e-6))
        except zo.InputError:
            # A flight lower than the differences has displaced states inside of the stop.
            seen.append(None)
            continue
        # Next to a grazing impact differences say nothing.
        size = 1.0 + float(np.max(np.abs(one)))
        is_smooth = float(np.max(np.abs(one - other))) < 1e-3 * size
        seen.append(one if is_smooth else None)
        if is_smooth:
            moduli = sorted(np.abs(np.linalg.eigvals(one)), reverse=True)
            own = [*map(abs, point.multipliers), 0.0, 0.0][:2]
            assert own == pytest.approx(moduli, abs=2e-3 * size)
    assert sum(one is not None for one in seen) > len(seen) / 2
    for k, (left, right) in enumerate(pairwise(seen)):
        if left is None or right is None:
            continue
        for kind, value in _conditions(left).items():
            after = _conditions(right)[kind]
            is_pair = np.iscomplexobj(np.linalg.eigvals(left))
            if min(abs(value), abs(after)) < 1e-4 or (kind is Kind.TORUS and not is_pair):
                continue
            kinds = (kind, Kind.BRANCHING) if kind is Kind.FOLD else (kind,)
            located = [one for one in family.special if one.kind in kinds and one.index == k]
            assert (value * after < 0.0) == (len(located) % 2 == 1)
