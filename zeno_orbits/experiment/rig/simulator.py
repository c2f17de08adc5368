"""Simulation of a machine: segments off the stop and in contact, between switching times.

A contact is a stretch of motion with a stiff force, without reset, contact multiplier or Zeno
point. Contacts begin and end at roots of the gap, and voltages change at known times. The segments
between are smooth, so an integrator keeps its full order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import NoReturn

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, RunawayError, SimulationError, counted
from zeno_orbits.experiment.rig.contact_damping import damping_number
from zeno_orbits.experiment.rig.controller import ControlLoop
from zeno_orbits.experiment.rig.machine import machine
from zeno_orbits.experiment.rig.run import (
    SPACING,
    Record,
    RigRun,
    RigSettings,
    Touch,
    rate_weight,
    rig_tolerance,
)
from zeno_orbits.integrators import Leg, Outcome, Passage
from zeno_orbits.model import (
    Call,
    Columns,
    CompiledFlow,
    FlowMemory,
    OwnScale,
    ParameterValues,
    Problem,
    Rig,
)
from zeno_orbits.simulation import LegFollower
from zeno_orbits.work import Progress, silent

_MOST_AT_ONCE = 1000
"""Contacts that may begin and end without time advancing."""
_IN_CONTACT = 257
"""Records of a contact at least, where nothing else divides it."""


def simulate_rig(
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
    number = damping_number(values.number("restitution"))
    if math.isinf(number):
        wanted = "must be greater than 0 for a compliant contact"
        raise InputError(f"Argument `restitution` {wanted}, but it is 0.")
    if not (math.isfinite(until) and until > 0.0):
        raise InputError(f"Argument `until` must be a positive number, but it is {until:g}.")
    follower = _Follower(problem, values, rig, number, settings or RigSettings(), seed)
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
        number: float,
        settings: RigSettings,
        seed: int,
    ) -> None:
        built = machine(problem, rig)
        own = problem.dynamics(values).own
        tolerance = settings.tolerance or rig_tolerance(rig.contact, own)
        self._machine, self._problem, self._rig, self._settings = built, problem, rig, settings
        self._number, self._tolerance = number, tolerance.times(own.least)
        self._spacing = SPACING * own.time if settings.spacing is None else settings.spacing
        self._legs = LegFollower(self._settings.engine)
        self._p = np.asarray(values.vector, dtype=np.float64)
        self._numbers = np.concatenate([self._p, np.zeros(built.n_motors), [0.0]])
        modes = {False: built.free, True: built.contact}
        self._memories = {
            touching: FlowMemory(mode, partial(self._weights, own, touching))
            for touching, mode in modes.items()
        }
        self._observe = Call(built.observe, self._numbers)
        self._motors = Call(built.motors, self._numbers)
        self._loop = self._control_loop(np.random.default_rng(seed)) if built.holds else None
        self._time, self._n_steps = 0.0, 0
        self._row = math.ceil(settings.keep_from / self._spacing)
        self._rows: list[tuple[float, Vector, Vector, bool]] = []
        self._touches: list[Touch] = []
        self._began: tuple[float, Vector, float] | None = None

    def _control_loop(self, random: np.random.Generator) -> ControlLoop:
        command = Call(self._machine.command, self._p)
        return ControlLoop(
            self._rig,
            lambda x: command(x).copy(),
            lambda y: self._motors(y, 0).copy(),
            self._machine.n_x,
            self._machine.n_q,
            random,
        )

    def begin(self, start: Sequence[float]) -> None:
        """Set the state, every rotor in the middle of its play, off the stop or in contact."""
        x = np.asarray(start, dtype=np.float64)
        if x.shape != (self._machine.n_x,):
            wanted = f"must be of shape ({self._machine.n_x},)"
            raise InputError(f"Argument `start` {wanted}, but it is {x.shape}.")
        self._require_inertia(x)
        self._y = Call(self._machine.rest, self._p)(x).copy()
        gap, rate = self._gap()
        self._touching = gap < 0.0 or (gap == 0.0 and rate < 0.0)
        if self._touching:
            self._enter(rate)

    def _weights(self, own: OwnScale, touching: bool) -> tuple[float, ...]:
        """Return the scales of the absolute local errors."""
        if not touching or self._settings.tolerance is not None:
            return self._machine.weights(own)
        _, _, _, inertia = self._observe(self._y).tolist()
        return self._machine.weights(own, rate_weight(self._rig.contact, own, inertia))

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
                self._numbers[self._p.size : -1] = self._loop.held
                edge = min(until, self._loop.next_edge)
            before = self._time
            self._leg(edge)
            at_once = at_once + 1 if self._time == before else 0
            if at_once > _MOST_AT_ONCE:
                self._stop(SimulationError, "Contacts begin and end without time advancing")
            escaped = self._problem.escaped(self._y[: self._machine.n_x].tolist())
            if escaped:
                self._stop(RunawayError, f"`{escaped}` ran away")
            on_progress("simulating the machine", self._time / until)

    def _stop(self, kind: type[SimulationError], reason: str) -> NoReturn:
        raise kind(reason, time=self._time, state=tuple(self._y.tolist()))

    def _leg(self, edge: float) -> None:
        """Follow one mode to an edge, or to where the contact begins or ends."""
        gap, rate = self._gap()
        inside = -gap if self._touching else gap
        mode = self._machine.contact if self._touching else self._machine.free
        numbers = self._numbers.copy()
        leg = Leg(
            flow=CompiledFlow(mode, numbers, self._memories[self._touching]),
            y=self._y,
            horizon=edge - self._time,
            tolerance=self._tolerance,
            on_guard=inside <= 0.0,
            watch=self._watch,
        )
        self._n_steps = 0
        passage = self._legs.follow(leg)
        over = passage.outcome is Outcome.HORIZON
        end = edge if over else self._time + passage.duration
        self._keep(passage, end, numbers)
        self._time, self._y = end, passage.state
        if not over:
            self._touching = not self._touching
            _, rate = self._gap()
            if self._touching:
                self._enter(rate)
            else:
                self._leave(rate)

    def _watch(self, steps: int, offset: float, y: Vector) -> None:
        """End a leg that takes too long: its steps are kept until it is over."""
        self._n_steps += steps
        if self._n_steps > self._settings.most_steps:
            most = counted(self._settings.most_steps, "step")
            softer = "soften its stop (--part contact.stiffness), or raise `most_steps`"
            reason = f"The machine needs more than {most} to its next event: {softer}"
            raise SimulationError(reason, time=self._time + offset, state=tuple(y.tolist()))

    def _gap(self) -> tuple[float, float]:
        _, gap, rate, _ = self._observe(self._y).tolist()
        return gap, rate

    def _enter(self, rate: float) -> None:
        self._began = (self._time, self._y, rate)
        self._numbers[-1] = self._number / max(-rate, self._rig.contact.slowest)

    def _leave(self, rate: float, *, forever: bool = False) -> None:
        if self._began is None:
            return
        start, state, approach = self._began
        self._began = None
        touch = Touch(
            start=start,
            state=state,
            approach_rate=approach,
            end=math.inf if forever else self._time,
            end_state=self._y,
            depart_rate=rate,
        )
        self._touches.append(touch)

    def _keep(self, passage: Passage, end: float, numbers: Vector) -> None:
        """Keep the grid points inside a leg, and in a contact every step."""
        settings, start = self._settings, self._time
        times: list[float] = []
        while self._row * self._spacing < end:
            times.append(self._row * self._spacing)
            self._row += 1
        if self._touching and end >= settings.keep_from:
            own = start + passage.trajectory.times
            if self._loop is None:
                # A curve through an impact needs more points than its smooth flow has steps.
                own = np.concatenate([own, np.linspace(start, end, _IN_CONTACT)])
            kept = own[own >= settings.keep_from]
            times = sorted({*times, *kept.tolist()})
        for time in times:
            if start <= time < end:
                state = passage.trajectory.state_at(time - start)
                self._rows.append((time, state, numbers, self._touching))

    def result(self) -> RigRun:
        """Return the run."""
        self._leave(self._gap()[1], forever=True)
        self._rows.append((self._time, self._y, self._numbers.copy(), self._touching))
        times, states, numbers, touching = zip(*self._rows, strict=True)
        y, held = np.array(states), np.array(numbers)
        seen = Columns(self._machine.observe)(y, held)[0]
        current, voltage = Columns(self._machine.motors)(y, held)
        in_contact = np.array(touching, dtype=bool)
        return RigRun(
            problem=self._problem.name,
            rig=self._rig,
            state_names=self._machine.state_names,
            times=np.array(times),
            states=y,
            in_contact=in_contact,
            # A root of the gap is rounded to either side. Off the stop the force is zero.
            contact_force=np.where(in_contact, np.maximum(seen[:, 0], 0.0), 0.0),
            gap=seen[:, 1],
            gap_rate=seen[:, 2],
            current=current,
            voltage=voltage,
            touches=tuple(self._touches),
            record=self._record(np.array(times), y, current),
        )

    def _record(self, times: Vector, states: Vector, current: Vector) -> Record:
        """Return the readings of the controller, or evenly spaced states without a controller."""
        n_q = self._machine.n_q
        if self._loop is None:
            spacing = self._spacing
            even = times == np.round(times / spacing) * spacing
            return Record(times=times[even], coordinates=states[even, :n_q], currents=current[even])
        read = [entry for entry in self._loop.log if entry[0] >= self._settings.keep_from]
        width = (len(read), -1)
        return Record(
            times=np.array([entry[0] for entry in read]),
            coordinates=np.array([entry[1][:n_q] for entry in read]).reshape(*width),
            currents=np.array([entry[2] for entry in read]).reshape(*width),
        )
