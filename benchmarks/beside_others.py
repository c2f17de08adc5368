"""Time the same work done by others and by us: a motor pendulum through its Zeno points for 20 s.

Every competitor is a script in `benchmarks/others/` and runs in a process of its own, one after the
other. Times are the processor's, medians over the runs after one that does not count, without
compiling; `prepared` is what compiling takes on the clock. Errors are held against a Taylor
integration in 80 bits. What is not installed is left out and says so.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

OTHERS = Path(__file__).with_name("others")

SCRIPTS = (
    *("ours", "heyoka_by_hand", "casadi_events", "scipy_loop"),
    *("jaxonomy_events", "siconos_moreau"),
)

SCALES = (1.8, 2.0, 7.8, 17.0, 2.6)
"""Largest value of each state over the reference orbit, rounded; errors are relative to it."""

LEVELS = (1e-4, 1e-6, 1e-8, 1e-10)
"""Errors at which times are compared."""

SWEEP_LEVEL = 1e-6
"""Error at which the sweep over `R / L` is compared."""

OURS = "ours"
"""How the names of our own methods begin."""

CONFIRMED = 1e-8
"""The truth and another integrator's tightest answer must be nearer than this."""

PATIENCE = 1800
"""A script that takes longer is given up [s]."""

Row = dict[str, Any]


def run(script: str, python: str, work: str, arguments: Sequence[str]) -> dict[str, Any]:
    """Run one script in its own process: its rows, or in one line why there are none."""
    command = [python, str(OTHERS / f"{script}.py"), work, *arguments]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=PATIENCE, check=False
        )
    except FileNotFoundError:
        return {"missing": f"there is no {python}"}
    except subprocess.TimeoutExpired:
        return {"missing": f"not done after {PATIENCE} s"}
    last = (done.stdout if done.returncode == 3 else done.stderr).strip().splitlines()[-1:]
    if done.returncode:
        return {"missing": last[0] if last else f"exit code {done.returncode}"}
    return json.loads(done.stdout.strip().splitlines()[-1])


def distance(state: Sequence[float], truth: Sequence[float]) -> float:
    """Return the largest difference of two states, each entry relative to its scale."""
    parts = [abs(a - b) / s for a, b, s in zip(state, truth, SCALES, strict=True)]
    # `max` may pass over NaN, which is the largest error of all.
    return math.inf if any(math.isnan(part) for part in parts) else max(parts)


def judge(rows: Iterable[Row], truths: dict[float, Row]) -> list[Row]:
    """Return the rows with error and median time; one that miscounts the locks is a failure."""
    judged: list[Row] = []
    for row in rows:
        if "state" not in row or row["rate"] not in truths:
            judged.append(row)
            continue
        truth = truths[row["rate"]]
        error = distance(row["state"], truth["state"])
        entry = row | {"error": error, "median": statistics.median(row["seconds"])}
        if row["locks"] not in (None, truth["locks"]):
            entry["failure"] = f"missed impacts: {row['locks']} locks, not {truth['locks']}"
        elif not error < 0.1:
            entry["failure"] = f"another motion: off by {error:.0e}"
        judged.append(entry)
    return judged


def time_at(level: float, points: Iterable[tuple[float, float]]) -> float | None:
    """Return the time at which a method reaches an error, between its runs by log-log lines.

    Runs that another one beats in both respects are left out.

    Args:
        level: The error.
        points: Error and time of each run.

    Returns:
        The time; that of the fastest run if even that one is more accurate than asked, and nothing
        if no run is as accurate.
    """
    front: list[tuple[float, float]] = []
    for error, time in sorted(points, key=lambda point: (point[1], point[0])):
        if not front or error < front[-1][0]:
            front.append((error, time))
    reached = next((k for k, (error, _) in enumerate(front) if error <= level), None)
    if reached is None:
        return None
    error, time = front[reached]
    if reached == 0 or error == 0.0:
        return time
    looser, faster = front[reached - 1]
    part = math.log(looser / level) / math.log(looser / error)
    return math.exp((1 - part) * math.log(faster) + part * math.log(time))


