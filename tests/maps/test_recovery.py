"""Recovery: against a state with a closed form, simulations, laws of the norm, and refusals."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq

import zeno_orbits as zo
from tests.support import hard_to_prove
from tests.support.commands import MISUSE, YES, ask, examples
from tests.support.orbits import shot_orbit
from tests.support.units import Units, in_units

OMEGA, GRAVITY = 30.0, 9.81


def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a ball on a shaken table, and a further state that does not act on it."""
    gap, speed, z = ca.SX.sym("gap"), ca.SX.sym("speed"), ca.SX.sym("z")
    clock = zo.Clock.at(p["omega"])
    ball = zo.HybridLagrangian.from_energies(
        q=gap,
        v=speed,
        kinetic=speed**2 / 2,
        potential=GRAVITY * gap,
        gap=gap,
        applied_force=p["A"] * p["omega"] ** 2 * clock.sine,
        clock=clock,
    )
    further = zo.Auxiliary(states=z, rate=-p["a"] * z + p["b"] * z**2)
    return zo.hybrid_system(ball, further, p["restitution"])


SHAKEN = zo.Problem(
    name="shaken_with_a_further_state",
    title="ball on a shaken table, and a state with a basin of its own",
    source="these tests",
    state_names=("gap", "speed", "z", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1", "1"),
    parameters=(
        zo.Quantity.positive("A", 0.015, "m", "amplitude of the table"),
        zo.Quantity.positive("omega", OMEGA, "rad/s", "its frequency"),
        zo.Quantity.positive("a", 2.0, "1/s", "decay of the further state"),
        zo.Quantity.positive("b", 1.0, "1/s", "its growth"),
        zo.Quantity.restitution(0.3),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0, "z": 0.1},),
    portraits=(("gap", "speed"),),
    amplitude_of="gap",
)


def recovered(a: float, b: float, **settings: float) -> zo.Recovery:
    orbit = zo.find_orbit_by_shooting(SHAKEN, parameters={"a": a, "b": b}).unwrap()
    chosen = zo.RecoverySettings(**settings)  # type: ignore[arg-type]
    return zo.recovery(orbit, problem=SHAKEN, settings=chosen)


@cache
def of_pendulum() -> tuple[zo.Orbit, zo.Recovery]:
    orbit = shot_orbit("motor_pendulum")
    return orbit, zo.recovery(orbit)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 5))]
)
def test_time_and_ball_of_a_state_with_a_closed_form(seed: int) -> None:
    # `z' = -a z + b z^2` decays below `a/b` and grows above it: the ball ends there. A period
    # multiplies a small `z` by `exp(-a T)`.
    drawn = random.Random(seed)
    a = drawn.uniform(0.5, 20.0)
    # The start at 0.1 lies inside the basin.
    b = a * 10 ** drawn.uniform(-1.0, 0.9)
    found = recovered(a, b, part=1e-3, error=1e-3, samples=50, seed=seed)
    period = 2 * math.pi / OMEGA
    assert found.spectral_radius == pytest.approx(math.exp(-a * period), rel=1e-6)
    assert found.contraction == pytest.approx(found.spectral_radius, rel=1e-9)
    assert found.periods == math.ceil(math.log(1e3) / (a * period))
    assert found.time == pytest.approx(found.periods * period, rel=1e-9)
    assert 1.0 - 2e-3 < found.extents["z"] * b / a < 1.0 + 1e-6
    assert [name for name, extent in found.extents.items() if extent > 1e-9] == ["z"]


@pytest.mark.slow
def test_a_derivative_contracts_in_the_norm_and_slower_than_its_eigenvalues() -> None:
    orbit, found = of_pendulum()
    slope = zo.floquet_multipliers(orbit).jacobian
    assert np.all(np.linalg.eigvalsh(found.norm) > 0.0)
    assert found.spectral_radius <= found.contraction < (1 + found.spectral_radius) / 2
    assert found.spectral_radius == pytest.approx(max(abs(np.linalg.eigvals(slope))), rel=1e-6)


def norm_of(found: zo.Recovery, change: np.ndarray) -> float:
    y = np.linalg.lstsq(found.directions, change, rcond=None)[0]
    return float(np.sqrt(y @ found.norm @ y))


@pytest.mark.slow
def test_a_simulated_disturbance_decays_to_the_part_in_the_periods() -> None:
    orbit, found = of_pendulum()
    problem = zo.load_problem("motor_pendulum")
    release = np.array(problem.state_vector(orbit.release_state))
    drawn = np.random.default_rng(1)
    for _ in range(5):
        change = found.directions @ drawn.standard_normal(2)
        change *= 1e-5 / norm_of(found, change)
        start = problem.dynamics(orbit.values(problem)).on_stop(release + change)
        before = norm_of(found, start - release)
        run = zo.simulate_with_error(problem, start, until=3.2 * orbit.period).execution
        after = norm_of(found, run.releases[found.periods].state - release)
        # The start is a release, and the orbit is known to 1e-10.
        assert after < found.settings.part * before + 1e-9


