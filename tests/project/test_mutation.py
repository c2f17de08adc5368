"""The faults of a mutation study: each is one, and each is a program."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.support.mutation import mutants_of

LIMITS = '''"""Text."""

_LIMIT: float = 0.5


def clipped(x: float, low: float = 0.0) -> float:
    """Return it."""
    if x < low and not x == 3:
        raise ValueError(f"Argument `x` must be larger, but it is {x + 1}.")
    return max(x, -low) * _LIMIT
'''


def test_faults_are_those_that_a_hand_would_make() -> None:
    diffs = [mutant.diff(LIMITS).splitlines()[-1].strip("+ ") for mutant in mutants_of(LIMITS)]
    assert "_LIMIT: float = 1.0" in diffs
    assert "if (x <= low) and not x == 3:" in diffs
    assert "if (x < low or not x == 3):" in diffs
    assert "if x < low and x == 3:" in diffs or "if x < low and (x == 3):" in diffs
    assert "return min(x, -low) * _LIMIT" in diffs
    assert "return max(x, low) * _LIMIT" in diffs
    assert "return (max(x, -low) / _LIMIT)" in diffs
    assert "return None" in diffs


def test_texts_annotations_and_errors_are_left_alone() -> None:
    for mutant in mutants_of(LIMITS):
        assert '"""Return it."""' in mutant.source
        assert "must be larger, but it is {x + 1}" in mutant.source
        assert "def clipped(x: float, low: float = " in mutant.source


@pytest.mark.parametrize("path", ["orbits/section.py"])
def test_every_mutant_of_a_module_is_another_program(path: str) -> None:
    source = (Path(__file__).parents[2] / "zeno_orbits" / path).read_text(encoding="utf-8")
    whole = ast.dump(ast.parse(source))
    mutants = list(mutants_of(source))
    assert len(mutants) > 50
    for mutant in mutants:
        assert ast.dump(ast.parse(mutant.source)) != whole
        assert mutant.diff(source)


def test_what_no_answer_depends_on_is_left_alone() -> None:
    source = (
        'x, T = ca.SX.sym("x", 2), TypeVar("T")\n'
        'y = dict(zip(cast("list[int]", names), path.read_text(encoding="utf-8"), strict=True))\n'
        'z = cast("float", low if found(names) else 3)\n'
    )
    lines = [mutant.diff(source).splitlines()[-1] for mutant in mutants_of(source)]
    assert lines == [
        '+x, T = ca.SX.sym("x", 3), TypeVar("T")',
        '+z = cast("float", (3 if found(names) else low))',
        '+z = cast("float", low if found(names) else 4)',
    ]
