"""The checker of certificates: on orbits in closed form, made by hand, and on false ones."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from tests.support.certificates import forced_oscillator
from zeno_orbits.model import load_problem
from zeno_orbits.proof import ProofVerdict, check


@pytest.fixture(scope="module")
def oscillator() -> dict[str, Any]:
    return forced_oscillator(load_problem("forced_oscillator"))


def test_the_forced_oscillator_is_proved_from_its_closed_form(oscillator: dict[str, Any]) -> None:
    verdict = check(oscillator)
    assert verdict.ok, verdict.claims
    names = [claim.name for claim in verdict.claims]
    assert names == ["motion 0", "exists", "unique", "period", "zeno_time", "impact_time"]


def test_a_period_that_does_not_hold_the_true_one_is_refused(oscillator: dict[str, Any]) -> None:
    false = copy.deepcopy(oscillator)
    claim = next(claim for claim in false["claims"] if claim["name"] == "period")
    claim["high"] = claim["low"]
    assert _refused(check(false)) == ["period"]


def _refused(verdict: ProofVerdict) -> list[str]:
    return [claim.name for claim in verdict.claims if not claim.ok]
