"""Check an orbit by forward integration from its numbers alone.

Nothing here knows how the orbit was found: the scene is rebuilt from the orbit's parameters and
gains, the completed system is simulated from the release over several periods, and what happens
is held against what the orbit says. Residuals are relative (theory (19)).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from zeno_orbits.certificate import DeltaCut, OrbitCertificate
from zeno_orbits.compiled import bind, compile_problem
from zeno_orbits.dynamics import HybridDynamics, Tolerance, Vector
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.execution import Arc, Execution, Impact, Mode, Release, ZenoPoint
from zeno_orbits.hybrid import audited
from zeno_orbits.orbit import ZenoOrbit
from zeno_orbits.poincare import Multipliers, floquet_multipliers
from zeno_orbits.problem import Problem, load_reference
from zeno_orbits.simulate import (
    SimulationSettings,
    Truncation,
    ZenoExtrapolation,
    simulate,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class VerificationSettings:
    """How to check.

    Attributes:
        tolerance: Largest residual that passes.
        n_periods: Periods to integrate.
        simulation: Accuracy of the integration.
        cuts: Thresholds of the delta sweep, in units of the first impact speed.
        use_reference: Integrate the scene's hand-written model instead of the derived one.
    """

    tolerance: float = 1e-9
    n_periods: int = 3
    simulation: SimulationSettings = field(default_factory=SimulationSettings)
    cuts: tuple[float, ...] = (3e-2, 3e-3, 3e-4, 3e-5)
    use_reference: bool = False


def verify(
    orbit: ZenoOrbit,
    problem: Problem,
    *,
    settings: VerificationSettings | None = None,
    dynamics: HybridDynamics | None = None,
    on_progress: Callable[[str], None] | None = None,
) -> OrbitCertificate:
    """Return the certificate of an orbit.

    Args:
        orbit: The orbit; its own certificate and multipliers are not looked at.
        problem: Its scene.
        settings: Tolerance, number of periods and accuracy.
        dynamics: The system to integrate; by default the scene's, at the orbit's numbers.
        on_progress: Called with the name of each stage as it begins.

    Raises:
        InputError: If the orbit does not fit the scene.
    """
    settings = settings or VerificationSettings()
    claim = _claim(orbit, problem)
    if dynamics is None:
        dynamics = problem_dynamics(orbit, problem, use_reference=settings.use_reference)
    tell = on_progress or (lambda _: None)
    tell("integrating the orbit")
    seen = _observe(dynamics, claim, settings)
    residuals = _orbit_residuals(dynamics, claim, seen)
    multipliers, energies = None, {}
    sweep: tuple[DeltaCut, ...] = ()
    if seen.cycle is not None:
        tell("cutting the impact sequence")
        sweep = _delta_sweep(dynamics, claim, seen.cycle, settings)
        if sweep:
            residuals["delta_sweep"] = sweep[-1].error
        tell("balancing the energy")
        energies = _energies(orbit, problem, claim, seen.cycle, settings)
        residuals["energy_balance"] = _imbalance(energies)
        residuals["integration"] = seen.integration_error
        if problem.reference is not None:
            tell("comparing two derivations of the model")
            residuals["second_model"] = _second_model(orbit, problem, seen.cycle)
        tell("computing the multipliers")
        multipliers = _multipliers(dynamics, claim, settings)
    stable = multipliers is not None and multipliers.spectral_radius < 1.0
    if not stable:
        # Rounding grows along an unstable orbit: later returns say nothing of it.
        residuals.pop("drift", None)
    return OrbitCertificate(
        tolerance=settings.tolerance,
        residuals=residuals,
        margins=_margins(dynamics, seen.cycle),
        energies=energies,
        multipliers=() if multipliers is None else multipliers.values,
        multiplier_error=math.inf if multipliers is None else multipliers.error,
        delta_sweep=sweep,
        delta_order=_order(sweep),
        integration_error=seen.integration_error,
        zeno_error=math.inf if seen.cycle is None else seen.cycle.zeno.error,
        period=math.nan if seen.cycle is None else seen.cycle.end.time,
        n_periods=settings.n_periods,
        model="reference" if settings.use_reference else "derived",
        trouble=seen.trouble,
    )


def certified(orbit: ZenoOrbit, certificate: OrbitCertificate) -> ZenoOrbit:
    """Return the orbit with a certificate and its multipliers in it."""
    return replace(
        orbit,
        certificate=certificate.as_json(),
        floquet_multipliers=certificate.multipliers,
    )


def problem_dynamics(
    orbit: ZenoOrbit, problem: Problem, *, use_reference: bool = False
) -> HybridDynamics:
    """Return the system of an orbit, derived from energies or written by hand.

    Raises:
        InputError: If the orbit's numbers do not fit the scene, or it has no hand-written model.
    """
    setting = orbit.setting(problem)
    if use_reference:
        return load_reference(problem).dynamics(setting)
    return bind(compile_problem(problem), setting.values())


@dataclass(frozen=True, slots=True, kw_only=True)
class _Claim:
    """What the orbit says, as vectors."""

    period: float
    release: Vector
    impacts: tuple[tuple[float, Vector], ...]
    zeno_time: float
    zeno: Vector


def _claim(orbit: ZenoOrbit, problem: Problem) -> _Claim:
    if orbit.problem != problem.name:
        message = (
            f"Argument `orbit` must be of scene `{problem.name}`, but it is of `{orbit.problem}`."
        )
        raise InputError(message)
    if not orbit.impacts:
        raise InputError("Argument `orbit` must have an impact, but it has none.")
    for name, values, known in (
        ("gains", orbit.gains, [gain.name for gain in problem.gains]),
        ("parameters", orbit.parameters, [quantity.name for quantity in problem.parameters]),
    ):
        if set(values) != set(known):
            odd = ", ".join(sorted(set(values) ^ set(known)))
            message = (
                f"Argument `orbit` must have the {name} of its scene, but these differ: {odd}."
            )
            raise InputError(message)

    def vector(named: Mapping[str, float], where: str) -> Vector:
        if set(named) != set(problem.state_names):
            odd = ", ".join(sorted(set(named) ^ set(problem.state_names)))
            message = (
                f"Argument `orbit` must have all states in `{where}`, but these differ: {odd}."
            )
            raise InputError(message)
        return np.array(problem.state_vector(named))

    return _Claim(
        period=orbit.period,
        release=vector(orbit.release_state, "release_state"),
        impacts=tuple((i.time, vector(i.state_minus, "impacts")) for i in orbit.impacts),
        zeno_time=orbit.zeno_time,
        zeno=vector(orbit.zeno_state, "zeno_state"),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _FirstCycle:
    """The first period as integrated."""

    execution: Execution
    arcs: tuple[Arc, ...]
    impacts: tuple[Impact, ...]
    zeno: ZenoPoint
    end: Release
    scale: Vector
    gap_scale: float
    force_scale: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Observation:
    """What the integration saw: its first period, the later returns, and its own error."""

    cycle: _FirstCycle | None
    impacts: tuple[Impact, ...]
    returns: tuple[Release, ...]
    integration_error: float
    trouble: str


def _observe(
    dynamics: HybridDynamics, claim: _Claim, settings: VerificationSettings
) -> _Observation:
    start = dynamics.on_stop(claim.release)
    horizon = (settings.n_periods + 0.5) * claim.period
    try:
        execution = simulate(dynamics, start, until=horizon, settings=settings.simulation)
    except ZenoOrbitsError as error:
        return _nothing(str(error))
    # A release state that is locked by a rounding error is released at once: no return.
    returns = tuple(r for r in execution.releases if r.time > 1e-6 * claim.period)
    zenos = [z for z in execution.zeno_points if returns and z.time < returns[0].time]
    if not returns or not zenos:
        what = "release" if not returns else "Zeno point"
        observed = _nothing(f"There is no {what} within {horizon:.4g} s")
        return replace(observed, impacts=execution.impacts)
    cycle = _first_cycle(dynamics, execution, returns[0], zenos[0])
    loose = replace(
        settings.simulation,
        tolerance=Tolerance(
            relative=1e3 * settings.simulation.tolerance.relative,
            absolute=1e3 * settings.simulation.tolerance.absolute,
        ),
        completion=ZenoExtrapolation(tolerance=1e-10),
    )
    again = simulate(dynamics, start, until=1.5 * cycle.end.time, settings=loose)
    later = [r for r in again.releases if r.time > 1e-6 * claim.period]
    error = _distance(later[0].state, cycle.end.state, cycle.scale) if later else math.inf
    return _Observation(
        cycle=cycle,
        impacts=execution.impacts,
        returns=returns,
        integration_error=error,
        trouble="",
    )


def _nothing(trouble: str) -> _Observation:
    return _Observation(
        cycle=None, impacts=(), returns=(), integration_error=math.inf, trouble=trouble
    )


def _first_cycle(
    dynamics: HybridDynamics, execution: Execution, end: Release, zeno: ZenoPoint
) -> _FirstCycle:
    arcs = tuple(arc for arc in execution.arcs if arc.start_time < end.time)
    states = np.array([step.after[: len(end.state)] for arc in arcs for step in arc.steps])
    sizes = np.max(np.abs(states), axis=0)
    gaps = [abs(dynamics.gap(x)) for x in states]
    forces = [
        abs(dynamics.multiplier(step.after))
        for arc in arcs
        if arc.mode is Mode.LOCKED
        for step in arc.steps
    ]
    return _FirstCycle(
        execution=execution,
        arcs=arcs,
        impacts=tuple(i for i in execution.impacts if i.time < end.time),
        zeno=zeno,
        end=end,
        scale=np.where(sizes > 0.0, sizes, 1.0),
        gap_scale=max(gaps),
        force_scale=max([*forces, abs(dynamics.multiplier(zeno.state))]),
    )


def _distance(a: Vector, b: Vector, scale: Vector) -> float:
    return float(np.max(np.abs(a - b) / scale))


def _orbit_residuals(
    dynamics: HybridDynamics, claim: _Claim, seen: _Observation
) -> dict[str, float]:
    cycle = seen.cycle
    if cycle is None:
        missing = ("release", "first_impact", "impact_sequence", "zeno_point", "closure")
        return dict.fromkeys(missing, math.inf) | {"release": _off_release(dynamics, claim, None)}
    period = claim.period
    hits = [
        max(abs(impact.time - time) / period, _distance(impact.state_minus, x, cycle.scale))
        for (time, x), impact in zip(claim.impacts, cycle.impacts, strict=False)
    ]
    # Impacts that the integration left to the tail have to lie inside it.
    first_unseen = len(cycle.impacts)
    hits += [
        max(0.0, abs(time - cycle.zeno.time) - cycle.zeno.tail) / period
        for time, _ in claim.impacts[first_unseen:]
    ]
    residuals = {
        "release": _off_release(dynamics, claim, cycle),
        "first_impact": hits[0],
        "impact_sequence": max(hits[1:], default=0.0),
        "zeno_point": max(
            abs(cycle.zeno.time - claim.zeno_time) / period,
            _distance(cycle.zeno.state, claim.zeno, cycle.scale),
        ),
        "closure": _distance(cycle.end.state, claim.release, cycle.scale),
        "period": abs(cycle.end.time - period) / period,
        "drift": max(_distance(r.state, claim.release, cycle.scale) for r in seen.returns),
        "penetration": _penetration(dynamics, cycle),
        "adhesion": _adhesion(dynamics, cycle),
        **_impact_laws(dynamics, cycle.impacts),
    }
    if len(dynamics.holonomic(claim.release)):
        residuals["holonomic"] = max(
            float(np.max(np.abs(dynamics.holonomic(arc.end_state)))) for arc in cycle.arcs
        )
    return residuals


def _off_release(dynamics: HybridDynamics, claim: _Claim, cycle: _FirstCycle | None) -> float:
    """Return how far the claimed release is from gap = gap rate = multiplier = 0."""
    speed = 1.0 if cycle is None else abs(cycle.impacts[0].approach_rate)
    gap = 1.0 if cycle is None else cycle.gap_scale
    force = 1.0 if cycle is None else cycle.force_scale
    return max(
        abs(dynamics.gap(claim.release)) / gap,
        abs(dynamics.gap_rate(claim.release)) / speed,
        abs(dynamics.multiplier(claim.release)) / force,
    )


def _penetration(dynamics: HybridDynamics, cycle: _FirstCycle) -> float:
    lowest = 0.0
    for arc in cycle.arcs:
        if arc.mode is Mode.FREE and arc.steps:
            scaled = len(arc.steps[0].after) > len(arc.start_state)
            inside = [step.after for step in arc.steps[:-1]]
            for y in inside:
                gap = float(y[-2]) * arc.time_unit**2 if scaled else dynamics.gap(y)
                lowest = min(lowest, gap)
            lowest = min(lowest, dynamics.gap(arc.end_state))
    return abs(lowest) / cycle.gap_scale


def _adhesion(dynamics: HybridDynamics, cycle: _FirstCycle) -> float:
    forces = [
        dynamics.multiplier(x)
        for arc in cycle.arcs
        if arc.mode is Mode.LOCKED and arc.end_time > cycle.zeno.time
        for x in (arc.start_state, *(step.after for step in arc.steps[:-1]), arc.end_state)
    ]
    return max(0.0, -min(forces, default=0.0)) / cycle.force_scale


def _impact_laws(dynamics: HybridDynamics, impacts: tuple[Impact, ...]) -> dict[str, float]:
    """Return how far the resets are from Newton's law and from its energy loss."""
    restitution = dynamics.restitution
    turn, loss = 0.0, 0.0
    fastest = max(abs(impact.approach_rate) for impact in impacts)
    for impact in impacts:
        rate = impact.approach_rate
        inertia = dynamics.normal_inertia(impact.state_minus)
        expected = -(1 - restitution**2) / 2 * inertia * rate**2
        change = dynamics.energy(impact.state_plus) - dynamics.energy(impact.state_minus)
        turn = max(turn, abs(dynamics.gap_rate(impact.state_plus) + restitution * rate) / fastest)
        loss = max(loss, abs(change - expected) / (inertia * fastest**2 / 2))
    return {"restitution": turn, "impact_energy": loss}


