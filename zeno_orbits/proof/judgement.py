"""What the return of a box says: whether an orbit passes through it, and where."""

from __future__ import annotations

from dataclasses import dataclass

from flint import arb

from zeno_orbits.proof.balls import Ball, matrix, product
from zeno_orbits.proof.fixed_point import MultiplierDiscs, ReturnBox, multiplier_discs
from zeno_orbits.proof.section import SectionStart
from zeno_orbits.proof.walk import ProofPassage


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
        needed: Radii of a box that may do.
    """

    judged: JudgedBox | None
    defect: list[Ball]
    reason: str = ""
    needed: list[float]


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
        wide = [float(one.abs_upper()) for one in found]
        reason = "the return map is not proved to have a fixed point in the box"
        small = all(w < 1e-3 for w in wide)
        needed = [1.5 * w for w in wide] if small else []
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
