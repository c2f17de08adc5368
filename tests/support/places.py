"""Places to work at that cannot be had, and what a command says of them."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import joblib
import pytest

from tests.support.commands import ask
from zeno_orbits import work
from zeno_orbits.work import Cluster

MISUSE = 2

places_that_cannot_be_had = pytest.mark.parametrize(
    ("place", "told"),
    [
        (("--workers", str(int(joblib.cpu_count()) + 1)), ": must be at most the "),
        (("--scheduler", "tcp://127.0.0.1:1"), "--scheduler tcp://127.0.0.1:1: "),
        (("--scheduler", "tcp://127.0.0.1:1", "--workers", "1"), "--workers 1: must not be given"),
    ],
)


def refuses(
    monkeypatch: pytest.MonkeyPatch, words: tuple[str | Path, ...], told: str, *, work_of: str
) -> None:
    """Hold that a command refuses its place in one line, before it does any work.

    Args:
        monkeypatch: Of the test.
        words: The command with its place.
        told: What the line says.
        work_of: The function that would begin its work; it is gone.
    """
    monkeypatch.setattr(work_of, None)
    monkeypatch.setattr(work, "Cluster", partial(Cluster, patience=0.5))
    answer = ask(*words)
    assert answer.code == MISUSE
    assert told in answer.err
    assert len(answer.err.splitlines()) == 1
