"""Executions put together by hand: which arc and which state a time belongs to."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.support.made_arcs import START, UNIT, ramp
from zeno_orbits.simulation import Arc, Ending, Execution, Impact, Mode, Release, ZenoPoint


def marked(arc: Arc) -> Arc:
    """The same with ends that its flow does not have."""
    return replace(arc, start_state=np.array([-1.0]), end_state=np.array([-2.0]))


def impact(time: float) -> Impact:
    return Impact(
        time=time,
        state_minus=np.array([time]),
        state_plus=np.array([time + 0.5]),
        approach_rate=-1.0,
    )


def zeno(time: float) -> ZenoPoint:
    return ZenoPoint(
        time=time, state=np.array([time + 0.25]), limit_error=0.0, tail=0.1, last_speed=0.2
    )


def release(time: float) -> Release:
    return Release(time=time, state=np.array([time + 0.75]))


@pytest.fixture(name="run")
def _run() -> Execution:
    """Arcs over [1, 3], [3, 3], [3, 7] and [7, 8] with an event at the end of each."""
    arcs = (
        marked(ramp(0.0, 1.0, start=1.0)),
        replace(ramp(0.0, 0.0, start=3.0), trajectory=None, start_state=np.array([30.0])),
        replace(marked(ramp(0.0, 0.5, 2.0, start=3.0)), mode=Mode.LOCKED),
        ramp(0.0, 0.5, start=7.0),
    )
    return Execution(state_names=("own",), arcs=arcs, events=(impact(3.0), zeno(3.0), release(7.0)))


def test_a_time_inside_an_arc_has_the_state_of_its_flow_and_the_ends_their_own() -> None:
    arc = marked(ramp(0.0, 1.0, 8.0))
    times = (START - 1.0, START, START + 1e-9, START + 6.0, START + 16.0 - 1e-9, START + 16.0, 99.0)
    states = [float(arc.state_at(time)[0]) for time in times]
    assert states == pytest.approx([-1.0, -1.0, 0.5e-9, 3.0, 8.0 - 0.5e-9, -2.0, -2.0], abs=1e-15)
    assert all(arc.state_at(time).shape == (1,) for time in times)


def test_a_tail_without_a_flow_is_a_line_between_its_ends() -> None:
    tail = replace(marked(ramp(0.0, 8.0)), trajectory=None)
    assert float(tail.state_at(START + 4.0)[0]) == pytest.approx(-1.25, rel=1e-15)
    steep = replace(tail, end_state=np.array([7.0]))
    assert float(steep.state_at(START + 4.0)[0]) == pytest.approx(1.0, rel=1e-15)
    assert tail.duration == 8.0
    assert tail.flow_times.tolist() == [0.0, 8.0]
    assert tail.flow_states.tolist() == [[-1.0], [-2.0]]
    with pytest.raises(ValueError, match="tail"):
        tail.flow_state_at(1.0)


def test_an_arc_with_a_flow_has_its_duration_and_its_steps() -> None:
    # Late, the time of its end is rounded; its duration is not.
    arc = ramp(0.0, 1e-9, 3e-9, start=1e9)
    assert arc.end_time == arc.start_time
    assert arc.duration == 3e-9
    assert arc.flow_times.tolist() == [0.0, 1e-9, 3e-9]
    assert arc.flow_states.tolist() == [[0.0, 99.0], [1e-9, 99.0], [3e-9, 99.0]]
    assert arc.flow_state_at(2e-9).tolist() == [2e-9, 99.0]


def test_samples_stand_close_at_the_ends_and_leave_out_no_step() -> None:
    steps = (0.0, 0.3, 1.1, 7.9, 8.0)
    arc = marked(ramp(*steps))
    times, states = arc.sampled(9)
    # Half a turn of a circle in eight equal parts, seen from the side, and three steps between.
    circle = [START + 16.0 * (1 - math.cos(math.pi * k / 8)) / 2 for k in range(9)]
    expected = sorted([*circle, *(START + UNIT * step for step in steps[1:-1])])
    assert times == pytest.approx(expected, rel=1e-14)
    assert states.shape == (12, 1)
    assert states[1:-1, 0] == pytest.approx((times[1:-1] - START) / UNIT, rel=1e-12)
    assert (states[0, 0], states[-1, 0]) == (-1.0, -2.0)
    assert times[-1] == arc.end_time
    assert len(ramp(0.0, 8.0).sampled()[0]) == 150


def test_a_time_at_which_arcs_meet_belongs_to_the_last_of_them(run: Execution) -> None:
    states = [float(run.state_at(time)[0]) for time in (1.0, 2.0, 3.0, 4.0, 7.0, 7.5, 8.0)]
    assert states == [-1.0, 0.5, -1.0, 0.5, 0.0, 0.25, 0.5]
    assert run.end_time == 8.0
    assert run.end_state.tolist() == [0.5]
    for outside in (0.999, 8.001):
        with pytest.raises(ValueError, match=rf"\[1, 8\].* {outside:g}"):
            run.state_at(outside)


def test_an_execution_is_sampled_arc_by_arc(run: Execution) -> None:
    times, states = run.sampled(5)
    # Three arcs of five samples, one of them with a step more, and one of no time.
    assert len(times) == len(states) == 5 + 1 + 6 + 5
    assert np.all(np.diff(times) >= 0.0)
    assert (times[0], times[-1]) == (1.0, 8.0)
    assert len(run.sampled()[0]) == 3 * 150 + 1 + 1


def test_events_are_told_apart(run: Execution) -> None:
    assert [one.time for one in run.impacts] == [3.0]
    assert [one.time for one in run.zeno_points] == [3.0]
    assert [one.time for one in run.releases] == [7.0]
    assert repr(run) == (
        "<Execution of own from 1 to 8 s: arcs=4, impacts=1, zeno_points=1, releases=1>"
    )
    assert "without arcs" in repr(Execution(state_names=("own",), arcs=(), events=()))


def test_a_release_at_the_start_is_no_return(run: Execution) -> None:
    events = tuple(release(time) for time in (0.0, 1e-6, 1.1e-6, 5.0))
    found = replace(run, events=events).returns(1.0)
    assert [one.time for one in found] == [1.1e-6, 5.0]
    assert [one.time for one in replace(run, events=events).returns(2.0)] == [5.0]


def test_tables_have_a_row_a_sample_and_a_row_an_event(run: Execution) -> None:
    table = run._columns()
    times, states = run.sampled()
    assert np.asarray(table["time"]).tolist() == times.tolist()
    assert np.asarray(table["own"]).tolist() == states[:, 0].tolist()
    counts = [150, 1, 151, 150]
    assert np.asarray(table["arc"]).tolist() == np.repeat(np.arange(4), counts).tolist()
    modes = ["free", "free", "locked", "free"]
    assert list(table["mode"]) == np.repeat(modes, counts).tolist()
    shown = run._shown_columns()
    assert {name: list(column) for name, column in shown.items()} == {
        "time": [3.0, 3.0, 7.0],
        "event": ["impact", "Zeno point", "release"],
        "own": [3.5, 3.25, 7.75],
    }


def test_words_for_endings_and_modes_are_words_and_an_arc_is_shown_without_its_steps() -> None:
    words = [one.value for kind in (Ending, Mode) for one in kind]
    assert all(word.replace(" ", "").isalpha() for word in words)
    assert "trajectory" not in repr(ramp(0.0, 8.0))
