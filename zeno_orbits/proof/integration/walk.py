"""Enclosure of one period from a set on the release section, record by record.

Steps are as long as their remainders allow. On each step, the motions are proved to touch the stop
only at the expected events.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum

from flint import arb

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ProofError
from zeno_orbits.proof.arithmetic.balls import ZERO, Ball, Matrix, product
from zeno_orbits.proof.arithmetic.recurrences import Series
from zeno_orbits.proof.integration.ball_system import BallSystem, SectionKind, require_proved
from zeno_orbits.proof.integration.events import (
    Meeting,
    cross,
    is_clear,
    meeting_guess,
    settle_impacts,
    strike,
    switch_guess,
    switch_reason,
)
from zeno_orbits.proof.integration.flow import BallFlow, FlowStep, enclose
from zeno_orbits.proof.integration.machine import BallMachine
from zeno_orbits.proof.integration.sets import (
    BallTime,
    Departure,
    ProofRecord,
    ProofStage,
    balanced,
)
from zeno_orbits.proof.integration.switches import pass_switch, require_before

_EVERY = 500
"""Number of steps after which the number that a period needs is estimated."""
_NEAR = 1e-3
"""Gap rate, in its unit, below which flights are short and their rows must keep their precision."""
_LAST = 1e-12
"""Gap rate, relative to the fastest impact, below which a failed Zeno tail ends a proof."""
_SHORTEST = 1e-5
"""Smallest step in flight and in contact, as a part of the longest step."""
_JUST_BEYOND = 1 + 2.0**-6
_BEYOND = 1 + 2.0**-3
"""Length of the step of a crossing, as a multiple of the time of the crossing."""
_FARTHER = (1.25, 1.5, 2.0)
"""The same multiples for sets that are too wide for a shorter step, in the order of the trials."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkSettings:
    """Settings of the enclosure of a period, step by step.

    Attributes:
        orders: Orders of Taylor's method for a point, and for the derivative.
        rest: Largest remainder of a step for a point, relative to the size of each state.
        derivative_rest: Largest remainder of a step for the derivative, in units in which the flow
            is balanced.
        first: First trial step, relative to the period.
        longest: Longest step, relative to the period.
        slow: Gap rate below which the Zeno tail replaces the remaining impacts if a flight cannot
            be resolved, relative to the fastest impact.
        slowest: Gap rate below which the Zeno tail always replaces the remaining impacts, relative
            to the fastest impact.
        most_impacts: Largest number of impacts in a flight phase.
        most_steps: Largest number of steps in a period.
    """

    orders: tuple[int, int] = (34, 28)
    rest: float = 1e-21
    derivative_rest: float = 3e-13
    first: float = 1e-3
    longest: float = 0.125
    slow: float = 1e-2
    slowest: float = 1e-19
    most_impacts: int = 5000
    most_steps: int = 12_000


class PassageKind(Enum):
    """Kind of an event in a period."""

    IMPACT = "impact"
    ZENO_POINT = "zeno_point"
    RELEASE = "release"
    SWITCH = "switch"


@dataclass(frozen=True, slots=True, kw_only=True)
class PassageEvent:
    """An event in a period.

    Attributes:
        kind: Kind of the event. A plastic impact that starts contact is an impact and a Zeno point.
        stage: The set at the event, or just before it for an impact.
        name: Name of the stop or of the switch.
        plastic: True for a plastic impact that starts contact.
        opens: Name of the stop that opens at a switch, or an empty text.
    """

    kind: PassageKind
    stage: ProofStage
    name: str
    plastic: bool = False
    opens: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofPassage:
    """The enclosure of one period of a set.

    Attributes:
        records: Inclusions from set to set.
        events: Impacts that were resolved one by one, Zeno points and releases, in order.
        end: The set at the end.
    """

    records: tuple[ProofRecord, ...]
    events: tuple[PassageEvent, ...]
    end: ProofStage

    @property
    def impact_times(self) -> tuple[BallTime, ...]:
        """Times of the individually resolved impacts."""
        return self._times(PassageKind.IMPACT)

    @property
    def zeno_times(self) -> tuple[BallTime, ...]:
        """Times of the Zeno points, or of plastic impacts that start contact."""
        return self._times(PassageKind.ZENO_POINT)

    @property
    def told(self) -> tuple[str, ...]:
        """The events in order, in words.

        Impacts on a stop just before its Zeno point belong to it. Impacts on other stops are
        listed.
        """
        words = list[str]()
        for event in self.events:
            if event.kind is PassageKind.IMPACT:
                words.append(f"impact on {event.name}")
            elif event.kind is PassageKind.ZENO_POINT:
                while words and words[-1] == f"impact on {event.name}":
                    words.pop()
                words.append(self._held(event))
            elif event.kind is PassageKind.SWITCH:
                release = f" with release of {event.opens}" if event.opens else ""
                words.append(f"switch {event.name}{release}")
            else:
                words.append(f"release of {event.name}")
        return tuple(words)

    @staticmethod
    def _held(event: PassageEvent) -> str:
        what = "plastic impact on" if event.plastic else "Zeno point of"
        return f"{what} {event.name}"

    @property
    def period(self) -> BallTime:
        """Time of the return to the section."""
        return self.end.time

    def _times(self, kind: PassageKind) -> tuple[BallTime, ...]:
        return tuple(one.stage.time for one in self.events if one.kind is kind)


