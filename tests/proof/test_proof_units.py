"""The same machine in other units is proved just the same, and its certificate holds."""

from __future__ import annotations

from functools import cache

import pytest

import zeno_orbits as zo
from tests.support.cases import often
from tests.support.units import Units, in_units
from zeno_orbits.proof import Proof, check_proof

GRAMS = Units(mass=1e3, length=1e3, time=1e3)
"""Gram, millimetre, millisecond."""
FAR = (Units(length=1e6, time=1e-6), Units(length=1e-6, time=1e6))


def name_of(units: Units) -> str:
    return f"{units.mass:g}-{units.length:g}-{units.time:g}"


@cache
def _proved(name: str, units: Units) -> tuple[Proof, zo.Problem]:
    problem = in_units(zo.load_problem(name), units)
    proof = zo.prove(zo.find_orbit(problem).unwrap(), problem=problem)
    assert proof.proved, proof.verdict()
    return proof, problem


def _require_same(name: str, units: Units) -> None:
    """Check that the theorem is the same, its period turned back into seconds."""
    (found, problem), (usual, _) = _proved(name, units), _proved(name, Units())
    assert (found.stable, found.inside) == (usual.stable, usual.inside)
    assert found.bounds is not None
    assert usual.bounds is not None
    # The numbers of the problem are rounded once more by the change of units.
    period = float(found.bounds.period.low) / units.time
    assert period == pytest.approx(float(usual.bounds.period.low), rel=1e-12)
    # Steps, and so the records, are not the same ones where powers of two round otherwise.
    assert found.bounds.period.width < 20 * units.time * usual.bounds.period.width
    assert check_proof(dict(found.certificate), problem).ok


@pytest.mark.slow
def test_a_machine_in_other_units_is_proved_and_its_certificate_holds() -> None:
    _require_same("motor_valve", GRAMS)


@pytest.mark.slow
@pytest.mark.parametrize("units", [FAR[0]], ids=name_of)
@pytest.mark.parametrize(
    "name", ["vibrating_table", "motor_valve", "forced_oscillator", "two_tone_table"]
)
def test_a_machine_in_far_units_is_proved_and_its_certificate_holds(
    name: str, units: Units
) -> None:
    _require_same(name, units)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "units"),
    often(2, [("torque_pendulum", FAR[0]), ("curved_surface", GRAMS), ("motor_pendulum", GRAMS)]),
    ids=["torque_pendulum", "curved_surface", "motor_pendulum"],
)
def test_a_proof_does_not_depend_on_the_units(name: str, units: Units) -> None:
    proof, _ = _proved(name, units)
    assert proof.bounds is not None
    assert proof.bounds.period.width < 1e-15 * float(proof.bounds.period.low)
