"""Continuations by many workers: the same families as by one, kept over kills."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest

from tests.support.commands import ask, interrupted_when
from tests.support.places import places_that_cannot_be_had, refuses
from tests.support.processes import Commands, workers_of
from zeno_orbits.continuation import (
    ContinuationSettings,
    CurveSteps,
    FamilySteps,
    SecondParameter,
    SpecialPointKind,
    WorkerPool,
    family_of_orbit,
    start_orbit,
)
from zeno_orbits.continuation import parallel as dispatch
from zeno_orbits.errors import CheckpointError, InputError, WorkError
from zeno_orbits.model import locate_problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.work import (
    Cluster,
    ExecutionPlan,
    FailedPoint,
    Workers,
    open_pool,
    silent,
    to_plain,
)
from zeno_orbits.work import scheduling as spreading_module

YES, MISUSE, INTERRUPTED = 0, 2, 130
CORES = int(joblib.cpu_count())
PROBLEM = "forced_oscillator"
IMPACTS = (
    *("continue", PROBLEM, "--section", "impact", "--set", "c=0.1", "--set", "stop=1"),
    *("--set", "restitution=0.8", "--start", "speed=1", "--start", "cosine=1"),
)
NEAR = (*IMPACTS, "--parameter", "A=0.8:1.1", "--max-points", "12")
"""A family that takes a second."""

needs_two = pytest.mark.skipif(CORES < 2, reason="needs two cores")


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.fixture(name="kept", scope="module")
def _kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A finished continuation that kept its checkpoint, and what it printed."""
    folder = tmp_path_factory.mktemp("kept") / "kept"
    answer = ask(*NEAR, "--workers", "1", "--checkpoint", folder, "--json")
    assert answer.code == YES
    return folder, answer.data


def oscillator() -> tuple[Any, Orbit]:
    # Plastic impacts, of which a return has one.
    problem = locate_problem(PROBLEM).load()
    return problem, start_orbit(problem, problem.values(parameters={"restitution": 0.0}))


def crewed(place: Workers | Cluster | None, folder: Path | None = None) -> Any:
    """Follow the loss of the release in two parameters; without a place, in this process."""
    problem, orbit = oscillator()
    told: dict[str, Any] = {
        "second": SecondParameter(
            name="stop", box=(-0.85, -0.75), kinds=(SpecialPointKind.RELEASE_LOST,)
        ),
        "settings": ContinuationSettings(
            steps=FamilySteps(first=0.1, longest=0.2),
            curve=CurveSteps(first=0.2, longest=0.2, most=2),
        ),
    }
    asked = (problem, orbit, "A", (0.7, 1.05))
    if place is None:
        return family_of_orbit(*asked, **told)
    with open_pool(place) as pool:
        crew = WorkerPool(
            problem_file=locate_problem(PROBLEM),
            plan=ExecutionPlan(place=place, checkpoint=folder),
            pool=pool,
            on_progress=silent,
        )
        return family_of_orbit(*asked, **told, crew=crew)


# ---------------------------------------------------------------------------- the same results


@needs_two
@pytest.mark.slow
def test_one_worker_and_two_find_what_a_continuation_without_workers_finds() -> None:
    alone = crewed(None)
    # In closed form: the force just reaches the stop.
    (curve,) = alone.boundaries
    assert len(curve.x) > 3
    assert np.array(curve.x) == pytest.approx(-np.array(curve.y), abs=1e-11)
    for count in (1, 2):
        assert to_plain(crewed(Workers(count=count))) == to_plain(alone)


@needs_two
@pytest.mark.slow
def test_the_command_writes_the_same_bytes_with_one_worker_and_two(tmp_path: Path) -> None:
    one, two = tmp_path / "one.json", tmp_path / "two.json"
    assert ask(*NEAR, "--workers", "1", "-o", one).code == YES
    assert ask(*NEAR, "--workers", "2", "-o", two).code == YES
    assert one.read_bytes() == two.read_bytes()
    # The checkpoints beside them went with their work.
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.json", "two.json"]


