r"""A loop at the corners of uncertain parameters, and the gain that is best at the worst corner.

The law does not know the parameters: at each corner it still has the centre of the orbit. So the
loop has another fixed point there. With the derivatives `A` and `B` of the return map there,

.. math:: y = P\bigl(y,\; \mathrm{clip}(u^* - K (y - y^*))\bigr), \qquad A - B S K,

where `S` is one for an input inside of its range and zero for a clipped one. With a delay the state
of the loop is :math:`(y, u)`. Newton's method finds the point, along the way from the orbit to the
corner if it does not from the orbit at once. The gain of the least largest spectral radius is a
local one: Nelder and Mead's method, first with the derivatives of the last points, then with the
points of each gain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues, spectral_radius
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.model import ParameterValues, corners_of
from zeno_orbits.orbits import ReturnMap
from zeno_orbits.work import ByValue, Progress

_CLOSED = 1e-10
"""Distance of a fixed point from its return, in sizes."""
_STEPS = 12
"""Steps of Newton's method."""
_SHORTEST = 1 / 64
"""Smallest part of the way to a corner that is tried."""
_ROUNDS = 8
"""Rounds with derivatives of the last points."""
_GAINED = 1e-4
"""Part of the spectral radius that a round has to gain."""
_FAR = 1e3
"""Radius of a loop that lacks a fixed point, above that of any other."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoopCorner(ByValue):
    """A loop at a corner of uncertain parameters.

    Attributes:
        parameters: The uncertain parameters, name to value.
        fixed_point: Coordinates of the orbit that the loop has there, ``(d,)``.
        inputs: Its inputs, ``(m,)``.
        multipliers: Multipliers of the loop there, the largest first.
        lost: Why the loop lacks an orbit there, or empty. Then the arrays are empty.
    """

    parameters: Mapping[str, float]
    fixed_point: Vector
    inputs: Vector
    multipliers: tuple[complex, ...]
    lost: str = ""

    @property
    def spectral_radius(self) -> float:
        """Largest modulus of a multiplier, infinite without an orbit."""
        return np.inf if self.lost else spectral_radius(self.multipliers)

    def as_json(self) -> dict[str, Any]:
        """Return the corner as plain data."""
        return {
            "parameters": dict(self.parameters),
            "fixed_point": self.fixed_point.tolist(),
            "inputs": self.inputs.tolist(),
            "multipliers": [[mu.real, mu.imag] for mu in self.multipliers],
            "lost": self.lost,
        }


@dataclass(frozen=True, slots=True)
class _Step:
    """A return of a loop: its state, the inputs in use, and the derivatives of the loop."""

    after: Vector
    used: Vector
    by_state: Vector
    by_inputs: Vector


@dataclass(frozen=True, slots=True)
class _Point:
    """A point of a loop on the way to a corner: the part of the way, and the last step there."""

    part: float
    state: Vector
    step: _Step
    why: str = ""


@dataclass(frozen=True, kw_only=True)
class UncertainLoop:
    """A loop whose machine has uncertain parameters.

    Attributes:
        returns: The return map of the orbit.
        inputs: Names of the inputs.
        centre: Inputs of the orbit, ``(m,)``.
        limits: Range of each input.
        delay: True if inputs are applied one return after their measurement.
        uncertain: Name to range of the uncertain parameters.
    """

    returns: ReturnMap
    inputs: tuple[str, ...]
    centre: Vector
    limits: tuple[tuple[float, float], ...]
    delay: bool
    uncertain: Mapping[str, tuple[float, float]]

    @property
    def _middle(self) -> Vector:
        """State of the loop in the orbit."""
        fixed = self.returns.fixed_point
        return np.concatenate([fixed, self.centre]) if self.delay else fixed

    @property
    def _sizes(self) -> Vector:
        own = self.returns.sizes
        return np.concatenate([own, input_sizes(self.returns, self.inputs)]) if self.delay else own

    def corners(self, gain: Vector) -> tuple[LoopCorner, ...]:
        """Return the loop with a gain at each corner.

        Args:
            gain: Matrix `K`.
        """
        d, sizes = len(self.returns.coordinates), self._sizes
        found: list[LoopCorner] = []
        for corner in corners_of(self.uncertain):
            point = self._reached(gain, corner)
            done = not point.why
            found.append(
                LoopCorner(
                    parameters=corner,
                    fixed_point=point.state[:d] if done else np.zeros(0),
                    inputs=point.step.used if done else np.zeros(0),
                    multipliers=(
                        eigenvalues(point.step.by_state * sizes / sizes[:, None]) if done else ()
                    ),
                    lost=point.why,
                )
            )
        return tuple(found)

    def best(self, gain: Vector, units: Vector, on_progress: Progress) -> Vector:
        """Return a gain whose largest spectral radius at the orbit and all corners is least.

        It is never larger than that of the first gain.

        Args:
            gain: First gain.
            units: Size of each coefficient, as of `gain`.
            on_progress: Called with the stage and the part of it that is done.
        """
        if not gain.size:
            return gain
        orbit = self._solved(0.0 * gain, {}, 0.0, self._middle)
        corners = corners_of(self.uncertain)
        best, known = gain / units, [self._reached(gain, corner) for corner in corners]

        def points(one: Vector) -> list[_Point]:
            used = one * units
            there = [
                self._reached(used, corner, None if near.why else near.state)
                for corner, near in zip(corners, known, strict=True)
            ]
            a, b = orbit.step.by_state, orbit.step.by_inputs
            return [replace(orbit, step=replace(orbit.step, by_state=a - b @ used)), *there]

        for k in range(_ROUNDS):
            on_progress("choosing the gain", k / _ROUNDS / 2)
            now = points(best)
            found = self._with_the_same_points(best, units, now)
            for part in (1.0, 0.5, 0.25):
                tried = best + part * (found - best)
                there = points(tried)
                if _worst(there) < (1 - _GAINED) * _worst(now):
                    break
            else:
                break
            best, known = tried, there[1:]
        on_progress("choosing the gain", 0.5)
        return _least(lambda one: _worst(points(one)), best, rounds=2, precision=1e-5) * units

    def _with_the_same_points(self, gain: Vector, units: Vector, known: Sequence[_Point]) -> Vector:
        """Return the best gain for the derivatives at points."""
        open_loops = [
            (one.step.by_state + one.step.by_inputs @ (gain * units), one.step.by_inputs)
            for one in known
        ]

        def worst(one: Vector) -> float:
            return max(_radius(a - b @ (one * units)) for a, b in open_loops)

        return _least(worst, gain, rounds=3)

    def _reached(
        self, gain: Vector, corner: Mapping[str, float], near: Vector | None = None
    ) -> _Point:
        """Return the fixed point at a corner, or the last one on the way to it."""
        if near is not None:
            there = self._solved(gain, corner, 1.0, near)
            if not there.why:
                return there
        at = self._solved(gain, corner, 0.0, self._middle)
        step = 1.0
        while at.part < 1.0 and step >= _SHORTEST:
            further = self._solved(gain, corner, min(at.part + step, 1.0), at.state)
            if further.why:
                step /= 2
                if step < _SHORTEST:
                    return _Point(at.part, at.state, at.step, further.why)
            else:
                at = further
        return at

    def _solved(
        self, gain: Vector, corner: Mapping[str, float], part: float, state: Vector
    ) -> _Point:
        """Return the fixed point at a part of the way, by Newton's method."""
        step = _Step(state, self.centre, np.eye(len(state)), np.zeros((len(state), 0)))
        try:
            values = self._values(corner, part)
            for _ in range(_STEPS):
                step = self._stepped(gain, values, state)
                missed = step.after - state
                if np.max(np.abs(missed) / self._sizes, initial=0.0) < _CLOSED:
                    return _Point(part, state, step)
                state = state + np.linalg.solve(np.eye(len(state)) - step.by_state, missed)
        except (ZenoOrbitsError, np.linalg.LinAlgError) as error:
            return _Point(part, state, step, str(error))
        return _Point(part, state, step, "Newton's method does not find a fixed point of the loop.")

    def _values(self, corner: Mapping[str, float], part: float) -> ParameterValues:
        """Return gains and parameters at a part of the way, those derived from them derived."""
        problem, known = self.returns.problem, self.returns.values
        own = dict(known.parameters)
        rest = {
            one: value
            for one, value in own.items()
            if one not in problem.derived_from([one for one in corner if one in own], own)
        }
        # A value that was given in place of the derived one stays.
        derived = problem.values(gains=known.gains, parameters=rest).parameters
        kept = {one: value for one, value in own.items() if one in rest or derived[one] != value}
        moved = {
            one: known.number(one) + part * (value - known.number(one))
            for one, value in corner.items()
        }
        gains = {**known.gains, **{k: v for k, v in moved.items() if k in known.gains}}
        others = {k: v for k, v in moved.items() if k not in gains}
        return problem.values(gains=gains, parameters={**kept, **others})

    def _stepped(self, gain: Vector, values: ParameterValues, state: Vector) -> _Step:
        """Return the next state of the loop, and its derivatives."""
        known, d = self.returns, len(self.returns.coordinates)
        low, high = np.array(self.limits).T
        wished = self.centre - gain @ (state - self._middle)
        follow = np.clip(wished, low, high)
        free = np.diag(((wished >= low) & (wished <= high)).astype(float))
        used = state[d:] if self.delay else follow
        numbers = dict(zip(self.inputs, used.tolist(), strict=True))
        gains = {**values.gains, **{k: v for k, v in numbers.items() if k in values.gains}}
        others = {**values.parameters, **{k: v for k, v in numbers.items() if k not in gains}}
        found = known.slopes(state[:d], gains, others)
        names = (*known.gain_names, *known.parameter_names)
        a, b = loop_derivatives(found, names, self.inputs, delay=self.delay)
        after = np.concatenate([found.point, follow]) if self.delay else found.point
        return _Step(after, used, a - b @ free @ gain, b @ free)


