r"""The fixed point of a return map, from its image of a point and its derivative over a box.

Krawczyk's operator, with :math:`Y \approx (1 - DP)^{-1}`,

.. math:: K = u_c - Y (u_c - P(u_c)) + (1 - Y (1 - DP(U)))(U - u_c)

contains every fixed point in `U`. If it lies inside `U`, exactly one fixed point exists in `U`
[Krawczyk1969]_. If `P(U)`, enclosed in mean value form, lies inside `U`, then `P` contracts `U`,
and exactly one fixed point exists as well. All boxes in this module are relative to :math:`u_c`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb

from zeno_orbits.errors import ProofError
from zeno_orbits.proof.arithmetic.balls import (
    Ball,
    Matrix,
    identity,
    mapped,
    matrix,
    middle,
    product,
)
from zeno_orbits.proof.integration.section import SectionStart
from zeno_orbits.proof.integration.walk import ProofPassage

_SPARE = 1.5
"""Factor by which a box is taken larger than its image."""
_LARGEST = 1e-3
"""Largest trial radius of a box, relative to the size of each state."""
_CONTRACTION = 0.25
"""Target for the spectral radius of the bounds of Krawczyk's operator on a smaller box."""
_BASIS_UNIT = 2.0**60
_NOISE = 3.0
"""Smallest radius of a box as a multiple of the rounding of Newton's step."""


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
        """True if the image lies in the interior of the box: the return map contracts the box."""
        return _inside(self.image, self.box)

    def krawczyk(self, box: Sequence[Ball]) -> list[Ball]:
        """Return `K` of a box, ``(d,)``.

        Raises:
            ProofError: If `1 - DP` is not invertible.
        """
        if not self.box:
            return []
        rest, moved = self.newton()
        return [a + b for a, b in zip(moved, product(rest, box), strict=True)]

    def newton(self) -> tuple[Matrix, list[Ball]]:
        """Return `1 - Y (1 - DP)`, and the step of Newton's method from the middle, ``(d,)``.

        Raises:
            ProofError: If `1 - DP` is not invertible.
        """
        eye = identity(len(self.box))
        try:
            inverse = mapped((eye - mapped(self.slopes, middle)).inv(), middle)
        except ZeroDivisionError as error:
            raise ProofError("exists", "the orbit has a multiplier of 1") from error
        return eye - inverse * (eye - self.slopes), product(inverse, self.shift)

    def encloses(self, found: Sequence[Ball]) -> bool:
        """Return True if a box lies in the interior of `U`."""
        return _inside(found, self.box)


