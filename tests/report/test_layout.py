"""Pictures leave no place of a row empty, and their labels are whole and apart."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import cache

import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import zeno_orbits as zo
from tests.support.disturbances import pushes_of
from zeno_orbits.report import plots
from zeno_orbits.report.plots import COLUMN_WIDTH, FULL_WIDTH
from zeno_orbits.simulation import Execution

MACHINES = {
    # One stop; no contact; a long name; switches; several stops.
    "motor_pendulum": 4.0,
    "impact_oscillator": 20.0,
    "motor_cart": 3.0,
    "limited_pendulum": 4.0,
    "relay": 0.08,
}


@cache
def _motion(name: str) -> tuple[zo.Problem, Execution]:
    problem = zo.load_problem(name)
    return problem, zo.simulate(problem, until=MACHINES[name])


def _of_machine(name: str, width: float) -> list[Figure]:
    problem, execution = _motion(name)
    values = problem.values()
    dynamics = (problem.graph_dynamics if problem.has_graph else problem.dynamics)(values)
    figures = [
        plots.plot_portraits(problem, execution, width=width),
        plots.plot_time_series(problem, execution, width=width),
    ]
    if execution.zeno_points:
        figures.append(plots.plot_zeno_neighbourhood(problem, execution, dynamics, width=width))
    if problem.outputs:
        figures.append(plots.plot_outputs(problem, values, execution, width=width))
    return figures


def _empty_places(figure: Figure) -> list[tuple[int, int]]:
    """Return row and column of the places in the grid of a figure without a panel."""
    spans = [spec for ax in figure.axes if (spec := ax.get_subplotspec()) is not None]
    rows, columns = spans[0].get_gridspec().get_geometry()
    taken = {(row, column) for one in spans for row in one.rowspan for column in one.colspan}
    return [(r, c) for r in range(rows) for c in range(columns) if (r, c) not in taken]


def _faults(figure: Figure) -> list[str]:
    """Return the labels of axes that overlap another label or leave the figure."""
    figure.savefig(io.BytesIO(), format="png")
    renderer = FigureCanvasAgg(figure).get_renderer()

    def labels(ax: Axes) -> list[str]:
        return [axis.label for axis in (ax.xaxis, ax.yaxis) if axis.label.get_text()]

    texts = [label for ax in figure.axes for label in labels(ax)]
    boxes = [(one.get_text(), one.get_window_extent(renderer)) for one in texts]
    faults = [
        f"{text} leaves the figure"
        for text, box in boxes
        if not (
            figure.bbox.padded(1).contains(*box.min) and figure.bbox.padded(1).contains(*box.max)
        )
    ]
    for k, (text, box) in enumerate(boxes):
        faults += [f"{text} overlaps {other}" for other, o in boxes[k + 1 :] if box.overlaps(o)]
    return faults


@pytest.mark.slow
@pytest.mark.parametrize("width", [COLUMN_WIDTH, FULL_WIDTH])
@pytest.mark.parametrize("name", MACHINES)
def test_rows_are_full_and_labels_are_whole(name: str, width: float) -> None:
    for figure in _of_machine(name, width):
        assert _empty_places(figure) == []
        assert _faults(figure) == []


@pytest.mark.parametrize("n", [1, 2, 4, 5, 7])
def test_pushes_of_any_number_of_directions_leave_no_empty_place(orbit: zo.Orbit, n: int) -> None:
    directions = [{"theta1": 1.0, "theta2": float(k)} for k in range(n)]
    figure = plots.plot_pushes(pushes_of(orbit, directions=directions))
    assert len(figure.axes) == n
    assert _empty_places(figure) == []


def _too_long(figure: Figure) -> None:
    figure.axes[0].set_ylabel("the rate of an angle with a very long name [rad/s]")


def _at_the_edge(figure: Figure) -> None:
    figure.set_layout_engine("none")
    figure.axes[0].yaxis.set_label_coords(-0.6, 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [_too_long, _at_the_edge])
def test_the_check_of_labels_finds_a_fault(spoil: Callable[[Figure], None]) -> None:
    problem, execution = _motion("motor_pendulum")
    figure = plots.plot_time_series(problem, execution)
    assert _faults(figure) == []
    spoil(figure)
    assert _faults(figure) != []


def test_the_check_of_rows_finds_an_empty_place() -> None:
    figure = Figure()
    for k in range(5):
        figure.add_subplot(3, 2, k + 1)
    assert _empty_places(figure) == [(2, 1)]


def test_ticks_are_labelled_above_a_panel_of_another_width() -> None:
    problem, execution = _motion("motor_pendulum")
    figure = plots.plot_time_series(problem, execution)
    told = [ax.xaxis.get_tick_params()["labelbottom"] for ax in figure.axes]
    # Five states: two rows of two panels, and a row of one.
    assert told == [False, False, True, True, True]
    assert [bool(ax.get_xlabel()) for ax in figure.axes] == [False] * 4 + [True]
