"""Every curve and every cell of the report, held against what was computed, not by its label."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.browser import Browser
from tests.support.cases import fast
from tests.support.report_pages import plotted, tables_in, tiles_in
from zeno_orbits.model import HybridDynamics, Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.precision import TimedSetting, WorkPrecision
from zeno_orbits.report.page import Subject, load_bundle, page_of
from zeno_orbits.simulation import Ending, Execution, Mode
from zeno_orbits.verification import OrbitCertificate

LABELS = {
    "<i>θ</i><sub>1</sub> [rad]": 0,
    "d<i>θ</i><sub>1</sub>/d<i>t</i> [rad/s]": 2,
    "<i>θ</i><sub>2</sub> [rad]": 1,
    "d<i>θ</i><sub>2</sub>/d<i>t</i> [rad/s]": 3,
    "<i>i</i> [A]": 4,
}
"""Label of a state of the pendulum to its place, in the order of the panels over time."""
PORTRAITS = (("theta1", 0, 2), ("theta2", 1, 3))
"""Coordinate of each portrait, and the places of what is across and upwards."""
MULTIPLIERS = (0.25 - 0.5j, 0.125 + 0.0625j)
TRIALS = (
    TimedSetting(sweep="engine", name="fast", value=1e-6, seconds=1e-3, error=1e-7, n_impacts=9),
    TimedSetting(sweep="engine", name="fast", value=1e-9, seconds=4e-3, error=1e-11, n_impacts=9),
    TimedSetting(sweep="cut", name="cut", value=1e-2, seconds=3e-3, error=1e-2),
    TimedSetting(
        sweep="cut", name="cut", value=1e-3, seconds=math.inf, error=math.inf, trouble="no"
    ),
)


@pytest.fixture(scope="module")
def subject(
    orbit: Orbit, problem: Problem, machine: HybridDynamics, certificate: OrbitCertificate
) -> Subject:
    """The pendulum with complex multipliers and numbers that no two cells share."""
    told = replace(
        certificate,
        multipliers=MULTIPLIERS,
        multiplier_error=1e-10,
        residuals={**certificate.residuals, "drift": math.inf, "escape": 0.0},
        energies={**certificate.energies, "energy_gain": 1e-17},
    )
    trade = WorkPrecision(
        problem=orbit.problem, work="3 s", truth="exact", truth_error=1e-20, trials=TRIALS
    )
    asked = {"quantity": "peak", "lower": None, "upper": 2.0, "lowest": 0.5, "highest": 1.5}
    listed = replace(orbit, certificate={"asked": [asked]}, versions={"numpy": "1.2"})
    subject = Subject(
        orbit=listed, problem=problem, dynamics=machine, certificate=told, trade=trade
    )
    return subject.followed()


@pytest.fixture(scope="module")
def execution(subject: Subject) -> Execution:
    assert subject.execution is not None
    return subject.execution


@pytest.fixture(scope="module")
def page(subject: Subject) -> str:
    return page_of(subject, load_bundle())


@pytest.fixture(scope="module")
def curves(page: str) -> dict[str, Any]:
    return plotted(page)


def drawn_arcs(execution: Execution) -> list[Any]:
    return [arc for arc in execution.arcs if arc.ending is not Ending.ZENO]


# ---------------------------------------------------------------------------- curves


@pytest.mark.slow
def test_each_panel_over_time_shows_its_state_in_seconds(
    curves: dict[str, Any], execution: Execution
) -> None:
    series = curves["series"]
    rows = {row["label"]: row["values"] for row in series["rows"]}
    assert list(rows)[:5] == list(LABELS)
    for k, arc in enumerate(drawn_arcs(execution)):
        times = series["arcs"][k]["t"]
        assert series["arcs"][k]["kind"] == arc.mode.value
        assert times[0] == pytest.approx(arc.start_time, abs=1e-12)
        assert times[-1] == pytest.approx(arc.end_time, rel=1e-12)
        true = np.array([arc.state_at(t) for t in times])
        for label, column in LABELS.items():
            # Ten digits of numbers below 20.
            assert rows[label][k] == pytest.approx(true[:, column], abs=1e-8), label
    ends = [point.time for point in execution.zeno_points]
    starts_again = [release.time for release in execution.releases]
    assert series["locked"] == [list(pair) for pair in zip(ends, starts_again, strict=True)]
    assert series["impacts"] == [impact.time for impact in execution.impacts]
    assert series["end"] == execution.end_time


def test_an_output_is_drawn_as_its_own_formula_has_it(
    curves: dict[str, Any], subject: Subject
) -> None:
    row = curves["series"]["rows"][5]
    assert row["label"] == "tip height [m]"
    angles = [curves["series"]["rows"][k]["values"] for k in (0, 2)]
    first, second = (subject.orbit.parameters[name] for name in ("L1", "L2"))
    for k, values in enumerate(row["values"]):
        theta1, theta2 = (np.array(angle[k]) for angle in angles)
        height = -first * np.cos(theta1) - second * np.cos(theta1 + theta2)
        assert values == pytest.approx(height, abs=1e-8)


@pytest.mark.parametrize("k", [0, 1])
def test_each_portrait_shows_what_its_axes_say(
    curves: dict[str, Any], execution: Execution, k: int
) -> None:
    _, across, up = PORTRAITS[k]
    drawn, labels = curves["portraits"][k], {place: label for label, place in LABELS.items()}
    assert (drawn["x"], drawn["y"]) == (labels[across], labels[up])
    events = {
        "before": [impact.state_minus for impact in execution.impacts],
        "after": [impact.state_plus for impact in execution.impacts],
        "zeno": [point.state for point in execution.zeno_points],
        "release": [release.state for release in execution.releases],
    }
    for name, states in events.items():
        # Eight digits of numbers below 20.
        assert drawn[name]["x"] == pytest.approx([x[across] for x in states], abs=1e-6), name
        assert drawn[name]["y"] == pytest.approx([x[up] for x in states], abs=1e-6), name
    for one, arc, times in zip(
        drawn["arcs"], drawn_arcs(execution), curves["series"]["arcs"], strict=True
    ):
        true = np.array([arc.state_at(t) for t in times["t"]])
        assert one["kind"] == arc.mode.value
        assert one["x"] == pytest.approx(true[:, across], abs=1e-6)
        assert one["y"] == pytest.approx(true[:, up], abs=1e-6)


def test_the_closeup_shows_gap_and_speed_of_the_impacts(
    curves: dict[str, Any], execution: Execution
) -> None:
    (zeno,) = curves["zeno"]
    (point,) = execution.zeno_points
    # The gap of the pendulum is theta2.
    for one, arc in zip(zeno["arcs"], drawn_arcs(execution), strict=True):
        times = np.array(one["t"]) + point.time
        true = [max(arc.state_at(t)[1], 0.0) for t in times]
        # Eight digits of times of a second, at 17 rad/s.
        assert one["h"] == pytest.approx(true, abs=2e-7)
    left = [point.time - impact.time for impact in execution.impacts]
    assert zeno["speeds"]["x"] == left
    speeds = [-impact.state_minus[3] for impact in execution.impacts]
    assert zeno["speeds"]["y"] == pytest.approx(speeds, rel=1e-6)
    # The law is the limit of the impacts: the last ones lie on it.
    ratio = zeno["law"]["y"][0] / zeno["law"]["x"][0]
    assert speeds[-1] / left[-1] == pytest.approx(ratio, rel=1e-4)
    assert (zeno["start"], zeno["end"]) == pytest.approx(
        (-point.time, execution.end_time - point.time)
    )


def test_multipliers_stand_where_they_are_in_the_plane(curves: dict[str, Any]) -> None:
    assert curves["stability"] == {
        "re": [value.real for value in MULTIPLIERS],
        "im": [value.imag for value in MULTIPLIERS],
    }


def test_a_trade_is_drawn_as_error_and_milliseconds(curves: dict[str, Any]) -> None:
    fast, cut = curves["trade"]["lines"]
    assert (fast["name"], fast["engine"], cut["engine"]) == ("fast", True, False)
    assert list(zip(fast["x"], fast["y"], strict=True)) == [(1e-11, 4.0), (1e-7, 1.0)]
    assert list(zip(cut["x"], cut["y"], strict=True)) == [(1e-2, 3.0)]
    front = curves["trade"]["front"]
    assert list(zip(front["x"], front["y"], strict=True)) == [(1e-7, 1.0), (1e-11, 4.0)]


def test_the_machine_stands_as_its_angles_say(
    curves: dict[str, Any], subject: Subject, execution: Execution
) -> None:
    machine = curves["machine"]
    first, second = (subject.orbit.parameters[name] for name in ("L1", "L2"))
    n = len(machine["modes"])
    assert machine["lines"][0]["stop"]
    assert [line["stop"] for line in machine["lines"][1:]] == [False] * (len(machine["lines"]) - 1)
    (locked,) = curves["series"]["locked"]
    for k in range(0, n, 7):
        time = k * subject.orbit.period / n
        theta1, theta2 = execution.state_at(time)[:2]
        knee = np.array([first * math.sin(theta1), -first * math.cos(theta1)])
        hand = theta1 + theta2
        tip = knee + second * np.array([math.sin(hand), -math.cos(hand)])
        shown = [line["corners"][k] for line in machine["lines"]]
        # Five digits of half a metre.
        assert any(c == pytest.approx([0.0, 0.0, *knee], abs=1e-5) for c in shown if len(c) == 4)
        assert any(c == pytest.approx([*knee, *tip], abs=1e-5) for c in shown if len(c) == 4)
        assert (machine["modes"][k] == Mode.LOCKED.value) == (locked[0] <= time < locked[1])


# ---------------------------------------------------------------------------- cells


def near(texts: list[str], values: Any, digits: int) -> bool:
    """Return True if each text is its number to some digits, and zero is 0."""
    return all(
        float(text) == float(f"{value:.{digits}g}") and (value != 0.0 or text == "0")
        for text, value in zip(texts, values, strict=True)
    )


@pytest.mark.parametrize("kind", ["gains", "parameters"])
def test_every_cell_of_the_numbers_of_an_orbit(page: str, subject: Subject, kind: str) -> None:
    section = {"gains": "asked", "parameters": "parameters"}[kind]
    known, found = getattr(subject.orbit, kind), tables_in(page, section)[0]
    quantities = getattr(subject.problem, kind)
    assert list(found) == ["name", "value", "unit", "meaning"]
    assert found["name"] == [one.name for one in quantities]
    assert near(found["value"], [known[one.name] for one in quantities], 12)
    assert found["unit"] == [one.unit for one in quantities]
    assert found["meaning"] == [one.meaning for one in quantities]


def test_every_cell_of_the_multipliers(page: str) -> None:
    assert tables_in(page, "stability")[0] == {
        "number": ["1", "2"],
        "real part [1]": ["0.25", "0.125"],
        "imaginary part [1]": ["-0.5", "0.0625"],
        "modulus [1]": ["0.55901699", "0.13975425"],
    }


@pytest.mark.slow
def test_what_is_below_the_error_of_a_multiplier_is_shown_as_zero(subject: Subject) -> None:
    certificate = replace(subject.certificate, multipliers=(-0.5 + 0j, complex(1e-17, -1e-18)))
    found = tables_in(
        page_of(replace(subject, certificate=certificate), load_bundle()), "stability"
    )[0]
    assert found["real part [1]"] == ["-0.5", "0"]
    assert found["imaginary part [1]"] == ["0", "0"]
    assert found["modulus [1]"] == ["0.5", "0 (below rounding)"]


def test_every_cell_of_the_residuals(page: str, subject: Subject) -> None:
    found, sizes = tables_in(page, "checks")[0], subject.certificate.residuals
    names = [text.partition(":")[0] for text in found["for the expert"]]
    assert sorted(names) == sorted(sizes)
    for name, passed, shown in zip(names, found["passed"], found["residual [1]"], strict=True):
        assert (passed == "✓ yes") == (sizes[name] <= 1e-9)
        if name in {"drift", "escape"}:
            assert shown == ("never reached" if name == "drift" else "0")
        else:
            assert float(shown) == pytest.approx(sizes[name], rel=0.05)


def test_every_cell_of_margins_and_energies(page: str, subject: Subject) -> None:
    found, parts = tables_in(page, "margins")
    margins = subject.certificate.margins
    units = {
        "gap_acceleration": "rad/s^2",
        "first_impact_speed": "rad/s",
        "release_transversality": "N m/s",
        "locked_time": "s",
        "later_impact_speed": "1",
        "events_apart": "s",
    }
    assert dict(zip(found["name"], found["unit"], strict=True)) == units
    assert near(found["value"], [margins[name] for name in found["name"]], 6)
    energies = subject.certificate.energies
    # What is rounding beside the largest, as what is left over is, is zero.
    least = 1e-13 * max(energies.values())
    shown = [value if abs(value) > least else 0.0 for value in energies.values()]
    assert near(parts["energy [J]"], shown, 6)
    assert (parts["part"][-1], parts["energy [J]"][-1]) == ("left over after the period", "0")


@pytest.mark.parametrize(("unit", "force"), fast(1, [("m", "N"), ("rad", "N m"), ("1", "J")]))
def test_the_force_on_a_stop_has_the_unit_of_its_gap(
    subject: Subject, unit: str, force: str
) -> None:
    units = (*(unit,) * 2, *subject.problem.state_units[2:])
    problem = replace(subject.problem, state_units=units, outputs=())
    found = tables_in(page_of(replace(subject, problem=problem), load_bundle()), "margins")[0]
    shown = dict(zip(found["name"], found["unit"], strict=True))
    assert shown["release_transversality"] == f"{force}/s"


def test_every_cell_of_the_events(page: str, execution: Execution) -> None:
    times, words, speeds = tables_in(page, "motion")[0].values()
    assert near(times, [event.time for event in execution.events], 12)
    hits = [k for k, word in enumerate(words) if word == "impact"]
    rates = [-impact.state_minus[3] for impact in execution.impacts]
    assert [float(speeds[k]) for k in hits] == pytest.approx(rates, rel=1e-5)
    assert [speeds[k] for k in range(len(words)) if k not in hits] == [""] * 2
    assert words[len(hits)].startswith("Zeno point")
    assert words[-1] == "release"


def rows_in(page: str, section: str) -> list[tuple[str, ...]]:
    """Return the rows of the last table of a section."""
    return list(zip(*tables_in(page, section)[-1].values(), strict=True))


def test_every_cell_of_bounds_trade_and_versions(page: str) -> None:
    assert rows_in(page, "asked") == [("peak", "-", "2", "0.5", "1.5")]
    trade = rows_in(page, "trade")
    assert trade[0] == ("1e-02", "fast, 1e-06", "1.00", "1.0e-07")
    assert trade[3] == ("1e-08", "fast, 1e-09", "4.00", "1.0e-11")
    assert trade[5] == ("1e-12", "none", "", "")
    versions = {row[0]: row[1:] for row in rows_in(page, "reproduce")}
    assert versions["numpy"] == ("1.2", np.__version__)
    assert versions["plotly"] == ("-", load_bundle().version)


def test_every_tile(page: str, subject: Subject, execution: Execution) -> None:
    (point,), (release,) = execution.zeno_points, execution.releases
    found = {name: (float(number), unit) for name, (number, unit) in tiles_in(page).items()}
    assert found == {
        "period": (pytest.approx(subject.orbit.period, rel=1e-9), "s"),
        "first impact after": (pytest.approx(execution.impacts[0].time, rel=1e-8), "s"),
        "Zeno point after": (pytest.approx(point.time, rel=1e-9), "s"),
        "rests on the stop for": (pytest.approx(release.time - point.time, rel=1e-5), "s"),
        "a small disturbance changes by the factor": (0.559, "per period"),
    }


# ---------------------------------------------------------------------------- in a browser


@pytest.fixture(scope="module")
def opened(page: str, browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Browser:
    path: Path = tmp_path_factory.mktemp("data") / "report.html"
    path.write_text(page, encoding="utf-8")
    browser.emulate(1100)
    browser.open(path)
    return browser


def traces(opened: Browser, plot: str) -> list[tuple[str, list[Any], list[Any]]]:
    """Return name, x and y of each curve of a plot, as the browser draws it."""
    script = (
        "return document.getElementById(arguments[0]).data.map("
        "(one) => [one.name || '', Array.from(one.x), Array.from(one.y)])"
    )
    return [tuple(one) for one in opened.run(script, f"plot-{plot}")]


@pytest.mark.parametrize("k", [0, 1])
def test_the_browser_draws_the_portraits_of_the_data(
    opened: Browser, curves: dict[str, Any], k: int
) -> None:
    data, found = curves["portraits"][k], traces(opened, f"portrait-{k}")
    words = {"free": "off the stop", "locked": "on the stop"}
    for arc, trace in zip(data["arcs"], found, strict=False):
        assert trace == (words[arc["kind"]], arc["x"], arc["y"])
    named = {name: (x, y) for name, x, y in found[len(data["arcs"]) + 1 :]}
    assert named == {
        "before an impact": (data["before"]["x"], data["before"]["y"]),
        "after an impact": (data["after"]["x"], data["after"]["y"]),
        "release": (data["release"]["x"], data["release"]["y"]),
        "Zeno point": (data["zeno"]["x"], data["zeno"]["y"]),
    }


def test_the_browser_draws_every_panel_over_time(opened: Browser, curves: dict[str, Any]) -> None:
    series, found = curves["series"], traces(opened, "series")
    arcs = series["arcs"]
    titles = opened.run(
        "const layout = document.getElementById('plot-series').layout;"
        "return arguments[0].map((k) => layout['yaxis' + (k ? k + 1 : '')].title.text)",
        list(range(len(series["rows"]))),
    )
    assert titles == [row["label"] for row in series["rows"]]
    for k, row in enumerate(series["rows"]):
        for j, values in enumerate(row["values"]):
            assert found[k * len(arcs) + j][1:] == (arcs[j]["t"], values)


def test_the_browser_draws_closeup_multipliers_and_trade(
    opened: Browser, curves: dict[str, Any]
) -> None:
    ((_, re, im),) = traces(opened, "stability")
    assert list(map(complex, re, im)) == list(MULTIPLIERS)
    (zeno,), shown = curves["zeno"], traces(opened, "zeno-0")
    for one, trace in zip([*zeno["arcs"], *zeno["tail"]], shown, strict=False):
        assert trace[1:] == (one["t"], one["h"])
    law, hits = traces(opened, "speeds-0")
    assert law[1:] == (zeno["law"]["x"], zeno["law"]["y"])
    assert hits[1:] == (zeno["speeds"]["x"], zeno["speeds"]["y"])
    front, *lines = traces(opened, "trade")
    data = curves["trade"]
    assert front[1:] == (list(data["front"]["x"]), list(data["front"]["y"]))
    for line, trace in zip(data["lines"], lines, strict=True):
        assert trace == (line["name"], list(line["x"]), list(line["y"]))


def test_the_gaps_on_logarithmic_axes_are_those_of_the_closeup(
    opened: Browser, curves: dict[str, Any]
) -> None:
    (zeno,) = curves["zeno"]
    flights = [one for one in zeno["arcs"] if one["kind"] == "free" and one["t"][0] < 0.0]
    flights += zeno["tail"]
    for one, (_, x, y) in zip(flights, traces(opened, "gaps-0"), strict=True):
        peak = int(np.argmax(one["h"]))
        assert max(y) == one["h"][peak]
        assert x[int(np.argmax(y))] == -one["t"][peak]


def test_the_machine_moves_when_it_is_played_and_follows_the_slider(
    opened: Browser, curves: dict[str, Any]
) -> None:
    slide = (
        "const slider = document.getElementById('at'); slider.value = arguments[0];"
        "slider.dispatchEvent(new Event('input'));"
        "return [...document.querySelectorAll('#machine polyline')].map((one) =>"
        " [one.getAttribute('points'), one.getAttribute('class')])"
    )
    machine = curves["machine"]
    n = len(machine["modes"])
    for k in (0, n // 3, n - 5):
        shown = opened.run(slide, k / n)
        lines = [line for line in machine["lines"] if len(line["corners"][k]) > 2]
        for (points, kind), line in zip(shown, lines, strict=True):
            corners = np.array([pair.split(",") for pair in points.split()], dtype=float)
            # The screen counts downwards.
            drawn = (corners * [1.0, -1.0]).ravel()
            assert drawn == pytest.approx(line["corners"][k], abs=1e-9)
            assert kind == ("stop" if line["stop"] else machine["modes"][k])
    assert "on the stop" in opened.run("return document.getElementById('shown').textContent")
    before = opened.run("return document.getElementById('at').value")
    opened.run("document.getElementById('play').click()")
    opened.driver.set_script_timeout(10)
    moved = opened.driver.execute_async_script(
        "const done = arguments[0];"
        "setTimeout(() => { document.getElementById('play').click();"
        " done(document.getElementById('at').value); }, 400)"
    )
    assert moved != before
    assert opened.complaints() == []
