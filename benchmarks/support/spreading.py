"""Spread the cases of a benchmark over processes, with a checkpoint."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from zeno_orbits.report import terminal
from zeno_orbits.work import ExecutionPlan, FailedPoint, Workers, spread_in_order, versions

FOLDERS = (Path(__file__).parents[1], Path(__file__).parents[2])
"""The scripts and the root of the repository, from which workers import."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the workers."""
    parser.add_argument("--workers", type=int, help="processes; one a core by default")
    parser.add_argument("--checkpoint", type=Path, help="keep what is finished here, and go on")


def arriving(
    name: str,
    task: Callable[[Sequence[Any]], Sequence[Any]],
    points: Sequence[Any],
    options: argparse.Namespace,
    *,
    chunk: int = 1,
) -> Generator[Any]:
    """Yield the answer of a task to each point in order, or a dictionary with ``refused``: why.

    Args:
        name: Name of the work, and of its folder in the checkpoint.
        task: Function from points to answers, all plain data. It can be pickled.
        points: The points.
        options: With the options of `add_options`.
        chunk: Number of points that one worker gets at once.
    """
    known = os.environ.get("PYTHONPATH", "")
    os.environ["PYTHONPATH"] = os.pathsep.join([*map(str, FOLDERS), *filter(None, [known])])
    folder = options.checkpoint
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    plan = ExecutionPlan(
        place=Workers(count=options.workers),
        chunk=chunk,
        checkpoint=None if folder is None else folder / name,
        identity={"work": name, "task": repr(task), "versions": versions()},
    )
    with (
        terminal.ProgressLine(lambda: None) as progress,
        closing(spread_in_order(task, points, plan, on_progress=progress)) as found,
    ):
        for one in found:
            yield {"refused": one.reason} if isinstance(one, FailedPoint) else one
