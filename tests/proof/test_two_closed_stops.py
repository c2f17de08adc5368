"""Proofs of orbits on which two stops are closed at the same time, and what refutes them."""

from __future__ import annotations

import copy
from collections.abc import Callable
from contextlib import suppress
from fractions import Fraction
from typing import Any

import pytest
from mpmath import mp, mpf

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.stacked import GRAVITY, pressed_pair, stacked_blocks
from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem
from zeno_orbits.proof import Proof, check_proof, prove_orbit
from zeno_orbits.proof.checker.certificate import read_machine
from zeno_orbits.proof.checker.section import ContactSection

Certificate = dict[str, Any]


@pytest.fixture(scope="module")
def pair() -> Problem:
    return pressed_pair()


@pytest.fixture(scope="module")
def proof(pair: Problem) -> Proof:
    return prove_orbit(zo.find_orbit(pair).unwrap(), pair)


def _off(interval: Any, exact: Any) -> float:
    """Return the distance of a number of many digits from an interval."""
    return interval.misses(Fraction(int(exact * 2**110), 2**110))


def _flight(shake: Any, weight: Any, start: Any, speed: Any) -> tuple[Any, Any]:
    """Return the landing phase and speed of a mass that leaves ``z = 0``, by its closed form."""

    def place(t: Any) -> Any:
        fall = speed - shake * mp.sin(start)
        return (
            shake * (mp.cos(start) - mp.cos(t)) + fall * (t - start) - weight * (t - start) ** 2 / 2
        )

    def rate(t: Any) -> Any:
        return speed - shake * (mp.sin(start) - mp.sin(t)) - weight * (t - start)

    step, t = mpf(1) / 1024, start
    if speed:
        # Past the top of a parabola whose height is that of the flight.
        step = speed / (weight - shake * mp.cos(start)) / 8
    t = start + step
    while place(t) > 0:
        t += step
    low, high = t - step, t
    for _ in range(180):
        middle = (low + high) / 2
        low, high = (middle, high) if place(middle) > 0 else (low, middle)
    return low, rate(low)


def _zeno_phase(shake: Any, weight: Any, restitution: Any) -> Any:
    """Return the phase of the Zeno point after the release at ``shake cos t = weight``."""
    t, speed = -mp.acos(weight / shake), mpf(0)
    while speed > mpf(10) ** -25 or not speed:
        t, down = _flight(shake, weight, t, speed)
        speed = -restitution * down
        if not restitution:
            break
    return t


def test_a_pair_lands_and_is_released_where_its_closed_form_says(proof: Proof) -> None:
    assert proof.proved, proof.verdict()
    assert proof.bounds is not None
    assert proof.events == ("plastic impact on table", "release of table")
    assert proof.certificate["machine"] == {"stop": 0, "sides": [], "held": 1}
    with mp.workdps(40):
        lands = (_zeno_phase(mpf(12), mpf(10), mpf(0)) + mp.acos(mpf(10) / 12)) / 20
        assert _off(proof.bounds.zeno_times[0], lands) < 1e-28
        assert _off(proof.bounds.period, 2 * mp.pi / 20) == 0
        assert _off(proof.bounds.start_state["cosine"], mpf(10) / 12) == 0


def test_the_section_names_the_other_closed_stop(pair: Problem, proof: Proof) -> None:
    # A release of the pair with a gap between the blocks does not belong to box 1.
    told = "\n".join(proof.lines())
    assert proof.as_json()["section"] == "a release of stop `table` in contact with `block`"
    assert "from a release of stop `table` in contact with `block` to the next" in told
    assert "Box 1 contains each release in contact with `block` with " in told
    data: Certificate = dict(proof.certificate)
    names = ("table", "block"), ()
    alone: Certificate = {**data, "machine": {"stop": 0, "sides": []}}
    for one, closed in ((data, ", in contact with `block`"), (alone, "")):
        machine, _, _ = read_machine(one, pair)
        given = dict(one["section"])
        if not closed:
            # One state more follows from no condition.
            given["places"] = [*given["places"], 1, 3]
        text = ContactSection.of(machine.first, given, names).text
        assert text.startswith("the release of `table`, where the gap,")
        assert text.endswith(f"acceleration vanish{closed}")


