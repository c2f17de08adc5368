"""Piecewise inputs and harmonics of a clock, against matrix exponentials and Fourier sums.

An oscillator ``x'' + c x' + x = u(t)`` far from its stop is linear. Between two switching times the
input is constant, so its state follows a matrix exponential of ``(x, x', 1)``. If the switching
time `s` is later by ``ds``, the state at a later time `t` changes by ``exp(A (t - s)) b (u- - u+)
ds``, with the levels before and after it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

import zeno_orbits as zo
from tests.loop.agreement import needs_compiler
from tests.reference.relay_by_hand import D, E, M, period_by_hand, relay_by_hand
from tests.support.cases import fast
from zeno_orbits.orbits import event_return

C, OMEGA = 0.3, 1.7
PERIOD = 2 * math.pi / OMEGA
LOCATED = 1e-10
"""Of times and states: a hundred times the tolerance of the integrator."""
FLOW, INPUT = np.array([[0.0, 1.0], [-1.0, -C]]), np.array([0.0, 1.0])
Numbers = Sequence[float] | np.ndarray
Force = Callable[[zo.Clock, Mapping[str, ca.SX]], ca.SX]


def oscillator(
    force: Force, gains: Mapping[str, float], *, switches: tuple[()] | None = ()
) -> zo.Problem:
    """Return a driven oscillator far from its stop, with the gains of its force."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        x, v, clock = ca.SX.sym("x"), ca.SX.sym("v"), zo.Clock.at(ca.SX(OMEGA))
        mass = zo.HybridLagrangian.from_energies(
            q=x,
            v=v,
            kinetic=v**2 / 2,
            potential=x**2 / 2,
            passive_force=-C * v,
            applied_force=force(clock, p),
            clock=clock,
            gap=x + 100,
        )
        return zo.hybrid_system(mass, zo.no_drive(mass), p["restitution"], switches=switches)

    return zo.Problem(
        name="oscillator",
        title="oscillator under a waveform",
        source="tests/laws/test_waveforms.py",
        state_names=("x", "v", "cosine", "sine"),
        state_units=("m", "m/s", "1", "1"),
        parameters=(zo.Quantity.restitution(0.5),),
        gains=tuple(
            zo.Quantity(name=k, unit="1", meaning=k, default=v, lower=v - 1, upper=v + 1)
            for k, v in gains.items()
        ),
        model=model,
        starts=({"cosine": 1.0},),
        portraits=(("x", "v"),),
        amplitude_of="x",
    )


def switched(n: int) -> Force:
    """Return a force of ``n + 1`` levels whose levels and times are gains."""
    return lambda clock, p: zo.piecewise(
        clock, [p[f"u{k}"] for k in range(n + 1)], [p[f"t{k}"] for k in range(1, n + 1)]
    )


