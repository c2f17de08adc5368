r"""Stability of an orbit: multipliers, return map in named coordinates, and time to recover.

The coordinates of the return map are states that determine a point of the section. If `C` maps the
orthonormal coordinates of the chart to them, :math:`DP = C A C^{-1}` (theory (4.5)). A small
disturbance changes per period by the multipliers. The largest, :math:`\mu`, decides in the long
run: the part `s` is reached after :math:`\ln s / \ln \lvert\mu\rvert` periods.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalue_errors, spectral_radius
from zeno_orbits.errors import positive_number
from zeno_orbits.model import Problem
from zeno_orbits.orbits.orbit import Orbit
from zeno_orbits.orbits.section import Section, coordinates_of
from zeno_orbits.work import ByValue, Columns, TableRepr, versions

RECOVERED = {"1/e": math.exp(-1.0), "1 %": 0.01}
"""Parts of a small disturbance whose times are printed, by their names."""
_SURE = 1e-3
"""Errors of the multipliers of an orbit that closes are smaller, relative to 1 or the largest."""
_SEEN = 0.1
"""Least size of a state in a direction, relative to that of the first state, to be named."""
_SAFE = 2.0
"""Factor on an error that is known to first order."""
_AT_FOLD = 1e-6
"""Distance of a multiplier from 1 below which an orbit is at a fold."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Multipliers(ByValue):
    """Floquet multipliers of the return map.

    Attributes:
        values: The multipliers, the largest first.
        errors: Estimated error of each multiplier.
        jacobian: Derivative of the return map in section coordinates, ``(d, d)``.
        section: The chart of the section, or ``None`` if the multipliers are unknown.
        event: Name of the event of the section.
    """

    values: tuple[complex, ...]
    errors: tuple[float, ...]
    jacobian: Vector
    section: Section | None = None
    event: str = ""

    @classmethod
    def unknown(cls) -> Multipliers:
        """Return the multipliers of an orbit that does not return."""
        return cls(values=(), errors=(math.inf,), jacobian=np.zeros((0, 0)))

    @property
    def error(self) -> float:
        """Largest error of a multiplier. Infinite if the multipliers are unknown."""
        return max(self.errors, default=0.0)

    @property
    def spectral_radius(self) -> float:
        """Largest modulus. If it is below one, the orbit is stable."""
        return spectral_radius(self.values)


def estimated_errors(
    values: Sequence[complex], others: Sequence[complex], least: float
) -> tuple[float, ...]:
    r"""Return the estimated errors of the multipliers of an orbit.

    If a period ends `d` away from its start, the orbit is :math:`d / |1 - \mu|` away to first
    order, and the change of the multipliers over the period is multiplied accordingly.

    Args:
        values: The multipliers, the largest first.
        others: Multipliers of a rougher computation that starts at the end of the period.
        least: Least error, because two computations may agree by chance.
    """
    nearest = min([1.0, *(abs(1.0 - value) for value in values)])
    farther = _SAFE / max(nearest, _AT_FOLD)
    return tuple(farther * error + least for error in eigenvalue_errors(values, others))


