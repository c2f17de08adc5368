"""The events that a theorem lists: impacts on other stops and plastic contacts have their names."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import casadi as ca
import pytest

import zeno_orbits as zo
from zeno_orbits.proof import check_proof

LAWS = {"ceil": (0.3, 0.3), "mixed": (0.0, 0.3)}
"""Restitution of the floor and the ceiling."""


def _problem(name: str) -> zo.Problem:
    """Return a mass that is thrown from a floor against a ceiling, and falls back."""
    floor, ceiling = LAWS[name]

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        x, v = ca.SX.sym("x"), ca.SX.sym("v")
        clock = zo.Clock.at(p["omega"])
        mass = zo.HybridLagrangian.from_energies(
            q=x,
            v=v,
            kinetic=v**2 / 2,
            potential=10 * x,
            applied_force=20 * clock.cosine,
            clock=clock,
            stops=(
                zo.Stop(name="floor", gap=x, restitution=p["floor"]),
                zo.Stop(name="ceiling", gap=0.5 - x, restitution=p["ceiling"]),
            ),
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    return zo.Problem(
        name=name,
        title=name,
        source="",
        state_names=("x", "v", "cosine", "sine"),
        state_units=("m", "m/s", "1", "1"),
        parameters=(
            zo.Quantity.positive("omega", 6.0, "rad/s", "frequency"),
            *(
                zo.Quantity(name=name, unit="1", meaning=name, default=e, lower=0.0, upper=1.0)
                for name, e in (("floor", floor), ("ceiling", ceiling))
            ),
        ),
        gains=(),
        model=model,
        starts=({"cosine": 1.0},),
        portraits=(("x", "v"),),
        amplitude_of="x",
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_a_theorem_lists_the_impact_on_the_other_stop(name: str, tmp_path: Path) -> None:
    problem = _problem(name)
    orbit = zo.find_orbit(problem, section="release floor").unwrap()
    proof = zo.prove(orbit, problem=problem)
    held = "plastic impact on floor" if name == "mixed" else "Zeno point of floor"
    assert proof.proved
    assert proof.events == ("impact on ceiling", held, "release of floor")
    assert f"{held.partition(' o')[0]} " in "\n".join(proof.lines())
    file = tmp_path / "proof.json"
    file.write_text(json.dumps(proof.certificate), encoding="utf-8")
    verdict = check_proof(file, problem)
    assert verdict.ok
    assert verdict.theorem.events == proof.events
