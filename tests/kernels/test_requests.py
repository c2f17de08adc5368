"""Compiled kernels on request: when there are some and when not; no answer depends on it."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from tests.support.compiling import forget, needs_compiler, use_folder, written_as_c
from zeno_orbits.cli import main
from zeno_orbits.kernels import Kernels, Recipe, account, caller, complaints, order, requests
from zeno_orbits.kernels.folder import KernelFolder, kernel_folder

INPUTS = np.array([0.3, -2.0, np.nan, np.inf, -np.inf, 0.0])


def wave() -> Recipe:
    """One function whose values are NaN and infinite at some of the inputs."""
    x = ca.SX.sym("x", INPUTS.size)
    function = ca.Function("wave", [x], [1 / x + ca.exp(x) + ca.sin(ca.fmin(x, 1.0))])
    return Recipe(maker=f"{written_as_c.__module__}:{written_as_c.__name__}", functions=(function,))


def values_of(kernels: Kernels) -> np.ndarray:
    """Return what the compiled function gives."""
    library, found = kernels.library(), np.zeros(INPUTS.size)
    assert library is not None
    library.caller("wave", [INPUTS], [found])()
    return found


def compiler(folder: Path, script: str) -> str:
    """Write a compiler that is a script, and return its path."""
    program = folder / "compiler"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    return str(program)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder; kernels are waited for."""
    use_folder(monkeypatch, tmp_path / "cache")
    return tmp_path / "cache" / "kernels"


@needs_compiler
def test_a_compiled_kernel_gives_the_bits_of_the_interpreter_nan_and_infinity_too() -> None:
    expected = np.zeros(INPUTS.size)
    caller(wave().functions[0], [INPUTS], [expected])()
    assert np.isnan(expected).any()
    assert np.isinf(expected).any()
    assert np.array_equal(values_of(Kernels(wave())), expected, equal_nan=True)
    assert complaints() == []
    assert account().startswith("steps are compiled by ")


def telling() -> Recipe:
    """A function that tells NaN, infinity and numbers too small for a full mantissa apart."""
    x = ca.SX.sym("x", len(ODD))
    neither = ca.logic_not(ca.logic_or(x <= 0.5, x > 0.5))
    parts = [neither, ca.fabs(x) == np.inf, x / 2, ca.fmin(x, 1.0), (x + 1e300) - 1e300]
    maker = f"{written_as_c.__module__}:{written_as_c.__name__}"
    return Recipe(maker=maker, functions=(ca.Function("wave", [x], [ca.vertcat(*parts)]),))


ODD = np.array([np.nan, np.inf, -np.inf, 1e-308, 1e-310, 0.0, 1.0])


