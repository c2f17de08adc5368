"""The names of the package."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import zeno_orbits as zo


def test_the_version_is_a_name_and_every_name_of_dir_can_be_used() -> None:
    assert "__version__" in dir(zo)
    for name in dir(zo):
        assert getattr(zo, name) is not None


def test_signatures_show_no_addresses_and_no_aliases() -> None:
    shown = {
        name: str(inspect.signature(getattr(zo, name)))
        for name in zo.__all__[1:]
        if inspect.isroutine(getattr(zo, name))
    }
    assert len(shown) > 30
    for name, text in shown.items():
        assert not re.search(r" at 0x|\b(Named|Numbers|Axis)\b", text), (name, text)
    assert "on_progress: Progress = silent" in shown["find_orbit"].replace("'", "")


def test_a_recording_is_cut_between_two_times(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    rows = "".join(f"{0.1 * k},{k}\n" for k in range(20))
    path.write_text(f"time [s],height [m]\n{rows}")
    found = zo.crop(zo.read_recording(path), 0.45, 1.25)
    assert found.time.tolist() == [0.1 * k for k in range(5, 13)]
