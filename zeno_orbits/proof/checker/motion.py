"""One record of a certificate: the image of a point and its neighbours, proved in balls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from zeno_orbits.proof.checker.balls import (
    Array,
    Ball,
    NotProved,
    around_zero,
    between,
    number,
    numbers,
    require,
)
from zeno_orbits.proof.checker.enclosure import Enclosure, Mapped
from zeno_orbits.proof.checker.formulas import CheckedView
from zeno_orbits.proof.checker.lanes import (
    LaneFlow,
    Lanes,
    coefficients,
    lanes_of,
    matmul,
    where,
)
from zeno_orbits.proof.checker.machine import (
    ONE_STOP,
    CertifiedMachine,
    require_known_switches,
    require_others_apart,
    require_sides,
)
from zeno_orbits.proof.checker.series import complex_values, interval, taylor, upper
from zeno_orbits.proof.checker.system import System

_SWEEPS = 4
"""Number of trials of an a-priori box."""


class RecordPosition(NamedTuple):
    """Position of a record in the motion.

    Attributes:
        mode: `free`, `locked`, or `closed` between a crossing and its impact.
        began: The event at the start of its phase, if the record is the first: a `release` or an
            `impact` of the stop, or `opened` by a switch after which the stop pulls.
        view: The stop that was met last, and the sides of the kinks.
        crossed: The switch that was crossed just before and whose guard is zero, or -1.
        met: Kind and index of the event of a crossing: a `stop`, a `switch` or a `release`.
        after: Stop and sides after the record.
    """

    mode: str
    began: str
    view: CheckedView = ONE_STOP
    crossed: int = -1
    met: tuple[str, int] = ("", -1)
    after: CheckedView = ONE_STOP

    @property
    def switch(self) -> int:
        """The switch of a crossing, or -1."""
        return self.met[1] if self.met[0] == "switch" else -1

    @property
    def contact(self) -> tuple[CheckedView, str]:
        """Stop and sides, and the mode."""
        return self.view, self.mode

    @property
    def meets(self) -> CheckedView:
        """Stop and sides of the system whose guard is met. Closed stops are held."""
        view, (kind, stop) = self.view, self.met
        if kind == "stop":
            held = view.stop if self.mode == "locked" else view.held
            return view._replace(stop=stop, held=held)
        if kind == "release" and self.mode == "locked":
            return view if stop == view.stop else view._replace(stop=stop, held=view.stop)
        return view._replace(stop=stop, held=-1) if kind == "release" else view


class Flow:
    """One step of Taylor's method from a set, with its a-priori box."""

    def __init__(self, old: Enclosure, h: Ball, point: Array, slope: Array, box: Array) -> None:
        """Store the results of `flows`.

        Args:
            old: The set.
            h: The step.
            point: Coefficients of the motion from its point, with remainder, ``(N, k + 1)``.
            slope: Coefficients of the derivative over the whole set, ``(N, N, k + 1)``.
            box: Box that contains all motions over the step.
        """
        self.old, self.h, self.box = old, h, box
        self._point, self._slope = point, slope

    def at(self, time: Ball) -> tuple[Array, Array, Array]:
        """Return point, derivative and box of the set at a time in the step."""
        part = time / self.h
        point, slope = (_horner(series, part) for series in (self._point, self._slope))
        return point, slope, point + self.old.moved(slope)