@dataclass(frozen=True, slots=True, kw_only=True)
class SlowDirection:
    """The direction in which a small disturbance decays most slowly, or grows fastest.

    Attributes:
        multiplier: Its multiplier. A complex multiplier has a plane of such directions.
        ratios: State to its change per unit of change of the first state, which is the largest
            relative to the range of the state. For a plane, the ratio of the amplitudes.
        units: State to its unit.
    """

    multiplier: complex
    ratios: Mapping[str, float]
    units: Mapping[str, str]

    @property
    def periods_per_turn(self) -> float:
        """Periods in which a disturbance turns once in its plane. Infinite if it does not turn."""
        angle = abs(np.angle(self.multiplier)) if self.multiplier.imag else 0.0
        return 2.0 * math.pi / angle if angle else math.inf

    @property
    def words(self) -> str:
        """The direction in words, the largest state first."""
        first, *others = self.ratios
        if not others:
            return f"{first} alone"
        unit = self.units[first]
        parts = [
            f"{name} ({self.ratios[name]:.3g} {_per(self.units[name], unit)})".replace(" )", ")")
            for name in others
        ]
        return f"mostly {first}, with {', '.join(parts)}"


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Stability(TableRepr):
    """Stability of an orbit to first order.

    Attributes:
        problem: Name of the problem.
        gains: Gains of the orbit.
        parameters: Parameters of the orbit.
        period: Period [s].
        event: Event of the section on which disturbances are compared. The section consists of the
            states just after it, or just before it if the event is a switch.
        values: Floquet multipliers, the largest first. Empty if the section is a point.
        errors: Estimated error of each multiplier.
        coordinates: States that are the coordinates of the return map, ``d`` names.
        jacobian: Derivative `DP` of the return map in these coordinates, ``(d, d)``. Row `i`,
            column `j` has the unit of coordinate `i` per unit of coordinate `j`.
        norm: Largest row sum of moduli of `DP`, with each coordinate relative to its largest value.
            A disturbance can grow by this factor in its first period.
        slowest: The direction of the largest multiplier. ``None`` if it is zero.
        units: State to its unit.
        versions: Program name to version, for the programs that computed the result.
    """

    problem: str
    gains: Mapping[str, float]
    parameters: Mapping[str, float]
    period: float
    event: str
    values: tuple[complex, ...]
    errors: tuple[float, ...]
    coordinates: tuple[str, ...]
    jacobian: Vector
    norm: float
    slowest: SlowDirection | None
    units: Mapping[str, str]
    versions: Mapping[str, str]

    def __repr__(self) -> str:
        """Return one line with the spectral radius, its error and the time to recover."""
        return (
            f"<Stability of {self.problem}: spectral_radius={self.spectral_radius:.6g} "
            f"+- {self.error:.0e}, {self.verdict}>"
        )

    def _columns(self) -> Columns:
        """Return the multipliers."""
        return {
            "multiplier": list(self.values),
            "modulus": [abs(value) for value in self.values],
            "error": list(self.errors),
        }

    @property
    def spectral_radius(self) -> float:
        """Largest modulus of a multiplier. If it is below one, the orbit is stable."""
        return spectral_radius(self.values)

    @property
    def error(self) -> float:
        """Largest error of a multiplier."""
        return max(self.errors, default=0.0)

    @property
    def closes(self) -> bool:
        """True if the errors are so small that the motion from the start returns to it."""
        return self.error < _SURE * max(1.0, self.spectral_radius)

    @property
    def stable(self) -> bool:
        """True if all multipliers, with their errors, are inside the unit circle."""
        return self.closes and self.spectral_radius + self.error < 1.0

    @property
    def unstable(self) -> bool:
        """True if a multiplier is outside the unit circle by more than the error."""
        return self.closes and self.spectral_radius - self.error > 1.0

    @property
    def verdict(self) -> str:
        """``stable``, ``unstable`` or ``undecided``."""
        return "stable" if self.stable else "unstable" if self.unstable else "undecided"

    def periods_to(self, part: float) -> float:
        """Return the number of periods after which a small disturbance is a part of its first size.

        It follows from the largest multiplier and holds in its direction, and for every disturbance
        in the long run. The value is negative if the part is in the past. Without a multiplier
        above rounding, disturbances vanish after as many periods as multipliers, at least one.

        Args:
            part: The part, below 1 for a disturbance that decays and above 1 for one that grows.

        Raises:
            InputError: If the part is not a positive number.
        """
        part = positive_number("part", part)
        if self.spectral_radius == 0.0:
            return float(max(1, len(self.values))) if part < 1.0 else math.inf
        rate = math.log(self.spectral_radius)
        return math.log(part) / rate if rate else math.inf

    def time_to(self, part: float) -> float:
        """Return the time after which a small disturbance is a part of its first size [s]."""
        return self.periods_to(part) * self.period

    @property
    def milestones(self) -> dict[str, float]:
        """Name of a part to the periods until a disturbance has it: decay, or doubling.

        Empty if the errors leave the stability open.
        """
        if self.stable:
            return {name: self.periods_to(part) for name, part in RECOVERED.items()}
        return {"twice": self.periods_to(2.0)} if self.unstable else {}

    def as_json(self) -> dict[str, Any]:
        """Return the result as plain data. An unknown error is null."""
        slow = self.slowest
        turn = math.inf if slow is None else slow.periods_per_turn
        return {
            "problem": self.problem,
            "gains": dict(self.gains),
            "parameters": dict(self.parameters),
            "period": self.period,
            "verdict": self.verdict,
            "spectral_radius": self.spectral_radius,
            "multipliers": [
                {
                    "value": [value.real, value.imag],
                    "error": error if math.isfinite(error) else None,
                }
                for value, error in zip(self.values, self.errors, strict=True)
            ],
            "section": self.event,
            "coordinates": {name: self.units[name] for name in self.coordinates},
            "return_map": self.jacobian.tolist(),
            "norm": self.norm,
            "slowest_direction": None if slow is None else dict(slow.ratios),
            "periods_per_turn": turn if math.isfinite(turn) else None,
            "recovery": [
                {"to": name, "periods": periods, "time": periods * self.period}
                for name, periods in self.milestones.items()
            ],
            "versions": dict(self.versions),
        }


