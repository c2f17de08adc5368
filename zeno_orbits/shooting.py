"""The conditions of a Zeno periodic orbit as a named nonlinear program.

Multiple shooting over release, first flight, rescaled flights, Zeno point and locked arc; every
interval is one collocation step whose last stage is the next node (theory (16), (17)).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from zeno_orbits.collocation import Array, Collocation
from zeno_orbits.compiled import CompiledSystem
from zeno_orbits.cycle import Closure, Cycle
from zeno_orbits.dynamics import HybridDynamics, Vector
from zeno_orbits.execution import Arc
from zeno_orbits.linear_algebra import null_space
from zeno_orbits.problem import Setting
from zeno_orbits.program import ProgramBuilder
from zeno_orbits.stretches import Stretch, StretchWriter, TranscriptionSettings, flow_scale
from zeno_orbits.tangents import Motion
from zeno_orbits.zeno import limit_weights, tail_time


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitTerms:
    """What an objective or a bound may speak of, as expressions in the unknowns of the program.

    Attributes:
        program: The program, open for more rows.
        compiled: The functions of the scene.
        p: Gains, then parameters, numbers or unknowns, ``(n_p,)``.
        free: Name to unknown of what is free.
        first: Name to value of what is free, where the search started.
        period: [s].
        electrical_work: Work of the sources in one period [J].
        approach_rate: Gap rate before the first impact, negative.
        release: Release state, ``(n_x,)``.
        zeno: Zeno state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        tangent: Basis of the scaled states near the release with gap and gap rate zero.
        stretches: The transcribed arcs, in order.
        motion: From any release to the end of a locked arc, not closed.
        scheme: The collocation scheme of the arcs.
        state_names: Name of each state.
        numbers: Gains, then parameters, in the guess.
        return_slope: Derivative of the return map, ``(d, d)``, if it was declared.
    """

    program: ProgramBuilder
    compiled: CompiledSystem
    p: ca.MX
    free: Mapping[str, ca.MX]
    first: Mapping[str, float]
    period: ca.MX
    electrical_work: ca.MX
    approach_rate: ca.MX
    release: ca.MX
    zeno: ca.MX
    scale: Vector
    tangent: Array
    stretches: tuple[Stretch, ...]
    motion: Motion
    scheme: Collocation
    state_names: tuple[str, ...]
    numbers: tuple[float, ...]
    return_slope: ca.MX | None = None

    def guessed(self, expression: ca.MX) -> Array:
        """Return the value of an expression in the guess."""
        return np.array(self.program.at_guess(expression).full())


def transcribe(
    compiled: CompiledSystem,
    setting: Setting,
    *,
    dynamics: HybridDynamics,
    cycle: Cycle,
    closure: Closure,
    free: Mapping[str, tuple[float, float]],
    first: Mapping[str, float],
    settings: TranscriptionSettings,
) -> OrbitTerms:
    """Declare the unknowns and the conditions of an orbit.

    Args:
        compiled: The functions of the scene.
        setting: Its numbers; what is free starts at its value here.
        dynamics: The system at these numbers.
        cycle: One simulated period, the guess.
        closure: Which impacts are resolved, and which of them tell the Zeno point.
        free: Name to bounds of the gains and parameters that are unknown.
        first: Numbers from which the search started, for the objective.
        settings: Scheme, mesh and closure.

    Returns:
        The terms of an objective, with the program they belong to.
    """
    program = ProgramBuilder()
    unknown = _declare_free(program, setting, free)
    named = {**setting.gains, **setting.parameters}
    p = ca.vertcat(*(unknown.get(name, ca.MX(value)) for name, value in named.items()))
    places = [k for k, name in enumerate(named) if name in unknown]
    restitution = _restitution(compiled, p, places, dynamics.restitution)
    writer = _Writer(program, compiled, settings, p, restitution, setting.values(), dynamics, cycle)

    n_free = len(program.blocks)
    release = program.variable("release state", cycle.start.state, scale=writer.scale)[:, 0]
    flight = writer.stretches.stretch("flight 0", cycle.flight, compiled.free, p, release)
    hops, limit = writer.impacts(flight, cycle, closure)
    zeno = program.variable("Zeno state", cycle.zeno.state, scale=writer.scale)[:, 0]
    program.equal("Zeno point", zeno - limit[2:], scale=ca.DM(writer.scale))
    locked = writer.stretches.stretch("locked", cycle.locked, compiled.locked, p, zeno)
    stretches = (flight, *hops, locked)
    writer.keep_apart(stretches)
    writer.start(release, zeno)
    motion = Motion(blocks=program.blocks[n_free:], equations=program.equations)
    tangent = writer.close(cycle.start.state, release, locked.end)

    period = limit[0] + locked.duration
    work = limit[1] + locked.work
    program.report("period", period)
    program.report("Zeno time", limit[0])
    program.report("electrical work", work)
    program.report("impact states", ca.horzcat(*(s.end[: compiled.n_x] for s in (flight, *hops))))
    program.report("flight times", ca.vertcat(*(s.duration for s in (flight, *hops))))
    return OrbitTerms(
        program=program,
        compiled=compiled,
        p=p,
        free=unknown,
        first=first,
        period=period,
        electrical_work=work,
        approach_rate=compiled.contact(flight.end, p)[1],
        release=release,
        zeno=zeno,
        scale=writer.scale,
        tangent=tangent,
        stretches=stretches,
        motion=motion,
        scheme=settings.scheme,
        state_names=compiled.state_names,
        numbers=setting.values(),
    )


def _declare_free(
    program: ProgramBuilder, setting: Setting, free: Mapping[str, tuple[float, float]]
) -> dict[str, ca.MX]:
    unknown: dict[str, ca.MX] = {}
    for name, (lower, upper) in free.items():
        value = setting.number(name)
        size = max(abs(value), 0.01 * (upper - lower))
        unknown[name] = program.variable(
            f"free {name}", value, scale=size, lower=lower, upper=upper
        )[0, 0]
    return unknown


def _restitution(
    compiled: CompiledSystem, p: ca.MX, free_places: Sequence[int], number: float
) -> ca.MX:
    """Return the restitution: a number, or a function of what is free if it depends on that."""
    _, columns = compiled.impulse.jac_sparsity(2, 1).get_triplet()
    if not set(columns) & set(free_places):
        return ca.MX(number)
    return compiled.impulse(ca.DM.zeros(compiled.n_x), p)[2]


class _Writer:
    """Writes the conditions of an orbit into one program."""

    def __init__(
        self,
        program: ProgramBuilder,
        compiled: CompiledSystem,
        settings: TranscriptionSettings,
        p: ca.MX,
        restitution: ca.MX,
        values: tuple[float, ...],
        dynamics: HybridDynamics,
        cycle: Cycle,
    ) -> None:
        self.program = program
        self.compiled = compiled
        self.p = p
        self.values = values
        self.rebound = dynamics.restitution
        self.restitution = restitution
        self.scale = cycle.scale()
        self.stretches = StretchWriter(program, compiled, settings, p, self.scale)
        self.gap_scale = _largest(cycle.flight, dynamics.gap)
        self.force_scale = _largest(cycle.locked, dynamics.multiplier)

    def impacts(
        self, flight: Stretch, cycle: Cycle, closure: Closure
    ) -> tuple[list[Stretch], ca.MX]:
        """Declare the flights between impacts and return them with the Zeno limit.

        The limit is ``(time, electrical work, state)``, theory (15).
        """
        program = self.program
        hops: list[Stretch] = []
        speeds: list[ca.MX] = []
        tails: list[ca.MX] = []
        here, time, work = flight.end, flight.duration, flight.work
        approach_rate = self.compiled.contact(here, self.p)[1]
        gap = self.compiled.contact(here, self.p)[0]
        program.equal("gap closes at impact 1", gap, scale=self.gap_scale)
        for k in range(closure.n_impacts):
            program.at_least_zero(f"impact {k + 1} closes the gap", -approach_rate)
            direction = self.compiled.impulse(here, self.p)[0]
            after = here - (1 + self.restitution) * approach_rate * direction
            if k in closure.nodes:
                speeds.append(-self.restitution * approach_rate)
                tails.append(self._tail(here, approach_rate, direction, time, work))
            if k + 1 == closure.n_impacts:
                break
            size = -self.rebound * cycle.impacts[k].approach_rate
            speed = program.variable(f"speed after impact {k + 1}", size, scale=size)
            program.equal(
                f"restitution at impact {k + 1}",
                speed + self.restitution * approach_rate,
                scale=size,
            )
            hop = self.stretches.stretch(
                f"flight {k + 1}",
                cycle.hops[k],
                self.compiled.flight,
                ca.vertcat(self.p, speed),
                ca.vertcat(after, 0, 1),
            )
            hops.append(hop)
            size = float(flow_scale(cycle.hops[k], self.scale)[-2])
            program.equal(f"gap closes at impact {k + 2}", hop.end[-2], scale=size)
            here, approach_rate = hop.end[:-2], speed * hop.end[-1]
            time, work = time + hop.duration, work + hop.work
        weights = limit_weights(speeds)
        limit = ca.MX.zeros(tails[0].numel())
        for weight, tail in zip(weights, tails, strict=True):
            limit += weight * tail
        return hops, limit

    def keep_apart(self, stretches: tuple[Stretch, ...]) -> None:
        """Require a non-negative gap in every flight and a non-negative multiplier on the stop."""
        flight, *hops, locked = stretches
        self._never_negative("gap >= 0 in flight 0", 0, flight, self.gap_scale)
        for hop in hops:
            size = float(flow_scale(hop.arc, self.scale)[-2])
            self.program.at_least_zero(f"gap >= 0 in {hop.name}", hop.stages[-2, :-1], scale=size)
        self._never_negative("multiplier >= 0 on the stop", 3, locked, self.force_scale)

    def start(self, release: ca.MX, zeno: ca.MX) -> None:
        """Require the release conditions, and that the stop attracts at the Zeno point."""
        contact = self.compiled.contact(release, self.p)
        eta = self.compiled.holonomic(release, self.p)
        self.program.equal("release: gap = 0", contact[0], scale=self.gap_scale)
        self.program.equal("release: gap rate = 0", contact[1])
        self.program.equal("release: multiplier = 0", contact[3], scale=self.force_scale)
        self.program.equal("release: holonomic constraints", eta)
        self.program.at_least_zero("release: multiplier falls", -contact[4])
        attracted = -self.compiled.contact(zeno, self.p)[2]
        self.program.at_least_zero("Zeno point: d2h/dt2 < 0", attracted)

    def close(self, at: Vector, release: ca.MX, end: ca.MX) -> Array:
        """Require that the locked arc ends at the release; return the directions that closes."""
        tangent = self._stop_tangent(at)
        change = (end - release) / ca.DM(self.scale)
        self.program.equal("the orbit closes", ca.mtimes(ca.DM(tangent).T, change))
        return tangent

    def _tail(
        self, minus: ca.MX, approach_rate: ca.MX, direction: ca.MX, time: ca.MX, work: ca.MX
    ) -> ca.MX:
        """Return ``(time, work, state)`` at the end of the tail, to first order (theory (15))."""
        resting = minus - approach_rate * direction
        acceleration = self.compiled.contact(resting, self.p)[2]
        remaining: ca.MX = tail_time(
            -self.restitution * approach_rate, acceleration, self.restitution
        )
        return ca.vertcat(
            time + remaining,
            work + remaining * self.compiled.powers(resting, self.p)[0],
            resting + remaining * self.compiled.locked.rate(resting, self.p),
        )

    def _never_negative(self, name: str, index: int, stretch: Stretch, scale: float) -> None:
        """Require a contact quantity to be non-negative at all stages of a stretch but its end."""
        x, p = ca.SX.sym("x", self.compiled.n_x), ca.SX.sym("p", self.p.numel())
        # A function of its own: the derivatives of the other quantities are not asked for.
        quantity = ca.Function("quantity", [x, p], [self.compiled.contact(x, p)[index]])
        states = stretch.stages[:, :-1]
        parameters = ca.repmat(self.p, 1, states.shape[1])
        self.program.at_least_zero_along(name, quantity, (states, parameters), scale=scale)

    def _stop_tangent(self, at: Vector) -> Array:
        """Return a basis of the scaled states near ``at`` with zero gap and gap rate."""
        x, p = ca.SX.sym("x", self.compiled.n_x), ca.SX.sym("p", len(self.values))
        held = ca.vertcat(self.compiled.contact(x, p)[0:2], self.compiled.holonomic(x, p))
        gradient = ca.Function("gradient", [x, p], [ca.jacobian(held, x)])(at, self.values)
        return null_space(np.asarray(gradient.full(), dtype=np.float64) * self.scale)


def _largest(arc: Arc, quantity: Callable[[Vector], float]) -> float:
    """Return the largest size of a quantity over an arc."""
    times = np.linspace(arc.start_time, arc.end_time, 33)
    return max(abs(quantity(arc.state_at(float(time)))) for time in times)
