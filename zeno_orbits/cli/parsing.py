"""Convert words of the command line to values: converters and actions for ``argparse``.

Each option is converted once, while it is parsed. A converter raises ``ArgumentTypeError`` with the
clause that follows the name of the option: ``must be a number, but it is `x```.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from zeno_orbits.errors import InputError, did_you_mean, not_known

if TYPE_CHECKING:
    import zeno_orbits as zo


class Named(argparse.Action):
    """Collect the pairs of a repeated option in a mapping. Each name may occur once."""

    def __init__(self, option_strings: Sequence[str], dest: str, **kwargs: Any) -> None:
        super().__init__(option_strings, dest, default={}, **kwargs)

    def __call__(
        self,
        parser: argparse.ArgumentParser,  # noqa: ARG002 (the form that `argparse` calls)
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,  # noqa: ARG002
    ) -> None:
        """Add one pair."""
        name, value = values
        known = getattr(namespace, self.dest)
        if name in known:
            raise argparse.ArgumentError(self, f"must name `{name}` once, not twice")
        setattr(namespace, self.dest, {**known, name: value})


class Once(argparse.Action):
    """Store the value of an option that may be given once. ``argparse`` silently keeps the last."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,  # noqa: ARG002 (the form that `argparse` calls)
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,  # noqa: ARG002
    ) -> None:
        """Store the value."""
        known = getattr(namespace, self.dest)
        if known is not None:
            message = f"must be given once, but was given as {known} and {values}"
            raise argparse.ArgumentError(self, message)
        setattr(namespace, self.dest, values)


class Range(NamedTuple):
    """A name with the ends of its range."""

    name: str
    box: tuple[float, float]

    def __str__(self) -> str:
        """Return the words that `read_range` reads."""
        return f"{self.name}={self.box[0]:g}:{self.box[1]:g}"


def read_number(text: str) -> float:
    """Return a number."""
    return _number(text, "be a number")


def _number(text: str, wanted: str) -> float:
    try:
        # Python reads 1_5 as 15, but the user means 1.5 or a range.
        return float("" if "_" in text else text)
    except ValueError:
        message = f"must {wanted}, but it is `{text}`"
        if _RANGE.fullmatch(text):
            message += ". An option such as `--vary` takes a range"
        if _COMMA.fullmatch(text):
            message += f". Write a decimal point: {text.replace(',', '.')}"
        elif "," in text and "=" in text:
            message += ". Repeat the option for each name"
        raise argparse.ArgumentTypeError(message) from None


_RANGE = re.compile(r"[-+.\deE]+:[-+.\deE]+")
"""Two ends of a range."""
_COMMA = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?")
"""A number with a decimal comma."""


def read_share(text: str) -> float:
    """Return a number between 0 and 1, the ends left out."""
    number = read_number(text)
    if not 0.0 < number < 1.0:
        raise argparse.ArgumentTypeError(f"must lie in (0, 1), but it is {number:g}")
    return number


def _is_whole(text: str) -> bool:
    """Return True for a whole number of at most 18 digits, the limit of compiled code."""
    return text.isascii() and text.isdigit() and len(text) < 19


def read_count(text: str) -> int:
    """Return a positive whole number."""
    if not _is_whole(text) or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a positive whole number, but it is `{text}`")
    return int(text)


def read_seed(text: str) -> int:
    """Return a whole number that is not negative."""
    if not _is_whole(text):
        raise argparse.ArgumentTypeError(
            f"must be a whole number of at least 0, but it is `{text}`"
        )
    return int(text)


def read_grid(text: str) -> tuple[int, int]:
    """Return two positive whole numbers from ``NxM``."""
    first, sign, second = text.partition("x")
    if not (sign and _is_whole(first) and _is_whole(second)):
        raise argparse.ArgumentTypeError(f"must be NxM, 50x50 for instance, but it is `{text}`")
    return read_count(first), read_count(second)


def read_named_number(text: str) -> tuple[str, float]:
    """Return name and value from ``NAME=VALUE``."""
    name, sign, value = text.partition("=")
    if not sign or not name:
        raise argparse.ArgumentTypeError(f"must be NAME=VALUE, but it is `{text}`")
    return name, _number(value, f"have a number for `{name}`")


def read_named_text(text: str) -> tuple[str, str]:
    """Return name and text from ``NAME=TEXT``. The name may contain the sign."""
    name, sign, value = text.rpartition("=")
    if not (sign and name.strip() and value.strip()):
        raise argparse.ArgumentTypeError(f"must be NAME=TEXT, but it is `{text}`")
    return name.strip(), value.strip()


