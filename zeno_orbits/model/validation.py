"""Checks of a model when it is loaded, before anything is computed with it.

Every mistake raises a ``ValueError`` that names the invalid part. A model is checked as a formula.
If formulas are not sufficient, it is checked at the problem's initial states and at states near
them.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, did_you_mean, shortened
from zeno_orbits.model.contact import SLOWEST, at_impact_speed, impact_speed
from zeno_orbits.model.domains import named_formulas, require_finite, require_rising_gap
from zeno_orbits.model.expressions.operations import symbols_in
from zeno_orbits.model.expressions.units import ELECTRICAL, is_electrical_unit, is_rate_of
from zeno_orbits.model.hybrid import CompletedSystem
from zeno_orbits.model.mistakes import NotSymbolicError, holds_nan
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.numeric.own_scale import ScaleReach, constraint_sizes, reach_of

_TRIALS = 24
"""States near each start at which the mass matrix is tried."""
_SPREAD = 1.0
"""Distance of these from a start, in each coordinate, as a part of how far the problem goes."""
_SINGULAR = 1e-12
"""Least eigenvalue of a mass matrix, relative to its largest one, that is not rounding."""
_OFF = 1e-9
"""Distance of a start from the stop or a constraint, as a part of how far they go."""

_DECLARED = "declared"
"""The formulas that the model declares, as one."""
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

_CALLED = re.compile(r"Function::call for '(\w+)'.*eval_sx", re.DOTALL)
"""CasADi's message about a function that takes no symbols of the kind that models have."""


def built(
    model: Callable[[Mapping[str, ca.SX]], object], symbols: Mapping[str, ca.SX]
) -> CompletedSystem:
    """Return the completed system that a model builds from its symbols.

    Raises:
        InputError: If the model uses an undeclared name or a function of other symbols, or returns
            another type.
    """
    _require_one_argument(model)
    try:
        system = model(symbols)
    except KeyError as error:
        if error.args and error.args[0] not in symbols:
            name = str(error.args[0])
            remedy = did_you_mean(name, symbols)
            if name == "restitution":
                remedy = " Add `Quantity.restitution(0.5)` to `parameters`, or write a number."
            asked = f"but it uses `{name}`.{remedy}"
            raise InputError(
                f"Argument `model` must use declared gains and parameters, {asked}"
            ) from error
        raise
    except RuntimeError as error:
        called = _CALLED.search(str(error))
        if called is None:
            raise
        raise InputError(
            f"Argument `model`: the function `{called[1]}` takes no `casadi.SX`: make an "
            "interpolant without the option `inline`, or use `zo.table`."
        ) from error
    if not isinstance(system, CompletedSystem):
        kind = "nothing" if system is None else f"a `{type(system).__name__}`"
        made = f"but it returns {kind}. Write `return zo.hybrid_system(...)`"
        raise InputError(f"Argument `model` must return the system of `hybrid_system`, {made}.")
    return system


def _require_one_argument(model: Callable[..., Any]) -> None:
    """Reject a model that cannot be called with the symbols alone.

    Raises:
        InputError: If its signature takes no argument, or requires several.
    """
    try:
        known = inspect.signature(model)
    except ValueError:
        return
    try:
        known.bind({})
    except TypeError:
        wanted = "must take one argument, the gains and parameters by name"
        taken = shortened(str(known))
        raise InputError(
            f"Argument `model` {wanted}, but it takes `{taken}`. Write `def model(p):`."
        ) from None


