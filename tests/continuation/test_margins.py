"""What an end is called: the cause of what vanishes there, whichever margin led to it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import casadi as ca
import numpy as np
import pytest

from tests.continuation.test_branches import Formula, formula
from zeno_orbits.arrays import Vector
from zeno_orbits.continuation import (
    ContinuationSettings,
    Family,
    FamilySteps,
    SpecialPointKind,
    start_orbit,
)
from zeno_orbits.continuation.assembly import whole_family
from zeno_orbits.continuation.branch import Branch, follow_branch
from zeno_orbits.continuation.corrector import FamilyMetric, first_point
from zeno_orbits.continuation.ends import locate_end
from zeno_orbits.continuation.families import HalfCurve
from zeno_orbits.continuation.jobs import FollowHalfCurve
from zeno_orbits.continuation.margins import Stage, VanishingMargin, causes, consequences, threats
from zeno_orbits.continuation.return_maps import DifferentiatedReturn, ReturnMap
from zeno_orbits.continuation.setup import Setup, start_at_release
from zeno_orbits.continuation.two_parameters.plane import CurveStart, ParameterPlane
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import load_problem
from zeno_orbits.orbits import Line, Margin, MarginKind, Section, ZenoOrbit
from zeno_orbits.work import from_plain, silent, to_plain

OSCILLATOR = load_problem("forced_oscillator")
DEFAULT, SHORT = FamilySteps(), FamilySteps(first=0.003, longest=0.01)
LONG = FamilySteps(first=0.1, longest=0.3)


@cache
def orbit_at(**numbers: float) -> ZenoOrbit:
    return start_orbit(OSCILLATOR, OSCILLATOR.values(parameters=numbers))


def downwards(
    box: tuple[float, float], steps: FamilySteps, **numbers: float
) -> tuple[Setup, Branch, Family]:
    """Return the oscillator's family from A = 1 down to its end in the force."""
    begin = start_at_release(OSCILLATOR, orbit_at(**numbers), "A", box, ContinuationSettings())
    setup, returns = begin.setup, begin.setup.returns(OSCILLATOR)
    start = first_point(returns, setup.metric, begin.x, 1.0, rising=False)
    branch = follow_branch(returns, setup.metric, start, box, steps, on_progress=silent)
    nothing = Branch(points=(), special=(), ending=SpecialPointKind.CLOSED)
    return setup, branch, whole_family(OSCILLATOR, setup, branch, nothing).family


def family_in_the_force(box: tuple[float, float], steps: FamilySteps, **numbers: float) -> Family:
    return downwards(box, steps, **numbers)[2]


@pytest.mark.parametrize(
    ("box", "steps"),
    [
        pytest.param((0.7, 1.5), DEFAULT, marks=pytest.mark.slow),
        pytest.param((0.5, 1.5), SHORT, marks=pytest.mark.slow),
        ((0.5, 1.5), LONG),
        pytest.param((0.79, 1.01), DEFAULT, marks=pytest.mark.slow),
        ((0.79, 1.01), LONG),
    ],
)
def test_the_end_of_a_flight_has_one_name_for_every_range_and_step(
    box: tuple[float, float], steps: FamilySteps
) -> None:
    # With A = 0.8 + eps^2 the stop lets go for a time of order eps, and the acceleration at the
    # next contact is of order eps^2: in arclength it is the nearer one to vanish.
    first = family_in_the_force(box, steps, restitution=0.0).first
    assert (first.kind, first.detail) == (SpecialPointKind.RELEASE_LOST, "")
    assert abs(first.at.value - 0.8) < 10 * first.error < 1e-9


@pytest.mark.slow
def test_so_it_has_with_impacts_that_accumulate() -> None:
    first = family_in_the_force((0.7, 1.5), DEFAULT, restitution=0.5).first
    assert (first.kind, first.detail) == (SpecialPointKind.RELEASE_LOST, "")
    assert abs(first.at.value - 0.8) < 10 * first.error < 1e-9


@pytest.mark.parametrize(
    ("restitution", "top", "steps"),
    [
        (0.0, 1.5, DEFAULT),
        pytest.param(0.0, 1.1, SHORT, marks=pytest.mark.slow),
        (0.3, 1.5, LONG),
        (0.3, 3.0, DEFAULT),
    ],
)
def test_a_motion_in_proportion_to_its_force_ends_with_its_amplitude(
    restitution: float, top: float, steps: FamilySteps
) -> None:
    # With the stop where the spring is relaxed, x(t) / A does not depend on A at all.
    family = family_in_the_force((0.0, top), steps, restitution=restitution, stop=0.0)
    assert (family.first.kind, family.first.detail) == (SpecialPointKind.AMPLITUDE_ZERO, "")
    assert abs(family.first.at.value) < 1e-12
    speeds = [point.margins["speed of the first impact"] / point.value for point in family.points]
    assert max(speeds) == pytest.approx(min(speeds), rel=1e-9)
    sizes = [point.margins["amplitude"] / point.value for point in family.points]
    # Looked at a few parts of the arcs, all at the same phases.
    assert max(sizes) == pytest.approx(min(sizes), rel=1e-9)


