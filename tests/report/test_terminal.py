"""Tables in the terminal: whatever its width, no name, number or word is cut."""

from __future__ import annotations

import io
import re
import sys
from types import ModuleType, SimpleNamespace
from typing import cast

import pytest

import zeno_orbits as zo
from zeno_orbits.errors import counted
from zeno_orbits.model import bundled_problems, load_problem
from zeno_orbits.report import terminal
from zeno_orbits.report.terminal import NotebookLine, line_for_watcher, progress


def plain(text: str) -> str:
    """Return what a terminal shows, without its colours."""
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


def test_a_sentence_ends_its_lines_between_words_in_a_terminal_and_is_whole_in_a_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    name = "a_name_that_is_much_longer_than_a_line_of_thirty"
    sentence = f"  The state `{name}` is not known, and --until neither."
    for is_terminal in (False, True):
        monkeypatch.setattr("sys.stdout.isatty", lambda is_terminal=is_terminal: is_terminal)
        monkeypatch.setattr("sys.stderr.isatty", lambda is_terminal=is_terminal: is_terminal)
        terminal.print_lines([sentence])
        terminal.print_error(sentence)
        terminal.print_whole([sentence])
        printed, error = capsys.readouterr()
        *folded, whole = plain(printed).splitlines()
        assert whole == sentence
        assert " ".join(printed.split()).count(f"`{name}` is not known, and --until neither.") == 2
        assert all(line.startswith("  ") for line in folded)
        assert (len(folded) > 1) == (len(error.splitlines()) > 1) == is_terminal
        assert all(len(line) <= 30 or name in line for line in folded if is_terminal)


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


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The clock of progress, which is patient for a second."""
    clock = Clock()
    monkeypatch.setattr(progress, "time", clock)
    monkeypatch.setattr(progress, "_PATIENCE", 1.0)
    return clock


def test_the_time_left_only_falls_within_a_stage_and_begins_anew_with_the_next(
    clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
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
    # Nothing is done for a while: no estimate is left when it has run out.
    clock.now += 1000.0
    line("stage 1", 0.975)
    assert "left" not in capsys.readouterr().err
    for one in left:
        assert len(one) > 3
        assert one == sorted(one, reverse=True)
    assert left[1][0] > left[0][-1]


def test_the_time_left_is_not_told_by_a_trace_of_the_work_while_workers_start(
    clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    line = progress.ProgressLine(lambda: None)
    for now, part, told in ((30.0, 1e-4, False), (40.0, 0.02, True), (80.0, 0.04, True)):
        clock.now = now
        line("points", part)
        assert ("left" in capsys.readouterr().err) == told


def _in_words(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60:.0f} min"


def test_work_that_turns_out_to_be_more_does_not_begin_the_time_left_anew(
    clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    line = progress.ProgressLine(lambda: None)
    for now, part in ((90.0, 0.4), (105.0, 0.399), (130.0, 0.4001), (150.0, 0.45)):
        clock.now = now
        line(f"points at {now}", part)
        # 90 s for 40 % leave 135 s, which pass with the clock.
        assert f"about {_in_words(225.0 - now)} left" in capsys.readouterr().err


def test_a_file_gets_a_line_when_something_is_new_and_a_sign_of_life_ever_more_rarely(
    clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    line = progress.ProgressLine(lambda: None)
    for now in range(100):
        clock.now = float(now)
        line("0 of 2 directions" if now < 90 else "1 of 2 directions", None)
    said = [float(one.split()[0]) for one in capsys.readouterr().err.splitlines()]
    # From the first second on, at each doubling; and the news at the next occasion.
    assert said == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 90.0]


class _Display:
    """IPython's `display`, which remembers what the cell shows."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def __call__(self, data: dict[str, str], **_: object) -> _Display:
        self.texts.append(data["text/plain"])
        return self

    update = __call__


class _Hurried(Clock):
    """A clock on which an hour passes whenever it is looked at."""

    def perf_counter(self) -> float:
        self.now += 3600.0
        return self.now


@pytest.fixture
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_PATIENCE", 1.0)
    monkeypatch.setattr(progress, "time", _Hurried())


@pytest.mark.usefixtures("_impatient")
def test_a_notebook_shows_one_line_that_disappears() -> None:
    display = _Display()
    with NotebookLine(display) as line:
        line("looking", 0.5)
    assert "looking   50 %" in display.texts[0]
    assert display.texts[-1] == ""


def test_a_line_is_shown_unasked_where_somebody_watches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    monkeypatch.setattr("sys.stderr", io.StringIO())
    assert line_for_watcher() is None
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    assert isinstance(line_for_watcher(), progress.ProgressLine)
    shell = SimpleNamespace(kernel=object())
    ipython = SimpleNamespace(
        get_ipython=lambda: shell, display=SimpleNamespace(display=_Display())
    )
    monkeypatch.setitem(sys.modules, "IPython", cast("ModuleType", ipython))
    assert isinstance(line_for_watcher(), NotebookLine)


@pytest.mark.usefixtures("_impatient")
def test_the_front_door_shows_progress_unless_it_is_taken_elsewhere(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    display, told = _Display(), list[str]()
    monkeypatch.setattr("zeno_orbits.report.line_for_watcher", lambda: NotebookLine(display))
    plane = {"x": ("restitution", 0.1, 0.3, 2), "y": ("g", 9.0, 10.0, 2)}
    zo.parameter_map("bouncing_ball", **plane)
    assert any("4 of 4 points" in text for text in display.texts)
    shown = len(display.texts)
    zo.parameter_map("bouncing_ball", **plane, on_progress=lambda stage, _: told.append(stage))
    assert len(display.texts) == shown
    assert told
