r"""Dry friction of a machine: which parts slip, and which stick.

Contacts are forces here, so the parts that stick are the only rows. Let :math:`G = R W R^\top` be
their Delassus matrix, and :math:`b` the accelerations of their rates without dry friction:

.. math:: \dot r = b + G f,\qquad f_j = -T_j s_j \text{ or } \dot r_j = 0,\ |f_j| \le T_{0,j}

At an event all sides of the parts at rest are tried, and sides that fulfil all laws are taken.
Source: [LeineNijmeijer2004]_.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.model import SIDE, CompletedSystem, Drive, Rig, first_held_rate

GUARDS_PER_PART = 3
"""Guards of a part: its rate, and what is left of its static friction up and down."""
_STILL, _STUCK = 1e-11, 1e-6
"""Parts of the size of a rate up to which a part that slips has none, and a part that sticks."""
_ROUNDED = 1e-9
"""Part of the size of a force or an acceleration that is rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DryParts:
    """The parts of a machine with dry friction, in symbols.

    Attributes:
        names: Name of each part: of the problem's parts, then the coordinates of the rig's.
        rates: Relative rates, ``(n_f,)``.
        torques: Friction while a part slips, ``(n_f,)``.
        static: Largest friction while it sticks, ``(n_f,)``.
        sides: Sides: 1 and -1 while a part slips, 0 while it sticks, ``(n_f,)``.
        added: Sides of the rig's own parts, which the problem lacks, ``(n_a,)``.
    """

    names: tuple[str, ...]
    rates: ca.SX
    torques: ca.SX
    static: ca.SX
    sides: ca.SX
    added: ca.SX

    @classmethod
    def of(cls, system: CompletedSystem, coordinates: Sequence[str], rig: Rig) -> DryParts:
        """Return the parts of a problem and of its rig.

        Args:
            system: The completed system of the problem.
            coordinates: Names of its coordinates.
            rig: The rig, whose dry friction acts along coordinates.
        """
        drive, v = system.drive, system.mechanism.v
        own = {name: one.coulomb for name, one in rig.friction.items() if one.coulomb}
        added = [ca.SX.sym(SIDE + name) for name in own]
        numbers = [ca.SX(one) for one in own.values()]
        return cls(
            names=(*drive.frictions, *own),
            rates=ca.vertcat(drive.sliding, *(v[coordinates.index(name)] for name in own)),
            torques=ca.vertcat(drive.torques, *numbers),
            static=ca.vertcat(drive.static, *numbers),
            sides=ca.vertcat(drive.sides, *added),
            added=ca.vertcat(ca.SX(0, 1), *added),
        )

    def of_drive(self, drive: Drive) -> DryParts:
        """Return the parts with the formulas of a drive on a branch of its kinks."""
        n = len(drive.frictions)
        return replace(
            self,
            rates=ca.vertcat(drive.sliding, _from(self.rates, n)),
            torques=ca.vertcat(drive.torques, _from(self.torques, n)),
            static=ca.vertcat(drive.static, _from(self.static, n)),
        )

    @property
    def added_names(self) -> tuple[str, ...]:
        """Name of the state of each part of the rig."""
        n = self.added.numel()
        return tuple(SIDE + name for name in self.names[len(self.names) - n :])

    def slipping(self, v: ca.SX) -> ca.SX:
        """Return the generalized forces of the rig's own parts that slip, ``(n_q,)``."""
        first = len(self.names) - self.added.numel()
        own = _from(self.rates, first)
        force = ca.SX.zeros(v.numel())
        if own.numel():
            force -= ca.mtimes(ca.jacobian(own, v).T, _from(self.torques, first) * self.added)
        return force

    def require_free(self, system: CompletedSystem) -> None:
        """Refuse parts whose rates depend on each other.

        Raises:
            InputError: If the force of a part is not determined. The message names it.
        """
        found = first_held_rate(system.mechanism, self.names, self.rates)
        if found is None:
            return
        wanted = f"must leave out `{self.names[found[0]]}`"
        told = "a constraint or another part with dry friction holds its rate as well"
        raise InputError(f"Argument `friction` {wanted}: {told}.")


def _from(column: ca.SX, first: int) -> ca.SX:
    """Return the entries of a column from an index on, also if there are none."""
    return ca.vertcat(ca.SX(0, 1), *(column[k] for k in range(first, column.numel())))


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldFlow:
    """The motion of a machine with its dry friction, in symbols.

    Attributes:
        acceleration: Acceleration with the parts that stick held, ``(n_q,)``.
        forces: Forces of the parts that stick, 0 for the others, ``(n_f,)``.
        load: What decides at an event: the numbers of a `DryLoad` in one column.
    """

    acceleration: ca.SX
    forces: ca.SX
    load: ca.SX


