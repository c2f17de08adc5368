"""The first guess of Newton's method for orbits of motions."""

from __future__ import annotations

import numpy as np
import pytest

from zeno_orbits.maps.newton import limit_of_steps


def test_the_limit_of_a_linear_motion_along_one_direction_is_its_fixed_point() -> None:
    scale, last = np.array([1.0, 10.0, 0.1]), np.array([0.3, -2.0, 0.05])
    away = 1e-3 * np.array([1.0, 2.0, 3.0]) * scale
    for multiplier in (0.9, 0.2, -0.7):
        # The last state is a return at a distance of `away` from the limit.
        before, earlier = (last + (1.0 / multiplier**k - 1.0) * away for k in (1, 2))
        found = limit_of_steps(last, before, earlier, scale)
        assert found == pytest.approx(last - away, abs=1e-12)
    # Steps that become longer, or no steps, lead nowhere.
    assert np.array_equal(limit_of_steps(last, last + away, last + 1.5 * away, scale), last)
    assert np.array_equal(limit_of_steps(last, last, last, scale), last)
