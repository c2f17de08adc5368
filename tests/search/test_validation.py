"""Searches that make no sense are refused, those at the border are not."""

from __future__ import annotations

import math
from typing import Any

import pytest

from zeno_orbits import NearestGains
from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Bound, Orbit
from zeno_orbits.search import SearchSettings, TransientSettings, search_orbits


def _check(problem: Problem, **asked: Any) -> None:
    """Search for a moment: a search that makes sense ends without an orbit."""
    settings = SearchSettings(settling=TransientSettings(horizon=1e-3), n_starts=0)
    told = {"free": {"Kp": (1.0, 2.0)}, **asked}
    search_orbits(problem, problem.values(), settings=settings, **told)


@pytest.mark.parametrize(
    "bounds",
    [
        (),
        (Bound(name="period", upper=1e-9), Bound(name="margin", lower=0.999)),
        (Bound(name="spectral_radius", upper=1e-4), Bound(name="current", lower=-2.0)),
        # What is refused of one quantity is none of another's business.
        (Bound(name="current", upper=0.0), Bound(name="theta1", lower=1.0)),
        (Bound(name="period", lower=1.0), Bound(name="margin", upper=-0.5)),
        (Bound(name="theta2", lower=2.0), Bound(name="theta1", upper=1e-5)),
    ],
)
def test_bounds_at_the_border_of_sense_are_taken(
    problem: Problem, bounds: tuple[Bound, ...]
) -> None:
    _check(problem, bounds=bounds)


@pytest.mark.parametrize(
    ("bound", "said"),
    [
        (Bound(name="period", upper=0.0), "positive `period`, but it has :0"),
        (Bound(name="period", upper=-1.0), "positive `period`, but it has :-1"),
        (Bound(name="margin", lower=1.0), "`margin` below 1, .*, but it has 1:"),
        (Bound(name="margin", lower=1.5), "`margin` below 1, .*, but it has 1.5:"),
        (Bound(name="spectral_radius", lower=0.1, upper=0.5), "above only, but it has 0.1:0.5"),
        (Bound(name="spectral_radius", upper=9.9e-5), "0.0001 or more, .*, but it has :9.9e-05"),
    ],
)
def test_a_bound_that_nothing_can_keep_is_told_with_what_it_asks(
    problem: Problem, bound: Bound, said: str
) -> None:
    # The first bound is not the only one that is looked at.
    with pytest.raises(InputError, match=rf"^Argument `bounds` must .*{said}"):
        _check(problem, bounds=(Bound(name="current", lower=-math.pi), bound))


def test_a_quantity_is_bounded_once_wherever_it_is_named_again(problem: Problem) -> None:
    first, other = Bound(name="current", lower=-3.0), Bound(name="voltage", lower=-3.0)
    _check(problem, bounds=(first, other))
    with pytest.raises(InputError, match="`bounds` must bound `current` once"):
        _check(problem, bounds=(first, other, Bound(name="current", upper=3.0)))


def test_every_number_that_is_free_has_a_range(problem: Problem) -> None:
    with pytest.raises(InputError, match=r"`vary` must .* for `R`"):
        _check(problem, free={"Kp": (1.0, 2.0), "R": (3.0, 3.0)})


def test_every_initial_state_is_one_of_the_problem(problem: Problem) -> None:
    state = dict.fromkeys(problem.state_names, 0.5)
    _check(problem, initial_states=(state,))
    with pytest.raises(InputError, match="`angle`"):
        _check(problem, initial_states=(state, {**state, "angle": 1.0}))


@pytest.mark.slow
def test_a_known_orbit_is_one_of_the_problem(problem: Problem, orbit: Orbit) -> None:
    _check(problem, near=orbit)
    other = problem.at_fidelity("quasi_static")
    wrong = "of problem `motor_pendulum@quasi_static`, but it is of `motor_pendulum`"
    with pytest.raises(InputError, match=wrong):
        _check(other, near=orbit)


def test_an_objective_is_held_against_the_problem_and_what_is_free(problem: Problem) -> None:
    asked = NearestGains(target={"R": 2.0})
    _check(problem, free={"R": (1.0, 3.0)}, objective=asked)
    with pytest.raises(InputError, match="names `R`"):
        _check(problem, objective=asked)
