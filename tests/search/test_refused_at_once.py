"""Questions that no orbit can answer are refused before any search, by every command alike."""

from __future__ import annotations

import math

import pytest

import zeno_orbits as zo
from tests.support.commands import MISUSE, NO, ask
from zeno_orbits.maps import Attractor, AttractorClass


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--vary", "A=0.9:1.1", "--objective", "period=5"), "turns of the clock, 6.28319 s each"),
        (("--vary", "A=0.9:1.1", "--objective", "period=5"), "fixes the period: free omega."),
        (("--vary", "omega=0.9:1.1", "--objective", "period=5"), "fixes the period: widen omega."),
        (("--vary", "A=0.9:1.1", "--objective", "contraction"), "is a point"),
        (
            ("--bounds", "spectral_radius=:0.5", "--vary", "A=0.9:1.1"),
            "--bounds spectral_radius=:0.5: must not ask for",
        ),
    ],
)
def test_an_objective_that_no_orbit_meets_is_refused_with_the_remedy(
    words: tuple[str, ...], reason: str
) -> None:
    answer = ask("search", "forced_oscillator", *words)
    assert answer.code == MISUSE
    assert reason in answer.err


@pytest.mark.slow
def test_a_period_of_whole_turns_is_searched() -> None:
    # The clock of the oscillator turns in 2 pi / omega: 5.9 s at omega = 1.0649...
    result = zo.search_gains(
        "forced_oscillator",
        vary={"omega": (0.9, 1.1)},
        objective=zo.TargetPeriod(target=5.9),
    )
    omega = result.unwrap().parameters["omega"]
    assert omega == pytest.approx(2 * math.pi / 5.9, rel=1e-9)


def test_a_start_off_the_clock_is_refused_by_search_and_map_in_the_same_words() -> None:
    start = ("--start", "cosine=0.5")
    searched = ask("search", "forced_oscillator", *start)
    mapped = ask("map", "forced_oscillator", "--x", "A=0.9:1.1", "--y", "c=1:2", *start)
    assert (searched.code, mapped.code) == (MISUSE, MISUSE)
    assert "on the unit circle, as a clock, but they are 0.5 and 0" in searched.err
    assert mapped.err.splitlines()[-1] == searched.err.splitlines()[-1]


def test_an_unstable_orbit_is_no_answer_unless_it_is_asked_for() -> None:
    gains = {"Kp": 4.3, "Kd": -1.55}
    shape = zo.EventSequence.parsed("zeno")
    refused = zo.find_orbit("motor_pendulum", gains=gains, shape=shape)
    assert refused.orbit is None
    assert "is not stable" in refused.detail
    found = zo.find_orbit("motor_pendulum", gains=gains, shape=shape, allow_unstable=True)
    certificate = found.candidates[0].certificate
    assert certificate is not None
    assert certificate.unstable


def test_no_map_is_suggested_to_a_machine_that_comes_to_rest() -> None:
    answer = ask("search", "bouncing_ball")
    assert answer.code == NO
    assert "map" not in answer.out
    assert "a drive or a clock" in answer.out
    # A table has a clock, which supplies what impacts take.
    assert (
        "zeno-orbits map vibrating_table"
        in ask("search", "vibrating_table", "--set", "A=0.005").out
    )


def test_an_orbit_without_multipliers_has_the_radius_zero_everywhere() -> None:
    assert Attractor(fate=AttractorClass.ZENO).spectral_radius == 0.0
    assert Attractor(fate=AttractorClass.NO_ZENO, multipliers=(0.5 + 0j,)).spectral_radius == 0.5
    assert math.isnan(Attractor(fate=AttractorClass.REST).spectral_radius)
