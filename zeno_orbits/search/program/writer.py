r"""The rows of a periodic orbit: flows by collocation, events, links and the return to the start.

A flow of duration `T` satisfies :math:`Y_{ik} = Y_{i-1,s} + h_i \sum_j A_{kj}\,T f(Y_{ij})` at the
Radau stages of every interval [HairerWanner1996]_. Its event adds a guard that is zero and falls.
The next flow starts at the state after the event, theory (3.2). A Zeno point is the limit (2.7) of
tails, whose states and times are unknowns, so that the limit is a polynomial in most of them. The
period may start after any event, because the last leg is linked to the first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from zeno_orbits.arrays import ROUNDED, Array, Rows, null_space
from zeno_orbits.integrators import radau_scheme
from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import EventReturn
from zeno_orbits.search.program.elements import ElementBuilder, LegElement, Terms
from zeno_orbits.search.program.formulas import FALL, GUARD, MachineFormulas, formulas_of_machine
from zeno_orbits.search.program.legs import Leg, legs_of
from zeno_orbits.search.program.mesh import graded_mesh, stage_fractions
from zeno_orbits.simulation import Ending, Impact, tail_time
from zeno_orbits.work import Checked

_LEAST = 1e-12
"""Smallest size of a guard."""
_RANGE = 0.01
"""Smallest size of a free value, in units of its range."""
_PLACES = 9
"""Samples of a leg for the sizes of its guard and of its scaled gap."""
_FALLS = 1e-9
"""Least rate at which a guard falls, in units of its size over its leg."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TranscriptionSettings(Checked):
    """Scheme and tolerances of a program.

    Attributes:
        n_stages: Radau stages of an interval.
        mesh_tolerance: Largest deviation of an interval's polynomial from the guess between its
            stages, in units of the size of each state. Ends of intervals are more accurate.
        closure_tolerance: Largest estimated relative error of a Zeno point.
        backward: Part of its duration for which a plain flow may run backward. So two events can
            change their order.
    """

    n_stages: int = 7
    mesh_tolerance: float = 3e-8
    closure_tolerance: float = 1e-11
    backward: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LegPlaces:
    """Places of the unknowns and outputs of a leg.

    Attributes:
        leg: The leg.
        mesh: Ends of its intervals as fractions.
        start: State at its start, ``(n_x,)``.
        unit: The unit `w` of a rescaled flight, empty in a plain flow.
        duration: Its duration in the flow's own time.
        stages: States of the flow at the stages, ``(n_y, n)``.
        sizes: Sizes of these states, ``(n_y,)``.
        work: Outputs with weights whose sum is the electrical work.
        event: Outputs of its event.
        time: Output of the time of a rescaled flight [s], -1 in a plain flow.
    """

    leg: Leg
    mesh: Array
    start: Rows
    unit: Rows
    duration: int
    stages: Rows
    sizes: Array
    work: Mapping[int, float]
    event: Rows
    time: int

    @property
    def end(self) -> Rows:
        """State of the flow at its end."""
        return self.stages[:, -1]

    @property
    def before(self) -> Rows:
        """The column of its event, without free values."""
        return np.concatenate([self.end, self.unit])

    @property
    def elapsed(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Unknowns and outputs whose sum is the time of the leg [s]."""
        return ((self.duration,), ()) if self.time < 0 else ((), (self.time,))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PeriodProgram:
    """One period in a program.

    Attributes:
        graph: The graph of modes at the guess.
        machine: The elements.
        builder: The program.
        free: Places of the free values.
        legs: The legs.
        tails: Place of a leg to the unknown time from its impact to the Zeno point [s].
        period: Place of the period [s].
        work: Outputs with weights whose sum is the electrical work. Empty if it is not needed.
    """

    graph: GraphDynamics
    machine: MachineFormulas
    builder: ElementBuilder
    free: Rows
    legs: tuple[LegPlaces, ...]
    tails: Mapping[int, int]
    period: int
    work: Mapping[int, float]


def free_places(
    builder: ElementBuilder, graph: GraphDynamics, free: Mapping[str, tuple[float, float]]
) -> Rows:
    """Add the free values to a program, and return their places.

    Args:
        builder: The program.
        graph: The graph of modes at the guess.
        free: Name to range of the free values.
    """
    names = list(graph.compiled.symbols)
    places: list[int] = []
    for name, (low, high) in free.items():
        value = float(graph.p[names.index(name)])
        size = max(abs(value), _RANGE * (high - low)) or 1.0
        places.append(int(builder.unknowns([value], size, low, high)[0]))
    return np.array(places, dtype=np.intp)


def write_period(
    builder: ElementBuilder,
    graph: GraphDynamics,
    found: EventReturn,
    free: Mapping[str, int],
    *,
    has_work: bool = False,
    settings: TranscriptionSettings | None = None,
) -> PeriodProgram:
    """Add the rows of a periodic orbit to a program.

    Args:
        builder: The program.
        graph: The graph of modes at the guess.
        found: The guess, a return to a section that need not be closed.
        free: Name to place of the free values.
        has_work: Whether the electrical work is needed.
        settings: Accuracy of the rows.
    """
    settings = settings or TranscriptionSettings()
    machine = formulas_of_machine(graph.compiled, tuple(free))
    writer = _Writer(
        builder=builder,
        graph=graph,
        machine=machine,
        free=np.array(list(free.values()), dtype=np.intp),
        settings=settings,
        has_work=has_work,
        legs=legs_of(graph, found, settings.closure_tolerance),
    )
    return writer.written()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _After:
    """A state after an event: unknowns, or outputs if unknowns are missing."""

    unknowns: Rows
    outputs: Rows

    def terms(self) -> tuple[list[Terms], list[Terms]]:
        """Return linear terms, and terms of outputs."""
        if self.unknowns.size:
            return [(self.unknowns, 1.0)], []
        return [], [(self.outputs, 1.0)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Writer:
    """The writer of one period."""

    builder: ElementBuilder
    graph: GraphDynamics
    machine: MachineFormulas
    free: Rows
    settings: TranscriptionSettings
    has_work: bool
    legs: tuple[Leg, ...]

    @property
    def _n(self) -> int:
        return self.machine.n_x

    def _sizes(self) -> Array:
        """Return the largest size of each state, ``(n_x,)``."""
        states = [arc.sampled(20)[1] for leg in self.legs for arc in leg.pieces]
        return self.graph.own.not_zero(np.max(np.abs(np.vstack(states)), axis=0))

    def written(self) -> PeriodProgram:
        """Add all rows, and return their places."""
        sizes = self._sizes()
        legs = tuple(self._flow(leg, sizes) for leg in self.legs)
        times = self.machine.times()
        if times is not None and self.free.size:
            out = self._at(times, np.zeros((0, 1), dtype=np.intp))[:, 0]
            self.builder.rows("order of times", outputs=[(out, 1.0)], upper=np.inf)
        tails: dict[int, int] = {}
        work: dict[int, float] = {}
        for k, places in enumerate(legs):
            following = legs[(k + 1) % len(legs)]
            after = self._event(k, legs)
            if places.leg.tail is not None:
                after, tails[k] = self._limit(k, legs, sizes)
            if k + 1 < len(legs):
                linear, outputs = after.terms()
                linear.append((following.start, -1.0))
                self.builder.rows("link", linear=linear, outputs=outputs, size=sizes)
            else:
                self._close(legs[0], after, sizes)
            work |= places.work
            if self.has_work and k in tails:
                column = np.concatenate([places.before, following.start, [tails[k]]])
                work[int(self._at(self.machine.tail_work(places.leg), column)[0, 0])] = 1.0
        return PeriodProgram(
            graph=self.graph,
            machine=self.machine,
            builder=self.builder,
            free=self.free,
            legs=legs,
            tails=tails,
            period=self._period(legs, tails),
            work=work,
        )

    def _at(self, element: LegElement, columns: Rows) -> Rows:
        """Evaluate an element at columns without free values, and return its outputs."""
        one = columns if columns.ndim == 2 else columns[:, None]
        free = np.repeat(self.free[:, None], one.shape[1], axis=1)
        return self.builder.outputs(element, np.vstack([one, free]), self.graph.p)

    def _flow(self, leg: Leg, sizes: Array) -> LegPlaces:
        """Add the collocation of a leg, and its event's outputs."""
        builder, scheme, n = self.builder, radau_scheme(self.settings.n_stages), self._n
        ys = sizes
        if leg.stop is not None:
            seen = leg.trajectory(self.graph, np.linspace(0.0, 1.0, _PLACES))[:, n:]
            ys = np.append(sizes, np.max(np.abs(seen), axis=0))
        mesh = graded_mesh(
            lambda at: leg.trajectory(self.graph, at),
            scheme,
            scale=ys,
            tolerance=self.settings.mesh_tolerance,
            most=sum(len(arc.flow_times) for arc in leg.pieces) + 16,
        )
        start = builder.unknowns(leg.trajectory(self.graph, np.zeros(1))[0, :n], sizes)
        unit = np.zeros(0, dtype=np.intp)
        if leg.stop is not None:
            unit = builder.unknowns([leg.unit], leg.unit, 0.0)
        # Below zero, two events change their order.
        lower = 0.0 if unit.size else -self.settings.backward * leg.duration
        duration = int(builder.unknowns([leg.duration], leg.duration, lower)[0])
        guess = leg.trajectory(self.graph, stage_fractions(mesh, scheme)).T
        stages = builder.unknowns(guess, np.repeat(ys[:, None], guess.shape[1], axis=1))
        outputs = self._collocated(leg, mesh, start, np.append(duration, unit), stages, ys)
        work: dict[int, float] = {}
        if self.has_work:
            weights = np.outer(np.diff(mesh), scheme.weights).ravel()
            work = dict(zip(outputs[-1].tolist(), weights.tolist(), strict=True))
        event = self._at(self.machine.event(leg), np.concatenate([stages[:, -1], unit]))[:, 0]
        time = -1
        if unit.size:
            column = np.append(unit, duration)
            time = int(self._at(self.machine.product(), column)[0, 0])
        return LegPlaces(
            leg=leg,
            mesh=mesh,
            start=start,
            unit=unit,
            duration=duration,
            stages=stages,
            sizes=ys,
            work=work,
            event=event,
            time=time,
        )

    def _collocated(
        self, leg: Leg, mesh: Array, start: Rows, shared: Rows, stages: Rows, sizes: Array
    ) -> Rows:
        """Add the rows of a flow, and return the outputs at its stages, ``(n_y, n)`` or more."""
        scheme, n_y = radau_scheme(self.settings.n_stages), len(stages)
        n, s = stages.shape[1], self.settings.n_stages
        columns = np.vstack([stages, np.repeat(shared[:, None], n, axis=1)])
        outputs = self._at(self.machine.stage(leg, has_work=self.has_work), columns)
        # A rescaled flight starts with the gap 0 and the gap rate 1, in its own units.
        first = np.concatenate([start, np.full(n_y - self._n, -1)]).astype(np.intp)
        given = np.zeros(n_y)
        given[self._n + 1 :] = -1.0
        for i, h in enumerate(np.diff(mesh).tolist()):
            before = first if i == 0 else stages[:, i * s - 1]
            rates = outputs[:n_y, i * s : (i + 1) * s]
            for k in range(s):
                self.builder.rows(
                    "flow",
                    linear=[(stages[:, i * s + k], 1.0), (before, -1.0)],
                    outputs=[(rates[:, j], -h * scheme.matrix[k, j]) for j in range(s)],
                    constant=given if i == 0 else 0.0,
                    size=sizes,
                )
        return outputs

    def _event(self, k: int, legs: Sequence[LegPlaces]) -> _After:
        """Add the rows of an event, and return the state after it."""
        builder, places = self.builder, legs[k]
        leg, event, n = places.leg, places.event, self._n
        following = legs[(k + 1) % len(legs)]
        size = self._guard_size(places)
        builder.rows(f"guard of {leg.ending.value}", outputs=[(event[[GUARD]], 1.0)], size=size)
        builder.rows(
            f"fall at {leg.ending.value}",
            outputs=[(event[[FALL]], 1.0)],
            size=size / leg.duration,
            lower=_FALLS,
            upper=np.inf,
        )
        armed = self.machine.armed(leg)
        if armed is not None:
            out = self._at(armed, places.end[:n])[:, 0]
            builder.rows("armed", outputs=[(out, 1.0)], upper=np.inf)
        if leg.ending is Ending.IMPACT and following.leg.stop == leg.index:
            self._rebound(following.unit, event)
        if leg.ending is Ending.RELEASE:
            return _After(unknowns=places.end, outputs=np.zeros(0, dtype=np.intp))
        return _After(unknowns=np.zeros(0, dtype=np.intp), outputs=event[2 : 2 + n])

    def _rebound(self, speed: Rows, event: Rows) -> None:
        """Add the law of impact: the speed after it is the unit of the next flight."""
        size = float(self.builder.value(speed)[0])
        self.builder.rows(
            "restitution",
            linear=[(speed, 1.0)],
            outputs=[(event[[2 + self._n]], -1.0)],
            size=size,
        )

    def _guard_size(self, places: LegPlaces) -> float:
        """Return the size of a guard along a leg."""
        leg, graph = places.leg, self.graph
        if leg.stop == leg.index and leg.strikes:
            return float(places.sizes[self._n])
        states = leg.trajectory(graph, np.linspace(0.0, 1.0, _PLACES))[:, : self._n]
        if leg.strikes:
            view = leg.struck(graph)
            values = [view.gap(x) for x in states]
        elif leg.ending is Ending.RELEASE:
            holding = graph.holding(leg.mode, leg.index)
            values = [holding.multiplier(x) for x in states]
        else:
            values = [graph.guards(leg.mode, x)[0][leg.index] for x in states]
        return max(float(np.max(np.abs(values))), _LEAST)

    def _limit(self, k: int, legs: Sequence[LegPlaces], sizes: Array) -> tuple[_After, int]:
        """Add the limit of a sequence. Return the Zeno point, and the time from the last impact."""
        builder, tail = self.builder, legs[k].leg.tail
        if tail is None:
            raise TypeError("Argument `k` must be the place of a leg that ends at a Zeno point.")
        impact = legs[k].leg.event
        if not isinstance(impact, Impact):
            raise TypeError("A Zeno point follows an impact.")
        last = legs[k].leg.struck(self.graph).speed_after(impact.approach_rate)
        speed = builder.unknowns([last], last, 0.0)
        self._rebound(speed, legs[k].event)
        hops = [legs[place] for place in tail.legs[1:]]
        speeds: list[Rows] = []
        states: list[Rows] = []
        times: list[Rows] = []
        for node in tail.nodes:
            state, time = self._node(legs[node], sizes)
            speeds.append(speed if node == k else legs[node + 1].unit)
            states.append(state)
            times.append(time)
        first = tuple(node - tail.legs[0] for node in tail.nodes)
        durations = np.array([hop.duration for hop in hops], dtype=np.intp)
        column = np.concatenate([*speeds, *states, *times, *(hop.unit for hop in hops), durations])
        out = self._at(self.machine.limit(first, len(hops)), column)[:, 0]
        guess = float(builder.output_values(out[[-1]])[0])
        time = builder.unknowns([guess], guess, 0.0)
        builder.rows("tail", linear=[(time, -1.0)], outputs=[(out[[-1]], 1.0)], size=guess)
        after = _After(unknowns=np.zeros(0, dtype=np.intp), outputs=out[:-1])
        return after, int(time[0])

    def _node(self, places: LegPlaces, sizes: Array) -> tuple[Rows, Rows]:
        """Add the tail of an impact, and return its state and time."""
        guess, time = self._tail_of(places.leg)
        state = self.builder.unknowns(guess, sizes)
        duration = self.builder.unknowns([time], time, 0.0)
        out = self._at(self.machine.tail(places.leg), places.before)[:, 0]
        self.builder.rows("tail", linear=[(state, 1.0)], outputs=[(out[:-1], -1.0)], size=sizes)
        self.builder.rows("tail", linear=[(duration, 1.0)], outputs=[(out[-1:], -1.0)], size=time)
        return state, duration

    def _tail_of(self, leg: Leg) -> tuple[Array, float]:
        """Return the state at the end of the tail of an impact, and its time."""
        view, impact = leg.struck(self.graph), leg.event
        if not isinstance(impact, Impact):
            raise TypeError("Argument `leg` must end at an impact.")
        rest = view.resting(np.asarray(impact.state_plus))
        speed = view.speed_after(impact.approach_rate)
        time = tail_time(speed, rest.gap_acceleration, view.restitution)
        return rest.state + time * rest.rate, float(time)

    def _close(self, first: LegPlaces, after: _After, sizes: Array) -> None:
        """Add the return to the start, in the directions that keep the constraints.

        A flow preserves its constraints and the clock's circle, which hold at the start.
        """
        x0 = self.builder.value(first.start)
        system, _ = self.machine.system(first.leg.mode)
        basis = np.eye(self._n)
        if system.holonomic.numel_out(0):
            out = self._at(self.machine.holonomic(first.leg.mode), first.start)[:, 0]
            self.builder.rows("holonomic", outputs=[(out, 1.0)])
            x, p = ca.SX.sym("x", self._n), ca.SX.sym("p", len(self.graph.p))
            slope = ca.Function("slope", [x, p], [ca.jacobian(system.holonomic(x, p), x)])
            matrix = np.array(ca.DM(slope(x0, self.graph.p)).full()) * sizes
            basis = null_space(matrix, ROUNDED)
        for direction in basis.T:
            weights = (direction / sizes).tolist()
            linear, outputs = after.terms()
            places, is_linear = (linear or outputs)[0][0], bool(linear)
            added: list[Terms] = [
                (np.array([place]), weight) for place, weight in zip(places, weights, strict=True)
            ]
            back: list[Terms] = [
                (np.array([place]), -weight)
                for place, weight in zip(first.start, weights, strict=True)
            ]
            self.builder.rows(
                "return",
                linear=[*back, *(added if is_linear else [])],
                outputs=[] if is_linear else added,
            )

    def _period(self, legs: Sequence[LegPlaces], tails: Mapping[int, int]) -> int:
        """Add the period as the sum of all times, and return its place."""
        guess = float(sum(np.sum(places.leg.spans) for places in legs))
        guess += float(sum(self.builder.value(np.array([time]))[0] for time in tails.values()))
        period = self.builder.unknowns([guess], guess, 0.0)
        linear: list[Terms] = [(period, -1.0)]
        linear += [(np.array([time]), 1.0) for time in tails.values()]
        outputs: list[Terms] = []
        for places in legs:
            unknowns, products = places.elapsed
            linear += [(np.array([place]), 1.0) for place in unknowns]
            outputs += [(np.array([place]), 1.0) for place in products]
        self.builder.rows("period", linear=linear, outputs=outputs, size=guess)
        return int(period[0])
