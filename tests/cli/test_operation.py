"""Commands as processes among others: hostile folders, signals, odd file names."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.commands import MISUSE, NO, YES, ask
from tests.support.processes import workers_of

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 60.0
SMALL = ("map", "vibrating_table", "--x", "A=0.0149:0.0151", "--y", "omega=29.9:30.1")

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and links of POSIX")


@contextmanager
def started(folder: Path, *words: str | Path, **more: str) -> Iterator[subprocess.Popen[str]]:
    """Start a command in a folder, whose temporary files go into `temporary` in it."""
    (folder / "temporary").mkdir(exist_ok=True)
    own = {"PYTHONPATH": str(ROOT), "TMPDIR": str(folder / "temporary"), **more}
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "zeno_orbits", *map(str, words)],
        cwd=folder,
        env={**os.environ, **own},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def wait_for(condition: Callable[[], object]) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.1)  # each look may start a process


def left_in(folder: Path) -> list[str]:
    """Return what a command has left of its temporary files; loky's own files do not count."""
    return [path.name for path in (folder / "temporary").glob("zeno-orbits*")]


@pytest.mark.slow
def test_a_deleted_current_folder_is_named(tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    words = [sys.executable, "-m", "zeno_orbits", "simulate", "bouncing_ball", "-o", "x.csv"]
    command = f"cd {gone} && rmdir {gone} && exec {shlex.join(words)}"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = subprocess.run(
        ["sh", "-c", command], capture_output=True, text=True, env=environment, check=False
    )
    assert run.returncode == MISUSE
    assert run.stderr.strip().endswith(
        "The current folder was deleted. Change to an existing folder."
    )


@pytest.mark.slow
def test_files_of_the_current_folder_are_not_imported_by_workers(tmp_path: Path) -> None:
    for name in ("platform", "types", "numpy", "signal", "joblib"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('imported by mistake')\n")
    with started(tmp_path, *SMALL, "--grid", "2x2", "--workers", "2", "--json") as process:
        out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == YES
    assert "Traceback" not in err
    assert "worker" not in out


@pytest.mark.slow
def test_a_request_to_end_leaves_no_temporary_folder(tmp_path: Path) -> None:
    with started(tmp_path, *SMALL, "--grid", "90x90", "--workers", "2") as process:
        wait_for(lambda: workers_of(process.pid))
        assert left_in(tmp_path)
        process.terminate()
        _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 128 + signal.SIGTERM
    # Progress may come before.
    assert err.splitlines()[-1].startswith("zeno-orbits: interrupted")
    assert "Traceback" not in err
    assert [name for name in left_in(tmp_path) if name not in err] == []


@pytest.mark.weekly
@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "request_to_end"),
    [("loop.c", "SIGTERM"), ("loop.c", "SIGHUP"), ("fmi3.c", "SIGINT"), ("fmi3.c", "SIGTERM")],
)
def test_an_export_that_ends_while_it_compiles_leaves_no_file(
    source: str, request_to_end: str, tmp_path: Path
) -> None:
    number = signal.Signals[request_to_end]
    if signal.getsignal(number) is signal.SIG_IGN:
        pytest.skip("this signal is ignored here")
    compiler = tmp_path / "cc"
    begun = 'touch "$TMPDIR/part.s" begun; exec sleep 60'
    compiler.write_text(f'#!/bin/sh\ncase "$*" in *{source}*) {begun};; esac\nexec cc "$@"\n')
    compiler.chmod(0o755)
    # Another digest than that of an installed package, whose library would be taken.
    copy = tmp_path / "copy"
    for part in ("zeno_orbits", "problems"):
        hidden = shutil.ignore_patterns("__pycache__", "*.so")
        shutil.copytree(ROOT / part, copy / part, ignore=hidden)
    changed = copy / "zeno_orbits" / "loop" / "loop.c"
    changed.write_text(changed.read_text() + "/* changed */\n")
    own = {"CC": str(compiler), "ZENO_ORBITS_CACHE": str(tmp_path / "cache")}
    own["PYTHONPATH"] = str(copy)
    with started(tmp_path, "export", "bouncing_ball", "--fmu", "-o", "out", **own) as process:
        wait_for((tmp_path / "begun").exists)
        assert list(tmp_path.rglob("zeno-orbits-scratch-*/part.s"))
        process.send_signal(number)
        process.communicate(timeout=PATIENCE)
    assert process.returncode == 128 + number
    assert list((tmp_path / "temporary").iterdir()) == []
    assert list(tmp_path.rglob("zeno-orbits-scratch-*")) == []
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_workers_of_a_killed_command_remove_its_temporary_folder(tmp_path: Path) -> None:
    words = (*SMALL, "--grid", "90x90", "--workers", "1", "--checkpoint", tmp_path / "kept")
    with started(tmp_path, *words) as process:
        notes = tmp_path / "temporary"
        # A note is written by a worker that has begun.
        wait_for(lambda: list(notes.glob("zeno-orbits-*/*")))
        process.kill()
        process.wait()
        wait_for(lambda: not left_in(tmp_path))