# ---------------------------------------------------------------------------- what is lost


@pytest.mark.slow
def test_a_direction_that_kills_every_worker_is_an_end_that_was_given_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    spread = dispatch.parallel_map

    def lose_the_second(*arguments: Any, **named: Any) -> Any:
        return (*spread(*arguments, **named)[:1], FailedPoint())

    monkeypatch.setattr(dispatch, "parallel_map", lose_the_second)
    answer = ask(*NEAR, "--workers", "1", "--json")
    assert answer.code == 1
    first, last = answer.data["families"][0]["ends"]
    assert (first["kind"], first["detail"]) == ("gave up", FailedPoint().reason)
    assert last["kind"] != "gave up"


# ---------------------------------------------------------------------------- checkpoints


def test_what_is_finished_is_not_done_again(
    kept: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, told = kept
    before = contents(folder)
    assert sorted(before) == [
        "directions/chunk-000000.json",
        "directions/chunk-000001.json",
        "directions/identity.json",
        "identity.json",
    ]

    def refuse(*_: Any) -> None:
        raise WorkError("It is done again")

    monkeypatch.setattr("zeno_orbits.work.pools._CorePool.submit", refuse)
    assert ask(*NEAR, "--checkpoint", folder, "--json").data == told
    assert contents(folder) == before


@pytest.mark.slow
def test_a_job_that_was_lost_is_done_again_and_gives_the_same(
    kept: tuple[Path, dict[str, Any]],
) -> None:
    folder, told = kept
    before = contents(folder)
    (folder / "directions" / "chunk-000001.json").unlink()
    assert ask(*NEAR, "--workers", "1", "--checkpoint", folder, "--json").data == told
    assert contents(folder) == before


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((*NEAR[:-1], "11"), "`settings.steps.most` is 12, not 11"),
        ((*NEAR[:-4], "--parameter", "A=0.8:1.2", "--max-points", "12"), "`range` is"),
        (
            (*NEAR[:-4], "--parameter", "omega=0.9:1.1", "--max-points", "12"),
            '`in` is "A", not "omega"',
        ),
        ((*NEAR, "--set", "omega=1.01"), "`parameters.omega` is 1.0, not 1.01"),
        (("continue", "motor_pendulum", "--parameter", "Kd=-1.1:-0.9"), '`problem` is "forced_osc'),
        (("map", "bouncing_ball", "--x", "m=1:2", "--y", "g=9:10"), '`work` is "continuation"'),
    ],
)
def test_the_checkpoint_of_another_continuation_is_refused_and_left_untouched(
    words: tuple[str, ...], told: str, kept: tuple[Path, dict[str, Any]]
) -> None:
    folder, _ = kept
    before = contents(folder)
    answer = ask(*words, "--workers", "1", "--checkpoint", folder)
    assert answer.code == MISUSE
    assert told in answer.err
    assert len(answer.err.splitlines()) == 1
    assert contents(folder) == before


