"""What a result shows of itself in a terminal or a notebook: a few lines, whatever it holds."""

from __future__ import annotations

from dataclasses import replace

import pytest

import zeno_orbits as zo
from tests.support.orbits import shot_orbit
from zeno_orbits.continuation import (
    Continuation,
    Family,
    FamilyPoint,
    SpecialPoint,
    SpecialPointKind,
)
from zeno_orbits.maps import Attractor, AttractorClass, Axis
from zeno_orbits.search import SearchStatus, StartAttempt
from zeno_orbits.simulation import simulate
from zeno_orbits.verification import with_certificate

MOST_CHARACTERS = 600


def shown(result: object) -> str:
    """Return the text of a result, which fits a screen."""
    assert len(repr(result)) < MOST_CHARACTERS
    assert str(result) == repr(result)
    return repr(result)


def special(kind: SpecialPointKind, value: float) -> SpecialPoint:
    at = FamilyPoint(value=value, state={}, period=1.0, multipliers=(), margins={}, miss=0.0)
    return SpecialPoint(kind=kind, at=at, error=0.0, index=0)


def test_an_execution_shows_its_span_and_its_events(
    orbit: zo.Orbit, problem: zo.Problem, machine: object
) -> None:
    start = problem.state_vector(orbit.release_state)
    text = shown(simulate(machine, start, until=1.1 * orbit.period))
    assert "from 0 to 1.99508" in text
    assert "impacts=10, zeno_points=1, releases=1" in text


def test_an_orbit_shows_its_gains_period_and_multipliers(
    orbit: zo.Orbit, certificate: zo.OrbitCertificate
) -> None:
    text = shown(with_certificate(orbit, certificate))
    assert text.startswith("<Orbit of motor_pendulum: Kp=2.5, Kd=-1, period=1.813712939 s")
    assert "verified=True" in text
    assert "verified=False" in shown(orbit)


def test_a_certificate_shows_its_verdict(certificate: zo.OrbitCertificate) -> None:
    assert certificate.verdict() in shown(certificate)


@pytest.mark.parametrize("succeeded", [True, False])
def test_a_search_shows_how_it_ended(orbit: zo.Orbit, succeeded: bool) -> None:
    attempts = (StartAttempt(gains=orbit.gains, status=SearchStatus.FOUND),) * 50
    result = zo.SearchResult(
        status=SearchStatus.FOUND if succeeded else SearchStatus.NO_GUESS,
        orbit=orbit if succeeded else None,
        residuals={str(k): 0.0 for k in range(1000)},
        agreement=0.0,
        closure_error=0.0,
        n_unknowns=0,
        iterations=0,
        solve_time=0.0,
        wall_time=1.0,
        attempts=attempts,
    )
    text = shown(result)
    assert "starts=50" in text
    assert ("<Orbit of" in text) is succeeded


def test_families_show_their_named_points() -> None:
    family = Family(
        problem="motor_pendulum",
        parameter="restitution",
        gains={},
        parameters={},
        n_returns=1,
        points=(special(SpecialPointKind.FOLD, 0.2).at,) * 1000,
        special=(special(SpecialPointKind.FOLD, 0.2),) * 20,
        first=special(SpecialPointKind.START, 0.1),
        last=special(SpecialPointKind.BOUND, 0.5),
    )
    assert "points=1000" in shown(family)
    assert "fold at 0.2" in shown(family)
    assert "and 14 more" in shown(family)
    found = Continuation(families=(replace(family, special=()),) * 3)
    assert "families=3, boundaries=0" in shown(found)


def test_a_map_shows_its_axes_and_counts_what_motions_settle_to() -> None:
    zeno = Attractor(fate=AttractorClass.ZENO, returns=1)
    found = zo.ParameterMap(
        problem="motor_pendulum",
        x=Axis(name="Kp", lower=1.0, upper=3.0, count=100, unit="V/rad"),
        y=Axis(name="Kd", lower=-2.0, upper=-1.0, count=30, unit="V s/rad"),
        gains={},
        parameters={},
        start={},
        until=60.0,
        attractors=(*(zeno,) * 2999, Attractor(fate=AttractorClass.REST)),
        versions={},
    )
    text = shown(found)
    assert "Kp from 1 to 3 in 100 points" in text
    assert "Zeno periodic orbit: 2999, rest: 1" in text


@pytest.mark.slow
def test_runs_and_recordings_show_their_span_and_their_size(orbit: zo.Orbit) -> None:
    run = zo.simulate_rig("motor_pendulum", until=0.4)
    assert shown(run).startswith("<RigRun of motor_pendulum from 0 to 0.4 s: times=")
    settled = zo.simulate_experiment(orbit, cycles=1, settle=0)
    assert shown(settled).startswith("<SettledRig of motor_pendulum: cycles=1, periods=1.8")
    recording = zo.sample_execution("motor_pendulum", zo.simulate("motor_pendulum", until=0.4))
    assert "times=201, signals=theta1, theta2, " in shown(recording)
    assert shown(recording.signals[0]) == "<RecordedSignal theta1 [rad]: values=201>"


@pytest.mark.slow
def test_proofs_and_fits_show_their_verdicts() -> None:
    orbit = shot_orbit("vibrating_table")
    assert shown(zo.prove(orbit)).startswith(
        "<Proof of vibrating_table: Proved by inclusions: the return map"
    )
    assert "No event is missed" in shown(zo.enclose_period(orbit))
    problem = zo.load_problem("motor_pendulum")
    recording = zo.sample_execution(problem, zo.simulate(problem, until=20.0), noise=1e-4)
    fitted = zo.identify(problem, zo.crop(recording, 10.0), ["R"])
    assert shown(fitted).startswith("<Identification of motor_pendulum: R=")
