"""Wrong recordings: one line with the file, the line or column, and the remedy."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from tests.support.commands import ask, assert_refused

pytestmark = pytest.mark.usefixtures("here", "orbit_file")

HEAD = "# zeno-orbits data 1\n# source: measured\n# problem: motor_pendulum\n"
TITLES = "time [s],theta1 [rad],theta2 [rad],current [A]"
ROWS = "".join(f"{k / 10},{k % 7 / 10},0.{k},-{k}\n" for k in range(9))
WHOLE = f"{HEAD}{TITLES}\n{ROWS}"


def titled(titles: str) -> str:
    return f"{HEAD}{titles}\n{ROWS}"


def retitled(old: str, new: str) -> str:
    assert old in TITLES
    return titled(TITLES.replace(old, new))


def rowed(change: Callable[[list[str]], list[str]]) -> str:
    return f"{HEAD}{TITLES}\n" + "\n".join(change(ROWS.splitlines())) + "\n"


WRONG: Mapping[str, tuple[str | bytes, str, str]] = {
    "empty": ("", "a line of column titles is missing", "such as `time [s],angle [rad]`"),
    "titles alone": (f"{HEAD}{TITLES}\n", "it has 0 rows of values", "record more"),
    "one row": (rowed(lambda rows: rows[:1]), "it has 1 row of values", "record more"),
    "no titles": (ROWS, "line 1 holds numbers in place of", "add a line such as `time [s],"),
    "time alone": (
        f"{HEAD}time [s]\n0\n1\n",
        "line 4 names one column, `time [s]`",
        "record a signal",
    ),
    "no signal": (
        f"{HEAD}time [s],foo [m]\n0,1\n1,2\n",
        "line 4 names no signal of the problem (its columns: time, foo)",
        "Known: theta1, theta2",
    ),
    "another problem": (
        f"{HEAD.replace('motor_pendulum', 'relay')}time [s],z [m]\n0,1\n1,2\n",
        "line 4 names no signal of the problem",
        "The file is a recording of the problem `relay`",
    ),
    "misspelt signal alone": (
        f"{HEAD}time [s],thta1 [rad]\n0,1\n1,2\n",
        "line 4 names no signal of the problem (its columns: time, thta1)",
        "Did you mean `theta1`?",
    ),
    "speed as an angle": (
        retitled("theta1 [rad]", "theta1 [rad/s]"),
        "line 4: column `theta1` has the unit rad/s",
        "the signal is in rad: correct the title",
    ),
    "voltage as a current": (
        retitled("[A]", "[V]"),
        "line 4: column `current` has the unit V",
        "the signal is in A: correct the title",
    ),
    "no unit": (retitled(" [A]", ""), "line 4: column `current` lacks a unit", "`current [A]`"),
    "unknown unit": (retitled("[A]", "[Amp]"), "line 4: the unit of column `current`", "write `A`"),
    "misspelt time": (retitled("time", "tiem"), "line 4 has no column", "rename `tiem` to `time`"),
    "no time": (retitled("time", "x"), "line 4 has no column named `time`", "name one column"),
    "two times": (
        retitled("theta1 [rad]", "t [s]"),
        "line 4 has more than one column named `time`",
        "name one column `time`",
    ),
    "time in radians": (
        retitled("time [s]", "time [rad]"),
        "line 4: column `time [rad]` is not a time",
        "write `time [s]`",
    ),
    "one name twice": (
        retitled("theta2", "theta1"),
        "line 4: two of its columns are named `theta1`",
        "rename or delete one",
    ),
    "text as a value": (
        rowed(lambda rows: [*rows[:3], "0.3,oops,1,1", *rows[4:]]),
        "line 8 has `oops` where column `theta1 [rad]` has a number",
        "correct or empty it",
    ),
    "date as a time": (
        rowed(lambda rows: ["2026-01-01 12:00,1,1,1", *rows]),
        "line 5 has `2026-01-01 12:00` where column `time [s]`",
        "write seconds since the start",
    ),
    "short row": (
        rowed(lambda rows: ["0,1", *rows[1:]]),
        "line 5 has 2 columns where line 4 names 4",
        "correct or delete the line",
    ),
    "long row": (
        rowed(lambda rows: ["0,1,1,1,1", *rows[1:]]),
        "line 5 has 5 columns where line 4 names 4",
        "correct or delete the line",
    ),
    "decimal commas": (
        rowed(lambda rows: ["0,0,1,5,2,5,1,0", *rows[1:]]),
        "line 5 has 8 columns where line 4 names 4",
        "with decimal commas, separate the columns by semicolons",
    ),
    "time that decreases": (
        rowed(lambda rows: [*rows, rows[2]]),
        "the time decreases from 0.8 to 0.2 in line 14",
        "sort the lines",
    ),
    "times that repeat": (
        rowed(lambda rows: [f"0,{row.partition(',')[2]}" for row in rows]),
        "most of its times repeat the one before, first in line 6",
        "write the time with more digits",
    ),
    "separated by spaces": (
        WHOLE.replace(",", "  "),
        "line 4 must separate its columns",
        "by commas, semicolons or tabs",
    ),
    "misspelt source": (
        WHOLE.replace("measured", "measred"),
        "its line `# source:` must name one of measured, simulated, not `measred`",
        "Did you mean `measured`?",
    ),
    "newer format": (WHOLE.replace("data 1", "data 9"), "its format is 9", "Update zeno_orbits"),
    "unknown contact": (
        retitled("current [A]", "contact.foo [1]"),
        "unknown name `contact.foo`",
        "Did you mean `contact`?",
    ),
    "contact in volts": (
        retitled("current [A]", "contact [V]"),
        "contact channel `contact`, but it has -1",
        "must have only 0 and 1",
    ),
    "no values": (
        rowed(lambda rows: [f"{row.partition(',')[0]},nan,nan,nan" for row in rows]),
        "lacks values",
        "no signal of it has a number",
    ),
    "rows by another separator": (
        rowed(lambda rows: [row.replace(",", ";") for row in rows]),
        "line 5 has 1 column where line 4 names 4",
        "separated by `,`: use one separator",
    ),
    "UTF-16": (WHOLE.encode("utf-16")[:-1], "it is broken UTF-16 text", "save it as UTF-8"),
    "spreadsheet": (b"PK\x03\x04\x00\x00rest\n", "it is a spreadsheet", "save the table as CSV"),
    "web page": (b"\xef\xbb\xbf\n<!DOCTYPE html>\n", "a web page (HTML)", "save the table as CSV"),
    "packed": (b"\x1f\x8b\x08rest", "it is a compressed file", "unpack it"),
}


@pytest.mark.parametrize("case", WRONG)
@pytest.mark.parametrize("command", ["compare", "identify"])
def test_a_wrong_recording_is_one_line_with_its_place_and_remedy(command: str, case: str) -> None:
    content, place, remedy = WRONG[case]
    Path("d.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    words = ("--fit", "R") if command == "identify" else ()
    assert_refused(ask(command, "orbit.json", "d.csv", *words), "d.csv", place, remedy)


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (lambda _: "nan", "no signal of it has a number"),
        (lambda _: "1e300", "must have values of `height` up to 1e+100, but it has 1e+300"),
        (lambda k: "nan" if k > 100 else f"{1 + 0.1 * math.sin(k)}", "No parameters were found"),
    ],
)
def test_a_recording_of_a_problem_is_refused_in_one_line(
    value: Callable[[int], str], told: str
) -> None:
    rows = [f"{0.01 * k},{value(k)}" for k in range(200)]
    Path("d.csv").write_text("\n".join(["time [s],height [m]", *rows]))
    answer = ask("identify", "bouncing_ball", "d.csv", "--fit", "restitution")
    assert answer.code in (1, 2)
    assert answer.err.count("\n") == 1
    assert "RuntimeWarning" not in answer.err
    assert told in answer.err


def test_the_table_holds_thirty_recordings() -> None:
    assert len(WRONG) >= 30


@pytest.mark.parametrize(
    ("title", "meant"), [("thta1 [rad]", "thta1"), ("Theta1 [rad]", "Theta1"), ("theta1 rad", None)]
)
def test_a_column_with_a_slip_is_noted_beside_signals(title: str, meant: str | None) -> None:
    from zeno_orbits.experiment import read_recording

    Path("d.csv").write_text(retitled("theta1 [rad]", title))
    known = {"theta1": "rad", "theta2": "rad", "current": "A"}
    found = read_recording("d.csv", only=known, units=known)
    told = f"line 4: column `{meant or title}` is not a signal of the problem and was left out"
    assert found.remarks == (f"{told}: rename it if it is `theta1`",)
