"""Terms of an orbit made by hand, for what objectives and bounds add to its program.

A point of two states ``x`` and ``v`` and one number ``k``; its arcs are cubics, which collocation
with three stages holds exactly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from numpy.polynomial import Polynomial

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import radau_scheme
from zeno_orbits.model import ContactQuantities
from zeno_orbits.orbits import EventSequence, PhaseKind
from zeno_orbits.search.transcription.arc import CollocatedArc
from zeno_orbits.search.transcription.mesh import stage_fractions
from zeno_orbits.search.transcription.phase import PhaseTerms
from zeno_orbits.search.transcription.program import ProgramBuilder

SCHEME = radau_scheme(3)
K = 2.0
SCALE = np.array([4.0, 0.5])


@dataclass(frozen=True, kw_only=True)
class Course:
    """A simulated arc: one polynomial a state, in the part of its duration that has passed.

    Attributes:
        start_time: Its start [s].
        duration: Its length [s].
        curves: The polynomials.
    """

    start_time: float
    duration: float
    curves: tuple[Polynomial, ...]

    @property
    def end_time(self) -> float:
        """Its end [s]."""
        return self.start_time + self.duration

    @property
    def flow_times(self) -> Vector:
        """Ends of the steps of an engine that took one."""
        return np.array([0.0, self.duration])

    @property
    def start_state(self) -> Vector:
        """State at its start."""
        return self.at(0.0)

    @property
    def end_state(self) -> Vector:
        """State at its end."""
        return self.at(1.0)

    def state_at(self, time: float) -> Vector:
        """Return the state at a time [s]."""
        return self.at((time - self.start_time) / self.duration)

    def states_at(self, times: Vector) -> Vector:
        """Return the states at times [s], one row each."""
        return np.array([self.state_at(time) for time in times.tolist()])

    def at(self, fraction: float) -> Vector:
        """Return the state at a fraction of the arc."""
        return np.array([curve(fraction) for curve in self.curves])


def course(
    x: Sequence[float], v: Sequence[float], *, duration: float = 2.0, start_time: float = 5.0
) -> Course:
    """Return an arc by the coefficients of its polynomials, constant term first."""
    curves = (Polynomial(list(x)), Polynomial(list(v)))
    return Course(start_time=start_time, duration=duration, curves=curves)


def compiled() -> Any:
    """Return the functions of the point: a gap ``x``, one motor, and a stop."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 1)
    contact = ca.vertcat(x[0], x[1], -p[0] - x[0], p[0] * x[0] + x[1], x[1] - p[0])
    function = ca.Function("contact", [x, p], [contact])
    return SimpleNamespace(
        n_x=2,
        state_names=("x", "v"),
        contact=function,
        contact_at=lambda at, numbers: ContactQuantities.of(function(at, numbers)),
        motors=ca.Function("motors", [x, p], [p[0] * x[0], p[0] * x[1]]),
    )


@dataclass(kw_only=True)
class HandMade:
    """Builds terms arc by arc."""

    program: ProgramBuilder
    p: ca.MX

    def arc(
        self, name: str, guess: Course, mesh: Sequence[float] = (0.0, 0.25, 1.0)
    ) -> CollocatedArc:
        """Return an arc whose start and stages are unknowns."""
        ends = np.array(mesh)
        states = np.array([guess.at(float(s)) for s in stage_fractions(ends, SCHEME)]).T
        start = self.program.variable(f"{name} start", guess.at(0.0), scale=SCALE)
        stages = self.program.variable(f"{name} stages", states, scale=SCALE)
        duration = self.program.variable(f"{name} duration", guess.duration)[0, 0]
        simulated: Any = guess
        return CollocatedArc(
            name=name,
            guess=simulated,
            mesh=ends,
            start=start,
            stages=stages,
            duration=duration,
            work=duration,
        )

    def phase(
        self,
        label: str,
        flight: Course,
        locked: Course | None = None,
        *,
        approach_rate: float = -3.0,
    ) -> PhaseTerms:
        """Return a phase of one flight, and a locked arc if it has one."""
        flown = self.arc(f"{label}flight", flight)
        held = None if locked is None else self.arc(f"{label}locked", locked)
        return PhaseTerms(
            label=label,
            start=flown.start,
            flights=(flown,),
            approach_rate=ca.MX(approach_rate),
            zeno=None if held is None else held.start,
            locked=held,
        )

    def terms(self, *phases: PhaseTerms, free: Mapping[str, ca.MX] | None = None) -> Any:
        """Return the terms of phases; their period is 8 s, their work -20 J."""
        lets_go = any(one.locked is None for one in phases)
        held = PhaseKind.PLASTIC if lets_go else PhaseKind.ZENO
        kinds = [PhaseKind.IMPACT if one.locked is None else held for one in phases]
        return SimpleNamespace(
            program=self.program,
            compiled=compiled(),
            p=self.p,
            free=free or {},
            shape=EventSequence(phases=tuple(kinds)) if kinds else None,
            period=ca.MX(8.0),
            electrical_work=ca.MX(-20.0),
            phases=phases,
            arcs=tuple(arc for phase in phases for arc in phase.arcs),
            scale=SCALE,
            scheme=SCHEME,
            state_names=("x", "v"),
            numbers=(K,),
            return_slope=None,
            guessed=lambda expression: self.program.at_guess(expression).full(),
        )


def hand_made() -> HandMade:
    """Return a builder with an empty program at ``k = 2``."""
    return HandMade(program=ProgramBuilder(), p=ca.MX([K]))


def rows_of(program: ProgramBuilder) -> dict[str, list[float]]:
    """Return the rows of a program at its guess by their names, in order."""
    # A program has a row and an unknown; these are left out of what is told.
    program.equal("", ca.MX(0))
    if not program.blocks:
        program.variable("", 0.0)
    built = program.build()
    values = ca.Function("rows", [built.unknowns], [built.rows])(built.guess).full().ravel()
    found: dict[str, list[float]] = {}
    for name, value in zip(built.row_names, values, strict=True):
        found.setdefault(name, []).append(float(value))
    return {name: entries for name, entries in found.items() if name}
