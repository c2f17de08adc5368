"""The C compiler of this machine: `CC`, `cc`, `gcc`, `clang`, or the one of the extra `compiled`.

Arithmetic stays that of the interpreter: no fast-math, and no product and sum contracted into one
rounding. So NaN and infinity survive, and results agree, mostly to the last bit.
"""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from zeno_orbits.errors import KernelError

_NAMES = ("cc", "gcc", "clang")
_STRICT = ("-fno-fast-math", "-fno-unsafe-math-optimizations", "-fno-finite-math-only")
"""They come after a user's own flags: whatever those say, NaN, infinity and tiny numbers survive.
"""
_FLAGS = (*("-O1", "-fPIC", "-shared", *_STRICT), "-ffp-contract=off", "-fno-math-errno", "-w")
"""At `-O1` the kernels are as fast as at `-O2`, and compiled in two thirds of the time."""
_ZIG_FLAGS = ("-mcpu=baseline", "-fno-sanitize=undefined")
"""Zig compiles for the very processor and adds checks, unless it is told not to."""
_LIBRARIES = ("-lm",)
_LONGEST = 600.0
"""Longest time that a compiler may take [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Compiler:
    """A C compiler.

    Attributes:
        command: The words that start it, and its own flags.
        file: The program, whose size and date tell one version from another.
    """

    command: tuple[str, ...]
    file: Path

    @property
    def identity(self) -> str:
        """All that the code depends on but its source: compiler, version, flags, processor."""
        stat = self.file.stat()
        version = f"{self.file} {stat.st_size} {stat.st_mtime_ns}"
        words = (*self.command, *_FLAGS, *_LIBRARIES)
        return "\n".join((version, " ".join(words), sys.platform, platform.machine()))

    def compile(self, source: Path, target: Path) -> None:
        """Compile a source into a shared library.

        Raises:
            KernelError: If that fails; it says why.
        """
        words = [*self.command, *_FLAGS, str(source), "-o", str(target), *_LIBRARIES]
        try:
            done = subprocess.run(
                words,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_LONGEST,
                check=False,
            )
        except (OSError, subprocess.SubprocessError) as error:
            raise KernelError(f"`{self.command[0]}` could not be run ({error})") from error
        if done.returncode != 0 or not target.is_file():
            said = (done.stderr or done.stdout).strip().splitlines()
            first = next((line for line in said if "error" in line.lower()), "".join(said[:1]))
            reason = first[:200] or f"exit code {done.returncode}"
            raise KernelError(f"`{' '.join(self.command[:3])}` failed: {reason}")


def find_compiler() -> Compiler | None:
    """Return the compiler to use: that of the variable `CC`, else the first there is, if any.

    Raises:
        KernelError: If `CC` names no program.
    """
    chosen = os.environ.get("CC", "").strip()
    if chosen:
        first, *rest = shlex.split(chosen)
        place = shutil.which(first)
        if place is None:
            raise KernelError(f"`CC` must name a C compiler, but there is no program `{first}`")
        return Compiler(command=(place, *rest), file=Path(place).resolve())
    for name in _NAMES:
        place = shutil.which(name)
        if place is not None:
            return Compiler(command=(place,), file=Path(place).resolve())
    return _zig()


def _zig() -> Compiler | None:
    """Return the compiler that the package `ziglang` brings, if it is installed."""
    spec = find_spec("ziglang")
    if spec is None or spec.origin is None:
        return None
    folder = Path(spec.origin).parent
    program = next((file for file in (folder / "zig", folder / "zig.exe") if file.is_file()), None)
    if program is None:
        return None
    return Compiler(command=(str(program), "cc", *_ZIG_FLAGS), file=program)
