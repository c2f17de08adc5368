"""A Zeno periodic orbit as numbers, and its JSON file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, cast

from zeno_orbits.errors import OrbitFileError
from zeno_orbits.files import write_whole
from zeno_orbits.problem import Problem, Setting

FORMAT = 1
"""Version of the file format that this code writes, and the newest that it reads."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitImpact:
    """One resolved impact of an orbit.

    Attributes:
        time: Since release [s].
        state_minus: State name to value just before it.
    """

    time: float
    state_minus: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenoOrbit:
    """Enough numbers to rebuild and recheck a Zeno periodic orbit; times count from release.

    Attributes:
        problem: Name of the scene.
        parameters: Name to value, all of the scene's.
        gains: Name to value, all of the scene's.
        period: [s].
        release_state: State name to value at the release.
        impacts: The impacts that were resolved one by one.
        zeno_time: [s].
        zeno_state: State name to value at the Zeno point.
        floquet_multipliers: Of the return map at the release; empty while unknown.
        certificate: What a verification said, as plain data; empty while unverified.
        versions: Name to version of what computed it.
    """

    problem: str
    parameters: Mapping[str, float]
    gains: Mapping[str, float]
    period: float
    release_state: Mapping[str, float]
    impacts: tuple[OrbitImpact, ...]
    zeno_time: float
    zeno_state: Mapping[str, float]
    floquet_multipliers: tuple[complex, ...] = ()
    certificate: Mapping[str, Any]
    versions: Mapping[str, str]

    def as_json(self) -> dict[str, Any]:
        """Return the orbit as the plain data of its file."""
        return {
            "format": FORMAT,
            "problem": self.problem,
            "parameters": dict(self.parameters),
            "gains": dict(self.gains),
            "period": self.period,
            "release_state": dict(self.release_state),
            "impacts": [
                {"time": impact.time, "state_minus": dict(impact.state_minus)}
                for impact in self.impacts
            ],
            "zeno_time": self.zeno_time,
            "zeno_state": dict(self.zeno_state),
            "floquet_multipliers": [[mu.real, mu.imag] for mu in self.floquet_multipliers],
            "certificate": dict(self.certificate),
            "versions": dict(self.versions),
        }

    def setting(self, problem: Problem) -> Setting:
        """Return the orbit's numbers for its scene.

        Raises:
            InputError: If the names or values do not fit the scene.
        """
        return problem.setting(gains=self.gains, parameters=self.parameters)


