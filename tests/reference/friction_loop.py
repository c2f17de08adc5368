r"""Linear machines with one stop, a motor and dry friction, followed by another event loop.

.. math:: M \dot v = f_0 - K q - C v + k s i + a \lambda + \sum_j r_j f_j,\qquad
    L \dot i = U - R i - k s^\top v

Within a mode the machine is linear, so matrix exponentials give its states. At every event all
combinations of contact and friction are tried, and the one that fulfils the laws is taken. Impacts
below the speed `SLOWEST` close the stop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import brentq

Array = NDArray[np.float64]
SLOWEST = 1e-6
"""Speed after an impact from which on the stop is closed."""
_ZERO = 1e-10
"""Rates and gaps below this value are zero at an event."""
_RISES = 1e-3
"""Time after a release within which no impact is looked for [s]."""
_FIRST, _GROW, _LONGEST = 1e-11, 1.3, 2e-3
"""First step of the search for an event, its growth, and its longest step [s]."""


@dataclass(frozen=True, kw_only=True)
class LinearMachine:
    """A linear machine with one stop ``a . q >= 0``.

    Attributes:
        mass: :math:`M`, ``(n, n)``.
        stiffness: :math:`K`, ``(n, n)``.
        damping: :math:`C`, ``(n, n)``.
        load: :math:`f_0`, ``(n,)``.
        normal: :math:`a`, ``(n,)``.
        restitution: Coefficient of restitution.
        motor: :math:`s`, ``(n,)``.
        circuit: ``(k, L, R, U)``.
        rows: :math:`r_j`, ``(m, n)``.
        belts: Speeds of the moving surfaces, ``(m,)``.
        torques: Friction while a part slips, ``(m,)``.
        statics: Largest friction while it sticks, ``(m,)``.
    """

    mass: Array
    stiffness: Array
    damping: Array
    load: Array
    normal: Array
    restitution: float
    motor: Array
    circuit: tuple[float, float, float, float]
    rows: Array
    belts: Array
    torques: Array
    statics: Array

    @classmethod
    def random(cls, seed: int) -> LinearMachine:
        """Return a machine with random numbers, and one or two parts with friction."""
        random = np.random.default_rng(seed)
        m = int(random.integers(1, 3))
        # The stop leaves every part free.
        n = m + 1
        root = random.normal(size=(n, n))
        springs = random.normal(size=(n, n))
        torques = random.uniform(0.2, 1.5, m)
        rows = np.eye(n)[:m] + 0.3 * random.normal(size=(m, n))
        return cls(
            mass=root @ root.T + 0.5 * np.eye(n),
            stiffness=4.0 * springs @ springs.T + 2.0 * np.eye(n),
            damping=random.uniform(0.0, 0.2) * np.eye(n),
            load=2.0 * random.normal(size=n),
            normal=np.append(random.uniform(-0.5, 0.5, m), 1.0),
            restitution=float(random.uniform(0.1, 0.6)),
            motor=np.eye(n)[0],
            circuit=(0.3, 0.5, 1.0, float(random.normal())),
            rows=rows,
            belts=random.choice([0.0, 0.4, -0.3], m),
            torques=torques,
            statics=torques * random.uniform(1.0, 1.6, m),
        )

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.load)

    def system(self, closed: bool, sides: tuple[int, ...]) -> tuple[Array, Array]:
        """Return the rate ``A y`` of ``y = (q, v, i, 1)`` in a mode, and its forces ``F y``.

        The forces are that of the stop, then those of the parts.
        """
        n, m = self.n, len(self.rows)
        k, inductance, resistance, voltage = self.circuit
        inverse = np.linalg.inv(self.mass)
        free = np.zeros((n, 2 * n + 2))
        free[:, :n], free[:, n : 2 * n] = -self.stiffness, -self.damping
        free[:, 2 * n], free[:, -1] = k * self.motor, self.load
        for row, torque, side in zip(self.rows, self.torques, sides, strict=True):
            free[:, -1] -= row * torque * side
        held = ([self.normal] if closed else []) + [
            row for row, side in zip(self.rows, sides, strict=True) if side == 0
        ]
        forces = np.zeros((1 + m, 2 * n + 2))
        acceleration = inverse @ free
        if held:
            rows = np.array(held)
            found = -np.linalg.solve(rows @ inverse @ rows.T, rows @ acceleration)
            acceleration = acceleration + inverse @ rows.T @ found
            places = ([0] if closed else []) + [1 + j for j in range(m) if sides[j] == 0]
            forces[places] = found
        rate = np.zeros((2 * n + 2, 2 * n + 2))
        rate[:n, n : 2 * n], rate[n : 2 * n] = np.eye(n), acceleration
        rate[2 * n, n : 2 * n] = -k * self.motor / inductance
        rate[2 * n, 2 * n], rate[2 * n, -1] = -resistance / inductance, voltage / inductance
        return rate, forces

    def events(self, y: Array, until: float) -> Iterator[tuple[float, str]]:
        """Yield the events of a motion from a state without contact."""
        n, time, closed, was_released = self.n, 0.0, False, False
        sides, _ = self._mode(y, (), closed=False)
        while True:
            guards = self._guards(closed, sides)
            rate, _ = self.system(closed, sides)
            # The gap grows with the third power of time, from below its rounding.
            late = _RISES if was_released else 0.0
            found = _first(rate, y, guards, until - time, late)
            if found is None:
                return
            step, name = found
            y, time, was_released = expm(step * rate) @ y, time + step, False
            before, was_closed = sides, closed
            if name == "impact":
                v = y[n : 2 * n]
                response = np.linalg.solve(self.mass, self.normal)
                speed = self.normal @ v
                e = self.restitution if -speed * self.restitution > SLOWEST else 0.0
                y[n : 2 * n] = v - (1 + e) * speed / (self.normal @ response) * response
                yield time, "impact"
                if e == 0.0:
                    yield time, "zeno"
                closed = e == 0.0
            kept = tuple(
                side if name != f"rate {j}" and name != f"force {j}" else None
                for j, side in enumerate(sides)
            )
            sides, closed = self._mode(y, kept, closed=closed and name != "release")
            yield from ((time, one) for one in _changes(before, sides))
            was_released = was_closed and not closed
            if was_released:
                yield time, "release"

    def _guards(self, closed: bool, sides: tuple[int, ...]) -> dict[str, Callable[[Array], float]]:
        """Return formulas that fall through zero at the events of a mode, by name."""
        n = self.n
        _, forces = self.system(closed, sides)
        found: dict[str, Callable[[Array], float]] = {}
        if closed:
            found["release"] = lambda y: float(forces[0] @ y)
        else:
            found["impact"] = lambda y: float(self.normal @ y[:n])
        for j, side in enumerate(sides):
            if side:
                found[f"rate {j}"] = lambda y, j=j, s=side: s * self._rate(j, y)
            else:
                found[f"force {j}"] = lambda y, j=j: float(self.statics[j] - abs(forces[1 + j] @ y))
        return found

    def _rate(self, j: int, y: Array) -> float:
        return float(self.rows[j] @ y[self.n : 2 * self.n] - self.belts[j])

    def _mode(
        self, y: Array, kept: tuple[int | None, ...], *, closed: bool
    ) -> tuple[tuple[int, ...], bool]:
        """Return sides and contact just after an event, which fulfil the laws.

        With a static friction above the other several may. The sides that the event does not
        concern then stay if they can.

        Args:
            y: The state.
            kept: The sides before the event, ``None`` for that of its part.
            closed: Whether the stop was closed.
        """
        n, m = self.n, len(self.rows)
        rates = [self._rate(j, y) for j in range(m)]
        ways = [(0, 1, -1) if abs(one) < _ZERO else (int(np.sign(one)),) for one in rates]
        found: list[tuple[tuple[int, ...], bool]] = []
        for sides, shut in product(product(*ways), (True, False) if closed else (False,)):
            rate, forces = self.system(shut, sides)
            fits = self._fits(y, rate, forces, rates, sides)
            if shut:
                fits = fits and forces[0] @ y > 0.0
            elif closed:
                fits = fits and self.normal @ (rate @ y)[n : 2 * n] >= -_ZERO
            if fits:
                found.append((sides, shut))
        assert found

        def changes(one: tuple[tuple[int, ...], bool]) -> int:
            return sum(k is not None and k != s for k, s in zip(kept, one[0], strict=bool(kept)))

        return min(found, key=changes)

    def _fits(
        self, y: Array, rate: Array, forces: Array, rates: list[float], sides: tuple[int, ...]
    ) -> bool:
        """Return True if every part obeys its law: stuck, or moving to its side."""
        acceleration = (rate @ y)[self.n : 2 * self.n]
        jerk = (rate @ rate @ y)[self.n : 2 * self.n]
        for j, side in enumerate(sides):
            if side == 0:
                # At the border the force decides by its rate.
                force, change = forces[1 + j] @ y, forces[1 + j] @ rate @ y
                over = abs(force) - self.statics[j]
                if over > _ZERO or (abs(over) <= _ZERO and np.sign(force) * change > 0.0):
                    return False
            elif abs(rates[j]) < _ZERO:
                moves = side * float(self.rows[j] @ acceleration)
                if moves < -_ZERO or (abs(moves) <= _ZERO and side * self.rows[j] @ jerk <= 0.0):
                    return False
        return True


def _changes(before: tuple[int, ...], after: tuple[int, ...]) -> Iterator[str]:
    for j, (one, other) in enumerate(zip(before, after, strict=True)):
        if one != other:
            word = "stick" if other == 0 else "slip" if one == 0 else "turn"
            yield f"{word} f{j}" + ("" if other == 0 else " up" if other > 0 else " down")


def _first(
    rate: Array, y: Array, guards: dict[str, Callable[[Array], float]], left: float, late: float
) -> tuple[float, str] | None:
    """Return the first zero of a guard that is positive before, and its name.

    Args:
        rate: Rate of the mode.
        y: The state.
        guards: Formulas that fall through zero, by name.
        left: Time that is left [s].
        late: Time before which no impact counts [s].
    """
    time, step, state = 0.0, _FIRST, y
    known = {name: guard(y) for name, guard in guards.items()}
    is_first = True
    grid = expm(_LONGEST * rate)
    while time < left:
        step = min(step, left - time + 1e-9)
        then = (grid if step == _LONGEST else expm(step * rate)) @ state
        now = {name: guard(then) for name, guard in guards.items()}
        fallen = [
            name
            for name in guards
            if now[name] < 0.0
            and known[name] > 0.0
            and not is_first
            and (name != "impact" or time >= late)
        ]
        if fallen:
            times = {name: _zero(guards[name], rate, state, step) for name in fallen}
            name = min(times, key=lambda one: times[one])
            return time + times[name], name
        time, state, known, is_first = time + step, then, now, False
        step = min(step * _GROW, _LONGEST)
    return None


def _zero(guard: Callable[[Array], float], rate: Array, y: Array, step: float) -> float:
    """Return when a guard is zero within a step [s]."""
    return float(brentq(lambda s: guard(expm(s * rate) @ y), 0.0, step, xtol=1e-15))
