"""How a verification puts its stages together, each of which is told what to answer."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.periods_by_hand import arc, cycle, first_cycle, impact, phase, system, zeno
from zeno_orbits.errors import SimulationError, ZenoOrbitsError
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model import StateLimit
from zeno_orbits.orbits import ONE_ZENO, EventSequence, Moment, Multipliers
from zeno_orbits.simulation import Mode, SimulationSettings
from zeno_orbits.verification import (
    DeltaCut,
    OrbitCertificate,
    VerificationSettings,
    multipliers_of,
    problem_dynamics,
    verifier,
    verify,
)
from zeno_orbits.verification.integration import Observation

SETTINGS = VerificationSettings(
    tolerance=1e-8,
    n_periods=4,
    simulation=SimulationSettings(tolerance=Tolerance(relative=1e-12, absolute=1e-13)),
    cuts=(0.1, 0.02),
)
SWEEP = tuple(DeltaCut(delta=v, speed=v, error=v**3) for v in (1e-1, 1e-2, 1e-3))


class _Stages:
    """In place of the stages: what each was asked, and what it shall answer."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        one = phase(
            (0.0, (0, 0, 0)), [impact(0.5, (0, -3.0, 1))], zeno(0.7, (0, 0, 5)), (1.5, (0, 0, 0))
        )
        one.zeno = zeno(0.7, (0, 0, 5), limit_error=3e-13)
        flight = arc(Mode.FREE, [0.0, 0.5], [(0, 0, 0), (0, -3, 1)])
        self.first = first_cycle(cycle([one], [flight]))
        self.seen = Observation(
            first=self.first,
            returns=(Moment(time=1.5, state=np.zeros(3)),),
            integration_error=2e-11,
            trouble="",
        )
        self.residuals: list[dict[str, float]] = []
        self.energies: Any = {"input_work": 2.0, "copper_loss": 1.0}
        self.sweep = SWEEP
        self.multipliers: Any = Multipliers(
            values=(0.5 + 0j,), error=1e-6, jacobian=np.array([[0.5]])
        )
        self.asked: dict[str, list[Any]] = {}
        self.orbit: Any = SimpleNamespace(
            shape=ONE_ZENO, problem_digest=(), values=lambda _: "numbers"
        )
        self.problem: Any = SimpleNamespace(
            name="toy",
            reference=None,
            escapes={},
            state_names=("a", "b", "c"),
            is_balanced=True,
        )
        self.claim = SimpleNamespace(
            shape=ONE_ZENO, start=np.array([1.0, 2.0, 3.0]), period=1.5, phases=()
        )
        for name, answer in (
            ("claim_of", lambda: self.claim),
            ("problem_dynamics", system),
            ("observe", lambda: self.seen),
            ("orbit_residuals", self._residuals),
            ("sampled_guards", dict),
            ("delta_sweep", lambda: self.sweep),
            ("energies_of", lambda: self.energies),
            ("second_model", lambda: 4e-11),
            ("margins_of", lambda: {"locked_time": 0.25}),
            ("place_on_section", lambda: "placed"),
            ("orbit_multipliers", lambda: self.multipliers),
        ):
            monkeypatch.setattr(verifier, name, self._stage(name, answer))

    def _stage(self, name: str, answer: Any) -> Any:
        def stage(*given: Any, **named: Any) -> Any:
            self.asked.setdefault(name, []).append((given, named))
            found = answer()
            if isinstance(found, Exception):
                raise found
            return found

        return stage

    def _residuals(self) -> dict[str, float]:
        return dict(self.residuals.pop(0))

    def certificate(self, *residuals: dict[str, float], **named: Any) -> OrbitCertificate:
        self.residuals = list(residuals or [{"closure": 1e-12, "drift": 1e-12}])
        settings = named.pop("settings", SETTINGS)
        return verify(self.orbit, self.problem, settings=settings, **named)


@pytest.fixture(name="stages")
def _stages(monkeypatch: pytest.MonkeyPatch) -> _Stages:
    return _Stages(monkeypatch)


def test_a_certificate_holds_what_its_stages_answer(stages: _Stages) -> None:
    seen = stages.certificate()
    assert seen == OrbitCertificate(
        tolerance=1e-8,
        residuals={
            "closure": 1e-12,
            "drift": 1e-12,
            "delta_sweep": pytest.approx(1e-9),
            "energy_balance": 0.5,
            "integration": 2e-11,
        },
        margins={"locked_time": 0.25},
        energies={"input_work": 2.0, "copper_loss": 1.0},
        multipliers=(0.5 + 0j,),
        multiplier_error=1e-6,
        delta_sweep=SWEEP,
        delta_order=pytest.approx(3.0),
        integration_error=2e-11,
        zeno_error=3e-13,
        period=1.5,
        n_periods=4,
        model="derived",
        trouble="",
        shape="zeno",
    )
    assert list(seen.residuals)[-1] == "integration"


