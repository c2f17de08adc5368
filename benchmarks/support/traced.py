"""Families of periodic orbits by brute force: many short steps, and nothing of `continuation`.

A family is traced along its arclength with a fixed longest step. At every point the test functions
of folds, flips and Neimark-Sacker points are computed. A change of sign between two points is
located by root finding along the chord. An end is where no orbit follows even at the least step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model.problem import ParameterValues, Problem
from zeno_orbits.orbits import event_return
from zeno_orbits.simulation import SimulationSettings

Vector = NDArray[np.float64]

FOLD, FLIP, TORUS = "fold", "flip", "Neimark-Sacker"
LEAST = 1e-10
"""Least step in parts of the range."""
CLOSE, TURN, FAR = 1e-11, 0.25, 0.5
"""Relative error of a point, largest angle between two tangents, and largest first correction in
parts of a step."""


STEPS = 50_000
"""Integration steps after which a return is given up."""


class LostError(Exception):
    """No orbit follows."""


@dataclass(frozen=True, kw_only=True)
class Returned:
    """A return: state at its end, and its derivatives by the state and by the parameter."""

    end: Vector
    by_state: Vector
    by_parameter: Vector


Map = Callable[[Vector, float], Returned]
"""From a state and the value of the parameter to the return, or a `LostError`."""


def releases(
    problem: Problem, values: ParameterValues, parameter: str, horizon: float, n_returns: int
) -> Map:
    """Return the return map from release to release of a problem, some returns at once."""
    place = problem.names.index(parameter)
    vector = np.array(values.vector)
    settings = SimulationSettings(most_steps=STEPS)

    clock, places = list(problem.compiled().clock), np.arange(len(problem.names))

    def once(x: Vector, s: float) -> Returned:
        # No orbit changes the radius of the clock. A start is put on its circle, so the multiplier
        # of that direction is zero instead of one.
        kept = np.eye(x.size)
        if clock:
            radius = np.zeros(x.size)
            radius[clock] = x[clock] / np.linalg.norm(x[clock])
            kept -= np.outer(radius, radius)
            x = x.copy()
            x[clock] = radius[clock]
        numbers = dict(zip(problem.names, np.where(places == place, s, vector), strict=True))
        moved = ParameterValues(
            gains={name: float(numbers[name]) for name in values.gains},
            parameters={name: float(numbers[name]) for name in values.parameters},
        )
        try:
            graph = problem.graph_dynamics(moved)
            found = event_return(
                graph,
                graph.first.on_stop(x),
                section="release stop",
                n_returns=1,
                guess=0.25 * horizon,
                settings=settings,
                parameters=(place,),
            )
        except (ZenoOrbitsError, FloatingPointError, ZeroDivisionError) as error:
            raise LostError(str(error)) from error
        return Returned(
            end=found.end, by_state=found.by_state @ kept, by_parameter=found.by_parameters[:, 0]
        )

    def several(x: Vector, s: float) -> Returned:
        found = once(x, s)
        for _ in range(n_returns - 1):
            after = once(found.end, s)
            by_parameter = after.by_state @ found.by_parameter + after.by_parameter
            by_state = after.by_state @ found.by_state
            found = Returned(end=after.end, by_state=by_state, by_parameter=by_parameter)
        return found

    return several


@dataclass(frozen=True, kw_only=True)
class Point:
    """An orbit of a traced family.

    Attributes:
        z: State and parameter in their units, ``(n + 1,)``.
        tangent: Unit tangent.
        multipliers: Of the return.
    """

    z: Vector
    tangent: Vector
    multipliers: Vector

    def tests(self) -> dict[str, float]:
        """Return the test functions by kind."""
        pairs = [(a * b - 1) for a, b in combinations(self.multipliers, 2)]
        return {
            FOLD: float(self.tangent[-1]),
            FLIP: float(np.real(np.prod(1 + self.multipliers))),
            TORUS: float(np.real(np.prod(pairs))) if pairs else 1.0,
        }

    @property
    def turning(self) -> bool:
        """Whether the largest multiplier is one of a complex pair."""
        return abs(max(self.multipliers, key=abs, default=0.0).imag) > 1e-6


@dataclass(frozen=True, kw_only=True)
class Tracer:
    """Traces a family.

    Attributes:
        returned: The return map.
        scale: Units of the state, ``(n,)``.
        box: Range of the parameter.
    """

    returned: Map
    scale: Vector
    box: tuple[float, float]

    def value(self, z: Vector) -> float:
        """Return the parameter of a point."""
        return float(z[-1] * (self.box[1] - self.box[0]))

    def at(self, guess: Vector, tangent: Vector, reach: float = math.inf) -> Point:
        """Return the orbit on the plane through a guess across a direction.

        Raises:
            LostError: If there is none.
        """
        z = guess.copy()
        n = self.scale.size
        for _ in range(9):
            found = self.returned(z[:-1] * self.scale, self.value(z))
            rows = np.zeros((n + 1, n + 1))
            slopes = found.by_state * self.scale / self.scale[:, None]
            rows[:n, :n] = slopes - np.eye(n)
            rows[:n, n] = found.by_parameter * (self.box[1] - self.box[0]) / self.scale
            rows[n] = tangent
            miss = np.append(found.end / self.scale - z[:-1], tangent @ (z - guess))
            if not np.all(np.isfinite(rows)):
                raise LostError("a derivative is infinite")
            step = np.linalg.lstsq(rows, -miss, rcond=1e-13)[0]
            size = float(np.max(np.abs(step)))
            if size > reach:
                raise LostError("the correction is longer than the step")
            z = z + step
            if size < CLOSE:
                return self._point(z, rows, slopes, tangent)
        raise LostError("Newton's method does not converge")

    def _point(self, z: Vector, rows: Vector, slopes: Vector, along: Vector) -> Point:
        n = self.scale.size
        tangent = np.linalg.lstsq(rows, np.append(np.zeros(n), 1.0), rcond=1e-13)[0]
        tangent /= np.linalg.norm(tangent)
        tangent *= math.copysign(1.0, tangent @ along)
        return Point(z=z, tangent=tangent, multipliers=np.linalg.eigvals(slopes))

    def start(self, x: Vector, s: float) -> Point:
        """Return the orbit at a value of the parameter, from a state near it."""
        along = np.append(np.zeros(self.scale.size), 1.0)
        z = np.append(x / self.scale, s / (self.box[1] - self.box[0]))
        return self.at(z, along)

    def trace(self, first: Point, longest: float, most: int) -> tuple[list[Point], str]:
        """Return the points from one on, and why there are no more.

        Args:
            first: The first point, whose tangent leads on.
            longest: Longest step.
            most: Largest number of points.
        """
        points, step = [first], longest
        while len(points) < most:
            here = points[-1]
            guess = here.z + step * here.tangent
            if not self.box[0] <= self.value(guess) <= self.box[1]:
                edge = self.box[0] if self.value(guess) < self.box[0] else self.box[1]
                part = (edge - self.value(here.z)) / (self.value(guess) - self.value(here.z))
                across = np.append(np.zeros(self.scale.size), 1.0)
                try:
                    last = self.at(here.z + part * step * here.tangent, across, FAR * step)
                except LostError:
                    pass
                else:
                    if abs(last.tangent @ here.tangent) > math.cos(TURN):
                        sign = math.copysign(1.0, last.tangent @ here.tangent)
                        end = Point(
                            z=last.z, tangent=sign * last.tangent, multipliers=last.multipliers
                        )
                        return [*points, end], "range"
            try:
                after = self._beside(here, guess, FAR * step)
            except LostError as lost:
                step /= 2
                if step < LEAST:
                    return points, str(lost)
                continue
            if not self.box[0] <= self.value(after.z) <= self.box[1]:
                step /= 2
                if step < LEAST:
                    return points, "range"
                continue
            points.append(after)
            step = min(2 * step, longest)
        return points, "points"

    def _beside(self, here: Point, guess: Vector, reach: float) -> Point:
        after = self.at(guess, here.tangent, reach)
        if after.tangent @ here.tangent < math.cos(TURN):
            raise LostError("the family turns")
        return after

    def special(self, points: list[Point]) -> list[tuple[str, float]]:
        """Return kind and value of the special points between successive points."""
        found: list[tuple[str, float]] = []
        for a, b in pairwise(points):
            before, after = a.tests(), b.tests()
            for kind in (FOLD, FLIP, TORUS):
                if before[kind] * after[kind] < 0.0:
                    at = self._located(a, b, kind)
                    if at is not None and (kind != TORUS or at.turning):
                        found.append((kind, self.value(at.z)))
        return found

    def _located(self, a: Point, b: Point, kind: str) -> Point | None:
        length = float((b.z - a.z) @ a.tangent)
        known = {0.0: a, length: b}

        def test(distance: float) -> float:
            if distance not in known:
                part = distance / length
                guess = (1 - part) * a.z + part * b.z
                guess += (distance - (guess - a.z) @ a.tangent) * a.tangent
                known[distance] = self.at(guess, a.tangent)
            return known[distance].tests()[kind]

        try:
            root = float(brentq(test, 0.0, length, xtol=1e-13 * max(1.0, length), rtol=1e-12))
            test(root)
        except LostError:
            return None
        return known[root]
