"""Exact derivatives of a return, held against differences, closed forms and other engines."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import DOP853

from tests.reference.closed_forms import COCO, FORCED, StoppedOscillator
from tests.reference.reference_orbit import MULTIPLIER, PERIOD, RELEASE
from tests.support.executions import execution_of
from tests.support.families import BALL, OSCILLATOR
from tests.support.mechanisms import clocked_oscillator, oscillator_state
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.integrators import Engine, Radau, RungeKutta, SciPy, Tolerance
from zeno_orbits.model import (
    GAP,
    GAP_RATE,
    HybridDynamics,
    HybridLagrangian,
    Problem,
    hybrid_system,
    load_problem,
    no_drive,
)
from zeno_orbits.orbits import (
    PhaseKind,
    ReturnDerivative,
    differentials_of,
    first_return,
    monodromy,
    orbit_multipliers,
    phases_of,
    poincare_jacobian,
    poincare_map,
    release_section,
    return_derivative,
    section_jacobian,
    to_next_release,
)
from zeno_orbits.simulation import (
    Ending,
    EventDerivatives,
    Impact,
    SaltationDerivative,
    SimulationSettings,
    Truncation,
    ZenoExtrapolation,
    simulate,
)

SETTINGS = SimulationSettings()
CENTRE = np.array(RELEASE)
SCALE = np.ones(5)
STEP = 1e-4
"""Displacement of differences of fourth order: 1e-16 of truncation, 1e-12 / 1e-4 of integration."""
OF_DIFFERENCES = 1e-8


def numbers_of(derivative: ReturnDerivative) -> Vector:
    """Return end state, then period, Zeno time, locked time, gap acceleration, first rate."""
    d = derivative
    special = (d.period, d.zeno_time, d.locked_time, d.gap_acceleration, d.first_rate)
    return np.append(d.end, [number.value for number in special])


def slopes_of(derivative: ReturnDerivative) -> tuple[Vector, Vector]:
    """Return the derivatives of the same, by state and by parameters."""
    d = derivative
    special = (d.period, d.zeno_time, d.locked_time, d.gap_acceleration, d.first_rate)
    return (
        np.concatenate([d.by_state, [number.by_state for number in special]]),
        np.concatenate([d.by_parameters, [number.by_parameters for number in special]]),
    )


def simulated(dynamics: HybridDynamics, x: Vector, horizon: float) -> Vector:
    """Return the same numbers by simulation alone."""
    run = to_next_release(dynamics, dynamics.on_stop(x), horizon=horizon, settings=SETTINGS)
    release, zeno = first_return(run), run.zeno_points[0]
    assert release is not None
    special = [
        release.time,
        zeno.time,
        release.time - zeno.time,
        dynamics.gap_acceleration(zeno.state),
        run.impacts[0].approach_rate,
    ]
    return np.append(release.state, special)


def differences(f: object, step: float = STEP) -> Vector:
    """Return the derivative of a function of a number at zero, to fourth order."""
    assert callable(f)
    near = (f(step) - f(-step)) / (2 * step)
    far = (f(2 * step) - f(-2 * step)) / (4 * step)
    return (4 * near - far) / 3


@pytest.fixture(name="derivative", scope="module")
def _derivative(machine: HybridDynamics) -> ReturnDerivative:
    return return_derivative(machine, CENTRE, horizon=2 * PERIOD, settings=SETTINGS)


# Against differences of the simulation.


@pytest.mark.parametrize("direction", [0, 1])
def test_a_return_and_its_special_quantities_move_as_differences_say(
    machine: HybridDynamics, derivative: ReturnDerivative, direction: int
) -> None:
    section = release_section(machine, CENTRE, SCALE)
    one = np.eye(2)[direction]
    measured = differences(
        lambda s: simulated(machine, section.state(machine, s * one), 2 * PERIOD)
    )
    by_state, _ = slopes_of(derivative)
    assert by_state @ section.tangent @ one == pytest.approx(measured, abs=OF_DIFFERENCES)


@pytest.mark.parametrize("name", ["Kp", "Kd", "restitution", "L", "m2", "g"])
def test_parameters_move_a_return_as_differences_say(problem: Problem, name: str) -> None:
    values = np.array(problem.values().vector)
    place = problem.names.index(name)
    machine = problem.dynamics(values)
    # Not on the orbit, and off the slow manifold: the start must fly whatever the parameters are.
    x = machine.on_stop(CENTRE + 1e-2 * (machine.free.rate(CENTRE)))
    x = x + np.array([0.0, 0.0, 0.0, 0.0, -1e-2])
    derivative = return_derivative(
        machine, x, horizon=2 * PERIOD, settings=SETTINGS, parameters=(place,)
    )

    def moved(part: float) -> Vector:
        p = values.copy()
        p[place] *= 1 + part
        return simulated(problem.dynamics(p), x, 2 * PERIOD)

    _, by_parameters = slopes_of(derivative)
    measured = differences(moved, 1e-4) / values[place]
    tolerance = OF_DIFFERENCES * (1 + 1 / abs(values[place]))
    assert by_parameters[:, 0] == pytest.approx(measured, rel=1e-7, abs=tolerance)


def test_the_values_are_those_of_the_simulation(
    machine: HybridDynamics, derivative: ReturnDerivative
) -> None:
    # The impacts are made one by one here, and so they are there at e = 0.2: the same numbers.
    assert numbers_of(derivative).tolist() == simulated(machine, CENTRE, 2 * PERIOD).tolist()


def test_at_fixed_coordinates_a_release_stays_one_whatever_the_gains(problem: Problem) -> None:
    values = np.array(problem.values().vector)
    machine = problem.dynamics(values)
    places = tuple(problem.names.index(name) for name in ("Kp", "m2"))
    derivative = return_derivative(
        machine, CENTRE, horizon=2 * PERIOD, settings=SETTINGS, parameters=places
    )
    section = release_section(machine, CENTRE, SCALE)
    on_section = section_jacobian(machine, derivative, SCALE)
    for k, place in enumerate(places):

        def moved(part: float, place: int = place) -> Vector:
            p = values.copy()
            p[place] += part
            other = problem.dynamics(p)
            start = section.state(other, np.zeros(2))
            numbers = simulated(other, start, 2 * PERIOD)
            return np.concatenate([section.coordinates(numbers[:5]), numbers[5:6], start])

        # So small that no start locks: the multiplier falls fast enough here for 1e-4 of a gain.
        measured = differences(moved, 1e-5)
        assert on_section.by_parameters[:, k] == pytest.approx(measured[:2], abs=1e-6)
        assert on_section.of(derivative.period)[2 + k] == pytest.approx(measured[2], abs=1e-6)
        assert on_section.lift[:, 2 + k] == pytest.approx(measured[3:], abs=1e-6)


def test_a_plastic_impact_has_a_derivative_of_rank_one(problem: Problem) -> None:
    values = problem.values(parameters={"restitution": 0.0})
    machine = problem.dynamics(values)
    derivative = return_derivative(machine, CENTRE, horizon=2 * PERIOD, settings=SETTINGS)
    section = release_section(machine, CENTRE, SCALE)
    jacobian = section_jacobian(machine, derivative, SCALE).jacobian
    measured = np.transpose(
        [
            differences(
                lambda s, one=one: section.coordinates(
                    simulated(machine, section.state(machine, s * one), 2 * PERIOD)[:5]
                )
            )
            for one in np.eye(2)
        ]
    )
    assert jacobian == pytest.approx(measured, abs=OF_DIFFERENCES)
    # The locked arc forgets the current to exp(-700).
    sizes = np.linalg.svd(jacobian, compute_uv=False)
    assert sizes[1] < 1e-12 < 1e-2 < sizes[0]


def test_restitution_moves_a_plastic_return_to_one_side(problem: Problem) -> None:
    place = problem.names.index("restitution")
    values = np.array(problem.values(parameters={"restitution": 0.0}).vector)

    def at(e: float) -> Vector:
        p = values.copy()
        p[place] = e
        return simulated(problem.dynamics(p), CENTRE, 2 * PERIOD)

    machine = problem.dynamics(values)
    derivative = return_derivative(
        machine, CENTRE, horizon=2 * PERIOD, settings=SETTINGS, parameters=(place,)
    )
    _, by_parameters = slopes_of(derivative)
    step = 1e-6
    # One-sided, of second order; the flights grow with e, and their next order with them.
    measured = (4 * at(step) - 3 * at(0.0) - at(2 * step)) / (2 * step)
    assert by_parameters[:, 0] == pytest.approx(measured, abs=2e-5, rel=2e-5)


# Against other engines, closures and tolerances.


@pytest.mark.parametrize(
    "engine", [RungeKutta(), SciPy(method=DOP853), Radau()], ids=lambda e: type(e).__name__
)
def test_every_engine_has_the_same_derivative(
    machine: HybridDynamics, derivative: ReturnDerivative, engine: Engine
) -> None:
    settings = replace(SETTINGS, engine=engine)
    other = return_derivative(machine, CENTRE, horizon=2 * PERIOD, settings=settings)
    for mine, theirs in zip(slopes_of(derivative), slopes_of(other), strict=True):
        # SciPy's steps are good to 1e-11 a period; the gap acceleration magnifies most.
        assert mine == pytest.approx(theirs, rel=1e-9, abs=1e-9)


def test_implicit_steps_have_the_derivative_of_explicit_ones(problem: Problem) -> None:
    values = problem.values(parameters={"L": 1e-4})
    machine = problem.dynamics(values)
    x = CENTRE.copy()
    for _ in range(6):
        _, x = poincare_map(machine, x, horizon=2 * PERIOD, settings=SETTINGS)
    by_automatic = return_derivative(machine, x, horizon=2 * PERIOD, settings=SETTINGS)
    kinds = {
        type(step).__name__
        for arc in by_automatic.execution.arcs
        for step in getattr(arc.trajectory, "steps", ())
    }
    assert kinds == {"ExplicitStep", "RadauStep"}
    settings = replace(SETTINGS, engine=RungeKutta())
    by_steps = return_derivative(machine, x, horizon=2 * PERIOD, settings=settings)
    tangent = release_section(machine, x, SCALE).tangent
    implicit, explicit = slopes_of(by_automatic)[0] @ tangent, slopes_of(by_steps)[0] @ tangent
    # In the section a small current goes with R / L = 30000 1/s: sizes are taken by the column.
    size = np.max(np.abs(explicit), axis=0)
    assert implicit / size == pytest.approx(explicit / size, abs=1e-9)


def test_a_rule_that_cuts_the_sequence_is_not_differentiated(
    machine: HybridDynamics, derivative: ReturnDerivative
) -> None:
    settings = replace(SETTINGS, completion=Truncation(delta=1e-2))
    other = return_derivative(machine, CENTRE, horizon=2 * PERIOD, settings=settings)
    assert np.array_equal(other.by_state, derivative.by_state)


@pytest.mark.parametrize("exponent", [-4, -6, -8, -10, -12])
def test_the_error_of_the_multipliers_bounds_the_true_one(
    machine: HybridDynamics, exponent: int
) -> None:
    tolerance = Tolerance(relative=10.0**exponent, absolute=10.0 ** (exponent - 1))
    completion = ZenoExtrapolation(tolerance=10.0**exponent)
    settings = SimulationSettings(tolerance=tolerance, completion=completion)
    scale = np.abs(CENTRE) + 1e-3
    found = orbit_multipliers(machine, CENTRE, scale=scale, period=PERIOD, settings=settings)
    # Seven digits are known.
    assert abs(found.values[0] - MULTIPLIER) <= found.error + 5e-8
    finest = poincare_jacobian(machine, CENTRE, scale=scale, period=PERIOD, settings=SETTINGS)
    true = np.linalg.eigvals(finest)
    off = max(float(np.min(np.abs(true - value))) for value in found.values)
    assert off <= found.error
    assert found.error < 10.0 ** (exponent + 2.5)


# What a period is made of.


def _monodromy_matrix(dynamics: HybridDynamics, derivative: ReturnDerivative) -> Vector:
    r"""Return the state transition over a period of fixed length, ``(n_x, n_x)``.

    .. math:: \Phi(T) = \frac{\partial P}{\partial x} - f(P)\,\frac{\partial T}{\partial x}

    On a periodic orbit its eigenvalues are 1, for :math:`f` itself, the multipliers, and zeros.
    """
    along = dynamics.locked.rate(derivative.end)
    return derivative.by_state - np.outer(along, derivative.period.by_state)


def test_the_monodromy_matrix_keeps_the_flow_and_forgets_what_leaves_the_stop(
    machine: HybridDynamics, derivative: ReturnDerivative
) -> None:
    whole = _monodromy_matrix(machine, derivative)
    along = machine.free.rate(CENTRE)
    # The orbit closes to 1e-12, and its flow with it times R / L.
    assert whole @ along == pytest.approx(along, rel=1e-8, abs=1e-8)
    values = sorted(np.linalg.eigvals(whole), key=abs, reverse=True)
    assert values[0] == pytest.approx(1.0, abs=1e-9)
    assert values[1] == pytest.approx(MULTIPLIER, abs=5e-8)
    assert [abs(value) for value in values[2:]] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_a_return_ends_in_the_section_whatever_the_start(
    machine: HybridDynamics, derivative: ReturnDerivative
) -> None:
    gradient = differentials_of(machine, ()).contact(derivative.end)[[0, 1, 3]]
    assert gradient @ derivative.by_state == pytest.approx(np.zeros((3, 5)), abs=1e-9)


def _saltation_matrix(dynamics: HybridDynamics, impact: Impact) -> Vector:
    r"""Return the matrix by which an impact multiplies a perturbation at equal time.

    .. math:: \Xi = R_x + \frac{(f(x^+) - R_x f(x^-))\,\nabla h^\top}{\dot h^-}, \qquad
        R_x = \frac{\partial R}{\partial x}

    Source: [LeineNijmeijer2004]_, theory (4.3).
    """
    differentials = differentials_of(dynamics, ())
    x, n_x = impact.state_minus, len(impact.state_minus)
    contact = differentials.contact(x)
    reset = differentials.reset(x, impact.approach_rate)
    jump = reset[:, :n_x] + reset[:, n_x, None] * contact[GAP_RATE]
    before, after = dynamics.free.rate(x), dynamics.free.rate(impact.state_plus)
    return jump + (after - jump @ before)[:, None] * contact[GAP] / impact.approach_rate


@pytest.mark.parametrize("oscillator", [FORCED, COCO])
def test_an_impact_on_an_oscillator_has_its_saltation_matrix_in_closed_form(
    oscillator: StoppedOscillator,
) -> None:
    problem = clocked_oscillator(oscillator, attracting=False)
    machine = problem.dynamics(problem.values())
    time, stop, e = 0.4, oscillator.stop, oscillator.restitution
    x_minus = np.array(oscillator_state(time, stop, 1.3))
    x_plus = np.array(oscillator_state(time, stop, -e * 1.3))
    impact = Impact(time=0.0, state_minus=x_minus, state_plus=x_plus, approach_rate=-1.3)

    def force(v: float) -> float:
        return math.cos(time) - oscillator.damping * v - stop

    # x+ = x, v+ = -e v: the rows of x and v; what the clock does not feel, it keeps.
    expected = np.eye(4)
    expected[0, 0] = expected[2, 2] = -e
    expected[2, 0] = (force(-e * 1.3) + e * force(1.3)) / 1.3
    found = _saltation_matrix(machine, impact)
    assert found == pytest.approx(expected, abs=1e-14)
    assert np.linalg.det(found) == pytest.approx(e**2, rel=1e-14)


def test_the_impact_oscillator_of_coco_has_its_published_multipliers() -> None:
    # Recipes for Continuation, chapter 15: phase and velocity after the impact, multipliers.
    phase, velocity = 0.07595216493831239, -1.3565863500759056
    problem = clocked_oscillator(COCO, attracting=False)
    machine = problem.dynamics(problem.values())
    start = np.array(oscillator_state(phase, COCO.stop, velocity))
    run = simulate(machine, start, until=6.5)
    (arc, impact) = (run.arcs[0], run.impacts[0])
    assert arc.ending is Ending.IMPACT
    assert impact.time == pytest.approx(2 * math.pi, abs=1e-12)
    assert impact.state_plus == pytest.approx(start, abs=1e-12)
    after = next(EventDerivatives(machine, (), SETTINGS.tolerance).passages(run)).after
    # Perturbations that stay on the stop: velocity, and the clock's phase and amplitude.
    reduced = after.state[np.ix_([1, 2, 3], [1, 2, 3])]
    values = sorted(np.linalg.eigvals(reduced), key=lambda value: (value.real, value.imag))
    published = complex(-0.58429531434153, 0.00560035149247)
    assert values[0] == pytest.approx(published.conjugate(), abs=1e-12)
    assert values[1] == pytest.approx(published, abs=1e-12)
    assert values[2] == pytest.approx(1.0, abs=1e-12)
    product = COCO.restitution**2 * math.exp(-COCO.damping * 2 * math.pi)
    assert (values[0] * values[1]).real == pytest.approx(product, rel=1e-12)


def _zeno_shift(
    machine: HybridDynamics, x: Vector, parameters: tuple[int, ...]
) -> SaltationDerivative:
    """Return how the Zeno point of a ball moves."""
    settings = replace(SETTINGS, completion=ZenoExtrapolation())
    run = simulate(machine, x, until=1e4, settings=settings)
    *_, last = EventDerivatives(machine, parameters, SETTINGS.tolerance).passages(run)
    return last.start


@pytest.mark.parametrize("e", [0.0, 0.2, 0.5, 0.8, 0.95, 0.99])
def test_the_zeno_time_of_a_ball_moves_as_its_closed_form(e: float) -> None:
    height, velocity, g = 1.3, 0.4, 9.81
    machine = BALL.at(m=0.7, g=g, c=0.0, e=e)
    shift = _zeno_shift(machine, np.array([height, velocity]), (1, 3))
    # t = v/g + u/g (1 + e)/(1 - e) with the speed u of the first impact, u^2 = v^2 + 2 g h.
    u, factor = math.sqrt(velocity**2 + 2 * g * height), (1 + e) / (1 - e)
    by_height = factor / u
    by_velocity = 1 / g + factor * velocity / (g * u)
    by_gravity = -velocity / g**2 + factor * (height / (g * u) - u / g**2)
    by_restitution = 2 * u / (g * (1 - e) ** 2)
    expected = [by_height, by_velocity, by_gravity, by_restitution]
    # The impacts before the last are one flight each, and the sum of their errors 1 / (1 - e).
    assert shift.time == pytest.approx(expected, rel=1e-12 / (1 - e))
    # The ball lies where the floor is.
    assert shift.state == pytest.approx(np.zeros((2, 4)), abs=1e-12 / (1 - e))


@pytest.mark.parametrize("e", [0.5, 0.9, 0.95])
def test_a_clock_that_is_not_acted_on_has_its_multiplier_whatever_the_restitution(e: float) -> None:
    # Its circle attracts with exp(-2 pi) a turn, see tests/orbits/test_poincare.py.
    problem = clocked_oscillator(replace(FORCED, restitution=e), attracting=True)
    machine = problem.dynamics(problem.values())
    x = np.array(oscillator_state(FORCED.release_time, FORCED.stop, 0.0))
    found = orbit_multipliers(machine, x, scale=np.ones(4), period=2 * math.pi, settings=SETTINGS)
    assert found.values[0] == pytest.approx(math.exp(-2 * math.pi), abs=1e-11 / (1 - e))
    assert abs(found.values[0] - math.exp(-2 * math.pi)) <= found.error


def test_frequency_and_stop_move_the_return_of_a_forced_oscillator() -> None:
    numbers = {"k": 1.0, "c": 1.9, "force": 1.0, "omega": 1.0, "stop": -0.8, "e": 0.5}
    names = list(OSCILLATOR.parameters)
    x = np.array(oscillator_state(FORCED.release_time + 1e-3, FORCED.stop, 0.0))
    machine = OSCILLATOR.at(**numbers)
    derivative = return_derivative(
        machine, x, horizon=9.0, settings=SETTINGS, parameters=tuple(range(len(names)))
    )
    _, by_parameters = slopes_of(derivative)
    for k, name in enumerate(names):
        if name == "stop":
            # The start would have to move along.
            continue
        measured = differences(
            lambda s, name=name: simulated(
                OSCILLATOR.at(**{**numbers, name: numbers[name] + s}), x, 9.0
            )
        )
        assert by_parameters[:, k] == pytest.approx(measured, abs=OF_DIFFERENCES), name


RATE = 0.05
"""How strongly the clock on a circle returns to its speed."""


def _clock_on_a_circle() -> Problem:
    """Return the forced oscillator, its clock a bead on a circle: a holonomic constraint."""

    def model(p: Mapping[str, ca.SX]) -> object:
        q, v = ca.SX.sym("q", 3), ca.SX.sym("v", 3)
        bead = v[1:]
        kept = RATE * (1 - ca.sumsqr(bead)) * bead
        mechanism = HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=q[0] ** 2 / 2,
            gap=FORCED.stop - q[0],
            passive_force=ca.vertcat(q[1] - FORCED.damping * v[0], kept),
            holonomic=ca.sumsqr(q[1:]) - 1,
        )
        return hybrid_system(mechanism, no_drive(mechanism), p["restitution"])

    names = ("x", "y", "z", "dx", "dy", "dz")
    return replace(
        clocked_oscillator(FORCED, attracting=True),
        model=model,
        state_names=names,
        state_units=("m",) * 3 + ("m/s",) * 3,
        starts=({"x": FORCED.stop, "y": 1.0},),
    )


def test_a_holonomic_constraint_takes_its_two_dimensions_from_the_section() -> None:
    problem = _clock_on_a_circle()
    machine = problem.dynamics(problem.values())
    t = FORCED.release_time
    x = np.array([FORCED.stop, math.cos(t), math.sin(t), 0.0, -math.sin(t), math.cos(t)])
    derivative = return_derivative(machine, x, horizon=9.0, settings=SETTINGS)
    assert derivative.period.value == pytest.approx(2 * math.pi, abs=1e-10)
    jacobian = section_jacobian(machine, derivative, np.ones(6)).jacobian
    assert jacobian.shape == (1, 1)
    # The bead's speed u obeys u' = RATE (1 - u^2) u, with the slope -2 RATE at 1.
    expected = math.exp(-2 * RATE * 2 * math.pi)
    assert jacobian[0, 0] == pytest.approx(expected, abs=1e-10)


# Starts and systems that have no derivative, or not the plain one.


def test_a_start_that_locks_for_a_while_flies_from_its_release(machine: HybridDynamics) -> None:
    moment = 2e-4
    x = machine.on_stop(CENTRE - moment * machine.locked.rate(CENTRE))
    derivative = return_derivative(machine, x, horizon=2 * PERIOD, settings=SETTINGS)
    assert derivative.period.value == pytest.approx(PERIOD + moment, abs=1e-6)
    along = machine.locked.rate(x)
    # Along its flow the start moves the time alone.
    assert derivative.period.by_state @ along == pytest.approx(-1.0, abs=1e-9)
    assert derivative.by_state @ along == pytest.approx(np.zeros(5), abs=1e-7)
    section = release_section(machine, x, SCALE)
    one = section.tangent[:, 0]
    measured = differences(lambda s: simulated(machine, machine.on_stop(x + s * one), 2 * PERIOD))
    assert slopes_of(derivative)[0] @ one == pytest.approx(measured, rel=1e-6, abs=1e-6)


def test_a_model_without_formulas_has_no_exact_derivative(machine: HybridDynamics) -> None:
    softer = replace(machine, reset_map=lambda x, r: machine.reset_map(x, 0.999 * r))
    assert machine.differentiation is not None
    assert softer.differentiation is None
    with pytest.raises(InputError, match="must have formulas"):
        return_derivative(softer, CENTRE, horizon=4.0, settings=SETTINGS)


def test_differences_see_a_replaced_part_that_formulas_would_not(machine: HybridDynamics) -> None:
    wrong = replace(machine, reset_map=lambda x, r: machine.reset_map(x, 1.05 * r))
    true, seen = (
        poincare_jacobian(each, CENTRE, scale=SCALE, period=PERIOD, settings=SETTINGS)
        for each in (machine, wrong)
    )
    assert np.max(np.abs(true - seen)) > 1e-3


def test_a_motion_without_a_return_has_no_derivative(machine: HybridDynamics) -> None:
    with pytest.raises(SimulationError, match="No release follows"):
        return_derivative(machine, CENTRE, horizon=0.5 * PERIOD, settings=SETTINGS)


def test_a_fall_that_a_plastic_table_throws_off_moves_the_return_behind_it() -> None:
    table = load_problem("vibrating_table")
    values = table.values(parameters={"A": 0.048, "restitution": 0.0})
    names = list(table.names)
    chosen = tuple(names.index(name) for name in ("A", "omega"))
    vector = np.array(values.vector)
    machine = table.dynamics(values)
    numbers = values.parameters
    # Just after the release at the sine g / (A omega^2), so that it flies whatever moves.
    phase = math.asin(numbers["g"] / (numbers["A"] * numbers["omega"] ** 2)) + 1e-3

    def released(angle: float) -> Vector:
        return np.array([0.0, 0.0, math.cos(angle), math.sin(angle)])

    x = released(phase)
    derivative = return_derivative(machine, x, horizon=3.0, settings=SETTINGS, parameters=chosen)
    assert [phase.kind for phase in phases_of(derivative.execution, x)] == [
        PhaseKind.IMPACT,
        PhaseKind.PLASTIC,
    ]
    assert derivative.parameters == chosen
    assert numbers_of(derivative) == pytest.approx(simulated(machine, x, 3.0), abs=1e-12)
    by_state, by_parameters = slopes_of(derivative)
    for k, place in enumerate(chosen):

        def moved(part: float, place: int = place) -> Vector:
            p = vector.copy()
            p[place] += part
            return simulated(table.dynamics(p), x, 3.0)

        # The time of the return, 0.3 s, turns the clock by 4e-4: the fourth power is no more.
        step = 2e-4 * vector[place]
        size = np.maximum(np.abs(by_parameters[:, k]), 1.0)
        measured = differences(moved, step)
        assert by_parameters[:, k] / size == pytest.approx(measured / size, abs=1e-6)
    along = np.array([0.0, 0.0, -math.sin(phase), math.cos(phase)])
    turned = differences(lambda s: simulated(machine, released(phase + s), 3.0))
    assert by_state @ along == pytest.approx(turned, abs=1e-6)


# Executions made by hand.


def test_a_return_that_does_not_come_tells_the_horizon_and_its_start(
    machine: HybridDynamics,
) -> None:
    with pytest.raises(SimulationError, match="No release follows") as caught:
        return_derivative(machine, CENTRE, horizon=0.25, settings=SETTINGS)
    assert (caught.value.time, caught.value.state) == (0.25, tuple(RELEASE))


@pytest.mark.parametrize(
    ("legs", "first"),
    [
        ((("r", 2e-6), ("i", 1.0)), 1),
        ((("r", 2.1e-6), ("i", 1.0)), 0),
        ((("i", 1.0), ("r", 2.0)), 0),
    ],
)
def test_a_start_flies_at_once_if_it_locks_for_a_millionth_of_a_return(
    legs: tuple[tuple[str, float], ...], first: int
) -> None:
    assert monodromy.first_that_counts(execution_of(*legs), 2.0) == first
