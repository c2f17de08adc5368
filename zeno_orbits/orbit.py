"""A periodic orbit as numbers, and its JSON file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, cast

from zeno_orbits.entries import Entries
from zeno_orbits.errors import InputError, OrbitFileError
from zeno_orbits.files import write_whole
from zeno_orbits.problem import Problem, Setting
from zeno_orbits.shape import OrbitShape, PhaseKind

FORMAT = 2
"""Version of the file format, the newest that this code reads."""
ONE_RELEASE = 1
"""Version that holds orbits with one Zeno point and one release, and no others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitImpact:
    """One resolved impact of an orbit.

    Attributes:
        time: Since the start of the period [s].
        state_minus: State name to value just before it.
    """

    time: float
    state_minus: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitPhase:
    """A flight of an orbit and what ends it.

    Attributes:
        kind: What ends it.
        start_time: Since the start of the period [s].
        start_state: State name to value at the release, or just after the impact, before it.
        impacts: The impacts that were resolved one by one.
        zeno_time: Where they accumulate, if the stop holds, since the start of the period [s].
        zeno_state: State name to value there.
    """

    kind: PhaseKind
    start_time: float
    start_state: Mapping[str, float]
    impacts: tuple[OrbitImpact, ...]
    zeno_time: float | None = None
    zeno_state: Mapping[str, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenoOrbit:
    """Enough numbers to rebuild and recheck a periodic orbit; times count from its start.

    Attributes:
        problem: Name of the scene.
        parameters: Name to value, all of the scene's.
        gains: Name to value, all of the scene's.
        period: [s].
        phases: What happens in a period; the first starts at time 0.
        floquet_multipliers: Of the return map where the period starts; empty while unknown.
        certificate: What a verification said, as plain data; empty while unverified.
        versions: Name to version of what computed it.
    """

    problem: str
    parameters: Mapping[str, float]
    gains: Mapping[str, float]
    period: float
    phases: tuple[OrbitPhase, ...]
    floquet_multipliers: tuple[complex, ...] = ()
    certificate: Mapping[str, Any]
    versions: Mapping[str, str]

    @property
    def shape(self) -> OrbitShape:
        """Kinds of its phases."""
        return OrbitShape(phases=tuple(phase.kind for phase in self.phases))

    @property
    def start_state(self) -> Mapping[str, float]:
        """State name to value where the period starts: at a release, or just after an impact."""
        return self.phases[0].start_state

    @property
    def impacts(self) -> tuple[OrbitImpact, ...]:
        """The resolved impacts of all phases."""
        return tuple(impact for phase in self.phases for impact in phase.impacts)

    @property
    def release_state(self) -> Mapping[str, float]:
        """State name to value at the release of an orbit that has one a period.

        Raises:
            InputError: If it has another shape.
        """
        self.shape.require_one_release()
        return self.start_state

    @property
    def zeno_time(self) -> float:
        """Zeno time of an orbit that has one Zeno point a period [s].

        Raises:
            InputError: If it has another shape.
        """
        return self._held()[0]

    @property
    def zeno_state(self) -> Mapping[str, float]:
        """State name to value at the Zeno point of an orbit that has one a period.

        Raises:
            InputError: If it has another shape.
        """
        return self._held()[1]

    def _held(self) -> tuple[float, Mapping[str, float]]:
        self.shape.require_one_release()
        phase = self.phases[0]
        if phase.zeno_time is None or phase.zeno_state is None:
            raise InputError("Argument `orbit` must have a Zeno point, but it has none.")
        return phase.zeno_time, phase.zeno_state

    def as_json(self) -> dict[str, Any]:
        """Return the orbit as the plain data of its file.

        With one Zeno point and one release it is of format 1, which older readers know. Of another
        shape it is of format 2, which they refuse, and has none of the entries that they read.
        """
        one = self.shape.has_one_release
        return {
            "format": ONE_RELEASE if one else FORMAT,
            "problem": self.problem,
            "parameters": dict(self.parameters),
            "gains": dict(self.gains),
            "shape": self.shape.text,
            "period": self.period,
            **(self._one_release() if one else {"phases": [_plain(p) for p in self.phases]}),
            "floquet_multipliers": [[mu.real, mu.imag] for mu in self.floquet_multipliers],
            "certificate": dict(self.certificate),
            "versions": dict(self.versions),
        }

    def _one_release(self) -> dict[str, Any]:
        return {
            "release_state": dict(self.release_state),
            "impacts": _plain_impacts(self.impacts),
            "zeno_time": self.zeno_time,
            "zeno_state": dict(self.zeno_state),
        }

    def setting(self, problem: Problem) -> Setting:
        """Return the orbit's numbers for its scene.

        Raises:
            InputError: If the names or values do not fit the scene.
        """
        return problem.setting(gains=self.gains, parameters=self.parameters)


def one_release_phase(
    *,
    release_state: Mapping[str, float],
    impacts: Sequence[OrbitImpact],
    zeno_time: float,
    zeno_state: Mapping[str, float],
) -> OrbitPhase:
    """Return the one phase of an orbit from release to release, of the kind that its impacts show.

    A single impact at the Zeno time itself is a plastic one.
    """
    at_once = len(impacts) == 1 and impacts[0].time == zeno_time
    return OrbitPhase(
        kind=PhaseKind.PLASTIC if at_once else PhaseKind.ZENO,
        start_time=0.0,
        start_state=release_state,
        impacts=tuple(impacts),
        zeno_time=zeno_time,
        zeno_state=zeno_state,
    )


def _plain(phase: OrbitPhase) -> dict[str, Any]:
    zeno = {}
    if phase.zeno_state is not None:
        zeno = {"zeno_time": phase.zeno_time, "zeno_state": dict(phase.zeno_state)}
    return {
        "kind": phase.kind.value,
        "start_time": phase.start_time,
        "start_state": dict(phase.start_state),
        "impacts": _plain_impacts(phase.impacts),
        **zeno,
    }


def _plain_impacts(impacts: Sequence[OrbitImpact]) -> list[dict[str, Any]]:
    return [{"time": one.time, "state_minus": dict(one.state_minus)} for one in impacts]


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
