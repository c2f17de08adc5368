"""The C compiler of this machine: `CC`, else `cc`, `gcc`, `clang`, or the extra `compiled`."""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from zeno_orbits.errors import KernelError

_NAMES = ("cc", "gcc", "clang")
_ZIG_FLAGS = ("-mcpu=baseline", "-fno-sanitize=undefined")
"""By default Zig compiles for the processor of this machine and adds checks. These flags prevent
both."""
_LONGEST = 600.0
"""Longest time that a compiler may take [s]."""
_PAUSE = 0.25
"""Time between two reports of progress [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Compiler:
    """A C compiler.

    Attributes:
        command: Command of the compiler with its own flags.
        file: Executable, whose size and date distinguish versions.
    """

    command: tuple[str, ...]
    file: Path

    @property
    def identity(self) -> str:
        """All that the code depends on but its source and flags: compiler, version, processor."""
        stat = self.file.stat()
        version = f"{self.file} {stat.st_size} {stat.st_mtime_ns}"
        return "\n".join((version, " ".join(self.command), sys.platform, platform.machine()))

    @property
    def digest(self) -> str:
        """A digest of the same."""
        return hashlib.sha256(self.identity.encode()).hexdigest()[:16]

    def compile(
        self,
        source: Path,
        target: Path,
        *,
        flags: Sequence[str],
        libraries: Sequence[str],
        on_wait: Callable[[float], object],
    ) -> None:
        """Compile a source into a shared library.

        Args:
            source: The C code.
            target: The library. The compiler's temporary files are beside it.
            flags: Flags of the compiler.
            libraries: Flags that follow the source.
            on_wait: Called with the elapsed time [s] at the start and again and again until the
                end. An exception that it raises ends the compiler.

        Raises:
            KernelError: If the compilation fails. The message contains the reason.
        """
        words = [*self.command, *flags, str(source), "-o", str(target), *libraries]
        try:
            code, said = _watched(words, target.parent, on_wait)
        except (OSError, subprocess.SubprocessError) as error:
            raise KernelError(f"`{self.command[0]}` could not be run ({error})") from error
        if code != 0 or not target.is_file():
            lines = said.strip().splitlines()
            first = next((line for line in lines if "error" in line.lower()), "".join(lines[:1]))
            reason = first[:200] or f"exit code {code}"
            raise KernelError(f"`{' '.join(self.command[:3])}` failed: {reason}")


def _watched(
    words: Sequence[str], scratch: Path, on_wait: Callable[[float], object]
) -> tuple[int, str]:
    """Run a command with a folder for temporary files.

    Returns:
        Its exit code, and its errors or else its output.
    """
    started, elapsed, pipe = time.monotonic(), 0.0, subprocess.PIPE
    with subprocess.Popen(
        words,
        stdin=subprocess.DEVNULL,
        stdout=pipe,
        stderr=pipe,
        text=True,
        errors="replace",
        # A compiler that is killed leaves its temporary files.
        env={**os.environ, "TMPDIR": str(scratch)},
    ) as process:
        try:
            while True:
                on_wait(elapsed)
                try:
                    out, err = process.communicate(timeout=_PAUSE)
                except subprocess.TimeoutExpired:
                    elapsed = time.monotonic() - started
                    if elapsed > _LONGEST:
                        raise
                else:
                    return process.returncode, err or out
        except BaseException:
            process.kill()
            raise


def find_compiler() -> Compiler | None:
    """Return the compiler: from the variable `CC`, else the first available, or ``None``.

    Raises:
        KernelError: If `CC` names no program, or cannot be split into words.
    """
    chosen = os.environ.get("CC", "").strip()
    if chosen:
        try:
            first, *rest = shlex.split(chosen)
        except ValueError as error:
            raise KernelError(f"CC=`{chosen}` is not a command ({error})") from error
        place = shutil.which(first)
        if place is None:
            raise KernelError(f"`CC` must name a C compiler, but the program `{first}` is missing")
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
