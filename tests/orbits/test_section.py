"""Charts of sections: lines and circles known by hand, and the releases of machines."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.reference.reference_orbit import RELEASE, ZENO_STATE
from tests.support.units import Units, in_units
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import HybridDynamics, load_problem
from zeno_orbits.orbits import (
    IMPACT_ROWS,
    RELEASE_ROWS,
    REST_ROWS,
    Line,
    Multipliers,
    project_to_section,
    section_around,
)

ROUNDING = 1e-14
CENTRE = np.array(RELEASE)
SCALE = np.maximum(np.abs(RELEASE), np.abs(ZENO_STATE)) + 1e-3


class Surface:
    """What a section asks of a system: functions of the state that vanish, and their gradients.

    Attributes:
        calls: How often the gap was evaluated.
    """

    def __init__(
        self,
        *contact: Callable[[Vector], float],
        gradient: Callable[[Vector], Any] | None = None,
        holonomic: Callable[[Vector], Vector] = lambda _: np.zeros(0),
        holonomic_gradient: Callable[[Vector], Any] = lambda _: np.zeros((0, 9)),
    ) -> None:
        self.calls = 0
        self._gap, self.gap_rate, self.multiplier = (*contact, contact[0], contact[0])[:3]
        self.holonomic = holonomic
        self.differentiation = None

        def by(chosen: tuple[int, ...]) -> Any:
            def columns(x: Vector, whole: Any) -> Vector:
                wanted = [*range(len(x)), *(len(x) + place for place in chosen)]
                return np.asarray(whole, dtype=float)[:, wanted]

            assert gradient is not None
            return SimpleNamespace(
                contact=lambda x: columns(x, gradient(x)),
                holonomic=lambda x: columns(x, holonomic_gradient(x)),
            )

        if gradient is not None:
            self.differentiation = SimpleNamespace(by=by)

    def gap(self, x: Vector) -> float:
        self.calls += 1
        return self._gap(x)


def circle(sign: float = 1.0, **given: Any) -> Any:
    """Return the unit circle, with its gradient or without."""
    return Surface(lambda x: sign * (x @ x - 1.0), **given)


def _of_circle(x: Vector) -> Any:
    return [[2 * x[0], 2 * x[1]]] + 4 * [[9.0, 9.0]]


def stuck(value: Any) -> Any:
    """Return conditions that a step does not change, of ``x`` alone or of ``x`` and ``y``."""
    values = np.atleast_1d(value)
    return Surface(
        lambda _: float(values[0]),
        lambda _: float(values[-1]),
        gradient=lambda _: [[1.0, 0.0], [0.0, 1.0], *3 * [[0.0, 0.0]]],
    )


def test_a_line_of_parameters_moves_those_that_its_direction_has() -> None:
    line = Line(origin=np.array([1.0, 2.0, 3.0]), direction=np.array([0.0, -0.5, 2.0]))
    assert line.moving == (1, 2)
    assert line.slopes.tolist() == [-0.5, 2.0]
    assert line.at(3.0).tolist() == [1.0, 0.5, 9.0]


@pytest.mark.parametrize("end", [1.0, -1.0])
@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("y", [0.1, -0.2])
def test_a_chart_of_a_circle_keeps_to_it_along_its_tangent(
    end: float, y: float, *, exact: bool
) -> None:
    system = circle(gradient=_of_circle) if exact else circle()
    centre, scale = np.array([end, 0.0]), np.array([2.0, 0.5])
    chart = section_around(system, IMPACT_ROWS, centre, scale)
    assert (chart.dimension, chart.rows) == (1, (0,))
    assert np.abs(chart.tangent[:, 0]) == pytest.approx([0.0, 1.0], abs=1e-9)
    # The scaled gradient is (4 end, 0).
    assert chart.normal[:, 0] == pytest.approx([0.25 * end, 0.0], abs=1e-9)
    # Away from the tangent by y the circle is y^2 / 2 and more nearer, in either direction.
    coordinates = np.array([y / 0.5 * chart.tangent[1, 0]])
    x = chart.state(system, coordinates)
    assert x == pytest.approx([end * np.sqrt(1 - y**2), y], abs=ROUNDING if exact else 1e-9)
    assert chart.coordinates(x) == pytest.approx(coordinates, abs=1e-9)
    system.calls = 0
    assert chart.state(system, np.zeros(1)).tolist() == [end, 0.0]
    assert system.calls == 1


@pytest.mark.parametrize("value", [1e100, -1e100, np.nan, [1.0, 1e100], [1e101, 1.0]])
def test_a_section_is_lost_where_one_of_its_conditions_is_beyond_all_bounds(value: Any) -> None:
    system = stuck(value)
    centre = np.array([0.5, -0.25])
    chart = section_around(system, REST_ROWS, centre, np.ones(2))
    with pytest.raises(SimulationError, match="diverges from the section") as caught:
        chart.state(system, np.zeros(0))
    assert (caught.value.time, caught.value.state) == (0.0, (0.5, -0.25))
    chart.state(stuck(0.9e100), np.zeros(0))


@pytest.mark.parametrize(("angle", "dimension"), [(1.2e-9, 1), (0.8e-9, 2)])
@pytest.mark.parametrize("unit", [1.0, 1e-7, 1e7])
def test_conditions_depend_on_each_other_if_their_gradients_are_parallel_to_a_billionth(
    angle: float, unit: float, dimension: int
) -> None:
    # Unit rows a small angle apart have the singular values sqrt(2) and angle / sqrt(2).
    rows = [[1.0, 0.0, 0.0], [unit, 2 * angle * unit, 0.0], *3 * [[0.0, 0.0, 1.0]]]
    system: Any = Surface(lambda _: 0.0, gradient=lambda _: rows)
    chart = section_around(system, REST_ROWS, np.zeros(3), np.ones(3))
    assert chart.dimension == dimension
    # Both rows are kept each for itself, or half of their sum; rounding is 1e-16 over the angle.
    sizes = np.array([[1.0], [unit]])
    kept = (np.array(rows[:2]) / sizes) @ (chart.normal * sizes.T)
    expected = np.eye(2) if dimension == 1 else np.full((2, 2), 0.5)
    assert kept == pytest.approx(expected, abs=1e-6)


def test_a_condition_without_a_gradient_takes_no_dimension() -> None:
    rows = [[3.0, 0.0], *4 * [[0.0, 0.0]]]
    system: Any = Surface(lambda _: 0.0, gradient=lambda _: rows)
    chart = section_around(system, REST_ROWS, np.zeros(2), np.ones(2))
    assert chart.dimension == 1
    assert chart.normal == pytest.approx(np.array([[1 / 3, 0.0], [0.0, 0.0]]), abs=ROUNDING)


def _line_by_parameters() -> Any:
    """Return the section ``x + y = 3 p_0 + p_2``."""
    gradient = [[1.0, 1.0, -3.0, 0.0, -1.0], *4 * [5 * [9.0]]]
    return Surface(lambda x: x[0] + x[1], gradient=lambda _: gradient)


def test_a_chart_moves_with_its_section_the_shortest_way_in_scaled_states() -> None:
    centre, scale = np.zeros(2), np.array([2.0, 0.5])
    # The nearest point of x + y = c is at c (4, 1/4) / (4 + 1/4).
    nearest = np.array([16.0, 1.0]) / 17
    chart = section_around(_line_by_parameters(), IMPACT_ROWS, centre, scale, parameters=(2, 0))
    assert chart.drift == pytest.approx(np.outer(nearest, [1.0, 3.0]), abs=ROUNDING)
    assert chart.lift[:, 1:] == pytest.approx(chart.drift, abs=0.0)
    # The tangent (1, -1) is (1/2, -2) in scaled states.
    along = scale * chart.tangent[:, 0]
    assert chart.lift[:, 0] == pytest.approx(along, abs=0.0)
    assert along / along[0] == pytest.approx([1.0, -1.0], abs=ROUNDING)
    assert np.linalg.norm(chart.tangent) == pytest.approx(1.0, abs=ROUNDING)
    still = section_around(_line_by_parameters(), IMPACT_ROWS, centre, scale)
    assert still.drift.shape == (2, 0)


def test_a_state_is_projected_to_the_nearest_one_in_scaled_states() -> None:
    line: Any = _line_by_parameters()
    found = project_to_section(line, IMPACT_ROWS, np.array([0.5, 0.5]), np.array([2.0, 0.5]))
    assert found == pytest.approx([0.5 - 16 / 17, 0.5 - 1 / 17], abs=ROUNDING)
    for start in ([1.2, 0.9], [-0.4, 0.3], [0.0, -1.5], [0.5, 0.0]):
        x = np.array(start)
        found = project_to_section(circle(gradient=_of_circle), IMPACT_ROWS, x, np.ones(2))
        assert found == pytest.approx(x / np.linalg.norm(x), abs=ROUNDING)


# The release section of machines.


@pytest.mark.parametrize("coordinates", [(0.0, 0.0), (1e-2, 0.0), (0.0, -1e-2), (0.03, 0.02)])
def test_states_of_the_section_are_releases(
    machine: HybridDynamics, coordinates: tuple[float, float]
) -> None:
    section = section_around(machine, RELEASE_ROWS, CENTRE, SCALE)
    assert section.dimension == 2
    x = section.state(machine, np.array(coordinates))
    assert machine.gap(x) == pytest.approx(0.0, abs=1e-14)
    assert machine.gap_rate(x) == pytest.approx(0.0, abs=1e-12)
    assert machine.multiplier(x) == pytest.approx(0.0, abs=1e-14)
    assert machine.multiplier_rate(x) < 0.0


@pytest.mark.parametrize("coordinates", [(0.0, 0.0), (1e-2, 0.0), (0.0, -1e-2), (0.03, 0.02)])
def test_coordinates_and_states_of_the_section_invert_each_other(
    machine: HybridDynamics, coordinates: tuple[float, float]
) -> None:
    section = section_around(machine, RELEASE_ROWS, CENTRE, SCALE)
    x = section.state(machine, np.array(coordinates))
    assert section.coordinates(x) == pytest.approx(np.array(coordinates), abs=1e-12)
    again = section.state(machine, section.coordinates(x))
    assert again == pytest.approx(x, abs=1e-12)


def test_the_centre_is_the_origin_of_its_chart(machine: HybridDynamics) -> None:
    section = section_around(machine, RELEASE_ROWS, CENTRE, SCALE)
    assert section.coordinates(CENTRE).tolist() == [0.0, 0.0]
    assert section.tangent.T @ section.tangent == pytest.approx(np.eye(2), abs=1e-12)


@pytest.mark.parametrize("time", [1e-6, 1.0, 1e6])
def test_conditions_of_far_different_sizes_are_all_kept(time: float) -> None:
    # Gap, gap rate, multiplier and clock leave no freedom; their gradients differ as their units.
    units = Units(time=time)
    table = in_units(load_problem("vibrating_table"), units)
    dynamics, values = table.dynamics(table.values()), table.values().parameters
    sine = values["g"] / (values["A"] * values["omega"] ** 2)
    release = np.array([0.0, 0.0, math.sqrt(1 - sine**2), sine])
    scale = np.array([0.01, 0.4 / time, 1.0, 1.0])
    assert section_around(dynamics, RELEASE_ROWS, release, scale).dimension == 0


def test_the_spectral_radius_is_the_largest_modulus() -> None:
    found = Multipliers(
        values=(0.6 + 0.8j, 0.5, -2.0), errors=(0.0,) * 3, jacobian=np.zeros((3, 3))
    )
    assert found.spectral_radius == 2.0
    assert replace(found, values=(0.3 + 0.4j, 0.1)).spectral_radius == 0.5
