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

    def rows(
        self, name: str, strides: Sequence[int], widths: Sequence[int]
    ) -> Callable[[int, Sequence[Vector], Vector], None]:
        """Return a call of a kernel for many rows, each of which gets what it would get alone.

        Args:
            name: Name of the kernel.
            strides: Numbers from one row of an input to the next, one an input; 0 if all rows
                share it.
            widths: Numbers in a row of an output, one an output.

        Returns:
            From the number of rows, contiguous inputs, and a contiguous array for the outputs side
            by side, ``(n, sum(widths))``, to nothing.
        """
        loop, kernel = self._code["zk_rows"], self.address(name)
        n_in, n_out, whole = len(strides), len(widths), sum(widths)
        steps = (ctypes.c_longlong * (n_in + n_out))(*strides, *([whole] * n_out))
        offsets = [8 * sum(widths[:k]) for k in range(n_out)]
        addresses = ctypes.c_void_p * (n_in + n_out)
        counts = ctypes.c_longlong(n_in), ctypes.c_longlong(n_out)

        def call(n: int, given: Sequence[Vector], taken: Vector) -> None:
            base = address_of(taken)
            places = addresses(*map(address_of, given), *[base + offset for offset in offsets])
            loop(kernel, ctypes.c_longlong(n), *counts, places, steps)

        return call

    def address(self, name: str) -> ctypes.c_void_p:
        """Return the address of a kernel, for a function of the library that calls kernels."""
        return ctypes.cast(self._code[name], ctypes.c_void_p)


def address_of(array: Vector) -> int:
    """Return the address of the numbers of an array, five times faster than ``ctypes.data``."""
    if array.size and array.flags.writeable:
        memory: Any = array
        return ctypes.addressof(ctypes.c_char.from_buffer(memory))
    return array.ctypes.data
