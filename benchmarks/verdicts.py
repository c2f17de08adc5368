"""Verdicts of `compare` on recordings that show an orbit of the machine, and on others.

    python benchmarks/verdicts.py [--yes 200] [--seed 31] [--workers N] [--checkpoint FOLDER]
        [--quick]

Recordings that show one: ten problems, with the orbit at the problem's numbers or at numbers some
per cent off, 80 to 600 samples a period, 3 to 30 periods, noise of 0.01 to 1 % of each signal's
range, with and without velocities, all drawn by the seed. A false no is the verdict that no orbit
is shown. Those that `compare` cannot decide are counted by their first reason.

Recordings that show none: noise, periodic signals of other kinds, motions reversed in time, other
machines, motions without a Zeno point, parts of a period, wrong signs and wrong units. A false yes
is the verdict that this orbit or one with other values is shown.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from comparison import exact, machine
from coverage import CASES, Judge
from support.spreading import add_options, arriving

from tests.support.recordings_of import recording_of
from zeno_orbits.experiment import (
    ComparisonVerdict,
    Recording,
    Sampling,
    compare_recording,
    sampled,
)
from zeno_orbits.experiment.recordings.recording import crop_recording
from zeno_orbits.model.library import load_problem
from zeno_orbits.search import orbit_by_shooting
from zeno_orbits.simulation import simulate

Signal = NDArray[np.float64]

GAPS: Mapping[str, str] = {
    "vibrating_table": "height",
    "forced_oscillator": "distance",
    "motor_valve": "opening",
    "relief_valve": "lift",
    "motor_pendulum": "theta2",
}
SAMPLES, CYCLES, NOISE = 150.37, 12, 2e-3
SHAPES: Mapping[str, Callable[[Signal], Signal]] = {
    "rectified sine": lambda s: np.maximum(np.sin(2 * math.pi * s), 0.0),
    "clipped triangle": lambda s: np.maximum(np.abs(2 * s - 1) - 0.4, 0.0) / 0.6,
    "full-wave rectified sine": lambda s: np.abs(np.sin(math.pi * s)),
    "sine": lambda s: (1 + np.sin(2 * math.pi * s)) / 2,
    "square": lambda s: (s < 0.4).astype(np.float64),
    "parabola and a plastic impact": lambda s: np.maximum(s * (0.7 - s), 0.0) * 8,
    "elastic hops": lambda s: 4 * s * (1 - s),
}
"""Height of a gap over the phase in [0, 1)."""


def noisy(recording: Recording, seed: int) -> Recording:
    """Return a recording with noise on each signal."""
    rng = np.random.default_rng(seed)

    def one(values: Signal) -> Signal:
        return values + NOISE * np.ptp(values) * rng.normal(size=len(values))

    signals = tuple(replace(s, values=one(s.values)) for s in recording.signals)
    return replace(recording, signals=signals)


def copied(name: str, cycles: float = CYCLES) -> Recording:
    """Return a noisy recording of the orbit of a problem."""
    one = machine(name, CYCLES)
    since = 0.37 * one.orbit.period
    return noisy(crop_recording(exact(one, SAMPLES), since, since + cycles * one.orbit.period), 1)


def of_gap(name: str, values: Callable[[Signal], Signal]) -> Recording:
    """Return a recording of the gap alone, from its height in parts of the orbit's by the phase."""
    one = machine(name, CYCLES)
    gap = next(s for s in exact(one, SAMPLES).signals if s.name == GAPS[name])
    time = np.arange(int(CYCLES * SAMPLES)) * one.orbit.period / SAMPLES
    heights = np.ptp(gap.values) * values(time / one.orbit.period)
    return noisy(recording_of(one.problem, (GAPS[name],), time, heights[None]), 2)


def white(seed: int) -> Callable[[Signal], Signal]:
    """Return noise without memory."""
    return lambda phase: np.random.default_rng(seed).normal(size=len(phase))


def walk(seed: int) -> Callable[[Signal], Signal]:
    """Return the distance of a random walk."""
    return lambda phase: np.abs(np.cumsum(np.random.default_rng(seed).normal(size=len(phase)))) / 30


