"""Largest pushes: against a closed form, the law of an impulse, long simulations, and refusals."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support import hard_to_prove
from tests.support.antidamped_spring import LIFTED, SETS, numbers, threshold
from tests.support.cases import often
from tests.support.commands import MISUSE, YES, ask, examples
from tests.support.orbits import shot_orbit
from tests.support.units import Units, in_units
from zeno_orbits.errors import InputError
from zeno_orbits.maps import Pushes

FEW = zo.PushSettings(phases=3, steps=6)


def lifted_pushes(set_: tuple[float, float, float], **parameters: float) -> Pushes:
    orbit = zo.find_orbit_by_shooting(LIFTED, parameters={**numbers(*set_), **parameters}).unwrap()
    # Phase 0.2 lies early in the contact, with a thousand seconds before the next lift.
    settings = zo.PushSettings(phases=5, steps=8, reach=40.0, error=1e-9)
    return zo.largest_push(orbit, problem=LIFTED, settings=settings)


@pytest.mark.slow
@pytest.mark.parametrize("set_", often(1, [(one,) for one in SETS[6::-3] + SETS[9::3]]))
def test_the_largest_push_gives_the_speed_of_one_flight_and_one_impact(
    set_: tuple[float, float, float],
) -> None:
    found = lifted_pushes(set_)
    up = next(push for push in found.pushes if push.phase == 0.2 and push.is_positive)
    assert up.mode == "locked"
    assert up.unit == "N s"
    assert up.beyond == "the oscillation grows"
    assert up.error <= 1e-9 * up.largest * (1 + 1e-6)
    assert up.largest == pytest.approx(threshold(*set_), rel=1e-8)


@pytest.mark.weekly
@pytest.mark.slow
def test_an_impulse_is_the_mass_times_the_speed() -> None:
    found = lifted_pushes(SETS[3], mass=2.5)
    up = next(push for push in found.pushes if push.phase == 0.2 and push.is_positive)
    assert up.largest == pytest.approx(2.5 * threshold(*SETS[3]), rel=1e-8)


@pytest.mark.weekly
@pytest.mark.slow
def test_a_push_onto_the_stop_is_never_lost_as_the_stop_takes_it() -> None:
    found = lifted_pushes(SETS[3])
    onto = [p for p in found.pushes if p.mode == "locked" and not p.is_positive]
    assert onto
    assert all(math.isnan(push.largest) for push in onto)


@pytest.mark.slow
def test_below_its_first_flip_the_shaken_ball_returns_from_every_push() -> None:
    # The acceleration of the table is 1.38 g: the ball is thrown once a turn.
    orbit = zo.find_orbit("vibrating_table").unwrap()
    found = zo.largest_push(orbit, settings=zo.PushSettings(phases=4, steps=8, reach=5.0))
    assert found.least is None
    assert found.as_json()["least"] is None
    assert {push.as_json()["largest"] for push in found.pushes} == {None}


@pytest.mark.slow
def test_a_push_that_ends_on_the_coexisting_orbit_is_lost_and_names_it() -> None:
    # At A = 0.02 the table has an orbit with a Zeno point and one with one impact per period.
    result = zo.find_orbit("vibrating_table", parameters={"A": 0.02})
    orbit = result.unwrap()
    found = zo.largest_push(orbit, settings=zo.PushSettings(phases=4, steps=12, reach=3.0))
    assert found.least is not None
    assert found.least.beyond.startswith("another periodic orbit without a Zeno point")


@pytest.mark.slow
def test_the_least_push_of_the_pendulum_separates_return_from_loss(
    orbit: zo.Orbit, problem: zo.Problem
) -> None:
    found = zo.largest_push(orbit, settings=replace(FEW, steps=12))
    least = found.least
    assert least is not None
    start = orbit.phases[0].start_state
    whole = zo.simulate(problem, gains=dict(orbit.gains), start=start, until=orbit.period)
    state = whole.state_at(least.phase * orbit.period)
    (inverse,), _ = problem.inverse_masses(orbit.values(problem), state[None])
    force = np.array([least.direction.get(name, 0.0) for name in problem.state_names[:2]])

    def settles(impulse: float) -> bool:
        """Follow the pushed motion by the simulator alone: has it the orbit's releases at last?"""
        pushed = state.copy()
        pushed[2:4] += impulse * inverse @ force
        begin = dict(zip(problem.state_names, pushed.tolist(), strict=True))
        try:
            motion = zo.simulate(problem, gains=dict(orbit.gains), start=begin, until=60.0)
        except zo.SimulationError:
            return False
        last = motion.releases[-1].state if motion.releases else np.full(5, np.inf)
        named = dict(zip(problem.state_names, last.tolist(), strict=True))
        return all(abs(named[name] - start[name]) < 1e-3 for name in ("theta1", "dtheta1"))

    # In contact the pushed state leaves the stop in this direction, or it is in flight.
    assert settles(0.98 * least.largest)
    assert not settles(1.02 * (least.largest + least.error))


