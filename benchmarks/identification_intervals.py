"""How often 95 % intervals hold the truth, over hundreds of recordings: a step of the fit.

    python benchmarks/identification_intervals.py [--seeds 200] [--noise 0.01] [--correlated]

Beside `coverage.py`, whose fits look for every orbit, this one makes of every recording's fit only
the last step, from the truth: period, alignment, folding, weights, residuals, derivatives and
intervals are those of `identify`, and errors that are straight in the noise do not depend on where
a fit begins. So the intervals are seen alone, and their errors told from a search that ends
elsewhere; and the claim of independent noise is beside them.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.stats import binom

sys.path.insert(0, str(Path(__file__).parent))

from coverage import CASES, noise_of

from zeno_orbits.experiment.comparison.alignment import aligned
from zeno_orbits.experiment.comparison.folding import folded
from zeno_orbits.experiment.identification.least_squares import Fit, weighed
from zeno_orbits.experiment.identification.predictions import Predictions
from zeno_orbits.experiment.identification.stationarity import unsteady
from zeno_orbits.experiment.identification.uncertainty import spread_of
from zeno_orbits.experiment.identification.unknowns import unknowns_of
from zeno_orbits.experiment.orbit_table import measurement, tabulate_orbit
from zeno_orbits.experiment.recordings.periodicity import periodicity
from zeno_orbits.model.library import load_problem
from zeno_orbits.search import orbit_by_shooting, settled_return

PROBLEM = "motor_pendulum"
SIGNALS, SOUGHT = CASES[PROBLEM].signals, CASES[PROBLEM].unknowns
CYCLES, RATE = 12, 250.0
TRUTH = (3.06, 0.0303, 0.207)
"""Of what is sought; not the problem's numbers, nor round ones."""


def main() -> None:
    """Run the benchmark and print its shares."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--noise", type=float, default=0.01)
    parser.add_argument("--correlated", action="store_true")
    options = parser.parse_args()
    problem = load_problem(PROBLEM)
    truth = {n: v for one, v in zip(SOUGHT, TRUTH, strict=True) for n in one.names}
    values = problem.values(parameters=truth)
    table = tabulate_orbit(orbit_by_shooting(problem, values).unwrap(), problem, SIGNALS)
    unknowns = unknowns_of(problem, values, SOUGHT)
    near = settled_return(problem, values)
    orbits = Predictions(problem, unknowns, measurement(problem, SIGNALS), near)
    x = unknowns.first
    errors, halves, claimed, plain, refused = [], [], [], [], 0
    for seed in range(options.seeds):
        rng = np.random.default_rng(10_000 + seed)
        times = np.arange(int(CYCLES * table.period * RATE)) / RATE
        entries = table.at(times / table.period + rng.random())
        extent = np.ptp(entries, axis=0)
        noise = noise_of(rng, entries.shape, correlated=options.correlated)
        entries = (entries + options.noise * extent * noise).T
        period = periodicity(times, entries)
        if period is None:
            raise RuntimeError(f"No period is seen with seed {seed}.")
        where = aligned(table, times, entries, period, SIGNALS)
        data = folded(times, entries, where).without_jumps(orbits.table(x))
        stage = weighed(orbits, data, period, x)
        jacobian, residuals = stage.jacobian(x), stage.residuals(x)
        step = -np.linalg.lstsq(jacobian, residuals, rcond=None)[0]
        rest = residuals + jacobian @ step
        spread = spread_of(jacobian, rest, data)
        done = Fit(
            x=x + step,
            data=data,
            jacobian=jacobian,
            residuals=rest,
            spread=spread,
            before=0.0,
            after=0.0,
            repeating=0.0,
            converged=True,
        )
        refused += unsteady(done) is not None
        errors.append(step[:-1])
        halves.append(spread.half)
        claimed.append(spread.errors)
        plain.append(np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))[:-1])
    off, half = np.array(errors), np.array(halves)
    inside = np.abs(off) <= half
    low, high = binom.interval(0.95, len(off), 0.95)
    print(f"of {len(off)} recordings, {low:.0f} to {high:.0f} expected inside a 95 % interval:")
    for k, one in enumerate(SOUGHT):
        seen = float(np.std(off[:, k]))
        score = np.sqrt(np.mean((off[:, k] / np.array(claimed)[:, k]) ** 2))
        alone = seen / np.mean(np.array(plain)[:, k])
        wide = np.median(half[:, k]) / (1.96 * seen)
        print(
            f"  {one.label}: inside {int(inside[:, k].sum())}; errors {seen:.2e} of the number, "
            f"{score:.2f} standard errors, {alone:.2f} of those of independent noise; "
            f"half intervals {wide:.2f} times 1.96 standard deviations"
        )
    print(f"all three at once: {int(inside.all(axis=1).sum())}; refused as unsteady: {refused}")


if __name__ == "__main__":
    main()
