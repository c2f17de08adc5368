"""Identities of formulas, tested at random points modulo a random prime.

A formula is a rational function of its inputs and of the values of its transcendental functions,
with exact binary constants. These values are treated as independent unknowns, except for
``sin^2 + cos^2 = 1`` and ``y^2 = u`` for a root ``y`` of ``u``. The identity is then stronger than
required.

Roots. The ring of rational functions with ``y^2 = u`` is a field only if ``u`` is not a square in
it. Otherwise a false identity, such as ``sqrt(s^2) = s``, holds for one of two signs at every
point. So each root is rejected until a point is found at which all earlier roots have values modulo
a prime and its radicand is not a square modulo that prime. A square of the field before the root
would be a square at this point, so the root extends the field. All roots together then generate a
field.

If an identity does not hold, its norm over that field is a nonzero rational function of the inputs.
Its numerator has a degree below ``2^220``: the degree is below ``2^110`` for a formula, and an
impact composes two formulas. It vanishes at a random point modulo a random prime of 384 bits with a
probability below ``2^-160`` (Schwartz and Zippel), and below ``2^-100`` among the points at which
all roots have values, for up to 40 roots. The points are drawn anew, from the operating system,
each time that a certificate is checked.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping, Sequence

from zeno_orbits.proof.checker.balls import NotProved, require
from zeno_orbits.proof.checker.formulas import Graph, Row

_BITS = 384
_ROUNDS = 64
_DEGREE = 110
_DRAWS = 40
"""Number of points for each pattern of squares that the roots may have.

