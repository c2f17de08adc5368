r"""Dry friction in the modes of a machine: motion that sticks, and the switches of its parts.

Let `R` be the rows :math:`\partial r / \partial v` of the parts that stick, `W` the inverse mass on
the constraints, `a` the acceleration without their forces. The forces keep :math:`\dot r = 0`:

.. math:: f = -(R W R^\top)^{-1} (R\,a + \dot R\,v + \partial_t r),\qquad
    W_\mathrm{stuck} = W - W R^\top (R W R^\top)^{-1} R W

Closed stops are further rows of the same system. Source: [LeineNijmeijer2004]_.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, combinations, product

import casadi as ca
import numpy as np

from zeno_orbits.model.drives.circuits import Drive
from zeno_orbits.model.drives.friction import STICKS_BELOW
from zeno_orbits.model.lagrangian import HybridLagrangian, accelerate
from zeno_orbits.model.stops import Stop, Switch

FORCED = 2.0
"""Number that tells that a switch of a part occurs before the stops open or close."""
PER_PART = 5
"""Number of switches of a part: it sticks, and turns or slips in either direction."""
_STILL, _AGAINST = 1e-11, 1e-12
"""Parts of the size of a rate below which a part that sticks has none, and one that slips keeps its
side."""
_MOST = 24
"""Combinations of stops and parts that are tried where a part may stick."""
_DEPENDENT = 1e-9
"""Part of a row that is rounding, beside the rows that it depends on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StuckMotion:
    """The motion of a mechanism some of whose parts stick.

    Attributes:
        inverse_mass: Inverse mass with these parts as constraints, ``(n_q, n_q)``.
        acceleration: Acceleration, ``(n_q,)``.
        rows: Derivatives of their rates with respect to the velocities, ``(n_s, n_q)``.
        inertia: Inverse of the Delassus matrix of the rows, ``(n_s, n_s)``.
        drift: Accelerations of the rates without an acceleration of the mechanism, ``(n_s,)``.
        belts: Their rates at zero velocities, ``(n_s,)``.
    """

    inverse_mass: ca.SX
    acceleration: ca.SX
    rows: ca.SX
    inertia: ca.SX
    drift: ca.SX
    belts: ca.SX

    def belt_power(self, acceleration: ca.SX) -> ca.SX:
        """Return the power of moving surfaces, from the acceleration without their forces [W]."""
        forces = -ca.mtimes(self.inertia, ca.mtimes(self.rows, acceleration) + self.drift)
        return -ca.dot(forces, self.belts)


def stuck_motion(
    mechanism: HybridLagrangian,
    drive: Drive,
    inverse_mass: ca.SX,
    acceleration: ca.SX,
    extra: ca.SX,
    extra_rate: ca.SX,
) -> StuckMotion | None:
    """Return the motion with the parts that stick, or ``None`` if none sticks.

    Args:
        mechanism: The mechanism, whose closed stops are constraints.
        drive: Its drive on a branch, which tells what sticks.
        inverse_mass: Inverse mass on the constraints, ``(n_q, n_q)``.
        acceleration: Acceleration on the constraints without the forces of parts that stick.
        extra: States after the velocities.
        extra_rate: Their rates.
    """
    n = drive.sticks.numel()
    stuck = [k for k in range(n) if drive.sticks[k].is_constant() and float(drive.sticks[k])]
    if not stuck:
        return None
    v, rates = mechanism.v, drive.sliding[stuck]
    rows = ca.jacobian(rates, v)
    drift = _drift(mechanism, rates, extra, extra_rate)
    response = ca.mtimes(inverse_mass, rows.T)
    inertia = ca.inv(ca.mtimes(rows, response))
    gain = ca.mtimes(response, inertia)
    return StuckMotion(
        inverse_mass=inverse_mass - ca.mtimes(gain, response.T),
        acceleration=acceleration - ca.mtimes(gain, ca.mtimes(rows, acceleration) + drift),
        rows=rows,
        inertia=inertia,
        drift=drift,
        belts=ca.substitute(rates, v, ca.SX.zeros(v.numel())),
    )


