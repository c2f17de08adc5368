"""Dry friction: closed forms, another event loop, and wrong declarations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference.friction_loop import LinearMachine
from tests.support.linear_friction import (
    PLASTIC,
    events_of,
    events_of_reference,
    task_of,
    without_impacts,
)
from tests.support.mechanisms import machine_of
from tests.support.orbits import shot_orbit
from tests.support.same_bits import same_bits
from zeno_orbits import orbit_from_json

ROUNDING = 1e-12
"""Relative error of closed forms: steps of the integrator are a tenth as exact."""


def slider_model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a mass on a spring, on a surface that may move, with dry friction."""
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    mass = zo.HybridLagrangian.from_energies(
        q=x, v=v, kinetic=p["m"] * v**2 / 2, potential=p["k"] * x**2 / 2
    )
    pad = zo.DryFriction("pad", rate=v - p["belt"], torque=p["T"], static=p["T0"])
    return zo.hybrid_system(mass, (zo.no_drive(mass), pad))


def slider(*, belt: float = 0.0, torque: float = 1.0, static: float = 1.0) -> zo.Problem:
    values = {"m": 1.3, "k": 4.0, "belt": belt, "T": torque, "T0": static}
    return machine_of(slider_model, {"x": "m", "v": "m/s", "side_pad": "1"}, values)


@pytest.mark.usefixtures("both_loops")
def test_a_block_on_a_belt_sticks_and_slips_in_closed_form() -> None:
    belt, torque, static, stiffness = 0.3, 1.0, 1.5, 4.0
    w = math.sqrt(stiffness / 1.3)
    found = zo.simulate(
        slider(belt=belt, torque=torque, static=static), start={"v": belt}, until=12.0
    )
    leave, middle = static / stiffness, torque / stiffness
    slips = 2 * (math.pi - math.atan((leave - middle) * w / belt)) / w
    back = 2 * middle - leave
    time, wanted = leave / belt, list[tuple[str, float, float]]()
    for _ in range(3):
        wanted += [("slip pad down", time, leave), ("stick pad", time + slips, back)]
        time += slips + (leave - back) / belt
    for event, (name, when, place) in zip(found.switches, wanted, strict=False):
        assert event.name == name
        assert event.time == pytest.approx(when, rel=ROUNDING)
        assert event.state_plus == pytest.approx(
            [place, belt, 0.0 if name == "stick pad" else -1.0], rel=ROUNDING
        )
    assert len(found.switches) >= 6


@pytest.mark.usefixtures("both_loops")
@pytest.mark.parametrize("start", [-3.1, 3.1])
def test_dry_friction_takes_a_fixed_amplitude_in_every_swing(start: float) -> None:
    torque, stiffness = 1.0, 4.0
    found = zo.simulate(slider(torque=torque), start={"x": start}, until=30.0)
    half, band, place, time = math.pi / math.sqrt(stiffness / 1.3), torque / stiffness, start, 0.0
    # The first event at rest takes the side of the motion.
    assert found.switches[0].name == f"slip pad {'down' if start > 0 else 'up'}"
    for event in found.switches[1:]:
        place, time = -math.copysign(abs(place) - 2 * band, place), time + half
        assert event.time == pytest.approx(time, rel=ROUNDING)
        assert event.state_plus[0] == pytest.approx(place, rel=ROUNDING)
        word = "stick" if abs(place) <= band else "turn"
        assert event.name.startswith(word)
    assert abs(place) <= band
    assert found.end_state == pytest.approx([place, 0.0, 0.0], abs=ROUNDING)
    assert found.end_state[1] == 0.0


@pytest.mark.slow
def test_rest_by_friction_is_a_range_of_places() -> None:
    band = 1.0 / 4.0
    for place in (-0.99 * band, 0.4 * band, 0.99 * band):
        found = zo.simulate(slider(), start={"x": place}, until=5.0)
        assert not found.events
        assert found.end_state == pytest.approx([place, 0.0, 0.0], abs=1e-15)
    assert zo.simulate(slider(), start={"x": 1.01 * band}, until=5.0).switches


def test_the_limit_cycle_of_a_belt_forgets_every_disturbance() -> None:
    problem = zo.load_problem("stick_slip")
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    x1, x2, w, belt = 0.125, 0.375, 2.0, 0.3
    slips = 2 * (math.pi - math.atan((x2 - 0.25) * w / belt)) / w
    assert orbit.period == pytest.approx((x2 - x1) / belt + slips, rel=ROUNDING)
    assert zo.floquet_multipliers(orbit, problem=problem).values == (0.0, 0.0)
    assert zo.verify(orbit, problem=problem).passed