A root that is not a square in the earlier field is then rejected with a probability below
``e^-40``.
"""
_MOST_ROOTS = 10
"""Largest number of compared roots, including roots at moved inputs."""
_SHARE = 40
"""Number of points with the same prime."""


class _NoValueError(ValueError):
    """A point is a pole, or a root is undefined there."""


def random_prime() -> int:
    """Return a random prime ``p`` with ``p = 3 (mod 4)``, so that square roots are powers.

    It is a probable prime: a round of the test of Miller and Rabin asks for
    ``a^((p - 1) / 2) = 1`` or ``-1`` with a random base ``a``. The number that passes all rounds is
    composite with a probability below ``2^-120`` [Burthe1996]_.
    """
    while True:
        p = secrets.randbits(_BITS) | 1 << _BITS - 1 | 3
        bases = (secrets.randbelow(p - 3) + 2 for _ in range(_ROUNDS))
        if all(pow(a, p >> 1, p) in (1, p - 1) for a in bases):
            return p


class RandomPoint:
    """Values of nodes at a random point. Functions of equal arguments have equal values.

    Attributes:
        p: The prime.
        roots: Evaluated roots, in order, each with its evaluation and its node.
        lacks_root: True if the last root is undefined at the point.
    """

    def __init__(self, graph: Graph, p: int) -> None:
        """Draw a point.

        Args:
            graph: The nodes are there.
            p: A prime. All values are modulo this prime.
        """
        self._graph, self.p = graph, p
        self._inputs: dict[int, int] = {}
        self._functions: dict[tuple[str, int], int] = {}
        self._evaluations = 0
        self.roots: list[tuple[int, int]] = []
        self.lacks_root = False

    def values(self, outputs: Sequence[int], moved: Mapping[int, int] | None = None) -> list[int]:
        """Return nodes modulo the prime.

        Args:
            outputs: The nodes.
            moved: Inputs with other values than at the point, and these values.

        Raises:
            _NoValueError: If the point is a pole, or the last root is undefined there.
        """
        known, p = dict(moved or {}), self.p
        self._evaluations += 1
        for place in self._graph.needed(outputs):
            name, *given = self._graph.nodes[place]
            if place in known:
                continue
            if name == "input":
                known[place] = self._inputs.setdefault(place, secrets.randbelow(p))
            elif name == "constant":
                above, below = given[0].as_integer_ratio()
                known[place] = above * pow(below, -1, p) % p
            elif name == "function":
                known[place] = self._function(given[0], known[given[1]], place)
            else:
                a, b = known[given[0]], known[given[-1]]
                if name == "div":
                    if not b:
                        raise _NoValueError
                    b = pow(b, -1, p)
                signed = {"add": a + b, "sub": a - b, "neg": -a}
                known[place] = (signed[name] if name in signed else a * b) % p
        return [known[place] for place in outputs]

    def _function(self, name: str, u: int, place: int) -> int:
        """Return the value of a function, the same unknown for the same argument."""
        if (name, u) not in self._functions:
            p, t = self.p, secrets.randbelow(self.p)
            if name in ("sin", "cos"):
                below = pow(1 + t * t, -1, p)
                self._functions["sin", u] = 2 * t * below % p
                self._functions["cos", u] = (1 - t * t) * below % p
            elif name == "sqrt":
                self.roots.append((self._evaluations, place))
                t = pow(u, (p + 1) // 4, p)
                self.lacks_root = t * t % p != u
                if self.lacks_root:
                    raise _NoValueError
            self._functions.setdefault((name, u), t)
        return self._functions[name, u]


def at_random_point(
    graph: Graph, outputs: Sequence[int], evaluate: Callable[[RandomPoint], list[int]]
) -> list[int]:
    """Evaluate a function at a random point at which all required nodes are defined.

    Args:
        graph: The nodes are there.
        outputs: The nodes that the function evaluates. Their degree is bounded.
        evaluate: The function.
    """
    _require_low_degree(graph, outputs)
    found: list[int] | None = None
    proper, taken, drawn, p = set[tuple[int, int]](), set[tuple[int, int]](), 0, 0
    while drawn < _DRAWS << len(taken):
        p = random_prime() if drawn % _SHARE == 0 else p
        drawn, point = drawn + 1, RandomPoint(graph, p)
        try:
            values = evaluate(point)
            found = values if found is None else found
        except _NoValueError:
            if point.lacks_root:
                proper.add(point.roots[-1])
        taken.update(point.roots)
        require(len(taken) <= _MOST_ROOTS, "the formulas have too many roots to be compared")
        if found is not None and taken <= proper:
            return found
    if found is None:
        raise NotProved("the formulas are undefined at random points")
    raise NotProved("the formulas have a root of a square, or of a product of other radicands")


def _require_low_degree(graph: Graph, outputs: Sequence[int]) -> None:
    """Check that the norm of the compared formulas has a bounded degree."""
    degree: dict[int, int] = {}
    for place in graph.needed(outputs):
        name, *given = graph.nodes[place]
        if name in ("add", "sub", "mul", "div", "neg"):
            degree[place] = sum(degree[a] for a in given)
        elif name == "function":
            degree[place] = max(2, degree[given[1]]) if given[0] == "sqrt" else 2
        else:
            degree[place] = name != "constant"
        require(degree[place] << _MOST_ROOTS < 1 << _DEGREE, "the formulas are nested too deeply")


def require_impacts(
    graph: Graph,
    x: Sequence[int],
    direction: Row,
    *,
    gap: int,
    rate: int,
    rows: Sequence[int],
    beside: Sequence[tuple[int, int]] = (),
) -> None:
    """Check that a change of the state by ``-s D``, of any size ``s``, changes the gap rate alone.

    It drops by ``s``. The gap stays, and so do the constraint rows.

    Args:
        graph: The nodes are there.
        x: Inputs of the state.
        direction: ``D``, with None for zero entries.
        gap: The gap.
        rate: The gap rate.
        rows: The constraint rows.
        beside: Gap rate of each other stop, and its change per unit change of the gap rate.
    """
    size, struck = graph.put("input"), [node for node in direction if node is not None]
    others, pushed = [one for one, _ in beside], [along for _, along in beside]
    nodes = [gap, rate, *rows, *others, *pushed]
    first = 2 + len(rows)

    def evaluate(point: RandomPoint) -> list[int]:
        s, *found = point.values([size, *x, *struck, *nodes])
        drops = iter(found[len(x) :])
        moved = {
            place: (value - s * next(drops)) % point.p
            for place, value, along in zip(x, found, direction, strict=False)
            if along is not None
        }
        before = found[len(x) + len(struck) :]
        before[1] = (before[1] - s) % point.p
        for k in range(len(beside)):
            moved_by = s * before[first + len(beside) + k]
            before[first + k] = (before[first + k] - moved_by) % point.p
        return [*before, *point.values(nodes, moved)]

    found = at_random_point(graph, [*nodes, *struck], evaluate)
    what = ["its impacts change the gap", "its impacts change the gap rate in another way"]
    what += [f"constraint {k} is not kept at an impact" for k in range(len(rows))]
    what += ["its impacts change another gap rate in another way"] * 2 * len(beside)
    for told, before, after in zip(what, found, found[len(nodes) :], strict=False):
        require(before == after, told)


def require_kept(graph: Graph, rows: Sequence[int], rates: Sequence[int]) -> None:
    """Check that the rate of each constraint row is zero or another row.

    Then all rows solve a linear equation, and stay zero along the free flow. The same holds along
    the constrained flow, which differs from the free flow by a multiple of the impulse direction.
    The impulse does not change the rows.

    Args:
        graph: The nodes are there.
        rows: The rows.
        rates: Rates of the rows along the free flow.
    """
    both = [*rows, *rates]
    found = at_random_point(graph, both, lambda point: point.values(both))
    for k, rate in enumerate(found[len(rows) :]):
        known = rate in (0, *found[: len(rows)])
        what = f"constraint {k} is not shown to be kept: its rate along the free flow"
        require(known, f"{what} is neither zero nor another constraint")


def without_zeros(graph: Graph, row: Row) -> Row:
    """Return a row of nodes with None for those that are zero for all inputs.

    Args:
        graph: The nodes are there.
        row: The nodes.
    """
    given = [graph.zero if node is None else node for node in row]
    found = at_random_point(graph, given, lambda point: point.values(given))
    return [node if value else None for node, value in zip(row, found, strict=True)]


def are_equal(graph: Graph, left: Sequence[int], right: Sequence[int]) -> bool:
    """Return True if two lists of nodes are the same functions of the inputs.

    Args:
        graph: The nodes are there.
        left: Nodes.
        right: Nodes to compare with.
    """
    both = [*left, *right]
    found = at_random_point(graph, both, lambda point: point.values(both))
    return found[: len(left)] == found[len(left) :]
