"""Printed conclusions contain what is proved, and printed hypotheses are part of what is proved.

Each statement stands in docs/proof.md.
"""

from __future__ import annotations

import copy
import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any

import mpmath as mp
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support import hard_to_prove, sheets
from tests.support.cases import fast, often
from tests.support.orbits import shot_orbit
from tests.support.pages import ROOT
from zeno_orbits.proof import Proof, check_proof
from zeno_orbits.proof.theorem import ProvedInterval, SectionBox, double_below

EXACT = {
    "forced_oscillator": mp.mpf(1),
    "vibrating_table": mp.mpf(30),
    "two_tone_table": mp.mpf(30),
}
"""Frequency of the clock [rad/s], a double, so that the period is `2 pi` divided by it."""


@pytest.fixture(scope="module")
def proofs() -> dict[str, Proof]:
    """Return proofs by the names of their problems."""
    names = (*EXACT, "motor_valve", "curved_surface")
    return {name: zo.prove(zo.find_orbit_by_shooting(name).unwrap()) for name in names}


def read(text: str) -> tuple[Fraction, Fraction]:
    """Return the ends of a printed interval."""
    middle, _, radius = text.partition(" +- ")
    return Fraction(middle) - Fraction(radius), Fraction(middle) + Fraction(radius)


def intervals(proof: Proof) -> Iterator[tuple[Any, str]]:
    """Give every interval of a proof and the text that is printed for it."""
    assert proof.bounds is not None
    bounds, page = proof.bounds, "\n".join(proof.lines())
    for one in (bounds.period, *bounds.zeno_times, *bounds.start_state.values()):
        assert one.text in page
        yield one, one.text
    for box in proof.boxes:
        for name, one in box.coordinates.items():
            assert f"{name} = {one.text}" in page
            assert f"{name} = {one.inner_text}" in page
            yield one, one.text


def test_printed_intervals_read_back_exactly_contain_the_proved_ones(
    proofs: dict[str, Proof],
) -> None:
    for proof in proofs.values():
        for one, text in intervals(proof):
            low, high = read(text)
            assert low <= one.low <= one.high <= high


def test_every_point_of_a_box_that_is_printed_as_contained_is_in_the_proved_box(
    proofs: dict[str, Proof],
) -> None:
    # The statements are about every point of the box, so a wider box would be a stronger theorem.
    surface = proofs["curved_surface"]
    data, parts = surface.as_json()["boxes"], surface.certificate["passes"]
    for box, told, part in zip(surface.boxes, data, parts, strict=True):
        ends = zip(part["box"]["centre"], part["box"]["radius"], strict=True)
        for (name, one), (centre, radius) in zip(box.coordinates.items(), ends, strict=True):
            low, high = read(told["contains"][name])
            assert exact(centre) - exact(radius) <= low < high <= exact(centre) + exact(radius)
            # Three digits lose at most two of their units.
            assert high - low > Fraction(97, 100) * (one.high - one.low)


def exact(text: str) -> Fraction:
    """Return a number of a certificate."""
    mantissa, _, exponent = text.partition("p")
    return int(mantissa, 16) * Fraction(2) ** int(exponent)


def _of_the_table(p: dict[str, Any]) -> tuple[Any, int]:
    return p["g"] / (p["A"] * p["omega"] ** 2), 1


def _of_the_oscillator(p: dict[str, Any]) -> tuple[Any, int]:
    return mp.sqrt(1 - (p["k"] * p["stop"] / p["A"]) ** 2), -1


CLOSED_FORMS = {"vibrating_table": _of_the_table, "forced_oscillator": _of_the_oscillator}
"""Sine of the clock at the release and the sign of the cosine, from the parameters' doubles."""


