"""Broken problems: every mistake is one line that names the thing at fault, and no traceback."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import chdir, redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

import casadi as ca
import numpy as np
import pytest

from tests.support.cases import fast
from tests.support.units import Units, in_units
from zeno_orbits import (
    Clock,
    HybridLagrangian,
    MotorBank,
    Problem,
    Quantity,
    hybrid_system,
    no_drive,
)
from zeno_orbits.cli import main
from zeno_orbits.errors import ProblemFileError
from zeno_orbits.model import CompletedSystem, bundled_problems, load_problem, powers_of


def _new(*flags: str) -> str:
    """Return the file that `zeno-orbits new` writes for a problem called NAME."""
    with TemporaryDirectory() as folder, chdir(folder), redirect_stdout(StringIO()):
        assert main(["new", "NAME", *flags]) == 0
        return Path("NAME.py").read_text()


FORCED, MOTOR = _new(), _new("--with-motor")

# Name: template, what is replaced, by what, and the words that have to name it.
BROKEN: dict[str, tuple[str, str, str, str]] = {
    "gap of the velocity": (
        *(FORCED, "gap=q,", "gap=q + 0.1 * v,"),
        "`gap` must depend on the configuration only",
    ),
    "gap that is constant": (
        *(FORCED, "gap=q,", "gap=ca.SX(1),"),
        "`gap` must depend on the configuration, but it is constant",
    ),
    "gap that moves with time": (
        *(FORCED, "gap=q,", "gap=q + clock.sine,"),
        "`gap` must not depend on the clock",
    ),
    "gap flat at the start": (
        *(FORCED, "gap=q,", "gap=q**2,"),
        "gap must change with the configuration at start 1, but its derivative is 0",
    ),
    "no mass": (
        *(FORCED, 'p["m"] * v**2 / 2', "0 * v**2"),
        "`kinetic` must give every coordinate an inertia.*coordinate 1",
    ),
    "negative mass": (
        *(FORCED, 'p["m"] * v**2 / 2', '-p["m"] * v**2 / 2'),
        "mass matrix must be positive definite.*negative definite. Check the signs",
    ),
    "mass that changes its sign": (
        *(MOTOR, 'p["J"] * v**2 / 2', 'p["J"] * (0.5 - q) * v**2 / 2'),
        "mass matrix must be positive definite.*angle = ",
    ),
    "kinetic energy that is not quadratic": (
        *(FORCED, 'p["m"] * v**2 / 2', 'p["m"] * v**4'),
        "`kinetic` must be quadratic",
    ),
    "potential of the velocity": (
        *(FORCED, '(q + p["pressed"]) ** 2 / 2', "v**2"),
        "`potential` must depend on the configuration only",
    ),
    "motor that turns nothing": (
        *(MOTOR, "selection=ca.SX(1)", "selection=ca.SX(0)"),
        "`selection` must let every motor turn a joint, but motor 1 turns none",
    ),
    "motor of a wrong shape": (
        *(MOTOR, 'resistance=p["R"]', "resistance=ca.SX.eye(2)"),
        r"`resistance` must be of shape \(1, 1\)",
    ),
    "gain that appears nowhere": (
        *(MOTOR, ' - p["Kp"] * q', ""),
        "`gains` must appear.*`Kp` appears nowhere",
    ),
    "parameter that appears nowhere": (
        *(FORCED, '-p["c"] * v', "0 * v"),
        "`parameters` must appear.*`c` appears nowhere",
    ),
    "parameter that is not declared": (
        *(FORCED, 'p["k"] *', 'p["stiffness"] *'),
        "must use declared gains and parameters, but it uses `stiffness`",
    ),
    "symbol that is no parameter": (
        *(FORCED, 'p["F"] *', 'ca.SX.sym("wind") *'),
        "the applied force holds the symbol `wind`.* declare `wind` in `parameters`",
    ),
    "unit that is none": (
        *(FORCED, '"N s/m"', '"Ns/m"'),
        "`unit` must be one for `c`, but `Ns` in `Ns/m` is not a unit",
    ),
    "unit with two slashes": (
        *(FORCED, '"N s/m"', '"N/m/s"'),
        "`unit` must be one for `c`, but `N/m/s` is not a unit",
    ),
    "velocity in the unit of the position": (
        *(FORCED, '("m", "m/s", "1", "1")', '("m", "m", "1", "1")'),
        "`state_units` must give `dx` the unit of `x` per second",
    ),
    "too few units": (
        *(FORCED, '("m", "m/s", "1", "1")', '("m", "m/s")'),
        "`state_names` has 4 names and `state_units` has 2 units",
    ),
    "too few states": (
        *(MOTOR, '"angle", "rate", "current")', '"angle", "rate")'),
        "`state_names` has 2 names and `state_units` has 3 units",
    ),
    "states that the model has not": (
        *(MOTOR, "full_drive(mechanism, motor)", "no_drive(mechanism)"),
        "name `no_drive` is not defined. Write `zo.no_drive`",
    ),
    "current that the model has not": (
        *(MOTOR, "full_drive", "quasi_static_drive"),
        "`state_names` must name the model's 2 states .* names 3: angle, rate, current",
    ),
    "start beyond the stop": (
        *(MOTOR, '{"angle": 0.0}', '{"angle": -0.1}'),
        "Start 1 must have a gap >= 0, but it is -0.1",
    ),
    "start off the clock": (
        *(FORCED, '{"cosine": 1.0}', '{"x": 1.0}'),
        'have `cosine` and `sine` on the unit circle.*Add its phase, such as `"cosine": 1.0`',
    ),
    "start of an unknown state": (
        *(FORCED, '{"cosine": 1.0}', '{"theta": 1.0}'),
        "`starts` must name states .* it names `theta`",
    ),
    "start that is not finite": (
        *(MOTOR, '{"angle": 0.0}', '{"angle": float("nan")}'),
        "`angle` must be a finite number",
    ),
    "no start": (
        *(MOTOR, '({"angle": 0.0},)', "()"),
        "`starts` must hold a state to start from",
    ),
    "box the wrong way round": (
        *(MOTOR, "lower=6.0, upper=20.0", "lower=20.0, upper=6.0"),
        "`lower` must have a range with lower < upper for `Kp`, but it is 20:6",
    ),
    "box without an end": (
        *(MOTOR, "lower=6.0, upper=20.0", "lower=6.0"),
        "`gains` must have a default and a finite range for `Kp`",
    ),
    "formula that is not finite at the start": (
        *(FORCED, 'p["k"] * (q + p["pressed"]) ** 2 / 2', 'p["k"] * p["pressed"] * ca.log(q)'),
        r"the potential is not finite at start 1 \(q = 0\): `log\(q\)` is `log` of 0",
    ),
    "no restitution": (
        *(FORCED, "        Quantity.restitution(0.5),  # of the stop, in [0, 1]\n", ""),
        "must use declared gains and parameters, but it uses `restitution`",
    ),
    "restitution above one": (
        *(FORCED, "Quantity.restitution(0.5)", "Quantity.restitution(1.5)"),
        r"`restitution` must lie in \[0, 1\], but it is 1.5",
    ),
    "restitution in a range of its own": (
        FORCED,
        "Quantity.restitution(0.5),",
        'Quantity(name="restitution", unit="1", meaning="", default=0.5),',
        "must hold `restitution` in .*its range is different",
    ),
    "default outside its range": (
        *(FORCED, "default=1.0, lower=0.0", "default=-1.0, lower=0.0"),
        "`c` must be at least 0, but it is -1",
    ),
    "name that is there twice": (
        *(FORCED, 'Quantity.positive("omega"', 'Quantity.positive("k"'),
        "but `k` appears twice",
    ),
    "state with the name of a parameter": (
        *(FORCED, '("x", "dx", "cosine"', '("k", "dx", "cosine"'),
        "but `k` appears twice",
    ),
    "name that cannot be typed": (
        *(FORCED, 'Quantity.positive("m"', 'Quantity.positive("the mass"'),
        "`name` must begin with a letter .* but it is `the mass`",
    ),
    "portrait of an unknown state": (
        *(FORCED, '(("x", "dx"),)', '(("x", "y"),)'),
        "`portraits` must name states .* it names `y`",
    ),
    "amplitude of an unknown state": (
        *(FORCED, 'amplitude_of="x"', 'amplitude_of="y"'),
        "`amplitude_of` must name states .* it names `y`",
    ),
    "friction with an entry too many": (
        *(FORCED, '-p["c"] * v', 'ca.vertcat(-p["c"] * v, 0)'),
        "`passive_force` must have 1 entries",
    ),
    "mechanism that is not completed": (
        FORCED,
        'hybrid_system(mechanism, no_drive(mechanism), p["restitution"])',
        "mechanism",
        "`model` must return the system of `hybrid_system`, but it returns a `Hybrid",
    ),
    "no problem": (*(FORCED, "PROBLEM =", "SCENE ="), "it lacks a `PROBLEM`"),
    "no Python": (*(FORCED, "def model(p):", "def model(p)"), "line 9: expected"),
}


def test_there_are_enough_of_them() -> None:
    assert len(BROKEN) >= 25


@pytest.mark.parametrize("fault", BROKEN)
def test_a_broken_problem_is_refused_in_one_line_that_names_the_fault(
    fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    template, old, broken, words = BROKEN[fault]
    assert old in template, fault
    file = tmp_path / "broken.py"
    text = template.replace("NAME", "broken").replace(old, broken, 1)
    if "quasi_static_drive" in broken:
        text = text.replace("import MotorBank, quasi_static_drive", "import MotorBank, full_drive")
        text = text.replace("full_drive\n", "full_drive, quasi_static_drive\n", 1)
        text = text.replace("full_drive(mechanism", "quasi_static_drive(mechanism")
    file.write_text(text)
    assert main(["zeno-condition", str(file)]) == 2
    shown = capsys.readouterr()
    lines = shown.err.strip().splitlines()
    assert len(lines) == 1, shown.err
    assert re.search(words, lines[0]), lines[0]
    assert str(file) in lines[0]
    assert not shown.out


def test_the_traceback_is_there_for_those_who_ask(tmp_path: Path) -> None:
    file = tmp_path / "broken.py"
    file.write_text(FORCED.replace("gap=q,", "gap=v,"))
    with pytest.raises(ValueError, match="`gap` must depend on the configuration") as caught:
        main(["zeno-condition", str(file), "--debug"])
    assert isinstance(caught.value.__cause__, ValueError)


@pytest.mark.slow
@pytest.mark.parametrize("flags", fast(1, [[], ["--with-motor"], ["--with-circuit"]]))
def test_a_new_problem_works_as_it_is_written(
    flags: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mine", *flags]) == 0
    written = Path("mine.py").read_text()
    assert len(written.splitlines()) < 60
    assert main(["new", "mine", *flags]) == 2
    assert "`mine.py` exists" in capsys.readouterr().err
    assert Path("mine.py").read_text() == written
    assert main(["zeno-condition", "./mine.py"]) == 0
    assert main(["simulate", "./mine.py", "--until", "2"]) == 0
    assert main(["search", "./mine.py", "-o", "orbit.json"]) == 0
    assert main(["verify", "orbit.json", "--problem", "mine.py"]) == 0


@pytest.mark.parametrize("name", ["my-problem", "a/b", "2nd"])
def test_a_new_problem_needs_a_name_that_is_a_word(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["new", name]) == 2
    assert "must begin with a letter" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["", "metre", "m/", "m//s", "m^x", "kg*m", "m^2.5"])
def test_what_is_no_unit_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is not a unit"):
        powers_of(text)


# The same verdict in any units.

UNITS = [
    Units(length=length, time=time)
    for length in (1e-6, 1e-3, 1.0, 1e3, 1e6)
    for time in (1e-6, 1.0)
]
REACH = (9.81 + 0.015 * 30**2) / 30**2
"""How far the ball of the table goes while the clock turns by a radian: all of a / omega^2 [m]."""


@pytest.mark.parametrize("units", UNITS, ids=str)
def test_a_start_is_beyond_the_stop_by_a_part_of_how_far_the_problem_goes(units: Units) -> None:
    table = load_problem("vibrating_table")

    def start(part: float) -> Problem:
        return in_units(replace(table, starts=({"height": -part * REACH, "cosine": 1.0},)), units)

    assert start(0.9e-9).checked()
    with pytest.raises(ValueError, match="Start 1 must have a gap >= 0"):
        start(1.1e-9).checked()


@pytest.mark.parametrize("units", UNITS, ids=str)
def test_a_mass_that_vanishes_nearby_is_found(units: Units) -> None:
    def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        body = HybridLagrangian.from_energies(
            q=q, v=v, kinetic=p["m"] * (1 - q / p["far"]) * v**2 / 2, potential=p["k"] * q, gap=q
        )
        return hybrid_system(body, no_drive(body), p["restitution"])

    problem = Problem(
        name="thinning",
        title="",
        source="",
        state_names=("x", "dx"),
        state_units=("m", "m/s"),
        parameters=(
            Quantity.positive("m", 2.0, "kg", ""),
            Quantity.positive("far", 0.02, "m", ""),
            Quantity.positive("k", 3.0, "N", ""),
            Quantity.restitution(0.5),
        ),
        gains=(),
        model=model,
        starts=({"x": 0.014},),
        portraits=(("x", "dx"),),
        amplitude_of="x",
    )
    with pytest.raises(ValueError, match=r"at the admissible state .* it is negative definite"):
        in_units(problem, units).checked()
    # From a tenth of the way it goes no farther than twice as far.
    assert in_units(replace(problem, starts=({"x": 0.002},)), units).checked()


@pytest.mark.parametrize("name", ["motor_cart", "curved_surface"])
@pytest.mark.parametrize("length", [1e-6, 1e6])
def test_masses_beside_moments_of_inertia_are_no_singular_matrix(name: str, length: float) -> None:
    assert in_units(load_problem(name), Units(length=length)).checked()


# Matrices in place of energies.


def _links() -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
    """Return a double pendulum by its matrices: q, v, M, C, N."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    a, b, c, d, e = 0.025, 0.003, 0.003, 0.4, 0.15
    coupling = b + c * ca.cos(q[1])
    mass = ca.blockcat([[a + b + 2 * c * ca.cos(q[1]), coupling], [coupling, b]])
    turn = c * ca.sin(q[1])
    coriolis = ca.blockcat([[-turn * v[1], -turn * (v[0] + v[1])], [turn * v[0], 0]])
    both = e * ca.sin(q[0] + q[1])
    return q, v, mass, coriolis, ca.vertcat(d * ca.sin(q[0]) + both, both)


