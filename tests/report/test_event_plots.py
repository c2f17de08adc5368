"""Pictures of machines with several stops or switches: what is shaded, marked and named."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache

import casadi as ca
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.orbits import event_orbit
from zeno_orbits.report import orbit_motion, plots
from zeno_orbits.simulation import Execution


@cache
def _motion(name: str) -> Execution:
    orbit, problem = event_orbit(name), zo.load_problem(name)
    return orbit_motion(orbit, problem, problem.graph_dynamics(orbit.values(problem)))


def _labels(figure: Figure) -> set[str]:
    return {text.get_text() for legend in figure.legends for text in legend.get_texts()}


def _points(line: Line2D) -> np.ndarray:
    return np.asarray(line.get_xydata())


def _shaded(ax: Axes) -> list[Rectangle]:
    return [patch for patch in ax.patches if isinstance(patch, Rectangle)]


def _spans(ax: Axes) -> dict[str, list[tuple[float, float]]]:
    """Return the shaded intervals of a panel by colour."""
    found: dict[str, list[tuple[float, float]]] = {}
    for patch in _shaded(ax):
        ends = (patch.get_x(), patch.get_x() + patch.get_width())
        found.setdefault(to_hex(patch.get_facecolor()), []).append(ends)
    return found


def test_the_closed_intervals_of_each_stop_are_shaded_in_a_colour_of_its_own() -> None:
    orbit, execution = event_orbit("clapper"), _motion("clapper")
    figure = plots.plot_time_series(zo.load_problem("clapper"), execution)
    spans = _spans(figure.axes[0])
    times = {event.name: event.time for event in orbit.events}
    # The period starts at the Zeno point of the upper stop.
    assert orbit.section == "zeno upper"
    closed = [(times["zeno lower"], times["release lower"]), (0.0, times["release upper"])]
    seen = [one for intervals in spans.values() for one in intervals]
    for interval in closed:
        assert any(one == pytest.approx(interval, abs=1e-6 * orbit.period) for one in seen)
    colours = [
        next(c for c, parts in spans.items() if any(p == pytest.approx(i, abs=1e-5) for p in parts))
        for i in closed
    ]
    assert len(set(colours)) == 2
    # By symmetry both stops are closed equally long.
    assert np.ptp(closed[0]) == pytest.approx(np.ptp(closed[1]), rel=1e-9)
    for name in ("upper", "lower"):
        assert {f"contact phase: {name}", f"impact: {name}"} <= _labels(figure)


def test_two_stops_that_are_closed_at_once_share_the_height_of_a_panel() -> None:
    def pair(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        stops = tuple(
            zo.Stop(name=name, gap=q[k], restitution=0.0)
            for k, name in enumerate(("left", "right"))
        )
        balls = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=ca.dot(v, v) / 2, potential=p["g"] * (q[0] + q[1]), stops=stops
        )
        return zo.hybrid_system(balls, zo.no_drive(balls))

    problem = zo.Problem(
        name="two_balls",
        title="two balls",
        source="here",
        state_names=("a", "b", "da", "db"),
        state_units=("m", "m", "m/s", "m/s"),
        parameters=(zo.Quantity.positive("g", 10.0, "m/s^2", "gravity"),),
        gains=(),
        model=pair,
        starts=({"a": 0.2, "b": 0.8},),
        portraits=(("a", "da"),),
        amplitude_of="a",
    )
    figure = zo.plot(zo.simulate(problem, until=1.0), problem=problem)
    heights = sorted(
        {(patch.get_y(), patch.get_y() + patch.get_height()) for patch in _shaded(figure.axes[0])}
    )
    assert heights == [(0.0, 0.5), (0.0, 1.0), (0.5, 1.0)]
    # A ball falls from the height h in sqrt(2 h / g).
    both = [patch for patch in _shaded(figure.axes[0]) if patch.get_height() == 0.5]
    assert {round(patch.get_x(), 9) for patch in both} == {round(math.sqrt(0.16), 9)}


def test_switches_are_lines_at_their_times_and_marks_at_their_states() -> None:
    orbit, problem = event_orbit("hopper"), zo.load_problem("hopper")
    figure = plots.plot_time_series(problem, _motion("hopper"))
    for ax in figure.axes:
        drawn = [float(_points(line)[0, 0]) for line in ax.lines if line.get_gid() == "switch"]
        told = [event.time for event in orbit.events if event.name.startswith("switch")]
        assert sorted(drawn) == pytest.approx(told, abs=1e-9)
    assert {"switch: kink 1", "switch: kink 2", "impact"} <= _labels(figure)
    # The stop of this machine has no name.
    assert not any(label.endswith(": stop") for label in _labels(figure))
    (portrait,) = plots.plot_portraits(problem, _motion("hopper")).axes
    marks = [_points(line)[0] for line in portrait.lines if line.get_gid() == "switch"]
    # The push ends and would begin again at the height s, and the speed is zero at the top.
    height = problem.values().parameters["s"]
    assert sorted(mark[0] for mark in marks)[:2] == pytest.approx([height, height], abs=1e-9)
    assert min(abs(mark[1]) for mark in marks) == pytest.approx(0.0, abs=1e-9)


def test_an_orbit_of_events_is_drawn_as_portraits_with_its_resets() -> None:
    orbit = event_orbit("kneed_walker")
    figure = zo.plot(orbit)
    assert {"switch: heel strike", "contact phase: knee", "Zeno point", "reset"} <= _labels(figure)
    strike = orbit.events[-1].state
    start = orbit.start_state
    resets = [_points(line) for line in figure.axes[0].lines if line.get_label() == "reset"]
    # Heel strike leads from the state before it to the start of the period.
    wanted = np.array([[strike["q1"], strike["dq1"]], [start["q1"], start["dq1"]]])
    assert any(one == pytest.approx(wanted, abs=1e-8) for one in resets if one.shape == (2, 2))


def test_the_legend_lacks_a_contact_phase_that_is_a_point_of_the_portrait() -> None:
    figure = plots.plot_portraits(zo.load_problem("clapper"), _motion("clapper"))
    assert "Zeno point" in _labels(figure)
    assert not any(label.startswith("contact phase") for label in _labels(figure))


@pytest.mark.parametrize(
    ("name", "gaps"),
    fast(
        1,
        [
            ("clapper", {"lower": lambda q: 1.0 + q, "upper": lambda q: 1.0 - q}),
            ("relay", {"open": lambda z: 9e-4 - z, "closed": lambda z: z}),
        ],
    ),
)
def test_a_zoom_has_a_row_for_every_stop_with_its_own_gap_and_impacts(
    name: str, gaps: dict[str, Callable[[float], float]]
) -> None:
    orbit, problem = event_orbit(name), zo.load_problem(name)
    graph = problem.graph_dynamics(orbit.values(problem))
    figure = plots.plot_zeno_neighbourhood(problem, _motion(name), graph)
    # The rows follow the Zeno points of the period.
    assert [event.name.removeprefix("zeno ") for event in orbit.events if "zeno" in event.name] == [
        *gaps
    ]
    assert len(figure.axes) == 3 * len(gaps)
    for k, (stop, gap) in enumerate(gaps.items()):
        first, flights, hits = figure.axes[3 * k : 3 * k + 3]
        for ax, words in ((first, "gap $h$"), (flights, "gap $h$"), (hits, "impact speed")):
            label = ax.get_ylabel().replace("\n", " ")
            assert label.startswith(words)
            assert f" of {stop} [" in label
        times, drawn = _points(first.lines[1]).T
        middle = len(times) // 2
        place = float(_motion(name).state_at(float(times[middle]))[0])
        assert drawn[middle] == pytest.approx(gap(place), abs=1e-12)
        (speeds,) = [line for line in hits.lines if line.get_label() == "before impact"]
        told = [event for event in orbit.events if event.name == f"impact {stop}"]
        assert len(_points(speeds)) == len(told)


@pytest.mark.slow
def test_a_family_marks_the_end_at_which_two_events_meet() -> None:
    orbit = zo.find_orbit("kneed_walker", parameters={"restitution": 0.38}).unwrap()
    found = zo.continue_orbit(orbit, ("restitution", 0.379, 0.40))
    figure = zo.plot(found)
    assert "two events meet" in _labels(figure)
    (mark,) = (line for line in figure.axes[0].lines if line.get_label() == "two events meet")
    # The heel strike meets the Zeno point of the knee there.
    assert _points(mark)[0, 0] == pytest.approx(0.38397, abs=5e-6)
