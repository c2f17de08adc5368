"""Equations are recognized, however they are written."""

from __future__ import annotations

from dataclasses import replace

import pytest

from zeno_orbits.model.library import bundled_problems, load_problem
from zeno_orbits.model.problem import Problem
from zeno_orbits.orbits.digest import digest_of, same_equations


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


def test_problems_of_different_machines_have_different_digests() -> None:
    digests = {name: digest_of(load_problem(name)) for name in bundled_problems()}
    for name, digest in digests.items():
        alike = [other for other in digests if same_equations(digest, digests[other])]
        # Both are one mass on a spring before a stop, shaken by a clock.
        both = {"forced_oscillator", "impact_oscillator"}
        assert set(alike) == (both if name in both else {name})
