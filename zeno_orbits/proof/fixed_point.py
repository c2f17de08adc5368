r"""The fixed point of a return map, from its image of a point and its derivative over a box.

Krawczyk's operator, with :math:`Y \approx (1 - DP)^{-1}`,

.. math:: K = u_c - Y (u_c - P(u_c)) + (1 - Y (1 - DP(U)))(U - u_c)

holds every fixed point in `U`; if it lies inside `U` there is one, and no other [Krawczyk1969]_.
All boxes here are less :math:`u_c`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb

from zeno_orbits.errors import ProofError
from zeno_orbits.proof.balls import Ball, Matrix, identity, mapped, matrix, middle, product
from zeno_orbits.proof.section import SectionStart
from zeno_orbits.proof.walk import ProofPassage

_SPARE = 1.5
"""How much larger than what it becomes a box is taken."""
_LARGEST = 1e-3
"""Radius of a box beyond which none is tried, per size of a state."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReturnBox:
    """A return map over a box.

    Attributes:
        box: `U`, ``(d,)``.
        shift: :math:`P(u_c) - u_c`, for all carried parameters, ``(d,)``.
        slopes: `DP` over the box, ``(d, d)``.
    """

    box: list[Ball]
    shift: list[Ball]
    slopes: Matrix

    @property
    def image(self) -> list[Ball]:
        """`P(U)`, ``(d,)``."""
        moved = product(self.slopes, self.box)
        return [a + b for a, b in zip(self.shift, moved, strict=True)]

    @property
    def included(self) -> bool:
        """True if the image lies in the interior of the box."""
        return _inside(self.image, self.box)

    def krawczyk(self, box: Sequence[Ball]) -> list[Ball]:
        """Return `K` of a box, ``(d,)``.

        Raises:
            ProofError: If `1 - DP` is not invertible.
        """
        d = len(self.box)
        if not d:
            return []
        eye = identity(d)
        try:
            inverse = mapped((eye - mapped(self.slopes, middle)).inv(), middle)
        except ZeroDivisionError as error:
            raise ProofError("exists", "the orbit has a multiplier of 1") from error
        rest = eye - inverse * (eye - self.slopes)
        return [
            a + b for a, b in zip(product(inverse, self.shift), product(rest, box), strict=True)
        ]

    def encloses(self, found: Sequence[Ball]) -> bool:
        """Return True if a box lies in the interior of `U`."""
        return _inside(found, self.box)


