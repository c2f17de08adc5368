"""The machine with its feedback: multipliers by two routes, files, commands, and refusals."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.commands import MISUSE, NO, YES, ask
from tests.support.orbits import event_orbit
from tests.support.repelling import GAINS, KD, START
from zeno_orbits.errors import InputError

RANGE = {"Kd": (-1.83, -1.33)}


@pytest.fixture(name="here")
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


MACHINES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "hopper": ({}, {"inputs": ["a"]}),
    "motor_pendulum": ({"gains": {"Kp": 2.5, "Kd": -1.1}}, {"inputs": ["Kd"], "delay": True}),
    "impact_oscillator": ({}, {"inputs": ["A"]}),
    "limited_pendulum": ({}, {"inputs": ["Kp", "Kd"]}),
    "powered_walker": ({}, {"inputs": ["Kp", "Kd"]}),
    "motor_pendulum at its Zeno point": (
        {"gains": {"Kp": 2.5, "Kd": -1.1}},
        {"inputs": ["Kd"], "section": "zeno stop"},
    ),
}


@pytest.mark.parametrize("case", fast(2, MACHINES))
def test_the_machine_has_the_multipliers_of_the_design(case: str) -> None:
    how, asked = MACHINES[case]
    found = zo.design_feedback(zo.find_orbit(case.split()[0], **how).unwrap(), **asked)
    machine = found.machine()
    orbit = zo.find_orbit_by_shooting(machine).unwrap()
    assert orbit.period == pytest.approx(found.returns.period, rel=1e-10)
    values = np.array(zo.floquet_multipliers(orbit, problem=machine).values)
    wished = np.array(found.multipliers)
    n = int(np.sum(np.abs(wished) > 1e-4))
    assert n > 0
    assert np.sort_complex(values[:n]) == pytest.approx(np.sort_complex(wished[:n]), abs=1e-8)
    assert np.max(np.abs(values[n:]), initial=0.0) < 1e-3
    certificate = zo.verify(orbit, problem=machine)
    assert certificate.passed, certificate.verdict()


@pytest.mark.slow
def test_the_machine_follows_the_law_of_the_feedback(repelling: zo.Orbit) -> None:
    found = zo.design_feedback(repelling, RANGE)
    machine = found.machine()
    motion = found.run(found.returns.fixed_point * [1.004, 1.0], 8)
    state = found.returns.state(motion.points[0]) | {"held_Kd": float(motion.inputs[0, 0])}
    run = zo.simulate(machine, start=state, until=17.5)
    settings = [one for one in run.switches if one.time > 0.5]
    assert len(settings) == 8
    places = [machine.state_names.index(name) for name in ("dtheta1", "current", "held_Kd")]
    for k, event in enumerate(settings):
        assert event.time == pytest.approx(motion.times[k + 1], rel=1e-9)
        assert event.state_plus[places[:2]] == pytest.approx(motion.points[k + 1], rel=1e-8)
        assert event.state_plus[places[2]] == pytest.approx(
            found.inputs_at(event.state_plus[places[:2]])[0], rel=1e-13
        )


@pytest.mark.slow
def test_a_repelling_orbit_is_held_for_a_thousand_periods(repelling: zo.Orbit) -> None:
    machine = zo.design_feedback(repelling, RANGE).machine()
    start = dict(zip(machine.state_names, machine.initial_state(), strict=True))
    run = zo.simulate(
        machine, start={**start, "dtheta1": 1.001 * start["dtheta1"]}, until=1001 * 2.11026135
    )
    values = np.array([one.state_plus for one in run.switches])
    assert len(values) >= 1000
    centre = np.array([start[name] for name in machine.state_names])
    assert np.max(np.abs(values[40:] - centre)) < 1e-11
    free = zo.simulate(
        "motor_pendulum",
        gains=GAINS,
        start={**START, "dtheta1": 1.001 * START["dtheta1"]},
        until=20.0,
    )
    away = [abs(one.state[2] - START["dtheta1"]) for one in free.releases if one.time > 0.5]
    assert max(away[:8]) > 0.3


@pytest.mark.slow
def test_files_and_commands_take_the_machine(repelling: zo.Orbit, here: Path) -> None:
    zo.write_orbit(repelling, "orbit.json")
    words = ("feedback", "orbit.json", "--input", "Kd=-1.83:-1.33")
    assert "Written: held.py" in ask(*words, "--machine", "held.py").out
    answer = ask("search", "held.py", "-o", "held.json")
    assert answer.code == YES, answer.err
    held = zo.read_orbit("held.json")
    assert held.sequence == ("zeno stop", "release stop", "switch hold at release stop")
    assert ask("verify", "held.json").code == YES
    assert "0.343624" in ask("stability", "held.json").out
    # A problem file of a problem file.
    again = zo.design_feedback("held.json", ["Kp"]).machine("again.py")
    assert again.state_names[-2:] == ("held_Kd", "held_Kp")
    assert zo.find_orbit_by_shooting("again.py").unwrap().period == pytest.approx(held.period)
    refused = ask("prove", "held.json")
    assert refused.code == NO
    assert "an event of a stop sets states anew" in refused.out
    assert ask(*words, "--machine", "held.txt").code == MISUSE
    assert sorted(path.name for path in here.iterdir()) == [
        *("again.py", "held.json", "held.py", "orbit.json"),
    ]


@pytest.mark.slow
def test_the_rig_holds_the_orbit_and_without_feedback_leaves_it(repelling: zo.Orbit) -> None:
    machine = zo.design_feedback(repelling, RANGE).machine()
    rig = zo.Rig(contact=zo.Contact(stiffness=1e7))
    run = zo.simulate_rig(machine, rig, until=42.0)
    rested = [one for one in run.touches if 0.1 < one.end - one.start < 1.0]
    assert len(rested) == 19
    periods = np.diff([one.end for one in rested])
    assert periods == pytest.approx(np.full(18, repelling.period), rel=1e-3)
    held = [one.end_state[machine.state_names.index("held_Kd")] for one in rested]
    assert held[-1] == pytest.approx(KD, abs=1e-3)
    with pytest.raises(zo.SimulationError, match="ran away"):
        zo.simulate_rig("motor_pendulum", rig, gains=GAINS, start=START, until=42.0)


@pytest.mark.slow
def test_a_parabola_through_readings_holds_the_orbit_that_a_filter_loses(
    repelling: zo.Orbit,
) -> None:
    machine = zo.design_feedback(repelling, RANGE).machine()

    def run(window: float) -> zo.RigRun:
        sensors = zo.Sensors(filter_time=2e-3, window=window)
        stiff, sampled = zo.Contact(stiffness=1e6), zo.Controller(period=1e-3)
        rig = zo.Rig(contact=stiff, controller=sampled, sensors=sensors)
        return zo.simulate_rig(machine, rig, until=17.0)

    place = machine.state_names.index("held_Kd")
    held = [one.end_state[place] for one in run(0.03).touches if 0.1 < one.end - one.start < 1.0]
    assert len(held) == 8
    # The parabola misses the rate by 0.008 rad/s, which the loop multiplies by four.
    assert held[2:] == pytest.approx([KD] * 6, abs=0.02)
    with pytest.raises(zo.SimulationError, match="ran away"):
        run(0.0)


def test_rounding_of_the_orbit_does_not_set_the_scale_of_the_machine() -> None:
    # The distance of this start was 6e-15 m, which gave gaps a scale of 1e-12 m.
    start = {"speed": 2.6803551243281465, "cosine": -0.5698815439487501}
    start["sine"] = math.sqrt(1 - start["cosine"] ** 2)
    parameters = {"omega": 1.745806347612351}
    orbit = zo.find_orbit_by_shooting("impact_oscillator", parameters=parameters, start=start)
    found = zo.design_feedback(orbit.unwrap(), {"A": (0.0, 2.0)})
    machine = found.machine()
    own = zo.load_problem("impact_oscillator").dynamics(
        orbit.unwrap().values(found.returns.problem)
    )
    assert machine.graph_dynamics(machine.values()).own.gap == own.own.gap
    point = found.returns.fixed_point + 1e-3 * found.returns.sizes
    first = {**found.returns.state(point), "held_A": float(found.inputs_at(point)[0])}
    assert len(zo.simulate(machine, start=first, until=100.0).impacts) == 27


def test_a_held_input_that_is_zero_leaves_the_multipliers_exact() -> None:
    # The held pull is a coefficient times the errors of the speed, and no unit of its error.
    start = {"speed": 0.9131562646434344, "cosine": 0.25365451795650656, "sine": 0.9672948803339385}
    parameters = {"A": 0.015}
    orbit = zo.find_orbit_by_shooting("table_juggler", parameters=parameters, start=start)
    found = zo.design_feedback(orbit.unwrap(), ["pull"], weight=0.0)
    machine = found.machine()
    stability = zo.floquet_multipliers(zo.find_orbit_by_shooting(machine).unwrap(), problem=machine)
    assert stability.stable
    assert stability.error < 1e-6
    assert stability.values[0] == pytest.approx(found.multipliers[0], rel=1e-7)


def _juggler(unit: float) -> tuple[zo.Problem, zo.Orbit]:
    """Return the juggled ball with lengths in another unit, and its repelling orbit."""
    known = zo.load_problem("table_juggler")
    sizes = {"A": unit, "g": unit}
    values = {"A": 0.015}
    parameters = tuple(
        replace(one, default=values.get(one.name, one.default or 0.0) * sizes.get(one.name, 1.0))
        for one in known.parameters
    )
    start = {"speed": 0.9131562646434344 * unit}
    start |= {"cosine": 0.25365451795650656, "sine": 0.9672948803339385}
    problem = replace(known, name="ball", parameters=parameters, starts=(start,))
    return problem, zo.find_orbit_by_shooting(problem).unwrap()


@pytest.mark.slow
@pytest.mark.parametrize("unit", fast(1, [1e3, 1e-3, 1e6]))
def test_a_held_input_that_is_zero_has_the_scale_of_its_law_in_any_unit(unit: float) -> None:
    problem, orbit = _juggler(unit)
    # Least squares do not depend on the unit: the gain is the one in metres.
    si = zo.design_feedback(_juggler(1.0)[1], ["pull"], problem=_juggler(1.0)[0])
    found = zo.design_feedback(orbit, ["pull"], problem=problem)
    sizes = np.array([1.0 if one == "speed" else unit for one in si.returns.coordinates])
    assert found.gain[0] / sizes == pytest.approx(si.gain[0], rel=1e-7)
    placed = zo.design_feedback(
        orbit, ["pull"], problem=problem, method="place", multipliers=[0.2, 0.1]
    )
    assert placed.multipliers == pytest.approx((0.2, 0.1), abs=1e-9)
    machine = placed.machine()
    held = zo.find_orbit_by_shooting(machine).unwrap()
    values = zo.floquet_multipliers(held, problem=machine).values
    assert values[:2] == pytest.approx((0.2, 0.1), abs=1e-8)
    again = zo.return_map(held, problem=machine).multipliers
    assert again[:3] == pytest.approx(values, abs=1e-11)
    certificate = zo.verify(held, problem=machine)
    assert certificate.passed, certificate.verdict()


def test_an_input_without_effect_stays_without_one() -> None:
    problem, orbit = _juggler(1.0)
    with pytest.raises(InputError, match="`m` does not change the multiplier -2"):
        zo.design_feedback(orbit, ["m"], problem=problem)


def _top(p: Any) -> Any:
    """Return the juggled ball with a switch at the top of its flight, which resets nothing."""
    ball = zo.load_problem("table_juggler").model(p).bare
    height, speed = ball.q, ball.v
    top = zo.Switch(name="top", guard=speed, armed=height)
    return zo.hybrid_system(ball, zo.no_drive(ball), p["restitution"], switches=[top])


@pytest.mark.slow
def test_a_machine_can_begin_that_is_set_at_a_switch_without_a_reset() -> None:
    problem = replace(_juggler(1.0)[0], name="topped", model=_top)
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    found = zo.design_feedback(orbit, ["pull"], problem=problem, section="switch top")
    machine = found.machine()
    assert len(zo.simulate(machine, until=1.05 * orbit.period).impacts) == 1
    held = zo.find_orbit_by_shooting(machine).unwrap()
    values = np.array(zo.floquet_multipliers(held, problem=machine).values[:2])
    assert values == pytest.approx(np.array(found.multipliers), abs=1e-8)


def test_kinks_set_no_held_states() -> None:
    found = zo.design_feedback(zo.find_orbit("hopper").unwrap(), ["a"], section="switch kink 1")
    with pytest.raises(InputError, match="`section`: `switch kink 1` is a kink"):
        found.machine()


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"inputs": {}}, "`inputs` must name at least one"),
        ({"inputs": {"b": None}}, "`b`"),
        ({"inputs": {"a": (3.0, 1.0)}}, "must have a range LOWER <= UPPER for `a`"),
        ({"at": "impact"}, "`at` must be an event"),
        ({"gain": {}}, "`gain` lacks the coefficient of `speed` in `a`"),
        ({"gain": {"a": {"speed": float("nan")}}}, "gain of speed"),
        ({"centre": {"sped": 1.0}, "gain": {"a": {"sped": 1.0}}}, "Did you mean `speed`?"),
        ({"delay": True}, "`gain` lacks the coefficient of `a` in `a`"),
    ],
)
def test_a_wrong_law_is_named(changed: dict[str, Any], told: str) -> None:
    law: dict[str, Any] = {
        "inputs": {"a": None},
        "at": "impact stop",
        "gain": {"a": {"speed": 1.0}},
        "centre": {"speed": 1.0},
    }
    with pytest.raises(InputError) as error:
        zo.hold_inputs("hopper", **law | changed)
    assert told in str(error.value)


@pytest.mark.slow
def test_an_input_of_a_switching_time_is_refused_as_a_state() -> None:
    found = zo.design_feedback(event_orbit("relay_soft"), ["t1"])
    with pytest.raises(InputError, match="`t1` determines a switching time of a waveform"):
        found.machine()