def _drift(mechanism: HybridLagrangian, rates: ca.SX, extra: ca.SX, extra_rate: ca.SX) -> ca.SX:
    """Return the accelerations of rates without an acceleration of the mechanism."""
    q, v = mechanism.q, mechanism.v
    if extra.numel() == 0:
        return ca.jtimes(rates, q, v)
    return ca.jtimes(rates, ca.vertcat(q, extra), ca.vertcat(v, extra_rate))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Held:
    """A mechanism whose closed stops and parts that stick are held.

    Attributes:
        contacts: Contact forces of the stops, zero for an open one, ``(n_stops,)``.
        lifts: Gap accelerations, ``(n_stops,)``.
        forces: Forces of the parts that stick, zero for the others, ``(n_f,)``.
        pulls: Accelerations of the rates, ``(n_f,)``.
    """

    contacts: ca.SX
    lifts: ca.SX
    forces: ca.SX
    pulls: ca.SX


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rows:
    """The rows of all stops and of all parts with friction, and what acts on them.

    Attributes:
        drive: The drive.
        contact: 1 for each stop that is closed, and else 0, ``(n_stops,)``.
        delassus: Delassus matrix of the rows, ``(n_stops + n_f, n_stops + n_f)``.
        drift: Accelerations of the rows without friction and contact, ``(n_stops + n_f,)``.
    """

    drive: Drive
    contact: ca.SX
    delassus: ca.SX
    drift: ca.SX

    @classmethod
    def of(cls, mechanism: HybridLagrangian, drive: Drive, gaps: ca.SX, contact: ca.SX) -> _Rows:
        """Return the rows of a mechanism.

        Args:
            mechanism: The mechanism.
            drive: Its drive.
            gaps: The gaps of its stops, ``(n_stops,)``.
            contact: 1 for each stop that is closed, and else 0, ``(n_stops,)``.
        """
        q, v, still = mechanism.q, mechanism.v, ca.SX.zeros(drive.sides.numel())
        extra, extra_rate = drive.states, drive.rates
        if mechanism.clock is not None:
            extra = ca.vertcat(extra, mechanism.clock.state)
            extra_rate = ca.vertcat(extra_rate, mechanism.clock.rate)
        inverse_mass, free = accelerate(mechanism, ca.substitute(drive.force, drive.sides, still))
        rates = ca.vertcat(ca.jtimes(gaps, q, v), drive.sliding)
        rows = ca.jacobian(rates, v)
        return cls(
            drive=drive,
            contact=contact,
            delassus=ca.mtimes([rows, inverse_mass, rows.T]),
            drift=ca.mtimes(rows, free) + _drift(mechanism, rates, extra, extra_rate),
        )

    def held(self, shut: Sequence[int], sides: ca.SX) -> _Held:
        """Return the forces and accelerations at sides of the parts.

        Args:
            shut: 0 for each stop that is open, whether it was closed or not, ``(n_stops,)``.
            sides: The sides, 0 for a part that sticks, ``(n_f,)``.
        """
        n = self.contact.numel()
        acts = ca.vertcat(ca.SX(list(shut)) * self.contact, 1 - sides**2)
        slipping = ca.vertcat(ca.SX.zeros(n), -self.drive.torques * sides)
        drift = self.drift + ca.mtimes(self.delassus, slipping)
        # Rows that do not act become rows of the unit matrix.
        system = self.delassus * ca.mtimes(acts, acts.T) + ca.diag(1 - acts**2)
        forces = -ca.mtimes(ca.inv(system), acts * drift)
        left = drift + ca.mtimes(self.delassus, acts * forces)
        return _Held(contacts=forces[:n], lifts=left[:n], forces=forces[n:], pulls=left[n:])

    def needed_at_once(self, part: int) -> ca.SX:
        """Return the force that a part needs to stick, with all other held parts."""
        sides = ca.SX(self.drive.sides)
        sides[part] = 0
        return self.held((1,) * self.contact.numel(), sides).forces[part]

    def needed_at_rest(self, part: int) -> ca.SX:
        """Return the force that a part needs to stick where its rate is zero, or infinity.

        With that force a closed stop may open, and another part that sticks may slip. The
        combination that fulfils all laws is taken, and of several the one in which most is held.
        Beyond `_MOST` combinations all is kept as it is: a change then leads to a further event at
        the same time.
        """
        drive, n = self.drive, self.contact.numel()
        others = [k for k in range(len(drive.frictions)) if k != part]
        if 2**n * 3 ** len(others) > _MOST:
            return self.needed_at_once(part)
        needed = ca.SX(math.inf)
        ways = product(*[(0, 1)] * n, *[(1, -1, 0)] * len(others))
        for way in sorted(ways, key=lambda one: sum(one[:n]) + sum(s == 0 for s in one[n:])):
            one, fits = self._fitting(part, way[:n], dict(zip(others, way[n:], strict=True)))
            needed = ca.if_else(fits, one.forces[part], needed)
        return needed

    def _fitting(
        self, part: int, shut: Sequence[int], beside: Mapping[int, int]
    ) -> tuple[_Held, ca.SX]:
        """Return what is held in a combination, and whether that fulfils all laws."""
        drive, sides, fits = self.drive, ca.SX(self.drive.sides), ca.SX(1)
        sides[part] = 0
        for k, side in beside.items():
            sides[k] = ca.if_else(drive.sides[k] ** 2 < STICKS_BELOW, side, drive.sides[k])
        one = self.held(shut, sides)
        for k, is_shut in enumerate(shut):
            obeys = one.contacts[k] >= 0 if is_shut else self.contact[k] * one.lifts[k] >= 0
            fits = ca.logic_and(fits, obeys)
        for k, side in beside.items():
            obeys = side * one.pulls[k] > 0 if side else one.forces[k] ** 2 <= drive.static[k] ** 2
            was_slipping = drive.sides[k] ** 2 > STICKS_BELOW
            fits = ca.logic_and(fits, ca.logic_or(was_slipping, obeys))
        return one, ca.logic_and(fits, one.forces[part] ** 2 <= drive.static[part] ** 2)


