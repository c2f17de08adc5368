"""Links in a folder lead no file elsewhere to harm, whatever writes into the folder."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.cases import fast
from tests.support.chores import square
from tests.support.commands import MISUSE, ask, contents
from zeno_orbits.errors import CheckpointError, KernelError
from zeno_orbits.loop import library_folder
from zeno_orbits.work import (
    ExecutionPlan,
    Workers,
    file_lock,
    keeps_nothing,
    parallel_map,
    remove_checkpoint,
)

POINTS = [float(k) for k in range(8)]
TEXT = "valuable\n"


@pytest.fixture(name="elsewhere")
def _elsewhere(tmp_path: Path) -> Path:
    """A folder with a file and a finished checkpoint, which must stay as they are."""
    folder = tmp_path / "elsewhere"
    (folder / "stage").mkdir(parents=True)
    (folder / "file").write_text(TEXT)
    (folder / "identity.json").write_text("{}")
    (folder / "stage" / "identity.json").write_text("{}")
    (folder / "stage" / "chunk-000000.json").write_text("{}")
    return folder


@pytest.fixture(name="folder")
def _folder(tmp_path: Path) -> Path:
    folder = tmp_path / "kept"
    folder.mkdir()
    return folder


def plan(folder: Path) -> ExecutionPlan:
    return ExecutionPlan(place=Workers(count=1), chunk=4, checkpoint=folder, identity={"one": 1})


def to_a_file(name: str) -> Callable[[Path, Path], None]:
    return lambda folder, elsewhere: (folder / name).symlink_to(elsewhere / "file")


def to_nothing(name: str) -> Callable[[Path, Path], None]:
    return lambda folder, elsewhere: (folder / name).symlink_to(elsewhere / "new")


def to_a_folder(name: str) -> Callable[[Path, Path], None]:
    return lambda folder, elsewhere: (folder / name).symlink_to(elsewhere / "stage")


def a_pipe(name: str) -> Callable[[Path, Path], None]:
    return lambda folder, _: os.mkfifo(folder / name)


TRAPS = {
    f"{make.__name__} {name}": make(name)
    for name in (".lock", "identity.json", "chunk-000000.json", "chunk-000001.json")
    for make in (to_a_file, to_nothing, a_pipe)
} | {
    f"{make.__name__} {name}": make(name)
    for name in ("stage", ".unfinished-1", "chunk-000000.json", "root-0")
    for make in (to_a_folder, to_a_file)
}


@pytest.mark.parametrize("trap", TRAPS)
@pytest.mark.parametrize("finished", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_checkpoint_changes_nothing_outside_of_its_folder(
    trap: str, finished: bool, folder: Path, elsewhere: Path
) -> None:
    if finished:
        parallel_map(square, POINTS, plan(folder))
        for path in folder.iterdir():
            if path.name in trap:
                path.unlink()
    TRAPS[trap](folder, elsewhere)
    before = contents(elsewhere)
    with pytest.raises(CheckpointError, match=r"link"):
        parallel_map(square, POINTS, plan(folder))
    keeps_nothing(folder)
    remove_checkpoint(folder)
    assert contents(elsewhere) == before
    assert folder.exists(), "what is not of the checkpoint stays"


@pytest.mark.parametrize("make", [to_a_file, to_nothing, a_pipe])
def test_the_name_of_the_owner_takes_the_place_of_a_link(
    make: Callable[[str], Callable[[Path, Path], None]], folder: Path, elsewhere: Path
) -> None:
    make(".owner")(folder, elsewhere)
    before = contents(elsewhere)
    assert list(parallel_map(square, POINTS, plan(folder))) == square(POINTS)
    assert contents(elsewhere) == before


def test_a_checkpoint_that_is_a_link_is_refused(tmp_path: Path, elsewhere: Path) -> None:
    for name, target in (("a", elsewhere), ("b", elsewhere / "stage"), ("c", elsewhere / "new")):
        (tmp_path / name).symlink_to(target)
        before = contents(elsewhere)
        with pytest.raises(CheckpointError, match="it is a link"):
            parallel_map(square, POINTS, plan(tmp_path / name))
        remove_checkpoint(tmp_path / name)
        assert contents(elsewhere) == before


@pytest.mark.slow
def test_a_second_name_of_a_file_keeps_its_content(folder: Path, elsewhere: Path) -> None:
    for name in (".lock", ".owner", "identity.json"):
        (folder / name).hardlink_to(elsewhere / "file")
    with pytest.raises(CheckpointError):
        parallel_map(square, POINTS, plan(folder))
    (folder / "identity.json").unlink()
    assert list(parallel_map(square, POINTS, plan(folder))) == square(POINTS)
    remove_checkpoint(folder)
    assert (elsewhere / "file").read_text() == TEXT


@pytest.mark.slow
def test_folders_of_a_checkpoint_are_removed_and_others_stay(folder: Path) -> None:
    for name in ("stage", "own"):
        parallel_map(square, POINTS, plan(folder / name))
    (folder / "own" / "notes.txt").write_text("mine")
    (folder / "chunk-000000.json").mkdir()
    remove_checkpoint(folder)
    assert sorted(contents(folder)) == ["chunk-000000.json", "own", "own/notes.txt"]


LOCKING = """
import sys
from pathlib import Path
from zeno_orbits.work import file_lock
try:
    with file_lock(Path(sys.argv[1])):
        print("free")
