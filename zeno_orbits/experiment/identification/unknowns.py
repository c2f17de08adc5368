"""What is asked of a fit: the numbers that are sought, and where they begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.experiment.identification.predictions import Unknowns
from zeno_orbits.model.problem import ParameterValues, Problem


@dataclass(frozen=True, slots=True, kw_only=True)
class Sought:
    """A number to be found.

    Attributes:
        names: The parameters that it is the value of; more than one if they are tied together.
        lower: Smallest value.
        upper: Largest value.
    """

    names: tuple[str, ...]
    lower: float
    upper: float

    @property
    def label(self) -> str:
        """Its name: those of its parameters."""
        return "+".join(self.names)


def begin_of(
    problem: Problem, values: ParameterValues, sought: Sequence[Sought]
) -> ParameterValues:
    """Return the numbers to start from: every sought one inside its range, tied ones equal.

    Raises:
        InputError: If a name or a range cannot be.
    """
    if not sought:
        raise InputError("Argument `fit` must name a parameter, but it names none.")
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
                raise InputError(f"Argument `fit` must name `{name}` once, but it does so twice.")
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


def unknowns_of(problem: Problem, begin: ParameterValues, sought: Sequence[Sought]) -> Unknowns:
    """Return what is sought as places in gains and parameters."""
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
