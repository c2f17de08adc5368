"""One record of a certificate: what it maps a point and its neighbours to, proved in balls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from zeno_orbits.errors import InputError
from zeno_orbits.proof.checker.balls import (
    Ball,
    Matrix,
    Vector,
    added,
    around_zero,
    between,
    dot,
    entries,
    identity,
    matrix,
    modulus,
    number,
    require,
    solved,
    times,
    vector,
)
from zeno_orbits.proof.checker.series import complex_values, taylor
from zeno_orbits.proof.checker.system import CONTACT, FREE, IMPULSE, LAW, System


@dataclass(frozen=True, slots=True)
class Enclosure:
    """A set handed on: ``z(u_c)`` in ``m + Q r``, ``dz/du`` in ``C + Q R``, over a box of u.

    ``r`` and ``R`` are balls around zero, ``spread`` is the box of ``u - u_c``.
    """

    m: Vector
    C: Matrix
    Q: Matrix
    r: Vector
    R: Matrix
    spread: Vector

    @classmethod
    def of(cls, data: Any, spread: Vector, n: int, bits: int) -> Enclosure:
        """Return a set of a certificate: its numbers rounded down to units, wherever it is used."""
        m, C, Q, r, R = entries(data, "m", "C", "Q", "r", "R")
        return cls(
            m=vector(m, n, bits, exact=False),
            C=matrix(C, n, len(spread), bits),
            Q=matrix(Q, n, n, bits),
            r=around_zero(vector(r, n, bits, exact=False)),
            R=[around_zero(row) for row in matrix(R, n, len(spread), bits)],
            spread=spread,
        )

    @property
    def derivative(self) -> Matrix:
        """A set that holds ``dz/du``, ``(N, D)``."""
        return added(self.C, times(self.Q, self.R))

    @property
    def hull(self) -> Vector:
        """A box that holds all states, ``(N,)``."""
        return self.image(self.m, self.Q, self.derivative, self.spread)

    def image(self, point: Vector, noise: Matrix, slope: Matrix, spread: Vector) -> Vector:
        """Return a box of ``point + noise r + slope spread``, the mean value form."""
        rows = zip(point, noise, slope, strict=True)
        return [p + dot((*n, *s), (*self.r, *spread)) for p, n, s in rows]


class Mapped(NamedTuple):
    """What a record makes of a set: of its point m, of its neighbours, and the time it takes."""

    point: Vector
    slope: Matrix
    time: Ball
    time_slope: Vector


class Place(NamedTuple):
    """Where in the motion a record stands: its mode, and what its arc began with."""

    mode: str
    began: str


def require_enclosed(old: Enclosure, mapped: Mapped, new: Enclosure) -> None:
    """Check that a set holds what a record makes of the one before it."""
    inverse = solved(new.Q, identity(len(new.m), new.m[0].bits))
    noise = times(inverse, times(mapped.slope, old.Q))
    shift = [[a - b] for a, b in zip(mapped.point, new.m, strict=True)]
    drift = added(times(mapped.slope, old.C), [[-x for x in row] for row in new.C])
    for name, found, given in (
        (
            "r",
            added(times(inverse, shift), times(noise, [[x] for x in old.r])),
            [[x] for x in new.r],
        ),
        ("R", added(times(inverse, drift), times(noise, old.R)), new.R),
    ):
        for i, rows in enumerate(zip(found, given, strict=True)):
            for x, bound in zip(*rows, strict=True):
                spread = Ball(0, bound.r, bound.bits).shown()
                require(x.size <= bound.r, f"{name}[{i}] must hold {x.shown()}, but is {spread}")


_HIGHEST = 200
"""Order beyond which a certificate is refused before anything is computed."""


class Flow:
    """One step of Taylor's method from a set, with its a-priori box (theory of the proof, 2)."""

    def __init__(
        self, system: System, mode: str, old: Enclosure, record: Mapping[str, Any]
    ) -> None:
        self.system, self.old, bits = system, old, system.bits
        self.h = number(record["h"], bits)
        require(self.h.low > 0, "the step is not positive")
        to, order = record["orders"]
        if not (
            type(to) is type(order) is int and 0 < min(to, order) <= max(to, order) <= _HIGHEST
        ):
            raise InputError(f"The certificate's orders must be from 1 to {_HIGHEST}.")
        slow = system.flow[mode]
        rates = slow | system.variational[mode]
        series = taylor(system.graph, rates, system.at(old.hull), self.h, order)
        box = {place: _hull(series[place], rates[place]) for place in rates}
        last = taylor(system.graph, rates, system.constants | box, self.h, order + 1)
        reach = {v: _hull([*series[v], last[v][-1]], None) for v in rates}
        for v, rate in rates.items():
            inside = box[v].low < reach[v].low and reach[v].high < box[v].high
            require(rate is None or inside, "there is no a-priori box")
        self.box = [reach[place] for place in system.z]
        self._slopes = [[(*series[v], last[v][-1]) for v in row] for row in system.V]
        points = taylor(system.graph, slow, system.at(old.m), self.h, to)
        ends = taylor(system.graph, slow, system.at(self.box), self.h, to + 1)
        self._points = [(*points[z], ends[z][-1]) for z in system.z]

    def at(self, time: Ball) -> tuple[Vector, Matrix, Vector]:
        """Return point, derivative and box of the set at a time of the step."""
        part = time / self.h
        point = [_horner(series, part) for series in self._points]
        slope = [[_horner(series, part) for series in row] for row in self._slopes]
        old = self.old
        noise, spread = times(slope, old.Q), times(slope, old.derivative)
        return point, slope, old.image(point, noise, spread, old.spread)


