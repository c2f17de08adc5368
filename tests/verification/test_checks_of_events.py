"""Each check of an orbit of events refuses the false orbit or law that it is for, and it alone.

The run follows the compiled formulas of the true machine. The checks meet a machine with one false
law, as if the simulator had this law wrong.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.false_limits import FalseLimit
from tests.support.mechanisms import machine_of
from tests.support.orbits import event_orbit
from zeno_orbits import StateLimit
from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import Automatic, Segment, SegmentResult, Tolerance
from zeno_orbits.model import GraphDynamics, GraphMode, HybridDynamics, load_problem
from zeno_orbits.verification import CHECKS, OrbitCertificate, VerificationSettings

QUICK = VerificationSettings(n_periods=1)
MACHINES = ("clapper", "kneed_walker", "relay")
"""Two stops, two stops with a switch, two stops with kinks."""
SLOWLY = [pytest.param(name, marks=pytest.mark.slow) for name in MACHINES]
ZENO = {"clapper": "lower", "kneed_walker": "knee", "relay": "open"}
"""A stop of each machine at which impacts accumulate."""

COMPARED = {
    "impact": "first_impact",
    "zeno": "zeno_point",
    "release": "phases",
    "switch": "events",
}
"""Kind of an event to the residual that compares it."""

View = Callable[[HybridDynamics], HybridDynamics]


@cache
def _orbit(name: str) -> zo.Orbit:
    return zo.find_orbit(name).unwrap()


def _graph(name: str) -> GraphDynamics:
    problem = load_problem(name)
    return problem.graph_dynamics(_orbit(name).values(problem))


def _checked(name: str, change: View, stop: str = "") -> OrbitCertificate:
    """Verify an orbit with a false law at one stop, or at all."""
    wrong: Any = copy.copy(_graph(name))
    right = wrong.view

    def view(mode: Any, k: int) -> HybridDynamics:
        true = right(mode, k)
        return change(true) if stop in ("", wrong.stop_names[k]) else true

    wrong.view = view
    return zo.verify(_orbit(name), settings=QUICK, dynamics=wrong)


class _Guard:
    """A flow whose guard is another function of the guard."""

    def __init__(self, flow: Any, guard: Callable[[Vector], Vector]) -> None:
        self._flow, self._guard = flow, guard

    def __getattr__(self, name: str) -> Any:
        return getattr(self._flow, name)

    def guards(self, states: Vector) -> Vector:
        return self._guard(self._flow.guards(states))


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_a_true_orbit_passes_every_check_of_its_machine(name: str) -> None:
    seen = zo.verify(_orbit(name), settings=QUICK)
    assert seen.passed, seen.verdict()
    every = {"events", "restitution", "impact_energy", "delta_sweep", "energy_balance"}
    every |= {"first_impact", "impact_sequence", "zeno_point", "drift", "integration", "start"}
    every |= {"impulses"} if len(_graph(name).stop_names) > 1 else set()
    assert every | {"penetration", "adhesion", "closure", "period"} <= set(seen.residuals)
    assert set(seen.residuals) <= set(CHECKS)
    assert max(seen.residuals.values()) < 1e-10


# False laws.


@pytest.mark.parametrize("name", MACHINES)
def test_a_gap_that_is_negative_in_mid_flight_fails_alone(name: str) -> None:
    def inside(view: HybridDynamics) -> HybridDynamics:
        def guard(gaps: Vector) -> Vector:
            return np.where(gaps > 0.5 * gaps.max(initial=0.0), -1e-3 * gaps, gaps)

        return replace(view, free=_Guard(view.free, guard))

    seen = _checked(name, inside, ZENO[name])
    assert seen.failed == ("penetration",)
    # Relative to the largest gap that stays, at most half of the true one.
    assert 1e-5 < seen.residuals["penetration"] < 2.1e-3


@pytest.mark.parametrize("name", MACHINES)
def test_a_stop_that_pulls_in_contact_fails_alone(name: str) -> None:
    def pulling(view: HybridDynamics) -> HybridDynamics:
        return replace(view, locked=_Guard(view.locked, np.negative))

    assert _checked(name, pulling, ZENO[name]).failed == ("adhesion",)


@pytest.mark.parametrize("name", MACHINES)
def test_a_false_restitution_breaks_the_law_of_impact(name: str) -> None:
    seen = _checked(name, lambda view: replace(view, restitution=view.restitution + 1e-6))
    assert seen.failed == ("restitution", "impact_energy")
    assert seen.residuals["restitution"] == pytest.approx(1e-6, rel=1e-6)


@pytest.mark.parametrize("name", MACHINES)
def test_a_false_loss_at_an_impact_is_seen_from_kinetic_energies(name: str) -> None:
    def heavy(view: HybridDynamics) -> HybridDynamics:
        def inertia(x: Vector) -> float:
            return (1 + 1e-6) * view.normal_inertia(x)

        return replace(view, normal_inertia=inertia)

    seen = _checked(name, heavy)
    assert "impact_energy" in seen.failed
    assert "restitution" not in seen.failed
    e = min(view.restitution for view in _graph(name).open_views)
    assert seen.residuals["impact_energy"] == pytest.approx(1e-6 * (1 - e**2), rel=1e-3)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plain:
    """An engine that the compiled loop does not know."""

    def follow(self, leg: Segment) -> SegmentResult:
        return Automatic().follow(leg)


@pytest.mark.parametrize("name", [MACHINES[0], *SLOWLY[1:]])
@pytest.mark.parametrize("delay", [0.0, 1e-6])
def test_a_wrong_zeno_limit_is_not_what_the_cuts_tend_to(name: str, delay: float) -> None:
    simulation = zo.SimulationSettings(engine=_Plain(), completion=FalseLimit(delay=delay))
    seen = zo.verify(_orbit(name), settings=replace(QUICK, simulation=simulation))
    assert {"zeno_point", "delta_sweep"} <= set(seen.failed) if delay else seen.passed


def test_a_broken_constraint_fails_alone() -> None:
    (release,) = (one for one in _orbit("clapper").events if one.name == "release upper")
    there = np.array(list(release.state.values()))

    def broken(view: HybridDynamics) -> HybridDynamics:
        def constraint(x: Vector) -> Vector:
            off = 1e-6 if np.max(np.abs(x - there)) < 1e-6 else 0.0
            return view.holonomic(x) + off

        return replace(view, holonomic=constraint)

    assert _checked("clapper", broken).failed == ("holonomic",)


@pytest.mark.parametrize("side", [0, 1])
def test_a_kink_on_its_other_side_fails_alone(side: int) -> None:
    wrong: Any = copy.copy(_graph("relay"))
    right = wrong.guards_along

    def guards(mode: GraphMode, states: Vector) -> Any:
        values, rounding, armed = right(mode, states)
        _, sides = mode
        return (-values if sides[0] == bool(side) else values), rounding, armed

    wrong.guards_along = guards
    assert zo.verify(_orbit("relay"), settings=QUICK, dynamics=wrong).failed == ("switches",)


def test_an_armed_switch_that_is_passed_without_its_event_fails_alone() -> None:
    wrong: Any = copy.copy(_graph("kneed_walker"))
    right = wrong.guards_along
    orbit = _orbit("kneed_walker")
    run = zo.simulate("kneed_walker", start=orbit.start_state, until=orbit.events[0].time)
    early, middle, late = (float(run.state_at(part * run.end_time)[0]) for part in (0.2, 0.5, 0.8))

    def guards(mode: GraphMode, states: Vector) -> Any:
        _, rounding, armed = right(mode, states)
        # Another guard, which falls through zero in the middle of the first flight.
        falling = (middle - states[:, :1]) * np.sign(late - early)
        return falling, rounding, np.ones_like(armed)

    wrong.guards_along = guards
    seen = zo.verify(_orbit("kneed_walker"), settings=QUICK, dynamics=wrong)
    assert seen.failed == ("switches",)


@pytest.mark.parametrize("name", MACHINES)
def test_a_coordinate_beyond_its_limit_fails_alone(name: str) -> None:
    problem, orbit = load_problem(name), _orbit(name)
    state = problem.state_names[0]
    largest = max(abs(float(event.state[state])) for event in orbit.events)
    limit = StateLimit(beyond=0.9 * largest, phrase="the arm left its frame")
    seen = zo.verify(orbit, problem=replace(problem, escapes={state: limit}), settings=QUICK)
    assert seen.failed == ("escape",)
    assert "the arm left its frame" in seen.verdict()


@pytest.mark.slow
def test_a_wrong_second_model_fails_alone(tmp_path: Path) -> None:
    problem = load_problem("motor_pendulum")
    orbit = zo.find_orbit(problem).unwrap()
    assert problem.reference is not None
    assert zo.verify(orbit, problem=problem, settings=QUICK).residuals["second_model"] < 1e-12
    text = problem.reference.read_text(encoding="utf-8")
    file = tmp_path / "reference.py"
    wrong = text.replace("kinetic - self.g * height", "kinetic + self.g * height")
    file.write_text(wrong, encoding="utf-8")
    false = replace(problem, reference=file)
    assert zo.verify(orbit, problem=false, settings=QUICK).failed == ("second_model",)


@pytest.mark.parametrize("section", ["release lower", "release upper"])
def test_a_multiplier_that_is_not_zero_at_the_release_fails_alone(section: str) -> None:
    orbit = zo.find_orbit("clapper", section=section).unwrap()
    wrong: Any = copy.copy(_graph("clapper"))
    right, off = wrong.view, 1e-6 * wrong.own.multiplier

    def view(mode: Any, k: int) -> HybridDynamics:
        true = right(mode, k)
        return replace(true, multiplier=lambda x: true.multiplier(x) + off)

    wrong.view = view
    assert zo.verify(orbit, settings=QUICK).passed
    assert zo.verify(orbit, settings=QUICK, dynamics=wrong).failed == ("release",)


def test_a_start_that_is_not_the_state_after_a_switch_fails_alone() -> None:
    wrong: Any = copy.copy(_graph("kneed_walker"))
    right = wrong.after_switch
    wrong.after_switch = lambda switch, x: right(switch, x) + 1e-6
    seen = zo.verify(_orbit("kneed_walker"), settings=QUICK, dynamics=wrong)
    assert seen.failed == ("start",)


def test_a_closed_stop_that_pulls_in_an_impact_fails_alone() -> None:
    wrong: Any = copy.copy(_graph("clapper"))
    right = wrong.delassus

    def coupled(x: Vector) -> Vector:
        # As if the stops were coupled: an impact on one would pull at the other.
        matrix = right(x)
        size = float(np.sqrt(matrix[0, 0] * matrix[1, 1]))
        return np.diag(np.diag(matrix)) + 0.5 * size * np.array([[0.0, 1.0], [1.0, 0.0]])

    wrong.delassus = coupled
    seen = zo.verify(_orbit("clapper"), settings=QUICK, dynamics=wrong)
    assert seen.failed == ("impulses",)


@pytest.mark.slow
def test_a_later_period_that_goes_elsewhere_fails_alone() -> None:
    orbit = _orbit("kneed_walker")
    since = orbit.period + 0.5 * orbit.events[0].time
    completion = FalseLimit(place=1, off=1e-6, since=since, until=since + orbit.period)
    off = zo.SimulationSettings(engine=_Plain(), completion=completion)
    settings = replace(QUICK, n_periods=2, simulation=off)
    assert zo.verify(orbit, settings=settings).failed == ("drift",)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Careless:
    """An engine that takes any tolerance near the usual one, or above it, for a coarse one."""

    def follow(self, leg: Segment) -> SegmentResult:
        loose = leg.tolerance.relative > Tolerance().relative / 50
        coarse = Tolerance(relative=1e-5, absolute=1e-6)
        return Automatic().follow(replace(leg, tolerance=coarse) if loose else leg)


@pytest.mark.slow
def test_a_return_that_a_looser_integration_does_not_confirm_fails_alone() -> None:
    careless = zo.SimulationSettings(engine=_Careless())
    seen = zo.verify(_orbit("kneed_walker"), settings=replace(QUICK, simulation=careless))
    assert seen.failed == ("integration",)


# False data.


@pytest.mark.parametrize("name", MACHINES)
def test_a_false_period_fails_alone(name: str) -> None:
    orbit = _orbit(name)
    for part in (1e-7, -1e-4, 0.3):
        false = replace(orbit, period=orbit.period * (1 + part))
        assert zo.verify(false, settings=QUICK).failed == ("period",)


@pytest.mark.parametrize("name", MACHINES)
def test_a_start_that_is_not_the_end_of_the_period_is_refused(name: str) -> None:
    orbit = _orbit(name)
    for state, value in orbit.start_state.items():
        start = {**orbit.start_state, state: value + 1e-6}
        seen = zo.verify(replace(orbit, start_state=start), settings=QUICK)
        assert not seen.passed
        assert {"start", "closure"} & set(seen.failed), state


def test_a_file_with_another_event_is_refused_from_this_event_on() -> None:
    orbit = _orbit("clapper")
    names = [event.name for event in orbit.events]
    place = names.index("release lower")
    false = replace(orbit.events[place], name="release upper")
    events = (*orbit.events[:place], false, *orbit.events[place + 1 :])
    seen = zo.verify(replace(orbit, events=events), settings=QUICK)
    assert "events" in seen.failed


def _dragged() -> zo.Problem:
    """Return a forced mass with quadratic drag. Its sine is small at every kink of the drag."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v, clock = ca.SX.sym("q"), ca.SX.sym("v"), zo.Clock.at(p["omega"])
        mass = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=135 * q**2 / 2,
            passive_force=-0.28 * v - 0.145 * ca.fabs(v) * v,
            applied_force=4.2 * clock.cosine,
            clock=clock,
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    units = {"q": "m", "v": "m/s", "cosine": "1", "sine": "1"}
    return machine_of(model, units, {"omega": 1.15})


