"""Laws of the impact speed in fits and rigs."""

from __future__ import annotations

import pytest

import zeno_orbits as zo
from tests.support.recordings_of import recorded
from zeno_orbits.experiment import tabulate_orbit

TRUTH = {"restitution": 0.55, "fall": 0.3}


def _recording(seed: int) -> zo.Recording:
    problem = zo.load_problem("marble_table")
    orbit = zo.find_orbit(problem, parameters=TRUTH).unwrap()
    table = tabulate_orbit(orbit, problem, ("height", "speed"))
    return recorded(table, problem, n_cycles=10, rate=2000.0, noise=3e-3, seed=seed, start=0.4)


@pytest.mark.weekly
@pytest.mark.slow
def test_the_parameters_of_a_law_are_found_from_an_orbit() -> None:
    found = zo.identify(
        "marble_table", _recording(0), {"restitution": (0.2, 0.9), "fall": (0.0, 1.0)}
    )
    for one in found.fitted:
        true = TRUTH[one.unknown.label]
        assert abs(one.value - true) < 5 * one.error < 0.3 * true, one
    # The recording excludes a constant restitution.
    fall = found.fitted[1]
    assert fall.low > 0.0
    constant = zo.identify(
        "marble_table", _recording(0), {"restitution": (0.2, 0.9)}, parameters={"fall": 0.0}
    )
    assert constant.misfit > 3 * found.misfit


def test_a_compliant_stop_is_damped_for_the_restitution_at_each_speed() -> None:
    problem = zo.load_problem("marble_table")
    orbit = zo.find_orbit(problem).unwrap()
    off: list[list[float]] = []
    for stiffness in (1e7, 1e9):
        rig = zo.Rig(contact=zo.Contact(stiffness=stiffness, slowest=1e-6))
        run = zo.simulate_rig(problem, rig, until=orbit.period, start=orbit.start_state)
        pairs = [(-one.approach_rate, one.depart_rate) for one in run.touches]
        off.append([1 - away / (v * (0.5 - 0.2 * v)) for v, away in pairs if v > 0.1])
    # The load lowers the ratio by its impulse, which falls with the duration of the contact.
    for soft, stiff in zip(*off, strict=True):
        assert 0 < stiff < 0.003
        assert soft / stiff == pytest.approx(10, rel=0.05)
