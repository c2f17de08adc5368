"""Sets of initial states: proved by polynomials, confirmed by simulations, refused if changed."""

from __future__ import annotations

import copy
import json
import math
import random
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import zeno_orbits as zo
from tests.support.certificates import mutants
from tests.support.orbits import shot_orbit
from zeno_orbits.cli import main
from zeno_orbits.errors import InputError
from zeno_orbits.orbits import Orbit
from zeno_orbits.proof import basin as searched
from zeno_orbits.proof import check_proof
from zeno_orbits.proof.checker import basin as judged
from zeno_orbits.proof.checker import certificate as first_box
from zeno_orbits.report.terminal import print_basin

pytestmark = pytest.mark.slow

Certificate = dict[str, Any]


@pytest.fixture(scope="module")
def orbit() -> Orbit:
    return shot_orbit("solenoid")


@pytest.fixture(scope="module")
def proof(orbit: Orbit) -> zo.Proof:
    return zo.prove(orbit, basin=True)


@pytest.fixture(scope="module")
def certificate(proof: zo.Proof) -> Certificate:
    return json.loads(json.dumps(proof.certificate))


@pytest.fixture(scope="module")
def short(certificate: Certificate) -> Certificate:
    """Return a certificate of one box and its sets, which claims existence alone."""
    claims = [one for one in certificate["claims"] if one["name"] == "exists" and one["pass"] == 0]
    return certificate | {"passes": certificate["passes"][:1], "claims": claims}


