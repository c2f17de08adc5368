"""Error estimates by repetition: a run is repeated at looser tolerances, the difference bounds."""

from __future__ import annotations

from dataclasses import replace

from zeno_orbits.integrators import Tolerance
from zeno_orbits.simulation import SimulationSettings, ZenoExtrapolation, ZenoPassage

LOOSER = 100.0
"""Factor of the tolerances of the second run. With a tenth of it an error was seen three times the
difference; with this, never above 0.6 of it."""

_MOST_RESOLVED = 0.5
"""Beyond this an impact sequence is hardly resolved at all."""


def at_looser_tolerance(
    settings: SimulationSettings, *, factor: float = LOOSER
) -> SimulationSettings:
    """Return settings whose integration errors are larger by far; the completion stays.

    Args:
        settings: The settings.
        factor: Factor of the tolerances.
    """
    tolerance = settings.tolerance
    return replace(
        settings,
        tolerance=Tolerance(
            relative=factor * tolerance.relative, absolute=factor * tolerance.absolute
        ),
    )


def loosened(
    settings: SimulationSettings, *, factor: float = LOOSER, resolved: float = 1.0
) -> SimulationSettings:
    """Return settings whose errors are larger by far: of the steps, and of the Zeno limit.

    Args:
        settings: The settings.
        factor: Factor of the tolerances.
        resolved: Factor of the speed from which on impacts may be left out.
    """
    completion = extrapolated(settings)
    return replace(
        at_looser_tolerance(settings, factor=factor),
        completion=ZenoExtrapolation(
            tolerance=factor * completion.tolerance,
            resolved=min(resolved * completion.resolved, max(completion.resolved, _MOST_RESOLVED)),
        ),
    )


def extrapolated(settings: SimulationSettings) -> ZenoExtrapolation:
    """Return the completion that visits the impacts, as accurate as the settings ask for."""
    completion = settings.completion
    if isinstance(completion, ZenoPassage):
        return completion.one_by_one
    return completion if isinstance(completion, ZenoExtrapolation) else ZenoExtrapolation()
