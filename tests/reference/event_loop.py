r"""Executions of machines with several stops, switches and kinks, in NumPy and SciPy alone.

Nothing is shared with the package. SciPy's DOP853 follows every mode with a tolerance of 1e-12. A
guard is evaluated at sixteen points of each step, its root is bracketed on the dense output, and
then refined by steps that end at the root. Impacts are resolved one by one down to a small speed
`w`. Time and state at the impacts of a sequence are smooth functions of `w`. Their limit at `w = 0`
is extrapolated by Neville's scheme.

The mode after an event solves a linear complementarity problem by enumeration: forces on the closed
stops at rest, impulses at an impact.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq, minimize_scalar

Array = np.ndarray
State = tuple[Array, Array, Array]
"""Coordinates, velocities and further states."""
Formula = Callable[[float, Array, Array, Array], float]
"""A function of time, coordinates, velocities and further states."""

_LOOKS = 16
"""Evaluations of every guard per step."""
_ARMED = 4e-14
"""Value from which a guard that started at its zero can fall through zero."""
_TOGETHER = 1e-10
"""Time between two events that are not told apart."""
_TOO_SLOW = 1e-8
"""Speed after an impact below which a limit is taken as it is."""
_ACCUMULATED = 1e-4
"""Time between switches, shorter than the one before, that belongs to an accumulation."""
_CORNER = 5
"""Impacts within 1e-8 s that end a run: with one stop, the limit is found before them."""
_MOST_IN_CORNER, _SOON, _CLEAR = 1000, 1e-7, 1e-5
"""Impacts in a corner that are followed, the time within which forces change no gap rate by more
than a tenth of the last value, and this value, with which a stop is left for good."""
_NODES = 8
"""Largest number of impacts from which a limit is extrapolated."""
_GRAZE = 1e-8
"""Smallest value of a guard at an extremum that is told from zero."""
_AHEAD = 1e-4
"""Time after which the branch of a formula that starts at its kink is read."""


class Refused(Exception):  # noqa: N818
    """The execution ends here, for a reason that the package has a name for."""

    def __init__(self, reason: str, time: float, detail: str = "") -> None:
        super().__init__(f"{reason} at {time:.12g} {detail}")
        self.reason, self.time = reason, time


class Unsure(Exception):  # noqa: N818
    """Rounding decides what happens next, so there is no reference beyond this time."""

    def __init__(self, reason: str, time: float) -> None:
        super().__init__(f"{reason} at {time:.12g}")
        self.time = time


@dataclass(frozen=True, kw_only=True)
class Contact:
    """A stop.

    Attributes:
        name: Its name.
        gap: Of the coordinates.
        normal: Gradient of the gap, ``(n,)``.
        bend: Second derivative of the gap along the velocity.
        restitution: Of impacts.
    """

    name: str
    gap: Callable[[Array], float]
    normal: Callable[[Array], Array]
    restitution: float
    bend: Callable[[Array, Array], float] = lambda _q, _v: 0.0


@dataclass(frozen=True, kw_only=True)
class Reset:
    """A switch: its guard falls through zero while it is armed, and the state is reset."""

    name: str
    guard: Formula
    armed: Formula
    after: Callable[[float, Array, Array, Array], State]


@dataclass(frozen=True, kw_only=True)
class Machine:
    """A machine in numbers.

    Attributes:
        n: Number of coordinates.
        mass: Mass matrix, ``(n, n)``.
        force: All forces without those of the stops, ``(n,)``, of time, coordinates, velocities,
            further states and the branches of the kinks.
        rate: Rates of the further states, of the same.
        contacts: The stops.
        kinks: Conditions of the switched formulas. The branch is whether a condition is positive.
        resets: The switches.
        scale: Longest step.
    """

    n: int
    mass: Callable[[Array], Array]
    force: Callable[[float, Array, Array, Array, tuple[bool, ...]], Array]
    rate: Callable[[float, Array, Array, Array, tuple[bool, ...]], Array] = lambda *_: np.empty(0)
    contacts: tuple[Contact, ...] = ()
    kinks: tuple[Formula, ...] = ()
    resets: tuple[Reset, ...] = ()
    scale: float = 0.1


@dataclass(frozen=True, kw_only=True)
class Event:
    """An event.

    Attributes:
        kind: ``impact``, ``zeno``, ``release`` or ``switch``.
        name: Name of the stop or switch, empty for a kink.
        time: When it happens.
        before: State before it.
        after: State after it.
        rate: Gap rate before an impact.
        closed: Stops that are closed after it.
        forced: Whether it is the consequence of another event at the same time.
    """

    kind: str
    name: str
    time: float
    before: Array
    after: Array
    rate: float = math.nan
    closed: tuple[str, ...] = ()
    forced: bool = False


@dataclass(slots=True)
class Run:
    """An execution: its events, its end, and the reason if it ended early."""

    events: list[Event] = field(default_factory=list[Event])
    end_time: float = 0.0
    end_state: Array = field(default_factory=lambda: np.empty(0))
    refused: Refused | None = None
    unsure: Unsure | None = None


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """Tolerance of the steps, and the speed from which limits are extrapolated."""

    tolerance: float = 1e-12
    slow: float = 2e-3


def complementary(matrix: Array, free: Array) -> Array:
    """Return ``f >= 0`` with ``free + matrix f >= 0``, one of the two zero in each entry."""
    n = len(free)
    for size in range(n + 1):
        for held in itertools.combinations(range(n), size):
            at = list(held)
            f = np.zeros(n)
            if at:
                f[at] = np.linalg.solve(matrix[np.ix_(at, at)], -free[at])
            left = free + matrix @ f
            left[at] = 0.0
            if np.all(f >= 0.0) and np.all(left >= 0.0):
                return f
    raise ArithmeticError("The complementarity problem has no solution.")


class _Loop:
    """One execution. The state is ``(q, v, z)`` in one array.

    After an impact the gap and gap rate of its stop are two further states, which start at 0 and
    `w`. So they keep all their digits however small `w` is.
    """

    def __init__(self, machine: Machine, accuracy: Accuracy, size: int) -> None:
        self.m, self.accuracy, self.size = machine, accuracy, size
        self.watched: int | None = None
        self.speed = 0.0

    def split(self, y: Array) -> State:
        n = self.m.n
        return y[:n], y[n : 2 * n], y[2 * n : self.size]

    def normals(self, q: Array, closed: Sequence[int]) -> Array:
        rows = [self.m.contacts[k].normal(q) for k in closed]
        return np.array(rows).reshape(len(closed), self.m.n)

    def flow(
        self, t: float, y: Array, closed: tuple[int, ...], branches: tuple[bool, ...]
    ) -> tuple[Array, Array, Array]:
        """Return the rate of the state, the forces of the closed stops, all gap accelerations."""
        q, v, z = self.split(y)
        mass = self.m.mass(q)
        a = np.linalg.solve(mass, self.m.force(t, q, v, z, branches))
        forces = np.empty(0)
        if closed:
            J = self.normals(q, closed)
            response = np.linalg.solve(mass, J.T)
            bend = np.array([self.m.contacts[k].bend(q, v) for k in closed])
            forces = -np.linalg.solve(J @ response, J @ a + bend)
            a = a + response @ forces
        rate = np.concatenate([v, a, self.m.rate(t, q, v, z, branches)])
        lifts = np.array([c.normal(q) @ a + c.bend(q, v) for c in self.m.contacts])
        if len(y) > self.size and self.watched is not None:
            rate = np.concatenate([rate, [y[-1], lifts[self.watched]]])
        return rate, forces, lifts

    def gap_rate(self, k: int, y: Array) -> float:
        q, v, _ = self.split(y)
        return float(self.m.contacts[k].normal(q) @ v)

    def holding(
        self, t: float, y: Array, touching: tuple[int, ...], branches: tuple[bool, ...]
    ) -> tuple[int, ...]:
        """Return the stops among those at zero gap and rate that carry a force."""
        if not touching:
            return ()
        q, _, _ = self.split(y)
        _, _, lifts = self.flow(t, y, (), branches)
        J = self.normals(q, touching)
        matrix = J @ np.linalg.solve(self.m.mass(q), J.T)
        f = complementary(matrix, lifts[list(touching)])
        return tuple(k for k, force in zip(touching, f, strict=True) if force > 0.0)

    def struck(
        self, y: Array, k: int, approach: float, closed: tuple[int, ...]
    ) -> tuple[Array, tuple[int, ...]]:
        """Return the state after an impact on a stop, and the closed stops that stay closed."""
        q, v, z = self.split(y)
        J = self.normals(q, (k, *closed))
        response = np.linalg.solve(self.m.mass(q), J.T)
        A = J @ response
        target = -(1.0 + self.m.contacts[k].restitution) * approach
        # Eliminate the impulse of the stop that is struck, whose rate is given.
        direct = target / A[0, 0]
        reduced = A[1:, 1:] - np.outer(A[1:, 0], A[0, 1:]) / A[0, 0]
        impulses = complementary(reduced, A[1:, 0] * direct)
        first = direct - float(A[0, 1:] @ impulses) / A[0, 0]
        if first < 0.0:
            raise ArithmeticError("The stop that is struck pulls.")
        v = v + response @ np.array([first, *impulses])
        stay = tuple(s for s, p in zip(closed, impulses, strict=True) if p > 0.0)
        return np.concatenate([q, v, z]), stay

    def branch_of(self, t: float, y: Array) -> tuple[bool, ...]:
        return tuple(kink(t, *self.split(y)) > 0.0 for kink in self.m.kinks)

    def settled(
        self,
        t: float,
        y: Array,
        closed: tuple[int, ...],
        guess: tuple[bool, ...],
        fixed: int | None = None,
    ) -> tuple[bool, ...]:
        """Return the branches of the next arc: those at their kink are read a moment later."""
        found = list(guess)
        for j, kink in enumerate(self.m.kinks):
            if j == fixed:
                continue
            value = kink(t, *self.split(y))
            if abs(value) < 1e-11:
                later = self.advance(t, y, t + _AHEAD, closed, tuple(found))
                value = kink(t + _AHEAD, *self.split(later))
                if abs(value) < 1e-13:
                    continue
            found[j] = value > 0.0
        return tuple(found)

    def advance(
        self,
        t: float,
        y: Array,
        end: float,
        closed: tuple[int, ...],
        branches: tuple[bool, ...],
    ) -> Array:
        """Return the state at a later or earlier time, without events."""
        if end == t:
            return y
        solver = self.solver(t, y, end, closed, branches, abs(end - t))
        while solver.status == "running":
            solver.step()
        return solver.y

    def solver(
        self,
        t: float,
        y: Array,
        end: float,
        closed: tuple[int, ...],
        branches: tuple[bool, ...],
        first: float,
    ) -> Any:
        absolute = np.full(len(y), 0.01 * self.accuracy.tolerance)
        if len(y) > self.size:
            absolute[-2:] *= min(1.0, self.speed**2), min(1.0, self.speed)
        return DOP853(
            lambda s, x: self.flow(s, x, closed, branches)[0],
            t,
            y,
            end,
            rtol=self.accuracy.tolerance,
            atol=absolute,
            max_step=self.m.scale,
            first_step=min(first, abs(end - t), self.m.scale),
        )


def corner_impacts(gaps: Array, rates: Array, matrix: Array, e: Array) -> tuple[list[Any], Array]:
    """Return the impacts in a corner, each with its time and stop, and the last gap rates.

    The impacts come within so short a time that no force changes a velocity: gaps are linear. They
    end once no stop is approached, or after a thousand impacts.
    """
    h, w, time = gaps.copy(), rates.copy(), 0.0
    found: list[Any] = []
    while np.any(w < 0.0) and len(found) < _MOST_IN_CORNER:
        ways = [-one / rate if rate < 0.0 else math.inf for one, rate in zip(h, w, strict=True)]
        k = int(np.argmin(ways))
        h, time = h + w * ways[k], time + ways[k]
        h[k] = 0.0
        w = w - (1.0 + e[k]) * w[k] * matrix[:, k] / matrix[k, k]
        found.append((time, k))
    return found, w


def parts(gaps: Array, rates: Array, matrix: Array, e: Array) -> bool:
    """Test whether impacts in a corner end with all stops left at a clear speed, soon enough."""
    found, last = corner_impacts(gaps, rates, matrix, e)
    soon = not found or found[-1][0] < _SOON
    return bool(np.min(last) > _CLEAR and soon)


def simulated(
    machine: Machine,
    state: Sequence[float],
    until: float,
    *,
    closed: Sequence[str] = (),
    accuracy: Accuracy | None = None,
) -> Run:
    """Return an execution from a state at time 0.

    Args:
        machine: The machine.
        state: Coordinates, velocities and further states.
        until: End time.
        closed: Names of the stops at zero gap and rate at the start.
        accuracy: Of the steps.
    """
    run = Run(end_state=np.array(state, dtype=float))
    walk = _Walk(machine, accuracy or Accuracy(), run, until)
    try:
        walk.start(run.end_state, closed)
        while walk.t < until:
            walk.arc()
    except Refused as refused:
        run.refused = refused
    except Unsure as unsure:
        run.unsure = unsure
    run.end_time, run.end_state = walk.t, walk.y
    return run


class _Walk(_Loop):
    """The state of an execution between two events."""

    def __init__(self, machine: Machine, accuracy: Accuracy, run: Run, until: float) -> None:
        super().__init__(machine, accuracy, len(run.end_state))
        self.run, self.until = run, until
        self.t, self.y = 0.0, np.empty(0)
        self.closed: tuple[int, ...] = ()
        self.branches: tuple[bool, ...] = ()
        self.touching: set[int] = set()
        self.just: tuple[str, int] | None = None
        self.fired: tuple[float, int] | None = None
        self.first = 1e-3
        self.approach = math.nan
        self.sequence: list[tuple[float, float, Array]] = []
        self.sequence_mode: tuple[Any, ...] = ()
        self.flips: set[int] = set()
        self.slow: dict[int, float] = {}

    def start(self, y: Array, closed: Sequence[str]) -> None:
        self.y = y
        at = [k for k, c in enumerate(self.m.contacts) if c.name in closed]
        self.branches = self.settled(0.0, y, (), self.branch_of(0.0, y))
        self.closed = self.holding(0.0, y, tuple(at), self.branches)
        touched = [abs(c.gap(self.split(y)[0])) < 1e-12 for c in self.m.contacts]
        self.touching = {k for k, yes in enumerate(touched) if yes and k not in self.closed}

    # Guards: (what, index, sign). Every guard is positive inside its mode.
    def guards(self) -> list[tuple[str, int, float]]:
        found = [("gap", k, 1.0) for k in range(len(self.m.contacts)) if k not in self.closed] + [
            ("force", k, 1.0) for k in self.closed
        ]
        found += [("kink", j, 1.0 if b else -1.0) for j, b in enumerate(self.branches)]
        return found + [("switch", j, 1.0) for j in range(len(self.m.resets))]

    def values(self, guards: list[tuple[str, int, float]], t: float, y: Array) -> Array:
        q, v, z = self.split(y)
        forces: Array = np.empty(0)
        if self.closed:
            forces = self.flow(t, y, self.closed, self.branches)[1]
        out = np.empty(len(guards))
        for i, (what, k, sign) in enumerate(guards):
            if what == "gap":
                watched = len(y) > self.size and k == self.watched
                out[i] = y[-2] if watched else self.m.contacts[k].gap(q)
            elif what == "force":
                out[i] = forces[self.closed.index(k)]
            elif what == "kink":
                out[i] = sign * self.m.kinks[k](t, q, v, z)
            else:
                out[i] = self.m.resets[k].guard(t, q, v, z)
        return out

    def arc(self) -> None:
        """Follow a mode to its next event and apply it."""
        guards = self.guards()
        y0 = self.y
        if self.watched is not None:
            y0 = np.concatenate([y0, [0.0, self.speed]])
        start = self.values(guards, self.t, y0)
        offset = np.zeros(len(guards))
        armed = np.ones(len(guards), dtype=bool)
        for i, (what, k, _) in enumerate(guards):
            at_zero = abs(start[i]) < 1e-11
            if what == "gap" and k in self.touching:
                offset[i], armed[i] = start[i], False
            elif what == "gap" and start[i] < 1e-13 and self.gap_rate(k, self.y) < 0.0:
                raise Refused("SimultaneousEventsError", self.t, "impacts in a corner")
            elif what == "switch" and at_zero and self.fired != (self.t, k) and self.falls(k):
                self.switch(k)
                return
            elif self.just == (what, k) or (what in ("switch", "kink") and at_zero):
                armed[i] = False
                offset[i] = start[i] if what == "kink" and self.just == (what, k) else 0.0
            elif (what == "switch" and start[i] < 0.0) or (what == "force" and start[i] < 1e-10):
                armed[i] = False
        solver = self.solver(self.t, y0, self.until, self.closed, self.branches, self.first)
        before = start - offset
        time = self.t
        while solver.status == "running":
            t0, y0 = solver.t, solver.y.copy()
            solver.step()
            if solver.status == "failed" or not np.all(np.isfinite(solver.y)):
                raise Unsure("the steps fail", t0)
            dense = solver.dense_output()
            ends = np.linspace(t0, solver.t, _LOOKS + 1)[1:]

            def value(i: int, s: float, dense: Any = dense) -> float:
                return float(self.values(guards, s, dense(s))[i] - offset[i])

            table = [before]
            times = [time]
            for end in ends:
                now = self.values(guards, end, dense(end)) - offset
                hits: list[tuple[float, int]] = []
                for i, (what, _, _) in enumerate(guards):
                    if not armed[i]:
                        if now[i] > (0.0 if guards[i][:2] == ("gap", self.watched) else _ARMED):
                            armed[i] = True
                        elif now[i] < -1e-8 and what != "switch":
                            raise Unsure(f"a guard {guards[i]} starts below zero", end)
                        continue
                    if before[i] > 0.0 >= now[i]:
                        root = brentq(lambda s, i=i: value(i, s), time, end, xtol=1e-15)
                        hits.append((float(root), i))
                    elif len(table) > 1 and 0.0 < before[i] < min(now[i], table[-2][i]):
                        low = minimize_scalar(
                            lambda s, i=i: value(i, s),
                            bounds=(times[-2], end),
                            method="bounded",
                            options={"xatol": 1e-10},
                        )
                        if low.fun < _GRAZE and low.fun > -_GRAZE:
                            raise Unsure("a guard grazes its zero", float(low.x))
                        if low.fun <= 0.0:
                            root = brentq(
                                lambda s, i=i: value(i, s), times[-2], float(low.x), xtol=1e-15
                            )
                            hits.append((float(root), i))
                hits = [hit for hit in hits if not self.passed(guards[hit[1]], hit[0], dense)]
                if hits:
                    self.happen(guards, offset, sorted(hits), t0, y0)
                    return
                for i, (what, _, _) in enumerate(guards):
                    if what == "switch" and now[i] <= 0.0:
                        armed[i] = False
                table.append(now)
                times.append(end)
                before, time = now, end
        self.t, self.y = self.until, solver.y[: self.size]

    def falls(self, k: int) -> bool:
        """Test whether a switch is armed, and its guard, which is zero here, falls."""
        reset, rate = self.m.resets[k], self.flow(self.t, self.y, self.closed, self.branches)[0]
        ahead, behind = (
            reset.guard(self.t + d, *self.split(self.y + d * rate)) for d in (1e-6, -1e-6)
        )
        if abs(ahead - behind) < 1e-12:
            raise Unsure("a guard neither falls nor rises", self.t)
        return ahead < behind and reset.armed(self.t, *self.split(self.y)) > 0.0

    def passed(self, guard: tuple[str, int, float], t: float, dense: Any) -> bool:
        """Test whether a guard fell through zero without being armed."""
        what, k, _ = guard
        if what != "switch":
            return False
        armed = self.m.resets[k].armed(t, *self.split(dense(t)))
        if abs(armed) < _GRAZE:
            raise Unsure("a switch is armed as its guard falls", t)
        return armed < 0.0

    def happen(
        self,
        guards: list[tuple[str, int, float]],
        offset: Array,
        hits: list[tuple[float, int]],
        t0: float,
        y0: Array,
    ) -> None:
        """Refine the first of some roots and apply its event."""
        refined: list[tuple[float, int, Array]] = []
        for root, i in hits:
            t, width = root, 1e-7
            y = self.advance(t0, y0, t, self.closed, self.branches)
            for _ in range(3):
                here = self.values(guards, t, y)[i] - offset[i]
                rate = self.flow(t, y, self.closed, self.branches)[0]
                ahead = self.values(guards, t + width, y + width * rate)[i]
                behind = self.values(guards, t - width, y - width * rate)[i]
                slope = (ahead - behind) / (2 * width)
                if slope >= 0.0 or abs(here / slope) > 1e-3 * self.m.scale:
                    break
                t -= here / slope
                y = self.advance(t0, y0, t, self.closed, self.branches)
            refined.append((t, i, y))
        refined.sort(key=lambda one: one[0])
        together = [one for one in refined if one[0] - refined[0][0] < _TOGETHER]
        struck = [one for one in together if guards[one[1]][0] == "gap"]
        is_alone = len(struck) == 1 and all(
            guards[one[1]][0] == "kink" for one in together if one is not struck[0]
        )
        # The side of a kink on a stop is read after the impact.
        t, i, y = struck[0] if is_alone else refined[0]
        self.t, self.y = t, y[: self.size]
        self.approach = y[-1] if guards[i][:2] == ("gap", self.watched) else math.nan
        self.watched = None
        if len(together) > 1 and not is_alone:
            raise Refused("SimultaneousEventsError", t, f"{guards[i]} {guards[together[1][1]]}")
        what, k, _ = guards[i]
        {"gap": self.impact, "force": self.release, "kink": self.kink, "switch": self.switch}[what](
            k
        )

    def names(self) -> tuple[str, ...]:
        return tuple(self.m.contacts[k].name for k in sorted(self.closed))

    def note(
        self, kind: str, name: str, before: Array, *, rate: float = math.nan, forced: bool = False
    ) -> None:
        self.run.events.append(
            Event(
                kind=kind,
                name=name,
                time=self.t,
                before=before,
                after=self.y.copy(),
                rate=rate,
                closed=self.names(),
                forced=forced,
            )
        )

    def after_event(
        self,
        touching: Sequence[int],
        *,
        flying: Sequence[int] = (),
        just: tuple[str, int] | None = None,
        speed: tuple[int, float] | None = None,
    ) -> None:
        """Choose the next mode.

        Args:
            touching: Stops at zero gap and zero gap rate.
            flying: Stops that open with a speed.
            just: Guard that is at its zero and must not fire again.
            speed: Stop that was struck, and its gap rate.
        """
        was = self.closed
        fixed = just[1] if just and just[0] == "kink" else None
        guess = list(self.branch_of(self.t, self.y))
        if fixed is not None:
            guess[fixed] = self.branches[fixed]
        held = self.holding(self.t, self.y, tuple(sorted(touching)), tuple(guess))
        for _ in range(3):
            branches = self.settled(self.t, self.y, held, tuple(guess), fixed)
            again = self.holding(self.t, self.y, tuple(sorted(touching)), branches)
            guess = list(branches)
            if again == held:
                break
            held = again
        for j in range(len(self.m.kinks)):
            if held and j != fixed and self.stuck(j, held, tuple(guess)):
                raise Refused("SlidingError", self.t, "in contact")
        self.branches, self.closed = tuple(guess), held
        self.touching = (set(touching) | set(flying)) - set(held)
        for k in sorted(set(was) - set(held)):
            self.note("release", self.m.contacts[k].name, self.y.copy(), forced=True)
        self.just = just
        lifts = self.flow(self.t, self.y, self.closed, self.branches)[2]
        self.first = 1e-3
        if speed is not None:
            self.watched, self.speed = speed
        for k in self.touching:
            w = self.speed if k == self.watched else self.gap_rate(k, self.y)
            if k in flying and lifts[k] < 0.0:
                self.first = min(self.first, 0.2 * w / abs(lifts[k]))

    def stuck(self, j: int, closed: tuple[int, ...], branches: tuple[bool, ...]) -> bool:
        """Test whether contact holds a discontinuous formula at its kink, as dry friction."""
        if abs(self.m.kinks[j](self.t, *self.split(self.y))) > 1e-9:
            return False
        rate = self.flow(self.t, self.y, closed, branches)[0]
        later = self.m.kinks[j](self.t + 1e-3, *self.split(self.y + 1e-3 * rate))
        if abs(later) > 1e-9:
            return False
        other = tuple(b != (i == j) for i, b in enumerate(branches))
        jump = self.flow(self.t, self.y, (), other)[0] - self.flow(self.t, self.y, (), branches)[0]
        return bool(np.max(np.abs(jump)) > 1e-6)

    def release(self, k: int) -> None:
        name = self.m.contacts[k].name
        self.closed = tuple(s for s in self.closed if s != k)
        self.note("release", name, self.y.copy())
        self.sequence = []
        held = self.closed
        self.after_event(held)
        self.touching.add(k)

    def kink(self, j: int) -> None:
        old = self.branches
        new = tuple(b != (i == j) for i, b in enumerate(old))
        condition, sign = self.m.kinks[j], 1.0 if old[j] else -1.0
        held = self.holding(self.t, self.y, self.closed, new)
        rate = self.flow(self.t, self.y, held, new)[0]
        ahead, behind = (
            sign * condition(self.t + d, *self.split(self.y + d * rate)) for d in (1e-6, -1e-6)
        )
        slope = (ahead - behind) / 2e-6
        if abs(slope) < 1e-6:
            raise Unsure("a kink is crossed tangentially", self.t)
        if slope > 0.0:
            raise Refused("SlidingError", self.t)
        self.branches = new
        self.flips.add(j)
        self.note("switch", "", self.y.copy())
        self.after_event(self.closed, just=("kink", j))
        # Flips within a flight that repeat do not end a sequence of impacts.

    def switch(self, j: int) -> None:
        before = self.y.copy()
        reset = self.m.resets[j]
        self.fired = self.t, j
        recent = [e.time for e in self.run.events if e.kind == "switch" and e.name == reset.name]
        if len(recent) > 1:
            last, before_last = self.t - recent[-1], recent[-1] - recent[-2]
            if last < min(_ACCUMULATED, 0.7 * before_last):
                raise Refused("ChatterError", self.t)
        q, v, z = reset.after(self.t, *self.split(self.y))
        self.y = np.concatenate([q, v, z])
        touching: list[int] = []
        flying: list[int] = []
        struck: list[int] = []
        for k, contact in enumerate(self.m.contacts):
            gap, rate = contact.gap(q), self.gap_rate(k, self.y)
            small = 1e-9 if k in self.closed else 1e-12
            if gap < -1e-9:
                raise Refused("PenetrationError", self.t)
            if abs(gap) <= small and rate < -1e-9:
                struck.append(k)
            elif abs(gap) <= small:
                (touching if abs(rate) <= 1e-9 else flying).append(k)
        self.sequence = []
        index = len(self.run.events)
        self.after_event(touching, flying=flying, just=("switch", j))
        self.first = 1e-7
        releases = self.run.events[index:]
        del self.run.events[index:]
        self.note("switch", reset.name, before)
        # A stop that is struck by a plastic impact does not open.
        plastic = [self.m.contacts[k].name for k in struck if self.m.contacts[k].restitution == 0.0]
        self.run.events += [one for one in releases if one.name not in plastic]
        if len(struck) > 1:
            raise Refused("SimultaneousEventsError", self.t, "a reset strikes two stops")
        if struck:
            self.approach = math.nan
            self.impact(struck[0])

    def impact(self, k: int) -> None:
        before, contact = self.y.copy(), self.m.contacts[k]
        approach = self.gap_rate(k, self.y) if math.isnan(self.approach) else self.approach
        self.y, stay = self.struck(self.y, k, approach, self.closed)
        opened = tuple(s for s in self.closed if s not in stay)
        w = contact.restitution * -approach
        mode = (k, stay, self.branch_of(self.t, self.y), frozenset(self.flips))
        if opened or mode != self.sequence_mode:
            self.sequence = []
        self.sequence_mode = mode
        self.sequence.append((w, self.t, self.y.copy()))
        was = self.closed
        self.closed = stay
        self.note("impact", contact.name, before, rate=approach)
        index = len(self.run.events)
        for s in opened:
            self.note("release", self.m.contacts[s].name, self.y.copy(), forced=True)
        if contact.restitution == 0.0:
            self.closed = stay
            self.after_event((*stay, k), flying=opened)
            if k in self.closed:
                events = self.run.events[index:]
                del self.run.events[index:]
                self.note("zeno", contact.name, self.y.copy())
                self.run.events += events
            self.sequence = []
            return
        self.slow[k] = w
        self.refuse_two(k, w, was)
        self.after_event(stay, flying=(k, *opened), speed=(k, w))
        lift = self.flow(self.t, self.y, self.closed, self.branches)[2][k]
        if w < self.accuracy.slow and lift < 0.0:
            self.limit(k)
        elif w < _TOO_SLOW / 10:
            raise Unsure("a slow impact opens the stop", self.t)
        self.flips = set()

    def at_kink(self, j: int, y: Array) -> bool:
        """Test whether a condition is zero, as that of a velocity at rest."""
        return abs(self.m.kinks[j](self.t, *self.split(y))) < 1e-7

    def refuse_two(self, k: int, w: float, closed: tuple[int, ...]) -> None:
        """Refuse impacts that accumulate on two stops, at slow speeds or in a corner."""
        impacts = [event for event in self.run.events if event.kind == "impact"][-_CORNER:]
        if len(impacts) == _CORNER and self.t - impacts[0].time < 1e-8:
            if not self.closed and parts(*self.corner(impacts[0].time)):
                raise Unsure("impacts in a corner that part again", self.t)
            raise Refused("SimultaneousEventsError", self.t, "impacts in a corner")
        if w > 1e-4:
            return
        for s, contact in enumerate(self.m.contacts):
            near = abs(contact.gap(self.split(self.y)[0])) < 1e-6
            if s != k and near and s not in self.closed and self.slow.get(s, 1.0) < 1e-4:
                raise Refused("SimultaneousEventsError", self.t, "impacts on two stops")
            if s != k and s in closed and s not in self.closed:
                raise Refused("SimultaneousEventsError", self.t, "impacts lift a closed stop")

    def corner(self, since: float) -> tuple[Array, Array, Array, Array]:
        """Return gaps, rates, coupling and restitutions of the stops struck since a time."""
        names = {event.name for event in self.run.events if event.time >= since}
        struck = [k for k, contact in enumerate(self.m.contacts) if contact.name in names]
        q = self.split(self.y)[0]
        J = self.normals(q, struck)
        return (
            np.array([self.m.contacts[k].gap(q) for k in struck]),
            np.array([self.gap_rate(k, self.y) for k in struck]),
            J @ np.linalg.solve(self.m.mass(q), J.T),
            np.array([self.m.contacts[k].restitution for k in struck]),
        )

    def limit(self, k: int) -> None:
        """Extrapolate a sequence of impacts to its limit if there are enough of them."""
        chosen: list[tuple[float, float, Array]] = []
        for one in reversed(self.sequence):
            if not chosen or one[0] > 1.6 * chosen[-1][0]:
                chosen.append(one)
            if len(chosen) == _NODES:
                break
        slowest = chosen[0][0]
        if len(chosen) < 3:
            if slowest < _TOO_SLOW:
                raise Unsure("too few impacts before a limit", self.t)
            return
        table = [np.array([t, *y]) for _, t, y in chosen]
        speeds = [w for w, _, _ in chosen]
        best, error = table[0], math.inf
        for m in range(1, len(table)):
            table = [
                (speeds[i + m] * table[i] - speeds[i] * table[i + 1]) / (speeds[i + m] - speeds[i])
                for i in range(len(table) - 1)
            ]
            change = float(np.max(np.abs(table[0] - best)))
            best, error = (table[0], change) if change < error else (best, error)
            if change > error:
                break
        if error > 3e-12 and slowest > _TOO_SLOW:
            return
        if error > 1e-8:
            raise Unsure(f"a limit of impacts is known to {error:.1g}", self.t)
        time = float(best[0])
        if time > self.until:
            return
        flips = self.flips | {j for j in range(len(self.m.kinks)) if self.at_kink(j, best[1:])}
        guards = [
            g
            for g in self.guards()
            if g[:2] != ("gap", k) and not (g[0] == "kink" and g[1] in flips)
        ]
        now = self.values(guards, self.t, self.y)
        here = self.t, self.y, self.watched
        self.t, self.y, self.watched = time, best[1:], None
        then = self.values(guards, self.t, self.y)
        if np.any((now > 1e-9) & (then <= 0.0)):
            if slowest < _TOO_SLOW:
                raise Unsure("another event precedes a limit of impacts", self.t)
            self.t, self.y, self.watched = here
            return
        n = self.m.n
        q = self.y[:n]
        # The limit is on the stop at rest up to the error of the extrapolation.
        normal = self.m.contacts[k].normal(q)
        response = np.linalg.solve(self.m.mass(q), normal)
        rate = self.gap_rate(k, self.y)
        self.y = self.y.copy()
        self.y[n : 2 * n] -= response * rate / float(normal @ response)
        self.closed = (*self.closed, k)
        held = self.closed
        index = len(self.run.events)
        before = self.y.copy()
        self.after_event(held)
        events = self.run.events[index:]
        del self.run.events[index:]
        self.note("zeno", self.m.contacts[k].name, before)
        self.run.events += events
        self.sequence = []
        self.slow.pop(k, None)
