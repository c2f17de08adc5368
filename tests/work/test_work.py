"""Work spread over processes: the same results whoever computes them, and whoever is killed."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import joblib
import pytest
from joblib.externals.loky import ProcessPoolExecutor

from tests.support import chores
from tests.support.chores import Deadly, Diary
from zeno_orbits.errors import CheckpointError, InputError, WorkError
from zeno_orbits.work import ExecutionPlan, FailedPoint, Workers, parallel_map, spread_in_order
from zeno_orbits.work import scheduling as spreading_module

CORES = int(joblib.cpu_count())
TWO = Workers(count=min(CORES, 2))
POINTS = [0.1 * k for k in range(24)]
IDENTITY = {"command": "test", "settings": {"until": 60.0, "seed": 0}}

needs_two = pytest.mark.skipif(CORES < 2, reason="needs two cores")


def plan(folder: Path | None = None, *, place: Workers = TWO, **changes: Any) -> ExecutionPlan:
    return ExecutionPlan(place=place, chunk=4, checkpoint=folder, identity={**IDENTITY, **changes})


def alone(points: Sequence[float] = POINTS) -> list[dict[str, Any]]:
    """What the diary says of every point, without any machinery."""
    sums = [sum(points[k : k + 4]) for k in range(0, len(points), 4)]
    return [{"point": p / 3, "sum": sums[k // 4]} for k, p in enumerate(points)]


def wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end, "nothing happens"
        time.sleep(0.01)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.fixture(name="diary")
def _diary(tmp_path: Path) -> Diary:
    folder = tmp_path / "diary"
    folder.mkdir()
    return Diary(folder=str(folder))


# ---------------------------------------------------------------------------- results


@pytest.mark.slow
@needs_two
def test_one_worker_and_two_return_what_the_task_itself_returns(diary: Diary) -> None:
    for count in (1, 2):
        assert list(parallel_map(diary, POINTS, plan(place=Workers(count=count)))) == alone()


@pytest.mark.slow
def test_a_last_chunk_may_be_short_and_no_points_need_no_worker(diary: Diary) -> None:
    assert list(parallel_map(diary, POINTS[:10], plan())) == alone(POINTS[:10])
    assert parallel_map(diary, [], plan()) == ()


@pytest.mark.slow
def test_results_are_what_comes_out_of_json_with_or_without_a_checkpoint(tmp_path: Path) -> None:
    points = [0.1, 5e-324, 1.7976931348623157e308, -0.0]
    fresh = parallel_map(chores.echo, points, plan(tmp_path / "kept"))
    again = parallel_map(chores.echo, points, plan(tmp_path / "kept"))
    assert fresh == again == tuple([point.hex(), [point]] for point in points)
    assert str(fresh[-1][1][0]) == "-0.0"


@pytest.mark.slow
def test_every_core_is_used_if_nothing_is_said(diary: Diary) -> None:
    slow = Diary(folder=diary.folder, pause=0.2)
    parallel_map(slow, POINTS, ExecutionPlan(chunk=1))
    assert 1 <= len(slow.workers()) <= CORES
    assert CORES < 2 or len(slow.workers()) > 1


@pytest.mark.slow
def test_numerical_libraries_get_one_thread_in_a_worker(tmp_path: Path) -> None:
    assert parallel_map(chores.environment, [1.0], plan(tmp_path / "kept"))[0] == ["1", "1", "1"]


@pytest.mark.slow
def test_progress_is_told_up_to_the_end(diary: Diary) -> None:
    told: list[tuple[str, float]] = []
    parallel_map(diary, POINTS, plan(), on_progress=lambda what, part: told.append((what, part)))
    parts = [part for _, part in told]
    assert parts == sorted(parts)
    assert parts[0] == 0.0
    assert told[-1] == ("24 of 24 points", 1.0)


@pytest.mark.slow
def test_progress_goes_by_points_inside_a_chunk_that_tells_it() -> None:
    told: list[tuple[str, float]] = []
    whole = ExecutionPlan(place=Workers(count=1), chunk=8)
    parallel_map(chores.telling, POINTS[:8], whole, on_progress=lambda *one: told.append(one))
    parts = [part for _, part in told]
    assert parts == sorted(parts)
    assert len({part for part in parts if 0.0 < part < 1.0}) >= 3
    assert told[-1] == ("8 of 8 points", 1.0)
    # What is under way is not finished: a reader who stops at the end has everything.
    assert max(part for part in parts[:-1] if part < 1.0) <= 0.99


# ---------------------------------------------------------------------------- misuse and failure


@pytest.mark.parametrize("count", [CORES + 1, 0, -1])
def test_more_workers_than_cores_or_none_are_refused(count: int) -> None:
    with pytest.raises(InputError, match=rf"`workers` must be .*but it is {count}\."):
        parallel_map(chores.square, POINTS, plan(place=Workers(count=count)))


def test_an_empty_chunk_is_refused() -> None:
    with pytest.raises(InputError, match="`chunk` must be at least 1, but it is 0"):
        ExecutionPlan(chunk=0)


@pytest.mark.slow
def test_the_exception_of_a_task_is_told_with_its_place_even_if_it_cannot_travel() -> None:
    with pytest.raises(WorkError, match=r"OddError: there is no answer for \d+\.\d+") as caught:
        parallel_map(chores.fail, POINTS, plan())
    assert "chores.py" in caught.value.trace


@pytest.mark.parametrize("name", ["not_plain", "too_few"])
def test_a_task_that_does_not_return_plain_data_one_a_point_is_refused(name: str) -> None:
    with pytest.raises((WorkError, InputError), match=r"JSON|one result per point"):
        parallel_map(getattr(chores, name), POINTS, plan())


def test_a_task_that_cannot_be_sent_is_refused() -> None:
    with pytest.raises(WorkError, match="cannot be sent"):
        parallel_map(chores.Unsendable(), POINTS, plan())


# ---------------------------------------------------------------------------- killed workers


@pytest.mark.parametrize("how", [signal.SIGKILL, None], ids=["killed", "exit code 0"])
@pytest.mark.slow
def test_a_point_that_kills_every_worker_is_named_and_the_others_are_not(how: int | None) -> None:
    task = Deadly(points=(POINTS[5],), how=how)
    results = parallel_map(task, POINTS[:12], plan())
    assert isinstance(results[5], FailedPoint)
    assert [r for k, r in enumerate(results) if k != 5] == [*POINTS[:5], *POINTS[6:12]]


@pytest.mark.slow
@needs_two
def test_a_worker_that_is_killed_in_the_middle_changes_nothing(
    tmp_path: Path, diary: Diary
) -> None:
    slow = Diary(folder=diary.folder, pause=0.15)

    def kill_one() -> None:
        wait_until(lambda: len(slow.starts()) >= 3)
        os.kill(min(slow.workers()), signal.SIGKILL)

    with ThreadPoolExecutor(1) as thread:
        killing = thread.submit(kill_one)
        results = parallel_map(slow, POINTS, plan(tmp_path / "killed"))
        killing.result()
    assert list(results) == alone()
    assert 6 < len(slow.starts()) <= 6 + 2, "the chunks under way are computed again, no others"
    assert len(slow.workers()) > 2
    parallel_map(Diary(folder=diary.folder), POINTS, plan(tmp_path / "quiet"))
    assert contents(tmp_path / "killed") == contents(tmp_path / "quiet")


@pytest.mark.slow
def test_points_that_kill_once_each_are_all_computed_in_their_chunks(tmp_path: Path) -> None:
    task = Deadly(points=tuple(POINTS[1::12]), once=str(tmp_path))
    assert list(parallel_map(task, POINTS, plan())) == POINTS


@pytest.mark.slow
def test_a_lost_point_is_remembered_by_the_checkpoint(tmp_path: Path) -> None:
    task = Deadly(points=(POINTS[2],))
    first = parallel_map(task, POINTS[:4], plan(tmp_path / "kept"))
    assert parallel_map(chores.square, POINTS[:4], plan(tmp_path / "kept")) == first
    assert first == (*POINTS[:2], FailedPoint(), POINTS[3])


# ---------------------------------------------------------------------------- killed as a whole

PROGRAM = """
import sys
from tests.work.test_work import POINTS, plan
from tests.support.chores import Diary
from zeno_orbits.work import Workers, parallel_map
from pathlib import Path
if __name__ == "__main__":
    place = Workers(count=int(sys.argv[3]))
    task = Diary(folder=sys.argv[1], pause=0.15)
    parallel_map(task, POINTS, plan(Path(sys.argv[2]), place=place))
