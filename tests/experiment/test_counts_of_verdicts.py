"""Counts of verdicts on many recordings of machines with several stops, and without contact.

A recording of the orbit must not be called another motion, and a recording of another motion must
not be called the orbit. The truths do not use the package: two-sided oscillators, a wheel, an
escapement and a driven oscillator move by closed forms or SciPy. Relays with contact phases are
simulated, with channels from their events.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from itertools import count

import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference.several_stops import TwoSided, two_sided
from tests.support.contactless import (
    Motion,
    duffing,
    duffing_motion,
    escapement,
    escapement_motion,
    wheel,
    wheel_motion,
)
from tests.support.mechanisms import machine_of, walled_oscillator
from zeno_orbits.arrays import Vector
from zeno_orbits.experiment import ComparisonVerdict, RecordedSignal, Recording, Source

THIS, OPEN = ComparisonVerdict.THIS_ORBIT, ComparisonVerdict.UNDECIDED
Case = tuple[zo.Problem, zo.Orbit, Recording]

LINE = {"x": "m", "dx": "m/s", "cosine": "1", "sine": "1"}


def _sampled(
    problem: zo.Problem, period: float, states: Motion, names: tuple[str, ...], seed: int
) -> Recording:
    """Return a recording of some states of a motion, with noise, at uneven phases."""
    random = np.random.default_rng(seed)
    cycles, per = random.uniform(9.0, 16.0), random.uniform(120.0, 300.0)
    begin, steps = random.uniform(0.0, 5.0), np.arange(int(cycles * per), dtype=np.float64)
    time: Vector = np.asarray(begin + steps * period / per, dtype=np.float64)
    begin = random.uniform(0.0, period)
    values = states(np.mod(time - time[0] + begin, period))
    values = values + random.uniform(1e-4, 3e-3) * np.ptp(values, axis=0) * random.normal(
        size=values.shape
    )
    places = [problem.state_names.index(name) for name in names]
    signals = tuple(
        RecordedSignal(name=name, unit=problem.state_units[k], values=values[:, k])
        for name, k in zip(names, places, strict=True)
    )
    return Recording(source=Source.MEASURED, problem=problem.name, time=time, signals=signals)


def _reversed(recording: Recording) -> Recording:
    signals = tuple(replace(one, values=one.values[::-1].copy()) for one in recording.signals)
    return replace(recording, signals=signals)


# Two-sided oscillators: two stops, impacts and no contact phase.


@cache
def _oscillators() -> tuple[TwoSided, ...]:
    """Return twenty oscillators with a stable orbit."""
    drawn = (two_sided(np.random.default_rng(seed)) for seed in count())
    stable = (one for one in drawn if max(abs(one.multipliers)) < 0.9)
    return tuple(next(stable) for _ in range(20))


def _both_halves(o: TwoSided) -> Motion:
    """Return the motion over a period: the second half is the first with the sign changed."""

    def states(times: Vector) -> Vector:
        rows = [[*o.state(t % o.half), 0.0, 0.0] for t in times.tolist()]
        signs = np.where(times < o.half, 1.0, -1.0)
        return np.array(rows) * signs[:, None]

    return states


@cache
def _oscillator(k: int) -> tuple[zo.Problem, zo.Orbit]:
    """Return an oscillator and its orbit."""
    o = _oscillators()[k]
    numbers = {
        "c": o.c,
        "omega": o.omega,
        "d": o.stop,
        "restitution": o.restitution,
        "A": o.amplitude,
    }
    problem = machine_of(lambda p: walled_oscillator(p, upper=1, lower=-1), LINE, numbers)
    x, v = o.state(0.4 * o.half)
    angle = o.omega * 0.4 * o.half + o.phase
    start = {"x": x, "dx": v, "cosine": math.cos(angle), "sine": math.sin(angle)}
    return problem, zo.find_orbit(problem, start=start).unwrap()


def _oscillator_case(k: int, seed: int, **changed: float) -> Case:
    """Return an oscillator with a recording of it, or of one with other values."""
    o = replace(_oscillators()[k], **changed)
    problem, orbit = _oscillator(k)
    names = ("x", "dx") if seed % 2 else ("x",)
    return problem, orbit, _sampled(problem, 2 * o.half, _both_halves(o), names, seed)


def _other_oscillator(k: int, seed: int) -> Case:
    """Return an oscillator with a recording of the orbit of another impact speed."""
    o = _oscillators()[k]
    problem, orbit = _oscillator(k)
    other = next(
        one
        for one in (two_sided(np.random.default_rng(1000 * k + n)) for n in count())
        if abs(one.half / o.half - 1) > 0.05
    )
    # The period is that of the orbit, and the motion that of another machine.
    states = _both_halves(other)
    scale = other.half / o.half
    recording = _sampled(
        problem, 2 * o.half, lambda t: states(t * scale) * (o.stop / other.stop), ("x",), seed
    )
    return problem, orbit, recording


# Motions that touch no stop.

FREE: Mapping[
    str,
    tuple[Callable[[], zo.Problem], Callable[..., tuple[float, Motion]], dict[str, str]],
] = {
    "wheel": (wheel, wheel_motion, {"slope": "slope", "length": "l"}),
    "escapement": (escapement, escapement_motion, {"k": "k", "push": "F"}),
    "duffing": (duffing, duffing_motion, {"amplitude": "A", "omega": "omega"}),
}


@cache
def _free(name: str, numbers: tuple[tuple[str, float], ...]) -> tuple[zo.Problem, zo.Orbit]:
    problem, _, names = FREE[name]
    parameters = {names[word]: value for word, value in numbers}
    return problem(), zo.find_orbit(problem(), parameters=parameters).unwrap()


USUAL = {
    "wheel": {"slope": 0.08, "length": 1.0},
    "escapement": {"k": 9.0, "push": 1.0},
    "duffing": {"amplitude": 0.2, "omega": 1.1},
}


def _free_case(name: str, seed: int, factor: float = 1.0) -> Case:
    """Return a machine with a recording of it, or with one of its numbers changed."""
    random = np.random.default_rng(seed)
    own = {word: value * random.uniform(0.97, 1.03) for word, value in USUAL[name].items()}
    problem, orbit = _free(name, tuple(own.items()))
    word = list(own)[seed % 2]
    period, states = FREE[name][1](**(own | {word: own[word] * factor}))
    names = tuple(one for one in problem.state_names if one not in {"cosine", "sine"})
    return problem, orbit, _sampled(problem, period, states, names[: 1 + seed % 2], seed)


# A relay: two stops with contact phases, a field and channels.


@cache
def _relay(numbers: tuple[tuple[str, float], ...] = ()) -> zo.Orbit:
    return zo.find_orbit("relay", parameters=dict(numbers), section="zeno open").unwrap()


def _relay_case(seed: int, **changed: float) -> Case:
    """Return a relay with channels and one signal, of it or of one with other values."""
    random, problem = np.random.default_rng(seed), zo.load_problem("relay")
    shown, orbit = _relay(tuple(changed.items())), _relay()
    rate = random.uniform(9e4, 1.5e5)
    time = random.uniform(0.0, 0.1) + np.arange(int(4.2 * shown.period * rate)) / rate
    run = zo.simulate(
        "relay", until=1.001 * shown.period, start=dict(shown.start_state), parameters=changed
    )
    begin = random.uniform(0.0, shown.period)
    since = np.mod(time - time[0] + begin, shown.period)
    signals = [
        RecordedSignal(name=f"contact.{stop}", unit="1", values=_channel(shown, stop, since))
        for stop in ("closed", "open")
    ]
    name = ("z", "flux")[seed % 2]
    k = problem.state_names.index(name)
    values = run.states_at(since)[:, k]
    values = values + 1e-3 * np.ptp(values) * random.normal(size=len(values))
    signals.append(RecordedSignal(name=name, unit=problem.state_units[k], values=values))
    recording = Recording(
        source=Source.MEASURED, problem="relay", time=time, signals=tuple(signals)
    )
    return problem, orbit, recording


def _channel(orbit: zo.Orbit, stop: str, since: Vector, contact: float = 6e-5) -> Vector:
    """Return the channel of a stop, whose contacts between two bounces have one duration."""
    times = {
        kind: [one.time for one in orbit.events if one.name == f"{kind} {stop}"]
        for kind in ("impact", "release")
    }
    impacts, (release,) = times["impact"], times["release"]
    begins = impacts[: 1 + int(np.sum(np.diff(impacts) > contact))]
    lasts = [*(contact for _ in begins[:-1]), (release - begins[-1]) % orbit.period]
    touched = [
        np.mod(since - begin, orbit.period) < last
        for begin, last in zip(begins, lasts, strict=True)
    ]
    return np.any(touched, axis=0).astype(np.float64)


def _exchanged(case: Case) -> Case:
    problem, orbit, recording = case
    names = {"contact.closed": "contact.open", "contact.open": "contact.closed"}
    signals = tuple(replace(one, name=names.get(one.name, one.name)) for one in recording.signals)
    return problem, orbit, replace(recording, signals=signals)


def _true_cases() -> Iterator[tuple[str, Case]]:
    """Yield 100 recordings of the orbit."""
    for k in range(20):
        for seed in (2 * k, 2 * k + 1):
            yield f"oscillator {k} {seed}", _oscillator_case(k, seed)
    for name in FREE:
        for seed in range(12):
            yield f"{name} {seed}", _free_case(name, seed)
    for seed in range(24):
        yield f"relay {seed}", _relay_case(seed)


def _false_cases() -> Iterator[tuple[str, Case]]:
    """Yield 60 recordings of other motions."""
    for k in range(6):
        yield f"oscillator {k} other", _other_oscillator(k, k)
        problem, orbit, recording = _oscillator_case(k, k)
        yield f"oscillator {k} reversed", (problem, orbit, _reversed(recording))
    for name in FREE:
        for seed, factor in enumerate((0.85, 0.9, 1.1, 1.15, 0.93, 1.07)):
            yield f"{name} {seed} x {factor}", _free_case(name, seed, factor)
        for seed in (20, 21, 22, 23):
            problem, orbit, recording = _free_case(name, seed)
            yield f"{name} {seed} reversed", (problem, orbit, _reversed(recording))
    for seed, restitution in enumerate((0.2, 0.25, 0.35, 0.4, 0.45, 0.5)):
        yield f"relay e={restitution}", _relay_case(seed, restitution=restitution)
    for seed in range(6):
        yield f"relay {seed} reversed", _turned(_relay_case(seed))
        yield f"relay {seed} exchanged", _exchanged(_relay_case(seed))


def _turned(case: Case) -> Case:
    problem, orbit, recording = case
    return problem, orbit, _reversed(recording)


def _verdicts(cases: Iterator[tuple[str, Case]]) -> dict[str, ComparisonVerdict]:
    return {
        name: zo.compare(orbit, recording, problem=problem).verdict
        for name, (problem, orbit, recording) in cases
    }


@pytest.mark.weekly
@pytest.mark.slow
def test_no_recording_of_the_orbit_is_called_another_motion() -> None:
    found = _verdicts(_true_cases())
    assert len(found) == 100
    assert [name for name, one in found.items() if one not in {THIS, OPEN}] == []
    assert Counter(found.values())[THIS] >= 90


@pytest.mark.weekly
@pytest.mark.slow
def test_no_recording_of_another_motion_is_called_the_orbit() -> None:
    found = _verdicts(_false_cases())
    assert len(found) == 60
    assert [name for name, one in found.items() if one is THIS] == []