def repeated(shape: str) -> Callable[[Signal], Signal]:
    """Return a shape of every period."""
    return lambda phase: SHAPES[shape](np.mod(phase, 1.0))


def changed(name: str, factors: Mapping[str, float]) -> Recording:
    """Return the orbit's recording with some signals multiplied."""
    copy = copied(name)
    signals = tuple(
        replace(signal, values=factors.get(signal.name, 1.0) * signal.values)
        for signal in copy.signals
    )
    return replace(copy, signals=signals)


def backward(name: str) -> Recording:
    """Return the orbit's recording reversed in time."""
    copy = copied(name)
    return replace(
        copy, signals=tuple(replace(s, values=s.values[::-1].copy()) for s in copy.signals)
    )


def other(
    name: str, source: str, numbers: Mapping[str, float], start: Mapping[str, float]
) -> Recording:
    """Return the settled motion of a problem, recorded as one of another.

    Args:
        name: The problem that it is compared with.
        source: The problem that moves.
        numbers: Its numbers.
        start: Its initial state.
    """
    problem = load_problem(source)
    dynamics = problem.dynamics(problem.values(numbers=numbers))
    period = machine(name, CYCLES).orbit.period
    begin = dynamics.on_stop(np.array(problem.state_vector(start)))
    motion = simulate(dynamics, begin, until=(60 + CYCLES) * period)
    whole = sampled(problem, motion, Sampling(rate=SAMPLES / period))
    kept = {s.name for s in copied(name).signals}
    signals = tuple(s for s in whole.signals if s.name in kept)
    part = crop_recording(replace(whole, signals=signals), 60 * period, (60 + CYCLES) * period)
    return noisy(replace(part, problem=name), 3)


SWING = {"speed": 1.0, "cosine": 1.0}
COCO = {"c": 0.1, "stop": 1.0, "restitution": 0.8}
TABLE = {"height": 0.02, "cosine": 1.0}
NONE: Mapping[str, tuple[str, Callable[[], Recording]]] = {
    **{f"white noise: {n}": (n, lambda n=n: of_gap(n, white(4))) for n in GAPS},
    "a random walk: vibrating_table": (
        "vibrating_table",
        lambda: of_gap("vibrating_table", walk(5)),
    ),
    "a random walk: motor_valve": ("motor_valve", lambda: of_gap("motor_valve", walk(6))),
    **{
        f"{shape}: {n}": (n, lambda n=n, shape=shape: of_gap(n, repeated(shape)))
        for shape in SHAPES
        for n in ("vibrating_table", "relief_valve")
    },
    **{f"reversed: {n}": (n, lambda n=n: backward(n)) for n in GAPS},
    "one impact a turn": (
        "forced_oscillator",
        lambda: other("forced_oscillator", "forced_oscillator", COCO, SWING),
    ),
    "one impact a turn, more damped": (
        "forced_oscillator",
        lambda: other("forced_oscillator", "forced_oscillator", {**COCO, "c": 0.3}, SWING),
    ),
    "one impact in two turns": (
        "forced_oscillator",
        lambda: other(
            "forced_oscillator", "forced_oscillator", {**COCO, "stop": 0.0, "omega": 2.7}, SWING
        ),
    ),
    "hops without rest": (
        "vibrating_table",
        lambda: other("vibrating_table", "vibrating_table", {"restitution": 0.85}, TABLE),
    ),
    "hops without rest on a table that shakes more": (
        "vibrating_table",
        lambda: other("vibrating_table", "vibrating_table", {"A": 0.03, "restitution": 0.7}, TABLE),
    ),
    "a table with two tones": (
        "vibrating_table",
        lambda: other("vibrating_table", "two_tone_table", {}, TABLE),
    ),
    **{
        f"{part:g} of a period: {n}": (n, lambda n=n, part=part: copied(n, part))
        for n, part in (("motor_pendulum", 0.3), ("relief_valve", 0.6), ("vibrating_table", 0.9))
    },
    **{
        f"gap of the wrong sign: {n}": (n, lambda n=n: changed(n, {GAPS[n]: -1.0}))
        for n in ("motor_pendulum", "vibrating_table", "relief_valve")
    },
    "current of the wrong sign": (
        "motor_pendulum",
        lambda: changed("motor_pendulum", {"current": -1.0}),
    ),
    "degrees called radians": (
        "motor_pendulum",
        lambda: changed("motor_pendulum", {"theta1": 180 / math.pi, "theta2": 180 / math.pi}),
    ),
    "millimetres called metres": (
        "vibrating_table",
        lambda: changed("vibrating_table", {"height": 1e3}),
    ),
    "milliamperes called amperes": (
        "motor_valve",
        lambda: changed("motor_valve", {"current": 1e3}),
    ),
}
"""The recordings that show no orbit: the problem that each is compared with, and the recording."""
YES = {ComparisonVerdict.THIS_ORBIT, ComparisonVerdict.OTHER_VALUES}


