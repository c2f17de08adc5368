"""Check an orbit by forward integration from its data alone.

The check is independent of the method that found the orbit. The problem is rebuilt from the orbit's
parameters and gains. The completed system is simulated over several periods, from the start of the
period. The result is compared with the orbit's data. Residuals are relative (theory (3.4), (3.9)).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError, ZenoOrbitsError, require_counts
from zeno_orbits.model import GraphDynamics, HybridDynamics, Problem, load_reference
from zeno_orbits.orbits import (
    Multipliers,
    Orbit,
    extrapolated,
    other_equations,
    time_blur,
)
from zeno_orbits.simulation import SimulationSettings
from zeno_orbits.verification.certificate import DeltaCut, OrbitCertificate
from zeno_orbits.verification.claim import Case
from zeno_orbits.verification.cross_checks import (
    accumulations_of,
    cut_order,
    delta_sweep,
    second_model,
)
from zeno_orbits.verification.energies import EXACT, QUICK, PeriodEnergies, energies_of
from zeno_orbits.verification.integration import (
    Period,
    Run,
    decisive,
    distance,
    error_by_repetition,
    followed,
)
from zeno_orbits.verification.margins import margins_of
from zeno_orbits.verification.multipliers import multipliers_along
from zeno_orbits.verification.residuals import (
    constraints_along,
    escapes_of,
    event_misses,
    impact_laws,
    largest_along,
    nothing_returns,
    off_section,
    sizes_along,
    unlisted_impacts,
)
from zeno_orbits.verification.second_net import GuardRanges, sampled_guards
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
_SHORTER_TAIL = 1e-2
"""Factor on the speed to which impacts are resolved, if the work in their tails is too inexact."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Observation:
    """The integrated orbit.

    Attributes:
        run: The integration.
        scale: Size of each state along the first period, ``(n_x,)``, empty without a period.
        residuals: Residuals of this integration.
        integration_error: Relative difference from an integration at a looser tolerance.
        blur: The part of it that the rounding of times explains.
    """

    run: Run
    scale: Vector
    residuals: Mapping[str, float]
    integration_error: float = math.inf
    blur: float = 0.0

    @property
    def first(self) -> Period | None:
        """The first period, if it is over."""
        return next(iter(self.run.periods), None)

    @property
    def worst(self) -> float:
        """The largest residual or error."""
        return max(*self.residuals.values(), self.integration)

    @property
    def integration(self) -> float:
        """The part of the error that tolerances cause."""
        return max(0.0, self.integration_error - self.blur)


