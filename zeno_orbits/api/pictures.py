"""Pictures of results."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from zeno_orbits.api.inputs import Named, front_door, known_problem

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@front_door
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
        result: An execution, orbit, search result, shooting result, certificate, multipliers,
            family, continuation, map, work-precision study, comparison or fit of transients. An
            orbit is simulated over one period.
        problem: Problem of the result, if the result does not contain it.
        ax: Axes to draw into, for a picture of one panel.
        axes: Axes to draw into, as many as the picture has panels.
        width: Width of the picture [in]. The default is 7, the width of a page.
        title: Title above the picture. The default is an empty title.

    Raises:
        InputError: If the result cannot be plotted, its problem is not known, or the number of axes
            differs from the number of panels.
    """
    from zeno_orbits.report import figure_of

    known = None if problem is None else known_problem(problem)
    return figure_of(result, problem=known, ax=ax, axes=axes, width=width, title=title)
