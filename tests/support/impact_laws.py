"""Balls whose restitution depends on the impact speed, and their motions by recursion.

A flight that leaves the floor at the speed ``w`` strikes it again at ``w`` after ``2 w / g``. So
the speeds follow ``v' = e(v) v``, and all times are sums of quotients.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca
import mpmath as mp

import zeno_orbits as zo

Law = Callable[[Any, Mapping[str, Any], Any], Any]
"""From speed, parameters and a module of functions (casadi or mpmath) to the restitution."""

DIGITS = 60


class Reference:
    """The functions of a law for numbers of many digits."""

    fmin, sqrt, exp = staticmethod(min), mp.sqrt, mp.exp


LAWS: Mapping[str, Law] = {
    "linear": lambda v, p, _: p["e0"] - p["c"] * v,
    "exponential": lambda v, p, f: p["e0"] * f.exp(-p["c"] * v),
    "capped power": lambda v, p, f: f.fmin(p["e0"], p["e0"] * (v / 0.01) ** (-p["c"])),
    "late cap": lambda v, p, f: f.fmin(p["e0"], p["e0"] * (v / 0.0001) ** (-p["c"])),
    "root": lambda v, p, f: p["e0"] - p["c"] * f.sqrt(v),
    "fifth root": lambda v, p, _: p["e0"] - p["c"] * v**0.2,
}
"""Laws that are analytic at zero, that have a kink, or a root there."""

PARAMETERS = (
    zo.Quantity.positive("g", 9.81, "m/s^2", "gravity"),
    zo.Quantity(name="e0", unit="1", meaning="restitution at speed zero", default=0.8),
    zo.Quantity(name="c", unit="s/m", meaning="fall of the restitution", default=0.03),
    zo.Quantity(name="e1", unit="1", meaning="restitution of the roof", default=0.9),
    zo.Quantity(name="c1", unit="s/m", meaning="fall of the restitution of the roof", default=0.02),
)


def ball(law: Law, *, drive: Callable[[Any, Any], Any] | None = None) -> zo.Problem:
    """Return a ball on a floor with a law.

    Args:
        law: The law.
        drive: Function from the mechanism and the parameters to its drive.
    """

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        h, v = ca.SX.sym("h"), ca.SX.sym("v")
        one = zo.HybridLagrangian.from_energies(
            q=h, v=v, kinetic=v**2 / 2, potential=p["g"] * h, gap=h
        )
        return zo.hybrid_system(
            one, zo.no_drive(one) if drive is None else drive(one, p), law(zo.impact_speed, p, ca)
        )

    return _problem(model, PARAMETERS[:3])


def ball_under_roof(height: float = 1.0) -> zo.Problem:
    """Return a ball between floor and roof, each with a linear law of its own.

    Args:
        height: Height of the roof [m].
    """

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        h, v = ca.SX.sym("h"), ca.SX.sym("v")
        floor = zo.Stop(name="floor", gap=h, restitution=p["e0"] - p["c"] * zo.impact_speed)
        roof = zo.Stop(name="roof", gap=height - h, restitution=p["e1"] - p["c1"] * zo.impact_speed)
        one = zo.HybridLagrangian.from_energies(
            q=h, v=v, kinetic=v**2 / 2, potential=p["g"] * h, stops=(floor, roof)
        )
        return zo.hybrid_system(one, zo.no_drive(one))

    return _problem(model, PARAMETERS)


def _problem(model: Any, parameters: tuple[zo.Quantity, ...]) -> zo.Problem:
    return zo.Problem(
        name="ball_of_law",
        title="ball with a law of impact",
        source="a test",
        state_names=("h", "v"),
        state_units=("m", "m/s"),
        parameters=parameters,
        gains=(),
        model=model,
        starts=({"h": 0.5},),
        portraits=(("h", "v"),),
        amplitude_of="h",
    )


class Fall(NamedTuple):
    """A motion by recursion: name of the stop, time and speed of every impact, and the Zeno time.

    Impacts slower than the last digits are left out.
    """

    stops: list[str]
    times: list[Any]
    speeds: list[Any]
    zeno_time: Any


def dropped(law: Law, numbers: Mapping[str, float], height: float = 0.5) -> Fall:
    """Return the motion of a ball dropped on the floor, to ``DIGITS``."""
    with mp.workdps(DIGITS + 10):
        p = {name: mp.mpf(value) for name, value in numbers.items()}
        v = mp.sqrt(2 * p["g"] * mp.mpf(height))
        return _on_floor(law, p, v / p["g"], v, [])


def thrown(numbers: Mapping[str, float], speed: float, height: float = 1.0) -> Fall:
    """Return the motion of a ball thrown up from the floor, under the roof.

    Args:
        numbers: Parameters.
        speed: Speed at the start [m/s].
        height: Height of the roof [m].
    """
    with mp.workdps(DIGITS + 10):
        p = {name: mp.mpf(value) for name, value in numbers.items()}
        g, w, time, known = p["g"], mp.mpf(speed), mp.mpf(0), list[tuple[str, Any, Any]]()
        while w**2 > 2 * g * height:
            above = mp.sqrt(w**2 - 2 * g * height)
            time += (w - above) / g
            known.append(("roof", time, above))
            down = (p["e1"] - p["c1"] * above) * above
            v = mp.sqrt(down**2 + 2 * g * height)
            time += (v - down) / g
            known.append(("floor", time, v))
            w = (p["e0"] - p["c"] * v) * v
        return _on_floor(LAWS["linear"], p, time + 2 * w / g, w, known)


def _on_floor(law: Law, p: Mapping[str, Any], time: Any, v: Any, known: Sequence[Any]) -> Fall:
    rows = list(known)
    while v > mp.mpf(10) ** -DIGITS:
        rows.append(("floor", time, v))
        v *= law(v, p, Reference)
        time += 2 * v / p["g"]
    stops, times, speeds = (list(column) for column in zip(*rows, strict=True))
    return Fall(stops, times, speeds, time)
