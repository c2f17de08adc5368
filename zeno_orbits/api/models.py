"""Studies of a problem without an orbit: Theorem 1, reduced models and work-precision studies.

The list of the bundled problems is also here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from zeno_orbits.api.inputs import Named, Numbers, front_door, known_problem
from zeno_orbits.errors import InputError
from zeno_orbits.model import ParameterValues, Problem, bundled_problems, load_problem
from zeno_orbits.work import Progress, silent

if TYPE_CHECKING:
    from zeno_orbits.precision import ReductionCost, WorkPrecision, WorkPrecisionSettings
    from zeno_orbits.proof import EquilibriumReport


def bundled_names() -> tuple[str, ...]:
    """Return the names of the bundled problems."""
    return tuple(bundled_problems())


def all_problems() -> list[Problem]:
    """Return the bundled problems, each with its reduced models."""
    return [one for name in bundled_problems() for one in load_problem(name).ladder()]


@front_door
def compile_problem(problem: Named) -> None:
    """Compile the formulas of a problem into the cache of this machine.

    Executions take about a third less time, with identical results. Later runs and other processes
    find the compiled formulas automatically. A compilation takes about a second.

    Args:
        problem: The problem, its name or its file.

    Raises:
        InputError: If the formulas cannot be compiled. The message gives the reason.
    """
    from zeno_orbits.simulation import compile_formulas

    known = known_problem(problem)
    reason = compile_formulas(known.compiled_graph())
    if reason:
        raise InputError(f"The formulas of `{known.name}` are not compiled: {reason}.")


@front_door
def equilibrium_acceleration(
    problem: Named, *, gains: Numbers | None = None, parameters: Numbers | None = None
) -> Any:
    r"""Return :math:`\ddot h` at a Zeno equilibrium as a SymPy formula with the values inserted.

    Theorem 1: impacts accumulate near an equilibrium with a negative value.

    Args:
        problem: The problem, its name or its file.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.

    Raises:
        InputError: If a name is unknown or a value is out of range.
    """
    from zeno_orbits.model import formulas

    known = known_problem(problem)
    values = known.values(gains=gains, parameters=parameters)
    return formulas.with_numbers(formulas.acceleration_formula(known), values)


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenoCondition:
    """Theorem 1 for a problem at fixed values.

    Attributes:
        problem: The problem.
        values: Its gains and parameters.
        formula: The acceleration of the gap at a Zeno equilibrium, in symbols.
        with_values: The same formula with the values inserted.
        equilibrium: Theorem 1 at one state, if one was named.
        sources: Parts of the machine that supply energy by a sign, as sentences.
    """

    problem: Problem
    values: ParameterValues
    formula: Any
    with_values: Any
    equilibrium: EquilibriumReport | None
    sources: tuple[str, ...] = ()

    @property
    def always(self) -> bool | None:
        """True or False if the sign is the same at every equilibrium, otherwise None."""
        return bool(self.with_values < 0) if self.with_values.is_number else None

    @property
    def text(self) -> str:
        """Formula with the values inserted, to six digits."""
        from zeno_orbits.model import six_digits

        return six_digits(self.with_values)

    def as_json(self) -> dict[str, Any]:
        """Return the condition as plain data."""
        coefficients = self.with_values.as_coefficients_dict().items()
        point = self.equilibrium
        return {
            "problem": self.problem.name,
            "restitution": self.problem.first_system(self.values).restitution,
            "formula": str(self.formula),
            "numbers": self.text,
            "coefficients": {str(term): float(factor) for term, factor in coefficients},
            "parameters": dict(self.values.parameters),
            **({"energy_sources": list(self.sources)} if self.sources else {}),
            **({} if point is None else {"at": _equilibrium_json(self.problem, point)}),
        }


@front_door
def zeno_condition(
    problem: Named,
    *,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    at: Numbers | None = None,
) -> ZenoCondition:
    """Return Theorem 1 for a problem, and for one state if it is named.

    Args:
        problem: The problem, its name or its file.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        at: State name to value of the equilibrium, 0 for the others. The cosine of a clock is 1 if
            the argument names neither of its two states.

    Raises:
        InputError: If a name is unknown or a value is out of range, or the restitution is 1.
    """
    from zeno_orbits.model import acceleration_formula, energy_sources, with_numbers

    known = known_problem(problem)
    values = known.values(gains=gains, parameters=parameters)
    known.require_zeno_points(values)
    formula = acceleration_formula(known)
    return ZenoCondition(
        problem=known,
        values=values,
        formula=formula,
        with_values=with_numbers(formula, values),
        equilibrium=_equilibrium(known, values, at) if at else None,
        sources=tuple(one.text for one in energy_sources(known, values)),
    )


def _equilibrium(
    problem: Problem, values: ParameterValues, named: Mapping[str, float]
) -> EquilibriumReport:
    """Return Theorem 1 at the state that was named."""
    from zeno_orbits.proof import equilibrium_report

    state = list(problem.state_vector(named))
    clock = problem.clock
    if clock and not any(problem.state_names[k] in named for k in clock):
        state[clock[0]] = 1.0
    return equilibrium_report(problem, values, state)


def _equilibrium_json(problem: Problem, point: EquilibriumReport) -> dict[str, Any]:
    def named(numbers: Sequence[float]) -> dict[str, float]:
        return dict(zip(problem.state_names, numbers, strict=True))

    found = point.neighbourhood
    return {
        "state": named(point.state),
        "gap": point.gap,
        "gap_rate": point.gap_rate,
        "gap_acceleration": point.gap_acceleration,
        "is_zeno_equilibrium": point.is_zeno_equilibrium,
        "has_zeno_executions": point.has_zeno_executions,
        "eigenvalues": [[one.real, one.imag] for one in point.eigenvalues],
        "neighbourhood": found
        and {
            "radii": named(found.radii),
            "gap": found.gap,
            "gap_rate": found.gap_rate,
            "duration": found.duration,
            "pull": list(found.pull),
        },
    }


@front_door
def reduced_model_errors(
    problem: Named,
    *,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    measure: bool = False,
) -> list[ReductionCost]:
    """Return the estimated errors of a problem's reduced models.

    Args:
        problem: The problem, its name or its file.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        measure: True also measures the errors against the orbit of the full problem.

    Raises:
        InputError: If a name is unknown, or no reduced models exist for the problem.
    """
    from zeno_orbits.precision import errors_of_reduced_models

    known = known_problem(problem)
    values = known.values(gains=gains, parameters=parameters)
    if not known.fidelities:
        message = f"must have reduced models, but `{known.name}` lacks them"
        raise InputError(f"Argument `problem` {message}.")
    return list(errors_of_reduced_models(known, values, measure=measure).values())


@front_door
def work_precision(
    problem: Named,
    *,
    until: float | None = None,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    quick: bool = False,
    settings: WorkPrecisionSettings | None = None,
    on_progress: Progress = silent,
) -> WorkPrecision:
    """Return a work-precision study: error and processor time of many settings.

    Args:
        problem: The problem, its name or its file.
        until: End time of the simulations [s].
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        start: State name to initial value, 0 for the others. The default is the problem's first
            start.
        quick: True selects few settings and one run of each.
        settings: Extent of the study. It overrides ``quick``.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If a name is unknown or a value is out of range.
        SimulationError: If the reference solution cannot be computed.
    """
    from zeno_orbits.precision import QUICK, WorkPrecisionSettings, measure_work_precision

    known = known_problem(problem)
    values = known.values(gains=gains, parameters=parameters)
    state = known.initial_state(start, values)
    chosen = settings or (QUICK if quick else WorkPrecisionSettings())
    if until is not None:
        chosen = replace(chosen, until=until)
    return measure_work_precision(known, values, state, settings=chosen, on_progress=on_progress)
