"""Real machines: a simulated test rig, and recordings for comparison and identification."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits.api.inputs import (
    Named,
    Numbers,
    any_orbit,
    as_orbit,
    front_door,
    known_problem,
    problem_of,
    whole,
)
from zeno_orbits.errors import InputError, named_numbers, number_range, shown
from zeno_orbits.model import ParameterValues, Problem, Rig, recorded_problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.work import Progress, silent

if TYPE_CHECKING:
    from zeno_orbits.experiment import (
        ColumnNotes,
        Comparison,
        FitParameter,
        Identification,
        LawComparison,
        MatchedRun,
        Recording,
        RecordingDescription,
        RigComparison,
        RigRun,
        RigSettings,
        SecondFile,
        SettledRig,
        TransientComparison,
    )

Fit = Mapping[str, tuple[float, float] | None] | Sequence[str]
"""Parameters to estimate, each with its range or None. ``A+B`` are two with one value."""

RIG_TIME = 10.0
"""Duration of a run without an orbit, in characteristic times of the problem."""


@front_door
def crop(
    recording: Recording, t_start: float | None = None, t_end: float | None = None
) -> Recording:
    """Return the part of a recording between two times.

    Args:
        recording: The recording.
        t_start: First time [s]. The default is the beginning.
        t_end: Last time [s]. The default is the end.

    Raises:
        InputError: If fewer than two rows are left.
    """
    from zeno_orbits.experiment import crop_recording

    return crop_recording(recording, t_start, t_end)


@front_door
def describe_recording(
    recording: str | Path, *, columns: ColumnNotes | None = None, problem: Named | None = None
) -> RecordingDescription:
    """Return what a file of time series is understood to be, as an instrument wrote it.

    Args:
        recording: The file.
        columns: What is known of its columns in addition to their titles.
        problem: The problem whose signals are sought. The default is any.

    Raises:
        DataFileError: If the file is not a table of values.
        InputError: If the notes name a column that the file does not have.
    """
    from zeno_orbits.experiment import description_of as describe
    from zeno_orbits.experiment import measurable

    known = None if problem is None else measurable(known_problem(problem))
    return describe(recording, columns=columns, units=known)


def clock_words(first: RecordingDescription, second: RecordingDescription) -> str:
    """Return what signals of two files tell of the clock of the second one, empty without any.

    Args:
        first: A file as it was understood.
        second: A second file of the same motion on another clock.
    """
    from zeno_orbits.experiment import words_of_clocks as told

    known = first.recording, second.recording
    return "" if known[0] is None or known[1] is None else told(known[0], known[1])


@front_door
def compare(
    orbit: Orbit | str | Path,
    recording: Recording | str | Path,
    *,
    problem: Named | None = None,
    fit: Sequence[str] = (),
    second_file: Recording | str | Path | None = None,
    t_start: float | None = None,
    t_end: float | None = None,
    on_progress: Progress = silent,
) -> Comparison:
    """Return a recording compared with an orbit.

    Args:
        orbit: The orbit, or its file.
        recording: The recording, or its file. Signals with the name of a state, motor or output of
            the problem are compared, and contact channels.
        problem: The orbit's problem. The default is the bundled problem of its name.
        fit: Gains and offsets of channels to determine, ``CHANNEL.gain`` and ``CHANNEL.offset``. A
            channel without a known scale and zero, such as a track in pixels, counts by its shape.
        second_file: A second file of the same motion on another clock, which shows the orbit too.
        t_start: First time of the recording that counts [s].
        t_end: Last time of the recording that counts [s].
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If the recording contains no signal of the problem and no contact channel, a
            signal has a wrong unit, or a contact channel is invalid.
        SimulationError: If the orbit does not return.
    """
    from zeno_orbits.experiment import compare_recording, compare_two_files

    found = any_orbit(orbit)
    known = problem_of(found, problem)
    errors = _instrument_errors(known, found.values(known), fit)
    data = recording_for(known, recording, t_start, t_end, on_progress)
    other = read_second_file(known, second_file, on_progress)
    _require_one_trial([("", data)], other)
    on_progress("comparing", None)
    readings = [word for one in errors for word in one.readings]
    if other is None:
        return compare_recording(found, known, data, readings)
    return compare_two_files(found, known, (data, other.recording), other.label, readings)


@front_door
def identify(
    problem: Named,
    recording: Recording | str | Path | Sequence[Recording | str | Path],
    fit: Fit,
    *,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    initial: Sequence[str] = (),
    second_file: Recording | str | Path | None = None,
    transient: bool | None = None,
    t_start: float | None = None,
    t_end: float | None = None,
    on_progress: Progress = silent,
) -> Identification:
    """Return the parameters for which the motion of a problem is nearest to recordings.

    A settled machine is compared with the orbit of its parameters. A transient, such as a drop, a
    swing-down or a step, is compared with a simulation whose initial values are determined too. The
    recordings decide which: several trials, times of events and motions that come to rest are
    transients.

    Args:
        problem: The problem, its name or its file.
        recording: The recording, or its file. Several are trials of transients with the same
            parameters. A settled machine is recorded over at least two periods.
        fit: Parameters to estimate. ``A+B`` are two parameters with one value. Without a range, a
            parameter may vary between a tenth and ten times its value, or for transients between
            a third and three times. ``CHANNEL.gain``, ``CHANNEL.offset`` and ``clock_rate`` are
            errors of the instruments. A clock with the rate `c` is faster by the factor ``1 + c``.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        start: Known initial values of transients. The other recorded states begin near their first
            samples, and their rates near the slopes there.
        initial: Further initial values of transients to determine: states that are not recorded,
            ``clock`` for the phase of the clock, ``offset`` for the time of the start.
        second_file: A second file of the same motion on another clock, whose offset and rate are
            determined too. Of a settled motion it has signals, and no contact channel.
        transient: Whether transients are fitted. The default is to decide by the recordings.
        t_start: First time of the recordings that counts [s].
        t_end: Last time of the recordings that counts [s].
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If a name is unknown, a range does not fit the parameter, or a contact channel
            is invalid.
        UnfittableError: If the recording does not show such a motion, or no orbit exists at the
            initial parameter values.
    """
    known = known_problem(problem)
    return identify_trials(
        known,
        labelled_recordings(known, recording, t_start, t_end, on_progress),
        fit,
        values=known.values(gains=gains, parameters=parameters),
        start=start,
        initial=initial,
        second=read_second_file(known, second_file, on_progress),
        transient=transient,
        on_progress=on_progress,
    )


@front_door
def compare_laws(
    problem: Named,
    recording: Recording | str | Path | Sequence[Recording | str | Path],
    fit: Fit,
    law: Sequence[str] = ("constant", "linear", "power"),
    *,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    initial: Sequence[str] = (),
    t_start: float | None = None,
    t_end: float | None = None,
    on_progress: Progress = silent,
) -> LawComparison:
    """Return laws of impact, each fitted to the same transients, and the law that they support.

    The laws are ``constant``, ``linear`` in the impact speed and a ``power`` of it, capped below 1.

    Args:
        problem: The problem, its name or its file, with a parameter ``restitution``.
        recording: The recording or its file, or several trials.
        fit: Parameters to estimate, as for `identify`. The restitution is one of them.
        law: Names of the laws.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        start: Known initial values, as for `identify`.
        initial: Further initial values to determine, as for `identify`.
        t_start: First time of the recordings that counts [s].
        t_end: Last time of the recordings that counts [s].
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If a name is unknown, or the problem has no parameter `restitution`.
        UnfittableError: If no simulated motion follows the recordings.
    """
    known = known_problem(problem)
    return compare_laws_of(
        known,
        labelled_recordings(known, recording, t_start, t_end, on_progress),
        fit,
        law,
        values=known.values(gains=gains, parameters=parameters),
        start=start,
        initial=initial,
        on_progress=on_progress,
    )


def compare_laws_of(
    problem: Problem,
    trials: Sequence[tuple[str, Recording]],
    fit: Fit,
    law: Sequence[str],
    *,
    values: ParameterValues,
    start: Numbers | None = None,
    initial: Sequence[str] = (),
    on_progress: Progress = silent,
) -> LawComparison:
    """Return the result of `compare_laws` for recordings that were read.

    Args:
        problem: The problem.
        trials: Label and recording of each trial.
        fit: As in `compare_laws`.
        law: As in `compare_laws`.
        values: Gains and parameters at the start.
        start: As in `compare_laws`.
        initial: As in `compare_laws`.
        on_progress: Called with the stage and the part of it that is done.
    """
    from zeno_orbits.experiment import laws_of

    asked: dict[str, tuple[float, float] | None]
    asked = dict(fit) if isinstance(fit, Mapping) else dict.fromkeys(fit)
    asked.setdefault("restitution", None)

    def fitted(
        other: Problem, numbers: ParameterValues, further: Mapping[str, tuple[float, float]]
    ) -> Identification:
        return identify_trials(
            other,
            trials,
            {**asked, **further},
            values=numbers,
            start=start,
            initial=initial,
            transient=True,
            on_progress=on_progress,
        )

    return laws_of(problem, values, law, fitted)


def identify_trials(
    problem: Problem,
    trials: Sequence[tuple[str, Recording]],
    fit: Fit,
    *,
    values: ParameterValues,
    start: Numbers | None = None,
    initial: Sequence[str] = (),
    second: SecondFile | None = None,
    transient: bool | None = None,
    on_progress: Progress = silent,
) -> Identification:
    """Return the result of `identify` for recordings that were read.

    Args:
        problem: The problem.
        trials: Label and recording of each trial.
        fit: As in `identify`.
        values: Gains and parameters at the start.
        start: As in `identify`.
        initial: As in `identify`.
        second: The second file of `identify`, which was read.
        transient: As in `identify`.
        on_progress: Called with the stage and the part of it that is done.
    """
    from zeno_orbits.experiment import fit_parameters, fit_transient_parameters

    known = problem
    if not _are_transients(known, trials, transient, start, initial, second):
        unknowns = _unknowns(known, values, fit)
        return fit_parameters(
            known, values, trials[0][1], unknowns, second=second, on_progress=on_progress
        )
    return fit_transient_parameters(
        known,
        values,
        trials,
        _unknowns(known, values, fit, transient=True),
        start=named_numbers("start", start),
        free=initial,
        second=second,
        on_progress=on_progress,
    )


def labelled_recordings(
    problem: Problem,
    recording: Recording | str | Path | Sequence[Recording | str | Path],
    t_start: float | None,
    t_end: float | None,
    on_progress: Progress,
) -> list[tuple[str, Recording]]:
    """Return recordings with their labels: the names of their files, or their numbers.

    Args:
        problem: The problem.
        recording: The recording or its file, or several.
        t_start: First time that counts [s].
        t_end: Last time that counts [s].
        on_progress: Called with the stage.

    Raises:
        InputError: If recordings are missing.
    """
    from zeno_orbits.experiment import Recording

    is_one = isinstance(recording, Recording | str | Path)
    several = [recording] if is_one else [*recording]
    if not several:
        raise InputError("Argument `recording` must hold a recording, but it is empty.")
    return [
        (
            Path(one).name if isinstance(one, str | Path) else f"trial {k}",
            recording_for(problem, one, t_start, t_end, on_progress, events=True),
        )
        for k, one in enumerate(several, start=1)
    ]


def read_second_file(
    problem: Problem, second: Recording | str | Path | None, on_progress: Progress = silent
) -> SecondFile | None:
    """Return a second file of a motion, which was read, or ``None`` without it.

    Args:
        problem: The problem.
        second: The recording or its file.
        on_progress: Called with the stage.
    """
    from zeno_orbits.experiment import SecondFile

    if second is None:
        return None
    label = Path(second).name if isinstance(second, str | Path) else "second file"
    found = recording_for(problem, second, None, None, on_progress, events=True)
    return SecondFile(label=label, recording=found)


def _require_one_trial(trials: Sequence[tuple[str, Recording]], second: SecondFile | None) -> None:
    if second is not None and len(trials) > 1:
        wanted = f"belongs to a single trial, but {len(trials)} recordings are given"
        raise InputError(f"Argument `second_file` {wanted}: omit one of both.")
    if second is not None and any(one == second.recording for _, one in trials):
        wanted = "holds the first recording again: give the file of another instrument"
        raise InputError(f"Argument `second_file` {wanted}.")


def _are_transients(
    problem: Problem,
    trials: Sequence[tuple[str, Recording]],
    transient: bool | None,
    start: Numbers | None,
    initial: Sequence[str],
    second: SecondFile | None,
) -> bool:
    """Return True if transients are to be fitted.

    Raises:
        InputError: If a settled orbit is asked for, and an argument belongs to transients.
    """
    from zeno_orbits.experiment import measurable, transient_reason

    _require_one_trial(trials, second)
    asked = "start" if start else "initial" if initial else "recording" if len(trials) > 1 else ""
    if transient is False and asked:
        wanted = "needs transients: omit `transient`, or set it to True"
        raise InputError(f"Argument `{asked}` {wanted}.")
    if transient is not None or asked:
        return transient is None or transient
    return bool(transient_reason([one for _, one in trials], measurable(problem)))


@front_door
def compare_transient(
    problem: Named,
    recording: Recording | str | Path | Sequence[Recording | str | Path],
    *,
    fit: Sequence[str] = (),
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    initial: Sequence[str] = (),
    second_file: Recording | str | Path | None = None,
    t_start: float | None = None,
    t_end: float | None = None,
    on_progress: Progress = silent,
) -> TransientComparison:
    """Return transients compared with the motion of a problem, impact by impact.

    The fit has the initial values and the named instrument errors only. The result tests
    whether the residuals have structure.

    Args:
        problem: The problem, its name or its file.
        recording: The recording or its file, or several trials.
        fit: Errors of instruments to determine: ``CHANNEL.gain``, ``CHANNEL.offset`` and
            ``clock_rate``.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        start: Known initial values, as for `identify`.
        initial: Further initial values to determine, as for `identify`.
        second_file: A second file of the same transient on another clock, as for `identify`.
        t_start: First time of the recordings that counts [s].
        t_end: Last time of the recordings that counts [s].
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If a name is unknown, or a recording holds no signal or event of the problem.
        UnfittableError: If no simulated motion follows the recordings.
    """
    from zeno_orbits.experiment import compare_transients

    known = known_problem(problem)
    values = known.values(gains=gains, parameters=parameters)
    trials = labelled_recordings(known, recording, t_start, t_end, on_progress)
    other = read_second_file(known, second_file, on_progress)
    _require_one_trial(trials, other)
    return compare_transients(
        known,
        values,
        trials,
        _instrument_errors(known, values, fit),
        start=named_numbers("start", start),
        free=initial,
        second=other,
        on_progress=on_progress,
    )


@front_door
def simulate_rig(
    problem: Named,
    rig: Rig | None = None,
    *,
    until: float | None = None,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    seed: int = 0,
    settings: RigSettings | None = None,
    on_progress: Progress = silent,
) -> RigRun:
    """Return a run of the simulated test rig of a problem.

    Args:
        problem: The problem, its name or its file.
        rig: The parts of the machine. The default is the rig that the problem declares.
        until: End time [s]. The default is ten characteristic times of the problem.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        start: State name to initial value, 0 for the others. The default is the problem's first
            start.
        seed: Random seed of the sensor noise.
        settings: Accuracy. The default follows the parts of the machine.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If a name is unknown, or the rig does not fit the problem.
        SimulationError: If the simulation of the machine cannot be continued.
    """
    from zeno_orbits.experiment import default_rig
    from zeno_orbits.experiment import run_rig as simulated

    known = known_problem(problem)
    values = known.values(gains=gains, parameters=parameters)
    parts = rig or default_rig(known, values=values)
    end = rig_duration(known, values) if until is None else until
    return simulated(
        known,
        values,
        parts,
        known.initial_state(start, values),
        end,
        seed=whole("seed", seed),
        settings=settings or rig_settings(parts),
        on_progress=on_progress,
    )


def rig_duration(problem: Problem, values: ParameterValues) -> float:
    """Return the default duration of a run without an orbit [s].

    Args:
        problem: The problem.
        values: Gains and parameters.
    """
    from zeno_orbits.experiment import time_scale_of

    return RIG_TIME * time_scale_of(problem, values)


@front_door
def simulate_experiment(
    orbit: Orbit | str | Path,
    *,
    problem: Named | None = None,
    rig: Rig | None = None,
    cycles: int = 3,
    settle: int | None = None,
    seed: int = 0,
    settings: RigSettings | None = None,
    on_progress: Progress = silent,
) -> SettledRig:
    """Return cycles of the simulated test rig near an orbit, after its transient.

    Args:
        orbit: The orbit, or its file. The machine has its gains and parameters.
        problem: The orbit's problem. The default is the bundled problem of its name.
        rig: The parts of the machine. The default is the rig that the problem declares.
        cycles: Number of cycles to return.
        settle: Number of cycles before them. The default follows the Floquet multipliers.
        seed: Random seed of the sensor noise.
        settings: Accuracy.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If the rig does not fit the problem, or `cycles` is below 1.
        SimulationError: If the machine does not move in cycles like the orbit's.
    """
    from zeno_orbits.experiment import settle_rig

    orbit = as_orbit(orbit, problem)
    return settle_rig(
        orbit,
        problem_of(orbit, problem),
        rig,
        cycles=cycles,
        settle=settle,
        seed=whole("seed", seed),
        settings=settings,
        on_progress=on_progress,
    )


@front_door
def simulate_periods(
    orbit: Orbit | str | Path,
    *,
    problem: Named | None = None,
    rig: Rig | None = None,
    periods: int = 3,
    settle: int | None = None,
    seed: int = 0,
    settings: RigSettings | None = None,
    on_progress: Progress = silent,
) -> RigRun:
    """Return periods of the simulated test rig near an orbit, after its transient.

    Args:
        orbit: The orbit, or its file. The rig has its gains and parameters.
        problem: The orbit's problem. The default is the bundled problem of its name.
        rig: The parts of the machine. The default is the rig that the problem declares.
        periods: Number of periods to return.
        settle: Number of periods before them. The default follows the Floquet multipliers.
        seed: Random seed of the sensor noise.
        settings: Accuracy and records.
        on_progress: Called with the stage and the part of it that is done.

    Returns:
        The run, with times since the start of the first period.

    Raises:
        InputError: If the rig does not fit the problem, or `periods` is below 1.
        SimulationError: If the simulation of the machine cannot be continued.
    """
    from zeno_orbits.experiment import periods_near

    found = any_orbit(orbit)
    return periods_near(
        found,
        problem_of(found, problem),
        rig,
        periods=periods,
        settle=settle,
        seed=whole("seed", seed),
        settings=settings,
        on_progress=on_progress,
    )


def compare_rig(orbit: Orbit, problem: Problem, settled: SettledRig) -> RigComparison:
    """Return the cycles of a machine compared with an orbit.

    Args:
        orbit: The orbit.
        problem: Its problem.
        settled: The machine after its transient.
    """
    from zeno_orbits.experiment import compare_cycles

    return compare_cycles(orbit, problem, settled)


def machine_of(
    problem: Problem,
    *,
    orbit: Orbit | None = None,
    values: ParameterValues | None = None,
    numbers: Numbers | None = None,
    only: Sequence[str] | None = None,
    without: Sequence[str] = (),
    exact: bool = False,
) -> Rig:
    """Return the rig of a problem with some parts and values changed.

    Args:
        problem: The problem.
        orbit: The orbit whose impacts load the stop, if the problem declares no rig.
        values: Gains and parameters, if `orbit` is None.
        numbers: ``PART.NAME`` to value.
        only: Parts to keep in addition to the contact.
        without: Parts to leave out.
        exact: True simulates each switching edge of the H-bridge.

    Raises:
        InputError: If a part or a name is unknown, or the parts do not fit each other.
    """
    from zeno_orbits.experiment import default_rig
    from zeno_orbits.model import PART_NAMES, PwmSettings, rig_with_numbers, without_parts

    left_out = list(without)
    if only is not None:
        if "sensors" in only and "controller" not in only:
            wanted = "must name the controller with the sensors, which it reads"
            raise InputError(f"Argument `only` {wanted}.")
        left_out += [name for name in PART_NAMES if name not in only]
    whole = default_rig(problem, orbit=orbit, values=values)
    rig = rig_with_numbers(without_parts(whole, left_out), numbers or {})
    if not exact:
        return rig
    if rig.bridge is None:
        raise InputError("Argument `exact` needs a bridge, which the machine lacks.")
    return replace(rig, bridge=replace(rig.bridge, switching=PwmSettings.EXACT))


def rig_settings(rig: Rig) -> RigSettings:
    """Return an accuracy that the noise and rounding of the sensors justify.

    Args:
        rig: The parts of the machine.
    """
    from zeno_orbits.experiment import RigSettings
    from zeno_orbits.integrators import Tolerance

    if rig.controller is None:
        return RigSettings()
    return RigSettings(tolerance=Tolerance(relative=1e-8, absolute=1e-10))


@front_door
def rig_recording(
    run: RigRun, problem: Named | None = None, *, noise: float = 0.0, seed: int = 0
) -> Recording:
    """Return the measured signals of a run as a recording, with a contact channel of every stop.

    Args:
        run: The run. Without a controller its samples are `RigSettings.spacing` apart.
        problem: Its problem. The default is the bundled problem of its name.
        noise: Noise on all signals but the contact channels, relative to the range of each. The
            sensors of a controller have their own noise.
        seed: Random seed of the noise.

    Raises:
        InputError: If noise is added to the readings of a controller, or is negative.
    """
    from zeno_orbits.experiment import recording_of

    given = None if problem is None else known_problem(problem)
    known = recorded_problem(run.problem, given, result="run")
    return recording_of(run, known, {"seed": str(seed)}, noise=noise, seed=whole("seed", seed))


def rig_sampling(rig: Rig, rate: float | None, until: float, *, noise: float = 0.0) -> RigSettings:
    """Return the settings of a run whose samples are taken at a rate.

    Args:
        rig: The parts of the machine.
        rate: Samples per second [Hz], or ``None`` for the default.
        until: End of the run [s].
        noise: Noise of the recording.

    Raises:
        InputError: If the machine has a controller, which has its own rate and noise, or the rate
            gives no useful number of samples.
    """
    from zeno_orbits.experiment import Sampling, require_noise

    require_noise(noise, rig)
    settings = rig_settings(rig)
    if rate is None:
        return settings
    if rig.controller is not None:
        wanted = "must be left out of a machine with a controller"
        raise InputError(f"Argument `rate` {wanted}: --part controller.period.")
    Sampling(rate=rate).count(until)
    return replace(settings, spacing=1.0 / rate)


def rig_warnings(run: RigRun, problem: Problem) -> tuple[str, ...]:
    """Return warnings about deep penetrations of the stop and contacts that samples may miss.

    The gap of a single stop shows contacts that its channel misses.

    Args:
        run: The run.
        problem: Its problem.
    """
    from zeno_orbits.experiment import penetration_warnings, sampling_warnings

    missed = sampling_warnings(run) if problem.has_graph else ()
    return (*penetration_warnings(run, problem), *missed)


def counterpart_for(
    orbit: Orbit,
    problem: Problem,
    *,
    recording: str | Path | None = None,
    periods: int,
    on_progress: Progress = silent,
) -> MatchedRun:
    """Return another motion to draw with an orbit: a recording, or the simulated test rig.

    Args:
        orbit: The orbit.
        problem: Its problem.
        recording: The file of a recording. The default is the simulated test rig.
        periods: Number of periods to show.
        on_progress: Called with the stage and the part of it that is done.
    """
    from zeno_orbits.experiment import recording_counterpart, rig_counterpart

    if recording is None:
        return rig_counterpart(orbit, problem, periods, on_progress=on_progress)
    return recording_counterpart(recording_for(problem, recording), orbit, problem, periods)


def recording_for(
    problem: Problem,
    recording: Recording | str | Path,
    t_start: float | None = None,
    t_end: float | None = None,
    on_progress: Progress = silent,
    *,
    events: bool = False,
) -> Recording:
    """Return the part of a recording that counts, with the signals of a problem.

    Args:
        problem: The problem.
        recording: The recording, or its file.
        t_start: First time [s].
        t_end: Last time [s].
        on_progress: Called with the stage.
        events: Whether columns of event times count, which may stand alone in a file.

    Raises:
        DataFileError: If the file is not a recording.
        InputError: If fewer than two rows are left.
    """
    from zeno_orbits.experiment import (
        CONTACT,
        EVENT_FAMILIES,
        measurable,
        read_event_file,
        read_recording,
    )

    if isinstance(recording, str | Path):
        on_progress("reading the recording", None)
        known = measurable(problem)
        families = (CONTACT, *EVENT_FAMILIES) if events else (CONTACT,)
        alone = read_event_file(recording) if events else None
        recording = alone or read_recording(recording, only=known, families=families, units=known)
    return crop(recording, t_start, t_end)


_DECADE, _THRICE = 10.0, 3.0
_LEAST_RESTITUTION, _MOST_RESTITUTION = 0.02, 0.98
"""Range of a restitution by default in a fit of transients, in which impacts accumulate in time."""


def _instrument_errors(
    problem: Problem, values: ParameterValues, fit: Sequence[str]
) -> tuple[FitParameter, ...]:
    """Return the errors of instruments that a comparison determines.

    Raises:
        InputError: If a name is not the name of such an error.
    """
    found = _unknowns(problem, values, fit, transient=True)
    for one in found:
        if len(one.readings) != 1 or len(one.names) != 1:
            wanted = "must name CHANNEL.gain, CHANNEL.offset or clock_rate"
            told = f"Argument `fit` {wanted}, but it has `{one.label}`"
            raise InputError(f"{told}: `identify` fits parameters.")
    return found


def _unknowns(
    problem: Problem, values: ParameterValues, fit: Fit, *, transient: bool = False
) -> tuple[FitParameter, ...]:
    """Return the parameters to estimate, in ranges that the problem allows.

    Args:
        problem: The problem.
        values: Parameter values at the start.
        fit: Parameters to estimate.
        transient: Whether the narrower default ranges of transients apply.
    """
    from zeno_orbits.experiment import FitParameter, default_range

    # A sequence may name a parameter twice, which the fit refuses.
    asked: list[tuple[Any, tuple[float, float] | None]]
    asked = [*fit.items()] if isinstance(fit, Mapping) else [(label, None) for label in fit]
    known = {quantity.name: quantity for quantity in problem.parameters}
    found: list[FitParameter] = []
    for label, box in asked:
        if not isinstance(label, str):
            wanted = "must name parameters by texts"
            raise InputError(f"Argument `fit` {wanted}, but it has {shown(label)}.")
        names = tuple(label.split("+"))
        lower, upper = -math.inf, math.inf
        for name in names:
            if name in known:
                lower, upper = max(lower, known[name].lower), min(upper, known[name].upper)
        around = None if names[0] in known else default_range(names[0])
        if around is None:
            value = values.parameters.get(names[0], 0.0)
            factor = _THRICE if transient else _DECADE
            around = sorted((value / factor, value * factor)) if value else (-1.0, 1.0)
            if transient and names[0] == "restitution":
                around = (_LEAST_RESTITUTION, _MOST_RESTITUTION)
        low, high = max(lower, around[0]), min(upper, around[1])
        if box is not None:
            low, high = number_range("fit", box)
            if low < lower or high > upper:
                inside = f"[{lower:g}, {upper:g}]".replace("inf]", "inf)").replace("[-inf", "(-inf")
                wanted = f"must have a range inside {inside} for `{label}`"
                raise InputError(f"Argument `fit` {wanted}, but it is {low:g}:{high:g}.")
        found.append(FitParameter(names=names, lower=max(low, lower), upper=min(high, upper)))
    return tuple(found)
