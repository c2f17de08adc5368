"""The library of the loop: of an installed package, or built once into the user's cache.

A single library serves all problems. A source tree, which holds no library, takes the library of an
installed package of the same digest. A second library may contain the compiled formulas of a single
problem, which the first one calls: that is faster and gives the same digits. A process that builds
a library holds a lock, and the library is created by renaming, so two processes that start at once
do not conflict. Without a compiler the library is missing, and the plain Python simulator is used.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

from zeno_orbits.errors import InputError, KernelError
from zeno_orbits.loop.binding import declared
from zeno_orbits.loop.compiler import Compiler, find_compiler
from zeno_orbits.loop.folder import LibraryFolder, library_folder
from zeno_orbits.loop.source import (
    FLAGS,
    LIBRARIES,
    library_name,
    source_digest,
    whole_source,
)
from zeno_orbits.work import BUILD_WATCH, scratch_folder, silent

VARIABLE = "ZENO_ORBITS_LOOP"
_CHOICES = ("use", "tape", "never")
"""The library with compiled formulas of a problem if available, the library with tapes alone, or
the reference in Python."""

_LIBRARY = "ZENO_ORBITS_LOOP_LIBRARY"
"""A custom library, built from the same code with other flags to detect faults."""

_KEY = "loop"

_NOTICE = "compiling the simulator once, about 15 s"
_USUAL = 15.0
"""Usual time of this compilation on a busy machine [s]."""

COMPILE = "ZENO_ORBITS_COMPILE"


class When(Enum):
    """The values of the variable ``ZENO_ORBITS_COMPILE``."""

    WAIT = "wait"
    """A library is compiled when it is first needed, and waited for. The default."""
    BACKGROUND = "background"
    """The same: the word of an earlier release."""
    NEVER = "never"
    """Existing libraries are used, but no compiler is started."""


def may_compile() -> When:
    """Return the value of the variable ``ZENO_ORBITS_COMPILE``.

    Raises:
        InputError: If it is something unknown.
    """
    chosen, known = os.environ.get(COMPILE, ""), [when.value for when in When]
    if chosen and chosen not in known:
        message = f"must be one of {', '.join(known)}, but it is `{chosen}`"
        raise InputError(f"Argument `{COMPILE}` {message}.")
    return When(chosen or When.WAIT.value)


def loop_library() -> Any:
    """Return the library as ``ctypes`` has it, or ``None`` if it cannot be had.

    Raises:
        InputError: If the variable ``ZENO_ORBITS_LOOP`` holds something unknown.
    """
    chosen = os.environ.get(VARIABLE, "") or _CHOICES[0]
    if chosen not in _CHOICES:
        known = ", ".join(_CHOICES)
        raise InputError(f"Argument `{VARIABLE}` must be one of {known}, but it is `{chosen}`.")
    return None if chosen == "never" else _found()[0]


def may_have_formulas() -> bool:
    """Return True if compiled formulas of a problem may be used."""
    return os.environ.get(VARIABLE, "") != "tape" and not os.environ.get(_LIBRARY, "")


def compiled_library(digest: str) -> Any:
    """Return the library of the formulas of one problem, or ``None`` if it is not in the cache.

    Args:
        digest: Digest of the formulas.
    """
    if not may_have_formulas():
        return None
    try:
        compiler = find_compiler()
        if compiler is None:
            return None
        path = library_folder().find(_formulas_key(digest, compiler))
        return None if path is None else ctypes.CDLL(str(path))
    except (KernelError, OSError):
        return None


def compile_library(digest: str, source: Callable[[], str]) -> None:
    """Compile the library of the formulas of one problem into the cache, unless it exists.

    Args:
        digest: Digest of the formulas.
        source: Returns the C code.

    Raises:
        KernelError: If the compilation fails. The message contains the reason.
    """
    compiler = _any_compiler()
    try:
        _kept(_formulas_key(digest, compiler), source, compiler, FLAGS)
    except OSError as error:
        raise KernelError(f"the cache cannot be written ({error.strerror})") from error


def _formulas_key(digest: str, compiler: Compiler) -> str:
    text = " ".join((digest, source_digest(), *FLAGS))
    return f"formulas_{hashlib.sha256(text.encode()).hexdigest()[:16]}_{compiler.digest}"


def loop_trouble() -> str:
    """Return the reason why executions run in Python, as a clause, or an empty string.

    The reason is empty for a process that is set to use Python.
    """
    if os.environ.get(VARIABLE, "") == "never" or not _found.cache_info().currsize:
        return ""
    return _found()[1]


def loop_account() -> str:
    """Return a clause that names the simulator of this process."""
    if os.environ.get(VARIABLE, "") == "never":
        return f"executions run in Python, as {VARIABLE}=never asks"
    library, reason = _found()
    return "executions run in compiled code" if library else f"executions run in Python: {reason}"


@cache
def _found() -> tuple[Any, str]:
    """Return the library, and the reason if it is missing."""
    try:
        chosen = os.environ.get(_LIBRARY, "")
        path = Path(chosen) if chosen else _installed() or _built()
        return declared(ctypes.CDLL(str(path))), ""
    except (KernelError, OSError) as error:
        return None, str(error)


def _installed() -> Path | None:
    """Return the library that was built with this package, or with an installed one of one digest.

    Python runs code of every folder on its path, so their libraries need no further trust.
    """
    name = library_name()
    folders = (Path(entry) / "zeno_orbits" / "loop" for entry in sys.path)
    paths = (folder / name for folder in (Path(__file__).parent, *folders))
    return next((path for path in paths if path.is_file()), None)


def _built() -> Path:
    """Return the library from the cache, built if it is not there.

    Raises:
        KernelError: If it cannot be built.
        OSError: If the cache cannot be written.
    """
    compiler = _any_compiler()
    key = f"{_KEY}_{source_digest()}_{compiler.digest}"
    return _kept(key, whole_source, compiler, FLAGS, _NOTICE)


def _any_compiler() -> Compiler:
    compiler = find_compiler()
    if compiler is None:
        install = "install cc, gcc or clang, or run `pip install 'zeno_orbits[compiled]'`"
        raise KernelError(f"a C compiler is missing ({install})")
    return compiler


def _kept(
    key: str,
    source: Callable[[], str],
    compiler: Compiler,
    flags: Sequence[str],
    notice: str = "",
) -> Path:
    """Return a library from the cache, built if it is not there, with progress if it is named."""
    folder = library_folder()
    folder.make()
    found = folder.find(key)
    if found is not None:
        return found
    if may_compile() is When.NEVER:
        raise KernelError(f"{COMPILE}=never forbids the compiler")
    with folder.held():
        return folder.find(key) or _compiled(folder, key, source(), compiler, flags, notice)


def _compiled(
    folder: LibraryFolder,
    key: str,
    source: str,
    compiler: Compiler,
    flags: Sequence[str],
    notice: str,
) -> Path:
    watch = BUILD_WATCH.get()() if notice else nullcontext(silent)
    with (
        scratch_folder(folder.path) as scratch,
        watch as on_progress,
    ):
        code, library = scratch / "loop.c", scratch / "loop.so"
        code.write_text(source, encoding="utf-8")

        def wait(seconds: float) -> None:
            on_progress(notice, min(seconds / _USUAL, 0.99))

        compiler.compile(code, library, flags=flags, libraries=LIBRARIES, on_wait=wait)
        _require_exact(library)
        return folder.store(key, library)


_FAULTS = (
    "NaN and infinity",
    "numbers too small for a full mantissa",
    "the order of sums",
    "the rounding of a product",
    "sines",
)


def _require_exact(path: Path) -> None:
    """Reject a library whose compiler uses inexact floating-point optimisations, for any flags.

    Raises:
        KernelError: If the library cannot be loaded, or its arithmetic violates the C standard.
    """
    near = 1.0 + 2.0**-30
    numbers = (math.nan, math.inf, sys.float_info.min, 1.0, 1e300, near, near * near, math.sin(1.0))
    try:
        fault = ctypes.CDLL(str(path)).zl_fault((ctypes.c_double * 8)(*numbers))
    except (OSError, AttributeError) as error:
        raise KernelError(f"the compiled library cannot be loaded ({error})") from error
    if fault:
        raise KernelError(f"the compiled library gives wrong values for {_FAULTS[fault - 1]}")
