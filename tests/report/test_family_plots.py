"""The panels of a family show the numbers of its points, each stability in its own line."""

from __future__ import annotations

from collections.abc import Sequence

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


def _point(k: int, periods: Sequence[float] = PERIODS) -> FamilyPoint:
    return FamilyPoint(
        value=VALUES[k],
        state={},
        period=periods[k],
        multipliers=(complex(-RADII[k]), complex(0.1)),
        margins={},
        miss=0.0,
    )


def _family(periods: Sequence[float] = PERIODS) -> Continuation:
    def end(k: int) -> SpecialPoint:
        return SpecialPoint(kind=SpecialPointKind.BOUND, at=_point(k, periods), error=0.0, index=k)

    whole = Family(
        problem="motor_pendulum",
        parameter="Kp",
        gains={},
        parameters={},
        n_returns=1,
        points=tuple(_point(k, periods) for k in range(len(VALUES))),
        special=(),
        first=end(0),
        last=end(len(VALUES) - 1),
    )
    return Continuation(families=(whole,))


def _drawn(
    periods: Sequence[float] = PERIODS, amplitudes: Sequence[float] = AMPLITUDES
) -> list[Axes]:
    with pytest.MonkeyPatch.context() as patch:
        known = dict(zip(VALUES, amplitudes, strict=True))

        def amplitude(point: FamilyPoint) -> float:
            return known[point.value]

        patch.setattr(plots, "_amplitudes", lambda *_: amplitude)  # pyright: ignore
        return plots.plot_families(_family(periods), load_problem("motor_pendulum")).axes


@pytest.fixture(name="panels", scope="module")
def _panels() -> list[Axes]:
    return _drawn()


@pytest.mark.parametrize(("change", "n"), [(0.0, 2), (1e-9, 2), (1e-4, 3)])
def test_a_constant_period_has_no_panel(change: float, n: int) -> None:
    panels = _drawn([0.7 * (1.0 + change * k) for k in range(len(VALUES))])
    assert len(panels) == n
    assert any(ax.get_ylabel().startswith("period") for ax in panels) == (n == 3)


def test_the_rounding_of_a_constant_amplitude_is_not_seen() -> None:
    panels = _drawn(amplitudes=[0.3 + 1e-16 * (k % 2) for k in range(len(VALUES))])
    low, high = panels[1].get_ylim()
    assert low < 0.29 < 0.31 < high


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
