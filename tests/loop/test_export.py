"""An exported problem, compiled and run without Python, gives the execution of `simulate`."""

from __future__ import annotations

import math
import subprocess
from pathlib import Path

import pytest

import zeno_orbits as zo
from tests.loop.agreement import needs_compiler
from tests.support.cases import fast
from tests.support.commands import MISUSE, YES, ask
from tests.support.nested_kinks import half_periods, nested_problem
from tests.support.one_stop import GRAPHS
from zeno_orbits.loop import binding
from zeno_orbits.orbits import orbit_event_name
from zeno_orbits.simulation import simulate, state_after

pytestmark = [needs_compiler, pytest.mark.usefixtures("here")]

STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a folder of the test's own."""
    monkeypatch.chdir(tmp_path)


def _events_of(name: str, *options: str, level: str = "-O1") -> list[tuple[str, list[float]]]:
    """Return what the example program prints: kind and name, time and state, of every event."""
    answer = ask("export", name, "-o", "exported", *options)
    assert answer.code == YES, answer.err
    stem = next(Path("exported").glob("*.h")).stem
    words = ["cc", *STRICT, level, "exported/main.c", f"exported/{stem}.c", "-o", "program", "-lm"]
    compiled = subprocess.run(words, capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stderr
    # No variable of Python, nor any other, is there.
    run = subprocess.run(["./program"], capture_output=True, text=True, check=False, env={})
    assert run.returncode == 0, run.stderr
    n = 1 + len(zo.load_problem(name).state_names)
    rows = [line.split() for line in run.stdout.splitlines()]
    return [(" ".join(row[:-n]), [float(number) for number in row[-n:]]) for row in rows]


def _expected(name: str, until: float, **numbers: float) -> list[tuple[str, list[float]]]:
    problem = zo.load_problem(name)
    values = problem.values(numbers=numbers)
    run = simulate(
        problem.graph_dynamics(values), problem.state_vector(problem.starts[0]), until=until
    )
    return [
        (orbit_event_name(event), [event.time, *state_after(event).tolist()])
        for event in run.events
    ]


@pytest.mark.slow
def test_a_sequence_of_many_impacts_runs_to_its_end() -> None:
    # The valve bounces once a turn of its limit cycle, so its impacts never accumulate.
    options = ("--set", "q=2", "--set", "restitution=0.8", "--until", "24000")
    found = _events_of("relief_valve", *options)
    assert len(found) > 3 * 4096
    assert found == _expected("relief_valve", 24000.0, q=2.0, restitution=0.8)


@pytest.mark.slow
def test_elastic_impacts_give_the_same_digits() -> None:
    found = _events_of("bouncing_ball", "--set", "restitution=1", "--until", "100")
    assert len(found) == 111
    assert found == _expected("bouncing_ball", 100.0, restitution=1.0)


EXPORTED = (
    "motor_pendulum",
    "curved_surface",
    "marble_table",
    "solenoid",
    "two_motors",
    "two_tone_table",
)


@pytest.mark.slow
@pytest.mark.parametrize("name", fast(1, EXPORTED))
def test_an_exported_problem_gives_the_same_to_the_last_digit(name: str) -> None:
    assert _events_of(name, "--until", "4") == _expected(name, 4.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name == "hopper" else pytest.mark.slow) for name in GRAPHS],
)
def test_machines_with_several_stops_or_switches_give_the_same_digits(name: str) -> None:
    until = GRAPHS[name]
    # A compiler takes most of the time.
    level = "-O0" if name == "hopper" else "-O1"
    found = _events_of(name, "--until", str(until), level=level)
    assert len(found) > 10
    assert found == _expected(name, until)


@pytest.mark.slow
def test_a_machine_without_a_stop_gives_the_same_digits() -> None:
    file = Path("wheel.py")
    file.write_text("from tests.support.contactless import wheel\n\nPROBLEM = wheel()\n")
    found = _events_of("wheel.py", "--until", "5")
    assert len(found) > 3
    assert found == _expected("wheel.py", 5.0)


