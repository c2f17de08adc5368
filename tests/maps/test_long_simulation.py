"""What a long simulation calls the motions of problems whose attractors are known."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import pytest

from tests.reference.closed_forms import StoppedOscillator
from tests.reference.long_simulation import LongRun, attractor_of
from tests.reference.reference_orbit import MULTIPLIER, PERIOD
from tests.support.mechanisms import clocked_oscillator, oscillator
from zeno_orbits import StateLimit
from zeno_orbits.integrators import Tolerance
from zeno_orbits.maps import Attractor, AttractorClass
from zeno_orbits.maps.attractors import attractor_from_json, attractor_json
from zeno_orbits.model import Problem, load_problem
from zeno_orbits.simulation import SimulationSettings

QUICK = LongRun(
    until=40.0,
    simulation=SimulationSettings(tolerance=Tolerance(relative=1e-9, absolute=1e-11)),
)


def at(problem: Problem, run: LongRun = QUICK, **numbers: float) -> Attractor:
    gains = {gain.name for gain in problem.gains}
    values = problem.values(
        gains={name: value for name, value in numbers.items() if name in gains},
        parameters={name: value for name, value in numbers.items() if name not in gains},
    )
    return attractor_of(problem, values, run=run)


def test_the_reference_orbit_is_a_zeno_orbit_of_period_one_with_its_multiplier(
    problem: Problem,
) -> None:
    found = at(problem)
    assert (found.fate, found.returns) == (AttractorClass.ZENO, 1)
    # A return that repeats to 1e-6 has its time to the same.
    assert found.period == pytest.approx(PERIOD, rel=1e-6)
    # Differences over 1e-4 are off by its square, and by the integration over it: 1e-9 / 1e-4.
    assert found.multipliers[0] == pytest.approx(MULTIPLIER, abs=3e-5)
    assert found.spectral_radius == abs(found.multipliers[0])
    assert set(found.margins) == {
        "gap_acceleration",
        "first_impact_speed",
        "release_transversality",
        "locked_time",
    }
    assert found.margins["first_impact_speed"] == pytest.approx(16.909711305434, rel=1e-5)


def test_a_plastic_stop_makes_the_orbit_simple(problem: Problem) -> None:
    found = at(problem, restitution=0.0)
    assert (found.fate, found.returns) == (AttractorClass.SIMPLE, 1)
    assert found.period == pytest.approx(1.82033892548, rel=1e-6)


def test_where_the_locked_arc_has_shrunk_to_nothing_the_orbit_has_no_zeno_point(
    problem: Problem,
) -> None:
    found = at(problem, replace(QUICK, until=100.0), restitution=0.43)
    assert (found.fate, found.returns) == (AttractorClass.NO_ZENO, 0)
    assert found.period == pytest.approx(1.8141, abs=1e-3)


@pytest.mark.parametrize(
    ("gains", "name", "phrase"),
    [
        ({"Kp": 2.5, "Kd": -1.8}, "theta1", "link 1 rotates"),
        ({"Kp": 3.0, "Kd": -3.0}, "theta2", "link 2 goes over the top"),
    ],
)
def test_what_runs_away_is_named_by_what_it_means(
    problem: Problem, gains: Mapping[str, float], name: str, phrase: str
) -> None:
    found = at(problem, **gains)
    assert (found.fate, found.escaped, found.detail) == (AttractorClass.ESCAPE, name, phrase)


@pytest.mark.slow
def test_a_link_that_swings_past_half_a_turn_and_comes_back_does_not_run_away(
    problem: Problem,
) -> None:
    close = problem.escapes | {"theta2": StateLimit(beyond=2.0, phrase="nearly")}
    numbers = {"Kp": 3.56, "Kd": -1.48}
    assert at(problem, **numbers).fate is AttractorClass.ZENO
    assert at(replace(problem, escapes=close), **numbers).detail == "nearly"


def test_a_ball_comes_to_rest_on_the_floor() -> None:
    found = at(load_problem("bouncing_ball"))
    assert found.fate is AttractorClass.REST
    assert found.state == {"height": 0.0, "speed": 0.0}


def test_the_forced_oscillator_has_the_zeno_orbit_of_the_closed_form() -> None:
    stopped = StoppedOscillator(damping=1.9, stop=-0.8, restitution=0.5)
    found = at(clocked_oscillator(stopped, attracting=True))
    assert (found.fate, found.returns) == (AttractorClass.ZENO, 1)
    assert found.period == pytest.approx(2 * math.pi, rel=1e-6)


@pytest.mark.slow
def test_an_oscillation_that_dies_slowly_is_told_with_its_factor_a_period() -> None:
    found = at(oscillator(damping=0.1))
    assert found.fate is AttractorClass.UNSETTLED
    # The maxima of exp(-c t / 2) cos(w t) follow each other at 2 pi / w.
    damped = math.sqrt(1 - 0.1**2 / 4)
    assert found.trend == pytest.approx(math.exp(-0.05 * 2 * math.pi / damped), rel=1e-4)
    assert found.phrase.endswith("decaying")


@pytest.mark.slow
def test_an_oscillation_that_grows_slowly_is_told_so_and_one_that_died_rests() -> None:
    growing = at(oscillator(damping=-0.02))
    assert growing.fate is AttractorClass.UNSETTLED
    assert growing.trend > 1.0
    assert growing.phrase.endswith("growing")
    assert at(oscillator(damping=1.5)).fate is AttractorClass.REST


def test_a_coordinate_without_a_bound_runs_away_in_the_end() -> None:
    found = at(oscillator(stiffness=-1.0))
    assert (found.fate, found.escaped, found.detail) == (AttractorClass.ESCAPE, "x", "x diverges")


def test_free_oscillations_repeat_without_a_zeno_point() -> None:
    found = at(oscillator(damping=0.0))
    assert found.fate is AttractorClass.NO_ZENO
    assert found.period == pytest.approx(2 * math.pi, rel=1e-6)


def test_a_simulation_that_stops_is_a_failure_with_its_reason(problem: Problem) -> None:
    few = replace(QUICK, simulation=replace(QUICK.simulation, most_steps=50))
    found = at(problem, few)
    assert found.fate is AttractorClass.FAILED
    assert "more than 50 steps" in found.detail


@pytest.mark.parametrize(
    "attractor",
    [
        Attractor(fate=AttractorClass.REST, state={"x": 0.0}),
        Attractor(fate=AttractorClass.UNSETTLED, trend=0.0),
        Attractor(fate=AttractorClass.ESCAPE, escaped="x", detail="x diverges"),
        Attractor(
            fate=AttractorClass.ZENO,
            returns=2,
            period=0.1 + 0.2,
            multipliers=(complex(1 / 3, -5e-324), 0j),
            margins={"locked_time": 1e-300},
            state={"x": -0.0},
        ),
    ],
)
def test_an_attractor_comes_back_from_plain_data_to_the_last_bit(attractor: Attractor) -> None:
    back = attractor_from_json(attractor_json(attractor))
    assert repr(back) == repr(attractor)
