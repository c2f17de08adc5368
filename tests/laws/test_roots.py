"""Powers and roots whose base is zero at an event: Hertz contact, orifices, and what is refused.

The time in a contact with the force :math:`k u^n` of depth `u` follows from the energy: with the
speed `v` the depth is :math:`u_m = ((n + 1) v^2 / (2 k))^{1/(n + 1)}` and the time

.. math:: T = \\frac{2 u_m}{v} \\int_0^1 \\frac{dz}{\\sqrt{1 - z^{n + 1}}}
    = \\frac{2 u_m}{v} \\frac{\\sqrt{\\pi}\\, \\Gamma(1 + 1/(n + 1))}{\\Gamma(1/2 + 1/(n + 1))}
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.one_mass import Motion, one_mass
from zeno_orbits.arrays import Vector
from zeno_orbits.maps import AttractorClass, attractors_at

K, V = 3.0, 0.7
OMEGA, FAR, E = 1.3, 0.5, 0.5

PADS: dict[str, tuple[float, Callable[[ca.SX], ca.SX]]] = {
    "power of a maximum": (1.5, lambda u: ca.fmax(u, 0) ** 1.5),
    "power in a branch": (1.5, lambda u: ca.if_else(u > 0, u**1.5, 0)),
    "power in the other branch": (1.5, lambda u: ca.if_else(u <= 0, 0, u**1.5)),
    "power of a multiple": (1.5, lambda u: ca.if_else(u > 0, (2 * u) ** 1.5, 0) / 2**1.5),
    "product with a root": (1.5, lambda u: ca.fmax(u, 0) * ca.sqrt(ca.fmax(u, 0))),
    "power of a size": (1.5, lambda u: ca.if_else(u > 0, ca.fabs(u) ** 1.5, 0)),
    "power of a square": (1.5, lambda u: (ca.fmax(u, 0) ** 2) ** 0.75),
    "power near one": (1.1, lambda u: ca.fmax(u, 0) ** 1.1),
    "power above two": (2.4, lambda u: ca.fmax(u, 0) ** 2.4),
    "root": (0.5, lambda u: ca.sqrt(ca.fmax(u, 0))),
    "root in a branch": (0.5, lambda u: ca.if_else(u > 0, ca.sqrt(u), 0)),
    "cube root": (1 / 3, lambda u: ca.fmax(u, 0) ** (1 / 3)),
}


def _pad(force: Callable[[ca.SX], ca.SX]) -> zo.Problem:
    """Return a mass that flies to a pad at `x = 0` and away again to a distant stop."""
    return one_mass(
        lambda m: m.p["k"] * force(-m.x),
        stops=lambda m: (zo.Stop(name="wall", gap=m.x + 100, restitution=0.5),),
        has_clock=False,
        start={"x": 0.3, "v": -V},
        k=K,
    )


@pytest.mark.parametrize("form", fast(6, PADS))
def test_the_time_in_an_elastic_contact_is_the_closed_form(form: str) -> None:
    n, force = PADS[form]
    one = 1.0 / (n + 1.0)
    depth = ((n + 1.0) * V**2 / (2.0 * K)) ** one
    time = 2.0 * depth / V * math.sqrt(math.pi) * math.gamma(1.0 + one) / math.gamma(0.5 + one)
    arrival = 0.3 / V
    motion = zo.simulate(_pad(force), until=arrival + time + 1.0)
    assert len(motion.events) == 2
    # A root has an infinite derivative there, which costs the steps beside it some digits.
    precision = 1e-10 if n > 1.0 else 1e-8
    assert [event.time for event in motion.events] == pytest.approx(
        [arrival, arrival + time], abs=precision
    )
    assert motion.end_state[1] == pytest.approx(V, abs=precision)


FORCES: dict[str, tuple[Callable[[Motion], ca.SX], Callable[[float, float], float]]] = {
    "pad": (
        lambda m: -m.x - 0.2 * m.v - 3 * ca.fmax(m.x, 0) ** 1.5,
        lambda x, v: -x - 0.2 * v - 3 * max(x, 0.0) ** 1.5,
    ),
    "pad on the stop": (
        lambda m: -m.x - 0.2 * m.v - 0.5 * (m.x + FAR) ** 1.5,
        lambda x, v: -x - 0.2 * v - 0.5 * max(x + FAR, 0.0) ** 1.5,
    ),
    "product on the stop": (
        lambda m: -m.x - 0.2 * m.v - 0.5 * (m.x + FAR) * ca.sqrt(m.x + FAR),
        lambda x, v: -x - 0.2 * v - 0.5 * max(x + FAR, 0.0) ** 1.5,
    ),
    "root of a cube on the stop": (
        lambda m: -m.x - 0.2 * m.v - 0.5 * ca.sqrt((m.x + FAR) ** 3),
        lambda x, v: -x - 0.2 * v - 0.5 * max(x + FAR, 0.0) ** 1.5,
    ),
    "product of drag": (
        lambda m: -m.x - 0.2 * m.v * ca.sqrt(ca.fabs(m.v)),
        lambda x, v: -x - 0.2 * math.copysign(abs(v) ** 1.5, v),
    ),
    "drag": (
        lambda m: -m.x - 0.2 * ca.sign(m.v) * ca.fabs(m.v) ** 1.5,
        lambda x, v: -x - 0.2 * math.copysign(abs(v) ** 1.5, v),
    ),
    "orifice": (
        lambda m: -m.x - 0.2 * ca.sign(m.v) * ca.sqrt(ca.fabs(m.v)),
        lambda x, v: -x - 0.2 * math.copysign(abs(v) ** 0.5, v),
    ),
}


def _forced(force: Callable[[Motion], ca.SX]) -> zo.Problem:
    return one_mass(
        lambda m: force(m) + m.cosine,
        stops=lambda m: (zo.Stop(name="wall", gap=m.x + FAR, restitution=E),),
        start={"x": 0.1, "v": 0.0, "cosine": 1.0},
        omega=OMEGA,
    )


def _turned(force: Callable[[float, float], float], y: Vector) -> Vector:
    """Return the state after a turn of the clock, by SciPy and the formula of the force."""
    time, turn = 0.0, 2.0 * math.pi / OMEGA

    def gap(_: float, y: Vector) -> float:
        return float(y[0]) + FAR

    reached: Any = gap
    reached.terminal, reached.direction = True, -1

    def rate(t: float, y: Vector) -> list[float]:
        return [y[1], force(y[0], y[1]) + math.cos(OMEGA * t)]

    while True:
        way = solve_ivp(
            rate, (time, turn), y, events=reached, rtol=1e-12, atol=1e-13, max_step=0.01
        )
        time, y = float(way.t[-1]), way.y[:, -1].copy()
        if way.status != 1:
            return y
        y[0], y[1] = -FAR, -E * y[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", FORCES)
def test_multipliers_of_orbits_over_powers_are_those_of_differences(name: str) -> None:
    force, number = FORCES[name]
    orbit = zo.find_orbit(_forced(force), allow_unstable=True).unwrap()
    certificate = zo.verify(orbit, problem=_forced(force))
    assert certificate.passed
    assert orbit.period == pytest.approx(2.0 * math.pi / OMEGA, abs=1e-10)
    found = zo.floquet_multipliers(orbit, problem=_forced(force))
    if name == "orifice":
        # The derivative of the root is infinite where the velocity is zero: nothing is claimed.
        assert math.isinf(found.error)
        assert "unknown stability" in certificate.verdict()
        return
    y = np.array([0.1, 0.0])
    for _ in range(40):
        y = _turned(number, y)
    step = 1e-5
    slopes = [
        (_turned(number, y + step * one) - _turned(number, y - step * one)) / (2.0 * step)
        for one in np.eye(2)
    ]
    expected: list[complex] = np.linalg.eigvals(np.transpose(slopes)).tolist()
    sizes = sorted(abs(one) for one in found.values)
    # Second derivatives of these forces are infinite, so that differences have fewer digits.
    assert sizes == pytest.approx(sorted(map(abs, expected)), abs=1e-5)


OUTSIDE: dict[str, tuple[Callable[[ca.SX], ca.SX], str]] = {
    "root": (ca.sqrt, r"`sqrt\(x\)` is `sqrt` of -"),
    "power": (lambda x: x**1.5, r"`pow\(x,1.5\)` is `constpow` of -"),
    "logarithm": (ca.log, r"`log\(x\)` is `log` of -"),
    "angle": (lambda x: ca.acos(x + 1), r"`acos\(\(x\+1\)\)` is `acos` of 1"),
    "pole": (lambda x: -0.01 / x, r"`\(-?0.01/x\)` divides -?0.01 by "),
    "double pole": (lambda x: -0.01 / x**2, r"`\(-?0.01/sq\(x\)\)` divides -?0.01 by "),
    "weak pole": (lambda x: -1e-7 / x**2, r"`\(-?1e-07/sq\(x\)\)` divides -?1e-07 by "),
    "tangent": (lambda x: ca.tan(x + ca.pi / 2), r"`tan\(\(x\+1.57.*\)\)` is `tan` of 1.57"),
}


@pytest.mark.parametrize("name", OUTSIDE)
@pytest.mark.parametrize("far", [100.0, 0.0])
def test_a_formula_that_is_left_is_named_with_the_state(name: str, far: float) -> None:
    """The stop is far from the place where the formula ends, or there."""
    formula, words = OUTSIDE[name]
    start = {"x": -0.3 if name == "angle" else 0.3, "v": 0.7 if name == "angle" else -0.7}
    side = -1.0 if name == "angle" else 1.0
    problem = one_mass(
        lambda m: 0.1 * formula(m.x),
        stops=lambda m: (zo.Stop(name="wall", gap=side * m.x + far, restitution=0.5),),
        has_clock=False,
        start=start,
    )
    if far == 0.0 and name in ("root", "power"):
        assert zo.simulate(problem, until=1.0).impacts
        return
    with pytest.raises(
        zo.SimulationError, match=rf"the applied force is not finite ahead \(x = .*\): {words}"
    ):
        zo.simulate(problem, until=1.0)


def _left(formula: Callable[[ca.SX], ca.SX], *, is_named: bool) -> zo.Problem:
    """Return a mass that flies to the end of a formula, with a far stop of either kind."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        x, v = ca.SX.sym("x"), ca.SX.sym("v")
        gap = x + 100
        stops = (zo.Stop(name="wall", gap=gap, restitution=p["restitution"]),) if is_named else ()
        mass = zo.HybridLagrangian.from_energies(
            q=x,
            v=v,
            kinetic=v**2 / 2,
            potential=ca.SX(0.0),
            passive_force=0.1 * formula(x),
            gap=None if is_named else gap,
            stops=stops,
        )
        law = () if is_named else (p["restitution"],)
        return zo.hybrid_system(mass, zo.no_drive(mass), *law)

    return zo.Problem(
        name="left",
        title="One mass",
        source="tests",
        state_names=("x", "v"),
        state_units=("m", "m/s"),
        parameters=(zo.Quantity.restitution(0.5),),
        gains=(),
        model=model,
        starts=({"x": 0.3, "v": -0.7},),
        portraits=(("x", "v"),),
        amplitude_of="x",
    )


@pytest.mark.parametrize("is_named", [False, True])
@pytest.mark.parametrize("name", [name for name in OUTSIDE if name != "angle"])
def test_every_way_to_a_motion_names_the_formula_that_it_leaves(
    name: str, *, is_named: bool
) -> None:
    formula, words = OUTSIDE[name]
    problem = _left(formula, is_named=is_named)
    told = rf"the passive force is not finite ahead \(x = .*\): .*{words}"
    with pytest.raises(zo.SimulationError, match=told):
        zo.simulate(problem, until=1.0)
    (found,) = attractors_at(problem, [problem.values()])
    assert found.fate is AttractorClass.FAILED
    assert re.search(told, found.detail)
    if is_named:
        with pytest.raises(zo.OrbitNotFoundError, match=told):
            zo.find_orbit(problem).unwrap()
    else:
        assert re.search(told, zo.find_orbit(problem).detail)
