"""Transitions of lanes at their events: impacts, Zeno points, release, the end.

The rules are those of `simulate` in rows, `completion.ZenoExtrapolation` among them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Rows, Vector
from zeno_orbits.model import GAP_RATE, MULTIPLIER_RATE
from zeno_orbits.simulation.batch.lanes import (
    FLIGHT,
    FREE,
    LOCKED,
    Lanes,
    true_rows,
)
from zeno_orbits.simulation.batch.model import BatchFlow, BatchModel
from zeno_orbits.simulation.batch.outcomes import Ended, LaneEvent, Reason, Released, Struck
from zeno_orbits.simulation.batch.zeno_limit import Tails
from zeno_orbits.simulation.event_rules import enters_stop, is_geometric, stop_holds
from zeno_orbits.simulation.zeno_limit import tail_time

_HARDLY, _FIRST = 1e-5, 1e-3
"""A flow that changes by less than this in the problem's own time; its first step, in these."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchSettings:
    """Accuracy and limits of a batch.

    Attributes:
        completion: Largest estimated error of a Zeno limit, for a unit of the lane's tolerance.
        resolved: Impacts are resolved one by one until their speed has fallen to this part.
        contact: A gap, gap rate or gap acceleration below this part of the problem's own counts
            as zero.
        most_impacts: Impacts without a release before a lane is given up.
        most_steps: Steps before a lane is given up.
    """

    completion: float = 1e-3
    resolved: float = 1e-3
    contact: float = 1e-12
    most_impacts: int = 20_000
    most_steps: int = 200_000


