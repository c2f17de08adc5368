"""Settings of a search, and its possible results."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum

from zeno_orbits.errors import InputError, any_number, positive_number
from zeno_orbits.search.program.writer import TranscriptionSettings
from zeno_orbits.simulation import SimulationSettings
from zeno_orbits.work import Checked, require_kinds


class SearchStatus(Enum):
    """Result of a search. The value is the sentence shown to the user."""

    FOUND = "The search found an orbit."
    NO_EVENTS = "No event occurred in the simulated time. An orbit needs an impact or a switch."
    NO_GUESS = "No simulation settled to a periodic motion from which to search."
    NOT_SOLVED = "The conditions of the orbit could not be met."
    NOT_FOLLOWED = "Simulating the solution does not reproduce it."
    NOT_ACCEPTED = "The orbits that were found were not accepted."

    @property
    def lacks_motion(self) -> bool:
        """True if no simulation reached a motion from which to search."""
        return self in (SearchStatus.NO_EVENTS, SearchStatus.NO_GUESS)


class SearchMethod(Enum):
    """How the best orbit in given ranges is found.

    Attributes:
        PROGRAM: A nonlinear program with all impacts, solved by Ipopt, then a simulation.
        SHOOTING: Orbits that are closed by simulation at every choice of the free values, without
            a program.
        AUTO: The program, whose optimum shooting checks. Shooting alone where a program lacks the
            objective or a bound, has extremes of signals, or does not converge.
    """

    AUTO = "auto"
    PROGRAM = "program"
    SHOOTING = "shooting"


@dataclass(frozen=True, slots=True, kw_only=True)
class TransientSettings:
    """Limits of the simulation of a motion until it repeats.

    Attributes:
        horizon: Longest simulated time from one start [s]. The default is 400 of the problem's
            slowest oscillations, or longer for a motion whose returns converge.
    """

    horizon: float | None = None

    def __post_init__(self) -> None:
        """Reject a time limit that is not positive."""
        require_kinds(self)
        if self.horizon is not None and not 0.0 < any_number("until", self.horizon) < math.inf:
            wanted = "must be a finite, positive number of seconds"
            raise InputError(f"Argument `until` {wanted}, but it is {self.horizon:g}.")


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchSettings(Checked):
    """Limits and tolerances of a search.

    Attributes:
        settling: Limits of the simulation until a motion repeats.
        simulation: Integrator and accuracy of the simulations that close orbits.
        transcription: Scheme, mesh and closure of the program that is solved beside the simulation.
        agreement: Largest relative difference of program and simulation over one period.
        rounds: Number of meshes, each ten times finer, until they agree.
        n_starts: Number of quasi-random starts after the given values.
        candidates: Number of accepted orbits after which a search ends.
        seed: Seed of the quasi-random starts.
    """

    settling: TransientSettings = field(default_factory=TransientSettings)
    simulation: SimulationSettings = field(default_factory=SimulationSettings)
    transcription: TranscriptionSettings = field(default_factory=TranscriptionSettings)
    agreement: float = 3e-10
    rounds: int = 4
    n_starts: int = 12
    candidates: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        """Reject values of a wrong kind, and a search for no orbit."""
        Checked.__post_init__(self)
        if self.candidates < 1:
            wanted = f"must be at least 1, but it is {self.candidates}"
            raise InputError(f"Argument `candidates` {wanted}.")

    def for_accuracy(self, accuracy: float) -> SearchSettings:
        """Return the fastest settings that reach a relative accuracy of the orbit.

        The mesh is refined by a factor of ten until program and simulation agree to this accuracy.
        The first mesh follows from measurements of `zeno-orbits trade`.

        Raises:
            InputError: If the accuracy is not a positive number.
        """
        accuracy = positive_number("accuracy", accuracy)
        transcription = replace(
            self.transcription,
            mesh_tolerance=min(_MESH_FOR * accuracy, _COARSEST_MESH),
            closure_tolerance=max(0.03 * accuracy, 1e-12),
        )
        return replace(self, transcription=transcription, agreement=0.3 * accuracy)


_COARSEST_MESH = 1e-2
_MESH_FOR = 100.0
"""Mesh tolerance in units of the accuracy: errors at mesh points are this much smaller than errors
inside intervals."""
