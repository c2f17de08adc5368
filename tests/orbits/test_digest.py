"""Equations are recognized, however they are written."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.support.one_stop import one_stop_problems
from zeno_orbits.model import Problem, load_problem
from zeno_orbits.orbits import digest as module
from zeno_orbits.orbits import digest_of, same_equations


def test_the_same_equations_written_in_another_way_have_the_same_digest(problem: Problem) -> None:
    def rewritten(symbols):
        system = problem.model(symbols)
        return replace(
            system,
            energy=3 * system.energy - 2 * system.energy,
            free_flow=(system.free_flow + 1.0) - 1.0,
        )

    other = replace(problem, model=rewritten)
    assert same_equations(digest_of(problem), digest_of(other))


@pytest.mark.parametrize("name", ["free_flow", "locked_flow", "gap", "multiplier", "energy"])
def test_a_term_that_is_changed_by_a_thousandth_changes_the_digest(
    problem: Problem, name: str
) -> None:
    def changed(symbols):
        system = problem.model(symbols)
        return replace(system, **{name: 1.001 * getattr(system, name)})

    other = replace(problem, model=changed)
    assert not same_equations(digest_of(problem), digest_of(other))


def test_default_numbers_and_titles_are_no_equations(problem: Problem) -> None:
    parameters = [
        replace(quantity, default=0.3 if quantity.default is None else 0.9 * quantity.default)
        for quantity in problem.parameters
    ]
    other = replace(problem, title="another", parameters=tuple(parameters))
    assert digest_of(problem) == digest_of(other)


@pytest.mark.slow
def test_problems_of_different_machines_have_different_digests() -> None:
    digests = {name: digest_of(load_problem(name)) for name in one_stop_problems()}
    for name, digest in digests.items():
        alike = [other for other in digests if same_equations(digest, digests[other])]
        # Both are one mass on a spring before a stop, shaken by a clock.
        both = {"forced_oscillator", "impact_oscillator"}
        assert set(alike) == (both if name in both else {name})


def test_the_digest_of_a_ball_is_what_files_of_it_hold() -> None:
    # By hand: k (sqrt(5) - 1) / 2 without its whole part for k = 1, 2 and so on, plus 0.2 for a
    # state or a weight and plus 0.5 for a parameter.
    parts = np.array(
        [0.6180339887498949, 0.2360679774997898, 0.8541019662496847, 0.4721359549995796]
    )
    (height, speed), (m, g) = parts[:2] + 0.2, parts[:2] + 0.5
    weight = parts + 0.2
    free, locked, contact, _, energy, motors = digest_of(load_problem("bouncing_ball"))
    assert free == pytest.approx(weight[0] * speed - weight[1] * g, rel=1e-12)
    assert locked == pytest.approx(weight[0] * speed, rel=1e-12)
    assert contact == pytest.approx(weight @ [height, speed, -g, m * g], rel=1e-12)
    assert energy == pytest.approx(weight[0] * m * (speed**2 / 2 + g * height), rel=1e-12)
    assert motors == 0.0


def test_digests_agree_to_a_millionth_of_their_size_and_small_ones_to_a_millionth() -> None:
    one = (1.0, -3e4, 0.0)
    assert same_equations(one, (1.0, -3e4 * (1 + 0.9e-6), 0.9e-6))
    assert not same_equations(one, (1.0, -3e4 * (1 + 1.5e-6), 0.0))
    assert not same_equations(one, (1.0, -3e4, 1.5e-6))
    assert not same_equations(one, one[:2])


def test_a_function_without_a_value_at_the_state_of_the_digest_tells_nothing() -> None:
    assert module._number((np.array([1.0, math.nan]), 2.0)) == 0.0
    assert module._number(np.array([0.0, math.inf])) == 0.0
    # The weights are 0.818 and 0.436.
    assert module._number((1.0, 2.0)) == pytest.approx(0.8180339887 + 2 * 0.4360679775)