def test_matrices_give_the_equations_that_their_energies_give() -> None:
    q, v, mass, coriolis, gravity = _links()
    potential = -0.4 * ca.cos(q[0]) - 0.15 * ca.cos(q[0] + q[1])
    by_matrices = HybridLagrangian.from_matrices(
        q=q, v=v, mass_matrix=mass, coriolis=coriolis, gravity=gravity, gap=q[1]
    )
    by_energies = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=ca.dot(v, ca.mtimes(mass, v)) / 2,
        potential=potential,
        gap=q[1],
    )
    difference = ca.Function("d", [q, v], [by_matrices.bias - by_energies.bias])
    for place in ([0.3, 0.4, -1.0, 2.0], [-2.0, 1.3, 0.7, 0.2]):
        # Of terms of about 1.
        assert float(ca.norm_inf(difference(place[:2], place[2:]))) < 1e-14
    # Without a potential all of N is a force whose work is a loss; with it nothing is left.
    known = HybridLagrangian.from_matrices(
        q=q,
        v=v,
        mass_matrix=mass,
        coriolis=coriolis,
        gravity=gravity,
        gap=q[1],
        potential=potential,
    )
    left = ca.Function("f", [q], [known.passive_force, by_matrices.passive_force + gravity])
    for force in left([0.3, 0.4]):
        assert float(ca.norm_inf(force)) < 1e-15