def require_states(
    system: CompletedSystem, state_names: Sequence[str], state_units: Sequence[str]
) -> None:
    """Reject names that do not fit the states, and velocities whose units are not rates.

    Args:
        system: The completed system.
        state_names: Names of the states, ``(n_x,)``.
        state_units: Units of the states.

    Raises:
        ValueError: If a name or unit does not fit. The message contains the name.
    """
    n_x, n_q = system.state.numel(), system.n_q
    if n_x != len(state_names):
        named = f"but it names {len(state_names)}: {', '.join(state_names)}"
        raise ValueError(
            f"Argument `state_names` must name the model's {n_x} states ({n_q} coordinates, as "
            f"many velocities, {n_x - 2 * n_q} of drives and clock{_others(system)}), {named}."
            f"{_forgotten(system, state_names)}"
        )
    for k in range(n_q):
        if not is_rate_of(state_units[n_q + k], state_units[k]):
            name, rate = state_names[k], state_names[n_q + k]
            raise ValueError(
                f"Argument `state_units` must give `{rate}` the unit of `{name}` per second, "
                f"but they are `{state_units[n_q + k]}` and `{state_units[k]}`."
            )
    places = range(2 * n_q, n_x)
    for k, kind in zip(places, system.drive.kinds, strict=False):
        if kind and not is_electrical_unit(kind, state_units[k], state_units):
            raise ValueError(
                f"Argument `state_units` must give the {kind} `{state_names[k]}` the unit "
                f"{ELECTRICAL[kind]}, but it is `{state_units[k]}`."
            )


def _others(system: CompletedSystem) -> str:
    """Return the symbols of the states after the velocities, as a clause."""
    names = [system.state[k].name() for k in range(2 * system.n_q, system.state.numel())]
    return f": {', '.join(f'`{name}`' for name in names)}" if names else ""


def _forgotten(system: CompletedSystem, state_names: Sequence[str]) -> str:
    """Return the remedy if the formulas hold symbols that were to be states, or an empty text."""
    known = {system.state[k].element_hash() for k in range(system.state.numel())}
    strangers = {
        one.name() for one in _symbols_of(system) if one.element_hash() not in known
    } & set(state_names)
    if not strangers:
        return ""
    words = ", ".join(f"`{name}`" for name in state_names if name in strangers)
    return (
        f" The formulas use {words}, not a state of the mechanism or drive. Pass a clock to "
        "the mechanism, as `clock=clock`."
    )


def require_known_symbols(system: CompletedSystem, symbols: Mapping[str, ca.SX]) -> None:
    """Refuse a symbol in the formulas that is neither a state nor declared.

    The state after an impact may also hold its speed.
    """
    known = ca.vertcat(system.state, *symbols.values())
    known_ones = {known[k].element_hash() for k in range(known.numel())}
    for name, entry in system.drive.entries:
        for symbol in symbols_in(entry):
            is_speed = name == "after_impact" and ca.is_equal(symbol, impact_speed)
            if symbol.element_hash() not in known_ones and not is_speed:
                raise ValueError(
                    f"Argument `{name}` must use states, gains and parameters only, "
                    f"but it holds another symbol, `{symbol.name()}`."
                )
    for symbol in _symbols_of(system):
        if symbol.element_hash() in known_ones:
            continue
        name = symbol.name()
        for one in named_formulas(system):
            if ca.depends_on(one.formula, symbol):
                raise one.error(
                    f"{one.words} holds the symbol `{name}`, which is neither a state nor declared."
                    f' Write `p["{name}"]`, and declare `{name}` in `parameters`.'
                )
        raise ValueError(
            f"Argument `model` must use its states, gains and parameters only, but it holds the "
            f"symbol `{name}`."
        )


def unused_symbols(
    system: CompletedSystem, symbols: Mapping[str, ca.SX], outputs: Sequence[ca.SX]
) -> tuple[str, ...]:
    """Return the names of the unused symbols.

    Args:
        system: The completed system.
        symbols: Gains and parameters by name.
        outputs: Expressions in addition to the system's own expressions.
    """
    used = {symbol.element_hash() for symbol in _symbols_of(system, outputs)}
    return tuple(name for name, symbol in symbols.items() if symbol.element_hash() not in used)


