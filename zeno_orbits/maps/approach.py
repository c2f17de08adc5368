r"""Test whether a motion converges to an orbit of Newton's method (theory (4.7)).

Newton's method also finds orbits that the motion only passes. The test therefore uses the motion
itself: its section coordinates relative to the orbit, and the derivative :math:`A` of the return
map there.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector

_LOCAL_ERRORS = 10.0
"""Error of a period of a motion, in units of the local error."""
SAME_PERIOD = 1e-4
"""Relative difference below which the periods at two accuracies agree."""
_AGREES = 0.5
"""Largest relative difference between a step of the motion and the linear prediction."""
_PLACES = 6
"""Number of test points on either side of the orbit for a slow approach."""
_PART = 0.25
"""Required rate of approach at these points, in units of the multipliers' rate."""
_REAL = 1e-6
"""Imaginary part of a multiplier that counts as zero."""
_SHARED = 1e-2
"""Largest difference between two equal motions, in units of the time of a return."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Accuracy:
    """Accuracy with which motions are simulated up to their attractors.

    Attributes:
        motion: Local error while a motion converges.
        orbit: Local error of the reported orbit.
        near: Largest relative change of a return with which Newton's method is tried.
        exact: Largest last step of Newton's method. The error of the orbit is about the square of
            this step, and the error of the multipliers is about the step itself.
        repeats: Change that counts as repeating if Newton's method is not available.
        exponents: Whether a motion that does not repeat is simulated on for its Lyapunov exponent.
    """

    motion: float = 1e-8
    orbit: float = 1e-10
    near: float = 0.02
    exact: float = 2e-6
    repeats: float = 1e-7
    exponents: bool = True

    @property
    def reached(self) -> float:
        """Distance that the accumulated local errors of a motion can account for."""
        return _LOCAL_ERRORS * self.motion


@dataclass(frozen=True, slots=True, kw_only=True)
class Approach:
    """The returns by which a motion approaches an orbit.

    Attributes:
        times: Times of all returns [s].
        captured: Index of the return after which the distance to the orbit only decreased.
        doubtful: True if the time of the last return changes at a higher accuracy.
    """

    times: tuple[float, ...]
    captured: int
    doubtful: bool = False

    def is_shared_by(self, other: Approach) -> bool:
        """Return True if another motion makes the same returns up to the orbit."""
        at = self.captured
        usual = self.times[-1] / len(self.times)
        return at < len(other.times) and abs(self.times[at] - other.times[at]) <= _SHARED * usual


def is_approached(before: Vector, after: Vector, jacobian: Vector, reached: float) -> bool:
    """Return True if a step agrees with the linear prediction, to half of the predicted step.

    Args:
        before: Start of the step relative to the orbit, in section coordinates, ``(m,)``.
        after: End of the step, in the same coordinates.
        jacobian: Derivative of the return map, ``(m, m)``.
        reached: Error of the step.
    """
    expected = jacobian @ before
    miss = float(np.max(np.abs(after - expected), initial=0.0))
    step = float(np.max(np.abs(before - expected), initial=0.0))
    return miss <= max(_AGREES * step, reached)


def places_on_the_way(origin: Vector, jacobian: Vector) -> Vector:
    """Return test points between a motion and its orbit, and possibly beyond the orbit, ``(n, m)``.

    A slow motion along one direction passes these points. If the slowest multiplier is negative,
    the motion alternates between both sides, and the result has as many points beyond the orbit. If
    the multiplier is complex, the motion spirals around the orbit and the result is empty.

    Args:
        origin: Position of the motion relative to the orbit, in section coordinates, ``(m,)``.
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
    r"""Return True if a return reduces the distance to the orbit from each point.

    Distances are measured in the norm :math:`|y|_M` with
    :math:`\gamma^{-2} A^\top M A - M = -I,\ \gamma = (1 + \rho) / 2`, in which the linear map
    reduces them by the factor :math:`\gamma`. A part of this rate is required.

    Args:
        places: Points relative to the orbit, in coordinates of the section, ``(n, m)``.
        images: Images of the points under the return map, ``(n, m)``.
        jacobian: Derivative of the return map at the orbit, ``(m, m)``.
    """
    rate = 1.0 - float(np.max(np.abs(np.linalg.eigvals(jacobian))))
    if not rate > 0.0:
        return False
    norm, power = np.eye(len(jacobian)), jacobian / (1.0 - rate / 2.0)
    # The sum of the powers doubles its length.
    while np.max(np.abs(power)) > _REAL:
        norm, power = norm + power.T @ norm @ power, power @ power

    def away(rows: Vector) -> Vector:
        return np.sqrt(np.einsum("ki,ij,kj->k", rows, norm, rows))

    return bool(np.all(away(images) <= (1.0 - _PART * rate) * away(places)))


def steps_towards(passed: Sequence[Vector], state: Vector, scale: Vector, reached: float) -> int:
    """Return the number of final steps of a motion that all led towards a state.

    Args:
        passed: States of the motion, the last first.
        state: The state.
        scale: Size of each state, ``(n_x,)``.
        reached: Relative distance that counts as zero.
    """
    away = [float(np.max(np.abs(one - state) / scale)) for one in passed]
    pairs = itertools.pairwise(away)
    return len(list(itertools.takewhile(lambda pair: pair[0] <= max(pair[1], reached), pairs)))