def _delta_sweep(
    dynamics: HybridDynamics, claim: _Claim, cycle: _FirstCycle, settings: VerificationSettings
) -> tuple[DeltaCut, ...]:
    """Cut the sequence by the paper's rule at falling thresholds, and compare on the locked arc."""
    if dynamics.restitution == 0.0:
        return ()
    when = (cycle.zeno.time + cycle.end.time) / 2
    truth = cycle.execution.state_at(when)
    fastest = abs(cycle.impacts[0].approach_rate)
    cuts: list[DeltaCut] = []
    for share in settings.cuts:
        rule = replace(settings.simulation, completion=Truncation(delta=share * fastest))
        try:
            run = simulate(dynamics, dynamics.on_stop(claim.release), until=when, settings=rule)
        except ZenoOrbitsError:
            return (*cuts, DeltaCut(delta=share * fastest, speed=math.nan, error=math.inf))
        last = run.impacts[-1] if run.impacts else cycle.impacts[0]
        error = _distance(run.end_state, truth, cycle.scale)
        cuts.append(DeltaCut(delta=share * fastest, speed=abs(last.approach_rate), error=error))
    return tuple(cuts)


def _order(sweep: tuple[DeltaCut, ...]) -> float:
    """Return the slope of error against speed, over the cuts that are above rounding."""
    usable = [cut for cut in sweep if 1e-12 < cut.error < math.inf]
    if len({cut.speed for cut in usable}) < 2:  # noqa: PLR2004
        return math.nan
    speeds = np.log([cut.speed for cut in usable])
    errors = np.log([cut.error for cut in usable])
    return float(np.polyfit(speeds, errors, 1)[0])


