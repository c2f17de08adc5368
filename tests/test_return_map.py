"""The return map inside a program is that of the simulator, and its rows bound its multipliers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tests.reference_orbit import MULTIPLIER
from zeno_orbits.closing import close_orbit
from zeno_orbits.compiled import bind
from zeno_orbits.confirmation import one_cycle
from zeno_orbits.cycle import closures_of
from zeno_orbits.dynamics import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.models import compiled_model
from zeno_orbits.poincare import floquet_multipliers
from zeno_orbits.problem import Problem, load_problem
from zeno_orbits.program import ProgramBuilder
from zeno_orbits.return_map import keep_radius_below, section_map
from zeno_orbits.shooting import OrbitTerms, transcribe
from zeno_orbits.simulate import SimulationSettings
from zeno_orbits.stretches import TranscriptionSettings

DIFFERENCES = 1e-6
"""Asked of the agreement with differences of the simulated map; these err by less than 1e-8."""


def _terms(problem: Problem, **numbers: float) -> tuple[OrbitTerms, Vector]:
    """Return the terms of an orbit's program, and its multipliers by differences."""
    setting = problem.setting().replaced(numbers)
    orbit = close_orbit(problem, setting).unwrap()
    compiled = compiled_model(problem)
    dynamics = bind(compiled, setting.values())
    release = dynamics.on_stop(np.array(list(orbit.release_state.values())))
    cycle = one_cycle(dynamics, release, 2 * orbit.period)
    assert cycle is not None
    terms = transcribe(
        compiled,
        setting,
        dynamics=dynamics,
        cycle=cycle,
        closures=closures_of(cycle, dynamics, 1e-11),
        free={},
        first={},
        settings=TranscriptionSettings(),
    )
    multipliers = floquet_multipliers(
        dynamics,
        release,
        scale=cycle.scale(),
        period=orbit.period,
        settings=SimulationSettings(),
    )
    return terms, np.array(multipliers.values)


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("motor_pendulum", {}),
        ("motor_pendulum", {"Kp": 1.5, "Kd": -1.4}),
        ("motor_pendulum", {"restitution": 0.0}),
        ("motor_pendulum", {"restitution": 0.35, "L": 0.02}),
        ("motor_pendulum@quasi_static", {"Kd": -0.7}),
    ],
)
def test_multipliers_in_the_program_are_those_of_the_simulated_map(
    name: str, numbers: dict[str, float]
) -> None:
    terms, expected = _terms(load_problem(name), **numbers)
    found = np.linalg.eigvals(terms.guessed(section_map(terms)))
    found = np.array(sorted(found, key=abs, reverse=True))
    assert len(found) == len(expected) == terms.compiled.n_x - 3
    assert found == pytest.approx(expected, abs=DIFFERENCES)
    if name == "motor_pendulum" and not numbers:
        assert found[0].real == pytest.approx(MULTIPLIER, abs=DIFFERENCES)


def test_the_guess_of_a_neighbour_meets_its_rows_and_a_wrong_one_does_not(scene: Problem) -> None:
    terms, _ = _terms(scene)
    section_map(terms)
    program = terms.program.build()
    rows = ca.Function("rows", [program.unknowns], [program.rows])
    ours = np.array([name.startswith("neighbour") for name in program.row_names])
    assert np.max(np.abs(rows(program.guess).full().ravel()[ours])) < 1e-9
    for block in ("neighbour 1: locked duration", "neighbour 2: release state"):
        wrong = program.guess.copy()
        wrong[program.names[block][0]] += 1e-3
        assert np.max(np.abs(rows(wrong).full().ravel()[ours])) > 1e-5


def test_a_section_of_too_many_coordinates_is_refused(
    scene: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    terms, _ = _terms(scene)
    monkeypatch.setattr("zeno_orbits.return_map.MOST_COORDINATES", 1)
    with pytest.raises(InputError, match="where the section has 2 coordinates"):
        section_map(terms)


@pytest.mark.parametrize("size", [1, 2])
def test_the_rows_hold_for_exactly_the_radii_above_the_spectral_radius(size: int) -> None:
    program = ProgramBuilder()
    entries = program.variable("entries", np.zeros((size, size)))
    radius = program.variable("radius", 1.0)[0, 0]
    keep_radius_below(program, entries, radius)
    built = program.build()
    rows = ca.Function("rows", [built.unknowns], [built.rows])
    random = np.random.default_rng(1)
    kinds = set[bool]()
    for _ in range(300):
        matrix = random.normal(size=(size, size))
        values = np.linalg.eigvals(matrix)
        kinds.add(bool(np.iscomplex(values[0])))
        true = float(np.max(np.abs(values)))
        for factor, holds in ((1.001, True), (0.999, False)):
            point = np.concatenate([matrix.flatten(order="F"), [factor * true]])
            assert (float(ca.mmin(rows(point))) >= 0.0) is holds
    assert kinds == ({False} if size == 1 else {False, True})
