"""The extreme of a state over an orbit, in the unknowns of a program."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.search.transcription.arc import Stretch
from zeno_orbits.search.transcription.transcribe import OrbitTerms
from zeno_orbits.simulation.execution import Arc


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """Where the guess has its extreme value: an interval of a stretch and a place in it."""

    stretch: Stretch
    interval: int
    place: float


def summit(terms: OrbitTerms, index: int, sign: float) -> ca.MX:
    """Return the largest value of a state (smallest, if ``sign`` is -1) over the orbit.

    Inside an interval it is where the derivative of the collocation polynomial vanishes, and the
    place is an unknown; at an impact, where the rate may turn round, it is a node.
    """
    highest = max(
        (_highest_place(stretch, index, sign) for stretch in terms.stretches),
        key=lambda found: found[0],
    )[1]
    n = terms.scheme.n_stages
    first = highest.interval * n
    start = highest.stretch.start if first == 0 else highest.stretch.stages[:, first - 1]
    values = ca.horzcat(start[index], highest.stretch.stages[index, first : first + n])
    if highest.place in (0.0, 1.0):
        return values[0, 0] if highest.place == 0.0 else values[0, -1]
    label = "highest" if sign > 0 else "lowest"
    name = f"place where {terms.state_names[index]} is {label}"
    place = terms.program.variable(name, highest.place, lower=-0.5, upper=1.5)
    points = np.concatenate([[0.0], terms.scheme.nodes])
    height = ca.mtimes(values, _basis(points, place))
    slope = ca.jacobian(height, place)
    size = float(np.max(np.abs([_value(highest.stretch.arc, index, f) for f in (0.0, 0.5, 1.0)])))
    terms.program.equal(
        f"{terms.state_names[index]} is {label} there", slope, scale=max(size, 1e-3)
    )
    return height


def _highest_place(stretch: Stretch, index: int, sign: float) -> tuple[float, _Place]:
    """Return the extreme of the guess over a stretch, and where it is."""
    fractions = np.linspace(0.0, 1.0, 400 if stretch.arc.duration > 0 else 1)
    values = [sign * _value(stretch.arc, index, float(fraction)) for fraction in fractions]
    best = int(np.argmax(values))
    at = float(fractions[best])
    interval = int(np.clip(np.searchsorted(stretch.mesh, at) - 1, 0, len(stretch.mesh) - 2))
    left, right = stretch.mesh[interval], stretch.mesh[interval + 1]
    place = 0.0 if best == 0 else 1.0 if best == len(values) - 1 else (at - left) / (right - left)
    return values[best], _Place(stretch=stretch, interval=interval, place=float(place))


def _value(arc: Arc, index: int, fraction: float) -> float:
    state: Vector = arc.flow_state_at(fraction * arc.duration)
    return float(state[index])


def _basis(points: Vector, place: ca.MX) -> ca.MX:
    """Return the Lagrange basis of the points at a place, ``(n_points, 1)``."""
    entries: list[ca.MX] = []
    for k, point in enumerate(points):
        entry = ca.MX(1)
        for j, other in enumerate(points):
            if j != k:
                entry *= (place - float(other)) / float(point - other)
        entries.append(entry)
    return ca.vertcat(*entries)
