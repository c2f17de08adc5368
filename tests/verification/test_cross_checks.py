"""Cuts, energies and second models of motions made by hand: each is held to what it is made of."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.periods_by_hand import (
    claim,
    cycle,
    first_cycle,
    impact,
    phase,
    state,
    system,
    zeno,
)
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.integrators import PlainFlow
from zeno_orbits.orbits import Moment, PhaseKind
from zeno_orbits.simulation import SimulationSettings, Truncation, ZenoExtrapolation, ZenoPassage
from zeno_orbits.verification import DeltaCut, cross_checks
from zeno_orbits.verification.cross_checks import (
    cut_order,
    delta_sweep,
    energies_of,
    imbalance,
    second_model,
)

SETTINGS = SimulationSettings(most_impacts=77)
FASTEST = 4.0


def _piling(fastest: float = FASTEST, kind: PhaseKind = PhaseKind.ZENO) -> Any:
    """Return a phase of impacts that halve their speed, from the time 1 to the Zeno point at 2."""
    hits = [impact(2.0 - 0.5**k, (0.0, -fastest * 0.5**k, 10.0 * k)) for k in range(4)]
    return phase((0.0, (0, 0, 0)), hits, zeno(2.0, (0, 0, 9)), (3.0, (0, 0, 0)), kind=kind)


# Cuts.


class _Cuts:
    """In place of motions that are cut: errors by a law."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, error: Callable[[float, Any], float]
    ) -> None:
        self.made: list[float] = []
        self._error = error
        monkeypatch.setattr(cross_checks, "_cut", self._cut)

    def _cut(self, _: Any, __: Any, of: Any, delta: float, ___: Any) -> DeltaCut:
        self.made.append(delta)
        return DeltaCut(delta=delta, speed=delta / 2, error=self._error(delta, of))


def _swept(phases: list[Any], cuts: tuple[float, ...], enough: float) -> list[DeltaCut]:
    return list(delta_sweep(system(), first_cycle(cycle(phases)), cuts, SETTINGS, enough))


