"""The relay under other voltages: pulses whose lengths are gains, and harmonics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate

import casadi as ca

import zeno_orbits as zo

RELAY = zo.load_problem("relay")
UNCERTAIN = {"ks": (52.25, 57.75), "R": (47.5, 52.5)}
"""Changes of 5 % of spring and resistance."""

Voltage = Callable[[zo.Clock, Mapping[str, ca.SX]], ca.SX]


def driven_relay(voltage: Voltage, gains: Sequence[zo.Quantity]) -> zo.Problem:
    """Return the relay under a voltage.

    Args:
        voltage: Function of the clock, and of gains and parameters [V].
        gains: Gains of the voltage.
    """

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        armature, flux = RELAY.model(p).mechanism, ca.SX.sym("flux")
        opening, clock = armature.q, armature.clock
        assert clock is not None
        saturation = 1 - (flux / p["phi_s"]) ** 2
        current = flux * (p["S0"] / saturation + p["S1"] * opening) / p["N"]
        iron = -p["S0"] * p["phi_s"] ** 2 / 2 * ca.log(saturation)
        applied = voltage(clock, p)
        coil = zo.Auxiliary(
            states=flux,
            rate=(applied - p["R"] * current) / p["N"],
            force=-p["S1"] * flux**2 / 2,
            input_power=applied * current,
            loss=p["R"] * current**2,
            stored_energy=iron + p["S1"] * opening * flux**2 / 2,
        )
        return zo.hybrid_system(armature, coil)

    return replace(RELAY, name="driven_relay", model=model, gains=tuple(gains))


def pulsed_relay(lengths: Sequence[float]) -> zo.Problem:
    """Return the relay whose voltage is on and off in turn, then on until half the period.

    The gains `d1`, `d2` and so on are the lengths of the levels, so their order cannot change.

    Args:
        lengths: Defaults of an even number of lengths [s].
    """
    names = [f"d{k}" for k in range(1, len(lengths) + 1)]

    def voltage(clock: zo.Clock, p: Mapping[str, ca.SX]) -> ca.SX:
        times = [*accumulate(p[name] for name in names), clock.period / 2]
        return zo.piecewise(clock, [p["U"], 0] * (len(times) // 2 + 1), times)

    gains = [
        zo.Quantity(
            name=name, unit="s", meaning="length of a level", default=one, lower=1e-4, upper=2e-3
        )
        for name, one in zip(names, lengths, strict=True)
    ]
    return driven_relay(voltage, gains)


def switching_times(problem: zo.Problem, gains: Mapping[str, float]) -> list[float]:
    """Return the switching times of a pulsed relay before half the period [s]."""
    return list(accumulate(gains[gain.name] for gain in problem.gains))
