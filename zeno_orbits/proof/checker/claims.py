"""What a proved passage around the orbit says: existence, uniqueness, stability, enclosures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, cast

from zeno_orbits.errors import InputError
from zeno_orbits.proof.checker.balls import (
    Ball,
    Matrix,
    NotProved,
    Vector,
    added,
    dot,
    entries,
    identity,
    matrix,
    middles,
    modulus,
    require,
    solved,
    times,
    vector,
)
from zeno_orbits.proof.checker.motion import Enclosure
from zeno_orbits.proof.checker.section import Box


@dataclass(frozen=True, kw_only=True)
class Passage:
    """A proved passage: from a box of the section once around to its image.

    Attributes:
        n_x: Number of states.
        places: States that are the section's coordinates.
        box: The box.
        start: The set that the box lies in.
        end: The set that it has become.
        times: When what happens, by its name: the centre's time, and its derivative.
    """

    n_x: int
    places: Sequence[int]
    box: Box
    start: Enclosure
    end: Enclosure
    times: Mapping[str, Sequence[tuple[Ball, Vector]]]

    @property
    def bits(self) -> int:
        """The unit is ``2^-bits``."""
        return self.start.m[0].bits

    @property
    def one(self) -> int:
        """The number one, in units."""
        return 1 << self.bits

    @property
    def d(self) -> int:
        """Number of section coordinates."""
        return len(self.places)

    @property
    def slope(self) -> Matrix:
        """Derivative of the return map by coordinates and parameters, ``(d, D)``."""
        derivative = self.end.derivative
        return [derivative[k] for k in self.places]

    @property
    def shift(self) -> Vector:
        """What the centre returns to, less the centre, ``(d,)``."""
        end, nothing = self.end, [Ball(0, 0, x.bits) for x in self.end.spread]
        point = end.image(end.m, end.Q, end.derivative, nothing)
        return [point[k] - c for k, c in zip(self.places, self.box.centre, strict=False)]

    @cached_property
    def fixed_points(self) -> tuple[Vector, Vector]:
        """Where fixed points are, less the centre, by Krawczyk's operator, once and twice."""
        return (once := self._krawczyk(self.box.spread)), self._krawczyk(once)

    def _krawczyk(self, spread: Vector) -> Vector:
        d = self.d
        if d == 0:
            return list(spread)
        ones = identity(d, self.bits)
        off = added(ones, [[-x for x in row[:d]] for row in self.slope])
        Y = middles(solved(middles(off), ones))
        rest = added(ones, [[-x for x in row] for row in times(Y, off)])
        by_over = times(Y, [row[d:] for row in self.slope])
        newton = times(Y, [[x] for x in self.shift])
        rows = zip(newton, rest, by_over, strict=True)
        found = [x + dot((*y, *z), spread) for (x,), y, z in rows]
        return [*found, *self.box.spread[d:]]

    def at_orbit(self, value: Ball, slope: Vector) -> Ball:
        """Return a function of the coordinates at the fixed point, by the mean value theorem."""
        return value if not slope else value + dot(slope, self.fixed_points[1])

    def turned(self, basis: Any) -> list[list[tuple[Ball, Ball]]]:
        """Return ``T^-1 DP T`` as real and imaginary parts, ``(d, d)``."""
        d, zero = self.d, Ball(0, 0, self.bits)
        re, im = (matrix(part, d, d, self.bits) for part in entries(basis, "re", "im"))
        rows = [[*a, *(-x for x in b)] for a, b in zip(re, im, strict=True)]
        rows += [[*b, *a] for a, b in zip(re, im, strict=True)]
        square = [row[:d] for row in self.slope]
        both = [[*row, *[zero] * d] for row in square] + [[*[zero] * d, *row] for row in square]
        found = solved(rows, times(both, rows))
        return [[(found[i][j], found[d + i][j]) for j in range(d)] for i in range(d)]

    def discs(self, basis: Any) -> list[tuple[int, int, int]]:
        """Return Gershgorin's discs: real and imaginary part of the centre, radius, in units."""
        return [
            (
                row[i][0].m,
                row[i][1].m,
                row[i][0].r + row[i][1].r + sum(modulus(*x) for j, x in enumerate(row) if j != i),
            )
            for i, row in enumerate(self.turned(basis))
        ]