def test_a_state_that_is_small_at_the_events_has_its_size_between_them() -> None:
    problem = _dragged()
    orbit = zo.find_orbit(problem).unwrap()
    assert max(abs(event.state["sine"]) for event in orbit.events) < 0.01
    assert zo.verify(orbit, problem=problem).passed


def test_a_height_that_is_zero_at_the_events_has_its_size_between_them() -> None:
    table = event_orbit("vibrating_table")
    compared = {"zeno": "zeno_point"}.get(table.events[-1].word, "closure")
    run = zo.simulate("vibrating_table", start=table.start_state, until=table.period)
    highest = float(np.max(run.sampled()[1][:, 0]))
    last = table.events[-1]
    state = {**last.state, "height": last.state["height"] + 1e-7 * highest}
    false = replace(table, events=(*table.events[:-1], replace(last, state=state)))
    assert zo.verify(table, settings=QUICK).passed
    assert zo.verify(false, settings=QUICK).failed == (compared,)


@pytest.mark.parametrize("name", [MACHINES[0], *SLOWLY[1:]])
@pytest.mark.parametrize("of", ["time", "state"])
def test_every_event_of_a_file_is_compared(name: str, of: str) -> None:
    orbit = _orbit(name)
    # The first event of a name: its impact is the first of a sequence.
    kinds = {event.name: k for k, event in reversed([*enumerate(orbit.events[:-1])])}
    for k in kinds.values():
        event = orbit.events[k]
        state = dict(event.state)
        first, value = next(iter(state.items()))
        moved = (
            replace(event, time=event.time + 1e-8 * orbit.period)
            if of == "time"
            else replace(event, state=state | {first: value + 1e-6 * (1 + abs(value))})
        )
        events = (*orbit.events[:k], moved, *orbit.events[k + 1 :])
        seen = zo.verify(replace(orbit, events=events), settings=QUICK)
        assert seen.failed == (COMPARED[event.word],), event.name


