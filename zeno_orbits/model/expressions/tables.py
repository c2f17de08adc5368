r"""Tables in formulas: functions of one or two arguments that are given at knots.

A table is a polynomial in every cell between two knots. Its coefficients are looked up by the index
of the cell, so a formula has the same size for ten knots and for ten thousand. A knot of a linear
or monotone table is an event without a reset. A machine has one kink per such argument: its sides
are the cells of even and of odd index.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any, cast

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import shown
from zeno_orbits.integrators import TABLE_HEAD, CellTable
from zeno_orbits.model.expressions.identities import at_random_points, is_told_by_points
from zeno_orbits.model.expressions.spans import reach, reach_of_cells
from zeno_orbits.work import checked

_KINDS, _OUTSIDE = ("linear", "cubic", "monotone"), ("refuse", "hold", "extend")
_LEAST = {"linear": 2, "cubic": 4, "monotone": 2}
"""Number of knots that a kind needs."""
_MOST_PARAMETERS = 64
"""Number of values up to which they may be formulas of parameters."""
_FAR = 1e150
"""Size of a knot that is too large for its square."""
_SAME, _COMPARED = 1e-12, 50
"""Relative rounding of shapes of knots that are the same, and the number of points along an
argument at which a table of CasADi is compared."""


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
    given = cast("Any", x if pair else (x,))
    try:
        arguments = [ca.SX(one) for one in given]
    except (TypeError, NotImplementedError):
        arguments = []
    if len(arguments) != 1 + pair or any(not one.is_scalar() for one in arguments):
        raise ValueError("Argument `x` of a table must be a scalar formula, or a pair of them.")
    axes = cast("Any", knots if pair and isinstance(knots, Sequence) else [] if pair else [knots])
    if pair and len(axes) != 2:
        raise ValueError("Argument `knots` must be a pair for a table of two arguments.")
    named = [f"knots[{k}]" for k in range(2)] if pair else ["knots"]
    placed = [_numeric_axis(*one, kind) for one in zip(arguments, axes, named, strict=True)]
    if pair:
        return _surface(placed, numbers_in(values, "values", 2), kind, outside, name)
    (argument,) = placed
    formulas = _formulas(values)
    if formulas is not None:
        return _of_parameters(argument, formulas, kind, outside, name)
    return _curve(argument, numbers_in(values, "values", 1), kind, outside, name)


def _require_choice(what: str, given: str, choices: Sequence[str]) -> None:
    if given not in choices:
        told = ", ".join(f"'{one}'" for one in choices)
        raise ValueError(f"Argument `{what}` must be one of {told}, but it is {shown(given)}.")


@dataclass(frozen=True, slots=True)
class _Axis:
    """An argument with knots that are numbers."""

    x: ca.SX
    knots: Vector


def _formulas(given: Any) -> list[ca.SX] | None:
    """Return entries as formulas, or ``None`` if all of them are numbers."""
    if isinstance(given, np.ndarray) or not isinstance(given, ca.SX | Sequence):
        return None
    entries = cast("Any", ca.vertsplit(ca.vec(given)) if isinstance(given, ca.SX) else given)
    if not any(isinstance(one, ca.SX) for one in entries):
        return None
    formulas = [ca.SX(one) for one in entries]
    return None if all(one.is_constant() for one in formulas) else formulas


def numbers_in(given: Any, what: str, dimension: int) -> Vector:
    """Return finite numbers in an array.

    Args:
        given: The numbers.
        what: Name of the argument that holds them.
        dimension: Number of dimensions.

    Raises:
        ValueError: If an entry is not a finite number, or the dimension differs.
    """
    if np.ma.is_masked(given):
        raise ValueError(f"Argument `{what}` must hold numbers, but samples of it are masked.")
    try:
        plain = given
        if isinstance(given, ca.SX | ca.DM):
            plain = ca.evalf(ca.SX(given)).full()
            plain = plain.ravel() if dimension == 1 else plain
        elif dimension == 1 and not isinstance(given, np.ndarray):
            plain = [float(one) for one in given]
        numbers = np.array(plain, dtype=np.float64)
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"Argument `{what}` must hold numbers.") from None
    if numbers.ndim != dimension:
        raise ValueError(
            f"Argument `{what}` must have {dimension} dimension(s), but it has {numbers.ndim}."
        )
    for place in np.argwhere(~np.isfinite(numbers))[:1].tolist():
        at = ", ".join(map(str, place))
        raise ValueError(
            f"Argument `{what}` must hold finite numbers, but entry [{at}] is "
            f"{numbers[tuple(place)]}."
        )
    return numbers


def _numeric_axis(x: ca.SX, knots: Any, what: str, kind: str) -> _Axis:
    """Return an argument, scaled so that its knots are numbers, which messages name.

    Raises:
        ValueError: If the knots do not increase, are too few, or do not move together.
    """
    formulas = _formulas(knots)
    if formulas is not None:
        first, last = formulas[0], formulas[-1]
        shape = _shape_of(formulas)
        return _increasing(_Axis((x - first) / (last - first), shape), what, kind)
    return _increasing(_Axis(x, numbers_in(knots, what, 1)), what, kind)


def _increasing(axis: _Axis, what: str, kind: str) -> _Axis:
    knots, least = axis.knots, _LEAST[kind]
    if knots.size and not np.max(np.abs(knots)) < _FAR:
        raise ValueError(
            f"Argument `{what}` of a table must be below {_FAR:g}: choose other units."
        )
    if len(knots) < least:
        raise ValueError(
            f"Argument `{what}` of a {kind} table must hold at least {least} numbers, but it holds "
            f"{len(knots)}."
        )
    for k in np.flatnonzero(np.diff(knots) <= 0.0)[:1].tolist():
        problem = "equals" if knots[k + 1] == knots[k] else "is below"
        raise ValueError(
            f"Argument `{what}` of a table must increase, but entry {k + 1} ({knots[k + 1]:g}) "
            f"{problem} entry {k} ({knots[k]:g})."
        )
    return axis


def _shape_of(knots: Sequence[ca.SX]) -> Vector:
    """Return the places of knots between the first and the last one, for all parameter values.

    Raises:
        ValueError: If the places depend on parameters.
    """
    found = at_random_points([(one - knots[0]) / (knots[-1] - knots[0]) for one in knots])
    is_one = np.all(np.isfinite(found)) and np.all(np.abs(found - found[0]) <= _SAME)
    if not (is_one and is_told_by_points(*knots)):
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
        with np.errstate(all="ignore"):
            return finite(np.stack([values[:-1], np.diff(values, axis=0) / width]))
    from scipy.interpolate import CubicSpline, PchipInterpolator

    made = held_in_doubles(CubicSpline if kind == "cubic" else PchipInterpolator, knots, values)
    return np.array(made.c[::-1], dtype=np.float64)


def held_in_doubles(made: Any, knots: Vector, values: Vector, **options: Any) -> Any:
    """Return a spline of SciPy whose coefficients are finite.

    Args:
        made: Class of the spline.
        knots: Its knots, ``(n,)``.
        values: Its values, ``(n, ...)``.
        options: Further arguments.

    Raises:
        ValueError: If a coefficient is beyond the range of a double.
    """
    try:
        with np.errstate(all="ignore"):
            found = made(knots, values, **options)
    except ValueError:
        raise ValueError(_TOO_LARGE) from None
    finite(found.c)
    return found


_TOO_LARGE = (
    "Arguments `knots` and `values` of a table, or `time` and `samples` of a record, must be of "
    "moderate sizes, but its slopes are beyond the range of a double: choose other units."
)


def finite(coefficients: Vector) -> Vector:
    """Return coefficients of a table.

    Args:
        coefficients: The coefficients, of any shape.

    Raises:
        ValueError: If one is beyond the range of a double.
    """
    if not np.all(np.isfinite(coefficients)):
        raise ValueError(_TOO_LARGE)
    return coefficients


def _borders(knots: Vector, coefficients: Vector, *, is_kinked: bool) -> Vector:
    """Return the first columns of a table by the coefficients of its cells: see `CellTable`."""
    lengths = reach_of_cells(knots) if is_kinked else reach(knots, coefficients)
    width, n = np.diff(knots), len(knots) - 1
    guard = np.stack([np.zeros(n), np.ones(n), -1.0 / width])
    guard[:, -1] = 0.0, 1.0, 0.0
    guard[:, 0] = width[0], -1.0, 0.0
    return np.vstack([knots[:-1], guard, width, lengths])


def _require_fit(n_values: int, n_knots: int, what: str = "") -> None:
    if n_values != n_knots:
        raise ValueError(
            f"Arguments `knots` and `values` of a table must fit{what}, but there are {n_knots} "
            f"knots and {n_values} values."
        )


def _held(axis: _Axis, outside: str, *, is_kinked: bool) -> tuple[ca.SX, Vector, bool]:
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
    coefficients = _cells(axis.knots, values, kind)[:, :, None]
    return _polynomials(axis, coefficients, outside, name, is_kinked=kind != "cubic")[0]


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
    parts = _polynomials(axis, coefficients, outside, name, is_kinked=kind != "cubic")
    return ca.dot(ca.vertcat(*values), ca.vertcat(*parts))


def _polynomials(
    axis: _Axis, coefficients: Vector, outside: str, name: str, *, is_kinked: bool
) -> list[ca.SX]:
    """Return functions by the coefficients of their cells, ``(k, n, m)``."""
    x, knots, is_held = _held(axis, outside, is_kinked=is_kinked)
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
        columns=np.vstack([_borders(knots, coefficients, is_kinked=is_kinked), rows]),
        is_kinked=is_kinked,
        refuses=outside == "refuse",
    )
    found = cells.numbers_of(cells.cell(x))
    u, n = x - found[0], len(coefficients)
    own = found[TABLE_HEAD:]
    return [horner(own[k * n : (k + 1) * n], u) for k in range(coefficients.shape[2])]


def horner(coefficients: Sequence[ca.SX], u: ca.SX) -> ca.SX:
    """Return a polynomial.

    Args:
        coefficients: Coefficients by increasing powers.
        u: Its argument.
    """
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
    is_kinked = kind == "linear"
    if outside == "hold" and is_kinked:
        values = np.pad(values, 1, mode="edge")
    held = [_held(axis, outside, is_kinked=is_kinked)[:2] for axis in axes]
    (_, first), (_, second) = held
    along, across = _cells(first, values, kind), _cells(second, values.T, kind)
    every = np.transpose(_cells(second, np.moveaxis(along, 2, 0), kind), (2, 0, 3, 1))
    parts, refuses = (along, across), outside == "refuse"
    return _patches(held, every, parts, name, refuses=refuses, is_kinked=is_kinked)


def _patches(
    axes: Sequence[tuple[ca.SX, Vector]],
    coefficients: Vector,
    parts: Sequence[Vector],
    name: str,
    *,
    refuses: bool,
    is_kinked: bool,
) -> ca.SX:
    """Return a function of two arguments by the coefficients of its cells.

    Args:
        axes: Both arguments with their knots.
        coefficients: Coefficients by the powers of both arguments and by the cells, ``(k, l, n,
            m)``.
        parts: For each argument, coefficients of functions of it alone that make up the function,
            ``(k, n, ...)``.
        name: Name of the table.
        refuses: Whether the function is undefined beyond the knots.
        is_kinked: Whether knots are events.
    """
    ways: list[ca.SX] = []
    cells: list[ca.SX] = []
    for k, (x, knots) in enumerate(axes):
        one = CellTable(
            name=f"argument {k + 1} of the table `{name}`",
            knots=knots,
            columns=_borders(knots, parts[k], is_kinked=is_kinked),
            is_kinked=is_kinked,
            refuses=refuses,
        )
        cells.append(one.cell(x))
        ways.append(x - one.numbers_of(cells[-1])[0])
    order, across = coefficients.shape[:2], coefficients.shape[3]
    columns = coefficients.reshape(order[0] * order[1], -1)
    data = CellTable(name=f"the table `{name}`", knots=np.zeros(0), columns=columns)
    numbers = data.numbers_of(cells[0] * across + cells[1])
    rows = [numbers[i * order[1] : (i + 1) * order[1]] for i in range(order[0])]
    return horner([horner(row, ways[1]) for row in rows], ways[0])


# Tables of CasADi.

_LINEAR = re.compile(
    r"casadi_interpn\(res\[0\], (?P<n>[12]), (?P<knots>\w+), (?P<offsets>\w+), (?P<values>\w+), "
    r"arg\[0\], \w+, (?P<m>\d+),"
)
_SPLINE = re.compile(
    r"nd_boor_eval\)?\(\S+?,(?P<n>[12]),(?P<knots>\w+),(?P<offsets>\w+),(?P<degrees>\w+),\w+,"
    r"(?P<values>\w+),(?P<m>\d+),"
)
"""Use of a table in CasADi's C code."""


