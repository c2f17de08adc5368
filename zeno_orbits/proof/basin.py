"""Search for a large set of initial states that the return map maps into its interior.

The set is a box of the release section. Its image is enclosed in polynomials of its coordinates.
Then the image is enclosed by a smaller box, and so on until the image lies in a box that the return
map contracts: every execution from the set converges to the orbit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from flint import arb

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ProofError, counted
from zeno_orbits.orbits import Orbit
from zeno_orbits.proof.arithmetic.balls import ZERO, Ball, matrix
from zeno_orbits.proof.arithmetic.polynomials import Basis, Polynomial
from zeno_orbits.proof.fixed_point import JudgedBox
from zeno_orbits.proof.integration.ball_system import BallSystem, require_proved
from zeno_orbits.proof.integration.orbit_walk import LEAST_SIZE
from zeno_orbits.proof.integration.polynomial_walk import (
    PhaseDuration,
    PolynomialPass,
    PolynomialSet,
    PolynomialWalk,
)
from zeno_orbits.proof.integration.section import SectionStart, start_on_section
from zeno_orbits.proof.integration.walk import PassageKind, ProofPassage
from zeno_orbits.work import Progress

_LARGEST = 2.0
"""First trial radius of a set, relative to the size of each coordinate."""
_SMALLER = math.sqrt(0.5)
"""Ratio of successive trial radii."""
_MOST_COEFFICIENTS, _HIGHEST_DEGREE = 21, 6
"""Limits of the polynomials, which also limit the time of a step."""
_WITHIN = 0.98
"""Largest image relative to the set around it, so that the checker also confirms it."""
_MOST_SETS = 8
_SPARE = 2.0**-48
"""Smallest remainder of a start, relative to each state: its middle is rounded to doubles."""
_LONGEST = 0.125
"""Longest step, relative to the period."""


def large_sets(
    orbit: Orbit, system: BallSystem, found: JudgedBox, on_progress: Progress
) -> Iterator[list[PolynomialPass]]:
    """Yield ever smaller sets around a box, each with the sets that lead from its image to the box.

    Trial sets shrink by a constant factor until the image of a set lies in its interior. A list
    contains only this set if the images are not proved to reach the box. Doubles compute the sets,
    so the checker may refuse one: then the next one has half the radius.

    Args:
        orbit: The orbit.
        system: Its problem in balls.
        found: A box that the return map contracts.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        ProofError: If no further set is larger than the box, or the section is a single point.
    """
    d = len(found.start.places)
    if not d:
        raise ProofError("basin", "the section is a single point")
    box = np.array([float(one.rad()) for one in found.start.at.U])
    sizes = [max(abs(float(found.start.at.m[k].mid())), LEAST_SIZE) for k in found.start.places]
    factor = _LARGEST / float(np.max(box[:d] / np.array(sizes)))
    count, reason = 0, "box 1 is already larger than the largest trial set"
    while factor > 1.0:
        radii = np.concatenate([factor * box[:d], box[d:]])
        count += 1
        try:
            tried = _pass(orbit, system, found, radii, on_progress)
            inside = bool(np.all(_image(tried)[:d] < _WITHIN * radii[:d]))
            require_proved(inside, "basin", "the image of the set is not inside the set")
        except ProofError as error:
            reason = f"none of {counted(count, 'trial set')} succeeds. The smallest is"
            reason += f" {factor:.3g} times as large as box 1: {error.reason}"
            factor *= _SMALLER
            continue
        yield _chain(orbit, system, found, tried, on_progress)
        factor /= 2.0
    raise ProofError("basin", reason)


def _chain(
    orbit: Orbit,
    system: BallSystem,
    found: JudgedBox,
    first: PolynomialPass,
    on_progress: Progress,
) -> list[PolynomialPass]:
    """Return a set with the sets that lead from its image to a box, or alone without them."""
    d, sets = len(found.start.places), [first]
    box = np.array([float(one.rad()) for one in found.start.at.U])
    while len(sets) < _MOST_SETS:
        image = _image(sets[-1])
        if bool(np.all(image[:d] < _WITHIN * box[:d])):
            return sets
        radii = np.concatenate([np.maximum(image[:d] / _WITHIN**2, box[:d] / 2), box[d:]])
        try:
            sets.append(_pass(orbit, system, found, radii, on_progress))
        except ProofError:
            break
    return sets[:1]


def _image(one: PolynomialPass) -> Vector:
    """Return the largest distance of the image from the middle, for each coordinate."""
    last = one.records[-1].result.box
    pairs = zip(one.start.places, one.start.centre, strict=True)
    return np.array([float((last[k] - centre).abs_upper()) for k, centre in pairs])


def _pass(
    orbit: Orbit,
    system: BallSystem,
    found: JudgedBox,
    radii: Vector,
    on_progress: Progress,
) -> PolynomialPass:
    """Return the enclosure of one period from a box with given radii.

    Raises:
        ProofError: If a condition is not proved.
    """
    what = f"follow a set of radius {max(radii):.0e}"

    def tell(doing: str, time: float) -> None:
        on_progress(f"{what}, {doing}", min(time / orbit.period, 1.0))

    old = found.start
    start = start_on_section(system, old.at.m, old.places, old.others, list(radii))
    first = _first(system, start)
    phases = _phases(found.passage, [float(one.rad()) for one in start.at.U])
    walk = PolynomialWalk(system, first, phases, _LONGEST * orbit.period, tell)
    walk.follow(orbit.shape.n_releases)
    last = walk.set.box
    back = all(bool(a.contains(last[k])) for k, a in zip(start.others, start.around, strict=True))
    require_proved(back, "basin", "the set does not return to its part of the section")
    return PolynomialPass(start=start, first=first, records=tuple(walk.records))


def _first(system: BallSystem, start: SectionStart) -> PolynomialSet:
    """Return the section's points over a box as polynomials of the coordinates."""
    n, others, n_others = system.n, start.others, len(start.others)
    inputs = [*start.places, *range(n - len(system.carried), n)]
    basis = Basis.of(len(inputs), degree_for(len(inputs)))
    y = [Polynomial.constant(basis, float(value.mid())) for value in start.at.m]
    for j, k in enumerate(inputs):
        y[k].c[basis.variable(j)] = float(start.at.U[j].rad())

    def inverse(box: Sequence[Ball]) -> list[list[Ball]]:
        rows = [[ZERO] * n for _ in range(n_others)]
        places = zip(system.constraint_places, system.constraints(box)[1], strict=True)
        for (row, col), one in places:
            rows[row][col] = one
        try:
            return matrix([[row[k] for k in others] for row in rows], n_others).inv().table()
        except ZeroDivisionError:
            raise ProofError("start", "the release section is not smooth there") from None

    middle = inverse([arb(float(one.c[0])) for one in y])
    for _ in range(basis.degree + 2):
        values = system.constraints(y)[0]
        for k, row in zip(others, middle, strict=True):
            step = sum((float(a.mid()) * v for a, v in zip(row, values, strict=True)), 0.0)
            y[k] = Polynomial(basis, (y[k] - step).c, 0.0)
    box = [one.ball for one in y]
    for k, around in zip(others, start.around, strict=True):
        box[k] = around
    values = [one.ball.abs_upper() for one in system.constraints(y)[0]]
    r = np.zeros(n)
    for k in inputs:
        r[k] = _SPARE * y[k].size
    for k, row in zip(others, inverse(box), strict=True):
        off = sum((a.abs_upper() * v for a, v in zip(row, values, strict=True)), ZERO)
        r[k] = 4.0 * float(off.abs_upper()) + _SPARE * y[k].size
    return PolynomialSet(p=y, frame=np.eye(n), r=r)


