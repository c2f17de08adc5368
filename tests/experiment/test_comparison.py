"""Recordings whose truth is known: what is measured of them is right, and the false ones are told.

Tolerances are five standard errors as claimed, so a claim that is too bold fails; and where there
is no noise, what the table of the orbit and the harmonics of the period leave.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.recordings_of import recorded, recording_of
from zeno_orbits.errors import InputError
from zeno_orbits.experiment import (
    Comparison,
    ComparisonVerdict,
    OrbitTable,
    RecordedSignal,
    Recording,
    compare_recording,
    tabulate_orbit,
)
from zeno_orbits.experiment.comparison.alignment import aligned
from zeno_orbits.experiment.orbit_table import gap_coordinates
from zeno_orbits.experiment.recordings.periodicity import periodicity
from zeno_orbits.model import HybridDynamics, Problem, load_problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.search import orbit_by_shooting
from zeno_orbits.simulation import simulate

SIGNALS = ("theta1", "theta2", "current")
SURE = 5.0
LABELS = dict(zip(SIGNALS, (r"$\theta_{1}$ [rad]", r"$\theta_{2}$ [rad]", "$i$ [A]"), strict=True))


@pytest.fixture(scope="module")
def table(orbit: Orbit, problem: Problem) -> OrbitTable:
    return tabulate_orbit(orbit, problem, SIGNALS)


@pytest.fixture(scope="module")
def compared(orbit: Orbit, problem: Problem, table: OrbitTable) -> tuple[Recording, Comparison]:
    """Return a copy of the orbit with little noise, and its comparison."""
    recording = recorded(table, problem, noise=1e-3)
    return recording, compare_recording(orbit, problem, recording)


def changed(recording: Recording, change: Callable[[np.ndarray, np.ndarray], Any]) -> Recording:
    """Return a recording with other times and values, ``(time, values) -> (time, values)``."""
    values = np.stack([signal.values for signal in recording.signals])
    time, values = change(recording.time, values)
    signals = tuple(
        replace(signal, values=row) for signal, row in zip(recording.signals, values, strict=True)
    )
    return replace(recording, time=time, signals=signals)


def truth_of(orbit: Orbit, stretch: float) -> dict[str, float]:
    """Return what a copy of the orbit, stretched in time, shows of its contacts."""
    first = orbit.impacts[0]
    rate, after = first.state_minus["dtheta2"], first.time
    return {
        "period": stretch * orbit.period,
        "first impact time": stretch * after,
        "first impact speed": rate / stretch,
        "restitution seen": orbit.parameters["restitution"],
        "end of chatter": stretch * orbit.zeno_time,
        "chatter duration": stretch * (orbit.zeno_time - after),
        "contact duration": stretch * (orbit.period - orbit.zeno_time),
        "release time": stretch * orbit.period,
        "delay of theta1": 0.0,
        "delay of current": 0.0,
        "gap in contact": 0.0,
    }


COPIES: dict[str, dict[str, float]] = {
    "noisy": {"noise": 2e-3},
    "very noisy": {"noise": 1e-2},
    "shifted": {"noise": 2e-3, "start": 0.85},
    "coarse and uneven": {"noise": 2e-3, "rate": 80.0, "jitter": 1.0},
    "slower": {"noise": 2e-3, "stretch": 1.3},
    "faster": {"noise": 2e-3, "stretch": 0.7, "start": 0.6},
    "short": {"noise": 2e-3, "n_cycles": 3.5},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", fast(1, COPIES))
def test_the_numbers_of_a_copy_are_the_orbits_own(
    name: str, orbit: Orbit, problem: Problem, table: OrbitTable
) -> None:
    options: Any = COPIES[name]
    found = compare_recording(orbit, problem, recorded(table, problem, seed=3, **options))
    assert found.agrees, found.reasons
    for what, true in truth_of(orbit, options.get("stretch", 1.0)).items():
        metric = found.metric(what)
        assert math.isfinite(metric.data), what
        assert abs(metric.data - true) < SURE * metric.error, (what, metric)
    # A claimed error that is huge would make the above say nothing.
    assert found.metric("first impact time").error < 1e-3
    assert found.metric("period").error < 1e-3
    assert found.metric("contact duration").error < 2e-2


@pytest.mark.slow
def test_the_numbers_of_a_copy_without_noise_are_near_the_orbits_own(
    orbit: Orbit, problem: Problem, table: OrbitTable
) -> None:
    found = compare_recording(orbit, problem, recorded(table, problem))
    # Times are as good as the period, which sixteen harmonics of a kinked signal give to 1e-5.
    for what, true in truth_of(orbit, 1.0).items():
        assert found.metric(what).data == pytest.approx(true, rel=3e-5, abs=3e-5), what
    for metric in found.metrics:
        if "rms" in metric.name or "distance" in metric.name:
            assert abs(metric.data) < 1e-2, metric


@pytest.mark.slow
def test_a_known_deviation_is_measured(orbit: Orbit, problem: Problem, table: OrbitTable) -> None:
    def cut_off(time: np.ndarray, values: np.ndarray) -> Any:
        # Above 2.1 A the current is cut off; link 1 is off by 0.05 rad.
        return time, np.stack([values[0] + 0.05, values[1], np.minimum(values[2], 2.1)])

    found = compare_recording(
        orbit, problem, changed(recorded(table, problem, noise=1e-3), cut_off)
    )
    assert found.agrees
    # Within a bin of 1/240 of a period the current changes by less than 0.03 A near its top.
    assert found.metric("highest of current").data == pytest.approx(2.1, abs=0.03)
    assert any("`current` looks cut off" in remark for remark in found.remarks)
    # The same offset everywhere: its root mean square is the offset. What is cut off moves the
    # alignment by less than 0.5 ms, and link 1 by 8 rad/s times that.
    for part in ("in flight", "in chatter", "in contact"):
        rms = found.metric(f"rms deviation {part} of theta1")
        assert rms.data == pytest.approx(0.05, abs=4e-3)


@pytest.mark.slow
def test_a_signal_that_comes_late_is_told_by_how_much(
    orbit: Orbit, problem: Problem, table: OrbitTable
) -> None:
    def late(time: np.ndarray, values: np.ndarray) -> Any:
        values = values.copy()
        values[2] = table.at((time - 0.020) / table.period + 0.3)[:, 2]
        return time, values

    found = compare_recording(orbit, problem, changed(recorded(table, problem, noise=1e-3), late))
    behind = found.metric("delay of current").data - found.metric("delay of theta1").data
    # Means over bins of 7.6 ms of a signal with a jump: a twentieth of a bin.
    assert behind == pytest.approx(0.020, abs=4e-4)


@pytest.mark.slow
def test_gaps_and_holes_are_lived_with(orbit: Orbit, problem: Problem, table: OrbitTable) -> None:
    copy = recorded(table, problem, noise=2e-3)
    rng = np.random.default_rng(1)

    def holed(time: np.ndarray, values: np.ndarray) -> Any:
        kept = (time < 5.0) | (time > 8.1)
        values = np.where(rng.random(values.shape) < 0.2, np.nan, values)
        return time[kept], values[:, kept]

    found = compare_recording(orbit, problem, changed(copy, holed))
    assert found.agrees, found.reasons
    for what, true in truth_of(orbit, 1.0).items():
        metric = found.metric(what)
        assert abs(metric.data - true) < SURE * metric.error, (what, metric)


@pytest.mark.slow
def test_angles_alone_give_portraits(orbit: Orbit, problem: Problem, table: OrbitTable) -> None:
    whole = recorded(table, problem, noise=1e-3)
    angles = replace(whole, signals=whole.signals[:2])
    found = compare_recording(orbit, problem, angles)
    assert found.agrees
    distance = found.metric("mean distance in the portrait of theta1 and dtheta1")
    # The floor of the noise of estimated velocities, as claimed.
    assert 0.0 <= distance.data < SURE * distance.error < 0.02


Change = Callable[[np.ndarray, np.ndarray], Any]

FALSE: dict[str, tuple[Change, str]] = {
    "first angle mirrored": (
        lambda t, y: (t, y * [[-1], [1], [1]]),
        "`theta1` looks like its sign reversed",
    ),
    "gap mirrored": (
        lambda t, y: (t, y * [[1], [-1], [1]]),
        "`theta2` looks like its sign reversed",
    ),
    "degrees as radians": (
        lambda t, y: (t, y * [[180 / math.pi], [180 / math.pi], [1]]),
        "`theta1` looks like degrees labelled as radians",
    ),
    "exchanged columns": (
        lambda t, y: (t, y[[1, 0, 2]]),
        "`theta2` and `theta1` look swapped: exchange|`theta1` and `theta2` look swapped: exchange",
    ),
    "exchanged columns of different kinds": (
        lambda t, y: (t, y[[2, 1, 0]]),
        "`theta1` and `current` look swapped|`current` and `theta1` look swapped",
    ),
    "milliampere as ampere": (
        lambda t, y: (t, y * [[1], [1], [1e3]]),
        "`current` looks like a thousandth of its unit labelled as the unit",
    ),
    "milliseconds as seconds": (
        lambda t, y: (1e3 * t, y),
        "milliseconds labelled as seconds",
    ),
    "halved times": (
        lambda t, y: (0.5 * t, y),
        "the period is 0.5 times the orbit's: check the column of times",
    ),
    "doubled period": (
        lambda t, y: (t, y * (1 + 0.05 * np.sign(np.sin(math.pi * t / 1.81371293903)))),
        "the period is doubled",
    ),
    "noise": (
        lambda t, y: (t, np.random.default_rng(0).normal(size=y.shape)),
        "variance repeat",
    ),
    "another motion": (
        lambda t, y: (t, 0 * y + np.sin(np.outer([3.0, 6.0, 9.0], t))),
        "moves otherwise|looks like",
    ),
    "less than a period": (
        lambda t, y: (t[:500], y[:, :500]),
        "no period is seen",
    ),
    "a pause of hours in the middle": (
        lambda t, y: (t + 1e4 * (t > t[len(t) // 2]), y),
        "s for 1e+04 s, and no period is seen: correct the times",
    ),
    "never at rest": (
        lambda t, y: (
            t,
            y + [[0.0], [0.15], [0.0]] * (1 + np.sin(6 * math.pi * t / 1.81371293903)),
        ),
        "no contact phase is seen",
    ),
}

TWINS = {"gap mirrored", "exchanged columns of different kinds", "never at rest"}
"""Changes that take long, or whose twin is another one."""


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in TWINS)) for name in FALSE],
)
def test_what_shows_no_such_orbit_is_told_with_the_reason(
    name: str, orbit: Orbit, problem: Problem, table: OrbitTable
) -> None:
    change, reason = FALSE[name]
    found = compare_recording(orbit, problem, changed(recorded(table, problem, noise=1e-3), change))
    assert not found.agrees
    assert any(part in one for one in found.reasons for part in reason.split("|")), found.reasons


@pytest.mark.slow
def test_values_far_from_all_others_are_named_and_large_true_values_are_not(
    orbit: Orbit, problem: Problem, compared: tuple[Recording, Comparison]
) -> None:
    right, known = compared

    def stray(time: np.ndarray, values: np.ndarray) -> Any:
        values = values.copy()
        values[0, 700] = -50.0
        return time, values

    found = compare_recording(orbit, problem, changed(right, stray))
    at = f"{right.time[700]:g} s"
    told = f"`theta1` has 1 value far from all others (-50 at {at}): correct or empty it"
    assert [one for one in found.remarks if "far from all" in one] == [told]
    assert not any("far from all" in one for one in known.remarks)


@pytest.mark.slow
def test_the_recording_of_another_problem_is_told_first(
    orbit: Orbit, problem: Problem, table: OrbitTable
) -> None:
    right = recorded(table, problem, noise=1e-3)
    other = replace(right, problem="relay")
    found = compare_recording(orbit, problem, other)
    told = f"the recording names the problem `relay`, not `{problem.name}` (line `# problem:`)"
    assert found.agrees
    assert told in found.remarks
    wrong = compare_recording(orbit, problem, changed(other, FALSE["first angle mirrored"][0]))
    assert wrong.reasons[0] == told
    assert told not in wrong.remarks


@pytest.mark.slow
def test_signals_that_jump_are_aligned_as_well() -> None:
    # The speed of this problem jumps by two thirds of its range; its slope knows nothing of that.
    problem = load_problem("forced_oscillator")
    orbit = orbit_by_shooting(problem, problem.values()).unwrap()
    table = tabulate_orbit(orbit, problem, ("distance", "speed"))
    found = compare_recording(orbit, problem, recorded(table, problem, noise=1e-3, rate=60.0))
    assert found.agrees, found.reasons
    for what in ("first impact time", "end of chatter", "release time", "contact duration"):
        metric = found.metric(what)
        assert abs(metric.data - metric.orbit) < SURE * metric.error < 0.05, metric


@pytest.mark.slow
def test_a_start_that_still_settles_is_named(
    orbit: Orbit, problem: Problem, machine: HybridDynamics
) -> None:
    execution = simulate(machine, [0.6, 0, 0, 0, 0], until=30.0)
    time = np.arange(0.0, 30.0, 2.5e-3)
    states = np.array([execution.state_at(t) for t in time])
    recording = recording_of(problem, problem.state_names, time, states.T)
    found = compare_recording(orbit, problem, recording)
    assert any("still settling" in remark and "--t-start" in remark for remark in found.remarks)
    assert found.verdict is ComparisonVerdict.UNDECIDED


def test_signals_of_another_kind_are_refused(orbit: Orbit, problem: Problem) -> None:
    time = np.arange(100) * 0.1
    metres = RecordedSignal(name="theta1", unit="m", values=np.sin(time))
    other = RecordedSignal(name="pressure", unit="Pa", values=np.sin(time))
    empty = RecordedSignal(name="theta1", unit="rad", values=np.full(100, np.nan))
    huge = RecordedSignal(name="theta1", unit="rad", values=1e300 * np.sin(time))
    whole = RecordedSignal(name="theta2", unit="rad", values=np.sin(time))
    # The largest sine of these times is that of 4.7 s.
    for signals, reason in (
        ((huge,), r"`theta1` up to 1e\+100, but it has 9.9\d*e\+299 at t = 4.7 s: correct"),
        ((metres,), "`theta1` in a unit like rad, but it has m"),
        ((other,), "must have a signal or a contact channel of the problem"),
        ((empty,), "lacks values: no signal of it has a number"),
        ((empty, whole), "lacks values of `theta1`: delete its column"),
    ):
        recording = Recording(source=None, problem="", time=time, signals=signals)
        with pytest.raises(InputError, match=reason):
            compare_recording(orbit, problem, recording)


@pytest.mark.slow
def test_the_data_are_plain_and_finite(compared: tuple[Recording, Comparison]) -> None:
    import json

    found = compared[1]
    data = json.loads(json.dumps(found.as_json(), allow_nan=False))
    assert data["agrees"] is True
    assert data["source"] == "simulated"
    assert data["metrics"].keys() == {metric.name for metric in found.metrics}
    for metric in found.metrics:
        assert data["metrics"][metric.name] == {
            "unit": metric.unit,
            "orbit": metric.orbit,
            "data": metric.data,
            "difference": metric.data - metric.orbit,
            "standard_error": metric.error,
        }
    units = {metric.name: metric.unit for metric in found.metrics}
    assert units["period"] == units["delay of current"] == "s"
    assert units["first impact speed"] == "rad/s"
    assert units["highest of current"] == units["rms deviation in contact of current"] == "A"


def test_each_curve_of_the_picture_is_what_its_label_says(
    orbit: Orbit, problem: Problem, table: OrbitTable, compared: tuple[Recording, Comparison]
) -> None:
    from zeno_orbits.report.plots import plot_comparison

    recording, found = compared
    assert found.deviations is not None
    assert found.where is not None
    axes = plot_comparison(problem, found).axes
    phases = np.mod(found.where.phases(recording.time), 1.0)
    order = np.argsort(phases)
    for k, name in enumerate(SIGNALS):
        left, right = axes[2 * k], axes[2 * k + 1]
        assert left.get_ylabel() == LABELS[name]
        curves = {
            line.get_label(): line.get_xydata() for line in left.lines if len(line.get_xdata())
        }
        values = recording.signal(name).values
        mean, own = np.asarray(curves["mean over cycles"]), np.asarray(curves["orbit"])
        # A bin's mean is the signal at its middle, but for what it changes within: some per cent.
        around = np.interp(mean[:, 0], phases[order], values[order])
        assert np.median(np.abs(mean[:, 1] - around)) < 0.01 * np.ptp(values)
        # The orbit's curve, at the phases of the samples, is the samples without their noise.
        away = values - table.at(phases)[:, k]
        assert np.median(np.abs(away)) < 2e-3 * np.ptp(values)
        assert own[:, 1] == pytest.approx(table.nodes.values[:, k], abs=1e-6)
        deviation = np.asarray(right.lines[0].get_xydata())
        assert deviation[:, 0] == pytest.approx(mean[:, 0])
        assert deviation[:, 1] == pytest.approx(mean[:, 1] - table.at(mean[:, 0])[:, k], abs=1e-9)
    portraits = axes[2 * len(SIGNALS) :]
    assert len(portraits) == len(problem.portraits)
    for ax, (first, second) in zip(portraits, problem.portraits, strict=True):
        whole = tabulate_orbit(orbit, problem, (first, second))
        mine, recorded_one = (np.asarray(line.get_xydata()) for line in ax.lines)
        assert np.ptp(mine, axis=0) == pytest.approx(np.ptp(whole.nodes.values, axis=0), rel=1e-3)
        inside = recorded_one[np.all(np.isfinite(recorded_one), axis=1)]
        assert np.ptp(inside, axis=0) == pytest.approx(np.ptp(mine, axis=0), rel=0.1)


def test_a_table_of_the_orbit_is_the_orbit(
    orbit: Orbit, problem: Problem, machine: HybridDynamics
) -> None:
    whole = tabulate_orbit(orbit, problem, problem.state_names)
    execution = simulate(machine, problem.state_vector(orbit.release_state), until=orbit.period)
    phases = np.random.default_rng(0).random(500)
    true = np.array([execution.state_at(phase * orbit.period) for phase in phases])
    # Cubics between nodes a few ms apart, of motions that change within 0.1 s: (0.05)^4 / 384.
    assert whole.at(phases) == pytest.approx(true, abs=2e-7)
    assert gap_coordinates(problem) == ("theta2",)
    assert problem.gap_unit == "rad"
    assert load_problem("curved_surface").gap_unit == "m"


@pytest.mark.parametrize("n_cycles", [2.2, 3.7, 5.3, 7.27, 9.9])
@pytest.mark.parametrize("start", [0.0, 0.35, 0.7])
def test_the_period_is_none_of_its_multiples_wherever_a_record_is_cut_off(
    n_cycles: float, start: float, orbit: Orbit, problem: Problem
) -> None:
    # What overlaps at the end of a record may hold more of the motion's energy than its share.
    table = tabulate_orbit(orbit, problem, ("theta1", "theta2"))
    whole = recorded(table, problem, n_cycles=n_cycles, start=start, rate=200.0, noise=2e-3)
    found = periodicity(whole.time, np.stack([one.values for one in whole.signals]))
    assert found is not None
    # Two cycles at 200 Hz: some samples; a multiple would be off by a whole period.
    assert found.period == pytest.approx(orbit.period, abs=0.01)


@pytest.mark.parametrize("seed", range(5))
def test_the_period_is_as_sure_as_is_said(seed: int, problem: Problem, table: OrbitTable) -> None:
    copy = recorded(table, problem, noise=2e-2, rate=200.0, seed=seed, start=0.2 * seed)
    found = periodicity(copy.time, np.stack([signal.values for signal in copy.signals]))
    assert found is not None
    assert abs(found.period - table.period) < SURE * found.error < 1e-3
    assert found.alternation < SURE * found.alternation_noise


SHORT = [(0.0128, 0.1, 500.0), (0.0128, 0.3, 250.0), (0.015, 0.3, 480.0), (0.015, 0.65, 1000.0)]
"""Amplitude of a shaken table, restitution, and samples a second: phases of few samples."""


@pytest.mark.slow
@pytest.mark.parametrize(("amplitude", "restitution", "rate"), fast(1, SHORT))
def test_phases_too_short_for_the_sampling_are_not_resolved_or_right(
    amplitude: float, restitution: float, rate: float
) -> None:
    shaken = load_problem("vibrating_table")
    values = shaken.values(parameters={"A": amplitude, "restitution": restitution})
    orbit = orbit_by_shooting(shaken, values).unwrap()
    table = tabulate_orbit(orbit, shaken, shaken.state_names)
    found = compare_recording(
        orbit, shaken, recorded(table, shaken, noise=1e-3, rate=rate, n_cycles=25)
    )
    assert found.agrees, found.reasons
    true = {metric.name: metric.orbit for metric in found.metrics}
    true["restitution seen"] = restitution
    told = 0
    for name in names_of_contact_metrics(found):
        metric = found.metric(name)
        if math.isfinite(metric.data):
            told += 1
            assert abs(metric.data - true[name]) < SURE * metric.error, metric
    assert told or any("not resolved" in remark for remark in found.remarks)


def names_of_contact_metrics(found: Comparison) -> list[str]:
    """Return the names of the numbers that contacts give."""
    names = [metric.name for metric in found.metrics]
    return names[1 : names.index("gap in contact")]


# ---------------------------------------------------------------- samples few, many, or cut off


@pytest.fixture(scope="module")
def shaken() -> tuple[Problem, Orbit, OrbitTable]:
    problem = load_problem("vibrating_table")
    orbit = orbit_by_shooting(problem, problem.values()).unwrap()
    return problem, orbit, tabulate_orbit(orbit, problem, ("height", "speed"))


@pytest.fixture(scope="module")
def forced() -> tuple[Problem, Orbit, OrbitTable]:
    problem = load_problem("forced_oscillator")
    orbit = orbit_by_shooting(problem, problem.values()).unwrap()
    return problem, orbit, tabulate_orbit(orbit, problem, ("distance", "speed"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", fast(1, [0, 9, 13, 27]))
def test_the_period_is_as_sure_as_is_said_where_samples_meet_jumps_step_by_step(
    seed: int, forced: tuple[Problem, Orbit, OrbitTable]
) -> None:
    # 376.99 samples a period: from cycle to cycle they move by a hundredth of a step past a jump.
    problem, orbit, table = forced
    start = np.random.default_rng(seed).random()
    copy = recorded(table, problem, noise=1e-3, rate=60.0, seed=seed, start=start)
    where = compare_recording(orbit, problem, copy).where
    assert where is not None
    assert abs(where.period - orbit.period) < SURE * where.period_error < 1e-4


@pytest.mark.slow
def test_later_cycles_with_few_samples_say_nothing_of_settling(
    shaken: tuple[Problem, Orbit, OrbitTable],
) -> None:
    problem, orbit, table = shaken

    def thinned(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # Fewer than half of the bins of a cycle have a sample there.
        lost = (np.arange(time.size) > time.size / 3) & (np.arange(time.size) % 4 > 0)
        return time, np.where(lost, np.nan, values)

    copy = changed(recorded(table, problem, noise=1e-3, rate=300.37 / orbit.period), thinned)
    found = compare_recording(orbit, problem, copy)
    assert not any("still settling" in remark for remark in found.remarks)


def noisier(recording: Recording, name: str, factor: float, seed: int) -> Recording:
    """Return a recording with noise added to one signal, in parts of its range."""
    rng = np.random.default_rng(seed)
    signals = tuple(
        replace(
            one, values=one.values + factor * np.ptp(one.values) * rng.normal(size=one.values.size)
        )
        if one.name == name
        else one
        for one in recording.signals
    )
    return replace(recording, signals=signals)


@pytest.mark.parametrize("noisy", fast(0, ["distance", "speed"]))
def test_errors_of_time_follow_the_noise_of_the_signals_that_tell_it(
    noisy: str, forced: tuple[Problem, Orbit, OrbitTable]
) -> None:
    # One signal is thirty times as noisy as the other. An error from the noise of both together is
    # almost twice too large if the distance is noisy: the steep speed tells the time.
    _, _, table = forced
    scores: list[float] = []
    for seed in range(30):
        start = np.random.default_rng(seed).random()
        copy = recorded(table, forced[0], noise=1e-3, rate=60.0, n_cycles=6, seed=seed, start=start)
        copy = noisier(copy, noisy, 3e-2, seed + 99)
        values = np.stack([one.values for one in copy.signals])
        period = periodicity(copy.time, values)
        assert period is not None
        where = aligned(table, copy.time, values, period, ("distance", "speed"))
        scores.append((where.period - table.period) / where.period_error)
    # The size of thirty deviations is known to 13 %; the larger of two errors counts.
    assert 0.68 < float(np.sqrt(np.mean(np.square(scores)))) < 1.3


@pytest.mark.slow
def test_the_period_of_a_recording_without_noise_is_exact(
    forced: tuple[Problem, Orbit, OrbitTable],
) -> None:
    problem, orbit, table = forced
    found = compare_recording(orbit, problem, recorded(table, problem, rate=60.0))
    # The table stands for itself: rounding alone.
    assert found.metric("period").data == pytest.approx(orbit.period, rel=1e-11)
    assert found.metric("period").error < 1e-10
    assert found.metric("restitution seen").data == pytest.approx(0.5, rel=1e-6)


@pytest.mark.slow
def test_a_part_of_a_cycle_is_not_called_unsettled(
    forced: tuple[Problem, Orbit, OrbitTable],
) -> None:
    # Cut off where it begins, the first and the last cycle have a bin or two in common.
    problem, orbit, table = forced
    copy = recorded(table, problem, noise=5e-3, rate=500.0, n_cycles=8)
    assert not any(
        "settling" in remark for remark in compare_recording(orbit, problem, copy).remarks
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", fast(1, range(6)))
def test_a_period_of_few_samples_is_none_of_its_multiples(
    seed: int, shaken: tuple[Problem, Orbit, OrbitTable]
) -> None:
    problem, orbit, table = shaken
    start = np.random.default_rng(seed).random()
    copy = recorded(table, problem, noise=1e-2, rate=100.0, seed=seed, start=start)
    found = compare_recording(orbit, problem, copy)
    # A contact phase of a few samples is not resolved, so it may be the orbit's.
    assert found.agrees, found.reasons
    assert found.metric("period").data == pytest.approx(orbit.period, rel=1e-3)


FEW = (9.4, 8.35, 3.3, 4.3, 5.3, 7.1, 7.9, 10.5, 11.75, 15.3, 20.6)


@pytest.mark.slow
@pytest.mark.parametrize(("n_cycles", "noise"), fast(1, [(20.0, 1e-3), (40.0, 0.0)]))
@pytest.mark.parametrize("samples", fast(1, FEW))
@pytest.mark.parametrize("machine", fast(1, ["shaken", "forced"]))
def test_an_orbit_with_few_samples_is_not_taken_for_another(
    machine: str, samples: float, n_cycles: float, noise: float, request: pytest.FixtureRequest
) -> None:
    problem, orbit, table = request.getfixturevalue(machine)
    rate = samples / orbit.period
    found = compare_recording(
        orbit, problem, recorded(table, problem, noise=noise, rate=rate, n_cycles=n_cycles)
    )
    possible = {ComparisonVerdict.THIS_ORBIT, ComparisonVerdict.UNDECIDED}
    assert found.verdict in possible, (found.reasons, found.differences)
    if samples > 6.0:
        assert found.metric("period").data == pytest.approx(orbit.period, rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("samples", "n_cycles"), fast(1, [(30.3, 12.0), (11.76, 40.0), (45.7, 12.0)])
)
def test_cycles_that_differ_in_turn_are_seen_with_few_samples(
    samples: float, n_cycles: float, shaken: tuple[Problem, Orbit, OrbitTable]
) -> None:
    problem, orbit, table = shaken

    def doubled(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        size = 0.3 * np.std(values, axis=1, keepdims=True)
        return time, values + size * np.cos(np.pi * time / orbit.period + [[0.0], [1.0]])

    copy = recorded(table, problem, noise=1e-3, rate=samples / orbit.period, n_cycles=n_cycles)
    found = compare_recording(orbit, problem, changed(copy, doubled))
    assert found.verdict in {ComparisonVerdict.NO_ORBIT, ComparisonVerdict.UNDECIDED}
    said = " ".join((*found.reasons, *found.unresolved))
    assert "every other cycle differs by 21 %" in said


@pytest.mark.slow
@pytest.mark.parametrize("steps", fast(1, [20, 200]))
def test_a_coarse_encoder_is_no_deviation(
    steps: int, problem: Problem, orbit: Orbit, table: OrbitTable
) -> None:
    def rounded(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        step = np.ptp(values[:2], axis=1, keepdims=True) / steps
        return time, np.concatenate([np.rint(values[:2] / step) * step, values[2:]])

    exact = recorded(table, problem, noise=1e-5, rate=431.7, n_cycles=6)
    copy = changed(exact, rounded)
    differing = [one.name for one in compare_recording(orbit, problem, copy).differences]
    assert not [name for name in differing if "theta" in name]
    stretched = changed(exact, lambda time, values: (time, rounded(time, 1.2 * values)[1]))
    assert compare_recording(orbit, problem, stretched).differences


@pytest.mark.parametrize(
    ("channel", "why"),
    [
        (lambda closed: closed, ""),
        (lambda closed: 1.0 - closed, "channel and signals contradict each other"),
        (np.ones_like, "channel and signals contradict each other"),
        (np.zeros_like, "the contact `stop` never closes"),
    ],
    ids=["true", "inverted", "always closed", "never closed"],
)
def test_a_contact_channel_must_agree_with_the_recorded_gap(
    channel: Callable[[np.ndarray], np.ndarray],
    why: str,
    orbit: Orbit,
    problem: Problem,
    table: OrbitTable,
) -> None:
    plain = recorded(table, problem, n_cycles=5, rate=200.0)
    time = (plain.time + 0.3 * orbit.period) % orbit.period
    closed = np.array(time > orbit.zeno_time, dtype=np.float64)
    contact = RecordedSignal(name="contact", unit="1", values=channel(closed))
    found = compare_recording(orbit, problem, replace(plain, signals=(*plain.signals, contact)))
    assert found.agrees == (not why)
    assert any(why in reason for reason in found.reasons) == bool(why), found.reasons


@pytest.mark.slow
@pytest.mark.parametrize("until", [2.0, 3.4, 5.0])
def test_a_motion_that_grows_towards_the_orbit_is_no_other_orbit(
    orbit: Orbit, problem: Problem, until: float
) -> None:
    # Its impacts become 40 % faster from cycle to cycle, though the cycles look alike.
    start = simulate(problem.dynamics(orbit.values(problem)), problem.initial_state(), until=until)
    recording = zo.sample_execution(problem, start, noise=1e-3)
    found = compare_recording(orbit, problem, recording)
    assert found.verdict is ComparisonVerdict.UNDECIDED
    assert any("has not settled" in reason for reason in found.unresolved)


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "cycles"), [(1_000_000, 10_000), (40_000, 9_973)])
def test_the_period_of_many_cycles_is_found(rows: int, cycles: int) -> None:
    # The period is known: it is the one of the formula. The records have less than four bins of
    # 2^15 per cycle.
    period = 1.7
    time = np.linspace(0.0, cycles * period, rows)
    phase = 2 * np.pi * time / period
    noise = np.random.default_rng(1).normal(scale=0.01, size=(2, rows))
    values = np.array([np.sin(phase) + 0.3 * np.sin(2 * phase), np.cos(phase)]) + noise
    found = periodicity(time, values)
    assert found is not None
    assert found.error < 1e-8
    assert found.period == pytest.approx(period, abs=6 * found.error)
    assert found.n_cycles == pytest.approx(cycles, rel=1e-5)
    assert found.repeats > 0.999