def of_interpolant(table: Any, arguments: Sequence[ca.SX]) -> list[ca.SX]:
    """Return a `casadi.interpolant` as a table.

    A linear table goes on beyond its knots. A spline, which jumps to zero there, refuses.

    Args:
        table: The interpolant, linear or a spline, of one or two arguments.
        arguments: Its arguments.

    Raises:
        ValueError: If its knots are unknown, it has more arguments, or it differs from the table.
    """
    generator = ca.CodeGenerator("table")
    generator.add(table)
    text = generator.dump()
    is_spline = table.class_name() == "BSplineInterpolant"
    used = (_SPLINE if is_spline else _LINEAR).search(text)
    if used is None or int(used["n"]) != len(arguments) or "1" not in (used["n"], used["m"]):
        raise ValueError(
            f"Argument `model`: a formula calls the table `{table.name()}`, whose knots are "
            "unknown here: use `zo.table`, of one or two arguments."
        )
    offsets = _whole(text, used["offsets"])
    places = [_array(text, used["knots"])[a:b] for a, b in pairwise(offsets)]
    degrees = _whole(text, used["degrees"]) if is_spline else [1] * len(places)
    if not is_spline:
        # A line is a spline of degree one, whose first and last knots count twice.
        places = [np.concatenate([one[:1], one, one[-1:]]) for one in places]
    m, shape = int(used["m"]), [len(one) - d - 1 for one, d in zip(places, degrees, strict=True)]
    values = _array(text, used["values"]).reshape(*shape[::-1], m)
    outside = "refuse" if is_spline else "extend"
    symbols = [ca.SX.sym("x") for _ in arguments]
    formulas = _of_splines(symbols, places, degrees, values, outside, table.name())
    made: Any = ca.Function(table.name(), symbols, [ca.vertcat(*formulas)])
    _require_same(table, made, [np.unique(one) for one in places])
    value = made(*arguments)
    return [value[k] for k in range(len(formulas))]


