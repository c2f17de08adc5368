"""What bounds and objectives add to the program of an orbit, on arcs made by hand."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.support.hand_made import SCALE, SCHEME, Course, K, course, hand_made, rows_of
from zeno_orbits.arrays import Array, Vector
from zeno_orbits.errors import InputError
from zeno_orbits.orbits import Bound
from zeno_orbits.search import (
    MaxMargin,
    MinEnergy,
    MinPeak,
    MinSpectralRadius,
    NearestGains,
    Objective,
    TargetAmplitude,
    TargetPeriod,
)
from zeno_orbits.search.objectives import TowardTarget
from zeno_orbits.search.transcription.constraints import (
    extreme,
    inside,
    keep,
    largest,
    quantity_terms,
    smallest_share,
)
from zeno_orbits.search.transcription.mesh import stage_fractions
from zeno_orbits.search.transcription.nearness import Nearness
from zeno_orbits.simulation import Extent, signal

EXACT = 1e-12
POLISHED = 1e-9
"""A peak is looked for until its place is known so well, in parts of its arc."""

# Highest where 2 s^2 - 4 s + 7 / 4 = 0: at 1 - 1 / sqrt(8).
HILL = course((0.0, 5.25, -6.0, 2.0), (1.0, 0.0, -3.0, 0.0))
VALLEY = course((-1.0, -4.0, 4.0), (0.25, 0.0, 0.0, 0.5), duration=0.5)
RISE = course((0.5, 1.0), (2.0, -1.0), duration=3.0)


def _values(terms: Any, *expressions: Any) -> list[float]:
    return [float(terms.guessed(expression)[0, 0]) for expression in expressions]


def _columns(*guesses: Course) -> Array:
    """Return the states at starts and stages of arcs on the usual mesh, ``(2, n)``."""
    fractions = [0.0, *stage_fractions(np.array([0.0, 0.25, 1.0]), SCHEME)]
    return np.array([guess.at(float(s)) for guess in guesses for s in fractions]).T


# Places inside of an arc.


@pytest.mark.parametrize(
    ("fraction", "interval"),
    [(0.0, 0), (0.1, 0), (0.25, 0), (0.3, 1), (0.5, 1), (0.51, 2), (0.99, 2), (1.0, 2)],
)
def test_a_state_inside_is_that_of_the_polynomial_of_its_own_interval(
    fraction: float, interval: int
) -> None:
    made = hand_made()
    mesh = np.array([0.0, 0.25, 0.5, 1.0])
    arc = made.arc("arc", RISE, mesh)
    # No one polynomial goes through stages like these.
    states = np.random.default_rng(1).normal(size=(3, 10))
    stages, start = ca.MX(ca.DM(states[:, 1:])), ca.MX(ca.DM(states[:, 0]))
    found = made.program.at_guess(
        inside(made.terms(), replace(arc, stages=stages, start=start), fraction)
    )
    points = np.concatenate([[0.0], SCHEME.nodes])
    own = states[:, 3 * interval : 3 * interval + 4]
    at = (fraction - mesh[interval]) / (mesh[interval + 1] - mesh[interval])
    expected = [np.polynomial.Polynomial.fit(points, row, 3)(at) for row in own]
    assert found.full().ravel() == pytest.approx(expected, abs=EXACT)


# Largest values.


def test_the_largest_value_is_held_at_starts_stages_and_peaks_of_both_signs() -> None:
    made = hand_made()
    terms = made.terms(made.phase("", HILL, VALLEY))
    most = largest(terms, signal(terms.compiled, "x"), terms.arcs, "peak")
    # The valley is twice as deep as it begins, and deeper than the hill is high.
    size = 2.0
    assert _values(terms, most) == pytest.approx([1.001 * size])
    x = _columns(HILL, VALLEY)[0]
    peaks = [_top(HILL), -2.0]
    held = np.concatenate([x[:7], peaks[:1], x[7:], peaks[1:]])
    rows = rows_of(made.program)
    assert list(rows) == ["peak: not above it", "peak: not below minus it"]
    for name, sign in (("peak: not above it", -1.0), ("peak: not below minus it", 1.0)):
        expected = (1.001 * size + sign * held) / size
        assert sorted(rows[name]) == pytest.approx(sorted(expected), abs=POLISHED)
    built = made.program.build()
    place = built.names["peak"][0]
    assert (built.lower[place], built.scales[place]) == (0.0, size)


def _top(guess: Course) -> float:
    """Return the highest value of the first state inside of an arc."""
    curve = guess.curves[0]
    roots = [float(r.real) for r in curve.deriv().roots() if 0.0 < r.real < 1.0]
    return max(float(curve(root)) for root in roots)


def test_only_the_arcs_that_count_are_held_and_a_signal_of_zero_has_a_size() -> None:
    made = hand_made()
    terms = made.terms(made.phase("", HILL, course((0.0,), (0.0,))))
    most = largest(terms, signal(terms.compiled, "voltage"), terms.arcs[1:], "peak")
    assert _values(terms, most) == pytest.approx([1.001])
    assert {len(row) for row in rows_of(made.program).values()} == {7}


# Extremes.


def _orbit(*guesses: Course) -> tuple[Any, Any]:
    made = hand_made()
    return made, made.terms(*(made.phase(f"{k}", guess) for k, guess in enumerate(guesses)))


def test_the_highest_place_inside_is_an_unknown_where_the_rate_vanishes() -> None:
    shifted = course((3.0, 5.25, -6.0, 2.0), (0.0,))
    made, terms = _orbit(RISE, shifted)
    height = extreme(terms, 0, 1.0)
    assert _values(terms, height) == pytest.approx([3.0 + _top(HILL)], abs=EXACT)
    built = made.program.build()
    place, _ = built.names["place where x is highest"]
    assert place == built.unknowns.numel() - 1
    assert (built.lower[place], built.upper[place]) == (-0.5, 1.5)
    at_top = min(r.real for r in HILL.curves[0].deriv().roots())
    # The last three quarters of the arc are its second interval.
    assert built.guess[place] == pytest.approx((at_top - 0.25) / 0.75, abs=1e-6)
    rows = ca.Function("rows", [built.unknowns], [built.rows])
    assert built.row_names == ("x is highest there",)
    assert float(rows(built.guess)) == pytest.approx(0.0, abs=1e-6)
    elsewhere = built.guess.copy()
    elsewhere[place] = 1.0
    slope = 0.75 * HILL.curves[0].deriv()(1.0) / SCALE[0]
    assert float(rows(elsewhere)) == pytest.approx(slope, abs=EXACT)


def test_the_lowest_place_has_its_own_name_and_state() -> None:
    made, terms = _orbit(RISE, VALLEY, course((0.0,), (3.0, -16.0, 16.0)))
    assert _values(terms, extreme(terms, 0, -1.0)) == pytest.approx([-2.0], abs=EXACT)
    assert _values(terms, extreme(terms, 1, -1.0)) == pytest.approx([-1.0], abs=EXACT)
    assert list(rows_of(made.program)) == ["x is lowest there", "v is lowest there"]


def test_an_extreme_at_an_impact_is_a_node() -> None:
    made, terms = _orbit(RISE, course((1.0, -3.0), (0.0, 1.0)))
    heights = [extreme(terms, 0, 1.0), extreme(terms, 0, -1.0), extreme(terms, 1, 1.0)]
    assert _values(terms, *heights) == pytest.approx([1.5, -2.0, 2.0], abs=EXACT)
    assert made.program.equations == ()
    arcs = terms.arcs
    nodes = [arcs[0].end[0], arcs[1].end[0], arcs[0].start[1]]
    unknowns = ca.vertcat(*(block.symbol for block in made.program.blocks))
    for height, node in zip(heights, nodes, strict=True):
        slopes = [ca.jacobian(one, unknowns) for one in (height, node)]
        one, other = (made.program.at_guess(slope).full() for slope in slopes)
        assert np.array_equal(one, other)


# Numbers of the whole orbit.


def _two_phases() -> tuple[Any, Any]:
    made = hand_made()
    first = made.phase("phase 1: ", HILL, VALLEY, approach_rate=-3.0)
    second = made.phase("phase 2: ", course((0.25, 1.0), (1.5, 0.0)), RISE, approach_rate=-0.5)
    return made, made.terms(first, second)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("period", [8.0]),
        ("energy", [-20.0]),
        ("first_impact_speed", [3.0, 0.5]),
        ("locked_time", [0.5, 3.0]),
        # k + x at the Zeno points.
        ("gap_acceleration", [K - 1.0, K + 0.5]),
    ],
)
def test_a_number_of_the_orbit_has_a_value_a_phase(name: str, expected: list[float]) -> None:
    _, terms = _two_phases()
    assert _values(terms, *quantity_terms(terms, name)) == pytest.approx(expected, abs=EXACT)


def test_the_stop_lets_go_where_the_next_phase_starts() -> None:
    made = hand_made()
    starts = [1.0, 1.5, 0.5]
    terms = made.terms(
        *(made.phase(f"phase {k}: ", course((0.0,), (v,)), VALLEY) for k, v in enumerate(starts))
    )
    # Its multiplier falls with k - v; after the last phase the first follows.
    expected = [K - 1.5, K - 0.5, K - 1.0]
    assert _values(terms, *quantity_terms(terms, "release_rate")) == pytest.approx(expected)


def test_a_phase_that_does_not_hold_has_no_number_of_the_stop() -> None:
    made = hand_made()
    impact = made.phase("phase 1: ", RISE, approach_rate=-2.0)
    terms = made.terms(impact, made.phase("phase 2: ", HILL, VALLEY))
    assert _values(terms, *quantity_terms(terms, "locked_time")) == [0.5]
    assert _values(terms, *quantity_terms(terms, "gap_acceleration")) == [K - 1.0]
    assert _values(terms, *quantity_terms(terms, "first_impact_speed")) == [2.0, 3.0]
    alone = made.terms(impact)
    with pytest.raises(InputError, match=r"shape `impact`, but it names `locked_time`"):
        quantity_terms(alone, "locked_time")


def test_the_smallest_share_is_below_that_of_every_margin() -> None:
    made, terms = _two_phases()
    assert _values(terms, *quantity_terms(terms, "margin")) == [0.1]
    rows = {name: row for name, row in rows_of(made.program).items() if "margin:" in name}

    # Beside the speed of the first impact its flight, beside the pull of the stop the locked arc.
    def most(values: Vector) -> float:
        return 1.001 * float(np.max(np.abs(values)))

    first, second = RISE.curves[0](np.linspace(0, 1, 3)), _columns(VALLEY)[0]
    expected = {
        "margin: phase 1: speed of the first impact": 3.0 / most(_columns(HILL)[1]),
        "margin: phase 1: d2h/dt2 at the Zeno point": (K - 1.0) / most(-K - second),
        "margin: phase 1: locked arc": 0.5 / 8.0,
        "margin: phase 2: speed of the first impact": 0.5 / most(np.array([1.5])),
        "margin: phase 2: d2h/dt2 at the Zeno point": (K + 0.5) / most(-K - first),
        "margin: phase 2: locked arc": 3.0 / 8.0,
    }
    assert list(rows) == list(expected)
    for name, value in expected.items():
        assert rows[name] == pytest.approx([value - 0.1], abs=POLISHED), name
    built = made.program.build()
    place = built.names["smallest margin"][0]
    assert (built.lower[place], built.upper[place]) == (-1.0, 1.0)
    unknowns = [name for name in built.names if name.startswith("largest value near the phase")]
    assert len(unknowns) == 4


def test_the_share_of_an_orbit_that_the_stop_never_holds_is_that_of_its_speeds() -> None:
    made = hand_made()
    smallest_share(made.terms(made.phase("", RISE)))
    assert [name for name in rows_of(made.program) if name.startswith("margin")] == [
        "margin: speed of the first impact"
    ]


# Bounds.


def test_a_signal_is_held_at_both_ends_in_units_of_its_size() -> None:
    made = hand_made()
    terms = made.terms(made.phase("", HILL))
    bound = Bound(name="current", lower=-3.0, upper=2.0)
    size = keep(terms, bound, slack=0.5)
    assert size == 3.0
    values = np.append(K * _columns(HILL)[0], K * _top(HILL))
    rows = rows_of(made.program)
    assert list(rows) == ["current >= -3", "current <= 2"]
    above, below = (values + 3.0) / size + 0.5, (2.0 - values) / size + 0.5
    assert sorted(rows["current >= -3"]) == pytest.approx(sorted(above), abs=POLISHED)
    assert sorted(rows["current <= 2"]) == pytest.approx(sorted(below), abs=POLISHED)


@pytest.mark.parametrize(
    ("bound", "row", "size"),
    [
        (Bound(name="v", upper=1.0), "v <= 1", 2.0),
        (Bound(name="v", lower=-0.5), "v >= -0.5", 2.0),
        (Bound(name="period", lower=5.0), "period >= 5", 8.0),
        (Bound(name="energy", upper=30.0), "energy <= 30", 30.0),
    ],
)
def test_an_open_end_has_no_row(bound: Bound, row: str, size: float) -> None:
    made = hand_made()
    terms = made.terms(made.phase("", HILL))
    assert keep(terms, bound) == pytest.approx(size, abs=POLISHED)
    rows = rows_of(made.program)
    assert list(rows) == [row]
    # Without a slack no row is left any.
    expected = {"period >= 5": [3.0 / 8.0], "energy <= 30": [50.0 / 30.0]}
    assert rows[row] == pytest.approx(expected.get(row, rows[row]))


def test_a_quantity_of_zero_that_is_held_at_zero_has_a_size() -> None:
    made = hand_made()
    terms = made.terms(made.phase("", course((0.0,), (0.0,))))
    assert keep(terms, Bound(name="x", lower=0.0)) == 1.0
    assert keep(terms, Bound(name="x", lower=-1e-3, upper=0.0)) == 1e-3


def test_a_number_of_the_orbit_is_held_in_every_phase() -> None:
    made, terms = _two_phases()
    size = keep(terms, Bound(name="first_impact_speed", lower=1.0), slack=0.25)
    assert size == 3.0
    rows = rows_of(made.program)
    assert list(rows) == ["first_impact_speed >= 1"]
    assert rows["first_impact_speed >= 1"] == pytest.approx([2 / 3 + 0.25, -0.5 / 3 + 0.25])


def test_a_number_of_the_orbit_is_held_at_both_ends() -> None:
    made = hand_made()
    terms = made.terms(made.phase("", HILL, VALLEY))
    size = keep(terms, Bound(name="energy", lower=-22.0, upper=-10.0), slack=ca.MX(0.125))
    assert size == 22.0
    rows = rows_of(made.program)
    assert list(rows) == ["energy >= -22", "energy <= -10"]
    assert rows["energy >= -22"] == pytest.approx([2 / 22 + 0.125])
    assert rows["energy <= -10"] == pytest.approx([10 / 22 + 0.125])


def test_the_least_of_several_phases_is_not_bounded_from_above() -> None:
    _, terms = _two_phases()
    keep(terms, Bound(name="period", upper=9.0))
    wanted = r"bound `locked_time` from below only for the shape `zeno\*2`, but it has 0.1:2"
    with pytest.raises(InputError, match=wanted):
        keep(terms, Bound(name="locked_time", lower=0.1, upper=2.0))


# What objectives ask of a program and how they score, at terms made by hand.

FALL = course((0.5, -1.0), (2.0, -3.0))


def _made(
    objective: Objective, *flights: Course, free: Mapping[str, float] | None = None, **more: Any
) -> tuple[float, dict[str, list[float]], Any]:
    """Return an objective's cost in the guess, its rows there, and the program."""
    made = hand_made()
    unknown = {
        name: made.program.variable(f"free {name}", value)[0, 0]
        for name, value in (free or {"k": 2.0}).items()
    }
    phases = [made.phase(f"phase {k}: ", one) for k, one in enumerate(flights or (HILL,))]
    terms = made.terms(*phases, free=unknown)
    terms.nearness = Nearness(first={"k": 1.0, "r": 30.0}, sizes={"k": 0.5, "r": 10.0})
    for name, value in more.items():
        setattr(terms, name, value)
    cost = float(terms.guessed(ca.MX(objective.cost(terms)))[0, 0])
    return cost, rows_of(made.program), made.program.build()


