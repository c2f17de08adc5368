"""Kernels on request: loaded if they are on disk, else built once the work repays it.

Building takes seconds and a whole core, so no answer waits for it: another process writes the C
code and compiles it, while this one interprets. It is asked for when the interpreted work that the
kernels would have done has taken `_REPAYS` seconds in this process.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import casadi as ca

from zeno_orbits.errors import KernelError
from zeno_orbits.kernels.compiler import Compiler, find_compiler
from zeno_orbits.kernels.folder import kernel_folder
from zeno_orbits.kernels.library import KernelLibrary
from zeno_orbits.kernels.order import Order

_REPAYS = 0.05
"""Interpreted work after which a library is asked for [s]."""
_WRITERS = ("integrators", "kernels", "model/numeric", "simulation/batch")
"""Folders whose code writes kernels; another version of it writes others."""


class When(Enum):
    """When kernels are compiled: the values of the variable ``ZENO_ORBITS_COMPILE``."""

    BACKGROUND = "background"
    """By another process, once the work repays it. The default."""
    WAIT = "wait"
    """At the first use, and it is waited for: for measurements and for images of containers."""
    NEVER = "never"
    """Not at all, and what is on disk is not used either."""


def when_to_compile() -> When:
    """Return what the variable ``ZENO_ORBITS_COMPILE`` says.

    Raises:
        InputError: If it says something else.
    """
    said = os.environ.get("ZENO_ORBITS_COMPILE", "")
    known = [when.value for when in When]
    if said and said not in known:
        from zeno_orbits.errors import InputError

        message = f"must be one of {', '.join(known)}, but it is `{said}`"
        raise InputError(f"Argument `ZENO_ORBITS_COMPILE` {message}.")
    return When(said or When.BACKGROUND.value)


@dataclass(frozen=True, slots=True, kw_only=True)
class KernelSource:
    """What a library is compiled from.

    Attributes:
        functions: Functions of scalar instructions; each becomes a kernel of its name.
        code: C code that stands after them and may call them.
    """

    functions: Sequence[ca.Function]
    code: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recipe:
    """How a library is made, in words that another process can follow.

    Attributes:
        maker: ``module:function``, from `functions` and `numbers` to a `Source`.
        functions: What it starts from.
        numbers: Whatever else it needs.
    """

    maker: str
    functions: tuple[ca.Function, ...]
    numbers: tuple[float, ...] = ()

    def plain(self) -> dict[str, object]:
        """Return the recipe as plain data."""
        functions = [function.serialize() for function in self.functions]
        return {"maker": self.maker, "functions": functions, "numbers": list(self.numbers)}


class Kernels:
    """The kernels of a recipe, from the moment that they are there."""

    def __init__(self, recipe: Recipe | None) -> None:
        """Look for nothing yet.

        Args:
            recipe: How they are made; without one there are none.
        """
        self._recipe = recipe
        self._library: KernelLibrary | None = None
        self._key = ""
        self._order: Order | None = None
        self._given_up = False
        self._owed = 0.0

    def library(self) -> KernelLibrary | None:
        """Return the library, or nothing as long as it is not there."""
        if self._library is None and not self._given_up:
            self._try(self._look)
        return self._library

    def owe(self, seconds: float) -> None:
        """Add up what was interpreted, and ask for the library once that repays it.

        Args:
            seconds: Time that the kernels would have saved.
        """
        self._owed += seconds
        if self._owed > _REPAYS and self._order is None and self._library is None:
            self._try(self._ask)

    @contextmanager
    def owing(self) -> Generator[None]:
        """Add up the time of what a library would make needless, such as formulas."""
        started = time.perf_counter()
        yield
        self.owe(time.perf_counter() - started)

    def build(self) -> bool:
        """Make the library now, wait for it, and return True if it is there."""
        if self.library() is None:
            self._try(self._ask_and_wait)
        return self._library is not None

    @property
    def is_ordered(self) -> bool:
        """True if another process makes the library."""
        return self._order is not None and self._library is None

    def _look(self) -> None:
        if self._recipe is None:
            self._given_up = True
        elif not self._key:
            _used.append(self)
            when, compiler = when_to_compile(), usable_compiler()
            if when is When.NEVER or compiler is None:
                self._given_up = True
                return
            self._key = key_of(self._recipe, compiler)
            self._library = self._found()
            if self._library is None and when is When.WAIT:
                self._ask_and_wait()
        elif self._order is not None and self._order.due():
            over = self._order.is_over()
            self._library = self._found()
            if over and self._library is None:
                self._given_up = True

    def _found(self) -> KernelLibrary | None:
        folder = kernel_folder()
        path = folder.find(self._key)
        if path is not None:
            return KernelLibrary(path)
        failure = folder.failure_of(self._key)
        if failure.is_file() and not folder.job_of(self._key).exists():
            raise KernelError(failure.read_text(encoding="utf-8").strip())
        return None

    def _ask(self) -> None:
        compiler = usable_compiler()
        if compiler is not None and self._recipe is not None and not self._given_up:
            self._order = Order.placed(kernel_folder(), self._key, self._recipe.plain(), compiler)

    def _ask_and_wait(self) -> None:
        self._ask()
        if self._order is not None:
            self._order.wait()
            self._library = self._found()

    def _try(self, step: Callable[[], None]) -> None:
        """Take a step towards the library; what goes wrong is told once, and is the last try."""
        try:
            step()
        except KernelError as error:
            self._given_up = True
            _complaints.setdefault(str(error), None)


_complaints: dict[str, None] = {}
_used: list[Kernels] = []


def complaints() -> list[str]:
    """Return why kernels are not used in this process, one clause each; mostly there are none."""
    return list(_complaints)


def account() -> str:
    """Return in one clause how steps were taken in this process, and why; empty if none were.

    The default engine takes compiled steps wherever it can: where heyoka is there, too, Taylor's
    method takes as long, and a second more of compiling in the process that waits for it.
    """
    if not _used:
        return ""
    said = _how_and_why()
    if find_spec("heyoka") is None:
        return said
    if said.startswith(_INTERPRETED):
        return f"{said}; in long runs `--engine taylor` is several times as fast"
    return f"{said}; compiled, they are as fast as `--engine taylor`, and sooner ready"


_INTERPRETED = "steps are interpreted"


def _how_and_why() -> str:
    if when_to_compile() is When.NEVER:
        return f"{_INTERPRETED}, as ZENO_ORBITS_COMPILE=never asks"
    if complaints():
        return f"{_INTERPRETED}: {complaints()[0]}"
    compiler = usable_compiler()
    if compiler is None:
        install = "install cc, gcc or clang, or run `pip install 'zeno_orbits[compiled]'`"
        return f"{_INTERPRETED}: there is no C compiler ({install})"
    there = sum(kernels.library() is not None for kernels in _used)
    ordered = sum(kernels.is_ordered for kernels in _used)
    by = f"compiled by {compiler.command[0]}"
    if there == len(_used):
        return f"steps are {by}"
    why = f"the rest took less than {_REPAYS:g} s, which repays no compiling"
    if ordered:
        why = f"{ordered} more are being compiled for the next run"
    return f"steps of {there} of {len(_used)} flows are {by}; {why}"


@cache
def usable_compiler() -> Compiler | None:
    """Return the compiler of this machine, if any; a `CC` that names none is a complaint."""
    try:
        return find_compiler()
    except KernelError as error:
        _complaints.setdefault(str(error), None)
        return None


def key_of(recipe: Recipe, compiler: Compiler) -> str:
    """Return a digest of all that a library depends on."""
    parts = (json.dumps(recipe.plain()), compiler.identity, _writers())
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]


@cache
def _writers() -> str:
    """Return a digest of the code that writes kernels, CasADi's own by its version."""
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256(ca.CasadiMeta.version().encode())
    for folder in _WRITERS:
        for file in sorted((package / folder).iterdir()):
            if file.suffix in {".py", ".c"}:
                digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()
