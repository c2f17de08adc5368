"""Parse unit strings such as ``N m s/rad`` and reject malformed strings.

A unit is a product of SI symbols with integer powers and at most one slash: ``kg m^2``, ``V
s/rad``, ``m/s^2``, ``1``. The radian counts as a separate unit, because an angle is not a length.
Another unit of length or mass, ``mm`` or ``g``, is also a separate unit and not a multiple of the
metre or kilogram. Physical laws hold in any units as long as all values have the same units
(`require_coherent`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from zeno_orbits.errors import shortened

Powers = Mapping[str, int]
"""Powers of the base units. A missing base unit has the power 0."""

_BASE = ("kg", "m", "s", "A", "rad", "K", "mol", "cd")
_ALIKE = (("m", "mm", "cm", "um", "km"), ("kg", "g", "mg"))
"""Base units of one kind, of which a problem has one."""
_OTHERS = tuple(unit for units in _ALIKE for unit in units[1:])
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
    "mN": {"kg": 1, "mm": 1, "s": -2},
}
_POWER = re.compile(r"([^\^]+?)(?:\^(-?\d+))?")
_FACTOR = re.compile(r"([A-Za-z]+)(?:\^(-?\d+))?")


def powers_of(text: str) -> dict[str, int]:
    """Return the powers of the base units of a unit.

    Raises:
        ValueError: If the text is not a unit. The message names the invalid part.
    """
    above, slash, below = text.partition("/")
    if not text.strip() or (slash and not below.strip()) or "/" in below:
        hint = "write for instance `N m s/rad`, and `1` for none"
        raise ValueError(f"`{shortened(text)}` is not a unit: {hint}")
    total: dict[str, int] = {}
    for part, sign in ((above, 1), (below, -1)):
        for factor in part.split():
            for base, power in _factor(factor, text).items():
                total[base] = total.get(base, 0) + sign * power
    return {base: power for base, power in total.items() if power}


def text_of(powers: Powers) -> str:
    """Return the text of a unit by the powers of its base units, such as ``kg m/s^2``."""
    above, below = (
        " ".join(
            base if abs(n) == 1 else f"{base}^{abs(n)}"
            for base, n in powers.items()
            if n * sign > 0
        )
        for sign in (1, -1)
    )
    return f"{above or '1'}/{below}" if below else above or "1"


def unit_quotient(unit: str, by: str) -> str:
    """Return the text of a quotient of two units, with one slash: ``m/s`` by ``s`` is ``m/s^2``."""
    above, below = powers_of(unit), powers_of(by)
    if not below:
        return unit
    if "/" not in unit + by:
        return f"{unit}/{by}"
    bases = (*above, *(base for base in below if base not in above))
    return text_of({base: above.get(base, 0) - below.get(base, 0) for base in bases})


def require_coherent(units: Mapping[str, str]) -> None:
    """Refuse units of which two measure the same: a problem has one of mass, and one of length.

    Args:
        units: Name of a number to its unit.

    Raises:
        ValueError: If two units do not fit together. The message names both.
    """
    seen: dict[str, tuple[str, str]] = {}
    for name, unit in units.items():
        powers = powers_of(unit)
        for kind in _ALIKE:
            for base in (one for one in kind if one in powers):
                first, other = seen.setdefault(kind[0], (base, name))
                if first != base:
                    wanted = "must be of one system for all values of a problem"
                    whole = "" if unit == base else f" (`{unit}`)"
                    raise ValueError(
                        f"Argument `unit` {wanted}, but `{other}` counts in {first}, and "
                        f"`{name}`{whole} in {base}. Write both in one of them."
                    )


def energy_unit(units: Mapping[str, str]) -> str:
    """Return the unit of energies where numbers are in these units: J, or a product like it.

    Args:
        units: Name of a number to its unit.
    """
    used = {base for unit in units.values() for base in powers_of(unit)}
    length, mass = (next((one for one in kind if one in used), kind[0]) for kind in _ALIKE)
    return "J" if (length, mass) == ("m", "kg") else f"{mass} {length}^2/s^2"


def is_rate_of(rate: str, unit: str) -> bool:
    """Return True if the first unit is the second unit per second."""
    wanted = powers_of(unit)
    wanted["s"] = wanted.get("s", 0) - 1
    return powers_of(rate) == {base: power for base, power in wanted.items() if power}


ELECTRICAL: Mapping[str, str] = {"current": "A", "voltage": "V"}
"""Unit of the states of a circuit, by their kind."""


def is_electrical_unit(kind: str, unit: str, units: Sequence[str]) -> bool:
    """Return True if a unit is a current or voltage unit, or ``1`` in a scaled problem.

    Args:
        kind: ``current`` or ``voltage``.
        unit: The unit.
        units: Units of all states. A voltage is expressed in their unit of length and mass.
    """
    found = powers_of(unit)
    used = {base for one in units for base in powers_of(one)}
    wanted: dict[str, int] = {}
    for base, power in powers_of(ELECTRICAL[kind]).items():
        alike = next((kinds for kinds in _ALIKE if base in kinds), (base,))
        wanted[next((one for one in alike if one in used), base)] = power
    return found in ({}, wanted)


def _factor(factor: str, text: str) -> Powers:
    if factor == "1":
        return {}
    found = _FACTOR.fullmatch(factor)
    symbol = found[1] if found else factor
    if found is None or (symbol not in {*_BASE, *_OTHERS} and symbol not in _DERIVED):
        meant = _meant(symbol)
        if meant and found and found[2]:
            meant = f"{meant}^{found[2]}"
        known = ", ".join((*_BASE, *_OTHERS, *_DERIVED))
        remedy = f": write `{meant}`" if meant else f". Known units are {known}"
        if symbol[:1] in _PREFIXES and symbol[1:] in _DERIVED:
            remedy = f": convert the value to `{symbol[1:]}`"
        if "*" in factor:
            meant = text.replace("**", "^").replace("*", " ")
            remedy = f": write `{meant}`, with spaces"
        where = f"`{shortened(factor)}`" + (f" in `{shortened(text)}`" if factor != text else "")
        raise ValueError(f"{where} is not a unit{remedy}")
    power = int(found[2] or 1)
    return {base: n * power for base, n in _DERIVED.get(symbol, {symbol: 1}).items()}


def _meant(symbol: str) -> str:
    """Return the unit that a word stands for, or an empty text."""
    return _WORDS.get(symbol.lower().removesuffix("s")) or _apart(symbol)


_PREFIXES = frozenset("kmunMG")


def _apart(symbol: str) -> str:
    """Return two units that were written as one word, with a space, or an empty text."""
    known = {*_BASE, *_DERIVED}
    if symbol[:1] in _PREFIXES and symbol[1:] in known:
        return ""  # `ms` is a millisecond.
    splits = ((symbol[:k], symbol[k:]) for k in range(1, len(symbol)))
    return next((f"{one} {other}" for one, other in splits if {one, other} <= known), "")


_WORDS: Mapping[str, str] = {
    **dict.fromkeys(("metre", "meter"), "m"),
    **dict.fromkeys(("millimetre", "millimeter"), "mm"),
    "second": "s",
    "sec": "s",
    "radian": "rad",
    "kilogram": "kg",
    "gram": "g",
    "newton": "N",
    "amp": "A",
    "ampere": "A",
    "volt": "V",
    "watt": "W",
    "joule": "J",
    "henry": "H",
    "hertz": "Hz",
    "kelvin": "K",
    "pascal": "Pa",
    "farad": "F",
    "tesla": "T",
    "weber": "Wb",
    "coulomb": "C",
}
"""Words that stand for units, in lower case, without a plural."""

_SCALED: Mapping[str, tuple[str, float]] = {
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "µs": ("s", 1e-6),
    "ns": ("s", 1e-9),
    "min": ("s", 60.0),
    "h": ("s", 3600.0),
    "deg": ("rad", math.pi / 180.0),
    "°": ("rad", math.pi / 180.0),
    "mrad": ("rad", 1e-3),
    "rev": ("rad", 2.0 * math.pi),
    "rpm": ("rad/s", math.pi / 30.0),
    "mm": ("m", 1e-3),
    "cm": ("m", 1e-2),
    "km": ("m", 1e3),
    "um": ("m", 1e-6),
    "mA": ("A", 1e-3),
    "mV": ("V", 1e-3),
    "kV": ("V", 1e3),
    "mW": ("W", 1e-3),
    "kHz": ("Hz", 1e3),
    "mN": ("N", 1e-3),
    "kN": ("N", 1e3),
    "g": ("kg", 1e-3),
}
"""Units that instruments write, as so many of a unit that this toolkit computes in."""

_SPELLED: Mapping[str, str] = {
    "sec": "s",
    "seconds": "s",
    "second": "s",
    "radians": "rad",
    "degrees": "deg",
    "degree": "deg",
    "amp": "A",
    "amps": "A",
    "volt": "V",
    "volts": "V",
    "Ohm": "ohm",
    "Ω": "ohm",
    "μs": "us",
    "RPM": "rpm",
}

_NO_SCALE: Mapping[str, str] = {
    "count": "convert to an angle [deg], counts * 360 / counts per turn",
    "tick": "convert to an angle [deg], ticks * 360 / ticks per turn",
    "step": "convert to an angle or a length, steps * size of a step",
    "lsb": "convert to volts [V], value * range in volts / number of values of the converter",
    "bit": "convert to volts [V], value * range in volts / number of values of the converter",
    "raw": "convert to the quantity, by the data sheet of the instrument",
}


def in_si(text: str) -> tuple[str, float]:
    """Return the SI unit of a measured quantity, and the size of the given unit in SI units.

    A degree and a revolution are converted to radians.

    Raises:
        ValueError: If the text is not a unit, or the unit lacks a scale. The message names the
            unit.
    """
    spelled = _SPELLED.get(text.strip(), text.strip())
    for word, hint in _NO_SCALE.items():
        if spelled.lower().removesuffix("s") == word:
            raise ValueError(f"`{shortened(text)}` has no fixed size: {hint}")
    above, slash, below = spelled.partition("/")
    parts = [above.split(), below.split()]
    factor = 1.0
    for part, sign in zip(parts, (1, -1), strict=True):
        for k, symbol in enumerate(part):
            found = _POWER.fullmatch(symbol)
            name, power = (found[1], int(found[2] or 1)) if found else (symbol, 1)
            name = _SPELLED.get(name, name)
            unit, scale = _SCALED.get(name, (name, 1.0))
            if unit == name and name not in ("1", *_BASE, *_DERIVED):
                known = ", ".join(dict.fromkeys((*_BASE, *_DERIVED, *_SCALED)))
                meant = _meant(name)
                remedy = f": write `{meant}`" if meant else f". Known units are {known}"
                raise ValueError(f"`{name}` is not a unit{remedy}")
            factor *= scale ** (sign * power)
            if "/" in unit and (power != 1 or sign != 1 or slash):
                raise ValueError(f"`{text}` is not a known unit: `{name}` must stand alone")
            part[k] = unit if power == 1 else f"{unit}^{power}"
    whole = " ".join(parts[0]) + ("/" + " ".join(parts[1]) if slash else "")
    powers_of(whole)
    return whole, factor
