"""What the prover encloses holds simulations of thirty digits, from anywhere in its box."""

from __future__ import annotations

from decimal import Decimal, localcontext
from typing import Any

import casadi as ca
import numpy as np
import pytest
from flint import arb, ctx

import zeno_orbits as zo
from tests.reference.many_digits.execution import extended_execution
from tests.support import hard_to_prove
from tests.support.cases import fast, often
from tests.support.orbits import shot_orbit
from zeno_orbits.orbits import Orbit
from zeno_orbits.proof.arithmetic.balls import matrix
from zeno_orbits.proof.integration.ball_system import BallSystem, PeriodStart, SectionKind
from zeno_orbits.proof.integration.flow import BallFlow, enclose
from zeno_orbits.proof.integration.machine import BallMachine
from zeno_orbits.proof.integration.section import section_places, start_on_section
from zeno_orbits.proof.integration.sets import Departure, ProofStage, start_set
from zeno_orbits.proof.integration.walk import ProofPassage, WalkSettings, walk

_BITS = 128
_TRUE = arb("1e-19")
"""How far the simulations may be off; they are asked for twenty digits."""


def _decimal(x: Any) -> Decimal:
    return Decimal(x.mid().str(40, radius=False))


def _holds(ball: Any, truth: Decimal) -> bool:
    return bool((ball + arb(0, _TRUE)).overlaps(arb(str(truth))))


def _check(orbit: Orbit, radius: float, shares: list[float]) -> None:
    """Follow a box, and a point of it in many digits; compare all events and the end."""
    problem = zo.load_problem(orbit.problem)
    values = orbit.values(problem)
    with ctx.workprec(_BITS):
        machine = BallMachine(
            problem, values, {}, 1.0, section=PeriodStart(SectionKind.RELEASE), is_graph=False
        )
        system = machine.view(0, ())
        y = list(problem.state_vector(orbit.start_state))
        places, others = section_places(system, y)
        radii = [radius * max(abs(y[k]), 1e-3) for k in places]
        exact = [arb(value) for value in y]
        start = start_on_section(system, exact, places, others, radii)
        begin = ProofStage.started(start.at, Departure.RELEASED, (0, (), -1))
        passage = walk(machine, begin, 1, WalkSettings(), lambda *_: None)
        offset = [arb(s) * r for s, r in zip(shares, radii, strict=False)]
        inside = list(exact)
        for k, change in zip(places, offset, strict=True):
            inside[k] = inside[k] + change
        point = start_on_section(system, inside, places, others, [0.0] * len(places)).at.m
        _compare(problem, values, passage, point, offset)


def _compare(
    problem: Any, values: Any, passage: ProofPassage, point: Any, offset: list[Any]
) -> None:
    with localcontext() as digits:
        digits.prec = 60
        state = [_decimal(x) for x in point]
        until = float(passage.period.middle.mid()) + 1e-4
        run = extended_execution(problem, values, state, until=until, digits=20)
    # A start on the edge of release may count as a release at time zero.
    (release,) = [one for one in run.releases if one.time > Decimal("1e-9")]
    (zeno,) = run.zeno_points
    assert len(run.impacts) > 5
    for truth, time in zip(run.impacts, passage.impact_times, strict=False):
        assert _holds(time.at(offset), truth.time)
    assert _holds(passage.zeno_times[0].at(offset), zeno.time)
    assert _holds(passage.period.at(offset), release.time)
    for ball, truth in zip(passage.end.at.box, release.state, strict=True):
        assert _holds(ball, truth)


@pytest.mark.slow
@pytest.mark.parametrize("name", fast(1, ["vibrating_table", "forced_oscillator", "motor_valve"]))
def test_a_single_point_is_enclosed(name: str) -> None:
    gains = {gain.name: gain.default for gain in zo.load_problem(name).gains}
    _check(zo.find_orbit_by_shooting(name, gains=gains).unwrap(), 1e-9, [])


@pytest.mark.slow
@pytest.mark.parametrize("radius", often(1, [1e-8, 1e-12]))
def test_points_anywhere_in_a_box_are_enclosed(radius: float) -> None:
    orbit = shot_orbit("torque_pendulum")
    random = np.random.default_rng(1)
    corners = [[1.0, 1.0], [-1.0, 1.0]]
    for shares in (*corners, *random.uniform(-1.0, 1.0, (2, 2)).tolist()):
        _check(orbit, radius, shares)


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


def _linear(rate: float) -> BallFlow:
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    return BallFlow(x, p, p * x, None, [arb(rate)])


@pytest.mark.parametrize("rate", [1.0, -1.0, -3000.0])
@pytest.mark.parametrize("size", [2.0**-10, 2.0**-11])
def test_a_step_holds_the_exponential_and_its_derivative(rate: float, size: float) -> None:
    with ctx.workprec(96):
        flow = _linear(rate)
        box = [arb(2, 1e-6)]
        step = enclose(flow, flow.series(box, 28), arb(size), (34, 28))
        assert step is not None
        with ctx.workprec(256):
            grown = (arb(rate) * size).exp()
        point = step.point(flow.point_series([arb(2)], 34), arb(size))[0]
        assert point.overlaps(2 * grown)
        assert abs(point - 2 * grown) < 1e-12
        assert step.derivative(arb(size))[0, 0].contains(grown)
        assert all(step.box[0].contains(2 * (arb(rate) * size * k / 8).exp()) for k in range(9))


def test_a_step_that_is_too_long_has_no_box() -> None:
    x = ca.SX.sym("x")
    flow = BallFlow(x, ca.SX(0, 1), x**2, None, [])
    with ctx.workprec(96):
        series = flow.series([arb(1)], 20)
        # The motion 1 / (1 - t) leaves every box by t = 1.
        assert enclose(flow, series, arb(2), (20, 20)) is None
        assert enclose(flow, series, arb(0.25), (20, 20)) is not None


def test_halving_a_step_tightens_what_is_handed_on() -> None:
    x = ca.SX.sym("x", 2)
    flow = BallFlow(x, ca.SX(0, 1), ca.vertcat(x[1], -ca.sin(x[0])), None, [])
    widths = []
    with ctx.workprec(96):
        for halvings in (0, 1, 2):
            size = arb(0.5) / 2**halvings
            at = start_set([arb(1), arb(0)], matrix([[1, 0], [0, 1]], 2), [arb(0, 1e-9)] * 2, ())
            for _ in range(2**halvings):
                step = enclose(flow, flow.series(at.box, 10), size, (12, 10))
                assert step is not None
                image = step.point(flow.point_series(at.m, 12), size)
                at = at.mapped(image, step.derivative(size), [0, 1], np.ones(2))
            widths.append(max(one.rad() for one in at.derivative.entries()))
    assert widths[2] < widths[1] < widths[0]