def test_stages_are_given_the_settings(stages: _Stages) -> None:
    stages.certificate()
    [(given, _)] = stages.asked["observe"]
    assert given[2:] == (SETTINGS.simulation, 4, SETTINGS.tolerance)
    [(given, _)] = stages.asked["delta_sweep"]
    # Cuts go on until they are a tenth as far off as may be.
    assert given[2:4] == (SETTINGS.cuts, SETTINGS.simulation)
    assert given[4] == pytest.approx(1e-9)
    [(given, _)] = stages.asked["energies_of"]
    assert given[3:] == (stages.first.cycle, SETTINGS.simulation)
    [(given, named)] = stages.asked["problem_dynamics"]
    assert named == {"use_reference": False}
    [(given, named)] = stages.asked["orbit_multipliers"]
    assert given[1] == "placed"
    assert named["scale"] is stages.first.scale
    assert (named["period"], named["shape"]) == (1.5, ONE_ZENO)
    # Part of what a looser integration makes of it.
    assert 1e12 * named["noise"] == pytest.approx(2.0)
    used = named["settings"].tolerance
    assert (1e10 * used.relative, 1e11 * used.absolute) == pytest.approx((1.0, 1.0))


def test_multipliers_are_no_finer_than_they_are_read_and_no_coarser_than_asked(
    stages: _Stages,
) -> None:
    for relative, absolute in ((1e-6, 1e-13), (1e-13, 1e-6)):
        asked = Tolerance(relative=relative, absolute=absolute)
        rough = replace(SETTINGS, simulation=SimulationSettings(tolerance=asked))
        stages.certificate(settings=rough)
        _, named = stages.asked["orbit_multipliers"][-1]
        used = named["settings"].tolerance
        assert used.relative == max(relative, 1e-10)
        assert 1e11 * used.absolute == pytest.approx(1e11 * max(absolute, 1e-11))


def test_a_system_that_is_given_is_the_one_that_is_integrated(stages: _Stages) -> None:
    own = system(restitution=0.25)
    stages.certificate(dynamics=own)
    assert "problem_dynamics" not in stages.asked
    assert stages.asked["observe"][0][0][0] is own
    stages.certificate(settings=replace(SETTINGS, use_reference=True))
    assert stages.asked["problem_dynamics"][0][1] == {"use_reference": True}
    assert stages.certificate(settings=replace(SETTINGS, use_reference=True)).model == "reference"


# A finer integration, where a residual may be the integration's own.


@pytest.mark.parametrize(
    ("residual", "runs"), [(0.99, 1), (1.0, 1), (1.01, 2), (999.0, 2), (1001.0, 1), (math.inf, 1)]
)
def test_a_residual_a_little_too_large_is_looked_at_more_finely(
    stages: _Stages, residual: float, runs: int
) -> None:
    # In units of what passes.
    size = residual * SETTINGS.tolerance
    seen = stages.certificate({"closure": size, "period": 0.0}, {"closure": 0.0, "period": 0.0})
    assert len(stages.asked["observe"]) == runs
    assert seen.residuals["closure"] == (size if runs == 1 else 0.0)
    used = stages.asked["observe"][-1][0]
    assert used[3] == SETTINGS.n_periods
    fine = 1.0 if runs == 1 else 1e-2
    assert 1e12 * used[2].tolerance.relative == pytest.approx(fine)
    # All that follows is as fine.
    assert stages.asked["energies_of"][0][0][4] == used[2]


def test_without_a_period_nothing_is_looked_at_more_finely(stages: _Stages) -> None:
    stages.seen = replace(stages.seen, first=None, trouble="It is lost")
    seen = stages.certificate({"closure": 2e-8})
    assert len(stages.asked["observe"]) == 1
    assert seen.residuals == {"closure": 2e-8}
    assert (seen.multipliers, seen.multiplier_error) == ((), math.inf)
    assert (seen.zeno_error, seen.energies, seen.delta_sweep) == (math.inf, {}, ())
    assert math.isnan(seen.period)
    assert math.isnan(seen.delta_order)
    assert seen.trouble == "It is lost"
    assert "orbit_multipliers" not in stages.asked


# What repeats the period in another way.


def test_only_what_can_be_repeated_is(stages: _Stages) -> None:
    stages.sweep = ()
    assert "delta_sweep" not in stages.certificate().residuals
    assert "second_model" not in stages.asked
    stages.problem.reference = "a file"
    assert stages.certificate().residuals["second_model"] == 4e-11


def test_energies_that_cannot_be_had_do_not_balance(stages: _Stages) -> None:
    stages.energies = ZenoOrbitsError("It is lost.")
    seen = stages.certificate()
    assert seen.energies == {}
    assert seen.residuals["energy_balance"] == math.inf


def test_the_stages_are_told_in_their_order(stages: _Stages) -> None:
    stages.problem.reference = "a file"
    told: list[tuple[str, Any]] = []
    stages.certificate(on_progress=lambda *stage: told.append(stage))
    assert told == [
        ("integrating the orbit", None),
        ("sampling gap and multiplier", None),
        ("cutting the impact sequence", None),
        ("balancing the energy", None),
        ("comparing two derivations of the model", None),
        ("computing the multipliers", None),
    ]


