"""Time a map of the reference problem on one core, and compare it with single simulations.

The bound is 12 ms a point: 100 x 100 points on two cores in a minute. Agreement: period and
release of settled points against one period of a single simulation, multipliers against the
derivatives along it, fates against a long one.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.support.returns import multipliers_at
from zeno_orbits.errors import RunawayError
from zeno_orbits.maps.attractors import Attractor, AttractorClass
from zeno_orbits.maps.classify import attractors_at
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.problem import ParameterValues, Problem
from zeno_orbits.simulation.simulator import SimulationSettings, simulate

BOUND = 12.0
"""Processor time of a point [ms]."""

FAR = 20 * np.pi
"""A coordinate beyond this is an escape in a single simulation [rad]."""

LONG = 200.0
"""Longest single simulation that a fate is compared with [s]."""


def settings_of(problem: Problem, size: int) -> list[ParameterValues]:
    """Return a square grid over the plane of the gains."""
    return [
        problem.values(gains={"Kp": float(kp), "Kd": float(kd)})
        for kd in np.linspace(-2.0, 0.0, size)
        for kp in np.linspace(1.0, 5.0, size)
    ]


def misses(
    problem: Problem, values: ParameterValues, found: Attractor
) -> tuple[float, float, float]:
    """Return by how much period, release state and multipliers miss those of a single simulation.

    The multipliers are those of orbits of one return.
    """
    dynamics = problem.dynamics(values)
    state = np.array([found.state[name] for name in problem.state_names])
    run = simulate(dynamics, state, until=1.5 * found.period)
    back = run.returns(found.period)[found.returns - 1]
    period, release = abs(back.time - found.period), float(np.max(np.abs(back.state - state)))
    if found.returns > 1:
        return period, release, np.nan
    exact = multipliers_at(dynamics, state, found.period)
    # Those of a complex pair have one modulus, so their order is not certain.
    missed = np.abs(np.sort_complex(exact) - np.sort_complex(found.multipliers))
    return period, release, float(np.max(missed))


def same_fate(problem: Problem, values: ParameterValues, found: Attractor) -> bool:
    """Return True if a long single simulation from the same start ends alike."""
    dynamics = problem.dynamics(values)
    start = problem.state_vector(problem.starts[0])
    try:
        run = simulate(dynamics, start, until=LONG, settings=SimulationSettings(far=FAR))
    except RunawayError:
        # Which coordinate is beyond its bound first depends on the bounds.
        return found.fate is AttractorClass.ESCAPE
    states = [release.state for release in run.releases]
    amplitudes = [float(np.max(np.abs(state))) for state in states]
    if found.fate is AttractorClass.REST:
        return amplitudes[-1] < 0.9 * amplitudes[len(amplitudes) // 2] < 0.9 * amplitudes[0]
    if found.fate is not AttractorClass.ZENO:
        return found.fate is AttractorClass.UNSETTLED
    named = np.array([found.state[name] for name in problem.state_names])
    away = [float(np.max(np.abs(state - named))) for state in states]
    nearest = min(away[-found.returns :])
    # Where a motion settles slowly it is still on its way, but nearer than before.
    return nearest < 1e-3 or nearest < 0.7 * min(
        away[len(away) // 2 - found.returns :][: found.returns]
    )


def print_figures(figures: dict[str, Any], *, as_json: bool) -> None:
    """Print one figure a line, or JSON."""
    if as_json:
        print(json.dumps(figures, indent=2))
        return
    width = max(map(len, figures))
    for name, value in figures.items():
        shown = f"{value:.3g}" if isinstance(value, float) else value
        print(f"{name:{width}} {shown}")


def main() -> int:
    """Print the figures; 1 if a point takes longer than the bound, or the answers differ."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--size", type=int, default=40, metavar="N", help="points along a side")
    parser.add_argument("--orbits", type=int, default=50, metavar="N", help="orbits compared")
    parser.add_argument("--fates", type=int, default=20, metavar="N", help="fates compared")
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    options = parser.parse_args()
    problem = load_problem("motor_pendulum")
    settings = settings_of(problem, options.size)
    attractors_at(problem, settings[:1], until=1.0)
    started = time.process_time()
    found = attractors_at(problem, settings)
    seconds = time.process_time() - started
    rng = np.random.default_rng(0)
    orbits = [k for k, one in enumerate(found) if one.returns]
    chosen = rng.choice(orbits, size=min(options.orbits, len(orbits)), replace=False)
    missed = np.array([misses(problem, settings[k], found[k]) for k in chosen])
    median, largest = np.nanmedian(missed, axis=0), np.nanmax(missed, axis=0)
    looked = rng.choice(len(found), size=min(options.fates, len(found)), replace=False)
    differ = [k for k in looked if not same_fate(problem, settings[k], found[k])]
    figures = {
        "points": len(found),
        "ms_a_point": 1e3 * seconds / len(found),
        "points_a_second": len(found) / seconds,
        "fates": dict(Counter(one.fate.value for one in found)),
        "period_miss_median": float(median[0]),
        "period_miss_largest": float(largest[0]),
        "release_miss_largest": float(largest[1]),
        "multiplier_miss_median": float(median[2]),
        "multiplier_miss_largest": float(largest[2]),
        "fates_compared": len(looked),
        "fates_that_differ": [
            dict(settings[k].gains) | {"map": found[k].fate.value} for k in differ
        ],
    }
    print_figures(figures, as_json=options.json)
    return int(figures["ms_a_point"] > BOUND)


if __name__ == "__main__":
    sys.exit(main())
