"""Floquet multipliers of orbits of events: closed forms, and differences of an own event loop."""

from __future__ import annotations

import cmath
import io
import math
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import null_space

import zeno_orbits as zo
from tests.reference.event_loop import Contact, Machine, simulated
from tests.support.cases import fast
from zeno_orbits.maps import attractors_at
from zeno_orbits.report.terminal import print_certificate

# Stops that are closed during the whole period.


@dataclass(frozen=True, kw_only=True)
class Pressed:
    """A forced oscillator, and masses that constant forces press on stops.

    Attributes:
        slopes: Slope of each stop along the oscillator. The masses slide up and down on them.
        damping: Damping of the oscillator [N s/m].
        decay: Rate of a further state that the speed drives [1/s], or 0 without one.
        striker: Restitution of a further stop that the oscillator strikes, or ``None``.
    """

    slopes: tuple[float, ...]
    damping: float = 0.3
    decay: float = 0.0
    striker: float | None = None

    @property
    def mass(self) -> float:
        """Mass of the oscillator with the masses that it moves."""
        return 1.0 + sum(slope**2 for slope in self.slopes)

    @property
    def multipliers(self) -> list[complex]:
        """The multipliers of the oscillator, ``exp(lambda T)``, the largest first."""
        b = self.damping / (2 * self.mass)
        root = cmath.sqrt(b**2 - 2.0 / self.mass)
        decays = [-self.decay] if self.decay else []
        turn = 2 * math.pi / OMEGA
        values = [cmath.exp(rate * turn) for rate in (-b + root, -b - root, *decays)]
        return sorted(values, key=lambda value: (-abs(value), -value.imag))

    @property
    def problem(self) -> zo.Problem:
        """The machine. The force on the masses has a kink in time."""
        n = 1 + len(self.slopes)

        def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
            q, v, z = ca.SX.sym("q", n), ca.SX.sym("v", n), ca.SX.sym("z")
            clock = zo.Clock.at(ca.SX(OMEGA))
            stops = [
                zo.Stop(name=f"s{k}", gap=q[k] - slope * q[0], restitution=0.3)
                for k, slope in enumerate(self.slopes, start=1)
            ]
            rest = p["press"] * sum(self.slopes) / 2
            if self.striker is not None:
                stops.append(zo.Stop(name="wall", gap=0.2 - q[0] - rest, restitution=self.striker))
            mechanism = zo.HybridLagrangian.from_energies(
                q=q,
                v=v,
                kinetic=ca.sumsqr(v) / 2,
                potential=q[0] ** 2 + p["press"] * ca.sum1(q[1:]),
                passive_force=ca.vertcat(-self.damping * v[0], *([0] * (n - 1))),
                applied_force=ca.vertcat(clock.cosine, *([ca.fabs(clock.cosine)] * (n - 1))),
                clock=clock,
                stops=tuple(stops),
            )
            drive = zo.no_drive(mechanism)
            if self.decay:
                drive = zo.Auxiliary(states=z, rate=v[0] - self.decay * z)
            return zo.hybrid_system(mechanism, drive)

        names = [f"q{k}" for k in range(n)] + [f"v{k}" for k in range(n)]
        further = ["z"] if self.decay else []
        return zo.Problem(
            name="pressed",
            title="oscillator with masses on stops",
            source="tests",
            state_names=(*names, *further, "cosine", "sine"),
            state_units=(*["m"] * n, *["m/s"] * n, *["1" for _ in further], "1", "1"),
            parameters=(zo.Quantity.positive("press", 20.0, "N", "force on the stops"),),
            gains=(),
            model=model,
            starts=(self.start,),
            portraits=(("q0", "v0"),),
            amplitude_of="q0",
        )

    @property
    def start(self) -> dict[str, float]:
        """The masses on their stops, in equilibrium."""
        q0 = -20.0 * sum(self.slopes) / 2
        places = {f"q{k}": slope * q0 for k, slope in enumerate(self.slopes, start=1)}
        return {"q0": q0, **places, "cosine": 1.0}


OMEGA = 1.3

ALWAYS_CLOSED = [
    Pressed(slopes=(0.7,)),
    Pressed(slopes=(0.5, -1.2)),
    Pressed(slopes=(0.4,), decay=0.2),
    Pressed(slopes=(0.0, 0.0)),
    Pressed(slopes=(0.4,), damping=4.0),
    Pressed(slopes=(0.3, 0.2, -0.6), decay=0.9),
]


