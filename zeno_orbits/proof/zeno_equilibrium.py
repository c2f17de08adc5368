r"""Theorem 1 at a point: a neighbourhood of a Zeno equilibrium in which all impacts accumulate.

The bounds are the bounds of the lemma of the Zeno tail (docs/proof.md), restricted to real states,
for which analyticity is not required. The checker's balls bound formulas over boxes, rounded
outward.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.model import HybridDynamics, ParameterValues, Problem
from zeno_orbits.proof.checker.balls import Ball, NotProved, between
from zeno_orbits.proof.checker.formulas import Graph, require_analytic, walked
from zeno_orbits.proof.checker.series import values

_BITS = 200
"""The unit of balls is two to the power of minus this number."""
_ON_STOP = 1e-9
"""Largest gap and gap rate that are treated as zero, relative to their sizes."""
_STILL = 1e-9
"""Largest rate of a state at an equilibrium of the free flow, relative to the size of the state."""
_ROUNDING = 1e-9
"""Relative widening of every bound, far above the rounding errors of doubles."""
_HALVINGS, _PASSES = 40, 12
"""Number of trial boxes, and of passes that adjust the sides of the successful box."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenoNeighbourhood:
    r"""The states :math:`|x_i - x_i^*| \le r_i`, :math:`0 \le h \le H`, :math:`|\dot h| \le V`.

    From each of them infinitely many impacts (one, if `e = 0`) accumulate on the stop, at a state
    with :math:`\ddot h < 0`, within the duration.

    Attributes:
        centre: :math:`x^*`, ``(n_x,)``.
        radii: :math:`r`, ``(n_x,)``.
        gap: :math:`H`.
        gap_rate: :math:`V`.
        duration: Upper bound of the time until the Zeno point [s].
        pull: Bounds of :math:`-\ddot h` along all of these motions.
    """

    centre: tuple[float, ...]
    radii: tuple[float, ...]
    gap: float
    gap_rate: float
    duration: float
    pull: tuple[float, float]

    def contains(self, dynamics: HybridDynamics, state: Sequence[float] | Vector) -> bool:
        """Return True if a state lies in the neighbourhood.

        Args:
            dynamics: The system of the equilibrium.
            state: The state, ``(n_x,)``.
        """
        x = np.asarray(state, dtype=np.float64)
        inside = np.abs(x - np.array(self.centre)) <= np.array(self.radii)
        bounds = 0.0 <= dynamics.gap(x) <= self.gap and abs(dynamics.gap_rate(x)) <= self.gap_rate
        return bool(np.all(inside)) and bounds


@dataclass(frozen=True, slots=True, kw_only=True)
class EquilibriumReport:
    r"""Theorem 1 at a state.

    Attributes:
        state: The state, ``(n_x,)``.
        gap: :math:`h`.
        gap_rate: :math:`\dot h`.
        gap_acceleration: :math:`\ddot h` of the free flow.
        is_on_stop: True if :math:`h = \dot h = 0`.
        is_still: True if :math:`f = 0`.
        eigenvalues: Eigenvalues of the free flow's derivative, if the state is an equilibrium of
            the flow.
        neighbourhood: A neighbourhood in which impacts accumulate, or ``None`` if the conditions of
            the theorem do not hold.
    """

    state: tuple[float, ...]
    gap: float
    gap_rate: float
    gap_acceleration: float
    is_on_stop: bool
    is_still: bool
    eigenvalues: tuple[complex, ...]
    neighbourhood: ZenoNeighbourhood | None

    @property
    def is_zeno_equilibrium(self) -> bool:
        """True if the state is a fixed point of the reset map, not an equilibrium of the flow."""
        return self.is_on_stop and not self.is_still

    @property
    def has_zeno_executions(self) -> bool:
        """True if Theorem 1 holds at the state."""
        return self.is_zeno_equilibrium and self.gap_acceleration < 0.0


def _dynamics_at(problem: Problem, numbers: ParameterValues, state: Vector) -> HybridDynamics:
    """Return the system of the stop, on the branch of the kinks at a state."""
    graph = problem.graph_dynamics(numbers)
    return graph.view(((), graph.sides_at(state, graph.open_mode[1])), 0)


