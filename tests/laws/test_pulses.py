"""Pulses in tables that are flat for long before: no kind of table lets a step pass one unseen.

A force over a place gives a mass the energy of its integral. A force over time moves an oscillator
by its convolution with the response to an impulse, in Gauss-Legendre sums from sample to sample.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import DOP853, solve_ivp
from scipy.interpolate import CubicSpline, PchipInterpolator, make_interp_spline

import zeno_orbits as zo
from tests.loop.agreement import needs_compiler
from tests.support.same_bits import agreed
from tests.support.tabled import mass, moved, oscillator
from zeno_orbits.integrators import Engine, Radau, SciPy
from zeno_orbits.simulation import SimulationSettings

KINDS = ("linear", "monotone", "cubic")
EXACT = 1e-10
"""Relative: a hundred times the tolerance of the integrator."""


def course(kind: str, knots: np.ndarray, values: np.ndarray) -> Any:
    """Return a table of SciPy."""
    if kind == "linear":
        return make_interp_spline(knots, values, k=1)
    return (CubicSpline if kind == "cubic" else PchipInterpolator)(knots, values)


def pulse(n: int, at: int, *heights: float) -> np.ndarray:
    """Return samples that are zero except from an index on."""
    samples = np.zeros(n)
    samples[at : at + len(heights)] = heights
    return samples


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("n", [2001, pytest.param(100_001, marks=pytest.mark.slow)])
def test_a_pulse_of_three_samples_in_a_record_is_seen(kind: str, n: int) -> None:
    # At 4.9 s the first step after a knot ends on the next one, if there are 2001 samples.
    times = np.linspace(0.0, 100.0, n)
    begin = n // 10 * 4 + 3
    samples = pulse(n, begin, 300.0, 900.0, -200.0)
    run = zo.simulate(oscillator(zo.record(times, samples, kind=kind)), until=47.0)
    near = times[begin - 40 : begin + 44]
    wanted = moved(course(kind, times, samples), near, 47.0)
    assert np.max(np.abs(wanted)) > 1e-2
    assert run.end_state[:2] == pytest.approx(wanted, rel=EXACT)


@pytest.mark.parametrize("height", [1e-6, 1.0, 1e3])
def test_a_pulse_in_a_repeated_record_is_seen(height: float) -> None:
    n = 20_000
    times = np.arange(n) * 50.0 / n
    samples = pulse(n, 13_000, height)
    run = zo.simulate(oscillator(zo.record(times, samples, period=50.0, kind="cubic")), until=40.0)
    closed = CubicSpline(np.append(times, 50.0), np.append(samples, samples[0]), bc_type="periodic")
    wanted = moved(closed, times[12_960:13_041], 40.0)
    assert run.end_state[:2] == pytest.approx(wanted, rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("speed", [1e-3, 1.0, 1e3])
def test_a_pulse_on_the_way_of_a_mass_gives_it_its_energy(kind: str, speed: float) -> None:
    knots = np.linspace(-1.0, 99.0, 10_001)
    forces = speed**2 * pulse(len(knots), 6_000, 30.0, 10.0, 5.0)
    problem = mass(lambda x, _: zo.table(x, knots, forces, kind))
    run = zo.simulate(problem, until=70.0 / speed, start={"x": 1.0, "v": speed})
    made = course(kind, knots, forces)
    work = float(made.integrate(1.0, 70.0))
    assert run.end_state[1] == pytest.approx(math.sqrt(speed**2 + 2 * work), rel=EXACT)
    assert run.end_state[1] > 1.1 * speed


def two(x: ca.SX, v: ca.SX, knots: np.ndarray, forces: np.ndarray) -> ca.SX:
    """Return a table of place and speed that does not depend on the speed."""
    speeds = np.linspace(-9.0, 9.0, 5)
    return zo.table((x, v), (knots, speeds), np.tile(forces[:, None], (1, 5)), "cubic")


def spline(x: ca.SX, _: ca.SX, knots: np.ndarray, forces: np.ndarray) -> ca.SX:
    """Return a table of CasADi."""
    return ca.interpolant("bumps", "bspline", [knots], forces)(x)


@pytest.mark.parametrize("made", [two, spline])
def test_a_pulse_in_other_smooth_tables_is_seen(made: Any) -> None:
    knots = np.linspace(-1.0, 99.0, 2001)
    forces = pulse(len(knots), 1_200, 3.0, 9.0, 2.0)
    run = zo.simulate(
        mass(lambda x, v: made(x, v, knots, forces)), until=70.0, start={"x": 1.0, "v": 1.0}
    )
    if made is two:
        work = float(CubicSpline(knots, forces).integrate(1.0, 90.0))
    else:
        at = np.linspace(50.0, 70.0, 200_001)
        work = float(
            np.trapezoid(ca.interpolant("b", "bspline", [knots], forces)(at).full()[:, 0], at)
        )
    assert run.end_state[1] == pytest.approx(math.sqrt(1.0 + 2 * work), rel=1e-9)


@pytest.mark.slow
def test_a_pulse_at_the_top_of_a_flight_is_seen() -> None:
    # The top is 0.3 cells above the middle of the pulse: the mass turns inside of it.
    knots = np.linspace(-1.0, 9.0, 4001)
    forces = -2.0 + pulse(len(knots), 2_000, 0.5, 1.5, 0.5)
    top = knots[2_001] + 0.3 * 0.0025
    made = CubicSpline(knots, forces)
    speed = math.sqrt(-2 * float(made.integrate(0.0, top)))
    problem = mass(lambda x, _: zo.table(x, knots, forces, "cubic"), restitution=0.5)
    run = zo.simulate(problem, until=6.0, start={"x": 0.0, "v": speed})

    def field(_: float, y: np.ndarray) -> list[float]:
        return [y[1], float(made(y[0]))]

    def gap(_: float, y: np.ndarray) -> float:
        return y[0]

    setattr(gap, "terminal", True)  # noqa: B010
    setattr(gap, "direction", -1)  # noqa: B010
    wanted = solve_ivp(
        *(field, (0.0, 9.0), [1e-300, speed], "DOP853"),
        rtol=1e-12,
        atol=1e-14,
        max_step=4e-3,
        events=gap,
    )
    assert run.impacts[0].time == pytest.approx(wanted.t[-1], abs=1e-9)
    assert run.impacts[0].approach_rate == pytest.approx(-speed, rel=EXACT)


@pytest.mark.parametrize("width", [3, 40, 2_000])
def test_a_pulse_of_any_width_is_seen(width: int) -> None:
    times = np.linspace(0.0, 100.0, 50_001)
    samples = pulse(len(times), 20_000, *np.sin(np.pi * np.arange(width) / width) ** 4)
    run = zo.simulate(oscillator(zo.record(times, samples, kind="cubic")), until=47.0)
    near = times[19_900 : 20_100 + width]
    wanted = moved(CubicSpline(times, samples), near, 47.0)
    assert run.end_state[:2] == pytest.approx(wanted, rel=1e-9)


def test_a_pulse_between_uneven_knots_is_seen() -> None:
    times = np.array([0.0, 10.0, 20.0, 30.0, 30.001, 30.002, 30.003, 40.0, 50.0, 60.0])
    samples = np.array([0.0, 0, 0, 0, 1, 2, 0, 0, 0, 0]) / 100
    made = CubicSpline(times, samples)
    run = zo.simulate(oscillator(zo.record(times, samples, kind="cubic")), until=47.0)
    marks = np.unique(np.concatenate([times[:-2], [47.0], np.linspace(0.0, 47.0, 4701)]))
    wanted = moved(made, marks, 47.0)
    assert run.end_state[:2] == pytest.approx(wanted, rel=1e-9)


@needs_compiler
@pytest.mark.parametrize("over", ["time", "phase", "place"])
def test_loop_and_reference_take_the_same_steps_through_a_pulse(over: str) -> None:
    samples = pulse(400, 250, 40.0)
    if over == "place":
        knots = np.linspace(-1.0, 3.0, 400)
        problem = mass(lambda x, _: zo.table(x, knots, samples - 2.0, "cubic"))
    else:
        period = 4.0 if over == "phase" else None
        times: Any = np.arange(400) * 0.01
        record = zo.record(times, samples, kind="cubic", period=period)
        problem = oscillator(record)
    agreed(problem, 3.5)


@pytest.mark.parametrize("engine", [Radau(), SciPy(method=DOP853)])
def test_other_engines_see_the_pulse(engine: Engine) -> None:
    times = np.linspace(0.0, 30.0, 3001)
    samples = pulse(3001, 2_000, 40.0, 90.0)
    problem = oscillator(zo.record(times, samples, kind="cubic"))
    settings = SimulationSettings(engine=engine)
    run = zo.simulate(problem, until=25.0, settings=settings)
    wanted = moved(CubicSpline(times, samples), times[1_960:2_043], 25.0)
    assert run.end_state[:2] == pytest.approx(wanted, rel=1e-8)
