"""What a search is asked is reached, and measured without the program that reached it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.support.measured import measured
from tests.support.returns import multipliers_at
from zeno_orbits import (
    MaxMargin,
    MaxPush,
    MinBounceTime,
    MinEnergy,
    MinImpactLoss,
    MinPeak,
    MinSpectralRadius,
    NearestGains,
    TargetAmplitude,
    TargetPeriod,
)
from zeno_orbits.api import Verified
from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem, load_problem, load_reference
from zeno_orbits.orbits import Bound, Orbit
from zeno_orbits.search import (
    OBJECTIVES,
    Objective,
    Operand,
    SearchSettings,
    SearchStatus,
    TransientSettings,
    Verdict,
    objective_help,
    orbit_at_gains,
    orbit_by_shooting,
    search_orbits,
)
from zeno_orbits.simulation import simulate
from zeno_orbits.verification import OrbitCertificate

ONCE = SearchSettings(n_starts=0)
OPTIMAL = 1e-5
"""How near the best value the solver stops: ten times its optimality tolerance, relative."""


def _scan(
    problem: Problem, name: str, entries: Sequence[float], quantity: str, **fixed: float
) -> list[float]:
    """Return a quantity of the orbits on a line, each closed by simulation alone."""
    found: list[float] = []
    near: Orbit | None = None
    for value in entries:
        values = problem.values().replaced({**fixed, name: value})
        near = orbit_by_shooting(problem, values, near=near).unwrap()
        extent = measured(near, problem, quantity)
        found.append(extent.largest)
    return found


# What objectives ask of a program and how they score, at terms made by hand.


def test_gains_that_are_wanted_are_named() -> None:
    assert NearestGains(target={"Kp": 2.5, "Kd": -1.0}).wish == "gains near Kp = 2.5, Kd = -1"
    assert NearestGains(target={}).wish == "gains near the start"


def test_a_gain_that_is_wanted_is_a_finite_number(problem: Problem) -> None:
    NearestGains(target={"Kd": 1.0, "R": 2.0}).check(problem, {"R": (1.0, 3.0)})
    with pytest.raises(InputError, match="finite for `Kd`, but it is inf"):
        NearestGains(target={"Kp": 1.0, "Kd": math.inf}).check(problem, {})
    with pytest.raises(InputError, match=r"free parameters \(Kp, Kd, R\), but it names `L`"):
        NearestGains(target={"L": 1.0}).check(problem, {"R": (1.0, 3.0)})


@pytest.mark.parametrize("target", [0.0, -1.0, math.inf, math.nan])
def test_a_target_is_positive_and_finite(problem: Problem, target: float) -> None:
    TargetPeriod(target=1e-3).check(problem, {})
    TargetAmplitude(target=1e-3, state="theta1").check(problem, {})
    for objective in (TargetPeriod(target=target), TargetAmplitude(target=target, state="theta1")):
        with pytest.raises(InputError, match=f"a positive target, but it is {target:g}"):
            objective.check(problem, {})


def test_an_amplitude_is_one_of_a_state(problem: Problem) -> None:
    with pytest.raises(InputError, match=r"\(theta1, .*\), but it names `angle`"):
        TargetAmplitude(target=1.0, state="angle").check(problem, {})


# Words of the command line.


def test_every_word_makes_its_objective(problem: Problem) -> None:
    made = {
        word: one.objective(problem, operand)
        for (word, one), operand in zip(
            OBJECTIVES.items(),
            [{"Kp": 2.0}, 1.8, 0.5, None, "current", None, None, {"theta2": 1.0}, {}, "lower", ""],
            strict=True,
        )
    }
    assert made == {
        "nearest": NearestGains(target={"Kp": 2.0}),
        "period": TargetPeriod(target=1.8),
        "amplitude": TargetAmplitude(target=0.5, state="theta1"),
        "energy": MinEnergy(),
        "peak": MinPeak(signal="current"),
        "contraction": MinSpectralRadius(),
        "margin": MaxMargin(),
        "push": MaxPush(direction={"theta2": 1.0}),
        "robustness": MaxPush(),
        "impacts": MinImpactLoss(stop="lower"),
        "bounce": MinBounceTime(),
    }


def test_help_names_every_word_with_its_operand() -> None:
    words = {
        "nearest": Operand.NUMBERS,
        "period=SECONDS": Operand.NUMBER,
        "amplitude=VALUE": Operand.NUMBER,
        "energy": Operand.NOTHING,
        "peak=SIGNAL": Operand.SIGNAL,
        "contraction": Operand.NOTHING,
        "margin": Operand.NOTHING,
        "push": Operand.DIRECTION,
        "robustness": Operand.DIRECTION,
        "impacts": Operand.STOP,
        "bounce": Operand.STOP,
    }
    assert {one.usage: one.operand for one in OBJECTIVES.values()} == words
    told = objective_help()
    assert told.startswith("nearest (to the problem's gains), nearest:NAME=VALUE,..., period=")
    assert (
        ", peak=SIGNAL (least peak of current, voltage or a state, likewise), contraction (" in told
    )
    assert ", margin (widest range of the free values before the orbit is lost), push or " in told
    assert told.endswith(
        ", or bounce or bounce=STOP (least time from first impacts to Zeno points, likewise)"
    )


# Objectives, each against a scan by simulation.


@pytest.mark.parametrize("quantity", ["current", "voltage"])
@pytest.mark.slow
def test_the_least_peak_is_that_of_a_scan(problem: Problem, quantity: str) -> None:
    scan = _scan(problem, "Kp", np.linspace(2.0, 3.0, 11).tolist(), quantity)
    result = search_orbits(
        problem,
        problem.values(),
        free={"Kp": (2.0, 3.0)},
        objective=MinPeak(signal=quantity),
        settings=ONCE,
    )
    best = result.candidates[0]
    assert best.extents[quantity].largest == pytest.approx(min(scan), rel=OPTIMAL)
    assert best.score == best.extents[quantity].largest


@pytest.mark.slow
def test_the_fastest_contraction_is_that_of_a_scan(problem: Problem) -> None:
    # Along this line the larger multiplier does not cross zero, where anything would do.
    scan = _scan(problem, "Kd", np.linspace(-1.2, -1.1, 5).tolist(), "spectral_radius")
    result = search_orbits(
        problem,
        problem.values(gains={"Kd": -1.15}),
        free={"Kd": (-1.2, -1.1)},
        objective=MinSpectralRadius(),
        settings=ONCE,
    )
    assert result.candidates[0].score == pytest.approx(min(scan), rel=1e-3)
    orbit = result.unwrap()
    dynamics = problem.dynamics(orbit.values(problem))
    release = np.array(list(orbit.release_state.values()))
    multipliers = multipliers_at(dynamics, release, orbit.period)
    # The one that was made small is the dominating one.
    assert abs(multipliers[0]) == pytest.approx(result.candidates[0].score, abs=1e-6)


# Bounds.


@pytest.mark.slow
def test_a_bound_on_an_angle_is_active_and_held_at_all_times(problem: Problem) -> None:
    highest = 1.9
    result = search_orbits(
        problem,
        problem.values(),
        free={"Kd": (-1.1, -0.8)},
        bounds=[Bound(name="theta2", upper=highest)],
        settings=ONCE,
    )
    orbit = result.unwrap()
    dynamics = load_reference(problem).dynamics(orbit.values(problem))
    start = dynamics.on_stop(np.array(list(orbit.release_state.values())))
    run = simulate(dynamics, start, until=1.2 * orbit.period)
    times = np.linspace(0.0, orbit.period, 20_001)
    angles = [run.state_at(float(time))[1] for time in times]
    # Without the bound it swings to 1.988, so a nearest orbit lies on the bound.
    assert highest - 1e-4 < max(angles) <= highest + 1e-9


@pytest.mark.slow
def test_a_spectral_radius_is_kept(problem: Problem) -> None:
    result = search_orbits(
        problem,
        problem.values(gains={"Kd": -1.2}),
        free={"Kd": (-1.3, -0.9)},
        bounds=[Bound(name="spectral_radius", upper=0.1)],
        settings=ONCE,
    )
    extent = result.candidates[0].extents["spectral_radius"]
    # Without the bound it would be twice that.
    assert 0.09 < extent.highest <= 0.1


@pytest.mark.slow
def test_the_nearest_orbit_to_bounds_that_no_gains_keep_is_that_of_a_scan(problem: Problem) -> None:
    radius, current = 0.2, 2.0
    box = {gain.name: (gain.lower, gain.upper) for gain in problem.gains}
    result = search_orbits(
        problem,
        problem.values(),
        free=box,
        objective=MinEnergy(),
        bounds=[
            Bound(name="spectral_radius", upper=radius),
            Bound(name="current", lower=-current, upper=current),
        ],
        settings=ONCE,
    )
    assert result.status is SearchStatus.NOT_SOLVED
    assert result.detail.startswith("No orbit was found that keeps all bounds. The nearest one, at")
    assert "(Kp at its bound 1)" in result.detail
    # Simulation alone: on no line of fixed Kp do the two intervals of Kd meet, least so at Kp = 1.
    lacks: list[float] = []

    def peak_at(derivative: float) -> float:
        return _scan(problem, "Kd", [derivative], "current", Kp=1.0)[0] - current

    for proportional in (1.0, 1.2, 2.0, 3.0):

        def peak(derivative: float, Kp: float = proportional) -> float:
            return _scan(problem, "Kd", [derivative], "current", Kp=Kp)[0] - current

        there = float(brentq(peak, -1.0, -0.5, xtol=1e-6))
        lacks += _scan(problem, "Kd", [there], "spectral_radius", Kp=proportional)
        # Less Kd against gravity, more current; more Kd, slower contraction.
        assert peak(there - 0.05) > 0.0
        assert _scan(problem, "Kd", [there + 0.05], "spectral_radius", Kp=proportional) > lacks[-1:]
    assert lacks == sorted(lacks)
    # What both bounds lack is shared: less of one is more of the other.
    found = re.search(
        r"Kd = (\S+) .*:0.2 by (\S+); `current` leaves its bounds -2:2 by (\S+)\.$", result.detail
    )
    assert found is not None
    derivative, slow, strong = map(float, found.groups())
    assert slow < lacks[0] - radius
    assert _scan(problem, "Kd", [derivative], "spectral_radius", Kp=1.0)[0] == pytest.approx(
        radius + slow, abs=2e-4
    )
    assert peak_at(derivative) == pytest.approx(strong, abs=2e-3)


@pytest.mark.slow
def test_a_spectral_radius_is_kept_where_the_section_has_three_coordinates() -> None:
    problem = load_problem("two_motors")
    here, asked = problem.values().number("Kd"), 0.1
    result = search_orbits(
        problem,
        problem.values(),
        free={"Kd": (-1.2, -0.8)},
        bounds=[Bound(name="spectral_radius", upper=asked)],
        settings=ONCE,
    )
    assert result.candidates[0].extents["spectral_radius"].highest <= asked

    def radius(value: float) -> float:
        return _scan(problem, "Kd", [value], "spectral_radius")[0] - asked

    assert radius(here) > 0.0
    nearest = float(brentq(radius, here, here + 0.1, xtol=1e-9))
    assert result.unwrap().gains["Kd"] == pytest.approx(nearest, abs=1e-6)


@pytest.mark.slow
def test_an_orbit_at_fixed_numbers_that_passes_a_bound_is_refused(problem: Problem) -> None:
    result = search_orbits(
        problem, problem.values(), free={}, bounds=[Bound(name="theta2", upper=1.9)], settings=ONCE
    )
    assert result.status is SearchStatus.NOT_ACCEPTED
    assert result.orbit is None
    assert result.detail == "`theta2` leaves its bounds :1.9 by 0.0883."


# What is free.


@pytest.mark.slow
def test_a_free_parameter_is_found_and_what_is_derived_from_it_stays(problem: Problem) -> None:
    start = problem.values()
    box = {"R": (2.0, 4.0), "L1": (0.195, 0.205)}
    result = search_orbits(
        problem, start, free=box, objective=TargetPeriod(target=1.8), settings=ONCE
    )
    orbit = result.unwrap()
    assert orbit.period == pytest.approx(1.8, abs=1e-8)
    assert orbit.gains == start.gains
    moved = {n for n, value in orbit.parameters.items() if value != start.parameters[n]}
    assert moved == {"R", "L1"}
    # The calibration would have moved the rotor; the orbit says what it stands for.
    other = problem.values(parameters={"L1": orbit.parameters["L1"]})
    assert other.parameters["J_rotor"] != orbit.parameters["J_rotor"]
    closed = orbit_by_shooting(problem, orbit.values(problem), near=orbit).unwrap()
    assert closed.period == pytest.approx(1.8, abs=1e-8)


@pytest.mark.slow
def test_a_free_restitution_moves_the_impacts_and_the_zeno_point_with_it(problem: Problem) -> None:
    result = search_orbits(
        problem,
        problem.values(),
        free={"restitution": (0.1, 0.35)},
        objective=TargetPeriod(target=1.8126),
        settings=ONCE,
    )
    orbit = result.unwrap()
    closed = orbit_by_shooting(problem, orbit.values(problem)).unwrap()
    assert closed.period == pytest.approx(1.8126, abs=1e-8)
    assert 0.2 < orbit.parameters["restitution"] < 0.3


# Ways to an orbit.


@pytest.mark.slow
def test_a_known_orbit_is_followed_to_other_numbers(problem: Problem, orbit: Orbit) -> None:
    values = problem.values(parameters={"restitution": 0.3, "R": 2.8})
    result = search_orbits(problem, values, free={}, near=orbit, settings=ONCE)
    alone = orbit_by_shooting(problem, values).unwrap()
    assert result.unwrap().period == pytest.approx(alone.period, abs=1e-8)


@pytest.mark.slow
def test_the_end_of_a_family_is_named(problem: Problem, orbit: Orbit) -> None:
    values = problem.values(parameters={"restitution": 0.5})
    result = search_orbits(problem, values, free={}, near=orbit, settings=ONCE)
    assert result.status is SearchStatus.NO_GUESS
    assert "the contact phase vanishes" in result.detail
    end = float(result.detail.split("restitution = ")[1].split(",")[0])
    # Where the contact phase vanishes was measured beforehand to be near 0.417.
    assert end == pytest.approx(0.4168, abs=2e-4)


@pytest.mark.slow
def test_a_start_that_settles_to_nothing_is_reached_from_an_easier_one(problem: Problem) -> None:
    # Too short a wait for the motion to settle at these gains, but not at the problem's own.
    brief = SearchSettings(n_starts=0, settling=TransientSettings(horizon=4.0))
    values = problem.values(gains={"Kp": 2.5, "Kd": -1.2})
    result = orbit_at_gains(problem, values, settings=brief)
    patient = orbit_at_gains(problem, values)
    assert result.unwrap().period == pytest.approx(patient.unwrap().period, abs=1e-8)


@pytest.mark.slow
def test_candidates_are_ranked_and_the_best_is_the_orbit(problem: Problem) -> None:
    settings = SearchSettings(n_starts=2, candidates=2)
    result = search_orbits(
        problem,
        problem.values(),
        free={"Kd": (-1.1, -0.9)},
        objective=TargetPeriod(target=1.8),
        settings=replace(settings, candidates=2),
    )
    scores = [one.score for one in result.candidates]
    assert scores == sorted(scores)
    assert result.orbit is result.candidates[0].orbit
    # Every start leads to the one orbit of that period on this line.
    assert [one.starts for one in result.candidates] == [3]
    assert [one.status for one in result.attempts] == [SearchStatus.FOUND] * 3


# Orbits that do not attract.


@pytest.mark.slow
def test_the_best_orbit_that_attracts_is_taken_where_the_best_of_all_lies_on_a_fold(
    problem: Problem, certificate: OrbitCertificate
) -> None:
    on_fold = replace(certificate, multipliers=(1.0 + 0.0j,))
    seen: list[Orbit] = []

    def refuse_the_first(orbit: Orbit) -> Verdict:
        seen.append(orbit)
        if len(seen) == 1:
            return Verdict(objection="It does not attract.", certificate=on_fold)
        return Verdict(certificate=certificate)

    result = search_orbits(
        problem,
        problem.values(),
        free={"Kd": (-1.1, -0.9)},
        accept=refuse_the_first,
        settings=ONCE,
    )
    assert result.status is SearchStatus.FOUND
    assert len(seen) == 2
    assert result.candidates[0].extents["spectral_radius"].highest < 0.99
    assert result.detail.startswith("The best orbit, at Kp = 2.5, Kd = -1, lies on a fold of the")
    assert "the best orbit with a spectral radius up to 0.99" in result.detail


@pytest.mark.slow
def test_gains_beyond_a_fold_lead_to_the_nearest_orbit_that_attracts(problem: Problem) -> None:
    target = {"Kp": 2.5, "Kd": -1.8}
    result = search_orbits(
        problem,
        problem.values(),
        free={"Kp": (2.0, 3.0), "Kd": (-1.9, -1.2)},
        objective=NearestGains(target=target),
        accept=Verified(problem=problem),
        settings=ONCE,
    )
    gains = result.unwrap().gains
    # Along Kp = 2.5 a simulation attracts up to Kd = -1.6219.
    assert gains == pytest.approx({"Kp": 2.5, "Kd": -1.622}, abs=0.02)
    certificate = result.candidates[0].certificate
    assert certificate is not None
    assert certificate.stable
    assert "Orbits could be followed to Kd = -1.62" in result.detail


# Misuse.


@pytest.mark.parametrize(
    ("free", "bounds", "objective", "said"),
    [
        ({"restitution": (0.1, 1.1)}, [], None, r"`restitution` must lie in \[0, 1\]"),
        ({"R": (4.0, 2.0)}, [], None, "`vary` must have finite bounds LOWER < UPPER for `R`"),
        ({"Q": (1.0, 2.0)}, [], None, "`vary`: unknown name `Q`.*Known: Kp, .*R"),
        ({}, [Bound(name="angle", upper=1.0)], None, "`bounds`: unknown name `angle`"),
        ({}, [Bound(name="spectral_radius", lower=0.1)], None, "from above only"),
        ({}, [Bound(name="spectral_radius", upper=0.0)], None, "by 0.0001 or more"),
        ({}, [Bound(name="spectral_radius", upper=9e-5)], None, "by 0.0001 or more"),
        ({}, [Bound(name="margin", lower=1.0)], None, "a `margin` below 1"),
        ({}, [Bound(name="period", upper=0.0)], None, "a positive `period`"),
        ({}, [Bound(name="period", upper=2.0)] * 2, None, "must bound `period` once"),
        ({"Kp": (1.0, 2.0)}, [], MinPeak(signal="torque"), "`objective`: unknown name `torque`"),
        ({"Kp": (1.0, 2.0)}, [], NearestGains(target={"R": 2.0}), "names `R`"),
    ],
)
def test_a_question_that_makes_no_sense_is_refused(
    problem: Problem,
    free: dict[str, tuple[float, float]],
    bounds: list[Bound],
    objective: Objective | None,
    said: str,
) -> None:
    with pytest.raises(InputError, match=said):
        search_orbits(problem, problem.values(), free=free, bounds=bounds, objective=objective)


def test_an_orbit_of_another_problem_is_no_start(problem: Problem, orbit: Orbit) -> None:
    other = problem.at_fidelity("quasi_static")
    with pytest.raises(InputError, match="`near` must be of problem `motor_pendulum@quasi_static`"):
        search_orbits(other, other.values(), free={}, near=orbit, objective=MinEnergy())
