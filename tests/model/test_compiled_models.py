"""Compiled problems are shared where that is safe, and only there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from zeno_orbits.model.hybrid import audited
from zeno_orbits.model.library import load_problem


def test_a_problem_is_compiled_once_for_each_transform() -> None:
    problem = load_problem("motor_pendulum")
    assert problem.compiled() is problem.compiled()
    assert problem.compiled(audited) is problem.compiled(audited)
    assert problem.compiled(audited) is not problem.compiled()
    assert problem.compiled(audited).n_x == problem.compiled().n_x + 3


def test_a_changed_problem_is_not_mistaken_for_the_one_it_was_made_from() -> None:
    problem = load_problem("motor_pendulum")
    other = load_problem("bouncing_ball")
    changed = replace(other, name=problem.name, title=problem.title, source=problem.source)
    again = load_problem("motor_pendulum")
    assert changed.compiled().n_x == 2
    assert problem.compiled().n_x == 5
    # Loaded anew, the file may say something else.
    assert again.compiled() is not problem.compiled()


def test_two_systems_bound_to_one_model_keep_their_own_numbers() -> None:
    problem = load_problem("motor_pendulum")
    weak = problem.values(gains={"Kp": 2.0})
    strong = problem.values(gains={"Kp": 4.0})
    shared = [problem.dynamics(values) for values in (weak, strong)]
    alone = [replace(problem).dynamics(values) for values in (weak, strong)]
    x = np.array([0.3, 0.2, 1.0, -0.5, 0.1])
    for _ in range(2):
        for ours, theirs in zip(shared, alone, strict=True):
            assert np.array_equal(ours.free.rate(x), theirs.free.rate(x))
            assert np.array_equal(ours.locked.rate(x), theirs.locked.rate(x))
    assert not np.array_equal(shared[0].free.rate(x), shared[1].free.rate(x))
