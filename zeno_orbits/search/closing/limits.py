"""Limits of the states of a period, and states by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import Problem
from zeno_orbits.simulation import Arc


def beyond_limits(problem: Problem, arcs: Sequence[Arc]) -> str:
    """Return a clause on the first declared limit of a state that a period exceeds, or none.

    Args:
        problem: The problem, with its `escapes`.
        arcs: The arcs of a period.
    """
    for name, escape in problem.escapes.items():
        place = problem.state_names.index(name)
        size = max(float(np.max(np.abs(arc.flow_states[:, place]))) for arc in arcs)
        if size > escape.beyond:
            passed = f"`{name}` reaches {size:.4g}, beyond {escape.beyond:.4g}"
            return f"{escape.phrase[0].upper()}{escape.phrase[1:]}: {passed}"
    return ""


def named(problem: Problem, state: Vector) -> dict[str, float]:
    """Return a mapping of state name to value."""
    return dict(zip(problem.state_names, map(float, state), strict=True))