def confirmation(rows: Iterable[Row], rate: float) -> tuple[float, str] | None:
    """Return how near another integrator comes to the truth at its tightest, and which does."""
    tightest: dict[str, Row] = {}
    for row in rows:
        if row["rate"] == rate and "failure" not in row and not row["method"].startswith("heyoka"):
            known = tightest.get(row["method"])
            if known is None or row["accuracy"] < known["accuracy"]:
                tightest[row["method"]] = row
    return min(((row["error"], name) for name, row in tightest.items()), default=None)


def methods(rows: Iterable[Row]) -> list[str]:
    """Return the names of the methods in order."""
    return list(dict.fromkeys(row["method"] for row in rows))


def times_at(rows: Sequence[Row], levels: Sequence[float]) -> dict[str, list[float | None]]:
    """Return for each method the time at each level."""
    good = [row for row in rows if "failure" not in row]
    return {
        name: [
            time_at(level, [(r["error"], r["median"]) for r in good if r["method"] == name])
            for level in levels
        ]
        for name in methods(good)
    }


def fastest_of_ours(times: dict[str, list[float | None]]) -> list[float | None]:
    """Return our best time at each level."""
    own = [values for name, values in times.items() if name.startswith(OURS)]
    return [min((t for t in column if t), default=None) for column in zip(*own, strict=True)]


def milliseconds(seconds: float | None) -> str:
    """Return a time for a table."""
    return "-" if seconds is None else f"{1e3 * seconds:.3g}"


def print_runs(rows: Iterable[Row]) -> None:
    """Print one line a run."""
    heads = f"{'asked':>8}{'median [ms]':>13}{'error':>10}{'impacts':>9}{'prepared [ms]':>15}"
    print(f"{'method':20}{heads}")
    for row in rows:
        head = f"{row['method']:20}{row['accuracy']:8.0e}"
        if "failure" in row:
            print(f"{head}  {row['failure']}"[:100])
            continue
        impacts = "-" if row["impacts"] is None else row["impacts"]
        print(
            f"{head}{milliseconds(row['median']):>13}{row['error']:10.1e}{impacts:>9}"
            f"{milliseconds(row['preparation']):>15}"
        )


def print_levels(times: dict[str, list[float | None]], heads: Sequence[str]) -> None:
    """Print times in columns, and beside each its ratio to ours."""
    base = fastest_of_ours(times) or [None] * len(heads)
    print(f"{'method':20}" + "".join(f"{head:>20}" for head in heads))
    for name, values in times.items():
        cells = ""
        for value, own in zip(values, base, strict=True):
            ratio = f"({value / own:.3g})" if value and own else ""
            cells += f"{milliseconds(value):>10}{ratio:>10}"
        print(f"{name:20}{cells}")


def collect(
    scripts: Sequence[str], pythons: Mapping[str, str], arguments: Sequence[str]
) -> dict[str, Any] | None:
    """Run everything and return the findings, or nothing if there is no truth to judge by."""
    found: dict[str, Any] = {"versions": {}, "missing": {}, "confirmed": {}}
    for work in ("follow", "sweep", "ball"):
        rows: list[Row] = []
        for script in scripts:
            print(f"{work}: {script} ...", file=sys.stderr)
            answer = run(script, pythons.get(script, sys.executable), work, arguments)
            if "missing" in answer:
                found["missing"][script] = answer["missing"]
                continue
            found["versions"][script] = answer["version"]
            rows += answer["rows"]
        found[work] = rows
        if work == "ball":
            continue
        print(f"{work}: truth ...", file=sys.stderr)
        truth = run("truth", sys.executable, work, [*arguments, "--runs", "1"])
        if "missing" in truth:
            print(f"Nothing to hold errors against: {truth['missing']}", file=sys.stderr)
            return None
        truths = {row["rate"]: row for row in truth["rows"]}
        found[work] = judge(rows, truths)
        for rate in truths:
            found["confirmed"][f"{work}, R/L = {rate:g}"] = confirmation(found[work], rate)
    return found


