"""The energy balance in the certificate of event orbits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import casadi as ca
import mpmath
import numpy as np
import pytest
from scipy.integrate import quad

import zeno_orbits as zo
from tests.support.cases import fast
from zeno_orbits.orbits import OrbitEvent


def _bell(share: float) -> zo.Problem:
    """Return a mass between two stops, with a Maxwell element whose stated loss is a share of it.

    The element is a spring and a damper in series: ``s' = v - s / tau``, with the force ``-k s``,
    the stored energy ``k s^2 / 2`` and the loss ``k s^2 / tau``.
    """

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        place, speed, stretch = (ca.SX.sym(name) for name in ("place", "speed", "stretch"))
        clock = zo.Clock.at(p["omega"])
        mass = zo.HybridLagrangian.from_energies(
            q=place,
            v=speed,
            kinetic=speed**2 / 2,
            potential=place**2 / 2,
            applied_force=5 * clock.cosine,
            clock=clock,
            stops=(
                zo.Stop(name="upper", gap=1 - place, restitution=0.3),
                zo.Stop(name="lower", gap=1 + place, restitution=0.2),
            ),
        )
        element = zo.Auxiliary(
            states=stretch,
            rate=speed - stretch,
            force=-p["k"] * stretch,
            loss=share * p["k"] * stretch**2,
            stored_energy=p["k"] * stretch**2 / 2,
        )
        return zo.hybrid_system(mass, element)

    return zo.Problem(
        name="bell",
        title="mass between two stops with a Maxwell element",
        source="tests",
        state_names=("place", "speed", "stretch", "cosine", "sine"),
        state_units=("m", "m/s", "m", "1", "1"),
        parameters=(
            zo.Quantity.positive("omega", 0.3, "rad/s", "frequency of the force"),
            zo.Quantity.positive("k", 0.5, "N/m", "stiffness of the element"),
        ),
        gains=(),
        model=model,
        starts=({"cosine": 1.0},),
        portraits=(("place", "speed"),),
        amplitude_of="place",
    )


@cache
def _orbit() -> zo.Orbit:
    return zo.find_orbit(_bell(1.0)).unwrap()


@pytest.mark.slow
def test_the_input_work_of_an_event_orbit_is_what_losses_and_impacts_take() -> None:
    certificate = zo.verify(_orbit(), problem=_bell(1.0))
    # The tolerances of the integration are near 1e-12.
    for name in ("energy_balance", "restitution", "impulses"):
        assert certificate.residuals[name] < 1e-10
    energies = certificate.energies
    assert energies["input_work"] > 1.0
    assert energies["other_loss"] > 0.1
    # Newton's law at the impacts of the file, beyond which the tails lose next to nothing.
    lost = 0.0
    for event in _orbit().events:
        kind, _, stop = event.name.partition(" ")
        if kind == "impact":
            e = {"upper": 0.3, "lower": 0.2}[stop]
            lost += (1 - e**2) / 2 * event.state["speed"] ** 2
    assert energies["impact_loss"] == pytest.approx(lost, rel=1e-5)


def test_a_false_loss_is_refused() -> None:
    certificate = zo.verify(_orbit(), problem=_bell(0.99))
    assert not certificate.passed
    wrong = certificate.residuals["energy_balance"]
    missing = certificate.energies["other_loss"] / 99
    # One percent of the true loss, relative to the work that the force does and takes back.
    assert missing / 100 < wrong * certificate.energies["input_work"] < missing
    others = {name: x for name, x in certificate.residuals.items() if name != "energy_balance"}
    assert max(others.values()) < certificate.tolerance


# Energy of further states, which contact changes.


def _echo(share: float) -> zo.Problem:
    """Return a ball on a table, and a state that follows its speed and decays, with an energy.

    In flight ``z' = a - c z`` with the acceleration ``a`` of the ball, and an impact changes `z` as
    the speed. In contact the force of the stop changes it, too: ``z' = -c z``.
    """
    bundled, k, c = zo.load_problem("vibrating_table"), 0.02, 3.0

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        height, speed, z = (ca.SX.sym(name) for name in ("height", "speed", "z"))
        clock = zo.Clock.at(p["omega"])
        push = p["A"] * p["omega"] ** 2 * clock.sine
        ball = zo.HybridLagrangian.from_energies(
            q=height,
            v=speed,
            kinetic=p["m"] * speed**2 / 2,
            potential=p["m"] * p["g"] * height,
            gap=height,
            applied_force=p["m"] * push,
            clock=clock,
        )
        echo = zo.Auxiliary(
            states=z,
            rate=push - p["g"] - c * z,
            after_impact=z - (1 + p["restitution"]) * speed,
            force=0 * speed,
            input_power=k * z * (push - p["g"]),
            loss=share * k * c * z**2,
            stored_energy=k * z**2 / 2,
        )
        return zo.hybrid_system(ball, echo, p["restitution"])

    return replace(
        bundled,
        name="echo",
        model=model,
        state_names=("height", "speed", "z", "cosine", "sine"),
        state_units=("m", "m/s", "m/s", "1", "1"),
        outputs=(),
        drawing=None,
    )


@pytest.mark.slow
def test_contact_adds_to_the_energy_of_the_states_that_it_changes() -> None:
    found = zo.find_orbit(_echo(1.0)).unwrap()
    certificate = zo.verify(found, problem=_echo(1.0))
    assert certificate.passed, certificate.verdict()
    # The error of the tail's work falls with the cube of its first speed.
    assert certificate.residuals["energy_balance"] < 1e-10
    lost, m, k, e = 0.0, 0.05, 0.02, 0.3
    for event in found.events:
        if event.word == "impact":
            speed, z = event.state["speed"], event.state["z"]
            lost += (1 - e**2) / 2 * m * speed**2 - k / 2 * ((z - (1 + e) * speed) ** 2 - z**2)
    # The impacts after the last one lose next to nothing.
    assert certificate.energies["impact_loss"] == pytest.approx(lost, rel=1e-5)
    false = zo.verify(found, problem=_echo(1 - 1e-5))
    assert false.failed == ("energy_balance",)


# Impacts that open other stops.

IMPULSES = [
    # Coupling, restitution of the floor, restitution of the wall, pressure on the wall, section.
    (0.3, 0.5, 0.2, 60.0, "impact floor"),
    (0.1, 0.5, 0.0, 60.0, "impact floor"),
    (0.5, 0.7, 0.1, 120.0, "impact floor"),
    (0.4, 0.2, 0.4, 90.0, "impact floor"),
    (0.2, 0.6, 0.0, 30.0, "impact floor"),
    (0.3, 0.5, 0.2, 60.0, "zeno wall"),
]


def _pressed(coupling: float, floor: float, wall: float, pressure: float) -> zo.Problem:
    """Return a hopper that is pressed on a wall, which its impacts on the floor open."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        pushes = ca.logic_and(v[1] > 0, q[1] < 0.1)
        mass = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2 - coupling * v[0] * v[1],
            potential=pressure * q[0] + 9.81 * q[1],
            applied_force=ca.vertcat(0, ca.if_else(pushes, p["a"], 0)),
            stops=(
                zo.Stop(name="wall", gap=q[0], restitution=wall),
                zo.Stop(name="floor", gap=q[1], restitution=floor),
            ),
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    return zo.Problem(
        name="pressed_on_a_wall",
        title="hopper that is pressed on a wall",
        source="tests",
        state_names=("x", "height", "dx", "speed"),
        state_units=("m", "m", "m/s", "m/s"),
        parameters=(zo.Quantity.positive("a", 20.0, "m/s^2", "acceleration of the push"),),
        gains=(),
        model=model,
        starts=({"speed": 2.0},),
        portraits=(("height", "speed"),),
        amplitude_of="height",
    )


