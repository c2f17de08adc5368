"""Polynomials through Radau nodes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from zeno_orbits.integrators import doubled_nodes, radau_nodes, radau_scheme

ROUNDING = 1e-13


def test_two_stages_are_those_of_the_textbook() -> None:
    # [HairerWanner1996], table IV.5.5.
    nodes = radau_nodes(2)
    assert nodes.places == pytest.approx([1 / 3, 1.0], abs=ROUNDING)
    assert nodes.integral == pytest.approx(np.array([[5 / 12, -1 / 12], [3 / 4, 1 / 4]]))
    assert nodes.whole == pytest.approx([3 / 4, 1 / 4])


@pytest.mark.parametrize("n", [3, 5, 7, 9])
def test_the_matrix_of_the_scheme_is_that_of_its_nodes_to_rounding(n: int) -> None:
    # Each entry is the integral of a Lagrange polynomial of the nodes, here in exact fractions.
    # Sums of n terms below 1 err by n roundings; powers of the nodes would lose 200 at n = 7.
    scheme = radau_scheme(n)
    nodes = [Fraction(float(node)) for node in scheme.nodes]
    for j, here in enumerate(nodes):
        product = [Fraction(1)]
        for other in (*nodes[:j], *nodes[j + 1 :]):
            lower, raised = [*product, Fraction(0)], [Fraction(0), *product]
            product = [(r - other * p) / (here - other) for r, p in zip(raised, lower, strict=True)]
        for i, end in enumerate(nodes):
            exact = sum(part * end ** (k + 1) / (k + 1) for k, part in enumerate(product))
            assert abs(Fraction(float(scheme.matrix[i, j])) - exact) < n * np.finfo(float).eps


@pytest.mark.parametrize("n", [4, 8, 16])
def test_the_nodes_integrate_polynomials_of_degree_2n_minus_2(n: int) -> None:
    nodes = radau_nodes(n)
    degree = 2 * n - 2
    assert nodes.whole @ nodes.places**degree == pytest.approx(1 / (degree + 1), rel=1e-12)
    # One degree more is too much.
    if n == 4:
        missed = nodes.whole @ nodes.places ** (degree + 1) - 1 / (degree + 2)
        assert abs(missed) > 1e-6


@pytest.mark.parametrize("nodes", [radau_nodes(4), radau_nodes(16), doubled_nodes(8)])
def test_values_integrals_and_means_of_a_polynomial_are_exact(nodes) -> None:
    n = len(nodes.places)
    polynomial = np.polynomial.Chebyshev(np.random.default_rng(n).normal(size=n), domain=[0, 1])
    at, width = np.array([0.0, 0.2, 0.7, 1.0]), np.array([0.1, 0.5, 1e-3, 0.0])
    held = polynomial(nodes.places)
    antiderivative = polynomial.integ(lbnd=0)
    assert nodes.values(at) @ held == pytest.approx(polynomial(at), abs=1e-11)
    assert nodes.integrals(at) @ held == pytest.approx(antiderivative(at), abs=1e-12)
    assert nodes.integral @ held == pytest.approx(antiderivative(nodes.places), abs=1e-12)
    assert nodes.whole @ held == pytest.approx(antiderivative(1.0), abs=1e-12)
    rise = antiderivative(at + width) - antiderivative(at)
    means = nodes.means(at, width) @ held
    assert means[:3] == pytest.approx(rise[:3] / width[:3], abs=1e-10)
    assert means[3] == pytest.approx(polynomial(1.0), abs=1e-11)


def test_the_mean_over_a_short_interval_does_not_cancel() -> None:
    nodes = radau_nodes(8)
    held = nodes.places**7
    # The mean of u^7 over [a, a + d] is a^7 (1 + 3.5 d / a + ...).
    a, d = 0.5, 1e-9
    mean = float((nodes.means(np.array([a]), np.array([d])) @ held)[0])
    assert mean == pytest.approx(a**7 * (1 + 3.5 * d / a), rel=1e-13)


@pytest.mark.parametrize("n", [4, 8, 16])
def test_checked_places_lie_between_the_nodes(n: int) -> None:
    own, places = radau_nodes(n).places, doubled_nodes(n).places
    assert places[:n].tolist() == own.tolist()
    merged = np.sort(places)
    assert np.min(np.diff(merged)) > 0.0
    assert merged[::2].tolist() == places[n:].tolist()
    assert merged[1::2].tolist() == own.tolist()
