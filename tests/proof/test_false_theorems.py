"""False theorems: certificates that are sound but for one thing. None is accepted, none printed."""

from __future__ import annotations

import copy
import json
import math
import time
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple, cast

import casadi as ca
import pytest

from tests.support.cases import fast
from tests.support.certificates import (
    BITS,
    digest_of,
    forced_oscillator,
    impact_oscillator,
    text_of,
)
from tests.support.commands import MISUSE, ask
from tests.support.double_well import (
    DOUBLE,
    HALF_AS_FAST,
    WIDTH,
    basis_at,
    certificate_of,
    pass_around,
    problem_of,
)
from zeno_orbits.errors import InputError
from zeno_orbits.model import CompletedSystem, ImpactLaw, Problem, load_problem
from zeno_orbits.proof import ProofVerdict, check_proof

Certificate = dict[str, Any]
MOST = 2.0
"""Processor time in which what is no certificate is refused [s]."""


@pytest.fixture(scope="module")
def twice() -> Certificate:
    """Return a certificate of the same orbit, returning after two turns."""
    return impact_oscillator(load_problem("impact_oscillator"), turns=2)


@pytest.fixture(scope="module")
def beside() -> Certificate:
    """Return a certificate of a box beside the orbit, in that of the orbit."""
    return impact_oscillator(load_problem("impact_oscillator"), radius=1e-10, beside=5e-10)


@pytest.fixture(scope="module")
def within() -> Certificate:
    """Return a certificate of a smaller box around the same orbit."""
    return impact_oscillator(load_problem("impact_oscillator"), radius=1e-10)


def _verdict(certificate: Certificate, problem: Problem | None = None) -> ProofVerdict | str:
    """Return the verdict, or the refusal."""
    try:
        return check_proof(certificate, problem)
    except InputError as error:
        return str(error)


def _refusal(certificate: Certificate, problem: Problem | None = None) -> str:
    """Return the one line by which a certificate is refused; it prints no theorem."""
    verdict = _verdict(certificate, problem)
    if not isinstance(verdict, str):
        assert not verdict.ok
        assert verdict.conclusions() == []
        assert not any("Proved: " in line or "exactly one" in line for line in verdict.lines())
        verdict = verdict.verdict()
    assert "\n" not in verdict
    return verdict


def _with_pass(first: Certificate, second: Certificate) -> Certificate:
    """Return a certificate of two passes, all claims but that of uniqueness about the second."""
    both = copy.deepcopy(first)
    box, known = second["passes"][0]["box"], both["passes"][0]["box"]["others"]
    both["passes"].append({**copy.deepcopy(second["passes"][0]), "box": {**box, "others": known}})
    both["claims"] = [
        {**copy.deepcopy(claim), "pass": int(claim["name"] != "unique")}
        for claim in second["claims"]
    ]
    return both


# One certificate, one orbit.


@pytest.mark.slow
def test_a_smaller_box_around_the_same_orbit_gives_its_digits(
    impact: Certificate, within: Certificate
) -> None:
    verdict = check_proof(_with_pass(impact, within))
    assert verdict.ok, verdict.lines()
    assert "The return map has exactly one fixed point in box 1." in verdict.lines()


@pytest.mark.slow
def test_a_second_pass_of_another_return_map_is_refused(
    impact: Certificate, twice: Certificate
) -> None:
    assert check_proof(twice).ok
    assert "different return maps" in _refusal(_with_pass(impact, twice))


@pytest.mark.slow
def test_claims_about_a_box_without_the_fixed_point_are_refused(
    impact: Certificate, beside: Certificate
) -> None:
    assert "leaves the box" in _refusal(_with_pass(impact, beside))


@pytest.mark.slow
def test_a_first_box_without_the_fixed_point_lends_nothing_to_a_second(
    beside: Certificate,
) -> None:
    assert "more than one fixed point" in _refusal(_with_pass(beside, beside))


def test_a_second_box_beside_the_first_is_refused(impact: Certificate, beside: Certificate) -> None:
    assert "must lie in its first box" in _refusal(_with_pass(beside, impact))


