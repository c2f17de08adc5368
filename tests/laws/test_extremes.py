"""The extremes: every row is right to its stated tolerance or ends in a named error.

`extremes.py` holds the rows, `docs/extremes.md` shows them to the reader, alike ones in a line.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from scipy.integrate import DOP853, Radau

from tests.reference.independent import Follower, Method
from tests.reference.reference_orbit import FIRST_RATE, PERIOD, ZENO_STATE, ZENO_TIME
from tests.support.cases import fast
from tests.support.extremes import (
    CALIBRATED,
    FLYING,
    ROWS,
    Row,
    difference,
    lines,
    vanishing_sequence,
)
from zeno_orbits.model import load_problem, load_reference
from zeno_orbits.simulation import simulate

TABLE = Path(__file__).parents[2] / "docs" / "extremes.md"


def _cases() -> list[Any]:
    """Return the rows; those after the first two of a kind are slow."""
    seen, cases = Counter[str](), list[Any]()
    for row in ROWS:
        slow = row.slow or seen[row.kind] >= 2
        seen[row.kind] += not row.slow
        cases.append(pytest.param(row, id=row.name, marks=[pytest.mark.slow] * slow))
    return cases


@pytest.mark.slow
@pytest.mark.parametrize("row", _cases())
def test_the_row_is_right_or_ends_in_its_named_error(row: Row) -> None:
    if row.ends_in is not None:
        with pytest.raises(row.ends_in):
            row.error()
    else:
        assert row.error() <= row.tolerance


# The table.


def _table() -> dict[str, str]:
    """Return the lines of the document: each up to what is seen, and that."""
    found: dict[str, str] = {}
    _, _, after = TABLE.read_text().partition("\n## Measured cases\n")
    for line in after.partition("\n## ")[0].splitlines():
        if match := re.fullmatch(r"(\| (?!Case ).* \|) (\S+) \|", line):
            assert match[1] not in found, line
            found[match[1]] = match[2]
    return found


def test_the_names_of_the_rows_differ() -> None:
    assert len({row.name for row in ROWS}) == len(ROWS)


def test_the_table_has_the_rows_that_are_run_and_no_others() -> None:
    assert list(_table()) == list(lines(ROWS))


def test_every_row_is_in_one_line() -> None:
    names = [row.name for alike in lines(ROWS).values() for row in alike]
    assert sorted(names) == sorted(row.name for row in ROWS)


@pytest.mark.parametrize("line", lines(ROWS))
def test_a_line_has_seen_no_more_than_it_promises(line: str) -> None:
    seen = _table()[line]
    for row in lines(ROWS)[line]:
        if row.ends_in is not None:
            assert seen == row.promise
        else:
            assert re.fullmatch(r"0|\d\.\de-\d\d", seen)
            assert float(seen) <= row.tolerance


# The truth itself.


@pytest.mark.slow
@pytest.mark.parametrize(("method", "relative"), fast(1, [(DOP853, 3e-14), (Radau, 1e-11)]))
def test_the_second_simulator_finds_the_reference_orbit(method: Method, relative: float) -> None:
    problem = load_problem("motor_pendulum")
    machine = load_reference(problem).pendulum(problem.values(parameters=CALIBRATED))
    follower = Follower(machine=machine, method=method, relative=relative)
    # From its Zeno point over the release to the next Zeno point, one period later.
    followed = follower.follow(ZENO_STATE, PERIOD + 1e-9)
    # The published digits.
    assert followed.release_times[0] == pytest.approx(PERIOD - ZENO_TIME, abs=1e-11)
    assert followed.impacts[0][1] == pytest.approx(FIRST_RATE, abs=1e-9)
    assert followed.zeno_times[0] == pytest.approx(PERIOD, abs=1e-11)


@pytest.mark.slow
def test_the_sequence_that_ends_at_the_release_parts_those_that_do_from_those_that_do_not() -> None:
    assert vanishing_sequence(-1e-9)[1] is not None
    assert vanishing_sequence(1e-9)[1] is None


def test_a_machine_that_differs_in_the_ninth_digit_is_told_apart() -> None:
    problem = load_problem("motor_pendulum")
    values = problem.values(parameters=CALIBRATED)
    other = problem.values(parameters={**CALIBRATED, "g": 9.81 * (1 + 1e-9)})
    execution = simulate(load_reference(problem).dynamics(values), FLYING, until=1.0)
    for numbers, told in ((values, False), (other, True)):
        machine = load_reference(problem).pendulum(numbers)
        truth = Follower(machine=machine).follow(FLYING, 1.0)
        assert (difference(execution, truth, 1.0) > 1e-11) == told
