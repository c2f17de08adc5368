"""The cases of `docs/extremes.md`: what is asked, how the truth is known, what is promised.

A row is data, and a line of the page holds the rows that differ in one value. `test_extremes.py`
runs all rows alike. No truth here is stored output: `independent.py` and `closed_forms.py` work it
out anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import DOP853, Radau

from tests.reference.closed_forms import FORCED, StoppedOscillator
from tests.reference.independent import Followed, Follower, Method
from tests.reference.reference_orbit import PERIOD, ZENO_STATE
from tests.support.families import CIRCLE
from tests.support.mechanisms import forced_oscillator, oscillator_state, spring_mass
from tests.support.units import PENDULUM, PENDULUM_STATE, Units
from zeno_orbits import OrbitNotFoundError, hybrid_system, quasi_static_drive
from zeno_orbits.errors import SimulationError, ZenoOrbitsError
from zeno_orbits.model import (
    CompiledSystem,
    CompletedSystem,
    HybridDynamics,
    Problem,
    bind,
    load_problem,
    load_reference,
)
from zeno_orbits.orbits import ONE_ZENO
from zeno_orbits.search import orbit_at_gains
from zeno_orbits.simulation import Execution, SimulationSettings, Truncation, simulate

CLOSED = "closed form"
SECOND = "hand-written model"
SCALED = "the same machine in other units"


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One case.

    Attributes:
        kind: What is extreme, as the table has it.
        at: The value at which it is tested, if several are.
        asked: What is compared.
        truth: How it is known.
        error: Run it and return the largest relative error of what is asked.
        tolerance: What the error must stay below.
        ends_in: The named error that it must end in instead.
        slow: It takes more than a few seconds, or other rows of its kind run by default.
    """

    kind: str
    at: str = ""
    asked: str
    truth: str
    error: Callable[[], float]
    tolerance: float = 0.0
    ends_in: type[ZenoOrbitsError] | None = None
    slow: bool = False

    @property
    def name(self) -> str:
        """Kind and value."""
        return f"{self.kind} {self.at}".strip()

    @property
    def promise(self) -> str:
        """What the table promises: a tolerance or the name of an error."""
        return f"{self.tolerance:.0e}" if self.ends_in is None else f"`{self.ends_in.__name__}`"


def _relative(value: float, exact: float) -> float:
    return abs(value - exact) / abs(exact) if exact else abs(value)


# The ball: restitution, height, gravity, mass, speed.


@cache
def _compiled(name: str) -> tuple[Problem, CompiledSystem]:
    problem = load_problem(name)
    return problem, problem.compiled()


def _ball(**parameters: float) -> HybridDynamics:
    problem, compiled = _compiled("bouncing_ball")
    return bind(compiled, problem.values(parameters=parameters).vector)


def _ball_error(
    restitution: float, height: float = 1.0, speed: float = 0.0, g: float = 9.81, m: float = 1.0
) -> float:
    """Return the largest relative error of impact times, impact speeds and Zeno time."""
    first_speed = math.hypot(speed, math.sqrt(2 * g * height))
    first = (speed + first_speed) / g if speed >= 0 else 2 * height / (first_speed - speed)
    unit = 2 * first_speed / g
    zeno_time = first + unit * restitution / (1 - restitution)
    ball = _ball(restitution=restitution, g=g, m=m)
    execution = simulate(ball, (height, speed), until=2 * zeno_time)
    (zeno,) = execution.zeno_points
    errors = [_relative(zeno.time, zeno_time), *np.abs(execution.end_state).tolist()]
    skipped = 1 if height == 0.0 and speed > 0.0 else 0
    for k, impact in enumerate(execution.impacts, start=skipped):
        exact = first_speed * restitution**k
        series = restitution * (1 - restitution**k) / (1 - restitution)
        errors.append(_relative(-impact.approach_rate, exact))
        errors.append(_relative(impact.time, first + unit * series))
    return max(errors)


