"""Proof that a periodic orbit exists: choose a box, enclose one period, evaluate the return."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

import numpy as np
from flint import arb, ctx

from zeno_orbits.errors import ProofError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.proof.arithmetic.balls import Ball
from zeno_orbits.proof.basin import large_sets
from zeno_orbits.proof.checker.certificate import check_proof
from zeno_orbits.proof.claims import (
    CLOSE,
    claims_of,
    proof_bounds,
    proved_box,
    require_numbers,
    require_switches,
    section_box,
)
from zeno_orbits.proof.fixed_point import JudgedBox, judge
from zeno_orbits.proof.integration.ball_system import BallSystem, SectionKind
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
from zeno_orbits.proof.integration.walk import ProofPassage, WalkSettings
from zeno_orbits.proof.proof_file import (
    CertificateWriter,
    certificate,
    check_bits,
    proof_versions,
    require_hypotheses,
    system_data,
)
from zeno_orbits.proof.theorem import Proof
from zeno_orbits.work import Progress, silent

_RADII = (1e-9, 1e-12, 1e-14)
"""Trial radii of the box, relative to the size of each coordinate."""
_ATTEMPTS = 3
"""Largest number of further boxes that are tried after failures."""
_FOR_EVERY_BOX = ("shape", "steps")
"""Claims that fail for every box if they fail for one."""
_REFINEMENTS = 8
_FINE = 4e-15
"""Radius of the box that determines the digits, relative to the size of each coordinate."""
_BITS = 96
_ENLARGEMENTS = 12
"""Largest number of larger boxes that are tried for a basin."""
_MOST_SETS = 4
"""Largest number of sets that the checker judges."""
_GROWTH, _WORTH = 100.0, 2.0
"""First and smallest factor from a box to a larger box."""
_THINNEST = 0.01
"""Smallest ratio by which a side of the box is shortened relative to the others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofSettings:
    """Settings of a proof.

    Attributes:
        radius: Radius of a single box, relative to the size of each coordinate. None chooses a box
            automatically, and a much smaller box in it for the digits.
        basin: True for a set of initial states that is mapped into its interior and is as large as
            the enclosures allow.
        bits: Precision of the ball arithmetic [bits].
        walk: Settings of the steps.
    """

    radius: float | None = None
    basin: bool = False
    bits: int = _BITS
    walk: WalkSettings = field(default_factory=WalkSettings)


def prove_orbit(
    orbit: Orbit,
    problem: Problem,
    *,
    over: Mapping[str, float] | None = None,
    settings: ProofSettings | None = None,
    on_progress: Progress = silent,
) -> Proof:
    """Prove that a return map has exactly one fixed point near an orbit, stable or unstable.

    Args:
        orbit: The orbit. Only its values are used.
        problem: Its problem.
        over: Gain or parameter to the radius of its interval. The proof covers the whole interval.
        settings: Settings of the proof.
        on_progress: Called with the stage and the part of it that is done.

    Returns:
        The theorem with its certificate, or the claim that could not be proved.

    Raises:
        InputError: If the orbit or a name does not fit the problem.
        TranslationError: If the problem is not analytic.
    """
    started = clock.perf_counter()
    settings, over = settings or ProofSettings(), dict(over or {})
    values = orbit.values(problem)
    for name in over:
        problem.place(name, argument="interval")
    over = {name: over[name] for name in problem.names if name in over}
    try:
        with ctx.workprec(settings.bits):
            require_fit(orbit, problem, values)
            given = proof_start(orbit)
            machine, system = ball_machine(given, problem, values, over)
            if not machine.is_graph:
                require_hypotheses(system_data(problem, values, over, system), problem)
            search = _Search(given, problem, machine, system, over, settings, on_progress)
            found = _found(search)
            if settings.basin:
                found = _enlarged(search, found)
            passes = [found]
            if found.by_krawczyk and found.start.places and not over and settings.radius is None:
                passes += _refined(search, found)
            proof = _proof(search, values, passes)
            if settings.basin:
                proof = _with_basin(proof, search, found)
    except ProofError as error:
        proof = Proof(
            problem=problem.name,
            claim=error.claim,
            reason=error.reason,
            values={},
            over={},
            certificate={},
            wall_time=0.0,
            versions=proof_versions(),
        )
    return replace(proof, wall_time=clock.perf_counter() - started)


