"""The named numbers of a problem: quantities with units and ranges, outputs, and what must be said.

Every refusal here is of a declaration alone; the model is looked at in ``validation``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from zeno_orbits.errors import InputError, did_you_mean
from zeno_orbits.model.units import powers_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A named number of a problem, with its unit and the range in which it makes sense.

    Attributes:
        name: How it is called on the command line and in files.
        unit: SI unit, in brackets in tables; ``1`` for a pure number.
        meaning: One line for the user.
        default: Its value when nobody sets it; ``None`` if the problem derives it from the others.
        lower: Smallest sensible value. For a gain, the lower end of the search box.
        upper: Largest sensible value. For a gain, the upper end of the search box.
        excluded: Values at the ends that are themselves not allowed.
        instead: What to do at an excluded value, as a sentence; it ends the refusal.
    """

    name: str
    unit: str
    meaning: str
    default: float | None
    lower: float = -math.inf
    upper: float = math.inf
    excluded: tuple[float, ...] = ()
    instead: str = ""

    def __post_init__(self) -> None:
        """Refuse a name that cannot be typed, a unit that is none and a range that is empty."""
        _require_name("name", self.name)
        _require_unit(self.name, self.unit)
        if not self.lower < self.upper:
            wanted = f"must have a range with lower < upper for `{self.name}`"
            raise ValueError(f"Argument `lower` {wanted}, but it is {self.lower:g}:{self.upper:g}.")
        if self.default is not None and not math.isfinite(self.default):
            wanted = f"must be a finite number for `{self.name}`"
            raise ValueError(f"Argument `default` {wanted}, but it is {self.default}.")

    def checked(self, value: float) -> float:
        """Return ``value`` if it is a finite number inside the range, else raise ``InputError``."""
        value = float(value)
        if not math.isfinite(value):
            raise InputError(f"Argument `{self.name}` must be a finite number, but it is {value}.")
        if not self.lower <= value <= self.upper or value in self.excluded:
            message = f"Argument `{self.name}` must {self._range()}, but it is {value:g}."
            helped = f"{message} {self.instead}" if value in self.excluded else message
            raise InputError(helped.rstrip())
        return value

    def _range(self) -> str:
        below, above = math.isfinite(self.lower), math.isfinite(self.upper)
        if not below and not above:
            return f"differ from {', '.join(f'{value:g}' for value in self.excluded)}"
        if not above:
            word = "greater than" if self.lower in self.excluded else "at least"
            return f"be {word} {self.lower:g}"
        if not below:
            word = "less than" if self.upper in self.excluded else "at most"
            return f"be {word} {self.upper:g}"
        left = "(" if self.lower in self.excluded else "["
        right = ")" if self.upper in self.excluded else "]"
        return f"lie in {left}{self.lower:g}, {self.upper:g}{right}"


def positive(
    name: str, default: float | None, unit: str, meaning: str, *, instead: str = ""
) -> Quantity:
    """Return a quantity that must be greater than zero.

    Args:
        name: How it is called in files and on the command line.
        default: Its value; ``None`` if the problem derives it.
        unit: SI unit.
        meaning: What it is.
        instead: What to do instead of zero, as a sentence; it ends the refusal.
    """
    return Quantity(
        name=name,
        unit=unit,
        meaning=meaning,
        default=default,
        lower=0.0,
        excluded=(0.0,),
        instead=instead,
    )


