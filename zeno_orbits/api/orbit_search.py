"""Searches for orbits, each verified before it is accepted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits.api.inputs import (
    Named,
    Numbers,
    any_orbit,
    file_of,
    front_door,
    plan_of,
    repeating_problem,
    whole,
)
from zeno_orbits.api.settings import verification_settings
from zeno_orbits.errors import InputError, named_numbers, number_range
from zeno_orbits.model import ParameterValues, Problem, ProblemFile
from zeno_orbits.orbits import Orbit
from zeno_orbits.work import ExecutionPlan, Progress, silent

if TYPE_CHECKING:
    from zeno_orbits.orbits import Bound, EventSequence
    from zeno_orbits.search import (
        Candidate,
        Objective,
        SearchMethod,
        SearchResult,
        SearchSettings,
        ShootingResult,
    )
    from zeno_orbits.simulation import SimulationSettings
    from zeno_orbits.verification import VerificationSettings


@front_door
def find_orbit(
    problem: Named,
    *,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    shape: EventSequence | None = None,
    settings: SearchSettings | None = None,
    allow_unstable: bool = False,
    on_progress: Progress = silent,
) -> SearchResult:
    """Find the orbit at given values, and verify it.

    Args:
        problem: The problem, its name or its file.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        start: State name to initial value of the simulation that leads to the orbit. The default is
            each of the problem's starts.
        shape: Mode sequence of the orbit. The default is the sequence that a simulation reaches.
        settings: Limits and tolerances of the search.
        allow_unstable: Accept an unstable orbit. The default rejects it, like the command.
        on_progress: Called with the stage and the part of it that is done.

    Returns:
        The result of the search. ``.unwrap()`` returns the verified orbit with its certificate and
        Floquet multipliers, or raises `OrbitNotFoundError`.

    Raises:
        InputError: If a name is unknown or a value is out of range.
    """
    from zeno_orbits.search import SearchSettings as Settings

    return search_gains(
        problem,
        vary={},
        gains=gains,
        parameters=parameters,
        start=start,
        shape=shape,
        settings=replace(settings or Settings(), n_starts=0),
        allow_unstable=allow_unstable,
        on_progress=on_progress,
    )


@front_door
def search_gains(
    problem: Named,
    *,
    vary: Mapping[str, tuple[float, float]] | None = None,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    objective: Objective | None = None,
    bounds: Sequence[Bound] = (),
    near: Orbit | str | Path | None = None,
    shape: EventSequence | None = None,
    settings: SearchSettings | None = None,
    allow_unstable: bool = False,
    accuracy: float | None = None,
    engine: str | None = None,
    workers: int = 1,
    plan: ExecutionPlan | None = None,
    on_progress: Progress = silent,
) -> SearchResult:
    """Find gains, parameters and initial states of an orbit, and verify it.

    Args:
        problem: The problem, its name or its file.
        vary: Name to range of the gains and parameters to search. The default is every gain that
            ``gains`` does not fix, in the range that the problem declares.
        gains: Gains that differ from their defaults: the initial value of a free gain, the value of
            a fixed gain.
        parameters: Parameters that differ from their defaults, free or fixed in the same way.
        start: State name to initial value of the simulations that lead to orbits.
        objective: The objective. The default is the orbit with values nearest to their initial
            values.
        bounds: Bounds that the orbit must satisfy.
        near: A known orbit to start from, or its file.
        shape: Mode sequence of the orbit of a machine with the stop `stop`. The default is the
            sequence that a simulation reaches.
        settings: Limits and tolerances of the search.
        allow_unstable: Accept unstable orbits.
        accuracy: Largest relative error of the orbit. The settings follow it.
        engine: Name of the integrator of the verification. The default chooses automatically.
        workers: Number of processes that try starts. Several processes need the name or the file
            of the problem. The result is independent of their number.
        plan: Executor of the work and folder of finished starts. It overrides ``workers``.
        on_progress: Called with the stage and the part of it that is done.

    Returns:
        The verified orbits, the best first, or the reason of the failure.

    Raises:
        InputError: If a name is unknown, a value is out of range, or the lower end of a range lies
            above its upper end.
        WorkError: If the workers cannot finish.
    """
    from zeno_orbits.search import SearchSettings as Settings
    from zeno_orbits.search import search

    known = repeating_problem(problem)
    orbit = None if near is None else _near(near, known)
    shared = plan_of(workers, plan)
    spread = None
    if shared is not None:
        spread = search.StartWorkers(problem_file=file_of(problem), plan=shared, tell=on_progress)
    judge = Verified(
        problem=known if shared is None else file_of(problem),
        settings=verification_settings(accuracy=accuracy, engine=engine),
        allow_unstable=allow_unstable,
        accuracy=accuracy,
    )
    if accuracy is not None:
        settings = (settings or Settings()).for_accuracy(accuracy)
    values = start_values(known, near=orbit, gains=gains, parameters=parameters)
    result = search.search_orbits(
        known,
        values,
        free=_boxes(known, gains, vary),
        objective=objective,
        bounds=bounds,
        near=orbit,
        settings=settings,
        accept=judge,
        on_progress=on_progress,
        spread=spread,
        shape=shape,
        initial_states=() if start is None else (named_numbers("start", start),),
    )
    return _with_certificates(result, bounds)


@front_door
def find_event_orbit(
    problem: Named,
    *,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    near: Orbit | str | Path | None = None,
    start: Numbers | None = None,
    section: str | None = None,
    shape: EventSequence | None = None,
    until: float | None = None,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> Orbit:
    """Find the orbit to which a machine settles, and verify it.

    It is `find_orbit_by_shooting` and `verify` in one call.

    Args:
        problem: The problem, its name or its file.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        near: As for `find_orbit_by_shooting`.
        start: As for `find_orbit_by_shooting`.
        section: As for `find_orbit_by_shooting`.
        shape: As for `find_orbit_by_shooting`.
        until: As for `find_orbit_by_shooting`.
        settings: Integrator and accuracy.
        on_progress: Called with the stage and the part of it that is done.

    Returns:
        The orbit with its certificate and multipliers. `certificate["passed"]` is the verdict.

    Raises:
        InputError: If a name is unknown, a value is out of range, or the drive is a corrected one.
        SimulationError: If no motion settles to an orbit.
    """
    from zeno_orbits.search import settled_event_orbit as find
    from zeno_orbits.verification import verify, with_certificate

    known = repeating_problem(problem)
    begin = None if near is None else _near(near, known)
    orbit = find(
        known,
        start_values(known, near=begin, gains=gains, parameters=parameters),
        near=begin,
        start=start,
        section=section,
        shape=shape,
        until=until,
        simulation=settings,
        on_progress=on_progress,
    )
    return with_certificate(orbit, verify(orbit, known, on_progress=on_progress))


@front_door
def search_event_gains(
    problem: Named,
    *,
    vary: Mapping[str, tuple[float, float]] | None = None,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    near: Orbit | str | Path | None = None,
    objective: Objective | None = None,
    bounds: Sequence[Bound] = (),
    section: str | None = None,
    shape: EventSequence | None = None,
    until: float | None = None,
    n_starts: int = 12,
    seed: int = 0,
    candidates: int = 1,
    method: SearchMethod | None = None,
    allow_unstable: bool = False,
    settings: SimulationSettings | None = None,
    workers: int = 1,
    plan: ExecutionPlan | None = None,
    on_progress: Progress = silent,
) -> SearchResult:
    """Find gains of an orbit of events, and verify the orbit.

    It searches from one start, unless several orbits are requested, and also chooses the section
    and the method. The stop of a machine with one stop is named `stop`.

    Args:
        problem: The problem, its name or its file.
        vary: Name to range of the gains and parameters to search. The default is every gain that
            ``gains`` does not fix, in the range that the problem declares.
        gains: Gains that differ from their defaults: the initial value of a free gain, the value of
            a fixed gain.
        parameters: Parameters that differ from their defaults, free or fixed in the same way.
        start: State name to initial value of the simulation. The default is each of the problem's
            starts.
        near: A known orbit of events to start from, or its file. Its gains and parameters replace
            the defaults, and no motion has to settle.
        objective: `NearestGains` (the default), `TargetPeriod`, `TargetAmplitude`, `MinEnergy`,
            `MinPeak`, `MinSpectralRadius`, `MaxMargin`, `MaxPush`, `MinImpactLoss` or
            `MinBounceTime`.
        bounds: Bounds on signals, on the period, the energy, the spectral radius and margins, and
            on quantities of events, such as ``closed.impact_speed``. With uncertain parameters they
            hold at every corner.
        section: Name of the event at which the period starts and ends. The default is chosen by the
            program.
        shape: Mode sequence of the orbit of a machine with the stop `stop`. The default is the
            sequence that a simulation reaches.
        until: Longest time to settle [s].
        n_starts: Number of further starts in the ranges, if no motion settles at the first, or if
            several orbits are searched.
        seed: Seed of these starts, and of initial states.
        candidates: Number of different verified orbits to find and rank. If it is larger than 1,
            all starts count, and motions also start from initial states around the best orbit.
        method: How the optimum is found. The default is `SearchMethod.AUTO`: a nonlinear program
            whose optimum shooting checks, or shooting.
        allow_unstable: Rank unstable orbits, too.
        settings: Integrator and accuracy.
        workers: Number of processes that try starts. Several processes need the name or the file
            of the problem. The result is independent of their number.
        plan: Executor of the work and folder of finished starts. It overrides ``workers``.
        on_progress: Called with the stage and the part of it that is done.

    Returns:
        The orbit with its certificate and the values of the objective, or the reason why there is
        none: no orbit keeps the bounds, or an impact vanishes at the optimum.

    Raises:
        InputError: If a name is unknown, a value is out of range, or the objective needs another
            machine.
        SimulationError: If no motion settles to an orbit.
        WorkError: If the workers cannot finish.
    """
    from zeno_orbits.search import SearchMethod as Method
    from zeno_orbits.search import StartWorkers
    from zeno_orbits.search import search_event_orbits as search

    if candidates < 1:
        raise InputError(f"Argument `candidates` must be at least 1, but it is {candidates}.")
    known = repeating_problem(problem)
    begin = None if near is None else _near(near, known)
    shared = plan_of(workers, plan)
    spread = None
    if shared is not None:
        spread = StartWorkers(problem_file=file_of(problem), plan=shared, tell=on_progress)
    result = search(
        known,
        start_values(known, near=begin, gains=gains, parameters=parameters),
        near=begin,
        free=_boxes(known, gains, vary),
        objective=objective,
        bounds=bounds,
        start=start,
        section=section,
        shape=shape,
        until=until,
        n_starts=n_starts,
        seed=whole("seed", seed),
        candidates=candidates,
        method=method or Method.AUTO,
        accept=Verified(
            problem=known if shared is None else file_of(problem), allow_unstable=allow_unstable
        ),
        simulation=settings,
        on_progress=on_progress,
        spread=spread,
    )
    return _with_certificates(result, bounds)


@front_door
def find_orbit_by_shooting(
    problem: Named,
    *,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    near: Orbit | str | Path | None = None,
    start: Numbers | None = None,
    section: str | None = None,
    shape: EventSequence | None = None,
    until: float | None = None,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> ShootingResult:
    """Return the orbit to which a machine settles: faster than `find_orbit`, but not verified.

    Args:
        problem: The problem, its name or its file.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        near: A known orbit to start from, or its file. Its gains and parameters replace the
            defaults, and no motion has to settle.
        start: State name to initial value of the simulation. The default is each of the problem's
            starts.
        section: Name of the event at which the period starts and ends, such as ``zeno knee`` or
            ``switch heel strike``. The default is chosen by the program.
        shape: Mode sequence of the orbit of a machine with the stop `stop`. The default is the
            sequence that the simulation reaches.
        until: Longest time to settle [s].
        settings: Integrator and accuracy.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If a name is unknown, a value is out of range, or the section does not occur.
    """
    from zeno_orbits.search import orbit_by_shooting

    known = repeating_problem(problem)
    begin = None if near is None else _near(near, known)
    return orbit_by_shooting(
        known,
        start_values(known, near=begin, gains=gains, parameters=parameters),
        near=begin,
        start=start,
        section=section,
        shape=shape,
        until=until,
        simulation=settings,
        on_progress=on_progress,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Verified:
    """Acceptance test of a search: an independent verification whose certificate is kept.

    Attributes:
        problem: The problem, or the file from which a worker loads it.
        settings: Settings of the verification.
        allow_unstable: True accepts unstable orbits.
        accuracy: Largest relative error of the orbit, if it was requested.
    """

    problem: Problem | ProblemFile
    settings: VerificationSettings | None = None
    allow_unstable: bool = False
    accuracy: float | None = None

    def __call__(self, orbit: Orbit) -> Any:
        """Return the certificate of an orbit and the reason against accepting it, if any."""
        from zeno_orbits.search import Verdict
        from zeno_orbits.verification import verifier

        known = self.problem if isinstance(self.problem, Problem) else self.problem.load()
        certificate = verifier.verify(orbit, known, settings=self.settings)
        objection = ""
        if not certificate.passed:
            objection = certificate.verdict()
        elif not (certificate.stable or self.allow_unstable):
            radius = certificate.spectral_radius
            objection = f"The orbit is not stable: its spectral radius is {radius:.4g}."
        elif self.accuracy is not None and not certificate.orbit_error <= self.accuracy:
            objection = f"Its numbers are certain to {certificate.orbit_error:.1e} only."
        return Verdict(objection=objection, certificate=certificate)


def start_values(
    problem: Problem,
    *,
    near: Orbit | None = None,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
) -> ParameterValues:
    """Return the values from which a search starts.

    Args:
        problem: The problem.
        near: A known orbit. Its gains and parameters replace the defaults.
        gains: Gains that differ from these values.
        parameters: Parameters that differ from these values.

    Raises:
        InputError: If a name is unknown or a value is out of range.
    """
    if near is None:
        return problem.values(gains=gains, parameters=parameters)
    return problem.values(
        gains={**near.gains, **named_numbers("gains", gains)},
        parameters={**near.parameters, **named_numbers("parameters", parameters)},
    )


def _near(near: Orbit | str | Path, problem: Problem) -> Orbit:
    """Return the known orbit of a search.

    Raises:
        InputError: If the orbit belongs to another problem.
    """
    return _of_problem(any_orbit(near), problem)


def _of_problem(orbit: Orbit, problem: Problem) -> Orbit:
    """Refuse an orbit of another problem, and return the orbit."""
    if orbit.problem != problem.name:
        message = f"must be an orbit of `{problem.name}`, but it is of `{orbit.problem}`"
        raise InputError(f"Argument `near` {message}.")
    return orbit


def _with_certificates(result: SearchResult, bounds: Sequence[Bound]) -> SearchResult:
    """Return the result with the certificate, bounds and multipliers stored in each orbit."""
    from zeno_orbits.orbits import asked_and_reached
    from zeno_orbits.verification import with_certificate

    def checked(one: Candidate) -> Candidate:
        if one.certificate is None:
            return one
        certificate = replace(one.certificate, asked=tuple(asked_and_reached(bounds, one.extents)))
        return replace(one, orbit=with_certificate(one.orbit, certificate), certificate=certificate)

    candidates = tuple(map(checked, result.candidates))
    if result.orbit is None or result.certificate is None:
        return replace(result, candidates=candidates)
    certificate = replace(result.certificate, asked=result.asked)
    orbit = with_certificate(result.orbit, certificate)
    return replace(result, orbit=orbit, certificate=certificate, candidates=candidates)


def _boxes(
    problem: Problem, gains: Numbers | None, free: Mapping[str, tuple[float, float]] | None
) -> Mapping[str, tuple[float, float]]:
    """Return the ranges of a search, by default the ranges of all gains that are not fixed."""
    from zeno_orbits.search import free_gains

    if free is None:
        return free_gains(problem, fixed=gains or {})
    return {name: number_range("vary", box) for name, box in named_numbers("vary", free).items()}
