"""What all commands share: JSON, progress, errors, interrupts, and streams nobody reads."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.cases import fast
from tests.support.commands import (
    INTERRUPTED,
    MISUSE,
    NO,
    PUBLISHED_GAINS,
    YES,
    Answer,
    ask,
    assert_refused,
    contents,
    raising,
)
from zeno_orbits.cli import main
from zeno_orbits.errors import InputError, StepSizeError, ZenoOrbitsError
from zeno_orbits.report.terminal import progress

pytestmark = pytest.mark.usefixtures("here")


@pytest.mark.parametrize(
    "arguments",
    [
        ("problems",),
        ("zeno-condition", "motor_pendulum"),
        ("zeno-condition", "motor_pendulum", "--plot", "region.png"),
        ("simulate", "motor_pendulum", "--until", "2"),
        ("simulate", "motor_pendulum", "--until", "2", "--plot", "time.png"),
        ("search", "motor_pendulum", *PUBLISHED_GAINS),
        ("verify", "orbit.json", "--periods", "1"),
        ("plot", "orbit.json", "-o", "pictures", "--kind", "portraits"),
    ],
    ids=" ".join,
)
def test_json_is_all_that_standard_output_holds_and_progress_goes_elsewhere(
    arguments: tuple[str, ...], orbit_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert orbit_file.exists()
    monkeypatch.setattr(progress, "_PATIENCE", 0.0)
    answer = ask(*arguments, "--json")
    assert answer.code == YES
    assert answer.data
    if arguments[0] in ("simulate", "search", "verify"):
        assert re.search(r"^ *\d+\.\d s  \w", answer.err)
    else:
        assert answer.err == ""


def test_work_that_is_done_at_once_shows_no_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_PATIENCE", 1.0)
    assert ask("simulate", "bouncing_ball", "--until", "0.1").err == ""


def test_an_unexpected_error_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zeno_orbits.api.known_problem", raising(RuntimeError("two\nlines")))
    answer = ask("simulate", "motor_pendulum")
    assert_refused(answer, "internal error", "RuntimeError: two lines", "--debug")


@pytest.mark.parametrize(
    ("error", "code"),
    [(InputError("no."), MISUSE), (StepSizeError("no", time=1.0, state=()), NO)],
    ids=["input", "outcome"],
)
def test_a_refusal_is_data_for_programs_too(
    error: ZenoOrbitsError, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zeno_orbits.api.known_problem", raising(error))
    answer = ask("work-precision", "motor_pendulum", "--json")
    assert answer.code == code
    assert answer.data == {"error": type(error).__name__, "message": str(error)}
    assert answer.err == f"zeno-orbits: {error}\n"
    assert ask("work-precision", "motor_pendulum").out == ""


def test_an_unexpected_error_is_data_for_programs_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zeno_orbits.api.known_problem", raising(RuntimeError("deep")))
    answer = ask("simulate", "motor_pendulum", "--json")
    assert answer.code == MISUSE
    assert answer.data["error"] == "RuntimeError"
    assert "internal error" in answer.data["message"]


@pytest.mark.slow
def test_a_refusal_is_told_where_there_is_no_room_for_its_data(here: Path) -> None:
    command = [sys.executable, "-m", "zeno_orbits", "verify", "none.json", "--json"]
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        ended = subprocess.run(
            command, check=False, cwd=here, stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert ended.returncode == MISUSE
    assert ended.stderr.count("\n") == 1
    assert "none.json" in ended.stderr


def test_debug_shows_where_an_error_comes_from(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="pendulum"):
        main(["simulate", "pendulum", "--debug"])
    monkeypatch.setattr("zeno_orbits.api.known_problem", raising(RuntimeError("deep inside")))
    with pytest.raises(RuntimeError, match="deep inside"):
        main(["simulate", "motor_pendulum", "--debug"])


def started(*arguments: str | Path, **streams: Any) -> subprocess.Popen[str]:
    """Start the command line in a process of its own, as a shell would."""
    root = str(Path(__file__).resolve().parents[2])
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.Popen(
        [sys.executable, "-m", "zeno_orbits", *map(str, arguments)],
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        **streams,
    )


@pytest.mark.slow
def test_the_package_runs_as_a_module() -> None:
    with started("simulate", "bouncing_ball", "--until", "1", "--json") as process:
        out, err = process.communicate(timeout=60)
    assert process.returncode == YES
    # Progress is shown on a slow machine.
    assert all("simulating" in line for line in err.splitlines())
    assert json.loads(out)["problem"] == "bouncing_ball"


@pytest.mark.slow
def test_misuse_of_the_module_is_an_exit_code_and_one_line() -> None:
    with started("simulate", "bouncing_ball", "--until", "0") as process:
        out, err = process.communicate(timeout=60)
    assert_refused(Answer(process.returncode, out, err), "--until 0: ")


@pytest.mark.slow
@pytest.mark.parametrize("words", fast(1, ["problems", "problems --json"]))
def test_a_reader_who_has_seen_enough_is_no_error(words: str) -> None:
    with started(*words.split()) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        err = process.stderr.read()
    assert process.returncode == YES
    assert err == ""


def closed(*arguments: str | Path, streams: str) -> subprocess.CompletedProcess[str]:
    """Run the command line from a shell, with its streams closed or sent elsewhere."""
    root = str(Path(__file__).resolve().parents[2])
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


@pytest.mark.slow
@pytest.mark.parametrize("streams", fast(1, ["| true", ">&- 2>&-", "2>/dev/full"]))
def test_an_answer_does_not_depend_on_who_reads_it(
    streams: str, orbit_data: dict[str, Any], here: Path
) -> None:
    orbit_data["period"] *= 1 + 1e-6
    (here / "false.json").write_text(json.dumps(orbit_data))
    found = closed("verify", here / "false.json", "--periods", "1", streams=streams)
    assert found.returncode == NO
    assert "Error" not in found.stderr


@pytest.mark.slow
def test_a_yes_and_a_misuse_do_not_depend_on_it_either(here: Path) -> None:
    for streams in (">&-", "2>&-"):
        assert closed("problems", streams=streams).returncode == YES
        assert closed("verify", here / "none.json", streams=streams).returncode == MISUSE


@pytest.mark.slow
@pytest.mark.parametrize("words", fast(1, ["problems", "problems --json", "--help"]))
def test_an_output_that_finds_no_room_is_no_yes(words: str) -> None:
    found = closed(*words.split(), streams="> /dev/full")
    assert found.returncode == MISUSE
    assert re.fullmatch(
        r"zeno-orbits: Standard output is not writable.*No space left.*\n", found.stderr
    )


@pytest.mark.slow
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
    assert rest.endswith("zeno-orbits: interrupted, nothing was written\n")
    assert "Traceback" not in rest
    assert contents(here) == {}


def test_what_an_interrupt_leaves_half_done_is_told_as_an_interrupt(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def half_done(_: Any) -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            # As a library does that is interrupted while it is imported.
            raise AttributeError("module 'sympy' has no attribute 'core'") from None

    monkeypatch.setattr("zeno_orbits.report.terminal.print_problems", half_done)
    assert ask("problems") == Answer(
        INTERRUPTED, "", "zeno-orbits: interrupted, nothing was written\n"
    )
