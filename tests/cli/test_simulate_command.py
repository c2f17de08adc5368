"""The command `simulate`: its events, its error, its samples, its engines."""

from __future__ import annotations

import json
import math
import re
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
from zeno_orbits.errors import PenetrationError
from zeno_orbits.integrators import Tolerance
from zeno_orbits.report import terminal as report
from zeno_orbits.simulation import Execution, SimulationSettings, simulate

pytestmark = pytest.mark.usefixtures("here")


def test_simulate_names_impacts_zeno_points_and_releases() -> None:
    answer = ask("simulate", "motor_pendulum", "--until", "3")
    assert answer.code == YES
    for word in ("impact", "Zeno point", "release", "The last arc is"):
        assert word in answer.out


@pytest.mark.parametrize("error", [1e-10, 1e-4, 0.088])
def test_an_estimate_that_leaves_few_digits_is_followed_by_a_warning(
    error: float, capsys: pytest.CaptureFixture[str]
) -> None:
    report.print_error_estimate(error)
    said = capsys.readouterr().out.splitlines()
    assert said[0] == f"Estimated relative error: {error:.1e}."
    assert (len(said) == 2 and "events may be false" in said[1]) == (error > 1e-3)


def test_simulate_as_json_follows_the_ball_to_its_zeno_time() -> None:
    answer = ask("simulate", "bouncing_ball", "--set", "restitution=0.8", "--until", "5", "--json")
    assert answer.code == YES
    events = answer.data["events"]
    e, g = 0.8, 9.81
    fall = math.sqrt(2 / g)
    assert [event["event"] for event in events] == ["impact"] * (len(events) - 1) + ["zeno_point"]
    assert events[0]["time"] == pytest.approx(fall, rel=1e-11)
    assert events[-1]["time"] == pytest.approx(fall * (1 + e) / (1 - e), rel=1e-11)
    assert answer.data["end_mode"] == "locked"
    assert answer.data["end_time"] == 5.0


@pytest.mark.slow
def test_simulate_starts_where_it_is_told_and_draws_when_asked(here: Path) -> None:
    answer = ask(
        *("simulate", "bouncing_ball", "--start", "speed=-2", "--start", "height=1"),
        *("--until", "1", "--json", "--plot", "ball.svg"),
    )
    fall = (math.sqrt(4 + 2 * 9.81) - 2) / 9.81
    assert answer.data["events"][0]["time"] == pytest.approx(fall, rel=1e-11)
    assert "<svg" in (here / "ball.svg").read_text()


def test_simulate_at_an_accuracy_reports_the_error_as_text_and_json() -> None:
    ball = ("simulate", "bouncing_ball", "--until", "5", "--accuracy", "1e-6")
    assert 0.0 < error_said(ask(*ball)) <= 1e-6
    assert 0.0 < ask(*ball, "--json").data["error"] <= 1e-6


def test_simulate_tells_the_error_of_every_zeno_point_with_its_flights() -> None:
    """Of the closed form, and not of the limit of impacts that are wrong themselves."""
    e, g = 0.5, 9.81
    truth = math.sqrt(2 / g) * (1 + e) / (1 - e)
    ball = ("simulate", "bouncing_ball", "--set", f"restitution={e}", "--until", "5")
    data = ask(*ball, "--json").data
    (point,) = [event for event in data["events"] if event["event"] == "zeno_point"]
    assert abs(point["time"] - truth) <= point["error"] * (1 + truth)
    assert point["limit_error"] < point["error"] <= data["error"]
    said = re.search(r"Zeno point \+- (\S+)", ask(*ball).out)
    assert said is not None
    assert float(said[1]) == pytest.approx(point["error"], rel=0.5)


def test_simulate_says_where_no_looser_run_tells_the_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def fragile(*given: Any, settings: SimulationSettings, **named: Any) -> Execution:
        if settings.tolerance.relative > Tolerance().relative:
            raise PenetrationError("Through the stop", time=0.0, state=(0.0, 0.0))
        return simulate(*given, settings=settings, **named)

    monkeypatch.setattr("zeno_orbits.precision.accuracy.simulate", fragile)
    ball = ("simulate", "bouncing_ball", "--until", "5")
    answer = ask(*ball)
    assert re.search(r"Zeno point \+- \?", answer.out)
    assert "error: unknown" in answer.out
    data = ask(*ball, "--json").data
    assert data["error"] is None
    assert data["events"][-1]["error"] is None


