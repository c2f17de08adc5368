"""Passes of a certificate in polynomials: a box of initial states and its image, without slopes.

A polynomial set contains the states ``p(s) + Q e`` for all ``s`` in ``[-1, 1]^D`` and all ``e``
within radii. The coordinates of the start are ``u_c + s`` times the radii of the box. A record maps
the polynomials, and only the remainder ``Q e`` travels with a derivative over the whole set.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import comb
from typing import Any

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.proof.checker.balls import (
    Array,
    Ball,
    NotProved,
    around_zero,
    entries,
    exactly,
    fitting_together,
    linear_solution,
    number,
    numbers,
    radii,
    require,
    sizes,
)
from zeno_orbits.proof.checker.lanes import Lanes, lanes_of, orders_of
from zeno_orbits.proof.checker.motion import (
    RecordPosition,
    accumulated,
    held,
    lane_flow,
    require_apart,
    struck,
)
from zeno_orbits.proof.checker.polynomials import (
    Monomials,
    Polys,
    monomials,
    poly_series,
    poly_values,
    polynomial_value,
)
from zeno_orbits.proof.checker.section import Box, ContactSection, newton_of, reached_others
from zeno_orbits.proof.checker.system import System
from zeno_orbits.work import ExecutionPlan, parallel_map

_CHUNK = 100
"""Number of records that a process proves together."""
HIGHEST_DEGREE = 8
_MOST_MONOMIALS = 256
_LEAST_ORDER = 3
"""Smallest order of a step: a release needs the third derivative of the gap."""
_LOW = 2
"""Degree of the derivative over a set, which only moves the remainder."""


@dataclass(frozen=True, slots=True)
class PolySet:
    """A set of a pass: polynomials, and a remainder in a frame.

    Attributes:
        of: The monomials.
        P: Coefficients, ``(N, M)``.
        Q: Directions of the remainder, ``(N, N)``.
        E: Balls around zero with the radii of the remainder, ``(N,)``.
    """

    of: Monomials
    P: Array
    Q: Array
    E: Array

    @classmethod
    def read(cls, data: Any, of: Monomials, n: int, bits: int) -> PolySet:
        """Return a set of a certificate, whose numbers are rounded down to units for every use."""
        p, Q, r = entries(data, "p", "Q", "r")
        return cls(
            of,
            numbers(p, (n, of.n), bits, exact=False),
            numbers(Q, (n, n), bits, exact=False),
            radii(r, (n,), bits, exact=False),
        )

    @property
    def noise(self) -> Array:
        """The remainder, ``(N,)``."""
        return self.Q @ self.E

    @property
    def hull(self) -> Array:
        """A box that contains all states, ``(N,)``."""
        return ranges(self.P) + self.noise

    @property
    def polys(self) -> Polys:
        """The polynomials without the remainder, ``(N,)``."""
        return Polys.from_balls(self.of, self.P)

    @property
    def wide(self) -> Polys:
        """The polynomials with the remainder, ``(N,)``."""
        noise = lanes_of(self.noise)
        return self.polys.wider(abs(noise.c) + noise.r)


def ranges(P: Array) -> Array:
    """Return boxes around the values of polynomials with the coefficients ``(..., M)``."""
    return P[..., 0] + around_zero(P[..., 1:]).sum(axis=-1)


@dataclass(frozen=True, slots=True)
class PolyImage:
    """Image of a polynomial set under a record.

    Attributes:
        P: Coefficients of the image of the polynomials, with remainders in balls, ``(N, M)``.
        slope: Derivative over the whole set, ``(N, N)``.
    """

    P: Array
    slope: Array


def require_inside(old: PolySet, image: PolyImage, new: PolySet) -> None:
    """Check that a set contains the image of the set before a record (Lemma 12).

    Args:
        old: The set before the record.
        image: Its image.
        new: The set after the record.
    """
    n = len(old.P)
    inverse = linear_solution(new.Q, exactly(np.eye(n, dtype=int), new.E[0].bits))
    found = sizes(inverse @ (image.P - new.P)).sum(axis=1)
    found = found + sizes(inverse @ (image.slope @ old.Q) @ old.E)
    for i, (size, bound) in enumerate(zip(found, new.E, strict=True)):
        require(size <= bound.r, f"r[{i}] must hold {size} units, but has {bound.r}")


class PolyFlow:
    """A step from a polynomial set, with its a-priori box."""

    def __init__(
        self,
        old: PolySet,
        h: Ball,
        time: Array,
        box: Array,
        image: PolyImage,
        late: Any,
        leaving: Ball,
    ) -> None:
        """Store the results of `poly_flows`.

        Args:
            old: The set.
            h: Bound of the durations.
            time: Coefficients of the durations, ``(M,)``.
            box: Box that contains all motions up to the bound.
            image: Image at the durations.
            late: Function of a time that returns derivative and box over all durations within it.
            leaving: Change of the gap's state after a release, divided by the cube of the time in
                steps.
        """
        self.old, self.h, self.time, self.box, self.image = old, h, time, box, image
        self.late, self.leaving = late, leaving


@np.errstate(all="ignore")  # Every inequality is false for overflow.
def poly_flows(
    system: System,
    mode: str,
    orders: Sequence[int],
    olds: Sequence[PolySet],
    steps: Sequence[tuple[Ball, Array]],
) -> list[PolyFlow | str]:
    """Return steps of one mode and of the same orders, or the reason of a failure.

    Args:
        system: The system of the certificate.
        mode: The mode.
        orders: Orders for a point and for the derivative.
        olds: The sets.
        steps: Bound of the durations, and the coefficients of the durations.
    """
    rates, (high, low) = system.flow[mode], orders
    flow, of, bits = lane_flow(system, mode), olds[0].of, system.bits
    less = monomials(len(of.exponents[0]), min(_LOW, of.degree))
    moving = np.array([node is not None for node in rates])
    h = lanes_of([step for step, _ in steps])
    parts = Polys.from_balls(of, np.array([time / step for step, time in steps], dtype=object))

    wide = _joined([old.wide.to(less) for old in olds])
    x, V = poly_series(flow, _inputs(system, wide), h, low, slopes=True)
    if V is None:
        raise NotProved("the derivative is missing")
    bounds = held(system, mode, orders, x.range, V.range, h)
    points, _ = poly_series(
        flow, _inputs(system, _joined([old.polys for old in olds])), h, high, slopes=False
    )
    rest = Polys.constant(of, bounds.rest)
    rest_x = Polys.constant(less, bounds.rest_x)
    rest_V = Polys.constant(less, bounds.rest_slope)
    ends = polynomial_value(points, rest, parts[:, None])
    low_parts = parts.to(less)
    slopes = polynomial_value(V, rest_V, low_parts[:, None, None])

    def slope_of(found: Any) -> Array:
        slope = found.range.balls(bits)
        slope[~moving] = system.identity[~moving]
        return slope

    # Without the terms that vanish at a release.
    terms = x.range[3:, :, system.gap_row].then(bounds.rest_x[:, system.gap_row])
    leaving = terms.hull().balls(bits)
    made = list[PolyFlow | str]()
    for k, (old, (step, time)) in enumerate(zip(olds, steps, strict=True)):
        if not bounds.found[k]:
            made.append("an a-priori box is missing")
            continue

        def late(spare: Ball, k: int = k, old: PolySet = old, step: Ball = step) -> Any:
            more = lanes_of([around_zero(spare / step)])
            part = low_parts[k].wider(more.c[0] + more.r[0])
            slope = slope_of(polynomial_value(V[:, k], rest_V[k], part[None, None]))
            at = polynomial_value(x[:, k], rest_x[k], part[None]).range.balls(bits)
            at[~moving] = old.hull[~moving]
            return slope, at

        P = ends[k].balls(bits)
        P[~moving] = old.P[~moving]
        image = PolyImage(P, slope_of(slopes[k]))
        box = bounds.reach[k].balls(bits)
        made.append(PolyFlow(old, step, time, box, image, late, leaving[k]))
    return made


def _inputs(system: System, sets: Polys) -> dict[int, Polys]:
    """Return all inputs over sets of states, ``(L, N)``."""
    fixed = {
        place: Polys.constant(sets.of, lanes_of([ball] * len(sets.c)))
        for place, ball in system.constants.items()
    }
    return fixed | {place: sets[:, k] for k, place in enumerate(system.z)}


def _joined(sets: Sequence[Polys]) -> Polys:
    return Polys(sets[0].of, np.stack([one.c for one in sets]), np.stack([one.r for one in sets]))


def poly_stepped(system: System, place: RecordPosition, flow: PolyFlow) -> PolyImage:
    """Prove one whole step in one mode.

    Args:
        system: The system of the certificate.
        place: Position of the record in the motion.
        flow: The step.
    """
    system.require_defined(flow.box)
    image = flow.image
    if place.mode == "locked":
        system.require_pressure(flow.box)
        return image
    end = ranges(image.P) + image.slope @ flow.old.noise
    if place.began == "release" and (system.unit * flow.leaving).low > 0:
        return image
    is_open = system.gap(end).low > 0
    require_apart(system, place, flow.old.hull, flow.box, is_open=is_open)
    return image


def poly_crossed(
    system: System, place: RecordPosition, flow: PolyFlow, record: Mapping[str, Any]
) -> PolyImage:
    """Prove the crossing of the guard near the duration of a last step.

    Args:
        system: The system of the certificate.
        place: Position of the record in the motion.
        flow: The step.
        record: Its entries.
    """
    bits, free, old, image = system.bits, place.mode == "free", flow.old, flow.image
    system.require_defined(flow.box)
    spare = number(record["spare"], bits)
    times = ranges(flow.time)
    inside = 0 < spare.m < times.low and times.high + spare.m <= flow.h.m
    require(inside, "the times of the crossing are not inside the step")
    _, box = flow.late(spare)
    if free:
        value = system.unit * (ranges(image.P)[system.gap_row] - system.stop)
        gradient, rate = system.identity[system.gap_row] * system.unit, system.gap_rate(box)
        require_apart(system, place, old.hull, flow.box, is_open=True, last=True)
    else:
        value = -_values(system, "acceleration", old.of, image.P)[0]
        gradient = -system.gradient("acceleration", box)[0]
        rate, falling = (-system.value("locked_jerk", where)[0] for where in (box, flow.box))
        require(falling.high < 0, f"the multiplier's rate may be {falling.shown()}")
    require(rate.high < 0, f"the guard's rate may be {rate.shown()}")
    moved = gradient @ image.slope
    reach = value + moved @ old.noise
    # Then the guard is positive before, and negative after, the interval around the duration.
    require((around_zero(reach) / -rate).high < spare.m, "the crossing may be outside its interval")
    rates, P = system.rates(place.mode, box), image.P.copy()
    P[:, 0] = P[:, 0] + rates * around_zero(value / rate)
    slope = image.slope + np.outer(rates, -moved / rate)
    if free:
        P[system.gap_row], slope[system.gap_row] = (
            _constant(system, old, system.stop),
            system.nothing,
        )
    return PolyImage(P, slope)


def _constant(system: System, old: PolySet, value: Ball) -> Array:
    row = exactly(np.zeros(old.of.n, dtype=int), system.bits)
    row[0] = value
    return row


def _values(system: System, name: str, of: Monomials, P: Array) -> Array:
    """Return nodes at polynomials with the coefficients ``(N, M)``, as ranges."""
    return ranges(_polynomials(system, name, of, P))


def _polynomials(system: System, name: str, of: Monomials, P: Array) -> Array:
    """Return nodes at polynomials, as coefficients ``(n, M)``."""
    inputs = _inputs(system, Polys.from_balls(of, P[None]))
    found = poly_values(system.graph, inputs, system.nodes[name])
    return np.array([one[0].balls(system.bits) for one in found], dtype=object)


def poly_struck(system: System, old: PolySet) -> PolyImage:
    """Return the states after an impact: ``x - (1 + e) hdot D(x)``.

    Args:
        system: The system of the certificate.
        old: The set before it.
    """
    n_x, row, of, bits = system.n_x, system.rate_row, old.of, system.bits
    slope = struck(system, old.hull, old.P[:, 0]).slope
    e = Polys.from_balls(of, _polynomials(system, "law", of, old.P))
    along = Polys.from_balls(of, _polynomials(system, "direction", of, old.P))
    x, unit = old.polys, lanes_of(np.array([system.unit], dtype=object))
    one = Polys.constant(of, Lanes(np.ones(1, x.c.dtype), np.zeros(1, x.c.dtype)))
    speed = ((e + one) * x[row : row + 1]).scaled(unit)
    P = old.P.copy()
    P[:n_x] = (x[:n_x] - along * speed).balls(bits)
    plastic = system.value("law", old.hull)[0].size == 0
    # A product of polynomials is rounded outward, also a product with zero.
    P[row] = (
        _constant(system, old, Ball(0, 0, bits))
        if plastic
        else (-(e * x[row : row + 1])).balls(bits)[0]
    )
    P[system.gap_row] = _constant(system, old, system.stop)
    return PolyImage(P, slope)


def poly_accumulated(system: System, old: PolySet, record: Mapping[str, Any]) -> PolyImage:
    """Return the Zeno points of all remaining impacts, near the states of the set.

    Args:
        system: The system of the certificate.
        old: The set before it.
        record: Its entries.
    """
    still = old.P[:, 0]
    point = accumulated(system, old.hull, still, record).point
    P, slope = old.P.copy(), system.identity
    P[:, 0] = still + around_zero(point - still)
    for row, value in ((system.gap_row, system.stop), (system.rate_row, Ball(0, 0, system.bits))):
        P[row], slope[row] = _constant(system, old, value), system.nothing
    return PolyImage(P, slope)


def require_poly_start(system: System, section: ContactSection, box: Box, start: PolySet) -> None:
    """Check that a polynomial set contains every point of the section over a box.

    Args:
        system: The system of the certificate.
        section: Its section of releases.
        box: The box.
        start: The set.
    """
    require(section.settled, "the section is not of releases")
    bits, of, n = system.bits, start.of, len(system.z)
    newton, state = newton_of(system, section, box)
    reached_others(section, box, newton)
    inner = [*section.places, *system.varied]
    P = exactly(np.zeros((n, of.n), dtype=int), bits)
    P[system.gap_row, 0] = system.stop
    P[inner, 0] = box.centre
    for j, k in enumerate(inner):
        axis = tuple(int(i == j) for i in range(len(inner)))
        P[k, of.exponents.index(axis)] = Ball(box.spread[j].r, 0, bits)
    P[section.others] = start.P[section.others]
    around = ranges(P)
    for k, middle, reach in zip(section.others, box.others, box.others_spread, strict=True):
        require((around[k] - middle).size <= reach.r, f"state {k} leaves its part of the section")
    if section.equations:
        rest = np.array(
            [_polynomials(system, name, of, P)[row] for name, row in section.equations],
            dtype=object,
        )
        everywhere = state(box.centre + box.spread, box.others + box.others_spread)
        rows = [system.gradient(name, everywhere)[row] for name, row in section.equations]
        slopes = np.array(rows, dtype=object).reshape(len(rows), n)
        off = linear_solution(slopes[:, section.others], ranges(rest)[:, None])[:, 0]
        P[section.others, 0] = P[section.others, 0] - off
    nothing = PolySet(of, P, system.identity, system.nothing)
    require_inside(nothing, PolyImage(P, system.identity), start)


def require_degree(degree: Any, n_variables: int) -> Monomials:
    """Return the monomials of a degree in a certificate.

    Raises:
        InputError: If the degree is not allowed.
    """
    if type(degree) is not int or not 1 <= degree <= HIGHEST_DEGREE or n_variables < 1:
        raise InputError(f"The certificate's degree must be 1 to {HIGHEST_DEGREE}.")
    if comb(n_variables + degree, degree) > _MOST_MONOMIALS:
        raise InputError(f"The certificate's polynomials have more than {_MOST_MONOMIALS} terms.")
    return monomials(n_variables, degree)


RECORDS = {
    "step": ("h", "orders", "time"),
    "cross": ("h", "orders", "time", "spare"),
    "impact": (),
    "tail": ("radius", "speed"),
}
"""Entries of a record, by its kind."""


def proved_image(
    system: System,
    section: ContactSection,
    box: Box,
    part: Mapping[str, Any],
    stations: Sequence[RecordPosition],
) -> Array:
    """Return a box of states that contains the image of a box under the return map.

    Args:
        system: The system of the certificate.
        section: Its section.
        box: The box.
        part: The pass.
        stations: Position of each record in the motion.

    Raises:
        NotProved: If an inclusion is not proved.
    """
    of = require_degree(part["degree"], len(box.spread))
    sets = [part["start"], *(record["set"] for record in part["records"])]
    first, last = (
        PolySet.read(data, of, len(system.z), system.bits) for data in (sets[0], sets[-1])
    )
    require_poly_start(system, section, box, first)
    tasks = list(zip(stations, sets, part["records"], strict=False))
    judge = partial(_failures, system, of)
    failures = (
        judge(tasks)
        if len(tasks) <= _CHUNK
        else parallel_map(judge, tasks, ExecutionPlan(chunk=_CHUNK))
    )
    for k, failure in enumerate(failures):
        require(not failure, f"record {k} ({part['records'][k]['kind']}): {failure}")
    return last.hull


def _failures(system: System, of: Monomials, tasks: Sequence[Any]) -> list[str]:
    """Return the reason why a record is not proved, or an empty text, for every record."""
    with fitting_together():
        return _reasons(system, of, tasks)


def _reasons(system: System, of: Monomials, tasks: Sequence[Any]) -> list[str]:
    olds = [PolySet.read(data, of, len(system.z), system.bits) for _, data, _ in tasks]
    steps, found = _steps(system, of, olds, tasks), list[str]()
    for k, (place, _, record) in enumerate(tasks):
        new = PolySet.read(record["set"], of, len(system.z), system.bits)
        try:
            step = steps.get(k, "")
            image = _image(system, RecordPosition(*place), olds[k], record, step)
            require_inside(olds[k], image, new)
            found.append("")
        except NotProved as failure:
            found.append(str(failure))
    return found


def _image(
    system: System,
    place: RecordPosition,
    old: PolySet,
    record: Mapping[str, Any],
    step: PolyFlow | str,
) -> PolyImage:
    if record["kind"] == "impact":
        return poly_struck(system, old)
    if record["kind"] == "tail":
        return poly_accumulated(system, old, record)
    if isinstance(step, str):
        raise NotProved(step)
    if record["kind"] == "step":
        return poly_stepped(system, place, step)
    return poly_crossed(system, place, step, record)


def _steps(
    system: System, of: Monomials, olds: Sequence[PolySet], tasks: Sequence[Any]
) -> dict[int, PolyFlow | str]:
    """Return the flows of all steps and crossings, together for the same mode and orders."""
    groups: dict[tuple[str, int, int], list[int]] = {}
    found: dict[int, PolyFlow | str] = {}
    given: dict[int, tuple[Ball, Array]] = {}
    for k, (place, _, record) in enumerate(tasks):
        if "orders" not in record:
            continue
        high, low = orders_of(record)
        require(low >= _LEAST_ORDER, f"an order is below {_LEAST_ORDER}")
        h, time = number(record["h"], system.bits), numbers(record["time"], (of.n,), system.bits)
        reach, given[k] = ranges(time), (h, time)
        if not 0 < reach.low <= reach.high <= h.m:
            found[k] = "the durations are not positive, or longer than their bound"
            continue
        groups.setdefault((place[0], high, low), []).append(k)
    for (mode, *orders), places in groups.items():
        try:
            made = poly_flows(
                system, mode, orders, [olds[k] for k in places], [given[k] for k in places]
            )
            found |= dict(zip(places, made, strict=True))
        except NotProved as failure:
            found |= dict.fromkeys(places, str(failure))
    return found