@needs_compiler
@pytest.mark.parametrize(
    "flags",
    ["-ffast-math", "-ffinite-math-only", "-funsafe-math-optimizations", "-Ofast -march=native"],
)
def test_nan_infinity_and_tiny_numbers_survive_whatever_flags_the_user_has(
    flags: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", f"cc {flags}")
    kernels, expected = Kernels(telling()), np.zeros(5 * len(ODD))
    library, found = kernels.library(), np.zeros_like(expected)
    assert complaints() == []
    assert library is not None
    library.caller("wave", [ODD], [found])()
    caller(telling().functions[0], [ODD], [expected])()
    assert expected[: 2 * len(ODD)].tolist() == [1, 0, 0, 0, 0, 0, 0, 0, 1, 1, 0, 0, 0, 0]
    assert np.array_equal(found, expected, equal_nan=True)


@needs_compiler
def test_a_compiler_that_is_fast_and_wrong_after_all_is_found_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", compiler(tmp_path, 'exec cc "$@" -ffast-math'))
    assert Kernels(telling()).library() is None
    assert complaints() == ["the compiled `wave` computes something else"]


@pytest.mark.slow
@pytest.mark.skipif(find_spec("ziglang") is None, reason="needs the extra `compiled`")
def test_the_compiler_of_the_extra_gives_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zeno_orbits.kernels.compiler._NAMES", ())
    expected = np.zeros(INPUTS.size)
    caller(wave().functions[0], [INPUTS], [expected])()
    found = values_of(Kernels(wave()))
    assert "ziglang" in account()
    # Another compiler may take another `exp`, which is right to the last bit but one.
    assert np.allclose(found, expected, rtol=1e-15, atol=0.0, equal_nan=True)


@needs_compiler
def test_a_library_is_made_once_and_loaded_ever_after(monkeypatch: pytest.MonkeyPatch) -> None:
    values = values_of(Kernels(wave()))

    def refuse(*_: object) -> None:
        raise AssertionError("A library is made again.")

    monkeypatch.setattr(order, "_start", refuse)
    assert np.array_equal(values_of(Kernels(wave())), values, equal_nan=True)
    other = Recipe(maker=wave().maker, functions=wave().functions, numbers=(1,))
    with pytest.raises(AssertionError, match="made again"):
        Kernels(other).library()


@needs_compiler
def test_in_the_background_nothing_waits_and_the_library_comes_once_work_repays_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENO_ORBITS_COMPILE", "background")
    kernels = Kernels(wave())
    assert kernels.library() is None
    kernels.owe(requests._REPAYS / 2)
    assert not folder.exists()
    assert "repays no compiling" in account()
    kernels.owe(requests._REPAYS)
    assert list(folder.glob("*.job"))
    assert "being compiled for the next run" in account()
    started = time.monotonic()
    # The request goes just after the library has come.
    while kernels.library() is None or list(folder.glob("*.job")):
        assert time.monotonic() - started < 120.0
        time.sleep(0.05)
    assert np.isfinite(values_of(kernels)[0])


def test_without_a_compiler_steps_are_interpreted_and_nothing_is_wrong(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.setattr("zeno_orbits.kernels.compiler.find_spec", lambda _: None)
    assert Kernels(wave()).library() is None
    assert complaints() == []
    assert "there is no C compiler" in account()
    assert not folder.exists()


def test_who_wants_none_gets_none(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ZENO_ORBITS_COMPILE", "never")
    kernels = Kernels(wave())
    assert kernels.library() is None
    kernels.owe(1e9)
    assert not folder.exists()
    assert "as ZENO_ORBITS_COMPILE=never asks" in account()


@needs_compiler
@pytest.mark.parametrize("there", [True, False])
def test_how_steps_were_taken_is_told_beside_taylors_method_where_that_is_there(
    there: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(requests, "find_spec", lambda _: object() if there else None)
    assert account() == ""
    Kernels(wave()).library()
    assert account().endswith("as fast as `--engine taylor`, and sooner ready") == there
    monkeypatch.setenv("ZENO_ORBITS_COMPILE", "never")
    assert account().endswith("in long runs `--engine taylor` is several times as fast") == there
    assert account().startswith("steps are interpreted, as ZENO_ORBITS_COMPILE=never asks")


def test_a_compiler_that_does_not_exist_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler -O3")
    assert Kernels(wave()).library() is None
    assert complaints() == [
        "`CC` must name a C compiler, but there is no program `no-such-compiler`"
    ]


@pytest.mark.parametrize(
    ("script", "told"),
    [
        ("echo 'fatal error: I am broken' >&2; exit 1", "fatal error: I am broken"),
        ("exit 0", "exit code 0"),
        ('while [ "$1" != -o ]; do shift; done; echo nonsense > "$2"', "cannot be loaded"),
        ('exec cc -Dsin=cos "$@"', "computes something else"),
        ("kill -9 $$", "exit code -9"),
    ],
)
@needs_compiler
def test_a_broken_compiler_is_one_line_and_is_not_tried_again(
    script: str, told: str, tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", compiler(tmp_path, script))
    assert Kernels(wave()).library() is None
    (said,) = complaints()
    assert told in said
    assert "\n" not in said
    assert not list(folder.glob("*.kernels"))
    assert not list(folder.glob(".unfinished*"))

    def refuse(*_: object) -> None:
        raise AssertionError("A library is made again.")

    forget(monkeypatch)
    monkeypatch.setattr(order, "_start", refuse)
    assert Kernels(wave()).library() is None
    assert complaints() == [said]


@needs_compiler
@pytest.mark.parametrize(
    "length", [-1, *(pytest.param(n, marks=pytest.mark.slow) for n in (0, 99))]
)
def test_a_library_that_was_cut_is_made_again(length: int, folder: Path) -> None:
    values = values_of(Kernels(wave()))
    (file,) = folder.glob("*.kernels")
    whole = file.read_bytes()
    # Another file of this name: the first one is in use.
    file.unlink()
    file.write_bytes(whole[:length])
    file.chmod(0o600)
    assert np.array_equal(values_of(Kernels(wave())), values, equal_nan=True)
    assert complaints() == []


@needs_compiler
def test_a_folder_or_file_that_others_may_write_to_is_not_trusted(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values_of(Kernels(wave()))
    (file,) = folder.glob("*.kernels")
    for path in (folder, file):
        mode = path.stat().st_mode
        path.chmod(mode | 0o022)
        forget(monkeypatch)
        assert Kernels(wave()).library() is None
        assert complaints() == [f"`{path}` must be the user's alone, but others may write to it"]
        path.chmod(mode)
    forget(monkeypatch)
    assert Kernels(wave()).library() is not None


@needs_compiler
def test_a_folder_that_cannot_be_made_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("ZENO_ORBITS_CACHE", str(tmp_path / "file"))
    assert Kernels(wave()).library() is None
    (said,) = complaints()
    assert "cannot be made" in said


@needs_compiler
def test_a_full_disk_is_one_line(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.open

    def full(path: object, *rest: int) -> int:
        if str(path).endswith(".job"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(path, *rest)

    monkeypatch.setattr(os, "open", full)
    assert Kernels(wave()).library() is None
    assert complaints() == [f"`{folder}` cannot be written (No space left on device)"]


@needs_compiler
def test_a_disk_that_is_full_while_compiling_leaves_nothing_behind(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", compiler(tmp_path, 'ulimit -f 1; exec cc "$@"'))
    assert Kernels(wave()).library() is None
    assert len(complaints()) == 1
    assert {path.suffix for path in folder.iterdir() if path.name != ".lock"} == {".failed"}


@needs_compiler
def test_two_processes_at_once_compile_once_and_both_are_served(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "log"
    monkeypatch.setenv("CC", compiler(tmp_path, f'echo once >> {log}; sleep 1; exec cc "$@"'))
    program = (
        "from tests.kernels.test_requests import values_of, wave\n"
        "from zeno_orbits.kernels import Kernels\n"
        "print(float(values_of(Kernels(wave()))[0]).hex())"
    )
    started = [
        subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    answers = {process.communicate(timeout=120)[0] for process in started}
    assert [process.returncode for process in started] == [0, 0]
    assert len(answers) == 1
    assert log.read_text() == "once\n"
    assert len(list(folder.glob("*.kernels"))) == 1


@needs_compiler
def test_a_request_that_nobody_works_on_any_more_is_taken_over(folder: Path) -> None:
    values_of(Kernels(wave()))
    (file,) = folder.glob("*.kernels")
    job = folder / f"{file.name.partition('-')[0]}.job"
    file.unlink()
    job.touch()
    long_ago = time.time() - 2 * order._ABANDONED
    os.utime(job, (long_ago, long_ago))
    assert np.isfinite(values_of(Kernels(wave()))[0])


def test_a_process_that_was_killed_while_it_compiled_is_not_waited_for_for_ever(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values_of(Kernels(wave()))
    (file,) = folder.glob("*.kernels")
    file.unlink()
    (folder / f"{file.name.partition('-')[0]}.job").touch()
    monkeypatch.setattr(order, "_PATIENCE", 0.2)
    kernels = Kernels(wave())
    assert not kernels.build()
    assert any("another process has not compiled" in complaint for complaint in complaints())


def test_old_libraries_go_once_there_are_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zeno_orbits.kernels.folder._MOST", 2)
    kept = KernelFolder(tmp_path / "kept")
    kept.make()
    for k in range(3):
        made = kept.path / "made"
        made.write_text(str(k))
        file = kept.store(f"key{k}", made)
        os.utime(file, (k, k))
    assert kept.find("key0") is None
    assert kept.find("key2") == file


def test_the_folder_is_private_and_where_the_system_keeps_such_things(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ZENO_ORBITS_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    folder = kernel_folder()
    assert folder.path == tmp_path / "zeno_orbits" / "kernels"
    folder.make()
    assert folder.path.stat().st_mode & 0o077 == 0


@needs_compiler
def test_the_cache_is_described_and_cleared(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values_of(Kernels(wave()))
    assert main(["cache"]) == 0
    said = capsys.readouterr().out
    assert f"Folder: {folder}" in said
    assert "Kept: 1 compiled mode, 0." in said
    assert main(["cache", "--clear"]) == 0
    assert "Removed: 1 compiled mode" in capsys.readouterr().out
    assert list(folder.iterdir()) == []


def test_a_word_that_says_nothing_known_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ZENO_ORBITS_COMPILE", "sometimes")
    assert main(["cache"]) == 2
    wanted = "Argument `ZENO_ORBITS_COMPILE` must be one of background, wait, never"
    assert wanted in capsys.readouterr().err
