"""The commands `problems`, `conditions`, `fidelity` and `new`, and problems by their files."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.reference.reference_orbit import PERIOD
from tests.support.commands import (
    MISUSE,
    PUBLISHED_GAINS,
    YES,
    ask,
    assert_refused,
    contents,
)
from zeno_orbits.model import bundled_problems, load_problem

pytestmark = pytest.mark.usefixtures("here")


@pytest.mark.slow
def test_problems_lists_every_problem_with_its_gains() -> None:
    printed = ask("problems").out
    entries = {entry["name"]: entry for entry in ask("problems", "--json").data}
    for name in bundled_problems():
        assert name in printed
        problem = load_problem(name)
        assert list(entries[name]["gains"]) == [gain.name for gain in problem.gains]
        assert list(entries[name]["states"]) == list(problem.state_names)
        assert entries[name]["parameters"] == dict(problem.values().parameters)


@pytest.mark.slow
def test_conditions_shows_the_two_published_coefficients() -> None:
    answer = ask("zeno-condition", "motor_pendulum")
    assert answer.code == YES
    assert "2.92437" in answer.out
    assert "27.5697" in answer.out


def test_conditions_as_json_has_the_published_coefficients_to_all_published_digits() -> None:
    answer = ask("zeno-condition", "motor_pendulum", "--json")
    assert answer.code == YES
    coefficients = answer.data["coefficients"]
    assert set(coefficients) == {"current", "sin(theta1)"}
    # Half a unit of the last published digit.
    assert coefficients["current"] == pytest.approx(-2.92437, abs=5e-6)
    assert coefficients["sin(theta1)"] == pytest.approx(-27.5697, abs=5e-5)
    assert answer.data["restitution"] == 0.2


def test_conditions_of_a_falling_ball_are_minus_gravity() -> None:
    answer = ask("zeno-condition", "bouncing_ball", "--json")
    assert answer.code == YES
    assert answer.data["coefficients"] == pytest.approx({"1": -9.81})


@pytest.mark.slow
def test_conditions_draws_the_region_when_asked(here: Path) -> None:
    answer = ask("zeno-condition", "motor_pendulum", "--plot", "region.png")
    assert answer.code == YES
    assert (here / "region.png").read_bytes().startswith(b"\x89PNG")
    assert "Written: region.png" in answer.out


@pytest.mark.slow
def test_fidelity_names_the_reduced_models_and_their_cost() -> None:
    answer = ask("reduced-models", "motor_pendulum")
    assert answer.code == YES
    assert "motor_pendulum@quasi_static" in answer.out
    costs = ask("reduced-models", "motor_pendulum", "--json").data
    assert {cost["problem"].partition("@")[2] for cost in costs} == {"corrected", "quasi_static"}


def test_a_new_problem_may_not_take_the_name_of_another(here: Path) -> None:
    """An orbit file tells its problem by this name."""
    assert_refused(ask("new", "motor_pendulum"), "NAME motor_pendulum: ", "`motor_pendulum` is one")
    assert contents(here) == {}


@pytest.fixture(name="machine")
def _machine(tmp_path: Path) -> Path:
    """The motor pendulum under another name in another folder."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    bundled = bundled_problems()["motor_pendulum"]
    text = (bundled / "model.py").read_text()
    renamed = text.replace('name="motor_pendulum"', 'name="my_machine"')
    assert renamed != text
    (folder / "my_machine.py").write_text(renamed)
    (folder / "reference.py").write_text((bundled / "reference.py").read_text())
    return Path("..") / "elsewhere" / "my_machine.py"


@pytest.mark.slow
def test_a_problem_of_ones_own_is_simulated_by_its_path(machine: Path) -> None:
    answer = ask("simulate", machine, "--until", "1", "--json")
    assert answer.code == YES
    assert answer.data["problem"] == "my_machine"


@pytest.mark.slow
def test_a_problem_of_ones_own_is_searched_verified_and_drawn(machine: Path, here: Path) -> None:
    found = ask("search", machine, *PUBLISHED_GAINS, "-o", "mine.json", "--json")
    assert found.code == YES
    assert found.data["problem"] == "my_machine"
    assert found.data["period"] == pytest.approx(PERIOD, rel=3e-10)
    checked = ask("verify", "mine.json", "--problem", machine, "--json")
    assert checked.code == YES
    assert checked.data["residuals"]["second_model"] < 1e-9
    drawn = ask("plot", "mine.json", "--problem", machine, "--kind", "zeno")
    assert drawn.code == YES
    assert (here / "zeno.png").exists()
    refused = ask("verify", "mine.json")
    assert refused.code == MISUSE
    assert "`my_machine`" in refused.err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("raise RuntimeError('two\\nlines')", ("RuntimeError", "two lines")),
        ("def broken(:\n    pass\n", ("line 1: invalid syntax",)),
        ("import a_module_that_is_nowhere\n", ("a_module_that_is_nowhere",)),
        ("PROBLEM = 3\n", ("PROBLEM",)),
        ("", ("PROBLEM",)),
        (
            "import sys\nsys.exit(3)\n",
            ("line 2: the file ends the program (`sys.exit`). Remove the call",),
        ),
    ],
    ids=["raises", "syntax", "import", "type", "empty", "exits"],
)
@pytest.mark.parametrize("command", ["simulate", "search", "zeno-condition"])
def test_a_problem_file_that_defines_no_problem_is_refused(
    text: str, words: tuple[str, ...], command: str, here: Path
) -> None:
    (here / "scene.py").write_text(text)
    before = contents(here)
    assert_refused(ask(command, "scene.py"), "`scene.py`", *words)
    assert contents(here) == before


def test_a_problem_file_that_is_no_python_is_refused(here: Path) -> None:
    (here / "problem.txt").write_text("PROBLEM = None\n")
    assert_refused(ask("simulate", "problem.txt"), "`problem.txt`", "Python")


@pytest.mark.parametrize("name", ["a" * 5000, "a\0b"])
def test_a_name_that_no_file_can_have_is_no_problem(name: str) -> None:
    answer = ask("simulate", name)
    assert_refused(answer, "unknown problem")
    assert "internal" not in answer.err
