"""The command line: its answers, its exit codes, and what it says of bad input."""

from __future__ import annotations

import io
import json
import math
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import pytest

import zeno_orbits
from tests.reference.reference_orbit import ORBIT_KEYS, PERIOD, RELEASE
from zeno_orbits.cli import build_parser, main
from zeno_orbits.errors import PenetrationError, ZenoOrbitsError
from zeno_orbits.integrators.flow import Tolerance
from zeno_orbits.model import formulas as symbolic
from zeno_orbits.model.library import bundled_problems, load_problem
from zeno_orbits.model.problem import Problem
from zeno_orbits.precision.extended_fixed_point import ExtendedOrbit, extended_orbit
from zeno_orbits.report.terminal import progress
from zeno_orbits.search import SearchSettings
from zeno_orbits.simulation.execution import Execution
from zeno_orbits.simulation.simulator import SimulationSettings, simulate
from zeno_orbits.verification.certificate import OrbitCertificate

YES, NO, MISUSE, INTERRUPTED = 0, 1, 2, 130
COMMANDS = (
    *("problems", "conditions", "simulate", "fidelity", "search", "verify", "trade", "plot"),
    *("map", "rig"),
)
PUBLISHED_GAINS = ("--fix", "Kp=2.5", "--fix", "Kd=-1")


@dataclass(frozen=True)
class Answer:
    """What a command leaves behind."""

    code: int
    out: str
    err: str

    @property
    def data(self) -> Any:
        """Standard output, which must be one JSON document and nothing else."""
        return json.loads(self.out)


def ask(*arguments: str | Path) -> Answer:
    """Run a command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as ending:
            code = ending.code if isinstance(ending.code, int) else -1
    return Answer(code, out.getvalue(), err.getvalue())


def contents(folder: Path) -> dict[str, bytes | None]:
    """Return path to content of everything below a folder, without Python's own caches."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
        if "__pycache__" not in path.parts
    }


@pytest.fixture(name="searched", scope="module")
def _searched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Answer, Path]:
    """The published gains, searched once, and the file that came of it."""
    path = tmp_path_factory.mktemp("orbits") / "orbit.json"
    return ask("search", "motor_pendulum", *PUBLISHED_GAINS, "-o", path, "--json"), path


@pytest.fixture(name="orbit_data")
def _orbit_data(searched: tuple[Answer, Path]) -> dict[str, Any]:
    return json.loads(searched[1].read_text())


