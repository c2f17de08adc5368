"""Drawings of a machine: a problem gives its links as lines in the plane of the picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca

Drawing = Mapping[str, Sequence[tuple[Any, Any]]]
"""Corners of each line by name, across and upwards [m]. A single corner is a joint or a point mass.
The lines named ``stop`` and ``ground`` are drawn as such."""

DrawingFunction = Callable[[Mapping[str, ca.SX], Mapping[str, ca.SX]], Drawing]
"""From named states and named gains and parameters to the lines."""


def lines_of(
    drawing: DrawingFunction, states: Mapping[str, ca.SX], symbols: Mapping[str, ca.SX]
) -> dict[str, ca.SX]:
    """Return every line as a matrix of its corners, ``(n, 2)``.

    Args:
        drawing: Drawing of the problem.
        states: States of the problem by name.
        symbols: Gains and parameters of the problem by name.

    Raises:
        ValueError: If the drawing is empty, or a corner is not a pair of formulas in the states,
            gains and parameters.
    """
    try:
        lines = dict(drawing(states, symbols))
    except KeyError as error:
        asked = f"but it uses `{error.args[0]}`"
        raise ValueError(
            f"Argument `drawing` must use states, gains and parameters, {asked}."
        ) from error
    if not lines:
        raise ValueError("Argument `drawing` must contain a line.")
    found: dict[str, ca.SX] = {}
    known = {one.element_hash() for one in (*states.values(), *symbols.values())}
    for name, corners in lines.items():
        if not corners or any(len(corner) != 2 for corner in corners):
            wanted = "must give every line corners across and upwards"
            raise ValueError(f"Argument `drawing` {wanted}, but the corners of `{name}` differ.")
        if not all(ca.SX(one).is_scalar() for corner in corners for one in corner):
            wanted = "must make every corner of two numbers"
            raise ValueError(f"Argument `drawing` {wanted}, but the corners of `{name}` differ.")
        found[name] = ca.vertcat(*(ca.horzcat(ca.SX(x), ca.SX(y)) for x, y in corners))
        for symbol in ca.symvar(found[name]):
            if symbol.element_hash() not in known:
                wanted = "must use states, gains and parameters only"
                other = f"but `{name}` holds another symbol, `{symbol.name()}`"
                raise ValueError(f"Argument `drawing` {wanted}, {other}.")
    return found
