"""The rows of one phase of an orbit: its start, its flights, its impacts and its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Array, Vector, null_space
from zeno_orbits.model import GAP, GAP_RATE, MULTIPLIER, CompiledSystem, HybridDynamics, ImpactLaw
from zeno_orbits.orbits import RELEASE_ROWS, REST_ROWS, Cycle, EventSequence, Phase, rows_of
from zeno_orbits.search.transcription.arc import (
    ArcWriter,
    CollocatedArc,
    TranscriptionSettings,
    flow_scale,
)
from zeno_orbits.search.transcription.closure import Closure
from zeno_orbits.search.transcription.program import ProgramBuilder
from zeno_orbits.simulation import Arc, limit_weights, tail_time


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseTerms:
    """The expressions of one phase.

    Attributes:
        label: Prefix of the names of blocks and rows. Empty for an orbit of a single phase.
        start: Start of the phase, ``(n_x,)``.
        flights: The transcribed flights.
        approach_rate: Gap rate before the first impact, negative.
        zeno: Zeno state, ``(n_x,)``, or ``None`` without a contact phase.
        locked: The transcribed locked arc, or ``None`` without a contact phase.
    """

    label: str
    start: ca.MX
    flights: tuple[CollocatedArc, ...]
    approach_rate: ca.MX
    zeno: ca.MX | None
    locked: CollocatedArc | None

    @property
    def arcs(self) -> tuple[CollocatedArc, ...]:
        """The transcribed arcs, in order."""
        return self.flights if self.locked is None else (*self.flights, self.locked)


@dataclass(frozen=True, slots=True, kw_only=True)
class WrittenPhase:
    """A phase in the program, with the expressions that only adjacent phases need.

    Attributes:
        terms: Terms of the phase.
        end: End of the phase, ``(n_x,)``.
        rows: Rows of the contact that vanish at the end by construction.
        limit_time: Time from the start of the phase to its Zeno point, or to its impact [s].
        duration: Duration of the phase [s].
        work: Electrical work over the phase [J].
    """

    terms: PhaseTerms
    end: ca.MX
    rows: tuple[int, ...]
    limit_time: ca.MX
    duration: ca.MX
    work: ca.MX


class PhaseWriter:
    """Writes the conditions of an orbit into one program."""

    def __init__(
        self,
        program: ProgramBuilder,
        compiled: CompiledSystem,
        settings: TranscriptionSettings,
        p: ca.MX,
        law: ImpactLaw,
        values: tuple[float, ...],
        dynamics: HybridDynamics,
        cycle: Cycle,
    ) -> None:
        self.program = program
        self.compiled = compiled
        self.p = p
        self.values = values
        self.law = law
        self.scale = cycle.scale()
        self.arcs = ArcWriter(program, compiled, settings, p, self.scale)
        self.cycle = cycle
        self.plastic = dynamics.restitution == 0.0
        self.dynamics = dynamics

    def rows_before(self, place: int) -> tuple[int, ...]:
        """Return the rows of the contact that vanish at the start of a phase."""
        before = EventSequence(phases=(self.cycle.phases[place - 1].kind,))
        return rows_of(before, self.dynamics.restitution)

    def phase(
        self, label: str, phase: Phase, closure: Closure, rows: tuple[int, ...]
    ) -> WrittenPhase:
        """Declare a phase: its start, its flights and impacts, and its end."""
        program, n_x = self.program, self.compiled.n_x
        released = rows == RELEASE_ROWS
        word = "release" if released else "start"
        start = program.variable(f"{label}{word} state", phase.start.state, scale=self.scale)[:, 0]
        gap_scale = _largest(phase.flight, self.dynamics.gap, n_x)
        flight = self.first_flight(label, phase, start)
        hops, limit, after = self.impacts(label, flight, phase, closure, gap_scale)
        flights = (flight, *hops)
        program.report(f"{label}impact states", ca.horzcat(*(s.end[:n_x] for s in flights)))
        program.report(f"{label}flight times", ca.vertcat(*(s.duration for s in flights)))
        approach_rate = self.arrival(flight, start)[1]
        if phase.zeno is None or phase.locked is None:
            terms = PhaseTerms(
                label=label,
                start=start,
                flights=flights,
                approach_rate=approach_rate,
                zeno=None,
                locked=None,
            )
            self.keep_apart(label, flights, gap_scale)
            self.start(label, start, rows, gap_scale)
            return WrittenPhase(
                terms=terms,
                end=after,
                rows=REST_ROWS if self.plastic else (GAP,),
                limit_time=flight.duration,
                duration=flight.duration,
                work=flight.work,
            )
        zeno = program.variable(f"{label}Zeno state", phase.zeno.state, scale=self.scale)[:, 0]
        program.equal(f"{label}Zeno point", zeno - limit[2:], scale=ca.DM(self.scale))
        locked = self.arcs.collocate(
            f"{label}locked", phase.locked, self.compiled.locked, self.p, zeno
        )
        force_scale = _largest(phase.locked, self.dynamics.multiplier, n_x)
        self.keep_apart(label, flights, gap_scale)
        self._never_negative(f"{label}multiplier >= 0 on the stop", MULTIPLIER, locked, force_scale)
        self.start(label, start, rows, gap_scale)
        attracted = -self.compiled.contact_at(zeno, self.p).gap_acceleration
        program.at_least_zero(f"{label}Zeno point: d2h/dt2 < 0", attracted)
        return WrittenPhase(
            terms=PhaseTerms(
                label=label,
                start=start,
                flights=flights,
                approach_rate=approach_rate,
                zeno=zeno,
                locked=locked,
            ),
            end=locked.end,
            rows=REST_ROWS,
            limit_time=limit[0],
            duration=limit[0] + locked.duration,
            work=limit[1] + locked.work,
        )

    def first_flight(self, label: str, phase: Phase, start: ca.MX) -> CollocatedArc:
        """Declare the first flight, in rescaled variables if it begins with an impact."""
        name, arc, compiled = f"{label}flight 0", phase.flight, self.compiled
        if not is_rescaled(arc, compiled.n_x):
            return self.arcs.collocate(name, arc, compiled.free, self.p, start)
        speed = compiled.contact_at(start, self.p).gap_rate
        return self.arcs.collocate(
            name, arc, compiled.flight, ca.vertcat(self.p, speed), ca.vertcat(start, 0, 1)
        )

    def arrival(self, flight: CollocatedArc, start: ca.MX) -> tuple[ca.MX, ca.MX]:
        """Return the gap at the end of a first flight, which must vanish, and its gap rate."""
        if not is_rescaled(flight.guess, self.compiled.n_x):
            contact = self.compiled.contact_at(flight.end, self.p)
            return contact.gap, contact.gap_rate
        rate = self.compiled.contact_at(start, self.p).gap_rate
        return flight.end[-2], rate * flight.end[-1]

    def impacts(
        self, label: str, flight: CollocatedArc, phase: Phase, closure: Closure, gap_scale: float
    ) -> tuple[list[CollocatedArc], ca.MX, ca.MX]:
        """Declare the flights between impacts. Return them, the Zeno limit, and the last reset.

        The limit is ``(time, electrical work, state)``, theory (2.7). It is empty without a contact
        phase.
        """
        program, n_x = self.program, self.compiled.n_x
        hops: list[CollocatedArc] = []
        speeds: list[ca.MX] = []
        tails: list[ca.MX] = []
        here, time, work = flight.end[:n_x], flight.duration, flight.work
        gap, approach_rate = self.arrival(flight, flight.start[:n_x])
        if is_rescaled(flight.guess, n_x):
            gap_scale = float(flow_scale(flight.guess, self.scale)[-2])
        program.equal(f"{label}gap closes at impact 1", gap, scale=gap_scale)
        after = here
        for k in range(closure.n_impacts):
            program.at_least_zero(f"{label}impact {k + 1} closes the gap", -approach_rate)
            direction = self.compiled.impulse(here, self.p)[0]
            drop: ca.MX = self.law.rate_drop(approach_rate)
            after = here - drop * direction
            if k in closure.nodes:
                speeds.append(self.law.speed_after(approach_rate))
                tails.append(self._tail(here, approach_rate, direction, time, work))
            if k + 1 == closure.n_impacts:
                break
            size = self.dynamics.speed_after(phase.impacts[k].approach_rate)
            speed = program.variable(f"{label}speed after impact {k + 1}", size, scale=size)
            program.equal(
                f"{label}restitution at impact {k + 1}",
                speed - self.law.speed_after(approach_rate),
                scale=size,
            )
            hop = self.arcs.collocate(
                f"{label}flight {k + 1}",
                phase.rescaled_flights[k],
                self.compiled.flight,
                ca.vertcat(self.p, speed),
                ca.vertcat(after, 0, 1),
            )
            hops.append(hop)
            size = float(flow_scale(phase.rescaled_flights[k], self.scale)[-2])
            program.equal(f"{label}gap closes at impact {k + 2}", hop.end[-2], scale=size)
            here, approach_rate = hop.end[:-2], speed * hop.end[-1]
            time, work = time + hop.duration, work + hop.work
        weights = limit_weights(speeds) if speeds else []
        limit = ca.MX.zeros(tails[0].numel() if tails else 0)
        for weight, tail in zip(weights, tails, strict=True):
            limit += weight * tail
        return hops, limit, after

    def keep_apart(self, label: str, flights: tuple[CollocatedArc, ...], gap_scale: float) -> None:
        """Require a non-negative gap in every flight."""
        for k, flight in enumerate(flights):
            if not is_rescaled(flight.guess, self.compiled.n_x):
                self._never_negative(f"{label}gap >= 0 in flight {k}", GAP, flight, gap_scale)
                continue
            size = float(flow_scale(flight.guess, self.scale)[-2])
            name = f"{label}gap >= 0 in flight {k}"
            self.program.at_least_zero(name, flight.stages[-2, :-1], scale=size)

    def start(self, label: str, state: ca.MX, rows: tuple[int, ...], gap_scale: float) -> None:
        """Require that a phase starts at a release, or just after an impact."""
        contact = self.compiled.contact_at(state, self.p)
        eta = self.compiled.holonomic(state, self.p)
        word = f"{label}release" if rows == RELEASE_ROWS else f"{label}start"
        self.program.equal(f"{word}: gap = 0", contact.gap, scale=gap_scale)
        if GAP_RATE in rows:
            self.program.equal(f"{word}: gap rate = 0", contact.gap_rate)
        if MULTIPLIER in rows:
            self.program.equal(
                f"{word}: multiplier = 0", contact.multiplier, scale=self.force_scale
            )
        self.program.equal(f"{word}: holonomic constraints", eta)
        if MULTIPLIER in rows:
            self.program.at_least_zero(f"{word}: multiplier falls", -contact.multiplier_rate)
        else:
            leaves = contact.gap_acceleration if GAP_RATE in rows else contact.gap_rate
            self.program.at_least_zero(f"{word}: the stop is left", leaves)

    @property
    def force_scale(self) -> float:
        """Largest multiplier of the period."""
        sizes = [
            _largest(phase.locked, self.dynamics.multiplier, self.compiled.n_x)
            for phase in self.cycle.phases
            if phase.locked is not None
        ]
        return max(sizes, default=1.0)

    def join(
        self, label: str, phase: Phase, end: ca.MX, start: ca.MX, rows: tuple[int, ...]
    ) -> None:
        """Require that a phase starts at the end of the previous phase."""
        tangent = self._stop_tangent(phase.start.state, rows)
        change = (start - end) / ca.DM(self.scale)
        name = f"{label}it starts at the end of the last phase"
        self.program.equal(name, ca.mtimes(ca.DM(tangent).T, change))

    def close(self, at: Vector, start: ca.MX, end: ca.MX, rows: tuple[int, ...]) -> Array:
        """Require that the period ends at its start, and return the compared directions."""
        tangent = self._stop_tangent(at, rows)
        change = (end - start) / ca.DM(self.scale)
        self.program.equal("the orbit closes", ca.mtimes(ca.DM(tangent).T, change))
        return tangent

    def _tail(
        self, minus: ca.MX, approach_rate: ca.MX, direction: ca.MX, time: ca.MX, work: ca.MX
    ) -> ca.MX:
        """Return ``(time, work, state)`` at the end of the tail, to first order (theory (2.7))."""
        resting = minus - approach_rate * direction
        acceleration = self.compiled.contact_at(resting, self.p).gap_acceleration
        remaining: ca.MX = tail_time(
            self.law.speed_after(approach_rate), acceleration, self.law.restitution
        )
        return ca.vertcat(
            time + remaining,
            work + remaining * self.compiled.powers(resting, self.p)[0],
            resting + remaining * self.compiled.locked.rate(resting, self.p),
        )

    def _never_negative(self, name: str, index: int, arc: CollocatedArc, scale: float) -> None:
        """Require a contact quantity to be non-negative at all stages of an arc except its end."""
        x, p = ca.SX.sym("x", self.compiled.n_x), ca.SX.sym("p", self.p.numel())
        # A separate function avoids the derivatives of the other quantities.
        quantity = ca.Function("quantity", [x, p], [self.compiled.contact(x, p)[index]])
        states = arc.stages[:, :-1]
        parameters = ca.repmat(self.p, 1, states.shape[1])
        self.program.at_least_zero_along(name, quantity, (states, parameters), scale=scale)

    def _stop_tangent(self, at: Vector, rows: tuple[int, ...]) -> Array:
        """Return a basis of the scaled states near ``at`` in which rows of the contact vanish."""
        x, p = ca.SX.sym("x", self.compiled.n_x), ca.SX.sym("p", len(self.values))
        contact = self.compiled.contact(x, p)
        held = ca.vertcat(*(contact[row] for row in rows), self.compiled.holonomic(x, p))
        gradient = ca.Function("gradient", [x, p], [ca.jacobian(held, x)])(at, self.values)
        return null_space(np.asarray(gradient.full(), dtype=np.float64) * self.scale)


def is_rescaled(arc: Arc, n_x: int) -> bool:
    """Return True if an arc is a flight in rescaled variables (theory (2.6))."""
    return arc.flow_state_at(0.0).size > n_x


def _largest(arc: Arc, quantity: Callable[[Vector], float], n_x: int) -> float:
    """Return the largest absolute value of a quantity over an arc."""
    times = np.linspace(arc.start_time, arc.end_time, 33)
    return max(abs(quantity(arc.state_at(float(time))[:n_x])) for time in times)
