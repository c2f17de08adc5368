"""Machines with several stops, switches and kinks, simulated through the public functions.

Each reference is a closed form of `tests/reference/several_stops.py`, a published value, or an
execution of `tests/reference/event_loop.py`, which shares no code with the package.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad

import zeno_orbits as zo
from tests.reference import kneed_walker
from tests.reference.event_loop import Accuracy, simulated
from tests.reference.several_stops import (
    TwoSided,
    clipped_motor,
    hopper_speeds,
    impact_pair,
    two_sided,
)
from tests.support.cases import fast
from tests.support.mechanisms import machine_of, walled_oscillator
from zeno_orbits.continuation import SecondParameter, SpecialPointKind
from zeno_orbits.orbits import closed_return

G = 9.81
SETS = 20
LOCATED = 1e-10
"""Of times and states: a hundred times the tolerance of the integrator."""

LINE = {"x": "m", "dx": "m/s"}
FORCED = LINE | {"cosine": "1", "sine": "1"}


def events(execution: zo.Execution) -> list[tuple[str, str]]:
    """Return kind and name of every event, the name of a kink's switch left out."""
    words = {"Impact": "impact", "ZenoPoint": "zeno", "Release": "release", "SwitchEvent": "switch"}
    return [
        (words[type(e).__name__], "" if type(e).__name__ == "SwitchEvent" else e.stop)
        for e in execution.events
    ]


OSCILLATOR = machine_of(
    partial(walled_oscillator, upper=1, lower=-1),
    FORCED,
    {"c": 0.1, "omega": 1.0, "d": 1.0, "restitution": 0.5, "A": 1.0},
)


def oscillating(
    o: TwoSided, begin: float, until: float, moved: tuple[float, float] = (0.0, 0.0)
) -> zo.Execution:
    """Simulate a two-sided oscillator from a time of its orbit, or from a state beside it."""
    x, v = o.state(begin)
    angle = o.omega * begin + o.phase
    return zo.simulate(
        OSCILLATOR,
        until=until,
        parameters={
            "c": o.c,
            "omega": o.omega,
            "d": o.stop,
            "restitution": o.restitution,
            "A": o.amplitude,
        },
        start={
            "x": x + moved[0],
            "dx": v + moved[1],
            "cosine": math.cos(angle),
            "sine": math.sin(angle),
        },
    )


@pytest.mark.parametrize("seed", fast(8, range(SETS)))
def test_two_sided_oscillators_keep_their_symmetric_orbit(seed: int) -> None:
    o = two_sided(np.random.default_rng(seed))
    begin = 0.4 * o.half
    found = oscillating(o, begin, 3.5 * o.half - begin)
    assert [e.stop for e in found.events] == ["lower", "upper", "lower"]
    for k, impact in enumerate(found.impacts):
        assert impact.time + begin == pytest.approx((k + 1) * o.half, abs=LOCATED)
        assert impact.approach_rate == pytest.approx(-o.speed, abs=LOCATED)
        side = -1.0 if impact.stop == "lower" else 1.0
        assert impact.state_minus[:2] == pytest.approx([side * o.stop, side * o.speed], abs=LOCATED)
        assert impact.state_plus[1] == pytest.approx(-side * o.restitution * o.speed, abs=LOCATED)
    assert {arc.closed for arc in found.arcs} == {()}


@pytest.mark.parametrize("seed", range(3))
def test_deviations_of_two_sided_oscillators_grow_by_their_multipliers(seed: int) -> None:
    o, step = two_sided(np.random.default_rng(seed)), 1e-5
    begin = 0.4 * o.half

    def after_half(*moved: float) -> np.ndarray:
        found = oscillating(o, begin, o.half, (moved[0], moved[1]))
        return -np.array(found.end_state[:2])

    columns = [(after_half(*d) - after_half(*-d)) / (2 * step) for d in step * np.eye(2)]
    found = np.linalg.eigvals(np.column_stack(columns))
    # Central differences err by step^2 times the third derivative, and by rounding over the step.
    assert np.sort_complex(found) == pytest.approx(np.sort_complex(o.multipliers), abs=1e-6)


