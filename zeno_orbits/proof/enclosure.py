"""Enclose one period of an orbit from its start, whether or not the return map contracts.

The motions from a small box on the release section are enclosed over one period, as for a proof.
The enclosure shows that they have the events of the orbit file in the same order, without further
contact. No fixed point is needed.
"""

from __future__ import annotations

import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

from flint import arb, ctx

from zeno_orbits.errors import InputError, ProofError, TranslationError
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Orbit, OrbitPhase
from zeno_orbits.proof.arithmetic.balls import Ball, all_finite, exact_fraction
from zeno_orbits.proof.claims import own_state
from zeno_orbits.proof.integration.ball_system import BallSystem, require_proved
from zeno_orbits.proof.integration.machine import BallMachine
from zeno_orbits.proof.integration.orbit_walk import (
    LEAST_SIZE,
    ProofStart,
    ball_machine,
    proof_start,
    prover_state,
    require_fit,
    walk_period,
)
from zeno_orbits.proof.integration.section import SectionStart, section_places, start_on_section
from zeno_orbits.proof.integration.sets import ProofStage
from zeno_orbits.proof.integration.walk import PassageKind, ProofPassage, WalkSettings
from zeno_orbits.proof.period_enclosure import EnclosedEvent, PeriodEnclosure
from zeno_orbits.proof.proof_file import require_hypotheses, system_data
from zeno_orbits.proof.theorem import ProvedInterval, double_above
from zeno_orbits.work import Progress, silent

_RADII = (1e-11, 1e-14)
"""Trial radii of the box, relative to the size of each coordinate: error and rounding of a file."""
_BITS = 96


@dataclass(frozen=True, slots=True, kw_only=True)
class EnclosureSettings:
    """Settings of the enclosure of a period.

    Attributes:
        radius: Radius of the box of initial states, relative to the size of each coordinate. None
            tries two radii.
        tolerance: Largest distance between the orbit file and any execution of the box, for each
            event time and state. Times are relative to the period, states to their size.
        bits: Precision of the ball arithmetic [bits].
        walk: Settings of the steps.
    """

    radius: float | None = None
    tolerance: float = 1e-9
    bits: int = _BITS
    walk: WalkSettings = field(default_factory=WalkSettings)

    def __post_init__(self) -> None:
        """Check that the radius and the tolerance are in range.

        Raises:
            InputError: If the radius or the tolerance is out of range.
        """
        for name, value in (("radius", self.radius), ("tolerance", self.tolerance)):
            if value is not None and not 0.0 < value < 1.0:
                raise InputError(f"Argument `{name}` must lie in (0, 1), but it is {value!r}.")


class _ContradictionError(ProofError):
    """An enclosure excludes a value of the orbit file, so a smaller box cannot succeed."""


def enclose_one_period(
    orbit: Orbit,
    problem: Problem,
    *,
    settings: EnclosureSettings | None = None,
    on_progress: Progress = silent,
) -> PeriodEnclosure:
    """Enclose one period of an orbit: its events in order, without further contact in between.

    Args:
        orbit: The orbit. Only its values are used.
        problem: Its problem.
        settings: Settings of the enclosure.
        on_progress: Called with the stage and the part of it that is done.

    Returns:
        The events with their times, or the claim that could not be shown.

    Raises:
        InputError: If the orbit does not fit the problem.
    """
    started = clock.process_time()
    settings, values = settings or EnclosureSettings(), orbit.values(problem)
    try:
        with ctx.workprec(settings.bits):
            require_fit(orbit, problem, values)
            require_proved(orbit.has_phases, "shape", "the machine has several stops or switches")
            reason = f"the period does not start at a release (shape `{orbit.shape.text}`)"
            require_proved(orbit.shape.n_releases > 0, "shape", reason)
            held = all(phase.kind.holds for phase in orbit.phases)
            reason = f"an impact is followed by a flight (shape `{orbit.shape.text}`)"
            require_proved(held, "shape", reason)
            given = proof_start(orbit)
            machine, system = ball_machine(given, problem, values, {})
            require_hypotheses(system_data(problem, values, {}, system), problem)
            found = _enclosed(given, problem, machine, system, settings, on_progress)
    except ProofError as error:
        found = PeriodEnclosure(problem=problem.name, claim=error.claim, reason=error.reason)
    except TranslationError as error:
        reason = str(error).removesuffix(".")
        found = PeriodEnclosure(problem=problem.name, claim="model", reason=reason)
    return replace(found, processor_time=clock.process_time() - started)


def _enclosed(
    given: ProofStart,
    problem: Problem,
    machine: BallMachine,
    system: BallSystem,
    settings: EnclosureSettings,
    on_progress: Progress,
) -> PeriodEnclosure:
    """Return the enclosure from the largest trial box that meets the tolerance."""
    orbit = given.orbit
    y = prover_state(system, problem, orbit)
    places, others = section_places(system, y)
    sizes = [max(abs(y[k]), LEAST_SIZE) for k in places]
    tried = _RADII if settings.radius is None else (settings.radius,)
    failure = ProofError("start", "no box was tried")
    for radius in tried if places else (0.0,):
        radii = [radius * size for size in sizes]
        try:
            start = start_on_section(system, [arb(value) for value in y], places, others, radii)
            passage = walk_period(given, machine, system, start, settings.walk, on_progress)
            match = _Match(orbit, problem, system, start, settings.tolerance)
            return match.enclosure(passage, radius)
        except _ContradictionError:
            raise
        except ProofError as error:
            failure = error
    raise failure


