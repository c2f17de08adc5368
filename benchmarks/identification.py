"""How often the 95 % intervals of `identify` hold the truth, on recordings whose truth is known.

    python benchmarks/identification.py [--seeds 60] [--noise 0.01] [--correlated]
        [--problem forced_oscillator] [--rate 500] [--cycles 12] [--velocities]

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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from zeno_orbits.experiment import (
    RecordedSignal,
    Recording,
    Source,
    UnfittableError,
    Unknown,
    identify,
)
from zeno_orbits.experiment.orbit_table import tabulate_orbit
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.problem import Problem
from zeno_orbits.search import close_orbit


@dataclass(frozen=True, kw_only=True)
class Case:
    """A problem whose parameters are found.

    Attributes:
        signals: What is recorded.
        velocities: What is recorded as well with ``--velocities``.
        unknowns: What is found.
        spread: How far the truth is from the problem's numbers: relative standard deviations.
    """

    signals: tuple[str, ...]
    velocities: tuple[str, ...]
    unknowns: tuple[Unknown, ...]
    spread: tuple[float, ...]


PROBLEM = "motor_pendulum"
CASES = {
    PROBLEM: Case(
        signals=("theta1", "theta2", "current"),
        velocities=("dtheta1", "dtheta2"),
        unknowns=(
            Unknown(names=("R",), lower=2.0, upper=4.0),
            Unknown(names=("K_torque", "K_emf"), lower=0.02, upper=0.05),
            Unknown(names=("restitution",), lower=0.0, upper=0.4),
        ),
        spread=(0.03, 0.02, 0.05),
    ),
    "forced_oscillator": Case(
        signals=("distance",),
        velocities=("speed",),
        unknowns=(
            Unknown(names=("c",), lower=1.0, upper=3.0),
            Unknown(names=("restitution",), lower=0.2, upper=0.8),
        ),
        spread=(0.02, 0.03),
    ),
    "vibrating_table": Case(
        signals=("height",),
        velocities=("speed",),
        unknowns=(
            Unknown(names=("A",), lower=0.013, upper=0.018),
            Unknown(names=("restitution",), lower=0.1, upper=0.6),
        ),
        spread=(0.01, 0.05),
    ),
}
SIGNALS, SOUGHT = CASES[PROBLEM].signals, CASES[PROBLEM].unknowns
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
    options: argparse.Namespace, problem: Problem, seed: int
) -> tuple[Recording, dict[str, float]] | None:
    """Return a recording and its truth, or nothing if there is no orbit at that truth."""
    case = CASES[options.problem]
    rng = np.random.default_rng(seed)
    truth = dict(problem.values().parameters)
    for one, spread in zip(case.unknowns, case.spread, strict=True):
        factor = 1.0 + spread * rng.normal()
        truth |= {name: truth[name] * factor for name in one.names}
    orbit = close_orbit(problem, problem.values(parameters=truth)).orbit
    if orbit is None:
        return None
    names = (*case.signals, *(case.velocities if options.velocities else ()))
    table = tabulate_orbit(orbit, problem, names)
    times = np.arange(int(options.cycles * orbit.period * options.rate)) / options.rate
    values = table.at(times / orbit.period + rng.random())
    noise = noise_of(rng, values.shape, correlated=options.correlated)
    values += options.noise * np.ptp(values, axis=0) * noise
    units = dict(zip(problem.state_names, problem.state_units, strict=True))
    signals = tuple(
        RecordedSignal(name=name, unit=units[name], values=values[:, k].copy())
        for k, name in enumerate(names)
    )
    recording = Recording(
        source=Source.SIMULATED, problem=problem.name, time=times, signals=signals
    )
    return recording, truth


def main() -> None:
    """Run the benchmark and print one row a seed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--noise", type=float, default=0.01)
    parser.add_argument("--correlated", action="store_true")
    parser.add_argument("--problem", choices=CASES, default=PROBLEM)
    parser.add_argument("--rate", type=float, default=RATE, help="samples a second [Hz]")
    parser.add_argument("--cycles", type=int, default=CYCLES)
    parser.add_argument("--velocities", action="store_true", help="record velocities as well")
    options = parser.parse_args()
    problem, unknowns = load_problem(options.problem), CASES[options.problem].unknowns
    labels = [one.label for one in unknowns]
    inside, whole, tried = dict.fromkeys(labels, 0), 0, 0
    scores: dict[str, list[float]] = {label: [] for label in labels}
    errors: dict[str, list[float]] = {label: [] for label in labels}
    times: list[float] = []
    print("seed  " + "".join(f"{label:>22}" for label in labels) + "   (error in standard errors)")
    for seed in range(options.seeds):
        made = recorded(options, problem, seed)
        if made is None:
            print(f"{seed:4d}  no orbit at this truth")
            continue
        recording, truth = made
        began = time.process_time()
        tried += 1
        try:
            found = identify(problem, problem.values(), recording, unknowns)
        except UnfittableError as error:
            print(f"{seed:4d}  {error}")
            continue
        times.append(time.process_time() - began)
        row, all_in = "", True
        for one in found.fitted:
            true = truth[one.unknown.names[0]]
            here = one.low <= true <= one.high
            inside[one.unknown.label] += here
            all_in &= here
            scores[one.unknown.label].append((one.value - true) / one.error)
            errors[one.unknown.label].append(one.error / true)
            row += f"{one.value / true - 1:+14.2e} ({scores[one.unknown.label][-1]:+.1f})"
        whole += all_in
        print(f"{seed:4d}  {row}{'' if all_in else '   outside'}", flush=True)
    low, high = binom.interval(0.95, tried, 0.95)
    print(f"\ntruth inside the 95 % interval, of {tried}: {inside}; all at once: {whole}")
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
