r"""Orbits with n impacts beyond the end of complete chatter, and the ratio of their windows.

    python benchmarks/chatter_cascade.py [--problem NAME] [--restitution E] [--most N] [--json]

Where the contact phase of a Zeno orbit vanishes, orbits with n impacts and no Zeno point take over.
The window of n is the part of the parameter between two grazing orbits. At its lower end a contact
grazes before the first impact, and at its upper end the last impact grazes. The ratio of successive
windows tends to ``kappa``, theory (5.7). It deviates by a multiple of ``sigma^n``, so two ratios
are extrapolated to the limit:

    (R_n - sigma R_{n-1}) / (1 - sigma)

The error of a ratio follows from the errors of the ends. The error of the limit is its last change.
The exit code is 1 if a window is not found, if neighbouring windows do not meet to 1e-9, or if the
last limit differs from ``kappa`` by more than three of its errors.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from zeno_orbits import api
from zeno_orbits.continuation import ContinuationSettings, Family, SpecialPoint, SpecialPointKind
from zeno_orbits.continuation.separatrix import Separatrix, separatrix

MEETS = 1e-9
"""Largest distance of two descriptions of one grazing orbit, in the parameter."""
ONCE = ContinuationSettings(doublings=0)
"""Orbits of twice the period between a flip and the grazing end do not enter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A problem with a cascade.

    Attributes:
        parameter: The parameter of the cascade, which rises away from complete chatter.
        held: A value at which the orbit has a Zeno point.
        once: A value at which the orbit has one impact.
        last: Upper end of the range.
        initial: Initial state of all motions.
    """

    parameter: str
    held: float
    once: float
    last: float
    initial: dict[str, float]


CASES = {
    "forced_oscillator": Case(
        parameter="stop", held=0.0, once=0.35, last=0.6, initial={"cosine": 1.0}
    ),
    "relief_valve": Case(parameter="q", held=0.5, once=1.8, last=2.0, initial={"pressure": 10.5}),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """The orbits with n impacts.

    Attributes:
        impacts: Number of impacts per period.
        lower: End at which a contact before the first impact grazes.
        lower_error: Estimated error of it.
        upper: End at which the last impact grazes, or the end of the range.
        upper_error: Estimated error of it.
        seconds: Time of the family [s].
        trouble: Why an end was not located, or empty.
    """

    impacts: int
    lower: float
    lower_error: float
    upper: float
    upper_error: float
    seconds: float
    trouble: str


def last_zeno(case: Case, problem: str, e: float) -> SpecialPoint:
    """Return the end of the Zeno orbits, where the contact phase vanishes."""
    numbers = {case.parameter: case.held, "restitution": e}
    orbit = api.orbit_inside(api.known_problem(problem), {}, numbers=numbers)
    found = api.continue_orbit(orbit, (case.parameter, case.held, case.last), settings=ONCE)
    return found.families[0].last


def windows(case: Case, problem: str, e: float, zeno: float, most: int) -> Iterator[Window]:
    """Yield the windows from one impact on, each from an orbit in the middle of its prediction."""
    law, before = separatrix(e), case.last
    value = case.once
    for n in range(1, most + 1):
        started = time.perf_counter()
        box = (zeno, min(case.last, before + (before - zeno) / 8))
        family = followed(case, problem, e, value, box)
        if family.n_returns != n:
            raise SystemExit(f"{n} impacts are expected at {value!r}, but {family.n_returns} occur")
        first, last = family.first, family.last
        trouble = [
            f"{end.kind.value}: {end.detail}"
            for end, kinds in ((first, LOWER), (last, UPPER))
            if end.kind not in kinds and (n > 1 or end.kind is not SpecialPointKind.BOUND)
        ]
        yield Window(
            impacts=n,
            lower=first.at.value,
            lower_error=first.error,
            upper=last.at.value,
            upper_error=last.error,
            seconds=time.perf_counter() - started,
            trouble="; ".join(trouble),
        )
        if trouble:
            return
        before = first.at.value
        # The middle between the lower ends of this window and, as predicted, of the next one.
        value = zeno + (before - zeno) * (1 + 1 / law.repulsion) / 2


LOWER = (SpecialPointKind.EARLIER_GRAZING,)
UPPER = (SpecialPointKind.LATER_GRAZING, SpecialPointKind.GRAZING)


def followed(case: Case, problem: str, e: float, value: float, box: tuple[float, float]) -> Family:
    """Return the family of the orbit without a Zeno point at a value."""
    numbers = {case.parameter: value, "restitution": e}
    names = {gain.name for gain in api.known_problem(problem).gains}
    gains = {name: x for name, x in numbers.items() if name in names}
    found = api.continue_impacts(
        problem,
        (case.parameter, *box),
        start=case.initial,
        gains=gains,
        parameters={name: x for name, x in numbers.items() if name not in gains},
        settings=ONCE,
    )
    return found.families[0]


def rows(found: list[Window], law: Separatrix) -> list[dict[str, Any]]:
    """Return the windows with widths, ratios and extrapolated limits."""
    table: list[dict[str, Any]] = []
    for window in found:
        row: dict[str, Any] = {**asdict(window), "predicted": law.repulsion}
        row["width"] = width = window.upper - window.lower
        if table:
            # The grazing orbit between two windows is located best as the lower end of one.
            above = table[-1]
            row["miss"] = abs(window.upper - above["lower"])
            row["width"] = width = above["lower"] - window.lower
            ends = (above["lower_error"] + window.lower_error) / width
            ratio = row["ratio"] = above["width"] / width
            if "ratio" in above:
                ends += (found[len(table) - 2].lower_error + above["lower_error"]) / above["width"]
                limit = (ratio - law.shrinking * above["ratio"]) / (1 - law.shrinking)
                row["limit"] = limit
                if "limit" in above:
                    row["limit_error"] = abs(limit - above["limit"])
            row["ratio_error"] = ratio * ends
        table.append(row)
    return table


def show(row: dict[str, Any]) -> str:
    """Return a row of the table as text."""
    words = [
        f"{row['impacts']:3d}  {row['lower']:.13f}  {row['lower_error']:.0e}  {row['width']:.6e}"
    ]
    if "ratio" in row:
        words.append(f"{row['ratio']:.7f}  {row['ratio_error']:.0e}")
        words.append(f"{row['limit']:.5f}" if "limit" in row else 7 * " ")
        words.append(f"{row['limit_error']:.0e}" if "limit_error" in row else 5 * " ")
        words.append(f"{row['miss']:.0e}")
    return "  ".join([*words, f"{row['seconds']:.1f} s", row["trouble"]])


def main() -> int:
    """Print the table of the windows. Return 1 if a window is missing or the prediction fails."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--problem", choices=CASES, default="forced_oscillator")
    parser.add_argument("--restitution", type=float, default=0.5, metavar="E")
    parser.add_argument("--most", type=int, default=12, metavar="N", help="most impacts (12)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    case, e = CASES[options.problem], options.restitution
    law = separatrix(e)
    end = last_zeno(case, options.problem, e)
    if end.kind is not SpecialPointKind.LOCK_VANISHES:
        raise SystemExit(f"the family of Zeno orbits ends otherwise: {end.kind.value}")
    if not options.json:
        print(f"{options.problem}, restitution {e:g}, in {case.parameter}")
        print(f"the contact phase vanishes at {end.at.value:.13f} +- {end.error:.0e}")
        print(f"kappa = {law.repulsion:.7f}, sigma = {law.shrinking:.7f}")
        print("  n  lower end        error  window        ratio      error  limit    error  miss")
    found: list[Window] = []
    for window in windows(case, options.problem, e, end.at.value, options.most):
        found.append(window)
        if not options.json:
            print(show(rows(found, law)[-1]), flush=True)
    table = rows(found, law)
    if options.json:
        told = {"zeno": end.at.value, "zeno_error": end.error, "sigma": law.shrinking}
        print(json.dumps({**told, "windows": table}, indent=2))
    last = table[-1]
    failed = any(row["trouble"] or row.get("miss", 0.0) > MEETS for row in table)
    if "limit_error" in last:
        failed = failed or abs(last["limit"] - law.repulsion) > 3 * last["limit_error"]
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