def _deep_ball_error(restitution: float, slowest: float) -> float:
    """Return the largest relative error of impact speeds followed down to `slowest`."""
    settings = SimulationSettings(completion=Truncation(delta=slowest))
    ball = _ball(restitution=restitution)
    execution = simulate(ball, (0.0, -1.0), until=10.0, settings=settings)
    speeds = [-impact.approach_rate for impact in execution.impacts]
    assert speeds[-1] <= slowest / restitution
    return max(_relative(speed, restitution**k) for k, speed in enumerate(speeds))


def _contact_error() -> float:
    """Return how far a ball is from rest that is dropped from no more than a contact."""
    height = SimulationSettings().contact
    execution = simulate(_ball(restitution=0.5), (height, 0.0), until=1.0)
    return max(abs(float(execution.state_at(time)[0])) for time in (0.0, 1e-7, 0.5, 1.0))


BALL = "impacts, Zeno time"
BALL_ROWS = [
    *(
        Row(
            kind="ball, e =",
            at=f"{e:g}",
            asked=BALL,
            truth=CLOSED,
            error=partial(_ball_error, e),
            tolerance=1e-11 if e > 0.9 else 1e-12,
        )
        for e in (0.0, 1e-6, 0.2, 0.5, 0.9, 0.99)
    ),
    Row(
        kind="ball, e =",
        at="0.999",
        asked=BALL,
        truth=CLOSED,
        error=partial(_ball_error, 0.999),
        tolerance=1e-10,
        slow=True,
    ),
    Row(
        kind="ball dropped from the height that counts as contact",
        asked="height of a ball at rest",
        truth=CLOSED,
        error=_contact_error,
        tolerance=1e-12,
    ),
    *(
        Row(
            kind="ball dropped from a height [m]",
            at=f"{height:g}",
            asked=BALL,
            truth=CLOSED,
            error=partial(_ball_error, 0.5, height),
            tolerance=1e-12,
        )
        for height in (1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9)
    ),
    *(
        Row(
            kind="ball in",
            at=words,
            asked=BALL,
            truth=CLOSED,
            error=partial(_ball_error, 0.5, unit, 0.0, 9.81 * unit),
            tolerance=1e-12,
        )
        for words, unit in (("mm", 1e3), ("km", 1e-3))
    ),
    *(
        Row(
            kind="ball, gravity [m/s^2]",
            at=f"{g:g}",
            asked=BALL,
            truth=CLOSED,
            error=partial(_ball_error, 0.5, 1.0, 0.0, g),
            tolerance=1e-12,
        )
        for g in (1e-6, 1e-3, 1e3, 1e6)
    ),
    *(
        Row(
            kind="ball, mass [kg]",
            at=f"{m:g}",
            asked=BALL,
            truth=CLOSED,
            error=partial(_ball_error, 0.5, 1.0, 0.0, 9.81, m),
            tolerance=1e-12,
        )
        for m in (1e-6, 1e6)
    ),
    *(
        Row(
            kind=f"ball thrown down from {h:g} m, speed [m/s]",
            at=f"{-v:g}",
            asked=BALL,
            truth=CLOSED,
            error=partial(_ball_error, 0.5, h, v),
            tolerance=1e-12,
        )
        for v, h in ((-1e3, 1.0), (-1e3, 0.0), (-1.0, 0.0), (-1e-6, 0.0), (-1e-9, 0.0))
    ),
    *(
        Row(
            kind=f"ball, e = {e:g}, impacts followed to [m/s]",
            at=f"{slowest:g}",
            asked="impact speeds",
            truth=CLOSED,
            error=partial(_deep_ball_error, e, slowest),
            tolerance=tolerance,
            slow=tolerance == 1e-10,
        )
        for e, slowest, tolerance in (
            (0.2, 1e-30, 1e-12),
            (0.2, 1e-300, 1e-11),
            (0.9, 1e-30, 1e-11),
            (0.9, 1e-300, 1e-10),
        )
    ),
]


