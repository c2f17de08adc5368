"""The unknowns of a fit: parameters with ranges, initial values and indices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.model import ParameterValues, Problem


@dataclass(frozen=True, slots=True, kw_only=True)
class Unknown:
    """A parameter of a fit.

    Attributes:
        names: The fitted parameter, or several parameters that are tied together.
        lower: Smallest value.
        upper: Largest value.
    """

    names: tuple[str, ...]
    lower: float
    upper: float

    @property
    def label(self) -> str:
        """Name of the unknown: the names of its parameters."""
        return "+".join(self.names)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Unknowns:
    """The unknowns of a fit as indices into gains and parameters.

    The fit itself varies the parameters, relative to their scales, and a shift of the phase.

    Attributes:
        base: Gains, then parameters, at the start, ``(n_p,)``.
        places: Indices of the ``m`` parameters that vary.
        ties: Matrix from unknowns to the parameters that vary, ``(m, k)``.
        start: Initial values of the unknowns, ``(k,)``.
        scale: Scales of the unknowns, ``(k,)``.
        lower: Lower bounds of the unknowns, ``(k,)``.
        upper: Upper bounds of the unknowns, ``(k,)``.
    """

    base: Vector
    places: tuple[int, ...]
    ties: Vector
    start: Vector
    scale: Vector
    lower: Vector
    upper: Vector

    @property
    def first(self) -> Vector:
        """The unknowns at the start, ``(k + 1,)``: numbers over their sizes, and no shift."""
        return np.append(self.start / self.scale, 0.0)

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        """Least and greatest unknowns, each ``(k + 1,)``."""
        return np.append(self.lower / self.scale, -0.5), np.append(self.upper / self.scale, 0.5)

    def numbers(self, x: Vector) -> Vector:
        """Return the parameter values at unknowns of the fit, ``(k,)``."""
        return x[:-1] * self.scale

    def p_at(self, x: Vector) -> Vector:
        """Return gains and parameters at unknowns of the fit."""
        p = self.base.copy()
        p[list(self.places)] = self.ties @ self.numbers(x)
        return p


def begin_of(
    problem: Problem, values: ParameterValues, sought: Sequence[Unknown]
) -> ParameterValues:
    """Return the initial values: every unknown inside its range, tied parameters equal.

    Args:
        problem: The problem.
        values: All parameter values of the problem.
        sought: The unknowns.

    Raises:
        InputError: If a name or a range is invalid.
    """
    if not sought:
        raise InputError("Argument `fit` must name a parameter.")
    taken: list[str] = []
    parameters = dict(values.parameters)
    for one in sought:
        for name in one.names:
            if name not in parameters:
                known = ", ".join(parameters)
                hint = "; gains are known" if name in values.gains else ""
                message = f"must name parameters ({known}), but it names `{name}`{hint}"
                raise InputError(f"Argument `fit` {message}.")
            if name in taken:
                raise InputError(f"Argument `fit` must name `{name}` once, not twice.")
            taken.append(name)
        if not one.lower < one.upper:
            bounds = f"[{one.lower:g}, {one.upper:g}]"
            wanted = f"must have a range LOW:HIGH for `{one.label}`"
            raise InputError(f"Argument `fit` {wanted}, but it is {bounds}.")
        value = parameters[one.names[0]]
        if not one.lower < value < one.upper:
            value = (one.lower + one.upper) / 2
        parameters |= dict.fromkeys(one.names, value)
    return problem.values(gains=values.gains, parameters=parameters)


def unknowns_of(problem: Problem, begin: ParameterValues, sought: Sequence[Unknown]) -> Unknowns:
    """Return the unknowns as indices into gains and parameters.

    Args:
        problem: The problem.
        begin: All initial parameter values.
        sought: The unknowns.
    """
    names = [name for one in sought for name in one.names]
    ties = np.array([[float(name in one.names) for one in sought] for name in names])
    start = np.array([begin.parameters[one.names[0]] for one in sought])
    return Unknowns(
        base=np.array(begin.vector, dtype=np.float64),
        places=tuple(problem.names.index(name) for name in names),
        ties=ties,
        start=start,
        scale=np.where(start != 0.0, np.abs(start), 1.0),
        lower=np.array([one.lower for one in sought]),
        upper=np.array([one.upper for one in sought]),
    )