def _exists(which: int) -> dict[str, Any]:
    return {"name": "exists", "pass": which, "by": "krawczyk"}


@pytest.fixture(scope="module")
def wells(zeno: Certificate) -> dict[str, Any]:
    """Return a box that holds two orbits, and one around each of them."""
    boxes = {"both": (WIDTH / 2, 3 * WIDTH / 4), "top": (0.0, WIDTH / 128)}
    boxes["rest"] = (WIDTH, WIDTH / 128)
    return {name: pass_around(zeno, *box) for name, box in boxes.items()}


@pytest.mark.slow
def test_each_orbit_of_a_double_well_is_proved_by_itself(
    zeno: Certificate, wells: dict[str, Any]
) -> None:
    problem = problem_of(DOUBLE)
    for name, kind, y in (("top", "repelling", 0.0), ("rest", "stable", WIDTH)):
        claims = [_exists(0), {"name": "unique", "pass": 0}]
        claims.append({"name": kind, "pass": 0, "basis": basis_at(y)})
        verdict = check_proof(certificate_of(zeno, [wells[name]], claims, problem), problem)
        assert verdict.ok, verdict.lines()


@pytest.mark.slow
def test_two_orbits_of_a_double_well_are_not_merged_into_one(
    zeno: Certificate, wells: dict[str, Any]
) -> None:
    problem = problem_of(DOUBLE)
    alone = certificate_of(zeno, [wells["both"]], [], problem)
    assert [one.ok for one in check_proof(alone, problem).claims] == [True]
    claims = [_exists(1), {"name": "unique", "pass": 1}]
    claims.append({"name": "stable", "pass": 2, "basis": basis_at(WIDTH)})
    passes = [wells["both"], wells["top"], wells["rest"]]
    refusal = _refusal(certificate_of(zeno, passes, claims, problem), problem)
    assert "more than one fixed point" in refusal


# The sentences.


@pytest.mark.slow
def test_contraction_of_the_box_into_itself_makes_the_orbit_the_only_one_through_it(
    impact: Certificate,
) -> None:
    assert "one periodic orbit passes through box 1" in " ".join(check_proof(impact).lines())
    # Inclusion in the mean value form implies contraction: no norm needs to be claimed.
    silent = copy.deepcopy(impact)
    silent["claims"] = [one for one in silent["claims"] if one["name"] != "stable"]
    assert "one periodic orbit passes through box 1" in " ".join(check_proof(silent).lines())


@pytest.mark.slow
def test_a_free_spring_of_half_the_frequency_leaves_one_fixed_point_and_many_orbits(
    zeno: Certificate,
) -> None:
    # Every other point of the box has twice the period.
    problem = problem_of(HALF_AS_FAST)
    once = pass_around(zeno, 0.0, 2.0**-20, HALF_AS_FAST)
    ones = [[text_of(1), text_of(0)], [text_of(0), text_of(1)]]
    basis = {"re": ones, "im": [[text_of(0)] * 2] * 2}
    claims = [_exists(0), {"name": "unique", "pass": 0}]
    verdict = check_proof(certificate_of(zeno, [once], claims, problem), problem)
    told = " ".join(verdict.lines())
    assert verdict.ok, told
    assert "exactly one fixed point in box 1" in told
    assert "one periodic orbit" not in told
    for false in ({"name": "stable", "pass": 0, "basis": basis}, {**claims[0], "by": "inclusion"}):
        assert _refusal(certificate_of(zeno, [once], [*claims, false], problem), problem)


def test_a_verdict_states_all_that_the_theorem_depends_on(zeno_verdict: ProofVerdict) -> None:
    told = "\n".join(zeno_verdict.lines())
    for part in (
        "`forced_oscillator`",
        digest_of(load_problem("forced_oscillator")),
        "stop = -0.8",
        "restitution = 0.5",
        "the release",
        "a single point",
        "35 impacts proved one by one, 1 Zeno point, 1 release",
        "a Zeno periodic orbit",
        "period 6.283185",
    ):
        assert part in told
    plain = json.loads(json.dumps(zeno_verdict.as_json()))
    assert plain["kind"] == "Zeno periodic orbit"
    assert plain["parameters"]["stop"] == -0.8
    assert (plain["impacts_one_by_one"], plain["zeno_points"], plain["releases"]) == (35, 1, 1)


