"""Print what the commands say of each problem at its own numbers: do they tell one story?

    python benchmarks/one_story.py [PROBLEM ...]

Search, verify, simulate, map and continue are asked; by default of all bundled problems that have
an orbit, and of the machines of the tests. The last column is the largest relative difference
between the periods that they name.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import zeno_orbits as zo
from tests.support.one_story import story_of

MACHINES = sorted((Path(__file__).parents[1] / "tests/support/machines").glob("[a-z]*.py"))
WITHOUT = ("bouncing_ball", "falling_pendulum")
NOT_FOLLOWED = ("two_tone_table",)
LARGEST = 1e-8


def main() -> int:
    """Print the table; exit code 1 if two commands contradict each other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", nargs="*")
    bundled = [name for name in zo.bundled_problems() if name not in WITHOUT]
    names = parser.parse_args().problems or [*bundled, *map(str, MACHINES)]
    print(
        "| problem | shape | period, search [s] | verified | simulate | map | continue | differ |"
    )
    print("|---|---|---|---|---|---|---|---|")
    agree = True
    for name in names:
        told = story_of(name, follow=name not in NOT_FOLLOWED)
        others = (told.simulated, told.mapped, told.continued)
        cells = ["-" if math.isnan(one) else f"{one:.9g}" for one in others]
        word = "stable" if told.verified else "no"
        row = (f"`{Path(name).stem}`", f"`{told.shape}`", f"{told.period:.9g}", word, *cells)
        print("|", " | ".join((*row, f"{told.spread():.0e}")), "|", flush=True)
        agree &= told.verified and told.spread() < LARGEST and len(told.fates) == 1
    return int(not agree)


if __name__ == "__main__":
    sys.exit(main())
