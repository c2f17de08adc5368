"""Which pieces a curve is passed in, for pieces that do as they are told to; and whether to try."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from tests.support.mechanisms import fading_ball
from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import radau_nodes
from zeno_orbits.model import CharacteristicScales, HybridDynamics
from zeno_orbits.simulation import TailEstimate, ZenoLimit
from zeno_orbits.simulation.zeno import zeno_passage
from zeno_orbits.simulation.zeno.impact_curve import (
    CurveEnd,
    CurveLostError,
    CurvePiece,
    ImpactCurve,
    straight_piece,
)
from zeno_orbits.simulation.zeno.zeno_passage import CurveStep, is_settled, pass_through

TOLERANCE = 1e-12
EPS = 2.0**-52
WEIGHT = 10.0
FEW, SOME, MANY = 4, 8, 16


def _always(value: float) -> Callable[[float], float]:
    return lambda _: value


SMOOTH, STILL = _always(1e-7), _always(0.0)


@dataclass(kw_only=True)
class _Script:
    """What pieces do; by default one of eight nodes passes the whole curve.

    Attributes:
        few: Changes of the iterations with few nodes.
        some: First change with eight nodes, by the length of the piece.
        many: The same with sixteen.
        error: Correction of a converged piece, by its nodes and its length.
        rest: What is left of its iterations.
        fastest: Decay for a unit of speed, by the speed at the start.
        fall: Of the speed, in a flight.
        rate: Slope of the clock along the curve.
        first_flights: Flights that the start of a piece costs.
        iterations: Nodes and lengths of all iterations.
        guesses: Slopes of the straight lines that pieces begin as.
        starts: Points and speeds at which pieces start.
    """

    few: tuple[float, ...] = (0.5, 1e-4)
    some: Callable[[float], float] = SMOOTH
    many: Callable[[float], float] = SMOOTH
    error: Callable[[int, float], float] = lambda _n, _length: 1e-13
    rest: float = 0.0
    fastest: Callable[[float], float] = STILL
    fall: float = 1e-6
    rate: float = 0.25
    first_flights: int = 0
    iterations: list[tuple[int, float]] = field(default_factory=list[tuple[int, float]])
    guesses: list[float] = field(default_factory=list[float])
    starts: list[tuple[list[float], float]] = field(default_factory=list[tuple[list[float], float]])

    @property
    def slope(self) -> Vector:
        """Of the curve: the clock goes on, and so does the time."""
        return np.array([0.0, self.rate, 0.0, 0.0, 0.5])

    def start_at(self, curve: ImpactCurve, z: Vector, w: float) -> CurveEnd:
        curve.n_flights += self.first_flights
        self.starts.append((z.tolist(), w))
        derivative = np.zeros((5, 1))
        derivative[1] = -self.fastest(w)
        basis = np.eye(4)[:, 1:2]
        return CurveEnd(
            z=z, w=w, basis=basis, slope=self.slope, fall=self.fall, derivative=derivative
        )

    def straight_piece(self, start: CurveEnd, length: float, n: int, slope: Vector) -> CurvePiece:
        assert n == FEW
        self.guesses.append(float(slope[1]))
        return straight_piece(start, length, n, slope)

    def iterated(self, curve: ImpactCurve, piece: CurvePiece) -> CurvePiece:
        del curve
        n, done = len(piece.slopes), len(piece.changes)
        self.iterations.append((n, piece.length))
        if n == FEW:
            change = self.few[done]
        else:
            change = (self.some if n == SOME else self.many)(piece.length) / 10**done
        return replace(piece, slopes=np.tile(self.slope, (n, 1)), changes=(*piece.changes, change))

    def differentiated(self, curve: ImpactCurve, piece: CurvePiece) -> CurvePiece:
        assert len(piece.changes) == 1
        return self.iterated(curve, piece)

    def converged(self, curve: ImpactCurve, piece: CurvePiece, tolerance: float) -> CurvePiece:
        del curve, tolerance
        return replace(piece, changes=(self.rest,))

    def correction(self, curve: ImpactCurve, piece: CurvePiece) -> Vector:
        del curve
        return np.array([self.error(len(piece.slopes), piece.length), 0.0, 0.0, 0.0, 0.0])

    def nodes(self) -> list[int]:
        """Return the nodes of all iterations."""
        return [n for n, _ in self.iterations]

    def tried(self) -> list[float]:
        """Return the lengths that were tried, each once."""
        lengths = [length for _, length in self.iterations]
        return [a for a, b in zip(lengths, [math.nan, *lengths[:-1]], strict=True) if a != b]


Passing = Callable[..., ZenoLimit | None]


@pytest.fixture(name="passing")
def _passing(monkeypatch: pytest.MonkeyPatch) -> Passing:
    def passing(
        script: _Script,
        *,
        restitution: float = 0.0,
        tolerance: float = TOLERANCE,
        dynamics: HybridDynamics | None = None,
        most_flights: int = 1000,
    ) -> ZenoLimit | None:
        for name in (
            "start_at",
            "straight_piece",
            "iterated",
            "differentiated",
            "converged",
            "correction",
        ):
            monkeypatch.setattr(zeno_passage, name, getattr(script, name))
        return pass_through(
            dynamics or fading_ball(WEIGHT, 0.0, restitution),
            lambda _x, _w: None,
            3.0,
            np.array([0.0, 0.0, 0.0, 1.0]),
            1.0,
            tolerance,
            most_flights=most_flights,
        )

    return passing


def _lengths(limit: ZenoLimit | None) -> list[float]:
    assert limit is not None
    steps = [step for step in limit.path if isinstance(step, CurveStep)]
    return [step.piece.length for step in steps]


def test_a_smooth_curve_is_one_piece_of_eight_nodes(passing: Passing) -> None:
    script = _Script()
    limit = passing(script)
    assert limit is not None
    assert _lengths(limit) == [1.0]
    # Four nodes tell the shape, in an iteration and one with derivatives.
    assert script.nodes() == [FEW, FEW, SOME]
    assert limit.time == 3.5
    assert limit.state == pytest.approx([0.0, 0.25, 0.0, 1.0], abs=1e-15)
    # Rounding of a limit at e = 0, and twice the correction.
    assert limit.error == pytest.approx(16 * EPS + 2e-13, rel=1e-12)


@pytest.mark.parametrize(
    ("few", "n"),
    [
        # What is left is at most a thousandth.
        ((1e-3, 1e-3), 2),
        ((1.5e-3, 1.5e-3, 1e-6), 3),
        ((1.0, 0.5, 0.4, 1e-4), 4),
        ((1e-3, 1.2e-3, 1.5e-3, 1e-3), 4),
    ],
)
def test_four_nodes_are_iterated_until_the_shape_is_seen(
    passing: Passing, few: tuple[float, ...], n: int
) -> None:
    script = _Script(few=few)
    assert _lengths(passing(script)) == [1.0]
    assert script.nodes() == [FEW] * n + [SOME]


def test_a_shape_that_four_iterations_do_not_see_is_looked_for_in_a_quarter(
    passing: Passing,
) -> None:
    script = _Script(few=(1.0, 0.5, 0.4, 0.3), fall=1 / 64)
    assert passing(script) is None
    assert script.tried() == [1.0, 0.25]


@pytest.mark.parametrize(
    ("shape", "nodes"),
    [
        # Newton's method squares what eight nodes changed first: 1e-14 is the tolerance times 100.
        (0.99e-6, [SOME]),
        (1e-6, [SOME]),
        (1.001e-6, [SOME, MANY]),
        (0.99e-5, [SOME, MANY]),
        (3e-5 / 3, [SOME, MANY]),
        # One more iteration where sixteen nodes would begin too far off.
        (1.01e-5, [SOME, SOME, MANY]),
        (2.9e-3, [SOME, SOME, MANY]),
    ],
)
def test_more_nodes_are_taken_where_eight_will_not_do(
    passing: Passing, shape: float, nodes: list[int]
) -> None:
    script = _Script(some=_always(shape), error=lambda _n, _length: 1e-17)
    # Of 1e-16 nothing is asked at e = 0 but 32 eps, some 7e-15: the rounding of the limit.
    assert _lengths(passing(script, tolerance=1e-14)) == [1.0]
    assert script.nodes() == [FEW, FEW, *nodes]


@pytest.mark.parametrize(
    ("error", "rest", "nodes"),
    [
        (TOLERANCE, 0.0, [SOME]),
        (1.01 * TOLERANCE, 0.0, [SOME, MANY]),
        # What the iterations left counts, too.
        (0.6 * TOLERANCE, 0.3 * TOLERANCE, [SOME]),
        (0.6 * TOLERANCE, 0.5 * TOLERANCE, [SOME, MANY]),
    ],
)
def test_more_nodes_are_taken_where_the_error_at_eight_is_too_large(
    passing: Passing, error: float, rest: float, nodes: list[int]
) -> None:
    script = _Script(error=lambda n, _length: error if n == SOME else 1e-13, rest=rest)
    assert _lengths(passing(script)) == [1.0]
    assert script.nodes() == [FEW, FEW, *nodes]


@pytest.mark.parametrize(
    ("shape", "part"),
    [
        (1e-3 * 2**6, 0.5),
        # Errors fall with the sixth power of the length; it falls by a sensible part.
        (1e-3 * 4**6, 0.25),
        (3.1e-3, 0.6),
        (1e-3 * 11**6, 0.1),
    ],
)
def test_a_piece_that_eight_nodes_do_not_fit_is_shortened(
    passing: Passing, shape: float, part: float
) -> None:
    script = _Script(some=lambda length: shape if length == 1.0 else 1e-7)
    lengths = _lengths(passing(script))
    assert lengths == pytest.approx([part, 1 - part], rel=1e-12)
    assert script.nodes()[:3] == [FEW, FEW, SOME]
    assert MANY not in script.nodes()


@pytest.mark.parametrize(
    ("change", "part"), [(3e-6 * 2**6, 0.5), (3.1e-5, 0.6), (2.9e-5, 1.0), (3e-6 * 4**6, 0.25)]
)
def test_a_piece_that_sixteen_nodes_do_not_fit_is_shortened(
    passing: Passing, change: float, part: float
) -> None:
    script = _Script(
        some=lambda length: 1e-4 if length == 1.0 else 1e-7,
        many=lambda length: change if length == 1.0 else 1e-7,
    )
    assert _lengths(passing(script))[0] == pytest.approx(part, rel=1e-12)


def test_a_piece_that_sixteen_nodes_do_not_begin_to_fit_may_begin_in_a_layer(
    passing: Passing,
) -> None:
    script = _Script(
        some=_always(1e-4),
        many=lambda length: 3e-6 * 2**6 if length == 1.0 else 1e-7,
        fastest=_always(100.0),
    )
    assert _lengths(passing(script))[0] == pytest.approx(0.06, rel=1e-12)


@pytest.mark.parametrize(("times", "part"), [(2**6, 0.5), (4**6, 0.25), (1.01, 0.6), (1.0, 1.0)])
def test_a_piece_whose_error_at_sixteen_nodes_is_too_large_is_shortened(
    passing: Passing, times: float, part: float
) -> None:
    # However fast neighbouring curves approach: it is no layer that sixteen nodes resolve.
    script = _Script(
        error=lambda _n, length: times * TOLERANCE if length == 1.0 else 1e-13,
        fastest=_always(100.0),
    )
    limit = passing(script)
    assert _lengths(limit)[0] == pytest.approx(part, rel=1e-12)


def test_every_piece_starts_at_the_corrected_end_of_the_one_before(passing: Passing) -> None:
    script = _Script(
        some=lambda length: 1e-3 * 2**6 if length == 1.0 else 1e-7,
        error=lambda _n, _length: 0.5e-12,
    )
    limit = passing(script)
    assert limit is not None
    assert [w for _, w in script.starts] == pytest.approx([1.0, 0.5], rel=1e-14)
    assert script.starts[0][0] == [0.0, 0.0, 0.0, 1.0, 0.0]
    assert script.starts[1][0][0] == 0.5e-12
    assert script.starts[1][0][1:] == pytest.approx([0.125, 0.0, 1.0, 0.25], abs=1e-15)
    assert limit.time == 3.5
    # Two pieces, each twice its correction.
    assert limit.error == pytest.approx(16 * EPS + 2e-12, rel=1e-12)


def test_no_smaller_error_is_asked_for_than_rounding_leaves(passing: Passing) -> None:
    # 32 eps / (1 - e) at e = 0.75.
    allowed = 2.0**7 * EPS
    for error, nodes in ((0.99 * allowed, [SOME]), (1.01 * allowed, [SOME, MANY])):
        script = _Script(error=lambda n, _length, error=error: error if n == SOME else 1e-15)
        limit = passing(script, restitution=0.75, tolerance=1e-15)
        assert limit is not None
        assert script.nodes()[2:] == nodes
        assert limit.error > 64 * EPS


# Layers.


def _rough_if_longer(than: float) -> Callable[[float], float]:
    return lambda length: 1e-3 * 2**6 if length > than else 1e-7


def test_a_layer_is_passed_in_pieces_that_grow_with_its_decay(passing: Passing) -> None:
    script = _Script(some=_rough_if_longer(0.9), fastest=_always(100.0))
    # Six powers of e first; then 5.4 more for every decade that it has decayed: 6 / ln 10 are 2.6.
    second = (6 + 5.4 * 6 / math.log(10)) / 100
    # It is behind after 8 decades: here after (6 + 20) / ln 10, 11.3 of them.
    expected = [0.06, second, 1 - 0.06 - second]
    assert _lengths(passing(script)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("fastest", "second"), [(20.0, 0.5), (20.1, 6 / 20.1), (30.0, 0.2)])
def test_a_layer_is_suspected_where_neighbours_approach_fast_along_the_piece(
    passing: Passing, fastest: float, second: float
) -> None:
    script = _Script(some=_rough_if_longer(0.9), fastest=_always(fastest))
    passing(script)
    assert script.tried()[:2] == pytest.approx([1.0, second], rel=1e-12)


def test_a_layer_that_is_known_is_not_begun_again(passing: Passing) -> None:
    second = (6 + 5.4 * 6 / math.log(10)) / 100
    assert 100 * second > 20.0
    script = _Script(
        some=lambda length: (
            1e-3 * 2**6 if length > 0.9 or length == pytest.approx(second) else 1e-7
        ),
        fastest=_always(100.0),
    )
    passing(script)
    assert script.tried()[:4] == pytest.approx([1.0, 0.06, second, second / 2], rel=1e-9)


def test_a_layer_that_is_gone_allows_any_length(passing: Passing) -> None:
    script = _Script(some=_rough_if_longer(0.95), fastest=lambda w: 100.0 if w == 1.0 else 0.0)
    assert _lengths(passing(script)) == pytest.approx([0.06, 0.94], rel=1e-12)


@pytest.mark.parametrize(("fastest", "second"), [(0.0, 0.25), (100.0, 0.06)])
def test_a_piece_that_is_lost_is_tried_again_in_a_quarter_or_as_a_layer(
    passing: Passing, fastest: float, second: float
) -> None:
    def lost(length: float) -> float:
        if length == 1.0:
            raise CurveLostError
        return 1e-7

    script = _Script(some=lost, fastest=_always(fastest))
    passing(script)
    assert script.tried()[:2] == pytest.approx([1.0, second], rel=1e-12)


def test_a_short_piece_along_which_little_decays_is_in_no_layer(passing: Passing) -> None:
    def lost(length: float) -> float:
        if length in (1.0, 0.25):
            raise CurveLostError
        return 1e-7

    # Neighbours approach by 18 along the whole, and by 4.5 along a quarter.
    script = _Script(some=lost, fastest=_always(18.0))
    assert _lengths(passing(script)) == [0.0625, 0.9375]


# Where it is given up.


@pytest.mark.parametrize(("fall", "passes"), [(1 / 16, True), (1 / 15.9, False)])
def test_a_piece_passes_sixteen_impacts_or_none(
    passing: Passing, fall: float, passes: bool
) -> None:
    script = _Script(fall=fall)
    assert (passing(script) is not None) is passes
    assert bool(script.iterations) is passes


@pytest.mark.parametrize(("most", "passes"), [(8, True), (7, False)])
def test_no_piece_is_tried_when_the_flights_are_used_up(
    passing: Passing, most: int, passes: bool
) -> None:
    script = _Script(first_flights=7)
    assert (passing(script, most_flights=most) is not None) is passes


@pytest.mark.parametrize(("last", "passes"), [(0.4**7, True), (0.4**8, False)])
def test_eight_pieces_reach_the_end_of_a_curve_or_none_do(
    passing: Passing, last: float, passes: bool
) -> None:
    speeds: list[float] = []

    def fastest(w: float) -> float:
        speeds.append(w)
        return 0.0

    # 0.6 of what is left passes, and all of it at last.
    script = _Script(
        error=lambda _n, length: (
            1e-13 if length < 0.7 * speeds[-1] or speeds[-1] < 1.01 * last else 1.01 * TOLERANCE
        ),
        fastest=fastest,
    )
    limit = passing(script)
    assert (limit is not None) is passes
    if limit is not None:
        expected = [*(0.6 * 0.4**k for k in range(7)), 0.4**7]
        assert _lengths(limit) == pytest.approx(expected, rel=1e-9)
    assert len(script.starts) == 8


@pytest.mark.parametrize(("lift", "passes"), [(0.0, False), (0.5, False), (-1e-9, True)])
def test_an_end_where_the_stop_no_longer_holds_is_no_zeno_point(
    passing: Passing, lift: float, passes: bool
) -> None:

    def acceleration(x: Vector) -> float:
        return lift if x[1] > 0.2 else -WEIGHT

    dynamics = replace(fading_ball(WEIGHT, 0.0, 0.0), gap_acceleration=acceleration)
    assert (passing(_Script(), dynamics=dynamics) is not None) is passes


@pytest.mark.parametrize(
    ("rate", "straight"), [(4.9, True), (5.0, False), (-9.9, True), (-10.0, False), (0.0, True)]
)
def test_a_line_along_which_the_weight_halves_or_doubles_is_no_first_guess(
    passing: Passing, rate: float, straight: bool
) -> None:
    script = _Script(rate=rate)
    passing(script, dynamics=fading_ball(WEIGHT, 1.0, 0.0))
    assert script.guesses[0] == (rate if straight else 0.0)


# A piece along time.


def test_a_piece_is_read_along_its_time() -> None:
    own = CharacteristicScales(time=4.0, sizes=(2.0, 1.0, 1.0, 0.5))
    dynamics = replace(fading_ball(WEIGHT, 0.0, 0.9), scaling=lambda: own)
    curve = ImpactCurve(dynamics, lambda _x, _w: None, 0)
    z = np.array([1.0, -2.0, 3.0, 4.0, 0.25])
    start = CurveEnd(
        z=z,
        w=1.0,
        basis=np.eye(4)[:, :1],
        slope=np.zeros(5),
        fall=0.1,
        derivative=np.zeros((5, 1)),
    )
    places = radau_nodes(4).places
    # In the part u of the length 0.5: the time goes as u - 0.45 u^2, the states as u^2 and u.
    slopes = np.stack([2 * places, places**0, 0 * places, 4 * places, 1 - 0.9 * places], axis=1)
    piece = replace(straight_piece(start, 0.5, 4, np.zeros(5)), slopes=slopes)
    missed = np.array([0.0, 0.01, 0.0, 0.0, 0.03])
    step = CurveStep(curve=curve, piece=piece, missed=missed)

    def point(u: float) -> Vector:
        along = np.array([u**2, u, 0.0, 2 * u**2, u - 0.45 * u**2])
        return z + 0.5 * along + u * missed

    sizes = np.array([2.0, 1.0, 1.0, 0.5])
    assert step.end == pytest.approx(point(1.0), abs=1e-14)
    assert step.start == 1.0
    assert step.size == pytest.approx(4 * (point(1.0)[4] - 0.25), rel=1e-14)
    assert step.before.tolist() == [2.0, -2.0, 3.0, 2.0]
    assert step.after == pytest.approx(sizes * point(1.0)[:4], abs=1e-14)
    for outside in (0.0, -0.1):
        assert step.state_at(outside).tolist() == step.before.tolist()
    for outside in (step.size, step.size + 0.1):
        assert step.state_at(outside).tolist() == step.after.tolist()
    for u in (0.1, 0.5, 0.9):
        offset = 4 * (point(u)[4] - 0.25)
        assert step.state_at(offset) == pytest.approx(sizes * point(u)[:4], abs=1e-13)
        assert step.end_at(offset).tolist() == step.state_at(offset).tolist()


# Whether a curve is worth a try.


def _impacts(before: float, now: float, *, first: tuple[float, ...] = ()) -> list[TailEstimate]:
    """Return impacts whose last two fourth differences are such parts of 1 and the last state."""
    last = now / (1 - now)
    states = (*first, before * (1 + last), 0.0, 0.0, 0.0, 0.0, last)
    return [
        TailEstimate(
            impact_time=0.0,
            resting=np.array([x, 1.0]),
            speed=1.0,
            time=0.0,
            state=np.zeros(2),
            gap_acceleration=-1.0,
        )
        for x in states
    ]


@pytest.mark.parametrize(
    ("restitution", "now", "settled"),
    [
        # A hundredth of (1 - e)^4, or rounding.
        (0.9, 0.99e-6, True),
        (0.9, 1.01e-6, False),
        (1 - 1e-5, 2.9e-14, True),
        (1 - 1e-5, 3.1e-14, False),
    ],
)
def test_impacts_have_settled_where_fourth_differences_are_smooth_or_rounding(
    restitution: float, now: float, settled: bool
) -> None:
    assert is_settled(_impacts(0.3, now), restitution) is settled
    # Earlier impacts do not count.
    assert is_settled(_impacts(0.3, now, first=(5.0, -7.0)), restitution) is settled


def test_differences_that_do_not_fall_are_no_transient() -> None:
    assert is_settled(_impacts(0.25, 0.25), 0.9)
    assert is_settled(_impacts(0.25, 0.3), 0.9)


@pytest.mark.parametrize(("impacts", "settled"), [(149.5, False), (150.5, True)])
@pytest.mark.parametrize("ratio", [0.8, 0.85])
def test_a_transient_is_waited_for_if_it_is_over_in_150_impacts(
    ratio: float, impacts: float, settled: bool
) -> None:
    # An amplitude that falls to 1e-12 by the ratio, and its fourth difference.
    amplitude = 1e-12 * ratio**-impacts
    now = amplitude * (1 - ratio) ** 4
    assert is_settled(_impacts(now / ratio, now), 0.9) is settled