@pytest.mark.slow
@pytest.mark.parametrize("machine", fast(1, ALWAYS_CLOSED))
def test_a_stop_that_is_closed_all_the_time_adds_no_multiplier(machine: Pressed) -> None:
    orbit = zo.find_orbit(machine.problem, until=200.0).unwrap()
    certificate = zo.verify(orbit, problem=machine.problem)
    assert certificate.passed
    assert certificate.stable
    assert certificate.multipliers == pytest.approx(machine.multipliers, abs=1e-9)
    assert certificate.multiplier_error < 1e-8
    found = zo.floquet_multipliers(orbit, problem=machine.problem)
    assert found.values == pytest.approx(certificate.multipliers, abs=1e-13)
    assert found.error == pytest.approx(certificate.multiplier_error, rel=0.5, abs=1e-12)


@pytest.mark.slow
def test_every_answer_has_the_multipliers_of_admissible_disturbances() -> None:
    machine = Pressed(slopes=(0.7, 0.2))
    problem, largest = machine.problem, abs(machine.multipliers[0])
    orbit = zo.find_orbit(problem, until=200.0).unwrap()
    exact = pytest.approx(largest, abs=1e-8)
    assert abs(orbit.floquet_multipliers[0]) == exact
    (reached,) = attractors_at(problem, [problem.values()], until=200.0)
    assert reached.spectral_radius == exact
    settings = zo.RecoverySettings(samples=1, error=0.5)
    assert zo.recovery(orbit, problem=problem, settings=settings).spectral_radius == exact
    few = zo.PushSettings(phases=1, steps=1, reach=1e-3)
    pushes = zo.largest_push(orbit, problem=problem, directions=[{"q0": 1.0}], settings=few)
    assert pushes.spectral_radius == exact
    family = zo.continue_orbit(orbit, ("press", 20.0, 20.2), problem=problem).families[0]
    assert family.points[-1].spectral_radius == exact


@pytest.mark.slow
def test_an_orbit_moves_with_a_stop_that_is_closed_all_the_time() -> None:
    # The masses rest on the stops, which the parameter lifts.
    machine = Pressed(slopes=(0.5,))

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        clock = zo.Clock.at(ca.SX(OMEGA))
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=q[0] ** 2 + 20 * q[1],
            passive_force=ca.vertcat(-0.3 * v[0], 0),
            applied_force=ca.vertcat(clock.cosine, ca.fabs(clock.cosine)),
            clock=clock,
            stops=(zo.Stop(name="s1", gap=q[1] - 0.5 * q[0] - p["lift"], restitution=0.3),),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    lift = zo.Quantity(name="lift", unit="m", meaning="height", default=0.0, lower=-1, upper=1)
    problem = replace(machine.problem, model=model, parameters=(lift,))
    orbit = zo.find_orbit(problem, until=200.0).unwrap()
    family = zo.continue_orbit(orbit, ("lift", 0.0, 0.4), problem=problem).families[0]
    first, last = family.points[0], family.points[-1]
    assert last.value == pytest.approx(0.4)
    before, after = (np.array(list(one.state.values())) for one in (first, last))
    assert after - before == pytest.approx([0, 0.4, 0, 0, 0, 0], abs=1e-9)


def _sections(orbit: zo.Orbit) -> list[str]:
    """Return the events that may be sections. Impacts that accumulate are not."""
    names = set(orbit.sequence)
    return sorted(one for one in names if one.replace("impact", "zeno") not in names - {one})


@pytest.mark.slow
@pytest.mark.parametrize("restitution", [0.0, 0.4])
def test_the_section_after_any_event_has_the_same_multipliers(restitution: float) -> None:
    machine = Pressed(slopes=(0.7,), striker=restitution)
    names = _sections(zo.find_orbit(machine.problem, until=300.0).unwrap())
    assert len(names) > 1
    found = [
        zo.find_orbit(machine.problem, until=300.0, section=name).unwrap().floquet_multipliers
        for name in names
    ]
    assert all(one == pytest.approx(found[0], abs=1e-8) for one in found)


# Differences of an own event loop.


