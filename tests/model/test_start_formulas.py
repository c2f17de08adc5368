"""Starts that are formulas of gains and parameters, and starts that changed parameters forbid.

Truth: first impacts in closed form, and periods that the clock fixes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.commands import ask

FILE = """
import casadi as ca
import zeno_orbits as zo

def model(p):
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    clock = zo.Clock.at(p["w"])
    mass = zo.HybridLagrangian.from_energies(
        q=q, v=v, kinetic=v**2 / 2, potential=q**2 / 2, passive_force=-0.2 * v,
        applied_force=clock.cosine, clock=clock,
        stops=(
            zo.Stop(name="low", gap=q + p["d"], restitution=p["e"]),
            zo.Stop(name="high", gap=p["d"] - q, restitution=p["e"]),
        ),
    )
    return zo.hybrid_system(mass, zo.no_drive(mass))

PROBLEM = zo.Problem(
    name="between", title="mass between stops", source="test",
    state_names=("q", "v", "cosine", "sine"), state_units=("m", "m/s", "1", "1"),
    parameters=(
        zo.Quantity.positive("w", 1.0, "rad/s", "frequency"),
        zo.Quantity.positive("d", 1.0, "m", "half of the play"),
        zo.Quantity(name="e", unit="1", meaning="restitution", default=0.6, lower=0.0, upper=0.9),
    ),
    gains=(), model=model, starts=STARTS, portraits=(("q", "v"),), amplitude_of="q",
)
"""
FORMULA = '({"q": lambda p: p["d"], "cosine": 1.0},)'
CONSTANT = '({"q": 1.0, "cosine": 1.0},)'


def between(folder: Path, starts: str) -> str:
    """Return the file of a mass between stops, with given starts."""
    file = folder / "between.py"
    file.write_text(FILE.replace("STARTS", starts), encoding="utf-8")
    return str(file)


def _thrown(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    ball = zo.HybridLagrangian.from_energies(
        q=q, v=v, kinetic=p["m"] * v**2 / 2, potential=p["m"] * p["g"] * q, gap=q - p["floor"]
    )
    return zo.hybrid_system(ball, zo.no_drive(ball), p["restitution"])


def _under_a_roof(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    ball = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=p["m"] * v**2 / 2,
        potential=p["m"] * p["g"] * q,
        stops=(
            zo.Stop(name="floor", gap=q - p["floor"], restitution=p["restitution"]),
            zo.Stop(name="roof", gap=40.0 - q, restitution=p["restitution"]),
        ),
    )
    return zo.hybrid_system(ball, zo.no_drive(ball))


def thrown(model: Any, start: Mapping[str, float | Callable[[Mapping[str, float]], float]]) -> Any:
    """Return a thrown ball with a start."""
    positive = zo.Quantity.positive
    return zo.Problem(
        name="thrown",
        title="thrown ball",
        source="test",
        state_names=("q", "v"),
        state_units=("m", "m/s"),
        parameters=(
            positive("m", 2.0, "kg", "mass"),
            positive("g", 9.81, "m/s^2", "gravity"),
            zo.Quantity(name="floor", unit="m", meaning="floor", default=0.0),
            zo.Quantity.restitution(0.5),
        ),
        gains=(),
        model=model,
        starts=(start,),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )


def _fall(height: float, speed: float, g: float) -> float:
    return (speed + math.sqrt(speed**2 + 2 * g * height)) / g


STARTS: list[tuple[Any, Callable[[float, float], float]]] = [
    ({"q": lambda p: p["floor"] + 2.0}, lambda g, _: _fall(2.0, 0.0, g)),
    ({"q": lambda p: 10 / p["g"]}, lambda g, floor: _fall(10 / g - floor, 0.0, g)),
    ({"q": lambda p: p["floor"], "v": lambda p: p["m"]}, lambda g, _: _fall(0.0, 2.0, g)),
    ({"q": 3, "v": lambda p: -math.sqrt(p["g"])}, lambda g, floor: _fall(3 - floor, -(g**0.5), g)),
    ({"q": lambda p: float(ca.fmax(p["floor"], 0.5) + 1)}, lambda g, f: _fall(1.5 - f, 0.0, g)),
    ({"q": lambda p: max(p.values())}, lambda g, floor: _fall(max(g, 2.0) - floor, 0.0, g)),
]


@pytest.mark.parametrize("model", [_thrown, _under_a_roof])
@pytest.mark.parametrize(("start", "truth"), STARTS)
@pytest.mark.parametrize(("g", "floor"), fast(1, [(1.62, 0.25), (25.0, -0.5)]))
def test_a_start_follows_the_parameters_of_its_formulas(
    model: Any, start: Any, truth: Callable[[float, float], float], g: float, floor: float
) -> None:
    problem = thrown(model, start).checked()
    found = zo.simulate(problem, until=6.0, parameters={"g": g, "floor": floor})
    assert found.impacts[0].time == pytest.approx(truth(g, floor), rel=1e-12)


@pytest.mark.slow
def test_every_command_takes_a_start_that_is_a_formula(tmp_path: Path) -> None:
    """The period is a turn of the clock. A start inside of the stop would be refused."""
    file = between(tmp_path, FORMULA)
    for d in (0.4, 1.0, 1.3):
        orbit = zo.search_gains(file, parameters={"d": d}).orbit
        assert orbit is not None
        assert orbit.period == pytest.approx(2 * math.pi, rel=1e-12)
    plane = zo.parameter_map(file, x=("d", 0.4, 1.3, 2), y=("e", 0.5, 0.6, 2))
    assert [one.period for one in plane.attractors] == pytest.approx([2 * math.pi] * 4, rel=1e-10)
    answer = ask("simulate", file, "--set", "d=0.4", "--until", "3")
    assert answer.code == 0, answer.err
    assert zo.simulate(file, until=1.0, parameters={"d": 0.4}).arcs[0].start_state[0] == 0.4


def test_the_bundled_relay_starts_at_its_open_stop() -> None:
    for d in (6e-4, 1.2e-3):
        first = zo.simulate("relay", until=1e-3, parameters={"d": d}).arcs[0]
        assert first.start_state[0] == d
        assert first.closed == ("open",)


REMEDIES = ("pass a start (`start`)", "declare it as a formula of parameters")


@pytest.mark.parametrize("command", ["search", "simulate", "rig"])
def test_a_start_that_a_parameter_forbids_is_named_with_both_remedies(
    command: str, tmp_path: Path
) -> None:
    answer = ask(command, between(tmp_path, CONSTANT), "--set", "d=0.6")
    assert answer.code == 2
    told = answer.err.splitlines()[-1]
    assert "The declared start (q=1, cosine=1) must have a gap >= 0 at the stop `high`" in told
    assert "-0.4" in told
    for remedy in REMEDIES:
        assert remedy in told.replace("Pass", "pass")


@pytest.mark.slow
def test_a_search_skips_a_start_that_a_parameter_forbids(tmp_path: Path) -> None:
    file = between(tmp_path, '({"q": 1.0, "cosine": 1.0}, {"cosine": 1.0})')
    orbit = zo.search_gains(file, parameters={"d": 0.6}).orbit
    assert orbit is not None
    assert orbit.period == pytest.approx(2 * math.pi, rel=1e-12)
    with pytest.raises(zo.InputError, match="The declared start"):
        zo.simulate(file, until=1.0, parameters={"d": 0.6})


def test_a_start_with_one_stop_is_named_as_well() -> None:
    problem = thrown(_thrown, {"q": 1.0})
    with pytest.raises(zo.InputError, match=r"The declared start \(q=1\).*-1, at these.*`start`"):
        zo.simulate(problem, until=1.0, parameters={"floor": 2.0})
    with pytest.raises(zo.InputError, match="The declared start"):
        zo.find_orbit(problem, parameters={"floor": 2.0})
    fallen = zo.simulate(problem, until=1.0, parameters={"floor": 2.0}, start={"q": 2.1})
    assert fallen.impacts[0].time == pytest.approx(math.sqrt(0.2 / 9.81), rel=1e-12)


def test_a_formula_that_fails_at_changed_values_asks_for_a_start() -> None:
    problem = thrown(_thrown, {"q": lambda p: math.sqrt(p["floor"])}).checked()
    with pytest.raises(zo.InputError, match=r"`q`.*raises ValueError.*`start`"):
        zo.simulate(problem, until=1.0, parameters={"floor": -1.0})
    assert zo.simulate(problem, until=1.0, parameters={"floor": -1.0}, start={"q": 0.0}).impacts


WRONG = {
    "a text": ('"a"', "must be a number"),
    "a text of a formula": ('lambda p: "a"', "the formula of `q` must return a finite number"),
    "NaN": ("lambda p: float('nan')", "must return a finite number, but it returns nan"),
    "infinity": ("lambda p: 1e400", "must return a finite number, but it returns inf"),
    "another name": (
        'lambda p: p["D"]',
        "asks for `D`, which is not a gain or parameter (w, d, e)",
    ),
    "an error": ("lambda p: 1 / 0", "but it raises ZeroDivisionError: division by zero"),
    "an error of two lines": ('lambda p: int("a\\nb")', "but it raises ValueError"),
    "no argument": ("lambda: 1.0", "but it raises TypeError"),
    "nothing": ("lambda p: None", "must return a finite number, but it returns `None`"),
    "a symbol": ('lambda p: ca.SX.sym("x")', "must return a finite number"),
    "inside of the second stop": ('lambda p: 2 * p["d"]', "Start 1 must have a gap >= 0 at the"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_start_is_refused_on_one_line_when_the_file_is_loaded(
    case: str, tmp_path: Path
) -> None:
    value, reason = WRONG[case]
    answer = ask("simulate", between(tmp_path, f'({{"q": {value}, "cosine": 1.0}},)'))
    assert answer.code == 2
    assert len(answer.err.strip().splitlines()) == 1
    assert reason in answer.err


@pytest.mark.parametrize("starts", [(), {"q": 1.0}, (3.0,), (lambda p: p,), ({"z": 1.0},)])
def test_starts_of_another_kind_are_refused(starts: Any) -> None:
    with pytest.raises(zo.InputError, match="Argument `starts` must"):
        replace(thrown(_thrown, {"q": 1.0}), starts=starts)
