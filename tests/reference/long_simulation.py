"""What a motion settles to, by simulating it for long: slow, plain, and apart from fast maps.

Nothing is solved for: the motion is followed until it repeats, dies out or diverges. Maps are
held against it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tests.reference.long_simulation_passages import (
    Passage,
    Piece,
    passages_of,
    repeats,
    rests,
    scale_of,
    trend_of,
)
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, RunawayError, SimulationError
from zeno_orbits.integrators import Tolerance
from zeno_orbits.maps import Attractor, AttractorClass
from zeno_orbits.model import HybridDynamics, ParameterValues, Problem
from zeno_orbits.orbits import RELEASE_ROWS, section_around
from zeno_orbits.simulation import Execution, Impact, Mode, Release, SimulationSettings, simulate

_PIECES = 6
"""Pieces of a run; after each it is asked whether it has settled."""
_DIFFERENCE = 1e-4
"""Displacement for multipliers, relative; its square and the error of a return balance."""
_FAR = 1e4
"""A coordinate of a problem that declares no escapes has run away beyond this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LongRun:
    """How long and how accurately to simulate.

    Attributes:
        until: How long at most [s].
        close: A motion repeats if it is this close to an orbit, relative to its size; it rests if
            it has this part of its size left.
        most_returns: Longest period that is looked for, in returns.
        simulation: How to simulate.
    """

    until: float = 60.0
    close: float = 1e-6
    most_returns: int = 8
    simulation: SimulationSettings = field(
        default_factory=lambda: SimulationSettings(
            tolerance=Tolerance(relative=1e-10, absolute=1e-12)
        )
    )

    def __post_init__(self) -> None:
        if not (math.isfinite(self.until) and self.until > 0.0):
            wanted = "must be a positive number of seconds"
            raise InputError(f"Argument `until` {wanted}, but it is {self.until:g}.")


def attractor_of(
    problem: Problem,
    values: ParameterValues,
    state: Sequence[float] | None = None,
    *,
    run: LongRun | None = None,
) -> Attractor:
    """Return what a motion settles to.

    Args:
        problem: The problem.
        values: Its numbers.
        state: Where the motion starts, ``(n_x,)``; the problem's first start by default.
        run: How long and how accurately to simulate.
    """
    run = run or LongRun()
    dynamics = problem.dynamics(values)
    x = np.array(problem.state_vector(problem.starts[0]) if state is None else state)
    pieces: list[Piece] = []
    length, settings = run.until / _PIECES, _bounded(problem, run.simulation)
    for k in range(_PIECES):
        try:
            execution = simulate(dynamics, x, until=length, settings=settings)
        except RunawayError as error:
            return _escape(problem, np.array(error.state[: len(x)]))
        except SimulationError as error:
            return Attractor(fate=AttractorClass.FAILED, detail=str(error))
        pieces.append(Piece(start=k * length, execution=execution))
        far = [s for s in execution.sampled(20)[1] if problem.escaped(s)]
        if far:
            return _escape(problem, far[0])
        settled = _settled(problem, dynamics, pieces, run)
        if settled is not None:
            return settled
        x = execution.end_state
    return Attractor(fate=AttractorClass.UNSETTLED, trend=trend_of(pieces, dynamics.n_q))


def _bounded(problem: Problem, settings: SimulationSettings) -> SimulationSettings:
    """Return settings that end a run as soon as no coordinate can come back."""
    n_q = len(problem.state_names) // 2
    bounds = [escape.beyond for escape in problem.escapes.values()]
    declared = all(name in problem.escapes for name in problem.state_names[:n_q])
    return replace(settings, far=max(bounds) if declared and bounds else _FAR)


