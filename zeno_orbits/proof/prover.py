"""Prove that a periodic orbit exists: find a box around it, follow it, judge its return."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from flint import arb, ctx

from zeno_orbits.errors import InputError, ProofError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import ZenoOrbit
from zeno_orbits.orbits.digest import digest_of, same_equations
from zeno_orbits.proof.ball_system import BallSystem, require
from zeno_orbits.proof.balls import Ball, matrix, number_text, product
from zeno_orbits.proof.expressions import stop_identities
from zeno_orbits.proof.fixed_point import MultiplierDiscs, ReturnBox, multiplier_discs
from zeno_orbits.proof.program import BallProgram
from zeno_orbits.proof.proof_file import certificate, proof_versions
from zeno_orbits.proof.section import SectionStart, section_places, start_on_section
from zeno_orbits.proof.stage import BallTime, Departure, Stage
from zeno_orbits.proof.theorem import Bounds, Enclosure, MultiplierDisc, Proof
from zeno_orbits.proof.walk import Passage, WalkSettings, walk
from zeno_orbits.work import Progress, silent

_CLOSE = 1e-8
"""How far numbers of the orbit may be from those that are proved, per size."""
_RADII = (1e-9, 1e-12)
"""Radii of the box that are tried, per size of a coordinate."""
_REFINEMENTS = 8
_FINE = 4e-15
"""Radius of the box from which the digits are taken, per size of a coordinate."""
_BITS = 96
_DISCS_WIDER = 1.25
_TRIALS = 3
_ROUNDING = 1e-8
"""Rounding of an identity of the stop, made of numbers of some size."""
_TIMES_WIDER = 1.5
"""How much wider a claimed time is than found, so that another arithmetic finds it, too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofSettings:
    """How a proof is tried.

    Attributes:
        radius: Radius of the box per size of a coordinate, and then of one box alone; None to
            find one, and a far smaller one in it for the digits.
        bits: Length of the numbers.
        walk: How a period is followed.
    """

    radius: float | None = None
    bits: int = _BITS
    walk: WalkSettings = field(default_factory=WalkSettings)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Judged:
    """A box once around, with what follows.

    Attributes:
        start: The start.
        passage: Its way.
        returned: The return map.
        orbit: Start coordinates of the periodic orbit less those of the middle, and carried
            parameters, ``(d + n_over,)``.
        discs: Of the multipliers.
    """

    start: SectionStart
    passage: Passage
    returned: ReturnBox
    orbit: list[Ball]
    discs: MultiplierDiscs


def prove(
    orbit: ZenoOrbit,
    problem: Problem,
    *,
    over: Mapping[str, float] | None = None,
    settings: ProofSettings | None = None,
    on_progress: Progress = silent,
) -> Proof:
    """Prove that an orbit exists, is the only one near, and attracts or repels.

    Args:
        orbit: The orbit; only its numbers count.
        problem: Its problem.
        over: Gain or parameter to the radius of its interval, for all of which it is to hold.
        settings: How.
        on_progress: Called with what is being done and the part of it that is done.

    Returns:
        The theorem with its certificate, or which claim could not be proved.

    Raises:
        InputError: If the orbit or a name does not fit the problem.
        TranslationError: If the problem is not analytic.
    """
    started = clock.perf_counter()
    settings, over = settings or ProofSettings(), dict(over or {})
    values = orbit.values(problem)
    for name in over:
        problem.place(name, argument="over")
    try:
        with ctx.workprec(settings.bits):
            _require_fit(orbit, problem, values)
            system = BallSystem(problem, values, over)
            found = _found(orbit, problem, system, over, settings, on_progress)
            passes = [found]
            if found.start.places and not over and settings.radius is None:
                passes.append(_refined(orbit, system, found, settings, on_progress))
            proof = _proof(orbit, problem, values, over, system, passes)
    except ProofError as error:
        proof = Proof(
            problem=problem.name,
            claim=error.claim,
            reason=error.reason,
            box={},
            over={},
            certificate={},
            wall_time=0.0,
            versions=proof_versions(),
        )
    return replace(proof, wall_time=clock.perf_counter() - started)


