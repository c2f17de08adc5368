"""Results as tables: of pandas, and in a notebook."""

from __future__ import annotations

import sys
from collections.abc import Callable
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.report.test_figure_of import family
from tests.report.test_plots import EVERY_FATE, TRADE, small_map
from zeno_orbits.continuation import Continuation
from zeno_orbits.errors import InputError
from zeno_orbits.search import SearchResult
from zeno_orbits.work import Columns, TableRepr, by_name


class Numbered(TableRepr):
    """A result of some rows whose texts are HTML."""

    def __init__(self, rows: int) -> None:
        self._rows = rows

    def __repr__(self) -> str:
        return "<b>"

    def _columns(self) -> Columns:
        return {"<i>": ["<u>&"] * self._rows, "n": [k / 3 for k in range(self._rows)]}


class _Cells(HTMLParser):
    """The texts of a piece of HTML, and its elements."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.texts: list[str] = []
        self.tags: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: object) -> None:  # noqa: ARG002
        self.tags.append(tag)

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def shown(result: Any) -> _Cells:
    """Return what a notebook shows of a result."""
    return _Cells(result._repr_html_())


def test_a_notebook_shows_the_printed_form_and_a_table_as_text() -> None:
    found = shown(Numbered(2))
    assert set(found.tags) == {"pre", "table", "tr", "th", "td"}
    assert found.texts == ["<b>", "<i>", "n", "<u>&", "0", "<u>&", "0.3333333"]


def test_a_long_table_is_cut_and_says_so() -> None:
    found = shown(Numbered(100))
    assert found.tags.count("tr") == 13
    assert found.texts[-1] == "and 88 more rows"


def test_a_result_without_rows_has_no_table() -> None:
    assert shown(Numbered(0)).tags == ["pre"]


def test_entries_without_a_name_have_no_number_there() -> None:
    found = by_name([{"a": 1.0}, {"b": 2.0}])
    assert np.array_equal(found["a"], [1.0, np.nan], equal_nan=True)
    assert np.array_equal(found["b"], [np.nan, 2.0], equal_nan=True)


def test_without_pandas_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"pip install 'zeno_orbits\[tables\]'"):
        Numbered(1).to_pandas()


pandas = pytest.importorskip("pandas", reason="the extra `tables` is not installed")


def test_an_execution_is_a_table_of_its_states() -> None:
    ball = zo.simulate("bouncing_ball", until=1.0)
    table = ball.to_pandas()
    assert isinstance(table, pandas.DataFrame)
    assert list(table.columns) == ["time", "arc", "mode", "height", "speed"]
    assert table.arc.max() == len(ball.arcs) - 1
    first = table[table.arc == 0]
    # The first arc falls freely from one metre.
    assert np.allclose(first.height, 1.0 - 9.81 * first.time**2 / 2, atol=1e-9)
    assert np.allclose(first.speed, -9.81 * first.time, atol=1e-9)
    assert set(table["mode"]) == {"free"}
    assert shown(ball).texts[1:5] == ["time", "event", "height", "speed"]


def test_a_family_is_a_table_of_its_orbits_with_the_names_of_special_ones() -> None:
    one = family()
    for result in (one, Continuation(families=(one, one))):
        table = result.to_pandas()
        alike = table[table.family == 0]
        assert np.allclose(alike.restitution, [0.1, 0.2, 0.3, 0.4])
        assert np.allclose(alike.period, [1.81, 1.82, 1.83, 1.84])
        assert list(alike.stable) == [True, True, False, False]
        assert np.allclose(alike.spectral_radius, [0.4, 0.8, 1.2, 1.6])
        assert list(alike.name) == ["start", "", "", "fold"]
        assert len(table) == 4 * (1 if result is one else 2)
        assert "fold" in shown(result).texts


def test_an_end_that_is_no_orbit_of_a_family_has_a_row_of_its_own() -> None:
    from dataclasses import replace

    one = family()
    last = replace(one.last, at=replace(one.last.at, value=0.45), index=3)
    middle = replace(one.last, at=replace(one.last.at, value=0.25), index=1)
    table = replace(one, last=last, special=(middle,)).to_pandas()
    assert list(table.restitution) == pytest.approx([0.1, 0.2, 0.25, 0.3, 0.4, 0.45])


def test_a_map_is_a_table_of_its_points() -> None:
    found = small_map(*EVERY_FATE)
    table = found.to_pandas()
    assert list(table.Kp[:4]) == [1.0, 2.0, 3.0, 1.0]
    assert list(table.Kd[:4]) == [-2.0, -2.0, -2.0, -1.8]
    assert list(table.settles_to) == [one.phrase for one in EVERY_FATE]
    assert np.array_equal(table.period, [one.period for one in EVERY_FATE], equal_nan=True)
    assert "Zeno periodic orbit, period 1" in shown(found).texts


def test_orbit_certificate_search_and_trade_are_tables(
    orbit: zo.Orbit, certificate: zo.OrbitCertificate, found: SearchResult
) -> None:
    events = orbit.to_pandas()
    assert list(events.event) == [event.name for event in orbit.events]
    assert list(events.time) == [event.time for event in orbit.events]
    assert list(events.dtheta2) == [event.state["dtheta2"] for event in orbit.events]
    checks = certificate.to_pandas().set_index("name")
    assert {name: checks.residual[name] for name in checks.index} == dict(certificate.residuals)
    assert checks.passed.all()
    assert list(found.to_pandas().period) == [one.orbit.period for one in found.candidates]
    assert list(TRADE.to_pandas().seconds) == [trial.seconds for trial in TRADE.trials]
    for result in (orbit, certificate, found, TRADE):
        assert shown(result).texts[0] == repr(result)


RESULTS: dict[str, Callable[[], Any]] = {
    "execution": lambda: zo.simulate("bouncing_ball", until=4.0),
    "family": family,
    "map": lambda: small_map(*EVERY_FATE),
    "trade": lambda: TRADE,
}


@pytest.mark.parametrize("name", RESULTS)
def test_a_printed_result_fits_a_screen(name: str) -> None:
    result = RESULTS[name]()
    assert len(repr(result)) < 1000
    assert len(result._repr_html_()) < 6000