SMOOTH = """
import casadi as ca
import zeno_orbits as zo
from tests.support.mechanisms import machine_of

def model(_):
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    mass = zo.HybridLagrangian.from_energies(q=x, v=v, kinetic=v**2 / 2, potential=x)
    return zo.hybrid_system(mass, zo.no_drive(mass))

PROBLEM = machine_of(model, {"x": "m", "v": "m/s"})
"""


@pytest.mark.slow
def test_a_machine_without_events_and_parameters_is_strict_c() -> None:
    Path("smooth.py").write_text(SMOOTH)
    assert _events_of("smooth.py", "--until", "5") == []


@pytest.mark.slow
def test_a_machine_with_nested_kinks_gives_the_same_digits() -> None:
    Path("nested.py").write_text(nested_problem(), encoding="utf-8")
    found = _events_of("nested.py", "--until", "7")
    assert found == _expected("nested.py", 7.0)
    # A limit and a table follow the wave: the force is 1.5 N, after half a period 0.3 N.
    up, down = half_periods("table")
    y = down @ up @ (0.0, 0.0, 1.0)
    kind, numbers = found[-1]
    assert kind.startswith("switch")
    assert numbers[:3] == pytest.approx([2 * math.pi, *y[:2]], rel=1e-9)


TABLED = """
from dataclasses import replace

import casadi as ca
import numpy as np
import zeno_orbits as zo
from tests.support.mechanisms import machine_of

KIND = "{kind}"
SAMPLES = np.zeros(500)
SAMPLES[150:153] = 3.0, 9.0, 2.0
RECORD = zo.record(np.linspace(0.0, 4.99, 500), SAMPLES, period=5.0, kind=KIND)
KNOTS = np.linspace(-1.0, 9.0, 41)

def model(_):
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    clock = zo.Clock.at(ca.SX(RECORD.frequency))
    mass = zo.HybridLagrangian.from_energies(
        q=x, v=v, kinetic=v**2 / 2, potential=2 * x, gap=x, clock=clock,
        passive_force=zo.table(x, KNOTS, -np.sin(KNOTS), KIND), applied_force=RECORD.at(clock),
    )
    return zo.hybrid_system(mass, zo.no_drive(mass), 0.6)

UNITS = {{"x": "m", "v": "m/s", "cosine": "1", "sine": "1"}}
PROBLEM = replace(machine_of(model, UNITS), starts=({{"x": 1.0, "cosine": 1.0}},))
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["linear", "monotone", "cubic"])
def test_tables_and_records_with_a_pulse_give_the_same_digits(kind: str) -> None:
    Path("tabled.py").write_text(TABLED.format(kind=kind), encoding="utf-8")
    found = _events_of("tabled.py", "--until", "4")
    assert any(name.startswith("impact") for name, _ in found)
    assert found == _expected("tabled.py", 4.0)


@pytest.mark.slow
def test_a_short_pulse_is_not_lost_in_exported_code() -> None:
    width = 1e-7
    force = f"zo.piecewise(clock, (0, {1 / width!r}, 0), (1.0, 1.0 + {width!r}))"
    Path("pulsed.py").write_text(nested_problem(force), encoding="utf-8")
    found = _events_of("pulsed.py", "--until", "7")
    assert found == _expected("pulsed.py", 7.0)
    # The impulse is 1 N s, and the rounding of its ends is 1e-15 s.
    kind, numbers = found[1]
    assert kind.startswith("switch")
    assert numbers[:3] == pytest.approx([1.0 + width, 0.0, 1.0], abs=1e-7)


@pytest.mark.slow
def test_a_run_that_ends_early_tells_why() -> None:
    answer = ask("export", "relay_soft", "--until", "0.01", "-o", "exported")
    assert answer.code == YES, answer.err
    code = Path("exported/main.c").read_text(encoding="utf-8")
    # Exchanged switching times are refused, as in Python.
    places = list(zo.load_problem("relay_soft").symbols())
    t1, t2 = places.index("t1"), places.index("t2")
    begin = "status = zl_begin(problem, run, settings, relay_soft_parameters"
    swapped = "swapped[T1] = swapped[T2] + 1.0; status = zl_begin(problem, run, settings, swapped"
    swapped = swapped.replace("T1", str(t1)).replace("T2", str(t2))
    assert begin in code
    memory = "double swapped[64]; memcpy(swapped, relay_soft_parameters, (size_t)problem->n_p * 8);"
    code = code.replace(begin, f"{{ {memory} {swapped}").replace(
        "relay_soft_start);", "relay_soft_start); }", 1
    )
    Path("exported/main.c").write_text(f"#include <string.h>\n{code}", encoding="utf-8")
    words = ["cc", "-O1", "exported/main.c", "exported/relay_soft.c", "-o", "program", "-lm"]
    assert subprocess.run(words, check=False).returncode == 0
    run = subprocess.run(["./program"], capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert run.stderr == f"status {binding.UNORDERED} at 0 s\n"


def test_a_machine_with_too_many_modes_is_refused() -> None:
    Path("many.py").write_text(MANY, encoding="utf-8")
    answer = ask("export", "many.py", "-o", "exported")
    assert answer.code == MISUSE
    assert "many.py: cannot be exported: it has 512 modes, and at most 256 are exported" in (
        answer.err
    )


MANY = """
import casadi as ca
import zeno_orbits as zo


