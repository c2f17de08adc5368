"""The command line in this process, and what tests ask of its answers."""

from __future__ import annotations

import io
import json
import re
import shlex
from collections.abc import Callable, Generator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

import pytest

from zeno_orbits.cli import build_parser, main
from zeno_orbits.report.terminal import ProgressLine

YES, NO, MISUSE, INTERRUPTED = 0, 1, 2, 130
PUBLISHED_GAINS = ("--set", "Kp=2.5", "--set", "Kd=-1")


@dataclass(frozen=True)
class Answer:
    """What a command leaves behind."""

    code: int
    out: str
    err: str

    @property
    def data(self) -> Any:
        """Standard output, which must be one JSON document and nothing else."""
        return json.loads(self.out)


_parser = cache(build_parser)
"""To build it takes longer than most commands. A process of a user parses one line."""


def ask(*arguments: str | Path) -> Answer:
    """Run a command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.MonkeyPatch.context() as patch:
        patch.setattr("zeno_orbits.cli.program.build_parser", _parser)
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as ending:
            code = ending.code if isinstance(ending.code, int) else -1
    return Answer(code, out.getvalue(), err.getvalue())


def contents(folder: Path) -> dict[str, bytes | None]:
    """Return path to content of everything below a folder, without Python's own caches."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
        if "__pycache__" not in path.parts
    }


def raising(error: BaseException) -> Callable[..., NoReturn]:
    """Return a stand-in for any function, that raises."""

    def stand_in(*_arguments: Any, **_named: Any) -> NoReturn:
        raise error

    return stand_in


@contextmanager
def interrupted_when(due: Callable[[str, float], bool]) -> Generator[None]:
    """Interrupt every command at its first progress report that is due.

    Args:
        due: From the stage and its part (-1 if unknown) to whether the key is pressed.
    """

    def interrupt(_line: Any, stage: str, part: float | None = None) -> None:
        if due(stage, -1.0 if part is None else part):
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ProgressLine, "__call__", interrupt)
        yield


def error_said(answer: Answer) -> float:
    """Return the estimated error that a command prints."""
    (number,) = re.findall(r"Estimated relative error: (\S+)\.$", answer.out, flags=re.MULTILINE)
    return float(number)


def assert_refused(answer: Answer, *words: str) -> None:
    """Check that a command refused its input in one line and said nothing else."""
    assert answer.code == MISUSE
    assert answer.out == ""
    assert answer.err.startswith("zeno-orbits: ")
    assert answer.err.endswith("\n")
    assert answer.err.count("\n") == 1
    for word in words:
        assert word in answer.err


def examples(command: str) -> list[list[str]]:
    """Return the example lines of a command's help, split as a shell would."""
    answer = ask(command, "--help-all")
    assert answer.code == YES
    lines = re.findall(r"^  zeno-orbits ((?:\\\n|.)+)$", answer.out, flags=re.MULTILINE)
    return [shlex.split(line.replace("\\\n", " ")) for line in lines]
