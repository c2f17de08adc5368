"""Plans of work: its place, the size of its chunks, and the folder of its checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from zeno_orbits.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """Processes on this machine.

    Attributes:
        count: Number of processes; ``None`` for one per core.
        attempts: Number of times a chunk may kill the worker that computes it alone.
    """

    count: int | None = None
    attempts: int = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Cluster:
    """A Dask cluster that is running already.

    Attributes:
        address: Of its scheduler, ``tcp://host:8786`` for instance.
        patience: Longest wait for the scheduler, and for a first worker [s].
    """

    address: str
    patience: float = 8.0


Place = Workers | Cluster


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A plan of work; only the size of a chunk may change a result.

    Attributes:
        place: Where.
        chunk: Points a chunk. It must not depend on the place: points that are computed together
            may differ in the last bits from the same points computed apart.
        checkpoint: Folder that keeps finished chunks; ``None`` keeps none.
        identity: What tells this work from another, as plain data: the command, the problem and its
            content, settings, seeds, versions. Points and the package's own code are added to it.
        noun: Name of the points in progress reports.
    """

    place: Place = field(default_factory=Workers)
    chunk: int = 16
    checkpoint: Path | None = None
    identity: Mapping[str, Any] = field(default_factory=dict[str, Any])
    noun: str = "points"

    def __post_init__(self) -> None:
        if self.chunk < 1:
            raise InputError(f"Argument `chunk` must be at least 1, but it is {self.chunk}.")


@dataclass(frozen=True, slots=True, kw_only=True)
class LostPoint:
    """In place of a result: the point that killed every worker that computed it.

    Attributes:
        reason: The sentence for the user.
    """

    reason: str = "The point kills every worker that computes it."
