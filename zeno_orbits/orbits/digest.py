"""A digest of a problem's equations, which identifies the problem of an orbit.

The compiled functions are evaluated at fixed states and at a parameter vector of order 1. The
entries of each result are summed with fixed weights. Equivalent equations in another form have the
same digest, on any machine and with any version of CasADi. Other equations have another digest,
unless they differ on branches of kinks that hold at none of the states.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, cast

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import Problem

_SAME = 1e-6
"""Largest relative difference of the digests of the same equations."""

_SIZES = (0.1, 1.0, 10.0, 100.0)
"""Sizes of the states at which the formulas of a graph are evaluated."""
_SPREAD = (math.sqrt(5) - 1) / 2
_FUNCTIONS, _IMPULSE = 6, 3
"""Number of functions of a machine with one stop, and the place of the impulse."""


@lru_cache(maxsize=64)
def digest_of(problem: Problem) -> tuple[float, ...]:
    """Return one value per function of a problem: flows, contact, impulse, energy, motors.

    A machine with several stops, switches or kinks has one value per formula of its graph.
    """
    if problem.has_graph:
        return _digest_of_graph(problem)
    compiled = problem.compiled()
    x, p = _spread(compiled.n_x, 0.2), _spread(len(problem.symbols()), 0.5)
    functions = (
        compiled.free.rate,
        compiled.locked.rate,
        compiled.contact,
        compiled.impulse,
        compiled.energy,
        compiled.motors,
    )
    return tuple(_number(function(x, p)) for function in functions)


def _digest_of_graph(problem: Problem) -> tuple[float, ...]:
    """Return the values of flow, energy, gaps, switches and resets at states of several sizes.

    A kink takes the branch that holds at a state. States of all sizes and signs reach the branches
    of a limit, and small states are not lost beside large ones.
    """
    symbols = problem.symbols()
    system = problem.model(symbols)
    graph = system.graph
    groups = (
        (system.free_flow,),
        (system.energy,),
        tuple(ca.SX(stop.gap) for stop in graph.stops),
        tuple(stop.law.numbers for stop in graph.stops),
        (graph.delassus,),
        tuple(ca.SX(one.guard) for one in graph.switches),
        tuple(ca.SX(one.armed) for one in graph.switches),
        graph.resets,
    )
    names = ca.vertcat(*symbols.values())
    outputs = [ca.vertcat(*(ca.vec(ca.SX(one)) for one in group)) for group in groups]
    function = ca.Function("digest", [graph.state, names], [ca.densify(one) for one in outputs])
    x, p = _spread(graph.state.numel(), 0.2), _spread(names.numel(), 0.5)
    turned = x * np.where(np.arange(len(x)) % 2, -1.0, 1.0)
    found: list[float] = []
    for size in _SIZES:
        at = [function.call([size * state, p]) for state in (x, -x, turned, -turned)]
        found += [_number([_defined(one) for one in each]) for each in zip(*at, strict=True)]
    return tuple(found)


def _defined(entries: Any) -> Vector:
    """Return values with 0 for the formulas that are undefined at this state."""
    return np.nan_to_num(np.asarray(entries, dtype=np.float64), posinf=0.0, neginf=0.0)


def same_equations(digest: Sequence[float], other: Sequence[float]) -> bool:
    """Return True if two digests belong to the same equations.

    The impulse of a machine with one stop is never zero. Where a digest says so, it was undefined.
    """
    return len(digest) == len(other) and all(
        math.isclose(a, b, rel_tol=_SAME, abs_tol=_SAME)
        or (len(digest) == _FUNCTIONS and k == _IMPULSE and 0.0 in (a, b))
        for k, (a, b) in enumerate(zip(digest, other, strict=True))
    )


def other_equations(digest: Sequence[float], problem: Problem) -> str:
    """Return the clause that an orbit's digest belongs to other equations, or no text.

    Args:
        digest: Digest of the orbit, empty if its file lacks it.
        problem: The problem.
    """
    if not digest or same_equations(digest, digest_of(problem)):
        return ""
    return f"the equations of problem `{problem.name}` differ from those that gave the orbit"


def _spread(n: int, least: float) -> Vector:
    """Return distinct numbers between ``least`` and ``1 + least``, ``(n,)``."""
    return least + np.mod(_SPREAD * np.arange(1, n + 1), 1.0)


def _number(outputs: Any) -> float:
    entries: Sequence[Any] = (
        cast("Any", outputs) if isinstance(outputs, tuple | list) else (outputs,)
    )
    values = np.concatenate([np.asarray(entry, dtype=np.float64).ravel() for entry in entries])
    total = float(values @ _spread(values.size, 0.2))
    # A formula that is undefined at this state does not contribute.
    return total if math.isfinite(total) else 0.0
