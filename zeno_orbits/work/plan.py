"""Plans of work: the executor, the size of the chunks, and the folder of the checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from zeno_orbits.errors import InputError
from zeno_orbits.work.kinds import Checked, require_kinds


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers(Checked):
    """Processes on this machine.

    Attributes:
        count: Number of processes, or ``None`` for one process per core.
        attempts: Number of worker crashes after which a chunk that is computed alone is given up.
    """

    count: int | None = None
    attempts: int = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Cluster(Checked):
    """A running Dask cluster.

    Attributes:
        address: Address of the scheduler, for instance ``tcp://host:8786``.
        patience: Longest wait for the scheduler, and for a first worker [s].
    """

    address: str
    patience: float = 8.0


Place = Workers | Cluster


@dataclass(frozen=True, slots=True, kw_only=True)
class ExecutionPlan:
    """A plan of work. Only the size of a chunk may change a result.

    Attributes:
        place: Executor of the work: processes on this machine or a cluster.
        chunk: Number of points per chunk. It must not depend on the executor, since results of
            points that are computed together may differ in the last bits from separate
            computations.
        checkpoint: Folder for finished chunks, or ``None`` to store nothing.
        identity: Run fingerprint, which distinguishes this work from other work, as plain data: the
            command, the problem and its content, settings, seeds, versions. Points and the code of
            the package are added automatically.
        noun: Name of the points in progress reports.
    """

    place: Place = field(default_factory=Workers)
    chunk: int = 16
    checkpoint: Path | None = None
    identity: Mapping[str, Any] = field(default_factory=dict[str, Any])
    noun: str = "points"

    def __post_init__(self) -> None:
        require_kinds(self)
        if self.chunk < 1:
            raise InputError(f"Argument `chunk` must be at least 1, but it is {self.chunk}.")


@dataclass(frozen=True, slots=True, kw_only=True)
class FailedPoint:
    """Replacement for a result: the point crashed every worker that computed it.

    Attributes:
        reason: Sentence for the user.
    """

    reason: str = "Every worker that computes the point is terminated."
