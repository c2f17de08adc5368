"""Files appear whole or not at all."""

from __future__ import annotations

import errno
import gc
import os
import time
from pathlib import Path
from typing import Any

import pytest

from zeno_orbits.errors import InputError
from zeno_orbits.work import require_writable, scratch_folder, without_collection, write_whole


def _full(*_: Any, **__: Any) -> Any:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("content", ["θ̇ = 1\n", b"\x00\xff\n", ""])
def test_what_is_written_is_what_is_read(tmp_path: Path, content: str | bytes) -> None:
    path = tmp_path / "orbit.json"
    write_whole(path, content)
    expected = content.encode() if isinstance(content, str) else content
    assert path.read_bytes() == expected
    assert [file.name for file in tmp_path.iterdir()] == ["orbit.json"]


def test_an_existing_file_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "orbit.json"
    path.write_text("a much longer old text", encoding="utf-8")
    write_whole(path, "new")
    assert path.read_text(encoding="utf-8") == "new"


def test_others_may_read_the_file(tmp_path: Path) -> None:
    path = tmp_path / "orbit.json"
    write_whole(path, "new")
    assert path.stat().st_mode & 0o777 == 0o644


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "missing" / "orbit.json"
    with pytest.raises(InputError, match=r"`output` must be in a writable folder.*orbit\.json"):
        write_whole(path, "new")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_not_replaced_by_a_file(tmp_path: Path) -> None:
    path = tmp_path / "orbit.json"
    path.mkdir()
    with pytest.raises(InputError, match=r"`output` must be a file, but .* is a folder"):
        write_whole(path, "new")
    assert [file.name for file in tmp_path.iterdir()] == ["orbit.json"]
    assert path.is_dir()


def test_a_device_is_written_to_and_stays_what_it_is() -> None:
    """As the administrator, who may replace it by a file."""
    for _ in range(2):
        write_whole(Path(os.devnull), "new")
        require_writable(Path(os.devnull))
    assert Path(os.devnull).is_char_device()
    assert Path(os.devnull).read_bytes() == b""


def test_a_full_device_is_refused() -> None:
    full = Path("/dev/full")
    if not full.is_char_device():
        pytest.skip("this system has no device that is always full")
    with pytest.raises(InputError, match=r"must be a file that can be written.*No space left"):
        write_whole(full, "new")
    assert full.is_char_device()


def test_a_pipe_gets_what_is_written(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        require_writable(pipe)
        write_whole(pipe, "new")
        assert os.read(reader, 10) == b"new"
    finally:
        os.close(reader)
    assert pipe.is_fifo()


class _FullDisk:
    """A file that takes some bytes and then no more."""

    def __init__(self, handle: int, _mode: str) -> None:
        self.handle = handle

    def __enter__(self) -> _FullDisk:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self.handle)

    def write(self, data: bytes) -> int:
        os.write(self.handle, data[: len(data) // 2])
        return _full()


@pytest.mark.parametrize("old", ["old", None])
def test_a_disk_that_fills_up_leaves_the_old_file_and_no_litter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str | None
) -> None:
    path = tmp_path / "orbit.json"
    if old is not None:
        path.write_text(old, encoding="utf-8")
    with monkeypatch.context() as patched:
        patched.setattr(os, "fdopen", _FullDisk)
        with pytest.raises(InputError, match="`output` must be a file that can be written"):
            write_whole(path, "a new text")
    left = {file.name: file.read_text(encoding="utf-8") for file in tmp_path.iterdir()}
    assert left == ({} if old is None else {"orbit.json": old})


@pytest.mark.parametrize("step", ["chmod", "replace"])
def test_a_failure_at_the_last_moment_leaves_the_old_file_and_no_litter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    path = tmp_path / "orbit.json"
    path.write_text("old", encoding="utf-8")
    with monkeypatch.context() as patched:
        patched.setattr(Path, step, _full)
        with pytest.raises(InputError, match="No space left on device"):
            write_whole(path, "new")
    left = {file.name: file.read_text(encoding="utf-8") for file in tmp_path.iterdir()}
    assert left == {"orbit.json": "old"}


def test_an_interrupt_leaves_the_old_file_and_no_litter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    path = tmp_path / "orbit.json"
    path.write_text("old", encoding="utf-8")
    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", interrupt)
        with pytest.raises(KeyboardInterrupt):
            write_whole(path, "new")
    assert [file.name for file in tmp_path.iterdir()] == ["orbit.json"]
    assert path.read_text(encoding="utf-8") == "old"


def _aged(folder: Path, age: float) -> Path:
    folder.mkdir()
    (folder / "part").write_text("1")
    then = time.time() - age
    os.utime(folder, (then, then))
    return folder


def test_a_scratch_folder_is_gone_at_the_end_also_after_an_interrupt(tmp_path: Path) -> None:
    def interrupted() -> None:
        with scratch_folder(tmp_path) as folder:
            (folder / "part").write_text("1")
            assert list(tmp_path.iterdir()) == [folder]
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_process_left_goes_after_an_hour_and_nothing_else(tmp_path: Path) -> None:
    with scratch_folder(tmp_path) as folder:
        prefix = folder.name.rpartition("-")[0]
    old, young = (_aged(tmp_path / f"{prefix}-{age}", age) for age in (3700.0, 3500.0))
    foreign = _aged(tmp_path / "zeno-orbits-other", 1e6)
    link = tmp_path / f"{prefix}-link"
    link.symlink_to(foreign, target_is_directory=True)
    with scratch_folder(tmp_path):
        assert not old.exists()
        assert all(path.exists() for path in (young, foreign, foreign / "part", link))


def test_a_folder_of_another_user_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with scratch_folder(tmp_path) as folder:
        prefix = folder.name.rpartition("-")[0]
    old = _aged(tmp_path / f"{prefix}-old", 1e6)
    monkeypatch.setattr(os, "geteuid", lambda: old.stat().st_uid + 1)
    with scratch_folder(tmp_path):
        assert old.exists()


def _fail_without_collection() -> None:
    with without_collection():
        assert not gc.isenabled()
        _full()


def test_garbage_is_collected_again_after_a_pause_even_after_an_error() -> None:
    assert gc.isenabled()
    with pytest.raises(OSError, match="No space"):
        _fail_without_collection()
    assert gc.isenabled()
    gc.disable()
    try:
        with without_collection():
            pass
        # Whoever had turned it off finds it off.
        assert not gc.isenabled()
    finally:
        gc.enable()
