"""Orbits that the loop closes: closed forms, the reference in Python, and what is left to it."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.loop.agreement import needs_compiler
from tests.support import antidamped_spring as spring
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.loop import ClosedRecord
from zeno_orbits.maps import Accuracy, Attractor, attractors_at, newton
from zeno_orbits.model import GraphDynamics, Problem, load_problem
from zeno_orbits.orbits import SectionMode, closed_return, extrapolated, near_return
from zeno_orbits.simulation import SimulationTask, closed_by_loop, simulate, transient_settings

pytestmark = needs_compiler

TRANSIENT = transient_settings(1e-10)
SETTINGS = replace(TRANSIENT, completion=extrapolated(TRANSIENT))
ERROR = 1e-8
"""Error of a period by steps of a local error of 1e-10, with the growth of the orbits below."""


def closed(
    graph: GraphDynamics, x: Vector, section: str, n_returns: int, guess: float
) -> ClosedRecord | None:
    """Return the orbit near a start by the loop."""
    task = SimulationTask(dynamics=graph, state=x, until=guess, settings=SETTINGS)
    found = closed_by_loop(task, section=section, n_returns=n_returns, guess=guess, exact=1e-9)
    return None if found is None else found[0]


def orbit_of_spring(a: float, weight: float, restitution: float) -> tuple[float, float]:
    """Return speed and period of the orbit at the threshold, by its closed form."""
    speed, w = spring.threshold(a, weight, restitution), math.sqrt(1 - a * a)

    def place(t: float) -> float:
        b = (speed - a * weight) / w
        return -weight + math.exp(a * t) * (weight * math.cos(w * t) + b * math.sin(w * t))

    top = brentq(lambda t: place(t + 1e-7) - place(t - 1e-7), 1e-6, math.pi / w)
    return speed, brentq(place, top, top + math.pi / w, xtol=1e-15, rtol=1e-14)


@pytest.mark.parametrize("values", spring.SETS[:5])
def test_an_orbit_of_one_impact_has_its_closed_form_also_if_it_repels(
    values: tuple[float, float, float],
) -> None:
    speed, period = orbit_of_spring(*values)
    graph = spring.PROBLEM.graph_dynamics(spring.PROBLEM.values(parameters=spring.numbers(*values)))
    found = closed(graph, np.array([0.0, 1.004 * speed]), "impact stop", 1, 1.01 * period)
    assert found is not None
    assert found.start == pytest.approx([0.0, speed], rel=ERROR, abs=1e-15)
    assert found.period == pytest.approx(period, rel=ERROR)
    # By Liouville's formula: a flight stretches v dv by e^(2 a T), and the impact speeds by e.
    a, _, e = values
    assert found.by_state[1, 1] == pytest.approx(e**2 * math.exp(2 * a * period), rel=100 * ERROR)


def settled(problem: Problem, section: str, until: float) -> tuple[GraphDynamics, Vector, float]:
    """Return a state of a section near the orbit of a motion, and about the period."""
    graph = problem.graph_dynamics(problem.values())
    start = np.array(problem.state_vector(problem.starts[0]))
    motion = simulate(graph, start, until=until, settings=TRANSIENT)
    near = near_return(motion, graph, section)
    assert near.n_returns == 1
    return graph, np.asarray(near.state), near.period


@pytest.mark.parametrize(
    ("name", "section", "until"),
    [
        ("motor_pendulum", "release stop", 12.0),
        ("motor_pendulum", "zeno stop", 12.0),
        ("relief_valve", "release stop", 60.0),
    ],
)
def test_the_loop_and_the_reference_close_one_return(name: str, section: str, until: float) -> None:
    graph, x, period = settled(load_problem(name), section, until)
    found = closed(graph, x, section, 1, period)
    other = closed_return(
        graph,
        x,
        section=section,
        n_returns=1,
        guess=period,
        settings=SETTINGS,
        is_near=True,
        exact=1e-9,
    )
    assert found is not None
    assert found.start == pytest.approx(other.start, rel=ERROR, abs=ERROR)
    assert found.end == pytest.approx(other.end, rel=ERROR, abs=ERROR)
    assert found.period == pytest.approx(other.period, rel=ERROR)
    assert found.by_state == pytest.approx(other.by_state, rel=1e-6, abs=1e-6)
    assert len(found.events) == len(other.events)
    # Memory is used again: another return in between changes no bit.
    closed(graph, 1.001 * x, section, 1, period)
    again = closed(graph, x, section, 1, period)
    assert again is not None
    for field in fields(found):
        assert np.array_equal(getattr(found, field.name), getattr(again, field.name)), field.name


def test_a_motion_that_does_not_return_has_no_orbit() -> None:
    graph = spring.PROBLEM.graph_dynamics(spring.PROBLEM.values())
    speed, period = orbit_of_spring(0.1, 1.0, 0.8)
    # It comes to rest before so many impacts are resolved.
    with pytest.raises(SimulationError, match="does not converge"):
        closed(graph, np.array([0.0, 0.1 * speed]), "impact stop", 500, period)


def test_what_is_unusual_is_left_to_the_reference() -> None:
    speed, period = orbit_of_spring(0.1, 1.0, 0.8)
    # A clock, two stops, another event than that of a stop.
    lifted = spring.LIFTED.graph_dynamics(spring.LIFTED.values())
    assert closed(lifted, np.array([0.0, speed, 1.0, 0.0]), "impact stop", 1, period) is None
    clapper = load_problem("clapper")
    two = clapper.graph_dynamics(clapper.values())
    start = np.array(clapper.state_vector(clapper.starts[0]))
    assert closed(two, start, f"impact {two.stop_names[0]}", 1, 1.0) is None
    graph = spring.PROBLEM.graph_dynamics(spring.PROBLEM.values())
    assert closed(graph, np.array([0.0, speed]), "switch any", 1, period) is None
    with pytest.raises(SimulationError):
        closed(graph, np.array([0.0, np.nan]), "impact stop", 1, period)


def points_by(problem: Problem, values: list[dict[str, float]]) -> tuple[Attractor, ...]:
    settings = [problem.values(gains=one) for one in values]
    return attractors_at(problem, settings)


def by_reference(*_: Any, **__: Any) -> None:
    """Leave an orbit to the reference."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("motor_pendulum", [{"Kp": kp, "Kd": kd} for kp in (1.5, 2.5, 4.4) for kd in (-1.7, -0.9)]),
        ("relief_valve", [{"q": q} for q in (0.2, 0.6, 2.0, 5.0, 7.0)]),
    ],
)
def test_a_map_is_the_same_on_both_roads(
    name: str, values: list[dict[str, float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = load_problem(name)
    told = list[bool]()
    by_loop = newton.orbit_by_loop

    def counted(*arguments: Any, **named: Any) -> Any:
        found = by_loop(*arguments, **named)
        told.append(found is not None)
        return found

    monkeypatch.setattr(newton, "orbit_by_loop", counted)
    fast = points_by(problem, values)
    assert any(told)
    monkeypatch.setattr(newton, "orbit_by_loop", by_reference)
    for one, other in zip(fast, points_by(problem, values), strict=True):
        assert (one.fate, one.returns, one.sequence) == (other.fate, other.returns, other.sequence)
        assert one.period == pytest.approx(other.period, rel=1e-11, nan_ok=True)
        assert one.state == pytest.approx(other.state, rel=1e-9, abs=1e-11)
        assert one.margins == pytest.approx(other.margins, rel=1e-7)
        assert len(one.multipliers) == len(other.multipliers)
        assert np.array(one.multipliers) == pytest.approx(np.array(other.multipliers), abs=1e-7)


def test_a_period_is_the_shortest_one() -> None:
    problem = load_problem("motor_pendulum")
    graph, x, period = settled(problem, "release stop", 12.0)
    once = closed(graph, x, "release stop", 1, period)
    twice = closed(graph, x, "release stop", 2, 2 * period)
    assert once is not None
    assert twice is not None
    assert twice.period == pytest.approx(2 * once.period, rel=ERROR)
    accuracy = Accuracy()
    mode = SectionMode(closed=(), sides=(), stop="", released="stop")
    near = newton.orbit_near(
        graph,
        x,
        section="release stop",
        n_returns=2,
        guess=2 * period,
        mode=mode,
        accuracy=accuracy,
        starts=("release stop",),
    )
    assert near is not None
    assert near.n_returns == 1
    assert near.attractor.period == pytest.approx(once.period, rel=ERROR)
    assert near.attractor.sequence == ("zeno stop", "release stop")
