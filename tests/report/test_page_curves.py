"""The data of a page's plots, from motions made by hand: every number is known beforehand."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.periods_by_hand import arc, impact, system, zeno
from zeno_orbits.report.page import plot_data
from zeno_orbits.report.page.plot_data import (
    _label,
    _machine,
    _paths,
    _points,
    _portraits,
    _series,
    _short,
    _zeno,
    curves_of,
)
from zeno_orbits.report.zeno_neighbourhood import close_up
from zeno_orbits.simulation import Ending, Execution, Mode, Release

E, PULL = 0.5, 8.0
TIME, LAST = 10.0, 0.03125
HITS = [
    impact(TIME - left, (0.0, -speed, 0.0), (0.0, E * speed, 0.0))
    for left, speed in ((0.5, 1.0), (0.25, 0.5), (0.125, 0.25), (0.03125, 0.0625))
]
"""Impacts that halve their speed."""
LIMIT = zeno(TIME, (0.0, 0.0, 1.0), tail=0.03125, last_speed=LAST)
FLIGHT = arc(Mode.FREE, [9.0, 9.5], [(0.0, 1.0, 0.0), (1.0 / 3.0, -1.0, 2.0)])
REST = arc(Mode.LOCKED, [TIME, 11.0], [(0.0, 0.0, 1.0), (0.0, 0.0, 0.0)])
RELEASES = [Release(time=9.0, state=np.array([0.0, 0.0, 7.0]))]


def _execution(*events: Any, arcs: Any = (FLIGHT, REST)) -> Execution:
    return Execution(state_names=("x", "dx", "i"), arcs=tuple(arcs), events=events)


def _problem(**parts: Any) -> Any:
    named = {
        "state_names": ("x", "dx", "i"),
        "state_units": ("m", "m/s", "A<b>"),
        "portraits": (("x", "dx"), ("i", "x")),
        "outputs": (),
        "drawing": None,
        "gap_unit": "m<b>",
        "symbols": dict[str, Any],
        "model": lambda _: SimpleNamespace(n_q=1),
    }
    return SimpleNamespace(**{**named, **parts})


def _subject(**parts: Any) -> Any:
    named = {
        "certificate": SimpleNamespace(multipliers=(0.5 - 0.25j, 0.125 + 0j)),
        "execution": _execution(*RELEASES, *HITS, LIMIT),
        "problem": _problem(),
        "dynamics": system(restitution=E, gap_acceleration=lambda _: -PULL),
        "orbit": SimpleNamespace(period=2.0, values=lambda _: "numbers"),
        "trade": None,
        "pushes": None,
    }
    return SimpleNamespace(**{**named, **parts})


def test_a_subject_has_the_curves_of_what_it_has() -> None:
    assert set(curves_of(_subject())) == {"stability", "portraits", "series", "zeno"}
    none = SimpleNamespace(multipliers=())
    assert curves_of(_subject(certificate=none, execution=None)) == {}
    assert set(curves_of(_subject(execution=_execution(*HITS)))) == {
        *("stability", "portraits", "series"),
    }
    assert curves_of(_subject(execution=None)) == {
        "stability": {"re": [0.5, 0.125], "im": [-0.25, 0.0]}
    }


def test_the_close_up_counts_its_times_from_the_zeno_point_and_has_the_unit_of_the_gap() -> None:
    data = curves_of(_subject())["zeno"]
    assert data["unit"] == "m&lt;b&gt;"
    assert [one["kind"] for one in data["arcs"]] == ["free", "locked"]
    flight, rest = data["arcs"]
    assert (flight["t"][0], flight["t"][-1]) == (-1.0, -0.5)
    assert (rest["t"][0], rest["t"][-1]) == (0.0, 1.0)
    # The flight is straight here; eight digits are shown.
    assert (flight["h"][0], flight["h"][-1]) == (0.0, 0.33333333)
    assert set(rest["h"]) == {0.0}
    assert (data["start"], data["end"]) == (-1.0, 1.0)
    assert data["length"] == 0.5
    assert data["speeds"] == {"x": [0.5, 0.25, 0.125, 0.03125], "y": [1.0, 0.5, 0.25, 0.0625]}


def test_the_close_up_ends_with_the_last_arc() -> None:
    hop = arc(Mode.FREE, [9.5, 9.75], [(0.0, 1.0, 0.0), (0.0, -1.0, 0.0)])
    more = _execution(*RELEASES, *HITS, LIMIT, arcs=[FLIGHT, hop, REST])
    assert curves_of(_subject(execution=more))["zeno"]["end"] == 1.0


def test_the_tail_is_continued_to_a_ten_thousandth_of_its_speed() -> None:
    data = curves_of(_subject())["zeno"]
    # Halves of the last speed: fourteen of them, as 2^13 is below 10^4 and 2^14 above.
    assert len(data["tail"]) == 14
    for k, flight in enumerate(data["tail"]):
        speed = LAST * E**k
        # It ends 2 w / (a (1 - e)) before the Zeno point, rises to w^2 / (2 a).
        assert flight["t"][0] == pytest.approx(-2 * speed / PULL / (1 - E))
        assert max(flight["h"]) == pytest.approx(speed**2 / (2 * PULL), rel=1e-3)
    # The law is drawn from the first impact to the last of these flights.
    first, last = data["law"]["x"]
    assert first == 0.5
    assert last == pytest.approx(-data["tail"][-1]["t"][0])
    assert data["law"]["y"][0] == pytest.approx(PULL * (1 - E) / (2 * E) * 0.5)
    # As many decades of zoom as lie between these two.
    assert data["decades"] == math.floor(math.log10(first / last)) == 5


def test_of_thousands_of_flights_near_e_of_one_sixty_are_drawn() -> None:
    near = system(restitution=0.99, gap_acceleration=lambda _: -PULL)
    data = curves_of(_subject(dynamics=near))["zeno"]
    assert len(data["tail"]) == 60


def test_a_plastic_stop_has_no_tail_and_one_hit_no_zoom() -> None:
    plastic = system(restitution=0.0, gap_acceleration=lambda _: -PULL)
    hit = impact(TIME, (0.0, -1.0, 0.0), (0.0, 0.0, 0.0))
    point = zeno(TIME, (0.0, 0.0, 1.0), tail=0.0, last_speed=0.0)
    fall = arc(Mode.FREE, [8.0, TIME], [(0.0, 1.0, 0.0), (0.0, -1.0, 0.0)])
    zoom = close_up(_execution(hit, point, arcs=[fall, REST]), plastic)
    data = _zeno(zoom, "rad")
    assert data["tail"] == []
    assert data["speeds"] == {"x": [], "y": []}
    assert data["law"] == {"x": [], "y": []}
    assert data["decades"] == 0
    # A part of the time since the release, which is two seconds here.
    assert data["length"] == pytest.approx(0.6)


def test_portraits_show_the_states_that_their_problem_names() -> None:
    execution = _execution(*RELEASES, *HITS[:2], LIMIT)
    first, second = _portraits(_problem(), execution)
    assert (first["x"], first["y"]) == ("<i>x</i> [m]", "d<i>x</i>/d<i>t</i> [m/s]")
    assert second["x"].endswith("[A&lt;b&gt;]")
    assert first["before"] == {"x": [0.0, 0.0], "y": [-1.0, -0.5]}
    assert first["after"] == {"x": [0.0, 0.0], "y": [0.5, 0.25]}
    assert first["zeno"] == {"x": [0.0], "y": [0.0]}
    assert first["release"] == {"x": [0.0], "y": [0.0]}
    assert second["zeno"] == {"x": [1.0], "y": [0.0]}
    assert second["release"] == {"x": [7.0], "y": [0.0]}
    flight, rest = first["arcs"]
    assert (flight["kind"], rest["kind"]) == ("free", "locked")
    assert (flight["x"][0], flight["x"][-1]) == (0.0, 0.33333333)
    assert (flight["y"][0], flight["y"][-1]) == (1.0, -1.0)
    assert (second["arcs"][0]["x"][-1], second["arcs"][1]["x"][0]) == (2.0, 1.0)


def test_states_over_time_have_fourteen_digits_of_time_and_ten_of_themselves() -> None:
    late = arc(Mode.FREE, [9.0, 9.0 + 1.0 / 3.0], [(0.0, 1.0, 0.0), (1.0 / 3.0, -1.0, 2.0)])
    rest = arc(Mode.LOCKED, [9.0 + 1.0 / 3.0, 11.0], [(0.0, 0.0, 1.0), (0.0, 0.0, 0.0)])
    data = _series(_subject(), _execution(*HITS, LIMIT, LIMIT, arcs=[late, rest]))
    assert data["arcs"][0]["t"][-1] == 9.3333333333333
    assert [one["kind"] for one in data["arcs"]] == ["free", "locked"]
    x, dx, i = data["rows"]
    assert x["label"] == "<i>x</i> [m]"
    assert i["label"].endswith("[A&lt;b&gt;]")
    assert x["values"][0][-1] == 0.3333333333
    assert (dx["values"][0][0], dx["values"][0][-1], i["values"][1][0]) == (1.0, -1.0, 1.0)
    assert data["locked"] == [[9.0 + 1.0 / 3.0, 11.0]]
    assert data["impacts"] == [hit.time for hit in HITS]
    assert (data["zeno"], data["end"]) == (TIME, 11.0)
    # Fourteen digits of a time of ten seconds, and a tenth of a thousand points in what is shown:
    # more decades than that are dots.
    assert 3 <= data["decades"] <= 9
    assert _series(_subject(), _execution(*HITS))["zeno"] is None
    early = zeno(9.75, (0.0, 0.0, 1.0))
    assert _series(_subject(), _execution(early, LIMIT))["zeno"] == TIME


def test_outputs_follow_the_states_with_their_units() -> None:
    outputs = [SimpleNamespace(name="reach", unit="m<b>"), SimpleNamespace(name="u", unit="V")]
    asked: list[Any] = []

    def values(numbers: Any, states: Any) -> Any:
        asked.append(states.shape[1])
        assert numbers == "numbers"
        return np.stack([10.0 * states[:, 1], 100.0 * states[:, 2]], axis=1)

    # A flow may carry more than the states.
    wide = arc(Mode.FREE, [0.0, 1.0], [(0.0, 1.0, 0.0, 9.0), (0.5, -1.0, 2.0, 9.0)])
    subject = _subject(problem=_problem(outputs=outputs, output_values=values))
    data = _series(subject, _execution(arcs=[wide, wide]))
    assert asked == [3, 3]
    labels = [row["label"] for row in data["rows"][3:]]
    assert labels[0] == "reach [m&lt;b&gt;]"
    assert labels[1].endswith("[V]")
    reach, u = (row["values"] for row in data["rows"][3:])
    assert [(one[0], one[-1]) for one in reach] == [(10.0, -10.0)] * 2
    assert [(one[0], one[-1]) for one in u] == [(0.0, 200.0)] * 2


def test_a_machine_has_its_stop_first_its_points_last_and_up_upwards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    third = 1.0 / 3.0
    lines = {
        "point": np.array([[[9.0, 9.0]], [[8.0, 8.0]]]),
        "link": np.array([[[0.0, 0.0], [third, 1.0]], [[0.0, 0.0], [1.0, 2.0]]]),
        "stop": np.array([[[5.0, 5.0], [6.0, 6.0]]] * 2),
        "rope": np.array([[[1.0, 1.0], [2.0, 2.0]]] * 2),
    }
    motion = SimpleNamespace(lines=lines, modes=(Mode.FREE, Mode.LOCKED))
    asked: list[Any] = []

    def moved(*given: Any, n: int) -> Any:
        asked.append((*given[1:], n))
        return motion

    monkeypatch.setattr(plot_data, "machine_motion", moved)
    monkeypatch.setattr(plot_data, "frame_of", lambda _: ((-1.0, 3.0), (2.0, 7.0)))
    subject = _subject(problem=_problem(drawing="a drawing"))
    data = _machine(subject, subject.execution)
    [(values, execution, period, n)] = asked
    assert (values, execution, period) == ("numbers", subject.execution, 2.0)
    # Between two pictures corners move straight: a hundredth of a period is not seen.
    assert n >= 100
    assert [line["stop"] for line in data["lines"]] == [True, False, False, False]
    assert data["lines"][0]["corners"][0] == [5.0, 5.0, 6.0, 6.0]
    assert data["lines"][1]["corners"][0] == [0.0, 0.0, 0.33333, 1.0]
    assert data["lines"][2]["corners"][1] == [1.0, 1.0, 2.0, 2.0]
    assert data["lines"][3]["corners"] == [[9.0, 9.0], [8.0, 8.0]]
    # Left, top, width and height, with the top as a screen counts.
    assert data["box"] == [-1.0, -7.0, 4.0, 5.0]
    assert data["modes"] == ["free", "locked"]
    assert data["period"] == 2.0
    assert curves_of(subject)["machine"] == data
    point = SimpleNamespace(lines={"stop": lines["point"], "link": lines["link"]}, modes=())
    motion = point
    assert [line["stop"] for line in _machine(subject, subject.execution)["lines"]] == [False, True]


@pytest.mark.parametrize(("n", "least"), [(1, 150), (26, 150), (40, 100), (333, 12), (1000, 12)])
def test_the_points_of_a_curve_are_shared_out_among_its_arcs(
    monkeypatch: pytest.MonkeyPatch, n: int, least: int
) -> None:
    asked: list[int] = []
    monkeypatch.setattr(plot_data, "paths_of", lambda _, *, least: asked.append(least))
    some: Any = SimpleNamespace(arcs=[FLIGHT] * n)
    _paths(some)
    assert asked == [least]


def test_a_trade_has_its_front_last_and_its_names_as_text(monkeypatch: pytest.MonkeyPatch) -> None:
    def line(label: str, *, engine: bool) -> Any:
        return SimpleNamespace(label=label, is_engine=engine, errors=(1e-3,), milliseconds=(2.0,))

    monkeypatch.setattr(
        plot_data, "trade_lines", lambda _: [line("a<b>", engine=True), line("c", engine=False)]
    )
    monkeypatch.setattr(plot_data, "front_line", lambda _: line("front", engine=False))
    found = curves_of(_subject(trade="a trade", execution=None))["trade"]
    shown = {"x": (1e-3,), "y": (2.0,)}
    assert found == {
        "lines": [
            {"name": "a&lt;b&gt;", "engine": True, **shown},
            {"name": "c", "engine": False, **shown},
        ],
        "front": {"name": "front", "engine": False, **shown},
    }


def test_numbers_are_short_and_labels_have_their_units() -> None:
    assert _short([1.0 / 3.0, 2e9 / 3.0]) == [0.33333333, 666666670.0]
    assert _short([1.0 / 3.0], 3) == [0.333]
    assert _points([np.array([1.0, 2.0]), np.array([3.0, 1.0 / 3.0])]) == {
        "x": [1.0, 3.0],
        "y": [2.0, 0.33333333],
    }
    assert _label(_problem(), 1) == "d<i>x</i>/d<i>t</i> [m/s]"


def test_a_tail_too_short_to_see_is_no_curve() -> None:
    tail = arc(Mode.FREE, [9.5, 9.5001], [(0.0, 0.0, 2.0), (0.0, 0.0, 2.0)])
    tail.ending = Ending.ZENO
    data = _series(_subject(), _execution(*HITS, LIMIT, arcs=[FLIGHT, tail, REST]))
    assert len(data["arcs"]) == len(data["rows"][0]["values"]) == 2
