"""The checker of certificates: on orbits in closed form, made by hand, and on false ones."""

from __future__ import annotations

import copy
import json
import os
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import casadi as ca
import mpmath as mp
import pytest

from tests.support.cases import fast
from tests.support.certificates import (
    BITS,
    digest_of,
    mutants,
    text_of,
)
from zeno_orbits.errors import InputError
from zeno_orbits.model import ImpactLaw, load_problem
from zeno_orbits.proof import ProofVerdict, check_proof

Certificate = dict[str, Any]

MULTIPLIER = -0.58429531434153 + 0.00560035149247j
"""As published of the impact oscillator, with its conjugate."""


def test_a_zeno_orbit_in_closed_form_is_proved(zeno_verdict: ProofVerdict) -> None:
    assert zeno_verdict.ok, zeno_verdict.claims
    names = [claim.name for claim in zeno_verdict.claims]
    assert names == ["motion 0", "exists", "unique", "period", "zeno_time", "impact_time"]


@pytest.mark.slow
def test_an_orbit_with_one_impact_a_turn_is_proved(impact: Certificate) -> None:
    verdict = check_proof(impact)
    assert verdict.ok, verdict.claims
    discs = [[_value(x) for x in disc] for disc in _claim(impact, "multipliers")["discs"]]
    for known in (MULTIPLIER, MULTIPLIER.conjugate()):
        assert any(abs(complex(x, y) - known) < r for x, y, r in discs)


def test_the_problem_of_a_certificate_may_be_a_name(impact: Certificate) -> None:
    assert check_proof(impact, problem=impact["problem"]).ok
    with pytest.raises(InputError, match="must be the problem"):
        check_proof(impact, problem="bouncing_ball")


@pytest.mark.slow
def test_what_is_proved_reads_from_a_file(tmp_path: Path, impact: Certificate) -> None:
    path = tmp_path / "proof.json"
    path.write_text(json.dumps(impact))
    assert check_proof(path) == check_proof(impact)


@pytest.mark.parametrize("kind", fast(1, ["impact", "zeno"]))
def test_inclusion_alone_proves_one_stable_orbit(kind: str, request: pytest.FixtureRequest) -> None:
    certificate: Certificate = request.getfixturevalue(kind)
    alone = {**certificate, "claims": certificate["claims"][:1]}
    assert alone["claims"][0]["by"] == "inclusion"
    told = "\n".join(check_proof(alone).conclusions())
    assert "exactly one fixed point in box 1" in told
    assert "exactly one periodic orbit passes through box 1" in told
    assert "The fixed point of the return map is exponentially stable." in told


def test_a_norm_is_told_with_its_box_and_its_basis(impact: Certificate) -> None:
    told = check_proof(impact).conclusions()
    (line,) = (line for line in told if "norm of the return map's derivative" in line)
    start = "On box 1, the norm of the return map's derivative in the basis of the certificate is"
    norm = float(line.removeprefix(f"{start} at most ").removesuffix("."))
    # The multipliers' size, as published: the basis makes the derivative diagonal.
    assert abs(MULTIPLIER) <= norm < abs(MULTIPLIER) + 1e-2


@pytest.mark.slow
def test_multipliers_of_discs_that_meet_lie_in_their_union(impact: Certificate) -> None:
    apart, meeting = "One multiplier lies in each of the discs", "lie in the union of the discs"
    told = "\n".join(check_proof(impact).conclusions())
    assert apart in told
    assert meeting not in told
    # In the basis of the states the discs are wide.
    wide = copy.deepcopy(impact)
    one, none = text_of(1), text_of(0)
    basis = {"re": [[one, none], [none, one]], "im": [[none] * 2] * 2}
    discs = [[none, none, text_of(9)]] * 2
    _claim(wide, "multipliers").update(basis=basis, discs=discs)
    told = "\n".join(check_proof(wide).conclusions())
    assert meeting in told
    assert apart not in told


