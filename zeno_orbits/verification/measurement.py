"""Quantities of an orbit, measured in a simulation from its data alone.

A search computes these quantities with its NLP. This module is independent of the NLP.
"""

from __future__ import annotations

from collections.abc import Sequence

from zeno_orbits.errors import InputError, SimulationError, not_known
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.simulation import Extent, SimulationSettings, extent_of, signal, signal_names
from zeno_orbits.verification.claim import Case
from zeno_orbits.verification.energies import energies_of
from zeno_orbits.verification.integration import Run, followed
from zeno_orbits.verification.margins import margins_of, smallest_share
from zeno_orbits.verification.multipliers import multipliers_along
from zeno_orbits.verification.residuals import sizes_along

MARGINS = ("gap_acceleration", "first_impact_speed", "release_transversality", "locked_time")
"""Distances to loss of existence of an orbit, as in its certificate."""

NUMBERS = ("period", "energy", "spectral_radius", "margin", *MARGINS)
"""Scalar quantities of a whole orbit."""


def quantity_names(problem: Problem) -> tuple[str, ...]:
    """Return the names of all quantities of an orbit of a problem."""
    return (*signal_names(problem.compiled()), *NUMBERS)


def require_quantities(names: Sequence[str], problem: Problem, argument: str) -> None:
    """Reject a name that is not a quantity of the problem.

    Args:
        names: The names.
        problem: The problem.
        argument: Argument with the names, for the message.

    Raises:
        InputError: If a name is not a quantity. The message lists the quantities.
    """
    known = quantity_names(problem)
    for name in names:
        if name not in known:
            raise InputError(f"Argument `{argument}`: {not_known(name, known)}")


def measure(
    orbit: Orbit,
    problem: Problem,
    names: Sequence[str],
    *,
    simulation: SimulationSettings | None = None,
) -> dict[str, Extent]:
    """Return the range of quantities over one simulated period.

    Args:
        orbit: The orbit.
        problem: Its problem.
        names: Quantities to measure, from `quantity_names`.
        simulation: Accuracy.

    Raises:
        InputError: If a name is not a quantity of the problem.
        SimulationError: If the motion does not return to the release.
    """
    require_quantities(names, problem, "names")
    simulation = simulation or SimulationSettings()
    one = Case.of(orbit, problem, None)
    run = followed(one.graph, one.claim, one.start, simulation, 1)
    if not run.periods:
        raise SimulationError(run.trouble, time=0.0, state=tuple(one.start.tolist()))
    found: dict[str, Extent] = {}
    for name in dict.fromkeys(names):
        if name in NUMBERS:
            found[name] = _number(name, one, run, simulation)
        else:
            value = signal(problem.compiled(), name).at(orbit.values(problem).vector)
            found[name] = extent_of(value, run.periods[0].arcs)
    return found


def _number(name: str, one: Case, run: Run, simulation: SimulationSettings) -> Extent:
    error, first, graph = 0.0, run.periods[0], one.graph
    if name == "period":
        value = first.end
    elif name == "energy":
        value = energies_of(graph, first).values["input_work"]
    elif name == "spectral_radius":
        multipliers = multipliers_along(graph, one.claim, run, simulation)
        value, error = multipliers.spectral_radius, multipliers.error
    elif name == "margin":
        value = smallest_share(graph, first)
    else:
        value = margins_of(graph, first, sizes_along(first, graph, one.problem)).get(name)
    if value is None:
        wanted = f"must name a quantity of the events `{', '.join(one.claim.sequence)}`"
        raise InputError(f"Argument `names` {wanted}, but it names `{name}`.")
    return Extent(lowest=value, highest=value, error=error)
