"""The page on problems lists what there is, and nothing in the package knows a problem."""

from __future__ import annotations

import ast
import re
import tokenize
from pathlib import Path

from zeno_orbits.model import bundled_problems, load_problem

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "problems.md").read_text()
PACKAGE = ROOT / "zeno_orbits"


def test_the_page_lists_every_bundled_problem_with_its_number_of_states() -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \| (\d+) \|", PAGE, re.MULTILINE))
    assert {name: int(n) for name, n in rows.items()} == {
        name: len(load_problem(name).state_names) for name in bundled_problems()
    }


# Nothing in the package knows a problem.

WORDS = re.compile(
    r"\b(d?theta\d|pendulum|knee|shoulder|elbow|link[12]|cart|bowl|valve|hammer|piston|"
    r"L1|L2|lc1|lc2|J_rotor|K[pd]\d?|oscillator|bouncing|vibrating|table_|motor_(?!current|voltage)\w+|two_motors|"
    r"forced_\w+|falling_\w+|curved_\w+|torque_pendulum)\b"
)
PROBLEMS = {"new.py"}
"""The command `new` holds problems as texts, to be copied."""


def _code_words(path: Path) -> set[str]:
    """Return the words of a module's names and texts, docstrings and the examples of help apart."""
    tree = ast.parse(path.read_text())
    shown = set()
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            for one in body:
                if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant):
                    shown.add((one.value.lineno, one.value.col_offset))
    words: set[str] = set()
    for node in ast.walk(tree):
        names = [getattr(node, field, None) for field in ("id", "attr", "name", "arg")]
        words |= {name for name in names if isinstance(name, str)}
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and (node.lineno, node.col_offset) not in shown
            and "zeno-orbits " not in node.value
        ):
            words.add(node.value)
    return words


ANYWHERE = re.compile(WORDS.pattern.replace(r"\b", ""))
"""Words in a text whose borders are not known: in most modules none is found, at once."""


def _named_problems(path: Path) -> set[str]:
    if not ANYWHERE.search(path.read_text()):
        return set()
    return {found[0] for word in _code_words(path) if (found := WORDS.search(word))}


MODULES = [path for path in sorted(PACKAGE.rglob("*.py")) if "problems" not in path.parts]


def test_no_code_of_the_package_names_a_part_of_a_problem() -> None:
    named = {path.name: _named_problems(path) for path in MODULES if path.name not in PROBLEMS}
    assert {name: words for name, words in named.items() if words} == {}


def test_a_module_that_names_a_part_of_a_problem_would_be_found(tmp_path: Path) -> None:
    file = tmp_path / "module.py"
    for code in ('x = state["theta1"]', "Kp = 2.5", "def knee(): ...", "length = p.lc1"):
        file.write_text(code)
        assert _named_problems(file), code
    file.write_text('"""A pendulum."""\nexample = "zeno-orbits search motor_pendulum"\n')
    assert not _named_problems(file)


def test_no_module_of_the_package_imports_a_problem() -> None:
    contracts = (ROOT / "pyproject.toml").read_text()
    assert 'forbidden_modules = ["problems"]' in contracts
    for path in MODULES:
        with tokenize.open(path) as text:
            assert not re.search(r"^\s*(from|import) problems\b", text.read(), re.MULTILINE)