def _hull(series: Sequence[Ball], rate: int | None) -> Ball:
    """Return the sum of all terms over a step; wider, as an a-priori box, where there is a rate."""
    total = sum((c.with_zero() for c in series[2:]), series[0] + series[1].with_zero())
    wider = 0 if rate is None else total.r // 8 + (1 << 20)
    return Ball(total.m, total.r + wider, total.bits)


def _horner(series: Sequence[Ball], part: Ball) -> Ball:
    value = series[-1]
    for coefficient in reversed(series[:-1]):
        value = value * part + coefficient
    return value


def stepped(system: System, place: Place, old: Enclosure, record: Mapping[str, Any]) -> Mapped:
    """Prove one whole step in one mode."""
    flow = Flow(system, place.mode, old, record)
    point, slope, box = flow.at(flow.h)
    _require_apart(system, place, flow, old.hull, box)
    return Mapped(point, slope, flow.h, system.nothing)


def crossed(system: System, place: Place, old: Enclosure, record: Mapping[str, Any]) -> Mapped:
    """Prove the crossing of the guard in a last step: the gap closes, or the multiplier vanishes.

    With ``g`` the guard, the derivative is ``(1 - f grad g / (grad g . f)) D phi``.
    """
    flow = Flow(system, place.mode, old, record)
    bits, free = system.bits, place.mode == "free"
    (a, b), (first, last) = ((number(x, bits) for x in record[k]) for k in ("window", "centre"))
    require(0 <= a.m <= first.m <= last.m <= b.m <= flow.h.m, "the windows are not nested")
    for time, centre, sign in ((a, 0, 1), (b, 0, -1), (first, 1, 1), (last, 1, -1)):
        value = _guard(system, flow, time, centre=centre == 1, free=free)
        after = (value if sign > 0 else -value).low > 0
        require(after, f"the guard may vanish outside its window: {value.shown()}")
    _, slope, box = flow.at(between(a.low, b.high, bits))
    rates = system.rates(place.mode, box)
    if free:
        gradient, rate = system.across(system.gap_row), system.gap_rate(box)
        _require_apart(system, place, flow, old.hull, flow.at(a)[2], last=True)
    else:
        gradient, rate = system.gradient(CONTACT, box, 3), system.value(CONTACT, box)[4]
        falling = system.value(CONTACT, flow.box)[4]
        require(falling.high < 0, f"the multiplier's rate may be {falling.shown()}")
    require(rate.high < 0, f"the guard's rate may be {rate.shown()}")
    delay = [-(x / rate) for x in times([gradient], slope)[0]]
    slope = added(slope, [[x * y for y in delay] for x in rates])
    time = between(first.low, last.high, bits)
    point = flow.at(time)[0]
    if free:
        system.put_exactly(point, slope, system.gap_row, system.stop)
    return Mapped(point, slope, time, delay)


def _guard(system: System, flow: Flow, time: Ball, *, centre: bool, free: bool) -> Ball:
    """Return the guard at a time of a step: of the point alone, or of all of the set."""
    point, slope, box = flow.at(time)
    if free:
        return system.gap(point if centre else box)
    value = system.value(CONTACT, point)[3]
    if centre:
        return value
    old, row = flow.old, times([system.gradient(CONTACT, box, 3)], slope)
    spread = times(row, old.Q), times(row, old.derivative)
    return old.image([value], *spread, old.spread)[0]


