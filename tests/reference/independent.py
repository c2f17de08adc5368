"""A second simulator for the tests: SciPy's integrators under event handling of their own.

It shares no line with `simulate`, `crossing` or the engines. It follows the motor pendulum as the
hand-written `reference.py` states it, in seconds and radians, without rescaled flights and without
an extrapolated Zeno limit: impacts are followed one by one until they are slower than `SLOW`, the
next one is made plastic (theory (2.3): of third order), and the Zeno time adds the rest of the
geometric series. The gap is a coordinate, so gap and gap rate are set exactly after an impact.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.integrate import DOP853, LSODA, Radau, solve_ivp
from scipy.optimize import brentq

from zeno_orbits.arrays import Vector

Field = Callable[[Vector], Vector]
Method = type[DOP853] | type[Radau] | type[LSODA]

SLOW = 1e-8
"""Impacts slower than this part of the first of their sequence are the tail."""
GAP, RATE = 1, 3
"""Entries of `theta2` and its rate in the state."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Followed:
    """What happened.

    Attributes:
        impacts: Time and gap rate before every impact that was followed.
        zeno_times: When the sequences ended.
        zeno_states: Where, each ``(n_x,)``.
        release_times: When the stop let go.
        end_state: State at the end, ``(n_x,)``.
    """

    impacts: list[tuple[float, float]] = field(default_factory=list)
    zeno_times: list[float] = field(default_factory=list)
    zeno_states: list[Vector] = field(default_factory=list)
    release_times: list[float] = field(default_factory=list)
    end_state: Vector = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Follower:
    """The pendulum and how to integrate it.

    Attributes:
        machine: The hand-written pendulum.
        method: SciPy's method.
        relative: Relative tolerance.
    """

    machine: Any
    method: Method = DOP853
    relative: float = 3e-14

    def follow(self, state: Sequence[float], until: float) -> Followed:
        """Return the events and the end of the motion from a state off the stop or at a release."""
        log = Followed()
        time, x = 0.0, np.array(state, dtype=np.float64)
        speed, first = 0.0, 0.0
        if x[GAP] == x[RATE] == 0.0 and self.machine.multiplier(x) > 0.0:
            time, x = self._carried(log, time, x, until)
        while time < until:
            time, x = self._fall(time, x, until, speed)
            if time >= until:
                break
            approach = -float(x[RATE])
            assert approach > 0.0, "an impact closes the gap"
            log.impacts.append((time, -approach))
            first = max(first, approach)
            x = self.machine.reset_map(x, float(x[RATE]))
            speed = self.machine.restitution * approach
            x[GAP], x[RATE] = 0.0, speed
            holds = self.machine.gap_acceleration(x) < 0.0
            if speed <= SLOW * first and holds:
                time, x = self._lock(log, time, x, speed, until)
                speed, first = 0.0, 0.0
        return replace(log, end_state=x)

    def _lock(
        self, log: Followed, time: float, x: Vector, speed: float, until: float
    ) -> tuple[float, Vector]:
        x = x - speed * self.machine.impulse_direction(x)
        x[RATE] = 0.0
        pull = -self.machine.gap_acceleration(x)
        tail = 2 * speed / (pull * (1 - self.machine.restitution))
        log.zeno_times.append(time + tail)
        log.zeno_states.append(x + tail * self.machine.locked_flow(x))
        return self._carried(log, time, x, until)

    def _carried(self, log: Followed, time: float, x: Vector, until: float) -> tuple[float, Vector]:
        time, x = self._until(self.machine.locked_flow, self.machine.multiplier, time, x, until)
        x[GAP], x[RATE] = 0.0, 0.0
        if time < until:
            log.release_times.append(time)
        return time, x

    def _fall(self, time: float, x: Vector, until: float, speed: float) -> tuple[float, Vector]:
        """Follow a flight first to where the gap stops growing, then to the stop."""
        flow = self.machine.free_flow
        if x[RATE] > 0.0 or x[GAP] == 0.0:
            time, x = self._until(flow, lambda y: float(y[RATE]), time, x, until, speed)
        if time < until:
            time, x = self._until(flow, lambda y: float(y[GAP]), time, x, until, speed)
        return time, x

    def _until(
        self,
        flow: Field,
        guard: Callable[[Vector], float],
        time: float,
        x: Vector,
        until: float,
        speed: float = 0.0,
    ) -> tuple[float, Vector]:
        """Follow a flow until its guard falls through zero: steps by hand, root by bisection."""
        absolute = np.full(len(x), 1e-14)
        first_step: float | None = None
        if speed > 0.0:
            pull = abs(self.machine.gap_acceleration(x))
            absolute[[GAP, RATE]] = 1e-13 * speed**2 / pull, 1e-13 * speed
            first_step = min(0.1 * speed / pull, (until - time) / 2)
        settings: dict[str, Any] = {"rtol": self.relative, "atol": absolute}
        # Time from the start of the arc, so that short flights keep their digits.
        solver = self.method(_finite(flow), 0.0, x, until - time, first_step=first_step, **settings)
        # A start on the guard, a release for instance, does not count.
        armed = guard(x) > 0.0
        here, y = 0.0, x
        while solver.status == "running":
            message = solver.step()
            assert solver.status != "failed", message
            after = guard(solver.y)
            if armed and after < 0.0:
                size = float(solver.t) - here
                offset = self._locate(flow, guard, y, size, settings)
                return time + here + offset, self._carry(flow, y, offset, settings)
            armed = armed or after > 0.0
            here, y = float(solver.t), np.array(solver.y)
        return until, y

    def _carry(self, flow: Field, x: Vector, offset: float, settings: dict[str, Any]) -> Vector:
        if offset == 0.0:
            return x
        run = solve_ivp(_finite(flow), (0.0, offset), x, method=self.method, **settings)
        return np.array(run.y[:, -1])

    def _locate(
        self,
        flow: Field,
        guard: Callable[[Vector], float],
        x: Vector,
        size: float,
        settings: dict[str, Any],
    ) -> float:
        """Return where in a step the guard falls, on states that are integrated anew."""

        def value(offset: float) -> float:
            return guard(self._carry(flow, x, offset, settings))

        tiny = 4 * np.finfo(np.float64).eps
        return float(brentq(value, 0.0, size, xtol=tiny * size, rtol=tiny))


def _finite(flow: Field) -> Callable[[float, Vector], Vector]:
    """Return a field that answers NaN where a trial step is so wild that floats overflow."""

    def rate(_: float, y: Vector) -> Vector:
        try:
            return flow(y)
        except (OverflowError, ValueError):
            return np.full(len(y), np.nan)

    return rate
