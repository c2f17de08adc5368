"""What the prover encloses holds simulations of thirty digits, from anywhere in its box."""

from __future__ import annotations

from decimal import Decimal, localcontext
from typing import Any

import numpy as np
import pytest
from flint import arb, ctx

import zeno_orbits as zo
from tests.reference.many_digits.execution import extended_execution
from zeno_orbits.orbits import ZenoOrbit
from zeno_orbits.proof.integration.ball_system import BallSystem
from zeno_orbits.proof.integration.section import section_places, start_on_section
from zeno_orbits.proof.integration.sets import ProofStage
from zeno_orbits.proof.integration.walk import ProofPassage, WalkSettings, walk

_BITS = 128
_TRUE = arb("1e-19")
"""How far the simulations may be off; they are asked for twenty digits."""


def _decimal(x: Any) -> Decimal:
    return Decimal(x.mid().str(40, radius=False))


def _holds(ball: Any, truth: Decimal) -> bool:
    return bool((ball + arb(0, _TRUE)).overlaps(arb(str(truth))))


def _check(orbit: ZenoOrbit, radius: float, shares: list[float]) -> None:
    """Follow a box, and a point of it in many digits; compare all events and the end."""
    problem = zo.load_problem(orbit.problem)
    values = orbit.values(problem)
    with ctx.workprec(_BITS):
        system = BallSystem(problem, values)
        y = list(problem.state_vector(orbit.start_state))
        places, others = section_places(system, y)
        radii = [radius * max(abs(y[k]), 1e-3) for k in places]
        exact = [arb(value) for value in y]
        start = start_on_section(system, exact, places, others, radii)
        begin = ProofStage.released(start.at)
        passage = walk(system, begin, 1, WalkSettings(), lambda *_: None)
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
        until = float(passage.release_times[0].middle.mid()) + 1e-4
        run = extended_execution(problem, values, state, until=until, digits=20)
    # A start on the edge of release may count as a release at time zero.
    (release,) = [one for one in run.releases if one.time > Decimal("1e-9")]
    (zeno,) = run.zeno_points
    assert len(run.impacts) > 5
    for truth, time in zip(run.impacts, passage.impact_times, strict=False):
        assert _holds(time.at(offset), truth.time)
    assert _holds(passage.zeno_times[0].at(offset), zeno.time)
    assert _holds(passage.release_times[0].at(offset), release.time)
    for ball, truth in zip(passage.end.at.box, release.state, strict=True):
        assert _holds(ball, truth)


@pytest.mark.parametrize("name", ["vibrating_table", "forced_oscillator", "motor_valve"])
def test_a_single_point_is_enclosed(name: str) -> None:
    gains = {gain.name: gain.default for gain in zo.load_problem(name).gains}
    _check(zo.find_orbit_by_shooting(name, gains=gains).unwrap(), 1e-9, [])


@pytest.mark.slow
@pytest.mark.parametrize("radius", [1e-12, 1e-8])
def test_points_anywhere_in_a_box_are_enclosed(radius: float) -> None:
    orbit = zo.find_orbit_by_shooting("torque_pendulum").unwrap()
    random = np.random.default_rng(1)
    corners = [[1.0, 1.0], [-1.0, 1.0]]
    for shares in (*corners, *random.uniform(-1.0, 1.0, (2, 2)).tolist()):
        _check(orbit, radius, shares)
