"""Compiled scenes, built once: to build one takes as long as to simulate a period of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

from zeno_orbits.compiled import CompiledSystem, compile_problem
from zeno_orbits.dynamics import HybridDynamics
from zeno_orbits.hybrid import CompletedSystem
from zeno_orbits.problem import Problem, Setting, load_reference

_MOST = 16
"""Compiled scenes that are remembered; a session that makes thousands must not keep them all."""


@lru_cache(maxsize=_MOST)
def compiled_model(
    problem: Problem, transform: Callable[[CompletedSystem], CompletedSystem] | None = None
) -> CompiledSystem:
    """Return the functions of a scene, the same ones for the same scene and transform.

    A scene never changes and its functions hold symbols for all numbers, so they may be shared;
    what is bound to numbers has memory of its own.

    Args:
        problem: The scene; another object is another scene, however alike.
        transform: A change of the completed system first, a function of a module.
    """
    return compile_problem(problem, transform)


@lru_cache(maxsize=_MOST)
def reference_model(problem: Problem) -> Callable[[Setting], HybridDynamics]:
    """Return the hand-written model of a scene as a function of its numbers.

    Its file is read once for each scene, as the scene's own was.

    Raises:
        InputError: If the scene has none.
        ProblemFileError: If its file does not load.
    """
    return load_reference(problem).dynamics