@pytest.mark.parametrize("record", [0, 7, -1])
@pytest.mark.parametrize("kind", fast(1, ["impact", "zeno"]))
def test_a_motion_that_is_refused_has_no_numbers_of_events(
    kind: str, record: int, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    false = copy.deepcopy(request.getfixturevalue(kind))
    false["passes"][0]["records"][record]["set"]["m"][1] = text_of(0.125)
    verdict = check_proof(false)
    assert not verdict.ok
    path = tmp_path / "proof.json"
    path.write_text(json.dumps(false))
    for told in ("\n".join(verdict.lines()), ask("prove", "--check", path).out):
        assert "In a period" not in told
        assert "0 impacts" not in told
    plain = verdict.as_json()
    assert not {"kind", "releases", "impacts_one_by_one", "zeno_points", "plastic"} & plain.keys()


def test_an_orbit_without_zeno_point_is_called_so(impact: Certificate) -> None:
    assert "periodic orbit without a Zeno point" in check_proof(impact).verdict()


def test_a_printed_box_is_the_proved_one_exactly(impact: Certificate) -> None:
    box = check_proof(impact).theorem.box
    given = impact["passes"][0]["box"]
    for (middle, radius), m, r in zip(box.values(), given["centre"], given["radius"], strict=True):
        assert (middle, radius) == (_value(m), _value(r))


def test_printed_intervals_contain_two_pi(zeno_verdict: ProofVerdict, impact: Certificate) -> None:
    # Fifty digits of 2 pi [DLMF 3.12.1]; the frequencies are 1.
    turn = Fraction("6.28318530717958647692528676655900576839433879875021")
    for verdict in (zeno_verdict, check_proof(impact)):
        text = next(claim.evidence for claim in verdict.claims if claim.name == "period")
        middle, radius = (Fraction(part) for part in text.split(" +- "))
        assert abs(turn - middle) <= radius


def _value(text: str) -> Fraction:
    mantissa, exponent = text.replace("0x", "").split("p")
    return Fraction(int(mantissa, 16)) * Fraction(2) ** int(exponent)


# A certificate is data.

EVIL = """
from pathlib import Path
Path(__file__).with_name("was here").touch()
"""


@pytest.mark.parametrize(
    "name",
    [
        "./evil.py",
        "evil.py",
        "{folder}/evil.py",
        "problems/forced_oscillator.py",
        "../forced_oscillator",
        "forced_oscillator.py",
        "forced_oscillator\n",
        "forced oscillator",
        "",
        "./evil.py@forced_oscillator",
        None,
        7,
        ["forced_oscillator"],
        {"name": "forced_oscillator"},
    ],
)
def test_a_name_in_a_certificate_runs_no_file(
    zeno: Certificate, name: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "evil.py").write_text(EVIL)
    monkeypatch.chdir(tmp_path)
    name = name.format(folder=tmp_path) if isinstance(name, str) else name
    refusal = _refusal({**zeno, "problem": name})
    if isinstance(name, str):
        assert "Unknown problem" in refusal
        assert "--problem FILE.py" in refusal
    else:
        assert "The certificate's `problem` must be a text" in refusal
    path = tmp_path / "proof.json"
    path.write_text(json.dumps({**zeno, "problem": name}))
    answer = ask("prove", "--check", path)
    assert answer.code == MISUSE
    assert len(answer.err.strip().splitlines()) == 1
    assert not (tmp_path / "was here").exists()


def test_a_problem_that_is_given_must_have_the_name_of_the_certificate(zeno: Certificate) -> None:
    oscillator = load_problem("forced_oscillator")
    other = replace(oscillator, name="another")
    refusal = _refusal(zeno, other)
    assert "must be the problem `forced_oscillator` of the certificate" in refusal
    assert "it is `another`" in refusal
    assert "the problem `another`" in _refusal({**zeno, "problem": "another"}, oscillator)


@pytest.mark.slow
def test_formulas_are_asked_for_once_and_their_digest_is_told(zeno: Certificate) -> None:
    calls = list[int]()
    oscillator = load_problem("forced_oscillator")

    def model(p: Any) -> CompletedSystem:
        calls.append(1)
        system = oscillator.model(p)
        return system if len(calls) == 1 else replace(system, free_flow=2 * system.free_flow)

    changing = replace(oscillator, model=model)
    verdict = check_proof(zeno, changing)
    assert verdict.ok
    assert len(calls) == 1
    assert verdict.theorem.digest == zeno["digest"]
    assert "other formulas" in _refusal(zeno, changing)


# Other formulas than those of a completed execution.

State = Callable[[CompletedSystem], CompletedSystem]


def _appended(system: CompletedSystem, rate: Any, row: Any) -> CompletedSystem:
    """Return a system with a state y more, a constraint on it, and its rate."""
    y = ca.SX.sym("y")
    return replace(
        system,
        state=ca.vertcat(system.state, y),
        free_flow=ca.vertcat(system.free_flow, rate),
        locked_flow=ca.vertcat(system.locked_flow, rate),
        impulse_direction=ca.vertcat(system.impulse_direction, 0),
        holonomic=ca.vertcat(system.holonomic, row(y)),
    )


def _drifts(exponent: int) -> State:
    return lambda system: _appended(system, ca.SX(2.0**exponent), lambda y: y)


def _clock_too_wide(system: CompletedSystem) -> CompletedSystem:
    flow = system.free_flow
    return replace(system, free_flow=ca.vertcat(flow[:3], flow[3] * (1 + 2.0**-50)))


def _clock_that_spirals(system: CompletedSystem) -> CompletedSystem:
    flow = system.free_flow + 2.0**-60 * ca.vertcat(0, 0, system.state[2:])
    return replace(system, free_flow=flow)


def _constraint_of_the_speed(system: CompletedSystem) -> CompletedSystem:
    # Kept by the flow alone: y' = a and the row speed - y vanishes until the mass strikes.
    return _appended(system, system.free_flow[1], lambda y: system.state[1] - y)


@pytest.mark.parametrize(
    "change",
    [
        *(_drifts(k) for k in (-60, -50, -40, -30, -1000)),
        _clock_too_wide,
        _clock_that_spirals,
        _constraint_of_the_speed,
    ],
)
def test_constraints_that_the_motion_does_not_keep_are_refused(
    zeno: Certificate, change: State
) -> None:
    refusal = _refusal(*_of_changed(zeno, change))
    assert "constraint" in refusal
    assert "kept" in refusal


def _of_changed(certificate: Certificate, change: State) -> tuple[Certificate, Problem]:
    """Return a certificate that names the digest of a problem with other formulas, and that."""
    known = load_problem(certificate["problem"])
    other = replace(known, model=lambda p: change(known.model(p)))
    return {**certificate, "digest": digest_of(other)}, other


def _velocity_that_is_none(system: CompletedSystem) -> CompletedSystem:
    flow = system.free_flow
    return replace(system, free_flow=ca.vertcat(flow[0] * (1 + 2.0**-50), flow[1:]))


def _gap_of_the_clock(system: CompletedSystem) -> CompletedSystem:
    return replace(system, gap=system.gap + 1e-12 * system.state[2])


def _impact_that_turns_the_clock(system: CompletedSystem) -> CompletedSystem:
    return replace(system, impulse_direction=system.impulse_direction + ca.SX([0, 0, 1e-9, 0]))


def _restitution_of_the_speed(system: CompletedSystem) -> CompletedSystem:
    e = system.restitution * (1 + 1e-12 * system.state[1])
    return replace(system, law=ImpactLaw(e))


class _Softer(NamedTuple):
    """A law of one number that is none of Newton's."""

    restitution: Any
    of_speed: Any = None

    @property
    def numbers(self) -> Any:
        return self.restitution

    def speed_after(self, approach_rate: Any) -> Any:
        return -self.restitution * approach_rate * (1 + 1e-9 * approach_rate)

    def rate_drop(self, approach_rate: Any) -> Any:
        return approach_rate - self.speed_after(approach_rate)


class _Inconsistent(_Softer):
    def speed_after(self, approach_rate: Any) -> Any:
        return -self.restitution * approach_rate

    def rate_drop(self, approach_rate: Any) -> Any:
        return (1 + self.restitution) * approach_rate * (1 + 2.0**-40)


class _Kinked(_Softer):
    def speed_after(self, approach_rate: Any) -> Any:
        return -self.restitution * ca.fabs(approach_rate)


class _AtTwiceTheSpeed(ImpactLaw):
    def speed_after(self, approach_rate: Any) -> Any:
        return -self.at(-2 * approach_rate) * approach_rate


def _of_speed(formula: Callable[[Any, Any], Any], kind: Any = ImpactLaw) -> State:
    """Return the change to a law of the impact speed ``v`` and the own restitution ``e``."""
    return lambda system: replace(
        system, law=kind(system.restitution, lambda v: formula(system.restitution, v))
    )


def _law(kind: Any) -> State:
    return lambda system: replace(system, law=cast("ImpactLaw", kind(system.restitution)))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (_velocity_that_is_none, "is not a state"),
        (_gap_of_the_clock, "the one coordinate of the gap"),
        (_impact_that_turns_the_clock, "is not kept at an impact"),
        (_restitution_of_the_speed, "restitution is not constant"),
        (_law(_Softer), "not Newton's law"),
        (_law(_Inconsistent), "not Newton's law"),
        (_law(_Kinked), "`fabs`"),
        (_of_speed(lambda e, v: e - v / 9, _AtTwiceTheSpeed), "not Newton's law"),
        (_of_speed(lambda e, v: ca.fmin(e, 1 / v)), "`fmin`"),
        (_of_speed(lambda e, v: e + 100 * v), "may not be between 0 and 1"),
        (_of_speed(lambda e, v: e - 100 * v), "may not be between 0 and 1"),
        (_of_speed(lambda e, v: e * (1 + 1e-9 * v)), "motion"),
    ],
)
def test_a_problem_of_another_kind_or_law_is_refused(
    zeno: Certificate, change: State, told: str
) -> None:
    assert told in _refusal(*_of_changed(zeno, change))