def test_the_checkpoint_of_another_version_and_a_broken_one_are_refused(
    kept: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, _ = kept
    words = (*NEAR, "--workers", "1", "--checkpoint", folder)
    with monkeypatch.context() as patch:
        patch.setattr(spreading_module, "code_digest", lambda: "another")
        answer = ask(*words)
    assert (answer.code, "`code` is" in answer.err) == (MISUSE, True)
    chunk = folder / "directions" / "chunk-000000.json"
    whole = chunk.read_bytes()
    chunk.write_bytes(whole[: len(whole) // 2])
    answer = ask(*words)
    assert answer.code == MISUSE
    assert "`chunk-000000.json` is broken" in answer.err
    assert len(chunk.read_bytes()) == len(whole) // 2
    chunk.write_bytes(whole)


@pytest.mark.slow
def test_an_interrupt_keeps_the_jobs_that_are_finished(
    tmp_path: Path, kept: tuple[Path, dict[str, Any]]
) -> None:
    words = (*NEAR, "--workers", "1", "-o", tmp_path / "family.json", "--json")

    with interrupted_when(lambda stage, _: stage.startswith("1 of 2 directions")):
        answer = ask(*words)
    assert answer.code == INTERRUPTED
    assert (
        "family.json.checkpoint` keeps the finished work: the same command continues" in answer.err
    )
    assert len(list((tmp_path / "family.json.checkpoint").rglob("chunk-*"))) == 1
    assert ask(*words).data == kept[1]
    assert [path.name for path in tmp_path.iterdir()] == ["family.json"]


def test_an_interrupt_with_nothing_finished_leaves_no_checkpoint_behind(tmp_path: Path) -> None:
    with interrupted_when(lambda stage, _: "directions" in stage):
        assert ask(*NEAR, "--workers", "1", "-o", tmp_path / "family.json").code == INTERRUPTED
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------------------- misuse


@pytest.mark.slow
@places_that_cannot_be_had
def test_a_place_that_cannot_be_had_is_refused_and_the_checkpoint_left_untouched(
    place: tuple[str, ...],
    told: str,
    kept: tuple[Path, dict[str, Any]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder, _ = kept
    before = contents(folder)
    begins = "zeno_orbits.continuation.family_of_impacts"
    refuses(monkeypatch, (*NEAR, "--checkpoint", folder, *place), told, work_of=begins)
    assert contents(folder) == before


def test_a_problem_that_workers_would_not_see_is_refused(tmp_path: Path) -> None:
    problem, orbit = oscillator()
    with open_pool(Workers(count=1)) as pool:
        crew = WorkerPool(
            problem_file=locate_problem("bouncing_ball"),
            plan=ExecutionPlan(checkpoint=tmp_path / "kept"),
            pool=pool,
            on_progress=silent,
        )
        with pytest.raises(
            InputError, match="`problem` must be the problem that the workers of `crew` load"
        ):
            family_of_orbit(problem, orbit, "A", (0.5, 1.2), crew=crew)
    assert not (tmp_path / "kept").exists()


@pytest.mark.slow
def test_a_stage_of_another_work_in_the_folder_is_refused(tmp_path: Path) -> None:
    crewed(Workers(count=1), tmp_path / "kept")
    stage = tmp_path / "kept" / "curves-1" / "identity.json"
    entries = json.loads(stage.read_text()) | {"jobs": "others"}
    stage.write_text(json.dumps(entries))
    before = contents(tmp_path / "kept")
    with pytest.raises(CheckpointError, match='`jobs` is "others"'):
        crewed(Workers(count=1), tmp_path / "kept")
    assert contents(tmp_path / "kept") == before


# ---------------------------------------------------------------------------- killed


LONG = ("continue", PROBLEM, "--parameter", "A=0.5:1.2", "--parameter2", "stop=-0.9:-0.7")


@needs_two
@pytest.mark.weekly
@pytest.mark.slow
def test_a_continuation_by_two_workers_one_killed_and_then_all_is_that_of_one_worker(
    tmp_path: Path, commands: Commands
) -> None:
    quiet, killed = tmp_path / "quiet.json", tmp_path / "killed.json"

    def wait_for(count: int) -> None:
        end = time.monotonic() + 240
        while len(list(kept.rglob("chunk-*.json"))) < count:
            assert time.monotonic() < end
            time.sleep(0.01)

    kept = tmp_path / "killed.json.checkpoint"
    assert commands.start(*LONG, "--workers", "1", "-o", quiet).wait(400) == YES
    program = commands.start(*LONG, "--workers", "2", "-o", killed)
    wait_for(1)
    os.kill(workers_of(program.pid)[0], signal.SIGKILL)
    wait_for(2)
    program.kill()
    program.wait()
    assert not killed.exists()
    assert len(list(kept.rglob("chunk-*.json"))) < 4
    assert commands.start(*LONG, "--workers", "2", "-o", killed).wait(400) == YES
    assert killed.read_bytes() == quiet.read_bytes()
    assert not kept.exists()
