"""When a machine's voltages change, and to what: readings, delays and pulses in order of time."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from zeno_orbits.dynamics import Vector
from zeno_orbits.imperfections import Bridge, Controller, Rig, Switching
from zeno_orbits.rig.pulses import Leg, level, pulse
from zeno_orbits.rig.sensing import Reader


class Pilot:
    """Reads, computes and switches; between two of its edges every voltage is constant.

    Args:
        rig: The parts of the machine.
        command: From a measured state to the voltages of the feedback.
        currents: From a true state to the motors' currents.
        n_x: Number of the scene's states.
        n_q: Number of coordinates.
        random: Where noise comes from.
    """

    def __init__(
        self,
        rig: Rig,
        command: Callable[[Vector], Vector],
        currents: Callable[[Vector], Vector],
        n_x: int,
        n_q: int,
        random: np.random.Generator,
    ) -> None:
        self._command, self._currents, self._n_x = command, currents, n_x
        exact = rig.bridge is not None and rig.bridge.switching is Switching.EXACT
        self._bridge: Bridge | None = rig.bridge if exact else None
        self._controller = rig.controller or _as_fast_as(rig.bridge)
        self._reader = Reader(rig.sensors, self._controller, n_q, random)
        self._readings, self._periods = 0, 0
        self._waiting: deque[tuple[float, Vector]] = deque()
        self._edges: deque[tuple[float, int, Leg, float]] = deque()
        self._asked: Vector | None = None
        self.log: list[tuple[float, Vector, Vector]] = []
        self.held: Vector = np.zeros(0)

    @property
    def next_edge(self) -> float:
        """When something happens next [s]."""
        times = [self._readings * self._controller.period]
        times += [self._waiting[0][0]] if self._waiting else []
        if self._bridge is not None:
            times.append(self._periods / self._bridge.frequency)
            times += [self._edges[0][0]] if self._edges else []
        return min(times)

    def act(self, time: float, y: Vector) -> None:
        """Do what is due at a time: read, take over an earlier command, start pulses, switch."""
        if time >= self._readings * self._controller.period:
            self._read(time, y)
        while self._waiting and self._waiting[0][0] <= time:
            self._asked = self._waiting.popleft()[1]
        if self._asked is None:
            # Before the first command arrives the motors get nothing.
            self._asked = np.zeros_like(self._waiting[0][1])
        if self._bridge is None:
            self.held = self._asked
        else:
            self._switch(time, y, self._bridge, self._asked)

    def _read(self, time: float, y: Vector) -> None:
        measured = self._reader.read(y[: self._n_x])
        self.log.append((time, measured, self._reader.currents(self._currents(y))))
        self._waiting.append((time + self._controller.delay, self._command(measured)))
        self._readings += 1

    def _switch(self, time: float, y: Vector, bridge: Bridge, asked: Vector) -> None:
        if self.held.size != asked.size:
            self.held = np.zeros_like(asked)
        if time >= self._periods / bridge.frequency:
            edges: list[tuple[float, int, Leg, float]] = []
            for motor, voltage in enumerate(asked.tolist()):
                share = min(abs(voltage) / bridge.supply, 1.0)
                sign = math.copysign(1.0, voltage)
                edges += [(time + at, motor, leg, sign) for at, leg in pulse(bridge, share)]
            self._edges = deque(sorted(edges, key=lambda edge: edge[0]))
            self._periods += 1
        held = self.held.copy()
        while self._edges and self._edges[0][0] <= time:
            _, motor, leg, sign = self._edges.popleft()
            held[motor] = level(bridge, leg, sign, float(self._currents(y)[motor]))
        self.held = held


def _as_fast_as(bridge: Bridge | None) -> Controller:
    """Return the controller of a bridge without one: it knows the state at the start of a pulse."""
    if bridge is None:
        raise ValueError("Argument `rig` must have a controller or switch exactly, but it has not.")
    return Controller(period=1.0 / bridge.frequency)
