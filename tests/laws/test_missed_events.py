"""Narrow events of motions that need few steps: holes of the multiplier, bumps in the way, spots.

Between events every motion here is a polynomial in time, so steps grow to the horizon, and only
the guard itself tells how fast it varies. Each truth is a closed form, or the first root of an
elementary function of time, bracketed by a grid that a Lipschitz bound makes complete. The numbers
are new in every run. A failure prints their seed.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import DOP853, LSODA
from scipy.optimize import brentq

from tests.support.cases import fast
from tests.support.mechanisms import numeric, slider
from zeno_orbits import HybridLagrangian
from zeno_orbits.integrators import Engine, Radau, RungeKutta, SciPy
from zeno_orbits.model import HybridDynamics
from zeno_orbits.simulation import Impact, Release, SimulationSettings, simulate

SEED = secrets.randbits(32)
G = 9.81
LOCATED = 1e-9
"""Of an event's time, relative to the run: roots are found to 1e-13 times the slowness of a graze,
and grazes slower than 1e-4 of the guard's size are not drawn."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A motion and its first event.

    Attributes:
        dynamics: The machine.
        start: Its first state.
        until: Length of the run [s].
        event: Kind of the first event.
        time: Of the first event [s]; infinite if there is none.
    """

    dynamics: HybridDynamics
    start: tuple[float, ...]
    until: float
    event: type[Impact] | type[Release]
    time: float


Family = Callable[[np.random.Generator], Case | None]
Formula = Callable[[ca.SX], ca.SX]


def _slide(pull: Formula, start: float, speed: float, until: float, time: float) -> Case:
    """Return a mass of 1 kg that slides along a stop with the multiplier ``1 - pull(x)``."""
    dynamics = slider(lambda x: pull(x) - 1)
    state = (start, 0.0, speed, 0.0)
    return Case(dynamics=dynamics, start=state, until=until, event=Release, time=time)


def _thrown(
    gap: Callable[[ca.SX, ca.SX], ca.SX], start: tuple[float, ...], until: float, time: float
) -> Case:
    """Return a mass of 1 kg that is thrown over a ground, or past an obstacle."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    machine = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=ca.sumsqr(v) / 2, potential=G * q[1], gap=gap(q[0], q[1])
    )
    dynamics = numeric(machine, restitution=0.5)
    return Case(dynamics=dynamics, start=start, until=until, event=Impact, time=time)


def _first_root(
    function: Callable[[np.ndarray], np.ndarray], until: float, slope: float, finest: float
) -> float | None:
    """Return the first root of a function, infinity if it has none, nothing if it is too close.

    Args:
        function: Positive at zero.
        until: End of the search.
        slope: Bound of the modulus of its derivative: a grid cannot step over a root unseen.
        finest: Smallest value that is told from a root.
    """
    at = 0.0
    while at < until:
        value = float(function(np.array(at)))
        if value < finest:
            before, after = max(0.0, at - 4 * finest / slope), at + 4 * finest / slope
            if float(function(np.array(after))) > -finest / 8 or before == 0.0:
                return None
            return float(brentq(lambda t: float(function(np.array(t))), before, after, xtol=1e-15))
        at += value / slope
    return math.inf


def gaussian_hole(rng: np.random.Generator) -> Case | None:
    """Slide at constant speed over a hole of the multiplier: ``1 - d exp(-((x - c) / w)^2)``."""
    until, speed = 10.0 ** rng.uniform(-1, 2), 10.0 ** rng.uniform(-2, 2)
    path = until * speed
    depth = rng.uniform(1.01, 5.0)
    width = path * 10.0 ** rng.uniform(-3.5, -1)
    reach = width * math.sqrt(math.log(depth))
    centre = rng.uniform(1.1 * reach + 0.05 * path, 0.95 * path)
    return _slide(
        lambda x: depth * ca.exp(-(((x - centre) / width) ** 2)),
        0.0,
        speed,
        until,
        (centre - reach) / speed,
    )


def sinusoidal_ground(rng: np.random.Generator) -> Case | None:
    """Throw over a ground ``a sin(k x)``."""
    up, along, height = rng.uniform(0, 5), rng.uniform(0.5, 20), rng.uniform(0.2, 3)
    flight = (up + math.sqrt(up**2 + 2 * G * height)) / G
    wave = 2 * math.pi * rng.uniform(0.5, 40) / (along * flight)
    size = rng.uniform(0.02, 0.9) * height
    phase = rng.uniform(0, 2 * math.pi)
    until = 1.5 * flight + 1.0

    def gap(t: np.ndarray) -> np.ndarray:
        ground = size * np.sin(wave * along * t + phase)
        return height + up * t - G * t**2 / 2 - ground

    slope = up + G * until + size * wave * along
    time = _first_root(gap, until, slope, 1e-4 * size)
    if time is None:
        return None
    return _thrown(
        lambda x, y: y - size * ca.sin(wave * x + phase), (0.0, height, along, up), until, time
    )


