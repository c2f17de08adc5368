"""Falls of guards in rows of steps: polynomials, whose roots are known, in place of flows."""

import math

import numpy as np
import pytest

from zeno_orbits.simulation.batch.events import (
    _hermite_root,
    _lowest,
    _stays_above,
    first_falls,
    may_fall,
)


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


class Guards:
    """Guards as functions of time, a row each, with their rates; counts the looks at each row."""

    def __init__(self, *functions):
        self.functions = functions
        self.looks = np.zeros(len(functions), dtype=int)

    def __call__(self, rows, offset):
        np.add.at(self.looks, rows, 1)
        pairs = [self.functions[row](t) for row, t in zip(rows, offset, strict=True)]
        return np.array(pairs).reshape(-1, 2)

    def falls(self, sizes, on_guard):
        """Return where they fall, and how often each was looked at."""
        every, size = np.arange(len(self.functions)), np.array(sizes, dtype=float)
        before, after = self(every, 0 * size), self(every, size)
        self.looks[:] = 0
        found = first_falls(self, size, before, after, np.array(on_guard, dtype=bool))
        return found, self.looks


def with_roots(*roots, size=1.0, sign=-1.0):
    """A polynomial with these roots, in parts of a step, and its rate."""
    whole = np.poly1d(np.poly(np.array(roots) * size)) * sign
    rate = whole.deriv()
    return lambda t: (whole(t), rate(t))


@pytest.mark.parametrize(
    ("before", "after", "on_guard", "may"),
    [
        ((0.5, 0.0), (0.5, 0.0), False, False),
        # In a step of 3 the inner coefficients are value + rate and value - rate.
        ((1.0, -1.0), (1.0, 0.0), False, True),
        ((1.0, -0.5), (1.0, 0.0), False, False),
        ((1.0, 0.0), (1.0, 1.0), False, True),
        ((1.0, 0.0), (1.0, 0.5), False, False),
        # At the end on the guard, or beyond it.
        ((1.0, 0.0), (0.0, -1.0), False, True),
        ((1.0, 0.0), (-0.5, -1.0), False, True),
        # A rate that changes its sign from falling to rising hides a dip.
        ((2.0, -1.0), (2.0, 1.0), False, True),
        ((2.0, 0.0), (2.0, 1.0), False, False),
        ((2.0, -1.0), (2.0, 0.0), False, False),
        ((2.0, 1.0), (2.0, -1.0), False, False),
        # A start on the guard is none if the guard rises from there.
        ((0.0, 0.5), (1.0, 0.0), True, False),
        ((0.0, 0.5), (1.0, 0.0), False, True),
        ((-0.1, 0.5), (1.0, 0.0), True, True),
        ((-0.1, 0.5), (1.0, 0.0), False, True),
        ((0.5, 0.5), (1.0, 0.0), True, False),
    ],
)
def test_a_guard_may_fall_unless_its_cubic_stays_above(before, after, on_guard, may):
    # Beside a row that does not, and one that does.
    size = np.array([3.0, 3.0, 3.0])
    starts = np.array([[1.0, 0.0], before, [1.0, 0.0]])
    ends = np.array([[1.0, 0.0], after, [-1.0, 0.0]])
    found = may_fall(size, starts, ends, np.array([False, on_guard, False]))
    assert found.tolist() == [False, may, True]


@pytest.mark.parametrize("size", [1e-6, 1.0, 100.0])
@pytest.mark.parametrize("eighth", range(8))
def test_the_first_of_two_falls_is_found_in_every_eighth_of_a_step(eighth, size):
    middle = (eighth + 0.5) / 8
    guards = Guards(
        # A dip within an eighth, in its middle or at either side, then a fall beyond the step.
        with_roots(middle - 0.01, middle + 0.01, 1.5, size=size),
        with_roots(middle - 0.06, middle - 0.05, 1.5, size=size),
        with_roots(middle + 0.05, middle + 0.06, 1.5, size=size),
        # A fall in one eighth, a rise in the next one but one, and another fall, or none.
        with_roots(middle, middle + 0.25, 1.5, size=size),
        with_roots(middle, middle + 0.25, middle + 0.3, size=size),
        # One that is no cubic.
        with_roots(middle, middle + 0.2, 1.7, 1.1, 1.2, size=size),
        # None: it only comes near.
        with_roots(middle + 1e-3j, middle - 1e-3j, 1.5, size=size),
    )
    found, _ = guards.falls([size] * 7, [False] * 7)
    expected = size * np.array([middle - 0.01, middle - 0.06, middle + 0.05, *[middle] * 3, np.nan])
    assert found == pytest.approx(expected, rel=1e-12, nan_ok=True)


