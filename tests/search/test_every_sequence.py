"""The program for every event sequence against simulated orbits, closed forms and shooting."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.contactless import wheel, wheel_motion
from zeno_orbits import NearestGains
from zeno_orbits.orbits import EventReturn, event_return, largest_states, on_section
from zeno_orbits.orbits import orbit_event_name as name_of
from zeno_orbits.search import (
    ProgramOrbit,
    ProgramTask,
    Verdict,
    orbit_by_program,
    search_orbits,
    settled_return,
)
from zeno_orbits.search.objectives import Target
from zeno_orbits.simulation import SimulationSettings

FIXED = ProgramTask(free={}, objective=NearestGains(target={}), sizes={}, origin={}, units={})
PROGRAM, SHOOTING = zo.SearchMethod.PROGRAM, zo.SearchMethod.SHOOTING


def slow(*machines: tuple[str, dict[str, float]]) -> list[Any]:
    return [pytest.param(*machine, marks=pytest.mark.slow) for machine in machines]


def beside(
    problem: zo.Problem, values: zo.ParameterValues, part: float = 0.02
) -> tuple[EventReturn, EventReturn]:
    """Return an orbit, and the motion from a start that is off by parts of the states."""
    graph, orbit = problem.graph_dynamics(values), settled_return(problem, values)
    sizes = largest_states(orbit.execution.arcs, graph)
    off = part * sizes * np.random.default_rng(1).uniform(-1, 1, sizes.size)
    section = name_of(orbit.events[-1])
    motion = event_return(
        graph,
        on_section(graph, orbit.start + off, orbit.mode),
        section=section,
        n_returns=sum(name_of(event) == section for event in orbit.events),
        guess=orbit.period,
        settings=SimulationSettings(),
        mode=orbit.mode,
    )
    return orbit, motion


def closed(name: str, parameters: Mapping[str, float]) -> tuple[EventReturn, ProgramOrbit]:
    problem = zo.load_problem(name)
    values = problem.values(parameters=parameters)
    orbit, motion = beside(problem, values)
    # A valve leaves its seat in one state only.
    assert name == "relief_valve" or not np.allclose(motion.start, orbit.start, rtol=1e-4)
    return orbit, orbit_by_program(problem, values, motion, FIXED)


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("clapper", {}),
        ("hopper", {}),
        ("relay", {}),
        ("relief_valve", {}),
        *slow(
            ("kneed_walker", {}),
            ("kneed_walker", {"restitution": 0.0}),
            ("limited_pendulum", {}),
            ("sampled_pendulum", {}),
            ("motor_pendulum", {}),
            ("powered_walker", {}),
            ("relay_soft", {}),
            ("two_motors", {}),
        ),
    ],
)
def test_the_program_has_the_simulated_orbit(name: str, parameters: dict[str, float]) -> None:
    # Two stops, kinks, resets, samples, waveforms, a plastic knee: 1e-9 is far above both errors.
    orbit, solved = closed(name, parameters)
    assert solved.converged
    assert solved.miss < 1e-9
    assert solved.found.period == pytest.approx(orbit.period, rel=1e-10)


def test_a_machine_without_a_stop_has_the_slope_of_its_period() -> None:
    # The period at the slope is that of an energy balance and an integration by SciPy.
    found = zo.search_gains(
        wheel(),
        vary={"slope": (0.05, 0.15)},
        objective=zo.TargetPeriod(target=wheel_motion(slope=0.1)[0]),
        method=PROGRAM,
    )
    assert found.orbit is not None
    assert found.orbit.certificate["passed"]
    assert found.free["slope"] == pytest.approx(0.1, rel=1e-8)
    assert found.method is PROGRAM


@pytest.mark.slow
def test_a_prescribed_period_of_a_driven_machine_is_that_of_its_drive() -> None:
    # The frequency alone decides, so the amplitude stays where it is.
    found = zo.search_gains(
        "clapper",
        vary={"omega": (0.2, 0.4), "A": (4.0, 6.0)},
        objective=zo.TargetPeriod(target=24.0),
        method=PROGRAM,
    )
    assert found.orbit is not None
    assert found.orbit.certificate["passed"]
    assert found.free["omega"] == pytest.approx(2 * math.pi / 24, rel=1e-8)
    assert found.free["A"] == pytest.approx(5.0, rel=1e-7)


@pytest.mark.slow
def test_a_bounded_optimum_has_its_closed_form() -> None:
    # v^2 = 2 a s / (1 - e^2) and the loss is a s, so the bound on v decides.
    e, s = 0.5, 0.1
    found = zo.search_gains(
        "hopper",
        vary={"a": (5.0, 40.0)},
        objective=zo.MinImpactLoss(),
        bounds=[zo.Bound(name="stop.impact_speed", lower=2.0)],
        method=PROGRAM,
    )
    assert found.orbit is not None
    assert found.free["a"] == pytest.approx(4.0 * (1 - e**2) / (2 * s), rel=1e-7)
    assert found.value == pytest.approx(4.0 * (1 - e**2) / 2, rel=1e-7)
    assert found.asked[0]["kept"]


class TargetLoss(Target):
    """A prescribed loss of energy in impacts: an objective of a user."""

    @property
    def wish(self) -> str:
        return f"a loss of {self.target:g} J"

    def prescribed(self, point: Any) -> Any:
        return point.slopes("stop.energy_lost")[0]

    def aim(self, terms: Any, *, is_wish: bool) -> None:
        terms.reach("stop.energy_lost", self.target, is_wish=is_wish)


@pytest.mark.parametrize("method", [PROGRAM, SHOOTING])
def test_one_class_is_an_objective_of_both_methods(method: zo.SearchMethod) -> None:
    # The loss is a s, with s = 0.1.
    found = zo.search_gains(
        "hopper", vary={"a": (5.0, 40.0)}, objective=TargetLoss(target=2.4), method=method
    )
    assert found.method is method
    assert found.free["a"] == pytest.approx(24.0, rel=1e-8)


@pytest.mark.slow
def test_the_worst_corner_has_its_closed_form() -> None:
    e = 0.5
    found = zo.search_gains(
        "hopper",
        vary={"s": (0.05, 0.3)},
        objective=zo.MinImpactLoss(uncertain={"a": (15.0, 25.0)}),
        bounds=[zo.Bound(name="stop.impact_speed", lower=2.0)],
        method=PROGRAM,
    )
    # The least push decides the speed, and the largest one the loss.
    s = 4.0 * (1 - e**2) / (2 * 15.0)
    assert found.free["s"] == pytest.approx(s, rel=1e-7)
    assert found.worst == pytest.approx(25.0 * s, rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [
        pytest.param(
            "clapper",
            {"objective": zo.MinImpactLoss(), "vary": {"A": (4.5, 7.0), "c": (0.05, 0.5)}},
            marks=pytest.mark.slow,
        ),
        (
            "hopper",
            {
                "vary": {"a": (5.0, 40.0)},
                "objective": zo.TargetAmplitude(target=0.1, state="height"),
            },
        ),
    ],
)
def test_shooting_has_the_same_optimum(name: str, options: dict[str, Any]) -> None:
    program, shooting = (
        zo.search_gains(name, **options, method=method) for method in (PROGRAM, SHOOTING)
    )
    assert program.orbit is not None
    assert program.iterations > 0
    assert shooting.iterations == 0
    assert program.value == pytest.approx(shooting.value, rel=1e-6)
    for key, value in shooting.free.items():
        assert program.free[key] == pytest.approx(value, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("motor_pendulum", {"objective": zo.TargetPeriod(target=1.8)}),
        ("motor_pendulum", {"objective": zo.TargetAmplitude(target=1.0, state="theta1")}),
        ("motor_pendulum", {"objective": zo.MinBounceTime(), "vary": {"Kp": (1.0, 5.0)}}),
        (
            "motor_pendulum",
            {
                "objective": zo.MinEnergy(),
                "vary": {"Kd": (-1.2, -0.6)},
                "bounds": [zo.Bound(name="theta2", upper=1.9)],
            },
        ),
        pytest.param("powered_walker", {"objective": zo.MinEnergy()}, marks=pytest.mark.weekly),
        ("powered_walker", {"objective": zo.TargetPeriod(target=0.55)}),
    ],
)
def test_shooting_has_the_same_optimum_of_motors(name: str, options: dict[str, Any]) -> None:
    program, shooting = (
        zo.search_gains(name, **options, method=method) for method in (PROGRAM, SHOOTING)
    )
    assert program.orbit is not None
    assert program.orbit.certificate["passed"]
    assert program.value == pytest.approx(shooting.value, rel=1e-5)


@pytest.mark.weekly
@pytest.mark.slow
def test_a_gap_that_touches_zero_at_the_optimum_is_no_impact() -> None:
    # Shooting comes within 1.3e-10 of the bound and refuses its optimum, 2.02765e-6 J.
    found = zo.search_gains(
        "relay_soft",
        vary={"t1": (5e-4, 1.6e-3), "t2": (1.7e-3, 5e-3)},
        objective=zo.MinImpactLoss(stop="closed"),
        bounds=[zo.Bound(name="closed.impact_speed", lower=0.05)],
        method=PROGRAM,
    )
    assert found.orbit is not None
    assert found.orbit.certificate["passed"]
    assert found.asked[0]["kept"]
    assert found.value == pytest.approx(2.02765e-6, rel=1e-4)


@pytest.mark.slow
def test_a_bounded_peak_is_kept_between_the_stages() -> None:
    found = zo.search_gains(
        "motor_pendulum",
        vary={"Kp": (1.0, 5.0), "Kd": (-1.2, -0.3)},
        objective=zo.MinPeak(signal="current"),
        bounds=[zo.Bound(name="period", lower=1.75)],
        method=PROGRAM,
    )
    assert found.orbit is not None
    assert found.orbit.certificate["passed"]
    alone = zo.search_gains(
        "motor_pendulum",
        vary={"Kp": (1.0, 5.0), "Kd": (-1.2, -0.3)},
        objective=zo.MinPeak(signal="current"),
        bounds=[zo.Bound(name="period", lower=1.75)],
        method=SHOOTING,
    )
    assert found.value <= alone.value * (1 + 1e-6)


@pytest.mark.slow
def test_a_target_that_no_orbit_has_is_refused() -> None:
    found = zo.search_gains(
        "hopper",
        vary={"a": (15.0, 25.0)},
        objective=zo.TargetAmplitude(state="height", target=9.0),
        method=PROGRAM,
    )
    assert found.orbit is None
    assert found.detail.startswith("The program found no optimum")
    with pytest.raises(zo.InputError, match="must be a whole number of turns of the clock"):
        zo.search_gains(
            "clapper", vary={"omega": (0.29, 0.31)}, objective=zo.TargetPeriod(target=24.0)
        )


@pytest.mark.slow
def test_shooting_replaces_an_optimum_that_the_check_refuses() -> None:
    problem, checked = zo.load_problem("hopper"), list[zo.Orbit]()

    def once(orbit: zo.Orbit) -> Verdict:
        checked.append(orbit)
        return Verdict(objection="" if len(checked) > 1 else "refused once")

    found = search_orbits(
        problem,
        problem.values(),
        free={"a": (15.0, 25.0)},
        objective=zo.MinImpactLoss(),
        accept=once,
        settings=zo.SearchSettings(n_starts=0),
    )
    assert found.method is SHOOTING
    assert found.remarks[0].endswith("was refused: refused once")
    assert found.free["a"] == pytest.approx(15.0)


@pytest.mark.slow
def test_every_search_tells_the_optimum_that_it_reached() -> None:
    # The loss is a s, and the bound on v^2 = 2 a s / (1 - e^2) decides: a = 15 and a loss of 1.5.
    asked: dict[str, Any] = {
        "vary": {"a": (5.0, 40.0)},
        "objective": zo.MinImpactLoss(),
        "bounds": [zo.Bound(name="stop.impact_speed", lower=2.0)],
    }
    once = zo.SearchSettings(n_starts=0)
    for method in (PROGRAM, SHOOTING):
        found = zo.search_gains("hopper", **asked, method=method, settings=once)
        (best,) = found.candidates
        assert found.unwrap() == best.orbit
        assert found.status.name == "FOUND"
        assert found.free["a"] == pytest.approx(15.0, rel=1e-8)
        assert found.value == found.worst == pytest.approx(1.5, rel=1e-8)
        assert best.score == pytest.approx(1.5, rel=1e-8)
        assert best.extents["stop.impact_speed"].lowest == pytest.approx(2.0, rel=1e-8)
        assert found.asked[0]["kept"]
        assert found.certificate is not None
        assert found.certificate.asked == found.asked
        assert len(found.attempts) == 1
        assert found.n_orbits > 1


def test_a_refused_orbit_is_no_answer() -> None:
    problem = zo.load_problem("hopper")
    found = search_orbits(
        problem,
        problem.values(),
        free={},
        accept=lambda _: Verdict(objection="It is refused."),
    )
    assert found.orbit is None
    assert found.candidates == ()
    assert (found.status.name, found.attempts[0].detail) == ("NOT_ACCEPTED", "It is refused.")
    with pytest.raises(zo.OrbitNotFoundError, match="were not accepted"):
        found.unwrap()


def test_an_objective_that_a_program_does_not_have_is_refused() -> None:
    with pytest.raises(zo.InputError, match=r"`method` must be shooting or auto.*contraction"):
        zo.search_gains(
            "hopper",
            vary={"a": (5.0, 40.0)},
            objective=zo.MinSpectralRadius(),
            method=PROGRAM,
        )


def test_a_motion_far_from_the_orbit_is_no_orbit_of_the_program() -> None:
    # A row that is not met must show: the period of the task is not the period of the motion.
    problem = zo.load_problem("hopper")
    values = problem.values()
    _, motion = beside(problem, values)
    free = {"a": (19.9, 20.1)}
    task = replace(
        FIXED,
        free=free,
        objective=zo.TargetPeriod(target=2 * motion.period),
        origin={"a": 20.0},
        units={"a": 20.0},
    )
    solved = orbit_by_program(problem, values, motion, task)
    assert not solved.converged
    assert solved.detail
