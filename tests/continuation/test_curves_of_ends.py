"""Curves of ends in two parameters, on machines with one stop and with several, in closed form."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.one_mass import Motion, one_mass
from zeno_orbits.continuation import (
    ContinuationSettings,
    SecondParameter,
    SpecialPointKind,
    family_of_orbit,
)
from zeno_orbits.search import settled_event_orbit

Kind = SpecialPointKind


@dataclass(frozen=True, kw_only=True)
class Case:
    """A machine with a curve of ends.

    Attributes:
        force: The force on the mass.
        stops: Its stops.
        values: Name to value of its parameters.
        box: Range of the first parameter.
        second: Name and range of the second parameter.
        kind: Kind of the ends.
        off: Zero on the curve, from the values of all parameters.
        start: Start of the motion that settles.
    """

    force: Callable[[Motion], ca.SX]
    stops: Callable[[Motion], tuple[zo.Stop, ...]]
    values: Mapping[str, float]
    box: tuple[str, float, float]
    second: tuple[str, float, float]
    kind: Kind
    off: Callable[[Mapping[str, float]], float]
    start: Mapping[str, float]


def _drive(m: Motion) -> ca.SX:
    return -m.x - m.p["c"] * m.v + m.p["A"] * m.cosine


def _wall(m: Motion) -> zo.Stop:
    return zo.Stop(name="wall", gap=m.p["d"] - m.x, restitution=m.p["e"])


def _floor(m: Motion) -> zo.Stop:
    return zo.Stop(name="floor", gap=m.x - m.p["low"], restitution=0.4)


_STRUCK = {"omega": 2.0, "A": 1.0, "c": 0.1, "d": 0.2, "e": 0.7}
_HELD = {"omega": 1.0, "A": 1.0, "c": 1.9, "d": -0.8, "e": 0.5}


def _free_amplitude(p: Mapping[str, float]) -> float:
    return p["A"] / abs(complex(1 - p["omega"] ** 2, p["c"] * p["omega"]))


CASES = {
    # The free oscillation just reaches the wall.
    "grazing, one stop": Case(
        force=_drive,
        stops=lambda m: (_wall(m),),
        values=_STRUCK,
        box=("omega", 1.9, 2.6),
        second=("A", 0.99, 1.01),
        kind=Kind.GRAZING,
        off=lambda p: _free_amplitude(p) - p["d"],
        start={"cosine": 1.0},
    ),
    # The drive just exceeds the spring, which presses the mass onto the wall.
    "release, two stops": Case(
        force=_drive,
        stops=lambda m: (_wall(m), _floor(m)),
        values={**_HELD, "low": -2.0},
        box=("A", 0.7, 1.1),
        second=("d", -0.81, -0.79),
        kind=Kind.RELEASE_LOST,
        off=lambda p: p["A"] + p["d"],
        start={"cosine": 1.0, "x": -0.81},
    ),
    # A limit of the force just acts.
    "kink, one stop": Case(
        force=lambda m: -m.x - m.p["c"] * m.v + ca.fmin(m.p["top"], m.p["A"] * m.cosine),
        stops=lambda m: (_wall(m),),
        values={"omega": 2.6, "A": 1.25, "c": 0.05, "d": 0.0, "e": 0.8, "top": 1.3},
        box=("A", 1.2, 1.5),
        second=("top", 1.28, 1.32),
        kind=Kind.SWITCH_ENTERS,
        off=lambda p: p["A"] - p["top"],
        start={"cosine": 1.0},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_curve_of_ends_has_its_closed_form(name: str) -> None:
    case = CASES[name]
    problem = one_mass(
        case.force,
        stops=case.stops,
        has_clock=True,
        switches=lambda _: (),
        start=case.start,
        **case.values,
    )
    orbit = settled_event_orbit(problem, problem.values())
    parameter, *box = case.box
    other, *range_of_other = case.second
    found = family_of_orbit(
        problem,
        orbit,
        parameter,
        (box[0], box[1]),
        second=SecondParameter(
            name=other, box=(range_of_other[0], range_of_other[1]), kinds=(case.kind,)
        ),
        settings=ContinuationSettings(doublings=0),
    )
    (curve,) = found.boundaries
    assert curve.kind is case.kind
    assert (min(curve.y), max(curve.y)) == pytest.approx(tuple(range_of_other), rel=1e-9)
    offs = [
        case.off({**case.values, parameter: x, other: y})
        for x, y in zip(curve.x, curve.y, strict=True)
    ]
    assert np.max(np.abs(offs)) < 1e-9
    assert set(curve.ends) == {Kind.BOUND.value}
    # The law is of these parameters: at others it is not zero.
    assert abs(case.off({**case.values, parameter: curve.x[0], other: curve.y[-1]})) > 1e-3
    assert math.isfinite(max(curve.errors))
