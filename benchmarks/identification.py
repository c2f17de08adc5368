"""How often the 95 % intervals of `identify` hold the truth, on recordings whose truth is known.

    python benchmarks/identification.py [--problem motor_pendulum forced_oscillator vibrating_table]
        [--rates 100 250 500 1000] [--velocities no yes] [--seeds 20] [--noise 0.01] [--correlated]

Every seed has its own truth, some per cent from the problem's numbers, its own unknown start and
its own noise on every signal; the fit begins at the problem's numbers. With ``--correlated`` the
noise is that of a filtered sensor, which a fit that counts samples as independent gets wrong; with
``--noise 0`` there is none, and the tables of the orbits alone limit the numbers.
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
        velocities: What is recorded as well with ``--velocities yes``.
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


@dataclass(frozen=True, kw_only=True)
class Study:
    """Recordings of one kind: a problem, its signals and their rate.

    Attributes:
        problem: The problem.
        velocities: Whether they are recorded.
        rate: Samples a second [Hz].
        cycles: Length in periods.
        noise: Standard deviation in parts of each signal's range.
        correlated: Whether it is that of a filtered sensor.
    """

    problem: Problem
    velocities: bool
    rate: float
    cycles: int = CYCLES
    noise: float = 0.01
    correlated: bool = False

    @property
    def case(self) -> Case:
        """What is recorded and found."""
        return CASES[self.problem.name]

    def recorded(self, seed: int) -> tuple[Recording, dict[str, float]] | None:
        """Return a recording and its truth, or nothing if there is no orbit at that truth."""
        case, problem = self.case, self.problem
        rng = np.random.default_rng(seed)
        truth = dict(problem.values().parameters)
        for one, spread in zip(case.unknowns, case.spread, strict=True):
            factor = 1.0 + spread * rng.normal()
            truth |= {name: truth[name] * factor for name in one.names}
        orbit = close_orbit(problem, problem.values(parameters=truth)).orbit
        if orbit is None:
            return None
        names = (*case.signals, *(case.velocities if self.velocities else ()))
        table = tabulate_orbit(orbit, problem, names)
        times = np.arange(int(self.cycles * orbit.period * self.rate)) / self.rate
        values = table.at(times / orbit.period + rng.random())
        noise = noise_of(rng, values.shape, correlated=self.correlated)
        values += self.noise * np.ptp(values, axis=0) * noise
        units = dict(zip(problem.state_names, problem.state_units, strict=True))
        signals = tuple(
            RecordedSignal(name=name, unit=units[name], values=values[:, k].copy())
            for k, name in enumerate(names)
        )
        source = Source.SIMULATED
        return Recording(source=source, problem=problem.name, time=times, signals=signals), truth


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """One fit beside its truth.

    Attributes:
        inside: Whether the interval of each number holds the truth.
        scores: Error of each number in its standard errors.
        errors: Relative standard errors.
        seconds: Processor time [s].
    """

    inside: tuple[bool, ...]
    scores: tuple[float, ...]
    errors: tuple[float, ...]
    seconds: float


def fitted(study: Study, seed: int) -> Fitted | str:
    """Return the fit of one seed's recording, or why there is none."""
    made = study.recorded(seed)
    if made is None:
        return "no orbit at this truth"
    recording, truth = made
    began = time.process_time()
    try:
        found = identify(study.problem, study.problem.values(), recording, study.case.unknowns)
    except UnfittableError as error:
        return str(error)
    seconds = time.process_time() - began
    true = [truth[one.unknown.names[0]] for one in found.fitted]
    pairs = list(zip(found.fitted, true, strict=True))
    return Fitted(
        inside=tuple(one.low <= value <= one.high for one, value in pairs),
        scores=tuple((one.value - value) / one.error for one, value in pairs),
        errors=tuple(one.error / value for one, value in pairs),
        seconds=seconds,
    )


def main() -> int:
    """Print one row a seed on request, and one row a kind of recording; 1 if one holds too few."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--noise", type=float, default=0.01)
    parser.add_argument("--correlated", action="store_true")
    parser.add_argument("--problem", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--rates", nargs="+", type=float, default=[100.0, 250.0, 500.0, 1000.0])
    parser.add_argument("--cycles", type=int, default=CYCLES)
    parser.add_argument("--velocities", nargs="+", choices=("no", "yes"), default=["no", "yes"])
    parser.add_argument("--each", action="store_true", help="print every fit, too")
    options = parser.parse_args()
    low, high = binom.interval(0.95, options.seeds, 0.95)
    print(f"of {options.seeds}, {low:.0f} to {high:.0f} are expected inside a 95 % interval\n")
    print(
        "| Problem | Velocities | Rate [Hz] | Fitted | Inside | Root mean square, greatest error "
        "in standard errors | Standard errors | Time |\n|---|---|---|---|---|---|---|---|"
    )
    enough = True
    for name in options.problem:
        problem = load_problem(name)
        for velocities in options.velocities:
            for rate in options.rates:
                study = Study(
                    problem=problem,
                    velocities=velocities == "yes",
                    rate=rate,
                    cycles=options.cycles,
                    noise=options.noise,
                    correlated=options.correlated,
                )
                enough &= show(study, options.seeds, each=options.each) >= low
    return 0 if enough else 1


def show(study: Study, seeds: int, *, each: bool) -> int:
    """Print one row, and return how often the number that is worst off was inside."""
    found: list[Fitted] = []
    for seed in range(seeds):
        one = fitted(study, seed)
        if isinstance(one, Fitted):
            found.append(one)
        if each or isinstance(one, str):
            print(f"    seed {seed}: {one}", flush=True)
    if not found:
        print(f"| {study.problem.name} | {study.velocities} | {study.rate:g} | none of {seeds} |")
        return 0
    labels = [one.label for one in study.case.unknowns]
    inside = np.array([one.inside for one in found]).reshape(-1, len(labels)).sum(axis=0)
    held = ", ".join(f"`{label}` {count}" for label, count in zip(labels, inside, strict=True))
    scores = np.array([one.scores for one in found]).ravel()
    errors = np.array([one.errors for one in found]).reshape(-1, len(labels))
    print(
        f"| {study.problem.name} | {'yes' if study.velocities else 'no'} | {study.rate:g} | "
        f"{len(found)} of {seeds} | {held} | {np.sqrt(np.mean(scores**2)):.2f}, "
        f"{np.max(np.abs(scores)):.1f} | "
        f"{', '.join(f'{size:.1e}' for size in np.median(errors, axis=0))} | "
        f"{statistics.median(one.seconds for one in found):.1f} s |",
        flush=True,
    )
    return int(inside.min())


if __name__ == "__main__":
    raise SystemExit(main())
