"""Notebooks run with the slow tests, but for the first one."""

from __future__ import annotations

import pytest

QUICK = "01_"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the notebooks that are slow."""
    for item in items:
        if item.path.suffix == ".ipynb" and not item.path.name.startswith(QUICK):
            item.add_marker(pytest.mark.slow)
