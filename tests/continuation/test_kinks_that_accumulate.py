"""A kink in every flight of impacts that accumulate does not belong to the event sequence."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.one_mass import one_mass
from zeno_orbits.arrays import Vector
from zeno_orbits.continuation import (
    ContinuationSettings,
    Family,
    FamilySteps,
    SpecialPointKind,
    family_of_orbit,
)
from zeno_orbits.maps import AttractorClass


@dataclass(frozen=True, slots=True, kw_only=True)
class Damped:
    """A spring with a damper that has a kink at rest, driven against a stop at `place`.

    Attributes:
        symbolic: Force of the damper.
        number: The same force of a number.
        amplitude: Amplitude of the drive.
        place: Place of the stop.
        box: Range of the coefficient of restitution.
    """

    symbolic: Callable[[ca.SX], ca.SX]
    number: Callable[[float], float]
    amplitude: float
    place: float
    box: tuple[float, float]

    def problem(self) -> zo.Problem:
        return one_mass(
            lambda m: -m.x - self.symbolic(m.v) + m.p["A"] * m.cosine,
            stops=lambda m: (zo.Stop(name="wall", gap=self.place - m.x, restitution=m.p["e"]),),
            start={"cosine": 1.0},
            omega=0.8,
            A=self.amplitude,
            e=sum(self.box) / 2,
        )

    def contact(self, e: float) -> float:
        """Return the duration of contact by another integrator, from release to release."""
        omega = 0.8
        # The wall lets go where the drive is weaker than the spring.
        released = np.arccos(self.place / self.amplitude) / omega

        def rate(t: float, y: Vector) -> list[float]:
            drive = self.amplitude * np.cos(omega * t)
            return [y[1], -y[0] - self.number(float(y[1])) + drive]

        def gap(_: float, y: Vector) -> float:
            return float(self.place - y[0])

        vars(gap).update(terminal=True, direction=-1.0)
        y, t = np.array([self.place, 0.0]), released
        fast = 0.0
        while True:
            # A flight starts on the wall: the first crossing does not count.
            ahead: Any = solve_ivp(rate, (t, t + 1e-9), y, rtol=1e-12, atol=1e-14)
            found: Any = solve_ivp(
                rate, (t + 1e-9, t + 20.0), ahead.y[:, -1], events=gap, rtol=1e-12, atol=1e-14
            )
            t = float(found.t_events[0][0])
            y = np.array([self.place, -e * float(found.y_events[0][0][1])])
            fast = max(fast, -float(y[1]))
            if -y[1] < 1e-5 * fast:
                break
        push = self.amplitude * np.cos(omega * t) - self.place
        # The rest of the flights is a geometric series.
        zeno = t - 2 * y[1] / push / (1 - e)
        return float(released + 2 * np.pi / omega - zeno)


QUADRATIC = Damped(
    symbolic=lambda v: 0.4 * ca.fabs(v) * v,
    number=lambda v: 0.4 * abs(v) * v,
    amplitude=2.0,
    place=0.5,
    box=(0.2, 0.3),
)
MACHINES = {
    "quadratic drag": QUADRATIC,
    "one-sided": Damped(
        symbolic=lambda v: 0.5 * ca.fmax(v, 0.0),
        number=lambda v: 0.5 * max(v, 0.0),
        amplitude=1.8,
        place=0.4,
        box=(0.15, 0.26),
    ),
    "two rates": Damped(
        symbolic=lambda v: ca.if_else(v > 0.0, 0.2 * v, 0.7 * v),
        number=lambda v: 0.2 * v if v > 0.0 else 0.7 * v,
        amplitude=2.5,
        place=0.8,
        box=(0.25, 0.33),
    ),
    "lesser of two": Damped(
        symbolic=lambda v: ca.fmin(0.2 * v, 0.6 * v),
        number=lambda v: min(0.2 * v, 0.6 * v),
        amplitude=2.2,
        place=0.3,
        box=(0.1, 0.2),
    ),
    "cubic and linear": Damped(
        symbolic=lambda v: 0.1 * v + 0.2 * v**2 * ca.fabs(v) * ca.sign(v),
        number=lambda v: 0.1 * v + 0.2 * v**3,
        amplitude=3.0,
        place=1.0,
        box=(0.22, 0.32),
    ),
}


@cache
def _orbit(name: str) -> zo.Orbit:
    return zo.find_orbit(MACHINES[name].problem()).unwrap()


def _family(name: str) -> Family:
    machine = MACHINES[name]
    few = ContinuationSettings(doublings=0, steps=FamilySteps(first=0.3, longest=0.4))
    found = family_of_orbit(machine.problem(), _orbit(name), "e", machine.box, settings=few)
    return found.families[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", fast(1, sorted(MACHINES, reverse=True)))
def test_a_family_goes_on_where_the_number_of_resolved_flights_changes(name: str) -> None:
    family = _family(name)
    assert [family.first.kind, family.last.kind] == 2 * [SpecialPointKind.BOUND]
    assert not family.special
    for end in (family.first, family.last):
        locked = end.at.margins["contact duration, release wall"]
        assert locked == pytest.approx(MACHINES[name].contact(end.at.value), abs=2e-7)


@pytest.mark.parametrize("name", ["quadratic drag", "one-sided"])
def test_a_kink_of_accumulating_flights_is_listed_and_is_no_entry_of_the_sequence(
    name: str,
) -> None:
    orbit = _orbit(name)
    assert orbit.certificate["passed"]
    flights = sum(event.name == "impact wall" for event in orbit.events) - 1
    kinks = [event.name for event in orbit.events if event.name.startswith("switch ")]
    assert len(kinks) >= flights > 3
    # The one kink is between the release and the first impact.
    assert orbit.sequence == ("release wall", "switch kink 1", "zeno wall")


@pytest.mark.slow
def test_a_list_without_a_kink_of_an_accumulating_flight_is_verified() -> None:
    orbit = _orbit("quadratic drag")
    at = [event.name for event in orbit.events].index("impact wall") + 1
    assert orbit.events[at].name == "switch kink 1"
    fewer = replace(orbit, events=(*orbit.events[:at], *orbit.events[at + 1 :]))
    assert zo.verify(fewer, problem=MACHINES["quadratic drag"].problem()).passed
    # An impact less is another motion.
    at = max(k for k, event in enumerate(orbit.events) if event.name.startswith("impact "))
    other = replace(orbit, events=(*orbit.events[:at], *orbit.events[at + 1 :]))
    assert not zo.verify(other, problem=MACHINES["quadratic drag"].problem()).passed


def test_a_file_whose_sequence_names_these_kinks_is_read(tmp_path: Path) -> None:
    orbit = _orbit("quadratic drag")
    path = tmp_path / "orbit.json"
    path.write_text(json.dumps(orbit.as_json()))
    entries = json.loads(path.read_text())
    names = [event.name for event in orbit.events]
    # Former versions had an entry of every impact that a kink follows.
    entries["sequence"] = [name for k, name in enumerate(names) if names[k + 1 : k + 2] != [_ZENO]]
    path.write_text(json.dumps(entries))
    assert zo.read_orbit(path).period == orbit.period
    entries["sequence"] = ["release wall", "impact wall", "zeno wall"]
    path.write_text(json.dumps(entries))
    with pytest.raises(zo.OrbitFileError, match="its `sequence` is"):
        zo.read_orbit(path)


_ZENO = "zeno wall"


def test_a_kink_of_accumulating_flights_is_no_section() -> None:
    problem = MACHINES["quadratic drag"].problem()
    with pytest.raises(zo.InputError, match="`switch kink 1`, whose events accumulate: take `zeno"):
        zo.find_orbit(problem, section="switch kink 1").unwrap()


def test_neighbours_on_a_map_are_of_one_kind() -> None:
    machine = MACHINES["quadratic drag"]
    low, high = machine.box
    found = zo.parameter_map(machine.problem(), x=("e", low, high, 4), y=("A", 1.9, 2.1, 2))
    assert {one.fate for one in found.attractors} == {AttractorClass.ZENO}
    assert {one.sequence for one in found.attractors} == {_orbit("quadratic drag").sequence}
