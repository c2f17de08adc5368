"""Newton's method for orbits of motions: its charts, its derivatives and its first guess."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from zeno_orbits.maps import AttractorClass, attempt, attractors_at
from zeno_orbits.maps.newton import RELEASES, FixedPoint, chart_at, extrapolated
from zeno_orbits.model import load_problem
from zeno_orbits.simulation import simulate

PENDULUM = load_problem("motor_pendulum")


@pytest.mark.parametrize(("kp", "kd"), [(4.918, -0.408), (2.714, -1.184), (4.592, -0.49)])
def test_steps_with_an_old_derivative_shorten_as_the_derivative_changes(
    monkeypatch: pytest.MonkeyPatch, kp: float, kd: float
) -> None:
    steps = list[tuple[float, bool]]()
    usual = attempt.newton_step

    def noted(*given: Any) -> FixedPoint:
        found = usual(*given)
        steps.append((found.distance, given[-1] is not None))
        return found

    monkeypatch.setattr(attempt, "newton_step", noted)
    (found,) = attractors_at(PENDULUM, [PENDULUM.values(gains={"Kp": kp, "Kd": kd})])
    assert found.fate is AttractorClass.ZENO
    assert any(reused for _, reused in steps)
    # The derivative changes in proportion to the way since its bundle, so each step with it is
    # shorter by about the same factor. So is the first step after it.
    for (before, _), (here, reused), (after, _) in zip(steps, steps[1:], steps[2:], strict=False):
        if reused:
            assert after < 5.0 * here * here / before + 1e-9


def test_the_limit_of_a_linear_motion_along_one_direction_is_its_fixed_point() -> None:
    dynamics = PENDULUM.dynamics(PENDULUM.values())
    run = simulate(dynamics, PENDULUM.state_vector(PENDULUM.starts[0]), until=20.0)
    last = run.releases[-1].state
    section = chart_at(dynamics, RELEASES.rows, last, np.ones(last.size))
    away = 1e-3 * np.arange(1.0, section.dimension + 1.0)

    def at(y: np.ndarray[Any, Any]) -> Any:
        return last + section.scale * (section.tangent @ y)

    for multiplier in (0.9, 0.2, -0.7):
        # The centre is a return at a distance of `away` from the limit.
        earlier = [(1.0 / multiplier**k - 1.0) * away for k in (1, 2)]
        assert extrapolated(section, *map(at, earlier)) == pytest.approx(-away, rel=1e-6)
    # Steps that become longer, or no steps, lead nowhere.
    assert not np.any(extrapolated(section, at(2.0 * away), at(away)))
    assert not np.any(extrapolated(section, last, last))
