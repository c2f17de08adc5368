r"""Is a motion on its way to an orbit that Newton's method has found (theory (29))?

Newton's method also finds orbits that the motion passes by, so the motion itself has to tell: in
section coordinates from the orbit, with the derivative :math:`A` of the return map there.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector

_AGREES = 0.5
"""Part by which a step of the motion may differ from what the derivative at the orbit says."""
_PLACES = 6
"""Places on either side of the orbit from which a slow way to it is looked at."""
_PART = 0.25
"""Part of the rate of the multipliers at which the motion has to come nearer there."""
_REAL = 1e-6
"""Imaginary part of a multiplier that is none."""
_SHARED = 1e-2
"""Part of the time of a return by which two motions that are the same may differ."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """How a motion came to an orbit.

    Attributes:
        times: Of all its returns [s].
        captured: Number of the return from which on it only came nearer to the orbit.
        doubtful: Whether its last return took another time than it takes more accurately.
    """

    times: tuple[float, ...]
    captured: int
    doubtful: bool = False

    def is_shared_by(self, other: Way) -> bool:
        """Return True if another motion makes the same returns up to the orbit."""
        at = self.captured
        usual = self.times[-1] / len(self.times)
        return at < len(other.times) and abs(self.times[at] - other.times[at]) <= _SHARED * usual


def is_approached(before: Vector, after: Vector, jacobian: Vector, reached: float) -> bool:
    """Return True if a step is the one that the derivative tells, to half of it.

    Args:
        before: Where the step began, from the orbit, in section coordinates, ``(m,)``.
        after: Where it ended.
        jacobian: Derivative of the return map, ``(m, m)``.
        reached: Error of the step.
    """
    expected = jacobian @ before
    miss = float(np.max(np.abs(after - expected), initial=0.0))
    step = float(np.max(np.abs(before - expected), initial=0.0))
    return miss <= max(_AGREES * step, reached)


def places_on_the_way(origin: Vector, jacobian: Vector) -> Vector:
    """Return places between a motion and its orbit, and as many beyond it, ``(n, m)``.

    A motion that comes slowly along one direction passes them, on one side or on both in turn.
    There are none where it circles about the orbit.

    Args:
        origin: Where the motion is, from the orbit, in section coordinates, ``(m,)``.
        jacobian: Derivative of the return map, ``(m, m)``.
    """
    values = np.linalg.eigvals(jacobian)
    slowest = values[np.argmax(np.abs(values))]
    if abs(slowest.imag) > _REAL:
        return np.empty((0, len(origin)))
    parts = np.arange(1, _PLACES + 1) / _PLACES
    signs = (1.0, -1.0) if slowest.real < 0.0 else (1.0,)
    return np.concatenate([np.outer(sign * parts, origin) for sign in signs])


def all_come_nearer(places: Vector, images: Vector, jacobian: Vector) -> bool:
    r"""Return True if a return leads nearer to the orbit from each place.

    Near is measured along the eigenvectors of :math:`A`, where it brings all nearer by the spectral
    radius; a part of that rate is asked for.

    Args:
        places: From the orbit, in section coordinates, ``(n, m)``.
        images: Where they return to, ``(n, m)``.
        jacobian: Derivative of the return map at the orbit, ``(m, m)``.
    """
    values, vectors = np.linalg.eig(jacobian)
    rate = 1.0 - float(np.max(np.abs(values)))

    along = np.linalg.pinv(vectors)

    def away(rows: Vector) -> Vector:
        return np.max(np.abs(rows @ along.T), axis=1)

    return bool(np.all(away(images) <= (1.0 - _PART * rate) * away(places)))


def steps_towards(passed: Sequence[Vector], state: Vector, scale: Vector, reached: float) -> int:
    """Return how many of the last steps of a motion led towards a state.

    Args:
        passed: States of the motion, the last first.
        state: The state.
        scale: Size of each state, ``(n_x,)``.
        reached: Distance that counts as none, relative.
    """
    away = [float(np.max(np.abs(one - state) / scale)) for one in passed]
    pairs = itertools.pairwise(away)
    return len(list(itertools.takewhile(lambda pair: pair[0] <= max(pair[1], reached), pairs)))
