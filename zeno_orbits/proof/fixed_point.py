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


__all__ = ["MultiplierDiscs", "ReturnBox", "matrix", "multiplier_discs"]
