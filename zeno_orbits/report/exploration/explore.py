"""The widget of live exploration: `explore`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zeno_orbits.errors import InputError, named_numbers, number_range
from zeno_orbits.model import Problem, Quantity, locate_problem
from zeno_orbits.work import checked

_AROUND = 0.5
"""Half width of a slider without a finite range, in parts of the value."""


@checked
def explore(
    problem: Problem | str | Path,
    *,
    vary: Mapping[str, tuple[float, float]] | None = None,
    gains: Mapping[str, float] | None = None,
    parameters: Mapping[str, float] | None = None,
) -> Any:
    """Return a widget with sliders for gains and parameters and the attractor that they give.

    Each change of a slider simulates from the last orbit, closes the new orbit by Newton's method
    and draws its phase portraits. The orbit is not verified: pass it to `verify`. The attributes
    ``widget.attractor`` and ``widget.values`` hold the current result.

    Args:
        problem: The problem, its name or its file.
        vary: Range of each gain or parameter that gets a slider, by default every gain. It is
            required for a problem without gains.
        gains: Gains that differ from the defaults of the problem.
        parameters: Parameters that differ from the defaults of the problem. Derived parameters
            that are not named here follow the sliders.

    Raises:
        InputError: If the extra `explore` is missing, a name is unknown, a range is empty, a value
            is out of range, or nothing varies.
    """
    known = problem if isinstance(problem, Problem) else locate_problem(problem).load()
    fixed = {**named_numbers("gains", gains), **named_numbers("parameters", parameters)}
    values = known.values(gains=gains, parameters=parameters)
    sliders = _sliders(known, {**values.gains, **values.parameters}, vary)
    try:
        from zeno_orbits.report.exploration.widget import Explorer
    except ImportError as error:
        install = "run `pip install 'zeno_orbits[explore]'`"
        raise InputError(f"`explore` needs anywidget: {install}.") from error
    return Explorer(known, fixed, sliders)


def _sliders(
    problem: Problem,
    values: Mapping[str, float],
    vary: Mapping[str, tuple[float, float]] | None,
) -> list[dict[str, Any]]:
    """Return the name, unit, meaning, range and value of each slider."""
    ranges = {one.name: _range(one, values[one.name]) for one in problem.gains}
    ranges = ranges if vary is None else dict(vary)
    if not ranges:
        wanted = "must name a gain or a parameter and its range, for example {'A': (0.5, 1.5)}"
        raise InputError(f"Argument `vary` {wanted}: `{problem.name}` lacks gains.")
    sliders: list[dict[str, Any]] = []
    for name, box in ranges.items():
        lower, upper = number_range("vary", box, name)
        quantity = problem.require_range(name, (lower, upper), argument="vary")
        sliders.append(
            {
                "name": name,
                "unit": quantity.unit,
                "meaning": quantity.meaning,
                "lower": lower,
                "upper": upper,
                "value": min(max(values[name], lower), upper),
            }
        )
    return sliders


def _range(quantity: Quantity, value: float) -> tuple[float, float]:
    if math.isfinite(quantity.lower) and math.isfinite(quantity.upper):
        return quantity.lower, quantity.upper
    width = _AROUND * abs(value) or 1.0
    return max(quantity.lower, value - width), min(quantity.upper, value + width)
