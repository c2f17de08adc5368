"""Energy, peaks, amplitudes and signals of orbits of events, against closed forms.

The machines with closed forms are in `tests/support/coil_hopper.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.coil_hopper import COIL_HOPPER, CoilHop, wave_coil
from tests.support.orbits import event_orbit
from zeno_orbits.orbits import (
    EventCourse,
    EventReturn,
    Reading,
    closed_return,
    course_signal_names,
    inverse_of_closing,
)
from zeno_orbits.simulation import SimulationSettings

BOX = {"U": (6.0, 25.0)}


def _search(objective: Any, **options: Any) -> zo.SearchResult:
    return zo.search_gains(COIL_HOPPER, objective=objective, **options)


def _least(function: Callable[[float], float]) -> float:
    """Return the least value over the voltage."""
    options = {"xatol": 1e-12}
    found: Any = minimize_scalar(function, bounds=BOX["U"], method="bounded", options=options)
    return float(found.fun)


def _voltage(quantity: Callable[[CoilHop], float], value: float) -> float:
    """Return the voltage at which a quantity has a value."""
    return float(brentq(lambda u: quantity(CoilHop(voltage=u)) - value, *BOX["U"], xtol=1e-14))


# Objectives.


@pytest.mark.slow
def test_the_least_energy_has_its_closed_form() -> None:
    found = _search(zo.MinEnergy())
    assert found.orbit is not None
    assert found.orbit.certificate["passed"]
    # SLSQP ends at a relative change of 1e-9.
    assert found.value == pytest.approx(_least(lambda u: CoilHop(voltage=u).energy), rel=1e-8)
    assert found.value == pytest.approx(CoilHop(voltage=found.free["U"]).energy, rel=1e-11)
    worked = found.orbit.certificate["energies"]["input_work"]
    assert found.value == pytest.approx(worked, rel=1e-10)


@pytest.mark.slow
def test_the_least_peak_is_where_two_peaks_are_equal() -> None:
    # At half the sum of both voltages the current is constant.
    found = _search(zo.MinPeak(signal="current"))
    assert found.free["U"] == pytest.approx(8.0, abs=1e-8)
    assert found.value == pytest.approx(8.0 / 3.0, rel=1e-9)


@pytest.mark.slow
def test_the_peak_of_a_speed_is_its_value_before_an_impact() -> None:
    found = _search(zo.MinPeak(signal="speed"), vary={"U": (8.0, 12.0)})
    assert found.value == pytest.approx(CoilHop(voltage=8.0).impact_speed, rel=1e-10)


@pytest.mark.slow
def test_a_third_harmonic_takes_its_known_part_from_the_peak_of_a_sine() -> None:
    # sin + sin(3)/6 has the peak sqrt(3)/2, the least of all third harmonics.
    found = zo.search_gains(wave_coil((3,)), objective=zo.MinPeak(signal="current"))
    assert found.free["g3"] == pytest.approx(1 / 6, abs=1e-6)
    assert found.value == pytest.approx(math.sqrt(3) / 2, rel=1e-10)


@pytest.mark.slow
def test_two_harmonics_have_the_peak_of_a_linear_program() -> None:
    from scipy.optimize import linprog

    found = zo.search_gains(wave_coil((3, 5)), objective=zo.MinPeak(signal="current"))
    angles = np.linspace(0.0, np.pi / 2, 20001)
    waves = np.array([np.sin(3 * angles), np.sin(5 * angles)]).T
    one = np.ones((len(angles), 1))
    solved: Any = linprog(
        [0.0, 0.0, 1.0],
        A_ub=np.vstack([np.hstack([waves, -one]), np.hstack([-waves, -one])]),
        b_ub=np.concatenate([-np.sin(angles), np.sin(angles)]),
        bounds=[(-0.5, 0.5), (-0.5, 0.5), (0.0, None)],
    )
    # The grid of angles misses a peak by less than its step squared.
    assert found.value == pytest.approx(float(solved.fun), abs=1e-7)
    assert [found.free["g3"], found.free["g5"]] == pytest.approx(solved.x[:2], abs=1e-4)


@pytest.mark.slow
def test_a_prescribed_amplitude_is_reached() -> None:
    found = _search(zo.TargetAmplitude(state="height", target=0.2))
    assert found.orbit is not None
    assert found.free["U"] == pytest.approx(_voltage(lambda hop: hop.highest / 2, 0.2), rel=1e-9)


@pytest.mark.slow
def test_an_amplitude_that_no_orbit_has_is_missed_by_a_printed_distance() -> None:
    found = _search(zo.TargetAmplitude(state="height", target=1.0), vary={"U": (8.0, 12.0)})
    assert found.orbit is None
    nearest = CoilHop(voltage=12.0).highest / 2
    assert f"The nearest that was reached has an amplitude of {nearest:.10g}"[:-2] in found.detail
    assert f"by {1.0 - nearest:.3g}." in found.detail


@pytest.mark.weekly
@pytest.mark.slow
def test_the_worst_case_over_a_range_has_its_closed_form() -> None:
    ends = (2.5, 3.5)
    found = _search(zo.MinEnergy(uncertain={"R": ends}))

    def worst(u: float) -> float:
        return max(CoilHop(voltage=u, resistance=r).energy for r in (3.0, *ends))

    assert found.worst == pytest.approx(_least(worst), rel=1e-8)
    assert found.worst_at == {"R": 2.5}
    mean = [CoilHop(voltage=found.free["U"], resistance=r).energy for r in ends]
    assert found.mean == pytest.approx(sum(mean) / 2, rel=1e-9)
    peak = _search(zo.MinPeak(signal="current", uncertain={"R": ends}))
    assert peak.worst == pytest.approx(8.0 / 2.5, rel=1e-9)


# Bounds.


@pytest.mark.slow
def test_bounds_on_signals_and_numbers_are_touched_where_they_decide() -> None:
    quantities: list[tuple[zo.Bound, Callable[[CoilHop], float], float]] = [
        (zo.Bound(name="height", upper=0.3), lambda hop: hop.highest, 0.3),
        (zo.Bound(name="current", upper=2.9), lambda hop: hop.currents[1], 2.9),
        (zo.Bound(name="current", lower=2.4), lambda hop: min(hop.currents), 2.4),
        (zo.Bound(name="speed", lower=-2.2), lambda hop: hop.impact_speed, 2.2),
        (zo.Bound(name="energy", lower=8.0), lambda hop: hop.energy, 8.0),
    ]
    for bound, quantity, value in quantities:
        found = _search(
            zo.NearestGains(target={"U": 12.0}), vary={"U": (6.0, 14.0)}, bounds=[bound]
        )
        assert found.orbit is not None, bound
        reached = quantity(CoilHop(voltage=found.free["U"]))
        assert reached == pytest.approx(value, rel=1e-8), bound
        (asked,) = found.asked
        assert asked["kept"]


@pytest.mark.slow
def test_the_least_energy_keeps_a_bound_on_a_signal() -> None:
    found = _search(zo.MinEnergy(), bounds=[zo.Bound(name="current", upper=3.0)])
    voltage = _voltage(lambda hop: hop.currents[1], 3.0)
    assert found.free["U"] == pytest.approx(voltage, rel=1e-8)
    assert found.value == pytest.approx(CoilHop(voltage=voltage).energy, rel=1e-8)


@pytest.mark.slow
def test_a_bound_on_the_spectral_radius_is_kept() -> None:
    # One multiplier is the square of the restitution, the other that of the coil.
    bound = zo.Bound(name="spectral_radius", upper=0.16)
    found = _search(zo.NearestGains(target={}), vary={"restitution": (0.3, 0.6)}, bounds=[bound])
    assert found.free["restitution"] == pytest.approx(0.4, rel=1e-6)


@pytest.mark.slow
def test_a_bound_on_a_signal_that_no_orbit_keeps_is_named_with_its_excess() -> None:
    found = _search(zo.MinEnergy(), bounds=[zo.Bound(name="height", upper=0.12)])
    assert found.orbit is None
    lowest = CoilHop(voltage=6.0).highest
    assert f"`height` leaves its bounds :0.12 by {lowest - 0.12:.3g}" in found.detail


# Derivatives.


SETTINGS = SimulationSettings()


def _course(
    problem: zo.Problem, near: zo.Orbit, name: str, value: float
) -> tuple[EventCourse, EventReturn]:
    """Return the orbit near another at a value of a gain or parameter."""
    values = near.values(problem).replaced({name: value})
    graph = problem.graph_dynamics(values)
    chosen = (list(values.numbers).index(name),)
    found = closed_return(
        graph,
        np.array(problem.state_vector(near.start_state)),
        section=near.section,
        n_returns=near.n_returns,
        guess=near.period,
        settings=SETTINGS,
        parameters=chosen,
    )
    return EventCourse(graph=graph, found=found, parameters=chosen), found


def _along(course: EventCourse, found: EventReturn, reading: Reading) -> float:
    """Return the derivative of a value along the orbits."""
    moved = inverse_of_closing(course.graph, found) @ found.by_parameters[:, 0]
    n_x = len(found.start)
    return float(reading.by[:n_x] @ moved + reading.by[n_x])


@pytest.mark.parametrize(
    ("name", "parameter"),
    fast(
        1,
        [
            ("hopper", "a"),
            ("relay_soft", "t1"),
            ("limited_pendulum", "U"),
            ("limited_pendulum", "Kp"),
            ("powered_walker", "step"),
        ],
    ),
)
def test_derivatives_along_orbits_are_those_of_differences(name: str, parameter: str) -> None:
    problem = zo.load_problem(name)
    near = zo.find_orbit(problem).unwrap()
    first = near.values(problem).number(parameter)
    step = 1e-4 * abs(first)
    course, found = _course(problem, near, parameter, first)
    (below, _), (above, _) = (
        _course(problem, near, parameter, first + sign * step) for sign in (-1, 1)
    )
    by = (above.work.value - below.work.value) / (2 * step)
    # The error of a central difference is that of the step squared.
    assert _along(course, found, course.work) == pytest.approx(by, rel=1e-6)
    assert course.work.value == pytest.approx(near.certificate["energies"]["input_work"], rel=1e-10)
    for signal in set(course_signal_names(problem.compiled_graph())) - {"cosine", "sine"}:
        for sign in (1.0, -1.0):
            sides = (one.peaks(signal, sign, 1)[0].reading.value for one in (below, above))
            low, high = sides
            peak = course.peaks(signal, sign, 1)[0].reading
            size = abs(peak.value) / abs(first)
            # The ends of a motion on a stop are zero to rounding.
            wanted = pytest.approx((high - low) / (2 * step), rel=1e-6, abs=1e-6 * size + 1e-11)
            assert _along(course, found, peak) == wanted, (signal, sign)


@pytest.mark.slow
def test_peaks_are_the_largest_values_of_a_fine_sampling() -> None:
    problem = zo.load_problem("limited_pendulum")
    near = zo.find_orbit(problem).unwrap()
    course, found = _course(problem, near, "U", 5.0)
    motion = found.execution
    times = np.linspace(0.0, found.period, 40001)
    for k, signal in enumerate(problem.state_names):
        values = motion.states_at(times)[:, k]
        extent = course.extent(signal)
        assert extent.highest >= values.max() - 1e-12
        assert extent.lowest <= values.min() + 1e-12
        # A sampled peak is lower by the square of the distance of two samples, an end by its slope.
        assert extent.highest == pytest.approx(values.max(), abs=1e-3)
        assert extent.lowest == pytest.approx(values.min(), abs=1e-3)


# A machine with one stop, as a machine over its modes.


def _inert() -> zo.Problem:
    """Return the motor pendulum with a switch that no motion reaches."""
    motor = zo.load_problem("motor_pendulum")

    def model(p: Any) -> zo.CompletedSystem:
        one = motor.model(p)
        angle, rate = one.mechanism.q[0], one.mechanism.v[0]
        never = zo.Switch(name="never", guard=100 - angle, armed=rate)
        return zo.hybrid_system(one.mechanism, one.drive, p["restitution"], switches=(never,))

    return replace(
        motor, name="inert_pendulum", model=model, fidelities={}, reference=None, rig=None
    )


@pytest.mark.weekly
@pytest.mark.slow
@pytest.mark.parametrize(
    ("objective", "bounds"),
    [
        (zo.MinEnergy(), [zo.Bound(name="spectral_radius", upper=0.3)]),
        (zo.TargetAmplitude(state="theta1", target=1.55), []),
    ],
)
def test_an_inert_switch_does_not_change_the_optimum(
    objective: Any, bounds: list[zo.Bound]
) -> None:
    free = {"Kp": (2.0, 4.0), "Kd": (-1.2, -0.8)}
    over_modes = zo.search_gains(_inert(), vary=free, objective=objective, bounds=bounds)
    plain = zo.search_gains("motor_pendulum", vary=free, objective=objective, bounds=bounds)
    assert over_modes.orbit is not None
    assert plain.orbit is not None
    # Ipopt keeps bounds to 1e-8 of its own scale, and the plain search lies inside by as much.
    assert over_modes.orbit.gains == pytest.approx(plain.orbit.gains, abs=5e-6)
    quantities = objective.quantities
    if quantities:
        best = plain.candidates[0].extents[quantities[0]]
        assert over_modes.value == pytest.approx(objective.rank(best), rel=1e-6)


@pytest.mark.weekly
@pytest.mark.slow
def test_no_orbit_of_a_line_of_equal_periods_takes_less_energy() -> None:
    free = {"Kp": (1.5, 5.0), "Kd": (-1.4, -0.7)}
    found = zo.search_gains(
        "limited_pendulum",
        vary=free,
        objective=zo.MinEnergy(),
        bounds=[zo.Bound(name="period", lower=1.8)],
    )
    assert found.orbit is not None

    def orbit(kp: float, kd: float) -> zo.Orbit:
        return zo.find_orbit(
            "limited_pendulum", near=found.orbit, gains={"Kp": kp, "Kd": kd}
        ).unwrap()

    for kp in np.linspace(1.5, 4.5, 7):
        # The period grows with the derivative gain.
        ends = free["Kd"]
        if (orbit(kp, ends[0]).period - 1.8) * (orbit(kp, ends[1]).period - 1.8) > 0.0:
            continue
        kd = float(brentq(lambda kd, kp=kp: orbit(kp, kd).period - 1.8, *ends, xtol=1e-10))
        worked = orbit(kp, kd).certificate["energies"]["input_work"]
        assert worked >= found.value * (1 - 1e-8)


# Pushes. Just after the impact of a hopper the impulse m e v stops it, and it stays at rest.


@pytest.mark.slow
def test_the_largest_push_keeps_a_bound_and_has_its_closed_form() -> None:
    found = zo.search_gains(
        "hopper",
        vary={"a": (15.0, 25.0)},
        objective=zo.MaxPush(),
        bounds=[zo.Bound(name="stop.impact_speed", upper=2.4)],
    )
    assert found.orbit is not None
    assert found.orbit.certificate["passed"]
    (asked,) = found.asked
    assert asked["kept"]
    # An impulse is located to 1e-3, and the search ends in a region of 2e-3 of the range.
    assert found.value == pytest.approx(0.5 * asked["highest"], rel=1.5e-3)
    assert asked["highest"] == pytest.approx(2.4, rel=2e-3)
    assert found.push is not None
    assert found.push.direction == {"height": -1.0}
    assert found.push.phase == 0.0
    assert "The least push is 1." in found.told_push


@pytest.mark.weekly
@pytest.mark.slow
def test_the_least_push_over_a_range_is_that_of_the_weakest_corner() -> None:
    found = zo.search_gains(
        "hopper",
        vary={"a": (24.0, 25.0)},
        objective=zo.MaxPush(direction={"height": 1.0}, uncertain={"s": (0.08, 0.12)}),
    )
    assert found.worst_at == {"s": 0.08}
    speed = math.sqrt(2 * found.free["a"] * 0.08 / (1 - 0.5**2))
    assert found.worst == pytest.approx(0.5 * speed, rel=1.5e-3)
    assert found.free["a"] == pytest.approx(25.0, abs=0.02)


# Starts and refusals.


def test_a_search_starts_at_a_known_orbit_and_takes_its_values(tmp_path: Path) -> None:
    orbit = zo.find_orbit(COIL_HOPPER, gains={"U": 14.0}, parameters={"s": 0.12}).unwrap()
    path = tmp_path / "hopper.json"
    zo.write_orbit(orbit, path)
    same = zo.find_orbit(COIL_HOPPER, near=path).unwrap()
    assert same.period == pytest.approx(orbit.period, rel=1e-12)
    assert same.gains == {"U": 14.0}
    other = zo.find_orbit(COIL_HOPPER, near=path, gains={"U": 7.0}).unwrap()
    assert other.period == pytest.approx(CoilHop(voltage=7.0, s=0.12).period, rel=1e-11)
    near = _search(zo.NearestGains(target={}), near=path)
    assert near.free["U"] == 14.0
    assert near.orbit is not None
    assert near.orbit.parameters["s"] == 0.12


@pytest.mark.slow
def test_a_known_orbit_that_is_lost_on_the_way_is_named() -> None:
    known = event_orbit("hopper")
    # The push no longer carries the mass.
    found = zo.find_orbit("hopper", near=known, parameters={"a": 5.0})
    assert found.orbit is None
    assert "could be followed to a = 7.35" in found.detail


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"objective": zo.MinPeak(signal="hight")}, r"unknown name `hight`. Did you mean `height`"),
        ({"objective": zo.MinPeak(signal="period")}, "unknown name `period`. Known: height"),
        ({"objective": zo.TargetAmplitude(state="x", target=1.0)}, "names `x`"),
        ({"objective": zo.MaxPush(direction={"hight": 1.0})}, "`hight`. Did you mean `height`"),
        ({"objective": zo.MinEnergy(uncertain={"U": (7.0, 8.0)})}, "`U`"),
        ({"bounds": [zo.Bound(name="hight", upper=1.0)]}, "`hight`. Did you mean `height`"),
        ({"start": {"height": 0.1}, "near": True}, "`start` must be left out"),
        ({"section": "impact stop", "near": True}, "`section` must be left out"),
    ],
)
def test_invalid_searches_are_refused(options: dict[str, Any], words: str) -> None:
    if options.get("near"):
        options = options | {"near": zo.find_orbit(COIL_HOPPER).unwrap()}
    with pytest.raises(zo.InputError, match=words):
        _search(**{"objective": zo.MinEnergy(), **options})


def test_a_machine_without_a_source_has_no_energy_to_save() -> None:
    for options in (
        {"objective": zo.MinEnergy()},
        {"bounds": [zo.Bound(name="energy", upper=1.0)]},
    ):
        with pytest.raises(zo.InputError, match="lacks a source of energy"):
            zo.search_gains("hopper", vary={"a": (10.0, 30.0)}, **options)


def test_a_known_orbit_of_another_machine_or_format_is_refused() -> None:
    orbit = event_orbit("hopper")
    with pytest.raises(zo.InputError, match="must be an orbit of `coil_hopper`"):
        zo.find_orbit(COIL_HOPPER, near=orbit).unwrap()


@pytest.mark.slow
def test_worst_energies_of_one_stop_are_those_of_its_list_of_events() -> None:
    objective = zo.MinEnergy(uncertain={"c": (1.8, 2.0)})
    options = {"vary": {"A": (0.9, 1.1)}, "objective": objective}
    once = zo.SearchSettings(n_starts=0)
    found = zo.search_gains("forced_oscillator", settings=once, **options)
    other = zo.search_gains("forced_oscillator", **options)
    assert found.candidates[0].score == pytest.approx(other.worst, rel=1e-9)
    # The stiffest force does the most work.
    assert other.worst > other.value


@pytest.mark.slow
def test_the_default_section_of_a_sampled_machine_is_not_its_sample() -> None:
    # A motion cannot start at a sample, at which the switch is armed.
    found = zo.search_gains("sampled_pendulum", vary={}, objective=zo.MinEnergy(), until=25.0)
    assert found.orbit is not None
    assert found.value == pytest.approx(found.orbit.certificate["energies"]["input_work"], rel=1e-9)


@pytest.mark.weekly
@pytest.mark.slow
def test_a_search_does_not_go_on_from_another_orbit_where_its_own_is_lost() -> None:
    # At Kd = -0.725 motions settle to an orbit of seven times the period and four times the energy.
    found = zo.search_gains(
        "sampled_pendulum",
        gains={"Kp": 2.5},
        vary={"Kd": (-1.2, -0.1)},
        objective=zo.MinEnergy(),
        method=zo.SearchMethod.SHOOTING,
        allow_unstable=True,
        settings=zo.SearchSettings(n_starts=0),
    )
    beside = zo.find_orbit("sampled_pendulum", gains={"Kp": 2.5, "Kd": -0.983}).unwrap()
    assert beside.period == pytest.approx(1.872, rel=1e-9)
    assert found.value < beside.certificate["energies"]["input_work"]
    assert found.orbit is not None
    assert found.orbit.period == pytest.approx(1.872, rel=1e-9)