# Grazing: a mass on a spring whose swing reaches the stop by little.


def _grazing_error(dip: float, restitution: float = 0.5) -> float:
    r"""Return the error of the first impact of :math:`x = \cos t` on :math:`x \ge -1 + dip`.

    An error of the position counts by the inverse of the speed, so the time is measured in units
    of the stay below the stop, `2 sqrt(2 dip)`, which is exactly what grazing makes small.
    """
    execution = simulate(spring_mass(1 - dip, restitution), (1.0, 0.0), until=4.0)
    first = execution.impacts[0]
    stop = 1 - dip
    time, speed = math.acos(-stop), math.sqrt((1 - stop) * (1 + stop))
    return max(abs(first.time - time) * speed, abs(-first.approach_rate - speed) * speed)


GRAZING_ROWS = [
    Row(
        kind="first impact grazes, depth of the swing past the stop",
        at=f"{dip:g}",
        asked="impact, times its speed",
        truth=CLOSED,
        error=partial(_grazing_error, dip),
        tolerance=1e-12,
    )
    for dip in (1e-3, 1e-6, 1e-9, 1e-12)
]


# Long horizons: the forced oscillator repeats after exactly one turn.


def _horizon_error(turns: int) -> float:
    start = oscillator_state(0.0, FORCED.stop, 0.0)
    until = 2 * math.pi * turns
    execution = simulate(forced_oscillator(FORCED, FORCED.restitution), start, until=until)
    assert len(execution.zeno_points) == turns
    last = until - 2 * math.pi + FORCED.zeno_time()
    errors = np.abs(execution.end_state - np.array(start))
    return max(float(np.max(errors)), abs(execution.zeno_points[-1].time - last)) / turns


def _long_ball_error(horizon: float) -> float:
    execution = simulate(_ball(restitution=0.8), (1.0, 0.0), until=horizon)
    exact = math.sqrt(2 / 9.81) * 9
    assert execution.end_time == horizon
    return max(_relative(execution.zeno_points[0].time, exact), *np.abs(execution.end_state))


def _swing_error(horizon: float) -> float:
    """Return the error of a free swing, for each radian."""
    execution = simulate(spring_mass(2.0, 0.5), (1.0, 0.0), until=horizon)
    exact = np.array([math.cos(horizon), -math.sin(horizon)])
    return float(np.max(np.abs(execution.end_state - exact))) / horizon


def _orbit_error(periods: int) -> float:
    """Return the error of the pendulum's last Zeno point on its orbit, for each period."""
    problem, compiled = _compiled("motor_pendulum")
    dynamics = bind(compiled, problem.values(parameters=CALIBRATED).vector)
    execution = simulate(dynamics, ZENO_STATE, until=periods * PERIOD + 0.1)
    zeno = execution.zeno_points[periods - 1]
    errors = np.abs(zeno.state - np.array(ZENO_STATE))
    return max(float(np.max(errors)), abs(zeno.time - periods * PERIOD)) / periods


HORIZON_ROWS = [
    *(
        Row(
            kind="pendulum on its orbit, periods",
            at=f"{periods}",
            asked="last Zeno time and state, for each period",
            truth="Taylor integration (`reference_orbit.py`)",
            error=partial(_orbit_error, periods),
            tolerance=1e-11,
            slow=periods > 100,
        )
        for periods in (50, 500)
    ),
    Row(
        kind="forced oscillator, turns",
        at="16",
        asked="last Zeno time and end, for each turn",
        truth=CLOSED,
        error=partial(_horizon_error, 16),
        tolerance=1e-12,
    ),
    Row(
        kind="forced oscillator, turns",
        at="1592",
        asked="last Zeno time and end, for each turn",
        truth=CLOSED,
        error=partial(_horizon_error, 1592),
        tolerance=1e-11,
        slow=True,
    ),
    Row(
        kind="ball at rest until 1e4 s",
        asked="Zeno time and rest",
        truth=CLOSED,
        error=partial(_long_ball_error, 1e4),
        tolerance=1e-12,
    ),
    Row(
        kind="free swing for 1e4 s",
        asked="end, for each radian",
        truth=CLOSED,
        error=partial(_swing_error, 1e4),
        tolerance=1e-12,
    ),
]


