"""A pytest plugin that writes which functions of the package each test calls.

    FUNCTIONS_CALLED=file.json python -m pytest -n0 -p tests.support.functions_called ...

What the setup of a fixture calls counts for every test that uses the fixture.
"""

from __future__ import annotations

import json
import os
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

PACKAGE = str(Path(__file__).parents[2] / "zeno_orbits")
Place = tuple[str, int]
"""A file and the first line of a function in it."""

_by_fixture: dict[str, set[Place]] = defaultdict(set)
_by_test: dict[str, set[Place]] = defaultdict(set)
_fixtures_of: dict[str, tuple[str, ...]] = {}
_seconds: dict[str, float] = defaultdict(float)
_collectors: list[set[Place]] = []


def _listen(frame: FrameType, event: str, _: Any) -> None:
    code = frame.f_code
    if event == "call" and _collectors and code.co_filename.startswith(PACKAGE):
        _collectors[-1].add((code.co_filename, code.co_firstlineno))


def pytest_sessionstart() -> None:
    """Listen to every call from now on."""
    sys.settrace(_listen)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any) -> Iterator[None]:
    """Collect the calls of a fixture by its name."""
    _collectors.append(_by_fixture[fixturedef.argname])
    try:
        return (yield)
    finally:
        _collectors.pop()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Collect the calls of a test."""
    _fixtures_of[item.nodeid] = tuple(getattr(item, "fixturenames", ()))
    _collectors.append(_by_test[item.nodeid])
    sys.settrace(_listen)
    try:
        return (yield)
    finally:
        _collectors.pop()


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up how long each test takes; one that fails is of no use to a study."""
    _seconds[report.nodeid] += report.duration if report.outcome == "passed" else float("inf")


def pytest_sessionfinish() -> None:
    """Write test to seconds and places."""
    sys.settrace(None)
    table = {
        name: {
            "seconds": _seconds[name],
            "called": sorted(
                places.union(*(_by_fixture[one] for one in _fixtures_of[name])),
            ),
        }
        for name, places in _by_test.items()
        if _seconds[name] < float("inf")
    }
    Path(os.environ["FUNCTIONS_CALLED"]).write_text(json.dumps(table), encoding="utf-8")