def equilibrium_report(
    problem: Problem, numbers: ParameterValues, state: Sequence[float]
) -> EquilibriumReport:
    """Evaluate Theorem 1 at a state.

    Args:
        problem: The problem.
        numbers: Its gains and parameters.
        state: The state, ``(n_x,)``.

    Raises:
        InputError: If the state violates a holonomic constraint, or if the neighbourhood cannot be
            computed: a restitution that depends on the state, an operation without bounds.
    """
    x = np.array(state, dtype=np.float64)
    dynamics = _dynamics_at(problem, numbers, x)
    own = dynamics.own
    off = dynamics.holonomic(x)
    if off.size and float(np.max(np.abs(off))) > _ON_STOP:
        raise InputError(
            "Argument `--at` must keep the constraints, but the state is off by "
            f"{float(np.max(np.abs(off))):.3g}. A clock keeps cosine^2 + sine^2 = 1."
        )
    gap, rate, flow = dynamics.gap(x), dynamics.gap_rate(x), dynamics.free.rate(x)
    if not np.all(np.isfinite(flow)):
        raise InputError("Argument `--at` is a state with a rate that is not finite.")
    sizes = np.maximum(own.states(len(x)), np.abs(x)) / own.time
    is_still = bool(np.all(np.abs(flow) <= _STILL * sizes))
    on_stop = abs(gap) <= _ON_STOP * own.gap and abs(rate) <= _ON_STOP * own.gap_rate
    acceleration = dynamics.gap_acceleration(x)
    holds = on_stop and not is_still and acceleration < 0.0
    spectrum = np.linalg.eigvals(dynamics.free.jacobian(x)) if is_still else np.zeros(0)
    return EquilibriumReport(
        state=tuple(map(float, x)),
        gap=gap,
        gap_rate=rate,
        gap_acceleration=acceleration,
        is_on_stop=on_stop,
        is_still=is_still,
        eigenvalues=tuple(complex(one) for one in spectrum),
        neighbourhood=zeno_neighbourhood(problem, numbers, x) if holds else None,
    )


def zeno_neighbourhood(
    problem: Problem, numbers: ParameterValues, state: Vector
) -> ZenoNeighbourhood | None:
    """Return a neighbourhood of a Zeno equilibrium in which all impacts accumulate.

    The box around the equilibrium starts at the problem's characteristic sizes and is halved until
    the bounds hold. Then its sides are doubled and halved one by one as long as the neighbourhood
    grows.

    Args:
        problem: The problem.
        numbers: Its gains and parameters.
        state: The Zeno equilibrium, ``(n_x,)``.
    """
    bounds = _Bounds(problem, numbers, state)
    own = _dynamics_at(problem, numbers, state).own
    sizes = np.maximum(own.states(len(state)), np.abs(state))
    boxes = (sizes * 2.0**-k for k in range(_HALVINGS))
    sides = next((box for box in boxes if bounds.neighbourhood(box) is not None), None)
    if sides is None:
        return None
    best = bounds.neighbourhood(sides)
    for _ in range(_PASSES):
        before = best
        for k in range(len(sides)):
            for factor in (2.0, 0.5):
                trial = sides.copy()
                trial[k] *= factor
                found = bounds.neighbourhood(trial)
                if _size(found) > _size(best):
                    best, sides = found, trial
        if best is before:
            break
    return best


def _size(found: ZenoNeighbourhood | None) -> float:
    """Return a measure of a neighbourhood, with equal weights for its gap rate and its sides."""
    if found is None:
        return -math.inf
    return math.log(found.gap_rate) + float(np.mean(np.log(found.radii)))


_Over = tuple[Vector, Vector, float, float]
"""Bounds of the flow, of the impulse direction and of the pull over a box."""


