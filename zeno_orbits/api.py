"""The functions of the front door: from a problem, or an orbit, to a result, in one call each.

A problem is given as an object, by the name of a bundled one, or by the path of its file. Numbers
that are not given are the problem's own. Functions of an orbit find its problem by its name;
``problem=`` overrides. Work of more than a second shows its progress in terminals and notebooks;
``on_progress=`` takes it elsewhere. The rooms offer the same steps with everything adjustable.

Offers: the functions below; `zeno_orbits` exports them.
Imports: every room but ``cli``.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import wraps
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from zeno_orbits.errors import InputError
from zeno_orbits.model import (
    Problem,
    ProblemFile,
    bundled_problems,
    load_problem,
    locate_problem,
    split_fidelity,
)
from zeno_orbits.orbits import ZenoOrbit, read_orbit
from zeno_orbits.work import Progress, silent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from zeno_orbits.continuation import Continuation, ContinuationSettings, Crew
    from zeno_orbits.maps import ParameterMap
    from zeno_orbits.orbits import Bound, Multipliers, OrbitShape
    from zeno_orbits.proof import Proof
    from zeno_orbits.search import Closing, Objective, SearchResult, SearchSettings
    from zeno_orbits.simulation import Execution, SimulationSettings
    from zeno_orbits.verification import OrbitCertificate, VerificationSettings

Named = str | Path | Problem
"""A problem, the name of a bundled one, or the path of its file."""

Numbers = Mapping[str, float]
"""Name to value; what is not named keeps the problem's own number."""

Axis = tuple[str, float, float, int]
"""Name of a gain or parameter, its range, and the number of points along it."""

_P = ParamSpec("_P")
_R = TypeVar("_R")


def _shows_progress(work: Callable[_P, _R]) -> Callable[_P, _R]:
    """Show progress in a notebook or terminal, unless the caller takes it elsewhere."""

    @wraps(work)
    def shown(*args: _P.args, **options: _P.kwargs) -> _R:
        from zeno_orbits.report import line_for_watcher

        line = None if "on_progress" in options else line_for_watcher()
        if line is None:
            return work(*args, **options)
        told: Any = work
        with line:
            return told(*args, **{**options, "on_progress": line})

    return shown