@pytest.fixture(name="here", autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture(name="orbit")
def _orbit(searched: tuple[Answer, Path], here: Path) -> Path:
    """A copy of the orbit file in the working folder."""
    path = here / "orbit.json"
    path.write_bytes(searched[1].read_bytes())
    return path


@pytest.fixture(name="formulas", scope="module", autouse=True)
def _formulas() -> Any:
    """Let SymPy simplify the acceleration of each problem once, not in every test."""
    known: dict[str, Any] = {}
    simplify = symbolic.equilibrium_acceleration

    def remembered(problem: Problem) -> Any:
        if problem.name not in known:
            known[problem.name] = simplify(problem)
        return known[problem.name]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(symbolic, "equilibrium_acceleration", remembered)
        yield


def raising(error: BaseException) -> Callable[..., NoReturn]:
    """Return a stand-in for any function, that raises."""

    def stand_in(*_arguments: Any, **_named: Any) -> NoReturn:
        raise error

    return stand_in


# ---------------------------------------------------------------------------- answers


@pytest.mark.parametrize("name", sorted(bundled_problems()))
def test_problems_lists_every_problem_with_its_gains(name: str) -> None:
    assert name in ask("problems").out
    entry = next(entry for entry in ask("problems", "--json").data if entry["name"] == name)
    problem = load_problem(name)
    assert list(entry["gains"]) == [gain.name for gain in problem.gains]
    assert list(entry["states"]) == list(problem.state_names)
    assert entry["parameters"] == dict(problem.values().parameters)


def test_conditions_shows_the_two_published_coefficients() -> None:
    answer = ask("conditions", "motor_pendulum")
    assert answer.code == YES
    assert "2.92437" in answer.out
    assert "27.5697" in answer.out


def test_conditions_as_json_has_the_published_coefficients_to_all_published_digits() -> None:
    answer = ask("conditions", "motor_pendulum", "--json")
    assert answer.code == YES
    coefficients = answer.data["coefficients"]
    assert set(coefficients) == {"current", "sin(theta1)"}
    # Half a unit of the last published digit.
    assert coefficients["current"] == pytest.approx(-2.92437, abs=5e-6)
    assert coefficients["sin(theta1)"] == pytest.approx(-27.5697, abs=5e-5)
    assert answer.data["restitution"] == 0.2


def test_conditions_of_a_falling_ball_are_minus_gravity() -> None:
    answer = ask("conditions", "bouncing_ball", "--json")
    assert answer.code == YES
    assert answer.data["coefficients"] == pytest.approx({"1": -9.81})


def test_conditions_draws_the_region_when_asked(here: Path) -> None:
    answer = ask("conditions", "motor_pendulum", "-o", "region.png")
    assert answer.code == YES
    assert (here / "region.png").read_bytes().startswith(b"\x89PNG")
    assert "Written: region.png" in answer.out


def test_simulate_names_impacts_zeno_points_and_releases() -> None:
    answer = ask("simulate", "motor_pendulum", "--until", "3")
    assert answer.code == YES
    for word in ("impact", "Zeno point", "release", "the last arc is"):
        assert word in answer.out


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


def test_simulate_starts_where_it_is_told_and_draws_when_asked(here: Path) -> None:
    answer = ask(
        *("simulate", "bouncing_ball", "--start", "speed=-2", "--start", "height=1"),
        *("--until", "1", "--json", "-o", "ball.svg"),
    )
    fall = (math.sqrt(4 + 2 * 9.81) - 2) / 9.81
    assert answer.data["events"][0]["time"] == pytest.approx(fall, rel=1e-11)
    assert "<svg" in (here / "ball.svg").read_text()


def test_search_at_the_published_gains_finds_the_orbit_and_writes_what_it_prints(
    searched: tuple[Answer, Path],
) -> None:
    answer, path = searched
    assert answer.code == YES
    assert answer.data == json.loads(path.read_text())
    assert set(answer.data) == ORBIT_KEYS
    assert answer.data["format"] == 1
    assert answer.data["problem"] == "motor_pendulum"
    assert answer.data["gains"] == {"Kp": 2.5, "Kd": -1.0}
    # The reference closes to 6e-15; the search promises 3e-10, relative.
    assert answer.data["period"] == pytest.approx(PERIOD, rel=3e-10)
    assert set(answer.data["impacts"][0]) == {"time", "state_minus"}
    assert {"passed", "residuals", "margins"} <= set(answer.data["certificate"])
    assert answer.data["certificate"]["passed"] is True
    assert all(len(pair) == 2 for pair in answer.data["floquet_multipliers"])
    assert {"python", "casadi", "numpy", "scipy"} <= set(answer.data["versions"])


def test_search_with_free_gains_finds_the_orbit_nearest_to_the_problems_own(here: Path) -> None:
    answer = ask("search", "motor_pendulum", "-o", "found.json")
    assert answer.code == YES
    assert "The search found an orbit." in answer.out
    assert "Verified: a stable Zeno periodic orbit" in answer.out
    assert "Written: found.json" in answer.out
    data = json.loads((here / "found.json").read_text())
    assert data["gains"] == pytest.approx({"Kp": 2.5, "Kd": -1.0})


@pytest.mark.slow
def test_search_keeps_a_bound_and_says_what_is_asked_and_reached() -> None:
    keep = ("--fix", "Kp=2.5", "--gain", "Kd=-1.1:-0.8", "--keep", "theta2=:1.95")
    answer = ask("search", "motor_pendulum", *keep, "--candidates", "2", "--starts", "1", "--json")
    assert answer.code == YES
    (asked,) = answer.data["certificate"]["asked"]
    assert (asked["quantity"], asked["lower"], asked["upper"]) == ("theta2", None, 1.95)
    assert 1.94 < asked["highest"] <= 1.95 + 1e-9
    assert asked["kept"] is True
    scores = [one["score"] for one in answer.data["candidates"]]
    assert scores == sorted(scores)
    assert answer.data["candidates"][0]["orbit"]["period"] == answer.data["period"]
    assert answer.data["failures"] == []


def test_search_for_a_parameter_says_what_stays_and_what_is_reached(orbit: Path) -> None:
    free = (*PUBLISHED_GAINS, "--free", "L1=0.198:0.202", "--objective", "peak=current")
    answer = ask("search", "motor_pendulum", *free, "--from", orbit, "--candidates", "1")
    assert answer.code == YES
    assert "Not free, and kept as at the start: J_rotor, K_torque, K_emf." in answer.out
    assert "Asked for the least peak of current; measured on a simulation" in answer.out
    assert re.search(r"^L1 +0\.\d+ +m", answer.out, re.MULTILINE)
    assert max(map(len, answer.out.splitlines())) <= 100


def test_search_at_gains_without_an_orbit_answers_no_with_the_reason(here: Path) -> None:
    gains = ("--fix", "Kp=2.5", "--fix", "Kd=1")
    answer = ask("search", "motor_pendulum", *gains, "-o", "f.json")
    assert answer.code == NO
    assert "No simulation settled" in answer.out
    assert "the motion dies out" in answer.out
    assert ".." not in answer.out
    assert contents(here) == {}


def test_search_as_json_says_no_in_json(here: Path) -> None:
    answer = ask("search", "bouncing_ball", "--json", "-o", "ball.json")
    assert answer.code == NO
    assert answer.data["found"] is False
    assert answer.data["status"]
    assert contents(here) == {}


def assert_says_what_was_missed(answer: Answer, wish: str) -> None:
    """Check the sentence of a search that could not meet a wish."""
    said = " ".join(answer.out.split())
    assert answer.code == NO
    assert "The conditions of the orbit could not be met." in said
    assert "The nearest that was reached is a period of" in said
    assert wish in said
    # A row is named with the place where it stands; rows without a place are named alone.
    assert re.search(r"missed: `[^`]+` by \d", said)
    assert "`continuity`" not in said


def test_a_search_that_misses_says_which_conditions_by_name(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One gain, a narrow box, no small steps: a quick no, with all that a long one says."""
    impatient = partial(SearchSettings, smallest_step=0.02)
    monkeypatch.setattr("zeno_orbits.search.SearchSettings", impatient)
    answer = ask(
        *("search", "motor_pendulum", "--fix", "Kd=-1", "--gain", "Kp=2.49:2.51"),
        *("--objective", "period=1.95", "--starts", "1", "-o", "f.json"),
    )
    assert_says_what_was_missed(answer, "missed: `a period of 1.95 s` by 0.1")
    assert contents(here) == {}


@pytest.mark.slow
def test_a_period_that_no_orbit_has_ends_in_a_no_that_says_what_was_tried(here: Path) -> None:
    answer = ask("search", "motor_pendulum", "--objective", "period=5", "-o", "f.json")
    assert_says_what_was_missed(answer, "The nearest that was reached is a period of")
    assert contents(here) == {}


def test_verify_says_yes_to_what_the_search_wrote(orbit: Path) -> None:
    answer = ask("verify", orbit)
    assert answer.code == YES
    assert "Verified: a stable Zeno periodic orbit" in answer.out
    assert "Observed order of the cut" in answer.out


def test_verify_prints_the_certificate_as_json(orbit: Path) -> None:
    answer = ask("verify", orbit, "--json")
    assert answer.code == YES
    assert answer.data["passed"] is True
    assert answer.data["model"] == "derived"
    assert max(answer.data["residuals"].values()) < 1e-9
    assert min(answer.data["margins"].values()) > 0


def test_verify_on_the_hand_written_model_says_yes_too(orbit: Path) -> None:
    answer = ask("verify", orbit, "--model", "reference", "--periods", "1", "--json")
    assert answer.code == YES
    assert answer.data["model"] == "reference"


def _later_zeno(data: dict[str, Any]) -> None:
    data["zeno_time"] += 1e-4


def _longer_period(data: dict[str, Any]) -> None:
    data["period"] *= 1 + 1e-6


def _other_first_impact(data: dict[str, Any]) -> None:
    data["impacts"][0]["time"] += 1e-5


def _not_at_release(data: dict[str, Any]) -> None:
    data["release_state"]["current"] += 1e-3


def _off_the_stop(data: dict[str, Any]) -> None:
    data["release_state"]["theta2"] += 1e-3


def _inside_the_stop(data: dict[str, Any]) -> None:
    data["release_state"]["theta2"] -= 1e-3


def _moving_into_the_stop(data: dict[str, Any]) -> None:
    data["release_state"]["dtheta2"] -= 1e-3


def _doubled_period(data: dict[str, Any]) -> None:
    data["period"] *= 2


def _henries_for_millihenries(data: dict[str, Any]) -> None:
    data["parameters"]["L"] *= 1000


def _milliamperes_for_amperes(data: dict[str, Any]) -> None:
    data["release_state"]["current"] *= 1000


def _out_of_all_bounds(data: dict[str, Any]) -> None:
    data["release_state"]["theta1"] = 1e200


def _other_zeno_point(data: dict[str, Any]) -> None:
    data["zeno_state"]["theta1"] += 1e-4


@pytest.mark.parametrize(
    ("tamper", "residual"),
    [
        (_later_zeno, "zeno_point"),
        (_other_zeno_point, "zeno_point"),
        (_longer_period, "period"),
        (_other_first_impact, "first_impact"),
        (_not_at_release, "release"),
        (_off_the_stop, "release"),
        (_inside_the_stop, "release"),
        (_moving_into_the_stop, "release"),
        (_doubled_period, "period"),
        (_henries_for_millihenries, "first_impact"),
        (_milliamperes_for_amperes, "release"),
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
    assert f"Refused: `{residual}` is" in answer.out
    assert answer.err == ""


def test_plot_writes_five_pictures(orbit: Path, here: Path) -> None:
    answer = ask("plot", orbit, "-o", "pictures")
    assert answer.code == YES
    pictures = sorted((here / "pictures").iterdir())
    assert [path.name for path in pictures] == [
        "outputs.png",
        "portraits.png",
        "region.png",
        "time.png",
        "zeno.png",
    ]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures)
    assert answer.out.count("Written: ") == 5


def test_pictures_that_cannot_all_be_drawn_are_none(orbit_data: dict[str, Any], here: Path) -> None:
    """A period too short for a Zeno point: the portraits alone could be drawn."""
    (here / "short.json").write_text(json.dumps(orbit_data | {"period": 1e-3}))
    before = contents(here)
    assert_refused(ask("plot", "short.json", "-o", "pictures"), "Zeno point")
    assert contents(here) == before
    assert not (here / "pictures").exists()


def test_a_new_problem_may_not_take_the_name_of_another(here: Path) -> None:
    """An orbit file tells its problem by this name."""
    assert_refused(ask("new", "motor_pendulum"), "`name`", "`motor_pendulum` is one")
    assert contents(here) == {}


def test_plot_writes_the_picture_that_is_asked_for(orbit: Path, here: Path) -> None:
    answer = ask("plot", orbit, "--kind", "portraits", "--format", "pdf", "--json")
    assert answer.data == {"pictures": ["portraits.pdf"]}
    assert (here / "portraits.pdf").read_bytes().startswith(b"%PDF")


# ------------------------------------------------------------------- accuracy and engines


def error_said(answer: Answer) -> float:
    """Return the estimated error that a command prints."""
    (number,) = re.findall(r"Estimated relative error: (\S+)\.$", answer.out, flags=re.MULTILINE)
    return float(number)


@pytest.fixture(name="exact", scope="module")
def _exact() -> ExtendedOrbit:
    """The orbit at the published gains, to 25 digits."""
    pytest.importorskip("heyoka")
    problem = load_problem("motor_pendulum")
    return extended_orbit(problem, problem.values(), RELEASE)


def orbit_miss(data: Mapping[str, Any], exact: ExtendedOrbit) -> float:
    """Return how far an orbit file is off, in the units of its residuals.

    The largest values of the states on the orbit: 1.2 rad, 17 rad/s and more.
    """
    sizes = {"theta1": 1.2, "theta2": 1.0, "dtheta1": 8.0, "dtheta2": 16.9, "current": 3.0}
    period, zeno = float(exact.period), exact.zeno_points[0]
    times = [(data["period"], exact.period), (data["zeno_time"], zeno.time)]
    times += [
        (i["time"], true.time) for i, true in zip(data["impacts"], exact.impacts, strict=False)
    ]
    misses = [abs(time - float(true)) / period for time, true in times]
    for found, true in (("release_state", exact.release_state), ("zeno_state", zeno.state)):
        for name, value in zip(exact.state_names, true, strict=True):
            misses.append(abs(data[found][name] - float(value)) / sizes[name])
    return max(misses)


@pytest.mark.parametrize("wanted", [1e-4, 1e-6, 1e-10])
@pytest.mark.slow
def test_a_search_to_an_accuracy_keeps_it_and_bounds_its_error(
    wanted: float, here: Path, exact: ExtendedOrbit
) -> None:
    accuracy = f"--accuracy={wanted}"
    answer = ask("search", "motor_pendulum", *PUBLISHED_GAINS, accuracy, "-o", "o.json")
    assert answer.code == YES
    said = error_said(answer)
    data = json.loads((here / "o.json").read_text())
    # Two digits of the estimate are printed, and the sizes above are rounded.
    assert orbit_miss(data, exact) < 1.1 * said
    assert said <= wanted
    checked = ask("verify", "o.json", accuracy)
    assert checked.code == YES
    assert error_said(checked) <= wanted


def test_an_orbit_that_is_not_the_one_is_seen_to_miss_it(
    orbit_data: dict[str, Any], exact: ExtendedOrbit
) -> None:
    assert orbit_miss(orbit_data, exact) < 1e-9
    orbit_data["zeno_state"]["current"] += 1e-5
    assert orbit_miss(orbit_data, exact) > 1e-6


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


def test_an_accuracy_that_the_orbit_misses_is_a_no_of_the_search(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every residual passes; the orbit attracts so weakly that its numbers are worse than that."""
    weak = property(lambda _certificate: 3e-4)
    monkeypatch.setattr(OrbitCertificate, "orbit_error", weak)
    search = ("search", "motor_pendulum", *PUBLISHED_GAINS, "-o", "o.json")
    answer = ask(*search, "--accuracy", "1e-4")
    assert answer.code == NO
    assert "certain to 3.0e-04 only" in answer.out
    assert contents(here) == {}


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
    said = re.search(r"Zeno point \(\+- (.*?)\)", ask(*ball).out)
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
    assert "Zeno point (+- ?)" in answer.out
    assert "error: unknown" in answer.out
    data = ask(*ball, "--json").data
    assert data["error"] is None
    assert data["events"][-1]["error"] is None


def test_verify_at_an_accuracy_reports_the_error_as_json(orbit: Path) -> None:
    assert 0.0 < ask("verify", orbit, "--accuracy", "1e-6", "--json").data["error"] <= 1e-6


def test_an_orbit_that_is_less_certain_than_asked_is_a_no(orbit: Path) -> None:
    """However lax its residuals are judged."""
    lax = ("verify", orbit, "--periods", "1", "--tolerance", "0.5", "--accuracy")
    refused = ask(*lax, "1e-12")
    assert refused.code == NO
    assert "Verified" in refused.out
    assert error_said(refused) > 1e-12
    assert "more than the accuracy 1e-12" in refused.out
    assert ask(*lax, "1e-12", "--json").code == NO
    assert ask(*lax, "1e-6").code == YES


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--rate", "0"), ("`rate`", "positive")),
        (("--rate", "1e12"), ("`rate`", "10000000 samples")),
        (("--noise", "1e308"), ("`noise`", "1e+06")),
        (("--noise", "nan"), ("`noise`", "nan")),
        (("-o", "a.png", "--data", "./a.png"), ("`output`", "another file than `data`")),
    ],
    ids=str,
)
def test_samples_that_cannot_be_are_refused_before_the_work(
    arguments: tuple[str, ...], words: tuple[str, ...], here: Path
) -> None:
    data = () if "--data" in arguments else ("--data", "data.csv")
    answer = ask("simulate", "bouncing_ball", "--until", "1", *arguments, *data)
    assert_refused(answer, *words)
    assert contents(here) == {}


