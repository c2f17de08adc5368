"""The figures of the paper, by name and at the width of a column."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from matplotlib.figure import Figure

from zeno_orbits.errors import InputError
from zeno_orbits.experiment import MatchedRun
from zeno_orbits.model import GraphDynamics, HybridDynamics, ParameterValues, Problem
from zeno_orbits.report.motion import machine_motion
from zeno_orbits.report.plots.animation import film_of, gif_of, has_ffmpeg, mp4_of
from zeno_orbits.report.plots.graph import plot_graph
from zeno_orbits.report.plots.mechanism import plot_mechanism
from zeno_orbits.report.plots.portraits import plot_portraits
from zeno_orbits.report.plots.region import plot_zeno_set
from zeno_orbits.report.plots.style import COLUMN_WIDTH, rendered
from zeno_orbits.report.plots.two_motions import (
    TwoMotions,
    plot_beside_by_phase,
    plot_beside_impacts,
    plot_beside_over_time,
    plot_beside_portraits,
    plot_beside_zeno_point,
)
from zeno_orbits.simulation import Execution


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """The subject of the figures.

    Attributes:
        problem: The problem.
        values: Parameter values of the orbit.
        dynamics: The problem at these values.
        period: Period of the orbit [s].
        one: The motion over one period, from its start.
        several: The motion over several periods.
        periods: Number of periods of ``several``.
        other: Function that returns the motion for comparison with the model. It is called only if
            needed.
    """

    problem: Problem
    values: ParameterValues
    dynamics: HybridDynamics | GraphDynamics
    period: float
    one: Execution
    several: Execution
    periods: int
    other: Callable[[], MatchedRun]


def graph_files(material: Material) -> dict[str, bytes]:
    """Return the hybrid system and its completion as graphs."""
    _one_stop(material)
    return _files({"fig2_systems": plot_graph(material.problem, material.values)})


def mechanism_files(material: Material) -> dict[str, bytes]:
    """Return the mechanism at the release and its circuit."""
    drawn = plot_mechanism(material.problem, material.values, material.one, material.period)
    return _files({"fig3_mechanism": drawn})


def region_files(material: Material) -> dict[str, bytes]:
    """Return the region of Theorem 1, the orbit's contact phase in it."""
    problem, dynamics = material.problem, _one_stop(material)
    return _files({"region": plot_zeno_set(problem, dynamics, material.one, width=COLUMN_WIDTH)})


def portrait_files(material: Material) -> dict[str, bytes]:
    """Return the phase portraits."""
    drawn = plot_portraits(material.problem, material.one, width=COLUMN_WIDTH)
    return _files({"fig4_portraits": drawn})


def beside_files(material: Material) -> dict[str, bytes]:
    """Return the model and another motion: over time, by phase, impacts, portraits, zoom."""
    one = TwoMotions(
        problem=material.problem,
        dynamics=_one_stop(material),
        model=material.one,
        other=material.other(),
    )
    return _files(
        {
            "fig5a_over_time": plot_beside_over_time(replace(one, model=material.several)),
            "fig5a_by_phase": plot_beside_by_phase(one),
            "fig5b_impacts": plot_beside_impacts(one),
            "fig5c_portraits": plot_beside_portraits(one),
            "fig5d_zeno_point": plot_beside_zeno_point(one),
        }
    )


def animation_files(material: Material) -> dict[str, bytes]:
    """Return the machine in motion: a GIF, and an MP4 where ffmpeg is found.

    A machine that advances is shown over several periods.
    """
    problem, values, period = material.problem, material.values, material.period
    if machine_motion(problem, values, material.several, material.periods * period, n=2).renamed:
        film = film_of(problem, values, material.several, period, periods=material.periods)
    else:
        film = film_of(problem, values, material.one, period)
    files = {"machine.gif": gif_of(film)}
    return files | ({"machine.mp4": mp4_of(film)} if has_ffmpeg() else {})


PAPER: dict[str, Callable[[Material], dict[str, bytes]]] = {
    "graph": graph_files,
    "mechanism": mechanism_files,
    "region": region_files,
    "portraits": portrait_files,
    "beside": beside_files,
    "animation": animation_files,
}
"""Functions that write the files of each kind of figure."""


def _one_stop(material: Material) -> HybridDynamics:
    """Return the system of a machine with one stop and no switch.

    Raises:
        InputError: If the machine has several stops or switches.
    """
    try:
        return material.problem.dynamics(material.values)
    except InputError as error:
        raise InputError(
            f"This figure needs a machine with one stop, no switch and no kink, unlike "
            f"`{material.problem.name}`."
        ) from error


def _files(figures: Mapping[str, Figure]) -> dict[str, bytes]:
    return {
        f"{name}.{kind}": rendered(figure, kind)
        for name, figure in figures.items()
        for kind in ("pdf", "png")
    }
