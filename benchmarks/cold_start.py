"""Time whole commands, from the start of Python to the last line.

The search of the reference problem has a bound of 10 s.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time

COMMANDS = {
    "problems": (("problems",), None),
    "search motor_pendulum": (("search", "motor_pendulum"), 10.0),
}
"""Name to arguments and the longest time allowed [s], if there is a bound."""


def seconds(arguments: tuple[str, ...]) -> float:
    """Return how long a command takes, run as a user would."""
    started = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "zeno_orbits", *arguments], check=True, capture_output=True
    )
    return time.perf_counter() - started


def main() -> int:
    """Time all commands; 1 if one is over its bound."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=5, metavar="N", help="runs of each command")
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    options = parser.parse_args()
    if options.runs < 1:
        parser.error(f"--runs must be at least 1, but it is {options.runs}")
    rows = []
    for name, (arguments, bound) in COMMANDS.items():
        times = [seconds(arguments) for _ in range(options.runs)]
        median = statistics.median(times)
        good = bound is None or median < bound
        rows.append({"command": name, "median": median, "slowest": max(times), "bound": bound})
        rows[-1]["good"] = good
    if options.json:
        print(json.dumps(rows, indent=2))
    else:
        print("command                 median [s]  slowest [s]  bound [s]")
        for row in rows:
            bound = "-" if row["bound"] is None else f"{row['bound']:g}"
            print(f"{row['command']:24}{row['median']:10.2f}{row['slowest']:13.2f}{bound:>11}")
    return 0 if all(row["good"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
