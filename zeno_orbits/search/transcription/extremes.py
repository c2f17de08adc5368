"""The extreme of a state over an orbit, in the unknowns of a program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import lagrange_basis
from zeno_orbits.search.transcription.arc import CollocatedArc
from zeno_orbits.search.transcription.transcribe import OrbitTerms
from zeno_orbits.simulation import Arc


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """Where the guess has its extreme value: an interval of an arc and a place in it."""

    arc: CollocatedArc
    interval: int
    place: float


def extreme(terms: OrbitTerms, index: int, sign: float) -> ca.MX:
    """Return the largest value of a state (smallest, if ``sign`` is -1) over the orbit.

    Inside an interval it is where the derivative of the collocation polynomial vanishes, and the
    place is an unknown; at an impact, where the rate may turn round, it is a node.

    Args:
        terms: The transcribed orbit.
        index: Place of the state among the states.
        sign: 1 for the largest value, -1 for the smallest.
    """
    found = max(
        (_highest_place(arc, index, sign) for arc in terms.arcs),
        key=lambda pair: pair[0],
    )[1]
    n = terms.scheme.n_stages
    first = found.interval * n
    start = found.arc.start if first == 0 else found.arc.stages[:, first - 1]
    values = ca.horzcat(start[index], found.arc.stages[index, first : first + n])
    if found.place in (0.0, 1.0):
        return values[0, 0] if found.place == 0.0 else values[0, -1]
    label = "highest" if sign > 0 else "lowest"
    name = f"place where {terms.state_names[index]} is {label}"
    place = terms.program.variable(name, found.place, lower=-0.5, upper=1.5)
    points = np.concatenate([[0.0], terms.scheme.nodes])
    basis = cast("ca.MX", ca.vertcat(*lagrange_basis(points.tolist(), place)))
    height = ca.mtimes(values, basis)
    slope = ca.jacobian(height, place)
    name = f"{terms.state_names[index]} is {label} there"
    terms.program.equal(name, slope, scale=float(terms.scale[index]))
    return height


def _highest_place(arc: CollocatedArc, index: int, sign: float) -> tuple[float, _Place]:
    """Return the extreme of the guess over an arc, and where it is."""
    fractions = np.linspace(0.0, 1.0, 400 if arc.guess.duration > 0 else 1)
    values = [sign * _value(arc.guess, index, float(fraction)) for fraction in fractions]
    best = int(np.argmax(values))
    at = float(fractions[best])
    interval = int(np.clip(np.searchsorted(arc.mesh, at) - 1, 0, len(arc.mesh) - 2))
    left, right = arc.mesh[interval], arc.mesh[interval + 1]
    place = 0.0 if best == 0 else 1.0 if best == len(values) - 1 else (at - left) / (right - left)
    return values[best], _Place(arc=arc, interval=interval, place=float(place))


def _value(arc: Arc, index: int, fraction: float) -> float:
    state: Vector = arc.flow_state_at(fraction * arc.duration)
    return float(state[index])
