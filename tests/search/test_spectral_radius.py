"""The return map inside a program is that of the simulator, and its rows bound its multipliers."""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.reference.reference_orbit import MULTIPLIER
from tests.support.cases import fast
from tests.support.hand_made import SCALE, K, course, hand_made, rows_of
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem, bind, load_problem
from zeno_orbits.orbits import orbit_multipliers, place_on_section
from zeno_orbits.search import TranscriptionSettings, orbit_by_shooting
from zeno_orbits.search.confirmation import one_cycle
from zeno_orbits.search.transcription import spectral_radius
from zeno_orbits.search.transcription.closure import closures_of
from zeno_orbits.search.transcription.nearness import Nearness
from zeno_orbits.search.transcription.program import Derived, ProgramBuilder
from zeno_orbits.search.transcription.spectral_radius import (
    keep_radius_below,
    radius_of,
    section_map,
)
from zeno_orbits.search.transcription.transcribe import OrbitTerms, transcribe
from zeno_orbits.simulation import SimulationSettings

DIFFERENCES = 1e-6
"""Asked of the agreement with differences of the simulated map; these err by less than 1e-8."""


def _terms(
    problem: Problem, free: dict[str, tuple[float, float]] | None = None, **numbers: float
) -> tuple[OrbitTerms, Vector]:
    """Return the terms of an orbit's program, and its multipliers by differences."""
    values = problem.values().replaced(numbers)
    orbit = orbit_by_shooting(problem, values).unwrap()
    compiled = problem.compiled()
    dynamics = bind(compiled, values.vector)
    start = place_on_section(dynamics, orbit.shape, np.array(list(orbit.start_state.values())))
    cycle = one_cycle(dynamics, start, 2 * orbit.period, orbit.shape)
    assert cycle is not None
    terms = transcribe(
        compiled,
        values,
        dynamics=dynamics,
        cycle=cycle,
        closures=closures_of(cycle, dynamics, 1e-11),
        free=free or {},
        nearness=Nearness(first={}, sizes={}),
        settings=TranscriptionSettings(),
    )
    multipliers = orbit_multipliers(
        dynamics,
        start,
        scale=cycle.scale(),
        period=orbit.period,
        settings=SimulationSettings(),
        shape=orbit.shape,
    )
    return terms, np.array(multipliers.values)


@pytest.mark.parametrize(
    ("name", "numbers", "size"),
    fast(
        3,
        [
            ("motor_pendulum", {}, 2),
            ("motor_pendulum", {"Kp": 1.5, "Kd": -1.4}, 2),
            ("motor_pendulum", {"restitution": 0.0}, 2),
            ("motor_pendulum", {"restitution": 0.35, "L": 0.02}, 2),
            # Beyond the end of its Zeno orbits: three impacts a period, and no release.
            ("motor_pendulum", {"restitution": 0.5}, 4),
            ("motor_pendulum@quasi_static", {"Kd": -0.7}, 1),
            ("two_motors", {"Kd": -1.1}, 3),
        ],
    ),
)
def test_multipliers_in_the_program_are_those_of_the_simulated_map(
    name: str, numbers: dict[str, float], size: int
) -> None:
    terms, expected = _terms(load_problem(name), **numbers)
    found = np.linalg.eigvals(terms.guessed(section_map(terms)))
    found = np.array(sorted(found, key=abs, reverse=True))
    assert len(found) == len(expected) == size
    assert found == pytest.approx(expected, abs=DIFFERENCES)
    if name == "motor_pendulum" and not numbers:
        assert found[0].real == pytest.approx(MULTIPLIER, abs=DIFFERENCES)


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("motor_pendulum", {"Kp": 1.5, "Kd": -1.4}),
        ("motor_pendulum", {"restitution": 0.5}),
        ("two_motors", {}),
    ],
)
@pytest.mark.slow
def test_the_derivative_of_the_map_by_every_unknown_is_that_of_differences(
    name: str, numbers: dict[str, float]
) -> None:
    terms, _ = _terms(load_problem(name), free={"Kd": (-2.0, 0.0)}, **numbers)
    slope = section_map(terms)
    terms.program.at_least_zero("slope", ca.vec(slope))
    program = terms.program.build()
    n = slope.numel()
    rows = ca.Function("rows", [program.unknowns], [program.rows[-n:]])
    slopes = ca.Function("slopes", [program.unknowns], [program.jacobian[-n:, :]])
    jacobian = slopes(program.guess).full()
    random = np.random.default_rng(1)
    for place, shape in program.names.values():
        move = np.zeros(program.guess.size)
        move[place : place + shape[0] * shape[1]] = random.normal(size=shape[0] * shape[1])
        move /= np.linalg.norm(move)
        # The error of differences is of second order; two of them tell how large it is.
        coarse, fine = (
            (rows(program.guess + h * move) - rows(program.guess - h * move)).full().ravel() / 2 / h
            for h in (2e-5, 1e-5)
        )
        size = 1.0 + np.max(np.abs(fine))
        allowed = 1e-7 * size + np.max(np.abs(coarse - fine))
        assert np.max(np.abs(jacobian @ move - fine)) < allowed < 1e-3 * size
    # The gain moves the map, too, not only the orbit.
    assert np.max(np.abs(jacobian[:, program.names["free Kd"][0]])) > 1e-2