def way(powers: Mapping[Margin, float], *, left: float = 0.0) -> list[Stage]:
    """Return stages at which margins are powers of what is halved from one to the next."""
    return [
        Stage(
            z=np.array([size]),
            margins={margin: left + 3 * size**power for margin, power in powers.items()},
        )
        for size in 0.01 / 2.0 ** np.arange(5)
    ]


RELEASE, ACCELERATION = Margin(loss=MarginKind.RELEASE_RATE), Margin(loss=MarginKind.ACCELERATION)
FIRST, NEAR = Margin(loss=MarginKind.FIRST_IMPACT), Margin(loss=MarginKind.NEAR_MISS)
AMPLITUDE, LOCK = Margin(loss=MarginKind.AMPLITUDE), Margin(loss=MarginKind.LOCK)


@pytest.mark.parametrize(
    ("powers", "cause"),
    [
        ({RELEASE: 1, ACCELERATION: 2, FIRST: 3}, RELEASE),
        ({RELEASE: 1, ACCELERATION: 2, FIRST: 3, AMPLITUDE: 3}, RELEASE),
        ({AMPLITUDE: 1, ACCELERATION: 1, FIRST: 1, RELEASE: 1}, AMPLITUDE),
        ({LOCK: 1, ACCELERATION: 1}, LOCK),
        ({ACCELERATION: 1}, ACCELERATION),
    ],
)
def test_the_cause_is_the_same_whichever_margin_is_followed(
    powers: Mapping[Margin, float], cause: Margin
) -> None:
    for gone in powers:
        assert causes(way(powers), gone) == (cause,)


def test_what_is_left_where_another_vanishes_is_no_cause() -> None:
    kept = way({RELEASE: 1}, left=0.1)
    lost = way({ACCELERATION: 1})
    both = [
        Stage(z=one.z, margins={**one.margins, **other.margins})
        for one, other in zip(kept, lost, strict=True)
    ]
    assert causes(both, ACCELERATION) == (ACCELERATION,)


def test_two_losses_that_have_nothing_to_do_with_each_other_have_one_order() -> None:
    both = way({NEAR: 1, FIRST: 1})
    assert causes(both, NEAR) == causes(both, FIRST) == (FIRST, NEAR)


def test_a_release_takes_the_flight_of_the_next_return_with_it_and_of_no_other() -> None:
    last = replace(RELEASE, place=1)
    assert consequences(RELEASE, 2).keys() >= {replace(FIRST, place=1)}
    assert consequences(last, 2).keys() >= {FIRST}
    own = {replace(FIRST, place=1): 3, last: 1}
    assert causes(way(own), last) == (replace(FIRST, place=1), last)
    assert causes(way({FIRST: 3, last: 1}), FIRST) == (last,)


@pytest.mark.parametrize(("restitution", "threatened"), [(0.0, True), (0.3, False)])
def test_the_acceleration_threatens_by_itself_at_plastic_impacts_alone(
    restitution: float, *, threatened: bool
) -> None:
    found = threats(way({ACCELERATION: 1}), lambda _: restitution)
    assert bool(found) is threatened


def ended(margins: Mapping[Margin, float], restitution: float = 0.0) -> Branch:
    """Return a family that ends at s = 0.25, as an impact that grazes has it."""

    def image(y: ca.SX, s: ca.SX) -> ca.SX:
        return y + (ca.sqrt(s - 0.25) + s - 0.25 - y) / 2

    returns = Formula(
        function=formula(image, 1),
        margins={
            margin: lambda x, _, factor=factor: factor * (np.sqrt(1 + 4 * float(x[0])) - 1) / 2
            for margin, factor in margins.items()
        },
        least=0.25,
        e=restitution,
    )
    metric = FamilyMetric(scale=np.ones(1), unit=1.0, horizon=1.0)
    start = first_point(returns, metric, np.array([0.75]), 0.5, rising=False)
    return follow_branch(returns, metric, start, (0.0, 1.0), FamilySteps(), on_progress=silent)


