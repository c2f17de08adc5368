"""Cases of a law: a few in every run, all with the slow tests."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def fast(n: int, cases: Iterable[Any]) -> list[Any]:
    """Return the cases of a parametrization, those after the first `n` marked as slow."""
    return [case if k < n else _slow(case) for k, case in enumerate(cases)]


def _slow(case: Any) -> Any:
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=pytest.mark.slow)