def shaken_box(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a free mass between the ends ``A sin t`` and ``A sin t + d``, seen from the lower."""
    q, v, clock = ca.SX.sym("q"), ca.SX.sym("v"), zo.Clock.at(ca.SX(1.0))
    mechanism = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=v**2 / 2,
        potential=ca.SX(0),
        applied_force=p["A"] * clock.sine,
        clock=clock,
        stops=(
            zo.Stop(name="lower", gap=q, restitution=p["restitution"]),
            zo.Stop(name="upper", gap=p["d"] - q, restitution=p["restitution"]),
        ),
    )
    return zo.hybrid_system(mechanism, zo.no_drive(mechanism))


BOX = machine_of(shaken_box, FORCED, {"A": 1.0, "restitution": 0.5, "d": 1.0})


@pytest.mark.parametrize("seed", range(3))
def test_a_return_to_an_impact_closes_from_another_phase_of_the_clock(seed: int) -> None:
    o = two_sided(np.random.default_rng(seed))
    parameters = {"c": o.c, "omega": o.omega, "d": o.stop, "restitution": o.restitution}
    graph = OSCILLATOR.graph_dynamics(
        OSCILLATOR.values(parameters={**parameters, "A": o.amplitude})
    )
    known = np.array([o.stop, -o.restitution * o.speed, math.cos(o.phase), math.sin(o.phase)])
    moved = o.phase + 0.05
    found = closed_return(
        graph,
        np.array([known[0], 1.05 * known[1], math.cos(moved), math.sin(moved)]),
        section="impact upper",
        n_returns=1,
        guess=2 * o.half,
        settings=zo.SimulationSettings(),
    )
    assert found.period == pytest.approx(2 * o.half, abs=LOCATED)
    assert found.start == pytest.approx(known, abs=LOCATED)


@pytest.mark.parametrize("seed", range(SETS))
def test_impact_pairs_keep_their_orbit(seed: int) -> None:
    o, begin = impact_pair(np.random.default_rng(seed)), 0.5
    ends = o.amplitude * math.sin(o.phase), o.amplitude * math.sin(o.phase + begin)
    found = zo.simulate(
        BOX,
        until=3.5 * math.pi - begin,
        parameters={"A": o.amplitude, "restitution": o.restitution, "d": o.length},
        start={
            "x": ends[0] + o.speed * begin - ends[1],
            "dx": o.speed - o.amplitude * math.cos(o.phase + begin),
            "cosine": math.cos(o.phase + begin),
            "sine": math.sin(o.phase + begin),
        },
    )
    assert [e.stop for e in found.events] == ["upper", "lower", "upper"]
    for k, impact in enumerate(found.impacts):
        assert impact.time + begin == pytest.approx((k + 1) * math.pi, abs=LOCATED)
        approach = o.speed + o.amplitude * math.cos(o.phase)
        assert impact.approach_rate == pytest.approx(-approach, abs=LOCATED)


@pytest.mark.slow
def test_folds_of_impact_pairs_lie_on_their_curve_in_two_parameters() -> None:
    # d = A (pi (1 + e) / (1 - e) cos p + 2 sin p) is largest at the fold.
    def fold(e: float) -> float:
        return math.hypot(math.pi * (1 + e) / (1 - e), 2.0)

    phase, ratio = 0.43, 3.0
    length = math.pi * ratio * math.cos(phase) + 2 * math.sin(phase)
    orbit = zo.find_orbit(
        BOX,
        parameters={"restitution": 0.5, "d": length},
        start={
            "x": 1e-9,
            "dx": (ratio - 1) * math.cos(phase),
            "cosine": math.cos(phase),
            "sine": math.sin(phase),
        },
        until=200.0,
        allow_unstable=True,
    ).unwrap()
    box = (length - 0.05, fold(0.5) + 0.05)
    second = SecondParameter(name="restitution", box=(0.48, 0.51), kinds=tuple(SpecialPointKind))
    found = zo.continue_orbit(orbit, ("d", *box), problem=BOX, parameter2=second)
    (special,) = found.families[0].special
    assert special.kind is SpecialPointKind.FOLD
    assert special.at.value == pytest.approx(fold(0.5), rel=1e-12)
    (curve,) = found.boundaries
    assert max(curve.y) - min(curve.y) > 0.01
    assert curve.x == pytest.approx([fold(e) for e in curve.y], rel=1e-11)


def hopper(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a body that a leg pushes with the acceleration `a` while it rises below `s`."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    rises_below = ca.logic_and(v > 0, q < p["s"])
    mechanism = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=v**2 / 2,
        potential=G * q,
        applied_force=ca.if_else(rises_below, p["a"], 0),
        gap=q,
    )
    return zo.hybrid_system(mechanism, zo.no_drive(mechanism), p["restitution"], switches=())


@pytest.mark.parametrize(("a", "s", "e"), [(25.0, 0.1, 0.6), (40.0, 0.03, 0.3), (15.0, 0.2, 0.8)])
def test_a_hopper_has_its_speeds(a: float, s: float, e: float) -> None:
    problem = machine_of(hopper, LINE, {"a": a, "s": s, "restitution": e})
    found = zo.simulate(problem, until=6.0, start={"x": 0.5})
    speeds = [-impact.approach_rate for impact in found.impacts]
    assert len(speeds) > 3
    assert speeds[0] == pytest.approx(math.sqrt(2 * G * 0.5), rel=1e-12)
    exact = hopper_speeds(speeds[0], len(speeds) - 1, thrust=a, rise=s, e=e)
    assert speeds[1:] == pytest.approx(exact, rel=1e-12)


def test_a_hopper_repeats_its_hop() -> None:
    a, s, e = 25.0, 0.1, 0.6
    speed = math.sqrt(2 * a * s / (1 - e**2))
    problem = machine_of(hopper, LINE, {"a": a, "s": s, "restitution": e})
    found = zo.simulate(problem, until=4.0, start={"x": speed**2 / (2 * G)})
    assert len(found.impacts) > 3
    for impact in found.impacts:
        assert -impact.approach_rate == pytest.approx(speed, rel=1e-12)


def walker(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return the kneed walker from its energies, and its heel strike from angular momenta."""
    q, v = ca.SX.sym("q", 3), ca.SX.sym("v", 3)

    def along(angle: ca.SX) -> ca.SX:
        return ca.vertcat(-ca.sin(angle), ca.cos(angle))

    stance, thigh, shank = (along(q[k]) for k in range(3))
    masses = (0.05, 0.5, 0.5, 0.5, 0.05)
    places = (
        0.375 * stance,
        0.675 * stance,
        stance,
        stance - 0.325 * thigh,
        stance - 0.5 * thigh - 0.125 * shank,
    )
    rates = [ca.jtimes(place, q, v) for place in places]
    foot = stance - 0.5 * thigh - 0.5 * shank

    def momentum(about: ca.SX, which: range, rates: list[ca.SX]) -> ca.SX:
        total = ca.SX(0)
        for k in which:
            arm = places[k] - about
            total += masses[k] * (arm[0] * rates[k][1] - arm[1] * rates[k][0])
        return total

    # After heel strike the foot of the swing leg rests: its rate is taken from every place.
    after = ca.SX.sym("after", 2)
    turned = ca.vertcat(after[0], after[1], after[1])
    foot_rate = ca.jtimes(foot, q, turned)
    rates_after = [ca.jtimes(place, q, turned) - foot_rate for place in places]
    equations = ca.vertcat(
        momentum(foot, range(5), rates_after) - momentum(foot, range(5), rates),
        momentum(stance, range(2), rates_after) - momentum(stance, range(2), rates),
    )
    matrix = ca.jacobian(equations, after)
    solved = ca.solve(matrix, -ca.substitute(equations, after, ca.SX.zeros(2)))
    mechanism = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=sum(m * ca.sumsqr(r) / 2 for m, r in zip(masses, rates, strict=True)),
        potential=sum(9.8 * m * r[1] for m, r in zip(masses, places, strict=True)),
        stops=(zo.Stop(name="knee", gap=q[1] - q[2], restitution=p["restitution"]),),
    )
    slope = math.asin(7.25 / 144)
    heel_strike = zo.Switch(
        name="heel strike",
        guard=q[0] + q[1] + 2 * slope,
        armed=q[1] + slope - 0.02,
        q_after=ca.vertcat(q[1], q[0], q[0]),
        v_after=ca.vertcat(solved[1], solved[0], solved[0]),
    )
    return zo.hybrid_system(mechanism, zo.no_drive(mechanism), switches=(heel_strike,))