"""


def start_program(diary: Diary, kept: Path, workers: int) -> subprocess.Popen[bytes]:
    arguments = [sys.executable, "-c", PROGRAM, diary.folder, str(kept), str(workers)]
    return subprocess.Popen(arguments, start_new_session=True, stderr=subprocess.DEVNULL)


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    # What nobody waits for stays as a zombie.
    return Path(f"/proc/{pid}/stat").read_text().split(")")[-1].split()[0] != "Z"


@pytest.mark.slow
def test_a_process_that_is_killed_loses_what_is_in_flight_and_leaves_no_worker_behind(
    tmp_path: Path, diary: Diary
) -> None:
    kept = tmp_path / "kept"
    program = start_program(diary, kept, TWO.count or 1)
    wait_until(lambda: kept.exists() and len(list(kept.glob("chunk-*.json"))) >= 2)
    program.kill()
    program.wait()
    finished = contents(kept)
    workers = diary.workers()
    wait_until(lambda: not any(map(is_alive, workers)))
    before = len(diary.starts())
    assert list(parallel_map(diary, POINTS, plan(kept, place=Workers(count=1)))) == alone()
    done = sum(name.startswith("chunk") for name in finished)
    assert len(diary.starts()) - before == 6 - done, "finished chunks are not computed again"
    assert {name: contents(kept)[name] for name in finished if name[0] != "."} == {
        name: data for name, data in finished.items() if name[0] != "."
    }
    parallel_map(diary, POINTS, plan(tmp_path / "quiet"))
    visible = {name: data for name, data in contents(kept).items() if name[0] != "."}
    assert visible == contents(tmp_path / "quiet")


@pytest.mark.slow
def test_an_interrupt_ends_the_workers_and_keeps_what_is_finished(
    tmp_path: Path, diary: Diary
) -> None:
    slow = Diary(folder=diary.folder, pause=0.1)

    def interrupt(_what: str, part: float) -> None:
        if part >= 0.3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        parallel_map(slow, POINTS, plan(tmp_path / "kept"), on_progress=interrupt)
    wait_until(lambda: not any(map(is_alive, slow.workers())))
    assert len(list((tmp_path / "kept").glob("chunk-*.json"))) >= 2
    assert list(parallel_map(slow, POINTS, plan(tmp_path / "kept"))) == alone()


@pytest.mark.slow
def test_a_second_interrupt_waits_until_the_workers_have_ended(
    tmp_path: Path, diary: Diary, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = Diary(folder=diary.folder, pause=0.1)
    shutdown, ended = ProcessPoolExecutor.shutdown, list[bool]()

    def interrupted(self: ProcessPoolExecutor, **how: bool) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        shutdown(self, **how)
        ended.append(True)

    def interrupt(_what: str, part: float) -> None:
        if part >= 0.3:
            raise KeyboardInterrupt

    monkeypatch.setattr(ProcessPoolExecutor, "shutdown", interrupted)
    with pytest.raises(KeyboardInterrupt):
        parallel_map(slow, POINTS, plan(tmp_path / "kept"), on_progress=interrupt)
    assert ended == [True]
    wait_until(lambda: not any(map(is_alive, slow.workers())))


# ---------------------------------------------------------------------------- checkpoints


def forbidden(points: Sequence[float]) -> list[float]:
    """A task that must not run."""
    raise OSError(str(points))


@pytest.fixture(name="finished", scope="module")
def _finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint of finished work, which no test changes."""
    folder = tmp_path_factory.mktemp("finished")
    (folder / "diary").mkdir()
    parallel_map(Diary(folder=str(folder / "diary")), POINTS, plan(folder / "kept"))
    return folder / "kept"


