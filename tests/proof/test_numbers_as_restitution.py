"""A restitution that is a plain number in the problem file is taken exactly, as a parameter is."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import pytest

import zeno_orbits as zo
from zeno_orbits.errors import InputError
from zeno_orbits.model import CompletedSystem, Problem
from zeno_orbits.proof import check_proof

E = 0.3
"""1 + 0.3 is not a double."""


def _struck(p: Mapping[str, Any], restitution: Any) -> CompletedSystem:
    """Return the shaken mass on a spring, with a restitution."""
    place, speed = ca.SX.sym("place"), ca.SX.sym("speed")
    clock = zo.Clock.at(p["omega"])
    mass = zo.HybridLagrangian.from_energies(
        q=place,
        v=speed,
        kinetic=speed**2 / 2,
        potential=(place + 1) ** 2 / 2,
        passive_force=-0.5 * speed,
        applied_force=3 * clock.cosine,
        clock=clock,
        stops=(zo.Stop(name="wall", gap=place, restitution=restitution),),
    )
    return zo.hybrid_system(mass, zo.no_drive(mass))


def _softer(p: Mapping[str, Any]) -> CompletedSystem:
    return _struck(p, 0.3000001)


def _problem(name: str, **further: Any) -> Problem:
    def model(p: Mapping[str, Any]) -> CompletedSystem:
        return _struck(p, p["restitution"] if further else E)

    return zo.Problem(
        name=name,
        title="shaken mass on a spring with a stop",
        source="written here",
        state_names=("place", "speed", "cosine", "sine"),
        state_units=("m", "m/s", "1", "1"),
        parameters=(zo.Quantity.positive("omega", 0.8, "rad/s", "shaking"), *further.values()),
        gains=(),
        model=model,
        starts=({"place": 0.1, "cosine": 1.0},),
        portraits=(("place", "speed"),),
        amplitude_of="place",
    )


@pytest.mark.slow
def test_a_number_as_restitution_is_proved_with_the_digits_of_a_parameter() -> None:
    named = _problem("named", restitution=zo.Quantity.restitution(E))
    plain = _problem("plain")
    found = zo.prove(zo.find_orbit(plain).unwrap(), problem=plain)
    wanted = zo.prove(zo.find_orbit(named).unwrap(), problem=named)
    assert found.proved, found.verdict()
    assert wanted.proved, wanted.verdict()
    assert found.bounds is not None
    assert wanted.bounds is not None
    for pair in zip(found.bounds.zeno_times, wanted.bounds.zeno_times, strict=True):
        assert max(one.low for one in pair) <= min(one.high for one in pair)
        assert max(one.width for one in pair) < 1e-15
    certificate = dict(found.certificate)
    assert check_proof(certificate, plain).ok, check_proof(certificate, plain).verdict()
    other = replace(plain, model=_softer)
    with pytest.raises(InputError, match="other formulas"):
        check_proof(copy.deepcopy(certificate), other)
