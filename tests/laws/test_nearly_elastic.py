"""Impacts whose restitution is 1, or so near 1 that a simulation does not see the end."""

from __future__ import annotations

import json

import pytest

import zeno_orbits as zo
from tests.support.commands import NO, YES, ask


@pytest.mark.parametrize("lost", [1e-4, 1e-7, 1e-9])
def test_a_ball_that_loses_little_is_not_periodic(lost: float) -> None:
    """It rests after the Zeno time, which is 9e3 s or more. The loss per impact is known."""
    answer = ask("simulate", "bouncing_ball", "--settle", "--set", f"restitution={1 - lost!r}")
    assert answer.code == YES
    assert "not settled yet" in answer.out
    assert f"steadily slower, by {lost:.1g} of their speed each" in answer.out


def test_an_elastic_ball_is_periodic() -> None:
    answer = ask("simulate", "bouncing_ball", "--settle", "--set", "restitution=1")
    assert "periodic orbit without a Zeno point" in answer.out


@pytest.mark.slow
def test_a_map_of_balls_that_lose_little_has_no_orbit() -> None:
    found = zo.parameter_map(
        "bouncing_ball", x=("restitution", 1 - 2e-7, 1 - 1e-7, 2), y=("g", 9.0, 10.0, 2)
    )
    assert {one.fate.value for one in found.attractors} == {"not settled yet"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["forced_oscillator", "clapper"])
def test_a_zeno_orbit_with_elastic_impacts_is_refused_by_the_restitution(
    name: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    file = tmp_path_factory.mktemp("elastic") / "orbit.json"
    assert ask("search", name, "-o", str(file)).code == YES
    data = json.loads(file.read_text())
    data["parameters"]["restitution"] = 1.0
    file.write_text(json.dumps(data))
    for command in ("stability", "recovery", "push", "plot"):
        answer = ask(command, str(file))
        assert answer.code != YES
        assert "`restitution` must be less than 1 for a Zeno point, but it is 1" in answer.err
    answer = ask("continue", str(file), "--parameter", "A=0.9:6")
    assert "`restitution` must be less than 1 for a Zeno point, but it is 1" in answer.err
    answer = ask("verify", str(file))
    assert answer.code == NO
    assert "elastic impacts have no Zeno point" in answer.out