@pytest.mark.parametrize("name", MACHINES)
def test_impacts_that_the_check_does_not_resolve_obey_the_law_of_the_tail(name: str) -> None:
    orbit, stop = _orbit(name), ZENO[name]
    names = [event.name for event in orbit.events]
    zeno = names.index(f"zeno {stop}")
    last, limit = orbit.events[zeno - 1], orbit.events[zeno]
    assert last.name == f"impact {stop}"
    e = _graph(name).open_views[_graph(name).stop_names.index(stop)].restitution

    def continued(miss: float) -> zo.Orbit:
        """Return the orbit with two further impacts on its way to the Zeno point."""
        more = [
            replace(
                last,
                time=limit.time + e**j * (last.time - limit.time),
                state={
                    state: limit.state[state] + (e**j + miss) * (value - limit.state[state])
                    for state, value in last.state.items()
                },
            )
            for j in (1, 2)
        ]
        return replace(orbit, events=(*orbit.events[:zeno], *more, *orbit.events[zeno:]))

    assert zo.verify(continued(0.0), settings=QUICK).passed
    assert zo.verify(continued(0.2), settings=QUICK).failed == ("impact_sequence",)
    fewer = replace(orbit, events=(*orbit.events[: zeno - 1], *orbit.events[zeno:]))
    assert zo.verify(fewer, settings=QUICK).passed