@np.errstate(all="ignore")  # Every inequality is false for overflow.
def flows(
    system: System,
    mode: str,
    orders: Sequence[int],
    olds: Sequence[Enclosure],
    steps: Array,
    *,
    whole: bool,
) -> list[Flow | str]:
    """Return steps of one mode and of the same orders, or the reason of a failure.

    All results except the motions of points are computed over many sets together, in hardware
    numbers. A candidate ``B`` contains all motions over a step if their Taylor sums over the set,
    with the remainder over ``B``, lie inside ``B``. The derivative is enclosed in the same way. Its
    remainder is the remainder of the flow from ``B`` times the box of the derivative.

    Args:
        system: The system of the certificate.
        mode: The mode.
        orders: Orders for a point and for the derivative.
        olds: The sets.
        steps: The steps.
        whole: True if only the ends of the steps are needed.
    """
    rates, (high, low) = system.flow[mode], orders
    flow, h = lane_flow(system, mode), lanes_of(steps)
    moving = np.array([node is not None for node in rates])
    sets = lanes_of([old.hull for old in olds])
    x, V = coefficients(flow, all_inputs(system, sets), h, low, low)
    found, reach, rest_V, _, over = held(system, mode, orders, x, V, h)
    made = list[Flow | str]()
    slopes = V.then(rest_V)
    for k, (old, step) in enumerate(zip(olds, steps, strict=True)):
        if not found[k]:
            made.append("an a-priori box is missing")
            continue
        slope = (slopes[:, k].total()[None] if whole else slopes[:, k]).balls(system.bits)
        slope[:, ~moving] = 0 * slope[:, ~moving]
        slope[0, ~moving] = system.identity[~moving]
        ends = over[k].balls(system.bits)
        ends[~moving] = system.nothing[~moving]
        point = taylor(system.graph, system.z, rates, system.at(old.m), step, high)
        series = np.concatenate([point, ends[:, None]], axis=1)
        made.append(Flow(old, step, series, np.moveaxis(slope, 0, -1), reach[k].balls(system.bits)))
    return made


def lane_flow(system: System, mode: str) -> LaneFlow:
    """Return the flow of a mode."""
    return LaneFlow(system.graph, system.z, system.flow[mode], system.slopes[mode])


def all_inputs(system: System, box: Lanes) -> dict[int, Lanes]:
    """Return all inputs over boxes of states, ``(L, N)``."""
    count = len(box.c)
    fixed = {k: lanes_of([ball] * count) for k, ball in system.constants.items()}
    return fixed | {place: box[:, k] for k, place in enumerate(system.z)}


class HeldBoxes(NamedTuple):
    """A-priori boxes of steps.

    Attributes:
        found: True for each step with a box.
        reach: All motions over the steps, ``(L, N)``.
        rest_slope: Remainders of the derivatives, ``(L, N, N)``.
        rest_x: Remainders of the motions at the order of the derivatives, ``(L, N)``.
        rest: Remainders of the motions of points, ``(L, N)``.
    """

    found: Any
    reach: Lanes
    rest_slope: Lanes
    rest_x: Lanes
    rest: Lanes


def held(
    system: System, mode: str, orders: Sequence[int], x: Lanes, V: Lanes, h: Lanes
) -> HeldBoxes:
    """Return a-priori boxes from the terms of the flow and of its derivative over sets.

    Args:
        system: The system of the certificate.
        mode: The mode.
        orders: Orders for a point and for the derivative.
        x: Terms of the states over the sets, ``(low + 1, L, N)``.
        V: Terms of the derivatives, ``(low + 1, L, N, N)``.
        h: The steps, ``(L,)``.
    """
    flow, (high, low) = lane_flow(system, mode), orders
    moving = np.array([node is not None for node in system.flow[mode]])
    reach, reach_V = x.hull(), V.hull()
    found = np.zeros(len(h.c), dtype=bool)
    box, box_V, rest_x, rest_V = reach, reach_V, reach, reach_V
    for _ in range(_SWEEPS):
        wide = moving & ~found[:, None]
        box = where(wide, reach.wider(), box)
        box_V = where(~found[:, None, None], reach_V.wider(), box_V)
        over, over_V = coefficients(flow, all_inputs(system, box), h, low + 1, low + 1)
        rest_x, rest_V = over[low + 1], matmul(over_V[low + 1], box_V)
        reach, reach_V = x.then(rest_x).hull(), V.then(rest_V).hull()
        inside = reach.inside(box) | ~moving
        found = inside.all(axis=1) & reach_V.inside(box_V)[:, moving].all(axis=(1, 2))
        if found.all():
            break
    over, _ = coefficients(flow, all_inputs(system, reach), h, 0, high + 1)
    return HeldBoxes(found, reach, rest_V, rest_x, over[high + 1])


