"""Searches by many workers: the same answer as by one, kept over kills, and nobody else's."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import joblib
import pytest

from tests.support.commands import ask, interrupted_when
from tests.support.places import places_that_cannot_be_had, refuses
from tests.support.processes import Commands
from zeno_orbits import MaxMargin
from zeno_orbits.errors import CheckpointError, InputError
from zeno_orbits.model import locate_problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.search import (
    SearchResult,
    SearchSettings,
    SearchStatus,
    StartWorkers,
    Verdict,
    search_orbits,
)
from zeno_orbits.verification import verify
from zeno_orbits.work import ExecutionPlan, FailedPoint, Workers, spread_in_order, to_plain
from zeno_orbits.work import scheduling as spreading_module

YES, NO, MISUSE, INTERRUPTED = 0, 1, 2, 130
CORES = int(joblib.cpu_count())
PROBLEM = "vibrating_table"
STARTS = "zeno_orbits.search.starts.multistart"
FREE = {"restitution": (0.2, 0.5)}
TABLE = ("search", PROBLEM, "--vary", "restitution=0.2:0.5")
"""A search whose every start finds an orbit."""
BALL = ("search", "bouncing_ball", "--vary", "m=1:2", "--n-starts", "3")
"""A search whose no start finds one."""

needs_two = pytest.mark.skipif(CORES < 2, reason="needs two cores")


@dataclass(frozen=True, slots=True, kw_only=True)
class Picky:
    """Verifies orbits, but for those at one restitution.

    Attributes:
        refused: The restitution.
    """

    refused: float = 0.0

    def __call__(self, orbit: Orbit) -> Verdict:
        """Return the objection, or the certificate."""
        if orbit.parameters["restitution"] == self.refused:
            return Verdict(objection="It is the usual one.")
        return Verdict(certificate=verify(orbit, locate_problem(PROBLEM).load()))


def search(place: Workers | None, *, folder: Path | None = None, **changes: Any) -> SearchResult:
    """Search the table for several orbits; without a place, in this process alone."""
    problem_file = locate_problem(PROBLEM)
    spread = None
    if place is not None:
        spread = StartWorkers(
            problem_file=problem_file, plan=ExecutionPlan(place=place, checkpoint=folder)
        )
    settings = SearchSettings(n_starts=2, candidates=4, seed=changes.pop("seed", 0))
    told: dict[str, Any] = {"accept": Picky(), "settings": settings, **changes}
    problem = problem_file.load()
    return search_orbits(problem, problem.values(), free=FREE, spread=spread, **told)


def timeless(result: SearchResult) -> Any:
    """Return everything that a search promises but the time it took, as comparable data."""
    return to_plain(replace(result, wall_time=0.0, solve_time=0.0))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.fixture(name="alone", scope="module")
def _alone() -> SearchResult:
    """What the search finds without workers."""
    return search(None)


@pytest.fixture(name="kept", scope="module")
def _kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A finished search that kept its checkpoint, and what it printed."""
    folder = tmp_path_factory.mktemp("kept") / "kept"
    answer = ask(*BALL, "--workers", "1", "--checkpoint", folder, "--json")
    assert answer.code == NO
    return folder, answer.data


# ---------------------------------------------------------------------------- the same answer


@needs_two
@pytest.mark.slow
def test_one_worker_and_two_find_what_a_search_without_workers_finds(alone: SearchResult) -> None:
    # All lead to the restitution of the first, from which two of them may differ by more than 1e-6.
    assert len(alone.attempts) == sum(one.starts for one in alone.candidates) == 3
    assert timeless(search(Workers(count=1))) == timeless(alone)
    assert timeless(search(Workers(count=2))) == timeless(alone)


@needs_two
@pytest.mark.slow
def test_an_optimum_is_the_same_whoever_looks_at_the_box() -> None:
    asked = {"objective": MaxMargin(), "settings": SearchSettings(n_starts=3)}
    here = search(None, **asked)
    assert here.candidates
    assert timeless(search(Workers(count=2), **asked)) == timeless(here)


@pytest.mark.slow
@needs_two
def test_the_command_prints_the_same_bytes_for_one_worker_and_two() -> None:
    for words, code in ((TABLE, YES), (BALL, NO)):
        more = (*words, "--candidates", "9", "--n-starts", "3", "--json")
        one, two = (ask(*more, "--workers", count) for count in ("1", "2"))
        assert one.code == two.code == code
        assert one.out == two.out != ""


