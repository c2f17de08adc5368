"""Tables of machines hold the numbers that their headings promise, cell by cell."""

from __future__ import annotations

import math
import re
from types import SimpleNamespace
from typing import Any

import pytest

from zeno_orbits.experiment import ComparisonVerdict, FitParameter, FittedParameter, Metric
from zeno_orbits.report import terminal


def table_of(printed: str) -> list[list[str]]:
    """Return the cells of what is printed up to the first empty line, heading first."""
    lines = printed.split("\n\n")[0].splitlines()
    return [re.split(r"\s{2,}", line.strip()) for line in lines]


def recording(label: str = "recording, measured") -> Any:
    return SimpleNamespace(label=label, remarks=("one gap in time",))


def test_a_comparison_prints_each_number_in_its_column(capsys: pytest.CaptureFixture[str]) -> None:
    metrics = (
        Metric(name="period", unit="s", orbit=1.25, data=1.375, error=0.0625),
        Metric(name="restitution seen", unit="1", orbit=0.5, data=math.nan, error=math.nan),
        Metric(name="first impact time", unit="s", orbit=16e-6, data=16.0625e-6, error=3.9e-9),
    )
    found: Any = SimpleNamespace(
        metrics=metrics,
        recording=recording(),
        instruments={},
        remarks=("rough",),
        is_zeno=True,
        second_file=None,
        verdict=ComparisonVerdict.OTHER_VALUES,
        differences=metrics[:1],
    )
    terminal.print_comparison(found)
    printed = capsys.readouterr().out
    verdict, _, table = printed.partition("quantity")
    assert table_of("quantity" + table) == [
        ["quantity", "orbit", "recording, measured", "difference", "standard error", "unit"],
        ["period", "1.25", "1.375", "+0.125", "0.062", "s"],
        ["restitution seen", "0.5", "not resolved", "-", "-", "1"],
        ["first impact time", "16", "16.0625", "+0.0625", "0.0039", "us"],
    ]
    assert "Note: one gap in time." in printed
    assert "Note: rough." in printed
    assert "a Zeno orbit of this machine with other values:" in verdict
    assert "  period 1.375 s instead of 1.25 s" in verdict


def test_a_comparison_that_is_a_no_says_why(capsys: pytest.CaptureFixture[str]) -> None:
    found: Any = SimpleNamespace(
        metrics=(),
        recording=recording(),
        instruments={},
        remarks=(),
        is_zeno=True,
        second_file=None,
        verdict=ComparisonVerdict.NO_ORBIT,
        reasons=("no impact is seen",),
    )
    terminal.print_comparison(found)
    printed = capsys.readouterr().out
    assert "does not show a Zeno orbit of this machine:\n  no impact is seen." in printed


def test_fitted_numbers_stand_with_their_errors_and_intervals(
    capsys: pytest.CaptureFixture[str],
) -> None:
    seen = FittedParameter(
        unknown=FitParameter(names=("R",), lower=1.0, upper=9.0),
        start=3.0,
        value=3.25,
        error=0.125,
        low=2.75,
        high=3.75,
    )
    hidden = FittedParameter(
        unknown=FitParameter(names=("K", "k"), lower=0.0, upper=9.0),
        start=2.0,
        value=2.5,
        error=math.inf,
        low=-math.inf,
        high=math.inf,
    )
    found: Any = SimpleNamespace(
        fitted=(seen, hidden),
        before=0.02,
        after=0.004,
        closed_orbit=SimpleNamespace(period=1.8125),
        transient=None,
        remarks=(),
        edges=6,
        edge_misfit=1.25,
        unseen=(SimpleNamespace(text="`K+k` is not seen"),),
    )
    terminal.print_identification(found, recording().remarks)
    printed = capsys.readouterr().out
    assert table_of(printed) == [
        ["parameter", "start value", "fitted", "standard error", "95 % interval"],
        ["R", "3", "3.25", "0.12", "2.75 to 3.75"],
        ["K+k", "2", "2.5", "not determined", "-"],
    ]
    assert "0.02 before, 0.004 after the fit. Period 1.8125 s." in printed
    assert "Deviation of 6 edges of contacts: 1.2 errors." in printed
    assert "Warning: `K+k` is not seen." in printed


def test_cycles_of_a_machine_stand_beside_the_orbit(capsys: pytest.CaptureFixture[str]) -> None:
    def numbers(*five: float) -> SimpleNamespace:
        names = ("impact_time", "impact_rate", "lock_time", "lock_angle", "period")
        return SimpleNamespace(**dict(zip(names, five, strict=True)))

    found: Any = SimpleNamespace(
        cycles=4,
        orbit=numbers(1.0, -2e-6, 3.0, 4.0, 5.0),
        mean=numbers(1.5, -2.25e-6, 3.125, 4.0625, 5.5),
        spread=numbers(0.1, 0.2e-6, 0.3, 0.4, 0.5),
        units={
            **dict.fromkeys(("impact_time", "lock_time", "period"), "s"),
            "impact_rate": "m/s",
            "lock_angle": "rad",
        },
        drifting=("period",),
        portrait=0.25,
        portrait_at=0.5,
        warnings=("the stop gives way",),
        unlike=(),
    )
    terminal.print_rig(found, "theta2")
    printed = capsys.readouterr().out
    upper, lower, *rows = table_of(printed)
    assert upper == ["machine,", "standard"]
    assert lower == ["quantity", "unit", "orbit", "mean", "deviation", "difference"]
    assert rows == [
        ["first impact", "s", "1", "1.5", "0.1", "+0.5"],
        ["gap rate at the first impact", "um/s", "-2", "-2.25", "0.2", "-0.25"],
        ["Zeno point, or end of chatter", "s", "3", "3.125", "0.3", "+0.12"],
        ["theta2 at that time", "rad", "4", "4.0625", "0.4", "+0.062"],
        ["period", "s", "5", "5.5", "0.5", "+0.5"],
    ]
    words = " ".join(printed.split())
    assert "Warning: the stop gives way." in words
    assert "has not settled: period still changes in one direction" in words
    assert "at most 25 % of the orbit's size away from it, at 50 % of the cycle" in words