def test_the_numbers_of_a_theorem_are_exact(impact: Certificate) -> None:
    verdict = check_proof(impact)
    centre, radius = (impact["passes"][0]["box"][name] for name in ("centre", "radius"))
    boxes = verdict.as_json()["box"].values()
    for shown, exact in zip(boxes, zip(centre, radius, strict=True), strict=True):
        for text, number in zip(shown, exact, strict=True):
            assert _exactly(text) == Fraction(_units(number), 2**BITS)
            assert text in "\n".join(verdict.lines())


def _exactly(text: str) -> Fraction:
    mantissa, _, exponent = text.partition("p")
    if not exponent:
        return Fraction(text)
    return Fraction(int(mantissa, 16)) * Fraction(2) ** int(exponent)


@pytest.mark.slow
def test_a_theorem_over_a_range_is_about_each_value(zeno_verdict: ProofVerdict) -> None:
    theorem = zeno_verdict.theorem
    radius = Fraction(1, 2**300) + Fraction(1, 2**90)
    verdict = replace(zeno_verdict, theorem=replace(theorem, over={"omega": radius}))
    (line,) = (line for line in verdict.lines() if line.startswith("Parameters that vary"))
    assert _exactly(line.rpartition(" ")[2].removesuffix(".")) == radius
    assert "for each value of omega there is a Zeno periodic orbit" in verdict.verdict()


def _moved(text: str, by: float) -> str:
    with mp.workdps(80):
        return text_of(mp.mpf(_units(text)) / mp.mpf(2) ** BITS + mp.mpf(by))


def _units(text: str) -> int:
    mantissa, exponent = text.replace("0x", "").split("p")
    return int(mantissa, 16) << (int(exponent) + BITS)


def _value(text: str) -> float:
    return _units(text) / 2**BITS


def _claim(certificate: Certificate, name: str) -> Any:
    return next(claim for claim in certificate["claims"] if claim["name"] == name)


@pytest.mark.slow
def test_the_other_states_may_be_looked_for_around_another_place(zeno: Certificate) -> None:
    # The sine is 0.6: a thousandth beside it, Newton's first step is off by 8e-7, and must be
    # enclosed on the whole way from there.
    moved = copy.deepcopy(zeno)
    others = moved["passes"][0]["box"]["others"]
    others["centre"][1], others["radius"][1] = _moved(others["centre"][1], 1e-3), text_of(0.01)
    assert check_proof(moved).ok


def _period_too_long(c: Certificate) -> None:
    claim = _claim(c, "period")
    claim["low"], claim["high"] = _moved(claim["low"], 1e-6), _moved(claim["high"], 1e-6)


def _state_too_far(c: Certificate) -> None:
    claim = _claim(c, "start_state")
    claim["low"][1] = claim["high"][1]


def _disc_too_small(c: Certificate) -> None:
    _claim(c, "multipliers")["discs"][1][2] = "0x1p-80"


def _disc_elsewhere(c: Certificate) -> None:
    _claim(c, "multipliers")["discs"][0][0] = text_of(0.5)


def _norm_in_a_bad_basis(c: Certificate) -> None:
    _claim(c, "stable")["basis"] = {
        "re": [[text_of(1), text_of(1)], [text_of(0), text_of(1e-3)]],
        "im": [[text_of(0)] * 2] * 2,
    }


def _repelling(c: Certificate) -> None:
    basis = _claim(c, "stable")["basis"]
    c["claims"].append({"name": "repelling", "pass": 0, "basis": basis})


def _stable_in_a_basis_that_is_none(c: Certificate) -> None:
    _claim(c, "stable")["basis"] = {part: [[text_of(0)] * 2] * 2 for part in ("re", "im")}


