"""What the extremes give now: runs every row of `tests/support/extremes.py` and prints the table.

Prints the rows of `docs/extremes.md`, the error seen in each, rounded up to two digits; exit 1 if
one breaks its promise. Rows whose name contains an argument are enough for a first look.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.support.extremes import ROWS, Row
from zeno_orbits.errors import ZenoOrbitsError


def rounded_up(error: float) -> str:
    """Return an error with two digits, never smaller than it is."""
    if error == 0.0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(error)) - 1)
    return f"{math.ceil(error / unit) * unit:.1e}"


def seen(row: Row) -> tuple[str, bool]:
    """Return what a row gives, and whether it keeps its promise."""
    try:
        error = row.error()
    except ZenoOrbitsError as outcome:
        return f"`{type(outcome).__name__}`", row.ends_in is type(outcome)
    return rounded_up(error), row.ends_in is None and error <= row.tolerance


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", nargs="?", default="", help="only rows whose name contains this")
    arguments = parser.parse_args()
    broken = 0
    print("| Row | Asked | Truth | Promised | Seen |\n|---|---|---|---|---|")
    for row in ROWS:
        if arguments.part in row.name:
            text, kept = seen(row)
            broken += not kept
            line = f"| {row.name} | {row.asked} | {row.truth} | {row.promise} | {text} |"
            print(line if kept else f"{line} BROKEN", flush=True)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
