"""Formulas compiled for one problem give the digits of its tapes, in every bit."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.loop.agreement import needs_compiler, task_of
from tests.support.commands import NO, YES, ask
from tests.support.one_stop import one_stop_problems
from zeno_orbits import HybridLagrangian, hybrid_system, no_drive
from zeno_orbits.integrators import Automatic, Radau, RungeKutta, Tolerance
from zeno_orbits.loop import (
    LoopRun,
    Program,
    binding,
    filled,
    loop_library,
    machine_source,
    program_of,
)
from zeno_orbits.model import CompiledSystem, bind, compile_system
from zeno_orbits.simulation import (
    SimulationSettings,
    SimulationTask,
    event_name,
    run_settings,
    state_after,
)
from zeno_orbits.simulation.compiled.programs import graph_program

pytestmark = [needs_compiler, pytest.mark.usefixtures("own_cache")]

ENGINES = (Automatic(), RungeKutta(), Radau())
ACCURACIES = (1e-5, 1e-9)


@pytest.fixture(scope="module")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep formulas that are compiled in a folder of these tests' own."""
    assert loop_library() is not None
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ZENO_ORBITS_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.delenv("ZENO_ORBITS_LOOP", raising=False)
        yield


@dataclass(frozen=True, kw_only=True)
class Both:
    """The programs of the same formulas, by tapes and compiled."""

    tapes: Program
    compiled: Program


def _both(system: CompiledSystem) -> Both:
    library = loop_library()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ZENO_ORBITS_LOOP", "tape")
        tapes = Program(library, system)
    compiled = Program(library, system)
    compiled.compile()
    assert compiled.is_compiled
    assert not tapes.is_compiled
    return Both(tapes=tapes, compiled=compiled)


def _followed(program: Program, task: SimulationTask) -> tuple[list[int], list[bytes]]:
    """Return every status of a run, and the bytes of all that it recorded."""
    formulas = task.graph.first.formulas
    assert formulas is not None
    run = LoopRun(program, filled(run_settings(task)), formulas.values, task.state)
    statuses: list[int] = []
    while not statuses or statuses[-1] in (binding.FULL, binding.CURVE):
        statuses.append(run.resume())
        if statuses[-1] == binding.CURVE:
            run.answer(None)
    record = run.record()
    # Only flights fill the last two entries of a state, and only implicit steps all of a row.
    n = program.n_x
    parts = (
        record.steps[:, : binding.STEP_WIDTH + n],
        record.polynomials[:, : binding.STAGES * n],
        record.arcs[:, : binding.ARC_WIDTH + 2 * n],
        record.events,
    )
    return statuses, [part.tobytes() for part in parts]


def _tasks(name: str, until: float) -> Sequence[SimulationTask]:
    problem = zo.load_problem(name)
    return [
        task_of(
            problem,
            until=until,
            start=start,
            settings=SimulationSettings(
                engine=engine, tolerance=Tolerance(relative=accuracy, absolute=accuracy / 10)
            ),
        )
        for start in range(len(problem.starts))
        for engine in ENGINES
        for accuracy in ACCURACIES
    ]


def _ball_in_everything() -> SimulationTask:
    """Return a ball under a force that holds every operation, of which many call functions.

    Operations with a jump or a kink act on a parameter: of the states they are events.
    """
    q, v, k = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("k")
    small = q / (1 + q**2)
    smooth = [
        *(f(small) for f in (ca.sin, ca.cos, ca.tan, ca.asin, ca.acos, ca.atan, ca.sinh, ca.cosh)),
        *(f(small) for f in (ca.tanh, ca.asinh, ca.atanh, ca.exp, ca.expm1, ca.log1p, ca.erf)),
        *(ca.acosh(1.5 + q**2), ca.log(2 + q), ca.sqrt(1 + v**2), 1 / (2 + q), ca.hypot(q, 1 + v)),
        *(2 * v, -q * v, q * v - v**2, q - v * q, (1 + v**2) ** (0.5 + q**2)),
    ]
    others = [
        *(f(10 * k) for f in (ca.fabs, ca.sign, ca.floor, ca.ceil)),
        *(ca.fabs(k) ** 2.5, ca.atan2(k, -0.2), ca.fmin(k, 0.3), ca.fmax(k, -0.2)),
        *(ca.fmod(k, 0.25), ca.copysign(k, -1 - k), ca.remainder(k, 0.3)),
        *(ca.if_else(k < 0.2, k, 1), ca.if_else(k <= 0.37, 1, k)),
        *(ca.logic_and(k > 0, k > 0.1), ca.logic_or(k > 0.4, k > 0.2), ca.logic_not(k > 0.1)),
    ]
    parts = [*smooth, *(part * v for part in others)]
    weights = np.random.default_rng(5).uniform(-0.05, 0.05, len(parts))
    force = sum((w * part for w, part in zip(weights.tolist(), parts, strict=True)), ca.SX(0))
    ball = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=v**2 / 2, potential=9.81 * q, gap=q, passive_force=force
    )
    system = hybrid_system(ball, no_drive(ball), ca.SX(0.6))
    dynamics = bind(compile_system(system, {"k": k}, ("q", "v")), (0.37,))
    return SimulationTask(dynamics=dynamics, state=np.array([0.5, 0.1]), until=1.5)