def gaussian_bump(rng: np.random.Generator) -> Case | None:
    """Throw over flat ground with one bump ``a exp(-((x - c) / w)^2)``."""
    up, along, height = rng.uniform(0, 5), rng.uniform(0.5, 20), rng.uniform(0.2, 3)
    flight = (up + math.sqrt(up**2 + 2 * G * height)) / G
    path = along * flight
    width, centre = path * 10.0 ** rng.uniform(-3, -1), path * rng.uniform(0.2, 0.9)
    size = rng.uniform(0.2, 3) * height
    until = 1.2 * flight

    def gap(t: np.ndarray) -> np.ndarray:
        bump = size * np.exp(-(((along * t - centre) / width) ** 2))
        return height + up * t - G * t**2 / 2 - bump

    time = _first_root(gap, until, up + G * until + size / width * along, 1e-4 * size)
    if time is None:
        return None
    return _thrown(
        lambda x, y: y - size * ca.exp(-(((x - centre) / width) ** 2)),
        (0.0, height, along, up),
        until,
        time,
    )


def magnet_spot(rng: np.random.Generator) -> Case | None:
    """Slide past a magnet with far tails, of the pull ``d w^2 / (w^2 + (x - c)^2)``."""
    until, speed = 10.0 ** rng.uniform(-1, 2), 10.0 ** rng.uniform(-2, 2)
    path, depth = until * speed, rng.uniform(1.01, 5.0)
    width = path * 10.0 ** rng.uniform(-3.5, -1.5)
    reach = width * math.sqrt(depth - 1.0)
    centre = rng.uniform(1.1 * reach + 0.05 * path, 0.95 * path)
    return _slide(
        lambda x: depth * width**2 / (width**2 + (x - centre) ** 2),
        0.0,
        speed,
        until,
        (centre - reach) / speed,
    )


def thin_pole(rng: np.random.Generator) -> Case | None:
    """Throw past a pole: the gap is the distance from its middle, less its radius."""
    up, along = rng.uniform(1, 6), rng.uniform(0.5, 20)
    until = 2.0
    path = along * until
    radius, when = path * 10.0 ** rng.uniform(-3.5, -1.5), rng.uniform(0.3, 1.8)
    centre = along * when, up * when - G * when**2 / 2 + radius * rng.uniform(-2, 2)

    def distance(t: np.ndarray) -> np.ndarray:
        return np.hypot(along * t - centre[0], up * t - G * t**2 / 2 - centre[1]) - radius

    if float(distance(np.array(0.0))) <= radius:
        return None
    time = _first_root(distance, until, along + up + G * until, 1e-4 * radius)
    if time is None:
        return None

    def gap(x: ca.SX, y: ca.SX) -> ca.SX:
        return ca.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2) - radius

    return _thrown(gap, (0.0, 0.0, along, up), until, time)


def cam_tooth(rng: np.random.Generator) -> Case | None:
    """Turn a cam at constant speed: its tooth ``exp(k (cos(a - b) - 1))`` meets a resting follower.

    The follower weighs nothing that falls: it rests at ``r`` off the base circle.
    """
    speed, rest = 10.0 ** rng.uniform(-1, 2), rng.uniform(0.2, 0.98)
    sharp = 10.0 ** rng.uniform(1, 5)
    reach = math.acos(max(-1.0, 1.0 + math.log(rest) / sharp))
    turn = rng.uniform(1.1 * reach, 2 * math.pi - 1.1 * reach)
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    machine = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=ca.sumsqr(v) / 2,
        potential=ca.SX(0),
        gap=q[1] - ca.exp(sharp * (ca.cos(q[0] - turn) - 1)),
    )
    return Case(
        dynamics=numeric(machine, restitution=0.5),
        start=(0.0, rest, speed, 0.0),
        until=2 * math.pi / speed,
        event=Impact,
        time=(turn - reach) / speed,
    )


def _drawn(family: Family, n: int) -> Iterator[Case]:
    rng = np.random.default_rng([SEED, sum(map(ord, family.__name__))])
    while n > 0:
        case = family(rng)
        if case is not None:
            n -= 1
            yield case


FAMILIES = (gaussian_hole, sinusoidal_ground, gaussian_bump, magnet_spot, thin_pole, cam_tooth)


