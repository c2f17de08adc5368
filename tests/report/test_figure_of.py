"""The picture of any result: each has one, with a title if wanted, and other values are refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import zeno_orbits as zo
from tests.report.test_plots import EVERY_FATE, TRADE, small_map
from tests.support.cases import fast
from zeno_orbits.continuation import (
    Continuation,
    Family,
    FamilyPoint,
    SpecialCurve,
    SpecialPoint,
    SpecialPointKind,
)
from zeno_orbits.report.plots import (
    COLUMN_WIDTH,
    FULL_WIDTH,
    figure_of,
    plot_certificate,
    save_figure,
)
from zeno_orbits.search import OrbitNotClosedError, SearchStatus, ShootingResult
from zeno_orbits.verification import RESIDUALS


def family() -> Family:
    """Return a short family over the restitution that loses its stability and ends at a fold."""
    points = tuple(
        FamilyPoint(
            value=0.1 * k,
            state={},
            period=1.8 + 0.01 * k,
            multipliers=(complex(0.4 * k),),
            margins={"speed of the first impact": 1.0 + k},
            miss=0.0,
        )
        for k in range(1, 5)
    )
    first = SpecialPoint(kind=SpecialPointKind.START, at=points[0], error=0.0, index=0)
    last = SpecialPoint(kind=SpecialPointKind.FOLD, at=points[-1], error=1e-12, index=3)
    return Family(
        problem="motor_pendulum",
        parameter="restitution",
        gains={},
        parameters={},
        n_returns=1,
        points=points,
        special=(),
        first=first,
        last=last,
    )


def boundary() -> SpecialCurve:
    return SpecialCurve(
        kind=SpecialPointKind.FOLD,
        names=("restitution", "Kp"),
        x=(0.1, 0.2),
        y=(2.0, 3.0),
        errors=(0.0, 0.0),
        ends=("", ""),
    )


RESULTS: dict[str, Callable[[], object]] = {
    "family": family,
    "continuation": lambda: Continuation(families=(family(),)),
    "boundaries": lambda: Continuation(families=(family(),), boundaries=(boundary(),)),
    "map": lambda: small_map(*EVERY_FATE),
    "trade": lambda: TRADE,
}


@pytest.mark.parametrize("name", RESULTS)
def test_every_result_has_a_picture_and_takes_a_title(name: str, tmp_path: Path) -> None:
    figure = figure_of(RESULTS[name](), title="A title")
    assert isinstance(figure, Figure)
    (legend,) = figure.legends
    assert "A title" in (legend.get_title().get_text(), figure.get_suptitle())
    assert float(figure.get_figwidth()) == FULL_WIDTH
    save_figure(figure, str(tmp_path / "picture.png"))
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_an_orbit_is_drawn_over_one_period_of_its_own(orbit: zo.Orbit) -> None:
    figure = figure_of(orbit)
    first = figure.axes[0]
    (release,) = {
        tuple(np.ravel(line.get_xydata()))
        for line in first.get_lines()
        if line.get_label() == "release"
    }
    angles = orbit.release_state
    assert release == pytest.approx((angles["theta1"], angles["dtheta1"]), abs=1e-8)


def test_a_search_is_drawn_as_its_best_orbit(orbit: zo.Orbit) -> None:
    found = zo.SearchResult(
        status=SearchStatus.FOUND,
        orbit=orbit,
        residuals={},
        agreement=0.0,
        closure_error=0.0,
        n_unknowns=0,
        iterations=0,
        solve_time=0.0,
        wall_time=0.0,
        attempts=(),
    )
    labels = [ax.get_xlabel() for ax in figure_of(found).axes]
    assert labels == [ax.get_xlabel() for ax in figure_of(orbit).axes]


def test_an_execution_without_its_problem_is_drawn_without_units(ball: zo.Execution) -> None:
    assert [ax.get_ylabel() for ax in figure_of(ball).axes] == ["height", "speed"]
    units = [ax.get_ylabel() for ax in figure_of(ball, problem=zo.load_problem(BALL)).axes]
    assert units == ["height [m]", "speed [m/s]"]


PANELS = {"family": 3, "continuation": 3, "boundaries": 1, "map": 1, "trade": 1}


@pytest.mark.parametrize("name", RESULTS)
def test_every_result_is_drawn_into_axes_that_are_there(name: str) -> None:
    figure = Figure(figsize=(5.0, 4.0))
    axes = np.atleast_1d(figure.subplots(1, PANELS[name]))
    others = figure.add_axes((0.9, 0.9, 0.1, 0.1))
    assert zo.plot(RESULTS[name](), axes=axes, title="A title") is figure
    assert all(ax.lines or ax.collections for ax in axes)
    assert not figure.legends
    assert len(others.lines) + len(others.collections) == 0
    assert axes[0].get_legend() is not None
    assert axes[0].get_title() == "A title"


def test_an_orbit_and_a_certificate_are_drawn_into_axes_that_are_there(
    orbit: zo.Orbit, certificate: zo.OrbitCertificate
) -> None:
    for result in (orbit, certificate):
        figure = Figure()
        axes = figure.subplots(2)
        assert zo.plot(result, axes=axes) is figure
        assert figure.axes == list(axes)
        assert all(ax.lines for ax in axes)


def test_one_panel_takes_one_axes(ball: zo.Execution) -> None:
    ax = Figure().add_subplot()
    zo.plot(TRADE, ax=ax)
    assert len(ax.lines) == 5
    with pytest.raises(
        zo.InputError, match="as many as the picture has panels, 2, but there are 1"
    ):
        zo.plot(ball, ax=ax)
    with pytest.raises(zo.InputError, match="exclude each other"):
        zo.plot(TRADE, ax=ax, axes=[ax])
    with pytest.raises(zo.InputError, match="`width` must not be given with axes"):
        zo.plot(TRADE, ax=ax, width=3.4)
    assert float(zo.plot(TRADE, width=3.4).get_figwidth()) == 3.4


@pytest.mark.parametrize("width", [0.0, -1.0, 1e4, np.nan, np.inf])
def test_a_width_that_no_picture_can_have_is_refused(width: float) -> None:
    with pytest.raises(zo.InputError, match=r"`width` must lie in \[1.5, 60\] inches, but it is"):
        zo.plot(TRADE, width=width)


def test_what_are_no_axes_is_refused() -> None:
    no_axes: Any = 1
    with pytest.raises(zo.InputError, match="`axes` must be axes of matplotlib, but one"):
        zo.plot(TRADE, ax=no_axes)


def test_multipliers_have_a_picture_and_a_closing_is_drawn_as_its_orbit(
    orbit: zo.Orbit,
) -> None:
    found = replace(zo.floquet_multipliers(orbit), values=(0.5 + 0.25j, -0.125j))
    (circle,) = figure_of(found).axes
    shown = {complex(*np.ravel(line.get_xydata())) for line in circle.get_lines()}
    assert shown == set(found.values)
    labels = [ax.get_xlabel() for ax in figure_of(ShootingResult(orbit=orbit)).axes]
    assert labels == [ax.get_xlabel() for ax in figure_of(orbit).axes]
    with pytest.raises(OrbitNotClosedError, match="nothing comes back"):
        figure_of(ShootingResult(orbit=None, detail="nothing comes back"))


@pytest.mark.slow
@pytest.mark.parametrize("width", fast(1, [2.5, COLUMN_WIDTH, FULL_WIDTH]))
def test_labels_of_ticks_across_keep_off_each_other(
    width: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "zeno_orbits.report.plots.family.orbit_amplitude", lambda _, __, point: point.value
    )
    one = family()
    # Numbers near each other, and negative ones, have the longest labels.
    moved = [replace(point, value=-1.1 + 0.5 * point.value) for point in one.points]
    close = replace(
        one,
        points=tuple(moved),
        first=replace(one.first, at=moved[0]),
        last=replace(one.last, at=moved[-1]),
    )
    figure = figure_of(close, width=width)
    FigureCanvasAgg(figure).draw()
    for ax in figure.axes:
        (left, right), labels = ax.get_xlim(), ax.get_xticklabels()
        seen = [label for label in labels if left <= label.get_position()[0] <= right]
        boxes = [label.get_window_extent() for label in seen]
        assert len(boxes) > 1
        assert all(a.x1 < b.x0 for a, b in pairwise(boxes))


BALL = "bouncing_ball"


@pytest.fixture(scope="module")
def ball() -> zo.Execution:
    return zo.simulate(BALL, until=1.0)


@pytest.mark.parametrize("width", [COLUMN_WIDTH, FULL_WIDTH])
def test_a_certificate_shows_each_residual_at_its_size_and_what_failed(
    certificate: zo.OrbitCertificate, width: float
) -> None:
    residuals = {**certificate.residuals, "drift": 1e-3, "period": np.inf, "escape": 0.0}
    refused = replace(certificate, residuals=residuals)
    for one, failed in ((certificate, 0), (refused, 1)):
        ax, _ = plot_certificate(one, width=width).axes
        names = [label.get_text().replace(" ", "_") for label in ax.get_yticklabels()]
        assert names == [name for name in RESIDUALS if name in one.residuals]
        bars = {
            names[int(np.ravel(line.get_ydata())[0])]: line
            for line in ax.get_lines()
            if str(line.get_label()).startswith("residual")
        }
        sizes = {name: np.ravel(line.get_xdata())[1] for name, line in bars.items()}
        words = {names[round(text.get_position()[1])]: text.get_text() for text in ax.texts}
        for name, size in one.residuals.items():
            if size == 0.0 or size == np.inf:
                # No bar stands for what has no place on a logarithmic axis.
                assert words[name] == ("0" if size == 0.0 else "never reached")
            else:
                assert sizes[name] == size
        assert [bar.get_label() for bar in bars.values()].count("residual, failed") == failed
        # The axis ends a decade below what it shows.
        assert ax.get_xlim()[0] == pytest.approx(0.1 * min(*sizes.values(), one.tolerance))


def test_a_certificate_shows_each_multiplier_where_it_is(
    certificate: zo.OrbitCertificate,
) -> None:
    values = (1.5 + 0.25j, 0.2 - 0.75j)
    _, circle = plot_certificate(replace(certificate, multipliers=values)).axes
    drawn = {complex(*np.ravel(line.get_xydata())): line.get_label() for line in circle.get_lines()}
    assert drawn == {
        values[0]: "multiplier outside the circle",
        values[1]: "multiplier inside the circle",
    }


def test_each_panel_of_a_family_shows_its_own_number_and_dashes_where_it_repels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        "zeno_orbits.report.plots.family.orbit_amplitude", lambda _, __, point: 7.0 * point.value
    )
    one = family()
    period, amplitude, radius = figure_of(one).axes
    expected = {
        period: [point.period for point in one.points],
        amplitude: [7.0 * point.value for point in one.points],
        radius: [0.4, 0.8, 1.2, 1.6],
    }
    assert [ax.get_ylabel().partition(" ")[0] for ax in expected] == [
        *("period", "amplitude", "spectral")
    ]
    for ax, values in expected.items():
        true = dict(zip([point.value for point in one.points], values, strict=True))
        looks = {
            label: [line for line in ax.get_lines() if line.get_label() == label]
            for label in ("stable", "unstable")
        }
        for label, (line,) in looks.items():
            for x, y in np.asarray(line.get_xydata()):
                assert y == pytest.approx(true[x], rel=1e-15), (label, x)
            assert (line.get_linestyle() == "-") == (label == "stable")
        stable, unstable = (np.ravel(lines[0].get_xdata()) for lines in looks.values())
        # The orbits of radius below 1 are the first two; a line joins the next one.
        assert sorted(set(stable)) == [0.1, 0.2]
        assert sorted(set(unstable)) == [0.2, 0.1 * 3, 0.1 * 4]


def test_a_value_without_a_picture_is_refused() -> None:
    with pytest.raises(zo.InputError, match=r"`result` must be one of `Execution`, .*`int`"):
        figure_of(3)
