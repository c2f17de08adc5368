r"""Sets of states that are propagated from step to step, with their derivatives.

A set encloses the motions from all start coordinates `u` in a box `U` around :math:`u_c`:
:math:`z(u_c) \in m + Q r` and :math:`\partial z / \partial u \in C + Q R`. By the mean value
theorem :math:`z(u) \in m + Q r + (C + Q R)(u - u_c)`. The frame `Q` turns with the flow, since
otherwise boxes would grow from step to step [Lohner1987]_. Its directions are orthogonal in units
in which the flow is balanced. A stage is a set with its mode, the times of its motions and the
units of the next record.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import partial
from typing import Any

import numpy as np
from flint import arb, ctx
from scipy.linalg import qr

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ProofError
from zeno_orbits.proof.arithmetic.balls import (
    ZERO,
    Ball,
    Matrix,
    identity,
    mapped,
    matrix,
    middle,
    product,
    scaled,
    symmetric,
)

NEW_WIDER = 1.5
"""Factor by which a derivative is widened, so that the checker's arithmetic also confirms it."""
MACHINE_WIDER = 3.0
"""The same for machines with several stops or switches, whose formulas are longer."""
_SWEEPS = 20
_FARTHEST = 12
"""Largest exponent of a unit, a power of two, in which a flow is balanced."""
_SLACK = 1e-4
"""Relative enlargement of a set, so that it is also large enough in the checker's arithmetic."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BallSet:
    """States and derivatives over a box of start coordinates.

    Attributes:
        m: Point near the motion from the middle of the box, exact, ``(n,)``.
        frame: `Q`, exact, ``(n, n)``.
        r: Deviation of the motion from the middle from ``m``, in the frame, around zero, ``(n,)``.
        C: Matrix near the derivative, exact, ``(n, d)``.
        R: Deviation of the derivative from ``C``, in the frame, around zero, ``(n, d)``.
        U: Start coordinates minus the coordinates of the middle, around zero, ``(d,)``.
        wider: Factor by which derivatives are widened.
    """

    m: list[Ball]
    frame: Matrix
    r: list[Ball]
    C: Matrix
    R: Matrix
    U: list[Ball]
    wider: float = NEW_WIDER

    @property
    def noise(self) -> list[Ball]:
        """The motion from the middle minus ``m``, ``(n,)``."""
        return product(self.frame, self.r)

    @property
    def derivative(self) -> Matrix:
        """The derivative with respect to the start coordinates, ``(n, d)``."""
        return self.C + self.frame * self.R

    @property
    def deviation(self) -> list[Ball]:
        """All states minus ``m``, ``(n,)``."""
        spread = product(self.derivative, self.U)
        return [a + b for a, b in zip(self.noise, spread, strict=True)]

    @property
    def box(self) -> list[Ball]:
        """All states, ``(n,)``."""
        return [a + b for a, b in zip(self.m, self.deviation, strict=True)]

    @property
    def middle_box(self) -> list[Ball]:
        """The motion from the middle, ``(n,)``."""
        return [a + b for a, b in zip(self.m, self.noise, strict=True)]

    def mapped(
        self,
        image: Sequence[Ball],
        derivative: Matrix,
        rows: Sequence[int],
        metric: Vector,
        *,
        fine: bool = False,
    ) -> BallSet:
        """Return the set after a map.

        Args:
            image: Image of ``m``, ``(n,)``.
            derivative: Derivative of the map over the whole set, ``(n, n)``.
            rows: Rows that share a frame. The other rows keep their axes.
            metric: Unit of each state in which directions are orthogonal, powers of two, ``(n,)``.
            fine: True if a state of the shared frame must keep its relative precision near zero.
        """
        # Only the new terms are widened. The propagated terms hardly need any slack.
        derivative = mapped(derivative, partial(scaled, factor=self.wider))
        moved, spread = derivative * self.frame, derivative * self.C
        frame = self._frame(moved, list(rows), metric)
        try:
            back = frame.inv()
        except ZeroDivisionError as error:
            raise ProofError("set", "the frame of the set is singular") from error
        m, spare = [one.mid() for one in image], (0.0, 0.0) if fine else _SPARE
        C = mapped(spread, middle)
        turned = back * moved
        off = [scaled(one, _POINT_WIDER) - exact for one, exact in zip(image, m, strict=True)]
        r = [a + b for a, b in zip(product(turned, self.r), product(back, off), strict=True)]
        spread_in_frame = turned * self.R + back * (spread - C)
        # The checker computes derivatives in hardware numbers, in which terms cancel less exactly.
        terms = mapped(back, _size) * mapped(derivative, _size)
        framed, reach = terms * mapped(self.frame, _size), mapped(self.R, _size)
        R = spread_in_frame + mapped(terms * mapped(self.C, _size) + framed * reach, _rounded)
        rounding = product(framed, [_size(one) for one in self.r])
        r = [one + _rounded(more) for one, more in zip(r, rounding, strict=True)]
        # A polynomial motion has no remainder, but the checker rounds it.
        smallest = arb(0, arb(2) ** (_LEAST - ctx.prec))
        least = [smallest if k in rows and not fine else ZERO for k in range(len(r))]
        # A derivative that vanishes exactly is rounded in the checker.
        tiny = [smallest if k in rows else ZERO for k in range(len(r))]
        return BallSet(
            m=m,
            frame=frame,
            r=[_with_slack(one, spare[0] * (k in rows), least[k]) for k, one in enumerate(r)],
            C=C,
            R=matrix(
                [
                    [_with_slack(one, spare[1] * (k in rows), tiny[k]) for one in row]
                    for k, row in enumerate(R.table())
                ],
                R.ncols(),
            ),
            U=self.U,
            wider=self.wider,
        )

    def _frame(self, moved: Matrix, rows: list[int], metric: Vector) -> Matrix:
        """Return a frame along the longest directions of the set."""
        n = len(self.m)
        frame = np.eye(n)
        lengths = np.array(
            [
                sum(float((self.R[k, j] * u).rad()) for j, u in enumerate(self.U))
                + float(self.r[k].rad())
                for k in range(n)
            ]
        )
        directions = np.array([[float(moved[i, k].mid()) for k in range(n)] for i in range(n)])
        directions = directions * lengths / metric[:, None]
        frame[np.ix_(rows, rows)] = metric[rows, None] * orthogonal(directions[rows])
        return matrix([[arb(float(x)) for x in row] for row in frame], n)


def orthogonal(directions: Vector) -> Vector:
    """Return an orthogonal matrix by QR decomposition with column pivoting.

    Each column is the direction with the longest component orthogonal to the previous columns. If a
    stiff flow makes directions nearly parallel, an order by their whole lengths would leave only
    rounding errors for the second column, and boxes would grow by a third from step to step.
    """
    largest = float(np.max(np.abs(directions), initial=0.0))
    if not 0.0 < largest < math.inf:
        return np.eye(len(directions))
    return np.asarray(qr(directions / largest, pivoting=True)[0], dtype=np.float64)


_POINT_WIDER = 16.0
"""Factor by which the error of a point is widened: another a-priori box has other remainders."""


def _size(x: Ball) -> Ball:
    return abs(x).upper()


def _rounded(size: Ball) -> Ball:
    return arb(0, size * _DOUBLES)


def _with_slack(x: Ball, spare: float = 0.0, least: Ball = ZERO) -> Ball:
    """Return a slightly larger interval around zero. Zero becomes the least interval."""
    if x.is_zero():
        return least
    return scaled(symmetric(x), 1 + _SLACK) + arb(0, arb(2) ** (_LEAST - ctx.prec) + spare)


_SPARE = (2.0**-72, 2.0**-44)
"""Smallest nonzero interval of a state in the shared frame, and of a derivative.

