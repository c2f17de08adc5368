"""Known orbits, and the recognition of a motion that converges to a known orbit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.maps.approach import Accuracy
from zeno_orbits.maps.attractors import ORBITS, Attractor
from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import orbit_event_name
from zeno_orbits.simulation import MotionEnd, scale_of, state_after, watched_motion

_NEAR = 0.01
"""Distance from an orbit, in units of `1 - rho`, below which the return map is nearly linear."""
_PART = 0.25
"""Required relative decrease of the distance over a period, in units of `1 - rho`."""
_CLOSED = 1e-5
"""Relative distance from its start below which an orbit is closed."""
_SOON = 1e-6
"""Part of a period within which a crossing belongs to the start."""
_PATIENCE = 4
"""Crossings after a period during which a motion near a known orbit is not tested in other ways."""
_SAME_PERIOD, _SAME_STATE = 1e-6, 1e-4
"""Relative difference of periods and states below which two orbits are the same."""


@dataclass(frozen=True, kw_only=True)
class KnownOrbit:
    r"""A stable orbit for comparison with motions.

    Attributes:
        attractor: The orbit.
        section: Name of the event of the section.
        states: States of the orbit on the section over a period, ``(n, n_x)``.
        scale: Size of each state, ``(n_x,)``.
        rate: Spectral radius :math:`\rho` of the return map.
    """

    attractor: Attractor
    section: str
    states: tuple[tuple[float, ...], ...]
    scale: tuple[float, ...]
    rate: float

    @property
    def period(self) -> float:
        """Period of the orbit [s]."""
        return self.attractor.period

    @property
    def near(self) -> float:
        """Relative distance below which a motion may converge to the orbit."""
        return _NEAR * (1.0 - self.rate)

    def distances(self, state: Vector) -> Vector:
        """Return the relative distance of a state from each state of the orbit, ``(n,)``."""
        states, scale = self._arrays
        return np.max(np.abs(states - state) / scale, axis=1)

    @cached_property
    def _arrays(self) -> tuple[Vector, Vector]:
        return np.array(self.states), np.array(self.scale)

    def passes(self, state: Vector) -> bool:
        """Return True if a state on the section is a state of the orbit."""
        return bool(np.min(self.distances(state)) < _SAME_STATE)


@dataclass(slots=True, kw_only=True)
class Recognition:
    r"""The crossings of a motion near one known orbit.

    A motion converges to the orbit if it satisfies two conditions. All crossings of a period are
    nearer than 1 % of :math:`1 - \rho`, in the orbit's order. The period reduces the distance by a
    quarter of the rate :math:`1 - \rho`, or to the accuracy of the motion.

    Attributes:
        orbit: The orbit.
        reached: Relative distance within the accumulated local errors.
        passed: Index on the orbit and distance of the last crossings, all near the orbit.
    """

    orbit: KnownOrbit
    reached: float
    passed: list[tuple[int, float]] = field(default_factory=list[tuple[int, float]])

    def sees(self, state: Vector) -> bool:
        """Record a crossing, and return True if the motion converges to the orbit."""
        away = self.orbit.distances(state)
        place = int(np.argmin(away))
        n, distance = len(away), float(away[place])
        if not distance < self.orbit.near:
            self.passed.clear()
            return False
        if self.passed and place != (self.passed[-1][0] + 1) % n:
            self.passed.clear()
        self.passed.append((place, distance))
        if len(self.passed) <= n:
            return False
        shrinks = 1.0 - _PART * (1.0 - self.orbit.rate)
        return distance <= max(shrinks * self.passed[-1 - n][1], self.reached)

    @property
    def may_see(self) -> bool:
        """True if the next crossings may show that the motion converges to the orbit."""
        return 0 < len(self.passed) <= len(self.orbit.states) + _PATIENCE


def known_orbit(
    graph: GraphDynamics,
    units: Sequence[str],
    attractor: Attractor,
    starts: Sequence[str],
    accuracy: Accuracy,
) -> KnownOrbit | None:
    """Return an attractor as a known orbit, or ``None`` if it is not usable.

    An orbit is usable if its multipliers are known and below one, and if it has events.

    Args:
        graph: The graph of modes.
        units: Unit of each state.
        attractor: The attractor.
        starts: Events of which the period of an attractor without an event sequence starts at the
            first that occurs.
        accuracy: Accuracy of the simulation.
    """
    if attractor.fate not in ORBITS or not attractor.spectral_radius < 1.0:
        return None
    start = np.array([attractor.state[name] for name in graph.state_names])
    period, found = attractor.period, dict[str, list[Vector]]()
    pieces = watched_motion(graph, start, until=1.05 * period, error=accuracy.orbit, goes_on=True)
    for piece in pieces:
        for event in () if isinstance(piece, MotionEnd) else piece.events:
            if _SOON * period < event.time < (1.0 + _SOON) * period:
                found.setdefault(orbit_event_name(event), []).append(state_after(event))
    section = next((one for one in (*attractor.sequence[-1:], *starts) if one in found), "")
    states = found.get(section, [])
    if not states:
        return None
    scale = scale_of(states, units, graph.own.states(len(start)))
    if not float(np.max(np.abs(states[-1] - start) / scale)) < _CLOSED:
        return None
    return KnownOrbit(
        attractor=attractor,
        section=section,
        states=tuple(tuple(np.asarray(state).tolist()) for state in states),
        scale=tuple(scale.tolist()),
        rate=attractor.spectral_radius,
    )


def distinct_orbits(orbits: Sequence[KnownOrbit]) -> tuple[KnownOrbit, ...]:
    """Return the orbits without repetitions, numbered if several orbits have the same phrase."""
    found: list[KnownOrbit] = []
    for orbit in orbits:
        if not any(is_same(orbit, other) for other in found):
            found.append(orbit)
    phrases = [orbit.attractor.phrase for orbit in found]
    numbered: list[KnownOrbit] = []
    for k, (orbit, phrase) in enumerate(zip(found, phrases, strict=True)):
        number = phrases[: k + 1].count(phrase) if phrases.count(phrase) > 1 else 0
        numbered.append(replace(orbit, attractor=replace(orbit.attractor, number=number)))
    return tuple(numbered)


def is_same(one: KnownOrbit, other: KnownOrbit) -> bool:
    """Return True if two orbits are the same, for any start of their periods."""
    alike = [(orbit.section, len(orbit.states)) for orbit in (one, other)]
    if alike[0] != alike[1]:
        return False
    period = other.attractor.period
    if not math.isclose(one.attractor.period, period, rel_tol=_SAME_PERIOD):
        return False
    return other.passes(np.array(one.states[-1]))


def returns_to(orbit: KnownOrbit, reached: Attractor, names: Sequence[str]) -> bool:
    """Return True if the attractor of a motion is a known orbit.

    Args:
        orbit: The orbit.
        reached: The attractor, recognized as the known orbit or found independently.
        names: Name of each state.
    """
    if reached == orbit.attractor:
        return True
    if reached.fate is not orbit.attractor.fate or not reached.state:
        return False
    if not math.isclose(reached.period, orbit.attractor.period, rel_tol=_SAME_PERIOD):
        return False
    return orbit.passes(np.array([reached.state[name] for name in names]))