@dataclass(slots=True, kw_only=True)
class _Pace:
    """Length of the next step, from the remainders of the last step."""

    size: float
    most: float


Tell = Callable[[str, float], None]


def walk(
    machine: BallMachine, start: ProofStage, count: int, settings: WalkSettings, tell: Tell
) -> ProofPassage:
    """Enclose one period from a set.

    Args:
        machine: The problem.
        start: The set on the section.
        count: Number of releases of the section's stop in the period, of impacts on it if the
            period starts just after an impact, or of passages of the switch before which it starts.
        settings: Settings of the enclosure.
        tell: Called with the stage and the time reached [s].

    Raises:
        ProofError: If a condition is not proved. The error names the claim.
    """
    way = _Way(machine=machine, settings=settings, tell=tell, stage=start, count=count)
    if machine.section.kind is SectionKind.SWITCH:
        require_before(machine, start, machine.section.switch)
        way.switch(machine.section.switch)
    while way.n_returns < count:
        try:
            way.follow()
        except ProofError as error:
            # If a flight cannot be resolved, a Zeno tail from the last impact may still succeed.
            try:
                summed = way.sum_up()
            except ProofError:
                summed = False
            if not summed:
                raise error from None
    ended = way.stage.view, way.stage.departure is Departure.LOCKED
    returned = ended == (start.view, start.departure is Departure.LOCKED)
    require_proved(returned, "shape", "the motion returns to its section in another mode")
    return ProofPassage(
        records=tuple(way.records),
        events=tuple(way.events),
        end=way.stage,
    )


