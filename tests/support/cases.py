"""Cases of a law: a few in every run, more with the slow tests, all with the weekly ones."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def fast(n: int, cases: Iterable[Any]) -> list[Any]:
    """Return the cases of a parametrization, those after the first `n` marked as slow."""
    return [_marked(case, *[pytest.mark.slow] * (k >= n)) for k, case in enumerate(cases)]


def often(n: int, cases: Iterable[Any]) -> list[Any]:
    """Return the cases of a slow test, those after the first `n` marked as weekly."""
    return [_marked(case, *[pytest.mark.weekly] * (k >= n)) for k, case in enumerate(cases)]


def _marked(case: Any, *marks: Any) -> Any:
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=marks)
