"""Whether the two-sided oscillator has contact phases, by exact flights.

``x'' + c x' + x = A cos(omega t)``, ``|x| <= 1``. At the upper stop the mass is released where the
force falls to ``A cos(omega t) = 1``, always in the same state, so a half period has no memory. It
flies to the lower stop, where it is released half a turn later. Its impacts accumulate before
that release, or the release comes first. All flights have 40 digits. Nothing here is shared with
the package.
"""

from __future__ import annotations

from typing import Any

import mpmath

mp: Any = mpmath

_MOST_IMPACTS = 400
_SURE = 0.2
"""Part of the time left within which impacts surely accumulate before the release."""
_STEPS = 8
"""Steps over a flight in which its end is looked for."""


def accumulates(amplitude: float, omega: float, damping: float, restitution: float) -> bool:
    """Return True if the impacts on the lower stop accumulate before the release.

    Args:
        amplitude: ``A``.
        omega: Frequency of the force.
        damping: ``c``.
        restitution: ``e``.
    """
    with mp.workdps(40):
        return _accumulates(*(mp.mpf(repr(x)) for x in (amplitude, omega, damping, restitution)))


def _accumulates(force: Any, w: Any, c: Any, restitution: Any) -> bool:
    """Return True if the impacts accumulate before the release, for exact numbers."""
    gain = force / mp.mpc(1 - w**2, c * w)
    decay, turn = c / 2, mp.sqrt(1 - c**2 / 4)

    def forced(t: Any) -> tuple[Any, Any]:
        phasor = gain * mp.expj(w * t)
        return phasor.real, (1j * w * phasor).real

    def flight(start: Any, place: Any, speed: Any) -> Any:
        x0, v0 = forced(start)
        x, v = place - x0, speed - v0

        def at(t: Any) -> tuple[Any, Any]:
            fade, angle = mp.exp(-decay * (t - start)), turn * (t - start)
            cos, sin = mp.cos(angle), mp.sin(angle) / turn
            there, rate = forced(t)
            return (
                there + fade * (cos * x + sin * (v + decay * x)),
                rate + fade * (cos * v - sin * (x + decay * v)),
            )

        return at

    release = mp.acos(1 / force) / w + mp.pi / w
    time, at = mp.acos(1 / force) / w, flight(mp.acos(1 / force) / w, mp.mpf(1), mp.mpf(0))
    # The first impact: the lower stop is reached in steps, then by bisection.
    step = mp.mpf(1) / 50
    while at(time)[0] > -1:
        time += step
    time = _root(at, time)
    for _ in range(_MOST_IMPACTS):
        speed = -restitution * at(time)[1]
        lift = force * mp.cos(w * time) + 1 - c * speed
        if lift >= 0 or time >= release:
            return False
        # With a constant acceleration the impacts would last so long.
        if -2 * speed / lift / (1 - restitution) < _SURE * (release - time):
            return True
        start, at = time, flight(time, mp.mpf(-1), speed)
        # Where the flight grazes, it lasts twice as long as with a constant acceleration.
        step = -2 * speed / lift / _STEPS
        ahead = [start + k * step for k in range(1, 4 * _STEPS)]
        landed = next((t for t in ahead if at(t)[0] < -1), None)
        if landed is None:
            return False
        time = _root(at, landed)
    raise AssertionError("The impacts neither accumulate nor escape.")


def _root(at: Any, beyond: Any) -> Any:
    """Return the time at which a flight reaches the lower stop, by Newton's method from beyond."""
    time, size = beyond, mp.inf
    while True:
        place, rate = at(time)
        change = (place + 1) / rate
        if abs(change) >= size:
            return time
        time, size = time - change, abs(change)