def _energies(
    orbit: ZenoOrbit,
    problem: Problem,
    claim: _Claim,
    cycle: _FirstCycle,
    settings: VerificationSettings,
) -> dict[str, float]:
    """Return the energies of one period, from an integration that carries the ledger along."""
    dynamics = bind(compile_problem(problem, audited), orbit.setting(problem).values())
    start = np.concatenate([claim.release, np.zeros(3)])
    simulation = settings.simulation
    run = simulate(dynamics, dynamics.on_stop(start), until=cycle.end.time, settings=simulation)
    impact_loss = 0.0
    for impact in run.impacts:
        inertia = dynamics.normal_inertia(impact.state_minus)
        e = dynamics.restitution
        impact_loss += (1 - e**2) / 2 * inertia * impact.approach_rate**2
    for zeno in run.zeno_points:
        # The tail loses the whole normal kinetic energy that is left.
        impact_loss += dynamics.normal_inertia(zeno.state) * zeno.last_speed**2 / 2
    end = run.end_state
    return {
        "input_work": float(end[-3]),
        "copper_loss": float(end[-2]),
        "other_loss": float(end[-1]),
        "impact_loss": impact_loss,
        "energy_gain": dynamics.energy(end) - dynamics.energy(start),
    }


def _imbalance(energies: Mapping[str, float]) -> float:
    spent = sum(value for name, value in energies.items() if name != "input_work")
    size = max(abs(value) for value in energies.values())
    return abs(energies["input_work"] - spent) / size if size > 0.0 else 0.0