NEAR = Nearness(first={"k": 1.0, "r": 30.0}, sizes={"k": 0.5, "r": 10.0})
EXTENTS = {"x": Extent(lowest=-3.0, highest=2.0), "energy": Extent(lowest=5.0, highest=6.0)}


def test_nearest_gains_cost_half_their_squared_distance_from_the_target_or_the_start() -> None:
    objective, free = NearestGains(target={"k": 5.0}), {"k": 2.0, "r": 50.0}
    # ((2 - 5) / 0.5)^2 / 2 + ((50 - 30) / 10)^2 / 2.
    cost, rows, _ = _made(objective, free=free)
    assert cost == pytest.approx(18.0 + 2.0)
    assert rows == {}
    assert objective.score(free, NEAR, {}) == pytest.approx(20.0)
    assert objective.goal == {"k": 5.0}
    assert objective.quantities == ()
    assert objective.least == -math.inf


def test_nothing_that_is_free_is_no_distance_away() -> None:
    assert NEAR.distance({}, {"k": 5.0}) == 0.0
    assert NEAR.distance({"k": 1.5}, {}) == pytest.approx(0.5)


def test_a_period_that_is_wanted_is_a_row_and_the_start_the_cost() -> None:
    objective = TargetPeriod(target=6.5)
    cost, rows, _ = _made(objective)
    assert cost == pytest.approx(2.0)
    assert rows == {"a period of 6.5 s": [1.5]}
    assert objective.score({"k": 2.0}, NEAR, {}) == pytest.approx(2.0)
    cycle: Any = SimpleNamespace(period=6.0)
    assert objective.measured(cycle) == 6.0
    assert objective.miss(cycle) == pytest.approx(0.5 / 6.5)
    longer: Any = SimpleNamespace(period=7.8)
    assert objective.miss(longer) == pytest.approx(0.2)