def _of_splines(
    arguments: Sequence[ca.SX],
    places: Sequence[Vector],
    degrees: Sequence[int],
    values: Vector,
    outside: str,
    name: str,
) -> list[ca.SX]:
    """Return splines by their coefficients, ``(n, m)`` or ``(n_2, n_1, 1)``.

    Raises:
        ValueError: If a degree is zero, or the degrees differ in smoothness.
    """
    if min(degrees) < 1 or len({degree < 3 for degree in degrees}) > 1:
        raise ValueError(
            f"Argument `model`: a formula calls the table `{name}`, whose degrees {degrees} have "
            "no table here: use degree 1 or 3."
        )
    is_kinked = degrees[0] < 3
    if len(arguments) == 1:
        knots, coefficients = _pieces(places[0], values, degrees[0])
        axis = _Axis(arguments[0], knots)
        return _polynomials(axis, coefficients, outside, name, is_kinked=is_kinked)
    first, along = _pieces(places[0], np.moveaxis(values[:, :, 0], 0, 1), degrees[0])
    second, across = _pieces(places[1], values[:, :, 0], degrees[1])
    _, every = _pieces(places[1], np.moveaxis(along, 2, 0), degrees[1])
    axes = list(zip(arguments, (first, second), strict=True))
    patches = np.transpose(every, (2, 0, 3, 1))
    parts, refuses = (along, across), outside == "refuse"
    return [_patches(axes, patches, parts, name, refuses=refuses, is_kinked=is_kinked)]


