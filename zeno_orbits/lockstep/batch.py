"""Many completed executions in lockstep: each lane with its own time, step, mode and numbers.

The rules are those of `simulate`, in rows: flights rescaled after an impact (theory (14)), events
on true steps, the Zeno limit by extrapolation (theory (15)), the locked arc to its release. A lane
never sees another: all that couples them is that one call serves many.

A lane may *follow* another, which then decides for both: step sizes, which steps hold, from which
impacts the Zeno point is told. Followers that start a little beside their leader give derivatives
of the leader's execution as it was computed, free of the noise that steps chosen afresh would bring.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.dynamics import Vector
from zeno_orbits.lockstep.crossing import first_falls, may_fall
from zeno_orbits.lockstep.events import Ended, Event, Reason, Released, Struck
from zeno_orbits.lockstep.lanes import FLIGHT, FREE, LOCKED, Rows, empty_lanes
from zeno_orbits.lockstep.model import ABSOLUTE, BatchFlow, BatchModel
from zeno_orbits.lockstep.tails import Tails

_SAFETY, _SHRINK, _GROW = 0.9, 0.2, 8.0
_EXPONENT = -1 / 5
_LEAVES = 1e-6
"""A guard that was never positive and is below minus this part of its change has been left."""
_MAY_BEND = 0.1
"""Largest relative change of d2h/dt2 over a Zeno tail; beyond it the tail is not geometric yet."""
_STILL = 1e-6
"""Speeds and accelerations below this are rest, in the scene's units."""
_LOOK = 64
"""Steps of a lane between two looks whether it is at rest."""
_FOLLOWED = 1e-10
_MOST_CORRECTIONS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchSettings:
    """How to advance the lanes of a batch.

    Attributes:
        completion: Largest estimated error of a Zeno limit, for a unit of the lane's tolerance.
        resolved: Impacts are resolved one by one until their speed has fallen to this part.
        contact: A gap or gap rate below this counts as zero.
        most_impacts: Impacts without a release before a lane is given up.
        most_steps: Steps before a lane is given up.
    """

    completion: float = 1e-3
    resolved: float = 1e-3
    contact: float = 1e-12
    most_impacts: int = 20_000
    most_steps: int = 1_000_000


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
            model: The scene.
            n_lanes: How many lanes there may be at a time.
            bounds: Largest modulus of each state before a lane has escaped, ``(n_x,)``.
            settings: How to advance them.
        """
        self.model = model
        self.settings = settings or BatchSettings()
        self.bounds = np.full(model.n_x, np.inf) if bounds is None else bounds
        self._lanes = empty_lanes(n_lanes, model.n_x, model.n_p)
        self._tails = Tails(n_lanes, model.n_x)
        self._flows: tuple[BatchFlow, ...] = (model.free, model.flight, model.locked)
        self._events: list[Event] = []
        self._where = np.zeros(n_lanes, dtype=np.intp)

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
            self._admit(rows, x)
        return rows

    def start_released(
        self, p: Vector, x: Vector, tolerance: float, until: Vector, *, n_followers: int
    ) -> Rows:
        """Start lanes from release states, the first of each `n_followers + 1` the leader.

        Args:
            p: Gains and parameters, ``(n, n_p)``.
            x: Release states, ``(n, n_x)``.
            tolerance: Local error allowed.
            until: When they end [s], ``(n,)``.
            n_followers: Lanes that follow each leader.
        """
        rows = self._take(p, tolerance, until, n_followers + 1)
        with np.errstate(all="ignore"):
            self._begin(rows, FREE, np.zeros(len(rows)), x, np.ones(len(rows)), on_guard=True)
        return rows

    def stop(self, lanes: Sequence[int]) -> None:
        """End lanes and their followers."""
        slots = self._lanes
        for lane in lanes:
            if slots.alive[lane]:
                ended = np.flatnonzero(slots.alive & (slots.leader == lane))
                slots.alive[ended] = False
                slots.free_slots.extend(ended.tolist())

    def round(self) -> list[Event]:
        """Advance every lane by one step and return what happened."""
        lanes = self._lanes
        groups = [np.flatnonzero(lanes.alive & (lanes.mode == mode)) for mode in range(3)]
        with np.errstate(all="ignore"):
            for mode, rows in enumerate(groups):
                if len(rows):
                    self._advance(mode, rows)
            self._look_for_rest()
        events, self._events = self._events, []
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
        self._forget(rows)
        return rows

    def _forget(self, rows: Rows) -> None:
        """Begin a new count of impacts."""
        lanes = self._lanes
        lanes.impacts[rows] = 0
        lanes.struck[rows], lanes.zeno_time[rows] = np.nan, np.nan
        lanes.zeno_acceleration[rows] = np.nan
        self._tails.clear(rows)

    def _lead(self, rows: Rows) -> Rows:
        """Return where in these rows each one's leader stands."""
        self._where[rows] = np.arange(len(rows))
        return self._where[self._lanes.leader[rows]]

    def _admit(self, rows: Rows, x: Vector) -> None:
        small = self.settings.contact
        lanes = self._lanes
        p = lanes.p[rows, :-1]
        gap, rate = self.model.contact(x, p)[0][:, :2].T
        time, unit = np.zeros(len(rows)), np.ones(len(rows))
        lanes.y[rows, : self.model.n_x] = x
        outside = ~np.isfinite(x).all(axis=1) | ~(gap >= -small)
        unfit = ~((lanes.restitution[rows] >= 0.0) & (lanes.restitution[rows] < 1.0))
        self._fail(rows[outside], "The start is not admissible: the gap is negative")
        self._fail(rows[~outside & unfit], "The restitution does not lie in [0, 1)")
        well = ~outside & ~unfit
        off = well & (gap > small)
        self._begin(rows[off], FREE, time[off], x[off], unit[off], on_guard=False)
        up = well & (gap <= small) & (rate > small)
        self._launch(rows[up], time[up], x[up], rate[up])
        down = well & (gap <= small) & (rate < -small)
        self._hit(rows[down], time[down], x[down], rate[down])
        still = well & (gap <= small) & (np.abs(rate) <= small)
        self._rest(rows[still], time[still], x[still])

    def _begin(
        self, rows: Rows, mode: int, time: Vector, y: Vector, unit: Vector, *, on_guard: bool
    ) -> None:
        """Start legs of a mode."""
        if not len(rows):
            return
        lanes, flow = self._lanes, self._flows[mode]
        lanes.mode[rows], lanes.leg_time[rows], lanes.unit[rows] = mode, time, unit
        lanes.y[rows, : flow.n_y] = y
        lanes.offset[rows], lanes.largest[rows] = 0.0, 0.0
        lanes.on_guard[rows], lanes.refused[rows] = on_guard, False
        p = self._numbers(mode, rows)
        lanes.guard[rows] = flow.guard(y, p)
        slope = flow.rate(y, p)
        ratio = np.max(np.abs(slope / (ABSOLUTE + np.abs(y))), axis=1)
        size = np.where(ratio > 1e-5, 0.01 / ratio, 1e-3)
        lead = self._lead(rows)
        lanes.size[rows] = size[lead]
        lost = ~np.isfinite(slope).all(axis=1)
        self._fail(rows[lost], "The flow is not finite at its start")

    def _numbers(self, mode: int, rows: Rows) -> Vector:
        return self._lanes.p[rows] if mode == FLIGHT else self._lanes.p[rows, :-1]

    def _launch(self, rows: Rows, time: Vector, x: Vector, speed: Vector) -> None:
        """Start rescaled flights."""
        if len(rows):
            self._lanes.p[rows, -1] = speed
            scaled = np.tile([0.0, 1.0], (len(rows), 1))
            y = np.concatenate([x, scaled], axis=1)
            self._begin(rows, FLIGHT, time, y, speed, on_guard=True)

    def _advance(self, mode: int, rows: Rows) -> None:
        """Take a step with every lane of a mode."""
        lanes, flow = self._lanes, self._flows[mode]
        lead = self._lead(rows)
        y, p, tolerance = lanes.y[rows, : flow.n_y], self._numbers(mode, rows), lanes.tolerance[rows]
        left = (lanes.until[rows] - lanes.leg_time[rows]) / lanes.unit[rows] - lanes.offset[rows]
        size = np.minimum(lanes.size[rows], left)[lead]
        after, error, guard = flow.attempt(y, p, size, tolerance)
        error = error[lead]
        good = error <= 1.0
        factor = np.maximum(_SAFETY * error**_EXPONENT, _SHRINK)
        factor = np.where(good, np.minimum(factor, np.where(lanes.refused[rows], 1.0, _GROW)), factor)
        lanes.size[rows] = size * np.where(np.isfinite(error), factor, _SHRINK)
        lanes.refused[rows] = ~good
        lanes.steps[rows] += good
        tiny = ~good & ~(lanes.size[rows] > 4 * np.spacing(lanes.offset[rows]))
        self._fail(rows[tiny], "The step size fell to rounding level")
        long = lanes.steps[rows] > self.settings.most_steps
        self._fail(rows[long], f"It takes more than {self.settings.most_steps} steps")
        before, on_guard = lanes.guard[rows], lanes.on_guard[rows]
        own = lanes.leader[rows] == rows
        looked = np.flatnonzero(good & own & may_fall(size, before, guard, on_guard))
        falls = np.full(len(rows), np.nan)
        if len(looked):

            def dense(at: Rows, offset: Vector) -> Vector:
                k = looked[at]
                return flow.attempt(y[k], p[k], offset, tolerance[k])[2]

            falls[looked] = first_falls(
                dense, size[looked], before[looked], guard[looked], on_guard[looked]
            )
        fell = np.isfinite(falls)[lead]
        followers = np.flatnonzero(fell & ~own)
        if len(followers):
            falls[followers] = _followed(
                flow, y[followers], p[followers], falls[lead[followers]], tolerance[followers]
            )
        on = np.flatnonzero(good & ~fell)
        self._go_on(mode, rows[on], after[on], guard[on], size[on])
        at = np.flatnonzero(fell & lanes.alive[rows])
        if len(at):
            end, _, end_guard = flow.attempt(y[at], p[at], falls[at], tolerance[at])
            ended = rows[at]
            time = lanes.leg_time[ended] + lanes.unit[ended] * (lanes.offset[ended] + falls[at])
            self._arrive(mode, ended, time, end, end_guard)

    def _go_on(self, mode: int, rows: Rows, after: Vector, guard: Vector, size: Vector) -> None:
        """Accept steps in which no guard fell."""
        if not len(rows):
            return
        lanes, model = self._lanes, self.model
        change = np.maximum(np.abs(lanes.guard[rows, 1]), np.abs(guard[:, 1])) * size
        lanes.largest[rows] = np.maximum(lanes.largest[rows], change)
        small = np.maximum(_LEAVES * lanes.largest[rows], self.settings.contact)
        left = lanes.on_guard[rows] & (guard[:, 0] < -small)
        lanes.on_guard[rows] &= (guard[:, 0] <= 0.0)[self._lead(rows)]
        lanes.y[rows, : after.shape[1]], lanes.guard[rows] = after, guard
        lanes.offset[rows] += size
        self._fail(rows[left], "The state leaves the admissible set from its boundary")
        far = np.abs(after[:, : model.n_x]) > self.bounds
        for k in np.flatnonzero(far.any(axis=1) & lanes.alive[rows]):
            name = model.state_names[int(np.argmax(far[k]))]
            self._end(int(rows[k]), Reason.ESCAPE, name)
        horizon = (lanes.until[rows] - lanes.leg_time[rows]) / lanes.unit[rows]
        over = lanes.offset[rows] >= horizon * (1 - 1e-14)
        for row in rows[over & lanes.alive[rows]]:
            self._end(int(row), Reason.HORIZON, "")

    def _arrive(self, mode: int, rows: Rows, time: Vector, y: Vector, guard: Vector) -> None:
        """Do what the fall of a guard means."""
        lanes = self._lanes
        x = y[:, : self.model.n_x]
        lanes.y[rows, : y.shape[1]] = y
        if mode == LOCKED:
            self._release(rows, time, x)
        elif mode == FLIGHT:
            self._hit(rows, time, x, lanes.p[rows, -1] * y[:, -1])
        else:
            self._tails.clear(rows)
            # The gap closes no faster than rounding: the stop is touched, not struck.
            touched = (np.abs(guard[:, 1]) <= self.settings.contact)[self._lead(rows)]
            self._rest(rows[touched], time[touched], x[touched])
            self._hit(rows[~touched], time[~touched], x[~touched], guard[~touched, 1])

    def _release(self, rows: Rows, time: Vector, x: Vector) -> None:
        lanes = self._lanes
        state = self.model.resting(x, lanes.p[rows, :-1])[0]
        for k, row in enumerate(rows.tolist()):
            self._events.append(
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
        self._forget(rows)
        self._begin(rows, FREE, time, state, np.ones(len(rows)), on_guard=True)

    def _rest(self, rows: Rows, time: Vector, x: Vector) -> None:
        """Go on from the stop at zero gap rate: locked, or released at once."""
        if len(rows):
            state, acceleration, _ = self.model.resting(x, self._lanes.p[rows, :-1])
            self._lock(rows, time, state, *self._holds(rows, state, acceleration[:, 0]))

    def _holds(
        self, rows: Rows, state: Vector, acceleration: Vector
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Tell where the stop holds, and where it neither holds nor repels, to rounding."""
        lead = self._lead(rows)
        slack = np.abs(acceleration) <= self.settings.contact
        holds = acceleration < 0.0
        if slack.any():
            rate = self.model.contact(state, self._lanes.p[rows, :-1])[0][:, 4]
            holds = np.where(slack, rate > 0.0, holds)
        return holds[lead], slack[lead]

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
            self._begin(rows[at], LOCKED, time[at], state[at], unit[at], on_guard=on_guard)
        at = ~holds
        self._begin(rows[at], FREE, time[at], state[at], unit[at], on_guard=True)

    def _hit(self, rows: Rows, time: Vector, x: Vector, rate: Vector) -> None:
        """Apply the reset map and go on."""
        if not len(rows):
            return
        lanes, model, small = self._lanes, self.model, self.settings.contact
        p = lanes.p[rows, :-1]
        x_plus = model.reset(x, p, rate[:, None])[0]
        speed = -lanes.restitution[rows] * rate
        rate_plus = model.contact(x_plus, p)[0][:, 1]
        lanes.struck[rows] = np.where(lanes.impacts[rows] == 0, rate, lanes.struck[rows])
        lanes.impacts[rows] += 1
        self._fail(rows[~(rate < 0.0)], "An impact must close the gap, but it opens")
        inside = (rate < 0.0) & (rate_plus < -1e-9 * (1.0 - rate))
        self._fail(rows[inside], "The reset map sends the state into the stop")
        chatter = lanes.impacts[rows] > self.settings.most_impacts
        most = f"More than {self.settings.most_impacts} impacts came without a release"
        self._fail(rows[chatter], most)
        alive = lanes.alive[rows]
        rows, time, x_plus, speed, rate = (a[alive] for a in (rows, time, x_plus, speed, rate))
        if not len(rows):
            return
        lead = self._lead(rows)
        first = (speed >= self._tails.last_speed(rows)) | (self._tails.count[rows] == 0)
        for k in np.flatnonzero(first & (lanes.leader[rows] == rows)):
            self._events.append(
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
        at = np.flatnonzero(flies)
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
        lanes, tails, settings = self._lanes, self._tails, self.settings
        state, acceleration, flow = resting
        lead = self._lead(rows)
        presses = (acceleration < 0.0)[lead]
        tails.clear(rows[~presses | (speed >= tails.last_speed(rows))[lead]])
        remaining = 2 * speed / (-acceleration * (1 - lanes.restitution[rows]))
        told = time + remaining, state + remaining[:, None] * flow
        tails.append(rows[presses], speed[presses], told[0][presses], told[1][presses])
        due = np.flatnonzero(presses & (speed <= settings.resolved * tails.speed[rows, 0])[lead])
        done = np.zeros(len(rows), dtype=bool)
        if len(due):
            done[due] = self._pass(rows[due], acceleration[due])
        on = ~done
        self._launch(rows[on], time[on], x_plus[on], speed[on])

    def _pass(self, rows: Rows, acceleration: Vector) -> NDArray[np.bool_]:
        """Go on from the Zeno points that are told well enough, and tell which those are."""
        lanes, settings = self._lanes, self.settings
        lead = self._lead(rows)
        time, raw, error = self._tails.limits(rows, lanes.leader[rows])
        state, there, _ = self.model.resting(raw, lanes.p[rows, :-1])
        there = there[:, 0]
        holds, slack = self._holds(rows, state, there)
        fit = (error <= settings.completion * lanes.tolerance[rows]) & (time < lanes.until[rows])
        fit &= np.abs(there - acceleration) <= _MAY_BEND * np.abs(acceleration)
        done = (fit & holds)[lead]
        lanes.zeno_time[rows[done]] = time[done]
        lanes.zeno_acceleration[rows[done]] = there[done]
        self._lock(rows[done], time[done], state[done], holds[done], slack[done])
        return done

    def _look_for_rest(self) -> None:
        lanes, n_q = self._lanes, self.model.n_q
        due = lanes.alive & (lanes.steps % _LOOK == _LOOK - 1)
        for mode in (FREE, LOCKED):
            rows = np.flatnonzero(due & (lanes.mode == mode))
            if not len(rows):
                continue
            x = lanes.y[rows, : self.model.n_x]
            slow = np.abs(x[:, n_q : 2 * n_q]).max(axis=1, initial=0.0) < _STILL
            rows, x = rows[slow], x[slow]
            if len(rows):
                motion = np.abs(self._flows[mode].rate(x, lanes.p[rows, :-1])[:, : 2 * n_q])
                for row in rows[motion.max(axis=1) < _STILL]:
                    self._end(int(row), Reason.REST, "")

    def _fail(self, rows: Rows, sentence: str) -> None:
        for row in rows.tolist():
            self._end(row, Reason.FAILURE, sentence)

    def _end(self, row: int, reason: Reason, detail: str) -> None:
        """End a lane; a follower that cannot go on is left to its leader, and holds NaN."""
        lanes = self._lanes
        if not lanes.alive[row]:
            return
        if lanes.leader[row] != row:
            if reason is Reason.FAILURE:
                lanes.y[row] = np.nan
            return
        time = lanes.leg_time[row] + lanes.unit[row] * lanes.offset[row]
        state = lanes.y[row, : self.model.n_x].copy()
        self._events.append(
            Ended(lane=row, time=float(time), state=state, reason=reason, detail=detail)
        )
        self.stop([row])


def _followed(
    flow: BatchFlow, y: Vector, p: Vector, offset: Vector, tolerance: Vector
) -> Vector:
    """Return the falls of followers by Newton's method from their leaders' falls."""
    at, open_ = offset.copy(), np.arange(len(offset))
    for _ in range(_MOST_CORRECTIONS):
        guard = flow.attempt(y[open_], p[open_], at[open_], tolerance[open_])[2]
        change = -guard[:, 0] / guard[:, 1]
        at[open_] += change
        open_ = open_[np.abs(change) > _FOLLOWED * np.abs(offset[open_])]
        if not len(open_):
            break
    return at
