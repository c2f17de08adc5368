"""Prove the orbits of the bundled problems over a range of restitutions, and print a table.

    python benchmarks/proof_table.py [PROBLEM ...] [--restitutions 0 0.1 0.2 0.3 0.4 0.41] [--check]

Each orbit is closed by simulation from that of the nearest restitution, the first from the default
one. A row holds the restitution, the period, and the processor times of prover and checker, or the
reason of a refusal. `leg` is the nine-state leg of the tests. Exit 1 if a certificate is refused
by the checker, or if an orbit is closed and not proved.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import zeno_orbits as zo
from zeno_orbits.model import bundled_problems, load_problem

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.hard_to_prove import leg

RESTITUTIONS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.41)
LONGEST = 100
"""Characters of a reason in the table."""


def seconds() -> float:
    """Return the processor time of this process and of those that it has waited for [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def closed(problem: zo.Problem, wanted: Sequence[float]) -> Iterator[tuple[float, zo.Orbit | str]]:
    """Yield the orbit at each restitution, or why there is none, from the default one outward.

    A machine without such a parameter has one row.
    """
    if "restitution" not in problem.names:
        found = zo.find_orbit_by_shooting(problem)
        yield math.nan, found.detail if found.orbit is None else found.orbit
        return
    own = problem.values().parameters["restitution"]
    known: dict[float, zo.Orbit] = {}
    default = zo.find_orbit_by_shooting(problem)
    if default.orbit is not None:
        known[own] = default.orbit
    for e in sorted(wanted, key=lambda e: abs(e - own)):
        nearest = min(known, key=lambda x: abs(x - e), default=None)
        near = None if nearest is None else known[nearest]
        found = zo.find_orbit_by_shooting(problem, parameters={"restitution": e}, near=near)
        if found.orbit is None:
            yield e, found.detail
            continue
        known[e] = found.orbit
        yield e, found.orbit


def row(problem: zo.Problem, orbit: zo.Orbit, *, check: bool) -> tuple[list[str], bool]:
    """Return the cells of an orbit, and whether its proof holds."""
    started = seconds()
    proof = zo.prove(orbit, problem=problem)
    spent = f"{seconds() - started:.1f}"
    if proof.bounds is None:
        return ["", proof.verdict()[:LONGEST], "", spent, ""], False
    holds, checked = True, ""
    if check:
        started = seconds()
        holds = zo.check_proof(dict(proof.certificate), problem).ok
        checked = f"{seconds() - started:.1f}" if holds else "REFUSED"
    what = "stable" if proof.stable else "unstable" if proof.repelling else "exists"
    inside = f"{what}, inside" if proof.inside else what
    return [proof.bounds.period.text, inside, str(proof.n_records), spent, checked], holds


def main() -> int:
    """Print a line an orbit; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", nargs="*", metavar="PROBLEM")
    parser.add_argument("--restitutions", nargs="+", type=float, default=RESTITUTIONS)
    parser.add_argument("--check", action="store_true", help="check each certificate, too")
    options = parser.parse_args()
    names = options.problems or [
        *(name for name in bundled_problems() if not load_problem(name).has_graph),
        "leg",
    ]
    print("| problem | e | period [s] | proved | inclusions | prover [s] | checker [s] |")
    print("|---|---|---|---|---|---|---|")
    sound = True
    for name in names:
        problem = leg() if name == "leg" else zo.load_problem(name)
        for e, orbit in closed(problem, options.restitutions):
            if isinstance(orbit, str):
                cells = ["", f"no orbit: {orbit[:LONGEST]}", "", "", ""]
            else:
                cells, holds = row(problem, orbit, check=options.check)
                sound = sound and holds
            print("|", " | ".join([f"`{name}`", f"{e:g}", *cells]), "|", flush=True)
    return int(not sound)


if __name__ == "__main__":
    sys.exit(main())
