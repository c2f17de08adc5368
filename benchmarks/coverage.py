"""How often the intervals of `identify` and the errors of `compare` hold the truth.

    python benchmarks/coverage.py [--only fits comparisons] [--problems NAME ...] [--fits 50]
        [--comparisons 50] [--noise 0.01] [--workers N] [--checkpoint FOLDER] [--quick]
    python benchmarks/coverage.py --only fits --problems motor_pendulum --rates 100 250 500 1000
        --velocities no yes [--correlated]

Fits: every recording has its own truth, some per cent from the problem's numbers, its own phase and
its own noise; the fit begins at the problem's numbers. A parameter is held if its 95 % interval
contains the truth. With ``--correlated`` the noise is that of a filtered sensor. With ``--noise 0``
only the tables of the orbits limit the numbers. With ``--instruments`` one channel has a gain and
an offset, the clock has a rate, and the fit determines them too.

Comparisons: recordings of the problem's orbit, simulated, at a random phase with 0.1 % of noise. A
value is held if it is within two standard errors of the orbit's, 95 % of the time at least.

The last rows take a quantity of all problems and signals together. Every share has its binomial
interval of 95 %. A quantity fails if so few are held that chance explains it less often than once
in twenty benchmarks, or if all of at least 500 are held: the error is then too wide. With
OPENBLAS_NUM_THREADS=1 in the environment a fit takes half of the time.
"""

from __future__ import annotations

import argparse
import math
import re
import statistics
import sys
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, binomtest

sys.path.insert(0, str(Path(__file__).parent))

from comparison import machine, recorded, scores
from support.spreading import add_options, arriving

from zeno_orbits.experiment import (
    FitParameter,
    RecordedSignal,
    Recording,
    Source,
    UnfittableError,
    fit_parameters,
)
from zeno_orbits.experiment.orbit_table import tabulate_orbit
from zeno_orbits.model.library import load_problem
from zeno_orbits.search import orbit_by_shooting


@dataclass(frozen=True, kw_only=True)
class Case:
    """A problem whose parameters are found.

    Attributes:
        signals: What is recorded.
        velocities: What is recorded as well with ``--velocities yes``.
        unknowns: What is found.
        off: How far the truth is from the problem's numbers: relative standard deviations.
    """

    signals: tuple[str, ...]
    velocities: tuple[str, ...]
    unknowns: tuple[FitParameter, ...]
    off: tuple[float, ...]


def unknown(label: str, lower: float, upper: float) -> FitParameter:
    """Return an unknown with its range."""
    return FitParameter(names=tuple(label.split("+")), lower=lower, upper=upper)


