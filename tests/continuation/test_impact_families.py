"""Families of orbits without a Zeno point, against the closed form of the impact oscillator."""

from __future__ import annotations

import math
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from tests.reference.closed_forms import FadingBall
from tests.reference.linear_impacts import ImpactOscillator, critical, grazing_stop
from zeno_orbits.continuation import (
    Continuation,
    ContinuationSettings,
    Family,
    FamilySteps,
    SpecialPointKind,
    family_of_impacts,
    family_of_orbit,
)
from zeno_orbits.continuation.continuation import continue_from
from zeno_orbits.continuation.corrector import FamilyMetric, first_point
from zeno_orbits.continuation.parallel import Dispatch
from zeno_orbits.continuation.separatrix import separatrix
from zeno_orbits.continuation.setup import FamilyStart, Setup
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import load_problem
from zeno_orbits.orbits import EventSection, SectionMode
from zeno_orbits.search import orbit_at_gains
from zeno_orbits.simulation import SimulationSettings
from zeno_orbits.work import silent

OSCILLATOR = load_problem("forced_oscillator")
COCO = {"c": 0.1, "stop": 1.0, "restitution": 0.8}
PHASE, VELOCITY = 0.07595216493831239, -1.3565863500759056
"""Of the orbit at A = 1, as COCO prints them."""
STATE = (0.0, -VELOCITY, math.cos(PHASE), math.sin(PHASE))


BOX = (0.05, 1.5)
SETUP = Setup(
    values=OSCILLATOR.values(parameters=COCO),
    parameter="A",
    box=BOX,
    section=EventSection(
        name="impact stop",
        n_returns=1,
        sequence=("impact stop",),
        mode=SectionMode(closed=(), sides=(), stop="stop"),
        openings=(),
    ),
    metric=FamilyMetric(scale=np.array([2.0, 1.4, 1.0, 1.0]), unit=BOX[1] - BOX[0], horizon=25.0),
    simulation=SimulationSettings(),
)


def followed(settings: ContinuationSettings) -> Continuation:
    start = FamilyStart(setup=SETUP, x=np.array(STATE), s=1.0)
    return continue_from(start, Dispatch(problem=OSCILLATOR, settings=settings, on_progress=silent))


@cache
def family_in_amplitude() -> Continuation:
    return followed(ContinuationSettings())


def test_the_published_orbit_closes_with_the_published_multipliers() -> None:
    returns = SETUP.returns(OSCILLATOR)
    point = first_point(returns, SETUP.metric, np.array(STATE), 1.0, rising=True)
    assert np.max(np.abs(point.x - STATE)) < 1e-12
    assert point.found.time == pytest.approx(2 * math.pi, abs=1e-11)
    assert point.multipliers[0].real == pytest.approx(-0.58429531434153, abs=1e-12)
    assert abs(point.multipliers[0].imag) == pytest.approx(0.00560035149247, abs=1e-11)
    product = point.multipliers[0] * point.multipliers[1]
    assert product.real == pytest.approx(0.8**2 * math.exp(-0.1 * 2 * math.pi), rel=1e-12)


@pytest.mark.slow
def test_the_family_in_the_amplitude_ends_by_grazing_at_one_tenth() -> None:
    (family,) = family_in_amplitude().families
    end = next(end for end in (family.first, family.last) if end.kind is not SpecialPointKind.BOUND)
    assert end.kind is SpecialPointKind.GRAZING
    # At resonance the free oscillation A / c just reaches the stop.
    assert end.at.value == pytest.approx(0.1, abs=1e-9)
    assert abs(end.at.value - 0.1) < 10 * end.error < 1e-8
    assert end.at.state["speed"] == pytest.approx(0.0, abs=1e-8)


@pytest.mark.slow
def test_no_multiplier_is_stated_for_a_grazing_end_since_the_largest_has_no_limit() -> None:
    (family,) = family_in_amplitude().families
    (end,) = [one for one in (family.first, family.last) if one.kind is SpecialPointKind.GRAZING]
    assert end.at.multiplier_error == math.inf
    assert not end.stable
    assert end.as_json()["multiplier_error"] is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parameter", "box", "amplitude"), [("stop", (-0.2, 0.4), 1.0), ("omega", (0.7, 1.1), 0.5)]
)
def test_multipliers_and_margins_at_an_end_are_limits(
    parameter: str, box: tuple[float, float], amplitude: float
) -> None:
    given = {"c": 0.1, "stop": 0.3, "restitution": 0.6, "A": amplitude}
    start = OSCILLATOR.state_vector({"speed": 1.0, "cosine": 1.0})
    values = OSCILLATOR.values(parameters=given)
    once = ContinuationSettings(doublings=0)
    (family,) = family_of_impacts(OSCILLATOR, values, start, parameter, box, settings=once).families
    end = family.first
    assert end.kind is SpecialPointKind.EARLIER_GRAZING
    at = {"omega": 1.0, **given, parameter: end.at.value}
    truth = ImpactOscillator(
        amplitude=amplitude, omega=at["omega"], damping=0.1, stop=at["stop"], restitution=0.6
    )
    state = end.at.state
    phase, velocity = math.atan2(state["sine"], state["cosine"]), -state["speed"]
    values_there = np.linalg.eigvals(truth.monodromy(phase / truth.omega, velocity))
    missed = np.abs(np.sort_complex(values_there) - np.sort_complex(end.at.multipliers))
    assert np.max(missed) < end.at.multiplier_error < 1e-7
    before = truth.at_impact(phase / truth.omega, velocity)[1]
    assert end.at.margins["speed of the first impact"] == pytest.approx(before, rel=1e-10)
    # The last point of the family is not the end.
    near = np.linalg.norm(np.sort_complex(family.points[0].multipliers) - values_there)
    assert near > 10 * end.at.multiplier_error


