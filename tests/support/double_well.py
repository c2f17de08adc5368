"""A shaken mass on a stop beside another one on a spring or in a double well.

The masses do not feel each other. That in the well, ``y'' = k y (1 - b y^2) - c y'``, has rest
points at 0, which repels, and at ``b^-1/2``, which attracts: two periodic orbits in one box. Sets
of the shaken mass are those of a certificate in closed form; to them the other mass is added, in
sixty digits.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import mpmath as mp

from tests.support.certificates import digest_of, text_of
from zeno_orbits import (
    Clock,
    CompletedSystem,
    HybridLagrangian,
    Problem,
    Quantity,
    hybrid_system,
    no_drive,
)

WIDTH = 2.0**-20
"""Distance of the rest points of the double well."""
_ORDER = 24


class Well(NamedTuple):
    """Numbers of ``y'' = stiff y (1 - bend y^2) - damped y'``."""

    stiff: float
    bend: float
    damped: float


DOUBLE = Well(2.0**-9, WIDTH**-2, 2.0**-6)
HALF_AS_FAST = Well(-0.25, 0.0, 0.0)
"""A free spring of half the frequency of the shaking."""


def _model(p: Mapping[str, ca.SX], well: Well) -> CompletedSystem:
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    clock = Clock.at(p["omega"])
    pit = well.stiff * (well.bend * q[1] ** 4 / 4 - q[1] ** 2 / 2)
    masses = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=p["m"] * v[0] ** 2 / 2 + v[1] ** 2 / 2,
        potential=p["k"] * (p["stop"] - q[0]) ** 2 / 2 + pit,
        gap=q[0],
        passive_force=ca.vertcat(-p["c"] * v[0], -well.damped * v[1]),
        applied_force=ca.vertcat(-p["A"] * clock.cosine, 0),
        clock=clock,
    )
    return hybrid_system(masses, no_drive(masses), p["restitution"])


_DOUBLE_WELL = Problem(
    name="two_masses",
    title="two masses that do not feel each other",
    source="made for a test",
    state_names=("distance", "y", "speed", "dy", "cosine", "sine"),
    state_units=("m", "m", "m/s", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 1.0, "kg", "mass"),
        Quantity(name="c", unit="N s/m", meaning="damping", default=1.9),
        Quantity(name="k", unit="N/m", meaning="stiffness", default=1.0),
        Quantity(name="A", unit="N", meaning="amplitude", default=1.0),
        Quantity.positive("omega", 1.0, "rad/s", "frequency"),
        Quantity(name="stop", unit="m", meaning="place of the stop", default=-0.8),
        Quantity.restitution(0.5),
    ),
    gains=(),
    model=partial(_model, well=DOUBLE),
    starts=({"cosine": 1.0},),
    portraits=(("distance", "speed"),),
    amplitude_of="distance",
)


def problem_of(well: Well) -> Problem:
    """Return the two masses."""
    return replace(_DOUBLE_WELL, model=partial(_model, well=well))


def _moved(z: list[Any], h: Any, well: Well) -> tuple[list[Any], Any]:
    """Return the mass in the well after a time, and its derivative by the start."""
    y, v = [z[0]], [z[1]]
    V = [mp.eye(2)]
    for k in range(_ORDER):
        square = [sum(y[i] * y[j - i] for i in range(j + 1)) for j in range(k + 1)]
        cube = sum(square[j] * y[k - j] for j in range(k + 1)) * well.bend
        y.append(v[k] / (k + 1))
        v.append((well.stiff * (y[k] - cube) - well.damped * v[k]) / (k + 1))
        slopes = [well.stiff * (int(j == 0) - 3 * square[j] * well.bend) for j in range(k + 1)]
        last = mp.zeros(2)
        for col in range(2):
            last[0, col] = V[k][1, col] / (k + 1)
            pulled = sum(slopes[j] * V[k - j][0, col] for j in range(k + 1))
            last[1, col] = (pulled - well.damped * V[k][1, col]) / (k + 1)
        V.append(last)
    both = [mp.polyval(one[::-1], h) for one in (y, v)]
    total = mp.zeros(2)
    for k, one in enumerate(V):
        total += one * h**k
    return both, total


def _set(
    shaken: Mapping[str, Any], z: list[Any], C: Any, R: Any, r: Any, apart: Any
) -> dict[str, Any]:
    """Return a set of the shaken mass with the other one; what they feel of each other is 0."""
    at, zero = (0, 2, 4, 5), "0x0p+0"
    m, rows, radii = [zero] * 6, [[zero] * 2 for _ in range(6)], [zero] * 6
    wide = [[text_of(0)] * 2 for _ in range(6)]
    for k, place in enumerate(at):
        m[place], radii[place] = shaken["m"][k], shaken["r"][k]
        wide[place] = [text_of(apart[k] + mp.mpf(2) ** -160)] * 2
        if shaken["r"][k] == text_of(0):
            wide[place] = [zero] * 2
    for k, place in enumerate((1, 3)):
        m[place], radii[place] = text_of(z[k]), text_of(r[k])
        rows[place] = [text_of(C[k, j]) for j in range(2)]
        wide[place] = [text_of(R[k, j]) for j in range(2)]
    Q = [[text_of(int(i == j)) for j in range(6)] for i in range(6)]
    return {"m": m, "C": rows, "Q": Q, "r": radii, "R": wide}