@dataclass(slots=True, kw_only=True)
class _Group:
    """Events up to a release: impacts, the Zeno point, the release."""

    impacts: list[ProofStage]
    zeno: ProofStage
    release: ProofStage


class _Match:
    """Comparison of an orbit file with enclosures, with the largest distance so far."""

    def __init__(
        self,
        orbit: Orbit,
        problem: Problem,
        system: BallSystem,
        start: SectionStart,
        tolerance: float,
    ) -> None:
        self._orbit, self._problem, self._system = orbit, problem, system
        self._start, self._tolerance = start, tolerance
        self._far = 0.0, "", ""

    def enclosure(self, passage: ProofPassage, radius: float) -> PeriodEnclosure:
        """Return the enclosure that results from a passage.

        Raises:
            ProofError: If a value of the file is excluded, or its enclosure is too wide.
        """
        phases, groups = self._orbit.phases, _groups(passage)
        self._state("the start", phases[0].start_state, self._start.at.box)
        for number, (phase, group) in enumerate(zip(phases, groups, strict=True), start=1):
            self._flights(number, phase, group)
            after = phases[number] if number < len(phases) else None
            time = self._orbit.period if after is None else after.start_time
            state = phases[0].start_state if after is None else after.start_state
            self._event("release", f"release {number}", time, state, group.release)
        miss, name, text = self._far
        reason = f"{name} is enclosed in {text} only, a distance of {miss:.1e} from the orbit file"
        require_proved(miss <= self._tolerance, "width", reason)
        return PeriodEnclosure(
            problem=self._problem.name,
            events=tuple(
                EnclosedEvent(kind=one.kind.value, time=self._time(one.stage))
                for one in passage.events
            ),
            miss=miss,
            radius=radius,
            n_inclusions=len(passage.records),
        )

    def _flights(self, number: int, phase: OrbitPhase, group: _Group) -> None:
        """Compare the impacts of a phase and the Zeno point that ends them."""
        count, found = len(phase.impacts), len(group.impacts)
        if count == 0 or (self._system.plastic and count != found):
            reason = f"phase {number} has {found} impacts, but the orbit file has {count}"
            raise _ContradictionError("shape", reason)
        for k, (impact, stage) in enumerate(zip(phase.impacts, group.impacts, strict=False)):
            name = f"impact {k + 1} of phase {number}"
            self._event("impact", name, impact.time, impact.state_minus, stage)
        last, zeno = self._time(group.impacts[-1]), self._time(group.zeno)
        tail = ProvedInterval(low=last.low, high=zeno.high)
        for impact in phase.impacts[found:]:
            # Impacts in the tail lie between the last resolved impact and the Zeno point.
            self._excluded("impact_time", "a later impact", impact.time, tail, self._orbit.period)
        if phase.zeno_time is None or phase.zeno_state is None:
            raise _ContradictionError("shape", f"phase {number} lacks a Zeno point in the file")
        name = f"the Zeno point of phase {number}"
        self._event("zeno", name, phase.zeno_time, phase.zeno_state, group.zeno)

    def _event(
        self, kind: str, name: str, time: float, state: Mapping[str, float], stage: ProofStage
    ) -> None:
        self._number(f"{kind}_time", name, time, self._time(stage), self._orbit.period)
        self._state(name, state, stage.at.box)

    def _state(self, name: str, state: Mapping[str, float], box: Sequence[Ball]) -> None:
        own = own_state(self._system, box)
        for one, unit, x in zip(self._problem.state_names, self._system.units, own, strict=False):
            size = max(unit, abs(state[one]))
            self._number("state", f"`{one}` at {name}", state[one], _interval(x), size)

    def _number(
        self, claim: str, name: str, value: float, enclosed: ProvedInterval, size: float
    ) -> None:
        self._excluded(claim, name, value, enclosed, size)
        far = double_above(enclosed.reaches(value) / Fraction(size))
        self._far = max(self._far, (far, name, enclosed.text))

    def _excluded(
        self, claim: str, name: str, value: float, enclosed: ProvedInterval, size: float
    ) -> None:
        if not enclosed.misses(value) <= self._tolerance * size:
            reason = f"{name} is enclosed in {enclosed.text}, but the orbit file has {value!r}"
            raise _ContradictionError(claim, reason)

    def _time(self, stage: ProofStage) -> ProvedInterval:
        return _interval(stage.time.at(self._start.at.U))


def _groups(passage: ProofPassage) -> list[_Group]:
    """Return the events of a passage, grouped by release."""
    groups: list[_Group] = []
    impacts: list[ProofStage] = []
    zeno: ProofStage | None = None
    for event in passage.events:
        if event.kind is PassageKind.IMPACT:
            impacts.append(event.stage)
        elif event.kind is PassageKind.ZENO_POINT:
            zeno = event.stage
        elif zeno is not None:
            groups.append(_Group(impacts=impacts, zeno=zeno, release=event.stage))
            impacts, zeno = [], None
    return groups


def _interval(x: Ball) -> ProvedInterval:
    """Return a ball as an interval."""
    require_proved(all_finite([x]), "width", "the bounds of an enclosure are missing")
    return ProvedInterval(low=exact_fraction(x.lower().mid()), high=exact_fraction(x.upper().mid()))