def _horner(series: Array, part: Ball) -> Array:
    """Return the sum of all terms at a part of a step. Orders are on the last axis."""
    value = series[..., -1]
    for k in range(series.shape[-1] - 2, -1, -1):
        value = value * part + series[..., k]
    return value


def _require_events(system: System, place: RecordPosition, flow: Flow, end: Array) -> None:
    """Check that a step meets no stop and no switch, except that of its crossing."""
    system.require_defined(flow.box)
    boxes = flow.old.hull, flow.box, end
    besides = [system.gap_row]
    if place.met[0] == "stop" and not system.is_pinned:
        besides.append(system.n_x + 2 * place.met[1])
    require_others_apart(system, place.mode, boxes, besides)
    require_known_switches(system, place.mode, boxes, crossed=place.crossed, met=place.switch)


def stepped(machine: CertifiedMachine, place: RecordPosition, flow: Flow) -> Mapped:
    """Prove one whole step in one mode.

    Args:
        machine: The systems of the certificate.
        place: Position of the record in the motion.
        flow: The step.
    """
    system, (point, slope, box) = machine.systems[place.view], flow.at(flow.h)
    _require_events(system, place, flow, box)
    machine.require_pressure(place.view, place.mode, flow.box)
    if place.mode == "free":
        is_open = system.gap(box).low > 0
        require_apart(system, place, flow.old.hull, flow.box, is_open=is_open)
    return Mapped(point, slope, flow.h, system.nothing)


def crossed(
    machine: CertifiedMachine, place: RecordPosition, flow: Flow, record: Mapping[str, Any]
) -> Mapped:
    """Prove the crossing of the guard in a last step: the gap closes, or ``-a`` vanishes.

    With ``g`` the guard, the derivative is ``(1 - f grad g / (grad g . f)) D phi``.

    Args:
        machine: The systems of the certificate.
        place: Position of the record in the motion.
        flow: The step.
        record: Its entries.
    """
    system, met = machine.systems[place.view], machine.systems[place.meets]
    bits, strikes = system.bits, place.met[0] == "stop"
    end = flow.at(flow.h)[2]
    _require_events(system, place, flow, end)
    a, b = numbers(record["window"], (2,), bits)
    first, last = numbers(record["centre"], (2,), bits)
    require(0 <= a.m <= first.m <= last.m <= b.m <= flow.h.m, "the windows are not nested")
    for time, whole, sign in ((a, True, 1), (b, True, -1), (first, False, 1), (last, False, -1)):
        value = _guard(met, place, flow, time, whole=whole)
        if (value * sign).low <= 0:
            raise NotProved(f"the guard may vanish outside its window: {value.shown()}")
    _, slope, box = flow.at(between(a.low, b.high, bits))
    _require_contact(machine, place, flow, end, is_open=met.gap(flow.at(a)[2]).low > 0)
    if strikes:
        gradient, rate = met.identity[met.gap_row] * met.unit, met.gap_rate(box)
    elif place.switch >= 0:
        sign, k = system.signs[place.switch], place.switch
        gradient = system.gradient("guards", box)[k] * sign
        rate = system.value(f"guards_{place.mode}", box)[k] * sign
    else:
        gradient = -met.gradient("acceleration", box)[0]
        rate, falling = (-met.value("locked_jerk", where)[0] for where in (box, flow.box))
        require(falling.high < 0, f"the multiplier's rate may be {falling.shown()}")
    require(rate.high < 0, f"the guard's rate may be {rate.shown()}")
    delay = -(gradient @ slope) / rate
    slope = slope + np.outer(system.rates(place.mode, box), delay)
    time = between(first.low, last.high, bits)
    point = flow.at(time)[0]
    if strikes:
        point[met.gap_row], slope[met.gap_row] = met.stop, met.nothing
    return Mapped(point, slope, time, delay)