_WAYS = (("up", 1), ("down", -1))
"""Directions of a part, and the signs of its rate."""
_ASIDE = math.sqrt(STICKS_BELOW)
"""Size of a side above which a part slips."""


def _after(drive: Drive, part: int, side: int) -> ca.SX:
    """Return the states of a drive with another side of a part."""
    return ca.substitute(drive.states, drive.sides[part], ca.SX(side))


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionFormulas:
    """The switches of all parts with friction, and what occurs without a zero of a guard.

    Attributes:
        switches: Each part sticks, and turns or slips up and down. Where a guard cannot fall it is
            1, and so it is for the other sides of the part.
        due: A number per switch. It is positive where the switch occurs at the start of an arc, and
            `FORCED` where it occurs before the stops open or close.
    """

    switches: tuple[Switch, ...]
    due: ca.SX


def friction_guards(
    mechanism: HybridLagrangian, drive: Drive, gaps: ca.SX, contact: ca.SX
) -> tuple[ca.SX, ...]:
    """Return the guards of the switches of all parts.

    Args:
        mechanism: The mechanism.
        drive: Its drive.
        gaps: The gaps of its stops, ``(n_stops,)``.
        contact: 1 for each stop that is closed, and else 0, ``(n_stops,)``.
    """
    rows = _Rows.of(mechanism, drive, gaps, contact)
    return tuple(chain(*(_guards(rows, k) for k in range(len(drive.frictions)))))


def _guards(rows: _Rows, k: int) -> list[ca.SX]:
    """Return the guards of a part: it sticks, turns up and down, and slips up and down."""
    drive = rows.drive
    side, rate, static = drive.sides[k], drive.sliding[k], drive.static[k]
    is_stuck, needed = (1 - side**2) ** 2, rows.needed_at_once(k)
    reserves = [is_stuck * (static + sign * needed) + (1 - is_stuck) for _, sign in _WAYS]
    return [is_stuck + side * rate] * (1 + len(_WAYS)) + reserves


