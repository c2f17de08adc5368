r"""Polynomials of the start coordinates with a remainder, and their series in time.

A quantity :math:`q(s)`, :math:`s \in [-1, 1]^D`, is given by a polynomial of a fixed degree and a
radius that bounds the difference. Products add what they drop to the radius [MakinoBerz2003]_. The
numbers are doubles, and their rounding is not bounded: polynomials only propose sets, which the
checker then encloses in its own arithmetic.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement as choices
from typing import Any, cast

import numpy as np
from flint import arb

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ProofError
from zeno_orbits.proof.arithmetic.balls import Ball


@dataclass(frozen=True, slots=True)
class Basis:
    """The monomials of a number of variables up to a degree.

    Attributes:
        degree: Largest degree of a monomial.
        exponents: One row per monomial, the constant first, ``(M, D)``.
        kept: Matrix from the products of two coefficients to the coefficients of a product,
            ``(M, M * M)``.
        dropped: 1 for the products above the degree, ``(M * M,)``.
    """

    degree: int
    exponents: Any
    kept: Vector
    dropped: Vector

    @classmethod
    def of(cls, n_variables: int, degree: int) -> Basis:
        """Return the monomials up to a degree, in order of their degrees."""
        variables = range(n_variables)
        factors = (one for k in range(degree + 1) for one in choices(variables, k))
        every = (tuple(map(one.count, variables)) for one in factors)
        found = sorted(every, key=lambda one: (sum(one), one))
        place = {one: k for k, one in enumerate(found)}
        kept = np.zeros((len(found), len(found), len(found)))
        for i, a in enumerate(found):
            for j, b in enumerate(found):
                k = place.get(tuple(x + y for x, y in zip(a, b, strict=True)))
                if k is not None:
                    kept[k, i, j] = 1.0
        flat = kept.reshape(len(found), -1)
        return cls(degree, np.array(found).reshape(len(found), -1), flat, 1.0 - flat.sum(axis=0))

    @property
    def n(self) -> int:
        """Number of monomials."""
        return len(self.exponents)

    def variable(self, k: int) -> int:
        """Return the index of a variable as a monomial."""
        wanted = np.eye(self.exponents.shape[1], dtype=int)[k]
        return int(np.flatnonzero((self.exponents == wanted).all(axis=1))[0])


class Polynomial:
    """A polynomial with a remainder. Its operations also take numbers and exact balls."""

    __slots__ = ("_inverse", "basis", "c", "r")

    def __init__(self, basis: Basis, c: Vector, r: float) -> None:
        """Store coefficients, ``(M,)``, and the radius of the remainder."""
        self.basis, self.c, self.r = basis, c, r
        self._inverse: Polynomial | None = None

    @classmethod
    def constant(cls, basis: Basis, value: float, r: float = 0.0) -> Polynomial:
        """Return a constant."""
        c = np.zeros(basis.n)
        c[0] = value
        return cls(basis, c, r)

    @property
    def size(self) -> float:
        """Bound of the polynomial without its remainder."""
        return float(np.abs(self.c).sum())

    @property
    def spread(self) -> float:
        """Bound of the difference from the constant coefficient."""
        return self.size - abs(float(self.c[0])) + self.r

    @property
    def ball(self) -> Ball:
        """Range of the polynomial."""
        return arb(float(self.c[0]), self.spread)

    def reduced(self, basis: Basis) -> Polynomial:
        """Return it with the monomials of a lower degree, and the others in the remainder."""
        rest = float(np.abs(self.c[basis.n :]).sum())
        return Polynomial(basis, self.c[: basis.n], self.r + rest)

    def wider(self, r: float) -> Polynomial:
        """Return it with a larger remainder."""
        return Polynomial(self.basis, self.c, self.r + r)

    def __neg__(self) -> Polynomial:
        return Polynomial(self.basis, -self.c, self.r)

    def __add__(self, other: Any) -> Polynomial:
        if isinstance(other, Polynomial):
            return Polynomial(self.basis, self.c + other.c, self.r + other.r)
        c = self.c.copy()
        c[0] += float(other)
        return Polynomial(self.basis, c, self.r)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Polynomial:
        return self + -other

    def __rsub__(self, other: Any) -> Polynomial:
        return -self + other

    def __mul__(self, other: Any) -> Polynomial:
        if not isinstance(other, Polynomial):
            x = float(other)
            return Polynomial(self.basis, self.c * x, self.r * abs(x))
        pairs = np.outer(self.c, other.c).ravel()
        r = self.r * (other.size + other.r) + self.size * other.r
        r += float(np.abs(pairs) @ self.basis.dropped)
        return Polynomial(self.basis, self.basis.kept @ pairs, r)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Polynomial:
        if not isinstance(other, Polynomial):
            return self * (1.0 / float(other))
        return self * other.inverse()

    def __rtruediv__(self, other: Any) -> Polynomial:
        return self.inverse() * other

    def inverse(self) -> Polynomial:
        """Return the reciprocal."""
        if self._inverse is None:
            x, away, n = float(self.c[0]), self.spread, self.basis.degree + 1
            least = abs(x) - away
            if not least > 0.0:
                raise ProofError("polynomial", "a divisor may vanish on the box")
            terms = [(-1.0) ** k / x ** (k + 1) for k in range(n)]
            self._inverse = self._composed(terms, 1.0 / (abs(x) ** n * least))
        return self._inverse

    def sin(self) -> Polynomial:
        """Return the sine."""
        return self._turned(0)

    def cos(self) -> Polynomial:
        """Return the cosine."""
        return self._turned(1)

    def _turned(self, ahead: int) -> Polynomial:
        x, n = float(self.c[0]), self.basis.degree + 1
        waves = [math.sin(x), math.cos(x), -math.sin(x), -math.cos(x)]
        terms = [waves[(k + ahead) % 4] / math.factorial(k) for k in range(n)]
        return self._composed(terms, 1.0 / math.factorial(n))

    def exp(self) -> Polynomial:
        """Return the exponential."""
        x, n = float(self.c[0]), self.basis.degree + 1
        terms = [math.exp(x) / math.factorial(k) for k in range(n)]
        return self._composed(terms, math.exp(x + self.spread) / math.factorial(n))

    def log(self) -> Polynomial:
        """Return the logarithm."""
        x, n, least = float(self.c[0]), self.basis.degree + 1, self._least()
        terms = [math.log(x), *(-((-1.0) ** k) / (k * x**k) for k in range(1, n))]
        return self._composed(terms, 1.0 / (n * least**n))

    def sqrt(self) -> Polynomial:
        """Return the square root."""
        x, n, least = float(self.c[0]), self.basis.degree + 1, self._least()
        factors = [1.0]
        for k in range(n):
            factors.append(factors[-1] * (0.5 - k) / (k + 1))
        terms = [factors[k] * x ** (0.5 - k) for k in range(n)]
        return self._composed(terms, abs(factors[n]) * least ** (0.5 - n))

    def atan(self) -> Polynomial:
        """Return the arctangent."""
        x, n = float(self.c[0]), self.basis.degree + 1
        turned = [(-1.0) ** (k - 1) / k * ((x - 1j) ** -k).imag for k in range(1, n)]
        return self._composed([math.atan(x), *turned], 1.0 / n)

    def _least(self) -> float:
        least = float(self.c[0]) - self.spread
        if not least > 0.0:
            raise ProofError("polynomial", "a root or logarithm is not defined on the box")
        return least

    def _composed(self, terms: Sequence[float], last: float) -> Polynomial:
        """Return a function from its Taylor coefficients at the constant coefficient.

        Args:
            terms: The coefficients up to the degree.
            last: Bound of the next coefficient over the range.
        """
        c = self.c.copy()
        c[0] = 0.0
        away = Polynomial(self.basis, c, self.r)
        found = Polynomial.constant(self.basis, terms[-1])
        for one in terms[-2::-1]:
            found = found * away + one
        return found.wider(last * self.spread ** len(terms))


class PolynomialSeries:
    """Coefficients in time, each a polynomial. It is a list for the rules of `recurrences`."""

    __slots__ = ("_first", "basis", "c", "n", "r", "s")

    def __init__(self, basis: Basis, capacity: int) -> None:
        """Make room for a number of coefficients."""
        self.basis, self.n = basis, 0
        self.c = np.zeros((capacity, basis.n))
        self.r, self.s = np.zeros(capacity), np.zeros(capacity)
        self._first: Polynomial | None = None

    def __len__(self) -> int:
        return self.n

    def append(self, one: Any) -> None:
        """Append a coefficient: a polynomial, or a number."""
        if isinstance(one, Polynomial):
            self.c[self.n], self.r[self.n] = one.c, one.r
        else:
            self.c[self.n, 0] = float(one)
        self.s[self.n] = np.abs(self.c[self.n]).sum()
        self.n += 1

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, slice):
            part = range(self.n)[key]
            stop = part.stop if part.stop >= 0 else None
            view = slice(part.start, stop, part.step) if len(part) else slice(0, 0)
            return PolynomialBlock(self.basis, self.c[view], self.r[view], self.s[view])
        if key == 0:
            # Its reciprocal is needed at every order.
            if self._first is None:
                self._first = Polynomial(self.basis, self.c[0], float(self.r[0]))
            return self._first
        return Polynomial(self.basis, self.c[key], float(self.r[key]))

    @property
    def balls(self) -> list[Ball]:
        """Ranges of the coefficients."""
        away = self.s - np.abs(self.c[:, 0]) + self.r
        return [arb(float(x), float(r)) for x, r in zip(self.c[: self.n, 0], away, strict=False)]


class PolynomialBlock:
    """Successive coefficients of a series."""

    __slots__ = ("basis", "c", "r", "s")

    def __init__(self, basis: Basis, c: Vector, r: Vector, s: Vector) -> None:
        """Store coefficients, radii and sizes without copying them."""
        self.basis, self.c, self.r, self.s = basis, c, r, s

    def dot(self, others: Any) -> Polynomial:
        """Return the sum of the products with as many other coefficients."""
        if isinstance(others, list):
            given = cast("list[Polynomial]", others)
            c: Any = np.array([one.c for one in given]).reshape(-1, self.basis.n)
            r: Any = np.array([one.r for one in given])
            s: Any = np.abs(c).sum(axis=1)
        else:
            c, r, s = others.c, others.r, others.s
        n = min(len(c), len(self.c))
        pairs = (c[:n].T @ self.c[:n]).ravel()
        off = s[:n] @ self.r[:n] + r[:n] @ (self.s[:n] + self.r[:n])
        off += np.abs(pairs) @ self.basis.dropped
        return Polynomial(self.basis, self.basis.kept @ pairs, float(off))
