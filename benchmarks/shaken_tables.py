"""Random shaken tables against exact flights: is every period that a map or a search names right?

    python benchmarks/shaken_tables.py --tables 300 --searches 30

Accelerations from 1.5 to 3.3 g and restitutions from 0 to 0.7 are drawn at random, and tables with
these shake at 30, 1 and 0.01 rad/s. The truth is that of `tests/reference/exact_flights.py`. A
motion that does not settle, or would settle to something else if a number changed in its eleventh
digit, may be called anything but a short period.

Exit 1 if a period is false, or fewer than 95 % of the motions are found that settle to a period of
up to 22 turns.
"""

from __future__ import annotations

import argparse
import math
import random
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import zeno_orbits as zo

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.reference.exact_flights import Truth, clearly_settled
from zeno_orbits.maps import attractors_at

OMEGAS = (30.0, 1.0, 0.01)
GRAVITY = 9.81
LONGEST = 22
"""Turns of a period that has to be found."""
TURNS = 1500
"""Turns that the truth follows a motion."""
SAME = 1e-7
"""Relative difference of a period that is right; a map is told to 1e-8."""
GOAL = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table and what a ball on it settles to.

    Attributes:
        acceleration: Largest, in units of gravity.
        restitution: Of the ball.
        truth: What it settles to, if that is clear.
    """

    acceleration: float
    restitution: float
    truth: Truth | None

    @property
    def has_to_be_found(self) -> bool:
        """True if it settles to a period that is not too long."""
        truth = self.truth
        return truth is not None and truth.arrived and 0 < truth.turns <= LONGEST

    def is_false(self, turns: float) -> bool:
        """Return True if so many turns cannot be the period."""
        if not abs(turns - round(turns)) <= SAME * turns:
            return True
        right = 0 if self.truth is None else self.truth.turns
        if right and right == 2 * round(turns) and self.truth and not self.truth.arrived:
            # On its way to half the period a motion alternates, for as many turns as it likes.
            return False
        return round(turns) != right and min(right or math.inf, turns) <= LONGEST


def random_tables(count: int, seed: int) -> Iterator[Table]:
    """Yield tables with their truths."""
    drawn = random.Random(seed)
    for _ in range(count):
        acceleration, restitution = drawn.uniform(1.5, 3.3), drawn.uniform(0.0, 0.7)
        truth = clearly_settled(acceleration, restitution, TURNS)
        yield Table(acceleration=acceleration, restitution=restitution, truth=truth)


def values_of(problem: zo.Problem, table: Table, omega: float) -> zo.ParameterValues:
    """Return the numbers of a table that shakes at a frequency [rad/s]."""
    amplitude = table.acceleration * GRAVITY / omega**2
    numbers = {"A": amplitude, "omega": omega, "restitution": table.restitution, "g": GRAVITY}
    return problem.values(parameters=numbers)


def mapped(tables: Sequence[Table], omega: float) -> list[float]:
    """Return the periods that a map names, in turns; NaN where it names none."""
    problem = zo.load_problem("vibrating_table")
    settings = [values_of(problem, table, omega) for table in tables]
    return [one.period * omega / (2 * math.pi) for one in attractors_at(problem, settings)]


def searched(tables: Sequence[Table], omega: float) -> list[float]:
    """Return the periods of the attracting orbits that searches find and verify, likewise."""
    problem = zo.load_problem("vibrating_table")
    found: list[float] = []
    for table in tables:
        values = values_of(problem, table, omega)
        orbit = zo.find_orbit(problem, parameters=dict(values.parameters)).orbit
        checked = None if orbit is None else zo.verify(orbit, problem=problem)
        good = checked is not None and checked.passed and checked.stable
        found.append(orbit.period * omega / (2 * math.pi) if orbit and good else math.nan)
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """How many periods were right.

    Attributes:
        asked: Tables whose period has to be found.
        found: Of these.
        false: Tables with a false period.
        missed: Tables of the former that were not found.
    """

    asked: int
    found: int
    false: tuple[Table, ...]
    missed: tuple[Table, ...]


def score(tables: Sequence[Table], turns: Sequence[float]) -> Score:
    """Return how many of the periods are right.

    Args:
        tables: The tables.
        turns: Their periods, in turns; NaN where none is named.
    """
    pairs = list(zip(tables, turns, strict=True))
    asked = [(table, n) for table, n in pairs if table.has_to_be_found]
    missed = tuple(table for table, n in asked if math.isnan(n))
    false = tuple(table for table, n in pairs if not math.isnan(n) and table.is_false(n))
    found = sum(not math.isnan(n) and not table.is_false(n) for table, n in asked)
    return Score(asked=len(asked), found=found, false=false, missed=missed)


def main() -> int:
    """Print the scores and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tables", type=int, default=300)
    parser.add_argument("--searches", type=int, default=30, help="tables that are searched, too")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--verbose", action="store_true", help="print each that is not right")
    options = parser.parse_args()
    tables = list(random_tables(options.tables, options.seed))
    good = True
    print("| by | omega [rad/s] | tables | settle to 1-22 turns | found | false |")
    print("|---|---|---|---|---|---|")
    for name, ask, some in (
        ("map", mapped, tables),
        ("search", searched, tables[: options.searches]),
    ):
        for omega in OMEGAS:
            seen = score(some, ask(some, omega))
            cells = (name, f"{omega:g}", len(some), seen.asked, seen.found, len(seen.false))
            print("|", " | ".join(map(str, cells)), "|", flush=True)
            for kind, which in (("false", seen.false), ("missed", seen.missed)):
                for table in which if options.verbose else ():
                    print(f"  {kind}: {table}", flush=True)
            good &= not seen.false and seen.found >= GOAL * seen.asked
    return int(not good)


if __name__ == "__main__":
    sys.exit(main())