def friction_formulas(
    mechanism: HybridLagrangian,
    drive: Drive,
    gaps: ca.SX,
    contact: ca.SX,
    state: ca.SX,
    sizes: ca.SX,
) -> FrictionFormulas:
    """Return the switches of all parts, and formulas that tell whether they occur without a zero.

    An impact or a jump of a force may leave a part on a side that it does not have. It turns if its
    rate is against its side. It slips if it has a rate, or if it needs more than the static force.

    Args:
        mechanism: The mechanism.
        drive: Its drive.
        gaps: The gaps of its stops, ``(n_stops,)``.
        contact: 1 for each stop that is closed, and else 0, ``(n_stops,)``.
        state: The state, ``(n_x,)``.
        sizes: Sizes of its entries, ``(n_x,)``.
    """
    rows = _Rows.of(mechanism, drive, gaps, contact)
    parts = [_of_part(rows, mechanism.v, k, state, sizes) for k in range(len(drive.frictions))]
    return FrictionFormulas(
        switches=tuple(chain(*(one.switches for one in parts))),
        due=ca.vertcat(*(one.due for one in parts)),
    )


def _of_part(rows: _Rows, v: ca.SX, k: int, state: ca.SX, sizes: ca.SX) -> FrictionFormulas:
    """Return the formulas of one part."""
    drive = rows.drive
    name, side, rate, static = drive.frictions[k], drive.sides[k], drive.sliding[k], drive.static[k]
    needed, at_rest = rows.needed_at_once(k), rows.needed_at_rest(k)
    slips, sticks = side**2 > STICKS_BELOW, side**2 < STICKS_BELOW
    forward, *_, up, down = _guards(rows, k)
    row = ca.jacobian(rate, v)
    # Any direction that changes the rate alone: the rate is zero up to rounding.
    stopped = v - row.T * (rate / ca.dot(row, row))
    size = ca.mtimes(ca.fabs(ca.jacobian(rate, state)), sizes)
    small, against = _STILL * size, _AGAINST * size
    beyond = static + _STILL * (ca.fabs(static) + ca.fabs(needed))
    found = [
        Switch(
            name=f"stick {name}",
            guard=forward,
            armed=ca.logic_and(slips, at_rest**2 <= static**2),
            v_after=stopped,
            others_after=_after(drive, k, 0),
        )
    ]
    due = [ca.SX(0)]
    for word, sign in _WAYS:
        is_other = -sign * side > _ASIDE
        armed, moved = ca.logic_and(is_other, static**2 < at_rest**2), _after(drive, k, sign)
        turn = f"turn {name} {word}"
        found.append(Switch(name=turn, guard=forward, armed=armed, others_after=moved))
        due.append(FORCED * ca.logic_and(is_other, side * rate < -against))
    for (word, sign), reserve in zip(_WAYS, (up, down), strict=True):
        moved = _after(drive, k, sign)
        slip = f"slip {name} {word}"
        found.append(Switch(name=slip, guard=reserve, armed=sticks, others_after=moved))
        is_pulled = ca.logic_and(ca.fabs(rate) <= small, beyond < -sign * needed)
        urgency = ca.if_else(static**2 < at_rest**2, FORCED, 1)
        leaves = ca.if_else(sign * rate > small, FORCED, ca.if_else(is_pulled, urgency, 0))
        due.append(ca.if_else(sticks, leaves, 0))
    return FrictionFormulas(switches=tuple(found), due=ca.vertcat(*due))


