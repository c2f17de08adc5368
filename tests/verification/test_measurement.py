"""What is measured of an orbit is what a dense simulation shows."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.reference_orbit import MULTIPLIER, PERIOD
from zeno_orbits.errors import InputError
from zeno_orbits.model import HybridDynamics, Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.simulation import simulate
from zeno_orbits.verification import EVENT_MARGINS, OrbitCertificate, measure

SAMPLES = 20_001


@pytest.mark.slow
def test_peaks_are_those_of_a_dense_simulation(
    problem: Problem, orbit: Orbit, machine: HybridDynamics
) -> None:
    found = measure(orbit, problem, ["theta2", "current", "voltage"])
    start = machine.on_stop(np.array(list(orbit.release_state.values())))
    run = simulate(machine, start, until=1.3 * orbit.period)
    times = np.linspace(0.0, orbit.period, SAMPLES)
    states = np.array([run.state_at(float(time)) for time in times])
    gains = orbit.gains
    dense = {
        "theta2": states[:, 1],
        "current": states[:, 4],
        "voltage": -gains["Kp"] * states[:, 0] - gains["Kd"] * states[:, 2],
    }
    step = orbit.period / SAMPLES
    for name, values in dense.items():
        # A sample misses a smooth peak by the square of the step, a kink by the step; both rates
        # are below 1e3 a second here, at the impact.
        assert found[name].highest >= np.max(values) - 1e-9
        assert found[name].lowest <= np.min(values) + 1e-9
        assert found[name].highest == pytest.approx(np.max(values), abs=1e3 * step)
        assert found[name].lowest == pytest.approx(np.min(values), abs=1e3 * step)


def test_numbers_are_those_of_the_certificate(
    problem: Problem, orbit: Orbit, certificate: OrbitCertificate
) -> None:
    margins = [name for name in EVENT_MARGINS if name in certificate.margins]
    assert len(margins) == 4
    names = ["period", "energy", "spectral_radius", "margin", *margins]
    found = measure(orbit, problem, names)
    assert found["period"].highest == pytest.approx(PERIOD, abs=1e-8)
    assert found["energy"].highest == pytest.approx(certificate.energies["input_work"], rel=1e-9)
    assert found["spectral_radius"].highest == pytest.approx(abs(MULTIPLIER), abs=1e-6)
    for name in margins:
        assert found[name].highest == pytest.approx(certificate.margins[name], rel=1e-8)
    # The locked arc is the nearest way to lose this orbit.
    assert found["margin"].lowest == pytest.approx(certificate.margins["locked_time"] / PERIOD)


def test_what_is_no_quantity_of_the_problem_is_refused(problem: Problem, orbit: Orbit) -> None:
    with pytest.raises(InputError, match=r"`names`: unknown name `theta3`.*Known: "):
        measure(orbit, problem, ["theta1", "theta3"])


# Of motions made by hand.
