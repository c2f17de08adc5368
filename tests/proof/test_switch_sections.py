"""Proofs from just before a switch: walkers, relay loops, stops that a switch opens."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from flint import acb, arb, ctx

import zeno_orbits as zo
from tests.support import switched
from tests.support.cases import fast
from tests.support.orbits import event_orbit
from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem
from zeno_orbits.proof import Proof, check_proof

Certificate = dict[str, Any]


def _proof(problem: Problem) -> Proof:
    return _proof_of(problem)


def _proof_of(problem: Problem, **parameters: float) -> Proof:
    found = zo.prove(zo.find_orbit(problem, parameters=parameters).unwrap(), problem=problem)
    assert found.proved, found.verdict()
    return found


@pytest.fixture(scope="module")
def wheel() -> Proof:
    return _proof(switched.rimless_wheel())


@pytest.fixture(scope="module")
def block() -> Proof:
    return _proof(switched.pushed_block())


def _meets(interval: Any, truth: Any) -> bool:
    """Return True if a proved interval and a ball have a number in common."""
    low, high = (arb(x.numerator) / arb(x.denominator) for x in (interval.low, interval.high))
    return not bool(truth < low) and not bool(truth > high)


def test_the_wheel_agrees_with_its_energy_and_a_proved_quadrature(wheel: Proof) -> None:
    # Energy: w^2 / 2 + g cos(angle) is kept, and a strike leaves the part k of the rate. Balls of
    # FLINT enclose the rate, and its rigorous quadrature the period. Nothing of ours is used.
    with ctx.workprec(160):
        last, g, k = arb(0.08) + arb(switched.HALF), arb(switched.GRAVITY), arb(switched.LEFT)
        first = last - 2 * arb(switched.HALF)
        fall = 2 * g * (first.cos() - last.cos())
        rate = (fall / (1 - k * k)).sqrt()

        def slowness(angle: acb, analytic: bool) -> acb:
            square = acb((k * rate) ** 2) + 2 * acb(g) * (acb(first).cos() - angle.cos())
            return 1 / square.sqrt(analytic=analytic)

        period = acb.integral(slowness, acb(first), acb(last)).real
        assert bool(period.rad() < 1e-30)
        assert wheel.bounds is not None
        assert _meets(wheel.bounds.period, period)
        assert _meets(wheel.bounds.start_state["rate"], rate)
        assert _meets(wheel.bounds.start_state["angle"], last)
        assert wheel.bounds.period.width < 1e-18
    (disc,) = wheel.bounds.multipliers
    assert abs(disc.centre - switched.LEFT**2) < disc.radius < 1e-9
    assert wheel.inside
    assert wheel.events == ("switch strike",)


@pytest.mark.slow
def test_the_wheels_certificate_is_accepted_and_names_its_section(wheel: Proof) -> None:
    verdict = check_proof(dict(wheel.certificate), switched.rimless_wheel())
    assert verdict.ok, verdict.verdict()
    told = "\n".join(verdict.lines())
    assert "the states just before the switch `strike`" in told
    assert "exactly one periodic orbit passes through box 1" in told
    assert "from the state just before switch `strike`" in "\n".join(wheel.lines())


@pytest.mark.slow
def test_the_relay_loop_has_the_amplitude_period_and_multiplier_of_its_closed_form() -> None:
    problem = switched.relay_loop()
    proof = _proof(problem)
    assert proof.bounds is not None
    # Half a turn about the pushed centre: A = 1 + (A + 1) r with r = exp(-c pi / (2 w)).
    w = math.sqrt(1 - 0.25**2)
    r = math.exp(-0.25 * math.pi / w)
    assert proof.bounds.start_state["place"].misses(-(1 + r) / (1 - r)) < 1e-15
    assert proof.bounds.period.misses(2 * math.pi / w) < 2e-15
    (disc,) = proof.bounds.multipliers
    assert abs(disc.centre - r**2) < 1e-12
    assert check_proof(dict(proof.certificate), problem).ok


@pytest.mark.slow
def test_a_jump_of_a_force_opens_a_stop_that_presses(block: Proof) -> None:
    assert block.bounds is not None
    assert block.events[-1] == "switch kink 1 with release of table"
    # The block flies up with a fifth of its weight while the push is on.
    duration, a = 2 * math.acos(0.9) / 3.0, 0.2 * switched.GRAVITY
    assert block.bounds.start_state["height"].misses(a * duration**2 / 2) < 1e-15
    assert block.bounds.start_state["speed"].misses(a * duration) < 1e-15
    # It falls freely, and its impacts last as long as a geometric series.
    speed, height, g = a * duration, a * duration**2 / 2, switched.GRAVITY
    down = math.sqrt(speed**2 + 2 * g * height)
    zeno = (speed + down) / g + 2 * 0.3 * down / g / (1 - 0.3)
    assert block.bounds.zeno_times[0].misses(zeno) < 1e-14
    assert check_proof(dict(block.certificate), switched.pushed_block()).ok


def _switches(certificate: Certificate) -> list[Any]:
    return [r for one in certificate["passes"] for r in one["records"] if r["kind"] == "switch"]


def _first(certificate: Certificate) -> list[Any]:
    return certificate["passes"][0]["records"]


WHEEL: dict[str, Callable[[Certificate], Any]] = {
    "the guard stays zero after a strike that changes it": lambda c: _switches(c)[0].update(kept=1),
    "a wheel that is held": lambda c: _switches(c)[0].update(mode="locked"),
    "a wheel that is opened": lambda c: _switches(c)[0].update(mode="opened"),
    "no strike": lambda c: _first(c).pop(0),
    "two strikes": lambda c: _first(c).insert(0, copy.deepcopy(_first(c)[0])),
    "no return": lambda c: _first(c).pop(),
    "a return to a stop": lambda c: _first(c)[-1].update(meets=["stop", 0]),
    "a section of releases": lambda c: c["section"].update(
        conditions=["gap", "gap_rate", "multiplier"]
    ),
    "a section on the stop": lambda c: c["section"].update(
        conditions=["gap", "gap_rate", "guard"], places=[]
    ),
    "a section without its switch": lambda c: c["section"].pop("switch"),
    "a section of another switch": lambda c: c["section"].update(switch=1),
    "a section of no switch": lambda c: c["section"].update(switch=-1),
    "a switch that is no number": lambda c: c["section"].update(switch=False),
    "a pinned gap": lambda c: c.update(gap_row=0),
    "a slope that is steeper": lambda c: c["parameters"].update(slope="0x1p-3"),
    "a mode is missing": lambda c: _switches(c)[0].pop("mode"),
}


def _conclusions(certificate: Certificate, problem: Problem) -> list[str]:
    try:
        return check_proof(certificate, problem).conclusions()
    except InputError:
        return []


@pytest.mark.parametrize("name", fast(3, WHEEL))
def test_no_edited_certificate_of_the_wheel_is_accepted(wheel: Proof, name: str) -> None:
    edited = copy.deepcopy(dict(wheel.certificate))
    WHEEL[name](edited)
    assert not _conclusions(edited, switched.rimless_wheel())


BLOCK: dict[str, Callable[[Certificate], Any]] = {
    "the block is held by its table": lambda c: _switches(c)[1].update(mode="locked"),
    "the block is in flight from the start": lambda c: _switches(c)[1].update(mode="free"),
    "a kink that is not zero after it": lambda c: _switches(c)[1].update(kept=0),
    "the start is on the other side": lambda c: c["machine"].update(sides=[1]),
    "the kink keeps its side": lambda c: _switches(c)[0].update(sides=[0]),
    "contact at the start": lambda c: c["section"].update(conditions=["gap", "gap_rate", "guard"]),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BLOCK)
def test_no_edited_certificate_of_the_block_is_accepted(block: Proof, name: str) -> None:
    edited = copy.deepcopy(dict(block.certificate))
    BLOCK[name](edited)
    assert not _conclusions(edited, switched.pushed_block())


def test_a_certificate_of_another_machine_is_refused(wheel: Proof) -> None:
    with pytest.raises(InputError):
        check_proof(dict(wheel.certificate), switched.relay_loop())


def test_a_wheel_whose_strike_is_not_armed_is_not_proved() -> None:
    problem = switched.rimless_wheel()
    orbit = zo.find_orbit(problem).unwrap()
    # Upwards the switch is not armed, so no motion strikes.
    back = {**orbit.start_state, "rate": -orbit.start_state["rate"]}
    events = tuple(replace(e, state={**e.state, "rate": -e.state["rate"]}) for e in orbit.events)
    assert not zo.prove(replace(orbit, start_state=back, events=events), problem=problem).proved


@pytest.mark.slow
def test_a_step_of_the_compass_walker_is_proved_at_the_multipliers_of_its_variations() -> None:
    orbit = event_orbit("compass_walker")
    proof = zo.prove(orbit, radius=1e-9)
    assert proof.proved, proof.verdict()
    assert proof.bounds is not None
    assert proof.bounds.period.misses(orbit.period) < 1e-12
    known = sorted(one.real for one in orbit.floquet_multipliers)
    found = sorted(one.centre.real for one in proof.bounds.multipliers)
    assert found == pytest.approx(known, abs=1e-6)


@pytest.fixture(scope="module")
def lifted() -> Proof:
    return _proof(switched.lifted_block())


@pytest.mark.slow
def test_a_reset_lifts_a_block_from_its_table(lifted: Proof) -> None:
    assert lifted.bounds is not None
    assert lifted.events == ("switch lift with release of table", "Zeno point of table")
    fall = math.sqrt(2 * 0.5 / switched.GRAVITY)
    assert lifted.bounds.impact_times[0].misses(fall) < 1e-15
    assert lifted.bounds.zeno_times[0].misses(fall * (1 + 2 * 0.3 / 0.7)) < 1e-15
    assert lifted.bounds.period.misses(2 * math.pi / 3.0) < 1e-15
    assert check_proof(dict(lifted.certificate), switched.lifted_block()).ok


LIFTED: dict[str, Callable[[Certificate], Any]] = {
    "the block stays on its table": lambda c: _switches(c)[0].update(mode="locked"),
    "the table pulls no more": lambda c: _switches(c)[0].update(mode="opened"),
    "it is put below its table": lambda c: c["parameters"].update(lift="-0x1p-1"),
    "it is put on its table": lambda c: c["parameters"].update(lift="0x0p0"),
    "the coordinate is the gap": lambda c: c.update(gap_row=0),
    "the switch is not armed": lambda c: c["passes"][0]["box"]["others"].update(
        centre=[
            x[1:] if x.startswith("-") else f"-{x}"
            for x in c["passes"][0]["box"]["others"]["centre"]
        ]
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LIFTED)
def test_no_edited_certificate_of_the_lifted_block_is_accepted(lifted: Proof, name: str) -> None:
    edited = copy.deepcopy(dict(lifted.certificate))
    LIFTED[name](edited)
    assert not _conclusions(edited, switched.lifted_block())


@pytest.mark.slow
def test_a_block_that_is_put_below_its_table_is_named() -> None:
    problem = switched.lifted_block()
    orbit = zo.find_orbit(problem).unwrap()
    below = replace(orbit, parameters={**orbit.parameters, "lift": -0.5})
    proof = zo.prove(below, problem=problem)
    assert (proof.proved, proof.claim) == (False, "switch")
    assert "gap is not proved positive just after a switch" in proof.reason


@pytest.mark.slow
def test_a_reset_throws_a_block_up_from_its_table() -> None:
    problem = switched.thrown_block()
    orbit = zo.find_orbit(problem).unwrap()
    proof = zo.prove(orbit, problem=problem)
    assert proof.proved, proof.verdict()
    assert proof.bounds is not None
    assert proof.events == ("switch throw with release of table", "Zeno point of table")
    flight = 2 * 4.0 / switched.GRAVITY
    assert proof.bounds.impact_times[0].misses(flight) < 1e-15
    assert proof.bounds.zeno_times[0].misses(flight / (1 - 0.3)) < 1e-15
    certificate = dict(proof.certificate)
    assert check_proof(certificate, problem).ok
    for mode in ("free", "locked", "opened"):
        edited = copy.deepcopy(certificate)
        _switches(edited)[0]["mode"] = mode
        assert not _conclusions(edited, problem)
    for speed in ("0x0p0", "-0x1p2"):
        edited = copy.deepcopy(certificate)
        edited["parameters"]["throw"] = speed
        assert not _conclusions(edited, problem)
    down = replace(orbit, parameters={**orbit.parameters, "throw": -4.0})
    refused = zo.prove(down, problem=problem)
    assert (refused.proved, refused.claim) == (False, "switch")
    assert "struck just after a switch" in refused.reason


@pytest.mark.slow
def test_two_stops_that_open_at_the_same_time_are_refused_with_their_names() -> None:
    problem = switched.two_blocks()
    proof = zo.prove(zo.find_orbit(problem).unwrap(), problem=problem)
    assert (proof.proved, proof.claim) == (False, "shape")
    assert "open at the same time" in proof.reason
    assert "`left`" in proof.reason
    assert "`right`" in proof.reason


@pytest.mark.slow
def test_the_wheel_is_proved_over_slopes_that_move_its_section() -> None:
    problem = switched.rimless_wheel()
    proof = zo.prove(zo.find_orbit(problem).unwrap(), problem=problem, interval={"slope": 1e-9})
    assert proof.proved, proof.verdict()
    assert proof.bounds is not None
    rates = proof.bounds.start_state["rate"]
    for change in (-1e-9, 1e-9):
        last = 0.08 + change + switched.HALF
        fall = 2 * switched.GRAVITY * (math.cos(last - 2 * switched.HALF) - math.cos(last))
        assert rates.misses(math.sqrt(fall / (1 - switched.LEFT**2))) < 1e-15
    assert rates.width < 1e-7
    assert check_proof(dict(proof.certificate), problem).ok


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rests", "place", "radius", "reason"),
    [
        (False, 1, "0x3p-1", "a gap may be closed before the switch"),
        (False, 0, "0x3p-2", "switch 1 may be zero"),
        (True, 0, "0x5p-2", "the stop may not be under pressure before the switch"),
    ],
)
def test_states_that_are_not_just_before_the_switch_are_refused(
    rests: bool, place: int, radius: str, reason: str
) -> None:
    # The switch sends every place and height to a state over the table, under pressure, and right
    # of the kink. So the period and the return from these boxes are sound, but they hold states
    # inside the table, left of the kink, or pulled by it.
    problem = switched.returned_block(rests=rests)
    proof = _proof(problem)
    assert check_proof(dict(proof.certificate), problem).ok
    false = copy.deepcopy(dict(proof.certificate))
    false["passes"][0]["box"]["radius"][place] = radius
    false["passes"] = false["passes"][:1]
    false["claims"] = [{"name": "exists", "pass": 0, "by": "inclusion"}]
    told = check_proof(false, problem).verdict()
    assert told.startswith(f"Not proved: `motion 0`: section: {reason}")


@pytest.mark.slow
def test_a_box_that_reaches_into_a_stop_before_the_switch_is_not_proved() -> None:
    problem = switched.returned_block(rests=False)
    orbit = zo.find_orbit(problem).unwrap()
    assert zo.prove(orbit, problem=problem, radius=0.5).proved
    found = zo.prove(orbit, problem=problem, radius=1.5)
    assert found.verdict().startswith("Not proved: `section`: a gap is not proved positive just")


@pytest.mark.slow
def test_a_plastic_stop_that_is_left_with_a_speed_has_no_zeno_point() -> None:
    # Lemma 10 holds for e = 0 as well, but its single impact is no Zeno point.
    problem = switched.thrown_block()
    proof = _proof_of(problem, restitution=0.0)
    assert proof.events == ("switch throw with release of table", "plastic impact on table")
    certificate = dict(proof.certificate)
    told = check_proof(certificate, problem).verdict()
    assert told.startswith("Proved: a periodic orbit with plastic impacts")
    false = copy.deepcopy(certificate)
    for one in false["passes"]:
        records = one["records"]
        k = next(j for j, record in enumerate(records) if record["kind"] == "impact")
        n = len(records[k]["set"]["m"]) - 2
        tail = {"kind": "tail", "set": records[k]["set"], "radius": ["0x1p+0"] * n}
        records[1 : k + 1] = [tail | {"speed": "0x5p+0"}]
    with pytest.raises(InputError, match="record 1 must be"):
        check_proof(false, problem)
