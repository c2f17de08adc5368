"""Old public names: each still works, with a warning that names the new one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import zeno_orbits as zo
import zeno_orbits.work
from zeno_orbits.aliases import ALIASES

SAME = sorted(set(ALIASES) - {"QUICK", "cut", "positive", "restitution", "rig_cycles", "trade"})
"""Names of which only the word changed."""


def old(name: str) -> object:
    """Return the object of an old name, which must give a warning."""
    new = ALIASES[name][0]
    with pytest.warns(
        DeprecationWarning, match=rf"zeno_orbits\.{name} is now zeno_orbits\."
    ) as told:
        found = getattr(zo, name)
    assert len(told) == 1
    assert new in str(told[0].message)
    assert told[0].filename == __file__
    return found


@pytest.mark.parametrize("name", SAME)
def test_an_old_name_is_the_object_of_its_new_name(name: str) -> None:
    assert old(name) is getattr(zo, ALIASES[name][0])


@pytest.mark.parametrize("name", ALIASES)
def test_an_old_name_is_no_public_name_any_more(name: str) -> None:
    assert name not in zo.__all__
    assert name not in dir(zo)
    assert ALIASES[name][0].partition(".")[0] in zo.__all__


def test_an_old_name_can_be_imported_from_the_package() -> None:
    with pytest.warns(DeprecationWarning, match="zeno_orbits.LeastEnergy is now"):
        exec("from zeno_orbits import LeastEnergy")


def test_quantities_made_by_old_names_are_those_of_the_class() -> None:
    mass = zo.Quantity.positive("m", 1.0, "kg", "mass", instead="Leave it out.")
    assert old("positive")("m", 1.0, "kg", "mass", instead="Leave it out.") == mass
    assert old("restitution")(0.3) == zo.Quantity.restitution(0.3)
    assert (mass.lower, mass.excluded) == (0.0, (0.0,))


def test_the_old_quick_settings_are_those_of_the_class() -> None:
    assert old("QUICK") == zo.WorkPrecisionSettings.quick()
    assert zo.WorkPrecisionSettings.quick() != zo.WorkPrecisionSettings()


def test_old_functions_keep_their_arguments(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time [s],height [m]\n0,0.0\n1,0.5\n2,0.9\n")
    recording = zo.read_recording(path)
    part = old("cut")(recording, since=0.5, until=2.0)
    assert part.time.tolist() == [1.0, 2.0]
    assert zo.crop(recording, t_start=0.5, t_end=2.0).time.tolist() == part.time.tolist()
    ball = zo.load_problem("bouncing_ball")
    state = ball.state_vector({"height": 1.0})
    few = replace(
        zo.WorkPrecisionSettings.quick(), until=1.0, tolerances=(1e-6,), cuts=(), impacts=()
    )
    values = ball.values(parameters={"restitution": 0.3})
    before = old("trade")(ball, values, state, settings=few)
    after = zo.work_precision(
        ball, start={"height": 1.0}, parameters={"restitution": 0.3}, settings=few
    )
    assert [one.name for one in before.trials] == [one.name for one in after.trials]
    assert max(one.error for one in after.trials) < 1.0


def test_the_old_rig_run_of_an_orbit_has_the_cycles_of_the_new_one() -> None:
    table = zo.load_problem("vibrating_table")
    orbit = zo.find_orbit_by_shooting(table).unwrap()
    before = old("rig_cycles")(orbit, table, cycles=1, settle=1)
    after = zo.simulate_experiment(orbit, cycles=1, settle=1)
    assert before.cycles[0].period == after.cycles[0].period
    # The shaken table returns after one turn of its clock, the rig within its compliance.
    assert abs(after.cycles[0].period - orbit.period) < 1e-2 * orbit.period


def test_the_accuracy_of_a_simulation_takes_a_problem_or_its_dynamics() -> None:
    ball = zo.load_problem("bouncing_ball")
    dynamics, state = ball.dynamics(ball.values()), ball.state_vector({"height": 1.0})
    one = zo.simulate_to_accuracy(dynamics, state, until=0.6, accuracy=1e-8)
    other = zo.simulate_to_accuracy(ball, start={"height": 1.0}, until=0.6, accuracy=1e-8)
    # A fall from 1 m: sqrt(2 / g).
    g = ball.values().parameters["g"]
    for found in (one, other):
        assert abs(found.execution.impacts[0].time - (2.0 / g) ** 0.5) < 1e-8
    with pytest.raises(zo.InputError, match="needs `state`"):
        zo.simulate_to_accuracy(dynamics, accuracy=1e-8)
    with pytest.raises(zo.InputError, match="exclude each other"):
        zo.simulate_with_error(ball, state, start={"height": 1.0})


def test_the_old_name_of_a_failed_point_gives_its_class() -> None:
    with pytest.warns(DeprecationWarning, match="is now zeno_orbits.work.FailedPoint"):
        from zeno_orbits.work import LostPoint
    assert LostPoint is zeno_orbits.work.FailedPoint
