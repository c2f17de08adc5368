"""Several orbits of events: mirror images that coexist, ranked and different.

Without spring and damping the clapper is the impact pair: between impacts its mass moves under the
force `A cos(omega t)` alone, which has a closed form.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import pytest

import zeno_orbits as zo

PAIR = {"k": 0.0, "c": 0.0, "restitution": 0.9, "omega": 2.0, "A": 4.0}


def flown(state: Mapping[str, float], time: float, force: float, omega: float) -> dict[str, float]:
    """Return the state of a mass under a cosine force after a time."""
    angle = math.atan2(state["sine"], state["cosine"])
    after = angle + omega * time
    impulse = force / omega
    drift = state["speed"] - impulse * math.sin(angle)
    turned = math.cos(after) - math.cos(angle)
    return {
        "place": state["place"] + drift * time - impulse / omega * turned,
        "speed": drift + impulse * math.sin(after),
        "cosine": math.cos(after),
        "sine": math.sin(after),
    }


def assert_closed_form(orbit: zo.Orbit) -> None:
    """Check every flight and every impact of an orbit of the impact pair."""
    force, omega, e = (orbit.parameters[name] for name in ("A", "omega", "restitution"))
    state, time = dict(orbit.start_state), 0.0
    for event in orbit.events:
        state = flown(state, event.time - time, force, omega)
        assert state == pytest.approx(dict(event.state), abs=1e-10)
        side = 1.0 if event.name == "impact upper" else -1.0
        assert state["place"] == pytest.approx(side, abs=1e-10)
        assert side * state["speed"] > 0.0
        state["speed"] *= -e
        time = event.time
    assert state == pytest.approx(dict(orbit.start_state), abs=1e-10)
    # A flight keeps the area of the phase plane, and an impact takes the part 1 - e^2.
    product = math.prod(abs(mu) for mu in orbit.floquet_multipliers)
    assert product == pytest.approx(e ** (2 * len(orbit.events)), rel=1e-8)


def mirrored(name: str) -> str:
    """Return the name of an event on the other side."""
    return "impact lower" if name == "impact upper" else "impact upper"


def assert_mirror_images(one: zo.Orbit, other: zo.Orbit) -> None:
    """Check that each event of an orbit has its mirror image, half a turn of the clock later."""

    def by_speed(row: tuple[Any, ...]) -> tuple[str, float]:
        return row[0], row[2]

    images = [
        (mirrored(event.name), *(-value for value in event.state.values())) for event in one.events
    ]
    wanted = sorted(images, key=by_speed)
    found = sorted(((event.name, *event.state.values()) for event in other.events), key=by_speed)
    for expected, actual in zip(wanted, found, strict=True):
        assert actual[0] == expected[0]
        assert actual[1:] == pytest.approx(expected[1:], abs=1e-9)


@pytest.mark.slow
def test_both_mirror_images_of_an_impact_pair_are_found_and_verified() -> None:
    found = zo.search_gains(
        "clapper", vary={}, parameters=PAIR, settings=zo.SearchSettings(candidates=3)
    )
    orbits = [one.orbit for one in found.candidates]
    assert len(orbits) == 2
    for one in found.candidates:
        assert one.certificate is not None
        assert one.certificate.passed
        assert one.certificate.stable
        assert_closed_form(one.orbit)
    assert_mirror_images(*orbits)
    assert found.orbit == orbits[0]
    assert found.n_states > 0


@pytest.mark.slow
def test_two_pairs_of_mirror_images_coexist() -> None:
    parameters = PAIR | {"restitution": 0.7}
    found = zo.search_gains(
        "clapper", vary={}, parameters=parameters, settings=zo.SearchSettings(candidates=4)
    )
    orbits = sorted((one.orbit for one in found.candidates), key=lambda one: one.period)
    turn = 2 * math.pi / PAIR["omega"]
    assert [one.period / turn for one in orbits] == pytest.approx([1.0, 1.0, 2.0, 2.0], rel=1e-11)
    for one in orbits:
        assert_closed_form(one)
    assert_mirror_images(*orbits[:2])
    assert_mirror_images(*orbits[2:])


@pytest.mark.slow
def test_a_symmetric_machine_with_one_attractor_has_one_candidate() -> None:
    found = zo.search_gains("clapper", vary={}, settings=zo.SearchSettings(candidates=2))
    assert len(found.candidates) == 1
    assert found.candidates[0].starts == 1


@pytest.mark.slow
def test_optima_of_equal_values_and_scores_are_different_if_their_orbits_are() -> None:
    free = {"A": (3.9, 4.1)}
    wish = zo.MinImpactLoss()
    found = zo.search_gains(
        "clapper",
        vary=free,
        parameters=PAIR,
        objective=wish,
        settings=zo.SearchSettings(candidates=2, n_starts=1),
    )
    one, other = found.candidates
    assert [one.orbit.parameters["A"], other.orbit.parameters["A"]] == pytest.approx([3.9, 3.9])
    assert one.score == pytest.approx(other.score, rel=1e-9)
    assert_mirror_images(one.orbit, other.orbit)
    assert_closed_form(one.orbit)


def test_several_starts_that_lead_to_one_orbit_are_counted() -> None:
    # The least loss is at the least push, from wherever the search starts.
    found = zo.search_gains(
        "hopper",
        vary={"a": (15.0, 40.0)},
        objective=zo.MinImpactLoss(),
        settings=zo.SearchSettings(candidates=2, n_starts=2),
    )
    (one,) = found.candidates
    assert one.starts == len(found.attempts) == 3
    assert one.score == pytest.approx(1.5, rel=1e-8)


def test_less_than_one_candidate_is_refused() -> None:
    with pytest.raises(zo.InputError, match="`candidates` must be at least 1, but it is 0"):
        zo.search_gains("hopper", vary={}, settings=zo.SearchSettings(candidates=0))


@pytest.mark.slow
def test_scaled_lengths_have_the_same_candidates() -> None:
    metres = zo.search_gains(
        "clapper", vary={}, parameters=PAIR, settings=zo.SearchSettings(candidates=2)
    )
    scaled = PAIR | {"A": 4e-3, "d": 1e-3}
    millimetres = zo.search_gains(
        "clapper", vary={}, parameters=scaled, settings=zo.SearchSettings(candidates=2)
    )
    for one, other in zip(metres.candidates, millimetres.candidates, strict=True):
        assert other.orbit.sequence == one.orbit.sequence
        times = [event.time for event in one.orbit.events]
        assert [event.time for event in other.orbit.events] == pytest.approx(times, rel=1e-9)
    for orbit in (one.orbit for one in millimetres.candidates):
        for before, after in pairwise(orbit.events):
            assert before.time < after.time
