"""Events while a gap is below its tolerance, but belongs to a flight that is under way.

The truth is a mass of one coordinate under a force that is linear in time between switching times.
Its flights are cubic, and their roots are taken in 60 digits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi
import mpmath
import pytest

import zeno_orbits as zo
from tests.support.mechanisms import machine_of
from zeno_orbits.simulation import Impact, ZenoPoint

ca: Any = casadi
mp: Any = mpmath.mp
mpf: Any = mpmath.mpf
DIGITS, END = 60, mpf(10) ** -25
LOCATED = 1e-12
"""Of times [s]: rounding of a gap over the speeds of these flights, which are short."""


pytestmark = pytest.mark.usefixtures("both_loops")


@dataclass(frozen=True, kw_only=True)
class Mass:
    """A mass over a floor.

    Attributes:
        force: Time, acceleration of the gap and its slope from then on, for each piece.
        e: Restitution.
        height: Gap at the start.
        speed: Gap rate at the start.
        lever: Gap over the coordinate.
    """

    force: tuple[tuple[float, float, float], ...]
    e: float = 0.5
    height: float = 0.0
    speed: float = 0.0
    lever: float = 1.0


def machine(masses: tuple[Mass, ...], reset: float | None = None) -> zo.Problem:
    """Return masses that do not act on each other, and a switch that only counts at a time."""
    n = len(masses)

    def model(_parameters: Mapping[str, Any]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", n + 1), ca.SX.sym("v", n + 1)
        time, forces = q[n], []
        for mass in masses:
            (begin, first, slope), *_ = mass.force
            force = first + slope * (time - begin)
            for (_, _, before), (since, _, after) in zip(mass.force, mass.force[1:], strict=False):
                force += (after - before) * ca.fmax(time - since, 0)
            forces.append(force / mass.lever)
        stops = tuple(
            zo.Stop(name=f"floor {k}", gap=mass.lever * q[k], restitution=mass.e)
            for k, mass in enumerate(masses)
        )
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=ca.SX(0),
            applied_force=ca.vertcat(*forces, 0),
            stops=stops,
        )
        times = () if reset is None else (reset,)
        switches = tuple(zo.Switch(name="count", guard=one - time, v_after=v) for one in times)
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism), switches=switches)

    names = {f"q{k}": "m" for k in range(n + 1)} | {f"v{k}": "m/s" for k in range(n + 1)}
    start = {f"v{n}": 1.0}
    for k, mass in enumerate(masses):
        start |= {f"q{k}": mass.height / mass.lever, f"v{k}": mass.speed / mass.lever}
    return replace(machine_of(model, names), starts=(start,))


def _roots(coefficients: list[Any]) -> list[Any]:
    """Return the real roots of a polynomial, the highest power first."""
    while coefficients and coefficients[0] == 0:
        coefficients = coefficients[1:]
    if len(coefficients) < 2:
        return []
    roots = mp.polyroots(coefficients, maxsteps=500, extraprec=400)
    return [mp.re(one) for one in roots if abs(mp.im(one)) < mpf(10) ** -40 * abs(one)]


def truth(mass: Mass) -> tuple[list[Any], Any]:
    """Return the times of the impacts of a mass, and of their limit."""
    force: list[list[Any]] = [[mpf(one) for one in piece] for piece in mass.force]
    t: Any = force[0][0]
    q: Any = mpf(mass.height)
    v: Any = mpf(mass.speed)
    impacts = list[Any]()
    for (since, first, slope), end in zip(
        force, [*(piece[0] for piece in force[1:]), mp.inf], strict=True
    ):
        while t < end:
            a = first + slope * (t - since)
            cubic = [slope / 6, a / 2, v] + ([q] if q else [])
            falls = [h for h in _roots(cubic) if h > 0 and v + a * h + slope * h**2 / 2 < 0]
            if not falls or t + min(falls) > end:
                h = end - t
                q += v * h + a * h**2 / 2 + slope * h**3 / 6
                t, v = end, v + a * h + slope * h**2 / 2
                break
            h = min(falls)
            t, q, v = t + h, mpf(0), -mpf(mass.e) * (v + a * h + slope * h**2 / 2)
            impacts.append(t)
            if v < END:
                a = first + slope * (t - since)
                return impacts, t - 2 * v / (a * (1 - mpf(mass.e)))
    raise AssertionError("The mass does not come to rest.")


def thrown(rise: float, lever: float = 1.0, since: float = 0.0) -> Mass:
    """Return a mass whose stop opens at a time, by a force that rises for some time, then falls."""
    end = since + rise
    return Mass(force=((since, 0.0, 1.0), (end, end - since, -0.5)), lever=lever)


def falling(speed: float, at: float) -> Mass:
    """Return a mass that falls slowly, and has a tiny gap at a time, at which its force changes."""
    pull = 1e-3
    height = speed * at + pull * at**2 / 2 + speed * 1e-6
    return Mass(force=((0.0, -pull, 0.0), (at, -pull, -0.1)), height=height, speed=-speed)


def dropped(at: float) -> Mass:
    """Return a mass that lands at a time."""
    return Mass(force=((0.0, -1.0, 0.0),), height=at**2 / 2, e=0.3)


CASES: dict[str, tuple[tuple[Mass, ...], float | None]] = {
    "kink": ((thrown(3e-5),), None),
    "kink just after the release": ((thrown(3e-6),), None),
    "kink while gap and rate are below the tolerance": ((thrown(3e-7, since=0.5),), None),
    "kink while both are a ten thousandth of it": ((thrown(1e-8, since=0.5),), None),
    "kink over a lever": ((thrown(3e-5, lever=-2.0),), None),
    "reset": ((thrown(3e-5),), 4.5e-5),
    "another mass lands": ((thrown(6e-5, since=0.5), dropped(0.5 + 3e-5)), None),
    "an earlier mass lands": ((dropped(0.5 + 3e-5), thrown(6e-5, lever=2.0, since=0.5)), None),
    "kink before a slow landing": ((falling(1e-7, 0.3),), None),
    "reset before a slow landing": ((falling(1e-7, 0.3),), 0.3 - 1e-7),
    "another mass lands before a slow landing": ((falling(1e-7, 0.4), dropped(0.4)), None),
}


@pytest.mark.parametrize("name", CASES)
def test_an_event_during_a_flight_below_the_tolerance_of_the_gap_does_not_move_it(
    name: str,
) -> None:
    masses, reset = CASES[name]
    motion = zo.simulate(machine(masses, reset), until=1.0)
    with mp.workdps(DIGITS):
        for k, mass in enumerate(masses):
            impacts, limit = truth(mass)
            own = [one for one in motion.events if getattr(one, "stop", "") == f"floor {k}"]
            first = next(one for one in own if isinstance(one, Impact))
            (zeno,) = (one for one in own if isinstance(one, ZenoPoint))
            assert abs(first.time - impacts[0]) < LOCATED
            assert abs(zeno.time - limit) < LOCATED


def test_a_block_that_lifts_off_just_before_a_sample_of_its_record_comes_to_rest_in_time() -> None:
    # In 50 digits, by series of Taylor about each sample and impact.
    truth = 20.2604386623911523
    motion = zo.simulate("shaken_block", until=20.261)
    last = [one for one in motion.events if isinstance(one, ZenoPoint)][-1]
    assert last.time == pytest.approx(truth, abs=1e-11)