class _Derivatives(Protocol):
    """Derivatives of a return."""

    @property
    def jacobian(self) -> Vector: ...
    @property
    def gain_jacobian(self) -> Vector: ...
    @property
    def parameter_jacobian(self) -> Vector: ...


def loop_derivatives(
    found: _Derivatives, names: Sequence[str], inputs: Sequence[str], *, delay: bool
) -> tuple[Vector, Vector]:
    """Return the derivatives of the next state of a loop by its state and by the inputs.

    Args:
        found: Derivatives of the return.
        names: Names of the gains, then of the parameters.
        inputs: Names of the inputs.
        delay: True if the state of the loop is the point and the inputs in use.
    """
    both = np.concatenate([found.gain_jacobian, found.parameter_jacobian], axis=1)
    a, b = found.jacobian, both[:, [names.index(name) for name in inputs]]
    if not delay:
        return a, b
    d, m = b.shape
    kept = np.zeros((d + m, d + m))
    kept[:d] = np.concatenate([a, b], axis=1)
    return kept, np.concatenate([np.zeros((d, m)), np.eye(m)])


def input_sizes(returns: ReturnMap, inputs: Sequence[str]) -> Vector:
    """Return the sizes of inputs, ``(m,)``.

    Args:
        returns: The return map of the orbit.
        inputs: Names of the inputs.
    """
    return np.array([returns.size_of(name) for name in inputs])


