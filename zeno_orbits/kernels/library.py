"""A shared library of kernels, called through memory that is allocated once."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import KernelError


class KernelLibrary:
    """A loaded library. A kernel reads and writes arrays of doubles in place."""

    def __init__(self, path: Path) -> None:
        try:
            self._code = ctypes.CDLL(str(path))
        except OSError as error:
            raise KernelError(f"`{path}` cannot be loaded ({error})") from error

    def function(self, name: str) -> Any:
        """Return a C function of the library as ``ctypes`` has it."""
        return self._code[name]

    def caller(
        self, name: str, arguments: Sequence[Vector], results: Sequence[Vector]
    ) -> Callable[[], None]:
        """Return a call without arguments, as `casadi_calls.caller` does for the same function.

        Args:
            name: Name of the kernel.
            arguments: One contiguous array an input; it is read at every call.
            results: One array an output; it is written at every call.
        """
        kernel = self._code[name]
        given = (ctypes.c_void_p * len(arguments))(*(array.ctypes.data for array in arguments))
        taken = (ctypes.c_void_p * len(results))(*(array.ctypes.data for array in results))

        def call(_kept: Any = (self._code, *arguments, *results)) -> None:
            # The default keeps the arrays alive: the kernel knows their bare addresses only.
            kernel(given, taken, None, None, 0)

        return call