@pytest.mark.slow
def test_points_of_the_ball_return_into_it_and_some_beyond_it_do_not() -> None:
    orbit, found = of_pendulum()
    problem = zo.load_problem("motor_pendulum")
    dynamics = problem.dynamics(orbit.values(problem))
    release = np.array(problem.state_vector(orbit.release_state))
    drawn = np.random.default_rng(7)
    back = np.linalg.inv(np.linalg.cholesky(found.norm).T)

    def release_near(z: np.ndarray) -> np.ndarray:
        """Return the release state at an angle and a rate: the current takes the force away."""
        state = release + found.directions @ (back @ z)

        def force(current: float) -> float:
            return float(dynamics.locked.guard(np.array([*state[:4], current]))[0])

        state[4] = brentq(force, state[4] - 0.1, state[4] + 0.1, xtol=1e-15)
        return state

    def lost(radius: float, count: int) -> int:
        outside = 0
        for _ in range(count):
            z = drawn.standard_normal(2)
            z *= radius * math.sqrt(drawn.uniform()) / np.linalg.norm(z)
            try:
                run = zo.simulate_with_error(
                    problem, release_near(z), until=3 * orbit.period
                ).execution
            except zo.SimulationError:
                outside += 1
                continue
            later = [one for one in run.releases if one.time > 0.5 * orbit.period]
            inside = later and norm_of(found, later[0].state - release) <= found.radius
            outside += not inside
        return outside

    assert lost(found.radius, 300) <= 3 * found.lost_share * 300
    assert lost(3.0 * found.radius, 100) > 0


@pytest.mark.slow
def test_the_statement_about_the_share_is_that_of_all_tests_together() -> None:
    _, found = of_pendulum()
    doubt = (1 - found.lost_share) ** found.settings.samples
    assert doubt == pytest.approx(0.05 / (found.tests * (found.tests + 1)), rel=1e-9)
    worse = replace(found, tests=found.tests + 1)
    assert worse.lost_share > found.lost_share


@pytest.mark.slow
def test_the_recovery_is_the_same_in_other_units() -> None:
    orbit, found = of_pendulum()
    del orbit
    other = in_units(zo.load_problem("motor_pendulum"), Units(mass=1e3, length=1e3, time=1e3))
    moved = zo.recovery(zo.find_orbit_by_shooting(other).unwrap(), problem=other)
    assert moved.periods == found.periods
    assert moved.contraction == pytest.approx(found.contraction, rel=1e-3)
    assert moved.extents["theta1"] == pytest.approx(found.extents["theta1"], rel=0.05)
    assert moved.extents["dtheta1"] == pytest.approx(found.extents["dtheta1"] / 1e3, rel=0.05)


def test_an_orbit_whose_section_is_a_point_recovers_in_one_period() -> None:
    orbit = shot_orbit("motor_valve")
    found = zo.recovery(orbit)
    assert (found.periods, found.contraction, found.radius) == (1, 0.0, math.inf)
    assert found.norm.shape == (0, 0)
    assert found.as_json()["radius"] is None


@pytest.mark.slow
def test_the_command_prints_time_ball_and_share(tmp_path: Path) -> None:
    orbit, found = of_pendulum()
    path = tmp_path / "orbit.json"
    zo.write_orbit(orbit, path)
    answer = ask("recovery", path, "-o", tmp_path / "recovery.json")
    assert answer.code == YES
    assert answer.out.startswith("A small disturbance decays to 1 % in 2 periods (3.62743 s)")
    assert "300 samples return: with confidence 95 %, at most" in answer.out
    data = json.loads((tmp_path / "recovery.json").read_text())
    assert data == ask("recovery", path, "--json").data
    assert data["radius"] == found.radius
    point = shot_orbit("motor_valve")
    zo.write_orbit(point, path)
    assert "The section of the orbit is a single point." in ask("recovery", path).out


@pytest.mark.slow
def test_the_examples_of_the_help_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    zo.write_orbit(of_pendulum()[0], "orbit.json")
    for words in examples("recovery"):
        assert ask(*words).code == YES


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--decay", "0"), "--decay"),
        (("--decay", "2"), "--decay"),
        (("--samples", "0"), "--samples"),
        (("--confidence", "1"), "--confidence"),
        (("--error", "-1"), "--error"),
        (("--problem", "motor_cart"), "`motor_pendulum`"),
    ],
    ids=lambda words: " ".join(words) if isinstance(words, tuple) else "",
)
def test_bad_options_are_one_line(words: tuple[str, ...], said: str, tmp_path: Path) -> None:
    path = tmp_path / "orbit.json"
    zo.write_orbit(of_pendulum()[0], path)
    answer = ask("recovery", path, *words)
    assert answer.code == MISUSE
    assert answer.err.count("\n") == 1
    assert said in answer.err


def test_orbits_that_do_not_attract_or_do_not_close_are_refused() -> None:
    orbit, _ = of_pendulum()
    moved = {**orbit.release_state, "theta1": orbit.release_state["theta1"] + 1e-3}
    phase = replace(orbit.phases[0], start_state=moved)
    with pytest.raises(zo.InputError, match="must be closed"):
        zo.recovery(orbit.with_phases((phase,)))
    problem = hard_to_prove.double_well()
    unstable = zo.find_orbit_by_shooting(problem).unwrap()
    with pytest.raises(zo.InputError, match="must be stable"):
        zo.recovery(unstable, problem=problem)


@pytest.mark.parametrize(
    ("settings", "named"),
    [({"error": 1e-17}, "`error` must be at least 1e-12"), ({"seed": -1}, "`seed` must not be")],
)
def test_a_step_that_doubles_cannot_resolve_and_a_negative_seed_are_refused(
    settings: dict[str, Any], named: str
) -> None:
    with pytest.raises(zo.InputError, match=named):
        zo.RecoverySettings(**settings)