def _missed(case: Case, engine: Engine | None = None) -> str:
    """Return how a run misses the first event of a case, or nothing."""
    settings = SimulationSettings() if engine is None else SimulationSettings(engine=engine)
    found = simulate(case.dynamics, case.start, until=case.until, settings=settings)
    first = next((e for e in found.events if isinstance(e, case.event)), None)
    if first is None:
        return "" if math.isinf(case.time) else f"no event, but one at {case.time:.12g}"
    off = abs(first.time - case.time)
    return "" if off <= LOCATED * case.until else f"at {first.time:.12g}, not {case.time:.12g}"


@pytest.mark.parametrize("cases", [15, pytest.param(120, marks=pytest.mark.slow)])
@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.__name__)
def test_no_first_event_of_a_family_is_missed(family: Family, cases: int) -> None:
    wrong = {k: _missed(case) for k, case in enumerate(_drawn(family, cases))}
    wrong = {k: text for k, text in wrong.items() if text}
    assert not wrong, f"seed {SEED}: {wrong}"


@pytest.mark.parametrize(
    "engine",
    fast(2, [RungeKutta(), Radau(), SciPy(method=DOP853), SciPy(method=LSODA)]),
    ids=("explicit", "implicit", "scipy explicit", "scipy multistep"),
)
def test_every_engine_sees_them(engine: Engine) -> None:
    drawn = [next(_drawn(family, 1)) for family in FAMILIES]
    wrong = {k: _missed(case, engine) for k, case in enumerate(drawn)}
    wrong = {k: text for k, text in wrong.items() if text}
    assert not wrong, f"seed {SEED}: {wrong}"


@pytest.mark.parametrize("engine", [RungeKutta(), Radau()], ids=("explicit", "implicit"))
def test_the_multiplier_of_the_documents_lets_go_where_it_is_zero(engine: Engine) -> None:
    case = _slide(
        lambda x: 1.5 * ca.exp(-(((x - 3) / 0.3) ** 2)),
        0.0,
        1.0,
        5.0,
        3 - 0.3 * math.sqrt(math.log(1.5)),
    )
    assert case.time == pytest.approx(2.80897, abs=5e-6)
    assert not _missed(case, engine)


@pytest.mark.parametrize("width", [0.3, 1e-2, 1e-4])
def test_a_pull_that_jumps_releases_at_its_edge(width: float) -> None:
    # The derivative of a jump is zero, and no bound of a rate excludes it.
    def pull(x: ca.SX) -> ca.SX:
        return 1.5 * ca.logic_and(x > 3, x < 3 + width)

    assert not _missed(_slide(pull, 0.0, 1.0, 5.0, 3.0))


@pytest.mark.parametrize("formula", [ca.log1p, ca.atanh, lambda b: ca.acosh(2 + b) - math.acosh(2)])
def test_pulls_in_rare_functions_are_seen(formula: Formula) -> None:
    centre, width = 3.0, 1e-3
    b = {ca.log1p: math.e - 1, ca.atanh: math.tanh(1.0)}.get(
        formula, math.cosh(1.0 + math.acosh(2)) - 2
    )
    top = min(1.6 * b, 0.99 if formula is ca.atanh else math.inf)
    time = centre - width * math.sqrt(math.log(top / b))

    def pull(x: ca.SX) -> ca.SX:
        return formula(top * ca.exp(-(((x - centre) / width) ** 2)))

    assert not _missed(_slide(pull, 0.0, 1.0, 5.0, time))


def test_a_hole_that_ends_above_zero_is_no_release() -> None:
    case = _slide(lambda x: (1 - 1e-9) * ca.exp(-(((x - 3) / 1e-3) ** 2)), 0.0, 1.0, 5.0, math.inf)
    assert not _missed(case)


@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_a_bump_in_the_way_of_a_later_flight_is_struck(size: float) -> None:
    # From rest at height 1 the ball lands at sqrt(2 / g) and flies on for 2 e sqrt(2 / g).
    restitution, along = 0.6, 2.0 * math.sqrt(size)
    landing = math.sqrt(2 * size / G)
    speed = restitution * math.sqrt(2 * G * size)
    half = speed / G
    centre, width, height = along * (landing + 0.7 * half), 3e-3 * size, 0.4 * size
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    bump = height * ca.exp(-(((q[0] - centre) / width) ** 2))
    machine = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=ca.sumsqr(v) / 2, potential=G * q[1], gap=q[1] - bump
    )
    found = simulate(
        numeric(machine, restitution=restitution), (0.0, size, along, 0.0), until=landing + half
    )

    def gap(t: float) -> float:
        ground = height * math.exp(-(((along * (landing + t) - centre) / width) ** 2))
        return speed * t - G * t**2 / 2 - ground

    struck = brentq(gap, 0.6 * half, 0.7 * half, xtol=1e-15)
    assert found.impacts[0].time == pytest.approx(landing, rel=1e-12, abs=0.0)
    assert found.impacts[1].time == pytest.approx(landing + struck, rel=1e-9, abs=0.0)