def require_sound_numbers(
    system: CompletedSystem,
    symbols: Mapping[str, ca.SX],
    values: Sequence[float],
    dynamics: HybridDynamics,
    state_units: Sequence[str],
    starts: Sequence[Sequence[float]],
) -> None:
    """Reject a model that fails at its default parameters, and starts that are not admissible.

    Args:
        system: The completed system.
        symbols: Gains and parameters by name.
        values: Values of the symbols, in the same order.
        dynamics: The system at these values, whose reach is the scale of all checks.
        state_units: Units of the states, ``(n_x,)``.
        starts: Initial states, each ``(n_x,)``.

    Raises:
        NotSymbolicError: If a formula is NaN itself.
        ValueError: If a formula is not finite at a start, if a start is beyond the stop or off a
            constraint, if the gap does not change with the configuration there, if the mass matrix
            or a coenergy near it is not convex, or if a resistance feeds energy in.
    """
    p = np.asarray(values, dtype=np.float64)
    mass_matrix = ca.hessian(system.energy, system.state[system.n_q : 2 * system.n_q])[0]
    look = _function(system, symbols, [ca.densify(mass_matrix), system.gap])
    formulas = {name: _function(system, symbols, [getattr(system, name)]) for name in _FORMULAS}
    # A state after an impact may hold its speed.
    slow = (at_impact_speed(one.formula, SLOWEST) for one in named_formulas(system))
    declared = [ca.vec(ca.densify(one)) for one in slow]
    formulas[_DECLARED] = _function(system, symbols, [ca.vertcat(*declared)])
    fields = _function(system, symbols, [ca.densify(system.drive.inertia)])
    lossy = {
        (name, number): _function(system, symbols, [ca.densify(matrix)])
        for number, (name, matrix) in enumerate(system.drive.entries)
        if name in ("resistance", "conductance") and matrix.numel()
    }
    random = np.random.default_rng(0)
    with np.errstate(all="ignore"):
        # Values that are not finite cannot be scaled here and are reported below.
        reach = reach_of(dynamics, starts, state_units, system.clock)
    sizes = reach.sizes(len(state_units))
    around, names = sizes[: system.n_q], dynamics.state_names
    for number, start in enumerate(starts, start=1):
        x = np.asarray(start, dtype=np.float64)
        _require_mass(look, x, p, around, names, f"at start {number}")
        _require_finite(system, symbols, formulas, x, p, number)
        _require_convex(fields, x, p, f"at start {number}")
        for (name, _), matrix in lossy.items():
            _require_lossy(name, matrix(x, p).full(), f"at start {number}")
        _require_admissible(dynamics, x, reach, number)
        for _ in range(_TRIALS):
            near = x.copy()
            near[: system.n_q] += around * random.uniform(-_SPREAD, _SPREAD, system.n_q)
            if float(look(near, p)[1]) >= 0.0:
                _require_mass(look, near, p, around, names, "at the admissible state")
                # Currents and voltages move as well: a field may saturate.
                free = [k for k in range(2 * system.n_q, len(x)) if k not in dynamics.clock]
                near[free] += sizes[free] * random.uniform(-_SPREAD, _SPREAD, len(free))
                _require_convex(fields, near, p, "at an admissible state near it")


def _require_finite(
    system: CompletedSystem,
    symbols: Mapping[str, ca.SX],
    formulas: Mapping[str, Any],
    x: Vector,
    p: Vector,
    number: int,
) -> None:
    """Refuse formulas that are not finite, by the names that the model gives them."""
    infinite = [
        name for name in ("gap", *_FORMULAS) if not np.all(np.isfinite(formulas[name](x, p).full()))
    ]
    if any(holds_nan(getattr(system, name)) for name in infinite):
        raise NotSymbolicError
    if infinite or not np.all(np.isfinite(formulas[_DECLARED](x, p).full())):
        require_finite(system, symbols, x, p, number, with_derivatives=bool(infinite))
    if infinite:
        require_rising_gap(system, symbols, x, p, number)
        raise ValueError(
            f"Argument `model` must give finite equations of motion at start {number}, but they "
            f"are not finite there. Change the start, or a formula.{_zeros(symbols, p)}"
        )


def _zeros(symbols: Mapping[str, ca.SX], p: Vector) -> str:
    """Return the sentence about values that are zero, which a formula may divide by."""
    zeros = [f"`{name}`" for name, value in zip(symbols, p.tolist(), strict=True) if value == 0.0]
    return f" Values that are zero: {', '.join(zeros)}." if zeros else ""


