r"""A graph of modes: a machine with several stops, switches, or kinks in its formulas.

A mode is a set `S` of closed stops and a branch of every kink. Its flow is smooth. It is the free
flow of the mechanism with the closed stops as holonomic constraints, with the inverse mass

.. math:: W_S = W - W J_S^\top (J_S W J_S^\top)^{-1} J_S W

For every other stop `k` the pair ``(S, k)`` is a completed system with one stop: its free flow is
the flow of `S`, its constrained flow the flow of :math:`S \cup \{k\}`, its multiplier the
multiplier of `k` in that mode. A graph of modes is made of these systems, theory (1.5)-(2.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import casadi as ca

from zeno_orbits.errors import did_you_mean
from zeno_orbits.model.drives.auxiliary import Part
from zeno_orbits.model.drives.circuits import Held
from zeno_orbits.model.drives.waveforms import TimeOrder, time_orders
from zeno_orbits.model.expressions.kinks import branched
from zeno_orbits.model.friction import friction_formulas, require_free_rates
from zeno_orbits.model.hybrid import CompletedSystem, completed
from zeno_orbits.model.lagrangian import HybridLagrangian, accelerate
from zeno_orbits.model.modes import GraphMode, ModeGraph, formulas_of, kinks_of
from zeno_orbits.model.stops import (
    Stop,
    Switch,
    event_of_setting,
    require_event_names,
    setting_name,
    watched,
)
from zeno_orbits.work import checked


@checked
def hybrid_system(
    lagrangian: HybridLagrangian,
    drive: Part | Sequence[Part] | Any,
    restitution: ca.SX | float | None = None,
    *,
    switches: Sequence[Switch] | None = None,
) -> CompletedSystem:
    r"""Build the completed hybrid system of a mechanism, its drive, its stops and its switches.

    Let :math:`W` be the inverse mass on the holonomic constraints (theory (1.6)) and
    :math:`J = \partial h / \partial q`. Then

    .. math:: \lambda = -\ddot h_\mathrm{free} / (J W J^\top),\qquad
        v^+ = v^- - (1 + e)\,\frac{J v^-}{J W J^\top}\,W J^\top

    Args:
        lagrangian: The mechanism, with one gap, with ``stops``, or without a stop.
        drive: Drive or additional states, or a tuple of several. Their states follow in order.
        restitution: Coefficient of restitution :math:`e` of the one gap in [0, 1]: a number, or a
            formula of parameters and ``zo.impact_speed``, as for a `Stop`. The ``stops`` of a
            mechanism have their own, and without a stop it is left out.
        switches: Declared switches of the machine. Every kink of a formula (``fmin``, ``fmax``,
            ``fabs``, ``sign``, ``if_else``, ``atan2``) is a further switch, without a reset.

    Returns:
        The completed system. With ``stops``, ``switches`` or a kink it is the first stop's, and its
        ``modes`` are declared. Its ``graph`` holds all modes of any machine.

    Raises:
        ValueError: If the restitution is missing or given twice, if a corrected drive would make it
            depend on the state, if drives share a state, if an impact with zero speed would change
            additional states, if a stop or switch is invalid, if a piecewise input has switching
            times of the state, or if a formula jumps without a condition or holds an unknown
            operation.

    Source: [Moreau1988]_ for the impact law, theory (1.6)-(2.1), and (20) for a corrected drive.
    """
    if lagrangian.has_gap:
        if restitution is None:
            raise ValueError("Argument `restitution` is missing: pass it to `hybrid_system`.")
        one = completed(lagrangian, drive, ca.SX(restitution))
        kinks = kinks_of(one.mechanism, one.drive, one.state)
        is_plain = not (one.drive.holds or one.drive.frictions)
        if switches is None and is_plain and not any(kinks):
            return one.as_built()
        return replace(one, modes=graph_of_one_stop(one, switches)).as_built()
    if restitution is not None and not lagrangian.stops:
        raise ValueError(
            "Argument `restitution` must be left out of a machine without a stop. If it has one, "
            "give the mechanism its `gap`."
        )
    if restitution is not None:
        raise ValueError(
            "Argument `restitution` must be left out of `hybrid_system`: every stop has its own."
        )
    one = completed(lagrangian, drive, ca.SX(watched(lagrangian.stops)[0].restitution))
    return replace(one, modes=_graph(one, lagrangian.stops, tuple(switches or ()))).as_built()


def graph_of_one_stop(one: CompletedSystem, switches: Sequence[Switch] | None = None) -> ModeGraph:
    """Return the graph of modes of a machine with one stop, which is named `stop`.

    Args:
        one: The machine.
        switches: Its switches. Every kink of a formula is a further switch.

    Raises:
        ValueError: If a switch is invalid, or the gap has a kink.
    """
    stop = Stop(name="stop", gap=one.gap, restitution=one.stop_restitution)
    return replace(_graph(one, (stop,), tuple(switches or ())), is_named=switches is not None)


def system_of_stop(
    graph: ModeGraph, mode: GraphMode, stop: int, beyond: tuple[int, ...] = ()
) -> CompletedSystem:
    """Return the completed system of an open stop in a mode.

    Args:
        graph: The modes of the machine.
        mode: The mode, whose closed stops are constraints.
        stop: Index of the stop.
        beyond: Indices of compliant stops whose gap is negative.
    """
    closed, sides = mode
    mechanism, drive, _ = graph.on_branch(sides, beyond)
    shut = ca.vertcat(mechanism.holonomic, *(graph.stops[k].gap for k in closed))
    seen = watched(graph.stops)[stop]
    one = replace(mechanism, gap=seen.gap, holonomic=shut)
    return completed(one, drive, ca.SX(seen.restitution))


def guard_and_flow(graph: ModeGraph, mode: GraphMode, switch: int) -> tuple[ca.SX, ca.SX]:
    """Return the guard of a switch in a mode, and the flow of the mode, ``(n_x,)``.

    Args:
        graph: The modes of the machine.
        mode: The mode.
        switch: Index of a declared switch, or of a kink after these.
    """
    closed, sides = mode
    opened = [k for k in range(graph.n_watched) if k not in closed]
    if opened:
        flow = system_of_stop(graph, mode, opened[0]).free_flow
    else:
        flow = system_of_stop(graph, (closed[:-1], sides), closed[-1]).locked_flow
    return graph.guard(sides, switch, closed), flow


def _graph(
    one: CompletedSystem, stops: tuple[Stop, ...], switches: tuple[Switch, ...]
) -> ModeGraph:
    """Return the graph of modes of a machine.

    Raises:
        ValueError: If a stop or a switch is invalid, or if a corrected drive would make a
            restitution depend on the state.
    """
    mechanism, drive = one.bare, one.drive
    for switch in switches:
        _require_guard(one, switch)
    switches, causes = _with_holds(one, stops, switches)
    if drive.frictions:
        every_gap = ca.vertcat(ca.SX(0, 1), *(stop.gap for stop in stops))
        require_free_rates(one.mechanism, drive, stops)
        contact = ca.SX.zeros(len(stops))
        none = ca.SX.zeros(one.state.numel())
        formulas = friction_formulas(one.mechanism, drive, every_gap, contact, one.state, none)
        added = formulas.switches
        switches, causes = (*switches, *added), (*causes, *("" for _ in added))
    if len(stops) > 1 and drive.after_impact is not None:
        raise ValueError(
            "Argument `after_impact` must be left out of a machine with several stops."
        )
    gaps = ca.vertcat(*(stop.gap for stop in watched(stops)))
    _require_smooth(
        one.state, gap=gaps, holonomic=mechanism.holonomic, mass_matrix=mechanism.mass_matrix
    )
    normals = ca.jacobian(gaps, mechanism.q)
    delassus = coupling = _delassus(one.mechanism, normals)
    if drive.added_inertia.nnz():
        coupling = _delassus(mechanism, normals)
    conditions, roots = kinks_of(mechanism, drive, one.state)
    bare = ModeGraph(
        mechanism=mechanism,
        drive=drive,
        stops=stops,
        switches=switches,
        conditions=conditions,
        roots=roots,
        time_orders=_time_orders(one),
        delassus=delassus,
        coupling=coupling,
        resets=tuple(_reset(one, switch) for switch in switches),
        causes=causes,
        state=one.state,
    )
    require_event_names([*(stop.name for stop in stops), *bare.switch_names])
    if bare.has_current_layers:
        _require_constant_restitutions(bare)
    return bare


def _with_holds(
    one: CompletedSystem, stops: tuple[Stop, ...], switches: tuple[Switch, ...]
) -> tuple[tuple[Switch, ...], tuple[str, ...]]:
    """Return the switches with one for each event of a stop that sets states, and their causes.

    Raises:
        ValueError: If the machine lacks the event.
    """
    events = [f"switch {switch.name}" for switch in switches]
    known = [f"{kind} {stop.name}" for stop in stops for kind in ("impact", "zeno", "release")]
    found, causes = list(switches), [""] * len(switches)
    for at in dict.fromkeys(held.at for held in one.drive.holds):
        if at in events:
            continue
        if at not in known:
            hint = did_you_mean(at, [*known, *events])
            told = f"{', '.join([*known, *events]) or 'none'}), but it is `{at}`.{hint}"
            raise ValueError(f"Argument `at` must be an event of the machine ({told}")
        after = _set_anew(one, at, one.drive.states)
        # Its guard never falls: the event of the stop is its cause.
        one_setting = Switch(name=setting_name(at), guard=ca.SX(1), armed=0.0, others_after=after)
        found.append(one_setting)
        causes.append(at)
    return tuple(found), tuple(causes)


def _held(one: CompletedSystem, switch: Switch, reset: ca.SX) -> ca.SX:
    """Return the state after a declared switch at which states are set."""
    at = f"switch {switch.name}"
    if not any(held.at == at for held in one.drive.holds):
        return reset
    first = 2 * one.n_q
    after = ca.SX(one.state)
    after[first : first + one.drive.states.numel()] = _set_anew(one, at, one.drive.states)
    return ca.substitute(after, one.state, reset)


def _set_anew(one: CompletedSystem, at: str, states: ca.SX) -> ca.SX:
    """Return the states of a drive, those that are set at an event by their formulas."""
    held: list[Held] = [held for held in one.drive.holds if held.at == at]
    formulas = ca.vertcat(*(each.after for each in held))
    return ca.substitute(states, ca.vertcat(*(each.states for each in held)), formulas)


def _delassus(mechanism: HybridLagrangian, normals: ca.SX) -> ca.SX:
    r"""Return :math:`J W J^\top` of rows `J`."""
    inverse_mass, _ = accelerate(mechanism, ca.SX.zeros(mechanism.q.numel()))
    return ca.mtimes([normals, inverse_mass, normals.T])


def _require_constant_restitutions(graph: ModeGraph) -> None:
    """Complete every stop beside all combinations of closed stops, as a corrected drive does.

    Raises:
        ValueError: If a restitution depends on the state.
    """
    sides = (True,) * len(graph.conditions)
    for stop in range(len(graph.stops)):
        others = [k for k in range(len(graph.stops)) if k != stop]
        for n in range(len(others) + 1):
            for closed in combinations(others, n):
                system_of_stop(graph, (closed, sides), stop)


def _time_orders(one: CompletedSystem) -> tuple[TimeOrder, ...]:
    """Return the orders of switching times in the formulas of a machine.

    Raises:
        ValueError: If a time depends on the state.
    """
    formulas = (*formulas_of(one.mechanism).values(), *formulas_of(one.drive).values())
    orders = time_orders(formulas)
    if any(ca.depends_on(ca.vertcat(order.lower, order.upper), one.state) for order in orders):
        raise ValueError(
            "Argument `times` of a piecewise input must hold numbers, gains and parameters only."
        )
    return orders


def _require_guard(one: CompletedSystem, switch: Switch) -> None:
    """Refuse a declared guard that is not a smooth formula of the state.

    Raises:
        ValueError: If it is not.
    """
    if event_of_setting(switch.name):
        raise ValueError(
            f"Argument `name` of the switch `{switch.name}` must not begin with `hold at`, by "
            "which switches of held states are named."
        )
    if not ca.depends_on(ca.SX(switch.guard), one.state):
        raise ValueError(
            f"Argument `guard` of the switch `{switch.name}` must depend on the state, but it is "
            "constant."
        )
    if branched([ca.SX(switch.guard)], one.state).conditions:
        raise ValueError(
            f"Argument `guard` of the switch `{switch.name}` must be smooth, but it holds a kink."
        )


def _reset(one: CompletedSystem, switch: Switch) -> ca.SX:
    """Return the state after a switch, at which states may be set.

    Raises:
        ValueError: If a reset changes the number of states.
    """
    n_q, n_drive = one.n_q, one.drive.states.numel()
    parts: list[ca.SX] = []
    first = 0
    for name, n in (("q_after", n_q), ("v_after", n_q), ("others_after", n_drive)):
        given = getattr(switch, name)
        after = one.state[first : first + n] if given is None else ca.vec(ca.SX(given))
        if after.numel() != n:
            raise ValueError(
                f"Argument `{name}` of the switch `{switch.name}` must have {n} entries, but it "
                f"has {after.numel()}."
            )
        parts.append(after)
        first += n
    return _held(one, switch, ca.vertcat(*parts, one.state[first:]))


def _require_smooth(state: ca.SX, **formulas: ca.SX) -> None:
    """Refuse a kink where a machine needs a derivative.

    Raises:
        ValueError: If a formula has a kink. The message names it.
    """
    for name, formula in formulas.items():
        if branched([formula], state).conditions:
            raise ValueError(
                f"Argument `{name}` must be smooth, but it holds a kink: declare two stops instead."
            )
