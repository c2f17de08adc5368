"""Whether a search finds the fastest contraction of a whole box with one free gain.

Random boxes of the motor pendulum: one gain is held, the other free over a random range. The truth
is a dense scan by the maps: the least spectral radius, or as good as zero where
the largest multiplier changes its sign between neighbouring orbits. Prints both; exit 1 if a search
ends above the truth by more than a thousandth, or finds nothing where the scan does.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np

from zeno_orbits.api import Verified
from zeno_orbits.maps import Attractor, Fate, attractors_at
from zeno_orbits.model import ParameterValues, Problem, load_problem
from zeno_orbits.search import FastestContraction, search_gains
from zeno_orbits.search.objectives import LEAST_RADIUS

RANGES = {"Kp": (0.5, 8.0), "Kd": (-2.0, -0.3)}
NARROWEST = 0.2
"""Least part of the range of a gain that a box covers."""
CLOSE = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """A box with one free gain.

    Attributes:
        free: The gain.
        low: Its lower end.
        high: Its upper end.
        held: Name of the other gain.
        value: Its value.
    """

    free: str
    low: float
    high: float
    held: str
    value: float


def boxes(seed: int) -> Iterator[Box]:
    """Yield random boxes without end, each gain free in turn."""
    random = np.random.default_rng(seed)
    while True:
        for free, held in (("Kd", "Kp"), ("Kp", "Kd")):
            least, most = RANGES[free]
            width = (most - least) * random.uniform(NARROWEST, 1.0)
            low = random.uniform(least, most - width)
            value = random.uniform(*RANGES[held])
            yield Box(free=free, low=low, high=low + width, held=held, value=value)


def least_radius(problem: Problem, box: Box, n_places: int) -> float:
    """Return the least spectral radius of the orbits in a box by a dense scan; infinite if none."""
    start = problem.values(gains={box.held: box.value})
    places = np.linspace(box.low, box.high, n_places).tolist()
    found = attractors_at(problem, [start.replaced({box.free: place}) for place in places])
    orbits = [one if one.fate is Fate.ZENO else None for one in found]
    least = min((one.spectral_radius for one in orbits if one is not None), default=math.inf)
    crosses = any(_crosses(a, b) for a, b in pairwise(orbits) if a is not None and b is not None)
    return LEAST_RADIUS if crosses else max(least, LEAST_RADIUS)


def _crosses(one: Attractor, other: Attractor) -> bool:
    """Return True if the only multiplier that is not nearly zero passes zero between two orbits."""
    if one.returns != other.returns or one.returns != 1:
        return False
    (a, *rest), (b, *others) = one.multipliers, other.multipliers
    alone = all(abs(value) < CLOSE for value in (*rest, *others))
    return alone and a.real * b.real < 0.0 and abs(a - b) < 0.5


def searched(problem: Problem, box: Box) -> float:
    """Return the least spectral radius that a search finds; infinite if it finds no orbit."""
    values: ParameterValues = problem.values(gains={box.held: box.value})
    result = search_gains(
        problem,
        values,
        free={box.free: (box.low, box.high)},
        objective=FastestContraction(),
        accept=Verified(problem=problem),
    )
    return result.candidates[0].score if result.candidates else math.inf


def main() -> int:
    """Run the study and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--boxes", type=int, default=10, metavar="N", help="boxes with an orbit")
    parser.add_argument("--places", type=int, default=200, metavar="N", help="places of the scan")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    options = parser.parse_args()
    problem = load_problem("motor_pendulum")
    rows: list[dict[str, object]] = []
    missed = 0
    for box in boxes(options.seed):
        if len(rows) == options.boxes:
            break
        truth = least_radius(problem, box, options.places)
        if not math.isfinite(truth):
            continue
        found = searched(problem, box)
        is_missed = found > truth * (1 + CLOSE) + CLOSE
        missed += is_missed
        rows.append({**asdict(box), "truth": truth, "found": found, "missed": is_missed})
        if not options.json:
            where = f"{box.held} = {box.value:.4g}, {box.free} = {box.low:.4g}:{box.high:.4g}"
            word = "MISSED" if is_missed else ""
            print(f"{where:40} scan {truth:.5f}  search {found:.5f}  {word}", flush=True)
    if options.json:
        print(json.dumps(rows, indent=2))
    else:
        print(f"{len(rows) - missed} of {len(rows)} found")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
