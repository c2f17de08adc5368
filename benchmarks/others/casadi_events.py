"""CasADi: the events of its own integrators, experimental since 3.6.

The mode is a state that only events change; one guard a mode, and a transition function that
resets impacts, makes slow ones plastic, and releases. A motion must never start *on* a guard, which
no event would leave, so the gap is nudged by 1e-12 rad after every event. `rosenbrock` then goes
the whole way, interpreted or compiled in C; `cvodes` and `idas` are run to show what they do.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import casadi as ca
import work
from work import HORIZON, Method, Motion

NUDGE = 1e-12
"""Gap after an event [rad]."""


COMPILED = {"jit": True, "compiler": "shell"}
"""Options that have a C compiler translate model and integrator."""

SCRATCH = tempfile.TemporaryDirectory()
"""Where CasADi puts what it compiles; else it would be the working folder."""


@cache
def built(plugin: str, rate: float, accuracy: float, *, compiled: bool) -> Any:
    """Return the integrator of the whole motion, interpreted or compiled in C."""
    machine, slowest = work.pendulum(rate), work.cut(accuracy)
    x, t, guard = ca.SX.sym("x", 6), ca.SX.sym("t"), ca.SX.sym("guard")
    pendulum, on_stop = [x[k] for k in range(5)], x[5] > 0.5
    slow = -x[3] < slowest
    plastic, elastic = (machine.impact(pendulum, e) for e in (0.0, machine.restitution))
    struck = [ca.if_else(slow, *pair) for pair in zip(plastic, elastic, strict=True)]
    after_impact = ca.vertcat(struck[0], NUDGE, *struck[2:], ca.if_else(slow, 1, 0))
    after_release = ca.vertcat(x[0], NUDGE, x[2], 0, x[4], 0)
    transition = ca.Function(
        "transition",
        {
            "index": guard,
            "t": t,
            "x": x,
            "post_x": ca.if_else(guard < 0.5, after_impact, after_release),
        },
        ["index", "t", "x", "z", "p", "u"],
        ["post_x", "post_z"],
    )
    free = machine.rates(pendulum, ca.sin, ca.cos)
    carried = machine.locked_rates([x[0], x[2], x[4]], ca.sin)
    locked_rates = (carried[0], 0, carried[1], 0, carried[2])
    rates = [ca.if_else(on_stop, *pair) for pair in zip(locked_rates, free, strict=True)]
    hold = machine.hold(x[0], x[4], ca.sin)
    guards = ca.vertcat(ca.if_else(on_stop, 1, x[1]), ca.if_else(on_stop, hold, 1))
    return ca.integrator(
        "motion",
        plugin,
        {"t": t, "x": x, "ode": ca.vertcat(*rates, 0), "zero": guards},
        0,
        HORIZON,
        {
            "transition": transition,
            "max_events": 10_000,
            "max_num_steps": 10_000_000,
            "reltol": accuracy,
            "abstol": accuracy,
            "jit_options": {"flags": ["-O2"], "directory": f"{SCRATCH.name}/"},
            **(COMPILED if compiled else {}),
        },
    )


def prepare(
    plugin: str,
    rate: float,
    accuracy: float,
    start: Sequence[float],
    locked: bool,
    *,
    compiled: bool = False,
) -> Callable[[], Motion]:
    """Build the integrator, and return the whole motion as a function without arguments."""
    integrator = built(plugin, rate, accuracy, compiled=compiled)
    x0 = [start[0], NUDGE, *start[2:], int(locked)]

    def follow() -> Motion:
        end = integrator(x0=x0)["xf"].full().ravel().tolist()
        if not -1e-6 < end[1] < 10.0:
            raise RuntimeError(f"left the mechanism without a word: theta2 = {end[1]:.0f} rad")
        return Motion(state=end[:5])

    return follow


def version() -> str:
    """Return which CasADi it is."""
    return f"CasADi {ca.__version__}"


METHODS = [
    Method(
        name="CasADi rosenbrock",
        accuracies=(1e-4, 1e-5, 1e-6, 1e-8, 1e-10, 1e-11),
        sweep_accuracies=(1e-6, 1e-7, 1e-8, 1e-11),
        prepare=partial(prepare, "rosenbrock"),
    ),
    Method(
        name="CasADi ros. with jit",
        accuracies=(1e-5, 1e-6, 1e-8, 1e-10, 1e-11),
        sweep_accuracies=(1e-6, 1e-7, 1e-8),
        prepare=partial(prepare, "rosenbrock", compiled=True),
    ),
    Method(name="CasADi cvodes", accuracies=(1e-8,), prepare=partial(prepare, "cvodes")),
    Method(name="CasADi idas", accuracies=(1e-8,), prepare=partial(prepare, "idas")),
]

if __name__ == "__main__":
    # CasADi warns on stdout's and stderr's descriptors; stdout is for the result.
    result = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    sys.stdout = result
    sys.exit(work.serve(__doc__, METHODS, version))
