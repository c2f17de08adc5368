"""The library: its rules are those of Python, its code is clean, and it is found or built."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.loop.agreement import needs_compiler
from tests.support.cases import often
from tests.support.commands import YES, ask
from tests.support.source_trees import unbuilt_tree
from zeno_orbits.integrators import (
    automatic,
    dop853,
    dop853_step,
    events,
    flow,
    following,
    guard_net,
    radau,
    steps,
)
from zeno_orbits.loop import whole_source
from zeno_orbits.loop.source import FLAGS, HERE, LIBRARIES
from zeno_orbits.model import contact, friction
from zeno_orbits.model.numeric import admission, graph_dynamics
from zeno_orbits.simulation import (
    accumulations,
    arc_follower,
    event_rules,
    reference_run,
    small_hops,
    stop_run,
)
from zeno_orbits.simulation.zeno import completion, rescaled_flight, zeno_limit, zeno_passage

pytestmark = needs_compiler

ROOT = Path(__file__).resolve().parents[2]
WARNINGS = ("-pedantic", "-Wall", "-Wextra", "-Werror")

RULES: dict[str, float] = {
    "CUBIC": events.CUBIC,
    "CUBIC_STEPS": events.CUBIC_STEPS,
    "HALVINGS": events.HALVINGS,
    "TINY": events.TINY,
    "DOUBLES": events.DOUBLES,
    "POLISH": events.POLISH,
    "MOST_PIECES": guard_net.MOST_PIECES,
    "NARROWEST": guard_net.NARROWEST,
    "NEAR_START": guard_net.NEAR_START,
    "AGREE": guard_net.AGREE,
    "SLACK": steps.SLACK,
    "ROUNDED": steps.ROUNDED,
    "ABOVE": stop_run._ABOVE,
    "STEADY": stop_run._STEADY,
    "BRIEF": arc_follower._BRIEF,
    "HOP_PART": small_hops._PART,
    "PART_OF_HOP": small_hops._PART_OF_HOP,
    "HOP_TURNS": small_hops._TURNS,
    "HOP_LOW": small_hops._LOW,
    "LOW_RISING": small_hops._LOW_RISING,
    "HOP_BRIEF": stop_run._BRIEF,
    "LEAVES": following.LEAVES,
    "EXPLICIT_SAFETY": dop853.SAFETY,
    "EXPLICIT_SHRINK": dop853.SHRINK,
    "EXPLICIT_GROW": dop853.GROW,
    "EXPLICIT_EXPONENT": dop853.EXPONENT,
    "IMPLICIT_SAFETY": radau.SAFETY,
    "IMPLICIT_SHRINK": radau.SHRINK,
    "IMPLICIT_GROW": radau.GROW,
    "UNSOLVED": radau.UNSOLVED,
    "FIRST_ITERATIONS": flow.FIRST_ITERATIONS,
    "MOST_ITERATIONS": steps.MOST_ITERATIONS,
    "NEWTON_SHARE": steps.NEWTON_SHARE,
    "NEWTON_FLOOR": steps.NEWTON_FLOOR,
    "FIRST_LOOK": automatic.FIRST_LOOK,
    "PATIENCE": automatic.PATIENCE,
    "HELD": automatic.HELD,
    "STUCK": automatic.STUCK,
    "PAYS": automatic.PAYS,
    "LONG_LEFT": automatic.LONG,
    "FIRST_STEP": automatic.FIRST_STEP,
    "FIRST_PACE": arc_follower._FIRST_LOOK,
    "RISE": arc_follower._RISE,
    "INSIDE": event_rules._INSIDE,
    "MAY_BEND": event_rules._MAY_BEND,
    "ROUNDING": event_rules.ROUNDING,
    "LATE": event_rules.LATE,
    "N_NODES": zeno_limit.N_NODES,
    "NODE_RATIO": zeno_limit.NODE_RATIO,
    "FALLEN": zeno_limit._FALLEN,
    "MOST_FALLS": zeno_limit._MOST_FALLS,
    "SLOWEST": contact.SLOWEST,
    "FIRST_TRY": completion._FIRST_TRY,
    "WORTHWHILE": completion._WORTHWHILE,
    "STILL_HOLDS": completion._STILL_HOLDS,
    "DIFFERENCES": zeno_passage._DIFFERENCES,
    "SEEN": zeno_passage._SEEN,
    "SMOOTH": zeno_passage._SMOOTH,
    "DECAYED": zeno_passage._DECAYED,
    "WORTH_WAITING": zeno_passage._WORTH_WAITING,
    "FLIGHT_STEPS": rescaled_flight._MOST_STEPS,
    "MOST_CORRECTIONS": rescaled_flight._MOST_CORRECTIONS,
    "CLOSE": rescaled_flight._CLOSE,
    "FORCED": friction.FORCED,
    "PER_PART": friction.PER_PART,
    "SWITCH_ZERO": graph_dynamics._ZERO,
    "START_OFF": admission.START_OFF,
    "APART": reference_run._APART,
    "AT_ONCE": reference_run._AT_ONCE,
    "OF_FLIGHT": reference_run._OF_FLIGHT,
    "CONTINUOUS": reference_run._CONTINUOUS,
    "ONE_SURFACE": reference_run._ONE_SURFACE,
    "SHIFT": reference_run._SHIFT,
    "SAME": reference_run._SAME,
    "GROW": reference_run._GROW,
    "SHORTEST": reference_run._SHORTEST,
    "SPENT": reference_run._SPENT,
    "LEAST_IMPULSE": reference_run._LEAST_IMPULSE,
    "PART_BEFORE": reference_run._BEFORE,
    "NEAR_KINK": reference_run._NEAR_KINK,
    "SPLIT": reference_run._SPLIT,
    "SPLIT_RESOLVED": reference_run._SPLIT_RESOLVED,
    "SLOW_BESIDE": reference_run._SLOW_BESIDE,
    "LEAST_BESIDE": reference_run._LEAST_BESIDE,
    "ACCUMULATED": reference_run._ACCUMULATED,
    "LOW": reference_run._LOW,
    "SLOW": reference_run._SLOW,
    "LOST": reference_run._LOST,
    "COUPLED": reference_run._COUPLED,
    "LEFT_GAP": reference_run._LEFT,
    "IN_TURN": accumulations._IN_TURN,
    "IN_ROW": accumulations._IN_ROW,
    "LAST_IMPACTS": accumulations._LAST,
    "CHANGES": accumulations._CHANGES,
    "CORNER": accumulations._CORNER,
    "SHORT": accumulations._SHORT,
    "FAST": accumulations._FAST,
    "SOON": accumulations._SOON,
    "COMPARED": accumulations._COMPARED,
    "FALLING": accumulations._FALLING,
    "ALIKE": accumulations._ALIKE,
}


def test_the_numbers_of_the_rules_are_those_of_python() -> None:
    text = (HERE / "rules.h").read_text(encoding="utf-8")
    found = {
        name: float(number)
        for name, number in re.findall(r"^#define (\w+) (\S+)$", text, flags=re.MULTILINE)
    }
    assert found == RULES


def test_the_tableau_is_that_of_python() -> None:
    text = (HERE / "dop853.h").read_text(encoding="utf-8")
    rows = re.findall(r"\{(\d+),\s*\{([\d,\s]+)\},\s*\{([^}]+)\}\}", text)
    expected = [*dop853_step.STAGES, dop853_step.STEP, dop853_step.FIFTH, dop853_step.THIRD]
    assert len(rows) == len(expected)
    for (count, places, weights), row in zip(rows, expected, strict=True):
        assert int(count) == len(row)
        pairs = zip(map(int, places.split(",")), map(float, weights.split(",")), strict=True)
        assert tuple(pairs) == row


@pytest.mark.slow
@pytest.mark.parametrize("level", ["-O0", "-O1", "-O2", "-O3"])
def test_the_code_compiles_without_a_warning(tmp_path: Path, level: str) -> None:
    code = tmp_path / "loop.c"
    code.write_text(whole_source(), encoding="utf-8")
    words = ["cc", *FLAGS, *WARNINGS, level, str(code), "-o", str(tmp_path / "loop.so")]
    done = subprocess.run([*words, *LIBRARIES], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def _python(code: str, folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "ZENO_ORBITS_CACHE": str(folder), **variables}
    environment["PYTHONPATH"] = str(unbuilt_tree())
    return subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        cwd=unbuilt_tree(),
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


ACCOUNT = "from zeno_orbits.loop import loop_account; print(loop_account())"
RUN = """
import numpy as np, zeno_orbits as zo
from zeno_orbits.simulation import simulate
problem = zo.load_problem("bouncing_ball")
run = simulate(problem.dynamics(problem.values()), (1.0, 0.0), until=9.0)
print(type(run).__name__, repr(run.zeno_points[0].time))
"""


@pytest.mark.slow
def test_two_processes_that_need_the_library_at_once_both_get_it(tmp_path: Path) -> None:
    tree = str(unbuilt_tree())
    environment = {**os.environ, "ZENO_ORBITS_CACHE": str(tmp_path), "PYTHONPATH": tree}
    words, pipe = [sys.executable, "-c", ACCOUNT], subprocess.PIPE
    processes = [
        subprocess.Popen(words, env=environment, cwd=tree, stdout=pipe, text=True) for _ in range(3)
    ]
    said = [process.communicate(timeout=300)[0] for process in processes]
    assert said == ["executions run in compiled code\n"] * 3
    assert len(list((tmp_path / "kernels").glob("loop_*.kernels"))) == 1


@pytest.mark.slow
def test_a_library_that_was_cut_is_built_again(tmp_path: Path) -> None:
    assert "compiled" in _python(ACCOUNT, tmp_path).stdout
    (library,) = (tmp_path / "kernels").glob("loop_*.kernels")
    library.write_bytes(library.read_bytes()[:1000])
    assert "compiled" in _python(ACCOUNT, tmp_path).stdout


@pytest.mark.slow
def test_without_a_compiler_the_plain_simulator_gives_the_same(tmp_path: Path) -> None:
    alone = _python(RUN, tmp_path, PATH="", CC="")
    looped = _python(RUN, tmp_path)
    assert alone.stdout.split()[0] == "Execution", alone.stderr
    assert looped.stdout.split()[0] == "RecordedExecution", looped.stderr
    assert alone.stdout.split()[1] == looped.stdout.split()[1]
    said = _python(ACCOUNT, tmp_path, PATH="", CC="").stdout
    assert said.startswith("executions run in Python: a C compiler is missing")


def test_the_plain_simulator_can_be_asked_for(tmp_path: Path) -> None:
    assert _python(RUN, tmp_path, ZENO_ORBITS_LOOP="never").stdout.split()[0] == "Execution"
    said = _python(ACCOUNT, tmp_path, ZENO_ORBITS_LOOP="never").stdout
    assert said == "executions run in Python, as ZENO_ORBITS_LOOP=never asks\n"
    refused = _python(RUN, tmp_path, ZENO_ORBITS_LOOP="sometimes")
    assert refused.returncode != 0
    assert "Argument `ZENO_ORBITS_LOOP` must be one of use, tape, never" in refused.stderr


SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g")


@pytest.mark.slow
@pytest.mark.parametrize("name", often(1, ["relay", "motor_pendulum", "vibrating_table", "hopper"]))
def test_random_runs_and_units_end_in_a_status(tmp_path: Path, name: str) -> None:
    """Follow 200 of each problem: NaN, infinity and numbers far from the usual are among them."""
    assert ask("export", name, "--fmu", "-o", str(tmp_path)).code == YES
    with zipfile.ZipFile(tmp_path / f"{name}.fmu") as whole:
        whole.extractall(tmp_path)
    code = Path(__file__).with_name("stress.c").read_text(encoding="utf-8")
    sources = tmp_path / "sources"
    (sources / "stress.c").write_text(code.replace("PROBLEM", name), encoding="utf-8")
    flags = ["-std=c99", *WARNINGS, "-O1", "-ffp-contract=off", *SANITIZERS]
    words = ["cc", *flags, str(sources / "stress.c"), "-o", str(tmp_path / "stress"), "-lm"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    run = subprocess.run(
        [str(tmp_path / "stress"), "200"], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr[-3000:]
    counts = [int(word) for word in run.stdout.split()]
    assert sum(counts) == 200
    assert sum(count > 0 for count in counts) >= 3


@pytest.mark.weekly
@pytest.mark.slow
def test_no_undefined_behaviour_is_met(tmp_path: Path) -> None:
    """Rerun the tests of runs with a library that checks addresses and arithmetic."""
    code, library = tmp_path / "loop.c", tmp_path / "loop.so"
    code.write_text(whole_source(), encoding="utf-8")
    words = ["cc", *FLAGS, *SANITIZERS, str(code), "-o", str(library), *LIBRARIES]
    subprocess.run(words, check=True)
    found = [
        subprocess.run(
            ["cc", f"-print-file-name={name}"], capture_output=True, text=True, check=True
        ).stdout.strip()
        for name in ("libasan.so", "libubsan.so")
    ]
    if not all(map(os.path.isabs, found)) or shutil.which("cc") is None:
        pytest.skip("this compiler has no sanitizers to load")
    environment = {
        **os.environ,
        "LD_PRELOAD": " ".join(found),
        "ASAN_OPTIONS": "detect_leaks=0:verify_asan_link_order=0",
        "UBSAN_OPTIONS": "halt_on_error=1:print_stacktrace=1",
        "ZENO_ORBITS_LOOP_LIBRARY": str(library),
        "PYTHONPATH": str(ROOT),
    }
    names = ("test_run.py", "test_equality.py", "test_graph_equality.py", "test_tangent.py")
    files = [str(Path(__file__).with_name(name)) for name in names]
    words = [sys.executable, "-m", "pytest", "-q", "-n0", "-p", "no:cacheprovider", *files]
    done = subprocess.run(
        words, env=environment, capture_output=True, text=True, check=False, cwd=ROOT, timeout=1500
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
