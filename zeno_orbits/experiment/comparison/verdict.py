"""The verdict on a recording: this orbit, one with other values, none, or not decidable."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.contact_fit import ContactFit
from zeno_orbits.experiment.comparison.metrics import Metric
from zeno_orbits.experiment.orbit_table import OrbitTable, PeriodTable

_CHANCE = 1e-3
"""Chance by which noise alone makes some quantity of the orbit itself differ."""
_FINEST = 1e-4
"""A quantity differs by at least this part of its size: better instruments do not exist."""
_SHARE, _LEAST = 0.25, 0.02
"""A contact phase lasts at least these parts of the orbit's own and of the period."""
_MISFIT = 0.012
"""Largest root mean square of the periodic residual between a machine's gap and the fit of flights,
impacts and contact, relative to the range."""
_UNLIKE = 0.25
"""Part of the square of a rebound that its shape leaves unexplained at most."""
_REBOUND, _ELASTIC = 0.02, 0.98
"""Least and greatest restitution of impacts that decay."""


class ComparisonVerdict(Enum):
    """Verdict on a recording. The value is the word in JSON."""

    THIS_ORBIT = "this orbit"
    OTHER_VALUES = "other values"
    NO_ORBIT = "no orbit"
    UNDECIDED = "undecided"

    @property
    def shows_orbit(self) -> bool:
        """True if the recording shows the orbit, or one of the machine with other values."""
        return self in {ComparisonVerdict.THIS_ORBIT, ComparisonVerdict.OTHER_VALUES}


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Result of the test of a recording's contacts.

    Attributes:
        reasons: Reasons why the contacts do not match a Zeno orbit, most serious first.
        unresolved: Reasons why the samples are inconclusive.
        unseen: Reasons why the contacts are not seen, so that signals alone must agree.
    """

    reasons: tuple[str, ...] = ()
    unresolved: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()


def contact_finding(found: ContactFit | None, table: OrbitTable, time: Vector) -> Finding:
    """Test whether contacts match a Zeno orbit: contact phase and decaying impacts.

    Args:
        found: The contacts, or ``None`` if the gap lacks a resting level.
        table: The orbit.
        time: Times of the recording, ``(n_t,)`` [s].
    """
    own = table.period - table.zeno_time
    step = float(np.median(np.diff(time)))
    if found is None:
        if own < 12.0 * step:
            return Finding(unseen=(_too_few("the contact phase", own, step),))
        return Finding(reasons=("no contact phase is seen: the gap never rests at its lowest",))
    resolved = found.resolved
    if not resolved.contact:
        return Finding(unresolved=(_too_few("the contact phase", own, step),))
    if found.resting < max(_SHARE * own, _LEAST * table.period):
        seen = f"the gap rests for {found.resting:.3g} s at most"
        return Finding(reasons=(f"no contact phase is seen: {seen}, the orbit's for {own:.3g} s",))
    if not (resolved.flight and found.speed.known):
        why = _too_few("the flight before the impact", table.first_impact, step)
        return Finding(unresolved=(why,))
    return _decay(found, table, step)


def _decay(found: ContactFit, table: OrbitTable, step: float) -> Finding:
    """Test whether the gap consists of flights with decaying impacts, and contact."""
    times = [one.time for one in table.impacts]
    rebounds = len(times) > 1
    bounce, resolved = found.restitution, found.resolved
    none = "no decaying sequence of impacts is seen"
    if found.misfit > _MISFIT:
        left = f"{100 * found.misfit:.2g} % of its range are left"
        what = "the gap does not move in flight, impacts and contact that opens smoothly"
        return Finding(reasons=(f"{what} ({left})",))
    if not found.speed.value < 0.0:
        return Finding(reasons=(f"{none}: the gap does not fall onto the stop",))
    if rebounds and not (bounce.known and bounce.value > max(_REBOUND, 2.0 * bounce.error)):
        if resolved.short_rebounds:
            return Finding(reasons=(f"{none}: the gap does not rebound from its first impact",))
        length = times[1] - times[0]
        return Finding(unresolved=(_too_few("the first rebound", length, step),))
    if rebounds and found.rebound_share > _UNLIKE:
        return Finding(reasons=(f"{none}: no rebound follows the first impact",))
    if rebounds and bounce.value - 2.0 * bounce.error > _ELASTIC:
        return Finding(reasons=(f"{none}: rebounds do not slow down ({bounce.value:.3g})",))
    if found.contact.known and found.contact.value < 2.0 * found.contact.error:
        return Finding(reasons=("no contact phase is seen: rebounds last until the release",))
    return Finding()


def _too_few(what: str, length: float, step: float) -> str:
    return (
        f"{what} is not resolved: it lasts {length:.3g} s in the orbit, samples are {step:.3g} s "
        f"apart"
    )


def differing(
    metrics: Sequence[Metric], table: PeriodTable, signals: Sequence[str]
) -> tuple[Metric, ...]:
    """Return the quantities that differ from the orbit's beyond their errors and chance.

    Args:
        metrics: All quantities.
        table: The orbit.
        signals: Names of the recorded signals, in the order of the table.
    """
    # A number of bounces that is equal in all cycles has no error.
    measured = [one for one in metrics if one.error > 0.0 or one.name.endswith(".bounces")]
    found = _beyond_chance(measured, lambda one: _size(one, table, signals))
    # Quantities before distances, which only repeat that something differs.
    return tuple(sorted(found, key=lambda one: "deviation" in one.name or "distance" in one.name))


def _beyond_chance(
    metrics: Sequence[Metric], size: Callable[[Metric], float]
) -> tuple[Metric, ...]:
    """Return the known quantities that differ from the orbit's beyond their errors and chance.

    Args:
        metrics: All quantities. Those without a value or an error are left out.
        size: Function from a quantity to its size.
    """
    known = [one for one in metrics if math.isfinite(one.data) and one.error >= 0.0]
    if not known:
        return ()
    from scipy.special import ndtri

    most = -float(ndtri(_CHANCE / 2.0 / len(known)))
    return tuple(
        one
        for one in known
        if abs(one.data - one.orbit) > max(one.largest_error(most), _FINEST * size(one))
    )


def _size(one: Metric, table: PeriodTable, signals: Sequence[str]) -> float:
    """Return the size of a quantity: of times the period, of signals their range."""
    if one.unit == "s":
        return table.period
    for k, name in enumerate(signals):
        if one.name.endswith(f" of {name}"):
            values = table.nodes.values[:, k]
            return float(np.ptp(values) or np.max(np.abs(values)) or 1.0)
    if one.name == "gap in contact":
        return float(np.ptp(table.nodes.values[:, -1]))
    return max(abs(one.orbit), 1.0 if one.unit == "1" else 0.0)
