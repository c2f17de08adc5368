"""A digest of a problem's equations, which identifies the problem of an orbit.

The compiled functions are evaluated at one fixed state and parameter vector of order 1. The entries
of each result are summed with fixed weights. Equivalent equations in another form have the same
digest, on any machine and with any version of CasADi. Other equations have another digest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, cast

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import Problem

_SAME = 1e-6
"""Largest relative difference of the digests of the same equations."""

_SPREAD = (math.sqrt(5) - 1) / 2


@lru_cache(maxsize=64)
def digest_of(problem: Problem) -> tuple[float, ...]:
    """Return one value per function of a problem: flows, contact, impulse, energy, motors."""
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


def same_equations(digest: Sequence[float], other: Sequence[float]) -> bool:
    """Return True if two digests belong to the same equations."""
    return len(digest) == len(other) and all(
        math.isclose(a, b, rel_tol=_SAME, abs_tol=_SAME) for a, b in zip(digest, other, strict=True)
    )


def _spread(n: int, least: float) -> Vector:
    """Return distinct numbers between ``least`` and ``1 + least``, ``(n,)``."""
    return least + np.mod(_SPREAD * np.arange(1, n + 1), 1.0)


def _number(outputs: Any) -> float:
    entries: Sequence[Any] = cast("Any", outputs) if isinstance(outputs, tuple) else (outputs,)
    values = np.concatenate([np.asarray(entry, dtype=np.float64).ravel() for entry in entries])
    total = float(values @ _spread(values.size, 0.2))
    # A formula that is undefined at this state does not contribute.
    return total if math.isfinite(total) else 0.0
