"""What several laws share: both programs that carry out executions."""

from __future__ import annotations

import pytest

from tests.loop.agreement import needs_compiler


@pytest.fixture(
    params=[
        pytest.param("use", marks=needs_compiler),
        pytest.param("never", marks=pytest.mark.slow),
    ],
)
def both_loops(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run every test with the compiled loop and with its reference in Python."""
    monkeypatch.setenv("ZENO_ORBITS_LOOP", request.param)
