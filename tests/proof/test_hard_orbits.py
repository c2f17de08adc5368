"""Ordinary orbits whose formulas ask something special of a proof are proved by default."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import casadi as ca
import mpmath as mp
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support import hard_to_prove
from tests.support.cases import fast, often
from tests.support.orbits import shot_orbit
from zeno_orbits.errors import TranslationError
from zeno_orbits.proof import Proof, check_proof

ZENO = mp.mpf("5.06454057578434876") - mp.acos(mp.mpf(-0.8))
"""Zeno point of the forced oscillator from its release, published to eighteen digits."""
PHASE = 1.989115685977736
OBSERVED = Path(__file__).parents[1] / "support" / "machines" / "observed_valve.py"


def _proved(problem: zo.Problem, orbit: zo.Orbit | None = None) -> Proof:
    orbit = zo.find_orbit_by_shooting(problem).unwrap() if orbit is None else orbit
    proof = zo.prove(orbit, problem=problem)
    assert proof.proved, proof.verdict()
    return proof


def _is_that_of_the_forced_oscillator(proof: Proof) -> None:
    """Check period and Zeno point; the double -0.8 of the stop moves them by less than 1e-16."""
    assert proof.bounds is not None
    (zeno,) = proof.bounds.zeno_times
    assert proof.bounds.period.misses(float(2 * mp.pi)) < 1e-15
    assert abs(mp.mpf(float(zeno.low)) - ZENO) < 1e-15
    assert zeno.width < 1e-15


@pytest.mark.slow
@pytest.mark.parametrize(
    "problem",
    fast(
        1,
        [
            hard_to_prove.double_well,
            lambda: hard_to_prove.with_gap(lambda d: d + d**2),
            lambda: hard_to_prove.with_gap(lambda d: 3 * d),
            lambda: hard_to_prove.with_force(lambda d: -d / float("inf")),
        ],
    ),
    ids=["unstable rest of a double well", "curved gap", "gap of slope 3", "division by infinity"],
)
def test_a_change_that_leaves_the_orbit_leaves_its_proof(
    problem: Callable[[], zo.Problem],
) -> None:
    _is_that_of_the_forced_oscillator(_proved(problem()))


@pytest.mark.slow
def test_a_curved_guide_with_a_curved_gap_is_proved() -> None:
    assert _proved(hard_to_prove.curved_guide()).bounds is not None


@pytest.mark.slow
def test_certificates_of_a_curved_gap_and_of_a_rest_at_zero_are_well_formed() -> None:
    problem = hard_to_prove.with_gap(lambda d: d + d**2)
    assert check_proof(dict(_proved(problem).certificate), problem).ok


@pytest.mark.slow
def test_a_pendulum_has_the_same_proved_zeno_point_in_its_angle_and_on_a_kept_circle() -> None:
    # The equations share no term: mass, force and gap are those of another coordinate.
    found: list[Proof] = []
    for problem in (hard_to_prove.pendulum(), hard_to_prove.cartesian_pendulum()):
        found.append(_proved(problem))
        verdict = check_proof(dict(found[-1].certificate), problem)
        assert verdict.ok, verdict.claims
    angle, cartesian = (proof.bounds for proof in found)
    assert angle is not None
    assert cartesian is not None
    assert cartesian.period.misses(float(2 * mp.pi)) < 1e-15
    (one,), (other,) = angle.zeno_times, cartesian.zeno_times
    assert max(one.low, other.low) <= min(one.high, other.high)
    assert max(one.width, other.width) < 1e-17


@pytest.mark.parametrize("tension", [1 - 2.0**-40, 1 + 2.0**-52])
def test_a_pendulum_whose_rod_gives_way_is_refused_before_it_is_followed(tension: float) -> None:
    orbit = zo.find_orbit_by_shooting(hard_to_prove.cartesian_pendulum()).unwrap()
    loose = hard_to_prove.cartesian_pendulum(tension)
    proof = zo.prove(replace(orbit, problem_digest=""), problem=loose)
    assert not proof.proved
    assert proof.claim == "hypotheses"
    assert "constraint 1 is not shown to be kept" in proof.verdict()


@pytest.mark.slow
def test_an_observer_that_impacts_change_forgets_its_error_at_its_own_rate() -> None:
    problem = zo.load_problem(OBSERVED)
    proof = _proved(problem)
    assert proof.bounds is not None
    (disc,), period = proof.bounds.multipliers, mp.mpf(float(proof.bounds.period.low))
    # Its error obeys z' = -3 z in flight, in contact and through impacts: it is a closed form.
    assert abs(disc.centre - mp.exp(-3 * period)) < disc.radius + 1e-15
    assert disc.radius < 1e-10
    verdict = check_proof(dict(proof.certificate), problem)
    assert verdict.ok, verdict.claims


@pytest.mark.slow
@pytest.mark.parametrize(
    "same",
    [
        lambda x: x + ca.sinh(x / 4) - (ca.exp(x / 4) - ca.exp(-x / 4)) / 2,
        lambda x: ca.tan(ca.atan2(x, 1)),
        lambda x: x + ca.log1p(ca.expm1(x)) - x,
        lambda x: ca.sin(ca.asin(x / 4)) * 4,
        lambda x: x + ca.cos(ca.acos(x / 64)) - x / 64,
        lambda x: x + ca.sinh(ca.asinh(x / 64)) - x / 64,
        lambda x: ca.atanh(ca.tanh(x)),
        lambda x: x * (ca.cosh(x) ** 2 - ca.sinh(x) ** 2),
        lambda x: x + ca.acosh(ca.cosh(x + 5)) - (x + 5),
    ],
    ids=["sinh", "atan2", "expm1", "asin", "acos", "asinh", "tanh", "cosh", "acosh"],
)
def test_analytic_functions_that_undo_each_other_leave_orbit_and_certificate(
    same: Callable[[ca.SX], ca.SX],
) -> None:
    # The force c (f(d) - d) vanishes for all d, which neither prover nor checker is told.
    problem = hard_to_prove.with_force(lambda d: 0.25 * (same(d) - d))
    proof = _proved(problem)
    _is_that_of_the_forced_oscillator(proof)
    verdict = check_proof(dict(proof.certificate), problem)
    assert verdict.ok, verdict.claims


FORCES: dict[str, Callable[[ca.SX], ca.SX]] = {
    **{
        name: getattr(ca, name)
        for name in ("sin", "tan", "atan", "sinh", "tanh", "asinh", "exp", "expm1", "log1p")
    },
    "cosh": lambda d: d + ca.cosh(d / 4),
    "asin": lambda d: ca.asin(d / 16),
    "acos": lambda d: -ca.acos(d / 16),
    "acosh": lambda d: ca.acosh(2 + d),
    "atanh": lambda d: ca.atanh(d / 16),
    "log": lambda d: ca.log(1 + d),
    "logarithm near its pole": lambda d: ca.log(0.05 + d) / 8,
    "root": lambda d: ca.sqrt(1 + d),
    "cube": lambda d: (1 + d) ** 3 / 16,
    "inverse cube": lambda d: -((1 + d) ** -3),
    "half power": lambda d: (1 + d) ** 2.5 / 4,
    "inverse root": lambda d: -((1 + d) ** -0.5),
    "broken power": lambda d: (1 + d) ** 0.7,
    "power of a number": lambda d: 2**d,
    "angle": lambda d: ca.atan2(d, 1 + d**2),
    "length": lambda d: ca.hypot(d, 1),
}
"""Forces that rise with the distance, from every analytic operation."""


@pytest.mark.slow
@pytest.mark.parametrize("name", often(8, FORCES))
def test_the_checker_has_every_operation_of_the_prover(name: str) -> None:
    force, at_rest = FORCES[name], float(ca.DM(FORCES[name](ca.SX(0))))
    problem = hard_to_prove.with_force(lambda d: -0.1 * (force(d) - at_rest))
    verdict = check_proof(dict(_proved(problem).certificate), problem)
    assert verdict.ok, verdict.claims


@pytest.mark.parametrize(
    ("operation", "error", "words"),
    [
        (ca.erf, TranslationError, "one of them is"),
        (ca.fabs, zo.ZenoOrbitsError, "fabs"),
        (ca.floor, ValueError, "`floor` of the states"),
    ],
    ids=["erf", "fabs", "floor"],
)
def test_an_operation_without_a_rule_is_named(
    operation: Callable[[ca.SX], ca.SX], error: type[Exception], words: str
) -> None:
    orbit = shot_orbit("forced_oscillator")
    problem = hard_to_prove.with_force(lambda d: 0 * d - 1e-9 * operation(d + 9))
    with pytest.raises(error, match=words):
        zo.prove(replace(orbit, problem_digest="", problem=problem.name), problem=problem)


@pytest.mark.slow
def test_parameters_that_vary_may_be_named_in_any_order() -> None:
    orbit = shot_orbit("motor_valve")
    ranges = {"restitution": 1e-5, "V0": 1e-7}
    for names in (("restitution", "V0"), ("V0", "restitution")):
        proof = zo.prove(orbit, interval={name: ranges[name] for name in names})
        assert proof.proved, proof.verdict()
        assert check_proof(dict(proof.certificate)).ok


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["forced_oscillator", pytest.param("solenoid", marks=pytest.mark.slow)]
)
def test_the_certificate_of_plastic_impacts_is_accepted(name: str) -> None:
    problem = zo.load_problem(name)
    orbit = zo.find_orbit_by_shooting(problem, parameters={"restitution": 0.0}).unwrap()
    proof = _proved(problem, orbit)
    verdict = check_proof(dict(proof.certificate), problem)
    assert verdict.ok, verdict.claims
    assert verdict.theorem.plastic


@pytest.mark.weekly
@pytest.mark.slow
def test_the_certificate_of_a_release_in_a_long_step_is_accepted() -> None:
    problem = zo.load_problem("torque_pendulum")
    orbit = zo.find_orbit_by_shooting(problem, parameters={"restitution": 0.2}).unwrap()
    verdict = check_proof(dict(_proved(problem, orbit).certificate), problem)
    assert verdict.ok, verdict.claims


@pytest.mark.weekly
@pytest.mark.slow
def test_the_certificate_of_an_orbit_that_repels_at_zero_holds() -> None:
    problem = hard_to_prove.double_well()
    proof = _proved(problem)
    assert proof.repelling
    verdict = check_proof(dict(proof.certificate), problem)
    assert verdict.ok, verdict.claims


@pytest.mark.parametrize("name", fast(1, ["vibrating_table", "forced_oscillator", "motor_valve"]))
def test_flights_that_are_not_resolved_are_summed_up_earlier(name: str) -> None:
    # Over an interval this wide the late impacts of different restitutions meet no common window.
    orbit = zo.find_orbit_by_shooting(name).unwrap()
    e = dict(orbit.parameters)["restitution"]
    proof = zo.prove(orbit, interval={"restitution": 1e-4})
    assert proof.proved, proof.verdict()
    assert proof.bounds is not None
    for end in (e - 1e-4, e + 1e-4):
        other = zo.find_orbit_by_shooting(name, parameters={"restitution": end}).unwrap()
        (zeno,) = (phase.zeno_time for phase in other.phases)
        # The simulated Zeno time has an error of 1e-11.
        assert proof.bounds.zeno_times[0].misses(zeno or 0.0) < 1e-11
    assert proof.bounds.zeno_times[0].width < 1e-2


@pytest.mark.weekly
@pytest.mark.slow
def test_a_leg_of_nine_states_is_proved_by_default_and_its_certificate_holds() -> None:
    problem = hard_to_prove.leg()
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    proof = _proved(problem, orbit)
    verdict = check_proof(dict(proof.certificate), problem)
    assert verdict.ok, verdict.claims
    assert proof.stable
    assert proof.bounds is not None
    # The voltage has the period of its clock, so the orbit has it, too.
    assert proof.bounds.period.misses(float(2 * mp.pi / 6)) < 1e-15
    found = zo.floquet_multipliers(orbit, problem=problem)
    for disc in proof.bounds.multipliers:
        assert min(abs(disc.centre - value) for value in found.values) < disc.radius + 1e-7


@pytest.mark.weekly
@pytest.mark.slow
def test_a_motion_that_needs_too_many_steps_is_refused_early_with_their_number() -> None:
    # The electrical time constant is a millionth of the period, and no step is much longer.
    orbit = zo.find_orbit_by_shooting("motor_pendulum", parameters={"L": 5e-6}).unwrap()
    started = time.process_time()
    proof = zo.prove(orbit)
    assert proof.claim == "steps"
    assert "steps of" in proof.reason
    assert time.process_time() - started < 60.0


def _thrown_off(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a ball on a shaken table: one plastic impact per period holds, one lets it go."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    clock = zo.Clock.at(1.0)
    double, turned = 2 * clock.sine * clock.cosine, clock.cosine**2 - clock.sine**2
    shake = p["A"] * clock.sine + p["B"] * (double * np.cos(PHASE) + turned * np.sin(PHASE))
    ball = zo.HybridLagrangian.from_energies(
        q=q, v=v, kinetic=v**2 / 2, potential=q, applied_force=shake, gap=q, clock=clock
    )
    return zo.hybrid_system(ball, zo.no_drive(ball), p["restitution"])


@pytest.mark.slow
def test_a_plastic_impact_that_throws_off_is_refused_with_the_force_of_its_stop() -> None:
    problem = zo.Problem(
        name="thrown_off",
        title="ball on a shaken table",
        source="closed form",
        state_names=("q", "v", "cosine", "sine"),
        state_units=("m", "m/s", "1", "1"),
        parameters=(
            zo.Quantity.positive("A", 1.404789965607557, "m/s^2", "shake"),
            zo.Quantity.positive("B", 2.5633084807315303, "m/s^2", "shake"),
            zo.Quantity.restitution(0.0),
        ),
        gains=(),
        model=_thrown_off,
        starts=({"q": 0.5, "cosine": 1.0},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    proof = zo.prove(orbit, problem=problem)
    # Flights in closed form and bisection: the gap accelerates by 1.4833938663521 where it lands.
    assert not proof.proved
    assert "contact ends at once, since the contact force is negative ([-1.48339" in proof.reason
