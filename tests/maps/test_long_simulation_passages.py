"""Whether a motion repeats, from sequences whose answer is plain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from tests.reference.long_simulation_passages import Passage, repeats, scale_of

CLOSE = 1e-6


def marked(values: Sequence[float]) -> list[Passage]:
    """A passage a second; the second state is always one."""
    return [Passage(time=float(k), state=np.array([value, 1.0])) for k, value in enumerate(values)]


def settles(values: Sequence[float], n: int, late: float = 0.0) -> bool:
    return repeats(marked(values), n, CLOSE, now=len(values) - 1 + late)


def test_equal_marks_repeat_and_too_few_tell_nothing() -> None:
    assert settles([2.0] * 4, 1)
    assert not settles([2.0] * 3, 1)
    assert not settles([2.0] * 4, 2)


@pytest.mark.parametrize("multiplier", [0.5, -0.5, 0.9, -0.99])
@pytest.mark.slow
def test_a_geometric_approach_repeats_once_what_is_left_of_it_is_small(multiplier: float) -> None:
    values = [1.0 + multiplier**k for k in range(4000)]
    first = next(k for k in range(5, 4000) if settles(values[:k], 1))
    # Relative to states of size 1; the last term is multiplier^(first - 1).
    left = abs(multiplier) ** (first - 1)
    assert left <= CLOSE
    # Steps that alternate are added up as if they did not: too careful by (1 + m) / (1 - m).
    assert left >= (1 - abs(multiplier)) / 4 * CLOSE


def test_slow_steps_that_add_up_do_not_pass_for_an_orbit() -> None:
    slow = [1.0 + 1e-4 * 0.9999**k for k in range(50)]
    assert abs(slow[-1] - slow[-2]) < CLOSE
    assert not settles(slow, 1)


def test_growing_and_dying_motions_do_not_repeat() -> None:
    for factor in (1.01, 0.99):
        values = [factor**k for k in range(100)]
        passages = [Passage(time=m.time, state=m.state[:1]) for m in marked(values)]
        assert not any(repeats(passages, n, CLOSE, now=99.0) for n in range(1, 9))


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_the_smallest_period_is_the_one_that_repeats(n: int) -> None:
    values = [1.0 + 0.1 * (k % n) for k in range(30)]
    assert next(m for m in range(1, 9) if settles(values, m)) == n


def test_a_motion_that_has_stopped_making_marks_does_not_repeat() -> None:
    assert settles([2.0] * 9, 1, late=1.4)
    assert not settles([2.0] * 9, 1, late=1.6)
    assert settles([2.0, 3.0] * 9, 2, late=2.9)


def test_a_state_that_vanishes_at_every_mark_is_measured_by_the_largest() -> None:
    passages = [Passage(time=0.0, state=np.array([0.0, 3.0, 1e-12, -2.0]))]
    assert scale_of(passages).tolist() == [3.0, 3.0, 3.0, 2.0]
