"""Steps in boxes around the last orbit: which boxes, what refuses a step, and where they end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest

from zeno_orbits.model.problem import ParameterValues
from zeno_orbits.search.trust_region import LastStep, _is_held, trust_region_steps

Box = dict[str, tuple[float, float]]
CYCLE: Any = "the first cycle"


@dataclass(frozen=True)
class _Search:
    """A search as far as steps in boxes are concerned."""

    free: Box


def _gains(**values: float) -> ParameterValues:
    return ParameterValues(gains=values, parameters={})


def _step(agreement: float = 0.0, **values: float) -> Any:
    solution = SimpleNamespace(values=_gains(**values), cycle=f"the cycle at {values}")
    return SimpleNamespace(solution=solution, agreement=agreement, detail="")


REFUSED: Any = SimpleNamespace(solution=None, agreement=0.0, detail="no")


def _steps(
    free: Box, answer: Callable[[int, Box], Any], **values: float
) -> tuple[LastStep, list[Box]]:
    """Return where steps lead whose outcomes are given, and the boxes they were asked for in."""
    boxes: list[Box] = []

    def solve(search: Any, _values: ParameterValues, _cycle: Any) -> Any:
        boxes.append(search.free)
        return answer(len(boxes) - 1, search.free)

    search: Any = _Search(free=free)
    return trust_region_steps(search, _gains(**values), CYCLE, solve), boxes


def _halves(boxes: list[Box], name: str, size: float) -> list[float]:
    return [(box[name][1] - box[name][0]) / (2 * size) for box in boxes]


def test_a_box_is_a_tenth_of_each_range_to_both_sides_and_ends_where_the_range_does() -> None:
    free = {"Kp": (0.0, 10.0), "Kd": (-2.0, 2.0), "R": (1.0, 3.0)}
    last, (box,) = _steps(free, lambda *_: _step(Kp=5.0, Kd=-1.9, R=2.9), Kp=5.0, Kd=-1.9, R=2.9)
    expected = {"Kp": (4.0, 6.0), "Kd": (-2.0, -1.5), "R": (2.7, 3.0)}
    assert list(box) == list(expected)
    for name, sides in expected.items():
        assert box[name] == pytest.approx(sides)
    assert last.converged


def test_a_refused_step_is_tried_again_in_a_quarter_of_the_box_and_an_accepted_one_doubles_it() -> (
    None
):
    def answer(count: int, box: Box) -> Any:
        return _step(Kp=box["Kp"][1]) if count == 0 else REFUSED

    last, boxes = _steps({"Kp": (0.0, 10.0)}, answer, Kp=5.0)
    # The last one would be less than 0.002 of the range to a side: it is not tried.
    assert _halves(boxes, "Kp", 10.0) == pytest.approx([0.1, 0.2, 0.05, 0.0125, 0.003125])
    assert not last.converged
    assert last.values.number("Kp") == pytest.approx(6.0)
    assert last.cycle == f"the cycle at { {'Kp': 6.0} }"


def test_without_an_accepted_step_the_first_orbit_is_left_as_it_is() -> None:
    last, boxes = _steps({"Kp": (0.0, 10.0)}, lambda *_: REFUSED, Kp=5.0)
    assert _halves(boxes, "Kp", 10.0) == pytest.approx([0.1, 0.025, 0.00625])
    assert last == LastStep(values=_gains(Kp=5.0), cycle=CYCLE)
    assert not last.converged
    assert last.outcome is None


def test_steps_end_after_forty() -> None:
    accepted: list[float] = []

    def answer(_: int, box: Box) -> Any:
        low, high = box["Kp"]
        if high - low > 0.2:
            return REFUSED
        accepted.append(high)
        return _step(Kp=high)

    last, _ = _steps({"Kp": (0.0, 10.0)}, answer, Kp=1.0)
    assert len(accepted) == 40
    assert last.values.number("Kp") == accepted[-1] < 9.0
    assert not last.converged


@pytest.mark.parametrize(
    ("agreement", "taken"), [(0.99e-4, True), (1e-4, False), (float("nan"), False)]
)
def test_a_solution_that_its_simulation_does_not_follow_well_enough_is_no_step(
    agreement: float, taken: bool
) -> None:
    last, _ = _steps({"Kp": (0.0, 10.0)}, lambda *_: _step(agreement, Kp=5.5), Kp=5.0)
    assert last.converged is taken
    assert last.values.number("Kp") == (5.5 if taken else 5.0)
    assert (last.outcome is not None) is taken


@pytest.mark.parametrize(
    ("here", "held"), [(0.0, True), (0.9e-3, True), (1e-3, False), (0.5, False)]
)
def test_a_number_is_held_within_a_thousandth_of_its_box(here: float, held: bool) -> None:
    search: Any = _Search(free={"Kp": (-5.0, 5.0)})
    assert _is_held(search, _gains(Kp=here), {"Kp": (0.0, 1.0)}) is held
    assert _is_held(search, _gains(Kp=-here), {"Kp": (-1.0, 0.0)}) is held


def test_each_number_is_held_by_its_own_box() -> None:
    search: Any = _Search(free={"Kp": (-5.0, 5.0), "R": (-500.0, 500.0)})
    box = {"Kp": (0.0, 1.0), "R": (0.0, 100.0)}
    assert _is_held(search, _gains(Kp=0.05, R=0.05), box)
    assert not _is_held(search, _gains(Kp=0.05, R=50.0), box)
