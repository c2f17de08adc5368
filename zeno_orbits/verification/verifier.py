"""Check an orbit by forward integration from its data alone.

The check is independent of the method that found the orbit. The problem is rebuilt from the orbit's
parameters and gains. The completed system is simulated over several periods, from the start of the
period. The result is compared with the orbit's data. Residuals are relative (theory (3.4), (3.7)).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from zeno_orbits.errors import SimulationError, ZenoOrbitsError, require_counts
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model import HybridDynamics, Problem, graph_of, load_reference
from zeno_orbits.orbits import (
    Multipliers,
    Orbit,
    PhaseKind,
    orbit_multipliers,
    other_equations,
    place_on_section,
)
from zeno_orbits.simulation import SimulationSettings
from zeno_orbits.verification.certificate import DeltaCut, OrbitCertificate
from zeno_orbits.verification.claim import Claim, claim_of
from zeno_orbits.verification.cross_checks import (
    Accumulation,
    cut_order,
    delta_sweep,
    energies_of,
    second_model,
)
from zeno_orbits.verification.integration import FirstCycle, Observation, decisive, observe
from zeno_orbits.verification.residuals import escapes_of, margins_of, orbit_residuals
from zeno_orbits.verification.second_net import sampled_guards
from zeno_orbits.work import Checked, Progress, checked, silent


@dataclass(frozen=True, slots=True, kw_only=True)
class VerificationSettings(Checked):
    """Accuracy and extent of a verification.

    Attributes:
        tolerance: Largest residual that passes.
        n_periods: Number of periods to integrate.
        simulation: Accuracy of the integration.
        cuts: Thresholds of the delta sweep, in units of the first impact speed.
        use_reference: Integrate the problem's hand-written model instead of the derived model.
    """

    tolerance: float = 1e-9
    n_periods: int = 3
    simulation: SimulationSettings = field(default_factory=SimulationSettings)
    cuts: tuple[float, ...] = (3e-2, 3e-3, 3e-4, 3e-5)
    use_reference: bool = False

    def __post_init__(self) -> None:
        """Refuse values of a wrong kind, and no period."""
        Checked.__post_init__(self)
        require_counts(n_periods=self.n_periods)


_SHARE = 0.1
"""Conservative ratio between the errors of the finer and of the looser integration."""


_MULTIPLIERS = 1e-10
"""Relative local error for multipliers. A smaller error costs more without being useful."""


def verify(
    orbit: Orbit,
    problem: Problem,
    *,
    settings: VerificationSettings | None = None,
    dynamics: HybridDynamics | None = None,
    on_progress: Progress = silent,
) -> OrbitCertificate:
    """Return the certificate of an orbit.

    Args:
        orbit: The orbit. Its own certificate and multipliers are ignored.
        problem: Its problem.
        settings: Tolerance, number of periods and accuracy.
        dynamics: The system to integrate. By default it is the problem's system at the orbit's
            parameter values.
        on_progress: Called with the name of each stage as it begins.

    Raises:
        InputError: If the orbit does not fit the problem.
    """
    settings = settings or VerificationSettings()
    claim = claim_of(orbit, problem)
    if dynamics is None:
        dynamics = problem_dynamics(orbit, problem, use_reference=settings.use_reference)
    on_progress("integrating the orbit", None)
    n_periods, enough = settings.n_periods, settings.tolerance

    def observed(simulation: SimulationSettings) -> tuple[Observation, dict[str, float]]:
        seen = observe(dynamics, claim, simulation, n_periods, enough)
        return seen, orbit_residuals(dynamics, problem, claim, seen)

    (seen, residuals), simulation = decisive(observed, _worst, settings.simulation, enough)
    settings = replace(settings, simulation=simulation)
    multipliers: Multipliers | None = None
    again = _CrossChecks()
    if seen.first is not None:
        again = _cross_checks(orbit, problem, dynamics, claim, seen.first, settings, on_progress)
        residuals = _worse(residuals, again.residuals)
        residuals["integration"] = seen.integration_error
        on_progress("computing the multipliers", None)
        with suppress(ZenoOrbitsError):
            multipliers = _multipliers(dynamics, claim, seen.first, settings, seen)
    stable = multipliers is not None and multipliers.spectral_radius < 1.0
    trouble = seen.trouble
    if not stable:
        # Rounding errors grow along an unstable orbit, so later returns are meaningless.
        residuals.pop("drift", None)
        trouble = trouble if multipliers is None else ""
    clauses = [trouble, *_contradictions(orbit, problem, dynamics, seen)]
    return OrbitCertificate(
        tolerance=settings.tolerance,
        residuals=residuals,
        margins=margins_of(dynamics, seen.first),
        energies=again.energies,
        multipliers=() if multipliers is None else multipliers.values,
        multiplier_error=math.inf if multipliers is None else multipliers.error,
        delta_sweep=again.sweep,
        delta_order=cut_order(again.sweep, seen.integration_error),
        integration_error=seen.integration_error,
        zeno_error=math.inf if seen.first is None else seen.first.zeno_error,
        period=math.nan if seen.first is None else seen.first.cycle.end.time,
        n_periods=settings.n_periods,
        model="reference" if settings.use_reference else "derived",
        trouble="; ".join(clause for clause in clauses if clause),
        shape=claim.shape.text,
        open_balance=not problem.is_balanced,
    )


def _worst(observed: tuple[Observation, Mapping[str, float]]) -> float:
    """Return the largest residual and integration error, infinite without a period."""
    seen, residuals = observed
    return max(*residuals.values(), seen.integration_error) if seen.first else math.inf


def _worse(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    """Return the union of two sets of residuals, with the larger value of common residuals."""
    return {**one, **{name: max(size, one.get(name, size)) for name, size in other.items()}}


@dataclass(frozen=True, slots=True, kw_only=True)
class _CrossChecks:
    """Results of the integrations that repeat the first period in another way."""

    residuals: dict[str, float] = field(default_factory=dict[str, float])
    energies: Mapping[str, float] = field(default_factory=dict[str, float])
    sweep: tuple[DeltaCut, ...] = ()


def _cross_checks(
    orbit: Orbit,
    problem: Problem,
    dynamics: HybridDynamics,
    claim: Claim,
    first: FirstCycle,
    settings: VerificationSettings,
    on_progress: Progress,
) -> _CrossChecks:
    simulation, residuals = settings.simulation, dict[str, float]()
    on_progress("sampling gap and multiplier", None)
    cycle = first.cycle
    residuals |= sampled_guards(graph_of(dynamics), cycle.execution.arcs, cycle.end.time)
    on_progress("cutting the impact sequence", None)
    accumulations = [
        Accumulation(dynamics=dynamics, impacts=phase.impacts, contact=phase.locked)
        for phase in cycle.phases
        if phase.kind is PhaseKind.ZENO and phase.locked is not None
    ]
    enough = settings.tolerance / 10.0
    sweep = delta_sweep(dynamics, accumulations, first.scale, settings.cuts, simulation, enough)
    if sweep:
        residuals["delta_sweep"] = sweep[-1].error
    on_progress("balancing the energy", None)
    energies: Mapping[str, float] = {}
    try:
        found = energies_of(orbit, problem, claim, first.cycle, simulation)
        energies = found.values
        if problem.is_balanced:
            residuals["energy_balance"] = found.imbalance
    except ZenoOrbitsError:
        residuals["energy_balance"] = math.inf
    if problem.reference is not None:
        on_progress("comparing two derivations of the model", None)
        values, times = orbit.values(problem), np.linspace(0.0, cycle.end.time, 41)
        struck = [impact.state_minus for impact in cycle.impacts]
        states = np.array([*cycle.execution.states_at(times), *struck])
        by_hand = load_reference(problem).dynamics(values)
        residuals["second_model"] = second_model(by_hand, [(problem.dynamics(values), states)])
    return _CrossChecks(residuals=residuals, energies=energies, sweep=sweep)


def _contradictions(
    orbit: Orbit, problem: Problem, dynamics: HybridDynamics, seen: Observation
) -> Iterator[str]:
    """Yield clauses on false statements in an orbit's data, and on coordinates that escape."""
    if other := other_equations(orbit.problem_digest, problem):
        yield other
    shape = orbit.shape.at_restitution(dynamics.restitution)
    if shape != orbit.shape:
        at = f"at restitution {dynamics.restitution:g} it is `{shape.text}`"
        yield f"the orbit says that its shape is `{orbit.shape.text}`, but {at}"
    if dynamics.restitution == 1.0 and not shape.without_contact:
        yield f"elastic impacts have no Zeno point, but the orbit has the shape `{shape.text}`"
    if seen.first is not None:
        yield from (phrase for _, phrase in escapes_of(problem, seen.first.largest).values())


