"""Mistakes of a first problem file: one line that names the file, its line and the remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.commands import MISUSE, ask

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


@pytest.mark.parametrize(
    ("right", "wrong", "line", "said"),
    [
        ("= -v", "= -math.sin(q)", 8, "Write `ca.sin(q)`"),
        ("= -v", "= -v * float(q)", 8, "Write `ca.sin(q)`, or the symbol"),
        ('p["g"] * q, gap', 'p["g"] * q + math.sin(q), gap', 10, "Write `ca.sin(q)`"),
        ('kinetic=p["m"]', 'kinetic=-p["m"]', 10, "mass matrix must be positive definite"),
        ("gap=q", "gap=ca.vertcat(q, q)", 10, "Argument `gap` must be one formula"),
        ("= -v", "= -ca.mtimes(ca.SX(2, 2), ca.SX(3, 1))", 8, "formulas whose shapes do not fit"),
        ('("m", "m/s")', '("m",)', 17, "Argument `state_units` must be one for every state"),
        ('("m", "m/s")', '("m", "Meter")', 17, "`Meter` in `Meter` is not a unit"),
        ('amplitude_of="q"', 'amplitude_of="p"', 25, "`amplitude_of` must name states"),
        ('name="ball"', "name=3", 15, "Argument `name` must be a text"),
        ('"m", 1.0', '"m", -1.0', 19, "must be greater than 0"),
        ("= -v", "= -1 if q > 0 else 1", 8, "Write `ca.if_else(q > 0, a, b)`"),
        ("= -v", "= -max(v, 0)", 8, "`ca.fmax` for `max`"),
        ("= -v", "= -v * (q > 0 and v)", 8, "`ca.logic_and` for `and`"),
        ("= -v", "= -c * v", 8, "NameError: name 'c' is not defined"),
        ("= -v", '= -p["c"] * v', 8, "must use declared gains and parameters, but it uses `c`"),
        ("= -v", "= -v * np.sin", 8, "TypeError"),
        ('ca.SX.sym("q")', 'ca.MX.sym("q")', 10, "Write `ca.SX.sym` for every symbol"),
        (', p["restitution"])', ")", 12, "Argument `restitution` is missing"),
        ("    return zo", "    zo", 23, "must return the system of `hybrid_system`"),
        ('name="ball", title', 'name="ball" title', 15, "Perhaps you forgot a comma"),
        ('"m/s^2"', '"N/metre"', 20, "`metre` in `N/metre` is not a unit: write `m`"),
        ('"m/s^2"', '"Newton"', 20, "`Newton` in `Newton` is not a unit: write `N`"),
        ('"m/s^2"', '"furlong"', 20, "Known units are kg, m, s"),
        ('("m", "m/s")', '("mm", "mm/s")', 20, "Write both in one of them"),
        ('{"q": 1.0}', '{"q": -1.0}', 24, "Change the start, or the sign of the gap"),
        ("gap=q", "gap=-q", 24, "Change the start, or the sign of the gap"),
        ("import numpy", "import no_such_module", 3, "No module named 'no_such_module'"),
    ],
)
def test_a_mistake_is_one_line_with_its_place_and_remedy(
    right: str, wrong: str, line: int, said: str, tmp_path: Path
) -> None:
    assert FILE.count(right) == 1
    file = tmp_path / "ball.py"
    file.write_text(FILE.replace(right, wrong), encoding="utf-8")
    answer = ask("simulate", file, "--until", "1")
    assert answer.code == MISUSE
    assert answer.err.count("\n") == 1
    assert f"`{file}`, line {line}: " in answer.err
    assert said in answer.err
    assert "?." not in answer.err


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
