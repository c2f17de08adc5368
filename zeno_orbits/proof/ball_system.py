"""A problem at fixed numbers in balls: flows of both modes, impact, section."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
from flint import arb

from zeno_orbits.errors import InputError, ProofError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.proof.balls import ZERO, Ball, Matrix, identity, matrix
from zeno_orbits.proof.expressions import proof_expressions
from zeno_orbits.proof.flow import BallFlow
from zeno_orbits.proof.program import BallProgram


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpactValues:
    """The impulse direction at a state.

    Attributes:
        direction: Change of the state by unit gap rate, ``(n,)``.
        slopes: Its derivative, ``(n, n)``.
    """

    direction: list[Ball]
    slopes: Matrix


class BallSystem:
    """A problem at fixed numbers, in balls.

    Attributes:
        expressions: Its equations.
        n: Number of states of the prover.
        gap: Place of the gap.
        rate: Place of the gap rate.
        restitution: Coefficient of restitution, exact.
        gap_offset: Gap where the coordinate that it is one of is zero.
        free: The flow off the stop.
        locked: The flow on the stop; its guard is the multiplier.
    """

    def __init__(
        self, problem: Problem, values: ParameterValues, over: Mapping[str, float] | None = None
    ) -> None:
        """Translate the problem.

        Args:
            problem: The problem.
            values: Its numbers, taken exactly.
            over: Gains or parameters that become states of rate zero.

        Raises:
            TranslationError: If an operation of the problem is not analytic.
            InputError: If the restitution or the place of the stop is to vary.
        """
        carried = tuple(over or ())
        e = self.expressions = proof_expressions(problem, carried)
        offset = e.coordinate.offset if e.coordinate else ca.SX(0)
        for what, expression in (("restitution", e.restitution), ("place of the stop", offset)):
            if ca.depends_on(expression, e.states):
                wanted = f"must leave the {what} as it is"
                raise InputError(f"Argument `over` {wanted}, but it changes with {carried[0]}.")
        named = dict(zip(problem.names, values.vector, strict=True))
        self.carried = {name: arb(float(named[name])) for name in carried}
        exact = [arb(float(named[name])) for name in problem.names if name not in carried]
        self.numbers = [*exact, *(arb(value) for value in e.constants)]
        self.n, self.gap, self.rate = e.states.numel(), e.gap_place, e.rate_place
        self.n_x = self.n - len(carried) - (2 if e.coordinate is None else 0)
        (self.restitution,) = self._program(e.restitution)([ZERO] * self.n)[0] or [ZERO]
        self.gap_offset = (self._program(offset)([ZERO] * self.n)[0] or [ZERO])[0]
        self.free = BallFlow(e.states, e.numbers, e.free, None, self.numbers)
        self.locked = BallFlow(e.states, e.numbers, e.locked, e.multiplier, self.numbers)
        self._slopes = ca.jacobian(e.direction, e.states)
        self._impact = self._program(e.direction, self._slopes)
        self._tail = self._program(e.free, e.direction)
        gradient = ca.jacobian(e.constraints, e.states)
        self.constraints = self._program(e.constraints, gradient)
        self.constraint_places = list(zip(*gradient.sparsity().get_triplet(), strict=True))

    @property
    def groups(self) -> dict[str, list[list[int]]]:
        """Rows of a set that turn together: all, or those beside the gap and its rate."""
        last = self.n - len(self.carried)
        moving = list(range(last))
        return {
            "all": [moving],
            "beside": [[k for k in moving if k not in (self.gap, self.rate)]],
        }

    def impact(self, y: Sequence[Ball]) -> ImpactValues:
        """Return the impulse direction at a state, and its derivative."""
        direction, slopes = self._impact(y)
        rows = [[ZERO] * self.n for _ in range(self.n)]
        places = zip(*self._slopes.sparsity().get_triplet(), strict=True)
        for (row, col), one in zip(places, slopes, strict=True):
            rows[row][col] = one
        return ImpactValues(direction=direction, slopes=matrix(rows, self.n))

    def free_values(self, y: Sequence[Ball]) -> tuple[list[Ball], list[Ball]]:
        """Return the free flow and the impulse direction at a state, of complex balls too."""
        rate, direction = self._tail(y)
        return rate, direction

    def reset_derivative(self, y: Sequence[Ball]) -> Matrix:
        r"""Return the derivative of the reset at states on the stop, ``(n, n)``.

        .. math:: 1 - (1 + e)\,(d\, \partial \dot h + \dot h\, \partial d)
        """
        law, at, n = 1 + self.restitution, self.impact(y), self.n
        rows = (identity(n) - at.slopes * (law * y[self.rate])).table()
        for k in range(n):
            rows[k][self.rate] -= law * at.direction[k]
        rows[self.gap] = [ZERO] * n
        rows[self.rate] = [ZERO] * n
        rows[self.rate][self.rate] = -self.restitution
        return matrix(rows, n)

    def reset(self, y: Sequence[Ball]) -> list[Ball]:
        """Return the state after an impact, ``(n,)``; the gap is zero."""
        push = (1 + self.restitution) * y[self.rate]
        after = [a - push * d for a, d in zip(y, self.impact(y).direction, strict=True)]
        after[self.gap], after[self.rate] = ZERO, -self.restitution * y[self.rate]
        return after

    def _program(self, *outputs: ca.SX) -> BallProgram:
        e = self.expressions
        dense = [ca.densify(one) if one.shape[1] == 1 else one for one in outputs]
        function = ca.Function("part", [e.states, e.numbers], dense, {"cse": True})
        return BallProgram(function, self.numbers)


def require_proved(holds: bool, claim: str, reason: str) -> None:
    """Raise `ProofError` unless a condition holds.

    Args:
        holds: The condition.
        claim: What it is needed for.
        reason: What fails.
    """
    if not holds:
        raise ProofError(claim, reason)
