"""A source tree whose library no installed package has."""

from __future__ import annotations

import shutil
import tempfile
from functools import cache
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]
_KEPT = tempfile.TemporaryDirectory(prefix="zeno_orbits_tree_")


@cache
def unbuilt_tree() -> Path:
    """Return a copy of the package and its problems with another digest of the same C code."""
    tree = Path(_KEPT.name)
    for name in ("zeno_orbits", "problems"):
        skipped = shutil.ignore_patterns("__pycache__", "*.so")
        shutil.copytree(_ROOT / name, tree / name, ignore=skipped)
    with (tree / "zeno_orbits" / "loop" / "loop.c").open("a", encoding="utf-8") as code:
        code.write("/* of a tree that is not installed */\n")
    return tree