def test_numbers_that_no_parameter_can_be_derived_from_are_misuse() -> None:
    answer = ask("simulate", "motor_pendulum", "--set", "m2=1e300", "--until", "1")
    assert_refused(answer, "`parameters`", "out of range")
    assert "internal" not in answer.err


@pytest.mark.parametrize("name", ["a" * 5000, "a\0b"])
def test_a_name_that_no_file_can_have_is_no_problem(name: str) -> None:
    answer = ask("simulate", name)
    assert_refused(answer, "`problem` must be one of")
    assert "internal" not in answer.err


def test_an_accuracy_out_of_reach_is_a_no(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that rounds a thousand times worse."""
    monkeypatch.setattr("zeno_orbits.precision.accuracy.ROUNDING", 4e-12)
    ball = ("simulate", "bouncing_ball", "--until", "1", "-o", "f.png", "--accuracy")
    answer = ask(*ball, "1e-12")
    assert answer.code == NO
    assert answer.out == ""
    assert re.fullmatch(r"zeno-orbits: The accuracy 1e-12 is out of reach: .*\n", answer.err)
    assert contents(here) == {}
    assert ask(*ball, "1e-9").code == YES


@pytest.mark.parametrize("engine", ["automatic", "explicit", "implicit", "taylor"])
def test_every_engine_simulates_and_is_named(engine: str) -> None:
    if engine == "taylor":
        pytest.importorskip("heyoka")
    answer = ask("simulate", "motor_pendulum", "--until", "2", "--engine", engine)
    assert answer.code == YES
    assert f"Engine: {engine}," in answer.out


@pytest.mark.parametrize(
    "command",
    [
        ("simulate", "motor_pendulum", "-o", "f.png"),
        ("search", "motor_pendulum", "-o", "f.json"),
        ("verify", "orbit.json"),
    ],
    ids=lambda command: command[0],
)
def test_taylor_without_heyoka_is_refused_with_what_to_install(
    command: tuple[str, ...], orbit: Path, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert orbit.exists()
    before = contents(here)
    monkeypatch.setitem(sys.modules, "heyoka", None)
    assert_refused(ask(*command, "--engine", "taylor"), "heyoka", "zeno_orbits[taylor]")
    assert contents(here) == before


# ------------------------------------------------------------------------ fidelity and trade


def test_fidelity_names_the_reduced_models_and_their_cost() -> None:
    answer = ask("fidelity", "motor_pendulum")
    assert answer.code == YES
    assert "motor_pendulum@quasi_static" in answer.out
    costs = ask("fidelity", "motor_pendulum", "--json").data
    assert {cost["problem"].partition("@")[2] for cost in costs} == {"corrected", "quasi_static"}


TRADING = ("trade", "bouncing_ball", "--quick", "--until", "4.5")


def test_trade_writes_what_it_prints_and_draws_it(here: Path) -> None:
    answer = ask(*TRADING, "--json", "-o", "trade.json", "--picture", "trade.png")
    assert answer.code == YES
    assert answer.data == json.loads((here / "trade.json").read_text())
    assert {"problem", "truth", "truth_error", "trials"} <= set(answer.data)
    assert any(trial["on_front"] for trial in answer.data["trials"])
    assert (here / "trade.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(contents(here)) == ["trade.json", "trade.png"]


@pytest.mark.parametrize("problem", ["bouncing_ball", "motor_pendulum", "motor_pendulum@corrected"])
@pytest.mark.slow
def test_trade_shows_the_cheapest_values_of_each_accuracy(problem: str) -> None:
    answer = ask("trade", problem, "--quick", "--until", "4.5")
    assert answer.code == YES
    for words in ("cheapest setting", "SciPy LSODA", "plastic below", "Truth:", "Work: 4.5 s"):
        assert words in answer.out


def test_trade_where_nothing_happens_so_soon_is_a_no_in_one_line(here: Path) -> None:
    answer = ask("trade", "bouncing_ball", "--until", "0.1", "-o", "t.json", "--picture", "t.png")
    assert answer.code == NO
    assert answer.out == ""
    assert answer.err.startswith("zeno-orbits: There is nothing to compare")
    assert answer.err.count("\n") == 1
    assert contents(here) == {}


@pytest.mark.parametrize(
    "where",
    ["precision.trials.trade", "report.plots.plot_trade", "report.plots.save_figure"],
)
def test_an_interrupted_trade_writes_nothing(
    where: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"zeno_orbits.{where}", raising(KeyboardInterrupt()))
    answer = ask(*TRADING, "-o", "t.json", "--picture", "t.png")
    assert answer.code == INTERRUPTED
    assert answer.out == ""
    assert answer.err == "zeno-orbits: interrupted; nothing was written\n"
    assert contents(here) == {}


# ------------------------------------------------------------------- problems by their file


@pytest.fixture(name="machine")
def _machine(tmp_path: Path) -> Path:
    """The motor pendulum under another name in another folder."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    bundled = bundled_problems()["motor_pendulum"]
    text = (bundled / "model.py").read_text()
    renamed = text.replace('name="motor_pendulum"', 'name="my_machine"')
    assert renamed != text
    (folder / "my_machine.py").write_text(renamed)
    (folder / "reference.py").write_text((bundled / "reference.py").read_text())
    return Path("..") / "elsewhere" / "my_machine.py"


def test_a_problem_of_ones_own_is_simulated_by_its_path(machine: Path) -> None:
    answer = ask("simulate", machine, "--until", "1", "--json")
    assert answer.code == YES
    assert answer.data["problem"] == "my_machine"


def test_a_problem_of_ones_own_is_searched_verified_and_drawn(machine: Path, here: Path) -> None:
    found = ask("search", machine, *PUBLISHED_GAINS, "-o", "mine.json", "--json")
    assert found.code == YES
    assert found.data["problem"] == "my_machine"
    assert found.data["period"] == pytest.approx(PERIOD, rel=3e-10)
    checked = ask("verify", "mine.json", "--problem", machine, "--json")
    assert checked.code == YES
    assert checked.data["residuals"]["second_model"] < 1e-9
    drawn = ask("plot", "mine.json", "--problem", machine, "--kind", "zeno")
    assert drawn.code == YES
    assert (here / "zeno.png").exists()
    refused = ask("verify", "mine.json")
    assert refused.code == MISUSE
    assert "`my_machine`" in refused.err


# ------------------------------------------------------------------------------ bad input


def assert_refused(answer: Answer, *words: str) -> None:
    """Check that a command refused its input in one line and said nothing else."""
    assert answer.code == MISUSE
    assert answer.out == ""
    assert answer.err.startswith("zeno-orbits: ")
    assert answer.err.endswith("\n")
    assert answer.err.count("\n") == 1
    for word in words:
        assert word in answer.err


def simulating(*arguments: str) -> tuple[str, ...]:
    return ("simulate", "motor_pendulum", *arguments)


def searching(*arguments: str) -> tuple[str, ...]:
    return ("search", "motor_pendulum", "-o", "f.json", *arguments)


BAD_ARGUMENTS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "unknown command": (("frobnicate",), ("frobnicate", "search")),
    "command with a slip": (("serach", "motor_pendulum"), ("`serach`. Did you mean `search`?",)),
    "option with a slip": (searching("--gian", "Kp=2"), ("--gian", "Did you mean `--gain`?")),
    "choice with a slip": (simulating("--engine", "explict"), ("Did you mean `explicit`?",)),
    "problem with a slip": (("search", "motor_pendulm"), ("Did you mean `motor_pendulum`?",)),
    "gain with a slip": (simulating("--gain", "kp=1"), ("`kp`. Did you mean `Kp`?",)),
    "parameter with a slip": (simulating("--set", "restution=0"), ("mean `restitution`?",)),
    "state with a slip": (simulating("--start", "thta2=1"), ("Did you mean `theta2`?",)),
    "objective with a slip": (searching("--objective", "enrgy"), ("Did you mean `energy`?",)),
    "unknown option": (("problems", "--frobnicate"), ("--frobnicate",)),
    "no problem": (("simulate",), ("PROBLEM",)),
    "unknown problem": (("search", "pendulum"), ("`pendulum`", "motor_pendulum")),
    "unknown problem, conditions": (("conditions", "pendulum"), ("`pendulum`", "motor_pendulum")),
    "unknown parameter": (simulating("--set", "m3=1"), ("`m3`", "m2")),
    "unknown gain": (simulating("--gain", "Ki=1"), ("`Ki`", "Kp")),
    "unknown gain to search": (searching("--gain", "Ki=1:2"), ("`Ki`", "Kp")),
    "unknown gain to fix": (searching("--fix", "Ki=1"), ("`Ki`", "Kp")),
    "gain of a problem without gains": (("simulate", "bouncing_ball", "--gain", "Kp=1"), ("`Kp`",)),
    "gain fixed and searched": (searching("--fix", "Kp=2", "--gain", "Kp=1:3"), ("`gain`", "Kp")),
    "gain not a number": (searching("--fix", "Kp=abc"), ("`Kp`", "`abc`")),
    "gain not finite": (searching("--fix", "Kp=inf"), ("`Kp`", "finite")),
    "bounds reversed": (searching("--gain", "Kp=5:1"), ("`Kp`", "5:1")),
    "bounds equal": (searching("--gain", "Kp=2:2"), ("`Kp`", "2:2")),
    "bounds not finite": (searching("--gain", "Kp=1:inf"), ("`Kp`", "inf")),
    "bounds twice": (searching("--gain", "Kp=1:5", "--gain", "Kp=2:3"), ("`Kp`", "twice")),
    "parameter unknown": (searching("--free", "Q=1:2"), ("`free`", "`Q`", "restitution")),
    "parameter beyond its range": (searching("--free", "restitution=0.1:1"), ("`restitution`",)),
    "parameter reversed": (searching("--free", "R=4:2"), ("`R`", "4:2")),
    "parameter starts outside": (searching("--free", "R=2:4", "--set", "R=9"), ("`R`", "9")),
    "parameter without colon": (searching("--free", "R=1"), ("`free`", "LOW:HIGH")),
    "gain free twice": (searching("--free", "Kp=1:2", "--gain", "Kp=1:2"), ("`free`", "Kp")),
    "free and fixed": (searching("--free", "Kp=1:2", "--fix", "Kp=1"), ("`free`", "Kp")),
    "bound unknown": (searching("--keep", "angle=:1"), ("`keep`", "`angle`", "theta2")),
    "bound without colon": (searching("--keep", "theta2=1"), ("`keep`", "LOWER:UPPER")),
    "bound of nothing": (searching("--keep", "theta2=:"), ("`theta2`", "finite")),
    "bound reversed": (searching("--keep", "theta2=2:1"), ("`theta2`", "2:1")),
    "bound twice": (searching("--keep", "period=:2", "--keep", "period=1:"), ("`keep`", "twice")),
    "peak of nothing": (searching("--objective", "peak"), ("`objective`", "peak=SIGNAL")),
    "peak unknown": (searching("--objective", "peak=torque"), ("`torque`", "voltage")),
    "contraction of what is fixed": (
        searching(*PUBLISHED_GAINS, "--objective", "contraction"),
        ("`objective`", "contraction"),
    ),
    "from nowhere": (searching("--from", "none.json"), ("none.json",)),
    "candidates 0": (searching("--candidates", "0"), ("`candidates`", "`0`")),
    "bounds without colon": (searching("--gain", "Kp=1"), ("LOW:HIGH", "`Kp=1`")),
    "bounds not numbers": (searching("--gain", "Kp=a:b"), ("`Kp`", "`a`")),
    "mass negative": (simulating("--set", "m1=-0.3"), ("`m1`", "greater than 0", "-0.3")),
    "mass zero": (simulating("--set", "m1=0"), ("`m1`", "greater than 0")),
    "restitution 1": (simulating("--set", "restitution=1"), ("`restitution`", "[0, 1)")),
    "restitution 1.2": (simulating("--set", "restitution=1.2"), ("`restitution`", "1.2")),
    "restitution -0.1": (simulating("--set", "restitution=-0.1"), ("`restitution`", "-0.1")),
    "restitution nan": (simulating("--set", "restitution=nan"), ("`restitution`", "nan")),
    "restitution inf": (simulating("--set", "restitution=inf"), ("`restitution`", "inf")),
    "restitution 1, conditions": (
        ("conditions", "motor_pendulum", "--set", "restitution=1"),
        ("`restitution`",),
    ),
    "parameter without value": (simulating("--set", "m1"), ("NAME=VALUE", "`m1`")),
    "parameter without name": (simulating("--set", "=1"), ("NAME=VALUE", "`=1`")),
    "parameter not a number": (simulating("--set", "m1=abc"), ("`m1`", "`abc`")),
    "parameter empty": (simulating("--set", "m1="), ("`m1`", "number")),
    "parameter twice": (simulating("--set", "m1=1", "--set", "m1=2"), ("`m1`", "twice")),
    "no rotor inertia: link 2 too long": (
        simulating("--set", "I2=0.02"),
        ("no rotor inertia", "0.355825", "1.48333"),
    ),
    "no rotor inertia: link 1 too long": (
        simulating("--set", "lc1=3"),
        ("no rotor inertia", "J_rotor must not be negative"),
    ),
    "until 0": (simulating("--until", "0"), ("`until`", "positive")),
    "until negative": (simulating("--until", "-1"), ("`until`", "positive")),
    "until nan": (simulating("--until", "nan"), ("`until`", "nan")),
    "until infinite": (simulating("--until", "inf"), ("`until`", "inf")),
    "until not a number": (simulating("--until", "soon"), ("`until`", "`soon`")),
    "unknown state": (simulating("--start", "phi=1"), ("`phi`", "theta1")),
    "start not finite": (simulating("--start", "theta1=nan"), ("`theta1`", "nan")),
    "start inside the stop": (simulating("--start", "theta2=-0.1"), ("gap >= 0", "-0.1")),
    "objective unknown": (searching("--objective", "speed"), ("`objective`", "`speed`", "energy")),
    "objective empty": (searching("--objective", ""), ("`objective`", "energy")),
    "objective twice": (
        searching("--objective", "energy", "--objective", "margin"),
        ("`objective`", "once", "energy, margin"),
    ),
    "number with an underscore": (searching("--fix", "Kp=2_5"), ("`Kp`", "`2_5`")),
    "bounds with an underscore": (searching("--gain", "Kp=1_0:20"), ("`Kp`", "`1_0`")),
    "radius too small": (
        searching("--keep", "spectral_radius=:1e-5"),
        ("`spectral_radius`", "0.0001", ":1e-05"),
    ),
    "period without target": (searching("--objective", "period"), ("period", "number")),
    "period negative": (searching("--objective", "period=-1"), ("`objective`", "-1")),
    "period zero": (searching("--objective", "period=0"), ("`objective`", "positive")),
    "period not finite": (searching("--objective", "period=nan"), ("`objective`", "nan")),
    "amplitude negative": (searching("--objective", "amplitude=-2"), ("`objective`", "-2")),
    "energy with a target": (searching("--objective", "energy=3"), ("`objective`",)),
    "nearest an unknown gain": (searching("--objective", "nearest:Ki=1"), ("`Ki`", "Kp")),
    "nearest a fixed gain": (
        searching("--fix", "Kp=2", "--objective", "nearest:Kp=3"),
        ("`Kp`", "Kd"),
    ),
    "nearest without value": (searching("--objective", "nearest:Kp"), ("NAME=VALUE", "`Kp`")),
    "period with all gains fixed": (
        searching(*PUBLISHED_GAINS, "--objective", "period=1.8"),
        ("`objective`", "free"),
    ),
    "starts 0": (searching("--starts", "0"), ("`starts`", "`0`")),
    "starts negative": (searching("--starts", "-3"), ("`starts`", "`-3`")),
    "seed not a number": (searching("--seed", "x"), ("`seed`", "`x`")),
    "seed negative": (searching("--seed", "-1"), ("seed",)),
    "search into a missing folder": (
        ("search", "motor_pendulum", "-o", "none/f.json"),
        ("`output`", "none/f.json"),
    ),
    "search into a folder": (("search", "motor_pendulum", "-o", "."), ("`output`", "folder")),
    "simulate into a missing folder": (simulating("-o", "none/f.png"), ("`output`", "none/f.png")),
    "simulate into a folder": (simulating("-o", "."), ("`output`", "folder")),
    "simulate into an unknown format": (simulating("-o", "f.gif"), ("`output`", ".png", "f.gif")),
    "simulate into no format": (simulating("-o", "f"), ("`output`", ".png")),
    "conditions into an unknown format": (
        ("conditions", "motor_pendulum", "-o", "f.gif"),
        ("`output`", ".png", "f.gif"),
    ),
    "conditions into a missing folder": (
        ("conditions", "motor_pendulum", "-o", "none/f.png"),
        ("`output`", "none/f.png"),
    ),
    "trade for no time": (("trade", "bouncing_ball", "--until", "0"), ("`until`", "positive")),
    "trade for nan": (("trade", "bouncing_ball", "--until", "nan"), ("`until`", "nan")),
    "trade without end": (("trade", "bouncing_ball", "--until", "inf"), ("`until`", "inf")),
    "trade into a missing folder": (
        ("trade", "bouncing_ball", "-o", "none/t.json"),
        ("`output`", "none/t.json"),
    ),
    "trade drawn into a missing folder": (
        ("trade", "bouncing_ball", "--picture", "none/t.png"),
        ("`picture`", "none/t.png"),
    ),
    "trade drawn in an unknown format": (
        ("trade", "bouncing_ball", "--picture", "t.gif"),
        (".png", "t.gif"),
    ),
    "trade written and drawn into one file": (
        ("trade", "bouncing_ball", "--picture", "t.png", "-o", "t.png"),
        ("`picture`", "t.png"),
    ),
    **{
        f"accuracy {value} of {command[0]}": (
            (*command, f"--accuracy={value}"),
            ("`accuracy`", "[1e-12, 0.01]", f"it is {value}."),
        )
        for command in (simulating("-o", "f.png"), searching(*PUBLISHED_GAINS))
        for value in ("nan", "inf", "0", "-1", "1e-20", "1", "2")
    },
    "accuracy not a number": (simulating("--accuracy", "good"), ("`accuracy`", "`good`")),
    "engine unknown": (simulating("--engine", "euler"), ("`engine`", "`euler`", "implicit")),
    "plot into an unknown format": (("plot", "o.json", "--format", "gif"), ("gif", "svg")),
    "plot an unknown kind": (("plot", "o.json", "--kind", "pie"), ("pie", "portraits")),
    "verify nothing": (("verify",), ("ORBIT.json",)),
    "orbit file missing": (("verify", "none.json"), ("`none.json`", "read")),
    "orbit file missing, plot": (("plot", "none.json", "-o", "pictures"), ("`none.json`", "read")),
    "orbit file a folder": (("verify", "."), ("Orbit file", "read")),
    "problem file missing": (("simulate", "none.py"), ("`none.py`",)),
    "problem a folder without model": (("simulate", "."), ("model.py",)),
}


