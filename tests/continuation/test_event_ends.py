"""Ends of families of event orbits, against exact flights."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

import zeno_orbits as zo
from tests.reference.relay_by_hand import period_by_hand, relay_by_hand
from tests.reference.two_sided_end import accumulates
from zeno_orbits.arrays import Vector
from zeno_orbits.continuation import ContinuationSettings, Family, SpecialPointKind, family_of_orbit
from zeno_orbits.model import load_problem
from zeno_orbits.search import settled_event_orbit

CLAPPER = load_problem("clapper")
FORCE = {"amplitude": 5.0, "omega": 0.3, "damping": 0.1}


def _family(
    problem: zo.Problem, parameter: str, box: tuple[float, float], **parameters: float
) -> Family:
    """Return the family of the orbit of a problem at its defaults, or at other parameters."""
    orbit = settled_event_orbit(problem, problem.values(parameters=parameters))
    once = ContinuationSettings(doublings=0)
    (family,) = family_of_orbit(problem, orbit, parameter, box, settings=once).families
    return family


@pytest.mark.slow
def test_the_contact_phases_of_the_clapper_vanish_where_exact_flights_say() -> None:
    family = _family(CLAPPER, "restitution", (0.8344, 0.9), restitution=0.8345)
    end = family.last
    assert end.kind is SpecialPointKind.LOCK_VANISHES
    assert end.detail in ("zeno upper and release upper", "zeno lower and release lower")
    assert end.error < 1e-8
    width = 10 * end.error + 1e-11
    assert accumulates(**FORCE, restitution=end.at.value - width)
    assert not accumulates(**FORCE, restitution=end.at.value + width)
    # Both contact phases shrink as the power 0.6 of the distance, theory (5.7).
    for stop in ("upper", "lower"):
        times = [point.margins[f"contact duration, release {stop}"] for point in family.points]
        assert times[-1] < times[0]


@pytest.mark.slow
def test_a_family_through_a_contact_phase_starts_at_its_release() -> None:
    orbit = settled_event_orbit(CLAPPER, CLAPPER.values(parameters={"restitution": 0.3}))
    assert orbit.section.startswith("zeno ")
    few = ContinuationSettings(doublings=0)
    box = (0.2999, 0.3001)
    (family,) = family_of_orbit(CLAPPER, orbit, "restitution", box, settings=few).families
    point = family.points[0]
    # A release is at rest on a stop, where the force equals that of the spring.
    assert abs(point.state["place"]) == pytest.approx(1.0, abs=1e-12)
    assert point.state["speed"] == pytest.approx(0.0, abs=1e-12)
    force = 5.0 * point.state["cosine"]
    assert force == pytest.approx(point.state["place"], abs=1e-11)
    # So the section is a point, and the return has no multipliers.
    assert point.multipliers == ()


def _unlike_stops(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return an oscillator between two stops of unlike distance and restitution."""
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    clock = zo.Clock.at(p["omega"])
    return zo.hybrid_system(
        machine := zo.HybridLagrangian.from_energies(
            q=x,
            v=v,
            kinetic=v**2 / 2,
            potential=0.65 * x**2,
            passive_force=-0.15 * v,
            applied_force=4.0 * clock.cosine + p["F0"],
            clock=clock,
            stops=(
                zo.Stop(name="hi", gap=1.0 - x, restitution=p["restitution"]),
                zo.Stop(name="lo", gap=0.7 + x, restitution=p["e_lo"]),
            ),
        ),
        zo.no_drive(machine),
    )


def _unlike(*, omega: float, restitution: float, e_lo: float, F0: float) -> zo.Problem:
    return zo.Problem(
        name="unlike_stops",
        title="Oscillator between unlike stops",
        source="tests",
        state_names=("x", "v", "cosine", "sine"),
        state_units=("m", "m/s", "1", "1"),
        parameters=(
            zo.Quantity.positive("omega", omega, "rad/s", "frequency"),
            zo.Quantity.restitution(restitution),
            zo.Quantity(name="e_lo", unit="1", meaning="e of lo", default=e_lo, lower=0.0),
            zo.Quantity(name="F0", unit="N", meaning="constant force", default=F0),
        ),
        gains=(),
        model=_unlike_stops,
        starts=({"cosine": 1.0},),
        portraits=(("x", "v"),),
        amplitude_of="x",
    )


