"""Maps of machines with several stops and switches: closed forms, brute force and files."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference.several_stops import TwoSided, two_sided
from tests.support.orbits import event_orbit
from zeno_orbits.cli import main
from zeno_orbits.maps import Attractor, AttractorClass, attractors_at, read_map, write_map

G = 9.81

BISTABLE = {"omega": 2.09, "c": 0.2, "A": 1.47, "restitution": 0.64}
"""Two orbits of the clapper attract: one strikes both stops, and one stays between them."""


def _attractor(name: str, start: dict[str, float] | None = None, **numbers: float) -> Attractor:
    problem = zo.load_problem(name)
    (found,) = attractors_at(problem, [problem.values(numbers=numbers)], start=start)
    return found


def _hop(a: float, s: float, e: float) -> float:
    """Return the period of a hopper: the push from the floor to `s`, then a parabola."""
    struck = math.sqrt(2 * a * s / (1 - e**2))
    leaves = math.sqrt((e * struck) ** 2 + 2 * (a - G) * s)
    push = (leaves - e * struck) / (a - G)
    return push + (leaves + math.sqrt(leaves**2 + 2 * G * s)) / G


def test_a_map_of_the_hopper_has_the_periods_and_multipliers_of_its_closed_form() -> None:
    found = zo.parameter_map("hopper", x=("a", 12.0, 40.0, 3), y=("restitution", 0.2, 0.8, 3))
    for k, one in enumerate(found.attractors):
        a, e = found.x.values()[k % 3], found.y.values()[k // 3]
        assert one.fate is AttractorClass.NO_ZENO
        assert one.sequence[-1] == "impact stop"
        assert one.period == pytest.approx(_hop(a, 0.1, e), rel=1e-11)
        assert one.multipliers == pytest.approx((e**2,), abs=1e-9)


def _near_orbit(oscillator: TwoSided, time: float, off: float = 0.0) -> dict[str, float]:
    place, speed = oscillator.state(time)
    angle = oscillator.omega * time + oscillator.phase
    clock = {"cosine": math.cos(angle), "sine": math.sin(angle)}
    return {"place": place * (1 - off), "speed": speed, **clock}


def _of(oscillator: TwoSided) -> dict[str, float]:
    own = {"c": oscillator.c, "omega": oscillator.omega, "A": oscillator.amplitude}
    return {**own, "d": oscillator.stop, "restitution": oscillator.restitution}


@pytest.mark.slow
def test_symmetric_orbits_of_the_clapper_attract_where_their_closed_form_is_stable() -> None:
    rng = np.random.default_rng(5)
    stable: list[bool] = []
    for _ in range(12):
        oscillator = two_sided(rng)
        start = _near_orbit(oscillator, 0.4 * oscillator.half, off=1e-4)
        found = _attractor("clapper", start, **_of(oscillator))
        wanted = oscillator.multipliers**2
        symmetric = (
            set(found.sequence) == {"impact lower", "impact upper"}
            and len(found.sequence) == 2
            and abs(abs(found.state["speed"]) - oscillator.restitution * oscillator.speed) < 1e-7
        )
        stable.append(bool(np.max(np.abs(wanted)) < 1.0))
        assert symmetric == stable[-1]
        if symmetric:
            assert found.turns == 1
            assert found.period == pytest.approx(2 * oscillator.half, rel=1e-11)
            ours = sorted(found.multipliers, key=lambda mu: (mu.real, mu.imag))
            exact = sorted(wanted.astype(complex), key=lambda mu: (mu.real, mu.imag))
            assert np.array(ours) == pytest.approx(np.array(exact), abs=1e-7)
    # Both outcomes are tested.
    assert 2 <= sum(stable) <= 10


def test_a_weak_force_does_not_reach_the_stops() -> None:
    omega, c = 0.3, 0.5
    reaches = abs(complex(1 - omega**2, c * omega))
    below = _attractor("clapper", c=c, A=0.98 * reaches)
    assert (below.fate, below.turns, below.sequence) == (AttractorClass.NO_ZENO, 1, ())
    above = _attractor("clapper", c=c, A=1.02 * reaches)
    assert set(above.sequence) & {"impact upper", "zeno upper"}
    assert _attractor("clapper", c=c, A=0.0).fate is AttractorClass.REST


@pytest.mark.slow
def test_the_phrase_of_an_orbit_counts_events_and_zeno_points() -> None:
    found = _attractor("relay")
    assert found.phrase == "Zeno periodic orbit, 6 events, 2 Zeno points"
    assert found.turns == 1
    plastic = _attractor("kneed_walker", restitution=0.0)
    assert plastic.fate is AttractorClass.SIMPLE
    assert plastic.phrase == "simple periodic orbit, 2 events, 1 Zeno point"
    assert plastic.period == pytest.approx(0.56457806957, abs=1e-10)


@pytest.mark.slow
def test_a_walker_that_loses_its_balance_falls() -> None:
    walks, falls = (
        _attractor("powered_walker", {"q1": 0.2, "q2": -0.2, "q3": -0.2, "dq1": rate})
        for rate in (-0.9, 0.0)
    )
    assert walks.phrase == "Zeno periodic orbit, 2 events, 1 Zeno point"
    assert (falls.fate, falls.phrase) == (AttractorClass.ESCAPE, "it falls")


def test_a_motion_that_the_simulator_refuses_is_a_failed_point_with_the_reason() -> None:
    found = _attractor("hopper", a=0.5)
    assert found.fate is AttractorClass.FAILED
    assert "kink" in found.detail


@pytest.mark.slow
def test_basins_of_two_orbits_are_those_of_long_simulations() -> None:
    found = zo.parameter_map(
        "clapper",
        x=("place", -0.8, 0.8, 3),
        y=("speed", -3.0, 3.0, 5),
        parameters=BISTABLE,
        start={"cosine": 1.0},
    )
    assert [one.sequence for one in found.orbits] == [("impact upper", "impact lower")]
    turn = 2 * math.pi / BISTABLE["omega"]
    for k, one in enumerate(found.attractors):
        start = {"place": found.x.values()[k % 3], "speed": found.y.values()[k // 3]}
        run = zo.simulate(
            "clapper", until=100 * turn, parameters=BISTABLE, start={**start, "cosine": 1.0}
        )
        strikes = any(event.time > 99 * turn for event in run.events)
        assert one.fate is AttractorClass.NO_ZENO
        assert one.turns == 1
        assert bool(one.sequence) == strikes
    assert len({one.phrase for one in found.attractors}) == 2


def test_an_orbit_is_found_over_its_shortest_period_from_one_section() -> None:
    # From other starts the motion first meets the other stop, or repeats better after two turns.
    numbers = {"omega": 1.5, "c": 0.05, "A": 1.1, "restitution": 0.9}
    for speed in (0.0, 1.0, 2.0):
        found = _attractor("clapper", {"speed": speed, "cosine": 1.0}, **numbers)
        assert found.sequence == ("impact upper", "impact lower")
        assert found.turns == 1


def test_a_map_file_keeps_the_event_sequences(tmp_path: Path) -> None:
    found = zo.parameter_map("hopper", x=("a", 12.0, 40.0, 2), y=("s", 0.1, 0.2, 2))
    write_map(found, tmp_path / "map.json")
    assert read_map(tmp_path / "map.json") == found
    assert all(one.sequence for one in found.attractors)


def _first_attractor(capsys: Any) -> str:
    """Return the attractor of the first row of a printed map, which may take two lines."""
    _, _, *lines = capsys.readouterr().out.splitlines()
    first, second = (re.split(r"\s{2,}", line.strip())[0] for line in lines[:2])
    return f"{first} {second}"


@pytest.mark.slow
def test_the_command_maps_machines_with_switches(tmp_path: Path, capsys: Any) -> None:
    file = tmp_path / "map.json"
    words = ["--x", "a=12:20", "--y", "restitution=0.2:0.5", "--grid", "2x2", "-o", str(file)]
    # Exit code 1: no point has a Zeno point.
    assert main(["map", "hopper", *words]) == 1
    assert _first_attractor(capsys) == "periodic orbit without a Zeno point, 4 events"
    assert read_map(file).x.name == "a"


@pytest.mark.slow
def test_the_command_maps_from_an_orbit_and_draws(tmp_path: Path, capsys: Any) -> None:
    orbit = tmp_path / "orbit.json"
    zo.write_orbit(event_orbit("clapper"), orbit)
    words = ["--orbit", str(orbit), "--x", "place=-0.5:0.5", "--y", "speed=-1:1", "--grid", "2x2"]
    picture = tmp_path / "map.png"
    assert main(["map", "clapper", *words, "--plot", str(picture)]) == 0
    assert _first_attractor(capsys) == "Zeno periodic orbit, 4 events, 2 Zeno points"
    assert picture.exists()


@pytest.mark.slow
def test_two_workers_compute_the_same_map() -> None:
    axes: dict[str, Any] = {"x": ("A", 0.5, 5.0, 5), "y": ("restitution", 0.1, 0.7, 4)}
    one, two = (zo.parameter_map("clapper", **axes, workers=n) for n in (1, 2))
    assert one.attractors == two.attractors
