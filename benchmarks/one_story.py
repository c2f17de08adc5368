"""Print what the commands say of each problem at its own numbers: do they tell one story?

    python benchmarks/one_story.py [PROBLEM ...]

Search, verify, simulate, map and continue are asked; by default of all bundled problems that have
an orbit, and of the machines of the tests. After the largest relative difference between the
periods that they name come those of a machine with a stiff stop (`rig`), and how far `identify` is
off the true restitution with a recording without noise.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import zeno_orbits as zo

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.support.one_story import data_story_of, story_of

MACHINES = sorted((Path(__file__).parents[1] / "tests/support/machines").glob("[a-z]*.py"))
WITHOUT = ("bouncing_ball", "falling_pendulum")
NOT_FOLLOWED = ("two_tone_table",)
LARGEST = 1e-8
LARGEST_OF_RIG, LARGEST_OF_FIT = 1e-4, 1e-6
"""A contact of the machine lasts some 1e-5 of the period, and its orbit is off by as much."""


def main() -> int:
    """Print the table; exit code 1 if two commands contradict each other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", nargs="*")
    bundled = [
        name
        for name in zo.bundled_problems()
        if name not in WITHOUT and not zo.load_problem(name).has_graph
    ]
    names = parser.parse_args().problems or [*bundled, *map(str, MACHINES)]
    heads = ("problem", "shape", "period, search [s]", "verified", "simulate", "map", "continue")
    print("|", " | ".join((*heads, "differ", "rig", "identify")), "|")
    print("|" + 10 * "---|")
    agree = True
    for name in names:
        told = story_of(name, follow=name not in NOT_FOLLOWED)
        others = (told.simulated, told.mapped, told.continued)
        cells = ["-" if math.isnan(one) else f"{one:.9g}" for one in others]
        word = "stable" if told.verified else "no"
        row = (f"`{Path(name).stem}`", f"`{told.shape}`", f"{told.period:.9g}", word, *cells)
        data = data_story_of(name)
        off = ["-" if math.isnan(one) else f"{one:.0e}" for one in (data.rig, data.identified)]
        print("|", " | ".join((*row, f"{told.spread():.0e}", *off)), "|", flush=True)
        agree &= told.verified and told.spread() < LARGEST and len(told.fates) == 1
        agree &= not (data.rig > LARGEST_OF_RIG or data.identified > LARGEST_OF_FIT)
    return int(not agree)


if __name__ == "__main__":
    sys.exit(main())