def _free(change: Callable[[Any], Any]) -> State:
    return lambda system: replace(
        system, free_flow=ca.vertcat(system.free_flow[0], change(system), system.free_flow[2:])
    )


@pytest.mark.slow
@pytest.mark.parametrize("factor", fast(1, [1 - 1e-9, -1.0]))
def test_a_certificate_of_another_machine_is_refused(zeno: Certificate, factor: float) -> None:
    assert "motion" in _refusal(
        *_of_changed(zeno, _free(lambda system: factor * system.free_flow[1]))
    )


ROUGH: dict[str, Callable[[Any], Any]] = {
    "fabs": ca.fabs,
    "floor": ca.floor,
    "ceil": ca.ceil,
    "sign": ca.sign,
    "fmax": lambda x: ca.fmax(x, 0),
    "fmin": lambda x: ca.fmin(x, 0),
    "lt": lambda x: ca.if_else(x < 0, x, 2 * x),
    "fmod": lambda x: ca.fmod(x, 2),
    "erf": ca.erf,
}


@pytest.mark.parametrize("name", ROUGH)
def test_a_formula_that_is_not_analytic_is_refused_by_its_name(
    zeno: Certificate, name: str
) -> None:
    rough = ROUGH[name]
    changed = _free(lambda system: system.free_flow[1] + rough(system.state[0]))
    refusal = _refusal(*_of_changed(zeno, changed))
    assert "analytic" in refusal
    assert "`" in refusal


