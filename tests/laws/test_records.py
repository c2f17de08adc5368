"""Measured inputs over time: closed forms, another integrator, cost, files and refusals.

An oscillator ``x'' + c x' + x = u`` under a piecewise linear input follows a matrix exponential of
``(x, v, u, u')`` from sample to sample.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.linalg import expm

import zeno_orbits as zo
from tests.loop.agreement import followed as plainly
from tests.loop.agreement import looped, needs_compiler
from tests.reference.rocking_by_hand import rocking_by_hand
from tests.support.same_bits import agreed
from tests.support.tabled import FLOW, followed, moved, oscillator, under
from zeno_orbits.errors import ChatterError, DataFileError, InputError
from zeno_orbits.simulation import SimulationSettings, SimulationTask

EXACT = 1e-12
EVENT = 1e-8
"""Of the times of events of a rocking block, which bounces until it rests."""


@pytest.mark.parametrize("n", [2, 11, 161])
def test_an_oscillator_follows_a_record_and_its_ends(n: int) -> None:
    times, inputs = np.linspace(1.0, 9.0, n), np.random.default_rng(n).normal(size=n)
    run = zo.simulate(oscillator(zo.record(times, inputs)), until=12.0)
    assert run.end_state[:2] == pytest.approx(followed(times, inputs, 12.0), abs=EXACT)
    assert [one.time for one in run.switches] == pytest.approx(times.tolist(), abs=EXACT)


@pytest.mark.parametrize("n", [5, 40, 161])
def test_an_oscillator_follows_a_record_that_is_repeated(n: int) -> None:
    period, rng = 4.0, np.random.default_rng(n)
    times, inputs = np.sort(rng.uniform(-1.0, 2.9, n)), rng.normal(size=n)
    problem = oscillator(zo.record(times, inputs, period=period))
    every = np.concatenate([times + k * period for k in range(-1, 5)])
    wanted = followed(every, np.tile(inputs, 6), 2.6 * period)
    run = zo.simulate(problem, until=2.6 * period)
    assert run.end_state[:2] == pytest.approx(wanted, abs=EXACT)
    passed = np.array([one.time for one in run.switches])
    marks = [one for one in every if 1e-6 < one < 2.6 * period]
    assert max(float(np.min(np.abs(passed - one))) for one in marks) < EXACT


def test_a_repeated_cubic_record_is_a_periodic_spline_without_events() -> None:
    rng = np.random.default_rng(1)
    times, inputs = np.sort(rng.uniform(0.0, 2.9, 25)), rng.normal(size=25)
    record = zo.record(times, inputs, period=3.0, kind="cubic")
    clock = zo.Clock.at(ca.SX(record.frequency))
    value: Any = ca.Function("u", [clock.state], [record.at(clock)])
    wanted = CubicSpline(
        np.append(times, times[0] + 3.0), np.append(inputs, inputs[0]), bc_type="periodic"
    )
    for at in rng.uniform(-6.0, 6.0, 60):
        angle = record.frequency * at
        found = float(value([math.cos(angle), math.sin(angle)]))
        assert found == pytest.approx(float(wanted((at - times[0]) % 3.0 + times[0])), abs=1e-12)
    assert not zo.simulate(oscillator(record), until=7.0).events


@pytest.mark.parametrize("n", [2, 5, 30])
def test_a_repeated_monotone_record_overshoots_nowhere_and_has_one_course_in_every_turn(
    n: int,
) -> None:
    rng = np.random.default_rng(n)
    times, inputs = np.sort(rng.uniform(-1.0, 1.9, n)), rng.normal(size=n)
    record = zo.record(times, inputs, period=3.0, kind="monotone")
    clock = zo.Clock.at(ca.SX(record.frequency))
    value: Any = ca.Function("u", [clock.state], [record.at(clock)])
    # Of many turns in a row, the middle one is as if repeated.
    every = np.concatenate([times + 3.0 * k for k in range(-3, 5)])
    wanted = PchipInterpolator(every, np.tile(inputs, 8))
    for at in rng.uniform(-3.0, 3.0, 60):
        angle = record.frequency * at
        found = float(value([math.cos(angle), math.sin(angle)]))
        assert found == pytest.approx(float(wanted(at)), abs=1e-12)
        assert min(inputs) - EXACT <= found <= max(inputs) + EXACT
    run = zo.simulate(oscillator(record), until=7.0)
    assert run.end_state[:2] == pytest.approx(moved(wanted, np.sort(every), 7.0), abs=1e-11)


@pytest.mark.slow
def test_the_orbit_under_a_repeated_record_has_its_multipliers() -> None:
    times, inputs = np.arange(9) * 0.4, np.random.default_rng(7).normal(size=9)
    orbit = zo.find_orbit(oscillator(zo.record(times, inputs, period=4.0))).unwrap()
    wanted = np.linalg.eigvals(expm(FLOW[:2, :2] * 4.0)).tolist()
    assert sorted(orbit.floquet_multipliers, key=lambda mu: mu.imag) == pytest.approx(
        sorted(wanted, key=lambda mu: mu.imag), abs=1e-10
    )
    assert orbit.certificate["passed"]


@pytest.mark.parametrize("kind", ["linear", "cubic"])
def test_a_record_may_decay_to_the_least_number(kind: str) -> None:
    times = np.arange(800) * 0.01
    inputs = np.exp(-np.arange(800.0))
    assert 0.0 < inputs[-60] < 1e-320
    stops = np.where(inputs < 1e-200, 0.0, inputs)
    runs = [
        zo.simulate(oscillator(zo.record(times, each, period=8.0, kind=kind)), until=9.0)
        for each in (inputs, stops)
    ]
    assert np.array_equal(runs[0].end_state, runs[1].end_state)


@pytest.mark.slow
def test_samples_are_no_chatter_and_switches_have_a_limit_of_their_own() -> None:
    samples = np.random.default_rng(4).normal(size=30)
    few = SimulationSettings(most_impacts=3)
    shaken = oscillator(zo.record(np.linspace(0.0, 2.9, 30), samples))
    sampled = zo.load_problem("sampled_pendulum")
    for problem, until in ((shaken, 3.5), (sampled, 5.0)):
        task = SimulationTask(
            dynamics=problem.graph_dynamics(problem.values()),
            state=np.array(problem.state_vector(problem.starts[0])),
            until=until,
            settings=few,
        )
        outcomes = looped(task), plainly(task)
        if problem is shaken:
            assert [len(one.execution.events) for one in outcomes if one.execution] == [29, 29]
            continue
        for one in outcomes:
            assert isinstance(one.error, ChatterError)
            assert re.match(r"More than 3 switches occurred, .*`sample`", str(one.error))


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("kind", ["linear", "monotone", "cubic"])
@pytest.mark.parametrize("period", [2.0, None])
def test_loop_and_reference_agree_in_every_bit_under_a_record(
    kind: str, period: float | None
) -> None:
    inputs = np.random.default_rng(2).normal(size=20)
    record = zo.record(np.linspace(0.0, 1.9, 20), inputs, period=period, kind=kind)
    problem = oscillator(record)
    agreed(problem, 3.0)


@pytest.mark.slow
@pytest.mark.parametrize("n", [161, 2000, 20_000])
def test_a_rocking_block_obeys_equations_by_hand(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    size, times = 2.2, np.arange(n) * 40.0 / n
    tones = ((1.0, 39.0), (0.6, 71.0), (0.3, 163.0 if n > 400 else 30.0))
    ground = sum(a * np.sin(math.pi * k * times / 20.0) for a, k in tones)
    ground = np.sin(math.pi * times / 40.0) ** 2 * ground
    wanted = rocking_by_hand(
        np.append(times, 40.0),
        size * np.append(ground, ground[0]),
        radius=0.6,
        slenderness=0.25,
        gravity=9.81,
        restitution=0.6,
        longest=1e-3,
    )
    problem = replace(zo.load_problem("shaken_block"), name=f"block {n}")
    names: Any = getattr(problem.model, "__globals__")  # noqa: B009
    monkeypatch.setitem(names, "GROUND", zo.record(times, ground, period=40.0))
    run = zo.simulate(problem, until=40.0, parameters={"size": size})
    assert [one.time for one in run.releases] == pytest.approx(wanted.lifts, abs=EVENT)
    assert [one.time for one in run.zeno_points] == pytest.approx(wanted.zeno_points, abs=EVENT)
    impacts = np.array(wanted.impacts)
    assert all(np.min(np.abs(impacts - one.time)) < EVENT for one in run.impacts)
    # Every sample is an event, however many of them one step of the resting block would pass.
    passed = np.array([one.time for one in run.switches])
    assert max(float(np.min(np.abs(passed - one))) for one in times[1:]) < 1e-10
    # An odd number of cells has one more knot.
    assert len(passed) == n - 1 + n % 2


@pytest.mark.slow
@pytest.mark.parametrize(("n", "halves"), [(20_000, 40), (10_000, 7)])
def test_no_short_cell_of_a_smooth_record_is_passed_unseen(n: int, halves: int) -> None:
    # Where the input is level, a step that starts on a knot reaches over many cells.
    times = np.arange(n) * 2.0 / n
    inputs = 50 * np.cos(halves * math.pi * times)
    run = zo.simulate(oscillator(zo.record(times, inputs, period=2.0)), until=1.6)
    assert len(run.switches) == pytest.approx(0.8 * n, abs=1)
    gaps = np.diff([one.time for one in run.switches])
    assert np.max(np.abs(gaps - 2.0 / n)) < 1e-11
    assert run.end_state[:2] == pytest.approx(followed(times, inputs, 1.6), abs=1e-11)


@pytest.mark.slow
def test_a_hundred_thousand_samples_are_followed() -> None:
    times = np.linspace(0.0, 100.0, 100_001)
    inputs = np.random.default_rng(0).normal(size=len(times))
    run = zo.simulate(oscillator(zo.record(times, inputs)), until=100.0)
    assert run.end_state[:2] == pytest.approx(followed(times, inputs, 100.0), abs=1e-9)


# One-shot inputs.


def test_a_step_a_pulse_and_a_ramp_happen_once() -> None:
    clock = zo.Time()
    t = clock.state
    pulse = ca.if_else(t > 0.5, 1.0, 0.0) - ca.if_else(t > 0.9, 1.0, 0.0)
    ramp = ca.fmax(0.0, ca.fmin(1.0, (t - 2.0) / 0.7))
    problem = under(3 * pulse + ramp, clock, "once")
    run = zo.simulate(problem, until=5.0)
    # A step is a line that rises within no time: its two ends are one instant to rounding.
    marks = [0.0, 0.5, 0.5 + 1e-13, 0.9, 0.9 + 1e-13, 2.0, 2.7, 5.0]
    wanted = followed(np.array(marks), np.array([0, 0, 3.0, 3.0, 0, 0, 1.0, 1.0]), 5.0)
    assert run.end_state[:2] == pytest.approx(wanted, abs=EXACT)
    times = [one.time for one in run.switches]
    assert times == pytest.approx([0.5, 0.9, 2.0, 2.7], abs=EXACT)
    for ask in (zo.find_orbit, zo.search_gains, zo.find_orbit_by_shooting):
        with pytest.raises(InputError, match=r"no motion of `once` repeats, .* `zo.Time`"):
            ask(problem)
    with pytest.raises(InputError, match="no motion of `once` repeats"):
        zo.parameter_map(problem, x=("restitution", 0.1, 0.5, 2), y=("x", 0.0, 1.0, 2))


# Files and refusals.


def test_a_record_is_read_in_si_units(tmp_path: Path) -> None:
    path = tmp_path / "ground.csv"
    path.write_text("time [ms],ground [mm],voltage [V]\n0,0,1\n100,5,2\n250,-3,1\n")
    found = zo.read_record(path, "ground", unit="m")
    assert found.time == pytest.approx([0.0, 0.1, 0.25])
    assert found.samples == pytest.approx([0.0, 0.005, -0.003])
    for column, unit, words in (
        ("ground", "m/s^2", r"column `ground` has `m`, and the input is in `m/s\^2`"),
        ("floor", "m", "the column `floor` is missing"),
    ):
        with pytest.raises(DataFileError, match=words):
            zo.read_record(path, column, unit=unit)
    with pytest.raises(InputError, match=r"Argument `unit`: `metres` is not a unit"):
        zo.read_record(path, "ground", unit="metres per")
    with pytest.raises(InputError, match=r"`unit` must be an SI unit, .* it is `mm`: write `m`"):
        zo.read_record(path, "ground", unit="mm")


WRONG: tuple[tuple[dict[str, Any], str], ...] = (
    ({"time": [0, 0], "samples": [1, 2]}, r"`time` must increase, but entry 1"),
    ({"time": [0, 1], "samples": [1, math.nan]}, r"`samples` must hold finite numbers"),
    ({"time": [0, 1, 2], "samples": [1, 2]}, "3 times and 2 samples"),
    ({"time": [0, 1], "samples": [1, 2], "period": 0.5}, "must not be shorter than the record"),
    ({"time": [0, 1], "samples": [1, 2], "period": -2.0}, "must be positive and finite"),
    ({"time": [0, 1], "samples": [1, 2], "period": 0.0}, "must be positive and finite"),
    ({"time": [0, 1], "samples": [1, 2], "period": math.nan}, "must be positive and finite"),
    ({"time": [0, 1], "samples": [1, 2], "period": math.inf}, "must be positive and finite"),
    ({"time": [0, 1], "samples": [1, 2], "period": 1.0}, "must end where it begins"),
    ({"time": [0, 1, 2], "samples": [1e308, -1e308, 0]}, "slopes are beyond the range of a double"),
    ({"time": [1], "samples": [2]}, "2 to 2000000 times, but it holds 1"),
    ({"time": [0, 1], "samples": [1, 2], "kind": "step"}, "'linear', 'cubic' or 'monotone'"),
)


@pytest.mark.parametrize(("given", "words"), WRONG)
def test_a_wrong_record_is_refused_in_one_line(given: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words) as error:
        zo.record(**given).at(zo.Time())
    assert "\n" not in str(error.value)


def test_a_record_refuses_a_clock_that_does_not_fit() -> None:
    once, again = zo.record([0, 1], [1, 2]), zo.record([0, 1], [1, 2], period=3.0)
    for record, clock, words in (
        (once, zo.Clock.at(ca.SX(2.0)), "`period` of the record `record` is missing"),
        (again, zo.Clock.at(ca.SX(2.0)), r"must turn once in 3 s, .* its frequency is 2"),
        (again, zo.Time(), r"needs `zo.Clock.at\(record.frequency\)`"),
    ):
        with pytest.raises(InputError, match=words):
            record.at(clock)
