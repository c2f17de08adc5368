"""Executions in many digits, against problems whose impacts are known in closed form."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from decimal import Decimal

import casadi as ca
import mpmath as mp
import pytest

import tests.reference.many_digits.execution as extended
from tests.reference.closed_forms import FORCED
from tests.reference.many_digits.execution import (
    ExtendedExecution,
    extended_execution,
    trace_difference,
)
from tests.reference.many_digits.fixed_point import extended_orbit
from tests.reference.many_digits.run import ExtendedRun, Trace
from tests.reference.many_digits.system import ExtendedSystem
from tests.support.cases import fast
from tests.support.mechanisms import clocked_oscillator
from zeno_orbits import HybridLagrangian, hybrid_system, no_drive
from zeno_orbits.errors import InputError, SimulationError, TranslationError
from zeno_orbits.model import CompletedSystem, load_problem
from zeno_orbits.simulation import simulate

BALL = load_problem("bouncing_ball")
G = 9.81


@pytest.fixture(autouse=True)
def _sixty_digits() -> Iterator[None]:
    with mp.workdps(60):
        yield


def _mp(value: Decimal) -> mp.mpf:
    return mp.mpf(str(value))


def _bounce(
    restitution: float,
    state: tuple[float, float] = (1.0, 0.0),
    *,
    until: float = 5.0,
    times: tuple[float, ...] = (),
    digits: int = 25,
) -> ExtendedExecution:
    values = BALL.values(parameters={"restitution": restitution})
    return extended_execution(BALL, values, state, until=until, times=times, digits=digits)


def _ball_state(restitution: float, time: float) -> tuple[mp.mpf, mp.mpf]:
    """Return height and speed of a ball dropped from 1 m, in closed form."""
    g, e = mp.mpf(G), mp.mpf(restitution)
    left, speed = mp.mpf(time), mp.mpf(0)
    height, flight = mp.mpf(1), mp.sqrt(2 / g)
    while left > flight:
        left -= flight
        speed = e * (g * flight - speed)
        height, flight = mp.mpf(0), 2 * speed / g
    return height + speed * left - g * left**2 / 2, speed - g * left


@pytest.mark.slow
@pytest.mark.parametrize("restitution", fast(1, [0.8, 0.2]))
def test_a_ball_comes_to_rest_when_the_closed_form_says(restitution: float) -> None:
    e = mp.mpf(restitution)
    ball = _bounce(restitution)
    (zeno,) = ball.zeno_points
    wanted = mp.sqrt(2 / mp.mpf(G)) * (1 + e) / (1 - e)
    assert abs(_mp(zeno.time) - wanted) < mp.mpf(10) ** -27
    assert ball.error < 1e-25
    assert [float(value) for value in zeno.state] == [0.0, 0.0]
    bounces = mp.mpf(0)
    for k, impact in enumerate(ball.impacts):
        bounces += e**k if k else 0
        fall = mp.sqrt(2 / mp.mpf(G))
        assert abs(_mp(impact.time) - fall * (1 + 2 * bounces)) < mp.mpf(10) ** -27
        assert abs(_mp(impact.approach_rate) + mp.sqrt(2 * mp.mpf(G)) * e**k) < mp.mpf(10) ** -27


def test_states_at_given_times_are_those_of_the_closed_form() -> None:
    zeno = 0.67728546147859636
    times = (0.0, 0.2, 0.5, 0.6, zeno - 1e-4, zeno - 1e-9, 0.7, 5.0)
    ball = _bounce(0.2, times=times)
    assert [float(sample.time) for sample in ball.samples] == list(times)
    for sample in ball.samples:
        wanted = (0, 0) if sample.time > zeno else _ball_state(0.2, float(sample.time))
        for value, closed in zip(sample.state, wanted, strict=True):
            assert abs(_mp(value) - closed) < mp.mpf(10) ** -25


def test_every_admissible_start_is_followed() -> None:
    ball = ExtendedSystem(BALL, BALL.values(parameters={"restitution": 0.2}), 30)

    def rests(*state: float) -> list[mp.mpf]:
        run = ExtendedRun(ball, until=5.0)
        return [mp.mpf(time.str(40, radius=False)) for time, _ in run.follow(state).zeno_points]

    e, tiny = mp.mpf(0.2), mp.mpf(10) ** -27
    ((thrown,), (striking,)) = rests(0.0, 2.0), rests(0.0, -2.0)
    assert abs(thrown - 4 / mp.mpf(G) / (1 - e)) < tiny
    assert abs(striking - 4 * e / mp.mpf(G) / (1 - e)) < tiny
    assert rests(0.0, 0.0) == []


def test_a_plastic_ball_stays_where_it_falls() -> None:
    ball = _bounce(0.0)
    assert len(ball.impacts) == 1
    assert ball.zeno_points[0].time == ball.impacts[0].time


def _oscillator_impacts() -> list[mp.mpf]:
    """Return the impact times of the forced oscillator after its release, by its closed form."""
    c, stop, e = mp.mpf(FORCED.damping), mp.mpf(FORCED.stop), mp.mpf(FORCED.restitution)
    decay = c / 2
    frequency = mp.sqrt(1 - decay**2)

    def motion(t: mp.mpf, start: mp.mpf, velocity: mp.mpf) -> tuple[mp.mpf, mp.mpf]:
        a = stop - mp.sin(start) / c
        b = (velocity - mp.cos(start) / c + decay * a) / frequency
        s, d = frequency * (t - start), mp.exp(-decay * (t - start))
        swing = (frequency * b - decay * a) * mp.cos(s) - (frequency * a + decay * b) * mp.sin(s)
        return mp.sin(t) / c + d * (a * mp.cos(s) + b * mp.sin(s)), mp.cos(t) / c + d * swing

    start, velocity, guess = mp.acos(stop), mp.mpf(0), mp.mpf("4.6665292208296586")
    times: list[mp.mpf] = []
    while not times or velocity < mp.mpf(-10) ** -29:
        # Newton's method from the guess of the parabola; 60 digits bear the cancellation.
        for _ in range(40):
            position, rate = motion(guess, start, velocity)
            guess -= (position - stop) / rate
        times.append(guess)
        velocity = -e * motion(guess, start, velocity)[1]
        start = guess
        guess = start + 2 * velocity / (mp.cos(start) - c * velocity - stop) * -1
    return times


@pytest.mark.slow
def test_the_forced_oscillator_strikes_and_rests_as_its_closed_form_says() -> None:
    times = _oscillator_impacts()
    assert float(times[1]) == pytest.approx(4.8909848023223145, abs=1e-15)
    problem = clocked_oscillator(FORCED, attracting=False)
    release = mp.acos(mp.mpf(FORCED.stop))
    phase = [Decimal(mp.nstr(value, 50)) for value in (mp.cos(release), -mp.sin(release))]
    start = (FORCED.stop, phase[0], 0.0, phase[1])
    motion = extended_execution(problem, problem.values(), start, until=7.0, digits=25)
    assert motion.error < 1e-25
    for impact, time in zip(motion.impacts, times, strict=False):
        assert abs(_mp(impact.time) + release - time) < mp.mpf(10) ** -26
    assert abs(_mp(motion.zeno_points[0].time) + release - times[-1]) < mp.mpf(10) ** -26
    assert float(times[-1]) == pytest.approx(5.06454057578434876, abs=1e-15)
    assert abs(_mp(motion.releases[-1].time) - 2 * mp.pi) < mp.mpf(10) ** -26


@pytest.mark.slow
def test_the_forced_oscillators_orbit_has_the_period_two_pi() -> None:
    problem = clocked_oscillator(FORCED, attracting=True)
    orbit = extended_orbit(problem, problem.values(), (-0.8, -0.8001, 0.0, -0.5999), digits=25)
    assert abs(_mp(orbit.period) - 2 * mp.pi) < mp.mpf(10) ** -26
    assert max(orbit.error, 10 * orbit.closure) < 1e-25
    sine = mp.sqrt(1 - mp.mpf(-0.8) ** 2)
    for value, wanted in zip(orbit.release_state, (-0.8, -0.8, 0, -sine), strict=True):
        assert abs(_mp(value) - wanted) < mp.mpf(10) ** -26
    # The clock y'' = -y + y' (1 - y^2 - y'^2): its cycle y^2 + y'^2 = 1 attracts with
    # the integral of the divergence, 1 - y^2 - 3 y'^2 = -2 y'^2, over a period: -2 pi.
    assert orbit.multipliers[0] == pytest.approx(mp.exp(-2 * mp.pi), rel=1e-6)


@pytest.mark.slow
def test_a_holonomic_constraint_changes_no_digit() -> None:
    # A pendulum of 0.5 m in its angle, and in the plane on a circle; numbers exact in both.
    def polar(p: Mapping[str, ca.SX]) -> CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        height = 0.3 * ca.sin(q) - 0.4 * ca.cos(q)
        swing = HybridLagrangian.from_energies(
            q=q, v=v, kinetic=0.125 * v**2, potential=G * height, gap=ca.sin(q)
        )
        return hybrid_system(swing, no_drive(swing), p["restitution"])

    def planar(p: Mapping[str, ca.SX]) -> CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        height = 2 * (0.3 * q[0] + 0.4 * q[1])
        swing = HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=G * height,
            gap=q[0],
            holonomic=ca.sumsqr(q) - 0.25,
        )
        return hybrid_system(swing, no_drive(swing), p["restitution"])

    ends: list[Decimal] = []
    for model, names, state in (
        (polar, ("q", "v"), (0.0, 1.0)),
        (planar, ("x", "y", "vx", "vy"), (0.0, -0.5, 0.5, 0.0)),
    ):
        problem = replace(
            BALL,
            model=model,
            state_names=names,
            state_units=tuple("1" for _ in names),
            starts=({},),
            portraits=(),
            amplitude_of=names[0],
        )
        values = problem.values(parameters={"restitution": 0.3})
        swing = extended_execution(problem, values, state, until=2.0, digits=25)
        ends.append(swing.zeno_points[0].time)
    assert abs(_mp(ends[0]) - _mp(ends[1])) < mp.mpf(10) ** -27


def test_impacts_without_a_zeno_point_are_those_of_a_simulation() -> None:
    problem = load_problem("impact_oscillator")
    start, values = problem.state_vector(problem.starts[0]), problem.values()
    motion = extended_execution(problem, values, start, until=20.0)
    assert motion.error < 1e-20
    found = simulate(problem.dynamics(values), start, until=20.0)
    assert (len(motion.impacts), motion.zeno_points, motion.releases) == (3, (), ())
    for exact, impact in zip(motion.impacts, found.impacts, strict=True):
        # The simulator promises 1e-11 a period.
        assert float(exact.time) == pytest.approx(impact.time, abs=1e-10)


def test_an_orbit_needs_a_guess_near_the_release_section() -> None:
    with pytest.raises(InputError, match=r"near a release state, .* stay off by 9\.81"):
        extended_orbit(BALL, BALL.values(), (0.0, 0.0))


def test_a_release_without_a_return_is_told() -> None:
    problem = clocked_oscillator(FORCED, attracting=True)
    with pytest.raises(SimulationError, match="No release follows"):
        extended_orbit(problem, problem.values(), (-0.8, -0.8, 0.0, -0.6), horizon=6.0)


@pytest.mark.slow
def test_an_error_that_is_too_large_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extended, "SPARE_DIGITS", (-8, 12))
    problem = clocked_oscillator(FORCED, attracting=True)
    with pytest.raises(SimulationError, match=r"certain to \S+ only, not to 25 digits"):
        extended_execution(problem, problem.values(), (-0.8, -0.8, 0.0, -0.6), until=7.0, digits=25)


def test_two_runs_differ_by_their_largest_difference() -> None:
    def trace(time: float, rate: float, n_impacts: int, sample: float) -> Trace:
        return Trace(
            impacts=[(time, rate)] * n_impacts,
            zeno_points=[(2.0, [0.0])],
            samples=[(3.0, [sample])],
        )

    base = trace(1.0, -3.0, 3, 5.0)
    assert trace_difference(base, trace(1.0, -3.0, 5, 5.0)) == 0.0
    assert trace_difference(trace(1.5, -3.0, 3, 5.0), base) == 0.25
    assert trace_difference(trace(1.0, -3.5, 3, 5.0), base) == 0.125
    assert trace_difference(trace(1.0, -3.0, 3, 5.6), base) == pytest.approx(0.1)
    assert trace_difference(base, Trace(impacts=base.impacts, zeno_points=[])) == float("inf")


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"state": (1.0,)}, "must have 2 entries, but it has 1"),
        ({"state": (1.0, float("nan"))}, "must be finite"),
        ({"state": (-0.1, 0.0)}, "must have a gap >= 0, but it is -0.1"),
        ({"until": 0.0}, "must be a positive number of seconds"),
        ({"until": float("inf")}, "must be a positive number of seconds"),
        ({"times": (6.0,)}, r"must lie in \[0, 5\]"),
        ({"times": (float("nan"),)}, r"must lie in \[0, 5\]"),
        ({"digits": 5}, r"must lie in \[10, 100\]"),
    ],
)
def test_misuse_is_told(changes: Mapping[str, object], complaint: str) -> None:
    arguments = {"state": (1.0, 0.0), "restitution": 0.2, **changes}
    with pytest.raises(InputError, match=complaint):
        _bounce(**arguments)


def test_a_model_that_is_not_analytic_is_refused_by_name() -> None:
    def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        braked = HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=G * q, gap=q, passive_force=-ca.erf(v)
        )
        return hybrid_system(braked, no_drive(braked), p["restitution"])

    problem = replace(BALL, model=model)
    with pytest.raises(TranslationError, match="one of them is `erf`"):
        extended_execution(problem, problem.values(), (1.0, 0.0), until=1.0)
