"""What several test modules share: the reference problem, its orbit and the orbit's certificate."""

from __future__ import annotations

import gc
import math
import os
import signal
from collections.abc import Generator, Iterator

import pytest
from hypothesis import settings

from tests.support.processes import Commands
from tests.support.repelling import repelling_orbit
from zeno_orbits.model import HybridDynamics, Problem, load_problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.search import SearchResult, orbit_at_gains
from zeno_orbits.verification import OrbitCertificate, verify

# A shell makes its background jobs ignore interrupts, and their commands would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples every time, and no clock: a run that fails must fail again, on any machine.
settings.register_profile("repeatable", derandomize=True, database=None, deadline=None)
settings.register_profile("new examples", database=None, deadline=None)
settings.load_profile(os.environ.get("ZENO_ORBITS_EXAMPLES", "repeatable"))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect without the search for cycles: what is collected stays until the end."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        # Tests make few cycles: to look for them as often as Python does takes a twentieth.
        gc.set_threshold(50_000, 50, 100)
        gc.enable()


@pytest.fixture(scope="session")
def problem() -> Problem:
    """The motor pendulum."""
    return load_problem("motor_pendulum")


@pytest.fixture(scope="session")
def found(problem: Problem) -> SearchResult:
    """The search at the published gains."""
    return orbit_at_gains(problem, problem.values())


@pytest.fixture(scope="session")
def orbit(found: SearchResult) -> Orbit:
    """The orbit at the published gains."""
    return found.unwrap()


@pytest.fixture(scope="session")
def machine(orbit: Orbit, problem: Problem) -> HybridDynamics:
    """The motor pendulum at the published gains, as numeric functions."""
    return problem.dynamics(orbit.values(problem))


@pytest.fixture(scope="session")
def certificate(orbit: Orbit, problem: Problem) -> OrbitCertificate:
    """The certificate of the orbit at the published gains."""
    return verify(orbit, problem)


@pytest.fixture(scope="session")
def repelling() -> Orbit:
    """The repelling orbit that a feedback once per period keeps."""
    return repelling_orbit()


@pytest.fixture(autouse=True)
def _silence(monkeypatch: pytest.MonkeyPatch) -> None:
    """No progress in this process, however slow the machine is."""
    monkeypatch.setattr("zeno_orbits.report.terminal.progress._PATIENCE", math.inf)


@pytest.fixture
def commands() -> Iterator[Commands]:
    """Processes that end with their test."""
    commands = Commands()
    yield commands
    commands.end()