# The Zeno point comes as the stop is about to let go: d2h/dt2 -> 0.

LEAD = 0.1
"""How long before the release the mass leaves the stop [s]."""


def _sequence(speed: float) -> tuple[list[tuple[float, float]], float | None]:
    """Return time and approach speed of the impacts before the release, and the Zeno time.

    There is none if a flight outlasts the release: the last entry is then that flight's impact.
    """
    time, impacts = FORCED.release_time - LEAD, []
    while speed > 1e-18:
        duration, approach = first_return(FORCED, time, speed)
        time += duration
        impacts.append((time, approach))
        if time > FORCED.release_time:
            return impacts, None
        speed = FORCED.restitution * approach
    return impacts, time


def first_return(oscillator: StoppedOscillator, start: float, speed: float) -> tuple[float, float]:
    """Return duration and approach speed of a flight that may be short or escape.

    The mean speed over the first `d` of a flight is `w + a d / 2 + j d^2 / 6 + ...`. Where those
    three terms have a positive root, it starts Newton's method on the whole series.
    """
    derivatives = [oscillator.stop, -speed]
    for n in range(30):
        forcing = math.cos(start + n * math.pi / 2)
        derivatives.append(forcing - oscillator.damping * derivatives[-1] - derivatives[-2])
    mean = [-d / math.factorial(n) for n, d in enumerate(derivatives)][1:]
    discriminant = mean[1] ** 2 - 4 * mean[0] * mean[2]
    if mean[1] >= 0.0 or discriminant < 0.0:
        time, approach = oscillator.next_impact(start, -speed)
        return time - start, approach
    duration = 2 * mean[0] / (-mean[1] + math.sqrt(discriminant))
    for _ in range(30):
        value = sum(c * duration**n for n, c in enumerate(mean))
        slope = sum(n * c * duration ** (n - 1) for n, c in enumerate(mean) if n)
        duration -= value / slope
    return duration, -sum((n + 1) * c * duration**n for n, c in enumerate(mean))


@cache
def critical_speed() -> float:
    """Return the speed at which the impacts end just as the stop lets go."""
    low, high = 1e-4, 1e-2
    while high - low > 4e-16 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if _sequence(middle)[1] is not None else (low, middle)
    return low


def vanishing_sequence(part: float) -> tuple[list[tuple[float, float]], float | None]:
    """Return impacts and Zeno time, if any, `part` away from the critical speed."""
    return _sequence(critical_speed() * (1 + part))


def _vanishing_error(part: float) -> float:
    """Return the error of the impacts, Zeno point or not, and of the first impact after it."""
    speed = critical_speed() * (1 + part)
    impacts, zeno_time = _sequence(speed)
    start = FORCED.release_time - LEAD
    state = oscillator_state(start, FORCED.stop, -speed)
    execution = simulate(forced_oscillator(FORCED, FORCED.restitution), state, until=3.0)
    times = [impact.time + start for impact in execution.impacts]
    before = [time for time in times if time < FORCED.release_time]
    errors = [abs(time - exact) for time, (exact, _) in zip(before, impacts, strict=False)]
    if zeno_time is None:
        assert not [z for z in execution.zeno_points if z.time + start < FORCED.release_time]
        escaped = next(time for time in times if time > FORCED.release_time)
        return max(*errors, abs(escaped - impacts[-1][0]))
    zeno = execution.zeno_points[0].time + start
    landing, _ = FORCED.next_impact(FORCED.release_time, 0.0)
    again = next(time for time in times if time > FORCED.release_time)
    return max(*errors, abs(zeno - zeno_time), abs(again - landing))


