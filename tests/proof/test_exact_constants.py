"""Constants of formulas enter a proof exactly, also where CasADi would fold them in doubles."""

from __future__ import annotations

import casadi as ca
import pytest

from tests.support import hard_to_prove

pytest.importorskip("flint")

from flint import arb, ctx

from zeno_orbits.proof.integration.ball_system import BallSystem


def test_a_derivative_is_no_rounded_sum_of_powers_of_two() -> None:
    problem = hard_to_prove.with_gap(lambda d: d + 2.0**-54 * d + 2.0**-56 * d)
    with ctx.workprec(128):
        slope = 1 + arb(2) ** -54 + arb(2) ** -56
        system = BallSystem(problem, problem.values())
        speed = problem.state_names.index("ddistance")
        rates = system.free.rate([arb(k + 1) / 7 for k in range(system.n)])
        gap_acceleration = rates[system.rate] * system.units[system.rate]
        ratio = gap_acceleration / (rates[speed] * system.units[speed])
        assert ratio.contains(slope)
        assert not ratio.contains(1)


def test_a_number_to_a_power_has_its_own_logarithm() -> None:
    problem = hard_to_prove.with_force(lambda d: -(2**d))
    plain = hard_to_prove.with_force(lambda d: 0 * d)
    with ctx.workprec(128):
        systems = [BallSystem(one, one.values()) for one in (problem, plain)]
        y = [arb(k + 1) / 7 for k in range(systems[0].n)]
        changed, unchanged = (one.free.rate(y)[one.rate] * one.units[one.rate] for one in systems)
        distance = y[systems[0].gap] * systems[0].units[systems[0].gap]
        mass = problem.values().parameters["m"]
        truth = -(arb(2).log() * distance).exp() / arb(mass)
        assert (changed - unchanged).overlaps(truth)
        assert (changed - unchanged - truth).abs_upper() < 1e-30
        rounded = (arb(float(ca.log(2.0))) * distance).exp() / arb(mass)
        assert not (changed - unchanged).overlaps(-rounded)
