"""How often the 95 % intervals of `identify` hold the truth, on recordings whose truth is known.

    python benchmarks/identification.py [--seeds 60] [--noise 0.01] [--correlated]

Every seed has its own truth, some per cent from the problem's numbers, its own unknown start and
its own noise on angles and current; the fit begins at the problem's numbers. With ``--correlated``
the noise is that of a filtered sensor, which a fit that counts samples as independent gets wrong.
A share of intervals that hold is given with the range in which it would be in 95 of 100 such
benchmarks if it were 95 %. Small matrices gain nothing from threads: with OPENBLAS_NUM_THREADS=1
in the environment a fit takes half of the processor time.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from zeno_orbits.experiment.identification.identification import Sought, UnfittableError, identify
from zeno_orbits.experiment.orbit_table import table_of
from zeno_orbits.experiment.recordings.recording import Recording, Signal, Source
from zeno_orbits.model.library import load_problem
from zeno_orbits.search import close_orbit

PROBLEM = "motor_pendulum"
SIGNALS = ("theta1", "theta2", "current")
SOUGHT = (
    Sought(names=("R",), lower=2.0, upper=4.0),
    Sought(names=("K_torque", "K_emf"), lower=0.02, upper=0.05),
    Sought(names=("restitution",), lower=0.0, upper=0.4),
)
SPREAD = (0.03, 0.02, 0.05)
"""How far the truth is from the problem's numbers: relative standard deviations."""
CYCLES = 12
RATE = 250.0
MEMORY = 8
"""Samples over which a filtered sensor forgets."""


def noise_of(
    rng: np.random.Generator, shape: tuple[int, int], *, correlated: bool
) -> NDArray[np.float64]:
    """Return noise of standard deviation one along the first axis."""
    white = rng.normal(size=shape)
    if not correlated:
        return white
    keep = np.exp(-1.0 / MEMORY)
    found = np.empty(shape)
    found[0] = white[0]
    for k in range(1, shape[0]):
        found[k] = keep * found[k - 1] + np.sqrt(1 - keep**2) * white[k]
    return found


def recorded(
    seed: int, noise: float, *, correlated: bool
) -> tuple[Recording, dict[str, float]] | None:
    """Return a recording and its truth, or nothing if there is no orbit at that truth."""
    rng = np.random.default_rng(seed)
    problem = load_problem(PROBLEM)
    truth = dict(problem.values().parameters)
    for one, spread in zip(SOUGHT, SPREAD, strict=True):
        factor = 1.0 + spread * rng.normal()
        truth |= {name: truth[name] * factor for name in one.names}
    orbit = close_orbit(problem, problem.values(parameters=truth)).orbit
    if orbit is None:
        return None
    table = table_of(orbit, problem, SIGNALS)
    times = np.arange(int(CYCLES * orbit.period * RATE)) / RATE
    values = table.at(times / orbit.period + rng.random())
    values += noise * np.ptp(values, axis=0) * noise_of(rng, values.shape, correlated=correlated)
    units = dict(zip(problem.state_names, problem.state_units, strict=True))
    signals = tuple(
        Signal(name=name, unit=units[name], values=values[:, k].copy())
        for k, name in enumerate(SIGNALS)
    )
    recording = Recording(source=Source.SIMULATED, problem=PROBLEM, time=times, signals=signals)
    return recording, truth


def main() -> None:
    """Run the benchmark and print one row a seed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--noise", type=float, default=0.01)
    parser.add_argument("--correlated", action="store_true")
    options = parser.parse_args()
    problem = load_problem(PROBLEM)
    labels = [one.label for one in SOUGHT]
    inside, whole, tried = dict.fromkeys(labels, 0), 0, 0
    scores: dict[str, list[float]] = {label: [] for label in labels}
    errors: dict[str, list[float]] = {label: [] for label in labels}
    times: list[float] = []
    print("seed  " + "".join(f"{label:>22}" for label in labels) + "   (error in standard errors)")
    for seed in range(options.seeds):
        made = recorded(seed, options.noise, correlated=options.correlated)
        if made is None:
            print(f"{seed:4d}  no orbit at this truth")
            continue
        recording, truth = made
        began = time.process_time()
        tried += 1
        try:
            found = identify(problem, problem.values(), recording, SOUGHT)
        except UnfittableError as error:
            print(f"{seed:4d}  {error}")
            continue
        times.append(time.process_time() - began)
        row, all_in = "", True
        for one in found.fitted:
            true = truth[one.sought.names[0]]
            here = one.low <= true <= one.high
            inside[one.sought.label] += here
            all_in &= here
            scores[one.sought.label].append((one.value - true) / one.error)
            errors[one.sought.label].append(one.error / true)
            row += f"{one.value / true - 1:+14.2e} ({scores[one.sought.label][-1]:+.1f})"
        whole += all_in
        print(f"{seed:4d}  {row}{'' if all_in else '   outside'}", flush=True)
    low, high = binom.interval(0.95, tried, 0.95)
    print(f"\ntruth inside the 95 % interval, of {tried}: {inside}; all three at once: {whole}")
    print(f"expected {low:.0f} to {high:.0f}; errors, in standard errors and relative, as medians:")
    for label in labels:
        own = np.array(scores[label])
        print(
            f"  {label}: root mean square {np.sqrt(np.mean(own**2)):.2f}, "
            f"greatest {np.max(np.abs(own)):.1f}; {statistics.median(errors[label]):.1e}"
        )
    print(f"median processor time: {statistics.median(times):.1f} s")


if __name__ == "__main__":
    main()