@dataclass(frozen=True, kw_only=True)
class Linear:
    """A linear oscillator between plane stops, with a force of a clock.

    Attributes:
        mass: Mass matrix, ``(n, n)``.
        stiffness: Stiffness of each coordinate.
        damping: Damping of each coordinate.
        normals: Normal of each stop, ``(m, n)``.
        gaps: Gap of each stop at the origin.
        restitutions: Restitution of each stop.
        constant: Constant force.
        force: Amplitude of the force of the clock.
        omega: Its frequency.
    """

    mass: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    normals: np.ndarray
    gaps: np.ndarray
    restitutions: np.ndarray
    constant: np.ndarray
    force: np.ndarray
    omega: float

    @classmethod
    def drawn(cls, seed: int) -> Linear:
        """Return a random machine of two or three coordinates."""
        rng = np.random.default_rng(seed)
        n = int(rng.integers(2, 4))
        m = int(rng.integers(2, n + 2))
        skew = rng.normal(size=(n, n))
        mass = np.eye(n) + 0.25 * (skew + skew.T) / 2
        if np.linalg.eigvalsh(mass).min() < 0.3:
            mass = np.eye(n)
        stiffness, damping = rng.uniform(0.5, 3.0, n), rng.uniform(0.1, 0.6, n)
        normals = rng.normal(size=(m, n))
        return cls(
            mass=mass,
            stiffness=stiffness,
            damping=damping,
            normals=normals / np.linalg.norm(normals, axis=1)[:, None],
            gaps=rng.uniform(0.0, 0.8, m),
            restitutions=rng.choice([0, 0, 0.3, 0.6, 0.8], m),
            constant=rng.normal(size=n) * 1.5,
            force=rng.normal(size=n) * 3.0,
            omega=float(rng.uniform(0.8, 2.5)),
        )

    @property
    def problem(self) -> zo.Problem:
        """The machine as a problem."""
        n = len(self.mass)

        def model(_: Mapping[str, ca.SX]) -> zo.CompletedSystem:
            q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
            clock = zo.Clock.at(ca.SX(self.omega))
            planes = zip(self.gaps, self.normals, self.restitutions, strict=True)
            mechanism = zo.HybridLagrangian.from_energies(
                q=q,
                v=v,
                kinetic=ca.dot(v, ca.DM(self.mass) @ v) / 2,
                potential=ca.dot(q**2, ca.DM(self.stiffness)) / 2 - ca.dot(ca.DM(self.constant), q),
                passive_force=-ca.DM(self.damping) * v,
                applied_force=ca.DM(self.force) * clock.cosine,
                clock=clock,
                stops=tuple(
                    zo.Stop(
                        name=f"s{k}",
                        gap=float(gap) + ca.dot(ca.DM(normal), q),
                        restitution=float(e),
                    )
                    for k, (gap, normal, e) in enumerate(planes)
                ),
            )
            return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

        names = [f"q{k}" for k in range(n)] + [f"v{k}" for k in range(n)]
        return zo.Problem(
            name="linear",
            title="oscillator between plane stops",
            source="tests",
            state_names=(*names, "cosine", "sine"),
            state_units=(*["m"] * n, *["m/s"] * n, "1", "1"),
            parameters=(),
            gains=(),
            model=model,
            starts=({"cosine": 1.0},),
            portraits=(("q0", "v0"),),
            amplitude_of="q0",
        )

    def machine(self, since: float) -> Machine:
        """Return the machine for the event loop, from a time of the clock on."""

        def contact(k: int) -> Contact:
            return Contact(
                name=f"s{k}",
                gap=lambda q: float(self.gaps[k] + self.normals[k] @ q),
                normal=lambda _: self.normals[k],
                restitution=float(self.restitutions[k]),
            )

        def force(t: float, q: np.ndarray, v: np.ndarray, *_: object) -> np.ndarray:
            push = self.constant + self.force * math.cos(self.omega * (t + since))
            return push - self.stiffness * q - self.damping * v

        contacts = tuple(contact(k) for k in range(len(self.gaps)))
        return Machine(n=len(self.mass), mass=lambda _: self.mass, force=force, contacts=contacts)

    def differences(self, orbit: zo.Orbit) -> list[complex]:
        """Return the multipliers by central differences, from the middle of the longest arc."""
        n = len(self.mass)
        run = zo.simulate(self.problem, until=orbit.period, start=orbit.start_state)
        arc = max(run.arcs, key=lambda one: one.end_time - one.start_time)
        x = np.array(run.state_at((arc.start_time + arc.end_time) / 2))
        machine = self.machine(math.atan2(x[-1], x[-2]) / self.omega)
        held = self.normals[[int(name[1:]) for name in arc.closed]]
        along = null_space(held) if len(held) else np.eye(n)
        basis = np.kron(np.eye(2), along)

        def returned(y: np.ndarray) -> np.ndarray:
            found = simulated(machine, y.tolist(), orbit.period, closed=arc.closed)
            assert found.refused is None
            assert found.unsure is None
            return found.end_state

        assert returned(x[: 2 * n]) == pytest.approx(x[: 2 * n], abs=1e-10)
        columns = [
            (returned(x[: 2 * n] + STEP * one) - returned(x[: 2 * n] - STEP * one)) / (2 * STEP)
            for one in basis.T
        ]
        values = np.linalg.eigvals(basis.T @ np.array(columns).T)
        return sorted(map(complex, values), key=abs, reverse=True)


