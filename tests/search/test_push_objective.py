"""Gains for the largest push: laws of scale, corners, brute force, and refusals."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.antidamped_spring import LIFTED, SETS, numbers
from tests.support.commands import MISUSE, NO, YES, ask
from zeno_orbits.maps import PushSettings, least_push

PUSHES = PushSettings(phases=6, steps=24, error=1e-3)
"""What the search asks of an orbit (docs/pushes.md)."""
ONCE = zo.SearchSettings(n_starts=0)
SPRING = {**numbers(*SETS[3]), "mass": 1.0}
PENDULUM = {"Kp": 2.5, "Kd": -1.0}


def pushed(
    problem: zo.Problem, free: Mapping[str, tuple[float, float]], **asked: object
) -> tuple[zo.Orbit, float, str]:
    """Return the orbit with the largest push, the push, and the sentences about it."""
    result = zo.search_gains(problem, vary=free, settings=ONCE, **asked)  # type: ignore[arg-type]
    return result.unwrap(), result.candidates[0].extents["push"].lowest, result.detail


def spring_push(weight: float) -> float:
    """Return the least push of the lifted mass, from the rays of `largest_push`."""
    orbit = zo.find_orbit_by_shooting(LIFTED, parameters={**SPRING, "weight": weight}).unwrap()
    least = zo.largest_push(orbit, problem=LIFTED, settings=PUSHES).least
    assert least is not None
    return least.largest


@pytest.mark.weekly
@pytest.mark.slow
def test_the_least_push_scales_with_the_weight_of_the_mass() -> None:
    # With x in units of the weight the equation of motion has no weight: pushes scale with it.
    least: list[float] = []
    for weight in (1.0, 4.0):
        orbit = zo.find_orbit_by_shooting(LIFTED, parameters={**SPRING, "weight": weight}).unwrap()
        least.append(least_push(LIFTED, orbit, settings=PUSHES).largest / weight)
    assert least[1] == pytest.approx(least[0], rel=1e-3)
    assert least[0] == pytest.approx(spring_push(1.0), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["motor_pendulum", "two_motors", "motor_valve"])
def test_the_least_push_is_the_smallest_of_all_rays(name: str) -> None:
    problem = zo.load_problem(name)
    orbit = zo.find_orbit(problem).unwrap()
    settings = PushSettings(phases=3, steps=8, error=1e-4)
    every = zo.largest_push(orbit, settings=settings).least
    one = least_push(problem, orbit, settings=settings)
    if every is None:
        assert np.isnan(one.largest)
        assert not one.beyond
    else:
        assert one.largest == pytest.approx(every.largest, abs=one.error + every.error)
        assert one.largest / one.searched <= 1.0


@pytest.mark.weekly
@pytest.mark.slow
def test_a_push_in_proportion_to_the_weight_is_largest_at_the_largest_weight() -> None:
    at_one = spring_push(1.0)
    orbit, push, detail = pushed(
        LIFTED, {"weight": (0.5, 2.0)}, parameters=SPRING, objective=zo.MaxPush()
    )
    assert orbit.parameters["weight"] == pytest.approx(2.0, abs=1e-6)
    assert push == pytest.approx(2.0 * at_one, rel=2e-3)
    assert "Beyond it: the oscillation grows." in detail


@pytest.mark.weekly
@pytest.mark.slow
def test_over_uncertain_weights_the_smallest_weight_decides() -> None:
    wish, start = zo.MaxPush(uncertain={"weight": (0.5, 2.0)}), {**SPRING, "weight": 1.0}
    _, push, detail = pushed(LIFTED, {"mass": (0.999, 1.001)}, parameters=start, objective=wish)
    assert push == pytest.approx(0.5 * spring_push(1.0), rel=4e-3)
    assert "(at weight = 0.5)" in detail


@pytest.mark.weekly
@pytest.mark.slow
def test_the_largest_push_of_the_pendulum_is_that_of_brute_force() -> None:
    problem = zo.load_problem("motor_pendulum")
    best = 0.0
    for kd in np.linspace(-1.1, -0.5, 7):
        orbit = zo.find_orbit_by_shooting(problem, gains={"Kp": 2.5, "Kd": float(kd)}).unwrap()
        best = max(best, least_push(problem, orbit, settings=PUSHES).largest)
    result = zo.search_gains(
        problem,
        vary={"Kd": (-1.1, -0.5)},
        gains=PENDULUM,
        objective=zo.MaxPush(),
        settings=zo.SearchSettings(n_starts=2),
    )
    found = result.candidates[0]
    assert found.extents["push"].lowest >= 0.99 * best
    again = zo.largest_push(found.orbit, settings=PUSHES).least
    assert again is not None
    assert again.largest == pytest.approx(found.extents["push"].lowest, abs=2 * again.error)


@pytest.mark.weekly
@pytest.mark.slow
def test_over_an_uncertain_box_the_push_is_the_least_of_its_corners() -> None:
    problem = zo.load_problem("motor_pendulum")
    box = {"restitution": (0.15, 0.25), "R": (2.9, 3.1)}
    orbit, push, _ = pushed(
        problem, {"Kd": (-1.05, -0.9)}, gains=PENDULUM, objective=zo.MaxPush(uncertain=box)
    )
    corners = [{}, *({"restitution": e, "R": r} for e in box["restitution"] for r in box["R"])]
    least: list[float] = []
    for corner in corners:
        there = zo.find_orbit(problem, gains=orbit.gains, parameters=corner).unwrap()
        least.append(least_push(problem, there, settings=PUSHES).largest)
    assert push == pytest.approx(min(least), rel=3e-3)


@pytest.mark.weekly
@pytest.mark.slow
def test_a_bound_is_kept_by_the_gains_of_the_largest_push() -> None:
    problem = zo.load_problem("motor_pendulum")
    bounds = [zo.Bound(name="spectral_radius", upper=0.3)]
    orbit, push, _ = pushed(
        problem, {"Kd": (-1.1, -0.5)}, gains=PENDULUM, objective=zo.MaxPush(), bounds=bounds
    )
    assert max(map(abs, orbit.floquet_multipliers)) <= 0.3 * (1 + 1e-6)
    # The least push grows with Kd from the start on.
    assert orbit.gains["Kd"] > PENDULUM["Kd"]
    assert push > 0.0160


@pytest.mark.slow
def test_an_orbit_that_some_corner_loses_is_no_answer() -> None:
    # A force of 0.7 does not lift the mass off its stop at all: 0.8 is needed.
    said = ask(
        *("search", "forced_oscillator", "--vary", "k=0.99:1.01", "--n-starts", "1"),
        *("--objective", "robustness", "--uncertain", "A=0.7:1.1"),
    )
    assert said.code == NO
    assert "The orbit is not kept (at A = 0.7): the release is not transversal." in said.out


@pytest.mark.slow
def test_gains_move_until_every_corner_has_an_orbit() -> None:
    # The mass leaves its stop if A > 0.8 k. At the start, k = 1, the corner A = 0.75 has no orbit.
    wish = zo.MaxPush(uncertain={"A": (0.75, 1.1)})
    result = zo.search_gains(
        "forced_oscillator", vary={"k": (0.8, 1.2)}, objective=wish, settings=ONCE
    )
    k = result.unwrap().parameters["k"]
    assert 0.8 <= k < 0.75 / 0.8
    assert "No push up to" in result.detail


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--objective", "robustness"), "must have --uncertain NAME=LOW:HIGH"),
        (("--objective", "push", "--uncertain", "R=2:3"), "must have --objective robustness"),
        (
            ("--objective", "push:theta3=1"),
            "unknown name `theta3`. Did you mean `theta2`? Known: theta1, theta2.",
        ),
        (("--objective", "push:theta1=0"), "must have one finite component that is not zero"),
        (("--objective", "push=1"), "unknown objective `push=1`. Did you mean `push`?"),
        (
            ("--objective", "robustness", "--uncertain", "restitution=0.5:1.5"),
            "--uncertain restitution=0.5:1.5: must lie in [0, 1]",
        ),
        (
            ("--objective", "robustness", "--uncertain", "Kp=1:2"),
            "must name parameters, but `Kp` is a gain",
        ),
        (
            ("--vary", "R=2:4", "--objective", "robustness", "--uncertain", "R=2:3"),
            "must not name the unknown `R`",
        ),
    ],
)
def test_a_wish_without_a_meaning_is_refused_in_one_line(
    words: tuple[str, ...], message: str
) -> None:
    said = ask("search", "motor_pendulum", *words)
    assert said.code == MISUSE
    assert message in said.err
    assert "\n" not in said.err.strip()


def test_impulses_of_different_units_need_a_direction() -> None:
    said = ask("search", "motor_cart", "--objective", "push")
    assert said.code == MISUSE
    assert "must name a direction, such as push:NAME=1" in said.err
    assert "N m s, N s" in said.err


@pytest.mark.slow
def test_the_command_writes_a_verified_orbit(tmp_path: Path) -> None:
    out = tmp_path / "orbit.json"
    words = ("--set", "Kp=2.5", "--vary", "Kd=-1.05:-0.95", "--objective", "push:theta2=1")
    said = ask("search", "motor_pendulum", *words, "--n-starts", "1", "-o", str(out))
    assert said.code == YES
    assert "The least push is 0.0" in said.out
    assert ask("verify", out).code == YES


@pytest.mark.slow
def test_an_orbit_that_loses_no_push_is_no_larger_push_than_another() -> None:
    # The shaken ball returns from every push, and faster orbits have longer scans.
    said = ask(
        *("search", "vibrating_table", "--vary", "omega=29.9:30.1", "--n-starts", "1"),
        *("--objective", "push"),
    )
    assert said.code == YES
    assert "No push up to 0.0" in said.out
    assert "inf" not in said.out


@pytest.mark.parametrize(
    ("wish", "named"),
    [
        ({"uncertain": {"g": (9, 10, 11)}}, "a lower and an upper end for `g`"),
        ({"uncertain": {"g": 9}}, "a lower and an upper end for `g`"),
        ({"uncertain": {"g": ("9", "10")}}, "`uncertain` must be a number"),
        ({"uncertain": {3: (1, 2)}}, "`uncertain` must have texts as names"),
        ({"direction": {1: 1.0}}, "`direction` must have texts as names"),
        ({"direction": {"theta1": "a"}}, "`direction` must be a number"),
    ],
)
def test_values_of_a_wrong_kind_are_refused_by_the_objective(
    wish: dict[str, Any], named: str
) -> None:
    with pytest.raises(zo.InputError, match=named):
        zo.MaxPush(**wish)


def test_a_corner_at_which_the_problem_has_no_parameters_is_named() -> None:
    said = ask(
        *("search", "motor_pendulum", "--objective", "robustness", "--uncertain", "g=1:60"),
        *("--vary", "Kp=2.4:2.6"),
    )
    assert said.code == MISUSE
    assert "must leave valid parameters at the corner g = 1" in said.err
