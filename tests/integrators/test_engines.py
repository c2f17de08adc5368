"""Engines by name: one row each, from which the command line and the comparisons take them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from zeno_orbits.arrays import Vector
from zeno_orbits.cli import main
from zeno_orbits.errors import InputError
from zeno_orbits.integrators import (
    ENGINES,
    Leg,
    Outcome,
    PlainFlow,
    RungeKutta,
    Tolerance,
    engine_named,
)
from zeno_orbits.integrators.steps import DECAY_ERROR, SHORT_ERROR

FALLING = PlainFlow(
    field=lambda y: np.array([y[1], -2.0]), guard_and_rate=lambda y: (float(y[0]), float(y[1]))
)
"""From rest at a height of 1 the guard falls after 1, exactly."""


@pytest.mark.parametrize("name", ENGINES)
def test_every_engine_of_a_row_follows_a_flow_to_the_fall_of_its_guard(name: str) -> None:
    engine = engine_named(name)
    passage = engine.follow(
        Leg(
            flow=FALLING,
            y=np.array([1.0, 0.0]),
            horizon=5.0,
            tolerance=Tolerance(),
            on_guard=False,
        )
    )
    assert passage.outcome is Outcome.FALL
    assert math.isclose(passage.duration, 1.0, rel_tol=1e-13)
    assert np.allclose(passage.state, [0.0, -2.0], atol=1e-12)


def test_the_command_line_offers_the_rows_and_takes_the_first_by_default(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        main(["simulate", "--help-all"])
    assert f"--engine {{{','.join(ENGINES)}}}" in capsys.readouterr().out
    assert next(iter(ENGINES)) == "automatic"


def test_a_name_of_no_engine_is_refused_in_one_line_with_the_remedy() -> None:
    with pytest.raises(InputError, match=r"^Argument `engine` must be one of .*`sympy`\.$"):
        engine_named("sympy")
    with pytest.raises(InputError, match=r"`taylor`, which was removed: take `automatic`"):
        engine_named("taylor")


@pytest.mark.parametrize("relative", [1e-4, 1e-8, 1e-12])
@pytest.mark.parametrize("rate", [1e-3, 1.0, 1e6])
def test_the_first_step_through_a_layer_has_the_length_of_the_second(
    rate: float, relative: float
) -> None:
    # y = 0.5 + exp(-rate t): a step that is refused, or followed by a far longer one, is a waste.
    flow = PlainFlow(field=lambda y: -rate * (y - 0.5), guard_and_rate=lambda y: (float(y[0]), 0.0))
    tolerance = Tolerance(relative=relative, absolute=relative / 10)
    tried: list[float] = []
    attempt = flow.attempt

    class Watched(PlainFlow):
        def attempt(self, y: Vector, size: float, tolerance: Tolerance) -> tuple[Vector, float]:
            tried.append(size)
            return attempt(y, size, tolerance)

    watched = Watched(field=flow.field, guard_and_rate=flow.guard_and_rate)
    steps = RungeKutta().steps(watched, np.array([1.5]), tolerance)
    first, second = next(steps), next(steps)
    assert tried[:2] == [first.size, second.size]
    assert 0.5 < second.size / first.size < 2.0


@pytest.mark.parametrize(("length", "error"), [(1.0, DECAY_ERROR), (0.1, SHORT_ERROR * 0.1**6)])
def test_the_error_estimate_of_a_decay_is_that_of_the_first_step(
    length: float, error: float
) -> None:
    scale = Tolerance(relative=0.0, absolute=1.0)
    decay = PlainFlow(field=lambda y: -y, guard_and_rate=lambda _: (1.0, 0.0))
    _, found = decay.attempt(np.array([1.0]), length, scale)
    assert found == pytest.approx(error, rel=1e-3)
