"""Verdicts of `compare` for machines with several stops, with switches, and without contact.

    python benchmarks/event_verdicts.py [--yes 100] [--no 60] [--seed 42]

Recordings that show the orbit: noise of 0.05 to 1 % of each signal's range, rounding to 8 to 12
bits, offsets of 1e-5 of the range, 40 to 600 samples a period, 2.3 to 30 periods, all states or
coordinates alone, with and without contact channels, all drawn by the seed. A false no is the
verdict that no orbit is shown, or one with other values.

Recordings of other motions: a parameter or gain that is 5 to 40 % off, the motion reversed in time,
two orbits in turn (a doubled period), signals of another size, the other well, and the walk of
another walker. A false yes is the verdict that this orbit is shown. For motions that no machine
with other values has, which are reversed or doubled, it is also the verdict that one is.

Three machines touch no stop: their recordings are made by SciPy or in closed form.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from contact_fits import channel

import zeno_orbits as zo
from tests.support.contactless import (
    duffing,
    duffing_motion,
    escapement,
    escapement_motion,
    wheel,
    wheel_motion,
)
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.experiment import (
    ComparisonVerdict,
    RecordedSignal,
    Recording,
    Source,
    contact_names,
)
from zeno_orbits.experiment.identification.event_period import EventPeriod, event_period
from zeno_orbits.experiment.orbit_table import measurement
from zeno_orbits.search import event_orbit_of, settled_return

OWN: Mapping[str, tuple[Callable[..., zo.Problem], Callable[..., Any], tuple[str, ...]]] = {
    "wheel": (wheel, wheel_motion, ("slope", "length")),
    "escapement": (escapement, escapement_motion, ("k", "c", "push")),
    "duffing": (duffing, duffing_motion, ("c", "amplitude", "omega")),
}
DEFAULTS = {
    "slope": 0.08,
    "length": 1.0,
    "k": 9.0,
    "c": 0.4,
    "push": 1.0,
    "amplitude": 0.2,
    "omega": 1.1,
}
BUNDLED: Mapping[str, tuple[str, ...]] = {
    "kneed_walker": ("slope", "m_hip", "restitution"),
    "powered_walker": ("Kp", "Kd", "step", "Kp_knee"),
    "hopper": ("m", "a", "s", "restitution"),
    "relay": ("R", "ks", "U", "restitution"),
    "clapper": ("A", "c", "restitution", "d"),
    "limited_pendulum": ("Kp", "Kd", "U", "R"),
    "relief_valve": ("q", "k", "restitution"),
}
"""Bundled machines and the numbers of each that are changed."""
MACHINES = (*OWN, *BUNDLED)
VISIBLE = 0.02
"""A change counts if the period or a range of a signal changes by this part at least."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """A periodic motion of a machine: its signals by phase, and its channels by time."""

    problem: zo.Problem
    period: float
    at: Callable[[Vector], Vector]
    names: tuple[str, ...]
    table: EventPeriod | None

    def sizes(self) -> Vector:
        """Return the period and the ranges of all signals."""
        return np.append(np.ptp(self.at(np.arange(2000) / 2000), axis=0), self.period)


def _shown(problem: zo.Problem) -> tuple[str, ...]:
    return tuple(name for name in problem.state_names if name not in {"cosine", "sine"})


@cache
def orbit_of(name: str) -> tuple[zo.Problem, zo.Orbit]:
    """Return a machine and its orbit."""
    problem = OWN[name][0]() if name in OWN else zo.load_problem(name)
    values = problem.values()
    return problem, event_orbit_of(problem, values, settled_return(problem, values))


@cache
def motion_of(name: str, changes: tuple[tuple[str, float], ...] = ()) -> Motion:
    """Return the motion of a machine whose numbers are multiplied by factors, or of a well."""
    problem = orbit_of(name)[0]
    names = _shown(problem)
    if name in OWN:
        numbers = {
            word: factor
            if word == "side"
            else factor * (1.5 if name == "duffing" and word == "c" else DEFAULTS[word])
            for word, factor in changes
        }
        period, states = OWN[name][1](**numbers)
        columns = [problem.state_names.index(one) for one in names]

        def at(phases: Vector) -> Vector:
            return np.asarray(states(np.mod(phases, 1.0) * period))[:, columns]

        return Motion(problem=problem, period=period, at=at, names=names, table=None)
    values = problem.values()
    known = {**values.gains, **values.parameters}
    numbers = {word: factor * known[word] for word, factor in changes}
    gains = {word: one for word, one in numbers.items() if word in values.gains}
    rest = {word: one for word, one in numbers.items() if word not in gains}
    values = problem.values(gains=gains, parameters=rest)
    found = settled_return(problem, values)
    table = event_period(problem.graph_dynamics(values), found, measurement(problem, names))
    return Motion(problem=problem, period=table.period, at=table.at, names=names, table=table)


def recorded(
    motions: tuple[Motion, ...], random: np.random.Generator, *, scale: float = 1.0
) -> Recording:
    """Return a recording of one motion, or of several in turn, as cheap instruments make it."""
    first = motions[0]
    ends = np.cumsum([one.period for one in motions])
    samples, cycles = 40 * 15 ** random.random(), random.uniform(2.3, 30)
    with_channels = first.table is not None and random.random() < 0.5
    if with_channels:
        # Channels need samples in every bounce.
        samples, cycles = 4000 * samples / 40, min(cycles, 8.0)
    n = int(cycles * samples)
    time = random.uniform(0, 5) + np.arange(n) * first.period / samples
    since = np.mod(time, ends[-1])
    turn = np.searchsorted(ends, since, side="right")
    begins = np.concatenate([[0.0], ends])
    values = np.zeros((n, len(first.names)))
    for k, one in enumerate(motions):
        values[turn == k] = one.at((since[turn == k] - begins[k]) / one.period)
    size = np.ptp(values, axis=0)
    values = scale * (values - values.mean(axis=0)) + values.mean(axis=0)
    values += 10 ** random.uniform(-3.3, -2) * size * random.normal(size=values.shape)
    values += 1e-5 * size * random.uniform(-1, 1, len(size))
    if random.random() < 0.5:
        step = size / 2.0 ** random.integers(8, 13)
        values = np.rint(values / step) * step
    problem = first.problem
    units = dict(zip(problem.state_names, problem.state_units, strict=True))
    n_q = problem.model(problem.symbols()).n_q
    alone = len(motions) == 1 and scale == 1.0 and random.random() < 0.3
    signals = [
        RecordedSignal(name=name, unit=units[name], values=values[:, k])
        for k, name in enumerate(first.names)
        if not (alone and problem.state_names.index(name) >= n_q)
    ]
    if with_channels and first.table is not None:
        stops = first.table.graph.stop_names
        for title, stop in zip(contact_names(stops), stops, strict=True):
            row = np.zeros(n)
            for k, one in enumerate(motions):
                own = (since - begins[k])[turn == k]
                assert one.table is not None
                row[turn == k] = channel(one.table, stop, own, 2.5 * one.period / samples)
            signals.append(RecordedSignal(name=title, unit="1", values=row))
    return Recording(
        source=Source.SIMULATED, problem=problem.name, time=time, signals=tuple(signals)
    )


def reversed_in_time(recording: Recording) -> Recording:
    """Return a recording that runs backward."""
    signals = tuple(replace(one, values=one.values[::-1].copy()) for one in recording.signals)
    return replace(recording, signals=signals)


def changed(name: str, random: np.random.Generator, least: float) -> tuple[str, Motion]:
    """Return a motion of a machine with a number that is visibly off by a part at least."""
    words, own = (OWN[name][2] if name in OWN else BUNDLED[name]), motion_of(name)
    for _ in range(30):
        word = str(random.choice(words))
        part = random.uniform(least, 0.4) * random.choice([-1.0, 1.0])
        try:
            found = motion_of(name, ((word, 1.0 + part),))
        except ZenoOrbitsError:
            continue
        if np.max(np.abs(found.sizes() / own.sizes() - 1.0)) > VISIBLE:
            return f"{word} {100 * part:+.0f} %", found
    raise RuntimeError(f"Machine {name} has no other orbit.")


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A recording, the machine that it is compared with, and the verdicts that are false."""

    name: str
    kind: str
    recording: Recording
    false: frozenset[ComparisonVerdict]


