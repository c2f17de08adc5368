"""The certificate of a periodic orbit: residuals, margins, stability, and a verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from zeno_orbits.orbits import (
    NO_ZENO_ORBIT,
    SIMPLE_ORBIT,
    ZENO_ORBIT,
    EventSequence,
)
from zeno_orbits.work import Columns, TableRepr


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """A check of an orbit by a relative size, its residual, that is zero for a true orbit.

    Attributes:
        law: Statement that is true if the residual is zero.
        failure: Statement that is true if it is not zero.
        plainly: The check for a reader without knowledge of hybrid systems.
    """

    law: str
    failure: str
    plainly: str


CHECKS: Mapping[str, Check] = {
    "release": Check(
        law="gap, gap rate and multiplier are zero at the release",
        failure="gap, gap rate or multiplier is not zero at the release",
        plainly="The motion starts at a release.",
    ),
    "start": Check(
        law="the period starts just after its last event",
        failure="the period does not start just after its last event",
        plainly="The motion starts just after an event.",
    ),
    "first_impact": Check(
        law="the first impact has the time and state of the orbit",
        failure="the first impact differs from the orbit in time or state",
        plainly="The first impact has the time and state of the file.",
    ),
    "impact_sequence": Check(
        law="the later impacts have the times and states of the orbit",
        failure="a later impact differs from the orbit in time or state",
        plainly="The later impacts have the times and states of the file.",
    ),
    "restitution": Check(
        law="every impact multiplies the gap rate by -e",
        failure="an impact does not multiply the gap rate by -e",
        plainly="The rebound speed is a fixed fraction of the impact speed.",
    ),
    "impact_energy": Check(
        law="every impact loses (1 - e^2)/2 m w^2",
        failure="an impact does not lose (1 - e^2)/2 m w^2",
        plainly="Each impact dissipates the predicted energy.",
    ),
    "events": Check(
        law="the event sequence and the switches are those of the orbit",
        failure="the event sequence or a switch differs from the orbit",
        plainly="The events are those of the file, in its order.",
    ),
    "impulses": Check(
        law="no closed stop pulls in an impact",
        failure="a closed stop pulls in an impact",
        plainly="A closed stop does not pull in an impact.",
    ),
    "zeno_point": Check(
        law="the impacts accumulate at the time and state of the orbit",
        failure="the Zeno point differs from the orbit in time or state",
        plainly="The impacts accumulate at the time and state of the file.",
    ),
    "phases": Check(
        law="the other flights start at the times and states of the orbit",
        failure="the start of a later flight differs from the orbit in time or state",
        plainly="Later flights start at the times and states of the file.",
    ),
    "delta_sweep": Check(
        law="cutting the sequence at ever slower impacts tends to the same motion",
        failure="truncation at smaller thresholds tends to another motion",
        plainly="The later the sequence of impacts is truncated, the smaller the effect.",
    ),
    "penetration": Check(
        law="the gap is never negative in flight",
        failure="the gap is negative in flight",
        plainly="The moving part does not pass through the stop.",
    ),
    "adhesion": Check(
        law="the multiplier is never negative on the stop",
        failure="the multiplier is negative on the stop",
        plainly="The stop pushes and does not pull.",
    ),
    "switches": Check(
        law="every formula stays on its branch between the events",
        failure="a formula leaves its branch between the events",
        plainly="Every formula stays on its branch between the events.",
    ),
    "escape": Check(
        law="no coordinate exceeds a divergence limit of the problem",
        failure="a coordinate exceeds a divergence limit of the problem",
        plainly="No state exceeds its limit.",
    ),
    "closure": Check(
        law="the period ends where it starts",
        failure="the period does not end where it starts",
        plainly="After one period the motion is where it started.",
    ),
    "period": Check(
        law="the period agrees with the orbit",
        failure="the period differs from the orbit",
        plainly="The period equals the period of the file.",
    ),
    "drift": Check(
        law="the later periods end where the first period ends",
        failure="a later period does not end where the first period ends",
        plainly="The later simulated periods are like the first.",
    ),
    "energy_balance": Check(
        law="work in = energy gained + copper, friction and impact losses",
        failure="work in differs from energy gained + copper, friction and impact losses",
        plainly="The energy balance of a period closes: input work minus losses is the change "
        "of energy.",
    ),
    "holonomic": Check(
        law="the holonomic constraints hold",
        failure="a holonomic constraint does not hold",
        plainly="The other constraints of the mechanism hold.",
    ),
    "second_model": Check(
        law="a second derivation of the model gives the same flows and resets",
        failure="a second derivation of the model gives other flows or resets",
        plainly="Equations that were derived a second time, independently, agree.",
    ),
    "integration": Check(
        law="a looser integration gives the same return",
        failure="the return changes at a looser tolerance",
        plainly="A less accurate integration gives the same values, within the tolerance.",
    ),
}
"""All checks by the name of their residual.

