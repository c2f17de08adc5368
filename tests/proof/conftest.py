"""Certificates of two closed-form orbits that several files of tests falsify."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import pytest

from tests.support.certificates import forced_oscillator, impact_oscillator
from zeno_orbits.model import load_problem
from zeno_orbits.proof import ProofVerdict, check_proof
from zeno_orbits.proof.checker import identities


@pytest.fixture(scope="package", autouse=True)
def _one_prime() -> Iterator[None]:
    """Draw one random prime for all checks of a process: it costs more than many a check."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identities, "random_prime", cache(identities.random_prime))
        yield


@pytest.fixture(scope="session")
def zeno() -> dict[str, Any]:
    """Return a certificate of a Zeno periodic orbit, its section without coordinates."""
    return forced_oscillator(load_problem("forced_oscillator"))


@pytest.fixture(scope="session")
def zeno_verdict(zeno: dict[str, Any]) -> ProofVerdict:
    """Return what the checker says of the first."""
    return check_proof(zeno)


@pytest.fixture(scope="session")
def impact() -> dict[str, Any]:
    """Return a certificate on the section just after an impact, with two coordinates."""
    return impact_oscillator(load_problem("impact_oscillator"))
