r"""Flows in many digits by Gauss's collocation, in steps of any stiffness.

The polynomial of degree `s` whose rate is that of the flow at the `s` Gauss nodes of a step is
right at its end to order `2 s` [HairerWanner1996]_, IV.5:

.. math:: F_i = f\Bigl(y_0 + h \sum_j a_{ij} F_j\Bigr), \qquad y_1 = y_0 + h \sum_j b_j F_j

Newton's method finds the rates, in doubles first. Its matrix then serves for the full length, where
each iteration gains some ten digits. A step may also end where an entry of the state falls to zero:
its length is then one more unknown.

Numbers are the midpoints of python-flint's balls: nothing is enclosed here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import casadi as ca
import numpy as np
from flint import arb, ctx
from scipy.linalg.lapack import dgetrf, dgetrs

from tests.reference.many_digits.gauss_scheme import (
    GaussScheme,
    Real,
    ball_rows,
    double_rows,
    gauss_scheme,
)
from tests.reference.many_digits.series_roots import first_root
from zeno_orbits.arrays import Array, Vector
from zeno_orbits.errors import InputError, SimulationError, StepSizeError
from zeno_orbits.proof import BallProgram

_STAGES_PER_DIGIT = 0.75
_BLOCK = 4
"""Numbers of stages come in multiples of it, but for the largest."""
_ORDERS = 1.5
"""Digits that the end of a step has for each that its polynomial has: 2 where nothing is stiff."""
_MOST_STEPS = 100_000
_MOST_TRIES = 200
"""Tries of a step, each shorter."""
_MOST_SHORTENED = 8
_LEAST = 1e-30
"""Step that is taken as a sign of a pole, as a part of the duration."""
_ITERATIONS = 12
_NEAR, _CLOSE, _LOST = 1e-2, 1e-7, 1e12
"""Relative changes of an iteration in doubles: then the end may move, it is enough, it is in vain.
"""
_GAIN = 1e-3
"""Factor by which an iteration in full length shrinks the change at least."""
_GROWTH = 3.0
_FLOOR = 1e-6
"""Part of its own size below which a state is zero to a step's error."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Step:
    """A step.

    Attributes:
        scheme: The collocation.
        size: Its length.
        states: At the nodes, then at the end, ``(s + 1, n)``.
        error: Largest of the last two modes of the rates, relative to the states.
    """

    scheme: GaussScheme
    size: Real
    states: list[list[Real]]
    error: float


