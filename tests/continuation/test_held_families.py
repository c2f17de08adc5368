"""Repelling orbits of families and the least feedback that keeps them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.commands import MISUSE, YES, ask
from tests.support.repelling import KD
from zeno_orbits.errors import InputError


@pytest.fixture(scope="module")
def families(repelling: zo.Orbit) -> zo.Continuation:
    """Three orbits of a family: its ends, and the start."""
    found = zo.continue_orbit(repelling, ("Kd", -1.5791, -1.57909))
    (family,) = found.families
    middle = min(family.points, key=lambda one: abs(one.value - KD))
    points = (family.points[0], middle, family.points[-1])
    return replace(found, families=(replace(family, points=points),))


def test_least_effort_has_a_closed_form_for_one_multiplier_that_repels(
    repelling: zo.Orbit, families: zo.Continuation
) -> None:
    held = zo.stabilize(families, ["Kp"])
    (points,) = held.points
    assert len(points) == len(families.families[0].points)
    middle = min(points, key=lambda one: abs(one.value - KD))
    assert middle.value == pytest.approx(KD, abs=1e-12)
    # With the left eigenvector w of the multiplier, P = (mu^2 - 1) w w' / (w b)^2.
    returns = zo.return_map(repelling)
    sizes, value = returns.sizes, repelling.gains["Kp"]
    a = returns.jacobian * sizes / sizes[:, None]
    b = returns.gain_jacobian[:, returns.gain_names.index("Kp")] * value / sizes
    w, mu = np.ones(len(b)), 0.0
    for _ in range(50):
        # The other multiplier is zero.
        mu, w = float(np.linalg.norm(w @ a)), w @ a / np.linalg.norm(w @ a)
    effort = float(np.sqrt(mu**2 - 1) / abs(w @ b))
    assert middle.effort == pytest.approx(effort, rel=1e-6)
    assert middle.held_radius == pytest.approx(1 / mu, rel=1e-8)
    assert all(point.reason == "" for point in points)
    assert "held=" in repr(held)
    with pytest.raises(InputError, match="`Kd` is the parameter of the families"):
        zo.stabilize(families, ["Kd"])
    with pytest.raises(InputError, match="unknown name `Kq`"):
        zo.stabilize(families, ["Kq"])


@pytest.mark.slow
def test_an_input_without_effect_is_the_reason_why_an_orbit_is_not_kept(
    families: zo.Continuation,
) -> None:
    held = zo.stabilize(families, ["restitution"])
    reasons = {point.reason for points in held.points for point in points}
    efforts = [point.effort for points in held.points for point in points]
    # The restitution acts on the orbit, gravity on the section too.
    assert reasons == {""}
    assert np.all(np.isfinite(efforts))
    moved = zo.stabilize(families, ["g"])
    assert all("`g` moves the section" in one.reason for points in moved.points for one in points)
    assert np.all(np.isnan([one.effort for points in moved.points for one in points]))


@pytest.mark.slow
def test_the_command_prints_draws_and_writes_what_is_held(
    repelling: zo.Orbit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    zo.write_orbit(repelling, "orbit.json")
    words = ("continue", "orbit.json", "--parameter", "Kd=-1.5792:-1.579", "--stabilize", "Kp")
    answer = ask(*words, "--plot", "held.png", "-o", "held.json")
    assert answer.code == YES, answer.err
    assert "Feedback by Kp keeps" in answer.out
    assert (tmp_path / "held.png").stat().st_size > 10_000
    data = json.loads((tmp_path / "held.json").read_text())
    assert data["inputs"] == ["Kp"]
    assert all(one["held_radius"] < 1.0 < one["spectral_radius"] for one in data["held"][0])
    refused = ask(*words[:-1], "Kd")
    assert refused.code == MISUSE
    assert "--stabilize Kd: `Kd` is the parameter of the families" in refused.err
