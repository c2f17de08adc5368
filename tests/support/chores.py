"""Tasks for workers, as cheap as can be; workers import this module by its name."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zeno_orbits.work import report_part


def square(points: Sequence[float]) -> list[float]:
    """Return squares."""
    return [point * point for point in points]


def telling(points: Sequence[float]) -> list[float]:
    """Return squares, slowly, and tell after each how many are done."""
    for k in range(len(points)):
        time.sleep(0.15)
        report_part((k + 1) / len(points))
    return square(points)


@dataclass(frozen=True, slots=True, kw_only=True)
class Diary:
    """Sums its chunk into every result, and leaves a file for every chunk that it starts.

    A result tells the chunk in which it was computed: cutting the points otherwise would show.

    Attributes:
        folder: Where the files go.
        pause: How long a chunk takes [s].
    """

    folder: str
    pause: float = 0.0

    def __call__(self, points: Sequence[float]) -> list[dict[str, Any]]:
        """Return each point with the sum of its chunk."""
        (Path(self.folder) / f"{points[0]:.17g}-{os.getpid()}-{time.time_ns()}").touch()
        time.sleep(self.pause)
        return [{"point": point / 3, "sum": sum(points)} for point in points]

    def starts(self) -> list[str]:
        """Return the first point of every chunk that was started, once a start."""
        return sorted(path.name.split("-")[0] for path in Path(self.folder).iterdir())

    def workers(self) -> set[int]:
        """Return the processes that started chunks."""
        return {int(path.name.split("-")[1]) for path in Path(self.folder).iterdir()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Deadly:
    """Kills its worker at some points.

    Attributes:
        points: These.
        how: ``None`` leaves by the back door, with exit code 0; a number is a signal.
        once: If given, a folder that remembers the dead: no point kills twice.
    """

    points: tuple[float, ...]
    how: int | None = signal.SIGKILL
    once: str = ""

    def __call__(self, points: Sequence[float]) -> list[float]:
        """Return the points, if the process lives to tell."""
        for point in points:
            if point in self.points and not self._has_killed(point):
                if self.how is None:
                    os._exit(0)
                os.kill(os.getpid(), self.how)
                time.sleep(60)
        return list(points)

    def _has_killed(self, point: float) -> bool:
        if not self.once:
            return False
        mark = Path(self.once) / f"{point}"
        known = mark.exists()
        mark.touch()
        return known


class OddError(Exception):
    """An exception that no other process can unpickle."""

    def __init__(self, reason: str, *, number: int) -> None:
        super().__init__(reason)
        self.number = number


def fail(points: Sequence[float]) -> list[float]:
    """Fail."""
    raise OddError(f"there is no answer for {points[0]}", number=7)


def environment(points: Sequence[float]) -> list[list[str | None]]:
    """Return the number of threads that numerical libraries are given."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return [[os.environ.get(name) for name in names] for _ in points]


def not_plain(points: Sequence[float]) -> list[float]:
    """Return what JSON does not hold."""
    return [float("nan") for _ in points]


def too_few(points: Sequence[float]) -> list[float]:
    """Forget a point."""
    return list(points[1:])


def echo(points: Sequence[float]) -> list[Any]:
    """Return points in hexadecimal digits and in a tuple."""
    return [(point.hex(), (point,)) for point in points]


def slow_at_zero(points: Sequence[float]) -> list[float]:
    """Return squares, those of a chunk that begins at zero late."""
    time.sleep(0.0 if points[0] else 0.5)
    return square(points)


class Unsendable:
    """A task that cannot be pickled."""

    def __call__(self, points: Sequence[float]) -> list[float]:
        """Return the points."""
        return list(points)

    def __reduce__(self) -> Any:
        """Refuse."""
        raise TypeError("not for export")


def addresses(points: Sequence[float]) -> list[str]:
    """Return the address of the Dask worker that computes."""
    from distributed import get_worker

    return [str(get_worker().address) for _ in points]