except TimeoutError:
    print("held")
"""


def test_a_lock_holds_between_processes_and_leaves_no_file(tmp_path: Path) -> None:
    path = tmp_path / ".lock"

    def state() -> str:
        words = [sys.executable, "-c", LOCKING, str(path)]
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()

    with file_lock(path):
        assert state() == "held"
    assert not path.exists()
    assert state() == "free"
    path.write_text(TEXT)
    assert state() == "free"


@pytest.mark.parametrize("kind", ["link", "dangling", "pipe", "folder"])
def test_a_lock_is_a_regular_file(kind: str, tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    {
        "link": lambda: ((tmp_path / "file").write_text(TEXT), path.symlink_to(tmp_path / "file")),
        "dangling": lambda: path.symlink_to(tmp_path / "new"),
        "pipe": lambda: os.mkfifo(path),
        "folder": path.mkdir,
    }[kind]()
    before = contents(tmp_path)
    with pytest.raises(OSError, match="is a link, or not a file"), file_lock(path):
        pass
    assert contents(tmp_path) == before


@pytest.fixture(name="cache")
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ZENO_ORBITS_CACHE", str(tmp_path / "cache"))
    library_folder().make()
    return tmp_path / "cache" / "kernels"


def test_the_lock_of_the_cache_follows_no_link(cache: Path, elsewhere: Path) -> None:
    (cache / ".loop-lock").symlink_to(elsewhere / "file")
    with pytest.raises(KernelError, match="cannot be locked"), library_folder().held():
        pass
    assert (elsewhere / "file").read_text() == TEXT


@pytest.mark.skipif(os.geteuid() != 0, reason="needs files of two users")
def test_a_cache_of_another_user_is_neither_used_nor_cleared(cache: Path, elsewhere: Path) -> None:
    (elsewhere / "old.job").touch()
    elsewhere.chmod(0o700)
    cache.rmdir()
    cache.symlink_to(elsewhere)
    library_folder().make()
    os.chown(cache, 12345, 12345, follow_symlinks=False)
    for use in (library_folder().make, library_folder().clear):
        with pytest.raises(KernelError, match="other users can write"):
            use()
    os.chown(elsewhere, 12345, 12345)
    os.chown(cache, 0, 0, follow_symlinks=False)
    for use in (library_folder().make, library_folder().clear):
        with pytest.raises(KernelError, match="other users can write"):
            use()
    assert (elsewhere / "old.job").exists()


SMALL = ("map", "bouncing_ball", "--x", "g=5:10", "--y", "m=1:2", "--grid", "2x2", "--workers", "1")


@pytest.mark.parametrize("own", [False, True])
def test_a_command_names_the_option_of_a_folder_with_a_link(
    own: bool, tmp_path: Path, elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / ("map.json.checkpoint" if own else "kept")
    folder.mkdir()
    (folder / ".lock").symlink_to(elsewhere / "file")
    before = contents(elsewhere)
    answer = ask(*SMALL, "-o", "map.json", *(() if own else ("--checkpoint", "kept")))
    assert answer.code == MISUSE
    assert ("Checkpoint `map.json.checkpoint`" if own else "--checkpoint kept: ") in answer.err
    assert "`.lock` is a link, or not a file" in answer.err
    assert answer.err.count("\n") == 1
    assert contents(elsewhere) == before
    assert not (tmp_path / "map.json").exists()


@pytest.mark.parametrize("option", ["--plot", "-o", "--checkpoint"])
def test_a_command_names_the_option_that_cannot_be_written(
    option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    given = {"--plot": "map.png", "-o": "map.json", "--checkpoint": "kept"}
    bad = {"--plot": "no/map.png", "-o": "no/map.json", "--checkpoint": "no/kept"}
    words = [word for one in given for word in (one, bad[one] if one == option else given[one])]
    answer = ask(*SMALL, *words)
    assert answer.code == MISUSE
    assert answer.err.startswith(f"zeno-orbits: {option} {bad[option]}: ")


@pytest.mark.slow
@pytest.mark.parametrize("option", fast(1, ["--plot", "-o"]))
def test_a_command_names_the_option_whose_disk_is_full(
    option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fault shows after the work, when the file is written."""
    monkeypatch.chdir(tmp_path)
    Path("map.png").symlink_to("/dev/full" if option == "--plot" else "a.png")
    Path("map.json").symlink_to("/dev/full" if option == "-o" else "a.json")
    answer = ask(*SMALL, "--plot", "map.png", "-o", "map.json")
    assert answer.code == MISUSE
    assert answer.err.startswith(f"zeno-orbits: {option} map."), answer.err
    assert "No space left on device" in answer.err
