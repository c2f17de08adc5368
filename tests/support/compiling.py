"""Compiled kernels in tests: a folder that all of a session share, and systems of their own."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import casadi as ca
import pytest

from zeno_orbits.kernels import KernelSource, requests
from zeno_orbits.model import CompiledSystem, load_problem
from zeno_orbits.model.problem import _compiled

needs_compiler = pytest.mark.skipif(
    shutil.which("cc") is None, reason="there is no C compiler `cc` here"
)


def use_folder(monkeypatch: pytest.MonkeyPatch, folder: Path, when: str = "wait") -> None:
    """Compile into a folder, and know nothing of what was compiled before."""
    monkeypatch.setenv("ZENO_ORBITS_CACHE", str(folder))
    monkeypatch.setenv("ZENO_ORBITS_COMPILE", when)
    monkeypatch.delenv("CC", raising=False)
    forget(monkeypatch)


def forget(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget the compiler, complaints and kernels of this process."""
    requests.usable_compiler.cache_clear()
    monkeypatch.setattr(requests, "_complaints", {})
    monkeypatch.setattr(requests, "_used", [])


def fresh_system(name: str) -> CompiledSystem:
    """Return the functions of a problem that nobody else has, and so no kernels yet."""
    return _compiled.__wrapped__(load_problem(name), None)


def written_as_c(functions: Sequence[ca.Function], _numbers: Sequence[float]) -> KernelSource:
    """Return a source of the functions as they are: the maker of small recipes."""
    return KernelSource(functions=functions)
