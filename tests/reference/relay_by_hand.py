"""The relay under any voltage that is on and off in turn, by the event loop in NumPy and SciPy.

Nothing is shared with the package. Units are mm and ms, and the flux is in 1e-5 Wb.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.reference.event_loop import Contact, Event, Machine, simulated

T, M, D, E = 40.0, 1.6e-3, 0.9, 0.3
"""Period [ms], mass [kg], opening at the open stop [mm], restitution."""


def relay_by_hand(
    ks: float,
    resistance: float,
    times: Sequence[float],
    supply: float = 24.0,
    period: float = T,
) -> Machine:
    """Return the relay, whose voltage is on and changes at times and at half the period.

    Args:
        ks: Stiffness of the spring [N/m].
        resistance: Resistance of the coil [ohm].
        times: An even number of switching times [ms].
        supply: Voltage that is applied [V].
        period: Period [ms].
    """

    def voltage(branches: tuple[bool, ...]) -> float:
        return 0.0 if sum(branches) % 2 else supply

    def current(z: float, flux: float) -> float:
        flux = 1e-5 * flux
        return flux * (6e6 / (1 - (flux / 3.6e-5) ** 2) + 2.2e10 * 1e-3 * z) / 1200

    def force(_t: float, q: Any, v: Any, x: Any, _branches: Any) -> np.ndarray:
        newton = ks * (0.0159 - 1e-3 * q[0]) - 0.05 * v[0] - 2.2e10 * (1e-5 * x[0]) ** 2 / 2
        return np.array([1e-3 * newton / M])

    def rate(_t: float, q: Any, _v: Any, x: Any, branches: tuple[bool, ...]) -> np.ndarray:
        weber = (voltage(branches) - resistance * current(q[0], x[0])) / 1200
        return np.array([1e-3 * weber / 1e-5])

    return Machine(
        n=1,
        mass=lambda _: np.eye(1),
        force=force,
        rate=rate,
        contacts=(
            Contact(name="closed", gap=lambda q: q[0], normal=lambda _: np.ones(1), restitution=E),
            Contact(
                name="open", gap=lambda q: D - q[0], normal=lambda _: -np.ones(1), restitution=E
            ),
        ),
        kinks=tuple(lambda t, _q, _v, _x, at=at: t - at for at in (*times, period / 2)),
    )


def period_by_hand(machine: Machine, period: float = T) -> list[Event]:
    """Return the events of a period that begins as the voltage is applied, at rest when open."""
    before = simulated(machine, [D, 0.0, 0.0], period, closed=("open",))
    run = simulated(machine, [D, 0.0, float(before.end_state[2])], period, closed=("open",))
    assert run.refused is None
    assert run.unsure is None
    return run.events


def lost_by_hand(events: Sequence[Event], stop: str) -> float:
    """Return the energy lost at a stop, with the geometric tail of each sequence of impacts [J]."""
    lost, last = 0.0, 0.0
    for event in events:
        if (event.kind, event.name) == ("impact", stop):
            last = event.rate
            lost += M / 2 * (1 - E**2) * last**2
        elif (event.kind, event.name) == ("zeno", stop):
            lost += M / 2 * E**2 * last**2
    return lost
