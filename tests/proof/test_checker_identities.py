"""Identities of formulas: true ones are accepted, those that hold for one sign of a root never."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from zeno_orbits.proof.checker.balls import NotProved
from zeno_orbits.proof.checker.formulas import Graph
from zeno_orbits.proof.checker.identities import are_equal


def _accepted(graph: Graph, left: int, right: int) -> bool:
    try:
        return are_equal(graph, [left], [right])
    except NotProved:
        return False


def _sum(graph: Graph) -> tuple[int, int]:
    """Return ``a + b`` and its square, multiplied out."""
    a, b = graph.put("input"), graph.put("input")
    mixed = graph.put("mul", a, b)
    ends = graph.put("add", graph.put("mul", a, a), graph.put("mul", b, b))
    return graph.put("add", a, b), graph.put("add", ends, graph.put("add", mixed, mixed))


def _root_of_a_square(graph: Graph) -> tuple[int, int]:
    s, square = _sum(graph)
    return graph.function("sqrt", square), s


def _root_of_a_square_divided(graph: Graph) -> tuple[int, int]:
    s, square = _sum(graph)
    return graph.put("div", graph.function("sqrt", square), s), graph.one


def _one_of_two_signs(graph: Graph) -> tuple[int, int]:
    """Return ``(sqrt(s^2) - s) (sqrt(t^2) - t)`` and zero: it holds for three signs of four."""
    differences = list[int]()
    for _ in range(2):
        s, square = _sum(graph)
        differences.append(graph.put("sub", graph.function("sqrt", square), s))
    return graph.put("mul", *differences), graph.zero


def _roots_of_a_product_that_is_a_square(graph: Graph) -> tuple[int, int]:
    """Return ``sqrt(s) sqrt(s t^2)`` and ``s t``, which differ in sign if ``t`` is negative."""
    s, t = graph.put("input"), graph.put("input")
    scaled = graph.put("mul", graph.put("mul", s, t), t)
    roots = graph.put("mul", graph.function("sqrt", s), graph.function("sqrt", scaled))
    return roots, graph.put("mul", s, t)


def _root_of_a_sine(graph: Graph) -> tuple[int, int]:
    """Return ``sqrt(1 - sin^2)`` and the cosine, which may be negative."""
    x = graph.put("input")
    sine = graph.function("sin", x)
    rest = graph.put("sub", graph.one, graph.put("mul", sine, sine))
    return graph.function("sqrt", rest), graph.function("cos", x)


def _two_roots_of_other_sums(graph: Graph) -> tuple[int, int]:
    """Return ``sqrt(a) + sqrt(b)`` and ``sqrt(a + b)``."""
    a, b = graph.put("input"), graph.put("input")
    left = graph.put("add", graph.function("sqrt", a), graph.function("sqrt", b))
    return left, graph.function("sqrt", graph.put("add", a, b))


@pytest.mark.slow
@pytest.mark.parametrize(
    "identity",
    [
        _root_of_a_square,
        _root_of_a_square_divided,
        _one_of_two_signs,
        _roots_of_a_product_that_is_a_square,
        _root_of_a_sine,
        _two_roots_of_other_sums,
    ],
)
def test_a_false_identity_between_roots_is_never_accepted(
    identity: Callable[[Graph], tuple[int, int]],
) -> None:
    # A random sign would accept all but the last in half of all trials or more: 2^-40 to miss it.
    trials = 40 if identity is _root_of_a_square else 12
    for _ in range(trials):
        graph = Graph()
        left, right = identity(graph)
        assert not _accepted(graph, left, right)


def _root_squared(graph: Graph) -> tuple[int, int]:
    x = graph.put("input")
    root = graph.function("sqrt", x)
    return graph.put("mul", root, root), x


def _conjugate(graph: Graph) -> tuple[int, int]:
    """Return ``1 / (sqrt(a) + sqrt(b))`` and ``(sqrt(a) - sqrt(b)) / (a - b)``."""
    a, b = graph.put("input"), graph.put("input")
    x, y = graph.function("sqrt", a), graph.function("sqrt", b)
    left = graph.put("div", graph.one, graph.put("add", x, y))
    return left, graph.put("div", graph.put("sub", x, y), graph.put("sub", a, b))


def _same_radicand(graph: Graph) -> tuple[int, int]:
    """Return roots of ``(a + b)^2 + 1`` in two forms."""
    s, square = _sum(graph)
    first = graph.put("add", graph.put("mul", s, s), graph.one)
    second = graph.put("add", square, graph.one)
    return graph.function("sqrt", first), graph.function("sqrt", second)


def _nested(graph: Graph) -> tuple[int, int]:
    """Return ``sqrt(1 + sqrt(x))^4`` and ``1 + 2 sqrt(x) + x``."""
    x = graph.put("input")
    root = graph.function("sqrt", x)
    outer = graph.function("sqrt", graph.put("add", graph.one, root))
    square = graph.put("mul", outer, outer)
    right = graph.put("add", graph.put("add", graph.one, x), graph.put("add", root, root))
    return graph.put("mul", square, square), right


def _length_of_a_turned_vector(graph: Graph) -> tuple[int, int]:
    """Return the lengths of a vector before and after a turn."""
    x, y, angle = (graph.put("input") for _ in range(3))
    c, s = graph.function("cos", angle), graph.function("sin", angle)
    u = graph.put("sub", graph.put("mul", c, x), graph.put("mul", s, y))
    v = graph.put("add", graph.put("mul", s, x), graph.put("mul", c, y))

    def length(a: int, b: int) -> int:
        return graph.function(
            "sqrt", graph.put("add", graph.put("mul", a, a), graph.put("mul", b, b))
        )

    return length(x, y), length(u, v)


@pytest.mark.parametrize(
    "identity",
    [_root_squared, _conjugate, _same_radicand, _nested, _length_of_a_turned_vector],
)
def test_a_true_identity_between_positive_roots_is_always_accepted(
    identity: Callable[[Graph], tuple[int, int]],
) -> None:
    for _ in range(8):
        graph = Graph()
        left, right = identity(graph)
        assert are_equal(graph, [left], [right])
