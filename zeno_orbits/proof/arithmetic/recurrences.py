r"""Taylor coefficients of operations, computed in order from the coefficients of their arguments.

For :math:`c = a b`, :math:`c_k = \sum_j a_j b_{k-j}`. A function :math:`y(x)` follows from its
derivative: :math:`k y_k = \sum_j j x_j g_{k-j}` with `g` its slope [JorbaZou2005]_. Newton's method
for division and sine of whole series would be faster, but its results grow without bound on wide
balls.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import mul
from typing import Any

from zeno_orbits.proof.arithmetic.balls import ZERO, Ball

Series = list[Any]
"""Coefficients of a series, lowest power first."""
Constant = Ball | None
"""An argument that is constant along the series, or None for an argument that varies."""


def recurrence(
    name: str, x: Series, y: Series, constants: tuple[Constant, Constant], out: Series
) -> Callable[[int], None]:
    """Return the function that appends coefficient `k` of an operation to its series.

    Args:
        name: The operation.
        x: Coefficients of its first argument.
        y: Coefficients of its second argument, or of the slope for a function with a slope rule.
        constants: The arguments that are constants.
        out: Coefficients of the operation.
    """
    if name == "cos":
        return _nothing
    if name in _CONSTANT_RULES and constants != (None, None):
        return _CONSTANT_RULES[name](x, y, *constants, out)
    return _RULES[name](x, y, out) if name in _RULES else _integral(name, x, y, out)


def _nothing(k: int) -> None:
    """Append nothing, since the sine also appends the cosine."""


def _dot(x: Any, y: Any) -> Any:
    # Series of polynomials form all products together.
    return y.dot(x) if hasattr(y, "dot") else sum(map(mul, x, y), ZERO)


def _add(x: Series, y: Series, out: Series) -> Callable[[int], None]:
    return lambda k: out.append(x[k] + y[k])


def _sub(x: Series, y: Series, out: Series) -> Callable[[int], None]:
    return lambda k: out.append(x[k] - y[k])


def _neg(x: Series, _: Series, out: Series) -> Callable[[int], None]:
    return lambda k: out.append(-x[k])


def _mul(x: Series, y: Series, out: Series) -> Callable[[int], None]:
    return lambda k: out.append(_dot(x[: k + 1], y[k::-1]))


def _sq(x: Series, _: Series, out: Series) -> Callable[[int], None]:
    def step(k: int) -> None:
        half = (k + 1) // 2
        value = 2 * _dot(x[:half], x[k:0:-1])
        out.append(value if k % 2 else value + x[k // 2] * x[k // 2])

    return step


def _div(x: Series, y: Series, out: Series) -> Callable[[int], None]:
    def step(k: int) -> None:
        out.append((x[k] - _dot(y[1 : k + 1], out[::-1])) / y[0])

    return step


def _exp(x: Series, _: Series, out: Series) -> Callable[[int], None]:
    slopes: Series = []

    def step(k: int) -> None:
        if k == 0:
            out.append(x[0].exp())
            return
        slopes.append(k * x[k])
        out.append(_dot(slopes, out[::-1]) / k)

    return step


def sine_and_cosine(x: Series, sine: Series, cosine: Series) -> Callable[[int], None]:
    """Return the function that appends coefficient `k` of sine and cosine, which need each other.

    Args:
        x: Coefficients of their argument.
        sine: Coefficients of the sine.
        cosine: Coefficients of the cosine.
    """
    slopes: Series = []

    def step(k: int) -> None:
        if k == 0:
            sine.append(x[0].sin())
            cosine.append(x[0].cos())
            return
        slopes.append(k * x[k])
        following = _dot(slopes, cosine[::-1]) / k
        cosine.append(_dot(slopes, sine[::-1]) / -k)
        sine.append(following)

    return step


def _log(x: Series, _: Series, out: Series) -> Callable[[int], None]:
    slopes: Series = []

    def step(k: int) -> None:
        if k == 0:
            out.append(x[0].log())
            return
        out.append((x[k] - _dot(slopes, x[k - 1 : 0 : -1]) / k) / x[0])
        slopes.append(k * out[k])

    return step


def _sqrt(x: Series, _: Series, out: Series) -> Callable[[int], None]:
    def step(k: int) -> None:
        if k == 0:
            out.append(x[0].sqrt())
            return
        out.append((x[k] - _dot(out[1:k], out[k - 1 : 0 : -1])) / (2 * out[0]))

    return step


def _integral(name: str, x: Series, g: Series, out: Series) -> Callable[[int], None]:
    """Return the rule of a function from its derivative ``y' = x' g``, with a series ``g``."""
    slopes: Series = []

    def step(k: int) -> None:
        if k == 0:
            out.append(getattr(x[0], name)())
            return
        slopes.append(k * x[k])
        out.append(_dot(slopes, g[k - 1 :: -1]) / k)

    return step


def _add_constant(
    x: Series, y: Series, p: Constant, q: Constant, out: Series
) -> Callable[[int], None]:
    other, number = (y, p) if q is None else (x, q)
    return lambda k: out.append(other[k] if k else other[k] + number)


def _sub_constant(
    x: Series, y: Series, p: Constant, q: Constant, out: Series
) -> Callable[[int], None]:
    if q is None:
        return lambda k: out.append(-y[k] if k else p - y[k])
    return lambda k: out.append(x[k] if k else x[k] - q)


def _mul_constant(
    x: Series, y: Series, p: Constant, q: Constant, out: Series
) -> Callable[[int], None]:
    other, number = (y, p) if q is None else (x, q)
    return lambda k: out.append(number * other[k])


def _div_constant(
    x: Series, y: Series, p: Constant, q: Constant, out: Series
) -> Callable[[int], None]:
    if q is not None:
        return lambda k: out.append(x[k] / q)
    return lambda k: out.append((-_dot(y[1 : k + 1], out[::-1]) if k else p) / y[0])


_RULES = {
    "add": _add,
    "sub": _sub,
    "neg": _neg,
    "mul": _mul,
    "sq": _sq,
    "div": _div,
    "exp": _exp,
    "log": _log,
    "sqrt": _sqrt,
}
_CONSTANT_RULES = {
    "add": _add_constant,
    "sub": _sub_constant,
    "mul": _mul_constant,
    "div": _div_constant,
}
OPERATIONS = {*_RULES, "sin", "cos"}
"""Operations with a specific rule."""
SLOPES = {
    "asin": (-1, 1),
    "acos": (-1, 1),
    "atan": (1, 1),
}
"""Factor of the square and offset in the denominator of the slope, which may be under a root."""
