"""jaxonomy: zero crossings of a leaf system, and the switch that it has for Zeno behaviour.

The mode is a state that only events change, slow impacts are made plastic by hand, and the gap is
nudged by 1e-12 rad after every event, as for CasADi. The ball is simulated past its Zeno time, as
it is and with the switch. No Zeno time is told, so what comes of it is the failure of its row.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import work
from work import HORIZON, Method, Motion

NUDGE = 1e-12
"""Gap after an event [rad]."""

BALL_UNTIL = 5.0
"""Simulated time of the ball, past its Zeno time at 4.06 s [s]."""


def load() -> Any:
    """Return jaxonomy.

    Raises:
        NotInstalledError: If it is not there.
    """
    try:
        import jax
        import jaxonomy
    except ImportError as error:
        raise work.NotInstalledError(f"jaxonomy is not installed ({error})") from error
    jax.config.update("jax_enable_x64", True)
    return jaxonomy


def machine_of(rate: float, accuracy: float) -> Any:
    """Return the pendulum as a leaf system; the last of its six states is 1 on the stop."""
    jaxonomy = load()
    import jax.numpy as jnp

    machine, slowest = work.pendulum(rate), work.cut(accuracy)

    class Machine(jaxonomy.LeafSystem):
        def __init__(self) -> None:
            super().__init__(name="machine")
            self.declare_continuous_state(6, ode=self.rates)
            for guard, reset in ((self.gap, self.impact), (self.hold, self.release)):
                self.declare_zero_crossing(
                    guard=guard, reset_map=reset, direction="positive_then_non_positive"
                )

        def rates(self, _time: Any, state: Any, **_: Any) -> Any:
            x = state.continuous_state
            free = machine.rates(x[:5], jnp.sin, jnp.cos)
            turn, spin, current = machine.locked_rates([x[0], x[2], x[4]], jnp.sin)
            held = (turn, 0.0, spin, 0.0, current)
            pairs = zip(held, free, strict=True)
            return jnp.array([*(jnp.where(x[5] > 0.5, *pair) for pair in pairs), 0.0])

        def gap(self, _time: Any, state: Any, **_: Any) -> Any:
            x = state.continuous_state
            return jnp.where(x[5] > 0.5, 1.0, x[1])

        def hold(self, _time: Any, state: Any, **_: Any) -> Any:
            x = state.continuous_state
            return jnp.where(x[5] > 0.5, machine.hold(x[0], x[4], jnp.sin), 1.0)

        def impact(self, _time: Any, state: Any, **_: Any) -> Any:
            x = state.continuous_state
            slow = -x[3] < slowest
            after = [
                jnp.where(slow, *pair)
                for pair in zip(
                    machine.impact(x[:5], 0.0),
                    machine.impact(x[:5], machine.restitution),
                    strict=True,
                )
            ]
            locked = jnp.where(slow, 1.0, 0.0)
            return state.with_continuous_state(jnp.array([after[0], NUDGE, *after[2:], locked]))

        def release(self, _time: Any, state: Any, **_: Any) -> Any:
            x = state.continuous_state
            free = jnp.array([x[0], NUDGE, x[2], 0.0, x[4], 0.0])
            return state.with_continuous_state(free)

    return Machine()


def prepare(
    rate: float, accuracy: float, start: Sequence[float], locked: bool
) -> Callable[[], Motion]:
    """Compile the simulation, and return the whole motion as a function without arguments."""
    jaxonomy, system = load(), machine_of(rate, accuracy)
    import jax.numpy as jnp

    context = system.create_context()
    begin = jnp.array([start[0], NUDGE, *start[2:], float(locked)])
    options = jaxonomy.SimulatorOptions(rtol=accuracy, atol=accuracy, max_major_steps=5000)
    simulator = jaxonomy.Simulator(system, options=options)

    def follow() -> Motion:
        end = simulator.advance_to(HORIZON, context.with_continuous_state(begin)).context
        state = [float(value) for value in end.continuous_state]
        if not float(end.time) >= HORIZON:
            raise RuntimeError(f"stopped at {float(end.time):.6f} s without a word")
        return Motion(state=state[:5])

    return follow


def prepare_ball(switch: bool, accuracy: float) -> Callable[[], float]:
    """Return a function that tells, as an error, what becomes of the ball after its Zeno time."""
    jaxonomy = load()
    import jax.numpy as jnp

    class Ball(jaxonomy.LeafSystem):
        def __init__(self) -> None:
            super().__init__(name="ball")
            self.declare_continuous_state(2, ode=self.rates)
            self.declare_zero_crossing(
                guard=lambda _time, state, **_: state.continuous_state[0],
                reset_map=self.impact,
                direction="positive_then_non_positive",
                zeno_tolerance=1e-6 if switch else None,
            )

        def rates(self, _time: Any, state: Any, **_: Any) -> Any:
            return jnp.array([state.continuous_state[1], -work.BALL_GRAVITY])

        def impact(self, _time: Any, state: Any, **_: Any) -> Any:
            height, speed = state.continuous_state
            after = jnp.array([jnp.abs(height), -work.BALL_RESTITUTION * speed])
            return state.with_continuous_state(after)

    options = jaxonomy.SimulatorOptions(rtol=accuracy, atol=accuracy, max_major_steps=5000)
    system = Ball()
    context = system.create_context()
    context = context.with_continuous_state(jnp.array([work.BALL_HEIGHT, 0.0]))
    simulator = jaxonomy.Simulator(system, options=options)

    def zeno_time() -> float:
        end = simulator.advance_to(BALL_UNTIL, context).context
        height, speed = (float(value) for value in end.continuous_state)
        reached = f"at {float(end.time):.9f} s, height {height:.1e} m, speed {speed:.1e} m/s"
        raise RuntimeError(f"no Zeno time; asked for {BALL_UNTIL} s it ends {reached}")

    return zeno_time


def version() -> str:
    """Return which jaxonomy it is."""
    from importlib.metadata import version as version_of

    load()
    return f"jaxonomy {version_of('jaxonomy')}"


METHODS = [
    Method(
        name="jaxonomy",
        accuracies=(1e-4, 1e-6, 1e-8, 1e-10),
        prepare=prepare,
        ball=partial(prepare_ball, False),
    ),
    Method(
        name="jaxonomy, switch", accuracies=(), prepare=prepare, ball=partial(prepare_ball, True)
    ),
]

if __name__ == "__main__":
    sys.exit(work.serve(__doc__, METHODS, version))