def _worst(points: Sequence[_Point]) -> float:
    """Return the largest spectral radius, above `_FAR` if a fixed point is not reached."""
    return max(
        _FAR * (2.0 - one.part) if one.why else min(_radius(one.step.by_state), _FAR)
        for one in points
    )


def _radius(matrix: Vector) -> float:
    return spectral_radius(np.linalg.eigvals(matrix))


def _least(
    value: Callable[[Vector], float], start: Vector, *, rounds: int, precision: float = 1e-7
) -> Vector:
    """Return where a function is least near a start, by Nelder and Mead's method.

    It starts anew at its end, since it may stop in a valley with a kink.
    """
    # The import takes a fifth of a second.
    from scipy.optimize import minimize

    def flat(one: Vector) -> float:
        return value(one.reshape(start.shape))

    best, least = np.asarray(start.ravel(), dtype=np.float64), value(start)
    for _ in range(rounds):
        reach = 0.2 * max(float(np.max(np.abs(best))), 0.1)
        found: Any = minimize(
            flat,
            best,
            method="Nelder-Mead",
            options={
                "initial_simplex": np.concatenate([best[None], best + reach * np.eye(best.size)]),
                "xatol": 10 * precision,
                "fatol": precision,
                "maxfev": 60 * best.size,
            },
        )
        gained = least - float(found.fun)
        if gained > 0.0:
            best, least = np.asarray(found.x, dtype=np.float64), float(found.fun)
        if gained <= _GAINED * least:
            break
    return np.asarray(best.reshape(start.shape), dtype=np.float64)


def require_orbit_inside(
    uncertain: Mapping[str, tuple[float, float]], returns: ReturnMap, inputs: Sequence[str]
) -> None:
    """Refuse ranges that lack the value of the orbit, or that are inputs.

    Args:
        uncertain: Name to range of the uncertain parameters.
        returns: The return map of the orbit.
        inputs: Names of the inputs.

    Raises:
        InputError: If there is one.
    """
    for name, ends in uncertain.items():
        if name in inputs:
            raise InputError(f"Argument `uncertain` must not name the input `{name}`.")
        require_value_inside("uncertain", name, returns.values.number(name), ends)


def require_value_inside(argument: str, name: str, value: float, ends: tuple[float, float]) -> None:
    """Refuse a range that lacks the value of the orbit.

    Args:
        argument: Name of the argument, for the message.
        name: Name of the gain or parameter.
        value: Its value in the orbit.
        ends: The range.

    Raises:
        InputError: If the value is outside.
    """
    low, high = ends
    if not low <= value <= high:
        told = f"{low:g}:{high:g} of `{name}` lacks its value {value:.9g} in the orbit"
        raise InputError(f"Argument `{argument}`: the range {told}.")
