"""Machines with several stops, switches and kinks: what a model may declare, and bad input."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from zeno_orbits.model.expressions.kinks import branched

X = ca.SX.sym("x", 2)


def _value(formula: ca.SX, x: Any) -> float:
    return float(ca.Function("f", [X], [formula])(x))


@pytest.mark.parametrize("seed", fast(6, range(20)))
def test_a_branch_is_the_formula_where_its_conditions_have_their_sides(seed: int) -> None:
    random = np.random.default_rng(seed)
    a, b, c = random.uniform(-1, 1, 3)
    formula = (
        ca.fmax(-a * X[0], ca.fmin(b, X[0] * X[1]))
        + ca.fabs(X[1] - c) * ca.sign(X[0] + a)
        + ca.if_else(ca.logic_and(X[0] < b, ca.logic_not(X[1] > a)), X[0], X[1] ** 2)
    )
    for _ in range(20):
        x = random.uniform(-2, 2, 2)
        found = branched([formula], X)
        sides = tuple(_value(condition, x) > 0.0 for condition in found.conditions)
        there = branched([formula], X, sides)
        assert not branched(there.formulas, X).conditions
        assert _value(there.formulas[0], x) == pytest.approx(_value(formula, x), rel=1e-14)
        # The smooth conditions are those of the formula wherever a kink decides.
        for smooth, written in zip(there.smooth, found.conditions, strict=True):
            assert _value(smooth, x) == pytest.approx(_value(written, x), rel=1e-13, abs=1e-15)


def test_conditions_of_parameters_are_no_kinks() -> None:
    p = ca.SX.sym("p")
    assert branched([ca.fmax(p, 2) * X[0]], X).conditions == ()


def test_one_condition_in_two_operations_is_one_kink() -> None:
    assert len(branched([ca.fabs(X[0]), ca.sign(-X[0])], X).conditions) == 1


@pytest.mark.parametrize(
    ("operation", "name"),
    [
        (ca.floor, "`floor`"),
        (ca.ceil, "`ceil`"),
        (lambda x: ca.fmod(x, 2), "`fmod`"),
        (lambda x: ca.remainder(x, 2), "`remainder`"),
        (lambda x: x == 1, "`==`"),
        (lambda x: x != 1, "`!=`"),
        (lambda x: ca.if_else(x, 1, 2), "a number of the states as a condition"),
        (ca.logic_not, "a number of the states as a condition"),
        (lambda x: ca.tanh(1 / x), "`tanh` of a quotient"),
        (lambda x: ca.erf(X[1] / x), "`erf` of a quotient"),
        (lambda x: ca.atan(ca.tan(x)), "`atan` of a quotient"),
        (lambda x: ca.atan(1 + 1 / x), "`atan` of a quotient"),
    ],
)
def test_jumps_without_a_condition_are_refused(operation: Any, name: str) -> None:
    with pytest.raises(ValueError, match="jumps") as caught:
        branched([operation(X[0])], X)
    assert name in str(caught.value)
    # The same operation of parameters alone does not jump.
    p = ca.SX.sym("p")
    assert branched([operation(p) * X[1]], ca.vertcat(X[1])).conditions == ()


@pytest.mark.parametrize(
    "operation",
    [
        lambda x: ca.tanh(x / (1 + X[1] ** 2)),
        lambda x: ca.atan(1 / ca.cosh(x)),
        lambda x: ca.erf(x * ca.exp(X[1])),
        lambda x: ca.atan2(x, 2),
    ],
)
def test_quotients_with_a_positive_denominator_are_smooth(operation: Any) -> None:
    assert branched([operation(X[0])], X).conditions == ()


def _mechanism(**options: Any) -> zo.HybridLagrangian:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    made = {name: value(q, v) if callable(value) else value for name, value in options.items()}
    given: dict[str, Any] = {"gap": q} | made
    kept = {name: value for name, value in given.items() if value is not None}
    return zo.HybridLagrangian.from_energies(q=q, v=v, kinetic=v**2 / 2, potential=9.81 * q, **kept)


def _stops(*gaps: Any) -> Any:
    return lambda q, _: tuple(
        zo.Stop(name=f"stop {k}", gap=gap(q), restitution=0.5) for k, gap in enumerate(gaps)
    )


def _system(mechanism: zo.HybridLagrangian, *restitution: float, **options: Any) -> Any:
    switches = options.pop("switches", None)
    given = switches(mechanism.q, mechanism.v) if callable(switches) else switches
    return zo.hybrid_system(mechanism, zo.no_drive(mechanism), *restitution, switches=given)


@pytest.mark.parametrize("name", ["relay", "clapper", "kneed_walker", "motor_pendulum", "solenoid"])
def test_the_flow_of_a_mode_keeps_the_gaps_of_its_closed_stops(name: str) -> None:
    problem = zo.load_problem(name)
    graph = problem.graph_dynamics(problem.values())
    x = np.array(problem.initial_state())
    n = len(graph.stop_names)

    def accelerations(closed: tuple[int, ...]) -> list[float]:
        """Return the derivative of every gap rate along the flow, by central differences."""
        rate = graph.flow((closed, graph.open_mode[1])).rate(x)
        step = 1e-6 / max(1.0, float(np.max(np.abs(rate))))
        return [
            abs(view.gap_rate(x + step * rate) - view.gap_rate(x - step * rate)) / (2 * step)
            for view in graph.open_views
        ]

    free = accelerations(())
    assert min(free) > 1e-3
    for bits in range(1, 2**n):
        closed = tuple(k for k in range(n) if bits >> k & 1)
        found = accelerations(closed)
        assert max(found[k] / free[k] for k in closed) < 1e-5


def test_gap_and_stops_exclude_each_other() -> None:
    with pytest.raises(ValueError, match="either the argument `gap` or the argument `stops`"):
        _mechanism(stops=_stops(lambda q: q))


def test_a_restitution_belongs_to_one_gap_or_to_each_stop() -> None:
    with pytest.raises(ValueError, match="`restitution` is missing"):
        _system(_mechanism())
    two = _mechanism(gap=None, stops=_stops(lambda q: q, lambda q: 2 - q))
    with pytest.raises(ValueError, match="every stop has its own"):
        _system(two, 0.5)


@pytest.mark.parametrize(
    ("switches", "words"),
    [
        (lambda _, __: (zo.Switch(name="a", guard=ca.SX(1)),), "`a` must depend on the state"),
        (lambda q, _: (zo.Switch(name="a", guard=ca.fabs(q)),), "`a` must be smooth"),
        (
            lambda q, _: (zo.Switch(name="a", guard=q, q_after=ca.vertcat(q, q)),),
            "`q_after` of the switch `a` must have 1 entries, but it has 2",
        ),
        (
            lambda q, _: (zo.Switch(name="a", guard=q, others_after=q),),
            "`others_after` of the switch `a` must have 0 entries",
        ),
        (lambda q, _: 2 * (zo.Switch(name="a", guard=q),), "two are `a`"),
        (lambda q, _: (zo.Switch(name=" ", guard=q),), "it is empty"),
        (lambda q, _: (zo.Switch(name="stop", guard=q),), "two are `stop`"),
        (lambda q, _: (zo.Switch(name="a, b", guard=q),), "single blanks .* it is 'a, b'"),
        (lambda q, _: (zo.Switch(name="x=1", guard=q),), "single blanks .* it is 'x=1'"),
        (lambda q, _: (zo.Switch(name=" a", guard=q),), "single blanks .* it is ' a'"),
        (lambda q, _: (zo.Switch(name="a\x1b[31m", guard=q),), r"single blanks .* it is 'a\\x1b"),
    ],
)
def test_invalid_switches_are_refused(switches: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        _system(_mechanism(), 0.5, switches=switches)


def test_a_gap_with_a_kink_is_refused() -> None:
    bent = _mechanism(gap=lambda q, _: ca.fmin(q, 2 - q))
    with pytest.raises(ValueError, match=r"`gap` must be smooth.*declare two stops"):
        _system(bent, 0.5, switches=())


def test_a_kink_in_the_gap_of_any_stop_is_refused() -> None:
    bent = _mechanism(gap=None, stops=_stops(lambda q: q, lambda q: ca.fmin(2 - q, 4 - q)))
    with pytest.raises(ValueError, match="`gap` must be smooth"):
        _system(bent)


def _problem(model: Any, **changes: Any) -> zo.Problem:
    given: dict[str, Any] = {
        "name": "trial",
        "title": "trial",
        "source": "here",
        "state_names": ("q", "v"),
        "state_units": ("m", "m/s"),
        "parameters": (zo.Quantity.restitution(0.5),),
        "gains": (),
        "model": model,
        "starts": ({"q": 1.0},),
        "portraits": (("q", "v"),),
        "amplitude_of": "q",
    }
    return zo.Problem(**(given | changes))


def test_two_stops_with_one_gap_are_refused() -> None:
    def model(p: Any) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        stops = tuple(zo.Stop(name=n, gap=q, restitution=p["restitution"]) for n in ("a", "b"))
        ball = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=q, stops=stops
        )
        return zo.hybrid_system(ball, zo.no_drive(ball))

    with pytest.raises(zo.InputError, match="`a` and `b` have the same gap"):
        _problem(model).checked()


def test_a_stop_without_a_name_is_named_as_the_fault_though_no_restitution_is_declared() -> None:
    def model(p: Any) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        stops = (zo.Stop(name="", gap=q, restitution=p["e"]),)
        ball = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=q, stops=stops
        )
        return zo.hybrid_system(ball, zo.no_drive(ball))

    own = zo.Quantity(name="e", unit="1", meaning="restitution", default=0.5, lower=0.0, upper=1.0)
    with pytest.raises(ValueError, match="must name the stop or switch, but it is empty"):
        _problem(model, parameters=(own,)).checked()


def _between(p: Any) -> zo.CompletedSystem:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    stops = (
        zo.Stop(name="floor", gap=q, restitution=p["restitution"]),
        zo.Stop(name="ceiling", gap=2 - q, restitution=p["restitution"]),
    )
    ball = zo.HybridLagrangian.from_energies(q=q, v=v, kinetic=v**2 / 2, potential=q, stops=stops)
    return zo.hybrid_system(ball, zo.no_drive(ball))


def test_a_start_beyond_any_stop_is_refused_by_its_name() -> None:
    problem = _problem(_between).checked()
    with pytest.raises(zo.InputError, match="at the stop `ceiling`, but it is -1"):
        zo.simulate(problem, start={"q": 3.0})


def test_a_switch_that_is_armed_where_a_motion_starts_is_refused() -> None:
    def model(p: Any) -> zo.CompletedSystem:
        ball = _mechanism()
        switch = zo.Switch(name="top", guard=ball.v)
        return zo.hybrid_system(ball, zo.no_drive(ball), p["restitution"], switches=(switch,))

    with pytest.raises(zo.SimulationError, match="`top` is armed at its start"):
        zo.simulate(_problem(model), start={"q": 1.0})


def test_a_zeno_condition_of_such_a_problem_is_refused_in_one_line() -> None:
    problem = _problem(_between)
    with pytest.raises(zo.InputError) as caught:
        zo.zeno_condition(problem)
    assert "\n" not in str(caught.value)


def test_a_kink_of_the_state_gives_a_machine_modes_without_switches() -> None:
    def model(p: Any) -> zo.CompletedSystem:
        ball = _mechanism(passive_force=lambda _, v: -0.1 * ca.fabs(v) * v)
        return zo.hybrid_system(ball, zo.no_drive(ball), p["restitution"])

    def of_parameters(p: Any) -> zo.CompletedSystem:
        ball = _mechanism(passive_force=lambda _, v: -ca.fmax(p["restitution"], 0.1) * v)
        return zo.hybrid_system(ball, zo.no_drive(ball), p["restitution"])

    assert _problem(model).checked().has_graph
    assert not _problem(of_parameters).checked().has_graph