VANISHING_ROWS = [
    Row(
        kind="d2h/dt2 -> 0 at the Zeno point, relative offset from the critical speed",
        at=f"{part:+.0e}",
        asked="impacts, Zeno time, first impact after the release",
        truth=CLOSED,
        error=partial(_vanishing_error, part),
        tolerance=1e-10 if abs(part) > 1e-10 else 1e-8,
        slow=abs(part) < 1e-10,
    )
    for part in (-1e-1, -1e-3, -1e-6, -1e-9, -1e-12, 1e-12, 1e-9, 1e-6, 1e-3, 1e-1)
]


# The motor pendulum: inductance, restitution, gains, masses, units.

FLYING = (0.5, 0.3, 0.0, 0.0, 0.0)
"""Both links off the vertical, the knee bent, at rest."""
LIFTED = (*ZENO_STATE[:3], 1e-3, ZENO_STATE[4])
"""At the Zeno point of the reference orbit, the knee just leaving its stop."""
CALIBRATED = {"J_rotor": 0.01792808647924, "K_torque": 0.03071770892865}


_TELLING = 1.1e-3
"""Impacts below this part of the fastest are left to the Zeno time, not resolved by everybody."""


def difference(execution: Execution, truth: Followed, until: float) -> float:
    """Return the largest error of events and end, times to the horizon, states to `1 + |x|`."""
    counts = (len(execution.zeno_points), len(execution.releases))
    assert counts == (len(truth.zeno_times), len(truth.release_times))
    errors = [0.0]
    fastest = max((-rate for _, rate in truth.impacts), default=0.0)
    slow = -max(_TELLING * fastest, 1e-3)
    seen = [(i.time, i.approach_rate) for i in execution.impacts if i.approach_rate < slow]
    known = [impact for impact in truth.impacts if impact[1] < slow]
    for (time, rate), (true_time, true_rate) in zip(seen, known, strict=True):
        errors += [abs(time - true_time) / until, abs(rate - true_rate) / (1 - true_rate)]
    pairs = [
        *zip(execution.zeno_points, truth.zeno_times, strict=True),
        *zip(execution.releases, truth.release_times, strict=True),
    ]
    errors += [abs(event.time - time) / until for event, time in pairs]
    scale = 1 + np.abs(truth.end_state)
    return float(max(*errors, np.max(np.abs(execution.end_state - truth.end_state) / scale)))


def _pendulum_error(
    parameters: Mapping[str, float],
    gains: Mapping[str, float] | None = None,
    until: float = 1.0,
    state: tuple[float, ...] = FLYING,
    method: Method = DOP853,
    relative: float = 3e-14,
) -> float:
    problem, compiled = _compiled("motor_pendulum")
    values = problem.values(parameters={**CALIBRATED, **parameters}, gains=gains)
    execution = simulate(bind(compiled, values.vector), state, until=until)
    machine = load_reference(problem).pendulum(values)
    truth = Follower(machine=machine, method=method, relative=relative).follow(state, until)
    return difference(execution, truth, until)


@dataclass(frozen=True, slots=True, kw_only=True)
class _WithoutInductance:
    """The hand-written pendulum with the current of theory (1.3) put in for its state."""

    machine: Any

    @property
    def restitution(self) -> float:
        return float(self.machine.restitution)

    def _full(self, x: Any) -> Any:
        voltage = -self.machine.proportional * x[0] - self.machine.derivative * x[2]
        current = (voltage - self.machine.emf_constant * x[2]) / self.machine.resistance
        return np.append(x, current)

    def free_flow(self, x: Any) -> Any:
        return self.machine.free_flow(self._full(x))[:4]

    def locked_flow(self, x: Any) -> Any:
        return self.machine.locked_flow(self._full(x))[:4]

    def gap_acceleration(self, x: Any) -> float:
        return float(self.machine.gap_acceleration(self._full(x)))

    def multiplier(self, x: Any) -> float:
        return float(self.machine.multiplier(self._full(x)))

    def impulse_direction(self, x: Any) -> Any:
        return self.machine.impulse_direction(self._full(x))[:4]

    def reset_map(self, x: Any, rate: float) -> Any:
        return x - (1 + self.restitution) * rate * self.impulse_direction(x)


