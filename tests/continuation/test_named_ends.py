"""Every end of a family has its name: machines of one mass, against flights by another integrator.

An end is a periodic motion on which one condition is just zero. Both are checked: the motion from
the state at the end is integrated by SciPy from the formula of the force, which has its kinks, and
returns to that state, and the condition of the named event is zero on it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq, fsolve, minimize_scalar

import zeno_orbits as zo
from tests.reference.two_walls import TURN, TwoWalls
from tests.support.one_mass import Motion, one_mass
from zeno_orbits.arrays import Vector
from zeno_orbits.continuation import (
    ContinuationSettings,
    Family,
    SecondParameter,
    SpecialPoint,
    SpecialPointKind,
    family_of_orbit,
)
from zeno_orbits.search import settled_event_orbit

Kind = SpecialPointKind


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A machine whose family has an end.

    Attributes:
        force: The force on the mass.
        walls: Name to side (1 above, -1 below), place and coefficient of restitution.
        parameters: Name to value.
        box: Range of the parameter that changes.
        first: Kind and detail of the first end. ``None`` for an end that is not of interest.
        last: Kind and detail of the last end.
        parameter: Name of the parameter that changes.
        doublings: Number of successive period doublings.
        start: Start of the motion that settles.
        switches: Declared switches.
    """

    force: Callable[[Motion], ca.SX]
    walls: Mapping[str, tuple[int, float, float]]
    parameters: Mapping[str, float]
    box: tuple[float, float]
    first: tuple[Kind, str] | None = None
    last: tuple[Kind, str] | None = None
    parameter: str = "A"
    doublings: int = 0
    start: Mapping[str, float] = field(default_factory=lambda: {"cosine": 1.0})
    switches: Callable[[Motion], tuple[zo.Switch, ...]] = lambda _: ()

    def problem(self) -> zo.Problem:
        return one_mass(
            self.force,
            stops=lambda m: tuple(
                zo.Stop(name=name, gap=side * (place - m.x), restitution=e)
                for name, (side, place, e) in self.walls.items()
            ),
            switches=self.switches,
            has_clock=True,
            start=self.start,
            **self.parameters,
        )

    def families(self) -> tuple[Family, ...]:
        problem = self.problem()
        orbit = settled_event_orbit(problem, problem.values())
        settings = ContinuationSettings(doublings=self.doublings)
        found = family_of_orbit(problem, orbit, self.parameter, self.box, settings=settings)
        return found.families


@dataclass(frozen=True, slots=True, kw_only=True)
class Flown:
    """A motion over one period.

    Attributes:
        pieces: Dense solutions between events, with their begin and end.
        end: Place and speed at the end.
        rate: From a time and a state to the rates.
    """

    pieces: list[tuple[Any, float, float]]
    end: Vector
    rate: Callable[[float, Vector], list[float]]

    def least(self, value: Callable[[float, Vector], float]) -> float:
        """Return the least local minimum of a condition inside the pieces."""
        found: list[float] = []
        for solution, begin, end in self.pieces:
            times = np.linspace(begin, end, 800)
            values = [value(t, solution(t)) for t in times]
            for k in range(1, len(times) - 1):
                if values[k] <= min(values[k - 1], values[k + 1]):

                    def there(t: float, one: Any = solution) -> float:
                        return value(t, one(t))

                    inside: Any = minimize_scalar(
                        there,
                        bounds=(times[k - 1], times[k + 1]),
                        method="bounded",
                        options={"xatol": 1e-12},
                    )
                    found.append(float(inside.fun))
        return min(found, default=np.inf)


