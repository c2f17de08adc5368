"""The rules of events on plain numbers, at and on both sides of their limits."""

from __future__ import annotations

import numpy as np
import pytest

from zeno_orbits.simulation.event_rules import (
    closes_at_once,
    enters_stop,
    is_geometric,
    stop_holds,
)


def test_a_reset_into_the_stop_is_one_beyond_the_rounding_of_its_rates() -> None:
    # 1e-9 of the rate before and of the usual one.
    assert enters_stop(-1.01e-9 * 4.0, -3.0, 1.0)
    assert not enters_stop(-1e-9 * 4.0, -3.0, 1.0)
    assert not enters_stop(-0.99e-9 * 4.0, -3.0, 1.0)
    assert enters_stop(np.array([-1e-8, 0.0, 1.0]), -3.0, 1.0).tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("acceleration", "rate", "slack", "holds"),
    [
        (-1.0, -1.0, False, True),
        (1.0, 1.0, False, False),
        (0.5, 1.0, False, False),
        (0.0, 1.0, False, False),
        # Where the acceleration is rounding, the multiplier's rate decides.
        (1e-17, 1.0, True, True),
        (-1e-17, -1.0, True, False),
        (-1e-17, 0.0, True, False),
    ],
)
def test_a_stop_holds_what_falls_to_it_or_is_about_to(
    acceleration: float, rate: float, slack: bool, holds: bool
) -> None:
    assert bool(stop_holds(acceleration, rate, slack)) is holds


def test_a_gap_that_opens_by_less_than_its_rounding_does_not_open() -> None:
    # It opens to 2 a^3 / (3 b^2), with b = 2 here: 3.4e-16 is a = 1.27e-5, of coordinates near 1.
    eps = 4 * 2.0**-52
    limit = (1.5 * eps * 2.0**2) ** (1 / 3)
    assert closes_at_once(0.99 * limit, 6.0, 3.0, 1.0)
    assert not closes_at_once(1.01 * limit, 6.0, 3.0, 1.0)
    # Far from the origin more is rounding; a gap that goes on opening is none.
    assert closes_at_once(1.01 * limit, 6.0, 3.0, 2.0)
    assert not closes_at_once(0.99 * limit, -6.0, 3.0, 1.0)
    # What does not open at all is no flight to leave out, nor what opens for ever, however slowly.
    assert not closes_at_once(0.0, 6.0, 3.0, 1.0)
    assert not closes_at_once(1e-120, 0.0, 3.0, 1.0)


@pytest.mark.parametrize("fall", [0.25, 5.0])
def test_the_height_of_a_gap_that_opens_goes_with_the_square_of_its_fall(fall: float) -> None:
    limit = (1.5 * 4 * 2.0**-52 * fall**2) ** (1 / 3)
    assert closes_at_once(0.99 * limit, 3.0 * fall, 3.0, 1.0)
    assert not closes_at_once(1.01 * limit, 3.0 * fall, 3.0, 1.0)


def test_a_tail_over_which_the_acceleration_bends_by_a_tenth_is_not_geometric_yet() -> None:
    assert is_geometric(-10.9, -10.0)
    assert is_geometric(-11.0, -10.0)
    assert is_geometric(-9.1, -10.0)
    assert not is_geometric(-11.1, -10.0)
    assert is_geometric(np.array([-10.5, -12.0]), -10.0).tolist() == [True, False]
