"""One period is enclosed with the events of the orbit file, or refused with the reason."""

from __future__ import annotations

import copy
import math
import pickle
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from scipy.optimize import brentq

import zeno_orbits as zo
from tests.support import hard_to_prove, magnet_spot
from tests.support.cases import fast
from tests.support.commands import NO, YES, ask
from tests.support.orbits import shot_orbit
from zeno_orbits.orbits import OrbitPhase, PhaseKind

CLOSE = 1e-10
"""Orbits are searched to about 1e-12 per size; hundredfold for sensitive impacts."""
DIGITS = 120


@pytest.fixture(scope="module")
def table() -> zo.Orbit:
    return shot_orbit("vibrating_table")


@pytest.fixture(scope="module")
def surface() -> zo.Orbit:
    return shot_orbit("curved_surface")


@pytest.mark.parametrize(
    "name",
    fast(
        1,
        ["forced_oscillator", "vibrating_table", "motor_valve", "two_tone_table", "curved_surface"],
    ),
)
def test_a_period_of_a_bundled_orbit_is_enclosed(name: str) -> None:
    orbit = zo.find_orbit_by_shooting(name).unwrap()
    found: zo.PeriodEnclosure = zo.enclose_period(orbit)
    assert found.enclosed, found.verdict()
    assert found.miss is not None
    assert found.miss < CLOSE
    kinds = [event.kind for event in found.events]
    assert kinds.count("release") == kinds.count("zeno_point") == orbit.shape.n_releases
    assert kinds.count("impact") >= len(orbit.impacts)
    assert found.events[-1].time.misses(orbit.period) < CLOSE


def _fraction(x: mp.mpf) -> Fraction:
    sign, mantissa, exponent, _ = x._mpf_
    return (-1) ** sign * Fraction(int(mantissa)) * Fraction(2) ** int(exponent)


def _table_impacts(orbit: zo.Orbit, count: int) -> list[mp.mpf]:
    """Return the impacts of a ball on a sine table from its release, from the closed form."""
    a, omega, g, e = (mp.mpf(orbit.parameters[n]) for n in ("A", "omega", "g", "restitution"))
    phase, time, speed, times = mp.asin(g / (a * omega**2)), mp.mpf(0), mp.mpf(0), []

    def height(duration: mp.mpf) -> mp.mpf:
        here, there = omega * time + phase, omega * (time + duration) + phase
        lift = mp.sin(there) - mp.sin(here) - omega * mp.cos(here) * duration
        return speed * duration - g * duration**2 / 2 - a * lift

    for k in range(count):
        pull = g - a * omega**2 * mp.sin(omega * time + phase)
        # The first flight has no speed to start a parabola from. It lasts about half a turn.
        guess = mp.pi / omega if k == 0 else 2 * speed / pull
        ends, tol = (guess, guess * mp.mpf("1.01")), mp.mpf(10) ** -100
        duration = mp.findroot(lambda t: height(t) / t, ends, tol=tol, maxsteps=50)
        assert all(height(duration * j / 50) > 0 for j in range(1, 50))
        here, there = omega * time + phase, omega * (time + duration) + phase
        arrival = speed - g * duration - a * omega * (mp.cos(there) - mp.cos(here))
        time, speed = time + duration, -e * arrival
        times.append(time)
    return times


@pytest.mark.slow
def test_the_enclosed_times_hold_the_closed_form_of_a_ball_on_a_table(
    table: zo.Orbit,
) -> None:
    found = zo.enclose_period(table)
    impacts = [event.time for event in found.events if event.kind == "impact"]
    with mp.workdps(DIGITS):
        for enclosed, truth in zip(impacts, _table_impacts(table, 20), strict=False):
            assert enclosed.low <= _fraction(truth) <= enclosed.high
            assert enclosed.width < 1e-17
        period = _fraction(2 * mp.pi / mp.mpf(table.parameters["omega"]))
    assert found.events[-1].time.low <= period <= found.events[-1].time.high


def test_a_plastic_orbit_has_one_impact_and_is_refused_with_two() -> None:
    orbit = zo.find_orbit_by_shooting("vibrating_table", parameters={"restitution": 0.0}).unwrap()
    found = zo.enclose_period(orbit)
    assert [event.kind for event in found.events] == ["impact", "zeno_point", "release"]
    (phase,) = orbit.phases
    twice = replace(phase, impacts=(*phase.impacts, *phase.impacts))
    assert zo.enclose_period(orbit.with_phases((twice,))).claim == "shape"


@pytest.mark.slow
def test_an_orbit_that_repels_is_enclosed() -> None:
    problem = hard_to_prove.double_well()
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    multipliers = zo.floquet_multipliers(orbit, problem=problem)
    assert max(abs(value) for value in multipliers.values) > 1.0
    found = zo.enclose_period(orbit, problem=problem)
    assert found.enclosed, found.verdict()


