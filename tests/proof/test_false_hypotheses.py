"""Certificates of problems that break one hypothesis of the theorem. None is accepted."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import pytest

import zeno_orbits as zo
from tests.support import hard_to_prove, sheets
from tests.support.cases import fast, often
from tests.support.certificates import (
    digest_of,
    text_of,
)
from tests.support.orbits import shot_orbit
from zeno_orbits.errors import InputError
from zeno_orbits.model import CompletedSystem, ImpactLaw, Problem, load_problem
from zeno_orbits.proof import check_proof

Certificate = dict[str, Any]
Change = Callable[[CompletedSystem], CompletedSystem]
LITTLE, NOTHING = 2.0**-40, 2.0**-250
"""A factor that moves an orbit, and one that moves no number of a certificate by its unit."""


def _of(certificate: Certificate, change: Change, **data: Any) -> tuple[Certificate, Problem]:
    """Return a certificate that names the digest of a problem with other formulas, and that."""
    known = load_problem(certificate["problem"])
    other = replace(known, model=lambda p: change(known.model(p)))
    return {**certificate, **data, "digest": digest_of(other)}, other


def _refusal(certificate: Certificate, problem: Problem | None = None) -> str:
    """Return why a certificate is refused."""
    try:
        verdict = check_proof(certificate, problem)
    except InputError as error:
        return str(error)
    assert not verdict.ok
    assert verdict.conclusions() == []
    return verdict.verdict()


def _with_state(rate: Any, drop: Any) -> Callable[[CompletedSystem], tuple[CompletedSystem, Any]]:
    """Return what adds a state y of a rate, which an impact changes by a part of the gap rate."""

    def extend(system: CompletedSystem) -> tuple[CompletedSystem, Any]:
        y = ca.SX.sym("y")
        extended = replace(
            system,
            state=ca.vertcat(system.state, y),
            free_flow=ca.vertcat(system.free_flow, rate),
            locked_flow=ca.vertcat(system.locked_flow, rate),
            impulse_direction=ca.vertcat(system.impulse_direction, drop),
        )
        return extended, y

    return extend


STRUCK = _with_state(0, 1)
"""A state that rests, but for impacts."""


def _gap_of_a_struck_state(system: CompletedSystem) -> CompletedSystem:
    extended, y = STRUCK(system)
    return replace(extended, gap=extended.gap + LITTLE * y)


def _gap_of_the_speed(system: CompletedSystem) -> CompletedSystem:
    return replace(system, gap=system.gap + LITTLE * system.state[1])


def _rate_bent_by_a_struck_state(system: CompletedSystem) -> CompletedSystem:
    extended, y = STRUCK(system)
    flow = extended.free_flow
    return replace(extended, free_flow=ca.vertcat(flow[0] + LITTLE * y**2, flow[1:]))


def _rate_bent_by_the_speed(system: CompletedSystem) -> CompletedSystem:
    flow, v = system.free_flow, system.state[1]
    return replace(system, free_flow=ca.vertcat(flow[0] + LITTLE * v**3, flow[1:]))


def _restitution_of_a_struck_state(system: CompletedSystem) -> CompletedSystem:
    extended, y = STRUCK(system)
    return replace(extended, law=ImpactLaw(extended.restitution * (1 + LITTLE * y)))


def _constraint_of_a_struck_state(system: CompletedSystem) -> CompletedSystem:
    extended, y = STRUCK(system)
    return replace(extended, holonomic=ca.vertcat(extended.holonomic, y))


def _constraint_of_a_product(system: CompletedSystem) -> CompletedSystem:
    # The row grows as itself: it is kept, but its rate is no other row.
    extended, y = _with_state(0, 0)(system)
    flow = ca.vertcat(extended.free_flow[:-1], LITTLE * y * extended.state[1])
    return replace(extended, free_flow=flow, holonomic=ca.vertcat(extended.holonomic, y))


def _impact_that_pushes_nothing(system: CompletedSystem) -> CompletedSystem:
    return replace(system, impulse_direction=0 * system.impulse_direction)


def _impact_across_the_stop(system: CompletedSystem) -> CompletedSystem:
    return replace(system, impulse_direction=ca.vertcat(LITTLE, system.impulse_direction[1:]))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (_gap_of_a_struck_state, "impacts change the gap"),
        (_gap_of_the_speed, "impacts change the gap"),
        (_rate_bent_by_a_struck_state, "gap rate in another way"),
        (_rate_bent_by_the_speed, "gap rate in another way"),
        (_restitution_of_a_struck_state, "restitution is not constant"),
        (_constraint_of_a_struck_state, "constraint 1 is not kept at an impact"),
        (_constraint_of_a_product, "constraint 1 is not shown to be kept"),
        (_impact_that_pushes_nothing, "gap rate in another way"),
        (_impact_across_the_stop, "impacts change the gap"),
    ],
)
def test_impacts_that_are_none_of_the_theorem_are_refused(
    zeno: Certificate, change: Change, told: str
) -> None:
    assert told in _refusal(*_of(zeno, change, gap_row=None))


def _pushed(force: Callable[[Any, Any], Any]) -> Change:
    """Return what adds a force of cosine and sine of the clock, too small to be seen."""

    def change(system: CompletedSystem) -> CompletedSystem:
        flow, (cosine, sine) = system.free_flow, ca.vertsplit(system.state[2:])
        pushed = flow[1] + NOTHING * force(cosine, sine)
        return replace(system, free_flow=ca.vertcat(flow[0], pushed, flow[2:]))

    return change


ANALYTIC: dict[str, Callable[[Any, Any], Any]] = {
    "an angle about a point off the circle": lambda c, s: ca.atan2(s, c + 2),
    "an arc sine": lambda c, _: ca.asin(c / 2),
    "an arc cosine": lambda c, _: ca.acos(c / 2),
    "an area sine": lambda c, _: ca.asinh(c),
    "an area cosine": lambda c, _: ca.acosh(c + 3),
    "an area tangent": lambda c, _: ca.atanh(c / 2),
    "a hyperbolic cosine": lambda c, _: ca.cosh(c) + ca.sinh(c) + ca.tanh(c),
    "a logarithm": lambda c, _: ca.log(c + 2) + ca.log1p(c / 2) + ca.expm1(c),
    "a root": lambda c, s: ca.sqrt(c + 2) + ca.hypot(c + 3, s),
    "a common factor": lambda c, s: ca.exp(c) * s / (ca.exp(c) * (3 + s)),
}
ROUGH: dict[str, Callable[[Any, Any], Any]] = {
    "the angle of the clock, with a jump": lambda c, s: ca.atan2(s, c),
    "an arc sine beyond one": lambda c, _: ca.asin(2 * c),
    "an arc sine up to one": lambda c, _: ca.asin(c),
    "an arc cosine up to one": lambda c, _: ca.acos(c),
    "an area cosine below one": lambda c, _: ca.acosh(c),
    "an area cosine below minus one": lambda c, _: ca.acosh(c - 3),
    "an area tangent up to one": lambda c, _: ca.atanh(c),
    "an area tangent beyond one": lambda c, _: ca.atanh(2 * c),
    "a logarithm of both signs": lambda c, _: ca.log(c),
    "a logarithm from minus two": lambda c, _: ca.log1p(2 * c),
    "a root of both signs": lambda c, _: ca.sqrt(c),
    "a root of a square": lambda c, _: ca.sqrt(c**2),
    "a distance from the origin": lambda c, _: ca.hypot(c, 0 * c),
    "a tangent with poles": lambda c, _: ca.tan(2 * c),
    "a pole": lambda c, _: 1 / c,
    "a logarithm of both signs over infinity": lambda c, _: ca.log(c) / float("inf"),
    "a root of both signs over infinity": lambda c, _: ca.sqrt(c) / float("inf"),
    "a size over infinity": lambda _, s: ca.fabs(s) / float("inf"),
    "a common factor that vanishes": lambda c, s: ca.sin(c) * s / (ca.sin(c) * (3 + s)),
    "a common factor with a pole": lambda c, s: (1 / c) * s / ((1 / c) * (3 + s)),
}


@pytest.mark.parametrize("name", fast(2, ANALYTIC))
def test_a_force_that_is_analytic_and_below_every_unit_changes_no_certificate(
    impact: Certificate, name: str
) -> None:
    verdict = check_proof(*_of(impact, _pushed(ANALYTIC[name])))
    assert verdict.ok, verdict.claims


@pytest.mark.parametrize("name", fast(4, ROUGH))
def test_the_same_force_with_a_jump_a_kink_or_a_pole_on_the_way_is_refused(
    impact: Certificate, name: str
) -> None:
    assert _refusal(*_of(impact, _pushed(ROUGH[name])))


# Sections just after an impact.


def _without(c: Certificate, place: int) -> None:
    del c["passes"][0]["records"][place]


def _plastic(c: Certificate) -> None:
    c["parameters"]["restitution"] = text_of(0)


def _towards_the_stop(c: Certificate) -> None:
    start = c["passes"][0]["start"]
    speed = start["m"][1]
    start["m"][1] = c["passes"][0]["box"]["centre"][0] = f"-{speed}"


def _from_the_air(c: Certificate) -> None:
    c["passes"][0]["start"]["m"][0] = text_of(1e-20)


def _at_rest_on_the_stop(c: Certificate) -> None:
    c["section"] = {"conditions": ["gap", "gap_rate"], "places": [3]}


def _a_release_that_is_an_impact(c: Certificate) -> None:
    c["section"]["conditions"] = ["gap", "multiplier"]


AFTER_IMPACT: dict[str, Callable[[Certificate], None]] = {
    "a plastic impact leads to no flight": _plastic,
    "a start towards the stop": _towards_the_stop,
    "a start off the stop": _from_the_air,
    "a section of rest": _at_rest_on_the_stop,
    "a section of two kinds": _a_release_that_is_an_impact,
    "no impact at the end": lambda c: _without(c, -1),
    "no flight before the impact": lambda c: _without(c, -2),
    "no first step": lambda c: _without(c, 0),
    "an impact more": lambda c: c["passes"][0]["records"].append(c["passes"][0]["records"][-1]),
}


@pytest.mark.parametrize("name", AFTER_IMPACT)
def test_a_section_that_is_none_of_states_just_after_an_impact_is_refused(
    impact: Certificate, name: str
) -> None:
    false = copy.deepcopy(impact)
    AFTER_IMPACT[name](false)
    assert _refusal(false)


def test_a_section_just_after_an_impact_gives_its_theorem(impact: Certificate) -> None:
    verdict = check_proof(impact)
    assert verdict.ok
    assert "periodic orbit without a Zeno point" in verdict.verdict()
    assert "the states just after an impact, where the gap vanishes" in "\n".join(verdict.lines())
    theorem = verdict.theorem
    assert (theorem.releases, theorem.zeno_points, theorem.impacts) == (0, 0, 1)


# Machines whose stop pulls.


def _negated(text: str) -> str:
    return text[1:] if text.startswith("-") else f"-{text}"


def _force_of_the_stop(p: dict[str, float]) -> float:
    """Return the contact force at rest on the stop at time 0: minus spring, minus shaking."""
    return 0.8 * p["k"] * p["A"] / abs(p["m"]) + p["A"]


PULLED = ("m", "c", "k", "A")
NEGATIVE = {name: (one.rest[0], PULLED) for name, one in sheets.MACHINES.items()}


@pytest.mark.slow
@pytest.mark.parametrize("name", often(4, NEGATIVE))
def test_a_machine_whose_stop_pulls_is_refused_by_prover_and_checker(name: str) -> None:
    # The motion is the same if mass, damping, stiffness and force change their signs together.
    rest, names = NEGATIVE[name]
    problem = sheets.problem_of(name, rest)
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    proof = zo.prove(orbit, problem=problem)
    assert proof.proved
    assert check_proof(dict(proof.certificate), problem).ok
    negative = {
        one: -orbit.parameters[one] if one in names else x for one, x in orbit.parameters.items()
    }
    assert _force_of_the_stop(dict(orbit.parameters)) > 0 > _force_of_the_stop(negative)
    pulled = replace(orbit, parameters=negative)
    refused = zo.prove(pulled, problem=problem)
    assert (refused.proved, refused.claim) == (False, "inertia")
    assert "mass matrix" in refused.reason
    assert refused.statements() == []
    assert not zo.enclose_period(pulled, problem=problem).enclosed
    false = copy.deepcopy(dict(proof.certificate))
    for one in names:
        false["parameters"][one] = _negated(false["parameters"][one])
    assert "mass matrix may not be positive definite" in _refusal(false, problem)


SIGNS = {"the struck mass": (-1, 1), "both": (-1, -1), "the free mass": (1, -1)}


@pytest.fixture(scope="module")
def pair() -> tuple[zo.Orbit, Problem, Certificate]:
    """Return an orbit of two masses and its certificate of one pass."""
    problem = hard_to_prove.two_masses()
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    certificate = dict(zo.prove(orbit, problem=problem, radius=1e-9).certificate)
    assert check_proof(certificate, problem).ok
    return orbit, problem, certificate


@pytest.mark.parametrize("name", fast(0, SIGNS))
def test_two_masses_are_refused_if_one_of_them_is_negative(
    pair: tuple[zo.Orbit, Problem, Certificate], name: str
) -> None:
    orbit, problem, certificate = pair
    signs = dict(zip(("1", "2"), SIGNS[name], strict=True))
    changed = {one: x * signs.get(one[-1], 1) for one, x in orbit.parameters.items()}
    refused = zo.prove(replace(orbit, parameters=changed), problem=problem)
    assert (refused.proved, refused.claim) == (False, "inertia")
    false = copy.deepcopy(certificate)
    for one, text in false["parameters"].items():
        if signs.get(one[-1]) == -1:
            false["parameters"][one] = _negated(text)
    assert "mass matrix may not be positive definite" in _refusal(false, problem)


def _mass(change: Callable[[ca.SX], ca.SX]) -> Change:
    """Return what changes the mass matrix of a system alone."""

    def changed(system: CompletedSystem) -> CompletedSystem:
        mechanism = system.mechanism
        return replace(
            system, mechanism=replace(mechanism, mass_matrix=change(mechanism.mass_matrix))
        )

    return changed


@pytest.mark.slow
@pytest.mark.parametrize("factor", fast(1, [-1, 0, -LITTLE]))
def test_a_hand_made_certificate_needs_a_positive_mass(zeno: Certificate, factor: float) -> None:
    assert "mass matrix" in _refusal(*_of(zeno, _mass(lambda m: factor * m)))


@pytest.mark.slow
def test_a_mass_that_vanishes_on_the_way_is_refused(zeno: Certificate) -> None:
    def thin(system: CompletedSystem) -> CompletedSystem:
        # Positive on the stop and negative far from it, where only flights lead.
        distance = system.state[0]
        return _mass(lambda m: m * (1 - 100 * distance))(system)

    assert "mass matrix" in _refusal(*_of(zeno, thin))
    verdict = check_proof(*_of(zeno, _mass(lambda m: LITTLE * m)))
    assert verdict.ok


SLOWLY = 2.0**-46


def _counting_turns(system: CompletedSystem, share: float) -> CompletedSystem:
    """Return a system whose clock has a state that counts turns, held to the clock's angle."""
    cosine, sine = system.state[2], system.state[3]
    omega = system.free_flow[3] / cosine
    phase = ca.SX.sym("phase")
    row = phase - 1 - share * ca.atan2(sine, cosine)
    return replace(
        system,
        state=ca.vertcat(system.state, phase),
        free_flow=ca.vertcat(system.free_flow, share * omega),
        locked_flow=ca.vertcat(system.locked_flow, share * omega),
        impulse_direction=ca.vertcat(system.impulse_direction, 0),
        holonomic=ca.vertcat(system.holonomic, row),
    )


