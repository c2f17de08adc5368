"""Proofs of machines with several stops, switches and kinks, and what refutes them."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

import casadi as ca
import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.orbits import event_orbit
from zeno_orbits.errors import InputError
from zeno_orbits.model import CompletedSystem, Problem, load_problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.proof import Proof, check_proof, prove_orbit

Certificate = dict[str, Any]


def _two_stops(p: Mapping[str, Any]) -> CompletedSystem:
    """Return the impact oscillator with a second stop, a kink and a switch, none of them met."""
    place, speed = ca.SX.sym("place"), ca.SX.sym("speed")
    clock = zo.Clock.at(p["omega"])
    held = zo.HybridLagrangian.from_energies(
        q=place,
        v=speed,
        kinetic=p["m"] * speed**2 / 2,
        potential=p["k"] * (p["stop"] - place) ** 2 / 2,
        passive_force=-p["c"] * speed,
        applied_force=-p["A"] * clock.cosine + ca.fmax(place - p["level"], 0),
        clock=clock,
        stops=(
            zo.Stop(name="near", gap=place, restitution=p["restitution"]),
            zo.Stop(name="far", gap=p["far"] - place, restitution=0.5),
        ),
    )
    switch = zo.Switch(name="late", guard=p["late"] - place, armed=speed)
    return zo.hybrid_system(held, zo.no_drive(held), switches=(switch,))


@pytest.fixture(scope="module")
def machine() -> Problem:
    problem = load_problem("impact_oscillator")
    more = [zo.Quantity.positive(name, 9.0, "m", "a place") for name in ("far", "level", "late")]
    return replace(
        problem, name="two_stops", model=_two_stops, parameters=(*problem.parameters, *more)
    ).checked()


@pytest.fixture(scope="module")
def orbit(machine: Problem) -> Orbit:
    return zo.find_orbit(machine).unwrap()


@pytest.fixture(scope="module")
def proof(machine: Problem, orbit: Orbit) -> Proof:
    return prove_orbit(orbit, machine)


@pytest.fixture(scope="module")
def hopper() -> Proof:
    return zo.prove(event_orbit("hopper"))


@pytest.mark.slow
def test_stops_and_switches_that_are_not_met_change_no_digit(
    machine: Problem, proof: Proof
) -> None:
    assert proof.proved, proof.verdict()
    shape = zo.EventSequence.parsed("impact")
    alone = zo.prove(zo.find_orbit_by_shooting("impact_oscillator", shape=shape).unwrap())
    assert proof.bounds is not None
    assert alone.bounds is not None
    assert proof.events == ("impact on near",)
    for name, one in alone.bounds.start_state.items():
        other = proof.bounds.start_state[name]
        assert max(one.low, other.low) <= min(one.high, other.high)
        assert other.width < 1e-17
    assert check_proof(dict(proof.certificate), machine).ok


def _sum(text: str, move: Fraction) -> str:
    digits, power = text.split("p")
    units = int((int(digits, 16) * Fraction(2) ** int(power) + move) * 2**256)
    return f"{'-' if units < 0 else ''}0x{abs(units):x}p-256"


# In this orbit the place reaches 2.3 m: what is put there is met.
@pytest.mark.parametrize(
    ("name", "told"),
    [("far", "another gap may close"), ("level", "switch 1 may"), ("late", "switch 0 may")],
)
def test_a_certificate_is_refused_if_another_stop_or_switch_is_met(
    machine: Problem, proof: Proof, name: str, told: str
) -> None:
    moved = copy.deepcopy(dict(proof.certificate))
    moved["parameters"][name] = "0x1p-1"
    if name == "far":
        # The gap of the far stop is a state, so that it moves in every set.
        for one in moved["passes"]:
            for part in (one["start"], *(record["set"] for record in one["records"])):
                part["m"][6] = _sum(part["m"][6], Fraction(1, 2) - 9)
    verdict = check_proof(moved, machine)
    assert not verdict.ok
    assert told in " ".join(claim.evidence for claim in verdict.claims)
    assert not verdict.conclusions()


@pytest.mark.parametrize("name", fast(1, ("far", "level", "late")))
def test_an_orbit_is_not_proved_if_another_stop_or_switch_is_met(
    machine: Problem, orbit: Orbit, name: str
) -> None:
    met = replace(orbit, parameters={**orbit.parameters, name: 0.5})
    found = prove_orbit(met, machine)
    assert not found.proved


@pytest.mark.slow
def test_the_hoppers_speed_and_period_are_those_of_its_closed_form(hopper: Proof) -> None:
    assert hopper.proved, hopper.verdict()
    assert hopper.bounds is not None
    a, s, e, g = 20.0, 0.1, 0.5, 9.81
    down = math.sqrt(2 * a * s / (1 - e**2))
    assert float(hopper.bounds.start_state["speed"].low) == pytest.approx(e * down, 1e-15)
    # It pushes to the height s, where the speed is v, and then falls freely from there.
    v = math.sqrt((e * down) ** 2 + 2 * (a - g) * s)
    period = (v - e * down) / (a - g) + (v + down) / g
    assert float(hopper.bounds.period.low) == pytest.approx(period, 1e-15)
    assert check_proof(dict(hopper.certificate)).ok
    assert "Events in order: switch kink 2" in " ".join(
        check_proof(dict(hopper.certificate)).lines()
    )


def _records(certificate: Certificate, kind: str) -> list[Any]:
    return [r for one in certificate["passes"] for r in one["records"] if r["kind"] == kind]


def _flip(record: Any, k: int) -> None:
    record["sides"][k] = 1 - record["sides"][k]


def _without_switch(certificate: Certificate) -> None:
    for one in certificate["passes"]:
        at = next(k for k, r in enumerate(one["records"]) if r["kind"] == "switch")
        del one["records"][at - 1 : at + 1]


EDITS: dict[str, Callable[[Certificate], Any]] = {
    "the impact leaves a kink on its side": lambda c: _flip(_records(c, "impact")[0], 0),
    "a kink that is crossed keeps its side": lambda c: _flip(_records(c, "switch")[0], 1),
    "another kink changes its side": lambda c: _flip(_records(c, "switch")[0], 0),
    "the start is on another side": lambda c: _flip(c["machine"], 1),
    "a crossing meets the other switch": lambda c: _records(c, "cross")[0].update(
        meets=["switch", 0]
    ),
    "a crossing meets the stop": lambda c: _records(c, "cross")[0].update(meets=["stop", 0]),
    "a crossing is a release": lambda c: _records(c, "cross")[0].update(meets=["release", 0]),
    "a switch is left out": _without_switch,
    "a switch is an impact": lambda c: _records(c, "switch")[0].update(kind="impact"),
    "a kink is missing": lambda c: c["machine"].update(sides=[1]),
    "a side is no number": lambda c: c["machine"].update(sides=[True, 1]),
    "a stop that is missing": lambda c: c["machine"].update(stop=1),
    "no machine": lambda c: c.pop("machine"),
}


def _conclusions(certificate: Certificate) -> list[str]:
    try:
        return check_proof(certificate).conclusions()
    except InputError:
        return []


@pytest.mark.parametrize("name", fast(4, EDITS))
def test_no_edited_certificate_of_a_machine_is_accepted(hopper: Proof, name: str) -> None:
    edited = copy.deepcopy(dict(hopper.certificate))
    EDITS[name](edited)
    assert not _conclusions(edited)


@pytest.mark.slow
def test_the_clapper_is_released_where_the_force_is_that_of_the_spring() -> None:
    proof = zo.prove(event_orbit("clapper"))
    assert proof.proved, proof.verdict()
    assert proof.bounds is not None
    assert proof.events[0].startswith("Zeno point of")
    assert sorted(proof.events)[:2] == ["Zeno point of lower", "Zeno point of upper"]
    assert abs(float(proof.bounds.start_state["cosine"].low)) == pytest.approx(0.2, 1e-15)
    assert float(proof.bounds.period.low) == pytest.approx(2 * math.pi / 0.3, 1e-15)
    first, second = (float(one.low) for one in proof.bounds.zeno_times)
    # Both stops are alike, half a turn apart.
    assert second - first == pytest.approx(math.pi / 0.3, rel=1e-12)
    assert check_proof(dict(proof.certificate)).ok


@pytest.mark.slow
def test_the_relay_is_proved_through_its_switches() -> None:
    proof = zo.prove(event_orbit("relay"))
    assert proof.proved, proof.verdict()
    assert proof.bounds is not None
    assert proof.stable
    assert float(proof.bounds.period.low) == pytest.approx(0.04, 1e-14)
    assert sorted(proof.events)[-2:] == ["switch kink 1", "switch kink 1"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["s", "restitution"])
def test_the_hopper_is_proved_over_an_interval_that_holds_its_closed_form(name: str) -> None:
    proof = zo.prove(event_orbit("hopper"), interval={name: 1e-9})
    assert proof.proved, proof.verdict()
    assert proof.bounds is not None
    speed = proof.bounds.start_state["speed"]
    for change in (-1e-9, 1e-9):
        numbers = {"s": 0.1, "restitution": 0.5}
        numbers[name] += change
        e = numbers["restitution"]
        exact = e * math.sqrt(40.0 * numbers["s"] / (1 - e**2))
        # The ends are rounded by the closed form alone.
        assert speed.misses(exact) < 1e-15
    assert speed.width < 1e-7
    assert check_proof(dict(proof.certificate)).ok