# Missed events


@pytest.fixture(scope="module")
def unaware() -> zo.Orbit:
    """The orbit without the magnet, claimed of the machine with it."""
    problem = magnet_spot.PROBLEM
    orbit = zo.find_orbit(problem, parameters={"pull": 0.0}).unwrap()
    assert zo.enclose_period(orbit, problem=problem).enclosed
    return replace(orbit, parameters={**orbit.parameters, "pull": 12.0})


def _weight_less_lift(angle: float) -> float:
    magnet = 12.0 * math.exp((math.cos(angle - 0.3) - 1) / magnet_spot.WIDTH**2)
    return 9.81 - 0.015 * 30.0**2 * math.sin(angle) - magnet


def _magnet_after_release() -> float:
    """Return the time from the release of the table to that at the magnet, in closed form."""
    at_magnet = brentq(_weight_less_lift, 0.3 - 3 * magnet_spot.WIDTH, 0.3, xtol=1e-15)
    return (2 * math.pi + at_magnet - math.asin(9.81 / (0.015 * 30.0**2))) / 30.0


def _enclosed_in(reason: str) -> float:
    """Return the middle of the interval that a reason names."""
    found = re.search(r"enclosed in (\S+) \+- ", reason)
    assert found is not None, reason
    return float(found[1])


@pytest.mark.slow
def test_an_orbit_that_misses_a_release_is_refused_with_its_time(unaware: zo.Orbit) -> None:
    found = zo.enclose_period(unaware, problem=magnet_spot.PROBLEM)
    assert not found.enclosed
    assert found.claim == "release_time"
    assert abs(_enclosed_in(found.reason) - _magnet_after_release()) < 1e-14
    assert repr(unaware.period) in found.reason
    assert found.events == ()
    assert found.miss is None


@pytest.mark.slow
def test_the_orbit_with_both_releases_is_enclosed() -> None:
    orbit = zo.find_orbit(magnet_spot.PROBLEM).unwrap()
    found = zo.enclose_period(orbit, problem=magnet_spot.PROBLEM)
    assert found.enclosed, found.verdict()
    first, second = (one.time for one in found.events if one.kind == "release")
    # The period starts at either release.
    apart = _magnet_after_release()
    truth = apart if orbit.start_state["sine"] > 0.5 else 2 * math.pi / 30.0 - apart
    assert first.misses(truth) < 1e-14
    assert second.misses(2 * math.pi / 30.0) < 1e-15


TOOTH_PLACE = 3.0
"""Angle of a turn at which a mass on a spring pushes a tooth below the ball, in flight [rad]."""


TOOTH_WIDTH = 0.05


def _tooth(angle: float) -> float:
    """Return the height of the tooth at an angle of a turn, per its largest."""
    return math.exp((math.cos(angle - TOOTH_PLACE) - 1) / TOOTH_WIDTH**2)


