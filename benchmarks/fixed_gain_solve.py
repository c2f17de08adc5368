"""Time the solve of an orbit at given gains, and hold period and release against known figures.

The figures of the problem `motor_pendulum` were measured outside this project, with a Taylor
integrator and Newton's method on the return map, which closed to 6e-15:

    published gains, e = 0.2   period 1.81371293903044, release (theta1, dtheta1, current) =
                               (0.1985068301199, -5.2365375521764, -1.8591703843225)
    e = 0, 0.1, 0.3            period 1.82033892548, 1.81767797277, 1.81128512357 (11 decimals)

For R = 2, R = 4 and Kp = 4 there are none. "Published" are the gains Kp = 2.5, Kd = -1 and
the two coefficients of Theorem 1; the masses and lengths are the problem's own.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from zeno_orbits.model.library import load_problem
from zeno_orbits.model.problem import Problem
from zeno_orbits.search import find_orbit
from zeno_orbits.verification.verifier import verify

SOLVE_BOUND = 0.3
"""Largest median time of one solve [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """Numbers that differ from the problem's own, and what is known of their orbit.

    Attributes:
        name: How the table calls it.
        gains: Gain name to value.
        parameters: Parameter name to value.
        period: Known period [s].
        release: Known release, state name to value.
    """

    name: str
    gains: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    period: float | None = None
    release: Mapping[str, float] = field(default_factory=dict)


CASES = (
    Case(
        name="published",
        period=1.81371293903044,
        release={
            "theta1": 0.1985068301199,
            "dtheta1": -5.2365375521764,
            "current": -1.8591703843225,
        },
    ),
    Case(name="e = 0", parameters={"restitution": 0.0}, period=1.82033892548),
    Case(name="e = 0.1", parameters={"restitution": 0.1}, period=1.81767797277),
    Case(name="e = 0.3", parameters={"restitution": 0.3}, period=1.81128512357),
    Case(name="R = 2", parameters={"R": 2.0}),
    Case(name="R = 4", parameters={"R": 4.0}),
    Case(name="Kp = 4", gains={"Kp": 4.0}),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """What one case took; times are medians over the runs [s].

    Attributes:
        name: The case.
        solve: Ipopt alone.
        search: Guess, transcription, solve and the simulation that confirms it.
        verification: The forward integration with all its residuals.
        unknowns: Unknowns of the program.
        iterations: Ipopt's iterations in the last run.
        verified: Whether the verification says yes.
        period: Of the orbit [s].
        period_error: Against the known one, relative, if there is one.
        release_error: Likewise, the largest of its states.
    """

    name: str
    solve: float
    search: float
    verification: float
    unknowns: int
    iterations: int
    verified: bool
    period: float
    period_error: float | None
    release_error: float | None


def measure(problem: Problem, case: Case, n_runs: int) -> Measurement:
    """Search and verify a case several times."""
    values = problem.values(gains=case.gains, parameters=case.parameters)
    solve_times: list[float] = []
    search_times: list[float] = []
    verification_times: list[float] = []
    result = find_orbit(problem, values)
    certificate = verify(result.unwrap(), problem)
    for _ in range(n_runs):
        result = find_orbit(problem, values)
        solve_times.append(result.solve_time)
        search_times.append(result.wall_time)
        started = time.perf_counter()
        certificate = verify(result.unwrap(), problem)
        verification_times.append(time.perf_counter() - started)
    orbit = result.unwrap()
    release = [
        abs(orbit.release_state[n] - known) / abs(known) for n, known in case.release.items()
    ]
    return Measurement(
        name=case.name,
        solve=statistics.median(solve_times),
        search=statistics.median(search_times),
        verification=statistics.median(verification_times),
        unknowns=result.n_unknowns,
        iterations=result.iterations,
        verified=certificate.passed,
        period=orbit.period,
        period_error=None if case.period is None else abs(orbit.period / case.period - 1),
        release_error=max(release, default=None),
    )


def print_table(measurements: list[Measurement]) -> None:
    """Print one line a case, under 100 columns."""
    print(
        "case       solve [s]  search [s]  verify [s]  unknowns  iter.  period [s]      "
        "err. T    err. x0  ok"
    )
    for m in measurements:
        period = "-" if m.period_error is None else f"{m.period_error:.0e}"
        release = "-" if m.release_error is None else f"{m.release_error:.0e}"
        print(
            f"{m.name:10}{m.solve:10.4f}{m.search:12.3f}{m.verification:12.3f}{m.unknowns:10d}"
            f"{m.iterations:7d}  {m.period:.11f}{period:>9}{release:>11}  "
            f"{'yes' if m.verified else 'NO'}"
        )


def main() -> int:
    """Run all cases; 1 if a solve is too slow or an orbit is refused."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=7, metavar="N", help="runs of each case")
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    options = parser.parse_args()
    if options.runs < 1:
        parser.error(f"--runs must be at least 1, but it is {options.runs}")
    problem = load_problem("motor_pendulum")
    measurements = [measure(problem, case, options.runs) for case in CASES]
    slowest = max(m.solve for m in measurements)
    good = slowest < SOLVE_BOUND and all(m.verified for m in measurements)
    if options.json:
        data = {"bound": SOLVE_BOUND, "good": good, "cases": [asdict(m) for m in measurements]}
        print(json.dumps(data, indent=2))
    else:
        print_table(measurements)
        print(f"\nSlowest median solve: {slowest:.4f} s; the bound is {SOLVE_BOUND} s.")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
