"""A search restarts a run from a state on an event, which has a gap of rounding size.

Truth: flights of a linear oscillator in closed form, impacts by root finding, and multipliers by
saltation matrices, all in this file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq

import zeno_orbits as zo


@dataclass(frozen=True, kw_only=True)
class Shaken:
    """A mass ``m x'' + c x' + k (x + press) = A cos(omega t)`` between walls, with restitution."""

    A: float
    e: float
    m: float = 1.0
    c: float = 0.4
    k: float = 1.0
    press: float = 0.8
    omega: float = 1.0
    low: float = 0.0
    high: float = 50.0
    above: float = 1.0
    mirrored: bool = False

    def problem(self, form: str) -> zo.Problem:
        """Return it with one gap, one named stop, two stops, or one stop and a switch."""

        sign = -1.0 if self.mirrored else 1.0

        def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
            q, v, turns = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("turns")
            x = sign * q
            clock = zo.Clock.at(self.omega)
            stops = {"floor": x - self.low, "roof": self.high - x}
            contact: dict[str, Any] = {"gap": x - self.low}
            if form != "gap":
                n = 2 if form == "two stops" else 1
                contact = {
                    "stops": tuple(
                        zo.Stop(name=name, gap=gap, restitution=p["restitution"])
                        for name, gap in list(stops.items())[:n]
                    )
                }
            mass = zo.HybridLagrangian.from_energies(
                q=q,
                v=v,
                kinetic=self.m * v**2 / 2,
                potential=self.k * (x + self.press) ** 2 / 2,
                passive_force=-self.c * v,
                applied_force=sign * p["A"] * clock.cosine,
                clock=clock,
                **contact,
            )
            if form == "gap":
                return zo.hybrid_system(mass, zo.no_drive(mass), p["restitution"])
            if form != "switch":
                return zo.hybrid_system(mass, zo.no_drive(mass))
            count = zo.Auxiliary(states=turns, rate=-turns)
            turn = zo.Switch(
                name="turn", guard=clock.sine, armed=-clock.cosine, others_after=turns + 1.0
            )
            return zo.hybrid_system(mass, (count,), switches=(turn,))

        further = ("turns",) if form == "switch" else ()
        return zo.Problem(
            name="shaken",
            title="shaken mass",
            source="test",
            state_names=("q", "v", *further, "cosine", "sine"),
            state_units=("m", "m/s", *("1" for _ in further), "1", "1"),
            parameters=(
                zo.Quantity.positive("A", self.A, "N", "force"),
                zo.Quantity.restitution(self.e),
            ),
            gains=(),
            model=model,
            starts=({"q": sign * (self.low + self.above), "cosine": 1.0},),
            portraits=(("q", "v"),),
            amplitude_of="q",
        )

    def _steady(self, t: Any) -> tuple[Any, Any]:
        force = self.A / (self.k - self.m * self.omega**2 + 1j * self.c * self.omega)
        turned = force * np.exp(1j * self.omega * t)
        return turned.real - self.press, (1j * self.omega * turned).real

    def _after(self, t0: float, x0: float, v0: float, t: Any) -> tuple[Any, Any]:
        decay = self.c / (2 * self.m)
        own = math.sqrt(self.k / self.m - decay**2)
        x, v = self._steady(t0)
        a = x0 - x
        b = (v0 - v + decay * a) / own
        steady, rate = self._steady(t)
        d = t - t0
        fade, cosine, sine = np.exp(-decay * d), np.cos(own * d), np.sin(own * d)
        return (
            fade * (a * cosine + b * sine) + steady,
            fade * ((b * own - decay * a) * cosine - (a * own + decay * b) * sine) + rate,
        )

    def _height(self, t: float, t0: float, x0: float, v0: float, wall: float) -> float:
        return float(self._after(t0, x0, v0, t)[0] - wall)

    def _acceleration(self, t: float, x: float, v: float) -> float:
        drive = self.A * math.cos(self.omega * t)
        return (drive - self.c * v - self.k * (x + self.press)) / self.m

    def impacts(self, n_turns: int) -> list[tuple[float, float, float]]:
        """Return time, wall and approach velocity of every impact of many turns."""
        t, x, v = 0.0, self.low + self.above, 0.0
        found: list[tuple[float, float, float]] = []
        while t < n_turns * 2 * math.pi / self.omega:
            after = [*np.geomspace(1e-6, 1e-2, 40), *np.arange(0.02, 12.0, 0.01)]
            times = t + np.array(after) / self.omega
            places, _ = self._after(t, x, v, times)
            out = np.flatnonzero((places < self.low) | (places > self.high))
            if not out.size:
                places, speeds = self._after(t, x, v, times[-1:])
                t, x, v = float(times[-1]), float(places[0]), float(speeds[0])
                continue
            wall = self.low if places[out[0]] < self.low else self.high
            early, late = times[out[0] - 1 : out[0] + 1].tolist()
            hit = brentq(self._height, early, late, args=(t, x, v, wall), xtol=1e-15)
            speed = float(self._after(t, x, v, hit)[1])
            found.append((hit, wall, speed))
            t, x, v = hit, wall, -self.e * speed
        return found

    def orbit(self, n_turns: int = 60) -> tuple[float, int, np.ndarray]:
        """Return the period, the number of impacts, and the multipliers of the attractor."""
        found = self.impacts(n_turns)
        states = np.array(
            [(wall, v, math.cos(self.omega * t), math.sin(self.omega * t)) for t, wall, v in found]
        )
        for n in range(1, 40):
            if np.max(np.abs(states[-n:] - states[-2 * n : -n])) < 1e-7:
                break
        else:
            raise AssertionError("The attractor is not periodic.")
        period, jump = found[-1][0] - found[-1 - n][0], np.eye(2)
        decay = self.c / (2 * self.m)
        own = math.sqrt(self.k / self.m - decay**2)
        for (t0, _, _), (t1, wall, v) in pairwise(found[-1 - n :]):
            d = t1 - t0
            cosine, sine = math.cos(own * d), math.sin(own * d)
            flow = math.exp(-decay * d) * np.array(
                [
                    [cosine + decay / own * sine, sine / own],
                    [-(decay**2 + own**2) / own * sine, cosine - decay / own * sine],
                ]
            )
            before, after = (self._acceleration(t1, wall, u) for u in (v, -self.e * v))
            reset = np.array([[-self.e, 0.0], [(after + self.e * before) / v, -self.e]])
            jump = reset @ flow @ jump
        return period, n, np.linalg.eigvals(jump)


