"""The data of a periodic orbit, and its JSON file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from zeno_orbits.errors import InputError
from zeno_orbits.model import ParameterValues, Problem, RecordedFile
from zeno_orbits.orbits.digest import digest_of
from zeno_orbits.orbits.shape import EventSequence, PhaseKind
from zeno_orbits.work import Columns, TableRepr, by_name, versions

FORMAT = 2
"""Version of the file format. It is the newest version that this code can read."""
ONE_RELEASE = 1
"""Version of the format for orbits with exactly one Zeno point and one release."""
EVENT_FORMAT = 3
"""Version of the format of orbit files that list events."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitImpact:
    """One resolved impact of an orbit.

    Attributes:
        time: Time since the start of the period [s].
        state_minus: State name to value just before the impact.
    """

    time: float
    state_minus: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitPhase:
    """A flight of an orbit and the events that end it.

    Attributes:
        kind: Kind of its end.
        start_time: Time of its start since the start of the period [s].
        start_state: State name to value at its start: at a release, or just after an impact.
        impacts: The impacts that were resolved one by one.
        zeno_time: If contact follows, the accumulation time since the start of the period [s].
        zeno_state: If contact follows, state name to value at the accumulation.
    """

    kind: PhaseKind
    start_time: float
    start_state: Mapping[str, float]
    impacts: tuple[OrbitImpact, ...]
    zeno_time: float | None = None
    zeno_state: Mapping[str, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ZenoOrbit(TableRepr):
    """The data with which a periodic orbit can be rebuilt and verified. Times count from its start.

    Attributes:
        problem: Name of the problem.
        parameters: Name to value, for all parameters of the problem.
        gains: Name to value, for all gains of the problem.
        period: Period [s].
        phases: Phases of a period. The first starts at time 0.
        floquet_multipliers: Multipliers of the return map at the start of the period. Empty while
            unknown.
        certificate: Result of a verification, as plain data. Empty while unverified.
        versions: Name to version of the packages that computed it.
        problem_digest: Digest of the equations of its problem (`digest.digest_of`). Empty in files
            of older versions.
        problem_file: File of its problem, or None if the problem is bundled. Not compared.
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
    problem_file: RecordedFile | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        """Return one line with the gains, the period, the phases and the verification status."""
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
    def shape(self) -> EventSequence:
        """Kinds of its phases."""
        return EventSequence(phases=tuple(phase.kind for phase in self.phases))

    @property
    def kind(self) -> str:
        """Name of the orbit: Zeno periodic, simple (plastic impacts), or without a Zeno point."""
        return self.shape.kind

    @property
    def start_state(self) -> Mapping[str, float]:
        """State name to value at the start of the period: a release, or just after an impact."""
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
        """State name to value at the release of an orbit with one release per period.

        Raises:
            InputError: If the orbit has a different shape.
        """
        self.shape.require_one_release()
        return self.start_state

    @property
    def zeno_time(self) -> float:
        """Zeno time of an orbit with one Zeno point per period [s].

        Raises:
            InputError: If the orbit has a different shape.
        """
        return self._held()[0]

    @property
    def zeno_state(self) -> Mapping[str, float]:
        """State name to value at the Zeno point of an orbit with one Zeno point per period.

        Raises:
            InputError: If the orbit has a different shape.
        """
        return self._held()[1]

    def _held(self) -> tuple[float, Mapping[str, float]]:
        self.shape.require_one_release()
        phase = self.phases[0]
        if phase.zeno_time is None or phase.zeno_state is None:
            raise InputError("Argument `orbit` lacks a Zeno point.")
        return phase.zeno_time, phase.zeno_state

    def as_json(self) -> dict[str, Any]:
        """Return the orbit as the plain data of its file, without `problem_file`.

        An orbit with one Zeno point and one release has format 1, which older versions can read.
        All other orbits have format 2, which older versions reject. The entries of format 1 are
        then absent.
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
        """Return the orbit's parameter values for its problem.

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
        values: The problem's parameter values.
        period: Period [s].
        phases: Phases of a period.
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
        problem_file=RecordedFile.of(problem),
    )


def one_release_phase(
    *,
    release_state: Mapping[str, float],
    impacts: Sequence[OrbitImpact],
    zeno_time: float,
    zeno_state: Mapping[str, float],
) -> OrbitPhase:
    """Return the only phase of an orbit from release to release, with its kind from the impacts.

    If there is a single impact at the Zeno time itself, the phase is plastic.

    Args:
        release_state: State name to value at the release.
        impacts: The resolved impacts.
        zeno_time: Zeno time since the release [s].
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