def test_cuts_are_parts_of_the_first_impact_speed_and_end_where_they_are_near_enough(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A cubic law, as the theory has it.
    cuts = _Cuts(monkeypatch, lambda delta, _: delta**3)
    found = _swept([_piling()], (0.1, 0.05), 1e-9)
    # 0.2, 0.02, 0.002 and 0.0002: the last of these is the first whose cube is below 1e-9.
    assert cuts.made == pytest.approx([0.4, 0.2, 0.02, 0.002, 0.0002])
    assert [cut.delta for cut in found] == cuts.made
    assert [cut.error for cut in found] == pytest.approx([delta**3 for delta in cuts.made])
    cuts.made.clear()
    _swept([_piling()], (0.1, 0.05), 1.0)
    assert cuts.made == pytest.approx([0.4, 0.2])


@pytest.mark.parametrize(("fall", "more"), [(2.0, 0), (2.1, 1), (1.5, 0), (0.5, 0)])
def test_a_finer_cut_is_made_only_if_the_last_one_halved_the_error(
    monkeypatch: pytest.MonkeyPatch, fall: float, more: int
) -> None:
    # Errors fall once by this, then no more.
    errors = iter([1.0, *[1.0 / fall] * 9])
    cuts = _Cuts(monkeypatch, lambda *_: next(errors))
    _swept([_piling()], (0.1, 0.01), 1e-9)
    assert len(cuts.made) == 2 + more


def test_one_cut_has_none_before_it_to_be_better_than(monkeypatch: pytest.MonkeyPatch) -> None:
    cuts = _Cuts(monkeypatch, lambda delta, _: delta**3)
    assert len(_swept([_piling()], (0.1,), 1e-9)) == len(cuts.made) == 1


def test_cuts_get_no_finer_than_rounding_bears(monkeypatch: pytest.MonkeyPatch) -> None:
    cuts = _Cuts(monkeypatch, lambda delta, _: delta)
    _swept([_piling()], (1e-2, 1e-3), 1e-30)
    # The finest is a billionth of the first impact speed, to the rounding of its tenths.
    assert 0.5e-9 < cuts.made[-1] / FASTEST < 2e-9
    # Their number is that of the decades from 1e-2 to 1e-9.
    assert len(cuts.made) == 8


def test_the_sweep_is_of_the_accumulation_whose_last_cut_is_worst(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # The first cut of the slow one is better than that of the fast one, its last is worse.
    table = {(8.0, 0.8): 5.0, (8.0, 0.4): 1.0, (4.0, 0.4): 3.0, (4.0, 0.2): 2.0}
    _Cuts(monkeypatch, lambda delta, of: table[-of.impacts[0].approach_rate, round(delta, 9)])
    both = [_piling(8.0), _piling(4.0)]
    for phases in (both, both[::-1]):
        assert [cut.error for cut in _swept(phases, (0.1, 0.05), 10.0)] == [3.0, 2.0]


def test_impacts_that_do_not_accumulate_are_not_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    cuts = _Cuts(monkeypatch, lambda *_: 1.0)
    assert _swept([_piling(kind=PhaseKind.PLASTIC)], (0.1,), 1e-9) == []
    assert cuts.made == []


class _Motion:
    """In place of a simulation: what it was asked, and where it ends."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, end: Any, impacts: tuple[Any, ...] = ()
    ) -> None:
        self.asked: list[tuple[Any, dict[str, Any]]] = []
        self._found = SimpleNamespace(end_state=end, impacts=impacts, zeno_points=())
        monkeypatch.setattr(cross_checks, "simulate", self._simulate)

    def _simulate(self, _: Any, start: Any, **named: Any) -> Any:
        self.asked.append((start, named))
        return self._found


def _one_cut(phase_: Any, delta: float) -> DeltaCut:
    """Return one cut; the completed motion is at the state (0, t, 0) at the time t."""
    period = cycle([phase_])
    period.execution.state_at = lambda t: state(0.0, t, 0.0)
    first = first_cycle(period)
    share = delta / abs(phase_.impacts[0].approach_rate)
    return delta_sweep(system(), first, (share,), SETTINGS, 1.0)[0]


@pytest.mark.parametrize(
    ("delta", "place"), [(0.9, 3), (1.1, 2), (1.0, 3), (2.5, 1), (4.5, 0), (0.1, 3)]
)
def test_a_cut_motion_starts_after_the_first_impact_that_it_makes_plastic_or_the_last(
    monkeypatch: pytest.MonkeyPatch, delta: float, place: int
) -> None:
    # Speeds are 4, 2, 1 and 1/2 at the times 1, 3/2, 7/4 and 15/8.
    motion = _Motion(monkeypatch, state(0.0, 2.5, 0.0))
    found = _one_cut(_piling(), delta)
    [(start, named)] = motion.asked
    hit = _piling().impacts[place]
    # Onto the stop, where the gap rate is that before the impact.
    assert start.tolist() == [0.0, hit.approach_rate, 10.0 * place]
    # The middle of the locked arc, from 2 to 3.
    assert named["until"] == 2.5 - hit.time
    assert named["settings"] == replace(SETTINGS, completion=Truncation(delta=delta))
    assert found == DeltaCut(delta=delta, speed=abs(hit.approach_rate), error=0.0)


def test_a_cut_is_as_far_off_as_the_motions_are_in_the_sizes_of_the_states(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hits = tuple(impact(t, (0, -speed, 0)) for t, speed in ((0.0, 1.0), (0.1, 0.6), (0.2, 0.3)))
    _Motion(monkeypatch, state(0.0, 2.0, 20.0), hits)
    found = _one_cut(_piling(), 0.4)
    # 20 in 100, and 1/2 in 10; the speed is that of the last impact before the cut.
    assert found == DeltaCut(delta=0.4, speed=0.3, error=0.2)


def test_cuts_are_compared_at_the_end_where_no_locked_arc_is_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    motion = _Motion(monkeypatch, state(0.0, 3.0, 0.0))
    open_ended = SimpleNamespace(**{**vars(_piling()), "zeno": None})
    period = cycle([open_ended])
    period.execution.state_at = lambda t: state(0.0, t, 0.0)
    [found] = delta_sweep(system(), first_cycle(period), (0.1,), SETTINGS, 1.0)
    assert found.error == 0.0
    assert motion.asked[0][1]["until"] == pytest.approx(3.0 - 1.875)


def test_a_cut_motion_that_is_lost_has_no_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: Any, **__: Any) -> Any:
        raise ZenoOrbitsError("It is lost.")

    monkeypatch.setattr(cross_checks, "simulate", lost)
    found = _one_cut(_piling(), 0.4)
    assert (found.delta, found.error) == (0.4, math.inf)
    assert math.isnan(found.speed)


def _cuts_at(*points: tuple[float, float]) -> tuple[DeltaCut, ...]:
    return tuple(DeltaCut(delta=1.0, speed=speed, error=error) for speed, error in points)


def test_the_order_is_the_slope_over_the_cuts_that_tell() -> None:
    cubic = [(0.1, 1e-3), (0.01, 1e-6), (0.001, 1e-9)]
    assert cut_order(_cuts_at(*cubic), 0.0) == pytest.approx(3.0)
    # Neither one that has no end nor one below the noise or below rounding tells.
    odd = [(1.0, math.inf), (1e-4, 0.9e-12)]
    assert cut_order(_cuts_at(*cubic, *odd), 0.0) == pytest.approx(3.0)
    assert cut_order(_cuts_at(*cubic, (1e-4, 4e-8)), 5e-8) == pytest.approx(3.0)
    assert cut_order(_cuts_at((1.0, 1.5e-11), (0.1, 1.5e-12)), 0.0) == pytest.approx(1.0)
    assert math.isnan(cut_order(_cuts_at((1.0, 9e-12), (0.1, 9e-13)), 0.0))
    # Two speeds make a slope, one does not.
    assert cut_order(_cuts_at(*cubic[:2]), 0.0) == pytest.approx(3.0)
    assert math.isnan(cut_order(_cuts_at(cubic[0], cubic[0]), 0.0))
    assert math.isnan(cut_order((), 0.0))
    assert math.isnan(cut_order(_cuts_at(*cubic), 1e-6))


# Energies.

UNIT = 1000.0


class _Ledger:
    """In place of an orbit and its problem: a ledger in kilojoules after the three states."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, shape: str) -> None:
        hits = [
            impact(time, (0.0, -speed, force, 9, 0, 0, 0))
            for time, speed, force in ((0.5, 4.0, 1.0), (0.7, 0.0, 8.0), (0.9, 2.0, 3.0))
        ]
        hits[-1] = replace(hits[-1], state_plus=state(0.0, 1.0, 3.0, 9, 0.7, 0.6, 0.5))
        limit = zeno(1.0, (0.0, 0.0, 6.0, 9, 0, 0, 0), last_speed=0.5)
        self.run = SimpleNamespace(
            impacts=tuple(hits),
            zeno_points=(limit,) if shape == "zeno" else (),
            end_state=state(0.0, 3.0, 2.0, 9, 7.0, 4.0, 2.0),
        )
        parts = [phase((0, (0, 2.0, 1.0, 5)), hits, None, (2.0, (0, 0, 0)))]
        if shape != "zeno":
            parts = [phase((0, (0, 2.0, 1.0, 5)), [hit], None, (2.0, (0, 0, 0))) for hit in hits]
        self.claim = claim(shape, 2.0, parts)
        self.cycle = cycle(parts)
        self.cycle.end = Moment(time=2.0, state=state(0, 0, 0))
        self.audited: list[Any] = []
        self.asked: list[tuple[Any, dict[str, Any]]] = []
        monkeypatch.setattr(cross_checks, "simulate", self._simulate)
        monkeypatch.setattr(cross_checks, "with_energy_ledger", lambda unit: f"in {unit:g} J")

    def _simulate(self, _: Any, start: Any, **named: Any) -> Any:
        self.asked.append((start, named))
        return self.run

    def energies(self, simulation: SimulationSettings = SETTINGS) -> dict[str, float]:
        orbit: Any = SimpleNamespace(values=lambda _: "its numbers")
        problem: Any = SimpleNamespace(dynamics=self._dynamics)
        return energies_of(orbit, problem, self.claim, self.cycle, simulation)

    def _dynamics(self, values: Any, audit: Any = None) -> Any:
        assert values == "its numbers"
        if audit is None:
            return SimpleNamespace(own=SimpleNamespace(energy=UNIT))
        self.audited.append(audit)
        return system(
            n_q=1,
            on_stop=lambda x: state(0.0, 0.0, *x[2:]),
            impulse_direction=lambda _: state(0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        )


def test_energies_are_those_of_a_ledger_and_of_every_impact(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ledger = _Ledger(monkeypatch, "zeno")
    found = ledger.energies()
    # With e = 1/2 and m = 2 + x: 3/8 (3 * 16 + 5 * 4), and 1/2 * 8 / 4 that the tail has left.
    assert found == pytest.approx(
        {
            "input_work": 7000.0,
            "copper_loss": 4000.0,
            "other_loss": 2000.0,
            "impact_loss": 25.5 + 1.0,
            # m w^2 / 2 with m = 4 and w = 3, from rest.
            "energy_gain": 18.0,
        }
    )
    assert ledger.audited == ["in 1000 J"]
    [(start, named)] = ledger.asked
    # The ledger starts empty.
    assert start.tolist() == [0.0, 0.0, 1.0, 5.0, 0.0, 0.0, 0.0]
    assert (named["until"], named["impacts"]) == (2.0, None)


def test_a_period_that_an_impact_ends_has_the_energies_just_after_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ledger = _Ledger(monkeypatch, "impact*3")
    found = ledger.energies()
    assert found == pytest.approx(
        {
            "input_work": 700.0,
            "copper_loss": 600.0,
            "other_loss": 500.0,
            "impact_loss": 25.5,
            # From m = 3 and w = 2 to m = 5 and w = 1.
            "energy_gain": 2.5 - 6.0,
        }
    )
    [(start, named)] = ledger.asked
    assert start.tolist() == [0.0, 2.0, 1.0, 5.0, 0.0, 0.0, 0.0]
    assert named["impacts"] == 3
    # The impact may come a little later than it did.
    assert 2.0 < named["until"] < 2.01


def test_impacts_are_counted_one_by_one_however_the_zeno_point_is_reached(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ledger = _Ledger(monkeypatch, "zeno")
    passing = ZenoPassage(tolerance=1e-7, resolved=0.2)
    for completion, used in (
        (passing, ZenoExtrapolation(tolerance=1e-7, resolved=0.2)),
        (Truncation(delta=0.3), Truncation(delta=0.3)),
    ):
        ledger.energies(replace(SETTINGS, completion=completion))
        assert ledger.asked[-1][1]["settings"] == replace(SETTINGS, completion=used)


def test_an_imbalance_is_what_is_unexplained_of_the_largest_energy() -> None:
    known = {"input_work": 10.0, "copper_loss": 5.0, "impact_loss": 4.0, "energy_gain": -1.0}
    assert imbalance(known) == pytest.approx(0.2)
    assert imbalance({**known, "energy_gain": 3.0}) == pytest.approx(0.2)
    assert imbalance({**known, "energy_gain": -40.0}) == pytest.approx(41.0 / 40.0)
    assert imbalance(dict.fromkeys(known, 0.0)) == 0.0
    assert imbalance({**dict.fromkeys(known, 0.0), "input_work": 1e-9}) == 1.0


# A second model.


def _flow(rate: Callable[[Any], Any]) -> PlainFlow:
    return PlainFlow(field=rate, guard_and_rate=lambda _: (0.0, 0.0))


def _model(**parts: Any) -> Any:
    """Return a model whose every quantity at a state (t, ...) is known."""
    named = {
        "free": _flow(lambda x: np.array([1.0 + x[0], 0.0])),
        "locked": _flow(lambda x: np.array([2.0 + x[0], 0.0])),
        "reset_map": lambda x, rate: np.array([rate, -x[1]]),
        "gap_rate": lambda x: 3.0 + x[0],
        "gap_acceleration": lambda x: 4.0 + x[0],
        "multiplier": lambda x: 5.0 + x[0],
        "energy": lambda x: 6.0 + x[0],
        "normal_inertia": lambda x: (7.0 + x[0]) / 100.0,
        "on_stop": lambda x: np.array([x[0], 1.0]),
    }
    return SimpleNamespace(**{**named, **parts})


def _at(place: float, value: Callable[[Any], Any], by: float) -> Callable[..., Any]:
    """Return a quantity that is off by this in its last entry at one state alone."""

    def changed(x: Any, *more: Any) -> Any:
        right = value(x, *more)
        if abs(x[0] - place) > 1e-9:
            return right
        return right + (np.array([0.0, by]) if np.ndim(right) else by)

    return changed


def _difference(monkeypatch: pytest.MonkeyPatch, **parts: Any) -> float:
    """Return the residual of a second model with other parts, over the times from 0 to 2."""
    derived, by_hand = _model(), _model(**parts)
    reference = SimpleNamespace(dynamics=lambda _: by_hand)
    monkeypatch.setattr(cross_checks, "load_reference", lambda _: reference)
    orbit: Any = SimpleNamespace(values=lambda _: None)
    problem: Any = SimpleNamespace(dynamics=lambda _: derived)
    # States before impacts are not among those on the way.
    hits = [impact(0.7, (10.0, 20.0)), impact(0.9, (11.0, 20.0))]
    period = cycle([phase((0, (0, 0)), hits, None, (2.0, (0, 0)))])
    period.execution.states_at = lambda t: np.array([t, np.full_like(t, 20.0)]).T
    return second_model(orbit, problem, period)


def test_two_models_that_agree_do_not_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _difference(monkeypatch) == 0.0


@pytest.mark.parametrize("place", [0.0, 0.05, 1.0, 2.0, 10.0, 11.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_two_models_differ_by_their_worst_quantity_in_its_largest_size(
    monkeypatch: pytest.MonkeyPatch, place: float, sign: float
) -> None:
    # The largest value of each is at the last impact, 11; an entry that is zero has the size 1.
    model, by = _model(), sign * 0.5
    for parts, size in (
        ({"free": _flow(_at(place, model.free.rate, by))}, 1.0),
        ({"locked": _flow(_at(place, model.locked.rate, by))}, 1.0),
        ({"reset_map": _at(place, model.reset_map, by)}, 20.0),
        ({"gap_rate": _at(place, model.gap_rate, by)}, 14.0),
        ({"gap_acceleration": _at(place, model.gap_acceleration, by)}, 15.0),
        ({"multiplier": _at(place, model.multiplier, by)}, 16.0),
        ({"energy": _at(place, model.energy, by)}, 17.0),
        ({"normal_inertia": _at(place, model.normal_inertia, by)}, 0.18),
    ):
        assert _difference(monkeypatch, **parts) == pytest.approx(0.5 / size)


def test_models_are_compared_on_the_stop_where_they_hold_on_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # States on the stop have a second entry of 1, those on the way of 20.
    model = _model()

    def off_it(value: Callable[[Any], Any]) -> Callable[[Any], Any]:
        return lambda x: value(x) + (1.0 if x[1] != 1.0 else 0.0)

    same = {
        "locked": _flow(off_it(model.locked.rate)),
        "gap_acceleration": off_it(model.gap_acceleration),
        "multiplier": off_it(model.multiplier),
    }
    assert _difference(monkeypatch, **same) == 0.0
    assert _difference(monkeypatch, energy=off_it(model.energy)) > 0.0