def test_an_accuracy_out_of_reach_is_a_no(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that rounds a thousand times worse."""
    monkeypatch.setattr("zeno_orbits.precision.accuracy.ROUNDING", 4e-12)
    ball = ("simulate", "bouncing_ball", "--until", "1", "--plot", "f.png", "--accuracy")
    answer = ask(*ball, "1e-12")
    assert answer.code == NO
    assert answer.out == ""
    assert re.fullmatch(r"zeno-orbits: The accuracy 1e-12 is out of reach: .*\n", answer.err)
    assert contents(here) == {}
    assert ask(*ball, "1e-9").code == YES


@pytest.mark.parametrize("engine", ["automatic", "explicit", "implicit"])
def test_every_engine_simulates_and_is_named(engine: str) -> None:
    answer = ask("simulate", "motor_pendulum", "--until", "2", "--engine", engine)
    assert answer.code == YES
    assert f"Engine: {engine}," in answer.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--rate", "0"), ("--rate 0:", "positive")),
        (("--rate", "1e12"), ("--rate 1e12:", "10000000 samples")),
        (("--noise", "1e308"), ("--noise 1e308:", "[0, 1)")),
        (("--noise", "5"), ("--noise 5:", "[0, 1), relative to the range of each signal")),
        (("--noise", "nan"), ("--noise nan:", "nan")),
        (("--plot", "a.csv"), ("--plot a.csv:", ".png")),
    ],
    ids=str,
)
def test_samples_that_cannot_be_are_refused_before_the_work(
    arguments: tuple[str, ...], words: tuple[str, ...], here: Path
) -> None:
    answer = ask("simulate", "bouncing_ball", "--until", "1", *arguments, "-o", "data.csv")
    assert_refused(answer, *words)
    assert contents(here) == {}


def test_numbers_that_no_parameter_can_be_derived_from_are_misuse() -> None:
    answer = ask("simulate", "motor_pendulum", "--set", "m2=1e300", "--until", "1")
    assert_refused(answer, "`parameters`", "out of range")
    assert "internal" not in answer.err


SHORT = ("simulate", "motor_pendulum", "--until", "40", "--max-steps", "3000")


@pytest.mark.slow
def test_a_run_of_too_many_steps_keeps_its_table_picture_and_samples_and_names_the_option(
    here: Path,
) -> None:
    answer = ask(*SHORT, "--plot", "time.svg", "-o", "data.csv")
    assert answer.code == NO
    assert answer.out.count("release") >= 5
    assert "Zeno point" in answer.out
    assert "more than 3000 steps: raise --max-steps, or simulate" in answer.err
    assert set(contents(here)) == {"time.svg", "data.csv"}
    data = ask(*SHORT, "--json").data
    assert "most_steps" in data["stopped"]
    assert 5.0 < data["end_time"] < 40.0
    whole = ask("simulate", "motor_pendulum", "--until", "10", "--json").data
    assert whole["stopped"] is None
    assert whole["events"][0] == data["events"][0]


def columns(*arguments: str) -> list[str]:
    """Return the headings of the table of a simulation."""
    answer = ask("simulate", *arguments)
    assert answer.code == YES
    return re.split(r"  +", answer.out.splitlines()[0].strip())


def test_the_table_shows_what_moves_and_all_states_on_request() -> None:
    events = ["t [s]", "event", "dh/dt"]
    pendulum = ("motor_pendulum", "--until", "3")
    assert columns(*pendulum) == [*events, "theta1", "dtheta1", "current"]
    every = ["theta1", "theta2", "dtheta1", "dtheta2", "current"]
    assert columns(*pendulum, "--all-states") == [*events, *every]
    # A mass on a spring strikes at one place, at a speed that the table has, and time is time.
    assert columns("forced_oscillator") == events


@pytest.mark.parametrize("problem", ["motor_pendulum", "two_motors", "curved_surface"])
def test_the_table_fits_eighty_columns(problem: str) -> None:
    lines = ask("simulate", problem, "--until", "3").out.splitlines()
    table = lines[: next(k for k, line in enumerate(lines) if not line.strip())]
    assert max(len(line.rstrip()) for line in table) <= 80


def test_a_single_event_shows_its_states() -> None:
    out = ask("simulate", "motor_pendulum", "--until", "1").out
    heading, row = out.splitlines()[:2]
    assert heading.split()[-3:] == ["theta1", "dtheta1", "current"]
    assert row.split()[1] == "release"
    assert len(row.split()) == 5


def test_all_states_stand_in_several_tables_where_one_is_too_wide(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("zeno_orbits.report.terminal.console._FILE_WIDTH", 60)
    out = ask("simulate", "motor_pendulum", "--until", "1.4", "--all-states").out
    headings = [line.split() for line in out.splitlines() if line.lstrip().startswith("t [s]")]
    states = [heading[heading.index("dh/dt") + 1 :] for heading in headings]
    every = ["theta1", "theta2", "dtheta1", "dtheta2", "current"]
    assert [name for shown in states for name in shown] == every
    assert len(states) > 1
    assert all(len(line) <= 60 for line in out.splitlines()[:9])


def test_a_state_below_its_rounding_is_printed_as_zero_and_written_in_full() -> None:
    words = ("simulate", "forced_oscillator", "--until", "10", "--all-states", "--events")
    printed, data = ask(*words), ask(*words, "--json").data
    rows = [row.split() for row in printed.out.splitlines() if " impact " in row]
    assert len(rows) > 5
    # The mass is on its stop in each impact.
    assert all(row[3] == "0" for row in rows)
    assert "e-17" in json.dumps(data)
    assert float(rows[0][2]) == pytest.approx(-0.2007483, rel=1e-5)