@cache
def _quasi_static() -> tuple[Problem, CompiledSystem]:
    problem = load_problem("motor_pendulum")
    problem_file = problem.model.__globals__

    def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
        links = problem_file["lagrangian"](p)
        return hybrid_system(
            links, quasi_static_drive(links, problem_file["motor"](links, p)), p["restitution"]
        )

    without = replace(
        problem,
        model=model,
        reference=None,
        state_names=problem.state_names[:4],
        state_units=problem.state_units[:4],
    )
    return without, without.compiled()


def _quasi_static_error(until: float) -> float:
    problem, compiled = _quasi_static()
    values = problem.values(parameters=CALIBRATED)
    execution = simulate(bind(compiled, values.vector), FLYING[:4], until=until)
    machine = load_reference(load_problem("motor_pendulum")).pendulum(values)
    follower = Follower(machine=_WithoutInductance(machine=machine))
    return difference(execution, follower.follow(FLYING[:4], until), until)


def _feed_energy() -> float:
    """Follow a motion that a gain of the wrong sign feeds until it turns beyond all bounds."""
    problem, compiled = _compiled("motor_pendulum")
    values = problem.values(parameters=CALIBRATED, gains={"Kd": -1e6})
    few = SimulationSettings(most_steps=20_000)
    return simulate(bind(compiled, values.vector), FLYING, until=1.0, settings=few).end_time


EVENTS = "events and end"
PENDULUM_ROWS = [
    Row(
        kind="pendulum, L = 0 (quasi-static)",
        asked=EVENTS,
        truth=SECOND,
        error=partial(_quasi_static_error, 1.5),
        tolerance=1e-11,
    ),
    *(
        Row(
            kind="pendulum, L [H]",
            at=f"{inductance:g}",
            asked=EVENTS,
            truth=SECOND,
            error=partial(
                _pendulum_error,
                {"L": inductance},
                until=1.5,
                method=Radau if inductance < 1e-3 else DOP853,
                relative=1e-11 if inductance < 1e-3 else 3e-14,
            ),
            tolerance=1e-9 if inductance < 1e-3 else 1e-11,
            slow=inductance <= 1e-4,
        )
        for inductance in (1e-9, 1e-6, 1e-4, 2e-3, 0.1, 1.0)
    ),
    *(
        Row(
            kind="pendulum, e =",
            at=f"{e:g}",
            asked=EVENTS,
            truth=SECOND,
            error=partial(_pendulum_error, {"restitution": e}, until=1.5),
            tolerance=1e-10,
        )
        for e in (0.0, 1e-6, 0.2, 0.5, 0.9, 0.99, 0.999)
    ),
    *(
        Row(
            kind="pendulum, Zeno point from 1e-3 rad/s, e =",
            at=f"{e:g}",
            asked=EVENTS,
            truth=SECOND,
            error=partial(_pendulum_error, {"restitution": e}, until=0.1, state=LIFTED),
            tolerance=1e-11,
            slow=e >= 0.99,
        )
        for e in (0.9, 0.99, 0.999)
    ),
    *(
        Row(
            kind="pendulum, mass of link 2, relative",
            at=f"{ratio:g}",
            asked=EVENTS,
            truth=SECOND,
            error=partial(_pendulum_error, {"m2": 0.1 * ratio, "I2": 0.00075 * ratio}),
            tolerance=1e-10,
        )
        for ratio in (1e-6, 1e-3, 1e3, 1e6)
    ),
    *(
        Row(
            kind="pendulum, mass of link 1, relative",
            at=f"{ratio:g}",
            asked=EVENTS,
            truth=SECOND,
            error=partial(
                _pendulum_error,
                {"m1": 0.3 * ratio, "I1": 0.001 * ratio, "J_rotor": 0.0179 * ratio},
            ),
            tolerance=1e-11,
        )
        for ratio in (1e-3, 1e3, 1e6)
    ),
    Row(
        kind="pendulum, mass of link 1, relative",
        at="1e-06",
        asked=EVENTS,
        truth=SECOND,
        error=partial(
            _pendulum_error,
            {"m1": 0.3e-6, "I1": 1e-9, "J_rotor": 0.0179e-6},
        ),
        tolerance=1e-11,
    ),
    *(
        Row(
            kind="pendulum, Kp [V/rad]",
            at=f"{gain:g}",
            asked=EVENTS,
            truth=SECOND,
            error=partial(_pendulum_error, {}, {"Kp": gain}),
            tolerance=1e-10,
        )
        for gain in (1e-6, 1e-3, 1e3)
    ),
    Row(
        kind="pendulum, Kp [V/rad]",
        at="1e+06",
        asked=EVENTS,
        truth=SECOND,
        error=partial(_pendulum_error, {}, {"Kp": 1e6}, until=0.02),
        tolerance=1e-10,
    ),
    *(
        Row(
            kind="pendulum, Kd [V s/rad]",
            at=f"{gain:g}",
            asked=EVENTS,
            truth=SECOND,
            error=partial(_pendulum_error, {}, {"Kd": gain}, until=until),
            tolerance=1e-10,
        )
        for gain, until in ((-1e-6, 1.0), (1e-6, 1.0), (1.0, 1.0), (1e3, 1.0), (1e6, 0.1))
    ),
    Row(
        kind="pendulum, within 20000 steps, Kd [V s/rad]",
        at="-1e+06",
        asked="an end",
        truth="the motion grows without bound",
        error=_feed_energy,
        ends_in=SimulationError,
    ),
    *(
        Row(
            kind="pendulum, contact phase shrinks, e =",
            at=f"{e:g}",
            asked=EVENTS,
            truth=SECOND,
            error=partial(_pendulum_error, {"restitution": e}, until=6.0, state=ZENO_STATE),
            tolerance=1e-9,
            slow=e != 0.42,
        )
        for e in (0.4, 0.4165, 0.4168, 0.418, 0.42)
    ),
]


