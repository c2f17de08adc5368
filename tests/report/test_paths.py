"""Arcs as curves: smooth wherever they bend, whatever steps the integrator took."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from zeno_orbits.arrays import Vector
from zeno_orbits.report.paths import drawn_paths
from zeno_orbits.report.plots import COLUMN_WIDTH, FULL_WIDTH, plot_states
from zeno_orbits.simulation import Arc, Ending, Execution, Impact, Mode


@dataclass(frozen=True, kw_only=True)
class Sine:
    """A flow along a sine and a thin layer, known to its last bit at every time.

    Attributes:
        duration: Of the leg [s].
        step: Length of its steps.
    """

    duration: float
    step: float

    @property
    def times(self) -> Vector:
        return np.append(np.arange(0.0, self.duration, self.step), self.duration)

    @property
    def states(self) -> Vector:
        return np.array([self.state_at(time) for time in self.times.tolist()])

    def state_at(self, offset: float) -> Vector:
        return np.array([math.sin(offset), math.exp(-offset / 1e-2)])

    def states_at(self, offsets: Vector) -> Vector:
        return np.column_stack([np.sin(offsets), np.exp(-offsets / 1e-2)])


def run_of(*durations: float, step: float, impacts: int = 0) -> Execution:
    """Return an execution of one sine after the other, with impacts at even times."""
    arcs: list[Arc] = []
    start = 0.0
    for duration in durations:
        flow = Sine(duration=duration, step=step)
        arcs.append(
            Arc(
                mode=Mode.FREE,
                start_time=start,
                end_time=start + duration,
                start_state=flow.state_at(0.0),
                end_state=flow.state_at(duration),
                ending=Ending.HORIZON,
                impact_index=0,
                time_unit=1.0,
                trajectory=flow,
            )
        )
        start += duration
    state = np.zeros(2)
    events = tuple(
        Impact(time=float(time), state_minus=state, state_plus=state, approach_rate=-1.0)
        for time in np.linspace(0.0, start, impacts)
    )
    return Execution(state_names=("x", "layer"), arcs=tuple(arcs), events=events)


@pytest.mark.parametrize("step", [0.1, 1.0, 4.0])
@pytest.mark.parametrize("duration", [3.0, 2000.0])
def test_a_sine_is_drawn_as_a_sine_however_long_and_coarse(duration: float, step: float) -> None:
    (path,) = drawn_paths(run_of(duration, step=step))
    fine = np.linspace(0.0, duration, 50_000)
    drawn = np.interp(fine, path.times, path.states[:, 0])
    # A chord that was left has its middle within 1e-4 of the range, which is 2, and is a parabola.
    assert np.max(np.abs(drawn - np.sin(fine))) < 3e-4
    # Some two hundred points a turn, and no more: what is drawn must not weigh.
    assert len(path.times) < 400 * (1 + duration / (2 * math.pi))
    corners = np.abs(np.diff(np.diff(path.states[:, 0]) / np.diff(path.times)))
    # A corner turns the line by less than four degrees.
    assert np.max(corners) < math.radians(4.0)


def test_a_layer_thinner_than_any_step_is_drawn() -> None:
    (path,) = drawn_paths(run_of(3.0, step=0.5))
    inside = path.times < 0.05
    assert np.count_nonzero(inside) > 10
    fine = np.linspace(0.0, 0.1, 1000)
    drawn = np.interp(fine, path.times, path.states[:, 1])
    assert np.max(np.abs(drawn - np.exp(-fine / 1e-2))) < 2e-3


def test_points_stand_where_the_flow_was_at_their_times() -> None:
    (path,) = drawn_paths(run_of(7.0, step=1.0))
    assert np.all(np.diff(path.times) > 0.0)
    assert path.states[:, 0].tolist() == [math.sin(time) for time in path.times.tolist()]


@pytest.mark.parametrize("width", [COLUMN_WIDTH, FULL_WIDTH])
def test_a_long_run_is_drawn_as_the_range_that_it_covers(width: float) -> None:
    figure = plot_states(run_of(1000.0, 1000.0, step=1.0, impacts=5000), width=width)
    ax = figure.axes[0]
    (band,) = [one for one in ax.collections if isinstance(one, PolyCollection)]
    low, high = np.asarray(band.get_paths()[0].vertices).T[1].min(), 1.0
    assert low == pytest.approx(-1.0, abs=1e-3)
    assert _highest(band) == pytest.approx(high, abs=1e-3)
    # Neither curves nor five thousand ticks, and no word of them.
    assert not [line for line in ax.lines if len(np.ravel(line.get_xdata()))]
    assert _words(figure) == ["range of the motion", "free arc"]


def _highest(band: PolyCollection) -> float:
    return float(np.asarray(band.get_paths()[0].vertices).T[1].max())


def _words(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_short_run_is_drawn_as_a_curve_with_its_impacts() -> None:
    figure = plot_states(run_of(30.0, step=1.0, impacts=4))
    assert _words(figure) == ["free arc", "impact"]
    assert not [one for one in figure.axes[0].collections if isinstance(one, PolyCollection)]