@pytest.mark.slow
def test_its_fold_is_where_the_closed_form_has_a_multiplier_of_one() -> None:
    (family,) = family_in_amplitude().families
    (fold,) = [special for special in family.special if special.kind is SpecialPointKind.FOLD]

    def make(amplitude: float) -> ImpactOscillator:
        return ImpactOscillator(
            amplitude=amplitude, omega=1.0, damping=0.1, stop=1.0, restitution=0.8
        )

    phase = math.atan2(fold.at.state["sine"], fold.at.state["cosine"])
    guess = (phase, -fold.at.state["speed"], fold.at.value)
    assert fold.at.value == pytest.approx(critical(make, 1.0, guess), abs=1e-11)
    assert fold.error < 1e-10
    assert fold.at.multipliers[0] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.slow
def test_longer_steps_find_the_same_points() -> None:
    settings = ContinuationSettings(steps=FamilySteps(first=0.1, longest=0.2))
    (family,) = followed(settings).families
    (usual,) = family_in_amplitude().families
    assert len(family.points) < len(usual.points)
    assert [s.kind for s in family.named] == [s.kind for s in usual.named]
    for one, other in zip(family.named, usual.named, strict=True):
        assert one.at.value == pytest.approx(other.at.value, abs=1e-9)


@pytest.mark.slow
def test_a_flip_throws_off_the_branch_of_twice_the_period() -> None:
    values = OSCILLATOR.values(parameters={**COCO, "stop": 0.0, "omega": 2.5})
    found = family_of_impacts(
        OSCILLATOR,
        values,
        OSCILLATOR.state_vector({"speed": 1.0, "cosine": 1.0}),
        "omega",
        (2.3, 2.75),
    )
    single, double = found.families
    (flip,) = single.special

    def make(omega: float) -> ImpactOscillator:
        return ImpactOscillator(amplitude=1.0, omega=omega, damping=0.1, stop=0.0, restitution=0.8)

    start = math.atan2(flip.at.state["sine"], flip.at.state["cosine"]) / flip.at.value
    guess = (start, -flip.at.state["speed"], flip.at.value)
    assert flip.kind is SpecialPointKind.FLIP
    assert flip.at.value == pytest.approx(critical(make, -1.0, guess), abs=1e-10)
    assert double.n_returns == 2
    assert double.first.kind is SpecialPointKind.FLIP
    assert double.first.at.value == flip.at.value
    # Two turns of the force, and a true period of two: the halves differ.
    later = double.points[-1]
    assert later.period == pytest.approx(4 * math.pi / later.value, rel=1e-9)
    speeds = [v for name, v in later.margins.items() if name.startswith("speed of")]
    assert abs(speeds[0] - speeds[1]) > 0.05
    # Stability passes from one to the other (supercritical), and the branch flips again.
    assert [point.stable for point in single.points] == [
        point.value < flip.at.value for point in single.points
    ]
    assert double.points[1].stable
    assert [s.kind for s in double.special] == [SpecialPointKind.FLIP]


@pytest.mark.slow
def test_numbers_of_steps_and_giving_up_are_named_results() -> None:
    few = ContinuationSettings(steps=FamilySteps(most=3))
    (family,) = followed(few).families
    assert {family.first.kind, family.last.kind} == {SpecialPointKind.MOST_STEPS}
    hasty = ContinuationSettings(steps=FamilySteps(first=0.9, longest=0.9, shortest=0.5))
    (family,) = followed(hasty).families
    assert SpecialPointKind.GAVE_UP in (family.first.kind, family.last.kind)
    assert family.first.detail or family.last.detail


def test_a_motion_that_rests_on_the_stop_has_no_family_of_impacts() -> None:
    values = OSCILLATOR.values(parameters={"A": 0.5})
    with pytest.raises((SimulationError, InputError)):
        family_of_impacts(
            OSCILLATOR,
            values,
            OSCILLATOR.state_vector({"speed": 1.0, "cosine": 1.0}),
            "A",
            (0.4, 0.6),
        )


ONCE = ContinuationSettings(doublings=0)


