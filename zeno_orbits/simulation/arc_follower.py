"""One arc of an execution: a flow followed to its guard, within limits of time, steps and reach."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import PenetrationError, RunawayError, SimulationError, counted
from zeno_orbits.integrators import Engine, GuardedFlow, Leg, Outcome, Tolerance, light_value
from zeno_orbits.model import HybridDynamics, Resting
from zeno_orbits.simulation.execution import Arc, Ending, Impact, Mode

_FIRST_LOOK = 25_000
"""Steps before the first look at the pace of an execution; good motions take some 150 a second."""
_RISING, _RISE = 4, 1.5
"""Looks in a row between which a speed grows by this factor or more: that is no oscillation."""


@light_value
class ArcStart:
    """The start of the next arc.

    Attributes:
        mode: Its mode.
        time: When [s].
        state: Where, ``(n_x,)``.
        speed: Gap rate of a start from the stop, exactly; ``None`` for any other start.
        impact: The impact that it comes from, if any.
        resting: The state moved onto the stop, after an impact.
    """

    mode: Mode
    time: float
    state: Vector
    speed: float | None = None
    impact: Impact | None = None
    resting: Resting | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Look:
    """A look at how far an execution has come.

    Attributes:
        steps: Steps so far.
        time: When [s].
        speed: Largest velocity.
    """

    steps: int
    time: float
    speed: float


@dataclass(slots=True, kw_only=True)
class ArcFollower:
    """Follows the arcs of one execution and counts their steps.

    Attributes:
        dynamics: The system.
        engine: The integrator.
        tolerance: Its local error.
        until: When to stop [s].
        contact: Part of the problem's own sizes below which a guard counts as zero.
        far: A coordinate beyond this ends the execution with an error: one bound for all
            coordinates, or one for each.
        most_steps: Steps of all arcs before the execution is given up.
    """

    dynamics: HybridDynamics
    engine: Engine
    tolerance: Tolerance
    until: float
    contact: float
    far: float | tuple[float, ...]
    most_steps: int
    _start: float = 0.0
    _unit: float = 1.0
    _n_steps: int = 0
    _next_look: int = _FIRST_LOOK
    _looks: list[_Look] = field(default_factory=list[_Look])
    _reach: Vector | None = None

    def __post_init__(self) -> None:
        """Give the bound of every coordinate, if there is one."""
        if np.min(self.far) < math.inf:
            far = np.asarray(self.far, dtype=np.float64)
            self._reach = np.broadcast_to(far, (self.dynamics.n_q,))

    def follow(
        self,
        start: ArcStart,
        flow: GuardedFlow,
        natural: Ending,
        *,
        impact_index: int,
        on_guard: bool,
    ) -> tuple[Arc, Vector]:
        """Follow a flow until its guard falls through zero or the horizon comes.

        Args:
            start: Where it starts; its speed makes it a rescaled flight.
            flow: The flow.
            natural: What the guard means.
            impact_index: Impacts before it.
            on_guard: The start is a root of the guard that does not count.

        Returns:
            The arc, and the last state of the flow itself.

        Raises:
            SimulationError: If a limit is reached, or the state leaves the admissible set.
        """
        n_x, own = len(start.state), self.dynamics.own
        unit = 1.0 if start.speed is None else start.speed
        size = own.multiplier if start.mode is Mode.LOCKED else own.gap
        leg = Leg(
            flow=flow,
            y=start.state if start.speed is None else _launched(start.state),
            horizon=(self.until - start.time) / unit,
            tolerance=self.tolerance,
            on_guard=on_guard,
            rounding=self.contact * (size if start.speed is None else 1 / own.gap_acceleration),
            watch=self._watch,
            reach=self._reach,
        )
        self._start, self._unit = start.time, unit
        passage = self.engine.follow(leg)
        time = start.time + unit * passage.duration
        if passage.outcome is Outcome.LEFT:
            raise PenetrationError(
                "The state leaves the admissible set from its boundary",
                time=time,
                state=tuple(passage.state[:n_x].tolist()),
            )
        over = passage.outcome is Outcome.HORIZON
        arc = Arc(
            mode=start.mode,
            start_time=start.time,
            end_time=self.until if over else time,
            start_state=start.state,
            end_state=passage.state[:n_x],
            ending=Ending.HORIZON if over else natural,
            impact_index=impact_index,
            time_unit=unit,
            trajectory=passage.trajectory,
        )
        return arc, passage.state

    def _watch(self, steps: int, offset: float, y: Vector) -> None:
        """End a leg that takes too long or goes too far."""
        self._n_steps += steps
        if self._n_steps >= self._next_look:
            self._look(self._start + self._unit * offset, y)
        if self._n_steps > self.most_steps:
            raise SimulationError(
                f"The execution needs more than {counted(self.most_steps, 'step')}: "
                "raise `most_steps` (--most-steps), or simulate a shorter time",
                time=self._start + self._unit * offset,
                state=tuple(y.tolist()),
            )
        if self._reach is None:
            return
        parts = np.abs(y[: self.dynamics.n_q]) / self._reach
        if float(parts.max()) > 1.0:
            name = self.dynamics.state_names[int(np.argmax(parts))]
            raise RunawayError(
                f"{name} runs away",
                time=self._start + self._unit * offset,
                state=tuple(y.tolist()),
                coordinate=name,
            )

    def _look(self, time: float, y: Vector) -> None:
        """End a motion that speeds up so much that its steps will not last to the horizon.

        A look comes at every doubling of the steps. Speeds that grow from look to look, and the
        pace since the last one, tell in a tenth of the steps what all of them would.
        """
        n_q = self.dynamics.n_q
        self._next_look *= 2
        rates = np.abs(y[n_q : 2 * n_q])
        self._looks.append(_Look(steps=self._n_steps, time=time, speed=float(rates.max())))
        last = self._looks[-_RISING:]
        if len(last) < _RISING or any(b.speed < _RISE * a.speed for a, b in pairwise(last)):
            return
        before = last[-2]
        steps, passed = self._n_steps - before.steps, time - before.time
        needed = (self.until - time) * steps / passed if passed > 0.0 else math.inf
        if self._n_steps + needed > self.most_steps:
            name = self.dynamics.state_names[n_q + int(np.argmax(rates))]
            raise RunawayError(
                f"{name} grows without end: at the pace of its last {steps} steps, "
                f"{needed:.1g} more would be needed",
                time=time,
                state=tuple(y.tolist()),
            )


def _launched(x: Vector) -> Vector:
    """Return the state of a rescaled flight at its start, ``(x, 0, 1)``."""
    y = np.zeros(x.size + 2)
    y[:-2], y[-1] = x, 1.0
    return y
