"""Prove that a periodic orbit exists: find a box around it, follow it, judge its return."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from flint import arb, ctx

from zeno_orbits.errors import InputError, ProofError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import ZenoOrbit, digest_of, same_equations
from zeno_orbits.proof.ball_system import BallSystem, require_proved
from zeno_orbits.proof.claims import CLOSE, claims_of, proof_bounds, require_numbers
from zeno_orbits.proof.expressions import stop_identities
from zeno_orbits.proof.fixed_point import JudgedBox, judge
from zeno_orbits.proof.program import BallProgram
from zeno_orbits.proof.proof_file import certificate, proof_versions
from zeno_orbits.proof.section import SectionStart, section_places, start_on_section
from zeno_orbits.proof.stage import BallTime, Departure, ProofStage
from zeno_orbits.proof.theorem import Proof
from zeno_orbits.proof.walk import ProofPassage, WalkSettings, walk
from zeno_orbits.work import Progress, silent

_RADII = (1e-9, 1e-12)
"""Radii of the box that are tried, per size of a coordinate."""
_ATTEMPTS = 3
"""How often other boxes are tried that a failure suggests."""
_REFINEMENTS = 8
_FINE = 4e-15
"""Radius of the box from which the digits are taken, per size of a coordinate."""
_BITS = 96
_PATIENCE = 1.5
"""Periods that the motion may take to return."""
_TRIALS = 3
_ROUNDING = 1e-8
"""Rounding of an identity of the stop, made of numbers of some size."""


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
            system = BallSystem(problem, values, over, orbit.period)
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
    own = problem.dynamics(values).own
    function, sizes = stop_identities(problem, own)
    program = BallProgram(function, [arb(float(value)) for value in values.vector])
    state = problem.state_vector(orbit.start_state)
    usual = own.states(len(state))
    for k in range(_TRIALS):
        # Irrational multiples spread the states evenly; any state will do.
        moves = [math.sin(3.0 * (k + 1) * (j + 1)) for j in range(len(state))]
        near = [
            arb(x + (size + abs(x)) * move / 4)
            for x, size, move in zip(state, usual, moves, strict=True)
        ]
        for (name, size), terms in zip(sizes.items(), program(near), strict=True):
            # Constants that CasADi has folded leave rounding.
            off, allowed = sum(terms), _ROUNDING * sum((abs(x) for x in terms), arb(size))
            require_proved(bool(abs(off) < allowed), "model", f"it is not so that {name} ({off})")


def _found(
    orbit: ZenoOrbit,
    problem: Problem,
    system: BallSystem,
    over: Mapping[str, float],
    settings: ProofSettings,
    on_progress: Progress,
) -> JudgedBox:
    """Return a box for which the proof succeeds, the largest that is tried first."""
    y = _prover_state(system, problem, orbit)
    places, others = section_places(system, y)
    sizes = [max(abs(y[k]), 1e-3) for k in places]
    tried = _RADII if settings.radius is None else (settings.radius,)
    radii = [[share * size for size in sizes] for share in tried]
    failure, attempts = ProofError("exists", "no box was tried"), _ATTEMPTS
    centre = [arb(value) for value in y]
    while radii:
        box = radii.pop(0)
        units = system.units[system.n - len(over) :]
        widths = [*box, *(over[name] / u for name, u in zip(system.carried, units, strict=True))]
        try:
            start = start_on_section(system, centre, places, others, widths)
            passage = _walked(orbit, system, start, settings, on_progress)
            judged = judge(start, passage)
        except ProofError as error:
            failure = error
            continue
        defect = max(
            (abs(float(one.mid())) / size for one, size in zip(judged.defect, sizes, strict=True)),
            default=0.0,
        )
        if defect > CLOSE:
            reason = "the motion from the orbit's start does not come back to it"
            raise ProofError("closure", f"{reason}: off by {defect:.1e} of its size")
        if judged.judged is not None:
            return judged.judged
        failure = ProofError("exists", judged.reason)
        if judged.needed and attempts:
            radii, attempts = judged.needed, attempts - 1
    raise failure


def _refined(
    orbit: ZenoOrbit,
    system: BallSystem,
    found: JudgedBox,
    settings: ProofSettings,
    on_progress: Progress,
) -> JudgedBox:
    """Return a far smaller box around the orbit inside a box in which it is the only one."""
    places, start = found.start.places, found.start
    y = list(start.at.m)
    near = found.orbit
    for _ in range(_REFINEMENTS):
        near = found.returned.krawczyk(near)
    for k, change in zip(places, near, strict=True):
        y[k] = (y[k] + change).mid()
    noise = [10 * float(one.rad()) for one in found.returned.shift]
    radii = [max(_FINE * abs(float(y[k].mid())), n) for k, n in zip(places, noise, strict=True)]
    fine = start_on_section(system, y, places, start.others, radii)
    for k, inner, outer in zip(start.others, fine.around, start.around, strict=True):
        require_proved(bool(outer.contains(inner)), "exists", f"state {k} leaves the first box")
    attempt = judge(fine, _walked(orbit, system, fine, settings, on_progress))
    if attempt.judged is None:
        raise ProofError("exists", attempt.reason)
    return attempt.judged


def _walked(
    orbit: ZenoOrbit,
    system: BallSystem,
    start: SectionStart,
    settings: ProofSettings,
    on_progress: Progress,
) -> ProofPassage:
    stage = ProofStage(
        at=start.at, departure=Departure.RELEASED, time=BallTime.start(len(start.at.U))
    )
    radius = max((float(u.rad()) for u in start.at.U), default=0.0)
    what = f"follow a box of radius {radius:.0e}" if radius else "follow the orbit"

    def tell(doing: str, time: float) -> None:
        late = time > _PATIENCE * orbit.period
        require_proved(not late, "period", f"the motion does not return within {time:.6g} s")
        on_progress(f"{what}, {doing}", min(time / orbit.period, 1.0))

    return walk(system, stage, orbit.shape.n_releases, settings.walk, tell)


def _prover_state(system: BallSystem, problem: Problem, orbit: ZenoOrbit) -> list[float]:
    """Return the orbit's start in the prover's states, ``(n,)``."""
    own = problem.state_vector(orbit.start_state)
    x = [float(value) / unit for value, unit in zip(own, system.units, strict=False)]
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
    passes: list[JudgedBox],
) -> Proof:
    """Return the theorem of a box, and of a finer one from which its digits are."""
    found, fine = passes[0], passes[-1]
    bounds = proof_bounds(problem, system, fine)
    require_numbers(orbit, bounds, system.units)
    names, units = problem.state_names, system.units
    box = zip(found.start.places, found.start.centre, found.start.at.U, strict=False)
    claims = claims_of(passes, bounds)
    ways = [(one.start, one.passage) for one in passes]
    return Proof(
        problem=problem.name,
        box={
            names[k]: (float(centre) * units[k], float(u.rad()) * units[k]) for k, centre, u in box
        },
        over={n: (values.number(n), radius) for n, radius in over.items()},
        plastic=system.plastic,
        inside=found.returned.included,
        stable=bool(found.start.places) and fine.discs.stable,
        repelling=fine.discs.repelling,
        bounds=bounds,
        certificate=certificate(problem, values, over, system, ways, claims),
        n_records=sum(len(one.passage.records) for one in passes),
        wall_time=0.0,
        versions=proof_versions(),
    )