def impacts_of(stop: float, box: tuple[float, float]) -> Family:
    values = OSCILLATOR.values(parameters={"stop": stop})
    start = OSCILLATOR.state_vector({"cosine": 1.0})
    return family_of_impacts(OSCILLATOR, values, start, "stop", box, settings=ONCE).families[0]


@pytest.mark.slow
def test_orbits_with_n_impacts_follow_each_other_between_grazing_orbits() -> None:
    e, stops = 0.5, (0.28, 0.18, 0.14, 0.119)
    highest = (0.32, 0.3, 0.2, 0.15)
    families = [impacts_of(at, (0.1003, high)) for at, high in zip(stops, highest, strict=True)]
    ends = [family.first for family in families]
    assert [family.n_returns for family in families] == [1, 2, 3, 4]
    for n, (family, end) in enumerate(zip(families, ends, strict=True), 1):
        assert end.kind is SpecialPointKind.EARLIER_GRAZING
        truth = grazing_stop(n, 1.9, e, stops[n - 1])
        assert end.at.value == pytest.approx(truth, abs=10 * end.error + 1e-11)
        # The reference answers another question at another restitution.
        assert abs(end.at.value - grazing_stop(n, 1.9, e + 1e-3, stops[n - 1])) > 1e-5
        assert end.detail == ("" if n == 1 else f"impact 1 of {n}")
        if n > 1:
            last = family.last
            assert (last.kind, last.detail) == (
                SpecialPointKind.LATER_GRAZING,
                f"impact {n} of {n}",
            )
            # Both are the grazing orbit between n - 1 and n impacts.
            assert last.at.value == pytest.approx(ends[n - 2].at.value, abs=1e-10)
    widths = [a.at.value - b.at.value for a, b in pairwise(ends)]
    ratios = [a / b for a, b in pairwise(widths)]
    # The ratios fall towards that of theory (5.7). The last one is still 7 % above it.
    assert ratios[0] > ratios[1] > separatrix(e).repulsion
    assert ratios[1] == pytest.approx(separatrix(e).repulsion, rel=0.1)


@pytest.mark.slow
def test_an_orbit_with_two_impacts_from_the_search_is_followed() -> None:
    orbit = orbit_at_gains(OSCILLATOR, OSCILLATOR.values(parameters={"stop": 0.2})).unwrap()
    assert orbit.shape.text == "impact*2"
    few = ContinuationSettings(steps=FamilySteps(most=2), doublings=0)
    (family,) = family_of_orbit(OSCILLATOR, orbit, "stop", (0.1, 0.3), settings=few).families
    assert family.n_returns == 2
    near = min(family.points, key=lambda point: abs(point.value - 0.2))
    assert near.period == pytest.approx(2 * math.pi, abs=1e-10)
    assert near.stable


def test_a_motion_with_a_zeno_point_is_named_instead_of_a_family_of_impacts() -> None:
    with pytest.raises(SimulationError, match="it has `zeno stop, release stop`"):
        impacts_of(0.05, (0.0, 0.3))


def critical_speed(ball: FadingBall) -> float:
    """Return the speed above which the impacts of a ball do not accumulate, by bisection."""
    low, high = 0.0, 0.375 * ball.g**2 / ball.b
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if ball.zeno_time(middle) < math.inf else (low, middle)
    return low


@pytest.mark.parametrize("restitution", [0.05, 0.2, 0.417, 0.8])
def test_the_ratio_parts_balls_that_stay_from_balls_that_are_let_go(restitution: float) -> None:
    ball = FadingBall(g=2.0, b=0.7, restitution=restitution)
    # The closed form follows some 30 impacts; each doubles a rounding error at most twice.
    wanted = separatrix(restitution).ratio * ball.g**2 / ball.b
    assert critical_speed(ball) == pytest.approx(wanted, rel=1e-11)


@pytest.mark.parametrize("restitution", [0.2, 0.417, 0.8])
def test_what_is_left_of_the_lock_falls_with_the_exponent(restitution: float) -> None:
    law = separatrix(restitution)
    ball = FadingBall(g=1.0, b=1.0, restitution=restitution)
    distance = 1e-5

    def left(part: float) -> float:
        return 1.0 - ball.zeno_time(law.ratio * (1 - part))

    # By one factor of the repulsion nearer, the sequence has exactly one impact more: no log wave.
    # The next order of the law is the distance itself.
    fall = left(distance / law.repulsion) / left(distance)
    assert fall == pytest.approx(law.shrinking, rel=30 * distance)
    assert law.repulsion**-law.exponent == pytest.approx(law.shrinking, rel=1e-12)


def test_the_exponent_is_three_fifths_where_flights_are_averaged() -> None:
    # Theory (2.8): w a^(-1/3) + const a^(5/3) is kept, so a distance grows as a^(-5/3).
    assert separatrix(0.9999).exponent == pytest.approx(0.6, abs=1e-6)
    assert separatrix(0.9999).ratio == pytest.approx(0.3 * 1e-4, rel=1e-3)