@pytest.mark.parametrize(
    ("falsify", "name"),
    [
        (_period_too_long, "period"),
        (_stable_in_a_basis_that_is_none, "stable"),
        (_state_too_far, "start_state"),
        (_disc_too_small, "multipliers"),
        (_disc_elsewhere, "multipliers"),
        (_norm_in_a_bad_basis, "stable"),
        (_repelling, "repelling"),
    ],
)
def test_a_false_claim_is_refused_by_its_name(
    impact: Certificate, falsify: Callable[[Certificate], None], name: str
) -> None:
    false = copy.deepcopy(impact)
    falsify(false)
    assert _refused(check_proof(false)) == [name]


@pytest.mark.slow
def test_the_time_of_a_zeno_point_that_is_moved_is_refused(zeno: Certificate) -> None:
    false = copy.deepcopy(zeno)
    claim = _claim(false, "zeno_time")
    claim["low"] = claim["high"]
    assert _refused(check_proof(false)) == ["zeno_time"]


def _refused(verdict: ProofVerdict) -> list[str]:
    return [claim.name for claim in verdict.claims if not claim.ok]


def _other_restitution(c: Certificate) -> str:
    c["parameters"]["restitution"] = text_of(0.8 + 1e-9)
    return "(impact): r[1]"


def _box_far_too_large(c: Certificate) -> str:
    c["passes"][0]["box"]["radius"] = [text_of(1e-3)] * 2
    return "section: state 2 of the section is not found"


def _start_beside_the_section(c: Certificate) -> str:
    c["passes"][0]["start"]["m"][2] = _moved(c["passes"][0]["start"]["m"][2], 1e-20)
    return "section: r[2]"


def _start_that_does_not_turn(c: Certificate) -> str:
    c["passes"][0]["start"]["C"][2][1] = text_of(0)
    return "section: R[2]"


def _a_step_left_out(c: Certificate) -> str:
    del c["passes"][0]["records"][3]
    return "record 3 (step): r["


def _a_step_too_long(c: Certificate) -> str:
    c["passes"][0]["records"][3]["h"] = text_of(0.5 + 1e-12)
    return "record 3 (step): r["


def _a_set_too_small(c: Certificate) -> str:
    c["passes"][0]["records"][4]["set"]["r"][2] = "0x0p+0"
    return "record 4 (step): r[2]"


def _a_derivative_too_sure(c: Certificate) -> str:
    c["passes"][0]["records"][12]["set"]["R"][1][0] = "0x0p+0"
    return "record 12 (cross): R[1]"


def _an_order_too_low(c: Certificate) -> str:
    c["passes"][0]["records"][5]["orders"] = [10, 20]
    return "record 5 (step): r["


def _a_window_before_the_impact(c: Certificate) -> str:
    window = c["passes"][0]["records"][12]["window"]
    window[1] = c["passes"][0]["records"][12]["centre"][1]
    return "record 12 (cross): the guard may vanish outside its window"


def _a_centre_that_misses(c: Certificate) -> str:
    centre = c["passes"][0]["records"][12]["centre"]
    centre[0] = centre[1]
    return "record 12 (cross): the guard may vanish outside its window"


def _a_step_of_no_length(c: Certificate) -> str:
    c["passes"][0]["records"][3]["h"] = text_of(0)
    return "record 3 (step): the step is not positive"


def _an_impact_inside_a_step(c: Certificate) -> str:
    records = c["passes"][0]["records"]
    names = ("h", "orders", "set")
    through = {"kind": "step", **{name: records[12][name] for name in names}}
    records.insert(12, {**through, "h": text_of(0.5)})
    return "record 12 (step): the gap may close"


def _a_box_of_others_elsewhere(c: Certificate) -> str:
    c["passes"][0]["box"]["others"]["centre"][0] = text_of(0.9)
    return "section: state 2"


def _a_return_elsewhere(c: Certificate) -> str:
    c["passes"][0]["box"]["others"]["radius"][0] = text_of(1e-11)
    return "section: state 2"


