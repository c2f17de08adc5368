"""Runs of a virtual rig with several stops, switches and kinks, compared with SciPy.

The equations of the references are written by hand, and their events are located by SciPy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import zeno_orbits as zo
from tests.support.cases import fast
from zeno_orbits.api import rig_warnings
from zeno_orbits.arrays import Vector
from zeno_orbits.experiment import RigSettings
from zeno_orbits.integrators import Tolerance

FINE = RigSettings(tolerance=Tolerance(relative=1e-12, absolute=1e-14))
Rates = Callable[[Vector], Vector]
Guard = Callable[[Vector], float]


def _number(restitution: float) -> float:
    """Return the damping number `u` with ``u - ln(1 + u) = -e u - ln(1 - e u)``, theory (6.2)."""
    e = restitution

    def missing(u: float) -> float:
        return u - math.log1p(u) + e * u + math.log1p(-e * u)

    return float(brentq(missing, 1e-3, (1 - 1e-12) / e, xtol=1e-15))


def _until(rates: Rates, guard: Guard, time: float, x: Vector) -> tuple[float, Vector]:
    """Return time and state where a guard falls through zero."""

    def event(_t: float, y: Vector) -> float:
        return guard(y)

    event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
    arc: Any = solve_ivp(
        lambda _t, y: rates(y),
        (time, time + 100.0),
        x,
        method="DOP853",
        events=event,
        rtol=3e-14,
        atol=1e-15,
        first_step=1e-6,
    )
    return float(arc.t_events[0][0]), arc.y_events[0][0]


@pytest.mark.slow
def test_a_mass_between_two_compliant_stops_moves_as_scipy_moves_it() -> None:
    """``x'' = -x - 0.1 x' + 2 cos(1.3 t)`` and two stops at ``|x| = 1``, damped for 0.3."""
    stiffness, number = 1e5, _number(0.3)
    wanted: list[tuple[str, float, float]] = []
    time, x = 0.0, np.array([0.0, 0.0, 1.0, 0.0])
    for _ in range(8):
        # The stop ahead is the one towards which the mass is pushed.

        def free(y: Vector) -> Vector:
            return np.array([y[1], -y[0] - 0.1 * y[1] + 2 * y[2], -1.3 * y[3], 1.3 * y[2]])

        time, x = _until(free, lambda y: 1 - abs(y[0]), time, x)
        side = math.copysign(1.0, x[0])
        alpha, begin = number / abs(x[1]), time

        def pressed(y: Vector, side: float = side, alpha: float = alpha) -> Vector:
            depth, closing = side * y[0] - 1, side * y[1]
            force = stiffness * depth * max(0.0, 1 + alpha * closing)
            return free(y) - np.array([0.0, side * force, 0.0, 0.0])

        time, x = _until(pressed, lambda y, side=side: side * y[0] - 1, time, x)  # type: ignore[misc]
        wanted.append(("upper" if side > 0 else "lower", begin, time))
    rig = zo.Rig(contact=zo.Contact(stiffness=stiffness))
    run = zo.simulate_rig(
        "clapper",
        rig,
        until=wanted[-1][2] + 1e-3,
        parameters={"A": 2.0, "omega": 1.3},
        settings=FINE,
    )
    assert {stop for stop, _, _ in wanted} == {"upper", "lower"}
    assert [touch.stop for touch in run.touches[:8]] == [stop for stop, _, _ in wanted]
    found = [(touch.start, touch.end) for touch in run.touches[:8]]
    # SciPy's events are located on dense output of order 7.
    assert np.ravel(found) == pytest.approx(
        np.ravel([(begin, end) for _, begin, end in wanted]), abs=1e-9
    )