class _Bounds:
    """Bounds of a problem's formulas over boxes around a state, and their neighbourhoods."""

    def __init__(self, problem: Problem, numbers: ParameterValues, state: Vector) -> None:
        symbols = problem.symbols()
        system = problem.one_stop_model(symbols)
        if ca.depends_on(system.law_numbers, system.state):
            raise InputError(
                "A neighbourhood needs a restitution that does not depend on the state."
            )
        speed = ca.SX.sym("speed")
        law = ca.SX(system.law.at(speed))
        outputs = [system.free_flow, system.impulse_direction, system.gap_acceleration, law]
        parameters = ca.vertcat(*symbols.values())
        function = ca.Function(
            "bounds", [system.state, parameters, speed], [ca.densify(one) for one in outputs]
        )
        self._graph, self._state = Graph(), state
        self._x = [self._graph.put("input") for _ in range(len(state))]
        places = [self._graph.put("input") for _ in numbers.vector]
        self._speed = self._graph.put("input")
        try:
            nodes = walked(function, self._graph, [self._x, places, [self._speed]])
            require_analytic(self._graph, [node for group in nodes for node in group])
        except NotProved as error:
            raise InputError(f"A neighbourhood cannot be computed: {error}.") from error
        *self._outputs, self._law = [node for group in nodes for node in group]
        self._numbers = {
            k: _ball(Fraction(value), Fraction(0))
            for k, value in zip(places, numbers.vector, strict=True)
        }
        self._is_constant = system.law.of_speed is None
        self._restitution = _dynamics_at(problem, numbers, state).restitution

    def neighbourhood(self, sides: Vector) -> ZenoNeighbourhood | None:
        r"""Return the neighbourhood whose motions stay in a box, or ``None`` if none is found.

        In the box :math:`|f_i| \le F_i`, :math:`|d_i| \le D_i` and
        :math:`\alpha \le -\ddot h \le A`. With :math:`H = V^2 / (2 A)` the first impact comes
        within :math:`t_1 = V (1 + \sqrt{1 + \alpha / A}) / \alpha`, at a speed of at most
        :math:`w = V \sqrt{1 + A / \alpha}`. A flight that starts at the speed `u` lasts at most
        :math:`2 u / \alpha` and ends at :math:`u \sqrt{A / \alpha}`. So the speeds decrease by the
        factor :math:`\rho = e \sqrt{A / \alpha}` per impact, and all impacts occur within
        :math:`T = t_1 + 2 e w / (\alpha (1 - \rho))`. A state moves by at most
        :math:`F_i T + (1 + e) D_i w / (1 - \rho)`. This must not exceed half of the box, since
        motions start in the inner half of the box. If the restitution depends on the speed, `e` is
        its largest value up to the speed `w`, and `V` is halved until that value allows it.

        Args:
            sides: Half the sides of the box, ``(n_x,)``.
        """
        found = self._over(sides)
        if found is None:
            return None
        wanted = self._rate(sides, found, self._restitution)
        if wanted is None or self._is_constant:
            return wanted and self._found(sides, found, *wanted)
        for k in range(_HALVINGS):
            most = wanted[0] * 2.0**-k
            e = self._largest_restitution(most * math.sqrt(1 + found[3] / found[2]))
            allowed = None if e is None else self._rate(sides, found, e)
            if allowed is not None and allowed[0] >= most:
                return self._found(sides, found, most, allowed[1])
        return None

    def _rate(self, sides: Vector, found: _Over, e: float) -> tuple[float, float] | None:
        """Return `V` and `T / V` for a restitution, or ``None`` if no motion stays in the box."""
        flow, direction, weakest, strongest = found
        fall = e * math.sqrt(strongest / weakest) * (1 + _ROUNDING)
        if fall >= 1.0:
            return None
        # All bounds are proportional to V. The following bounds are for V = 1.
        first = (1 + math.sqrt(1 + weakest / strongest)) / weakest
        speed = math.sqrt(1 + strongest / weakest)
        time = first + 2 * e * speed / (weakest * (1 - fall))
        way = flow * time + (1 + e) * direction * speed / (1 - fall)
        moves = way > 0.0
        if not np.any(moves):
            return None
        return float(np.min(sides[moves] / 2 / way[moves])) * (1 - _ROUNDING), time

    def _found(self, sides: Vector, found: _Over, rate: float, time: float) -> ZenoNeighbourhood:
        _, _, weakest, strongest = found
        return ZenoNeighbourhood(
            centre=tuple(map(float, self._state)),
            radii=tuple(map(float, sides / 2)),
            gap=rate**2 / (2 * strongest) * (1 - _ROUNDING),
            gap_rate=rate,
            duration=rate * time * (1 + _ROUNDING),
            pull=(weakest, strongest),
        )

    def _largest_restitution(self, speed: float) -> float | None:
        """Return the largest restitution up to a speed, ``None`` if it may lie outside [0, 1]."""
        half = Fraction(speed * (1 + _ROUNDING)) / 2
        try:
            (found,) = values(
                self._graph, self._numbers | {self._speed: _ball(half, half)}, [self._law]
            )
        except NotProved:
            return None
        unit = 2.0**-_BITS
        high = float(found.high) * unit * (1 + _ROUNDING)
        return high if float(found.low) >= 0.0 and high <= 1.0 else None

    def _over(self, sides: Vector) -> _Over | None:
        """Return bounds of flow, impulse and pull over a box, or ``None`` for an unbounded pull."""
        box = {
            place: _ball(Fraction(float(x)), Fraction(float(side)))
            for place, x, side in zip(self._x, self._state, sides, strict=True)
        }
        try:
            found = values(self._graph, self._numbers | box, self._outputs)
        except NotProved:
            return None
        n, unit = len(sides), 2.0**-_BITS
        sizes = np.array([float(one.size) * unit for one in found[: 2 * n]]) * (1 + _ROUNDING)
        acceleration = found[2 * n]
        weakest = -float(acceleration.high) * unit * (1 - _ROUNDING)
        strongest = -float(acceleration.low) * unit * (1 + _ROUNDING)
        if weakest <= 0.0:
            return None
        return sizes[:n], sizes[n:], weakest, strongest


def _ball(middle: Fraction, radius: Fraction) -> Ball:
    """Return the ball of an interval, rounded outward."""
    scale = 2**_BITS
    low, high = (middle - radius) * scale, (middle + radius) * scale
    return between(math.floor(low), math.ceil(high), _BITS)
