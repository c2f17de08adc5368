"""The systems of a certificate: one for each stop of a machine, on each side of its kinks.

A machine with one stop and without switches has one system. All systems of a machine have the same
states, and those of the same sides have the same free flow.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, cast

from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem, watched
from zeno_orbits.proof.checker.balls import Array, Ball, NotProved, entries, require
from zeno_orbits.proof.checker.formulas import (
    CheckedView,
    Formulas,
    Graph,
    checked_formulas,
    formulas_of_view,
    joined_digest,
    walked,
)
from zeno_orbits.proof.checker.identities import are_equal
from zeno_orbits.proof.checker.system import System, bound_system

ONE_STOP = CheckedView(0, ())
_MOST_SIDES = 64


class _Systems(dict[CheckedView, System]):
    """Systems that are made when they are needed. Other processes receive those made so far."""

    def __init__(self, make: Callable[[CheckedView], System]) -> None:
        super().__init__()
        self._make = make

    def __missing__(self, view: CheckedView) -> System:
        self[view] = found = self._make(view)
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)


class CertifiedMachine(NamedTuple):
    """The systems of a certificate.

    Attributes:
        start: Stop and sides on the section.
        systems: The system of each stop on each side of the kinks, and with another stop held.
        n_stops: Number of stops.
        n_switches: Number of switches, declared and of kinks.
        is_graph: True for a machine with several stops, switches or kinks.
        names: Names of the stops, and of the switches.
    """

    start: CheckedView
    systems: Mapping[CheckedView, System]
    n_stops: int
    n_switches: int
    is_graph: bool
    names: tuple[tuple[str, ...], tuple[str, ...]]

    @property
    def first(self) -> System:
        """The system on the section."""
        return self.systems[self.start]

    def closed(self, view: CheckedView, mode: str) -> list[CheckedView]:
        """Return the view of each closed stop, in which the other closed stop is held."""
        own, both = view.held, view._replace(stop=view.held, held=-1)
        if mode != "locked":
            return [both] if own >= 0 else []
        return [view, both._replace(held=view.stop)] if own >= 0 else [view]

    def require_pressure(
        self, view: CheckedView, mode: str, box: Array, released: int = -1
    ) -> None:
        """Check that each closed stop is under pressure on a box of states.

        Args:
            view: Stop and sides.
            mode: The mode.
            box: The states.
            released: A stop that is not checked.
        """
        for one in self.closed(view, mode):
            if one.stop != released:
                self.systems[one].require_pressure(box)

    def is_plastic(self, view: CheckedView) -> bool:
        """Return True if the restitution of a stop is exactly zero, independently of the states."""
        system = self.systems[view]
        law = system.nodes["law"]
        varies = not set(system.z).isdisjoint(system.graph.needed(law))
        return not varies and system.value("law", system.nothing)[0].size == 0


def read_sides(count: int, sides: Any) -> tuple[bool, ...]:
    """Read the sides of the kinks in a certificate, and check their number.

    Args:
        count: Number of kinks.
        sides: The sides, 1 or 0 each.
    """
    given = cast("list[Any]", sides) if isinstance(sides, list) else [None]
    if len(given) != count or not all(type(x) is int and x in (0, 1) for x in given):
        raise InputError("The certificate's `sides` must be 0 or 1 for each kink.")
    return tuple(map(bool, given))


def bound_machine(
    data: Mapping[str, Any],
    problem: Problem,
    numbers: Mapping[str, Ball],
    over: Sequence[str],
) -> CertifiedMachine:
    """Return the systems of a certificate. The problem is evaluated once.

    Args:
        data: The certificate.
        problem: Its problem.
        numbers: All gains and parameters.
        over: Names of the parameters that vary.

    Raises:
        InputError: If the certificate belongs to other formulas.
        NotProved: If a hypothesis of the theorem is not shown.
    """
    row = data["gap_row"]
    if "machine" not in data:
        formulas = checked_formulas(problem)
        _require_digest(data, problem, formulas.digest)
        _require_row(row, formulas)
        system = bound_system(formulas, numbers, over, row)
        return CertifiedMachine(ONE_STOP, {ONE_STOP: system}, 1, 0, False, (("stop",), ()))
    further = ("held",) if "held" in data["machine"] else ()
    stop, own, *held = entries(data["machine"], "stop", "sides", *further)
    symbols = problem.symbols()
    graph = problem.model(symbols).graph
    if type(stop) is not int or not 0 <= stop < graph.n_watched:
        raise InputError("The certificate's `machine` must have a stop of the problem.")
    n_kinks, n_stops = len(graph.conditions), graph.n_watched
    if any(type(k) is not int or not 0 <= k < n_stops or k == stop for k in held):
        raise InputError("The certificate's `held` must be another stop of the problem.")
    start = CheckedView(stop, read_sides(n_kinks, own), *held)
    records = [record for part in data["passes"] for record in part["records"]]
    used = {read_sides(n_kinks, record["sides"]) for record in records if "sides" in record}
    used.add(start.sides)
    require(len(used) <= _MOST_SIDES, "the kinks have too many sides")
    if row is not None and n_stops > 1:
        raise InputError("The certificate's `gap_row` must be null for several stops.")
    views = [CheckedView(k, sides) for sides in sorted(used) for k in range(n_stops)]
    formulas = {view: formulas_of_view(graph, symbols, view) for view in views}
    _require_digest(data, problem, joined_digest(one.digest for one in formulas.values()))
    _require_row(row, formulas[start._replace(held=-1)])
    _require_ordered({view.sides: formulas[view] for view in views if view.stop == 0})

    def made(view: CheckedView) -> System:
        own, beside = view._replace(held=-1), view._replace(stop=view.held, held=-1)
        system = bound_system(formulas[own], numbers, over, row, view, formulas.get(beside))
        _require_free_resets(system)
        return system

    systems = _Systems(made)
    for view in [*views, start]:
        # Each hypothesis is checked, also of a stop that is never met.
        _ = systems[view]
    n_switches = len(graph.switches) + n_kinks
    names = tuple(one.name for one in watched(graph.stops)), graph.switch_names
    return CertifiedMachine(start, systems, n_stops, n_switches, True, names)


def _require_digest(data: Mapping[str, Any], problem: Problem, digest: str) -> None:
    if data["digest"] != digest:
        raise InputError(
            f"The certificate belongs to other formulas than those of the problem `{problem.name}`."
        )


def _require_row(row: Any, formulas: Formulas) -> None:
    if row is not None and (type(row) is not int or not 0 <= row < formulas.n_q):
        raise InputError("The certificate's `gap_row` must be a coordinate.")


def _require_ordered(sides: Mapping[tuple[bool, ...], Formulas]) -> None:
    """Check that the condition of each kink depends on the sides of earlier kinks alone.

    Then a state has one consistent choice of sides, unless a condition is zero, and the condition
    of a kink that is crossed is zero on both sides. Guards of declared switches depend on no side.
    """
    graph, one = Graph(), next(iter(sides.values())).function
    x = [graph.put("input") for _ in range(one.numel_in(0))]
    p = [graph.put("input") for _ in range(one.numel_in(1))]
    guards = dict[tuple[bool, ...], list[int]]()
    for key, formulas in sides.items():
        outputs = walked(formulas.function, graph, [x, p])
        guards[key] = outputs[7] if len(outputs) > 7 else []
    known = dict[tuple[int, tuple[bool, ...]], int]()
    for key, nodes in guards.items():
        declared = len(nodes) - len(key)
        for k, node in enumerate(nodes):
            first = known.setdefault((k, key[: max(0, k - declared)]), node)
            same = first == node or are_equal(graph, [first], [node])
            require(same, "the condition of a kink depends on its own or a later side")


def _require_free_resets(system: System) -> None:
    """Check that resets change no state on which constraints depend."""
    x = system.z[: system.n_x]
    needed = set(system.graph.needed(system.nodes["constraints"]))
    for changed in system.changed:
        free = not any(x[place] in needed for place in changed)
        require(free, "a switch resets a state on which a constraint depends")


def require_reset(system: System, box: Array, switch: int, mode: str) -> None:
    """Check that all gaps are positive after a reset that moves them, except that of a closed stop.

    Args:
        system: The system on the sides after it.
        box: Box of the states after it.
        switch: The switch.
        mode: Mode after it: `free`, `locked`, `opened` for a stop that opens at once, or `thrown`
            for a stop that is left with a speed.
    """
    if mode == "thrown":
        rate = system.gap_rate(box)
        require(rate.low > 0, f"the gap rate after a reset may be {rate.shown()}")
    if switch >= system.n_declared or not system.moves[switch]:
        return
    for k in system.open_rows:
        held = k == system.gap_row and mode != "free"
        require(held or box[k].low > 0, f"a gap may be closed after a reset: {box[k].shown()}")


def require_first(machine: CertifiedMachine, box: Array, switch: int, mode: str) -> None:
    """Check that all states of a section are just before its switch, in its mode and on its sides.

    The guard of the switch falls, and it is armed. All gaps are positive, except those of closed
    stops, which are under pressure. No other guard is zero, and the kinks are on their sides.

    Args:
        machine: The systems of the certificate.
        box: Box of the states.
        switch: The switch.
        mode: The mode.
    """
    system = machine.first
    rate = system.value(f"guards_{mode}", box)[switch] * system.signs[switch]
    require(rate.high < 0, f"the guard of the section may not fall: its rate is {rate.shown()}")
    if switch < system.n_declared:
        armed = system.value("armed", box)[switch]
        require(armed.low > 0, f"the switch of the section may not be armed: {armed.shown()}")
    system.require_defined(box)
    held = {system.gap_row} if mode == "locked" else set[int]()
    for k in {system.gap_row, *system.open_rows} - held:
        gap = system.gap(box) if k == system.gap_row else box[k]
        require(gap.low > 0, f"a gap may be closed before the switch: {gap.shown()}")
    for one in machine.closed(machine.start, mode):
        pull = machine.systems[one].value("acceleration", box)[0]
        require(pull.high < 0, "the stop may not be under pressure before the switch")
    require_sides(system, box, switch)


def require_sides(system: System, box: Array, crossed: int = -1) -> None:
    """Check that no guard is zero just after an event, and that the kinks are on their sides.

    Args:
        system: The system on the sides after the event.
        box: Box of the states.
        crossed: The switch that was crossed, whose guard is zero, or -1.
    """
    for k, (sign, value) in enumerate(zip(system.signs, system.value("guards", box), strict=True)):
        guard = value * sign
        sound = guard.low > 0 or (k < system.n_declared and guard.high < 0)
        require(k == crossed or sound, f"switch {k} may be zero: {guard.shown()}")


def require_known_switches(
    system: System,
    mode: str,
    boxes: tuple[Array, Array, Array],
    *,
    crossed: int,
    met: int,
) -> None:
    """Check that a step meets no switch, except the switch that ends it.

    A guard keeps its side if it differs from zero on the whole step, if it moves away from zero, or
    if it moves towards zero and has not reached it at the end. A declared switch is an event only
    where its guard falls through zero and it is armed.

    Args:
        system: The system of the certificate.
        mode: The mode.
        boxes: Boxes of the states at the start, on the whole step and at the end.
        crossed: The switch that was crossed at the start, or -1.
        met: The switch that ends the step, or -1.
    """
    if not system.signs:
        return
    first, box, last = (
        [value * sign for sign, value in zip(system.signs, system.value("guards", z), strict=True)]
        for z in boxes
    )
    armed, rates = (system.value(name, boxes[1]) for name in ("armed", f"guards_{mode}"))
    for k, sign in enumerate(system.signs):
        rate, declared, recent = rates[k] * sign, k < system.n_declared, k == crossed
        falls, rises = rate.high < 0, rate.low > 0
        if k == met:
            ready = first[k].low > 0 and (not declared or armed[k].low > 0)
            require(falls and ready, f"switch {k} may be met twice: its rate is {rate.shown()}")
            continue
        above = first[k].low > 0 if not recent else not declared
        holds = box[k].low > 0 or (rises and above) or (falls and last[k].low > 0)
        if declared and not holds:
            below = recent or first[k].high < 0
            holds = rises or box[k].high < 0 or armed[k].high < 0 or (falls and below)
        if not holds:
            raise NotProved(f"switch {k} may be met: its guard is {box[k].shown()}")


def require_others_apart(
    system: System, mode: str, boxes: tuple[Array, Array, Array], besides: Sequence[int]
) -> None:
    """Check that the gaps of other stops stay positive on a step.

    Args:
        system: The system of the certificate.
        mode: The mode.
        boxes: Boxes of the states at the start, on the whole step and at the end.
        besides: Rows of the gaps that are checked otherwise.
    """
    start, box, end = boxes
    rows = [k for k in system.open_rows if k not in besides]
    rates = system.rates(mode, box) if rows else box
    for k in rows:
        gap, rate, pull = box[k], box[k + 1], rates[k + 1]
        first, last = start[k].low > 0, end[k].low > 0
        apart = gap.low > 0 or (rate.high < 0 and last) or (rate.low > 0 and first)
        apart = apart or (first and last and pull.high < 0)
        require(apart, f"another gap may close: it is {gap.shown()}")