@pytest.mark.parametrize("case", BAD_ARGUMENTS)
def test_bad_arguments_are_refused_in_one_line(case: str, here: Path) -> None:
    arguments, words = BAD_ARGUMENTS[case]
    assert_refused(ask(*arguments), *words)
    assert contents(here) == {}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("verify", "orbit.json", "--tolerance", "0"), ("`tolerance`", "(0, 1)")),
        (("verify", "orbit.json", "--tolerance=-1e-9"), ("`tolerance`",)),
        (("verify", "orbit.json", "--tolerance", "nan"), ("`tolerance`",)),
        (("verify", "orbit.json", "--tolerance", "1"), ("`tolerance`",)),
        (("verify", "orbit.json", "--periods", "0"), ("`periods`", "`0`")),
        (("verify", "orbit.json", "--model", "guessed"), ("`model`", "reference")),
        (("verify", "orbit.json", "--problem", "bouncing_ball"), ("bouncing_ball",)),
        (("verify", "orbit.json", "--problem", "none.py"), ("`none.py`",)),
        *(
            (("verify", "orbit.json", f"--accuracy={value}"), ("`accuracy`", f"it is {value}."))
            for value in ("nan", "0", "-1", "1e-20", "1", "2")
        ),
        (
            ("verify", "orbit.json", "--engine", "taylor", "--model", "reference"),
            ("formulas", "Taylor"),
        ),
        (("plot", "orbit.json", "--problem", "bouncing_ball", "-o", "p"), ()),
        (("plot", "orbit.json", "-o", "orbit.json"), ("`output`", "folder")),
        (("plot", "orbit.json", "-o", "orbit.json/p"), ("`output`", "folder")),
    ],
    ids=lambda value: " ".join(value[2:]) if value and value[0] in COMMANDS else "",
)
def test_a_good_orbit_with_bad_arguments_is_refused_in_one_line(
    arguments: tuple[str, ...], words: tuple[str, ...], orbit: Path, here: Path
) -> None:
    before = contents(here)
    assert orbit.name in before
    assert_refused(ask(*arguments), *words)
    assert contents(here) == before


