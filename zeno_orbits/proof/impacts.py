r"""An impact, and the infinitely many impacts of a Zeno tail, as maps of sets with derivatives.

Lemma. Let a polydisc of states around the set, and of rates :math:`|w| \le \bar w`, be complex, and
on a box `B` around it :math:`\ddot h` in a disc of middle :math:`a_0` and radius :math:`r_a`,
:math:`|f_i| \le F_i`, :math:`|d_i| \le D_i`. A flight from rate `w` then lasts at most `S w`, with
:math:`S = 2 / (|a_0| - r_a)`, the next rate is at most :math:`\rho = e \kappa` times the last, with
:math:`\kappa = 1 + 4 r_a / (|a_0| - r_a)`, and a state moves by at most :math:`c_i w` from impact
to impact, :math:`c_i = S F_i + (1 + e) \kappa D_i`. If :math:`\rho < 1`, impacts accumulate, and
the Zeno point is analytic and within :math:`c_i w / (1 - \rho)` of the state; Cauchy's bound on the
polydisc holds its derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence

from flint import acb, arb

from zeno_orbits.errors import ProofError
from zeno_orbits.proof.ball_system import BallSystem, require_proved
from zeno_orbits.proof.balls import ONE, ZERO, Ball, identity, matrix, symmetric
from zeno_orbits.proof.stage import Departure, ProofRecord, ProofStage

_SPEED_SHARE = 0.25
"""Part of the polydisc that its fastest tail may cross."""
_RADII = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
"""Radii of the polydisc that are tried, per size of a state."""


def strike(system: BallSystem, stage: ProofStage) -> tuple[ProofRecord, ProofStage]:
    """Return the record of an impact and the set after it.

    Args:
        system: The problem.
        stage: Where the stop is met.
    """
    at, box = stage.at, stage.at.box
    derivative = system.reset_derivative(box)
    result = at.mapped(system.reset(at.m), derivative, system.groups["beside"])
    record = ProofRecord(kind="impact", numbers={}, orders=(), result=result)
    after = Departure.LOCKED if system.plastic else Departure.STRUCK
    return record, stage.next(result, after, stage.time)


def settle_impacts(system: BallSystem, stage: ProofStage) -> tuple[ProofRecord, ProofStage]:
    """Return the record of a Zeno tail and the set of Zeno points.

    Args:
        system: The problem.
        stage: Just after an impact.

    Raises:
        ProofError: If impacts are not proved to accumulate.
    """
    reason = ""
    for share in _RADII:
        try:
            return _settled(system, stage, share)
        except ProofError as error:
            reason = error.reason
    raise ProofError("zeno_point", reason)


def _settled(system: BallSystem, stage: ProofStage, share: float) -> tuple[ProofRecord, ProofStage]:
    n, gap, rate = system.n, system.gap, system.rate
    at, box = stage.at, stage.at.box
    speed_now = box[rate].abs_upper()
    radius = [arb(share) * (1 + x.abs_upper()) for x in box]
    radius = [arb(float(one.mid())) for one in radius]
    speed, e = arb(share * 1e-6), system.impact(box).restitution.upper()
    for _ in range(40):
        # The gap and its rate stay far within these in all flights, as `_bounds` checks.
        radius[gap] = speed
        radius[rate] = arb(float((speed * (4 + 8 / (1 - e))).mid()))
        found = _bounds(system, box, radius, speed)
        if found is not None:
            break
        speed = speed / 4
        require_proved(bool(speed > 2 * speed_now), "zeno_point", "no polydisc holds the tail")
    else:
        raise ProofError("zeno_point", "no polydisc holds the tail")
    c, rho, longest, delta = found
    left = 1 - rho
    off = speed - speed_now
    require_proved(bool(off > 0), "zeno_point", "the gap rate exceeds that of the polydisc")
    image = list(at.m)
    w = at.middle_box[rate].abs_upper()
    rows = identity(n).table()
    for i in range(n):
        rows[i][gap] = ZERO
        reach = c[i] / left
        image[i] = image[i] + symmetric(reach * w)
        for j in range(n):
            if j == rate:
                rows[i][j] = symmetric(reach * (1 + speed_now / off))
            elif j != gap and not c[i].is_zero():
                rows[i][j] = rows[i][j] + symmetric(reach * speed_now / delta[j])
    for i in (gap, rate):
        rows[i], image[i] = [ZERO] * n, ZERO
    result = at.mapped(image, matrix(rows, n), system.groups["beside"])
    time = stage.time.later((longest * speed_now / left).union(ZERO))
    numbers = {"radius": radius, "speed": speed}
    record = ProofRecord(kind="tail", numbers=numbers, orders=(), result=result)
    return record, stage.next(result, Departure.LOCKED, time)


def _bounds(
    system: BallSystem, box: Sequence[Ball], radius: Sequence[Ball], speed: Ball
) -> tuple[list[Ball], Ball, Ball, list[Ball]] | None:
    """Return `c`, `rho`, `S` and what is left of the polydisc; None if it is not enough."""
    gap, rate = system.gap, system.rate
    wide = [acb(x + arb(0, r), arb(0, r)) for x, r in zip(box, radius, strict=True)]
    flow, direction, e = system.free_values(wide)
    e = e.abs_upper()
    a = flow[rate]
    a0 = a.real.mid()
    spread = (a - a0).abs_upper()
    slack = -a0 - spread
    if not bool(slack > 0):
        raise ProofError("zeno_point", f"`gap_acceleration` is not proved negative there ({a})")
    longest = 2 / slack
    kappa = 1 + 4 * spread / slack
    rho = e * kappa
    if not bool(rho < 1):
        raise ProofError("zeno_point", f"impacts are not proved to shrink (ratio {rho})")
    c: list[Ball] = []
    delta: list[Ball] = []
    for i in range(system.n):
        if i in (gap, rate):
            c.append(ZERO)
            delta.append(ONE)
            continue
        moved = longest * flow[i].abs_upper()
        c.append(moved + (1 + e) * kappa * direction[i].abs_upper())
        if c[i].is_zero():
            delta.append(radius[i])
            continue
        delta.append(radius[i] - speed * (moved + c[i] / (1 - rho)))
        if not bool(delta[i] > 0):
            return None
    # In flight the rate is at most (2 + kappa) w, and the gap what that makes in a time S w.
    high, fast = longest * speed * flow[gap].abs_upper(), speed * (2 + kappa)
    if not (bool(high < radius[gap]) and bool(fast < radius[rate])):
        return None
    return c, rho, longest, delta