ANGLES = ("theta1", "theta2")
ANGLE_RATES = ("dtheta1", "dtheta2")
CASES: Mapping[str, Case] = {
    "motor_pendulum": Case(
        signals=(*ANGLES, "current"),
        velocities=ANGLE_RATES,
        unknowns=(
            unknown("R", 2.0, 4.0),
            unknown("K_torque+K_emf", 0.02, 0.05),
            unknown("restitution", 0.0, 0.4),
        ),
        off=(0.03, 0.02, 0.05),
    ),
    "forced_oscillator": Case(
        signals=("distance",),
        velocities=("speed",),
        unknowns=(unknown("c", 1.0, 3.0), unknown("restitution", 0.2, 0.8)),
        off=(0.02, 0.03),
    ),
    "vibrating_table": Case(
        signals=("height",),
        velocities=("speed",),
        unknowns=(unknown("A", 0.013, 0.018), unknown("restitution", 0.1, 0.6)),
        off=(0.01, 0.05),
    ),
    "relief_valve": Case(
        signals=("lift", "pressure"),
        velocities=("rate",),
        unknowns=(unknown("b", 10.0, 30.0), unknown("restitution", 0.05, 0.5)),
        off=(0.01, 0.05),
    ),
    "solenoid": Case(
        signals=("opening", "current"),
        velocities=("rate",),
        unknowns=(unknown("R", 15.0, 25.0), unknown("restitution", 0.1, 0.6)),
        off=(0.02, 0.05),
    ),
    "motor_valve": Case(
        signals=("opening", "current"),
        velocities=("rate",),
        unknowns=(unknown("R", 0.3, 0.7), unknown("restitution", 0.1, 0.6)),
        off=(0.02, 0.05),
    ),
    "curved_surface": Case(
        signals=("x", "y"),
        velocities=("dx", "dy"),
        unknowns=(unknown("A", 0.013, 0.018), unknown("restitution", 0.1, 0.6)),
        off=(0.01, 0.05),
    ),
    "motor_cart": Case(
        signals=("x", "angle", "current"),
        velocities=("dx", "dangle"),
        unknowns=(unknown("R", 1.0, 2.0), unknown("restitution", 0.1, 0.6)),
        off=(0.02, 0.05),
    ),
    "torque_pendulum": Case(
        signals=ANGLES,
        velocities=ANGLE_RATES,
        unknowns=(unknown("b1", 0.05, 0.15), unknown("restitution", 0.1, 0.6)),
        off=(0.02, 0.05),
    ),
    "two_motors": Case(
        signals=(*ANGLES, "current1", "current2"),
        velocities=ANGLE_RATES,
        unknowns=(unknown("R", 2.0, 4.0), unknown("restitution", 0.05, 0.4)),
        off=(0.02, 0.05),
    ),
}
FITTED_CYCLES, COMPARED_CYCLES = 12, 10
FITTED_SAMPLES, COMPARED_SAMPLES = 200.37, 150.37
"""Samples a period, not whole numbers: phases differ from cycle to cycle."""
COMPARED_NOISE, WITHIN, MOST = 1e-3, 2.0, 1e6
"""Noise, standard errors within which a value is held, and the most that a table shows."""
CLOCK = "clock_rate"
MEMORY = 8
"""Samples over which a filtered sensor forgets."""
SHARE, CHANCE, ALWAYS = 0.95, 0.05, 500
"""Share of truths that are held, chance of one false alarm, and values of which one is missed."""
GAIN, OFFSET, RATE = 0.03, 0.05, 3e-4
"""Standard deviations of errors of instruments: relative, in parts of the range, and relative."""


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
class Judge:
    """Values of recordings beside their truth.

    Attributes:
        noise: Standard deviation for fits in parts of each signal's range.
        correlated: Whether it is that of a filtered sensor.
        instruments: Whether the last channel and the clock have errors.
        cycles: Length of a fitted recording in periods.
        spread: Factor of how far the truth is from the problem's numbers.
    """

    noise: float
    correlated: bool = False
    instruments: bool = False
    cycles: int = FITTED_CYCLES
    spread: float = 1.0

    def __call__(self, points: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        """Return, for each point, the rows of its values, or why there are none."""
        return [self._compared(p) if p["part"] == COMPARISONS else self._fitted(p) for p in points]

    def recorded(self, point: dict[str, Any]) -> tuple[Recording, dict[str, float]] | None:
        """Return a recording and its truth, or nothing if there is no orbit at that truth."""
        problem, case = load_problem(point["problem"]), CASES[point["problem"]]
        rng = np.random.default_rng([zlib.crc32(point["problem"].encode()), point["seed"]])
        truth = dict(problem.values().parameters)
        for one, off in zip(case.unknowns, case.off, strict=True):
            factor = 1.0 + self.spread * off * rng.normal()
            truth |= {name: truth[name] * factor for name in one.names}
        orbit = orbit_by_shooting(problem, problem.values(parameters=truth)).orbit
        if orbit is None:
            return None
        names = (*case.signals, *(case.velocities if point["velocities"] else ()))
        table = tabulate_orbit(orbit, problem, names)
        rate = point["rate"] or point.get("samples", FITTED_SAMPLES) / orbit.period
        times = np.arange(int(self.cycles * orbit.period * rate)) / rate
        values = table.at(times / orbit.period + rng.random())
        noise = noise_of(rng, values.shape, correlated=self.correlated)
        extent = np.ptp(values, axis=0)
        values += self.noise * extent * noise
        if self.instruments:
            at, channel = len(case.signals) - 1, case.signals[-1]
            gain, offset, rate = rng.normal(size=3) * (GAIN, OFFSET * extent[at], RATE)
            values[:, at] = (1.0 + gain) * values[:, at] + offset
            times *= 1.0 + rate
            truth |= {f"{channel}.gain": 1.0 + gain, f"{channel}.offset": offset, CLOCK: rate}
        units = dict(zip(problem.state_names, problem.state_units, strict=True))
        signals = tuple(
            RecordedSignal(name=name, unit=units[name], values=values[:, k].copy())
            for k, name in enumerate(names)
        )
        source = Source.SIMULATED
        return Recording(source=source, problem=problem.name, time=times, signals=signals), truth

    def sought(self, name: str) -> tuple[FitParameter, ...]:
        """Return what is found in recordings of a problem."""
        case = CASES[name]
        if not self.instruments:
            return case.unknowns
        channel = case.signals[-1]
        return (
            *case.unknowns,
            unknown(f"{channel}.gain", 0.5, 2.0),
            unknown(f"{channel}.offset", -math.inf, math.inf),
            unknown(CLOCK, -0.05, 0.05),
        )

    def _fitted(self, point: dict[str, Any]) -> dict[str, Any]:
        made = self.recorded(point)
        if made is None:
            return {"refused": "no orbit at this truth"}
        recording, truth = made
        problem, sought = load_problem(point["problem"]), self.sought(point["problem"])
        began = time.process_time()
        try:
            found = fit_parameters(problem, problem.values(), recording, sought)
        except UnfittableError as error:
            return {"refused": str(error)}
        if not all(math.isfinite(one.error) for one in found.fitted):
            return {"refused": f"no interval: {found.remarks}"}
        rows: list[list[Any]] = []
        for one in found.fitted:
            true = truth[one.unknown.names[0]]
            held = bool(one.low <= true <= one.high)
            score = float((one.value - true) / one.error)
            rows.append([one.unknown.label, held, score, float(one.error / abs(true))])
        return {"rows": rows, "seconds": time.process_time() - began}

    def _compared(self, point: dict[str, Any]) -> dict[str, Any]:
        one = machine(point["problem"], COMPARED_CYCLES)
        recording = recorded(one, COMPARED_SAMPLES, COMPARED_CYCLES, COMPARED_NOISE, point["seed"])
        began = time.process_time()
        try:
            found = [score for score in scores(one, recording) if score.resolved]
        except ValueError as error:
            return {"refused": str(error)}
        rows: list[list[Any]] = []
        for score in found:
            size = max(abs(score.orbit), abs(score.data)) or 1.0
            off = math.copysign(min(score.off, MOST), score.data - score.orbit)
            rows.append(
                [score.name, bool(score.off <= WITHIN), float(off), float(score.error / size)]
            )
        return {"rows": rows, "seconds": time.process_time() - began}


FITS, COMPARISONS, ALL = "fits", "comparisons", "all"


@dataclass(frozen=True, kw_only=True)
class Row:
    """The values of one quantity.

    Attributes:
        kind: Problem, and signals and rate of a fit that differ from the default.
        name: The quantity.
        held: Whether each value is held.
        scores: Deviation of each value in its standard errors.
        errors: Standard error of each value, relative.
    """

    kind: str
    name: str
    held: list[bool]
    scores: list[float]
    errors: list[float]

    def rare(self, tests: int) -> bool:
        """Return True if chance explains so few less often than its share of so many tests."""
        few = float(binom.cdf(sum(self.held), len(self.held), SHARE))
        return few < CHANCE / tests

    @property
    def wide(self) -> bool:
        """Whether so many values are all held that the errors are too wide."""
        return len(self.held) >= ALWAYS and all(self.held)

    def told(self, tests: int) -> str:
        """Return the row of the table."""
        n, n_held = len(self.held), sum(self.held)
        low, high = binomtest(n_held, n).proportion_ci()
        sizes = np.array(self.scores)
        flag = " (!)" if self.rare(tests) or self.wide else ""
        return (
            f"| {self.kind} | {self.name} | {n_held} of {n}{flag} | {n_held / n:.1%} "
            f"({low:.1%} to {high:.1%}) | {np.mean(sizes):+.2f} | "
            f"{np.sqrt(np.mean(sizes**2)):.2f} | {np.max(np.abs(sizes)):.1f} | "
            f"{np.median(self.errors):.1e} |"
        )


def rows_of(points: Sequence[dict[str, Any]], results: Sequence[Any]) -> list[Row]:
    """Return the quantities of all points, in order."""
    found: dict[tuple[str, str], Row] = {}
    shared: dict[tuple[str, str], Row] = {}
    for point, result in zip(points, results, strict=True):
        for name, held, score, error in result.get("rows", []):
            # A quantity of several signals or problems is one quantity: "highest of lift" too.
            keys = (
                (point["kind"], name),
                (ALL, re.sub(r" of (?!chatter).*|.*\.(?=gain|offset)", "", name)),
            )
            for rows, (kind, of) in zip((found, shared), keys, strict=True):
                new = Row(kind=kind, name=of, held=[], scores=[], errors=[])
                row = rows.setdefault((kind, of), new)
                row.held.append(held)
                row.scores.append(score)
                row.errors.append(error)
    return [*found.values(), *shared.values()]


def show(part: str, points: Sequence[dict[str, Any]], results: Sequence[Any]) -> bool:
    """Print the table of a part and its sums.

    Returns:
        True if no quantity is held too seldom, or always.
    """
    rows = rows_of(points, results)
    print(
        f"\n| Problem, {part} | Quantity | Held | Share (95 % interval) | Mean | Root mean square "
        "| Greatest | Standard error |\n|---|---|---|---|---|---|---|---|"
    )
    print(*(row.told(len(rows)) for row in rows), sep="\n")
    for point, result in zip(points, results, strict=True):
        if "refused" in result:
            print(f"    {point['kind']}, seed {point['seed']}: {result['refused']}")
    held = sum(sum(row.held) for row in rows if row.kind == ALL)
    n = sum(len(row.held) for row in rows if row.kind == ALL)
    told = [result["seconds"] for result in results if "seconds" in result]
    if not told:
        return False
    rare, wide = sum(row.rare(len(rows)) for row in rows), sum(row.wide for row in rows)
    low, high = binomtest(held, n).proportion_ci()
    print(
        f"{len(told)} of {len(results)} {part} with values: {held} of {n} held, {held / n:.1%} "
        f"({low:.1%} to {high:.1%}); {rare} of {len(rows)} quantities too seldom, {wide} always; "
        f"{statistics.median(told):.2f} s each.",
        flush=True,
    )
    return not rare and not wide


def points_of(part: str, options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield the recordings of a part."""
    for name in options.problems:
        if part == COMPARISONS:
            for seed in range(options.comparisons):
                yield {"part": part, "problem": name, "kind": name, "seed": seed}
            continue
        for velocities in options.velocities:
            for rate in options.rates or [0.0]:
                kind = name + (", velocities" if velocities == "yes" else "")
                kind += f", {rate:g} Hz" if rate else ""
                for seed in range(options.fits):
                    point = {"part": part, "problem": name, "kind": kind, "seed": seed}
                    yield {**point, "velocities": velocities == "yes", "rate": rate}


def main() -> int:
    """Print the tables; 1 if a quantity is held too seldom, or always."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parts = (FITS, COMPARISONS)
    parser.add_argument("--only", nargs="+", choices=parts, default=list(parts))
    parser.add_argument("--problems", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--fits", type=int, default=50, help="of each problem, rate and signals")
    parser.add_argument("--comparisons", type=int, default=50, help="of each problem")
    parser.add_argument("--noise", type=float, default=0.01, help="of fits")
    parser.add_argument("--correlated", action="store_true", help="noise of a filtered sensor")
    parser.add_argument("--instruments", action="store_true", help="errors of channel and clock")
    parser.add_argument("--rates", nargs="+", type=float, help="samples a second, of fits [Hz]")
    parser.add_argument("--cycles", type=int, default=FITTED_CYCLES, help="of fits")
    parser.add_argument("--velocities", nargs="+", choices=("no", "yes"), default=["no"])
    add_options(parser)
    parser.add_argument("--quick", action="store_true", help="two recordings of each problem")
    options = parser.parse_args()
    if options.quick:
        options.fits = options.comparisons = 2
    judge = Judge(
        noise=options.noise,
        correlated=options.correlated,
        instruments=options.instruments,
        cycles=options.cycles,
    )
    sound = True
    for part in options.only:
        points = list(points_of(part, options))
        results = list(arriving(part, judge, points, options, chunk=10))
        sound &= show(part, points, results)
    return 0 if sound else 1


if __name__ == "__main__":
    raise SystemExit(main())
