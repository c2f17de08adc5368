"""Time every engine on the motor pendulum for 20 s, over tolerances and over R/L.

The reference orbit (measured outside this project, period 1.81371293903044 s) is stable, so the
state after eleven periods is its release state again: the error is the largest difference, relative
to 1 + |x|. At other R/L the yardstick is the Radau engine at 1e-12. `by hand` is what a user of
heyoka writes: plain coordinates, terminal events, a plastic cut at the first impact below 0.01
rad/s; `Taylor, cut` is ours with the same cut; `interpreted` is the default engine without
compiled steps. Engines that took too long are not asked for more.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.integrate import DOP853, LSODA
from scipy.integrate import Radau as SciPyRadau

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.integrators import Automatic, Engine, Radau, RungeKutta, SciPy, Taylor
from zeno_orbits.integrators.engine import Leg, Passage
from zeno_orbits.integrators.flow import Tolerance
from zeno_orbits.integrators.taylor.casadi_to_heyoka import load_heyoka, translate
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.numeric.compiled import CompiledSystem, bind
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.problem import Problem
from zeno_orbits.simulation.completion import Truncation, ZenoExtrapolation
from zeno_orbits.simulation.execution import Execution
from zeno_orbits.simulation.simulator import SimulationSettings, simulate

RELEASE = (0.1985068301199, 0.0, -5.2365375521764, 0.0, -1.8591703843225)
PERIOD, N_PERIODS = 1.81371293903044, 11
UNTIL, CUT = 20.0, 1e-2
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
RATIOS = (1e3, 1e4, 1e5, 1e6)
MOST_STEPS = 5_000_000

ENGINES: Mapping[str, Engine] = {
    "Taylor": Taylor(),
    "Taylor, cut": Taylor(),
    "RungeKutta": RungeKutta(),
    "Radau": Radau(),
    "Automatic": Automatic(),
    "interpreted": Automatic(),
    "SciPy DOP853": SciPy(method=DOP853),
    "SciPy LSODA": SciPy(method=LSODA),
    "SciPy Radau": SciPy(method=SciPyRadau),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Counting:
    """An engine that counts its steps.

    Attributes:
        engine: The engine.
        steps: How many, between two looks.
    """

    engine: Engine
    steps: list[int] = field(default_factory=list[int])

    def follow(self, leg: Leg) -> Passage:
        """Follow a flow as the engine does."""

        def watch(steps: int, time: float, y: Vector) -> None:
            self.steps.append(steps)
            leg.watch(steps, time, y)

        return self.engine.follow(replace(leg, watch=watch))


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Runs of one engine.

    Attributes:
        wall: Median time [s].
        cpu: Median processor time [s], which other processes disturb less.
        steps: Steps of all arcs.
        error: Of the state, relative to ``1 + |x|``.
    """

    wall: float
    cpu: float
    steps: int
    error: float


def timed(run: Callable[[], Any], n_runs: int) -> tuple[float, float, Any]:
    """Return median wall and processor time of a call, and what it returned."""
    wall: list[float] = []
    cpu: list[float] = []
    result = None
    for _ in range(n_runs):
        started, used = time.perf_counter(), time.process_time()
        result = run()
        wall.append(time.perf_counter() - started)
        cpu.append(time.process_time() - used)
    return statistics.median(wall), statistics.median(cpu), result


def measure(
    dynamics: HybridDynamics, name: str, relative: float, n_runs: int, error: Callable[..., float]
) -> Timing | None:
    """Simulate with an engine, or return nothing if it gives up."""
    settings = SimulationSettings(
        engine=ENGINES[name],
        tolerance=Tolerance(relative=relative, absolute=relative / 10),
        completion=(
            Truncation(delta=CUT)
            if name.endswith("cut")
            else ZenoExtrapolation(tolerance=max(relative, 1e-12))
        ),
        most_steps=MOST_STEPS,
    )
    try:
        # The run that counts the steps is the one that compiles.
        counted = Counting(engine=settings.engine)
        simulate(dynamics, RELEASE, until=UNTIL, settings=replace(settings, engine=counted))
        wall, cpu, execution = timed(
            lambda: simulate(dynamics, RELEASE, until=UNTIL, settings=settings), n_runs
        )
    except SimulationError:
        return None
    return Timing(wall=wall, cpu=cpu, steps=sum(counted.steps), error=error(execution))