@pytest.fixture(name="kept")
def _kept(tmp_path: Path, finished: Path) -> Path:
    """A copy of it."""
    return shutil.copytree(finished, tmp_path / "kept")


def test_what_is_finished_is_not_computed_again(kept: Path) -> None:
    before = contents(kept)
    assert list(parallel_map(forbidden, POINTS, plan(kept))) == alone()
    assert contents(kept) == before


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"command": "search"}, r'`command` is "test", not "search"'),
        ({"settings": {"until": 30.0, "seed": 0}}, r"`settings\.until` is 60\.0, not 30\.0"),
        ({"settings": {"until": 60.0, "seed": 1}}, r"`settings\.seed` is 0, not 1"),
        ({"settings": {"until": 60.0}}, r'`settings\.seed` is 0, not "nothing"'),
        ({"problem": "bouncing_ball"}, r'`problem` is "nothing", not "bouncing_ball"'),
    ],
)
def test_the_checkpoint_of_another_work_is_refused_and_left_untouched(
    kept: Path, change: dict[str, Any], told: str
) -> None:
    before = contents(kept)
    with pytest.raises(CheckpointError, match=told):
        parallel_map(forbidden, POINTS, plan(kept, **change))
    assert contents(kept) == before


def test_the_checkpoint_of_other_points_or_chunks_is_refused(kept: Path) -> None:
    before = contents(kept)
    with pytest.raises(CheckpointError, match="`points` is 24, not 23"):
        parallel_map(forbidden, POINTS[1:], plan(kept))
    with pytest.raises(CheckpointError, match="`points_digest` is"):
        parallel_map(forbidden, [*POINTS[1:], 7.0], plan(kept))
    with pytest.raises(CheckpointError, match="`chunk` is 4, not 5"):
        parallel_map(
            forbidden, POINTS, ExecutionPlan(place=TWO, chunk=5, checkpoint=kept, identity=IDENTITY)
        )
    assert contents(kept) == before


