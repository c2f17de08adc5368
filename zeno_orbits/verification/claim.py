"""The claimed orbit: its data as vectors, in the order of the problem's states."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, finite_number
from zeno_orbits.model import GraphDynamics, HybridDynamics, Problem, load_reference
from zeno_orbits.orbits import Orbit, OrbitEvent

_OPENED = 1e-6
"""Gap and gap rate at which a stop has been opened, in the characteristic scales."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClaimedEvent:
    """An event of an orbit, as vectors.

    Attributes:
        name: Its name.
        time: Its time since the start of the period [s].
        state: State just before it, ``(n_x,)``.
        after: State just after it, ``(n_x,)``, if the orbit states it.
    """

    name: str
    time: float
    state: Vector
    after: Vector | None


@dataclass(frozen=True, slots=True, kw_only=True)
class StartContact:
    """A stop that the orbit touches at the start of its period.

    Attributes:
        stop: Its index.
        view: Its system, in which the other closed stops are constraints.
        rests: Whether its gap rate is zero, too.
        released: Whether its multiplier is zero, too.
    """

    stop: int
    view: HybridDynamics
    rests: bool
    released: bool

    def placed(self, x: Vector) -> Vector:
        """Return the state moved onto the stop, to rounding, ``(n_x,)``.

        Args:
            x: A state near it, ``(n_x,)``.
        """
        if self.rests:
            return self.view.on_stop(x)
        n_q, x = self.view.n_q, x.copy()
        x[:n_q] -= self.view.gap(x) * self.view.impulse_direction(x)[n_q : 2 * n_q]
        return x


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """An orbit, as vectors.

    Attributes:
        sequence: Its event sequence.
        section: Name of the event at which the period starts and ends.
        n_returns: Number of such events in a period.
        period: Period [s].
        start: State at the start of the period, ``(n_x,)``.
        events: Its events.
    """

    sequence: tuple[str, ...]
    section: str
    n_returns: int
    period: float
    start: Vector
    events: tuple[ClaimedEvent, ...]

    def count(self, kind: str) -> int:
        """Return the number of events of a kind.

        Args:
            kind: Name of the kind, such as ``impact``.
        """
        return sum(event.name.startswith(f"{kind} ") for event in self.events)

    @property
    def starts_at_release(self) -> bool:
        """True if the period starts where a multiplier falls through zero.

        The multiplier is not zero at a release that another event causes.
        """
        *earlier, last = self.events
        is_caused = any(event.time == last.time for event in earlier)
        return self.section.startswith("release ") and not is_caused

    def contacts(self, graph: GraphDynamics) -> list[StartContact]:
        """Return the stops that the orbit touches at the start of its period.

        A stop is closed if its last event is a Zeno point. The event of the section leaves another.

        Args:
            graph: The graph of modes.
        """
        last = {event.name.partition(" ")[2]: k for k, event in enumerate(self.events)}
        kind, _, left = self.section.partition(" ")
        closed = [
            k
            for k, name in enumerate(graph.stop_names)
            if name in last and self.events[last[name]].name == f"zeno {name}"
        ]
        sides = graph.sides_at(self.start, graph.open_mode[1])
        found: list[StartContact] = []
        for k, name in enumerate(graph.stop_names):
            leaves = name == left and kind in ("impact", "release")
            if not leaves and k not in closed:
                continue
            view = graph.view((tuple(j for j in closed if j != k), sides), k)
            # An impact or a switch may open other stops. Older files do not list such releases.
            later = self.events[last[name] + 1 :]
            jumps = any(one.name.startswith(("switch ", "impact ")) for one in later)
            opened = not leaves and jumps
            if opened and abs(view.gap(self.start)) > _OPENED * view.own.gap:
                continue
            opened = opened and abs(view.gap_rate(self.start)) > _OPENED * view.own.gap_rate
            released = leaves and self.starts_at_release
            plastic = kind == "impact" and view.restitution == 0.0
            rests = (released or plastic) if leaves else not opened
            found.append(StartContact(stop=k, view=view, rests=rests, released=released))
        return found


