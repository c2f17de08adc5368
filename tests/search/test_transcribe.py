"""The program of an orbit: true orbits meet its rows, and each row fails for its own reason."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import PERIOD, RELEASE, ZENO_TIME
from tests.support.cases import fast
from tests.support.mechanisms import clocked_oscillator, forced_oscillator, oscillator_state
from zeno_orbits.arrays import Vector
from zeno_orbits.model import HybridDynamics, ParameterValues, Problem, bind
from zeno_orbits.orbits import Cycle, cycles
from zeno_orbits.search import SearchStatus, TranscriptionSettings, orbit_at_gains
from zeno_orbits.search.transcription.closure import Closure, closure_of, closures_of
from zeno_orbits.search.transcription.ipopt import Hessian, IpoptSettings, SolveStatus, solve
from zeno_orbits.search.transcription.nearness import Nearness
from zeno_orbits.search.transcription.program import NonlinearProgram
from zeno_orbits.search.transcription.transcribe import transcribe
from zeno_orbits.simulation import estimate_tail, extrapolate, simulate

MESH = 1e-7
VISIBLE = 20 * MESH
"""A condition counts as violated above this; meshes leave about their tolerance."""


@pytest.fixture(name="cycle", scope="module")
def _cycle(machine: HybridDynamics) -> Cycle:
    start = np.array(RELEASE)
    (cycle,) = cycles(simulate(machine, start, until=1.5 * PERIOD), start=start)
    return cycle


def _program(
    problem: Problem,
    values: ParameterValues,
    cycle: Cycle,
    *,
    mesh_tolerance: float = MESH,
    free: Mapping[str, tuple[float, float]] | None = None,
) -> NonlinearProgram:
    compiled = problem.compiled()
    dynamics = bind(compiled, values.vector)
    settings = TranscriptionSettings(mesh_tolerance=mesh_tolerance)
    terms = transcribe(
        compiled,
        values,
        dynamics=dynamics,
        cycle=cycle,
        closures=closures_of(cycle, dynamics, settings.closure_tolerance),
        free=free or {},
        nearness=Nearness(first={}, sizes={}),
        settings=settings,
    )
    return terms.program.build()


@pytest.fixture(name="program", scope="module")
def _made(problem: Problem, cycle: Cycle) -> NonlinearProgram:
    return _program(problem, problem.values(), cycle)


def _violations(program: NonlinearProgram, scaled: Vector) -> dict[str, float]:
    rows = ca.Function("rows", [program.unknowns], [program.rows])(scaled).full().ravel()
    sizes = np.maximum(program.row_lower - rows, rows - program.row_upper)
    found: dict[str, float] = {}
    for name, size in zip(program.row_names, sizes, strict=True):
        found[name] = max(found.get(name, 0.0), float(size))
    return found


def _violated(program: NonlinearProgram, block: str, entry: int, change: float = 1e-3) -> set[str]:
    """Return the rows that fail when one entry of a block of the guess is changed (scaled).

    Args:
        program: The program.
        block: Name of the block.
        entry: Place in the block, column by column; negative from its end.
        change: Change in units of the scale.
    """
    start, (n_rows, n_columns) = program.names[block]
    scaled = program.guess.copy()
    scaled[start + entry % (n_rows * n_columns)] += change
    return {name for name, size in _violations(program, scaled).items() if size > VISIBLE}


@pytest.mark.parametrize("tolerance", [1e-5, 1e-7, 1e-9])
def test_a_simulated_period_meets_every_condition_to_the_accuracy_of_its_mesh(
    problem: Problem, cycle: Cycle, tolerance: float
) -> None:
    program = _program(problem, problem.values(), cycle, mesh_tolerance=tolerance)
    assert max(_violations(program, program.guess).values()) < 2 * tolerance


@pytest.mark.parametrize("free", fast(1, [{}, {"Kp": (1.0, 6.0), "Kd": (-1.5, -0.4)}]))
def test_the_jacobian_by_the_chain_rule_is_that_of_the_whole_graph(
    free: dict[str, tuple[float, float]], problem: Problem, cycle: Cycle
) -> None:
    program = _program(problem, problem.values(), cycle, free=free)
    plain = ca.jacobian(program.rows, program.unknowns)
    both = ca.Function("both", [program.unknowns], [program.jacobian, plain])
    # Off the guess, so that no entry vanishes by the orbit's own symmetry.
    ours, theirs = both(program.guess * (1 + 1e-3 * np.sin(np.arange(len(program.guess)))))
    largest = float(ca.norm_inf(ca.vec(theirs)))
    # An entry is a sum of some hundred products.
    assert float(ca.norm_inf(ca.vec(ours - theirs))) < 100 * np.finfo(np.float64).eps * largest
    # A gain left out of the chain rule would show: its column is far above rounding.
    assert all(np.max(np.abs(theirs[:, k].full())) > 1e-6 for k in range(len(free)))


def test_at_fixed_gains_there_are_as_many_equations_as_unknowns(program: NonlinearProgram) -> None:
    equations = int(np.sum(program.row_lower == program.row_upper))
    assert equations == program.unknowns.numel() == len(program.guess)


def test_every_free_gain_is_one_unknown_more(
    problem: Problem, cycle: Cycle, program: NonlinearProgram
) -> None:
    box = {"Kp": (1.0, 6.0), "Kd": (-1.5, -0.4)}
    wider = _program(problem, problem.values(), cycle, free=box)
    assert len(wider.guess) == len(program.guess) + 2
    for name, (lower, upper) in box.items():
        (place, _) = wider.names[f"free {name}"]
        scale = wider.scales[place]
        assert wider.lower[place] * scale == pytest.approx(lower)
        assert wider.upper[place] * scale == pytest.approx(upper)
        assert wider.guess[place] * scale == pytest.approx(problem.values().gains[name])


def test_rows_speak_of_flights_impacts_and_the_release(program: NonlinearProgram) -> None:
    assert {
        "continuity[flight 0, interval 0]",
        "continuity[flight 2, interval 1]",
        "continuity[locked, interval 0]",
        "gap closes at impact 1",
        "gap closes at impact 3",
        "restitution at impact 2",
        "release: gap = 0",
        "release: gap rate = 0",
        "release: multiplier = 0",
        "release: multiplier falls",
        "Zeno point",
        "Zeno point: d2h/dt2 < 0",
        "the orbit closes",
        "gap >= 0 in flight 0",
        "multiplier >= 0 on the stop",
    } <= set(program.row_names)


START = "continuity[flight 0, interval 0]"


@pytest.mark.parametrize(
    ("state", "rows"),
    [
        ("theta1", {START, "release: multiplier = 0", "the orbit closes"}),
        ("theta2", {START, "release: gap = 0", "release: multiplier = 0"}),
        ("dtheta1", {START, "the orbit closes"}),
        ("dtheta2", {START, "release: gap rate = 0"}),
        ("current", {START, "release: multiplier = 0", "the orbit closes"}),
    ],
)
def test_another_release_state_violates_the_conditions_that_it_enters(
    program: NonlinearProgram, problem: Problem, state: str, rows: set[str]
) -> None:
    assert _violated(program, "release state", problem.state_names.index(state)) == rows


@pytest.mark.parametrize("entry", range(5))
def test_another_zeno_state_is_not_the_limit_of_the_impacts(
    program: NonlinearProgram, entry: int
) -> None:
    expected = {"Zeno point", "continuity[locked, interval 0]"}
    assert _violated(program, "Zeno state", entry) == expected


def test_another_speed_after_an_impact_breaks_the_law_of_restitution(
    program: NonlinearProgram,
) -> None:
    rows = _violated(program, "speed after impact 3", 0)
    assert "restitution at impact 3" in rows
    assert "continuity[flight 3, interval 0]" in rows
    assert not any("flight 2" in name for name in rows)


def test_a_flight_that_ends_off_the_stop_is_named(program: NonlinearProgram) -> None:
    # The last stage of a rescaled flight ends with gap and gap rate.
    assert "gap closes at impact 3" in _violated(program, "flight 2 stages", -2)
    assert "restitution at impact 3" in _violated(program, "flight 2 stages", -1)
    assert "gap closes at impact 1" in _violated(program, "flight 0 stages", -4)


def test_a_flight_of_another_length_breaks_its_continuity_only(program: NonlinearProgram) -> None:
    for arc in ("flight 0", "flight 2", "locked"):
        rows = _violated(program, f"{arc} duration", 0)
        assert rows
        assert all(name.startswith(f"continuity[{arc}, ") for name in rows)


def test_a_locked_arc_that_ends_elsewhere_does_not_close(program: NonlinearProgram) -> None:
    # dtheta1 of the last stage.
    assert "the orbit closes" in _violated(program, "locked stages", -3)


def test_a_flight_through_the_stop_is_named(program: NonlinearProgram) -> None:
    rows = _violated(program, "flight 0 stages", 5 * 30 + 1, change=-5.0)
    assert "gap >= 0 in flight 0" in rows


def test_the_program_comes_back_to_the_declared_orbit(program: NonlinearProgram) -> None:
    off = program.guess * (1 + 1e-4)
    nudged = NonlinearProgram(
        **{name: getattr(program, name) for name in program.__slots__} | {"guess": off}
    )
    solution = solve(nudged, IpoptSettings(hessian=Hessian.LIMITED_MEMORY))
    assert solution.status is SolveStatus.SOLVED
    # The mesh tolerance bounds the polynomials between stages; ends of intervals are better.
    assert solution.values["period"][0, 0] == pytest.approx(PERIOD, abs=MESH)
    assert solution.values["Zeno time"][0, 0] == pytest.approx(ZENO_TIME, abs=MESH)
    assert max(solution.residuals.values()) < 1e-9


# A problem without motors.


@pytest.mark.parametrize("attracting", [True, False])
def test_the_orbit_of_the_forced_oscillator_is_found(attracting: bool) -> None:
    # Where the clock does not attract, every amplitude of it has its own orbit and the program is
    # singular; it is solved all the same, near its guess.
    problem = clocked_oscillator(FORCED, attracting=attracting)
    result = orbit_at_gains(problem, problem.values())
    assert result.status is SearchStatus.FOUND
    found = result.unwrap()
    # The loose settling drifts along the neutral amplitude, by 1e-8 a second for up to 200 s; the
    # times and states of the orbit follow the amplitude with a factor below 10.
    accuracy = 1e-9 if attracting else 10 * 200 * 1e-8
    assert found.period == pytest.approx(2 * np.pi, abs=1e-9)
    assert found.release_state["y"] == pytest.approx(FORCED.stop, abs=accuracy)
    assert found.release_state["dy"] == pytest.approx(-0.6, abs=accuracy)
    exact = FORCED.zeno_time() - FORCED.release_time
    assert found.zeno_time == pytest.approx(exact, abs=accuracy)
    for impact, (time, approach) in zip(found.impacts, FORCED.impacts(), strict=False):
        assert impact.time == pytest.approx(time - FORCED.release_time, abs=accuracy)
        assert impact.state_minus["dx"] == pytest.approx(approach, abs=accuracy)


# How phases are put together, told by phases that are given.

ACCURACY = 1e-11


@pytest.fixture(name="oscillator", scope="module")
def _oscillator() -> HybridDynamics:
    return forced_oscillator(FORCED, FORCED.restitution)


@pytest.fixture(name="turn", scope="module")
def _turn(oscillator: HybridDynamics) -> Cycle:
    start = oscillator_state(0.0, FORCED.stop, 0.0)
    return cycles(simulate(oscillator, start, until=2.5 * math.tau))[0]


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-7, 1e-9, 1e-11])
def test_a_closure_has_the_fewest_impacts_for_its_tolerance(
    oscillator: HybridDynamics, turn: Cycle, tolerance: float
) -> None:
    closure = closure_of(turn.impacts, oscillator, tolerance)
    assert closure.error <= tolerance
    for n in range(1, closure.n_impacts):
        fewer = closure_of(turn.impacts[:n], oscillator, tolerance)
        assert fewer.error > tolerance
    assert closure.nodes[-1] == closure.n_impacts - 1
    assert list(closure.nodes) == sorted(set(closure.nodes))


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10])
def test_the_error_of_a_closure_bounds_the_true_one(
    oscillator: HybridDynamics, turn: Cycle, tolerance: float
) -> None:
    closure = closure_of(turn.impacts, oscillator, tolerance)
    estimates = []
    for k in closure.nodes:
        impact = turn.impacts[k]
        speed = -oscillator.restitution * impact.approach_rate
        estimate = estimate_tail(oscillator, impact.time, impact.state_plus, speed)
        assert estimate is not None
        estimates.append(estimate)
    limit = extrapolate(oscillator, estimates)
    exact = FORCED.zeno_time()
    assert abs(limit.time - exact) <= closure.error * (1 + exact) + ACCURACY
    point = np.array(oscillator_state(exact, FORCED.stop, 0.0))
    assert np.all(np.abs(limit.state - point) <= closure.error * (1 + np.abs(point)) + ACCURACY)


def test_a_tolerance_that_nothing_reaches_takes_all_impacts(
    oscillator: HybridDynamics, turn: Cycle
) -> None:
    closure = closure_of(turn.impacts, oscillator, 0.0)
    assert closure.n_impacts == len(turn.impacts)


def test_a_plastic_impact_closes_alone(problem: Problem) -> None:
    values = problem.values(parameters={"restitution": 0.0})
    plastic = problem.dynamics(values)
    run = simulate(plastic, RELEASE, until=6.0)
    cycle = cycles(run)[-1]
    assert cycle.rescaled_flights == ()
    closure = closure_of(cycle.impacts, plastic, 1e-12)
    assert closure.n_impacts == 1
    assert closure.nodes == (0,)
    assert closure.error == 0.0


# Which impacts are taken, told by estimates that are given.


def test_each_phase_has_its_closure_and_an_impact_that_does_not_hold_closes_exactly(
    oscillator: HybridDynamics, turn: Cycle
) -> None:
    (held,) = turn.phases
    let_go = replace(held, zeno=None, locked=None)
    cycle: Any = SimpleNamespace(phases=(held, let_go, held))
    expected = closure_of(turn.impacts, oscillator, 1e-7)
    alone = Closure(n_impacts=1, nodes=(), error=0.0)
    assert closures_of(cycle, oscillator, 1e-7) == (expected, alone, expected)