@pytest.mark.slow
@pytest.mark.parametrize("engine", [RungeKutta(), Radau()])
def test_every_operation_gives_the_same_bits(engine: RungeKutta | Radau) -> None:
    task = replace(_ball_in_everything(), settings=SimulationSettings(engine=engine))
    assert task.graph.first.formulas is not None
    both = _both(task.graph.first.formulas.system)
    statuses, parts = _followed(both.compiled, task)
    assert (statuses, parts) == _followed(both.tapes, task)
    assert all(parts[k] for k in (0, 2, 3))
    assert bool(parts[1]) == isinstance(engine, Radau)


@pytest.mark.slow
def test_compiled_formulas_are_found_by_later_programs_of_the_same_problem(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    zo.compile_problem("bouncing_ball")
    library, system = loop_library(), zo.load_problem("bouncing_ball").compiled()
    program = program_of(system)
    assert program is not None
    assert program.is_compiled
    assert Program(library, system).is_compiled
    assert not Program(library, zo.load_problem("vibrating_table").compiled()).is_compiled
    monkeypatch.setenv("ZENO_ORBITS_LOOP", "tape")
    assert not Program(library, system).is_compiled


@pytest.mark.slow
def test_formulas_that_are_compiled_in_the_middle_of_a_run_carry_it_on() -> None:
    task = _tasks("bouncing_ball", 2.0)[0]
    assert task.graph.first.formulas is not None
    program = _both(task.graph.first.formulas.system).tapes
    expected = _followed(program, task)[1][3]
    run = LoopRun(program, filled(run_settings(task)), task.graph.first.formulas.values, task.state)
    assert run.resume(events=6, arcs=3) == binding.FULL
    program.compile()
    assert program.is_compiled
    while run.resume(events=6, arcs=3) == binding.FULL:
        pass
    assert run.record().events.tobytes() == expected


def test_a_cache_that_cannot_be_written_is_reported_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "taken").write_text("", encoding="utf-8")
    monkeypatch.setenv("ZENO_ORBITS_CACHE", str(tmp_path / "taken"))
    with pytest.raises(
        zo.InputError, match=r"The formulas of `torque_pendulum` are not compiled: .*taken"
    ):
        zo.compile_problem("torque_pendulum")
    answer = ask("cache", "--compile", "torque_pendulum", "--json")
    assert answer.code == NO
    assert "the formulas of `torque_pendulum` are not compiled" in answer.out


@pytest.mark.slow
def test_the_command_compiles_a_problem() -> None:
    assert ask("cache", "--compile", "bouncing_ball").code == YES
    program = program_of(zo.load_problem("bouncing_ball").compiled())
    assert program is not None
    assert program.is_compiled


@pytest.mark.slow
@pytest.mark.parametrize("name", list(one_stop_problems())[::3])
def test_compiled_formulas_of_every_bundled_problem_give_the_same_bits(name: str) -> None:
    both = _both(zo.load_problem(name).compiled())
    for task in _tasks(name, 2.0):
        assert _followed(both.compiled, task) == _followed(both.tapes, task)


def _events(problem: zo.Problem, until: float) -> list[tuple[str, float, list[float]]]:
    run = zo.simulate(problem, until=until)
    return [(event_name(one), one.time, state_after(one).tolist()) for one in run.events]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clapper", "kneed_walker", "relay"])
def test_compiled_formulas_of_all_modes_give_the_same_bits(name: str) -> None:
    problem = zo.load_problem(name)
    expected = _events(problem, 3.0)
    assert expected
    zo.compile_problem(problem)
    graph = graph_program(problem.compiled_graph())
    assert not isinstance(graph, str)
    assert graph.is_compiled
    assert _events(problem, 3.0) == expected


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hopper", "limited_pendulum"])
def test_a_mode_that_the_compiled_library_lacks_is_carried_out_by_tape(name: str) -> None:
    problem = zo.load_problem(name)
    expected = _events(problem, 3.0)
    graph = graph_program(problem.compiled_graph())
    assert not isinstance(graph, str)
    assert len(graph.views) > 1
    graph.compile(list(graph.views.values())[:1])
    assert graph.is_compiled
    assert _events(problem, 3.0) == expected


@pytest.mark.slow
def test_threads_share_compiled_formulas() -> None:
    both = _both(zo.load_problem("motor_pendulum").compiled())
    tasks = _tasks("motor_pendulum", 1.0)
    with ThreadPoolExecutor(4) as pool:
        threads = list(pool.map(lambda task: _followed(both.compiled, task), [*tasks] * 3))
    expected = [_followed(both.tapes, task) for task in tasks]
    assert threads == expected * 3


@pytest.mark.slow
def test_generated_code_is_strict_c99(tmp_path: Path) -> None:
    formulas = _ball_in_everything().dynamics.formulas
    assert formulas is not None
    program = program_of(formulas.system)
    assert program is not None
    code = tmp_path / "loop.c"
    code.write_text(
        machine_source(program.n_x, {1: program.tapes, 2: program.tapes}), encoding="utf-8"
    )
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1", "-ffp-contract=off"]
    words = ["cc", *flags, "-c", str(code), "-o", str(tmp_path / "loop.o")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
