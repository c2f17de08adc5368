"""The checker's arithmetic: exact rational numbers stay in its balls, and roots in its discs."""

from __future__ import annotations

import math
import operator
import random
from collections.abc import Callable
from fractions import Fraction
from types import SimpleNamespace

import mpmath as mp
import numpy as np
import pytest

from tests.support.cases import fast
from zeno_orbits.errors import InputError
from zeno_orbits.proof.checker import identities, lanes
from zeno_orbits.proof.checker.balls import Ball, NotProved, exactly, linear_solution
from zeno_orbits.proof.checker.formulas import Graph
from zeno_orbits.proof.checker.identities import are_equal, random_prime
from zeno_orbits.proof.checker.lanes import Lanes, matmul, require_rounding
from zeno_orbits.proof.checker.polynomials import Polys, composed, monomials
from zeno_orbits.proof.checker.series import (
    complex_values,
    function_at,
    interval,
    taylor,
    upper,
)

BITS = 20
"""Few, so that a rounding to the wrong side is soon seen."""
OPERATIONS = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
}


def _some(chance: random.Random) -> tuple[Ball, Fraction]:
    """Return a ball and a number in it, often at its end."""
    ball = Ball(chance.randint(-(2**22), 2**22), chance.choice([0, 1, 7, 2**10]), BITS)
    offset = Fraction(chance.choice([-1, 1, 0, chance.randint(-9, 9)]), chance.choice([1, 9]))
    within = max(-1, min(1, offset))
    return ball, (ball.m + within * ball.r) / Fraction(2**BITS)


def _holds(ball: Ball, value: Fraction) -> bool:
    return ball.low <= value * 2**ball.bits <= ball.high


@pytest.mark.parametrize("name", OPERATIONS)
def test_an_operation_on_numbers_stays_in_that_on_balls(name: str) -> None:
    chance, apply, done = random.Random(1), OPERATIONS[name], 0
    while done < 2000:
        (a, x), (b, y) = _some(chance), _some(chance)
        if name == "div" and abs(b.m) <= b.r:
            with pytest.raises(NotProved):
                apply(a, b)
            continue
        assert _holds(apply(a, b), apply(x, y))
        done += 1


def test_coefficients_of_products_and_quotients_hold_exact_ones() -> None:
    graph = Graph()
    x, y = graph.put("input"), graph.put("input")
    product, quotient = graph.put("mul", x, y), graph.put("div", x, y)
    three = graph.put("constant", 3.0)
    chance = random.Random(2)
    for _ in range(50):
        (a, u), (b, v) = _some(chance), _some(chance)
        if abs(b.m) < 2**18:
            continue
        # x' = y, y' = 3: x = u + v t + 3/2 t^2, y = v + 3 t.
        # A state that moves by a node has its coefficients, one order later.
        h, z = Ball(2**BITS, 0, BITS), [x, y, graph.put("input"), graph.put("input")]
        start = {x: a, y: b} | dict.fromkeys(z[2:], Ball(0, 0, BITS))
        found = taylor(graph, z, [y, three, product, quotient], start, h, 4)
        exact_x, exact_y = [u, v, Fraction(3, 2), Fraction(0)], [v, Fraction(3), Fraction(0)]
        exact_y.append(Fraction(0))
        ratio: list[Fraction] = []
        for k in range(4):
            mixed = sum(exact_x[j] * exact_y[k - j] for j in range(k + 1))
            rest = exact_x[k] - sum(ratio[j] * exact_y[k - j] for j in range(k))
            ratio.append(rest / exact_y[0])
            assert _holds(found[0][k], exact_x[k])
            assert _holds(found[2][k + 1] * (k + 1), Fraction(mixed))
            assert _holds(found[3][k + 1] * (k + 1), ratio[k])