def _require_fit(orbit: ZenoOrbit, problem: Problem, values: ParameterValues) -> None:
    """Refuse orbits that are none of the problem's, or of a kind that is not proved."""
    digest = orbit.problem_digest
    if digest and not same_equations(digest, digest_of(problem)):
        raise ProofError("problem", "the orbit was computed from other equations")
    _require_stop(orbit, problem, values)
    if not orbit.shape.starts_at_release:
        reason = f"the period starts at no release (shape `{orbit.shape.text}`)"
        raise ProofError("shape", reason)
    if not 0.0 <= values.parameters.get("restitution", 0.0) < 1.0:
        raise InputError("Argument `restitution` must lie in [0, 1), but it does not.")


def _require_stop(orbit: ZenoOrbit, problem: Problem, values: ParameterValues) -> None:
    """Refuse equations that break an identity of the stop, at a few states around the orbit's."""
    function, names = stop_identities(problem)
    program = BallProgram(function, [arb(float(value)) for value in values.vector])
    state = problem.state_vector(orbit.start_state)
    for k in range(_TRIALS):
        # Irrational multiples spread the states evenly; any state will do.
        moves = [math.sin(3.0 * (k + 1) * (j + 1)) for j in range(len(state))]
        near = [arb(x + (1 + abs(x)) * move / 4) for x, move in zip(state, moves, strict=True)]
        for name, value in zip(names, program(near)[0], strict=True):
            # Constants that CasADi has folded leave rounding.
            require(bool(abs(value) < _ROUNDING), "model", f"it is not so that {name} ({value})")


def _found(
    orbit: ZenoOrbit,
    problem: Problem,
    system: BallSystem,
    over: Mapping[str, float],
    settings: ProofSettings,
    on_progress: Progress,
) -> _Judged:
    """Return a box for which the proof succeeds, the largest that is tried first."""
    y = _prover_state(system, problem, orbit)
    places, others = section_places(system, y)
    sizes = [max(abs(y[k]), 1e-3) for k in places]
    tried = _RADII if settings.radius is None else (settings.radius,)
    radii = [[share * size for size in sizes] for share in tried]
    failure = ProofError("exists", "no box was tried")
    centre = [arb(value) for value in y]
    while radii:
        box = radii.pop(0)
        widths = [*box, *(over[name] for name in system.carried)]
        try:
            start = start_on_section(system, centre, places, others, widths)
            passage = _walked(orbit, system, start, settings, on_progress)
            judged = _judged(start, passage)
        except ProofError as error:
            failure = error
            continue
        defect = max(
            (abs(float(one.mid())) / size for one, size in zip(judged.defect, sizes, strict=True)),
            default=0.0,
        )
        if defect > _CLOSE:
            reason = "the motion from the orbit's start does not come back to it"
            raise ProofError("closure", f"{reason}: off by {defect:.1e} of its size")
        if judged.judged is not None:
            return judged.judged
        failure = ProofError("exists", judged.reason)
        if judged.needed:
            radii = [judged.needed]
    raise failure


def _refined(
    orbit: ZenoOrbit,
    system: BallSystem,
    found: _Judged,
    settings: ProofSettings,
    on_progress: Progress,
) -> _Judged:
    """Return a far smaller box around the orbit inside a box in which it is the only one."""
    places, start = found.start.places, found.start
    y = list(start.at.m)
    near = found.orbit
    for _ in range(_REFINEMENTS):
        near = found.returned.krawczyk(near)
    for k, change in zip(places, near, strict=True):
        y[k] = (y[k] + change).mid()
    radii = [_FINE * max(abs(float(y[k].mid())), 1e-3) for k in places]
    fine = start_on_section(system, y, places, start.others, radii)
    for k, inner, outer in zip(start.others, fine.around, start.around, strict=True):
        require(bool(outer.contains(inner)), "exists", f"state {k} leaves the first box")
    attempt = _judged(fine, _walked(orbit, system, fine, settings, on_progress))
    if attempt.judged is None:
        raise ProofError("exists", attempt.reason)
    return attempt.judged


@dataclass(frozen=True, slots=True, kw_only=True)
class _Attempt:
    """A box once around, judged.

    Attributes:
        judged: What follows, if the orbit exists.
        defect: Where the middle returns, less the middle, ``(d,)``.
        reason: What is missing.
        needed: Radii of a box that may do.
    """

    judged: _Judged | None
    defect: list[Ball]
    reason: str = ""
    needed: list[float]


