"""What a Zeno passage costs as the restitution nears one, impact by impact and along the curve.

Every problem starts on its stop with a speed whose tail, under a constant pull, would last equally
long at every restitution. The truth of ball and bead is their closed form; that of the motor
pendulum is the same sequence impact by impact at a tolerance of 1e-14, so far as it is followed.
Flights are all that an engine is asked for, those along a curve included; times are medians.
The pendulum starts on a current that is not the curve's own; where it takes 20 to 200 impacts to
decay, its layer costs more than the rest.

Exit 1 if a passage at ``e = 0.999`` costs more than twice the flights of one at 0.9, or if its
error is above 1e-10.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.reference.closed_forms import FadingBall, SlidingBead
from tests.support.mechanisms import GRAVITY, bead_on_disc, fading_ball
from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import (
    FlowWithEvent,
    RungeKutta,
    Segment,
    SegmentResult,
    Step,
    Tolerance,
)
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.simulation.events import ZenoPoint
from zeno_orbits.simulation.simulator import SimulationSettings, simulate
from zeno_orbits.simulation.zeno.completion import Completion, ZenoExtrapolation, ZenoPassage

RESTITUTIONS = (0.9, 0.99, 0.999, 0.9999, 0.99999)
MOST_BY_IMPACTS = 0.999
"""Impact by impact, larger restitutions take minutes."""
COST_GOAL, ERROR_GOAL, AT = 2.0, 1e-10, 0.999
FINE = Tolerance(relative=1e-14, absolute=1e-15)

Truth = tuple[float, Vector]


@dataclass
class Counter:
    """An engine that counts the flights that it is asked for, and their steps."""

    n_x: int
    flights: int = 0
    n_steps: int = 0
    engine: RungeKutta = field(default_factory=RungeKutta)

    def follow(self, leg: Segment) -> SegmentResult:
        """Follow a leg with the explicit engine; a flow with a scaled gap is a flight."""
        passage = self.engine.follow(leg)
        if len(leg.y) > self.n_x:
            self.flights += 1
            self.n_steps += len(passage.trajectory.times) - 1
        return passage

    def steps(self, flow: FlowWithEvent, y: Vector, tolerance: Tolerance) -> Iterator[Step]:
        """Yield the steps of one flight along a curve of impacts."""
        self.flights += 1
        for step in self.engine.steps(flow, y, tolerance):
            self.n_steps += 1
            yield step


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A system near a Zeno point, and what is known of it.

    Attributes:
        name: Its name.
        tail: How long the tail would last under a constant pull [s].
        system: From restitution to system.
        resting: State on the stop at the start.
        truth: From restitution and speed to Zeno time and state, if known in closed form.
    """

    name: str
    tail: float
    system: Callable[[float], HybridDynamics]
    resting: tuple[float, ...]
    truth: Callable[[float, float], Truth] | None = None


@dataclass(frozen=True, kw_only=True)
class Cost:
    """One passage: flights, their steps, time [s], and error, which is NaN without a truth."""

    flights: int
    steps: int
    wall: float
    error: float
    claimed: float


def ball_truth(restitution: float, speed: float) -> Truth:
    """Return where the ball of fading weight comes to rest."""
    rest = FadingBall(g=10.0, b=3.0, restitution=restitution).zeno_time(speed)
    return rest, np.array([0.0, rest, 0.0, 1.0])


def bead_truth(restitution: float, speed: float) -> Truth:
    """Return where the bead comes to rest on its disc."""
    rest, state = SlidingBead(g=GRAVITY, restitution=restitution).zeno_point(0.2, 0.5, speed)
    return rest, np.array(state)


def pendulum(restitution: float) -> HybridDynamics:
    """Return the motor pendulum."""
    problem = load_problem("motor_pendulum")
    values = problem.values(parameters={"restitution": restitution})
    return problem.dynamics(values)


ON_DISC = (math.sin(0.2), math.cos(0.2), 0.5 * math.cos(0.2), -0.5 * math.sin(0.2))
NEAR_ZENO = (1.2, 0.0, 1.7, 0.0, -0.46)
PROBLEMS = (
    Problem(
        name="ball of fading weight",
        tail=0.3,
        system=lambda e: fading_ball(10.0, 3.0, e),
        resting=(0.0, 0.0, 0.0, 1.0),
        truth=ball_truth,
    ),
    Problem(
        name="bead on a disc", tail=0.1, system=bead_on_disc, resting=ON_DISC, truth=bead_truth
    ),
    Problem(name="pendulum, 12 L/R", tail=0.008, system=pendulum, resting=NEAR_ZENO),
    Problem(name="pendulum, 75 L/R", tail=0.05, system=pendulum, resting=NEAR_ZENO),
    Problem(name="pendulum, 300 L/R", tail=0.2, system=pendulum, resting=NEAR_ZENO),
)