def test_digests_tell_operations_apart() -> None:
    known = load_problem("forced_oscillator")
    digests = set[str]()
    for rough in ROUGH.values():
        change = _free(lambda system, f=rough: f(system.state[0]))
        digests.add(digest_of(replace(known, model=lambda p, c=change: c(known.model(p)))))
    assert len(digests) == len(ROUGH)


@pytest.mark.slow
def test_a_formula_that_is_not_used_may_be_of_any_kind(zeno: Certificate) -> None:
    rough = _of_changed(zeno, lambda s: replace(s, multiplier=ca.fabs(s.multiplier)))
    assert check_proof(*rough).ok


@pytest.mark.slow
@pytest.mark.parametrize("shift", [1e-8, -1e-8, 1e-12])
def test_a_release_where_only_the_problems_multiplier_vanishes_is_refused(shift: float) -> None:
    known = load_problem("forced_oscillator")
    moved = forced_oscillator(known, shift)
    certificate, other = _of_changed(
        moved, lambda s: replace(s, multiplier=s.multiplier - shift * s.normal_inertia)
    )
    assert "section" in _refusal(certificate, other)


@pytest.mark.slow
def test_a_proof_asks_neither_for_the_locked_flow_nor_for_the_length_of_the_impulse_direction(
    zeno: Certificate,
) -> None:
    # What is proved is the constrained flow that the checker makes of the free one.
    leaving = ca.SX([0, 1e-8, 0, 0])
    changed = _of_changed(
        zeno,
        lambda s: replace(
            s, locked_flow=s.locked_flow + leaving, impulse_direction=3 * s.impulse_direction
        ),
    )
    assert check_proof(*changed).ok