def read_direction(text: str) -> dict[str, float]:
    """Return a direction from ``NAME=VALUE,NAME=VALUE``, in which each name occurs once."""
    entries: dict[str, float] = {}
    for part in text.split(","):
        name, value = read_named_number(part)
        if name in entries:
            message = f"must name `{name}` once, not twice"
            raise argparse.ArgumentTypeError(message)
        entries[name] = value
    return entries


def read_interval(text: str) -> tuple[str, float, float]:
    """Return name, middle and radius of an interval ``NAME=VALUE:RADIUS``."""
    name, value, radius = _ends(text, "NAME=VALUE:RADIUS")
    wanted = f"have numbers for `{name}`"
    width = _number(radius, wanted)
    if not 0.0 < width < math.inf:
        raise argparse.ArgumentTypeError(f"must have a radius above 0, but the radius is {width:g}")
    return name, _number(value, wanted), width


def read_range(text: str) -> Range:
    """Return name and bounds from ``NAME=LOW:HIGH``."""
    name, low, high = _ends(text, "NAME=LOW:HIGH")
    wanted = f"have numbers for `{name}`"
    return Range(name, (_number(low, wanted), _number(high, wanted)))


def read_input(text: str) -> tuple[str, tuple[float, float] | None]:
    """Return name and range from ``NAME`` or ``NAME=LOW:HIGH``."""
    if "=" not in text:
        return text, None
    found = read_range(text)
    return found.name, found.box


def read_multipliers(text: str) -> tuple[complex, ...]:
    """Return complex numbers from ``MU,...``."""
    try:
        return tuple(complex(one.replace(" ", "")) for one in text.split(","))
    except ValueError as error:
        wanted = f"must be numbers such as 0.2,0.1 or 0.2+0.1j,0.2-0.1j, but it is `{text}`"
        raise argparse.ArgumentTypeError(wanted) from error


class AxisRange(NamedTuple):
    """A name with the ends of its range, and the number of points if it was given."""

    range: Range
    points: int | None

    def __str__(self) -> str:
        """Return the words that `read_axis` reads."""
        return str(self.range) if self.points is None else f"{self.range}:{self.points}"


def read_axis(text: str) -> AxisRange:
    """Return an axis of a map from ``NAME=LOW:HIGH`` or ``NAME=LOW:HIGH:COUNT``."""
    ends, _, count = text.rpartition(":")
    if ends.count(":") == 1:
        if not _is_whole(count) or int(count) < 2:
            wanted = "must have a COUNT of at least 2 points after LOW:HIGH"
            raise argparse.ArgumentTypeError(f"{wanted}, but it is `{count}`")
        return AxisRange(read_range(ends), read_count(count))
    return AxisRange(read_range(text), None)


def read_bound(text: str) -> tuple[str, zo.Bound]:
    """Return name and bound from ``NAME=LOWER:UPPER``, an open end left empty."""
    import zeno_orbits as zo

    name, low, high = _ends(text, "NAME=LOWER:UPPER, one end may be empty")
    wanted = f"have numbers for `{name}`"
    lower = _number(low, wanted) if low else -math.inf
    upper = _number(high, wanted) if high else math.inf
    try:
        return name, zo.Bound(name=name, lower=lower, upper=upper)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _ends(text: str, form: str) -> tuple[str, str, str]:
    name, sign, ends = text.partition("=")
    low, colon, high = ends.partition(":")
    if not sign or not colon or not name or ":" in high:
        raise argparse.ArgumentTypeError(f"must be {form}, but it is `{text}`")
    return name, low, high


Fit = tuple[tuple[tuple[str, ...], tuple[float, float] | None], ...]
"""Names that share one value, and the range of that value, if it is given."""


def read_fit(text: str) -> Fit:
    """Return names, those tied by ``+`` together, and bounds from ``NAME[=LOW:HIGH],...``."""
    found: list[tuple[tuple[str, ...], tuple[float, float] | None]] = []
    for entry in text.split(","):
        name, sign, _ = entry.strip().partition("=")
        names = tuple(part.strip() for part in name.split("+"))
        if not all(names):
            wanted = "must be NAME or NAME=LOW:HIGH, or several of them with commas between"
            raise argparse.ArgumentTypeError(f"{wanted}, but it is `{text}`")
        if any(names == known for known, _ in found):
            label = "+".join(names)
            raise argparse.ArgumentTypeError(f"must name `{label}` once, but it is `{text}`")
        found.append((names, read_range(entry.strip()).box if sign else None))
    return tuple(found)


