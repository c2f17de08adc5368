"""The C code of the library as one file, and how it is compiled. It needs nothing but Python.

The build of the package runs this module by itself, before anything else is installed.
"""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path

HERE = Path(__file__).resolve().parent
MAIN = "loop.c"

STRICT = ("-fno-fast-math", "-fno-unsafe-math-optimizations", "-fno-finite-math-only")
FLAGS = (
    *("-std=c99", "-O3", "-fPIC", "-shared", "-fvisibility=hidden", *STRICT),
    *("-ffp-contract=off", "-fno-math-errno"),
)
"""Compiler flags without fused multiply-add, so that digits equal Python's digits."""

LIBRARIES = ("-lm",)

_INCLUDE = re.compile(r'^#include "(?P<name>[\w.]+)"\n', re.MULTILINE)


def whole_source(main: str = MAIN, skipped: Mapping[str, str] | None = None) -> str:
    """Return the C code of a file with its included files inserted.

    Args:
        main: The file.
        skipped: Replacement text of included files that are not inserted, by name.
    """

    def included(found: re.Match[str]) -> str:
        name = found["name"]
        return skipped[name] if skipped and name in skipped else whole_source(name, skipped)

    return _INCLUDE.sub(included, (HERE / main).read_text(encoding="utf-8"))


@cache
def source_digest() -> str:
    """Return a digest of the code and of the flags that it is compiled with."""
    text = "\n".join((whole_source(), *FLAGS))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def library_name() -> str:
    """Return the file name of the library that is built with the package."""
    suffix = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    return f"_loop-{source_digest()}{suffix}"