MACHINES = {
    "three impacts": Shaken(A=2.8, e=0.75),
    "three impacts, bouncy": Shaken(A=1.8, e=0.9),
    "17 impacts in two turns": Shaken(A=1.525, e=0.7, above=1.7),
    "11 impacts in three turns": Shaken(A=1.525, e=0.9),
    "between two walls": Shaken(A=2.0, e=0.8, press=0.0, low=-1.0, high=1.0, c=0.1),
    "between uneven walls": Shaken(A=2.0, e=0.8, press=0.3, low=-0.5, high=1.2, c=0.2),
    "under a roof": Shaken(A=2.2, e=0.8, mirrored=True),
    "heavy and slow": Shaken(A=5.0, e=0.75, m=2.5, k=1.5, c=0.9, press=1.1, omega=0.7),
    "small and fast": Shaken(A=0.28, e=0.7, m=1e-2, k=1.0, c=0.03, press=0.09, omega=11.0),
}


FORMS = {
    "three impacts": ("gap", "one stop", "two stops", "switch"),
    "three impacts, bouncy": ("one stop",),
    "under a roof": ("one stop",),
}


QUICK = ("three impacts, bouncy", "17 impacts in two turns", "between uneven walls")


@pytest.mark.parametrize(
    "name", [one if one in QUICK else pytest.param(one, marks=pytest.mark.slow) for one in MACHINES]
)
def test_every_form_of_a_machine_has_its_orbit(name: str) -> None:
    """Period and multipliers to the tolerance of root finding, 1e-15 s over 60 turns."""
    machine = MACHINES[name]
    period, n_impacts, multipliers = machine.orbit()
    for form in FORMS.get(name, ("two stops",)):
        section = "impact floor" if form == "switch" else None
        found = zo.search_gains(machine.problem(form), section=section)
        assert found.orbit is not None, (form, found.detail)
        assert found.orbit.period == pytest.approx(period, rel=1e-10), form
        struck = [one for one in found.orbit.events if one.name.startswith("impact ")]
        assert len(struck) == n_impacts, form
        # The counted turns add a multiplier. One that is below rounding is not listed.
        seen = np.array([*found.orbit.floquet_multipliers, 0.0])
        for one in multipliers:
            assert np.min(np.abs(seen - one)) < 1e-6, form


@pytest.mark.parametrize("form", ["gap", "one stop", "two stops"])
@pytest.mark.parametrize("name", ["three impacts", "heavy and slow", "under a roof"])
def test_a_run_goes_on_from_every_impact_of_another_run(name: str, form: str) -> None:
    """The impacts after it are those of the closed form, whatever rounding its gap has."""
    machine = MACHINES[name]
    problem = machine.problem(form)
    truth = np.array([t for t, _, _ in machine.impacts(8)])
    struck = zo.simulate(problem, until=20.0).impacts
    assert len(struck) > 5
    for impact in struck:
        state = dict(zip(problem.state_names, map(float, impact.state_plus), strict=True))
        again = zo.simulate(problem, until=10.0, start=state).impacts
        times = impact.time + np.array([one.time for one in again])
        after = truth[truth > impact.time + 1e-6][: len(times)]
        assert len(after) == len(times) > 1
        assert np.allclose(times, after, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("form", ["gap", "one stop", "two stops"])
def test_a_start_inside_of_a_stop_beyond_rounding_is_refused(form: str) -> None:
    """A gap of -1e-10 is a rounded file of an orbit, a gap of -1e-8 is inside of the stop."""
    problem = MACHINES["three impacts"].problem(form)
    begin = {"v": 1.0, "cosine": 1.0}
    on_it = zo.simulate(problem, until=6.0, start=begin).impacts
    rounded = zo.simulate(problem, until=6.0, start={**begin, "q": -1e-10}).impacts
    assert [one.time for one in rounded] == pytest.approx([one.time for one in on_it], abs=1e-8)
    for gap in (-1e-8, -1e-6, -0.5):
        with pytest.raises(zo.InputError, match=f"must have a gap >= 0.*but it is {gap:g}"):
            zo.simulate(problem, until=6.0, start={**begin, "q": gap})