@pytest.mark.parametrize("command", [("verify",), ("plot", "-o", "pictures")])
@pytest.mark.parametrize("part", [0.0, 0.001, 0.2, 0.5, 0.9, 0.999])
def test_an_orbit_file_that_is_cut_short_is_refused(
    part: float, command: tuple[str, ...], orbit: Path, here: Path
) -> None:
    text = orbit.read_text().rstrip()
    orbit.write_text(text[: int(part * len(text))])
    before = contents(here)
    assert_refused(ask(*command, orbit.name), "orbit.json", "JSON")
    assert contents(here) == before


def _newer(data: dict[str, Any]) -> Any:
    return {**data, "format": 3}


def _other_format(data: dict[str, Any]) -> Any:
    return {**data, "format": "1"}


def _list(data: dict[str, Any]) -> Any:
    return [data]


def _nan(data: dict[str, Any]) -> Any:
    return {**data, "period": math.nan}


def _nan_inside(data: dict[str, Any]) -> Any:
    return {**data, "release_state": {**data["release_state"], "theta1": math.nan}}


def _infinite_gain(data: dict[str, Any]) -> Any:
    return {**data, "gains": {"Kp": math.inf, "Kd": -1.0}}


def _negative_period(data: dict[str, Any]) -> Any:
    return {**data, "period": -1.0}


