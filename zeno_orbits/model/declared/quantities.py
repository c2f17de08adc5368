"""Named parameters of a problem: quantities with units and ranges, outputs, and checks.

All checks here concern the declaration alone. The model is checked in ``validation``.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from zeno_orbits.errors import (
    InputError,
    counted,
    finite_number,
    named_numbers,
    not_known,
    shortened,
)
from zeno_orbits.model.expressions.units import powers_of
from zeno_orbits.work import require_kinds


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A named parameter of a problem, with its unit and its valid range.

    Attributes:
        name: Name on the command line and in files.
        unit: SI unit, in brackets in tables, or ``1`` for a pure number.
        meaning: One line for the user.
        default: Default value, or ``None`` if the problem derives the value from other parameters.
        lower: Smallest sensible value. For a gain, the lower end of the search box.
        upper: Largest sensible value. For a gain, the upper end of the search box.
        excluded: Values at the ends that are themselves not allowed.
        instead: Remedy for an excluded value, as a sentence at the end of the error message.
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
        """Reject a name that cannot be typed, an invalid unit and an empty range."""
        require_kinds(self)
        _require_name("name", self.name)
        require_unit(self.name, self.unit)
        if not self.lower < self.upper:
            wanted = f"must have a range with lower < upper for `{self.name}`"
            raise InputError(f"Argument `lower` {wanted}, but it is {self.lower:g}:{self.upper:g}.")
        if self.default is not None and not math.isfinite(self.default):
            wanted = f"must be a finite number for `{self.name}`"
            raise InputError(f"Argument `default` {wanted}, but it is {self.default}.")

    @classmethod
    def positive(
        cls, name: str, default: float | None, unit: str, meaning: str, *, instead: str = ""
    ) -> Quantity:
        """Return a quantity that must be greater than zero.

        Args:
            name: Name in files and on the command line.
            default: Default value, or None if the problem derives it.
            unit: SI unit.
            meaning: One-line description.
            instead: Remedy for zero, as a sentence at the end of the error message.
        """
        return cls(
            name=name,
            unit=unit,
            meaning=meaning,
            default=default,
            lower=0.0,
            excluded=(0.0,),
            instead=instead,
        )

    @classmethod
    def restitution(cls, default: float) -> Quantity:
        """Return the coefficient of restitution `e`, in [0, 1]."""
        return cls(
            name="restitution",
            unit="1",
            meaning="coefficient of restitution of the stop",
            default=default,
            lower=0.0,
            upper=1.0,
        )

    def checked(self, value: float) -> float:
        """Return ``value`` if it is a finite number inside the range, else raise ``InputError``."""
        value = finite_number(self.name, value)
        if not self.lower <= value <= self.upper or value in self.excluded:
            message = f"Argument `{self.name}` must {self.range_words()}, but it is {value:g}."
            helped = f"{message} {self.instead}" if value in self.excluded else message
            raise InputError(helped.rstrip())
        return value

    def closed_range(self) -> tuple[float, float]:
        """Return the smallest and the largest allowed number: next to an end that is excluded.

        Next to zero it is the smallest normal number, which every reader of a file accepts.
        """
        low, high, tiny = self.lower, self.upper, sys.float_info.min
        if low in self.excluded:
            low = tiny if low == 0.0 else math.nextafter(low, math.inf)
        if high in self.excluded:
            high = -tiny if high == 0.0 else math.nextafter(high, -math.inf)
        return low, high

    def range_words(self) -> str:
        """Return the requirement on a value, as in a message: ``be greater than 0``."""
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


positive, restitution = Quantity.positive, Quantity.restitution


@dataclass(frozen=True, slots=True, kw_only=True)
class Output:
    """An observable quantity that is not a state: a height, a power, a force.

    Attributes:
        name: Label in pictures.
        unit: SI unit.
        formula: Function from named states and named gains and parameters to the expression.
    """

    name: str
    unit: str
    formula: Callable[[Mapping[str, ca.SX], Mapping[str, ca.SX]], ca.SX]

    def __post_init__(self) -> None:
        """Reject values of a wrong kind, and an invalid unit."""
        require_kinds(self)
        require_unit(self.name, self.unit)


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterValues:
    """Values for every name of a problem.

    Attributes:
        gains: Values by name, in the problem's order.
        parameters: Values by name, in the problem's order, including derived parameters.
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
        """Return a gain or a parameter.

        Raises:
            InputError: If the name is unknown.
        """
        try:
            return self.gains[name] if name in self.gains else self.parameters[name]
        except (KeyError, TypeError, NotImplementedError):
            # Symbols of CasADi have no hash.
            raise InputError(unknown("name", shortened(str(name)), tuple(self.numbers))) from None

    def replaced(self, numbers: Mapping[str, float]) -> ParameterValues:
        """Return the values with replacements for some names. Derived values do not change.

        Raises:
            InputError: If a name is unknown or a value is not a finite number.
        """
        known, numbers = self.numbers, named_numbers("numbers", numbers)
        for name, value in numbers.items():
            if name not in known:
                raise InputError(unknown("numbers", shortened(name), tuple(known)))
            finite_number(name, value)
        return ParameterValues(
            gains={name: numbers.get(name, value) for name, value in self.gains.items()},
            parameters={name: numbers.get(name, value) for name, value in self.parameters.items()},
        )