def _units_error(units: Units) -> float:
    """Return the difference of a motion in SI units from the same one in other units."""
    problem, compiled = _compiled("motor_pendulum")
    values = problem.values(parameters=CALIBRATED)
    until = 1.5
    plain = simulate(bind(compiled, values.vector), FLYING, until=until)
    other = problem.values(
        parameters=units.numbers(values.parameters, PENDULUM),
        gains=units.numbers(values.gains, PENDULUM),
    )
    state = np.array(FLYING) * units.state(PENDULUM_STATE)
    scaled = simulate(bind(compiled, other.vector), state, until=until * units.time)
    truth = Followed(
        impacts=[(impact.time, impact.approach_rate) for impact in plain.impacts],
        zeno_times=[zeno.time for zeno in plain.zeno_points],
        release_times=[release.time for release in plain.releases],
        end_state=plain.end_state,
    )
    return difference(units.in_si(scaled, PENDULUM_STATE, (0, 0, 0)), truth, until)


def _circle_error(units: Units, angle: float = 0.5) -> float:
    """Return the difference of a bob on a circle in SI units from the same in other units."""
    numbers = {"m": 0.7, "l": 0.4, "g": 9.81, "e": 0.5}
    start = np.array([0.4 * math.sin(angle), -0.4 * math.cos(angle), 0.0, 0.0])
    plain = simulate(CIRCLE.at(**numbers), start, until=1.5)
    scaled = start * units.state(CIRCLE.states)
    compiled = replace(
        CIRCLE.compiled,
        starts=lambda _p: (tuple(scaled.tolist()),),
        state_units=("m", "m", "m/s", "m/s"),
    )
    bob = bind(compiled, list(units.numbers(numbers, CIRCLE.parameters).values()))
    other = simulate(bob, scaled, until=1.5 * units.time)
    truth = Followed(
        impacts=[(impact.time, impact.approach_rate) for impact in plain.impacts],
        zeno_times=[zeno.time for zeno in plain.zeno_points],
        end_state=plain.end_state,
    )
    return difference(units.in_si(other, CIRCLE.states, CIRCLE.gap), truth, 1.5)