def test_a_start_on_the_guard_counts_only_once_the_guard_has_been_above():
    guards = Guards(
        # It rises and falls.
        with_roots(-1.0, 0.0, 0.8),
        # It falls at once, rises at 0.3 and falls again; or dips within the first eighth.
        with_roots(0.0, 0.3, 0.8),
        with_roots(0.0, 0.05, 0.8),
        # It falls for good, from the guard or from rounding above it.
        with_roots(0.0),
        lambda t: (1e-18 - t, -1.0),
        # It stays on the guard as long as the step, or above it.
        lambda _: (0.0, 0.0),
        with_roots(0.0, 3.0),
        # It rises, dips between two eighths, and stays above.
        with_roots(0.0, 0.68, 0.7, 2.0, sign=-1.0),
        # It stays on the guard and falls from there; or falls, rises, and never reaches it.
        lambda t: (-max(t - 0.5, 0.0), -float(t > 0.5)),
        with_roots(0.0, 0.5 + 0.1j, 0.5 - 0.1j),
        # A short rise, and another fall that ends in the middle of the next rise.
        with_roots(0.0, 1e-6, 1.2, sign=1.0),
    )
    found, _ = guards.falls([1.0] * 11, [True] * 11)
    nan = np.nan
    expected = [0.8, 0.8, 0.8, nan, nan, nan, nan, 0.68, nan, nan, 1e-6]
    assert found == pytest.approx(expected, rel=1e-12, nan_ok=True)
    # Elsewhere the first fall counts, that at the start too.
    found, _ = guards.falls([1.0] * 11, [False] * 11)
    expected = [0.8, 0.0, 0.0, 0.0, 0.0, nan, nan, 0.68, 0.5, 0.0]
    assert found[:10] == pytest.approx(expected, rel=1e-12, abs=1e-15, nan_ok=True)


@pytest.mark.parametrize("power", [3, 10, 20, 40])
def test_a_rise_from_the_guard_far_shorter_than_the_step_is_found(power):
    short = 2.0**-power
    guards = Guards(*(with_roots(0.0, part * short) for part in (0.4, 0.6, 1.0)))
    found, looks = guards.falls([1.0] * 3, [True] * 3)
    assert found == pytest.approx([0.4 * short, 0.6 * short, short], rel=1e-13)
    # Seven eighths, as many halves as it takes, and Newton's steps.
    assert max(looks) <= 7 + power + 1 + 8


def test_a_guard_that_is_zero_at_the_end_of_a_step_has_not_fallen_yet():
    found, _ = Guards(with_roots(1.0), with_roots(1.0 + 1e-9), with_roots(1.0 - 1e-9)).falls(
        [1.0] * 3, [False] * 3
    )
    assert found == pytest.approx([np.nan, np.nan, 1.0 - 1e-9], rel=1e-15, nan_ok=True)


@pytest.mark.parametrize(
    "roots",
    [
        (0.3,),
        (0.95,),
        (0.05,),
        (0.3, -1.0, -0.7),
        (0.9, 1.8, 2.5),
        (0.05, 1.5, 3.0),
        (0.5, -1 + 3j, -1 - 3j),
    ],
)
def test_a_guard_that_falls_once_as_its_cubic_says_takes_few_looks(roots):
    found, looks = Guards(with_roots(*roots)).falls([1.0], [False])
    assert found == pytest.approx([roots[0]], rel=1e-15, abs=1e-15)
    # One in the middle, one where the cubic has its root, and one or two to be sure.
    assert looks[0] <= 4


def test_a_guard_whose_middle_is_not_its_cubics_is_looked_at_in_eighths():
    # A line that falls at 0.9, with a dip about the middle: its ends tell the last fall alone.
    def dipping(t):
        dip = 0.8 * math.exp(-(((t - 0.5) / 0.08) ** 2))
        return 0.9 - t - dip, -1.0 + 2 * (t - 0.5) / 0.08**2 * dip

    found, _ = Guards(dipping).falls([1.0], [False])
    assert 0.4 < found[0] < 0.5
    assert dipping(found[0])[0] == pytest.approx(0.0, abs=1e-15)