def test_an_orbit_whose_section_is_a_single_point_is_proved_without_a_set(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "orbit.json"
    zo.write_orbit(shot_orbit("forced_oscillator"), path)
    assert main(["prove", str(path), "--basin"]) == 0
    told = capsys.readouterr().out
    assert "No set of initial states is proved beyond box 1: the section is a single point." in told


@pytest.fixture
def remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Prove no record twice, and none after one that fails: a change concerns few of them."""
    for module, name in ((judged, "_failures"), (first_box, "_proved")):
        monkeypatch.setattr(module, name, _remembered(getattr(module, name)))
        monkeypatch.setattr(module, "_CHUNK", 10**6)


def _remembered(prove: Callable[..., list[Any]]) -> Callable[..., list[Any]]:
    known = dict[str, Any]()

    def proved(given: Any, about: Any, tasks: Sequence[Any]) -> list[Any]:
        system = getattr(given, "first", given)
        numbers = repr((system.constants, system.unit, system.stop, about))
        keys = [numbers + repr(task) for task in tasks]
        new = [k for k, key in enumerate(keys) if key not in known]
        for k, one in zip(new, prove(given, about, [tasks[k] for k in new]), strict=True):
            known[keys[k]] = one
        return [known[key] for key in keys]

    return proved


def test_a_set_is_at_least_one_percent_of_the_sampled_ball_and_attracts(
    orbit: Orbit, proof: zo.Proof, certificate: Certificate
) -> None:
    ball = zo.recovery(orbit)
    assert proof.attracted
    for name, half in proof.initial_states.items():
        assert 0.01 * ball.extents[name] < half < ball.extents[name]
    verdict = check_proof(certificate)
    assert verdict.ok
    for name, (middle, radius) in verdict.theorem.basin.items():
        assert proof.basin[name].low == middle - radius
        assert proof.basin[name].high == middle + radius
    assert "Every execution from the set converges to the periodic orbit." in verdict.lines()


@pytest.mark.weekly
def test_a_set_that_the_checker_refuses_is_followed_by_smaller_ones(
    orbit: Orbit, proof: zo.Proof, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = list[int]()

    def stern(data: Any, problem: Any) -> Any:
        verdict = check_proof(data, problem)
        seen.append(len(data["basin"]))
        if len(seen) > 1:
            return verdict
        claims = [one._replace(ok=one.ok and one.name != "basin") for one in verdict.claims]
        return replace(verdict, claims=tuple(claims))

    monkeypatch.setattr("zeno_orbits.proof.prover.check_proof", stern)
    smaller = zo.prove(orbit, basin=True)
    assert len(seen) == 2
    assert smaller.no_basin == ""
    assert check_proof(smaller.certificate).ok
    for name, half in smaller.initial_states.items():
        assert 0.3 * proof.initial_states[name] < half < 0.6 * proof.initial_states[name]


def test_a_printed_set_excludes_the_release_at_the_opposite_current(
    proof: zo.Proof, certificate: Certificate, capsys: pytest.CaptureFixture[str]
) -> None:
    # A release needs current^2 = 2 push / (L0 slope): two sheets over the same sines.
    current = math.sqrt(2 * 4.0 / (0.5 * 500.0))
    assert proof.basin_box is not None
    verdict = check_proof(certificate)
    told = [proof.basin_box.lying(), proof.basin_box.contained(), verdict.theorem.basin_others]
    told.append(proof.as_json()["basin_others"])
    for texts in told:
        middle, radius = map(float, texts["current"].split(" +- "))
        assert abs(current - middle) <= radius + 1e-15
        assert abs(-current - middle) > 0.3
        assert set(texts) >= {"current", "cosine"}
    page = "\n".join(proof.lines())
    (line,) = (one for one in page.splitlines() if one.startswith("The set of initial states con"))
    assert f"current = {proof.basin_box.contained()['current']}" in line
    half = Fraction(re.findall(r"sine = \S+ \+- ([^,]+)", line)[0])
    # The table repeats the interval of this line, whose half-width is not rounded up.
    one = proof.basin["sine"]
    assert half <= (one.high - one.low) / 2
    assert Fraction(repr(proof.initial_states["sine"])) <= (one.high - one.low) / 2
    print_basin(proof, zo.recovery(shot_orbit("solenoid")))
    assert proof.basin_box.contained()["sine"] in capsys.readouterr().out


@pytest.mark.weekly
def test_a_plastic_stop_has_a_set_of_initial_states() -> None:
    plastic = zo.find_orbit_by_shooting("solenoid", parameters={"restitution": 0.0}).unwrap()
    proof = zo.prove(plastic, basin=True)
    assert proof.no_basin == ""
    assert proof.attracted
    (half,) = proof.initial_states.values()
    # The whole printed set returns into itself: simulations of its ends.
    middle = plastic.start_state["sine"]
    current = plastic.start_state["current"]
    for sine in (middle - half, middle + half):
        start = {"current": current, "sine": sine, "cosine": -math.sqrt(1 - sine**2)}
        run = zo.simulate("solenoid", start=start, parameters={"restitution": 0.0}, until=0.108)
        (end,) = [one.state for one in run.releases if one.time > 0.05]
        assert abs(end[list(plastic.start_state).index("sine")] - middle) < half


def test_a_search_for_a_set_without_a_result_states_the_reason(
    orbit: Orbit, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A box that fills the largest trial set leaves nothing to search.
    monkeypatch.setattr(searched, "_LARGEST", 1e-9)
    proof = zo.prove(orbit, basin=True)
    assert not proof.basin
    assert proof.as_json()["no_basin"] == proof.no_basin != ""
    (line,) = (one for one in proof.lines() if one.startswith("No set of initial states is"))
    assert "box 1 is already larger than the largest trial set" in line


def test_simulated_returns_lie_within_the_proved_remainder_of_the_polynomials(
    orbit: Orbit, certificate: Certificate
) -> None:
    first, last = certificate["basin"][0], certificate["basin"][0]["records"][-1]["set"]
    ((middle, half),) = _intervals(first["box"])
    (place,) = certificate["section"]["places"]
    frame, r = last["Q"][place], last["r"]
    remainder = sum(abs(_value(x)) * _value(size) for x, size in zip(frame, r, strict=True))
    for share in (-1.0, -0.5, 0.3, 1.0):
        rows = first["start"]["p"]
        start = {name: _at(row, share) for name, row in zip(orbit.start_state, rows, strict=True)}
        run = zo.simulate("solenoid", start=start, gains=orbit.gains, until=1.02 * orbit.period)
        (end,) = [one.state for one in run.releases if one.time > 0.5 * orbit.period]
        assert abs(end[place] - middle) < half
        assert abs(end[place] - _at(last["p"][place], share)) < remainder


def _at(row: Sequence[str], s: float) -> float:
    """Return a polynomial of one variable."""
    return sum(float(_value(c)) * s**k for k, c in enumerate(row))


@pytest.mark.usefixtures("remembered")
def test_none_of_40_changed_sets_is_accepted(short: Certificate) -> None:
    assert check_proof(short).ok
    chance = random.Random(5)
    for number in range(40):
        mutant = copy.deepcopy(short)
        _falsify(mutant["basin"], chance, number)
        assert not _accepted(mutant), number


@pytest.mark.weekly
@pytest.mark.usefixtures("remembered")
def test_of_40_random_changes_those_accepted_leave_the_set_as_it_is(
    short: Certificate,
) -> None:
    assert check_proof(short).ok
    accepted = 0
    for mutant in mutants(short, 40, 7, "basin"):
        if mutant != short and _accepted(mutant):
            accepted += 1
            old, new = (_intervals(one["basin"][0]["box"]) for one in (short, mutant))
            for (a, r), (b, q) in zip(old, new, strict=True):
                assert abs(a - b) + q <= r * (1 + Fraction(1, 50))
    # Last digits of a set may change within its slack.
    assert accepted < 24


def _accepted(mutant: Certificate) -> bool:
    try:
        return check_proof(mutant).ok
    except InputError:
        return False


def _falsify(sets: list[Any], chance: random.Random, number: int) -> None:
    """Change a number of a set by far more than its slack, or a record."""
    one = chance.choice(sets)
    records = one["records"]
    k = chance.randrange(1, len(records))
    moving = [record for record in records if record["kind"] in ("step", "cross")]
    record = chance.choice(moving)
    kind = number % 10
    if kind == 0:
        sets[0]["box"]["radius"] = [_scaled(x, 8) for x in sets[0]["box"]["radius"]]
    elif kind == 1:
        record["set"]["r"] = [_scaled(x, Fraction(1, 2)) for x in record["set"]["r"]]
    elif kind == 2:
        row = record["set"]["p"][chance.choice(_moved(record))]
        row[1] = _scaled(row[1], Fraction(101, 100))
    elif kind == 3:
        del records[k]
    elif kind == 4:
        record["time"][0] = _scaled(record["time"][0], Fraction(99, 100))
    elif kind == 5:
        cross = chance.choice([one for one in records if one["kind"] == "cross"])
        cross["spare"] = _scaled(cross["spare"], Fraction(1, 64))
    elif kind == 6:
        record["h"] = _scaled(record["h"], Fraction(1, 2))
    elif kind == 7:
        one["start"]["p"][-1][0] = _scaled(one["start"]["p"][-1][0], Fraction(101, 100))
    elif kind == 8:
        records.insert(k, copy.deepcopy(records[k]))
    else:
        tail = next(one for one in records if one["kind"] == "tail")
        tail["speed"] = _scaled(tail["speed"], Fraction(1, 2**30))


def _moved(record: Mapping[str, Any]) -> list[int]:
    """Return the states whose polynomials have a term that matters."""
    rows = [(abs(_value(row[1])), k) for k, row in enumerate(record["set"]["p"])]
    return [max(rows)[1]]


def _intervals(box: Mapping[str, Any]) -> list[tuple[Fraction, Fraction]]:
    pairs = zip(box["centre"], box["radius"], strict=True)
    return [(_value(centre), _value(radius)) for centre, radius in pairs]


def _value(text: str) -> Fraction:
    mantissa, exponent = text.replace("0x", "").split("p")
    return int(mantissa, 16) * Fraction(2) ** int(exponent)


def _scaled(text: str, factor: Fraction | int) -> str:
    """Return a number of a certificate times a factor, rounded to a multiple of 2^-200."""
    units = round(_value(text) * factor * 2**200)
    return f"{'-' if units < 0 else ''}0x{abs(units):x}p-200"


# Convergence, with an own integration of the contactor at the bundled values.


def _free(_: float, y: Any) -> list[float]:
    x, v, i, c, s = y
    wide = 1 + 500.0 * x
    force = 4.0 - 2000.0 * x - 4.0 * v - 0.5 * 500.0 * i**2 / 2 / wide**2
    swept = -0.5 * 500.0 / wide**2 * v
    current = (5.0 + 5.0 * c - 20.0 * i - swept * i) * wide / 0.5
    return [v, force / 0.05, current, -60.0 * s, 60.0 * c]


def _held(_: float, y: Any) -> list[float]:
    _, _, i, c, s = y
    return [0.0, 0.0, (5.0 + 5.0 * c - 20.0 * i) / 0.5, -60.0 * s, 60.0 * c]


def _turn(sine: float, e: float = 0.3) -> tuple[float, float, Any]:
    """Return the duration of a turn from a release, its next sine, and the states on the way."""
    current = math.sqrt(2 * 4.0 / (0.5 * 500.0))

    def hit(_: float, y: Any) -> float:
        return y[0]

    def freed(_: float, y: Any) -> float:
        return y[2] - current

    for event in (hit, freed):
        event.terminal, event.direction = True, -1  # type: ignore[attr-defined]
    options: dict[str, Any] = {"rtol": 1e-11, "atol": 1e-13, "method": "DOP853", "max_step": 1e-3}
    y: Any = [0.0, 0.0, current, -math.sqrt(1 - sine**2), sine]
    states, time, step = [], 0.0, 1e-3
    while True:
        run = solve_ivp(_free, (0, step), y, **options)
        y, time = run.y[:, -1], time + step
        states.append(run.y)
        run = solve_ivp(_free, (0, 1), y, events=hit, **options)
        states.append(run.y)
        y, time = run.y_events[0][0].copy(), time + run.t_events[0][0]
        y[:2] = 0.0, -e * y[1]
        fall = -_free(0, y)[1]
        assert fall > 0
        step = 0.6 * y[1] / fall
        if step < 1e-8:
            break
    y[1] = 0.0
    run = solve_ivp(_held, (0, 1), y, events=freed, **options)
    states.append(run.y)
    return time + run.t_events[0][0], run.y_events[0][0][4], np.concatenate(states, axis=1)


def test_executions_from_a_printed_set_converge_as_the_document_defines(proof: zo.Proof) -> None:
    assert proof.basin_box is not None
    middle, _, half = proof.basin_box.contained()["sine"].partition(" +- ")
    known = float(proof.as_json()["start_state"]["sine"].partition(" +- ")[0])
    _, _, orbit = _turn(known)
    sizes = np.ptp(orbit, axis=1)[:, None]
    for side in (-1.0, 0.3, 1.0):
        sine, distances, times = float(middle) + side * float(half), list[float](), list[float]()
        for _ in range(3):
            time, sine, states = _turn(sine)
            assert abs(sine - float(middle)) < float(half)
            off = [np.min(np.max(np.abs(orbit - x[:, None]) / sizes, axis=0)) for x in states.T]
            distances.append(max(off))
            times.append(abs(time - math.tau / 60.0))
        # The multiplier is 0.025: two more turns bring the motion to the orbit's own sampling.
        assert times[2] < 1e-2 * times[0]
        assert distances[2] < 0.05 * distances[0] + 5e-3
