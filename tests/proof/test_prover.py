"""Orbits are proved, their certificates checked, and what is no orbit is not proved."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.commands import MISUSE, NO, YES, ask
from tests.support.orbits import shot_orbit
from zeno_orbits.model import CompletedSystem, Problem, load_problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.proof import ProofSettings, check_proof, prove_orbit


@pytest.fixture(scope="module")
def table() -> Orbit:
    return shot_orbit("vibrating_table")


@pytest.fixture(scope="module")
def surface() -> Orbit:
    return shot_orbit("curved_surface")


@pytest.mark.slow
def test_the_orbit_of_the_vibrating_table_is_proved_and_its_certificate_holds(
    table: Orbit,
) -> None:
    proof = zo.prove(table)
    assert proof.proved, proof.verdict()
    assert proof.bounds is not None
    # The period is that of the table, and the release where its acceleration is that of gravity.
    assert abs(float(proof.bounds.period.low) - 2 * math.pi / 30) < 1e-16
    assert proof.bounds.period.width < 1e-18
    assert float(proof.bounds.start_state["sine"].low) == pytest.approx(9.81 / 0.015 / 30**2, 1e-15)
    assert check_proof(dict(proof.certificate)).ok
    assert "periodic" in "\n".join(proof.lines())


def _curved(problem: Problem) -> Problem:
    """Return a problem with the gap `d + d^2 / 10` in place of its distance `d`."""

    def model(p: Mapping[str, Any]) -> CompletedSystem:
        one = problem.model(p).mechanism
        curved = replace(one, gap=one.gap + one.gap**2 / 10)
        return zo.hybrid_system(curved, zo.no_drive(curved), p["restitution"])

    return replace(problem, model=model)


@pytest.mark.parametrize("curved", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_an_orbit_without_contact_is_proved_at_its_published_state(*, curved: bool) -> None:
    problem = load_problem("impact_oscillator")
    problem = _curved(problem) if curved else problem
    shape = zo.EventSequence.parsed("impact")
    orbit = zo.find_orbit_by_shooting(problem, shape=shape).unwrap()
    proof = prove_orbit(orbit, problem)
    assert proof.proved, proof.verdict()
    assert proof.bounds is not None
    # The motion between two impacts is a free oscillation about the forced one: with the force at
    # its phase and the speeds v before and e v after, both ends of a period are at the stop.
    start = {name: float(one.low) for name, one in proof.bounds.start_state.items()}
    assert float(proof.bounds.period.low) == pytest.approx(2 * math.pi, 1e-15)
    assert start["speed"] == pytest.approx(_closed_speed(start["cosine"], start["sine"]), 1e-13)
    assert check_proof(dict(proof.certificate), problem).ok
    assert "just after the last impact" in " ".join(proof.statements())
    moved = replace(orbit, start_state={**orbit.start_state, "speed": start["speed"] + 1e-6})
    assert prove_orbit(moved, problem).claim == "closure"


def _closed_speed(cosine: float, sine: float) -> float:
    """Return the speed after the impact of an orbit that strikes once a turn, from its phase."""
    c, e = 0.1, 0.8
    w = math.sqrt(1 - c**2 / 4)
    decay, cos, sin = math.exp(-c * math.pi), math.cos(2 * math.pi * w), math.sin(2 * math.pi * w)
    # With m = k = omega = A = 1 the place y satisfies y'' + c y' + y = cos t, and sin(t) / c is a
    # motion. Its difference z to the place has z(T) = z(0), and its rate there is -v / e, not v.
    z = 1 - sine / c
    forced = cosine / c
    # z(T) = decay (z cos + (u + c z / 2) sin / w) with u = z'(0) = -v - forced.
    u = (z / decay - z * cos) * w / sin - c * z / 2
    after = decay * (u * cos - (z + c * u / 2) * sin / w)
    assert after + forced == pytest.approx((u + forced) / -e, rel=1e-11)
    return -(u + forced)


@pytest.mark.slow
def test_a_gap_that_is_no_coordinate_is_carried_and_the_certificate_holds(
    surface: Orbit,
) -> None:
    proof = zo.prove(surface)
    assert proof.proved, proof.verdict()
    assert proof.stable
    assert check_proof(dict(proof.certificate)).ok


# The first call, one in the middle and the last one; the others with `-m slow`.
@pytest.mark.parametrize(
    "other",
    fast(2, (1, 3, 6, 2, 4, 5)),
)
def test_a_model_with_other_formulas_at_one_call_gets_no_theorem_about_them(
    table: Orbit, other: int
) -> None:
    calls = list[int]()
    published = load_problem("vibrating_table")

    def model(p: Mapping[str, Any]) -> CompletedSystem:
        calls.append(1)
        factor = 1 + 1e-12 if len(calls) == other else 1.0
        return published.model({**p, "A": factor * p["A"]})

    proof = prove_orbit(table, replace(published, model=model))
    if proof.proved:
        assert check_proof(dict(proof.certificate), published).ok
    else:
        assert "other formulas" in proof.reason


def _start(orbit: Orbit, **moves: float) -> Orbit:
    first = orbit.phases[0]
    state = {**first.start_state}
    for name, move in moves.items():
        state[name] += move
    return orbit.with_phases((replace(first, start_state=state), *orbit.phases[1:]))


def _later_zeno(orbit: Orbit) -> Orbit:
    first = orbit.phases[0]
    assert first.zeno_time is not None
    later = replace(first, zeno_time=first.zeno_time + 1e-6)
    return orbit.with_phases((later, *orbit.phases[1:]))


def _later_impact(orbit: Orbit) -> Orbit:
    first = orbit.phases[0]
    later = replace(first.impacts[0], time=first.impacts[0].time + 1e-6)
    return orbit.with_phases((replace(first, impacts=(later, *first.impacts[1:])),))


FALSE: dict[str, tuple[Any, str]] = {
    "period doubled": (lambda o: replace(o, period=2 * o.period), "period"),
    "period off": (lambda o: replace(o, period=o.period * (1 + 1e-6)), "period"),
    "period halved": (lambda o: replace(o, period=o.period / 2), "period"),
    "release moved": (lambda o: _start(o, **{next(iter(o.start_state)): 1e-6}), "closure"),
    "Zeno point moved": (_later_zeno, "zeno_time"),
    "impact moved": (_later_impact, "impact_time"),
    "other equations": (lambda o: replace(o, problem_digest=(1.0, 2.0)), "problem"),
}


@pytest.mark.parametrize("name", fast(2, FALSE))
def test_what_is_no_orbit_is_not_proved(table: Orbit, surface: Orbit, name: str) -> None:
    change, claim = FALSE[name]
    # The clock alone says where the table lets go: a moved release is none, and returns to one.
    orbit = surface if claim == "closure" else table
    proof = prove_orbit(
        change(orbit), load_problem(orbit.problem), settings=ProofSettings(radius=1e-9)
    )
    assert not proof.proved
    assert proof.claim == claim
    assert f"`{claim}`" in proof.verdict()


@pytest.mark.weekly
@pytest.mark.slow
def test_a_basin_is_much_larger_than_a_box_lies_in_the_sampled_ball_and_its_certificate_holds() -> (
    None
):
    orbit = shot_orbit("torque_pendulum")
    box, basin = zo.prove(orbit), zo.prove(orbit, basin=True)
    ball = zo.recovery(orbit)
    assert basin.inside
    assert basin.stable
    for name, (_, half) in basin.box.items():
        assert 1e5 * box.box[name][1] < half < ball.extents[name]
    assert check_proof(dict(basin.certificate)).ok


@pytest.mark.slow
def test_a_map_that_turns_every_box_out_of_itself_gets_no_basin(surface: Orbit) -> None:
    proof = zo.prove(surface, basin=True)
    assert not proof.proved
    assert proof.claim == "inclusion"


def test_a_reset_of_the_wrong_sign_is_not_proved(table: Orbit) -> None:
    problem = load_problem("vibrating_table")

    def wrong(p: Any) -> Any:
        system = problem.model(p)
        return replace(system, impulse_direction=-system.impulse_direction)

    proof = prove_orbit(replace(table, problem_digest=()), replace(problem, model=wrong))
    assert not proof.proved
    assert proof.claim == "model"
    assert "turns the gap rate round" in proof.reason


def test_a_multiplier_that_is_not_the_stops_is_not_proved(table: Orbit) -> None:
    problem = load_problem("vibrating_table")

    def pulled(p: Any) -> Any:
        system = problem.model(p)
        return replace(system, multiplier=system.multiplier + 1)

    proof = prove_orbit(replace(table, problem_digest=()), replace(problem, model=pulled))
    assert proof.claim == "model"
    assert "multiplier" in proof.reason


@pytest.mark.slow
def test_a_stop_that_pulls_for_a_moment_is_not_proved() -> None:
    # The table of two tones throws the ball twice a turn; an orbit that is held the second time
    # would have to be pulled.
    orbit = shot_orbit("two_tone_table")
    assert orbit.shape.text == "zeno*2"
    pulled = orbit.with_phases(orbit.phases[:1])
    proof = zo.prove(pulled)
    assert not proof.proved
    assert proof.claim == "exists"


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [*(pytest.param(one, marks=pytest.mark.slow) for one in ("restitution", "A")), "omega"],
)
def test_an_orbit_is_proved_over_an_interval_of_any_number(table: Orbit, name: str) -> None:
    proof = zo.prove(table, interval={name: 1e-9})
    assert proof.proved, proof.verdict()
    verdict = check_proof(dict(proof.certificate))
    assert verdict.ok, verdict.claims


@pytest.mark.slow
def test_an_orbit_is_proved_wherever_its_stop_is_within_an_interval() -> None:
    # Steps are long here: the checker must not find derivatives wider than the prover does.
    proof = zo.prove(shot_orbit("forced_oscillator"), interval={"stop": 1e-9})
    assert proof.proved, proof.verdict()
    assert check_proof(dict(proof.certificate)).ok


@pytest.mark.slow
def test_the_enclosures_over_an_interval_hold_the_numbers_at_its_ends(table: Orbit) -> None:
    wide = zo.prove(table, interval={"restitution": 1e-6})
    assert wide.bounds is not None
    for change in (-1e-6, 1e-6):
        other = zo.find_orbit_by_shooting(
            "vibrating_table", parameters={"restitution": 0.3 + change}
        ).unwrap()
        one = zo.prove(other)
        assert one.bounds is not None
        for outer, inner in (
            *zip(wide.bounds.zeno_times, one.bounds.zeno_times, strict=True),
            *zip(wide.bounds.impact_times, one.bounds.impact_times, strict=False),
        ):
            assert bool(outer.low <= inner.high)
            assert bool(inner.low <= outer.high)
            # At its ends the interval is not much wider than what moves the numbers.
            assert outer.width < 1e-5


@pytest.mark.slow
def test_the_command_proves_writes_and_checks(table: Orbit, tmp_path: Path) -> None:
    orbit, proof = tmp_path / "orbit.json", tmp_path / "proof.json"
    zo.write_orbit(table, orbit)
    answer = ask("prove", str(orbit), "-o", str(proof))
    assert answer.code == YES, answer.err
    assert "Theorem." in answer.out
    assert json.loads(proof.read_text())["problem"] == "vibrating_table"
    checked = ask("prove", "--check", str(proof))
    assert checked.code == YES
    assert "every claim holds" in checked.out
    zo.write_orbit(replace(table, period=2 * table.period), orbit)
    refused = ask("prove", str(orbit))
    assert refused.code == NO
    assert "Not proved: `period`" in refused.out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "`--check`"),
        (("orbit.json", "--check", "proof.json"), "both"),
        (("orbit.json", "--interval", "A=0.5:1e-9"), "`A`"),
        (("orbit.json", "--interval", "nothing=1:1e-9"), "`nothing`"),
        (("orbit.json", "--interval", "A=0.015"), "NAME=VALUE:RADIUS"),
        (("orbit.json", "--interval", "A=0.015:-1"), "radius above 0"),
        (("orbit.json", "--radius", "2"), "(0, 1)"),
    ],
)
def test_wrong_usage_is_told_in_one_line(
    table: Orbit,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    told: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    zo.write_orbit(table, tmp_path / "orbit.json")
    answer = ask("prove", *words)
    assert answer.code == MISUSE
    assert told in answer.err
    assert answer.err.count("\n") == 1
