"""Returns to the release and their exact derivatives, against closed forms and differences."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import DOP853

from tests.reference.closed_forms import COCO, FORCED, StoppedOscillator
from tests.reference.reference_orbit import MULTIPLIER, PERIOD, RELEASE
from tests.support.families import BALL, OSCILLATOR
from tests.support.mechanisms import clocked_oscillator, forced_oscillator, oscillator_state
from tests.support.returns import multipliers_at, next_release, release_return, release_section
from zeno_orbits import HybridLagrangian, hybrid_system, no_drive
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.integrators import Engine, Radau, RungeKutta, SciPy, Tolerance
from zeno_orbits.model import GAP, GAP_ACCELERATION, GAP_RATE, HybridDynamics, Problem, load_problem
from zeno_orbits.orbits import (
    EventReturn,
    Orbit,
    derivative_of_return,
    differentials_of,
    event_return,
)
from zeno_orbits.simulation import (
    Ending,
    EventDerivatives,
    Impact,
    SaltationDerivative,
    SimulationSettings,
    Truncation,
    ZenoExtrapolation,
    ZenoPoint,
    change_of,
    simulate,
)
from zeno_orbits.verification import VerificationSettings, multipliers_of, verify

SETTINGS = SimulationSettings()
TURN = 2 * math.pi
CENTRE = np.array(RELEASE)
SCALE = np.ones(5)
STEP = 1e-4
"""Displacement of differences of fourth order: 1e-16 of truncation, 1e-12 / 1e-4 of integration."""
OF_DIFFERENCES = 1e-8


def numbers_of(found: EventReturn) -> Vector:
    """Return end state, then period, Zeno time, contact duration, gap acceleration, first rate."""
    zeno = next(event for event in found.events if isinstance(event, ZenoPoint))
    first = next(event for event in found.events if isinstance(event, Impact))
    acceleration = found.differentiation.graph.first.gap_acceleration(zeno.state)
    locked = found.period - zeno.time
    return np.append(
        found.end, [found.period, zeno.time, locked, acceleration, first.approach_rate]
    )


def slopes_of(found: EventReturn) -> tuple[Vector, Vector]:
    """Return the derivatives of the same, by state and by parameters."""
    kinds = [type(event) for event in found.events]
    at, first = kinds.index(ZenoPoint), kinds.index(Impact)
    zeno, machine = found.events[at], found.differentiation.graph.first
    assert isinstance(zeno, ZenoPoint)
    bend = differentials_of(machine, found.differentiation.chosen).contact(zeno.state)
    end, settled = found.landing, found.after[at]
    rows = np.vstack(
        [
            end.state,
            end.time,
            settled.time,
            end.time - settled.time,
            change_of(bend[GAP_ACCELERATION], settled.state),
            found.shifts[first].rate,
        ]
    )
    return rows[:, : len(found.start)], rows[:, len(found.start) :]


def simulated(machine: HybridDynamics, x: Vector, guess: float) -> Vector:
    """Return the same numbers by a plain simulation."""
    run = simulate(machine, machine.on_stop(x), until=2 * guess, settings=RESOLVED)
    flown = run.impacts[0].time
    release = next(one for one in run.releases if one.time > flown)
    zeno = next(one for one in run.zeno_points if one.time < release.time)
    special = [
        release.time,
        zeno.time,
        release.time - zeno.time,
        machine.gap_acceleration(zeno.state),
        run.impacts[0].approach_rate,
    ]
    return np.append(release.state, special)


RESOLVED = SimulationSettings(completion=ZenoExtrapolation())
"""Impacts are followed one by one, as for derivatives."""


def differences(f: Callable[[float], Vector], step: float = STEP) -> Vector:
    """Return the derivative of a function of a number at zero, to fourth order."""
    near = (f(step) - f(-step)) / (2 * step)
    far = (f(2 * step) - f(-2 * step)) / (4 * step)
    return (4 * near - far) / 3


@pytest.fixture(name="derivative", scope="module")
def _derivative(machine: HybridDynamics) -> EventReturn:
    return release_return(machine, CENTRE, guess=PERIOD)


@pytest.fixture(name="oscillator", scope="module")
def _oscillator() -> HybridDynamics:
    return forced_oscillator(FORCED, FORCED.restitution)


# The events of a return.


def test_a_return_has_the_events_of_the_closed_form(oscillator: HybridDynamics) -> None:
    start = np.array(oscillator_state(FORCED.release_time, FORCED.stop, 0.0))
    found = release_return(oscillator, start, guess=TURN)
    assert found.period == pytest.approx(TURN, abs=1e-11)
    *impacts, zeno, release = found.events
    assert all(isinstance(event, Impact) for event in impacts)
    assert isinstance(zeno, ZenoPoint)
    assert zeno.time == pytest.approx(FORCED.zeno_time() - FORCED.release_time, abs=1e-11)
    assert release.time == found.period
    assert found.arcs[0].end_time == impacts[0].time
    assert found.arcs[-1].end_time == found.period


@pytest.mark.parametrize("early", [1e-11, 1e-3, FORCED.release_time])
def test_contact_before_the_first_release_belongs_to_the_start(
    oscillator: HybridDynamics, early: float
) -> None:
    start = np.array(oscillator_state(FORCED.release_time - early, FORCED.stop, 0.0))
    found = release_return(oscillator, start, guess=TURN)
    released = np.array(oscillator_state(FORCED.release_time, FORCED.stop, 0.0))
    assert found.start == pytest.approx(released, abs=1e-11)
    assert found.period == pytest.approx(TURN, abs=1e-10)


def test_another_event_sequence_is_refused(oscillator: HybridDynamics) -> None:
    start = np.array(oscillator_state(FORCED.release_time, FORCED.stop, 0.0))
    given = {"section": "release stop", "guess": TURN, "settings": SETTINGS}
    sequence = ("zeno stop", "release stop")
    graph = oscillator.as_graph("stop")
    twice = event_return(graph, start, n_returns=2, sequence=2 * sequence, **given)
    assert twice.period == pytest.approx(2 * TURN, abs=1e-10)
    with pytest.raises(SimulationError, match="event sequence changes to `zeno stop, release"):
        event_return(graph, start, n_returns=1, sequence=2 * sequence, **given)


def test_an_event_that_does_not_follow_is_named(machine: HybridDynamics) -> None:
    # A return is waited for four times as long as the guess.
    with pytest.raises(SimulationError, match="`release stop` does not follow 1 times") as caught:
        release_return(machine, CENTRE, guess=0.2 * PERIOD)
    assert caught.value.time == pytest.approx(0.8 * PERIOD, rel=1e-12)
    assert release_return(machine, CENTRE, guess=0.3 * PERIOD).period == pytest.approx(PERIOD)


def test_a_ball_that_rests_for_good_does_not_return() -> None:
    ball = load_problem("bouncing_ball")
    with pytest.raises(SimulationError, match="does not follow"):
        release_return(ball.dynamics(ball.values()), np.array([1.0, 0.0]), guess=5.0)


def test_the_declared_release_starts_a_period_that_closes(derivative: EventReturn) -> None:
    assert derivative.period == pytest.approx(PERIOD, abs=1e-10)
    assert derivative.end == pytest.approx(CENTRE, abs=1e-10)


# Against differences of the simulation.


@pytest.mark.parametrize("direction", [0, 1])
def test_a_return_and_its_special_quantities_move_as_differences_say(
    machine: HybridDynamics, derivative: EventReturn, direction: int
) -> None:
    section = release_section(machine, CENTRE, SCALE)
    one = np.eye(2)[direction]
    measured = differences(lambda s: simulated(machine, section.state(machine, s * one), PERIOD))
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
    derivative = release_return(machine, x, guess=PERIOD, parameters=(place,))

    def moved(part: float) -> Vector:
        p = values.copy()
        p[place] *= 1 + part
        return simulated(problem.dynamics(p), x, PERIOD)

    _, by_parameters = slopes_of(derivative)
    measured = differences(moved, 1e-4) / values[place]
    tolerance = OF_DIFFERENCES * (1 + 1 / abs(values[place]))
    assert by_parameters[:, 0] == pytest.approx(measured, rel=1e-7, abs=tolerance)


def test_the_values_are_those_of_the_simulation(
    machine: HybridDynamics, derivative: EventReturn
) -> None:
    # The impacts are made one by one here, and so they are there at e = 0.2: the same numbers.
    assert numbers_of(derivative).tolist() == simulated(machine, CENTRE, PERIOD).tolist()


def test_a_plastic_impact_has_a_derivative_of_rank_one(problem: Problem) -> None:
    values = problem.values(parameters={"restitution": 0.0})
    machine = problem.dynamics(values)
    derivative = release_return(machine, CENTRE, guess=PERIOD)
    section = release_section(machine, CENTRE, SCALE)
    tangent = section.tangent
    jacobian = section.components(derivative.by_state @ tangent)
    measured = np.transpose(
        [
            differences(
                lambda s, one=one: section.coordinates(
                    simulated(machine, section.state(machine, s * one), PERIOD)[:5]
                )
            )
            for one in np.eye(2)
        ]
    )
    assert jacobian == pytest.approx(measured, abs=OF_DIFFERENCES)
    # The contact phase forgets the current to exp(-700).
    sizes = np.linalg.svd(jacobian, compute_uv=False)
    assert sizes[1] < 1e-12 < 1e-2 < sizes[0]


def test_restitution_moves_a_plastic_return_to_one_side(problem: Problem) -> None:
    place = problem.names.index("restitution")
    values = np.array(problem.values(parameters={"restitution": 0.0}).vector)

    def at(e: float) -> Vector:
        p = values.copy()
        p[place] = e
        return simulated(problem.dynamics(p), CENTRE, PERIOD)

    machine = problem.dynamics(values)
    derivative = release_return(machine, CENTRE, guess=PERIOD, parameters=(place,))
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
    machine: HybridDynamics, derivative: EventReturn, engine: Engine
) -> None:
    settings = replace(SETTINGS, engine=engine)
    other = release_return(machine, CENTRE, guess=PERIOD, settings=settings)
    for mine, theirs in zip(slopes_of(derivative), slopes_of(other), strict=True):
        # SciPy's steps are good to 1e-11 a period; the gap acceleration magnifies most.
        assert mine == pytest.approx(theirs, rel=1e-9, abs=1e-9)


def test_implicit_steps_have_the_derivative_of_explicit_ones(problem: Problem) -> None:
    values = problem.values(parameters={"L": 1e-4})
    machine = problem.dynamics(values)
    x = CENTRE.copy()
    for _ in range(6):
        _, x = next_release(machine, x, guess=PERIOD)
    by_automatic = release_return(machine, x, guess=PERIOD)
    kinds = {
        type(step).__name__
        for arc in by_automatic.execution.arcs
        for step in getattr(arc.trajectory, "steps", ())
    }
    assert kinds == {"ExplicitStep", "RadauStep"}
    settings = replace(SETTINGS, engine=RungeKutta())
    by_steps = release_return(machine, x, guess=PERIOD, settings=settings)
    tangent = release_section(machine, x, SCALE).tangent
    implicit, explicit = slopes_of(by_automatic)[0] @ tangent, slopes_of(by_steps)[0] @ tangent
    # In the section a small current goes with R / L = 30000 1/s: sizes are taken by the column.
    size = np.max(np.abs(explicit), axis=0)
    assert implicit / size == pytest.approx(explicit / size, abs=1e-9)


def test_a_rule_that_cuts_the_sequence_is_not_differentiated(
    machine: HybridDynamics, derivative: EventReturn
) -> None:
    settings = replace(SETTINGS, completion=Truncation(delta=1e-2))
    other = release_return(machine, CENTRE, guess=PERIOD, settings=settings)
    assert np.array_equal(other.by_state, derivative.by_state)


@pytest.mark.parametrize("exponent", [-4, -6, -8, -10, -12])
def test_the_error_of_the_multipliers_bounds_the_true_one(
    problem: Problem, orbit: Orbit, exponent: int
) -> None:
    tolerance = Tolerance(relative=10.0**exponent, absolute=10.0 ** (exponent - 1))
    completion = ZenoExtrapolation(tolerance=10.0**exponent)
    settings = SimulationSettings(tolerance=tolerance, completion=completion)
    verification = VerificationSettings(simulation=settings)
    found = multipliers_of(orbit, problem, settings=verification)
    # Seven digits are known.
    assert abs(found.values[0] - MULTIPLIER) <= found.error + 5e-8
    true = multipliers_of(orbit, problem).values
    off = max(min(abs(one - value) for one in true) for value in found.values)
    assert off <= found.error
    assert found.error < 10.0 ** (exponent + 2.5)


# What a period is made of.


def _monodromy_matrix(dynamics: HybridDynamics, derivative: EventReturn) -> Vector:
    r"""Return the state transition over a period of fixed length, ``(n_x, n_x)``.

    .. math:: \Phi(T) = \frac{\partial P}{\partial x} - f(P)\,\frac{\partial T}{\partial x}

    On a periodic orbit its eigenvalues are 1, for :math:`f` itself, the multipliers, and zeros.
    """
    along = dynamics.locked.rate(derivative.end)
    return derivative.by_state - np.outer(along, derivative.landing.time)


def test_the_monodromy_matrix_keeps_the_flow_and_forgets_what_leaves_the_stop(
    machine: HybridDynamics, derivative: EventReturn
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
    machine: HybridDynamics, derivative: EventReturn
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
    # Its circle attracts with exp(-2 pi) a turn, as a test below derives.
    problem = clocked_oscillator(replace(FORCED, restitution=e), attracting=True)
    machine = problem.dynamics(problem.values())
    x = np.array(oscillator_state(FORCED.release_time, FORCED.stop, 0.0))
    (value,) = multipliers_at(machine, x, TURN)
    assert value == pytest.approx(math.exp(-TURN), abs=1e-11 / (1 - e))


def test_frequency_and_stop_move_the_return_of_a_forced_oscillator() -> None:
    numbers = {"k": 1.0, "c": 1.9, "force": 1.0, "omega": 1.0, "stop": -0.8, "e": 0.5}
    names = list(OSCILLATOR.parameters)
    x = np.array(oscillator_state(FORCED.release_time + 1e-3, FORCED.stop, 0.0))
    machine = OSCILLATOR.at(**numbers)
    derivative = release_return(machine, x, guess=TURN, parameters=tuple(range(len(names))))
    _, by_parameters = slopes_of(derivative)
    for k, name in enumerate(names):
        if name == "stop":
            # The start would have to move along.
            continue
        measured = differences(
            lambda s, name=name: simulated(
                OSCILLATOR.at(**{**numbers, name: numbers[name] + s}), x, TURN
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
    derivative = release_return(machine, x, guess=TURN)
    assert derivative.period == pytest.approx(TURN, abs=1e-10)
    jacobian = derivative_of_return(derivative.differentiation.graph, derivative)[2]
    assert jacobian.shape == (1, 1)
    # The bead's speed u obeys u' = RATE (1 - u^2) u, with the slope -2 RATE at 1.
    expected = math.exp(-2 * RATE * 2 * math.pi)
    assert jacobian[0, 0] == pytest.approx(expected, abs=1e-10)


# Starts and systems that have no derivative, or not the plain one.


def test_a_model_without_formulas_has_no_exact_derivative(machine: HybridDynamics) -> None:
    softer = replace(machine, differentiation=None)
    with pytest.raises(InputError, match="must have formulas"):
        release_return(softer, CENTRE, guess=PERIOD)


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
    derivative = release_return(machine, x, guess=1.0, parameters=chosen)
    kinds = [type(event).__name__ for event in derivative.events]
    assert kinds == ["Impact", "Impact", "ZenoPoint", "Release"]
    assert numbers_of(derivative) == pytest.approx(simulated(machine, x, 1.0), abs=1e-12)
    by_state, by_parameters = slopes_of(derivative)
    for k, place in enumerate(chosen):

        def moved(part: float, place: int = place) -> Vector:
            p = vector.copy()
            p[place] += part
            return simulated(table.dynamics(p), x, 1.0)

        # The time of the return, 0.3 s, turns the clock by 4e-4: the fourth power is no more.
        step = 2e-4 * vector[place]
        size = np.maximum(np.abs(by_parameters[:, k]), 1.0)
        measured = differences(moved, step)
        assert by_parameters[:, k] / size == pytest.approx(measured / size, abs=1e-6)
    along = np.array([0.0, 0.0, -math.sin(phase), math.cos(phase)])
    turned = differences(lambda s: simulated(machine, released(phase + s), 1.0))
    assert by_state @ along == pytest.approx(turned, abs=1e-6)


# Multipliers that are known.


def _clocked(*, attracting: bool) -> tuple[Problem, Vector]:
    problem = clocked_oscillator(FORCED, attracting=attracting)
    return problem, np.array(oscillator_state(FORCED.release_time, FORCED.stop, 0.0))


def test_a_clock_that_attracts_has_its_multiplier_in_closed_form() -> None:
    # y'' = -y + y' (1 - y^2 - y'^2) shrinks areas of (y, y') on its circle at the rate -2 y'^2,
    # whose integral over a turn is -2 pi. Nothing else is left of a locked mass.
    problem, release = _clocked(attracting=True)
    (value,) = multipliers_at(problem.dynamics(problem.values()), release, TURN)
    assert value == pytest.approx(math.exp(-TURN), abs=1e-11)


def test_a_clock_that_keeps_any_amplitude_has_the_multiplier_one() -> None:
    problem, release = _clocked(attracting=False)
    (value,) = multipliers_at(problem.dynamics(problem.values()), release, TURN)
    assert value == pytest.approx(1.0, abs=1e-11)


def test_a_locked_arc_forgets_the_current(problem: Problem) -> None:
    # With R / L = 1500 a second, the contact phase of half a second forgets it to exp(-700): one
    # multiplier is zero. At e = 0 this is the whole of the second one.
    dynamics = problem.dynamics(problem.values(parameters={"restitution": 0.0}))
    settled = CENTRE
    for _ in range(8):
        _, settled = next_release(dynamics, settled, guess=PERIOD)
    large, small = multipliers_at(dynamics, settled, PERIOD)
    assert abs(small) < 1e-6
    assert abs(large) < 1.0


def test_a_small_change_shrinks_by_the_multiplier(
    machine: HybridDynamics, derivative: EventReturn
) -> None:
    section = release_section(machine, CENTRE, SCALE)
    values, vectors = np.linalg.eig(section.components(derivative.by_state @ section.tangent))
    direction = np.real(vectors[:, int(np.argmax(np.abs(values)))])
    distance = 1e-4
    start = section.state(machine, distance * direction)
    _, end = next_release(machine, start, guess=PERIOD)
    # The next order is the distance itself.
    expected = distance * direction * MULTIPLIER
    assert section.coordinates(end) == pytest.approx(expected, abs=10 * distance**2)


def test_a_model_without_formulas_has_its_multipliers_by_differences(
    problem: Problem, orbit: Orbit, machine: HybridDynamics
) -> None:
    blind = replace(machine, differentiation=None)
    found = verify(orbit, problem, dynamics=blind).multipliers
    # The fourth order in the step of 2e-5 leaves the noise of a return, 1e-12, over it.
    assert found[0] == pytest.approx(MULTIPLIER, abs=1e-6)
    assert abs(found[1]) < 1e-6