def _require_name(argument: str, name: str) -> None:
    if not name.isidentifier():
        wanted = "must begin with a letter and hold letters, digits and underscores only"
        raise InputError(f"Argument `{argument}` {wanted}, but it is `{shortened(name)}`.")


def require_unit(name: str, unit: str) -> None:
    """Refuse a text that is not a unit.

    Args:
        name: Name of the quantity in the message.
        unit: The text.

    Raises:
        InputError: If the text is not a unit. The message names the invalid part.
    """
    try:
        powers_of(unit)
    except ValueError as error:
        raise InputError(f"Argument `unit` must be one for `{name}`, but {error}.") from error


@dataclass(frozen=True, slots=True, kw_only=True)
class StateLimit:
    """Divergence limit of a coordinate.

    Attributes:
        beyond: Modulus of the coordinate beyond which it counts as diverged.
        phrase: Meaning of the divergence, for the user.
    """

    beyond: float
    phrase: str

    def __post_init__(self) -> None:
        """Refuse a size that nothing or everything is beyond."""
        require_kinds(self)
        if not (math.isfinite(self.beyond) and self.beyond > 0.0):
            raise InputError(
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
        InputError: If a name is repeated. The message names it.
    """
    seen: set[str] = set()
    for name in (*states, *(quantity.name for quantity in quantities)):
        if name in seen:
            message = "must differ for states, gains and parameters"
            raise InputError(f"Argument `name` {message}, but `{name}` appears twice.")
        seen.add(name)
    if len(states) != len(state_units):
        count = f"but `state_names` has {counted(len(states), 'name')} and `state_units` has"
        raise InputError(
            f"Argument `state_units` must be one for every state, {count} "
            f"{counted(len(state_units), 'unit')}."
        )
    for name, unit in zip(states, state_units, strict=True):
        _require_name("state_names", name)
        require_unit(name, unit)


def require_ranges(
    gains: Sequence[Quantity], parameters: Sequence[Quantity], *, derives: bool
) -> None:
    """Reject gains without a finite range, and parameters without a value.

    Args:
        gains: The gains.
        parameters: The parameters.
        derives: Whether parameters without a default are derived.

    Raises:
        InputError: If a declaration is invalid, or the default of a gain is outside of its range.
            The message contains its name.
    """
    for gain in gains:
        if gain.default is None or not math.isfinite(gain.upper - gain.lower):
            wanted = f"must have a default and a finite range for `{gain.name}`"
            raise InputError(f"Argument `gains` {wanted}: `default=`, `lower=` and `upper=`.")
        if not gain.lower <= gain.default <= gain.upper:
            wanted = f"must have the default of `{gain.name}` in its range"
            raise InputError(
                f"Argument `gains` {wanted} [{gain.lower:g}, {gain.upper:g}], but it is "
                f"{gain.default:g}. Change the default or the range."
            )
    for quantity in parameters:
        if quantity.default is not None:
            quantity.checked(quantity.default)
        elif not derives:
            wanted = f"must give `{quantity.name}` a default or a `derive`"
            raise InputError(f"Argument `parameters` {wanted}.")


def require_restitution(parameters: Sequence[Quantity]) -> None:
    """Reject a parameter `restitution` with an invalid range.

    Args:
        parameters: The parameters.

    Raises:
        InputError: If the restitution may be negative or exceed 1, or is a gain.
    """
    impact = [quantity for quantity in parameters if quantity.name == "restitution"]
    if not impact or impact[0].lower < 0.0 or impact[0].upper > 1.0:
        how = "its range is different" if impact else "it is a gain"
        raise InputError(
            f"Argument `parameters` must hold `restitution` in [0, 1], but {how}. "
            "Write `Quantity.restitution(0.5)`."
        )


def unknown(kind: str, name: str, known: tuple[str, ...]) -> str:
    """Return the refusal of a name: the known names, and the nearest of them if one is near.

    Args:
        kind: Argument with the name.
        name: The name.
        known: The names that it may be.
    """
    noun = kind if kind in ("problem", "gain", "parameter", "state") else "name"
    return f"Argument `{kind}`: {not_known(name, known, noun)}"
