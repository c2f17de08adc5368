"""Files of results are data: a path in one of them is not run, whatever reads the file."""

from __future__ import annotations

import inspect
import json
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

import zeno_orbits as zo
from tests.support.commands import ask
from tests.support.data_files import contents_by_kind, reading_commands, write_files
from zeno_orbits import api
from zeno_orbits.maps import read_boundaries, read_map, read_pushes, read_recovery
from zeno_orbits.precision import read_work_precision

MARK = "it ran"

PROBLEM = """
from pathlib import Path

Path({mark!r}).touch()
import casadi as ca
from zeno_orbits import HybridLagrangian, Problem, Quantity, hybrid_system, no_drive


def model(p):
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    ball = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=p["m"] * v**2 / 2, potential=p["m"] * 9.81 * q, gap=q
    )
    return hybrid_system(ball, no_drive(ball), 0.5)


PROBLEM = Problem(
    name={name!r},
    title="a ball",
    model=model,
    parameters=(Quantity.positive("m", 1.0, "kg", "mass"),),
    state_names=("q", "v"),
    state_units=("m", "m/s"),
    time_unit="s",
)
"""

NAMES = (
    "{folder}/evil.py",
    *(
        pytest.param(name, marks=pytest.mark.slow)
        for name in (
            *("evil.py", "./evil.py", "evil.py@bouncing_ball", "bouncing_ball@evil.py"),
            *("bouncing_ball@x.py", "bouncing_ball@x.py@y", "evil"),
        )
    ),
)
"""Texts of the entry `problem` that lead to a program, by a careless reader."""
FAR = "far"
"""Folder of a program that is neither beside the files nor in the current folder."""


def _write_program(folder: Path, name: str) -> None:
    """Write programs that leave a mark, to which the text of an entry may lead."""
    program = PROBLEM.format(mark=str(folder / MARK), name=name)
    files = ("evil.py", "evil.py@bouncing_ball", "bouncing_ball@x.py", "evil/model.py")
    for file in (*files, f"{FAR}/hidden.py"):
        (folder / file).parent.mkdir(exist_ok=True)
        (folder / file).write_text(program, encoding="utf-8")


