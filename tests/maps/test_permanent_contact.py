"""Permanent contact of forced machines, against the force that lifts them off in closed form."""

import math
from collections.abc import Mapping

import casadi as ca
import pytest

import zeno_orbits as zo
from zeno_orbits.maps import AttractorClass, attractors_at
from zeno_orbits.model import load_problem


def _leg() -> zo.Problem:
    """Return a body on a sprung foot, with a force between them."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v, clock = ca.SX.sym("q", 2), ca.SX.sym("v", 2), zo.Clock.at(p["omega"])
        leg = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=0.3 * v[0] ** 2 / 2 + 2.0 * (v[0] + v[1]) ** 2 / 2,
            potential=9.81 * (2.3 * q[0] + 2.0 * q[1]) + 800.0 * q[1] ** 2 / 2,
            passive_force=ca.vertcat(0, -8.0 * v[1]),
            applied_force=ca.vertcat(0, p["F"] * clock.cosine),
            gap=q[0],
            clock=clock,
        )
        return zo.hybrid_system(leg, zo.no_drive(leg), p["restitution"])

    return zo.Problem(
        name="leg",
        title="a body on a sprung foot",
        source="by hand",
        state_names=("foot", "extension", "foot_speed", "rate", "cosine", "sine"),
        state_units=("m", "m", "m/s", "m/s", "1", "1"),
        parameters=(
            zo.Quantity.positive("omega", 18.0, "rad/s", "speed of the drive"),
            zo.Quantity.positive("F", 10.0, "N", "amplitude of the force"),
            zo.Quantity.restitution(0.2),
        ),
        gains=(),
        model=model,
        starts=({"extension": -0.025, "cosine": 1.0},),
        portraits=(("foot", "foot_speed"),),
        amplitude_of="foot",
    )


def test_permanent_contact_of_a_forced_machine_has_the_period_of_its_clock_and_its_own_name():
    bowl = load_problem("curved_surface")
    (found,) = attractors_at(bowl, [bowl.values(parameters={"A": 1e-3})])
    assert (found.fate, found.phrase) == (AttractorClass.HELD, "permanent contact")
    assert found.period == pytest.approx(2 * math.pi / bowl.values().number("omega"), rel=1e-12)


def test_contact_is_permanent_up_to_the_force_that_lifts_the_foot() -> None:
    leg = _leg()
    # By hand: the body accelerates by omega^2 F / |k - m omega^2 + i c omega|. At the lift-off its
    # force on the foot is the weight of both.
    stiffness = abs(complex(800.0 - 2.0 * 18.0**2, 8.0 * 18.0))
    lift_off = 2.3 * 9.81 * stiffness / (2.0 * 18.0**2)
    settings = [leg.values(parameters={"F": part * lift_off}) for part in (0.4, 0.999, 1.001)]
    *held, thrown = attractors_at(leg, settings)
    assert [one.phrase for one in held] == 2 * ["permanent contact"]
    assert held[0].period == pytest.approx(2 * math.pi / 18.0, rel=1e-9)
    assert thrown.fate is AttractorClass.ZENO


@pytest.mark.slow
def test_a_search_in_permanent_contact_names_it_and_does_not_wait() -> None:
    result = zo.find_orbit(_leg(), parameters={"F": 4.0})
    assert result.orbit is None
    assert "stays in contact with `stop`, with the period 0.349066 s" in result.detail
    # The given values are tried twice. The points of the box say the same, and are not.
    result = zo.search_gains(_leg(), vary={"F": (1.0, 4.0)})
    assert result.orbit is None
    assert len(result.attempts) == 2
    assert "permanent contact (25)" in result.scan
