"""What a certificate is about: a problem at its numbers, as nodes, and its values in balls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.proof.checker.balls import Array, Ball, exactly
from zeno_orbits.proof.checker.formulas import Formulas, Graph, walked
from zeno_orbits.proof.checker.series import taylor, values

Rates = dict[int, int | None]
Rows = list[list[int | None]]
FREE, LOCKED, CONTACT, IMPULSE, LAW, HOLONOMIC = range(6)
GAP, GAP_RATE, GAP_ACCELERATION, MULTIPLIER = range(4)


@dataclass(frozen=True, slots=True, kw_only=True)
class System:
    """Nodes of a completed system; its states are ``z = (x, [h, hdot], [parameters])``.

    Attributes:
        z: Inputs of the states, ``(N,)``.
        V: Inputs of the tangents, ``(N, N)``.
        constants: Inputs that stay, the parameters, and their values.
        flow: Rates of the states, by the mode.
        variational: Rates of the tangents, by the mode.
        outputs: Nodes of free flow, locked flow, contact, impulse direction, law and constraints.
        tangents: Their tangents, a row each.
        gap_row: Row of the states that tells the gap.
        rate_row: Row of the states that tells the gap rate.
        unit: By how much the gap changes with its row.
        stop: Value of the gap's row on the stop.
    """

    graph: Graph
    n_x: int
    z: list[int]
    V: list[list[int]]
    constants: dict[int, Ball]
    flow: dict[str, Rates]
    variational: dict[str, Rates]
    outputs: list[list[int]]
    tangents: list[Rows]
    gap_row: int
    rate_row: int
    unit: Ball
    stop: Ball

    @property
    def bits(self) -> int:
        """The unit is ``2^-bits``."""
        return self.unit.bits

    @property
    def is_pinned(self) -> bool:
        """True if a coordinate tells the gap."""
        return self.gap_row < self.n_x

    @property
    def inner(self) -> list[int]:
        """Rows of the states that formulas depend on: states of the problem, and parameters."""
        carried = () if self.is_pinned else (self.gap_row, self.rate_row)
        return [k for k in range(len(self.z)) if k not in carried]

    @property
    def nothing(self) -> Array:
        """A row of zeros, ``(N,)``."""
        return exactly(np.zeros(len(self.z), dtype=int), self.bits)

    @property
    def identity(self) -> Array:
        """The identity matrix, ``(N, N)``."""
        return exactly(np.eye(len(self.z), dtype=int), self.bits)

    def at(self, z: Array) -> dict[int, Ball]:
        """Return all inputs at states, the tangents those of the states themselves."""
        seeds = zip(np.ravel(self.V), self.identity.ravel(), strict=True)
        return self.constants | dict(zip(self.z, z, strict=True)) | {int(v): x for v, x in seeds}

    def value(self, output: int, z: Array) -> Array:
        """Return one of the outputs over a box of states."""
        return values(self.graph, self.at(z), self.outputs[output])

    def gradient(self, output: int, z: Array) -> Array:
        """Return the derivative of one of the outputs over a box of states, ``(n, N)``."""
        nodes = self.tangents[output]
        found = values(self.graph, self.at(z), [node for row in nodes for node in row])
        return found.reshape(len(nodes), len(self.z))

    def rates(self, mode: str, z: Array) -> Array:
        """Return the rates of the states over a box of them."""
        return values(self.graph, self.at(z), [self.flow[mode][place] for place in self.z])

    def gap(self, z: Array) -> Ball:
        """Return the gap over a box of states."""
        return self.unit * (z[self.gap_row] - self.stop)

    def gap_rate(self, z: Array) -> Ball:
        """Return the gap rate over a box of states."""
        return self.unit * z[self.rate_row]

    def gap_acceleration(self, z: Array) -> Ball:
        """Return the second time derivative of the gap off the stop."""
        return self.unit * self.rates("free", z)[self.rate_row]

    def gap_jerk(self, z: Array) -> Ball:
        """Return the third time derivative of the gap off the stop."""
        one, row = Ball(1 << self.bits, 0, self.bits), self.z[self.rate_row]
        return self.unit * taylor(self.graph, self.flow["free"], self.at(z), one, 2)[row][2] * 2

    def multiplier_rate(self, z: Array) -> Ball:
        """Return the time derivative of the multiplier on the stop."""
        return self.gradient(CONTACT, z)[MULTIPLIER] @ self.rates("locked", z)


def bound_system(
    formulas: Formulas, numbers: Mapping[str, Ball], over: Sequence[str], row: int | None
) -> System:
    """Return the nodes of a problem at its numbers.

    Args:
        formulas: Its instructions.
        numbers: All gains and parameters.
        over: Names of those that vary.
        row: The coordinate that alone tells the gap; ``None`` if gap and rate are carried.
    """
    graph, n_x, n_q = Graph(), formulas.function.numel_in(0), formulas.n_q
    bits = next(iter(numbers.values())).bits
    x = [graph.put("input") for _ in range(n_x)]
    p = {name: graph.put("input") for name in numbers}
    carried = [graph.put("input") for _ in range(2 if row is None else 0)]
    outputs = walked(formulas.function, graph, [x, list(p.values())])
    moving = [p[name] for name in over]
    z = [*x, *carried, *moving]
    V = [[graph.put("input") for _ in z] for _ in z]
    seeds, none = dict(zip(z, V, strict=True)), [None] * len(z)
    pinned = () if row is None else (row, n_q + row)
    acceleration = outputs[CONTACT][GAP_ACCELERATION]
    rates: dict[str, list[int | None]] = {
        "free": [*outputs[FREE], *([carried[1], acceleration] if carried else [])],
        "locked": [None if k in pinned else node for k, node in enumerate(outputs[LOCKED])],
    }
    flow = {mode: dict(zip_longest(z, nodes)) for mode, nodes in rates.items()}
    every = [*carried, *(node for nodes in outputs for node in nodes)]
    rows: dict[int | None, list[int | None]] = dict(
        zip(every, graph.tangents(every, seeds), strict=True)
    )
    # What moves the tangents is the derivative of the flow.
    slopes = {
        m: [v for n in nodes.values() for v in rows.get(n, none)] for m, nodes in flow.items()
    }
    variational = {m: dict(zip(np.ravel(V).tolist(), slopes[m], strict=True)) for m in flow}
    unit, stop = Ball(1 << bits, 0, bits), Ball(0, 0, bits)
    constants = {p[name]: ball for name, ball in numbers.items() if name not in over}
    if row is not None:
        unit, stop = _coordinate(graph, outputs[CONTACT][GAP], x[row], constants, bits)
        if outputs[FREE][row] != x[n_q + row]:
            raise InputError("The certificate's `gap_row` must move by a state of its own.")
    return System(
        graph=graph,
        n_x=n_x,
        z=z,
        V=V,
        constants=constants,
        flow=flow,
        variational=variational,
        outputs=outputs,
        tangents=[[rows[node] for node in nodes] for nodes in outputs],
        gap_row=n_x if row is None else row,
        rate_row=n_x + 1 if row is None else n_q + row,
        unit=unit,
        stop=stop,
    )


def _coordinate(
    graph: Graph, gap: int, x: int, constants: Mapping[int, Ball], bits: int
) -> tuple[Ball, Ball]:
    """Return slope and root of the gap in its coordinate, if it is affine in that one alone."""
    one = graph.put("input")
    slope = graph.tangents([gap], {x: [one]})[0][0]
    given = {place for place in graph.needed([gap]) if graph.nodes[place] == ("input",)}
    turned = {place for place in graph.needed([slope]) if graph.nodes[place] == ("input",)}
    if slope is None or not given <= {x, *constants} or not turned <= {one, *constants}:
        raise InputError("The certificate's `gap_row` must be the one coordinate of the gap.")
    inputs = {**constants, x: Ball(0, 0, bits), one: Ball(1 << bits, 0, bits)}
    unit, origin = values(graph, inputs, [slope, gap])
    return unit, -(origin / unit)