# Parameters.


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("restitution", 1.5),
        ("restitution", -0.5),
        ("m", -1.0),
        ("m", 0.0),
        ("omega", -1.0),
        ("omega", 0.0),
        ("c", -1.9),
        ("k", -1.0),
        ("A", -1.0),
    ],
)
def test_a_parameter_out_of_its_range_is_refused(
    zeno: Certificate, name: str, value: float
) -> None:
    false = copy.deepcopy(zeno)
    false["parameters"][name] = text_of(value)
    assert f"`{name}` must be inside its range" in _refusal(false)


def test_elastic_impacts_prove_no_zeno_orbit(zeno: Certificate) -> None:
    false = copy.deepcopy(zeno)
    false["parameters"]["restitution"] = text_of(1.0)
    assert "restitution must be 0, or between 0 and 1" in _refusal(false)


@pytest.mark.parametrize(
    ("name", "radius"), [("restitution", 0.6), ("m", 1.0), ("omega", 1.5), ("c", 2.0)]
)
def test_a_range_that_leaves_that_of_the_problem_is_refused(
    zeno: Certificate, name: str, radius: float
) -> None:
    false = {**zeno, "over": {name: text_of(radius)}}
    assert f"`{name}` must be inside its range" in _refusal(false)


def test_a_range_of_a_certificate_for_one_value_is_refused(zeno: Certificate) -> None:
    assert _refusal({**zeno, "over": {"c": text_of(1e-30)}})
    assert _refusal({**zeno, "over": {"c": "-0x1p-100"}})
    assert _refusal({**zeno, "over": {"beauty": text_of(1e-30)}})


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    fast(1, ("omega", "stop", "k", "A", "restitution", "m", "c")),
)
def test_the_orbit_of_another_value_of_a_parameter_is_refused(zeno: Certificate, name: str) -> None:
    false = copy.deepcopy(zeno)
    value = float(_value(zeno["parameters"][name]))
    false["parameters"][name] = text_of(math.nextafter(value * (1 + 1e-9), 9))
    assert _refusal(false)


# Exchange, rename, widen, other units, stale.


def _claim(c: Certificate, name: str) -> Any:
    return next(claim for claim in c["claims"] if claim["name"] == name)


def _scaled(data: Any, factor: int) -> Any:
    """Return numbers of a certificate in other units."""
    if isinstance(data, list):
        return [_scaled(one, factor) for one in cast("list[Any]", data)]
    return text_of(0) if not _value(data) else f"{_units(data) * factor:#x}p-{BITS}"


def _units(text: str) -> int:
    return int(_value(text) * 2**BITS)


