r"""Names as they stand in formulas: ``Kp`` is :math:`K_p`, ``dtheta1`` :math:`\dot\theta_1`."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape

from zeno_orbits.model import Problem

_GREEK = {
    "alpha": "α",
    "beta": "β",
    "gamma": "γ",
    "delta": "δ",
    "theta": "θ",
    "phi": "φ",
    "varphi": "φ",
    "psi": "ψ",
    "eta": "η",
    "xi": "ξ",
    "omega": "ω",
}
_NAME = re.compile(rf"(current|{'|'.join(_GREEK)}|[a-z](?=\d*$|_)|[A-Z](?=\d|_|[a-z]?\d*$))_?(\w*)")
"""A letter and its subscript: digits, one small letter, or any text after an underscore."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Symbol:
    """A letter with a subscript, dotted if it is the rate of another state."""

    letter: str
    below: str
    dotted: bool


def math_symbol(name: str, states: Sequence[str] = ()) -> str:
    """Return a name in matplotlib's math notation. A word is not changed.

    Args:
        name: Name of a state, gain or parameter.
        states: Names of all states, which determine whether a name is a rate.
    """
    found = _symbol(name, states)
    if isinstance(found, str):
        return found
    letter = rf"\{found.letter}" if found.letter in _GREEK else found.letter
    letter = rf"\dot{{{letter}}}" if found.dotted else letter
    below = rf"\mathrm{{{found.below}}}" if len(found.below) > _LETTERS else found.below
    return f"${letter}_{{{below}}}$" if below else f"${letter}$"


def html_symbol(name: str, states: Sequence[str] = ()) -> str:
    """Return a name as HTML. A word is not changed.

    Args:
        name: Name of a state, gain or parameter.
        states: Names of all states, which determine whether a name is a rate.
    """
    found = _symbol(name, states)
    if isinstance(found, str):
        return escape(found)
    letter = f"<i>{_GREEK.get(found.letter, found.letter)}</i>"
    symbol = f"{letter}<sub>{found.below}</sub>" if found.below else letter
    return f"d{symbol}/d<i>t</i>" if found.dotted else symbol


_LETTERS = 2
"""Largest length of a subscript that is a symbol itself. A longer subscript is an upright word."""


def _symbol(name: str, states: Sequence[str]) -> _Symbol | str:
    """Return the parts of a symbol, or the words for a name that is a word."""
    dotted = name[:1] == "d" and name[1:] in states
    stem = name[1:] if dotted else name
    parts = _NAME.fullmatch(stem)
    if parts is None:
        return f"rate of {stem}" if dotted else name.replace("_", " ")
    letter = "i" if parts[1] == "current" else parts[1]
    return _Symbol(letter=letter, below=parts[2], dotted=dotted)


def direction_symbol(direction: Mapping[str, float], symbol: Callable[[str], str]) -> str:
    """Return a direction as a sum of symbols, such as ``theta1 - 0.5 theta2``.

    Args:
        direction: Coordinate to entry, the first entry positive.
        symbol: Function from a name to its symbol.
    """
    words = ""
    for name, entry in direction.items():
        if entry:
            sign = (" - " if entry < 0.0 else " + ") if words else ""
            factor = "" if abs(entry) == 1.0 else f"{abs(entry):g} "
            words += f"{sign}{factor}{symbol(name)}"
    return words


def label_of(problem: Problem, index: int) -> str:
    """Return the label of an axis that shows a state, with its unit."""
    symbol = math_symbol(problem.state_names[index], problem.state_names)
    return f"{symbol} [{problem.state_units[index]}]"


def quantity_label(name: str, unit: str) -> str:
    """Return the label of an axis that shows a gain, parameter or output, with its unit."""
    return f"{math_symbol(name)} [{unit}]"
