"""Are the numbers of `compare` as good as they claim, on machines that nothing was tuned to?

    python benchmarks/comparison.py [--machines hammer geared_flap motor_valve]
        [--samples 40 150 600] [--cycles 30] [--noise 0.001] [--seeds 5] [--each]

A machine of `tests/support/machines`, or a bundled problem, is simulated on its orbit and sampled
with noise, so many samples a period, from an unknown phase on. Every number that `compare` gives is
held against the orbit's own, in units of its standard error; a number may instead be left out as
not resolved. How often the errors hold the truth is measured by `coverage.py`.
"""

from __future__ import annotations

import argparse
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from zeno_orbits.experiment import (
    ComparisonVerdict,
    RecordedSignal,
    Recording,
    Sampling,
    compare_recording,
    sampled,
)
from zeno_orbits.experiment.recordings.recording import crop_recording
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.problem import Problem
from zeno_orbits.orbits.orbit import Orbit
from zeno_orbits.search import orbit_by_shooting
from zeno_orbits.simulation import Execution, simulate

MACHINES = Path(__file__).parents[1] / "tests" / "support" / "machines"
SURE = 4.0
"""Standard errors by which a number may be off."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """One number of a comparison.

    Attributes:
        name: What it is.
        orbit: The orbit's.
        data: The recording's; NaN where it is not resolved.
        error: Its standard error.
    """

    name: str
    orbit: float
    data: float
    error: float

    @property
    def resolved(self) -> bool:
        """True if the recording tells the number."""
        return math.isfinite(self.data)

    @property
    def off(self) -> float:
        """How far it is off, in its standard errors."""
        apart = abs(self.data - self.orbit)
        return apart / self.error if self.error > 0.0 else math.inf if apart else 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Machine:
    """A machine on its orbit.

    Attributes:
        problem: The problem.
        orbit: The orbit.
        motion: Simulated from the release of that.
    """

    problem: Problem
    orbit: Orbit
    motion: Execution


@lru_cache
def machine(name: str, cycles: int) -> Machine:
    """Return a machine of the tests or a bundled problem, over some periods and one more."""
    path = MACHINES / f"{name}.py"
    problem = load_problem(path if path.exists() else name)
    orbit = orbit_by_shooting(problem, problem.values()).unwrap()
    dynamics = problem.dynamics(problem.values())
    start = dynamics.on_stop(np.array(problem.state_vector(orbit.release_state)))
    motion = simulate(dynamics, start, until=(cycles + 1.0) * orbit.period)
    return Machine(problem=problem, orbit=orbit, motion=motion)


@lru_cache
def exact(one: Machine, samples: float) -> Recording:
    """Return samples of the whole motion without noise, without its clock."""
    problem = one.problem
    sampling = Sampling(rate=samples / one.orbit.period)
    whole = sampled(problem, one.motion, sampling)
    clock = {problem.state_names[k] for k in problem.compiled().clock}
    return replace(whole, signals=tuple(s for s in whole.signals if s.name not in clock))


def recorded(one: Machine, samples: float, cycles: int, noise: float, seed: int) -> Recording:
    """Return what instruments see of it, its clock left out.

    Args:
        one: The machine.
        samples: A period.
        cycles: How many periods.
        noise: Standard deviation in parts of each signal's range.
        seed: Of the noise and of where the recording begins.
    """
    # Recordings of different machines do not share their noise.
    rng = np.random.default_rng([zlib.crc32(one.problem.name.encode()), seed])
    since = one.orbit.period * float(rng.random())
    part = crop_recording(exact(one, samples), since, since + cycles * one.orbit.period)

    def noisy(signal: RecordedSignal) -> RecordedSignal:
        values = signal.values
        added = noise * np.ptp(values) * rng.normal(size=len(values))
        return replace(signal, values=values + added)

    return replace(part, signals=tuple(noisy(signal) for signal in part.signals))


def scores(one: Machine, recording: Recording) -> Iterator[Score]:
    """Yield every number of a comparison.

    Raises:
        ValueError: If the verdict is that the recording shows no orbit of the machine.
    """
    found = compare_recording(one.orbit, one.problem, recording)
    if found.verdict is ComparisonVerdict.NO_ORBIT:
        raise ValueError(f"Argument `recording` must show the orbit, but {found.reasons}.")
    known = {"restitution seen": one.orbit.parameters["restitution"]}
    for metric in found.metrics:
        true = known.get(metric.name, metric.orbit)
        yield Score(name=metric.name, orbit=true, data=metric.data, error=metric.error)


def main() -> int:
    """Print one row a kind of recording; 1 if a number is farther off than it may be."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    names = sorted(path.stem for path in MACHINES.glob("[a-z]*.py"))
    parser.add_argument("--machines", nargs="+", default=None)
    parser.add_argument("--samples", nargs="+", type=float, default=[40.0, 150.0, 600.0])
    parser.add_argument("--cycles", type=int, default=30)
    parser.add_argument("--noise", type=float, default=1e-3)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--each", action="store_true", help="print every number, too")
    options = parser.parse_args()
    print(
        "| Machine | Samples a period | Numbers | Not resolved | Greatest error in standard "
        "errors |\n|---|---|---|---|---|"
    )
    sound = True
    for name in options.machines or names:
        one = machine(name, options.cycles)
        for samples in options.samples:
            found: list[Score] = []
            refused = 0
            for seed in range(options.seeds):
                recording = recorded(one, samples, options.cycles, options.noise, seed)
                try:
                    found += scores(one, recording)
                except ValueError as error:
                    print(f"    {error}")
                    refused += 1
            told = [score for score in found if score.resolved]
            for score in told if options.each else [s for s in told if s.off > SURE]:
                print(f"    {score}: off by {score.off:.1f}")
            worst = max((score.off for score in told), default=math.nan)
            sound &= worst <= SURE and not refused
            print(
                f"| {name} | {samples:g} | {len(found)} | {len(found) - len(told)} | {worst:.1f} |",
                flush=True,
            )
    return 0 if sound else 1


if __name__ == "__main__":
    raise SystemExit(main())