def _judged(start: SectionStart, passage: Passage) -> _Attempt:
    """Judge the return of a box."""
    places, end, d = start.places, passage.end.at, len(start.places)
    box = end.box
    slopes = end.derivative
    rows = [[slopes[k, j] for j in range(d)] for k in places]
    carried = matrix(
        [[slopes[k, j] for j in range(d, slopes.ncols())] for k in places], slopes.ncols() - d
    )
    middle = end.middle_box
    defect = [middle[k] - centre for k, centre in zip(places, start.centre, strict=True)]
    parameters = start.at.U[d:]
    spread = product(carried, parameters) if parameters else [arb(0)] * d
    returned = ReturnBox(
        box=start.at.U[:d],
        shift=[a + b for a, b in zip(defect, spread, strict=True)],
        slopes=matrix(rows, d),
    )
    if not all(a.contains(box[k]) for k, a in zip(start.others, start.around, strict=True)):
        reason = "the box does not come back to the part of the section that it started on"
        return _Attempt(judged=None, defect=defect, reason=reason, needed=[])
    found = returned.krawczyk(returned.box)
    if not returned.encloses(found):
        wide = [float(one.abs_upper()) for one in found]
        reason = "the return map is not proved to have a fixed point in the box"
        small = all(w < 1e-3 for w in wide)
        needed = [3 * w for w in wide] if small else []
        return _Attempt(judged=None, defect=defect, reason=reason, needed=needed)
    orbit = [*returned.krawczyk(found), *parameters]
    judged = _Judged(
        start=start,
        passage=passage,
        returned=returned,
        orbit=orbit,
        discs=multiplier_discs(returned.slopes),
    )
    return _Attempt(judged=judged, defect=defect, needed=[])


def _walked(
    orbit: ZenoOrbit,
    system: BallSystem,
    start: SectionStart,
    settings: ProofSettings,
    on_progress: Progress,
) -> Passage:
    stage = Stage(at=start.at, departure=Departure.RELEASED, time=BallTime.start(len(start.at.U)))
    radius = max((float(u.rad()) for u in start.at.U), default=0.0)
    what = f"follow a box of radius {radius:.0e}" if radius else "follow the orbit"

    def tell(doing: str, time: float) -> None:
        on_progress(f"{what}, {doing}", min(time / orbit.period, 1.0))

    def overdue(time: float) -> None:
        if time > 1.5 * orbit.period + 1e-9:
            raise ProofError("period", f"no return within {time:.6g} s")

    def report(doing: str, time: float) -> None:
        overdue(time)
        tell(doing, time)

    return walk(system, stage, orbit.shape.n_releases, settings.walk, report)


def _prover_state(system: BallSystem, problem: Problem, orbit: ZenoOrbit) -> list[float]:
    """Return the orbit's start in the prover's states, ``(n,)``."""
    x = [float(value) for value in problem.state_vector(orbit.start_state)]
    if system.expressions.coordinate is None:
        x += [0.0, 0.0]
    x += [float(value.mid()) for value in system.carried.values()]
    x[system.gap] = x[system.rate] = 0.0
    return x


def _proof(
    orbit: ZenoOrbit,
    problem: Problem,
    values: ParameterValues,
    over: Mapping[str, float],
    system: BallSystem,
    passes: list[_Judged],
) -> Proof:
    """Return the theorem of a box, and of a finer one from which its digits are."""
    found, fine = passes[0], passes[-1]
    bounds = _bounds(problem, system, fine)
    _require_numbers(orbit, bounds)
    names = problem.state_names
    centres = [float(c) for c in found.start.centre]
    claims = _claims(passes, bounds)
    ways = [(one.start, one.passage) for one in passes]
    return Proof(
        problem=problem.name,
        box={
            names[k]: (c, float(u.rad()))
            for k, c, u in zip(found.start.places, centres, found.start.at.U, strict=False)
        },
        over={n: (float(system.carried[n]), r) for n, r in over.items()},
        plastic=bool(system.restitution.is_zero()),
        inside=found.returned.included,
        stable=bool(found.start.places) and fine.discs.stable,
        repelling=fine.discs.repelling,
        bounds=bounds,
        certificate=certificate(problem, values, over, system, ways, claims),
        n_records=sum(len(one.passage.records) for one in passes),
        wall_time=0.0,
        versions=proof_versions(),
    )


