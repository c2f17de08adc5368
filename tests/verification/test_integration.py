"""How an orbit is followed: how long, how finely, and what is told where it does not come back."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.periods_by_hand import arc, claim, cycle, impact, phase, state, system, zeno
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.integrators import Tolerance
from zeno_orbits.orbits import ONE_ZENO, EventSequence, Moment, PhaseKind
from zeno_orbits.simulation import Mode, SimulationSettings, ZenoExtrapolation
from zeno_orbits.verification import integration
from zeno_orbits.verification.integration import _measured, _missing, distance, observe

PERIOD = 2.0
PHASES = [
    phase(
        (0.0, (0.0, 0.0, 0.0)),
        [impact(0.5, (0.0, -4.0, 1.0))],
        zeno(0.7, (0.0, 0.0, 5.0), limit_error=1e-9),
        (PERIOD, (0.0, 0.0, 0.0)),
    )
]
FLIGHT = arc(Mode.FREE, [0.0, 0.3, 0.5], [(0, 0, 0), (-3.0, 2.0, 0.5), (0.0, -4.0, 1.0)])
REST = arc(Mode.LOCKED, [0.7, 1.0, 2.0], [(0, 0, 5), (1e-9, 0, -7.0), (0, 0, 0)])
SETTINGS = SimulationSettings(tolerance=Tolerance(relative=1e-9, absolute=1e-10))


class _Runs:
    """In place of integrations: what each was asked, and periods that end where they are told."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, ends: list[list[Any]]) -> None:
        self.asked: list[dict[str, Any]] = []
        self._ends = ends
        monkeypatch.setattr(integration, "followed", self._followed)
        monkeypatch.setattr(integration, "first_cycles", self._first_cycles)

    def _followed(self, _: Any, x: Any, shape: EventSequence, **named: Any) -> Any:
        self.asked.append({"x": x, "shape": shape, **named})
        ends = self._ends.pop(0)
        if ends and isinstance(ends[0], Exception):
            raise ends[0]
        return ends

    def _first_cycles(self, run: Any, *_: Any) -> tuple[Any, ...]:
        found: list[Any] = []
        for time, x in run:
            period = cycle(PHASES, [FLIGHT, REST])
            period.end = Moment(time=time, state=state(*x))
            found.append(period)
        return tuple(found)


def _error(text: str) -> ZenoOrbitsError:
    return ZenoOrbitsError(text)


