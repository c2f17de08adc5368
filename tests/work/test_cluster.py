"""A Dask cluster: a scheduler and two workers here, and what is said of bad addresses."""

from __future__ import annotations

import contextlib
import shutil
import signal
import socket
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.support import chores
from tests.support.chores import Deadly, Diary
from tests.support.clusters import DaskCluster, dask_cluster, noted_problem, wait_until
from tests.support.commands import ask
from zeno_orbits.errors import InputError, WorkError
from zeno_orbits.maps import Axis, Plane, map_of_plane, write_map
from zeno_orbits.model import bundled_problems, locate_problem
from zeno_orbits.work import Cluster, ExecutionPlan, FailedPoint, Workers, parallel_map

pytest.importorskip("distributed", reason="needs the extra `cluster`")

POINTS = [0.1 * k for k in range(24)]
IMPACTS = (
    *("--section", "impact", "--set", "c=0.1", "--set", "stop=1", "--set", "restitution=0.8"),
    *(
        "--start",
        "speed=1",
        "--start",
        "cosine=1",
        "--parameter",
        "A=0.8:1.1",
        "--max-points",
        "12",
    ),
)
"""A family in two directions."""
RELEASES = (
    *("--set", "restitution=0", "--parameter", "A=0.7:1.1", "--parameter2", "stop=-0.81:-0.79"),
    *("--kind", "release-lost"),
)
"""A family in two directions, and a curve in two."""


@pytest.fixture(name="cluster")
def _cluster(tmp_path: Path) -> Iterator[DaskCluster]:
    with dask_cluster(tmp_path) as cluster:
        yield cluster


def plan(place: Workers | Cluster, checkpoint: Path | None = None) -> ExecutionPlan:
    return ExecutionPlan(place=place, chunk=4, checkpoint=checkpoint)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.slow
def test_two_workers_of_a_cluster_one_killed_leave_the_checkpoint_of_a_single_process(
    cluster: DaskCluster, tmp_path: Path
) -> None:
    victim = cluster.start_worker("--no-nanny")
    cluster.start_worker("--no-nanny")
    (tmp_path / "diary").mkdir()
    slow = Diary(folder=str(tmp_path / "diary"), pause=0.3)

    def kill_one() -> None:
        wait_until(lambda: victim.pid in slow.workers())
        victim.send_signal(signal.SIGKILL)

    with ThreadPoolExecutor(1) as thread:
        killing = thread.submit(kill_one)
        there = parallel_map(slow, POINTS, plan(cluster.place(), tmp_path / "there"))
        killing.result()
    here = parallel_map(slow, POINTS, plan(Workers(count=1), tmp_path / "here"))
    assert there == here
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


@pytest.mark.parametrize(
    ("words", "n_finished"),
    [
        pytest.param(IMPACTS, 0, id="family"),
        pytest.param(RELEASES, 2, id="curve", marks=pytest.mark.slow),
    ],
)
@pytest.mark.slow
def test_a_family_on_a_cluster_with_a_worker_killed_is_the_file_made_here(
    cluster: DaskCluster, tmp_path: Path, words: tuple[str, ...], n_finished: int
) -> None:
    problem, diary = noted_problem("forced_oscillator", tmp_path)
    workers = [cluster.start_worker("--no-nanny") for _ in range(2)]
    kept, there, here = (tmp_path / name for name in ("kept", "there.json", "here.json"))

    def kill_a_busy_one() -> int:
        """Kill who has the problem, and so a piece in hand, when some others are finished."""

        def busy() -> list[int]:
            known = {int(path.name) for path in diary.iterdir()}
            done = len(list(kept.rglob("chunk-*.json")))
            return [k for k, one in enumerate(workers) if one.pid in known and done >= n_finished]

        wait_until(lambda: bool(busy()), 300.0)
        workers[busy()[0]].send_signal(signal.SIGKILL)
        return len(list(kept.rglob("chunk-*.json")))

    with ThreadPoolExecutor(1) as thread:
        killing = thread.submit(kill_a_busy_one)
        place = ("--scheduler", cluster.address, "--checkpoint", kept)
        answer = ask("continue", problem, *words, *place, "-o", there)
        finished = killing.result()
    assert answer.code == 0
    n_pieces = len(list(kept.rglob("chunk-*.json")))
    assert n_finished <= finished < n_pieces
    assert sum(one.poll() is None for one in workers) == 1
    assert ask("continue", problem, *words, "--workers", "1", "-o", here).code == 0
    assert there.read_bytes() == here.read_bytes()


