"""The reference problem: its published numbers, its calibration and its two derivations."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.integrators import PlainFlow
from zeno_orbits.model import (
    HybridDynamics,
    ParameterValues,
    Problem,
    bind,
    load_problem,
    load_reference,
)

CURRENT_COEFFICIENT, GRAVITY_COEFFICIENT = 2.92437, 27.5697
"""Printed in the paper: d2h/dt2 = -2.92437 i - 27.5697 sin(theta1)."""
AGREEMENT = 1e-10
"""Two derivations in floats; a few hundred operations, condition of M below 100, margin 1e3."""
Model = Callable[[ParameterValues], HybridDynamics]
NUMBERS = ("gap", "gap_rate", "gap_acceleration", "multiplier", "normal_inertia", "energy")


@pytest.fixture(name="problem", scope="module")
def _problem() -> Problem:
    return load_problem("motor_pendulum")


@pytest.fixture(name="derived", scope="module")
def _derived(problem: Problem) -> Model:
    compiled = problem.compiled()
    return lambda values: bind(compiled, values.vector)


@pytest.fixture(name="by_hand", scope="module")
def _by_hand(problem: Problem) -> Model:
    return load_reference(problem).dynamics


def _random_parameters(generator: np.random.Generator) -> dict[str, float]:
    """Return masses and lengths for which the published numbers can hold."""
    lc2 = generator.uniform(0.08, 0.22)
    m2 = generator.uniform(0.05, 0.4)
    # (I2 + m2 lc2^2) / (m2 lc2) must stay below 9.81 / 27.5697 = 0.3558 m.
    arm = generator.uniform(lc2 + 0.02, 0.33)
    return {
        "L1": generator.uniform(0.1, 0.4),
        "lc1": generator.uniform(0.02, 0.2),
        "m1": generator.uniform(0.1, 0.6),
        "I1": generator.uniform(1e-4, 2e-3),
        "lc2": lc2,
        "m2": m2,
        "I2": m2 * lc2 * (arm - lc2),
    }


def _random_values(problem: Problem, generator: np.random.Generator) -> ParameterValues:
    electrical = {
        "R": generator.uniform(1, 5),
        "L": generator.uniform(1e-3, 1e-2),
        "K_emf": generator.uniform(0.01, 0.2),
        "restitution": generator.uniform(0, 0.9),
        "g": 9.81,
    }
    gains = {"Kp": generator.uniform(1, 6), "Kd": generator.uniform(-1.5, 1)}
    return problem.values(gains=gains, parameters={**_random_parameters(generator), **electrical})


def _random_state(generator: np.random.Generator) -> Vector:
    return generator.normal(size=5) * np.array([1.5, 1.5, 5.0, 5.0, 2.0])


def _states(n: int, seed: int) -> list[Vector]:
    generator = np.random.default_rng(seed)
    return [_random_state(generator) for _ in range(n)]


def _on_stop(x: Vector) -> Vector:
    resting = x.copy()
    resting[[1, 3]] = 0.0
    return resting


def _disagreements(one: HybridDynamics, other: HybridDynamics, x: Vector) -> dict[str, float]:
    """Return the relative disagreement of every map, the multiplier rate's on the stop."""
    rate, resting = one.gap_rate(x), _on_stop(x)
    pairs = {name: (getattr(one, name)(x), getattr(other, name)(x)) for name in NUMBERS}
    pairs |= {
        "free flow": (one.free.rate(x), other.free.rate(x)),
        "constrained flow": (one.locked.rate(x), other.locked.rate(x)),
        "reset_map": (one.reset_map(x, rate), other.reset_map(x, rate)),
        "impulse_direction": (one.impulse_direction(x), other.impulse_direction(x)),
        "multiplier_rate": (one.multiplier_rate(resting), other.multiplier_rate(resting)),
        "free guard": (one.free.guard(x), other.free.guard(x)),
        "locked guard": (one.locked.guard(resting), other.locked.guard(resting)),
    }
    scaled = np.append(x, (0.3, 0.7))
    pairs["flight"] = (one.flight(0.2).rate(scaled), other.flight(0.2).rate(scaled))
    return {
        name: float(np.max(np.abs(np.subtract(left, right)) / (1 + np.abs(left))))
        for name, (left, right) in pairs.items()
    }


def _coefficients(dynamics: HybridDynamics) -> tuple[float, float]:
    """Return minus the factors of the current and of sin(theta1) in d2h/dt2."""
    with_current = np.array([0.0, 0.0, 0.0, 0.0, 1.0])
    sideways = np.array([math.pi / 2, 0.0, 0.0, 0.0, 0.0])
    return -dynamics.gap_acceleration(with_current), -dynamics.gap_acceleration(sideways)


