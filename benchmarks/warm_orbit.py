"""Time a verified orbit at given gains in a warm process: guess, closing, verification.

Every repetition starts from the numbers of the problem, at gains that change from one to the next;
nothing is kept but compiled code. A further table certifies the same orbits independently: with
another engine than they were closed with, and on the model written by hand.
"""

from __future__ import annotations

import argparse
import itertools
import json
import statistics
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from zeno_orbits.integrators import Automatic, Engine, Radau
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.problem import Problem
from zeno_orbits.search import orbit_by_shooting
from zeno_orbits.simulation.simulator import SimulationSettings
from zeno_orbits.verification.verifier import VerificationSettings, verify

BOUND = 0.05
"""Largest median wall time of a verified orbit with the default engine [s]."""

ENGINES: Mapping[str, Engine] = {"Automatic": Automatic(), "Radau": Radau()}
GAINS = tuple({"Kp": kp, "Kd": -1.0} for kp in (2.5, 2.6, 3.0, 4.0))
STAGES = ("guess", "closing", "verify", "all")


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Medians over the repetitions [s].

    Attributes:
        closed_with: Engine of guess and closing.
        checked_with: Engine, or model, of the verification.
        wall: Stage to wall time.
        cpu: Stage to processor time.
        worst: Largest residual of all certificates.
        passed: Whether all certificates say yes.
    """

    closed_with: str
    checked_with: str
    wall: Mapping[str, float]
    cpu: Mapping[str, float]
    worst: float
    passed: bool


def measure(
    problem: Problem, closed_with: str, checked_with: str, runs: int, *, by_hand: bool = False
) -> Timing:
    """Find and verify orbits at changing gains."""
    making = SimulationSettings(engine=ENGINES[closed_with])
    checking = VerificationSettings(
        simulation=SimulationSettings(engine=ENGINES[checked_with]), use_reference=by_hand
    )
    wall: dict[str, list[float]] = {stage: [] for stage in STAGES}
    cpu: dict[str, list[float]] = {stage: [] for stage in STAGES}
    worst, passed = 0.0, True

    # One round over all gains compiles what there is to compile and does not count.
    for count, gains in zip(range(len(GAINS) + runs), itertools.cycle(GAINS), strict=False):
        marks: list[tuple[float, float]] = []

        def mark(
            _stage: str = "",
            _share: float | None = None,
            *,
            marks: list[tuple[float, float]] = marks,
        ) -> None:
            marks.append((time.perf_counter(), time.process_time()))

        mark()
        values = problem.values(gains=gains)
        orbit = orbit_by_shooting(problem, values, simulation=making, on_progress=mark).unwrap()
        mark()
        certificate = verify(orbit, problem, settings=checking)
        mark()
        # Stages begin at the start, where the guess is closed, at the orbit and at its verdict.
        begun = (marks[0], marks[-3], marks[-2], marks[-1])
        if count >= len(GAINS):
            for stage, (first, last) in zip(
                STAGES, (*itertools.pairwise(begun), (begun[0], begun[-1])), strict=True
            ):
                wall[stage].append(last[0] - first[0])
                cpu[stage].append(last[1] - first[1])
        worst = max(worst, *certificate.residuals.values())
        passed = passed and certificate.passed
    return Timing(
        closed_with=closed_with,
        checked_with="model by hand" if by_hand else checked_with,
        wall={stage: statistics.median(times) for stage, times in wall.items()},
        cpu={stage: statistics.median(times) for stage, times in cpu.items()},
        worst=worst,
        passed=passed,
    )


def row(timing: Timing) -> str:
    """Return one line, wall and processor time of each stage in ms."""
    cells = "".join(
        f"{1e3 * timing.wall[stage]:9.1f}{1e3 * timing.cpu[stage]:7.1f}" for stage in STAGES
    )
    verdict = "yes" if timing.passed else "NO"
    return f"{timing.closed_with:10}{timing.checked_with:14}{cells}{timing.worst:9.0e}  {verdict}"


def main() -> int:
    """Measure; 1 if the median is too long, or an orbit is refused."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=20, metavar="N", help="repetitions, 9 at least")
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    options = parser.parse_args()
    if options.runs < 9:
        parser.error(f"--runs must be at least 9, but it is {options.runs}")
    problem = load_problem("motor_pendulum")
    timings = [
        measure(problem, "Automatic", "Automatic", options.runs),
        measure(problem, "Automatic", "Radau", options.runs),
        measure(problem, "Radau", "Automatic", options.runs),
        measure(problem, "Automatic", "Automatic", options.runs, by_hand=True),
    ]
    median = timings[0].wall["all"]
    good = median < BOUND and all(timing.passed for timing in timings)
    if options.json:
        print(json.dumps({"bound": BOUND, "good": good, "rows": [asdict(t) for t in timings]}))
        return 0 if good else 1
    heads = "".join(f"{stage + ' [ms]':>16}" for stage in STAGES)
    print(f"closed    checked       {heads}    worst  ok")
    print(" " * 24 + "     wall    cpu" * len(STAGES))
    for timing in timings:
        print(row(timing))
    print(f"\nMedian of the first row: {1e3 * median:.1f} ms. The bound is {1e3 * BOUND:.0f} ms.")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