class _Way:
    """A set within its period, with the records that led to it."""

    def __init__(
        self,
        *,
        machine: BallMachine,
        settings: WalkSettings,
        tell: Tell,
        stage: ProofStage,
        count: int,
    ) -> None:
        self.records: list[ProofRecord] = []
        self.events: list[PassageEvent] = []
        self.n_returns, self._count = 0, count
        self.stage = stage
        self._n_impacts = 0
        self._machine, self._settings, self._tell = machine, settings, tell
        self._section = stage.stop
        period = self._system.period
        self._pace = _Pace(size=settings.first * period, most=settings.longest * period)
        self._fastest = ZERO
        self._slow: tuple[ProofStage, int, int] | None = None

    @property
    def _system(self) -> BallSystem:
        return self._machine.view(*self.stage.view)

    @property
    def _on_section(self) -> bool:
        return self.stage.stop == self._section

    def follow(self) -> None:
        """Propagate the set to its next event, and through the event."""
        least, met = self._pace.size * _SHORTEST, None
        while met is None:
            record, self.stage, met = _move(
                self._machine, self.stage, self._pace, self._settings, least
            )
            self.records.append(record)
            now = float(self.stage.time.middle.mid())
            self._tell(self.stage.departure.value, now)
            self._require_few(now)
        if met.kind == "switch":
            self.n_returns += met.number == self._machine.section.switch
            if self.n_returns < self._count:
                self.switch(met.number)
        elif met.kind == "release":
            self._note(PassageKind.RELEASE)
            at_release = self._machine.section.kind is SectionKind.RELEASE
            self.n_returns += self._on_section and at_release
        else:
            self._strike()

    def _require_few(self, now: float) -> None:
        """Raise an error if the steps are so short that a period would need too many of them."""
        count, most = len(self.records), self._settings.most_steps
        if count % _EVERY == 0 and now > 0.0:
            needed = count * self._system.period / now
            size = f"steps of {now / count:.1e} s are needed"
            reason = f"{size}, about {needed:.0f} in a period, but {most} are the most"
            if needed > most:
                raise ProofError("steps", reason)

    def switch(self, switch: int) -> None:
        """Pass a switch: the reset of a declared switch, and the sides of the kinks.

        Args:
            switch: Index of the switch.
        """
        record, after = pass_switch(self._machine, self.stage, switch)
        opens = self.stage.departure is Departure.LOCKED and after.departure is not Departure.LOCKED
        name, stop = self._machine.switch_names[switch], self._machine.stop_names[self.stage.stop]
        self._note(PassageKind.SWITCH, name, opens=stop if opens else "")
        self.records.append(record)
        # A tail replaces impacts only up to the next event of another kind.
        self.stage, self._slow = after, None
        self._pace.size = self._settings.first * self._system.period

    def _strike(self) -> None:
        settings, rate = self._settings, self._system.rate
        self._note(PassageKind.IMPACT)
        self._n_impacts += 1
        self.n_returns += self._on_section and self._system.struck
        self._fastest = self._fastest.max(self.stage.at.box[rate].abs_upper())
        record, stage = strike(self._system, self.stage)
        sides = self._machine.sides_at(stage.stop, stage.sides, stage.at.box)
        if self._machine.is_graph:
            record = replace(record, fields={"sides": [int(side) for side in sides]})
        self.stage = replace(stage, sides=sides)
        self.records.append(record)
        if self.stage.departure is Departure.STRUCK and not self._system.struck:
            speed = self.stage.at.box[rate]
            # A tail needs a positive speed, which the last impacts of a wide set do not show.
            if bool(speed < settings.slow * self._fastest) and is_clear(speed):
                self._slow = self.stage, len(self.records), len(self.events)
            if bool(speed < settings.slowest * self._fastest) and self._sum_up_early():
                return
        if self.stage.departure is Departure.LOCKED:
            self._hold()
        elif self._n_impacts > settings.most_impacts:
            count = self._n_impacts
            raise ProofError("zeno_point", f"impacts do not accumulate in {count} of them")

    def _sum_up_early(self) -> bool:
        """Try a Zeno tail from the last impact. Faster impacts may still be too fast for it."""
        slow = self._slow
        try:
            return self.sum_up()
        except ProofError:
            if bool(self.stage.at.box[self._system.rate] < _LAST * self._fastest):
                raise
            self._slow = slow
            return False

    def sum_up(self) -> bool:
        """Replace all impacts after a slow last impact by a Zeno tail. Return True on success."""
        if self._slow is None:
            return False
        (stage, n_records, n_events), self._slow = self._slow, None
        closed = [self._machine.view(*stage.seen(k)) for k in stage.closed]
        record, self.stage = settle_impacts(self._machine.view(*stage.view), stage, closed)
        self.records[n_records:], self.events[n_events:] = [record], []
        self._hold()
        return True

    def _hold(self) -> None:
        self._note(PassageKind.ZENO_POINT, plastic=self._system.plastic)
        self._pace.size = self._settings.first * self._system.period

    def _note(
        self, kind: PassageKind, name: str = "", *, plastic: bool = False, opens: str = ""
    ) -> None:
        name = name or self._machine.stop_names[self.stage.stop]
        event = PassageEvent(kind=kind, stage=self.stage, name=name, plastic=plastic, opens=opens)
        self.events.append(event)


def _contacts(machine: BallMachine, stage: ProofStage) -> Iterator[tuple[BallSystem, Departure]]:
    """Yield for each stop its system, and the mode and position of a set relative to it."""
    for k in range(len(machine.stop_names)):
        if k in stage.closed:
            yield machine.view(*stage.seen(k)), Departure.LOCKED
        else:
            departure = stage.departure if k == stage.stop else Departure.FLYING
            yield machine.view(k, stage.sides), departure


def _met_first(
    machine: BallMachine, stage: ProofStage, points: list[Series], within: float
) -> tuple[float | None, Meeting]:
    """Return an approximate time of the first event of the middle of a set, and the event."""
    found: list[tuple[float, Meeting]] = []
    for k, (view, departure) in enumerate(_contacts(machine, stage)):
        time = meeting_guess(view, departure, points, within)
        if time is not None:
            found.append((time, Meeting("release" if k in stage.closed else "stop", k)))
    switch = switch_guess(machine.view(*stage.view), stage, points, within)
    found += [switch] if switch else []
    return min(found, default=(None, Meeting("", 0)))