def _inside(inner: Sequence[Ball], outer: Sequence[Ball]) -> bool:
    return all(a.is_finite() and b.contains_interior(a) for a, b in zip(inner, outer, strict=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiplierDiscs:
    """Discs that hold the multipliers: each group of discs apart from the rest holds its number.

    Attributes:
        basis: Approximate eigenvectors as columns, exact, ``(d, d)``.
        centres: Of the discs, exact.
        radii: Of the discs.
        norm: Largest sum of the sizes in a row of `DP` in the basis.
    """

    basis: list[list[complex]]
    centres: list[complex]
    radii: list[Ball]
    norm: Ball

    @property
    def stable(self) -> bool:
        """True if the norm is below 1."""
        return bool(self.norm < 1)

    @property
    def repelling(self) -> bool:
        """True if a disc apart from the others lies outside the unit circle."""
        for k, (centre, radius) in enumerate(zip(self.centres, self.radii, strict=True)):
            apart = all(
                bool(_distance(centre, other) > radius + wide)
                for j, (other, wide) in enumerate(zip(self.centres, self.radii, strict=True))
                if j != k
            )
            if apart and bool(_distance(centre, 0j) - radius > 1):
                return True
        return False


def _distance(a: complex, b: complex) -> Ball:
    return abs(acb(a) - acb(b))


def multiplier_discs(slopes: Matrix) -> MultiplierDiscs:
    """Return discs that hold the eigenvalues of all matrices in a box (Gershgorin).

    Args:
        slopes: The matrices, ``(d, d)``.
    """
    d = slopes.nrows()
    floats = np.array([[float(slopes[i, j].mid()) for j in range(d)] for i in range(d)])
    basis: Any = np.eye(d, dtype=np.complex128)
    if d > 1:
        _, vectors = np.linalg.eig(floats)
        if np.linalg.cond(vectors) < 1e8:
            basis = vectors.astype(np.complex128)
    T = acb_mat(d, d, [acb(complex(x)) for x in basis.ravel()])
    turned = T.inv() * acb_mat(slopes) * T
    centres: list[complex] = []
    radii: list[Ball] = []
    norm = arb(0)
    for k in range(d):
        centre = complex(turned[k, k].mid())
        others = sum((turned[k, j].abs_upper() for j in range(d) if j != k), arb(0))
        centres.append(centre)
        radii.append((others + (turned[k, k] - acb(centre)).abs_upper()).upper())
        norm = norm.max(others + turned[k, k].abs_upper())
    return MultiplierDiscs(
        basis=[[complex(x) for x in row] for row in basis],
        centres=centres,
        radii=radii,
        norm=norm,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedBox:
    """A box once around, with what follows.

    Attributes:
        start: The start.
        passage: Its way.
        returned: The return map.
        orbit: Start coordinates of the periodic orbit less those of the middle, and carried
            parameters, ``(d + n_over,)``.
        discs: Of the multipliers.
    """

    start: SectionStart
    passage: ProofPassage
    returned: ReturnBox
    orbit: list[Ball]
    discs: MultiplierDiscs


@dataclass(frozen=True, slots=True, kw_only=True)
class ReturnAttempt:
    """A box once around, judged.

    Attributes:
        judged: What follows, if the orbit exists.
        defect: Where the middle returns, less the middle, ``(d,)``.
        reason: What is missing.
        needed: Radii of boxes that may do.
    """

    judged: JudgedBox | None
    defect: list[Ball]
    reason: str = ""
    needed: list[list[float]]


def judge(start: SectionStart, passage: ProofPassage) -> ReturnAttempt:
    """Judge the return of a box."""
    places, end, d = start.places, passage.end.at, len(start.places)
    box = end.box
    slopes = end.derivative
    rows = [[slopes[k, j] for j in range(d)] for k in places]
    carried = matrix(
        [[slopes[k, j] for j in range(d, slopes.ncols())] for k in places], slopes.ncols() - d
    )
    middle = end.middle_box
    defect = [middle[k] - centre for k, centre in zip(places, start.centre, strict=True)]
    parameters = start.at.U[d:]
    spread = product(carried, parameters) if parameters else [arb(0)] * d
    returned = ReturnBox(
        box=start.at.U[:d],
        shift=[a + b for a, b in zip(defect, spread, strict=True)],
        slopes=matrix(rows, d),
    )
    if not all(a.contains(box[k]) for k, a in zip(start.others, start.around, strict=True)):
        reason = "the box does not come back to the part of the section that it started on"
        return ReturnAttempt(judged=None, defect=defect, reason=reason, needed=[])
    found = returned.krawczyk(returned.box)
    if not returned.encloses(found):
        wide = [_SPARE * float(one.abs_upper()) for one in found]
        reason = "the return map is not proved to have a fixed point in the box"
        small = all(w < _LARGEST for w in wide)
        asked = [float(u.rad()) for u in returned.box]
        # A box that holds the one that was asked for is better than a smaller one.
        needed = [[max(w, u) for w, u in zip(wide, asked, strict=True)], wide] if small else []
        return ReturnAttempt(judged=None, defect=defect, reason=reason, needed=needed)
    orbit = [*returned.krawczyk(found), *parameters]
    judged = JudgedBox(
        start=start,
        passage=passage,
        returned=returned,
        orbit=orbit,
        discs=multiplier_discs(returned.slopes),
    )
    return ReturnAttempt(judged=judged, defect=defect, needed=[])
