"""Recordings by contact channels alone of a mass that bounces between two walls without resting.

One turn of the clock has three impacts on the left wall and one on the right one. Contacts of a
given duration begin at the impacts of a simulation.
"""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.one_mass import Motion, one_mass
from zeno_orbits.experiment import (
    Comparison,
    ComparisonVerdict,
    RecordedSignal,
    Recording,
    Source,
    compare_recording,
)

WALLS = ("left", "right")
THREE = {"omega": 2.17, "A": 1.32, "d": 0.02, "e": 0.31}
ONE = {"omega": 2.17, "A": 1.58, "d": 0.6, "e": 0.89}


def _force(m: Motion) -> ca.SX:
    return m.p["A"] * m.cosine - m.x - 0.1 * m.v


def _stops(m: Motion) -> tuple[zo.Stop, ...]:
    places = (m.x + m.p["d"], 0.4 - m.x)
    return tuple(
        zo.Stop(name=name, gap=gap, restitution=m.p["e"])
        for name, gap in zip(WALLS, places, strict=True)
    )


PROBLEM = one_mass(
    _force,
    stops=_stops,
    start={"x": 0.1, "v": 0.0, "cosine": 1.0},
    omega=2.17,
    A=1.32,
    d=0.02,
    e=0.31,
)


@cache
def _orbit(one: bool) -> zo.Orbit:
    return zo.find_orbit(PROBLEM, parameters=ONE if one else THREE).unwrap()


def _recording(step: float, duration: float, *, one: bool = False) -> Recording:
    """Return the channels of both walls over twelve periods, with contacts of a duration [s]."""
    orbit = _orbit(one)
    until = 13.0 * orbit.period
    motion = zo.simulate(PROBLEM, start=orbit.start_state, until=until, parameters=orbit.parameters)
    time = np.arange(0.3 * orbit.period, 12.3 * orbit.period, step)
    signals: list[RecordedSignal] = []
    for name in WALLS:
        begins = np.array([impact.time for impact in motion.impacts if impact.stop == name])
        late = np.subtract.outer(time, begins)
        closed = np.any((late >= 0.0) & (late < duration), axis=1)
        signals.append(
            RecordedSignal(name=f"contact.{name}", unit="1", values=closed.astype(float))
        )
    return Recording(source=Source.SIMULATED, problem="one_mass", time=time, signals=tuple(signals))


def _compared(recording: Recording) -> Comparison:
    return compare_recording(_orbit(False), PROBLEM, recording)


def test_the_orbits_have_three_impacts_and_one_on_the_left_wall() -> None:
    counts = [[_orbit(one).sequence.count(f"impact {name}") for name in WALLS] for one in (0, 1)]
    assert counts == [[3, 1], [1, 1]]


@pytest.mark.parametrize("seconds", [0.02, 0.05])
def test_impacts_at_unlike_intervals_on_one_wall_show_the_orbit(seconds: float) -> None:
    found = _compared(_recording(0.0097, seconds))
    assert found.verdict is ComparisonVerdict.THIS_ORBIT, found


@pytest.mark.slow
@pytest.mark.parametrize("one", [False, True])
@pytest.mark.parametrize("samples", [9, 17.37, 60.37])
def test_contacts_shorter_than_a_sample_decide_nothing(samples: float, one: bool) -> None:
    step = _orbit(one).period / samples
    for part in (0.02, 0.5, 0.95):
        found = _compared(_recording(step, part * step, one=one))
        assert found.verdict is ComparisonVerdict.UNDECIDED, (part, found)
        assert "shorter ones may be missed" in found.unresolved[0]


@pytest.mark.parametrize("seconds", [0.02, 0.05])
def test_another_number_of_impacts_is_not_this_orbit(seconds: float) -> None:
    assert not _compared(_recording(0.0097, seconds, one=True)).agrees


def test_flights_that_a_contact_hides_decide_nothing() -> None:
    """The shortest flight of the orbit lasts 0.27 s."""
    found = _compared(_recording(0.0097, 0.3))
    assert found.verdict is ComparisonVerdict.UNDECIDED, found