def _require_admissible(
    dynamics: HybridDynamics, x: Vector, reach: ScaleReach, number: int
) -> None:
    gap = dynamics.gap(x)
    if gap < -_OFF * reach.gap:
        raise ValueError(
            f"Start {number} must have a gap >= 0, but it is {gap:.6g}. Change the start, or the "
            "sign of the gap."
        )
    off = dynamics.holonomic(x)
    if np.any(np.abs(off) > _OFF * constraint_sizes(dynamics, x, reach.sizes(len(x)))):
        clock = [dynamics.state_names[k] for k in dynamics.clock]
        if clock and abs(float(np.hypot(*x[list(dynamics.clock)])) - 1.0) > _OFF:
            raise ValueError(
                f"Start {number} must have {' and '.join(f'`{name}`' for name in clock)} on the "
                f'unit circle of the clock. Add its phase, such as `"{clock[0]}": 1.0`.'
            )
        raise ValueError(
            f"Start {number} must satisfy the holonomic constraints, but it violates them by "
            f"{float(np.max(np.abs(off))):.3g}. Change the start."
        )


def _require_mass(
    look: Any, x: Vector, p: Vector, sizes: Vector, state_names: Sequence[str], where: str
) -> None:
    # In these scales all entries are energies, so a negligible entry is negligible in any units.
    matrix = look(x, p)[0].full() * np.outer(sizes, sizes)
    if not np.all(np.isfinite(matrix)):
        return
    roots = np.linalg.eigvalsh(matrix)
    if roots[0] > _SINGULAR * abs(roots[-1]):
        return
    place = ", ".join(
        f"{name} = {value:.3g}" for name, value in zip(state_names, x[: sizes.size], strict=False)
    )
    if roots[-1] < 0.0:
        raise ValueError(
            f"The mass matrix must be positive definite, but {where} ({place}) it is negative "
            "definite. Check the signs in `kinetic`."
        )
    what = "singular" if abs(roots[0]) <= _SINGULAR * abs(roots[-1]) else "indefinite"
    raise ValueError(
        f"The mass matrix must be positive definite, but {where} ({place}) it is {what}: "
        f"in the problem's own sizes its eigenvalues reach from {roots[0]:.3g} to {roots[-1]:.3g}."
    )


def _require_convex(fields: Any, x: Vector, p: Vector, where: str) -> None:
    """Reject inductances and capacitances whose matrix is not positive definite."""
    matrix = fields(x, p).full()
    if not matrix.size or not np.all(np.isfinite(matrix)):
        return
    # Henry and farad differ by many powers of ten. After this scaling only the signs matter.
    sizes = np.sqrt(np.abs(np.diag(matrix)))
    scaled = matrix / np.outer(sizes, sizes) if np.all(sizes > 0.0) else matrix
    least = float(np.linalg.eigvalsh((scaled + scaled.T) / 2)[0])
    if not least > _SINGULAR:
        raise ValueError(
            "Argument `coenergy` must be convex in the currents and voltages, with inductances and "
            f"capacitances above zero, but {where} it is not: the least eigenvalue of its second "
            f"derivative is {least:.3g}, with diagonal entries of size 1."
        )


def _require_lossy(name: str, matrix: Vector, where: str) -> None:
    """Refuse a resistance or a conductance that feeds energy in."""
    if not np.all(np.isfinite(matrix)):
        return
    roots = np.linalg.eigvalsh((matrix + matrix.T) / 2)
    if roots[0] < -_SINGULAR * np.max(np.abs(roots)):
        raise ValueError(
            f"Argument `{name}` must lose energy, but {where} its least eigenvalue is "
            f"{roots[0]:.3g}: an element that feeds energy in belongs to `source`."
        )


def _symbols_of(system: CompletedSystem, outputs: Sequence[ca.SX] = ()) -> Iterator[ca.SX]:
    """Return the symbols of the formulas of a system and of further ones, some of them repeated."""
    formulas: list[ca.SX] = [*(getattr(system, name) for name in _FORMULAS), *outputs]
    return chain.from_iterable(map(symbols_in, formulas))


def _function(system: CompletedSystem, symbols: Mapping[str, ca.SX], outputs: list[ca.SX]) -> Any:
    return ca.Function("look", [system.state, ca.vertcat(*symbols.values())], outputs)