@pytest.mark.slow
def test_a_point_that_kills_every_worker_of_a_cluster_is_named(cluster: DaskCluster) -> None:
    cluster.start_worker("--nanny")
    task = Deadly(points=(POINTS[1],))
    assert parallel_map(task, POINTS[:3], plan(cluster.place())) == (
        POINTS[0],
        FailedPoint(),
        POINTS[2],
    )


@pytest.mark.slow
def test_failures_come_home_from_a_cluster_and_its_end_is_noticed(cluster: DaskCluster) -> None:
    with pytest.raises(InputError, match=r"lacks a worker after 0\.5 s"):
        parallel_map(chores.square, POINTS, plan(cluster.place(patience=0.5)))
    cluster.start_worker("--no-nanny")
    with pytest.raises(WorkError, match="there is no answer for"):
        parallel_map(chores.fail, POINTS, plan(cluster.place()))

    def stop(_what: str, part: float) -> None:
        if part > 0.0:
            cluster.processes[0].kill()

    (cluster.folder / "diary").mkdir()
    slow = Diary(folder=str(cluster.folder / "diary"), pause=0.2)
    with pytest.raises(WorkError, match="has lost its scheduler or all its workers"):
        parallel_map(slow, POINTS, plan(cluster.place()), on_progress=stop)


@pytest.mark.slow
def test_a_map_made_on_a_cluster_is_the_file_made_here(
    cluster: DaskCluster, tmp_path: Path
) -> None:
    problem = tmp_path / "ball.py"
    shutil.copy(bundled_problems()["bouncing_ball"], problem)
    cluster.start_worker("--no-nanny")
    plane = Plane(
        source=locate_problem(problem),
        x=Axis(name="m", lower=1.0, upper=2.0, count=3),
        y=Axis(name="restitution", lower=0.1, upper=0.5, count=3),
        start=(1.0, 0.0),
    )
    for name, place in (("there", cluster.place()), ("here", Workers(count=1))):
        write_map(map_of_plane(plane, plan(place)), tmp_path / name)
    assert (tmp_path / "there").read_bytes() == (tmp_path / "here").read_bytes()


@pytest.mark.slow
def test_a_search_on_a_cluster_prints_what_it_prints_here(
    cluster: DaskCluster, tmp_path: Path
) -> None:
    problem = tmp_path / "table.py"
    shutil.copy(bundled_problems()["vibrating_table"], problem)
    cluster.start_worker("--no-nanny")
    words = ("--vary", "restitution=0.2:0.5", "--candidates", "9", "--n-starts", "2", "--json")
    there, here = (
        ask("search", problem, *words, *place)
        for place in (("--scheduler", cluster.address), ("--workers", "1"))
    )
    assert there.code == here.code == 0
    assert there.out == here.out


@pytest.mark.slow
def test_workers_with_other_code_are_refused(
    cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    cluster.start_worker("--no-nanny")
    monkeypatch.setattr("zeno_orbits.work.cluster.code_digest", lambda: "another")
    with pytest.raises(InputError, match="another version of zeno_orbits"):
        parallel_map(chores.square, POINTS, plan(cluster.place()))


@pytest.mark.slow
def test_the_address_of_a_worker_is_not_that_of_a_scheduler(cluster: DaskCluster) -> None:
    cluster.start_worker("--no-nanny")
    (address,) = parallel_map(chores.addresses, [0.0], plan(cluster.place()))
    with pytest.raises(InputError, match="is the address of a Worker"):
        parallel_map(chores.square, POINTS, plan(Cluster(address=address)))


@contextlib.contextmanager
def silent_server() -> Iterator[str]:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"


@pytest.mark.slow
def test_a_server_that_says_nothing_is_given_up() -> None:
    with (
        silent_server() as address,
        pytest.raises(InputError, match=r"does not answer within 0\.5 s"),
    ):
        parallel_map(chores.square, POINTS, plan(Cluster(address=address, patience=0.5)))


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "localhost:1"])
def test_a_closed_port_does_not_answer(address: str) -> None:
    with pytest.raises(InputError, match=r"does not answer within 0\.5 s"):
        parallel_map(chores.square, POINTS, plan(Cluster(address=address, patience=0.5)))


@pytest.mark.parametrize("address", ["", "nonsense", "http://127.0.0.1:80", "tcp://127.0.0.1:x"])
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(InputError, match="must be the address of a Dask scheduler"):
        parallel_map(chores.square, POINTS, plan(Cluster(address=address, patience=0.5)))


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"zeno_orbits\[cluster\]"):
        parallel_map(chores.square, POINTS, plan(Cluster(address="tcp://127.0.0.1:1")))
