"""Quantities of events against published numbers, closed forms, energies and differences."""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.orbits import event_orbit
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import (
    EventQuantities,
    EventReturn,
    closed_return,
    event_quantity_names,
    inverse_of_closing,
    largest_states,
    near_return,
    require_event_quantity,
)
from zeno_orbits.simulation import Impact, SimulationSettings, SwitchEvent, simulate

SETTINGS = SimulationSettings()
_SETTLES = {"relay": 0.09, "relay_soft": 0.13, "hopper": 5.0}
"""Times until the motions nearly repeat [s]."""


def _return(
    problem: Problem,
    values: ParameterValues,
    section: str | None = None,
    parameters: tuple[int, ...] = (),
) -> EventReturn:
    graph = problem.graph_dynamics(values)
    x = np.array(problem.state_vector(problem.starts[0]))
    near = near_return(simulate(graph, x, until=_SETTLES[problem.name]), graph, section)
    return closed_return(
        graph,
        near.state,
        section=near.section,
        n_returns=near.n_returns,
        guess=near.period,
        settings=SETTINGS,
        parameters=parameters,
    )


@cache
def _quantities(name: str, section: str | None = None) -> EventQuantities:
    problem = zo.load_problem(name)
    values = problem.values()
    return EventQuantities.of(problem.graph_dynamics(values), _return(problem, values, section))


def _one(quantities: EventQuantities, name: str) -> float:
    (reading,) = quantities.readings(name)
    return reading.value


RELAY = {
    "closed.energy_lost": 2.65121545e-3,
    "open.energy_lost": 5.26684769e-4,
    "closed.impact_speed": 1.79987359610,
    "open.impact_speed": 0.81032276748,
    "closed.impact_time": 2.09300141683e-3,
    "closed.zeno_time": 2.56120736805e-3,
    "closed.bounce_time": 2.56120736805e-3 - 2.09300141683e-3,
    "open.release_time": 0.54922195966e-3,
    "closed.release_time": 24.2984216485e-3,
    "open.impact_time": 27.3932730156e-3,
    "open.zeno_time": 28.7985429859e-3,
}
"""From a program that shares no code with this one. The last digit of each is rounded."""


@pytest.mark.parametrize("section", ["zeno closed", "zeno open", "switch kink 1"])
def test_the_relay_has_the_published_quantities_from_every_section(section: str) -> None:
    quantities = _quantities("relay", section)
    for name, wanted in RELAY.items():
        assert _one(quantities, name) == pytest.approx(wanted, rel=4e-9), name
    times = sorted(one.value for one in quantities.readings("kink 1.time"))
    assert times == pytest.approx([0.0, 0.02], abs=1e-12)


def test_impacts_are_counted_above_a_speed_and_not_to_the_resolution() -> None:
    quantities = _quantities("relay")
    # In flights this short the speeds nearly fall by the restitution 0.3: 1.8, 0.54, 0.15, 0.04.
    assert _one(quantities, "closed.impacts@1") == 1.0
    assert _one(quantities, "closed.impacts@0.1") == 3.0
    assert _one(quantities, "closed.impacts@2") == 0.0
    assert _one(quantities, "closed.impacts") == 4.0
    resolved = sum(isinstance(event, Impact) for event in quantities.events)
    assert resolved > _one(quantities, "closed.impacts") + _one(quantities, "open.impacts")


def test_the_energy_that_a_hopper_loses_is_the_work_of_its_push() -> None:
    values = zo.load_problem("hopper").values().parameters
    quantities = _quantities("hopper")
    assert _one(quantities, "stop.energy_lost") == pytest.approx(values["a"] * values["s"])
    assert quantities.extent("stop.bounce_time") is None
    assert quantities.extent("stop.zeno_time") is None
    assert "stop.zeno_time" not in quantities.table()


@pytest.mark.parametrize("restitution", [0.0, 0.3])
def test_the_knee_of_a_walker_loses_the_difference_of_its_kinetic_energies(
    restitution: float,
) -> None:
    problem = zo.load_problem("kneed_walker")
    values = problem.values(parameters={"restitution": restitution})
    events = zo.simulate(problem, until=0.6, parameters={"restitution": restitution}).events
    strike = next(k for k, event in enumerate(events) if isinstance(event, SwitchEvent))
    quantities = EventQuantities(
        graph=problem.graph_dynamics(values),
        start=np.array(problem.state_vector(problem.starts[0])),
        period=events[strike].time,
        events=events[: strike + 1],
    )
    impacts = [event for event in quantities.events if isinstance(event, Impact)]
    before, after = (
        problem.inverse_masses(values, np.array([getattr(one, side) for one in impacts]))[1]
        for side in ("state_minus", "state_plus")
    )
    lost = float(np.sum(before - after))
    # The impacts that are not resolved lose a part e^(2n) of the first loss.
    assert lost > 0.01
    assert _one(quantities, "knee.energy_lost") == pytest.approx(lost, rel=1e-6)


