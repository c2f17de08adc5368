"""What is measured of an orbit is what a dense simulation shows."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.reference.reference_orbit import MULTIPLIER, PERIOD
from tests.support.periods_by_hand import arc, cycle, first_cycle, impact, phase, system, zeno
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import HybridDynamics, Problem, load_problem
from zeno_orbits.orbits import ONE_ZENO, ZenoOrbit
from zeno_orbits.simulation import Mode, SimulationSettings, simulate
from zeno_orbits.verification import OrbitCertificate, measure, measurement
from zeno_orbits.verification.integration import Observation
from zeno_orbits.verification.measurement import NUMBERS, measured_smallest_share, quantity_names

SAMPLES = 20_001


def test_the_quantities_of_a_problem_are_its_states_its_motors_and_numbers(
    problem: Problem,
) -> None:
    names = quantity_names(problem)
    assert names[:6] == ("theta1", "theta2", "dtheta1", "dtheta2", "current", "voltage")
    assert names[6:] == (
        *("period", "energy", "spectral_radius", "margin"),
        *("gap_acceleration", "first_impact_speed", "release_transversality", "locked_time"),
    )
    assert "current" in quantity_names(load_problem("motor_pendulum@quasi_static"))
    assert "current" not in quantity_names(load_problem("bouncing_ball"))


@pytest.mark.slow
def test_peaks_are_those_of_a_dense_simulation(
    problem: Problem, orbit: ZenoOrbit, machine: HybridDynamics
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
    problem: Problem, orbit: ZenoOrbit, certificate: OrbitCertificate
) -> None:
    names = ["period", "energy", "spectral_radius", "margin", *certificate.margins]
    found = measure(orbit, problem, names)
    assert found["period"].highest == pytest.approx(PERIOD, abs=1e-8)
    assert found["energy"].highest == pytest.approx(certificate.energies["input_work"], rel=1e-9)
    assert found["spectral_radius"].highest == pytest.approx(abs(MULTIPLIER), abs=1e-6)
    for name, value in certificate.margins.items():
        assert found[name].highest == pytest.approx(value, rel=1e-8)
    # The locked arc is the nearest way to lose this orbit.
    assert found["margin"].lowest == pytest.approx(certificate.margins["locked_time"] / PERIOD)


def test_what_is_no_quantity_of_the_problem_is_refused(problem: Problem, orbit: ZenoOrbit) -> None:
    with pytest.raises(InputError, match=r"`names` must name a quantity of the problem .*`theta3`"):
        measure(orbit, problem, ["theta1", "theta3"])


# Of motions made by hand.


class _Parts:
    """In place of an integration and what is made of it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        one = _held(fall=3.0, until=1.5)
        self.first = first_cycle(cycle([one], [one.flight, one.locked]))
        self.seen = Observation(
            first=self.first, returns=(), integration_error=0.0, trouble="It is lost"
        )
        self.asked: dict[str, Any] = {}
        self.claim = SimpleNamespace(shape=ONE_ZENO, start=np.array([1.0, 2.0, 3.0]))
        self.margins = {"locked_time": 0.25, "first_impact_speed": 3.0}
        self.orbit: Any = SimpleNamespace(values=lambda _: SimpleNamespace(vector="numbers"))
        self.problem: Any = SimpleNamespace(compiled=lambda: "compiled")
        shown = SimpleNamespace(at=lambda _: lambda x: float(x[1]) ** 2)
        multipliers = SimpleNamespace(spectral_radius=0.7, error=1e-5)
        for name, value in (
            ("signal_names", lambda _: ("h", "w")),
            ("claim_of", lambda *_: self.claim),
            ("bind", lambda *_: system()),
            ("observe", self._observe),
            ("signal", lambda *_: shown),
            ("margins_of", lambda *_: self.margins),
            ("place_on_section", lambda *_: "placed"),
            ("energies_of", lambda *_: {"input_work": 5.0, "impact_loss": 1.0}),
            ("orbit_multipliers", self._multipliers),
        ):
            monkeypatch.setattr(measurement, name, value)
        self._found = multipliers

    def _observe(self, *given: Any) -> Observation:
        self.asked["simulation"], self.asked["periods"] = given[2:]
        return self.seen

    def _multipliers(self, _: Any, start: Any, **named: Any) -> Any:
        self.asked["multipliers"] = {"start": start, **named}
        return self._found

    def measured(self, *names: str, **settings: Any) -> dict[str, Any]:
        return measure(self.orbit, self.problem, names, **settings)


