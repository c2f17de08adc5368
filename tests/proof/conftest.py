"""Certificates of two closed-form orbits that several files of tests falsify."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.certificates import forced_oscillator, impact_oscillator
from zeno_orbits.model import load_problem


@pytest.fixture(scope="session")
def zeno() -> dict[str, Any]:
    """Return a certificate of a Zeno periodic orbit, its section without coordinates."""
    return forced_oscillator(load_problem("forced_oscillator"))


@pytest.fixture(scope="session")
def impact() -> dict[str, Any]:
    """Return a certificate on the section just after an impact, with two coordinates."""
    return impact_oscillator(load_problem("impact_oscillator"))