def test_an_end_at_which_two_things_happen_says_both() -> None:
    for order in ((FIRST, NEAR), (NEAR, FIRST)):
        branch = ended(dict(zip(order, (1.0, 3.0), strict=True)))
        assert branch.ending is SpecialPointKind.GRAZING
        assert branch.end is not None
        assert branch.end.also == (SpecialPointKind.EARLIER_GRAZING,)
        again = from_plain(Branch, json.loads(json.dumps(to_plain(branch))))
        assert again.end is not None
        assert again.end.also == branch.end.also


@cache
def plastic() -> tuple[Setup, Branch]:
    """Return the oscillator's family with plastic impacts, down to its end in the force."""
    return downwards((0.7, 1.5), LONG, restitution=0.0)[:2]


def test_both_are_in_the_family() -> None:
    setup, branch = plastic()
    assert branch.end is not None
    end = replace(branch.end, also=(SpecialPointKind.LOCK_VANISHES, SpecialPointKind.GRAZING))
    family = whole_family(OSCILLATOR, setup, branch, replace(branch, end=end)).family
    assert family.first.detail == ""
    assert family.last.detail == "together with: locked arc vanishes, first impact grazes"


def test_an_acceleration_that_seems_to_vanish_alone_ends_plastic_impacts_only() -> None:
    assert ended({ACCELERATION: 1.0}).ending is SpecialPointKind.THEOREM_LOST
    assert ended({ACCELERATION: 1.0}, restitution=0.3).ending is SpecialPointKind.GAVE_UP


def test_an_acceleration_is_not_approached_where_impacts_accumulate() -> None:
    setup, branch = plastic()
    points, returns = branch.points[-8:-6], setup.returns(OSCILLATOR)
    assert branch.end is not None
    alone = VanishingMargin(margin=ACCELERATION, distance=1.0, fall=1.0)
    # Without its cause among the margins it would be an end of its own.
    blind = Blind(returns=returns, kept=(ACCELERATION,))
    found = locate_end(blind, setup.metric, points, alone)
    assert found.kind is SpecialPointKind.THEOREM_LOST
    with pytest.raises(SimulationError, match="without a known cause"):
        locate_end(replace(blind, e=0.3), setup.metric, points, alone)
    # With it, the end has its name, and is better known than by what follows from it.
    caused = locate_end(returns, setup.metric, points, alone)
    assert caused.kind is SpecialPointKind.RELEASE_LOST
    assert caused.error < found.error


@dataclass(frozen=True, kw_only=True)
class Blind:
    """A return map with some margins only."""

    returns: ReturnMap
    kept: tuple[Margin, ...]
    e: float = 0.0

    @property
    def line(self) -> Line:
        return self.returns.line

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        found = self.returns.follow(x, s, horizon=horizon)
        return replace(found, margins={key: found.margins[key] for key in self.kept})

    def frame(self, x: Vector, s: float, scale: Vector) -> Section:
        return self.returns.frame(x, s, scale)

    def projected(self, x: Vector, s: float, scale: Vector) -> Vector:
        return self.returns.projected(x, s, scale)

    def restitution(self, s: float, place: int = 0) -> float:
        del s, place
        return self.e

    def loosened(self) -> Blind:
        return replace(self, returns=self.returns.loosened())

    def moved_to(self, line: Line) -> Blind:
        return replace(self, returns=self.returns.moved_to(line))


@pytest.mark.slow
def test_a_curve_of_ends_is_not_followed_along_ends_of_another_name() -> None:
    setup, branch = plastic()
    assert branch.end is not None
    names = OSCILLATOR.names
    plane = ParameterPlane(
        names=("A", "stop"),
        places=(names.index("A"), names.index("stop")),
        box=np.array([(0.7, 1.5), (-0.82, -0.78)]),
        p=np.array(setup.values.vector),
    )

    def curve(kind: SpecialPointKind) -> HalfCurve:
        assert branch.end is not None
        start = CurveStart(
            found=replace(branch.end, kind=kind),
            value=(0.8, -0.8),
            leading=branch.points[-8:-6],
        )
        half = FollowHalfCurve(setup=setup, plane=plane, start=start, upwards=True)
        return half.run(OSCILLATOR, ContinuationSettings(), silent)

    right, wrong = curve(SpecialPointKind.RELEASE_LOST), curve(SpecialPointKind.THEOREM_LOST)
    assert right.end == SpecialPointKind.BOUND.value
    assert np.array(right.x) + np.array(right.y) == pytest.approx(np.zeros(len(right.x)), abs=1e-8)
    assert wrong.end.startswith(SpecialPointKind.GAVE_UP.value)
    assert len(wrong.x) == 1
