"""Work-precision results: the accuracy and the price of engines, closures and reduced models.

The command `trade` measures and writes them; `trials` makes the measurements.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zeno_orbits.errors import InputError
from zeno_orbits.precision.landmark import ROUNDING
from zeno_orbits.work import Columns, Displayed, EntryError, restored

SAME_WORK = ("engine", "cut", "impacts", "fidelity")
"""Sweeps whose trials follow the same motion, so that their times compare."""

_CLOSURES = {"cut": "plastic below a speed", "impacts": "limit after n impacts"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One setting, timed and compared with the truth.

    Attributes:
        sweep: Quantity that is varied: ``engine``, ``cut``, ``impacts``, ``mesh`` or ``fidelity``.
        name: Engine, closure or model.
        value: The number that is varied: a tolerance, a threshold, a count.
        seconds: Median processor time of the work [s].
        error: Largest relative difference from the truth; infinite if the run went another way.
        n_impacts: Impacts that were resolved.
        trouble: Reason why there is no result; empty if there is one.
    """

    sweep: str
    name: str
    value: float
    seconds: float
    error: float
    n_impacts: int = 0
    trouble: str = ""

    @property
    def label(self) -> str:
        """Name of the line of the trial in a picture."""
        if self.sweep == "engine":
            return self.name
        return _CLOSURES.get(self.sweep, f"model {self.name}")


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class WorkPrecision(Displayed):
    """All trials of one piece of work.

    Attributes:
        problem: The problem.
        work: The simulated motion, as a phrase.
        truth: The reference it is compared with, as a phrase.
        truth_error: Estimated error of that.
        trials: The trials, those that are other work (``mesh``) included.
    """

    problem: str
    work: str
    truth: str
    truth_error: float
    trials: tuple[Trial, ...]

    def __repr__(self) -> str:
        """Return one line: what was measured, how often, against what."""
        return (
            f"<WorkPrecision of {self.problem}: {self.work}, trials={len(self.trials)}, "
            f"front={len(self.front)}; truth: {self.truth}, error {self.truth_error:.0e}>"
        )

    def _columns(self) -> Columns:
        """Return the trials."""
        names = ("sweep", "name", "value", "seconds", "error", "n_impacts", "trouble")
        front = set(map(id, self.front))
        table = {name: [getattr(trial, name) for trial in self.trials] for name in names}
        return {**table, "on_front": [id(trial) in front for trial in self.trials]}

    @property
    def front(self) -> tuple[Trial, ...]:
        """The trials that no other one beats in both time and error, the fastest first.

        Errors below rounding are luck and do not count as smaller.
        """
        comparable = [t for t in self.trials if t.sweep in SAME_WORK and math.isfinite(t.error)]
        front: list[Trial] = []
        for trial in sorted(comparable, key=lambda t: (t.seconds, t.error)):
            if not front or max(trial.error, ROUNDING) < front[-1].error:
                front.append(trial)
        return tuple(front)

    def as_json(self) -> dict[str, Any]:
        """Return the results as plain data; what is not finite becomes ``null``."""
        front = set(map(id, self.front))
        return {
            "problem": self.problem,
            "work": self.work,
            "truth": self.truth,
            "truth_error": self.truth_error if math.isfinite(self.truth_error) else None,
            "trials": [
                {
                    "sweep": trial.sweep,
                    "name": trial.name,
                    "value": trial.value,
                    "seconds": trial.seconds if math.isfinite(trial.seconds) else None,
                    "error": trial.error if math.isfinite(trial.error) else None,
                    "impacts": trial.n_impacts,
                    "trouble": trial.trouble,
                    "on_front": id(trial) in front,
                }
                for trial in self.trials
            ],
        }

    def cheapest(self, accuracy: float) -> Trial | None:
        """Return the fastest trial that reached an accuracy, if one did."""
        return next((trial for trial in self.front if trial.error <= accuracy), None)


@dataclass(frozen=True, slots=True, kw_only=True)
class _TrialEntry:
    """A trial in a file; what is not finite is null."""

    sweep: str
    name: str
    value: float
    seconds: float | None
    error: float | None
    impacts: int
    trouble: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _File:
    """A file of the command `trade`."""

    problem: str
    work: str
    truth: str
    truth_error: float | None
    trials: tuple[_TrialEntry, ...]


def read_work_precision(path: Path) -> WorkPrecision:
    """Read a file that the command `trade` wrote.

    Args:
        path: The file.

    Raises:
        InputError: If it is missing, cut short or of a wrong type.
    """
    wanted = f"Trade file `{path}` must hold what `trade -o` wrote, but"
    try:
        found = restored(_File, json.loads(path.read_text(encoding="utf-8")))
    except EntryError as error:
        raise InputError(f"{wanted} {error}.") from error
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{wanted} it does not ({type(error).__name__}).") from error
    return WorkPrecision(
        problem=found.problem,
        work=found.work,
        truth=found.truth,
        truth_error=_number(found.truth_error),
        trials=tuple(
            Trial(
                sweep=entry.sweep,
                name=entry.name,
                value=entry.value,
                seconds=_number(entry.seconds),
                error=_number(entry.error),
                n_impacts=entry.impacts,
                trouble=entry.trouble,
            )
            for entry in found.trials
        ),
    )


def _number(value: float | None) -> float:
    """Return a number of a file; what was not finite was written as null."""
    return math.inf if value is None else value