def test_an_orbit_is_followed_over_its_periods_and_once_again_less_accurately(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ends = [(2.0, (0.0, 0.0, 0.0)), (4.1, (0.0, 0.0, 0.1))]
    runs = _Runs(monkeypatch, [ends, [(2.0, (0.0, 0.02, -0.7)), (4.0, (9.0, 9.0, 9.0))]])
    said = claim("plastic", PERIOD, [replace_start(PHASES[0], (0.3, 0.3, 0.3))])
    seen = observe(system(), said, SETTINGS, 2)
    far, again = runs.asked
    # Half a period more than is asked for, of the shape that the restitution gives.
    assert (far["horizon"], far["n_periods"], far["settings"]) == (5.0, 2, SETTINGS)
    assert far["shape"] == again["shape"] == ONE_ZENO
    # Both start on the section.
    assert far["x"].tolist() == again["x"].tolist() == [0.0, 0.0, 0.3]
    assert again["horizon"] == 3.0
    assert again.get("n_periods", 1) == 1
    assert again["settings"].tolerance.relative > 10 * SETTINGS.tolerance.relative
    assert again["settings"].completion == ZenoExtrapolation(tolerance=1e-10)
    assert [(end.time, end.state[2]) for end in seen.returns] == [(2.0, 0.0), (4.1, 0.1)]
    # The largest states are 3, 4 and 7; the first returns differ by 0.02 / 4 and 0.7 / 7.
    assert seen.integration_error == pytest.approx(0.1)
    assert seen.trouble == ""
    assert seen.first is not None
    assert seen.first.cycle.end is seen.returns[0]


def replace_start(one: Any, x: tuple[float, ...]) -> Any:
    """Return a phase that starts elsewhere."""
    return SimpleNamespace(**{**vars(one), "start": Moment(time=0.0, state=state(*x))})


def test_a_looser_integration_that_fails_or_does_not_come_back_confirms_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said = claim("zeno", PERIOD, PHASES)
    for loose in ([_error("It is lost.")], []):
        _Runs(monkeypatch, [[(2.0, (0.0, 0.0, 0.0))], loose])
        seen = observe(system(), said, SETTINGS, 1)
        assert math.isinf(seen.integration_error)
        assert seen.trouble == ""
        assert len(seen.returns) == 1


def test_an_error_above_the_tolerance_is_estimated_again_by_a_less_loose_integration(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said = claim("zeno", PERIOD, PHASES)
    once, far, near = ([(2.0, (0.0, 0.0, 0.0 + by))] for by in (0.0, 0.7, 7e-9))
    for loose in (far, [_error("It is lost.")]):
        runs = _Runs(monkeypatch, [once, loose, near])
        seen = observe(system(), said, SETTINGS, 1, 1e-8)
        # The largest state is 7, and the error is at most three times the second difference.
        assert seen.integration_error == pytest.approx(3e-9)
        rough, fine = (one["settings"].tolerance.relative for one in runs.asked[1:])
        assert rough / 10 == pytest.approx(fine)
        assert fine > 2 * SETTINGS.tolerance.relative
    # A small error needs no further integration, and a false return stays false.
    assert observe_twice(monkeypatch, near, []) == pytest.approx(1e-9)
    assert observe_twice(monkeypatch, far, far) == pytest.approx(0.1)


def observe_twice(monkeypatch: pytest.MonkeyPatch, *repetitions: Any) -> float:
    """Return the error by repetitions of an integration that returns to zero."""
    _Runs(monkeypatch, [[(2.0, (0.0, 0.0, 0.0))], *repetitions])
    said = claim("zeno", PERIOD, PHASES)
    return observe(system(), said, SETTINGS, 1, 1e-8).integration_error


def test_a_motion_that_is_lost_later_tells_of_its_first_period(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said = claim("zeno", PERIOD, PHASES)
    once = [(2.0, (0.0, 0.0, 0.0))]
    runs = _Runs(monkeypatch, [[_error("It is lost.")], once, once])
    seen = observe(system(), said, SETTINGS, 3)
    assert [one["horizon"] for one in runs.asked] == [7.0, 3.0, 3.0]
    assert [one.get("n_periods") for one in runs.asked[:2]] == [3, 1]
    assert seen.trouble == "It is lost"
    assert len(seen.returns) == 1
    assert seen.integration_error == 0.0


def test_a_motion_that_is_lost_at_once_is_told_by_its_own_trouble(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said = claim("zeno", PERIOD, PHASES)
    runs = _Runs(monkeypatch, [[_error("It is lost later.")], [_error("It is lost at once.")]])
    seen = observe(system(), said, SETTINGS, 3)
    assert len(runs.asked) == 2
    assert seen.trouble == "It is lost at once"
    assert (seen.first, seen.returns) == (None, ())
    assert math.isinf(seen.integration_error)


def test_no_motion_is_waited_for_so_long_that_times_overflow(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said = replace(claim("zeno", PERIOD, PHASES), period=1e308)
    once = [(2.0, (0.0, 0.0, 0.0))]
    runs = _Runs(monkeypatch, [once, once])
    observe(system(), said, SETTINGS, 3)
    # A flight in units of its speed, 1e-100 or less, has times as much longer.
    assert 1e150 < runs.asked[0]["horizon"] < 1e250


def test_what_is_missing_is_said_with_the_time_that_was_waited(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said = claim("zeno", PERIOD, PHASES)
    _Runs(monkeypatch, [[]])
    monkeypatch.setattr(integration, "_missing", lambda *_: "There is nothing")
    seen = observe(system(), said, SETTINGS, 2)
    assert seen.trouble == "There is nothing within 5 s"
    assert seen.first is None


# What is missing.


def _execution(*, returns: int = 0, zeno_points: int = 0) -> Any:
    def asked(period: float) -> tuple[int, ...]:
        assert period == 3.0
        return tuple(range(returns))

    return SimpleNamespace(end_time=3.0, returns=asked, zeno_points=[0] * zeno_points)


@pytest.mark.parametrize(
    ("execution", "said"),
    [
        (_execution(), "No release occurs"),
        (_execution(zeno_points=1), "No release occurs"),
        (_execution(returns=1), "No Zeno point occurs"),
        (_execution(returns=1, zeno_points=1), "phases `zeno*2`, but zeno, impact"),
    ],
)
def test_the_first_thing_that_a_motion_lacks_is_named(
    monkeypatch: pytest.MonkeyPatch, execution: Any, said: str
) -> None:
    kinds = [PhaseKind.ZENO, PhaseKind.IMPACT, PhaseKind.ZENO]

    def phases(*_: Any, held: bool) -> tuple[Any, ...]:
        assert held
        return tuple(SimpleNamespace(kind=kind) for kind in kinds)

    monkeypatch.setattr(integration, "phases_of", phases)
    # No more phases are told than the shape has.
    assert _missing(execution, state(0.0), EventSequence.parsed("zeno*2")).endswith(said)


def test_a_motion_without_impacts_has_none_of_the_phases(monkeypatch: pytest.MonkeyPatch) -> None:
    def phases(*_: Any, held: bool) -> tuple[Any, ...]:
        assert not held
        return ()

    monkeypatch.setattr(integration, "phases_of", phases)
    assert _missing(_execution(), state(0.0), EventSequence.parsed("impact")).endswith("but none")


# Sizes.


def test_the_error_of_the_zeno_points_is_that_of_the_worst() -> None:
    worse = SimpleNamespace(**{**vars(PHASES[0]), "zeno": zeno(0.7, (0, 0, 5), limit_error=3e-9)})
    for phases in ([PHASES[0], worse], [worse, PHASES[0]]):
        assert _measured(system(), cycle(phases, [FLIGHT, REST])).zeno_error == 3e-9


def test_the_sizes_of_a_period_are_the_largest_on_its_way() -> None:
    first = _measured(system(), cycle(PHASES, [FLIGHT, REST]))
    assert first.largest.tolist() == first.scale.tolist() == [3.0, 4.0, 7.0]
    assert first.gap == 3.0
    # The multiplier counts on the stop alone: 7 there, and 5 at the Zeno point.
    assert first.force == 7.0
    assert first.zeno_error == 1e-9


def test_the_multiplier_at_a_zeno_point_counts_where_the_locked_arc_is_short() -> None:
    short = arc(Mode.LOCKED, [0.7, 0.8, 0.9], [(0, 0, 1), (0, 0, 0.5), (0, 0, 0)])
    assert _measured(system(), cycle(PHASES, [FLIGHT, short])).force == 5.0
    pulled = [SimpleNamespace(**{**vars(PHASES[0]), "zeno": zeno(0.7, (0.0, 0.0, -6.0))})]
    assert _measured(system(), cycle(pulled, [FLIGHT, short])).force == 6.0


def test_a_state_that_never_moves_has_the_size_one_and_so_has_a_force_that_never_acts() -> None:
    still = arc(Mode.FREE, [0, 1, 2], [(0, 1, 0), (-0.25, 0, 0), (0, -1, 0)])
    one = phase((0, (0, 1, 0)), [impact(2, (0, -1, 0))], None, (2, (0, 1, 0)))
    first = _measured(system(), cycle([one], [still]))
    assert first.largest.tolist() == [0.25, 1.0, 0.0]
    assert first.scale.tolist() == [0.25, 1.0, 1.0]
    assert first.force == 1.0
    assert first.zeno_error == 0.0


def test_the_gap_of_a_rescaled_flight_is_that_of_its_flow_in_the_square_of_its_unit() -> None:
    def hop(gap: float, *, mode: Mode = Mode.FREE) -> Any:
        flow = [(0, 1, 0, 0, 1), (0.25, 0, 0, gap, 7), (0, -1, 0, 0, -1)]
        return arc(mode, [0, 1, 2], [(0, 1, 0), (0, -1, 0)], flow=flow, unit=0.1)

    low = arc(Mode.FREE, [0, 1, 2], [(0, 1, 0), (0.01, 0, 0), (0, -1, 0)])
    for gap in (8.0, -8.0):
        found = _measured(system(), cycle(PHASES, [low, hop(gap)]))
        assert found.gap == pytest.approx(0.08)
        # What the flow has beyond the state is no state.
        assert found.largest.tolist() == [0.25, 1.0, 0.0]
    # An entry beyond the state is a gap in a flight only.
    on_stop = _measured(system(), cycle(PHASES, [low, hop(8.0, mode=Mode.LOCKED)]))
    assert on_stop.gap == 0.25


def test_states_are_as_far_apart_as_their_farthest_entry_in_its_size() -> None:
    scale = np.array([1.0, 10.0, 100.0])
    a = np.array([1.0, 2.0, 3.0])
    for b, apart in (
        ([1.0, 2.0, 3.0], 0.0),
        ([1.5, 3.0, 9.0], 0.5),
        ([0.5, 3.0, 9.0], 0.5),
        ([1.0, 12.0, -97.0], 1.0),
    ):
        assert distance(a, np.array(b), scale) == apart
