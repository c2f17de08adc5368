"""A problem at fixed parameter values in balls: flows of both modes, impact, section."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import casadi as ca
from flint import arb

from zeno_orbits.errors import ProofError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.proof.arithmetic.balls import ZERO, Ball, Matrix, column, identity, matrix
from zeno_orbits.proof.arithmetic.expressions import (
    MachineView,
    ProofExpressions,
    proof_expressions,
)
from zeno_orbits.proof.arithmetic.program import BallProgram
from zeno_orbits.proof.integration.flow import BallFlow


class SectionKind(Enum):
    """Kind of the states at which a period starts."""

    RELEASE = "release"
    IMPACT = "impact"
    SWITCH = "switch"


class PeriodStart(NamedTuple):
    """The event at which a period starts.

    Attributes:
        kind: The states of a release, just after an impact, or just before a switch.
        switch: Index of the switch, or -1.
        locked: True if the stop is closed just before the switch.
    """

    kind: SectionKind
    switch: int = -1
    locked: bool = False


_AT_RELEASE = PeriodStart(SectionKind.RELEASE)
_FAST = 1e-3
"""Gap rate, in its unit, above which it shares the frame of the other states."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpactValues:
    """The impulse direction and the coefficient of restitution at a state.

    Attributes:
        direction: Change of the state per unit change of the gap rate, ``(n,)``.
        slopes: Derivative of the direction, ``(n, n)``.
        restitution: Coefficient of restitution.
        restitution_slopes: Derivative of the coefficient of restitution, ``(n,)``.
    """

    direction: list[Ball]
    slopes: Matrix
    restitution: Ball
    restitution_slopes: list[Ball]


def _equations(e: ProofExpressions, section: PeriodStart) -> ca.SX:
    """Return the formulas that are zero on a section."""
    equations = {
        SectionKind.RELEASE: e.constraints,
        SectionKind.IMPACT: e.struck_constraints,
        # The pressure is the first of the constraints.
        SectionKind.SWITCH: e.constraints[1:] if section.locked else e.holonomic,
    }[section.kind]
    if section.switch >= 0:
        equations = ca.vertcat(e.guards[section.switch], equations)
    return equations