def test_a_push_of_a_compliant_hopper_begins_and_ends_at_its_kinks() -> None:
    """In contact, the push ``a`` begins where the mass begins to rise, and it ends at ``s``."""
    a, s, g, e, stiffness = 20.0, 0.1, 9.81, 0.5, 1e4
    number = _number(e)
    time = 0.0
    x: Vector = np.array([0.05, -1.0])
    contacts: list[float] = []

    def falls(y: Vector) -> Vector:
        return np.array([y[1], -g])

    def pressed(y: Vector, alpha: float, push: float) -> Vector:
        force = stiffness * -y[0] * max(0.0, 1 - alpha * y[1])
        return np.array([y[1], force - g + push])

    for _ in range(2):
        time, x = _until(falls, lambda y: y[0], time, x)
        contacts.append(time)
        alpha = number / -float(x[1])
        sinks, rises = (partial(pressed, alpha=alpha, push=push) for push in (0.0, a))
        time, x = _until(sinks, lambda y: -y[1], time, x)
        time, x = _until(rises, lambda y: -y[0], time, x)
        contacts.append(time)
        time, x = _until(lambda y: np.array([y[1], a - g]), lambda y: s - y[0], time, x)
    rig = zo.Rig(contact=zo.Contact(stiffness=stiffness))
    start = {"height": 0.05, "speed": -1.0}
    run = zo.simulate_rig("hopper", rig, until=time, start=start, settings=FINE)
    found = [moment for touch in run.touches for moment in (touch.start, touch.end)]
    assert found == pytest.approx(contacts, abs=1e-9)
    assert run.states[-1] == pytest.approx(x, abs=1e-9)


def _end_deviation(name: str, until: float, stiffness: float, **options: Any) -> float:
    hard = zo.simulate(name, until=until, **options)
    rig = zo.Rig(contact=zo.Contact(stiffness=stiffness))
    run = zo.simulate_rig(name, rig, until=until, **options)
    return float(np.max(np.abs(run.states[-1] - hard.end_state)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "until", "stiffness", "order"),
    fast(
        1,
        [
            # The clock decides the release: its delay is the dent, with the order 1.
            ("clapper", 30.0, 1e5, 1.0),
            # A dent delays every event: with the order 1/2, the duration of a contact.
            ("hopper", 1.5, 1e7, 0.5),
            ("limited_pendulum", 2.0, 1e5, 0.5),
            # The samples of a clock are switches with a reset.
            ("sampled_pendulum", 2.0, 1e5, 0.5),
            # Heel strike exchanges the legs, and the knee is straight: a closed stop.
            ("kneed_walker", 1.2, 1e5, 0.5),
        ],
    ),
)
def test_compliant_stops_converge_to_the_execution_with_hard_stops(
    name: str, until: float, stiffness: float, order: float
) -> None:
    soft, stiff = (_end_deviation(name, until, k) for k in (stiffness, 100 * stiffness))
    assert soft < 0.05
    # The next order is 10 to 20 % of the deviation at the softer stop.
    assert soft / stiff == pytest.approx(100**order, rel=0.2)


@pytest.mark.slow
def test_the_contacts_of_a_stiff_relay_begin_at_the_published_impacts() -> None:
    """MACHINES: first impacts 2.09300141683 ms and 27.3932730156 ms after the voltage is on."""
    period = 0.04
    rig = zo.Rig(contact=zo.Contact(stiffness=1e11, slowest=1e-6))
    run = zo.simulate_rig("relay", rig, until=2 * period)
    closed = next(touch for touch in run.touches if touch.stop == "closed" and touch.start > period)
    opened = next(
        touch for touch in run.touches if touch.stop == "open" and touch.start > 1.6 * period
    )
    assert 1e3 * (closed.start - period) == pytest.approx(2.09300141683, abs=1e-6)
    assert closed.approach_rate == pytest.approx(-1.79987359610, abs=1e-6)
    # The armature leaves a dent of 4e-12 m later than a hard stop.
    assert 1e3 * (opened.start - period) == pytest.approx(27.3932730156, abs=1e-5)
    assert opened.approach_rate == pytest.approx(-0.81032276748, abs=1e-6)


