"""True orbits pass and false ones are refused for the right reason."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from mpmath import mp

import zeno_orbits as zo
from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import MULTIPLIER, PERIOD
from tests.reference.shaken_truth import DIGITS, Table, throw
from tests.support.false_limits import FalseLimit
from tests.support.mechanisms import clocked_oscillator
from tests.support.orbits import changed
from zeno_orbits import StateLimit, hybrid_system
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.integrators import Automatic, Segment, SegmentResult, Tolerance
from zeno_orbits.model import CompletedSystem, HybridDynamics, Problem, load_problem
from zeno_orbits.orbits import Orbit, OrbitImpact, PhaseKind
from zeno_orbits.search import orbit_at_gains, orbit_by_shooting
from zeno_orbits.simulation import (
    Execution,
    Mode,
    SimulationSettings,
    ZenoExtrapolation,
    simulate,
)
from zeno_orbits.verification import (
    RESIDUALS,
    OrbitCertificate,
    VerificationSettings,
    verify,
    with_certificate,
)

QUICK = VerificationSettings(n_periods=1)
MOTION = {"first_impact", "impact_sequence", "zeno_point", "closure", "period", "drift"}
"""What changes when the motion does."""

Check = Callable[..., OrbitCertificate]


@pytest.fixture(name="check", scope="module")
def _check(problem: Problem) -> Check:
    def check(orbit: Orbit, dynamics: HybridDynamics | None = None) -> OrbitCertificate:
        return verify(orbit, problem, settings=QUICK, dynamics=dynamics)

    return check


# True orbits.


def test_the_declared_orbit_is_verified(certificate: OrbitCertificate) -> None:
    assert certificate.passed, certificate.verdict()
    assert certificate.failed == ()
    assert certificate.residuals["closure"] < 1e-9
    assert certificate.residuals["energy_balance"] < 1e-10
    assert certificate.period == pytest.approx(PERIOD, abs=1e-9)
    assert certificate.trouble == ""


def test_the_paper_rule_is_of_third_order(certificate: OrbitCertificate) -> None:
    assert certificate.delta_order == pytest.approx(3.0, abs=0.2)
    speeds = [cut.speed for cut in certificate.delta_sweep]
    assert speeds == sorted(speeds, reverse=True)
    assert all(cut.speed < cut.delta for cut in certificate.delta_sweep)


def test_the_declared_orbit_is_stable_with_the_declared_multipliers(
    certificate: OrbitCertificate,
) -> None:
    large, small = certificate.multipliers
    assert large == pytest.approx(MULTIPLIER, abs=1e-6)
    assert small == pytest.approx(0.0, abs=1e-6)
    assert certificate.stable


def test_the_energy_that_goes_in_comes_out_as_heat_and_impacts(
    certificate: OrbitCertificate,
) -> None:
    energies = certificate.energies
    losses = energies["copper_loss"] + energies["other_loss"] + energies["impact_loss"]
    assert energies["input_work"] == pytest.approx(losses, rel=1e-9)
    assert energies["energy_gain"] == pytest.approx(0.0, abs=1e-8)
    assert min(energies["input_work"], energies["copper_loss"], energies["impact_loss"]) > 0.0


def test_every_margin_of_the_declared_orbit_is_positive(certificate: OrbitCertificate) -> None:
    assert set(certificate.margins) == {
        "gap_acceleration",
        "first_impact_speed",
        "release_transversality",
        "locked_time",
        "later_impact_speed",
        "events_apart",
    }
    assert certificate.lost == ()


def test_every_residual_has_its_sentence(certificate: OrbitCertificate) -> None:
    assert set(certificate.residuals) <= set(RESIDUALS)


@pytest.mark.slow
def test_the_model_written_by_hand_gives_the_same_certificate(
    orbit: Orbit, problem: Problem, certificate: OrbitCertificate
) -> None:
    by_hand = verify(orbit, problem, settings=replace(QUICK, use_reference=True))
    assert by_hand.passed, by_hand.verdict()
    assert by_hand.model == "reference"
    assert certificate.model == "derived"
    assert by_hand.residuals["closure"] < 1e-9
    assert by_hand.multipliers[0] == pytest.approx(certificate.multipliers[0], abs=1e-6)


@pytest.mark.slow
def test_a_plastic_orbit_is_verified_without_a_sweep(problem: Problem) -> None:
    values = problem.values(parameters={"restitution": 0.0})
    seen = verify(orbit_at_gains(problem, values).unwrap(), problem, settings=QUICK)
    assert seen.passed, seen.verdict()
    assert seen.delta_sweep == ()
    assert "delta_sweep" not in seen.residuals


def test_an_orbit_of_a_problem_without_motors_is_verified() -> None:
    problem = clocked_oscillator(FORCED, attracting=True)
    seen = verify(orbit_at_gains(problem, problem.values()).unwrap(), problem, settings=QUICK)
    assert seen.passed, seen.verdict()
    assert seen.stable
    assert "second_model" not in seen.residuals


@pytest.mark.slow
def test_an_orbit_that_may_have_any_amplitude_is_not_called_stable() -> None:
    problem = clocked_oscillator(FORCED, attracting=False)
    seen = verify(orbit_at_gains(problem, problem.values()).unwrap(), problem, settings=QUICK)
    # Its multiplier is one; what is computed may fall below by its error only.
    assert seen.multipliers[0] == pytest.approx(1.0, abs=1e-7)
    assert not seen.stable


def test_the_orbit_carries_its_certificate(orbit: Orbit, certificate: OrbitCertificate) -> None:
    whole = with_certificate(orbit, certificate)
    assert whole.certificate == certificate.as_json()
    assert whole.floquet_multipliers == certificate.multipliers
    assert replace(whole, certificate={}, floquet_multipliers=()) == orbit


def test_stages_are_told(orbit: Orbit, problem: Problem) -> None:
    told: list[str] = []
    verify(orbit, problem, settings=QUICK, on_progress=lambda stage, _: told.append(stage))
    assert told[0] == "integrating the orbit"
    assert "computing the multipliers" in told


# False numbers.


@pytest.mark.parametrize("change", [1e-6, -1e-3])
def test_a_false_period_fails_alone(check: Check, orbit: Orbit, change: float) -> None:
    seen = check(replace(orbit, period=orbit.period + change))
    assert seen.failed == ("period",)
    assert not seen.passed


@pytest.mark.parametrize(("gain", "change"), [("Kp", 1e-6), ("Kd", 1e-6), ("Kp", 0.1)])
def test_false_gains_change_the_motion(
    check: Check, orbit: Orbit, gain: str, change: float
) -> None:
    # On the release set the voltage does not enter, so the release holds.
    seen = check(replace(orbit, gains={**orbit.gains, gain: orbit.gains[gain] + change}))
    assert seen.failed[0] == "first_impact"
    assert set(seen.failed) == MOTION


@pytest.mark.parametrize("change", [1e-6, -1e-6])
@pytest.mark.parametrize(
    ("state", "first"),
    [
        ("theta1", "release"),
        ("theta2", "release"),
        ("dtheta1", "first_impact"),
        ("dtheta2", "release"),
        ("current", "release"),
    ],
)
def test_a_false_release_state_is_refused(
    check: Check, orbit: Orbit, state: str, first: str, change: float
) -> None:
    # The multiplier does not depend on dtheta1: such a state is a release, of another motion.
    moved = {**orbit.release_state, state: orbit.release_state[state] + change}
    seen = check(changed(orbit, release_state=moved))
    assert seen.failed[0] == first
    assert "closure" in seen.failed


@pytest.mark.parametrize("change", [-1e-2, 1e-2])
def test_a_false_angle_far_from_the_release_is_refused(
    check: Check, orbit: Orbit, change: float
) -> None:
    moved = {**orbit.release_state, "theta1": orbit.release_state["theta1"] + change}
    assert check(changed(orbit, release_state=moved)).failed[0] == "release"


@pytest.mark.parametrize("theta2", [-0.1, -1e-6])
def test_a_release_inside_the_stop_is_refused(check: Check, orbit: Orbit, theta2: float) -> None:
    seen = check(changed(orbit, release_state={**orbit.release_state, "theta2": theta2}))
    assert not seen.passed
    assert seen.failed[0] == "release"


@pytest.mark.parametrize("restitution", [0.0, 0.2 + 1e-6, 0.3])
def test_a_false_restitution_shows_after_the_first_impact(
    check: Check, orbit: Orbit, restitution: float
) -> None:
    seen = check(replace(orbit, parameters={**orbit.parameters, "restitution": restitution}))
    assert seen.failed[0] == "impact_sequence"
    assert {"impact_sequence", "zeno_point", "closure", "period"} <= set(seen.failed)
    assert "release" not in seen.failed
    assert "first_impact" not in seen.failed


def test_a_restitution_without_a_locked_arc_is_refused(check: Check, orbit: Orbit) -> None:
    # Beyond 0.417 the impacts do not die out before the stop lets go.
    seen = check(replace(orbit, parameters={**orbit.parameters, "restitution": 0.5}))
    assert not seen.passed
    assert "The event `release stop` does not follow" in seen.trouble
    assert seen.multipliers == ()
    assert not seen.stable


@pytest.mark.parametrize(("name", "first"), [("R", "first_impact"), ("m2", "release")])
def test_a_false_parameter_is_refused(check: Check, orbit: Orbit, name: str, first: str) -> None:
    value = orbit.parameters[name] * (1 + 1e-4)
    seen = check(replace(orbit, parameters={**orbit.parameters, name: value}))
    assert seen.failed[0] == first
    assert set(seen.failed) >= MOTION


def test_a_length_that_enters_no_law_does_not_matter(check: Check, orbit: Orbit) -> None:
    assert check(replace(orbit, parameters={**orbit.parameters, "L2": 0.4})).passed


def test_a_false_zeno_time_fails_alone(check: Check, orbit: Orbit) -> None:
    assert check(changed(orbit, zeno_time=orbit.zeno_time + 1e-6)).failed == ("zeno_point",)


@pytest.mark.parametrize("state", ["theta1", "theta2", "dtheta1", "dtheta2", "current"])
def test_a_false_zeno_state_fails_alone(check: Check, orbit: Orbit, state: str) -> None:
    moved = {**orbit.zeno_state, state: orbit.zeno_state[state] + 1e-6}
    assert check(changed(orbit, zeno_state=moved)).failed == ("zeno_point",)


@pytest.mark.parametrize(
    ("index", "failed"), [(0, "first_impact"), (3, "impact_sequence"), (-1, "impact_sequence")]
)
@pytest.mark.parametrize("what", ["time", "state"])
def test_a_false_impact_fails_alone(
    check: Check, orbit: Orbit, index: int, failed: str, what: str
) -> None:
    impacts = list(orbit.impacts)
    impact = impacts[index]
    if what == "time":
        impacts[index] = replace(impact, time=impact.time + 1e-6)
    else:
        current = impact.state_minus["current"] + 1e-6
        impacts[index] = replace(impact, state_minus={**impact.state_minus, "current": current})
    assert check(changed(orbit, impacts=tuple(impacts))).failed == (failed,)


def test_impacts_out_of_order_are_refused(check: Check, orbit: Orbit) -> None:
    first, second, *rest = orbit.impacts
    seen = check(changed(orbit, impacts=(second, first, *rest)))
    assert seen.failed == ("first_impact", "impact_sequence")
    assert check(changed(orbit, impacts=(first, *rest))).failed == ("impact_sequence",)


def test_impacts_after_the_zeno_point_are_refused(check: Check, orbit: Orbit) -> None:
    late = OrbitImpact(time=orbit.zeno_time + 1e-2, state_minus=orbit.impacts[-1].state_minus)
    impacts = (*orbit.impacts, late, late, late)
    assert check(changed(orbit, impacts=impacts)).failed == ("impact_sequence",)


@pytest.mark.parametrize("name", ["motor_pendulum", "vibrating_table", "solenoid"])
def test_claimed_impacts_that_the_check_does_not_resolve_obey_the_law_of_the_tail(
    name: str,
) -> None:
    machine = load_problem(name)
    orbit = orbit_by_shooting(machine, machine.values()).unwrap()
    finer = SimulationSettings(completion=ZenoExtrapolation(resolved=1e-10))
    motion = simulate(
        machine.dynamics(machine.values()),
        machine.state_vector(orbit.release_state),
        until=orbit.period,
        settings=finer,
    )
    impacts = tuple(
        OrbitImpact(
            time=one.time,
            state_minus=dict(zip(machine.state_names, one.state_minus.tolist(), strict=True)),
        )
        for one in motion.impacts
    )
    assert len(impacts) > len(orbit.impacts) + 2
    more = changed(orbit, impacts=impacts)
    assert verify(more, machine, settings=QUICK).passed
    later = impacts[len(orbit.impacts) + 1]
    before = dict(later.state_minus)
    first = machine.state_names[0]
    for false in (
        replace(later, time=(later.time + orbit.zeno_time) / 2),
        replace(later, state_minus={**before, first: before[first] + 1e-6}),
        replace(later, state_minus=dict.fromkeys(before, 77.0)),
    ):
        wrong = tuple(false if one is later else one for one in impacts)
        seen = verify(changed(orbit, impacts=wrong), machine, settings=QUICK)
        assert seen.failed == ("impact_sequence",)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_times_that_are_not_finite_are_refused(check: Check, orbit: Orbit, bad: float) -> None:
    late = replace(orbit.impacts[3], time=bad)
    impacts = (*orbit.impacts[:3], late, *orbit.impacts[4:])
    for wrong in (
        changed(orbit, impacts=impacts),
        changed(orbit, impacts=(*orbit.impacts, late)),
        changed(orbit, zeno_time=bad),
        replace(orbit, period=bad),
    ):
        with pytest.raises(InputError, match=r"`(time|zeno_time|period)` must be a finite number"):
            check(wrong)
    machine = load_problem("hopper")
    events = zo.find_orbit(machine).unwrap()
    moved = (replace(events.events[0], time=bad), *events.events[1:])
    with pytest.raises(InputError, match="`time` must be a finite number"):
        verify(replace(events, events=moved), machine, settings=QUICK)


# False laws.


def test_a_reset_into_the_stop_stops_the_integration(
    check: Check, orbit: Orbit, machine: HybridDynamics
) -> None:
    wrong = replace(machine, reset_map=lambda x, rate: machine.reset_map(x, -rate))
    seen = check(orbit, wrong)
    assert "The reset map sends the state into the stop" in seen.trouble
    assert seen.failed[0] == "first_impact"
    assert "release" not in seen.failed


def test_a_reset_that_throws_back_too_fast_breaks_the_law_of_restitution(
    check: Check, orbit: Orbit, machine: HybridDynamics
) -> None:
    def bouncy(x: Vector, rate: float) -> Vector:
        return x - (1 + 0.25) * rate * machine.impulse_direction(x)

    seen = check(orbit, replace(machine, reset_map=bouncy))
    assert {"restitution", "impact_energy", "impact_sequence"} <= set(seen.failed)
    assert seen.failed[0] == "impact_sequence"


def test_a_reset_that_throws_back_too_slowly_is_refused(
    check: Check, orbit: Orbit, machine: HybridDynamics
) -> None:
    def dull(x: Vector, rate: float) -> Vector:
        return x - (1 + 0.15) * rate * machine.impulse_direction(x)

    seen = check(orbit, replace(machine, reset_map=dull))
    assert not seen.passed
    assert {"impact_sequence", "zeno_point", "closure"} <= set(seen.failed)


def test_a_reset_that_changes_the_tangential_momentum_loses_the_wrong_energy(
    check: Check, orbit: Orbit, machine: HybridDynamics
) -> None:
    def pushing(x: Vector, rate: float) -> Vector:
        after = machine.reset_map(x, rate)
        after[2] += 1e-3 * abs(rate)
        return after

    seen = check(orbit, replace(machine, reset_map=pushing))
    assert "impact_energy" in seen.failed
    assert "restitution" not in seen.failed
    assert seen.failed[0] == "impact_sequence"


def test_a_reset_of_the_knee_alone_loses_the_wrong_energy(
    check: Check, orbit: Orbit, machine: HybridDynamics
) -> None:
    def knee(x: Vector, rate: float) -> Vector:
        after = machine.reset_map(x, rate)
        after[2] = x[2]
        return after

    seen = check(orbit, replace(machine, reset_map=knee))
    assert "impact_energy" in seen.failed
    assert "restitution" not in seen.failed


def test_a_multiplier_of_the_wrong_sign_pulls(
    check: Check, orbit: Orbit, machine: HybridDynamics
) -> None:
    wrong = replace(machine, locked=_Guard(machine.locked, np.negative))
    assert check(orbit, wrong).failed == ("adhesion",)


def test_a_wrong_energy_fails_at_the_impacts(
    check: Check, orbit: Orbit, machine: HybridDynamics
) -> None:
    wrong = replace(machine, energy=lambda x: machine.energy(x) + 1e-3 * float(x[2]) ** 2)
    assert check(orbit, wrong).failed == ("impact_energy",)


def test_a_large_potential_energy_does_not_drown_the_loss_of_an_impact(
    check: Check, orbit: Orbit, machine: HybridDynamics
) -> None:
    # The difference of two such energies is rounded to 1e-8 J, and an impact loses 0.4 J at most.
    lifted = replace(machine, energy=lambda x: machine.energy(x) + 4e8)
    seen = check(orbit, lifted)
    assert seen.passed
    assert seen.residuals["impact_energy"] < 1e-12


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("r2 = -swirl * rate1**2 - pull2", "r2 = swirl * rate1**2 - pull2"),
        ("x - (1 + self.restitution)", "x + (1 + self.restitution)"),
        ("kinetic - self.g * height", "kinetic + self.g * height"),
    ],
    ids=["coriolis", "reset", "height"],
)
def test_a_second_model_with_a_wrong_sign_fails_alone(
    orbit: Orbit, problem: Problem, tmp_path: Path, right: str, wrong: str
) -> None:
    assert problem.reference is not None
    text = problem.reference.read_text(encoding="utf-8")
    assert text.count(right) == 1
    file = tmp_path / "reference.py"
    file.write_text(text.replace(right, wrong), encoding="utf-8")
    seen = verify(orbit, replace(problem, reference=file), settings=QUICK)
    assert seen.failed == ("second_model",)


def test_a_second_model_that_is_wrong_on_the_stop_fails_alone(
    orbit: Orbit, problem: Problem, tmp_path: Path
) -> None:
    assert problem.reference is not None
    text = problem.reference.read_text(encoding="utf-8")
    right = "field=machine.locked_flow"
    assert text.count(right) == 1
    file = tmp_path / "reference.py"
    wrong = "field=lambda x: machine.locked_flow(x) * (1 + 1e-6)"
    file.write_text(text.replace(right, wrong), encoding="utf-8")
    seen = verify(orbit, replace(problem, reference=file), settings=QUICK)
    assert seen.failed == ("second_model",)


def test_a_gap_that_is_negative_in_mid_flight_fails_alone(
    check: Check, orbit: Orbit, machine: HybridDynamics
) -> None:
    # Far from the stop, so that no event changes; a thousandth of the largest gap inside.
    far = 0.5 * max(abs(machine.gap(x)) for x in _flight_of(orbit, machine))

    def guards(gaps: Vector) -> Vector:
        return np.where(gaps < far, gaps, -1e-3 * far)

    seen = check(orbit, replace(machine, free=_Guard(machine.free, guards)))
    assert seen.failed == ("penetration",)
    assert seen.residuals["penetration"] == pytest.approx(1e-3, rel=0.01)


def test_a_constraint_that_is_broken_before_the_first_impact_only_fails_alone(
    check: Check, orbit: Orbit, machine: HybridDynamics
) -> None:
    fastest = min(machine.gap_rate(x) for x in _flight_of(orbit, machine))

    def holonomic(x: Vector) -> Vector:
        return np.array([0.0, -1e-6 if machine.gap_rate(x) < 0.9 * fastest else 0.0])

    seen = check(orbit, replace(machine, holonomic=holonomic))
    assert seen.failed == ("holonomic",)
    assert seen.residuals["holonomic"] == 1e-6


class _Guard:
    """A flow whose guard at many states is another function of the guard."""

    def __init__(self, flow: Any, guard: Callable[[Vector], Vector]) -> None:
        self._flow, self._guard = flow, guard

    def __getattr__(self, name: str) -> Any:
        return getattr(self._flow, name)

    def guards(self, states: Vector) -> Vector:
        return self._guard(self._flow.guards(states))


def _flight_of(orbit: Orbit, machine: HybridDynamics) -> Vector:
    """Return states from the release to the first impact, ``(n, n_x)``."""
    start = machine.on_stop(np.array(list(orbit.release_state.values())))
    return simulate(machine, start, until=orbit.period, impacts=1).sampled()[1]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Careless:
    """An engine that takes any tolerance near the usual one, or above it, for a coarse one."""

    def follow(self, leg: Segment) -> SegmentResult:
        loose = leg.tolerance.relative > Tolerance().relative / 50
        coarse = Tolerance(relative=1e-5, absolute=1e-6)
        return Automatic().follow(replace(leg, tolerance=coarse) if loose else leg)


@pytest.mark.slow
def test_a_return_that_a_looser_integration_does_not_confirm_fails_alone(
    orbit: Orbit, problem: Problem
) -> None:
    careless = SimulationSettings(engine=_Careless())
    seen = verify(orbit, problem, settings=replace(QUICK, simulation=careless))
    assert seen.failed == ("integration",)
    # The residual lacks what the rounding of times explains.
    assert 1e-8 < seen.residuals["integration"] <= seen.integration_error
    assert seen.residuals["integration"] == pytest.approx(seen.integration_error, rel=1e-3)


@pytest.mark.slow
def test_a_wrong_zeno_limit_is_not_what_the_cuts_tend_to(orbit: Orbit, problem: Problem) -> None:
    late = SimulationSettings(completion=FalseLimit(delay=1e-6))
    seen = verify(orbit, problem, settings=replace(QUICK, simulation=late))
    assert {"zeno_point", "delta_sweep", "period"} <= set(seen.failed)


@pytest.mark.parametrize("place", [0, 1])
def test_one_wrong_zeno_limit_of_two_is_enough(place: int) -> None:
    table = load_problem("two_tone_table")
    orbit = orbit_by_shooting(table, table.values()).unwrap()
    times = [phase.zeno_time or math.nan for phase in orbit.phases]
    assert len(times) == 2
    assert verify(orbit, table, settings=QUICK).passed
    late = FalseLimit(delay=1e-6, since=times[place] - 1e-3, until=times[place] + 1e-3)
    simulation = SimulationSettings(completion=late)
    seen = verify(orbit, table, settings=replace(QUICK, simulation=simulation))
    assert {"zeno_point", "delta_sweep"} <= set(seen.failed)


def test_the_cuts_go_on_where_the_locked_arc_is_about_to_vanish(problem: Problem) -> None:
    # The family in e ends at 0.41679; its cubic error there is seen at four cuts still.
    near = orbit_by_shooting(problem, problem.values(parameters={"restitution": 0.4167})).unwrap()
    seen = verify(near, problem)
    assert seen.passed
    assert len(seen.delta_sweep) > len(VerificationSettings().cuts)
    assert seen.delta_sweep[-1].error < seen.tolerance / 10
    late = SimulationSettings(completion=FalseLimit(delay=1e-6))
    assert "delta_sweep" in verify(near, problem, settings=replace(QUICK, simulation=late)).failed


@pytest.mark.slow
def test_a_release_that_is_none_fails_alone(
    check: Check, orbit: Orbit, machine: HybridDynamics
) -> None:
    # The flow's own guard knows better; what the certificate asks is off by a millionth.
    largest = max(abs(machine.multiplier(x)) for x in _locked_of(orbit, machine))
    seen = check(
        orbit, replace(machine, multiplier=lambda x: machine.multiplier(x) + 1e-6 * largest)
    )
    assert seen.failed == ("release",)
    assert seen.residuals["release"] == pytest.approx(1e-6, rel=1e-3)


def test_a_gap_rate_that_breaks_the_law_of_impact_fails_alone(
    check: Check, orbit: Orbit, machine: HybridDynamics
) -> None:
    def rate(x: Vector) -> float:
        found = machine.gap_rate(x)
        return found * (1 + 1e-7) if found > 0.0 else found

    seen = check(orbit, replace(machine, gap_rate=rate))
    assert seen.failed == ("restitution",)
    # A part 1e-7 of the speed after the first impact, e = 0.2 times the one before.
    assert seen.residuals["restitution"] == pytest.approx(0.2e-7, rel=1e-3)


def test_a_motion_that_does_not_come_back_fails_at_its_end_alone(
    check: Check, orbit: Orbit, machine: HybridDynamics
) -> None:
    # A release beside the orbit's, and all that follows it: true but for its end.
    start = {**orbit.release_state, "dtheta1": orbit.release_state["dtheta1"] + 1e-4}
    state = machine.on_stop(np.array(list(start.values())))
    motion = simulate(machine, state, until=1.5 * orbit.period, releases=1)
    names, zeno = machine.state_names, motion.zeno_points[0]

    def named(x: Vector) -> dict[str, float]:
        return dict(zip(names, x.tolist(), strict=True))

    seen = check(
        changed(
            orbit,
            period=motion.releases[0].time,
            release_state=named(state),
            impacts=tuple(
                OrbitImpact(time=one.time, state_minus=named(one.state_minus))
                for one in motion.impacts
            ),
            zeno_time=zeno.time,
            zeno_state=named(zeno.state),
        )
    )
    assert seen.failed == ("closure", "drift")
    # The multiplier is -0.019: the return is as far off as the start, nearly.
    assert seen.residuals["closure"] == pytest.approx(1e-4 / _largest(motion, 2), rel=0.05)


def test_a_later_period_that_goes_elsewhere_fails_alone(orbit: Orbit, problem: Problem) -> None:
    since = orbit.period + 0.5 * orbit.zeno_time
    completion = FalseLimit(off=1e-6, since=since, until=since + orbit.period)
    off = replace(QUICK.simulation, completion=completion)
    settings = replace(QUICK, n_periods=3, simulation=off)
    seen = verify(orbit, problem, settings=settings)
    assert seen.failed == ("drift",)
    assert verify(orbit, problem, settings=replace(settings, n_periods=1)).passed


@pytest.mark.slow
def test_a_power_that_the_motion_does_not_take_fails_alone(orbit: Orbit, problem: Problem) -> None:
    def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
        system = problem.model(p)
        drive = replace(system.drive, input_power=(1 + 1e-6) * system.drive.input_power)
        return hybrid_system(system.bare, drive, p["restitution"])

    seen = verify(orbit, replace(problem, model=model, reference=None), settings=QUICK)
    assert seen.failed == ("energy_balance",)
    assert seen.residuals["energy_balance"] == pytest.approx(1e-6, rel=0.5)


@pytest.mark.slow
def test_cuts_that_tend_elsewhere_fail_alone(
    orbit: Orbit, problem: Problem, machine: HybridDynamics
) -> None:
    hasty = SimulationSettings(engine=_HastyAtTheEnd(flow=machine.locked, end=0.3))
    settings = replace(QUICK, simulation=hasty)
    seen = verify(orbit, problem, settings=settings, dynamics=machine)
    assert seen.failed == ("delta_sweep",)


@dataclass(frozen=True, slots=True, kw_only=True)
class _HastyAtTheEnd:
    """An engine that follows one flow carelessly if little time is left."""

    flow: object
    end: float

    def follow(self, leg: Segment) -> SegmentResult:
        hasty = leg.flow is self.flow and leg.horizon < self.end
        coarse = Tolerance(relative=1e-5, absolute=1e-6)
        return Automatic().follow(replace(leg, tolerance=coarse) if hasty else leg)


def _locked_of(orbit: Orbit, machine: HybridDynamics) -> Vector:
    """Return states from the Zeno point to the release, ``(n, n_x)``."""
    start = machine.on_stop(np.array(list(orbit.release_state.values())))
    run = simulate(machine, start, until=1.5 * orbit.period, releases=1)
    return next(arc for arc in reversed(run.arcs) if arc.mode is Mode.LOCKED).sampled()[1]


def _largest(motion: Execution, state: int) -> float:
    return float(np.max(np.abs(motion.sampled()[1][:, state])))


@pytest.mark.slow
def test_margins_are_the_least_of_all_phases() -> None:
    table = load_problem("two_tone_table")
    values = table.values()
    seen = verify(orbit_by_shooting(table, values).unwrap(), table, settings=QUICK)
    with mp.workdps(DIGITS):
        truth, e = Table.of(values.parameters), values.parameters["restitution"]
        first = throw(truth, mp.mpf(0), e)
        second = throw(truth, first.start + first.zeno_time, e)
        both = [first, second]
        ends = [one.start + one.zeno_time for one in both]
        releases = [truth.throw_after(end) for end in ends]
        phases = {
            "gap_acceleration": [-truth.lifts(end) for end in ends],
            "first_impact_speed": [one.speeds[0] for one in both],
            # The multiplier is m times what the table pushes with.
            "release_transversality": [
                values.parameters["m"] * mp.diff(truth.lifts, release) for release in releases
            ],
            "locked_time": [b - a for a, b in zip(ends, releases, strict=True)],
            "later_impact_speed": [
                min(w / (e * v) for v, w in pairwise(one.speeds)) for one in both
            ],
        }
        phases["events_apart"] = [
            min(one.times[0], held) for one, held in zip(both, phases["locked_time"], strict=True)
        ]
    assert set(seen.margins) == {*phases, "phases_apart"}
    assert seen.margins["phases_apart"] > 0.0
    for name, (one, other) in phases.items():
        assert abs(one - other) > 1e-4 * one
        assert seen.margins[name] == pytest.approx(float(min(one, other)), rel=1e-9)


# Motions that a problem does not allow.


@pytest.mark.parametrize(("part", "failed"), [(0.99, ("escape",)), (1.01, ())])
@pytest.mark.parametrize("state", ["theta1", "theta2"])
def test_a_coordinate_beyond_its_escape_fails_alone(
    orbit: Orbit,
    problem: Problem,
    machine: HybridDynamics,
    state: str,
    part: float,
    failed: tuple[str, ...],
) -> None:
    start = machine.on_stop(np.array(list(orbit.release_state.values())))
    _, states = simulate(machine, start, until=orbit.period).sampled()
    largest = float(np.max(np.abs(states[:, problem.state_names.index(state)])))
    escape = StateLimit(beyond=part * largest, phrase="it goes over the top")
    seen = verify(orbit, replace(problem, escapes={state: escape}), settings=QUICK)
    assert seen.failed == failed
    assert seen.residuals["escape"] == pytest.approx(1 / part - 1 if failed else 0.0, abs=1e-3)
    assert seen.verdict().endswith("; it goes over the top.") == bool(failed)


def test_a_problem_without_escapes_has_no_residual_of_them(orbit: Orbit, problem: Problem) -> None:
    seen = verify(orbit, replace(problem, escapes={}), settings=QUICK)
    assert "escape" not in seen.residuals


# False statements of an orbit about itself.


def test_an_orbit_with_a_false_shape_is_refused(check: Check, orbit: Orbit) -> None:
    seen = check(changed(orbit, kind=PhaseKind.PLASTIC, impacts=orbit.impacts[:1]))
    assert seen.failed == ()
    assert seen.verdict() == (
        "Refused: the orbit says that its shape is `plastic`, but at restitution 0.2 it is `zeno`."
    )


def test_an_orbit_of_other_equations_with_the_same_name_is_refused(
    check: Check, orbit: Orbit
) -> None:
    foreign = tuple(value + 1e-3 for value in orbit.problem_digest)
    seen = check(replace(orbit, problem_digest=foreign))
    assert seen.failed == ()
    assert "Refused: the equations of problem `motor_pendulum` differ from those" in seen.verdict()


def test_an_orbit_of_an_older_file_is_verified_without_a_digest(check: Check, orbit: Orbit) -> None:
    assert check(replace(orbit, problem_digest=())).passed


def test_a_period_near_the_largest_number_is_refused_without_a_warning(
    check: Check, orbit: Orbit
) -> None:
    assert check(replace(orbit, period=1e308)).failed == ("period",)


# Orbits that do not fit.


def test_an_orbit_of_another_problem_is_refused(orbit: Orbit, problem: Problem) -> None:
    with pytest.raises(InputError, match="must be of problem `motor_pendulum`"):
        verify(replace(orbit, problem="bouncing_ball"), problem)


def test_an_orbit_without_impacts_is_refused(orbit: Orbit, problem: Problem) -> None:
    with pytest.raises(InputError, match="lacks an impact"):
        verify(changed(orbit, impacts=()), problem)


@pytest.mark.parametrize(
    ("where", "named"), [("release_state", "start_state"), ("zeno_state", "zeno stop")]
)
def test_a_state_that_is_not_named_is_refused(
    orbit: Orbit, problem: Problem, where: str, named: str
) -> None:
    state = {name: value for name, value in orbit.release_state.items() if name != "current"}
    with pytest.raises(InputError, match=f"`{named}`, but it lacks `current`: add"):
        verify(changed(orbit, **{where: state}), problem)


def test_an_impact_with_unknown_states_is_refused(orbit: Orbit, problem: Problem) -> None:
    state = {**orbit.release_state, "theta3": 0.0}
    with pytest.raises(InputError, match="`impact stop`, but it names `theta3`: remove"):
        verify(changed(orbit, impacts=(OrbitImpact(time=1.0, state_minus=state),)), problem)


@pytest.mark.parametrize("where", ["gains", "parameters"])
def test_numbers_that_are_missing_are_refused(orbit: Orbit, problem: Problem, where: str) -> None:
    values = dict(getattr(orbit, where))
    name, _ = values.popitem()
    with pytest.raises(InputError, match=f"but it lacks `{name}`"):
        verify(replace(orbit, **{where: values}), problem)


def test_a_period_too_short_for_a_return_is_refused(check: Check, orbit: Orbit) -> None:
    seen = check(replace(orbit, period=1e-3))
    assert not seen.passed
    assert "The event `release stop` does not follow" in seen.trouble


def test_a_pendulum_at_rest_is_no_orbit(check: Check, orbit: Orbit) -> None:
    seen = check(changed(orbit, release_state=dict.fromkeys(orbit.release_state, 0.0)))
    assert not seen.passed
    assert "The event `release stop` does not follow" in seen.trouble