It is below the remainders of steps, which differ between the two arithmetics.
"""
_DOUBLES = 2.0**-44
"""Allowance for rounding of a derivative in hardware numbers, relative to its terms."""
_GIVEN_WIDER = 4.0
"""Factor by which a computed row of a start is widened: the checker computes it differently."""
_LEAST = -20
"""Smallest interval of a set, as a power of two relative to one unit in the last place of 1."""


def start_set(
    m: Sequence[Ball],
    derivative: Matrix,
    box: Sequence[Ball],
    given: Sequence[int],
    wider: float = NEW_WIDER,
) -> BallSet:
    """Return the set of a start, from its middle and its derivative in balls.

    Args:
        m: The state at the middle of the box, ``(n,)``.
        derivative: Derivative of the state with respect to the start coordinates, ``(n, d)``.
        box: Start coordinates minus the coordinates of the middle, around zero, ``(d,)``.
        given: Computed rows, which may not be exact zeros in another arithmetic.
        wider: Factor by which derivatives are widened.
    """
    n = len(m)
    exact, C = [one.mid() for one in m], mapped(derivative, middle)
    r = [one - middle_ for one, middle_ in zip(m, exact, strict=True)]
    rows = (derivative - C).table()
    spare = arb(0, arb(2) ** (_LEAST - ctx.prec))
    for k in given:
        r[k] = scaled(r[k], _GIVEN_WIDER) + spare
        rows[k] = [scaled(one, _GIVEN_WIDER) + spare for one in rows[k]]
    return BallSet(
        m=exact,
        frame=identity(n),
        r=[_with_slack(one) for one in r],
        C=C,
        R=mapped(matrix(rows, len(box)), _with_slack),
        U=list(box),
        wider=wider,
    )


def balanced(slopes: Matrix) -> Vector:
    """Return units of the states in which a matrix is balanced [Osborne1960]_, powers of two.

    With a stiff spring, displacement and rate of a mass follow an elongated ellipse. Frames that
    are orthogonal in units of its axes turn with the motion. Other frames widen the set at every
    turn.

    Args:
        slopes: Derivative of a flow, ``(n, n)``.
    """
    n = slopes.nrows()
    sizes = np.array([[abs(float(slopes[i, j].mid())) for j in range(n)] for i in range(n)])
    np.fill_diagonal(sizes, 0.0)
    units = np.ones(n)
    for _ in range(_SWEEPS):
        before = units.copy()
        for k in range(n):
            given, taken = sizes[:, k] @ (units[k] / units), sizes[k] @ (units / units[k])
            if 0.0 < given < math.inf and 0.0 < taken < math.inf:
                exponent = round(math.log2(units[k]) + math.log2(taken / given) / 2)
                units[k] = 2.0 ** max(-_FARTHEST, min(_FARTHEST, exponent))
        if np.array_equal(units, before):
            break
    return units


class Departure(Enum):
    """Mode in which the motions of a set continue, and their position relative to the stop."""

    FLYING = "flying"
    RELEASED = "released"
    STRUCK = "struck"
    OPENED = "opened"
    LOCKED = "locked"


@dataclass(frozen=True, slots=True, kw_only=True)
class BallTime:
    """Times of the motions of a set: the time of the middle motion, and the derivative.

    Attributes:
        middle: Time of the motion from the middle of the start box [s].
        slopes: Derivative with respect to the start coordinates, over the whole box, ``(d,)``.
    """

    middle: Ball
    slopes: tuple[Ball, ...]

    @classmethod
    def start(cls, d: int) -> BallTime:
        """Return time zero, with ``d`` start coordinates."""
        return cls(middle=ZERO, slopes=(ZERO,) * d)

    def later(self, duration: Ball, slopes: Sequence[Ball] = ()) -> BallTime:
        """Return the times after a duration, which may change with the start coordinates."""
        added = slopes or (ZERO,) * len(self.slopes)
        return BallTime(
            middle=self.middle + duration,
            slopes=tuple(a + b for a, b in zip(self.slopes, added, strict=True)),
        )

    def at(self, offset: Sequence[Ball]) -> Ball:
        """Return the time at start coordinates, given as offsets from the middle."""
        return sum((a * b for a, b in zip(self.slopes, offset, strict=True)), self.middle)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofRecord:
    """One inclusion, from a set to the next set.

    Attributes:
        kind: ``step``, ``cross``, ``impact`` or ``tail``.
        numbers: The numbers of the record, exact.
        orders: Orders of a Taylor step, empty for other records.
        result: The propagated set.
        fields: Further entries of the record, plain data: event of a crossing, sides of the kinks.
        places: Indices of the states with a radius in a tail.
    """

    kind: str
    numbers: dict[str, Any]
    orders: tuple[int, ...]
    result: BallSet
    fields: dict[str, Any] = field(default_factory=dict[str, Any])
    places: Sequence[int] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofStage:
    """A set at a stage of its period.

    Attributes:
        at: The set.
        departure: Mode in which the set continues.
        time: Time since the start.
        metric: Units of the states in which the flow is balanced, powers of two, ``(n,)``.
        stop: Index of the stop that was met last.
        sides: Side of every kink.
        held: Index of another stop that is held closed, or -1.
        switched: Index of the switch that was crossed just before and whose guard is zero, or None.
    """

    at: BallSet
    departure: Departure
    time: BallTime
    metric: Vector
    stop: int = 0
    sides: tuple[bool, ...] = ()
    held: int = -1
    switched: int | None = None

    @classmethod
    def started(
        cls, at: BallSet, departure: Departure, view: tuple[int, tuple[bool, ...], int]
    ) -> ProofStage:
        """Return the stage of a set on the section at time zero, by stop, sides and held stop."""
        stop, sides, held = view
        return cls(
            at=at,
            departure=departure,
            stop=stop,
            sides=sides,
            held=held,
            time=BallTime.start(len(at.U)),
            metric=np.ones(len(at.m)),
        )

    @property
    def view(self) -> tuple[int, tuple[bool, ...], int]:
        """The stop that was met last, the sides, and the held stop."""
        return self.stop, self.sides, self.held

    @property
    def closed(self) -> dict[int, int]:
        """Each closed stop, and the other closed stop or -1."""
        locked = self.departure is Departure.LOCKED
        closed = {self.stop: self.held} if locked else dict[int, int]()
        if self.held >= 0:
            closed[self.held] = self.stop if locked else -1
        return closed

    def seen(self, stop: int) -> tuple[int, tuple[bool, ...], int]:
        """Return the view of a stop, in which the other closed stop is held.

        Raises:
            ProofError: If two other stops are closed.
        """
        others = [k for k in self.closed if k != stop]
        if len(others) > 1:
            raise ProofError("shape", "a third stop is met while two stops are closed")
        return stop, self.sides, others[0] if others else -1

    def timed(self, duration: Ball, row: Matrix) -> BallTime:
        """Return the times after an event.

        Args:
            duration: Duration to the event, for ``m``.
            row: Derivative of the duration with respect to the state, ``(1, n)``.
        """
        slopes: list[Ball] = (row * self.at.derivative).entries() if self.at.U else []
        (noise,) = product(row, self.at.noise)
        return self.time.later(duration + noise, slopes)

    def next(self, result: BallSet, departure: Departure, time: BallTime) -> ProofStage:
        """Return the stage after a record."""
        return replace(self, at=result, departure=departure, time=time, switched=None)
