"""The loop that controls steps along a path, on paths that are known by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from zeno_orbits.errors import InputError, SimulationError, WorkError
from zeno_orbits.orbits.path import PathStep, StepControl, StepError, follow_path, returns_to_start

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
