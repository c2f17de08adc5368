"""The names of the package."""

from __future__ import annotations

from pathlib import Path

import zeno_orbits as zo


def test_the_version_is_a_name_and_every_name_of_dir_can_be_used() -> None:
    assert "__version__" in dir(zo)
    for name in dir(zo):
        assert getattr(zo, name) is not None


def test_a_recording_is_cut_between_two_times(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    rows = "".join(f"{0.1 * k},{k}\n" for k in range(20))
    path.write_text(f"time [s],height [m]\n{rows}")
    found = zo.crop(zo.read_recording(path), 0.45, 1.25)
    assert found.time.tolist() == [0.1 * k for k in range(5, 13)]