def _millimetres(c: Certificate) -> None:
    for one in (c["passes"][0]["start"], *(r["set"] for r in c["passes"][0]["records"])):
        for part in ("m", "C", "r", "R"):
            one[part][:2] = _scaled(one[part][:2], 1000)


def _milliseconds(c: Certificate) -> None:
    claim = _claim(c, "period")
    claim["low"], claim["high"] = _scaled([claim["low"], claim["high"]], 1000)


def _exchanged(first: tuple[Any, ...], second: tuple[Any, ...]) -> Callable[[Certificate], None]:
    """Return what exchanges two places of a certificate."""

    def exchange(c: Certificate) -> None:
        (a, i), (b, j) = (_at(c, place) for place in (first, second))
        a[i], b[j] = b[j], a[i]

    return exchange


def _at(c: Any, place: tuple[Any, ...]) -> tuple[Any, Any]:
    for key in place[:-1]:
        c = c[key]
    return c, place[-1]


def _put(value: Any, *place: Any) -> Callable[[Certificate], None]:
    """Return what puts a value at a place of a certificate."""

    def put(c: Certificate) -> None:
        a, i = _at(c, place)
        a[i] = value

    return put


def _larger(factor: int, *place: Any) -> Callable[[Certificate], None]:
    def enlarge(c: Certificate) -> None:
        a, i = _at(c, place)
        a[i] = _scaled(a[i], factor)

    return enlarge


RECORDS, BOX = ("passes", 0, "records"), ("passes", 0, "box")
START = ("passes", 0, "start")
FALSE: dict[str, Callable[[Certificate], None]] = {
    "millimetres": _millimetres,
    "milliseconds": _milliseconds,
    "two records exchanged": _exchanged((*RECORDS, 2), (*RECORDS, 3)),
    "the sets of two records exchanged": _exchanged((*RECORDS, 2, "set"), (*RECORDS, 5, "set")),
    "the first and last sets exchanged": _exchanged(START, (*RECORDS, -1, "set")),
    "centres of two coordinates exchanged": _exchanged((*BOX, "centre", 0), (*BOX, "centre", 1)),
    "coordinates exchanged": _put([3, 1], "section", "places"),
    "other coordinates": _put([1, 2], "section", "places"),
    "one coordinate": _put([1], "section", "places"),
    "a section of releases": _put(["gap", "gap_rate", "multiplier"], "section", "conditions"),
    "a section of rest": _put(["gap", "gap_rate"], "section", "conditions"),
    "a section anywhere": _put(["gap_rate"], "section", "conditions"),
    "a section twice": _put(["gap", "gap"], "section", "conditions"),
    "a wider box": _larger(1000, *BOX, "radius"),
    "a box of no width": _larger(0, *BOX, "radius"),
    "a step for a crossing": _put("step", *RECORDS, 12, "kind"),
    "a crossing for a step": _put("cross", *RECORDS, 3, "kind"),
    "a tail for an impact": _put("tail", *RECORDS, 13, "kind"),
    "an impact for a step": _put("impact", *RECORDS, 3, "kind"),
    "a record of another kind": _put("jump", *RECORDS, 3, "kind"),
    "a longer step": _larger(2, *RECORDS, 3, "h"),
    "a step back": _larger(-1, *RECORDS, 3, "h"),
    "bounds exchanged": _exchanged(("claims", 5, "low"), ("claims", 5, "high")),
    "a period twice as long": _larger(2, "claims", 5, "low"),
    "a Zeno time for a period": _put("zeno_time", "claims", 5, "name"),
    "a basis of other parts": _exchanged(
        ("claims", 3, "basis", "re"), ("claims", 3, "basis", "im")
    ),
    "a repelling orbit": _put("repelling", "claims", 3, "name"),
    "discs of no radius": _put("0x0p+0", "claims", 4, "discs", 0, 2),
    "a second place for others": _larger(2, *BOX, "others", "centre"),
    "others on the other side": _larger(-1, *BOX, "others", "centre"),
    "masses and springs exchanged": _exchanged(("parameters", "m"), ("parameters", "c")),
    "another problem": _put("vibrating_table", "problem"),
    "a carried gap": _put(None, "gap_row"),
    "fewer bits": _put(64, "bits"),
    "an old format": _put(1, "format"),
    "another kind of file": _put("zeno_orbits orbit", "kind"),
    "no claim of existence": lambda c: c.update(claims=c["claims"][2:]),
    "existence by trust": _put("trust", "claims", 0, "by"),
    "the pass before the first": _put(-1, "claims", 0, "pass"),
    "a pass that is a truth value": _put(True, "claims", 0, "pass"),
    "a period turned into numbers": _put(6.283185307179586, "claims", 5, "low"),
    "a name twice": lambda c: c["parameters"].update(mass=text_of(1)),
}


