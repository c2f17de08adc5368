"""A search in small steps: one box around each orbit, as wide as the last steps allow.

A program is drawn around one orbit and trusted near it only. Where the whole way is too far for
one, each step is a program of its own on the orbit that the last one found, simulated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from zeno_orbits.model.problem import ParameterValues
from zeno_orbits.orbits.cycle import Cycle
from zeno_orbits.search.refinement import ON_THE_WAY, Hunt
from zeno_orbits.search.settings import Find

_FIRST, _LEAST = 0.1, 2e-3
"""Half width of a box in units of the whole range: the first, and the least that is tried."""

_MOST_STEPS = 40
_TOUCHES = 1e-3
"""A number this near the side of its box, in units of its half width, is held by it."""

_STILL = 1e-5
"""A step that moves nothing by more, in units of the ranges, has arrived."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """Where a walk ended.

    Attributes:
        values: The numbers there.
        cycle: One simulated period there.
        find: What the last step that counted found; ``None`` if none did.
        arrived: Whether no further step would lead on, rather than none could be taken.
    """

    values: ParameterValues
    cycle: Cycle
    find: Find | None
    arrived: bool = False


def walk(
    hunt: Hunt,
    values: ParameterValues,
    cycle: Cycle,
    solve: Callable[[Hunt, ParameterValues, Cycle], Find],
) -> Stop:
    """Return where steps lead that each solve a program in a box around the last orbit.

    Args:
        hunt: The search; its box is never left.
        values: Where to start.
        cycle: One simulated period there.
        solve: One step, given the search in a smaller box.
    """
    half, stop = _FIRST, Stop(values=values, cycle=cycle, find=None)
    for _ in range(_MOST_STEPS):
        box = _box_around(hunt, stop.values, half)
        find = solve(replace(hunt, free=box), stop.values, stop.cycle)
        if find.cycle is None or find.values is None or not find.agreement < ON_THE_WAY:
            half /= 4
            if half < _LEAST:
                break
            continue
        moved = _moved(hunt, stop.values, find.values)
        held = _is_held(hunt, find.values, box)
        arrived = not held or moved < _STILL
        stop = Stop(values=find.values, cycle=find.cycle, find=find, arrived=arrived)
        if arrived:
            break
        half *= 2
    return stop


def _box_around(hunt: Hunt, values: ParameterValues, half: float) -> dict[str, tuple[float, float]]:
    box: dict[str, tuple[float, float]] = {}
    for name, (low, high) in hunt.free.items():
        here, reach = values.number(name), half * (high - low)
        box[name] = (max(low, here - reach), min(high, here + reach))
    return box


def _moved(hunt: Hunt, here: ParameterValues, there: ParameterValues) -> float:
    return max(
        abs(there.number(name) - here.number(name)) / (high - low)
        for name, (low, high) in hunt.free.items()
    )


def _is_held(hunt: Hunt, values: ParameterValues, box: dict[str, tuple[float, float]]) -> bool:
    """Tell whether a side of the small box that is not one of the whole holds a number."""
    for name, (low, high) in box.items():
        here, near = values.number(name), _TOUCHES * (high - low)
        whole = hunt.free[name]
        if (here - low < near and low > whole[0]) or (high - here < near and high < whole[1]):
            return True
    return False
