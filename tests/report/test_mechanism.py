"""Mechanism and circuit, drawn from the problem: every element that the equations have."""

from __future__ import annotations

import numpy as np
import pytest

from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem, load_problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.report import plots
from zeno_orbits.simulation import Execution, simulate


def elements(name: str) -> list[list[str]]:
    """Return the kinds of the elements of each loop of a problem."""
    return [
        [one.kind.value for one in loop.elements]
        for loop in plots.circuit_loops(load_problem(name))
    ]


def one_second(problem: Problem) -> Execution:
    start = problem.state_vector(dict(problem.starts[0]))
    return simulate(problem.dynamics(problem.values()), start, until=1.0)


def test_a_motor_is_a_loop_of_source_resistance_inductance_and_motor() -> None:
    whole = ["source", "resistance", "inductance", "motor"]
    assert elements("motor_pendulum") == [whole]
    assert elements("two_motors") == [whole, whole]


def test_a_filter_is_a_loop_of_its_own_that_shares_its_capacitor() -> None:
    filtered = load_problem("filtered_pendulum")
    feed, motor = plots.circuit_loops(filtered)
    assert [one.kind.value for one in feed.elements] == [
        *("source", "resistance", "inductance", "capacitor")
    ]
    # The motor is fed by the capacitor alone.
    assert [one.kind.value for one in motor.elements] == [
        *("resistance", "inductance", "capacitor", "motor")
    ]
    assert feed.elements[-1] == motor.elements[2]


def test_an_inductance_that_moves_is_the_machine_itself() -> None:
    (loop,) = plots.circuit_loops(load_problem("solenoid"))
    assert [one.kind.value for one in loop.elements] == ["source", "resistance", "inductance"]
    assert loop.elements[-1].label == "$L(q)$"


def test_the_release_is_drawn_before_the_rest_of_the_period(problem: Problem, orbit: Orbit) -> None:
    values = orbit.values(problem)
    start = problem.state_vector(orbit.start_state)
    run = simulate(problem.dynamics(values), start, until=1.01 * orbit.period)
    mechanism, circuit = plots.plot_mechanism(problem, values, run, orbit.period).axes
    front = max(line.get_zorder() for line in mechanism.lines)
    ends = [
        np.asarray(line.get_xydata())[-1] for line in mechanism.lines if line.get_zorder() == front
    ]
    drawn = problem.drawn_lines(values, run.state_at(0.0)[None, :])
    lasts = [lines[0][-1] for lines in drawn.values()]
    assert len(ends) == len(lasts)
    assert all(any(end == pytest.approx(last) for last in lasts) for end in ends)
    assert {"$V$", "$R$", "$L$", "M"} <= {text.get_text() for text in circuit.texts}


def test_a_problem_without_drawing_and_circuit_is_refused() -> None:
    ball = load_problem("relief_valve")
    assert ball.drawing is None
    with pytest.raises(InputError, match=r"must have a drawing or a circuit, but `relief_valve`"):
        plots.plot_mechanism(ball, ball.values(), one_second(ball), 1.0)