@pytest.mark.slow
@pytest.mark.parametrize("name", fast(1, CLOSED_FORMS))
def test_the_point_of_a_section_without_coordinates_is_printed_with_its_states(
    proofs: dict[str, Proof], name: str
) -> None:
    proof = proofs[name]
    problem = zo.load_problem(name)
    with mp.workdps(120):
        numbers = {one.name: mp.mpf(one.default or 0.0) for one in problem.parameters}
        sine, sense = CLOSED_FORMS[name](numbers)
        truth = {"sine": sine, "cosine": sense * mp.sqrt(1 - sine**2)}
        exactly_ = {state: Fraction(mp.nstr(x, 110)) for state, x in truth.items()}
    data, verdict = proof.as_json()["boxes"][0], check_proof(dict(proof.certificate))
    told = [data["others"], data["others_contain"], verdict.as_json()["other_states"][0]]
    page = "\n".join([*proof.lines(), *verdict.lines()])
    for texts in told:
        for state, x in exactly_.items():
            low, high = read(texts[state])
            assert low <= x <= high
            assert high - low < Fraction(1, 10**15)
            assert f"{state} = {texts[state]}" in page
            # The mirrored point, on the other sheet, is excluded.
            assert not low <= -x <= high
    at_rest = {state: text for state, text in data["others"].items() if state not in truth}
    assert len(at_rest) == 2
    assert set(at_rest.values()) == {"0 +- 0"}


SHEETS = [(name, rest) for name, one in sheets.MACHINES.items() for rest in one.rest]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "rest"), often(2, SHEETS[::-1]))
def test_orbits_over_the_same_coordinates_have_theorems_that_name_their_sheet(
    name: str, rest: float
) -> None:
    problem, others = sheets.problem_of(name, rest), sheets.MACHINES[name].rest
    proof = zo.prove(zo.find_orbit_by_shooting(problem).unwrap(), problem=problem)
    verdict = check_proof(dict(proof.certificate), problem)
    assert verdict.ok
    data, checked = proof.as_json(), verdict.as_json()
    assert set(data["boxes"][0]["coordinates"]) == set(data["box"]) == set(checked["box"])
    for number, box in enumerate(data["boxes"]):
        lying = box["coordinates"] | box["others"]
        assert set(lying) == set(problem.state_names)
        told = [lying, box["contains"] | box["others_contain"]]
        ends = [checked["box"], *checked["smaller_boxes"]][number]
        shown = {state: f"{_decimal(m)} +- {_decimal(r)}" for state, (m, r) in ends.items()}
        assert set(shown | checked["other_states"][number]) == set(problem.state_names)
        told.append(shown | checked["other_states"][number])
        for texts in told:
            low, high = read(texts["y"])
            assert low <= Fraction(rest) <= high
            assert not any(low <= Fraction(other) <= high for other in others if other != rest)
            # The release of the mass: cos(t) = -0.8, sin(t) = 0.6, but for the rounding of 0.8.
            for state, x in (("cosine", -0.8), ("sine", 0.6)):
                low, high = read(texts[state])
                assert float(low) - 1e-15 <= x <= float(high) + 1e-15
        page = "\n".join(proof.lines())
        for texts in told[:2]:
            assert all(f"{state} = {text}" in page for state, text in texts.items())


OTHER_SHEETS: dict[str, Any] = {
    "both sheets": lambda centre, _: (centre, 3.0),
    "the other sheet": lambda centre, radius: (-centre, radius),
    "beside the sheet": lambda centre, radius: (centre + 0.25, radius),
}


@pytest.fixture(scope="module")
def of_two_sheets() -> tuple[zo.Problem, dict[str, Any]]:
    """Return a machine whose orbits lie on two sheets, and a certificate of one of them."""
    problem = sheets.problem_of("two sheets", 1.0)
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    certificate = dict(zo.prove(orbit, problem=problem, radius=1e-9).certificate)
    assert check_proof(certificate, problem).ok
    return problem, certificate


@pytest.mark.parametrize("name", OTHER_SHEETS)
def test_a_certificate_whose_other_states_are_not_those_of_one_sheet_is_refused(
    name: str, of_two_sheets: tuple[zo.Problem, dict[str, Any]]
) -> None:
    problem, false = of_two_sheets[0], copy.deepcopy(of_two_sheets[1])
    box, places = false["passes"][0]["box"]["others"], false["section"]["places"]
    which = [k for k in range(2, 5) if k not in places].index(2)
    found = OTHER_SHEETS[name](
        float(exact(box["centre"][which])), float(exact(box["radius"][which]))
    )
    for name, x in zip(("centre", "radius"), found, strict=True):
        units = int(Fraction(x) * 2**200)
        box[name][which] = f"{'-' if units < 0 else ''}0x{abs(units):x}p-200"
    verdict = check_proof(false, problem)
    assert not verdict.ok
    assert verdict.conclusions() == []
    assert "section" in verdict.verdict()


