"""Compiled libraries and their folder: found, made, trusted, cleared, and what goes wrong there."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.loop.agreement import needs_compiler
from tests.support.cases import fast, often
from tests.support.source_trees import unbuilt_tree
from zeno_orbits.cli import main
from zeno_orbits.loop import library_folder, loop_library

SIMULATE = ("simulate", "bouncing_ball", "--until", "9", "--json")
NOTE = "zeno-orbits: note: executions run in Python, as accurate and slower: "


def ask(cache: Path, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a command in a process of its own, which knows of no library yet."""
    tree = str(unbuilt_tree())
    return subprocess.run(
        [sys.executable, "-m", "zeno_orbits", *words],
        env={**os.environ, "PYTHONPATH": tree, "ZENO_ORBITS_CACHE": str(cache), **variables},
        cwd=tree,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def python_says(cache: Path, code: str, own: str) -> str:
    """Return the output and the errors of a program, in a process that knows of no library yet."""
    tree = str(unbuilt_tree())
    own_variables = {"PYTHONPATH": tree, "ZENO_ORBITS_CACHE": str(cache), "CC": own}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **own_variables},
        cwd=tree,
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    return done.stdout + done.stderr


def notes(done: subprocess.CompletedProcess[str]) -> list[str]:
    """Return what a command wrote beside its output, without the progress of a slow machine."""
    return [line for line in done.stderr.splitlines() if not re.match(r" *\d+\.\d s ", line)]


def simulated(cache: Path, **variables: str) -> str:
    """Return the events of a ball, and require that nothing is noted."""
    done = ask(cache, *SIMULATE, **variables)
    assert (done.returncode, notes(done)) == (0, [])
    return done.stdout


def noted(cache: Path, **variables: str) -> str:
    """Return why a ball is simulated in Python, in one line beside the same events."""
    done = ask(cache, *SIMULATE, **variables)
    assert done.returncode == 0
    (note,) = notes(done)
    assert note.startswith(NOTE)
    assert json.loads(done.stdout)["events"]
    return note.removeprefix(NOTE)


def libraries(cache: Path) -> list[Path]:
    return sorted((cache / "kernels").glob("*.kernels"))


def compiler(folder: Path, script: str) -> str:
    """Write a compiler that is a script, and return its path."""
    program = folder / "compiler"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    return str(program)


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("flags", often(1, ["-ffast-math", "-Ofast"]))
def test_digits_are_the_same_whatever_flags_the_user_has(flags: str, tmp_path: Path) -> None:
    assert simulated(tmp_path / "a", CC=f"cc {flags}") == simulated(tmp_path / "b")


@pytest.mark.slow
@needs_compiler
def test_a_compiler_that_is_fast_and_wrong_after_all_is_found_out(tmp_path: Path) -> None:
    fast = compiler(tmp_path, 'exec cc "$@" -ffast-math')
    assert "the compiled library gives wrong values for" in noted(tmp_path, CC=fast)
    assert libraries(tmp_path) == []


@pytest.mark.slow
@pytest.mark.skipif(find_spec("ziglang") is None, reason="needs the extra `compiled`")
def test_the_compiler_of_the_extra_gives_the_same_events(tmp_path: Path) -> None:
    found = [json.loads(simulated(tmp_path / name, **own)) for name, own in EXTRA.items()]
    times = [[event["time"] for event in one["events"]] for one in found]
    # A ball needs no function of the C library: every operation is rounded alike.
    assert times[0] == times[1]


EXTRA = {"extra": {"CC": f"{sys.executable} -m ziglang cc"}, "own": {"CC": ""}}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "told"),
    [
        ("echo 'fatal error: I am broken' >&2; exit 1", "fatal error: I am broken"),
        ("exit 0", "exit code 0"),
        ('while [ "$1" != -o ]; do shift; done; echo nonsense > "$2"', "cannot be loaded"),
        ('exec cc -Dsin=cos "$@"', "gives wrong values for sines"),
        ("kill -9 $$", "exit code -9"),
        ('ulimit -f 1; exec cc "$@"', "failed"),
    ],
)
@needs_compiler
def test_a_broken_compiler_is_one_line_and_leaves_nothing_behind(
    script: str, told: str, tmp_path: Path
) -> None:
    assert told in noted(tmp_path, CC=compiler(tmp_path, script))
    assert {path.name for path in (tmp_path / "kernels").iterdir()} <= {".loop-lock"}


@pytest.mark.slow
@needs_compiler
def test_a_compilation_is_announced_and_its_time_left_told(tmp_path: Path) -> None:
    # A library from elsewhere stands for a compiler that takes a while.
    made = loop_library()._name
    own = compiler(tmp_path, f'while [ "$1" != -o ]; do shift; done; sleep 1.5; cp {made} "$2"')
    done = ask(tmp_path, *SIMULATE, CC=own)
    assert done.returncode == 0
    line, *_ = done.stderr.splitlines()
    assert re.fullmatch(r" *1\.\d s  compiling the simulator once, about 15 s +\d+ %", line)
    plain = python_says(tmp_path / "python", "import zeno_orbits.loop as l; l.loop_library()", own)
    assert plain == "zeno_orbits: compiling the simulator once, about 15 s\n"
    assert ask(tmp_path, *SIMULATE, CC=own).stderr == ""


