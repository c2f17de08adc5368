"""Orbits are proved, their certificates checked, and what is no orbit is not proved."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

import zeno_orbits as zo
from zeno_orbits.orbits import ZenoOrbit
from zeno_orbits.proof import check_proof


@pytest.fixture(scope="module")
def table() -> ZenoOrbit:
    return zo.find_orbit("vibrating_table").unwrap()


def test_the_orbit_of_the_vibrating_table_is_proved_and_its_certificate_holds(
    table: ZenoOrbit,
) -> None:
    proof = zo.prove(table)
    assert proof.proved, proof.verdict()
    assert proof.bounds is not None
    # The period is that of the table; its frequency is the double 30.
    assert proof.bounds.period.holds(2 * math.pi / 30) or proof.bounds.period.width < 1e-16
    assert abs(float(proof.bounds.period.low) - 2 * math.pi / 30) < 1e-15
    assert check_proof(dict(proof.certificate)).ok


@pytest.mark.parametrize(
    ("change", "claim"),
    [
        ({"period": 2 * math.pi / 15}, "period"),
        ({"problem_digest": (1.0, 2.0)}, "problem"),
    ],
)
def test_what_is_no_orbit_is_not_proved(
    table: ZenoOrbit, change: dict[str, object], claim: str
) -> None:
    proof = zo.prove(replace(table, **change))
    assert not proof.proved
    assert proof.claim == claim
    assert f"`{claim}`" in proof.verdict()
