"""What a search is told and what comes of one of its starts: values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model.problem import ParameterValues
from zeno_orbits.orbits.cycle import Cycle
from zeno_orbits.orbits.orbit import ZenoOrbit
from zeno_orbits.orbits.shape import OrbitShape
from zeno_orbits.search.guess import SettlingSettings
from zeno_orbits.search.transcription.arc import TranscriptionSettings
from zeno_orbits.search.transcription.ipopt import IpoptSettings, Solution


class SearchStatus(Enum):
    """How a search ended. The value is the sentence shown to the user."""

    FOUND = "The search found an orbit."
    NO_GUESS = "No simulation settled to a motion that an orbit could be sought near."
    NOT_SOLVED = "The conditions of the orbit could not be met."
    NOT_FOLLOWED = "A simulation does not follow the solution."
    NOT_ACCEPTED = "The orbits that were found were not accepted."


_BY_ITERATIONS = IpoptSettings(most_iterations=60, most_seconds=1e9)
"""A limit of time would let the answer depend on what else the machine does."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchSettings:
    """How hard to look.

    Attributes:
        settling: How long a simulation may take to repeat itself.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """An orbit to start from.

    Attributes:
        values: Its numbers.
        start: Where its period starts, ``(n_x,)``.
        shape: Its shape.
    """

    values: ParameterValues
    start: Vector
    shape: OrbitShape


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """Where a search starts.

    Attributes:
        values: The numbers.
        known: An orbit at these numbers or near them; by default the problem is simulated.
        easy: Settings from which to follow orbits to these numbers where a simulation finds none.
    """

    values: ParameterValues
    known: Known | None = None
    easy: tuple[ParameterValues, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Find:
    """What came of one start or one solve.

    Attributes:
        status: How it ended.
        detail: The reason in words, where there is no orbit.
        orbit: The orbit, if there is one.
        values: Numbers of the solution.
        cycle: One period simulated from the solution.
        solution: What the solver returned.
        agreement: Relative difference of solution and simulation.
        closure_error: Estimated error of the Zeno closure, relative.
        n_unknowns: Unknowns of the program.
        shortfall: How far from a wanted value the start ended, or by how much it passes its bounds,
            in units of their sizes.
        excesses: Name of each bound to what a simulation of the solution passes it by.
    """

    status: SearchStatus
    detail: str = ""
    orbit: ZenoOrbit | None = None
    values: ParameterValues | None = None
    cycle: Cycle | None = None
    solution: Solution | None = None
    agreement: float = np.inf
    closure_error: float = np.inf
    n_unknowns: int = 0
    shortfall: float = np.inf
    excesses: Mapping[str, float] = field(default_factory=dict[str, float])


def listed(numbers: Mapping[str, float]) -> str:
    """Return names and numbers in words."""
    return ", ".join(f"{name} = {value:.6g}" for name, value in numbers.items()) or "the problem"
