"""Impacts of the bundled problems in closed form, in 60 digits; `README.md` derives them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import mpmath
from mpmath import mp, mpf

DIGITS = 60
ROUNDING = mpf(10) ** -20
"""Part of a flight's duration to which its end is found; Newton's last step is far finer."""
MOST_STEPS = 50
END = mpf(10) ** -15
"""Part of the first speed at which a sequence is at its end; what follows is summed."""

Numbers = Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sequence:
    """Impacts that accumulate.

    Attributes:
        times: Of every impact, from the start [s].
        speeds: Gap rate before each of them, positive towards the stop.
        zeno_time: Where they accumulate [s].
    """

    times: list[Any]
    speeds: list[Any]
    zeno_time: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """Motions off a stop in closed form.

    Attributes:
        after: ``(time, state, s) -> state`` a time ``s`` later.
        gap: Gap of a state.
        rate: Gap rate of a state.
        acceleration: Gap acceleration of a time and a state.
        reset: State before an impact to the one after it.
        step: Length at which a long flight is scanned for its end [s].
    """

    after: Callable[[Any, Any, Any], Any]
    gap: Callable[[Any, Any], Any]
    rate: Callable[[Any, Any], Any]
    acceleration: Callable[[Any, Any], Any]
    reset: Callable[[Any, Any], Any]
    step: float

    def sequence(self, time: Any, state: Any, restitution: Any) -> Sequence:
        """Return all impacts of a motion that leaves the stop, or falls on it, at a time."""
        times, speeds = [], []
        start, length = time, self._long(time, state)
        while True:
            time, state = time + length, self.after(time, state, length)
            times.append(time - start)
            speeds.append(-self.rate(time, state))
            state = self.reset(time, state)
            bounce, pull = self.rate(time, state), -self.acceleration(time, state)
            tail = 2 * bounce / pull
            if speeds[-1] < END * speeds[0]:
                return Sequence(
                    times=times,
                    speeds=speeds,
                    zeno_time=time + tail / (1 - restitution) - start,
                )
            is_short = 0 < tail < 10 * self.step
            length = self._root(time, state, tail) if is_short else self._long(time, state)

    def _long(self, time: Any, state: Any) -> Any:
        right = mpf(self.step)
        while self.gap(time + right, self.after(time, state, right)) > 0:
            right += self.step
        return self._root(time, state, right)

    def _root(self, time: Any, state: Any, s: Any) -> Any:
        """Return where the mean gap rate ``gap / s`` of a flight vanishes, by Newton's method.

        The start of the flight is no root of it. From behind the root, or near it, it converges.
        """
        for _ in range(MOST_STEPS):
            later = self.after(time, state, s)
            mean = self.gap(time + s, later) / s
            change = mean * s / (self.rate(time + s, later) - mean)
            s -= change
            if abs(change) < ROUNDING * s:
                return s
        raise ArithmeticError("Newton's method for the end of a flight does not converge.")


def vibrating_table(p: Numbers) -> Sequence:
    """Return the impacts after the take-off of the ball or marble on its table."""
    with mp.workdps(DIGITS):
        g, a, w, e = (mpf(p[name]) for name in ("g", "A", "omega", "restitution"))
        # The marble's restitution falls with the speed.
        fall = mpf(p.get("fall", 0))

        def after(t: Any, x: Any, s: Any) -> Any:
            ahead, here = w * (t + s), w * t
            moved = mp.sin(ahead) - mp.sin(here) - w * s * mp.cos(here)
            turned = mp.cos(ahead) - mp.cos(here)
            return x[0] + x[1] * s - g * s**2 / 2 - a * moved, x[1] - g * s - a * w * turned

        flight = Flight(
            after=after,
            gap=lambda _, x: x[0],
            rate=lambda _, x: x[1],
            acceleration=lambda t, _: a * w**2 * mp.sin(w * t) - g,
            reset=lambda _, x: (mpf(0), -(e + fall * x[1]) * x[1]),
            step=float(0.02 / w),
        )
        return flight.sequence(mp.asin(g / (a * w**2)) / w, (mpf(0), mpf(0)), e)


def falling_pendulum(p: Numbers, angle: float) -> Sequence:
    """Return the impacts of the pendulum that falls at rest from an angle off its stop."""
    with mp.workdps(DIGITS):
        g, m, lc, inertia, e = (mpf(p[name]) for name in ("g", "m", "lc", "I", "restitution"))
        square = m * g * lc / (inertia + m * lc**2)
        stop = mpf(p["stop"])
        high = mpf(angle) + stop
        pull = square * mp.sin(stop)

        def fall(top: Any) -> Any:
            k = mp.sin(top / 2)
            phase = mp.asin(mp.sin(stop / 2) / k)
            return (mp.ellipk(k**2) - mp.ellipf(phase, k**2)) / mp.sqrt(square)

        time = fall(high)
        speed = mp.sqrt(2 * square * (mp.cos(stop) - mp.cos(high)))
        times, speeds = [time], [speed]
        while speeds[-1] > END * speeds[0]:
            speed = e * speeds[-1]
            top = mp.acos(mp.cos(stop) - speed**2 / (2 * square))
            time += 2 * fall(top)
            times.append(time)
            speeds.append(speed)
        zeno = time + 2 * e * speeds[-1] / (pull * (1 - e))
        return Sequence(times=times, speeds=speeds, zeno_time=zeno)


def bowl(p: Numbers, x: float, y: float, dx: float) -> Sequence:
    """Return the impacts of a ball thrown over a bowl at rest, in no air."""
    with mp.workdps(DIGITS):
        g, rho, e = (mpf(p[name]) for name in ("g", "rho", "restitution"))

        def after(_: Any, z: Any, s: Any) -> Any:
            return z[0] + z[2] * s, z[1] + z[3] * s - g * s**2 / 2, z[2], z[3] - g * s

        def reset(_: Any, z: Any) -> Any:
            slope = z[0] / rho
            push = (1 + e) * (z[3] - slope * z[2]) / (1 + slope**2)
            return z[0], z[0] ** 2 / (2 * rho), z[2] + push * slope, z[3] - push

        flight = Flight(
            after=after,
            gap=lambda _, z: z[1] - z[0] ** 2 / (2 * rho),
            rate=lambda _, z: z[3] - z[0] * z[2] / rho,
            acceleration=lambda _, z: -g - z[2] ** 2 / rho,
            reset=reset,
            step=1e-3,
        )
        return flight.sequence(mpf(0), (mpf(x), mpf(y), mpf(dx), mpf(0)), e)


def valve(p: Numbers, gains: Numbers) -> tuple[Sequence, Any]:
    """Return the impacts of the valve after it leaves its seat, and the period."""
    with mp.workdps(DIGITS):
        names = ("J", "k", "preload", "c", "R", "L", "K_torque", "K_emf", "V0", "restitution")
        j, k, preload, c, r, coil, torque, emf, v0, e = (mpf(p[name]) for name in names)
        kp, kd = mpf(gains["Kp"]), mpf(gains["Kd"])
        # The last row and column carry the constant terms.
        flow = mpmath.matrix(
            [
                [0, 1, 0, 0],
                [-k / j, -c / j, torque / j, -preload / j],
                [-kp / coil, -(kd + emf) / coil, -r / coil, v0 / coil],
                [0, 0, 0, 0],
            ]
        )
        roots, left, right = mp.eig(flow, left=True, right=True)
        parts = [right[:, n] * left[n, :] / (left[n, :] * right[:, n])[0] for n in range(flow.rows)]

        def after(_: Any, x: Any, s: Any) -> Any:
            moved = sum(
                (mp.exp(root * s) * (part * x) for root, part in zip(roots, parts, strict=True)),
                mpmath.matrix(4, 1),
            )
            return moved.apply(mp.re)

        def reset(_: Any, x: Any) -> Any:
            return mpmath.matrix([0, -e * x[1], x[2], 1])

        flight = Flight(
            after=after,
            gap=lambda _, x: x[0],
            rate=lambda _, x: x[1],
            acceleration=lambda _, x: (torque * x[2] - preload - c * x[1]) / j,
            reset=reset,
            step=2e-3,
        )
        release = preload / torque
        start = mpmath.matrix([0, 0, release, 1])
        sequence = flight.sequence(mpf(0), start, e)
        current = _current_at_rest(flight, start, sequence)
        locked = coil / r * mp.log((v0 / r - current) / (v0 / r - release))
        return sequence, sequence.zeno_time + locked


def _current_at_rest(flight: Flight, state: Any, sequence: Sequence) -> Any:
    """Return the current after all impacts; it is continuous."""
    time = mpf(0)
    for end in sequence.times:
        state = flight.reset(end, flight.after(time, state, end - time))
        time = end
    return flight.after(time, state, sequence.zeno_time - time)[2]
