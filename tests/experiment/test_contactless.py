"""`compare` and `identify` on orbits without contact, whose recordings SciPy or a formula makes."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.commands import NO, YES, ask
from tests.support.contactless import (
    Motion,
    duffing,
    duffing_motion,
    escapement,
    escapement_motion,
    wheel,
    wheel_motion,
)
from zeno_orbits.arrays import Vector
from zeno_orbits.experiment import (
    ComparisonVerdict,
    RecordedSignal,
    Recording,
    Source,
    UnfittableError,
)

MACHINES: dict[str, tuple[Callable[[], zo.Problem], Callable[..., tuple[float, Motion]]]] = {
    "wheel": (wheel, wheel_motion),
    "escapement": (escapement, escapement_motion),
    "duffing": (duffing, duffing_motion),
}
THIS, NONE = ComparisonVerdict.THIS_ORBIT, ComparisonVerdict.NO_ORBIT


@cache
def _orbit(name: str) -> tuple[zo.Problem, zo.Orbit]:
    problem = MACHINES[name][0]()
    return problem, zo.find_orbit(problem).unwrap()


def _recording(
    name: str,
    motions: tuple[tuple[float, Motion], ...],
    *,
    noise: float = 2e-3,
    samples: float = 150.37,
    cycles: float = 12.3,
    chosen: tuple[str, ...] = (),
    channel: float | None = None,
    seed: int = 0,
) -> Recording:
    """Return a recording of one motion, or of several in turn."""
    problem, random = _orbit(name)[0], np.random.default_rng(seed)
    ends = np.cumsum([one[0] for one in motions])
    time = 3.0 + np.asarray(
        np.arange(int(samples * cycles)) * motions[0][0] / samples, dtype=np.float64
    )
    since = np.mod(time - 2.9, ends[-1])
    turn = np.searchsorted(ends, since, side="right")
    values = np.zeros((len(time), len(problem.state_names)))
    for k, (period, states) in enumerate(motions):
        values[turn == k] = states(since[turn == k] - ends[k] + period)
    values += noise * np.ptp(values, axis=0) * random.normal(size=values.shape)
    signals = [
        RecordedSignal(name=one, unit=unit, values=values[:, k])
        for k, (one, unit) in enumerate(zip(problem.state_names, problem.state_units, strict=True))
        if one in (chosen or {"q", "x", "v"})
    ]
    if channel is not None:
        row = np.full(len(time), channel)
        signals.append(RecordedSignal(name="contact", unit="1", values=row))
    return Recording(source=Source.MEASURED, problem=name, time=time, signals=tuple(signals))


def _compared(name: str, recording: Recording) -> zo.Comparison:
    problem, orbit = _orbit(name)
    return zo.compare(orbit, recording, problem=problem)


@pytest.mark.parametrize("chosen", [(), ("v",)], ids=["all", "speed"])
@pytest.mark.parametrize("name", fast(2, MACHINES))
def test_a_recording_of_the_orbit_shows_it(name: str, chosen: tuple[str, ...]) -> None:
    own = MACHINES[name][1]()
    found = _compared(name, _recording(name, (own,), chosen=chosen))
    assert found.verdict is THIS, (found.reasons, found.unresolved, found.differences)
    assert not found.differences
    period = found.metric("period")
    assert abs(period.data - own[0]) < 4 * period.error < 1e-3 * own[0]


OTHERS = [
    ("wheel", {"slope": 0.09}, "period"),
    ("escapement", {"k": 9.0 * 1.05}, "period"),
    # The push changes the size alone.
    ("escapement", {"push": 1.1}, "highest of x"),
    ("duffing", {"omega": 1.1 * 1.05}, "period"),
    ("duffing", {"amplitude": 0.23}, "highest of x"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "changed", "first"), fast(1, OTHERS))
def test_another_controller_is_not_this_orbit_and_the_first_difference_is_named(
    name: str, changed: dict[str, float], first: str
) -> None:
    other, own = MACHINES[name][1](**changed), MACHINES[name][1]()
    found = _compared(name, _recording(name, (other,)))
    assert found.verdict is ComparisonVerdict.UNDECIDED
    assert not found.agrees
    assert any("accumulating impacts" in why for why in found.unresolved)
    assert found.differences[0].name == first
    period = found.metric("period")
    assert abs(period.data - other[0]) < 5 * period.error
    # The extremes are those of the other motion.
    grid = np.arange(20000) / 20000
    for k, signal in enumerate(found.signals):
        highest = float(np.max(other[1](grid * other[0])[:, k]))
        size = float(np.ptp(own[1](grid * own[0])[:, k]))
        assert abs(found.metric(f"highest of {signal}").data - highest) < 0.08 * size


@pytest.mark.parametrize("name", fast(1, MACHINES))
def test_a_recording_reversed_in_time_is_no_orbit(name: str) -> None:
    forward = _recording(name, (MACHINES[name][1](),))
    signals = tuple(replace(one, values=one.values[::-1].copy()) for one in forward.signals)
    found = _compared(name, replace(forward, signals=signals))
    assert found.verdict is NONE
    assert "backward" in found.reasons[0] or "sign reversed" in found.reasons[0]


@pytest.mark.slow
def test_eight_bits_hide_no_difference_that_is_larger_than_half_a_step() -> None:
    exact = _recording("escapement", (escapement_motion(),), chosen=("x",), samples=312.8)
    row = exact.signals[0].values
    step = float(np.ptp(row)) / 256
    rounded: Vector = step * np.rint(row / step)
    verdicts: dict[int, zo.Comparison] = {}
    for direction in (1, -1):
        signal = replace(exact.signals[0], values=rounded[::direction].copy())
        verdicts[direction] = _compared("escapement", replace(exact, signals=(signal,)))
    assert verdicts[1].verdict is THIS
    # Root mean square of x(t) - x(s - t) at the best s, by correlation of 20,000 exact samples.
    assert verdicts[-1].metric("rms deviation of x").data == pytest.approx(0.0085466, rel=0.05)
    assert "backward" in verdicts[-1].reasons[0]


@pytest.mark.parametrize(
    ("name", "changed"),
    fast(
        1,
        [
            ("wheel", {"slope": 0.09}),
            ("escapement", {"push": 1.2}),
            ("duffing", {"amplitude": 0.24}),
        ],
    ),
)
def test_two_orbits_in_turn_are_a_doubled_period(name: str, changed: dict[str, float]) -> None:
    motion = MACHINES[name][1]
    found = _compared(name, _recording(name, (motion(), motion(**changed)), cycles=20.3))
    assert not found.agrees
    assert found.verdict in {NONE, ComparisonVerdict.UNDECIDED}


@pytest.mark.slow
def test_the_orbit_in_the_other_well_is_not_this_orbit() -> None:
    found = _compared("duffing", _recording("duffing", (duffing_motion(-1.0),)))
    assert found.verdict is NONE
    assert "sign reversed" in found.reasons[0]


def test_a_clock_alone_decides_nothing() -> None:
    clock_alone = _recording("duffing", (duffing_motion(),), chosen=("cosine", "sine"))
    found = _compared("duffing", clock_alone)
    assert found.verdict is ComparisonVerdict.UNDECIDED
    assert "cosine, sine depend on the clock alone" in found.unresolved[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", fast(1, MACHINES))
def test_the_deviation_at_every_phase_is_the_one_that_was_added(name: str) -> None:
    own = MACHINES[name][1]()
    exact = _recording(name, (own,), noise=0.0, samples=960.37)
    first = exact.signals[0]
    phases = (exact.time - 2.9) / own[0]
    bump = 0.03 * np.ptp(first.values) * np.exp(-(((phases % 1.0 - 0.5) / 0.05) ** 2))
    changed = replace(first, values=first.values + bump)
    found = _compared(name, replace(exact, signals=(changed, *exact.signals[1:])))
    assert found.deviations is not None
    assert found.where is not None
    largest = np.nanmax(found.deviations.average[:, 0])
    assert largest == pytest.approx(float(bump.max()), rel=0.1)
    assert np.nanmax(np.abs(found.deviations.average[:, 1])) < 0.05 * np.ptp(
        exact.signals[1].values
    )
    assert not found.agrees


@pytest.mark.slow
def test_the_place_of_an_orbit_whose_signals_jump_is_as_sure_as_is_said() -> None:
    # The period starts at 2.9 s, and the angle alone is recorded, which jumps back at every spoke.
    period, scores = wheel_motion()[0], list[float]()
    for seed in range(16):
        found = _compared("wheel", _recording("wheel", (wheel_motion(),), chosen=("q",), seed=seed))
        assert found.where is not None
        late = (found.where.release - 2.9 + period / 2) % period - period / 2
        scores.append(late / found.where.error)
        delay = found.metric("delay of q")
        assert abs(delay.data) < delay.error
    # The size of sixteen deviations is known to 18 %.
    assert 0.5 < float(np.sqrt(np.mean(np.square(scores)))) < 1.6


def test_an_orbit_of_two_turns_is_compared_over_both() -> None:
    problem, once = _orbit("wheel")
    again = tuple(replace(one, time=one.time + once.period) for one in once.events)
    twice = replace(once, period=2 * once.period, events=(*once.events, *again))
    found = zo.compare(twice, _recording("wheel", (wheel_motion(),)), problem=problem)
    assert found.verdict is THIS, (found.reasons, found.differences)
    assert found.metric("period").data == pytest.approx(2 * wheel_motion()[0], rel=1e-4)


# A stop that is never reached.


@pytest.mark.parametrize("name", ["escapement", pytest.param("duffing", marks=pytest.mark.slow)])
def test_a_channel_of_a_stop_that_is_never_reached_agrees(name: str) -> None:
    own = MACHINES[name][1]()
    assert _compared(name, _recording(name, (own,), channel=0.0)).verdict is THIS
    found = _compared(name, _recording(name, (own,), channel=1.0))
    assert found.verdict is NONE
    assert "the orbit does not touch it" in found.reasons[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "word", "start", "true"),
    fast(
        1,
        [
            ("escapement", "c", 0.41, 0.4),
            ("duffing", "c", 1.55, 1.5),
        ],
    ),
)
def test_identify_takes_a_channel_of_a_stop_that_is_never_reached(
    name: str, word: str, start: float, true: float
) -> None:
    recording = _recording(name, (MACHINES[name][1](),), channel=0.0)
    found = zo.identify(_orbit(name)[0], recording, [word], parameters={word: start})
    (one,) = found.fitted
    assert abs(one.value - true) < 4 * one.error < 0.02 * true
    touched = _recording(name, (MACHINES[name][1](),), channel=1.0)
    with pytest.raises(UnfittableError, match="does not touch it"):
        zo.identify(_orbit(name)[0], touched, [word], parameters={word: start})


# The command, the picture and long recordings.

FILE = """from tests.support.contactless import wheel