@dataclass(frozen=True, slots=True)
class _Search:
    """A proof that is searched."""

    given: ProofStart
    problem: Problem
    machine: BallMachine
    system: BallSystem
    over: Mapping[str, float]
    settings: ProofSettings
    on_progress: Progress

    @property
    def orbit(self) -> Orbit:
        """The orbit, which starts on the section."""
        return self.given.orbit

    def walked(self, start: SectionStart) -> ProofPassage:
        """Return the enclosure of one period from a set of the section."""
        return walk_period(
            self.given, self.machine, self.system, start, self.settings.walk, self.on_progress
        )


def _found(search: _Search) -> JudgedBox:
    """Return a box for which the proof succeeds. Larger boxes are tried first."""
    system, over, settings = search.system, search.over, search.settings
    y = prover_state(system, search.problem, search.orbit)
    places, others = section_places(system, y)
    sizes = [max(abs(y[k]), LEAST_SIZE) for k in places]
    tried = _RADII if settings.radius is None else (settings.radius,)
    middle = [arb(value) for value in y]
    boxes = [(middle, [share * size for size in sizes]) for share in tried]
    units = system.units[system.n - len(over) :]
    varied = [over[name] / unit for name, unit in zip(system.carried, units, strict=True)]
    failure, attempts = ProofError("exists", "no box was tried"), _ATTEMPTS
    while boxes:
        middle, radii = boxes.pop(0)
        try:
            start = start_on_section(system, middle, places, others, [*radii, *varied])
            judged = judge(start, search.walked(start))
        except ProofError as error:
            if error.claim in _FOR_EVERY_BOX:
                raise
            failure = error
            continue
        _require_closed(judged.defect, sizes)
        if judged.judged is not None:
            return judged.judged
        failure = ProofError("exists", judged.reason)
        if judged.next and attempts:
            boxes, attempts = [(_moved(start, step), r) for step, r in judged.next], attempts - 1
    raise failure


def _require_closed(defect: Sequence[Ball], sizes: Sequence[float]) -> None:
    """Raise an error for an orbit whose start does not return to itself."""
    off = max(
        (abs(float(one.mid())) / size for one, size in zip(defect, sizes, strict=True)),
        default=0.0,
    )
    if off > CLOSE:
        reason = "the motion from the orbit's start does not return to it"
        raise ProofError("closure", f"{reason}: the defect is {off:.1e} of its size")


def _moved(start: SectionStart, step: Sequence[Ball]) -> list[Ball]:
    """Return the middle of a start after a step in the coordinates of the section, ``(n,)``."""
    y = list(start.at.m)
    for k, change in zip(start.places, step, strict=True):
        y[k] = (y[k] + change).mid()
    return y


def _enlarged(search: _Search, found: JudgedBox) -> JudgedBox:
    """Return the largest box found that the return map maps into its interior.

    Boxes grow by a constant factor until a box fails. Then the factor is bisected. The sides of the
    next box are the geometric means of those of the box and of its image, since the map contracts
    a box best whose sides are in the ratio of those of its image.

    Raises:
        ProofError: If the return map does not map the first box into its interior.
    """
    if not found.returned.included:
        reason = "the return map does not map a box with sides along the coordinates into itself"
        raise ProofError("inclusion", reason)
    start, d = found.start, len(found.start.places)
    largest, most = found, math.inf
    for _ in range(_ENLARGEMENTS if d else 0):
        factor = min(_GROWTH, math.sqrt(most))
        if factor < _WORTH:
            break
        sides = np.array([float(one.rad()) for one in largest.start.at.U[:d]])
        image = np.array([float(one.abs_upper()) for one in largest.returned.image]) / sides
        shape = sides * np.sqrt(np.maximum(image / np.max(image), _THINNEST))
        radii = [*(factor * shape), *(float(one.rad()) for one in start.at.U[d:])]
        try:
            wide = start_on_section(search.system, start.at.m, start.places, start.others, radii)
            tried = judge(wide, search.walked(wide)).judged
        except ProofError:
            tried = None
        if tried is None or not tried.returned.included:
            most = factor
        else:
            largest, most = tried, most / factor
    return largest


