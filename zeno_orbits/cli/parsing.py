"""Words of the command line as values: the border at which strings stand for choices."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from zeno_orbits.errors import InputError

if TYPE_CHECKING:
    from zeno_orbits.model.problem import Problem
    from zeno_orbits.model.rig_parts import Rig
    from zeno_orbits.orbits.bounds import Bound
    from zeno_orbits.orbits.shape import OrbitShape
    from zeno_orbits.search.objectives import Objective


def read_numbers(entries: Sequence[str], option: str) -> dict[str, float]:
    """Return name to value from ``NAME=VALUE`` entries."""
    numbers: dict[str, float] = {}
    for entry in entries:
        name, sign, value = entry.partition("=")
        if not sign or not name:
            raise InputError(f"Argument `{option}` must be NAME=VALUE, but it is `{entry}`.")
        if name in numbers:
            raise InputError(f"Argument `{option}` must name `{name}` once, but it does so twice.")
        numbers[name] = read_number(value, name)
    return numbers


def read_rig(rig: Rig, entries: Sequence[str], only: Sequence[str] | None) -> Rig:
    """Return a rig with other parts and other numbers.

    Args:
        rig: What is changed.
        entries: ``contact.stiffness=1e5``, ``friction.COORDINATE.coulomb=0.01``,
            ``gears.MOTOR.play=0.01``; a part that is not there yet is added.
        only: Names of the parts to keep beside the contact; all of them if ``None``.
    """
    from zeno_orbits.model.rig_parts import PART_NAMES, with_numbers, without_parts

    if only is not None:
        if "sensors" in only and "controller" not in only:
            wanted = "must name the controller with the sensors, which it reads"
            raise InputError(f"Argument `only` {wanted}, but it does not.")
        rig = without_parts(rig, [name for name in PART_NAMES if name not in only])
    return with_numbers(rig, read_numbers(entries, "part"))


def read_boxes(entries: Sequence[str], option: str = "gain") -> dict[str, tuple[float, float]]:
    """Return name to bounds from ``NAME=LOW:HIGH`` entries."""
    boxes: dict[str, tuple[float, float]] = {}
    for entry in entries:
        name, box = read_range(entry, option)
        if name in boxes:
            raise InputError(f"Argument `{option}` must name `{name}` once, but it does so twice.")
        boxes[name] = box
    return boxes


def read_shape(text: str | None) -> OrbitShape | None:
    """Return the shape that a text such as ``zeno*2`` names, if there is one."""
    from zeno_orbits.orbits.shape import OrbitShape

    return None if text is None else OrbitShape.parsed(text)


def read_fit(
    text: str,
) -> tuple[tuple[tuple[str, ...], tuple[float, float] | None], ...]:
    """Return names, those tied by ``+`` together, and bounds from ``NAME[=LOW:HIGH],...``."""
    found: list[tuple[tuple[str, ...], tuple[float, float] | None]] = []
    for entry in text.split(","):
        name, sign, _ = entry.strip().partition("=")
        names = tuple(part.strip() for part in name.split("+"))
        if not all(names):
            wanted = "must be NAME or NAME=LOW:HIGH, or several of them with commas between"
            raise InputError(f"Argument `fit` {wanted}, but it is `{text}`.")
        found.append((names, read_range(entry.strip(), "fit")[1] if sign else None))
    return tuple(found)


def read_bounds(entries: Sequence[str]) -> tuple[Bound, ...]:
    """Return bounds from ``NAME=LOWER:UPPER`` entries, an open end left empty."""
    from zeno_orbits.orbits.bounds import Bound

    found: list[Bound] = []
    for entry in entries:
        name, sign, ends = entry.partition("=")
        low, colon, high = ends.partition(":")
        if not sign or not colon or not name:
            wanted = "must be NAME=LOWER:UPPER, one end may be empty"
            raise InputError(f"Argument `keep` {wanted}, but it is `{entry}`.")
        if name in [bound.name for bound in found]:
            raise InputError(f"Argument `keep` must name `{name}` once, but it does so twice.")
        lower = read_number(low, name) if low else -math.inf
        upper = read_number(high, name) if high else math.inf
        found.append(Bound(name=name, lower=lower, upper=upper))
    return tuple(found)


def read_range(entry: str, option: str) -> tuple[str, tuple[float, float]]:
    """Return name and bounds from ``NAME=LOW:HIGH``."""
    name, sign, bounds = entry.partition("=")
    low, colon, high = bounds.partition(":")
    if not sign or not colon or not name:
        raise InputError(f"Argument `{option}` must be NAME=LOW:HIGH, but it is `{entry}`.")
    return name, (read_number(low, name), read_number(high, name))


def read_number(text: str, name: str) -> float:
    """Return a number, or say which name has none."""
    try:
        # Python reads 1_5 as 15; whoever types it means 1.5 or a range.
        return float("" if "_" in text else text)
    except ValueError:
        raise InputError(f"Argument `{name}` must be a number, but it is `{text}`.") from None


def read_count(text: str) -> int:
    """Return a positive whole number, for ``argparse``."""
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a positive whole number, but it is `{text}`")
    return int(text)


def read_grid(text: str) -> tuple[int, int]:
    """Return two positive whole numbers from ``NxM``, for ``argparse``."""
    first, sign, second = text.partition("x")
    if not sign:
        raise argparse.ArgumentTypeError(f"must be NxM, 50x50 for instance, but it is `{text}`")
    return read_count(first), read_count(second)


def read_once(texts: Sequence[str], option: str, otherwise: str) -> str:
    """Return what an option says that may be given once only, where the last would win silently."""
    if len(texts) > 1:
        raise InputError(f"Argument `{option}` must be given once, but it is {', '.join(texts)}.")
    return texts[0] if texts else otherwise


def read_seed(text: str) -> int:
    """Return a whole number that is not negative, for ``argparse``."""
    if not text.isdigit():
        raise argparse.ArgumentTypeError(f"must be a whole number from 0 on, but it is `{text}`")
    return int(text)


def read_objective(
    wish: str, problem: Problem, free: Mapping[str, tuple[float, float]]
) -> Objective:
    """Return the objective that a wish on the command line stands for.

    Args:
        wish: A word of `OBJECTIVES`, with its operand.
        problem: The problem.
        free: Name to bounds of what is free.
    """
    from zeno_orbits.search.objectives import OBJECTIVES, Operand

    word, _, text = wish.partition(":") if wish.startswith("nearest") else wish.partition("=")
    known = OBJECTIVES.get(word)
    takes = Operand.NOTHING if known is None else known.operand
    if (
        known is None
        or (takes is Operand.NOTHING and text)
        or (takes is Operand.SIGNAL and not text)
    ):
        *most, last = (one.usage for one in OBJECTIVES.values())
        wishes = f"{', '.join(most)} or {last}"
        raise InputError(f"Argument `objective` must be {wishes}, but it is `{wish}`.")
    if takes is Operand.NUMBERS:
        return known.objective(problem, _targets(text, free))
    operand: str | float = text
    if takes is Operand.NUMBER:
        operand = read_number(text, f"objective {word}")
        if not 0.0 < operand < math.inf:
            message = f"must have a positive {word}, but it is {operand:g}"
            raise InputError(f"Argument `objective` {message}.")
    if not free:
        message = f"must leave a gain or a parameter free for the {word}, but none is"
        raise InputError(f"Argument `objective` {message}.")
    return known.objective(problem, operand)


def _targets(text: str, free: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Return name to target from ``NAME=VALUE,...``, each in the range of what is free."""
    targets = read_numbers([part for part in text.split(",") if part], "objective")
    for name, value in targets.items():
        if name not in free:
            known = ", ".join(free) or "none"
            message = f"must name what is free ({known}), but it names `{name}`"
            raise InputError(f"Argument `objective` {message}.")
        low, high = free[name]
        if not low <= value <= high:
            bounds = f"must lie in the range of `{name}`, [{low:g}, {high:g}]"
            raise InputError(f"Argument `objective` {bounds}, but it is {value:g}.")
    return targets