class Transitions:
    """The lanes of a batch between their steps; `events` collects what is to be told of them."""

    def __init__(self, model: BatchModel, lanes: Lanes, settings: BatchSettings) -> None:
        self.model = model
        self.lanes = lanes
        self.settings = settings
        self.events: list[LaneEvent] = []
        self.flows: tuple[BatchFlow, ...] = (model.free, model.flight, model.locked)
        unit = np.append(model.own.time, model.own.states(model.n_x))
        self._tails = Tails(len(lanes.alive), unit)
        self._where = np.zeros(len(lanes.alive), dtype=np.intp)

    def end(self, row: int, reason: Reason, detail: str) -> None:
        """End a lane; a follower that cannot go on is left to its leader, and holds NaN.

        Args:
            row: The lane.
            reason: Its end.
            detail: Name of what escaped, or a sentence on a failure.
        """
        lanes = self.lanes
        if not lanes.alive[row]:
            return
        if lanes.leader[row] != row:
            if reason is Reason.FAILURE:
                lanes.y[row] = np.nan
            return
        time = lanes.leg_time[row] + lanes.unit[row] * lanes.offset[row]
        state = lanes.y[row, : self.model.n_x].copy()
        self.events.append(
            Ended(lane=row, time=float(time), state=state, reason=reason, detail=detail)
        )
        self.leave(row)

    def fail(self, rows: Rows, sentence: str) -> None:
        """End lanes that cannot be continued, and say why."""
        for row in rows.tolist():
            self.end(row, Reason.FAILURE, sentence)

    def forget(self, rows: Rows) -> None:
        """Begin a new count of impacts."""
        lanes = self.lanes
        lanes.impacts[rows] = 0
        lanes.struck[rows], lanes.zeno_time[rows] = np.nan, np.nan
        lanes.zeno_acceleration[rows] = np.nan
        self._tails.clear(rows)

    def lead(self, rows: Rows) -> Rows:
        """Return where in these rows each one's leader stands."""
        self._where[rows] = np.arange(len(rows))
        return self._where[self.lanes.leader[rows]]

    def begin(
        self, rows: Rows, mode: int, time: Vector, y: Vector, unit: Vector, *, on_guard: bool
    ) -> None:
        """Start legs of a mode.

        Args:
            rows: The lanes, ``(n,)``.
            mode: ``FREE``, ``FLIGHT`` or ``LOCKED``.
            time: Their starts [s], ``(n,)``.
            y: States of the flow there, ``(n, n_y)``.
            unit: Length of one unit of the flow's own time [s], ``(n,)``.
            on_guard: The starts are roots of the guard that do not count.
        """
        if not len(rows):
            return
        lanes, flow = self.lanes, self.flows[mode]
        lanes.mode[rows], lanes.leg_time[rows], lanes.unit[rows] = mode, time, unit
        lanes.y[rows, : flow.n_y] = y
        lanes.offset[rows], lanes.largest[rows] = 0.0, 0.0
        lanes.on_guard[rows], lanes.refused[rows] = on_guard, False
        p = self.numbers(mode, rows)
        lanes.guard[rows] = flow.guard(y, p)
        slope = flow.rate(y, p)
        ratio = np.max(np.abs(slope / (self.model.absolute + np.abs(y))), axis=1)
        own_time = self.model.own.time / unit
        size = np.where(ratio * own_time > _HARDLY, 0.01 / ratio, _FIRST * own_time)
        rate = np.abs(slope[:, : self.model.n_x]) / np.reshape(unit, (-1, 1))
        lanes.largest_rate[rows] = np.fmax(lanes.largest_rate[rows], rate)
        lead = self.lead(rows)
        lanes.size[rows] = size[lead]
        lost = ~np.isfinite(slope).all(axis=1)
        self.fail(rows[lost], "The flow is not finite at its start")

    def numbers(self, mode: int, rows: Rows) -> Vector:
        """Return the parameters of a mode, ``(n, n_p)``; a flight has its speed behind them."""
        return self.lanes.p[rows] if mode == FLIGHT else self.lanes.p[rows, :-1]

    def _launch(self, rows: Rows, time: Vector, x: Vector, speed: Vector) -> None:
        """Start rescaled flights."""
        if len(rows):
            self.lanes.p[rows, -1] = speed
            scaled = np.tile([0.0, 1.0], (len(rows), 1))
            y = np.concatenate([x, scaled], axis=1)
            self.begin(rows, FLIGHT, time, y, speed, on_guard=True)

    def admit(self, rows: Rows, x: Vector) -> None:
        """Start lanes at time 0 in the mode that their states ask for."""
        own, lanes = self.model.own, self.lanes
        small, small_rate = self.settings.contact * own.gap, self.settings.contact * own.gap_rate
        p = lanes.p[rows, :-1]
        gap, rate = self.model.contact(x, p)[0][:, :2].T
        time, unit = np.zeros(len(rows)), np.ones(len(rows))
        lanes.y[rows, : self.model.n_x] = x
        outside = ~np.isfinite(x).all(axis=1) | ~(gap >= -small)
        unfit = ~((lanes.restitution[rows] >= 0.0) & (lanes.restitution[rows] < 1.0))
        self.fail(rows[outside], "The start is not admissible: the gap is negative")
        self.fail(rows[unfit], "The restitution does not lie in [0, 1)")
        well = lanes.alive[rows]
        off = well & (gap > small)
        self.begin(rows[off], FREE, time[off], x[off], unit[off], on_guard=False)
        up = well & (gap <= small) & (rate > small_rate)
        self._launch(rows[up], time[up], x[up], rate[up])
        down = well & (gap <= small) & (rate < -small_rate)
        self._hit(rows[down], time[down], x[down], rate[down])
        still = well & (gap <= small) & (np.abs(rate) <= small_rate)
        self._rest(rows[still], time[still], x[still])

    def resume(self, rows: Rows, x: Vector) -> None:
        """Start lanes at time 0 at a release, or in a sequence of impacts, just after one."""
        p = self.lanes.p[rows, :-1]
        rate = self.model.contact(x, p)[0][:, GAP_RATE]
        flies = (rate > self.settings.contact * self.model.own.gap_rate)[self.lead(rows)]
        time, unit = np.zeros(len(rows)), np.ones(len(rows))
        at = ~flies
        self.begin(rows[at], FREE, time[at], x[at], unit[at], on_guard=True)
        state, acceleration, flow = self.model.resting(x[flies], p[flies])
        resting = state, acceleration[:, 0], flow
        self._accumulate(rows[flies], time[flies], x[flies], rate[flies], resting)

    def arrive(self, mode: int, rows: Rows, time: Vector, y: Vector, guard: Vector) -> None:
        """Apply the event that the fall of a guard means.

        Args:
            mode: Mode of the lanes.
            rows: The lanes, ``(n,)``.
            time: When their guards fell [s], ``(n,)``.
            y: States of the flow there, ``(n, n_y)``.
            guard: Guards and their rates there, ``(n, 2)``.
        """
        lanes = self.lanes
        x = y[:, : self.model.n_x]
        lanes.y[rows, : y.shape[1]] = y
        if mode == LOCKED:
            self._release(rows, time, x)
        elif mode == FLIGHT:
            self._hit(rows, time, x, lanes.p[rows, -1] * y[:, -1])
        else:
            self._tails.clear(rows)
            # The gap closes no faster than rounding: the stop is touched, not struck.
            small = self.settings.contact * self.model.own.gap_rate
            touched = (np.abs(guard[:, 1]) <= small)[self.lead(rows)]
            self._rest(rows[touched], time[touched], x[touched])
            self._hit(rows[~touched], time[~touched], x[~touched], guard[~touched, 1])

    def _release(self, rows: Rows, time: Vector, x: Vector) -> None:
        lanes = self.lanes
        state = self.model.resting(x, lanes.p[rows, :-1])[0]
        for k, row in enumerate(rows.tolist()):
            self.events.append(
                Released(
                    lane=row,
                    time=float(time[k]),
                    state=state[k].copy(),
                    impacts=int(lanes.impacts[row]),
                    struck=float(lanes.struck[row]),
                    zeno_time=float(lanes.zeno_time[row]),
                    zeno_acceleration=float(lanes.zeno_acceleration[row]),
                )
            )
        self.forget(rows)
        self.begin(rows, FREE, time, state, np.ones(len(rows)), on_guard=True)

    def _rest(self, rows: Rows, time: Vector, x: Vector) -> None:
        """Go on from the stop at zero gap rate: locked, or released at once."""
        if len(rows):
            state, acceleration, _ = self.model.resting(x, self.lanes.p[rows, :-1])
            self._lock(rows, time, state, *self._holds(rows, state, acceleration[:, 0]))

    def _holds(
        self, rows: Rows, state: Vector, acceleration: Vector
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Tell where the stop holds, and where it neither holds nor repels, to rounding."""
        lead = self.lead(rows)
        slack = np.abs(acceleration) <= self.settings.contact * self.model.own.gap_acceleration
        rate = np.full(len(rows), np.nan)
        if slack.any():
            rate = self.model.contact(state, self.lanes.p[rows, :-1])[0][:, MULTIPLIER_RATE]
        return stop_holds(acceleration, rate, slack)[lead], slack[lead]

    def _lock(
        self,
        rows: Rows,
        time: Vector,
        state: Vector,
        holds: NDArray[np.bool_],
        slack: NDArray[np.bool_],
    ) -> None:
        """Start locked legs where the stop holds, and free ones where it does not."""
        unit = np.ones(len(rows))
        for on_guard in (False, True):
            at = holds & (slack == on_guard)
            self.begin(rows[at], LOCKED, time[at], state[at], unit[at], on_guard=on_guard)
        at = ~holds
        self.begin(rows[at], FREE, time[at], state[at], unit[at], on_guard=True)

    def _hit(self, rows: Rows, time: Vector, x: Vector, rate: Vector) -> None:
        """Apply the reset map and go on."""
        if not len(rows):
            return
        lanes, model = self.lanes, self.model
        small = self.settings.contact * model.own.gap_rate
        p = lanes.p[rows, :-1]
        x_plus = model.reset(x, p, rate[:, None])[0]
        speed = model.rebound(p, rate[:, None])[0][:, 0]
        rate_plus = model.contact(x_plus, p)[0][:, GAP_RATE]
        lanes.struck[rows] = np.where(lanes.impacts[rows] == 0, rate, lanes.struck[rows])
        lanes.impacts[rows] += 1
        self.fail(rows[~(rate < 0.0)], "An impact must close the gap, but it opens")
        inside = enters_stop(rate_plus, rate, model.own.gap_rate)
        self.fail(rows[inside], "The reset map sends the state into the stop")
        chatter = lanes.impacts[rows] > self.settings.most_impacts
        most = f"More than {self.settings.most_impacts} impacts came without a release"
        self.fail(rows[chatter], most)
        alive = lanes.alive[rows]
        rows = rows[alive]
        time, x_plus, speed, rate = (a[alive] for a in (time, x_plus, speed, rate))
        if not len(rows):
            return
        lead = self.lead(rows)
        # Impacts of a sequence slow down by `e` nearly; one that keeps more begins another.
        keeps = (1 + lanes.restitution[rows]) / 2
        first = speed >= keeps * self._tails.last_speed(rows)
        first |= self._tails.count[rows] == 0
        for k in true_rows(first[lead]).tolist():
            self.events.append(
                Struck(
                    lane=int(rows[k]),
                    time=float(time[k]),
                    state=x_plus[k].copy(),
                    rate=float(rate[k]),
                )
            )
        state, acceleration, flow = model.resting(x_plus, lanes.p[rows, :-1])
        acceleration = acceleration[:, 0]
        slow = (speed <= small)[lead]
        flies = np.ones(len(rows), dtype=bool)
        if slow.any():
            holds, slack = self._holds(rows, state, acceleration)
            # Where the stop lets go, the flight is the free flow's whatever is left of the speed.
            stays = slow & (~holds | (speed == 0.0)[lead])
            reached = stays & holds
            lanes.zeno_time[rows[reached]] = time[reached]
            lanes.zeno_acceleration[rows[reached]] = acceleration[reached]
            self._lock(rows[stays], time[stays], state[stays], holds[stays], slack[stays])
            flies = ~stays
        at = true_rows(flies)
        self._accumulate(
            rows[at], time[at], x_plus[at], speed[at], (state[at], acceleration[at], flow[at])
        )

    def _accumulate(
        self,
        rows: Rows,
        time: Vector,
        x_plus: Vector,
        speed: Vector,
        resting: tuple[Vector, Vector, Vector],
    ) -> None:
        """Pass to the Zeno point where the impacts so far tell it, and fly on elsewhere."""
        if not len(rows):
            return
        lanes, tails, settings = self.lanes, self._tails, self.settings
        state, acceleration, flow = resting
        lead = self.lead(rows)
        presses = (acceleration < 0.0)[lead]
        tails.clear(rows[~presses | (speed >= tails.last_speed(rows))[lead]])
        remaining = tail_time(speed, acceleration, lanes.restitution[rows])
        told = time + remaining, state + remaining[:, None] * flow
        tails.append(rows[presses], speed[presses], told[0][presses], told[1][presses])
        due = true_rows(presses & (speed <= settings.resolved * tails.speed[rows, 0])[lead])
        done = np.zeros(len(rows), dtype=bool)
        if len(due):
            done[due] = self._pass(rows[due], acceleration[due])
        on = ~done
        self._launch(rows[on], time[on], x_plus[on], speed[on])

    def _pass(self, rows: Rows, acceleration: Vector) -> NDArray[np.bool_]:
        """Go on from the Zeno points that are told well enough, and tell which those are."""
        lanes, settings = self.lanes, self.settings
        lead = self.lead(rows)
        time, raw, error = self._tails.limits(rows, lanes.leader[rows])
        state, there, _ = self.model.resting(raw, lanes.p[rows, :-1])
        there = there[:, 0]
        holds, slack = self._holds(rows, state, there)
        fit = (error <= settings.completion * lanes.tolerance[rows]) & (time < lanes.until[rows])
        fit &= is_geometric(there, acceleration)
        done = (fit & holds)[lead]
        lanes.zeno_time[rows[done]] = time[done]
        lanes.zeno_acceleration[rows[done]] = there[done]
        self._lock(rows[done], time[done], state[done], holds[done], slack[done])
        return done

    def leave(self, row: int) -> None:
        """Take a lane and its followers out."""
        lanes = self.lanes
        if lanes.alive[row]:
            ended = true_rows(lanes.alive & (lanes.leader == row))
            lanes.alive[ended] = False
            lanes.free_slots.extend(ended.tolist())