The order is causal: the first residual that fails explains the later failures.
"""

RESIDUALS: Mapping[str, str] = {name: check.law for name, check in CHECKS.items()}
"""Statement by residual that is true if the residual is zero, in causal order."""


_MISSES = ("closure", "period")
"""Residuals that compare the orbit's data with an integration, for every orbit."""
_STARTS = ("release", "start")
"""The same, of which every orbit has one."""
_MISSES_IF_ANY = ("first_impact", "impact_sequence", "events", "zeno_point", "phases")
"""Such residuals that orbits have by their events."""


_MOST_LISTED = 20
"""Events of an orbit up to which a sentence lists them all."""


def _listed(events: Sequence[str]) -> str:
    """Return the events of an orbit, or the first events of very many."""
    if len(events) <= _MOST_LISTED:
        return ", ".join(events)
    return f"{', '.join(events[:_MOST_LISTED])}, ..., {len(events)} in all"


@dataclass(frozen=True, slots=True, kw_only=True)
class DeltaCut:
    """One truncation of the impact sequence by the paper's rule.

    Attributes:
        delta: Threshold of the impact speed.
        speed: Speed of the impact at which the sequence was truncated.
        error: Relative distance from the completed motion at an equal later time.
    """

    delta: float
    speed: float
    error: float