@pytest.fixture(name="hostile", params=NAMES)
def _hostile(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> list[Path]:
    """Files of every kind that name a program, in the current folder beside the program."""
    monkeypatch.chdir(tmp_path)
    name = request.param.format(folder=tmp_path)
    _write_program(tmp_path, name)
    far = {"problem_file": f"{FAR}/hidden.py"}
    contents = {kind: data | far for kind, data in contents_by_kind(name).items()}
    return write_files(tmp_path, contents)


@pytest.mark.slow
def test_files_of_every_kind_are_sound_but_for_the_problem(tmp_path: Path) -> None:
    """Otherwise the checks below would end at another entry."""
    files = write_files(tmp_path, contents_by_kind("forced_oscillator"))
    readers = _readers()
    for file in files:
        assert any(_reads(reader, file) for reader in readers[:-1]), file


def _reads(reader: Callable[[Path], Any], file: Path) -> bool:
    with suppress(zo.InputError):
        reader(file)
        return True
    return False


def _readers() -> tuple[Callable[[Path], Any], ...]:
    """Return the functions that read a file of results."""
    return (
        *(zo.read_orbit, zo.read_orbit, zo.read_recording, read_map, read_pushes),
        *(read_recovery, read_work_precision, api.any_orbit),
        lambda path: zo.check_proof(path, "forced_oscillator"),
        lambda path: read_boundaries(path, "m", "g"),
        lambda path: json.loads(path.read_text()),
    )


def _read(files: list[Path]) -> Iterator[Any]:
    """Yield paths of files, as both kinds, and everything that can be read from them."""
    for file in files:
        yield file
        for reader in _readers():
            with suppress(Exception):
                yield reader(file)


def _public_functions() -> dict[str, Callable[..., Any]]:
    """Return the public functions, and those on which commands rest."""
    doors = [(module, name) for module in (zo, api) for name in module.__all__]
    found = {name: getattr(module, name) for module, name in doors}
    return {name: one for name, one in found.items() if inspect.isfunction(one)}


PLAIN: dict[str, Any] = {
    "parameter": "m",
    "box": (0.5, 2.0),
    "plan": zo.ExecutionPlan(place=zo.Workers(count=2)),
    "x": ("m", 1.0, 2.0, 2),
    "y": ("m", 1.0, 2.0, 2),
    "fit": ["m"],
    "accuracy": 1e-3,
    "workers": 2,
}
"""Sound values of arguments that need one."""


def _calls(function: Callable[..., Any], data: Any) -> Iterator[dict[str, Any]]:
    """Yield arguments of a function, with the data at each place for a result or a file in turn."""
    known = inspect.signature(function).parameters
    needed = {name for name, one in known.items() if one.default is one.empty}
    several = {"workers": 2} if "workers" in known else {}
    for name, one in known.items():
        if any(word in str(one.annotation) for word in ("Path", "Orbit", "Any", "object", "Run")):
            if name == "problem":
                continue
            given = {other: PLAIN.get(other, data) for other in needed}
            yield {**given, **several, name: data}


@pytest.mark.slow
def test_no_function_runs_a_program_that_a_file_of_results_names(
    hostile: list[Path], tmp_path: Path
) -> None:
    calls = 0
    for data in _read(hostile):
        for name, function in _public_functions().items():
            for arguments in _calls(function, data):
                writes = "path" in arguments and name.startswith("write")
                if "problem" in arguments or writes:
                    continue
                calls += 1
                with suppress(Exception):
                    function(**arguments)
    assert calls > 500
    assert not (tmp_path / MARK).exists()


@pytest.mark.slow
def test_no_command_runs_a_program_that_a_file_of_results_names(
    hostile: list[Path], tmp_path: Path
) -> None:
    asked = 0
    for file in hostile:
        for words in reading_commands(file, output=tmp_path / "out.html"):
            answer = ask(*words)
            assert "Traceback" not in answer.err
            assert "internal error" not in answer.err, (words, answer.err)
            asked += 1
    assert asked > 200
    assert not (tmp_path / MARK).exists()


@pytest.mark.slow
def test_a_checkpoint_runs_no_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    _write_program(tmp_path, "evil.py")
    words = ("map", "bouncing_ball", "--x", "g=5:10", "--y", "m=1:2", "--grid", "2x2")
    kept = ("--workers", "1", "--checkpoint", "kept")
    assert ask(*words, *kept).err == ""
    assert (tmp_path / "kept" / "identity.json").exists()
    for file in (tmp_path / "kept").rglob("*.json"):
        text = file.read_text()
        for one in ("bouncing_ball", "zeno", str(tmp_path)):
            text = text.replace(f'"{one}"', f'"{tmp_path}/evil.py"')
        file.write_text(text)
    ask(*words, *kept)
    assert not (tmp_path / MARK).exists()


def test_a_problem_that_the_caller_names_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The check of the checks above: the program leaves its mark when it runs."""
    monkeypatch.chdir(tmp_path)
    _write_program(tmp_path, "ball")
    write_files(tmp_path, contents_by_kind("ball"))
    ask("verify", "orbit_1.json")
    with suppress(zo.ZenoOrbitsError):
        zo.verify("orbit_1.json")
    assert not (tmp_path / MARK).exists()
    ask("verify", "orbit_1.json", "--problem", "evil.py")
    assert (tmp_path / MARK).exists()
    (tmp_path / MARK).unlink()
    with suppress(zo.ZenoOrbitsError):
        zo.plot(zo.read_orbit("orbit_1.json"), problem="evil")
    assert (tmp_path / MARK).exists()


@pytest.mark.parametrize("kind", ["orbit_1.json", "orbit_3.json"])
def test_a_name_that_is_not_bundled_asks_for_the_file(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    _write_program(tmp_path, "evil.py")
    write_files(tmp_path, contents_by_kind("evil.py"))
    told = r"Unknown problem `evil\.py`\. If it is yours, pass its file with --problem"
    for call in (
        lambda: zo.verify(kind),
        lambda: zo.plot(zo.read_orbit(kind)),
        lambda: zo.continue_orbit(kind, ("m", 0.5, 2.0), workers=2),
        lambda: zo.largest_push(kind, workers=2),
    ):
        with pytest.raises(zo.InputError, match=told):
            call()
    assert not (tmp_path / MARK).exists()


def _recorded(folder: Path, text: str, kind: str = "orbit_1.json") -> Path:
    """Write an orbit file in a folder that records a path of its problem file."""
    folder.mkdir(exist_ok=True)
    content = contents_by_kind("ball")[kind] | {"problem_file": text}
    (path,) = write_files(folder, {kind: content})
    return path


def _runs(orbit: Path, mark: Path) -> bool:
    """Return True if a command or a function that takes the orbit runs the program."""
    mark.unlink(missing_ok=True)
    ask("verify", str(orbit))
    with suppress(Exception):
        zo.plot(api.any_orbit(orbit))
    return mark.exists()


KINDS = ["orbit_1.json", *(pytest.param(f"orbit_{k}.json", marks=pytest.mark.slow) for k in (2, 3))]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("place", ["beside", "current", "folder beside"])
def test_an_own_problem_file_beside_the_orbit_or_in_the_current_folder_runs(
    kind: str, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    _write_program(tmp_path, "ball")
    if place == "current":
        orbit = _recorded(tmp_path / "results", "../evil.py", kind)
    else:
        monkeypatch.chdir(tmp_path / FAR)
        orbit = _recorded(tmp_path, "evil.py" if place == "beside" else "evil", kind)
    assert _runs(orbit, tmp_path / MARK)


def _in_another_folder(_folder: Path) -> str:
    return f"{FAR}/hidden.py"


def _at_an_absolute_path(folder: Path) -> str:
    return str(folder / FAR / "hidden.py")


def _above(_folder: Path) -> str:
    return "../above.py"


def _a_link(folder: Path) -> str:
    (folder / "link.py").symlink_to(folder / FAR / "hidden.py")
    return "link.py"


def _writable_by_all(folder: Path) -> str:
    (folder / "evil.py").chmod(0o646)
    return "evil.py"


def _writable_by_a_group(folder: Path) -> str:
    os.chown(folder / "evil.py", os.geteuid(), 54321)
    (folder / "evil.py").chmod(0o664)
    return "evil.py"


def _of_another_user(folder: Path) -> str:
    os.chown(folder / "evil.py", 54321, 54321)
    return "evil.py"


def _in_a_folder_that_others_may_write(folder: Path) -> str:
    folder.chmod(0o777)
    return "evil.py"


def _a_model_that_others_may_write(folder: Path) -> str:
    (folder / "evil" / "model.py").chmod(0o666)
    return "evil"


PLACES: dict[Callable[[Path], str], str] = {
    _in_another_folder: "in another folder",
    _at_an_absolute_path: "in another folder",
    _above: "in another folder",
    _a_link: "a link",
    _writable_by_all: "may write to it",
    _writable_by_a_group: "may write to it",
    _of_another_user: "another user owns it",
    _in_a_folder_that_others_may_write: "may write to its folder",
    _a_model_that_others_may_write: "may write to it",
}


@pytest.mark.parametrize("place", PLACES, ids=lambda one: one.__name__.strip("_"))
def test_a_recorded_problem_file_of_others_or_elsewhere_runs_only_if_it_is_named(
    place: Callable[[Path], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if place in (_writable_by_a_group, _of_another_user) and os.geteuid() != 0:
        pytest.skip("only root can give a file to others")
    folder, mark = tmp_path / "given", tmp_path / "given" / MARK
    folder.mkdir()
    monkeypatch.chdir(folder)
    _write_program(folder, "ball")
    (tmp_path / "above.py").write_text((folder / "evil.py").read_text())
    text = place(folder)
    orbit = _recorded(folder, text)
    assert not _runs(orbit, mark)
    answer = ask("verify", str(orbit))
    assert answer.err.count("\n") == 1
    assert PLACES[place] in answer.err
    remedy = os.path.relpath(folder / text)
    assert f"pass --problem {remedy} (`problem=` in Python)" in answer.err
    ask("verify", str(orbit), "--problem", str(folder / text))
    assert mark.exists()


def test_a_recorded_path_that_a_shell_could_misread_is_not_proposed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    name = "x.py; touch y"
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / name).write_text("")
    answer = ask("verify", str(_recorded(tmp_path, f"far/{name}")))
    assert "pass --problem FILE.py " in answer.err