@pytest.mark.parametrize("values", [{}, {"mass": 1.0}])
def test_values_that_are_missing_or_unknown_are_refused(values: dict[str, float]) -> None:
    orbit = _orbit("clapper")
    false = {**orbit.parameters, **values} if values else {}
    with pytest.raises(zo.InputError, match="must have the parameters of its problem"):
        zo.verify(replace(orbit, parameters=false), settings=QUICK)


@pytest.mark.parametrize("other", ["motor_pendulum", "hopper", "relay"])
def test_a_machine_of_another_problem_is_refused(other: str) -> None:
    problem = load_problem(other)
    wrong = problem.system(problem.values())
    with pytest.raises(zo.InputError, match="`dynamics` must have the states and stops of problem"):
        zo.verify(_orbit("clapper"), dynamics=wrong)


@pytest.mark.parametrize("name", MACHINES)
def test_resolved_impacts_that_an_orbit_lacks_are_counted(name: str) -> None:
    orbit, stop = _orbit(name), ZENO[name]
    names = [event.name for event in orbit.events]
    zeno = names.index(f"zeno {stop}")
    assert names[zeno - 2 : zeno] == 2 * [f"impact {stop}"]
    whole = zo.verify(orbit, settings=QUICK)
    assert whole.unlisted == 0
    assert "unlisted" not in whole.as_json()
    short = zo.verify(
        replace(orbit, events=(*orbit.events[: zeno - 2], *orbit.events[zeno:])), settings=QUICK
    )
    assert short.passed
    assert short.unlisted == short.as_json()["unlisted"] == 2
    # A gap in the list is no end of it.
    gap = (*orbit.events[: zeno - 2], *orbit.events[zeno - 1 :])
    assert zo.verify(replace(orbit, events=gap), settings=QUICK).failed == ("impact_sequence",)
