"""The release section, the return map on it, and multipliers that are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import MULTIPLIER, PERIOD, RELEASE, ZENO_STATE
from tests.support.mechanisms import clocked_oscillator, oscillator_state
from tests.support.units import Units, in_units
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import HybridDynamics, Problem, load_problem
from zeno_orbits.orbits import (
    IMPACT_ROWS,
    RELEASE_ROWS,
    REST_ROWS,
    EventSequence,
    Multipliers,
    orbit_multipliers,
    poincare,
    poincare_jacobian,
    poincare_map,
    release_section,
    rows_of,
    to_next_release,
)
from zeno_orbits.simulation import SimulationSettings, simulate

SETTINGS = SimulationSettings()
SCALE = np.maximum(np.abs(RELEASE), np.abs(ZENO_STATE)) + 1e-3
CENTRE = np.array(RELEASE)


@pytest.fixture(name="multipliers", scope="module")
def _multipliers(machine: HybridDynamics) -> Multipliers:
    return orbit_multipliers(machine, CENTRE, scale=SCALE, period=PERIOD, settings=SETTINGS)


@pytest.mark.parametrize("coordinates", [(0.0, 0.0), (1e-2, 0.0), (0.0, -1e-2), (0.03, 0.02)])
def test_states_of_the_section_are_releases(
    machine: HybridDynamics, coordinates: tuple[float, float]
) -> None:
    section = release_section(machine, CENTRE, SCALE)
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
    section = release_section(machine, CENTRE, SCALE)
    x = section.state(machine, np.array(coordinates))
    assert section.coordinates(x) == pytest.approx(np.array(coordinates), abs=1e-12)
    again = section.state(machine, section.coordinates(x))
    assert again == pytest.approx(x, abs=1e-12)


def test_the_centre_is_the_origin_of_its_chart(machine: HybridDynamics) -> None:
    section = release_section(machine, CENTRE, SCALE)
    assert section.coordinates(CENTRE).tolist() == [0.0, 0.0]
    assert section.tangent.T @ section.tangent == pytest.approx(np.eye(2), abs=1e-12)


def test_the_orbit_is_a_fixed_point_of_the_return_map(machine: HybridDynamics) -> None:
    time, x = poincare_map(machine, CENTRE, horizon=2 * PERIOD, settings=SETTINGS)
    assert time == pytest.approx(PERIOD, abs=1e-10)
    assert x == pytest.approx(CENTRE, abs=1e-10)


def test_a_horizon_before_the_next_release_is_told(machine: HybridDynamics) -> None:
    with pytest.raises(SimulationError, match="No release follows") as caught:
        poincare_map(machine, CENTRE, horizon=0.9 * PERIOD, settings=SETTINGS)
    assert caught.value.time == 0.9 * PERIOD
    assert caught.value.state == tuple(RELEASE)


def test_the_pendulum_has_the_declared_multipliers(multipliers: Multipliers) -> None:
    large, small = multipliers.values
    assert large == pytest.approx(MULTIPLIER, abs=1e-6)
    assert small == pytest.approx(0.0, abs=1e-6)
    assert multipliers.error < 1e-6
    assert multipliers.spectral_radius == abs(large)


def test_the_multipliers_do_not_depend_on_the_units(
    machine: HybridDynamics, multipliers: Multipliers
) -> None:
    stretched = SCALE * np.array([3.0, 0.5, 0.4, 2.0, 5.0])
    other = orbit_multipliers(machine, CENTRE, scale=stretched, period=PERIOD, settings=SETTINGS)
    # Other displacements, so other errors: each below 1e-6.
    assert other.values[0] == pytest.approx(multipliers.values[0], abs=1e-6)
    assert other.values[1] == pytest.approx(multipliers.values[1], abs=1e-6)


def test_a_small_change_shrinks_by_the_multiplier(
    machine: HybridDynamics, multipliers: Multipliers
) -> None:
    section = release_section(machine, CENTRE, SCALE)
    _, vectors = np.linalg.eig(multipliers.jacobian)
    values = np.linalg.eigvals(multipliers.jacobian)
    direction = np.real(vectors[:, int(np.argmax(np.abs(values)))])
    distance = 1e-4
    start = section.state(machine, distance * direction)
    _, end = poincare_map(machine, start, horizon=2 * PERIOD, settings=SETTINGS)
    # The next order is the distance itself.
    expected = distance * direction * multipliers.values[0].real
    assert section.coordinates(end) == pytest.approx(expected, abs=10 * distance**2)


def test_a_locked_arc_forgets_the_current(problem: Problem) -> None:
    # With R / L = 1500 a second, the locked arc of half a second forgets it to exp(-700): one
    # multiplier is zero. At e = 0 this is the whole of the second one.
    values = problem.values(parameters={"restitution": 0.0})
    dynamics = problem.dynamics(values)
    settled = CENTRE
    for _ in range(8):
        _, settled = poincare_map(dynamics, settled, horizon=2 * PERIOD, settings=SETTINGS)
    found = orbit_multipliers(dynamics, settled, scale=SCALE, period=PERIOD, settings=SETTINGS)
    assert abs(found.values[1]) < 1e-6
    assert abs(found.values[0]) < 1.0
    assert abs(np.linalg.det(found.jacobian)) < 1e-6


def _clocked(*, attracting: bool, by_differences: bool = False, noise: float = 0.0) -> Multipliers:
    problem = clocked_oscillator(FORCED, attracting=attracting)
    dynamics = problem.dynamics(problem.values())
    if by_differences:
        dynamics = replace(dynamics, differentiation=None)
    release = np.array(oscillator_state(FORCED.release_time, FORCED.stop, 0.0))
    return orbit_multipliers(
        dynamics, release, scale=np.ones(4), period=2 * math.pi, settings=SETTINGS, noise=noise
    )


def test_a_clock_that_attracts_has_its_multiplier_in_closed_form() -> None:
    # y'' = -y + y' (1 - y^2 - y'^2) shrinks areas of (y, y') on its circle at the rate -2 y'^2,
    # whose integral over a turn is -2 pi. Nothing else is left of a locked mass.
    found = _clocked(attracting=True)
    assert len(found.values) == 1
    assert found.values[0] == pytest.approx(math.exp(-2 * math.pi), abs=1e-11)
    assert found.error < 1e-10


def test_differences_tell_the_same_multiplier_less_well() -> None:
    found = _clocked(attracting=True, by_differences=True)
    assert found.values[0] == pytest.approx(math.exp(-2 * math.pi), abs=1e-8)
    # The error is that of the coarser difference: its distance from the exact value.
    assert found.error < 1e-4


def test_a_clock_that_keeps_any_amplitude_has_the_multiplier_one() -> None:
    found = _clocked(attracting=False)
    assert found.values[0] == pytest.approx(1.0, abs=1e-11)


def test_a_state_that_does_not_return_is_told(machine: HybridDynamics) -> None:
    blind = replace(machine, multiplier_rate=lambda _: 1.0)
    with pytest.raises(SimulationError):
        orbit_multipliers(blind, CENTRE, scale=SCALE, period=PERIOD / 3, settings=SETTINGS)


def test_waiting_for_a_return_sees_what_a_longer_simulation_sees(machine: HybridDynamics) -> None:
    short = to_next_release(machine, CENTRE, horizon=2 * PERIOD, settings=SETTINGS)
    long = simulate(machine, CENTRE, until=2 * PERIOD, settings=SETTINGS)
    first, second = short.returns(2 * PERIOD)[0], long.returns(2 * PERIOD)[0]
    # The same steps in the same order: nothing but the end differs.
    assert first.time == second.time
    assert np.array_equal(first.state, second.state)
    assert short.end_time == first.time < long.end_time


def test_a_start_that_is_locked_for_a_moment_waits_for_the_return_after_it(
    machine: HybridDynamics,
) -> None:
    # A little before the release the multiplier still holds, and lets go at once.
    moment = 1e-9
    start = machine.on_stop(CENTRE - moment * machine.locked.rate(CENTRE))
    execution = to_next_release(machine, start, horizon=2 * PERIOD, settings=SETTINGS)
    first, second = execution.releases
    assert first.time == pytest.approx(moment, rel=1e-3)
    assert second.time == pytest.approx(PERIOD + moment, abs=1e-8)
    assert execution.end_time == second.time


def test_a_motion_without_a_return_is_followed_to_the_horizon(machine: HybridDynamics) -> None:
    execution = to_next_release(machine, CENTRE, horizon=PERIOD / 2, settings=SETTINGS)
    assert not execution.releases
    assert execution.end_time == pytest.approx(PERIOD / 2)


@pytest.mark.parametrize("time", [1e-6, 1.0, 1e6])
def test_conditions_of_far_different_sizes_are_all_kept(time: float) -> None:
    # Gap, gap rate, multiplier and clock leave no freedom; their gradients differ as their units.
    units = Units(time=time)
    table = in_units(load_problem("vibrating_table"), units)
    dynamics, values = table.dynamics(table.values()), table.values().parameters
    sine = values["g"] / (values["A"] * values["omega"] ** 2)
    release = np.array([0.0, 0.0, math.sqrt(1 - sine**2), sine])
    scale = np.array([0.01, 0.4 / time, 1.0, 1.0])
    assert release_section(dynamics, release, scale).dimension == 0


@pytest.mark.parametrize(
    ("restitution", "rows"), [(0.0, REST_ROWS), (0.3, IMPACT_ROWS), (1.0, IMPACT_ROWS)]
)
def test_a_period_from_an_impact_starts_on_the_stop_and_at_rest_after_a_plastic_one(
    restitution: float, rows: tuple[int, ...]
) -> None:
    assert rows_of(EventSequence.parsed("impact"), restitution) == rows
    assert rows_of(EventSequence.parsed("zeno"), restitution) == RELEASE_ROWS


def test_the_slope_of_a_system_without_formulas_is_that_of_differences(
    machine: HybridDynamics,
) -> None:
    given = {"scale": SCALE, "period": PERIOD, "settings": SETTINGS}
    blind = replace(machine, differentiation=None)
    exact = poincare.poincare_jacobian(machine, CENTRE, **given)
    # The fourth order in the step of 2e-5 leaves the noise of a return, 1e-12, over it.
    assert poincare.poincare_jacobian(blind, CENTRE, **given) == pytest.approx(exact, abs=1e-6)


def test_a_section_that_is_a_point_has_no_multipliers_by_differences_either() -> None:
    table = load_problem("vibrating_table")
    dynamics, values = table.dynamics(table.values()), table.values().parameters
    sine = values["g"] / (values["A"] * values["omega"] ** 2)
    release = np.array([0.0, 0.0, math.sqrt(1 - sine**2), sine])
    found = orbit_multipliers(
        replace(dynamics, differentiation=None),
        release,
        scale=np.array([0.01, 0.4, 1.0, 1.0]),
        period=2 * math.pi / values["omega"],
        settings=SETTINGS,
    )
    assert found.values == ()
    assert found.spectral_radius == 0.0
    # No multiplier, no error; noise that is not told is none.
    assert found.error == 0.0


def test_the_spectral_radius_is_the_largest_modulus() -> None:
    found = Multipliers(
        values=(0.6 + 0.8j, 0.5, -2.0), errors=(0.0,) * 3, jacobian=np.zeros((3, 3))
    )
    assert found.spectral_radius == 2.0
    assert replace(found, values=(0.3 + 0.4j, 0.1)).spectral_radius == 0.5


@pytest.mark.parametrize("exact", [True, False])
def test_a_return_is_waited_for_twice_as_long_as_the_period_that_is_given(*, exact: bool) -> None:
    problem = clocked_oscillator(FORCED, attracting=True)
    dynamics = problem.dynamics(problem.values())
    dynamics = dynamics if exact else replace(dynamics, differentiation=None)
    x = np.array(oscillator_state(FORCED.release_time, FORCED.stop, 0.0))
    given = {"scale": np.ones(4), "settings": SETTINGS}
    found = poincare_jacobian(dynamics, x, period=0.55 * 2 * math.pi, **given)
    assert found[0, 0] == pytest.approx(math.exp(-2 * math.pi), abs=1e-8)
    with pytest.raises(SimulationError):
        poincare_jacobian(dynamics, x, period=0.45 * 2 * math.pi, **given)