def test_a_dip_that_a_tangent_excludes_costs_no_look_and_another_few():
    def parabola(height, steep):
        return lambda t: (height + steep * (t - 0.56) ** 2, 2 * steep * (t - 0.56))

    guards = Guards(parabola(1.0, 10.0), parabola(1e-3, 50.0), parabola(-1e-3, 50.0))
    found, looks = guards.falls([1.0] * 3, [False] * 3)
    half = (1e-3 / 50.0) ** 0.5
    assert found == pytest.approx([np.nan, np.nan, 0.56 - half], rel=1e-12, nan_ok=True)
    assert looks[0] == 7
    # Until the parabola's tangent stays above: the width falls by half a look.
    assert 8 <= looks[1] <= 7 + 8


def test_the_lowest_place_of_a_dip_is_found_by_its_rate():
    for place in (0.01, 0.3, 0.5, 0.77, 0.99):
        guards = Guards(lambda t, place=place: (1e-9 + (t - place) ** 2, 2 * (t - place)))
        _, pair = _lowest(guards, 0, 0.0, 1.0)
        # Halves until a tangent from the lowest place tells that it does not reach zero.
        assert pair[0] > 0.0
        assert guards.looks[0] <= 17
        below = Guards(lambda t, place=place: ((t - place) ** 2 - 1e-6, 2 * (t - place)))
        at, pair = _lowest(below, 0, 0.0, 1.0)
        assert abs(at - place) < 1e-3
        assert pair == pytest.approx(below(np.array([0]), np.array([at]))[0], rel=1e-15)
        assert pair[0] < 0.0
        assert below.looks[0] <= 12


@pytest.mark.parametrize(
    ("left", "right", "stays"),
    [
        # Tangents over a width of 2.
        ((2.1, -1.0), (0.1, 3.0), True),
        ((2.0, -1.0), (0.1, 3.0), False),
        ((0.1, -1.0), (2.1, 1.0), True),
        ((0.1, -1.0), (2.0, 1.0), False),
        ((9.0, -1.0), (9.0, 1.0), True),
    ],
)
def test_a_dip_stays_above_where_a_tangent_at_one_of_its_ends_does(left, right, stays):
    pairs = np.array([left]), np.array([right])
    assert _stays_above(*pairs, np.array([2.0])).tolist() == [stays]


@pytest.mark.parametrize("place", [1e-9, 0.02, 0.4, 0.71, 0.999])
def test_roots_of_guards_that_are_no_polynomials_are_as_exact(place):
    guards = Guards(
        lambda t: (
            (-math.tanh(1e4 * (t - place)), -1e4 / math.cosh(1e4 * (t - place)) ** 2)
            if abs(t - place) < 0.03
            else (-math.copysign(1.0, t - place), 0.0)
        ),
        lambda t: (-((t - place) ** 3), -3 * (t - place) ** 2),
        lambda t: (-math.expm1(40 * (t - place)), -40 * math.exp(40 * (t - place))),
    )
    found, looks = guards.falls([1.0] * 3, [False] * 3)
    assert found[[0, 2]] == pytest.approx([place] * 2, rel=1e-12, abs=1e-15)
    # At a triple root a correction is a third of what is missing.
    assert found[1] == pytest.approx(place, abs=3e-10)
    # Halves until Newton's method takes over: near a layer of 1e-4, at rounding, and soon.
    assert (looks <= [20, 56, 15]).all()


def test_the_first_guess_of_a_root_is_that_of_the_cubic_through_the_ends():
    rng = np.random.default_rng(1)
    roots = rng.uniform(0.0, 1.0, 1000)
    others = rng.uniform(0.0, 1.0, 1000), rng.uniform(1.0, 3.0, 1000)
    # -(t - root) ((t - re)^2 + im^2): it falls once.
    shapes = [
        np.poly1d(np.poly([root, re + 1j * im, re - 1j * im]).real) * -3.0
        for root, re, im in zip(roots, *others, strict=True)
    ]
    ends = [
        np.array([part(t) for part in (*shapes, *(shape.deriv() for shape in shapes))])
        for t in (0.0, 1.0)
    ]
    (low, low_rate), (high, high_rate) = (end.reshape(2, -1) for end in ends)
    found = _hermite_root(low, low_rate, high, high_rate)
    # Also where Newton's method is there before its last step.
    assert np.max(np.abs(found - roots)) < 1e-14


@pytest.mark.parametrize("size", [1e-3, 1.0, 100.0])
def test_a_jump_is_halved_down_to_rounding_and_no_further(size):
    place = 0.71 * size
    found, looks = Guards(lambda t: (1.0 if t < place else -1.0, 0.0)).falls([size], [False])
    assert found == pytest.approx([place], rel=1e-15)
    # One in the middle, seven eighths, and 47 halves from an eighth of the step to its rounding.
    assert looks[0] <= 8 + 51
