"""An exported problem, compiled and run without Python, gives the execution of `simulate`."""

from __future__ import annotations

import math
import subprocess
from pathlib import Path

import pytest

import zeno_orbits as zo
from tests.loop.agreement import needs_compiler
from tests.support.commands import MISUSE, YES, ask
from tests.support.one_stop import one_stop_problems
from zeno_orbits.simulation import Impact, ZenoPoint, simulate

pytestmark = [needs_compiler, pytest.mark.usefixtures("here")]

STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a folder of the test's own."""
    monkeypatch.chdir(tmp_path)


def _events_of(name: str, *options: str, level: str = "-O1") -> list[tuple[str, list[float]]]:
    """Return what the example program prints: kind, then time and state, of every event."""
    answer = ask("export", name, "-o", "exported", *options)
    assert answer.code == YES, answer.err
    stem = next(Path("exported").glob("*.h")).stem
    words = ["cc", *STRICT, level, "exported/main.c", f"exported/{stem}.c", "-o", "program", "-lm"]
    compiled = subprocess.run(words, capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stderr
    # No variable of Python, nor any other, is there.
    run = subprocess.run(["./program"], capture_output=True, text=True, check=False, env={})
    assert run.returncode == 0, run.stderr
    rows = [line.split() for line in run.stdout.splitlines()]
    return [(kind, [float(number) for number in numbers]) for kind, *numbers in rows]


def _expected(name: str, until: float) -> list[tuple[str, list[float]]]:
    problem = zo.load_problem(name)
    run = simulate(
        problem.dynamics(problem.values()),
        problem.state_vector(problem.starts[0]),
        until=until,
    )
    found: list[tuple[str, list[float]]] = []
    for event in run.events:
        kind = "impact" if isinstance(event, Impact) else "release"
        kind = "zeno" if isinstance(event, ZenoPoint) else kind
        state = event.state_plus if isinstance(event, Impact) else event.state
        found.append((kind, [event.time, *state.tolist()]))
    return found


@pytest.mark.parametrize(
    "name", [pytest.param("curved_surface", marks=pytest.mark.slow), "motor_pendulum"]
)
def test_an_exported_problem_gives_the_same_to_the_last_digit(name: str) -> None:
    found = _events_of(name, "--t-end", "3")
    assert found
    assert found == _expected(name, 3.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", one_stop_problems())
def test_every_bundled_problem_can_be_exported(name: str) -> None:
    assert _events_of(name, "--t-end", "4", level="-O2") == _expected(name, 4.0)


@pytest.mark.slow
def test_numbers_and_start_are_those_that_were_asked_for() -> None:
    options = (
        "--set",
        "restitution=0.7",
        "--set",
        "g=1.62",
        "--initial",
        "height=2",
        "--t-end",
        "40",
    )
    found = _events_of("bouncing_ball", *options)
    fall = math.sqrt(2 * 2 / 1.62)
    assert found[0][0] == "impact"
    assert found[0][1][0] == pytest.approx(fall, rel=1e-14)
    zeno = next(numbers for kind, numbers in found if kind == "zeno")
    assert zeno[0] == pytest.approx(fall * 1.7 / 0.3, rel=1e-11)


@pytest.mark.slow
def test_near_one_impacts_are_followed_one_by_one() -> None:
    found = _events_of("bouncing_ball", "--set", "restitution=0.99", "--t-end", "95")
    fall = math.sqrt(2 / 9.81)
    assert sum(kind == "impact" for kind, _ in found) > 600
    zeno = next(numbers for kind, numbers in found if kind == "zeno")
    assert zeno[0] == pytest.approx(fall * 1.99 / 0.01, rel=1e-10)


def test_an_output_that_is_a_file_is_refused() -> None:
    Path("taken").write_text("", encoding="utf-8")
    answer = ask("export", "bouncing_ball", "-o", "taken")
    assert answer.code == MISUSE
    assert "`taken` is a file" in answer.err


def test_a_time_that_is_not_positive_is_refused() -> None:
    answer = ask("export", "bouncing_ball", "-o", "exported", "--t-end", "-1")
    assert answer.code == MISUSE
    assert not Path("exported").exists()


def test_what_is_written_is_told_to_programs() -> None:
    answer = ask("export", "bouncing_ball", "-o", "exported", "--json")
    assert answer.code == YES
    for name in ("bouncing_ball.c", "bouncing_ball.h", "main.c"):
        assert f"exported/{name}" in answer.out
        assert (Path("exported") / name).is_file()
