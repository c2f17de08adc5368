"""Motions followed again where small errors may decide: which answers are believed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from zeno_orbits.maps import Accuracy, Attractor, AttractorClass
from zeno_orbits.maps.approach import Approach
from zeno_orbits.maps.sure_point import sure_attractor

ORBIT = Attractor(fate=AttractorClass.NO_ZENO, period=2.0)
REST = Attractor(fate=AttractorClass.REST)
DIRECT = Approach(times=tuple(np.arange(1.0, 41.0)), captured=9)
LATE = replace(DIRECT, captured=10)

Told = tuple[Attractor, Approach | None]


ACCURATE = Accuracy(motion=1e-10)


def told_by(*answers: Told, accuracy: Accuracy | None = None) -> tuple[Attractor, list[Accuracy]]:
    """Return what is concluded of a motion that settles to these in turn, and the accuracies."""
    used: list[Accuracy] = []

    class Scripted:
        """A motion that comes to its answer."""

        def __init__(self, accuracy: Accuracy) -> None:
            assert isinstance(accuracy, Accuracy)
            used.append(accuracy)
            self.way = answers[len(used) - 1][1]
            self._answer = answers[len(used) - 1][0]

        def attractor(self) -> Attractor:
            return self._answer

    answer, way = sure_attractor(Scripted, accuracy or Accuracy())  # type: ignore[arg-type]
    assert way is (None if math.isnan(answer.period) else answers[len(used) - 1][1])
    return answer, used


def test_a_motion_that_goes_straight_to_its_orbit_is_followed_once() -> None:
    for told in ((ORBIT, DIRECT), (REST, None), (REST, LATE)):
        answer, used = told_by(told)
        assert answer is told[0]
        assert used == [Accuracy()]


def test_a_motion_that_wanders_has_to_do_so_at_two_accuracies_alike() -> None:
    finer = replace(ORBIT, period=2.0 * (1 + 0.9e-4))
    answer, used = told_by((ORBIT, LATE), (finer, LATE))
    assert answer is finer
    assert [(one.motion, one.orbit) for one in used] == [(1e-8, 1e-10), (1e-10, 1e-10)]
    # One that is as accurate as its orbit already is followed more accurately.
    _, used = told_by((ORBIT, LATE), (finer, LATE), accuracy=ACCURATE)
    assert [one.motion for one in used] == pytest.approx([1e-10, 1e-12])
    # So has one whose last return took another time.
    doubtful = replace(DIRECT, doubtful=True)
    answer, used = told_by((ORBIT, doubtful), (ORBIT, DIRECT))
    assert (answer, len(used)) == (ORBIT, 2)


@pytest.mark.parametrize(
    "again",
    [
        (replace(ORBIT, period=2.0 * (1 + 1.1e-4)), LATE),
        (replace(ORBIT, fate=AttractorClass.ZENO), LATE),
        (replace(ORBIT, returns=1), LATE),
        # It leaves the way of before by more than a hundredth of a return, or is there sooner.
        (ORBIT, replace(LATE, times=tuple(np.arange(1.0, 41.0) + 0.011))),
        (ORBIT, replace(LATE, times=tuple(np.arange(2.0, 12.0)), captured=9)),
    ],
)
def test_a_motion_that_ends_elsewhere_more_accurately_is_followed_a_third_time(again: Told) -> None:
    answer, used = told_by((ORBIT, LATE), again, again)
    assert answer is again[0]
    assert [one.motion for one in used] == pytest.approx([1e-8, 1e-10, 1e-12])
    assert [one.orbit for one in used] == pytest.approx([1e-10, 1e-10, 1e-12])
    # The second answer is held against the third, not the first one.
    answer, _ = told_by((ORBIT, LATE), again, (ORBIT, LATE))
    assert answer.fate is AttractorClass.UNSETTLED
    assert answer.detail == "its attractor depends on the smallest errors"


def test_a_motion_that_settles_only_inaccurately_is_not_settled() -> None:
    growing = Attractor(fate=AttractorClass.UNSETTLED, trend=1.2)
    answer, used = told_by((ORBIT, LATE), (growing, None))
    assert (answer.fate, answer.trend, len(used)) == (AttractorClass.UNSETTLED, 1.2, 2)
    assert answer.detail == "its attractor depends on the smallest errors"


def test_a_way_is_shared_up_to_where_it_comes_nearer_only() -> None:
    # Four returns in 20 s: they may differ by 0.05 s when the way begins.
    times = (2.0, 4.0, 6.0, 20.0)
    way = Approach(times=times, captured=2)
    assert way.is_shared_by(replace(way, times=(2.5, 4.5, 6.049)))
    assert way.is_shared_by(replace(way, times=(2.0, 4.0, 5.951, 50.0)))
    assert not way.is_shared_by(replace(way, times=(2.0, 4.0, 6.051, 20.0)))
    assert not way.is_shared_by(replace(way, times=(2.0, 4.0)))