def _pieces(places: Vector, values: Vector, degree: int) -> tuple[Vector, Vector]:
    """Return the knots of a spline and the coefficients of its cells, ``(degree + 1, n, ...)``."""
    from scipy.interpolate import BSpline

    made, knots = BSpline(places, values, degree), np.unique(places)
    parts = [made(knots[:-1], nu=k) / math.factorial(k) for k in range(degree + 1)]
    return knots, np.stack(parts)


def _require_same(table: Any, made: Any, knots: Sequence[Vector]) -> None:
    """Refuse formulas that differ from a table at the middle of a cell.

    Raises:
        ValueError: If they differ.
    """
    middles = [(one[1:] + one[:-1]) / 2 for one in knots]
    picked = [one[:: max(1, len(one) // _COMPARED)] for one in middles]
    for at in map(list, product(*picked)):
        found, expected = made(*at).full(), table(at).full().reshape(-1, 1)
        if np.max(np.abs(found - expected)) > _SAME * (1.0 + np.max(np.abs(expected))):
            raise ValueError(f"The formula of the table `{table.name()}` differs from it at {at}.")


def _array(text: str, name: str) -> Vector:
    """Return an array of numbers of C code."""
    entries = re.search(rf"casadi_real {name}\[\d+\] =\s*{{(.*?)}};", text, re.DOTALL)
    return np.array([float(one) for one in ("" if entries is None else entries[1]).split(",")])


def _whole(text: str, name: str) -> list[int]:
    """Return an array of whole numbers of C code."""
    entries = re.search(rf"casadi_int {name}\[\d+\] = {{(.*?)}};", text, re.DOTALL)
    return [int(one) for one in ("" if entries is None else entries[1]).split(",")]
