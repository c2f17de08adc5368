"""The loop that controls steps along a path, on paths that are known by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from zeno_orbits.errors import InputError, SimulationError, WorkError
from zeno_orbits.orbits import PathStep, StepControl, StepError, follow_path, returns_to_start

CONTROL = StepControl(first=0.1, longest=0.4, shortest=0.01, most=100)


def until(
    wall: float, steps: list[float]
) -> Callable[[Sequence[float], float], PathStep[float, str]]:
    """Return a path along the real line that refuses every step beyond a wall."""

    def advance(points: Sequence[float], step: float) -> PathStep[float, str]:
        steps.append(step)
        if points[-1] + step > wall:
            raise StepError("beyond the wall")
        return PathStep(points=(points[-1] + step,), easy=True)

    return advance


def gave_up(points: Sequence[float], trouble: str) -> PathStep[float, str]:
    return PathStep(end=f"{trouble} after {points[-1]:.4g}")


def test_easy_steps_grow_up_to_the_longest_and_refused_ones_shrink_down_to_the_shortest() -> None:
    steps: list[float] = []
    path = follow_path(0.0, CONTROL, until(1.0, steps), give_up=gave_up)
    assert steps[:5] == pytest.approx([0.1, 0.15, 0.225, 0.3375, 0.4])
    assert max(steps) == CONTROL.longest
    assert min(steps) >= CONTROL.shortest
    assert 1.0 - path.points[-1] < 2 * CONTROL.shortest
    assert path.end == f"beyond the wall after {path.points[-1]:.4g}"


def test_a_path_ends_after_its_number_of_points_or_where_a_step_or_what_looks_ahead_says() -> None:
    few = StepControl(first=0.1, shortest=0.01, most=3)
    path = follow_path(0.0, few, until(9.0, []), give_up=gave_up)
    assert (len(path.points), path.end) == (4, None)

    def last(points: Sequence[float], step: float) -> PathStep[float, str]:
        return PathStep(points=(points[-1] + step,), end="arrived")

    assert follow_path(0.0, few, last, give_up=gave_up).end == "arrived"

    def ahead(_points: Sequence[float], step: float) -> PathStep[float, str]:
        return PathStep(points=(1.0,), end="the wall") if step < 0.05 else PathStep()

    path = follow_path(0.0, CONTROL, until(1.0, []), give_up=gave_up, shortened=ahead)
    assert (path.points[-1], path.end) == (1.0, "the wall")


def test_a_step_as_short_as_the_shortest_is_tried_and_each_new_length_is_told() -> None:
    steps: list[float] = []
    told: list[float] = []

    def ahead(_points: Sequence[float], step: float) -> PathStep[float, str]:
        told.append(step)
        return PathStep()

    control = StepControl(first=1.0, shortest=0.25)
    path = follow_path(0.0, control, until(0.0, steps), give_up=gave_up, shortened=ahead)
    assert steps == [1.0, 0.5, 0.25]
    assert told == [0.5, 0.25]
    assert (path.points, path.end) == ((0.0,), "beyond the wall after 0")


def test_a_step_that_is_not_easy_is_followed_by_one_as_long_and_an_easy_one_by_more() -> None:
    def taken(*, easy: bool) -> list[float]:
        steps: list[float] = []

        def advance(points: Sequence[float], step: float) -> PathStep[float, str]:
            steps.append(step)
            ahead = (points[-1] + step, points[-1] + 2 * step)
            return PathStep(points=ahead, easy=True) if easy else PathStep(points=ahead)

        control = StepControl(first=1.0, shortest=0.1, most=4, growth=3.0)
        path = follow_path(0.0, control, advance, give_up=gave_up)
        # Two points a step, and four after the first at most are waited for.
        assert len(path.points) == 5
        return steps

    assert taken(easy=False) == [1.0, 1.0]
    assert taken(easy=True) == [1.0, 3.0]


@pytest.mark.parametrize("error", [TypeError(), InputError("A name is wrong."), WorkError("Gone.")])
def test_an_error_that_is_no_outcome_of_a_step_is_passed_on(error: Exception) -> None:
    def broken(_points: Sequence[float], _step: float) -> PathStep[float, str]:
        raise error

    with pytest.raises(type(error)):
        follow_path(0.0, CONTROL, broken, give_up=gave_up)


@pytest.mark.parametrize(
    "error", [StepError("too far"), SimulationError("too far", time=0.0, state=())]
)
def test_a_motion_that_cannot_be_simulated_refuses_the_step_as_a_bad_point_does(
    error: Exception,
) -> None:
    def refused(_points: Sequence[float], _step: float) -> PathStep[float, str]:
        raise error

    path = follow_path(0.0, CONTROL, refused, give_up=gave_up)
    assert path.points == (0.0,)
    assert "too far" in str(path.end)


@dataclass(frozen=True)
class OnCircle:
    angle: float

    @property
    def z(self) -> np.ndarray:
        return np.array([np.cos(self.angle), np.sin(self.angle)])

    @property
    def tangent(self) -> np.ndarray:
        return np.array([-np.sin(self.angle), np.cos(self.angle)])


def test_a_circle_is_back_at_its_start_when_a_chord_passes_it_and_not_before() -> None:
    points = [OnCircle(0.1 * k) for k in range(70)]
    back = [n for n in range(1, 70) if returns_to_start(points[:n], stray=0.1, turn=0.2)]
    # The chord from 6.2 to 6.3 passes 2 pi.
    assert back == [64]


def test_a_spiral_that_passes_beside_its_start_is_not_back() -> None:
    class OnSpiral(OnCircle):
        @property
        def z(self) -> np.ndarray:
            # A turn later it is 0.06 farther out, more than a tenth of a chord.
            return (1.0 + self.angle / 100) * super().z

    points = [OnSpiral(0.1 * k) for k in range(70)]
    assert not any(returns_to_start(points[:n], stray=0.1, turn=0.2) for n in range(1, 70))
    assert any(returns_to_start(points[:n], stray=1.0, turn=0.2) for n in range(1, 70))


@dataclass(frozen=True)
class Placed:
    """A point of the plane with the direction of its tangent."""

    x: float
    y: float = 0.0
    angle: float = 0.0

    @property
    def z(self) -> np.ndarray:
        return np.array([self.x, self.y])

    @property
    def tangent(self) -> np.ndarray:
        return np.array([np.cos(self.angle), np.sin(self.angle)])


@pytest.mark.parametrize(
    ("start", "back"),
    [
        (Placed(1.5), True),
        # The chord is 2 long, from 0 on: its end belongs to it, its beginning does not.
        (Placed(2.0), True),
        (Placed(0.0), False),
        (Placed(2.5), False),
        (Placed(-0.5), False),
        # Beside it by less than a quarter of its length, by a quarter, by more.
        (Placed(1.5, 0.4), True),
        (Placed(0.25, -0.4), True),
        (Placed(1.5, 0.5), False),
        (Placed(1.5, -0.6), False),
        # Turned by less than twice 0.2, by more, and all the way round.
        (Placed(1.5, angle=0.39), True),
        (Placed(1.5, angle=-0.41), False),
        (Placed(1.5, angle=np.pi), False),
    ],
    ids=str,
)
def test_a_start_is_passed_by_a_chord_that_it_lies_on_beside_by_little_and_along(
    start: Placed, *, back: bool
) -> None:
    points = [start, Placed(9.0, 9.0), Placed(0.0), Placed(2.0)]
    assert returns_to_start(points, stray=0.25, turn=0.2) is back
    # Three points are no loop.
    assert returns_to_start([start, *points[2:]], stray=0.25, turn=0.2) is False
