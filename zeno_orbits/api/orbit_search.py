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
    near: Orbit | str | Path | None = None,
    start: Numbers | None = None,
    section: str | None = None,
    shape: EventSequence | None = None,
    until: float | None = None,
    method: SearchMethod | None = None,
    settings: SearchSettings | None = None,
    allow_unstable: bool = False,
    on_progress: Progress = silent,
) -> SearchResult:
    """Find the orbit at given values, and verify it.

    Args:
        problem: The problem, its name or its file.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        near: As for `search_gains`.
        start: As for `search_gains`.
        section: As for `search_gains`.
        shape: As for `search_gains`.
        until: As for `search_gains`.
        method: The default is `SearchMethod.SHOOTING`: a simulation closes the orbit. The other
            methods also compare it with a nonlinear program, which takes longer.
        settings: Limits and tolerances of the search.
        allow_unstable: Accept an unstable orbit. The default rejects it, like the command.
        on_progress: Called with the stage and the part of it that is done.

    Returns:
        The result of the search. ``.unwrap()`` returns the verified orbit with its certificate and
        Floquet multipliers, or raises `OrbitNotFoundError`.

    Raises:
        InputError: If a name is unknown, a value is out of range, or the section does not occur.
    """
    from zeno_orbits.search import SearchMethod as Method
    from zeno_orbits.search import SearchSettings as Settings

    return search_gains(
        problem,
        vary={},
        gains=gains,
        parameters=parameters,
        near=near,
        start=start,
        section=section,
        shape=shape,
        until=until,
        method=method or Method.SHOOTING,
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
    section: str | None = None,
    shape: EventSequence | None = None,
    until: float | None = None,
    method: SearchMethod | None = None,
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
        start: State name to initial value of the simulations that lead to orbits. The default is
            each of the problem's starts.
        objective: The objective. The default is the orbit with values nearest to their initial
            values.
        bounds: Bounds on signals, on the period, the energy, the spectral radius and margins, and
            on quantities of events, such as ``closed.impact_speed``. With uncertain parameters they
            hold at every corner.
        near: A known orbit to start from, or its file. Its gains and parameters replace the
            defaults, and no motion has to settle.
        section: Name of the event at which the period starts and ends, such as ``zeno knee`` or
            ``switch heel strike``. The default is chosen by the program.
        shape: Mode sequence of the orbit of a machine with the stop `stop`. The default is the
            sequence that a simulation reaches.
        until: Longest time to settle [s]. The default is 400 of the problem's slowest oscillations,
            or longer for a motion whose returns converge.
        method: How the optimum is found. The default is `SearchMethod.AUTO`: a nonlinear program
            whose optimum shooting checks, or shooting.
        settings: Limits and tolerances of the search.
        allow_unstable: Accept unstable orbits.
        accuracy: Largest relative error of the orbit. The settings follow it.
        engine: Name of the integrator of the verification. The default chooses automatically.
        workers: Number of processes that try starts. Several processes need the name or the file
            of the problem. The result is independent of their number.
        plan: Executor of the work and folder of finished starts. It overrides ``workers``.
        on_progress: Called with the stage and the part of it that is done.

    Returns:
        The result of the search. ``.unwrap()`` returns the best verified orbit, or raises
        `OrbitNotFoundError` with the reason of the failure.

    Raises:
        InputError: If a name is unknown, a value is out of range, the lower end of a range lies
            above its upper end, or the objective needs another machine.
        WorkError: If the workers cannot finish.
    """
    from zeno_orbits.search import SearchMethod as Method
    from zeno_orbits.search import SearchSettings as Settings
    from zeno_orbits.search import TransientSettings, search

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
    settings = settings or Settings()
    if accuracy is not None:
        settings = settings.for_accuracy(accuracy)
    if until is not None:
        settings = replace(settings, settling=TransientSettings(horizon=until))
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
        section=section,
        shape=shape,
        method=method or Method.AUTO,
        initial_states=() if start is None else (named_numbers("start", start),),
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
            radius, error = certificate.spectral_radius, certificate.multiplier_error
            objection = (
                f"The orbit is not stable: its spectral radius is {radius:.4g}."
                if certificate.unstable
                else f"The stability of the orbit is unknown: its spectral radius is {radius:.4g} "
                f"+- {error:.1g}."
            )
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