# Stability, and what returns say.


@pytest.mark.parametrize(("radius", "kept"), [(0.999, True), (1.0, False), (1.5, False)])
def test_later_returns_count_only_along_an_orbit_that_attracts(
    stages: _Stages, radius: float, kept: bool
) -> None:
    stages.multipliers = replace(stages.multipliers, values=(0.1 + 0j, complex(radius)))
    stages.seen = replace(stages.seen, trouble="It is lost later")
    seen = stages.certificate()
    assert ("drift" in seen.residuals) is kept
    assert seen.trouble == ("It is lost later" if kept else "")


def test_multipliers_that_cannot_be_had_leave_trouble_as_it_is(stages: _Stages) -> None:
    stages.multipliers = ZenoOrbitsError("They cannot be had.")
    stages.seen = replace(stages.seen, trouble="It is lost later")
    seen = stages.certificate()
    assert "drift" not in seen.residuals
    assert (seen.multipliers, seen.multiplier_error) == ((), math.inf)
    assert seen.trouble == "It is lost later"


# What an orbit says of itself.


def test_every_contradiction_is_a_clause(stages: _Stages, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def same(*digests: Any) -> bool:
        asked.append(digests)
        return False

    monkeypatch.setattr(verifier, "same_equations", same)
    monkeypatch.setattr(verifier, "digest_of", lambda _: (2.0,))
    stages.orbit.problem_digest = (1.0,)
    stages.orbit.shape = EventSequence.parsed("plastic")
    stages.seen = replace(stages.seen, trouble="It is lost later")
    # The sizes of the three states are 1, 10 and 100.
    stages.problem.escapes = {
        "a": StateLimit(beyond=2.0, phrase="a flies off"),
        "b": StateLimit(beyond=5.0, phrase="b flies off"),
        "c": StateLimit(beyond=5.0, phrase="c flies off"),
    }
    clauses = stages.certificate().trouble.split("; ")
    assert asked == [((1.0,), (2.0,))]
    assert len(clauses) == 5
    assert clauses[0] == "It is lost later"
    assert "equations of problem `toy`" in clauses[1]
    assert "`plastic`" in clauses[2]
    assert "0.5" in clauses[2]
    assert clauses[2].endswith("`zeno`")
    assert clauses[3:] == ["b flies off", "c flies off"]


def test_a_shape_is_that_of_the_systems_restitution(stages: _Stages) -> None:
    stages.orbit.shape = stages.claim.shape = EventSequence.parsed("plastic")
    assert stages.certificate(dynamics=system(restitution=0.0)).trouble == ""
    assert stages.certificate(dynamics=system(restitution=0.0)).shape == "plastic"


# Alone.


def test_multipliers_alone_are_those_of_one_period(stages: _Stages) -> None:
    assert multipliers_of(stages.orbit, stages.problem, settings=SETTINGS) is stages.multipliers
    [(given, _)] = stages.asked["observe"]
    assert given[2:] == (SETTINGS.simulation, 1)
    [(_, named)] = stages.asked["orbit_multipliers"]
    assert 1e12 * named["noise"] == pytest.approx(2.0)
    multipliers_of(stages.orbit, stages.problem)
    assert stages.asked["observe"][-1][0][2] == SimulationSettings()


def test_an_orbit_that_does_not_return_has_no_multipliers(stages: _Stages) -> None:
    stages.seen = replace(stages.seen, first=None, trouble="It is lost")
    with pytest.raises(SimulationError, match="It is lost") as caught:
        multipliers_of(stages.orbit, stages.problem)
    assert caught.value.time == 1.5
    assert caught.value.state == (1.0, 2.0, 3.0)


def test_the_system_of_an_orbit_is_derived_or_written_by_hand(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def by_hand(problem: Any) -> Any:
        assert problem.name == "toy"
        return SimpleNamespace(dynamics=lambda values: ("by hand", values))

    monkeypatch.setattr(verifier, "load_reference", by_hand)
    orbit: Any = SimpleNamespace(values=lambda _: "numbers")
    problem: Any = SimpleNamespace(name="toy", dynamics=lambda values: ("derived", values))
    assert problem_dynamics(orbit, problem) == ("derived", "numbers")
    assert problem_dynamics(orbit, problem, use_reference=True) == ("by hand", "numbers")


def test_what_is_asked_by_default(stages: _Stages) -> None:
    stages.residuals = [{"closure": 0.0}]
    seen = verify(stages.orbit, stages.problem)
    assert (seen.tolerance, seen.n_periods, seen.model) == (1e-9, 3, "derived")
    [(given, _)] = stages.asked["delta_sweep"]
    # A decade apart each, down to where a cubic error is below what passes.
    assert given[2] == pytest.approx([0.03, 0.003, 0.0003, 0.00003])
