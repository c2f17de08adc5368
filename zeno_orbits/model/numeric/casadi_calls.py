"""CasADi functions called through memory that is allocated once: a microsecond, not thirty."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca

from zeno_orbits.arrays import Vector


def caller(
    function: ca.Function, arguments: Sequence[Vector], results: Sequence[Vector]
) -> Callable[[], None]:
    """Return a call without arguments that reads and overwrites the given arrays.

    Args:
        function: The function.
        arguments: One array per input, which is read at every call.
        results: One array per output, which is written at every call.
    """
    made: list[Callable[[], None]] = []

    def call() -> None:
        # A system at other values has a dozen of these calls, and few of them are used.
        if not made:
            made.append(_connected(function, arguments, results))
        made[0]()

    return call


def _connected(
    function: ca.Function, arguments: Sequence[Vector], results: Sequence[Vector]
) -> Callable[[], None]:
    # CasADi's stubs require a size that the call takes from the memory itself.
    buffer: Any
    buffer, evaluate = function.buffer()
    for k, argument in enumerate(arguments):
        buffer.set_arg(k, memoryview(argument.data))
    for k, result in enumerate(results):
        buffer.set_res(k, memoryview(result.data))

    def call(_kept: Any = (buffer, *arguments, *results)) -> None:
        # The default keeps buffer and arrays alive, because the trigger holds only their addresses.
        evaluate()

    return call
