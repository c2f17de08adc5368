"""Work-precision results: accuracy and cost of integrators, Zeno approximations, reduced models.

The command `work-precision` writes the results. The measurements are implemented in `trials`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.precision.landmark import ROUNDING
from zeno_orbits.work import Columns, EntryError, TableRepr, from_plain, read_json

SAME_WORK = ("engine", "cut", "impacts", "fidelity")
"""Sweeps whose trials simulate the same motion, so that their times are comparable."""

_ABOVE = 100.0
"""Least ratio of an error to the error of the reference, for the estimate of an order."""

_CLOSURES = {"cut": "plastic below a speed", "impacts": "limit after n impacts"}


@dataclass(frozen=True, slots=True, kw_only=True)
class TimedSetting:
    """One setting, timed and compared with the reference.

    Attributes:
        sweep: Quantity that is varied: ``engine``, ``cut``, ``impacts``, ``mesh`` or ``fidelity``.
        name: Name of the integrator, Zeno approximation or model.
        value: Value of the varied quantity: a tolerance, a threshold, a count.
        seconds: Median processor time of the work [s].
        error: Largest relative difference from the reference. Infinite if the events differ.
        n_impacts: Number of resolved impacts.
        trouble: Reason of a failure. Empty if the trial has a result.
        speed: Geometric mean of the gap rates at which impact sequences were truncated. NaN without
            a truncation.
    """

    sweep: str
    name: str
    value: float
    seconds: float
    error: float
    n_impacts: int = 0
    trouble: str = ""
    speed: float = math.nan

    @property
    def label(self) -> str:
        """Name of the trial's curve in a plot."""
        if self.sweep == "engine":
            return self.name
        return _CLOSURES.get(self.sweep, f"model {self.name}")


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class WorkPrecision(TableRepr):
    """All trials of one work-precision study.

    Attributes:
        problem: The problem.
        work: The simulated motion, as a phrase.
        truth: The reference for the comparison, as a phrase.
        truth_error: Estimated error of the reference.
        trials: The trials, including trials of other work (``mesh``).
        compared: Kind of the events whose errors are reported: the first of ``release``, ``Zeno
            point``, ``impact`` and ``end`` that the motion contains.
    """

    problem: str
    work: str
    truth: str
    truth_error: float
    trials: tuple[TimedSetting, ...]
    compared: str = "release"

    def __repr__(self) -> str:
        """Return one line with the motion, the number of trials and the reference."""
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
    def front(self) -> tuple[TimedSetting, ...]:
        """The Pareto front of time and error, the fastest trial first.

        Errors below rounding are accidental and do not count as smaller.
        """
        comparable = [t for t in self.trials if t.sweep in SAME_WORK and math.isfinite(t.error)]
        front: list[TimedSetting] = []
        for trial in sorted(comparable, key=lambda t: (t.seconds, t.error)):
            if not front or max(trial.error, ROUNDING) < front[-1].error:
                front.append(trial)
        return tuple(front)

    @property
    def cut_order(self) -> float:
        """Observed order of the error of the paper's rule in the speed of the truncation.

        It is NaN if an order cannot be computed. Errors that may be due to the reference or to
        rounding are omitted.
        """
        runs = [t for t in self.trials if t.sweep == "engine" and t.name == "automatic"]
        # Truncated runs have the tightest tolerance. Errors due to that tolerance have no order.
        steps = min(runs, key=lambda trial: trial.value).error if runs else 0.0
        least = max(_ABOVE * max(self.truth_error, ROUNDING), 10 * steps)
        cuts = [t for t in self.trials if t.sweep == "cut" and least < t.error < 1.0]
        known = {t.speed: t.error for t in cuts if t.speed > 0.0}
        if len(known) < 2:
            return math.nan
        speeds, errors = np.log(list(known)), np.log(list(known.values()))
        return float(np.polyfit(speeds, errors, 1)[0])

    @property
    def expected_cut_order(self) -> int:
        """Order of the error by theory (2.3): 3 for releases, 1 for the Zeno points themselves."""
        return 3 if self.compared == "release" else 1

    def as_json(self) -> dict[str, Any]:
        """Return the results as plain data. Values that are not finite become ``null``."""
        front = set(map(id, self.front))
        return {
            "problem": self.problem,
            "work": self.work,
            "truth": self.truth,
            "truth_error": self.truth_error if math.isfinite(self.truth_error) else None,
            "compared": self.compared,
            "cut_order": self.cut_order if math.isfinite(self.cut_order) else None,
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
                    **({"speed": trial.speed} if math.isfinite(trial.speed) else {}),
                }
                for trial in self.trials
            ],
        }

    def cheapest(self, accuracy: float) -> TimedSetting | None:
        """Return the fastest trial that reached an accuracy, or ``None``."""
        return next((trial for trial in self.front if trial.error <= accuracy), None)


@dataclass(frozen=True, slots=True, kw_only=True)
class _TrialEntry:
    """A trial in a file. A value that is not finite is null."""

    sweep: str
    name: str
    value: float
    seconds: float | None
    error: float | None
    impacts: int
    trouble: str
    speed: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _File:
    """A file of the command `work-precision`."""

    problem: str
    work: str
    truth: str
    truth_error: float | None
    trials: tuple[_TrialEntry, ...]
    compared: str = "release"


def read_work_precision(path: Path) -> WorkPrecision:
    """Read a file of the command `work-precision`.

    Args:
        path: The file.

    Raises:
        InputError: If the file is missing, truncated or of a wrong type.
    """
    wanted = f"Trade file `{path}` is not an output of `work-precision -o`:"
    try:
        found = from_plain(_File, read_json(path))
    except EntryError as error:
        raise InputError(f"{wanted} {error}.") from error
    except ValueError as error:
        raise InputError(f"{wanted} {error}.") from error
    return WorkPrecision(
        problem=found.problem,
        work=found.work,
        truth=found.truth,
        truth_error=_number(found.truth_error),
        compared=found.compared,
        trials=tuple(
            TimedSetting(
                sweep=entry.sweep,
                name=entry.name,
                value=entry.value,
                seconds=_number(entry.seconds),
                error=_number(entry.error),
                n_impacts=entry.impacts,
                trouble=entry.trouble,
                speed=math.nan if entry.speed is None else entry.speed,
            )
            for entry in found.trials
        ),
    )


def _number(value: float | None) -> float:
    """Return a number of a file. The entry null stands for a value that is not finite."""
    return math.inf if value is None else value