def compared(found: dict[str, Any], rates: Sequence[float]) -> dict[str, Any]:
    """Return the times at equal error: of the motion by error, of the sweep by ``R / L``."""
    sweep = [row for row in found["sweep"] if "failure" not in row]
    columns = [
        times_at([row for row in sweep if row["rate"] == rate], [SWEEP_LEVEL]) for rate in rates
    ]
    return {
        "follow": times_at(found["follow"], LEVELS),
        "sweep": {
            name: [column.get(name, [None])[0] for column in columns] for name in methods(sweep)
        },
    }


def show(found: dict[str, Any], rates: Sequence[float]) -> None:
    """Print the tables, none wider than 100 columns."""
    print("Followed for 20 s at R/L = 1500 1/s\n")
    print_runs(found["follow"])
    print("\nTime at equal error [ms], and in brackets how many times ours it is\n")
    print_levels(found["times"]["follow"], [f"{level:.0e}" for level in LEVELS])
    print(f"\nThe same at error {SWEEP_LEVEL:.0e}, over R/L [1/s], from the Zeno point\n")
    print_levels(found["times"]["sweep"], [f"{rate:.0e}" for rate in rates])
    for row in found["sweep"]:
        if "failure" in row:
            asked = f"{row['method']}, R/L {row['rate']:.0e}, asked {row['accuracy']:.0e}"
            print(f"  {asked}: {row['failure']}"[:100])
    print("\nZeno time of the bouncing ball, e = 0.8, against its closed form\n")
    for row in found["ball"]:
        head = f"{row['method']:20}{row['accuracy']:8.0e}"
        if "failure" in row:
            print(f"{head}  {row['failure']}"[:100])
            continue
        print(f"{head}{milliseconds(statistics.median(row['seconds'])):>13}{row['error']:10.1e}")
    print()
    for script, reason in found["missing"].items():
        print(f"Left out, {script}: {reason}"[:100])
    for what, pair in found["confirmed"].items():
        by = f"to {pair[0]:.0e} by {pair[1]}" if pair else "by nobody"
        print(f"Truth of {what} 1/s confirmed {by}.")


def main() -> int:
    """Run everything; 1 if there is no truth, or no other integrator confirms it."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").partition("\n")[0],
        epilog="Siconos runs under the Python that Debian gives it: --system-python. The whole "
        "takes ten to twenty minutes, --quick about three.",
    )
    parser.add_argument("--runs", type=int, default=5, metavar="N", help="runs that count, of each")
    parser.add_argument(
        "--quick", action="store_true", help="two runs of each, and R/L only up to 1e4 1/s"
    )
    parser.add_argument(
        "--only",
        nargs="+",
        choices=SCRIPTS,
        default=SCRIPTS,
        metavar="SCRIPT",
        help=f"run these competitors only: {', '.join(SCRIPTS)}",
    )
    parser.add_argument(
        "--system-python", default="/usr/bin/python3", metavar="PATH", help="Python for Siconos"
    )
    parser.add_argument(
        "--jaxonomy-python",
        default=sys.executable,
        metavar="PATH",
        help="Python for jaxonomy, which wants many packages of its own",
    )
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    options = parser.parse_args()
    if options.runs < 1:
        parser.error(f"--runs must be at least 1, but it is {options.runs}")
    rates = [1e3, 1e4] if options.quick else [1e3, 1e4, 1e5, 1e6]
    arguments = ["--runs", str(min(options.runs, 2) if options.quick else options.runs)]
    arguments += ["--rates", *map(str, rates)]

    pythons = {
        "siconos_moreau": options.system_python,
        "jaxonomy_events": options.jaxonomy_python,
    }
    found = collect(options.only, pythons, arguments)
    if found is None:
        return 1
    found["times"] = compared(found, rates)
    if options.json:
        print(json.dumps(found, indent=2))
    else:
        show(found, rates)
    sure = [pair is not None and pair[0] < CONFIRMED for pair in found["confirmed"].values()]
    return 0 if all(sure) else 1


if __name__ == "__main__":
    sys.exit(main())
