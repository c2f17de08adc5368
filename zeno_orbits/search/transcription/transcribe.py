"""The conditions of a periodic orbit as a named nonlinear program.

The program uses multiple shooting over the phases of a period: usually release, first flight,
rescaled flights, Zeno point and locked arc. Every interval is one collocation step whose last stage
is the next node (theory (3.1), (3.2), (3.8)).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Array, Vector
from zeno_orbits.integrators import Collocation
from zeno_orbits.model import CompiledSystem, HybridDynamics, ImpactLaw, ParameterValues
from zeno_orbits.orbits import Cycle, EventSequence
from zeno_orbits.search.transcription.arc import CollocatedArc, TranscriptionSettings
from zeno_orbits.search.transcription.closure import Closure
from zeno_orbits.search.transcription.motion_derivative import ProgramMotion
from zeno_orbits.search.transcription.nearness import Nearness
from zeno_orbits.search.transcription.phase import PhaseTerms, PhaseWriter, WrittenPhase
from zeno_orbits.search.transcription.program import ProgramBuilder


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitTerms:
    """Quantities of an orbit, for objectives and bounds, as expressions in the unknowns.

    Attributes:
        program: The program, open for more rows.
        compiled: The functions of the problem.
        p: Gains, then parameters, as values or unknowns, ``(n_p,)``.
        free: Name to unknown of each free value.
        nearness: Measure of the distance between the free values and the start of the search.
        shape: The shape of the orbit.
        period: Period of the orbit [s].
        electrical_work: Work of the sources in one period [J].
        phases: The terms of each phase.
        end: End of the period, ``(n_x,)``. It equals the start on an orbit.
        scale: Size of each state, ``(n_x,)``.
        tangent: Basis of the scaled states near the start in which start and end are compared.
        motion: Motion from any start on the section to the end, without the closing equations.
        scheme: The collocation scheme of the arcs.
        state_names: Name of each state.
        numbers: Gains, then parameters, in the guess.
        return_slope: Derivative of the return map, ``(d, d)``, if it was declared.
    """

    program: ProgramBuilder
    compiled: CompiledSystem
    p: ca.MX
    free: Mapping[str, ca.MX]
    nearness: Nearness
    shape: EventSequence
    period: ca.MX
    electrical_work: ca.MX
    phases: tuple[PhaseTerms, ...]
    end: ca.MX
    scale: Vector
    tangent: Array
    motion: ProgramMotion
    scheme: Collocation
    state_names: tuple[str, ...]
    numbers: tuple[float, ...]
    return_slope: ca.MX | None = None

    @property
    def start(self) -> ca.MX:
        """Start of the period, ``(n_x,)``."""
        return self.phases[0].start

    @property
    def arcs(self) -> tuple[CollocatedArc, ...]:
        """The transcribed arcs of all phases, in order."""
        return tuple(arc for phase in self.phases for arc in phase.arcs)

    def guessed(self, expression: ca.MX) -> Array:
        """Return the value of an expression in the guess."""
        return np.array(self.program.at_guess(expression).full())


def transcribe(
    compiled: CompiledSystem,
    values: ParameterValues,
    *,
    dynamics: HybridDynamics,
    cycle: Cycle,
    closures: Sequence[Closure],
    free: Mapping[str, tuple[float, float]],
    nearness: Nearness,
    settings: TranscriptionSettings,
) -> OrbitTerms:
    """Declare the unknowns and the conditions of an orbit of the shape of its guess.

    Args:
        compiled: The functions of the problem.
        values: Gains and parameters, which are also the first values of the free unknowns.
        dynamics: The system at these values.
        cycle: One simulated period, the guess.
        closures: For each phase, the resolved impacts and the impacts that determine the Zeno
            point.
        free: Name to bounds of the unknown gains and parameters.
        nearness: Measure of the distance between the free values and the start of the search, for
            the objective.
        settings: Scheme, mesh and closure.

    Returns:
        The terms of an objective, with their program.
    """
    program = ProgramBuilder()
    unknown = _declare_free(program, values, free)
    named = values.numbers
    p = ca.vertcat(*(unknown.get(name, ca.MX(value)) for name, value in named.items()))
    places = [k for k, name in enumerate(named) if name in unknown]
    law = _impact_law(compiled, p, places, values.vector)
    writer = PhaseWriter(program, compiled, settings, p, law, values.vector, dynamics, cycle)

    n_free, labels = len(program.blocks), labels_of(cycle.shape)
    written: list[WrittenPhase] = []
    for k, (phase, closure) in enumerate(zip(cycle.phases, closures, strict=True)):
        here = writer.phase(labels[k], phase, closure, writer.rows_before(k))
        if written:
            writer.join(labels[k], phase, written[-1].end, here.terms.start, written[-1].rows)
        written.append(here)
    motion = ProgramMotion(blocks=program.blocks[n_free:], equations=program.equations)
    last, start = written[-1], written[0].terms.start
    tangent = writer.close(cycle.start.state, start, last.end, last.rows)

    period, work = ca.MX(0), ca.MX(0)
    for here in written:
        label = here.terms.label
        program.report(f"{label}start time", period)
        program.report(f"{label}Zeno time", period + here.limit_time)
        period, work = period + here.duration, work + here.work
    program.report("period", period)
    program.report("electrical work", work)
    return OrbitTerms(
        program=program,
        compiled=compiled,
        p=p,
        free=unknown,
        nearness=nearness,
        shape=cycle.shape,
        period=period,
        electrical_work=work,
        phases=tuple(here.terms for here in written),
        end=last.end,
        scale=writer.scale,
        tangent=tangent,
        motion=motion,
        scheme=settings.scheme,
        state_names=compiled.state_names,
        numbers=values.vector,
    )


def labels_of(shape: EventSequence) -> tuple[str, ...]:
    """Return the prefix of the names of blocks and rows of each phase."""
    if shape.n_phases == 1:
        return ("",)
    return tuple(f"phase {k + 1}: " for k in range(shape.n_phases))


def start_block(shape: EventSequence, place: int) -> str:
    """Return the name of the block with the start of a phase."""
    before = shape.phases[place - 1]
    return f"{labels_of(shape)[place]}{'release' if before.holds else 'start'} state"


def _declare_free(
    program: ProgramBuilder, values: ParameterValues, free: Mapping[str, tuple[float, float]]
) -> dict[str, ca.MX]:
    unknown: dict[str, ca.MX] = {}
    for name, (lower, upper) in free.items():
        value = values.number(name)
        size = max(abs(value), 0.01 * (upper - lower))
        unknown[name] = program.variable(
            f"free {name}", value, scale=size, lower=lower, upper=upper
        )[0, 0]
    return unknown


def _impact_law(
    compiled: CompiledSystem, p: ca.MX, free_places: Sequence[int], values: Sequence[float]
) -> ImpactLaw:
    """Return the law of impact, with constants or with functions of the free values."""
    _, columns = compiled.impulse.jac_sparsity(2, 1).get_triplet()
    if compiled.coefficient is None and not set(columns) & set(free_places):
        return ImpactLaw(ca.MX(float(compiled.law_at(ca.DM(values)).restitution)))
    return compiled.law_at(p)
