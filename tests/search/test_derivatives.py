"""Derivatives of a program: chain rule, motion along arcs, and multipliers of the return map."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.reference.reference_orbit import MULTIPLIER
from tests.support.cases import fast
from tests.support.hand_made import rows_of
from zeno_orbits.arrays import Vector
from zeno_orbits.model import Problem, bind, load_problem
from zeno_orbits.orbits import orbit_multipliers, place_on_section
from zeno_orbits.search import TranscriptionSettings, orbit_by_shooting
from zeno_orbits.search.confirmation import one_cycle
from zeno_orbits.search.transcription.closure import closures_of
from zeno_orbits.search.transcription.jacobian import MappedRows, rows_jacobian
from zeno_orbits.search.transcription.motion_derivative import ProgramMotion, derivative_along
from zeno_orbits.search.transcription.nearness import Nearness
from zeno_orbits.search.transcription.program import ProgramBuilder
from zeno_orbits.search.transcription.spectral_radius import (
    keep_radius_below,
    radius_of,
    section_map,
)
from zeno_orbits.search.transcription.transcribe import OrbitTerms, transcribe
from zeno_orbits.simulation import SimulationSettings

EXACT = 1e-13


def _pair() -> ca.Function:
    """Return rows ``(c - sin b, d - b c)`` of the columns ``(c, d)`` and ``b``, and an output."""
    ends, b = ca.SX.sym("ends", 2), ca.SX.sym("b")
    rows = ca.vertcat(ends[0] - ca.sin(b), ends[1] - b * ends[0])
    return ca.Function("pair", [ends, b], [rows, b])


def _motion(start: Any = lambda a: a) -> tuple[Any, Any, ProgramBuilder]:
    """Return how the ends of two columns move with their starts, and the program.

    From ``a_k`` follow ``b_k = g a_k^2``, ``c_k = sin b_k`` and ``d_k = b_k c_k``, with a number
    ``g`` that does not move with the motion.
    """
    program = ProgramBuilder()
    g = program.variable("g", 1.5, scale=3.0)[0, 0]
    n_before = len(program.blocks)
    a = program.variable("a", [0.4, -0.7], scale=[2.0, 0.5])[:, 0]
    b = program.variable("b", [0.3, 0.8], scale=[4.0, 0.25])[:, 0]
    ends = program.variable("ends", [[0.2, 0.9], [0.1, 0.5]], scale=[0.1, 5.0])
    program.equal("b", b - g * a**2, scale=ca.DM([7.0, 0.3]))
    program.equal_along("ends", _pair(), (ends, b.T), scale=np.array([[2.0], [9.0]]))
    motion = ProgramMotion(blocks=program.blocks[n_before:], equations=program.equations)
    # An unknown that is declared later has no part in the motion.
    program.variable("later", 1.0)
    derived = derivative_along(
        program, motion, start(a), np.array([[1.0, 0.0], [0.0, 2.0]]), ca.vec(ends)
    )
    return derived, motion, program


def _at(program: ProgramBuilder, *expressions: ca.MX) -> tuple[dict[str, Any], list[Any]]:
    """Return the unknowns of the guess by name, and the values of expressions there."""
    guess = {block.name: block.guess for block in program.blocks}
    return guess, [program.at_guess(one).full() for one in expressions]


def test_ends_move_with_starts_as_the_chain_rule_says_off_the_motion_too() -> None:
    derived, motion, program = _motion()
    guess, (value,) = _at(program, derived.value)
    g, (a, b) = guess["g"][0, 0], (guess["a"][:, 0], guess["b"][:, 0])
    c = guess["ends"][0]
    # With the equations linearised where they are not met: db = 2 g a da, dc = cos b db, and
    # dd = (c + b cos b) db; the second start moves twice as far.
    db = 2 * g * a * np.array([1.0, 2.0])
    expected = np.zeros((4, 2))
    for k in range(2):
        expected[2 * k : 2 * k + 2, k] = [
            np.cos(b[k]) * db[k],
            (c[k] + b[k] * np.cos(b[k])) * db[k],
        ]
    assert value == pytest.approx(expected, abs=EXACT)
    unknowns = sum(block.symbol.numel() for block in motion.blocks)
    rows = 2 + 4
    assert unknowns == rows + 2


def test_the_move_of_the_ends_changes_with_every_unknown() -> None:
    derived, _, program = _motion()
    guess, (slope,) = _at(program, derived.slope)
    g, a, b, c = guess["g"][0, 0], guess["a"][:, 0], guess["b"][:, 0], guess["ends"][0]
    places: dict[str, int] = {}
    scales: list[float] = []
    for block in program.blocks:
        places[block.name] = len(scales)
        scales += (
            np.repeat(block.scale[:, None], block.guess.shape[1], axis=1).flatten("F").tolist()
        )
    assert slope.shape == (8, len(scales))
    expected = np.zeros((4, 2, len(scales)))
    for k, move in enumerate((1.0, 2.0)):
        cosine, sine = np.cos(b[k]), np.sin(b[k])
        bend = c[k] + b[k] * cosine
        first, second = expected[2 * k, k], expected[2 * k + 1, k]
        first[places["g"]] = cosine * 2 * a[k] * move
        second[places["g"]] = bend * 2 * a[k] * move
        first[places["a"] + k] = cosine * 2 * g * move
        second[places["a"] + k] = bend * 2 * g * move
        first[places["b"] + k] = -sine * 2 * g * a[k] * move
        # d(c + b cos b)/db = cos b - b sin b: c is an unknown of its own.
        second[places["b"] + k] = (cosine - b[k] * sine) * 2 * g * a[k] * move
        second[places["ends"] + 2 * k] = 2 * g * a[k] * move
    by_columns = np.concatenate([expected[:, 0], expected[:, 1]]) * np.array(scales)
    assert slope == pytest.approx(by_columns, abs=EXACT)


def test_what_is_prescribed_at_the_start_may_be_any_expression_of_it() -> None:
    derived, _, program = _motion(lambda a: ca.vertcat(3.0 * a[0], a[1] + a[0] ** 2))
    _, (value,) = _at(program, derived.value)
    # A move of 1 of the first expression moves a_0 by 1/3, and a_1 back by 2 a_0 / 3.
    first, second = _unit_moves()
    assert value[:, 0] == pytest.approx(first / 3 - second * 2 * 0.4 / 3, abs=EXACT)
    assert value[:, 1] == pytest.approx(2 * second, abs=EXACT)


def _unit_moves() -> tuple[Any, Any]:
    derived, _, program = _motion()
    _, (value,) = _at(program, derived.value)
    return value[:, 0], value[:, 1] / 2


EPS = float(np.finfo(np.float64).eps)
N_COLUMNS = 3


def pair() -> ca.Function:
    """Return a function of a pair and a number with two rows, and an output besides."""
    x, t = ca.SX.sym("x", 2), ca.SX.sym("t")
    rows = ca.vertcat(ca.sin(x[0]) * x[1] * t, x[0] ** 2 - t)
    return ca.Function("pair", [x, t], [rows, x[0]])


def mapped(unknowns: ca.MX, scale: ca.DM) -> tuple[MappedRows, ca.MX]:
    """Return rows at columns that are unknowns, products of them and constants; and the rows."""
    states = ca.horzcat(unknowns[:2], unknowns[1:3] * unknowns[0], ca.MX([0.5, -2.0]))
    times = ca.horzcat(unknowns[3], 4.0, ca.exp(unknowns[4]))
    rows = MappedRows(function=pair(), parts=(states, times), n_columns=N_COLUMNS, scale=scale)
    return rows, ca.vec(pair().map(N_COLUMNS)(states, times)[0]) / scale


def both(scale: ca.DM, wrong: ca.DM | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the Jacobian by the chain rule and by CasADi at one point."""
    unknowns = ca.MX.sym("u", 5)
    first, last = ca.sumsqr(unknowns), unknowns[4] * unknowns[:2]
    block, _ = mapped(unknowns, scale if wrong is None else wrong)
    _, plain = mapped(unknowns, scale)
    ours = rows_jacobian([first, block, last, block], unknowns)
    theirs = ca.jacobian(ca.vertcat(first, plain, last, plain), unknowns)
    at = np.array([0.3, -1.2, 0.8, 2.0, 0.1])
    values = ca.Function("values", [unknowns], [ours, theirs])(at)
    return values[0].full(), values[1].full()