def test_matrices_keep_an_applied_force_and_its_clock() -> None:
    q, v, mass, coriolis, gravity = _links()
    clock = Clock.at(ca.SX(3.0))
    pushed = ca.vertcat(2.0 * clock.cosine, -0.5)
    given = {"q": q, "v": v, "gap": q[1], "coriolis": coriolis, "gravity": gravity}
    forced = HybridLagrangian.from_matrices(
        mass_matrix=mass, applied_force=pushed, clock=clock, **given
    )
    free = HybridLagrangian.from_matrices(mass_matrix=mass, **given)
    systems = [hybrid_system(one, no_drive(one), ca.SX(0.5)) for one in (forced, free)]
    states = [one.state for one in systems]
    accelerations = [one.free_flow[2:4] for one in systems]
    look = ca.Function("a", [states[0]], [*accelerations, systems[0].input_power, mass])
    x = [0.3, 0.4, -1.0, 2.0, 0.6, 0.8]
    with_force, without, power, inertia = (one.full() for one in look(x))
    # M a = F + what there is without it; the power of F is F v.
    assert inertia @ (with_force - without) == pytest.approx(np.array([[1.2], [-0.5]]), abs=1e-12)
    assert float(power[0, 0]) == pytest.approx(1.2 * -1.0 - 0.5 * 2.0, abs=1e-14)


