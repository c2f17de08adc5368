"""Orbit files record the file and the equations of their problem."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import casadi as ca
import pytest

import zeno_orbits as zo
from tests.support.commands import MISUSE, NO, YES, ask
from tests.support.nested_kinks import nested_problem
from zeno_orbits.api import any_orbit
from zeno_orbits.model import load_problem
from zeno_orbits.orbits import digest_of, same_equations

PROBLEMS = Path(__file__).parents[2] / "problems"
MACHINES = ["template", *(pytest.param(one, marks=pytest.mark.slow) for one in ("relay", "hopper"))]
"""A machine with one stop, with two stops and a switched voltage, and with kinks."""


@pytest.fixture(name="folder")
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _own_orbit(name: str, orbit: Path, file: str = "mine.py") -> None:
    """Write an own problem file, and an orbit of it."""
    if name == "template":
        assert ask("new", "mine").code == YES
        shutil.move("mine.py", Path(file))
        zo.write_orbit(zo.find_orbit(file).unwrap(), orbit)
        return
    source = (PROBLEMS / f"{name}.py").read_text(encoding="utf-8")
    assert f'name="{name}"' in source
    Path(file).write_text(source.replace(f'name="{name}"', 'name="mine"'), encoding="utf-8")
    zo.write_orbit(zo.find_orbit(file).unwrap(), orbit)


def _edit(file: Path) -> None:
    """Change the mass in the kinetic energy by a thousandth."""
    source = file.read_text(encoding="utf-8")
    assert 'kinetic=p["m"]' in source
    file.write_text(source.replace('kinetic=p["m"]', 'kinetic=1.001 * p["m"]'), encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_commands_and_functions_find_the_problem_of_an_orbit(name: str, folder: Path) -> None:
    (folder / "results").mkdir()
    _own_orbit(name, Path("results/orbit.json"))
    data = json.loads(Path("results/orbit.json").read_text())
    assert data["problem_file"] == "../mine.py"
    # The recorded file is in the current folder here.
    assert ask("verify", "results/orbit.json").code == YES
    assert zo.verify("results/orbit.json").passed
    shutil.copy("mine.py", "results")
    os.chdir(folder / "results")
    assert ask("verify", "orbit.json").code == YES
    os.chdir("/")
    answer = ask("verify", folder / "results" / "orbit.json")
    assert "in another folder" in answer.err
    given = ask("verify", folder / "results" / "orbit.json", "--problem", folder / "mine.py")
    assert given.code == YES


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_other_equations_are_told(name: str, folder: Path) -> None:
    _own_orbit(name, Path("orbit.json"))
    quiet = ask("plot", "orbit.json", "--kind", "time", "-o", "p")
    assert (quiet.code, quiet.err) == (YES, "")
    _edit(folder / "mine.py")
    clause = "equations of problem `mine` differ from those that gave the orbit"
    told = ask("plot", "orbit.json", "--kind", "time", "-o", "p")
    assert told.err == f"zeno-orbits: note: The {clause}.\n"
    verified = ask("verify", "orbit.json")
    assert verified.code == NO
    assert clause in verified.out
    assert verified.err == ""
    with pytest.warns(zo.EquationsWarning, match=clause):
        zo.floquet_multipliers("orbit.json")


def test_an_orbit_in_memory_knows_its_problem_and_is_equal_wherever_it_is(folder: Path) -> None:
    (folder / "models").mkdir()
    _own_orbit("template", Path("orbit.json"), "models/mine.py")
    orbit = zo.find_orbit("models/mine.py").unwrap()
    assert zo.verify(orbit).passed
    assert any_orbit("orbit.json") == orbit
    assert any_orbit("orbit.json").problem_file != orbit.problem_file
    assert "problem_file" not in orbit.as_json()


def test_a_bundled_problem_needs_no_file(orbit: zo.Orbit, folder: Path) -> None:
    zo.write_orbit(orbit, "orbit.json")
    assert "problem_file" not in json.loads(Path("orbit.json").read_text())
    assert zo.read_orbit("orbit.json").problem_file is None
    assert zo.verify("orbit.json").passed
    assert folder == Path.cwd()


@pytest.mark.parametrize(("entry", "passed"), [(7, False), ("", True), ("mine.py", True)])
def test_the_entry_is_an_optional_text(
    entry: object, passed: bool, orbit: zo.Orbit, folder: Path
) -> None:
    path = folder / "orbit.json"
    path.write_text(json.dumps(orbit.as_json() | {"problem_file": entry}))
    if passed:
        assert zo.read_orbit(path) == orbit
        return
    with pytest.raises(zo.OrbitFileError, match="`problem_file` must be a text"):
        zo.read_orbit(path)


def test_a_file_with_a_byte_order_mark_is_read(orbit: zo.Orbit, folder: Path) -> None:
    path = folder / "orbit.json"
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(orbit.as_json()).encode())
    assert zo.read_orbit(path) == orbit


@pytest.mark.parametrize("name", ["relay", "hopper", "kneed_walker", "sampled_pendulum"])
def test_the_digest_of_a_machine_with_modes_is_that_of_its_equations(name: str) -> None:
    problem = load_problem(name)
    digest = digest_of(problem)
    assert any(digest)

    def rewritten(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        system = problem.model(p)
        return replace(system, free_flow=(system.free_flow + 1) - 1)

    def changed(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        name = problem.parameters[0].name
        return problem.model({**p, name: 1.001 * p[name]})

    assert same_equations(digest, digest_of(replace(problem, model=rewritten)))
    assert not same_equations(digest, digest_of(replace(problem, model=changed)))


def test_a_script_that_is_no_model_is_not_run_because_an_orbit_names_it(folder: Path) -> None:
    _own_orbit("template", Path("orbit.json"))
    (folder / "wipe.py").write_text("open('it ran', 'w')\n")
    data = json.loads(Path("orbit.json").read_text())
    Path("orbit.json").write_text(json.dumps(data | {"problem_file": "wipe.py"}))
    answer = ask("verify", "orbit.json")
    assert answer.code == MISUSE
    assert "`wipe.py` is not run unless you name it, since it defines no `PROBLEM`" in answer.err
    assert not Path("it ran").exists()


def test_the_remedy_names_the_file_that_is_there(folder: Path) -> None:
    (folder / "results").mkdir()
    _own_orbit("template", Path("results/orbit.json"))
    (folder / "mine.py").chmod(0o666)
    answer = ask("verify", "results/orbit.json")
    assert answer.code == MISUSE
    assert "pass --problem mine.py (" in answer.err


LIMITS = {
    "one limit": "ca.fmin(12, WISH)",
    "other limits": "ca.fmax(-12, ca.fmin(11, WISH))",
    "a small force beyond a speed": (
        "ca.fmax(-12, ca.fmin(12, WISH)) + ca.if_else(v < -0.5, 0.1, 0)"
    ),
}


@pytest.mark.parametrize("other", LIMITS.values(), ids=LIMITS)
def test_an_edit_behind_a_kink_changes_the_digest(other: str, folder: Path) -> None:
    def digest(form: str) -> tuple[float, ...]:
        force = form.replace("WISH", "(5 - 40 * q - 3 * v)")
        path = folder / "limited.py"
        path.write_text(nested_problem(force), encoding="utf-8")
        return digest_of(load_problem(path))

    own = digest("ca.fmin(12, ca.fmax(-12, WISH))")
    # The same limits in another order.
    assert same_equations(own, digest("ca.fmax(-12, ca.fmin(12, WISH))"))
    assert not same_equations(own, digest(other))


def test_a_name_with_a_file_in_the_current_folder_is_told(folder: Path) -> None:
    assert ask("new", "tapper").code == YES
    answer = ask("simulate", "tapper")
    assert "Unknown problem `tapper`. For the file, pass `tapper.py`." in answer.err
    assert ask("simulate", "tapper.py", "--until", "1").code == YES
    assert (folder / "tapper.py").exists()


@pytest.mark.parametrize("file", ["relay.py", "relay/model.py"])
def test_a_bundled_name_is_the_bundled_problem_and_a_file_of_that_name_is_told(
    file: str, folder: Path
) -> None:
    assert ask("new", "tapper").code == YES
    path = folder / file
    path.parent.mkdir(exist_ok=True)
    shutil.move("tapper.py", path)
    word = "./relay" if path.parent != folder else "relay.py"
    answer = ask("simulate", "relay", "--until", "0.01", "--json")
    assert f"`relay` is the bundled problem. For the file in this folder, pass `{word}`." in (
        answer.err
    )
    assert json.loads(answer.out)["problem"] == "relay"
    with pytest.warns(zo.EquationsWarning, match="bundled"):
        assert zo.load_problem("relay").name == "relay"
    own = ask("simulate", word, "--until", "0.01", "--json")
    assert own.err == ""
    assert json.loads(own.out)["problem"] == "tapper"


def test_the_folder_of_the_bundled_problems_holds_no_namesake(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(PROBLEMS)
    assert ask("simulate", "relay", "--until", "0.01").err == ""


@pytest.mark.slow
def test_an_orbit_of_a_file_with_a_bundled_name_belongs_to_the_file(folder: Path) -> None:
    source = (PROBLEMS / "vibrating_table.py").read_text(encoding="utf-8")
    Path("relay.py").write_text(
        source.replace('name="vibrating_table"', 'name="relay"'), encoding="utf-8"
    )
    zo.write_orbit(zo.find_orbit("relay.py").unwrap(), Path("orbit.json"))
    assert ask("verify", "orbit.json").code == YES
    shutil.move("relay.py", "other.py")
    answer = ask("verify", "orbit.json")
    assert answer.code == MISUSE
    assert "its file `relay.py` is missing: pass --problem FILE.py" in answer.err
    assert ask("verify", "orbit.json", "--problem", "other.py").code == YES
    # Without the file, the name alone leads to a machine whose parameters differ.
    data = json.loads(Path("orbit.json").read_text())
    del data["problem_file"]
    (folder / "orbit.json").write_text(json.dumps(data))
    assert "must have the parameters of its problem" in ask("verify", "orbit.json").err