def _bounds(problem: Problem, system: BallSystem, found: _Judged) -> Bounds:
    offset, passage = found.orbit, found.passage
    start = found.start.at
    moved = product(start.derivative, offset) if offset else [arb(0)] * system.n
    state = [a + b for a, b in zip(start.middle_box, moved, strict=True)]
    coordinate = system.expressions.coordinate
    if coordinate is not None:
        state[system.gap] = (state[system.gap] - system.gap_offset) * coordinate.sign
    return Bounds(
        period=_claimed(passage.release_times[-1].at(offset)),
        zeno_times=tuple(_claimed(one.at(offset)) for one in passage.zeno_times),
        impact_times=tuple(_claimed(one.at(offset)) for one in passage.impact_times),
        start_state={
            name: _claimed(value) for name, value in zip(problem.state_names, state, strict=False)
        },
        multipliers=tuple(
            MultiplierDisc(centre=c, radius=float(r) * _DISCS_WIDER + 1e-15)
            for c, r in zip(found.discs.centres, found.discs.radii, strict=True)
        ),
        norm=float(found.discs.norm.upper()),
    )


def _claimed(x: Ball) -> Enclosure:
    """Return the ends of an enclosure that is somewhat wider than a ball."""
    if x.is_zero():
        return Enclosure(low=x, high=x)
    wide = x + arb(0, x.rad() * (_TIMES_WIDER - 1) + abs(x).upper() * arb(2) ** -85)
    return Enclosure(low=wide.lower().mid(), high=wide.upper().mid())


def _require_numbers(orbit: ZenoOrbit, bounds: Bounds) -> None:
    """Refuse an orbit whose other numbers are not those of the orbit that is proved."""
    allowed = _CLOSE * orbit.period

    def check(name: str, enclosed: Enclosure, value: float, most: float) -> None:
        off = enclosed.misses(value)
        reason = f"the orbit says {value:.12g}, but {enclosed.text} is proved"
        require(off <= most, name, reason)

    check("period", bounds.period, orbit.period, allowed)
    held = [phase for phase in orbit.phases if phase.zeno_time is not None]
    require(len(held) == len(bounds.zeno_times), "shape", "the orbit has other Zeno points")
    for phase, proved in zip(held, bounds.zeno_times, strict=True):
        check("zeno_time", proved, float(phase.zeno_time or 0.0), allowed)
    impacts = [impact.time for impact in orbit.impacts]
    for time in impacts:
        nearest = min(bounds.impact_times, key=lambda one: one.misses(time))
        check("impact_time", nearest, time, allowed)
    for name, value in orbit.start_state.items():
        check("start_state", bounds.start_state[name], value, _CLOSE * max(1.0, abs(value)))


def _claims(passes: list[_Judged], bounds: Bounds) -> list[dict[str, Any]]:
    """Return the claims of the certificate."""
    last = len(passes) - 1
    claims: list[dict[str, Any]] = []

    def claim(name: str, number: int = last, **fields: Any) -> None:
        claims.append({"name": name, "pass": number, **fields})

    for number, one in enumerate(passes):
        if one.start.places:
            claim("exists", number, by="krawczyk")
        if one.returned.included:
            claim("exists", number, by="inclusion")
    if passes[0].start.places:
        claim("unique", 0)
        discs = passes[-1].discs
        basis = {
            "re": [_exact(*(x.real for x in row)) for row in discs.basis],
            "im": [_exact(*(x.imag for x in row)) for row in discs.basis],
        }
        if discs.stable:
            claim("stable", basis=basis)
        elif discs.repelling:
            claim("repelling", basis=basis)
        found = [_exact(one.centre.real, one.centre.imag, one.radius) for one in bounds.multipliers]
        claim("multipliers", basis=basis, discs=found)
    claim("period", last, **_ends(bounds.period))
    for which, one in enumerate(bounds.zeno_times):
        claim("zeno_time", last, which=which, **_ends(one))
    for which, one in enumerate(bounds.impact_times):
        claim("impact_time", last, which=which, **_ends(one))
    state = list(bounds.start_state.values())
    low, high = [number_text(x.low) for x in state], [number_text(x.high) for x in state]
    claim("start_state", low=low, high=high)
    return claims


def _ends(one: Enclosure) -> dict[str, str]:
    return {"low": number_text(one.low), "high": number_text(one.high)}


def _exact(*numbers: float) -> list[str]:
    return [number_text(arb(x)) for x in numbers]
