"""The system of a certificate: a problem at fixed parameter values, as nodes, with values in balls.

Only the free flow ``f``, the gap ``h(q)``, the impulse direction ``d``, the restitution ``e`` and
the constraints are taken from the problem's formulas. The other quantities follow from the
definition of a completed execution, with ``L`` for derivatives along a vector field. These are the
gap rate ``L_f h``, its rate ``a = L_f L_f h``, and ``D = d / L_d L_f h``. An impact maps ``x`` to
``x - (1 + e) (L_f h) D``, so that ``L_f h`` becomes ``-e L_f h`` (Newton's law). The constrained
flow is ``f - a D``. Along it, ``h = L_f h = 0`` is invariant. The constrained flow applies while
``a < 0``.

The contact force is ``-a N`` with the inertia ``N = D_v' M D_v``, where ``D_v`` is the velocity
part of ``D`` and ``M`` the problem's mass matrix. ``M`` must be positive definite along the motion.
Then the force is positive for ``a < 0``, and an impact increases no kinetic energy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isqrt
from typing import NamedTuple

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.proof.checker.balls import Array, Ball, exactly, require
from zeno_orbits.proof.checker.formulas import (
    CheckedView,
    Formulas,
    Graph,
    Row,
    require_analytic,
    walked,
)
from zeno_orbits.proof.checker.identities import (
    are_equal,
    require_impacts,
    require_kept,
    without_zeros,
)
from zeno_orbits.proof.checker.series import values


@dataclass(frozen=True, slots=True, kw_only=True)
class System:
    """Nodes of a completed system with states ``z = (x, [h, hdot], [parameters])``.

    Attributes:
        z: Inputs of the states, ``(N,)``.
        constants: Constant inputs (the parameters), and their values.
        flow: Mode to rates of the states, with None for a rate of zero.
        slopes: Mode to derivatives of the rates with respect to the states, ``(N, N)``.
        nodes: Nodes of `free` flow, `gap`, `gap_rate`, `acceleration` and its rates on and off the
            stop (`locked_jerk` and `jerk`), `direction`, `law`, `constraints`, and the `inertia`,
            the mass matrix by columns. With a held stop, `pushed` is the change of its gap rate per
            unit of the own one if it were not held, and `room` the determinant of both stops.
        tangents: Derivatives of nodes with respect to the states, one row per node.
        gap_row: Index of the state that determines the gap.
        rate_row: Index of the state that determines the gap rate.
        unit: Derivative of the gap with respect to this state.
        stop: Value of this state on the stop.
        settling: Indices of the states that an impact may change: the states of the problem, and
            gap and gap rate of the other stops.
        varied: Indices of the parameters that vary.
        signs: Factor of the guard of each switch: 1, or -1 for a kink on its negative side.
        n_declared: Number of declared switches, which precede the kinks.
        changed: States that the reset of each declared switch changes.
        moves: True for each reset that changes a state on which a gap or a gap rate depends. Then
            the nodes `after k` are gap and gap rate of each stop after reset `k`.
        kept: True for each declared switch whose guard has the same value before and after its
            reset, so that it is zero after it.
        closed: True for each reset after which the own gap and gap rate are zero if they were zero
            before it.
        rests: True for each reset after which the own gap is zero if it was zero before it.
        held_row: Index of the gap of the stop that is held closed, or -1.
    """

    graph: Graph
    n_x: int
    settling: list[int]
    varied: list[int]
    signs: list[int]
    n_declared: int
    changed: list[list[int]]
    moves: list[bool]
    kept: list[bool]
    closed: list[bool]
    rests: list[bool]
    held_row: int
    z: list[int]
    constants: dict[int, Ball]
    flow: dict[str, Row]
    slopes: dict[str, list[Row]]
    nodes: dict[str, Row]
    tangents: dict[int | None, Row]
    gap_row: int
    rate_row: int
    unit: Ball
    stop: Ball

    @property
    def has_speed_law(self) -> bool:
        """True if the restitution depends on the gap rate before an impact."""
        return not {*self.z[: self.n_x]}.isdisjoint(self.graph.needed(self.nodes["law"]))

    def require_law(self, box: Array) -> None:
        """Check that a restitution of the impact speed lies between 0 and 1 on a box of states."""
        if self.has_speed_law:
            e = self.value("law", box)[0]
            inside = e.low > 0 and e.high < 1 << self.bits
            require(inside, f"the restitution may not be between 0 and 1: {e.shown()}")

    @property
    def bits(self) -> int:
        """The unit is ``2^-bits``."""
        return self.unit.bits

    @property
    def is_pinned(self) -> bool:
        """True if a coordinate determines the gap."""
        return self.gap_row < self.n_x

    @property
    def inner(self) -> list[int]:
        """Indices of the states that formulas depend on: states of the problem, and parameters."""
        return [*self.settling, *self.varied]

    @property
    def gap_rows(self) -> range:
        """Indices of the gaps that are additional states. Each is followed by its rate."""
        return range(self.n_x, len(self.z) - len(self.varied), 2)

    @property
    def open_rows(self) -> list[int]:
        """Indices of the gaps that are additional states, without that of a held stop."""
        return [k for k in self.gap_rows if k != self.held_row]

    @property
    def nothing(self) -> Array:
        """A row of zeros, ``(N,)``."""
        return exactly(np.zeros(len(self.z), dtype=int), self.bits)

    @property
    def identity(self) -> Array:
        """The identity matrix, ``(N, N)``."""
        return exactly(np.eye(len(self.z), dtype=int), self.bits)

    def at(self, z: Array) -> dict[int, Ball]:
        """Return all inputs at states."""
        return self.constants | dict(zip(self.z, z, strict=True))

    def value(self, name: str, z: Array) -> Array:
        """Return nodes over a box of states."""
        return values(self.graph, self.at(z), self.nodes[name])

    def gradient(self, name: str, z: Array) -> Array:
        """Return the derivatives of nodes over a box of states, ``(n, N)``."""
        nodes = [part for node in self.nodes[name] for part in self.tangents[node]]
        return values(self.graph, self.at(z), nodes).reshape(-1, len(self.z))

    def require_defined(self, box: Array) -> None:
        """Check that the gap and the constraints are analytic on a box of states.

        The identities about them hold along a motion only if they are. The mass matrix must be
        positive definite on the box.
        """
        for name in ("gap", "constraints"):
            self.value(name, box)
        self.require_inertia(box)

    def require_inertia(self, box: Array) -> None:
        """Check that the mass matrix is positive definite on a box of states.

        All pivots of its symmetric part are positive (Sylvester's criterion). If a stop is held,
        the determinant of the two stops, each response in units of its own, is positive.
        """
        for both in self.value("room", box):
            require(both.low > 0, f"the responses of two stops may be dependent: {both.shown()}")
        entries = self.value("inertia", box)
        n = isqrt(len(entries))
        rows = entries.reshape(n, n)
        rows = rows + rows.T
        for k in range(n):
            pivot = rows[k, k]
            require(pivot.low > 0, f"the mass matrix may not be positive definite: {pivot.shown()}")
            for i in range(k + 1, n):
                rows[i] = rows[i] - rows[k] * (rows[i, k] / pivot)

    def require_reaction(self, box: Array) -> None:
        """Check that an impact presses the held stop, or leaves its gap rate unchanged."""
        for pushed in self.value("pushed", box):
            require(pushed.high < 0, f"an impact may open the other stop: {pushed.shown()}")

    def require_pressure(self, box: Array) -> None:
        """Check that the own stop is under pressure on a box of states of its contact."""
        pull = self.value("acceleration", box)[0]
        told = f"the multiplier may be {(-pull).shown()} times the normal inertia"
        require(pull.high < 0, told)

    def rates(self, mode: str, z: Array) -> Array:
        """Return the rates of the states over a box of states."""
        return values(self.graph, self.at(z), self.flow[mode])

    def gap(self, z: Array) -> Ball:
        """Return the gap over a box of states."""
        return self.unit * (z[self.gap_row] - self.stop)

    def gap_rate(self, z: Array) -> Ball:
        """Return the gap rate over a box of states."""
        return self.unit * z[self.rate_row]


def bound_system(
    formulas: Formulas,
    numbers: Mapping[str, Ball],
    over: Sequence[str],
    row: int | None,
    view: CheckedView | None = None,
    beside: Formulas | None = None,
) -> System:
    """Return the nodes of a problem at given parameter values.

    If a stop ``i`` is held closed, the free flow is the constrained flow of ``i``. The direction is
    ``D - p D_i``, normalised, where ``p`` is the change of the gap rate of ``i`` along ``D``. So an
    impact changes the gap rate of ``i`` no more.

    Args:
        formulas: Formulas of the problem.
        numbers: All gains and parameters.
        over: Names of the parameters that vary.
        row: Index of the only coordinate in the gap, or ``None`` if gap and gap rate are additional
            states.
        view: The stop and the sides of a machine with several stops, switches or kinks.
        beside: Formulas of the stop that is held, if there is one.

    Raises:
        InputError: If the lemmas do not apply to the problem.
    """
    graph, n_x, n_q = Graph(), formulas.function.numel_in(0), formulas.n_q
    bits, stop = next(iter(numbers.values())).bits, 0 if view is None else view.stop
    x = [graph.put("input") for _ in range(n_x)]
    p = {name: graph.put("input") for name in numbers}
    given = _given(formulas, graph, x, list(p.values()), stop)
    free, along, law, rows, gaps, guards, armed, resets = given
    gap = gaps[stop]

    def derivative(node: int, field: Sequence[int | None]) -> int:
        found = graph.tangents([node], dict(zip(x, ([k] for k in field), strict=True)))[0][0]
        return graph.zero if found is None else found

    def normalised(along: Row, rate: int) -> Row:
        along = [None if node == graph.zero else node for node in along]
        response = derivative(rate, along)
        # Most directions are already normalised. A division would then only widen the intervals.
        if are_equal(graph, [response], [graph.one]):
            return along
        return [None if node is None else graph.put("div", node, response) for node in along]

    nothing: Row = [None if node == graph.zero else node for node in free]
    rate = derivative(gap, nothing)
    direction, held, room, reaction = normalised(along, rate), -1, list[int](), list[int]()
    if view is not None and beside is not None:
        held = view.held
        at_held = derivative(gaps[held], nothing)
        along_held = _given(beside, graph, x, list(p.values()), held)
        require(are_equal(graph, free, along_held.free), "two stops have different free flows")
        other = normalised(along_held.along, at_held)
        pushed_back = graph.put("neg", derivative(at_held, nothing))
        # States that the held stop keeps at rest would otherwise have wide rates.
        nothing = without_zeros(graph, _combined(graph, nothing, pushed_back, other))
        turn = derivative(at_held, direction)
        if not are_equal(graph, [turn], [graph.zero]):
            direction = without_zeros(
                graph, _combined(graph, direction, graph.put("neg", turn), other)
            )
            room, reaction = [derivative(rate, direction)], [turn]
            direction = normalised(direction, rate)
    acceleration = derivative(rate, nothing)
    if view is not None:
        _require_positions(graph, x, n_q, nothing, direction, gaps)
    force = graph.put("neg", acceleration)
    # If coordinates determine gap and gap rate, the constrained flow keeps them constant.
    pinned = () if row is None else (row, n_q + row)
    locked = _combined(graph, nothing, force, direction)
    locked = [None if k in pinned else node for k, node in enumerate(locked)]
    if held >= 0:
        locked = without_zeros(graph, locked)
    law = _law_at(formulas, graph, list(p.values()), law, graph.put("neg", rate))
    _require_newton(formulas, graph, x, list(p.values()))
    rates = [derivative(node, nothing) for node in rows]
    gap_rates = [derivative(node, nothing) for node in gaps]
    pushed = [derivative(node, direction) for node in gap_rates]
    pairs = [(gap_rates[k], pushed[k]) for k in range(len(gaps)) if k != stop]
    if not _is_constant(graph, x, gap):
        require_impacts(graph, x, direction, gap=gap, rate=rate, rows=rows, beside=pairs)
    require_kept(graph, rows, rates)
    (masses,) = walked(formulas.inertia, graph, [x, list(p.values())])
    require_analytic(graph, masses)
    carried = [graph.put("input") for _ in range(2 * len(gaps) if row is None else 0)]
    lifted = [derivative(node, nothing) for node in gap_rates]
    flying, locking, struck = _at_stops(graph, carried, (stop, held), force, lifted, pushed)
    own = (n_x + 2 * stop, n_x + 2 * stop + 1) if carried else ()
    settling = [k for k in range(n_x + len(carried)) if k not in own]
    ends = [node for pair in zip(gaps, gap_rates, strict=True) for node in pair]
    changes = [
        _Change.of(graph, x, one, ends, carried, guard)
        for one, guard in zip(resets, guards, strict=False)
    ]
    require(row is None or not any(one.moves for one in changes), "a switch moves the pinned gap")
    nodes: dict[str, Row] = {
        "free": [[*nothing, *flying][k] for k in settling],
        "gap": [gap],
        "gap_rate": [rate],
        "acceleration": [acceleration],
        "jerk": [derivative(acceleration, nothing)],
        "locked_jerk": [derivative(acceleration, locked)],
        "direction": [[*direction, *struck][k] for k in settling],
        "law": [law],
        "room": [*room],
        "pushed": [*reaction],
        "constraints": [*rows],
        "stops": [*ends],
        "guards": [*guards],
        "armed": [*armed],
        "guards_free": [derivative(node, nothing) for node in guards],
        "guards_locked": [derivative(node, locked) for node in guards],
        **{f"reset {k}": [*one] for k, one in enumerate(resets)},
        **{f"after {k}": [*one.ends] for k, one in enumerate(changes)},
    }
    z = [*x, *carried, *(p[name] for name in over)]
    rest: Row = [None] * (len(z) - n_x)
    flow: dict[str, Row] = {
        "free": [*nothing, *flying, *rest][: len(z)],
        "locked": [*locked, *locking, *rest][: len(z)],
    }
    tangents = _tangents(graph, z, [*flow.values(), *nodes.values()])
    nodes["inertia"] = [*masses]
    unit, origin = Ball(1 << bits, 0, bits), Ball(0, 0, bits)
    constants = {p[name]: ball for name, ball in numbers.items() if name not in over}
    if row is not None:
        require(free[row] == x[n_q + row], "the rate of the gap's coordinate is not a state")
        unit, origin = _coordinate(graph, gap, x[row], constants, bits)
    return System(
        graph=graph,
        n_x=n_x,
        z=z,
        constants=constants,
        flow=flow,
        slopes={mode: [tangents[node] for node in nodes] for mode, nodes in flow.items()},
        nodes=nodes,
        tangents=tangents,
        gap_row=n_x + 2 * stop if row is None else row,
        rate_row=n_x + 2 * stop + 1 if row is None else n_q + row,
        unit=unit,
        stop=origin,
        settling=settling,
        varied=list(range(len(z) - len(over), len(z))),
        signs=[*(1 for _ in armed), *(1 if side else -1 for side in (view.sides if view else ()))],
        n_declared=len(armed),
        changed=[one.states for one in changes],
        moves=[one.moves for one in changes],
        kept=[one.keeps_guard for one in changes],
        closed=[not one.moves or all(one.stays[2 * stop : 2 * stop + 2]) for one in changes],
        rests=[not one.moves or one.stays[2 * stop] for one in changes],
        held_row=-1 if held < 0 else n_x + 2 * held,
    )


def _combined(graph: Graph, row: Row, factor: int, other: Row) -> Row:
    """Return a row plus a multiple of another row."""
    pairs = zip(row, other, strict=True)
    return [graph.total(a, graph.product(factor, b)) for a, b in pairs]


def _is_constant(graph: Graph, x: Sequence[int], node: int) -> bool:
    """Return True if a node does not depend on the state, as the gap of an absent stop."""
    return set(x).isdisjoint(graph.needed([node]))


class _Change(NamedTuple):
    """What the reset of a declared switch changes.

    Attributes:
        states: States that it changes.
        moves: True if a gap or a gap rate depends on one of them.
        ends: Nodes of gap and gap rate of each stop after it. Others stay the same nodes.
        stays: True for each of these that is zero after it if it was zero before it.
        keeps_guard: True if the guard has the same value before and after it.
    """

    states: list[int]
    moves: bool
    ends: list[int]
    stays: list[bool]
    keeps_guard: bool

    @classmethod
    def of(
        cls,
        graph: Graph,
        x: Sequence[int],
        reset: Sequence[int],
        ends: Sequence[int],
        carried: Sequence[int],
        guard: int,
    ) -> _Change:
        """Return what a reset changes.

        Args:
            graph: The nodes are there.
            x: Inputs of the state.
            reset: The state after it.
            ends: Gap and gap rate of each stop.
            carried: Inputs of gap and gap rate of each stop, empty if a coordinate is the gap.
            guard: The guard of the switch.
        """
        states = [k for k, node in enumerate(reset) if node != x[k]]
        changed = {x[k] for k in states}
        moves = not changed.isdisjoint(graph.needed(ends))
        *after, next_guard = graph.composed([*ends, guard], dict(zip(x, reset, strict=True)))
        keeps = changed.isdisjoint(graph.needed([guard]))
        keeps = keeps or are_equal(graph, [next_guard], [guard])
        if not carried or not moves:
            return cls(states, moves, [*ends], [not moves] * len(ends), keeps)
        rows = zip(after, ends, carried, strict=True)
        after = [own if node == before else node for node, before, own in rows]
        stays = [node in (graph.zero, own) for node, own in zip(after, carried, strict=True)]
        return cls(states, moves, after, stays, keeps)


class _Given(NamedTuple):
    """Nodes of the formulas of a problem."""

    free: list[int]
    along: Row
    law: int
    rows: list[int]
    gaps: list[int]
    guards: list[int]
    armed: list[int]
    resets: list[list[int]]


def _given(
    formulas: Formulas, graph: Graph, x: Sequence[int], p: Sequence[int], stop: int
) -> _Given:
    """Return the formulas as nodes. All are analytic, and the restitution has no state."""
    free, _, contact, along, (law, *_), rows, *further = walked(formulas.function, graph, [x, p])
    gaps, guards, armed, *resets = further or ([contact[0]], [], [])
    if _is_constant(graph, x, gaps[stop]):
        # A constant gap never closes, so no impact has a direction.
        along = [graph.zero] * len(along)
    require_analytic(graph, [*free, *along, law, *rows])
    require_analytic(graph, [*gaps, *guards, *armed, *(node for one in resets for node in one)])
    require(gaps[stop] == contact[0], "the gap is not that of its stop")
    constant = set(x).isdisjoint(graph.needed([law]))
    require(constant, "its restitution is not constant")
    return _Given(free, [*along], law, rows, gaps, guards, armed, resets)


def _at_stops(
    graph: Graph,
    carried: Sequence[int],
    closed: Sequence[int],
    force: int,
    lifted: Sequence[int],
    pushed: Sequence[int],
) -> tuple[Row, Row, Row]:
    """Return the rates of all gaps and gap rates in flight and in contact, and their changes.

    Args:
        graph: The nodes are there.
        carried: Inputs of gap and gap rate of each stop.
        closed: The stop of the system, and the stop that is held or -1.
        force: Minus the gap acceleration of the first.
        lifted: Acceleration of each gap in flight.
        pushed: Change of each gap rate per unit change of the own gap rate.
    """
    flying, held, struck = list[int | None](), list[int | None](), list[int | None]()
    for k in range(len(carried) // 2):
        rate, away, is_held = carried[2 * k + 1], k not in closed, k == closed[1]
        pull = graph.total(lifted[k], graph.product(force, pushed[k]))
        flying += [None, None] if is_held else [rate, lifted[k]]
        held += [rate, pull] if away else [None, None]
        struck += [None, None if is_held else pushed[k]]
    return flying, held, struck


def _tangents(graph: Graph, z: Sequence[int], parts: Sequence[Row]) -> dict[int | None, Row]:
    """Return the derivatives of nodes with respect to the states."""
    one_hot = {place: [graph.one if k == place else None for k in z] for place in z}
    every = [node for part in parts for node in part if node is not None]
    none: Row = [None] * len(z)
    found = zip(every, graph.tangents(every, one_hot), strict=True)
    return dict[int | None, Row](found) | {None: none}


def _require_positions(
    graph: Graph,
    x: Sequence[int],
    n_q: int,
    free: Row,
    direction: Row,
    gaps: Sequence[int],
) -> None:
    """Check that gaps depend on coordinates, whose rates are states and that impacts do not change.

    Then all systems of a machine have the same gap rates, on all sides of the kinks.
    """
    require([*free[:n_q]] == [*x[n_q : 2 * n_q]], "the rate of a coordinate is not a state")
    still = all(node is None for node in direction[:n_q])
    require(still, "an impact changes a coordinate")
    of_gaps = graph.needed(gaps)
    require(set(x[n_q:]).isdisjoint(of_gaps), "a gap depends on other states than coordinates")


def _law_at(formulas: Formulas, graph: Graph, p: Sequence[int], slowest: int, speed: int) -> int:
    """Return the restitution at an impact speed, or that of all impacts."""
    if formulas.coefficient is None:
        return slowest
    ((law,),) = walked(formulas.coefficient, graph, [p, [speed]])
    require_analytic(graph, [law])
    return law


def _require_newton(formulas: Formulas, graph: Graph, x: Sequence[int], p: Sequence[int]) -> None:
    """Check that an impact drops the gap rate ``s`` by ``(1 + e) s``, to ``-e s``, for every e."""
    e, s = graph.put("input"), graph.put("input")
    (drop,), (after,) = walked(formulas.law, graph, [x, p, [e], [s]])
    e = _law_at(formulas, graph, p, e, graph.put("neg", s))
    require_analytic(graph, [drop, after])
    wanted = [graph.put("mul", graph.put("add", graph.one, e), s)]
    wanted.append(graph.put("neg", graph.put("mul", e, s)))
    require(are_equal(graph, [drop, after], wanted), "its law of impact is not Newton's law")


def _coordinate(
    graph: Graph, gap: int, x: int, constants: Mapping[int, Ball], bits: int
) -> tuple[Ball, Ball]:
    """Return slope and root of the gap in its coordinate, if the gap is affine in it alone."""
    slope = graph.tangents([gap], {x: [graph.one]})[0][0]
    given = {place for place in graph.needed([gap]) if graph.nodes[place] == ("input",)}
    turned = {place for place in graph.needed([slope]) if graph.nodes[place] == ("input",)}
    if slope is None or not given <= {x, *constants} or not turned <= {*constants}:
        raise InputError("The certificate's `gap_row` must be the one coordinate of the gap.")
    unit, origin = values(graph, {**constants, x: Ball(0, 0, bits)}, [slope, gap])
    return unit, -(origin / unit)
