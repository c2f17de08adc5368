"""Orbits of machines with several stops or switches: published values, closed forms, files."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.orbits import event_orbit

WALKER_MULTIPLIERS = (0.3531363 + 0.552108j, 0.3531363 - 0.552108j, 0.1438697)
"""From a program that shares no code with this one, to seven digits."""


@pytest.mark.slow
def test_the_walker_with_plastic_knees_has_the_published_gait() -> None:
    orbit = event_orbit("kneed_walker", restitution=0.0)
    assert orbit.certificate["passed"]
    assert orbit.sequence == ("zeno knee", "switch heel strike")
    # The swing knee is free after heel strike, with which the period ends.
    released = orbit.certificate["quantities"]["knee.release_time"]
    assert released == pytest.approx([0.56457806957] * 2, abs=1e-10)
    assert orbit.period == pytest.approx(0.56457806957, abs=1e-10)
    knee = orbit.events[0]
    assert knee.time == pytest.approx(0.34881592073, abs=1e-10)
    assert knee.state["dq2"] - knee.state["dq3"] == pytest.approx(-7.711117507, abs=1e-8)
    start = [orbit.start_state[name] for name in ("q1", "q2", "dq1", "dq2")]
    told = [0.18816565351, -0.28890268731, -1.10894729114, -0.05771782658]
    assert start == pytest.approx(told, abs=1e-9)
    assert orbit.floquet_multipliers == pytest.approx(WALKER_MULTIPLIERS, abs=1e-6)


@pytest.mark.parametrize("factor", fast(1, [1e3, 1e-6]))
@pytest.mark.parametrize(
    ("name", "lengths", "states"),
    [
        ("kneed_walker", ("l_thigh", "l_shank", "b_thigh", "b_shank", "g"), ()),
        ("clapper", ("d", "A"), ("place", "speed")),
        ("hopper", ("a", "s", "g"), ("height", "speed")),
    ],
)
def test_events_do_not_depend_on_the_unit_of_length(
    name: str, lengths: tuple[str, ...], states: tuple[str, ...], factor: float
) -> None:
    problem = zo.load_problem(name)
    parameters = {one: factor * problem.values().parameters[one] for one in lengths}
    start = {
        one: value * (factor if one in states else 1.0) for one, value in problem.starts[0].items()
    }
    scaled = replace(
        problem,
        starts=(start,),
        parameters=tuple(
            replace(one, default=parameters.get(one.name, one.default))
            for one in problem.parameters
        ),
    )
    there, here = (zo.simulate(one, until=3.0).events for one in (scaled, problem))
    assert [type(event) for event in there] == [type(event) for event in here]
    for one, other in zip(there, here, strict=True):
        assert one.time == pytest.approx(other.time, abs=1e-11)


@pytest.mark.slow
def test_the_multipliers_of_a_walker_are_those_of_differences_of_its_returns() -> None:
    orbit = event_orbit("kneed_walker", restitution=0.3)
    problem = zo.load_problem("kneed_walker")
    names = problem.state_names
    x = np.array([orbit.start_state[name] for name in names])
    # Directions that keep the start: both legs on the slope, and a straight swing leg.
    basis = np.array(
        [[1, -1, -1, 0, 0, 0], [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 1]], dtype=np.float64
    )

    def returned(y: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        run = zo.simulate(
            problem,
            until=0.7,
            parameters={"restitution": 0.3},
            start=dict(zip(names, map(float, y), strict=True)),
        )
        return run.switches[0].state_plus

    step = 1e-5
    columns = [(returned(x + step * d) - returned(x - step * d)) / (2 * step) for d in basis]
    matrix = np.linalg.lstsq(basis.T, np.array(columns).T, rcond=None)[0]
    found = sorted(np.linalg.eigvals(matrix), key=lambda mu: (-abs(mu), -mu.imag))
    assert orbit.floquet_multipliers == pytest.approx(tuple(found), abs=1e-6)


@pytest.mark.slow
def test_gaits_with_a_zeno_knee_end_where_heel_strike_meets_the_zeno_point() -> None:
    orbit = event_orbit("kneed_walker", restitution=0.37)
    family = zo.continue_orbit(orbit, ("restitution", 0.3, 0.5)).families[0]
    assert family.last.kind is zo.SpecialPointKind.EVENTS_MEET
    assert family.last.at.value == pytest.approx(0.38397, abs=5e-6)
    assert family.last.error < 1e-9
    assert family.last.detail.endswith("zeno knee and switch heel strike")
    assert all(point.stable for point in family.points)


@pytest.mark.slow
@pytest.mark.parametrize("section", ["zeno knee", "switch heel strike"])
def test_a_gait_is_the_same_from_every_section(section: str) -> None:
    orbit = zo.find_orbit("kneed_walker", section=section).unwrap()
    usual = event_orbit("kneed_walker")
    assert orbit.events[-1].name == section
    assert orbit.certificate["passed"]
    assert orbit.period == pytest.approx(usual.period, rel=1e-12)
    assert orbit.floquet_multipliers == pytest.approx(usual.floquet_multipliers, abs=1e-8)


def test_both_halves_of_a_clapper_are_mirror_images() -> None:
    orbit = event_orbit("clapper")
    period = 2 * math.pi / 0.3
    assert orbit.certificate["passed"]
    assert orbit.period == pytest.approx(period, rel=1e-13)
    events = {event.name: event for event in orbit.events if not event.name.startswith("impact")}
    between = (events["zeno upper"].time - events["zeno lower"].time) % period
    assert between == pytest.approx(period / 2, rel=1e-11)
    # On the stop `d` the spring holds the mass until the force is less: A cos(omega t) = k d.
    release = events["release upper"]
    assert release.state["cosine"] == pytest.approx(1.0 / 5.0, abs=1e-11)


def test_the_first_impact_of_a_clapper_follows_the_matrix_exponential() -> None:
    orbit = event_orbit("clapper")
    at = [event.name for event in orbit.events].index("release upper")
    release = orbit.events[at]
    hit = next(event for event in orbit.events[at:] if event.name == "impact lower")
    # x'' = -x - 0.1 x' + 5 cos(0.3 t), with the clock as two states.
    flow = np.array([[0, 1, 0, 0], [-1, -0.1, 5, 0], [0, 0, 0, -0.3], [0, 0, 0.3, 0]])
    start = [release.state[name] for name in ("place", "speed", "cosine", "sine")]
    end = expm(flow * (hit.time - release.time)) @ start
    wanted = [hit.state[name] for name in ("place", "speed", "cosine", "sine")]
    assert end == pytest.approx(wanted, abs=1e-10)


@pytest.mark.parametrize(("a", "s", "e"), [(20.0, 0.1, 0.5), (5.0, 0.3, 0.8), (40.0, 0.02, 0.2)])
def test_a_hopper_has_the_speed_and_the_multiplier_of_its_closed_form(
    a: float, s: float, e: float
) -> None:
    orbit = event_orbit("hopper", a=a, s=s, restitution=e)
    impact = orbit.events[-1]
    assert impact.state["speed"] ** 2 == pytest.approx(2 * a * s / (1 - e**2), rel=1e-12)
    # The impact takes the part 1 - e^2 of the energy, and the push gives the same each time.
    assert orbit.floquet_multipliers == pytest.approx((e**2,), abs=1e-10)


@pytest.mark.slow
def test_a_limit_that_is_never_reached_changes_nothing() -> None:
    orbit = event_orbit("limited_pendulum", U=1000.0)
    unlimited = zo.find_orbit("motor_pendulum").unwrap()
    assert orbit.sequence == ("release stop", "zeno stop")
    assert orbit.period == pytest.approx(unlimited.period, rel=1e-11)
    ours = np.array(orbit.floquet_multipliers[: len(unlimited.floquet_multipliers)])
    assert ours == pytest.approx(np.array(unlimited.floquet_multipliers), abs=1e-7)


@pytest.mark.slow
def test_a_limited_voltage_has_its_orbit() -> None:
    orbit = event_orbit("limited_pendulum")
    assert orbit.certificate["passed"]
    voltage = {"Kp": 2.5, "Kd": -1.0, "U": 5.0}
    limits = [event for event in orbit.events if event.name.startswith("switch")]
    assert limits
    for event in limits:
        wanted = -voltage["Kp"] * event.state["theta1"] - voltage["Kd"] * event.state["dtheta1"]
        assert abs(wanted) == pytest.approx(voltage["U"], abs=1e-10)


@pytest.mark.slow
def test_a_limited_voltage_moves_as_the_rig_with_that_part_alone() -> None:
    # The rig has a compliant stop in place of impacts, multiplier and kinks.
    orbit = event_orbit("limited_pendulum")
    release = next(event for event in orbit.events if event.name == "release stop")
    start = dict(release.state) | {"theta2": 0.0, "dtheta2": 0.0}
    names = ("theta1", "dtheta1", "current")

    def deviation(stiffness: float, event: Any) -> np.ndarray[Any, Any]:
        contact = zo.Contact(stiffness=stiffness, exponent=1.0, slowest=1e-4)
        rig = zo.Rig(contact=contact, bridge=zo.HBridge(supply=orbit.parameters["U"]))
        until = orbit.period if event is None else (event.time - release.time) % orbit.period
        wanted = start if event is None else event.state
        run = zo.simulate_rig("motor_pendulum", rig, until=until, start=start)
        assert np.max(np.abs(run.voltage)) == pytest.approx(orbit.parameters["U"], rel=1e-12)
        return np.array([run.of(name)[-1] - wanted[name] for name in names])

    for event in orbit.events:
        if event.name.startswith("switch"):
            assert np.max(np.abs(deviation(1e9, event))) < 1e-6, event.time
    # A whole period: the deviation falls with the root of the stiffness, to zero.
    soft, stiff = deviation(1e7, None), deviation(1e9, None)
    assert np.max(np.abs(stiff[[0, 2]])) < 1e-6
    assert np.max(np.abs((10 * stiff - soft) / 9)) < 3e-8


@pytest.mark.slow
def test_a_relay_has_the_published_bounces() -> None:
    orbit = event_orbit("relay", "zeno open")
    assert orbit.certificate["passed"]
    on, off = (event.time for event in orbit.events if event.name == "switch kink 1")
    first = {}
    for event in orbit.events:
        first.setdefault(event.name, event)
    milliseconds = {
        "release open": (on, 0.54922195966),
        "impact closed": (on, 2.09300141683),
        "zeno closed": (on, 2.56120736805),
        "release closed": (off, 24.2984216485 - 20),
        "impact open": (off, 27.3932730156 - 20),
        "zeno open": (off, 28.7985429859 - 20),
    }
    for name, (since, wanted) in milliseconds.items():
        assert 1e3 * (first[name].time - since) == pytest.approx(wanted, abs=2e-9), name
    assert first["impact closed"].state["dz"] == pytest.approx(-1.79987359610, abs=1e-9)
    assert first["impact open"].state["dz"] == pytest.approx(0.81032276748, abs=1e-9)
    assert orbit.floquet_multipliers == () or abs(orbit.floquet_multipliers[0]) < 1e-5


def test_an_orbit_of_a_relay_is_verified_from_every_section() -> None:
    # From the switch at U = 27.75 V, a run at 100 times the tolerance differs by 1.4e-9.
    sections = ("zeno open", "switch kink 1")
    orbits = [
        zo.find_orbit("relay", parameters={"U": 27.75}, section=one).unwrap() for one in sections
    ]
    assert all(orbit.certificate["passed"] for orbit in orbits)
    speeds = [
        min(event.state["dz"] for event in orbit.events if event.name == "impact closed")
        for orbit in orbits
    ]
    assert speeds[0] == pytest.approx(speeds[1], abs=1e-9)


# Files, and orbits that are false.


def test_a_file_holds_every_number_to_the_last_bit(tmp_path: Path) -> None:
    orbit = event_orbit("hopper")
    zo.write_orbit(orbit, tmp_path / "hopper.json")
    assert zo.read_orbit(tmp_path / "hopper.json") == orbit
    assert zo.verify(tmp_path / "hopper.json").passed


@pytest.mark.slow
def test_an_orbit_without_a_certificate_is_verified_from_its_data() -> None:
    bare = replace(event_orbit("kneed_walker"), certificate={}, floquet_multipliers=())
    certificate = zo.verify(bare)
    assert certificate.passed
    assert certificate.stable
    assert certificate.multipliers == pytest.approx(
        event_orbit("kneed_walker").floquet_multipliers, abs=1e-9
    )


def _moved(orbit: zo.Orbit, place: int, **changes: Any) -> zo.Orbit:
    events = list(orbit.events)
    events[place] = replace(events[place], **changes)
    return replace(orbit, events=tuple(events))


@pytest.mark.slow
def test_false_orbits_are_refused_with_the_residual_that_explains_it() -> None:
    orbit = event_orbit("kneed_walker")
    start = {**orbit.start_state, "dq1": orbit.start_state["dq1"] * (1 + 1e-6)}
    assert "closure" in zo.verify(replace(orbit, start_state=start)).failed
    late = _moved(orbit, 0, time=orbit.events[0].time + 1e-6)
    assert zo.verify(late).failed[0] == "first_impact"
    other = _moved(orbit, 0, state={**orbit.events[0].state, "q1": 0.0})
    assert zo.verify(other).failed[0] == "first_impact"
    longer = replace(orbit, period=orbit.period * (1 + 1e-7))
    assert "period" in zo.verify(longer).failed
    fewer = replace(orbit, events=orbit.events[1:])
    assert zo.verify(fewer).failed[0] == "first_impact"
    stiffer = replace(orbit, parameters={**orbit.parameters, "restitution": 0.21})
    assert zo.verify(stiffer).failed[0] == "impact_sequence"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"events": []}, "at least one event"),
        ({"period": 0.0}, "`period` must be positive"),
        ({"sequence": ["zeno stop"]}, "its `sequence` is `zeno stop`"),
        ({"period": 1.0}, "not at the end of its `period`"),
        ({"start_state": None}, "start_state"),
        ({"gains": {"Kp": "much"}}, "gains"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused(
    tmp_path: Path, change: dict[str, Any], words: str
) -> None:
    file = tmp_path / "orbit.json"
    file.write_text(json.dumps(event_orbit("hopper").as_json() | change))
    with pytest.raises(zo.OrbitFileError, match=words):
        zo.read_orbit(file)


def test_events_out_of_order_are_refused(tmp_path: Path) -> None:
    data = event_orbit("hopper").as_json()
    data["events"] = [data["events"][1], data["events"][0], *data["events"][2:]]
    data["sequence"] = [event["name"] for event in data["events"]]
    file = tmp_path / "orbit.json"
    file.write_text(json.dumps(data))
    with pytest.raises(zo.OrbitFileError, match="not in order of time"):
        zo.read_orbit(file)


def test_a_section_that_does_not_occur_is_refused_with_the_known_events() -> None:
    with pytest.raises(zo.InputError, match=r"zeno knee.*but it is `zeno elbow`"):
        zo.find_orbit("kneed_walker", section="zeno elbow").unwrap()


def test_an_impact_that_accumulates_is_no_section() -> None:
    with pytest.raises(zo.InputError, match=r"accumulate: take `zeno knee`"):
        zo.find_orbit("kneed_walker", section="impact knee").unwrap()


@pytest.mark.parametrize("problem", ["clapper", "hopper", "relief_valve"])
def test_period_and_multipliers_do_not_depend_on_the_section(problem: str) -> None:
    orbit = zo.find_orbit(problem).unwrap()
    limits = {name.replace("zeno", "impact") for name in orbit.sequence}
    others = {event.name for event in orbit.events} - limits - {orbit.section}
    for section in others:
        other = zo.find_orbit(problem, section=section).unwrap()
        assert other.certificate["passed"]
        assert other.period == pytest.approx(orbit.period, rel=1e-12)
        sizes = [sorted(map(abs, one.floquet_multipliers)) for one in (orbit, other)]
        assert sizes[1] == pytest.approx(sizes[0], abs=1e-9)


def test_a_machine_with_one_stop_has_the_same_orbit_from_each_section() -> None:
    numbers = {"Kp": 2.5, "Kd": -1.0}
    events = zo.find_orbit("motor_pendulum", gains=numbers, section="zeno stop").unwrap()
    phases = zo.find_orbit("motor_pendulum", gains=numbers).unwrap()
    assert (events.section, phases.section) == ("zeno stop", "release stop")
    assert (events.has_phases, phases.has_phases) == (False, True)
    assert events.period == pytest.approx(phases.period, rel=1e-11)
    assert events.certificate["passed"]
    largest = abs(events.floquet_multipliers[0])
    assert largest == pytest.approx(abs(phases.floquet_multipliers[0]), abs=1e-9)
