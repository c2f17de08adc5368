"""Newton's method on return maps that are made up: which steps it takes, and when it gives up."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from zeno_orbits.errors import SimulationError
from zeno_orbits.orbits import ONE_ZENO, EventSequence
from zeno_orbits.search import PeriodicCycle, cycle_near, newton_from_cycle, newton_on_return_map
from zeno_orbits.search.shooting import fixed_point
from zeno_orbits.simulation import SimulationSettings

SETTINGS = SimulationSettings()
TWICE = EventSequence.parsed("zeno*2")


def _failure(words: str = "It fails") -> SimulationError:
    return SimulationError(words, time=1.0, state=(1.0,))


@dataclass
class Map:
    """A return map on its section, whose slopes are what they are told to be.

    Attributes:
        image: The map.
        slope: What is told of its slope at a point.
        drift: Change of a period in units of its own size.
        starts: Where returns were asked for.
        slopes: Where slopes were.
    """

    image: Callable[[Any], Any]
    slope: Callable[[Any], Any]
    drift: float = 0.0
    starts: list[list[float]] = field(default_factory=list)
    slopes: list[list[float]] = field(default_factory=list)

    def cycle_of(self, _: Any, start: Any, shape: Any, *, horizon: float, settings: Any) -> Any:
        """Return a return."""
        assert (shape, horizon, settings) == (TWICE, 6.0, SETTINGS)
        self.starts.append(start.tolist())
        end = self.image(start)
        if end is None:
            raise _failure()
        return SimpleNamespace(
            start=SimpleNamespace(state=start),
            end=SimpleNamespace(state=np.asarray(end)),
            period=3.0,
            drift=lambda scale: self.drift if scale == "sizes" else np.nan,
            scale_at_events=lambda: "sizes",
        )

    def return_slope(self, _: Any, start: Any, **named: Any) -> Any:
        """Return a slope."""
        assert (named["period"], named["settings"], named["shape"]) == (3.0, SETTINGS, TWICE)
        assert named["scale"].tolist() == [1.0] * len(start)
        self.slopes.append(start.tolist())
        return np.asarray(self.slope(start))


@pytest.fixture(name="closed")
def _closed(monkeypatch: pytest.MonkeyPatch) -> Callable[..., PeriodicCycle]:
    """Close the period of a map from the origin of its section."""

    def closed(told: Map, n: int = 1, slope: Any = None) -> PeriodicCycle:
        section = SimpleNamespace(
            dimension=n, state=lambda _, at: np.array(at), coordinates=lambda x: x
        )
        monkeypatch.setattr(fixed_point, "section_around", lambda *_: section)
        monkeypatch.setattr(fixed_point, "place_on_section", lambda _machine, _shape, state: state)
        monkeypatch.setattr(fixed_point, "cycle_of", told.cycle_of)
        monkeypatch.setattr(fixed_point, "poincare_jacobian", told.return_slope)
        machine: Any = SimpleNamespace(restitution=0.5)
        return newton_on_return_map(
            machine,
            np.array([7.0, 8.0]),
            scale=np.ones(n),
            period=3.0,
            settings=SETTINGS,
            slope=slope,
            shape=TWICE,
        )

    return closed


def _linear(slope: float, told: float | None = None) -> Map:
    """Return a map that is off by 0.01 at the origin, and repeats at `0.01 / (1 - slope)`."""
    return Map(
        image=lambda y: slope * y + 0.01,
        slope=lambda _: [[slope if told is None else told]],
    )


def test_two_returns_tell_the_slope_of_a_line(closed: Any) -> None:
    told = _linear(0.4)
    found = closed(told)
    assert (found.returns, told.slopes) == (3, [])
    assert np.ravel(told.starts) == pytest.approx([0.0, 0.01, 0.01 / 0.6])
    assert found.cycle.start.state == pytest.approx([0.01 / 0.6])
    assert 0.0 <= found.miss <= 1e-12


def test_the_slope_is_taken_at_the_better_point_where_a_return_does_not_halve_the_miss(
    closed: Any,
) -> None:
    told = _linear(0.6)
    assert closed(told).returns == 3
    assert np.ravel(told.slopes) == pytest.approx([0.01])
    away = _linear(3.0)
    closed(away)
    assert away.slopes == [[0.0]]
    assert np.ravel(away.starts) == pytest.approx([0.0, 0.01, -0.005])
    # As large a miss on the other side is no better.
    flipped = _linear(-1.0)
    closed(flipped)
    assert flipped.slopes == [[0.0]]
    # Just halved is not enough: a miss of 1/64, then one of 1/128.
    half = Map(image=lambda y: y / 2 + 1 / 64, slope=lambda _: [[0.5]])
    closed(half)
    assert half.slopes == [[1 / 64]]


def test_steps_that_lead_nowhere_are_shortened_by_four_each(closed: Any) -> None:
    # Off by 0.01 at the origin and by 0.02 everywhere else.
    told = Map(image=lambda y: y + (0.01 if y[0] == 0.0 else 0.02), slope=lambda _: [[0.0]])
    with pytest.raises(SimulationError, match="No return repeats") as caught:
        closed(told)
    # A return to 0.01 and, by the slope that is told, once more. It has shown a slope of 2, so the
    # next step is 0.01 / (1 - 2), a quarter of it; then that of -3, a sixteenth of 0.01 / (1 + 3).
    starts = np.ravel(told.starts)
    assert starts[:5] == pytest.approx([0.0, 0.01, 0.01, -0.01 / 4, 0.0025 / 16])
    assert len(starts) == 16
    assert told.slopes == [[0.0]]
    assert caught.value.reason.endswith("differs by 1.0e-02")
    assert (caught.value.time, caught.value.state) == (3.0, (7.0, 8.0))


def test_a_motion_that_does_not_return_is_tried_from_nearer(closed: Any) -> None:
    # It returns up to 0.3 only; a step of 1 is shortened to a quarter.
    told = Map(image=lambda y: None if y[0] > 0.3 else 0.96 * y + 0.01, slope=lambda _: [[0.99]])
    found = closed(told, slope=np.array([[0.99]]))
    assert np.ravel(told.starts)[:2] == pytest.approx([0.0, 1.0])
    assert np.ravel(told.starts)[2] == pytest.approx(0.25)
    assert told.slopes == []
    assert found.cycle.start.state == pytest.approx([0.25], abs=1e-9)
    lost = Map(image=lambda _: None, slope=lambda _: [[0.0]])
    with pytest.raises(SimulationError, match="It fails"):
        closed(lost)
    assert len(lost.starts) == 1


def test_a_known_slope_counts_for_the_first_point_only(closed: Any) -> None:
    # It is right at the origin; the map bends.
    told = Map(
        image=lambda y: 3.0 * y - 20.0 * y**2 + 0.01,
        slope=lambda y: [[3.0 - 40.0 * y[0]]],
    )
    found = closed(told, slope=np.array([[3.0]]))
    y = found.cycle.start.state[0]
    assert 2.0 * y - 20.0 * y**2 + 0.01 == pytest.approx(0.0, abs=1e-12)
    assert np.ravel(told.starts)[1] == pytest.approx(-0.005)


def test_a_step_is_long_again_after_a_short_one_that_helped(closed: Any) -> None:
    # Off the fixed point 0 by 1 it does not return before a quarter of the step.
    def image(y: Any) -> Any:
        return None if y[0] > 0.5 else 0.5 * y + 0.5 if y[0] < 0.2 else 0.1 * y + 0.27

    told = Map(image=image, slope=lambda _: [[0.5 if _[0] < 0.2 else 0.1]])
    found = closed(told)
    assert found.cycle.start.state == pytest.approx([0.3])


@pytest.mark.parametrize(
    ("misses", "returned", "miss"),
    [
        # The second is no better, but rounding may leave as much.
        ((5e-9, 6e-9), 2, 5e-9),
        ((5e-9, 5e-9), 2, 5e-9),
        ((1e-8, 1e-8), 2, 1e-8),
        ((1e-6, 4e-9, 0.9e-8), 3, 4e-9),
        ((5e-9, 0.9e-12), 2, 0.9e-12),
        # More than rounding leaves is followed on.
        ((5e-9, 2e-8, 0.0), 3, 0.0),
        ((5e-9, 4e-9, 0.0), 3, 0.0),
        ((1e-12,), 1, 1e-12),
        ((1.1e-12, 0.0), 2, 0.0),
    ],
)
def test_what_rounding_may_leave_is_an_orbit_once_it_gets_no_better(
    closed: Any, misses: Sequence[float], returned: int, miss: float
) -> None:
    left = list(misses)

    def image(y: Any) -> Any:
        return y + left.pop(0)

    found = closed(Map(image=image, slope=lambda _: [[0.0]]))
    assert found.returns == returned
    assert found.miss == pytest.approx(miss, rel=1e-3, abs=1e-20)


def test_as_many_returns_as_there_may_be_are_tried(closed: Any) -> None:
    def never(y: Any) -> Any:
        return y + 1.0

    told = Map(image=never, slope=lambda _: [[0.0]])
    with pytest.raises(SimulationError, match=r"differs by 1.0e\+00"):
        closed(told)
    assert len(told.starts) == 16


def test_what_repeats_because_it_shrinks_to_a_point_is_no_orbit(closed: Any) -> None:
    for drift, is_one in ((1e-6, True), (1.1e-6, False)):
        told = _linear(0.4)
        told.drift = drift
        if is_one:
            assert closed(told).returns == 3
            continue
        with pytest.raises(SimulationError, match="shrinks to a point") as caught:
            closed(told)
        assert caught.value.time == 3.0
        assert caught.value.state == pytest.approx((0.01 / 0.6,))


def test_at_a_fold_where_the_slope_is_one_the_shortest_step_is_taken(closed: Any) -> None:
    matrix = np.diag([1.0, 0.4])
    told = Map(image=lambda y: matrix @ y + [0.0, 0.01], slope=lambda _: matrix)
    found = closed(told, n=2, slope=matrix)
    assert found.cycle.start.state == pytest.approx([0.0, 0.01 / 0.6])
    assert found.returns == 2


def test_several_coordinates_are_closed_together(closed: Any) -> None:
    matrix = np.array([[0.3, -0.2], [0.1, 0.2]])
    told = Map(image=lambda y: matrix @ y + [0.01, 0.02], slope=lambda _: matrix)
    found = closed(told, n=2)
    fixed = np.linalg.solve(np.eye(2) - matrix, [0.01, 0.02])
    assert found.cycle.start.state == pytest.approx(fixed, abs=1e-11)


# A rank-one correction.


def _trial(at: Sequence[float], miss: Sequence[float]) -> Any:
    cycle: Any = SimpleNamespace()
    return fixed_point._Trial(at=np.array(at), cycle=cycle, miss=np.array(miss))


def test_a_slope_is_corrected_along_the_step_alone() -> None:
    j = np.array([[0.5, 0.2], [-0.3, 0.4]])
    before, after = _trial([1.0, 2.0], [0.5, 0.25]), _trial([3.0, 3.0], [0.1, 0.7])
    found = fixed_point._broyden(j, before, after)
    step = np.array([2.0, 1.0])
    # The image moves by the step and by how the miss changes.
    assert found @ step == pytest.approx(step + np.array([0.1 - 0.5, 0.7 - 0.25]))
    across = np.array([-1.0, 2.0])
    assert found @ across == pytest.approx(j @ across)
    assert fixed_point._broyden(j, before, before) is j


def test_the_change_of_a_return_is_its_largest_entry_either_way() -> None:
    assert _trial([0.0, 0.0], [0.5, -0.75]).change == 0.75
    assert _trial([], []).change == 0.0


# Near a period.


def test_a_period_is_closed_from_its_start_in_sizes_at_its_events(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[Any] = []

    def close(*arguments: Any, **named: Any) -> str:
        asked.append((arguments, named))
        return "closed"

    monkeypatch.setattr(fixed_point, "newton_on_return_map", close)
    cycle: Any = SimpleNamespace(
        start=SimpleNamespace(state="start"),
        scale_at_events=lambda: "sizes",
        period=3.0,
        shape=TWICE,
    )
    machine: Any = "machine"
    assert newton_from_cycle(machine, cycle, SETTINGS) == "closed"  # type: ignore[comparison-overlap]
    named = {"scale": "sizes", "period": 3.0, "settings": SETTINGS, "shape": TWICE}
    assert asked == [(("machine", "start"), named)]


@pytest.mark.parametrize(
    ("shape", "kinds", "place"),
    [
        (ONE_ZENO, ["zeno", "zeno"], 0),
        (TWICE, ["zeno", "zeno"], 0),
        (EventSequence.parsed("impact*2"), ["zeno", "impact", "impact", "impact"], 1),
        # The stop is not plastic.
        (EventSequence.parsed("plastic"), ["impact", "impact", "zeno"], 2),
        (ONE_ZENO, ["impact"], None),
        (TWICE, ["zeno"], None),
        (EventSequence.parsed("impact*2"), [], None),
    ],
)
def test_the_first_period_of_a_shape_is_cut_out_of_a_motion_over_two(
    monkeypatch: pytest.MonkeyPatch, shape: EventSequence, kinds: list[str], place: Any
) -> None:
    asked: list[Any] = []

    def simulate(*arguments: Any, **named: Any) -> str:
        asked.append((*arguments, named))
        return "run"

    def phases_of(run: Any, x: Any, *, held: bool) -> Any:
        assert (run, x.tolist()) == ("run", [1.0, 2.0])
        assert held is shape.starts_at_release
        return tuple(SimpleNamespace(kind=kind, place=k) for k, kind in enumerate(kinds))

    monkeypatch.setattr(fixed_point, "simulate", simulate)
    monkeypatch.setattr(fixed_point, "phases_of", phases_of)
    monkeypatch.setattr(
        fixed_point,
        "kinds_of",
        lambda some: tuple(fixed_point.EventSequence.parsed(one.kind).phases[0] for one in some),
    )
    monkeypatch.setattr(fixed_point, "follow_each_other", lambda _: True)
    monkeypatch.setattr(fixed_point, "cycle_between", lambda _, some: [one.place for one in some])
    machine: Any = SimpleNamespace(restitution=0.5)
    x = np.array([1.0, 2.0])

    def near() -> Any:
        return cycle_near(machine, x, period=3.0, settings=SETTINGS, shape=shape)

    if place is None:
        words = "Zeno point with a later release" if shape is ONE_ZENO else f"`{shape.text}`"
        with pytest.raises(SimulationError, match=r"is reached|follows") as caught:
            near()
        assert words in caught.value.reason
        assert (caught.value.time, caught.value.state) == (6.0, (1.0, 2.0))
    else:
        assert near() == list(range(place, place + shape.n_phases))
        monkeypatch.setattr(fixed_point, "follow_each_other", lambda _: False)
        with pytest.raises(SimulationError):
            near()
    assert asked[0] == (machine, x, {"until": 6.0, "settings": SETTINGS})