@pytest.mark.slow
def test_the_checker_confirms_both_contacts(pair: Problem, proof: Proof) -> None:
    verdict = check_proof(dict(proof.certificate), pair)
    assert verdict.ok
    assert "Events in order: plastic impact on table, release of table." in verdict.lines()


# The motion of the pair is the same: only what holds the blocks together is another.
FALSE: dict[str, tuple[dict[str, str], str]] = {
    "a magnet that pulls the blocks apart": ({"P": "-0x40p+0"}, "the multiplier may be"),
    "an upper block below the lower one": (
        {"P": "-0x40p+0", "side": "-0x1p+0"},
        "an impact may open the other stop",
    ),
    "a Delassus matrix that is not positive": (
        {"M": "0x1p-1", "m": "0x1p-1", "c": "0x3p-1"},
        "the responses of two stops may be dependent",
    ),
    "an impact that is not plastic": ({"restitution": "0x1p-1"}, ""),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", fast(1, FALSE))
def test_a_pair_that_would_open_is_not_accepted(pair: Problem, proof: Proof, name: str) -> None:
    false, (numbers, told) = copy.deepcopy(dict(proof.certificate)), FALSE[name]
    false["parameters"].update(numbers)
    try:
        verdict = check_proof(false, pair)
    except InputError:
        assert not told
        return
    assert not verdict.conclusions()
    assert told in " ".join(claim.evidence for claim in verdict.claims)


def _records(certificate: Certificate, kind: str) -> list[Any]:
    return [r for r in certificate["passes"][0]["records"] if r["kind"] == kind]


EDITS: dict[str, Callable[[Certificate], Any]] = {
    "no stop is held": lambda c: c["machine"].pop("held"),
    "the own stop is held": lambda c: c["machine"].update(held=0),
    "a stop that is missing is held": lambda c: c["machine"].update(held=2),
    "a truth value is held": lambda c: c["machine"].update(held=True),
    "the roles are exchanged": lambda c: c["machine"].update(stop=1, held=0),
    "the other stop is released": lambda c: _records(c, "cross")[-1].update(meets=["release", 1]),
    "a missing stop is released": lambda c: _records(c, "cross")[-1].update(meets=["release", -1]),
    "the held stop is struck": lambda c: _records(c, "cross")[0].update(meets=["stop", 1]),
    "the release is a strike": lambda c: _records(c, "cross")[-1].update(meets=["stop", 0]),
}


@pytest.mark.parametrize("name", fast(3, EDITS))
def test_no_edited_certificate_of_a_pair_is_accepted(
    pair: Problem, proof: Proof, name: str
) -> None:
    edited = copy.deepcopy(dict(proof.certificate))
    EDITS[name](edited)
    with suppress(InputError):
        assert not check_proof(edited, pair).conclusions()


@pytest.mark.slow
def test_each_block_comes_to_rest_while_the_other_one_is_closed() -> None:
    problem = stacked_blocks()
    found = prove_orbit(zo.find_orbit(problem).unwrap(), problem)
    assert found.proved, found.verdict()
    assert found.bounds is not None
    order = "Zeno point of block", "release of table", "Zeno point of table", "release of block"
    assert found.events == order
    upper, table = found.bounds.zeno_times
    # Heights of the last flights are 1e-50.
    with mp.workdps(70):
        # Half a turn apart, the pair of 3 kg and the block alone follow the same closed form.
        g, both = mpf(GRAVITY), (2 * mpf(21.7) - 11) / 3
        begins = mp.pi - mp.acos(g / 11)
        rest = mp.pi + _zeno_phase(mpf(11), g, mpf(0.3)) - begins
        assert _off(upper, rest / 20) == 0
        rest = 2 * mp.pi + _zeno_phase(both, g, mpf(0.2)) - begins
        assert _off(table, rest / 20) == 0
        assert float(upper.width) < 1e-14
    assert check_proof(dict(found.certificate), problem).ok
