"""Margins of orbits of events: distances in the values to the loss of an event or of stability.

The hopper rises above the height of its push if `a > g (1 - e^2)`. The impact pair, a clapper
without spring and damping, has flights in closed form.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq, fsolve

import zeno_orbits as zo
from tests.support.cases import often
from tests.support.commands import NO, YES, ask

G = 9.81


def widest(name: str, free: dict[str, tuple[float, float]], **options: Any) -> zo.SearchResult:
    """Return the orbit of the widest margin, which must be verified."""
    found = zo.search_gains(name, vary=free, objective=zo.MaxMargin(), **options)
    assert found.certificate is not None
    assert found.certificate.passed
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("e", "a"), often(1, [(0.2, (9.0, 12.0)), (0.5, (5.0, 40.0))]))
def test_the_margin_of_a_hopper_has_its_closed_form(e: float, a: tuple[float, float]) -> None:
    found = widest("hopper", {"a": a}, parameters={"restitution": e})
    low, high = a
    assert found.free["a"] == pytest.approx(high, abs=1e-6)
    assert found.value == pytest.approx((high - G * (1 - e**2)) / (high - low), abs=1e-9)
    assert "The nearest loss is at a = " in found.detail


@pytest.mark.slow
def test_a_hopper_near_its_end_has_a_narrow_margin() -> None:
    found = widest("hopper", {"a": (5.0, 7.4)})
    assert found.value == pytest.approx((7.4 - 0.75 * G) / 2.4, abs=1e-9)


@pytest.mark.weekly
@pytest.mark.slow
def test_the_margin_in_two_parameters_is_the_smaller_of_the_closed_forms() -> None:
    found = widest("hopper", {"a": (5.0, 9.0), "restitution": (0.1, 0.6)}, parameters={"a": 9.0})
    in_a = (9.0 - G * (1 - 0.6**2)) / 4.0
    in_e = (0.6 - math.sqrt(1 - 9.0 / G)) / 0.5
    assert found.free == pytest.approx({"a": 9.0, "restitution": 0.6}, abs=1e-6)
    assert found.value == pytest.approx(min(in_a, in_e), abs=1e-6)


@pytest.mark.slow
def test_the_margin_of_a_clapper_is_the_distance_to_the_end_of_its_family() -> None:
    found = widest("clapper", {"A": (0.5, 3.0)})
    assert found.orbit is not None
    (family,) = zo.continue_orbit(found.orbit, ("A", 0.9, 3.5)).families
    assert family.first.kind is zo.SpecialPointKind.LOCK_VANISHES
    assert found.value == pytest.approx((3.0 - family.first.at.value) / 2.5, abs=1e-4)
    assert "the contact phase before `release" in found.detail


@pytest.mark.weekly
@pytest.mark.slow
def test_a_margin_does_not_depend_on_the_unit_of_length() -> None:
    metres = widest("clapper", {"A": (0.5, 3.0)})
    millimetres = widest("clapper", {"A": (5e-4, 3e-3)}, parameters={"d": 1e-3, "A": 3e-3})
    assert millimetres.value == pytest.approx(metres.value, abs=1e-4)
    assert millimetres.free["A"] == pytest.approx(1e-3 * metres.free["A"], rel=1e-6)


@pytest.mark.weekly
@pytest.mark.slow
def test_a_walker_loses_its_gait_where_heel_strike_meets_the_zeno_point() -> None:
    # The published end of gaits with a Zeno knee.
    found = widest("kneed_walker", {"restitution": (0.1, 0.5)}, parameters={"restitution": 0.37})
    assert found.value == pytest.approx((0.38397 - 0.1) / 0.4, abs=2e-5)
    assert "`switch heel strike` meets the event before it" in found.detail


# Loss of stability, against the closed form of the impact pair.

OMEGA, E = 2.0, 0.9


def _place(state: np.ndarray[Any, Any], force: float, time: float) -> float:
    place, speed, angle = state
    drift = speed - force / OMEGA * math.sin(angle)
    turned = math.cos(angle + OMEGA * time) - math.cos(angle)
    return float(place + drift * time - force / OMEGA**2 * turned)


def _after(state: np.ndarray[Any, Any], force: float) -> np.ndarray[Any, Any]:
    """Return the state just after the next impact: place, speed and angle of the clock."""
    times = np.linspace(1e-6, 2 * math.pi, 2000)
    places = np.array([_place(state, force, time) for time in times])
    k = int(np.argmax(np.abs(places) > 1.0))
    side = math.copysign(1.0, places[k])
    before = times[k - 1] if k else 1e-9
    time = float(brentq(lambda t: _place(state, force, t) - side, before, times[k], xtol=1e-15))
    drift = state[1] - force / OMEGA * math.sin(state[2])
    speed = drift + force / OMEGA * math.sin(state[2] + OMEGA * time)
    return np.array([side, -E * speed, state[2] + OMEGA * time])


def _radius(start: np.ndarray[Any, Any], force: float) -> tuple[np.ndarray[Any, Any], float]:
    """Return the orbit of three impacts near a start, and its spectral radius."""

    def returned(z: Any) -> np.ndarray[Any, Any]:
        state = np.array([start[0], z[0], z[1]])
        for _ in range(3):
            state = _after(state, force)
        return np.array([state[1], state[2] - 2 * math.pi])

    z: Any = fsolve(lambda z: returned(z) - z, start[1:], xtol=1e-13)
    step = 1e-6
    columns = [(returned(z + step * d) - returned(z - step * d)) / (2 * step) for d in np.eye(2)]
    radius = max(abs(np.linalg.eigvals(np.array(columns).T)))
    return np.array([start[0], *z]), float(radius)


@pytest.mark.weekly
@pytest.mark.slow
def test_an_impact_pair_loses_its_stability_where_its_closed_form_does() -> None:
    fixed = {"k": 0.0, "c": 0.0, "restitution": E, "omega": OMEGA, "A": 4.0}
    found = widest("clapper", {"A": (3.0, 5.0)}, parameters=fixed)
    assert found.orbit is not None
    assert "The nearest loss is at A = 5.83208: the orbit loses stability." in found.detail
    state = found.orbit.start_state
    start = np.array([state["place"], state["speed"], math.atan2(state["sine"], state["cosine"])])
    start[0] = math.copysign(1.0, start[0])
    force = found.free["A"]
    known = {force: start}

    def excess(value: float) -> float:
        nearest = known[min(known, key=lambda one: abs(one - value))]
        radius = math.nan
        for part in np.linspace(0.0, 1.0, 12)[1:]:
            nearest, radius = _radius(nearest, force + part * (value - force))
        return radius - 1.0

    truth = float(brentq(excess, 5.7, 5.9, xtol=1e-9))
    assert found.value == pytest.approx((truth - force) / 2.0, abs=1e-4)


# Bounds.


@pytest.mark.weekly
@pytest.mark.slow
def test_a_margin_keeps_the_bounds() -> None:
    bound = zo.Bound(name="stop.impact_speed", upper=2.0)
    found = widest("hopper", {"a": (5.0, 20.0)}, bounds=[bound])
    # v^2 = 2 a s / (1 - e^2).
    assert found.free["a"] == pytest.approx(15.0, abs=2e-3)
    assert found.value == pytest.approx((found.free["a"] - 0.75 * G) / 15.0, abs=1e-6)


@pytest.mark.slow
def test_a_bound_on_the_speed_of_the_first_impact_has_its_closed_form() -> None:
    bound = zo.Bound(name="first_impact_speed", lower=3.0)
    found = zo.search_gains("hopper", vary={"a": (5.0, 40.0)}, bounds=[bound])
    assert found.free["a"] == pytest.approx(9.0 * 0.75 / 0.2, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "lower"), [("locked_time", 4.0), ("margin", 0.1)])
def test_bounds_on_contacts_are_reached(name: str, lower: float) -> None:
    bound = zo.Bound(name=name, lower=lower)
    found = zo.search_gains(
        "clapper", vary={"A": (1.2, 5.0)}, parameters={"A": 1.3}, bounds=[bound]
    )
    assert found.orbit is not None
    (asked,) = found.asked
    assert asked["kept"]
    events = {one.name: one.time for one in found.orbit.events}
    period = found.orbit.period
    contact = (events["release upper"] - events["zeno upper"]) % period
    if name == "locked_time":
        assert contact == pytest.approx(lower, rel=1e-6)
        assert found.orbit.certificate["margins"][name] == pytest.approx(contact, rel=1e-9)
    else:
        assert contact / period >= lower - 1e-6


@pytest.mark.slow
def test_the_share_of_one_stop_is_that_of_its_list_of_events() -> None:
    problem = zo.load_problem("motor_pendulum")
    orbit = zo.find_orbit(problem, gains={"Kp": 2.5, "Kd": -1.0}).unwrap()
    # The contact phase is the nearest way to lose this orbit.
    share = orbit.certificate["margins"]["locked_time"] / orbit.period
    bound = zo.Bound(name="margin", lower=0.0)
    found = zo.search_gains(problem, vary={}, gains={"Kp": 2.5, "Kd": -1.0}, bounds=[bound])
    assert found.asked[0]["lowest"] == pytest.approx(share, rel=1e-6)


@pytest.mark.slow
def test_a_bound_that_no_orbit_keeps_is_answered_with_its_excess() -> None:
    bound = zo.Bound(name="first_impact_speed", lower=10.0)
    found = zo.search_gains(
        "hopper", vary={"a": (5.0, 40.0)}, objective=zo.MaxMargin(), bounds=[bound]
    )
    assert found.orbit is None
    assert "No orbit was found that keeps all bounds" in found.detail


# The command.


@pytest.mark.weekly
@pytest.mark.slow
def test_the_command_and_python_have_the_same_margin() -> None:
    words = ("search", "hopper", "--vary", "a=5:40", "--objective", "margin")
    answer = ask(*words, "--json")
    assert answer.code == YES
    assert answer.data["search"]["value"] == widest("hopper", {"a": (5.0, 40.0)}).value
    printed = ask(*words)
    assert "It persists for a = 7.3575 to 75, each alone." in printed.out
    assert "Asked for the widest margin to losing the orbit: 0.93264286." in printed.out
    refused = ask(*words, "--bounds", "first_impact_speed=10:")
    assert refused.code == NO


def test_a_margin_without_a_free_value_is_refused() -> None:
    with pytest.raises(zo.InputError, match="needs a free value: name its range in `vary`"):
        zo.search_gains("hopper", vary={}, objective=zo.MaxMargin())


def test_an_unknown_margin_is_refused_with_the_names() -> None:
    answer = ask("search", "hopper", "--vary", "a=5:40", "--bounds", "locked_tim=1:")
    assert answer.code not in (YES, NO)
    assert "Did you mean `locked_time`?" in answer.err


@pytest.mark.parametrize(
    ("bound", "message"),
    [
        ("margin=1.5:", "must ask for a `margin` below 1"),
        ("spectral_radius=0.2:0.5", "must bound `spectral_radius` from above only"),
        ("period=:-1", "must leave a positive `period`"),
    ],
)
def test_a_bound_that_no_orbit_satisfies_is_refused(bound: str, message: str) -> None:
    answer = ask("search", "hopper", "--vary", "a=5:40", "--bounds", bound)
    assert answer.code not in (YES, NO)
    assert message in answer.err
