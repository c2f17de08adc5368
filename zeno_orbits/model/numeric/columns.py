"""A CasADi function of many rows at once."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector

_LARGEST = 8
"""Number of rows of the widest mapped function, as a power of two. More rows need several calls."""
_FEW = 16
"""Rows of a block that costs hardly more than its call."""


class Columns:
    """A function called for `n` rows, through blocks of 256, 128, ... 1 rows.

    Each row is computed by the same instructions, so its result is bitwise independent of the other
    rows.
    """

    def __init__(self, function: ca.Function) -> None:
        """Take a function.

        Args:
            function: The function.
        """
        self._function = function
        self._widths_out = [function.numel_out(k) for k in range(function.n_out())]
        self._blocks: dict[int, Any] = {}

    def __call__(self, *inputs: Vector) -> tuple[Vector, ...]:
        """Return one array ``(n, n_out)`` an output.

        Args:
            inputs: One array ``(n, n_in)`` an input.
        """
        n = len(inputs[0])
        padded = _padded(n)
        given = [_filled(array, padded) for array in inputs]
        results = [np.empty((padded, width)) for width in self._widths_out]
        start, power = 0, _LARGEST
        while start < padded:
            while (1 << power) > padded - start:
                power -= 1
            stop = start + (1 << power)
            buffer, evaluate = self._block(power)
            for k, array in enumerate(given):
                buffer.set_arg(k, memoryview(array[start:stop].reshape(-1).data))
            for k, array in enumerate(results):
                buffer.set_res(k, memoryview(array[start:stop].reshape(-1).data))
            evaluate()
            start = stop
        return tuple(result[:n] for result in results)

    def _block(self, power: int) -> tuple[Any, Any]:
        if power not in self._blocks:
            mapped = self._function if power == 0 else self._function.map(1 << power, "serial")
            self._blocks[power] = mapped.buffer()
        return self._blocks[power]


def _padded(n: int) -> int:
    """Return a number of rows not below `n` that takes few blocks: a block costs some rows."""
    if n <= _FEW:
        return 1 << max(n - 1, 0).bit_length() if n else 0
    return -(-n // _FEW) * _FEW


def _filled(array: Vector, n: int) -> Vector:
    """Return the rows in contiguous memory, with the last row repeated up to `n`."""
    if len(array) == n:
        return np.ascontiguousarray(array)
    filled = np.empty((n, *array.shape[1:]))
    filled[: len(array)], filled[len(array) :] = array, array[-1]
    return filled
