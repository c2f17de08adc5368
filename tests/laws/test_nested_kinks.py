"""Kinks of kinks, tables, angles and waveforms: linear pieces by matrix exponentials.

A mass on a spring carries a coil. A law of the voltage depends on the signs of the clock and, where
it is not limited, linearly on the position. So the state is a product of matrix exponentials over
quarters of a period.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import casadi
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.nested_kinks import FORCES, half_periods, nested_problem
from tests.support.random_machines import RandomMachine
from zeno_orbits.arrays import Vector

ca: Any = casadi

SPEED, PHASE, WEIGHT = math.pi / 2, 0.5, 100.0
"""Frequency of the clock, its phase at the start, and the weight of a mass in contact."""
NAMES = ("q", "v", "current", "cosine", "sine")
Law = Callable[[Any, Any, zo.Clock], Any]


class Case(NamedTuple):
    """A law of the voltage.

    Attributes:
        law: The voltage from position, current and clock.
        truth: From whether sine and cosine are positive to the constant part of the voltage and its
            slope in the position.
    """

    law: Law
    truth: Callable[[bool, bool], tuple[float, float]]


def _wave(clock: zo.Clock, high: float, low: float) -> Any:
    return ca.if_else(clock.sine > 0, high, low)


def _table(x: Any) -> Any:
    return ca.interpolant("table", "linear", [[0, 1, 2, 4]], [0, 3, 7, 6])(x)


def _piecewise(clock: zo.Clock) -> Any:
    return zo.piecewise(clock, levels=(40, 0), times=(clock.period / 2,))


CASES = {
    "limit of a wave": Case(
        lambda q, _, clock: ca.fmin(12, _wave(clock, 40, 0) - 0.1 * q),
        lambda up, _: (12, 0) if up else (0, -0.1),
    ),
    "limit of a wave without the state": Case(
        lambda _, i, clock: ca.fmin(12, _wave(clock, 40, 0)) + 0 * i,
        lambda up, _: (12, 0) if up else (0, 0),
    ),
    "limit of a piecewise input": Case(
        lambda q, _, clock: ca.fmin(12, _piecewise(clock) - 0.1 * q),
        lambda up, _: (12, 0) if up else (0, -0.1),
    ),
    "two limits": Case(
        lambda q, _, clock: ca.fmax(-3, ca.fmin(12, _wave(clock, 40, -40) - 0.1 * q)),
        lambda up, _: (12, 0) if up else (-3, 0),
    ),
    "size of a wave": Case(
        lambda q, _, clock: ca.fabs(_wave(clock, 40, -20) - 0.1 * q),
        lambda up, _: (40, -0.1) if up else (20, 0.1),
    ),
    "choice by a limit": Case(
        lambda q, _, clock: ca.if_else(ca.fmin(12, _wave(clock, 40, 0) + 0.1 * q) > 10, 3, -1 + q),
        lambda up, _: (3, 0) if up else (-1, 1),
    ),
    "choice at a limit": Case(
        lambda q, _, clock: ca.if_else(ca.fmin(12, _wave(clock, 40, 0) + 0.1 * q) >= 12, 3, -1),
        lambda up, _: (3, 0) if up else (-1, 0),
    ),
    "least of two waves": Case(
        lambda q, _, clock: ca.fmin(
            ca.if_else(clock.cosine > 0, 20, 4) + 0.1 * q, _wave(clock, 40, 12)
        ),
        lambda up, right: (20.0 if right else 4.0, 0.1) if up or not right else (12, 0),
    ),
    "two waves that switch together": Case(
        lambda q, _, clock: (
            _wave(clock, 3, -1) + ca.if_else(clock.sine * clock.cosine > 0, 5, 2) + 0.1 * q
        ),
        lambda up, right: ((3 if up else -1) + (5 if up == right else 2), 0.1),
    ),
    "function of a kink": Case(
        lambda q, _, clock: ca.fabs(ca.tanh(3 * ca.fabs(clock.sine))) * 0 + _wave(clock, 2, 1) + q,
        lambda up, _: (2 if up else 1, 1),
    ),
    "table of a wave": Case(
        lambda q, _, clock: _table(_wave(clock, 1.5, 0.25) + 0.001 * q),
        lambda up, _: (5, 0.004) if up else (0.75, 0.003),
    ),
    "square root of a wave": Case(
        lambda q, _, clock: ca.fmin(
            2, ca.if_else(clock.sine > 0, 1e3 * ca.sqrt(clock.sine + 0.5), q / 1e3 - 4)
        ),
        lambda up, _: (2, 0) if up else (-4, 1e-3),
    ),
    "angle beyond its cut": Case(
        lambda q, _, clock: ca.atan2(_wave(clock, 1, -1), -1 + 0 * q) + 0.1 * q,
        lambda up, _: (0.75 * math.pi if up else -0.75 * math.pi, 0.1),
    ),
}


def _problem(law: Law, *, in_contact: bool = False, switches: Any = None) -> zo.Problem:
    def model(p: Any) -> zo.CompletedSystem:
        q, v, current = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("current")
        clock = zo.Clock.at(ca.SX(SPEED))
        mass = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=q**2 / 2 + (WEIGHT * q if in_contact else 0),
            gap=q if in_contact else q + 1e5,
            clock=clock,
        )
        one = ca.SX(1)
        motor = zo.MotorBank(
            selection=one,
            resistance=one,
            inductance=one,
            torque_constant=one,
            emf_constant=one,
            voltage=law(q, current, clock),
            current=current,
        )
        given = {} if switches is None else {"switches": switches}
        return zo.hybrid_system(mass, zo.full_drive(mass, motor), p["restitution"], **given)

    return zo.Problem(
        name="coil",
        title="coil",
        source="closed form",
        state_names=NAMES,
        state_units=("m", "m/s", "A", "1", "1"),
        parameters=(zo.Quantity.restitution(0.0),),
        gains=(),
        model=model,
        starts=({"cosine": math.cos(PHASE), "sine": math.sin(PHASE)},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )


def _pieces(case: Case, until: float, *, in_contact: bool) -> list[Vector]:
    """Return the flow over each quarter of a period, as a matrix of ``(q, v, i, 1)``."""
    quarter = 1.0
    time, first = 0.0, quarter - PHASE / SPEED
    found: list[Vector] = []
    while time < until:
        end = min(until, first if time == 0.0 else time + quarter)
        angle = SPEED * (time + end) / 2 + PHASE
        constant, slope = case.truth(math.sin(angle) > 0.0, math.cos(angle) > 0.0)
        rates = np.array([[0, 1, 0, 0], [-1, 0, 1, 0], [slope, -1, -1, constant], [0, 0, 0, 0]])
        if in_contact:
            rates[:2] = 0.0
            rates[2, :2] = 0.0
        found.append(expm(rates * (end - time)))
        time = end
    return found


def _truth(case: Case, until: float, *, in_contact: bool) -> Vector:
    y = np.array([0.0, 0.0, 0.0, 1.0])
    for matrix in _pieces(case, until, in_contact=in_contact):
        y = matrix @ y
    return y[:3]


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("in_contact", fast(1, [True, False]))
def test_all_conditions_take_their_sides_anew_at_every_switch(name: str, in_contact: bool) -> None:
    case = CASES[name]
    # Kinks are events with and without the argument `switches`.
    problem = _problem(case.law, in_contact=in_contact, switches=() if in_contact else None)
    assert zo.simulate(problem, until=7.3).end_state[:3] == pytest.approx(
        _truth(case, 7.3, in_contact=in_contact), rel=1e-9, abs=1e-9
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["limit of a wave", "limit of a piecewise input", "choice at a limit", "table of a wave"],
)
def test_a_rig_takes_all_sides_anew(name: str) -> None:
    case = CASES[name]
    rig = zo.Rig(contact=zo.Contact(stiffness=1e4))
    run = zo.simulate_rig(_problem(case.law), rig, until=7.3, parameters={"restitution": 0.5})
    want = _truth(case, 7.3, in_contact=False)
    assert run.states[-1, :3] == pytest.approx(want, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("name", ["limit of a wave", "size of a wave", "table of a wave"])
def test_multipliers_are_those_of_the_product_of_the_pieces(name: str) -> None:
    case = CASES[name]
    orbit = zo.find_orbit(_problem(case.law)).unwrap()
    period = np.linalg.multi_dot(_pieces(case, 4.0, in_contact=False)[::-1])
    want = np.linalg.eigvals(period[:3, :3])
    got = np.array(orbit.floquet_multipliers)
    assert orbit.period == pytest.approx(4.0, rel=1e-10)
    assert np.sort(np.abs(got))[::-1][:3] == pytest.approx(np.sort(np.abs(want))[::-1], abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("name", FORCES)
def test_maps_and_orbits_have_the_multipliers_of_nested_kinks(name: str, tmp_path: Path) -> None:
    file = tmp_path / "nested.py"
    file.write_text(nested_problem(FORCES[name][0]), encoding="utf-8")
    up, down = half_periods(name)
    eigenvalues: Any = np.linalg.eigvals
    want: Any = np.sort(np.abs(eigenvalues(down[:2, :2] @ up[:2, :2])))
    fixed: Any = np.linalg.solve(np.eye(2) - (down @ up)[:2, :2], (down @ up)[:2, 2])
    orbit = zo.find_orbit(str(file)).unwrap()
    begin = math.atan2(orbit.start_state["sine"], orbit.start_state["cosine"])
    assert orbit.period == pytest.approx(2 * math.pi, rel=1e-10)
    assert np.sort(np.abs(orbit.floquet_multipliers)) == pytest.approx(want, abs=1e-9)
    until = 2 * math.pi - begin % (2 * math.pi) or 2 * math.pi
    run = zo.simulate(str(file), until=until, start=orbit.start_state)
    assert run.end_state[:2] == pytest.approx(fixed, abs=1e-8)
    plane = zo.parameter_map(str(file), x=("q", 0.0, 20.0, 2), y=("v", -3.0, 3.0, 2))
    for one in plane.attractors:
        assert np.sort(np.abs(one.multipliers)) == pytest.approx(want, abs=1e-7)


def test_a_reset_takes_all_sides_anew() -> None:
    """A switch turns the sign of a state, which selects a wave within a limit."""
    q, v, z = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("z")

    def model(p: Any) -> zo.CompletedSystem:
        clock = zo.Clock.at(ca.SX(SPEED))
        force = ca.fmin(1, ca.if_else(z > 0, 4, -2) + 0.1 * q)
        mass = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=0, passive_force=force, gap=q + 1e4, clock=clock
        )
        turned = zo.Auxiliary(states=z, rate=0 * z)
        turn = zo.Switch(name="turn", guard=clock.cosine, others_after=-z)
        return zo.hybrid_system(mass, turned, p["restitution"], switches=(turn,))

    problem = zo.Problem(
        name="turned",
        title="turned",
        source="closed form",
        state_names=("q", "v", "z", "cosine", "sine"),
        state_units=("m", "m/s", "1", "1", "1"),
        parameters=(zo.Quantity.restitution(0.5),),
        gains=(),
        model=model,
        starts=({"z": 1.0, "cosine": 1.0},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )
    y, time = np.array([0.0, 0.0, 1.0]), 0.0
    for end, is_limited in ((1.0, True), (5.0, False), (6.0, True)):
        rates = np.array([[0, 1, 0], [0, 0, 1.0], [0, 0, 0]])
        if not is_limited:
            rates[1] = [0.1, 0, -2]
        y, time = expm(rates * (end - time)) @ y, end
    assert zo.simulate(problem, until=6.0).end_state[:2] == pytest.approx(y[:2], rel=1e-10)


def test_an_impact_takes_all_sides_anew() -> None:
    """The force on a ball is limited while it rises, and depends on its height while it falls."""

    def model(p: Any) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        force = ca.fmin(5, ca.if_else(v > 0, 8, 1) + q)
        ball = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=10 * q, passive_force=force, gap=q
        )
        return zo.hybrid_system(ball, zo.no_drive(ball), p["restitution"])

    problem = zo.Problem(
        name="ball",
        title="ball",
        source="closed form",
        state_names=("q", "v"),
        state_units=("m", "m/s"),
        parameters=(zo.Quantity.restitution(0.8),),
        gains=(),
        model=model,
        starts=({"q": 1.0},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )
    # Falling: q'' = q - 9 from rest at h, so q = 9 - (9 - h) cosh t. Rising: q'' = -5.
    time, height, want = 0.0, 1.0, list[float]()
    for _ in range(4):
        fall = math.acosh(9 / (9 - height))
        time += fall
        want.append(time)
        speed = 0.8 * (9 - height) * math.sinh(fall)
        time += speed / 5
        height = speed**2 / 10
    impacts = zo.simulate(problem, until=want[-1] + 1e-3).impacts
    assert [one.time for one in impacts] == pytest.approx(want, rel=1e-11)


OTHER_ANGLES = ((-0.5, 0.1), (-0.3, -0.2), (-0.4, 0.0), (-0.2, 0.15))


def _two_masses(condition: Callable[[Any], Any]) -> zo.Problem:
    """Return two free masses, which pass their kinks at the same time."""

    def model(p: Any) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        first = ca.if_else(q[0] > 1, 1, 0) + ca.if_else(condition(q) > 0, 1, 0)
        mass = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=0,
            passive_force=ca.vertcat(first, 0),
            gap=q[0] + 9,
        )
        return zo.hybrid_system(mass, zo.no_drive(mass), p["restitution"])

    return zo.Problem(
        name="two",
        title="two masses",
        source="closed form",
        state_names=("a", "b", "da", "db"),
        state_units=("m", "m", "m/s", "m/s"),
        parameters=(zo.Quantity.restitution(0.5),),
        gains=(),
        model=model,
        starts=({"a": 0.0, "b": -1.0, "da": 1.0, "db": 2.0},),
        portraits=(("a", "da"),),
        amplitude_of="a",
    )


@pytest.mark.parametrize(
    "condition",
    [lambda q: 3 * q[0] - 3, lambda q: q[0] ** 3 - 1, lambda q: ca.exp(q[0]) - math.e],
)
def test_kinks_on_one_surface_are_one_event(condition: Callable[[Any], Any]) -> None:
    end = zo.simulate(_two_masses(condition), until=2.0)
    assert end.end_state == pytest.approx([1 + 1 + 1, 3.0, 3.0, 2.0], rel=1e-10)
    assert len(end.switches) == 1


@pytest.mark.parametrize(
    "condition",
    [lambda q: q[1] - 1, lambda q: q[0] + q[1] - 2, lambda q: 3 * q[0] - q[1] - 2],
)
def test_kinks_on_two_surfaces_at_one_time_are_refused(condition: Callable[[Any], Any]) -> None:
    with pytest.raises(zo.SimultaneousEventsError, match="switch kink 1 and switch kink 2"):
        zo.simulate(_two_masses(condition), until=2.0)


def _wrapped(kw: float, *, shift: float = 0.1) -> zo.Problem:
    def model(p: Any) -> zo.CompletedSystem:
        q, v, clock = ca.SX.sym("q"), ca.SX.sym("v"), zo.Clock.at(ca.SX(2.0))
        error = ca.atan2(ca.sin(q + math.pi - shift), ca.cos(q + math.pi - shift))
        mass = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=q**2 / 2,
            passive_force=-0.3 * v - p["kw"] * error,
            applied_force=3 * clock.cosine,
            clock=clock,
            stops=(
                zo.Stop(name="up", gap=1 - q, restitution=0.3),
                zo.Stop(name="low", gap=1.2 + q, restitution=0.7),
            ),
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    return zo.Problem(
        name="wrapped",
        title="wrapped angle",
        source="saltation matrices",
        state_names=("q", "v", "cosine", "sine"),
        state_units=("rad", "rad/s", "1", "1"),
        parameters=(zo.Quantity(name="kw", unit="N m/rad", meaning="gain", default=kw),),
        gains=(),
        model=model,
        starts=({"q": 0.3, "v": 0.2, "cosine": 1.0},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )


def _period_map(kw: float, y: Vector, shift: float) -> Vector:
    """Return the state of the wrapped machine after one period of its force, with its own events.

    The wrapped angle is ``q - shift + pi`` below `shift` and ``q - shift - pi`` above it.
    """
    time = 0.0
    above = bool(y[0] > shift)

    def rate(t: float, x: Any) -> list[float]:
        error = x[0] - shift + (-math.pi if above else math.pi)
        return [x[1], -0.3 * x[1] - kw * error - x[0] + 3 * math.cos(2 * t)]

    while time < math.pi:

        def cut(_: float, x: Any, sign: int = 1 if above else -1) -> float:
            return (x[0] - shift) * sign

        def up(_: float, x: Any) -> float:
            return 1.0 - x[0]

        def low(_: float, x: Any) -> float:
            return 1.2 + x[0]

        events: list[Any] = [cut, up, low]
        for one in events:
            one.terminal, one.direction = True, -1
        found: Any = solve_ivp(
            rate, (time, math.pi), y, "DOP853", events=events, rtol=1e-12, atol=1e-13
        )
        time, y = float(found.t[-1]), found.y[:, -1].copy()
        if found.status == 1:
            event = next(k for k in range(3) if found.t_events[k].size)
            if event == 0:
                above = not above
                y[0] = shift + (1e-14 if above else -1e-14)
            else:
                y[1] *= -(0.3, 0.7)[event - 1]
                y[0] = (1.0 - 1e-15, -1.2 + 1e-15)[event - 1]
    return y


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kw", "shift"), fast(2, [(-0.3, 0.1), (-0.4, 0.0), (-0.3, -0.2), (-0.2, 0.15)])
)
def test_multipliers_contain_the_jump_at_the_branch_cut_of_an_angle(
    kw: float, shift: float
) -> None:
    orbit = zo.find_orbit(_wrapped(kw, shift=shift)).unwrap()
    y = np.array([0.3, 0.2])
    for _ in range(14):
        y = _period_map(kw, y, shift)
    assert np.allclose(_period_map(kw, y, shift), y, atol=1e-9)
    step = 1e-6
    columns = [
        (_period_map(kw, y + step * e, shift) - _period_map(kw, y - step * e, shift)) / (2 * step)
        for e in np.eye(2)
    ]
    want = max(abs(np.linalg.eigvals(np.array(columns).T)))
    assert max(map(abs, orbit.floquet_multipliers)) == pytest.approx(want, abs=1e-6)
    assert any(name.startswith("switch kink") for name in orbit.sequence)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_random_machine_moves_as_its_formulas_say(seed: int) -> None:
    _require_equal(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 40))
def test_more_random_machines_move_as_their_formulas_say(seed: int) -> None:
    _require_equal(seed)


def _require_equal(seed: int) -> None:
    machine = RandomMachine(seed=seed)
    want = machine.motion(2.0)
    if want is not None:
        got = zo.simulate(machine.problem(with_switches=seed % 2 == 0), until=2.0).end_state
        assert got == pytest.approx(want, abs=1e-6)