def flown(case: Case, end: SpecialPoint) -> Flown:
    """Return the motion from the state at an end, over its period."""
    values = {**case.parameters, case.parameter: end.at.value}
    x, v, cosine, sine = (ca.SX.sym(name) for name in ("x", "v", "cosine", "sine"))
    symbols = {name: ca.SX.sym(name) for name in values}
    motion = Motion(x=x, v=v, cosine=cosine, sine=sine, clock=None, p=symbols)
    inputs = [ca.vertcat(x, v, cosine, sine), ca.vertcat(*symbols.values())]
    force = ca.Function("force", inputs, [ca.SX(case.force(motion))])
    phase = np.arctan2(end.at.state["sine"], end.at.state["cosine"])

    def rate(t: float, y: Vector) -> list[float]:
        angle = phase + values["omega"] * t
        state = [float(y[0]), float(y[1]), float(np.cos(angle)), float(np.sin(angle))]
        return [state[1], float(force(ca.DM(state), ca.DM([*values.values()])))]

    def struck(side: int, place: float) -> Callable[[float, Vector], float]:
        def gap(_: float, y: Vector) -> float:
            return side * (place - float(y[0]))

        vars(gap).update(terminal=True, direction=-1.0)
        return gap

    walls = list(case.walls.values())
    gaps = [struck(side, place) for side, place, _ in walls]
    t, y = 0.0, np.array([end.at.state["x"], end.at.state["v"]])
    pieces: list[tuple[Any, float, float]] = []
    while t < end.at.period - 1e-7:
        # A flight starts on a wall, where the gap rises.
        begin = t
        first: Any = solve_ivp(rate, (t, t + 1e-8), y, rtol=1e-12, atol=1e-14)
        one: Any = solve_ivp(
            rate,
            (t + 1e-8, end.at.period),
            first.y[:, -1],
            events=gaps,
            dense_output=True,
            max_step=0.02,
            rtol=1e-11,
            atol=1e-13,
        )
        t, y = float(one.t[-1]), one.y[:, -1]
        pieces.append((one.sol, begin + 1e-8, t))
        for (side, place, e), times in zip(walls, one.t_events, strict=True):
            # The period may end at an impact.
            at_end = abs(place - y[0]) < 1e-8 and side * y[1] > 0.0
            if times.size or at_end:
                y = np.array([y[0], -e * y[1]])
    return Flown(pieces=pieces, end=y, rate=rate)


def named(case: Case) -> list[SpecialPoint]:
    """Return the ends that a case names. No family of the case was given up."""
    families = case.families()
    ends = [end for family in families for end in (family.first, family.last)]
    assert all(end.kind is not Kind.GAVE_UP for end in ends)
    family = families[-1]
    pairs = ((family.first, case.first), (family.last, case.last))
    found = [(end, wanted) for end, wanted in pairs if wanted is not None]
    assert [(end.kind, end.detail) for end, _ in found] == [wanted for _, wanted in found]
    return [end for end, _ in found]


def closes(end: SpecialPoint, motion: Flown) -> bool:
    """Return whether a motion returns to its start."""
    start = np.array([end.at.state["x"], end.at.state["v"]])
    return bool(np.max(np.abs(motion.end - start)) < 1e-6)


def _some(names: Iterable[str], *fast: str) -> list[Any]:
    """Return parameters, all but some of which are slow."""
    return [name if name in fast else pytest.param(name, marks=pytest.mark.slow) for name in names]


# A release that meets a switching time: a force drops or jumps up where the sine passes 0.6.

_SWITCHING = np.sqrt(1 - 0.6**2)
"""Cosine of the phase at which the force jumps."""


def _pressed(
    step: float,
    amplitude: float,
    box: tuple[float, float],
    first: tuple[Kind, str] | None = None,
    last: tuple[Kind, str] | None = None,
    restitution: float = 0.0,
) -> Case:
    return Case(
        force=lambda m: (
            -m.x - 0.2 * m.v + m.p["A"] * m.cosine + ca.if_else(m.sine > 0.6, 0.0, step)
        ),
        walls={"wall": (1, 0.5, restitution)},
        parameters={"omega": 0.7, "A": amplitude},
        box=box,
        first=first,
        last=last,
    )