LEGS = {
    "stance": "rad",
    "thigh": "rad",
    "shank": "rad",
    "dstance": "rad/s",
    "dthigh": "rad/s",
    "dshank": "rad/s",
}
WALKER = machine_of(walker, LEGS, {"restitution": 0.0})


def walking(e: float, until: float) -> zo.Execution:
    """Simulate the walker from the published state."""
    start = dict(zip(LEGS, kneed_walker.start(), strict=True))
    return zo.simulate(WALKER, until=until, parameters={"restitution": e}, start=start)


@pytest.mark.slow
def test_the_kneed_walker_takes_its_published_step() -> None:
    published = 1e-9  # ten digits are printed
    found = walking(0.0, 0.6)
    strike = next(e for e in found.events if type(e).__name__ == "SwitchEvent")
    assert strike.name == "heel strike"
    assert strike.time == pytest.approx(kneed_walker.PERIOD, abs=published)
    assert strike.state_plus == pytest.approx(kneed_walker.start(), abs=published)
    assert found.impacts[0].stop == "knee"
    assert found.impacts[0].time == pytest.approx(kneed_walker.KNEE_TIME, abs=published)
    assert found.impacts[0].approach_rate == pytest.approx(kneed_walker.KNEE_RATE, abs=published)
    assert ("knee",) in {arc.closed for arc in found.arcs}
    assert found.arcs[-1].closed == ()