@pytest.mark.parametrize(("coupling", "floor", "wall", "pressure", "section"), fast(2, IMPULSES))
def test_an_impact_that_opens_another_stop_at_the_end_of_a_period_loses_its_energy(
    coupling: float, floor: float, wall: float, pressure: float, section: str
) -> None:
    problem = _pressed(coupling, floor, wall, pressure)
    orbit = zo.find_orbit(problem, section=section).unwrap()
    certificate = zo.verify(orbit, problem=problem)
    assert certificate.passed, certificate.verdict()
    mass = np.array([[1.0, -coupling], [-coupling, 1.0]])
    inverse = np.linalg.inv(mass)
    lost = 0.0
    for event in orbit.events:
        kind, _, stop = event.name.partition(" ")
        if kind != "impact":
            continue
        v = np.array([event.state["dx"], event.state["speed"]])
        struck, other, e = (0, 1, wall) if stop == "wall" else (1, 0, floor)
        # The wall holds if its impulse pushes. The floor is open while the wall is struck.
        target = np.array([[1.0 + e]]) * v[struck]
        held = other == 0 and abs(event.state["x"]) < 1e-12 and abs(v[0]) < 1e-9
        rows = [struck, other] if held else [struck]
        wanted = np.array([-target[0, 0], 0.0][: len(rows)])
        impulses = np.linalg.solve(inverse[np.ix_(rows, rows)], wanted)
        if held and impulses[1] < 0:
            rows, impulses = [struck], np.array([wanted[0] / inverse[struck, struck]])
        after = v + inverse[:, rows] @ impulses
        lost += (v @ mass @ v - after @ mass @ after) / 2
    assert certificate.energies["impact_loss"] == pytest.approx(lost, rel=1e-6)


