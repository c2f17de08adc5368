"""Residuals and margins of periods made by hand: each is what its definition says."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.periods_by_hand import (
    arc,
    claim,
    cycle,
    first_cycle,
    impact,
    phase,
    state,
    system,
    zeno,
)
from zeno_orbits.model import StateLimit
from zeno_orbits.orbits import ONE_ZENO, EventSequence, Moment
from zeno_orbits.simulation import Mode
from zeno_orbits.verification.claim import Claim
from zeno_orbits.verification.integration import Observation
from zeno_orbits.verification.residuals import (
    _adhesion,
    _hits,
    _impact_laws,
    _off_section,
    _penetration,
    escapes_of,
    lawful_impact,
    margins_of,
    orbit_residuals,
)

PERIOD = 2.0
HELD = [
    phase(
        (0.0, (0.0, 0.0, 1.0)),
        [impact(0.2, (0.0, -4.0, 1.0)), impact(0.5, (0.0, -2.0, 2.0)), impact(0.6, (0, -1, 3))],
        zeno(0.7, (0.0, 0.0, 5.0)),
        (0.9, (0.0, 0.0, 0.5)),
    ),
    phase(
        (0.9, (0.0, 0.0, 0.5)),
        [impact(1.1, (0.0, -3.0, 1.0)), impact(1.4, (0.0, -1.5, 2.0))],
        zeno(1.5, (0.0, 0.0, 4.0)),
        (2.0, (0.0, 0.0, 1.0)),
    ),
]
"""Two accumulations a period; times differ so that a mix-up shows."""
STRUCK = [
    phase((0.0, (0, 4, 1)), [impact(0.8, (0, -8, 3))], None, (0.8, (0.0, 4.0, 3.0))),
    phase((0.8, (0, 4, 3)), [impact(2.0, (0, -6, 2))], None, (2.0, (0.0, 3.0, 2.0))),
]
"""Two impacts a period, and no Zeno point."""


def _claim(phases: list[Any] = HELD, shape: str = "zeno*2") -> Claim:
    return claim(shape, PERIOD, phases)


def _said(place: int, **entries: Any) -> Claim:
    """Return the claim of the two accumulations with other entries of one phase."""
    whole = _claim()
    parts = list(whole.phases)
    parts[place] = replace(parts[place], **entries)
    return replace(whole, phases=tuple(parts))


def _shifted(place: int, index: int, *, time: float = 0.0, by: Any = (0.0, 0.0, 0.0)) -> Claim:
    """Return the claim with one impact of one phase elsewhere."""
    hits = list(_claim().phases[place].impacts)
    hits[index] = (hits[index][0] + time, hits[index][1] + state(*by))
    return _said(place, impacts=tuple(hits))


# What the orbit says.

TRUE = {"first_impact": 0.0, "impact_sequence": 0.0, "zeno_point": 0.0, "phases": 0.0}


def test_a_period_that_is_as_said_misses_nothing() -> None:
    assert _hits(_claim(), first_cycle(cycle(HELD))) == TRUE


@pytest.mark.parametrize("place", [0, 1])
def test_every_accumulation_has_its_first_impact_and_its_later_ones(place: int) -> None:
    first = first_cycle(cycle(HELD))
    # Times are counted in periods, states in their sizes 1, 10 and 100; the largest part tells.
    for index, name in ((0, "first_impact"), (1, "impact_sequence"), (-1, "impact_sequence")):
        for sign in (1.0, -1.0):
            moved = _shifted(place, index, time=sign * 0.02)
            assert _hits(moved, first) == pytest.approx({**TRUE, name: 0.01})
            moved = _shifted(place, index, time=sign * 0.02, by=(0.0, 0.0, sign * 5.0))
            assert _hits(moved, first) == pytest.approx({**TRUE, name: 0.05})


@pytest.mark.parametrize("place", [0, 1])
def test_every_accumulation_has_its_zeno_point_and_its_start(place: int) -> None:
    first = first_cycle(cycle(HELD))
    said = _claim().phases[place]
    assert said.zeno is not None
    time, x = said.zeno
    late = _said(place, zeno=(time - 0.02, x))
    assert _hits(late, first) == pytest.approx({**TRUE, "zeno_point": 0.01})
    beside = _said(place, zeno=(time, x + state(0.0, 0.3, 0.0)))
    assert _hits(beside, first) == pytest.approx({**TRUE, "zeno_point": 0.03})
    assert _hits(_said(place, zeno=None), first) == {**TRUE, "zeno_point": math.inf}
    early = _said(place, start_time=said.start_time + 0.02)
    assert _hits(early, first) == pytest.approx({**TRUE, "phases": 0.01})
    aside = _said(place, start=said.start + state(0.0, 0.0, -7.0))
    assert _hits(aside, first) == pytest.approx({**TRUE, "phases": 0.07})


@pytest.mark.parametrize("place", [0, 1])
@pytest.mark.parametrize(("offset", "miss"), [(-0.1, 0.0), (0.1, 0.0), (-0.3, 0.1), (0.5, 0.2)])
def test_impacts_that_the_integration_left_to_the_tail_have_to_lie_inside_it(
    place: int, offset: float, miss: float
) -> None:
    # The tail is a tenth of a second long, the period two seconds.
    end = HELD[place].zeno.time
    inside = (end - 0.05, state(0.0, -0.5, 0.0))
    odd = (end + offset, state(9.0, 9.0, 9.0))
    for more in ((inside, odd), (odd, inside)):
        said = _said(place, impacts=(*_claim().phases[place].impacts, *more))
        found = _hits(said, first_cycle(cycle(HELD)))
        assert found == pytest.approx({**TRUE, "impact_sequence": miss}, abs=1e-15)


def test_impacts_that_the_orbit_does_not_say_are_not_missed() -> None:
    few = _said(0, impacts=_claim().phases[0].impacts[:1])
    assert _hits(few, first_cycle(cycle(HELD))) == TRUE


def test_a_period_without_accumulations_has_no_zeno_point_to_miss() -> None:
    found = _hits(_claim(STRUCK, "impact*2"), first_cycle(cycle(STRUCK)))
    assert found == {"first_impact": 0.0, "impact_sequence": 0.0, "phases": 0.0}


def test_a_period_of_one_phase_has_no_other_phases_to_miss() -> None:
    found = _hits(_claim(HELD[:1], "zeno"), first_cycle(cycle(HELD[:1])))
    assert found == {"first_impact": 0.0, "impact_sequence": 0.0, "zeno_point": 0.0}


def test_phases_that_are_not_those_of_the_claim_are_not_compared() -> None:
    with pytest.raises(ValueError, match="zip"):
        _hits(_claim(), first_cycle(cycle(HELD[:1])))


# Where the period starts.


@pytest.mark.parametrize(
    ("shape", "e", "start", "sizes", "bare"),
    [
        # A release: the gap in 2, its rate in the first impact's speed 4, the multiplier in 50.
        ("zeno*2", 0.5, (-0.2, 0.0, 0.0), 0.1, 0.2),
        ("zeno*2", 0.5, (0.0, -0.2, 0.0), 0.05, 0.2),
        ("zeno*2", 0.5, (0.0, 0.0, -0.2), 0.004, 0.2),
        ("zeno*2", 0.5, (0.2, 0.3, 0.4), 0.1, 0.4),
        # Just after an impact only a plastic one leaves no speed; the multiplier says nothing.
        ("impact*2", 0.5, (0.2, 7.0, 7.0), 0.1, 0.2),
        ("impact*2", 0.0, (0.2, 0.8, 7.0), 0.2, 0.8),
        ("impact,plastic", 0.0, (0.0, 0.0, 5.0), 0.1, 5.0),
    ],
)
def test_the_start_is_as_far_off_its_section_as_its_largest_part(
    shape: str, e: float, start: tuple[float, ...], sizes: float, bare: float
) -> None:
    said = _said(0, start=state(*start))
    said = replace(said, shape=EventSequence.parsed(shape))
    first = first_cycle(cycle(HELD))
    assert _off_section(system(restitution=e), said, first) == pytest.approx(sizes)
    # Without a period there are no sizes.
    assert _off_section(system(restitution=e), said, None) == pytest.approx(bare)


# What the motion does on its way.


def test_the_gap_is_looked_at_inside_and_at_the_end_of_every_flight() -> None:
    def seen(*arcs: Any) -> float:
        return _penetration(system(), first_cycle(cycle(HELD, arcs)))

    above = arc(Mode.FREE, [0, 1, 2], [(0, 1, 0), (1, 0, 0), (0, -1, 0)])
    assert seen(above) == 0.0
    below = arc(Mode.FREE, [0, 1, 2], [(0, 1, 0), (-0.4, 0, 0), (0, -1, 0)])
    at_end = arc(Mode.FREE, [0, 1, 2], [(0, 1, 0), (1, 0, 0), (-0.6, -1, 0)])
    # In units of the largest gap, 2. The first state is the last of the arc before.
    assert seen(below) == seen(above, below, above) == pytest.approx(0.2)
    assert seen(at_end) == seen(at_end, below) == seen(below, at_end) == pytest.approx(0.3)
    from_inside = arc(Mode.FREE, [0, 1, 2], [(-1, 1, 0), (1, 0, 0), (0, -1, 0)])
    assert seen(from_inside) == 0.0
    # Neither the stop nor a tail that was not followed is a flight.
    locked = arc(Mode.LOCKED, [0, 1, 2], [(0, 0, 1), (-1, 0, 1), (-1, 0, 0)])
    tail = arc(Mode.FREE, [0, 1], [(0, 1, 0), (-1, 0, 0)])
    assert seen(locked, tail) == 0.0


def test_a_rescaled_flight_has_its_gap_in_its_own_state() -> None:
    unit = 0.1
    # Its gap is that of the flow, times the square of its unit of time; the state's is rounding.
    hop = arc(
        Mode.FREE,
        [0, 1, 2],
        [(0, 1, 0), (0, -1, 0)],
        flow=[(0, 1, 0, 0, 1), (-1, 0, 0, -8.0, 0), (0, -1, 0, 0, -1)],
        unit=unit,
    )
    assert _penetration(system(), first_cycle(cycle(HELD, [hop]))) == pytest.approx(0.04)


def test_the_multiplier_is_looked_at_on_every_locked_arc() -> None:
    def seen(*forces: tuple[float, ...] | None) -> float:
        arcs = [
            None
            if one is None
            else arc(Mode.LOCKED, range(len(one)), [(0.0, 0.0, force) for force in one])
            for one in forces
        ]
        phases = [phase((0, (0,)), [], None, (1, (0,)), locked=one) for one in arcs]
        return _adhesion(system(), first_cycle(cycle(phases)))

    assert seen((4.0, 3.0, 0.5)) == 0.0
    # In units of the largest multiplier, 50.
    assert seen((4.0, -3.0, 0.0)) == pytest.approx(0.06)
    assert seen((4.0, 1.0, 0.0), None, (2.0, -1.0, 2.0)) == pytest.approx(0.02)
    assert seen(None) == 0.0


def test_an_impact_obeys_newtons_law_and_costs_the_energy_that_it_takes() -> None:
    hit = impact(0.0, (0.0, -3.0, 4.0))
    # With e = 1/2 and m = 2 + 4: 3/2 afterwards, and (1 - 1/4) / 2 * 6 * 9 lost.
    assert lawful_impact(system(), hit) == pytest.approx((1.5, 20.25))
    assert lawful_impact(system(restitution=0.0), hit) == pytest.approx((0.0, 27.0))


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_impacts_are_measured_in_the_speed_and_energy_of_the_fastest(
    place: int, sign: float
) -> None:
    lawful = [impact(0.0, (0.0, -rate, 2.0 * k)) for k, rate in enumerate((2.0, 4.0, 1.0))]
    assert _impact_laws(system(), tuple(lawful)) == pytest.approx(
        {"restitution": 0.0, "impact_energy": 0.0}, abs=1e-15
    )
    hit = lawful[place]
    after = hit.state_plus + state(0.0, sign * 0.1, 0.0)
    odd = [*lawful[:place], replace(hit, state_plus=after), *lawful[place + 1 :]]
    w = float(hit.state_plus[1])
    assert _impact_laws(system(), tuple(odd)) == pytest.approx(
        {
            "restitution": 0.1 / 4.0,
            # Of the energy at the speed 4 and the same inertia, which cancels.
            "impact_energy": abs((w + sign * 0.1) ** 2 - w**2) / 4.0**2,
        }
    )


# Escapes.


def test_a_coordinate_escapes_by_what_it_goes_beyond_in_units_of_its_escape() -> None:
    first = first_cycle(cycle(HELD))
    problem: Any = SimpleNamespace(
        state_names=("a", "b", "c"),
        escapes={
            "a": StateLimit(beyond=0.8, phrase="a flies off"),
            # Its size is 10: that far it may go.
            "b": StateLimit(beyond=10.0, phrase="b flies off"),
            "c": StateLimit(beyond=50.0, phrase="c flies off"),
        },
    )
    found = escapes_of(problem, first)
    assert list(found) == ["a", "c"]
    assert found["a"] == (pytest.approx(0.25), "a flies off")
    assert found["c"] == (pytest.approx(1.0), "c flies off")


# Margins.


def test_the_margins_of_accumulations_are_the_least_of_all() -> None:
    # d2h/dt2 is -10 times the third entry, the rate of the multiplier -100 times.
    assert margins_of(system(), first_cycle(cycle(HELD))) == pytest.approx(
        {
            "gap_acceleration": 40.0,
            "first_impact_speed": 3.0,
            "release_transversality": 50.0,
            "locked_time": 0.2,
        }
    )
    swapped = margins_of(system(), first_cycle(cycle(HELD[::-1])))
    assert swapped == margins_of(system(), first_cycle(cycle(HELD)))


def test_a_plastic_impact_that_lets_go_has_a_margin_of_that_and_others_have_not() -> None:
    pulled = system(restitution=0.0, gap_acceleration=lambda x: float(x[2]))
    assert margins_of(pulled, first_cycle(cycle(STRUCK))) == {
        "first_impact_speed": 6.0,
        "lets_go": 2.0,
    }
    assert margins_of(system(), first_cycle(cycle(STRUCK))) == {"first_impact_speed": 6.0}
    # Where the stop holds nothing lets go.
    assert "lets_go" not in margins_of(system(restitution=0.0), first_cycle(cycle(HELD)))


def test_phases_are_apart_by_the_nearest_shorter_period_in_the_sizes_of_the_states() -> None:
    asked: list[Any] = []

    def shorter(scale: Any) -> dict[EventSequence, float]:
        asked.append(scale)
        return {ONE_ZENO: 0.3, EventSequence.parsed("zeno*2"): 0.1}

    first = first_cycle(cycle(HELD, shorter_periods=shorter))
    assert margins_of(system(), first)["phases_apart"] == 0.1
    assert asked == [first.scale]


def test_without_a_period_there_are_no_margins() -> None:
    assert margins_of(system(), None) == {}


# All together.

FREE: Any = SimpleNamespace(state_names=("a", "b", "c"), escapes={})


def _seen(phases: list[Any], *returns: tuple[float, ...]) -> Observation:
    first = first_cycle(cycle(phases))
    ends = tuple(Moment(time=PERIOD, state=state(*x)) for x in returns)
    return Observation(first=first, returns=ends, integration_error=0.0, trouble="")


def test_what_an_integration_tells_has_the_names_of_the_shape() -> None:
    held = orbit_residuals(system(), FREE, _claim(), _seen(HELD, (0, 0, 1)))
    common = {"closure", "period", "drift", "penetration", "adhesion"}
    common |= {"first_impact", "impact_sequence", "phases", "restitution", "impact_energy"}
    assert set(held) == common | {"release", "zeno_point"}
    assert {held[name] for name in held if name != "release"} == {0.0}
    # The start has a multiplier of 1, and the largest is 50.
    assert held["release"] == pytest.approx(0.02)
    said = _claim(STRUCK, "impact*2")
    struck = orbit_residuals(system(), FREE, said, _seen(STRUCK, (0, 4, 1)))
    assert set(struck) == common | {"start"}


def test_the_first_return_closes_and_the_farthest_drifts() -> None:
    whole = _seen(HELD, (0.0, 0.1, 1.0), (0.3, 0.0, 1.0), (0.0, 0.0, 3.0))
    assert whole.first is not None
    end = Moment(time=2.5, state=state(0.0, 0.1, 1.0))
    late = [*HELD[:1], SimpleNamespace(**{**vars(HELD[1]), "end": end})]
    seen = replace(whole, first=first_cycle(cycle(late)))
    found = orbit_residuals(system(), FREE, _claim(), seen)
    assert found["closure"] == pytest.approx(0.01)
    assert found["drift"] == pytest.approx(0.3)
    assert found["period"] == pytest.approx(0.25)
    early = replace(_claim(), period=4.0)
    assert orbit_residuals(system(), FREE, early, seen)["period"] == pytest.approx(0.375)


def test_holonomic_constraints_are_looked_at_where_arcs_end() -> None:
    arcs = [
        arc(Mode.FREE, [0, 1, 2], [(0, 0, 0), (9, 9, 9), (0.0, 0.02, -0.3)]),
        arc(Mode.FREE, [2, 3, 4], [(0, 0, 0), (9, 9, 9), (0.0, -0.1, 0.2)]),
    ]
    constrained = system(holonomic=lambda x: x[1:], own=None)
    first = first_cycle(cycle(HELD, arcs))
    seen = replace(_seen(HELD, (0, 0, 1)), first=first)
    found = orbit_residuals(constrained, FREE, _claim(), seen)
    assert found["holonomic"] == pytest.approx(0.3)
    # A constraint that ten units of the states change by twenty is off by a twentieth of that.
    sloped = SimpleNamespace(
        by=lambda _: SimpleNamespace(holonomic=lambda _: np.array([[2.0, 0.0, 0.0]] * 2))
    )
    sized = SimpleNamespace(states=lambda n: np.full(n, 10.0))
    constrained = system(holonomic=lambda x: x[1:], differentiation=sloped, own=sized)
    found = orbit_residuals(constrained, FREE, _claim(), seen)
    assert found["holonomic"] == pytest.approx(0.3 / 20.0)


def test_the_farthest_escape_is_the_residual() -> None:
    seen = _seen(HELD, (0, 0, 1))
    escapes = {
        "a": StateLimit(beyond=0.8, phrase="off"),
        "c": StateLimit(beyond=50.0, phrase="off"),
        "b": StateLimit(beyond=99.0, phrase="off"),
    }
    problem: Any = SimpleNamespace(state_names=("a", "b", "c"), escapes=escapes)
    assert orbit_residuals(system(), problem, _claim(), seen)["escape"] == pytest.approx(1.0)
    problem.escapes = {"b": StateLimit(beyond=99.0, phrase="off")}
    assert orbit_residuals(system(), problem, _claim(), seen)["escape"] == 0.0


def test_without_a_period_all_that_it_would_tell_is_missed() -> None:
    nothing = Observation(first=None, returns=(), integration_error=math.inf, trouble="none")
    missed = dict.fromkeys(["first_impact", "impact_sequence", "closure"], math.inf)
    held = orbit_residuals(system(), FREE, _claim(), nothing)
    assert held == {"release": 1.0, "zeno_point": math.inf, **missed}
    struck = orbit_residuals(system(), FREE, _claim(STRUCK, "impact*2"), nothing)
    assert struck == {"start": 0.0, **missed}
