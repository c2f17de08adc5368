r"""Machines whose electrical energy and peaks have closed forms.

The hopper of `problems/hopper.py` with a coil: the voltage is `U` while it pushes, and ``W - U``
otherwise. The push has the acceleration ``a = c U``. The coil has ``L i' = V - R i`` and no effect
on the mass. With the impact speed ``v^2 = 2 a s / (1 - e^2)`` and the speed
``w^2 = e^2 v^2 + 2 (a - g) s`` at `s` the push lasts ``(w - e v) / (a - g)`` and the rest of the
period ``(w + v) / g``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

import zeno_orbits as zo

C, S, E, G, R, L, W = 2.0, 0.1, 0.5, 9.81, 3.0, 0.1, 16.0
"""Values of the parameters, in SI units."""


def _model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    height, speed, current = (ca.SX.sym(name) for name in ("height", "speed", "current"))
    pushes = ca.logic_and(speed > 0, height < p["s"])
    mass = zo.HybridLagrangian.from_energies(
        q=height,
        v=speed,
        kinetic=speed**2 / 2,
        potential=p["g"] * height,
        gap=height,
        applied_force=ca.if_else(pushes, C * p["U"], 0),
    )
    voltage = ca.if_else(pushes, p["U"], W - p["U"])
    coil = zo.Auxiliary(
        states=current,
        rate=(voltage - p["R"] * current) / p["L"],
        input_power=voltage * current,
        loss=p["R"] * current**2,
        stored_energy=p["L"] * current**2 / 2,
    )
    return zo.hybrid_system(mass, coil, p["restitution"], switches=())


COIL_HOPPER = zo.Problem(
    name="coil_hopper",
    title="hopping mass with a coil that is on while it pushes",
    source="tests/support/coil_hopper.py",
    state_names=("height", "speed", "current"),
    state_units=("m", "m/s", "A"),
    parameters=(
        zo.Quantity.positive("s", S, "m", "height below which it pushes"),
        zo.Quantity.positive("R", R, "ohm", "resistance of the coil"),
        zo.Quantity.positive("L", L, "H", "inductance of the coil"),
        zo.Quantity.restitution(E),
        zo.Quantity.positive("g", G, "m/s^2", "gravity"),
    ),
    gains=(
        zo.Quantity(name="U", unit="V", meaning="voltage", default=10.0, lower=6.0, upper=25.0),
    ),
    model=_model,
    starts=({"height": 0.0, "speed": 1.0},),
    portraits=(("height", "speed"),),
    amplitude_of="height",
)


@dataclass(frozen=True, kw_only=True)
class CoilHop:
    """The orbit of the hopper with a coil, in closed form.

    Attributes:
        voltage: The voltage `U` [V].
        s: Height below which it pushes [m].
        resistance: Resistance of the coil [ohm].
    """

    voltage: float
    s: float = S
    resistance: float = R

    @property
    def _speeds(self) -> tuple[float, float]:
        push = C * self.voltage
        strikes = math.sqrt(2 * push * self.s / (1 - E**2))
        return strikes, math.sqrt((E * strikes) ** 2 + 2 * (push - G) * self.s)

    @property
    def _times(self) -> tuple[float, float]:
        strikes, leaves = self._speeds
        return (leaves - E * strikes) / (C * self.voltage - G), (leaves + strikes) / G

    @property
    def period(self) -> float:
        """The period [s]."""
        return sum(self._times)

    @property
    def highest(self) -> float:
        """The largest height [m]."""
        return self.s + self._speeds[1] ** 2 / (2 * G)

    @property
    def impact_speed(self) -> float:
        """The speed of the impact, the largest of all [m/s]."""
        return self._speeds[0]

    @property
    def currents(self) -> tuple[float, float]:
        """The currents at the start and at the end of the push, the extremes [A]."""
        pushing, other = self.voltage / self.resistance, (W - self.voltage) / self.resistance
        on, off = (math.exp(-self.resistance * time / L) for time in self._times)
        end = (pushing * (1 - on) + on * other * (1 - off)) / (1 - on * off)
        return other + (end - other) * off, end

    @property
    def energy(self) -> float:
        """The work of the source and of the push in a period [J]."""
        begin, end = self.currents
        total = C * self.voltage * self.s
        phases = ((self.voltage, begin), (W - self.voltage, end))
        for (voltage, first), time in zip(phases, self._times, strict=True):
            steady = voltage / self.resistance
            lag = L / self.resistance * (1 - math.exp(-self.resistance * time / L))
            total += voltage * (steady * time + (first - steady) * lag)
        return total


def wave_coil(harmonics: Sequence[int]) -> zo.Problem:
    r"""Return a mass at rest off its stop, and a coil with a prescribed current.

    The voltage gives :math:`i = \sin\varphi + \sum_k g_k \sin k\varphi`, and the gains are
    :math:`g_k`.

    Args:
        harmonics: The numbers `k`, odd.
    """

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        place, speed, current = (ca.SX.sym(name) for name in ("place", "speed", "current"))
        omega = 2 * math.pi
        clock = zo.Clock.at(omega)
        amplitudes = {1: ca.SX(1.0), **{k: p[f"g{k}"] for k in harmonics}}
        waves = [
            (amplitudes[k] * k * omega * L, amplitudes[k] * R) if k in amplitudes else (0.0, 0.0)
            for k in range(1, max(amplitudes) + 1)
        ]
        voltage = zo.harmonics(clock, waves)
        damping = ca.if_else(clock.sine > 0, 4, 5)
        mass = zo.HybridLagrangian.from_energies(
            q=place,
            v=speed,
            kinetic=speed**2 / 2,
            potential=20 * place**2,
            gap=1 + place,
            # A period needs an event: the damping changes with the sign of the sine.
            applied_force=-damping * speed,
            clock=clock,
        )
        coil = zo.Auxiliary(
            states=current,
            rate=(voltage - R * current) / L,
            input_power=voltage * current,
            loss=R * current**2,
            stored_energy=L * current**2 / 2,
        )
        return zo.hybrid_system(mass, coil, p["restitution"], switches=())

    return zo.Problem(
        name="wave_coil",
        title="coil with a prescribed current, beside a mass at rest",
        source="tests/support/coil_hopper.py",
        state_names=("place", "speed", "current", "cosine", "sine"),
        state_units=("m", "m/s", "A", "1", "1"),
        parameters=(zo.Quantity.restitution(E),),
        gains=tuple(
            zo.Quantity(
                name=f"g{k}", unit="A", meaning="amplitude", default=0.0, lower=-0.5, upper=0.5
            )
            for k in harmonics
        ),
        model=model,
        starts=({"cosine": 1.0},),
        portraits=(("place", "speed"),),
        amplitude_of="current",
    )
