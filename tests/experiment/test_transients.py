"""Fits of transients against closed forms: drops, event times, wrong laws, and messages."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import zeno_orbits as zo
from zeno_orbits.experiment import (
    FitParameter,
    RecordedSignal,
    fit_transient_parameters,
    read_event_file,
)
from zeno_orbits.experiment.transients.event_labels import labelled, sequences_of
from zeno_orbits.experiment.transients.motion import moved
from zeno_orbits.simulation import EventKind
from zeno_orbits.work import silent

Row = NDArray[np.float64]
G = 9.81


def heights(times: Row, law: tuple[float, float], height: float = 0.5) -> Row:
    """Return the heights of a ball with the restitution ``e0 - c v``, by its flights."""
    begin, speed = math.sqrt(2 * height / G), math.sqrt(2 * G * height)
    found = np.where(times < begin, height - G * times**2 / 2, 0.0)
    while speed > 1e-9:
        speed *= law[0] - law[1] * speed
        since = times - begin
        inside = (since >= 0.0) & (since < 2 * speed / G)
        found[inside] = speed * since[inside] - G * since[inside] ** 2 / 2
        begin += 2 * speed / G
    return found


def bounces(n: int, e: float, *, first: float = 1.0, scatter: float = 0.0, seed: int = 0) -> Row:
    """Return the times of `n` impacts with flights that shrink by `e`, with scatter per impact."""
    random = np.random.default_rng(seed)
    ratios = e * (1.0 + scatter * random.standard_normal(n - 2))
    flights = 0.4 * np.cumprod(np.concatenate([[1.0], ratios]))
    return first + np.concatenate([[0.0], np.cumsum(flights)])


def track(times: Row, values: Row, name: str = "height", unit: str = "m") -> zo.Recording:
    """Return one signal as a recording."""
    signal = RecordedSignal(name=name, unit=unit, values=values)
    return zo.Recording(source=None, problem="", time=times, signals=(signal,))


def heard(times: Row) -> zo.Recording:
    """Return times of impacts as a recording."""
    return track(times, times, "impact", "s")


TIMES = np.arange(0.0, 1.6, 0.01)


def noisy(values: Row, size: float, seed: int) -> Row:
    return values + size * np.random.default_rng(seed).standard_normal(len(values))


def structure_left(found: zo.Identification) -> bool:
    assert found.transient is not None
    return found.transient.tests.has_structure


@pytest.mark.slow
def test_a_drop_without_noise_gives_restitution_and_gravity_to_nine_digits() -> None:
    found = zo.identify(
        "bouncing_ball",
        track(TIMES, heights(TIMES, (0.8, 0.0))),
        ["restitution", "g"],
        parameters={"restitution": 0.6, "g": 8.0},
        on_progress=silent,
    )
    assert found.values.parameters["restitution"] == pytest.approx(0.8, rel=1e-8)
    assert found.values.parameters["g"] == pytest.approx(G, rel=1e-8)
    assert found.closed_orbit is None
    with pytest.raises(zo.InputError, match="transients were fitted"):
        _ = found.orbit


@pytest.mark.slow
def test_the_interval_of_a_noisy_drop_has_the_width_of_its_noise() -> None:
    clean = heights(TIMES, (0.7, 0.0))
    values = [
        zo.identify(
            "bouncing_ball",
            track(TIMES, noisy(clean, 0.005, seed)),
            ["restitution"],
            on_progress=silent,
        ).fitted[0]
        for seed in range(1)
    ]
    for one in values:
        assert one.low < one.value < one.high
        assert one.high - one.low == pytest.approx(2 * 1.96 * one.error, rel=0.1)
        assert abs(one.value - 0.7) < 4 * one.error
        # Of the derivative of the heights with respect to e, which grows from flight to flight.
        assert 1e-4 < one.error < 1e-3


def test_the_sensitivities_of_a_flight_are_those_of_its_closed_form() -> None:
    problem = zo.load_problem("bouncing_ball")
    chosen = [problem.names.index("restitution")]
    graph = problem.graph_dynamics(problem.values(parameters={"restitution": 0.8}))
    motion = moved(graph, np.array([0.5, 0.0]), 1.0, chosen)
    assert motion is not None
    first, speed = math.sqrt(1.0 / G), math.sqrt(G)
    times = first + np.linspace(0.01, 0.45, 9)
    # After the impact z = e v s - g s^2 / 2 with s = t - t1.
    assert motion.at(times).by[:, 0, 2] == pytest.approx(speed * (times - first), rel=1e-9)
    deviated = motion.after_deviation(motion.execution.impacts[0], times)
    assert deviated[:, 0] == pytest.approx(speed * (times - first), rel=1e-9)
    second = motion.events_after_deviation(motion.execution.impacts[0], EventKind.IMPACT, "stop")
    assert second[1] == pytest.approx(2 * speed / G, rel=1e-9)
    # A start that is higher strikes later and faster.
    by_height = motion.events(EventKind.IMPACT, "stop").by[0, 0]
    assert by_height == pytest.approx(1 / math.sqrt(2 * G * 0.5), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_law_of_the_speed_is_told_from_a_constant_restitution(seed: int) -> None:
    wrong, right = (
        zo.identify(
            "bouncing_ball",
            track(TIMES, noisy(heights(TIMES, law), 0.002, seed)),
            ["restitution"],
            on_progress=silent,
        )
        for law in ((0.8, 0.04), (0.75, 0.0))
    )
    assert structure_left(wrong)
    assert wrong.transient is not None
    assert "restitution" in wrong.transient.verdict
    assert wrong.transient.tests.speed_matters == ("stop",)
    assert not structure_left(right)


@pytest.mark.slow
def test_two_drops_share_their_restitution_and_not_their_starts() -> None:
    drops = [
        track(TIMES, noisy(heights(TIMES, (0.7, 0.0), height), 0.003, seed))
        for seed, height in enumerate((0.5, 0.8))
    ]
    both = zo.identify("bouncing_ball", drops, ["restitution"], on_progress=silent)
    one = zo.identify("bouncing_ball", drops[0], ["restitution"], on_progress=silent)
    assert both.transient is not None
    starts = [trial.start["height"] for trial in both.transient.trials]
    assert starts == pytest.approx([0.5, 0.8], abs=0.004)
    assert both.fitted[0].error < 0.9 * one.fitted[0].error
    assert abs(both.fitted[0].value - 0.7) < 4 * both.fitted[0].error


@pytest.mark.slow
def test_a_parameter_without_effect_is_named_and_has_no_interval() -> None:
    found = zo.identify(
        "bouncing_ball",
        track(TIMES, noisy(heights(TIMES, (0.7, 0.0)), 0.003, 3)),
        ["restitution", "m"],
        on_progress=silent,
    )
    assert [one.unknown.label for one in found.fitted if math.isinf(one.error)] == ["m"]
    assert found.unseen[0].text == "`m` is not seen"


def test_a_release_at_an_unknown_time_is_found() -> None:
    late = 0.2
    clean = np.where(late > TIMES, 0.5, heights(np.maximum(TIMES - late, 0.0), (0.7, 0.0)))
    found = zo.identify(
        "bouncing_ball",
        track(TIMES, noisy(clean, 0.002, 5)),
        ["restitution"],
        start={"height": 0.5, "speed": 0.0},
        initial=["offset"],
        on_progress=silent,
    )
    assert found.transient is not None
    assert found.transient.trials[0].offset == pytest.approx(late, abs=1e-3)
    assert abs(found.fitted[0].value - 0.7) < 4 * found.fitted[0].error


@pytest.mark.slow
def test_gain_and_zero_of_a_camera_are_fitted_with_the_restitution() -> None:
    pixels = 1.2 * heights(TIMES, (0.7, 0.0)) + 0.05
    found = zo.identify(
        "bouncing_ball",
        track(TIMES, noisy(pixels, 0.002, 6)),
        ["restitution", "height.gain", "height.offset"],
        transient=True,
        on_progress=silent,
    )
    errors = [one.error for one in found.fitted]
    values = [one.value for one in found.fitted]
    for value, truth, error in zip(values, (0.7, 1.2, 0.05), errors, strict=True):
        assert abs(value - truth) < 4 * error < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("missed", range(1, 7))
def test_a_bounce_that_was_not_heard_is_named(missed: int) -> None:
    times = bounces(9, 0.8)
    found = zo.identify(
        "bouncing_ball",
        heard(np.delete(times, missed)),
        ["restitution"],
        initial=["height"],
        on_progress=silent,
    )
    assert found.transient is not None
    (trial,) = found.transient.trials
    assert [one.partition(",")[0] for one in trial.missed] == [
        f"bounce {missed + 1} at `stop` was not heard"
    ]
    assert trial.false == ()
    assert found.fitted[0].value == pytest.approx(0.8, rel=1e-4)


def test_false_events_and_several_sequences_are_labelled() -> None:
    times = bounces(10, 0.75, scatter=0.01, seed=4)
    false = np.sort(np.append(times, times[3] + 0.03))
    labels = labelled(false)
    assert labels.n_false == 1
    assert labels.numbers[4] is None
    assert [one for one in labels.numbers if one is not None] == list(range(10))
    again = np.concatenate([times, times + times[-1] + 1.0])
    assert [part.stop - part.start for part in sequences_of(again)] == [10, 10]


@pytest.mark.slow
def test_events_of_scattering_impacts_give_the_restitution_and_its_scatter() -> None:
    random = np.random.default_rng(8)
    drops = [
        bounces(11, 0.85, scatter=0.02, seed=seed) + 3e-4 * random.standard_normal(11)
        for seed in range(8)
    ]
    found = zo.identify(
        "bouncing_ball",
        [heard(one) for one in drops],
        ["restitution"],
        initial=["height"],
        on_progress=silent,
    )
    one = found.fitted[0]
    assert abs(one.value - 0.85) < 3 * one.error
    # The mean of 72 ratios of flights with a scatter of 2 % has this error at least.
    assert 0.85 * 0.02 / math.sqrt(72) < one.error * 1.3
    assert found.transient is not None
    assert 0.014 < found.transient.scatter < 0.027


@pytest.mark.slow
def test_edges_of_a_contact_channel_are_events() -> None:
    times = np.arange(0.0, 3.0, 0.001)
    impacts = bounces(12, 0.7, first=0.3)
    closed = np.any(np.abs(times[:, None] - impacts[None, :]) < 0.0015, axis=1)
    closed |= times > impacts[-1] + 0.01
    found = zo.identify(
        "bouncing_ball",
        track(times, closed.astype(np.float64), "contact", "1"),
        ["restitution"],
        transient=True,
        initial=["height"],
        on_progress=silent,
    )
    assert abs(found.fitted[0].value - 0.7) < 4 * found.fitted[0].error < 0.02


def test_a_file_of_one_column_holds_times_of_impacts(tmp_path: Path) -> None:
    path = tmp_path / "drop.csv"
    path.write_text("impact [ms]\n1000\n1400\n1680\n", encoding="utf-8")
    found = read_event_file(path)
    assert found is not None
    assert found.signals[0].name == "impact"
    assert found.time == pytest.approx([1.0, 1.4, 1.68])
    path.write_text("impact [s],release [s]\n1.0,2.5\n1.4,\n", encoding="utf-8")
    found = read_event_file(path)
    assert found is not None
    assert [np.nansum(one.values) for one in found.signals] == pytest.approx([2.4, 2.5])
    path.write_text("time [s],height [m]\n0,1\n1,2\n", encoding="utf-8")
    assert read_event_file(path) is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("impact\n1.0\n1.4\n", "line 1: write the title as `impact [s]`"),
        ("impact [s]\n1.0\nfast\n", "line 3 has `fast` where a time is expected"),
        ("impact [s]\n1.0\n", "fewer than two event times"),
        ("impact [s]\n1.0\n0.5\n", "the times of `impact` decrease from 1 to 0.5 s"),
        ("impact [m],release [s]\n1.0,2.0\n1.5,\n", "write `impact [s]`"),
    ],
)
def test_wrong_files_of_events_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "drop.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(zo.InputError) as error:
        read_event_file(path)
    assert message in str(error.value)


@pytest.mark.slow
def test_a_comparison_tells_right_from_wrong_values_impact_by_impact() -> None:
    drop = track(TIMES, noisy(heights(TIMES, (0.7, 0.0)), 0.002, 9))
    right = zo.compare_transient(
        "bouncing_ball", drop, parameters={"restitution": 0.7}, on_progress=silent
    )
    assert right.agrees
    known = [one for one in right.impacts if math.isfinite(one.recorded)]
    assert len(known) >= 4
    assert max(abs(one.deviation) for one in known) < 2e-3
    assert [one.rms for one in right.flights] == pytest.approx(
        [0.002] * len(right.flights), rel=0.5
    )
    wrong = zo.compare_transient(
        "bouncing_ball", drop, parameters={"restitution": 0.68}, on_progress=silent
    )
    assert not wrong.agrees
    assert max(one.rms for one in wrong.flights) > 0.01
    assert str(wrong.as_json()["verdict"]).startswith("structure is left")


@pytest.mark.slow
def test_settled_recordings_are_still_compared_with_orbits() -> None:
    motion = zo.simulate("vibrating_table", until=10.0)
    recording = zo.sample_execution("vibrating_table", motion, rate=400.0, noise=0.002, seed=1)
    height = replace(recording, signals=recording.signals[:1])
    found = zo.identify(
        "vibrating_table", zo.crop(height, 4.0), ["restitution"], on_progress=silent
    )
    assert found.transient is None
    assert found.orbit.period > 0.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"initial": ["hight"]}, "Did you mean `height`?"),
        ({"initial": ["clock"]}, "the problem lacks a clock"),
        ({"start": {"hight": 1.0}}, "Did you mean `height`?"),
        ({"transient": False, "start": {"height": 1.0}}, "Argument `start` needs transients"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line(given: dict[str, object], message: str) -> None:
    drop = track(TIMES, heights(TIMES, (0.7, 0.0)))
    with pytest.raises(zo.InputError) as error:
        zo.identify("bouncing_ball", drop, ["restitution"], **given)  # type: ignore[arg-type]
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_noise_alone_gives_no_parameters() -> None:
    random = np.random.default_rng(2)
    noise = track(TIMES, np.abs(random.standard_normal(len(TIMES))))
    with pytest.raises(zo.ZenoOrbitsError, match="off"):
        zo.identify("bouncing_ball", noise, ["restitution"], transient=True, on_progress=silent)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "fit", "start", "signals", "until", "rate"),
    [
        ("clapper", ["restitution", "k"], {"place": 0.1, "cosine": 1.0}, (0, 1), 3.0, 200.0),
        (
            "motor_pendulum",
            ["restitution", "R"],
            {"theta1": 1.0, "theta2": 0.9},
            (0, 1, 4),
            2.0,
            250.0,
        ),
        ("relay", ["restitution", "ks"], None, (0, 2), 0.02, 4e4),
    ],
)
def test_machines_of_one_and_several_stops_are_found_from_20_per_cent_off(
    name: str,
    fit: list[str],
    start: dict[str, float] | None,
    signals: tuple[int, ...],
    until: float,
    rate: float,
) -> None:
    problem = zo.load_problem(name)
    truth = problem.values()
    motion = zo.simulate(problem, until=until, start=start)
    recording = zo.sample_execution(problem, motion, rate=rate, noise=0.003, seed=3)
    kept = replace(recording, signals=tuple(recording.signals[k] for k in signals))
    begin = problem.values(
        parameters={**truth.parameters, **{one: 1.2 * truth.parameters[one] for one in fit}}
    )
    sought = [
        sought_in(one, begin.parameters[one] / 3, min(3 * begin.parameters[one], 0.98))
        if one == "restitution"
        else sought_in(one, begin.parameters[one] / 3, 3 * begin.parameters[one])
        for one in fit
    ]
    found = fit_transient_parameters(problem, begin, [("step", kept)], sought)
    for one in found.fitted:
        assert abs(one.value - truth.parameters[one.unknown.label]) < 4 * one.error
    assert not structure_left(found)


def sought_in(name: str, lower: float, upper: float) -> FitParameter:
    return FitParameter(names=(name,), lower=lower, upper=upper)


@pytest.mark.parametrize(
    ("recording", "message"),
    [
        (track(TIMES, 100 * heights(TIMES, (0.7, 0.0))), "signals' ranges off"),
        (track(TIMES, -heights(TIMES, (0.7, 0.0))), "signals' ranges off"),
        (track(TIMES, np.full(len(TIMES), 0.3)), "no signal of trial 1 changes"),
        (track(TIMES, np.full(len(TIMES), np.nan)), "all samples of trial 1 are missing"),
        (track(TIMES[:5], heights(TIMES[:5], (0.7, 0.0))), "fewer than 8 samples"),
        (heard(bounces(9, 0.8)), "--initial NAME"),
        (track(TIMES, TIMES, "impact left", "s"), "Did you mean `impact stop`?"),
        (track(TIMES, TIMES, "impact", "m"), "in s, not in m"),
    ],
)
def test_recordings_that_show_no_drop_are_refused(recording: zo.Recording, message: str) -> None:
    with pytest.raises(zo.ZenoOrbitsError) as error:
        zo.identify("bouncing_ball", recording, ["restitution"], transient=True, on_progress=silent)
    assert message in str(error.value)


@pytest.mark.slow
def test_events_without_a_law_leave_structure() -> None:
    random = np.random.default_rng(1)
    rows: list[Row] = [np.sort(random.uniform(0.0, 5.0, 15)), 1.0 + 0.3 * np.arange(12.0)]
    for times in rows:
        found = zo.identify(
            "bouncing_ball", heard(times), ["restitution"], initial=["height"], on_progress=silent
        )
        assert structure_left(found)


@pytest.mark.slow
def test_as_many_unknowns_as_data_give_no_interval() -> None:
    found = zo.identify(
        "bouncing_ball",
        heard(bounces(3, 0.7)),
        ["restitution"],
        initial=["height"],
        on_progress=silent,
    )
    assert found.fitted[0].value == pytest.approx(0.7)
    assert math.isinf(found.fitted[0].error)
    assert found.transient is not None
    assert found.transient.verdict.startswith("the model is not tested")


@pytest.mark.slow
def test_event_times_of_two_stops_and_releases_give_two_parameters() -> None:
    problem = zo.load_problem("relay")
    truth = problem.values().parameters
    motion = zo.simulate(problem, until=0.036)
    columns: dict[str, list[float]] = {}
    for kind, events in (("impact", motion.impacts), ("release", motion.releases)):
        for event in events:
            own = columns.setdefault(f"{kind} {event.stop}", [])
            # Bounces of less than 20 microseconds are not heard.
            if event.time > 0.0 and (not own or event.time - own[-1] > 2e-5):
                own.append(event.time)
    random = np.random.default_rng(1)
    rows = {
        name: np.sort(np.array(own) + 1e-6 * random.standard_normal(len(own)))
        for name, own in columns.items()
    }
    every = np.unique(np.concatenate(list(rows.values())))
    recording = zo.Recording(
        source=None,
        problem="relay",
        time=every,
        signals=tuple(
            RecordedSignal(name=name, unit="s", values=np.where(np.isin(every, row), every, np.nan))
            for name, row in rows.items()
        ),
    )
    begin = {name: 1.15 * truth[name] for name in ("restitution", "ks")}
    found = zo.identify("relay", recording, list(begin), parameters=begin, on_progress=silent)
    for one in found.fitted:
        true = truth[one.unknown.label]
        assert abs(one.value - true) < 4 * one.error < 0.05 * true
    assert found.transient is not None
    assert found.transient.trials[0].missed == ()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [7, 31])
def test_a_velocity_with_hidden_impacts_leads_to_the_true_optimum(seed: int) -> None:
    """Noise hides the impacts in the position, and the velocity has samples beside them."""
    random = np.random.default_rng(seed)
    truth = {
        name: value * float(random.uniform(0.9, 1.1))
        for name, value in {"restitution": 0.3, "k": 1.0, "c": 0.1}.items()
    }
    motion = zo.simulate(
        "clapper", until=3.0, parameters=truth, start={"place": 0.1, "cosine": 1.0}
    )
    sampled = zo.sample_execution(
        "clapper", motion, parameters=truth, rate=100.0, noise=0.02, seed=seed
    )
    kept = tuple(one for one in sampled.signals if one.name in ("place", "speed"))
    begin = {name: 1.2 * value for name, value in truth.items()}
    found = zo.identify(
        "clapper",
        replace(sampled, signals=kept),
        list(truth),
        parameters=begin,
        transient=True,
    )
    detail = found.transient
    assert detail is not None
    assert detail.trials[0].seen_impacts < len(detail.trials[0].impacts)
    assert not detail.tests.has_structure
    # The other optima leave residuals of 1.2 times the noise.
    assert detail.tests.misfit < 1.15
    for one in found.fitted:
        if math.isfinite(one.error):
            assert abs(one.value - truth[one.unknown.label]) < 4 * one.error


@pytest.mark.slow
@pytest.mark.parametrize("held", [0.0, 0.06, 0.25])
def test_samples_before_the_release_are_named_with_the_time_that_leaves_them_out(
    held: float,
) -> None:
    clean = heights(np.maximum(TIMES - held, 0.0), (0.7, 0.0 if held else 0.05))
    recording = track(TIMES, noisy(clean, 1e-3, 2))
    found = zo.identify("bouncing_ball", recording, ["restitution"], on_progress=silent)
    assert structure_left(found)
    told = [one for one in found.remarks if "--t-start" in one]
    assert len(told) == (1 if held else 0)
    for one in told:
        begin = float(one.rpartition(" ")[2])
        assert begin == pytest.approx(held, abs=0.015)
        cropped = zo.crop(recording, begin)
        again = zo.identify("bouncing_ball", cropped, ["restitution"], on_progress=silent)
        assert not structure_left(again)
        assert again.values.parameters["restitution"] == pytest.approx(0.7, abs=0.005)
