"""The command `verify`: orbits, tampered orbits, and files that hold no orbit."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.support.commands import (
    NO,
    YES,
    ask,
    assert_refused,
    contents,
    error_said,
)

pytestmark = pytest.mark.usefixtures("here")


def test_verify_says_yes_to_what_the_search_wrote(orbit_file: Path) -> None:
    answer = ask("verify", orbit_file)
    assert answer.code == YES
    verdict, count, *_ = answer.out.splitlines()
    assert verdict.startswith("Verified: a stable Zeno periodic orbit")
    assert re.match(r"(\d+) of \1 checks passed\. Largest residual: \S+ \(\w+\), ", count)
    assert "margin" not in answer.out
    assert "Observed order" not in answer.out


def test_verify_prints_margins_and_the_truncation_test_on_request(orbit_file: Path) -> None:
    margins, truncation, everything = (
        ask("verify", orbit_file, word).out for word in ("--margins", "--truncation", "--all")
    )
    assert "release_transversality" in margins
    assert "Observed order" not in margins
    # The order of the truncation error is 3 by theory (2.3).
    order = re.search(r"Observed order of the truncation error: (\S+)", truncation)
    assert order is not None
    assert abs(float(order[1]) - 3.0) < 0.1
    assert "release_transversality" not in truncation
    assert "release_transversality" in everything
    assert order[0] in everything


def test_verify_counts_the_impacts_that_a_file_lacks_before_a_zeno_point(orbit_file: Path) -> None:
    data = json.loads(orbit_file.read_text())
    zeno = [event["name"] for event in data["events"]].index("zeno stop")
    del data["events"][1:zeno]
    orbit_file.write_text(json.dumps(data))
    answer = ask("verify", orbit_file)
    assert answer.code == YES
    assert f"Note: the orbit lacks {zeno - 1} resolved impacts before Zeno points" in answer.out


def test_verify_prints_the_certificate_as_json(orbit_file: Path) -> None:
    answer = ask("verify", orbit_file, "--json")
    assert answer.code == YES
    assert answer.data["passed"] is True
    assert answer.data["model"] == "derived"
    assert max(answer.data["residuals"].values()) < 1e-9
    assert min(answer.data["margins"].values()) > 0


@pytest.mark.slow
def test_verify_on_the_hand_written_model_says_yes_too(orbit_file: Path) -> None:
    answer = ask("verify", orbit_file, "--model", "reference", "--periods", "1", "--json")
    assert answer.code == YES
    assert answer.data["model"] == "reference"


def _later_zeno(data: dict[str, Any]) -> None:
    data["events"][-2]["time"] += 1e-4


def _henries_for_millihenries(data: dict[str, Any]) -> None:
    data["parameters"]["L"] *= 1000


def _out_of_all_bounds(data: dict[str, Any]) -> None:
    data["start_state"]["theta1"] = 1e200


@pytest.mark.parametrize(
    ("tamper", "residual"),
    [
        (_later_zeno, "zeno_point"),
        (_henries_for_millihenries, "first_impact"),
        (_out_of_all_bounds, "release"),
    ],
)
def test_verify_refuses_a_tampered_orbit_and_names_the_residual(
    tamper: Callable[[dict[str, Any]], None],
    residual: str,
    orbit_data: dict[str, Any],
    here: Path,
) -> None:
    tamper(orbit_data)
    (here / "false.json").write_text(json.dumps(orbit_data))
    answer = ask("verify", "false.json", "--periods", "1")
    assert answer.code == NO
    assert f"Refused: `{residual}` = " in answer.out
    assert answer.err == ""


@pytest.mark.slow
def test_verify_at_an_accuracy_refuses_a_period_that_is_further_off(
    orbit_data: dict[str, Any], here: Path
) -> None:
    orbit_data["period"] *= 1 + 1e-5
    (here / "off.json").write_text(json.dumps(orbit_data))
    refused = ask("verify", "off.json", "--accuracy", "1e-6")
    assert refused.code == NO
    assert "Refused: `period` = 1.0e-05 exceeds 1e-06" in refused.out
    assert error_said(refused) >= 0.99e-5
    assert ask("verify", "off.json", "--accuracy", "1e-4").code == YES


def test_verify_at_an_accuracy_reports_the_error_as_json(orbit_file: Path) -> None:
    assert 0.0 < ask("verify", orbit_file, "--accuracy", "1e-6", "--json").data["error"] <= 1e-6


@pytest.mark.slow
def test_an_orbit_that_is_less_certain_than_asked_is_a_no(orbit_file: Path) -> None:
    """However lax its residuals are judged."""
    data = json.loads(orbit_file.read_text())
    orbit_file.write_text(json.dumps({**data, "period": data["period"] * (1 + 1e-9)}))
    lax = ("verify", orbit_file, "--periods", "1", "--tolerance", "0.5", "--accuracy")
    refused = ask(*lax, "1e-12")
    assert refused.code == NO
    assert "Verified" in refused.out
    assert error_said(refused) > 1e-12
    assert "exceeds the requested accuracy 1e-12" in refused.out
    assert ask(*lax, "1e-12", "--json").code == NO
    assert ask(*lax, "1e-6").code == YES


@pytest.mark.parametrize("command", [("verify",), ("plot", "-o", "pictures")])
@pytest.mark.parametrize("part", [0.0, 0.5])
def test_an_orbit_file_that_is_cut_short_is_refused(
    part: float, command: tuple[str, ...], orbit_file: Path, here: Path
) -> None:
    text = orbit_file.read_text().rstrip()
    orbit_file.write_text(text[: int(part * len(text))])
    before = contents(here)
    assert_refused(ask(*command, orbit_file.name), "orbit.json", "JSON" if part else "it is empty")
    assert contents(here) == before


def _newer(data: dict[str, Any]) -> Any:
    return {**data, "format": 4}


def _nan(data: dict[str, Any]) -> Any:
    return {**data, "period": math.nan}


def _missing_gain(data: dict[str, Any]) -> Any:
    return {**data, "gains": {"Kp": 2.5}}


def _bad_restitution(data: dict[str, Any]) -> Any:
    return {**data, "parameters": {**data["parameters"], "restitution": 1.2}}


def _unknown_problem(data: dict[str, Any]) -> Any:
    return {**data, "problem": "flying_machine"}


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_newer, ("its format is 4", "Update zeno_orbits")),
        (_nan, ("`period`", "finite")),
        (_missing_gain, ("Kd",)),
        (_bad_restitution, ("`restitution`", "1.2")),
        (_unknown_problem, ("`flying_machine`",)),
    ],
)
def test_a_false_orbit_file_is_refused_and_its_entry_named(
    spoil: Callable[[dict[str, Any]], Any],
    words: tuple[str, ...],
    orbit_data: dict[str, Any],
    here: Path,
) -> None:
    (here / "false.json").write_text(json.dumps(spoil(orbit_data)))
    before = contents(here)
    assert_refused(ask("verify", "false.json"), *words)
    assert contents(here) == before


def test_an_orbit_file_that_is_not_text_is_refused(here: Path) -> None:
    (here / "binary.json").write_bytes(bytes(range(256)))
    assert_refused(ask("verify", "binary.json"), "binary.json")