class BallSystem:
    """A problem at fixed parameter values, in balls, with states in units of their size.

    Attributes:
        expressions: Equations of the problem.
        n: Number of states of the prover.
        gap: Index of the gap.
        rate: Index of the gap rate.
        plastic: True for a restitution of zero.
        has_speed_law: True if the restitution depends on the gap rate before an impact.
        section: The event at which the period starts.
        view: The stop and the sides, None for a machine with one stop and no switch.
        gap_offset: Gap at the zero of its coordinate.
        units: Units of the states, powers of two, ``(n,)``.
        period: Time scale of the motion, for the sizes of steps [s].
        held_rows: Indices of gap and gap rate of the stop that is held closed, or empty.
        free: Flow off the stop.
        locked: Flow on the stop. Its guard is minus the gap acceleration of the free flow.
    """

    def __init__(
        self,
        problem: Problem,
        values: ParameterValues,
        over: Mapping[str, float] | None = None,
        period: float = 1.0,
        *,
        section: PeriodStart = _AT_RELEASE,
        view: MachineView | None = None,
    ) -> None:
        """Translate the problem.

        Args:
            problem: The problem.
            values: Gains and parameters, taken exactly.
            over: Gains or parameters that become states of rate zero.
            period: Approximate duration of the motion [s].
            section: The event at which the period starts.
            view: The stop and the sides of a machine with several stops, switches or kinks.

        Raises:
            TranslationError: If an operation of the problem is not analytic.
        """
        carried, self.period, self.section = tuple(over or ()), period, section
        self.view = view
        named = dict(zip(problem.names, map(float, values.vector), strict=True))
        n_x, n_stops = len(problem.state_names), 1
        if view is None:
            own = problem.dynamics(values).own
        else:
            graph = problem.graph_dynamics(values)
            own, n_stops = graph.own, graph.n_watched
        sizes = (*own.states(n_x), *(own.gap, own.gap_rate) * n_stops)
        sizes += tuple(named[name] for name in carried)
        units = [power_of_two(size) for size in sizes]
        e = self.expressions = proof_expressions(problem, carried, units, view)
        last = n_x + 2 * n_stops
        self.units = units if e.coordinate is None else [*units[:n_x], *units[last:]]
        offset = e.coordinate.offset if e.coordinate else ca.SX(0)
        self.carried = {
            name: arb(named[name]) / unit for name, unit in zip(carried, units[last:], strict=True)
        }
        exact = [arb(float(named[name])) for name in problem.names if name not in carried]
        self.numbers = [*exact, *(arb(value) for value in e.constants)]
        self.n, self.gap, self.rate = e.states.numel(), e.gap_place, e.rate_place
        self.n_x = n_x
        self._law = self._program(e.restitution, ca.densify(ca.gradient(e.restitution, e.states)))
        centre = [ZERO] * (self.n - len(carried)) + list(self.carried.values())
        varies = ca.depends_on(e.restitution, e.states)
        self.has_speed_law = ca.depends_on(e.restitution, e.states[: self.n - len(carried)])
        self.plastic = not varies and bool(self._law(centre)[0][0].is_zero())
        self.gap_offset = (self._program(offset)([ZERO] * self.n)[0] or [ZERO])[0]
        self.free = BallFlow(e.states, e.numbers, e.free, None, self.numbers)
        self.locked = BallFlow(e.states, e.numbers, e.locked, e.pressure, self.numbers)
        self._slopes = ca.jacobian(e.direction, e.states)
        self._impact = self._program(e.direction, self._slopes)
        self._tail = self._program(e.free, e.direction, e.restitution)
        self._defined = self._program(e.defined)
        self._inertia = self._program(e.inertia, e.room)
        self._pushed = self._program(e.pushed)
        held = -1 if view is None else view.held
        self.held_rows = () if held < 0 else (n_x + 2 * held, n_x + 2 * held + 1)
        equations = _equations(e, section)
        gradient = ca.jacobian(equations, e.states)
        self.constraints = self._program(equations, gradient)
        self._stops = self._program(e.gaps, ca.densify(ca.jacobian(e.gaps, e.states)))
        slopes = ca.densify(ca.jacobian(e.guards, e.states))
        self._guards = self._program(e.guards, slopes, e.armed)
        self._resets = [
            self._program(one, ca.densify(ca.jacobian(one, e.states))) for one in e.resets
        ]
        self.constraint_places = list(zip(*gradient.sparsity().get_triplet(), strict=True))

    def turning_rows(self, rate: Ball | None) -> list[int]:
        """Return the rows of a set on the stop that share a frame.

        The gap is zero. A small gap rate keeps a separate axis, and so its relative precision.

        Args:
            rate: The gap rate, or None on the stop, where it is zero.
        """
        slow = rate is None or not bool(abs(rate) > _FAST)
        still = (self.gap, self.rate) if slow else (self.gap,)
        # Those of a held stop are no moving rows.
        return [k for k in self.moving_rows if k not in still]

    @property
    def moving_rows(self) -> list[int]:
        """Return the rows of a set in flight that share a frame.

        These are all except carried parameters, and gap and gap rate of a held stop.
        """
        return [k for k in range(self.n - len(self.carried)) if k not in self.held_rows]

    def impact(self, y: Sequence[Ball]) -> ImpactValues:
        """Return the impulse direction and the restitution at a state, and their derivatives.

        Raises:
            ProofError: If the restitution depends on the impact speed and is outside (0, 1).
        """
        direction, slopes = self._impact(y)
        (restitution,), gradient = self._law(y)
        if self.has_speed_law:
            inside = bool(restitution > 0) and bool(restitution < 1)
            reason = f"the restitution is not proved to be between 0 and 1 ({restitution})"
            require_proved(inside, "impact", reason)
        rows = [[ZERO] * self.n for _ in range(self.n)]
        places = zip(*self._slopes.sparsity().get_triplet(), strict=True)
        for (row, col), one in zip(places, slopes, strict=True):
            rows[row][col] = one
        return ImpactValues(
            direction=direction,
            slopes=matrix(rows, self.n),
            restitution=restitution,
            restitution_slopes=gradient,
        )

    @property
    def carried_stops(self) -> list[int]:
        """Indices of gaps and gap rates that are additional states."""
        pinned = self.expressions.coordinate is not None
        return [] if pinned else list(range(self.n_x, self.n_x + 2 * self.expressions.n_stops))

    @property
    def stopped(self) -> tuple[int, ...]:
        """Indices of the states that are zero on the section."""
        if self.section.kind is SectionKind.SWITCH and not self.section.locked:
            return self.held_rows
        return ((self.gap,) if self.struck else (self.gap, self.rate)) + self.held_rows

    @property
    def struck(self) -> bool:
        """True if the section holds the states just after an impact."""
        return self.section.kind is SectionKind.IMPACT

    def stops(self, y: Sequence[Ball]) -> tuple[list[Ball], list[list[Ball]]]:
        """Return gap and gap rate of all stops as functions of the problem's states.

        Returns:
            The values, and the derivatives of each value, ``(n,)``.
        """
        values, slopes = self._stops(y)
        return values, _rows(slopes, len(values))

    def guards(self, y: Sequence[Ball]) -> list[tuple[Ball, list[Ball]]]:
        """Return the guard of each switch with its gradient. On its side a kink's is positive."""
        values, slopes, _ = self._guards(y)
        signs = self.guard_signs
        rows = _rows(slopes, len(values))
        return [
            (sign * value, [sign * x for x in row])
            for sign, value, row in zip(signs, values, rows, strict=True)
        ]

    @property
    def guard_signs(self) -> list[int]:
        """Factor of each guard: 1, or -1 for a kink whose condition is negative."""
        sides = self.view.sides if self.view else ()
        return [*(1 for _ in self._resets), *(1 if side else -1 for side in sides)]

    @property
    def n_declared(self) -> int:
        """Number of declared switches, which precede the kinks."""
        return len(self._resets)

    def armed(self, y: Sequence[Ball]) -> list[Ball]:
        """Return the formulas `armed` of the declared switches."""
        return self._guards(y)[2]

    def switched(self, switch: int, y: Sequence[Ball]) -> tuple[list[Ball], Matrix]:
        """Return the state after a switch, ``(n,)``, and its derivative, ``(n, n)``."""
        if switch >= len(self._resets):
            return list(y), identity(self.n)
        after, slopes = self._resets[switch](y)
        return after, matrix(_rows(slopes, self.n), self.n)

    def undefined(self, y: Sequence[Ball]) -> str:
        """Return why the gap or a constraint is not proved to be analytic, real or complex."""
        if all(value.is_finite() for value in self._defined(y)[0]):
            return ""
        return "the gap or a constraint is not proved to be analytic along the motion"

    def light(self, y: Sequence[Ball]) -> str:
        """Return why the mass matrix is not proved to be positive definite on a box of states.

        The responses of the own and a held stop must be independent.
        """
        entries, room = self._inertia(y)
        if not all(bool(one > 0) for one in room):
            return "the responses of two closed stops are not proved to be independent"
        n = math.isqrt(len(entries))
        rows = [[entries[n * j + i] + entries[n * i + j] for j in range(n)] for i in range(n)]
        for k, row in enumerate(rows):
            if not bool(row[k] > 0):
                return "the mass matrix is not proved to be positive definite along the motion"
            for other in rows[k + 1 :]:
                share = other[k] / row[k]
                other[:] = [a - share * b for a, b in zip(other, row, strict=True)]
        return ""

    def opening(self, y: Sequence[Ball]) -> str:
        """Return why an impact is not proved to press the held stop on a box of states."""
        pressed = all(bool(one < 0) for one in self._pushed(y)[0])
        return "" if pressed else "an impact is not proved to press the other closed stop"

    def free_values(self, y: Sequence[Ball]) -> tuple[list[Ball], list[Ball], Ball]:
        """Return free flow, impulse direction and restitution at a state, real or complex."""
        rate, direction, (restitution,) = self._tail(y)
        return rate, direction, restitution

    def reset_derivative(self, y: Sequence[Ball]) -> Matrix:
        r"""Return the derivative of the reset at states on the stop, ``(n, n)``.

        .. math:: 1 - (1 + e)\,(d\, \partial \dot h + \dot h\, \partial d) - \dot h\, d\, \partial e
        """
        at, n = self.impact(y), self.n
        law = 1 + at.restitution
        turned = column(at.direction) * matrix([at.restitution_slopes], n)
        rows = (identity(n) - (at.slopes * law + turned) * y[self.rate]).table()
        for k in range(n):
            rows[k][self.rate] -= law * at.direction[k]
        rows[self.gap] = [ZERO] * n
        rows[self.rate] = [-y[self.rate] * slope for slope in at.restitution_slopes]
        rows[self.rate][self.rate] -= at.restitution
        return matrix(rows, n)

    def reset(self, y: Sequence[Ball]) -> list[Ball]:
        """Return the state after an impact, ``(n,)``, with a gap of zero."""
        at = self.impact(y)
        push = (1 + at.restitution) * y[self.rate]
        after = [a - push * d for a, d in zip(y, at.direction, strict=True)]
        after[self.gap], after[self.rate] = ZERO, -at.restitution * y[self.rate]
        return after

    def _program(self, *outputs: ca.SX) -> BallProgram:
        e = self.expressions
        dense = [ca.densify(one) if one.shape[1] == 1 else one for one in outputs]
        function = ca.Function("part", [e.states, e.numbers], dense, {"cse": True})
        return BallProgram(function, self.numbers)


def _rows(columns: Sequence[Ball], n: int) -> list[list[Ball]]:
    """Return the rows of a matrix of ``n`` rows that is given by columns."""
    return [list(columns[k::n]) for k in range(n)]


def power_of_two(size: float) -> float:
    """Return the power of two nearest to a size, an exact factor, or 1 for a size of 0."""
    return 2.0 ** round(math.log2(abs(size))) if size else 1.0


def require_proved(holds: bool, claim: str, reason: str) -> None:
    """Raise `ProofError` unless a condition holds.

    Args:
        holds: The condition.
        claim: Name of the claim that needs the condition.
        reason: Description of the failure.
    """
    if not holds:
        raise ProofError(claim, reason)
