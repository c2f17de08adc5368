"""The Jacobian of mapped rows against CasADi's own, which walks the whole graph seed by seed."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from zeno_orbits.search.transcription.jacobian import MappedRows, rows_jacobian

EPS = float(np.finfo(np.float64).eps)
N_COLUMNS = 3


def pair() -> ca.Function:
    """Return a function of a pair and a number with two rows, and an output besides."""
    x, t = ca.SX.sym("x", 2), ca.SX.sym("t")
    rows = ca.vertcat(ca.sin(x[0]) * x[1] * t, x[0] ** 2 - t)
    return ca.Function("pair", [x, t], [rows, x[0]])


def mapped(unknowns: ca.MX, scale: ca.DM) -> tuple[MappedRows, ca.MX]:
    """Return rows at columns that are unknowns, products of them and constants; and the rows."""
    states = ca.horzcat(unknowns[:2], unknowns[1:3] * unknowns[0], ca.MX([0.5, -2.0]))
    times = ca.horzcat(unknowns[3], 4.0, ca.exp(unknowns[4]))
    rows = MappedRows(function=pair(), parts=(states, times), n_columns=N_COLUMNS, scale=scale)
    return rows, ca.vec(pair().map(N_COLUMNS)(states, times)[0]) / scale


def both(scale: ca.DM, wrong: ca.DM | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the Jacobian by the chain rule and by CasADi at one point."""
    unknowns = ca.MX.sym("u", 5)
    first, last = ca.sumsqr(unknowns), unknowns[4] * unknowns[:2]
    block, _ = mapped(unknowns, scale if wrong is None else wrong)
    _, plain = mapped(unknowns, scale)
    ours = rows_jacobian([first, block, last, block], unknowns)
    theirs = ca.jacobian(ca.vertcat(first, plain, last, plain), unknowns)
    at = np.array([0.3, -1.2, 0.8, 2.0, 0.1])
    values = ca.Function("values", [unknowns], [ours, theirs])(at)
    return values[0].full(), values[1].full()


def test_mapped_rows_between_plain_ones_have_the_jacobian_of_the_whole_graph() -> None:
    ours, theirs = both(ca.DM([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    assert ours.shape == (1 + 6 + 2 + 6, 5)
    # A dozen operations an entry, in another order.
    assert np.max(np.abs(ours - theirs)) <= 12 * EPS * np.max(np.abs(theirs))


def test_a_scale_that_is_not_the_rows_own_shows() -> None:
    ours, theirs = both(ca.DM.ones(6), wrong=ca.DM([1.0, 1.0, 1.0, 1.0, 2.0, 1.0]))
    assert np.max(np.abs(ours - theirs)) > 0.1


def test_a_function_is_differentiated_by_every_part_of_its_column() -> None:
    unknowns = ca.MX.sym("u", 3)
    block = MappedRows(
        function=pair(), parts=(unknowns[:2], unknowns[2]), n_columns=1, scale=ca.DM.ones(2)
    )
    at = np.array([0.7, 1.5, 0.2])
    jacobian = ca.Function("jacobian", [unknowns], [rows_jacobian([block], unknowns)])(at)
    x, y, t = at
    expected = np.array([[np.cos(x) * y * t, np.sin(x) * t, np.sin(x) * y], [2 * x, 0.0, -1.0]])
    assert jacobian.full() == pytest.approx(expected, rel=8 * EPS)
