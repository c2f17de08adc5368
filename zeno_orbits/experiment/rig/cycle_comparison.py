"""Comparison of a machine's cycles with the orbit of its model, quantity by quantity."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.polyline import line_distances
from zeno_orbits.experiment.rig.cycles import RigCycle, SettledRig
from zeno_orbits.experiment.rig.default_stop import DEEP
from zeno_orbits.experiment.rig.run import RigRun
from zeno_orbits.model import Problem, unit_quotient
from zeno_orbits.orbits import Orbit
from zeno_orbits.simulation import simulate

_POINTS = 400
"""Points on every arc of the orbit. The chords between them have a relative error of 1e-5."""
_FEWEST = 4
"""Smallest number of cycles from which a trend can be distinguished from chance."""
_CHANCE = 1e-4
"""How often a number without a trend is mistaken for one that has it."""
_SCATTER = 0.02
"""Scatter of settled cycles at most, in parts of the period."""
_AWAY = 0.8
"""Distance of settled cycles from the orbit at most, in parts of its size."""
_WORTH = 1e-2
"""A trend over all the cycles is worth telling from this part of the orbit's number on."""
_RESOLVED = 2.0
"""Sampling times of a contact of which two samples are sure."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleNumbers:
    """Characteristic values of one cycle, either of a machine or of the orbit of its model.

    Attributes:
        impact_time: First contact, or first impact, from release [s].
        impact_rate: Gap rate there.
        lock_time: End of the chatter, or Zeno time, from release [s].
        lock_angle: Coordinate that the problem measures amplitudes of, there.
        period: [s].
    """

    impact_time: float
    impact_rate: float
    lock_time: float
    lock_angle: float
    period: float


def numbers_of_orbit(orbit: Orbit, problem: Problem) -> CycleNumbers:
    """Return the characteristic quantities of an orbit of the model."""
    dynamics = problem.dynamics(orbit.values(problem))
    first = orbit.impacts[0]
    return CycleNumbers(
        impact_time=first.time,
        impact_rate=dynamics.gap_rate(np.array(problem.state_vector(first.state_minus))),
        lock_time=orbit.zeno_time,
        lock_angle=orbit.zeno_state[problem.amplitude_of],
        period=orbit.period,
    )


def numbers_of_cycle(cycle: RigCycle, problem: Problem) -> CycleNumbers:
    """Return the characteristic quantities of a cycle of a machine."""
    return CycleNumbers(
        impact_time=cycle.impact.start - cycle.release,
        impact_rate=cycle.impact.approach_rate,
        lock_time=cycle.lock - cycle.release,
        lock_angle=float(cycle.lock_state[problem.state_names.index(problem.amplitude_of)]),
        period=cycle.period,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OrbitCurve:
    """An orbit as a closed line in the space of its states.

    Attributes:
        times: Times since the release, ``(n,)`` [s].
        states: States, ``(n, n_x)``, connected by straight lines.
        ranges: Range of every state along the orbit, ``(n_x,)``, 1 if it is constant.
    """

    times: Vector
    states: Vector
    ranges: Vector

    def distances(self, states: Vector) -> Vector:
        """Return the distance of points from the line, in states over their ranges, ``(m,)``."""
        return line_distances(self.states / self.ranges, states / self.ranges)


def orbit_curve(orbit: Orbit, problem: Problem, *, n_per_arc: int = 1500) -> OrbitCurve:
    """Return an orbit as a line, made by simulating one period of it.

    Args:
        orbit: The orbit.
        problem: Its problem.
        n_per_arc: Points on every arc. With 1500 points the chords have a relative error of about
            1e-6.
    """
    dynamics = problem.dynamics(orbit.values(problem))
    start = problem.state_vector(orbit.release_state)
    times, states = simulate(dynamics, start, until=orbit.period).sampled(n_per_arc)
    spans = np.ptp(states, axis=0)
    ranges = np.where(spans > 0.0, spans, 1.0)
    return OrbitCurve(times=times, states=states, ranges=ranges)


@dataclass(frozen=True, slots=True, kw_only=True)
class RigComparison:
    """A machine's cycles against an orbit.

    Attributes:
        problem: Name of the problem.
        cycles: Number of cycles.
        orbit: Characteristic quantities of the orbit.
        mean: Mean of the same quantities over the machine's cycles.
        spread: Standard deviation of the quantities over the cycles. It is 0 for one cycle.
        drifting: Names of the quantities that still drift, or ``None`` for too few cycles.
        portrait: Largest distance of the machine from the curve of the orbit, in states over their
            ranges.
        portrait_at: When, as a part of the cycle from release on.
        units: Unit of every quantity.
        penetration: Largest penetration of the stop.
        warnings: Why the machine may differ from a model with a hard stop.
        unlike: Reasons why the cycles are not of the orbit's kind. It is empty if they are.
    """

    problem: str
    cycles: int
    orbit: CycleNumbers
    mean: CycleNumbers
    spread: CycleNumbers
    drifting: tuple[str, ...] | None
    portrait: float
    portrait_at: float
    units: Mapping[str, str]
    penetration: float
    warnings: tuple[str, ...] = ()
    unlike: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Return it as plain data, labelled as simulated."""
        return {"source": "simulated", **asdict(self)}


