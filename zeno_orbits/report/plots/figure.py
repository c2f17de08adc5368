"""One function from any result to its picture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from matplotlib.figure import Figure

from zeno_orbits.continuation import Continuation, Family
from zeno_orbits.errors import InputError
from zeno_orbits.experiment import Comparison
from zeno_orbits.maps import ParameterMap
from zeno_orbits.model import Problem, load_problem
from zeno_orbits.orbits import ZenoOrbit
from zeno_orbits.precision import WorkPrecision
from zeno_orbits.report.orbit_motion import motion_of
from zeno_orbits.report.plots.certificate import plot_certificate
from zeno_orbits.report.plots.family import plot_boundaries, plot_families
from zeno_orbits.report.plots.map import plot_map
from zeno_orbits.report.plots.orbit import plot_portraits, plot_states, plot_time_series
from zeno_orbits.report.plots.recording import plot_comparison
from zeno_orbits.report.plots.style import FULL_WIDTH, add_title
from zeno_orbits.report.plots.work_precision import plot_trade
from zeno_orbits.search import SearchResult
from zeno_orbits.simulation import Execution
from zeno_orbits.verification import OrbitCertificate, problem_dynamics


def figure_of(
    result: object, *, problem: Problem | None = None, width: float = FULL_WIDTH, title: str = ""
) -> Figure:
    """Return the picture of a result.

    An orbit is simulated over one period from its own numbers and shown as phase portraits, an
    execution as states over time, a search as its best orbit.

    Args:
        result: An execution, orbit, search result, certificate, family, continuation, map, trade or
            comparison.
        problem: Its problem; by default the bundled one of its name. An execution knows no name:
            without its problem it is drawn without units.
        width: Width of the picture [in].
        title: Words above the picture; none by default.

    Raises:
        InputError: If there is no picture of such a value, or its problem is not known.
        OrbitNotFoundError: If a search result has no orbit.
        SimulationError: If the orbit cannot be simulated.
    """
    for kind, draw in _PICTURES.items():
        if isinstance(result, kind):
            figure = draw(result, problem, width)
            if title:
                add_title(figure, title)
            return figure
    kinds = ", ".join(f"`{kind.__name__}`" for kind in _PICTURES)
    message = f"must be one of {kinds}, but it is a `{type(result).__name__}`"
    raise InputError(f"Argument `result` {message}.")


def _of_execution(execution: Execution, problem: Problem | None, width: float) -> Figure:
    if problem is None:
        return plot_states(execution, width=width)
    return plot_time_series(problem, execution, width=width)


def _of_orbit(orbit: ZenoOrbit, problem: Problem | None, width: float) -> Figure:
    problem = problem or load_problem(orbit.problem)
    execution = motion_of(orbit, problem, problem_dynamics(orbit, problem))
    return plot_portraits(problem, execution, width=width)


def _of_search(found: SearchResult, problem: Problem | None, width: float) -> Figure:
    return _of_orbit(found.unwrap(), problem, width)


def _of_certificate(
    certificate: OrbitCertificate, _problem: Problem | None, width: float
) -> Figure:
    return plot_certificate(certificate, width=width)


def _of_family(family: Family, problem: Problem | None, width: float) -> Figure:
    return _of_continuation(Continuation(families=(family,)), problem, width)


def _of_continuation(found: Continuation, problem: Problem | None, width: float) -> Figure:
    problem = problem or load_problem(found.families[0].problem)
    if found.boundaries:
        return plot_boundaries(found, problem, width=width)
    return plot_families(found, problem, width=width)


def _of_map(found: ParameterMap, _problem: Problem | None, width: float) -> Figure:
    return plot_map(found, width=width)


def _of_trade(found: WorkPrecision, _problem: Problem | None, width: float) -> Figure:
    return plot_trade(found, width=width)


def _of_comparison(found: Comparison, problem: Problem | None, width: float) -> Figure:
    return plot_comparison(problem or load_problem(found.orbit.problem), found, width=width)


_PICTURES: dict[type, Callable[[Any, Problem | None, float], Figure]] = {
    Execution: _of_execution,
    ZenoOrbit: _of_orbit,
    SearchResult: _of_search,
    OrbitCertificate: _of_certificate,
    Family: _of_family,
    Continuation: _of_continuation,
    ParameterMap: _of_map,
    WorkPrecision: _of_trade,
    Comparison: _of_comparison,
}
