"""zeno_orbits: `simulate` on the compiled problem."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from functools import cache, partial

import work
from work import HORIZON, Method, Motion

from zeno_orbits.integrators import Automatic, Engine, Radau, RungeKutta
from zeno_orbits.integrators.flow import Tolerance
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.simulation.simulator import SimulationSettings, simulate
from zeno_orbits.simulation.zeno.completion import ZenoExtrapolation


def settings(accuracy: float, engine: Engine | None = None) -> SimulationSettings:
    """Return how to simulate at a local error."""
    return SimulationSettings(
        engine=engine or Automatic(),
        tolerance=Tolerance(relative=accuracy, absolute=accuracy / 10),
        completion=ZenoExtrapolation(tolerance=accuracy),
    )


@cache
def problem(name: str, rate: float | None = None) -> HybridDynamics:
    """Return a problem at its numbers, compiled."""
    problem = load_problem(name)
    parameters = {} if rate is None else work.declared(rate)
    values = problem.values(parameters=parameters)
    return problem.dynamics(values)


def prepare(
    engine: Engine, rate: float, accuracy: float, start: Sequence[float], _locked: bool
) -> Callable[[], Motion]:
    """Return the whole motion as a function without arguments."""
    machine = problem("motor_pendulum", rate)

    def follow() -> Motion:
        motion = simulate(machine, start, until=HORIZON, settings=settings(accuracy, engine))
        return Motion(
            state=motion.end_state.tolist(),
            impacts=len(motion.impacts),
            locks=len(motion.zeno_points),
        )

    return follow


def prepare_ball(accuracy: float) -> Callable[[], float]:
    """Return a function that gives the Zeno time of the ball."""
    ball = problem("bouncing_ball")

    def zeno_time() -> float:
        motion = simulate(ball, (work.BALL_HEIGHT, 0.0), until=5.0, settings=settings(accuracy))
        return motion.zeno_points[0].time if motion.zeno_points else math.nan

    return zeno_time


def method(name: str, engine: Engine, *, grows: bool) -> Method:
    """Return one of our engines as a competitor."""
    return Method(
        name=f"ours, {name}",
        accuracies=(1e-3, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-13),
        sweep_accuracies=(1e-4, 1e-5, 1e-6),
        prepare=partial(prepare, engine),
        ball=prepare_ball if isinstance(engine, Automatic) else None,
        grows=grows,
    )


METHODS = [
    method("automatic", Automatic(), grows=False),
    method("explicit", RungeKutta(), grows=True),
    method("implicit", Radau(), grows=False),
]

if __name__ == "__main__":
    sys.exit(work.serve(__doc__, METHODS, lambda: "zeno_orbits"))
