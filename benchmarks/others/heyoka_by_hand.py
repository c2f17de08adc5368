"""heyoka: Taylor integration in LLVM code, with terminal events driven by hand.

As good as a user can make it: numbers instead of parameters, so that the code is compiled for
them; compiling outside the timing; no dense output; and Python at the events only, since an impact
is reset inside the callback of its own event and the integration goes on.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import work
from work import HORIZON, Method, Motion

try:
    import heyoka as hy
except ImportError:
    hy = None

NUDGE = 1e-17
"""Gap after an impact [rad]: heyoka may miss the next one of a coordinate that starts at 0.0."""


def version() -> str:
    """Return which heyoka it is."""
    if hy is None:
        raise work.NotInstalledError("heyoka is not installed (pip install heyoka)")
    return f"heyoka {hy.__version__}"


class Impact:
    """The callback of an impact: resets the state, and stops the integration if it was slow.

    heyoka works on a copy of it, so the count is read from the integrator's own.
    """

    def __init__(self, share: float, restitution: float, slowest: float) -> None:
        self.share, self.restitution, self.slowest = share, restitution, slowest
        self.count = 0

    def __call__(self, integrator: Any, _direction: int) -> bool:
        """Return True if the integration goes on."""
        x = integrator.state
        approach = x[3]
        if not approach < 0.0:
            raise RuntimeError(f"an impact at {integrator.time:.9f} s opens the gap")
        self.count += 1
        if -approach < self.slowest:
            return False
        x[1] = NUDGE
        x[2] += (1.0 + self.restitution) * self.share * approach
        x[3] = -self.restitution * approach
        return True


class Hand:
    """Two integrators, off the stop and on it.

    Attributes:
        number: Floating-point type, ``float`` or NumPy's ``longdouble``.
    """

    def __init__(self, rate: float, accuracy: float, number: type, slowest: float) -> None:
        self.number = number
        machine = work.pendulum(rate)
        self.share = (machine.B + machine.C) / (machine.A + machine.B + 2.0 * machine.C)
        impact = Impact(self.share, machine.restitution, slowest)
        options: dict[str, Any] = {"fp_type": number}
        falls = {"direction": hy.event_direction.negative, **options}
        options["tol"] = number(accuracy)
        x = hy.make_vars("theta1", "theta2", "dtheta1", "dtheta2", "current")
        y = [x[0], x[2], x[4]]
        self.free = hy.taylor_adaptive(
            list(zip(x, machine.rates(x, hy.sin, hy.cos), strict=True)),
            [number(0)] * 5,
            t_events=[hy.t_event(x[1], callback=impact, **falls)],
            **options,
        )
        self.locked = hy.taylor_adaptive(
            list(zip(y, machine.locked_rates(y, hy.sin), strict=True)),
            [number(0)] * 3,
            t_events=[hy.t_event(machine.hold(y[0], y[2], hy.sin), **falls)],
            **options,
        )

    def impacts(self) -> int:
        """Return how many impacts there have been since the integrators were made."""
        return self.free.t_events[0].callback.count

    def follow(self, start: Sequence[float], locked: bool) -> Motion:
        """Follow the completed motion for 20 s."""
        locks, before = 0, self.impacts()
        horizon, time = self.number(HORIZON), self.number(0)
        x = [self.number(value) for value in start]
        while True:
            if locked:
                y = [x[0], x[2], x[4]]
                time, over = self.arc(self.locked, time, y, horizon)
                theta1, rate1, current = self.locked.state
                x = [theta1, 0.0, rate1, 0.0, current]
                if over:
                    return Motion(state=x, impacts=self.impacts() - before, locks=locks)
            x[1] = self.number(NUDGE)
            time, over = self.arc(self.free, time, x, horizon)
            x = self.free.state.copy()
            if over:
                return Motion(state=x, impacts=self.impacts() - before, locks=locks)
            locked, locks = True, locks + 1
            x[2] += self.share * x[3]

    def arc(self, integrator: Any, time: Any, start: Sequence[Any], horizon: Any) -> Any:
        """Integrate to a stopping event or the horizon; return when, and whether it is over."""
        integrator.reset_cooldowns()
        integrator.time = time
        integrator.state[:] = start
        outcome = integrator.propagate_until(horizon)[0]
        over = outcome == hy.taylor_outcome.time_limit
        if not over and int(outcome) not in (-1, 0):
            raise RuntimeError(f"heyoka stopped with {outcome}")
        return integrator.time, over


def prepare(
    rate: float, accuracy: float, start: Sequence[float], locked: bool
) -> Callable[[], Motion]:
    """Compile, and return the whole motion as a function without arguments."""
    hand = Hand(rate, accuracy, float, work.cut(accuracy))
    return lambda: hand.follow(start, locked)


def prepare_ball(accuracy: float) -> Callable[[], float]:
    """Compile, and return a function that gives the Zeno time of the ball."""
    g, e, slowest = work.BALL_GRAVITY, work.BALL_RESTITUTION, work.cut(accuracy)

    def impact(integrator: Any, _direction: int) -> bool:
        x = integrator.state
        if not x[1] < 0.0:
            raise RuntimeError(f"an impact at {integrator.time:.9f} s opens the gap")
        x[0], x[1] = NUDGE, -e * x[1]
        return bool(x[1] >= slowest)

    height, speed = hy.make_vars("height", "speed")
    touch = hy.t_event(height, direction=hy.event_direction.negative, callback=impact)
    fall = hy.taylor_adaptive(
        [(height, speed), (speed, -g + 0.0 * height)], [0.0, 0.0], t_events=[touch], tol=accuracy
    )

    def zeno_time() -> float:
        fall.reset_cooldowns()
        fall.time, fall.state[:] = 0.0, (work.BALL_HEIGHT, 0.0)
        outcome = fall.propagate_until(10.0)[0]
        if outcome == hy.taylor_outcome.time_limit:
            raise RuntimeError("an impact was missed: the ball fell through the floor")
        return fall.time + 2.0 * fall.state[1] / (g * (1.0 - e))

    return zeno_time


METHODS = [
    Method(
        name="heyoka by hand",
        accuracies=(1e-3, 1e-4, 1e-6, 1e-9, 1e-12, 1e-15),
        sweep_accuracies=(1e-3, 1e-4, 1e-6),
        prepare=prepare,
        ball=prepare_ball,
        grows=True,
    )
]

if __name__ == "__main__":
    sys.exit(work.serve(__doc__, METHODS, version))