UNIT_ROWS = [
    Row(
        kind="pendulum in",
        at=words,
        asked=EVENTS,
        truth=SCALED,
        error=partial(_units_error, units),
        tolerance=1e-10,
    )
    for words, units in (
        ("mm", Units(length=1e3)),
        ("km", Units(length=1e-3)),
        ("milligrams", Units(mass=1e6)),
        ("kilotonnes", Units(mass=1e-6)),
        ("milliseconds", Units(time=1e3)),
        ("microseconds", Units(time=1e6)),
        ("hours", Units(time=1 / 3600)),
        ("mm-g-ms", Units(mass=1e3, length=1e3, time=1e3)),
    )
]

UNIT_ROWS += [
    Row(
        kind="bob on a circle in micrometres, its start rounded in the last digit",
        asked=EVENTS,
        truth=SCALED,
        error=partial(_circle_error, Units(length=1e6), 1.1),
        tolerance=1e-10,
    ),
    *(
        Row(
            kind="bob on a circle (holonomic) in",
            at=words,
            asked=EVENTS,
            truth=SCALED,
            error=partial(_circle_error, units),
            tolerance=tolerance,
        )
        for words, units, tolerance in (
            ("mm", Units(length=1e3), 1e-10),
            ("micrometres", Units(length=1e6), 1e-10),
            ("km", Units(length=1e-3), 1e-10),
            ("Mm", Units(length=1e-6), 1e-10),
        )
    ),
]


# Searches where the family of orbits ends, near e = 0.417.


def _search_error(restitution: float) -> float:
    """Return by how much a found orbit fails to close, followed from its Zeno point to the next."""
    problem = load_problem("motor_pendulum")
    values = problem.values(parameters={"restitution": restitution})
    orbit = orbit_at_gains(problem, values, shape=ONE_ZENO).unwrap()
    machine = load_reference(problem).pendulum(values)
    state = tuple(
        0.0 if name in ("theta2", "dtheta2") else value for name, value in orbit.zeno_state.items()
    )
    followed = Follower(machine=machine).follow(state, orbit.period + 1e-9)
    error = np.abs(followed.zeno_states[0] - np.array(state)) / (1 + np.abs(np.array(state)))
    return max(abs(followed.zeno_times[0] - orbit.period), float(np.max(error)))


SEARCH_ROWS = [
    *(
        Row(
            kind="orbit of the pendulum, e =",
            at=f"{e:g}",
            asked="closure after a period",
            truth=SECOND,
            error=partial(_search_error, e),
            tolerance=1e-9,
            slow=True,
        )
        for e in (0.0, 1e-6, 0.41, 0.4165)
    ),
    Row(
        kind="orbit of the pendulum past the end of the family, e =",
        at="0.42",
        asked="an orbit with a Zeno point",
        truth="none exists (contact phases above)",
        error=partial(_search_error, 0.42),
        ends_in=OrbitNotFoundError,
        slow=True,
    ),
]

ROWS = [
    *BALL_ROWS,
    *GRAZING_ROWS,
    *VANISHING_ROWS,
    *HORIZON_ROWS,
    *PENDULUM_ROWS,
    *UNIT_ROWS,
    *SEARCH_ROWS,
]


def lines(rows: Sequence[Row]) -> Mapping[str, Sequence[Row]]:
    """Return the lines of the page, up to what is seen, with their rows: those of one promise."""
    alike: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        alike.setdefault((row.kind, row.asked, row.truth, row.promise), []).append(row)
    return {
        f"| {kind} | {', '.join(row.at for row in found)} | {asked} | {truth} | {promise} |": found
        for (kind, asked, truth, promise), found in alike.items()
    }