def test_an_amplitude_is_half_the_range_of_its_state_over_all_arcs() -> None:
    objective = TargetAmplitude(state="v", target=0.25)
    # Highest at the start of the second arc, lowest at the end of the first one.
    cost, rows, _ = _made(objective, HILL, course((0.0,), (2.0, -3.0)))
    assert cost == pytest.approx(2.0)
    assert rows["an amplitude of 0.25 of v"] == pytest.approx([(2.0 - -2.0) / 2 - 0.25])
    cycle: Any = SimpleNamespace(state_names=("x", "v"), arcs=(HILL, FALL))
    assert objective.measured(cycle) == pytest.approx(2.0, abs=1e-12)
    assert objective.miss(cycle) == pytest.approx(7.0)


def test_on_the_way_to_a_target_the_distance_from_it_is_the_cost() -> None:
    objective = TowardTarget(target=TargetPeriod(target=10.0))
    cost, rows, _ = _made(objective)
    assert cost == pytest.approx(((8.0 - 10.0) / 10.0) ** 2 / 2)
    assert rows == {}
    assert objective.wish == "a period of 10 s, or near it"


@pytest.mark.parametrize(("work", "cost"), [(-20.0, -1.0), (4.0, 1.0), (0.0, 0.0)])
def test_energy_costs_what_it_is_in_units_of_the_guess(work: float, cost: float) -> None:
    objective = MinEnergy()
    scaled = ca.MX(work)
    found, rows, _ = _made(objective, electrical_work=scaled)
    assert found == pytest.approx(cost)
    assert rows == {}
    assert objective.wish == "the least electrical energy per period"
    assert objective.quantities == ("energy",)
    assert objective.score({}, NEAR, EXTENTS) == 6.0


