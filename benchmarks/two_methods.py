"""How often the program, shooting and both find gains of a prescribed period.

The target is the period of a machine's own orbit, so an orbit with it exists. Every gain starts at
random up to a part of its value away. A search counts if the verifier passes its orbit and the
period is the target to 1e-8. Prints the counts, the median times, and for every pair of methods how
often both end at the same optimum, to 1e-3, and which one is better otherwise.
Exit 1 if `auto` finds fewer orbits than one of them.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from itertools import combinations

import numpy as np

import zeno_orbits as zo

MACHINES = ("motor_pendulum", "limited_pendulum", "powered_walker")
SAME = 1e-3
"""Relative difference of two optima that are one."""
REACHED = 1e-8
"""Largest relative distance from the period."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A search from wrong gains: its score or why there is none, and the time it took [s]."""

    score: float | None
    seconds: float
    reason: str = ""


def searched(name: str, wrong: dict[str, float], target: float, method: zo.SearchMethod) -> Trial:
    """Return the search of one method."""
    gains = {gain.name: gain for gain in zo.load_problem(name).gains}
    vary = {
        key: (min(gains[key].lower, value), max(gains[key].upper, value))
        for key, value in wrong.items()
    }
    began = time.perf_counter()
    try:
        found = zo.search_gains(
            name,
            vary=vary,
            gains=wrong,
            objective=zo.TargetPeriod(target=target),
            allow_unstable=True,
            method=method,
            settings=zo.SearchSettings(n_starts=0),
        )
    except zo.SimulationError as error:
        return Trial(score=None, seconds=time.perf_counter() - began, reason=error.reason)
    seconds = time.perf_counter() - began
    if found.orbit is None or found.certificate is None:
        return Trial(score=None, seconds=seconds, reason=found.detail)
    if not found.certificate.passed or abs(found.orbit.period / target - 1.0) > REACHED:
        return Trial(score=None, seconds=seconds, reason="the orbit is not verified")
    return Trial(score=found.value, seconds=seconds)


def compared(trials: dict[zo.SearchMethod, list[Trial]]) -> None:
    """Print how often two methods end at the same optimum."""
    for one, other in combinations(trials, 2):
        pairs = [
            (a.score, b.score)
            for a, b in zip(trials[one], trials[other], strict=True)
            if a.score is not None and b.score is not None
        ]
        same = [abs(a - b) <= SAME * max(a, b) for a, b in pairs]
        better = sum(a < b and not s for (a, b), s in zip(pairs, same, strict=True))
        print(
            f"  {one.value} and {other.value}: same optimum {sum(same)} of {len(pairs)}, "
            f"{one.value} better {better}, {other.value} better {len(pairs) - sum(same) - better}"
        )


def main() -> int:
    """Run all trials, print the counts, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", nargs="+", default=list(MACHINES))
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--off", type=float, default=0.3, help="largest part of a gain")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    is_good = True
    for name in options.machines:
        orbit = zo.find_orbit(name).unwrap()
        random = np.random.default_rng([options.seed, len(orbit.gains)])
        trials: dict[zo.SearchMethod, list[Trial]] = {method: [] for method in zo.SearchMethod}
        for k in range(options.trials):
            wrong = {
                key: float(value * (1.0 + options.off * random.uniform(-1.0, 1.0)))
                for key, value in orbit.gains.items()
            }
            for method, done in trials.items():
                done.append(searched(name, wrong, orbit.period, method))
                if done[-1].score is None:
                    print(f"  {name} {k}, {method.value}: {done[-1].reason}", flush=True)
        for method, done in trials.items():
            n_found = sum(trial.score is not None for trial in done)
            median = float(np.median([trial.seconds for trial in done]))
            print(f"{name}, {method.value}: {n_found} of {len(done)}, median {median:.2f} s")
        compared(trials)
        counts = {
            method: sum(trial.score is not None for trial in done)
            for method, done in trials.items()
        }
        is_good &= counts[zo.SearchMethod.AUTO] >= max(counts.values())
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