@pytest.mark.parametrize(
    "falsify",
    fast(
        6,
        [
            _other_restitution,
            _box_far_too_large,
            _start_beside_the_section,
            _start_that_does_not_turn,
            _a_step_left_out,
            _a_step_too_long,
            _a_set_too_small,
            _a_derivative_too_sure,
            _an_order_too_low,
            _a_window_before_the_impact,
            _a_centre_that_misses,
            _a_step_of_no_length,
            _an_impact_inside_a_step,
            _a_box_of_others_elsewhere,
            _a_return_elsewhere,
        ],
    ),
)
def test_a_motion_that_is_not_shown_is_refused_with_the_record_and_the_reason(
    impact: Certificate, falsify: Callable[[Certificate], str]
) -> None:
    false = copy.deepcopy(impact)
    reason = falsify(false)
    verdict = check_proof(false)
    assert reason in verdict.claims[0].evidence
    assert _refused(verdict) == [claim.name for claim in verdict.claims]


def _tail_that_is_too_sure(c: Certificate) -> str:
    _tail(c)["set"]["r"][3] = text_of(1e-12)
    return "(tail): r[3]"


def _tail_over_too_large_a_disc(c: Certificate) -> str:
    _tail(c)["radius"] = [text_of(2.0)] * 4
    return "(tail): the gap's acceleration may vanish"


def _tail_over_too_small_a_disc(c: Certificate) -> str:
    _tail(c)["radius"][2] = text_of(1e-12)
    return "(tail): the polydisc is too small"


def _tail_whose_impacts_are_faster(c: Certificate) -> str:
    _tail(c)["speed"] = text_of(1e-13)
    return "(tail): the speed after the impact"


def _held_until_the_stop_pulls(c: Certificate) -> str:
    records = c["passes"][0]["records"]
    last = {name: records[-1][name] for name in ("h", "orders", "set")}
    records.insert(-1, {"kind": "step", **last})
    return "(step): the multiplier may be"


def _released_where_the_stop_begins_to_press(c: Certificate) -> str:
    part = c["passes"][0]
    for numbers, place in (
        (part["box"]["others"]["centre"], 1),
        (part["start"]["m"], 3),
        (part["records"][-1]["set"]["m"], 3),
    ):
        numbers[place] = f"-{numbers[place]}"
    return "record 0 (step): the gap may close"


def _tail(c: Certificate) -> Any:
    return next(record for record in c["passes"][0]["records"] if record["kind"] == "tail")


@pytest.mark.slow
@pytest.mark.parametrize(
    "falsify",
    fast(
        1,
        [
            _tail_that_is_too_sure,
            _tail_over_too_large_a_disc,
            _tail_over_too_small_a_disc,
            _tail_whose_impacts_are_faster,
            _held_until_the_stop_pulls,
            _released_where_the_stop_begins_to_press,
        ],
    ),
)
def test_a_zeno_motion_that_is_not_shown_is_refused_with_the_inequality(
    zeno: Certificate, falsify: Callable[[Certificate], str]
) -> None:
    false = copy.deepcopy(zeno)
    reason = falsify(false)
    assert reason in check_proof(false).claims[0].evidence


def _another_digest(c: Certificate) -> None:
    c["digest"] = "0" * 64


def _another_problem(c: Certificate) -> None:
    c["problem"] = "vibrating_table"


def _a_number_that_is_none(c: Certificate) -> None:
    c["passes"][0]["start"]["m"][1] = "nan"


def _a_double(c: Certificate) -> None:
    c["passes"][0]["records"][0]["h"] = 0.5


def _another_format(c: Certificate) -> None:
    c["format"] = 1


def _an_unknown_entry(c: Certificate) -> None:
    c["statement"] = "there is an orbit of period 1"


def _no_claim_of_ours(c: Certificate) -> None:
    c["claims"].append({"name": "beautiful", "pass": 0})


def _no_pass_of_ours(c: Certificate) -> None:
    c["claims"][0]["pass"] = 1


