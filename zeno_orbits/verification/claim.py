"""The claimed orbit: its data as vectors, in the order of the problem's states."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, finite_number
from zeno_orbits.model import Problem
from zeno_orbits.orbits import EventSequence, Orbit, OrbitImpact, OrbitPhase, PhaseKind


@dataclass(frozen=True, slots=True, kw_only=True)
class ClaimedPhase:
    """A phase of an orbit, as vectors.

    Attributes:
        start_time: Time of the start [s].
        start: State at the start, ``(n_x,)``.
        impacts: Time [s] of every resolved impact and the state before it, ``(n_x,)``.
        zeno: Zeno time [s] and state, ``(n_x,)``, if contact follows.
    """

    start_time: float
    start: Vector
    impacts: tuple[tuple[float, Vector], ...]
    zeno: tuple[float, Vector] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """An orbit, as vectors.

    Attributes:
        shape: Its shape.
        period: Period [s].
        phases: Its phases.
        end: Time [s] of the last event and the state before it, ``(n_x,)``.
    """

    shape: EventSequence
    period: float
    phases: tuple[ClaimedPhase, ...]
    end: tuple[float, Vector]

    @property
    def start(self) -> Vector:
        """Start of the period, ``(n_x,)``."""
        return self.phases[0].start


def claim_of(orbit: Orbit, problem: Problem) -> Claim:
    """Return an orbit's data as vectors.

    Raises:
        InputError: If the orbit belongs to another problem, its names differ from the problem's, or
            a time is not finite.
    """
    if orbit.problem != problem.name:
        message = (
            f"Argument `orbit` must be of problem `{problem.name}`, but it is of `{orbit.problem}`."
        )
        raise InputError(message)
    for k, phase in enumerate(orbit.phases):
        _require_impacts(phase, "" if len(orbit.phases) == 1 else f" in phase {k + 1}")
    require_values(orbit, problem)

    def vector(named: Mapping[str, float], where: str) -> Vector:
        _require_same(named, problem.state_names, f"must have all states in `{where}`")
        return np.array(problem.state_vector(named))

    def hit(impact: OrbitImpact) -> tuple[float, Vector]:
        return finite_number("time", impact.time), vector(impact.state_minus, "impacts")

    one, last = orbit.shape.has_one_release, orbit.events[-1]
    return Claim(
        shape=orbit.shape,
        period=finite_number("period", orbit.period),
        phases=tuple(
            ClaimedPhase(
                start_time=finite_number("start_time", phase.start_time),
                start=vector(phase.start_state, "release_state" if one else "start_state"),
                impacts=tuple(map(hit, phase.impacts)),
                zeno=None
                if phase.zeno_time is None or phase.zeno_state is None
                else (
                    finite_number("zeno_time", phase.zeno_time),
                    vector(phase.zeno_state, "zeno_state"),
                ),
            )
            for phase in orbit.phases
        ),
        end=(finite_number("period", last.time), vector(last.state, "events")),
    )


def require_values(orbit: Orbit, problem: Problem) -> None:
    """Reject an orbit that lacks a value of its problem, or has another.

    Args:
        orbit: The orbit.
        problem: Its problem.

    Raises:
        InputError: If its gains or parameters have other names.
    """
    for name, values, known in (
        ("gains", orbit.gains, [gain.name for gain in problem.gains]),
        ("parameters", orbit.parameters, [quantity.name for quantity in problem.parameters]),
    ):
        _require_same(values, known, f"must have the {name} of its problem")


def _require_same(names: Iterable[str], known: Iterable[str], wanted: str) -> None:
    odd = ", ".join(sorted(set(names) ^ set(known)))
    if odd:
        raise InputError(f"Argument `orbit` {wanted}, but these differ: {odd}.")


def _require_impacts(phase: OrbitPhase, where: str) -> None:
    """Reject a phase without an impact, or with several impacts if the first ends the phase."""
    if not phase.impacts:
        raise InputError(f"Argument `orbit` lacks an impact{where}.")
    if phase.kind is not PhaseKind.ZENO and len(phase.impacts) > 1:
        wanted = f"must have one impact{where}, which is `{phase.kind.value}`"
        raise InputError(f"Argument `orbit` {wanted}, but it has {len(phase.impacts)}.")
