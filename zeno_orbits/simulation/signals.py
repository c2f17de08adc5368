"""Signals of an orbit, states and motor quantities, and their extremes along simulated arcs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Scalar, Vector
from zeno_orbits.model import CompiledSystem
from zeno_orbits.simulation.execution import Arc

_SAMPLES = 65
"""Number of samples of an arc in addition to the steps of its engine."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Extent:
    """The range of a quantity over an orbit.

    Attributes:
        lowest: Smallest value.
        highest: Largest value. For a property of the whole orbit it equals the smallest value.
        error: Estimated error of both values.
    """

    lowest: float
    highest: float
    error: float = 0.0

    @property
    def largest(self) -> float:
        """Largest absolute value."""
        return max(-self.lowest, self.highest)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Signal:
    """A number at every time of a motion.

    Attributes:
        name: Its name.
        function: ``(x, p) -> value``.
    """

    name: str
    function: ca.Function

    def at(self, values: Sequence[float]) -> Callable[[Vector], float]:
        """Return the signal as a function of the state, at given values of ``p``."""
        p = np.asarray(values, dtype=np.float64)
        return lambda x: float(self.function(x, p))


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """An extreme of a signal over an arc.

    Attributes:
        fraction: Where, as a fraction of the arc's duration.
        value: The signal there.
    """

    fraction: float
    value: float


def signal_names(compiled: CompiledSystem) -> tuple[str, ...]:
    """Return the names of a problem's signals: states, then motors' currents and voltages."""
    n_motors = compiled.motors.numel_out(0)
    ends = [""] if n_motors == 1 else [str(k + 1) for k in range(n_motors)]
    motors = [f"{word}{end}" for word in ("current", "voltage") for end in ends]
    return tuple(dict.fromkeys((*compiled.state_names, *motors)))


def signal(compiled: CompiledSystem, name: str) -> Signal:
    """Return a signal of a problem by its name, one of `signal_names`."""
    x = ca.SX.sym("x", compiled.n_x)
    p = ca.SX.sym("p", compiled.motors.numel_in(1))
    if name in compiled.state_names:
        value = x[compiled.state_names.index(name)]
    else:
        end = name.removeprefix("current").removeprefix("voltage")
        motor = int(end or 1) - 1
        value = compiled.motors.call([x, p])[0 if name.startswith("current") else 1][motor]
    return Signal(name=name, function=ca.Function(name, [x, p], [ca.densify(value)]))


def extent_of(value: Callable[[Vector], float], arcs: Sequence[Arc]) -> Extent:
    """Return the range of a signal over arcs, with refined peaks.

    Args:
        value: The signal as a function of the state.
        arcs: The arcs. An impact may lie between the end of an arc and the start of the next arc.
    """
    found = [peak.value for arc in arcs for sign in (1.0, -1.0) for peak in peaks(value, arc, sign)]
    return Extent(lowest=min(found), highest=max(found))


def peaks(value: Callable[[Vector], float], arc: Arc, sign: float) -> list[Peak]:
    """Return the local extremes of a signal over an arc, its ends among them.

    Args:
        value: The signal of the state.
        arc: The arc.
        sign: 1 for the largest values, -1 for the smallest.
    """
    # SciPy's optimizers take longer to import than a peak to find, and few callers need a peak.
    from scipy.optimize import minimize_scalar

    length = arc.end_time - arc.start_time
    if length <= 0.0:
        return [Peak(fraction=0.0, value=value(arc.start_state))]

    def here(fraction: float) -> float:
        return value(arc.state_at(arc.start_time + fraction * length))

    steps = arc.flow_times / arc.flow_times[-1] if arc.flow_times[-1] > 0.0 else [0.0]
    grid = np.union1d(np.linspace(0.0, 1.0, _SAMPLES), steps)
    between = arc.states_at(arc.start_time + grid[1:-1] * length)
    values = [sign * value(x) for x in (arc.start_state, *between, arc.end_state)]
    found = [
        Peak(fraction=0.0, value=sign * values[0]),
        Peak(fraction=1.0, value=sign * values[-1]),
    ]
    for k in range(1, len(grid) - 1):
        if values[k] >= values[k - 1] and values[k] > values[k + 1]:
            around = (float(grid[k - 1]), float(grid[k + 1]))
            inside = minimize_scalar(
                lambda f: -sign * here(float(f)),
                bounds=around,
                method="bounded",
                options={"xatol": 1e-9},
            )
            best, at = max((values[k], float(grid[k])), (-float(inside.fun), float(inside.x)))
            found.append(Peak(fraction=at, value=sign * best))
    return found


_LEAST_SAMPLES = 60
_EDGE = 1e-3
"""Part of an arc at its ends that is not its inside: a flight starts with its rate at zero."""


def least_inside(arc: Arc, value: Scalar, rate: Scalar) -> float | None:
    """Return the least local minimum of a function inside an arc, or ``None`` without any.

    Args:
        arc: An arc with a flow.
        value: The function of the state.
        rate: Its time derivative along the arc.
    """
    return min((value(x) for x in lows_inside(arc, rate)), default=None)


def lows_inside(arc: Arc, rate: Scalar) -> list[Vector]:
    """Return the states of the local minima of a function inside an arc, ``(n_x,)`` each.

    Args:
        arc: An arc with a flow.
        rate: The time derivative of the function along the arc.
    """
    from scipy.optimize import brentq

    duration = arc.duration
    if duration <= 0.0:
        return []
    inside = np.linspace(_EDGE * duration, (1 - _EDGE) * duration, _LEAST_SAMPLES)
    own = arc.flow_times
    inside = np.union1d(inside, own[(own > inside[0]) & (own < inside[-1])])
    n_x = len(arc.start_state)

    def state(t: float) -> Vector:
        return arc.flow_state_at(t)[:n_x]

    rates = [rate(x) for x in arc.flow_states_at(inside)[:, :n_x]]
    found: list[Vector] = []
    for k in range(len(inside) - 1):
        if rates[k] < 0.0 <= rates[k + 1]:
            left, right = float(inside[k]), float(inside[k + 1])
            root = float(brentq(lambda t: rate(state(t)), left, right, xtol=1e-14))
            found.append(state(root))
    return found
