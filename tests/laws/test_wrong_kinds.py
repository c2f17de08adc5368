"""Nonsense at the public doors: one line with the name of the argument, never a raw error."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import pytest

import zeno_orbits as zo
from zeno_orbits.experiment import RigSettings
from zeno_orbits.simulation import FixedImpacts, PlasticAfter, ZenoExtrapolation, ZenoPassage

NONSENSE = (
    object(),
    None,
    "2",
    "no such thing",
    10**400,
    math.nan,
    1j,
    [],
    {},
    [1, 2],
    ("a",),
    b"x",
)


@cache
def ball() -> zo.Problem:
    return zo.load_problem("bouncing_ball")


@cache
def motion() -> zo.Execution:
    return zo.simulate(ball(), until=0.5)


@cache
def samples() -> zo.Recording:
    return zo.sample_execution(ball(), motion())


@cache
def orbit() -> zo.Orbit:
    return zo.find_orbit_by_shooting("motor_pendulum").orbit


X, Y = ("Kp", 2.0, 3.0, 1), ("Kd", -1.0, -0.9, 1)

DOORS: dict[str, Callable[[Any], object]] = {
    "problem": lambda bad: zo.simulate(bad),
    "until": lambda bad: zo.simulate(ball(), until=bad),
    "gains": lambda bad: zo.simulate(ball(), gains=bad or [0], until=0.1),
    "parameters": lambda bad: zo.simulate(ball(), parameters={"e": bad}, until=0.1),
    "start": lambda bad: zo.simulate(ball(), start=bad or [0], until=0.1),
    "Kp": lambda bad: zo.find_orbit("motor_pendulum", gains={"Kp": bad}),
    "theta1": lambda bad: zo.find_orbit_by_shooting("motor_pendulum", start={"theta1": bad}),
    "vary": lambda bad: zo.search_gains("motor_pendulum", vary={"Kp": (1.0, bad)}),
    "energy": lambda bad: zo.Bound(name="energy", lower=bad),
    "axis": lambda bad: zo.parameter_map("motor_pendulum", x=("Kp", bad, 3.0, 3), y=Y),
    "count": lambda bad: zo.parameter_map("motor_pendulum", x=("Kp", 2.0, 3.0, bad), y=Y),
    "state": lambda bad: zo.simulate_with_error(ball(), bad if bad and bad != [1, 2] else "x"),
    "accuracy": lambda bad: zo.simulate_to_accuracy(ball(), accuracy=bad, until=0.1),
    "execution": lambda bad: zo.sample_execution(ball(), bad),
    "rate": lambda bad: zo.sample_execution(ball(), motion(), rate=bad),
    "noise": lambda bad: zo.sample_execution(ball(), motion(), noise=bad),
    "seed": lambda bad: zo.sample_execution(ball(), motion(), seed=bad),
    "recording": lambda bad: zo.crop(bad),
    "orbit": lambda bad: zo.compare(bad, samples()),
    "fit": lambda bad: zo.identify(ball(), samples(), bad),
    "rig": lambda bad: zo.simulate_rig(ball(), bad or 1, until=0.01),
    "settings": lambda bad: zo.simulate_rig(ball(), until=0.01, settings=bad or 1),
    "cycles": lambda bad: zo.simulate_experiment(orbit(), cycles=bad),
    "parameter": lambda bad: zo.continue_orbit(orbit(), (bad, -1.1, -0.9)),
    "range": lambda bad: zo.continue_orbit(orbit(), bad if bad != [1, 2] else ["Kd", 1]),
    "parameter2": lambda bad: zo.continue_orbit(orbit(), ("Kd", -1.1, -0.9), parameter2=bad or 1),
    "x": lambda bad: zo.parameter_map("motor_pendulum", x=(bad, 1, 2, 1), y=Y),
    "y": lambda bad: zo.parameter_map("motor_pendulum", x=X, y=bad),
    "refine": lambda bad: zo.parameter_map("motor_pendulum", x=X, y=Y, refine=bad),
    "workers": lambda bad: zo.parameter_map("motor_pendulum", x=X, y=Y, workers=bad),
    "plan": lambda bad: zo.parameter_map("motor_pendulum", x=X, y=Y, plan=bad or 1),
    "shape": lambda bad: zo.find_orbit("motor_pendulum", shape=bad or 1),
    "objective": lambda bad: zo.search_gains("motor_pendulum", vary={}, objective=bad or 1),
    "bounds": lambda bad: zo.search_gains("motor_pendulum", vary={}, bounds=bad or 1),
    "near": lambda bad: zo.search_gains("motor_pendulum", vary={}, near=bad or 1),
    "engine": lambda bad: zo.search_gains("motor_pendulum", vary={}, engine=bad or 1),
    "directions": lambda bad: zo.largest_push(orbit(), directions=bad or 1),
    "path": lambda bad: zo.read_orbit(bad if bad != "2" else None),
    "figure": lambda bad: zo.save_figure(bad, "picture.png"),
    "text": lambda bad: zo.EventSequence.parsed(bad),
    "time": lambda bad: motion().arcs[0].state_at(bad if bad is not math.nan else None),
}


@pytest.mark.parametrize("door", DOORS)
def test_nonsense_is_refused_in_one_line(
    door: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for bad in NONSENSE:
        with pytest.raises(zo.InputError) as error:
            DOORS[door](bad)
        assert "`" in str(error.value)
        assert "\n" not in str(error.value)
        # The longest message lists every bundled problem.
        assert len(str(error.value)) < 600
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "settings",
    [
        zo.SimulationSettings(),
        zo.SearchSettings(),
        zo.VerificationSettings(),
        zo.WorkPrecisionSettings(),
        zo.ContinuationSettings(),
        zo.PushSettings(),
        zo.Workers(),
        zo.Cluster(address="tcp://localhost:8786"),
        zo.ExecutionPlan(),
        zo.TargetPeriod(target=1.0),
        zo.TargetAmplitude(target=1.0, state="theta1"),
        zo.MinPeak(signal="theta1"),
        zo.Truncation(delta=0.1),
        zo.StateLimit(beyond=1.0, phrase="is over the top"),
        zo.Quantity.positive("m", 1.0, "kg", "mass"),
        RigSettings(),
        ZenoExtrapolation(),
        ZenoPassage(),
        FixedImpacts(n_impacts=3),
        PlasticAfter(n_impacts=3),
    ],
    ids=lambda settings: type(settings).__name__,
)
def test_settings_of_a_wrong_kind_are_refused(settings: Any) -> None:
    for field in fields(settings):
        with pytest.raises(zo.InputError) as error:
            replace(settings, **{field.name: object()})
        assert f"`{field.name}`" in str(error.value)


@pytest.mark.parametrize("path", ["\0", "a\0b.json", "\ud800.json"])
def test_a_text_that_no_system_stores_is_no_path(path: str) -> None:
    for door in (zo.read_orbit, zo.read_recording, zo.verify, zo.simulate):
        with pytest.raises(zo.InputError, match="must be a path, but it is"):
            door(path)
    with pytest.raises(zo.InputError, match="`path` must be a path"):
        zo.write_orbit(orbit(), path)


@pytest.mark.parametrize("symbol", [ca.MX.sym("y"), ca.SX.sym("x", 2)], ids=str)
def test_a_symbol_is_no_number(symbol: Any) -> None:
    with pytest.raises(zo.InputError, match="`until` must be a number"):
        zo.simulate(ball(), until=symbol)
    with pytest.raises(zo.InputError, match="`contact` must be a number"):
        zo.SimulationSettings(contact=symbol)


@pytest.mark.parametrize("delta", [0.0, -1.0, math.inf, math.nan])
def test_a_cut_needs_a_speed(delta: float) -> None:
    with pytest.raises(zo.InputError, match="`delta` must be"):
        zo.Truncation(delta=delta)