def _require_contact(
    machine: CertifiedMachine, place: RecordPosition, flow: Flow, end: Array, *, is_open: bool
) -> None:
    """Check the gaps of the own stop and of the stop that is met, and the contact forces.

    The force before a release follows from its rate.

    Args:
        machine: The systems of the certificate.
        place: Position of the record in the motion.
        flow: The step.
        end: Box of the states at its end.
        is_open: True if the gap that closes is positive just before the crossing.
    """
    start, (kind, index) = flow.old.hull, place.met
    system, met = machine.systems[place.view], machine.systems[place.meets]
    released = index if kind == "release" else -1
    machine.require_pressure(place.view, place.mode, flow.box, released)
    if kind == "stop":
        began = place if met is system else place._replace(began="")
        require_apart(met, began, start, flow.box, is_open=is_open, last=True)
    if place.mode == "free" and (met is not system or kind == "switch"):
        require_apart(system, place, start, flow.box, is_open=system.gap(end).low > 0)


def _guard(system: System, place: RecordPosition, flow: Flow, time: Ball, *, whole: bool) -> Ball:
    """Return the guard at a time in a step, for the point alone or for the whole set."""
    point, slope, box = flow.at(time)
    if place.met[0] == "stop":
        return system.gap(box if whole else point)
    name, k, sign = "acceleration", 0, -1
    if place.switch >= 0:
        name, k, sign = "guards", place.switch, system.signs[place.switch]
    value = system.value(name, point)[k] * sign
    gradient = system.gradient(name, box)[k] * sign
    return value + flow.old.moved(gradient @ slope) if whole else value


def require_apart(
    system: System,
    place: RecordPosition,
    start: Array,
    box: Array,
    *,
    is_open: bool,
    last: bool = False,
) -> None:
    """Check that the gap stays positive.

    Args:
        system: The system of the certificate.
        place: Position of the record in the motion.
        start: Box of the states at the start.
        box: Box that contains all motions over the step.
        is_open: True if the gap is positive at the end of the step, or just before a crossing.
        last: True for a step with a crossing.
    """
    gap, rate = system.gap(box), system.gap_rate(box)
    thrown = place.began == "impact" and system.gap_rate(start).low > 0
    open_first = thrown or system.gap(start).low > 0
    if (
        (gap.low > 0 and not last)
        or (rate.high < 0 and is_open)
        or (rate.low > 0 and open_first and not last)
        or (open_first and is_open and system.value("acceleration", box)[0].high < 0)
        or (place.began == "release" and not last and system.value("jerk", box)[0].low > 0)
        or (place.began == "opened" and not last and system.value("acceleration", box)[0].low > 0)
    ):
        return
    raise NotProved(f"the gap may close: it is {gap.shown()}")


def struck(system: System, box: Array, m: Array) -> Mapped:
    """Return the state after an impact: ``x - (1 + e) hdot D(x)``.

    Args:
        system: The system of the certificate.
        box: Box of the states before it.
        m: A state in the box.
    """
    row = system.rate_row
    system.require_law(box)
    e, at_point = system.value("law", box)[0], system.value("law", m)[0]
    e_slope, rate_slope = system.gradient("law", box)[0], system.identity[row] * system.unit
    rate, along = system.gap_rate(box), system.value("direction", box)
    fall = (e + 1) * rate
    fall = between(min(fall.low, 0), max(fall.high, 0), system.bits)
    moved, change = box.copy(), system.settling
    moved[change] = box[change] - along * fall
    system.require_defined(moved)
    system.require_reaction(box)
    drop = system.gradient("direction", box) * rate + np.outer(along, rate_slope)
    point, slope = m.copy(), system.identity
    speed = (at_point + 1) * system.gap_rate(m)
    point[change] = point[change] - system.value("direction", m) * speed
    slope[change] = slope[change] - drop * (e + 1) - np.outer(along, e_slope) * rate
    point[system.gap_row], slope[system.gap_row] = system.stop, system.nothing
    point[row], slope[row] = -(at_point * m[row]), e_slope * -box[row]
    slope[row, row] = slope[row, row] - e
    return Mapped(point, slope, Ball(0, 0, system.bits), system.nothing)


