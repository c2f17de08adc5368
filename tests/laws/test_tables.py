"""Tables in formulas: their values, motions through their knots, derivatives, cost and refusals.

A mass under a piecewise linear force moves from knot to knot in closed form. A cubic spline through
the values of a cubic polynomial is that polynomial, so a machine with the table is the machine with
the polynomial. The flow of a mass with damping `c` shrinks every area by ``exp(-c t)``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest
from mpmath import mp, mpf

import zeno_orbits as zo
from tests.loop.agreement import needs_compiler
from tests.reference.through_cells import through_cells
from tests.support.same_bits import agreed
from tests.support.tabled import Formula, mass, wavy
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.integrators import RungeKutta
from zeno_orbits.orbits import event_return
from zeno_orbits.simulation import (
    SimulationSettings,
    SwitchEvent,
)

EXACT = 1e-12
LOCATED = 1e-10
"""Of times and states: a hundred times the tolerance of the integrator."""
KINDS = ("linear", "cubic", "monotone")


def value_of(formula: ca.SX, *symbols: ca.SX) -> Callable[..., float]:
    """Return a formula as a function of numbers."""
    function: Any = ca.Function("value", list(symbols), [formula])
    return lambda *numbers: float(function(*numbers))


# Values.


def spline_by_hand(knots: Sequence[float], values: Sequence[float], x: float) -> mpf:
    """Return a not-a-knot spline from its second derivatives, in 60 digits."""
    with mp.workdps(60):
        k, f = [mpf(float(one)) for one in knots], [mpf(float(one)) for one in values]
        n, h = len(k), [mpf(float(b)) - mpf(float(a)) for a, b in pairwise(knots)]
        rows, right = mp.matrix(n, n), mp.matrix(n, 1)
        for i in range(1, n - 1):
            rows[i, i - 1], rows[i, i], rows[i, i + 1] = h[i - 1], 2 * (h[i - 1] + h[i]), h[i]
            right[i] = 6 * ((f[i + 1] - f[i]) / h[i] - (f[i] - f[i - 1]) / h[i - 1])
        rows[0, 0], rows[0, 1], rows[0, 2] = h[1], -(h[0] + h[1]), h[0]
        rows[n - 1, n - 3], rows[n - 1, n - 2], rows[n - 1, n - 1] = h[-1], -(h[-2] + h[-1]), h[-2]
        m = mp.lu_solve(rows, right)
        i = max(j for j in range(n - 1) if k[j] <= x)
        a, b = k[i + 1] - x, x - k[i]
        return (
            (m[i] * a**3 + m[i + 1] * b**3) / (6 * h[i])
            + (f[i] / h[i] - m[i] * h[i] / 6) * a
            + (f[i + 1] / h[i] - m[i + 1] * h[i] / 6) * b
        )


def monotone_by_hand(knots: np.ndarray, values: np.ndarray, x: float) -> float:
    """Return the cubic with the harmonic means of Fritsch and Butland as inner slopes."""
    h, d = np.diff(knots), np.diff(values) / np.diff(knots)
    slopes = np.zeros(len(knots))
    for i in range(1, len(knots) - 1):
        if d[i - 1] * d[i] > 0.0:
            w, u = 2 * h[i] + h[i - 1], h[i] + 2 * h[i - 1]
            slopes[i] = (w + u) / (w / d[i - 1] + u / d[i])
    i = int(np.searchsorted(knots, x, side="right")) - 1
    assert 0 < i < len(h) - 1
    t = (x - knots[i]) / h[i]
    return float(
        (1 + 2 * t) * (1 - t) ** 2 * values[i]
        + t * (1 - t) ** 2 * h[i] * slopes[i]
        + t**2 * (3 - 2 * t) * values[i + 1]
        + t**2 * (t - 1) * h[i] * slopes[i + 1]
    )


def test_a_table_has_the_values_of_its_kind() -> None:
    rng = np.random.default_rng(3)
    knots, values = np.cumsum(rng.uniform(0.1, 1.0, 9)), rng.normal(size=9)
    x = ca.SX.sym("x")
    found = {kind: value_of(zo.table(x, knots, values, kind), x) for kind in KINDS}
    for at in rng.uniform(knots[1], knots[-2], 40):
        assert found["linear"](at) == pytest.approx(np.interp(at, knots, values), abs=1e-15)
        assert found["cubic"](at) == pytest.approx(
            float(spline_by_hand(knots.tolist(), values.tolist(), at)), abs=1e-14
        )
        wanted = monotone_by_hand(knots, values, at)
        assert found["monotone"](at) == pytest.approx(wanted, abs=1e-15)
    for kind in KINDS:
        ends = [found[kind](at) for at in knots]
        assert ends == pytest.approx(values.tolist(), abs=1e-14)


@pytest.mark.slow
def test_a_table_of_two_arguments_is_a_table_in_each() -> None:
    rng = np.random.default_rng(4)
    first, second = np.cumsum(rng.uniform(0.1, 1, 7)), np.cumsum(rng.uniform(0.1, 1, 5))
    values = rng.normal(size=(7, 5))
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    for kind in ("linear", "cubic"):
        both = value_of(zo.table((x, y), (first, second), values, kind), x, y)
        for a, b in rng.uniform((first[0], second[0]), (first[-1], second[-1]), (20, 2)):
            rows = [value_of(zo.table(x, first, column, kind), x)(a) for column in values.T]
            wanted = value_of(zo.table(y, second, rows, kind), y)(b)
            assert both(a, b) == pytest.approx(wanted, abs=1e-13)


def test_knots_and_values_may_hold_parameters() -> None:
    x, p = ca.SX.sym("x"), ca.SX.sym("p", 2)
    places, heights = (0.0, 0.3, 1.0, 1.4), (1.0, -2.0, 0.5, 3.0)
    knots = [p[1] + p[0] * k for k in places]
    for kind in ("linear", "cubic"):
        formula = zo.table(x, knots, [p[0] * heights[0], *heights[1:]], kind)
        found: Any = ca.Function("f", [x, p], [formula, ca.jacobian(formula, p)])
        plain = value_of(zo.table(x, places, heights, kind), x)
        for at in (0.1, 0.7, 1.2):
            assert float(found(0.2 + at, [1.0, 0.2])[0]) == pytest.approx(plain(at), abs=1e-14)

            def moved(size: float, shift: float, at: float = at, f: Any = found) -> float:
                return float(f(0.2 + at, [size, shift])[0])

            h = 1e-6
            wanted = [
                (moved(1 + h, 0.2) - moved(1 - h, 0.2)) / (2 * h),
                (moved(1, 0.2 + h) - moved(1, 0.2 - h)) / (2 * h),
            ]
            assert found(0.2 + at, [1.0, 0.2])[1].full().ravel() == pytest.approx(wanted, abs=1e-8)


def test_an_interpolant_of_casadi_is_a_table() -> None:
    grid, other = [0.0, 1.0, 2.0, 3.5, 5.0, 6.0], [0.0, 0.5, 1.0, 2.0, 3.0]
    x = ca.SX.sym("x", 2)
    rng = np.random.default_rng(0)
    for kind in ("linear", "bspline"):
        for axes, given in (([grid], x[0]), ([grid, other], x)):
            n = math.prod(map(len, axes))
            made: Any = ca.interpolant("measured", kind, axes, np.sin(np.arange(n) ** 2.0))
            force = made(given)
            problem = mass(lambda q, v, f=force: ca.substitute(f, x, ca.vertcat(q, v)))
            system = problem.model(problem.symbols())
            flow: Any = ca.Function("f", [system.state], [system.mechanism.passive_force])
            for at in rng.uniform(0.1, 2.9, (20, 2)):
                wanted = float(made(at[: len(axes)]))
                assert float(flow(at)) == pytest.approx(wanted, abs=1e-13)
    solid: Any = ca.interpolant("solid", "linear", [other] * 3, np.zeros(125))
    with pytest.raises(ValueError, match=r"calls the table `solid`, whose knots are unknown here"):
        mass(lambda q, v: solid(ca.vertcat(q, v, q))).checked()


# Motions.


@pytest.mark.parametrize("n", [3, 7, 200])
def test_a_mass_under_a_piecewise_linear_force_has_its_closed_form(n: int) -> None:
    knots, forces = wavy(n)
    problem = mass(lambda x, _: zo.table(x, knots, forces, outside="extend"))
    wanted = through_cells(knots.tolist(), forces.tolist(), 2.0, 1.5, 0.5)
    run = zo.simulate(problem, until=1.5)
    assert run.end_state == pytest.approx([float(one) for one in wanted.end], abs=EXACT)
    assert [one.time for one in run.impacts] == pytest.approx(
        [float(one) for one in wanted.impacts], abs=EXACT
    )
    assert [one.time for one in run.switches] == pytest.approx(
        [float(one) for one in wanted.knots], abs=EXACT
    )
    # One kink, whatever the number of knots.
    assert {one.name for one in run.switches} == {"kink 1"}


@pytest.mark.slow
def test_a_knot_on_the_stop_changes_nothing_above_it() -> None:
    knots, forces = np.array([-1.0, 0.0, 1.0, 3.0]), np.array([5.0, -4.0, -5.0, -9.0])
    on_stop = mass(lambda x, _: zo.table(x, knots, forces, outside="extend"))
    # Without the knot at zero the same line goes on below the stop.
    below = mass(lambda x, _: zo.table(x, [-1.0, 1.0, 3.0], [-3.0, -5.0, -9.0], outside="extend"))
    one, other = (zo.simulate(each, until=4.0) for each in (on_stop, below))
    assert [each.time for each in one.impacts] == pytest.approx(
        [each.time for each in other.impacts], abs=LOCATED
    )
    assert one.zeno_points[0].time == pytest.approx(other.zeno_points[0].time, abs=LOCATED)


MACHINES: dict[str, Formula] = {
    **{
        kind: lambda x, _, kind=kind: zo.table(x, *wavy(9), kind, outside="extend")
        for kind in KINDS
    },
    "held": lambda x, _: zo.table(x, *wavy(6, 0.3, 1.5), outside="hold"),
    "held cubic": lambda x, _: zo.table(x, *wavy(6, 0.3, 1.5), "cubic", outside="hold"),
    "of two": lambda x, v: (
        zo.table((x, v), ([-1, 1, 3], [-9, -1, 1, 9]), np.arange(12.0).reshape(3, 4) / 5) - 9
    ),
}


@needs_compiler
@pytest.mark.parametrize("name", MACHINES)
def test_loop_and_reference_agree_in_every_bit(name: str) -> None:
    problem = mass(MACHINES[name])
    run = agreed(problem, 1.5, SimulationSettings(engine=RungeKutta()))
    assert run.impacts
    assert any(isinstance(one, SwitchEvent) for one in run.events) == (name != "cubic")


def cubic(x: ca.SX) -> ca.SX:
    """Return a cubic polynomial."""
    return 0.3 - 0.4 * x + 0.25 * x**2 - 0.06 * x**3


PLACES = np.linspace(-3.0, 4.0, 9)
HEIGHTS = np.array([float(cubic(ca.SX(one))) for one in PLACES])


def spline(x: ca.SX) -> ca.SX:
    """Return the table of the polynomial, which is the polynomial."""
    return zo.table(x, PLACES, HEIGHTS, "cubic", outside="extend")


@pytest.mark.parametrize("part", ["gap", "coenergy", "resistance and source"])
def test_a_machine_with_the_table_of_a_polynomial_is_that_with_the_polynomial(part: str) -> None:
    def machine(curve: Callable[[ca.SX], ca.SX]) -> zo.Problem:
        def model(p: Any) -> zo.CompletedSystem:
            q, v, current = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("i")
            gap = q + 0.2 * curve(q) if part == "gap" else q
            bend = curve(q) if part == "coenergy" else 1 + 0.1 * q
            ohm, volt = (curve(current), curve(v)) if part.startswith("res") else (2.0, 3.0)
            one = zo.HybridLagrangian.from_energies(
                q=q, v=v, kinetic=v**2 / 2, potential=9.81 * q, gap=gap
            )
            circuit = zo.Circuit(
                currents=current,
                coenergy=(1 + bend) * current**2 / 2,
                resistance=3 + ohm,
                source=ca.SX(volt),
            )
            return zo.hybrid_system(one, zo.circuit_drive(one, circuit), p["restitution"])

        return zo.Problem(
            name="magnet",
            title="mass in a magnet",
            source="tests/laws/test_tables.py",
            state_names=("q", "v", "i"),
            state_units=("m", "m/s", "A"),
            parameters=(zo.Quantity.restitution(0.6),),
            gains=(),
            model=model,
            starts=({"q": 1.0},),
            portraits=(("q", "v"),),
            amplitude_of="q",
        )

    found, wanted = (zo.simulate(machine(one), until=1.2) for one in (spline, cubic))
    assert found.impacts
    assert found.end_state == pytest.approx(wanted.end_state, abs=LOCATED)
    times = [[one.time for one in run.impacts] for run in (found, wanted)]
    assert times[0] == pytest.approx(times[1], abs=LOCATED)


def test_derivatives_through_knots_are_differences_and_shrink_areas() -> None:
    damping, h = 0.3, 1e-6
    for kind in KINDS:
        problem = mass(
            lambda x, _, kind=kind: zo.table(x, *wavy(9), kind, outside="extend"),
            damping=damping,
        )
        found = event_return(
            problem.graph_dynamics(problem.values()),
            np.array([0.0, 2.0]),
            section="impact stop",
            n_returns=1,
            guess=1.0,
            settings=zo.SimulationSettings(),
        )

        def after(speed: float, problem: zo.Problem = problem) -> float:
            run = zo.simulate(problem, until=1.5, start={"x": 0.0, "v": speed})
            return float(run.impacts[0].state_plus[1])

        wanted = (after(2.0 + h) - after(2.0 - h)) / (2 * h)
        noise = 1e-5 if kind == "cubic" else 1e-8
        assert found.by_state[1, 1] == pytest.approx(wanted, abs=noise)
        # An area (speed, time) shrinks by the damping and by the restitution at both ends.
        ratio = 0.5**2 * math.exp(-damping * found.period) * 2.0 / found.end[1]
        assert found.by_state[1, 1] == pytest.approx(ratio, rel=1e-8)


@pytest.mark.parametrize("first", ["linear", "cubic"])
def test_tables_on_equal_knots_keep_their_own_kind_and_name(first: str) -> None:
    knots = (np.linspace(-1.1, 3.0, 7), np.linspace(-9.0, 9.0, 5))
    values = -6.0 - np.add.outer(knots[0], 0.05 * knots[1])
    for kind in (first, "cubic" if first == "linear" else "linear"):
        problem = mass(
            lambda x, v, kind=kind: zo.table((x, v), knots, values, kind, outside="extend")
        )
        # The plane is the same to both kinds: knots of the linear table alone are events.
        assert bool(zo.simulate(problem, until=1.0).switches) == (kind == "linear")
    for name in ("left", "right"):
        problem = mass(lambda x, _, name=name: zo.table(x, [1.5, 2.5], [-1, -1], name=name))
        with pytest.raises(SimulationError, match=f"the table `{name}`"):
            zo.simulate(problem, until=5.0)


# Refusals.


@pytest.mark.parametrize("kind", ["linear", "cubic"])
def test_a_motion_that_leaves_a_table_ends_or_goes_on_as_declared(kind: str) -> None:
    knots, forces = wavy(9, 0.5)
    refused, held, extended = (
        mass(lambda x, _, o=outside: zo.table(x, knots, forces, kind, outside=o, name="spring"))
        for outside in ("refuse", "hold", "extend")
    )
    words = r"argument of the table `spring` is beyond its knots from 0.5 to 3"
    with pytest.raises(SimulationError, match=words) as error:
        zo.simulate(refused, until=1.5)
    first = next(
        one.time for one in zo.simulate(held, until=1.5).events if one.state_minus[0] < 0.51
    )
    assert error.value.time == pytest.approx(first, abs=1e-6)
    # Held, the force stays at its value at 0.5 below it.
    at, speed = zo.simulate(held, until=first).end_state
    fall = zo.simulate(held, until=1.5).impacts[0]
    assert fall.approach_rate**2 == pytest.approx(speed**2 - 2 * forces[0] * at, rel=1e-10)
    assert zo.simulate(extended, until=1.5).impacts[0].approach_rate != fall.approach_rate


X = ca.SX.sym("x")
WRONG: dict[str, tuple[tuple[Any, ...], dict[str, str], str]] = {
    "equal knots": (([0, 1, 1], [1, 2, 3]), {}, r"`knots` .* entry 2 \(1\) equals entry 1"),
    "unsorted knots": (([0, 2, 1], [1, 2, 3]), {}, r"entry 2 \(1\) is below entry 1 \(2\)"),
    "NaN": (([0, 1], [1, math.nan]), {}, r"`values` must hold finite numbers, but entry \[1\]"),
    "infinite knot": (([0, math.inf], [1, 2]), {}, r"`knots` must hold finite numbers"),
    "too many values": (([0, 1], [1, 2, 3]), {}, "there are 2 knots and 3 values"),
    "text": (([0, 1], ["a", 2]), {}, "`values` must hold numbers"),
    "one knot": (([0], [1]), {}, "at least 2 numbers"),
    "few knots": (([0, 1, 2], [1, 2, 3], "cubic"), {}, "at least 4 numbers"),
    "unknown kind": (([0, 1], [1, 2], "quadratic"), {}, "one of 'linear', 'cubic', 'monotone'"),
    "unknown end": (([0, 1], [1, 2]), {"outside": "clamp"}, "one of 'refuse', 'hold', 'extend'"),
    "no list": ((5, [1, 2]), {}, "`knots` must hold numbers"),
    "loose knots": (([0, X, 1], [1, 2, 3]), {}, "all knots move and stretch together"),
    "slopes": (([0, 1], [1e308, -1e308]), {}, "slopes are beyond the range of a double"),
    "spline": (([0, 1, 2, 3], [1e308, -1e308, 0, 1], "cubic"), {}, "slopes are beyond the range"),
    "far knots": (([0, 1e200], [1, 2]), {}, r"`knots` of a table must be below 1e\+150"),
    "sizes": (([0, 1], [1e-300, 1e300]), {}, "must be of comparable sizes"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_table_is_refused_in_one_line(name: str) -> None:
    given, options, words = WRONG[name]
    with pytest.raises((ValueError, InputError), match=words) as error:
        zo.table(X, *given, **options)
    assert "\n" not in str(error.value)


def test_masked_samples_are_no_numbers() -> None:
    masked = np.ma.array([0.0, 1.0, 2.0], mask=[0, 1, 0])
    for knots, values in (([0, 1, 2], masked), (masked, [0, 1, 2])):
        with pytest.raises(ValueError, match="are masked"):
            zo.table(X, knots, values)


def test_a_table_of_two_arguments_refuses_what_does_not_fit() -> None:
    for given, words in (
        (([0, 1, 2], [1, 2, 3]), "`knots` must be a pair"),
        ((([0, 1], [0, 1]), [1, 2]), "must have 2 dimension"),
        ((([0, 1], [1, 0]), [[1, 2], [1, 2]]), r"`knots\[1\]` of a table must increase"),
        ((([0, 1], [0, 1]), [[1, 2, 3], [1, 2, 3]]), "along argument 2"),
        ((([0, 1], [0, 1]), [[1, 2], [1, 2]], "monotone"), "'linear' or 'cubic'"),
    ):
        with pytest.raises(ValueError, match=words):
            zo.table((X, X), *given)


def test_messages_of_tables_in_a_model_name_the_table_and_no_start() -> None:
    knots = ([1.5, 2.5], [-9.0, 9.0])
    outside = mass(lambda x, v: zo.table((x, v), knots, [[-1, -1], [-1, -1]], name="spring"))
    with pytest.raises(SimulationError, match=r"[^f] argument 1 of the table `spring` is beyond"):
        zo.simulate(outside, until=5.0)
    made = ca.interpolant("lut", "linear", [[-9.0, 9.0]], [1.0, 2.0], {"inline": True})
    with pytest.raises(InputError, match=r"`lut` takes no `casadi.SX`: .* without .* `inline`"):
        zo.simulate(mass(lambda x, _: made(x)), until=5.0)
    with pytest.raises(InputError) as error:
        zo.simulate(mass(lambda x, _: x * zo.record([0, 1], [1, 2]).frequency), until=5.0)
    assert "start" not in str(error.value)


@pytest.mark.slow
def test_a_kinked_table_is_no_gap_and_a_table_is_not_proved() -> None:
    with pytest.raises(ValueError, match="`gap` must be smooth"):
        mass(lambda x, _: -x, gap=lambda x, _: x + zo.table(x, [-1, 0.5, 3], [0, 0.1, 0])).checked()
    orbit = zo.find_orbit("measured_valve").unwrap()
    with pytest.raises(InputError, match="looks up the table `area`"):
        zo.prove(orbit)


def test_the_measured_valve_with_no_share_of_its_table_is_the_relief_valve() -> None:
    found = zo.find_orbit("measured_valve", parameters={"share": 0.0}).unwrap()
    assert found.period == pytest.approx(2.432309875742, abs=1e-11)
    assert zo.find_orbit("measured_valve").unwrap().certificate["passed"]
