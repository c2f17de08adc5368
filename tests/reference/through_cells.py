"""A mass under a piecewise linear force, from knot to knot in closed form, in 40 digits.

In a cell ``x'' = F + s (x - k)``. The energy gives the speed at the next knot, and the logarithm of
``(u w + v)`` or the angle of ``(u, v / w)`` the time to it, with ``w^2 = |s|`` and the distance `u`
from the cell's equilibrium.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field

from mpmath import mp, mpf

DIGITS = 40
_SOON = mpf(10) ** -25


@dataclass(slots=True)
class Course:
    """Times of the knots that are passed, times of impacts, and the state at the end."""

    knots: list[mpf] = field(default_factory=list)
    impacts: list[mpf] = field(default_factory=list)
    end: tuple[mpf, mpf] = (mpf(0), mpf(0))


def through_cells(
    knots: Sequence[float],
    forces: Sequence[float],
    start: float,
    until: float,
    restitution: float,
) -> Course:
    """Return the course of a mass that starts at rest above a stop at zero."""
    with mp.workdps(DIGITS):
        return _course(
            [mpf(one) for one in knots],
            [mpf(one) for one in forces],
            mpf(start),
            mpf(until),
            mpf(restitution),
        )


def _course(k: list[mpf], f: list[mpf], x: mpf, until: mpf, e: mpf) -> Course:
    course, v, t = Course(), mpf(0), mpf(0)
    cell = min(max(bisect_right(k, x) - 1, 0), len(k) - 2)
    while True:
        slope = (f[cell + 1] - f[cell]) / (k[cell + 1] - k[cell])
        ends = [(k[cell], -1)] if cell > 0 else []
        ends += [(k[cell + 1], 1)] if cell < len(k) - 2 else []
        ends += [(mpf(0), 0)] if k[cell] < 0 < k[cell + 1] and (x > 0 or v > 0) else []
        found = [
            (time, end, speed, way)
            for end, way in ends
            for time, speed in _times(x, v, f[cell], slope, k[cell], end, way or -1)
        ]
        time, end, speed, way = min(found, default=(mp.inf, x, v, 0))
        if t + time > until:
            course.end = _moved(x, v, f[cell], slope, k[cell], until - t)
            return course
        t, x, v = t + time, end, speed
        if way:
            course.knots.append(t)
            cell += way
        else:
            course.impacts.append(t)
            v = -e * v


def _times(
    x: mpf, v: mpf, force: mpf, slope: mpf, knot: mpf, end: mpf, way: int
) -> list[tuple[mpf, mpf]]:
    """Return the time to a place and the speed there, or nothing."""
    work = force * (end - x) + slope / 2 * ((end - knot) ** 2 - (x - knot) ** 2)
    square = v * v + 2 * work
    if square < 0:
        return []
    there, w = way * mp.sqrt(square), mp.sqrt(abs(slope))
    if slope == 0:
        time = (there - v) / force
    elif slope > 0:
        u, u_there = x - knot + force / slope, end - knot + force / slope
        above, below = u_there * w + there, u * w + v
        if abs(below) < _SOON:
            above, below = u * w - v, u_there * w - there
        if above / below <= 0:
            return []
        time = mp.log(above / below) / w
    else:
        u, u_there = x - knot + force / slope, end - knot + force / slope
        turn = mp.fmod(mp.atan2(v / w, u) - mp.atan2(there / w, u_there), 2 * mp.pi)
        time = (turn + 2 * mp.pi if turn < _SOON else turn) / w
    return [(time, there)] if time > _SOON else []


def _moved(x: mpf, v: mpf, force: mpf, slope: mpf, knot: mpf, t: mpf) -> tuple[mpf, mpf]:
    if slope == 0:
        return x + v * t + force * t * t / 2, v + force * t
    rest, w = knot - force / slope, mp.sqrt(mp.mpc(slope))
    cosine, sine = mp.cosh(w * t), mp.sinh(w * t)
    return (
        rest + mp.re((x - rest) * cosine + v * sine / w),
        mp.re((x - rest) * w * sine + v * cosine),
    )
