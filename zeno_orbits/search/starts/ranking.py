"""Differences below which two orbits of a search are the same candidate."""

from __future__ import annotations

from collections.abc import Sequence

SAME = 1e-5
"""Relative difference of free values and periods below which two orbits are the same candidate. The
solution of a program is a few 1e-6 off the nearest values, as the score is flat there."""
SAME_OPTIMUM = 1e-3
"""The same for optima, and for their scores."""
SAME_STATE = 1e-3
"""Difference below which two states are the same, in units of their sizes on an orbit."""


def are_close(pairs: Sequence[tuple[float, float]], close: float) -> bool:
    """Return True if the numbers of every pair differ by less than a part of the larger one.

    Args:
        pairs: The pairs.
        close: The part.
    """
    return all(abs(p - q) <= close * max(abs(p), abs(q)) for p, q in pairs)
