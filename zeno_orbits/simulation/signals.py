"""Signals of an orbit, states and motor quantities, and their extremes along simulated arcs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Samples:
    """States inside an arc, at its engine's steps and between them.

    Attributes:
        arc: The arc.
        times: The flow's own times, ``(n,)``.
        states: States at these times, ``(n, n_x)``.
    """

    arc: Arc
    times: Vector
    states: Vector

    def state_at(self, time: float) -> Vector:
        """Return the state at one of the flow's own times, ``(n_x,)``."""
        return self.arc.flow_state_at(time)[: self.states.shape[1]]


def samples_inside(arc: Arc, *, is_short: bool = False) -> Samples:
    """Return states inside an arc, none for an arc without duration.

    Args:
        arc: An arc with a flow.
        is_short: True for a late flight between accumulating impacts, for which the engine's steps
            are samples enough.
    """
    duration, own, n_x = arc.duration, arc.flow_times, len(arc.start_state)
    if duration <= 0.0 or (is_short and len(own) > _FEW):
        return Samples(arc=arc, times=own[1:-1], states=arc.flow_states[1:-1, :n_x])
    inside = np.linspace(_EDGE * duration, (1 - _EDGE) * duration, _LEAST_SAMPLES)
    steps = own[(own > inside[0]) & (own < inside[-1])]
    inside = np.unique(np.concatenate([inside, steps]))
    return Samples(arc=arc, times=inside, states=arc.flow_states_at(inside)[:, :n_x])


_FEW = 3
"""Number of the engine's times in a flight that are too few samples."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lows:
    """Local minima of a function inside an arc.

    Attributes:
        states: States at the minima, ``(n_x,)`` each.
        falls: True if the function falls just before the end of the arc.
        rises: True if the function rises just after the start of the arc.
    """

    states: tuple[Vector, ...] = ()
    falls: bool = False
    rises: bool = False


def lows_inside(inside: Sequence[Samples], rate: Callable[[Vector], Vector]) -> list[Lows]:
    """Return the local minima of a function inside each of several arcs.

    Args:
        inside: Samples of the arcs.
        rate: The time derivative of the function along the arcs, from states ``(n, n_x)`` to
            ``(n,)``.
    """
    from scipy.optimize import brentq

    def rate_at(time: float, one: Samples) -> float:
        return float(rate(one.state_at(time)[None])[0])

    ends = np.cumsum([len(one.times) for one in inside])
    rates = np.split(rate(np.concatenate([one.states for one in inside])), ends[:-1])
    found: list[Lows] = []
    for one, values in zip(inside, rates, strict=True):
        low = np.flatnonzero((values[:-1] < 0.0) & (values[1:] >= 0.0))
        roots = [brentq(rate_at, *one.times[k : k + 2], args=(one,), xtol=1e-14) for k in low]
        found.append(
            Lows(
                states=tuple(map(one.state_at, roots)),
                falls=bool(values.size and values[-1] < 0.0),
                rises=bool(values.size and values[0] > 0.0),
            )
        )
    return found