def by_hand(compiled: CompiledSystem, dynamics: HybridDynamics, p: Vector, tolerance: float) -> Any:
    """Return a simulation as a user of heyoka writes it; it returns the states at its releases."""
    heyoka = load_heyoka()

    def integrator(mode: Any) -> Any:
        names = [heyoka.expression(f"y{k}") for k in range(compiled.n_x)]
        arguments = [names, [heyoka.par[k] for k in range(len(p))]]
        guard = translate(mode.guard, arguments)[0]
        event = heyoka.t_event(guard, direction=heyoka.event_direction.negative)
        rates = translate(mode.rate, arguments)
        system = list(zip(names, rates, strict=True))
        own = heyoka.taylor_adaptive(system, np.zeros(len(names)), tol=tolerance, t_events=[event])
        own.pars[:] = p[: own.pars.size]
        return own

    free, locked = integrator(compiled.free), integrator(compiled.locked)
    over = heyoka.taylor_outcome.time_limit

    def run() -> list[Vector]:
        x, now, held, releases = np.array(RELEASE), 0.0, False, list[Vector]()
        while True:
            # The guard must not be exactly zero where a flight starts, or heyoka misses its fall.
            x[1] = 0.0 if held else 1e-14
            own = locked if held else free
            own.time, own.state[:] = now, x
            own.reset_cooldowns()
            if own.propagate_until(UNTIL)[0] == over:
                return releases
            now, x = own.time, own.state.copy()
            if held:
                held, x[3] = False, 0.0
                releases.append(x)
            else:
                rate = x[3]
                held = -rate < CUT
                x = (
                    x - rate * dynamics.impulse_direction(x)
                    if held
                    else dynamics.reset_map(x, rate)
                )

    return run


def difference(x: Sequence[float] | Vector, y: Sequence[float] | Vector) -> float:
    """Return the largest difference of two states, relative to ``1 + |x|``."""
    return float(np.max(np.abs(np.subtract(x, y)) / (1 + np.abs(y))))


def return_error(execution: Execution) -> float:
    """Return the error of the state after eleven periods of the reference orbit."""
    return difference(execution.state_at(N_PERIODS * PERIOD), RELEASE)


def cell(timing: Timing | None) -> str:
    """Return one line of numbers."""
    if timing is None:
        return f"{'gave up or was too slow before':>44}"
    return (
        f"{timing.wall * 1e3:12.2f}{timing.cpu * 1e3:12.2f}{timing.steps:10d}{timing.error:10.0e}"
    )


def machine(compiled: CompiledSystem, vector: Sequence[float], name: str) -> HybridDynamics:
    """Return the system for a row of the tables."""
    return bind(compiled.interpreted() if name == "interpreted" else compiled, vector)


def over_tolerances(problem: Problem, n_runs: int, patience: float) -> None:
    """Print the table over tolerances."""
    compiled, values = problem.compiled(), problem.values().vector
    dynamics = bind(compiled, values)
    print("R/L = 1500 1/s     tol.     wall [ms]    cpu [ms]     steps    error")
    slow: set[str] = set()
    for relative in TOLERANCES:
        run = by_hand(compiled, dynamics, np.array(values), relative)
        run()
        wall, cpu, releases = timed(run, n_runs)
        print(
            f"{'by hand':16}{relative:7.0e}{wall * 1e3:12.2f}{cpu * 1e3:12.2f}{'':10}"
            f"{difference(releases[N_PERIODS - 1], RELEASE):10.0e}"
        )
        for name in ENGINES:
            timing = None
            if name not in slow:
                of_row = machine(compiled, values, name)
                timing = measure(of_row, name, relative, n_runs, return_error)
            if timing is None or timing.wall * n_runs > patience:
                slow.add(name)
            print(f"{name:16}{relative:7.0e}{cell(timing)}", flush=True)


def over_ratios(problem: Problem, n_runs: int, patience: float) -> None:
    """Print the table over R/L, at 1e-10."""
    values = problem.values()
    print("\ntol. = 1e-10       R/L      wall [ms]    cpu [ms]     steps    error")
    slow: set[str] = set()
    resistance = values.parameters["R"]
    for ratio in RATIOS:
        at = problem.values(parameters={"L": resistance / ratio})
        dynamics = problem.dynamics(at)
        tight = SimulationSettings(engine=Radau(), tolerance=Tolerance())
        exact = simulate(dynamics, RELEASE, until=UNTIL, settings=tight).end_state

        def end_error(execution: Execution, exact: Vector = exact) -> float:
            return difference(execution.end_state, exact)

        for name in ENGINES:
            timing = None
            if name not in slow:
                of_row = machine(problem.compiled(), at.vector, name)
                timing = measure(of_row, name, 1e-10, n_runs, end_error)
            if timing is None or timing.wall * n_runs > patience:
                slow.add(name)
            print(f"{name:16}{ratio:7.0e}{cell(timing)}", flush=True)


def main() -> int:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=5, metavar="N", help="runs of each case")
    parser.add_argument(
        "--patience", type=float, default=60.0, metavar="S", help="longest case that goes on [s]"
    )
    options = parser.parse_args()
    if options.runs < 1:
        parser.error(f"--runs must be at least 1, but it is {options.runs}")
    problem = load_problem("motor_pendulum")
    problem.compiled().build(problem.values().vector)
    over_tolerances(problem, options.runs, options.patience)
    over_ratios(problem, options.runs, options.patience)
    return 0


if __name__ == "__main__":
    sys.exit(main())