STEP = 1e-6


@cache
def _linear(seed: int) -> tuple[Linear, zo.Orbit]:
    machine = Linear.drawn(seed)
    return machine, zo.find_orbit(machine.problem, until=300.0).unwrap()


def _require_equal(found: Sequence[complex], exact: Sequence[complex], error: float) -> None:
    """Require equal multipliers. Those that the longer list has in addition are zero."""
    most = max(len(found), len(exact))
    one, other = ([*values, *[0j] * (most - len(values))] for values in (found, exact))
    assert max(min(abs(a - b) for b in other) for a in one) < error
    assert max(min(abs(a - b) for a in one) for b in other) < error


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed",
    [
        # Impacts of one stop after one of another.
        6,
        # A stop that a plastic impact opens. A stop that a force opens just after an impact.
        *(
            pytest.param(seed, marks=pytest.mark.slow)
            for seed in (76, 4, 8, 10, 15, 21, 22, 33, 38, 50)
        ),
    ],
)
def test_the_multipliers_are_those_of_an_own_event_loop(seed: int) -> None:
    machine, orbit = _linear(seed)
    certificate = zo.verify(orbit, problem=machine.problem)
    assert certificate.passed
    # The second difference of the flow and the error of the loop, 1e-12 / STEP.
    _require_equal(certificate.multipliers, machine.differences(orbit), 1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [6, 21, 38])
def test_an_orbit_has_the_same_multipliers_from_each_of_its_events(seed: int) -> None:
    machine, orbit = _linear(seed)
    names = _sections(orbit)
    assert len(names) > 1
    for name in names:
        other = zo.find_orbit(machine.problem, until=300.0, section=name).unwrap()
        assert other.floquet_multipliers == pytest.approx(orbit.floquet_multipliers, abs=1e-8)


# Multipliers below rounding.


def _door(inductance: float, *, one_stop: bool) -> zo.Problem:
    """Return a door that a motor closes once per turn of a clock, and a spring opens."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        clock = zo.Clock.at(ca.SX(0.7))
        latch = zo.Stop(name="latch", gap=q, restitution=p["restitution"])
        door = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=(q - 1) ** 2 / 2,
            passive_force=-0.5 * v,
            clock=clock,
            gap=q if one_stop else None,
            stops=() if one_stop else (latch,),
        )
        motor = zo.MotorBank(
            selection=ca.SX(1.0),
            resistance=ca.SX(2.0),
            inductance=ca.SX(inductance),
            torque_constant=ca.SX(0.5),
            emf_constant=ca.SX(0.5),
            voltage=-12 * clock.cosine,
        )
        restitution = p["restitution"] if one_stop else None
        return zo.hybrid_system(door, zo.full_drive(door, motor), restitution)

    return zo.Problem(
        name="door",
        title="door with a motor",
        source="tests",
        state_names=("q", "v", "i", "cosine", "sine"),
        state_units=("rad", "rad/s", "A", "1", "1"),
        parameters=(zo.Quantity.restitution(0.3),),
        gains=(),
        model=model,
        starts=({"q": 1.0, "cosine": 1.0},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )


@pytest.mark.parametrize("inductance", fast(1, [5e-3, 0.5, 2e-2, 3.0]))
def test_both_forms_of_a_machine_have_the_multipliers_of_its_section(inductance: float) -> None:
    plain, named = (_door(inductance, one_stop=one_stop) for one_stop in (True, False))
    found = zo.find_orbit(plain).orbit
    assert found is not None
    one = zo.verify(found, problem=plain)
    other = zo.verify(zo.find_orbit(named).unwrap(), problem=named)
    # A release fixes gap, gap rate and contact force: one of the four directions is left.
    (first,), (second,) = one.multipliers, other.multipliers
    assert first == pytest.approx(second, abs=1e-8)
    # The current decays as exp(-R t / L), at most 1e-70 in a closed phase of 4 s.
    if inductance <= 0.05:
        assert first == second == 0.0
        assert 1e-9 <= max(one.multiplier_error, other.multiplier_error) < 1e-6
    printed = "Floquet multipliers: 0 (below rounding) (+- "
    for certificate in (one, other):
        with io.StringIO() as text, redirect_stdout(text):
            print_certificate(certificate)
            assert (printed in text.getvalue()) == (first == 0.0)
