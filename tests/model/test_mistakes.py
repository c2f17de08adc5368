"""Mistakes of a first problem file: one line that names the file, its line and the remedy."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import pytest

import zeno_orbits as zo
from tests.support.commands import MISUSE, ask
from zeno_orbits.model import load_problem

FILE = """\
import math
import casadi as ca
import numpy as np
import zeno_orbits as zo

def model(p):
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    force = -v
    mass = zo.HybridLagrangian.from_energies(
        q=q, v=v, kinetic=p["m"] * v**2 / 2, potential=p["g"] * q, gap=q, passive_force=force
    )
    return zo.hybrid_system(mass, zo.no_drive(mass), p["restitution"])

PROBLEM = zo.Problem(
    name="ball", title="ball", source="own",
    state_names=("q", "v"),
    state_units=("m", "m/s"),
    parameters=(
        zo.Quantity.positive("m", 1.0, "kg", "mass"),
        zo.Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        zo.Quantity.restitution(0.5),
    ),
    gains=(), model=model,
    starts=({"q": 1.0},),
    portraits=(("q", "v"),), amplitude_of="q",
)
"""
"""The file without a mistake."""

GAIN = 'zo.Quantity(name="k", unit="1", meaning="k", default=9.0, '
"""The beginning of a gain."""


@pytest.mark.parametrize(
    ("right", "wrong", "line", "said"),
    [
        ("= -v", "= -math.sin(q)", 8, "Write `ca.sin(q)`"),
        ("= -v", "= -v * float(q)", 8, "Write `ca.sin(q)`, or the symbol"),
        ('p["g"] * q, gap', 'p["g"] * q + math.sin(q), gap', 10, "Write `ca.sin(q)`"),
        ("= -v", "= -v * np.linalg.inv(np.zeros((2, 2)))[0, 0]", 8, ": Singular matrix."),
        ("= -v", "= -np.ones(2).reshape(3)", 8, ": cannot reshape array of size 2 into shape (3,)"),
        ("= -v", "= -(np.ones(2) + np.ones(3))", 8, ": operands could not be broadcast together"),
        ("= -v", "= -v * np.ones(2)[2]", 8, ": IndexError: index 2 is out of bounds for axis 0"),
        ("model=model", "model=model(None)", 23, "`model` must be a function of the gains"),
        ("model=model", "model=model({})", 23, "`model` must be a function of the gains"),
        ('p["g"]', 'p["gg"]', 10, "but it uses `gg`. Did you mean `g`?"),
        ('({"q": 1.0},)', '({"q": 1.0})', 24, "For one entry, write `starts=(...,)`"),
        ('(("q", "v"),)', '("q", "v")', 25, "write `portraits=(...,)`, with a comma"),
        ('"m/s^2"', '"m*rad/s^2"', 20, "`m*rad` in `m*rad/s^2` is not a unit: write `m rad/s^2`"),
        ('"m/s^2"', '"meter^2"', 20, "`meter^2` is not a unit: write `m^2`."),
        ('Quantity.positive("g", 9', 'Quantity("g", 9', 20, "`Quantity` takes named arguments"),
        ("v**2 / 2", 'ca.SX.sym("v") ** 2 / 2', 10, "`kinetic` must use the symbol `v` of `v`"),
        ("= -v", "= -v * zo.Clock.at(0).sine", 8, "`frequency` must be positive, but it is 0."),
        ("= -v", '= -v * zo.Clock.at(p["g"]).sine', 8, "holds the symbol `sine`"),
        ('kinetic=p["m"]', 'kinetic=-p["m"]', 10, "mass matrix must be positive definite"),
        ("gap=q", "gap=ca.vertcat(q, q)", 10, "Argument `gap` must be one formula"),
        ("= -v", "= -ca.mtimes(ca.SX(2, 2), ca.SX(3, 1))", 8, "formulas whose shapes do not fit"),
        ('("m", "m/s")', '("m",)', 17, "Argument `state_units` must be one for every state"),
        ('("m", "m/s")', '("m", "Meter")', 17, "`Meter` is not a unit"),
        ('amplitude_of="q"', 'amplitude_of="p"', 25, "`amplitude_of` must name states"),
        ('name="ball"', "name=3", 15, "Argument `name` must be a text"),
        ('"m", 1.0', '"m", -1.0', 19, "must be greater than 0"),
        ("= -v", "= -1 if q > 0 else 1", 8, "Write `ca.if_else(q > 0, a, b)`"),
        ("= -v", "= -max(v, 0)", 8, "`ca.fmax` for `max`"),
        ("= -v", '= -v * p("g")', 8, 'a mapping is called. Write square brackets, as in `p["m"]`'),
        ("= -v", "= -v * open('k').read()", 8, "the file `k` is missing. Write `Path(__file__)"),
        ('title="ball"', 'title="ball', 15, "Close the quotation mark"),
        ('"m", 1.0,', 'name="m", default=1,0,', 19, "write a decimal point, as in `1.5`"),
        ('"m/s^2"', '"mH"', 20, "`mH` is not a unit: convert the value to `H`."),
        ('"m/s^2"', '"m/s**2"', 20, "`s**2` in `m/s**2` is not a unit: write `m/s^2`, with"),
        ("= -v", "= -v()", 8, "a formula or number is called (`'SX' object is not callable`)"),
        ("= -v", "= -v * (q > 0 and v)", 8, "`ca.logic_and` for `and`"),
        ("= -v", "= -c * v", 8, "the name `c` is not defined. Define or import it, or write"),
        ("= -v", "= -p.c * v", 8, 'a mapping lacks the attribute `c`. Write `p["c"]`'),
        ("= -v", "= -ca.SX.sym('c') * v", 8, "the passive force holds the symbol `c`, which is"),
        ("= -v", "= -v * ca.floor(q)", 8, "a formula holds `floor` of the states, which jumps"),
        ("= -v", "= -v * (q == 1)", 8, "a formula holds `==` of the states, which jumps"),
        ("= -v", '= -p["c"] * v', 8, "must use declared gains and parameters, but it uses `c`"),
        ("= -v", "= -v * np.sin", 8, "unsupported operand type(s) for *: 'SX' and"),
        ('ca.SX.sym("q")', 'ca.MX.sym("q")', 10, "Write `ca.SX.sym` for every symbol"),
        (', p["restitution"])', ")", 12, "Argument `restitution` is missing"),
        (
            *('potential=p["g"] * q', 'potential=p["g"] * q * v', 10),
            "`potential` must depend on the configuration only, but it depends on the velocity. "
            "Remove `v`.",
        ),
        ("v**2 / 2", "v**3 / 2", 10, "must be quadratic in the velocity, as `m * v**2 / 2`"),
        ("gap=q", "gap=1.0", 10, "but it is constant. Write it with `q`."),
        (
            *("passive_force=force", "passive_force=ca.vertcat(force, 0)", 10),
            "`passive_force` must have 1 entries, one per coordinate, but it has 2",
        ),
        (
            "passive_force=force",
            "friction=force",
            9,
            "take the argument `friction`. Remove it. Known:",
        ),
        (
            *("gap=q", 'stops=(zo.Stop(name="a", gap=q, restitution=0.5),)', 12),
            "must be left out of `hybrid_system`: every stop has its own",
        ),
        ("hybrid_system", "hybrid_sytem", 12, "Did you mean `hybrid_system`?"),
        ("from_energies", "from_energy", 9, "Did you mean `from_energies`?"),
        (
            'title="ball"',
            'titel="ball"',
            14,
            "take the argument `titel`. Did you mean `title`?",
        ),
        ("model=model,", "", 14, "`Problem` lacks the argument `model`. Write `model=...`"),
        (
            "PROBLEM =",
            "problem =",
            None,
            "`PROBLEM` of type `Problem`. Write `PROBLEM = zo.Problem(...)`",
        ),
        ('p["restitution"])', 'p["restitution"]', 12, "was never closed. Add the closing bracket"),
        ("    force", "   force", 8, "Indent the line like its neighbours"),
        ("        zo.Quantity.restitution(0.5),", "", 12, "Add `Quantity.restitution(0.5)`"),
        (
            "restitution(0.5)",
            "restitution(1.5)",
            21,
            "`restitution` must lie in [0, 1], but it is 1.5",
        ),
        ('positive("g"', 'positive("m"', 20, "but `m` appears twice"),
        ('"m", 1.0, "kg"', '"mm", 1.0, "kg"', 10, "but it uses `m`"),
        (
            *("gains=()", f"gains=({GAIN}lower=0.0),)", 23),
            "must have a default and a finite range for `k`: `default=`, `lower=` and `upper=`",
        ),
        (
            *("gains=()", f"gains=({GAIN}lower=0.0, upper=2.0),)", 23),
            "must have the default of `k` in its range [0, 2], but it is 9. Change the default or",
        ),
        (
            *("gains=()", f"gains=({GAIN}lower=0.0, upper=20.0),)", 23),
            "`gains` must appear in the model or an output, but `k` appears nowhere. Use it, or",
        ),
        (
            '("q", "v"),\n    state_units',
            '("q",),\n    state_units',
            17,
            "has 1 name and `state_units` has 2 units",
        ),
        ('{"q": 1.0}', '{"x": 1.0}', 24, "`starts` must name states (q, v), but it names `x`"),
        ('{"q": 1.0}', '{"q": "1"}', 24, "`starts`: the value of `q` must be a number, but"),
        ('({"q": 1.0},)', '{"q": 1.0}', 24, "`starts` must be a sequence with each entry a map"),
        ('(("q", "v"),)', '(("q", "w"),)', 25, "`portraits` must name states (q, v), but it"),
        ('"m/s^2"', '"Ns/m"', 20, "`Ns` in `Ns/m` is not a unit: write `N s`"),
        ("    return zo", "    zo", 23, "must return the system of `hybrid_system`"),
        ('name="ball", title', 'name="ball" title', 15, "Perhaps you forgot a comma"),
        ('"m/s^2"', '"N/metre"', 20, "`metre` in `N/metre` is not a unit: write `m`"),
        ('"m/s^2"', '"Newton"', 20, "`Newton` is not a unit: write `N`"),
        ('"m/s^2"', '"furlong"', 20, "Known units are kg, m, s"),
        ('("m", "m/s")', '("mm", "mm/s")', 20, "Write both in one of them"),
        ('{"q": 1.0}', '{"q": -1.0}', 24, "Change the start, or the sign of the gap"),
        ("gap=q", "gap=-q", 24, "Change the start, or the sign of the gap"),
        ("= -v", "= -sqrt(v)", 8, "the name `sqrt` is not defined. Write `ca.sqrt`."),
        ("= -v", "= -nq.sin(v)", 8, 'or write `p["nq"]` for a declared parameter.'),
        ("import numpy as np", "PI = np.pi", 3, "`np` is not defined. Add `import numpy as np`."),
        ("= -v", "= -hybrid_system", 8, "is not defined. Write `zo.hybrid_system`."),
        ("= -v", "= -round(v)", 8, "a formula holds `round` of the states, which jumps"),
        ("= -v", "= -int(v)", 8, "such as `int(q)` or `range(q)`. Write the symbol."),
        ("v**2", "v^2", 10, "Write `**` for a power."),
        ('"m", 1.0, "kg"', '"m", 1,0, "kg"', 19, "`Quantity.positive` takes at most 4 values"),
        ('{"q": 1.0}', '{"qq": 1.0}', 24, "but it names `qq`. Did you mean `q`?"),
        ('amplitude_of="q"', 'amplitude_of="qq"', 25, "but it names `qq`. Did you mean `q`?"),
        ("= -v", "= -v + 1j", 8, "Write numbers and `ca.SX` symbols on both sides."),
        (
            *("model(p):", "model():", 23),
            "`model` must take one argument, the gains and parameters by name, but it takes `()`. "
            "Write `def model(p):`.",
        ),
        ("model(p):", "model(p, q):", 23, "but it takes `(p, q)`. Write `def model(p):`."),
        ("    return zo", "    zo", 23, "returns nothing. Write `return zo.hybrid_system(...)`."),
        (
            *("zo.no_drive(mass)", "None", 12),
            "but it holds None. Without a drive, write `zo.no_drive(mechanism)`.",
        ),
        ('source="own",', "", 14, "lacks the argument `source`. Write `source=...`."),
        (
            *('starts=({"q": 1.0},)', "gain=()", 14),
            "`Problem` does not take the argument `gain`. Did you mean `gains`? Known: name, title",
        ),
        (
            'title="ball", source="own",',
            "",
            14,
            "`Problem` lacks the arguments `title`, `source`. Write `title=...`.",
        ),
        ("import numpy", "import no_such_module", 3, "No module named 'no_such_module'"),
    ],
)
def test_a_mistake_is_one_line_with_its_place_and_remedy(
    right: str, wrong: str, line: int | None, said: str, tmp_path: Path
) -> None:
    assert FILE.count(right) == 1
    file = tmp_path / "ball.py"
    file.write_text(FILE.replace(right, wrong), encoding="utf-8")
    answer = ask("simulate", file, "--until", "1")
    assert answer.code == MISUSE
    assert answer.err.count("\n") == 1
    place = f"`{file}`" if line is None else f"`{file}`, line {line}"
    assert f"{place}: " in answer.err
    assert said in answer.err
    assert "?." not in answer.err


@pytest.mark.parametrize(
    ("right", "wrong", "line", "formula", "why"),
    [
        ("= -v", "= -v * ca.sqrt(q - 2)", 8, "the passive force", "`sqrt` of -1"),
        ("= -v", "= -v / (q - 1)", 8, "the passive force", "divides 0 by 0"),
        ("= -v", "= -ca.acos(q + 1)", 8, "the passive force", "`acos` of 2"),
        ('p["g"] * q, gap', 'p["g"] * ca.log(q - 1), gap', 10, "the potential", "`log` of 0"),
        (
            *('p["g"] * q, gap', 'p["g"] * ca.sqrt(q - 1), gap', 10),
            *("the derivative of the potential", "divides 9.81 by 0"),
        ),
        (
            *('kinetic=p["m"]', 'kinetic=p["m"] * ca.log(q - 2)', 10),
            *("the mass matrix", "`log` of -1"),
        ),
        ("gap=q", "gap=ca.sqrt(q - 2)", 10, "the gap", "`sqrt` of -1"),
        (
            *(
                "gap=q",
                'stops=(zo.Stop(name="a", gap=q, restitution=0.5), '
                'zo.Stop(name="lid", gap=ca.sqrt(q - 3), restitution=0.5))',
                10,
            ),
            *("the gap of the stop `lid`", "`sqrt` of -2"),
        ),
    ],
)
def test_a_formula_that_leaves_its_domain_is_named_with_its_values(
    right: str, wrong: str, line: int, formula: str, why: str, tmp_path: Path
) -> None:
    assert FILE.count(right) == 1
    file = tmp_path / "ball.py"
    text = FILE.replace(right, wrong)
    if "stops=" in wrong:
        text = text.replace(', p["restitution"])', ")")
        text = text.replace("        zo.Quantity.restitution(0.5),\n", "")
    file.write_text(text, encoding="utf-8")
    answer = ask("simulate", file, "--until", "1")
    assert answer.code == MISUSE
    assert answer.err.count("\n") == 1
    assert f"`{file}`, line {line}: {formula} is not finite at start 1 (" in answer.err
    assert "q = 1" in answer.err
    assert why in answer.err
    assert "Change the formula, a value or the start: keep the " in answer.err
    for internal in ("free_flow", "normal_inertia", "gap_acceleration", "Argument"):
        assert internal not in answer.err


@pytest.mark.slow
def test_functions_of_numpy_take_symbols_without_a_warning(tmp_path: Path) -> None:
    file = tmp_path / "ball.py"
    file.write_text(FILE.replace("= -v", "= -np.sin(v) + np.cos(v) - np.cos(v)"), encoding="utf-8")
    words = [sys.executable, "-m", "zeno_orbits", "simulate", str(file), "--until", "1"]
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == ""


@pytest.mark.slow
def test_a_motion_that_slides_is_refused_with_a_formula_that_does_not(tmp_path: Path) -> None:
    file = tmp_path / "belt.py"
    text = FILE.replace('p["g"] * q', 'p["g"] * q**2 / 2').replace("gap=q", "gap=q + 3")
    for friction, code in (("ca.sign(v)", 1), ("ca.tanh(v / 1e-3)", 0)):
        file.write_text(text.replace("= -v", f"= -3 * {friction}"), encoding="utf-8")
        answer = ask("simulate", file, "--until", "20")
        assert answer.code == code
        told = 'the part `zo.DryFriction("NAME", rate=v, torque=3)` in place of the force `-3 * '
        assert (told in answer.err) == bool(code)


def test_a_file_of_another_encoding_is_named_with_the_remedy(tmp_path: Path) -> None:
    path = tmp_path / "ball.py"
    path.write_bytes(FILE.replace('title="ball"', 'title="b\u00e4ll"').encode("latin-1"))
    answer = ask("simulate", path, "--until", "1")
    assert answer.code == MISUSE
    assert "a character is not UTF-8. Save the file as UTF-8." in answer.err


def test_the_file_without_a_mistake_is_accepted(tmp_path: Path) -> None:
    file = tmp_path / "ball.py"
    file.write_text(FILE, encoding="utf-8")
    assert ask("simulate", file, "--until", "1").code == 0


def test_a_file_that_changes_the_folder_is_loaded_in_the_folder_of_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("ball.py").write_text(f"import os\nos.chdir('/')\n{FILE}", encoding="utf-8")
    answer = ask("simulate", "ball.py", "--until", "1", "-o", "ball.csv")
    assert answer.code == 0
    assert Path("ball.csv").exists()
    assert Path.cwd() == tmp_path


def test_a_negative_inductance_is_named_with_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ask("new", "flap", "--with-motor")
    text = Path("flap.py").read_text()
    for wrong, said in (
        ('inductance=-p["L"]', "Argument `inductance` must be positive"),
        ('inductance=p["L"], selection=ca.SX.ones(2, 1)', "`selection` must have 1 row"),
    ):
        given = text.replace("        selection=ca.SX(1),", "") if "selection" in wrong else text
        Path("flap.py").write_text(given.replace('inductance=p["L"]', wrong))
        line = given[: given.index("inductance=")].count("\n") + 1
        answer = ask("simulate", "flap.py")
        assert answer.code == MISUSE
        assert f"`flap.py`, line {line}: " in answer.err
        assert said in answer.err


def test_an_error_of_a_derivation_names_the_file_and_the_line(tmp_path: Path) -> None:
    """At the defaults the derivation is sound."""
    derive = "def derive(p):\n    return {} if p['m'] < 2 else np.linalg.inv(np.zeros((2, 2)))\n\n"
    text = FILE.replace("PROBLEM =", derive + "PROBLEM =").replace(
        "gains=()", "gains=(), derive=derive"
    )
    file = tmp_path / "derived.py"
    file.write_text(text)
    assert ask("simulate", file, "--until", "0.1").code == 0
    answer = ask("simulate", file, "--until", "0.1", "--set", "m=3")
    assert answer.code == MISUSE
    assert answer.err.count("\n") == 1
    assert "`derive` raises LinAlgError: Singular matrix, derived.py, line 15)" in answer.err


def _asks(p: Mapping[str, object]) -> object:
    return p["absent"]


def test_a_completed_system_with_replaced_formulas_is_refused() -> None:
    # Its modes are made from the mechanism and the drive, which lack the new formula.
    known = zo.load_problem("vibrating_table")

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        system = known.model(p)
        return replace(system, free_flow=system.free_flow * 2)

    with pytest.raises(zo.InputError, match="as it is, but formulas of it are replaced"):
        zo.find_orbit_by_shooting(replace(known, name="changed", model=model))


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (print, "must return the system of `hybrid_system`, but it returns nothing"),
        (len, "must return the system of `hybrid_system`, but it returns a `int`"),
        (isinstance, "must take one argument"),
        (_asks, "must use declared gains and parameters, but it uses `absent`"),
    ],
)
def test_a_wrong_model_of_a_problem_in_python_is_named(
    model: Callable[..., Any], said: str
) -> None:
    names: Any = {"state_names": ("q", "v"), "state_units": ("m", "m/s")}
    problem = zo.Problem(
        **names,
        name="wrong",
        title="wrong",
        source="tests",
        parameters=(zo.Quantity.restitution(0.5),),
        gains=(),
        model=model,
        starts=({"q": 1.0},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )
    with pytest.raises(zo.InputError, match=f"Argument `model` {said}"):
        zo.simulate(problem, until=1.0)


def test_a_system_in_place_of_a_model_is_named() -> None:
    """As ``model=model(None)`` gives one, if the model uses no parameter."""
    system: Any = load_problem("bouncing_ball").model(load_problem("bouncing_ball").symbols())
    with pytest.raises(zo.InputError, match="Argument `model` must be a function, but it is"):
        replace(load_problem("bouncing_ball"), model=system)
