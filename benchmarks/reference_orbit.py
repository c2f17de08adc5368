"""The Zeno periodic orbit of a problem to 25 digits, with an estimate of its own error.

A search in doubles gives the guess; the rest is computed in multiple precision, from the formulas
of the problem alone. Gains and parameters, calibrated ones too, are exactly the doubles of the
setting: `--set restitution=0.2` means the double next to 0.2.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from decimal import Decimal

from zeno_orbits.cli.parsing import Named, read_named_number
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.problem import ParameterValues, Problem
from zeno_orbits.precision import ExtendedOrbit, extended_orbit
from zeno_orbits.search import find_orbit


def rounded(value: Decimal, digits: int) -> str:
    """Return a number with so many decimals; zero has no sign."""
    text = f"{value:.{digits}f}"
    return text if text.strip("-0.") else text.lstrip("-")


def print_orbit(orbit: ExtendedOrbit, digits: int) -> None:
    """Print times, release, impacts and Zeno points with so many decimals."""
    print(f"period           {rounded(orbit.period, digits)} s")
    print("release state")
    for name, value in zip(orbit.state_names, orbit.release_state, strict=True):
        print(f"  {name:15}{rounded(value, digits):>{digits + 6}}")
    for k, impact in enumerate(orbit.impacts, start=1):
        rate = rounded(impact.approach_rate, digits)
        print(f"impact {k:3}       {rounded(impact.time, digits)} s, dh/dt = {rate}")
    for zeno in orbit.zeno_points:
        print(f"Zeno time        {rounded(zeno.time, digits)} s")
        print("Zeno state")
        for name, value in zip(orbit.state_names, zeno.state, strict=True):
            print(f"  {name:15}{rounded(value, digits):>{digits + 6}}")
    print(f"multipliers      {', '.join(f'{m:.9f}' for m in orbit.multipliers)} (9 decimals)")
    print(f"closure          {orbit.closure:.1e}, relative to one plus the state")
    print(f"error estimate   {orbit.error:.1e}, relative to one plus the number")
    print(f"time             {orbit.wall_time:.1f} s")


def as_data(orbit: ExtendedOrbit, problem: Problem, values: ParameterValues, digits: int) -> object:
    """Return the orbit for JSON: decimals as text, doubles exactly as hexadecimal text too."""
    data = asdict(orbit)
    data["multipliers"] = [[m.real, m.imag] for m in orbit.multipliers]
    exact = {name: value.hex() for name, value in (values.gains | values.parameters).items()}
    return {"problem": problem.name, "digits": digits, "setting": exact, "orbit": data}


def main(arguments: Sequence[str] | None = None) -> int:
    """Compute and print the orbit; 1 if there is none to these digits, 2 if asked wrongly."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("problem", nargs="?", default="motor_pendulum", help="name or path")
    parser.add_argument("--gain", action=Named, type=read_named_number, metavar="NAME=VALUE")
    parser.add_argument("--set", action=Named, type=read_named_number, metavar="NAME=VALUE")
    parser.add_argument("--digits", type=int, default=25, metavar="N", help="certain decimals")
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    options = parser.parse_args(arguments)
    try:
        problem = load_problem(options.problem)
        values = problem.values(gains=options.gain, parameters=options.set)
        started = time.process_time()
        found = find_orbit(problem, values).unwrap()
        guess = problem.state_vector(found.release_state)
        orbit = extended_orbit(problem, values, guess, digits=options.digits)
        processor = time.process_time() - started
    except ZenoOrbitsError as error:
        print(error, file=sys.stderr)
        return 2 if isinstance(error, InputError) else 1
    if options.json:
        print(json.dumps(as_data(orbit, problem, values, options.digits), indent=2, default=str))
    else:
        print_orbit(orbit, options.digits)
        print(f"processor time   {processor:.1f} s, the search in doubles included")
    return 0


if __name__ == "__main__":
    sys.exit(main())