@dataclass(frozen=True, kw_only=True)
class Verdicts:
    """Verdicts on recordings."""

    def __call__(self, points: Sequence[Any]) -> list[dict[str, str]]:
        """Return verdict and first reason of each recording."""
        return [self._none(p) if isinstance(p, str) else self._shown(p) for p in points]

    def _none(self, name: str) -> dict[str, str]:
        problem, make = NONE[name]
        return told(problem, make())

    def _shown(self, point: dict[str, Any]) -> dict[str, str]:
        judge = Judge(noise=point["noise"], cycles=point["cycles"], spread=point["spread"])
        made = judge.recorded(point)
        return {"refused": "no orbit"} if made is None else told(point["problem"], made[0])


def told(name: str, recording: Recording) -> dict[str, str]:
    """Return the verdict on a recording and its first reason."""
    problem = load_problem(name)
    orbit = orbit_by_shooting(problem, problem.values()).unwrap()
    found = compare_recording(orbit, problem, recording)
    reasons = [*found.reasons, *found.unresolved, *(one.name for one in found.differences)]
    return {"verdict": found.verdict.value, "reason": reasons[0] if reasons else ""}


def shown(n: int, seed: int) -> list[dict[str, Any]]:
    """Return so many recordings that show an orbit, drawn by a seed."""
    rng = np.random.default_rng(seed)
    names = list(CASES)
    return [
        {
            "problem": names[k % len(names)],
            "seed": int(rng.integers(2**31)),
            "velocities": bool(rng.integers(2)),
            "rate": 0.0,
            "samples": float(80 * 7.5 ** rng.random()),
            "cycles": int(rng.integers(3, 31)),
            "noise": float(10 ** rng.uniform(-4, -2)),
            # Numbers of the problem, or those some standard deviations off.
            "spread": float(rng.choice([0.0, 3.0])),
        }
        for k in range(n)
    ]


def main() -> int:
    """Print the verdicts; 1 if one is false."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--yes", type=int, default=200, help="recordings that show an orbit")
    parser.add_argument("--seed", type=int, default=31)
    add_options(parser)
    parser.add_argument("--quick", action="store_true", help="few of each")
    options = parser.parse_args()
    names = list(NONE)[:: 8 if options.quick else 1]
    points = shown(10 if options.quick else options.yes, options.seed)
    none = list(arriving("none", Verdicts(), names, options))
    print("| Recording | Verdict | First reason |\n|---|---|---|")
    words = {verdict.value for verdict in YES}
    for name, one in zip(names, none, strict=True):
        print(f"| {name} | {one.get('verdict', 'refused')} | {one.get('reason', one)} |")
    false_yes = sum(one.get("verdict", "") in words or "refused" in one for one in none)
    some = list(arriving("shown", Verdicts(), points, options, chunk=5))
    counts = Counter(one.get("verdict", one.get("refused")) for one in some)
    for point, one in zip(points, some, strict=True):
        if one.get("verdict") not in words:
            print(f"    {point}: {one}")
    false_no = counts[ComparisonVerdict.NO_ORBIT.value]
    print(
        f"{false_yes} false yes of {len(none)}; {false_no} false no of {len(some)}: "
        + ", ".join(f"{n} {word}" for word, n in counts.items())
    )
    return 1 if false_yes or false_no else 0


if __name__ == "__main__":
    raise SystemExit(main())
