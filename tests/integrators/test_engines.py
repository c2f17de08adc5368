"""Engines by name: one row each, from which the command line and the comparisons take them."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest

from zeno_orbits.cli import main
from zeno_orbits.errors import InputError
from zeno_orbits.integrators import (
    ENGINES,
    Leg,
    Outcome,
    PlainFlow,
    Tolerance,
    engine_named,
    installed_engines,
)
from zeno_orbits.integrators.engines import Selective
from zeno_orbits.model import load_problem

FALLING = PlainFlow(
    field=lambda y: np.array([y[1], -2.0]), guard_and_rate=lambda y: (float(y[0]), float(y[1]))
)
"""From rest at a height of 1 the guard falls after 1, exactly."""


@pytest.mark.parametrize("name", installed_engines())
def test_every_engine_of_a_row_follows_a_flow_to_the_fall_of_its_guard(name: str) -> None:
    engine = engine_named(name)
    start, ball = np.array([1.0, 0.0]), load_problem("bouncing_ball")
    flow = FALLING
    if isinstance(engine, Selective):
        with pytest.raises(InputError, match="must come from formulas"):
            engine.require(FALLING, start)
        flow = ball.dynamics(ball.values(parameters={"g": 2.0})).free
        engine.require(flow, start)
    passage = engine.follow(
        Leg(flow=flow, y=start, horizon=5.0, tolerance=Tolerance(), on_guard=False)
    )
    assert passage.outcome is Outcome.FALL
    assert math.isclose(passage.duration, 1.0, rel_tol=1e-13)
    assert np.allclose(passage.state, [0.0, -2.0], atol=1e-12)


def test_the_command_line_offers_the_rows_and_takes_the_first_by_default(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        main(["simulate", "--help"])
    assert f"--engine {{{','.join(ENGINES)}}}" in capsys.readouterr().out
    assert next(iter(ENGINES)) == "automatic"


def test_an_engine_whose_package_is_missing_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "heyoka", None)
    with pytest.raises(InputError, match=r"`taylor` needs heyoka: run `pip install"):
        engine_named("taylor")
