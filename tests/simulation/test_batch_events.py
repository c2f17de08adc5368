"""Falls of guards in rows of steps: polynomials, whose roots are known, in place of flows."""

import numpy as np
import pytest

from zeno_orbits.simulation.batch.events import first_falls, may_fall


def cubic(roots, size):
    """Return rows of a guard with these roots, and what `first_falls` asks of it."""
    polynomials = [np.poly1d(np.poly(row)) * -1.0 for row in roots]

    def dense(rows, offset):
        pairs = [
            (polynomials[r](t), polynomials[r].deriv()(t))
            for r, t in zip(rows, offset, strict=True)
        ]
        return np.array(pairs).reshape(-1, 2)

    every = np.arange(len(roots))
    return dense, dense(every, np.zeros(len(roots))), dense(every, np.full(len(roots), size))


def test_falls_are_found_where_a_cubic_has_them_and_nowhere_else():
    # -(t - a)(t - b)(t - c) falls at the first and third root, and rises at the second.
    roots = [(0.3, 2.0, 3.0), (-1.0, -0.5, 0.7), (0.2, 0.21, 4.0), (-2.0, -1.0, 5.0)]
    dense, before, after = cubic(roots, 1.0)
    size, on_guard = np.ones(4), np.zeros(4, dtype=bool)
    before = before.copy()
    falls = first_falls(dense, size, before, after, on_guard)
    assert falls[:2] == pytest.approx([0.3, 0.7], abs=1e-14)
    assert falls[2] == pytest.approx(0.2, abs=1e-12)
    assert np.isnan(falls[3])
    assert may_fall(size, before, after, on_guard).tolist() == [True, True, True, False]


def test_the_start_on_a_guard_is_no_fall_but_a_later_one_is():
    # Roots at the start, where the guard rises, and at 0.6, where it falls.
    dense, before, after = cubic([(-1.0, 0.0, 0.6)], 1.0)
    falls = first_falls(dense, np.ones(1), before, after, np.ones(1, dtype=bool))
    assert falls == pytest.approx([0.6], abs=1e-14)
