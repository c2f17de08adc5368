r"""Parts of a machine that supply energy although their kind takes it: signs that are often wrong.

Damping takes :math:`-v^\top (F(q, v) - F(q, 0)) \ge 0`, resistances take :math:`i^\top R\,i \ge 0`,
and a motor takes as much electrical power :math:`i^\top K_\omega w` as it returns in torque,
:math:`w^\top K_\varphi\,i`, if :math:`K_\omega = K_\varphi^\top` (theory (1.10)). Dry friction
takes :math:`T\,|r|`, where :math:`T \ge 0`. Constants are compared by form. Other formulas are
evaluated at states: a supply that is found is a fact, and one that is not found proves nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model.problem import ParameterValues, Problem, system_in_symbols

_SAMPLES = 256
"""Number of states at which formulas that change with the state are evaluated."""
_PARTS = (1e-4, 0.01, 0.1, 1.0)
"""Speeds of these states, relative to their characteristic scales."""
_ROUNDING = 1e-9
"""Power that is rounding, relative to the sum of the powers of all coordinates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EnergySource:
    """A part of a machine that supplies energy.

    Attributes:
        part: Argument of the model, such as ``passive_force``.
        reason: Sentence with the values that show it.
    """

    part: str
    reason: str

    @property
    def text(self) -> str:
        """The part and the reason as one sentence."""
        return f"`{self.part}` supplies energy: {self.reason}."


def energy_sources(problem: Problem, values: ParameterValues) -> tuple[EnergySource, ...]:
    """Return the parts of a machine that supply energy although their kind takes it.

    Args:
        problem: The problem.
        values: Values of its gains and parameters.
    """
    system, symbols = system_in_symbols(problem)
    keys, numbers = list(symbols.values()), [ca.SX(values.number(name)) for name in symbols]

    def known(formula: ca.SX) -> ca.SX:
        return ca.substitute([ca.SX(formula)], keys, numbers)[0]

    states = _states(problem, values)
    found = list[EnergySource]()
    q, v = system.bare.q, system.bare.v
    found += _by_damping(problem, known(system.bare.passive_force), q, v, states)
    drive = system.drive
    for part in drive.joins or (drive,):
        entries = {name: known(formula) for name, formula in part.entries}
        found += _by_motors(entries)
        for name, unit in (("resistance", "ohm"), ("conductance", "1/ohm")):
            found += _by_resistance(name, unit, entries)
    torques = map(known, ca.vertsplit(drive.torques))
    for name, torque in zip(drive.frictions, torques, strict=True):
        found += _by_friction(
            name, ca.Function("torque", [system.state], [torque]), states, problem
        )
    return tuple(found)


def _states(problem: Problem, values: ParameterValues) -> Vector:
    """Return states around the starts, slow and fast ones, ``(n, n_x)``."""
    starts = np.array(problem.admissible_starts(values))
    n_x = starts.shape[1]
    graph = problem.graph_dynamics(values)
    sizes = graph.own.states(n_x)
    random = np.random.default_rng(0)
    rows = starts[random.integers(len(starts), size=_SAMPLES)]
    rows = rows + 0.5 * sizes * random.uniform(-1.0, 1.0, rows.shape)
    velocity = slice(graph.n_q, 2 * graph.n_q)
    part = np.resize(_PARTS, _SAMPLES)[:, None]
    speeds = random.uniform(-1.0, 1.0, (_SAMPLES, graph.n_q))
    rows[:, velocity] = part * sizes[velocity] * speeds
    return rows