def _text_period(data: dict[str, Any]) -> Any:
    return {**data, "period": "1.8"}


def _text_states(data: dict[str, Any]) -> Any:
    return {**data, "zeno_state": "here"}


def _impact_numbers(data: dict[str, Any]) -> Any:
    return {**data, "impacts": [1.0, 2.0]}


def _no_impacts(data: dict[str, Any]) -> Any:
    return {**data, "impacts": []}


def _no_period(data: dict[str, Any]) -> Any:
    return {name: value for name, value in data.items() if name != "period"}


def _missing_state(data: dict[str, Any]) -> Any:
    return {**data, "release_state": {"theta1": 0.2}}


def _missing_gain(data: dict[str, Any]) -> Any:
    return {**data, "gains": {"Kp": 2.5}}


def _unknown_parameter(data: dict[str, Any]) -> Any:
    return {**data, "parameters": {**data["parameters"], "m3": 1.0}}


def _bad_restitution(data: dict[str, Any]) -> Any:
    return {**data, "parameters": {**data["parameters"], "restitution": 1.2}}


def _other_problem(data: dict[str, Any]) -> Any:
    return {**data, "problem": "bouncing_ball"}


def _unknown_problem(data: dict[str, Any]) -> Any:
    return {**data, "problem": "flying_machine"}


