"""The event loop in NumPy and SciPy against closed forms and published values."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.reference import kneed_walker
from tests.reference.event_loop import (
    Contact,
    Machine,
    Reset,
    Run,
    complementary,
    corner_impacts,
    parts,
    simulated,
)
from tests.reference.several_stops import (
    ClippedMotor,
    clipped_motor,
    hopper_speeds,
    impact_pair,
    two_sided,
)
from tests.support.cases import fast

G = 9.81
LOCATED = 1e-11
"""Of times and states: ten times the tolerance of the steps."""


def stop(name: str, sign: float, offset: float, restitution: float) -> Contact:
    """Return the stop ``offset + sign x`` of one coordinate."""
    return Contact(
        name=name,
        gap=lambda q: offset + sign * q[0],
        normal=lambda _q: np.array([sign]),
        restitution=restitution,
    )


def ball(restitution: float) -> Machine:
    return Machine(
        n=1,
        mass=lambda _q: np.eye(1),
        force=lambda *_: np.array([-G]),
        contacts=(stop("floor", 1.0, 0.0, restitution),),
    )


def zeno_time(run: Run) -> float:
    return next(event.time for event in run.events if event.kind == "zeno")


@pytest.mark.parametrize("e", fast(1, [0.0, 0.15, 0.5, 0.8, 0.9]))
def test_a_ball_has_its_zeno_time(e: float) -> None:
    exact = math.sqrt(2 / G) * (1 + e) / (1 - e)
    run = simulated(ball(e), (1.0, 0.0), exact + 0.1)
    assert zeno_time(run) == pytest.approx(exact, rel=LOCATED)
    assert run.events[-1].closed == ("floor",)


@pytest.mark.slow
def test_two_sided_oscillators_keep_their_symmetric_orbit() -> None:
    rng = np.random.default_rng(1)
    for _ in range(8):
        o = two_sided(rng)
        begin = 0.4 * o.half
        machine = Machine(
            n=1,
            mass=lambda _q: np.eye(1),
            force=lambda t, q, v, *_, o=o, begin=begin: np.array(
                [-q[0] - o.c * v[0] + o.amplitude * math.cos(o.omega * (t + begin) + o.phase)]
            ),
            contacts=(
                stop("upper", -1.0, o.stop, o.restitution),
                stop("lower", 1.0, o.stop, o.restitution),
            ),
        )
        run = simulated(machine, o.state(begin), 3.5 * o.half - begin)
        assert [event.name for event in run.events] == ["lower", "upper", "lower"]
        for k, event in enumerate(run.events):
            assert event.time + begin == pytest.approx((k + 1) * o.half, abs=LOCATED)
            assert -event.rate == pytest.approx(o.speed, abs=LOCATED)


@pytest.mark.slow
def test_impact_pairs_keep_their_orbit() -> None:
    rng = np.random.default_rng(2)
    for _ in range(8):
        o = impact_pair(rng)
        machine = Machine(
            n=1,
            mass=lambda _q: np.eye(1),
            force=lambda t, *_, o=o: np.array([o.amplitude * math.sin(t + o.phase + 0.5)]),
            contacts=(
                stop("lower", 1.0, 0.0, o.restitution),
                stop("upper", -1.0, o.length, o.restitution),
            ),
        )
        start = (
            o.amplitude * (math.sin(o.phase) - math.sin(o.phase + 0.5)) + 0.5 * o.speed,
            o.speed - o.amplitude * math.cos(o.phase + 0.5),
        )
        run = simulated(machine, start, 3.5 * math.pi - 0.5)
        assert [event.name for event in run.events] == ["upper", "lower", "upper"]
        for k, event in enumerate(run.events):
            assert event.time + 0.5 == pytest.approx((k + 1) * math.pi, abs=LOCATED)


@pytest.mark.slow
def test_a_hopper_has_its_speeds() -> None:
    thrust, rise, e = 25.0, 0.1, 0.6
    machine = Machine(
        n=1,
        mass=lambda _q: np.eye(1),
        force=lambda _t, _q, _v, _z, b: np.array([-G + (thrust if all(b) else 0.0)]),
        contacts=(stop("floor", 1.0, 0.0, e),),
        kinks=(lambda _t, _q, v, _z: v[0], lambda _t, q, _v, _z: rise - q[0]),
    )
    run = simulated(machine, (0.5, 0.0), 4.0)
    speeds = [-event.rate for event in run.events if event.kind == "impact"]
    assert speeds[0] == pytest.approx(math.sqrt(2 * G * 0.5), rel=LOCATED)
    exact = hopper_speeds(speeds[0], len(speeds) - 1, thrust=thrust, rise=rise, e=e)
    assert speeds[1:] == pytest.approx(exact, rel=LOCATED)


def motor(o: ClippedMotor) -> Machine:
    """Return the motor with a clipped voltage, on branches."""

    def voltage(t: float, q: np.ndarray, v: np.ndarray) -> float:
        return -o.p * q[0] - o.d * v[0] + o.A * math.cos(o.omega * t)

    def rate(
        t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray, b: tuple[bool, ...]
    ) -> np.ndarray:
        V = o.limit if not b[0] else -o.limit if not b[1] else voltage(t, q, v)
        return np.array([(V - o.R * z[0] - o.K * v[0]) / o.L])

    return Machine(
        n=1,
        mass=lambda _q: o.m * np.eye(1),
        force=lambda _t, q, v, z, _b: np.array([-o.k * q[0] - o.c * v[0] + o.K * z[0]]),
        rate=rate,
        contacts=(stop("stop", -1.0, o.stop, o.restitution),),
        kinks=(
            lambda t, q, v, _z: o.limit - voltage(t, q, v),
            lambda t, q, v, _z: o.limit + voltage(t, q, v),
        ),
    )


@pytest.mark.slow
def test_a_clipped_motor_follows_matrix_exponentials() -> None:
    rng = np.random.default_rng(3)
    for _ in range(3):
        o = clipped_motor(rng)
        exact = o.events(10.0)
        run = simulated(motor(o), (0.0, 0.0, 0.0), 10.0)
        seen = [event for event in run.events if event.kind != "zeno"][: len(exact)]
        assert len(exact) > 5
        assert [event.kind for event in seen] == [kind for kind, _, _ in exact]
        for event, (_, time, state) in zip(seen, exact, strict=True):
            assert event.time == pytest.approx(time, abs=LOCATED)
            assert event.before == pytest.approx(state[:3], abs=LOCATED)


def test_the_kneed_walker_has_its_published_step() -> None:
    run = simulated(kneed_walker.walker(0.0), kneed_walker.start(), 0.6, closed=("knee",))
    knee, rest, strike, freed = run.events
    published = 1e-9  # ten digits are printed
    assert knee.time == pytest.approx(kneed_walker.KNEE_TIME, abs=published)
    assert knee.rate == pytest.approx(kneed_walker.KNEE_RATE, abs=published)
    assert (rest.kind, rest.closed) == ("zeno", ("knee",))
    assert (strike.kind, strike.name) == ("switch", "heel strike")
    assert strike.time == pytest.approx(kneed_walker.PERIOD, abs=published)
    assert strike.after == pytest.approx(kneed_walker.start(), abs=published)
    assert (freed.kind, freed.time) == ("release", strike.time)


def pressed(coupling: float, push: tuple[float, float], e: float = 0.5) -> Machine:
    """Return two masses over a floor each, coupled by the mass matrix."""
    mass = np.array([[1.0, coupling], [coupling, 1.0]])
    return Machine(
        n=2,
        mass=lambda _q: mass,
        force=lambda *_: np.array(push),
        contacts=tuple(
            Contact(
                name=name,
                gap=lambda q, k=k: q[k],
                normal=lambda _q, k=k: np.eye(2)[k],
                restitution=e,
            )
            for k, name in enumerate(("left", "right"))
        ),
    )


def test_an_impact_presses_a_closed_stop_or_lifts_it() -> None:
    # With M = (1, c; c, 1), an impulse p on the left changes the rate of the right by -c p / (1 -
    # c^2). For c > 0 the right stop holds it. For c < 0 it opens at -c times the left's change.
    speed, e = 1.0, 0.5
    held = simulated(pressed(0.4, (-1.0, -1.0)), (0.1, 0.0, -speed, 0.0), 0.2, closed=("right",))
    assert [(x.kind, x.name) for x in held.events[:1]] == [("impact", "left")]
    assert held.events[0].closed == ("right",)
    c = -0.4
    lifted = simulated(pressed(c, (-1.0, -1.0)), (0.1, 0.0, -speed, 0.0), 0.2, closed=("right",))
    impact, opened = lifted.events[:2]
    assert (opened.kind, opened.name, opened.forced) == ("release", "right", True)
    change = (1 + e) * -impact.rate
    assert impact.after[2] == pytest.approx(-e * impact.rate, rel=LOCATED)
    assert impact.after[3] == pytest.approx(-c * change, rel=LOCATED)


@pytest.mark.slow
def test_impacts_on_two_coupled_stops_that_accumulate_are_refused() -> None:
    run = simulated(pressed(-0.4, (-1.0, -1.0)), (0.1, 0.0, 0.0, 0.0), 20.0, closed=("right",))
    assert run.refused is not None
    assert run.refused.reason == "SimultaneousEventsError"


def test_impacts_in_a_corner_part_if_the_angle_is_wide() -> None:
    # Elastic impacts in a wedge of angle a: the straight way through a fan of wedges meets at most
    # ceil(pi / a) walls, and J W J' has the cosine -cos(a).
    for angle in (2.5, 1.7, 1.0, 0.45, 0.1):
        c = math.cos(math.pi - angle)
        matrix = np.array([[1.0, c], [c, 1.0]])
        start = np.array([0.0, 1e-10]), np.array([1e-3, -1.0]), matrix
        found, last = corner_impacts(*start, np.array([1.0, 1.0]))
        assert math.ceil(math.pi / angle) - 1 <= len(found) <= math.ceil(math.pi / angle)
        assert np.all(last > 0.0)
        assert last @ np.linalg.solve(matrix, last) == pytest.approx(
            start[1] @ np.linalg.solve(matrix, start[1]), rel=1e-12
        )
    # Inelastic impacts in a narrow wedge come to rest in it.
    narrow = np.array([[1.0, -0.995], [-0.995, 1.0]])
    assert not parts(np.array([0.0, 1e-10]), np.array([0.1, -1.0]), narrow, np.array([0.3, 0.3]))


def test_complementarity_problems_are_solved() -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        n = int(rng.integers(1, 4))
        A = rng.normal(size=(n, n))
        matrix, free = A @ A.T + 0.1 * np.eye(n), rng.normal(size=n)
        f = complementary(matrix, free)
        left = free + matrix @ f
        assert np.all(f >= 0.0)
        assert np.all(left >= -1e-12)
        assert f @ left == pytest.approx(0.0, abs=1e-12)


def test_a_switch_exchanges_states_and_must_be_armed() -> None:
    def machine(armed: float) -> Machine:
        return Machine(
            n=2,
            mass=lambda _q: np.eye(2),
            force=lambda *_: np.zeros(2),
            resets=(
                Reset(
                    name="swap",
                    guard=lambda _t, q, _v, _z: 1.0 - q[0],
                    armed=lambda *_: armed,
                    after=lambda _t, q, v, z: (q[::-1].copy(), 0.5 * v[::-1], z),
                ),
            ),
        )

    run = simulated(machine(1.0), (0.0, 0.2, 2.0, 1.0), 0.6)
    assert [event.time for event in run.events] == pytest.approx([0.5], abs=LOCATED)
    assert run.events[0].after == pytest.approx([0.7, 1.0, 0.5, 1.0], abs=LOCATED)
    assert simulated(machine(-1.0), (0.0, 0.2, 2.0, 1.0), 0.6).events == []


def test_sliding_and_a_reset_into_a_stop_are_refused() -> None:
    friction = Machine(
        n=1,
        mass=lambda _q: np.eye(1),
        force=lambda _t, _q, _v, _z, b: np.array([-1.0 if b[0] else 1.0]),
        kinks=(lambda _t, _q, v, _z: v[0],),
    )
    run = simulated(friction, (0.0, 2.0), 5.0)
    assert run.refused is not None
    assert (run.refused.reason, run.refused.time) == ("SlidingError", pytest.approx(2.0))

    thrown = Machine(
        n=1,
        mass=lambda _q: np.eye(1),
        force=lambda *_: np.array([-G]),
        contacts=(stop("floor", 1.0, 0.0, 0.5),),
        resets=(
            Reset(
                name="drop",
                guard=lambda _t, q, _v, _z: q[0] - 0.5,
                armed=lambda *_: 1.0,
                after=lambda _t, q, v, z: (q - 1.0, v, z),
            ),
        ),
    )
    run = simulated(thrown, (1.0, 0.0), 5.0)
    assert run.refused is not None
    assert run.refused.reason == "PenetrationError"
    assert run.refused.time == pytest.approx(math.sqrt(1 / G))