def _step_reason(
    machine: BallMachine,
    stage: ProofStage,
    box: Sequence[Ball],
    end: Sequence[Ball],
    met: Meeting | None,
) -> str:
    """Return the condition on events that is not proved on a step, or an empty text.

    Args:
        machine: The problem.
        stage: The set at the start of the step.
        box: Box that contains all motions over the step.
        end: States at the end of the step.
        met: The event that ends the step, if there is one.
    """
    system, start = machine.view(*stage.view), stage.at.box
    flow = system.locked if stage.departure is Departure.LOCKED else system.free
    for k, (view, departure) in enumerate(_contacts(machine, stage)):
        ends = met is not None and met.kind != "switch" and met.number == k
        reason = contact_reason(view, flow, departure, start, box, None if ends else end[view.gap])
        if reason:
            return reason
    reason = switch_reason(system, stage, box, end, met)
    return reason or system.undefined(box) or system.light(box)


def _move(
    machine: BallMachine,
    stage: ProofStage,
    pace: _Pace,
    settings: WalkSettings,
    least: float,
) -> tuple[ProofRecord, ProofStage, Meeting | None]:
    """Return a record (step or crossing), the stage after it, and the event of a crossing."""
    system = machine.view(*stage.view)
    locked = stage.departure is Departure.LOCKED
    flow = system.locked if locked else system.free
    size, orders = min(pace.size, pace.most), settings.orders
    points = flow.point_series(stage.at.m, orders[0])
    guess, met = _met_first(machine, stage, points, 1.5 * size)
    if guess is not None:
        size = _aimed(guess, size)
        orders = _orders(size, pace.size, settings, flow.n)
        least = min(least, guess / 64)
    shortened = guess is not None
    over = flow.series(stage.at.box, orders[1])
    stage = replace(stage, metric=balanced(over.derivative[1]))
    reason, later = "no box holds the motions over a step", list(_FARTHER)
    while size >= least:
        exact = _dyadic(size)
        meets = guess is not None and guess < float(exact)
        step = enclose(flow, over, exact, orders)
        if step is None:
            size = size / 2
            continue
        excess = excess_of(step, stage.metric, settings.rest, settings.derivative_rest)
        if excess > 1.0 and size > least and len(later) == len(_FARTHER):
            size = max(least, size * max(0.25, 0.9 * excess ** (-1 / (orders[1] + 1))))
            continue
        image, derivative = step.point(points, exact), step.derivative(exact)
        end = [a + b for a, b in zip(image, product(derivative, stage.at.deviation), strict=True)]
        reason = _step_reason(machine, stage, step.box, end, met if meets else None)
        if reason:
            shortened = True
            if meets and guess is not None:
                size = guess / 2
                continue
            # A guard that is below zero only briefly is detected only by a sufficiently fine
            # search.
            dip, touched = _met_first(machine, stage, points, size)
            if dip is None or (guess is not None and dip >= guess):
                size = size / 2
                continue
            # Only the first guess may lower the smallest step, so that the search ends.
            least = least if guess is not None else min(least, dip / 64)
            guess, met, size = dip, touched, _aimed(dip, size)
            continue
        if meets and guess is not None:
            view = stage.view if met.kind == "switch" else stage.seen(met.number)
            try:
                record, after = cross(machine.view(*view), stage, step, points, arb(guess), met)
            except ProofError:
                # The motions of a wide set cross at times that differ more than a step exceeds one.
                if not later:
                    raise
                size = guess * later.pop(0)
                continue
            return record, replace(after, stop=view[0], held=view[2]), met
        if not shortened:
            pace.size = size * max(0.5, min(4.0, 0.9 * excess ** (-1 / (orders[1] + 1))))
        return (*_stepped(system, stage, exact, orders, image, derivative), None)
    raise ProofError(_CLAIMS[stage.departure], reason)


def _stepped(
    system: BallSystem,
    stage: ProofStage,
    size: Ball,
    orders: tuple[int, int],
    image: Sequence[Ball],
    derivative: Matrix,
) -> tuple[ProofRecord, ProofStage]:
    """Return the record of a step without an event, and the stage after it."""
    locked = stage.departure is Departure.LOCKED
    rows = system.turning_rows(None) if locked else system.moving_rows
    rate = stage.at.box[system.rate]
    near = bool(rate.abs_upper() < _NEAR)
    # After an opening the rate is no longer tiny, and an absent stop has none.
    near = near and (stage.departure is Departure.RELEASED or not rate.is_zero())
    result = stage.at.mapped(image, derivative, rows, stage.metric, fine=not locked and near)
    record = ProofRecord(kind="step", numbers={"h": size}, orders=orders, result=result)
    departure = Departure.LOCKED if locked else Departure.FLYING
    return record, stage.next(result, departure, stage.time.later(size))


