"""One function from any result to its picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zeno_orbits.continuation import Continuation, Family, HeldFamilies
from zeno_orbits.errors import InputError, shown
from zeno_orbits.experiment import Comparison, TransientComparison, TransientFit
from zeno_orbits.maps import ParameterMap
from zeno_orbits.model import Problem, recorded_problem
from zeno_orbits.orbits import Orbit, Stability
from zeno_orbits.precision import WorkPrecision
from zeno_orbits.report.motion import orbit_motion
from zeno_orbits.report.plots.certificate import plot_certificate, plot_multipliers
from zeno_orbits.report.plots.family import (
    plot_boundaries,
    plot_families,
    plot_held_families,
)
from zeno_orbits.report.plots.map import plot_map
from zeno_orbits.report.plots.panels import add_title, require_width
from zeno_orbits.report.plots.portraits import plot_portraits
from zeno_orbits.report.plots.recording import plot_comparison, plot_transient
from zeno_orbits.report.plots.style import FULL_WIDTH, keep_legible
from zeno_orbits.report.plots.time_series import plot_states, plot_time_series
from zeno_orbits.report.plots.work_precision import plot_trade
from zeno_orbits.search import SearchResult, ShootingResult
from zeno_orbits.simulation import Execution
from zeno_orbits.verification import OrbitCertificate


def figure_of(
    result: object,
    *,
    problem: Problem | None = None,
    ax: Axes | None = None,
    axes: Sequence[Axes] = (),
    width: float | None = None,
    title: str = "",
) -> Figure:
    """Return the figure of a result.

    An orbit is simulated over one period at its own parameter values and shown as phase portraits.
    An execution is shown as states over time, and a search as its best orbit.

    Args:
        result: An execution, orbit, search result, closing, certificate, multipliers, family,
            continuation, map, trade, comparison or fit of transients.
        problem: The problem of the result, by default the bundled problem with the result's problem
            name. An execution does not store a problem name. Without its problem it is drawn
            without units.
        ax: Axes to draw into, for a picture of one panel.
        axes: Axes to draw into, one per panel.
        width: Width of the picture [in], by default a page width.
        title: Title above the figure, by default empty.

    Raises:
        InputError: If the type of the result is not supported, its problem is unknown, or the
            number of axes differs from the number of panels.
        OrbitNotFoundError: If a search result contains no orbit.
        OrbitNotClosedError: If a shooting result contains no orbit.
        SimulationError: If the orbit cannot be simulated.
    """
    listed: Any = axes
    if not isinstance(listed, Sequence | np.ndarray):
        wanted = "must hold axes of matplotlib"
        raise InputError(f"Argument `axes` {wanted}, but it is {shown(axes)}.")
    given = [*np.ravel(np.asarray(axes, dtype=object))] if ax is None else [ax]
    if ax is not None and len(axes):
        raise InputError("Arguments `ax` and `axes` exclude each other: leave out one.")
    if given and width is not None:
        raise InputError("Argument `width` must not be given with axes, which have a width.")
    if width is not None:
        require_width(width)
    for kind, draw in _PICTURES.items():
        if isinstance(result, kind):
            figure = draw(result, problem, FULL_WIDTH if width is None else width, given)
            if title:
                add_title(figure, title, given)
            keep_legible(figure)
            return figure
    kinds = ", ".join(f"`{kind.__name__}`" for kind in _PICTURES)
    message = f"must be one of {kinds}, but it is a `{type(result).__name__}`"
    raise InputError(f"Argument `result` {message}.")


def _of_orbit(orbit: Orbit, problem: Problem | None, width: float, axes: Sequence[Axes]) -> Figure:
    problem = recorded_problem(orbit.problem, problem, file=orbit.problem_file)
    execution = orbit_motion(orbit, problem, orbit.machine(problem))
    return plot_portraits(problem, execution, width=width, axes=axes)


def _of_execution(
    execution: Execution, problem: Problem | None, width: float, axes: Sequence[Axes]
) -> Figure:
    if problem is None:
        return plot_states(execution, width=width, axes=axes)
    return plot_time_series(problem, execution, width=width, axes=axes)


def _of_continuation(
    found: Continuation, problem: Problem | None, width: float, axes: Sequence[Axes]
) -> Figure:
    word, file = found.families[0].problem, found.problem_file
    problem = recorded_problem(word, problem, result="continuation", file=file)
    draw = plot_boundaries if found.boundaries else plot_families
    return draw(found, problem, width=width, axes=axes)


def _of_held(
    held: HeldFamilies, problem: Problem | None, width: float, axes: Sequence[Axes]
) -> Figure:
    found = held.found
    word, file = found.families[0].problem, found.problem_file
    problem = recorded_problem(word, problem, result="continuation", file=file)
    return plot_held_families(held, problem, width=width, axes=axes)


_PICTURES: dict[type, Callable[[Any, Problem | None, float, Sequence[Axes]], Figure]] = {
    Execution: _of_execution,
    Orbit: _of_orbit,
    SearchResult: lambda found, problem, width, axes: _of_orbit(
        found.unwrap(), problem, width, axes
    ),
    ShootingResult: lambda found, problem, width, axes: _of_orbit(
        found.unwrap(), problem, width, axes
    ),
    OrbitCertificate: lambda found, _, width, axes: plot_certificate(found, width=width, axes=axes),
    Stability: lambda found, _, width, axes: plot_multipliers(
        tuple(found.values), width=width, axes=axes
    ),
    HeldFamilies: _of_held,
    Family: lambda found, problem, width, axes: _of_continuation(
        Continuation(families=(found,)), problem, width, axes
    ),
    Continuation: _of_continuation,
    ParameterMap: lambda found, _, width, axes: plot_map(found, width=width, axes=axes),
    WorkPrecision: lambda found, _, width, axes: plot_trade(found, width=width, axes=axes),
    Comparison: lambda found, problem, width, axes: plot_comparison(
        problem or found.problem, found, width=width, axes=axes
    ),
    TransientFit: lambda found, _, width, axes: plot_transient(found, width=width, axes=axes),
    TransientComparison: lambda found, _, width, axes: plot_transient(
        found.fit, width=width, axes=axes
    ),
}