def test_an_impulse_in_contact_changes_no_gap_rate_and_the_stop_only_pushes(
    orbit: zo.Orbit, problem: zo.Problem
) -> None:
    from zeno_orbits.maps import pushed

    values = orbit.values(problem)
    dynamics = problem.dynamics(values)
    state = np.array(problem.state_vector(orbit.zeno_state))
    (inverse,), (energy,) = problem.inverse_masses(values, state[None])
    mass = np.linalg.inv(inverse)
    assert energy == pytest.approx(0.5 * state[2:4] @ mass @ state[2:4])
    for angle in np.linspace(0.0, 2 * np.pi, 9):
        force = 0.02 * np.array([np.cos(angle), np.sin(angle)])
        after = pushed(problem.graph_dynamics(values), state, inverse @ force, (0,))
        # The gap is theta2, so the impulse of the stop acts along its second entry.
        along, of_stop = mass @ (after[2:4] - state[2:4]) - force
        assert along == pytest.approx(0.0, abs=1e-14)
        rate = dynamics.gap_rate(after)
        assert rate >= 0.0
        assert of_stop >= -1e-14
        assert abs(rate * of_stop) < 1e-14


@pytest.mark.weekly
@pytest.mark.slow
def test_a_push_is_the_same_in_grams_millimetres_and_milliseconds() -> None:
    units = Units(mass=1e3, length=1e3, time=1e3)
    problem = zo.load_problem("motor_pendulum")
    other = in_units(problem, units)
    there, here = (
        zo.largest_push(zo.find_orbit(one).unwrap(), problem=one, settings=FEW)
        for one in (other, problem)
    )
    impulse = units.mass * units.length**2 / units.time
    for one, two in zip(there.pushes, here.pushes, strict=True):
        assert one.beyond == two.beyond
        if math.isfinite(two.largest):
            assert abs(one.largest / impulse - two.largest) <= 2 * two.error


@pytest.mark.weekly
@pytest.mark.slow
def test_several_workers_find_the_same(orbit: zo.Orbit) -> None:
    alone = zo.largest_push(orbit, settings=FEW)
    assert zo.largest_push(orbit, settings=FEW, workers=2).as_json() == alone.as_json()


@pytest.mark.slow
def test_the_command_prints_the_least_push_first_and_writes_all(
    orbit: zo.Orbit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    zo.write_orbit(orbit, tmp_path / "orbit.json")
    words = ("--phases", "2", "--steps", "6", "-j", "1")
    answer = ask("push", "orbit.json", *words, "-o", "push.json", "--plot", "push.png")
    assert answer.code == YES
    assert answer.out.startswith("Least push: ")
    data = json.loads((tmp_path / "push.json").read_text())
    found = zo.largest_push(orbit, settings=zo.PushSettings(phases=2, steps=6))
    assert data == found.as_json()
    assert data["least"] == min(
        (one for one in data["pushes"] if one["largest"] is not None),
        key=lambda one: one["largest"],
    )
    assert (tmp_path / "push.png").stat().st_size > 5000


@pytest.mark.weekly
@pytest.mark.slow
@pytest.mark.parametrize("example", examples("push"), ids=" ".join)
def test_an_example_of_the_help_runs(
    example: tuple[str, ...],
    orbit: zo.Orbit,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    zo.write_orbit(orbit, tmp_path / "orbit.json")
    answer = ask(*example)
    assert answer.code == YES
    assert answer.out.startswith("Least push: ")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--directions", "theta3=1"), "--directions theta3=1: unknown name `theta3`"),
        (("--directions", "theta1=0"), "must have one finite component that is not zero"),
        (("--directions", "theta1=nan"), "must have one finite component that is not zero"),
        (("--directions", "dtheta1=1"), "unknown name `dtheta1`"),
        (("--directions", "theta1=1,theta1=2"), "must name `theta1` once"),
        (("--phases", "0"), "--phases: must be a positive whole number, but it is `0`"),
        (("--error", "2"), "--error: must lie in (0, 1), but it is 2"),
        (("--reach", "-1"), "--reach -1: must be positive"),
        (("--problem", "motor_valve"), "must be the problem `motor_pendulum` of the orbit"),
    ],
)
def test_a_push_that_makes_no_sense_is_one_line(
    words: tuple[str, ...],
    told: str,
    orbit: zo.Orbit,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    zo.write_orbit(orbit, tmp_path / "orbit.json")
    answer = ask("push", "orbit.json", *words)
    assert (answer.code, answer.out, answer.err.count("\n")) == (MISUSE, "", 1), answer.err
    assert told in answer.err


def test_an_orbit_that_repels_is_refused_though_the_one_that_attracts_has_its_period() -> None:
    problem = hard_to_prove.double_well()
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    with pytest.raises(InputError, match="must be stable, but"):
        zo.largest_push(orbit, problem=problem)


@pytest.mark.weekly
@pytest.mark.slow
def test_pushes_that_no_simulation_can_follow_are_lost() -> None:
    orbit = shot_orbit("motor_pendulum")
    settings = zo.PushSettings(phases=1, steps=1, reach=1e100)
    found = zo.largest_push(orbit, directions=[{"theta2": 1.0}], settings=settings)
    assert found.least is not None
    assert found.least.beyond == "link 1 rotates"
    assert found.least.largest < 1.0


@pytest.mark.parametrize("size", [1e-200, 1e308])
def test_a_direction_whose_square_is_no_double_is_refused(orbit: zo.Orbit, size: float) -> None:
    with pytest.raises(InputError, match="must have a largest entry from 1e-100 to 1e"):
        zo.largest_push(orbit, directions=[{"theta1": size}], settings=FEW)