def test_the_published_coefficients_come_back_from_the_default_problem(
    problem: Problem, derived: Model
) -> None:
    current, gravity = _coefficients(derived(problem.values()))
    assert current == pytest.approx(CURRENT_COEFFICIENT, rel=1e-12)
    assert gravity == pytest.approx(GRAVITY_COEFFICIENT, rel=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_the_published_coefficients_come_back_from_other_masses_and_lengths(
    problem: Problem, derived: Model, seed: int
) -> None:
    values = problem.values(parameters=_random_parameters(np.random.default_rng(seed)))
    current, gravity = _coefficients(derived(values))
    assert current == pytest.approx(CURRENT_COEFFICIENT, rel=1e-11)
    assert gravity == pytest.approx(GRAVITY_COEFFICIENT, rel=1e-11)


def test_the_calibration_gives_the_declared_rotor_and_torque_constant(problem: Problem) -> None:
    parameters = problem.values().parameters
    # Printed with 13 and 14 decimals.
    assert parameters["J_rotor"] == pytest.approx(0.01792808647924, abs=1e-14)
    assert parameters["K_torque"] == pytest.approx(0.03071770892865, abs=1e-14)
    assert parameters["K_emf"] == parameters["K_torque"]


def test_given_constants_are_not_calibrated_over(problem: Problem) -> None:
    given = {"J_rotor": 0.02, "K_torque": 0.05, "K_emf": 0.04}
    parameters = problem.values(parameters=given).parameters
    assert {name: parameters[name] for name in given} == given


def test_a_second_link_too_long_for_the_published_number_is_refused(problem: Problem) -> None:
    # B / E = lc2 + I2 / (m2 lc2) = 0.40 m, above 9.81 / 27.5697 = 0.3558 m.
    too_long = {"lc2": 0.15, "m2": 0.10, "I2": 0.10 * 0.15 * 0.25}
    bound = (
        r"\(I2 \+ m2 lc2\^2\) / \(m2 lc2\) must be below g / 27.5697 = 0.35582\d m, but .* 0.4 m"
    )
    with pytest.raises(InputError, match=bound):
        problem.values(parameters=too_long)


def test_a_first_link_too_heavy_for_the_published_number_is_refused(problem: Problem) -> None:
    with pytest.raises(InputError, match=r"J_rotor must not be negative, but it would be -0\.08"):
        problem.values(parameters={"I1": 0.1})


def test_the_hand_written_model_imports_no_symbolic_algebra(problem: Problem) -> None:
    assert problem.reference is not None
    tree = ast.parse(problem.reference.read_text(encoding="utf-8"))
    at_run_time = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    modules = {
        node.module if isinstance(node, ast.ImportFrom) else node.names[0].name
        for node in at_run_time
    }
    assert modules == {
        "__future__",
        "math",
        "dataclasses",
        "typing",
        "numpy",
        "zeno_orbits.arrays",
        "zeno_orbits.integrators.flow",
        "zeno_orbits.model.numeric.hybrid_dynamics",
    }


def test_both_derivations_agree_in_every_map_at_random_states(
    problem: Problem, derived: Model, by_hand: Model
) -> None:
    values = problem.values()
    one, other = derived(values), by_hand(values)
    for x in _states(50, seed=11):
        for name, difference in _disagreements(one, other, x).items():
            assert difference < AGREEMENT, f"{name} at {x}"


@pytest.mark.parametrize("seed", range(12))
def test_both_derivations_agree_under_random_settings(
    problem: Problem, derived: Model, by_hand: Model, seed: int
) -> None:
    generator = np.random.default_rng(100 + seed)
    values = _random_values(problem, generator)
    one, other = derived(values), by_hand(values)
    assert one.restitution == other.restitution
    for x in _states(50, seed):
        for name, difference in _disagreements(one, other, x).items():
            assert difference < AGREEMENT, f"{name} at {x}"


@pytest.mark.parametrize(
    "name", [*NUMBERS, "reset_map", "impulse_direction", "multiplier_rate", "free flow"]
)
def test_a_wrong_sign_in_one_map_shows_as_a_disagreement_of_that_map(
    problem: Problem, derived: Model, by_hand: Model, name: str
) -> None:
    values = problem.values()
    right = by_hand(values)
    if name == "reset_map":
        wrong = replace(right, reset_map=lambda x, rate: right.reset_map(x, -rate))
    elif name == "free flow":
        backwards = PlainFlow(field=lambda x: -right.free.rate(x), guard_and_rate=right.free.guard)
        wrong = replace(right, free=backwards)
    else:
        wrong = replace(right, **{name: lambda x: -getattr(right, name)(x)})
    x = _states(1, seed=12)[0]
    found = _disagreements(derived(values), wrong, x)
    assert [key for key, difference in found.items() if difference > AGREEMENT] == [name]


@pytest.mark.parametrize("model", ["derived", "by_hand"])
def test_the_multiplier_rate_on_the_stop_is_the_derivative_along_the_locked_flow(
    problem: Problem, model: str, request: pytest.FixtureRequest
) -> None:
    dynamics = request.getfixturevalue(model)(problem.values())
    for x in map(_on_stop, _states(20, seed=13)):
        slope = dynamics.locked.rate(x)
        step = 1e-5 / (1 + float(np.max(np.abs(slope))))
        difference = dynamics.multiplier(x + step * slope) - dynamics.multiplier(x - step * slope)
        # Truncation step^2 and rounding 1e-16 / step, both times the size of the slope.
        assert difference / (2 * step) == pytest.approx(
            dynamics.multiplier_rate(x), rel=1e-6, abs=1e-15 / step
        )


@pytest.mark.parametrize("model", ["derived", "by_hand"])
def test_energy_changes_by_what_the_source_gives_and_the_winding_loses(
    problem: Problem, model: str, request: pytest.FixtureRequest
) -> None:
    values = problem.values()
    p, gains = values.parameters, values.gains
    dynamics = request.getfixturevalue(model)(values)
    for x in _states(20, seed=14):
        slope = dynamics.free.rate(x)
        step = 1e-5 / (1 + float(np.max(np.abs(slope))))
        difference = dynamics.energy(x + step * slope) - dynamics.energy(x - step * slope)
        voltage = -gains["Kp"] * x[0] - gains["Kd"] * x[2]
        power = voltage * x[4] - p["R"] * x[4] ** 2
        # As above; the energy is of size 1 J.
        assert difference / (2 * step) == pytest.approx(power, rel=1e-6, abs=1e-14 / step)
