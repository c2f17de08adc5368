"""The conditions of a Zeno periodic orbit as a named nonlinear program.

Multiple shooting over release, first flight, rescaled flights, Zeno point and locked arc; every
interval is one collocation step whose last stage is the next node (theory (16), (17)).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from zeno_orbits.collocation import Array, Collocation, radau
from zeno_orbits.compiled import CompiledSystem
from zeno_orbits.cycle import Closure, Cycle
from zeno_orbits.dynamics import HybridDynamics, Vector
from zeno_orbits.execution import Arc
from zeno_orbits.flows import ModeFunctions
from zeno_orbits.linear_algebra import null_space
from zeno_orbits.meshes import graded_mesh, stage_fractions
from zeno_orbits.problem import Setting
from zeno_orbits.program import ProgramBuilder
from zeno_orbits.zeno import limit_weights, tail_time


@dataclass(frozen=True, slots=True, kw_only=True)
class TranscriptionSettings:
    """How finely an orbit is transcribed.

    Attributes:
        scheme: The collocation scheme of every interval.
        mesh_tolerance: Largest deviation of an interval's polynomial from the guess between its
            stages, in units of the size of each state. Ends of intervals are more accurate.
        closure_tolerance: Largest estimated error of the Zeno closure.
    """

    scheme: Collocation = field(default_factory=lambda: radau(7))
    mesh_tolerance: float = 3e-8
    closure_tolerance: float = 1e-11


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """A transcribed arc.

    Attributes:
        name: ``flight 0``, ``flight 1``, ... or ``locked``.
        arc: The simulated arc that is its guess.
        mesh: Ends of its intervals, fractions of its duration, ``(n_intervals + 1,)``.
        start: State of its flow at its start, ``(n_y, 1)``.
        stages: States at its stages, ``(n_y, n_intervals * n_stages)``.
        duration: Its length [s].
        work: Electrical work over it [J].
    """

    name: str
    arc: Arc
    mesh: Array
    start: ca.MX
    stages: ca.MX
    duration: ca.MX
    work: ca.MX

    @property
    def end(self) -> ca.MX:
        """State of its flow at its end, ``(n_y, 1)``."""
        return self.stages[:, -1]


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitTerms:
    """What an objective may speak of, as expressions in the unknowns of the program.

    Attributes:
        program: The program, open for more rows.
        gains: Name to value.
        first_gains: Gains from which the search started.
        period: [s].
        electrical_work: Work of the sources in one period [J].
        stretches: The transcribed arcs, in order.
        scheme: Their collocation scheme.
        state_names: Name of each state.
    """

    program: ProgramBuilder
    gains: Mapping[str, ca.MX]
    first_gains: Mapping[str, float]
    period: ca.MX
    electrical_work: ca.MX
    stretches: tuple[Stretch, ...]
    scheme: Collocation
    state_names: tuple[str, ...]


def transcribe(
    compiled: CompiledSystem,
    setting: Setting,
    *,
    dynamics: HybridDynamics,
    cycle: Cycle,
    closure: Closure,
    free_gains: Mapping[str, tuple[float, float]],
    first_gains: Mapping[str, float],
    settings: TranscriptionSettings,
) -> OrbitTerms:
    """Declare the unknowns and the conditions of an orbit.

    Args:
        compiled: The functions of the scene.
        setting: Its numbers; a free gain starts at its value here.
        dynamics: The system at these numbers.
        cycle: One simulated period, the guess.
        closure: Which impacts are resolved, and which of them tell the Zeno point.
        free_gains: Name to bounds of the gains that are unknown.
        first_gains: Gains from which the search started, for the objective.
        settings: Scheme, mesh and closure.

    Returns:
        The terms of an objective, with the program they belong to.
    """
    program = ProgramBuilder()
    gains = _declare_gains(program, setting, free_gains)
    p = ca.vertcat(*gains.values(), *setting.parameters.values())
    restitution = _restitution(compiled, p, len(gains), dynamics.restitution)
    writer = _Writer(program, compiled, settings, p, restitution, setting.values(), dynamics, cycle)

    release = program.variable("release state", cycle.start.state, scale=writer.scale)[:, 0]
    flight = writer.stretch("flight 0", cycle.flight, compiled.free, p, release)
    hops, limit = writer.impacts(flight, cycle, closure)
    zeno = program.variable("Zeno state", cycle.zeno.state, scale=writer.scale)[:, 0]
    program.equal("Zeno point", zeno - limit[2:], scale=ca.DM(writer.scale))
    locked = writer.stretch("locked", cycle.locked, compiled.locked, p, zeno)
    stretches = (flight, *hops, locked)
    writer.keep_apart(stretches)
    writer.close(cycle.start.state, release, zeno, locked.end)

    period = limit[0] + locked.duration
    work = limit[1] + locked.work
    program.report("period", period)
    program.report("Zeno time", limit[0])
    program.report("electrical work", work)
    program.report("impact states", ca.horzcat(*(s.end[: compiled.n_x] for s in (flight, *hops))))
    program.report("flight times", ca.vertcat(*(s.duration for s in (flight, *hops))))
    return OrbitTerms(
        program=program,
        gains=gains,
        first_gains=first_gains,
        period=period,
        electrical_work=work,
        stretches=stretches,
        scheme=settings.scheme,
        state_names=compiled.state_names,
    )


def _declare_gains(
    program: ProgramBuilder, setting: Setting, free: Mapping[str, tuple[float, float]]
) -> dict[str, ca.MX]:
    gains: dict[str, ca.MX] = {}
    for name, value in setting.gains.items():
        if name in free:
            lower, upper = free[name]
            gains[name] = program.variable(
                f"gain {name}", value, scale=max(abs(value), 1e-3), lower=lower, upper=upper
            )
        else:
            gains[name] = ca.MX(value)
    return gains


def _restitution(compiled: CompiledSystem, p: ca.MX, n_gains: int, number: float) -> ca.MX:
    """Return the restitution: a number, or under a corrected drive a function of the gains."""
    _, columns = compiled.impulse.jac_sparsity(2, 1).get_triplet()
    if min(columns, default=n_gains) >= n_gains:
        return ca.MX(number)
    return compiled.impulse(ca.DM.zeros(compiled.n_x), p)[2]


class _Writer:
    """Writes arcs and conditions into one program."""

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
        self.settings = settings
        self.p = p
        self.values = values
        self.rebound = dynamics.restitution
        self.restitution = restitution
        self.scale = cycle.scale()
        self.gap_scale = _largest(cycle.flight, dynamics.gap)
        self.force_scale = _largest(cycle.locked, dynamics.multiplier)
        self.intervals: dict[str, ca.Function] = {}

    def stretch(self, name: str, arc: Arc, mode: ModeFunctions, p: ca.MX, start: ca.MX) -> Stretch:
        """Declare the stages of an arc and its continuity."""
        scheme, n_stages = self.settings.scheme, self.settings.scheme.n_stages
        length = arc.duration
        scale = _flow_scale(arc, self.scale)

        def trajectory(fraction: float) -> Vector:
            return arc.flow_state_at(fraction * length)

        mesh = graded_mesh(trajectory, scheme, scale=scale, tolerance=self.settings.mesh_tolerance)
        fractions = stage_fractions(mesh, scheme)
        guess = np.array([trajectory(float(fraction)) for fraction in fractions]).T
        stages = self.program.variable(f"{name} stages", guess, scale=scale)
        duration = self.program.variable(f"{name} duration", length, scale=length)
        n_intervals = len(mesh) - 1
        starts = ca.horzcat(start, stages[:, n_stages - 1 : -1 : n_stages])
        sizes = duration * ca.DM(np.diff(mesh)).T
        (works,) = self.program.equal_along(
            [f"continuity[{name}, interval {k}]" for k in range(n_intervals)],
            self._interval(mode),
            (starts, stages, sizes, ca.repmat(p, 1, n_intervals)),
            scale=np.repeat(scale[:, None], n_stages, axis=1),
        )
        unit = p[-1] if mode is self.compiled.flight else ca.MX(1)
        return Stretch(
            name=name,
            arc=arc,
            mesh=mesh,
            start=start,
            stages=stages,
            duration=unit * duration,
            work=unit * ca.sum2(works),
        )

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
            hop = self.stretch(
                f"flight {k + 1}",
                cycle.hops[k],
                self.compiled.flight,
                ca.vertcat(self.p, speed),
                ca.vertcat(after, 0, 1),
            )
            hops.append(hop)
            size = float(_flow_scale(cycle.hops[k], self.scale)[-2])
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
            size = float(_flow_scale(hop.arc, self.scale)[-2])
            self.program.at_least_zero(f"gap >= 0 in {hop.name}", hop.stages[-2, :-1], scale=size)
        self._never_negative("multiplier >= 0 on the stop", 3, locked, self.force_scale)

    def close(self, at: Vector, release: ca.MX, zeno: ca.MX, end: ca.MX) -> None:
        """Require the release conditions, and that the locked arc ends at the same release."""
        contact = self.compiled.contact(release, self.p)
        eta = self.compiled.holonomic(release, self.p)
        self.program.equal("release: gap = 0", contact[0], scale=self.gap_scale)
        self.program.equal("release: gap rate = 0", contact[1])
        self.program.equal("release: multiplier = 0", contact[3], scale=self.force_scale)
        self.program.equal("release: holonomic constraints", eta)
        self.program.at_least_zero("release: multiplier falls", -contact[4])
        attracted = -self.compiled.contact(zeno, self.p)[2]
        self.program.at_least_zero("Zeno point: d2h/dt2 < 0", attracted)
        tangent = self._stop_tangent(at)
        change = (end - release) / ca.DM(self.scale)
        self.program.equal("the orbit closes", ca.mtimes(ca.DM(tangent).T, change))

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

    def _interval(self, mode: ModeFunctions) -> ca.Function:
        """Return one collocation step: defects of its stages, work over it (theory (17))."""
        name = mode.rate.name()
        if name not in self.intervals:
            scheme = self.settings.scheme
            n_y, n_p = mode.rate.size1_in(0), mode.rate.size1_in(1)
            n_x, n_values = self.compiled.n_x, self.p.numel()
            y, size, p = ca.SX.sym("y", n_y), ca.SX.sym("size"), ca.SX.sym("p", n_p)
            stages = ca.SX.sym("stages", n_y, scheme.n_stages)
            columns = ca.horzsplit(stages)
            rates = ca.horzcat(*(mode.rate(stage, p) for stage in columns))
            defects = stages - y - size * ca.mtimes(rates, ca.DM(scheme.matrix).T)
            powers = [self.compiled.powers(stage[:n_x], p[:n_values])[0] for stage in columns]
            work = size * ca.dot(ca.DM(scheme.weights), ca.vertcat(*powers))
            self.intervals[name] = ca.Function(
                f"{name}_interval", [y, stages, size, p], [defects, work], {"cse": True}
            )
        return self.intervals[name]

    def _stop_tangent(self, at: Vector) -> Array:
        """Return a basis of the scaled states near ``at`` with zero gap and gap rate."""
        x, p = ca.SX.sym("x", self.compiled.n_x), ca.SX.sym("p", len(self.values))
        held = ca.vertcat(self.compiled.contact(x, p)[0:2], self.compiled.holonomic(x, p))
        gradient = ca.Function("gradient", [x, p], [ca.jacobian(held, x)])(at, self.values)
        return null_space(np.asarray(gradient.full(), dtype=np.float64) * self.scale)


def _flow_scale(arc: Arc, scale: Vector) -> Vector:
    """Return the size of the states of an arc's flow: in a rescaled flight, gap and rate too."""
    states = [arc.flow_state_at(float(s)) for s in np.linspace(0.0, arc.duration, 9)]
    scaled = np.max(np.abs(np.array(states)), axis=0)[len(scale) :]
    return np.concatenate([scale, scaled])


def _largest(arc: Arc, quantity: Callable[[Vector], float]) -> float:
    """Return the largest size of a quantity over an arc."""
    times = np.linspace(arc.start_time, arc.end_time, 33)
    return max(abs(quantity(arc.state_at(float(time)))) for time in times)
