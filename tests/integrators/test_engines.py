"""Engines by name: one row each, from which the command line and the comparisons take them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from zeno_orbits.cli import main
from zeno_orbits.errors import InputError
from zeno_orbits.integrators import (
    ENGINES,
    PlainFlow,
    Segment,
    Termination,
    Tolerance,
    engine_named,
)

FALLING = PlainFlow(
    field=lambda y: np.array([y[1], -2.0]), guard_and_rate=lambda y: (float(y[0]), float(y[1]))
)
"""From rest at a height of 1 the guard falls after 1, exactly."""


@pytest.mark.parametrize("name", ENGINES)
def test_every_engine_of_a_row_follows_a_flow_to_the_fall_of_its_guard(name: str) -> None:
    engine = engine_named(name)
    passage = engine.follow(
        Segment(
            flow=FALLING,
            y=np.array([1.0, 0.0]),
            horizon=5.0,
            tolerance=Tolerance(),
            on_guard=False,
        )
    )
    assert passage.outcome is Termination.FALL
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
    with pytest.raises(
        InputError,
        match=r"^Argument `engine`: unknown integrator `sympy`\. Known: automatic, .*\.$",
    ):
        engine_named("sympy")
    with pytest.raises(InputError, match=r"`taylor`\. Did you mean `automatic`\?"):
        engine_named("taylor")
