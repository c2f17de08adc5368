"""From the recording of a walker with unlike legs to an orbit, a verdict and the legs' parameters.

The recordings are motions of `tests.reference.unlike_walker`, which shares no code with the package
and has legs that differ, as a recorded robot has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference.unlike_walker import Leg, Walker, after_strike, walked
from zeno_orbits.experiment import RecordedSignal

GAINS = {"push": 0.0327, "K_hip": -0.155, "K_stance": 0.512}
OTHERS = (0.01, 0.06, -0.1)
"""A controller that pushes while the first falls."""
START = np.array([-0.14, 0.14, 0.71, 0.6])
NOISE = 4e-4
"""Noise of encoders [rad], and of the torque in 0.1 N m."""
UNLIKE = (Leg(centre=0.0460, inertia=0.00425), Leg(centre=0.0490, inertia=0.00445))


@cache
def _orbit() -> zo.Orbit:
    return zo.find_orbit("compass_walker", gains=GAINS).unwrap()


def _recording(parts: Sequence[tuple[np.ndarray, np.ndarray]], seed: int = 1) -> zo.Recording:
    time = np.concatenate([one for one, _ in parts])
    rows = np.concatenate([own for _, own in parts])
    noise = NOISE * np.random.default_rng(seed).standard_normal(rows.shape)
    rows = rows + noise * np.array([1.0, 1.0, 0.1])
    units = {"hip": "rad", "stance": "rad", "torque": "N m"}
    signals = tuple(
        RecordedSignal(name=name, unit=unit, values=rows[:, k])
        for k, (name, unit) in enumerate(units.items())
    )
    return zo.Recording(source=None, problem="compass_walker", time=time, signals=signals)


def test_the_heel_strike_and_the_step_are_those_of_rigid_bodies() -> None:
    orbit = _orbit()
    strike = orbit.events[-1].state
    stance, swing = strike["stance"], strike["stance"] - strike["hip"]
    rates = np.array([strike["dstance"], strike["dstance"] - strike["dhip"]])
    one = Walker()
    after = after_strike(one, 0, np.array([stance, swing]), rates)
    begun = orbit.start_state
    assert after == pytest.approx([begun["dstance"], begun["dstance"] - begun["dhip"]], abs=1e-9)
    x = np.array([begun["stance"], begun["stance"] - begun["hip"], *after])
    ((first, _), (second, _)) = walked(one, x, 2, 1e5)
    assert second[0] - first[0] == pytest.approx(orbit.period, abs=2e-5)


@pytest.mark.slow
def test_unlike_legs_under_the_same_controller_show_an_orbit_with_other_values() -> None:
    parts = walked(Walker(legs=UNLIKE), START, 10, 200.0)
    found = zo.compare(_orbit(), _recording(parts))
    assert found.agrees
    assert any("legs, are unlike" in one for one in found.remarks)
    steps = [one[0][0] for one in parts]
    mean = (steps[-1] - steps[0]) / (len(steps) - 1)
    assert found.metric("period").data == pytest.approx(mean, rel=0.01)


@pytest.mark.slow
def test_the_same_legs_under_another_controller_do_not_show_the_orbit() -> None:
    other = walked(Walker(legs=UNLIKE, gains=OTHERS), START, 10, 200.0)
    found = zo.compare(_orbit(), _recording(other))
    assert not found.agrees
    assert any("torque" in one for one in found.reasons)


@pytest.mark.slow
def test_the_steps_of_a_leg_give_its_two_parameters_and_no_friction_below_zero() -> None:
    # Dry friction that falls with the speed looks like a negative viscous friction.
    real = Walker(legs=UNLIKE, viscous=0.0, dry=0.01, drop=0.003)
    steps = walked(real, START, 5, 200.0, skipped=2)
    trials = [_recording([one], seed=k) for k, one in enumerate(steps) if k % 2 == 0]
    found = zo.identify(
        "compass_walker",
        trials,
        {
            "lc": (0.03, 0.07),
            "J": (0.003, 0.006),
            "m_hip": (0.5, 6.0),
            "m_weight": (-1.0, 0.5),
            "viscous": (0.0, 0.02),
            "dry": (0.0, 0.05),
        },
        gains=GAINS,
        transient=True,
    )
    known = {one.unknown.label: one for one in found.fitted}
    swing = real.legs[1]
    # The friction of another law pulls at them.
    assert known["J"].value == pytest.approx(swing.inertia, rel=0.1)
    assert known["lc"].value == pytest.approx(swing.centre, rel=0.1)
    assert all(math.isinf(known[name].error) for name in ("m_hip", "m_weight", "viscous"))
    assert known["viscous"].value == pytest.approx(0.0, abs=1e-6)
    assert any("`viscous` reached an end" in one for one in found.remarks)
    assert found.transient is not None
    assert found.transient.tests.has_structure
