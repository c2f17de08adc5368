"""A branch is a curve of orbits: each range is proved, and neighbours hold the same orbit."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

import zeno_orbits as zo
from tests.support import hard_to_prove, switched
from tests.support.commands import MISUSE, NO, YES, ask
from tests.support.orbits import shot_orbit
from zeno_orbits.errors import InputError
from zeno_orbits.work import ExecutionPlan, Workers

pytestmark = pytest.mark.slow

Certificate = dict[str, Any]
INTERVAL = ("A", 1.0, 1.001)
"""Amplitudes of the forced oscillator, whose orbit is published at 1."""


@pytest.fixture(scope="module")
def orbit() -> zo.Orbit:
    return shot_orbit("forced_oscillator")


@pytest.fixture(scope="module")
def proof(orbit: zo.Orbit) -> zo.BranchProof:
    return zo.prove_branch(orbit, INTERVAL)


@pytest.fixture
def certificate(proof: zo.BranchProof) -> Certificate:
    return json.loads(json.dumps(proof.certificate))


def _number(text: str) -> Fraction:
    mantissa, exponent = text.split("p")
    return int(mantissa, 16) * Fraction(2) ** int(exponent)


def _ends(one: Certificate) -> tuple[Fraction, Fraction]:
    value, radius = _number(one["value"]), _number(one["radius"])
    return value - radius, value + radius


def test_the_ranges_cover_the_interval_and_hold_the_orbits_of_the_closed_form(
    proof: zo.BranchProof, certificate: Certificate
) -> None:
    # The stop releases where A cos(t) = k stop, and the period is that of the force.
    assert proof.complete
    ends = [_ends(one) for one in certificate["ranges"]]
    assert len(ends) > 1
    assert ends[0][0] <= 1
    assert ends[-1][1] >= Fraction(1.001)
    assert all(b[0] <= a[1] for a, b in pairwise(ends))
    names = zo.load_problem("forced_oscillator").state_names
    others = [k for k in range(len(names)) if names[k] in ("cosine", "sine")]
    for one, values in zip(certificate["ranges"], ends, strict=True):
        box = one["pass"]["box"]["others"]
        for amplitude in map(float, values):
            cosine = -0.8 / amplitude
            truth = (cosine, math.sqrt(1 - cosine**2))
            assert len(others) == len(box["centre"])
            for x, m, r in zip(truth, box["centre"], box["radius"], strict=True):
                assert abs(Fraction(x) - _number(m)) < _number(r)
        (period,) = (claim for claim in one["claims"] if claim["name"] == "period")
        assert _number(period["low"]) < Fraction(2 * math.pi) < _number(period["high"])


def test_the_checker_accepts_it_and_prints_the_interval(certificate: Certificate) -> None:
    verdict = zo.check_branch(certificate)
    assert verdict.ok, verdict.verdict()
    told = "\n".join(verdict.lines())
    assert "Proved: for each A from 1 to (the double 1.001) there is a Zeno periodic orbit" in told
    assert "one curve that is analytic in A" in told
    assert "exponentially stable for A from 1" in told


def _without_one(c: Certificate) -> None:
    del c["ranges"][1]


def _swapped(c: Certificate) -> None:
    c["ranges"][0], c["ranges"][1] = c["ranges"][1], c["ranges"][0]


def _narrower(c: Certificate) -> None:
    mantissa, exponent = c["ranges"][1]["radius"].split("p")
    c["ranges"][1]["radius"] = f"{mantissa}p{int(exponent) - 1}"


def _twice(c: Certificate) -> None:
    c["ranges"].insert(1, c["ranges"][0])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (_without_one, "ranges 1 and 2 leave a gap"),
        (_swapped, "ranges 1 and 2 are not in order"),
        (_narrower, "ranges 1 and 2 leave a gap"),
        (_twice, "ranges 1 and 2 are not in order"),
    ],
)
def test_ranges_with_a_gap_or_out_of_order_are_refused(
    certificate: Certificate, change: Callable[[Certificate], None], reason: str
) -> None:
    change(certificate)
    verdict = zo.check_branch(certificate)
    assert not verdict.ok
    assert verdict.conclusions() == []
    assert verdict.verdict() == f"Not proved: {reason}."


def _wider(c: Certificate) -> None:
    mantissa, exponent = c["ranges"][-1]["radius"].split("p")
    c["ranges"][-1]["radius"] = f"{mantissa}p{int(exponent) + 1}"


def _elsewhere(c: Certificate) -> None:
    c["parameters"]["c"] = "0x1p+0"


def _shorter_period(c: Certificate) -> None:
    (period,) = (claim for claim in c["ranges"][-1]["claims"] if claim["name"] == "period")
    period["high"] = period["low"]


def _other_box(c: Certificate) -> None:
    box = c["ranges"][-1]["pass"]["box"]["others"]
    box["centre"] = c["ranges"][0]["pass"]["box"]["others"]["centre"]
    box["radius"] = ["0x1p-40" for _ in box["radius"]]


@pytest.mark.parametrize(
    ("change", "claim"),
    [
        (_wider, "motion"),
        (_elsewhere, "motion"),
        (_shorter_period, "period"),
        (_other_box, "motion"),
    ],
)
def test_a_range_that_does_not_hold_fails_the_branch(
    certificate: Certificate, change: Callable[[Certificate], None], claim: str
) -> None:
    change(certificate)
    certificate["ranges"] = certificate["ranges"][-1:]
    verdict = zo.check_branch(certificate)
    assert verdict.verdict().startswith(f"Not proved: range 1: `{claim}`")
    assert verdict.conclusions() == []


@pytest.fixture(scope="module")
def wells() -> dict[str, zo.BranchProof]:
    """Return the branches of two orbits at the same parameters: one repels, one attracts."""
    problem = hard_to_prove.double_well()
    found = zo.find_orbit_by_shooting(problem).unwrap()
    starts = {name: {**found.start_state, "well": y} for name, y in (("top", 0.0), ("rest", 1.0))}
    return {
        name: zo.prove_branch(
            replace(found, start_state=start), ("A", 1.0, 1.0004), problem=problem
        )
        for name, start in starts.items()
    }


def test_the_stability_of_a_branch_is_that_of_its_orbits(wells: dict[str, zo.BranchProof]) -> None:
    problem = hard_to_prove.double_well()
    for name, word in (("top", "unstable"), ("rest", "exponentially stable")):
        branch = wells[name]
        assert branch.complete, branch.verdict()
        assert any(
            f"(5) The fixed point is {word} for A from 1 to" in x for x in branch.statements()
        )
        only = {**branch.certificate, "ranges": branch.certificate["ranges"][:1]}
        verdict = zo.check_branch(only, problem=problem)
        assert verdict.ok, verdict.verdict()
        assert any(f"is {word} for A from 1 to" in line for line in verdict.lines())


def test_stability_that_is_claimed_on_a_repelling_part_is_refused(
    wells: dict[str, zo.BranchProof],
) -> None:
    false = copy.deepcopy(dict(wells["top"].certificate))
    false["ranges"] = false["ranges"][:1]
    (claim,) = (one for one in false["ranges"][0]["claims"] if one["name"] == "repelling")
    claim["name"] = "stable"
    verdict = zo.check_branch(false, problem=hard_to_prove.double_well())
    assert verdict.verdict().startswith("Not proved: range 1: `stable`")


def test_ranges_of_two_orbits_are_not_joined_into_one_branch(
    wells: dict[str, zo.BranchProof],
) -> None:
    mixed = copy.deepcopy(dict(wells["top"].certificate))
    rest = wells["rest"].certificate["ranges"]
    first = mixed["ranges"][0]
    after = next(one for one in rest if _ends(first)[0] < _ends(one)[0] <= _ends(first)[1])
    mixed["ranges"] = [first, after]
    verdict = zo.check_branch(mixed, problem=hard_to_prove.double_well())
    assert verdict.verdict().startswith("Not proved: ranges 1 and 2 are not shown to hold the same")
    assert verdict.conclusions() == []


@pytest.fixture(scope="module")
def wheel() -> zo.BranchProof:
    """Return the branch of the rolling motion of a wheel without a rim, in the slope."""
    problem = switched.rimless_wheel()
    orbit = zo.find_orbit(problem).unwrap()
    return zo.prove_branch(orbit, ("slope", 0.08, 0.080012), problem=problem)


def test_a_branch_from_just_before_a_switch_holds_the_orbits_of_the_closed_form(
    wheel: zo.BranchProof,
) -> None:
    # As for the single orbit: gravity restores the energy that a strike takes.
    assert wheel.complete, wheel.verdict()
    certificate = json.loads(json.dumps(dict(wheel.certificate)))
    (place,) = certificate["section"]["places"]
    for one in certificate["ranges"]:
        box = one["pass"]["box"]
        sides = {place: (box["centre"][0], box["radius"][0])}
        sides[1 - place] = (box["others"]["centre"][0], box["others"]["radius"][0])
        for slope in map(float, _ends(one)):
            last = slope + switched.HALF
            fall = 2 * switched.GRAVITY * (math.cos(last - 2 * switched.HALF) - math.cos(last))
            truth = (last, math.sqrt(fall / (1 - switched.LEFT**2)))
            for k, (m, r) in sides.items():
                assert abs(Fraction(truth[k]) - _number(m)) < _number(r)
    verdict = zo.check_branch(certificate, problem=switched.rimless_wheel())
    assert verdict.ok, verdict.verdict()
    told = "\n".join(verdict.lines())
    assert "Section: the states just before the switch `strike`" in told
    assert "Events in order: switch strike." in told


def _strike(c: Certificate) -> Any:
    return c["ranges"][-1]["pass"]["records"][0]


def _another_return(c: Certificate) -> None:
    """Follow the wheel over two strikes in the last range."""
    one = c["ranges"][-1]["pass"]
    again = copy.deepcopy(one["records"])
    one["records"] += again


FALSE: dict[str, Callable[[Certificate], Any]] = {
    "passes of another range": lambda c: c["ranges"][0].update(
        {"pass": copy.deepcopy(c["ranges"][-1]["pass"])}
    ),
    "values of another range": lambda c: c["ranges"][-1].update(
        value=c["ranges"][0]["value"], radius=c["ranges"][-1]["radius"]
    ),
    "a range that is moved by its width": lambda c: c.update(
        ranges=[c["ranges"][0] | {"value": c["ranges"][1]["value"]}]
    ),
    "no strike": lambda c: c["ranges"][-1]["pass"]["records"].pop(0),
    "a wheel that is held": lambda c: _strike(c).update(mode="locked"),
    "a guard that stays zero": lambda c: _strike(c).update(kept=1),
    "two turns in one range": _another_return,
    "another switch": lambda c: c["section"].update(switch=1),
    "releases": lambda c: c["section"].update(conditions=["gap", "gap_rate", "multiplier"]),
    "a negative range": lambda c: c["ranges"][-1].update(
        radius="-" + c["ranges"][-1]["radius"].removeprefix("-")
    ),
    "no ranges": lambda c: c.update(ranges=[]),
    "a repelling wheel": lambda c: [
        claim.update(name="repelling")
        for claim in c["ranges"][-1]["claims"]
        if claim["name"] == "stable"
    ],
    "the parameter is another one": lambda c: c.update(branch="mass"),
}


@pytest.mark.parametrize("name", FALSE)
def test_no_false_branch_of_a_walker_is_accepted(wheel: zo.BranchProof, name: str) -> None:
    false = json.loads(json.dumps(dict(wheel.certificate)))
    false["ranges"] = false["ranges"][:2]
    FALSE[name](false)
    try:
        found = zo.check_branch(false, problem=switched.rimless_wheel()).conclusions()
    except InputError:
        found = []
    assert found == []


def test_an_interrupted_proof_continues_with_its_finished_parts(
    orbit: zo.Orbit, tmp_path: Path
) -> None:
    interval, plan = (
        ("A", 0.9998, 1.0002),
        ExecutionPlan(place=Workers(count=1), checkpoint=tmp_path / "parts"),
    )

    def interrupt(stage: str, _part: float | None = None, /) -> None:
        if stage.startswith("1 of"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        zo.prove_branch(orbit, interval, plan=plan, on_progress=interrupt)
    kept = sorted((tmp_path / "parts").glob("chunk-*.json"))
    assert len(kept) == 1
    stamp = kept[0].stat().st_mtime_ns
    found = zo.prove_branch(orbit, interval, plan=plan)
    assert found.complete
    assert kept[0].stat().st_mtime_ns == stamp
    assert found.certificate == zo.prove_branch(orbit, interval).certificate


def test_finished_parts_of_another_restitution_are_not_taken(
    orbit: zo.Orbit, tmp_path: Path
) -> None:
    # Both orbits have the same release and period, which the points of a branch hold.
    plan = ExecutionPlan(place=Workers(count=1), checkpoint=tmp_path / "parts")
    assert zo.prove_branch(orbit, ("A", 0.9999, 1.0001), plan=plan).complete
    other = zo.find_orbit_by_shooting("forced_oscillator", parameters={"restitution": 0.3}).unwrap()
    with pytest.raises(InputError, match="its `values"):
        zo.prove_branch(other, ("A", 0.9999, 1.0001), plan=plan)


def test_the_command_proves_a_branch_and_checks_its_file(orbit: zo.Orbit, tmp_path: Path) -> None:
    zo.write_orbit(orbit, tmp_path / "orbit.json")
    written = tmp_path / "branch.json"
    answer = ask(
        *("prove", tmp_path / "orbit.json", "--branch", "A=1:1.0002", "-o", written, "-j", "1")
    )
    assert answer.code == YES
    assert "(4) These fixed points form one curve that is analytic in A" in answer.out
    assert "Estimate: " in answer.err
    assert ask("prove", "--check", written, "-j", "1").code == YES
    data = json.loads(written.read_text())
    data["ranges"][0]["claims"] = []
    data["ranges"][0]["pass"]["records"][0]["h"] = "0x1p-200"
    written.write_text(json.dumps(data))
    false = ask("prove", "--check", written, "-j", "1", "--json")
    assert false.code == NO
    assert not false.data["proved"]


def test_an_interval_without_the_orbit_is_refused(orbit: zo.Orbit) -> None:
    with pytest.raises(InputError, match=r"must contain the orbit's own `A`, 1\.0"):
        zo.prove_branch(orbit, ("A", 1.1, 1.2))


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--branch", "A=1:1.1", "--basin"), "Option `--basin` is for a single orbit"),
        (("--branch", "A=1:1.1", "--radius", "1e-9"), "Option `--radius` is for a single orbit"),
        (("--workers", "2"), "Option `--workers` needs --branch"),
        (
            ("--branch", "A=1.1:1.2"),
            "Widen the interval, or search an orbit in it, as with --set A=",
        ),
        (("--branch", "B=1:1.2"), "unknown"),
    ],
)
def test_options_that_do_not_belong_to_a_branch_are_refused(
    orbit: zo.Orbit, tmp_path: Path, words: tuple[str, ...], reason: str
) -> None:
    zo.write_orbit(orbit, tmp_path / "orbit.json")
    answer = ask("prove", tmp_path / "orbit.json", *words)
    assert answer.code == MISUSE
    assert reason in answer.err