def _decimal(text: str) -> str:
    """Return an exact number of the checker, which may be hexadecimal, as a fraction's text."""
    return str(exact(text) if "p" in text else Fraction(text))


PROVED = (
    *("solenoid", "motor_valve", "forced_oscillator", "vibrating_table", "two_tone_table"),
    *("relief_valve", "curved_surface", "torque_pendulum", "motor_cart"),
)


@pytest.mark.slow
@pytest.mark.parametrize("name", often(6, PROVED))
def test_every_printed_interval_of_a_set_is_on_the_right_side_of_the_proved_one(name: str) -> None:
    problem = zo.load_problem(name)
    proof = zo.prove(zo.find_orbit_by_shooting(problem).unwrap())
    verdict = check_proof(dict(proof.certificate))
    assert verdict.ok
    places = proof.certificate["section"]["places"]
    parts = zip(proof.certificate["passes"], proof.as_json()["boxes"], strict=True)
    for number, (part, told) in enumerate(parts):
        box = part["box"]
        _require_sides(box, [problem.state_names[k] for k in places], told)
        # Other states that the printed set names lie in the box of the certificate.
        others = [k for k in range(len(problem.state_names)) if k not in places]
        names = [
            problem.state_names[k]
            for k in others
            if problem.state_names[k] in told["others_contain"]
        ]
        centres, radii = box["others"]["centre"], box["others"]["radius"]
        for state, centre, radius in zip(names, centres, radii, strict=True):
            for text in (
                told["others_contain"][state],
                verdict.theorem.others[number][state],
            ):
                low, high = read(text)
                assert exact(centre) - exact(radius) <= low <= high
                assert high <= exact(centre) + exact(radius)
    assert proof.bounds is not None
    claims = {one["name"]: one for one in proof.certificate["claims"]}
    low, high = read(proof.as_json()["period"])
    assert low <= exact(claims["period"]["low"]) <= exact(claims["period"]["high"]) <= high
    ends = zip(claims["start_state"]["low"], claims["start_state"]["high"], strict=True)
    for text, (least, most) in zip(proof.as_json()["start_state"].values(), ends, strict=True):
        low, high = read(text)
        assert low <= exact(least) <= exact(most) <= high


def _require_sides(box: Any, names: list[str], told: Any) -> None:
    """Check that a set contains its "contains" and lies in its "lies in"."""
    for state, centre, radius in zip(names, box["centre"], box["radius"], strict=True):
        least, most = exact(centre) - exact(radius), exact(centre) + exact(radius)
        low, high = read(told["coordinates"][state])
        assert low <= least <= most <= high
        low, high = read(told["contains"][state])
        assert least <= low <= high <= most


@pytest.mark.parametrize(
    ("low", "high"),
    [
        (Fraction(1, 3), Fraction(1, 2)),
        (Fraction(1, 3) - Fraction(1, 10**30), Fraction(1, 3)),
        (Fraction(99949, 10**5), Fraction(100051, 10**5)),
        (-Fraction(5, 10**7), Fraction(5, 10**7)),
        (Fraction(3157, 10**5) - 1, Fraction(3157, 10**5) + 1),
        (Fraction(2**70 + 1, 2**70), Fraction(2**70 + 3, 2**70)),
        (Fraction(123456), Fraction(123457)),
    ],
)
def test_a_set_is_printed_with_a_set_inside_and_a_set_outside(
    low: Fraction, high: Fraction
) -> None:
    one = ProvedInterval(low=low, high=high)
    wide = ProvedInterval(low=low - (high - low) / 50, high=high + (high - low) / 50)
    box = SectionBox(coordinates={"u": one}, others={"v": one}, around={"v": wide})
    lying, contained = box.lying(), box.contained()
    for state in ("u", "v"):
        a, b = read(lying[state])
        assert a <= low <= high <= b
    a, b = read(contained["u"])
    assert low <= a <= b <= high
    a, b = read(contained["v"])
    assert wide.low <= a <= low <= high <= b <= wide.high
    half = double_below((high - low) / 2)
    assert (
        Fraction(repr(half)) <= (high - low) / 2 < Fraction(repr(half)) * (1 + Fraction(1, 10**15))
    )