def _inside(inner: Sequence[Ball], outer: Sequence[Ball]) -> bool:
    return all(a.is_finite() and b.contains_interior(a) for a, b in zip(inner, outer, strict=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiplierDiscs:
    """Discs whose union contains the multipliers.

    A group of k discs that is separate from the other discs contains exactly k multipliers.

    Attributes:
        basis: Approximate eigenvectors as columns, exact, ``(d, d)``.
        centres: Centres of the discs, exact.
        radii: Radii of the discs.
        norm: Largest sum of absolute values in a row of `DP` in the basis.
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
        """True if a disc separate from the others lies outside the unit circle."""
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
    """Return discs that contain the eigenvalues of all matrices in a box (Gershgorin).

    Args:
        slopes: The matrices, ``(d, d)``.
    """
    d = slopes.nrows()
    floats = np.array([[float(slopes[i, j].mid()) for j in range(d)] for i in range(d)])
    basis: Any = np.eye(d, dtype=np.complex128)
    if d > 1:
        _, vectors = np.linalg.eig(floats)
        if np.linalg.cond(vectors) < 1e8:
            # Numbers of a certificate have a fixed unit.
            basis = np.rint(vectors * _BASIS_UNIT) / _BASIS_UNIT
    T = acb_mat(d, d, [acb(complex(x)) for x in basis.ravel()])
    turned = T.inv() * acb_mat(slopes) * T
    centres: list[complex] = []
    radii: list[Ball] = []
    norm = arb(0)
    for k in range(d):
        centre = complex(np.rint(complex(turned[k, k].mid()) * _BASIS_UNIT) / _BASIS_UNIT)
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
    """A box with exactly one fixed point of the return map, and the consequences.

    Attributes:
        start: The start.
        passage: Enclosure of one period from the start.
        returned: The return map.
        by_krawczyk: True if Krawczyk's operator maps the box into its interior. If False, the
            return map does.
        orbit: Start coordinates of the fixed point minus the coordinates of the middle, then
            carried parameters, ``(d + n_over,)``.
        discs: Discs of the multipliers.
    """

    start: SectionStart
    passage: ProofPassage
    returned: ReturnBox
    by_krawczyk: bool
    orbit: list[Ball]
    discs: MultiplierDiscs


@dataclass(frozen=True, slots=True, kw_only=True)
class ReturnAttempt:
    """Evaluation of a box after one period.

    Attributes:
        judged: The consequences, if a fixed point exists.
        defect: Image of the middle minus the middle, ``(d,)``.
        reason: Reason of the failure.
        next: Promising boxes to try next: shifts of the middle and radii, ``(d,)`` each.
    """

    judged: JudgedBox | None
    defect: list[Ball]
    reason: str = ""
    next: list[tuple[list[Ball], list[float]]]


def judge(start: SectionStart, passage: ProofPassage) -> ReturnAttempt:
    """Evaluate the return of a box."""
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
        reason = "the box does not return to the part of the section on which it started"
        return ReturnAttempt(judged=None, defect=defect, reason=reason, next=[])
    found = returned.krawczyk(returned.box)
    by_krawczyk = returned.encloses(found)
    if not (by_krawczyk or returned.included):
        reason = "the return map is not proved to have a fixed point in the box"
        return ReturnAttempt(judged=None, defect=defect, reason=reason, next=_next(returned, found))
    near = returned.krawczyk(found) if by_krawczyk else returned.image
    judged = JudgedBox(
        start=start,
        passage=passage,
        returned=returned,
        by_krawczyk=by_krawczyk,
        orbit=[*near, *parameters],
        discs=multiplier_discs(returned.slopes),
    )
    return ReturnAttempt(judged=judged, defect=defect, next=[])


def _next(returned: ReturnBox, found: Sequence[Ball]) -> list[tuple[list[Ball], list[float]]]:
    r"""Return promising boxes after a box has failed.

    The first box is at least as large as the image of the failed box under Krawczyk's operator. The
    second box is centred at the next iterate of Newton's method. Let `W` be the bounds of
    :math:`1 - Y(1 - DP)` on the failed box. The sides of the second box are
    :math:`(1 - W / (2 \rho(W)))^{-1} u`. `W` shrinks this vector in all coordinates if the box is
    small enough, since `W` shrinks with the box.
    """
    d = len(returned.box)
    wide = [_SPARE * float(one.abs_upper()) for one in found]
    asked = [float(u.rad()) for u in returned.box]
    rest, moved = returned.newton()
    bounds = np.array([[float(rest[i, j].abs_upper()) for j in range(d)] for i in range(d)])
    noise = [float(one.rad()) for one in moved]
    if not (np.all(np.isfinite(bounds)) and all(map(math.isfinite, (*wide, *noise)))):
        return []
    boxes: list[tuple[list[Ball], list[float]]] = []
    if all(w < _LARGEST for w in wide):
        still: list[Ball] = [arb(0)] * d
        boxes.append((still, [max(w, u) for w, u in zip(wide, asked, strict=True)]))
    radius = max(float(np.max(np.abs(np.linalg.eigvals(bounds)))), 1e-300)
    sides = np.linalg.solve(np.eye(d) - bounds / (2 * radius), np.array(asked))
    sides = sides * np.min(np.array(asked) / sides) * min(1.0, _CONTRACTION / radius)
    narrow = [max(float(s), _NOISE * n) for s, n in zip(sides, noise, strict=True)]
    boxes.append(([one.mid() for one in moved], narrow))
    return boxes
