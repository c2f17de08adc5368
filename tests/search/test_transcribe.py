"""The program of an orbit: true orbits meet its rows, and each row fails for its own reason."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import PERIOD, RELEASE, ZENO_TIME
from tests.support.mechanisms import clocked_oscillator
from zeno_orbits.arrays import Vector
from zeno_orbits.model import HybridDynamics, ParameterValues, Problem, bind
from zeno_orbits.orbits import Cycle, EventSequence, cycles
from zeno_orbits.search import SearchStatus, TranscriptionSettings, orbit_at_gains
from zeno_orbits.search.transcription import transcribe as transcription
from zeno_orbits.search.transcription.closure import closures_of
from zeno_orbits.search.transcription.ipopt import Hessian, IpoptSettings, SolveStatus, solve
from zeno_orbits.search.transcription.nearness import Nearness
from zeno_orbits.search.transcription.phase import PhaseTerms, WrittenPhase
from zeno_orbits.search.transcription.program import NonlinearProgram, ProgramBuilder
from zeno_orbits.search.transcription.transcribe import OrbitTerms, start_block, transcribe
from zeno_orbits.simulation import simulate

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


@pytest.mark.parametrize("free", [{}, {"Kp": (1.0, 6.0), "Kd": (-1.5, -0.4)}])
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


class _Writer:
    """Writes phases of given lengths; what it is asked is kept."""

    def __init__(self, program: ProgramBuilder, *asked: Any) -> None:
        self.program = program
        self.asked = asked
        self.scale = np.array([2.0, 3.0])
        self.phases: list[tuple[str, Any, Any, tuple[int, ...]]] = []
        self.joined: list[tuple[Any, ...]] = []
        self.closed: tuple[Any, ...] = ()
        _Writer.last = self

    last: Any = None

    def rows_before(self, place: int) -> tuple[int, ...]:
        return (10 + place,)

    def phase(self, label: str, phase: Any, closure: Any, rows: tuple[int, ...]) -> WrittenPhase:
        k = len(self.phases)
        self.phases.append((label, phase, closure, rows))
        start = self.program.variable(f"{label}start", [float(k), 0.0])[:, 0]
        self.program.equal(f"{label}row", start[1])
        terms = PhaseTerms(
            label=label,
            start=start,
            flights=(),
            approach_rate=ca.MX(-1.0),
            zeno=None,
            locked=None,
        )
        return WrittenPhase(
            terms=terms,
            end=start + 1,
            rows=(20 + k,),
            limit_time=ca.MX(0.25 * (k + 1)),
            duration=ca.MX(1.0 + k),
            work=ca.MX(10.0**k),
        )

    def join(self, *asked: Any) -> None:
        self.joined.append(asked)
        self.program.equal("join", self.program.variable(f"join {asked[0]}", 0.0))

    def close(self, *asked: Any) -> Any:
        self.closed = asked
        self.program.equal("close", self.program.variable("close", 0.0))
        return "the tangent"


def _put_together(
    problem: Problem,
    monkeypatch: pytest.MonkeyPatch,
    n: int,
    n_closures: int | None = None,
    **free: tuple[float, float],
) -> tuple[OrbitTerms, Any]:
    monkeypatch.setattr(transcription, "PhaseWriter", _Writer)
    cycle: Any = SimpleNamespace(
        phases=tuple(f"phase {k}" for k in range(n)),
        shape=EventSequence.parsed(f"zeno*{n}"),
        start=SimpleNamespace(state="the start"),
    )
    closures: Any = [f"closure {k}" for k in range(n if n_closures is None else n_closures)]
    dynamics: Any = "the dynamics"
    terms = transcribe(
        problem.compiled(),
        problem.values(),
        dynamics=dynamics,
        cycle=cycle,
        closures=closures,
        free=free,
        nearness=Nearness(first={}, sizes={}),
        settings=TranscriptionSettings(),
    )
    return terms, _Writer.last


def test_phases_follow_each_other_in_time_and_their_works_add_up(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    terms, writer = _put_together(problem, monkeypatch, 3, Kp=(1.0, 6.0))
    labels = ["phase 1: ", "phase 2: ", "phase 3: "]
    assert writer.phases == [
        (label, f"phase {k}", f"closure {k}", (10 + k,)) for k, label in enumerate(labels)
    ]
    program = terms.program.build()
    reports = ca.Function("reports", [program.unknowns], list(program.reports.values()))
    told = dict(
        zip(
            program.reports,
            [float(one) for one in reports.call([ca.DM(program.guess)])],
            strict=True,
        )
    )
    assert told == {
        "phase 1: start time": 0.0,
        "phase 1: Zeno time": 0.25,
        "phase 2: start time": 1.0,
        "phase 2: Zeno time": 1.5,
        "phase 3: start time": 3.0,
        "phase 3: Zeno time": 3.75,
        "period": 6.0,
        "electrical work": 111.0,
    }
    assert [float(terms.guessed(one)[0, 0]) for one in (terms.period, terms.electrical_work)] == [
        6.0,
        111.0,
    ]
    # Each phase starts where the one before it ends, where the rows of that one vanish by
    # themselves; the first starts where the last one ends.
    joins = [(label, phase, rows) for label, phase, _, _, rows in writer.joined]
    assert joins == [(labels[1], "phase 1", (20,)), (labels[2], "phase 2", (21,))]
    for k, (_, _, end, start, _) in enumerate(writer.joined):
        assert terms.guessed(ca.horzcat(end, start)).tolist() == [[k + 1.0, k + 1.0], [1.0, 0.0]]
    at, start, end, rows = writer.closed
    assert (at, rows) == ("the start", (22,))
    assert terms.guessed(ca.horzcat(start, end)).tolist() == [[0.0, 3.0], [0.0, 1.0]]
    assert terms.guessed(terms.end).tolist() == [[3.0], [1.0]]
    assert terms.guessed(terms.start).tolist() == [[0.0], [0.0]]
    assert terms.tangent == "the tangent"
    # A motion need not close, and what is free does not move with it.
    assert [one.names for one in terms.motion.equations].count("join") == 2
    assert "close" not in [one.names for one in terms.motion.equations]
    assert [one.name for one in terms.motion.blocks][:2] == ["phase 1: start", "phase 2: start"]
    assert not any(one.name.startswith(("free", "close")) for one in terms.motion.blocks)


def test_a_phase_without_a_closure_is_a_mistake(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ValueError, match="shorter"):
        _put_together(problem, monkeypatch, 2, n_closures=1)


@pytest.mark.parametrize(
    ("name", "box", "size"),
    [
        ("Kp", (1.0, 6.0), 2.5),
        ("Kd", (-900.0, 100.0), 10.0),
        ("Kd", (-90.0, 0.0), 1.0),
    ],
)
def test_a_free_number_has_its_own_size_or_a_hundredth_of_its_range(
    problem: Problem,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    box: tuple[float, float],
    size: float,
) -> None:
    terms, _ = _put_together(problem, monkeypatch, 1, **{name: box})
    program = terms.program.build()
    (place, _) = program.names[f"free {name}"]
    assert program.scales[place] == pytest.approx(size)
    assert program.lower[place] * size == pytest.approx(box[0])
    assert program.upper[place] * size == pytest.approx(box[1])
    values = problem.values()
    assert terms.guessed(terms.p).ravel().tolist() == list(values.vector) == list(terms.numbers)
    assert list(terms.free) == [name]
    # It is the one of the numbers that moves with its unknown.
    moved = terms.guessed(ca.jacobian(terms.p, terms.program.blocks[0].symbol)).ravel()
    assert moved.tolist() == [size * (one == name) for one in values.numbers]


@pytest.mark.parametrize("free", [("Kp",), ("R", "restitution"), ()])
def test_the_law_of_impact_depends_on_what_is_free_only_if_it_does(
    problem: Problem, monkeypatch: pytest.MonkeyPatch, free: tuple[str, ...]
) -> None:
    values = problem.values()
    ranges = {name: (0.5 * values.number(name), 1.5 * values.number(name)) for name in free}
    terms, writer = _put_together(problem, monkeypatch, 1, **ranges)
    law = writer.asked[3]
    assert float(terms.guessed(law.restitution)[0, 0]) == values.number("restitution")
    assert law.restitution.is_constant() is ("restitution" not in free)


@pytest.mark.parametrize(
    ("text", "blocks"),
    [
        ("zeno", ["release state"]),
        ("impact", ["start state"]),
        ("impact,plastic", ["phase 1: release state", "phase 2: start state"]),
        ("zeno*2", ["phase 1: release state", "phase 2: release state"]),
    ],
)
def test_a_phase_starts_at_a_release_if_the_one_before_it_holds(
    text: str, blocks: list[str]
) -> None:
    shape = EventSequence.parsed(text)
    assert [start_block(shape, k) for k in range(shape.n_phases)] == blocks
