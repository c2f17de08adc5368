"""The energy balance in the certificate of event orbits."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import casadi as ca
import pytest

import zeno_orbits as zo


def _bell(share: float) -> zo.Problem:
    """Return a mass between two stops, with a Maxwell element whose stated loss is a share of it.

    The element is a spring and a damper in series: ``s' = v - s / tau``, with the force ``-k s``,
    the stored energy ``k s^2 / 2`` and the loss ``k s^2 / tau``.
    """

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        place, speed, stretch = (ca.SX.sym(name) for name in ("place", "speed", "stretch"))
        clock = zo.Clock.at(p["omega"])
        mass = zo.HybridLagrangian.from_energies(
            q=place,
            v=speed,
            kinetic=speed**2 / 2,
            potential=place**2 / 2,
            applied_force=5 * clock.cosine,
            clock=clock,
            stops=(
                zo.Stop(name="upper", gap=1 - place, restitution=0.3),
                zo.Stop(name="lower", gap=1 + place, restitution=0.2),
            ),
        )
        element = zo.Auxiliary(
            states=stretch,
            rate=speed - stretch,
            force=-p["k"] * stretch,
            loss=share * p["k"] * stretch**2,
            stored_energy=p["k"] * stretch**2 / 2,
        )
        return zo.hybrid_system(mass, element)

    return zo.Problem(
        name="bell",
        title="mass between two stops with a Maxwell element",
        source="tests",
        state_names=("place", "speed", "stretch", "cosine", "sine"),
        state_units=("m", "m/s", "m", "1", "1"),
        parameters=(
            zo.Quantity.positive("omega", 0.3, "rad/s", "frequency of the force"),
            zo.Quantity.positive("k", 0.5, "N/m", "stiffness of the element"),
        ),
        gains=(),
        model=model,
        starts=({"cosine": 1.0},),
        portraits=(("place", "speed"),),
        amplitude_of="place",
    )


@cache
def _orbit() -> zo.EventOrbit:
    return zo.find_event_orbit(_bell(1.0))


def test_the_input_work_of_an_event_orbit_is_what_losses_and_impacts_take() -> None:
    certificate = zo.verify(_orbit(), problem=_bell(1.0))
    # The tolerances of the integration are near 1e-12.
    for name in ("energy_balance", "restitution", "impulses"):
        assert certificate.residuals[name] < 1e-10
    energies = certificate.energies
    assert energies["input_work"] > 1.0
    assert energies["other_loss"] > 0.1
    # Newton's law at the impacts of the file, beyond which the tails lose next to nothing.
    lost = 0.0
    for event in _orbit().events:
        kind, _, stop = event.name.partition(" ")
        if kind == "impact":
            e = {"upper": 0.3, "lower": 0.2}[stop]
            lost += (1 - e**2) / 2 * event.state["speed"] ** 2
    assert energies["impact_loss"] == pytest.approx(lost, rel=1e-5)


def test_a_false_loss_is_refused() -> None:
    certificate = zo.verify(_orbit(), problem=_bell(0.99))
    assert not certificate.passed
    wrong = certificate.residuals["energy_balance"]
    energies = certificate.energies
    # One percent of the true loss is missing from the balance.
    assert wrong == pytest.approx(
        energies["other_loss"] / 99 / max(map(abs, energies.values())), rel=1e-6
    )
    others = {name: x for name, x in certificate.residuals.items() if name != "energy_balance"}
    assert max(others.values()) < certificate.tolerance
