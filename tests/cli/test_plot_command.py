"""The command `plot`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.support.commands import (
    YES,
    ask,
    assert_refused,
    contents,
)

pytestmark = pytest.mark.usefixtures("here")


@pytest.mark.slow
def test_plot_writes_five_pictures(orbit_file: Path, here: Path) -> None:
    answer = ask("plot", orbit_file, "-o", "pictures")
    assert answer.code == YES
    pictures = sorted((here / "pictures").iterdir())
    assert [path.name for path in pictures] == [
        "outputs.png",
        "portraits.png",
        "region.png",
        "time.png",
        "zeno.png",
    ]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures)
    assert answer.out.count("Written: ") == 5


@pytest.mark.slow
def test_pictures_that_cannot_all_be_drawn_are_none(orbit_data: dict[str, Any], here: Path) -> None:
    """A period too short for a Zeno point: the portraits alone could be drawn."""
    (here / "short.json").write_text(json.dumps(orbit_data | {"period": 1e-3}))
    before = contents(here)
    assert_refused(ask("plot", "short.json", "-o", "pictures"), "Zeno point")
    assert contents(here) == before
    assert not (here / "pictures").exists()


def test_plot_writes_the_picture_that_is_asked_for(orbit_file: Path, here: Path) -> None:
    answer = ask("plot", orbit_file, "--kind", "portraits", "--format", "pdf", "--json")
    assert answer.data == {"pictures": ["portraits.pdf"]}
    assert (here / "portraits.pdf").read_bytes().startswith(b"%PDF")
