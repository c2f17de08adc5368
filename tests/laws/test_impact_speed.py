"""Restitutions that depend on the impact speed, against recursions with 60 digits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import mpmath as mp
import numpy as np
import pytest

import zeno_orbits as zo
from tests.loop.agreement import followed, looped, numbers_of, require_same_kinds
from tests.support.impact_laws import LAWS, Fall, ball, ball_under_roof, dropped, thrown
from zeno_orbits.integrators import Tolerance
from zeno_orbits.simulation import (
    EventDerivatives,
    FixedImpacts,
    PlasticAfter,
    SimulationSettings,
    SimulationTask,
    Truncation,
    simulate,
)

OF_SUMS = 1e-12
"""Rounding of the sum of a hundred flights, each integrated to 1e-14."""
NUMBERS = {"g": 9.81, "e0": 0.8, "c": 0.03}
ROOF = {**NUMBERS, "e1": 0.9, "c1": 0.02}


def _task(problem: zo.Problem, numbers: Mapping[str, float], state: Any, **more: Any) -> Any:
    values = problem.values(parameters=dict(numbers))
    system: Any = problem.graph_dynamics(values) if problem.has_graph else problem.dynamics(values)
    return SimulationTask(dynamics=system, state=np.array(state), until=60.0, **more)


def _require_known(run: zo.Execution, known: Fall, tolerance: float = OF_SUMS) -> None:
    for impact, stop, time, speed in zip(
        run.impacts, known.stops, known.times, known.speeds, strict=False
    ):
        assert impact.stop in ("", stop)
        assert impact.time == pytest.approx(float(time), rel=tolerance)
        assert -impact.approach_rate == pytest.approx(float(speed), abs=tolerance)
    assert run.zeno_points[0].time == pytest.approx(float(known.zeno_time), rel=tolerance)


# Impacts and Zeno points.


@pytest.mark.parametrize("e0", [0.3, 0.8, 0.95])
@pytest.mark.parametrize("law", LAWS)
def test_a_ball_has_the_impacts_and_the_zeno_time_of_its_recursion(law: str, e0: float) -> None:
    numbers = {**NUMBERS, "e0": e0}
    known = dropped(LAWS[law], numbers)
    run = zo.simulate(ball(LAWS[law]), until=60.0, parameters=numbers)
    assert len(run.impacts) >= 5
    _require_known(run, known)
    # The rounding of the flights is not part of the claimed error.
    off = abs(float(mp.mpf(run.zeno_points[0].time) / known.zeno_time - 1))
    assert off <= run.zeno_points[0].limit_error + 1e-13


@pytest.mark.slow
@pytest.mark.parametrize("law", ["linear", "exponential"])
def test_the_curve_of_many_impacts_ends_at_the_same_time(law: str) -> None:
    numbers = {**NUMBERS, "e0": 0.995, "c": 0.003}
    run = zo.simulate(ball(LAWS[law]), until=400.0, parameters=numbers)
    known = dropped(LAWS[law], numbers)
    assert len(run.impacts) < 0.1 * sum(v > 1e-3 * known.speeds[0] for v in known.speeds)
    assert run.zeno_points[0].time == pytest.approx(float(known.zeno_time), rel=3e-12)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("count", [2, 4, 7])
def test_a_limit_of_few_impacts_claims_the_error_that_the_law_causes(law: str, count: int) -> None:
    known = dropped(LAWS[law], NUMBERS)
    settings = SimulationSettings(completion=FixedImpacts(n_impacts=count))
    (zeno,) = zo.simulate(ball(LAWS[law]), until=60.0, settings=settings).zeno_points
    off = abs(zeno.time - float(known.zeno_time)) / (1 + float(known.zeno_time))
    assert 1e-12 < off <= zeno.limit_error


def test_two_stops_have_their_own_laws() -> None:
    problem, speed = ball_under_roof(), 11.0
    known = thrown(ROOF, speed)
    run = zo.simulate(problem, start={"h": 0.0, "v": speed}, until=60.0)
    assert known.stops.count("roof") >= 2
    assert [one.stop for one in run.impacts] == known.stops[: len(run.impacts)]
    _require_known(run, known)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    "completion",
    [None, FixedImpacts(n_impacts=4), PlasticAfter(n_impacts=3), Truncation(delta=0.01)],
    ids=["limit", "fixed", "plastic", "truncation"],
)
def test_both_loops_have_the_same_bits(law: str, completion: Any) -> None:
    plain = SimulationSettings()
    settings = plain if completion is None else replace(plain, completion=completion)
    task = _task(ball(LAWS[law]), NUMBERS, [0.5, 0.0], settings=settings)
    found, expected = looped(task).execution, followed(task).execution
    assert found is not None
    assert expected is not None
    require_same_kinds(found, expected)
    for one, other in zip(numbers_of(found), numbers_of(expected), strict=True):
        assert np.array_equal(one, other)


def test_both_loops_have_the_same_bits_at_two_stops() -> None:
    task = _task(ball_under_roof(), ROOF, [0.0, 11.0])
    found, expected = looped(task).execution, followed(task).execution
    assert found is not None
    assert expected is not None
    for one, other in zip(numbers_of(found), numbers_of(expected), strict=True):
        assert np.array_equal(one, other)


def test_a_truncation_cuts_at_the_speed_before_the_impact() -> None:
    delta, known = 0.5, dropped(LAWS["linear"], NUMBERS)
    settings = SimulationSettings(completion=Truncation(delta=delta))
    run = zo.simulate(ball(LAWS["linear"]), until=60.0, settings=settings)
    assert len(run.impacts) == 1 + sum(speed >= delta for speed in known.speeds)


def test_the_limit_does_not_depend_on_the_unit_of_length() -> None:
    small = {"g": 9.81e-6, "e0": 0.8, "c": 0.03e6}
    run = zo.simulate(ball(LAWS["linear"]), start={"h": 0.5e-6}, until=60.0, parameters=small)
    known = dropped(LAWS["linear"], NUMBERS)
    assert run.zeno_points[0].time == pytest.approx(float(known.zeno_time), rel=OF_SUMS)


def test_a_law_without_a_fall_is_a_constant_restitution() -> None:
    run = zo.simulate(ball(LAWS["linear"]), until=60.0, parameters={"c": 0.0})
    plain = zo.simulate("bouncing_ball", start={"height": 0.5}, until=60.0)
    assert [one.time for one in run.impacts] == [one.time for one in plain.impacts]
    assert run.zeno_points[0].time == plain.zeno_points[0].time


# Derivatives.


def _zeno_shift(task: Any, chosen: tuple[int, ...]) -> np.ndarray[Any, Any]:
    run = simulate(task.dynamics, task.state, until=60.0)
    walk = EventDerivatives(task.dynamics, chosen, Tolerance())
    before = list(walk.passages(run))
    locked = next(one for one in before if one.arc.start_time == run.zeno_points[0].time)
    return locked.start.time


@pytest.mark.parametrize("law", ["linear", "exponential", "late cap", "fifth root"])
def test_the_zeno_time_moves_as_its_recursion(law: str) -> None:
    task = _task(ball(LAWS[law]), NUMBERS, [0.5, 0.0])
    found = _zeno_shift(task, (0, 1, 2))
    names = ("g", "e0", "c")

    def zeno_time(name: str, value: Any) -> Any:
        moved = {**{k: mp.mpf(x) for k, x in NUMBERS.items()}, name: value}
        return dropped(LAWS[law], moved).zeno_time

    for name, shift in zip(names, found[2:], strict=True):
        with mp.workdps(40):
            exact = mp.diff(lambda x, name=name: zeno_time(name, x), mp.mpf(NUMBERS[name]))
        assert shift == pytest.approx(float(exact), rel=1e-8)


def test_the_zeno_time_moves_as_its_recursion_after_two_stops() -> None:
    task, speed = _task(ball_under_roof(), ROOF, [0.0, 11.0]), 11.0
    found = _zeno_shift(task, tuple(range(5)))
    for name, shift in zip(("g", "e0", "c", "e1", "c1"), found[2:], strict=True):
        with mp.workdps(40):
            exact = mp.diff(
                lambda x, name=name: thrown({**ROOF, name: x}, speed).zeno_time,
                mp.mpf(ROOF[name]),
            )
        assert shift == pytest.approx(float(exact), rel=1e-8)


# Refusals.


@pytest.mark.parametrize(("e0", "limit"), [(1.0, "1"), (0.0, "0"), (1.2, "1.2"), (-0.1, "-0.1")])
def test_a_limit_at_speed_zero_outside_of_0_and_1_is_refused(e0: float, limit: str) -> None:
    with pytest.raises(zo.InputError, match=rf"`restitution`.* {limit}[:.]?"):
        zo.simulate(ball(LAWS["linear"]), until=1.0, parameters={"e0": e0})


@pytest.mark.parametrize("python", [False, True])
def test_a_restitution_beyond_0_and_1_is_refused_with_the_speed(python: bool) -> None:
    task = _task(ball(LAWS["linear"]), {**NUMBERS, "c": 0.5}, [0.5, 0.0])
    error = (followed if python else looped)(task).error
    speed = float(dropped(LAWS["linear"], NUMBERS).speeds[0])
    assert error is not None
    assert str(error).startswith(
        f"Argument `restitution` must lie in [0, 1], but at the impact speed {speed:.6g} it is "
        f"{0.8 - 0.5 * speed:.6g}"
    )
    rising = {**NUMBERS, "c": -0.5}
    error = (followed if python else looped)(_task(ball(LAWS["linear"]), rising, [0.5, 0.0])).error
    assert error is not None
    assert f"it is {0.8 + 0.5 * speed:.6g}" in str(error)


@pytest.mark.parametrize("python", [False, True])
def test_the_stop_of_a_restitution_beyond_0_and_1_is_named(python: bool) -> None:
    task = _task(ball_under_roof(), {**ROOF, "c1": 0.5}, [0.0, 11.0])
    error = (followed if python else looped)(task).error
    assert error is not None
    assert "`restitution` of the stop `roof` must lie in [0, 1]" in str(error)


def test_the_speed_of_an_impact_is_refused_in_another_formula() -> None:
    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        h, v = ca.SX.sym("h"), ca.SX.sym("v")
        one = zo.HybridLagrangian.from_energies(
            q=h, v=v, kinetic=v**2 / 2, potential=p["g"] * h, passive_force=-zo.impact_speed, gap=h
        )
        return zo.hybrid_system(one, zo.no_drive(one), p["e0"] - p["c"] * zo.impact_speed)

    problem = replace(ball(LAWS["linear"]), model=model)
    with pytest.raises(ValueError, match="the passive force holds the symbol `impact_speed`"):
        problem.checked()


# States that jump with an impact.


def _counter(gain: Any) -> Any:
    """Return a drive with a state that an impact changes by a part of the change of the speed."""

    def drive(mechanism: zo.HybridLagrangian, p: Mapping[str, ca.SX]) -> Any:
        z = ca.SX.sym("z")
        return zo.Auxiliary(
            states=z,
            rate=ca.SX(0),
            after_impact=z + gain(mechanism.v, LAWS["linear"](zo.impact_speed, p, ca)),
        )

    return drive


def test_an_observer_follows_the_jump_of_the_speed() -> None:
    problem = ball(LAWS["linear"], drive=_counter(lambda v, e: -(1 + e) * v))
    problem = replace(problem, state_names=("h", "v", "z"), state_units=("m", "m/s", "m/s"))
    assert problem.checked().name == problem.name
    run = zo.simulate(problem, until=60.0)
    for impact in run.impacts:
        jump = impact.state_plus - impact.state_minus
        assert jump[2] == pytest.approx(jump[1], rel=1e-12)
    total = sum(
        (1 + 0.8 - 0.03 * v) * v for v in map(float, dropped(LAWS["linear"], NUMBERS).speeds)
    )
    assert run.zeno_points[0].state[2] == pytest.approx(total, rel=1e-10)


def _nearly(v: Any, e: Any) -> Any:
    """Return a jump in proportion to 1 + e at the impact speeds 0.1 and 0.3 alone."""
    return -(1 + e) * (1 + 5 * (zo.impact_speed - 0.1) * (zo.impact_speed - 0.3)) * v


@pytest.mark.parametrize("gain", [lambda v, e: -(2 + e) * v, _nearly])
def test_a_jump_that_is_not_in_proportion_to_the_impulse_is_refused(gain: Any) -> None:
    problem = ball(LAWS["linear"], drive=_counter(gain))
    problem = replace(problem, state_names=("h", "v", "z"), state_units=("m", "m/s", "m/s"))
    with pytest.raises(ValueError, match="in proportion to 1 \\+ e"):
        problem.checked()