def test_the_page_and_the_data_give_the_period_of_the_clock(proofs: dict[str, Proof]) -> None:
    with mp.workdps(60):
        for name, omega in EXACT.items():
            truth = Fraction(mp.nstr(2 * mp.pi / omega, 50))
            low, high = read(json.loads(json.dumps(proofs[name].as_json()))["period"])
            assert low < truth < high
            assert high - low < 1e-15


def test_the_data_hold_the_release_and_the_period_of_the_valve(proofs: dict[str, Proof]) -> None:
    # On the seat the current obeys L i' = V0 - R i from the Zeno point to the release, where the
    # torque of the motor is that of the preload.
    problem = zo.load_problem("motor_valve")
    p = {q.name: Fraction(q.default or 0.0) for q in problem.parameters}
    data = proofs["motor_valve"].as_json()
    low, high = read(data["start_state"]["current"])
    assert low <= p["preload"] / p["K_torque"] <= high
    orbit = shot_orbit("motor_valve")
    (phase,) = orbit.phases
    assert phase.zeno_state is not None
    with mp.workdps(30):
        number = {name: mp.mpf(x.numerator) / x.denominator for name, x in p.items()}
        limit = number["V0"] / number["R"]
        released = number["preload"] / number["K_torque"]
        start = mp.mpf(phase.zeno_state["current"])
        held = number["L"] / number["R"] * mp.log((limit - start) / (limit - released))
    zeno_low, zeno_high = read(data["zeno_times"][0])
    period_low, period_high = read(data["period"])
    # The current at the Zeno point is that of a simulation with an error of 1e-11.
    assert abs(float(period_low - zeno_high) - float(held)) < 1e-10
    assert abs(float(period_high - zeno_low) - float(held)) < 1e-10


def test_boxes_and_discs_of_the_data_contain_the_proved_ones(proofs: dict[str, Proof]) -> None:
    proof = proofs["curved_surface"]
    data = json.loads(json.dumps(proof.as_json()))
    for name, (middle, radius) in data["box"].items():
        one = proof.boxes[0].coordinates[name]
        assert Fraction(repr(middle)) - Fraction(repr(radius)) <= one.low
        assert Fraction(repr(middle)) + Fraction(repr(radius)) >= one.high
    assert proof.bounds is not None
    for (re_, im, radius), disc in zip(data["multipliers"], proof.bounds.multipliers, strict=True):
        off = abs(Fraction(repr(re_)) - Fraction(disc.centre.real))
        off += abs(Fraction(repr(im)) - Fraction(disc.centre.imag))
        assert Fraction(repr(radius)) >= Fraction(disc.radius) + off
    assert Fraction(repr(data["norm"])) >= Fraction(proof.boxes[-1].norm)
    for shown, box in zip(data["boxes"], proof.boxes, strict=True):
        assert Fraction(repr(shown["norm"])) >= Fraction(box.norm)


@pytest.mark.slow
def test_a_tiny_box_is_printed_with_the_orbit_in_it() -> None:
    # Ten digits of the middle would leave the orbit outside.
    proof = zo.prove(shot_orbit("curved_surface"), radius=1e-13)
    assert proof.bounds is not None
    for name, one in proof.boxes[0].coordinates.items():
        orbit = proof.bounds.start_state[name]
        low, high = read(one.text)
        assert low <= orbit.low <= orbit.high <= high
        assert high - low < 1e-10


def _words(text: str) -> str:
    """Return a text with `N` for numbers and no emphasis."""
    text = re.sub(r"\*|\$|\n", lambda found: " " if found[0] == "\n" else "", text)
    text = re.sub(r"box (\d)", lambda found: f"box {'1' if found[1] == '1' else 'N'}", text)
    text = re.sub(r"(?<![\w.])\d+(\.\d+)?(e-?\d+)?(?=[\s.])(?<!box 1)", "N", text)
    return re.sub(r"\s+", " ", text)