FUNCTIONS: dict[str, Callable[..., mp.mpf]] = {
    name: getattr(mp, name) for name in ("sin", "cos", "exp", "log", "sqrt", "atan", "tanh")
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_series_of_a_function_hold_its_derivatives(name: str) -> None:
    graph = Graph()
    x, one = graph.put("input"), graph.put("constant", 1.0)
    f = graph.function(name, x)
    start = Ball(3 << (60 - 2), 1 << 20, 60)
    series = _along(graph, f, {x: start}, [x], [one])
    with mp.workdps(50):
        for end in (start.low, start.m, start.high):
            at = mp.mpf(end) / 2**60
            for ball, exact in zip(series, mp.taylor(FUNCTIONS[name], at, 6), strict=True):
                assert ball.low <= exact * 2**60 <= ball.high


def _along(
    graph: Graph, f: int, starts: dict[int, Ball], z: list[int], rates: list[int | None]
) -> list[Ball]:
    """Return seven coefficients of a node: those of its integral, each times its order."""
    integral, h = graph.put("input"), Ball(1 << 60, 0, 60)
    starts = {**starts, integral: Ball(0, 0, 60)}
    found = taylor(graph, [*z, integral], [*rates, f], starts, h, 7)[-1]
    return [ball * (k + 1) for k, ball in enumerate(found[1:])]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_series_hold_derivatives_where_some_numbers_do_not_move(name: str) -> None:
    graph = Graph()
    x, c = graph.put("input"), graph.put("input")
    one, f = graph.put("constant", 1.0), graph.function(name, c)
    # (f(c) x + c) / f(c x) + f(f(c) + 1), at c = 5/4 and x = 2.
    top = graph.put("add", graph.put("mul", f, x), c)
    ratio = graph.put("div", top, graph.function(name, graph.put("mul", x, c)))
    whole = graph.put("add", ratio, graph.function(name, graph.put("add", f, one)))
    starts = {x: Ball(2 << 60, 0, 60), c: Ball(5 << 58, 0, 60)}
    found = _along(graph, whole, starts, [x, c], [one, None])
    g = FUNCTIONS[name]

    def exact(t: mp.mpf) -> mp.mpf:
        fixed = g(mp.mpf("1.25"))
        return (fixed * t + mp.mpf("1.25")) / g(t * mp.mpf("1.25")) + g(fixed + 1)

    with mp.workdps(60):
        for ball, coefficient in zip(found, mp.taylor(exact, 2, 6), strict=True):
            assert ball.low <= coefficient * 2**60 <= ball.high
            assert ball.r < 2**24


def test_the_same_operation_has_one_node_and_inputs_are_each_their_own() -> None:
    graph = Graph()
    x, y = graph.put("input"), graph.put("input")
    assert x != y
    assert graph.put("mul", x, y) == graph.put("mul", x, y) != graph.put("mul", y, x)
    assert graph.function("sin", x) == graph.function("sin", x) != graph.function("sin", y)


@pytest.mark.parametrize("name", ["log", "sqrt"])
def test_a_function_is_refused_where_it_is_not_analytic(name: str) -> None:
    with pytest.raises(NotProved):
        function_at(name, Ball(5, 5, BITS))
    graph = Graph()
    x = graph.put("input")
    with pytest.raises(NotProved):
        complex_values(graph, {x: (Ball(5, 0, 3), Ball(5, 0, 3))}, [graph.function(name, x)])


@pytest.mark.parametrize("name", ["sin", "cos", "exp", "log", "sqrt"])
def test_values_on_a_disc_stay_in_the_complex_bounds(name: str) -> None:
    graph = Graph()
    x = graph.put("input")
    shifted = graph.put("div", graph.function(name, x), graph.put("add", x, x))
    (found,) = complex_values(graph, {x: (Ball(3, 0, 1), Ball(1, 0, 1))}, [shifted])
    for angle in np.linspace(0, 6.28, 60):
        z = mp.mpc(1.5) + 0.5 * mp.expjpi(angle / mp.pi)
        value = getattr(mp, name)(z) / (2 * z)
        assert value.real in found.real
        assert value.imag in found.imag


def test_a_complex_division_by_a_disc_around_zero_is_refused() -> None:
    graph = Graph()
    x = graph.put("input")
    inverse = graph.put("div", graph.put("constant", 1.0), x)
    with pytest.raises(NotProved, match="unbounded"):
        complex_values(graph, {x: (Ball(1, 0, 3), Ball(2, 0, 3))}, [inverse])


def test_an_inverse_holds_the_exact_one_and_a_singular_matrix_has_none() -> None:
    numbers = np.array([[2, 1, 0], [1, 3, 1], [0, 1, 5]])
    ones = exactly(np.eye(3, dtype=int), BITS)
    found = linear_solution(exactly(numbers, BITS), ones)
    exact = [[14, -5, 1], [-5, 10, -2], [1, -2, 5]]
    for i in range(3):
        for j in range(3):
            assert _holds(found[i, j], Fraction(exact[i][j], 23))
    with pytest.raises(NotProved):
        linear_solution(exactly(np.array([[1, 2, 0], [2, 4, 0], [0, 0, 1]]), BITS), ones)


def test_a_ball_becomes_an_interval_that_holds_it() -> None:
    ball = Ball(3**900, 5, 150)
    ends = interval(ball)
    low, high = (Fraction(*mp.libmp.to_rational(end)) for end in ends._mpi_)
    # The ball has more bits than the interval: both ends are rounded, each to its side.
    assert low < Fraction(ball.low, 2**150)
    assert high > Fraction(ball.high, 2**150)
    assert high - low < Fraction(3**900, 2**1150)


def test_an_interval_of_bounds_becomes_a_whole_number_of_units_above_it() -> None:
    for bound in (Fraction(1, 3), Fraction(0), Fraction(3**200, 7)):
        ends = mp.iv.mpf(bound.numerator) / bound.denominator
        assert upper(ends, BITS).m >= bound * 2**BITS
        assert upper(ends, BITS).m <= bound * 2**BITS * (1 + Fraction(1, 2**50)) + 2


@pytest.mark.parametrize(
    "bound",
    [(0, mp.inf), (-mp.inf, mp.inf), (1, mp.nan), (-2, -1), (-1, 1), (0, mp.mpf(2) ** 9999)],
)
def test_a_bound_that_is_none_is_refused(bound: tuple[mp.mpf, mp.mpf]) -> None:
    with pytest.raises(NotProved, match=r"a bound (exceeds|is)"):
        upper(mp.iv.make_mpf(tuple(mp.mpf(end)._mpf_ for end in bound)), BITS)


def test_a_bound_by_a_difference_that_rounds_to_zero_is_refused() -> None:
    with pytest.raises(NotProved, match="exceeds the largest number"):
        upper(1 / (mp.iv.mpf([1, 1 + 2**-52]) - 1), BITS)


@pytest.mark.parametrize("bits", [53, 64, 113])
def test_hardware_numbers_of_one_unit_of_rounding_are_known(bits: int) -> None:
    require_rounding(SimpleNamespace(nmant=bits - 1, eps=2.0 ** (1 - bits)))


@pytest.mark.parametrize(("nmant", "eps"), [(105, 2.0**-105), (106, 2.0**-1074), (63, 2.0**-52)])
def test_pairs_of_doubles_are_refused_in_one_line(nmant: int, eps: float) -> None:
    with pytest.raises(InputError, match="this one has") as refusal:
        require_rounding(SimpleNamespace(nmant=nmant, eps=eps))
    assert "\n" not in str(refusal.value)


def test_a_sum_longer_than_its_bound_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def product(n: int) -> Lanes:
        return matmul(Lanes(np.ones((1, n)), 0 * np.ones((1, n))), Lanes(np.ones((n, 1)), 0.0))

    # As with a unit of rounding of 2^-53.
    monkeypatch.setattr(lanes, "MOST_TERMS", 4096)
    assert product(4000).r[0, 0] < 1e-9
    with pytest.raises(NotProved, match="the rounding of 5000 products"):
        product(5000)


@pytest.mark.slow
@pytest.mark.parametrize("bits", [64, 224])
def test_functions_of_large_arguments_are_enclosed(bits: int) -> None:
    # mpmath rounds an end in the wrong direction for about one argument in 10000. An exponential
    # has more bits than its argument, so that such an error is many units of the ball. The second
    # argument is one of those at 224 bits.
    random.seed(20261123)
    arguments = [0.5, 201.60786671930666, 650.0, -650.0]
    arguments += [random.uniform(90, 110) for _ in range(3000)]
    with mp.workprec(3000):
        for u in arguments:
            unit = Ball(int(Fraction(u) * 2**bits), 0, bits)
            for name in ("exp", "sin", "atan"):
                found = function_at(name, unit)
                truth = getattr(mp, name)(mp.mpf(unit.low) / 2**bits) * mp.mpf(2) ** bits
                assert found.low <= truth <= found.high, (name, u)


def test_monomials_of_many_variables_are_counted_without_listing_all_powers() -> None:
    of = monomials(21, 2)
    assert of.n == math.comb(23, 2)
    assert sum(of.exponents[-1]) == 2


def _polynomial(chance: random.Random) -> Polys:
    """Return a polynomial of two variables and degree 3, with a remainder, away from zero."""
    of = monomials(2, 3)
    c = np.array(
        [[chance.uniform(-1.0, 1.0) * 2.0 ** chance.randint(-30, -12) for _ in range(of.n)]]
    )
    c[0, 0] = chance.uniform(1.0, 2.0)
    return Polys(of, c.astype(lanes.REAL), np.array([2.0**-20], lanes.REAL))


def _exact(x: Polys, at: tuple[Fraction, Fraction]) -> Fraction:
    """Return the value of a polynomial without its remainder."""
    total = Fraction(0)
    for c, (i, j) in zip(x.c[0], x.of.exponents, strict=True):
        first = float(c)
        total += (Fraction(first) + Fraction(float(c - first))) * at[0] ** i * at[1] ** j
    return total


@pytest.mark.parametrize("name", ["mul", "sin", "exp", "log", "sqrt", ""])
def test_a_value_of_polynomials_stays_within_the_remainder_of_the_result(name: str) -> None:
    chance = random.Random(4)
    with mp.workdps(40):
        for _ in range(20):
            x, y = _polynomial(chance), _polynomial(chance)
            found = x * y if name == "mul" else composed(name, x)
            at = (Fraction(chance.choice([-1, 1])), Fraction(chance.randint(-8, 8), 8))
            rest = chance.choice([-1, 1]) * mp.mpf(2) ** -20
            u, v = (mp.fraction(*_exact(one, at).as_integer_ratio()) + rest for one in (x, y))
            truth = {"mul": u * v, "": 1 / u}[name] if name in ("mul", "") else getattr(mp, name)(u)
            miss = abs(truth - mp.fraction(*_exact(found, at).as_integer_ratio()))
            assert miss <= float(found.r[0])
            # The remainder is a small multiple of those of the arguments.
            assert float(found.r[0]) < 16 * 2.0**-20


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
    fast(2, [_root_squared, _conjugate, _same_radicand, _nested, _length_of_a_turned_vector]),
)
def test_a_true_identity_between_positive_roots_is_always_accepted(
    identity: Callable[[Graph], tuple[int, int]],
) -> None:
    for _ in range(8):
        graph = Graph()
        left, right = identity(graph)
        assert are_equal(graph, [left], [right])


@pytest.mark.slow
def test_a_modulus_is_a_prime_by_a_proof_of_primality() -> None:
    flint = pytest.importorskip("flint")
    for _ in range(3):
        p = random_prime()
        assert p.bit_length() == 384
        assert p % 4 == 3
        assert flint.fmpz(p).is_prime()


def test_a_product_of_two_primes_that_passes_fixed_bases_is_no_modulus(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A strong pseudoprime to the bases 2, 3, 5 and 7, with the remainder 3 modulo 4.
    composite = 3215031751
    assert composite % 4 == 3
    assert all(pow(a, composite >> 1, composite) in (1, composite - 1) for a in (2, 3, 5, 7))
    drawn = iter([composite, 10007])
    monkeypatch.setattr(identities, "_BITS", 1)
    monkeypatch.setattr(identities.secrets, "randbits", lambda _: next(drawn))
    assert random_prime() == 10007