def _with_a_hole(system: CompletedSystem) -> CompletedSystem:
    """Return a system with the same gap, written as a quotient that vanishes in flight."""
    h = system.gap
    return replace(system, gap=h * (h - 1e-3) * (h - 2e-3) / ((h - 1e-3) * (h - 2e-3)))


def _with_turns(state: Mapping[str, float]) -> dict[str, float]:
    return {**state, "phase": 1 + SLOWLY * math.atan2(state["sine"], state["cosine"])}


@pytest.mark.slow
def test_a_constraint_with_a_branch_in_the_way_proves_no_orbit() -> None:
    # The angle jumps by 2 pi once a turn, and the state does not: it never returns, by 9e-14.
    table = load_problem("vibrating_table")
    turning = replace(
        table,
        name="turning_table",
        state_names=(*table.state_names, "phase"),
        state_units=(*table.state_units, "1"),
        starts=({"cosine": 1.0, "phase": 1.0},),
        model=lambda p: _counting_turns(table.model(p), SLOWLY),
    )
    known = zo.find_orbit_by_shooting(table).unwrap()
    orbit = replace(
        known,
        problem=turning.name,
        start_state=_with_turns(known.start_state),
        events=tuple(replace(one, state=_with_turns(one.state)) for one in known.events),
        problem_digest=(),
    )
    proof = zo.prove(orbit, problem=turning)
    assert not proof.proved
    assert "not proved to be analytic along the motion" in proof.reason


@pytest.mark.slow
def test_a_gap_with_a_hole_in_the_way_is_refused_by_the_checker() -> None:
    orbit = shot_orbit("vibrating_table")
    certificate = dict(zo.prove(orbit).certificate)
    assert check_proof(certificate).ok
    assert "a divisor may be zero" in _refusal(*_of(certificate, _with_a_hole))


def test_a_restitution_of_zero_that_varies_is_refused(zeno: Certificate) -> None:
    # Even without a width: the words of the theorem depend on whether impacts are plastic.
    given = {**zeno["parameters"], "restitution": "0x0p+0"}
    false = {**zeno, "parameters": given, "over": {"restitution": "0x0p+0"}}
    with pytest.raises(InputError, match="restitution must be 0, or between 0 and 1"):
        check_proof(false)