def model(p):
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    force = sum(ca.if_else(q > k, 1, 0) for k in range(1, 9))
    mass = zo.HybridLagrangian.from_energies(
        q=q, v=v, kinetic=v**2 / 2, potential=9.81 * q, passive_force=-force, gap=q
    )
    return zo.hybrid_system(mass, zo.no_drive(mass), p["restitution"], switches=())


PROBLEM = zo.Problem(
    name="many",
    title="ball through eight layers",
    source="tests/loop/test_export.py",
    state_names=("height", "speed"),
    state_units=("m", "m/s"),
    parameters=(zo.Quantity.restitution(0.5),),
    gains=(),
    model=model,
    starts=({"height": 9.5},),
    portraits=(("height", "speed"),),
    amplitude_of="height",
)
"""


@pytest.mark.slow
def test_numbers_and_start_are_those_that_were_asked_for() -> None:
    options = (
        "--set",
        "restitution=0.7",
        "--set",
        "g=1.62",
        "--start",
        "height=2",
        "--until",
        "40",
    )
    found = _events_of("bouncing_ball", *options)
    fall = math.sqrt(2 * 2 / 1.62)
    assert found[0][0] == "impact stop"
    assert found[0][1][0] == pytest.approx(fall, rel=1e-14)
    zeno = next(numbers for kind, numbers in found if kind == "zeno stop")
    assert zeno[0] == pytest.approx(fall * 1.7 / 0.3, rel=1e-11)


@pytest.mark.slow
def test_near_one_impacts_are_followed_one_by_one() -> None:
    found = _events_of("bouncing_ball", "--set", "restitution=0.99", "--until", "95")
    fall = math.sqrt(2 / 9.81)
    assert sum(kind == "impact stop" for kind, _ in found) > 600
    zeno = next(numbers for kind, numbers in found if kind == "zeno stop")
    assert zeno[0] == pytest.approx(fall * 1.99 / 0.01, rel=1e-10)


def test_an_output_that_is_a_file_is_refused() -> None:
    Path("taken").write_text("", encoding="utf-8")
    answer = ask("export", "bouncing_ball", "-o", "taken")
    assert answer.code == MISUSE
    assert "`taken` is a file" in answer.err


def test_a_time_that_is_not_positive_is_refused() -> None:
    answer = ask("export", "bouncing_ball", "-o", "exported", "--until", "-1")
    assert answer.code == MISUSE
    assert not Path("exported").exists()


def test_what_is_written_is_told_to_programs() -> None:
    answer = ask("export", "bouncing_ball", "-o", "exported", "--json")
    assert answer.code == YES
    for name in ("bouncing_ball.c", "bouncing_ball.h", "main.c"):
        assert f"exported/{name}" in answer.out
        assert (Path("exported") / name).is_file()
