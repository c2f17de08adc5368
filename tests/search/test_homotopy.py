"""Orbits followed along a line of numbers: predictions, ends, and what is told of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model.problem import ParameterValues
from zeno_orbits.search import homotopy
from zeno_orbits.search.homotopy import Followed, follow

EASY = ParameterValues(gains={"Kp": 1.0, "Kd": -1.0}, parameters={"R": 2.0})
WANTED = ParameterValues(gains={"Kp": 5.0, "Kd": -1.0}, parameters={"R": 1.0})
SCALE = np.array([7.0, 3.0])
SHAPE: Any = "the shape"


@dataclass(frozen=True)
class _Cycle:
    """A period as far as a path is concerned."""

    state: Vector
    period: float
    phases: tuple[Any, ...]
    scale: Vector = field(default_factory=lambda: SCALE)
    shape: Any = SHAPE

    @property
    def start(self) -> Any:
        return SimpleNamespace(state=self.state)

    def scale_at_events(self) -> Vector:
        return self.scale


def _phase(locked_time: float, speed: float, zeno_at: float = 0.0) -> Any:
    """Return a phase; its Zeno state is the acceleration with which the stop attracts."""
    zeno = None
    if locked_time > 0.0:
        zeno = SimpleNamespace(time=1.5, state=np.array([zeno_at]))
    impacts = (SimpleNamespace(approach_rate=-speed), SimpleNamespace(approach_rate=-speed / 9))
    return SimpleNamespace(zeno=zeno, end=SimpleNamespace(time=1.5 + locked_time), impacts=impacts)


def _at(values: ParameterValues) -> _Cycle:
    """Return the orbit at some numbers: its start is linear in them."""
    kp, r = values.number("Kp"), values.number("R")
    return _Cycle(
        state=np.array([2.0 * kp + 1.0, -r]),
        period=kp + r,
        phases=(_phase(locked_time=6.0 - kp, speed=r, zeno_at=2.0 * kp),),
        scale=SCALE * kp,
    )


@dataclass
class _Told:
    """What a path asked for, in order."""

    stages: list[str] = field(default_factory=list[str])
    guesses: list[Vector] = field(default_factory=list[Vector])
    scales: list[Vector] = field(default_factory=list[Vector])
    periods: list[float] = field(default_factory=list[float])
    parts: list[float] = field(default_factory=list[float])

    @property
    def search(self) -> Any:
        problem = SimpleNamespace(
            state_vector=lambda state: tuple(state.values()), state_units=("rad", "m")
        )
        return SimpleNamespace(dynamics=self.dynamics, tell=self.stages.append, problem=problem)

    def dynamics(self, values: ParameterValues) -> Any:
        self.parts.append((values.number("Kp") - 1.0) / 4.0)
        assert values.number("Kd") == -1.0
        return SimpleNamespace(values=values, gap_acceleration=lambda x: -float(x[0]))


@pytest.fixture(name="told")
def _told(monkeypatch: pytest.MonkeyPatch) -> _Told:
    """Replace what a path simulates by orbits that are known."""
    told = _Told()

    def close(dynamics: Any, start: Vector, *, scale: Vector, period: float, **rest: Any) -> Any:
        told.guesses.append(start)
        told.scales.append(scale)
        told.periods.append(period)
        assert rest["shape"] == SHAPE
        return SimpleNamespace(cycle=_at(dynamics.values))

    monkeypatch.setattr(homotopy, "Cycle", _Cycle)
    monkeypatch.setattr(homotopy, "close_cycle", close)
    monkeypatch.setattr(homotopy, "placed", lambda _dynamics, _shape, guess: guess)
    return told


def _follow(told: _Told, near: Any, easy: ParameterValues = EASY) -> Followed:
    return follow(told.search, near, easy, WANTED)


def test_starts_are_predicted_by_the_secant_of_the_last_two(told: _Told) -> None:
    near = _Cycle(state=np.array([2.9, -2.1]), period=3.1, phases=(), scale=np.array([1.0, 2.0]))
    reached = _follow(told, near)
    assert reached.arrived
    assert reached.values == WANTED
    assert reached.cycle is not None
    assert reached.cycle.start.state.tolist() == [11.0, -1.0]
    assert (reached.ending, reached.left) == ("", 0.0)
    # A quarter of the way, then steps that grow by half, and the last one ends at the numbers.
    assert told.parts == pytest.approx([0.0, 0.25, 0.625, 1.0], abs=1e-15)
    assert told.stages == [f"following orbits: {part} % of the way" for part in (25, 62, 100)]
    # The known orbit, the first one, and two exact predictions: starts are linear in the numbers.
    expected = [[2.9, -2.1], [3.0, -2.0], [8.0, -1.375], [11.0, -1.0]]
    assert np.array(told.guesses) == pytest.approx(np.array(expected), abs=1e-14)
    # Sizes and periods are those of the orbit before.
    assert np.array(told.scales) == pytest.approx(np.array([[1, 2], SCALE, 2 * SCALE, 3.5 * SCALE]))
    assert told.periods == pytest.approx([3.1, 3.0, 2.0 + 1.75, 3.5 + 1.375])


def test_an_orbit_of_a_file_is_measured_by_all_its_states(told: _Told) -> None:
    states = [{"x": 3.0, "y": -2.0}, {"x": -4.0, "y": 0.5}, {"x": 1.0, "y": 1.0}]
    near: Any = SimpleNamespace(states_at_events=states, shape=SHAPE, period=3.0)
    assert _follow(told, near).arrived
    assert told.guesses[0].tolist() == [3.0, -2.0]
    assert told.scales[0].tolist() == [4.0, 2.0]
    assert told.periods[0] == 3.0


def test_numbers_that_are_there_already_take_one_orbit(told: _Told) -> None:
    reached = _follow(told, _at(WANTED), easy=WANTED)
    assert reached.arrived
    assert reached.values == WANTED
    assert (told.parts, told.stages) == ([1.0], [])


@pytest.mark.parametrize("error", [SimulationError("no", time=0.0, state=()), InputError("no")])
def test_without_a_first_orbit_nothing_is_followed(
    told: _Told, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise error

    monkeypatch.setattr(homotopy, "close_cycle", fail)
    reached = _follow(told, _at(EASY))
    assert reached == Followed(cycle=None, values=EASY, arrived=False)


@pytest.mark.parametrize("error", [InputError, np.linalg.LinAlgError])
def test_numbers_of_no_machine_end_the_path_before_them(
    told: _Told, monkeypatch: pytest.MonkeyPatch, error: type[Exception]
) -> None:
    tried: list[float] = []

    def fails(dynamics: Any, _shape: Any, guess: Vector) -> Vector:
        tried.append((dynamics.values.number("Kp") - 1.0) / 4.0)
        if tried[-1] > 0.0:
            raise error("no machine")
        return guess

    monkeypatch.setattr(homotopy, "placed", fails)
    reached = _follow(told, _at(EASY))
    assert not reached.arrived
    assert reached.values == EASY
    assert reached.left == 1.0
    # Halved until less than a ten-thousandth of the way would be left of a step.
    assert tried == pytest.approx([0.0, *(0.25 / 2**k for k in range(12))], abs=1e-15)
    assert reached.ending == "Orbits could be followed to Kp = 1, R = 2, not beyond."


def test_the_end_of_a_path_is_told_with_the_margin_that_is_gone(
    told: _Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    close = homotopy.close_cycle

    def until_half(dynamics: Any, *rest: Any, **more: Any) -> Any:
        part = (dynamics.values.number("Kp") - 1.0) / 4.0
        if part > 0.5:
            raise SimulationError("no orbit", time=0.0, state=())
        closed = close(dynamics, *rest, **more)
        margin = _phase(locked_time=1.0 - 1.99 * part, speed=1.0, zeno_at=1.0 - part)
        cycle = closed.cycle
        phases = (_phase(locked_time=5.0, speed=1.0, zeno_at=9.0), margin)
        return SimpleNamespace(cycle=_Cycle(state=cycle.state, period=cycle.period, phases=phases))

    monkeypatch.setattr(homotopy, "close_cycle", until_half)
    reached = _follow(told, _at(EASY))
    assert not reached.arrived
    # The step that is given up was refused at no more than twice its length.
    assert 0.5 <= reached.left < 0.5 + 2e-4
    assert reached.cycle is not None
    assert reached.cycle.period == pytest.approx(reached.values.number("Kp") + 1.5, abs=1e-3)
    # Numbers that stay the same are not told.
    kp, r = (f"{reached.values.number(name):.5g}" for name in ("Kp", "R"))
    where = f"Orbits could be followed to Kp = {kp}, R = {r}, not beyond"
    assert reached.ending == f"{where}: there the locked arc shrinks to nothing."


# Margins.


def _machine() -> Any:
    return SimpleNamespace(gap_acceleration=lambda x: -float(x[0]))


def _margins(*phases: Any) -> dict[str, float]:
    cycle: Any = SimpleNamespace(phases=phases)
    return homotopy._margins(_machine(), cycle)


def test_the_margin_of_several_phases_is_the_least_of_them() -> None:
    found = _margins(_phase(0.5, 3.0, 2.0), _phase(0.25, 4.0, 5.0), _phase(0.75, 2.0, 4.0))
    assert found == {"first_impact_speed": 2.0, "locked_time": 0.25, "gap_acceleration": 2.0}


def test_an_orbit_that_the_stop_never_holds_has_the_speed_of_its_impacts_only() -> None:
    assert _margins(_phase(0.0, 3.0), _phase(0.0, 1.0)) == {"first_impact_speed": 1.0}


def test_a_phase_that_does_not_hold_has_no_part_in_the_margins_of_those_that_do() -> None:
    found = _margins(_phase(0.0, 3.0), _phase(0.5, 4.0, 2.0))
    assert found == {"first_impact_speed": 3.0, "locked_time": 0.5, "gap_acceleration": 2.0}


@pytest.mark.parametrize(
    ("last", "told"),
    [
        ({"locked_time": 0.079, "gap_acceleration": 1.0}, ": there the locked arc shrinks"),
        ({"locked_time": 4.0, "gap_acceleration": 0.039}, ": there d2h/dt2 at the Zeno point goes"),
        ({"first_impact_speed": 0.159}, ": there the first impact grazes."),
        # Least as a part of what it was, not as a number.
        ({"locked_time": 0.001, "first_impact_speed": 0.001}, ": there the first impact grazes."),
        # A fiftieth of what it was is not gone.
        ({"locked_time": 0.08, "gap_acceleration": 0.04, "first_impact_speed": 0.16}, ", not b"),
    ],
)
def test_a_margin_is_gone_below_a_fiftieth_of_what_it_was(
    last: Mapping[str, float], told: str
) -> None:
    def point(margins: Mapping[str, float]) -> Any:
        return SimpleNamespace(margins=margins, values=WANTED)

    first = {"locked_time": 4.0, "gap_acceleration": 2.0, "first_impact_speed": 8.0}
    ending = homotopy._ending(point(first), point({**first, **last}), EASY, WANTED)
    assert ending.startswith("Orbits could be followed to Kp = 5, R = 1, not beyond")
    assert told in ending
    assert ("there" in ending) is ("there" in told)
