"""A certificate is replayed with the hand-written model, which has to say the same."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.commands import MISUSE, NO, YES, ask
from tests.support.orbits import shot_orbit
from zeno_orbits.orbits import Orbit
from zeno_orbits.proof import replay_proof

HAND_WRITTEN = '''
"""The shaken table by hand: a ball of the gap h = z - A sin(omega t), clock and ball by formula."""

import numpy as np

from zeno_orbits.integrators.flow import PlainFlow
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics, plain_flight


def dynamics(values):
    p = values.parameters
    A, omega, g, e = p["A"], p["omega"], p["g"], p["restitution"]

    def acceleration(x):
        return FACTOR * A * omega**2 * x[3] - g

    def free(x):
        return np.array([x[1], acceleration(x), -omega * x[3], omega * x[2]])

    def locked(x):
        return np.array([0.0, 0.0, -omega * x[3], omega * x[2]])

    return HybridDynamics(
        state_names=("z", "dz", "cosine", "sine"),
        n_q=1,
        restitution=e,
        speed_after=lambda rate: -e * rate,
        free=PlainFlow(field=free, guard_and_rate=lambda x: (float(x[0]), float(x[1]))),
        locked=PlainFlow(field=locked, guard_and_rate=lambda x: (-acceleration(x), 0.0)),
        flight=plain_flight(free, acceleration),
        gap=lambda x: float(x[0]),
        gap_rate=lambda x: float(x[1]),
        gap_acceleration=acceleration,
        multiplier=lambda x: -acceleration(x),
        multiplier_rate=lambda x: 0.0,
        reset_map=lambda x, rate: x - (1 + e) * rate * np.array([0.0, 1.0, 0.0, 0.0]),
        impulse_direction=lambda x: np.array([0.0, 1.0, 0.0, 0.0]),
        normal_inertia=lambda x: 1.0,
        energy=lambda x: 0.0,
        holonomic=lambda x: np.zeros(0),
    )
'''


@pytest.fixture(scope="module")
def table() -> Orbit:
    return shot_orbit("vibrating_table")


@pytest.fixture(scope="module")
def certificate(table: Orbit) -> dict[str, Any]:
    return dict(zo.prove(table).certificate)


def _by_hand(folder: Path, factor: float) -> zo.Problem:
    file = folder / f"reference_{factor}.py"
    file.write_text(HAND_WRITTEN.replace("FACTOR", repr(factor)))
    return replace(zo.load_problem("vibrating_table"), reference=file)


def test_a_model_written_by_hand_agrees_with_every_record(
    certificate: dict[str, Any], tmp_path: Path
) -> None:
    replay = replay_proof(certificate, _by_hand(tmp_path, 1.0))
    assert replay is not None
    assert replay.ok, replay.verdict()
    # Local errors of 1e-13 a step, of some steps a record.
    assert replay.largest < 1e-11
    assert replay.n_records == len(certificate["passes"][0]["records"])


def test_another_law_of_motion_is_noticed_and_the_record_named(
    certificate: dict[str, Any], tmp_path: Path
) -> None:
    replay = replay_proof(certificate, _by_hand(tmp_path, 1.0 + 1e-6))
    assert replay is not None
    assert not replay.ok
    assert "(step)" in replay.verdict()


def test_another_restitution_is_noticed_at_an_impact(
    certificate: dict[str, Any], tmp_path: Path
) -> None:
    other = copy.deepcopy(certificate)
    name = "restitution"
    other["parameters"][name] = f"{np.ldexp(1, 20).astype(int):#x}p-22"
    replay = replay_proof(other, _by_hand(tmp_path, 1.0))
    assert replay is not None
    assert "(impact)" in replay.verdict()


def test_a_problem_without_a_hand_written_model_is_not_replayed(
    certificate: dict[str, Any],
) -> None:
    assert replay_proof(certificate, zo.load_problem("vibrating_table")) is None


@pytest.mark.slow
def test_the_command_says_which_levels_were_checked(
    certificate: dict[str, Any], tmp_path: Path
) -> None:
    path = tmp_path / "proof.json"
    path.write_text(json.dumps(certificate))
    answer = ask("prove", "--check", path)
    assert answer.code == YES
    assert "Level A, replay: the problem lacks a hand-written model." in answer.out
    assert "Level B, inclusions: Proved: a Zeno periodic orbit" in answer.out
    told = ask("prove", "--check", path, "--json").data
    assert told["levels"] == {"A": None, "B": {"ok": True}}
    period = next(claim for claim in certificate["claims"] if claim["name"] == "period")
    false = copy.deepcopy(certificate)
    false["claims"][certificate["claims"].index(period)]["low"] = period["high"]
    path.write_text(json.dumps(false))
    assert ask("prove", "--check", path).code == NO
    path.write_text("{}")
    assert ask("prove", "--check", path).code == MISUSE


@pytest.mark.slow
def test_the_reference_orbit_is_replayed_with_its_hand_written_model(orbit: Orbit) -> None:
    proof = zo.prove(orbit, radius=1e-9)
    replay = replay_proof(dict(proof.certificate), zo.load_problem("motor_pendulum"))
    assert replay is not None
    assert replay.ok, replay.verdict()
