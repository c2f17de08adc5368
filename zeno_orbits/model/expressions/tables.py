r"""Tables in formulas: functions of one or two arguments that are given at knots.

A table is a polynomial in every cell between two knots. Its coefficients are looked up by the index
of the cell, so a formula has the same size for ten knots and for ten thousand. A knot of a linear
or monotone table is an event without a reset. A machine has one kink per such argument: its sides
are the cells of even and of odd index.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators.lookups import CellTable
from zeno_orbits.work import checked

Kind = Literal["linear", "cubic", "monotone"]
Outside = Literal["refuse", "hold", "extend"]
Numbers = Sequence[float] | Vector | ca.SX | Sequence[ca.SX | float]

_KINDS, _OUTSIDE = ("linear", "cubic", "monotone"), ("refuse", "hold", "extend")
_LEAST = {"linear": 2, "cubic": 4, "monotone": 2}
"""Number of knots that a kind needs."""
_MOST_PARAMETERS = 64
"""Number of values up to which they may be formulas of parameters."""
_POINTS, _SAME = 5, 1e-12
"""Points at which the shape of knots is compared, and the relative rounding there."""


@checked
def table(
    x: Any,  # a formula, or a pair of them
    knots: Any,  # numbers or formulas, of two arguments a pair of them
    values: Any,
    kind: str = "linear",
    *,
    outside: str = "refuse",
    name: str = "table",
) -> ca.SX:
    r"""Return a function that is given by its values at knots.

    Between knots the function is a straight line (``linear``), a cubic spline with continuous
    second derivatives and the ends of [DeBoor1978]_ (``cubic``), or a cubic with the slopes of
    [FritschButland1984]_, which overshoots no value (``monotone``). A table of two arguments is
    linear or cubic in each of them.

    Passing a knot of a linear or monotone table is one event without a reset. A cubic table has no
    events: its flow is smooth to second order.

    Args:
        x: The argument, a formula of states, or a pair of them.
        knots: Increasing knots, ``(n,)``, or a pair of them. Knots may be formulas of parameters
            if they move and stretch together.
        values: Value at every knot, ``(n,)``, or ``(n, m)`` for two arguments. Values of linear and
            cubic tables of one argument may be formulas of parameters, up to 64 of them.
        kind: ``linear``, ``cubic`` or ``monotone``.
        outside: Beyond the knots: ``refuse`` ends a motion, ``hold`` keeps the last value, and
            ``extend`` goes on with the last line or cubic.
        name: Name of the table in messages.

    Raises:
        ValueError: If knots do not increase, a number is not finite, or the numbers of knots and
            values do not fit.
    """
    _require_choice("kind", kind, _KINDS)
    _require_choice("outside", outside, _OUTSIDE)
    pair = isinstance(x, tuple | list)
    try:
        arguments = [ca.SX(one) for one in (x if pair else (x,))]
    except (TypeError, NotImplementedError):
        arguments = []
    if len(arguments) != 1 + pair or any(not one.is_scalar() for one in arguments):
        raise ValueError("Argument `x` of a table must be a scalar formula, or a pair of them.")
    axes = list(knots) if pair else [knots]
    if pair and len(axes) != 2:
        raise ValueError("Argument `knots` must be a pair for a table of two arguments.")
    placed = [_numeric_axis(at, axis, kind) for at, axis in zip(arguments, axes, strict=True)]
    if pair:
        return _surface(placed, _numbers(values, "values", 2), kind, outside, name)
    (argument,) = placed
    formulas = _formulas(values)
    if formulas is not None:
        return _of_parameters(argument, formulas, kind, outside, name)
    return _curve(argument, _numbers(values, "values", 1), kind, outside, name)


def _require_choice(what: str, given: str, choices: Sequence[str]) -> None:
    if given not in choices:
        told = ", ".join(f"'{one}'" for one in choices)
        raise ValueError(f"Argument `{what}` must be one of {told}, but it is '{given}'.")


@dataclass(frozen=True, slots=True)
class _Axis:
    """An argument with knots that are numbers."""

    x: ca.SX
    knots: Vector


def _formulas(given: Any) -> list[ca.SX] | None:
    """Return entries as formulas, or ``None`` if all of them are numbers."""
    if isinstance(given, np.ndarray):
        return None
    entries = ca.vertsplit(ca.vec(given)) if isinstance(given, ca.SX) else list(given)
    if not any(isinstance(one, ca.SX) for one in entries):
        return None
    formulas = [ca.SX(one) for one in entries]
    return None if all(one.is_constant() for one in formulas) else formulas


def _numbers(given: Any, what: str, dimension: int) -> Vector:
    """Return finite numbers in an array."""
    try:
        plain = given
        if isinstance(given, ca.SX | ca.DM):
            plain = ca.evalf(ca.SX(given)).full()
            plain = plain.ravel() if dimension == 1 else plain
        elif dimension == 1 and not isinstance(given, np.ndarray):
            plain = [float(one) for one in given]
        numbers = np.array(plain, dtype=np.float64)
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"Argument `{what}` of a table must hold numbers.") from None
    if numbers.ndim != dimension:
        raise ValueError(
            f"Argument `{what}` of a table must have {dimension} dimension(s), but it has "
            f"{numbers.ndim}."
        )
    for place in np.argwhere(~np.isfinite(numbers))[:1].tolist():
        at = ", ".join(map(str, place))
        raise ValueError(
            f"Argument `{what}` of a table must hold finite numbers, but entry [{at}] is "
            f"{numbers[tuple(place)]}."
        )
    return numbers


def _numeric_axis(x: ca.SX, knots: Any, kind: str) -> _Axis:
    """Return an argument, scaled so that its knots are numbers.

    Raises:
        ValueError: If the knots do not increase, are too few, or do not move together.
    """
    formulas = _formulas(knots)
    if formulas is not None:
        first, last = formulas[0], formulas[-1]
        shape = _shape_of(formulas)
        return _increasing(_Axis((x - first) / (last - first), shape), kind)
    return _increasing(_Axis(x, _numbers(knots, "knots", 1)), kind)


def _increasing(axis: _Axis, kind: str) -> _Axis:
    knots, least = axis.knots, _LEAST[kind]
    if len(knots) < least:
        raise ValueError(
            f"Argument `knots` of a {kind} table must hold at least {least} numbers, but it holds "
            f"{len(knots)}."
        )
    for k in np.flatnonzero(np.diff(knots) <= 0.0)[:1].tolist():
        problem = "equals" if knots[k + 1] == knots[k] else "is below"
        raise ValueError(
            f"Argument `knots` of a table must increase, but entry {k + 1} ({knots[k + 1]:g}) "
            f"{problem} entry {k} ({knots[k]:g})."
        )
    return axis


def _shape_of(knots: Sequence[ca.SX]) -> Vector:
    """Return the places of knots between the first and the last one, for all parameter values.

    Raises:
        ValueError: If the places depend on parameters.
    """
    every = ca.vertcat(*knots)
    symbols = ca.symvar(every)
    places: Any = ca.Function("places", symbols, [(every - knots[0]) / (knots[-1] - knots[0])])
    points = np.random.default_rng(0).uniform(0.5, 2.0, (_POINTS, len(symbols)))
    found = np.array([places(*point).full().ravel() for point in points.tolist()])
    if not np.all(np.isfinite(found)) or np.any(np.abs(found - found[0]) > _SAME):
        raise ValueError(
            "Argument `knots` of a table may hold parameters if all knots move and stretch "
            "together, such as `p * k` for every `k`: scale its argument instead."
        )
    return found[0]


# Coefficients.


def _cells(knots: Vector, values: Vector, kind: str) -> Vector:
    """Return the coefficients of every cell in powers of the way from its knot.

    Args:
        knots: The knots, ``(n + 1,)``.
        values: Values at the knots, ``(n + 1, ...)``.
        kind: Kind of the table.

    Returns:
        Coefficients, ``(2 or 4, n, ...)``.
    """
    if kind == "linear":
        width = np.diff(knots).reshape(-1, *[1] * (values.ndim - 1))
        return np.stack([values[:-1], np.diff(values, axis=0) / width])
    made = CubicSpline(knots, values) if kind == "cubic" else PchipInterpolator(knots, values)
    return np.array(made.c[::-1], dtype=np.float64)


def _borders(knots: Vector) -> Vector:
    """Return knot and guard of every cell, ``(4, n)``: see `CellTable.guard`."""
    width, n = np.diff(knots), len(knots) - 1
    guard = np.stack([np.zeros(n), np.ones(n), -1.0 / width])
    guard[:, -1] = 0.0, 1.0, 0.0
    guard[:, 0] = width[0], -1.0, 0.0
    return np.vstack([knots[:-1], guard])


def _require_fit(n_values: int, n_knots: int, what: str = "") -> None:
    if n_values != n_knots:
        raise ValueError(
            f"Arguments `knots` and `values` of a table must fit{what}, but there are {n_knots} "
            f"knots and {n_values} values."
        )


def _held(axis: _Axis, outside: str, is_kinked: bool) -> tuple[ca.SX, Vector, bool]:
    """Return the argument of a table, its knots, and whether it has constant outer cells.

    A smooth table is held by its argument, which has two kinks.
    """
    x, knots = axis.x, axis.knots
    if outside != "hold":
        return x, knots, False
    if not is_kinked:
        return ca.fmax(knots[0], ca.fmin(knots[-1], x)), knots, False
    first, last = knots[1] - knots[0], knots[-1] - knots[-2]
    return x, np.concatenate([[knots[0] - first], knots, [knots[-1] + last]]), True


def _curve(axis: _Axis, values: Vector, kind: str, outside: str, name: str) -> ca.SX:
    """Return a table of one argument."""
    _require_fit(len(values), len(axis.knots))
    coefficients = _cells(axis.knots, values, kind)
    return _polynomials(axis, coefficients[:, :, None], kind, outside, name)[0]


def _of_parameters(
    axis: _Axis, values: Sequence[ca.SX], kind: str, outside: str, name: str
) -> ca.SX:
    """Return a table whose values are formulas: a sum of tables with one value that is not zero."""
    if kind == "monotone" or len(values) > _MOST_PARAMETERS:
        raise ValueError(
            f"Argument `values` of a table may hold parameters if the table is linear or cubic and "
            f"has at most {_MOST_PARAMETERS} values: scale the table by a parameter instead."
        )
    _require_fit(len(values), len(axis.knots))
    coefficients = _cells(axis.knots, np.eye(len(values)), kind)
    parts = _polynomials(axis, coefficients, kind, outside, name)
    return ca.dot(ca.vertcat(*values), ca.vertcat(*parts))


def _polynomials(
    axis: _Axis, coefficients: Vector, kind: str, outside: str, name: str
) -> list[ca.SX]:
    """Return functions by the coefficients of their cells, ``(k, n, m)``."""
    x, knots, is_held = _held(axis, outside, kind != "cubic")
    if is_held:
        width = knots[-2] - knots[-3]
        powers = width ** np.arange(len(coefficients))
        ends = np.zeros((len(coefficients), 2, coefficients.shape[2]))
        ends[0, 0] = coefficients[0, 0]
        ends[0, 1] = np.tensordot(powers, coefficients[:, -1], 1)
        coefficients = np.concatenate([ends[:, :1], coefficients, ends[:, 1:]], axis=1)
    rows = np.concatenate(np.moveaxis(coefficients, 2, 0))
    cells = CellTable(
        name=f"the table `{name}`",
        knots=knots,
        columns=np.vstack([_borders(knots), rows]),
        is_kinked=kind != "cubic",
        refuses=outside == "refuse",
    )
    found = cells.numbers_of(cells.cell(x))
    u, n = x - found[0], len(coefficients)
    return [_horner(found[4 + k * n : 4 + (k + 1) * n], u) for k in range(coefficients.shape[2])]


def _horner(coefficients: Sequence[ca.SX], u: ca.SX) -> ca.SX:
    value = coefficients[-1]
    for one in reversed(coefficients[:-1]):
        value = one + u * value
    return value


def _surface(axes: Sequence[_Axis], values: Vector, kind: str, outside: str, name: str) -> ca.SX:
    """Return a table of two arguments: the product of two tables.

    Raises:
        ValueError: If the numbers do not fit, or the table is to be monotone.
    """
    if kind == "monotone":
        raise ValueError("Argument `kind` of a table of two arguments must be 'linear' or 'cubic'.")
    for k, (axis, n) in enumerate(zip(axes, values.shape, strict=True)):
        _require_fit(n, len(axis.knots), f" along argument {k + 1}")
    held = [_held(axis, outside, kind == "linear") for axis in axes]
    if held[0][2]:
        values = np.pad(values, 1, mode="edge")
    knots = [one[1] for one in held]
    along = np.moveaxis(_cells(knots[0], values, kind), 2, 0)
    every = np.transpose(_cells(knots[1], along, kind), (2, 0, 3, 1))
    ways: list[ca.SX] = []
    cells: list[ca.SX] = []
    for k, (x, places, _) in enumerate(held):
        one = CellTable(
            name=f"argument {k + 1} of the table `{name}`",
            knots=places,
            columns=_borders(places),
            is_kinked=kind == "linear",
            refuses=outside == "refuse",
        )
        cells.append(one.cell(x))
        ways.append(x - one.numbers_of(cells[-1])[0])
    order, across = len(every), len(knots[1]) - 1
    columns = every.reshape(order**2, -1)
    data = CellTable(name=f"the table `{name}`", knots=np.zeros(0), columns=columns)
    numbers = data.numbers_of(cells[0] * across + cells[1])
    inner = [_horner(numbers[i * order : (i + 1) * order], ways[1]) for i in range(order)]
    return _horner(inner, ways[0])
