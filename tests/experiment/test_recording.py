"""Files of time series as they are met: what is read, what is left out, what is refused."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from tests.support.cases import fast
from zeno_orbits import write_recording
from zeno_orbits.errors import DataFileError, InputError
from zeno_orbits.experiment import RecordedSignal, Recording, Source, read_recording

HEAD = "# zeno-orbits data 1\n# source: measured\n# problem: some_problem\n"
TITLES = "time [s],angle [rad],current [A]\n"
ROWS = "0.0,1.5,-2\n0.5,2.5,3e-1\n1.0,3.5,0\n"

Write = Callable[[str | bytes], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def written(content: str | bytes) -> Path:
        path = tmp_path / "data.csv"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return written


def angles(recording: Recording) -> list[float]:
    return recording.signal("angle").values.tolist()


def test_a_whole_file_is_read(write: Write) -> None:
    found = read_recording(write(HEAD + "# rig: the second one\n" + TITLES + ROWS))
    assert found.source is Source.MEASURED
    assert found.problem == "some_problem"
    assert dict(found.notes) == {"rig": "the second one"}
    assert found.time.tolist() == [0.0, 0.5, 1.0]
    assert found.names == ("angle", "current")
    assert angles(found) == [1.5, 2.5, 3.5]
    assert found.signal("current").values.tolist() == [-2.0, 0.3, 0.0]
    assert found.remarks == ()


def test_the_problem_of_a_file_of_version_0_1_is_its_scene(write: Write) -> None:
    found = read_recording(write(HEAD.replace("problem", "scene", 1) + TITLES + ROWS))
    assert found.problem == "some_problem"
    assert dict(found.notes) == {}


def test_the_lines_above_the_titles_may_be_missing(write: Write) -> None:
    found = read_recording(write(TITLES + ROWS))
    assert (found.source, found.problem, found.names) == (None, "", ("angle", "current"))


numbers = st.floats(allow_nan=True, allow_infinity=False)


@pytest.mark.slow
@given(st.lists(st.tuples(numbers, numbers), min_size=2, max_size=30))
def test_what_is_written_is_read_to_the_bit(rows: list[tuple[float, float]]) -> None:
    import tempfile

    first, second = np.array(rows).T
    time = np.cumsum(np.linspace(0.1, 0.2, len(rows)))
    signals = (
        RecordedSignal(name="a", unit="rad", values=first),
        RecordedSignal(name="b", unit="N m s/rad", values=second),
    )
    notes = {"seed": "4"}
    whole = Recording(source=Source.SIMULATED, problem="x", time=time, signals=signals, notes=notes)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "out.csv"
        write_recording(whole, path)
        found = read_recording(path)
    assert (found.source, found.problem, found.notes) == (whole.source, "x", notes)
    assert_array_equal(found.time, time)
    for here, there in zip(found.signals, signals, strict=True):
        assert (here.name, here.unit) == (there.name, there.unit)
        assert_array_equal(here.values, there.values)


def test_units_are_converted(write: Write) -> None:
    found = read_recording(write("time [ms],angle [deg],current [mA]\n0,180,1500\n5,90,-2\n"))
    assert found.time.tolist() == [0.0, 0.005]
    assert angles(found) == pytest.approx([math.pi, math.pi / 2], rel=1e-15)
    assert found.signal("angle").unit == "rad"
    assert found.signal("current").values.tolist() == [1.5, -0.002]


@pytest.mark.parametrize(
    "content",
    [
        "\ufeff" + TITLES + ROWS,
        (TITLES + ROWS).replace("\n", "\r\n"),
        (TITLES + ROWS).replace("\n", "\r"),
        (TITLES + ROWS).replace(",", "\t"),
        (TITLES + ROWS).replace(",", ";"),
        (TITLES + ROWS).replace(",", ";").replace(".", ","),
        (TITLES + ROWS).replace(",", "\t").replace(".", ","),
        TITLES.replace(",", " , ") + ROWS.replace(",", " ,  "),
        TITLES.replace(",", '","').replace("time", '"time').replace("[A]", '[A]"') + ROWS,
        TITLES + "\n" + ROWS + "\n\n",
        TITLES + ROWS.replace("0.5", "# a remark\n0.5"),
        TITLES + ROWS.removesuffix("\n"),
        TITLES + ROWS.replace("1.5", '"1.5"'),
        TITLES.replace("[", "(").replace("]", ")") + ROWS,
        TITLES.replace("\n", ",\n") + ROWS.replace("\n", ",\n"),
        TITLES + ROWS.replace("\n", ",\n"),
        TITLES.replace("time", "t") + ROWS,
        TITLES.replace("time", "Time") + ROWS,
        "# Größe\n" + TITLES + ROWS,
        "# Größe\n".encode("latin-1") + (TITLES + ROWS).encode(),
    ],
    ids=lambda content: repr(content)[:60],
)
def test_the_same_numbers_are_read_however_the_file_is_written(
    write: Write, content: str | bytes
) -> None:
    found = read_recording(write(content))
    assert found.time.tolist() == [0.0, 0.5, 1.0]
    assert angles(found) == [1.5, 2.5, 3.5]
    assert found.signal("current").values.tolist() == [-2.0, 0.3, 0.0]


def test_columns_may_stand_in_any_order(write: Write) -> None:
    found = read_recording(write("a [rad],time [s],b [rad]\n1,0,2\n3,1,4\n"))
    assert found.time.tolist() == [0.0, 1.0]
    assert found.signal("b").values.tolist() == [2.0, 4.0]


@pytest.mark.parametrize("hole", ["", "nan", "NaN", "NA", "null", "-", "inf", "-inf", "1e999"])
def test_a_hole_stays_a_hole_and_is_counted(write: Write, hole: str) -> None:
    found = read_recording(write(TITLES + ROWS.replace("2.5", hole)))
    assert math.isnan(angles(found)[1])
    assert found.signal("current").values.tolist() == [-2.0, 0.3, 0.0]
    infinite = ", infinite in 1 of them" if hole in ("inf", "-inf", "1e999") else ""
    assert found.remarks == (f"`angle` is missing in 1 of 3 rows{infinite}",)


def test_a_row_without_a_time_is_left_out_and_said(write: Write) -> None:
    found = read_recording(write(HEAD + TITLES + ROWS.replace("0.5", "nan")))
    assert angles(found) == [1.5, 3.5]
    assert found.remarks == ("1 row without a time left out, first line 6",)


def test_a_repeated_time_is_left_out_and_said(write: Write) -> None:
    found = read_recording(write(TITLES + ROWS + "1.0,9,9\n1.5,4.5,0\n"))
    assert angles(found) == [1.5, 2.5, 3.5, 4.5]
    assert found.remarks == ("1 row with the time of the row before left out, first line 5",)


def test_a_gap_in_time_is_said(write: Write) -> None:
    found = read_recording(write("time [s],a [rad]\n0,1\n1,1\n2,1\n30,1\n31,1\n"))
    assert found.remarks == ("1 gap in time, the longest 28 s after t = 2 s",)


def test_a_last_line_that_is_cut_short_is_left_out_and_said(write: Write) -> None:
    found = read_recording(write(TITLES + ROWS + "1.5,4."))
    assert angles(found) == [1.5, 2.5, 3.5]
    assert found.remarks == ("line 5, the last, is cut short and was left out",)


def test_columns_that_nobody_asks_for_may_hold_anything(write: Write) -> None:
    content = "time [s],state,angle [rad]\n0,idle,1\n1,run,2\n"
    assert angles(read_recording(write(content), only=("angle",))) == [1.0, 2.0]
    whole = read_recording(write(content))
    assert whole.names == ("angle",)
    assert whole.remarks == ("1 column of text left out: `state`",)


@cache
def _long() -> tuple[str, ...]:
    """Return lines of more than one piece of the reader: some 4 MB are read at a time."""
    return tuple(f"{k * 0.001!r},{k % 7}.25,{-k}\n" for k in range(200_000))


@pytest.mark.parametrize("at", fast(1, [100_000, 0, 1, 199_999]))
@pytest.mark.parametrize(
    ("before", "after", "reason"),
    [
        (".25,", ".25x,", r"line {} has `\d\.25x` where column `angle \[rad\]` has a number"),
        (".25,", ".25,7,", "line {} has 4 columns where line 1 names 3"),
        (".25,", ".25;", "line {} has 2 columns where line 1 names 3"),
        (".25,", ".2_5,", r"line {} has `\d\.2_5` where"),
    ],
)
def test_a_false_line_is_named_wherever_it_stands(
    write: Write, at: int, before: str, after: str, reason: str
) -> None:
    lines = list(_long())
    lines[at] = lines[at].replace(before, after)
    with pytest.raises(DataFileError, match=reason.format(at + 2)):
        read_recording(write(TITLES + "".join(lines)))


@pytest.mark.slow
def test_a_hole_in_every_line_of_a_long_file_is_kept(write: Write) -> None:
    lines = "".join(f"{k * 0.001!r},{k % 7}.25,,{-k}\n" for k in range(200_000))
    found = read_recording(write("time [s],angle [rad],empty [V],current [A]\n" + lines))
    assert len(found.time) == 200_000
    assert np.isnan(found.signal("empty").values).all()
    assert found.signal("current").values[-1] == -199_999.0


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("", "a line of column titles is missing"),
        ("\n\n", "a line of column titles is missing"),
        (HEAD, "a line of column titles is missing"),
        (TITLES, "it has 0 rows of values, and two are needed"),
        (TITLES + "0,1,2\n", "it has 1 row of values"),
        (TITLES + "nan,1,2\nnan,1,2\n", "it has 0 rows of values"),
        ('{"time": [0, 1]}\n', "it is a JSON file: save the table as CSV"),
        (ROWS, "line 1 holds numbers in place of the column titles"),
        ("time angle\n0 1\n", "line 1 must separate its columns by commas, semicolons or tabs"),
        ("angle [rad],x [m]\n0,1\n1,2\n", r"no column named `time` \(its columns: angle, x\)"),
        ("time [s],t [s],x [m]\n0,1,2\n1,2,3\n", "more than one column named `time`"),
        ("time [s],x [m],x [m]\n0,1,2\n1,2,3\n", "two of its columns are named `x`"),
        ("time [rad],x [m]\n0,1\n1,2\n", r"column `time \[rad\]` is not a time"),
        ("time,x [m]\n0,1\n1,2\n", r"column `time` lacks a unit: write for instance `time \["),
        ("time [s],x [counts]\n0,1\n1,2\n", "the unit of column `x` is not clear: `counts`"),
        ("time [s],x []\n0,1\n1,2\n", "the unit of column `x` is not clear"),
        (
            HEAD.replace("data 1", "data 2") + TITLES + ROWS,
            "its format is 2, .* is 1. Update zeno_orbits",
        ),
        (HEAD.replace("measured", "guessed") + TITLES + ROWS, "must name one of measured"),
        (TITLES + ROWS + "0.75,1,1\n", "the time decreases from 1 to 0.75 in line 5: sort"),
        (TITLES + "0,1,1\n0,1,1\n0,1,1\n1,1,1\n1,2,2\n", "most of its times repeat .* line 3"),
        (TITLES + "0,0,1,5,2,5\n0,5,1,5,2,5\n", "6 columns .* with decimal commas, separate"),
        (
            (TITLES + ROWS).replace(",", ";").replace("2.5", "2,5"),
            "line 3 writes decimals with `,`",
        ),
        (TITLES + "2026-11-05 12:00,1,2\n", "line 2 has `2026-11-05 12:00` where column `time"),
        ("time [s]\tx [m]\n0\t1.234,5\n1\t2\n", "line 2 has `1.234,5` where column"),
        ((TITLES + ROWS).encode("utf-16")[:-1], "it is broken UTF-16 text; save it"),
        (TITLES.encode() + b"0,1,2\n\0\0\0\0", "it is a binary file"),
    ],
    ids=lambda value: repr(value)[:50],
)
def test_what_cannot_be_understood_is_refused_in_one_line(
    write: Write, content: str | bytes, reason: str
) -> None:
    with pytest.raises(DataFileError, match=reason) as caught:
        read_recording(write(content))
    assert str(caught.value).startswith("Data file `")
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataFileError, match="cannot be read"):
        read_recording(tmp_path / "none.csv")
    with pytest.raises(DataFileError, match="it is a folder: name a file in it"):
        read_recording(tmp_path)


@pytest.mark.slow
def test_a_long_file_is_held_once(write: Write) -> None:
    # 1.2e6 rows of three numbers are 29 MB (38 MB with the line numbers); twice would be 77 MB,
    # and the text itself is 30 MB. A piece of text and its rows take some 30 MB at a time.
    rows = "".join(f"{k},1.5,2.5\n" for k in range(1_200_000))
    path = write(TITLES + rows)
    del rows
    tracemalloc.start()
    found = read_recording(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(found.time) == 1_200_000
    assert peak < 38e6 * 2 + 30e6


def test_a_recording_refuses_signals_that_do_not_belong_together() -> None:
    time = np.array([0.0, 1.0])
    good = RecordedSignal(name="a", unit="rad", values=np.zeros(2))
    short = RecordedSignal(name="b", unit="rad", values=np.zeros(1))
    for signals, reason in (((good, good), "different names"), ((short,), "must have 2 values")):
        with pytest.raises(ValueError, match=reason):
            Recording(source=None, problem="", time=time, signals=signals)
    for wrong in (time[::-1], time[:1], np.zeros(2), np.array([0.0, math.nan])):
        with pytest.raises(ValueError, match="`time` must hold two or more times that increase"):
            Recording(source=None, problem="", time=wrong, signals=())


def test_an_unknown_signal_is_refused_by_name(write: Write) -> None:
    found = read_recording(write(TITLES + ROWS))
    with pytest.raises(InputError, match=r"`signal`: unknown name `x`\. Known: angle, current"):
        found.signal("x")


@pytest.mark.slow
@pytest.mark.parametrize("holes", [False, True], ids=["whole", "with holes"])
def test_a_million_rows_are_read_in_two_seconds_from_a_path_as_text(
    tmp_path: Path, holes: bool
) -> None:
    import time

    n = 1_000_000
    one, other = np.char.mod("%.9g", np.random.default_rng(0).normal(size=(2, n)))
    if holes:
        one[::7] = ""
    rows = map(",".join, zip(np.char.mod("%.6f", np.arange(n) / 1000), one, other, strict=True))
    path = tmp_path / "long.csv"
    path.write_text("time [s],a [rad],b [A]\n" + "\n".join(rows) + "\n")
    begin = time.process_time()
    found = read_recording(str(path))
    assert time.process_time() - begin < 2.0
    assert len(found.time) == n
    assert np.isnan(found.signal("a").values).sum() == (len(one[::7]) if holes else 0)
    assert found.signal("b").values[-1] == float(other[-1])