@checked
def with_certificate(orbit: Orbit, certificate: OrbitCertificate) -> Orbit:
    """Return the orbit with a certificate and its multipliers in it."""
    return replace(
        orbit,
        certificate=certificate.as_json(),
        floquet_multipliers=certificate.multipliers,
    )


def problem_dynamics(
    orbit: Orbit, problem: Problem, *, use_reference: bool = False
) -> HybridDynamics:
    """Return the system of an orbit, derived from energies or written by hand.

    Args:
        orbit: The orbit. The system has its gains and parameters.
        problem: Its problem.
        use_reference: Use the problem's hand-written model.

    Raises:
        InputError: If the orbit's parameter values do not fit the problem, or the problem does not
            have a hand-written model.
    """
    values = orbit.values(problem)
    if use_reference:
        return load_reference(problem).dynamics(values)
    return problem.dynamics(values)


def multipliers_of(
    orbit: Orbit, problem: Problem, *, settings: VerificationSettings | None = None
) -> Multipliers:
    """Return the multipliers of an orbit as `verify` computes them, without its other checks.

    Args:
        orbit: The orbit. Its own multipliers are ignored.
        problem: Its problem.
        settings: Accuracy.

    Raises:
        InputError: If the orbit does not fit the problem.
        SimulationError: If the orbit does not return.
    """
    settings = settings or VerificationSettings()
    claim, dynamics = claim_of(orbit, problem), problem_dynamics(orbit, problem)
    seen = observe(dynamics, claim, settings.simulation, 1)
    if seen.first is None:
        raise SimulationError(seen.trouble, time=claim.period, state=tuple(claim.start))
    return _multipliers(dynamics, claim, seen.first, settings, seen)


def _multipliers(
    dynamics: HybridDynamics,
    claim: Claim,
    first: FirstCycle,
    settings: VerificationSettings,
    seen: Observation,
) -> Multipliers:
    return orbit_multipliers(
        dynamics,
        place_on_section(dynamics, claim.shape, claim.start),
        scale=first.scale,
        period=first.cycle.end.time,
        settings=replace(settings.simulation, tolerance=_no_finer(settings.simulation.tolerance)),
        noise=seen.integration_error * _SHARE,
        shape=claim.shape,
    )


def _no_finer(tolerance: Tolerance) -> Tolerance:
    """Return a tolerance sufficient for multipliers, of which eight digits are used."""
    return Tolerance(
        relative=max(tolerance.relative, _MULTIPLIERS),
        absolute=max(tolerance.absolute, _MULTIPLIERS / 10),
    )