_MEETS = (Kind.EVENTS_MEET, "switch kink 1 and release wall")
RELEASES = {
    # After the drop the force is A cos - 1/2, before it A cos - 1/2 + step.
    "after a drop": (_pressed(0.2, 0.8, (0.3, 1.0), first=_MEETS), 0.5),
    "after a large drop": (_pressed(0.4, 0.7, (0.5, 0.8), first=_MEETS), 0.5),
    "after a drop, with bounces": (_pressed(0.1, 0.7, (0.55, 0.75), _MEETS, None, 0.05), 0.5),
    "at a drop": (
        _pressed(
            0.2,
            0.44,
            (0.3, 0.48),
            first=(Kind.EARLIER_RELEASE, "release wall before switch kink 1"),
        ),
        0.3,
    ),
    "at a large drop": (
        _pressed(
            0.35,
            0.3,
            (0.1, 0.32),
            first=(Kind.EARLIER_RELEASE, "release wall before switch kink 1"),
        ),
        0.15,
    ),
    "before a jump up": (
        _pressed(-0.2, 0.86, (0.8, 1.0), last=(Kind.EVENTS_MEET, "release wall and switch kink 1")),
        0.7,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", _some(RELEASES, "after a drop"))
def test_a_release_meets_a_switching_time_in_closed_form(name: str) -> None:
    case, force = RELEASES[name]
    (end,) = named(case)
    assert end.at.value == pytest.approx(force / _SWITCHING, abs=10 * end.error + 1e-12)
    assert end.error < 1e-10


# A flight that grazes a stop, after any of its impacts, on orbits of one and of two returns.


def _oscillator(m: Motion) -> ca.SX:
    return -m.x - m.p["c"] * m.v + m.p["A"] * m.cosine


_GRAZES = "impact wall before impact wall"
GRAZES = {
    "second return": Case(
        force=_oscillator,
        walls={"wall": (1, 0.0, 0.8)},
        parameters={"omega": 2.65, "A": 1.0, "c": 0.02},
        parameter="omega",
        box=(2.64, 3.2),
        doublings=1,
        last=(Kind.EARLIER_GRAZING, f"{_GRAZES}, return 2 of 2"),
    ),
    "first return": Case(
        force=_oscillator,
        walls={"wall": (1, 0.0, 0.9)},
        parameters={"omega": 4.63, "A": 1.0, "c": 0.1},
        parameter="omega",
        box=(4.6, 5.0),
        doublings=1,
        last=(Kind.EARLIER_GRAZING, f"{_GRAZES}, return 1 of 2"),
    ),
    "hardening spring": Case(
        force=lambda m: _oscillator(m) - 0.3 * m.x**3,
        walls={"wall": (1, 0.0, 0.8)},
        parameters={"omega": 2.8, "A": 1.0, "c": 0.05},
        parameter="omega",
        box=(2.79, 3.3),
        last=(Kind.EARLIER_GRAZING, f"{_GRAZES}, return 2 of 2"),
    ),
    "ball on a table": Case(
        force=lambda m: -1 - 0.2 * m.v + m.p["A"] * m.cosine,
        walls={"floor": (-1, 0.0, 0.5)},
        parameters={"omega": 1.0, "A": 2.2},
        start={"x": 0.1, "cosine": 1.0},
        box=(1.6, 2.8),
        first=(Kind.EARLIER_GRAZING, "impact floor before impact floor"),
    ),
    "two walls": Case(
        force=_oscillator,
        walls={"up": (1, 0.3, 0.8), "low": (-1, -1.0, 0.8)},
        parameters={"omega": 2.0, "A": 1.0, "c": 0.1},
        parameter="omega",
        box=(1.9, 2.4),
        last=(Kind.EARLIER_GRAZING, "impact low before impact up"),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", _some(GRAZES, "two walls"))
def test_a_flight_grazes_a_stop_after_any_impact(name: str) -> None:
    case = GRAZES[name]
    (end,) = named(case)
    motion = flown(case, end)
    assert closes(end, motion)
    gaps = [
        motion.least(lambda _, y, side=side, place=place: side * (place - float(y[0])))
        for side, place, _ in case.walls.values()
    ]
    assert min(gaps) == pytest.approx(0.0, abs=1e-8)
    assert end.error < 1e-9


# A touch of a wall at which the largest multiplier grows without bound.

_SHAKEN = TwoWalls(c=0.1, force=5.0, omega=1.0, walls=(1.0, 1.0), restitutions=(0.5, 0.5))


def _touching(phase: float, e: float) -> float:
    """Return the restitution of the upper wall at which the last impact of a period is a touch.

    The period starts at the touch. The unknowns are its phase, the lengths of the six flights, and
    the restitution: each flight ends at its wall, the last one at rest, after one turn.

    Args:
        phase: First value of the phase.
        e: First value of the restitution.
    """
    walls = (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0)

    def missed(u: Vector) -> list[float]:
        t, x, v, upper = u[0], 1.0, 0.0, u[7]
        left: list[float] = []
        for wall, length in zip(walls, u[1:7], strict=True):
            end, rate = _SHAKEN.flown(t, x, v, length)
            left.append(end - wall)
            t, x, v = t + length, wall, -(upper if wall > 0.0 else 0.5) * rate
        return [*left, v, t - u[0] - TURN]

    guess, t, x, v = [phase], phase, 1.0, 0.0
    for wall in walls[:5]:
        s = 0.05
        while wall * _SHAKEN.flown(t, x, v, s)[0] < 1.0:
            s += 1e-4
        guess.append(s)
        rate = _SHAKEN.flown(t, x, v, s)[1]
        t, x, v = t + s, wall, -(e if wall > 0.0 else 0.5) * rate
    guess += [phase + TURN - t, e]
    root, _, status, message = fsolve(missed, guess, xtol=1e-14, full_output=True)
    assert status == 1, message
    assert np.max(np.abs(missed(root))) < 1e-11
    return float(root[7])


@pytest.mark.slow
def test_an_impact_vanishes_where_the_multiplier_has_no_bound() -> None:
    problem = one_mass(
        lambda m: -m.x - 0.1 * m.v + 5.0 * m.cosine,
        stops=lambda m: (
            zo.Stop(name="up", gap=1.0 - m.x, restitution=m.p["e"]),
            zo.Stop(name="low", gap=1.0 + m.x, restitution=0.5),
        ),
        start={"x": 0.1, "cosine": 1.0},
        omega=1.0,
        e=0.5,
    )
    orbit = settled_event_orbit(problem, problem.values())
    (family, *_) = family_of_orbit(problem, orbit, "e", (0.499, 0.6)).families
    end = family.last
    assert (end.kind, end.detail) == (Kind.GRAZING, "impact up")
    assert max(map(abs, family.points[-1].multipliers)) > 1e3
    phase = float(np.arctan2(end.at.state["sine"], end.at.state["cosine"]))
    assert end.at.value == pytest.approx(_touching(phase, end.at.value), abs=10 * end.error)
    assert end.error < 1e-8


@pytest.mark.slow
def test_an_orbit_of_one_impact_ends_where_the_free_oscillation_grazes() -> None:
    case = Case(
        force=_oscillator,
        walls={"wall": (1, 0.2, 0.7)},
        parameters={"omega": 2.0, "A": 1.0, "c": 0.1},
        parameter="omega",
        box=(1.9, 2.6),
        last=(Kind.GRAZING, "impact wall"),
    )
    (end,) = named(case)
    truth = brentq(lambda omega: 1 / abs(1 - omega**2 + 0.1j * omega) - 0.2, 2.0, 3.0, xtol=1e-14)
    assert end.at.value == pytest.approx(truth, abs=10 * end.error)
    assert end.error < 1e-9


# A kink or a switch that enters the event sequence.


def _no_switches(_: Motion) -> tuple[zo.Switch, ...]:
    return ()


def _latch(m: Motion) -> tuple[zo.Switch, ...]:
    return (zo.Switch(name="latch", guard=m.x + 0.5, armed=1.0, v_after=0.9 * m.v),)


def _kinked(
    force: Callable[[Motion], ca.SX],
    box: tuple[float, float],
    *,
    name: str = "kink 1",
    start: Mapping[str, float] | None = None,
    switches: Callable[[Motion], tuple[zo.Switch, ...]] = _no_switches,
) -> Case:
    return Case(
        force=lambda m: _oscillator(m) + force(m),
        walls={"wall": (1, 0.0, 0.8)},
        parameters={"omega": 2.6, "A": box[0] + 0.01, "c": 0.05},
        box=box,
        last=(Kind.SWITCH_ENTERS, f"switch {name} before impact wall"),
        start=start or {"cosine": 1.0},
        switches=switches,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """A place and a speed, and the driving force."""

    x: float
    v: float
    drive: float


_SLOW = {"x": 0.0, "v": -0.28, "cosine": np.cos(2.98), "sine": np.sin(2.98)}
"""Start near the orbit of one impact per period, beside which there are others."""
ENTERS: dict[str, tuple[Case, Callable[[_Place], float]]] = {
    # The condition, which is positive before it acts.
    "spring": (
        _kinked(lambda m: 2 * ca.fmax(-m.x - 0.5, 0), (0.68, 1.0), start=_SLOW),
        lambda at: at.x + 0.5,
    ),
    "jump": (
        _kinked(lambda m: ca.if_else(m.x < -0.5, 0.2, 0.0), (0.68, 1.0), start=_SLOW),
        lambda at: at.x + 0.5,
    ),
    "speed": (
        _kinked(lambda m: -0.5 * ca.fmax(m.v - 0.9, 0), (0.5, 1.5)),
        lambda at: 0.9 - at.v,
    ),
    "force": (
        _kinked(lambda m: 0.5 * ca.fmax(m.x + m.p["A"] * m.cosine - 0.9, 0), (1.9, 2.8)),
        lambda at: 0.9 - at.x - at.drive,
    ),
    "limit": (
        _kinked(lambda m: ca.fmin(0, 1.3 - m.p["A"] * m.cosine), (1.2, 1.5)),
        lambda at: 1.3 - at.drive,
    ),
    "switch": (
        _kinked(lambda _: ca.SX(0.0), (0.68, 1.0), name="latch", switches=_latch),
        lambda at: at.x + 0.5,
    ),
}


@pytest.mark.parametrize("name", _some(ENTERS, "switch"))
def test_a_kink_or_switch_enters_where_its_condition_is_just_zero(name: str) -> None:
    case, condition = ENTERS[name]
    (end,) = named(case)
    motion = flown(case, end)
    assert closes(end, motion)
    phase = np.arctan2(end.at.state["sine"], end.at.state["cosine"])
    omega, amplitude = case.parameters["omega"], end.at.value

    def at(t: float, y: Vector) -> float:
        drive = amplitude * float(np.cos(phase + omega * t))
        return condition(_Place(x=float(y[0]), v=float(y[1]), drive=drive))

    least = motion.least(at)
    assert least == pytest.approx(0.0, abs=1e-8)
    assert end.error < 1e-9


# A plastic impact after which the force pulls: the mass leaves at once.


@pytest.mark.slow
def test_a_plastic_impact_opens_its_stop_until_the_force_after_it_is_zero() -> None:
    case = Case(
        force=lambda m: -1 - 0.2 * m.v + m.p["A"] * m.cosine,
        walls={"floor": (-1, 0.0, 0.0)},
        parameters={"omega": 1.0, "A": 4.5},
        box=(3.9, 4.6),
        first=(Kind.EVENTS_MEET, "impact floor and release floor"),
        start={"x": 0.1, "cosine": 1.0},
    )
    (end,) = named(case)
    assert end.at.value * end.at.state["cosine"] == pytest.approx(1.0, abs=1e-9)
    assert closes(end, flown(case, end))


# A switch whose arming changes where its guard falls through zero.


ARMED: dict[str, Callable[[Motion], Any]] = {
    "a difference": lambda m: m.cosine - m.p["level"],
    "a comparison": lambda m: m.cosine > m.p["level"],
    "and": lambda m: ca.logic_and(m.cosine > m.p["level"], m.x < 5),
    "not": lambda m: ca.logic_not(m.cosine <= m.p["level"]),
    "or": lambda m: ca.logic_or(m.cosine > m.p["level"], m.x > 5),
    "a product": lambda m: (m.cosine > m.p["level"]) * (m.x < 5),
    "a choice": lambda m: ca.if_else(m.cosine > m.p["level"], 1, -1),
    "a sign": lambda m: ca.sign(m.cosine - m.p["level"]),
}


@pytest.mark.slow
@pytest.mark.parametrize("form", _some(ARMED, "a comparison"))
@pytest.mark.parametrize(
    ("level", "detail"),
    [
        (-0.9, "switch latch"),
        pytest.param(0.9, "switch latch before impact wall", marks=pytest.mark.slow),
    ],
)
def test_the_arming_of_a_switch_changes_where_a_flight_says(
    level: float, detail: str, form: str
) -> None:
    ended, at = (Kind.ARMING, detail), -0.3
    case = Case(
        force=_oscillator,
        walls={"wall": (1, 0.0, 0.8)},
        parameters={"omega": 2.6, "A": 0.9, "c": 0.05, "level": level},
        parameter="level",
        box=(-1.0, 1.0),
        first=ended if level > 0.0 else None,
        last=None if level > 0.0 else ended,
        start=_SLOW,
        switches=lambda m: (
            zo.Switch(name="latch", guard=m.x - at, armed=ARMED[form](m), v_after=0.9 * m.v),
        ),
    )
    (end,) = named(case)
    solution, begin, until = flown(case, end).pieces[0]
    # The flight from the wall passes the place before a switch can change it.
    times = np.linspace(begin, until, 400)
    passed = next(t for t in times if solution(t)[0] < at)
    time = brentq(lambda t: solution(t)[0] - at, begin, passed, xtol=1e-13)
    phase = np.arctan2(end.at.state["sine"], end.at.state["cosine"])
    assert end.at.value == pytest.approx(np.cos(phase + 2.6 * time), abs=1e-8)


# A motion that stalls at a saddle: a mass on a hill, kicked uphill where it passes a place.


def _hill(speed: float, **parameters: float) -> zo.Problem:
    return one_mass(
        lambda m: m.p["slope"] * m.x - m.p["c"] * m.v,
        stops=lambda m: (zo.Stop(name="wall", gap=1 - m.x, restitution=m.p["e"]),),
        switches=lambda m: (
            zo.Switch(
                name="kick", guard=m.x - 0.5, armed=-m.v, v_after=m.p["keep"] * m.v - m.p["k"]
            ),
        ),
        has_clock=False,
        start={"x": 1.0, "v": -speed},
        **parameters,
    )


def _kick_onto_the_saddle(*, e: float, keep: float, c: float, slope: float) -> float:
    """Return the kick with which the mass comes to rest on the hilltop, by exact flights.

    It leaves along the unstable direction, strikes the wall, passes the place again and arrives
    along the stable direction.
    """
    root = np.sqrt(c**2 / 4 + slope)
    leaves, arrives = -c / 2 + root, c / 2 + root
    free = np.array([[0.0, 1.0], [slope, -c]])
    struck = np.array([1.0, -e * leaves])
    time = brentq(lambda t: (expm(free * t) @ struck)[0] - 0.5, 0.0, _turning(free, struck))
    speed = -(expm(free * time) @ struck)[1]
    return float(arrives * 0.5 - keep * speed)


def _turning(free: Vector, struck: Vector) -> float:
    """Return when a flight from the wall turns."""
    return float(brentq(lambda t: (expm(free * t) @ struck)[1], 1e-9, 10.0))


HILLS = {
    "undamped": {"e": 0.9, "keep": 0.3, "c": 0.0, "slope": 1.0},
    "damped": {"e": 0.95, "keep": 0.2, "c": 0.02, "slope": 1.0},
    "steep": {"e": 0.92, "keep": 0.4, "c": 0.0, "slope": 2.0},
    "flat": {"e": 0.98, "keep": 0.5, "c": 0.04, "slope": 0.5},
    "steep and damped": {"e": 0.94, "keep": 0.1, "c": 0.03, "slope": 3.0},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", _some(HILLS, "damped"))
def test_a_period_grows_without_bound_where_exact_flights_end_on_the_saddle(
    name: str,
) -> None:
    values = HILLS[name]
    truth = _kick_onto_the_saddle(**values)
    kick = 0.97 * truth
    root = np.sqrt(values["c"] ** 2 / 4 + values["slope"])
    problem = _hill(values["e"] * (root - values["c"] / 2), k=kick, **values)
    orbit = settled_event_orbit(problem, problem.values())
    few = ContinuationSettings(doublings=0)
    box = (0.96 * truth, 1.1 * truth)
    (family,) = family_of_orbit(problem, orbit, "k", box, settings=few).families
    end = family.last
    assert end.kind is Kind.PERIOD_INFINITE
    assert end.at.value == pytest.approx(truth, abs=10 * end.error + 1e-12)
    assert end.error < 1e-8
    assert end.detail.startswith("rests at x = ")
    assert np.isinf(end.at.period)


@pytest.mark.slow
def test_a_curve_of_infinite_periods_in_two_parameters_has_its_closed_form() -> None:
    values = HILLS["damped"]
    truth = _kick_onto_the_saddle(**values)
    root = np.sqrt(values["c"] ** 2 / 4 + values["slope"])
    problem = _hill(values["e"] * (root - values["c"] / 2), k=0.97 * truth, **values)
    orbit = settled_event_orbit(problem, problem.values())
    second = SecondParameter(name="keep", box=(0.19, 0.21), kinds=(Kind.PERIOD_INFINITE,))
    box = (0.96 * truth, 1.1 * truth)
    few = ContinuationSettings(doublings=0)
    found = family_of_orbit(problem, orbit, "k", box, second=second, settings=few)
    (curve,) = found.boundaries
    assert (min(curve.y), max(curve.y)) == pytest.approx((0.19, 0.21), rel=1e-9)
    kicks = [_kick_onto_the_saddle(**{**values, "keep": keep}) for keep in curve.y]
    assert curve.x == pytest.approx(kicks, abs=1e-9)
    assert abs(kicks[0] - kicks[-1]) > 1e-3


# A contact phase that vanishes while the mass also strikes another stop several times.


@dataclass(frozen=True, slots=True, kw_only=True)
class Pressed:
    """A spring driven between an upper and a lower stop, of which the upper one holds it.

    Attributes:
        A: Amplitude of the drive, whose angular frequency is 1.
        c: Damping.
        place: Place of the upper stop.
        low: Place of the lower stop.
        other: Coefficient of restitution of the lower stop.
        e: Range of the coefficient of restitution of the upper stop.
    """

    A: float
    c: float
    place: float
    low: float
    other: float
    e: tuple[float, float]

    def problem(self) -> zo.Problem:
        return one_mass(
            lambda m: -m.x - self.c * m.v + self.A * m.cosine,
            stops=lambda m: (
                zo.Stop(name="up", gap=self.place - m.x, restitution=m.p["e"]),
                zo.Stop(name="low", gap=m.x - self.low, restitution=self.other),
            ),
            start={"x": 0.1, "cosine": 1.0},
            omega=1.0,
            e=self.e[0],
        )

    def accumulates(self, e: float) -> bool:
        """Return whether impacts on the upper stop accumulate before its force vanishes.

        Flights are exact. In late flights the ratio `w b / a**2` of theory (5.7) falls to zero, or
        it grows until a flight misses the stop.
        """
        response = self.A / complex(0.0, self.c)
        free = np.array([[0.0, 1.0], [-1.0, -self.c]])
        values, vectors = np.linalg.eig(free)
        inverse = np.linalg.inv(vectors)

        def forced(t: Vector) -> Vector:
            wave = response * np.exp(1j * t)
            return np.array([wave.real, (1j * wave).real])

        released = float(np.arccos(self.place / self.A))
        t, y = released, np.array([self.place, 0.0])
        for _ in range(60):
            modes: Any = inverse @ (y - forced(np.array(t)))

            def state(s: Vector, t: float = t, modes: Any = modes) -> Any:
                grown: Any = np.exp(values[:, None] * np.atleast_1d(s - t)) * modes[:, None]
                return (vectors @ grown).real + forced(np.atleast_1d(s))

            push = self.A * np.cos(t) - y[0] - self.c * y[1]
            step = min(0.01, abs(2 * y[1] / push) / 12) if y[1] != 0.0 else 0.01
            times = t + step * np.arange(1, int(14.0 / step) if step == 0.01 else 400)
            places: Vector = np.asarray(
                state(np.asarray(times, dtype=np.float64))[0], dtype=np.float64
            )
            outside = (places > self.place) | (places < self.low)
            if not outside.any():
                return False
            k = int(np.argmax(outside))
            wall = self.place if places[k] > self.place else self.low
            begin = times[k - 1] if k else t + step / 100

            def beyond(
                s: float, state: Callable[[Vector], Any] = state, wall: float = wall
            ) -> float:
                return float(state(np.array(s))[0, 0]) - wall

            t = float(brentq(beyond, begin, float(times[k]), xtol=1e-15))
            speed = float(state(np.array(t))[1, 0])
            y = np.array([wall, -(e if wall == self.place else self.other) * speed])
            push, fall = self.A * np.cos(t) - self.place, self.A * np.sin(t)
            if wall == self.place and fall > 0.0 and t > released + np.pi:
                ratio = -y[1] * fall / push**2
                if push <= 0.0 or ratio > 0.35:
                    return False
                if ratio < 0.02:
                    return True
        raise AssertionError("The impacts were not followed far enough.")


PRESSED = {
    "three impacts below": Pressed(A=5.0, c=0.1, place=1.0, low=-1.0, other=0.5, e=(0.43, 0.6)),
    "elastic below": Pressed(A=4.0, c=0.1, place=1.0, low=-1.2, other=0.6, e=(0.4, 0.7)),
    "damped": Pressed(A=5.0, c=0.3, place=0.8, low=-1.6, other=0.5, e=(0.4, 0.7)),
    "near": Pressed(A=3.0, c=0.2, place=0.5, low=-0.6, other=0.5, e=(0.35, 0.7)),
    "far": Pressed(A=6.0, c=0.2, place=1.5, low=-2.0, other=0.45, e=(0.35, 0.7)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", _some(PRESSED, "three impacts below"))
def test_a_contact_phase_vanishes_beside_repeated_impacts_on_another_stop(name: str) -> None:
    machine = PRESSED[name]
    problem = machine.problem()
    orbit = settled_event_orbit(problem, problem.values())
    few = ContinuationSettings(doublings=0)
    (family,) = family_of_orbit(problem, orbit, "e", machine.e, settings=few).families
    end = family.last
    assert (end.kind, end.detail) == (Kind.LOCK_VANISHES, "zeno up and release up")
    assert end.error < 1e-8
    # Rounding of the flights allows no smaller distance.
    width = 2e-7
    assert machine.accumulates(end.at.value - width)
    assert not machine.accumulates(end.at.value + width)
