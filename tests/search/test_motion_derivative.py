"""The derivative of a program's motion against one that is known in closed form."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from zeno_orbits.search.transcription import motion_derivative
from zeno_orbits.search.transcription.motion_derivative import ProgramMotion, derivative_along
from zeno_orbits.search.transcription.program import ProgramBuilder

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


def test_a_function_of_many_columns_is_differentiated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    directional = motion_derivative._directional

    def counted(function: ca.Function) -> ca.Function:
        made.append(function.name())
        return directional(function)

    monkeypatch.setattr(motion_derivative, "_directional", counted)
    program = ProgramBuilder()
    a = program.variable("a", 0.5)[0, 0]
    ends = program.variable("ends", [[0.2, 0.9], [0.1, 0.5]])
    function = _pair()
    program.equal_along("first", function, (ends[:, 0], a))
    program.equal_along("second", function, (ends[:, 1], ends[0, 0]))
    motion = ProgramMotion(blocks=program.blocks, equations=program.equations)
    derived = derivative_along(program, motion, a, np.array([[1.0, -3.0]]), ends[0, 1])
    assert made == ["pair"]
    # sin of sin, along two directions.
    slope = np.cos(0.2) * np.cos(0.5)
    assert program.at_guess(derived.value).full() == pytest.approx(np.array([[slope, -3 * slope]]))
