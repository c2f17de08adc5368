"""What a controller reads: coordinates rounded by encoders, rates from their differences."""

from __future__ import annotations

import math

import numpy as np

from zeno_orbits.dynamics import Vector
from zeno_orbits.imperfections import Controller, Sensors


class Reader:
    r"""Turns true states into measured ones, reading by reading (theory (52)).

    .. math:: q_k = r\,\mathrm{round}\!\left(\frac{q(t_k) + \nu_k}{r}\right),\qquad
        v_k = a\,v_{k-1} + (1 - a)\,\frac{q_k - q_{k-1}}{T_s},\qquad a = e^{-T_s/\tau}

    Args:
        sensors: What it reads with; ``None`` for the states themselves.
        controller: How often.
        n_q: Number of coordinates.
        random: Where the noise comes from.
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
        """Return what is known of a state, ``(n_x,)``; the next reading is a period later."""
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
            # The first reading has no difference yet; a machine would have run before.
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