@_shows_progress
def simulate(
    problem: Named,
    *,
    until: float = 10.0,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> Execution:
    """Return a completed execution: through every impact, Zeno point, locked arc and release.

    Args:
        problem: The problem, its name or its file.
        until: When to stop [s].
        gains: Gains that differ from the problem's own.
        parameters: Parameters that differ from the problem's own.
        start: State name to initial value, others zero; by default the problem's first start.
        settings: Integrator and accuracy.
        on_progress: Called with what is being done and the part of it that is done.

    Raises:
        InputError: If a name is unknown, a number out of range, or the start inside the stop.
        SimulationError: If the execution cannot be continued; it says where and why.
    """
    from zeno_orbits.simulation import simulator

    known = _known(problem)
    values = known.values(gains=gains, parameters=parameters)
    state = known.state_vector(known.starts[0] if start is None else start)
    return simulator.simulate(
        known.dynamics(values), state, until=until, settings=settings, on_progress=on_progress
    )


@_shows_progress
def find_orbit(
    problem: Named,
    *,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    shape: OrbitShape | None = None,
    settings: SearchSettings | None = None,
    on_progress: Progress = silent,
) -> SearchResult:
    """Find the orbit at given numbers, and verify it.

    Args:
        problem: The problem, its name or its file.
        gains: Gains that differ from the problem's own.
        parameters: Parameters that differ from the problem's own.
        start: State name to value from which a simulation looks for the orbit; by default the
            problem's starts.
        shape: The orbit's shape; by default what a simulation settles to.
        settings: How hard to look.
        on_progress: Called with what is being done and the part of it that is done.

    Returns:
        The search's result; ``.unwrap()`` is the verified orbit with its certificate and Floquet
        multipliers, or raises `OrbitNotFoundError`. Repelling orbits are accepted.

    Raises:
        InputError: If a name is unknown or a number out of range.
    """
    from zeno_orbits.search import SearchSettings as Settings

    return search_gains(
        problem,
        free={},
        gains=gains,
        parameters=parameters,
        start=start,
        shape=shape,
        settings=replace(settings or Settings(), n_starts=0),
        allow_unstable=True,
        on_progress=on_progress,
    )


@_shows_progress
def search_gains(
    problem: Named,
    *,
    free: Mapping[str, tuple[float, float]] | None = None,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    objective: Objective | None = None,
    bounds: Sequence[Bound] = (),
    near: ZenoOrbit | str | Path | None = None,
    shape: OrbitShape | None = None,
    settings: SearchSettings | None = None,
    allow_unstable: bool = False,
    workers: int = 1,
    on_progress: Progress = silent,
) -> SearchResult:
    """Find gains, parameters and initial states of an orbit, and verify it.

    Args:
        problem: The problem, its name or its file.
        free: Name to range of the gains and parameters to be found; by default every gain that
            ``gains`` does not fix, in the problem's own range.
        gains: Gains to start from, or fixed where they are not free.
        parameters: Parameters, likewise.
        start: State name to value from which simulations look for orbits.
        objective: What is asked of the orbit; by default numbers near their start.
        bounds: What the orbit must keep.
        near: A known orbit to start from, or its file.
        shape: The orbit's shape; by default what a simulation settles to.
        settings: How hard to look.
        allow_unstable: Accept orbits that do not attract.
        workers: Processes that try starts; with several, ``problem`` is a name or a file. The
            answer does not depend on their number.
        on_progress: Called with what is being done and the part of it that is done.

    Returns:
        The verified orbits, the best first, or why there is none.

    Raises:
        InputError: If a name is unknown, a number out of range, or bounds are the wrong way round.
    """
    from zeno_orbits.search import free_gains, search
    from zeno_orbits.work import Plan, Workers

    known = _known(problem)
    spread = None
    if workers > 1:
        spread = search.StartWorkers(
            problem_file=_file_of(problem),
            plan=Plan(place=Workers(count=workers)),
            tell=on_progress,
        )
    result = search.search_gains(
        known,
        known.values(gains=gains, parameters=parameters),
        free=free_gains(known, fixed=gains or {}) if free is None else free,
        objective=objective,
        bounds=bounds,
        near=_read(near) if near is not None else None,
        settings=settings,
        accept=Verified(problem=known, allow_unstable=allow_unstable),
        on_progress=on_progress,
        spread=spread,
        shape=shape,
        initial_states=() if start is None else (dict(start),),
    )
    return _with_certificates(result)


@_shows_progress
def close_orbit(
    problem: Named,
    *,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    near: ZenoOrbit | str | Path | None = None,
    shape: OrbitShape | None = None,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> Closing:
    """Return the orbit to which a simulation settles: faster than `find_orbit`, not verified.

    Args:
        problem: The problem, its name or its file.
        gains: Gains that differ from the problem's own.
        parameters: Parameters that differ from the problem's own.
        start: State name to value where the simulation starts; by default the problem's starts.
        near: A known orbit to start from, or its file.
        shape: The orbit's shape; by default what the motion settles to.
        settings: Integrator and accuracy.
        on_progress: Called with what is being done and the part of it that is done.

    Raises:
        InputError: If a name is unknown or a number out of range.
    """
    from zeno_orbits.search import closing

    known = _known(problem)
    if start is not None:
        known = replace(known, starts=(dict(start),))
    return closing.close_orbit(
        known,
        known.values(gains=gains, parameters=parameters),
        near=_read(near) if near is not None else None,
        simulation=settings,
        on_progress=on_progress,
        shape=shape,
    )


@_shows_progress
def verify(
    orbit: ZenoOrbit | str | Path,
    *,
    problem: Named | None = None,
    settings: VerificationSettings | None = None,
    on_progress: Progress = silent,
) -> OrbitCertificate:
    """Return the certificate of an orbit: what an independent forward integration says of it.

    Args:
        orbit: The orbit, or its file; its own certificate and multipliers are ignored.
        problem: Its problem; by default the bundled one of its name.
        settings: Tolerance, number of periods and accuracy.
        on_progress: Called with what is being done and the part of it that is done.

    Raises:
        InputError: If the orbit's problem is not known, or its numbers do not fit the problem.
        OrbitFileError: If the file is not an orbit file.
    """
    from zeno_orbits.verification import verifier

    orbit = _read(orbit)
    known = problem_of(orbit, problem)
    return verifier.verify(orbit, known, settings=settings, on_progress=on_progress)


def prove(
    orbit: ZenoOrbit | str | Path,
    *,
    problem: Named | None = None,
    over: Numbers | None = None,
    radius: float | None = None,
    on_progress: Progress = silent,
) -> Proof:
    """Return a proof that an orbit exists, with its certificate, or which claim has none.

    Args:
        orbit: The orbit, or its file; its own certificate is ignored.
        problem: Its problem; by default the bundled one of its name.
        over: Gain or parameter to the radius of its interval, for all of which it is to hold.
        radius: Of the box on the section, per size of a coordinate; found by itself by default.
        on_progress: Called with what is being done and the part of it that is done.

    Raises:
        InputError: If python-flint is missing (the extra `proof`), the orbit's problem is not
            known, or a number or name does not fit the problem.
        TranslationError: If the problem's equations are not analytic.
    """
    if find_spec("flint") is None:
        raise InputError("Proofs need python-flint: run `pip install 'zeno_orbits[proof]'`.")
    from zeno_orbits.proof import ProofSettings
    from zeno_orbits.proof import prove as proved

    orbit = _read(orbit)
    known = problem_of(orbit, problem)
    settings = ProofSettings(radius=radius)
    return proved(orbit, known, over=over, settings=settings, on_progress=on_progress)


def floquet_multipliers(
    orbit: ZenoOrbit | str | Path, *, problem: Named | None = None
) -> Multipliers:
    """Return the Floquet multipliers of an orbit with their error, by exact derivatives.

    Args:
        orbit: The orbit, or its file.
        problem: Its problem; by default the bundled one of its name.

    Raises:
        InputError: If the orbit's problem is not known, or its numbers do not fit the problem.
        SimulationError: If the orbit does not return.
    """
    from zeno_orbits.verification import multipliers_of

    orbit = _read(orbit)
    return multipliers_of(orbit, problem_of(orbit, problem))


@_shows_progress
def continue_orbit(
    orbit: ZenoOrbit | str | Path,
    parameter: str,
    box: tuple[float, float],
    *,
    problem: Named | None = None,
    settings: ContinuationSettings | None = None,
    workers: int = 1,
    on_progress: Progress = silent,
) -> Continuation:
    """Return the family of an orbit in a gain or parameter, with folds, flips, branches and ends.

    Args:
        orbit: The orbit, or its file; with one Zeno point or one impact a period.
        parameter: Name of the gain or parameter; what is derived from it stays as it is.
        box: Its range, lower end first; the orbit's own number lies in it.
        problem: The orbit's problem; by default the bundled one of its name.
        settings: Accuracy and steps.
        workers: Processes that follow pieces of it; with several, ``problem`` is a name or a file.
        on_progress: Called with what is being done and the part of it that is done.

    Raises:
        InputError: If a name is unknown or the range does not fit.
        SimulationError: If the orbit does not close.
    """
    from zeno_orbits import continuation

    orbit = _read(orbit)
    if orbit.shape.n_phases != 1:
        wanted = "must have one Zeno point or one impact a period to be continued"
        raise InputError(f"Argument `orbit` {wanted}, but its shape is `{orbit.shape.text}`.")
    source = problem or orbit.problem
    with _crew(source, workers, on_progress) as crew:
        known = problem_of(orbit, problem) if crew is None else crew.problem_file.load()
        if orbit.shape.starts_at_release:
            return continuation.continue_orbit(
                known, orbit, parameter, box, settings=settings, on_progress=on_progress, crew=crew
            )
        return continuation.continue_impacts(
            known,
            orbit.values(known),
            known.state_vector(orbit.phases[0].start_state),
            parameter,
            box,
            settings=settings,
            on_progress=on_progress,
            crew=crew,
        )


@contextmanager
def _crew(problem: Named, workers: int, on_progress: Progress) -> Generator[Crew | None]:
    """Open the workers of a continuation, if there are to be any."""
    from zeno_orbits.continuation import Crew
    from zeno_orbits.work import Plan, Workers, open_pool

    if workers == 1:
        yield None
        return
    plan = Plan(place=Workers(count=workers))
    with open_pool(plan.place) as pool:
        yield Crew(problem_file=_file_of(problem), plan=plan, pool=pool, on_progress=on_progress)


@_shows_progress
def parameter_map(
    problem: Named,
    *,
    x: Axis,
    y: Axis,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    until: float | None = None,
    workers: int = 1,
    on_progress: Progress = silent,
) -> ParameterMap:
    """Return what motions settle to over a plane of two gains or parameters.

    Args:
        problem: The problem, its name or its file; with several workers its name or file.
        x: The axis across, ``("Kp", 1, 5, 30)``: name, range, number of points.
        y: The axis upwards.
        gains: Gains that differ from the problem's own.
        parameters: Parameters that differ from the problem's own.
        start: State name to value where every motion starts; by default the problem's first start.
        until: How long a motion may take to settle [s]; by default 300 turns of the problem's
            clock, or 115 of its slowest oscillation; more above a restitution of 0.5.
        workers: Processes; with 1 no other than this one; 0 means one a core.
        on_progress: Called with what is being done and the part of it that is done.

    Raises:
        InputError: If a name is unknown, a range does not fit, or there are too many points.
        WorkError: If the work cannot be finished.
    """
    from zeno_orbits import maps
    from zeno_orbits.maps import chunk_of
    from zeno_orbits.work import Plan, Workers

    known = _known(problem)
    plane = maps.Plane(
        source=known if workers == 1 else _file_of(problem),
        x=maps.Axis(name=x[0], lower=x[1], upper=x[2], count=x[3]),
        y=maps.Axis(name=y[0], lower=y[1], upper=y[2], count=y[3]),
        gains=dict(gains or {}),
        parameters=dict(parameters or {}),
        start=known.state_vector(known.starts[0] if start is None else start),
        until=until,
    )
    plan = Plan(place=Workers(count=workers or None), chunk=chunk_of(plane))
    return maps.parameter_map(plane, plan, on_progress=on_progress)


def plot(
    result: Any,
    *,
    problem: Named | None = None,
    ax: Axes | None = None,
    axes: Sequence[Axes] = (),
    width: float | None = None,
    title: str = "",
) -> Figure:
    """Return a picture of a result.

    Args:
        result: An execution, orbit, search result, closing, certificate, multipliers, family,
            continuation, map, trade or comparison. An orbit is simulated over one period.
        problem: Its problem, where the result does not tell it.
        ax: Axes to draw into, for a picture of one panel.
        axes: Axes to draw into, as many as the picture has panels.
        width: Width of the picture [in]; by default 7, that of a page.
        title: Words above the picture; none by default.

    Raises:
        InputError: If there is no picture of such a value, its problem is not known, or the axes
            are not as many as its panels.
    """
    from zeno_orbits.report import figure_of

    known = None if problem is None else _known(problem)
    return figure_of(result, problem=known, ax=ax, axes=axes, width=width, title=title)


def equilibrium_acceleration(
    problem: Named, *, gains: Numbers | None = None, parameters: Numbers | None = None
) -> Any:
    r"""Return :math:`\ddot h` at a Zeno equilibrium as a SymPy formula with numbers in it.

    Theorem 1: where it is negative, impacts accumulate nearby.

    Args:
        problem: The problem, its name or its file.
        gains: Gains that differ from the problem's own.
        parameters: Parameters that differ from the problem's own.

    Raises:
        InputError: If a name is unknown or a number out of range.
    """
    from zeno_orbits.model import formulas

    known = _known(problem)
    values = known.values(gains=gains, parameters=parameters)
    return formulas.with_numbers(formulas.acceleration_formula(known), values)


@dataclass(frozen=True, slots=True, kw_only=True)
class Verified:
    """Accepts the orbits of a search that pass an independent check, and keeps the certificate.

    Attributes:
        problem: The problem, or where it comes from; a worker loads it itself.
        settings: How to check.
        allow_unstable: Whether an orbit that does not attract is accepted.
        accuracy: Largest relative error of its numbers, if one was asked for.
    """

    problem: Problem | ProblemFile
    settings: VerificationSettings | None = None
    allow_unstable: bool = False
    accuracy: float | None = None

    def __call__(self, orbit: ZenoOrbit) -> Any:
        """Return the certificate of an orbit, and the objection to it if there is one."""
        from zeno_orbits.search import Judgement
        from zeno_orbits.verification import verifier

        known = self.problem if isinstance(self.problem, Problem) else self.problem.load()
        certificate = verifier.verify(orbit, known, settings=self.settings)
        objection = ""
        if not certificate.passed:
            objection = certificate.verdict()
        elif not (certificate.stable or self.allow_unstable):
            radius = certificate.spectral_radius
            objection = f"The orbit does not attract: its spectral radius is {radius:.4g}."
        elif self.accuracy is not None and not certificate.orbit_error <= self.accuracy:
            objection = f"Its numbers are certain to {certificate.orbit_error:.1e} only."
        return Judgement(objection=objection, certificate=certificate)


def problem_of(orbit: ZenoOrbit, problem: Named | None = None) -> Problem:
    """Return the problem of an orbit, by its name or as given.

    Args:
        orbit: The orbit.
        problem: Its problem, for one that is not bundled.

    Raises:
        InputError: If the given problem is another one, or none is given and none is bundled.
    """
    name, fidelity = split_fidelity(orbit.problem)
    if problem is None:
        if name not in bundled_problems():
            message = f"must name the file of problem `{name}`, but it is missing"
            raise InputError(f"Argument `problem` {message}.")
        return load_problem(orbit.problem)
    known = _known(problem)
    if fidelity is not None and known.name == name:
        known = known.at_fidelity(fidelity)
    if known.name != orbit.problem:
        wanted = f"must be the problem `{orbit.problem}` of the orbit"
        raise InputError(f"Argument `problem` {wanted}, but it is `{known.name}`.")
    return known


def _with_certificates(result: SearchResult) -> SearchResult:
    """Return the result with each orbit's certificate and multipliers in the orbit."""
    from zeno_orbits.verification import certified

    candidates = tuple(
        one
        if one.certificate is None
        else replace(one, orbit=certified(one.orbit, one.certificate))
        for one in result.candidates
    )
    best = candidates[0].orbit if candidates else result.orbit
    return replace(result, orbit=best, candidates=candidates)


def _known(problem: Named) -> Problem:
    return problem if isinstance(problem, Problem) else locate_problem(problem).load()


def _file_of(problem: Named) -> ProblemFile:
    """Return what several workers can load."""
    if isinstance(problem, Problem):
        wanted = "must be a name or a file where `workers` load it themselves"
        raise InputError(f"Argument `problem` {wanted}, but it is an object.")
    return locate_problem(problem)


def _read(orbit: ZenoOrbit | str | Path) -> ZenoOrbit:
    return orbit if isinstance(orbit, ZenoOrbit) else read_orbit(orbit)
