"""Forced problems: a clock in the state, and the closed forms of the oscillator with a stop."""

from __future__ import annotations

import math
from itertools import islice
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from tests.reference.closed_forms import COCO, FORCED
from zeno_orbits import Clock, HybridLagrangian, MotorBank, corrected_drive, write_orbit
from zeno_orbits.cli import main
from zeno_orbits.errors import InputError
from zeno_orbits.model import load_problem
from zeno_orbits.orbits import RELEASE_ROWS, Orbit, section_around
from zeno_orbits.search import orbit_at_gains
from zeno_orbits.simulation import simulate
from zeno_orbits.verification import verify

OSCILLATOR = load_problem("forced_oscillator")
PUBLISHED_ZENO_TIME = 5.06454057578434876
PERIOD = 2 * math.pi


@pytest.fixture(name="orbit", scope="module")
def _orbit() -> Orbit:
    return orbit_at_gains(OSCILLATOR, OSCILLATOR.values()).unwrap()


def test_the_search_finds_the_orbit_of_the_closed_form(orbit: Orbit) -> None:
    # The search asks for agreement of program and simulation to 3e-10; both do far better here.
    release = FORCED.release_time
    assert orbit.period == pytest.approx(PERIOD, rel=1e-12)
    assert orbit.zeno_time + release == pytest.approx(PUBLISHED_ZENO_TIME, abs=1e-12)
    for impact, (time, approach) in zip(orbit.impacts, islice(FORCED.impacts(), 6), strict=False):
        assert impact.time + release == pytest.approx(time, abs=1e-12)
        assert impact.state_minus["speed"] == pytest.approx(-approach, abs=1e-12)
    assert orbit.release_state["cosine"] == pytest.approx(-0.8, abs=1e-12)
    assert orbit.release_state["sine"] == pytest.approx(0.6, abs=1e-12)


def test_its_return_map_has_no_memory_and_the_certificate_calls_it_stable(
    orbit: Orbit,
) -> None:
    certificate = verify(orbit, OSCILLATOR)
    assert certificate.passed, certificate.verdict()
    assert certificate.multipliers == ()
    assert certificate.spectral_radius == 0.0
    assert certificate.stable


def test_the_work_of_the_force_pays_for_what_the_impacts_and_the_damper_lose(
    orbit: Orbit,
) -> None:
    energies = verify(orbit, OSCILLATOR).energies
    losses = energies["other_loss"] + energies["impact_loss"]
    assert energies["input_work"] == pytest.approx(losses, rel=1e-9)
    assert energies["energy_gain"] == pytest.approx(0.0, abs=1e-12)
    assert energies["copper_loss"] == 0.0


def test_the_same_machine_in_other_units_of_time_has_the_same_orbit() -> None:
    # With the time in units of 1/3 s: omega, c, k and A scale by 3, 3, 9 and 9.
    faster = OSCILLATOR.values(parameters={"omega": 3.0, "c": 5.7, "k": 9.0, "A": 9.0})
    orbit = orbit_at_gains(OSCILLATOR, faster).unwrap()
    assert orbit.period == pytest.approx(PERIOD / 3, rel=1e-12)
    assert 3 * orbit.zeno_time + FORCED.release_time == pytest.approx(
        PUBLISHED_ZENO_TIME, abs=1e-11
    )


def test_impacts_of_the_published_orbit_without_a_zeno_point_are_found() -> None:
    values = OSCILLATOR.values(parameters={"c": 0.1, "stop": 1.0, "restitution": 0.8})
    dynamics = OSCILLATOR.dynamics(values)
    phase, velocity = 0.07595216493831239, -1.3565863500759056
    start = (0.0, -velocity, math.cos(phase), math.sin(phase))
    run = simulate(dynamics, start, until=2 * PERIOD + 0.1)
    assert len(run.impacts) == 2
    for k, impact in enumerate(run.impacts, start=1):
        assert impact.time == pytest.approx(k * PERIOD, abs=1e-11)
        assert impact.state_plus[1] == pytest.approx(-velocity, abs=1e-11)
    assert COCO.restitution == 0.8


