"""Error estimates by repetition: the difference of a second run at looser tolerances."""

from __future__ import annotations

from dataclasses import replace

from zeno_orbits.integrators import Tolerance
from zeno_orbits.simulation import SimulationSettings, ZenoExtrapolation, ZenoPassage

LOOSER = 100.0
"""Factor on the tolerances of the second run.

With this factor the observed errors were never above 0.6 of the difference. With a tenth of it, an
error of three times the difference was observed.
"""

_MOST_RESOLVED = 0.5
"""Largest ratio between the speeds of the last and the first resolved impact.

Beyond it an impact sequence is hardly resolved.
"""


def relaxed_tolerance(
    settings: SimulationSettings, *, factor: float = LOOSER
) -> SimulationSettings:
    """Return settings with much larger integration errors and the same Zeno completion.

    Args:
        settings: The settings.
        factor: Factor on the tolerances.
    """
    tolerance = settings.tolerance
    return replace(
        settings,
        tolerance=Tolerance(
            relative=factor * tolerance.relative, absolute=factor * tolerance.absolute
        ),
    )


def relaxed_settings(
    settings: SimulationSettings, *, factor: float = LOOSER, resolved: float = 1.0
) -> SimulationSettings:
    """Return settings with much larger errors of the steps and of the Zeno limit.

    Args:
        settings: The settings.
        factor: Factor on the tolerances.
        resolved: Factor on the speed below which impacts may be omitted, relative to the first.
    """
    completion = extrapolated(settings)
    return replace(
        relaxed_tolerance(settings, factor=factor),
        completion=ZenoExtrapolation(
            tolerance=factor * completion.tolerance,
            resolved=min(resolved * completion.resolved, max(completion.resolved, _MOST_RESOLVED)),
        ),
    )


def extrapolated(settings: SimulationSettings) -> ZenoExtrapolation:
    """Return the completion that computes the impacts, at the accuracy of the settings."""
    completion = settings.completion
    if isinstance(completion, ZenoPassage):
        return completion.one_by_one
    return completion if isinstance(completion, ZenoExtrapolation) else ZenoExtrapolation()
