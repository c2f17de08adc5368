"""Maps, families and certificates record the file of an own problem, as orbit files do."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

import zeno_orbits as zo
from tests.support.commands import MISUSE, YES, ask, assert_refused
from zeno_orbits.errors import MapFileError
from zeno_orbits.maps import read_map, write_map
from zeno_orbits.model import load_problem
from zeno_orbits.orbits import digest_of

BUNDLED = Path(__file__).parents[2] / "problems" / "vibrating_table.py"
NEW = ("problem_digest", "problem_file")
WRITTEN: Mapping[str, tuple[str, ...]] = {
    "map": ("map", "{}", "--x", "A=0.015:0.016", "--y", "g=9.8:9.9", "--grid", "2x2"),
    "family": (
        "continue",
        "{}",
        *["--near", "orbit.json", "--max-points", "1", "--parameter", "A=0.01:0.02"],
    ),
    "certificate": ("prove", "orbit.json"),
}


@pytest.fixture(name="folder")
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder, with an own problem file and the bundled one."""
    monkeypatch.chdir(tmp_path)
    source = BUNDLED.read_text(encoding="utf-8")
    Path("mine.py").write_text(source.replace('"vibrating_table"', '"mine"'), encoding="utf-8")
    (tmp_path / "results").mkdir()
    return tmp_path


def _written(kind: str, problem: str, path: str) -> dict[str, Any]:
    """Write a result of a problem by its command, and return its plain data."""
    zo.write_orbit(zo.find_orbit(problem).unwrap(), "orbit.json")
    answer = ask(*(word.format(problem) for word in WRITTEN[kind]), "-o", path)
    assert answer.code == YES, answer.err
    data: dict[str, Any] = json.loads(Path(path).read_text(encoding="utf-8"))
    return data


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRITTEN)
def test_a_result_names_the_own_problem_file_from_its_folder(kind: str, folder: Path) -> None:
    data = _written(kind, "mine.py", "results/result.json")
    assert data["problem"] == "mine"
    assert data["problem_file"] == "../mine.py"
    assert str(folder) not in json.dumps(data)
    if kind != "certificate":
        # A certificate has the digest of all its formulas.
        assert data["problem_digest"] == pytest.approx(digest_of(load_problem("mine.py")))


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRITTEN)
def test_a_result_of_a_bundled_problem_names_no_file(kind: str, folder: Path) -> None:
    data = _written(kind, "vibrating_table", "result.json")
    assert "problem_file" not in data
    assert folder == Path.cwd()


def test_a_map_is_read_with_its_file_and_without_the_new_entries(folder: Path) -> None:
    data = _written("map", "mine.py", "results/map.json")
    path = folder / "results" / "map.json"
    found = read_map(path)
    assert found.problem_file is not None
    assert Path(found.problem_file.path) == folder / "mine.py"
    write_map(found, folder / "again.json")
    again = json.loads((folder / "again.json").read_text(encoding="utf-8"))
    assert again == data | {"problem_file": "mine.py"}
    old = {name: value for name, value in data.items() if name not in NEW}
    path.write_text(json.dumps(old), encoding="utf-8")
    earlier = read_map(path)
    assert (earlier.problem_file, earlier.problem_digest) == (None, ())
    assert earlier.attractors == found.attractors


@pytest.mark.slow
def test_a_certificate_is_checked_with_a_named_file_only(folder: Path) -> None:
    _written("certificate", "mine.py", "proof.json")
    ran = folder / "ran"
    source = Path("mine.py").read_text(encoding="utf-8")
    mark = f"from pathlib import Path\nPath({str(ran)!r}).touch()\n"
    Path("mine.py").write_text(source.replace("import casadi", mark + "import casadi", 1))
    answer = ask("prove", "--check", "proof.json")
    assert_refused(answer, "Problem `mine`: its file `mine.py`", "--problem FILE.py")
    assert not ran.exists()
    assert ask("prove", "--check", "proof.json", "--problem", "mine.py").code == YES
    assert ran.exists()
    data = json.loads(Path("proof.json").read_text(encoding="utf-8"))
    del data["problem_file"]
    Path("proof.json").write_text(json.dumps(data), encoding="utf-8")
    assert ask("prove", "--check", "proof.json", "--problem", "mine.py").code == YES


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["map", "certificate"])
def test_the_entry_is_a_text(kind: str, folder: Path) -> None:
    data = _written(kind, "mine.py", "result.json")
    (folder / "result.json").write_text(json.dumps(data | {"problem_file": 7}), encoding="utf-8")
    if kind == "map":
        with pytest.raises(MapFileError, match="`problem_file` must be a text"):
            read_map(folder / "result.json")
        return
    answer = ask("prove", "--check", "result.json", "--problem", "mine.py")
    assert answer.code == MISUSE
    assert "`problem_file` must be a text, but it is `7`" in answer.err


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_a_family_of_an_own_problem_is_drawn_by_its_recorded_file() -> None:
    orbit = zo.find_orbit("mine.py").unwrap()
    at = orbit.parameters["A"]
    found = zo.continue_orbit(orbit, ("A", at, 1.001 * at), problem="mine.py")
    assert zo.plot(found).axes
    for one in found.families:
        with pytest.raises(zo.InputError, match="`mine`"):
            zo.plot(one)