class GaussFlow:
    """An autonomous flow ``y' = f(y, c)``, followed until one entry of ``y`` falls to zero."""

    def __init__(
        self, rate: ca.Function, values: Sequence[float], sizes: Vector, row: int, digits: int
    ) -> None:
        """Translate the flow, in the length of numbers that is set.

        Args:
            rate: ``((y, c), p) -> y'``, with any constants ``c`` of an arc.
            values: ``p``, exactly.
            sizes: Size of each entry of ``y``, beside which it may be zero, ``(n,)``.
            row: The guard's place in ``y``.
            digits: Digits that a step is right to.
        """
        self.n, self.row = len(sizes), row
        self._floor = _FLOOR * sizes
        self._target, self._least = 10.0 ** (-digits / _ORDERS), arb(10) ** -digits
        self._most_stages = math.ceil(_STAGES_PER_DIGIT * digits) + 2
        self._rate = ball_function(rate, values)
        y = ca.SX.sym("y", rate.numel_in(0))
        f = rate(y, ca.DM(list(values)))
        outputs = [ca.densify(f.T), ca.densify(ca.jacobian(f, y[: self.n]).T)]
        one = ca.Function("rate", [y], outputs, {"cse": True})
        self._coarse = lru_cache(one.map)
        self._size = math.inf

    def advance(
        self,
        y: Sequence[Real],
        duration: Real,
        *,
        order: int = 0,
        constants: Sequence[Real] = (),
        unit: float = 1.0,
        expected: float = math.inf,
    ) -> tuple[Real, list[Real], bool]:
        """Follow the flow until its guard falls to zero, or a duration is over.

        Args:
            y: Start, ``(n,)``.
            duration: The longest time.
            order: Order of the guard's root at the start, which does not count.
            constants: ``c``.
            unit: Unit of the time, in which steps are as long as they were on the last arc.
            expected: Time after which the guard is expected to fall; only speed depends on it.

        Returns:
            How long it took, the state then, and whether the guard fell.

        Raises:
            StepSizeError: If the flow ceases to be finite.
            SimulationError: If the guard leaves zero downwards or grazes it, or steps do not end.
        """
        here, time = list(y), arb(0)
        scheme = self._scheme(unit * expected)
        if unit * expected < self._size and duration > expected:
            step = self._landed(scheme, here, arb(expected), order, constants)
            if step is not None and step.error <= self._target and 0 < step.size < duration:
                return step.size, step.states[-1], True
        for _ in range(_MOST_STEPS):
            left = (duration - time).mid()
            if not left > 0:
                return time, here, False
            step, root = self._next(here, left, order, constants, unit)
            if root is not None:
                size = step.size * arb(root)
                step = self._landed(step.scheme, here, size, order, constants)
                if step is None:
                    raise followed_no_further("The guard grazes zero", time, here)
                return (time + step.size).mid(), step.states[-1], True
            time, here, order = (time + step.size).mid(), step.states[-1], 0
            if step.size < _LEAST * duration and step.size < left:
                break
        raise followed_no_further("The flow is not finite", time, here, StepSizeError)

    def _next(
        self, y: list[Real], left: Real, order: int, constants: Sequence[Real], unit: float
    ) -> tuple[_Step, float | None]:
        """Return a step that is right, no longer than what is left, and where the guard falls."""
        size, shortened, scheme = min(self._size / unit, float(left)), 0, self._scheme(math.inf)
        for _ in range(_MOST_TRIES):
            cut = bool(left <= 1.01 * size)
            step = self._step(scheme, y, left if cut else arb(size), constants)
            if step is None or not step.error < math.inf:
                size /= 4
                continue
            change = (self._target / max(step.error, 1e-300)) ** (1 / len(scheme.nodes))
            if step.error > self._target:
                size *= min(max(0.9 * change, 0.1), 0.9)
                continue
            root = self._fall(y, step, order)
            if root == 0.0:
                # A guard that rises only just shows it where a shorter step cuts less off.
                if shortened == _MOST_SHORTENED:
                    reason = "The state leaves the admissible set from its boundary"
                    raise followed_no_further(reason, 0, y)
                size, shortened = size / 8, shortened + 1
                continue
            grown = size * min(max(0.9 * change, 0.5), _GROWTH)
            self._size = unit * (size if cut else grown)
            return step, root
        raise followed_no_further("The flow is not finite", 0, y, StepSizeError)

    def _scheme(self, length: float) -> GaussScheme:
        """Return the scheme of as many stages as a step of a length needs.

        With all `s` stages the error is the target, ``q^s``, at the length `l` of the last arc's
        steps; with `k` stages it is about ``(q length / l)^k``.
        """
        stages, aim = self._most_stages, math.log(self._target)
        if 0.0 < length < self._size < math.inf:
            fewer = aim / (aim / stages + math.log(length / self._size))
            stages = min(stages, _BLOCK * math.ceil(fewer / _BLOCK + 1))
        return gauss_scheme(stages, ctx.prec)

    def _step(
        self,
        scheme: GaussScheme,
        y: list[Real],
        size: Real,
        constants: Sequence[Real],
        *,
        lands: bool = False,
    ) -> _Step | None:
        """Return a step; None if Newton's method does not find it.

        Args:
            scheme: The collocation.
            y: Its start, ``(n,)``.
            size: Its length; near it if the step lands.
            constants: Numbers of the arc.
            lands: Whether it ends where the guard is zero.
        """
        n, s = self.n, len(scheme.nodes)
        with np.errstate(all="ignore"):
            rough = self._rough_step(scheme, [*y, *constants], float(size), lands)
        if rough is None:
            return None
        rates, length, solve, scale = rough
        size = arb(length) if lands else size
        base = ball_rows(s + 1, y * (s + 1))
        fine = ball_rows(s, map(arb, rates.ravel()))
        before = None
        for _ in range(_ITERATIONS):
            moved = scheme.matrix * fine
            table = (base + moved * size).mid().table()
            found = [f for row in table[:-1] for f in self._rate([*row, *constants])[0]]
            rest = (ball_rows(s, found) - fine).mid().entries()
            if lands:
                rest.append(-(moved[s, self.row] if y[self.row] == 0 else table[-1][self.row]))
            if not all(one.is_finite() for one in rest):
                return None
            largest = max(abs(one) for one in rest)
            if largest == 0:
                break
            change = solve(np.array([float(one / largest) for one in rest]))
            fine = (fine + ball_rows(s, map(arb, change[: s * n])) * largest).mid()
            if lands:
                size = (size + largest * float(change[-1])).mid()
            relative = np.max(np.abs(change[: s * n].reshape(s, n)) / scale) * float(size)
            now = largest * float(relative)
            if before is not None:
                if now * (now / before).min(arb(_GAIN)) < self._least / 16:
                    break
                if not now < before / 4:
                    return None
            before = now
        states = (base + scheme.matrix * fine * size).mid().table()
        error = float(np.max(np.abs(double_rows(scheme.tails * fine)) / scale)) * float(size)
        return _Step(scheme=scheme, size=size, states=states, error=error)

    def _rough_step(
        self, scheme: GaussScheme, y: Sequence[Real], size: float, lands: bool
    ) -> tuple[Array, float, Callable[[Vector], Vector], Vector] | None:
        """Solve a step in doubles: return rates, length, Newton's solver and sizes of states.

        Args:
            scheme: The collocation.
            y: Start, then constants.
            size: Its length, or near it.
            lands: Whether it ends where the guard is zero.
        """
        n, row, coarse, s = self.n, self.row, scheme.coarse, len(scheme.nodes)
        m, start = s * n, np.array([float(x) for x in y])
        stages = np.tile(start, (s, 1))
        rates, moves = np.asarray(self._coarse(s)(stages.T)[0].full()).reshape(s, n), False
        for _ in range(_ITERATIONS):
            moved = coarse @ rates
            stages[:, :n] = start[:n] + size * moved[:-1]
            outputs = self._coarse(s)(stages.T)
            found, slopes = (np.asarray(one.full()).T.reshape(s, -1, n) for one in outputs)
            rest = np.append((found[:, 0] - rates).ravel(), np.zeros(int(moves)))
            system = np.eye(m + int(moves))
            system[:m, :m] -= size * np.einsum("ij,iab->iajb", coarse[:-1], slopes).reshape(m, m)
            if moves:
                # From zero the guard falls to zero where its mean rate is zero: not at once again.
                weight, known = (size, start[row]) if start[row] else (1.0, 0.0)
                system[:m, m] = -np.einsum("iab,ib->ia", slopes, moved[:-1]).ravel()
                system[m, row:m:n] = weight * coarse[-1]
                system[m, m] = moved[-1, row] if start[row] else 0.0
                rest[m] = -(known + weight * moved[-1, row])
            solve = partial(_solved, *dgetrf(system)[:2])
            change = solve(rest)
            rates = rates + change[:m].reshape(s, n)
            scale = np.maximum(np.max(np.abs(stages[:, :n]), axis=0), self._floor)
            relative = float(np.max(np.abs(size * change[:m].reshape(s, n)) / scale))
            size += float(change[m]) if moves else 0.0
            if relative < _CLOSE and moves == lands:
                return rates, size, solve, scale
            moves = lands and relative < _NEAR
            if not relative < _LOST:
                return None
        return None

    def _fall(
        self, y: list[Real], step: _Step, order: int, *, landed: bool = False
    ) -> float | None:
        """Return where in a step the guard falls to zero, as a part of it, if it does.

        Zero if it is not positive after the start.

        Args:
            y: Start of the step.
            step: The step.
            order: Order of the root at its start, which does not count.
            landed: Whether that at its end does not count, either.
        """
        values = [
            row[self.row] / (node**order * (1 - landed * node))
            for row, node in zip(step.states[:-1], step.scheme.nodes, strict=True)
        ]
        series = (step.scheme.bernstein * ball_rows(len(values), values)).entries()
        largest = max(abs(one.mid()) for one in series)
        try:
            root = first_root(np.array([float(one / largest) for one in series]))
        except InputError as error:
            raise followed_no_further("The guard grazes zero", 0, y) from error
        # Rounding may hide a root near the end, where the sign is known to all digits.
        below = not landed and not step.states[-1][self.row] > 0
        return 1.0 if root is None and below else root

    def _landed(
        self,
        scheme: GaussScheme,
        y: list[Real],
        size: Real,
        order: int,
        constants: Sequence[Real],
    ) -> _Step | None:
        """Return the step to the guard's first fall, from its length to some digits."""
        step = self._step(scheme, y, size, constants, lands=True)
        return step if step and self._fall(y, step, order, landed=True) is None else None


def _solved(factors: Any, pivots: Any, x: Vector) -> Vector:
    return np.asarray(dgetrs(factors, pivots, x)[0], dtype=np.float64)


def followed_no_further(
    reason: str, time: Real, y: Sequence[Real], kind: type[SimulationError] = SimulationError
) -> SimulationError:
    """Return the error of a motion that ends before its time.

    Args:
        reason: Why.
        time: When [s].
        y: Where.
        kind: Its type.
    """
    return kind(reason, time=float(time), state=tuple(float(value) for value in y))


def ball_function(function: ca.Function, values: Sequence[float]) -> BallProgram:
    """Return a function of ``(x, p)`` in many digits, its ``p`` fixed to doubles.

    Args:
        function: The function.
        values: ``p``, exactly.
    """
    x, p = ca.SX.sym("x", function.numel_in(0)), ca.SX.sym("p", function.numel_in(1))
    dense = [ca.densify(y) for y in function.call([x, p])]
    one = ca.Function("exact", [x, p], dense, {"cse": True})
    return BallProgram(one, [arb(float(value)) for value in values])