OPEN_BALANCE = "The energy balance is open: further states act with a force, without powers."
"""Statement in the certificate of a problem whose energy balance cannot be checked."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class OrbitCertificate(TableRepr):
    """Result of the forward integration of an orbit.

    Attributes:
        tolerance: Largest residual that passes.
        residuals: Relative size by name, zero for a true orbit. The names are keys of
            ``RESIDUALS``. A size is infinite if the integration ended earlier.
        margins: Distance to the loss of an event by name, each the least over the period:
            ``gap_acceleration`` (minus d2h/dt2 at a Zeno point), ``first_impact_speed``,
            ``later_impact_speed`` (relative to the speed after the impact before it),
            ``release_transversality`` (minus the rate of the multiplier), ``switch_transversality``
            (minus the rate of the guard), ``locked_time``, ``lets_go`` (d2h/dt2 after a plastic
            impact with immediate release) and ``events_apart`` (time between events).
            ``phases_apart`` is the relative distance of the period from several shorter periods.
        energies: Energy over one period by name [J]: ``input_work``, ``copper_loss``,
            ``other_loss``, ``impact_loss``, ``energy_gain``, and ``switch_loss`` with switches.
        multipliers: Floquet multipliers. Empty if the section is a point, or if they could not be
            computed. In the second case their error is infinite.
        multiplier_error: Estimated error of the largest multiplier.
        delta_sweep: Truncations at decreasing thresholds.
        delta_order: Observed order of the error in the speed of the truncation. NaN without a
            sweep.
        integration_error: Estimated relative error of the returned state.
        zeno_error: Estimated relative error of the Zeno limit. The error of the integration, which
            computes the impacts, is added to it.
        period: Period from the integration [s].
        n_periods: Number of periods that were integrated.
        model: The derivation that was integrated, ``derived`` or ``reference``.
        trouble: Clauses on other failures: the reason why the integration stopped early, an escape
            that was passed, or a false statement in the orbit's data. Empty without failures.
        shape: Claimed shape of an orbit that has one, as text. Else empty.
        asked: Requested bounds of the search, with the measured ranges.
        open_balance: True if a force acts whose powers are not specified by the problem, so that
            the energy balance cannot be checked.
        events: Event sequence of the orbit.
        quantities: Range of each quantity of its events over one period, by name.
        unlisted: Number of resolved impacts before Zeno points that the orbit does not list. They
            are not compared.
    """

    tolerance: float
    residuals: Mapping[str, float]
    margins: Mapping[str, float]
    energies: Mapping[str, float]
    multipliers: tuple[complex, ...]
    multiplier_error: float
    delta_sweep: tuple[DeltaCut, ...]
    delta_order: float
    integration_error: float
    zeno_error: float
    period: float
    n_periods: int
    model: str
    trouble: str = ""
    shape: str = ""
    asked: tuple[Mapping[str, Any], ...] = ()
    open_balance: bool = False
    events: tuple[str, ...] = ()
    quantities: Mapping[str, tuple[float, float]] = field(
        default_factory=dict[str, tuple[float, float]]
    )
    unlisted: int = 0

    def __repr__(self) -> str:
        """Return one line with the verdict and the stability of the orbit."""
        return f"<OrbitCertificate: {self.verdict()} spectral_radius={self.spectral_radius:.6g}>"

    def _columns(self) -> Columns:
        """Return the residuals, in causal order."""
        names = [name for name in RESIDUALS if name in self.residuals]
        return {
            "check": [RESIDUALS[name] for name in names],
            "name": names,
            "residual": [self.residuals[name] for name in names],
            "passed": [self.residuals[name] <= self.tolerance for name in names],
        }

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the residuals above the tolerance, in causal order."""
        return tuple(
            name
            for name in RESIDUALS
            if name in self.residuals and not self.residuals[name] <= self.tolerance
        )

    @property
    def passed(self) -> bool:
        """True if every residual is below the tolerance and every margin positive."""
        return not self.failed and not self.lost and not self.trouble

    @property
    def lost(self) -> tuple[str, ...]:
        """Names of the margins that are not positive."""
        return tuple(name for name, margin in self.margins.items() if not margin > 0.0)

    @property
    def spectral_radius(self) -> float:
        """Largest modulus of a multiplier. NaN if the multipliers could not be computed.

        It is zero if the release section is a point, as for a constrained mass without memory.
        """
        known = 0.0 if math.isfinite(self.multiplier_error) else math.nan
        return max((abs(value) for value in self.multipliers), default=known)

    @property
    def stable(self) -> bool:
        """True if the multipliers, with their error, are inside the unit circle."""
        return self.spectral_radius + self.multiplier_error < 1.0

    @property
    def unstable(self) -> bool:
        """True if a multiplier is outside the unit circle by more than its error."""
        return self.spectral_radius - self.multiplier_error > 1.0

    @property
    def _kind(self) -> str:
        shape = EventSequence.parsed(self.shape) if self.shape else None
        if shape is None:
            what = f"{self._kind_of_events} (events: {_listed(self.events)})"
        else:
            what = shape.described
        if self.stable:
            return f"a stable {what}"
        if self.unstable:
            return f"an unstable {what}"
        return f"a {what} of unknown stability"

    @property
    def _kind_of_events(self) -> str:
        if not any(name.startswith("zeno ") for name in self.events):
            return NO_ZENO_ORBIT
        longest = [high for name, (_, high) in self.quantities.items() if "bounce_time" in name]
        return SIMPLE_ORBIT if longest and max(longest) == 0.0 else ZENO_ORBIT

    @property
    def orbit_error(self) -> float:
        r"""Estimated relative error of all values of the orbit.

        If a return differs from its start by `d`, the fixed point is :math:`d / |1 - \mu|` away,
        with the multiplier :math:`\mu`. The error is infinite if the return or the multipliers
        could not be computed.
        """
        misses = [self.residuals.get(name, math.inf) for name in _MISSES]
        misses += [self.residuals[name] for name in _MISSES_IF_ANY if name in self.residuals]
        starts = [self.residuals[name] for name in _STARTS if name in self.residuals]
        misses += starts or [math.inf]
        if not all(map(math.isfinite, (*misses, self.integration_error, self.multiplier_error))):
            return math.inf
        # The Zeno point and the period have their own errors, however stable the orbit is.
        least = min([1.0, *(abs(1.0 - mu) for mu in self.multipliers)])
        miss = max(misses) + self.integration_error
        return miss / least if least > 0.0 else math.inf

    def verdict(self) -> str:
        """Return the verdict in one sentence, with the residual that explains a failure."""
        if self.passed:
            worst = max(self.residuals.values(), default=0.0)
            opened = f" {OPEN_BALANCE}" if self.open_balance else ""
            return f"Verified: {self._kind}; largest residual {worst:.1e}.{opened}"
        if self.failed:
            name = self.failed[0]
            size = f"`{name}` = {self.residuals[name]:.1e} exceeds {self.tolerance:.0e}"
            reason = f"{size} ({CHECKS[name].failure})"
        elif self.trouble:
            reason = self.trouble
        else:
            name = self.lost[0]
            reason = f"the margin `{name}` = {self.margins[name]:.1e} is not positive"
        tail = f"; {self.trouble}" if self.trouble and self.failed else ""
        return f"Refused: {reason}{tail}."

    def as_json(self) -> dict[str, Any]:
        """Return the certificate as plain data. Values that are not finite become ``null``."""
        return {
            "passed": self.passed,
            "stable": self.stable,
            "verdict": self.verdict(),
            "failed": list(self.failed),
            "tolerance": self.tolerance,
            "residuals": _finite(self.residuals),
            "margins": _finite(self.margins),
            "energies": _finite(self.energies),
            "floquet_multipliers": [[mu.real, mu.imag] for mu in self.multipliers],
            "multiplier_error": _number(self.multiplier_error),
            "delta_sweep": [
                {"delta": cut.delta, "speed": _number(cut.speed), "error": _number(cut.error)}
                for cut in self.delta_sweep
            ],
            "delta_order": _number(self.delta_order),
            "integration_error": _number(self.integration_error),
            "zeno_error": _number(self.zeno_error),
            "period": _number(self.period),
            "n_periods": self.n_periods,
            **({"shape": self.shape} if self.shape else {}),
            **({"events": list(self.events)} if self.events else {}),
            "model": self.model,
            "trouble": self.trouble,
            "asked": [dict(one) for one in self.asked],
            **({"open_balance": True} if self.open_balance else {}),
            **({"unlisted": self.unlisted} if self.unlisted else {}),
            **({"quantities": self._ranges()} if self.events else {}),
        }

    def _ranges(self) -> dict[str, list[float]]:
        return {name: list(ends) for name, ends in self.quantities.items()}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _finite(values: Mapping[str, float]) -> dict[str, float | None]:
    return {name: _number(value) for name, value in values.items()}
