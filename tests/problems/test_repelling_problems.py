"""The juggled ball and the simplest walker, by closed forms and by another integrator."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference.held_by_hand import Juggler, Vector, walked
from tests.support.cases import fast

E, OMEGA, G = 0.8, 30.0, 9.81
TURN = 2 * math.pi / OMEGA


def _juggled(amplitude: float, *, rises: bool) -> zo.Orbit:
    phase, speed = Juggler(amplitude=amplitude).orbit(rises=rises)
    start = {"speed": speed, "cosine": math.cos(phase), "sine": math.sin(phase)}
    parameters = {"A": amplitude}
    return zo.find_orbit_by_shooting("table_juggler", parameters=parameters, start=start).unwrap()


@pytest.mark.parametrize(("amplitude", "rises"), [(0.0067, True), (0.015, True), (0.015, False)])
def test_a_juggled_ball_has_the_phase_and_the_multipliers_of_its_closed_form(
    amplitude: float, rises: bool
) -> None:
    orbit, exact = _juggled(amplitude, rises=rises), Juggler(amplitude=amplitude)
    phase, speed = exact.orbit(rises=rises)
    assert orbit.sequence == ("impact stop",)
    assert orbit.period == pytest.approx(TURN, rel=1e-12)
    found = [orbit.start_state[one] for one in ("speed", "cosine", "sine")]
    assert found == pytest.approx([speed, math.cos(phase), math.sin(phase)], rel=1e-9)
    values = zo.floquet_multipliers(orbit).values
    assert sorted(values, key=abs, reverse=True) == pytest.approx(
        exact.multipliers(rises=rises).tolist(), rel=1e-9
    )


def _least_effort(amplitude: float, *, rises: bool) -> Vector:
    """Return the gains of speed and cosine that turn the repelling multiplier into its inverse."""
    phase, _ = Juggler(amplitude=amplitude).orbit(rises=rises)
    lift = amplitude * OMEGA**2 * math.sin(phase)
    c = 1 + E
    # Time of the impact and speed over the ground after it.
    a = np.array([[1.0, c / G], [-c * lift, E**2 - c**2 * lift / G]])
    later = -TURN * c / (2 * G)
    b = np.array([later, E * (G * later + TURN) - c * lift * later])
    largest, other = Juggler(amplitude=amplitude).multipliers(rises=rises)
    wished = np.poly([1 / largest, other])
    value = a @ a + wished[1] * a + wished[2] * np.eye(2)
    k = np.linalg.solve(np.column_stack([b, a @ b]).T, [0.0, 1.0]) @ value
    return np.array([k[1], k[1] * amplitude * OMEGA - k[0] / (OMEGA * math.sin(phase))])


@pytest.mark.parametrize(("amplitude", "rises"), [(0.015, True), (0.008, False)])
def test_least_squares_of_a_juggled_ball_has_a_closed_form(amplitude: float, rises: bool) -> None:
    found = zo.design_feedback(_juggled(amplitude, rises=rises), ["pull"], weight=0.0)
    assert found.returns.coordinates == ("speed", "cosine")
    assert found.gain[0] == pytest.approx(_least_effort(amplitude, rises=rises), rel=1e-8)
    largest, other = Juggler(amplitude=amplitude).multipliers(rises=rises)
    assert found.multipliers == pytest.approx((1 / largest, other), rel=1e-8)


def test_a_juggled_ball_is_held_as_by_parabolas() -> None:
    orbit = _juggled(0.015, rises=True)
    found = zo.design_feedback(orbit, ["pull"])
    machine, exact = found.machine(), Juggler(amplitude=0.015)
    phase, speed = exact.orbit(rises=True)
    phase, speed = phase + 2e-3, speed + 1e-3
    by_hand = exact.held(np.array([phase, speed]), lambda x: float(found.inputs_at(x)[0]), 60)
    first = {"speed": speed, "cosine": math.cos(phase), "sine": math.sin(phase)}
    pull = float(found.inputs_at(by_hand[0])[0])
    run = zo.simulate(machine, start={**first, "held_pull": pull}, until=60.5 * TURN)
    places = [machine.state_names.index(one) for one in ("speed", "cosine")]
    assert len(run.impacts) == 60
    for impact, point in zip(run.impacts, by_hand[1:], strict=True):
        assert impact.state_plus[places] == pytest.approx(point, rel=1e-10)
    assert by_hand[-1] == pytest.approx(found.returns.fixed_point, rel=1e-12)
    # Without the law the same ball leaves, from 1e-3 m/s.
    free = exact.held(np.array([phase, speed]), lambda _: 0.0, 8)
    assert abs(free[8, 0] - found.returns.fixed_point[0]) > 0.05


# ---------------------------------------------------------------------- the simplest walker


def _gait(slope: float) -> zo.Orbit:
    known = None if slope == 0.009 else _gait(0.009)
    parameters = {"slope": slope}
    return zo.find_orbit_by_shooting("slope_walker", parameters=parameters, near=known).unwrap()


def test_the_simplest_walker_has_the_gait_of_another_integrator() -> None:
    orbit = _gait(0.009)
    names = ("stance", "swing", "dstance", "dswing")
    returns = zo.return_map(orbit)
    before = returns.state(returns.fixed_point)
    start = np.array([before[one] for one in names])
    # Local errors of SciPy are at most 1e-12.
    assert walked(0.009, start, lambda _: 0.0, 1)[0] == pytest.approx(start, abs=1e-11)
    # Both feet are on the slope after a strike.
    assert orbit.start_state["swing"] == pytest.approx(2 * orbit.start_state["stance"], rel=1e-12)


def test_steps_on_gentle_slopes_have_the_published_length() -> None:
    # Garcia et al. (1998): the angle of a leg tends to 0.970956 slope^(1/3).
    lengths = [_gait(slope).start_state["stance"] / slope ** (1 / 3) for slope in (2e-3, 1e-3)]
    # The next term of the series is one in slope^(2/3).
    factor = 2 ** (2 / 3)
    assert (factor * lengths[1] - lengths[0]) / (factor - 1) == pytest.approx(0.970956, abs=3e-5)


def test_the_simplest_walker_loses_its_gait_at_the_published_slope() -> None:
    # Garcia et al. (1998): one step per period attracts up to a slope of 0.0151.
    for slope, attracts in ((0.0150, True), (0.0152, False)):
        values = zo.floquet_multipliers(_gait(slope)).values
        assert (max(map(abs, values)) < 1.0) == attracts
        assert values[0].real == pytest.approx(-1.0, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("slope", "n"), fast(1, [(0.02, 4), (0.025, 40)]))
def test_a_walker_on_a_steep_slope_is_held_as_by_another_integrator(slope: float, n: int) -> None:
    found = zo.design_feedback(_gait(slope), ["hip"])
    machine, returns = found.machine(), found.returns
    names = ("stance", "swing", "dstance", "dswing")
    places = [names.index(one) for one in returns.coordinates]
    known: Any = returns.state(returns.fixed_point + 1e-3 * returns.sizes)
    start = np.array([known[one] for one in names])

    def law(x: Vector) -> float:
        return float(found.inputs_at(x[places])[0])

    by_hand = walked(slope, start, law, n)
    dynamics = machine.graph_dynamics(machine.values())
    before = {**known, "held_hip": 0.0}
    after = dynamics.after_switch(0, np.array([before[one] for one in machine.state_names]))
    first = dict(zip(machine.state_names, after.tolist(), strict=True))
    assert first["held_hip"] == pytest.approx(law(start), rel=1e-12)
    run = zo.simulate(machine, start=first, until=(n + 0.5) * returns.period)
    assert len(run.switches) == n == len(by_hand)
    for strike, point in zip(run.switches, by_hand, strict=True):
        assert strike.state_minus[:4] == pytest.approx(point, abs=1e-9)
    assert abs(found.multipliers[0]) < 0.52
