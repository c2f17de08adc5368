"""The report page of an orbit."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from zeno_orbits.api.checks import verify
from zeno_orbits.api.inputs import Named, any_orbit, front_door, problem_of
from zeno_orbits.api.machines import compare
from zeno_orbits.errors import InputError
from zeno_orbits.orbits import Orbit
from zeno_orbits.work import Progress, silent

if TYPE_CHECKING:
    from zeno_orbits.experiment import Recording
    from zeno_orbits.maps import Pushes, Recovery
    from zeno_orbits.model import Problem
    from zeno_orbits.precision import WorkPrecision
    from zeno_orbits.report import Subject
    from zeno_orbits.verification import VerificationSettings


@front_door
def report_page(
    orbit: Orbit | str | Path,
    *,
    problem: Named | None = None,
    settings: VerificationSettings | None = None,
    trade: WorkPrecision | str | Path | None = None,
    pushes: Pushes | str | Path | None = None,
    recovery: Recovery | str | Path | None = None,
    recording: Recording | str | Path | None = None,
    t_start: float | None = None,
    t_end: float | None = None,
    on_progress: Progress = silent,
) -> str:
    """Verify an orbit and return the results as one page for a browser, in HTML.

    Args:
        orbit: The orbit, or its file.
        problem: The orbit's problem. The default is the bundled problem of its name.
        settings: Tolerance, number of periods and accuracy of the verification.
        trade: A work-precision study of the problem, or its file.
        pushes: The largest pushes of the orbit, or their file.
        recovery: The recovery of the orbit, or its file.
        recording: A recording to compare with the orbit, or its file.
        t_start: First time of the recording that counts [s].
        t_end: Last time of the recording that counts [s].
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If the extra `report` is not installed, the orbit's problem is not known, or a
            file is of another kind, problem or orbit.
    """
    from zeno_orbits.report import load_bundle, page_of

    bundle = load_bundle()
    subject = report_subject(
        orbit,
        problem=problem,
        settings=settings,
        trade=trade,
        pushes=pushes,
        recovery=recovery,
        recording=recording,
        t_start=t_start,
        t_end=t_end,
        on_progress=on_progress,
    )
    on_progress("writing the page", None)
    return page_of(subject.followed(), bundle)


def report_subject(
    orbit: Orbit | str | Path,
    *,
    problem: Named | None = None,
    settings: VerificationSettings | None = None,
    trade: WorkPrecision | str | Path | None = None,
    pushes: Pushes | str | Path | None = None,
    recovery: Recovery | str | Path | None = None,
    recording: Recording | str | Path | None = None,
    t_start: float | None = None,
    t_end: float | None = None,
    on_progress: Progress = silent,
) -> Subject:
    """Return the subject of a report page: the orbit with a fresh verification report.

    Args:
        orbit: As in `report_page`.
        problem: As in `report_page`.
        settings: As in `report_page`.
        trade: As in `report_page`.
        pushes: As in `report_page`.
        recovery: As in `report_page`.
        recording: As in `report_page`.
        t_start: As in `report_page`.
        t_end: As in `report_page`.
        on_progress: As in `report_page`.

    Raises:
        InputError: If the orbit's problem is not known, or a file is of another kind, problem or
            orbit.
    """
    from zeno_orbits.report import Subject

    found = any_orbit(orbit)
    known = problem_of(found, problem)
    if trade is not None and found.phases_as is None:
        raise InputError("Argument `trade` needs a machine with one stop, no switch and no kink.")
    study = _trade_of(found, trade)
    pushed = _pushes_of(found, known, pushes)
    recovered = _recovery_of(found, known, recovery)
    if recording is None and (t_start is not None or t_end is not None):
        asked = "t_end" if t_start is None else "t_start"
        raise InputError(f"Argument `{asked}` needs a recording.")
    compared = None
    if recording is not None:
        compared = compare(
            found, recording, problem=known, t_start=t_start, t_end=t_end, on_progress=on_progress
        )
    machine = found.machine(known)
    certificate = verify(
        found, problem=known, settings=settings, dynamics=machine, on_progress=on_progress
    )
    return Subject(
        orbit=found,
        problem=known,
        dynamics=machine,
        certificate=certificate,
        trade=study,
        pushes=pushed,
        recovery=recovered,
        comparison=compared,
        recording=Path(recording).name if isinstance(recording, str | Path) else "",
        file="orbit.json" if isinstance(orbit, Orbit) else Path(orbit).name,
        problem_file=str(problem) if isinstance(problem, str | Path) else "",
        content=json.dumps(found.as_json(), indent=2, allow_nan=False) + "\n",
        date=datetime.now(tz=UTC).date().isoformat(),
    )


def _trade_of(orbit: Orbit, trade: WorkPrecision | str | Path | None) -> WorkPrecision | None:
    """Return the work-precision study of the orbit's problem."""
    if isinstance(trade, str | Path):
        from zeno_orbits.precision import read_work_precision

        trade = read_work_precision(Path(trade))
    if trade is not None and trade.problem != orbit.problem:
        message = f"must be of the problem `{orbit.problem}`, but it is of `{trade.problem}`"
        raise InputError(f"Argument `trade` {message}.")
    return trade


def _pushes_of(orbit: Orbit, problem: Problem, pushes: Pushes | str | Path | None) -> Pushes | None:
    """Return the largest pushes of the orbit."""
    from zeno_orbits.maps import read_pushes, require_pushes_of

    found = read_pushes(Path(pushes)) if isinstance(pushes, str | Path) else pushes
    if found is not None:
        require_pushes_of(orbit, problem, found)
    return found


def _recovery_of(
    orbit: Orbit, problem: Problem, recovery: Recovery | str | Path | None
) -> Recovery | None:
    """Return the recovery of the orbit."""
    from zeno_orbits.maps import read_recovery, require_recovery_of

    found = read_recovery(Path(recovery)) if isinstance(recovery, str | Path) else recovery
    if found is not None:
        require_recovery_of(orbit, problem, found)
    return found
