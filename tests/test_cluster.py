"""A Dask cluster: a scheduler and two workers here, and what is said of bad addresses."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests import chores
from tests.chores import Deadly, Diary
from tests.test_cli import ask
from zeno_orbits.errors import InputError, WorkError
from zeno_orbits.map_file import write_map
from zeno_orbits.maps import Axis, Plane, parameter_map
from zeno_orbits.problem import bundled_problems
from zeno_orbits.scenes import scene_file
from zeno_orbits.work import Cluster, Lost, Plan, Workers, spread

pytest.importorskip("distributed", reason="needs the extra `cluster`")

POINTS = [0.1 * k for k in range(24)]
ROOT = Path(__file__).parents[1]


@dataclass
class DaskCluster:
    """A scheduler and its workers, as processes."""

    folder: Path
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def file(self) -> Path:
        return self.folder / "scheduler.json"

    @property
    def address(self) -> str:
        return str(json.loads(self.file.read_text())["address"])

    def start(self, part: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{part}", "--no-dashboard"]
        process = subprocess.Popen(
            [*command, "--scheduler-file", str(self.file), *arguments],
            cwd=self.folder,
            env=os.environ
            | {
                "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
                # A killer is called one after its second victim.
                "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
            },
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self.processes.append(process)
        return process

    def start_scheduler(self) -> subprocess.Popen[bytes]:
        process = self.start("scheduler", "--host", "127.0.0.1", "--port", "0")
        wait_until(lambda: self.file.exists() and self.file.stat().st_size > 0)
        return process

    def start_worker(self, *arguments: str) -> subprocess.Popen[bytes]:
        return self.start("worker", "--nthreads", "1", *arguments)

    def place(self, patience: float = 20.0) -> Cluster:
        return Cluster(address=self.address, patience=patience)


def wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "nothing happens"
        time.sleep(0.02)


@pytest.fixture(name="cluster")
def _cluster(tmp_path: Path) -> Iterator[DaskCluster]:
    cluster = DaskCluster(tmp_path)
    cluster.start_scheduler()
    try:
        yield cluster
    finally:
        for process in reversed(cluster.processes):
            process.terminate()
        for process in cluster.processes:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(2)
            process.kill()
            process.wait()


def plan(place: Workers | Cluster, checkpoint: Path | None = None) -> Plan:
    return Plan(place=place, chunk=4, checkpoint=checkpoint)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


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
        there = spread(slow, POINTS, plan(cluster.place(), tmp_path / "there"))
        killing.result()
    here = spread(slow, POINTS, plan(Workers(count=1), tmp_path / "here"))
    assert there == here
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


def test_a_point_that_kills_every_worker_of_a_cluster_is_named(cluster: DaskCluster) -> None:
    cluster.start_worker("--nanny")
    task = Deadly(points=(POINTS[1],))
    assert spread(task, POINTS[:3], plan(cluster.place())) == (POINTS[0], Lost(), POINTS[2])


def test_failures_come_home_from_a_cluster_and_its_end_is_noticed(cluster: DaskCluster) -> None:
    with pytest.raises(InputError, match=r"has no worker after 0\.5 s"):
        spread(chores.square, POINTS, plan(cluster.place(patience=0.5)))
    cluster.start_worker("--no-nanny")
    with pytest.raises(WorkError, match="there is no answer for"):
        spread(chores.fail, POINTS, plan(cluster.place()))

    def stop(_what: str, part: float) -> None:
        if part > 0.0:
            cluster.processes[0].kill()

    (cluster.folder / "diary").mkdir()
    slow = Diary(folder=str(cluster.folder / "diary"), pause=0.2)
    with pytest.raises(WorkError, match="has lost its scheduler or all its workers"):
        spread(slow, POINTS, plan(cluster.place()), tell=stop)


def test_a_map_made_on_a_cluster_is_the_file_made_here(
    cluster: DaskCluster, tmp_path: Path
) -> None:
    scene = tmp_path / "ball.py"
    shutil.copy(bundled_problems()["bouncing_ball"], scene)
    cluster.start_worker("--no-nanny")
    plane = Plane(
        scene=scene_file(scene),
        x=Axis(name="m", lower=1.0, upper=2.0, count=3),
        y=Axis(name="restitution", lower=0.1, upper=0.5, count=3),
        start=(1.0, 0.0),
    )
    for name, place in (("there", cluster.place()), ("here", Workers(count=1))):
        write_map(parameter_map(plane, plan(place)), tmp_path / name)
    assert (tmp_path / "there").read_bytes() == (tmp_path / "here").read_bytes()


def test_a_search_on_a_cluster_prints_what_it_prints_here(
    cluster: DaskCluster, tmp_path: Path
) -> None:
    scene = tmp_path / "table.py"
    shutil.copy(bundled_problems()["vibrating_table"], scene)
    cluster.start_worker("--no-nanny")
    words = ("--free", "restitution=0.2:0.5", "--candidates", "9", "--starts", "2", "--json")
    there, here = (
        ask("search", scene, *words, *place)
        for place in (("--scheduler", cluster.address), ("--workers", "1"))
    )
    assert there.code == here.code == 0
    assert there.out == here.out


def test_workers_with_other_code_are_refused(
    cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    cluster.start_worker("--no-nanny")
    monkeypatch.setattr("zeno_orbits.work.cluster.code_digest", lambda: "another")
    with pytest.raises(InputError, match="another version of zeno_orbits"):
        spread(chores.square, POINTS, plan(cluster.place()))


def test_the_address_of_a_worker_is_not_that_of_a_scheduler(cluster: DaskCluster) -> None:
    cluster.start_worker("--no-nanny")
    (address,) = spread(chores.addresses, [0.0], plan(cluster.place()))
    with pytest.raises(InputError, match="is that of a Worker"):
        spread(chores.square, POINTS, plan(Cluster(address=address)))


@contextlib.contextmanager
def silent_server() -> Iterator[str]:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"


def test_a_server_that_says_nothing_is_given_up() -> None:
    with (
        silent_server() as address,
        pytest.raises(InputError, match=r"does not answer within 0\.5 s"),
    ):
        spread(chores.square, POINTS, plan(Cluster(address=address, patience=0.5)))


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "localhost:1"])
def test_a_closed_port_does_not_answer(address: str) -> None:
    with pytest.raises(InputError, match=r"does not answer within 0\.5 s"):
        spread(chores.square, POINTS, plan(Cluster(address=address, patience=0.5)))


@pytest.mark.parametrize("address", ["", "nonsense", "http://127.0.0.1:80", "tcp://127.0.0.1:x"])
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(InputError, match="must be the address of a Dask scheduler"):
        spread(chores.square, POINTS, plan(Cluster(address=address, patience=0.5)))


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"zeno_orbits\[cluster\]"):
        spread(chores.square, POINTS, plan(Cluster(address="tcp://127.0.0.1:1")))
