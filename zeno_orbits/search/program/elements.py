r"""A nonlinear program made of elements, with exact first and second derivatives.

An element is a small function of a column of unknowns. The rows are

.. math:: g(z) = c + L z + M \phi(z)

with constant sparse `L` and `M`, where :math:`\phi` collects the outputs of all elements. The
derivatives of an element are built once and mapped over its columns, so that

.. math:: J = L + M J_\phi,\qquad
    \nabla^2 (\sigma f + \lambda^\top g) = \sum_k \nabla^2 (\mu_k \phi_k),\qquad
    \mu = M^\top \lambda + \sigma m

where `m` holds the weights of the outputs in the objective. Ipopt solves it [WachterBiegler2006]_.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from zeno_orbits.arrays import Array, Rows
from zeno_orbits.search.program.ipopt import IpoptSettings, SolveStatus, quiet_interrupts

_ca: Any = ca
"""CasADi without types, for expressions of mixed kinds, which its stubs do not follow."""

Terms = tuple[Rows, ArrayLike]
"""Places of unknowns or outputs, ``(m,)``, and their weights in as many rows."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LegElement:
    """A function of a column of unknowns and a column of constants.

    Attributes:
        values: ``(column, constants) -> outputs``.
        jacobian: The nonzero entries of its Jacobian.
        jacobian_at: Output and unknown of each entry of the Jacobian, ``(2, n)``.
        symbols: The symbols of the column and of the constants, and the outputs.
    """

    values: ca.Function
    jacobian: ca.Function
    jacobian_at: Rows
    symbols: tuple[ca.SX, ca.SX, ca.SX]

    @classmethod
    def of(cls, column: ca.SX, constants: ca.SX, outputs: ca.SX) -> LegElement:
        """Return the element of expressions.

        Args:
            column: Symbols of the unknowns, ``(m,)``.
            constants: Symbols of the constants, ``(q,)``.
            outputs: The outputs, ``(r,)``.
        """
        dense = _ca.densify(outputs)
        first = _ca.jacobian(dense, column)
        inputs = [column, constants]
        return cls(
            values=ca.Function("values", inputs, [dense], _OPTIONS),
            jacobian=ca.Function("jacobian", inputs, [_entries(first)], _OPTIONS),
            jacobian_at=_places(first),
            symbols=(column, constants, dense),
        )

    @cached_property
    def curvature(self) -> tuple[ca.Function, Rows]:
        """The weighted Hessian, which a square program does not need.

        ``(column, constants, weights) -> nonzero entries``, and the two unknowns of each entry,
        ``(2, n)``.
        """
        column, constants, dense = self.symbols
        weights = ca.SX.sym("weights", dense.numel())
        second = _ca.hessian(_ca.dot(weights, dense), column)[0]
        inputs = [column, constants, weights]
        return ca.Function("hessian", inputs, [_entries(second)], _OPTIONS), _places(second)

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return int(self.values.numel_out(0))


_OPTIONS = {"cse": True}


def _entries(matrix: Any) -> Any:
    """Return the nonzero entries of a matrix as a dense column."""
    return _ca.densify(_ca.vertcat(*matrix.nonzeros()) if matrix.nnz() else ca.SX(0, 1))


