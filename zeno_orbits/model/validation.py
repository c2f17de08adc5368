"""Checks of a model when it is loaded, before anything is computed with it.

Every mistake is a ``ValueError`` that names the thing at fault. A model is looked at as a formula
and, where formulas do not tell, at the states that the problem starts from and at others near them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model.hybrid import CompletedSystem
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.numeric.own_scale import Reach, constraint_sizes, reach_of
from zeno_orbits.model.units import is_rate_of

_TRIALS = 24
"""States near each start at which the mass matrix is tried."""
_SPREAD = 1.0
"""Distance of these from a start, in each coordinate, as a part of how far the problem goes."""
_SINGULAR = 1e-12
"""Least eigenvalue of a mass matrix, relative to its largest one, that is not rounding."""
_OFF = 1e-9
"""Distance of a start from the stop or a constraint, as a part of how far they go."""

_FORMULAS = (
    "free_flow",
    "gap",
    "gap_rate",
    "gap_acceleration",
    "normal_inertia",
    "multiplier",
    "locked_flow",
    "energy",
    "input_power",
    "copper_loss",
    "other_loss",
    "holonomic",
    "law_numbers",
)


def built(
    model: Callable[[Mapping[str, ca.SX]], object], symbols: Mapping[str, ca.SX]
) -> CompletedSystem:
    """Return what a model makes of its symbols.

    Raises:
        ValueError: If it asks for a name that is not declared, or makes something else.
    """
    try:
        system = model(symbols)
    except KeyError as error:
        if error.args and error.args[0] not in symbols:
            asked = f"but it asks for `{error.args[0]}`"
            raise ValueError(
                f"Argument `model` must use declared gains and parameters, {asked}."
            ) from error
        raise
    if not isinstance(system, CompletedSystem):
        made = f"but it returns a `{type(system).__name__}`"
        raise ValueError(  # noqa: TRY004
            f"Argument `model` must return what `complete` makes, {made}."
        )
    return system


def require_states(
    system: CompletedSystem, state_names: Sequence[str], state_units: Sequence[str]
) -> None:
    """Refuse names that do not fit the states, and velocities whose units are no rates.

    Args:
        system: The completed system.
        state_names: Names of the states, ``(n_x,)``.
        state_units: Their units.

    Raises:
        ValueError: With the name at fault.
    """
    n_x, n_q = system.state.numel(), system.n_q
    if n_x != len(state_names):
        named = f"but it names {len(state_names)}: {', '.join(state_names)}"
        raise ValueError(
            f"Argument `state_names` must name the model's {n_x} states ({n_q} coordinates, as "
            f"many velocities, currents, clock), {named}."
        )
    for k in range(n_q):
        if not is_rate_of(state_units[n_q + k], state_units[k]):
            name, rate = state_names[k], state_names[n_q + k]
            raise ValueError(
                f"Argument `state_units` must give `{rate}` the unit of `{name}` per second, "
                f"but they are `{state_units[n_q + k]}` and `{state_units[k]}`."
            )


def require_known_symbols(system: CompletedSystem, symbols: Mapping[str, ca.SX]) -> None:
    """Refuse a symbol in the formulas that is neither a state nor declared."""
    known = ca.vertcat(system.state, *symbols.values())
    known_ones = {known[k].element_hash() for k in range(known.numel())}
    for formula in _FORMULAS:
        for symbol in _symbols_in(getattr(system, formula)):
            if symbol.element_hash() not in known_ones:
                raise ValueError(
                    f"Argument `model` must use its states, gains and parameters only, "
                    f"but its {formula} holds another symbol, `{symbol.name()}`."
                )


def unused_symbols(
    system: CompletedSystem, symbols: Mapping[str, ca.SX], outputs: Sequence[ca.SX]
) -> tuple[str, ...]:
    """Return the names of the symbols that appear nowhere.

    Args:
        system: The completed system.
        symbols: Its gains and parameters by name.
        outputs: Expressions beside the system's own.
    """
    formulas = [*(getattr(system, formula) for formula in _FORMULAS), *outputs]
    used = {symbol.element_hash() for symbol in _symbols_in(ca.veccat(*formulas))}
    return tuple(name for name, symbol in symbols.items() if symbol.element_hash() not in used)


def require_sound_numbers(
    system: CompletedSystem,
    symbols: Mapping[str, ca.SX],
    values: Sequence[float],
    dynamics: HybridDynamics,
    state_units: Sequence[str],
    starts: Sequence[Sequence[float]],
) -> None:
    """Refuse a model that fails at its own numbers, and starts that are not admissible.

    Args:
        system: The completed system.
        symbols: Its gains and parameters by name.
        values: Their numbers, in the same order.
        dynamics: The system at these numbers: how far it goes is what all is measured by.
        state_units: Units of the states, ``(n_x,)``.
        starts: Initial states, each ``(n_x,)``.

    Raises:
        ValueError: If a formula is not finite at a start, if a start is beyond the stop or off a
            constraint, if the gap does not change with the configuration there, or if the mass
            matrix near it is not positive definite.
    """
    p = np.asarray(values, dtype=np.float64)
    mass_matrix = ca.hessian(system.energy, system.state[system.n_q : 2 * system.n_q])[0]
    look = _function(system, symbols, [ca.densify(mass_matrix), system.gap])
    formulas = {name: _function(system, symbols, [getattr(system, name)]) for name in _FORMULAS}
    random = np.random.default_rng(0)
    with np.errstate(all="ignore"):
        # What is not finite has no size yet; it is told of below.
        reach = reach_of(dynamics, starts, state_units, system.clock)
    sizes = reach.sizes(len(state_units))
    around, names = sizes[: system.n_q], dynamics.state_names
    for number, start in enumerate(starts, start=1):
        x = np.asarray(start, dtype=np.float64)
        _require_mass(look, x, p, around, names, f"at start {number}")
        _require_finite(formulas, x, p, number)
        _require_admissible(dynamics, x, reach, number)
        for _ in range(_TRIALS):
            near = x.copy()
            near[: system.n_q] += around * random.uniform(-_SPREAD, _SPREAD, system.n_q)
            if float(look(near, p)[1]) >= 0.0:
                _require_mass(look, near, p, around, names, "at the admissible state")


def _require_finite(formulas: Mapping[str, Any], x: Vector, p: Vector, number: int) -> None:
    for name in ("gap", *_FORMULAS):
        if not np.all(np.isfinite(formulas[name](x, p).full())):
            where = f"must be finite at start {number}, but its {name} is not"
            hint = "; does the gap change with the configuration there?"
            asked = hint if name == "normal_inertia" else ""
            raise ValueError(f"Argument `model` {where}{asked}.")


def _require_admissible(dynamics: HybridDynamics, x: Vector, reach: Reach, number: int) -> None:
    gap = dynamics.gap(x)
    if gap < -_OFF * reach.gap:
        raise ValueError(f"Start {number} must have a gap >= 0, but it is {gap:.6g}.")
    off = dynamics.holonomic(x)
    if np.any(np.abs(off) > _OFF * constraint_sizes(dynamics, x, reach.sizes(len(x)))):
        raise ValueError(
            f"Start {number} must keep the constraints, but it is off by "
            f"{float(np.max(np.abs(off))):.3g}; a clock may start with its cosine at 1."
        )


def _require_mass(
    look: Any, x: Vector, p: Vector, sizes: Vector, state_names: Sequence[str], where: str
) -> None:
    # In these sizes all entries are energies, so what is next to nothing is so in any units.
    matrix = look(x, p)[0].full() * np.outer(sizes, sizes)
    if not np.all(np.isfinite(matrix)):
        return
    roots = np.linalg.eigvalsh(matrix)
    if roots[0] > _SINGULAR * abs(roots[-1]):
        return
    place = ", ".join(
        f"{name} = {value:.3g}" for name, value in zip(state_names, x[: sizes.size], strict=False)
    )
    what = "singular" if abs(roots[0]) <= _SINGULAR * abs(roots[-1]) else "indefinite"
    raise ValueError(
        f"The mass matrix must be positive definite, but {where} ({place}) it is {what}: "
        f"in the problem's own sizes its eigenvalues reach from {roots[0]:.3g} to {roots[-1]:.3g}."
    )


def _symbols_in(expression: ca.SX) -> list[ca.SX]:
    return ca.symvar(expression)


def _function(system: CompletedSystem, symbols: Mapping[str, ca.SX], outputs: list[ca.SX]) -> Any:
    return ca.Function("look", [system.state, ca.vertcat(*symbols.values())], outputs)
