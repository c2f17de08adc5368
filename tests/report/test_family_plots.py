"""The panels of a family show the numbers of its points, each stability in its own line."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from zeno_orbits.continuation import (
    Continuation,
    Family,
    FamilyPoint,
    SpecialPoint,
    SpecialPointKind,
)
from zeno_orbits.model import load_problem
from zeno_orbits.report.plots import family as plots

VALUES = (1.0, 2.0, 3.0, 4.0, 5.0)
PERIODS = (0.71, 0.72, 0.74, 0.78, 0.86)
RADII = (0.2, 0.6, 0.9, 1.5, 1.9)
AMPLITUDES = (11.0, 12.0, 13.0, 14.0, 15.0)
STABLE, UNSTABLE = slice(0, 3), slice(3, 5)


def _point(k: int) -> FamilyPoint:
    return FamilyPoint(
        value=VALUES[k],
        state={},
        period=PERIODS[k],
        multipliers=(complex(-RADII[k]), complex(0.1)),
        margins={},
        miss=0.0,
    )


def _family() -> Continuation:
    def end(k: int) -> SpecialPoint:
        return SpecialPoint(kind=SpecialPointKind.BOUND, at=_point(k), error=0.0, index=k)

    whole = Family(
        problem="motor_pendulum",
        parameter="Kp",
        gains={},
        parameters={},
        n_returns=1,
        points=tuple(map(_point, range(len(VALUES)))),
        special=(),
        first=end(0),
        last=end(len(VALUES) - 1),
    )
    return Continuation(families=(whole,))


@pytest.fixture(name="panels", scope="module")
def _panels() -> list[Axes]:
    with pytest.MonkeyPatch.context() as patch:
        known = dict(zip(VALUES, AMPLITUDES, strict=True))

        def amplitude(point: FamilyPoint) -> float:
            return known[point.value]

        patch.setattr(plots, "_amplitudes", lambda *_: amplitude)  # pyright: ignore
        return plots.plot_families(_family(), load_problem("motor_pendulum")).axes


def _line(ax: Axes, label: str) -> Line2D:
    (found,) = [line for line in ax.lines if line.get_label() == label]
    return found


@pytest.mark.parametrize(
    ("place", "word", "numbers"),
    [(0, "period", PERIODS), (1, "amplitude", AMPLITUDES), (2, "spectral radius", RADII)],
)
def test_a_panel_shows_the_quantity_that_its_axis_names(
    panels: list[Axes], place: int, word: str, numbers: tuple[float, ...]
) -> None:
    ax = panels[place]
    assert ax.get_ylabel().startswith(word)
    for label, part in (("stable", STABLE), ("unstable", UNSTABLE)):
        x, y = _line(ax, label).get_data()
        drawn = dict(zip(np.asarray(x).tolist(), np.asarray(y).tolist(), strict=True))
        # Each line is joined to the one before it, by the last point of that.
        expected = dict(zip(VALUES[part], numbers[part], strict=True))
        assert expected.items() <= drawn.items()
        assert len(drawn) <= len(expected) + 1


def test_stable_orbits_are_the_solid_line_and_unstable_ones_the_dashed(panels: list[Axes]) -> None:
    for ax in panels:
        assert _line(ax, "stable").get_linestyle() == "-"
        assert _line(ax, "unstable").get_linestyle() != "-"
        assert max(np.asarray(_line(ax, "stable").get_xdata())) == VALUES[STABLE][-1]