@pytest.mark.slow
def test_the_first_start_that_is_accepted_ends_the_search_though_more_are_under_way() -> None:
    # Every start ends near the restitution of the first, and only the first one at it.
    one = SearchSettings(n_starts=6, candidates=1)
    result = search(Workers(count=min(CORES, 2)), accept=Picky(refused=0.3), settings=one)
    ends = [attempt.status for attempt in result.attempts]
    assert ends == [SearchStatus.NOT_ACCEPTED, SearchStatus.FOUND]
    assert timeless(result) == timeless(search(None, accept=Picky(refused=0.3), settings=one))


def test_a_search_that_ends_at_its_first_start_begins_no_worker(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(_place: Workers) -> None:
        raise OSError("a pool is opened")

    monkeypatch.setattr(spreading_module, "open_pool", refuse)
    assert ask(*TABLE).code == YES
    answer = ask(*BALL)
    assert (answer.code, "a pool is opened" in answer.err) == (MISUSE, True)


@pytest.mark.slow
def test_a_seed_repeats_its_starts_and_another_has_others() -> None:
    def tried(seed: str) -> list[float]:
        answer = ask(*BALL, "--workers", "1", "--seed", seed, "--json")
        return [attempt["parameters"]["m"] for attempt in answer.data["attempts"]]

    first = tried("1")
    assert tried("1") == first
    other = tried("2")
    # Where no place of the box has an orbit, the first is tried once more from easier numbers.
    assert other[:2] == first[:2] == [1.0, 1.0]
    assert not {*other[2:]} & {*first[2:]}


@pytest.mark.slow
def test_a_start_that_kills_every_worker_is_a_failure_by_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def lose_the_second(*arguments: Any, **named: Any) -> Iterator[Any]:
        for k, result in enumerate(spread_in_order(*arguments, **named)):
            yield FailedPoint() if k == 1 else result

    monkeypatch.setattr(f"{STARTS}.spread_in_order", lose_the_second)
    result = search(Workers(count=1))
    found = [attempt.status is SearchStatus.FOUND for attempt in result.attempts]
    assert found == [True, False, True]
    assert result.attempts[1].detail == FailedPoint().reason


# ---------------------------------------------------------------------------- checkpoints


def test_what_is_finished_is_not_tried_again(
    kept: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, told = kept
    before = contents(folder)
    assert len([name for name in before if name.startswith("chunk")]) == 4

    def refuse(*_: Any) -> None:
        raise OSError("it is tried again")

    monkeypatch.setattr(f"{STARTS}.try_start", refuse)
    monkeypatch.setattr(spreading_module, "open_pool", refuse)
    assert ask(*BALL, "--checkpoint", folder, "--json").data == told
    assert contents(folder) == before


@pytest.mark.slow
@pytest.mark.parametrize("chunk", [0, 2])
def test_a_start_that_was_lost_is_tried_again_and_gives_the_same(
    chunk: int, kept: tuple[Path, dict[str, Any]]
) -> None:
    folder, told = kept
    (folder / f"chunk-{chunk:06d}.json").unlink()
    assert ask(*BALL, "--workers", "1", "--checkpoint", folder, "--json").data == told
    assert (folder / f"chunk-{chunk:06d}.json").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((*BALL, "--seed", "1"), "`settings.seed` is 0, not 1"),
        ((*BALL[:-1], "4"), "`settings.n_starts` is 3, not 4"),
        ((*BALL, "--candidates", "2"), "`settings.candidates` is 1, not 2"),
        ((*BALL, "--set", "restitution=0.4"), "`parameters.restitution` is"),
        ((*BALL, "--objective", "nearest:m=1.5"), "`parameters.m` is 1.0, not 1.5"),
        ((*BALL, "--objective", "period=2"), "`objective.kind` is"),
        ((*BALL, "--bounds", "period=:2"), "`bounds` is []"),
        ((*BALL, "--allow-unstable"), "`accept.allow_unstable` is false, not true"),
        ((*BALL, "--accuracy", "1e-5"), "`settings.transcription.mesh_tolerance` is"),
        ((*BALL, "--engine", "implicit"), "`accept.settings.simulation.engine.kind` is"),
        (("search", "bouncing_ball", "--vary", "m=1:3", "--n-starts", "3"), "`free.m` is"),
        ((*TABLE, "--n-starts", "3"), '`problem` is "bouncing_ball"'),
        (("map", "bouncing_ball", "--x", "m=1:2", "--y", "g=9:10"), '`work` is "search"'),
    ],
)
def test_the_checkpoint_of_another_search_is_refused_and_left_untouched(
    words: tuple[str, ...], told: str, kept: tuple[Path, dict[str, Any]]
) -> None:
    folder, _ = kept
    before = contents(folder)
    answer = ask(*words, "--workers", "1", "--checkpoint", folder)
    assert answer.code == MISUSE
    assert told in answer.err
    assert contents(folder) == before


