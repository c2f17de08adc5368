"""One record of a certificate: what it maps a point and its neighbours to, proved in balls."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, cast

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.proof.checker.balls import (
    Array,
    Ball,
    NotProved,
    around_zero,
    between,
    number,
    numbers,
    require,
    with_zero,
)
from zeno_orbits.proof.checker.enclosure import Enclosure, Mapped
from zeno_orbits.proof.checker.series import complex_values, interval, taylor, upper
from zeno_orbits.proof.checker.system import CONTACT, FREE, IMPULSE, LAW, MULTIPLIER, System

_HIGHEST = 200
"""Order beyond which a certificate is refused before anything is computed."""
_SWEEPS = 4
"""How often an a-priori box is tried: rounding of a large number may move a small one."""


class Place(NamedTuple):
    """Where in the motion a record stands: its mode, and what its arc began with."""

    mode: str
    began: str


class Flow:
    """One step of Taylor's method from a set, with its a-priori box."""

    def __init__(
        self, system: System, mode: str, old: Enclosure, record: Mapping[str, Any]
    ) -> None:
        graph, slow = system.graph, system.flow[mode]
        self.old, self.h = old, number(record["h"], system.bits)
        require(self.h.low > 0, "the step is not positive")
        high, low = record["orders"]
        if not (
            type(high) is type(low) is int and 0 < min(low, high) <= max(low, high) <= _HIGHEST
        ):
            raise InputError(f"The certificate's orders must be from 1 to {_HIGHEST}.")
        rates = slow | system.variational[mode]
        moving = np.array([slow[v] is not None for v in system.z])

        def terms(z: Array, order: int) -> Array:
            """Return the coefficients of the states and of their derivative, ``(N, 1 + N, k)``."""
            found = taylor(graph, rates, system.at(z), self.h, order)
            places = zip(system.z, system.V, strict=True)
            return np.array([[found[v] for v in (z, *row)] for z, row in places], dtype=object)

        known = terms(old.hull, low)
        reach = _hull(known)
        for _ in range(_SWEEPS):
            box = reach.copy()
            box[moving] = _wider(reach[moving])
            # A derivative's coefficient is that of the flow from there, times the derivative.
            rest = terms(box[:, 0], low + 1)[..., -1:]
            rest[:, 1:, 0] = rest[:, 1:, 0] @ box[:, 1:]
            series = np.concatenate([known, rest], axis=2)
            reach = _hull(series)
            if np.all(_inside(reach[moving], box[moving])):
                break
        else:
            raise NotProved("there is no a-priori box")
        self.box, self._slope = reach[:, 0], series[:, 1:]
        point = taylor(graph, slow, system.at(old.m), self.h, high)
        ends = taylor(graph, slow, system.at(self.box), self.h, high + 1)
        self._point = np.array([(*point[v], ends[v][-1]) for v in system.z])

    def at(self, time: Ball) -> tuple[Array, Array, Array]:
        """Return point, derivative and box of the set at a time of the step."""
        part = time / self.h
        point, slope = (_horner(series, part) for series in (self._point, self._slope))
        return point, slope, point + self.old.moved(slope)


def _hull(series: Array) -> Array:
    """Return the sums of all terms over a step; orders are on the last axis."""
    return series[..., 0] + with_zero(series[..., 1:]).sum(axis=-1)