def _places(matrix: Any) -> Rows:
    """Return row and column of each nonzero entry, ``(2, n)``."""
    return np.array(matrix.sparsity().get_triplet(), dtype=np.intp).reshape(2, -1)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Calls:
    """All columns at which an element is evaluated, and the places of its outputs."""

    element: LegElement
    columns: Rows
    constants: Array
    outputs: Rows

    def joined(self, other: _Calls) -> _Calls:
        """Return the calls with the calls of another list."""
        return _Calls(
            element=self.element,
            columns=np.hstack([self.columns, other.columns]),
            constants=np.hstack([self.constants, other.constants]),
            outputs=np.hstack([self.outputs, other.outputs]),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ElementProgram:
    """A program for Ipopt. Its unknowns are in units of their sizes.

    Attributes:
        functions: Unknowns, objective and rows as CasADi expressions, ``x``, ``f`` and ``g``.
        derivatives: The functions of the derivatives, by the names of Ipopt's options.
        sizes: Size of each unknown, ``(n,)``.
        guess: The guess in these units, ``(n,)``.
        bounds: Lower and upper bounds of the unknowns, ``(2, n)``.
        row_bounds: Lower and upper bounds of the rows, ``(2, m)``.
        row_names: Name of each row.
    """

    functions: Mapping[str, ca.MX]
    derivatives: Mapping[str, ca.Function]
    sizes: Array
    guess: Array
    bounds: Array
    row_bounds: Array
    row_names: tuple[str, ...]

    @property
    def n_inequalities(self) -> int:
        """Number of rows that are not equations."""
        return int(np.sum(self.row_bounds[0] < self.row_bounds[1]))

    def solve(self, settings: IpoptSettings) -> ElementSolution:
        """Solve the program by Ipopt, from its guess.

        Args:
            settings: Tolerances and limits.

        Raises:
            KeyboardInterrupt: If the user interrupts. Ipopt alone would suppress the interrupt.
        """
        options: dict[str, Any] = settings.as_casadi() | dict(self.derivatives)
        if "hess_lag" not in self.derivatives:
            options["ipopt"]["hessian_approximation"] = "limited-memory"
        solver = _ca.nlpsol("orbit", "ipopt", dict(self.functions), options)
        started = time.perf_counter()
        with quiet_interrupts():
            answer = solver(
                x0=self.guess,
                lbx=self.bounds[0],
                ubx=self.bounds[1],
                lbg=self.row_bounds[0],
                ubg=self.row_bounds[1],
            )
        seconds = time.perf_counter() - started
        stats = solver.stats()
        status = str(stats["return_status"])
        if status in ("NonIpopt_Exception_Thrown", "User_Requested_Stop"):
            raise KeyboardInterrupt
        rows = np.array(answer["g"].full()).ravel()
        violations = np.maximum(self.row_bounds[0] - rows, rows - self.row_bounds[1])
        # A NaN counts as a violation.
        violations[np.isnan(violations)] = np.inf
        worst: dict[str, float] = {}
        for name, value in zip(self.row_names, violations.tolist(), strict=True):
            worst[name] = max(worst.get(name, 0.0), value)
        return ElementSolution(
            status=SolveStatus.from_ipopt(status),
            unknowns=np.array(answer["x"].full()).ravel() * self.sizes,
            residuals=worst,
            objective=float(answer["f"]),
            iterations=int(stats.get("iter_count", 0)),
            wall_time=seconds,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ElementSolution:
    """Result of a solve, successful or not.

    Attributes:
        status: Status of the solve.
        unknowns: The unknowns in their own units, ``(n,)``.
        residuals: Name of a row to its scaled violation. For rows of the same name, the largest.
        objective: Value of the objective.
        iterations: Number of iterations.
        wall_time: Time in the solver, without the construction of the program [s].
    """

    status: SolveStatus
    unknowns: Array
    residuals: Mapping[str, float]
    objective: float
    iterations: int
    wall_time: float

    @property
    def violation(self) -> float:
        """Largest scaled violation of a row."""
        return max(self.residuals.values(), default=0.0)


def _triplets() -> list[tuple[Rows, Rows, Array]]:
    return []


@dataclass(kw_only=True)
class ElementBuilder:
    """Unknowns, elements and rows of a program, in the order in which they are added."""

    _n: int = 0
    _n_rows: int = 0
    _n_outputs: int = 0
    _guess: list[Array] = field(default_factory=list[Array])
    _sizes: list[Array] = field(default_factory=list[Array])
    _bounds: list[Array] = field(default_factory=list[Array])
    _row_bounds: list[Array] = field(default_factory=list[Array])
    _constants: list[Array] = field(default_factory=list[Array])
    _row_names: list[str] = field(default_factory=list[str])
    _linear: list[tuple[Rows, Rows, Array]] = field(default_factory=_triplets)
    _of_outputs: list[tuple[Rows, Rows, Array]] = field(default_factory=_triplets)
    _calls: dict[int, _Calls] = field(default_factory=dict[int, _Calls])
    _cost: dict[int, float] = field(default_factory=dict[int, float])
    _cost_of_outputs: dict[int, float] = field(default_factory=dict[int, float])
    _squares: dict[int, tuple[float, float]] = field(default_factory=dict[int, tuple[float, float]])

    def unknowns(
        self, guess: ArrayLike, size: ArrayLike, lower: float = -np.inf, upper: float = np.inf
    ) -> Rows:
        """Add unknowns and return their places, in the shape of the guess.

        Args:
            guess: Their guess.
            size: Their sizes, of the same shape or one for all.
            lower: Their lower bound.
            upper: Their upper bound.
        """
        start = np.asarray(guess, dtype=np.float64)
        sizes = np.broadcast_to(np.asarray(size, dtype=np.float64), start.shape).ravel()
        places = np.arange(self._n, self._n + start.size, dtype=np.intp).reshape(start.shape)
        self._n += start.size
        self._guess.append(start.ravel() / sizes)
        self._sizes.append(sizes)
        self._bounds.append(np.array([lower / sizes, upper / sizes]))
        return places

    def outputs(self, element: LegElement, columns: Rows, constants: Array) -> Rows:
        """Evaluate an element at columns of unknowns and return the places of its outputs.

        Args:
            element: The element.
            columns: Places of the unknowns of each column, ``(m, n)``.
            constants: The constants of all columns, ``(q,)``.

        Returns:
            The places, ``(r, n)``.
        """
        n, r = columns.shape[1], element.n_outputs
        places = self._n_outputs + np.arange(r * n, dtype=np.intp).reshape((r, n), order="F")
        self._n_outputs += r * n
        calls = _Calls(
            element=element,
            columns=columns,
            constants=np.repeat(constants[:, None], n, axis=1),
            outputs=places,
        )
        key = id(element)
        self._calls[key] = self._calls[key].joined(calls) if key in self._calls else calls
        return places

    def rows(
        self,
        name: str,
        *,
        linear: Sequence[Terms] = (),
        outputs: Sequence[Terms] = (),
        constant: ArrayLike = 0.0,
        size: ArrayLike = 1.0,
        lower: float = 0.0,
        upper: float = 0.0,
    ) -> None:
        """Add rows: sums of terms and constants, over their sizes, between two bounds.

        Args:
            name: Name of the rows.
            linear: Unknowns with weights. A negative place stands for no unknown.
            outputs: Outputs of elements with weights.
            constant: The constants.
            size: The sizes.
            lower: Lower bound, in units of the sizes.
            upper: Upper bound, in units of the sizes.
        """
        n = len((*linear, *outputs)[0][0])
        rows = np.arange(self._n_rows, self._n_rows + n, dtype=np.intp)
        sizes = np.broadcast_to(np.asarray(size, dtype=np.float64), (n,))
        for store, terms in ((self._linear, linear), (self._of_outputs, outputs)):
            for places, weights in terms:
                scaled = np.broadcast_to(np.asarray(weights, dtype=np.float64), (n,)) / sizes
                used = places >= 0
                store.append((rows[used], places[used], scaled[used]))
        self._n_rows += n
        self._constants.append(np.broadcast_to(np.asarray(constant), (n,)) / sizes)
        self._row_bounds.append(np.repeat([[lower], [upper]], n, axis=1))
        self._row_names += [name] * n

    def cost_of(self, outputs: Mapping[int, float]) -> None:
        """Add outputs of elements with weights to the objective."""
        for place, weight in outputs.items():
            self._cost_of_outputs[place] = self._cost_of_outputs.get(place, 0.0) + weight

    def cost_of_unknowns(self, unknowns: Mapping[int, float]) -> None:
        """Add unknowns with weights to the objective."""
        for place, weight in unknowns.items():
            self._cost[place] = self._cost.get(place, 0.0) + weight

    def cost_of_distance(self, place: int, weight: float, wanted: float) -> None:
        """Add half the weighted square of the distance of an unknown from a value."""
        self._squares[place] = (weight, wanted)

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self._n

    def value(self, places: Rows) -> Array:
        """Return the guess of unknowns, in their own units."""
        guess, sizes = np.concatenate(self._guess), np.concatenate(self._sizes)
        return np.asarray((guess * sizes)[places])

    def output_values(self, places: Rows) -> Array:
        """Return outputs of elements at the guess."""
        guess = self.value(np.arange(self._n))
        found = np.full(self._n_outputs, np.nan)
        for calls in self._calls.values():
            if not np.isin(calls.outputs, places).any():
                continue
            n = calls.columns.shape[1]
            values: Any = calls.element.values.map(n)(guess[calls.columns], calls.constants)
            found[calls.outputs] = np.array(ca.DM(values).full())
        return found[places]

    def built(self, *, is_square: bool = False) -> ElementProgram:
        """Return the program.

        Args:
            is_square: Whether it lacks a choice, so that second derivatives are left out.
        """
        sizes = np.concatenate(self._sizes)
        z = ca.MX.sym("z", self._n)
        weights, factor = ca.MX.sym("weights", self._n_rows), ca.MX.sym("factor")
        nothing = ca.MX.sym("nothing", 0)
        x = ca.DM(sizes) * z
        linear = _sparse(self._linear, (self._n_rows, self._n))
        of_outputs = _sparse(self._of_outputs, (self._n_rows, self._n_outputs))
        at_outputs = ca.DM(_filled(self._cost_of_outputs, self._n_outputs))
        by_output = _ca.densify(_ca.mtimes(of_outputs.T, weights) + at_outputs * factor)
        phi, slopes = self._evaluated(x)
        rows = _ca.mtimes(linear, x) + _ca.mtimes(of_outputs, phi) + np.concatenate(self._constants)
        unit = _ca.diag(ca.DM(sizes))
        sloped = linear + _ca.mtimes(of_outputs, slopes)
        jacobian = _ca.mtimes(sloped, unit)
        cost, stiff = _filled(self._cost, self._n), np.zeros(self._n)
        wanted = np.zeros(self._n)
        for place, (weight, at) in self._squares.items():
            stiff[place], wanted[place] = weight, at
        off = x - ca.DM(wanted)
        value = (
            _ca.dot(ca.DM(cost), x)
            + _ca.dot(at_outputs, phi)
            + _ca.dot(ca.DM(stiff), off * off) / 2
        )
        gradient = _ca.mtimes(slopes.T, at_outputs) + ca.DM(cost) + ca.DM(stiff) * off
        inputs = [z, nothing]
        second: dict[str, ca.Function] = {}
        if not is_square:
            hessian = self._hessian(self._curvatures(x, by_output), sizes, stiff, factor)
            second = {"hess_lag": ca.Function("hessian", [*inputs, factor, weights], [hessian])}
        return ElementProgram(
            functions={"x": z, "f": value, "g": rows},
            derivatives={
                "jac_g": ca.Function("rows", inputs, [rows, jacobian]),
                "grad_f": ca.Function("objective", inputs, [value, ca.DM(sizes) * gradient]),
                **second,
            },
            sizes=sizes,
            guess=np.concatenate(self._guess),
            bounds=np.hstack(self._bounds),
            row_bounds=np.hstack(self._row_bounds),
            row_names=tuple(self._row_names),
        )

    def _evaluated(self, x: ca.MX) -> tuple[Any, Any]:
        """Return all outputs, and their Jacobian."""
        values: list[Any] = []
        order: list[Rows] = []
        slopes: list[Any] = []
        at: list[Rows] = []
        by: list[Rows] = []
        for calls in self._calls.values():
            element, n = calls.element, calls.columns.shape[1]
            columns = _ca.reshape(x[_listed(calls.columns)], len(calls.columns), n)
            constants = ca.DM(calls.constants)
            values.append(_ca.vec(element.values.map(n)(columns, constants)))
            order.append(calls.outputs.ravel(order="F"))
            if element.jacobian_at.size:
                slopes.append(_ca.vec(element.jacobian.map(n)(columns, constants)))
                at.append(calls.outputs[element.jacobian_at[0]].ravel(order="F"))
                by.append(calls.columns[element.jacobian_at[1]].ravel(order="F"))
        joined = _ca.vertcat(*values)
        phi = joined[np.argsort(np.concatenate(order)).tolist()]
        jacobian = _scattered(
            np.concatenate(at),
            np.concatenate(by),
            _ca.vertcat(*slopes),
            (self._n_outputs, self._n),
        )
        return phi, jacobian

    def _curvatures(self, x: ca.MX, weights: ca.MX) -> list[tuple[Rows, Rows, Any]]:
        """Return entries of the Hessian of weighted outputs with their places."""
        found: list[tuple[Rows, Rows, Any]] = []
        for calls in self._calls.values():
            hessian, places = calls.element.curvature
            if not places.size:
                continue
            n = calls.columns.shape[1]
            columns = _ca.reshape(x[_listed(calls.columns)], len(calls.columns), n)
            own = _ca.reshape(weights[_listed(calls.outputs)], calls.element.n_outputs, n)
            entries = _ca.vec(hessian.map(n)(columns, ca.DM(calls.constants), own))
            first, second = (calls.columns[side].ravel(order="F") for side in places)
            found.append((first, second, entries))
        return found

    def _hessian(
        self, curvatures: list[tuple[Rows, Rows, Any]], sizes: Array, stiff: Array, factor: ca.MX
    ) -> Any:
        """Return the upper triangle of the Hessian of the Lagrangian."""
        at: list[Rows] = []
        by: list[Rows] = []
        entries: list[Any] = []
        for first, second, values in curvatures:
            kept = np.flatnonzero(first <= second)
            scale = sizes[first[kept]] * sizes[second[kept]]
            at.append(first[kept])
            by.append(second[kept])
            entries.append(values[kept.tolist()] * ca.DM(scale))
        squared = np.flatnonzero(stiff)
        if squared.size:
            at.append(squared)
            by.append(squared)
            entries.append(ca.DM(stiff[squared] * sizes[squared] ** 2) * factor)
        shape = (self._n, self._n)
        if not entries:
            return ca.MX(*shape)
        return _scattered(np.concatenate(at), np.concatenate(by), _ca.vertcat(*entries), shape)


def _filled(entries: Mapping[int, float], n: int) -> Array:
    """Return a vector with given entries, zero elsewhere."""
    vector = np.zeros(n)
    for place, value in entries.items():
        vector[place] = value
    return vector


def _listed(places: Rows) -> list[int]:
    """Return places by columns, as CasADi takes them."""
    return places.ravel(order="F").tolist()


def _sparse(parts: Sequence[tuple[Rows, Rows, Array]], shape: tuple[int, int]) -> Any:
    """Return a constant sparse matrix. Entries at the same place add up."""
    if not parts:
        return ca.DM(*shape)
    rows, columns, values = (np.concatenate(list(one)) for one in zip(*parts, strict=True))
    return _ca.DM.triplet(rows.tolist(), columns.tolist(), ca.DM(values), *shape)


def _scattered(rows: Rows, columns: Rows, entries: Any, shape: tuple[int, int]) -> Any:
    """Return a sparse matrix with given entries. Entries at the same place add up."""
    keys, inverse = np.unique(columns * shape[0] + rows, return_inverse=True)
    places = [(keys % shape[0]).tolist(), (keys // shape[0]).tolist()]
    sparsity = _ca.Sparsity.triplet(*shape, *places)
    once = _ca.DM.triplet(
        inverse.tolist(), list(range(len(rows))), ca.DM.ones(len(rows)), len(keys), len(rows)
    )
    added = _ca.mtimes(once, entries)
    return _ca.MX(sparsity, _ca.densify(added))