@pytest.mark.slow
def test_each_printed_statement_stands_in_the_document(proofs: dict[str, Proof]) -> None:
    page = _words((ROOT / "docs" / "proof.md").read_text(encoding="utf-8"))
    plastic = zo.prove(
        zo.find_orbit_by_shooting("vibrating_table", parameters={"restitution": 0.0}).unwrap()
    )
    problem = hard_to_prove.double_well()
    unstable = zo.prove(zo.find_orbit_by_shooting(problem).unwrap(), problem=problem)
    by_inclusion = _stable_by_inclusion_alone(proofs["curved_surface"])
    seen: set[str] = set()
    for proof in (*proofs.values(), plastic, unstable, by_inclusion):
        for statement in proof.statements():
            number, _, words = statement.partition(" ")
            assert number in {"(1)", "(2)", "(3)", "(4)", "(5)"}
            for sentence in re.split(r"(?<=\.) ", words):
                told = _words(sentence)
                seen.add(told)
                assert told in page, told
    assert len(seen) >= 11


def _stable_by_inclusion_alone(proof: Proof) -> Proof:
    """Return a proof whose first box is contracted and whose basis gives no norm below 1."""
    assert proof.bounds is not None
    first = replace(proof.boxes[0], included=True)
    bounds = replace(proof.bounds, norm=1.5)
    return replace(proof, boxes=(first, *proof.boxes[1:]), bounds=bounds, stable=True)


def test_an_inclusion_gives_one_orbit_and_stability_without_a_norm_below_one(
    proofs: dict[str, Proof],
) -> None:
    told = _stable_by_inclusion_alone(proofs["curved_surface"]).statements()
    assert "(4) Exactly one periodic orbit passes through box 1." in told
    (stable,) = (one for one in told if one.startswith("(5)"))
    assert stable.endswith("is exponentially stable: P contracts box 1.")


def _shrinks(proof: Proof) -> bool:
    """Return whether the derivatives in the certificate contract box 1 in the norm of its radii."""
    part, places = proof.certificate["passes"][0], proof.certificate["section"]["places"]
    radii = [exact(text) for text in part["box"]["radius"]]
    last = part["records"][-1]["set"]

    def bound(i: int, j: int) -> Fraction:
        rest = zip(last["Q"][i], last["R"], strict=True)
        spread = sum((abs(exact(q)) * exact(row[j]) for q, row in rest), Fraction(0))
        return abs(exact(last["C"][i][j])) + spread

    return all(
        sum((bound(i, j) * r for j, r in enumerate(radii)), Fraction(0)) < own
        for i, own in zip(places, radii, strict=True)
    )


@pytest.mark.slow
def test_a_box_that_is_mapped_into_its_interior_is_contracted_and_no_other_is(
    proofs: dict[str, Proof],
) -> None:
    torque = zo.prove(shot_orbit("torque_pendulum"))
    assert torque.inside
    assert _shrinks(torque)
    assert not proofs["curved_surface"].inside
    assert not _shrinks(proofs["curved_surface"])


def test_a_fixed_point_is_not_called_the_only_periodic_orbit(proofs: dict[str, Proof]) -> None:
    # The multipliers of the curved surface turn: no box along its coordinates maps into itself.
    surface = "\n".join(proofs["curved_surface"].lines())
    assert "P has exactly one fixed point in box 1." in surface
    assert "periodic orbit passes" not in surface
    assert "into its interior" not in surface
    # No number is missing without a word.
    assert "Statement (4), about a single periodic orbit, is not proved" in surface
    valve = "\n".join(proofs["motor_valve"].lines())
    assert "Exactly one periodic orbit passes through box 1." in valve
    assert "Statement (4)" not in valve


