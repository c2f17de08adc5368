"""The steps of an engine as the loop takes them, if they are its own."""

from __future__ import annotations

import math
from typing import NamedTuple

from zeno_orbits.integrators import Automatic, Engine, Radau, RungeKutta, radau_scheme
from zeno_orbits.loop import binding


class LoopSteps(NamedTuple):
    """Kinds and bounds of steps.

    Attributes:
        begins_explicit: The first steps of a leg are explicit.
        goes_implicit: Implicit steps take over where they pay.
        largest_explicit: No explicit step is longer, in the time of the flow.
        largest_implicit: No implicit step is longer.
    """

    begins_explicit: bool
    goes_implicit: bool
    largest_explicit: float
    largest_implicit: float


def loop_steps(engine: Engine) -> LoopSteps | None:
    """Return the steps of an engine, or ``None`` if the loop does not take them.

    Args:
        engine: The engine. One of a derived class may do anything.
    """
    if type(engine) is RungeKutta:
        return LoopSteps(True, False, engine.largest_step, math.inf)
    if type(engine) is Radau:
        own = engine.scheme is radau_scheme(binding.STAGES)
        return LoopSteps(False, False, math.inf, engine.largest_step) if own else None
    if type(engine) is Automatic:
        explicit, implicit = loop_steps(engine.explicit), loop_steps(engine.implicit)
        if explicit is None or implicit is None:
            return None
        return LoopSteps(True, True, explicit.largest_explicit, implicit.largest_implicit)
    return None
