"""The contact channel of a recording: zeros and ones, from the rig and from files."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.orbits import event_orbit
from zeno_orbits.experiment import RecordedSignal, Recording, contact_channels

RATE = 1e5
STOPS = ("closed", "open")


@cache
def _run() -> zo.RigRun:
    rig = zo.Rig(contact=zo.Contact(stiffness=1e7))
    settings = zo.RigSettings(spacing=1 / RATE)
    return zo.simulate_rig("relay", rig, until=0.04, settings=settings)


@pytest.mark.slow
def test_the_channel_of_every_stop_is_one_from_the_begin_of_a_contact_to_its_end() -> None:
    run = _run()
    recording = zo.rig_recording(run)
    assert recording.names == ("z", "current", "voltage", "contact.closed", "contact.open")
    assert recording.time == pytest.approx(np.arange(4001) / RATE)
    for stop in STOPS:
        values = recording.signal(f"contact.{stop}").values
        for touch in (one for one in run.touches if one.stop == stop):
            inside = (recording.time >= touch.start) & (recording.time < touch.end)
            assert np.all(values[inside] == 1.0)
            values = np.where(inside, 0.0, values)
        assert not np.any(values)
    # Independent of the contacts: a touched stop is pressed.
    gap = recording.signal("z").values
    assert np.all((gap < 0.0) == (recording.signal("contact.closed").values == 1.0))


def test_noise_is_on_every_signal_but_the_channels() -> None:
    clean, noisy = zo.rig_recording(_run()), zo.rig_recording(_run(), noise=0.01, seed=3)
    for name in clean.names:
        difference = noisy.signal(name).values - clean.signal(name).values
        if name.startswith("contact"):
            assert not np.any(difference)
        else:
            size = np.std(difference) / np.ptp(clean.signal(name).values)
            # The standard deviation of 4000 samples is known to 1.1 %.
            assert size == pytest.approx(0.01, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bouncing_ball", "motor_pendulum"])
def test_a_machine_with_one_stop_has_one_channel(name: str) -> None:
    run = zo.simulate_rig(name, until=1.5)
    recording = zo.rig_recording(run)
    values = recording.signal("contact").values
    during = [
        any(touch.start <= time < touch.end for touch in run.touches) for time in recording.time
    ]
    assert np.array_equal(values == 1.0, during)
    assert 0.0 < np.mean(values) < 1.0


def test_a_file_gives_back_the_channels(tmp_path: Path) -> None:
    recording = zo.rig_recording(_run())
    zo.write_recording(recording, tmp_path / "relay.csv")
    again = zo.read_recording(tmp_path / "relay.csv")
    found = contact_channels(again, STOPS)
    assert set(found) == set(STOPS)
    assert all(
        np.array_equal(found[stop], recording.signal(f"contact.{stop}").values) for stop in STOPS
    )


def _with_channel(name: str, values: list[float], unit: str = "1") -> Recording:
    signal = RecordedSignal(name=name, unit=unit, values=np.array(values))
    return Recording(
        source=None, problem="", time=np.linspace(0.0, 1.0, len(values)), signals=(signal,)
    )


@pytest.mark.parametrize(
    ("name", "values", "unit", "words"),
    [
        ("contact.closed", [0.0, 0.5, 1.0], "1", "contact channel .* 0.5. Write 1 where"),
        ("contact.closed", [0.0, 1.0, 2.0], "1", "but it has 2"),
        ("contact.closed", [0.0, 1.0, 1.0], "V", "the unit V"),
        ("contact.close", [0.0, 1.0, 1.0], "1", "`contact.close`.*mean `contact.closed`"),
        ("contact", [0.0, 1.0, 1.0], "1", "contact channel: unknown name `contact`.*contact.open"),
    ],
)
def test_a_false_channel_is_refused_in_one_line(
    name: str, values: list[float], unit: str, words: str
) -> None:
    with pytest.raises(zo.InputError, match=words) as refused:
        contact_channels(_with_channel(name, values, unit), STOPS)
    assert "\n" not in str(refused.value)


def test_missing_samples_of_a_channel_stay_missing() -> None:
    values = contact_channels(_with_channel("contact.open", [0.0, np.nan, 1.0]), STOPS)["open"]
    assert np.isnan(values[1])


@pytest.mark.slow
def test_samples_of_a_controller_have_their_own_rate_and_noise() -> None:
    run = zo.simulate_rig("motor_pendulum", until=0.1)
    with pytest.raises(zo.InputError, match=r"`noise` must be left out .* sensors have their own"):
        zo.rig_recording(run, noise=0.1)
    for noise in (-0.1, 1.0, 5.0, float("nan"), float("inf")):
        with pytest.raises(zo.InputError, match=r"`noise` must lie in \[0, 1\), relative to"):
            zo.rig_recording(_run(), noise=noise)


@pytest.mark.slow
def test_periods_near_an_orbit_repeat_its_first_impacts() -> None:
    orbit = event_orbit("relay", "zeno open")
    rig = zo.Rig(contact=zo.Contact(stiffness=1e9))
    run = zo.simulate_periods(orbit, rig=rig, periods=2, settle=1)
    closed = next(event.time for event in orbit.events if event.name == "impact closed")
    found = [touch.start for touch in run.touches if touch.stop == "closed"]
    first = [time for k, time in enumerate(found) if k == 0 or time - found[k - 1] > 0.01]
    # A dent of a nanometre delays the contact by microseconds.
    assert first == pytest.approx([closed, closed + orbit.period], abs=1e-5)
    assert run.times[-1] == pytest.approx(2 * orbit.period)
    with pytest.raises(zo.InputError, match="`periods` must be at least 1"):
        zo.simulate_periods(orbit, rig=rig, periods=0)


@pytest.mark.slow
def test_periods_near_an_orbit_of_one_stop_repeat_its_first_impacts() -> None:
    orbit = event_orbit("vibrating_table")
    run = zo.simulate_periods(orbit, periods=2, settle=1)
    first = [min(t.start for t in run.touches if t.start > late) for late in (0.0, orbit.period)]
    struck = orbit.impacts[0].time
    # A stiff stop is struck a little later.
    assert first == pytest.approx([struck, struck + orbit.period], abs=1e-7)
    assert {touch.stop for touch in run.touches} == {"stop"}


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "truth"), [(1e5, 0.257), (1e6, 0.286), (1e7, 0.294)])
def test_the_restitution_off_a_compliant_stop_has_its_whole_error(
    stiffness: float, truth: float
) -> None:
    """The truth is the ratio of speeds of quadratic fits beside the contact, without noise."""
    orbit = zo.find_orbit("vibrating_table").unwrap()
    rig = zo.Rig(contact=zo.Contact(stiffness=stiffness))
    settings = zo.RigSettings(spacing=5e-5)
    run = zo.simulate_rig(
        "vibrating_table", rig, until=8 * orbit.period, start=orbit.start_state, settings=settings
    )
    found = zo.compare(orbit, zo.rig_recording(run, noise=0.003, seed=1))
    assert found.agrees
    seen = found.metric("restitution seen")
    assert abs(seen.data - truth) < 2.5 * seen.error
