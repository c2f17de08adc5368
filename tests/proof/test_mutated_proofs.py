"""No small change of a proof of some hundred inclusions is accepted that makes a claim false."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

import zeno_orbits as zo
from tests.support.certificates import BITS, mutants
from zeno_orbits.errors import InputError
from zeno_orbits.model import load_problem
from zeno_orbits.proof import check_proof
from zeno_orbits.proof.checker import certificate as judged

pytestmark = pytest.mark.slow

Certificate = dict[str, Any]
STATEMENT = ("format", "kind", "problem", "digest", "over", "gap_row", "section")
ROOM = 1e-12
"""Relative change of a parameter that the inclusions may leave room for."""


@pytest.fixture(
    scope="module",
    params=["curved_surface", pytest.param("torque_pendulum", marks=pytest.mark.weekly)],
)
def certificate(request: pytest.FixtureRequest) -> Certificate:
    """Return a proof of two passes and two coordinates, of a machine that is shaken once a turn."""
    proof = zo.prove(zo.find_orbit_by_shooting(request.param).unwrap())
    return json.loads(json.dumps(proof.certificate))


@pytest.fixture(autouse=True)
def remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Prove no record twice, and none after one that fails: a change concerns two of them."""
    prove, known = judged._proved, dict[str, list[Any]]()

    def proved(machine: Any, box: Any, tasks: Sequence[Any]) -> list[Any]:
        system = machine.first
        numbers = repr((system.constants, system.unit, system.stop, len(system.z), box))
        before = known.get(numbers, [])
        if not before:
            found = prove(machine, box, tasks)
            known[numbers] = list(zip(tasks, found, strict=True))
            return found
        found: list[Any] = []
        for k, task in enumerate(tasks):
            # One record more or less moves those behind it by one.
            near = before[max(0, k - 1) : k + 2]
            same = [result for one, result in near if one == task]
            found.append(same[0] if same else prove(machine, box, [task])[0])
            if isinstance(found[-1], str):
                break
        known.setdefault(numbers, list(zip(tasks, found, strict=False)))
        return [*found, *["not asked"] * (len(tasks) - len(found))]

    monkeypatch.setattr(judged, "_proved", proved)
    monkeypatch.setattr(judged, "_CHUNK", 10**6)


@pytest.mark.parametrize("count", [40, pytest.param(100, marks=pytest.mark.weekly)])
def test_no_mutation_is_accepted_with_a_claim_that_is_false(
    certificate: Certificate, count: int
) -> None:
    assert check_proof(certificate).ok
    accepted = 0
    for mutant in mutants(certificate, count, 3):
        if _accepted(mutant) and mutant != certificate:
            accepted += 1
            assert {k: mutant[k] for k in STATEMENT} == {k: certificate[k] for k in STATEMENT}
            _require_the_same_machine(mutant["parameters"], certificate["parameters"])
            _require_true(mutant, certificate)
    # Last digits of a set may change within its slack; most changes are refused.
    assert accepted < 50


def _require_the_same_machine(mutant: Mapping[str, str], original: Mapping[str, str]) -> None:
    """Allow the last digits of a number: what is proved then is the orbit of that machine."""
    assert mutant.keys() == original.keys()
    for name, text in original.items():
        assert _value(mutant[name]) == pytest.approx(_value(text), rel=ROOM, abs=0.0)


def _accepted(mutant: Certificate) -> bool:
    try:
        return check_proof(mutant).ok
    except InputError:
        return False


def _require_true(mutant: Certificate, original: Certificate) -> None:
    names = [claim["name"] for claim in mutant["claims"]]
    known = [claim["name"] for claim in original["claims"]]
    assert set(names) <= set(known)
    for claim in mutant["claims"]:
        same = [
            one
            for one in original["claims"]
            if (one["name"], one.get("which")) == (claim["name"], claim.get("which"))
        ]
        if "low" in claim:
            assert any(_holds(claim, one) for one in same)
        if claim["name"] == "period":
            # The period is that of the shaking.
            turn = 2 * math.pi / _value(mutant["parameters"]["omega"])
            assert _value(claim["low"]) - 1e-15 <= turn <= _value(claim["high"]) + 1e-15
        for disc, one in zip(claim.get("discs", ()), same[0].get("discs", ()), strict=True):
            (x, y, r), (a, b, _) = map(_value, disc), map(_value, one)
            assert math.hypot(x - a, y - b) <= r


def _holds(claim: Mapping[str, Any], original: Mapping[str, Any]) -> bool:
    """Return True if intervals hold the middles of others."""
    ends = [_listed(one[end]) for one in (claim, original) for end in ("low", "high")]
    return all(2 * a <= c + d <= 2 * b for a, b, c, d in zip(*ends, strict=True))


def _listed(ends: Any) -> list[float]:
    return [_value(text) for text in ([ends] if isinstance(ends, str) else ends)]


def _value(text: str) -> float:
    mantissa, exponent = text.replace("0x", "").split("p")
    return int(mantissa, 16) * 2.0 ** int(exponent)


def _tail(c: Certificate) -> Any:
    return next(record for record in c["passes"][0]["records"] if record["kind"] == "tail")


def test_a_tail_hardly_slower_than_its_bound_is_refused(
    zeno: Certificate, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The tail is the same task but for its speed, so no result may be remembered.
    monkeypatch.undo()
    # Cauchy's bound by the speed divides by the room between the bound and the speed: one unit,
    # 2^-BITS, far below the rounding of a double. The honest room accepts the same sets.
    false = copy.deepcopy(zeno)
    records = false["passes"][0]["records"]
    before = records[records.index(_tail(false)) - 1]["set"]
    machine, over, _ = judged.read_machine(false, load_problem("forced_oscillator"))
    system = machine.first
    section = judged.ContactSection.of(system, false["section"])
    box = judged.Box.of(system, section, false["passes"][0]["box"], over)
    speed = system.gap_rate(judged._set(system, box, before).hull)
    assert speed.r > 0
    _tail(false)["speed"] = f"0x{2 * speed.high:x}p-{BITS}"
    assert check_proof(false).ok
    _tail(false)["speed"] = f"0x{speed.high + 1:x}p-{BITS}"
    assert "(tail): r[" in check_proof(false).claims[0].evidence
    _tail(false)["speed"] = f"0x{speed.high:x}p-{BITS}"
    assert "(tail): the speed after the impact" in check_proof(false).claims[0].evidence