def _exists(passage: Passage, by: Any) -> str:
    """Show that the return map has a fixed point in the box."""
    if by not in ("inclusion", "krawczyk"):
        raise InputError("The certificate's `by` must be inclusion or krawczyk.")
    spread = passage.box.spread
    images = passage.fixed_points[0][: passage.d]
    if by == "inclusion":
        images = [x + dot(row, spread) for x, row in zip(passage.shift, passage.slope, strict=True)]
    for k, (image, bound) in enumerate(zip(images, spread, strict=False)):
        require(image.size < bound.r, f"coordinate {k} leaves the box: {image.shown()}")
    shares = [image.size / bound.r for image, bound in zip(images, spread, strict=False)]
    return f"the image takes {max(shares, default=0.0):.2g} of the box"


def _unique(passage: Passage) -> str:
    return _exists(passage, "krawczyk")


def _stable(passage: Passage, basis: Any) -> str:
    rows = passage.turned(basis)
    norm = max((sum(modulus(*entry) for entry in row) for row in rows), default=0)
    require(norm < passage.one, f"the norm of the derivative is {norm / passage.one:.6g}")
    return f"the norm of the derivative is {norm / passage.one:.6g}"


def _repelling(passage: Passage, basis: Any) -> str:
    discs, one = passage.discs(basis), passage.one
    for k, (x, y, r) in enumerate(discs):
        others = discs[:k] + discs[k + 1 :]
        apart = all((x - a) ** 2 + (y - b) ** 2 > (r + c) ** 2 for a, b, c in others)
        if apart and x * x + y * y > (one + r) ** 2:
            return f"a multiplier is at {x / one:.6g} + {y / one:.6g} i"
    raise NotProved("no multiplier is outside the unit circle for certain")


def _multipliers(passage: Passage, basis: Any, discs: Any) -> str:
    if not isinstance(discs, list) or len(cast("list[Any]", discs)) != passage.d:
        raise InputError("The certificate must have a disc for every multiplier.")
    for (x, y, r), disc in zip(passage.discs(basis), cast("list[Any]", discs), strict=True):
        a, b, c = (ball.m for ball in vector(disc, 3, passage.bits))
        require(c >= r and (x - a) ** 2 + (y - b) ** 2 <= (c - r) ** 2, "a disc is too small")
    return f"{passage.d} discs of Gershgorin"


def _timed(name: str) -> Callable[..., str]:
    def claim(passage: Passage, low: Any, high: Any, which: Any = 0) -> str:
        known = passage.times[name]
        if type(which) is not int or not 0 <= which < len(known):
            raise InputError(f"The certificate's `which` must be one of {len(known)} events.")
        return _within(passage, [passage.at_orbit(*known[which])], [low], [high])

    return claim


def _start_state(passage: Passage, low: Any, high: Any) -> str:
    start = passage.start
    point = start.image(start.m, start.Q, start.derivative, passage.fixed_points[1])
    return _within(passage, point[: passage.n_x], low, high)


def _within(passage: Passage, found: Vector, low: Any, high: Any) -> str:
    lows, highs = (vector(ends, len(found), passage.bits) for ends in (low, high))
    for a, x, b in zip(lows, found, highs, strict=True):
        require(a.m <= x.low and x.high <= b.m, f"it is {x.shown()}")
    return ", ".join(x.shown() for x in found)


class Claim(NamedTuple):
    """A kind of claim: its entries beside name and pass, its proof, and if it needs an orbit."""

    entries: tuple[str, ...]
    shown: Callable[..., str]
    of_orbit: bool = True


CLAIMS = {
    "exists": Claim(("by",), _exists, False),
    "unique": Claim((), _unique, False),
    "stable": Claim(("basis",), _stable),
    "repelling": Claim(("basis",), _repelling),
    "multipliers": Claim(("basis", "discs"), _multipliers),
    "period": Claim(("low", "high"), _timed("period")),
    "zeno_time": Claim(("low", "high", "which"), _timed("zeno_time")),
    "impact_time": Claim(("low", "high", "which"), _timed("impact_time")),
    "start_state": Claim(("low", "high"), _start_state),
}


def show(passage: Passage, claim: Mapping[str, Any]) -> str:
    """Prove a claim about a passage, and return what proves it.

    Raises:
        NotProved: If it is not proved.
        InputError: If it is no claim.
    """
    kind = CLAIMS[claim["name"]]
    given = entries(claim, "name", "pass", *kind.entries)[2:]
    if kind.of_orbit:
        try:
            _exists(passage, "krawczyk")
        except NotProved:
            _exists(passage, "inclusion")
    return kind.shown(passage, *given)