def restitution(default: float) -> Quantity:
    """Return the coefficient of restitution `e`, in [0, 1)."""
    return Quantity(
        name="restitution",
        unit="1",
        meaning="coefficient of restitution of the stop",
        default=default,
        lower=0.0,
        upper=1.0,
        excluded=(1.0,),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Output:
    """A quantity to look at that is no state: a height, a power, a force.

    Attributes:
        name: How it is called in pictures.
        unit: SI unit.
        formula: From named states and named gains and parameters to its expression.
    """

    name: str
    unit: str
    formula: Callable[[Mapping[str, ca.SX], Mapping[str, ca.SX]], ca.SX]

    def __post_init__(self) -> None:
        """Refuse a unit that is none."""
        _require_unit(self.name, self.unit)


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterValues:
    """Numbers for every name of a problem.

    Attributes:
        gains: Name to value, in the problem's order.
        parameters: Name to value, in the problem's order; derived ones included.
    """

    gains: Mapping[str, float]
    parameters: Mapping[str, float]

    @property
    def vector(self) -> tuple[float, ...]:
        """Return gains, then parameters: the parameter vector of the compiled system."""
        return (*self.gains.values(), *self.parameters.values())

    @property
    def numbers(self) -> dict[str, float]:
        """Name to value of gains, then of parameters."""
        return {**self.gains, **self.parameters}

    def number(self, name: str) -> float:
        """Return a gain or a parameter."""
        return self.gains[name] if name in self.gains else self.parameters[name]

    def replaced(self, numbers: Mapping[str, float]) -> ParameterValues:
        """Return the values with other numbers for some names; derived ones stay as they are."""
        return ParameterValues(
            gains={name: numbers.get(name, value) for name, value in self.gains.items()},
            parameters={name: numbers.get(name, value) for name, value in self.parameters.items()},
        )


def _require_name(argument: str, name: str) -> None:
    if not name.isidentifier():
        wanted = "must be a word of letters, digits and underscores"
        raise ValueError(f"Argument `{argument}` {wanted}, but it is `{name}`.")


def _require_unit(name: str, unit: str) -> None:
    try:
        powers_of(unit)
    except ValueError as error:
        raise ValueError(f"Argument `unit` must be one for `{name}`, but {error}.") from error


@dataclass(frozen=True, slots=True, kw_only=True)
class Escape:
    """A coordinate that has gone too far to come back.

    Attributes:
        beyond: The size of the coordinate from which on it has.
        phrase: What that means, for the user.
    """

    beyond: float
    phrase: str

    def __post_init__(self) -> None:
        """Refuse a size that nothing or everything is beyond."""
        if not (math.isfinite(self.beyond) and self.beyond > 0.0):
            raise ValueError(
                f"Argument `beyond` must be a positive number, but it is {self.beyond:g}."
            )


def require_names(
    states: Sequence[str], state_units: Sequence[str], quantities: Sequence[Quantity]
) -> None:
    """Refuse names that are there twice or cannot be typed, and states without a unit.

    Args:
        states: Names of the states.
        state_units: Their units.
        quantities: Gains and parameters.

    Raises:
        ValueError: With the name at fault.
    """
    seen: set[str] = set()
    for name in (*states, *(quantity.name for quantity in quantities)):
        if name in seen:
            message = "must differ for states, gains and parameters"
            raise ValueError(f"Argument `name` {message}, but `{name}` is there twice.")
        seen.add(name)
    if len(states) != len(state_units):
        count = f"but there are {len(state_units)} for {len(states)}"
        raise ValueError(f"Argument `state_units` must be one for every state, {count}.")
    for name, unit in zip(states, state_units, strict=True):
        _require_name("state_names", name)
        _require_unit(name, unit)


def require_ranges(
    gains: Sequence[Quantity], parameters: Sequence[Quantity], *, derives: bool
) -> None:
    """Refuse gains without a finite range, parameters without a value, a restitution that is none.

    Args:
        gains: The gains.
        parameters: The parameters; one has to be the restitution.
        derives: Whether parameters without a default are derived.

    Raises:
        ValueError: With the name at fault.
    """
    for gain in gains:
        if gain.default is None or not math.isfinite(gain.upper - gain.lower):
            wanted = f"must have a default and a finite range for `{gain.name}`"
            raise ValueError(f"Argument `gains` {wanted}, but it has not.")
    for quantity in parameters:
        if quantity.default is not None:
            quantity.checked(quantity.default)
        elif not derives:
            wanted = f"must give `{quantity.name}` a default or a `derive`"
            raise ValueError(f"Argument `parameters` {wanted}, but there is neither.")
    impact = [quantity for quantity in parameters if quantity.name == "restitution"]
    if not impact or impact[0].lower < 0.0 or not _is_below_one(impact[0]):
        wanted = "must hold a `restitution` in [0, 1)"
        how = "it holds none" if not impact else "its range is another one"
        raise ValueError(f"Argument `parameters` {wanted}, but {how}; see `restitution()`.")


def _is_below_one(quantity: Quantity) -> bool:
    return quantity.upper < 1.0 or (quantity.upper == 1.0 and 1.0 in quantity.excluded)


def unknown(kind: str, name: str, known: tuple[str, ...]) -> str:
    """Return the refusal of a name: the known names, and the nearest of them if one is near.

    Args:
        kind: Argument that the name was given for.
        name: The name.
        known: The names that it may be.
    """
    refusal = f"Argument `{kind}` must be one of {', '.join(known) or 'none'}, but it is `{name}`."
    return refusal + did_you_mean(name, known)
