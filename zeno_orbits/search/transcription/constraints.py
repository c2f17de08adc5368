"""Bounds, peaks and amplitudes as rows of a program.

A signal is bounded at all stages and at the extremes of the guess between them. If the signal then
still violates its bound between these points, a simulation detects the violation and updates the
points.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import cast

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Array, Vector
from zeno_orbits.errors import InputError
from zeno_orbits.integrators import lagrange_basis
from zeno_orbits.model import GAP_ACCELERATION, GAP_RATE
from zeno_orbits.orbits import Bound
from zeno_orbits.search.transcription.arc import CollocatedArc
from zeno_orbits.search.transcription.spectral_radius import keep_radius_below
from zeno_orbits.search.transcription.transcribe import OrbitTerms
from zeno_orbits.simulation import Signal, peaks, signal, signal_names

RADIUS_SLACK = 1e-7
"""Reduction of a bound on the spectral radius in the program: the error of its mesh."""


def quantity_terms(terms: OrbitTerms, name: str) -> list[ca.MX]:
    """Return a quantity of the orbit by its name in `measures.NUMBERS`, or its value in each phase.

    The quantity of an orbit of several phases is the smallest value of its phases.

    Raises:
        InputError: If orbits of this shape do not have the quantity.
    """
    if name == "period":
        return [terms.period]
    if name == "energy":
        return [terms.electrical_work]
    if name == "margin":
        return [smallest_share(terms)]
    if name == "first_impact_speed":
        return [-phase.approach_rate for phase in terms.phases]
    found: list[ca.MX] = []
    for place, phase in enumerate(terms.phases):
        if phase.locked is None or phase.zeno is None:
            continue
        if name == "locked_time":
            found.append(phase.locked.duration)
        elif name == "gap_acceleration":
            found.append(-terms.compiled.contact_at(phase.zeno, terms.p).gap_acceleration)
        else:
            # The release is the start of the next phase.
            release = terms.phases[(place + 1) % len(terms.phases)].start
            found.append(-terms.compiled.contact_at(release, terms.p).multiplier_rate)
    if not found:
        wanted = f"must bound a quantity of an orbit of shape `{terms.shape.text}`"
        raise InputError(f"Argument `bounds` {wanted}, but it names `{name}`.")
    return found


def smallest_share(terms: OrbitTerms) -> ca.MX:
    r"""Declare the smallest margin, as a share of its largest possible value, and return it.

    :math:`t \le` each share. The largest value is an unknown that bounds all stages (theory (5.3)).
    """
    program = terms.program
    share = program.variable("smallest margin", 0.1, lower=-1.0, upper=1.0)[0, 0]
    for phase in terms.phases:
        speed = (f"{phase.label}speed of the first impact", GAP_RATE, phase.flights[0])
        quantities: list[tuple[str, int, CollocatedArc, ca.MX]] = [(*speed, -phase.approach_rate)]
        if phase.locked is not None and phase.zeno is not None:
            push = -terms.compiled.contact_at(phase.zeno, terms.p).gap_acceleration
            quantities.append(
                (f"{phase.label}d2h/dt2 at the Zeno point", GAP_ACCELERATION, phase.locked, push)
            )
        for name, index, arc, value in quantities:
            quantity = _contact(terms, name, index)
            most = largest(terms, quantity, (arc,), f"largest value near the {name}")
            program.at_least_zero(f"margin: {name}", value / most - share)
        if phase.locked is not None:
            row = phase.locked.duration / terms.period - share
            program.at_least_zero(f"margin: {phase.label}locked arc", row)
    return share


def largest(
    terms: OrbitTerms, quantity: Signal, arcs: Sequence[CollocatedArc], label: str
) -> ca.MX:
    """Declare an unknown that bounds the absolute value of a signal, and return it.

    Args:
        terms: The transcribed orbit.
        quantity: The signal.
        arcs: The arcs on which the bound applies.
        label: Name of the unknown.
    """
    columns, at_guess = _places(terms, quantity, arcs)
    size = float(np.max(np.abs(at_guess))) or 1.0
    most = terms.program.variable(label, 1.001 * size, scale=size, lower=0.0)[0, 0]
    for sign, word in ((1.0, "above"), (-1.0, "below minus")):
        _hold(terms, f"{label}: not {word} it", quantity, columns, -sign, most, size)
    return most


def keep(terms: OrbitTerms, bound: Bound, slack: ca.MX | float = 0.0) -> float:
    """Require a quantity to satisfy its bounds, and return the size of the quantity.

    Args:
        terms: The orbit.
        bound: The quantity and its bounds.
        slack: Allowed violation of the bounds, in units of the size.
    """
    if bound.name == "spectral_radius":
        if terms.return_slope is None:
            raise ValueError("Argument `terms` lacks the return map.")
        radius = bound.upper - RADIUS_SLACK + slack
        keep_radius_below(terms.program, terms.return_slope, radius)
        return 1.0
    if bound.name in signal_names(terms.compiled):
        quantity = signal(terms.compiled, bound.name)
        columns, at_guess = _places(terms, quantity, terms.arcs)
        size = size_of(bound, float(np.max(np.abs(at_guess))))
        for sign, end in ((1.0, bound.lower), (-1.0, bound.upper)):
            if math.isfinite(end):
                offset = -sign * end + slack * size
                _hold(terms, _label(bound, sign), quantity, columns, sign, offset, size)
        return size
    values = quantity_terms(terms, bound.name)
    if len(values) > 1 and math.isfinite(bound.upper):
        wanted = f"must bound `{bound.name}` from below only for the shape `{terms.shape.text}`"
        raise InputError(f"Argument `bounds` {wanted}, but it has {bound.text}.")
    size = size_of(bound, max(abs(float(terms.guessed(value)[0, 0])) for value in values))
    for value in values:
        for sign, end in ((1.0, bound.lower), (-1.0, bound.upper)):
            if math.isfinite(end):
                row = sign * (value - end) + slack * size
                terms.program.at_least_zero(_label(bound, sign), row, scale=size)
    return size


def size_of(bound: Bound, largest_value: float) -> float:
    """Return the unit in which a bounded quantity is scaled."""
    ends = [abs(end) for end in (bound.lower, bound.upper) if math.isfinite(end)]
    return max(*ends, largest_value) or 1.0


def _label(bound: Bound, sign: float) -> str:
    relation, end = (">=", bound.lower) if sign > 0 else ("<=", bound.upper)
    return f"{bound.name} {relation} {end:g}"


def _contact(terms: OrbitTerms, name: str, index: int) -> Signal:
    x = ca.SX.sym("x", terms.compiled.n_x)
    p = ca.SX.sym("p", terms.p.numel())
    function = ca.Function("contact_part", [x, p], [terms.compiled.contact(x, p)[index]])
    return Signal(name=name, function=function)


def _hold(
    terms: OrbitTerms,
    label: str,
    quantity: Signal,
    columns: ca.MX,
    sign: float,
    offset: ca.MX | float,
    size: float,
) -> None:
    """Require ``sign * signal + offset >= 0`` at many states."""
    x, p = ca.SX.sym("x", terms.compiled.n_x), ca.SX.sym("p", terms.p.numel())
    room = ca.SX.sym("room")
    value = sign * quantity.function(x, p) + room
    n = columns.shape[1]
    terms.program.at_least_zero_along(
        label,
        ca.Function("room", [x, p, room], [value]),
        (columns, ca.repmat(terms.p, 1, n), ca.repmat(ca.MX(offset), 1, n)),
        scale=size,
    )


def _places(
    terms: OrbitTerms, quantity: Signal, arcs: Sequence[CollocatedArc]
) -> tuple[ca.MX, Array]:
    """Return the states at which a signal is bounded, ``(n_x, n)``, and its values in the guess."""
    n_x, value = terms.compiled.n_x, quantity.at(terms.numbers)
    columns: list[ca.MX] = []
    values: list[float] = []
    for arc in arcs:
        columns += [arc.start[:n_x], arc.stages[:n_x, :]]
        for sign in (1.0, -1.0):
            for peak in peaks(value, arc.guess, sign):
                values.append(peak.value)
                if 0.0 < peak.fraction < 1.0:
                    columns.append(inside(terms, arc, peak.fraction)[:n_x])
    return ca.horzcat(*columns), np.array(values)


def inside(terms: OrbitTerms, arc: CollocatedArc, fraction: float) -> ca.MX:
    """Return the state of an arc's flow at a fraction of its duration, by its polynomial.

    Args:
        terms: The transcribed orbit.
        arc: An arc of the orbit.
        fraction: Fraction of the duration, in [0, 1].

    Returns:
        The state in the program's unknowns, ``(n_y, 1)``.
    """
    states, place = _interval(terms, arc, fraction)
    return ca.mtimes(states, ca.DM(lagrange_basis(_points(terms), place)))


def extreme(terms: OrbitTerms, index: int, sign: float) -> ca.MX:
    """Return the largest value of a state (smallest, if ``sign`` is -1) over the orbit.

    Inside an interval, the derivative of the collocation polynomial vanishes at the extreme, and
    the position of the extreme is an unknown. At an impact, where the rate may change its sign, the
    extreme is a node.

    Args:
        terms: The transcribed orbit.
        index: Index of the state.
        sign: 1 for the largest value, -1 for the smallest.
    """
    arc, peak = max(
        ((arc, peak) for arc in terms.arcs for peak in peaks(_entry(index), arc.guess, sign)),
        key=lambda found: sign * found[1].value,
    )
    if peak.fraction in (0.0, 1.0):
        return (arc.end if peak.fraction else arc.start)[index]
    states, guess = _interval(terms, arc, peak.fraction)
    what = f"{terms.state_names[index]} is {'highest' if sign > 0 else 'lowest'}"
    place = terms.program.variable(f"place where {what}", guess, lower=-0.5, upper=1.5)
    basis = cast("ca.MX", ca.vertcat(*lagrange_basis(_points(terms), place)))
    height = ca.mtimes(states[index, :], basis)
    scale = float(terms.scale[index])
    terms.program.equal(f"{what} there", ca.jacobian(height, place), scale=scale)
    return height


def _entry(index: int) -> Callable[[Vector], float]:
    return lambda x: float(x[index])


def _interval(terms: OrbitTerms, arc: CollocatedArc, fraction: float) -> tuple[ca.MX, float]:
    """Return the states of the interval with a fraction of an arc, and the position inside it."""
    mesh, n = arc.mesh, terms.scheme.n_stages
    interval = max(int(np.searchsorted(mesh, fraction)) - 1, 0)
    first = interval * n
    start = arc.start if first == 0 else arc.stages[:, first - 1]
    place = (fraction - mesh[interval]) / (mesh[interval + 1] - mesh[interval])
    return ca.horzcat(start, arc.stages[:, first : first + n]), float(place)


def _points(terms: OrbitTerms) -> list[float]:
    """Return the positions of an interval's states, including its start."""
    return [0.0, *terms.scheme.nodes.tolist()]
