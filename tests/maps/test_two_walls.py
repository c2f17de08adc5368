"""Attractors of random machines with two stops and a clock, against exact flights."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import casadi as ca
import pytest

import zeno_orbits as zo
from tests.reference.two_walls import TwoWalls, settled
from zeno_orbits.maps import Attractor, AttractorClass, attractors_at
from zeno_orbits.simulation import AttractorKind

START = {"place": 0.05, "speed": 1.0, "cosine": 1.0}


def problem_of(machine: TwoWalls) -> zo.Problem:
    """Return a machine as a problem."""

    def model(_: object) -> zo.CompletedSystem:
        place, speed = ca.SX.sym("place"), ca.SX.sym("speed")
        clock = zo.Clock.at(ca.SX(machine.omega))
        upper, lower = machine.walls
        first, second = (
            e - fall * zo.impact_speed
            for e, fall in zip(machine.restitutions, machine.falls, strict=True)
        )
        mass = zo.HybridLagrangian.from_energies(
            q=place,
            v=speed,
            kinetic=speed**2 / 2,
            potential=place**2 / 2,
            passive_force=-machine.c * speed,
            applied_force=machine.force * clock.cosine,
            clock=clock,
            stops=(
                zo.Stop(name="upper", gap=upper - place, restitution=first),
                zo.Stop(name="lower", gap=lower + place, restitution=second),
            ),
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    return zo.Problem(
        name="two_walls",
        title="mass between two walls",
        source="tests",
        state_names=("place", "speed", "cosine", "sine"),
        state_units=("m", "m/s", "1", "1"),
        parameters=(),
        gains=(),
        model=model,
        starts=(START,),
        portraits=(("place", "speed"),),
        amplitude_of="place",
    )


def machine_of(drawn: random.Random) -> TwoWalls:
    """Return a random machine."""
    return TwoWalls(
        c=drawn.uniform(0.02, 0.5),
        force=drawn.uniform(0.5, 3.0),
        omega=drawn.uniform(0.4, 3.0),
        walls=(drawn.uniform(0.1, 1.0), drawn.uniform(0.1, 1.0)),
        restitutions=(drawn.uniform(0.1, 0.8), drawn.uniform(0.1, 0.8)),
    )


def found_at(machine: TwoWalls) -> Attractor:
    """Return the attractor that a map names."""
    problem = problem_of(machine)
    (found,) = attractors_at(problem, [problem.values()])
    return found


def agrees(machine: TwoWalls, found: Attractor, turns: int = 400) -> bool | None:
    """Return whether a map names what exact flights do; None where it gives a reason instead."""
    truth = settled(machine, START["place"], START["speed"], turns)
    if truth.turns == 0:
        if found.kind is AttractorKind.CHAOTIC:
            return True
        return None if found.fate is AttractorClass.UNSETTLED else False
    if found.fate is AttractorClass.UNSETTLED:
        return None
    fate = AttractorClass.ZENO if truth.holds else AttractorClass.NO_ZENO
    same = (found.fate, found.turns) == (fate, truth.turns)
    return same and bool(found.sequence) == truth.strikes


@pytest.mark.slow
def test_random_machines_with_two_stops_have_the_periods_of_exact_flights() -> None:
    drawn = random.Random(11)
    machines = [machine_of(drawn) for _ in range(3)]
    assert [agrees(one, found_at(one), 200) for one in machines] == [True] * 3


def law_machine_of(drawn: random.Random) -> TwoWalls:
    """Return a random machine whose restitutions fall with the speed, to no less than zero."""
    one = machine_of(drawn)
    return replace(one, falls=(drawn.uniform(0.0, 0.02), drawn.uniform(0.0, 0.02)))


@pytest.mark.slow
def test_random_machines_whose_stops_have_laws_of_their_own_have_their_periods() -> None:
    drawn = random.Random(5)
    machines = [law_machine_of(drawn) for _ in range(2)]
    assert [agrees(one, found_at(one), 200) for one in machines] == [True] * 2


@pytest.mark.slow
def test_ten_random_machines_with_laws_have_the_attractors_of_exact_flights() -> None:
    drawn = random.Random(6)
    machines = [law_machine_of(drawn) for _ in range(10)]
    # One of them loses a period doubling after 400 turns only.
    answers = [agrees(one, found_at(one), 1000) for one in machines]
    assert False not in answers
    assert answers.count(None) <= 1


@pytest.mark.weekly
@pytest.mark.slow
def test_sixty_random_machines_with_two_stops_have_the_attractors_of_exact_flights() -> None:
    drawn = random.Random(2)
    machines = [machine_of(drawn) for _ in range(60)]
    answers = [agrees(one, found_at(one)) for one in machines]
    assert False not in answers
    assert answers.count(None) <= 1


def test_the_exact_flights_of_a_symmetric_orbit_repeat_its_closed_form() -> None:
    # Without walls in reach the forced motion remains, of period one turn.
    wide = TwoWalls(c=0.4, force=1.0, omega=2.0, walls=(9.0, 9.0), restitutions=(0.5, 0.5))
    truth = settled(wide, 0.05, 1.0, 200)
    assert (truth.turns, truth.strikes, truth.holds) == (1, False, False)
    # A strong slow force presses the mass on both walls in turn.
    slow = TwoWalls(c=0.1, force=5.0, omega=0.3, walls=(1.0, 1.0), restitutions=(0.3, 0.3))
    truth = settled(slow, 0.05, 1.0, 200)
    assert (truth.turns, truth.strikes, truth.holds) == (1, True, True)
    x, v = slow.flown(0.3, 0.2, -0.4, 0.7)
    assert slow.flown(1.0, x, v, -0.7) == pytest.approx((0.2, -0.4), abs=1e-13)
    h = 1e-4
    before, here, after = (slow.flown(0.3, 0.2, -0.4, 0.7 + k * h)[0] for k in (-1, 0, 1))
    bend, rate = (after - 2 * here + before) / h**2, (after - before) / (2 * h)
    applied = slow.force * math.cos(slow.omega)
    assert bend + slow.c * rate + here == pytest.approx(applied, abs=1e-6)
