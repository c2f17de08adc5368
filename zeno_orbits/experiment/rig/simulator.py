"""Simulation of a machine: segments off the stops and in contact, between switching times.

A contact is a stretch of motion with a stiff force, without reset, contact multiplier or Zeno
point. Contacts begin and end at roots of the gaps, and voltages change at known times. Kinks of the
problem's formulas and its declared switches are events, as in the model. The segments between are
smooth, so an integrator keeps its full order.

A segment follows the guard that is expected to fall first. The other guards are then followed along
its steps, and the earliest zero ends the segment.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NoReturn, cast

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, RunawayError, SimulationError, counted
from zeno_orbits.experiment.rig.controller import ControlLoop
from zeno_orbits.experiment.rig.dry_friction import GUARDS_PER_PART, DryLoad
from zeno_orbits.experiment.rig.machine import machine
from zeno_orbits.experiment.rig.modes import RigGuard, RigMode, damping_numbers
from zeno_orbits.experiment.rig.run import (
    SPACING,
    RigRecord,
    RigRun,
    RigSettings,
    Touch,
    bounce_time,
    contacts_at,
    electric_outputs,
    rate_weight,
    rig_tolerance,
    time_scale_of,
)
from zeno_orbits.integrators import (
    BoxedStep,
    Segment,
    SegmentResult,
    SteppedTrajectory,
    Termination,
    follow_steps,
)
from zeno_orbits.model import (
    Call,
    Columns,
    CompiledFlow,
    FlowMemory,
    ModeFunctions,
    ParameterValues,
    Problem,
    Rig,
)
from zeno_orbits.simulation import (
    LegFollower,
    LoopTrajectory,
    armed_at_start,
    enters_by_switch,
    slides,
)
from zeno_orbits.work import Progress, silent

_MOST_AT_ONCE = 1000
"""Contacts that may begin and end without time advancing."""
_IN_CONTACT = 257
"""Records of a contact at least, where nothing else divides it."""
_GROW, _SHORTEST = 4.0, 1e-3
"""Next window over the previous segment, and the shortest window over the problem's time."""
_PERSISTS = 4.0
"""Duration from which a contact persists, in undamped bounces."""
_INSIDE = 1e-9
"""Penetration over the scale of the gap from which a reset has sent the state into a stop."""


def run_rig(
    problem: Problem,
    values: ParameterValues,
    rig: Rig,
    start: Sequence[float],
    until: float,
    *,
    seed: int = 0,
    settings: RigSettings | None = None,
    on_progress: Progress = silent,
) -> RigRun:
    """Simulate a machine.

    Args:
        problem: The problem.
        values: Parameter values of the problem. The contact is damped for the restitution.
        rig: The parts of the machine.
        start: State of the problem, ``(n_x,)``. Rotors driven through gears start in the middle of
            their backlash.
        until: End time [s].
        seed: Random seed of the noise.
        settings: Accuracy of the integration and the records to keep.
        on_progress: Called with the simulated part of the time, after every segment.

    Raises:
        InputError: If the rig does not fit the problem, or its restitution is 0, since a compliant
            contact cannot be plastic.
        RunawayError: If a coordinate diverges.
        SimulationError: If the integration fails.
    """
    if not (math.isfinite(until) and until > 0.0):
        raise InputError(f"Argument `until` must be a positive number, but it is {until:g}.")
    follower = _Follower(problem, values, rig, settings or RigSettings(), seed)
    follower.begin(start)
    follower.follow(until, on_progress)
    return follower.result()


