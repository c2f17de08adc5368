"""`compare` on machines that nothing was tuned to: each number is right or not resolved."""

from __future__ import annotations

import pytest

from benchmarks.comparison import SURE, machine, recorded, scores
from tests.support.cases import often

CYCLES, NOISE = 30, 1e-3
ALWAYS = ("period", "first impact time", "gap in contact")
"""Numbers that 150 samples a period always tell."""


@pytest.mark.slow
# Samples at the same phases in every period, 40 and 150 of them, miss the same peaks every time.
@pytest.mark.parametrize("samples", often(3, [40.0, 150.7, 600.9, 40.3, 150.0]))
@pytest.mark.parametrize("name", ["hammer", "geared_flap", "shaken_pair"])
def test_each_number_is_within_four_standard_errors_or_not_resolved(
    name: str, samples: float
) -> None:
    one = machine(name, CYCLES)
    for seed in range(3):
        found = list(scores(one, recorded(one, samples, CYCLES, NOISE, seed)))
        off = [score for score in found if score.resolved and score.off > SURE]
        assert not off
        told = {score.name for score in found if score.resolved}
        assert samples < 150.0 or told.issuperset(ALWAYS)