def require_free_rates(mechanism: HybridLagrangian, drive: Drive, stops: Sequence[Stop]) -> None:
    """Refuse a friction whose rate is zero while stops are closed or other parts stick.

    Its force and the force of the stop are then not determined. `first_held_rate` tells which
    states decide.

    Args:
        mechanism: The mechanism.
        drive: Its drive.
        stops: Its stops.

    Raises:
        ValueError: If there is one. The message names it.
    """
    found = first_held_rate(mechanism, drive.frictions, drive.sliding, stops)
    if found is None:
        return
    part, closed = found
    who = ", ".join(f"the closed stop `{stops[j].name}`" for j in closed)
    who = who or "a constraint or another part that sticks"
    raise ValueError(
        f"Argument `rate` of the friction `{drive.frictions[part]}` must be free, but it is zero "
        f"with {who}, so its force is not determined. Choose a rate that they do not hold."
    )


def first_held_rate(
    mechanism: HybridLagrangian, names: Sequence[str], rates: ca.SX, stops: Sequence[Stop] = ()
) -> tuple[int, tuple[int, ...]] | None:
    """Return a rate that closed stops and the rates before it hold, and these stops, if any does.

    Random states decide, at which the constraints hold and the gaps of the closed stops are zero. A
    rate that is held at all of them is held wherever the stops are closed. One that is held in a
    few configurations alone is not found.

    Args:
        mechanism: The mechanism.
        names: Name of each part.
        rates: Its rate, ``(n_f,)``.
        stops: Stops, which may close.
    """
    q, eta = mechanism.q, mechanism.holonomic
    gaps = ca.vertcat(ca.SX(0, 1), *(one.gap for one in stops))
    place = ca.vertcat(eta, gaps)
    normals = ca.jacobian(place, q)
    rows = ca.vertcat(normals, ca.jacobian(rates, mechanism.v))
    known = ca.symvar(ca.vertcat(ca.vec(rows), place))
    others = [one for one in known if not ca.depends_on(q, one)]
    symbols = [q, ca.vertcat(ca.SX(0, 1), *others)]
    function = ca.Function("rows", symbols, [ca.densify(one) for one in (place, normals, rows)])
    n_fixed, n_shut = eta.numel(), eta.numel() + len(stops)
    for closed in (c for m in range(len(stops) + 1) for c in combinations(range(len(stops)), m)):
        shut = [*range(n_fixed), *(n_fixed + k for k in closed)]
        matrices = list(_matrices_at(function, shut)) or list(_matrices_at(function, ()))
        if any(_rank(one[shut]) < len(shut) for one in matrices):
            continue
        for k in range(len(names)):
            taken = [*shut, *range(n_shut, n_shut + k + 1)]
            if all(_rank(one[taken]) < len(taken) for one in matrices):
                return k, closed
    return None


_TRIED, _CORRECTIONS = 4, 50
"""Random states at which ranks are taken, and corrections that lead to closed stops at most."""


def _matrices_at(function: ca.Function, shut: Sequence[int]) -> Iterator[np.ndarray]:
    """Yield the rows of stops and parts at random states with some gaps at zero.

    A random state from which the corrections by Gauss and Newton do not lead there is left out.
    """
    n_q, n_others = function.numel_in(0), function.numel_in(1)
    for seed in range(_TRIED):
        random = np.random.default_rng(seed)
        q, others = random.uniform(0.5, 1.5, n_q), random.uniform(0.5, 1.5, n_others)
        for _ in range(_CORRECTIONS):
            place, normals, rows = (
                np.asarray(one.full(), dtype=np.float64) for one in function(q, others)
            )
            left = place[shut].ravel()
            if not np.all(np.isfinite(rows)) or not np.all(np.isfinite(left)):
                break
            if not left.size or float(np.max(np.abs(left))) < _DEPENDENT:
                yield rows
                break
            q = q - np.linalg.lstsq(normals[shut], left)[0]


def _rank(matrix: np.ndarray) -> int:
    """Return the number of independent rows."""
    if not matrix.size:
        return 0
    sizes = np.linalg.norm(matrix, axis=1, keepdims=True)
    return int(np.linalg.matrix_rank(matrix / np.where(sizes > 0, sizes, 1.0), tol=_DEPENDENT))
