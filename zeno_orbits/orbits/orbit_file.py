"""Orbit files: JSON that holds every number of an orbit to the last bit."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from zeno_orbits.errors import InputError, OrbitFileError
from zeno_orbits.orbits.orbit import (
    FORMAT,
    ONE_RELEASE,
    OrbitImpact,
    OrbitPhase,
    ZenoOrbit,
    one_release_phase,
)
from zeno_orbits.orbits.shape import PhaseKind
from zeno_orbits.work.files import write_whole
from zeno_orbits.work.serialization import Entries


def write_orbit(orbit: ZenoOrbit, path: Path | str) -> None:
    """Write an orbit file, whole or not at all.

    Args:
        orbit: The orbit.
        path: Where; a file that is there is replaced.

    Raises:
        InputError: If the folder cannot be written.
    """
    write_whole(Path(path), json.dumps(orbit.as_json(), indent=2, allow_nan=False) + "\n")


def read_orbit(path: Path | str) -> ZenoOrbit:
    """Read an orbit file, every number to the last bit.

    Args:
        path: The file.

    Raises:
        OrbitFileError: If it is missing, cut short, of a wrong type or of a newer format, or if
            its parts contradict each other.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise OrbitFileError(path, f"it cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise OrbitFileError(path, "it is no text in UTF-8") from error
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


class _Reader(Entries):
    """Turns plain data into an orbit and names the entry that does not fit."""

    def refuse(self, reason: str) -> OrbitFileError:
        """Return what is raised of a file."""
        return OrbitFileError(self.path, reason)

    def orbit(self, data: object) -> ZenoOrbit:
        entries = self.mapping(data, "the file")
        number = self._format(entries)
        phases = (self._one_release(entries),) if number == ONE_RELEASE else self._phases(entries)
        multipliers = tuple(
            self._complex(pair) for pair in self.sequence(entries, "floquet_multipliers")
        )
        versions_found = self.mapping(entries.get("versions", {}), "versions")
        orbit = ZenoOrbit(
            problem=self.text(self.get(entries, "problem"), "problem"),
            parameters=self.numbers(self.get(entries, "parameters"), "parameters"),
            gains=self.numbers(self.get(entries, "gains"), "gains"),
            period=self.positive(self.get(entries, "period"), "period"),
            phases=phases,
            floquet_multipliers=multipliers,
            certificate=self.mapping(entries.get("certificate", {}), "certificate"),
            versions={name: str(value) for name, value in versions_found.items()},
        )
        self._check_shape(entries, orbit, number)
        return orbit

    def _one_release(self, entries: Mapping[str, Any]) -> OrbitPhase:
        phase = one_release_phase(
            release_state=self.numbers(self.get(entries, "release_state"), "release_state"),
            impacts=self._impacts(entries, ""),
            zeno_time=self.positive(self.get(entries, "zeno_time"), "zeno_time"),
            zeno_state=self.numbers(self.get(entries, "zeno_state"), "zeno_state"),
        )
        said = {kind.value: kind for kind in PhaseKind if kind.holds}.get(entries.get("shape", ""))
        return phase if said is None else replace(phase, kind=said)

    def _phases(self, entries: Mapping[str, Any]) -> tuple[OrbitPhase, ...]:
        listed = self.sequence(entries, "phases")
        if not listed:
            raise self.refuse("`phases` is empty")
        return tuple(
            self._phase(self.mapping(entry, f"phases[{k}]"), k) for k, entry in enumerate(listed)
        )

    def _phase(self, entries: Mapping[str, Any], place: int) -> OrbitPhase:
        where = f"phases[{place}]."
        known = {kind.value: kind for kind in PhaseKind}
        word = self.text(self.get(entries, "kind"), f"{where}kind")
        if word not in known:
            raise self.refuse(f"`{where}kind` is none of {', '.join(known)}")
        kind = known[word]
        zeno_time, zeno_state = None, None
        if kind.holds:
            zeno_time = self.positive(self.get(entries, "zeno_time"), f"{where}zeno_time")
            zeno_state = self.numbers(self.get(entries, "zeno_state"), f"{where}zeno_state")
        elif "zeno_time" in entries or "zeno_state" in entries:
            raise self.refuse(f"`{where}kind` is `{word}`, and yet there is a Zeno point")
        start_time = self.number(self.get(entries, "start_time"), f"{where}start_time")
        if (start_time == 0.0) != (place == 0) or start_time < 0.0:
            wanted = "0" if place == 0 else "later than 0"
            raise self.refuse(f"`{where}start_time` is not {wanted}")
        return OrbitPhase(
            kind=kind,
            start_time=start_time,
            start_state=self.numbers(self.get(entries, "start_state"), f"{where}start_state"),
            impacts=self._impacts(entries, where),
            zeno_time=zeno_time,
            zeno_state=zeno_state,
        )

    def _impacts(self, entries: Mapping[str, Any], where: str) -> tuple[OrbitImpact, ...]:
        return tuple(
            OrbitImpact(
                time=self.number(self.get(impact, "time"), f"{where}impacts[{k}].time"),
                state_minus=self.numbers(
                    self.get(impact, "state_minus"), f"{where}impacts[{k}].state_minus"
                ),
            )
            for k, impact in enumerate(
                self.mapping(entry, f"{where}impacts")
                for entry in self.sequence(entries, "impacts")
            )
        )

    def _check_shape(self, entries: Mapping[str, Any], orbit: ZenoOrbit, number: int) -> None:
        """Refuse phases that are no shape, another than the file says, or of the other format."""
        try:
            shape = orbit.shape
        except InputError as error:
            raise self.refuse(f"its phases are no shape: {error}".removesuffix(".")) from error
        said = shape.text
        if number == FORMAT or "shape" in entries:
            said = self.text(self.get(entries, "shape"), "shape")
        if said != shape.text:
            raise self.refuse(f"its `shape` is `{said}`, but its phases are `{shape.text}`")
        if shape.has_one_release and number != ONE_RELEASE:
            raise self.refuse(f"a shape `{said}` has format {ONE_RELEASE}, but it has {number}")

    def _complex(self, pair: object) -> complex:
        if not isinstance(pair, list) or len(cast("list[Any]", pair)) != 2:
            raise self.refuse("`floquet_multipliers` is not a list of pairs")
        real, imaginary = cast("list[Any]", pair)
        return complex(
            self.number(real, "floquet_multipliers"), self.number(imaginary, "floquet_multipliers")
        )

    def _format(self, entries: Mapping[str, Any]) -> int:
        number = self.get(entries, "format")
        if isinstance(number, bool) or not isinstance(number, int) or number < 1:
            raise self.refuse("`format` is not a positive whole number")
        if number > FORMAT:
            raise self.refuse(
                f"its format {number} is newer than {FORMAT}, the newest this version reads"
            )
        return number