def _no_impact_at_the_end(c: Certificate) -> None:
    del c["passes"][0]["records"][-1]


def _two_impacts(c: Certificate) -> None:
    records = c["passes"][0]["records"]
    records.append(records[-1])


def _a_row_too_few(c: Certificate) -> None:
    del c["passes"][0]["start"]["Q"][0]


def _a_negative_radius(c: Certificate) -> None:
    c["passes"][0]["start"]["r"][1] = "-0x1p-100"


def _an_endless_order(c: Certificate) -> None:
    c["passes"][0]["records"][0]["orders"] = [10**6, 20]


def _a_gap_that_is_another_coordinate(c: Certificate) -> None:
    c["gap_row"] = 1


def _a_parameter_that_is_no_double(c: Certificate) -> None:
    c["parameters"]["c"] = f"0x{_units(c['parameters']['c']) + 1:x}p-{BITS}"


def _a_number_finer_than_the_unit(c: Certificate) -> None:
    c["passes"][0]["records"][0]["h"] = "0x1p-400"


def _no_records(c: Certificate) -> None:
    c["passes"][0]["records"] = []


def _no_passes(c: Certificate) -> None:
    c["passes"] = []


def _a_pass_beside_the_first(c: Certificate) -> None:
    beside = copy.deepcopy(c["passes"][0])
    beside["box"]["centre"][0] = _moved(beside["box"]["centre"][0], 1e-12)
    c["passes"].append(beside)


def _a_coordinate_twice(c: Certificate) -> None:
    c["section"]["places"] = [1, 1]


def _orders_that_are_none(c: Certificate) -> None:
    c["passes"][0]["records"][0]["orders"] = 30


@pytest.mark.parametrize(
    "spoil",
    fast(
        12,
        [
            _no_records,
            _no_passes,
            _a_pass_beside_the_first,
            _a_coordinate_twice,
            _orders_that_are_none,
            _another_digest,
            _another_problem,
            _a_number_that_is_none,
            _a_double,
            _another_format,
            _an_unknown_entry,
            _no_claim_of_ours,
            _no_pass_of_ours,
            _no_impact_at_the_end,
            _two_impacts,
            _a_row_too_few,
            _a_negative_radius,
            _an_endless_order,
            _a_gap_that_is_another_coordinate,
            _a_parameter_that_is_no_double,
            _a_number_finer_than_the_unit,
        ],
    ),
)
def test_what_is_no_certificate_is_refused_in_one_line(
    impact: Certificate, spoil: Callable[[Certificate], None]
) -> None:
    spoiled = copy.deepcopy(impact)
    spoil(spoiled)
    with pytest.raises(InputError) as refusal:
        check_proof(spoiled)
    assert "\n" not in str(refusal.value)


_FAR = "0x1p+9999"


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    fast(1, [None, 10**400, 224.0, _FAR, [[]]]),
    ids=lambda kind: repr(kind)[:9],
)
def test_an_entry_of_another_kind_is_refused_in_words(impact: Certificate, kind: Any) -> None:
    names = [name for name in impact if name != "versions"]
    places = [(name,) for name in names]
    places += [
        (name, key) for name in names if isinstance(impact[name], dict) for key in impact[name]
    ]
    places += [("section", "places", 0), ("section", "conditions", 0), ("passes", 0)]
    for *path, last in places:
        changed = copy.deepcopy(impact)
        place: Any = changed
        for key in path:
            place = place[key]
        place[last] = kind
        with pytest.raises(InputError, match=r"The certificate|Unknown problem") as refused:
            check_proof(changed)
        assert "Error" not in str(refused.value)


@pytest.mark.slow
def test_a_record_of_another_shape_is_refused_by_whatever_process_meets_it(
    impact: Certificate, monkeypatch: pytest.MonkeyPatch
) -> None:
    spoiled = copy.deepcopy(impact)
    _orders_that_are_none(spoiled)
    # All records are met by workers, as those of a long certificate are.
    monkeypatch.setattr("zeno_orbits.proof.checker.certificate._CHUNK", 5)
    with pytest.raises(InputError, match="is invalid"):
        check_proof(spoiled)


