"""The same run in the same bits, whatever has been compiled before."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.loop.agreement import needs_compiler

PROGRAM = """
import hashlib, sys
import zeno_orbits as zo
from zeno_orbits.integrators import engine_named

digest = hashlib.sha256()
for name in sys.argv[2:]:
    settings = zo.SimulationSettings(engine=engine_named(sys.argv[1]))
    found = zo.simulate(name, until=3.0, settings=settings)
    times, states = found.sampled(20)
    digest.update(repr([(event.time, type(event)) for event in found.events]).encode())
    digest.update(times.tobytes() + states.tobytes() + found.end_state.tobytes())
    print(name, len(found.events), digest.hexdigest())
"""


def answer(folder: Path, *words: str, **variables: str) -> str:
    done = subprocess.run(
        [sys.executable, *words],
        env={**os.environ, "ZENO_ORBITS_CACHE": str(folder), **variables},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout


@pytest.mark.weekly
@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("engine", ["automatic"])
def test_a_cold_cache_a_warm_one_and_compiled_formulas_give_the_same_bits(
    engine: str, tmp_path: Path
) -> None:
    names = ("bouncing_ball", "motor_pendulum", "forced_oscillator", "vibrating_table")
    program = ("-c", PROGRAM, engine, *names)
    cold = answer(tmp_path, *program)
    assert cold.count("\n") == len(names)
    assert answer(tmp_path, *program) == cold
    for name in names:
        answer(tmp_path, "-m", "zeno_orbits", "cache", "--compile", name)
    assert answer(tmp_path, *program) == cold
    assert answer(tmp_path, *program, ZENO_ORBITS_LOOP="tape") == cold


@needs_compiler
@pytest.mark.slow
def test_dense_output_of_explicit_steps_is_that_of_the_reference(tmp_path: Path) -> None:
    program = ("-c", PROGRAM, "explicit", "bouncing_ball", "vibrating_table")
    assert answer(tmp_path, *program) == answer(tmp_path, *program, ZENO_ORBITS_LOOP="never")