def test_matrices_that_do_not_go_together_are_refused_by_name() -> None:
    q, v, mass, coriolis, gravity = _links()
    given = {"mass_matrix": mass, "coriolis": coriolis, "gravity": gravity}

    def refused(words: str, **changes: ca.SX) -> None:
        with pytest.raises(ValueError, match=words):
            HybridLagrangian.from_matrices(q=q, v=v, gap=q[1], **{**given, **changes})

    refused("`coriolis` is not consistent with the mass matrix", coriolis=2 * coriolis)
    refused("`coriolis` must be of shape", coriolis=ca.SX(1))
    refused("`gravity` must have 2 entries", gravity=ca.SX(1))
    lopsided = mass + ca.blockcat([[0, 0.1], [0, 0]])
    refused("`mass_matrix` is not symmetric", mass_matrix=lopsided)
    refused("`mass_matrix` must depend on the configuration", mass_matrix=mass * (1 + v[0]))
    refused(
        "`mass_matrix` must give every coordinate an inertia", mass_matrix=ca.diag(ca.SX([1, 0]))
    )


@pytest.mark.parametrize("factor", [-1.0, 1.0 + 1e-6, 0.0])
def test_a_potential_that_is_not_that_of_the_force_at_rest_is_refused(factor: float) -> None:
    q, v, mass, coriolis, gravity = _links()
    potential = -0.4 * ca.cos(q[0]) - 0.15 * ca.cos(q[0] + q[1])
    friction = 0.1 * v + ca.vertcat(0.2 * ca.tanh(5 * v[0]), 0)

    def build(factor: float) -> HybridLagrangian:
        return HybridLagrangian.from_matrices(
            q=q,
            v=v,
            mass_matrix=mass,
            coriolis=coriolis,
            gravity=gravity + friction,
            gap=q[1],
            potential=factor * potential,
        )

    with pytest.raises(ValueError, match=r"`potential` must have the gradient .* differs by "):
        build(factor)
    # Friction vanishes at rest, so it is no part of a potential.
    assert build(1.0).passive_force.shape == (2, 1)


