"""The digital controller of a machine: readings, delays and pulses in order of time.

Encoders round the coordinates, and rates are differences of the rounded coordinates (theory (6.5)).
The pulses of an H-bridge are resolved edge by edge (theory (6.4)).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from enum import Enum

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import Controller, HBridge, PwmSettings, Rig, Sensors


class ControlLoop:
    """Controller that reads, computes and switches. Voltages are constant between its edges.

    Args:
        rig: The parts of the machine.
        command: Function from a measured state to the feedback voltages.
        currents: Function from a true state to the motor currents.
        n_x: Number of the problem's states.
        n_q: Number of coordinates.
        sensed: Index of the current's state of each motor, or -1 if the current is no state.
        random: Random generator of the noise.
    """

    def __init__(
        self,
        rig: Rig,
        command: Callable[[Vector], Vector],
        currents: Callable[[Vector], Vector],
        n_x: int,
        n_q: int,
        sensed: Sequence[int],
        random: np.random.Generator,
    ) -> None:
        self._sensed = [(motor, k) for motor, k in enumerate(sensed) if k >= 0]
        self._command, self._currents, self._n_x = command, currents, n_x
        exact = rig.bridge is not None and rig.bridge.switching is PwmSettings.EXACT
        self._bridge: HBridge | None = rig.bridge if exact else None
        self._controller = rig.controller or _as_fast_as(rig.bridge)
        self._reader = Encoders(rig.sensors, self._controller, n_q, random)
        self._arc = ArcReadings(0.0 if rig.sensors is None else rig.sensors.window, n_q)
        self._readings, self._periods = 0, 0
        self._waiting: deque[tuple[float, Vector]] = deque()
        self._edges: deque[tuple[float, int, BridgeLeg, float]] = deque()
        self._asked: Vector | None = None
        self.log: list[tuple[float, Vector, Vector]] = []
        self.held: Vector = np.zeros(0)

    @property
    def next_edge(self) -> float:
        """Time of the next event [s]."""
        times = [self._readings * self._controller.period]
        times += [self._waiting[0][0]] if self._waiting else []
        if self._bridge is not None:
            times.append(self._periods / self._bridge.frequency)
            times += [self._edges[0][0]] if self._edges else []
        return min(times)

    def act(self, time: float, y: Vector) -> None:
        """Process the events due at a time: readings, delayed commands, pulses, switching edges."""
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

    def jumped(self) -> None:
        """Take note that velocities have jumped: readings from before are of another arc."""
        self._arc.clear()

    def estimate(self, time: float, x: Vector) -> Vector:
        """Return what the controller knows of the state at an event, ``(n_x,)``.

        Args:
            time: Time of the event [s].
            x: The state itself, for an event before the first reading.
        """
        return self._arc.estimate(time, self.log[-1][1]) if self.log else x

    def fits(self, time: float) -> bool:
        """Return True if the window holds enough readings of the present arc, or is not used.

        Args:
            time: Time of the event [s].
        """
        return self._arc.fits(time)

    def _read(self, time: float, y: Vector) -> None:
        measured = self._reader.read(y[: self._n_x]).copy()
        currents = self._reader.currents(self._currents(y))
        for motor, k in self._sensed:
            measured[k] = currents[motor]
        self._arc.add(time, measured)
        self.log.append((time, measured, currents))
        self._waiting.append((time + self._controller.delay, self._command(measured)))
        self._readings += 1

    def _switch(self, time: float, y: Vector, bridge: HBridge, asked: Vector) -> None:
        if self.held.size != asked.size:
            self.held = np.zeros_like(asked)
        if time >= self._periods / bridge.frequency:
            edges: list[tuple[float, int, BridgeLeg, float]] = []
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


def _as_fast_as(bridge: HBridge | None) -> Controller:
    """Return the controller of a bridge without controller, which reads at the start of a pulse."""
    if bridge is None:
        raise ValueError(
            "Argument `rig` must have a controller or exact switching, but it has neither."
        )
    return Controller(period=1.0 / bridge.frequency)


class Encoders:
    r"""Converter of true states to measured states, one reading at a time (theory (6.5)).

    .. math:: q_k = r\,\mathrm{round}\!\left(\frac{q(t_k) + \nu_k}{r}\right),\qquad
        v_k = a\,v_{k-1} + (1 - a)\,\frac{q_k - q_{k-1}}{T_s},\qquad a = e^{-T_s/\tau},\qquad
        i_k = i(t_k) + \eta_k

    Args:
        sensors: Sensor parameters, or ``None`` to return the states themselves.
        controller: Controller, which sets the sampling period.
        n_q: Number of coordinates.
        random: Random generator of the noise.
    """

    def __init__(
        self,
        sensors: Sensors | None,
        controller: Controller,
        n_q: int,
        random: np.random.Generator,
    ) -> None:
        self._sensors, self._period, self._n_q, self._random = (
            sensors,
            controller.period,
            n_q,
            random,
        )
        tau = 0.0 if sensors is None else sensors.filter_time
        self._kept = math.exp(-controller.period / tau) if tau > 0.0 else 0.0
        self._last: Vector | None = None
        self._rates: Vector = np.zeros(n_q)

    def read(self, x: Vector) -> Vector:
        """Return the measured state, ``(n_x,)``. The next reading follows one period later."""
        sensors, n_q = self._sensors, self._n_q
        if sensors is None:
            return x
        known = x.copy()
        q = x[:n_q]
        if sensors.noise > 0.0:
            q = q + self._random.normal(0.0, sensors.noise, n_q)
        if sensors.resolution > 0.0:
            # Adding zero turns -0.0 into 0.0.
            q = sensors.resolution * np.round(q / sensors.resolution) + 0.0
        if self._last is None:
            # The first reading lacks a previous reading for a difference. A real machine would have
            # run before.
            self._rates = x[n_q : 2 * n_q].copy()
        else:
            slope = (q - self._last) / self._period
            self._rates = self._kept * self._rates + (1.0 - self._kept) * slope
        self._last = q
        known[:n_q], known[n_q : 2 * n_q] = q, self._rates
        return known

    def currents(self, exact: Vector) -> Vector:
        """Return motor currents as they are read, ``(n_M,)`` [A]."""
        if self._sensors is None or self._sensors.current_noise == 0.0:
            return exact.copy()
        return exact + self._random.normal(0.0, self._sensors.current_noise, exact.size)


class ArcReadings:
    r"""Readings of the present arc, through which parabolas are fitted (theory (6.5)).

    The parabola of least squares through the readings of the last `window` gives coordinates and
    rates at an event. For many readings `n`, of errors :math:`\sigma`, the error of the rate is
    :math:`\sqrt{192 / n^3}\,\sigma / T_s`.

    Args:
        window: Time over which readings are kept [s]. Zero takes the last reading.
        n_q: Number of coordinates.
    """

    def __init__(self, window: float, n_q: int) -> None:
        self._window, self._n_q = window, n_q
        self._readings: deque[tuple[float, Vector]] = deque()

    def add(self, time: float, measured: Vector) -> None:
        """Add a reading, and drop those that are older than the window.

        Args:
            time: Time of the reading [s].
            measured: Measured state, coordinates first.
        """
        if self._window > 0.0:
            self._readings.append((time, measured[: self._n_q].copy()))
            self._drop_before(time - self._window)

    def clear(self) -> None:
        """Drop all readings."""
        self._readings.clear()

    def fits(self, time: float) -> bool:
        """Return True if more readings are kept than a parabola has coefficients, or none is used.

        Args:
            time: End of the window [s].
        """
        self._drop_before(time - self._window)
        return not self._window or len(self._readings) > _PARABOLA

    def estimate(self, time: float, measured: Vector) -> Vector:
        """Return the state at a time. With too few readings it is the last measured one.

        Args:
            time: Time of the estimate [s].
            measured: The last measured state, ``(n_x,)``.
        """
        if not self._window or not self.fits(time):
            return measured
        n_q, window = self._n_q, self._window
        ago = np.array([one - time for one, _ in self._readings]) / window
        q = np.array([one for _, one in self._readings])
        fitted = np.linalg.lstsq(np.vander(ago, _PARABOLA, increasing=True), q, rcond=None)[0]
        known = measured.copy()
        known[:n_q], known[n_q : 2 * n_q] = fitted[0], fitted[1] / window
        return known

    def _drop_before(self, time: float) -> None:
        while self._readings and self._readings[0][0] < time:
            self._readings.popleft()


_PARABOLA = 3
"""Coefficients of a parabola."""


class BridgeLeg(Enum):
    """Which transistors of the switching leg are on."""

    HIGH = "high"
    LOW = "low"
    NONE = "none"


def pulse(bridge: HBridge, share: float) -> tuple[tuple[float, BridgeLeg], ...]:
    """Return the switching times and states of the leg, with times since the start of the period.

    Every edge that turns a transistor on waits for the dead time.

    Args:
        bridge: Parameters of the bridge.
        share: Duty cycle, the part of the period with voltage applied, in [0, 1].
    """
    period, dead = 1.0 / bridge.frequency, bridge.dead_time
    on = share * period
    if share <= 0.0:
        return ((0.0, BridgeLeg.LOW),)
    if share >= 1.0:
        return ((0.0, BridgeLeg.HIGH),)
    edges: list[tuple[float, BridgeLeg]] = []
    if dead > 0.0:
        edges.append((0.0, BridgeLeg.NONE))
    if on > dead:
        edges.append((dead, BridgeLeg.HIGH))
    if dead > 0.0 and on > dead:
        edges.append((on, BridgeLeg.NONE))
    if on + dead < period:
        edges.append((on + dead, BridgeLeg.LOW))
    return tuple(edges)


def level(bridge: HBridge, leg: BridgeLeg, sign: float, current: float) -> float:
    """Return the voltage over a motor and its transistors while a leg is in a state [V].

    Args:
        bridge: Parameters of the bridge.
        leg: State of the switching leg. The other leg stays low.
        sign: Sign of the commanded voltage.
        current: Current of the motor, which flows through a diode while both transistors are off
            [A].
    """
    if leg is BridgeLeg.HIGH:
        return sign * bridge.supply
    if leg is BridgeLeg.LOW:
        return 0.0
    along = sign * current
    if along > 0.0:
        return -sign * bridge.diode_drop
    if along < 0.0:
        return sign * (bridge.supply + bridge.diode_drop)
    return 0.0