def start(problem: Problem, dynamics: HybridDynamics) -> tuple[float, Vector]:
    """Return the speed at which a passage starts, and its state."""
    resting = np.array(problem.resting)
    pull = -dynamics.gap_acceleration(resting)
    speed = problem.tail * (1 - dynamics.restitution) * pull / 2
    return speed, resting + speed * dynamics.impulse_direction(resting)


def passage(
    dynamics: HybridDynamics,
    state: Vector,
    until: float,
    completion: Completion,
    counter: Counter,
    tolerance: Tolerance,
) -> ZenoPoint:
    """Return the Zeno point that a simulation reaches."""
    settings = SimulationSettings(engine=counter, completion=completion, tolerance=tolerance)
    return simulate(dynamics, state, until=until, settings=settings).zeno_points[0]


def cost(problem: Problem, restitution: float, *, along: bool, truth: Truth | None, n: int) -> Cost:
    """Measure one way of passing through, with the default tolerances."""
    dynamics = problem.system(restitution)
    _, state = start(problem, dynamics)
    walls: list[float] = []
    for _ in range(n):
        counter = Counter(n_x=len(state))
        rule = ZenoPassage(engine=counter) if along else ZenoExtrapolation()
        started = time.perf_counter()
        point = passage(dynamics, state, 2 * problem.tail, rule, counter, Tolerance())
        walls.append(time.perf_counter() - started)
    error = math.nan
    if truth is not None:
        off = np.max(np.abs(point.state - truth[1]) / (1 + np.abs(truth[1])))
        error = max(abs(point.time - truth[0]), float(off))
    return Cost(
        flights=counter.flights,
        steps=counter.n_steps,
        wall=statistics.median(walls),
        error=error,
        claimed=point.limit_error,
    )


def known(problem: Problem, restitution: float) -> Truth | None:
    """Return the truth, in closed form or impact by impact."""
    dynamics = problem.system(restitution)
    speed, state = start(problem, dynamics)
    if problem.truth is not None:
        return problem.truth(restitution, speed)
    if restitution > MOST_BY_IMPACTS:
        return None
    rule = ZenoExtrapolation(tolerance=1e-13, resolved=1e-5)
    point = passage(dynamics, state, 2 * problem.tail, rule, Counter(n_x=len(state)), FINE)
    return point.time, point.state


def measure(problem: Problem, n: int) -> Iterator[tuple[float, Cost | None, Cost]]:
    """Yield restitution, cost impact by impact, and cost along the curve."""
    for restitution in RESTITUTIONS:
        sys.stderr.write(f"{problem.name}, e = {restitution}\n")
        truth = known(problem, restitution)
        by_impacts = None
        if restitution <= MOST_BY_IMPACTS:
            repeats = n if restitution < 0.99 else 1
            by_impacts = cost(problem, restitution, along=False, truth=truth, n=repeats)
        yield restitution, by_impacts, cost(problem, restitution, along=True, truth=truth, n=n)


def line(restitution: float, by_impacts: Cost | None, along: Cost, first: Cost) -> str:
    """Return a row of the table."""
    left = " " * 31
    if by_impacts is not None:
        left = f"{by_impacts.flights:8d} {1e3 * by_impacts.wall:10.1f} ms {by_impacts.error:8.1e}"
    right = f"{along.flights:7d} {along.steps:7d} {1e3 * along.wall:8.1f} ms"
    ends = f"{along.error:9.1e} {along.claimed:9.1e}"
    ratios = f"{along.flights / first.flights:7.2f} {along.wall / first.wall:7.2f}"
    return f"{restitution:8.5f} |{left} |{right} {ends} |{ratios}"


def main() -> int:
    """Run the benchmark and return the exit code."""
    parser = argparse.ArgumentParser(description="What a Zeno passage costs near e = 1.")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    met: list[bool] = []
    table: dict[str, list[dict[str, object]]] = {}
    for problem in PROBLEMS:
        rows = list(measure(problem, options.repeats))
        first = rows[0][2]
        at = next(along for restitution, _, along in rows if restitution == AT)
        met.append(at.flights <= COST_GOAL * first.flights and at.error <= ERROR_GOAL)
        table[problem.name] = [
            {"e": e, "by_impacts": by and asdict(by), "along": asdict(along)}
            for e, by, along in rows
        ]
        if options.json:
            continue
        print(f"\n{problem.name}: {'met' if met[-1] else 'NOT met'} at e = {AT}")
        print(
            f"{'e':>8} |{'flights':>8} {'time':>13} {'error':>8} |{'flights':>7} {'steps':>7} "
            f"{'time':>11} {'error':>9} {'claimed':>9} |  to e = 0.9 (flights, time)"
        )
        print(*(line(*row, first) for row in rows), sep="\n")
    if options.json:
        print(json.dumps({"met": all(met), "problems": table}, indent=2))
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
