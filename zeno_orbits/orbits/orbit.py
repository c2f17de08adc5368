"""A periodic orbit as numbers, and its JSON file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from zeno_orbits.errors import InputError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits.digest import digest_of
from zeno_orbits.orbits.shape import OrbitShape, PhaseKind
from zeno_orbits.work import Columns, Displayed, by_name, versions

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
    """A flight of an orbit and the events that end it.

    Attributes:
        kind: How it ends.
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


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ZenoOrbit(Displayed):
    """Enough numbers to rebuild and recheck a periodic orbit; times count from its start.

    Attributes:
        problem: Name of the problem.
        parameters: Name to value, all of the problem's.
        gains: Name to value, all of the problem's.
        period: [s].
        phases: Phases of a period; the first starts at time 0.
        floquet_multipliers: Of the return map where the period starts; empty while unknown.
        certificate: Result of a verification, as plain data; empty while unverified.
        versions: Name to version of the packages that computed it.
        problem_digest: Numbers that tell the equations of its problem from others
            (`digest.digest_of`); empty in files of older versions.
    """

    problem: str
    parameters: Mapping[str, float]
    gains: Mapping[str, float]
    period: float
    phases: tuple[OrbitPhase, ...]
    floquet_multipliers: tuple[complex, ...] = ()
    certificate: Mapping[str, Any]
    versions: Mapping[str, str]
    problem_digest: tuple[float, ...] = ()

    def __repr__(self) -> str:
        """Return one line: the gains, the period, the phases and whether it is verified."""
        gains = "".join(f"{name}={value:.7g}, " for name, value in self.gains.items())
        known = ", ".join(f"{abs(value):.3g}" for value in self.floquet_multipliers)
        moduli = f"multipliers of modulus {known}, " if known else ""
        verified = bool(self.certificate.get("passed"))
        return (
            f"<ZenoOrbit of {self.problem}: {gains}period={self.period:.10g} s, "
            f"shape={self.shape.text}, impacts={len(self.impacts)}, {moduli}verified={verified}>"
        )

    def _columns(self) -> Columns:
        """Return the impacts with the states before them."""
        return {
            "time": [impact.time for impact in self.impacts],
            **by_name([impact.state_minus for impact in self.impacts]),
        }

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
    def states_at_events(self) -> tuple[Mapping[str, float], ...]:
        """State name to value at the start of each phase, before its impacts, at its Zeno point."""
        starts = [phase.start_state for phase in self.phases]
        zeno = [phase.zeno_state for phase in self.phases if phase.zeno_state is not None]
        return (*starts, *zeno, *(impact.state_minus for impact in self.impacts))

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
        digest = {"problem_digest": list(self.problem_digest)} if self.problem_digest else {}
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
            **digest,
        }

    def _one_release(self) -> dict[str, Any]:
        return {
            "release_state": dict(self.release_state),
            "impacts": _plain_impacts(self.impacts),
            "zeno_time": self.zeno_time,
            "zeno_state": dict(self.zeno_state),
        }

    def values(self, problem: Problem) -> ParameterValues:
        """Return the orbit's numbers for its problem.

        Raises:
            InputError: If the names or values do not fit the problem.
        """
        return problem.values(gains=self.gains, parameters=self.parameters)


def new_orbit(
    problem: Problem, values: ParameterValues, *, period: float, phases: tuple[OrbitPhase, ...]
) -> ZenoOrbit:
    """Return an orbit without a certificate, computed by this version.

    Args:
        problem: Its problem.
        values: The problem's numbers.
        period: [s].
        phases: What happens in a period.
    """
    return ZenoOrbit(
        problem=problem.name,
        parameters=dict(values.parameters),
        gains=dict(values.gains),
        period=period,
        phases=phases,
        certificate={},
        versions=versions(),
        problem_digest=digest_of(problem),
    )


def one_release_phase(
    *,
    release_state: Mapping[str, float],
    impacts: Sequence[OrbitImpact],
    zeno_time: float,
    zeno_state: Mapping[str, float],
) -> OrbitPhase:
    """Return the one phase of an orbit from release to release, of the kind that its impacts show.

    A single impact at the Zeno time itself is a plastic one.

    Args:
        release_state: State name to value at the release.
        impacts: The resolved impacts.
        zeno_time: Since the release [s].
        zeno_state: State name to value at the Zeno point.
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