@pytest.mark.slow
def test_an_interrupt_while_workers_start_is_one_line(tmp_path: Path) -> None:
    with started(tmp_path, *SMALL, "--grid", "90x90", "--workers", "2") as process:
        wait_for(lambda: workers_of(process.pid))
        # A terminal sends it to all processes of the command.
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 128 + signal.SIGINT
    # Progress may come before.
    assert err.splitlines()[-1].startswith("zeno-orbits: interrupted")
    assert "Traceback" not in err


@pytest.fixture(name="masked")
def _masked() -> Iterator[None]:
    before = os.umask(0o027)
    yield
    os.umask(before)


@pytest.mark.usefixtures("masked")
def test_the_umask_decides_who_may_read_a_new_file(tmp_path: Path, orbit: zo.Orbit) -> None:
    path = tmp_path / "orbit.json"
    zo.write_orbit(orbit, path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_file_that_is_replaced_keeps_its_permissions_and_its_link(
    tmp_path: Path, orbit: zo.Orbit
) -> None:
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    real, link = folder / "real.json", tmp_path / "link.json"
    real.write_text("old")
    real.chmod(0o600)
    link.symlink_to(real)
    zo.write_orbit(orbit, link)
    assert link.is_symlink()
    assert zo.read_orbit(real) == orbit
    assert stat.S_IMODE(real.stat().st_mode) == 0o600
    assert [path.name for path in folder.iterdir()] == ["real.json"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    fast(1, [os.fsdecode(b"caf\xe9\xff.csv"), "x" * 246 + ".csv", "line\nbreak.csv"]),
    ids=["not UTF-8", "250 bytes", "line break"],
)
def test_any_legal_file_name_is_written(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / name
    monkeypatch.setenv("PYTHONIOENCODING", "utf-8")
    with started(tmp_path, "simulate", "bouncing_ball", "--until", "1", "-o", path) as process:
        out, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, err) == (YES, "")
    assert "Written: " in out
    assert path.stat().st_size > 100


@pytest.mark.slow
def test_a_map_with_a_long_name_keeps_its_parts_until_it_is_done(tmp_path: Path) -> None:
    path = tmp_path / ("x" * 245 + ".json")
    answer = ask(*SMALL, "--grid", "2x2", "--workers", "1", "-o", path)
    assert answer.code == YES
    assert list(tmp_path.iterdir()) == [path]


def test_a_name_that_no_system_allows_is_refused_before_the_work(tmp_path: Path) -> None:
    answer = ask(*SMALL, "--grid", "2x2", "-o", tmp_path / ("x" * 300))
    assert answer.code == 2
    assert "File name too long" in answer.err
    assert answer.err.count("\n") == 1


@pytest.mark.slow
def test_two_runs_with_one_output_do_not_disturb_each_other(tmp_path: Path) -> None:
    output = tmp_path / "map.json"
    words = (*SMALL, "--grid", "90x90", "--workers", "1", "-o", output)
    with started(tmp_path, *words) as first:
        lock = tmp_path / "map.json.checkpoint" / ".owner"
        wait_for(lambda: lock.exists() and lock.read_text())
        second = ask(*words)
        assert second.code == 2
        assert f"process {first.pid} on " in second.err
        assert "is working on it" in second.err
        assert second.err.count("\n") == 1
        assert first.poll() is None
        first.kill()
        first.wait()
    # A killed process frees its lock, and its work goes on.
    small = (*SMALL, "--grid", "2x2", "--workers", "1", "-o", tmp_path / "other.json")
    folder = tmp_path / "other.json.checkpoint"
    folder.mkdir()
    (folder / ".lock").touch()
    (folder / ".owner").write_text(f"process {first.pid} on here")
    assert ask(*small).code == YES
    assert not folder.exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("continue", "motor_pendulum", "--parameter", "Kd=-2.5:0"),
        ("search", "motor_pendulum", "--vary", "Kp=1:5", "--candidates", "3"),
    ],
    ids=lambda words: words[0],
)
def test_a_second_run_with_one_checkpoint_is_refused_and_a_terminated_one_goes_on(
    words: tuple[str, ...], tmp_path: Path, orbit: zo.Orbit, monkeypatch: pytest.MonkeyPatch
) -> None:
    zo.write_orbit(orbit, tmp_path / "orbit.json")
    monkeypatch.chdir(tmp_path)
    words = (*words, "--workers", "1", "--checkpoint", "kept")
    with started(tmp_path, *words) as first:
        # A run in several stages has a folder for each.
        wait_for(lambda: any(one.stat().st_size for one in (tmp_path / "kept").rglob(".owner")))
        second = ask(*words)
        assert second.code == 2
        assert f"process {first.pid} on " in second.err
        assert second.err.count("\n") == 1
        first.terminate()
        _, err = first.communicate(timeout=PATIENCE)
    assert first.returncode == 128 + signal.SIGTERM
    assert "Traceback" not in err
    assert not left_in(tmp_path)
    again = ask(*words)
    assert again.code in (YES, NO), again.err


@pytest.mark.slow
def test_a_map_has_the_same_bytes_with_one_worker_and_with_two(tmp_path: Path) -> None:
    files = [tmp_path / f"{workers}.json" for workers in ("1", "2")]
    for file in files:
        words = (*SMALL, "--grid", "6x6", "--workers", file.stem, "-o", file)
        assert ask(*words).code == YES
    assert files[0].read_bytes() == files[1].read_bytes()
