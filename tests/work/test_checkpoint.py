"""A checkpoint takes nothing for finished that is not the result of its own points."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from zeno_orbits.errors import CheckpointError
from zeno_orbits.work.checkpoint import open_checkpoint

WORK = {"work": "test"}


def test_a_chunk_in_the_place_of_another_is_refused_though_its_checksum_is_right(
    tmp_path: Path,
) -> None:
    checkpoint = open_checkpoint(tmp_path, WORK, [1, 1])
    checkpoint.save(0, ["first"])
    assert checkpoint.finished() == {0: ["first"]}
    shutil.copy(tmp_path / "chunk-000000.json", tmp_path / "chunk-000001.json")
    with pytest.raises(CheckpointError, match=r"chunk-000001\.json.*other work or another chunk"):
        checkpoint.finished()


@pytest.mark.parametrize("kept", [0, 1, 3])
def test_a_chunk_with_more_or_fewer_results_than_points_is_refused(
    tmp_path: Path, kept: int
) -> None:
    checkpoint = open_checkpoint(tmp_path, WORK, [2])
    checkpoint.save(0, ["one"] * kept)
    with pytest.raises(CheckpointError, match=f"it has {kept} results in place of 2"):
        checkpoint.finished()
