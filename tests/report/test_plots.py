"""Pictures: what they mark, how their axes speak, and how they reach the disk."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation

from tests.support.cases import fast
from zeno_orbits import HybridLagrangian, hybrid_system, no_drive
from zeno_orbits.errors import InputError
from zeno_orbits.maps import Attractor, AttractorClass, Axis, Boundary, ParameterMap
from zeno_orbits.model import CompletedSystem, HybridDynamics, Problem, Quantity, load_problem
from zeno_orbits.precision import TimedSetting, WorkPrecision
from zeno_orbits.report.plots import (
    COLUMN_WIDTH,
    FULL_WIDTH,
    plot_map,
    plot_portraits,
    plot_time_series,
    plot_trade,
    plot_zeno_neighbourhood,
    plot_zeno_set,
    save_figure,
)
from zeno_orbits.simulation import (
    Ending,
    Execution,
    Mode,
    SimulationSettings,
    Truncation,
    ZenoExtrapolation,
    simulate,
)

RELEASE = (0.1985068301199, 0.0, -5.2365375521764, 0.0, -1.8591703843225)
UNIT = re.compile(r" \[[^\]]+\]$")


class Shown(NamedTuple):
    problem: Problem
    dynamics: HybridDynamics
    execution: Execution

    def pictures(self, width: float) -> list[Figure]:
        problem, dynamics, execution = self
        return [
            plot_portraits(problem, execution, width=width),
            plot_time_series(problem, execution, width=width),
            plot_zeno_neighbourhood(problem, execution, dynamics, width=width),
            plot_zeno_set(problem, dynamics, execution, width=width),
            plot_zeno_set(problem, dynamics, width=width),
        ]


def simulated(
    problem: Problem,
    state: tuple[float, ...],
    *,
    until: float = 10.0,
    releases: int | None = None,
    settings: SimulationSettings | None = None,
    **parameters: float,
) -> Shown:
    values = problem.values(parameters=parameters)
    dynamics = problem.dynamics(values)
    execution = simulate(dynamics, state, until=until, releases=releases, settings=settings)
    return Shown(problem, dynamics, execution)


def sliding_puck() -> Problem:
    """Return a puck on a wall at y = 0.5, without motor; the stop leaves its x free."""

    def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        puck = HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2 + 0.3 * v[0] * v[1],
            potential=9 * q[0] * q[1],
            gap=q[1] - 0.5,
        )
        return hybrid_system(puck, no_drive(puck), p["restitution"])

    return Problem(
        name="puck",
        title="puck on a wall",
        source="for this test",
        state_names=("x", "y", "dx", "dy"),
        state_units=("m", "m", "m/s", "m/s"),
        parameters=(Quantity.restitution(0.3),),
        gains=(),
        model=model,
        starts=({"x": 1.0, "y": 0.6},),
        portraits=(("x", "dx"), ("y", "dy")),
        amplitude_of="x",
    )


def pendulum(*, e: float = 0.2, releases: int = 1) -> Shown:
    problem = load_problem("motor_pendulum")
    return simulated(problem, RELEASE, releases=releases, restitution=e)


PROBLEMS: dict[str, Callable[[], Problem]] = {
    "pendulum": pendulum,
    "three periods": lambda: pendulum(releases=3),
    "plastic": lambda: pendulum(e=0.0),
    "elastic": lambda: pendulum(e=0.41),
    "ball": lambda: simulated(load_problem("bouncing_ball"), (1.0, 0.0), until=5.0),
    "truncated ball": lambda: simulated(
        load_problem("bouncing_ball"),
        (1.0, 0.0),
        until=5.0,
        settings=SimulationSettings(completion=Truncation(delta=0.01)),
    ),
    "puck": lambda: simulated(sliding_puck(), (1.0, 0.6, 0.0, 0.0), until=0.8),
}


def early_ball() -> Shown:
    """Return a ball whose Zeno point is taken from its first impacts, so that a tail is left."""
    rough = SimulationSettings(completion=ZenoExtrapolation(resolved=0.5))
    return simulated(load_problem("bouncing_ball"), (1.0, 0.0), until=5.0, settings=rough)


PROBLEMS["early ball"] = early_ball


_LONGER = {"three periods", "plastic", "elastic", "ball", "truncated ball"}
"""Pictures with nothing in them that those of the others have not."""


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=[pytest.mark.slow] * (name in _LONGER)) for name in PROBLEMS],
)
def problem(request: pytest.FixtureRequest) -> Shown:
    return PROBLEMS[request.param]()


@pytest.fixture(scope="module")
def orbit() -> Shown:
    return pendulum(releases=3)


def spans(ax: Axes, mode: Mode) -> list[tuple[float, float]]:
    patches = [patch for patch in ax.patches if patch.get_gid() == mode.value]
    boxes = [patch.get_extents().transformed(ax.transData.inverted()) for patch in patches]
    return [(box.x0, box.x1) for box in boxes]


def points(line: Line2D) -> np.ndarray:
    return np.column_stack(line.get_data())


def marked(ax: Axes) -> np.ndarray:
    return np.concatenate([points(line) for line in ax.lines if line.get_gid() == "impact"])


def labelled(ax: Axes, label: str) -> list[Line2D]:
    return [line for line in ax.lines if line.get_label() == label]


def ticks(ax: Axes) -> list[float]:
    (collection,) = [item for item in ax.collections if item.get_gid() == "impact"]
    assert isinstance(collection, LineCollection)
    return [float(segment[0, 0]) for segment in collection.get_segments()]


@pytest.fixture(scope="module")
def drawn(problem: Shown) -> list[Figure]:
    """The pictures of a problem at the width of a column, where room is scarce."""
    return laid_out(problem, COLUMN_WIDTH)


def laid_out(problem: Shown, width: float) -> list[Figure]:
    figures = problem.pictures(width)
    for figure in figures:
        figure.draw_without_rendering()
    return figures


def test_every_axis_says_its_quantity_and_its_unit(drawn: list[Figure]) -> None:
    for figure in drawn:
        for ax in figure.axes:
            assert UNIT.search(ax.get_ylabel())
            numbered = any(tick.label1.get_visible() for tick in ax.xaxis.get_major_ticks())
            assert not numbered or UNIT.search(ax.get_xlabel())


def test_the_legend_keeps_off_the_panels_and_inside_the_picture(drawn: list[Figure]) -> None:
    legends_keep_off(drawn)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puck", "three periods"])
def test_the_legend_does_so_over_the_whole_width_of_a_page(name: str) -> None:
    legends_keep_off(laid_out(PROBLEMS[name](), FULL_WIDTH))


def legends_keep_off(figures: list[Figure]) -> None:
    for figure in figures:
        legend = figure.legends[0].get_window_extent()
        assert 0.0 <= legend.x0 < legend.x1 <= figure.bbox.x1
        assert legend.y1 <= figure.bbox.y1
        assert all(not legend.overlaps(ax.get_window_extent()) for ax in figure.axes)


def test_portraits_and_time_series_mark_every_impact_once(problem: Shown) -> None:
    impacts = problem.execution.impacts
    for ax in plot_portraits(problem.problem, problem.execution).axes:
        assert len(marked(ax)) == len(impacts)
    for ax in plot_time_series(problem.problem, problem.execution).axes:
        assert ticks(ax) == [impact.time for impact in impacts]


def test_the_mark_before_an_impact_is_the_state_before_it(orbit: Shown) -> None:
    ax = plot_portraits(orbit.problem, orbit.execution).axes[1]
    before = np.array([impact.state_minus for impact in orbit.execution.impacts])
    assert np.array_equal(marked(ax), before[:, [1, 3]])


def test_zeno_points_and_releases_are_marked_where_they_are(orbit: Shown) -> None:
    ax = plot_portraits(orbit.problem, orbit.execution).axes[0]
    for label, events in (
        ("Zeno point", orbit.execution.zeno_points),
        ("release", orbit.execution.releases),
    ):
        marks = [points(line)[0].tolist() for line in labelled(ax, label)]
        assert marks == [event.state[[0, 2]].tolist() for event in events]


def test_locked_phases_are_shaded_from_zeno_point_to_release(orbit: Shown) -> None:
    zeno = [point.time for point in orbit.execution.zeno_points]
    release = [event.time for event in orbit.execution.releases]
    for ax in plot_time_series(orbit.problem, orbit.execution).axes:
        assert np.allclose(
            spans(ax, Mode.LOCKED), list(zip(zeno, release, strict=True)), rtol=0, atol=1e-12
        )
        free = list(zip([0.0, *release[:-1]], zeno, strict=True))
        assert np.allclose(spans(ax, Mode.FREE), free, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_time_series_show_coordinates_their_velocities_beside_them_and_the_current(
    orbit: Shown,
) -> None:
    figure = plot_time_series(orbit.problem, orbit.execution)
    labels = {ax.get_ylabel(): ax for ax in figure.axes}
    columns = {
        r"$\theta_{1}$ [rad]": 0,
        r"$\dot{\theta}_{1}$ [rad/s]": 2,
        r"$\theta_{2}$ [rad]": 1,
        r"$\dot{\theta}_{2}$ [rad/s]": 3,
        "$i$ [A]": 4,
    }
    assert list(labels) == list(columns)
    arcs = [arc for arc in orbit.execution.arcs if arc.ending is not Ending.ZENO]
    for label, column in columns.items():
        ax = labels[label]
        lines = [line for line in ax.lines if line.get_label() in {"free arc", "contact phase"}]
        for line, arc in zip(lines, arcs, strict=True):
            times, values = points(line).T
            assert values == pytest.approx([arc.state_at(t)[column] for t in times], abs=1e-9)
        stars = [points(line)[0].tolist() for line in labelled(ax, "Zeno point")]
        zeno = orbit.execution.zeno_points
        assert stars == [[point.time, point.state[column]] for point in zeno]


def test_portraits_show_each_arc_over_the_states_that_their_axes_name(orbit: Shown) -> None:
    figure = plot_portraits(orbit.problem, orbit.execution)
    arcs = [arc for arc in orbit.execution.arcs if arc.ending is not Ending.ZENO]
    for ax, pair in zip(figure.axes, ([0, 2], [1, 3]), strict=True):
        assert ax.get_xlabel() == rf"$\theta_{{{pair[0] + 1}}}$ [rad]"
        assert ax.get_ylabel() == rf"$\dot{{\theta}}_{{{pair[0] + 1}}}$ [rad/s]"
        lines = [line for line in ax.lines if line.get_label() in {"free arc", "contact phase"}]
        for line, arc in zip(lines, arcs, strict=True):
            ends = points(line)[[0, -1]]
            assert ends.tolist() == [arc.start_state[pair].tolist(), arc.end_state[pair].tolist()]
            expected = {Mode.FREE: "free arc", Mode.LOCKED: "contact phase"}[arc.mode]
            assert line.get_label() == expected


def test_arrows_in_a_portrait_point_the_way_the_motion_goes(orbit: Shown) -> None:
    figure = plot_portraits(orbit.problem, orbit.execution)
    for ax, pair in zip(figure.axes, ([0, 2], [1, 3]), strict=True):
        arrows = [text for text in ax.texts if text.get_gid() == "direction"]
        assert 2 <= len(arrows) <= 6
        _, states = orbit.execution.sampled(400)
        sizes = np.ptp(states[:, pair], axis=0)
        curve = states[:, pair] / sizes
        for arrow in arrows:
            assert isinstance(arrow, Annotation)
            tail, head = np.array(arrow.xyann) / sizes, np.array(arrow.xy) / sizes
            # The motion passes here once a period, each time in the same direction.
            at = int(np.argmin(np.sum((curve - (tail + head) / 2) ** 2, axis=1)))
            assert (head - tail) @ (curve[at + 1] - curve[at - 1]) > 0.0


def test_a_zeno_tail_without_impacts_leaves_no_hole_in_the_curve() -> None:
    ball = early_ball()
    (zeno,) = ball.execution.zeno_points
    ax = plot_time_series(ball.problem, ball.execution).axes[0]
    (tail,) = labelled(ax, "Zeno tail, summed")
    assert points(tail)[:, 0].tolist() == [ball.execution.impacts[-1].time, zeno.time]


def test_the_first_order_law_meets_every_impact_of_a_ball() -> None:
    ball = early_ball()
    ax = plot_zeno_neighbourhood(ball.problem, ball.execution, ball.dynamics).axes[2]
    (law,) = labelled(ax, "first-order law")
    remaining, speed = points(law)[0]
    measured = marked(ax)
    assert np.allclose(measured[:, 1], speed / remaining * measured[:, 0], rtol=1e-9)


def test_the_flights_of_the_law_continue_the_resolved_ones_of_a_ball() -> None:
    ball = early_ball()
    ax = plot_zeno_neighbourhood(ball.problem, ball.execution, ball.dynamics).axes[0]
    law = [points(line) for line in labelled(ax, "first-order law")]
    last = ball.execution.impacts[-1]
    highest = (0.8 * last.approach_rate) ** 2 / (2 * 9.81)
    expected = [highest * 0.8 ** (2 * k) for k in range(len(law))]
    assert np.allclose([flight[:, 1].max() for flight in law], expected, rtol=1e-3)
    assert law[0][0, 0] == pytest.approx(last.time)


def test_a_zoom_begins_at_the_last_release_before_its_zeno_point() -> None:
    # Both periods of an orbit are alike, so a zoom into the second one shows no more impacts.
    once, twice = (pendulum(releases=n) for n in (1, 2))
    shown = [marked(plot_zeno_neighbourhood(*one).axes[2]) for one in map(_drawn, (once, twice))]
    assert len(twice.execution.impacts) == 2 * len(once.execution.impacts)
    assert len(shown[0]) == len(shown[1]) == len(once.execution.impacts)


def _drawn(one: Shown) -> tuple[Problem, Execution, HybridDynamics]:
    return one.problem, one.execution, one.dynamics


def test_the_boundary_of_the_region_is_the_published_curve(orbit: Shown) -> None:
    ax = plot_zeno_set(orbit.problem, orbit.dynamics).axes[0]
    (boundary,) = [item for item in ax.collections if np.ravel(item.get_linewidth())[0] == 1.2]
    vertices = [np.asarray(path.vertices) for path in boundary.get_paths()]
    angle, current = np.concatenate(vertices).T
    assert np.allclose(current, -27.5697 / 2.92437 * np.sin(angle), rtol=0, atol=0.02)
    assert ax.get_xlim() == pytest.approx((-np.pi, np.pi))


@pytest.mark.slow
def test_a_problem_without_current_shows_its_region_over_coordinate_and_velocity() -> None:
    puck = PROBLEMS["puck"]()
    ax = plot_zeno_set(puck.problem, puck.dynamics, puck.execution).axes[0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$x$ [m]", r"$\dot{x}$ [m/s]")


def test_a_problem_with_one_coordinate_shows_a_curve_over_its_velocity() -> None:
    ball = PROBLEMS["ball"]()
    (ax,) = plot_zeno_set(ball.problem, ball.dynamics, ball.execution).axes
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("speed [m/s]", r"$\ddot h$ [m/s$^2$]")
    (curve,) = labelled(ax, r"$\ddot h$")
    assert np.allclose(points(curve)[:, 1], -9.81)


def test_a_zoom_needs_a_zeno_point() -> None:
    falling = simulated(load_problem("bouncing_ball"), (1.0, 0.0), until=0.1)
    with pytest.raises(InputError, match="`execution` lacks a Zeno point"):
        plot_zeno_neighbourhood(falling.problem, falling.execution, falling.dynamics)


def test_a_flight_without_events_is_drawn_all_the_same() -> None:
    falling = simulated(load_problem("bouncing_ball"), (1.0, 0.0), until=0.1)
    (portrait,) = plot_portraits(falling.problem, falling.execution).axes
    series = plot_time_series(falling.problem, falling.execution).axes[0]
    assert len(labelled(portrait, "free arc")) == len(labelled(series, "free arc")) == 1
    assert spans(series, Mode.LOCKED) == []


@pytest.mark.slow
def test_drawing_leaves_the_settings_of_matplotlib_alone(orbit: Shown, tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    save_figure(plot_portraits(orbit.problem, orbit.execution), tmp_path / "portrait.svg")
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize(
    ("name", "start"), [("a.png", b"\x89PNG"), ("a.PDF", b"%PDF"), ("a.svg", b"<?xml")]
)
def test_the_suffix_says_the_format_and_the_bytes_repeat(
    name: str, start: bytes, tmp_path: Path
) -> None:
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        figure = Figure(figsize=(1, 1))
        figure.add_subplot().plot([0, 1])
        save_figure(figure, tmp_path / folder / name)
    first, second = ((tmp_path / folder / name).read_bytes() for folder in ("one", "two"))
    assert first.startswith(start)
    assert first == second
    assert [path.name for path in (tmp_path / "one").iterdir()] == [name]


@pytest.mark.parametrize("name", ["picture.gif", "picture", ".png"])
def test_an_unknown_suffix_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"`path` must end in \.png, \.pdf or \.svg, but"):
        save_figure(Figure(), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_leaves_the_old_picture_and_no_partial_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "picture.png"
    path.write_text("old")

    def break_off(_: Figure, target: io.BytesIO, **_settings: object) -> None:
        target.write(b"half a pic")
        raise OSError("No space left on device")

    monkeypatch.setattr(Figure, "savefig", break_off)
    with pytest.raises(OSError, match="No space left"):
        save_figure(Figure(), path)
    assert [file.name for file in tmp_path.iterdir()] == ["picture.png"]
    assert path.read_text() == "old"


# ---------------------------------------------------------------------------------- a trade


def measured(sweep: str, name: str, *pairs: tuple[float, float]) -> tuple[TimedSetting, ...]:
    """Return trials of times and errors, the loosest first."""
    return tuple(
        TimedSetting(sweep=sweep, name=name, value=10.0**-k, seconds=seconds, error=error)
        for k, (seconds, error) in enumerate(pairs)
    )


TRADE = WorkPrecision(
    problem="p",
    work="w",
    truth="t",
    truth_error=1e-25,
    trials=(
        *measured("engine", "explicit", (1e-3, 1e-3), (4e-3, 1e-9)),
        *measured("engine", "implicit", (2e-3, 0.0), (np.inf, np.inf)),
        *measured("cut", "plastic below", (3e-3, 1e-2)),
        *measured("fidelity", "quasi_static", (5e-4, 1e-1)),
        *measured("mesh", "868 unknowns", (1e-6, 1e-6)),
    ),
)


def lines_of(figure: Figure) -> dict[str, Line2D]:
    return {str(line.get_label()): line for line in figure.axes[0].get_lines()}


def test_a_trade_has_a_line_an_engine_and_one_for_the_front() -> None:
    figure = plot_trade(TRADE)
    lines = lines_of(figure)
    assert list(lines) == [
        *("explicit", "implicit", "plastic below a speed", "model quasi_static"),
        "nothing is faster and better",
    ]
    assert lines["explicit"].get_linestyle() != lines["plastic below a speed"].get_linestyle()
    looks = {(line.get_color(), line.get_marker()) for line in lines.values()}
    assert len(looks) == len(lines)


def test_a_trade_shows_times_in_milliseconds_and_what_is_lost_nowhere() -> None:
    lines = lines_of(plot_trade(TRADE))
    assert sorted(np.asarray(lines["explicit"].get_ydata())) == pytest.approx([1.0, 4.0])
    # An error of zero has no logarithm and an infinite one no place.
    (error,) = np.asarray(lines["implicit"].get_xdata())
    assert 0.0 < error < 1e-15
    front = lines["nothing is faster and better"]
    assert list(np.asarray(front.get_ydata())) == pytest.approx([0.5, 1.0, 2.0])


@pytest.mark.slow
def test_a_trade_without_any_result_is_an_empty_picture(tmp_path: Path) -> None:
    lost = WorkPrecision(problem="p", work="w", truth="t", truth_error=1e-25, trials=())
    save_figure(plot_trade(lost), tmp_path / "lost.png")
    assert (tmp_path / "lost.png").read_bytes().startswith(b"\x89PNG")


def small_map(*attractors: Attractor, columns: int = 3) -> ParameterMap:
    return ParameterMap(
        problem="motor_pendulum",
        x=Axis(name="Kp", lower=1.0, upper=3.0, count=columns, unit="V/rad"),
        y=Axis(name="Kd", lower=-2.0, upper=-1.0, count=len(attractors) // columns, unit="V s/rad"),
        gains={},
        parameters={},
        start={},
        until=60.0,
        attractors=attractors,
        versions={},
    )


def _zeno(period: float, radius: float, returns: int = 1) -> Attractor:
    multipliers = (complex(radius), 0j)
    return Attractor(
        fate=AttractorClass.ZENO, returns=returns, period=period, multipliers=multipliers
    )


EVERY_FATE = (
    *(_zeno(1.70 + 0.1 * k, 0.1 + 0.15 * k) for k in range(3)),
    *(_zeno(1.75 + 0.1 * k, 0.2 + 0.15 * k) for k in range(3)),
    *(_zeno(3.6, 0.5, returns=n) for n in (2, 4, 3)),
    Attractor(fate=AttractorClass.SIMPLE, returns=1, period=1.8),
    Attractor(fate=AttractorClass.NO_ZENO, period=1.8),
    Attractor(fate=AttractorClass.REST),
    Attractor(fate=AttractorClass.ESCAPE, escaped="theta1", detail="link 1 rotates"),
    Attractor(fate=AttractorClass.ESCAPE, escaped="theta2", detail="link 2 goes over the top"),
    Attractor(fate=AttractorClass.UNSETTLED),
    Attractor(fate=AttractorClass.UNSETTLED, trend=1.1),
    Attractor(fate=AttractorClass.UNSETTLED, trend=0.9),
    Attractor(fate=AttractorClass.FAILED, detail="no"),
)


def _legend(figure: Figure) -> dict[str, Any]:
    (legend,) = figure.legends
    handles = legend.legend_handles
    return {text.get_text(): handle for text, handle in zip(legend.texts, handles, strict=True)}


@pytest.mark.parametrize("width", [COLUMN_WIDTH, FULL_WIDTH])
def test_a_map_names_every_fate_once_in_a_colour_of_its_own(width: float) -> None:
    figure = plot_map(small_map(*EVERY_FATE), width=width)
    entries = _legend(figure)
    phrases = {attractor.phrase for attractor in EVERY_FATE}
    assert phrases <= set(entries)
    colours = [entries[phrase].get_facecolor() for phrase in phrases]
    assert len(set(colours)) == len(phrases)
    (ax,) = figure.axes
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$K_{p}$ [V/rad]", "$K_{d}$ [V s/rad]")


@pytest.mark.parametrize("width", [COLUMN_WIDTH, FULL_WIDTH])
def test_the_legend_of_a_map_stands_outside_and_inside_the_picture(width: float) -> None:
    figure = plot_map(small_map(*EVERY_FATE), width=width)
    figure.savefig(io.BytesIO(), format="png")
    (ax,) = figure.axes
    (legend,) = figure.legends
    inside, outside = ax.get_window_extent(), legend.get_window_extent()
    assert not inside.overlaps(outside)
    assert figure.bbox.x0 <= outside.x0
    assert outside.x1 <= figure.bbox.x1
    assert outside.y0 >= figure.bbox.y0
    assert inside.width > 0.5 * inside.height > 0.15 * inside.width


def test_the_cells_of_a_map_have_the_colours_of_their_fates() -> None:
    figure = plot_map(small_map(*EVERY_FATE))
    (mesh,) = (c for c in figure.axes[0].collections if isinstance(c, QuadMesh))
    figure.savefig(io.BytesIO(), format="png")
    entries = _legend(figure)
    cells = mesh.get_facecolor().reshape(-1, 4)
    for cell, attractor in zip(cells, EVERY_FATE, strict=True):
        assert tuple(cell) == pytest.approx(entries[attractor.phrase].get_facecolor())


def test_the_axes_of_a_map_end_at_its_range_also_under_boundaries() -> None:
    curve = Boundary(name="flip", points=((0.0, -1.5), (9.0, -1.5)))
    found = small_map(*EVERY_FATE)
    for curves in ((), (curve,)):
        (ax,) = plot_map(found, boundaries=curves).axes
        assert ax.get_xlim() == (found.x.lower, found.x.upper)
        assert ax.get_ylim() == (found.y.lower, found.y.upper)
    figure = plot_map(found, boundaries=[curve])
    (ax,) = figure.axes
    assert "flip" in _legend(figure)
    assert any(np.array_equal(line.get_xdata(), [0.0, 9.0]) for line in ax.lines)


def test_a_map_of_one_fate_has_no_contours() -> None:
    rest = [Attractor(fate=AttractorClass.REST)] * 6
    assert list(_legend(plot_map(small_map(*rest)))) == ["rest"]
    same = [_zeno(1.8, 0.1)] * 400
    figure = plot_map(small_map(*same, columns=20))
    assert list(_legend(figure)) == ["Zeno periodic orbit, period 1"]


def test_rounding_of_a_period_that_the_clock_fixes_is_no_contour() -> None:
    points = [(i / 19, k / 19) for k in range(20) for i in range(20)]
    rounded = small_map(*(_zeno(6.28 + 1e-9 * x, 0.95 * y) for x, y in points), columns=20)
    legend = _legend(plot_map(rounded))
    assert "spectral radius [1]" in legend
    assert "period [s]" not in legend


def sloping_map(n: int) -> ParameterMap:
    """Return a map whose period rises to the right and whose spectral radius rises upwards."""
    points = [(i / (n - 1), k / (n - 1)) for k in range(n) for i in range(n)]
    return small_map(*(_zeno(1.5 + 0.4 * x, 0.95 * y) for x, y in points), columns=n)


def test_a_map_of_few_points_draws_cells_and_no_contours() -> None:
    assert list(_legend(plot_map(sloping_map(6)))) == ["Zeno periodic orbit, period 1"]
    assert {"period [s]", "spectral radius [1]"} <= set(_legend(plot_map(sloping_map(20))))


def test_contours_of_a_map_lie_where_the_map_has_their_level() -> None:
    (ax,) = plot_map(sloping_map(20)).axes
    contours = [one for one in ax.collections if isinstance(one, QuadContourSet)]
    assert len(contours) == 2
    for lines in contours:
        for level, path in zip(lines.levels, lines.get_paths(), strict=True):
            x, y = (np.asarray(path.vertices).T - [[1.0], [-2.0]]) / [[2.0], [1.0]]
            across = lines is contours[0]
            field = 1.5 + 0.4 * x if across else 0.95 * y
            # The field is linear, so that contours between cells are exact.
            assert np.allclose(field, level, rtol=0, atol=1e-12)


@pytest.mark.parametrize("width", [COLUMN_WIDTH, FULL_WIDTH])
@pytest.mark.parametrize("height", fast(2, [None, -1.7, -1.48, -1.26]))
def test_labels_of_contours_keep_off_each_other_and_off_boundaries(
    width: float, height: float | None
) -> None:
    curve = Boundary(name="fold", points=((0.0, height or 9.0), (9.0, height or 9.0)))
    figure = plot_map(sloping_map(20), width=width, boundaries=[curve])
    figure.savefig(io.BytesIO(), format="png")
    renderer = FigureCanvasAgg(figure).get_renderer()
    (ax,) = figure.axes
    boxes = [text.get_window_extent(renderer) for text in ax.texts]
    assert len(boxes) >= 6
    for k, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[k + 1 :])
    for line in ax.lines:
        _, at = ax.transData.transform((2.0, np.ravel(line.get_ydata())[0]))
        assert not any(box.y0 <= at <= box.y1 for box in boxes)


def test_a_formula_in_a_label_of_two_lines_is_drawn_without_a_warning(
    caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    figure = Figure()
    ax = figure.subplots()
    ax.set_xlabel("speed $v$ of\nright [m/s]")
    ax.set_ylabel("a name with $ in it")
    save_figure(figure, tmp_path / "label.png")
    assert not caplog.records
    assert ax.xaxis.label.get_parse_math()
    # One dollar sign begins no formula.
    assert ax.yaxis.label.get_text() == "a name with $ in it"