def test_the_clock_stays_on_its_circle_for_a_thousand_turns() -> None:
    dynamics = OSCILLATOR.dynamics(OSCILLATOR.values(parameters={"A": 0.5}))
    until = 1000 * PERIOD
    run = simulate(dynamics, (0.0, 0.0, 1.0, 0.0), until=until)
    # Locked for good, as 0.5 < 0.8: some 1e4 steps of 1e-12 each drift by 1e-8 at worst.
    assert abs(dynamics.holonomic(run.end_state)[0]) < 1e-8
    assert run.end_state[2] == pytest.approx(math.cos(until), abs=1e-8)


def test_a_start_off_the_circle_of_the_clock_is_refused() -> None:
    dynamics = OSCILLATOR.dynamics(OSCILLATOR.values())
    with pytest.raises(InputError, match=r"on the unit circle, as a clock, but they are 0 and 0"):
        simulate(dynamics, (0.1, 0.0, 0.0, 0.0), until=1.0)


def test_a_start_that_names_no_state_of_the_clock_has_its_declared_phase() -> None:
    declared = OSCILLATOR.initial_state()
    assert declared[2:] == (1.0, 0.0)
    assert OSCILLATOR.initial_state({OSCILLATOR.state_names[1]: 0.5}) == (0.0, 0.5, 1.0, 0.0)
    assert OSCILLATOR.initial_state({OSCILLATOR.state_names[3]: -1.0}) == (0.0, 0.0, 0.0, -1.0)


def test_the_radius_of_the_clock_is_no_section_coordinate() -> None:
    dynamics = OSCILLATOR.dynamics(OSCILLATOR.values())
    section = section_around(dynamics, RELEASE_ROWS, np.array([0.0, 0.0, -0.8, 0.6]), np.ones(4))
    assert section.dimension == 0


@pytest.mark.parametrize("name", ["kinetic", "potential", "gap"])
def test_time_in_an_energy_or_in_the_gap_is_refused_by_name(name: str) -> None:
    q, v, clock = ca.SX.sym("q"), ca.SX.sym("v"), Clock.at(ca.SX(1))
    parts = {"kinetic": v**2 / 2, "potential": q, "gap": q}
    parts[name] = parts[name] * (2 + clock.cosine)
    with pytest.raises(ValueError, match=rf"Argument `{name}` must not depend on the clock"):
        HybridLagrangian.from_energies(q=q, v=v, clock=clock, **parts)


def test_an_applied_force_needs_an_entry_for_every_coordinate() -> None:
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    with pytest.raises(ValueError, match=r"Argument `applied_force` must have 2 entries"):
        HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=ca.SX(0),
            gap=q[0],
            applied_force=ca.SX(1),
        )


def test_a_corrected_drive_refuses_a_voltage_that_changes_with_time() -> None:
    q, v, clock = ca.SX.sym("q"), ca.SX.sym("v"), Clock.at(ca.SX(1))
    mechanism = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=v**2 / 2, potential=ca.SX(0), gap=q, clock=clock
    )
    one = ca.SX(1)
    motors = MotorBank(
        selection=one,
        resistance=one,
        inductance=one,
        torque_constant=one,
        emf_constant=one,
        voltage=clock.sine - q,
    )
    with pytest.raises(ValueError, match=r"voltage of the state alone"):
        corrected_drive(mechanism, motors)


@pytest.mark.slow
def test_all_pictures_that_a_forced_problem_has_are_drawn(
    orbit: Orbit, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "orbit.json"
    write_orbit(orbit, file)
    assert main(["plot", str(file), "-o", str(tmp_path)]) == 0
    assert sorted(p.name for p in tmp_path.glob("*.png")) == [
        "portraits.png",
        "time.png",
        "zeno.png",
    ]
    capsys.readouterr()
    assert main(["plot", str(file), "--kind", "region", "-o", str(tmp_path)]) == 2
    assert "has a clock or a holonomic constraint" in capsys.readouterr().err
