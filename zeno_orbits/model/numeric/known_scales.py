"""The characteristic scales of a problem at the values that were last asked for."""

from __future__ import annotations

from collections.abc import Callable

from zeno_orbits.arrays import Vector
from zeno_orbits.model.scale import CharacteristicScales

_MOST = 64
"""Number of kept scales."""


class KnownScales:
    """Scales by values and stop. To compute them takes longer than a short simulation."""

    def __init__(self) -> None:
        """Begin without scales."""
        self._known: dict[tuple[bytes, int], CharacteristicScales] = {}

    def at(
        self, p: Vector, stop: int, compute: Callable[[], CharacteristicScales]
    ) -> CharacteristicScales:
        """Return the scales at some values, computed unless they are known.

        Args:
            p: Parameter vector, gains then parameters.
            stop: Index of the stop.
            compute: Function that computes them.
        """
        key = p.tobytes(), stop
        found = self._known.get(key)
        if found is None:
            found = compute()
            if len(self._known) >= _MOST:
                self._known.clear()
            self._known[key] = found
        return found
