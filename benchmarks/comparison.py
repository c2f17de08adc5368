"""Are the numbers of `compare` as good as they claim, on machines that nothing was tuned to?

    python benchmarks/comparison.py [--machines hammer geared_flap motor_valve]
        [--samples 40 150 600] [--cycles 30] [--noise 0.001] [--seeds 5] [--each]
    python benchmarks/comparison.py --bias

A machine of `tests/support/machines`, or a bundled problem, is simulated on its orbit and sampled
with noise, so many samples a period, from an unknown phase on. Every number that `compare` gives is
held against the orbit's own, in units of its standard error; a number may instead be left out as
not resolved. With ``--bias`` the same is done on six problems, 50 recordings of each: 95 % of the
values of every quantity must be within two standard errors, and their mean must not be off by more
than the mean of so many unbiased values.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from zeno_orbits.experiment import Sampling, Verdict, compare, sampled
from zeno_orbits.experiment.recordings.recording import Recording, cut
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.problem import Problem
from zeno_orbits.orbits.orbit import ZenoOrbit
from zeno_orbits.search import close_orbit
from zeno_orbits.simulation import Execution, simulate

MACHINES = Path(__file__).parents[1] / "tests" / "support" / "machines"
SURE = 4.0
"""Standard errors by which a number may be off."""
STUDIED = (
    "motor_valve",
    "motor_pendulum",
    "vibrating_table",
    "solenoid",
    "forced_oscillator",
    "relief_valve",
)
"""Problems of the study of coverage, and what is recorded of each."""
RECORDINGS, CYCLES, SAMPLES = 50, 10, 150.0
WITHIN, SHARE, CHANCE = 2.0, 0.95, 1e-4
"""Standard errors, the share of values within them, and how seldom chance alone may refuse one."""


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


@dataclass(frozen=True, kw_only=True)
class Machine:
    """A machine on its orbit.

    Attributes:
        problem: The problem.
        orbit: The orbit.
        motion: Simulated from the release of that.
    """

    problem: Problem
    orbit: ZenoOrbit
    motion: Execution


@lru_cache
def machine(name: str, cycles: int) -> Machine:
    """Return a machine of the tests or a bundled problem, over some periods and one more."""
    path = MACHINES / f"{name}.py"
    problem = load_problem(path if path.exists() else name)
    orbit = close_orbit(problem, problem.values()).unwrap()
    dynamics = problem.dynamics(problem.values())
    start = dynamics.on_stop(np.array(problem.state_vector(orbit.release_state)))
    motion = simulate(dynamics, start, until=(cycles + 1.0) * orbit.period)
    return Machine(problem=problem, orbit=orbit, motion=motion)


def recorded(one: Machine, samples: float, cycles: int, noise: float, seed: int) -> Recording:
    """Return what instruments see of it, its clock left out.

    Args:
        one: The machine.
        samples: A period.
        cycles: How many periods.
        noise: Standard deviation in parts of each signal's range.
        seed: Of the noise and of where the recording begins.
    """
    problem, period = one.problem, one.orbit.period
    sampling = Sampling(rate=samples / period, noise=noise, seed=seed)
    whole = sampled(problem, problem.dynamics(problem.values()), one.motion, sampling)
    clock = {problem.state_names[k] for k in problem.compiled().clock}
    signals = tuple(signal for signal in whole.signals if signal.name not in clock)
    since = period * float(np.random.default_rng(seed).random())
    return cut(replace(whole, signals=signals), since, since + cycles * period)


def scores(one: Machine, recording: Recording) -> Iterator[Score]:
    """Yield every number of a comparison.

    Raises:
        ValueError: If the verdict is that the recording shows no orbit of the machine.
    """
    found = compare(one.orbit, one.problem, recording)
    if found.verdict is Verdict.NO_ORBIT:
        raise ValueError(f"Argument `recording` must show the orbit, but {found.reasons}.")
    known = {"restitution seen": one.orbit.parameters["restitution"]}
    for metric in found.metrics:
        true = known.get(metric.name, metric.orbit)
        yield Score(name=metric.name, orbit=true, data=metric.data, error=metric.error)


def coverage(names: Sequence[str], seeds: int, noise: float) -> bool:
    """Print the share of the values of every quantity within two standard errors.

    Args:
        names: Of the problems.
        seeds: Recordings of each.
        noise: Standard deviation in parts of each signal's range.

    Returns:
        True if the share of all values is 95 %, and none is lower than chance explains.
    """
    from scipy.stats import binom

    print("| Problem | Quantity | Values | Mean error | Within two |\n|---|---|---|---|---|")
    told, inside = 0, 0
    sound = True
    for name in names:
        one = machine(name, CYCLES)
        found: dict[str, list[float]] = {}
        for seed in range(seeds):
            for score in scores(one, recorded(one, SAMPLES, CYCLES, noise, seed)):
                if score.resolved:
                    apart = score.data - score.orbit
                    found.setdefault(score.name, []).append(apart / score.error)
        for quantity, errors in found.items():
            n, n_inside = len(errors), sum(abs(error) <= WITHIN for error in errors)
            told, inside = told + n, inside + n_inside
            rare = float(binom.cdf(n_inside, n, SHARE)) < CHANCE
            sound &= not rare
            row = f"{np.mean(errors):+.2f} | {n_inside / n:.0%}"
            print(f"| {name} | {quantity} | {n} | {row}{' (!)' if rare else ''} |", flush=True)
    print(f"Within two standard errors: {inside / told:.1%} of {told} values.")
    return sound and inside >= SHARE * told


def main() -> int:
    """Print one row a kind of recording; 1 if a number is farther off than it may be."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    names = sorted(path.stem for path in MACHINES.glob("[a-z]*.py"))
    parser.add_argument("--machines", nargs="+", default=None)
    parser.add_argument("--bias", action="store_true", help="shares within two standard errors")
    parser.add_argument("--samples", nargs="+", type=float, default=[40.0, 150.0, 600.0])
    parser.add_argument("--cycles", type=int, default=30)
    parser.add_argument("--noise", type=float, default=1e-3)
    parser.add_argument("--seeds", type=int, default=None)
    parser.add_argument("--each", action="store_true", help="print every number, too")
    options = parser.parse_args()
    if options.bias:
        seeds = options.seeds or RECORDINGS
        return 0 if coverage(options.machines or STUDIED, seeds, options.noise) else 1
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
            for seed in range(options.seeds or 5):
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
