"""Files of pushes and recoveries, as the commands `push` and `recovery` write them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.maps.pushes import Push, Pushes, PushSettings, unit_of_push
from zeno_orbits.maps.recovery import Recovery, RecoverySettings
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.simulation import Mode
from zeno_orbits.work import EntryError, from_plain, read_object

_SAME_VALUE = 1e-12
"""Largest relative difference of equal values, which may be derived on another machine."""
_SAME_PERIOD = 1e-6
"""Largest relative difference between the periods of one orbit."""
_SYMMETRIC = 1e-9
"""Largest difference between entries of a symmetric matrix, relative to its largest entry."""

_SAME_EXTENT = 1e-6
"""Largest relative difference of an extent from that of its norm and radius."""
_MOST = 10**9
"""Largest number of periods or tests."""

_Entries = TypeVar("_Entries")
_Result = TypeVar("_Result", Pushes, Recovery)


@dataclass(frozen=True, slots=True, kw_only=True)
class _PushEntry:
    """A push in a file. Without a loss, ``largest`` and ``error`` are null."""

    phase: float
    direction: Mapping[str, float]
    mode: str
    largest: float | None
    error: float | None
    beyond: str
    searched: float
    unit: str

    def push(self) -> Push:
        """Return the push."""
        return Push(
            phase=self.phase,
            direction=self.direction,
            mode=self.mode,
            largest=math.nan if self.largest is None else self.largest,
            error=math.nan if self.error is None else self.error,
            beyond=self.beyond,
            searched=self.searched,
            unit=self.unit,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _PushesFile:
    """A file of the command `push`. The first entry is in no other file."""

    pushes: tuple[_PushEntry, ...]
    problem: str
    gains: Mapping[str, float]
    parameters: Mapping[str, float]
    period: float
    spectral_radius: float
    phases: int
    steps: int
    reach: float
    error: float
    until: float
    least: _PushEntry | None
    versions: Mapping[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class _RecoveryFile:
    """A file of the command `recovery`. The first entry is in no other file.

    An unbounded radius and its extents are null.
    """

    norm: tuple[tuple[float, ...], ...]
    problem: str
    gains: Mapping[str, float]
    parameters: Mapping[str, float]
    period: float
    spectral_radius: float
    contraction: float
    part: float
    periods: int
    time: float
    directions: tuple[tuple[float, ...], ...]
    radius: float | None
    extents: Mapping[str, float] | None
    units: Mapping[str, str]
    tests: int
    samples: int
    confidence: float
    lost_share: float | None
    error: float
    seed: int
    versions: Mapping[str, str]


def read_pushes(path: Path) -> Pushes:
    """Read a file of the command `push`.

    Args:
        path: The file.

    Raises:
        InputError: If the file is missing, truncated or of another kind, or if an entry is missing,
            invalid, or contradicts other entries.
    """
    return _read("push", "pushes", _PushesFile, _pushes, path)


def read_recovery(path: Path) -> Recovery:
    """Read a file of the command `recovery`.

    Args:
        path: The file.

    Raises:
        InputError: If the file is missing, truncated or of another kind, or if an entry is missing,
            invalid, or contradicts other entries.
    """
    return _read("recovery", "recovery", _RecoveryFile, _recovery, path)


def require_pushes_of(orbit: Orbit, problem: Problem, found: Pushes) -> None:
    """Raise an error for pushes of another orbit.

    Args:
        orbit: The orbit.
        problem: Its problem.
        found: The pushes.

    Raises:
        InputError: If problem, gains, parameters, period, coordinates or units differ.
    """
    _require_same(orbit, found, "push", "pushes")
    for push in found.pushes:
        names = problem.state_names
        if not set(push.direction) <= set(names) or push.unit != unit_of_push(
            problem, push.direction
        ):
            reason = f"direction `{push.name}` [{push.unit}] does not belong to the problem"
            raise _refused("push", "pushes", reason)


def require_recovery_of(orbit: Orbit, problem: Problem, found: Recovery) -> None:
    """Raise an error for the recovery of another orbit.

    Args:
        orbit: The orbit.
        problem: Its problem.
        found: The recovery.

    Raises:
        InputError: If problem, gains, parameters, period, states or units differ.
    """
    _require_same(orbit, found, "recovery", "recovery")
    if dict(found.units) != dict(zip(problem.state_names, problem.state_units, strict=True)):
        raise _refused("recovery", "recovery", "its states and units differ from the problem")


def _require_same(orbit: Orbit, found: Pushes | Recovery, command: str, argument: str) -> None:
    remedy = f"Run `zeno-orbits {command} -o` for this orbit"
    if found.problem != orbit.problem:
        wanted = f"must be of the problem `{orbit.problem}`, but it is of `{found.problem}`"
        raise InputError(f"Argument `{argument}` {wanted}. {remedy}.")
    for kind, own, other in (
        ("gain", orbit.gains, found.gains),
        ("parameter", orbit.parameters, found.parameters),
    ):
        for name in (*own, *(name for name in other if name not in own)):
            here, there = own.get(name), other.get(name)
            if here is None or there is None or not math.isclose(here, there, rel_tol=_SAME_VALUE):
                values = f"is {_told(here)} in the orbit and {_told(there)} in the {argument}"
                reason = f"must be of this orbit, but {kind} `{name}` {values}"
                raise InputError(f"Argument `{argument}` {reason}. {remedy}.")
    if not math.isclose(found.period, orbit.period, rel_tol=_SAME_PERIOD):
        values = f"is {orbit.period!r} s in the orbit and {found.period!r} s in the {argument}"
        reason = f"must be of this orbit, but the period {values}"
        raise InputError(f"Argument `{argument}` {reason}. {remedy}.")


def _told(value: float | None) -> str:
    return "missing" if value is None else repr(value)


def _read(
    command: str,
    argument: str,
    kind: type[_Entries],
    result: Callable[[_Entries], _Result],
    path: Path,
) -> _Result:
    """Return the result of a command, from the entries of its file."""
    try:
        return result(from_plain(kind, read_object(path), finite=True))
    except EntryError as error:
        raise _refused(command, argument, _fault(error)) from error
    except InputError as error:
        raise _refused(command, argument, _invalid_settings(error)) from error
    except ValueError as error:
        raise _refused(command, argument, str(error)) from error


def _refused(command: str, argument: str, reason: str) -> InputError:
    wanted = f"must be a file of `zeno-orbits {command} -o`"
    return InputError(f"Argument `{argument}` {wanted}, but {reason}. Run this command again.")


def _fault(error: EntryError) -> str:
    if error.found == "missing":
        return f"entry `{error.name}` is missing"
    return f"entry `{error.name}` is {error.found} and not {error.wanted}"


def _invalid_settings(error: InputError) -> str:
    return f"its settings are invalid: {str(error).removesuffix('.')}"


def _require(holds: bool, name: str, wanted: str, found: object) -> None:
    """Raise an error for an entry without a valid value."""
    if not holds:
        raise EntryError(name, wanted, str(found))


def _require_orbit(file: _PushesFile | _RecoveryFile) -> None:
    _require(file.period > 0.0, "period", "positive", file.period)
    radius = file.spectral_radius
    _require(0.0 <= radius < 1.0, "spectral_radius", "in [0, 1)", radius)


def _pushes(file: _PushesFile) -> Pushes:
    _require_orbit(file)
    _require(file.until > 0.0, "until", "positive", file.until)
    settings = PushSettings(
        phases=file.phases,
        steps=file.steps,
        reach=file.reach,
        error=file.error,
        until=file.until,
    )
    for k, entry in enumerate(file.pushes):
        _require_push(entry, f"pushes[{k}]")
    _require_complete(file)
    found = Pushes(
        problem=file.problem,
        gains=file.gains,
        parameters=file.parameters,
        period=file.period,
        spectral_radius=file.spectral_radius,
        settings=settings,
        until=file.until,
        pushes=tuple(entry.push() for entry in file.pushes),
        versions=file.versions,
    )
    least = None if found.least is None else found.least.as_json()
    told = None if file.least is None else file.least.push().as_json()
    _require(least == told, "least", "the least of `pushes`", "another push")
    return found


def _require_push(entry: _PushEntry, name: str) -> None:
    _require(0.0 <= entry.phase < 1.0, f"{name}.phase", "in [0, 1)", entry.phase)
    _require(any(entry.direction.values()), f"{name}.direction", "different from zero", "zero")
    modes = [mode.value for mode in Mode]
    _require(entry.mode in modes, f"{name}.mode", f"one of {', '.join(modes)}", entry.mode)
    _require(entry.searched > 0.0, f"{name}.searched", "positive", entry.searched)
    _require(entry.unit != "", f"{name}.unit", "a unit", "empty")
    lost = entry.largest is not None
    _require((entry.error is not None) == lost, f"{name}.error", "null like `largest`", "not")
    _require(
        bool(entry.beyond) == lost,
        f"{name}.beyond",
        "empty if and only if no impulse is lost",
        "not",
    )
    if entry.largest is not None and entry.error is not None:
        _require(entry.error >= 0.0, f"{name}.error", "at least 0", entry.error)
        within = 0.0 <= entry.largest <= entry.searched
        _require(within, f"{name}.largest", "in [0, `searched`]", entry.largest)
        lost = (entry.largest + entry.error) * (1.0 - _SAME_VALUE)
        _require(lost <= entry.searched, f"{name}.error", "inside the scan", f"{entry.error:g}")


def _require_complete(file: _PushesFile) -> None:
    """Raise an error unless both senses of each direction have a push at each phase.

    A direction that was given twice has two.
    """
    rays: dict[frozenset[tuple[str, float]], list[float]] = {}
    for entry in file.pushes:
        rays.setdefault(frozenset(entry.direction.items()), []).append(entry.phase)
    _require(bool(rays), "pushes", "a list of pushes", "empty")
    phases = [k / file.phases for k in range(file.phases)]
    for direction, found in rays.items():
        opposite = frozenset((name, -entry) for name, entry in direction)
        times = len(found) // len(phases)
        complete = sorted(found) == sorted(phases * times) == sorted(rays.get(opposite, ()))
        _require(complete, "pushes", "a push per phase, direction and sense", "incomplete")


def _recovery(file: _RecoveryFile) -> Recovery:
    _require_orbit(file)
    _require(0.0 <= file.contraction < 1.0, "contraction", "in [0, 1)", file.contraction)
    least = file.spectral_radius * (1.0 - _SAME_VALUE)
    _require(file.contraction >= least, "contraction", "at least the spectral radius", "less")
    _require(1 <= file.periods <= _MOST, "periods", f"from 1 to {_MOST:.0e}", "another number")
    _require(1 <= file.tests <= _MOST, "tests", f"from 1 to {_MOST:.0e}", "another number")
    settings = RecoverySettings(
        part=file.part,
        samples=file.samples,
        confidence=file.confidence,
        error=file.error,
        seed=file.seed,
    )
    norm, directions = _matrices(file)
    radius = math.inf if file.radius is None else file.radius
    _require(radius >= 0.0, "radius", "at least 0", radius)
    found = Recovery(
        problem=file.problem,
        gains=file.gains,
        parameters=file.parameters,
        period=file.period,
        spectral_radius=file.spectral_radius,
        contraction=file.contraction,
        periods=file.periods,
        norm=norm,
        directions=directions,
        radius=radius,
        extents=_extents(file, norm, directions),
        units=file.units,
        tests=file.tests,
        settings=settings,
        versions=file.versions,
    )
    same = math.isclose(file.time, found.time, rel_tol=_SAME_VALUE)
    _require(same, "time", "`periods` times `period`", file.time)
    _require_share(file.lost_share, found.lost_share)
    return found


def _require_share(share: float | None, expected: float) -> None:
    same = math.isnan(expected)
    if share is not None:
        same = math.isclose(share, expected, rel_tol=_SAME_VALUE)
    _require(same, "lost_share", f"{expected:g} by the other entries", share)


def _matrices(file: _RecoveryFile) -> tuple[Vector, Vector]:
    """Return the matrix of the norm and the directions."""
    d = len(file.norm)
    _require(all(len(row) == d for row in file.norm), "norm", "a square matrix", "not square")
    fits = len(file.directions) == len(file.units) and all(len(r) == d for r in file.directions)
    _require(fits, "directions", "one row per state with the columns of `norm`", "of another shape")
    norm = np.array(file.norm, dtype=np.float64).reshape(d, d)
    directions = np.array(file.directions, dtype=np.float64).reshape(len(file.directions), d)
    largest = float(np.max(np.abs(norm), initial=0.0))
    symmetric = bool(np.all(np.abs(norm - norm.T) <= _SYMMETRIC * largest))
    positive = symmetric and bool(np.all(np.linalg.eigvalsh(norm) > 0.0))
    _require(positive, "norm", "symmetric and positive definite", "another matrix")
    return norm, directions


def _extents(file: _RecoveryFile, norm: Vector, directions: Vector) -> dict[str, float]:
    """Return the extents of the ball, which follow from its radius, its norm and the directions."""
    if file.radius is None:
        _require(file.extents is None, "extents", "null like `radius`", "not null")
        moved = np.any(directions != 0.0, axis=1)
        return {
            name: math.inf if moves else 0.0 for name, moves in zip(file.units, moved, strict=True)
        }
    extents = dict(file.extents or {})
    _require(list(extents) == list(file.units), "extents", "one per entry of `units`", "not")
    widths = np.sqrt(np.einsum("ij,ji->i", directions, np.linalg.solve(norm, directions.T)))
    for (name, extent), width in zip(extents.items(), widths.tolist(), strict=True):
        same = math.isclose(extent, file.radius * width, rel_tol=_SAME_EXTENT, abs_tol=0.0)
        wanted = f"{file.radius * width:g} by radius, norm and directions"
        _require(same, f"extents.{name}", wanted, f"{extent:g}")
    return extents