def versions() -> dict[str, str]:
    """Return name to version of what computes an orbit."""
    return dict(_versions())


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    """Ask the installation once: it takes longer than a period of simulation."""
    # Both take as long to import as a small module of ours, and a reader needs neither.
    import platform
    from importlib.metadata import PackageNotFoundError, version

    found = {"python": platform.python_version()}
    for name in ("zeno_orbits", "casadi", "numpy", "scipy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return tuple(found.items())


def write_orbit(orbit: ZenoOrbit, path: Path) -> None:
    """Write an orbit file, whole or not at all.

    Args:
        orbit: The orbit.
        path: Where; a file that is there is replaced.

    Raises:
        InputError: If the folder cannot be written.
    """
    write_whole(path, json.dumps(orbit.as_json(), indent=2, allow_nan=False) + "\n")


def read_orbit(path: Path) -> ZenoOrbit:
    """Read an orbit file, every number to the last bit.

    Args:
        path: The file.

    Raises:
        OrbitFileError: If it is missing, cut short, of a wrong type or of a newer format.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise OrbitFileError(path, f"it cannot be read ({type(error).__name__})") from error
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise OrbitFileError(path, f"it is no complete JSON ({error})") from error
    return orbit_from_json(data, path)


def orbit_from_json(data: object, path: Path) -> ZenoOrbit:
    """Return the orbit of what `ZenoOrbit.as_json` gave.

    Args:
        data: Plain data.
        path: Where it comes from, for messages.

    Raises:
        OrbitFileError: If it is of a wrong type or of a newer format.
    """
    return _Reader(path).orbit(data)


class _Reader:
    """Turns plain data into an orbit and names the entry that does not fit."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def orbit(self, data: object) -> ZenoOrbit:
        entries = self.mapping(data, "the file")
        self._check_format(entries)
        impacts = tuple(
            OrbitImpact(
                time=self.number(self.get(impact, "time"), f"impacts[{k}].time"),
                state_minus=self.numbers(
                    self.get(impact, "state_minus"), f"impacts[{k}].state_minus"
                ),
            )
            for k, impact in enumerate(
                self.mapping(entry, "impacts") for entry in self.sequence(entries, "impacts")
            )
        )
        multipliers = tuple(
            self._complex(pair) for pair in self.sequence(entries, "floquet_multipliers")
        )
        versions_found = self.mapping(entries.get("versions", {}), "versions")
        return ZenoOrbit(
            problem=self.text(self.get(entries, "problem"), "problem"),
            parameters=self.numbers(self.get(entries, "parameters"), "parameters"),
            gains=self.numbers(self.get(entries, "gains"), "gains"),
            period=self.positive(self.get(entries, "period"), "period"),
            release_state=self.numbers(self.get(entries, "release_state"), "release_state"),
            impacts=impacts,
            zeno_time=self.positive(self.get(entries, "zeno_time"), "zeno_time"),
            zeno_state=self.numbers(self.get(entries, "zeno_state"), "zeno_state"),
            floquet_multipliers=multipliers,
            certificate=self.mapping(entries.get("certificate", {}), "certificate"),
            versions={name: str(value) for name, value in versions_found.items()},
        )

    def refuse(self, reason: str) -> OrbitFileError:
        return OrbitFileError(self.path, reason)

    def get(self, entries: Mapping[str, Any], name: str) -> Any:
        if name not in entries:
            raise self.refuse(f"it has no `{name}`")
        return entries[name]

    def mapping(self, value: object, name: str) -> Mapping[str, Any]:
        if not isinstance(value, dict):
            raise self.refuse(f"`{name}` is not an object with names")
        return cast("dict[str, Any]", value)

    def sequence(self, entries: Mapping[str, Any], name: str) -> Sequence[Any]:
        value = self.get(entries, name)
        if not isinstance(value, list):
            raise self.refuse(f"`{name}` is not a list")
        return cast("list[Any]", value)

    def text(self, value: object, name: str) -> str:
        if not isinstance(value, str):
            raise self.refuse(f"`{name}` is not a text")
        return value

    def number(self, value: object, name: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.refuse(f"`{name}` is not a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self.refuse(f"`{name}` is not finite")
        return number

    def positive(self, value: object, name: str) -> float:
        number = self.number(value, name)
        if number <= 0.0:
            raise self.refuse(f"`{name}` is not positive")
        return number

    def numbers(self, value: object, name: str) -> dict[str, float]:
        entries = self.mapping(value, name)
        return {key: self.number(entry, f"{name}.{key}") for key, entry in entries.items()}

    def _complex(self, pair: object) -> complex:
        if not isinstance(pair, list) or len(cast("list[Any]", pair)) != 2:
            raise self.refuse("`floquet_multipliers` is not a list of pairs")
        real, imaginary = cast("list[Any]", pair)
        return complex(
            self.number(real, "floquet_multipliers"), self.number(imaginary, "floquet_multipliers")
        )

    def _check_format(self, entries: Mapping[str, Any]) -> None:
        number = self.get(entries, "format")
        if isinstance(number, bool) or not isinstance(number, int) or number < 1:
            raise self.refuse("`format` is not a positive whole number")
        if number > FORMAT:
            raise self.refuse(
                f"its format {number} is newer than {FORMAT}, the newest this version reads"
            )