def _held(*, fall: float, until: float, start: float = 0.0) -> Any:
    """Return a flight over half a second, a Zeno point a tenth later, and a locked arc.

    It rises at the speed 2 and falls the faster towards the impact; on the stop d2h/dt2 goes from
    -20 to zero at the release.
    """
    hit, limit = start + 0.5, start + 0.6
    return phase(
        (start, (0.0, 2.0, 0.0)),
        [impact(hit, (0.0, -fall, 1.0)), impact(hit + 0.05, (0.0, -0.5, 1.0))],
        zeno(limit, (0.0, 0.0, 1.0)),
        (until, (0.0, 0.0, 0.0)),
        flight=arc(Mode.FREE, [start, hit], [(0.0, 2.0, 0.0), (0.0, -fall, 1.0)]),
        locked=arc(Mode.LOCKED, [limit, until], [(0.0, 0.0, 2.0), (0.0, 0.0, 0.0)]),
    )


def _share(*phases: Any) -> float:
    return measured_smallest_share(
        system(gap_acceleration=lambda x: -10.0 * float(x[2])), cycle(phases)
    )


def test_the_smallest_share_is_the_least_of_speed_rest_and_push_over_all_phases() -> None:
    # Of the speed all, of the push half, and the locked arc 0.9 of 1.5 seconds.
    assert _share(_held(fall=3.0, until=1.5)) == pytest.approx(0.5)
    # 0.1 of 0.7 seconds at rest.
    assert _share(_held(fall=3.0, until=0.7)) == pytest.approx(0.1 / 0.7)
    # An impact at a tenth of the speed at which the flight began.
    assert _share(_held(fall=0.2, until=1.5)) == pytest.approx(0.1)
    # The times of a later phase count from the start of the period.
    later = _held(fall=3.0, until=2.2, start=1.5)
    early = _held(fall=3.0, until=1.5)
    for phases in ((early, later), (later, early)):
        assert _share(*phases) == pytest.approx(0.1 / phases[-1].end.time)


def test_a_phase_that_does_not_rest_has_the_share_of_its_speed_alone() -> None:
    struck = SimpleNamespace(**{**vars(_held(fall=0.5, until=0.6)), "zeno": None, "locked": None})
    assert _share(struck) == pytest.approx(0.25)


def test_every_quantity_is_what_it_is_called(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = _Parts(monkeypatch)
    found = parts.measured("w", "period", "energy", "margin", "locked_time", "spectral_radius", "w")
    assert {name: (seen.lowest, seen.highest) for name, seen in found.items()} == {
        # The square of the gap rate from 2 down to -3 and on the stop.
        "w": (pytest.approx(0.0, abs=1e-12), 9.0),
        "period": (1.5, 1.5),
        "energy": (5.0, 5.0),
        "margin": (0.5, 0.5),
        "locked_time": (0.25, 0.25),
        "spectral_radius": (0.7, 0.7),
    }
    assert {name: seen.error for name, seen in found.items() if seen.error} == {
        "spectral_radius": 1e-5
    }
    assert parts.asked["periods"] == 1
    assert parts.asked["simulation"] == SimulationSettings()
    assert parts.asked["multipliers"] == {
        "start": "placed",
        "scale": parts.first.scale,
        "period": 1.5,
        "settings": SimulationSettings(),
        "shape": ONE_ZENO,
    }


def test_accuracy_that_is_asked_for_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = _Parts(monkeypatch)
    rough = SimulationSettings(most_steps=99)
    parts.measured("spectral_radius", simulation=rough)
    assert parts.asked["simulation"] == parts.asked["multipliers"]["settings"] == rough


def test_a_margin_that_the_shape_does_not_have_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = _Parts(monkeypatch)
    with pytest.raises(InputError, match=r"of the shape `zeno`, .* `gap_acceleration`"):
        parts.measured("locked_time", "gap_acceleration")


def test_an_orbit_that_does_not_come_back_is_measured_by_no_number(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    parts = _Parts(monkeypatch)
    parts.seen = replace(parts.seen, first=None)
    with pytest.raises(SimulationError, match="It is lost") as caught:
        parts.measured(NUMBERS[0])
    assert caught.value.time == 0.0
    assert caught.value.state == (1.0, 2.0, 3.0)