def _second_model(orbit: ZenoOrbit, problem: Problem, cycle: _FirstCycle) -> float:
    """Return the largest relative difference of the two derivations along the orbit."""
    setting = orbit.setting(problem)
    by_hand: HybridDynamics = load_reference(problem).dynamics(setting)
    derived = bind(compile_problem(problem), setting.values())
    times = np.linspace(0.0, cycle.end.time, 41)
    free = [cycle.execution.state_at(float(t)) for t in times]
    free += [impact.state_minus for impact in cycle.impacts]
    rested = [derived.on_stop(x) for x in free]

    def gap_between(
        quantity: Callable[[HybridDynamics, Vector], Vector], at: list[Vector]
    ) -> float:
        pairs = [(quantity(by_hand, x), quantity(derived, x)) for x in at]
        size = np.max([np.abs(b) for _, b in pairs], axis=0)
        size = np.where(size > 0.0, size, 1.0)
        return max(float(np.max(np.abs(a - b) / size)) for a, b in pairs)

    return max(
        gap_between(lambda d, x: d.free.rate(x), free),
        gap_between(lambda d, x: d.locked.rate(x), rested),
        gap_between(lambda d, x: d.reset_map(x, d.gap_rate(x)), free),
        gap_between(lambda d, x: np.array([d.gap_acceleration(x), d.multiplier(x)]), rested),
        gap_between(lambda d, x: np.array([d.energy(x), d.normal_inertia(x)]), free),
    )


def _multipliers(
    dynamics: HybridDynamics, claim: _Claim, settings: VerificationSettings
) -> Multipliers | None:
    try:
        return floquet_multipliers(
            dynamics,
            dynamics.on_stop(claim.release),
            scale=np.maximum(np.abs(claim.release), np.abs(claim.zeno)) + 1e-3,
            period=claim.period,
            settings=settings.simulation,
        )
    except ZenoOrbitsError:
        return None


def _margins(dynamics: HybridDynamics, cycle: _FirstCycle | None) -> dict[str, float]:
    if cycle is None:
        return {}
    return {
        "gap_acceleration": -dynamics.gap_acceleration(cycle.zeno.state),
        "first_impact_speed": -cycle.impacts[0].approach_rate,
        "release_transversality": -dynamics.multiplier_rate(cycle.end.state),
        "locked_time": cycle.end.time - cycle.zeno.time,
    }