def degree_for(n_variables: int) -> int:
    """Return the degree of polynomials of a number of variables."""
    fits = [
        degree
        for degree in range(1, _HIGHEST_DEGREE + 1)
        if math.comb(n_variables + degree, degree) <= _MOST_COEFFICIENTS
    ]
    return max(fits, default=1)


def _phases(passage: ProofPassage, radii: Sequence[float]) -> Callable[[bool], PhaseDuration]:
    """Return a function that returns the next phase, in flight or in contact, to first order."""
    events = iter(passage.events)
    last = [0.0, *(0.0 for _ in radii)]

    def phases() -> Iterator[tuple[PassageKind, PhaseDuration]]:
        nonlocal last
        for event in events:
            time = event.stage.time
            slopes = [float(x.mid()) * r for x, r in zip(time.slopes, radii, strict=True)]
            now = [float(time.middle.mid()), *slopes]
            change = [a - b for a, b in zip(now, last, strict=True)]
            last = now
            yield event.kind, PhaseDuration(duration=change[0], slopes=change[1:])

    following = phases()

    def take(held: bool) -> PhaseDuration:
        for kind, phase in following:
            if kind is PassageKind.IMPACT and not held:
                return phase
            if kind is PassageKind.RELEASE and held:
                return phase
            if not held:
                break
        raise ProofError("zeno_point", "the impacts of a set are not resolved as far as needed")

    return take
