"""The asymptotic phase of an execution beside an orbit, Lemma 13 and the corollary of the proof."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.orbits import event_orbit
from zeno_orbits.orbits import orbit_event_name

MACHINES = ("hopper", "motor_pendulum", "relay", "solenoid", "clapper", "two_motors")
_PERIODS = 60


@pytest.mark.parametrize("name", fast(3, MACHINES))
def test_returns_settle_at_the_asymptotic_phase_with_the_rate_of_the_multipliers(name: str) -> None:
    """Times of returns differ from those of the orbit by theta, to the second order of the start.

    The first-order theta is the sum of the changes of all durations.
    """
    orbit = event_orbit(name)
    returns = zo.return_map(orbit)
    d = len(returns.coordinates)
    size = np.abs(returns.fixed_point) + 1e-3
    off = 1e-4 * size * np.cos(1.0 + np.arange(d))
    by_point = returns.time_jacobian[:d]
    expected = by_point @ np.linalg.solve(np.eye(d) - returns.jacobian, off)
    start = returns.state(returns.fixed_point + off)
    values: dict[str, Any] = {"gains": orbit.gains, "parameters": orbit.parameters}
    run = zo.simulate(name, until=(_PERIODS + 0.5) * orbit.period, start=start, **values)
    # The only stop of a machine has no name in its events.
    names = (returns.event, returns.event.removesuffix(" stop"))
    at = [e.time for e in run.events if orbit_event_name(e) in names and e.time > 1e-9]
    at = at[orbit.n_returns - 1 :: orbit.n_returns]
    late = np.array(at) - orbit.period * np.arange(1, len(at) + 1)
    assert len(at) >= _PERIODS
    largest = np.abs(by_point * off).sum() + 1e-12
    assert late[-1] == pytest.approx(expected, abs=2e-3 * largest + 1e-10)
    radius = max(np.abs(np.linalg.eigvals(returns.jacobian)))
    apart = np.abs(late - late[-1])[: _PERIODS // 2]
    bound = 20 * largest * (radius + 0.02) ** np.arange(1, len(apart) + 1) + 1e-9
    assert (apart <= bound).all()