def held_motion(
    parts: DryParts, v: ca.SX, inverse_mass: ca.SX, acceleration: ca.SX, drift: ca.SX
) -> HeldFlow:
    """Return the motion of a machine with its dry friction.

    Args:
        parts: The parts.
        v: Velocities, ``(n_q,)``.
        inverse_mass: Inverse mass on the constraints, ``(n_q, n_q)``.
        acceleration: Acceleration with the friction of the parts that slip, ``(n_q,)``.
        drift: Accelerations of the rates without an acceleration of the machine, ``(n_f,)``.
    """
    rows = ca.jacobian(parts.rates, v)
    response = ca.mtimes(inverse_mass, rows.T)
    delassus = ca.mtimes(rows, response)
    pulls = ca.mtimes(rows, acceleration) + drift
    acts = 1 - parts.sides**2
    # Rows that do not act become rows of the unit matrix.
    system = delassus * ca.mtimes(acts, acts.T) + ca.diag(1 - acts**2)
    forces = -ca.mtimes(ca.inv(system), acts * pulls)
    free = pulls + ca.mtimes(delassus, parts.torques * parts.sides)
    load = ca.vertcat(
        parts.rates, free, parts.torques, parts.static, ca.vec(delassus.T), ca.vec(rows.T)
    )
    return HeldFlow(
        acceleration=acceleration + ca.mtimes(response, forces), forces=forces, load=load
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class DryLoad:
    """What decides which parts slip at a state.

    Attributes:
        rates: Relative rates, ``(n_f,)``.
        free: Their accelerations without dry friction, ``(n_f,)``.
        torques: Friction while a part slips, ``(n_f,)``.
        static: Largest friction while it sticks, ``(n_f,)``.
        delassus: Accelerations per force, ``(n_f, n_f)``.
        rows: Derivatives of the rates with respect to the velocities, ``(n_f, n_q)``.
        sizes: Sizes of the rates, ``(n_f,)``.
    """

    rates: Vector
    free: Vector
    torques: Vector
    static: Vector
    delassus: Vector
    rows: Vector
    sizes: Vector

    @classmethod
    def of(cls, column: Vector, n_parts: int, v: Vector, scales: Vector) -> DryLoad:
        """Return what a column of numbers says.

        Args:
            column: The column of `HeldFlow.load`.
            n_parts: Number of parts.
            v: Velocities, ``(n_q,)``.
            scales: Their scales, ``(n_q,)``.
        """
        n = n_parts
        rates, free, torques, static = column[: 4 * n].reshape(4, n)
        rows = column[4 * n + n * n :].reshape(n, v.size)
        return cls(
            rates=rates,
            free=free,
            torques=torques,
            static=static,
            delassus=column[4 * n : 4 * n + n * n].reshape(n, n),
            rows=rows,
            sizes=np.abs(rows) @ (scales + np.abs(v)),
        )

    @property
    def rounding(self) -> Vector:
        """Rounding levels of the rates, ``(n_f,)``."""
        return _STILL * self.sizes

    def first_sides(self) -> tuple[int, ...]:
        """Return the signs of the rates, 0 for a part at rest."""
        moves = np.abs(self.rates) > self.rounding
        return tuple(int(one) for one in np.where(moves, np.sign(self.rates), 0))

    def sides(
        self, before: tuple[int, ...], *, fixed: Mapping[int, int], at_rest: Sequence[int] = ()
    ) -> tuple[int, ...] | None:
        """Return sides that fulfil all laws, or ``None``. Sides that do are kept.

        With a static friction above the other several may. Then parts that stick go on to stick,
        and of the others as many as possible stick.

        Args:
            before: Sides before the event.
            fixed: Sides of parts whose static friction has just been exceeded.
            at_rest: Parts whose rate has just fallen to zero.
        """
        level = np.where([one == 0 for one in before], _STUCK, _STILL) * self.sizes
        ways: list[tuple[int, ...]] = []
        for j, rate in enumerate(self.rates.tolist()):
            if j in fixed:
                ways.append((fixed[j],))
            elif j not in at_rest and abs(rate) > level[j]:
                ways.append((1 if rate > 0.0 else -1,))
            else:
                ways.append((0, 1, -1))

        def changes(one: tuple[int, ...]) -> tuple[int, int, int]:
            pairs = list(zip(before, one, strict=True))
            leaves = sum(old == 0 and new != 0 for old, new in pairs)
            slips = sum(new != 0 for j, new in enumerate(one) if len(ways[j]) > 1)
            return leaves, slips, sum(old != new for old, new in pairs)

        fresh = [j for j, one in enumerate(ways) if len(one) > 1]
        may_stay = all(side in way for side, way in zip(before, ways, strict=True))
        if not at_rest and may_stay and self._fits(before, fresh, slack=_ROUNDED):
            return before
        tried = sorted(product(*ways), key=changes)
        for slack in (0.0, _ROUNDED):
            for sides in tried:
                if self._fits(sides, fresh, slack=slack):
                    return sides
        return None

    def _fits(self, sides: tuple[int, ...], fresh: Sequence[int], *, slack: float) -> bool:
        """Return True if all parts at rest obey their laws: stuck, or pulled to their side."""
        side = np.array(sides)
        stuck = np.flatnonzero(side == 0)
        slipping = -self.torques * side
        pulls = self.free + self.delassus @ slipping
        sizes = np.abs(self.free) + np.abs(self.delassus) @ self.static
        if stuck.size:
            own = self.delassus[np.ix_(stuck, stuck)]
            forces = -np.linalg.solve(own, pulls[stuck])
            pulls = pulls + self.delassus[:, stuck] @ forces
            most = self.static[stuck] + _STILL * (self.static[stuck] + np.abs(forces))
            if np.any(np.abs(forces) > most):
                return False
        moving = [j for j in fresh if sides[j]]
        return all(sides[j] * pulls[j] > -slack * sizes[j] for j in moving)