def test_a_section_of_too_many_coordinates_is_refused(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    terms, _ = _terms(problem)
    monkeypatch.setattr("zeno_orbits.search.transcription.spectral_radius.MOST_COORDINATES", 1)
    with pytest.raises(InputError, match="a section with 2 coordinates"):
        section_map(terms)


@pytest.mark.parametrize("size", [1, 2, 3, 4, 5, 6])
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


@pytest.mark.parametrize(("size", "n_complex"), [(1, 0), (2, 1), (3, 2), (4, 4), (5, 4), (6, 6)])
def test_rows_of_multipliers_say_which_of_them_they_hold(size: int, n_complex: int) -> None:
    program = ProgramBuilder()
    matrix = program.variable("entries", 0.5 * np.eye(size))
    keep_radius_below(program, matrix, 1.0)
    rows = rows_of(program)
    names = [
        "real multipliers not above the spectral radius",
        "real multipliers not below - the spectral radius",
        "multipliers: complex values not above the spectral radius",
    ]
    assert list(rows) == names[: 2 + (n_complex > 0)]
    # p(1) and (-1)^d p(-1) of (z - 1/2)^d.
    assert rows[names[0]] == pytest.approx([0.5**size])
    assert rows[names[1]] == pytest.approx([1.5**size])
    # No row is asked twice.
    assert len(rows.get(names[2], [])) == n_complex


def test_a_spectral_radius_is_the_size_of_the_largest_multiplier() -> None:
    assert radius_of(np.array([[0.0, -4.0], [1.0, 0.0]])) == pytest.approx(2.0)
    assert radius_of(np.diag([0.5, -0.75])) == 0.75


# The section and its map, at terms made by hand.


def _by_hand(released: bool) -> tuple[Any, ca.MX]:
    """Return terms whose period ends twice as far from zero as it starts, and their end."""
    made = hand_made()
    rest = course((0.5,), (1.5,))
    phase = made.phase("", rest, rest if released else None)
    terms = made.terms(phase)
    end = 2.0 * phase.start
    terms.start, terms.end = phase.start, end
    terms.tangent = np.array([[1.0, 0.0], [0.0, 1.0]])
    terms.motion = "the motion"
    return terms, end


def test_the_end_of_a_lock_is_scaled_by_its_largest_slope_whichever_its_sign(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[Any] = []

    def derived(*arguments: Any) -> Derived:
        asked.extend(arguments)
        return Derived(value=ca.MX(ca.DM.eye(1)), slope=ca.MX(1, 6))

    def slope(_terms: OrbitTerms) -> Vector:
        return np.array([[-16.0, 0.0]])

    monkeypatch.setattr(spectral_radius, "derivative_along", derived)
    monkeypatch.setattr(spectral_radius, "_multiplier_slope", slope)
    terms, _ = _by_hand(released=True)
    section_map(terms)
    # The multiplier at the end is k x + v there, twice that of the start.
    assert terms.guessed(asked[2])[0] == pytest.approx((K * 1.0 + 3.0) / 16.0)


@pytest.mark.parametrize("released", [True, False])
def test_the_map_is_asked_for_in_coordinates_of_the_section(
    released: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []
    d = 1 if released else 2

    def derived(*arguments: Any) -> Derived:
        asked.extend(arguments)
        return Derived(value=ca.MX(ca.DM.eye(d)), slope=ca.MX(d * d, 6))

    monkeypatch.setattr(spectral_radius, "derivative_along", derived)
    terms, _ = _by_hand(released)
    slope = section_map(terms)
    assert slope.shape == (d, d)
    program, motion, start, targets, arrival = asked
    assert program is terms.program
    assert motion == "the motion"
    values = terms.guessed(start).ravel(), terms.guessed(arrival).ravel()
    # The multiplier k x + v, of scaled states 8 and 1/2, vanishes along the section; where an
    # impact ends the flight all of the tangent is its section.
    if released:
        basis = np.array([[0.5], [-8.0]]) / math.hypot(0.5, 8.0)
        basis *= np.sign(values[1][0]) * np.sign(float(basis[:, 0] @ [0.125, 3.0]))
        multiplier = [(K * 1.0 + 3.0) / 8.0]
    else:
        basis, multiplier = np.eye(2), []
    scaled = np.array([0.5, 1.5]) / SCALE
    assert values[0] == pytest.approx([*multiplier, *(basis.T @ scaled)])
    assert values[1] == pytest.approx(basis.T @ (2 * scaled))
    assert targets.tolist() == [*[[0.0]] * len(multiplier), *np.eye(d).tolist()]


@pytest.mark.parametrize("size", [0, 7])
def test_a_section_without_coordinates_or_with_more_than_six_is_refused(
    size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    terms, _ = _by_hand(released=False)
    terms.tangent = np.zeros((2, size))
    with pytest.raises(InputError, match=f"{size} coordinates, but one to 6 are supported"):
        section_map(terms)
    monkeypatch.setattr(spectral_radius, "derivative_along", lambda *_: _derived(6))
    terms.tangent = np.zeros((2, 6))
    assert section_map(terms).shape == (6, 6)


def _derived(size: int) -> Derived:
    return Derived(value=ca.MX(size, size), slope=ca.MX(size**2, 6))
