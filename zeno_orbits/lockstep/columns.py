"""A CasADi function for many rows at once: what each row gets does not depend on the others."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.dynamics import Vector

_LARGEST = 8
"""Rows of the widest mapped function, as a power of two; more take several calls."""


class Columns:
    """A function called for `n` rows, through blocks of 256, 128, ... 1 rows.

    Each row goes through the same compiled instructions, so its result is the same to the last bit
    in whatever company.
    """

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        self._widths_in = [function.numel_in(k) for k in range(function.n_in())]
        self._widths_out = [function.numel_out(k) for k in range(function.n_out())]
        self._blocks: dict[int, Any] = {}

    def __call__(self, *inputs: Vector) -> tuple[Vector, ...]:
        """Return one array ``(n, n_out)`` an output.

        Args:
            inputs: One array ``(n, n_in)`` an input.
        """
        n = len(inputs[0])
        given = [np.ascontiguousarray(array) for array in inputs]
        results = [np.empty((n, width)) for width in self._widths_out]
        start, power = 0, _LARGEST
        while start < n:
            while (1 << power) > n - start:
                power -= 1
            stop = start + (1 << power)
            buffer, evaluate = self._block(power)
            for k, array in enumerate(given):
                buffer.set_arg(k, memoryview(array[start:stop].reshape(-1)))
            for k, array in enumerate(results):
                buffer.set_res(k, memoryview(array[start:stop].reshape(-1)))
            evaluate()
            start = stop
        return tuple(results)

    def _block(self, power: int) -> tuple[Any, Any]:
        if power not in self._blocks:
            mapped = self._function if power == 0 else self._function.map(1 << power, "serial")
            self._blocks[power] = mapped.buffer()
        return self._blocks[power]