def test_an_orbit_of_another_friction_is_not_verified() -> None:
    problem = zo.load_problem("stick_slip")
    orbit = zo.find_orbit_by_shooting(problem, parameters={"T_static": 1.4}).unwrap()
    values = {"parameters": dict(problem.values().parameters)}
    false = orbit_from_json({**orbit.as_json(), **values}, Path("orbit.json"))
    assert not zo.verify(false, problem=problem).passed


def pendulum_with_sign(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return the pendulum with friction as a kink, which may turn but not stick."""
    smooth = zo.load_problem("motor_pendulum").model(p)
    links = smooth.mechanism
    friction = zo.Auxiliary(
        states=(unused := ca.SX.sym("unused")),
        rate=-unused,
        force=ca.vertcat(-p["T_gear"] * ca.sign(links.v[0]), 0),
        loss=p["T_gear"] * ca.fabs(links.v[0]),
    )
    return zo.hybrid_system(links, (smooth.drive, friction), p["restitution"])


@pytest.mark.slow
def test_friction_that_only_turns_is_that_of_a_sign() -> None:
    problem = zo.load_problem("sticking_pendulum")
    found = zo.simulate(problem, until=5.0)
    units = dict(zip(problem.state_names[:-1], problem.state_units, strict=False))
    values = problem.values()
    kinked = machine_of(
        pendulum_with_sign,
        units | {"unused": "1"},
        {k: v for k, v in values.numbers.items() if k != "T_static"},
    )
    start = {k: v for k, v in problem.starts[0].items() if isinstance(v, float)}
    beside = zo.simulate(kinked, start=start, until=5.0)
    assert [e.time for e in found.zeno_points] == pytest.approx(
        [e.time for e in beside.zeno_points], rel=1e-10
    )
    assert found.end_state[:-1] == pytest.approx(beside.end_state[:-1], rel=1e-8, abs=1e-8)


@pytest.mark.slow
def test_the_pendulum_with_friction_begins_at_the_one_without() -> None:
    without = zo.find_orbit_by_shooting("sticking_pendulum", parameters={"T_gear": 0.0}).unwrap()
    assert without.period == pytest.approx(1.81371293903044, rel=1e-11)
    orbit = shot_orbit("sticking_pendulum")
    assert orbit.period < without.period
    certificate = zo.verify(orbit)
    assert certificate.passed, certificate.verdict()


def coulomb_model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return `motor_pendulum` with one friction in its gear, slipping or sticking."""
    smooth = zo.load_problem("motor_pendulum").model(p)
    links = smooth.mechanism
    gear = zo.DryFriction("gear", rate=links.v[0], torque=p["T_gear"])
    return zo.hybrid_system(links, (smooth.drive, gear), p["restitution"])


def sticks_at_last(motion: zo.Execution) -> bool:
    """Return True if the gear has not moved for the last tenth of a motion."""
    last = motion.switches[-1]
    return last.name == "stick gear" and last.time < 0.9 * motion.end_time


@pytest.mark.slow
def test_the_family_in_the_friction_ends_where_simulations_come_to_rest() -> None:
    known = zo.load_problem("sticking_pendulum")
    kept = tuple(one for one in known.parameters if one.name != "T_static")
    problem = replace(known, name="coulomb_pendulum", model=coulomb_model, parameters=kept)
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    (family,) = zo.continue_orbit(orbit, ("T_gear", 0.0, 0.1), problem=problem).families
    (fold,) = (one for one in family.special if one.kind is zo.SpecialPointKind.FOLD)
    assert family.first is not None
    assert family.first.at.value == 0.0
    assert family.first.at.period == pytest.approx(1.81371293903044, rel=1e-10)

    def moved(torque: float, start: Mapping[str, float], until: float) -> zo.Execution:
        return zo.simulate(problem, parameters={"T_gear": torque}, start=start, until=until)

    stable = [one for one in family.points if one.value > 0.0 and abs(one.multipliers[0]) < 0.8]
    assert len(stable) > 10
    for point in stable[::3]:
        *_, before, last = moved(point.value, {"theta1": 1.2}, 100.0).releases
        assert last.time - before.time == pytest.approx(point.period, rel=1e-6)
    # Below the fold it swings on. Beyond it the gear sticks at last, while the knee may swing.
    assert not sticks_at_last(moved(0.99 * fold.at.value, {"theta1": 1.2}, 200.0))
    assert sticks_at_last(moved(1.01 * fold.at.value, {"theta1": 1.2}, 600.0))
    # The unstable orbits are the border: a little less comes to rest, a little more swings.
    border = [one for one in family.points[fold.index + 1 :] if one.multipliers[0].real > 1.3]
    for point in border[:: max(1, len(border) // 3)]:
        start = {name: x for name, x in point.state.items() if name != "side_gear"}
        less, more = (
            moved(point.value, {name: size * x for name, x in start.items()}, 100.0)
            for size in (0.99, 1.01)
        )
        assert sticks_at_last(less)
        assert not sticks_at_last(more)


def kicked_model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a ball above a table that slides, coupled to it by a part of its mass."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    pair = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=ca.sumsqr(v) / 2 + p["c"] * v[0] * v[1],
        potential=9.81 * q[1],
        gap=q[1],
    )
    table = zo.DryFriction("table", rate=v[0], torque=0.5, static=9.0)
    return zo.hybrid_system(pair, (zo.no_drive(pair), table), p["e"])


@pytest.mark.parametrize(("coupling", "moves"), [(0.0, False), (0.4, True)])
def test_an_impact_moves_a_part_that_sticks_only_if_it_gives_it_a_rate(
    coupling: float, moves: bool
) -> None:
    units = {"x": "m", "y": "m", "vx": "m/s", "vy": "m/s", "side_table": "1"}
    problem = machine_of(kicked_model, units, {"c": coupling, "e": 0.5})
    height = 0.3
    found = zo.simulate(problem, start={"y": height}, until=0.3)
    # While the table sticks, the ball falls freely.
    speed = math.sqrt(2 * 9.81 * height)
    assert found.impacts[0].time == pytest.approx(speed / 9.81, rel=ROUNDING)
    assert found.impacts[0].approach_rate == pytest.approx(-speed, rel=ROUNDING)
    # Bounded friction gives no impulse: momentum along x is kept.
    after = found.impacts[0].state_plus
    assert after[2] == pytest.approx(-coupling * 1.5 * speed, abs=1e-12)
    names = [one.name for one in found.switches]
    assert names == (["slip table down"] if moves else [])
    assert all(one.time == found.impacts[0].time for one in found.switches)


@pytest.mark.parametrize(
    ("c", "e"), [(0.05, 0.5), (-0.02, 0.7), (0.08, 0.4), (-0.06, 0.55), (0.4, 0.5)]
)
def test_impacts_beside_a_part_that_they_move_fall_by_the_ratio_of_its_slip(
    c: float, e: float
) -> None:
    units = {"x": "m", "y": "m", "vx": "m/s", "vy": "m/s", "side_table": "1"}
    problem = machine_of(kicked_model, units, {"c": c, "e": e})
    # By hand: inverse mass of ``[[1, c], [c, 1]]``, and accelerations of table and gap.
    inverse, g, torque, side = 1 / (1 - c * c), 9.81, 0.5, -math.copysign(1.0, c)
    b = side * inverse * (c * g - torque * side)
    a = inverse * (-g + c * torque * side)
    mu = abs(c) * (1 + e) / (e * abs(b))
    found, height = zo.simulate(problem, start={"y": 0.3}, until=2.0), 0.3
    zeno, ratio = found.zeno_points[0], e
    if mu * abs(a) < 2:
        ratio = e * math.sqrt(1 + (a + g) * mu * (2 + a * mu))
        # In units of the speed `w` after an impact: the flight, and the way of the table.
        flight = mu + (1 + a * mu + ratio / e) / g
        way = side * abs(b) * mu**2 / 2
        w = e * math.sqrt(2 * g * height)
        assert zeno.time == pytest.approx(w / (e * g) + w * flight / (1 - ratio), rel=1e-13)
        assert zeno.state[0] == pytest.approx(way * w**2 / (1 - ratio**2), rel=1e-12)
        assert list(zeno.state[2:]) == [0.0, 0.0, 0.0]
        assert not [one for one in found.switches if one.time >= zeno.time]
    else:
        assert zeno.state[2] != 0.0
    speeds = np.array([-one.approach_rate for one in found.impacts])
    assert len(speeds) > 6
    assert speeds[1:] / speeds[:-1] == pytest.approx(np.full(len(speeds) - 1, ratio), rel=1e-6)


def hammer() -> LinearMachine:
    """Return `guided_hammer`, whose magnet is a third coordinate that swings freely."""
    p = zo.load_problem("guided_hammer").values().numbers
    mass = np.diag([p["m"], p["M"], 1.0])
    stiffness = np.diag([0.0, p["k"], p["omega"] ** 2])
    stiffness[0, 2] = -p["A"]
    return LinearMachine(
        mass=mass,
        stiffness=stiffness,
        damping=np.diag([0.0, p["c"], 0.0]),
        load=-p["g"] * np.array([p["m"], p["M"], 0.0]),
        normal=np.array([1.0, -1.0, 0.0]),
        restitution=p["restitution"],
        motor=np.zeros(3),
        circuit=(0.0, 1.0, 1.0, 0.0),
        rows=np.array([[1.0, 0.0, 0.0]]),
        belts=np.zeros(1),
        torques=np.array([p["T"]]),
        statics=np.array([p["T_static"]]),
    )


@pytest.mark.slow
def test_the_hammer_follows_another_event_loop() -> None:
    found = zo.simulate("guided_hammer", until=1.0)
    start = np.array([0.01, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    wanted = without_impacts(list(hammer().events(start, 1.0)))
    events = [(time, name.replace("guide", "f0")) for time, name in events_of(found)]
    assert [name for _, name in events] == [name for _, name in wanted]
    assert [time for time, _ in events] == pytest.approx([t for t, _ in wanted], abs=PLASTIC)
    assert {"stick f0", "slip f0 up", "zeno", "release"} <= {name for _, name in events}


@pytest.mark.slow
def test_the_hammer_strikes_once_per_period_and_forgets_as_its_multiplier_says() -> None:
    problem = zo.load_problem("guided_hammer")
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    period = 2 * math.pi / problem.values().numbers["omega"]
    assert orbit.period == pytest.approx(period, rel=1e-14)
    largest, *others = zo.floquet_multipliers(orbit, problem=problem).values
    assert others == [0.0, 0.0]
    assert zo.verify(orbit, problem=problem).passed
    motion = zo.simulate(problem, start={"hammer": 0.012, "cosine": 1.0}, until=7 * period)
    late = np.diff([one.time for one in motion.releases]) - period
    assert late[5] / late[4] == pytest.approx(largest.real, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 8, 13, 33, 42, 53, 61, 72, 79, 85])
def test_random_machines_follow_another_event_loop(seed: int) -> None:
    machine = LinearMachine.random(seed)
    task = task_of(machine, seed, 8.0)
    found = same_bits(task)
    events, wanted = events_of(found), events_of_reference(machine, seed, 8.0)
    assert [name for _, name in events] == [name for _, name in wanted]
    assert [time for time, _ in events] == pytest.approx([t for t, _ in wanted], abs=PLASTIC)


def test_wrong_declarations_are_refused() -> None:
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    pair = zo.HybridLagrangian.from_energies(
        q=q, v=v, kinetic=ca.sumsqr(v) / 2, potential=ca.SX(0), gap=q[1]
    )

    def built(rate: ca.SX, torque: float = 1.0, static: float | None = None) -> None:
        part = zo.DryFriction("pad", rate=rate, torque=torque, static=static)
        zo.hybrid_system(pair, (zo.no_drive(pair), part), ca.SX(0.5))

    for rate, told in (
        (v[1], "`pad` must be free, but it is zero with the closed stop `stop`"),
        (v[0] ** 2, "must be affine in the velocities"),
        (q[0], "must be affine in the velocities"),
    ):
        with pytest.raises(ValueError, match=told):
            built(rate)
    with pytest.raises(ValueError, match="`torque` must be a number >= 0"):
        built(v[0], -1.0)
    with pytest.raises(ValueError, match=r"`static` must be at least the torque 1, but it is 0\.5"):
        built(v[0], 1.0, 0.5)
    with pytest.raises(zo.InputError, match="friction `pad` must be at least its"):
        zo.simulate(slider(torque=1.0, static=0.9), until=1.0)
    with pytest.raises(zo.InputError, match=r"friction `pad` must be at least 0.*it is -1"):
        zo.simulate(slider(torque=-1.0, static=0.9), until=1.0)
    with pytest.raises(zo.InputError, match="`side_pad` = 1 or -1"):
        zo.simulate(slider(), start={"x": 1.0, "side_pad": 0.3}, until=1.0)


@pytest.mark.parametrize(
    ("gap", "is_held"),
    [("q[0] * (1 + q[1])", True), ("q[0] - q[1] ** 2", False), ("q[0] + q[0] * q[1] ** 2", True)],
)
def test_a_rate_that_a_stop_holds_only_while_it_is_closed_is_refused(
    gap: str, is_held: bool
) -> None:
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    # At a zero gap the normal of the first and last is along q0, and nowhere else.
    pair = zo.HybridLagrangian.from_energies(
        q=q, v=v, kinetic=ca.sumsqr(v) / 2, potential=ca.SX(0), gap=eval(gap, {"q": q})
    )
    parts = (zo.no_drive(pair), zo.DryFriction("pad", rate=v[0], torque=1.0))
    if is_held:
        with pytest.raises(ValueError, match="`pad` must be free, but it is zero with the closed"):
            zo.hybrid_system(pair, parts, 0.5)
    else:
        assert zo.hybrid_system(pair, parts, 0.5).graph.n_frictions == 1


@pytest.mark.parametrize("name", ["a pad", "a,b", "pad=1", "p\n"])
def test_a_name_that_is_no_name_of_a_state_is_refused_where_the_part_is_declared(name: str) -> None:
    with pytest.raises(ValueError, match=r"`name` must hold letters, digits .*`side_NAME`"):
        zo.DryFriction(name, rate=ca.SX.sym("v"), torque=1.0)


def test_a_side_that_state_names_leave_out_is_named() -> None:
    right = slider()
    names = [name for name in right.state_names if name != "side_pad"]
    units = tuple(right.units[name] for name in names)
    start = {name: value for name, value in right.starts[0].items() if name in names}
    wrong = replace(right, state_names=tuple(names), state_units=units, starts=(start,))
    with pytest.raises(ValueError, match=r"of drives and clock: .*`side_pad`\), but it names"):
        wrong.checked()


def written_model(force: str, part: str, p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return two masses on springs, with forces and a part that are written as text."""
    x, u = ca.SX.sym("x"), ca.SX.sym("u")
    known: dict[str, Any] = {"x": x, "u": u, "ca": ca, "zo": zo, **p}
    forces = [ca.SX(one) for one in eval(force, known)]
    parts: list[Any] = [eval(part, known)] if part else []
    q, v = ca.vertcat(x, ca.SX.sym("y")), ca.vertcat(u, ca.SX.sym("w"))
    masses = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=ca.sumsqr(v) / 2,
        potential=ca.sumsqr(q) / 2,
        passive_force=ca.vertcat(*forces),
    )
    return zo.hybrid_system(masses, (zo.no_drive(masses), *parts))


def written(force: str, part: str = "") -> zo.Problem:
    units = {"x": "m", "y": "m", "u": "m/s", "w": "m/s"} | ({"side_NAME": "1"} if part else {})
    return machine_of(partial(written_model, force, part), units, {"f": 0.3, "g": 0.2, "b": 0.15})


@pytest.mark.parametrize(
    ("kink", "rest", "rate", "torque"),
    [
        ("-f * ca.sign(u), 0", "0, 0", "u", "f"),
        ("-g * (f + x**2) * ca.sign(2 * (u - b)), 0", "0, 0", "u - b", "g * (f + x**2)"),
        ("ca.if_else(u > 0, -f, f) - 0.1 * u, 0", "-0.1 * u, 0", "u", "f"),
        ("-f * u / ca.fabs(u), f", "0, f", "u", "f"),
        (
            "-(f + g * ca.exp(-(u / b)**2)) * ca.sign(u), 0",
            "0, 0",
            "u",
            "f + g * ca.exp(-(u / b)**2)",
        ),
    ],
)
def test_a_kink_that_slides_is_told_as_the_part_that_sticks_there(
    kink: str, rest: str, rate: str, torque: str
) -> None:
    with pytest.raises(zo.SlidingError) as refused:
        zo.simulate(written(kink), start={"x": 2.0}, until=60.0)
    told = f'zo.DryFriction("NAME", rate={rate}, torque={torque})'
    assert f"declare the part `{told}` in place" in str(refused.value)
    found = zo.simulate(written(rest, told), start={"x": 2.0}, until=refused.value.time + 0.01)
    assert found.switches[-1].name == "stick NAME"
    assert found.switches[-1].time == pytest.approx(refused.value.time, abs=1e-9)


@pytest.mark.parametrize(
    "kink", ["-3 * ca.sign(x + u**3), 0", "-3 * ca.sign(u), -3 * ca.sign(u)", "-3 * ca.sign(u), u"]
)
def test_a_kink_is_told_as_friction_only_if_its_force_is_along_its_rate(kink: str) -> None:
    with pytest.raises(zo.SlidingError) as refused:
        zo.simulate(written(kink), start={"x": 2.0}, until=60.0)
    is_friction = kink.endswith(", u")
    assert ("This is no dry friction" in str(refused.value)) != is_friction
    assert ("DryFriction" in str(refused.value)) == is_friction


@pytest.mark.slow
def test_a_wrong_side_of_a_start_is_set_right_by_its_rate() -> None:
    for side in (-1.0, 0.0, 1.0):
        found = zo.simulate(slider(), start={"v": 1.0, "side_pad": side}, until=0.1)
        assert found.end_state[-1] == 1.0
        assert [one.time for one in found.switches] == ([0.0] if side < 1.0 else [])