def claim_of(orbit: Orbit, problem: Problem) -> Claim:
    """Return an orbit's data as vectors.

    Raises:
        InputError: If the orbit belongs to another problem, its names differ from the problem's, a
            time is not finite, or a Zeno point lacks its impacts.
    """
    if orbit.problem != problem.name:
        message = (
            f"Argument `orbit` must be of problem `{problem.name}`, but it is of `{orbit.problem}`."
        )
        raise InputError(message)
    for name, values, known in (
        ("gains", orbit.gains, [gain.name for gain in problem.gains]),
        ("parameters", orbit.parameters, [quantity.name for quantity in problem.parameters]),
    ):
        _require_same(values, known, f"must have the {name} of its problem")
    if orbit.phases_as is not None:
        _ = orbit.phases  # Events that do not form them are refused.
    names = {event.name for event in orbit.events}
    for name in sorted(names):
        kind, _, stop = name.partition(" ")
        if kind == "zeno" and f"impact {stop}" not in names:
            raise InputError(f"Argument `orbit` lacks an impact on `{stop}` before its Zeno point.")

    def vector(named: Mapping[str, float], where: str) -> Vector:
        _require_same(named, problem.state_names, f"must have all states in `{where}`")
        return np.array(problem.state_vector(named))

    def event_of(event: OrbitEvent) -> ClaimedEvent:
        return ClaimedEvent(
            name=event.name,
            time=finite_number("time", event.time),
            state=vector(event.state, event.name),
            after=None if event.after is None else vector(event.after, event.name),
        )

    return Claim(
        section=orbit.section,
        sequence=orbit.sequence,
        n_returns=orbit.n_returns,
        period=finite_number("period", orbit.period),
        start=vector(orbit.start_state, "start_state"),
        events=tuple(map(event_of, orbit.events)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """An orbit to be verified, with its machines.

    Attributes:
        orbit: The orbit.
        problem: Its problem.
        claim: The orbit as vectors.
        graph: The machine to integrate.
        own: The machine of the problem, with its powers and energies.
        contacts: The stops that the orbit touches at the start of its period.
        start: Start of the integration: the claimed start moved onto its section, ``(n_x,)``.
    """

    orbit: Orbit
    problem: Problem
    claim: Claim
    graph: GraphDynamics
    own: GraphDynamics
    contacts: tuple[StartContact, ...]
    start: Vector

    @classmethod
    def of(
        cls,
        orbit: Orbit,
        problem: Problem,
        dynamics: HybridDynamics | GraphDynamics | None,
        *,
        use_reference: bool = False,
    ) -> Case:
        """Return an orbit with its machines.

        Args:
            orbit: The orbit.
            problem: Its problem.
            dynamics: The machine to integrate. The default is the problem's own.
            use_reference: True for the hand-written model of the problem as the default.

        Raises:
            InputError: If the orbit does not fit the problem.
        """
        claim, values = claim_of(orbit, problem), orbit.values(problem)
        own = problem.graph_dynamics(values)
        if dynamics is None and use_reference:
            dynamics = load_reference(problem).dynamics(values)
        graph = own if dynamics is None else dynamics.as_graph("".join(own.stop_names[:1]))
        if (graph.state_names, graph.stop_names) != (own.state_names, own.stop_names):
            wanted = f"must have the states and stops of problem `{problem.name}`"
            raise InputError(f"Argument `dynamics` {wanted}.")
        contacts, start = claim.contacts(graph), claim.start
        for contact in contacts:
            start = contact.placed(start)
        return cls(
            orbit=orbit,
            problem=problem,
            claim=claim,
            graph=graph,
            own=own,
            contacts=tuple(contacts),
            start=start,
        )


def claimed_start(
    orbit: Orbit, problem: Problem, dynamics: HybridDynamics | GraphDynamics
) -> Vector:
    """Return the start of an orbit, moved onto the stops that it touches there, ``(n_x,)``.

    Args:
        orbit: The orbit.
        problem: Its problem.
        dynamics: The machine at the parameter values of the orbit.

    Raises:
        InputError: If the orbit does not fit the problem.
    """
    return Case.of(orbit, problem, dynamics).start


def _require_same(names: Iterable[str], known: Iterable[str], wanted: str) -> None:
    given, right = set(names), set(known)
    faults = (
        (right - given, "it lacks {}: add the value"),
        (given - right, "it names {}: remove the name, or give the problem of the orbit"),
    )
    told = "; ".join(
        text.format(", ".join(f"`{name}`" for name in sorted(odd))) for odd, text in faults if odd
    )
    if told:
        raise InputError(f"Argument `orbit` {wanted}, but {told}.")