def compare_cycles(orbit: Orbit, problem: Problem, settled: SettledRig) -> RigComparison:
    """Compare the cycles of a settled machine with an orbit.

    Args:
        orbit: The orbit.
        problem: Its problem.
        settled: The machine.
    """
    rows = [asdict(numbers_of_cycle(cycle, problem)) for cycle in settled.cycles]
    table = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    wanted = numbers_of_orbit(orbit, problem)
    curve = orbit_curve(orbit, problem, n_per_arc=_POINTS)
    last = settled.cycles[-1]
    part = settled.run.between(last.release, last.end)
    away = curve.distances(part.states[:, : len(problem.state_names)])
    farthest = int(np.argmax(away))
    angle = problem.state_units[problem.state_names.index(problem.amplitude_of)]
    return RigComparison(
        problem=problem.name,
        cycles=len(rows),
        orbit=wanted,
        mean=CycleNumbers(**{name: float(np.mean(column)) for name, column in table.items()}),
        spread=CycleNumbers(**{name: float(np.std(column)) for name, column in table.items()}),
        drifting=_drifting(table, asdict(wanted)) if len(rows) >= _FEWEST else None,
        portrait=float(away[farthest]),
        portrait_at=float((part.times[farthest] - last.release) / last.period),
        units={
            **dict.fromkeys(("impact_time", "lock_time", "period"), "s"),
            "impact_rate": unit_quotient(problem.gap_unit, "s"),
            "lock_angle": angle,
        },
        penetration=float(max(-np.min(settled.run.gap), 0.0)),
        warnings=penetration_warnings(settled.run, problem),
        unlike=_unlike(table, wanted, float(away[farthest])),
    )


def _unlike(table: Mapping[str, Vector], orbit: CycleNumbers, away: float) -> tuple[str, ...]:
    """Return the reasons why cycles do not match the orbit: large scatter or large distance."""
    reasons: list[str] = []
    for name, what in (("period", "periods"), ("impact_time", "first impacts")):
        spread = float(np.std(table[name]))
        if spread > _SCATTER * orbit.period:
            reasons.append(f"{what} scatter by {100 * spread / orbit.period:.2g} % of the period")
    if away > _AWAY:
        reasons.append(f"the machine is {away:.2g} times the orbit's size away from it")
    return tuple(reasons)


def penetration_warnings(run: RigRun, problem: Problem) -> tuple[str, ...]:
    """Return a warning if the penetration exceeds a hundredth of the largest gap."""
    depth, height = -float(np.min(run.gap, initial=0.0)), float(np.max(run.gap, initial=0.0))
    if depth <= DEEP * height:
        return ()
    share = f"{100 * depth / height:.2g} % of the highest gap" if height > 0.0 else "all the time"
    found = f"the stop gives way by {depth:.2g} {problem.gap_unit}, {share}"
    return (f"{found}: a stiffer stop needs a larger --part contact.stiffness",)


def sampling_warnings(run: RigRun) -> tuple[str, ...]:
    """Return a warning if the samples of a run may miss contacts.

    A contact that is shorter than two sampling times may have a single sample, or none.

    Args:
        run: The run.
    """
    times = run.record.times
    if len(times) < 2:
        return ()
    step = float(np.median(np.diff(times)))
    begin, end = float(times[0]), float(times[-1])
    lasts = {t.end - t.start: t.stop for t in run.touches if begin <= t.start and t.end <= end}
    shortest = min(lasts, default=math.inf)
    if shortest >= _RESOLVED * step:
        return ()
    found = f"a contact of `{lasts[shortest]}` lasts {shortest:.2g} s, and samples are {step:.2g} s"
    option = "--rate" if run.rig.controller is None else "--part controller.period"
    wanted = f"{_RESOLVED / shortest:.2g} samples a second resolve it ({option})"
    return (f"{found} apart, so its channel may miss contacts: {wanted}",)


def drift(values: Vector) -> tuple[float, float]:
    """Return the change of a sequence along its fitted straight line, and the bound for chance.

    The bound is the quantile of Student's distribution that independent values without a trend
    exceed once in 10 000 cases.

    Args:
        values: Three or more values, ``(n,)``.
    """
    from scipy.special import stdtrit

    n = len(values)
    k = np.arange(n) - (n - 1) / 2
    slope = float(k @ values / (k @ k))
    left = values - np.mean(values) - slope * k
    error = float(np.sqrt(left @ left / (n - 2) / (k @ k)))
    return slope * (n - 1), error * (n - 1) * float(stdtrit(n - 2, 1 - _CHANCE / 2))


def _drifting(table: Mapping[str, Vector], orbit: Mapping[str, float]) -> tuple[str, ...]:
    found: list[str] = []
    for name, column in table.items():
        change, chance = drift(column)
        if abs(change) > max(chance, _WORTH * abs(orbit[name])):
            found.append(name)
    return tuple(found)
