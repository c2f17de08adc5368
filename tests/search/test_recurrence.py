"""After how many returns or impacts a motion repeats, told by numbers that are made up."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from zeno_orbits.model import CharacteristicScales
from zeno_orbits.orbits import ONE_ZENO, EventSequence, PhaseKind
from zeno_orbits.search.shooting.recurrence import (
    MOST_IMPACTS,
    Recurrence,
    TimedImpact,
    _as_returns,
)
from zeno_orbits.simulation import PERIODS, Impact

ZENO_TWICE = EventSequence.parsed("zeno*2")


def _lap(
    start: float, end: float, *, period: float = 1.0, size: float = 1.0, kinds: Any = ("zeno",)
) -> Any:
    """Return a return from one number to another; a second state is always zero."""
    phases = [SimpleNamespace(kind=PhaseKind(kind)) for kind in kinds]
    return SimpleNamespace(
        state_names=("x", "y"),
        start=SimpleNamespace(time=10.0, state=np.array([start, 0.0])),
        end=SimpleNamespace(time=10.0 + period, state=np.array([end, 0.0])),
        period=period,
        phases=phases,
        scale_at_events=lambda: np.array([size, 1.0]),
    )


def _laps(*places: float, **options: Any) -> tuple[Any, ...]:
    return tuple(_lap(a, b, **options) for a, b in pairwise(places))


def _struck(*after: Sequence[float], speeds: Sequence[float] = ()) -> tuple[TimedImpact, ...]:
    """Return impacts a second apart with states before them that are half of those after."""
    speeds = speeds or len(after) * [1.0]
    return tuple(
        TimedImpact(
            time=float(k),
            impact=Impact(
                time=0.0,
                state_minus=np.array(x) / 2,
                state_plus=np.array(x),
                approach_rate=-speed,
            ),
        )
        for k, (x, speed) in enumerate(zip(after, speeds, strict=True))
    )


def _seen(**changes: Any) -> Recurrence:
    told: dict[str, Any] = {"settled": 1e-3, "wanted": None}
    return Recurrence(**told | changes)


def _run(
    *impacts: float,
    releases: int = 0,
    zeno_points: int = 0,
    own: CharacteristicScales | None = None,
) -> Any:
    """Return a piece of a motion with impacts at times."""
    x = np.zeros(2)
    struck = [Impact(time=t, state_minus=x, state_plus=x, approach_rate=-1.0) for t in impacts]
    return SimpleNamespace(
        impacts=struck,
        releases=releases * [None],
        zeno_points=zeno_points * [None],
        own=own or CharacteristicScales(),
    )


# What is remembered.


def test_impacts_are_timed_from_the_beginning_of_the_motion_and_follow_those_before() -> None:
    seen = _seen().after(_run(0.25, 0.5), [], since=3.0).after(_run(0.125), [], since=7.0)
    assert [one.time for one in seen.struck] == [3.25, 3.5, 7.125]


@pytest.mark.parametrize("held", [{"releases": 1}, {"zeno_points": 1}])
def test_impacts_before_the_stop_held_do_not_count(held: dict[str, Any]) -> None:
    seen = _seen().after(_run(0.25), [], since=0.0).after(_run(0.5, **held), [], since=1.0)
    assert seen.struck == ()


def test_returns_follow_each_other_until_a_release_without_a_whole_return() -> None:
    one, two, three = _laps(1.0, 2.0, 3.0, 4.0)
    seen = _seen().after(_run(releases=1), [one], since=0.0)
    seen = seen.after(_run(), [], since=1.0)
    assert seen.returns == (one,)
    seen = seen.after(_run(releases=2), [two, three], since=1.0)
    assert seen.returns == (one, two, three)
    seen = seen.after(_run(releases=1), [], since=1.0)
    assert seen.returns == ()


def test_no_more_is_kept_than_four_times_the_longest_period() -> None:
    laps = _laps(*map(float, range(61)))
    seen = _seen().after(_run(*map(float, range(60))), laps, since=0.0)
    assert seen.returns == laps[-48:]
    assert [one.time for one in seen.struck] == [float(k) for k in range(12, 60)]


def test_sizes_are_those_of_the_last_piece() -> None:
    own = CharacteristicScales(sizes=(1e-3, 1.0))
    assert _seen().after(_run(own=own), [], since=0.0).own == own


def test_the_period_of_the_wanted_shape_that_came_nearest_is_kept() -> None:
    near, far = _lap(1.0, 1.25), _lap(1.25, 1.75)
    seen = _seen(wanted=ONE_ZENO).after(_run(releases=1), [near], since=0.0)
    seen = seen.after(_run(releases=1), [far], since=1.0)
    assert seen.best is not None
    assert (seen.best.cycle, seen.best.change) == (near, 0.25)
    nearer = seen.after(_run(releases=1), [_lap(1.75, 1.875)], since=2.0).best
    assert nearer is not None
    assert nearer.change == 0.125
    assert _seen().after(_run(releases=1), [near], since=0.0).best is None


# One period made of several returns.


def test_a_period_of_several_returns_adds_their_times_and_takes_the_largest_sizes() -> None:
    laps = (
        _lap(7.0, 1.0, period=100.0, size=1e3),
        _lap(1.0, 3.0, period=2.0, size=4.0),
        _lap(3.0, 5.0, period=3.0, size=16.0),
        _lap(5.0, 2.0, period=4.0, size=8.0),
    )
    seen = _seen(returns=laps)
    found = seen._after_returns(3)
    assert found is not None
    assert found.shape == EventSequence.parsed("zeno*3")
    assert found.period == 2.0 + 3.0 + 4.0
    # From 1 to 2 in units of 16.
    assert found.change == 1 / 16
    assert found.start.tolist() == [2.0, 0.0]
    assert found.cycle is None
    one = seen._after_returns(1)
    assert one is not None
    assert one.cycle is laps[-1]
    assert one.change == 3 / 8
    assert seen._after_returns(4) is not None
    assert seen._after_returns(5) is None


def test_laps_are_the_returns_that_they_start_and_end_at() -> None:
    laps = (_lap(1.0, 2.0, period=0.5, size=3.0), _lap(2.0, 4.0, period=0.25, size=5.0))
    found = _as_returns(laps)
    assert [one.time for one in found] == [10.0, 10.5, 10.25]
    assert [one.state[0] for one in found] == [1.0, 2.0, 4.0]
    assert [None if one.size is None else one.size[0] for one in found] == [3.0, 3.0, 5.0]


# One period made of several impacts.


def test_impacts_are_one_period_once_as_many_have_repeated() -> None:
    struck = _struck((1.0, 10.0), (2.0, 20.0), (1.125, 10.0), (2.0, 20.5))
    seen = _seen(struck=struck)
    found = seen._after_impacts(2)
    assert found is not None
    assert found.shape == EventSequence.parsed("impact*2")
    assert found.start.tolist() == [2.0, 20.5]
    assert found.period == 2.0
    # 1.125 against 1, in units of the largest, 2.
    assert found.change == 0.0625
    assert found.cycle is None
    assert seen._after_impacts(3) is None
    assert _seen(struck=struck[1:])._after_impacts(2) is None


def test_a_later_impact_that_differs_more_counts_and_so_does_its_speed() -> None:
    places = ((1.0, 1.0), (1.0, 1.0), (1.0, 1.0), (1.0, 1.5))
    found = _seen(struck=_struck(*places))._after_impacts(2)
    assert found is not None
    assert found.change == pytest.approx(0.5 / 1.5)
    same = 4 * [(1.0, 1.0)]
    for speeds, change in (((1.0, 1.0, 0.8, 1.0), 0.25), ((1.0, 1.0, 1.0, 4.0), 0.75)):
        slower = _seen(struck=_struck(*same, speeds=speeds))._after_impacts(2)
        assert slower is not None
        assert slower.change == pytest.approx(change)


@pytest.mark.parametrize(("size", "change"), [(1e-10, 1e-10), (1.5e-9, 1.0)])
def test_a_state_that_vanishes_at_the_impacts_has_the_largest_size(
    size: float, change: float
) -> None:
    # A billionth of the largest is rounding.
    found = _seen(struck=_struck((1.0, 0.0), (1.0, size)))._after_impacts(1)
    assert found is not None
    assert found.change == pytest.approx(change)
    # In the problem's own sizes both are as large.
    own = CharacteristicScales(sizes=(1.0, 1e-12))
    alone = _seen(struck=_struck((1.0, 0.0), (1.0, size)), own=own)._after_impacts(1)
    assert alone is not None
    assert alone.change == pytest.approx(1.0)


def test_sizes_of_impacts_are_those_before_and_after_them() -> None:
    before, after = np.array([-8.0, 1.0]), np.array([2.0, 8.0])
    struck = [
        TimedImpact(
            time=float(k),
            impact=Impact(time=0.0, state_minus=before, state_plus=after + k, approach_rate=-1.0),
        )
        for k in range(2)
    ]
    found = _seen(struck=tuple(struck))._after_impacts(1)
    assert found is not None
    # The first state changes by 1 of 8, the second by 1 of 9.
    assert found.change == 1 / 8


# What the motion settles to.


@pytest.mark.parametrize("n", PERIODS)
def test_the_shortest_number_of_returns_that_repeats_is_the_period(n: int) -> None:
    round_once = [float(k) for k in range(1, n + 1)]
    laps = _laps(*(3 * round_once), 1.0, size=float(n))
    found = _seen(returns=laps).settled_to()
    assert found is not None
    assert (found.shape.n_phases, found.period) == (n, n)


def test_returns_repeat_if_they_change_by_less_than_what_counts_as_none() -> None:
    assert _seen(returns=_laps(1.0, 1.0 + 1.1e-3)).settled_to() is None
    found = _seen(returns=_laps(1.0, 1.0 + 0.9e-3)).settled_to()
    assert found is not None
    assert found.change == pytest.approx(0.9e-3)


def test_a_motion_that_throws_over_repeats_after_one_return_not_two() -> None:
    # Each return changes it by 2e-3 or less, two by 5e-5: not a hundred times nearer.
    over = _laps(1.0, 1.002, 1.00005)
    assert _seen(returns=over).settled_to() is None
    # By 1e-5 two are nearer than one by 200.
    found = _seen(returns=_laps(1.0, 1.002, 1.00001)).settled_to()
    assert found is not None
    assert found.shape == ZENO_TWICE


def test_states_of_returns_are_measured_in_the_problems_own_sizes() -> None:
    # Of a size of 1e-15 the state would be rounding beside another of 1.
    lap = _lap(1e-15, 2e-15, size=1e-15)
    assert _seen(returns=(lap,)).settled_to() is not None
    assert _seen(returns=(lap,), own=CharacteristicScales(sizes=(1e-15, 1.0))).settled_to() is None


@pytest.mark.parametrize("n", [1, 2, MOST_IMPACTS])
def test_the_shortest_number_of_impacts_that_repeats_is_the_period(n: int) -> None:
    places = 4 * [(float(k), 1.0) for k in range(1, n + 1)]
    found = _seen(struck=_struck(*places)).settled_to()
    assert found is not None
    assert found.shape == EventSequence(phases=n * (PhaseKind.IMPACT,))
    assert found.change == 0.0


def test_no_longer_period_of_impacts_is_looked_for_than_the_longest() -> None:
    n = MOST_IMPACTS + 1
    places = 4 * [(float(k), 1.0) for k in range(1, n + 1)]
    assert _seen(struck=_struck(*places)).settled_to() is None
    assert _seen().settled_to() is None


def test_impacts_repeat_if_they_change_by_less_than_what_counts_as_none() -> None:
    assert _seen(struck=_struck((0.9985, 1.0), (1.0, 1.0))).settled_to() is None
    assert _seen(struck=_struck((0.9995, 1.0), (1.0, 1.0))).settled_to() is not None
    same = _struck((1.0, 1.0), (1.0, 1.0))
    assert _seen(struck=same).settled_to() is not None
    assert _seen(struck=same, settled=0.0).settled_to() is None


def test_two_impacts_are_one_period_only_if_nearer_by_far_than_one() -> None:
    def two(change: float) -> Recurrence:
        return _seen(struck=_struck((1.0, 1.0), (0.99, 1.0), (1.0, 1.0), (0.99 - change, 1.0)))

    # One impact changes the state by some 0.01.
    assert two(2e-4).settled_to() is None
    found = two(0.5e-4).settled_to()
    assert found is not None
    assert found.shape.n_phases == 2


def test_the_nearest_shorter_period_counts_not_the_last() -> None:
    # One impact changes by 0.002, two by 0.3, three by 2e-4: a tenth of what one does.
    places = [(1.0, 1.0), (0.7, 1.0), (0.7014, 1.0)]
    again = [(1.0, 1.0), (0.7, 1.0), (0.7012, 1.0)]
    assert _seen(struck=_struck(*places, *again)).settled_to() is None


# What may do for a guess.


def test_the_nearest_period_of_the_wanted_shape_is_a_guess_unless_it_changes_by_all_its_size() -> (
    None
):
    for end, is_one in ((1.5, True), (2.0, False), (3.0, False)):
        seen = _seen(wanted=ONE_ZENO).after(_run(releases=1), [_lap(1.0, end)], since=0.0)
        assert (seen.nearest(usable=0.0) is seen.best) == is_one
        assert (seen.nearest(usable=0.0) is None) != is_one
    assert _seen(wanted=ONE_ZENO).nearest(usable=1.0) is None


def test_the_shortest_usable_period_is_a_guess_unless_a_longer_one_is_ten_times_better() -> None:
    # One return changes by 0.02.
    for end, n in ((1.0019, 2), (1.0021, 1)):
        found = _seen(returns=_laps(1.0, 1.02 + end - 1.0, end)).nearest(usable=0.1)
        assert found is not None
        assert found.shape.n_phases == n
    # Exactly ten times is no more than that.
    tenth = _seen(returns=_laps(1.0, 1.6875, 1.0625)).nearest(usable=1.0)
    assert tenth is not None
    assert (tenth.shape, tenth.change) == (ONE_ZENO, 10 * 0.0625)
    near = _seen(returns=_laps(1.0, 1.02))
    assert near.nearest(usable=0.021) is not None
    assert near.nearest(usable=0.019) is None
    # A change of exactly what is usable is too much.
    exact = _seen(returns=_laps(1.0, 1.25))
    assert exact.nearest(usable=0.25) is None


def test_without_returns_impacts_are_a_guess() -> None:
    struck = _struck((1.0, 1.0), (0.5, 1.0), (1.0, 1.0), (0.51, 1.0))
    found = _seen(struck=struck).nearest(usable=0.1)
    assert found is not None
    assert found.shape == EventSequence.parsed("impact*2")
    once = _seen(struck=_struck((1.0, 1.0), (1.0625, 1.0))).nearest(usable=0.1)
    assert once is not None
    assert once.shape == EventSequence.parsed("impact")
    longest = 2 * [(float(k), 1.0) for k in range(1, MOST_IMPACTS + 1)]
    found = _seen(struck=_struck(*longest)).nearest(usable=0.01)
    assert found is not None
    assert found.shape.n_phases == MOST_IMPACTS
    beyond = 2 * [(float(k), 1.0) for k in range(1, MOST_IMPACTS + 2)]
    assert _seen(struck=_struck(*beyond)).nearest(usable=0.01) is None
    # Returns come first.
    both = _seen(struck=struck, returns=_laps(1.0, 1.01)).nearest(usable=0.1)
    assert both is not None
    assert both.shape == ONE_ZENO


def test_periods_of_the_wanted_shape_end_at_the_last_event() -> None:
    laps = _laps(1.0, 2.0, 3.0, 4.0)
    assert _seen(returns=laps).of_wanted_shape() == []
    (one,) = _seen(returns=laps, wanted=ONE_ZENO).of_wanted_shape()
    assert one.cycle is laps[-1]
    (two,) = _seen(returns=laps, wanted=ZENO_TWICE).of_wanted_shape()
    assert (two.period, two.change) == (2.0, 2.0)
    assert _seen(returns=laps, wanted=EventSequence.parsed("plastic")).of_wanted_shape() == []
    struck = _struck((1.0, 1.0), (2.0, 1.0), (1.0, 1.0), (2.0, 1.0))
    wanted = EventSequence.parsed("impact*2")
    (struck_twice,) = _seen(struck=struck, wanted=wanted).of_wanted_shape()
    assert (struck_twice.shape, struck_twice.change) == (wanted, 0.0)
    assert _seen(struck=struck[:3], wanted=wanted).of_wanted_shape() == []


# Why there is none.


def test_the_reason_says_what_was_seen() -> None:
    twice = _seen(returns=_laps(1.0, 2.0, 1.0), wanted=ONE_ZENO)
    assert twice.reason(5.0) == "the motion settles to an orbit of shape `zeno*2`"
    differing = _laps(1.0, 2.0)
    wanting = _seen(returns=differing, wanted=ZENO_TWICE)
    assert wanting.reason(5.0) == "no period of shape `zeno*2` nearly repeats"
    assert _seen(returns=differing).reason(5.0) == "its periods differ after 5 s"
    never = "no release is followed by a Zeno point"
    assert _seen().reason(2.5) == f"{never} after 2.5 s"
    struck = _struck((1.0, 1.0), (2.0, 1.0))
    assert _seen(struck=struck).reason(5.0) == (
        f"{never}, and its impacts do not repeat, after 5 s"
    )
