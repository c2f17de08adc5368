"""The paper's rule from the command line: where it cuts, and the error that it reports."""

from __future__ import annotations

import json
from typing import Any

import pytest

from zeno_orbits.cli import main


def _run(capsys: pytest.CaptureFixture[str], *words: str) -> Any:
    assert main(["simulate", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def _events(run: Any, kind: str) -> list[Any]:
    return [event for event in run["events"] if event["event"] == kind]


def test_the_first_slow_impact_is_the_last_and_the_reported_error_holds_the_cut(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # A ball from h = 1 with e = 0.5: impact k at the speed w0 / 2^k, Zeno time 3 sqrt(2 h / g).
    words = ("bouncing_ball", "--set", "restitution=0.5", "--until", "3")
    delta, first = 0.1, (2 * 9.81) ** 0.5
    run = _run(capsys, *words, "--truncation", str(delta))
    speeds = [-event["approach_rate"] for event in _events(run, "impact")]
    assert speeds == pytest.approx([first * 0.5**k for k in range(len(speeds))], rel=1e-9)
    assert speeds[-1] < delta <= speeds[-2]
    early = 3 * (2 / 9.81) ** 0.5 - _events(run, "zeno_point")[0]["time"]
    # The flights left out last 2 w / (g (1 - e)) with w = e times the last speed.
    assert early == pytest.approx(2 * speeds[-1] * 0.5 / (9.81 * 0.5), rel=1e-6)
    assert run["error"] >= 0.99 * early / (3 * (2 / 9.81) ** 0.5)


def test_releases_miss_by_the_third_order(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("motor_valve", "--until", "0.6")
    exact = _events(_run(capsys, *words), "release")
    errors: list[float] = []
    speeds: list[float] = []
    for delta in ("1", "0.2", "0.04"):
        run = _run(capsys, *words, "--truncation", delta)
        errors.append(abs(_events(run, "release")[1]["time"] - exact[1]["time"]))
        speeds.append(-_events(run, "impact")[-1]["approach_rate"])
    for k in range(2):
        # The next order, in the speeds of these cuts, is below a fifth.
        ratio = (speeds[k] / speeds[k + 1]) ** 3
        assert errors[k] / errors[k + 1] == pytest.approx(ratio, rel=0.2)


@pytest.mark.parametrize(
    ("words", "refusal"),
    [
        (["--truncation", "0"], "--truncation 0: must be a speed above 0, but it is 0"),
        (["--truncation", "1", "--accuracy", "1e-3"], "`--accuracy` exclude each other"),
    ],
)
def test_a_cut_that_cannot_be_is_refused(
    words: list[str], refusal: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", "bouncing_ball", *words]) == 2
    assert refusal in capsys.readouterr().err