def _with_basin(proof: Proof, search: _Search, found: JudgedBox) -> Proof:
    """Return a proof with the largest set of initial states that the checker accepts.

    Polynomials are computed in doubles, so only the checker proves a set.
    """
    problem, system, on_progress = search.problem, search.system, search.on_progress
    if search.machine.is_graph or system.struck:
        reason = "sets are searched for one stop without switches, from a release"
        return replace(proof, no_basin=reason)
    writer = CertificateWriter(system, found.start.places)
    # The other box and its claims do not concern the set.
    asked: dict[str, Any] = {
        **proof.certificate,
        "passes": proof.certificate["passes"][:1],
        "claims": [],
    }
    reason = ""
    try:
        for sets in islice(large_sets(search.orbit, system, found, on_progress), _MOST_SETS):
            on_progress("check the set of initial states", 0.0)
            written = [writer.polynomial_pass(one) for one in sets]
            verdict = check_proof(asked | {"basin": written}, problem)
            claims = {claim.name: claim for claim in verdict.claims}
            if claims["basin"].ok:
                attracted = "attraction" in claims and claims["attraction"].ok
                basin = written if attracted else written[:1]
                return replace(
                    proof,
                    certificate={**proof.certificate, "basin": basin},
                    basin_box=section_box(problem, system, sets[0].start),
                    attracted=attracted,
                )
            reason = f"the checker refuses the set: {claims['basin'].evidence}"
    except ProofError as error:
        reason = reason or error.reason
    return replace(proof, no_basin=reason)


def _refined(search: _Search, found: JudgedBox) -> list[JudgedBox]:
    """Return a much smaller box around the orbit inside a box that contains only this orbit.

    The list is empty if rounding makes the smaller box too imprecise.
    """
    places, start, system = found.start.places, found.start, search.system
    near = found.orbit
    for _ in range(_REFINEMENTS):
        near = found.returned.krawczyk(near)
    y = _moved(start, near)
    noise = [10 * float(one.rad()) for one in found.returned.shift]
    sizes = [max(abs(float(y[k].mid())), LEAST_SIZE) for k in places]
    radii = [max(_FINE * size, n) for size, n in zip(sizes, noise, strict=True)]
    try:
        fine = start_on_section(system, y, places, start.others, radii, start.around)
        judged = judge(fine, search.walked(fine)).judged
    except ProofError:
        return []
    outer = zip(start.centre, start.at.U, fine.centre, fine.at.U, strict=False)
    inside = all(bool((a + u).contains(b + v)) for a, u, b, v in outer)
    return [judged] if judged is not None and judged.by_krawczyk and inside else []


def _proof(search: _Search, values: ParameterValues, passes: list[JudgedBox]) -> Proof:
    """Return the theorem of a box, with digits from a smaller box."""
    problem, over, system = search.problem, search.over, search.system
    fine, numbers = passes[-1], [float(x) for x in values.vector]
    bits = check_bits(system, numbers)
    bounds = proof_bounds(problem, system, fine, bits)
    require_numbers(search.orbit, bounds, system.units)
    at_switch = search.given.kind is SectionKind.SWITCH
    require_switches(search.orbit, fine.passage, at_switch=at_switch)
    claims = claims_of(passes, bounds, system.units)
    ways = [(one.start, one.passage) for one in passes]
    written = certificate(problem, values, over, search.machine, system, ways, claims)
    if search.machine.is_graph:
        require_hypotheses(written, problem)
    return Proof(
        problem=problem.name,
        boxes=tuple(proved_box(problem, system, one) for one in passes),
        values=dict(zip(problem.names, numbers, strict=True)),
        over={n: (values.number(n), radius) for n, radius in over.items()},
        held=tuple(problem.derived_from(over, values.parameters)) if over else (),
        plastic=system.plastic,
        impacts=search.given.count if system.struck else 0,
        stop="" if at_switch or not search.machine.is_graph else search.given.event,
        switch=search.given.event if at_switch else "",
        beside=search.machine.beside(system),
        releases=search.given.count,
        events=fine.passage.told if search.machine.is_graph else (),
        stable=bool(fine.start.places) and (fine.discs.stable or passes[0].returned.included),
        repelling=fine.discs.repelling,
        bounds=bounds,
        certificate=written,
        n_records=sum(len(one.passage.records) for one in passes),
        wall_time=0.0,
        versions=proof_versions(),
    )
