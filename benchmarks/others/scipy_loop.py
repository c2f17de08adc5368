"""SciPy: `solve_ivp`, restarted by hand after every event.

The model is `work.Pendulum`, lean and in plain floats. The loop carries the repairs without which
it goes wrong: a first step inside the flight (else it may jump over all of it, in silence) and no
longer than ``L / R`` (else explicit stages overflow); a check that an impact closes the gap (else a
root at the restart passes for one); and a plastic reset of slow impacts (else it never ends).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial

import scipy
import work
from scipy.integrate import solve_ivp
from work import HORIZON, Method, Motion, Pendulum


def ending(flow: Callable, event: Callable, t: float, x: Sequence[float], **options: object):  # noqa: ANN201
    """Follow a flow until the event falls through zero or the time is up."""
    event.terminal, event.direction = True, -1
    solution = solve_ivp(flow, (t, HORIZON), x, events=event, **options)
    if not solution.success:
        raise RuntimeError(solution.message)
    return solution.t[-1], solution.y[:, -1].tolist(), bool(solution.t_events[0].size)


def follow(
    machine: Pendulum, solver: str, accuracy: float, start: Sequence[float], locked: bool
) -> Motion:
    """Follow the completed motion for 20 s."""
    slowest = work.cut(accuracy)
    options = {"method": solver, "rtol": accuracy, "atol": accuracy}
    layer = machine.inductance / machine.resistance
    t, x, first_step = 0.0, list(start), layer
    impacts = locks = 0
    while True:
        if locked:
            y = [x[0], x[2], x[4]]
            t, y, released = ending(
                lambda _, y: machine.locked_rates(y.tolist()),
                lambda _, y: machine.hold(float(y[0]), float(y[2])),
                t,
                y,
                **options,
            )
            x = [y[0], 0.0, y[1], 0.0, y[2]]
            if not released:
                return Motion(state=x, impacts=impacts, locks=locks)
            locked, first_step = False, layer
        t, x, hit = ending(
            lambda _, x: machine.rates(x.tolist()),
            lambda _, x: x[1],
            t,
            x,
            first_step=min(first_step, HORIZON - t),
            **options,
        )
        if not hit:
            return Motion(state=x, impacts=impacts, locks=locks)
        speed = -x[3]
        if not speed > 0.0:
            raise RuntimeError(f"an impact at {t:.9f} s opens the gap")
        impacts += 1
        locked = speed < slowest
        locks += locked
        x = machine.impact(x, 0.0 if locked else machine.restitution)
        if not locked:
            first_step = min(x[3] / (2.0 * abs(machine.rates(x)[3])), layer)


def prepare(
    solver: str, rate: float, accuracy: float, start: Sequence[float], locked: bool
) -> Callable[[], Motion]:
    """Return the whole motion as a function without arguments."""
    return partial(follow, work.pendulum(rate), solver, accuracy, start, locked)


def prepare_ball(solver: str, accuracy: float) -> Callable[[], float]:
    """Return a function that gives the Zeno time of the ball."""

    def zeno_time() -> float:
        g, e = work.BALL_GRAVITY, work.BALL_RESTITUTION
        t, x, first_step = 0.0, [work.BALL_HEIGHT, 0.0], 1e-3
        while True:
            t, x, _ = ending(
                lambda _, x: [x[1], -g],
                lambda _, x: x[0],
                t,
                x,
                method=solver,
                rtol=accuracy,
                atol=accuracy * 1e-9,
                first_step=first_step,
            )
            if not x[1] < 0.0:
                raise RuntimeError(f"an impact at {t:.9f} s opens the gap")
            x = [0.0, -e * x[1]]
            if x[1] < work.cut(accuracy):
                return t + 2.0 * x[1] / (g * (1.0 - e))
            first_step = x[1] / (2.0 * g)

    return zeno_time


METHODS = [
    Method(
        name="SciPy DOP853",
        accuracies=(1e-4, 1e-6, 1e-8, 1e-10, 1e-12),
        sweep_accuracies=(1e-4, 1e-6, 1e-8),
        prepare=partial(prepare, "DOP853"),
        ball=partial(prepare_ball, "DOP853"),
        grows=True,
    ),
    Method(
        name="SciPy LSODA",
        accuracies=(1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10),
        sweep_accuracies=(1e-6, 1e-7, 1e-8, 1e-9),
        prepare=partial(prepare, "LSODA"),
        ball=partial(prepare_ball, "LSODA"),
    ),
    Method(
        name="SciPy Radau",
        accuracies=(1e-4, 1e-6, 1e-8, 1e-10),
        sweep_accuracies=(1e-4, 1e-6, 1e-8),
        prepare=partial(prepare, "Radau"),
        ball=partial(prepare_ball, "Radau"),
    ),
]

if __name__ == "__main__":
    sys.exit(work.serve(__doc__, METHODS, lambda: f"SciPy {scipy.__version__}"))