def _require_apart(
    system: System, place: Place, flow: Flow, start: Vector, end: Vector, *, last: bool = False
) -> None:
    """Check that nothing is touched: the gap stays open, or the stop presses."""
    contact = system.value(CONTACT, flow.box)
    if place.mode == "locked":
        require(contact[3].low > 0, f"the multiplier may be {contact[3].shown()}")
        return
    gap, rate = system.gap(flow.box), system.gap_rate(flow.box)
    thrown = place.began == "impact" and system.gap_rate(start).low > 0
    open_first, open_last = thrown or system.gap(start).low > 0, system.gap(end).low > 0
    bent = contact[2].high < 0 and open_first and open_last
    falls, rises = rate.high < 0 and open_last, rate.low > 0 and open_first and not last
    left = place.began == "release" and system.third_derivative(flow.box).low > 0 and not last
    clear = gap.low > 0 and not last
    require(bent or falls or rises or left or clear, f"the gap may close: it is {gap.shown()}")


def struck(system: System, _: Place, old: Enclosure, __: Mapping[str, Any]) -> Mapped:
    """Return the state after an impact: ``x - (1 + e) hdot d(x)``."""
    bits, box, slope = system.bits, old.hull, identity(len(old.m), system.bits)
    one, row = Ball(1 << bits, 0, bits), system.rate_row
    e, at_point = (system.value(LAW, z)[0] for z in (box, old.m))
    e_slope, rate_slope = system.gradient(LAW, box, 0), system.across(row)
    rate, direction = system.gap_rate(box), system.value(IMPULSE, box)
    point, speed = list(old.m), (one + at_point) * system.gap_rate(old.m)
    for i, along in enumerate(system.value(IMPULSE, old.m)):
        point[i] = point[i] - speed * along
        entries = zip(slope[i], system.gradient(IMPULSE, box, i), rate_slope, e_slope, strict=True)
        slope[i] = [
            x - (one + e) * (rate * y + direction[i] * z) - rate * direction[i] * u
            for x, y, z, u in entries
        ]
    system.put_exactly(point, slope, system.gap_row, system.stop)
    system.put_exactly(point, slope, row, -(at_point * old.m[row]))
    slope[row] = [-(x * box[row]) for x in e_slope]
    slope[row][row] = slope[row][row] - e
    return Mapped(point, slope, Ball(0, 0, bits), system.nothing)


def accumulated(system: System, _: Place, old: Enclosure, record: Mapping[str, Any]) -> Mapped:
    """Return the Zeno point of all impacts to come, by the lemma of the Zeno tail."""
    bits, box, n_x = system.bits, old.hull, system.n_x
    one, zero = Ball(1 << bits, 0, bits), Ball(0, 0, bits)
    inner = [k for k in range(len(box)) if k < n_x or k > max(n_x - 1, system.rate_row)]
    speed, w = number(record["speed"], bits), system.gap_rate(box)
    require(w.low > 0 and w.high < speed.m, f"the speed after the impact is {w.shown()}")
    radius = {k: number(x, bits) for k, x in zip(inner, record["radius"], strict=True)}
    discs = {place: (ball, 0) for place, ball in system.constants.items()}
    discs |= {system.z[k]: (box[k], radius[k].m) for k in inner}
    nodes = [*(x for k in (FREE, IMPULSE, LAW) for x in system.outputs[k])]
    *found, fall = complex_values(system.graph, discs, [*nodes, system.outputs[CONTACT][2]])
    *bound, e = (Ball(modulus(*pair), 0, bits) for pair in found)
    spread = Ball(modulus(Ball(0, fall[0].r, bits), fall[1]), 0, bits)
    least = Ball(-fall[0].m, 0, bits) - spread
    require(least.low > 0, "the gap's acceleration may vanish on the polydisc")
    flight = (one + one) / least
    kappa = one + (spread + spread) * flight
    left = one - e * kappa
    require(left.low > 0, f"the impacts may not decay: their ratio is {(e * kappa).shown()}")
    c = [flight * bound[i] + (one + e) * kappa * bound[n_x + i] for i in range(n_x)]
    reach = [speed * (flight * bound[i] + c[i] / left) for i in range(n_x)]
    delta = {k: radius[k] - reach[k] if k < n_x else radius[k] for k in inner}
    require(all(x.low > 0 for x in delta.values()), "the polydisc is too small")
    point, slope = list(old.m), identity(len(box), bits)
    for i in range(n_x):
        moved, by_speed = w * c[i] / left, c[i] / left * (speed / (speed - w))
        point[i] = point[i] + Ball(0, moved.size, bits)
        for k in inner:
            slope[i][k] = slope[i][k] + Ball(0, (moved / delta[k]).size, bits)
        row = system.rate_row
        slope[i][row] = slope[i][row] + Ball(0, (by_speed * system.unit).size, bits)
    system.put_exactly(point, slope, system.gap_row, system.stop)
    system.put_exactly(point, slope, system.rate_row, zero)
    return Mapped(point, slope, between(0, (flight * w / left).high, bits), system.nothing)


KINDS = {"step": stepped, "cross": crossed, "impact": struck, "tail": accumulated}