def test_a_peak_is_an_unknown_in_units_of_its_size_on_all_arcs() -> None:
    objective = MinPeak(signal="v")
    cost, rows, program = _made(objective, HILL, course((0.0,), (0.5, -3.0)))
    assert cost == pytest.approx(1.0)
    assert set(rows) == {"peak of v: not above it", "peak of v: not below minus it"}
    # At the end of the second arc v = -2.5: to the thousandth that the guess is larger.
    assert min(rows["peak of v: not below minus it"]) == pytest.approx(0.001)
    assert program.scales[program.names["peak of v"][0]] == pytest.approx(2.5)
    assert objective.wish == "the least peak of v"
    assert MinPeak(signal="x").score({}, NEAR, EXTENTS) == 3.0


def test_a_peak_that_is_not_there_costs_nothing() -> None:
    cost, _, _ = _made(MinPeak(signal="v"), course((1.0,), (0.0,)))
    # Where a signal vanishes its size is a convention, a unit of its own.
    assert cost == pytest.approx(1.0)


def test_a_radius_is_an_unknown_above_all_multipliers() -> None:
    objective = MinSpectralRadius()
    slope = ca.MX(ca.DM([[0.5, 1.0], [0.0, -0.25]]))
    cost, rows, program = _made(objective, return_slope=slope)
    radius = 1.01 * 0.5
    assert cost == pytest.approx(radius)
    place = program.names["spectral radius"][0]
    assert program.lower[place] == pytest.approx(1e-4)
    assert program.guess[place] == pytest.approx(radius)
    # The characteristic polynomial of A / rho at 1.
    above = (1 - 0.5 / radius) * (1 + 0.25 / radius)
    assert rows["real multipliers not above the spectral radius"] == pytest.approx([above])
    assert objective.wish == "the fastest contraction"
    assert objective.least == 1e-4
    assert objective.quantities == ("spectral_radius",)
    assert objective.rank(Extent(lowest=0.2, highest=0.3)) == 0.3
    assert objective.rank(Extent(lowest=0.0, highest=1e-9)) == 1e-4


def test_multipliers_that_vanish_leave_the_least_radius() -> None:
    cost, _, _ = _made(MinSpectralRadius(), return_slope=ca.MX(ca.DM([[1e-7]])))
    assert cost == pytest.approx(1.01e-4)


def test_a_contraction_without_a_return_map_is_a_mistake() -> None:
    with pytest.raises(ValueError, match="lacks the return map"):
        _made(MinSpectralRadius())


def test_a_margin_is_no_row_of_a_program() -> None:
    objective = MaxMargin()
    cost, rows, _ = _made(objective)
    # ((2 - 1) / 0.5)^2 / 2, the distance from the start.
    assert cost == pytest.approx(2.0)
    assert rows == {}
    assert objective.wish == "the widest margin to losing the orbit"
    assert objective.quantities == ("persistence",)
    extents = {"persistence": Extent(lowest=0.25, highest=0.25)}
    assert objective.score({}, NEAR, extents) == -0.25
    assert objective.least == -1.0


# Misuse.
