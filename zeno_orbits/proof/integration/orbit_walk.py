"""An orbit of a file for the prover: consistency with its problem, its start, and one period."""

from __future__ import annotations

import math
from collections.abc import Sequence

from flint import arb

from zeno_orbits.errors import ProofError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import Orbit, other_equations
from zeno_orbits.proof.arithmetic.balls import Ball
from zeno_orbits.proof.arithmetic.expressions import stop_identities
from zeno_orbits.proof.arithmetic.program import BallProgram
from zeno_orbits.proof.integration.ball_system import BallSystem, require_proved
from zeno_orbits.proof.integration.section import SectionStart
from zeno_orbits.proof.integration.sets import Departure, ProofStage
from zeno_orbits.proof.integration.walk import ProofPassage, WalkSettings, walk
from zeno_orbits.work import Progress

LEAST_SIZE = 1e-3
"""Smallest size of a coordinate near zero, in its unit."""
_PATIENCE = 1.5
"""Longest time to return, in periods."""
_TRIALS = 3
_NEAREST = 30
"""Largest number of halvings of the distance of a trial state."""
_PLASTIC = "each plastic impact of the orbit is followed by a flight"
_ROUNDING = 1e-8
"""Rounding error of an identity of the stop, relative to the size of its terms."""


def require_fit(orbit: Orbit, problem: Problem, values: ParameterValues) -> None:
    """Raise an error for orbits that do not fit the problem, or of a kind that cannot be proved.

    Args:
        orbit: The orbit.
        problem: The problem.
        values: Gains and parameters of the orbit.

    Raises:
        ProofError: If the orbit does not fit, or is of another kind.
        InputError: If the restitution is 1.
    """
    if other_equations(orbit.problem_digest, problem):
        raise ProofError("problem", "the orbit was computed from other equations")
    problem.require_zeno_points(values)
    _require_stop(orbit, problem, values)


def _require_stop(orbit: Orbit, problem: Problem, values: ParameterValues) -> None:
    """Check the identities of the stop at a few states near the orbit's start."""
    own = problem.dynamics(values).own
    function, sizes = stop_identities(problem, own)
    program = BallProgram(function, [arb(float(value)) for value in values.vector])
    state = problem.state_vector(orbit.start_state)
    usual = own.states(len(state))
    for k in range(_TRIALS):
        # Irrational multiples spread the states evenly. Any state would be suitable.
        moves = [
            (size + abs(x)) * math.sin(3.0 * (k + 1) * (j + 1))
            for j, (x, size) in enumerate(zip(state, usual, strict=True))
        ]
        for (name, size), terms in zip(sizes.items(), _near(program, state, moves), strict=True):
            # Constants that CasADi has folded cause rounding errors.
            off, allowed = sum(terms), _ROUNDING * sum((abs(x) for x in terms), arb(size))
            require_proved(
                bool(abs(off) < allowed), "model", f"violated identity: {name} (error {off})"
            )


def _near(program: BallProgram, state: Sequence[float], moves: Sequence[float]) -> list[list[Ball]]:
    """Evaluate formulas at a state near another state, and closer to it if they are undefined."""
    found: list[list[Ball]] = []
    for halvings in range(2, _NEAREST):
        near = [arb(x + move / 2**halvings) for x, move in zip(state, moves, strict=True)]
        found = program(near)
        if all(value.is_finite() for terms in found for value in terms):
            break
    return found


def prover_state(system: BallSystem, problem: Problem, orbit: Orbit) -> list[float]:
    """Return the orbit's start in the prover's states, ``(n,)``.

    Args:
        system: The problem in the prover's units.
        problem: The problem.
        orbit: The orbit.
    """
    own = problem.state_vector(orbit.start_state)
    x = [float(value) / unit for value, unit in zip(own, system.units, strict=False)]
    if system.expressions.coordinate is None:
        x += [0.0, 0.0]
    x += [float(value.mid()) for value in system.carried.values()]
    if system.expressions.coordinate is not None:
        x[system.rate] *= system.expressions.coordinate.sign
    for k in system.stopped:
        x[k] = 0.0
    return x


def walk_period(
    orbit: Orbit,
    system: BallSystem,
    start: SectionStart,
    settings: WalkSettings,
    on_progress: Progress,
) -> ProofPassage:
    """Enclose one period from the set of a start, with an upper bound for the time to return.

    Args:
        orbit: The orbit, whose mode sequence and period are used.
        system: The orbit's problem in balls.
        start: The set.
        settings: Settings of the enclosure.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        ProofError: If a condition is not proved.
    """
    reason = system.light(start.at.box)
    require_proved(not reason, "inertia", reason)
    require_proved(not (system.struck and system.plastic), "shape", _PLASTIC)
    departure = Departure.STRUCK if system.struck else Departure.RELEASED
    stage = ProofStage.started(start.at, departure)
    radius = max((float(u.rad()) for u in start.at.U), default=0.0)
    what = f"follow a box of radius {radius:.0e}" if radius else "follow the orbit"

    def tell(doing: str, time: float) -> None:
        late = time > _PATIENCE * orbit.period
        require_proved(not late, "period", f"the motion does not return within {time:.6g} s")
        on_progress(f"{what}, {doing}", min(time / orbit.period, 1.0))

    count = orbit.shape.n_phases if system.struck else orbit.shape.n_releases
    return walk(system, stage, count, settings, tell)