def test_every_stop_has_its_own_restitution() -> None:
    """A free mass between ends: each contact returns the speed by the restitution of its stop."""

    def model(p: Any) -> zo.CompletedSystem:
        place, speed = ca.SX.sym("place"), ca.SX.sym("speed")
        stops = (
            zo.Stop(name="left", gap=1 + place, restitution=0.8),
            zo.Stop(name="right", gap=1 - place, restitution=p["e"]),
        )
        mass = zo.HybridLagrangian.from_energies(
            q=place, v=speed, kinetic=speed**2 / 2, potential=ca.SX(0), stops=stops
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    problem = zo.Problem(
        name="free",
        title="free mass between two ends",
        source="here",
        state_names=("place", "speed"),
        state_units=("m", "m/s"),
        parameters=(zo.Quantity(name="e", unit="1", meaning="restitution", default=0.4),),
        gains=(),
        model=model,
        starts=({"speed": 1.0},),
        portraits=(("place", "speed"),),
        amplitude_of="place",
    )
    rig = zo.Rig(contact=zo.Contact(stiffness=1e4))
    run = zo.simulate_rig(problem, rig, until=20.0)
    ratios = {touch.stop: -touch.depart_rate / touch.approach_rate for touch in run.touches[:-1]}
    assert ratios == {"right": pytest.approx(0.4, abs=1e-9), "left": pytest.approx(0.8, abs=1e-9)}
    with pytest.raises(zo.InputError, match="stop `right` must be greater than 0"):
        zo.simulate_rig(problem, rig, until=1.0, parameters={"e": 0.0})


def test_a_motion_that_slides_along_a_kink_is_refused_by_its_name() -> None:
    def model(p: Any) -> zo.CompletedSystem:
        place, speed = ca.SX.sym("place"), ca.SX.sym("speed")
        mass = zo.HybridLagrangian.from_energies(
            q=place,
            v=speed,
            kinetic=speed**2 / 2,
            potential=place**2 / 2,
            passive_force=-p["f"] * ca.sign(speed),
            stops=(zo.Stop(name="wall", gap=3 - place, restitution=0.5),),
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    problem = zo.Problem(
        name="dry",
        title="mass with dry friction",
        source="here",
        state_names=("place", "speed"),
        state_units=("m", "m/s"),
        parameters=(zo.Quantity(name="f", unit="N", meaning="friction", default=0.5),),
        gains=(),
        model=model,
        starts=({"place": 0.7},),
        portraits=(("place", "speed"),),
        amplitude_of="place",
    )
    rig = zo.Rig(contact=zo.Contact(stiffness=1e4))
    with pytest.raises(zo.SlidingError, match="`kink 1`"):
        zo.simulate_rig(problem, rig, until=10.0)


@pytest.mark.parametrize("factor", [1, 3])
@pytest.mark.parametrize("further", [False, True])
def test_a_bumper_acts_while_its_stop_is_compressed(factor: int, further: bool) -> None:
    """A contact lasts half a period of the springs of the stop and the bumper together."""

    def model(p: Any) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        bumper = p["k"] * ca.fmax(-factor * q, 0) / factor
        kink = ca.fmax(q - 0.7, 0) if further else 0
        mass = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=0, passive_force=bumper + kink - 1, gap=q
        )
        return zo.hybrid_system(mass, zo.no_drive(mass), p["restitution"])

    problem = zo.Problem(
        name="bumper",
        title="mass on a bumper",
        source="here",
        state_names=("q", "v"),
        state_units=("m", "m/s"),
        parameters=(
            zo.Quantity.positive("k", 3e6, "N/m", "bumper"),
            zo.Quantity.restitution(0.99999),
        ),
        gains=(),
        model=model,
        starts=({"q": 0.5},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )
    assert problem.checked().has_graph == further
    rig = zo.Rig(contact=zo.Contact(stiffness=1e6))
    touch = zo.simulate_rig(problem, rig, until=1.5).touches[0]
    assert touch.end - touch.start == pytest.approx(math.pi / 2e3, rel=1e-3)


@pytest.mark.parametrize(("spacing", "is_warned"), [(2e-3, False), (8e-3, True)])
def test_contacts_that_samples_may_miss_are_warned_of(spacing: float, is_warned: bool) -> None:
    """A mass of 1 kg vibrates on its stop with half a period of ``pi / sqrt(k)``, 9.9 ms."""
    run = zo.simulate_rig(
        "clapper",
        zo.Rig(contact=zo.Contact(stiffness=1e5)),
        until=8.0,
        parameters={"A": 2.0, "omega": 1.3},
        settings=RigSettings(spacing=spacing),
    )
    lasts = min(touch.end - touch.start for touch in run.touches if math.isfinite(touch.end))
    assert lasts == pytest.approx(math.pi / math.sqrt(1e5), rel=0.2)
    told = rig_warnings(run, zo.load_problem("clapper"))
    found = [one for one in told if "may miss contacts" in one]
    assert bool(found) is is_warned
    for one in found:
        assert f"lasts {lasts:.2g} s" in one
        assert f"{2 / lasts:.2g} samples a second" in one