def test_sequences_whose_flights_are_longer_than_those_between_them_decide_nothing() -> None:
    """A ball on a shaken table: it rests once in several turns, between bounces of all lengths."""
    parameters = {"omega": 2.095, "A": 3.243, "e": 0.526}
    table = one_mass(
        lambda m: m.p["A"] * m.cosine - 1 - 0.05 * m.v,
        stops=lambda m: (zo.Stop(name="floor", gap=m.x, restitution=m.p["e"]),),
        start={"x": 0.3, "v": 0.0, "cosine": 1.0},
        omega=parameters["omega"],
        A=parameters["A"],
        e=parameters["e"],
    )
    orbit = zo.find_orbit(table).unwrap()
    begins = [event.time for event in orbit.events if event.name == "impact floor"]
    assert np.max(np.diff(np.diff(begins))) > 1.0
    motion = zo.simulate(table, start=orbit.start_state, until=9.0 * orbit.period)
    time = np.arange(0.3 * orbit.period, 8.3 * orbit.period, 0.05)
    closed = np.zeros_like(time)
    for arc in motion.arcs:
        if arc.closed:
            closed[(time >= arc.start_time) & (time < arc.end_time)] = 1.0
    for impact in motion.impacts:
        closed[(time >= impact.time) & (time < impact.time + 0.12)] = 1.0
    signal = RecordedSignal(name="contact", unit="1", values=closed)
    recording = Recording(source=Source.SIMULATED, problem="one_mass", time=time, signals=(signal,))
    found = compare_recording(orbit, table, recording)
    assert found.verdict is ComparisonVerdict.UNDECIDED, found
    assert "cannot be divided into sequences" in found.unresolved[0]


TABLE = one_mass(
    lambda m: m.p["A"] * m.cosine - 1 - 0.05 * m.v,
    stops=lambda m: (zo.Stop(name="floor", gap=m.x, restitution=m.p["e"]),),
    start={"x": 0.0, "v": 0.0, "cosine": 1.0},
    omega=1.0,
    A=1.6,
    e=0.5,
)
"""A ball on a shaken table that rests once per turn: its bounces last 0.83, 0.48, 0.29 s, ..."""


@cache
def _resting(samples: float, part: float) -> Comparison:
    """Return the comparison of a channel whose bounces are contacts of `part` sampling times."""
    orbit = zo.find_orbit(TABLE).unwrap()
    step = orbit.period / samples
    motion = zo.simulate(TABLE, start=orbit.start_state, until=13.0 * orbit.period)
    time = np.arange(0.3 * orbit.period, 12.3 * orbit.period, step)
    closed = np.zeros_like(time)
    for arc in motion.arcs:
        if arc.closed:
            closed[(time >= arc.start_time) & (time < arc.end_time)] = 1.0
    for impact in motion.impacts:
        closed[(time >= impact.time) & (time < impact.time + part * step)] = 1.0
    signal = RecordedSignal(name="contact", unit="1", values=closed)
    recording = Recording(source=Source.SIMULATED, problem="one_mass", time=time, signals=(signal,))
    return compare_recording(orbit, TABLE, recording)


@pytest.mark.parametrize("samples", [60.0, 61.37, 90.5])
@pytest.mark.parametrize("part", [0.05, 0.5, 0.95])
def test_a_first_contact_that_samples_may_miss_has_no_time_and_doubles_no_period(
    samples: float, part: float
) -> None:
    """Sampling at 60 and 90.5 samples per period misses the same contacts in every cycle or two."""
    found = _resting(samples, part)
    assert found.verdict is ComparisonVerdict.UNDECIDED, found
    for name in ("impact_time", "zeno_time", "release_time"):
        assert np.isnan(found.metric(f"floor.{name}").data)
    assert np.isnan(found.metric("period").data)


@pytest.mark.parametrize("samples", [60.0, 61.37, 90.5])
def test_a_first_contact_of_three_samples_has_its_time(samples: float) -> None:
    found = _resting(samples, 3.0)
    assert not found.reasons
    for name in ("period", "floor.impact_time", "floor.zeno_time", "floor.release_time"):
        one = found.metric(name)
        assert abs(one.data - one.orbit) < 3 * one.error, name
    assert found.metric("period").error < 0.01