def test_stability_names_the_box_on_which_it_is_proved(proofs: dict[str, Proof]) -> None:
    proof = proofs["curved_surface"]
    assert len(proof.boxes) == 2
    (told,) = (one for one in proof.statements() if one.startswith("(5)"))
    assert "on box 2" in told
    norm = Fraction(told.rpartition(" ")[2].removesuffix("."))
    assert Fraction(proof.boxes[1].norm) <= norm < 1
    # The inner box lies in the outer one.
    for name, inner in proof.boxes[1].coordinates.items():
        outer = proof.boxes[0].coordinates[name]
        assert outer.low < inner.low <= inner.high < outer.high


@pytest.mark.slow
def test_stability_is_that_of_the_fixed_point_of_the_return_map_in_every_text(
    proofs: dict[str, Proof],
) -> None:
    # Of executions that start near the orbit off the section nothing is proved.
    proof = proofs["curved_surface"]
    verdict = check_proof(dict(proof.certificate))
    data = json.dumps([proof.as_json()["statements"], verdict.as_json()["statement"]])
    told = [proof.verdict(), *proof.lines(), *verdict.lines(), *data.split(". ")]
    about_stability = [line for line in told if "stable" in line]
    assert len(about_stability) >= 4
    for line in about_stability:
        assert "fixed point" in line
        assert "orbit is" not in line


def test_a_claim_of_a_certificate_is_about_the_orbit_of_its_first_box(
    proofs: dict[str, Proof],
) -> None:
    for proof in proofs.values():
        claims = proof.certificate["claims"]
        by_pass = [claim["pass"] for claim in claims if claim["name"] == "exists"]
        assert sorted(set(by_pass)) == list(range(len(proof.certificate["passes"])))
        assert [claim["pass"] for claim in claims if claim["name"] == "unique"] == [0]


def test_parameters_that_vary_are_named_with_those_that_do_not() -> None:
    orbit = shot_orbit("vibrating_table")
    # Two digits of this radius, rounded up, would be a range that is not proved.
    radius = 1.2345e-9
    proof = zo.prove(orbit, interval={"A": radius})
    told = "\n".join(proof.lines())
    (line,) = (line for line in told.splitlines() if line.startswith("The statements hold"))
    middle, _, printed = re.findall(r"A = (.*?), with", line)[0].partition(" +- ")
    proved = proof.certificate["parameters"]["A"], proof.certificate["over"]["A"]
    assert [Fraction(float(middle)), Fraction(float(printed))] == [exact(one) for one in proved]
    assert (float(middle), float(printed)) == (0.015, radius)
    assert "the doubles next to their decimals" in told
    assert "all other values held fixed" in line
    assert "derived" not in told


def test_multipliers_are_printed_as_lying_in_a_union_of_discs(proofs: dict[str, Proof]) -> None:
    page = proofs["curved_surface"].lines()
    assert proofs["curved_surface"].bounds is not None
    place = next(k for k, line in enumerate(page) if "union of the discs" in line)
    discs = [one.text for one in proofs["curved_surface"].bounds.multipliers]
    assert [line.split(maxsplit=1)[1] for line in page[place + 1 : place + 3]] == discs
    assert not any("disc" in line for line in proofs["motor_valve"].lines())


@pytest.mark.weekly
@pytest.mark.slow
def test_calibrated_parameters_are_named_as_held_fixed() -> None:
    orbit = shot_orbit("motor_pendulum")
    proof = zo.prove(orbit, interval={"m2": 1e-11})
    assert proof.proved, proof.verdict()
    # The back-EMF constant is the torque constant by default.
    assert set(proof.held) == {"J_rotor", "K_torque", "K_emf"}
    held = "Held fixed, though derived by default: J_rotor, K_torque, K_emf."
    assert held in proof.lines()


def test_bounds_are_rounded_up_in_every_double(proofs: dict[str, Proof]) -> None:
    random = np.random.default_rng(0)
    proof = proofs["forced_oscillator"]
    assert proof.bounds is not None
    period = proof.bounds.period
    assert Fraction(period.width) >= period.high - period.low
    for value in random.uniform(0.0, 10.0, 100).tolist():
        outside = max(period.low - Fraction(value), Fraction(value) - period.high)
        assert math.isclose(period.misses(value), float(max(outside, 0)), rel_tol=1e-15)
