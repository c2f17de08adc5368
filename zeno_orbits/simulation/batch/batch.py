"""Many completed executions in lockstep: each lane with its own time, step, mode and numbers.

The rules are those of `simulate`, in rows: flights rescaled after an impact (theory (14)), events
on true steps, the Zeno limit by extrapolation (theory (15)), the locked arc to its release. A lane
never sees another: all that couples them is that one call serves many.

A lane may *follow* another, which then decides for both: step sizes, which steps hold, from which
impacts the Zeno point is told. Followers that start a little beside their leader give derivatives
of the leader's execution as it was computed, free of the noise of steps that are chosen afresh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Rows, Vector
from zeno_orbits.simulation.attractor import has_left, is_still, keeps_holding
from zeno_orbits.simulation.batch.events import first_falls, may_fall
from zeno_orbits.simulation.batch.lanes import FREE, LOCKED, Mask, empty_lanes, true_rows
from zeno_orbits.simulation.batch.model import BatchFlow, BatchModel
from zeno_orbits.simulation.batch.outcomes import LaneEvent, Reason
from zeno_orbits.simulation.batch.rules import BatchSettings, Transitions

_SAFETY, _SHRINK, _GROW = 0.9, 0.2, 8.0
_EXPONENT = -1 / 5
_LEAVES = 1e-6
"""A guard that was never positive and is below minus this part of its change has been left."""
_PHASES = 64
"""Phases of the clock in which a motion at rest is looked at."""
_LOOK = 64
"""Steps of a lane between two looks whether it is at rest."""
_FOLLOWED = 1e-10
_MOST_CORRECTIONS = 8


class Batch:
    """Lanes that advance by one step a round; between rounds lanes come and go."""

    def __init__(
        self,
        model: BatchModel,
        n_lanes: int,
        *,
        bounds: Vector | None = None,
        settings: BatchSettings | None = None,
    ) -> None:
        """Make room for lanes.

        Args:
            model: The problem.
            n_lanes: How many lanes there may be at a time.
            bounds: Largest modulus of each state before a lane has escaped, ``(n_x,)``.
            settings: How to advance them.
        """
        self.model = model
        self.settings = settings or BatchSettings()
        self.bounds = np.full(model.n_x, np.inf) if bounds is None else bounds
        self._lanes = empty_lanes(n_lanes, model.n_x, model.n_q, model.n_p)
        self._transitions = Transitions(model, self._lanes, self.settings)

    @property
    def n_free(self) -> int:
        """Lanes for which there is room."""
        return len(self._lanes.free_slots)

    @property
    def n_running(self) -> int:
        """Lanes that run."""
        return int(np.count_nonzero(self._lanes.alive))

    def start(self, p: Vector, x: Vector, tolerance: float, until: Vector) -> Rows:
        """Start lanes from admissible states at time 0 and return which they are.

        Args:
            p: Gains and parameters, ``(n, n_p)``.
            x: States, ``(n, n_x)``.
            tolerance: Local error allowed.
            until: When they end [s], ``(n,)``.
        """
        rows = self._take(p, tolerance, until, None)
        with np.errstate(all="ignore"):
            self._transitions.admit(rows, x)
        return rows

    def resume(
        self, p: Vector, x: Vector, tolerance: float, until: Vector, *, n_followers: int
    ) -> Rows:
        """Start lanes from states on the stop, the first of each `n_followers + 1` the leader.

        A motion goes on from there as it does after a release, or after an impact that may be
        followed by slower ones of the same sequence.

        Args:
            p: Gains and parameters, ``(n, n_p)``.
            x: States at a release or just after an impact, ``(n, n_x)``.
            tolerance: Local error allowed.
            until: When they end [s], ``(n,)``.
            n_followers: Lanes that follow each leader.
        """
        rows = self._take(p, tolerance, until, n_followers + 1)
        with np.errstate(all="ignore"):
            self._transitions.resume(rows, x)
        return rows

    def stop(self, lanes: Sequence[int]) -> None:
        """End lanes and their followers."""
        for lane in lanes:
            self._transitions.leave(lane)

    def round(self) -> list[LaneEvent]:
        """Advance every lane by one step and return what happened."""
        lanes = self._lanes
        groups = [true_rows(lanes.alive & (lanes.mode == mode)) for mode in range(3)]
        with np.errstate(all="ignore"):
            for mode, rows in enumerate(groups):
                if len(rows):
                    self._advance(mode, rows)
            self._look_for_rest()
        events, self._transitions.events = self._transitions.events, []
        return events

    def _take(self, p: Vector, tolerance: float, until: Vector, bundle: int | None) -> Rows:
        lanes = self._lanes
        rows = np.array([lanes.free_slots.pop() for _ in range(len(p))], dtype=np.intp)
        lanes.alive[rows] = True
        lanes.leader[rows] = rows if bundle is None else np.repeat(rows[::bundle], bundle)
        lanes.p[rows, :-1], lanes.p[rows, -1] = p, 0.0
        lanes.tolerance[rows], lanes.until[rows] = tolerance, until
        lanes.restitution[rows] = self.model.restitution(np.zeros((len(p), self.model.n_x)), p)[0].T
        lanes.steps[rows] = 0
        lanes.largest_rate[rows], lanes.reach[rows] = 0.0, 0.0
        self._transitions.forget(rows)
        return rows

    def _advance(self, mode: int, rows: Rows) -> None:
        """Take a step with every lane of a mode."""
        lanes, transitions = self._lanes, self._transitions
        flow = transitions.flows[mode]
        lead = transitions.lead(rows)
        start = _Start(
            flow=flow,
            y=lanes.y[rows, : flow.n_y],
            p=transitions.numbers(mode, rows),
            tolerance=lanes.tolerance[rows],
        )
        left = (lanes.until[rows] - lanes.leg_time[rows]) / lanes.unit[rows] - lanes.offset[rows]
        size = np.minimum(lanes.size[rows], left)[lead]
        after, error, guard = start.steps(slice(None), size)
        good = self._control(rows, size, error[lead])
        own = lanes.leader[rows] == rows
        falls = self._falls(rows, start, size, guard, good & own)
        fell = np.isfinite(falls)[lead]
        follow = true_rows(fell & ~own)
        if len(follow):
            falls[follow] = _followed(start, follow, falls[lead[follow]])
        on = true_rows(good & ~fell)
        self._go_on(mode, rows[on], after[on], guard[on], size[on])
        at = true_rows(fell & lanes.alive[rows])
        if len(at):
            end, _, end_guard = start.steps(at, falls[at])
            ended = rows[at]
            time = lanes.leg_time[ended] + lanes.unit[ended] * (lanes.offset[ended] + falls[at])
            transitions.arrive(mode, ended, time, end, end_guard)

    def _control(self, rows: Rows, size: Vector, error: Vector) -> Mask:
        """Choose the next sizes from the errors of steps and tell which of these hold."""
        lanes, transitions = self._lanes, self._transitions
        good = error <= 1.0
        factor = np.maximum(_SAFETY * error**_EXPONENT, _SHRINK)
        most = np.where(lanes.refused[rows], 1.0, _GROW)
        factor = np.where(good, np.minimum(factor, most), factor)
        # A flow that blows up returns NaN; a shorter step may still be finite.
        lanes.size[rows] = size * np.where(np.isfinite(error), factor, _SHRINK)
        lanes.refused[rows] = ~good
        lanes.steps[rows] += good
        tiny = ~good & ~(lanes.size[rows] > 4 * np.spacing(lanes.offset[rows]))
        transitions.fail(rows[tiny], "The step size fell to rounding level")
        long = lanes.steps[rows] > self.settings.most_steps
        transitions.fail(rows[long], f"It takes more than {self.settings.most_steps} steps")
        return good

    def _falls(
        self, rows: Rows, start: _Start, size: Vector, guard: Vector, wanted: Mask
    ) -> Vector:
        """Return where in their steps the guards of the wanted lanes fall, NaN elsewhere."""
        before, on_guard = self._lanes.guard[rows], self._lanes.on_guard[rows]
        looked = true_rows(wanted & may_fall(size, before, guard, on_guard))
        falls = np.full(len(rows), np.nan)
        if len(looked):
            step = (size[looked], before[looked], guard[looked], on_guard[looked])
            falls[looked] = start.falls(looked, *step)
        return falls

    def _go_on(self, mode: int, rows: Rows, after: Vector, guard: Vector, size: Vector) -> None:
        """Accept steps of a mode in which no guard fell."""
        if not len(rows):
            return
        lanes, model = self._lanes, self.model
        change = np.maximum(np.abs(lanes.guard[rows, 1]), np.abs(guard[:, 1])) * size
        lanes.largest[rows] = np.maximum(lanes.largest[rows], change)
        own = model.own
        unit = {FREE: own.gap, LOCKED: own.multiplier}.get(mode, 1 / own.gap_acceleration)
        small = np.maximum(_LEAVES * lanes.largest[rows], self.settings.contact * unit)
        left = lanes.on_guard[rows] & (guard[:, 0] < -small)
        lanes.on_guard[rows] &= (guard[:, 0] <= 0.0)[self._transitions.lead(rows)]
        lanes.y[rows, : after.shape[1]], lanes.guard[rows] = after, guard
        lanes.offset[rows] += size
        self._transitions.fail(rows[left], "The state leaves the admissible set from its boundary")
        far = np.abs(after[:, : model.n_x]) > self.bounds
        for k in true_rows(far.any(axis=1) & lanes.alive[rows]).tolist():
            name = model.state_names[int(np.argmax(far[k]))]
            self._transitions.end(int(rows[k]), Reason.ESCAPE, name)
        horizon = (lanes.until[rows] - lanes.leg_time[rows]) / lanes.unit[rows]
        time = lanes.leg_time[rows] + lanes.unit[rows] * lanes.offset[rows]
        early = rows[time <= lanes.until[rows] / 2]
        lanes.reach[early] = np.maximum(lanes.reach[early], np.abs(lanes.y[early, : model.n_q]))
        self._end_of_time(rows[(lanes.offset[rows] >= horizon * (1 - 1e-14)) & lanes.alive[rows]])

    def _end_of_time(self, rows: Rows) -> None:
        """End lanes whose time is over, each with what it has come to."""
        lanes, n_q, end = self._lanes, self.model.n_q, self._transitions.end
        for row in self._still(rows).tolist():
            end(row, Reason.REST, "")
        for row in rows.tolist():
            left = has_left(lanes.y[row, :n_q], lanes.reach[row])
            held = lanes.mode[row] == LOCKED and lanes.leg_time[row] < lanes.until[row] / 2
            if left.any():
                end(row, Reason.ESCAPE, self.model.state_names[int(np.argmax(left))])
            else:
                end(row, Reason.HELD if held else Reason.HORIZON, "")

    def _look_for_rest(self) -> None:
        lanes = self._lanes
        due = lanes.alive & (lanes.steps % _LOOK == _LOOK - 1)
        for row in self._still(true_rows(due)).tolist():
            self._transitions.end(row, Reason.REST, "")

    def _still(self, rows: Rows) -> Rows:
        """Return which of these lanes are at rest, whatever the phase of the clock."""
        found: list[int] = []
        for mode in (FREE, LOCKED):
            still = rows[self._lanes.mode[rows] == mode]
            for phases in (1, _PHASES + 1) if self.model.clock else (1,):
                if len(still):
                    still = still[self._rests(mode, still, phases)]
            found.extend(still.tolist())
        return np.array(found, dtype=np.intp)

    def _rests(self, mode: int, rows: Rows, n_phases: int) -> Mask:
        """Return which lanes of a mode rest, in this phase of the clock or over a whole turn."""
        lanes, model, flow = self._lanes, self.model, self._transitions.flows[mode]
        x = np.repeat(lanes.y[rows, None, : model.n_x], n_phases, axis=1)
        p = np.repeat(lanes.p[rows, :-1], n_phases, axis=0)
        step = np.zeros(len(rows))
        if n_phases > 1:
            turn = np.linspace(0.0, 2 * np.pi, n_phases)
            x[:, :, model.clock] = _turned(x[:, 0, model.clock], turn)
            step = turn[1] / self._clock_rate(mode, rows)
        flat = x.reshape(-1, model.n_x)
        rates = flow.rate(flat, p)[:, model.moving].reshape(len(rows), n_phases, -1)
        zero = self.settings.contact * model.own.rates(model.n_q, model.n_x)[model.moving]
        rests = is_still(rates, lanes.largest_rate[rows][:, model.moving], zero)
        if mode == LOCKED and n_phases > 1:
            guard = flow.guard(flat, p).reshape(len(rows), n_phases, 2)
            rests &= keeps_holding(guard[:, :, 0], guard[:, :, 1], step)
        return rests

    def _clock_rate(self, mode: int, rows: Rows) -> Vector:
        """Return the frequency of the clock in each lane [rad/s]."""
        x, p = self._lanes.y[rows, : self.model.n_x], self._lanes.p[rows, :-1]
        c, s = x[:, self.model.clock].T
        rate = self._transitions.flows[mode].rate(x, p)[:, self.model.clock]
        return (c * rate[:, 1] - s * rate[:, 0]) / (c**2 + s**2)


def _turned(clock: Vector, angle: Vector) -> Vector:
    """Return the states of clocks turned by angles, ``(n, n_angles, 2)``."""
    c, s = clock.T[:, :, None]
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([c * cosine - s * sine, s * cosine + c * sine], axis=2)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Start:
    """States of the lanes of a mode, and steps of any size from there."""

    flow: BatchFlow
    y: Vector
    p: Vector
    tolerance: Vector

    def steps(self, at: Rows | slice, size: Vector) -> tuple[Vector, Vector, Vector]:
        """Return states, errors and guards after steps of some of the lanes."""
        return self.flow.attempt(self.y[at], self.p[at], size, self.tolerance[at])

    def falls(
        self, lanes: Rows, size: Vector, before: Vector, after: Vector, on_guard: Mask
    ) -> Vector:
        """Return where in their steps the guards of some of the lanes fall, NaN elsewhere."""
        told = on_guard.astype(np.float64)
        numbers = np.column_stack([size, self.tolerance[lanes], told, before, after])
        falls = self.flow.falls(self.y[lanes], self.p[lanes], numbers)
        if falls is not None:
            return falls

        def dense(at: Rows, offset: Vector) -> Vector:
            return self.steps(lanes[at], offset)[2]

        return first_falls(dense, size, before, after, on_guard)


def _followed(start: _Start, lanes: Rows, offset: Vector) -> Vector:
    """Return the falls of followers by Newton's method from their leaders' falls."""
    at, open_ = offset.copy(), np.arange(len(offset))
    for _ in range(_MOST_CORRECTIONS):
        guard = start.steps(lanes[open_], at[open_])[2]
        change = -guard[:, 0] / guard[:, 1]
        at[open_] += change
        open_ = open_[np.abs(change) > _FOLLOWED * offset[open_]]
        if not len(open_):
            break
    return at