def switched(system: System, box: Array, m: Array, switch: int) -> Mapped:
    """Return the state after a switch: the reset of a declared switch, or the same state.

    Args:
        system: The system of the certificate.
        box: Box of the states before it.
        m: A state in the box.
        switch: The switch.
    """
    point, slope, n = m.copy(), system.identity, system.n_x
    if switch < system.n_declared:
        point[:n] = system.value(f"reset {switch}", m)
        slope[:n] = system.gradient(f"reset {switch}", box)
        if system.moves[switch]:
            ends = slice(n, len(m) - len(system.varied))
            point[ends] = system.value(f"after {switch}", m)
            slope[ends] = system.gradient(f"after {switch}", box)
    return Mapped(point, slope, Ball(0, 0, system.bits), system.nothing)


def _replaced(box: Array, values: Mapping[int, Ball]) -> Array:
    found = box.copy()
    for k, value in values.items():
        found[k] = value
    return found


def accumulated(
    system: System,
    box: Array,
    m: Array,
    record: Mapping[str, Any],
    closed: Sequence[System] = (),
) -> Mapped:
    """Return the Zeno point of all remaining impacts, by the lemma of the Zeno tail.

    All bounds are upper ends of intervals of mpmath, over the complex polydisc of the record. The
    difference between the record's speed and the set's speed is formed exactly, in integer units.

    Args:
        system: The system of the certificate.
        box: Box of the states before it.
        m: A state in the box.
        record: Its entries.
        closed: The system of the other stop that is closed, if there is one.
    """
    bits, settling, inner = system.bits, system.settling, system.inner
    n = len(settling)
    speed, w = number(record["speed"], bits), system.gap_rate(box)
    require(w.low > 0 and w.high < speed.m, f"the speed after the impact is {w.shown()}")
    radius = numbers(record["radius"], (len(inner),), bits)
    discs = {place: (ball, Ball(0, 0, bits)) for place, ball in system.constants.items()}
    discs |= {system.z[k]: (box[k], r) for k, r in zip(inner, radius, strict=True)}
    wide = zip(inner, radius, strict=True)
    around = _replaced(box, {k: box[k] + around_zero(r) for k, r in wide})
    system.require_inertia(around)
    for one in closed:
        one.require_pressure(around)
    system.require_law(around)
    system.require_reaction(around)
    require_sides(system, around)
    for k in system.open_rows:
        require(k == system.gap_row or around[k].low > 0, "another gap may close in the tail")
    nodes = [node for k in ("free", "direction", "law", "acceleration") for node in system.nodes[k]]
    complex_values(system.graph, discs, [*system.nodes["gap"], *system.nodes["constraints"]])
    *found, fall = complex_values(system.graph, discs, nodes)
    *bound, e = (abs(z).b for z in found)
    middle = fall.real.mid
    apart = abs(fall - middle).b
    least = -middle - apart
    require(bool(least > 0), "the gap's acceleration may vanish on the polydisc")
    flight = 2 / least
    kappa = 1 + 2 * apart * flight
    left = 1 - e * kappa
    require(bool(left > 0), f"the impacts may not decay: their ratio is {e * kappa}")
    fast, room = interval(speed), interval(Ball(speed.m - w.high, 0, bits))
    w = interval(w).b
    point, slope = m.copy(), system.identity
    c = [flight * bound[i] + (1 + e) * kappa * bound[n + i] for i in range(n)]
    reach = [fast * (flight * bound[i] + c[i] / left) for i in range(n)]
    reach += [0] * (len(inner) - n)
    delta = [interval(r) - s for r, s in zip(radius, reach, strict=True)]
    require(all(bool(x > 0) for x in delta), "the polydisc is too small")
    for i, place in enumerate(settling):
        moved = c[i] * w / left
        point[place] = point[place] + around_zero(upper(moved, bits))
        for k, x in zip(inner, delta, strict=True):
            slope[place, k] = slope[place, k] + around_zero(upper(moved / x, bits))
        by_speed = upper(c[i] * fast / (left * room), bits) * system.unit
        slope[place, system.rate_row] = slope[place, system.rate_row] + around_zero(by_speed)
    for row, value in ((system.gap_row, system.stop), (system.rate_row, Ball(0, 0, bits))):
        point[row], slope[row] = value, system.nothing
    time = between(0, upper(flight * w / left, bits).m, bits)
    return Mapped(point, slope, time, system.nothing)