def stability_of(problem: Problem, orbit: Orbit, multipliers: Multipliers) -> Stability:
    """Return the stability of an orbit in the names and units of its problem.

    Args:
        problem: The problem of the orbit.
        orbit: The orbit.
        multipliers: Its multipliers, which are known.
    """
    section = multipliers.section
    names = problem.state_names
    units = dict(zip(names, problem.state_units, strict=True))
    n = len(names)
    lift = np.zeros((n, 0)) if section is None else section.lift[:n]
    scale = np.ones(n) if section is None else section.scale[:n]
    chosen = coordinates_of(lift / scale[:, None])
    here, sizes = lift[chosen], scale[chosen]
    jacobian = here @ multipliers.jacobian @ np.linalg.inv(here)
    relative = np.abs(jacobian * sizes / sizes[:, None])
    return Stability(
        problem=problem.name,
        gains=dict(orbit.gains),
        parameters=dict(orbit.parameters),
        period=orbit.period,
        event=multipliers.event,
        values=multipliers.values,
        errors=multipliers.errors,
        coordinates=tuple(names[k] for k in chosen),
        jacobian=jacobian,
        norm=float(np.max(np.sum(relative, axis=1), initial=0.0)),
        slowest=_slowest(multipliers, lift, scale, units),
        units=units,
        versions=versions(),
    )


def _slowest(
    multipliers: Multipliers, lift: Vector, scale: Vector, units: Mapping[str, str]
) -> SlowDirection | None:
    """Return the direction of the largest multiplier, or ``None`` if it is below rounding."""
    if not multipliers.values or multipliers.values[0] == 0.0:
        return None
    value = multipliers.values[0]
    known, vectors = np.linalg.eig(multipliers.jacobian)
    direction = lift @ vectors[:, int(np.argmin(np.abs(known - value)))]
    moved = np.abs(direction) if value.imag else np.real(direction)
    sizes = np.abs(moved) / scale
    order = [int(k) for k in np.argsort(-sizes, kind="stable")]
    first, names = order[0], list(units)
    ratios = {
        names[k]: float(moved[k] / moved[first]) for k in order if sizes[k] >= _SEEN * sizes[first]
    }
    return SlowDirection(multiplier=value, ratios=ratios, units=units)


def _per(unit: str, other: str) -> str:
    """Return a unit per another unit, or nothing if they are the same."""
    if unit == other:
        return ""
    if unit == "1":
        return f"per {other}"
    return unit if other == "1" else f"{unit} per {other}"
