"""Curves of folds and flips in two parameters, on maps whose curves are known by hand."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest

from tests.continuation.test_branches import Formula
from zeno_orbits.continuation import (
    ContinuationSettings,
    CurveSteps,
    Family,
    SecondParameter,
    SpecialCurve,
    SpecialPointKind,
    family_of_orbit,
    start_orbit,
)
from zeno_orbits.continuation.corrector import FamilyMetric, first_point
from zeno_orbits.continuation.families import whole_curve
from zeno_orbits.continuation.return_maps import DifferentiatedReturn
from zeno_orbits.continuation.special_points.special_points import INSIDE, located_near
from zeno_orbits.continuation.two_parameters.boundary import half_boundary
from zeno_orbits.continuation.two_parameters.plane import CurveSetup, CurveStart, ParameterPlane
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import load_problem
from zeno_orbits.orbits import Line, Margin, MarginKind, Orbit, Section
from zeno_orbits.work import silent


@dataclass(frozen=True, kw_only=True)
class InTwo(Formula):
    """A return map ``P(y, p)`` of two parameters, along a line of them."""

    along: Line
    loose: float = 0.0
    off: float = 0.0
    watched: bool = False

    @property
    def line(self) -> Line:
        return self.along

    def follow(self, x: np.ndarray, s: float, *, horizon: float) -> DifferentiatedReturn:
        del horizon
        p = self.along.at(s) + np.array([self.off, 0.0])
        if p[1] < self.least:
            raise SimulationError("Nothing returns", time=0.0, state=())
        end, by_state, by_p = (value.full() for value in self.function(x, p))
        left = {Margin(loss=MarginKind.LATER_IMPACT): float(p[1] - self.least)}
        return DifferentiatedReturn(
            time=1.0,
            end=end.ravel(),
            by_state=by_state,
            by_parameter=by_p @ self.along.direction,
            margins=left if self.watched else {},
        )

    def moved_to(self, line: Line) -> InTwo:
        return replace(self, along=line)

    def loosened(self) -> InTwo:
        return replace(self, off=self.loose)


LINE = Line(origin=np.array([0.0, 0.75]), direction=np.array([1.0, 0.0]))
BOX = ((-1.0, 1.0), (-1.0, 1.0))


def in_two(make: Callable[[ca.SX, ca.SX], ca.SX], size: int) -> ca.Function:
    y, p = ca.SX.sym("y", size), ca.SX.sym("p", 2)
    image = make(y, p)
    return ca.Function("P", [y, p], [image, ca.jacobian(image, y), ca.jacobian(image, p)])


def curve_of(
    function: ca.Function,
    kind: SpecialPointKind,
    y: list[float],
    p: tuple[float, float],
    box: tuple[tuple[float, float], tuple[float, float]],
    steps: CurveSteps | None = None,
    returns: InTwo | None = None,
) -> SpecialCurve:
    """Return the curve of a special point near a state and parameters; found along the first."""
    line = Line(origin=np.array([0.0, p[1]]), direction=np.array([1.0, 0.0]))
    returns = (returns or InTwo(function=function, along=line)).moved_to(line)
    metric = FamilyMetric(scale=np.ones(len(y)), unit=box[0][1] - box[0][0], horizon=1.0)
    start = first_point(returns, metric, np.array(y), p[0], rising=True)
    found = located_near(returns, metric, start, kind, INSIDE[kind])
    setup = CurveSetup(
        plane=ParameterPlane(names=("a", "b"), places=(0, 1), box=np.array(box), p=np.zeros(2)),
        returns=returns,
        metric=metric,
        steps=steps or CurveSteps(),
        on_progress=silent,
    )
    here = CurveStart(found=found, value=(found.z[-1] * metric.unit, p[1]))
    first = half_boundary(setup, here, upwards=True)
    second = None if first.closes else half_boundary(setup, here, upwards=False)
    return whole_curve(kind, setup.plane.names, first, second)


CUSP = in_two(lambda y, p: y + p[0] + p[1] * y - y**3, 1)


def test_two_folds_that_meet_in_a_cusp_are_one_curve_that_is_passed_and_named() -> None:
    # p1 = 2 y^3, p2 = 3 y^2 in closed form.
    fold = 2 * (0.75 / 3) ** 1.5
    curve = curve_of(CUSP, SpecialPointKind.FOLD, [-0.55], (fold - 0.01, 0.75), BOX)
    x, y = np.array(curve.x), np.array(curve.y)
    assert np.max(np.abs(4 * y**3 - 27 * x**2)) < 1e-10
    assert curve.ends == (SpecialPointKind.BOUND.value, SpecialPointKind.BOUND.value)
    assert sorted((x[0], x[-1])) == pytest.approx([-2 / 27**0.5, 2 / 27**0.5], abs=1e-10)
    assert (y[0], y[-1]) == pytest.approx((1.0, 1.0), abs=1e-12)
    (cusp,) = curve.cusps
    assert (x[cusp], y[cusp]) == pytest.approx((0.0, 0.0), abs=1e-10)
    assert curve.as_json()["cusps"] == [cusp]


@pytest.mark.slow
def test_every_fold_on_the_curve_is_found_wherever_it_starts() -> None:
    fold = 2 * (0.75 / 3) ** 1.5
    one = curve_of(CUSP, SpecialPointKind.FOLD, [-0.55], (fold - 0.01, 0.75), BOX)
    other = curve_of(CUSP, SpecialPointKind.FOLD, [0.55], (0.01 - fold, 0.75), BOX)
    assert (one.x[0], one.y[0]) == pytest.approx((-other.x[0], other.y[0]), abs=1e-10)
    assert len(one.cusps) == len(other.cusps) == 1


@pytest.mark.slow
def test_charts_that_turn_with_every_question_change_nothing() -> None:
    # A section's tangents are any basis: an eigenvalue solver gives one today, another tomorrow.
    @dataclass(frozen=True, kw_only=True)
    class Turning(InTwo):
        dice: np.random.Generator

        def frame(self, x: np.ndarray, s: float, scale: np.ndarray) -> Section:
            del s
            angle = self.dice.uniform(0.0, 6.0)
            tangent = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            return replace(super().frame(x, 0.0, scale), tangent=tangent)

    # The cusp again, with a second multiplier of 1 + p1 - 3: far from the circle.
    image = in_two(
        lambda y, p: ca.vertcat(y[0] + p[0] + p[1] * y[0] - y[0] ** 3, (p[0] - 2) * y[1] + y[0]), 2
    )
    fold = 2 * (0.75 / 3) ** 1.5
    plain = curve_of(image, SpecialPointKind.FOLD, [-0.55, -0.2], (fold - 0.01, 0.75), BOX)
    turning = Turning(function=image, along=LINE, dice=np.random.default_rng(4))
    turned = curve_of(
        image, SpecialPointKind.FOLD, [-0.55, -0.2], (fold - 0.01, 0.75), BOX, returns=turning
    )
    for curve in (plain, turned):
        x, y = np.array(curve.x), np.array(curve.y)
        assert np.max(np.abs(4 * y**3 - 27 * x**2)) < 1e-10
        assert curve.ends == (SpecialPointKind.BOUND.value, SpecialPointKind.BOUND.value)
        assert len(curve.cusps) == 1


def test_a_curve_of_flips_turns_back_in_both_parameters_and_closes() -> None:
    # y* = 0 always; its multiplier is -1 on the circle p1^2 + p2^2 = 1/4.
    image = in_two(lambda y, p: -(1 + (ca.sumsqr(p) - 0.25)) * y + y**3, 1)
    curve = curve_of(image, SpecialPointKind.FLIP, [0.0], (0.35, 0.3), BOX)
    x, y = np.array(curve.x), np.array(curve.y)
    assert np.max(np.abs(x**2 + y**2 - 0.25)) < 1e-10
    assert curve.ends == (SpecialPointKind.CLOSED.value, SpecialPointKind.CLOSED.value)
    assert (x[0], y[0]) == (x[-1], y[-1])
    # All round: the polygon has nearly the area of the circle.
    area = abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) / 2
    assert area == pytest.approx(np.pi / 4, rel=0.01)
    assert curve.cusps == ()


def test_a_curve_that_is_cut_short_says_why() -> None:
    fold = 2 * (0.75 / 3) ** 1.5
    start = (fold - 0.01, 0.75)
    few = curve_of(CUSP, SpecialPointKind.FOLD, [-0.55], start, BOX, CurveSteps(most_arcs=3))
    assert few.ends == ("3 steps", "3 steps")
    assert len(few.x) == 7
    lost = InTwo(function=CUSP, along=LINE, least=0.5)
    curve = curve_of(CUSP, SpecialPointKind.FOLD, [-0.55], start, BOX, returns=lost)
    assert curve.ends.count(SpecialPointKind.BOUND.value) == 1
    (other,) = (end for end in curve.ends if end != SpecialPointKind.BOUND.value)
    assert other.startswith("gave up: Nothing returns")
    # It is followed up to where its neighbours return no more.
    assert min(curve.y) == pytest.approx(0.5, abs=1e-3)


def test_a_curve_that_ends_where_something_else_is_lost_says_what() -> None:
    fold = 2 * (0.75 / 3) ** 1.5
    lost = InTwo(function=CUSP, along=LINE, least=0.5, watched=True)
    curve = curve_of(CUSP, SpecialPointKind.FOLD, [-0.55], (fold - 0.01, 0.75), BOX, returns=lost)
    (other,) = (end for end in curve.ends if end != SpecialPointKind.BOUND.value)
    assert other.startswith("meets: later impact grazes, within ")
    distance = float(other.split()[-4])
    # It is told how far the point is, in ranges, to some digits of one.
    assert 0.3 * distance < (min(curve.y) - 0.5) / 2 < 3 * distance < 1e-4


@pytest.mark.slow
def test_two_folds_that_meet_in_a_hairpin_are_one_curve() -> None:
    # With u = y / 0.01 the curve turns round within 2e-5 of the ranges.
    sharp = in_two(lambda y, p: y + p[0] + p[1] * (100 * y) - (100 * y) ** 3, 1)
    fold = 2 * (0.75 / 3) ** 1.5
    curve = curve_of(sharp, SpecialPointKind.FOLD, [-0.00508], (fold - 1e-4, 0.75), BOX)
    x, y = np.array(curve.x), np.array(curve.y)
    assert np.max(np.abs(4 * y**3 - 27 * x**2)) < 1e-10
    assert curve.ends == (SpecialPointKind.BOUND.value, SpecialPointKind.BOUND.value)
    (cusp,) = curve.cusps
    assert (x[cusp], y[cusp]) == pytest.approx((0.0, 0.0), abs=1e-8)
    blunt = CurveSteps(least_arc=1e-3)
    short = curve_of(sharp, SpecialPointKind.FOLD, [-0.00508], (fold - 1e-4, 0.75), BOX, blunt)
    assert sum(end.startswith("gave up") for end in short.ends) == 1


def test_a_curve_that_is_followed_by_secants_turns_round_a_sharp_tip() -> None:
    # The multipliers are a pair with the product 1 + p1 - 100 p0^2; the tip's radius is 5e-3.
    image = in_two(
        lambda y, p: (
            ca.sqrt(1 + p[1] - 100 * p[0] ** 2)
            * ca.vertcat(0.6 * y[0] - 0.8 * y[1], 0.8 * y[0] + 0.6 * y[1])
        ),
        2,
    )
    box = ((-0.2, 0.2), (-0.5, 1.0))
    curve = curve_of(image, SpecialPointKind.TORUS, [0.0, 0.0], (0.0695, 0.5), box)
    x, y = np.array(curve.x), np.array(curve.y)
    assert y == pytest.approx(100 * x**2, abs=1e-9)
    assert curve.ends == (SpecialPointKind.BOUND.value, SpecialPointKind.BOUND.value)
    assert sorted((x[0], x[-1])) == pytest.approx([-0.1, 0.1], abs=1e-9)
    assert min(y) < 0.02


def test_curves_that_begin_in_any_direction_are_found_from_their_first_point() -> None:
    for slope in (0.3, -0.9, 1.1, -8.0):
        image = in_two(
            lambda y, p, k=slope: (
                ca.sqrt(1 + p[1] - k * p[0])
                * ca.vertcat(0.6 * y[0] - 0.8 * y[1], 0.8 * y[0] + 0.6 * y[1])
            ),
            2,
        )
        curve = curve_of(
            image, SpecialPointKind.TORUS, [0.0, 0.0], (0.05 / slope - 0.001, 0.05), BOX
        )
        x, y = np.array(curve.x), np.array(curve.y)
        assert y == pytest.approx(slope * x, abs=1e-9)
        assert curve.ends == (SpecialPointKind.BOUND.value, SpecialPointKind.BOUND.value)


def test_a_less_accurate_return_is_seen_in_the_error() -> None:
    rough = InTwo(function=CUSP, along=LINE, loose=1e-6)
    fold = 2 * (0.75 / 3) ** 1.5
    curve = curve_of(CUSP, SpecialPointKind.FOLD, [-0.55], (fold - 0.01, 0.75), BOX, returns=rough)
    # Off by 1e-6 in p1, half a range's unit; less across the curve, by its slope.
    errors = np.array(curve.errors)
    assert np.all(errors < 1e-6)
    assert np.all(errors > 1e-7)


@pytest.mark.weekly
@pytest.mark.slow
def test_the_folds_and_flips_of_the_pendulum_pass_their_cusp_and_end_where_a_family_has_them() -> (
    None
):
    problem, box = load_problem("motor_pendulum"), (-1.7, -1.3)

    def orbit(kp: float) -> Orbit:
        return start_orbit(problem, problem.values(gains={"Kp": kp, "Kd": -1.5}))

    def family(kp: float) -> Family:
        settings = ContinuationSettings(doublings=0)
        return family_of_orbit(problem, orbit(kp), "Kd", box, settings=settings).families[0]

    kinds = (SpecialPointKind.FOLD, SpecialPointKind.FLIP)
    second = SecondParameter(name="Kp", box=(3.7, 4.4), kinds=kinds)
    settings = ContinuationSettings(doublings=0)
    found = family_of_orbit(problem, orbit(4.3), "Kd", box, second=second, settings=settings)
    assert {end for curve in found.boundaries for end in curve.ends} == {
        SpecialPointKind.BOUND.value
    }
    assert [
        len(curve.cusps) for curve in found.boundaries if curve.kind is SpecialPointKind.FOLD
    ] == [1, 0]
    assert max(error for curve in found.boundaries for error in curve.errors) < 1e-9
    for kp in (3.7, 4.4):
        special = family(kp).special
        for kind in kinds:
            ends = [
                curve.x[k]
                for curve in found.boundaries
                if curve.kind is kind
                for k in (0, -1)
                if abs(curve.y[k] - kp) < 1e-9
            ]
            values = [one.at.value for one in special if one.kind is kind]
            assert sorted(ends) == pytest.approx(sorted(values), abs=1e-8)


@pytest.mark.weekly
@pytest.mark.slow
def test_the_second_cusp_of_the_pendulum_is_where_two_folds_of_its_families_merge() -> None:
    # Its place is that of the curve; the families know of one parameter alone.
    problem, cusp = load_problem("motor_pendulum"), 10.966659556

    def folds(kp: float) -> list[float]:
        orbit = start_orbit(problem, problem.values(gains={"Kp": kp, "Kd": -1.12}))
        settings = ContinuationSettings(doublings=0)
        found = family_of_orbit(problem, orbit, "Kd", (-1.15, -1.11), settings=settings)
        special = found.families[0].special
        return [one.at.value for one in special if one.kind is SpecialPointKind.FOLD]

    far, near = folds(cusp - 0.02), folds(cusp - 0.002)
    assert (len(far), len(near), len(folds(cusp + 0.002))) == (2, 2, 0)
    # Two folds part with the power 3/2 of the distance from their cusp.
    assert abs(far[0] - far[1]) / abs(near[0] - near[1]) == pytest.approx(10**1.5, rel=0.1)


@pytest.mark.weekly
@pytest.mark.slow
def test_the_grazing_of_the_pendulum_keeps_to_its_family_and_meets_an_earlier_release() -> None:
    # Below Kp = 2.45 another family runs into an end beside this one, 1e-4 off in Kd.
    problem = load_problem("motor_pendulum")
    settings = ContinuationSettings(doublings=0)

    def orbit(kp: float) -> Orbit:
        return start_orbit(problem, problem.values(gains={"Kp": kp, "Kd": -1.0}))

    second = SecondParameter(name="Kp", box=(2.3, 4.5), kinds=(SpecialPointKind.GRAZING,))
    box = (-2.5, 0.0)
    found = family_of_orbit(problem, orbit(2.5), "Kd", box, second=second, settings=settings)
    (curve,) = found.boundaries
    low, high = np.argmin(curve.y), np.argmax(curve.y)
    family = family_of_orbit(problem, orbit(2.3), "Kd", (-2.5, 0.0), settings=settings).families[0]
    ends = [
        end.at.value for end in (family.first, family.last) if end.kind is SpecialPointKind.GRAZING
    ]
    assert curve.y[low] == pytest.approx(2.3, abs=1e-6)
    assert ends == pytest.approx([curve.x[low]], abs=1e-8)
    assert "meets: earlier release" in str(curve.ends)
    # It ends short of the meeting by at most the stated distance, in parts of the ranges.
    (short,) = re.findall(r"earlier release, within (\S+) of", str(curve.ends))
    assert float(short) <= 7e-3
    assert curve.y[high] == pytest.approx(4.172, abs=7e-3 * (4.5 - 2.3))
