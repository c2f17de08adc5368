"""The figures of the paper: what they hold, that they are whole, and what is said where not."""

from __future__ import annotations

import io
import json
import math
import re
import shlex
import shutil
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from PIL import Image

from tests.support.recordings_of import recorded
from zeno_orbits import write_orbit
from zeno_orbits.arrays import Vector
from zeno_orbits.cli import main
from zeno_orbits.errors import InputError, SimulationError, ZenoOrbitsError
from zeno_orbits.experiment import (
    MatchedRun,
    OrbitTable,
    Recording,
    Source,
    crop_recording,
    recording_counterpart,
    rig_counterpart,
    tabulate_orbit,
)
from zeno_orbits.model import HybridDynamics, Problem, load_problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.report import plots
from zeno_orbits.report.plots import COLUMN_WIDTH, PAPER, TwoMotions
from zeno_orbits.simulation import Execution, simulate
from zeno_orbits.work import Progress, write_all

COUNTERPARTS = "zeno_orbits.experiment.comparison.counterpart"

YES, NO, MISUSE = 0, 1, 2
FIGURES = (
    *("fig2_systems", "fig3_mechanism", "region", "fig4_portraits"),
    *("fig5a_over_time", "fig5a_by_phase", "fig5b_impacts", "fig5c_portraits", "fig5d_zeno_point"),
)


def ask(*arguments: str | Path) -> tuple[int, str, str]:
    """Run a command and return its exit code, its output and its errors."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as ending:
            code = int(ending.code or 0)
    return code, out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def one(orbit: Orbit, problem: Problem, machine: HybridDynamics) -> Execution:
    """One period of the pendulum from its release on."""
    release = problem.state_vector(orbit.release_state)
    return simulate(machine, release, until=orbit.period * (1 + 1e-6))


@pytest.fixture(scope="module")
def several(orbit: Orbit, problem: Problem, machine: HybridDynamics) -> Execution:
    """Three periods."""
    release = problem.state_vector(orbit.release_state)
    return simulate(machine, release, until=3 * orbit.period)


def signals_of(execution: Execution, problem: Problem) -> tuple[Vector, dict[str, Vector]]:
    """Return times and states of a motion, without repeated times."""
    times, states = execution.sampled()
    kept = np.concatenate([[True], np.diff(times) > 0.0])
    return times[kept], {name: states[kept, k] for k, name in enumerate(problem.state_names)}


@pytest.fixture(scope="module")
def other(several: Execution, problem: Problem) -> MatchedRun:
    """A motion beside the model's: its own, every angle a hundredth smaller."""
    times, signals = signals_of(several, problem)
    smaller = 0.99 * np.stack([signals[name] for name in problem.state_names], axis=1)
    return MatchedRun(
        label="virtual rig, simulated", times=times, states=smaller, period=times[-1] / 3
    )


@pytest.fixture
def parts(
    monkeypatch: pytest.MonkeyPatch, several: Execution, problem: Problem, orbit: Orbit
) -> None:
    """Stand-ins for the virtual rig and for the reader of recordings, with the model's motion."""
    times, signals = signals_of(several, problem)
    names = (*problem.state_names, "rotor")
    run = SimpleNamespace(
        times=times, state_names=names, of=lambda name: signals.get(name, 0.0 * times)
    )
    cycle = SimpleNamespace(period=times[-1] / 3)

    def settle_rig(*_: Any, cycles: int, on_progress: Progress) -> Any:
        on_progress("simulating the machine", 0.5)
        assert cycles == 3
        return SimpleNamespace(run=run, cycles=(cycle, cycle, cycle))

    def read_recording(path: Path, *, only: Any, families: Any = (), units: Any = None) -> Any:
        assert tuple(families) in ((), ("contact",))
        assert units == only
        if not path.exists():
            raise InputError(f"Data file `{path}`: it is missing.")
        assert set(only) > set(problem.state_names)
        table = tabulate_orbit(orbit, problem, ("theta1", "theta2"))
        return replace(recorded(table, problem, n_cycles=8.0), source=Source.MEASURED)

    monkeypatch.setattr(f"{COUNTERPARTS}.settle_rig", settle_rig)
    monkeypatch.setattr("zeno_orbits.experiment.read_recording", read_recording)


