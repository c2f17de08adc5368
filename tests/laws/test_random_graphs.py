"""Random machines with stops, limits, waveforms and switches against an event loop in NumPy."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks import random_graphs

SEED, TURNS = 401, 2.0


def require_true(index: int) -> None:
    """Require the events of the reference, or a refusal that the reference shares."""
    machine = random_graphs.widened(random_graphs.drawn(SEED, index))
    verdict, _, _, _ = random_graphs.judged(machine, TURNS)
    assert verdict.kind != "disagree", f"{machine}: {verdict.text}"


@pytest.mark.parametrize("index", range(3))
def test_random_machines_have_the_events_of_the_reference(index: int) -> None:
    require_true(index)


@pytest.mark.slow
@pytest.mark.parametrize("index", range(3, 64))
def test_many_random_machines_have_the_events_of_the_reference(index: int) -> None:
    require_true(index)


@pytest.mark.slow
def test_events_that_are_late_disagree() -> None:
    machine = random_graphs.widened(random_graphs.drawn(SEED, 0))
    verdict, run, seen, _ = random_graphs.judged(machine, TURNS)
    assert verdict.kind == "agree"
    assert seen
    late = [replace(event, time=event.time + 1e-6) for event in seen]
    found = random_graphs.compared(run, late, lambda _: (1e-8, 1e-7), run.end_time)
    assert found.kind == "disagree"