def _single_multiplier(data: dict[str, Any]) -> Any:
    return {**data, "floquet_multipliers": [0.1]}


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_newer, ("format 3", "newer")),
        (_other_format, ("`format`",)),
        (_list, ("object",)),
        (_nan, ("`period`", "finite")),
        (_nan_inside, ("`release_state.theta1`", "finite")),
        (_infinite_gain, ("`gains.Kp`", "finite")),
        (_negative_period, ("`period`", "positive")),
        (_text_period, ("`period`", "number")),
        (_text_states, ("`zeno_state`",)),
        (_impact_numbers, ("`impacts`",)),
        (_no_impacts, ("impact",)),
        (_no_period, ("`period`",)),
        (_missing_state, ("theta2",)),
        (_missing_gain, ("Kd",)),
        (_unknown_parameter, ("m3",)),
        (_bad_restitution, ("`restitution`", "1.2")),
        (_other_problem, ()),
        (_unknown_problem, ("`flying_machine`",)),
        (_single_multiplier, ("`floquet_multipliers`",)),
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


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("raise RuntimeError('two\\nlines')", ("RuntimeError", "two lines")),
        ("def broken(:\n    pass\n", ("SyntaxError",)),
        ("import a_module_that_is_nowhere\n", ("a_module_that_is_nowhere",)),
        ("PROBLEM = 3\n", ("PROBLEM",)),
        ("", ("PROBLEM",)),
        ("import sys\nsys.exit(3)\n", ("SystemExit",)),
    ],
    ids=["raises", "syntax", "import", "type", "empty", "exits"],
)
@pytest.mark.parametrize("command", ["simulate", "search", "conditions"])
def test_a_problem_file_that_defines_no_problem_is_refused(
    text: str, words: tuple[str, ...], command: str, here: Path
) -> None:
    (here / "scene.py").write_text(text)
    before = contents(here)
    assert_refused(ask(command, "scene.py"), "`scene.py`", *words)
    assert contents(here) == before


def test_a_problem_file_that_is_no_python_is_refused(here: Path) -> None:
    (here / "problem.txt").write_text("PROBLEM = None\n")
    assert_refused(ask("simulate", "problem.txt"), "`problem.txt`", "Python")


@pytest.mark.parametrize(
    "arguments",
    [
        ("search", "motor_pendulum", "-o", "closed/f.json"),
        ("simulate", "motor_pendulum", "-o", "closed/f.png"),
        ("plot", "orbit.json", "-o", "closed"),
        ("plot", "orbit.json", "-o", "closed/pictures"),
    ],
)
def test_a_closed_folder_is_refused(arguments: tuple[str, ...], orbit: Path, here: Path) -> None:
    closed = here / "closed"
    closed.mkdir(mode=0o500)
    if os.access(closed, os.W_OK):
        pytest.skip("this user may write anywhere")
    assert orbit.exists()
    assert_refused(ask(*arguments), "`output`", "closed")
    assert list(closed.iterdir()) == []


# -------------------------------------------------------------------------------- the help


def examples(command: str) -> list[list[str]]:
    """Return the example lines of a command's help, split as a shell would."""
    answer = ask(command, "--help")
    assert answer.code == YES
    lines = re.findall(r"^  zeno-orbits (.+)$", answer.out, flags=re.MULTILINE)
    return [shlex.split(line) for line in lines]


EVERY = tuple(re.findall(r"^    ([a-z]+)(?: |$)", build_parser().format_help(), flags=re.MULTILINE))


def test_every_command_is_known_to_the_tests_of_its_examples() -> None:
    elsewhere = {"new", "continue", "compare", "identify", "report", "figures"}
    assert set(EVERY) == {*COMMANDS, *elsewhere}


@pytest.mark.parametrize("command", EVERY)
def test_the_help_of_a_command_shows_examples_of_it(command: str) -> None:
    shown = examples(command)
    assert shown
    assert shown[0][0] == command
    assert all(example[0] in EVERY for example in shown)


def test_the_bare_command_prints_the_help_and_is_misuse() -> None:
    assert ask() == Answer(MISUSE, ask("--help").out, "")


def test_the_program_tells_its_version() -> None:
    assert ask("--version") == Answer(YES, f"zeno-orbits {zeno_orbits.__version__}\n", "")


def test_the_help_of_the_program_names_every_command_and_the_exit_codes() -> None:
    answer = ask("--help")
    assert answer.code == YES
    assert "exit codes: 0 yes; 1" in answer.out
    assert "example" in answer.out
    for command in EVERY:
        assert command in answer.out


LONG_WORDS = {"--objective", "reference", "--measure", "trade"}
# The examples of `map` take minutes, and one a cluster: `test_maps.py` runs smaller ones.
EXAMPLES = tuple(
    example for command in COMMANDS if command != "map" for example in examples(command)
)
QUICK = tuple(example for example in EXAMPLES if not LONG_WORDS & set(example))
LONG = tuple(example for example in EXAMPLES if LONG_WORDS & set(example))
HERE = tuple(example for example in LONG if "--scheduler" not in example)
"""Those that need no cluster; `test_cluster` has one."""


@pytest.mark.parametrize("example", QUICK, ids=" ".join)
def test_a_quick_example_of_the_help_runs(example: list[str], orbit: Path) -> None:
    assert orbit.exists()
    assert ask(*example).code == YES


