"""Inputs that are amplitudes and switching times of a waveform, against parabolas."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.pushed_ball import OMEGA, Ball, T, pushed_ball
from zeno_orbits.errors import InputError

BALL, PROBLEM = Ball(), pushed_ball()
INPUTS = ("F", "t1", "t2")


@cache
def _orbit() -> zo.Orbit:
    return zo.find_orbit_by_shooting(PROBLEM, start=BALL.start).unwrap()


def _slopes(name: str) -> Any:
    """Return the change of time and speed of a return by an argument, by complex steps."""
    time, speed = BALL.orbit
    step, ball = 1e-20j, BALL
    start = [complex(time), complex(speed)]
    if name in INPUTS:
        ball = replace(BALL, **{name: getattr(BALL, name) + step})
    else:
        start[("time", "speed").index(name)] += step
    return np.array([one.imag / 1e-20 for one in ball.after(*start)])


def _of_point(x: Any, names: tuple[str, ...]) -> tuple[float, float]:
    """Return time and speed of a point of the section."""
    known = dict(zip(names, x, strict=True))
    angle = math.asin(known["sine"]) if "sine" in known else math.acos(known["cosine"])
    if "sine" in known and BALL.start["cosine"] < 0.0:
        angle = math.pi - angle
    return angle / OMEGA, float(known["speed"])


def test_the_multipliers_are_those_of_the_parabolas() -> None:
    assert BALL.after(*BALL.orbit) == pytest.approx(BALL.orbit, abs=1e-15)
    slopes = np.stack([_slopes("time"), _slopes("speed")], axis=1)
    exact = np.linalg.eigvals(slopes)
    found = zo.return_map(_orbit(), problem=PROBLEM)
    assert found.period == pytest.approx(T, rel=1e-12)
    assert sorted(map(abs, found.multipliers)) == pytest.approx(sorted(np.abs(exact)), rel=1e-9)
    assert np.prod(exact) == pytest.approx(BALL.e**2, rel=1e-12)
    assert max(np.abs(exact)) > 2.4


@pytest.mark.parametrize("name", INPUTS)
def test_the_derivative_by_a_switching_time_is_exact(name: str) -> None:
    found = zo.return_map(_orbit(), problem=PROBLEM)
    assert not found.moves_section(name)
    by_time, by_speed = _slopes(name)
    turn = OMEGA * BALL.orbit[0]
    expected = {
        "speed": by_speed,
        "cosine": -OMEGA * math.sin(turn) * by_time,
        "sine": OMEGA * math.cos(turn) * by_time,
    }
    column = found.gain_jacobian[:, found.gain_names.index(name)]
    assert column == pytest.approx([expected[one] for one in found.coordinates], rel=1e-8)


@pytest.mark.parametrize("inputs", [("t1",), ("t2",), ("F",), ("F", "t1")])
def test_a_switching_time_that_is_set_at_each_impact_holds_the_ball(
    inputs: tuple[str, ...],
) -> None:
    found = zo.design_feedback(_orbit(), inputs, problem=PROBLEM, weight=0.0)
    free = max(map(abs, found.returns.multipliers))
    assert max(map(abs, found.multipliers)) == pytest.approx(1 / free, rel=1e-7)
    start = found.returns.fixed_point + 1e-4 * found.returns.sizes
    motion = found.run(start, 25)
    assert motion.lost == ""
    assert np.all(np.abs(motion.inputs - found.centre) > 0.0)
    names = found.returns.coordinates
    for k, used in enumerate(motion.inputs.tolist()):
        ball = replace(BALL, **dict(zip(inputs, used, strict=True)))
        point = [one.real for one in ball.after(*_of_point(motion.points[k], names))]
        assert _of_point(motion.points[k + 1], names) == pytest.approx(point, abs=1e-12)
    away = np.max(np.abs(motion.points - found.returns.fixed_point), axis=1)
    assert away[12] / away[11] == pytest.approx(1 / free, rel=1e-2)
    assert away[-1] < 1e-9
    fixed = {name: (value, value) for name, value in zip(inputs, found.centre, strict=True)}
    nothing = zo.design_feedback(_orbit(), fixed, problem=PROBLEM)
    gone = nothing.run(start, 25)
    assert gone.lost or np.max(np.abs(gone.points - found.returns.fixed_point)) > 0.1


def test_a_gain_may_be_uncertain() -> None:
    middle = complex(BALL.t2).real
    ends = (middle - 1e-4, middle + 1e-4)
    found = zo.design_feedback(_orbit(), ["F"], problem=PROBLEM, uncertain={"t2": ends})
    names = found.returns.coordinates
    assert [corner.parameters["t2"] for corner in found.corners] == [*ends]
    for corner in found.corners:
        assert abs(corner.inputs[0] - BALL.F) > 1e-6 * abs(BALL.F)
        ball = replace(BALL, t2=corner.parameters["t2"], F=float(corner.inputs[0]))
        point = _of_point(corner.fixed_point, names)
        assert [one.real for one in ball.after(*point)] == pytest.approx(point, abs=1e-9)


@pytest.mark.slow
def test_switching_times_out_of_order_lose_a_motion_with_the_reason() -> None:
    found = zo.design_feedback(_orbit(), {"t1": (-1.0, 1.0)}, problem=PROBLEM, method="deadbeat")
    far = found.returns.fixed_point.copy()
    speed = found.returns.coordinates.index("speed")
    k = float(found.gain[0, speed])
    # The law sets t1 to 0.15 s, after t2.
    far[speed] -= (0.15 - 0.08) / k
    assert found.inputs_at(far) == pytest.approx([0.15])
    motion = found.run(far, 3)
    assert len(motion.points) == 1
    assert "must increase from 0 to its period" in motion.lost
    low, high = found.extent("speed", step=0.2, most=0.4)
    assert -0.4 <= low <= 0.0 <= high <= 0.4


@pytest.mark.slow
def test_an_amplitude_is_a_state_of_the_machine_and_a_switching_time_is_refused() -> None:
    found = zo.design_feedback(_orbit(), ["F"], problem=PROBLEM, weight=0.0)
    machine = found.machine()
    orbit = zo.find_orbit_by_shooting(machine).unwrap()
    stability = zo.floquet_multipliers(orbit, problem=machine)
    assert stability.spectral_radius == pytest.approx(max(map(abs, found.multipliers)), rel=1e-6)
    timed = zo.design_feedback(_orbit(), ["t1"], problem=PROBLEM)
    with pytest.raises(InputError) as error:
        timed.machine()
    assert "`t1` determines a switching time of a waveform, which cannot be a state" in str(
        error.value
    )