def drawn(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return random levels, and random times that are apart."""
    times = (np.arange(1, n + 1) + rng.uniform(-0.4, 0.4, n)) * PERIOD / (n + 1)
    return rng.uniform(-2, 2, n + 1), times


def gains_of(levels: Numbers, times: Numbers) -> dict[str, float]:
    """Return levels and times by name."""
    named = {f"u{k}": float(level) for k, level in enumerate(levels)}
    return named | {f"t{k}": float(time) for k, time in enumerate(times, start=1)}


def followed(
    levels: Numbers, times: Numbers, x: np.ndarray, begin: float, until: float
) -> np.ndarray:
    """Return the state at a time, from a state at an earlier time, by matrix exponentials."""
    turns = range(int(until / PERIOD) + 1)
    marks = [k * PERIOD + t for k in turns for t in (0.0, *times)]
    here = begin
    for mark in [*(t for t in sorted(marks) if begin < t < until), until]:
        level = levels[int(np.searchsorted(times, (here + mark) / 2 % PERIOD))]
        rest = np.linalg.solve(FLOW, -INPUT * level)
        x, here = rest + expm(FLOW * (mark - here)) @ (x - rest), mark
    return x


@pytest.mark.parametrize("n", range(1, 8))
@pytest.mark.parametrize("starts_anew", [True, False])
def test_every_phase_has_its_level(n: int, starts_anew: bool) -> None:
    rng = np.random.default_rng(n)
    omega, times = ca.SX.sym("omega"), ca.SX.sym("t", n)
    clock = zo.Clock.at(omega)
    levels = [float(k) for k in range(n)] + [float(n) if starts_anew else 0.0]
    formula = zo.piecewise(clock, levels, [times[k] for k in range(n)])
    value = ca.Function("u", [clock.state, omega, times], [formula])
    for _ in range(200):
        turning = rng.uniform(0.5, 3)
        period = 2 * math.pi / turning
        switching, time = np.sort(rng.uniform(0, period, n)), rng.uniform(0, period)
        angle = turning * time
        found = float(value([math.cos(angle), math.sin(angle)], turning, switching))
        assert found == levels[int(np.searchsorted(switching, time))]


@pytest.mark.parametrize("n", fast(2, [1, 2, 3, 4]))
def test_an_oscillator_follows_its_levels_from_every_phase(n: int) -> None:
    rng = np.random.default_rng(n)
    levels, times = drawn(n, rng)
    problem = oscillator(switched(n), gains_of(levels, times))
    until = 3.3 * PERIOD
    for begin in (0.0, times[0], *rng.uniform(0, PERIOD, 3)):
        x = rng.uniform(-1, 1, 2)
        start = {"x": x[0], "v": x[1]}
        start |= {"cosine": math.cos(OMEGA * begin), "sine": math.sin(OMEGA * begin)}
        run = zo.simulate(problem, until=until - begin, start=start)
        wanted = followed(levels, times, x, begin, until)
        assert run.end_state[:2] == pytest.approx(wanted, abs=LOCATED)
        # Every switch is one event. A start on a switch has passed it already.
        marks = [k * PERIOD + t for k in range(4) for t in (0.0, *times)]
        marks = [t for t in marks if begin + 1e-9 < t < until]
        seen = np.array([event.time + begin for event in run.switches])
        assert all(np.min(np.abs(seen - t)) < LOCATED for t in marks)
        without_effect = 0 if n % 2 else round(3.3) + 1
        assert len(marks) <= len(seen) <= len(marks) + without_effect


@pytest.mark.parametrize("n", fast(2, [1, 2, 3, 5]))
def test_derivatives_with_respect_to_times_and_levels_are_exact(n: int) -> None:
    rng = np.random.default_rng(10 + n)
    levels, times = drawn(n, rng)
    named = gains_of(levels, times)
    problem = oscillator(switched(n), named)
    x = np.array([0.4, -0.2, 1.0, 0.0])
    found = event_return(
        problem.graph_dynamics(problem.values()),
        x,
        section="switch kink 1",
        n_returns=2,
        guess=PERIOD,
        settings=zo.SimulationSettings(),
        parameters=[problem.place(name) for name in named],
    )
    assert found.period == pytest.approx(PERIOD, abs=LOCATED)
    bounds = np.array([0.0, *times, PERIOD])
    by_levels: list[Any] = [
        np.linalg.solve(FLOW, (expm(FLOW * (PERIOD - a)) - expm(FLOW * (PERIOD - b))) @ INPUT)
        for a, b in pairwise(bounds)
    ]
    by_times: list[Any] = [
        expm(FLOW * (PERIOD - time)) @ INPUT * (before - after)
        for time, before, after in zip(times, levels[:-1], levels[1:], strict=True)
    ]
    wanted = np.array([*by_levels, *by_times]).T
    assert found.by_parameters[:2] == pytest.approx(wanted, abs=LOCATED)
    assert found.by_state[:2, :2] == pytest.approx(expm(FLOW * PERIOD), abs=LOCATED)


# Narrow pulses.

ROUNDED = 4e-15
"""Rounding of times and of the clock, over the part of the period that is a pulse."""
Wave = tuple[tuple[float, ...], tuple[float, ...]]


def pulses(*begins: float) -> Callable[[float], Wave]:
    """Return pulses of unit impulse between levels that differ, by their part of the period."""

    def wave(part: float) -> Wave:
        times = [(begin + k * part) * PERIOD for begin in begins for k in (0, 1)]
        levels = [0.5]
        for k in range(len(begins)):
            levels += [1 / (times[2 * k + 1] - times[2 * k]), 0.3 - 0.2 * k]
        return tuple(levels), tuple(times)

    return wave


def side_by_side(part: float) -> Wave:
    """Return three pulses without a pause between them."""
    width = part * PERIOD
    return (0.0, 1 / width, -0.5 / width, 2 / width, 0.1), tuple(
        0.4 * PERIOD + k * width for k in range(4)
    )


def across_the_start(part: float) -> Wave:
    """Return a pulse around the start of the period."""
    push, width = 1 / (part * PERIOD), part * PERIOD
    return (push, 0.2, push), (width / 2, PERIOD - width / 2)


def pause(part: float) -> Wave:
    """Return a level that a pulse interrupts."""
    begin, end = 0.6 * PERIOD, (0.6 + part) * PERIOD
    return (0.5, 0.5 - 1 / (end - begin), 0.5), (begin, end)


WAVES: dict[str, Callable[[float], Wave]] = {
    "one": pulses(0.3),
    "three": pulses(0.1, 0.35, 0.8),
    "side by side": side_by_side,
    "across the start": across_the_start,
    "pause": pause,
}


@needs_compiler
@pytest.mark.parametrize("part", fast(1, [1e-1, 1e-9, 3e-3, 1e-6]))
@pytest.mark.parametrize("name", WAVES)
def test_a_short_pulse_acts_as_its_impulse(name: str, part: float) -> None:
    levels, times = WAVES[name](part)
    problem = oscillator(lambda clock, _: zo.piecewise(clock, levels, times), {})
    wanted = followed(levels, times, np.array([0.1, 0.0]), 0.0, 1.5 * PERIOD)
    run = zo.simulate(problem, until=1.5 * PERIOD, start={"x": 0.1, "cosine": 1.0})
    assert run.end_state[:2] == pytest.approx(wanted, abs=LOCATED + ROUNDED / part)


@pytest.mark.parametrize("loop", [pytest.param("use", marks=needs_compiler), "never"])
@pytest.mark.parametrize("part", fast(2, [1e-2, 1e-8, 1e-5]))
def test_a_run_may_start_with_a_short_pulse(
    part: float, loop: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The first arc ends in its first step, on the other side of the switch where it starts.
    monkeypatch.setenv("ZENO_ORBITS_LOOP", loop)
    levels, times = WAVES["one"](part)
    problem = oscillator(lambda clock, _: zo.piecewise(clock, levels, times), {})
    angle, until = OMEGA * times[0], 0.3 * PERIOD
    start = {"x": 0.1, "cosine": math.cos(angle), "sine": math.sin(angle)}
    wanted = followed(levels, times, np.array([0.1, 0.0]), times[0], times[0] + until)
    run = zo.simulate(problem, until=until, start=start)
    assert run.end_state[:2] == pytest.approx(wanted, abs=LOCATED + ROUNDED / part)


@pytest.mark.parametrize("part", [1e-2, 1e-6, 1e-9])
def test_the_reference_in_python_sees_a_short_pulse(
    part: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENO_ORBITS_LOOP", "never")
    levels, times = WAVES["one"](part)
    problem = oscillator(lambda clock, _: zo.piecewise(clock, levels, times), {})
    wanted = followed(levels, times, np.array([0.1, 0.0]), 0.0, 0.5 * PERIOD)
    run = zo.simulate(problem, until=0.5 * PERIOD, start={"x": 0.1, "cosine": 1.0})
    assert run.end_state[:2] == pytest.approx(wanted, abs=LOCATED + ROUNDED / part)


@pytest.mark.slow
@pytest.mark.parametrize(
    "part", [3e-3, *(pytest.param(one, marks=pytest.mark.slow) for one in (1e-4, 1e-5, 1e-7))]
)
def test_orbits_and_maps_of_short_pulses_have_their_closed_form(part: float) -> None:
    levels, times = pulses(0.3)(part)
    problem = oscillator(
        lambda clock, p: zo.piecewise(clock, levels, (p["t"], p["t"] + part * PERIOD)),
        {"t": times[0]},
    )
    orbit = zo.find_orbit(problem).unwrap()
    wanted = sorted(map(complex, np.linalg.eigvals(expm(FLOW * PERIOD))), key=lambda mu: mu.imag)
    found = sorted(orbit.floquet_multipliers, key=lambda mu: mu.imag)
    assert orbit.period == pytest.approx(PERIOD, abs=LOCATED)
    assert found == pytest.approx(wanted, abs=1e-9)
    assert orbit.certificate["passed"]
    # Over two periods the state is the same: the orbit is that of all its pulses.
    x = np.array([orbit.start_state["x"], orbit.start_state["v"]])
    begin = math.atan2(orbit.start_state["sine"], orbit.start_state["cosine"]) / OMEGA % PERIOD
    assert followed(levels, times, x, begin, begin + PERIOD) == pytest.approx(x, abs=1e-8)
    plane = zo.parameter_map(problem, x=("t", 0.5, 1.5, 2), y=("x", 0.0, 1.0, 2))
    for one in plane.attractors:
        radii = [abs(mu) for mu in one.multipliers]
        assert radii == pytest.approx([math.exp(-C * PERIOD / 2)] * 2, abs=1e-8)


@pytest.mark.parametrize("width", [5e-10, 1e-12, 1e-15])
def test_a_pulse_in_the_rounding_of_its_phase_is_refused(width: float) -> None:
    words = r"at least 2e-10 of its period apart, but .* s above (`t1` = )?1 s"
    with pytest.raises(ValueError, match=words):
        oscillator(
            lambda clock, _: zo.piecewise(clock, (0.0, 1 / width, 0.0), (1.0, 1.0 + width)), {}
        ).checked()
    gains = gains_of((0.0, 1.0, 0.0), (1.0, 2.0))
    with pytest.raises(zo.SwitchingTimesError, match=words):
        zo.simulate(oscillator(switched(2), gains), until=1.0, gains={"t2": 1.0 + width})


def test_harmonics_are_a_fourier_sum() -> None:
    rng = np.random.default_rng(0)
    clock, a = zo.Clock.at(ca.SX(1.0)), ca.SX.sym("a", 12, 2)
    formula = zo.harmonics(clock, [(a[k, 0], a[k, 1]) for k in range(12)])
    value = ca.Function("u", [clock.state, a], [formula])
    for angle in rng.uniform(-math.pi, math.pi, 50):
        amplitudes = rng.uniform(-1, 1, (12, 2))
        orders = np.arange(1, 13)
        wanted = amplitudes[:, 0] @ np.cos(orders * angle) + amplitudes[:, 1] @ np.sin(
            orders * angle
        )
        found = float(value([math.cos(angle), math.sin(angle)], amplitudes))
        assert found == pytest.approx(wanted, abs=1e-13)


def test_an_oscillator_answers_harmonics_with_its_frequency_response() -> None:
    amplitudes = ((0.3, -0.4), (0.0, 1.0), (0.7, 0.2))
    problem = oscillator(lambda clock, _: zo.harmonics(clock, amplitudes), {}, switches=None)

    def answer(time: float) -> tuple[float, float]:
        orders = OMEGA * np.arange(1, 4)
        forces = np.array([complex(a, -b) for a, b in amplitudes])
        wave = forces / (1 - orders**2 + 1j * C * orders) * np.exp(1j * orders * time)
        return float(np.sum(wave).real), float(np.sum(1j * orders * wave).real)

    begin, until = 0.4, 6.0
    x, v = answer(begin)
    start = {"x": x, "v": v, "cosine": math.cos(OMEGA * begin), "sine": math.sin(OMEGA * begin)}
    run = zo.simulate(problem, until=until - begin, start=start)
    assert run.end_state[:2] == pytest.approx(answer(until), abs=LOCATED)


# A relay, whose contact bounces on a voltage with four switches in a period.

SOFT, ROBUST = (1.17589, 3.48276), (1.20713, 2.49154)
"""Published switching times [ms]: for one machine, and for 5 % of change in ks and R."""


def period_of(times: tuple[float, float], **parameters: float) -> zo.Execution:
    """Return the same period of the bundled problem, without the flux of the period before."""
    gains = {"t1": 1e-3 * times[0], "t2": 1e-3 * times[1]}
    start = {"z": 1e-3 * D, "flux": 3.3760203e-11, "cosine": 1.0}
    return zo.simulate("relay_soft", until=0.0399, start=start, gains=gains, parameters=parameters)


def lost_when_closing(times: tuple[float, float], **parameters: float) -> float:
    """Return the energy lost at the closed stop, with the geometric tail of its impacts [J]."""
    impacts = [one for one in period_of(times, **parameters).impacts if one.stop == "closed"]
    speeds = np.array([one.approach_rate for one in impacts])
    return float(M / 2 * ((1 - E**2) * np.sum(speeds**2) + E**2 * speeds[-1] ** 2))


@pytest.mark.slow
@pytest.mark.parametrize("times", [SOFT, ROBUST])
def test_a_relay_closes_as_in_an_independent_event_loop(times: tuple[float, float]) -> None:
    hand = period_by_hand(relay_by_hand(55.0, 50.0, times))
    run = period_of(times)
    for kind, ours in (
        ("switch", run.switches),
        ("release", run.releases),
        ("zeno", run.zeno_points),
    ):
        wanted = [one.time for one in hand if one.kind == kind]
        # The times depend on speeds of 1 mm/s at the nominal optimum.
        assert [1e3 * one.time for one in ours if one.time > 0] == pytest.approx(wanted, abs=1e-9)
    for stop in ("closed", "open"):
        # Ours ends the sequence after another number of impacts.
        speeds = [one.approach_rate for one in run.impacts if one.stop == stop][:6]
        told = [one.rate for one in hand if (one.kind, one.name) == ("impact", stop)][:6]
        assert speeds == pytest.approx(told, abs=LOCATED)


@pytest.mark.slow
def test_a_relay_at_its_published_times_closes_almost_without_impact() -> None:
    plain = 2.65121545e-3
    assert lost_when_closing(SOFT) < 1e-5 * plain
    # Half a unit of the last published digit away, the impact vanishes.
    assert lost_when_closing((1.17588778, 3.48277863)) < 4e-9 * plain


@pytest.mark.slow
def test_the_worst_corner_of_a_robust_relay_loses_the_published_energy() -> None:
    corners = [(55.0 * a, 50.0 * b) for a in (0.95, 1.05) for b in (0.95, 1.05)]
    worst = max(lost_when_closing(ROBUST, ks=ks, R=r) for ks, r in corners)
    assert worst == pytest.approx(4.34e-4, abs=5e-7)
    # The times of one machine are worse when it changes.
    nominal = max(lost_when_closing(SOFT, ks=ks, R=r) for ks, r in corners)
    assert nominal == pytest.approx(1.95e-3, abs=5e-6)


# Bad input.


@pytest.mark.parametrize(
    ("levels", "times", "words"),
    [
        ((1.0, 2.0), (), "one entry more than `times`"),
        ((1.0, 2.0), (0.1, 0.2), "one entry more than `times`"),
        ((1.0, 2.0, 3.0), (0.2, 0.1), "0.1 s is not above 0.2 s"),
        ((1.0, 2.0, 3.0), (0.2, 0.2), "0.2 s is not above 0.2 s"),
        ((1.0, 2.0), (0.0,), "0 s is not above 0 s"),
        ((1.0, 2.0), (7.0,), "6.28319 s is not above 7 s"),
        ((1.0, ca.SX.sym("u", 2)), (1.0,), "scalars only"),
    ],
)
def test_levels_and_times_that_do_not_fit_are_refused(
    levels: tuple[Any, ...], times: tuple[float, ...], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        zo.piecewise(zo.Clock.at(ca.SX(1.0)), levels, times)


@pytest.mark.parametrize("amplitudes", [(), (1.0, 2.0), ((1.0,),)])
def test_amplitudes_that_are_no_pairs_are_refused(amplitudes: Any) -> None:
    with pytest.raises(ValueError, match=r"a pair of|each entry a sequence"):
        zo.harmonics(zo.Clock.at(ca.SX(1.0)), amplitudes)


@pytest.mark.parametrize(
    ("moved", "words"),
    [
        ({"t1": 2.5}, "`t2` = 2 s is not above `t1` = 2.5 s"),
        ({"t1": 2.0}, "`t2` = 2 s is not above `t1` = 2 s"),
        ({"t1": -0.1}, "`t1` = -0.1 s is not above 0 s"),
        ({"t2": 4.0}, "3.69599 s is not above `t2` = 4 s"),
    ],
)
def test_gains_that_change_the_order_of_the_times_are_refused(
    moved: dict[str, float], words: str
) -> None:
    problem = oscillator(switched(2), gains_of((1.0, 0.0, 2.0), (1.0, 2.0)))
    with pytest.raises(zo.SwitchingTimesError, match=words):
        zo.simulate(problem, until=1.0, gains=moved)
    with pytest.raises(zo.SwitchingTimesError, match=words):
        zo.find_orbit(problem, gains=moved).unwrap()


def test_times_of_the_state_are_refused() -> None:
    with pytest.raises(ValueError, match="numbers, gains and parameters only"):
        oscillator(lambda clock, _: zo.piecewise(clock, (1, 0), (clock.sine,)), {}).checked()


def test_a_piecewise_input_needs_no_switches() -> None:
    gains = gains_of((1.0, 0.0), (1.0,))
    ends = [
        zo.simulate(oscillator(switched(1), gains, switches=given), until=5.0).end_state
        for given in (None, ())
    ]
    assert np.array_equal(*ends)