def read_shape(text: str) -> zo.EventSequence:
    """Return the shape that a text such as ``zeno*2`` names."""
    import zeno_orbits as zo

    try:
        return zo.EventSequence.parsed(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def read_point_kind(text: str) -> zo.SpecialPointKind:
    """Return the kind of special points that a word such as ``fold`` names."""
    from zeno_orbits import api

    words = api.located_point_kinds()
    if text not in words:
        raise argparse.ArgumentTypeError(not_known(text, words))
    return words[text]


class Wish(NamedTuple):
    """A requested objective: a row of `OBJECTIVES` with its operand."""

    text: str
    word: str
    row: Any
    operand: Any

    def __str__(self) -> str:
        """Return the words that `read_wish` reads."""
        return self.text

    def objective(self, problem: zo.Problem, free: Mapping[str, tuple[float, float]]) -> Any:
        """Return the objective.

        Args:
            problem: The problem.
            free: Bounds of the decision variables by name.

        Raises:
            InputError: If no decision variable affects the objective, or a target is out of its
                range.
        """
        if self.row.operand.name == "NUMBERS":
            _check_targets(self.operand, free)
        elif not free:
            message = "needs a gain or parameter to vary. Add --vary NAME=LOW:HIGH"
            raise InputError(f"Argument `objective` {message}.")
        return self.row.objective(problem, self.operand)


_WITH_RANGES = ("robustness", "energy", "peak", "impacts", "bounce")
"""Objectives over uncertain ranges. The first of them needs a range."""


def over_ranges(wish: Wish, objective: Any, uncertain: Mapping[str, tuple[float, float]]) -> Any:
    """Return an objective over uncertain ranges.

    Args:
        wish: The objective as typed.
        objective: The objective.
        uncertain: Name to range.

    Raises:
        InputError: If the objective takes no ranges, or lacks them.
    """
    if wish.word not in _WITH_RANGES:
        words = f"{', '.join(_WITH_RANGES[:-1])} or {_WITH_RANGES[-1]}"
        raise InputError(f"Argument `--uncertain` must have --objective {words}.")
    if not uncertain and wish.word == _WITH_RANGES[0]:
        raise InputError("Argument `--objective robustness` must have --uncertain NAME=LOW:HIGH.")
    return replace(objective, uncertain=uncertain)


def require_starts_inside(
    given: Mapping[str, float], free: Mapping[str, tuple[float, float]]
) -> None:
    """Refuse a start outside its range.

    Args:
        given: Name to value that was given.
        free: Name to range of the decision variables.

    Raises:
        InputError: If a value is outside.
    """
    for name, value in given.items():
        low, high = free.get(name, (-math.inf, math.inf))
        if not low <= value <= high:
            message = f"must start in its range [{low:g}, {high:g}]"
            raise InputError(f"Argument `--set {name}={value:g}` {message}.")


def read_wish(text: str) -> Wish:
    """Return the objective from the words of ``--objective``."""
    from zeno_orbits import api

    word, _, rest = text.partition(":") if text.startswith(_WITH_NAMES) else text.partition("=")
    objectives = api.objective_words()
    known = objectives.get(word)
    takes = "NOTHING" if known is None else known.operand.name
    lacks = not rest and (takes in ("SIGNAL", "NUMBER") or text != word)
    if known is None or (takes == "NOTHING" and rest) or lacks:
        if known is not None and lacks:
            raise argparse.ArgumentTypeError(f"`{text}` lacks its value. Write {known.usage}")
        if known is not None:
            raise argparse.ArgumentTypeError(f"`{word}` takes no value, but `{rest}` is given")
        usages = ", ".join(one.usage for one in objectives.values())
        near = did_you_mean(word, objectives)
        raise argparse.ArgumentTypeError(f"unknown objective `{word}`.{near} Known: {usages}.")
    operand: Any = rest
    if takes in ("NUMBERS", "DIRECTION"):
        operand = _targets(rest)
    elif takes == "NUMBER":
        operand = _number(rest, f"have a number for the {word}")
    return Wish(text, word, known, operand)


_WITH_NAMES = ("nearest", "push", "robustness")
"""Objectives that names with numbers may follow, after a colon."""


def _targets(text: str) -> dict[str, float]:
    """Return name to target from ``NAME=VALUE,...``."""
    targets: dict[str, float] = {}
    for part in filter(None, text.split(",")):
        name, value = read_named_number(part)
        if name in targets:
            raise argparse.ArgumentTypeError(f"must name `{name}` once, not twice")
        targets[name] = value
    return targets


def _check_targets(targets: Mapping[str, float], free: Mapping[str, tuple[float, float]]) -> None:
    for name, value in targets.items():
        if name not in free:
            known = ", ".join(free) or "none"
            message = f"must name free gains or parameters ({known}), but it names `{name}`"
            raise InputError(f"Argument `objective` {message}.")
        low, high = free[name]
        if not low <= value <= high:
            bounds = f"must lie in the range of `{name}`, [{low:g}, {high:g}]"
            raise InputError(f"Argument `objective` {bounds}, but it is {value:g}.")
