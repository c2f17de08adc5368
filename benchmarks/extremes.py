"""What the extremes give now: runs every row of `tests/support/extremes.py` and prints the table.

Prints the error seen in every row, then the table of `docs/extremes.md` with the largest error of
each line, rounded up to two digits. Exit 1 if a row breaks its promise. Rows whose name contains an
argument are enough for a first look.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.support.extremes import ROWS, Row, lines
from zeno_orbits.errors import ZenoOrbitsError


def rounded_up(error: float) -> str:
    """Return an error with two digits, never smaller than it is."""
    if error == 0.0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(error)) - 1)
    return f"{math.ceil(error / unit) * unit:.1e}"


def seen(row: Row) -> tuple[float | str, bool]:
    """Return the error of a row or the exception that ends it, and whether it keeps its promise."""
    try:
        error = row.error()
    except ZenoOrbitsError as outcome:
        return f"`{type(outcome).__name__}`", row.ends_in is type(outcome)
    return error, row.ends_in is None and error <= row.tolerance


def worst(found: list[float | str]) -> str:
    """Return the largest error of a line, or the exception in it."""
    texts = [one for one in found if isinstance(one, str)]
    return texts[0] if texts else rounded_up(max(one for one in found if isinstance(one, float)))


def main() -> int:
    """Print the rows and the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", nargs="?", default="", help="only rows whose name contains this")
    arguments = parser.parse_args()
    rows = [row for row in ROWS if arguments.part in row.name]
    errors: dict[str, float | str] = {}
    broken = 0
    for row in rows:
        errors[row.name], kept = seen(row)
        broken += not kept
        print(f"{row.name}: {worst([errors[row.name]])}{'' if kept else ' BROKEN'}", flush=True)
    print("\n| Case | Values | Compared | Reference | Bound | Measured |")
    print("|---|---|---|---|---|---|")
    for line, alike in lines(rows).items():
        print(f"{line} {worst([errors[row.name] for row in alike])} |")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
