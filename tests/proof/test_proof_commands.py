"""Certificates at the command line: only one that is accepted makes an orbit a proved one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import zeno_orbits as zo
from tests.support.certificates import impact_oscillator
from tests.support.commands import MISUSE, NO, YES, ask
from zeno_orbits.errors import InputError
from zeno_orbits.proof import check_proof_of


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the orbit of the forced oscillator and its certificate."""
    folder = tmp_path_factory.mktemp("proofs")
    orbit = zo.find_orbit("forced_oscillator").unwrap()
    zo.write_orbit(orbit, folder / "orbit.json")
    (folder / "proof.json").write_text(json.dumps(zo.prove(orbit).certificate))
    return folder / "orbit.json", folder / "proof.json"


def _changed(path: Path, name: str, change: Any) -> Path:
    data = json.loads(path.read_text())
    change(data)
    changed = path.with_name(name)
    changed.write_text(json.dumps(data))
    return changed


def _longer(data: Any) -> None:
    claim = next(claim for claim in data["claims"] if claim["name"] == "period")
    claim["low"] = claim["high"]


@pytest.mark.slow
def test_verify_says_that_an_orbit_is_proved_if_its_certificate_is_accepted(
    files: tuple[Path, Path],
) -> None:
    orbit, proof = files
    answer = ask("verify", orbit, "--proof", proof)
    assert answer.code == YES
    assert (
        "Proved: a Zeno periodic orbit of `forced_oscillator` exists; period 6.2831853"
        in answer.out
    )
    assert "Proved" not in ask("verify", orbit).out


@pytest.mark.slow
def test_a_false_certificate_fails_the_orbit_and_names_the_claim(files: tuple[Path, Path]) -> None:
    orbit, proof = files
    answer = ask("verify", orbit, "--proof", _changed(proof, "longer.json", _longer), "--json")
    assert answer.code == NO
    assert answer.data["passed"]
    assert not answer.data["proof"]["proved"]
    assert answer.data["proof"]["says"].startswith("Not proved: `period`")


@pytest.mark.slow
def test_a_certificate_of_another_orbit_is_refused(files: tuple[Path, Path]) -> None:
    orbit, proof = files
    other = _changed(orbit, "other.json", lambda data: data["parameters"].update(restitution=0.4))
    answer = ask("verify", other, "--proof", proof)
    assert answer.code == MISUSE
    assert "must be about `restitution` = 0.4, but it is about 0.5" in answer.err


def _claim(data: Any, name: str) -> Any:
    return next(claim for claim in data["claims"] if claim["name"] == name)


def _wide_below(data: Any) -> None:
    # An enclosure may be wider than what is proved.
    _claim(data, "start_state")["low"][2] = "-0x1p+0"


def _wide_above(data: Any) -> None:
    _claim(data, "start_state")["high"][3] = "0x1p+1"


def _wide_period(data: Any) -> None:
    _claim(data, "period")["low"] = "0x0p+0"


def _no_period(data: Any) -> None:
    data["claims"].remove(_claim(data, "period"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "told"),
    [
        (_wide_below, "at its start, but it encloses -1.0 to "),
        (_wide_above, " to 2.0."),
        (_wide_period, "but it encloses 0.0 to 6.28"),
        (_no_period, "lacks a claim `period`"),
    ],
)
def test_a_certificate_that_encloses_more_than_the_orbit_is_refused(
    files: tuple[Path, Path], change: Any, told: str
) -> None:
    orbit, proof = files
    wide = _changed(proof, "wide.json", change)
    assert ask("prove", "--check", wide).code == YES
    answer = ask("verify", orbit, "--proof", wide)
    assert answer.code == MISUSE
    assert told in answer.err
    assert len(answer.err.strip().splitlines()) == 1


@pytest.mark.slow
def test_an_orbit_beside_the_one_that_is_proved_is_refused(files: tuple[Path, Path]) -> None:
    orbit, proof = (zo.read_orbit(files[0]), files[1])
    problem = zo.load_problem("forced_oscillator")
    assert check_proof_of(orbit, problem, proof).ok
    name = list(orbit.start_state)[-1]
    moved = {**orbit.start_state, name: orbit.start_state[name] + 1e-6}
    phases = (replace(orbit.phases[0], start_state=moved), *orbit.phases[1:])
    with pytest.raises(InputError, match="at its start, but it encloses"):
        check_proof_of(orbit.with_phases(phases), problem, proof)
    with pytest.raises(InputError, match="must be about an orbit of period"):
        check_proof_of(replace(orbit, period=orbit.period + 1e-6), problem, proof)


def test_a_certificate_of_another_problem_is_refused(files: tuple[Path, Path]) -> None:
    orbit, proof = files
    foreign = proof.with_name("foreign.json")
    foreign.write_text(json.dumps(impact_oscillator(zo.load_problem("impact_oscillator"))))
    assert ask("verify", orbit, "--proof", foreign).code == MISUSE


@pytest.mark.slow
def test_the_report_shows_what_is_proved_and_only_that(files: tuple[Path, Path]) -> None:
    orbit, proof = files
    page = orbit.with_name("report.html")
    assert ask("report", orbit, "--proof", proof, "-o", page).code == YES
    text = page.read_text()
    assert "Proved: a Zeno periodic orbit" in text
    # Release at cosine -0.8 and sine 0.6, the other states on the stop.
    for state in ("cosine = -0.8000000000000000", "sine = 0.5999999999999999", "distance = 0 +-"):
        assert state in text
    assert "exactly one periodic orbit passes through box 1" in text
    false = _changed(proof, "longer.json", _longer)
    assert ask("report", orbit, "--proof", false, "-o", page).code == NO
    assert "roved: " not in page.read_text()


def _not_a_number(data: Any) -> None:
    data["passes"][0]["records"][0]["h"] = float("nan")


def _of_another_problem(data: Any) -> None:
    data["problem"] = "vibrating_table"


@pytest.mark.parametrize("spoil", [_not_a_number, _of_another_problem])
def test_what_is_no_certificate_of_its_problem_is_refused_in_one_line(
    files: tuple[Path, Path], spoil: Any
) -> None:
    answer = ask("prove", "--check", _changed(files[1], "spoiled.json", spoil))
    assert answer.code == MISUSE
    assert len(answer.err.strip().splitlines()) == 1


def test_a_certificate_that_is_cut_short_is_refused_in_one_line(files: tuple[Path, Path]) -> None:
    _, proof = files
    short = proof.with_name("short.json")
    short.write_text(proof.read_text()[:5000])
    answer = ask("prove", "--check", short)
    assert answer.code == MISUSE
    assert len(answer.err.strip().splitlines()) == 1