def _aimed(guess: float, size: float) -> float:
    """Return the size of a step beyond a crossing, or half the time to it for too long a step."""
    return guess * _BEYOND if guess * _JUST_BEYOND <= size else guess / 2


_CLAIMS = {
    Departure.FLYING: "flight",
    Departure.RELEASED: "leaves",
    Departure.STRUCK: "flight",
    Departure.OPENED: "leaves",
    Departure.LOCKED: "locked",
}
"""Name of the claim that a step contributes to."""


def _dyadic(size: float) -> Ball:
    """Return a number with few bits just below a size."""
    mantissa, exponent = math.frexp(size)
    return arb(math.ldexp(math.floor(mantissa * 4096), exponent - 12))


def excess_of(step: FlowStep, metric: Vector, rest: float, derivative_rest: float) -> float:
    """Return the largest remainder of a step as a multiple of the allowed remainder.

    Args:
        step: The step.
        metric: Units of the states in which the flow is balanced, ``(n,)``.
        rest: Allowed remainder for a point, relative to the size of each state.
        derivative_rest: Allowed remainder for the derivative, in these units.
    """
    order, order_v = step.orders
    far, near = step.size ** (order + 1), step.size ** (order_v + 1)
    worst = 1e-12
    for one, x in zip(step.rest, step.box, strict=True):
        allowed = rest * (1e-3 + float(x.abs_upper()))
        worst = max(worst, float((one * far).abs_upper()) / allowed)
    entries = step.derivative_rest.entries()
    n = len(metric)
    for k, one in enumerate(entries):
        allowed = derivative_rest * metric[k // n] / metric[k % n]
        worst = max(worst, float((one * near).abs_upper()) / allowed)
    return worst


def _orders(size: float, usual: float, settings: WalkSettings, n: int) -> tuple[int, int]:
    """Return the orders that are enough for a step that is shorter than the usual step.

    Orders are at least the number of states. The series must include dependences of a state that
    arise only through other states, since otherwise the box of the step is too small for them.
    """
    reach = 4.0 * size / usual

    def enough(allowed: float, most: int) -> int:
        for k in range(min(n, most), most):
            if reach**k / math.factorial(k + 1) < allowed * 1e-3:
                return k
        return most

    k = enough(settings.derivative_rest, settings.orders[1])
    return max(k, enough(settings.rest, settings.orders[0])), k


def contact_reason(
    system: BallSystem,
    flow: BallFlow,
    departure: Departure,
    start: Sequence[Ball],
    box: Sequence[Ball],
    end: Ball | None,
) -> str:
    """Return the contact condition that is not proved on a step, or an empty text.

    Args:
        system: The problem.
        flow: The flow of the mode.
        departure: Mode, and position relative to the stop, at the start of the step.
        start: Box of the states at the start.
        box: Box that contains all motions over the step.
        end: Gap at the end of the step, or None if the step must cross the guard.
    """
    if departure is Departure.LOCKED:
        multiplier, gradient, speeds = system.locked.guard(box)
        slope = sum((g * f for g, f in zip(gradient, speeds, strict=True)), ZERO)
        if end is None:
            holds, what = is_clear(-slope), f"to fall at the release ({slope})"
        else:
            if is_clear(-multiplier):
                return f"contact ends at once, since the contact force is negative ({multiplier})"
            holds, what = is_clear(multiplier), f"positive on the stop ({multiplier})"
        return "" if holds else f"the contact force is not proved {what}"
    if departure is Departure.RELEASED:
        jerk = _jerk(flow, box, system.rate)
        left = is_clear(jerk) and end is not None
        return "" if left else f"`d3h/dt3` is not proved positive at the release ({jerk})"
    if departure is Departure.OPENED:
        pull = flow.rate(box)[system.rate]
        left = is_clear(pull) and end is not None
        return "" if left else f"`gap_acceleration` is not proved positive after a switch ({pull})"
    gap, rate = box[system.gap], box[system.rate]
    struck = departure is Departure.STRUCK
    away = bool(start[system.rate if struck else system.gap] > 0)
    hump = away and is_clear(-flow.rate(box)[system.rate])
    if end is None:
        once = hump or (away and not struck and bool(rate < 0))
        return "" if once else "`gap` is not proved to fall once only before an impact"
    clear = bool(rate > 0) if struck else bool(gap > 0)
    over = hump and bool(end > 0)
    return "" if clear or over else "`gap` is not proved positive in flight"


def _jerk(flow: BallFlow, box: Sequence[Ball], rate: int) -> Ball:
    """Return the third derivative of the gap over a box."""
    return 2 * flow.point_series(box, 2)[rate][2]
