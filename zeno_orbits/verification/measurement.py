"""Quantities of an orbit, measured in a simulation from its data alone.

A search computes these quantities with its NLP. This module is independent of the NLP.
"""

from __future__ import annotations

from collections.abc import Sequence

from zeno_orbits.errors import InputError, SimulationError, not_known
from zeno_orbits.model import HybridDynamics, Problem, bind
from zeno_orbits.orbits import Cycle, Orbit, orbit_multipliers, place_on_section
from zeno_orbits.simulation import Extent, SimulationSettings, extent_of, signal, signal_names
from zeno_orbits.verification.claim import Claim, claim_of
from zeno_orbits.verification.cross_checks import energies_of
from zeno_orbits.verification.integration import FirstCycle, observe
from zeno_orbits.verification.residuals import margins_of

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
    claim = claim_of(orbit, problem)
    values = orbit.values(problem)
    compiled = problem.compiled()
    dynamics = bind(compiled, values.vector)
    seen = observe(dynamics, claim, simulation, 1)
    first = seen.first
    if first is None:
        raise SimulationError(seen.trouble, time=0.0, state=tuple(claim.start.tolist()))
    found: dict[str, Extent] = {}
    for name in dict.fromkeys(names):
        if name in NUMBERS:
            found[name] = _number(name, orbit, problem, dynamics, claim, first, simulation)
        else:
            value = signal(compiled, name).at(values.vector)
            found[name] = extent_of(value, first.cycle.execution.arcs)
    return found


def _number(
    name: str,
    orbit: Orbit,
    problem: Problem,
    dynamics: HybridDynamics,
    claim: Claim,
    first: FirstCycle,
    simulation: SimulationSettings,
) -> Extent:
    error, cycle = 0.0, first.cycle
    if name == "period":
        value = cycle.end.time
    elif name == "energy":
        value = energies_of(orbit, problem, claim, cycle, simulation).values["input_work"]
    elif name == "margin":
        value = measured_smallest_share(dynamics, cycle)
    elif name == "spectral_radius":
        multipliers = orbit_multipliers(
            dynamics,
            place_on_section(dynamics, claim.shape, claim.start),
            scale=first.scale,
            period=cycle.end.time,
            settings=simulation,
            shape=claim.shape,
        )
        value, error = multipliers.spectral_radius, multipliers.error
    else:
        margins = margins_of(dynamics, first)
        if name not in margins:
            wanted = f"must name a quantity of the shape `{claim.shape.text}`"
            raise InputError(f"Argument `names` {wanted}, but it names `{name}`.")
        value = margins[name]
    return Extent(lowest=value, highest=value, error=error)


def measured_smallest_share(dynamics: HybridDynamics, cycle: Cycle) -> float:
    r"""Return the smallest margin of all phases, relative to its largest possible value.

    The contact duration is relative to the period. :math:`-\ddot h` at the Zeno point is relative
    to its largest value in the contact phase. The speed of the first impact is relative to its
    largest value in the first flight. Theory (5.3).
    """
    shares: list[float] = []
    for phase in cycle.phases:
        speed = extent_of(dynamics.gap_rate, [phase.flight])
        shares.append(-phase.impacts[0].approach_rate / speed.largest)
        if phase.zeno is not None and phase.locked is not None:
            push = extent_of(dynamics.gap_acceleration, [phase.locked])
            shares.append((phase.end.time - phase.zeno.time) / cycle.end.time)
            shares.append(-dynamics.gap_acceleration(phase.zeno.state) / push.largest)
    return min(shares)
