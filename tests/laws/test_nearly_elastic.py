"""Impacts whose restitution is 1, or so near 1 that a simulation does not see the end."""

from __future__ import annotations

import json
import math

import pytest

import zeno_orbits as zo
from tests.support.commands import NO, YES, ask
from tests.support.one_mass import one_mass
from zeno_orbits.maps import attractors_at
from zeno_orbits.model import load_problem
from zeno_orbits.simulation import AttractorKind


@pytest.mark.parametrize("lost", [1e-4, 1e-7, 1e-9, 1e-11, 1e-12])
def test_a_ball_that_loses_little_is_not_periodic(lost: float) -> None:
    """It rests after the Zeno time, which is 9e3 s or more. The loss per impact is known."""
    answer = ask("simulate", "bouncing_ball", "--settle", "--set", f"restitution={1 - lost!r}")
    assert answer.code == YES
    assert "not settled yet" in answer.out
    assert f"steadily slower, by {lost:.1g} of their speed each" in answer.out


def test_an_elastic_ball_is_periodic() -> None:
    answer = ask("simulate", "bouncing_ball", "--settle", "--set", "restitution=1")
    assert "periodic orbit without a Zeno point" in answer.out


@pytest.mark.parametrize("height", [0.01, 5.0, 100.0, 1e4])
def test_a_ball_from_any_height_is_periodic_only_without_losses(height: float) -> None:
    """By hand: an elastic ball takes ``sqrt(8 h / g)``. With losses its end is the rest."""
    ball = load_problem("bouncing_ball")
    kept, lost = attractors_at(
        ball,
        [ball.values(parameters={"restitution": one}) for one in (1.0, 1.0 - 1e-11)],
        start={"height": height},
    )
    assert kept.phrase == "periodic orbit without a Zeno point"
    assert kept.period == pytest.approx(math.sqrt(8.0 * height / 9.81), rel=1e-9)
    assert (lost.phrase, lost.kind) == ("not settled yet", AttractorKind.UNDECIDED)
    assert "steadily slower, by 1e-11 of their speed each" in lost.detail


@pytest.mark.parametrize("lost", [1e-8, 1e-10, 1e-12])
def test_a_ball_with_a_named_stop_that_loses_little_is_not_periodic(lost: float) -> None:
    ball = one_mass(
        lambda m: -9.81 + 0.0 * m.x,
        stops=lambda m: (zo.Stop(name="floor", gap=m.x, restitution=m.p["e"]),),
        has_clock=False,
        start={"x": 1.0},
        e=1.0 - lost,
    )
    (found,) = attractors_at(ball, [ball.values()])
    assert (found.phrase, found.kind) == ("not settled yet", AttractorKind.UNDECIDED)
    assert f"steadily slower, by {lost:.1g} of their speed each" in found.detail


@pytest.mark.parametrize(("amplitude", "is_chaotic"), [(1e-6, False), (1e-3, False), (9e-3, True)])
@pytest.mark.parametrize("lost", [0.0, 1e-11])
def test_a_ball_on_a_table_is_chaotic_only_beyond_the_last_torus(
    amplitude: float, lost: float, *, is_chaotic: bool
) -> None:
    """By the standard map: it is chaotic everywhere if ``4 A omega^2 / g`` exceeds 0.97."""
    assert (4.0 * amplitude * 30.0**2 / 9.81 > 0.97) is is_chaotic
    table = load_problem("vibrating_table")
    values = table.values(parameters={"restitution": 1.0 - lost, "A": amplitude})
    (found,) = attractors_at(table, [values], start={"height": 0.05, "cosine": 1.0})
    assert (found.kind is AttractorKind.CHAOTIC) is is_chaotic
    if is_chaotic:
        assert 0.0 < found.exponent_error < found.exponent
    else:
        assert found.phrase == "not settled yet"


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