@pytest.fixture
def orbit_file(orbit: Orbit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An orbit file in the working folder."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "orbit.json"
    write_orbit(orbit, path)
    return path


@pytest.fixture(scope="module", name="figures")
def _figures(
    problem: Problem,
    orbit: Orbit,
    machine: HybridDynamics,
    one: Execution,
    several: Execution,
    other: MatchedRun,
) -> dict[str, Figure]:
    two = TwoMotions(problem=problem, dynamics=machine, model=one, other=other)
    return {
        "fig2_systems": plots.plot_graph(problem, orbit.values(problem)),
        "fig3_mechanism": plots.plot_mechanism(problem, orbit.values(problem), one, orbit.period),
        "region": plots.plot_zeno_set(problem, machine, one, width=COLUMN_WIDTH),
        "fig4_portraits": plots.plot_portraits(problem, one, width=COLUMN_WIDTH),
        "fig5a_over_time": plots.plot_beside_over_time(replace(two, model=several)),
        "fig5a_by_phase": plots.plot_beside_by_phase(two),
        "fig5b_impacts": plots.plot_beside_impacts(two),
        "fig5c_portraits": plots.plot_beside_portraits(two),
        "fig5d_zeno_point": plots.plot_beside_zeno_point(two),
    }


# ---------------------------------------------------------------------------- what they hold


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_fits_a_column_and_can_be_read_there(
    figures: dict[str, Figure], name: str
) -> None:
    figure = figures[name]
    assert figure.get_size_inches()[0] == COLUMN_WIDTH
    plots.rendered(figure, "pdf")
    sizes = [text.get_fontsize() for text in _texts(figure) if text.get_text().strip()]
    # Labels in eight points, numbers at ticks one point smaller.
    assert max(sizes) == pytest.approx(8.0)
    assert min(sizes) >= 7.0


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_nothing_of_a_figure_is_cut_off(figures: dict[str, Figure], name: str) -> None:
    figure = figures[name]
    plots.rendered(figure, "pdf")
    drawn, (wide, high) = figure.get_tightbbox(), figure.get_size_inches()
    # Half a point of slack: the boxes of glyphs are a little larger than their ink.
    assert min(drawn.x0, drawn.y0) >= -0.5 / 72
    assert drawn.x1 <= wide + 0.5 / 72
    assert drawn.y1 <= high + 0.5 / 72


@pytest.mark.parametrize("name", FIGURES[1:])
def test_lines_can_be_told_apart_in_grey(figures: dict[str, Figure], name: str) -> None:
    assert _alike(figures[name]) == []


def test_lines_of_one_width_and_shade_are_not_told_apart_in_grey() -> None:
    figure = Figure()
    ax = figure.add_subplot()
    # Of Okabe and Ito's colours two that differ in hue alone.
    ax.plot([0, 1], [0, 1], color="#56B4E9", label="free")
    ax.plot([0, 1], [1, 0], color="#E69F00", label="locked")
    assert _alike(figure) == [("free", "locked")]


def _alike(figure: Figure) -> list[tuple[str, str]]:
    """Return labels of lines that have the same dashes, and hardly another width or shade."""
    lines = {
        str(line.get_label()): line
        for ax in figure.axes
        for line in ax.get_lines()
        if line.get_linestyle() != "None" and not str(line.get_label()).startswith("_")
    }

    def shade(line: Any) -> float:
        # How bright a colour is (Rec. 709), and so how grey it prints.
        return float(np.dot(to_rgb(line.get_color()), (0.2126, 0.7152, 0.0722)))

    found: list[tuple[str, str]] = []
    for first, second in combinations(lines, 2):
        a, b = lines[first], lines[second]
        thin, thick = sorted((a.get_linewidth(), b.get_linewidth()))
        same = a.get_linestyle() == b.get_linestyle() and thick < 1.5 * thin
        if same and abs(shade(a) - shade(b)) < 0.15:
            found.append((first, second))
    return found


def _texts(figure: Figure) -> list[Any]:
    from matplotlib.text import Text

    return [one for one in figure.findobj(Text) if isinstance(one, Text)]


@pytest.mark.parametrize("name", FIGURES[1:])
def test_every_axis_has_its_unit(figures: dict[str, Figure], name: str) -> None:
    axes = [ax for ax in figures[name].axes if ax.axison]
    assert axes
    for ax in axes:
        labels = [ax.get_ylabel()]
        # Panels over one time share the label of the lowest.
        if ax.get_xlabel() or any(t.get_visible() for t in ax.get_xticklabels()):
            labels += [ax.get_xlabel()] if ax.get_label() != "<colorbar>" else []
        assert all(re.search(r"\[.+\]$", label) for label in labels), labels


def test_the_region_ends_where_the_published_acceleration_is_zero(
    figures: dict[str, Figure],
) -> None:
    ax = figures["region"].axes[0]
    (boundary,) = [
        one for one in ax.collections if isinstance(one, ContourSet) and list(one.levels) == [0.0]
    ]
    corners = np.concatenate([path.vertices for path in boundary.get_paths()])
    assert len(corners) > 100
    theta, current = np.asarray(corners, dtype=np.float64).T
    # The paper's numbers. Between points of a grid of 2 pi / 100 the curve is drawn straight, and
    # off by at most 27.5697 (2 pi / 100)^2 / 8 in the acceleration.
    off = np.abs(-2.92437 * current - 27.5697 * np.sin(theta))
    assert np.max(off) < 27.5697 * (2 * math.pi / 100) ** 2 / 8
    assert np.ptp(theta) == pytest.approx(2 * math.pi, rel=1e-6)


def test_the_graphs_name_domain_guard_reset_and_every_edge(figures: dict[str, Figure]) -> None:
    system, completion = figures["fig2_systems"].axes
    words = [" ".join(text.get_text() for text in ax.texts) for ax in (system, completion)]
    for word in ("electromechanical", "off the stop", "$D_h$", "$G_h$", "$R_h$", "$e$ = 0.2"):
        assert word in words[0]
    assert "on the stop" not in words[0]
    for word in ("off the stop", "on the stop", "impact", "Zeno point", "release", r"\lambda > 0"):
        assert word in words[1]
    assert r"\dot{\theta}_{2}" in words[1]
    # Without a completion there is one domain with one edge; it adds a domain and two edges.
    for ax, domains, edges in ((system, 1, 1), (completion, 2, 3)):
        arrows = [patch for patch in ax.patches if "Arrow" in type(patch).__name__]
        assert (len(ax.patches) - len(arrows), len(arrows)) == (domains, edges)


@pytest.mark.parametrize("name", ["fig2_systems"])
def test_no_words_of_the_graphs_lie_on_each_other_or_on_an_arrow(
    figures: dict[str, Figure], name: str
) -> None:
    figure = figures[name]
    renderer = FigureCanvasAgg(figure).get_renderer()
    for ax in figure.axes:
        # A box of text has its line spacing around the ink: three points of it are no overlap.
        boxes = [text.get_window_extent(renderer).padded(-3 * figure.dpi / 72) for text in ax.texts]
        for k, box in enumerate(boxes):
            assert not any(box.overlaps(other) for other in boxes[k + 1 :]), ax.texts[k]
            for patch in ax.patches:
                path = patch.get_transform().transform_path(patch.get_path())
                if "Arrow" in type(patch).__name__:
                    ink = np.concatenate(path.to_polygons(closed_only=False))
                    assert box.count_contains(ink) == 0, ax.texts[k]


def test_a_problem_without_a_motor_is_no_electromechanical_one() -> None:
    ball = load_problem("forced_oscillator")
    words = [text.get_text() for text in plots.plot_graph(ball, ball.values()).axes[0].texts]
    assert "(a) simple hybrid system" in words


def test_the_rig_is_called_simulated_and_never_measured(figures: dict[str, Figure]) -> None:
    for name in FIGURES[4:]:
        words = " ".join(text.get_text() for text in _texts(figures[name]))
        assert "simulated" in words, name
        assert "measured" not in words, name


def test_the_other_motion_lies_where_it_was(figures: dict[str, Figure], other: MatchedRun) -> None:
    (line,) = [
        line
        for line in figures["fig5a_over_time"].axes[1].get_lines()
        if line.get_label() == other.label
    ]
    assert np.array_equal(line.get_xdata(), other.times)
    assert np.array_equal(line.get_ydata(), other.states[:, 1])


def test_the_zeno_point_is_the_origin_of_its_figure(
    figures: dict[str, Figure], one: Execution
) -> None:
    ax = figures["fig5d_zeno_point"].axes[0]
    (low, high), (slow, fast) = ax.get_xlim(), ax.get_ylim()
    assert low < 0.0 < high
    assert slow < 0.0 < fast
    # All rebounds are inside: the first leaves the stop at e times the speed of the first impact.
    assert fast > -0.2 * one.impacts[0].approach_rate
    (star,) = [line for line in ax.get_lines() if line.get_label() == "Zeno point"]
    assert [*star.get_xdata(), *star.get_ydata()] == [0.0, 0.0]


def test_the_impacts_are_seen_from_the_first_to_beyond_the_release(
    figures: dict[str, Figure], one: Execution, orbit: Orbit
) -> None:
    for ax in figures["fig5b_impacts"].axes:
        start, end = ax.get_xlim()
        assert start < one.impacts[0].time
        assert end > orbit.period
    wide, close = (np.ptp(ax.get_ylim()) for ax in figures["fig5b_impacts"].axes)
    assert close < wide / 5


def test_gaps_where_a_coordinate_is_missing_stay_gaps(
    problem: Problem, machine: HybridDynamics, one: Execution, other: MatchedRun
) -> None:
    holed = other.states.copy()
    holed[100:200, 1] = math.nan
    two = TwoMotions(
        problem=problem, dynamics=machine, model=one, other=replace(other, states=holed)
    )
    figure = plots.plot_beside_zeno_point(two)
    (line,) = [x for x in figure.axes[0].get_lines() if x.get_label() == other.label]
    assert np.isnan(line.get_xdata()).sum() == 100


# ---------------------------------------------------------------------------- the other motion


@pytest.fixture(scope="module")
def table(orbit: Orbit, problem: Problem) -> OrbitTable:
    return tabulate_orbit(orbit, problem, ("theta1", "theta2"))


@pytest.mark.parametrize("stretch", [1.0, 1.1, 0.93])
@pytest.mark.parametrize("start", [0.0, 0.3, 0.9])
def test_a_recording_is_laid_over_the_orbit_by_its_phase_in_its_own_time(
    problem: Problem, orbit: Orbit, table: OrbitTable, stretch: float, start: float
) -> None:
    # What a search over the orbit's own period alone cannot do: the recording's is another.
    noise = {"noise": 2e-3, "seed": 7}
    whole = recorded(table, problem, n_cycles=7.5, start=start, stretch=stretch, **noise)
    found = recording_counterpart(whole, orbit, problem, 3)
    assert found.label == "recording, simulated"
    # Some six cycles of 700 samples, two signals: 1e-4 s with noise of 2e-3, five times over.
    assert found.period == pytest.approx(stretch * orbit.period, abs=5e-4)
    # Times are those of the recording, three whole cycles of it, a sample more or less.
    length = 3 * stretch * orbit.period
    assert 0.0 <= found.times[0] < 3e-3
    assert found.times[-1] == pytest.approx(length, abs=6e-3)
    assert np.diff(found.times) == pytest.approx(1 / 400.0)
    there = table.at(found.times / (stretch * orbit.period))
    # Noise is 2e-3 of the range; a shift of 5e-4 s at up to 17 rad/s is 9e-3.
    miss = np.abs(found.states[:, :2] - there) / np.ptp(table.nodes.values, axis=0)
    assert np.median(miss) < 4e-3


@pytest.mark.slow
def test_the_figures_and_the_comparison_lay_a_recording_over_the_orbit_alike(
    problem: Problem, orbit: Orbit, table: OrbitTable
) -> None:
    from zeno_orbits.experiment import compare_recording

    # No longer than what the figures look at.
    whole = recorded(table, problem, n_cycles=7.5, stretch=1.02, noise=2e-3, seed=5)
    where = compare_recording(orbit, problem, whole).where
    assert where is not None
    found = recording_counterpart(whole, orbit, problem, 3)
    assert found.period == where.period
    # The first kept sample is the first one after a release.
    assert np.min(np.abs(np.mod(whole.time - where.release, where.period) - found.times[0])) < 1e-9


def test_a_start_that_still_settles_does_not_move_the_overlay(
    problem: Problem, orbit: Orbit, table: OrbitTable
) -> None:
    whole = recorded(table, problem, n_cycles=30.0)
    early = whole.time < whole.time[-1] / 2
    strange = tuple(
        replace(one, values=np.where(early, np.sin(3.0 * whole.time), one.values))
        for one in whole.signals
    )
    found = recording_counterpart(replace(whole, signals=strange), orbit, problem, 3)
    assert found.period == pytest.approx(orbit.period, abs=1e-4)
    there = table.at(found.times / found.period)
    assert np.median(np.abs(found.states[:, :2] - there)) < 2e-3


def test_over_the_phase_each_motion_has_its_own_period(
    problem: Problem,
    orbit: Orbit,
    machine: HybridDynamics,
    one: Execution,
    table: OrbitTable,
) -> None:
    whole = recorded(table, problem, n_cycles=7.5, stretch=1.1)
    found = recording_counterpart(whole, orbit, problem, 3)
    two = TwoMotions(problem=problem, dynamics=machine, model=one, other=found)
    figure = plots.plot_beside_by_phase(two)
    assert figure.axes[-1].get_xlabel() == "phase from release [own periods]"
    title = figure.axes[0].get_title()
    assert f"model {orbit.period:.5g} s" in title
    assert f"other {1.1 * orbit.period:.4g}" in title
    (line,) = [x for x in figure.axes[1].get_lines() if x.get_label() == found.label]
    x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    # Two pauses between three cycles, and no line from the right edge to the left.
    assert int(np.isnan(x).sum()) == 2
    seen = np.isfinite(x)
    assert np.all(np.diff(x)[seen[1:] & seen[:-1]] > 0.0)
    # In phase it is the model; in time it would be late by a tenth of a period.
    assert np.median(np.abs(y[seen] - table.at(x[seen])[:, 1])) < 2e-3


@pytest.mark.slow
def test_the_picture_of_a_comparison_is_by_phase_and_names_both_periods(
    problem: Problem, orbit: Orbit, table: OrbitTable
) -> None:
    from zeno_orbits.experiment import compare_recording

    found = compare_recording(
        orbit, problem, recorded(table, problem, n_cycles=6.0, stretch=1.1, noise=1e-3)
    )
    figure = plots.plot_comparison(problem, found)
    labels = [ax.get_xlabel() for ax in figure.axes]
    assert labels.count("phase from release [own periods]") == 2
    title = figure.axes[0].get_title()
    assert f"orbit {orbit.period:.6g} s" in title
    assert f"recording {1.1 * orbit.period:.4g}" in title
    assert _alike(figure) == []


def _turned(recording: Recording) -> Recording:
    signals = tuple(replace(one, values=-one.values) for one in recording.signals[:1])
    return replace(recording, signals=(*signals, *recording.signals[1:]))


def _noisy(recording: Recording) -> Recording:
    random = np.random.default_rng(3)
    signals = tuple(
        replace(one, values=random.normal(size=len(one.values))) for one in recording.signals
    )
    return replace(recording, signals=signals)


def _holed(recording: Recording) -> Recording:
    holes = np.full(len(recording.time), math.nan)
    return replace(
        recording, signals=tuple(replace(one, values=holes) for one in recording.signals)
    )


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda x: replace(x, signals=x.signals[:1]), "but `theta2` is missing"),
        (lambda x: crop_recording(x, None, 3.0), "must last two periods, 3.627 s, at least"),
        (_holed, "no signal of it has a number"),
        (_noisy, "Argument `data` must show an orbit of the problem, but"),
        (_turned, "but `theta1` looks like its sign reversed"),
        (lambda x: replace(x, time=1e3 * x.time), "seconds, correct its unit. See `compare`"),
    ],
)
def test_a_recording_that_cannot_be_laid_over_is_refused(
    problem: Problem, orbit: Orbit, table: OrbitTable, spoil: Any, said: str
) -> None:
    whole = recorded(table, problem, n_cycles=8.0)
    with pytest.raises(InputError, match=re.escape(said)):
        recording_counterpart(spoil(whole), orbit, problem, 2)