PROBLEM = wheel()
"""


@pytest.mark.slow
def test_the_command_prints_words_and_draws(tmp_path: Path) -> None:
    _, orbit = _orbit("wheel")
    (tmp_path / "wheel.py").write_text(FILE)
    zo.write_orbit(orbit, tmp_path / "orbit.json")
    short = _recording("wheel", (wheel_motion(),), cycles=0.4)
    answers = {
        "The recording shows this orbit": (_recording("wheel", (wheel_motion(),)), YES),
        "The recording does not show this orbit": (_recording("wheel", (wheel_motion(0.09),)), NO),
        "The recording does not show an orbit of this machine": (short, NO),
    }
    for words, (recording, code) in answers.items():
        zo.write_recording(recording, tmp_path / "data.csv")
        command = ("compare", tmp_path / "orbit.json", tmp_path / "data.csv")
        words_of = (*command, "--problem", tmp_path / "wheel.py", "--plot", tmp_path / "p.png")
        answer = ask(*words_of)
        assert answer.code == code, answer.err
        lines = answer.out.splitlines()
        assert words in lines[0]
        assert "Zeno" not in answer.out
        if recording is short:
            assert "Nothing was drawn" in answer.out
            continue
        assert code == YES or lines[1].strip().startswith("period 0.8575")
        assert (tmp_path / "p.png").stat().st_size > 10_000
        (tmp_path / "p.png").unlink()


@pytest.mark.slow
def test_a_recording_is_compared_in_time_linear_in_its_rows(tmp_path: Path) -> None:
    def seconds(cycles: float) -> float:
        long = _recording("escapement", (escapement_motion(),), cycles=cycles, samples=40.0)
        # The stop closes for a moment in every cycle.
        row = (np.arange(len(long.time)) % 40 < 4).astype(np.float64)
        contact = RecordedSignal(name="contact", unit="1", values=row)
        zo.write_recording(replace(long, signals=(*long.signals, contact)), tmp_path / "long.csv")
        problem, orbit = _orbit("escapement")
        begin = clock.process_time()
        zo.compare(orbit, tmp_path / "long.csv", problem=problem)
        return clock.process_time() - begin

    seconds(100.0)
    assert seconds(12000.0) < 6 * seconds(3000.0)