@pytest.mark.slow
def test_the_kneed_walker_with_restitution_walks_as_in_the_reference() -> None:
    e, until = 0.2, 4.7 * kneed_walker.PERIOD
    found = walking(e, until)
    exact = simulated(kneed_walker.walker(e), kneed_walker.start(), until, closed=("knee",))
    strikes = [one for one in found.events if type(one).__name__ == "SwitchEvent"]
    expected = [one for one in exact.events if one.kind == "switch"]
    assert len(strikes) == len(expected) == 4
    for strike, reference in zip(strikes, expected, strict=True):
        assert strike.time == pytest.approx(reference.time, abs=1e-9)
        assert strike.state_plus == pytest.approx(reference.after, abs=1e-8)
    limits = [one for one in exact.events if one.kind == "zeno"]
    assert len(found.zeno_points) == len(limits)
    for point, reference in zip(found.zeno_points, limits, strict=True):
        assert (point.stop, reference.name) == ("knee", "knee")
        assert point.time == pytest.approx(reference.time, abs=1e-9)
        assert point.state == pytest.approx(reference.after, abs=1e-8)


MOTOR = ("m", "k", "c", "K", "L", "R", "p", "d", "A", "omega", "limit", "stop", "restitution")


def clipped(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a mass on a spring, moved by a motor with a clipped voltage."""
    q, v, i = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("i")
    clock = zo.Clock.at(p["omega"])
    mechanism = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=p["m"] * v**2 / 2,
        potential=p["k"] * q**2 / 2,
        passive_force=-p["c"] * v,
        clock=clock,
        stops=(zo.Stop(name="stop", gap=p["stop"] - q, restitution=p["restitution"]),),
    )
    voltage = p["A"] * clock.cosine - p["p"] * q - p["d"] * v
    circuit = zo.Circuit(
        currents=i,
        coenergy=p["L"] * i**2 / 2 + p["K"] * i * q,
        resistance=p["R"],
        source=ca.fmax(-p["limit"], ca.fmin(p["limit"], voltage)),
    )
    return zo.hybrid_system(mechanism, zo.circuit_drive(mechanism, circuit))


CLIPPED = machine_of(
    clipped, LINE | {"i": "A", "cosine": "1", "sine": "1"}, dict.fromkeys(MOTOR, 0.5)
)


@pytest.mark.parametrize("seed", range(8))
def test_a_clipped_motor_follows_matrix_exponentials(seed: int) -> None:
    o = clipped_motor(np.random.default_rng(seed))
    exact = o.events(10.0)
    found = zo.simulate(
        CLIPPED,
        until=10.0,
        parameters={name: getattr(o, name) for name in MOTOR},
        start={"cosine": 1.0},
    )
    seen = [e for e in found.events if type(e).__name__ in ("Impact", "SwitchEvent")][: len(exact)]
    kinds = {"Impact": "impact", "SwitchEvent": "switch"}
    assert len(exact) > 3
    assert [kinds[type(e).__name__] for e in seen] == [kind for kind, _, _ in exact]
    for event, (_, time, state) in zip(seen, exact, strict=True):
        assert event.time == pytest.approx(time, abs=LOCATED)
        assert event.state_minus[:3] == pytest.approx(state[:3], abs=LOCATED)


RELAY = {
    "m": 1.6e-3,
    "ks": 55.0,
    "zs": 0.0159,
    "b": 0.05,
    "S0": 6e6,
    "S1": 2.2e10,
    "phis": 3.6e-5,
    "N": 1200.0,
    "R": 50.0,
    "U": 24.0,
    "d": 9e-4,
    "restitution": 0.3,
    "T": 0.04,
}
RELAY_EVENTS = (
    ("release", "open", 0.54922195966e-3, None),
    ("impact", "closed", 2.09300141683e-3, 1.79987359610),
    ("zeno", "closed", 2.56120736805e-3, None),
    ("switch", "", 0.02, None),
    ("release", "closed", 24.2984216485e-3, None),
    ("impact", "open", 27.3932730156e-3, 0.81032276748),
    ("zeno", "open", 28.7985429859e-3, None),
)
"""Published events of a period: first impacts of both sequences, with their speeds [m/s]."""
RELAY_FLUX = 3.3760203e-11
"""Published flux at the start of a period [Wb]."""


def relay(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a relay whose armature bounces at both stops, with a square voltage."""
    z, w, flux = ca.SX.sym("z"), ca.SX.sym("w"), ca.SX.sym("flux")
    clock = zo.Clock.at(2 * math.pi / p["T"])
    mechanism = zo.HybridLagrangian.from_energies(
        q=z,
        v=w,
        kinetic=p["m"] * w**2 / 2,
        potential=p["ks"] * (p["zs"] - z) ** 2 / 2,
        passive_force=-p["b"] * w,
        clock=clock,
        stops=(
            zo.Stop(name="closed", gap=z, restitution=p["restitution"]),
            zo.Stop(name="open", gap=p["d"] - z, restitution=p["restitution"]),
        ),
    )
    reluctance = p["S0"] / (1 - (flux / p["phis"]) ** 2) + p["S1"] * z
    current = flux * reluctance / p["N"]
    voltage = ca.if_else(clock.sine > 0, p["U"], 0)
    coil = zo.Auxiliary(
        states=flux,
        rate=(voltage - p["R"] * current) / p["N"],
        force=-p["S1"] * flux**2 / 2,
    )
    return zo.hybrid_system(mechanism, coil)


def test_a_relay_bounces_at_both_stops_as_published() -> None:
    states = {"z": "m", "w": "m/s", "flux": "Wb", "cosine": "1", "sine": "1"}
    problem = machine_of(relay, states, RELAY)
    start = {"z": RELAY["d"], "flux": RELAY_FLUX, "cosine": 1.0, "sine": 0.0}
    found = zo.simulate(problem, until=0.0399, start=start)
    seen: list[tuple[str, str, float, float | None]] = []
    for event, (kind, name) in zip(found.events, events(found), strict=True):
        if kind == "impact" and seen and seen[-1][:2] == (kind, name):
            continue
        speed = -event.approach_rate if kind == "impact" else None
        seen.append((kind, name, event.time, speed))
    assert [one[:2] for one in seen] == [one[:2] for one in RELAY_EVENTS]
    # Eleven digits of the times are published, eight of the first flux.
    for one, published in zip(seen, RELAY_EVENTS, strict=True):
        assert one[2] == pytest.approx(published[2], abs=2e-12, rel=1e-10)
        assert one[3] == (None if published[3] is None else pytest.approx(published[3], rel=1e-9))


@pytest.mark.slow
def test_the_flux_of_a_relay_is_followed_in_its_own_size() -> None:
    # Its size is seen in the branch of the voltage alone, which four phases of the clock show.
    p = zo.load_problem("relay").values().parameters
    release = math.sqrt(2 * p["ks"] * (p["zs"] - p["d"]) / p["S1"])

    def rate(flux: float) -> float:
        reluctance = p["S0"] / (1 - (flux / p["phi_s"]) ** 2) + p["S1"] * p["d"]
        return (p["U"] - p["R"] * flux * reluctance / p["N"]) / p["N"]

    wanted = quad(lambda flux: 1 / rate(flux), 0.0, release, epsabs=0.0, epsrel=2e-14)[0]
    start = {"z": p["d"], "cosine": 1.0}
    run = zo.simulate("relay", until=6e-4, start=start)
    assert run.releases[0].time == pytest.approx(wanted, rel=1e-13)


def braked(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a mass that dry friction brakes, far from its stop."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    mechanism = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=v**2 / 2,
        potential=ca.SX(0),
        passive_force=-p["f"] * ca.sign(v),
        gap=q + 10,
    )
    return zo.hybrid_system(mechanism, zo.no_drive(mechanism), p["restitution"], switches=())


def test_sliding_is_refused() -> None:
    problem = machine_of(braked, LINE, {"f": 1.5, "restitution": 0.5})
    with pytest.raises(zo.SlidingError) as caught:
        zo.simulate(problem, until=5.0, start={"dx": 3.0})
    assert caught.value.time == pytest.approx(3.0 / 1.5, abs=LOCATED)
    assert isinstance(caught.value, zo.SimulationError)


def two_floors(coupling: float) -> zo.Problem:
    """Return two masses over a floor each, with the mass matrix ``(1, c; c, 1)``."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2 + coupling * v[0] * v[1],
            potential=ca.sum1(q),
            stops=(
                zo.Stop(name="left", gap=q[0], restitution=p["restitution"]),
                zo.Stop(name="right", gap=q[1], restitution=p["restitution"]),
            ),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    states = {"left": "m", "right": "m", "dleft": "m/s", "dright": "m/s"}
    return machine_of(model, states, {"restitution": 0.5})


def test_impacts_on_two_coupled_stops_at_the_same_time_are_refused() -> None:
    # Both masses fall with the acceleration -1 / (1 + c).
    with pytest.raises(zo.SimultaneousEventsError) as caught:
        zo.simulate(two_floors(0.2), until=5.0, start={"left": 0.5, "right": 0.5})
    assert caught.value.time == pytest.approx(math.sqrt(1.2), abs=LOCATED)


def test_impacts_on_two_uncoupled_stops_at_different_times_are_not_refused() -> None:
    # From the height h a ball of restitution 1/2 rests after sqrt(2 h) (1 + e) / (1 - e).
    found = zo.simulate(two_floors(0.0), until=6.0, start={"left": 0.5, "right": 0.9})
    rests = {point.stop: point.time for point in found.zeno_points}
    assert rests["left"] == pytest.approx(3.0, abs=LOCATED)
    assert rests["right"] == pytest.approx(3.0 * math.sqrt(1.8), abs=LOCATED)
    assert set(found.arcs[-1].closed) == {"left", "right"}


def test_impacts_that_lift_a_closed_stop_and_accumulate_with_it_are_refused() -> None:
    with pytest.raises(zo.SimultaneousEventsError):
        zo.simulate(two_floors(-0.4), until=20.0, start={"left": 0.1})


def test_an_impact_presses_a_closed_stop_that_it_does_not_lift() -> None:
    # While the right stop is closed, the left mass falls alone: its force is -1, its mass is 1.
    found = zo.simulate(two_floors(0.4), until=3.0, start={"left": 0.1})
    rests = {point.stop: point.time for point in found.zeno_points}
    assert rests["left"] == pytest.approx(3.0 * math.sqrt(0.2), abs=LOCATED)
    assert {event.stop for event in found.events} == {"left"}
    assert found.arcs[0].closed == ("right",)
    assert set(found.arcs[-1].closed) == {"left", "right"}


def dropped(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a ball that a switch puts below its floor."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    mechanism = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=v**2 / 2,
        potential=G * q,
        stops=(zo.Stop(name="floor", gap=q, restitution=p["restitution"]),),
    )
    drop = zo.Switch(name="drop", guard=q - 0.5, armed=ca.SX(1), q_after=q - 1.0)
    return zo.hybrid_system(mechanism, zo.no_drive(mechanism), switches=(drop,))


def test_a_reset_into_a_stop_is_refused() -> None:
    with pytest.raises(zo.SimulationError) as caught:
        zo.simulate(machine_of(dropped, LINE, {"restitution": 0.5}), until=5.0, start={"x": 1.0})
    assert type(caught.value).__name__ == "PenetrationError"
    assert caught.value.time == pytest.approx(math.sqrt(1 / G), abs=LOCATED)


def drag_ball(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a ball with the drag ``-b v |v|``."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    mechanism = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=v**2 / 2,
        potential=G * q,
        passive_force=-p["b"] * v * ca.fabs(v),
        gap=q,
    )
    return zo.hybrid_system(mechanism, zo.no_drive(mechanism), p["restitution"], switches=())


def drag_ball_times(height: float, b: float, e: float) -> tuple[list[float], float]:
    """Return the impact times of a ball with quadratic drag, and their limit.

    With the terminal speed ``u = sqrt(g / b)``, a fall from `h` takes
    ``u / g acosh(exp(b h))`` and ends at ``u sqrt(1 - exp(-2 b h))``. A rise from the speed `w`
    takes ``u / g atan(w / u)`` and ends at ``log(1 + w^2 / u^2) / (2 b)``.
    """
    u, t, times = math.sqrt(G / b), 0.0, []
    while True:
        t += (
            u / G * math.acosh(math.exp(b * height)) if height > 1e-9 else math.sqrt(2 * height / G)
        )
        speed = e * u * math.sqrt(-math.expm1(-2 * b * height))
        times.append(t)
        if speed < 1e-9:
            return times, t + 2 * speed / (G * (1 - e))
        t += u / G * math.atan(speed / u)
        height = math.log1p((speed / u) ** 2) / (2 * b)


def test_a_ball_with_quadratic_drag_comes_to_rest_through_a_kink_in_every_flight() -> None:
    b, e = 0.3, 0.5
    times, limit = drag_ball_times(1.0, b, e)
    problem = machine_of(drag_ball, LINE, {"b": b, "restitution": e})
    found = zo.simulate(problem, until=limit + 0.3, start={"x": 1.0})
    seen = [impact.time for impact in found.impacts]
    assert len(seen) > 4
    assert seen == pytest.approx(times[: len(seen)], abs=LOCATED)
    assert [point.time for point in found.zeno_points] == pytest.approx([limit], abs=LOCATED)
    assert found.end_state == pytest.approx([0.0, 0.0], abs=LOCATED)


@pytest.mark.slow
def test_the_reference_of_the_walker_does_not_depend_on_its_tolerance() -> None:
    e, until = 0.2, 4.7 * kneed_walker.PERIOD
    runs = [
        simulated(kneed_walker.walker(e), kneed_walker.start(), until, closed=("knee",), accuracy=a)
        for a in (Accuracy(), Accuracy(tolerance=1e-10, slow=1e-2))
    ]
    for one, other in zip(
        *([e for e in r.events if e.kind != "impact"] for r in runs), strict=True
    ):
        assert one.time == pytest.approx(other.time, abs=1e-9)
        assert one.after == pytest.approx(other.after, abs=1e-8)
