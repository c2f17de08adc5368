"""First guesses by simulation: follow a scene until its motion repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from zeno_orbits.completion import ZenoExtrapolation
from zeno_orbits.cycle import Cycle, cycles
from zeno_orbits.dynamics import HybridDynamics, Tolerance, Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.simulate import SimulationSettings, simulate

_TURNS = 20 * np.pi
"""A coordinate beyond this many radians, or metres, will not come back."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SettlingSettings:
    """How long to wait for a motion to repeat.

    Attributes:
        horizon: Longest simulated time from one start [s].
        chunk: Simulated time between two looks [s].
        settled: Change of the release state over a period that counts as repeating, relative.
        usable: Change up to which the last period still serves as a guess.
        simulation: Accuracy; looser than a verification.
    """

    horizon: float = 200.0
    chunk: float = 10.0
    settled: float = 1e-6
    usable: float = 0.1
    simulation: SimulationSettings = field(
        default_factory=lambda: SimulationSettings(
            tolerance=Tolerance(relative=1e-8, absolute=1e-10),
            completion=ZenoExtrapolation(tolerance=1e-11),
        )
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Settling:
    """Where a simulation went.

    Attributes:
        cycle: Its last period, if it is fit for a guess.
        reason: Why there is none, as a clause; empty if there is one.
    """

    cycle: Cycle | None
    reason: str = ""


def settle(
    dynamics: HybridDynamics,
    starts: Sequence[Vector | tuple[float, ...]],
    settings: SettlingSettings | None = None,
) -> Settling:
    """Return the last period of the first start whose motion repeats.

    Args:
        dynamics: The system.
        starts: Initial states, tried in order.
        settings: How long to wait.
    """
    settings = settings or SettlingSettings()
    reasons: list[str] = []
    for start in starts:
        settling = _settle_from(dynamics, np.array(start, dtype=np.float64), settings)
        if settling.cycle is not None:
            return settling
        reasons.append(settling.reason)
    return Settling(cycle=None, reason=" / ".join(dict.fromkeys(reasons)))


def _settle_from(dynamics: HybridDynamics, state: Vector, settings: SettlingSettings) -> Settling:
    elapsed, best = 0.0, None
    while elapsed < settings.horizon:
        try:
            run = simulate(dynamics, state, until=settings.chunk, settings=settings.simulation)
        except SimulationError as error:
            return Settling(cycle=None, reason=f"the simulation stops: {error.reason.lower()}")
        elapsed += run.end_time
        found = cycles(run)
        if found:
            best = found[-1]
            if best.drift(best.scale()) < settings.settled:
                return Settling(cycle=best)
        reason = _hopeless(dynamics, run.end_state, moved=bool(run.events))
        if reason:
            return Settling(cycle=None, reason=reason)
        if not found and run.releases:
            # The period may be longer than the chunk.
            pass
        state = run.end_state
    if best is not None and best.drift(best.scale()) < settings.usable:
        return Settling(cycle=best)
    what = "its periods differ" if best is not None else "no release is followed by a Zeno point"
    return Settling(cycle=None, reason=f"{what} after {settings.horizon:g} s")


def _hopeless(dynamics: HybridDynamics, state: Vector, *, moved: bool) -> str:
    """Return why a motion will not settle to an orbit, or nothing if it still may."""
    coordinates = state[: dynamics.n_q]
    far = int(np.argmax(np.abs(coordinates)))
    if abs(coordinates[far]) > _TURNS:
        return f"{dynamics.state_names[far]} runs away"
    if not moved and float(np.max(np.abs(dynamics.free.rate(state)[: 2 * dynamics.n_q]))) < 1e-6:
        return "the motion dies out"
    return ""
