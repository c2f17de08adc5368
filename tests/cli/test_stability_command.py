"""The command `stability`: its text, its data, its exit codes and wrong inputs."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import zeno_orbits as zo
from tests.support.commands import MISUSE, NO, YES, ask
from zeno_orbits.report.terminal import print_stability

pytestmark = pytest.mark.usefixtures("here")


def _file(problem: str, **how: Any) -> str:
    """Write the orbit of a problem and return the name of its file."""
    known = zo.load_problem(problem)
    if known.has_graph:
        zo.write_orbit(zo.find_orbit(known, **how).unwrap(), "orbit.json")
    else:
        zo.write_orbit(zo.find_orbit_by_shooting(known, **how).unwrap(), "orbit.json")
    return "orbit.json"


def test_a_stable_orbit_is_told_with_its_return_map_and_its_times() -> None:
    answer = ask("stability", _file("motor_pendulum"))
    assert answer.code == YES
    lines = answer.out.splitlines()
    told, _, error = lines[0].partition(" +- ")
    assert told == "Orbit of motor_pendulum: stable, spectral radius 0.0193686"
    assert float(error) < 1e-9
    assert "0 (below rounding)" in answer.out
    assert "just after `release stop`" in answer.out
    assert "per dtheta1 [rad/s]" in answer.out
    assert "Norm of DP (largest row sum, in scaled coordinates): 0.0" in answer.out
    assert "Slowest direction: mostly current, with dtheta1 (2.81 rad/s per A)" in answer.out
    assert "decays to 1/e in 0.2535 periods (0.4599 s)." in answer.out
    assert "decays to 1 % in 1.168 periods (2.118 s)." in answer.out
    assert max(map(len, lines)) <= 80


def test_the_section_of_several_stops_is_named_by_its_event() -> None:
    answer = ask("stability", _file("hopper", parameters={"restitution": 0.6}))
    assert answer.code == YES
    assert "spectral radius 0.36 +- 1e-12" in answer.out
    assert "just after `impact stop`" in answer.out
    assert "Slowest direction: speed alone" in answer.out


@pytest.mark.parametrize("gain", [-0.9, -1.5])
def test_a_file_whose_motion_does_not_return_is_not_called_stable(gain: float) -> None:
    path = Path(_file("motor_pendulum"))
    data = json.loads(path.read_text())
    assert data["gains"]["Kd"] == -1.0
    data["gains"]["Kd"] = gain
    path.write_text(json.dumps(data))
    answer = ask("stability", path)
    assert ask("stability", path, "--json").data["map"] is None
    assert answer.code == NO
    assert "Orbit of motor_pendulum: undecided" in answer.out
    assert "The motion does not return to its start (`verify` measures by how much)" in answer.out


def test_a_complex_pair_turns() -> None:
    answer = ask("stability", _file("impact_oscillator"))
    # The published multipliers -0.584295 +- 0.005600 i.
    assert "-0.5842953 +0.005600351 i" in answer.out
    assert "The disturbance turns once in 2.006 periods." in answer.out


def test_an_unstable_orbit_doubles_and_is_a_no(repelling: zo.Orbit) -> None:
    zo.write_orbit(repelling, "orbit.json")
    answer = ask("stability", "orbit.json")
    assert answer.code == NO
    assert answer.out.startswith("Orbit of motor_pendulum: unstable, spectral radius 2.91092")
    # ln 2 / ln 2.910917734.
    assert "A small disturbance grows to twice its size in 0.6487 periods" in answer.out
    assert "Fastest growth: mostly" in answer.out


def test_a_section_that_is_a_point_has_no_multipliers() -> None:
    answer = ask("stability", _file("forced_oscillator"))
    assert answer.code == YES
    assert "No multipliers: every period passes a section that is a point." in answer.out
    assert "Every small disturbance vanishes within 1 period" in answer.out
    assert "nan" not in answer.out


def test_a_multiplier_of_unknown_error_promises_no_decay(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = zo.floquet_multipliers(_file("impact_oscillator"))
    print_stability(replace(found, values=(0j, 0j), errors=(math.inf, math.inf), slowest=None))
    said = capsys.readouterr().out
    assert said.startswith("Orbit of impact_oscillator: undecided, spectral radius unknown")
    assert "vanishes" not in said
    assert "The errors of the multipliers leave open whether a disturbance decays." in said


def test_the_data_are_those_of_python(here: Path) -> None:
    file = _file("hopper", parameters={"restitution": 0.6})
    answer = ask("stability", file, "--json", "-o", "stability.json")
    found = zo.floquet_multipliers(file)
    assert answer.code == YES
    told = json.loads((here / "stability.json").read_text())
    assert answer.data == {**found.as_json(), "map": zo.return_map(file).as_json()} == told
    assert answer.data["multipliers"][0]["value"] == pytest.approx([0.36, 0.0], abs=1e-12)
    assert answer.data["coordinates"] == {"speed": "m/s"}
    assert answer.data["recovery"][1]["to"] == "1 %"


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("none.json",), MISUSE),
        (("orbit.json", "-o", "orbit.json"), MISUSE),
        (("orbit.json", "--periods", "3"), MISUSE),
        (("orbit.json", "--problem", "hopper"), MISUSE),
    ],
)
def test_wrong_inputs_end_in_one_line(words: tuple[str, ...], code: int) -> None:
    _file("forced_oscillator")
    answer = ask("stability", *words)
    assert answer.code == code
    assert answer.out == ""
    assert answer.err.count("\n") == 1
    assert answer.err.startswith("zeno-orbits")
