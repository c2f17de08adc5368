"""Families as values: which of their orbits are said to attract."""

import math

import pytest

from zeno_orbits.continuation import Family, FamilyPoint, SpecialPoint, SpecialPointKind

BELOW_ONE = math.nextafter(1.0, 0.0)
"""A modulus of 1, as rounding may leave it."""


def orbit(multiplier: complex) -> FamilyPoint:
    return FamilyPoint(
        value=1.0, state={}, period=2.0, multipliers=(multiplier,), margins={}, miss=0.0
    )


def named(kind: SpecialPointKind, at: FamilyPoint) -> SpecialPoint:
    return SpecialPoint(kind=kind, at=at, error=0.0, index=0)


@pytest.mark.parametrize(
    ("kind", "multiplier"),
    [
        (SpecialPointKind.FOLD, complex(BELOW_ONE)),
        (SpecialPointKind.FLIP, complex(-BELOW_ONE)),
        (SpecialPointKind.TORUS, 1j * BELOW_ONE),
        (SpecialPointKind.BRANCHING, complex(BELOW_ONE)),
    ],
)
def test_a_multiplier_on_the_unit_circle_is_not_called_stable_however_it_is_rounded(
    kind: SpecialPointKind, multiplier: complex
) -> None:
    at = orbit(multiplier)
    assert at.stable
    assert not named(kind, at).stable
    assert named(kind, at).as_json()["stable"] is False


@pytest.mark.parametrize(("multiplier", "stable"), [(0.5, True), (-1.5, False)])
def test_any_other_end_is_as_stable_as_its_orbit(multiplier: float, *, stable: bool) -> None:
    end = named(SpecialPointKind.GRAZING, orbit(complex(multiplier)))
    assert end.stable is stable
    assert end.as_json()["stable"] is stable


def test_the_table_of_a_family_says_the_same() -> None:
    flip = named(SpecialPointKind.FLIP, orbit(complex(-BELOW_ONE)))
    first = named(SpecialPointKind.BOUND, orbit(complex(0.1)))
    last = named(SpecialPointKind.BOUND, orbit(complex(0.2)))
    family = Family(
        problem="p",
        parameter="Kd",
        gains={},
        parameters={},
        n_returns=1,
        points=(first.at, last.at),
        special=(flip,),
        first=first,
        last=last,
    )
    table = family.to_pandas()
    assert list(zip(table["name"], table["stable"], strict=True)) == [
        ("end of the range", True),
        ("flip", False),
        ("end of the range", True),
    ]
