"""Measure by how much our engines err: the motor pendulum for 20 s from several starts.

The largest error over the tolerance; then, as `simulate --accuracy` does it, over the accuracy that
was asked for and over the estimate that comes with it. The error is that of
`zeno-orbits work-precision`: of any event and of the end, times relative to the last event's and
states to their largest value. It is held against the implicit engine at 1e-14.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence

import numpy as np

from zeno_orbits.integrators import Automatic, Engine, Radau, RungeKutta
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.precision.accuracy import at_tolerance, execution_to_accuracy
from zeno_orbits.precision.landmark import execution_distance
from zeno_orbits.simulation.execution import Execution
from zeno_orbits.simulation.simulator import SimulationSettings, simulate

ENGINES: dict[str, Engine] = {
    "automatic": Automatic(),
    "explicit": RungeKutta(),
    "implicit": Radau(),
}

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)

TRUE = 1e-14
"""Tolerance of what errors are held against."""

BOUND = 2.0
"""Estimates that an error may be: the estimate is the change from ten times the tolerance."""

HORIZON = 20.0
"""How long every motion is followed [s]: some ten periods."""

ACCURACIES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)
"""What is asked for."""


def starts(n: int) -> list[tuple[float, ...]]:
    """Return where the motions start: ``theta1, theta2, dtheta1, dtheta2, current``."""
    random = np.random.default_rng(3)
    return [
        (random.uniform(-1, 1), random.uniform(0, 1), *random.uniform(-2, 2, 2), 0.0)
        for _ in range(n)
    ]


def follow(dynamics: HybridDynamics, x: Sequence[float], tolerance: float, e: Engine) -> Execution:
    """Return the motion from a start at a tolerance."""
    settings = at_tolerance(tolerance, SimulationSettings(engine=e))
    return simulate(dynamics, x, until=HORIZON, settings=settings)


def over_tolerance(
    dynamics: HybridDynamics, motions: Sequence[tuple[tuple[float, ...], Execution]], e: Engine
) -> list[float]:
    """Return the largest error in units of each tolerance."""
    return [
        max(execution_distance(follow(dynamics, x, tolerance, e), truth) for x, truth in motions)
        / tolerance
        for tolerance in TOLERANCES
    ]


def over_promise(
    dynamics: HybridDynamics, motions: Sequence[tuple[tuple[float, ...], Execution]], e: Engine
) -> tuple[list[float], list[float]]:
    """Return the largest error in units of each accuracy, and in units of its estimate."""
    parts: list[float] = []
    shares: list[float] = []
    settings = SimulationSettings(engine=e)
    for accuracy in ACCURACIES:
        told = [
            execution_to_accuracy(dynamics, x, until=HORIZON, accuracy=accuracy, settings=settings)
            for x, _ in motions
        ]
        errors = [
            execution_distance(a.execution, t) for a, (_, t) in zip(told, motions, strict=True)
        ]
        parts.append(max(errors) / accuracy)
        shares.append(max(error / a.error for a, error in zip(told, errors, strict=True)))
    return parts, shares


def show(title: str, heads: Sequence[float], rows: dict[str, list[float]]) -> None:
    """Print one table."""
    print(f"{title}\n\n{'':12}" + "".join(f"{head:>10.0e}" for head in heads))
    for name, row in rows.items():
        print(f"{name:12}" + "".join(f"{ratio:>10.2g}" for ratio in row))
    print()


def main() -> int:
    """Measure; 1 if an accuracy is missed, or an estimate is below half the error."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--starts", type=int, default=8, metavar="N", help="motions to follow")
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    options = parser.parse_args()
    problem = load_problem("motor_pendulum")
    dynamics = problem.dynamics(problem.values())
    motions = [(x, follow(dynamics, x, TRUE, ENGINES["implicit"])) for x in starts(options.starts)]
    tolerances = {n: over_tolerance(dynamics, motions, e) for n, e in ENGINES.items()}
    promises = {n: over_promise(dynamics, motions, e) for n, e in ENGINES.items()}
    accuracies = {name: parts for name, (parts, _) in promises.items()}
    estimates = {name: shares for name, (_, shares) in promises.items()}
    if options.json:
        found = {"tolerance": tolerances, "accuracy": accuracies, "estimate": estimates}
        print(json.dumps(found, indent=2))
    else:
        print(f"Largest error of {options.starts} motions\n")
        show("Over the tolerance", TOLERANCES, tolerances)
        show("Over the accuracy asked for", ACCURACIES, accuracies)
        show("Over the estimate that comes with it", ACCURACIES, estimates)
    missed = max(max(row) for row in accuracies.values()) > 1.0
    return 1 if missed or max(max(row) for row in estimates.values()) > BOUND else 0


if __name__ == "__main__":
    sys.exit(main())