@pytest.mark.parametrize("name", fast(14, FALSE))
def test_a_certificate_that_is_changed_in_one_thing_is_refused(
    impact: Certificate, name: str
) -> None:
    false = copy.deepcopy(impact)
    FALSE[name](false)
    assert false != impact
    assert _refusal(false)


# Ends.


def _nested(depth: int) -> Any:
    data: Any = "0x0p+0"
    for _ in range(depth):
        data = [data]
    return data


ENDLESS: dict[str, Callable[[Certificate], None]] = {
    "a step of 2^99999": _put("0x1p+99999", *RECORDS, 0, "h"),
    "a step of 2^9999": _put("0x1p+9999", *RECORDS, 0, "h"),
    "a step of 2^400": _put("0x1p+400", *RECORDS, 0, "h"),
    "a step of 2^60": _put("0x1p+60", *RECORDS, 0, "h"),
    "a step of many digits": _put("0x" + "f" * 10**6 + "p-3999999", *RECORDS, 0, "h"),
    "an exponent of many digits": _put("0x1p-" + "9" * 10**5, *RECORDS, 0, "h"),
    "a state of 2^500": _put("0x1p+500", *START, "m", 1),
    "a radius of 2^500": _put("0x1p+500", *START, "r", 1),
    "a restitution of 2^300": _put("0x1p+300", "parameters", "restitution"),
    "a frequency of 2^500": _put("0x1p+500", "parameters", "omega"),
    "a frequency of 2^60": _put("0x1p+60", "parameters", "omega"),
    "orders of a million": _put([10**6, 10**6], *RECORDS, 0, "orders"),
    "orders of 10^1000": _put([10**1000, 20], *RECORDS, 0, "orders"),
    "orders below zero": _put([-1, -1], *RECORDS, 0, "orders"),
    "a billion bits": _put(10**9, "bits"),
    "bits that are true": _put(True, "bits"),
    "a list in a list in a list": _put(_nested(900), *START, "m"),
    "passes without end": lambda c: c.update(passes=c["passes"] * 1000),
    "records without end": lambda c: c["passes"][0].update(records=[1] * 10**6),
    "claims without end": lambda c: c.update(claims=c["claims"] * 10**5),
    "claims that are none": lambda c: c.update(claims=[1, 2, 3]),
    "no records": _put([], *RECORDS),
    "infinity": _put(math.inf, *START, "m", 1),
    "no number": _put(math.nan, *START, "m", 1),
    "an empty text": _put("", *START, "m", 1),
    "a number in other digits": _put("0x١p+0", *START, "m", 1),
    "a number with a space": _put(" 0x1p+0", *START, "m", 1),
    "a number with a line": _put("0x1p+0\n", *START, "m", 1),
}


@pytest.mark.parametrize("name", fast(10, ENDLESS))
def test_what_has_no_end_is_refused_at_once(impact: Certificate, name: str) -> None:
    false = copy.deepcopy(impact)
    ENDLESS[name](false)
    started = time.process_time()
    assert _refusal(false)
    assert time.process_time() - started < MOST


def test_a_file_that_is_nested_without_end_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "proof.json"
    path.write_text("[" * 10**6)
    answer = ask("prove", "--check", path)
    assert answer.code == MISUSE
    assert len(answer.err.strip().splitlines()) == 1