_wider: Any = np.frompyfunc(lambda x: Ball(x.m, x.r + x.r // 8 + (1 << 20), x.bits), 1, 1)
"""Intervals that are wider by a part of themselves, and by some units."""
_inside: Any = np.frompyfunc(lambda x, y: y.low < x.low and x.high < y.high, 2, 1)


def _horner(series: Array, part: Ball) -> Array:
    """Return the sum of all terms at a part of a step; orders are on the last axis."""
    value = series[..., -1]
    for k in range(series.shape[-1] - 2, -1, -1):
        value = value * part + series[..., k]
    return value


def stepped(system: System, place: Place, old: Enclosure, record: Mapping[str, Any]) -> Mapped:
    """Prove one whole step in one mode.

    Args:
        system: What the certificate is about.
        place: Where in the motion the record stands.
        old: The set before it.
        record: Its entries.
    """
    flow = Flow(system, place.mode, old, record)
    point, slope, box = flow.at(flow.h)
    _require_apart(system, place, flow, box)
    return Mapped(point, slope, flow.h, system.nothing)


def crossed(system: System, place: Place, old: Enclosure, record: Mapping[str, Any]) -> Mapped:
    """Prove the crossing of the guard in a last step: the gap closes, or the multiplier vanishes.

    With ``g`` the guard, the derivative is ``(1 - f grad g / (grad g . f)) D phi``.

    Args:
        system: What the certificate is about.
        place: Where in the motion the record stands.
        old: The set before it.
        record: Its entries.
    """
    flow = Flow(system, place.mode, old, record)
    bits, free = system.bits, place.mode == "free"
    a, b = numbers(record["window"], (2,), bits)
    first, last = numbers(record["centre"], (2,), bits)
    require(0 <= a.m <= first.m <= last.m <= b.m <= flow.h.m, "the windows are not nested")
    for time, whole, sign in ((a, True, 1), (b, True, -1), (first, False, 1), (last, False, -1)):
        value = _guard(system, flow, time, whole=whole, free=free)
        failure = f"the guard may vanish outside its window: {value.shown()}"
        require((value * sign).low > 0, failure)
    _, slope, box = flow.at(between(a.low, b.high, bits))
    if free:
        gradient, rate = system.identity[system.gap_row] * system.unit, system.gap_rate(box)
        _require_apart(system, place, flow, flow.at(a)[2], last=True)
    else:
        gradient, rate = system.gradient(CONTACT, box)[MULTIPLIER], system.multiplier_rate(box)
        falling = system.multiplier_rate(flow.box)
        require(falling.high < 0, f"the multiplier's rate may be {falling.shown()}")
    require(rate.high < 0, f"the guard's rate may be {rate.shown()}")
    delay = -(gradient @ slope) / rate
    slope = slope + np.outer(system.rates(place.mode, box), delay)
    time = between(first.low, last.high, bits)
    point = flow.at(time)[0]
    if free:
        point[system.gap_row], slope[system.gap_row] = system.stop, system.nothing
    return Mapped(point, slope, time, delay)


def _guard(system: System, flow: Flow, time: Ball, *, whole: bool, free: bool) -> Ball:
    """Return the guard at a time of a step: of the point alone, or of the whole set."""
    point, slope, box = flow.at(time)
    if free:
        return system.gap(box if whole else point)
    value = system.value(CONTACT, point)[MULTIPLIER]
    gradient = system.gradient(CONTACT, box)[MULTIPLIER]
    return value + flow.old.moved(gradient @ slope) if whole else value


def _require_apart(
    system: System, place: Place, flow: Flow, end: Array, *, last: bool = False
) -> None:
    """Check that nothing is touched: the gap stays open, or the stop presses."""
    if place.mode == "locked":
        multiplier = system.value(CONTACT, flow.box)[MULTIPLIER]
        require(multiplier.low > 0, f"the multiplier may be {multiplier.shown()}")
        return
    start, gap, rate = flow.old.hull, system.gap(flow.box), system.gap_rate(flow.box)
    thrown = place.began == "impact" and system.gap_rate(start).low > 0
    open_first, open_last = thrown or system.gap(start).low > 0, system.gap(end).low > 0
    bent = open_first and open_last and system.gap_acceleration(flow.box).high < 0
    falls, rises = rate.high < 0 and open_last, rate.low > 0 and open_first and not last
    left = place.began == "release" and not last and system.gap_jerk(flow.box).low > 0
    clear = gap.low > 0 and not last
    require(bent or falls or rises or left or clear, f"the gap may close: it is {gap.shown()}")


def struck(system: System, _: Place, old: Enclosure, __: Mapping[str, Any]) -> Mapped:
    """Return the state after an impact: ``x - (1 + e) hdot d(x)``.

    Args:
        system: What the certificate is about.
        _: An impact is the same everywhere.
        old: The set before it.
        __: It has no entries.
    """
    n_x, row, box = system.n_x, system.rate_row, old.hull
    e, at_point = system.value(LAW, box)[0], system.value(LAW, old.m)[0]
    e_slope, rate_slope = system.gradient(LAW, box)[0], system.identity[row] * system.unit
    rate, along = system.gap_rate(box), system.value(IMPULSE, box)
    drop = system.gradient(IMPULSE, box) * rate + np.outer(along, rate_slope)
    point, slope = old.m.copy(), system.identity
    speed = (at_point + 1) * system.gap_rate(old.m)
    point[:n_x] = point[:n_x] - system.value(IMPULSE, old.m) * speed
    slope[:n_x] = slope[:n_x] - drop * (e + 1) - np.outer(along, e_slope) * rate
    point[system.gap_row], slope[system.gap_row] = system.stop, system.nothing
    point[row], slope[row] = -(at_point * old.m[row]), e_slope * -box[row]
    slope[row, row] = slope[row, row] - e
    return Mapped(point, slope, Ball(0, 0, system.bits), system.nothing)


def accumulated(system: System, _: Place, old: Enclosure, record: Mapping[str, Any]) -> Mapped:
    """Return the Zeno point of all impacts to come, by the lemma of the Zeno tail.

    All bounds are upper ends of intervals of mpmath, over the complex polydisc of the record.

    Args:
        system: What the certificate is about.
        _: A tail is the same everywhere.
        old: The set before it.
        record: Its entries.
    """
    bits, box, n_x, inner = system.bits, old.hull, system.n_x, system.inner
    speed, w = number(record["speed"], bits), system.gap_rate(box)
    require(w.low > 0 and w.high < speed.m, f"the speed after the impact is {w.shown()}")
    radius = numbers(record["radius"], (len(inner),), bits)
    discs = {place: (ball, Ball(0, 0, bits)) for place, ball in system.constants.items()}
    discs |= {system.z[k]: (box[k], r) for k, r in zip(inner, radius, strict=True)}
    nodes = [node for k in (FREE, IMPULSE, LAW) for node in system.outputs[k]]
    acceleration = cast("int", system.flow["free"][system.z[system.rate_row]])
    *found, fall = complex_values(system.graph, discs, [*nodes, acceleration])
    *bound, e = (abs(z).b for z in found)
    fall = fall * interval(system.unit)
    middle = fall.real.mid
    apart = abs(fall - middle).b
    least = -middle - apart
    require(bool(least > 0), "the gap's acceleration may vanish on the polydisc")
    flight = 2 / least
    kappa = 1 + 2 * apart * flight
    left = 1 - e * kappa
    require(bool(left > 0), f"the impacts may not decay: their ratio is {e * kappa}")
    fast, w = interval(speed), interval(w).b
    point, slope = old.m.copy(), system.identity
    c = [flight * bound[i] + (1 + e) * kappa * bound[n_x + i] for i in range(n_x)]
    reach = [fast * (flight * bound[i] + c[i] / left) for i in range(n_x)]
    reach += [0] * (len(inner) - n_x)
    delta = [interval(r) - s for r, s in zip(radius, reach, strict=True)]
    require(all(bool(x > 0) for x in delta), "the polydisc is too small")
    for i in range(n_x):
        moved = c[i] * w / left
        point[i] = point[i] + around_zero(upper(moved, bits))
        for k, x in zip(inner, delta, strict=True):
            slope[i, k] = slope[i, k] + around_zero(upper(moved / x, bits))
        by_speed = upper(c[i] * fast / (left * (fast - w)), bits) * system.unit
        slope[i, system.rate_row] = slope[i, system.rate_row] + around_zero(by_speed)
    for row, value in ((system.gap_row, system.stop), (system.rate_row, Ball(0, 0, bits))):
        point[row], slope[row] = value, system.nothing
    time = between(0, upper(flight * w / left, bits).m, bits)
    return Mapped(point, slope, time, system.nothing)


KINDS: dict[str, Callable[..., Mapped]] = {
    "step": stepped,
    "cross": crossed,
    "impact": struck,
    "tail": accumulated,
}