def _grown(apart: list[Any], kind: str, h: Any) -> list[Any]:
    """Return bounds of what the shaken mass feels, of its gap, speed and clock, after a record."""
    everything, least = sum(apart), mp.mpf(2) ** -160
    if not apart[1]:
        # On the stop the clock alone moves.
        return [
            mp.mpf(0),
            mp.mpf(0),
            *(3 * x if kind == "cross" else x + h * everything for x in apart[2:]),
        ]
    gap, speed, *clock = (x + 2 * h * everything for x in apart)
    if kind == "cross":
        # A flight takes twice its speed by its acceleration, and the delay is the gap by the speed.
        late = gap + 2 * h * everything
        speed, clock = speed * mp.mpf("3.2") + 3 * late, [x + 8 * (speed + late) for x in clock]
    if kind == "impact":
        speed *= mp.mpf("0.505")
    if kind == "tail":
        return [mp.mpf(0), mp.mpf(0), *(x + mp.mpf(2) ** -20 for x in clock)]
    return [gap if kind == "step" else mp.mpf(0), *(x + least for x in (speed, *clock))]


def _number(text: str) -> Any:
    mantissa, exponent = text.replace("0x", "").split("p")
    return mp.mpf(int(mantissa, 16)) * mp.mpf(2) ** int(exponent)


def pass_around(
    shaken: Mapping[str, Any], y: float, radius: float, well: Well = DOUBLE
) -> dict[str, Any]:
    """Return a period of both masses from a box of the one in the well.

    Args:
        shaken: A certificate of the shaken mass alone, its section without coordinates.
        y: Middle of the box, at rest.
        radius: Its radius, and 16 times that of its speed.
        well: Where the other mass is.
    """
    one = shaken["passes"][0]
    with mp.workdps(60):
        z, C, speed = [mp.mpf(y), mp.mpf(0)], mp.eye(2), radius / 16
        R, r = mp.ones(2) * mp.mpf(2) ** -30, mp.matrix([mp.mpf(2) ** -110] * 2)
        start = _set(one["start"], z, C, R, r, [mp.mpf(2) ** -160] * 4)
        records, apart = list[dict[str, Any]](), [mp.mpf(2) ** -160] * 4
        for record in one["records"]:
            made, slack, h = copy.deepcopy(record), mp.mpf(2) ** -100, mp.mpf(0)
            if record["kind"] in ("step", "cross"):
                times = record.get("centre", [record["h"]] * 2)
                h = sum(map(_number, times)) / 2
                reach = [abs(C[0, j]) + R[0, j] for j in range(2)]
                spread = reach[0] * radius + reach[1] * speed + h * speed * 4
                bend = 3 * abs(well.stiff) * (2 * abs(z[0]) * spread + spread**2) * well.bend
                z, slope = _moved(z, h, well)
                size = mp.matrix([[abs(slope[i, j]) for j in range(2)] for i in range(2)])
                more = mp.matrix([[h * h * bend, h**3 * bend], [h * bend, h * h * bend]])
                C, old = slope * C, mp.matrix([[abs(C[i, j]) for j in range(2)] for i in range(2)])
                R = size * R * mp.mpf("1.01") + more * (old + R) * 2 + mp.ones(2) * mp.mpf(2) ** -40
                r, slack = (size + 2 * more) * r * mp.mpf("1.01"), mp.mpf(2) ** -100
            if record["kind"] == "tail":
                made["radius"] = [text_of(mp.mpf("1e-4"))] * 6
                slack = mp.mpf(2) ** -40
                R = R + mp.ones(2) * mp.mpf(2) ** -20
            apart = _grown(apart, record["kind"], h)
            r = r + mp.matrix([slack] * 2)
            made["set"] = _set(record["set"], z, C, R, r, apart)
            records.append(made)
    box = {
        "centre": [text_of(y), text_of(0)],
        "radius": [text_of(radius), text_of(speed)],
        "others": one["box"]["others"],
    }
    return {"box": box, "start": start, "records": records}


def basis_at(y: float) -> dict[str, Any]:
    """Return the eigenvectors of the flow at a rest point, as a basis of the checker's norm."""
    slope = DOUBLE.stiff * (1 - 3 * y * y * DOUBLE.bend)
    with mp.workdps(60):
        _, vectors = mp.eig(mp.matrix([[0, 1], [slope, -DOUBLE.damped]]))
        parts = {"re": mp.re, "im": mp.im}
        return {
            name: [[text_of(part(vectors[i, j])) for j in range(2)] for i in range(2)]
            for name, part in parts.items()
        }


def certificate_of(
    shaken: Mapping[str, Any],
    passes: list[dict[str, Any]],
    claims: list[dict[str, Any]],
    problem: Problem,
) -> dict[str, Any]:
    """Return a certificate of both masses."""
    return {
        **shaken,
        "problem": problem.name,
        "digest": digest_of(problem),
        "section": {"conditions": ["gap", "gap_rate", "multiplier"], "places": [1, 3]},
        "passes": passes,
        "claims": claims,
    }
