"""A flat follower on a turning cam of arcs: the arcs, and tables of their lift.

The acceleration of the lift jumps between circular arcs. A cubic table of the lift has flights that
are polynomials. Both are followed in 40 digits by :mod:`tests.reference.cam_follower`. In the frame
of the cam the acceleration of the lift is a force; on a cam of great inertia the table is a gap.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np
import pytest
from mpmath import mp, mpf
from scipy.interpolate import CubicSpline

import zeno_orbits as zo
from tests.reference.cam_follower import DIGITS, Arc, Cam, Course

BASE, NOSE, FLANK, RISE = 0.02, 0.008, 0.06, 0.022
"""Radii of the arcs, and the distance from the axis to the centre of the nose [m]."""
GRAVITY = 9.81
RESTITUTION = 0.4
LOCATED = 1e-10
"""Of times in seconds: cubic tables promise 1e-10, and jumps are events."""


def centre() -> tuple[mpf, mpf]:
    """Return the centre of a flank that touches base and nose, across the axis and along it."""
    with mp.workdps(DIGITS):
        to_base, to_nose, rise = mpf(FLANK) - mpf(BASE), mpf(FLANK) - mpf(NOSE), mpf(RISE)
        along = (rise**2 - to_nose**2 + to_base**2) / (2 * rise)
        return mp.sqrt(to_base**2 - along**2), along


def angles() -> tuple[mpf, mpf]:
    """Return the angles from the nose at which nose and base end."""
    with mp.workdps(DIGITS):
        across, along = centre()
        return mp.atan2(across, mpf(RISE) - along), mp.atan2(across, -along)


def cam_of_arcs(speed: float) -> Cam:
    """Return the cam, which starts with the middle of its base below the follower."""
    with mp.workdps(DIGITS):
        omega, (across, along), (of_nose, of_base) = mpf(speed), centre(), angles()

        def arc(angle: mpf, x: mpf, y: mpf, radius: float) -> Arc:
            # The angle from the nose is ``omega t - pi``.
            def turned(s: mpf) -> tuple[mpf, mpf]:
                return mp.sin(omega * s - mp.pi), mp.cos(omega * s - mp.pi)

            return Arc(
                start=(angle + mp.pi) / omega,
                lift=lambda s: x * turned(s)[0] + y * turned(s)[1] + mpf(radius) - mpf(BASE),
                rate=lambda s: omega * (x * turned(s)[1] - y * turned(s)[0]),
                acceleration=lambda s: -(omega**2) * (x * turned(s)[0] + y * turned(s)[1]),
            )

        arcs = (
            arc(-mp.pi, mpf(0), mpf(0), BASE),
            arc(-of_base, across, along, FLANK),
            # The acceleration of an arc must be monotone: two halves of the nose.
            arc(-of_nose, mpf(0), mpf(RISE), NOSE),
            arc(mpf(0), mpf(0), mpf(RISE), NOSE),
            arc(of_nose, -across, along, FLANK),
            arc(of_base, mpf(0), mpf(0), BASE),
        )
        return Cam(arcs, 2 * mp.pi / omega, mpf(GRAVITY), omega**2 * mpf(FLANK))


def cam_of_spline(spline: CubicSpline) -> Cam:
    """Return the cam whose lift is a spline over the time of a turn."""
    times = spline.x

    def arc(k: int) -> Arc:
        a, b, c, d = (mpf(float(one)) for one in spline.c[:, k])
        begin = mpf(float(times[k]))
        return Arc(
            start=begin,
            lift=lambda s: d + (s - begin) * (c + (s - begin) * (b + (s - begin) * a)),
            rate=lambda s: c + (s - begin) * (2 * b + 3 * a * (s - begin)),
            acceleration=lambda s: 2 * b + 6 * a * (s - begin),
        )

    with mp.workdps(DIGITS):
        steepest = float(np.abs(spline(times, 2)).max())
        arcs = tuple(arc(k) for k in range(len(times) - 1))
        return Cam(arcs, mpf(float(times[-1])), mpf(GRAVITY), mpf(steepest))


def problem(model: Any, names: dict[str, str], start: dict[str, float]) -> zo.Problem:
    """Return the problem of a follower."""
    return zo.Problem(
        name="follower",
        title="flat follower on a cam",
        source="tests/laws/test_cams.py",
        state_names=tuple(names),
        state_units=tuple(names.values()),
        parameters=(zo.Quantity.restitution(RESTITUTION),),
        gains=(),
        model=model,
        starts=(start,),
        portraits=(("y", "v"),),
        amplitude_of="y",
    )


def beside(clock: zo.Clock, acceleration: ca.SX) -> zo.Problem:
    """Return the distance of a follower from a cam whose lift has an acceleration."""

    def model(p: Any) -> zo.CompletedSystem:
        y, v = ca.SX.sym("y"), ca.SX.sym("v")
        mass = zo.HybridLagrangian.from_energies(
            q=y,
            v=v,
            kinetic=v**2 / 2,
            potential=GRAVITY * y,
            gap=y,
            applied_force=-acceleration,
            clock=clock,
        )
        return zo.hybrid_system(mass, zo.no_drive(mass), p["restitution"])

    names = {"y": "m", "v": "m/s", "cosine": "1", "sine": "1"}
    return problem(model, names, {"cosine": 1.0})


def of_arcs(speed: float) -> zo.Problem:
    """Return a follower of the cam of arcs, whose clock starts opposite to the nose."""
    clock = zo.Clock.at(ca.SX(speed))
    cosine, sine = -clock.state[0], -clock.state[1]
    across, along = (float(one) for one in centre())
    of_nose, of_base = (math.cos(float(one)) for one in angles())
    flank = -across * ca.fabs(sine) + along * cosine
    arcs = ca.if_else(cosine > of_nose, RISE * cosine, ca.if_else(cosine > of_base, flank, 0))
    return beside(clock, -(speed**2) * arcs)


def of_record(spline: CubicSpline) -> zo.Problem:
    """Return a follower of a spline, whose second derivative is a record of lines."""
    record = zo.record(spline.x[:-1], spline(spline.x[:-1], 2), period=float(spline.x[-1]))
    clock = zo.Clock.at(ca.SX(record.frequency))
    return beside(clock, record.at(clock))


def on_a_wheel(spline: CubicSpline, inertia: float) -> zo.Problem:
    """Return a follower above a table of the angle of a cam that turns freely at 1 rad/s.

    The follower changes the cam's speed by a share of ``1 / inertia``.
    """
    lifts = spline(spline.x)

    def model(p: Any) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        table = zo.table(q[1], spline.x, lifts, "cubic", outside="extend", name="lift")
        pair = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=(v[0] ** 2 + inertia * v[1] ** 2) / 2,
            potential=GRAVITY * q[0],
            gap=q[0] - table,
        )
        return zo.hybrid_system(pair, zo.no_drive(pair), p["restitution"])

    names = {"y": "m", "angle": "rad", "v": "m/s", "rate": "rad/s"}
    return problem(model, names, {"rate": 1.0, "v": float(spline(0.0, 1))})


def require_course(run: zo.Simulation, wanted: Course, located: float) -> None:
    """Require the releases, impacts and Zeno points of a course."""
    assert [one.time for one in run.releases] == pytest.approx(
        [float(one) for one in wanted.releases], abs=located
    )
    assert [one.time for one in run.zeno_points] == pytest.approx(
        [float(one) for one in wanted.zeno_points], abs=located
    )
    times = np.array([float(one) for one in wanted.impacts])
    assert all(np.min(np.abs(times - one.time)) < located for one in run.impacts)


def splined(cam: Cam, n: int, ends: str) -> CubicSpline:
    """Return the spline through the lift of a cam at equal times of a turn."""
    times = np.linspace(0.0, float(cam.turn), n + 1)
    with mp.workdps(DIGITS):
        lifts = [float(arc.lift(s)) for arc, s in map(cam.at, map(mpf, times[:-1].tolist()))]
    return CubicSpline(times, [*lifts, lifts[0]], bc_type=ends)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [22.0, 25.0, 28.0])
def test_a_follower_leaves_a_cam_of_arcs_and_comes_to_rest_on_it_again(speed: float) -> None:
    wanted = cam_of_arcs(speed).follow(0.9, RESTITUTION)
    assert len(wanted.zeno_points) >= 3
    run = zo.simulate(of_arcs(speed), until=0.9)
    require_course(run, wanted, 1e-13)
    # The acceleration jumps where arcs meet, and the flank's formula has a kink at the nose.
    assert run.switches


@pytest.mark.slow
def test_a_follower_stays_on_a_slow_cam() -> None:
    # The nose falls with at most ``RISE speed^2``.
    speed = 0.999 * math.sqrt(GRAVITY / RISE)
    assert not cam_of_arcs(speed).follow(0.9, RESTITUTION).releases
    assert not zo.simulate(of_arcs(speed), until=0.9).releases
    assert zo.simulate(of_arcs(1.002 * speed), until=0.9).releases


@pytest.mark.parametrize("n", [24, 200, 1001])
def test_a_follower_obeys_the_cubics_of_a_recorded_lift(n: int) -> None:
    spline = splined(cam_of_arcs(25.0), n, "periodic")
    wanted = cam_of_spline(spline).follow(0.7, RESTITUTION)
    assert len(wanted.zeno_points) >= 2
    require_course(zo.simulate(of_record(spline), until=0.7), wanted, 1e-12)


@pytest.mark.parametrize("n", [24, 200])
def test_a_follower_obeys_the_cubics_of_a_table_below_it(n: int) -> None:
    spline = splined(cam_of_arcs(25.0), n, "not-a-knot")
    # At 1 rad/s the angle of the wheel is the time.
    wanted = cam_of_spline(spline).follow(0.25, RESTITUTION)
    assert len(wanted.zeno_points) == 1
    run = zo.simulate(on_a_wheel(spline, 1e9), until=0.25)
    require_course(run, wanted, LOCATED)
    assert not run.switches