@pytest.mark.parametrize("example", LONG, ids=" ".join)
def test_a_long_example_of_the_help_is_understood(
    example: list[str], orbit: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert orbit.exists()
    reached = raising(ZenoOrbitsError("The work would begin here."))
    monkeypatch.setattr("zeno_orbits.search.search_gains", reached)
    monkeypatch.setattr("zeno_orbits.verification.verifier.verify", reached)
    monkeypatch.setattr("zeno_orbits.precision.trials.trade", reached)
    monkeypatch.setattr("zeno_orbits.precision.reduced_models.reduction_costs", reached)
    answer = ask(*example)
    assert answer.code == NO
    assert answer.err == "zeno-orbits: The work would begin here.\n"


@pytest.mark.slow
@pytest.mark.parametrize("example", HERE, ids=" ".join)
def test_a_long_example_of_the_help_runs(example: list[str], orbit: Path) -> None:
    assert orbit.exists()
    assert ask(*example).code == YES


# -------------------------------------------------------- output, errors and interruptions


@pytest.mark.parametrize(
    "arguments",
    [
        ("problems",),
        ("conditions", "motor_pendulum"),
        ("conditions", "motor_pendulum", "-o", "region.png"),
        ("simulate", "motor_pendulum", "--until", "2"),
        ("simulate", "motor_pendulum", "--until", "2", "-o", "time.png"),
        ("search", "motor_pendulum", *PUBLISHED_GAINS),
        ("verify", "orbit.json", "--periods", "1"),
        ("plot", "orbit.json", "-o", "pictures", "--kind", "portraits"),
    ],
    ids=" ".join,
)
def test_json_is_all_that_standard_output_holds_and_progress_goes_elsewhere(
    arguments: tuple[str, ...], orbit: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert orbit.exists()
    monkeypatch.setattr(progress, "_PATIENCE", 0.0)
    answer = ask(*arguments, "--json")
    assert answer.code == YES
    assert answer.data
    if arguments[0] in ("simulate", "search", "verify"):
        assert re.search(r"^ *\d+\.\d s  \w", answer.err)
    else:
        assert answer.err == ""


@pytest.mark.parametrize(
    "arguments",
    [
        ("map", "motor_pendulum", "--x", "Kp=1:5", "--y", "Kd=-2:0"),
        ("trade", "bouncing_ball"),
        ("continue", "motor_pendulum", "--in", "Kp=2:3"),
    ],
    ids=lambda arguments: arguments[0],
)
@pytest.mark.parametrize("picture", ["a.png", "./a.png"])
def test_a_picture_may_not_be_written_over_the_output(
    arguments: tuple[str, ...], picture: str, here: Path
) -> None:
    answer = ask(*arguments, "-o", "a.png", "--picture", picture)
    assert answer.code == MISUSE
    assert "`picture` must be another file than `output`" in answer.err
    assert contents(here) == {}


def test_work_that_is_done_at_once_shows_no_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_PATIENCE", 1.0)
    assert ask("simulate", "bouncing_ball", "--until", "0.1").err == ""


@pytest.mark.parametrize("where", ["search.search_gains", "verification.verifier.verify"])
def test_an_interrupted_search_says_so_and_writes_nothing(
    where: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"zeno_orbits.{where}", raising(KeyboardInterrupt()))
    answer = ask("search", "motor_pendulum", *PUBLISHED_GAINS, "-o", "f.json")
    assert answer.code == INTERRUPTED
    assert answer.out == ""
    assert answer.err == "zeno-orbits: interrupted; nothing was written\n"
    assert contents(here) == {}


def test_an_unexpected_error_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "zeno_orbits.model.library.load_problem", raising(RuntimeError("two\nlines"))
    )
    answer = ask("simulate", "motor_pendulum")
    assert_refused(answer, "internal error", "RuntimeError: two lines", "--debug")


def test_debug_shows_where_an_error_comes_from(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="pendulum"):
        main(["simulate", "pendulum", "--debug"])
    monkeypatch.setattr(
        "zeno_orbits.model.library.load_problem", raising(RuntimeError("deep inside"))
    )
    with pytest.raises(RuntimeError, match="deep inside"):
        main(["simulate", "motor_pendulum", "--debug"])


def started(*arguments: str | Path, **streams: Any) -> subprocess.Popen[str]:
    """Start the command line in a process of its own, as a shell would."""
    root = str(Path(__file__).resolve().parent.parent)
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.Popen(
        [sys.executable, "-m", "zeno_orbits", *map(str, arguments)],
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        **streams,
    )


def test_the_package_runs_as_a_module() -> None:
    with started("simulate", "bouncing_ball", "--until", "1", "--json") as process:
        out, err = process.communicate(timeout=60)
    assert process.returncode == YES
    assert err == ""
    assert json.loads(out)["problem"] == "bouncing_ball"


def test_misuse_of_the_module_is_an_exit_code_and_one_line() -> None:
    with started("simulate", "bouncing_ball", "--until", "0") as process:
        out, err = process.communicate(timeout=60)
    assert_refused(Answer(process.returncode, out, err), "`until`")


@pytest.mark.parametrize("arguments", [("problems",), ("problems", "--json")], ids=" ".join)
def test_a_reader_who_has_seen_enough_is_no_error(arguments: tuple[str, ...]) -> None:
    with started(*arguments) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        err = process.stderr.read()
    assert process.returncode == YES
    assert err == ""


def closed(*arguments: str | Path, streams: str) -> subprocess.CompletedProcess[str]:
    """Run the command line from a shell, with its streams closed or sent elsewhere."""
    root = str(Path(__file__).resolve().parent.parent)
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    words = shlex.join([sys.executable, "-m", "zeno_orbits", *map(str, arguments)])
    return subprocess.run(
        ["bash", "-c", f"set -o pipefail; {words} {streams}"],
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        check=False,
        timeout=120,
    )


@pytest.mark.parametrize("streams", [">&- 2>&-", "2>/dev/full", "| true"])
def test_an_answer_does_not_depend_on_who_reads_it(
    streams: str, orbit_data: dict[str, Any], here: Path
) -> None:
    _longer_period(orbit_data)
    (here / "false.json").write_text(json.dumps(orbit_data))
    found = closed("verify", here / "false.json", "--periods", "1", streams=streams)
    assert found.returncode == NO
    assert "Error" not in found.stderr


def test_a_yes_and_a_misuse_do_not_depend_on_it_either(here: Path) -> None:
    for streams in (">&-", "2>&-"):
        assert closed("problems", streams=streams).returncode == YES
        assert closed("verify", here / "none.json", streams=streams).returncode == MISUSE


@pytest.mark.parametrize("arguments", [("problems",), ("problems", "--json"), ("--help",)])
def test_an_output_that_finds_no_room_is_no_yes(arguments: tuple[str, ...]) -> None:
    found = closed(*arguments, streams="> /dev/full")
    assert found.returncode == MISUSE
    assert re.fullmatch(r"zeno-orbits: Standard output must take .*No space left.*\n", found.stderr)


def test_an_interrupt_from_the_keyboard_ends_a_search_without_a_file(here: Path) -> None:
    arguments = ("--objective", "period=1.95", "-o", "f.json")
    with started("search", "motor_pendulum", *arguments, cwd=here) as process:
        assert process.stderr is not None
        progress = process.stderr.readline()
        process.send_signal(signal.SIGINT)
        out, rest = process.communicate(timeout=60)
    assert re.match(r" *\d+\.\d s  \w", progress)
    assert process.returncode == INTERRUPTED
    assert out == ""
    assert rest.endswith("zeno-orbits: interrupted; nothing was written\n")
    assert "Traceback" not in rest
    assert contents(here) == {}