class _Follower:
    """Integrator of a machine, which records its motion."""

    def __init__(
        self,
        problem: Problem,
        values: ParameterValues,
        rig: Rig,
        settings: RigSettings,
        seed: int,
    ) -> None:
        built = machine(problem, rig)
        self._graph = problem.graph_dynamics(values)
        views = self._graph.open_views
        self._views, e = views, [view.restitution for view in views]
        self._numbers_of = damping_numbers(dict(zip(built.stop_names, e, strict=False)))
        self._owns = tuple(view.own for view in views)
        own = self._owns[0]
        tolerances = [rig_tolerance(rig.contact, one) for one in self._owns]
        tolerance = settings.tolerance or min(tolerances, key=lambda one: one.relative)
        self._machine, self._problem, self._rig, self._settings = built, problem, rig, settings
        self._values, self._tolerance = values, tolerance.times(own.least)
        self._own_time = time_scale_of(problem, values)
        self._spacing = SPACING * self._own_time if settings.spacing is None else settings.spacing
        self._legs = LegFollower(self._settings.engine)
        self._p = np.asarray(values.vector, dtype=np.float64)
        self._numbers = np.concatenate([self._p, np.zeros(built.n_motors), np.zeros(len(views))])
        self._memories: dict[ModeFunctions, FlowMemory] = {}
        self._observe = Call(built.observe, self._numbers)
        self._motors = Call(built.motors, self._numbers)
        self._loop = self._control_loop(np.random.default_rng(seed)) if built.holds else None
        self._time, self._n_steps = 0.0, 0
        self._row = math.ceil(settings.keep_from / self._spacing)
        self._rows: list[tuple[float, Vector, Vector, tuple[int, ...]]] = []
        self._touches: list[Touch] = []
        self._began: dict[int, tuple[float, Vector, float]] = {}
        self._mode = RigMode()
        self._window = _SHORTEST * self._own_time
        self._crossed: tuple[float, int] | None = None
        self._fallen: tuple[float, int] | None = None
        self._frictional = self._graph.compiled.graph.frictional
        self._dry_calls: dict[ca.Function, Call] = {}
        self._is_held = np.isin(np.arange(built.n_x), self._graph.compiled.graph.held)
        # A controller knows the values that it holds, and the clock at an event that it dates.
        dated = rig.sensors is not None and rig.sensors.window > 0.0
        turns = self._graph.compiled.graph.mechanism.clock
        n_clock = turns.state.numel() if dated and turns is not None else 0
        self._is_known = self._is_held | (np.arange(built.n_x) >= built.n_x - n_clock)
        self._persists: dict[int, float] = {}
        self._rested: set[int] = set()

    def _control_loop(self, random: np.random.Generator) -> ControlLoop:
        command = Call(self._machine.command, self._p)
        return ControlLoop(
            self._rig,
            lambda x: command(x).copy(),
            lambda y: self._motors(y, 0).copy(),
            self._machine.n_x,
            self._machine.n_q,
            self._machine.sensed,
            random,
        )

    def begin(self, start: Sequence[float]) -> None:
        """Set the state, every rotor in the middle of its play, off the stops or in contact."""
        x = np.asarray(start, dtype=np.float64)
        if x.shape != (self._machine.n_x,):
            wanted = f"must be of shape ({self._machine.n_x},)"
            raise InputError(f"Argument `start` {wanted}, but it is {x.shape}.")
        self._require_inertia(x)
        self._y = Call(self._machine.rest, self._p)(x).copy()
        above, sides = self._signs_at(self._graph.open_mode[1])
        self._mode = RigMode(sides=sides, above=above)
        self._take_contacts()
        if self._machine.dry_names:
            self._take_dry_sides(self._dry_load().first_sides())

    def _take_contacts(self) -> None:
        """Begin the contacts of a state, and end those that it has left."""
        gaps, rates = self._gaps()
        for k, (gap, rate) in enumerate(zip(gaps.tolist(), rates.tolist(), strict=True)):
            touches = gap < 0.0 or (gap == 0.0 and rate < 0.0)
            if touches != (k in self._mode.touched):
                self._turn(k)

    def _dry_load(self) -> DryLoad:
        """Return what decides which parts with dry friction slip."""
        formula, n_q = self._machine.load(self._mode.touched, self._mode.sides), self._machine.n_q
        if formula not in self._dry_calls:
            self._dry_calls[formula] = Call(formula, self._numbers)
        scales = self._owns[0].states(self._machine.n_x)[n_q : 2 * n_q]
        v = self._y[n_q : 2 * n_q]
        return DryLoad.of(
            self._dry_calls[formula](self._y).copy(), len(self._machine.dry_names), v, scales
        )

    def _take_dry_sides(self, dry: tuple[int, ...]) -> None:
        """Give the parts with dry friction their sides, and the rates of those that stick to 0."""
        y, n_q = self._y.copy(), self._machine.n_q
        y[list(self._machine.dry_sides)] = dry
        load, stuck = self._dry_load(), [side == 0 for side in dry]
        if any(stuck):
            rows = load.rows[stuck]
            y[n_q : 2 * n_q] -= np.linalg.lstsq(rows, load.rates[stuck])[0]
        self._y = y
        above, sides = self._signs_at(self._mode.sides)
        self._mode = replace(self._mode, above=above, sides=sides)

    def _settle_dry(self, fell: tuple[int, int] | None = None) -> DryLoad | None:
        """Let the parts with dry friction slip or stick as their laws ask, and return their load.

        Args:
            fell: Index of the part whose guard has fallen, and which one, or ``None`` at an event
                of the machine.

        Raises:
            SimulationError: If no sides fulfil the laws.
        """
        before = tuple(int(one) for one in self._y[list(self._machine.dry_sides)])
        if not before:
            return None
        part, kind = fell or (-1, -1)
        fixed = {part: 1 if kind == 1 else -1} if kind > 0 else {}
        at_rest = (part,) if kind == 0 else ()
        load = self._dry_load()
        after = load.sides(before, fixed=fixed, at_rest=at_rest)
        if after is None:
            names = ", ".join(f"`{name}`" for name in self._machine.dry_names)
            self._stop(SimulationError, f"No forces fulfil the laws of dry friction of {names}")
        if after == before:
            return load
        self._take_dry_sides(after)
        return self._dry_load()

    def _signs_at(self, before: tuple[bool, ...]) -> tuple[tuple[bool, ...], tuple[bool, ...]]:
        """Return the side of every declared switch and kink at the state. A zero keeps the side."""
        graph, x = self._graph, self._y[: self._machine.n_x]
        guards, rounding, _ = graph.guards(((), before), x)
        above = tuple(bool(not guards[k] < -rounding[k]) for k in range(graph.n_declared))
        return above, graph.sides_at(x, before)

    def _weights(self) -> tuple[float, ...]:
        """Return the scales of the absolute local errors in the present mode."""
        own, touched = self._owns[0], self._mode.touched
        if not touched or self._settings.tolerance is not None:
            return self._machine.weights(own)
        _, _, _, inertias = self._observed()
        factors = [
            rate_weight(self._rig.contact, self._owns[k], float(inertias[k])) for k in touched
        ]
        return self._machine.weights(own, max(factors))

    def _require_inertia(self, x: Vector) -> None:
        n_q = self._machine.n_q
        mass = Call(self._machine.inertia, self._p)(x).reshape(n_q, n_q)
        if self._rig.gears and float(np.min(np.linalg.eigvalsh(mass))) <= 0.0:
            wanted = "must be below the problem's inertia, which includes the rotors"
            raise InputError(f"Argument `rotor_inertia` {wanted}.")

    def follow(self, until: float, on_progress: Progress) -> None:
        """Carry the machine forward to a time, from edge to edge."""
        at_once = 0
        while self._time < until:
            edge = until
            if self._loop is not None:
                while self._loop.next_edge <= self._time:
                    self._loop.act(self._time, self._y)
                n_p = self._p.size
                self._numbers[n_p : n_p + self._machine.n_motors] = self._loop.held
                edge = min(until, self._loop.next_edge)
            edge = min([edge, *self._persists.values()])
            before = self._time
            self._leg(edge, self._settle_dry())
            for stop in [k for k, end in self._persists.items() if end <= self._time]:
                del self._persists[stop]
                self._rested.add(stop)
                self._set_anew("zeno", stop)
            at_once = at_once + 1 if self._time == before else 0
            if at_once > _MOST_AT_ONCE:
                self._stop(SimulationError, "Contacts begin and end without time advancing")
            escaped = self._problem.escaped(self._y[: self._machine.n_x].tolist())
            if escaped:
                self._stop(RunawayError, f"`{escaped}` ran away")
            on_progress("simulating the machine", self._time / until)

    def _stop(self, kind: type[SimulationError], reason: str) -> NoReturn:
        raise kind(reason, time=self._time, state=tuple(self._y.tolist()))

    def _leg(self, edge: float, load: DryLoad | None) -> None:
        """Follow one mode to an edge, or to the first event.

        Args:
            edge: Time of the edge [s].
            load: Load of the parts with dry friction at the start, if there are any.
        """
        guards = list(self._guards(load))
        horizon = edge - self._time
        if len(guards) > 1:
            horizon = min(horizon, self._window)
        numbers = self._numbers.copy()
        fell, passage = self._first(guards, horizon, numbers)
        over = passage.outcome is Termination.HORIZON
        ends = over and horizon == edge - self._time
        end = edge if ends else self._time + passage.duration
        self._keep(passage, end, numbers)
        self._time, self._y = end, passage.state
        if over:
            self._window *= _GROW
            return
        self._window = max(_GROW * passage.duration, _SHORTEST * self._own_time)
        n_stops, first_dry = self._machine.n_watched, self._machine.first_dry
        if fell < n_stops:
            self._turn(fell)
        elif fell < first_dry:
            self._cross(fell - n_stops, passage.outcome)
        else:
            self._settle_dry(divmod(fell - first_dry, GUARDS_PER_PART))

    def _guards(self, load: DryLoad | None) -> Iterator[RigGuard]:
        """Yield the guards of the mode, first the one that is expected to fall first."""
        gaps, rates = self._gaps()
        signs = np.where(np.isin(np.arange(gaps.size), self._mode.touched), -1.0, 1.0)
        insides, speeds = signs * gaps, signs * rates
        with np.errstate(divide="ignore", invalid="ignore"):
            soon = np.where(speeds < 0.0, np.maximum(insides, 0.0) / -speeds, np.inf)
        first = self._mode.touched[0] if self._mode.touched else int(np.argmin(soon))
        for k in sorted(range(gaps.size), key=lambda k: k != first):
            yield RigGuard(k, on_guard=bool(insides[k] <= 0.0))
        x = self._y[: self._machine.n_x]
        values, levels, _ = self._graph.guards(((), self._mode.sides), x)
        sides = (*self._mode.above, *self._mode.sides)
        for s, (value, level, side) in enumerate(zip(values, levels, sides, strict=True)):
            if s < self._graph.n_declared and (self._graph.causes[s] or s in self._frictional):
                continue
            on_guard = bool((value if side else -value) <= level)
            yield RigGuard(gaps.size + s, on_guard=on_guard, rounding=float(level), above=side)
        if load is not None:
            yield from self._dry_guards(load)

    def _dry_guards(self, load: DryLoad) -> Iterator[RigGuard]:
        """Yield the rate of every part that slips, and what is left of the others' friction."""
        for j, side in enumerate(self._y[list(self._machine.dry_sides)].tolist()):
            first = self._machine.first_dry + GUARDS_PER_PART * j
            if side:
                level = float(load.rounding[j])
                on_guard = bool(side * load.rates[j] <= level)
                yield RigGuard(first, on_guard=on_guard, rounding=level, above=side > 0.0)
            else:
                yield from (RigGuard(first + k, on_guard=False) for k in range(1, GUARDS_PER_PART))

    def _first(
        self, guards: Sequence[RigGuard], horizon: float, numbers: Vector
    ) -> tuple[int, SegmentResult]:
        """Return the guard that ends a leg first, and the flow up to its zero."""
        leg = Segment(
            flow=self._flow(guards[0], numbers),
            y=self._y,
            horizon=horizon,
            tolerance=self._tolerance,
            on_guard=guards[0].on_guard,
            watch=self._watch,
        )
        self._n_steps = 0
        fell, passage = guards[0].index, self._legs.follow(leg)
        for guard in guards[1:]:
            if passage.duration <= 0.0:
                break
            beside = Segment(
                flow=self._flow(guard, numbers),
                y=self._y,
                horizon=passage.duration,
                tolerance=self._tolerance,
                on_guard=guard.on_guard,
                rounding=guard.rounding,
            )
            found = self._beside(passage, beside)
            if found.outcome is not Termination.HORIZON:
                fell, passage = guard.index, found
        return fell, passage

    def _beside(self, passage: SegmentResult, leg: Segment) -> SegmentResult:
        """Follow another guard along the steps of a leg, or once more without steps."""
        way = passage.trajectory
        if not isinstance(way, SteppedTrajectory | LoopTrajectory):
            return self._legs.follow(leg)
        return follow_steps(iter(cast("Sequence[BoxedStep]", way.steps)), leg)

    def _flow(self, guard: RigGuard, numbers: Vector) -> CompiledFlow:
        """Return the flow of the present mode with a guard."""
        mode = self._machine.mode(
            self._mode.touched, self._mode.sides, guard.index, above=guard.above
        )
        if mode not in self._memories:
            self._memories[mode] = FlowMemory(mode, self._weights)
        return CompiledFlow(mode, numbers, self._memories[mode])

    def _watch(self, steps: int, offset: float, y: Vector) -> None:
        """End a leg that takes too long: its steps are kept until it is over."""
        self._n_steps += steps
        if self._n_steps > self._settings.most_steps:
            most = counted(self._settings.most_steps, "step")
            softer = "soften its stop (--part contact.stiffness), or raise `most_steps`"
            reason = f"The machine needs more than {most} to its next event: {softer}"
            raise SimulationError(reason, time=self._time + offset, state=tuple(y.tolist()))

    def _observed(self) -> Vector:
        """Return forces, gaps, gap rates and normal inertias of the stops, ``(4, n_stops)``."""
        return self._observe(self._y).copy().reshape(4, -1)

    def _gaps(self) -> tuple[Vector, Vector]:
        _, gaps, rates, _ = self._observed()
        return gaps, rates

    def _turn(self, stop: int) -> None:
        """Begin a contact, or end it."""
        self._mode = self._mode.turned(stop)
        _, _, rates, inertias = self._observed()
        if stop in self._mode.touched:
            rate = float(rates[stop])
            self._began[stop] = (self._time, self._y, rate)
            factor = self._damping_number(stop, -rate) / max(-rate, self._rig.contact.slowest)
            self._numbers[self._numbers.size - rates.size + stop] = factor
            if any(self._graph.causes):
                bounce = bounce_time(self._rig.contact, self._owns[stop], float(inertias[stop]))
                self._persists[stop] = self._time + _PERSISTS * bounce
        else:
            self._leave(stop, float(rates[stop]))
            self._persists.pop(stop, None)
            rested = stop in self._rested
            self._rested.discard(stop)
            self._set_anew("release" if rested else "impact", stop)
        if self._loop is not None:
            self._loop.jumped()

    def _set_anew(self, kind: str, stop: int) -> None:
        """Set states at an event of a stop, from what the controller last measured.

        A contact that lasts for several bounces is permanent, and its end is a release. The end of
        a shorter one is the end of an impact. With a window of readings, a release sets states if
        the window fits.

        Args:
            kind: Kind of the event.
            stop: Index of the stop.
        """
        graph, n_x = self._graph, self._machine.n_x
        switch = graph.setter_at(f"{kind} {self._machine.stop_names[stop]}")
        if switch is None:
            return
        # A contact of so few readings is chatter after a release, or the start of the run.
        if kind == "release" and self._loop is not None and not self._loop.fits(self._time):
            return
        after = self._y.copy()
        after[:n_x] = np.where(self._is_held, self._measured_after(switch), after[:n_x])
        self._y = after
        above, sides = self._signs_at(self._mode.sides)
        self._mode = replace(self._mode, above=above, sides=sides)

    def _measured_after(self, switch: int) -> Vector:
        """Return the state after a reset of the state that the controller has measured."""
        x = self._y[: self._machine.n_x]
        measured = x if self._loop is None else self._loop.estimate(self._time, x)
        return self._graph.after_switch(switch, np.where(self._is_known, x, measured))

    def _damping_number(self, stop: int, speed: float) -> float:
        """Return the damping number of a contact that begins at a speed."""
        view = self._views[stop]
        if view.restitution_at is None:
            return self._numbers_of[stop]
        name = self._machine.stop_names[stop]
        return damping_numbers({name: view.restitution_of(speed)})[0]

    def _leave(self, stop: int, rate: float, *, forever: bool = False) -> None:
        start, state, approach = self._began.pop(stop)
        touch = Touch(
            start=start,
            state=state,
            approach_rate=approach,
            end=math.inf if forever else self._time,
            end_state=self._y,
            depart_rate=rate,
            stop=self._machine.stop_names[stop],
        )
        self._touches.append(touch)

    def _cross(self, switch: int, outcome: Termination) -> None:
        """Go to the other side of a switch, or apply the reset of an armed one.

        Raises:
            SlidingError: If the flows on both sides of a kink point to it.
            SimulationError: If a declared switch is armed where its guard is zero at a start.
            PenetrationError: If a reset sends the state into a stop.
        """
        graph, x = self._graph, self._y[: self._machine.n_x]
        name, before = graph.switch_names[switch], self._mode
        falls = outcome is Termination.FALL
        armed = (
            switch < graph.n_declared
            and before.above[switch]
            and bool(graph.guards(((), before.sides), x)[2][switch] > 0.0)
        )
        if armed and falls:
            self._reset(switch)
            self._fallen = self._time, switch
            return
        if not falls and self._crossed == (self._time, switch):
            raise slides(graph, switch, self._time, x)
        if armed and self._fallen != (self._time, switch):
            raise armed_at_start(name, self._time, x)
        self._crossed = None if falls else (self._time, switch)
        self._mode = before.flipped(graph, switch, x)
        if falls and switch >= graph.n_declared:
            side = self._mode.sides[switch - graph.n_declared]
            beyond = RigGuard(self._machine.n_watched + switch, on_guard=True, above=side)
            if self._flow(beyond, self._numbers.copy()).guard(self._y)[1] < 0.0:
                raise slides(graph, switch, self._time, x)

    def _reset(self, switch: int) -> None:
        """Apply the reset of a declared switch."""
        graph, n_x = self._graph, self._machine.n_x
        after = self._y.copy()
        true = graph.after_switch(switch, self._y[:n_x])
        after[:n_x] = np.where(self._is_held, self._measured_after(switch), true)
        n_moving = 2 * self._machine.n_q
        if self._loop is not None and np.any(after[:n_moving] != self._y[:n_moving]):
            self._loop.jumped()
        self._y = after
        above, sides = self._signs_at(self._mode.sides)
        self._mode = replace(self._mode, above=above, sides=sides)
        gaps, _ = self._gaps()
        for k, (gap, own) in enumerate(zip(gaps, self._owns, strict=True)):
            if k not in self._mode.touched and gap < -_INSIDE * own.gap:
                stop = self._machine.stop_names[k]
                raise enters_by_switch(graph.switch_names[switch], stop, self._time, after[:n_x])
        self._take_contacts()

    def _keep(self, passage: SegmentResult, end: float, numbers: Vector) -> None:
        """Keep the grid points inside a leg, and in a contact every step."""
        settings, start, touched = self._settings, self._time, self._mode.touched
        times: list[float] = []
        while self._row * self._spacing < end:
            times.append(self._row * self._spacing)
            self._row += 1
        if touched and end >= settings.keep_from:
            own = start + passage.trajectory.times
            if self._loop is None:
                # A curve through an impact needs more points than its smooth flow has steps.
                own = np.concatenate([own, np.linspace(start, end, _IN_CONTACT)])
            kept = own[own >= settings.keep_from]
            times = sorted({*times, *kept.tolist()})
        inside = [time for time in times if start <= time < end]
        states = passage.trajectory.states_at(np.array(inside) - start) if inside else ()
        self._rows += [(*pair, numbers, touched) for pair in zip(inside, states, strict=True)]

    def result(self) -> RigRun:
        """Return the run."""
        _, rates = self._gaps()
        for k in list(self._began):
            self._leave(k, float(rates[k]), forever=True)
        self._rows.append((self._time, self._y, self._numbers.copy(), self._mode.touched))
        times, states, numbers, contacts = zip(*self._rows, strict=True)
        y, held = np.array(states), np.array(numbers)
        n_stops = len(self._machine.stop_names)
        shape = (len(times),) if n_stops == 1 else (len(times), n_stops)
        seen = Columns(self._machine.observe)(y, held)[0].reshape(len(times), 4, -1)[..., :n_stops]
        current, voltage = Columns(self._machine.motors)(y, held)
        touched = [[k in one for k in range(n_stops)] for one in contacts]
        in_contact = np.array(touched, dtype=bool).reshape(len(times), n_stops)
        # A root of the gap is rounded to either side. Off the stop the force is zero.
        force = np.where(in_contact, np.maximum(seen[:, 0], 0.0), 0.0)
        return RigRun(
            problem=self._problem.name,
            rig=self._rig,
            state_names=self._machine.state_names,
            stop_names=self._machine.stop_names,
            times=np.array(times),
            states=y,
            in_contact=in_contact.reshape(shape),
            contact_force=force.reshape(shape),
            gap=seen[:, 1].reshape(shape),
            gap_rate=seen[:, 2].reshape(shape),
            current=current,
            voltage=voltage,
            touches=tuple(sorted(self._touches, key=lambda one: one.start)),
            record=self._record(np.array(times), y, current),
        )

    def _record(self, times: Vector, states: Vector, current: Vector) -> RigRecord:
        """Return the readings of the controller, or evenly spaced states without a controller."""
        n_q, n_x = self._machine.n_q, self._machine.n_x
        if self._loop is None:
            spacing = self._spacing
            even = times == np.round(times / spacing) * spacing
            chosen = electric_outputs(self._problem)
            outputs = np.zeros((int(even.sum()), 0))
            if chosen:
                table = self._problem.output_values(self._values, states[even, :n_x])
                outputs = table[:, chosen]
            return RigRecord(
                times=times[even],
                coordinates=states[even, :n_q],
                currents=current[even],
                contacts=contacts_at(self._touches, self._machine.stop_names, times[even]),
                outputs=outputs,
            )
        read = [entry for entry in self._loop.log if entry[0] >= self._settings.keep_from]
        width = (len(read), -1)
        at = np.array([entry[0] for entry in read])
        return RigRecord(
            times=at,
            coordinates=np.array([entry[1][:n_q] for entry in read]).reshape(*width),
            currents=np.array([entry[2] for entry in read]).reshape(*width),
            contacts=contacts_at(self._touches, self._machine.stop_names, at),
            outputs=np.zeros((len(read), 0)),
        )