@pytest.mark.slow
@needs_compiler
def test_a_source_tree_uses_the_library_of_an_installed_package(tmp_path: Path) -> None:
    tree = unbuilt_tree()
    code = "from zeno_orbits.loop.source import library_name; print(library_name())"
    name = python_says(tmp_path, code, "cc").strip()
    installed = tmp_path / "site" / "zeno_orbits" / "loop" / name
    installed.parent.mkdir(parents=True)
    installed.write_bytes(Path(loop_library()._name).read_bytes())
    both = f"{tree}{os.pathsep}{tmp_path / 'site'}"
    done = ask(tmp_path / "cache", *SIMULATE, "--verbose", CC="no-such", PYTHONPATH=both)
    assert "executions run in compiled code" in done.stderr
    assert not (tmp_path / "cache").exists()


@pytest.mark.slow
@needs_compiler
def test_a_failed_compilation_is_not_remembered(tmp_path: Path) -> None:
    # The compiler stays the same: the program fails for now, as on a full disk.
    broken = tmp_path / "broken"
    broken.touch()
    script = f'if [ -e "{broken}" ]; then echo "error: no room" >&2; exit 1; fi; exec cc "$@"'
    own = compiler(tmp_path, script)
    assert "no room" in noted(tmp_path, CC=own)
    broken.unlink()
    simulated(tmp_path, CC=own)
    assert len(libraries(tmp_path)) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "told"),
    fast(
        1,
        [
            ("no-such-compiler -O3", "the program `no-such-compiler` is missing"),
            ("cc 'unfinished", "CC=`cc 'unfinished` is not a command (No closing quotation)"),
        ],
    ),
)
def test_a_variable_that_names_no_compiler_is_one_line_in_every_command(
    command: str, told: str, tmp_path: Path
) -> None:
    assert told in noted(tmp_path, CC=command)
    described = ask(tmp_path, "cache", CC=command)
    assert (described.returncode, notes(described)) == (0, [])
    assert told in described.stdout
    assert "Compiler: none" in described.stdout


@pytest.mark.slow
@needs_compiler
def test_a_folder_or_file_that_others_may_write_to_is_not_trusted(tmp_path: Path) -> None:
    simulated(tmp_path)
    (file,) = libraries(tmp_path)
    for path in (file.parent, file):
        mode = path.stat().st_mode
        path.chmod(mode | 0o022)
        assert f"other users can write to `{path}`" in noted(tmp_path)
        path.chmod(mode)
    simulated(tmp_path)


@pytest.mark.slow
@needs_compiler
def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert "cannot be made" in noted(tmp_path / "file")


@pytest.mark.slow
@needs_compiler
def test_a_lock_that_a_killed_process_left_holds_nobody_up(tmp_path: Path) -> None:
    (tmp_path / "kernels").mkdir(mode=0o700)
    (tmp_path / "kernels" / ".loop-lock").touch()
    (tmp_path / "kernels" / "zeno-orbits-scratch-1").mkdir()
    simulated(tmp_path)
    assert len(libraries(tmp_path)) == 1


@pytest.mark.slow
@needs_compiler
def test_the_word_never_starts_no_compiler_and_the_other_words_do(tmp_path: Path) -> None:
    assert "ZENO_ORBITS_COMPILE=never" in noted(tmp_path, ZENO_ORBITS_COMPILE="never")
    assert libraries(tmp_path) == []
    found = simulated(tmp_path, ZENO_ORBITS_COMPILE="background")
    assert len(libraries(tmp_path)) == 1
    # What is there is used.
    assert simulated(tmp_path, ZENO_ORBITS_COMPILE="never") == found


def test_another_word_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ZENO_ORBITS_CACHE", str(tmp_path))
    monkeypatch.setenv("ZENO_ORBITS_COMPILE", "sometimes")
    assert main(["cache"]) == 2
    wanted = "Argument `ZENO_ORBITS_COMPILE` must be one of wait, background, never"
    assert wanted in capsys.readouterr().err


@pytest.mark.slow
@needs_compiler
def test_the_cache_is_filled_described_and_cleared(tmp_path: Path) -> None:
    filled = json.loads(ask(tmp_path, "cache", "--compile", "bouncing_ball", "--json").stdout)
    assert filled["libraries"] == len(libraries(tmp_path)) == 2
    assert filled["bytes"] == sum(file.stat().st_size for file in libraries(tmp_path))
    assert filled["failures"] == []
    assert filled["compile"] == "wait"
    described = ask(tmp_path, "cache").stdout
    assert f"Folder: {tmp_path / 'kernels'}\nKept: 2 compiled files, 0." in described
    for name in ("a.failed", "a.job"):
        (tmp_path / "kernels" / name).write_bytes(b"\xff of an earlier release")
    cleared = ask(tmp_path, "cache", "--clear")
    assert cleared.returncode == 0
    assert "Removed: 2 compiled files" in cleared.stdout
    assert list((tmp_path / "kernels").iterdir()) == []


@pytest.mark.slow
@needs_compiler
def test_a_cache_that_cannot_be_filled_is_a_no_with_the_reason(tmp_path: Path) -> None:
    own = compiler(tmp_path, "echo 'error: no room' >&2; exit 1")
    done = ask(tmp_path, "cache", "--compile", "bouncing_ball", CC=own)
    assert done.returncode == 1
    assert "Failed: the formulas of `bouncing_ball` are not compiled" in done.stdout


def test_old_libraries_go_once_there_are_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zeno_orbits.loop.folder._MOST", 2)
    monkeypatch.setenv("ZENO_ORBITS_CACHE", str(tmp_path))
    kept = library_folder()
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
    monkeypatch.delenv("ZENO_ORBITS_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    folder = library_folder()
    assert folder.path == tmp_path / "zeno_orbits" / "kernels"
    folder.make()
    assert folder.path.stat().st_mode & 0o077 == 0
