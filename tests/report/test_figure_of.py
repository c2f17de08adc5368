"""The picture of any result: each has one, with a title if wanted, and other values are refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import zeno_orbits as zo
from tests.report.test_plots import EVERY_FATE, TRADE, small_map
from zeno_orbits.continuation.families import (
    Continuation,
    Family,
    FamilyPoint,
    SpecialCurve,
    SpecialPoint,
    SpecialPointKind,
)
from zeno_orbits.continuation.return_maps import Loss
from zeno_orbits.report.plots import (
    COLUMN_WIDTH,
    FULL_WIDTH,
    figure_of,
    plot_certificate,
    save_figure,
)
from zeno_orbits.search.settings import SearchStatus


def family() -> Family:
    """Return a short family over the restitution that loses its stability and ends at a fold."""
    points = tuple(
        FamilyPoint(
            value=0.1 * k,
            state={},
            period=1.8 + 0.01 * k,
            multipliers=(complex(0.4 * k),),
            margins={Loss.FIRST_IMPACT.value: 1.0 + k},
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


def test_an_orbit_is_drawn_over_one_period_of_its_own(orbit: zo.ZenoOrbit) -> None:
    figure = figure_of(orbit)
    first = figure.axes[0]
    (release,) = {
        tuple(np.ravel(line.get_xydata()))
        for line in first.get_lines()
        if line.get_label() == "release"
    }
    angles = orbit.release_state
    assert release == pytest.approx((angles["theta1"], angles["dtheta1"]), abs=1e-8)


def test_a_search_is_drawn_as_its_best_orbit(orbit: zo.ZenoOrbit) -> None:
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
    assert units == ["height [m]"]


BALL = "bouncing_ball"


@pytest.fixture(scope="module")
def ball() -> zo.Execution:
    return zo.simulate(BALL, until=1.0)


@pytest.mark.parametrize("width", [COLUMN_WIDTH, FULL_WIDTH])
def test_a_certificate_shows_what_failed_and_which_multiplier_is_outside(
    certificate: zo.OrbitCertificate, width: float
) -> None:
    residuals = {**certificate.residuals, "drift": np.inf}
    refused = replace(certificate, residuals=residuals, multipliers=(1.5 + 0j, 0.2 + 0j))
    for one, failed, outside in ((certificate, 0, 0), (refused, 1, 1)):
        residual, circle = plot_certificate(one, width=width).axes
        labels = [line.get_label() for line in residual.get_lines()]
        assert labels.count("residual, failed") == failed
        assert labels.count("residual, passed") == len(one.residuals) - failed
        shown = [line.get_label() for line in circle.get_lines()]
        assert shown.count("multiplier outside the circle") == outside
        assert len(shown) == len(one.multipliers)


def test_a_value_without_a_picture_is_refused() -> None:
    with pytest.raises(zo.InputError, match=r"`result` must be one of `Execution`, .*`int`"):
        figure_of(3)
