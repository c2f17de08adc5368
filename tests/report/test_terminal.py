"""Tables in the terminal: whatever its width, no name, number or word is cut."""

from __future__ import annotations

import re

import pytest

from zeno_orbits.errors import counted
from zeno_orbits.model.library import bundled_problems, load_problem
from zeno_orbits.report import terminal
from zeno_orbits.report.table import name_column, number_column, text_column
from zeno_orbits.report.terminal import progress
from zeno_orbits.report.terminal.console import print_table


def plain(text: str) -> str:
    """Return what a terminal shows, without its colours."""
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


@pytest.mark.parametrize("width", ["20", "80", "200"])
def test_no_name_number_or_word_of_a_table_is_cut(
    width: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", width)
    name, number, words = "a name that one must type", "-1.2345678901e-12", "some text to be read"
    columns = [
        name_column("first name", lambda _: name),
        number_column("value [rad/s]", lambda _: number),
        text_column("meaning", lambda _: words),
        text_column("passed", lambda _: True),
    ]
    print_table(columns, [None, None])
    printed = plain(capsys.readouterr().out)
    assert printed.count(name) == printed.count(number) == 2
    for word in (*words.split(), "ok"):
        assert printed.split().count(word) == 2
    for word in ("first", "name", "value", "[rad/s]", "meaning", "passed"):
        assert word in printed.split()


def test_every_problem_is_named_whole_in_eighty_columns(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")
    terminal.print_problems([load_problem(name) for name in bundled_problems()])
    lines = plain(capsys.readouterr().out).splitlines()
    assert all(any(line.split()[:1] == [name] for line in lines) for name in bundled_problems())
    assert max(map(len, lines)) <= 80


def test_one_is_singular_and_everything_else_plural() -> None:
    numbers = [counted(number, "impact") for number in (0, 1, 2)]
    assert numbers == ["0 impacts", "1 impact", "2 impacts"]


# ---------------------------------------------------------------------------- progress


class Clock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now = 0.0

    def perf_counter(self) -> float:
        return self.now


def test_the_time_left_only_falls_within_a_stage_and_begins_anew_with_the_next(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = Clock()
    monkeypatch.setattr(progress, "time", clock)
    monkeypatch.setattr(progress, "_PATIENCE", 1.0)
    line = progress.ProgressLine(lambda: None)
    left: list[list[int]] = [[], []]
    # A pace that slows down, and a second stage that is slower than the first.
    for stage, pace in ((0, 1.0), (1, 3.0)):
        began = clock.now
        for k in range(1, 40):
            clock.now = began + pace * k * (1.0 + 0.03 * k)
            line(f"stage {stage}", k / 40)
            said = capsys.readouterr().err
            told = re.search(r"about (\d+) (s|min) left", said)
            if told is not None:
                left[stage].append(int(told[1]) * (60 if told[2] == "min" else 1))
    for one in left:
        assert len(one) > 3
        assert one == sorted(one, reverse=True)
    assert left[1][0] > left[0][-1]