# ---------------------------------------------------------------------------- drawings


def test_the_pendulum_is_drawn_as_it_hangs(problem: Problem, orbit: Orbit) -> None:
    values = orbit.values(problem)
    first, second = values.parameters["L1"], values.parameters["L2"]
    states = np.array([[0.3, 0.5, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0, 0.0]])
    lines = problem.drawn_lines(values, states)
    for k, (theta1, theta2) in enumerate(states[:, :2]):
        knee = first * np.array([math.sin(theta1), -math.cos(theta1)])
        hand = theta1 + theta2
        tip = knee + second * np.array([math.sin(hand), -math.cos(hand)])
        assert lines["link 1"][k] == pytest.approx(np.array([[0.0, 0.0], knee]))
        assert lines["link 2"][k] == pytest.approx(np.array([knee, tip]))
        # On its stop link 2 goes on straight, and the stop is on the side that it cannot reach.
        along = knee / first
        for corner in lines["stop"][k][1:] - knee:
            assert along[0] * corner[1] - along[1] * corner[0] < 0.0


@pytest.mark.parametrize("name", ["motor_pendulum", "vibrating_table", "motor_cart"])
def test_problems_with_a_drawing_hold_together(name: str) -> None:
    assert load_problem(name).checked().drawing is not None


@pytest.mark.parametrize(
    ("drawing", "said"),
    [
        (lambda _x, _p: {}, "must contain a line"),
        (lambda x, _p: {"link": [(x["theta3"], 0)]}, "but it uses `theta3`"),
        (lambda _x, p: {"link": [(p["L9"], 0)]}, "but it uses `L9`"),
        (lambda x, _p: {"link": [(0, 0), (x["theta1"],)]}, "corners across and upwards"),
        (lambda _x, _p: {"link": []}, "corners across and upwards"),
        (lambda _x, _p: {"link": [(ca.SX.sym("z"), 0)]}, "another symbol, `z`"),
        (lambda _x, _p: {"link": [(ca.SX(2, 1), 0)]}, "two numbers"),
    ],
)
def test_a_drawing_that_cannot_be_is_refused_when_the_problem_is_checked(
    problem: Problem, drawing: Any, said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        replace(problem, drawing=drawing).checked()


def test_a_parameter_that_only_the_drawing_needs_is_used(problem: Problem) -> None:
    # Link 2's length appears in an output and in the drawing: either is enough, none is not.
    assert replace(problem, outputs=(), fidelities={}).checked()
    with pytest.raises(ValueError, match="`L2` appears nowhere"):
        replace(problem, outputs=(), drawing=None, fidelities={}).checked()


# ---------------------------------------------------------------------------- the machine in motion


@pytest.fixture(scope="module")
def film(problem: Problem, orbit: Orbit, one: Execution) -> plots.Film:
    return plots.film_of(problem, orbit.values(problem), one, orbit.period)


@pytest.mark.slow
def test_the_film_lasts_a_period_and_moves(film: plots.Film, orbit: Orbit) -> None:
    assert len(film.frames) / film.rate == pytest.approx(orbit.period, abs=0.5 / film.rate)
    stills = {frame.tobytes() for frame in film.frames}
    assert len(stills) == len(film.frames)
    assert len({frame.size for frame in film.frames}) == 1


@pytest.mark.slow
def test_nothing_but_the_machine_and_its_points_moves(film: plots.Film) -> None:
    # Labels and numbers of the axes, below them and on the left.
    first = np.asarray(film.frames[0])
    for frame in film.frames[1:]:
        here = np.asarray(frame)
        assert np.array_equal(here[-64:], first[-64:])
        assert np.array_equal(here[:, :64], first[:, :64])


@pytest.mark.slow
def test_both_portraits_have_a_moving_point(film: plots.Film) -> None:
    first, later = (np.asarray(film.frames[k]).astype(int) for k in (2, 18))
    changed = np.any(first != later, axis=2)
    # The right half, above and below its middle.
    right = changed[48:, changed.shape[1] * 6 // 10 :]
    half = len(right) // 2
    assert np.sum(right[:half]) > 50
    assert np.sum(right[half:]) > 50


@pytest.mark.slow
def test_a_problem_with_one_portrait_has_a_film_with_one(
    problem: Problem, orbit: Orbit, one: Execution
) -> None:
    single = replace(problem, portraits=problem.portraits[:1])
    film = plots.film_of(single, orbit.values(problem), one, orbit.period)
    assert film.frames[0].size == (1120, 608)


@pytest.mark.slow
def test_every_picture_of_the_gif_is_that_of_the_film(film: plots.Film) -> None:
    # Points that have not moved are not repeated: what is left must not stay behind.
    with Image.open(io.BytesIO(plots.gif_of(film))) as gif:
        for k, frame in enumerate(film.frames):
            gif.seek(k)
            seen = np.asarray(gif.convert("RGB"), dtype=float)
            off = np.max(np.abs(seen - np.asarray(frame, dtype=float)), axis=2)
            assert np.mean(off > 60) < 2e-3, k


@pytest.mark.slow
def test_the_gif_runs_round_with_all_its_pictures(film: plots.Film) -> None:
    data = plots.gif_of(film)
    with Image.open(io.BytesIO(data)) as gif:
        assert gif.n_frames == len(film.frames)
        assert gif.info["loop"] == 0
        assert gif.info["duration"] == 1000 // film.rate
        gif.seek(len(film.frames) // 2)
        seen = np.asarray(gif.convert("RGB"), dtype=float)
    true = np.asarray(film.frames[len(film.frames) // 2], dtype=float)
    # 63 colours for a picture that has few: hardly a point may be off by much.
    assert np.mean(np.abs(seen - true)) < 3.0
    assert len(data) < 1_000_000


@pytest.mark.slow
def test_the_colour_of_the_machine_tells_the_mode(film: plots.Film, orbit: Orbit) -> None:
    blue, orange = (0, 114, 178), (213, 94, 0)

    def count(frame: Image.Image, colour: tuple[int, int, int]) -> int:
        # Inside the axes of the machine, below the legend.
        left = np.asarray(frame)[80:, 96:480]
        return int(np.sum(np.all(left == colour, axis=2)))

    part = orbit.zeno_time / orbit.period
    flying, locked = film.frames[5], film.frames[int((part + 1) / 2 * len(film.frames))]
    assert count(flying, blue) > 100
    assert count(flying, orange) < 10
    assert count(locked, orange) > 100
    assert count(locked, blue) < 10


def test_a_problem_without_a_drawing_has_no_film(
    problem: Problem, orbit: Orbit, one: Execution
) -> None:
    bare = replace(problem, drawing=None)
    with pytest.raises(InputError, match="must have a drawing, but `motor_pendulum` lacks one"):
        plots.film_of(bare, orbit.values(problem), one, orbit.period)


@pytest.mark.skipif(not plots.has_ffmpeg(), reason="ffmpeg is not installed")
@pytest.mark.slow
def test_an_mp4_is_made_where_ffmpeg_is(film: plots.Film) -> None:
    assert plots.mp4_of(film)[4:8] == b"ftyp"


@pytest.mark.slow
def test_an_ffmpeg_that_fails_is_heard(
    film: plots.Film, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = tmp_path / "ffmpeg"
    fake.write_text("#!/bin/sh\ncat > /dev/null\necho 'no such encoder' >&2\nexit 3\n")
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(ZenoOrbitsError, match=r"ffmpeg made no film \(no such encoder\)"):
        plots.mp4_of(film)


# ---------------------------------------------------------------------------- the command


def test_the_command_offers_every_kind_there_is() -> None:
    _, told, _ = ask("figures", "--help-all")
    assert f"one of {', '.join(PAPER)}: the system" in " ".join(told.split())


@pytest.mark.usefixtures("parts")
@pytest.mark.weekly
@pytest.mark.slow
def test_one_command_writes_all_figures(orbit_file: Path) -> None:
    code, out, err = ask("figures", orbit_file, "-o", "new/figures")
    assert (code, err) == (YES, "")
    made = {path.name for path in Path("new/figures").iterdir()}
    wanted = {f"{name}.{kind}" for name in FIGURES for kind in ("pdf", "png")} | {"machine.gif"}
    assert made - {"machine.mp4"} == wanted
    assert all(f"new/figures/{name}" in out for name in made)
    for path in Path("new/figures").iterdir():
        data = path.read_bytes()
        assert data[:4] in (b"%PDF", b"\x89PNG", b"GIF8") or data[4:8] == b"ftyp"
    with Image.open("new/figures/region.png") as picture:
        # 3.4 in at 300 dots an inch.
        assert picture.size[0] == 1020


@pytest.mark.usefixtures("parts")
@pytest.mark.slow
def test_the_same_orbit_gives_the_same_bytes(orbit_file: Path) -> None:
    kinds = [word for kind in ("graph", "region", "portraits") for word in ("--kind", kind)]
    for folder in ("a", "b"):
        assert ask("figures", orbit_file, "-o", folder, *kinds)[0] == YES
    for path in Path("a").iterdir():
        assert path.read_bytes() == (Path("b") / path.name).read_bytes()


@pytest.mark.usefixtures("parts")
@pytest.mark.slow
def test_a_recording_takes_the_place_of_the_rig(
    orbit_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"{COUNTERPARTS}.settle_rig", None)
    Path("run.csv").touch()
    seen: list[MatchedRun] = []
    draw = plots.plot_beside_portraits

    def look(two: TwoMotions) -> Figure:
        seen.append(two.other)
        return draw(two)

    monkeypatch.setattr("zeno_orbits.report.plots.paper_figures.plot_beside_portraits", look)
    answer = ask("figures", orbit_file, "-o", "f", "--kind", "beside", "--recording", "run.csv")
    assert answer[0] == YES, answer
    assert [one.label for one in seen] == ["recording, measured"]
    assert len(list(Path("f").iterdir())) == 10


@pytest.mark.slow
def test_what_a_problem_does_not_have_is_said_and_left_out(
    orbit_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def still(*_: Any, **__: Any) -> Any:
        raise SimulationError("The rig does not move in cycles", time=1.0, state=(0.0,))

    monkeypatch.setattr(f"{COUNTERPARTS}.settle_rig", still)
    # A film without ffmpeg, and nothing that takes long.
    monkeypatch.setitem(PAPER, "animation", lambda _: {"machine.gif": b"GIF8"})
    monkeypatch.setitem(PAPER, "region", lambda _: {})
    code, out, _ = ask("figures", orbit_file, "-o", "f", "--json")
    assert code == YES
    left_out = json.loads(out)["left_out"]
    assert left_out["beside"] == "The rig does not move in cycles (at t = 1 s)"
    assert left_out["machine.mp4"] == "ffmpeg is not installed"
    assert "fig4_portraits.pdf" in {path.name for path in Path("f").iterdir()}
    # Asked for by name, it has to be there.
    code, _, err = ask("figures", orbit_file, "-o", "g", "--kind", "beside")
    assert code == NO
    assert "does not move in cycles" in err
    assert not Path("g").exists()


@pytest.mark.slow
def test_a_problem_is_searched_at_its_own_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, _ = ask("figures", "forced_oscillator", "-o", "f", "--kind", "portraits")
    assert code == YES
    assert "fig4_portraits.png" in out
    code, _, err = ask("figures", "bouncing_ball", "-o", "none")
    assert code == NO
    assert err.count("\n") == 1
    assert not Path("none").exists()


BESIDE = ("orbit.json", "-o", "f", "--kind", "graph", "--kind", "beside")


@pytest.mark.usefixtures("parts")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("orbit.json", "-o", "orbit.json"), "must be a folder, but `orbit.json` is a file"),
        (("orbit.json", "-o", "orbit.json/a"), "must be a folder that can be made"),
        (("none.json", "-o", "f"), "Orbit file `none.json` cannot be read"),
        (("no_scene", "-o", "f"), "unknown problem `no_scene`"),
        (("motor_pendulum", "--problem", "a.py", "-o", "f"), "must come with an orbit file"),
        (("orbit.json", "-o", "f", "--kind", "graph", "--recording", "a.csv"), "the kind `beside`"),
        ((*BESIDE, "--recording", "a.csv"), "Data file `a.csv`: it is missing"),
        (("orbit.json", "-o", "f", "--kind", "film"), "--kind: unknown name `film`. Known: graph"),
        (("orbit.json",), "Missing: -o/--output"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(
    orbit_file: Path, arguments: tuple[str, ...], said: str
) -> None:
    code, out, err = ask("figures", *arguments)
    assert (code, out) == (MISUSE, "")
    assert said in err
    assert err.count("\n") == 1
    assert [path.name for path in orbit_file.parent.iterdir()] == ["orbit.json"]


@pytest.mark.slow
def test_a_film_that_was_asked_for_needs_a_drawing(orbit_file: Path, problem: Problem) -> None:
    bare = orbit_file.with_name("bare.py")
    bare.write_text(
        "from dataclasses import replace\n"
        "import zeno_orbits as zo\n"
        f"PROBLEM = replace(zo.load_problem({problem.name!r}), drawing=None)\n"
    )
    asked = ("figures", orbit_file, "--problem", bare, "-o", "f")
    code, _, err = ask(*asked, "--kind", "animation")
    assert code == MISUSE
    assert "must have a drawing" in err
    code, out, _ = ask(*asked, "--kind", "graph")
    assert code == YES
    assert "machine" not in out


def test_an_orbit_without_a_zeno_point_is_refused(orbit_file: Path, orbit: Orbit) -> None:
    write_orbit(replace(orbit, period=0.5 * orbit.zeno_time), orbit_file)
    code, _, err = ask("figures", orbit_file, "-o", "f")
    assert code == MISUSE
    assert "must reach a Zeno point, but its period" in err


@pytest.mark.usefixtures("parts")
@pytest.mark.slow
def test_the_examples_of_the_help_run(orbit_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert orbit_file.exists()
    # The first example is run in full by `test_one_command_writes_all_figures`.
    for kind in ("animation", "beside"):
        monkeypatch.setitem(
            PAPER, kind, lambda material: {"a.png": material.other().label.encode()}
        )
    Path("recording.csv").touch()
    _, out, _ = ask("figures", "--help-all")
    examples = out.partition("examples:")[2].replace("\\\n", " ")
    lines = [line for line in examples.splitlines() if line.strip()]
    assert len(lines) == 3
    for line in lines:
        words = shlex.split(line)
        assert words[:2] == ["zeno-orbits", "figures"]
        assert ask(*words[1:])[0] == YES


@pytest.mark.weekly
@pytest.mark.slow
def test_the_real_rig_lies_near_the_model(orbit: Orbit, problem: Problem) -> None:
    found = rig_counterpart(orbit, problem, 2)
    assert found.label == "virtual rig, simulated"
    assert found.times[0] == pytest.approx(0.0, abs=1e-3)
    # Its period is within a per cent or so of the model's, and so two of them are.
    assert found.times[-1] == pytest.approx(2 * orbit.period, rel=0.02)
    assert np.all(np.diff(found.times) > 0.0)
    assert np.all(np.isfinite(found.states))


# ---------------------------------------------------------------------------- whole or not at all


@pytest.fixture(name="broken")
def _broken(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A disk that takes one file and no more."""
    write, written = Path.write_bytes, []

    def fail(path: Path, data: bytes) -> int:
        if written:
            raise OSError(28, "No space left on device")
        written.append(path)
        return write(path, data)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", fail)
        yield


@pytest.mark.usefixtures("broken")
def test_a_disk_that_fills_up_leaves_the_old_figures(tmp_path: Path) -> None:
    folder = tmp_path / "figures"
    folder.mkdir()
    with (folder / "a.png").open("wb") as file:
        file.write(b"old")
    with pytest.raises(InputError, match="No space left on device"):
        write_all(folder, {"a.png": b"new", "b.png": b"new"})
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {"a.png": b"old"}


def test_a_file_that_cannot_be_put_in_place_takes_the_others_back(tmp_path: Path) -> None:
    folder = tmp_path / "figures"
    folder.mkdir()
    (folder / "a.png").write_bytes(b"old")
    real, moved = shutil.move, []

    def fail(path: Path, target: Path) -> Path:
        if path.parent.name == "new":
            moved.append(path.name)
            if len(moved) == 3:
                raise OSError(28, "No space left on device")
        return real(path, target)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shutil, "move", fail)
        with pytest.raises(InputError, match="No space left on device"):
            write_all(folder, {"a.png": b"new", "b.png": b"new", "c.png": b"new"})
    # Two of three were in place already.
    assert moved == ["a.png", "b.png", "c.png"]
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {"a.png": b"old"}


def test_a_folder_in_the_place_of_a_file_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "b.png").mkdir()
    (tmp_path / "b.png" / "mine").write_bytes(b"mine")
    (tmp_path / "c.png").write_bytes(b"old")
    write_all(tmp_path, {"c.png": b"new"})
    with pytest.raises(InputError, match=r"must be a file, but `.*b\.png` is a folder"):
        write_all(tmp_path, {"a.png": b"new", "b.png": b"new", "c.png": b"newer"})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b.png", "c.png"]
    assert (tmp_path / "b.png" / "mine").read_bytes() == b"mine"
    assert (tmp_path / "c.png").read_bytes() == b"new"


@pytest.mark.slow
@pytest.mark.usefixtures("parts")
@pytest.mark.parametrize(
    ("command", "drawn"),
    [("plot", "plot_zeno_neighbourhood"), ("figures", "paper_figures.plot_beside_portraits")],
)
def test_a_picture_that_fails_in_the_middle_leaves_none(
    orbit_file: Path, monkeypatch: pytest.MonkeyPatch, command: str, drawn: str
) -> None:
    calls: list[str] = []

    def fail(*_: Any, **__: Any) -> Figure:
        calls.append(drawn)
        raise InputError("Argument `width` must be drawn, but it is not.")

    monkeypatch.setattr(f"zeno_orbits.report.plots.{drawn}", fail)
    kinds = ("--kind", "portraits", "--kind", "zeno" if command == "plot" else "beside")
    code, _, err = ask(command, orbit_file, *kinds, "-o", "f")
    assert (code, calls) == (MISUSE, [drawn])
    assert "must be drawn" in err
    assert not Path("f").exists()


def test_files_are_written_all_and_others_left_alone(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "figures"
    write_all(folder, {"a": b"1", "b": b"2"})
    write_all(folder, {"b": b"3"})
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {"a": b"1", "b": b"3"}
    assert (folder / "a").stat().st_mode & 0o777 == 0o644