THIS, OTHER = ComparisonVerdict.THIS_ORBIT, ComparisonVerdict.OTHER_VALUES
NEITHER = frozenset({THIS, OTHER})


def shown(n: int, seed: int) -> list[Case]:
    """Return so many recordings of orbits."""
    random = np.random.default_rng([seed, 1])
    false = frozenset({ComparisonVerdict.NO_ORBIT, OTHER})
    return [
        Case(name=name, kind="own", recording=recorded((motion_of(name),), random), false=false)
        for name in (MACHINES[k % len(MACHINES)] for k in range(n))
    ]


def others(n: int, seed: int) -> list[Case]:
    """Return so many recordings of other motions."""
    random = np.random.default_rng([seed, 2])
    found = [
        Case(
            name="duffing",
            kind="the other well",
            recording=recorded((motion_of("duffing", (("side", -1.0),)),), random),
            false=NEITHER,
        ),
        *(
            Case(
                name=name,
                kind=f"the walk of {other}",
                recording=recorded((motion_of(other),), random),
                false=frozenset({THIS}),
            )
            for name, other in (
                ("kneed_walker", "powered_walker"),
                ("powered_walker", "kneed_walker"),
            )
        ),
    ]
    kinds = ("changed", "changed", "reversed", "changed", "doubled", "changed", "scaled")
    for k in range(n - len(found)):
        name, kind = MACHINES[k % len(MACHINES)], kinds[k // len(MACHINES) % len(kinds)]
        own = motion_of(name)
        if kind == "reversed":
            made = reversed_in_time(recorded((own,), random))
        elif kind == "doubled":
            made = recorded((own, changed(name, random, 0.05)[1]), random)
        elif kind == "scaled":
            made = recorded((own,), random, scale=random.choice([0.8, 0.9, 1.1, 1.25]))
        else:
            kind, other = changed(name, random, 0.05)
            made = recorded((other,), random)
        false = NEITHER if kind in {"reversed", "doubled"} else frozenset({THIS})
        found.append(Case(name=name, kind=kind, recording=made, false=false))
    return found[:n]


def judged(cases: list[Case]) -> tuple[int, Counter[str]]:
    """Return the number of false verdicts and the verdicts, and print the false ones."""
    false, counts = 0, Counter[str]()
    for k, case in enumerate(cases):
        problem, orbit = orbit_of(case.name)
        found = zo.compare(orbit, case.recording, problem=problem)
        counts[found.verdict.value] += 1
        wrong = found.verdict in case.false
        false += wrong
        why = [*found.reasons, *found.unresolved, *(one.name for one in found.differences)]
        mark = "FALSE" if wrong else ""
        print(f"{k} {case.name}, {case.kind}: {found.verdict.value} {why[:3]} {mark}", flush=True)
    return false, counts


def main() -> int:
    """Print the verdicts; 1 if one is false."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--yes", type=int, default=100, help="recordings of the orbit")
    parser.add_argument("--no", type=int, default=60, help="recordings of other motions")
    parser.add_argument("--seed", type=int, default=42)
    options = parser.parse_args()
    false_no, yes = judged(shown(options.yes, options.seed))
    false_yes, no = judged(others(options.no, options.seed))
    print(f"{false_yes} false yes of {options.no}: {dict(no)}")
    print(f"{false_no} false no of {options.yes}: {dict(yes)}")
    return 1 if false_yes or false_no else 0


if __name__ == "__main__":
    raise SystemExit(main())
