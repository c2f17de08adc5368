"""Theorems about repelling orbits that a feedback holds, and what is not proved about them."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference.held_by_hand import walked
from tests.support.repelling import repelling_orbit
from zeno_orbits.proof import check_proof

SLOPE = 0.02


@cache
def _walks() -> zo.Orbit:
    gentle = zo.find_orbit_by_shooting("slope_walker").unwrap()
    parameters = {"slope": SLOPE}
    return zo.find_orbit_by_shooting("slope_walker", parameters=parameters, near=gentle).unwrap()


def _proof(machine: zo.Problem, **parameters: float) -> zo.Proof:
    orbit = zo.find_orbit_by_shooting(machine, parameters=parameters).unwrap()
    proof = zo.prove(orbit, problem=machine)
    assert proof.proved, proof.verdict()
    verdict = check_proof(dict(proof.certificate), machine)
    assert verdict.ok, verdict.verdict()
    return proof


@pytest.mark.slow
def test_the_return_map_of_a_held_walker_contracts() -> None:
    found = zo.design_feedback(_walks(), ["hip"])
    proof = _proof(found.machine())
    assert proof.stable
    assert not proof.repelling
    assert "the norm of DP (largest row sum) in the basis of the certificate is at most 0.507" in (
        "\n".join(proof.lines())
    )
    assert proof.bounds is not None
    # The multipliers of the design, which are computed without balls.
    discs = sorted(proof.bounds.multipliers, key=lambda one: -abs(one.centre))
    for disc, value in zip(discs, found.multipliers, strict=False):
        assert abs(disc.centre - value) < disc.radius + 1e-8
    # A step of SciPy from the enclosed state returns to it.
    names = ("stance", "swing", "dstance", "dswing")
    middle = [float(proof.bounds.start_state[one].low) for one in names]
    after = walked(SLOPE, np.array(middle), lambda _: 0.0, 1)[0]
    for name, value in zip(names, after, strict=True):
        assert proof.bounds.start_state[name].misses(float(value)) < 1e-10
    assert proof.bounds.start_state["held_hip"].misses(0.0) < 1e-13


@pytest.mark.slow
def test_coefficients_that_do_not_hold_prove_that_the_orbit_repels() -> None:
    machine = zo.design_feedback(_walks(), ["hip"]).machine()
    names = [one.name for one in machine.parameters if one.name.startswith("K_hip_")]
    assert len(names) == 3
    free = _proof(machine, **dict.fromkeys(names, 0.0))
    assert free.repelling
    assert not free.stable


@pytest.mark.slow
def test_the_short_gait_that_repels_more_is_proved() -> None:
    gentle = zo.find_orbit_by_shooting("slope_walker").unwrap()
    orbit = zo.find_orbit_by_shooting("slope_walker", parameters={"slope": 0.025}, near=gentle)
    found = zo.design_feedback(orbit.unwrap(), ["hip"])
    assert abs(found.returns.multipliers[0]) > 5.9
    assert _proof(found.machine()).stable


@pytest.mark.slow
@pytest.mark.weekly
def test_a_held_walker_with_a_motor_at_its_hip_is_proved() -> None:
    first = zo.find_orbit_by_shooting("compass_walker").unwrap()
    gains = {"push": 0.08}
    orbit = zo.find_orbit_by_shooting("compass_walker", gains=gains, near=first).unwrap()
    found = zo.design_feedback(orbit, {"K_hip": (-math.inf, math.inf)})
    assert abs(found.returns.multipliers[0]) > 1.29
    assert _proof(found.machine()).stable


def test_a_law_with_limits_is_refused_by_its_operation() -> None:
    machine = zo.design_feedback(_walks(), {"hip": (-1.0, 1.0)}).machine()
    orbit = zo.find_orbit_by_shooting(machine).unwrap()
    with pytest.raises(ValueError, match="one of them is `fmax`"):
        zo.prove(orbit, problem=machine)


@pytest.mark.slow
def test_states_that_a_release_sets_are_refused_by_the_missing_lemma() -> None:
    machine = zo.design_feedback(repelling_orbit(), ["Kp"]).machine()
    proof = zo.prove(zo.find_orbit_by_shooting(machine).unwrap(), problem=machine)
    assert not proof.proved
    assert proof.reason == (
        "an event of a stop sets states anew, and no lemma covers that: `verify` checks such an "
        "orbit numerically"
    )
