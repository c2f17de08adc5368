"""Pictures of executions and of the region of Theorem 1: values in, a ``Figure`` out.

No pyplot and no global settings, so a picture looks the same wherever it is drawn. Every function
takes a width in inches: ``COLUMN_WIDTH`` stacks the panels for one column of a paper,
``FULL_WIDTH`` sets them side by side.
"""

from zeno_orbits.report.plots.animation import Film, film_of, gif_of, has_ffmpeg, mp4_of
from zeno_orbits.report.plots.family import plot_boundaries, plot_families
from zeno_orbits.report.plots.graph import plot_graph
from zeno_orbits.report.plots.map import plot_map
from zeno_orbits.report.plots.orbit import plot_outputs, plot_portraits, plot_time_series
from zeno_orbits.report.plots.recording import plot_comparison
from zeno_orbits.report.plots.region import has_zeno_region, plot_zeno_region
from zeno_orbits.report.plots.style import COLUMN_WIDTH, FULL_WIDTH, rendered, save_figure
from zeno_orbits.report.plots.two_motions import (
    plot_beside_by_phase,
    plot_beside_impacts,
    plot_beside_over_time,
    plot_beside_portraits,
    plot_beside_zeno_point,
)
from zeno_orbits.report.plots.work_precision import plot_trade
from zeno_orbits.report.plots.zeno_point import plot_zeno_zoom

__all__ = [
    "COLUMN_WIDTH",
    "FULL_WIDTH",
    "Film",
    "film_of",
    "gif_of",
    "has_ffmpeg",
    "has_zeno_region",
    "mp4_of",
    "plot_beside_by_phase",
    "plot_beside_impacts",
    "plot_beside_over_time",
    "plot_beside_portraits",
    "plot_beside_zeno_point",
    "plot_boundaries",
    "plot_comparison",
    "plot_families",
    "plot_graph",
    "plot_map",
    "plot_outputs",
    "plot_portraits",
    "plot_time_series",
    "plot_trade",
    "plot_zeno_region",
    "plot_zeno_zoom",
    "rendered",
    "save_figure",
]