def verify(
    orbit: Orbit,
    problem: Problem,
    *,
    settings: VerificationSettings | None = None,
    dynamics: HybridDynamics | GraphDynamics | None = None,
    on_progress: Progress = silent,
) -> OrbitCertificate:
    """Return the certificate of an orbit.

    Args:
        orbit: The orbit. Its own certificate and multipliers are ignored.
        problem: Its problem.
        settings: Tolerance, number of periods and accuracy.
        dynamics: The machine to integrate. By default it is the problem's machine at the orbit's
            parameter values. Powers and energies come from the problem.
        on_progress: Called with the name of each stage as it begins.

    Raises:
        InputError: If the orbit does not fit the problem.
    """
    asked = settings or VerificationSettings()
    one = Case.of(orbit, problem, dynamics, use_reference=asked.use_reference)
    on_progress("integrating the orbit", None)

    def observed(simulation: SimulationSettings) -> _Observation:
        return _observed(one, replace(asked, simulation=simulation))

    seen, simulation = decisive(
        observed, lambda seen: seen.worst, asked.simulation, asked.tolerance
    )
    settings = replace(asked, simulation=simulation)
    known, again, residuals = Multipliers.unknown(), _CrossChecks(), dict(seen.residuals)
    if seen.first is None:
        residuals |= off_section(one, GuardRanges(one.graph), None, seen.scale)
    else:
        again = _cross_checks(one, seen, seen.first, settings, on_progress)
        residuals |= again.residuals
        on_progress("computing the multipliers", None)
        noise = _SHARE * seen.integration_error
        with suppress(ZenoOrbitsError):
            known = multipliers_along(one.graph, one.claim, seen.run, simulation, noise)
    trouble = seen.run.trouble
    if not known.spectral_radius < 1.0 or (not known.values and math.isinf(known.error)):
        # Rounding errors grow along an unstable orbit, so later returns are meaningless.
        residuals.pop("drift", None)
        trouble = "" if known.values else trouble
    clauses = [trouble, *_contradictions(one, seen.first)]
    errors = [point.limit_error for point in seen.first.zeno_points] if seen.first else [math.inf]
    return OrbitCertificate(
        tolerance=settings.tolerance,
        residuals={name: float(value) for name, value in residuals.items()},
        margins=again.margins,
        energies=again.energies,
        multipliers=known.values,
        multiplier_error=known.error,
        delta_sweep=again.sweep,
        delta_order=cut_order(again.sweep, seen.integration_error),
        integration_error=seen.integration_error,
        zeno_error=max(errors, default=0.0),
        period=math.nan if seen.first is None else seen.first.end,
        n_periods=settings.n_periods,
        model="reference" if settings.use_reference else "derived",
        trouble="; ".join(clause for clause in clauses if clause),
        shape=orbit.phases_as.text if orbit.phases_as else "",
        open_balance=not _is_balanced(one.own),
        events=orbit.sequence,
        quantities=again.quantities,
        unlisted=unlisted_impacts(one.claim, seen.first) if seen.first else 0,
    )


