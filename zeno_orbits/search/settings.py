"""Settings of a search, and the ways in which it may end."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum

from zeno_orbits.search.guess import SettlingSettings
from zeno_orbits.search.transcription.arc import TranscriptionSettings
from zeno_orbits.search.transcription.ipopt import IpoptSettings


class SearchStatus(Enum):
    """End of a search. The value is the sentence shown to the user."""

    FOUND = "The search found an orbit."
    NO_GUESS = "No simulation settled to a periodic motion from which to search."
    NOT_SOLVED = "The conditions of the orbit could not be met."
    NOT_FOLLOWED = "Simulating the solution does not reproduce it."
    NOT_ACCEPTED = "The orbits that were found were not accepted."


_BY_ITERATIONS = IpoptSettings(most_iterations=60, most_seconds=1e9)
"""A limit of time would let the answer depend on what else the machine does."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchSettings:
    """Limits and tolerances of a search.

    Attributes:
        settling: Limits of the wait for a simulated motion to repeat.
        transcription: Scheme, mesh and closure.
        ipopt: Solver settings; the square case approximates the Hessian whatever they say.
        agreement: Largest relative difference of program and simulation over one period.
        rounds: Times the mesh is drawn anew.
        n_starts: Quasi-random starting numbers after the given ones.
        candidates: Accepted orbits after which a search ends.
        first_step: Change of a wanted value that is tried at once, in units of the value.
        smallest_step: Smallest change before the search gives up, likewise.
        seed: Of the quasi-random gains.
    """

    settling: SettlingSettings = field(default_factory=SettlingSettings)
    transcription: TranscriptionSettings = field(default_factory=TranscriptionSettings)
    ipopt: IpoptSettings = field(default_factory=lambda: _BY_ITERATIONS)
    agreement: float = 3e-10
    rounds: int = 4
    n_starts: int = 12
    candidates: int = 1
    first_step: float = 0.03
    smallest_step: float = 0.003
    seed: int = 0

    def for_accuracy(self, accuracy: float) -> SearchSettings:
        """Return the cheapest settings that reach a relative accuracy of the orbit.

        A mesh is drawn anew, ten times finer, until program and simulation agree so far; the first
        one is what `zeno-orbits trade` measured to be near.
        """
        transcription = replace(
            self.transcription,
            mesh_tolerance=min(_MESH_FOR * accuracy, _COARSEST_MESH),
            closure_tolerance=max(0.03 * accuracy, 1e-12),
        )
        return replace(self, transcription=transcription, agreement=0.3 * accuracy)


_COARSEST_MESH = 1e-2
_MESH_FOR = 100.0
"""Mesh tolerance in units of the accuracy: ends of intervals are that much better than insides."""