def _with_tooth(height: float) -> zo.Problem:
    """Return the ball on a table with a tooth, raised where a mass on a spring turns back."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        clock, omega = zo.Clock.at(p["omega"]), p["omega"]
        ball = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=p["g"] * q[0] + omega**2 * q[1] ** 2 / 2,
            gap=q[0] - p["tooth"] * ca.exp((q[1] - 1) / TOOTH_WIDTH**2),
            applied_force=ca.vertcat(p["A"] * omega**2 * clock.sine, 0),
            clock=clock,
        )
        return zo.hybrid_system(ball, zo.no_drive(ball), p["restitution"])

    spot = magnet_spot.PROBLEM
    kept = tuple(one for one in spot.parameters if one.name not in {"pull", "spot"})
    tooth = zo.Quantity(name="tooth", unit="m", meaning="height of the tooth", default=height)
    return replace(
        spot,
        name="tooth",
        model=model,
        state_names=("height", "place", "speed", "rate", "cosine", "sine"),
        state_units=("m", "m", "m/s", "m/s", "1", "1"),
        parameters=(*kept, tooth),
    )


def _claimed(problem: zo.Problem) -> zo.Orbit:
    """Return the orbit of the plain table, with the free motion of the mass on the spring."""
    plain = zo.find_orbit(magnet_spot.PROBLEM, parameters={"pull": 0.0}).unwrap()
    (phase,) = plain.phases

    def added(state: Mapping[str, float]) -> dict[str, float]:
        angle = math.atan2(state["sine"], state["cosine"]) - TOOTH_PLACE
        return {**state, "place": math.cos(angle), "rate": -30.0 * math.sin(angle)}

    assert phase.zeno_state is not None
    impacts = tuple(replace(one, state_minus=added(one.state_minus)) for one in phase.impacts)
    with_mass = replace(
        phase,
        start_state=added(phase.start_state),
        impacts=impacts,
        zeno_state=added(phase.zeno_state),
    )
    return replace(
        plain,
        problem=problem.name,
        parameters=dict(problem.values().parameters),
        problem_digest=(),
    ).with_phases((with_mass,))


def _height(time: float) -> float:
    """Return the height of the ball above the table since its release, in closed form."""
    start = math.asin(9.81 / (0.015 * 30.0**2))
    lift = math.sin(30.0 * time + start) - math.sin(start) - 30.0 * math.cos(start) * time
    return -0.015 * lift - 9.81 * time**2 / 2


def _first_touch(tooth: float) -> float:
    """Return when a tooth of some height first touches the ball after its release."""
    start = math.asin(9.81 / (0.015 * 30.0**2))

    def above(time: float) -> float:
        return _height(time) - tooth * _tooth(30.0 * time + start)

    times = np.linspace(1e-3, (TOOTH_PLACE - start) / 30.0, 20_000)
    after = next(k for k, time in enumerate(times) if above(time) < 0.0)
    return brentq(above, times[after - 1], times[after], xtol=1e-15)


ABOVE = _height((TOOTH_PLACE - math.asin(9.81 / (0.015 * 30.0**2))) / 30.0)
"""Height of the ball above the table when the tooth is at its highest [m]."""


@pytest.mark.slow
def test_an_orbit_that_clears_a_tooth_is_enclosed_though_its_return_map_does_not_contract() -> None:
    problem = _with_tooth(0.9 * ABOVE)
    found = zo.enclose_period(_claimed(problem), problem=problem)
    assert found.enclosed, found.verdict()


@pytest.mark.slow
def test_an_orbit_that_misses_an_impact_is_refused_with_its_time() -> None:
    problem = _with_tooth(1.1 * ABOVE)
    found = zo.enclose_period(_claimed(problem), problem=problem)
    assert found.claim == "impact_time"
    assert "impact 1 of phase 1" in found.reason
    # The tooth is touched at a grazing angle, where a start known to 1e-12 moves it by more.
    assert abs(_enclosed_in(found.reason) - _first_touch(1.1 * ABOVE)) < 1e-9


# Numbers that are not those of the orbit


def _start(orbit: zo.Orbit, change: Callable[[OrbitPhase], OrbitPhase]) -> zo.Orbit:
    return orbit.with_phases((change(orbit.phases[0]), *orbit.phases[1:]))


def _moved_state(phase: OrbitPhase) -> OrbitPhase:
    name = next(iter(phase.start_state))
    return replace(phase, start_state={**phase.start_state, name: phase.start_state[name] + 1e-6})


def _moved_impact_state(phase: OrbitPhase) -> OrbitPhase:
    first, name = phase.impacts[0], next(iter(phase.impacts[0].state_minus))
    moved = {**first.state_minus, name: first.state_minus[name] + 1e-6}
    return replace(phase, impacts=(replace(first, state_minus=moved), *phase.impacts[1:]))


FALSE: dict[str, tuple[Callable[[zo.Orbit], zo.Orbit], str]] = {
    "period off": (lambda o: replace(o, period=o.period * (1 + 1e-8)), "release_time"),
    "period doubled": (lambda o: replace(o, period=2 * o.period), "release_time"),
    "period halved": (lambda o: replace(o, period=o.period / 2), "period"),
    "start moved": (lambda o: _start(o, _moved_state), "state"),
    "first impact left out": (
        lambda o: _start(o, lambda p: replace(p, impacts=p.impacts[1:])),
        "impact_time",
    ),
    "all impacts left out": (lambda o: _start(o, lambda p: replace(p, impacts=())), "shape"),
    "impact state moved": (lambda o: _start(o, _moved_impact_state), "state"),
    "Zeno point moved": (
        lambda o: _start(o, lambda p: replace(p, zeno_time=(p.zeno_time or 0.0) + 1e-8)),
        "zeno_time",
    ),
    "other equations": (lambda o: replace(o, problem_digest=(1.0, 2.0)), "problem"),
}


@pytest.mark.parametrize("name", FALSE)
def test_numbers_of_no_execution_are_refused(table: zo.Orbit, name: str) -> None:
    change, claim = FALSE[name]
    found = zo.enclose_period(change(table))
    assert not found.enclosed
    assert found.claim == claim
    assert f"`{claim}`" in found.verdict()


def test_a_period_with_a_phase_left_out_is_refused() -> None:
    orbit = shot_orbit("two_tone_table")
    found = zo.enclose_period(orbit.with_phases(orbit.phases[:1]))
    assert found.claim == "release_time"


def test_a_box_too_large_to_follow_gives_the_reason(surface: zo.Orbit) -> None:
    found = zo.enclose_period(surface, radius=0.5)
    assert not found.enclosed
    assert found.claim not in {"", "width"}
    assert found.reason


@pytest.mark.slow
def test_a_box_that_spreads_beyond_the_tolerance_is_refused(surface: zo.Orbit) -> None:
    found = zo.enclose_period(surface, radius=1e-7)
    assert found.claim == "width"
    assert zo.enclose_period(surface, radius=1e-7, tolerance=1e-4).enclosed


@pytest.mark.parametrize("kinds", [("impact",), ("impact", "plastic")])
def test_impacts_that_let_go_at_once_are_refused(table: zo.Orbit, kinds: tuple[str, ...]) -> None:
    (phase,) = table.phases
    thrown = replace(phase, impacts=phase.impacts[:1], zeno_time=None, zeno_state=None)
    phases = tuple(
        replace(phase if kind == "plastic" else thrown, kind=PhaseKind(kind)) for kind in kinds
    )
    found = zo.enclose_period(table.with_phases(phases))
    assert found.claim == "shape"
    assert f"`{','.join(kinds)}`" in found.reason


@pytest.mark.parametrize("options", [{"radius": 2.0}, {"tolerance": 0.0}, {"radius": math.nan}])
def test_a_radius_or_tolerance_out_of_range_is_refused(
    table: zo.Orbit, options: dict[str, Any]
) -> None:
    with pytest.raises(zo.InputError, match=next(iter(options))):
        zo.enclose_period(table, **options)


def test_an_enclosure_survives_copies(table: zo.Orbit) -> None:
    found = zo.enclose_period(table)
    assert pickle.loads(pickle.dumps(found)) == copy.deepcopy(found) == found


# The command


@pytest.fixture
def file(table: zo.Orbit, tmp_path: Path) -> Path:
    zo.write_orbit(table, tmp_path / "orbit.json")
    return tmp_path / "orbit.json"


@pytest.mark.slow
def test_the_command_prints_one_line_and_a_json_entry(file: Path) -> None:
    answer = ask("verify", file, "--rigorous")
    assert answer.code == YES, answer.err
    (line,) = [one for one in answer.out.splitlines() if one.startswith("Rigorous: ")]
    assert "1 Zeno point, 1 release. No event is missed." in line
    data = ask("verify", file, "--rigorous", "--json").data
    assert data["passed"]
    assert data["rigorous"]["enclosed"]
    assert data["rigorous"]["events"][-1]["kind"] == "release"
    assert "rigorous" not in ask("verify", file, "--json").data


@pytest.mark.slow
def test_the_command_fails_with_the_reason(table: zo.Orbit, file: Path) -> None:
    first = table.phases[0]
    shorter = replace(first, impacts=first.impacts[1:])
    zo.write_orbit(table.with_phases((shorter,)), file)
    answer = ask("verify", file, "--rigorous")
    assert answer.code == NO
    assert "Rigorous: not enclosed: `impact_time`: impact 1 of phase 1 is enclosed" in answer.out


@pytest.mark.slow
@pytest.mark.parametrize(("sign", "offset"), fast(1, [(-1, 0.0), (-1, 0.25), (1, -0.5)]))
def test_a_gap_against_its_coordinate_is_enclosed_with_the_signs_of_the_states(
    sign: int, offset: float
) -> None:
    # A ball on a shaken table: the coordinate may point downward, from any origin.
    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        clock = zo.Clock.at(p["omega"])
        ball = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=p["m"] * v**2 / 2,
            potential=sign * p["m"] * p["g"] * q,
            gap=sign * q + offset,
            applied_force=sign * p["m"] * p["A"] * p["omega"] ** 2 * clock.sine,
            clock=clock,
        )
        return zo.hybrid_system(ball, zo.no_drive(ball), p["restitution"])

    known = zo.load_problem("vibrating_table")
    problem = replace(
        known,
        model=model,
        starts=({"height": -sign * offset, "cosine": 1.0},),
        outputs=(),
        drawing=None,
        origin=None,
    )
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    first = orbit.impacts[0]
    assert sign * first.state_minus["speed"] < 0.0
    found = zo.enclose_period(orbit, problem=problem)
    assert found.enclosed, found.verdict()
    flipped = {**first.state_minus, "speed": -first.state_minus["speed"]}
    phase = orbit.phases[0]
    impacts = (replace(phase.impacts[0], state_minus=flipped), *phase.impacts[1:])
    false = orbit.with_phases((replace(phase, impacts=impacts), *orbit.phases[1:]))
    assert not zo.enclose_period(false, problem=problem).enclosed