@pytest.mark.parametrize("coupling", [0.6, -0.6])
def test_an_impact_beside_a_closed_stop_loses_the_difference_of_the_kinetic_energies(
    coupling: float,
) -> None:
    def corner(_p: Any) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        mass = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v[0] ** 2 + coupling * v[0] * v[1] + v[1] ** 2 / 2,
            potential=5 * q[0] + 2 * q[1],
            stops=(
                zo.Stop(name="side", gap=q[0], restitution=0.4),
                zo.Stop(name="floor", gap=q[1], restitution=0.5),
            ),
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    problem = zo.Problem(
        name="corner",
        title="mass in a corner",
        source="here",
        state_names=("x", "y", "dx", "dy"),
        state_units=("m", "m", "m/s", "m/s"),
        parameters=(),
        gains=(),
        model=corner,
        starts=({"y": 1.0},),
        portraits=(("x", "dx"),),
        amplitude_of="x",
    ).checked()
    execution = zo.simulate(problem, until=1.5)
    first = execution.impacts[0]
    assert first.stop == "floor"
    values = problem.values()
    quantities = EventQuantities(
        graph=problem.graph_dynamics(values),
        start=np.array([0.0, 1.0, 0.0, 0.0]),
        period=first.time,
        events=(first,),
    )
    energies = problem.inverse_masses(values, np.array([first.state_minus, first.state_plus]))[1]
    opens = coupling < 0.0
    assert (first.state_plus[2] > 1e-3) == opens
    lost = float(energies[0] - energies[1])
    assert _one(quantities, "floor.energy_lost") == pytest.approx(lost, rel=1e-12)
    # A floor alone would be struck by another mass.
    alone = (
        (1 - 0.5**2)
        / 2
        * first.approach_rate**2
        / np.linalg.inv([[2, coupling], [coupling, 1]])[1, 1]
    )
    assert (abs(alone - lost) < 1e-9 * lost) == opens


@pytest.mark.parametrize("name", ["R", "restitution", "m", "omega"])
def test_derivatives_along_orbits_are_those_of_differences(name: str) -> None:
    problem = zo.load_problem("relay")
    base = problem.values()
    place = [*base.gains, *base.parameters].index(name)
    step = 1e-5 * base.vector[place]

    def at(change: float) -> tuple[EventQuantities, EventReturn]:
        values = problem.values(parameters={name: base.parameters[name] + change})
        found = _return(problem, values, "zeno closed", (place,))
        graph = problem.graph_dynamics(values)
        return EventQuantities.of(graph, found, (place,)), found

    (here, found), (above, _), (below, _) = at(0.0), at(step), at(-step)
    n_x = len(found.start)
    moved = np.linalg.lstsq(np.eye(n_x) - found.by_state, found.by_parameters, rcond=1e-12)[0]
    for quantity in event_quantity_names(here.graph):
        if quantity.endswith(".impacts"):
            continue
        for one, up, down in zip(
            *(x.readings(quantity) for x in (here, above, below)), strict=True
        ):
            wanted = (up.value - down.value) / (2 * step)
            total = float((one.by[:n_x] @ moved + one.by[n_x:])[0])
            # The differences have errors of 1e-12 of the value, over the step.
            size = max(abs(one.value), 1e-3 * here.period)
            rounding = 1e-6 * size / base.vector[place]
            assert total == pytest.approx(wanted, rel=1e-6, abs=rounding), quantity


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("shut.impact_speed", "shut.impact_speed"),
        ("closed.impact_sped", "Did you mean `closed.impact_speed`"),
        ("closed.impacts@fast", "closed.impacts@fast"),
        ("closed.bounce_time@1", "closed.bounce_time@1"),
        ("z", "`z`"),
    ],
)
def test_unknown_quantities_are_refused(name: str, words: str) -> None:
    graph = _quantities("relay").graph
    with pytest.raises(zo.InputError, match=words):
        require_event_quantity(name, graph, "bounds")
    with pytest.raises(zo.InputError, match=words):
        _quantities("relay").extent(name)


def test_a_certificate_holds_the_quantities() -> None:
    orbit = event_orbit("hopper")
    certificate = zo.verify(orbit)
    assert certificate.quantities["stop.energy_lost"] == pytest.approx((2.0, 2.0))
    assert orbit.certificate["quantities"]["stop.impacts"] == [1.0, 1.0]


@pytest.mark.slow
def test_an_orbit_moves_with_its_values_as_the_difference_of_two_orbits() -> None:
    # The section moves along the clock, and the states have sizes from 1e-5 to 1.
    problem = zo.load_problem("relay_soft")
    gains = {one.name: one.default for one in problem.gains}
    chosen = tuple(problem.names.index(name) for name in gains)
    values = problem.values()
    found = _return(problem, values, "zeno closed", chosen)
    graph, unit = problem.graph_dynamics(values), 1e-8
    moved = inverse_of_closing(graph, found) @ found.by_parameters
    size = largest_states(found.execution.arcs, graph)
    for column, (name, value) in zip(moved.T, gains.items(), strict=True):
        ends = [
            _return(problem, problem.values(gains={name: value + sign * unit}), "zeno closed").start
            for sign in (1.0, -1.0)
        ]
        expected = (ends[0] - ends[1]) / (2 * unit) / size
        # In units of each state over a second; the switching times move the phase by hundreds.
        assert column / size == pytest.approx(expected, rel=1e-5, abs=1e-4)