def test_what_claims_nothing_is_no_proof(impact: Certificate) -> None:
    silent = {**impact, "claims": []}
    verdict = check_proof(silent)
    assert not verdict.ok
    assert verdict.verdict() == "Not proved: no claim states that an orbit exists."


def _twice_as_fast(system: Any) -> Any:
    flow = system.free_flow
    return replace(system, free_flow=ca.vertcat(2 * flow[0], flow[1:]))


def _restitution_of_the_phase(system: Any) -> Any:
    return replace(system, law=ImpactLaw(system.restitution * system.state[2]))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (_twice_as_fast, "is not a state"),
        (_restitution_of_the_phase, "restitution is not constant"),
    ],
)
def test_a_problem_that_the_lemmas_are_not_about_is_refused(
    impact: Certificate, change: Callable[[Any], Any], told: str
) -> None:
    problem = load_problem("impact_oscillator")
    other = replace(problem, model=lambda p: change(problem.model(p)))
    with pytest.raises(InputError, match=told):
        check_proof({**impact, "digest": digest_of(other)}, other)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes")
def test_a_pipe_is_no_certificate(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path):
        with pytest.raises(InputError, match="is not a certificate"):
            check_proof(path)


def test_a_file_that_is_cut_short_is_refused(tmp_path: Path, impact: Certificate) -> None:
    path = tmp_path / "proof.json"
    path.write_text(json.dumps(impact)[:-1000])
    with pytest.raises(InputError, match="is not a certificate"):
        check_proof(path)


@pytest.mark.slow
def test_no_mutation_is_accepted_with_a_claim_that_is_false(impact: Certificate) -> None:
    _require_sound_under_mutations(impact, count=40, seed=1)


@pytest.mark.weekly
@pytest.mark.slow
def test_none_of_300_mutations_is_accepted_with_a_claim_that_is_false(impact: Certificate) -> None:
    _require_sound_under_mutations(impact, count=300, seed=2)


def _require_sound_under_mutations(certificate: Certificate, count: int, seed: int) -> None:
    """Check that what is accepted after a change says nothing that the closed form denies."""
    statement = ("format", "kind", "problem", "digest", "parameters", "over", "gap_row", "section")
    for mutant in mutants(certificate, count, seed):
        try:
            accepted = check_proof(mutant).ok
        except InputError:
            continue
        if accepted and mutant != certificate:
            assert {k: mutant[k] for k in statement} == {k: certificate[k] for k in statement}
            _require_true(mutant, certificate)


def _require_true(mutant: Certificate, original: Certificate) -> None:
    """Check the claims of a mutant against what is known of the orbit."""
    start = [
        (_value(a) + _value(b)) / 2
        for a, b in zip(
            *(_claim(original, "start_state")[end] for end in ("low", "high")), strict=True
        )
    ]
    for claim in mutant["claims"]:
        if claim["name"] == "period":
            assert _value(claim["low"]) <= 2 * mp.pi <= _value(claim["high"])
        elif claim["name"] == "start_state":
            ends = zip(claim["low"], start, claim["high"], strict=True)
            assert all(_value(a) <= x <= _value(b) for a, x, b in ends)
        elif claim["name"] == "multipliers":
            discs = [[_value(x) for x in disc] for disc in claim["discs"]]
            for known in (MULTIPLIER, MULTIPLIER.conjugate()):
                assert any(abs(complex(x, y) - known) < r for x, y, r in discs)
        else:
            assert claim["name"] in ("exists", "unique", "stable")
    centre, radius = (mutant["passes"][0]["box"][name] for name in ("centre", "radius"))
    for place, middle, reach in zip((1, 3), centre, radius, strict=True):
        assert abs(_value(middle) - start[place]) < _value(reach)