def test_mapped_rows_between_plain_ones_have_the_jacobian_of_the_whole_graph() -> None:
    ours, theirs = both(ca.DM([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    assert ours.shape == (1 + 6 + 2 + 6, 5)
    # A dozen operations an entry, in another order.
    assert np.max(np.abs(ours - theirs)) <= 12 * EPS * np.max(np.abs(theirs))


def test_a_scale_that_is_not_the_rows_own_shows() -> None:
    ours, theirs = both(ca.DM.ones(6), wrong=ca.DM([1.0, 1.0, 1.0, 1.0, 2.0, 1.0]))
    assert np.max(np.abs(ours - theirs)) > 0.1


def test_a_function_is_differentiated_by_every_part_of_its_column() -> None:
    unknowns = ca.MX.sym("u", 3)
    block = MappedRows(
        function=pair(), parts=(unknowns[:2], unknowns[2]), n_columns=1, scale=ca.DM.ones(2)
    )
    at = np.array([0.7, 1.5, 0.2])
    jacobian = ca.Function("jacobian", [unknowns], [rows_jacobian([block], unknowns)])(at)
    x, y, t = at
    expected = np.array([[np.cos(x) * y * t, np.sin(x) * t, np.sin(x) * y], [2 * x, 0.0, -1.0]])
    assert jacobian.full() == pytest.approx(expected, rel=8 * EPS)


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
        1,
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