def test_the_checkpoint_of_another_version_is_refused_and_left_untouched(
    kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(kept)
    monkeypatch.setattr(spreading_module, "code_digest", lambda: "another")
    with pytest.raises(CheckpointError, match=r'`code` is ".*", not "another"'):
        parallel_map(forbidden, POINTS, plan(kept))
    identity = kept / "identity.json"
    newer = json.loads(identity.read_text()) | {"format": 99}
    identity.write_text(json.dumps(newer))
    with pytest.raises(CheckpointError, match="`format` is 99, not 1"):
        parallel_map(forbidden, POINTS, plan(kept))
    assert contents(kept) == before | {"identity.json": json.dumps(newer).encode()}


def halved(data: bytes) -> bytes:
    return data[: len(data) // 2]


def altered(data: bytes) -> bytes:
    entries = json.loads(data)
    entries["results"][0]["point"] += 1e-15
    return json.dumps(entries).encode()


def forgotten(data: bytes) -> bytes:
    return json.dumps(json.loads(data) | {"results": None}).encode()


def moved(data: bytes) -> bytes:
    return json.dumps(json.loads(data) | {"chunk": 4}).encode()


BROKEN = [halved, altered, forgotten, moved, lambda _: b"", lambda _: b"[]", lambda _: b"\xff"]


@pytest.mark.slow
def test_a_broken_chunk_is_named_and_can_be_removed_by_itself(kept: Path, diary: Diary) -> None:
    whole = contents(kept)
    file = kept / "chunk-000002.json"
    sound = file.read_bytes()
    for change in BROKEN:
        file.write_bytes(change(sound))
        before = contents(kept)
        with pytest.raises(
            CheckpointError, match=r"`chunk-000002\.json` is broken.*Remove that file"
        ):
            parallel_map(forbidden, POINTS, plan(kept))
        assert contents(kept) == before
    file.unlink()
    n_before = len(diary.starts())
    assert list(parallel_map(diary, POINTS, plan(kept))) == alone()
    assert len(diary.starts()) == n_before + 1
    assert contents(kept) == whole


def test_a_broken_identity_is_named(kept: Path) -> None:
    (kept / "identity.json").write_text("{")
    before = contents(kept)
    with pytest.raises(CheckpointError, match=r"`identity\.json` is broken"):
        parallel_map(forbidden, POINTS, plan(kept))
    assert contents(kept) == before


def test_a_folder_of_other_things_is_refused_and_left_untouched(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("everything")
    with pytest.raises(CheckpointError, match=r"not a checkpoint: it holds `thesis\.tex`"):
        parallel_map(forbidden, POINTS, plan(tmp_path))
    with pytest.raises(CheckpointError, match="not a folder"):
        parallel_map(forbidden, POINTS, plan(tmp_path / "thesis.tex"))
    with pytest.raises(CheckpointError, match="not a folder"):
        parallel_map(forbidden, POINTS, plan(tmp_path / "missing" / "kept"))
    assert contents(tmp_path) == {"thesis.tex": b"everything"}


@pytest.mark.slow
def test_half_written_files_of_a_killed_process_do_not_count(tmp_path: Path, diary: Diary) -> None:
    folder = tmp_path / "kept"
    folder.mkdir()
    (folder / ".identity.json.x7f").write_text("{")
    (folder / ".chunk-000001.json.x7f").write_text("{")
    assert list(parallel_map(diary, POINTS, plan(folder))) == alone()


# ---------------------------------------------------------------------------- one after the other


def numbered(points: Sequence[float]) -> list[float]:
    """What this process does first."""
    return [-point for point in points]


@pytest.mark.slow
@needs_two
def test_results_come_in_the_order_of_their_points_whoever_is_first() -> None:
    whole = ExecutionPlan(place=TWO, chunk=1, identity=IDENTITY)
    found = list(spread_in_order(chores.slow_at_zero, POINTS, whole))
    assert found == [point * point for point in POINTS]


@pytest.mark.slow
def test_who_has_seen_enough_ends_the_workers(diary: Diary) -> None:
    slow = Diary(folder=diary.folder, pause=0.1)
    results = spread_in_order(slow, POINTS, ExecutionPlan(place=TWO, chunk=1, identity=IDENTITY))
    assert next(results)["point"] == POINTS[0] / 3
    results.close()
    wait_until(lambda: not any(map(is_alive, slow.workers())))
    assert len(slow.starts()) < len(POINTS)


@pytest.mark.slow
def test_this_process_does_the_first_chunk_and_no_worker_begins_before_it_is_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_place: Workers) -> None:
        raise OSError("a pool is opened")

    default = ExecutionPlan(chunk=2, checkpoint=tmp_path / "kept", identity=IDENTITY)
    with monkeypatch.context() as patch:
        patch.setattr(spreading_module, "open_pool", refuse)
        results = spread_in_order(chores.square, [1.0, 2.0, 3.0], default, here=numbered)
        assert [next(results), next(results)] == [-1.0, -2.0]
        with pytest.raises(OSError, match="a pool is opened"):
            next(results)
    # What this process did is kept as well.
    again = spread_in_order(chores.square, [1.0, 2.0, 3.0], default, here=forbidden)
    assert list(again) == [-1.0, -2.0, 9.0]


def test_a_place_that_cannot_be_had_is_refused_before_any_work() -> None:
    crowd = ExecutionPlan(place=Workers(count=CORES + 1), chunk=1, identity=IDENTITY)
    with pytest.raises(InputError, match="`workers` must be at most"):
        next(spread_in_order(chores.square, POINTS, crowd, here=forbidden))