def test_the_checkpoint_of_another_known_orbit_is_refused(
    alone: SearchResult, tmp_path: Path
) -> None:
    orbit = alone.unwrap()
    folder = tmp_path / "kept"
    search(Workers(count=1), folder=folder, near=orbit, settings=SearchSettings(n_starts=0))
    other = replace(orbit, period=math.nextafter(orbit.period, 10.0))
    with pytest.raises(CheckpointError, match=r"`from\.period` is"):
        search(Workers(count=1), folder=folder, near=other, settings=SearchSettings(n_starts=0))


@pytest.mark.slow
def test_the_checkpoint_beside_the_output_goes_when_there_is_an_answer(tmp_path: Path) -> None:
    assert ask(*TABLE, "-o", tmp_path / "orbit.json").code == YES
    assert [path.name for path in tmp_path.iterdir()] == ["orbit.json"]
    assert ask(*BALL, "--workers", "1", "-o", tmp_path / "ball.json").code == NO
    assert [path.name for path in tmp_path.iterdir()] == ["orbit.json"]


@pytest.mark.slow
def test_an_interrupt_keeps_the_starts_that_are_finished(
    tmp_path: Path, kept: tuple[Path, dict[str, Any]]
) -> None:
    words = (*BALL, "--workers", "1", "-o", tmp_path / "ball.json", "--json")

    with interrupted_when(lambda _, part: part >= 0.5):
        answer = ask(*words)
    assert answer.code == INTERRUPTED
    assert "ball.json.checkpoint` keeps the finished work: the same command continues" in answer.err
    assert len(list((tmp_path / "ball.json.checkpoint").glob("chunk-*"))) == 2
    assert ask(*words).data == kept[1]
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------------------- misuse


@places_that_cannot_be_had
def test_a_place_that_cannot_be_had_is_refused_even_if_one_start_would_do(
    place: tuple[str, ...], told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuses(monkeypatch, (*TABLE, *place), told, work_of=f"{STARTS}.try_start")


def test_a_problem_that_workers_would_not_see_is_refused() -> None:
    problem = locate_problem(PROBLEM)
    other = replace(problem.load())
    with pytest.raises(
        InputError, match="`problem` must be the problem that the workers of `spread` load"
    ):
        search_orbits(
            other,
            other.values(),
            free=FREE,
            spread=StartWorkers(problem_file=problem, plan=ExecutionPlan()),
        )


def test_a_judge_that_has_no_name_cannot_be_told_from_another_by_a_checkpoint(
    tmp_path: Path,
) -> None:
    with pytest.raises(InputError, match="`accept` must consist of"):
        search(Workers(count=1), folder=tmp_path / "kept", accept=lambda _: Verdict())


# ---------------------------------------------------------------------------- the pendulum

LONG = (
    *("search", "motor_pendulum", "--vary", "Kp=2:3", "--vary", "Kd=-1.2:-0.8"),
    *("--objective", "period=1.8", "--candidates", "9", "--n-starts", "4", "--json"),
)


@pytest.mark.weekly
@needs_two
@pytest.mark.slow
@pytest.mark.parametrize("signal_", [signal.SIGKILL])
def test_a_search_that_is_killed_in_the_middle_ends_at_the_same_bytes(
    signal_: signal.Signals, tmp_path: Path, commands: Commands
) -> None:
    def start(folder: Path, workers: int, out: Path) -> subprocess.Popen[bytes]:
        with out.open("wb") as stream:
            place = ("--workers", str(workers), "--checkpoint", folder)
            return commands.start(*LONG, *place, stdout=stream)

    quiet, out = tmp_path / "quiet.json", tmp_path / "out.json"
    assert start(tmp_path / "quiet", 1, quiet).wait(300) == YES
    kept = tmp_path / "kept"
    program = start(kept, 2, out)
    end = time.monotonic() + 120
    while len(list(kept.glob("chunk-*.json"))) < 2:
        assert time.monotonic() < end
        time.sleep(0.01)
    program.send_signal(signal_)
    assert program.wait(60) in (-signal.SIGKILL, INTERRUPTED)
    assert out.read_bytes() == b""
    assert len(list(kept.glob("chunk-*.json"))) < 5
    assert start(kept, 2, out).wait(300) == YES
    assert out.read_bytes() == quiet.read_bytes()
    assert json.loads(out.read_text())["candidates"]