def _by_damping(
    problem: Problem, force: ca.SX, q: ca.SX, v: ca.SX, states: Vector
) -> list[EnergySource]:
    """Return the passive force if it supplies power by its dependence on velocity."""
    force = force - ca.substitute(force, v, ca.SX.zeros(v.numel()))
    damping = -ca.jacobian(force, v)
    if not ca.depends_on(damping, ca.vertcat(q, v)) and not ca.symvar(damping):
        weights, axes = np.linalg.eigh(_symmetric(damping))
        if not weights[0] < -_ROUNDING * np.max(np.abs(weights)):
            return []
        velocity = axes[:, 0] / axes[np.argmax(np.abs(axes[:, 0])), 0]
        power, at = -float(velocity @ _symmetric(damping) @ velocity), velocity
        shown = _named(problem.state_names[len(at) : 2 * len(at)], at)
    else:
        powers = ca.Function("powers", [q, v], [force * v], {"allow_free": False})
        n = v.numel()
        rows: Vector = np.array([_row(powers, x[:n], x[n : 2 * n]) for x in states])
        share = np.sum(rows, axis=1) / np.maximum(
            np.sum(np.abs(rows), axis=1), np.finfo(float).tiny
        )
        k = int(np.nanargmax(np.where(np.isfinite(share), share, -1.0)))
        if not share[k] > _ROUNDING:
            return []
        power = float(np.sum(rows[k]))
        shown = _named(problem.state_names[: 2 * n], states[k][: 2 * n])
    reason = f"it supplies {power:.3g} W at {shown}. Damping opposes the velocity: check its sign"
    return [EnergySource(part="passive_force", reason=reason)]


def _row(function: ca.Function, *arguments: Vector) -> Vector:
    return np.array(function(*arguments).full()).ravel()


def _by_motors(entries: Mapping[str, ca.SX]) -> list[EnergySource]:
    """Return motors whose back EMF drives the current that accelerates them."""
    if not {"torque_constant", "emf_constant"} <= set(entries):
        return []
    torque, emf = entries["torque_constant"], entries["emf_constant"].T
    if ca.symvar(torque) or ca.symvar(emf):
        return []
    found = list[EnergySource]()
    pair = np.array(ca.evalf(torque).full()), np.array(ca.evalf(emf).full())
    for k, motor in np.argwhere(pair[0] * pair[1] < 0.0):
        both = f"{pair[0][k, motor]:g} and `emf_constant` = {pair[1][k, motor]:g}"
        reason = (
            f"the back EMF of motor {motor + 1} drives the current, and does not brake it: "
            f"`torque_constant` = {both} have opposite signs. Check them"
        )
        found.append(EnergySource(part="emf_constant", reason=reason))
    return found


def _by_friction(
    name: str, torque: ca.Function, states: Vector, problem: Problem
) -> list[EnergySource]:
    """Return a part with dry friction if its friction is negative at a state."""
    values = np.array([_row(torque, x)[0] for x in states])
    k = int(np.argmin(np.where(np.isfinite(values), values, 0.0)))
    if not values[k] < 0.0:
        return []
    at = _named(problem.state_names, states[k])
    reason = f"its friction is {values[k]:.3g} at {at}. Friction opposes the rate: check its sign"
    return [EnergySource(part=name, reason=reason)]


def _by_resistance(name: str, unit: str, entries: Mapping[str, ca.SX]) -> list[EnergySource]:
    """Return a matrix of resistances or conductances that is not positive semidefinite."""
    matrix = entries.get(name)
    if matrix is None or not matrix.numel() or ca.symvar(matrix):
        return []
    least, *others = np.linalg.eigvalsh(_symmetric(matrix))
    if not least < -_ROUNDING * max(abs(least), *np.abs(others), 0.0):
        return []
    reason = f"its least eigenvalue is {least:g} {unit}. Resistances take power: check the sign"
    return [EnergySource(part=name, reason=reason)]


def _symmetric(matrix: ca.SX) -> Vector:
    """Return the symmetric part of a matrix of numbers."""
    values = np.array(ca.evalf(ca.densify(matrix)).full())
    return (values + values.T) / 2


def _named(names: tuple[str, ...], values: Vector) -> str:
    pairs = zip(names, values.tolist(), strict=True)
    return ", ".join(f"{name} = {value:.3g}" for name, value in pairs)
