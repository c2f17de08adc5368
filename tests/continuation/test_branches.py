"""How families are followed, on return maps that are formulas: every answer is known by hand."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
import pytest

from tests.reference.reference_orbit import RELEASE
from zeno_orbits.arrays import Vector
from zeno_orbits.continuation import (
    ContinuationSettings,
    FamilySteps,
    SpecialPointKind,
)
from zeno_orbits.continuation.branch import Branch, follow_branch
from zeno_orbits.continuation.corrector import FamilyMetric, first_point
from zeno_orbits.continuation.return_maps import Composed, DifferentiatedReturn
from zeno_orbits.continuation.setup import start_of_family
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Line, Margin, MarginKind, Orbit, Section
from zeno_orbits.work import from_plain, silent, to_plain


@dataclass(frozen=True, kw_only=True)
class Formula:
    """A return map ``P(y, s)`` on the whole space of ``y``."""

    function: ca.Function
    margins: Mapping[Margin, Callable[[Vector, float], float]] = field(
        default_factory=dict[Margin, Callable[[Vector, float], float]]
    )
    least: float = -np.inf
    e: float = 0.0

    @property
    def line(self) -> Line:
        return Line(origin=np.zeros(1), direction=np.ones(1))

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        del horizon
        if s < self.least:
            raise SimulationError("Nothing returns", time=0.0, state=())
        end, by_state, by_parameter = (value.full() for value in self.function(x, s))
        return DifferentiatedReturn(
            time=1.0,
            end=end.ravel(),
            by_state=by_state,
            by_parameter=by_parameter.ravel(),
            margins={one: value(x, s) for one, value in self.margins.items()},
        )

    def frame(self, x: Vector, s: float, scale: Vector) -> Section:
        del s
        eye = np.eye(x.size)
        return Section(
            rows=(),
            centre=x,
            scale=scale,
            tangent=eye,
            normal=np.zeros((x.size, 0)),
            drift=np.zeros((x.size, 1)),
        )

    def projected(self, x: Vector, s: float, scale: Vector) -> Vector:
        del s, scale
        return x

    def restitution(self, s: float, place: int = 0) -> float:
        del s, place
        return self.e

    def loosened(self) -> Formula:
        return self

    def moved_to(self, line: Line) -> Formula:
        del line
        return self


def formula(make: Callable[[ca.SX, ca.SX], ca.SX], size: int) -> ca.Function:
    y, s = ca.SX.sym("y", size), ca.SX.sym("s")
    image = make(y, s)
    return ca.Function("P", [y, s], [image, ca.jacobian(image, y), ca.jacobian(image, s)])


def followed(
    returns: Formula,
    x: list[float],
    s: float,
    box: tuple[float, float],
    steps: FamilySteps | None = None,
    unit: float = 1.0,
) -> Branch:
    metric = FamilyMetric(scale=np.ones(len(x)), unit=unit, horizon=1.0)
    start = first_point(returns, metric, np.array(x), s, rising=True)
    return follow_branch(returns, metric, start, box, steps or FamilySteps(), on_progress=silent)


def test_a_family_that_is_a_circle_closes_after_both_its_folds() -> None:
    circle = Formula(function=formula(lambda y, s: y + (1 - y**2 - s**2) / 3, 1))
    branch = followed(circle, [1.0], 0.0, (-2.0, 2.0))
    assert branch.ending is SpecialPointKind.CLOSED
    assert [one.kind for _, one in branch.special] == [SpecialPointKind.FOLD, SpecialPointKind.FOLD]
    assert [one.z[-1] for _, one in branch.special] == pytest.approx([1.0, -1.0], abs=1e-9)
    for point in branch.points:
        assert float(point.x @ point.x) + point.s**2 == pytest.approx(1.0, abs=1e-10)


@pytest.mark.parametrize("unit", [1e-16, 1e16])
def test_a_family_is_the_same_in_a_parameter_of_any_unit(unit: float) -> None:
    # y1 = sin s, y2 = cos s in units of s: as a column of 1e16 it would hide those of the states.
    def wave(y: ca.SX, s: ca.SX) -> ca.SX:
        return (y + ca.vertcat(ca.sin(s / unit), ca.cos(s / unit))) / 2

    returns = Formula(function=formula(wave, 2))
    branch = followed(returns, [0.0, 1.0], 0.0, (-unit, unit), unit=2 * unit)
    assert branch.ending is SpecialPointKind.BOUND
    assert branch.points[-1].s == unit
    for point in branch.points:
        s = point.s / unit
        assert point.x == pytest.approx([np.sin(s), np.cos(s)], abs=1e-10)


def test_a_complex_pair_that_leaves_the_circle_is_a_torus_and_two_real_ones_are_none() -> None:
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    spiral = Formula(function=formula(lambda y, s: (1 + s) * ca.mtimes(ca.DM(turn), y), 2))
    branch = followed(spiral, [0.0, 0.0], -0.3, (-0.3, 0.3))
    assert [one.kind for _, one in branch.special] == [SpecialPointKind.TORUS]
    assert branch.special[0][1].z[-1] == pytest.approx(0.0, abs=1e-9)
    saddle = Formula(function=formula(lambda y, s: ca.vertcat((2 + s) * y[0], y[1] / 2), 2))
    branch = followed(saddle, [0.0, 0.0], -0.3, (-0.3, 0.3))
    assert branch.special == ()


def test_families_that_cross_are_passed_straight_and_the_crossing_is_named() -> None:
    crossing = Formula(function=formula(lambda y, s: y + y * (s - y) / 2, 1))
    branch = followed(crossing, [0.0], -0.35, (-0.35, 0.5))
    assert branch.ending is SpecialPointKind.BOUND
    assert [one.kind for _, one in branch.special] == [SpecialPointKind.BRANCHING]
    assert branch.special[0][1].z[-1] == pytest.approx(0.0, abs=1e-7)
    assert max(abs(float(point.x[0])) for point in branch.points) < 1e-9


@pytest.mark.parametrize("apart", [0.05, 0.01])
def test_steps_longer_than_the_distance_to_another_family_do_not_jump(apart: float) -> None:
    # Two arcs that come close at s = 0 and part again: u v = apart^2 with u = y - s, v = y + s.
    arcs = Formula(function=formula(lambda y, s: y + ((y - s) * (y + s) - apart**2) / 4, 1))
    branch = followed(
        arcs, [np.hypot(1.0, apart)], -1.0, (-1.0, 1.0), FamilySteps(first=0.2, longest=0.3)
    )
    assert branch.ending is SpecialPointKind.BOUND
    assert all(float(point.x[0]) >= apart * (1 - 1e-9) for point in branch.points)
    assert branch.points[-1].x[0] == pytest.approx(np.hypot(1.0, apart), abs=1e-9)


def test_an_end_is_extrapolated_in_what_vanishes_there() -> None:
    # A square root at the end, as where an impact grazes: v = sqrt(s - s0), y = v + v^2.
    def margin(x: Vector, s: float) -> float:
        del s
        return (np.sqrt(1 + 4 * float(x[0])) - 1) / 2

    def image(y: ca.SX, s: ca.SX) -> ca.SX:
        return y + (ca.sqrt(s - 0.25) + s - 0.25 - y) / 2

    grazing = Formula(
        function=formula(image, 1),
        margins={Margin(loss=MarginKind.FIRST_IMPACT): margin},
        least=0.25,
    )
    metric = FamilyMetric(scale=np.ones(1), unit=1.0, horizon=1.0)
    start = first_point(grazing, metric, np.array([0.75]), 0.5, rising=False)
    branch = follow_branch(
        grazing,
        metric,
        start,
        (0.0, 1.0),
        FamilySteps(),
        on_progress=silent,
    )
    assert branch.ending is SpecialPointKind.GRAZING
    assert branch.end is not None
    assert branch.end.z[-1] == pytest.approx(0.25, abs=1e-9)
    assert branch.end.z[0] == pytest.approx(0.0, abs=1e-9)
    assert abs(branch.end.z[-1] - 0.25) < 10 * branch.end.error + 1e-12


def test_a_family_that_stops_for_no_known_reason_is_given_up_with_the_trouble() -> None:
    lost = Formula(function=formula(lambda y, s: y / 2 + s, 1), least=0.2)
    metric = FamilyMetric(scale=np.ones(1), unit=1.0, horizon=1.0)
    start = first_point(lost, metric, np.array([1.0]), 0.5, rising=False)
    branch = follow_branch(
        lost,
        metric,
        start,
        (0.0, 1.0),
        FamilySteps(),
        on_progress=silent,
    )
    assert branch.ending is SpecialPointKind.GAVE_UP
    assert "Nothing returns" in branch.detail
    assert branch.points[-1].s == pytest.approx(0.2, abs=1e-5)


FIRST, NEAR = Margin(loss=MarginKind.FIRST_IMPACT), Margin(loss=MarginKind.NEAR_MISS)
ACCELERATION = Margin(loss=MarginKind.ACCELERATION)


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


def test_an_acceleration_that_seems_to_vanish_alone_ends_plastic_impacts_only() -> None:
    assert ended({ACCELERATION: 1.0}).ending is SpecialPointKind.THEOREM_LOST
    assert ended({ACCELERATION: 1.0}, restitution=0.3).ending is SpecialPointKind.GAVE_UP


def test_two_returns_have_the_product_of_the_derivatives(problem: Problem, orbit: Orbit) -> None:
    box, settings = (-1.5, -0.5), ContinuationSettings()
    setup = start_of_family(problem, orbit, "Kd", box, settings).setup
    returns = setup.returns(problem)
    once = first_point(returns, setup.metric, np.array(RELEASE), -1.0, rising=True)
    twice = Composed(maps=(returns, returns))
    point = first_point(twice, setup.metric, np.array(RELEASE), -1.0, rising=True)
    assert point.found.time == pytest.approx(2 * once.found.time, rel=1e-10)
    assert point.multipliers[0].real == pytest.approx(once.multipliers[0].real ** 2, abs=1e-9)
    # The family is the same one, so is its tangent.
    assert np.max(np.abs(point.tangent - once.tangent)) < 1e-7