def test_a_problem_with_a_false_potential_is_refused_when_it_is_loaded(tmp_path: Path) -> None:
    file = tmp_path / "ball.py"
    text = (bundled_problems()["bouncing_ball"]).read_text()
    energies = "HybridLagrangian.from_energies("
    assert energies in text
    matrices = (
        "HybridLagrangian.from_matrices(mass_matrix=ca.SX(p['m']), coriolis=ca.SX(1, 1), "
        "gravity=p['m'] * p['g'], "
    )
    kinetic = re.search(r"kinetic=.*\n", text)
    assert kinetic is not None
    text = text.replace(energies, matrices).replace(kinetic[0], "")
    file.write_text(text)
    assert load_problem(file).values().numbers
    file.write_text(re.sub(r"potential=", "potential=-", text))
    with pytest.raises(ProblemFileError, match=r"`potential` must .* differs by .*"):
        load_problem(file)


def test_the_second_of_two_motors_is_named_if_it_turns_nothing() -> None:
    two = ca.SX.eye(2)
    with pytest.raises(ValueError, match="motor 2 turns none"):
        MotorBank(
            selection=ca.SX([[1, 0], [0, 0]]),
            resistance=two,
            inductance=two,
            torque_constant=two,
            emf_constant=two,
            voltage=ca.SX(2, 1),
        )
