"""Problems by name and from files: what is refused, and in which words."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from zeno_orbits.errors import InputError, ProblemFileError
from zeno_orbits.model import Problem, Quantity, bundled_problems, load_problem, load_reference


@pytest.fixture(name="pendulum", scope="module")
def _pendulum() -> Problem:
    return load_problem("motor_pendulum")


def test_the_bundled_problems_are_found_by_name() -> None:
    assert {"bouncing_ball", "motor_pendulum"} <= set(bundled_problems())
    for name in bundled_problems():
        assert load_problem(name).name == name


@pytest.mark.parametrize("name", sorted(bundled_problems()))
def test_every_bundled_problem_is_consistent(name: str) -> None:
    problem = load_problem(name)
    system = problem.model(problem.symbols())
    assert system.state.numel() == len(problem.state_names) == len(problem.state_units)
    assert len(set(problem.names)) == len(problem.names)
    assert len(problem.values().vector) == len(problem.names)
    assert problem.amplitude_of in problem.state_names
    for pair in problem.portraits:
        assert set(pair) <= set(problem.state_names)
    for start in problem.starts:
        assert len(problem.state_vector(start)) == len(problem.state_names)


@pytest.mark.slow
def test_a_problem_is_found_by_the_path_of_its_file_or_folder() -> None:
    path = bundled_problems()["motor_pendulum"]
    assert load_problem(path).name == "motor_pendulum"
    assert load_problem(path / "model.py").name == "motor_pendulum"
    assert load_problem(str(path / "model.py")).name == "motor_pendulum"


def test_an_unknown_problem_is_refused_with_the_known_names() -> None:
    with pytest.raises(
        InputError, match=r"`problem`: unknown problem `motor_pendul`.*bouncing_ball"
    ):
        load_problem("motor_pendul")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.py` cannot be read"):
        load_problem(tmp_path / "nothing.py")


def test_a_file_that_raises_is_refused_with_its_error(tmp_path: Path) -> None:
    file = tmp_path / "broken.py"
    file.write_text("ratio = 1 / 0\n", encoding="utf-8")
    with pytest.raises(ProblemFileError, match=r"broken\.py`, line 1: ZeroDivisionError") as caught:
        load_problem(file)
    assert caught.value.path == file


def test_a_file_that_is_no_python_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "garbled.py"
    file.write_text("def :\n", encoding="utf-8")
    with pytest.raises(ProblemFileError, match=r"garbled\.py`, line 1: invalid syntax"):
        load_problem(file)
    for name, text in (("problem.toml", ""), ("a.json", "{"), ("b.json", '{"problem": 3}')):
        other = tmp_path / name
        other.write_text(text, encoding="utf-8")
        with pytest.raises(ProblemFileError, match="it is not a Python file"):
            load_problem(other)
    table = tmp_path / "run.csv"
    table.write_text("time [s]\n", encoding="utf-8")
    with pytest.raises(ProblemFileError, match=r"orbit first, and the recording after it"):
        load_problem(table)


def test_a_file_without_a_problem_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "empty.py"
    file.write_text("problem = 1\n", encoding="utf-8")
    with pytest.raises(ProblemFileError, match="it lacks a `PROBLEM`"):
        load_problem(file)
    file.write_text("PROBLEM = 'a pendulum'\n", encoding="utf-8")
    with pytest.raises(ProblemFileError, match="it lacks a `PROBLEM` of type `Problem`"):
        load_problem(file)


def test_a_folder_without_a_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ProblemFileError, match=r"it is a folder without `model\.py`"):
        load_problem(tmp_path)


def test_an_unknown_parameter_is_refused_with_the_known_names(pendulum: Problem) -> None:
    with pytest.raises(
        InputError, match=r"`parameter`: unknown parameter `mass`.*Known: L1, lc1, "
    ):
        pendulum.values(parameters={"mass": 1.0})


def test_an_unknown_gain_is_refused_with_the_known_names(pendulum: Problem) -> None:
    with pytest.raises(
        InputError, match=r"`gain`: unknown gain `Ki`\. Did you mean `Kp`\? Known: Kp, Kd\."
    ):
        pendulum.values(gains={"Ki": 1.0})


def test_a_gain_of_a_problem_without_gains_is_refused() -> None:
    with pytest.raises(InputError, match=r"`gain`: unknown gain `Kp`\. Known: none"):
        load_problem("bouncing_ball").values(gains={"Kp": 1.0})


@pytest.mark.parametrize("mass", [0.0, -0.3])
def test_a_mass_that_is_not_positive_is_refused(pendulum: Problem, mass: float) -> None:
    with pytest.raises(InputError, match=f"`m1` must be greater than 0, but it is {mass:g}"):
        pendulum.values(parameters={"m1": mass})


@pytest.mark.parametrize("value", [-0.1, 1.0 + 1e-9, 1.5])
def test_a_restitution_outside_its_range_is_refused(pendulum: Problem, value: float) -> None:
    with pytest.raises(
        InputError, match=rf"`restitution` must lie in \[0, 1\], but it is {value:g}"
    ):
        pendulum.values(parameters={"restitution": value})


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_refused(pendulum: Problem, value: float) -> None:
    with pytest.raises(InputError, match="`m1` must be a finite number"):
        pendulum.values(parameters={"m1": value})
    with pytest.raises(InputError, match="`Kp` must be a finite number"):
        pendulum.values(gains={"Kp": value})
    with pytest.raises(InputError, match="`theta1` must be a finite number"):
        pendulum.state_vector({"theta1": value})


def test_gains_outside_the_search_box_are_allowed(pendulum: Problem) -> None:
    assert pendulum.values(gains={"Kp": 100.0}).gains["Kp"] == 100.0


def test_an_unknown_state_is_refused(pendulum: Problem) -> None:
    with pytest.raises(InputError, match=r"`state`: unknown state `theta3`.*Known: theta1, "):
        pendulum.state_vector({"theta3": 1.0})


def test_states_that_are_not_named_are_zero(pendulum: Problem) -> None:
    assert pendulum.state_vector({"dtheta1": 2}) == (0.0, 0.0, 2.0, 0.0, 0.0)


def test_values_come_gains_first_in_the_order_of_the_names(pendulum: Problem) -> None:
    values = pendulum.values(gains={"Kd": -0.5})
    named = dict(zip(pendulum.names, values.vector, strict=True))
    assert named == {**values.gains, **values.parameters}
    assert named["Kd"] == -0.5


def test_a_problem_without_a_hand_written_model_says_so() -> None:
    with pytest.raises(InputError, match="`bouncing_ball` lacks it"):
        load_reference(load_problem("bouncing_ball"))


def test_ranges_are_told_in_words() -> None:
    with pytest.raises(InputError, match="`m` must be greater than 0, but it is 0"):
        Quantity.positive("m", 1.0, "kg", "mass").checked(0.0)
    with pytest.raises(InputError, match=r"must lie in \[0, 1\]"):
        Quantity.restitution(0.5).checked(1.5)
    with pytest.raises(InputError, match=r"must lie in \[0, 2\)"):
        Quantity(
            name="x", unit="1", meaning="x", default=1.0, lower=0.0, upper=2.0, excluded=(2.0,)
        ).checked(2.0)


def test_a_name_is_a_gain_or_a_parameter_whichever_it_is() -> None:
    problem = load_problem("motor_pendulum")
    mixed = problem.values(gains={"Kd": -1.5}, numbers={"R": 2.0, "Kp": 3.0})
    assert mixed == problem.values(gains={"Kp": 3.0, "Kd": -1.5}, parameters={"R": 2.0})
    assert tuple(mixed.numbers.values()) == mixed.vector
    assert [problem.place(name) for name in problem.names] == [*range(len(problem.names))]
    assert problem.quantity("Kp") is problem.gains[0]
    assert problem.quantity("R").unit == "ohm"


def test_a_name_that_is_neither_is_refused_by_the_word_of_the_caller() -> None:
    problem = load_problem("bouncing_ball")
    with pytest.raises(InputError, match=r"`name`: unknown name `w`\. Known: m, g, restitution"):
        problem.values(numbers={"w": 1.0})
    with pytest.raises(InputError, match=r"`in`: unknown name `w`\. Known: m, g, restitution"):
        problem.place("w", argument="in")


def test_a_range_that_leaves_what_a_parameter_may_be_is_refused() -> None:
    problem = load_problem("motor_pendulum")
    with pytest.raises(InputError, match=r"`restitution` must lie in \[0, 1\]"):
        problem.require_range("restitution", (0.5, 1.1))
    with pytest.raises(InputError, match="`x` must have finite bounds LOWER < UPPER for `R`"):
        problem.require_range("R", (2.0, 2.0), argument="x")
    wider = (problem.gains[0].lower - 1.0, problem.gains[0].upper + 1.0)
    assert problem.require_range("Kp", wider) is problem.gains[0]