def _escape(problem: Problem, state: Vector) -> Attractor:
    name = problem.escaped(state.tolist())
    if not name:
        name = problem.state_names[int(np.argmax(np.abs(state[: len(state) // 2])))]
        return Attractor(fate=AttractorClass.ESCAPE, escaped=name, detail=f"{name} diverges")
    return Attractor(fate=AttractorClass.ESCAPE, escaped=name, detail=problem.escapes[name].phrase)


def _settled(
    problem: Problem, dynamics: HybridDynamics, pieces: Sequence[Piece], run: LongRun
) -> Attractor | None:
    """Return what the motion has settled to, if it has."""
    if rests(pieces, run.close):
        return Attractor(
            fate=AttractorClass.REST,
            state=dict(
                zip(problem.state_names, pieces[-1].execution.end_state.tolist(), strict=True)
            ),
        )
    passages = passages_of(pieces, dynamics.n_q)
    for n in range(1, run.most_returns + 1):
        if repeats(passages, n, run.close, now=pieces[-1].end):
            return _orbit(problem, dynamics, pieces, passages, n, run)
    return None


def _orbit(
    problem: Problem,
    dynamics: HybridDynamics,
    pieces: Sequence[Piece],
    passages: Sequence[Passage],
    n: int,
    run: LongRun,
) -> Attractor:
    """Return the periodic orbit that the last `n` passages belong to."""
    first, last = passages[-n - 1], passages[-1]
    period = last.time - first.time
    state = dict(zip(problem.state_names, last.state.tolist(), strict=True))
    if not _releases(pieces, first.time):
        return Attractor(fate=AttractorClass.NO_ZENO, period=period, state=state)
    round_trip = _Return(dynamics=dynamics, n=n, horizon=2.0 * period, settings=run.simulation)
    try:
        cycle = round_trip.execution(last.state)
        multipliers = _multipliers(round_trip, last.state, scale_of(passages[-n - 1 :]))
    except SimulationError as error:
        return Attractor(fate=AttractorClass.FAILED, period=period, state=state, detail=str(error))
    zenos = cycle.zeno_points
    fate = (
        AttractorClass.ZENO
        if any(zeno.last_speed > 0.0 for zeno in zenos)
        else AttractorClass.SIMPLE
    )
    return Attractor(
        fate=fate if zenos else AttractorClass.NO_ZENO,
        returns=n,
        period=period,
        multipliers=multipliers,
        margins=_margins(dynamics, cycle),
        state=state,
    )


def _releases(pieces: Sequence[Piece], after: float) -> bool:
    return any(passage.time >= after for s in pieces for passage in s.passages(Release))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Return:
    """From one release to the `n`-th after it."""

    dynamics: HybridDynamics
    n: int
    horizon: float
    settings: SimulationSettings

    def execution(self, x: Vector) -> Execution:
        """Return the motion from a release to the `n`-th after it.

        Raises:
            SimulationError: If there are not so many within the horizon.
        """
        start = self.dynamics.on_stop(x)
        for releases in (self.n, self.n + 1):
            # A start that is locked by rounding is released at once; that is no return.
            execution = simulate(
                self.dynamics,
                start,
                until=self.horizon,
                releases=releases,
                settings=self.settings,
            )
            if len(execution.returns(self.horizon)) == self.n:
                return execution
        raise SimulationError(
            "The motion does not return", time=self.horizon, state=tuple(x.tolist())
        )


def _multipliers(round_trip: _Return, x: Vector, scale: Vector) -> tuple[complex, ...]:
    """Return the Floquet multipliers by central differences of the return."""
    section = section_around(round_trip.dynamics, RELEASE_ROWS, x, scale)

    def image(coordinates: Vector) -> Vector:
        start = section.state(round_trip.dynamics, coordinates)
        return section.coordinates(round_trip.execution(start).end_state)

    shifts = _DIFFERENCE * np.eye(section.dimension)
    columns = [(image(shift) - image(-shift)) / (2 * _DIFFERENCE) for shift in shifts]
    if not columns:
        return ()
    values = np.linalg.eigvals(np.stack(columns, axis=1))
    return tuple(complex(value) for value in sorted(values, key=abs, reverse=True))


def _margins(dynamics: HybridDynamics, cycle: Execution) -> dict[str, float]:
    """Return the margins of a certificate, each the smallest over the period."""
    locked = [arc for arc in cycle.arcs if arc.mode is Mode.LOCKED and arc.start_time > 0.0]
    # The first impact of a sequence comes after something that is none.
    before = (None, *cycle.events)
    pairs = zip(before, cycle.events, strict=False)
    firsts = [
        now for last, now in pairs if isinstance(now, Impact) and not isinstance(last, Impact)
    ]
    named: dict[str, list[float]] = {
        "gap_acceleration": [-dynamics.gap_acceleration(z.state) for z in cycle.zeno_points],
        "first_impact_speed": [-impact.approach_rate for impact in firsts],
        "release_transversality": [-dynamics.multiplier_rate(r.state) for r in cycle.releases],
        "locked_time": [arc.end_time - arc.start_time for arc in locked],
    }
    return {name: min(values) for name, values in named.items() if values}
