"""One question, one file: a map does not depend on cache, compiler, workers or order."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

from tests.loop.agreement import needs_compiler
from tests.support.cases import often
from zeno_orbits.maps import Axis, Plane, attractors_at, chunk_of
from zeno_orbits.model import load_problem, locate_problem

PENDULUM = ("motor_pendulum", "--x", "Kp=1.5:4.5", "--y", "Kd=-1.6:-0.4", "--grid", "3x3")
TABLE = ("vibrating_table", "--x", "A=0.014:0.03", "--y", "restitution=0.1:0.5", "--grid", "3x3")


def map_file(folder: Path, words: tuple[str, ...], workers: int = 1, **chosen: str) -> bytes:
    """Return the bytes of a map that a process of its own makes with some variables set."""
    out = folder / "map.json"
    command = [sys.executable, "-m", "zeno_orbits", "map", *words]
    subprocess.run(
        [*command, "--workers", str(workers), "-o", str(out)],
        env={**os.environ, **chosen},
        capture_output=True,
        timeout=300,
        check=False,
    )
    made = out.read_bytes()
    out.unlink()
    return made


@pytest.mark.slow
@pytest.mark.parametrize("words", often(1, [(TABLE,), (PENDULUM,)]))
def test_a_map_is_the_same_file_whatever_has_been_compiled(
    tmp_path: Path, words: tuple[str, ...]
) -> None:
    usual = map_file(tmp_path, words)
    assert usual.count(b'"fate"') == 9
    cold = map_file(tmp_path, words, ZENO_ORBITS_CACHE=str(tmp_path / "empty"))
    tapes = map_file(tmp_path, words, ZENO_ORBITS_LOOP="tape")
    waited = map_file(tmp_path, words, ZENO_ORBITS_LOOP="use")
    assert [cold == usual, tapes == usual, waited == usual] == [True] * 3


@pytest.mark.weekly
@pytest.mark.slow
@pytest.mark.parametrize("words", [TABLE, PENDULUM])
def test_a_map_without_the_loop_has_the_same_attractors_to_rounding(
    tmp_path: Path, words: tuple[str, ...]
) -> None:
    usual, plain = (
        json.loads(map_file(tmp_path, words, ZENO_ORBITS_LOOP=chosen))["points"]
        for chosen in ("use", "never")
    )
    for one, other in zip(usual, plain, strict=True):
        names = ("fate", "returns", "turns", "kind", "escaped")
        assert [one.get(name) for name in names] == [other.get(name) for name in names]
        if "period" in one:
            # Sums of rounding over a period, far below the local error.
            assert one["period"] == pytest.approx(other["period"], rel=1e-10)


@pytest.mark.weekly
@needs_compiler
@pytest.mark.slow
def test_a_large_map_compiles_its_formulas_first_and_is_the_file_of_their_tapes(
    tmp_path: Path,
) -> None:
    words = ("bouncing_ball", "--x", "height=0.5:0.6", "--y", "restitution=0.1:0.2")
    made: list[bytes] = []
    for chosen, is_compiled in (("use", True), ("tape", False)):
        cache = tmp_path / chosen
        variables = {"ZENO_ORBITS_LOOP": chosen, "ZENO_ORBITS_CACHE": str(cache)}
        made.append(map_file(tmp_path, (*words, "--grid", "16x16"), workers=2, **variables))
        assert bool(list(cache.rglob("formulas_*"))) is is_compiled
    assert made[0] == made[1]


@pytest.mark.slow
def test_a_map_by_two_workers_is_the_file_of_one(tmp_path: Path) -> None:
    assert map_file(tmp_path, PENDULUM, workers=2) == map_file(tmp_path, PENDULUM)


def test_the_order_of_points_and_an_earlier_map_change_no_bit() -> None:
    table = load_problem("vibrating_table")
    settings = [
        table.values(parameters={"A": 0.001 * a, "restitution": 0.1 * e})
        for a in (14, 20, 27)
        for e in (1, 3)
    ]
    first = attractors_at(table, settings)
    order = list(range(len(settings)))
    random.Random(1).shuffle(order)
    again = attractors_at(table, [settings[k] for k in order])
    for k, found in zip(order, again, strict=True):
        assert repr(found) == repr(first[k])
    for values, found in zip(settings, first, strict=True):
        assert repr(attractors_at(table, [values])[0]) == repr(found)


def test_the_chunk_does_not_depend_on_the_computer(monkeypatch: pytest.MonkeyPatch) -> None:
    plane = Plane(
        source=locate_problem("vibrating_table"),
        x=Axis(name="A", lower=0.01, upper=0.02, count=100),
        y=Axis(name="restitution", lower=0.1, upper=0.5, count=100),
        start=(0.0, 0.0, 1.0, 0.0),
    )
    usual = chunk_of(plane)
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    assert chunk_of(plane) == usual
    assert 100 * 100 / usual >= 40
