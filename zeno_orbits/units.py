"""Units as text: what a word like ``N m s/rad`` is made of, so that one that cannot be is caught.

A unit is a product of SI symbols with whole powers and at most one slash: ``kg m^2``, ``V s/rad``,
``m/s^2``, ``1``. The radian counts as a unit of its own, for an angle is not a length.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

Powers = Mapping[str, int]
"""Base unit to its power; one that is missing has the power 0."""

_BASE = ("kg", "m", "s", "A", "rad", "K", "mol", "cd")
_DERIVED: Mapping[str, Powers] = {
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "Hz": {"s": -1},
    "C": {"A": 1, "s": 1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
    "H": {"kg": 1, "m": 2, "s": -2, "A": -2},
    "F": {"kg": -1, "m": -2, "s": 4, "A": 2},
    "Wb": {"kg": 1, "m": 2, "s": -2, "A": -1},
    "T": {"kg": 1, "s": -2, "A": -1},
}
_FACTOR = re.compile(r"([A-Za-z]+)(?:\^(-?\d+))?")


def powers_of(text: str) -> dict[str, int]:
    """Return the powers of the base units that a unit is made of.

    Raises:
        ValueError: If it is no unit; the text says which part is not.
    """
    above, slash, below = text.partition("/")
    if not text.strip() or (slash and not below.strip()) or "/" in below:
        raise ValueError(f"`{text}` is no unit; write for instance `N m s/rad`, and `1` for none")
    total: dict[str, int] = {}
    for part, sign in ((above, 1), (below, -1)):
        for factor in part.split():
            for base, power in _factor(factor, text).items():
                total[base] = total.get(base, 0) + sign * power
    return {base: power for base, power in total.items() if power}


def is_rate_of(rate: str, unit: str) -> bool:
    """Tell whether one unit is another one per second."""
    wanted = powers_of(unit)
    wanted["s"] = wanted.get("s", 0) - 1
    return powers_of(rate) == {base: power for base, power in wanted.items() if power}


def _factor(factor: str, text: str) -> Powers:
    if factor == "1":
        return {}
    found = _FACTOR.fullmatch(factor)
    symbol = found[1] if found else factor
    if found is None or (symbol not in _BASE and symbol not in _DERIVED):
        known = ", ".join((*_BASE, *_DERIVED))
        raise ValueError(f"`{factor}` in `{text}` is no unit; known are {known}")
    power = int(found[2] or 1)
    return {base: n * power for base, n in _DERIVED.get(symbol, {symbol: 1}).items()}