# Machines that lose nothing.

STAIRS = [(0.5, 2.0, 0.3), (0.9, 9.81, 0.1), (0.2, 1.0, 5.0), (0.7, 300.0, 2.0), (0.5, 9.81, 1e-3)]
"""Part of the speed that is kept, acceleration and length of a step."""


def _stairs(
    kept: float, g: float, step: float, power: float = 0.0, rise: float = 0.0
) -> zo.Problem:
    """Return a block on stairs. Its energy is counted from its step, so no energy is lost.

    A third state decays. The false models take a power, or store an energy, without a force.
    """

    def model(_: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v, z = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("z")
        mass = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=-g * q, gap=q + 100
        )
        edge = zo.Switch(name="edge", guard=step - q, armed=v, q_after=q - step, v_after=kept * v)
        part = zo.Auxiliary(
            states=z,
            rate=-z,
            force=0 * v,
            input_power=power * g * v,
            loss=0 * v,
            stored_energy=rise * g * q,
        )
        return zo.hybrid_system(mass, part, 0.0, switches=(edge,))

    return zo.Problem(
        name="stairs",
        title="block on stairs",
        source="tests",
        state_names=("q", "v", "z"),
        state_units=("m", "m/s", "1"),
        parameters=(),
        gains=(),
        model=model,
        starts=({"v": 1.0},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )


def _descent(kept: float, g: float, step: float) -> zo.Orbit:
    """Return the orbit in closed form: ``v-^2 (1 - kept^2) = 2 g step``."""
    last = math.sqrt(2 * g * step / (1 - kept**2))
    time = (1 - kept) * last / g
    edge = OrbitEvent(name="switch edge", time=time, state={"q": step, "v": last, "z": 0.0})
    return zo.Orbit(
        problem="stairs",
        parameters={},
        gains={},
        period=time,
        start_state={"q": 0.0, "v": kept * last, "z": 0.0},
        events=(edge,),
    )


@pytest.mark.parametrize(("kept", "g", "step"), STAIRS)
def test_the_closed_form_of_a_machine_that_loses_nothing_is_verified(
    kept: float, g: float, step: float
) -> None:
    certificate = zo.verify(_descent(kept, g, step), problem=_stairs(kept, g, step))
    assert certificate.passed, certificate.verdict()
    assert certificate.residuals["energy_balance"] < 1e-12
    # v+' = kept sqrt(v+^2 + 2 g step), so dv+'/dv+ = kept v+ / v- = kept^2.
    decay = math.exp(-certificate.period)
    expected = sorted((kept**2, decay), reverse=True)
    assert certificate.multipliers == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize(("kept", "g", "step"), STAIRS)
def test_a_false_power_and_a_false_energy_of_a_machine_that_loses_nothing_are_refused(
    kept: float, g: float, step: float
) -> None:
    for false in ({"power": 1e-6}, {"rise": 1e-6}):
        certificate = zo.verify(_descent(kept, g, step), problem=_stairs(kept, g, step, **false))
        assert certificate.failed == ("energy_balance",)
        # The false work is 1e-6 g step, and the largest kinetic energy g step / (1 - kept^2).
        expected = 1e-6 * (1 - kept**2)
        assert certificate.residuals["energy_balance"] == pytest.approx(expected, rel=1e-5)


def _wheel(spokes: float, slope: float) -> zo.Problem:
    """Return a rimless wheel of unit mass and spokes of 1 m, whose angles jump by two spokes."""

    def model(_: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        half = math.pi / spokes
        hub = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=9.81 * ca.cos(q), gap=q + 100
        )
        strike = zo.Switch(
            name="strike",
            guard=slope + half - q,
            armed=v,
            q_after=q - 2 * half,
            v_after=v * math.cos(2 * half),
        )
        return zo.hybrid_system(hub, zo.no_drive(hub), 0.0, switches=(strike,))

    stairs = _stairs(0.5, 1.0, 1.0)
    names, units = stairs.state_names[:2], ("rad", "rad/s")
    return replace(stairs, name="wheel", model=model, state_names=names, state_units=units)


@pytest.mark.parametrize(("spokes", "slope"), [(8, 0.08), (12, 0.05), (20, 0.03)])
def test_the_closed_form_of_a_rimless_wheel_is_verified(spokes: int, slope: float) -> None:
    half, g = math.pi / spokes, 9.81
    kept = math.cos(2 * half)
    fall = 2 * g * (math.cos(slope - half) - math.cos(slope + half))
    launch = kept * math.sqrt(fall / (1 - kept**2))
    begin, end = slope - half, slope + half

    def speed(q: float) -> float:
        return math.sqrt(launch**2 + 2 * g * (math.cos(begin) - math.cos(q)))

    period, _ = quad(lambda q: 1 / speed(q), begin, end, epsabs=0.0, epsrel=1e-13)
    strike = OrbitEvent(name="switch strike", time=period, state={"q": end, "v": launch / kept})
    orbit = zo.Orbit(
        problem="wheel",
        parameters={},
        gains={},
        period=period,
        start_state={"q": begin, "v": launch},
        events=(strike,),
    )
    certificate = zo.verify(orbit, problem=_wheel(spokes, slope))
    assert certificate.passed, certificate.verdict()
    assert certificate.multipliers == pytest.approx((kept**2,), abs=1e-8)


@pytest.mark.parametrize("above", [1e-3, 1e-4, 1e-5])
def test_a_ball_that_is_hardly_thrown_is_verified(above: float) -> None:
    m, g, omega = 0.05, 9.81, 30.0
    amplitude = g * (1 + above) / omega**2
    result = zo.find_orbit("vibrating_table", parameters={"restitution": 0.0, "A": amplitude})
    assert result.orbit is not None, result
    certificate = zo.verify(result.orbit)
    assert certificate.passed, certificate.verdict()
    with mpmath.workdps(40):
        factor = 1 + mpmath.mpf(above)
        start = mpmath.asin(1 / factor)

        def gap(angle: mpmath.mpf) -> mpmath.mpf:
            fallen = mpmath.sin(start) - mpmath.sin(start + angle) + angle * mpmath.cos(start)
            return factor * fallen - angle**2 / 2

        wide = 4 * mpmath.sqrt(2 * mpmath.mpf(above))
        angle = mpmath.findroot(gap, (wide / 2, 1.2 * wide), solver="anderson")
        rate = factor * (mpmath.cos(start) - mpmath.cos(start + angle)) - angle
        lost = float(m * (rate * g / omega) ** 2 / 2)
    # The gap acceleration is at most a part `above` of gravity, of which 1e-16 is rounding.
    assert certificate.energies["impact_loss"] == pytest.approx(lost, rel=1e-12 / above)


@pytest.mark.parametrize("above", fast(1, [1e-5, 3e-6]))
@pytest.mark.parametrize("restitution", [pytest.param(0.0, marks=pytest.mark.slow), 0.3, 0.5])
def test_events_of_a_ball_that_is_hardly_thrown_are_integrated_finer(
    above: float, restitution: float
) -> None:
    # The error of a lower tolerance is above 1e-9, so the orbit would be refused.
    parameters = {"restitution": restitution, "A": 9.81 * (1 + above) / 900}
    orbit = zo.find_orbit("vibrating_table", parameters=parameters, section="zeno stop").unwrap()
    assert orbit.certificate["passed"]
    # It is thrown where the table falls with the acceleration of gravity, once per turn.
    thrown = next(event for event in orbit.events if event.name == "release stop")
    # The clock leaves its circle by some 1e-15, which counts over the distance from the top.
    top = math.sqrt(2 * above)
    assert thrown.state["cosine"] == pytest.approx(
        math.sqrt(1 - (1 + above) ** -2), abs=3e-15 / top
    )
    assert orbit.period == pytest.approx(2 * math.pi / 30, rel=1e-9)
    for part in (3e-9, 1e-7):
        assert not zo.verify(replace(orbit, period=orbit.period * (1 + part))).passed