def _observed(one: Case, settings: VerificationSettings) -> _Observation:
    """Return the integrated orbit with the residuals of the integration itself."""
    graph, claim, n_periods = one.graph, one.claim, settings.n_periods
    run = followed(graph, claim, one.start, settings.simulation, n_periods)
    if not run.periods:
        return _Observation(run=run, scale=one.start[:0], residuals=nothing_returns(claim))
    first, scale = run.periods[0], sizes_along(run.periods[0], graph, one.problem)
    misses = event_misses(graph, claim, first, scale)
    misses["period"] = abs(first.end - claim.period) / claim.period
    if len(run.periods) == n_periods:
        misses["drift"] = max(distance(one.state, claim.start, scale) for one in run.periods)
    blur = time_blur(first.arcs, graph, first.end, scale)
    residuals = {
        **{name: max(0.0, miss - blur) for name, miss in misses.items()},
        **impact_laws(graph, first),
        **constraints_along(graph, first),
    }

    def difference(looser: SimulationSettings) -> float:
        others = followed(graph, claim, one.start, looser, 1).periods
        if not others:
            return math.inf
        later = abs(others[0].end - first.end) / first.end
        return max(distance(others[0].state, first.state, scale), later)

    error = error_by_repetition(difference, settings.simulation, settings.tolerance)
    return _Observation(
        run=run, scale=scale, residuals=residuals, integration_error=error, blur=blur
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _CrossChecks:
    """Results that need the first period: residuals, margins, energies, truncations."""

    residuals: Mapping[str, float] = field(default_factory=dict[str, float])
    margins: Mapping[str, float] = field(default_factory=dict[str, float])
    energies: Mapping[str, float] = field(default_factory=dict[str, float])
    quantities: Mapping[str, tuple[float, float]] = field(
        default_factory=dict[str, tuple[float, float]]
    )
    sweep: tuple[DeltaCut, ...] = ()


def _cross_checks(
    one: Case,
    seen: _Observation,
    first: Period,
    settings: VerificationSettings,
    on_progress: Progress,
) -> _CrossChecks:
    graph, problem, simulation = one.graph, one.problem, settings.simulation
    arcs = () if seen.run.execution is None else seen.run.execution.arcs
    on_progress("sampling all guards", None)
    ranges = sampled_guards(graph, first.arcs, first.duration)
    residuals = ranges.residuals()
    residuals |= off_section(one, ranges, first, seen.scale)
    on_progress("cutting the impact sequences", None)
    accumulations, enough = list(accumulations_of(graph, first, arcs)), settings.tolerance / 10.0
    sweep = delta_sweep(graph, accumulations, seen.scale, settings.cuts, simulation, enough)
    if sweep:
        residuals["delta_sweep"] = sweep[-1].error
    on_progress("balancing the energy", None)
    found: PeriodEnergies | None = None
    with suppress(ZenoOrbitsError):
        found = _energies(one, first, settings)
    if _is_balanced(one.own):
        residuals["energy_balance"] = found.imbalance if found else math.inf
    if problem.reference is not None and len(one.own.stop_names) == 1:
        on_progress("comparing two derivations of the model", None)
        by_hand = load_reference(problem).dynamics(one.orbit.values(problem))
        residuals["second_model"] = second_model(by_hand, one.own, first)
    if problem.escapes:
        beyond = escapes_of(problem, largest_along(first)).values()
        residuals["escape"] = max((excess for excess, _ in beyond), default=0.0)
    residuals["integration"] = seen.integration
    quantities = first.quantities(graph).table().items()
    return _CrossChecks(
        residuals=residuals,
        margins=margins_of(graph, first, seen.scale),
        energies=found.values if found else {},
        quantities={name: (q.lowest, q.highest) for name, q in quantities},
        sweep=sweep,
    )


def _energies(one: Case, first: Period, settings: VerificationSettings) -> PeriodEnergies:
    """Return the energies of the first period.

    If the balance does not close, powers are integrated more exactly, then impacts are resolved to
    a lower speed: the powers inside a tail are interpolated.
    """
    found = energies_of(one.own, first, QUICK)
    if found.imbalance > _SHARE * settings.tolerance:
        found = energies_of(one.own, first, EXACT)
    if found.imbalance <= settings.tolerance or not first.zeno_points:
        return found
    rule = extrapolated(settings.simulation)
    shorter = replace(rule, resolved=_SHORTER_TAIL * rule.resolved)
    finer = replace(settings.simulation, completion=shorter)
    run = followed(one.graph, one.claim, one.start, finer, 1)
    return energies_of(one.own, run.periods[0]) if run.periods else found


def _is_balanced(graph: GraphDynamics) -> bool:
    """Return True if all powers are given, so that the energy balance can be checked."""
    return graph.compiled.system(graph.open_mode, 0).is_balanced


def _contradictions(one: Case, first: Period | None) -> Iterator[str]:
    """Yield clauses on false statements in an orbit's data, and on coordinates that escape."""
    orbit, shape = one.orbit, one.orbit.phases_as
    if other := other_equations(orbit.problem_digest, one.problem):
        yield other
    for name, view in zip(one.graph.stop_names, one.graph.open_views, strict=False):
        e = view.restitution
        if e == 1.0 and f"zeno {name}" in orbit.sequence:
            yield f"elastic impacts have no Zeno point, but the orbit has the event `zeno {name}`"
        elif shape is not None and shape.at_restitution(e) != shape:
            at = f"at restitution {e:g} it is `{shape.at_restitution(e).text}`"
            yield f"the orbit says that its shape is `{shape.text}`, but {at}"
    if first is not None:
        yield from (phrase for _, phrase in escapes_of(one.problem, largest_along(first)).values())


@checked
def with_certificate(orbit: Orbit, certificate: OrbitCertificate) -> Orbit:
    """Return the orbit with a certificate and its multipliers in it."""
    return replace(
        orbit,
        certificate=certificate.as_json(),
        floquet_multipliers=certificate.multipliers,
    )


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
    simulation = (settings or VerificationSettings()).simulation
    one = Case.of(orbit, problem, None)
    run = followed(one.graph, one.claim, one.start, simulation, 1)
    if not run.periods:
        start = tuple(one.start.tolist())
        raise SimulationError(run.trouble, time=one.claim.period, state=start)
    return multipliers_along(one.graph, one.claim, run, simulation)
