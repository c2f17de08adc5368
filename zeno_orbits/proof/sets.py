r"""Sets of states handed on from step to step, with their derivatives.

A set is what the motions from all start coordinates `u` in a box `U` around :math:`u_c` have come
to: :math:`z(u_c) \in m + Q r` and :math:`\partial z / \partial u \in C + Q R`, so by the mean value
theorem :math:`z(u) \in m + Q r + (C + Q R)(u - u_c)`. The frame `Q` turns with the flow, or boxes
would grow from step to step [Lohner1987]_.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from flint import arb, ctx
from scipy.linalg import qr

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ProofError
from zeno_orbits.proof.balls import (
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

_SLACK = 1e-6
"""How much more than needed a set is given, so that another arithmetic finds it large enough."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BallSet:
    """States and derivatives over a box of start coordinates.

    Attributes:
        m: Near the motion from the middle of the box, exact, ``(n,)``.
        frame: `Q`, exact, ``(n, n)``.
        r: How far the motion from the middle is from ``m`` in the frame, around zero, ``(n,)``.
        C: Near the derivative, exact, ``(n, d)``.
        R: How far the derivative is from it in the frame, around zero, ``(n, d)``.
        U: Start coordinates less those of the middle, around zero, ``(d,)``.
    """

    m: list[Ball]
    frame: Matrix
    r: list[Ball]
    C: Matrix
    R: Matrix
    U: list[Ball]

    @property
    def noise(self) -> list[Ball]:
        """The motion from the middle less ``m``, ``(n,)``."""
        return product(self.frame, self.r)

    @property
    def derivative(self) -> Matrix:
        """The derivative with respect to the start coordinates, ``(n, d)``."""
        return self.C + self.frame * self.R

    @property
    def deviation(self) -> list[Ball]:
        """All states less ``m``, ``(n,)``."""
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
        self, image: Sequence[Ball], derivative: Matrix, groups: Sequence[Sequence[int]]
    ) -> BallSet:
        """Return the set after a map.

        Args:
            image: Of ``m``, ``(n,)``.
            derivative: Of the map over the whole set, ``(n, n)``.
            groups: Rows that get a frame of their own; the other rows keep their axes.
        """
        # What is new is given wider: what is handed on from before hardly needs any slack.
        derivative = mapped(derivative, _given_wide)
        moved, spread = derivative * self.frame, derivative * self.C
        frame = self._frame(moved, groups)
        try:
            back = frame.inv()
        except ZeroDivisionError as error:
            raise ProofError("set", "the frame of the set is singular") from error
        m = [one.mid() for one in image]
        C = mapped(spread, middle)
        turned = back * moved
        off = [_given_wide(one) - exact for one, exact in zip(image, m, strict=True)]
        r = [a + b for a, b in zip(product(turned, self.r), product(back, off), strict=True)]
        R = turned * self.R + back * (spread - C)
        return BallSet(
            m=m,
            frame=frame,
            r=[_with_slack(one) for one in r],
            C=C,
            R=mapped(R, _with_slack),
            U=self.U,
        )

    def _frame(self, moved: Matrix, groups: Sequence[Sequence[int]]) -> Matrix:
        """Return a frame along the directions in which the set is longest."""
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
        directions = directions * lengths
        for group in groups:
            rows = list(group)
            frame[np.ix_(rows, rows)] = _orthogonal(directions[rows])
        return matrix([[arb(float(x)) for x in row] for row in frame], n)


def _orthogonal(directions: Vector) -> Vector:
    """Return an orthogonal matrix: at each turn the direction with most left beside the others.

    Where a stiff flow has made directions nearly parallel, the order of their whole lengths would
    leave rounding for the second, and boxes would grow by a third from step to step.
    """
    largest = float(np.max(np.abs(directions), initial=0.0))
    if not 0.0 < largest < math.inf:
        return np.eye(len(directions))
    return np.asarray(qr(directions / largest, pivoting=True)[0], dtype=np.float64)


_NEW_WIDER = 1.25
"""How much wider than found a derivative is given, so that another arithmetic finds it, too."""


def _given_wide(x: Ball) -> Ball:
    return scaled(x, _NEW_WIDER)


def _with_slack(x: Ball) -> Ball:
    """Return a somewhat larger interval around zero; nothing but zero stays zero."""
    if x.is_zero():
        return x
    return scaled(symmetric(x), 1 + _SLACK) + arb(0, arb(2) ** (_LEAST - ctx.prec))


_GIVEN_WIDER = 4.0
"""How much wider a computed row of a start is given, for another way to compute it."""
_LEAST = -20
"""Smallest interval of a set, as a power of two below one unit of the last place of 1."""


def start_set(
    m: Sequence[Ball], derivative: Matrix, box: Sequence[Ball], given: Sequence[int]
) -> BallSet:
    """Return the set of a start, from its middle and its derivative in balls.

    Args:
        m: The state at the middle of the box, ``(n,)``.
        derivative: Of the state with respect to the start coordinates, ``(n, d)``.
        box: Start coordinates less those of the middle, around zero, ``(d,)``.
        given: Rows that are computed; another arithmetic may find no exact zeros there.
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
    )