def _least_gap_after_lo(state: Mapping[str, float], omega: float) -> float:
    """Return the least gap of `lo` on the flight after its impact, by exact flights from `hi`."""
    free, period = np.array([[0.0, 1.0], [-1.3, -0.15]]), 2 * np.pi / omega
    response = 4.0 / complex(1.3 - omega**2, 0.15 * omega)
    phase = np.arctan2(state["sine"], state["cosine"])

    def forced(t: float) -> Vector:
        wave = response * np.exp(1j * (phase + omega * t))
        return np.array([wave.real, (1j * omega * wave).real])

    def flight(begin: float, x: Vector) -> Callable[[float], Vector]:
        left = x - forced(begin)
        return lambda t: forced(t) + expm(free * (t - begin)) @ left

    first = flight(0.0, np.array([state["x"], state["v"]]))
    times = np.linspace(1e-3, period, 2000)
    k = next(k for k, t in enumerate(times) if first(t)[0] < -0.7)
    struck = brentq(lambda t: float(first(t)[0]) + 0.7, times[k - 1], times[k], xtol=1e-15)
    second = flight(struck, np.array([-0.7, -0.7 * first(struck)[1]]))
    times = np.linspace(struck, period, 4000)[1:-1]
    speeds = [float(second(t)[1]) for t in times]
    # The mass rises from the stop, falls towards it again, and turns.
    k = next(k for k in range(1, len(times)) if speeds[k - 1] < 0.0 <= speeds[k])
    turn = brentq(lambda t: float(second(t)[1]), times[k - 1], times[k], xtol=1e-15)
    return float(second(turn)[0]) + 0.7


@pytest.mark.slow
def test_a_family_without_switches_ends_openly_where_a_flight_has_no_duration() -> None:
    """A flight on `lo` that ends at once has no derivative, and the machine has no switch."""
    problem = _unlike(omega=0.4, restitution=0.77, e_lo=0.25, F0=0.4)
    family = _family(problem, "restitution", (0.765, 0.8))
    # Flights in closed form have a release of `hi` 0.10 s after its Zeno point at 0.78, none at
    # 0.79.
    assert 0.78 < family.last.at.value < 0.79
    assert family.last.kind in (SpecialPointKind.LOCK_VANISHES, SpecialPointKind.GAVE_UP)


@pytest.mark.slow
@pytest.mark.parametrize("box", [(1.9, 2.3), (1.2, 2.6)])
def test_a_family_ends_where_a_flight_grazes_the_stop_that_it_left(
    box: tuple[float, float],
) -> None:
    problem = _unlike(omega=2.2, restitution=0.9, e_lo=0.7, F0=0.0)
    family = _family(problem, "omega", box)
    assert family.first.kind is SpecialPointKind.EARLIER_GRAZING
    at, error = family.first.at.value, family.first.error
    assert error < 1e-10
    # The least gap by exact flights falls to zero on a line.
    gaps = [_least_gap_after_lo(one.state, one.value) for one in family.points[:2]]
    first, second = (one.value for one in family.points[:2])
    zero = first - gaps[0] * (second - first) / (gaps[1] - gaps[0])
    assert 0.0 < gaps[0] < gaps[1]
    assert at == pytest.approx(zero, abs=1e-5)


def _zeno_in_time(stop: str, switching: float, **changed: float) -> bool:
    """Return whether impacts of the relay accumulate before a time [ms], by an event loop."""
    period = changed.get("period", 40.0)
    events = period_by_hand(relay_by_hand(55.0, 50.0, (), **changed), period)
    zenos = [float(one.time) for one in events if (one.kind, one.name) == ("zeno", stop)]
    return any(time < switching for time in zenos)


@pytest.mark.weekly
@pytest.mark.slow
def test_the_relay_closes_down_to_the_voltage_of_an_independent_loop() -> None:
    end = _family(load_problem("relay"), "U", (9.0, 24.5)).first
    assert end.kind is SpecialPointKind.EVENTS_MEET
    assert "zeno closed" in end.detail
    assert end.error < 1e-9
    at = end.at.value
    assert _zeno_in_time("closed", 20.0, supply=at + 1e-5)
    assert not _zeno_in_time("closed", 20.0, supply=at - 1e-5)


@pytest.mark.slow
def test_the_next_switching_cuts_a_bounce_at_the_frequency_of_an_independent_loop() -> None:
    end = _family(load_problem("relay"), "omega", (150.0, 400.0)).last
    assert end.kind is SpecialPointKind.EVENTS_MEET
    assert "zeno open" in end.detail
    assert end.error < 1e-7
    slower, faster = (2e3 * np.pi / (end.at.value + off) for off in (-1e-4, 1e-4))
    assert _zeno_in_time("open", slower, period=slower)
    assert not _zeno_in_time("open", faster, period=faster)
