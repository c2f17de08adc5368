r"""Largest pushes: impulses on an orbit after which the motion still returns to it.

An impulse of size :math:`j` acts along the generalized force :math:`r` at one instant:

.. math:: v^+ = v^- + W r\, j

with :math:`W` the inverse mass on the holonomic constraints. An impulse away from a closed stop
opens it. Towards the stop, the impulse of the stop keeps the gap rate at zero (theory (1.7) with a
plastic impact at zero speed). The impulses :math:`\Lambda` of all closed stops :math:`S` solve

.. math:: \Lambda \ge 0,\qquad J_S v^+ \ge 0,\qquad \Lambda \perp J_S v^+,
    \qquad v^+ = v^- + W r\, j + W J_S^\top \Lambda

Currents and other states do not change. The smallest impulse with a loss along a ray is located by
`zeno_orbits.maps.rays`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, combinations
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError, any_number, shown
from zeno_orbits.maps.attractors import ORBITS
from zeno_orbits.maps.classify import (
    approach_from,
    attractors_at,
    known_orbits,
    usual_time,
)
from zeno_orbits.maps.known import KnownOrbit, returns_to
from zeno_orbits.maps.plane import OF_BASINS
from zeno_orbits.maps.rays import UNPUSHED, Loss, Ray, RayTrial
from zeno_orbits.model import (
    GraphDynamics,
    ParameterValues,
    Problem,
    ProblemFile,
    unknown,
)
from zeno_orbits.orbits import Orbit, orbit_event_name
from zeno_orbits.simulation import Mode, simulate, simulator_in_use, state_after
from zeno_orbits.work import (
    Columns,
    ExecutionPlan,
    FailedPoint,
    Progress,
    TableRepr,
    Workers,
    parallel_map,
    report_part,
    require_kinds,
    silent,
    versions,
)

_SAME_PERIOD = 1e-6
"""Largest relative difference between the period of an orbit and of the motion from its start."""
_HUGE = 1e100
"""Largest entry of a generalized force, whose square is still a double."""
_TOUCHES = 1e-9
"""Gap and gap rate that count as zero, in units of the problem's own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PushSettings:
    """Settings of a search for the largest pushes.

    Attributes:
        phases: Number of equidistant phases of the period.
        steps: Number of impulses along a ray of the scan.
        reach: Largest impulse, in units of the impulse that gives a resting mechanism the largest
            kinetic energy of the orbit.
        error: Largest relative error of a located impulse.
        until: Longest simulated time of a motion [s], or ``None`` for the usual time of a map.
    """

    phases: int = 12
    steps: int = 96
    reach: float = 2.0
    error: float = 1e-3
    until: float | None = None

    def __post_init__(self) -> None:
        """Reject values that are not valid.

        Raises:
            InputError: If a value is not valid. The message names the field.
        """
        require_kinds(self)
        for name in ("phases", "steps"):
            count: object = getattr(self, name)
            if type(count) is not int or not 1 <= count <= 100_000:
                wanted = "must be a whole number from 1 to 100000"
                raise InputError(f"Argument `{name}` {wanted}, but it is {shown(count)}.")
        for name in ("reach", "error", "until"):
            value: object = getattr(self, name)
            if name == "until" and value is None:
                continue
            if not 0.0 < any_number(name, value) < math.inf:
                raise InputError(f"Argument `{name}` must be positive, but it is {shown(value)}.")
        if not 1e-12 <= self.error < 1.0:
            wanted = "must lie in [1e-12, 1)"
            raise InputError(f"Argument `error` {wanted}, but it is {self.error:g}.")


@dataclass(frozen=True, slots=True, kw_only=True)
class Push:
    """The largest push in one sense of a direction, at one phase of an orbit.

    Attributes:
        phase: Part of the period since the start of the orbit, in [0, 1).
        direction: Coordinate to entry of the generalized force, with the sense of the push.
        mode: Mode of the orbit at the phase, ``free`` or ``locked``.
        largest: Largest impulse below which every scanned motion returns. NaN without a loss.
        error: Difference between the smallest impulse with a loss and the largest impulse with a
            return.
        beyond: Motion after the smallest impulse with a loss, as text.
        searched: End of the scan.
        unit: Unit of the impulses.
    """

    phase: float
    direction: Mapping[str, float]
    mode: str
    largest: float
    error: float
    beyond: str
    searched: float
    unit: str

    @property
    def name(self) -> str:
        """The direction as text, such as ``+theta1``."""
        parts = [(name, entry) for name, entry in self.direction.items() if entry]
        if len(parts) == 1 and abs(parts[0][1]) == 1.0:
            return f"{'+' if parts[0][1] > 0 else '-'}{parts[0][0]}"
        return " ".join(f"{entry:+g}*{name}" for name, entry in parts)

    @property
    def is_positive(self) -> bool:
        """True if the first entry of the direction is positive."""
        return next(entry for entry in self.direction.values() if entry) > 0.0

    def as_json(self) -> dict[str, Any]:
        """Return the push as plain data. Without a loss, ``largest`` and ``error`` are null."""
        lost = math.isfinite(self.largest)
        return {
            "phase": self.phase,
            "direction": dict(self.direction),
            "mode": self.mode,
            "largest": self.largest if lost else None,
            "error": self.error if lost else None,
            "beyond": self.beyond,
            "searched": self.searched,
            "unit": self.unit,
        }


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Pushes(TableRepr):
    """The largest pushes of an orbit over its phases.

    Attributes:
        problem: Name of the problem.
        gains: Gains of the orbit.
        parameters: Parameters of the orbit.
        period: Period of the orbit [s].
        spectral_radius: Spectral radius of the return map.
        settings: Settings of the search.
        until: Longest simulated time of a motion [s].
        pushes: One push for each phase, direction and sense.
        versions: Program name to version, for the programs that computed the pushes.
    """

    problem: str
    gains: Mapping[str, float]
    parameters: Mapping[str, float]
    period: float
    spectral_radius: float
    settings: PushSettings
    until: float
    pushes: tuple[Push, ...]
    versions: Mapping[str, str]

    def __repr__(self) -> str:
        """Return one line: the problem, the number of pushes, and the smallest push."""
        least = self.least
        said = "none lost" if least is None else f"least {least.largest:.6g} {least.unit}"
        return f"<Pushes of {self.problem}: {len(self.pushes)} rays, {said}>"

    @property
    def least(self) -> Push | None:
        """The smallest of the largest pushes, or ``None`` without a loss."""
        lost = [push for push in self.pushes if math.isfinite(push.largest)]
        return min(lost, key=lambda push: push.largest, default=None)

    def _columns(self) -> Columns:
        """Return one row for each push."""
        return {
            "phase": [push.phase for push in self.pushes],
            "direction": [push.name for push in self.pushes],
            "mode": [push.mode for push in self.pushes],
            "largest": [push.largest for push in self.pushes],
            "error": [push.error for push in self.pushes],
            "unit": [push.unit for push in self.pushes],
            "beyond": [push.beyond for push in self.pushes],
        }

    def as_json(self) -> dict[str, Any]:
        """Return the pushes as plain data."""
        least = self.least
        return {
            "problem": self.problem,
            "gains": dict(self.gains),
            "parameters": dict(self.parameters),
            "period": self.period,
            "spectral_radius": self.spectral_radius,
            "phases": self.settings.phases,
            "steps": self.settings.steps,
            "reach": self.settings.reach,
            "error": self.settings.error,
            "until": self.until,
            "pushes": [push.as_json() for push in self.pushes],
            "least": None if least is None else least.as_json(),
            "versions": dict(self.versions),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class _Moment:
    """The orbit at one phase.

    Attributes:
        phase: Part of the period.
        state: State, ``(n_x,)``.
        closed: Indices of the stops at zero gap and gap rate.
        mobility: Inverse mass on the constraints, ``(n_q, n_q)``.
        largest_energy: Largest kinetic energy of the whole orbit [J].
    """

    phase: float
    state: tuple[float, ...]
    closed: tuple[int, ...]
    mobility: Vector
    largest_energy: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rays:
    """The task of a worker: the largest push along each of some rays."""

    source: Problem | ProblemFile
    gains: Mapping[str, float]
    parameters: Mapping[str, float]
    orbit: KnownOrbit
    until: float
    steps: int
    error: float

    def __call__(self, rays: Sequence[Any]) -> list[dict[str, Any]]:
        """Return the largest impulse, its error and the motion beyond per ray, as plain data."""
        problem = self.source.load() if isinstance(self.source, ProblemFile) else self.source
        values = problem.values(gains=self.gains, parameters=self.parameters)
        tried = _trials(problem, values, self.orbit, self.until)
        found: list[dict[str, Any]] = []
        for ray in rays:
            along = Ray(tried=partial(tried, ray), period=self.orbit.period, error=self.error)
            found.append(_as_found(along.first_loss(ray["reach"], self.steps)))
            report_part(len(found) / len(rays))
        return found


def _trials(
    problem: Problem, values: ParameterValues, orbit: KnownOrbit, until: float
) -> Callable[[Mapping[str, Any], float], RayTrial]:
    """Return the function of a ray and an impulse that simulates the motion after the impulse."""
    graph = problem.graph_dynamics(values)

    def tried(ray: Mapping[str, Any], impulse: float) -> RayTrial:
        state, change = np.array(ray["state"]), np.array(ray["change"])
        after = pushed(graph, state, change * impulse, ray["closed"])
        reached, way = approach_from(
            problem, graph, after, until=until, accuracy=OF_BASINS, known=(orbit,)
        )
        if not returns_to(orbit, reached, problem.state_names):
            return RayTrial(impulse=impulse, beyond=reached, delay=math.inf)
        delay = 0.0 if way is None else way.times[way.captured]
        return RayTrial(impulse=impulse, beyond=None, delay=delay)

    return tried


def _as_found(loss: Loss | None) -> dict[str, Any]:
    """Return the largest impulse, its error and the motion beyond, as plain data."""
    if loss is None:
        return {"largest": None, "error": None, "beyond": ""}
    beyond = loss.beyond
    words = f"another {beyond.phrase}" if beyond.fate in ORBITS else beyond.phrase
    return {"largest": loss.kept, "error": loss.gone - loss.kept, "beyond": words}


def pushed(graph: GraphDynamics, state: Vector, change: Vector, closed: Sequence[int]) -> Vector:
    """Return the state after an impulse, ``(n_x,)``.

    Args:
        graph: The graph of modes.
        state: State before the impulse, ``(n_x,)``.
        change: Change of the velocities without a stop, ``(n_q,)``.
        closed: Indices of the stops at zero gap and gap rate.
    """
    after = state.copy()
    views = [graph.open_views[k] for k in closed]
    matrix = graph.delassus(state)[np.ix_(closed, closed)]
    speeds = slice(graph.n_q, 2 * graph.n_q)
    after[speeds] += change
    impulses = stop_impulses(matrix, np.array([view.gap_rate(after) for view in views]))
    # A unit impulse of a stop changes its own gap rate by J W J'.
    for view, own in zip(views, impulses * np.diag(matrix), strict=True):
        after[speeds] += own * view.impulse_direction(state)[speeds]
    return after


def stop_impulses(matrix: Vector, rates: Vector) -> Vector:
    r"""Return the impulses of stops that keep their gap rates at zero or above, ``(n,)``.

    .. math:: \Lambda \ge 0,\qquad \dot h + G \Lambda \ge 0,
        \qquad \Lambda \perp \dot h + G \Lambda

    `G` is positive definite, so there is one solution. It is found by enumeration.

    Args:
        matrix: Delassus matrix `G` of the stops, ``(n, n)``.
        rates: Gap rates without the impulses, ``(n,)``.
    """
    n, best, least = len(rates), np.zeros(len(rates)), math.inf
    for held in chain.from_iterable(combinations(range(n), size) for size in range(n + 1)):
        rows = list(held)
        impulses = np.zeros(n)
        impulses[rows] = np.linalg.solve(matrix[np.ix_(rows, rows)], -rates[rows])
        left = rates + matrix @ impulses
        left[rows] = np.diag(matrix)[rows] * impulses[rows]
        # By rounding, no set may satisfy all conditions: take the set that misses them least.
        missed = -float(np.min(left, initial=0.0))
        if missed < least:
            best, least = impulses, missed
    return best


def largest_pushes(
    source: Problem | ProblemFile,
    orbit: Orbit,
    *,
    directions: Sequence[Mapping[str, float]] = (),
    settings: PushSettings | None = None,
    plan: ExecutionPlan | None = None,
    on_progress: Progress = silent,
) -> Pushes:
    """Compute the largest pushes of an orbit, at equidistant phases, in both senses.

    Args:
        source: The problem of the orbit, or its file if other processes have to load it.
        orbit: The orbit.
        directions: Coordinate to entry of the generalized force of each direction. The default is
            one unit along each movable coordinate.
        settings: Settings of the search.
        plan: Executor of the work and folder of finished parts. The default is this process.
        on_progress: Called with the stage and its finished part.

    Raises:
        InputError: If a direction is unknown, of zero length, or moves nothing, or the orbit is
            unstable.
        SimulationError: If the problem does not follow the orbit.
    """
    settings = settings or PushSettings()
    problem = source.load() if isinstance(source, ProblemFile) else source
    values = orbit.values(problem)
    known, until, asked = _prepared(problem, values, orbit, directions, settings)
    task = _Rays(
        source=source,
        gains=dict(orbit.gains),
        parameters=dict(orbit.parameters),
        orbit=known,
        until=until,
        steps=settings.steps,
        error=settings.error,
    )
    found = _computed(task, [ray for _, ray in asked], plan, problem, on_progress)
    pushes = [
        replace(push, largest=one["largest"], error=one["error"], beyond=one["beyond"])
        if one["beyond"]
        else push
        for (push, _), one in zip(asked, found, strict=True)
    ]
    return Pushes(
        problem=problem.name,
        gains=dict(orbit.gains),
        parameters=dict(orbit.parameters),
        period=orbit.period,
        spectral_radius=known.rate,
        settings=settings,
        until=until,
        pushes=tuple(pushes),
        versions=versions(),
    )


def least_push(
    problem: Problem,
    orbit: Orbit,
    *,
    directions: Sequence[Mapping[str, float]] = (),
    settings: PushSettings | None = None,
) -> Push:
    """Compute the smallest of the largest pushes of an orbit.

    The impulses of all rays are tested in increasing order. After a loss the other rays are tested
    up to the smallest impulse with a loss only.

    Args:
        problem: The problem of the orbit.
        orbit: The orbit.
        directions: As in `largest_pushes`. They must have the same unit.
        settings: Settings of the search.

    Returns:
        The smallest push. Without a loss, the push whose scan ends first.

    Raises:
        InputError: If `largest_pushes` would raise it.
        SimulationError: If the problem does not follow the orbit.
    """
    settings = settings or PushSettings()
    values = orbit.values(problem)
    known, until, asked = _prepared(problem, values, orbit, directions, settings)
    trial_of = _trials(problem, values, known, until)
    kept = [UNPUSHED] * len(asked)
    least: Push | None = None
    parts = [k / settings.steps for k in range(1, settings.steps + 1)]
    scan = [(part * push.searched, n) for n, (push, _) in enumerate(asked) for part in parts]
    for impulse, n in sorted(scan):
        tried = impulse if least is None else min(impulse, least.largest)
        push, ray = asked[n]
        if tried <= kept[n].impulse:
            continue
        trial = trial_of(ray, tried)
        if trial.beyond is None:
            kept[n] = trial
            continue
        along = Ray(tried=partial(trial_of, ray), period=known.period, error=settings.error)
        least = replace(push, **_as_found(along.located([kept[n]], trial)))
        kept[n] = replace(trial, impulse=math.inf)
    return least or min((push for push, _ in asked), key=lambda push: push.searched)


def push_units(
    problem: Problem, direction: Mapping[str, float], argument: str = "direction"
) -> set[str]:
    """Return the units of the impulses along a direction, or along each coordinate without one.

    Args:
        problem: The problem.
        direction: Coordinate to entry of the generalized force. Empty for each coordinate.
        argument: Name of the argument in messages.

    Raises:
        InputError: If a coordinate is unknown, or the force is zero or infinite.
    """
    names = problem.state_names[: problem.compiled_graph().n_q]
    if not direction:
        return {unit_of_push(problem, {name: 1.0}) for name in names}
    _require_direction(direction, names, argument)
    return {unit_of_push(problem, direction)}


def _require_direction(
    direction: Mapping[str, float], names: tuple[str, ...], argument: str
) -> None:
    """Refuse unknown coordinates, no length, and a length whose square is not a double."""
    for name in direction:
        if name not in names:
            raise InputError(unknown(argument, name, names))
    entries = [abs(any_number(argument, entry)) for entry in direction.values()]
    largest = max(entries, default=0.0)
    if not all(map(math.isfinite, entries)) or largest == 0.0:
        wanted = "must have one finite component that is not zero"
        raise InputError(f"Argument `{argument}` {wanted}, but it is {dict(direction)}.")
    if not 1.0 / _HUGE <= largest <= _HUGE:
        wanted = f"must have a largest entry from {1.0 / _HUGE:g} to {_HUGE:g}"
        raise InputError(f"Argument `{argument}` {wanted}, but it is {dict(direction)}.")


def _prepared(
    problem: Problem,
    values: ParameterValues,
    orbit: Orbit,
    directions: Sequence[Mapping[str, float]],
    settings: PushSettings,
) -> tuple[KnownOrbit, float, list[tuple[Push, dict[str, Any]]]]:
    """Return the known orbit, the time limit of a motion, and the rays."""
    known = _attracting(problem, values, orbit, settings.until)
    moments = _moments(problem, values, orbit, settings.phases)
    until = settings.until
    if until is None:
        until = usual_time(problem, [values], np.array(moments[0].state))
    return known, until, _rays_from(problem, moments, directions, settings.reach)


def _rays_from(
    problem: Problem,
    moments: Sequence[_Moment],
    directions: Sequence[Mapping[str, float]],
    reach: float,
) -> list[tuple[Push, dict[str, Any]]]:
    """Return the pushes without results, each with the plain data of its ray."""
    energy = max(moment.largest_energy for moment in moments)
    rays: list[tuple[Push, dict[str, Any]]] = []
    for direction in directions or _each_coordinate(problem, moments):
        force, unit = _force(problem, direction, moments)
        for moment in moments:
            change = moment.mobility @ force
            end = reach * math.sqrt(2.0 * energy / float(force @ change))
            for sense in (1.0, -1.0):
                push = Push(
                    phase=moment.phase,
                    direction={name: sense * entry for name, entry in direction.items()},
                    mode=(Mode.LOCKED if moment.closed else Mode.FREE).value,
                    largest=math.nan,
                    error=math.nan,
                    beyond="",
                    searched=end,
                    unit=unit,
                )
                ray = {
                    "state": list(moment.state),
                    "closed": list(moment.closed),
                    "change": (sense * change).tolist(),
                    "reach": end,
                }
                rays.append((push, ray))
    return rays


def _computed(
    task: _Rays,
    rays: Sequence[Mapping[str, Any]],
    plan: ExecutionPlan | None,
    problem: Problem,
    on_progress: Progress,
) -> list[Any]:
    """Return the results of the rays, computed in this process or by workers.

    Raises:
        SimulationError: If a ray crashes its worker.
    """
    if plan is None or not isinstance(task.source, ProblemFile):
        if plan is not None and (plan.place != Workers(count=1) or plan.checkpoint is not None):
            wanted = "must be a name or a file where workers or a checkpoint are used"
            raise InputError(f"Argument `problem` {wanted}, but it is an object.")
        results = list[Any]()
        for ray in rays:
            results += task([ray])
            on_progress(f"{len(results)} of {len(rays)} pushes", len(results) / len(rays))
        return results
    identity = {
        "work": "push",
        "problem": problem.name,
        "problem_digest": task.source.digest,
        "gains": dict(task.gains),
        "parameters": dict(task.parameters),
        "until": task.until,
        "steps": task.steps,
        "error": task.error,
        "simulator": simulator_in_use(),
        "versions": versions(),
        **plan.identity,
    }
    shared = ExecutionPlan(
        place=plan.place, chunk=1, checkpoint=plan.checkpoint, identity=identity, noun="pushes"
    )
    found = list(parallel_map(task, rays, shared, on_progress=on_progress))
    for one in found:
        if isinstance(one, FailedPoint):
            raise SimulationError(one.reason, state=(), time=math.nan)
    return found


def _attracting(
    problem: Problem, values: ParameterValues, orbit: Orbit, until: float | None
) -> KnownOrbit:
    """Return the orbit as a known orbit for comparison with motions.

    Raises:
        InputError: If the motion from its start leaves the orbit, or the orbit is not stable.
    """
    start = _start_on(problem, values, orbit)
    (reached,) = attractors_at(problem, [values], start=start, until=until, accuracy=OF_BASINS)
    same = reached.fate in ORBITS and math.isclose(
        reached.period, orbit.period, rel_tol=_SAME_PERIOD
    )
    if not same:
        said = f"the motion that starts on it ends in: {reached.phrase}"
        raise InputError(f"Argument `orbit` must be stable, but {said}.")
    known = known_orbits(problem, values, [reached], OF_BASINS)
    if not known:
        said = f"its spectral radius is {reached.spectral_radius:.6g}"
        raise InputError(f"Argument `orbit` must be stable, but {said}.")
    # An unstable orbit may leave the motion on another orbit of the same period.
    if not _meets(problem, values, known[0], orbit):
        said = "the motion that starts on it ends on another orbit"
        raise InputError(f"Argument `orbit` must be stable, but {said}.")
    return known[0]


def _start_on(problem: Problem, values: ParameterValues, orbit: Orbit) -> Mapping[str, float]:
    """Return a state of an orbit, in the middle of its first arc if it starts at a switch."""
    if not orbit.past_switch:
        return orbit.start_state
    start = np.array(problem.state_vector(orbit.start_state))
    graph = problem.graph_dynamics(values)
    motion = simulate(graph, start, until=orbit.period, past=orbit.past_switch)
    first = motion.arcs[0]
    middle = motion.state_at((first.start_time + first.end_time) / 2)
    return dict(zip(problem.state_names, np.asarray(middle).tolist(), strict=True))


def _meets(problem: Problem, values: ParameterValues, known: KnownOrbit, orbit: Orbit) -> bool:
    """Return True if the start of an orbit is a state of a known orbit."""
    start = np.array(problem.state_vector(orbit.start_state))
    # Its period may start at another event.
    graph, past = problem.graph_dynamics(values), orbit.past_switch
    turned = simulate(graph, start, until=1.5 * orbit.period, past=past)
    return any(
        known.passes(np.asarray(state_after(event)))
        for event in turned.events
        if orbit_event_name(event) == known.section
    )


def _touched(graph: GraphDynamics, state: Vector) -> tuple[int, ...]:
    """Return the indices of the stops at zero gap and gap rate."""
    return tuple(
        k
        for k, view in enumerate(graph.open_views)
        if abs(view.gap(state)) <= _TOUCHES * view.own.gap
        and abs(view.gap_rate(state)) <= _TOUCHES * view.own.gap_rate
    )


def _moments(problem: Problem, values: ParameterValues, orbit: Orbit, phases: int) -> list[_Moment]:
    """Return the orbit at equidistant phases."""
    graph = problem.graph_dynamics(values)
    start = np.array(problem.state_vector(orbit.start_state))
    motion = simulate(graph, start, until=orbit.period, past=orbit.past_switch)
    times = [k / phases * orbit.period for k in range(phases)]
    states = motion.states_at(np.array(times))
    mobilities, _ = problem.inverse_masses(values, states)
    _, energies = problem.inverse_masses(values, motion.sampled(40)[1])
    return [
        _Moment(
            phase=k / phases,
            state=tuple(states[k].tolist()),
            closed=_touched(graph, states[k]),
            mobility=mobilities[k],
            largest_energy=float(np.max(energies)),
        )
        for k in range(phases)
    ]


def _each_coordinate(problem: Problem, moments: Sequence[_Moment]) -> list[dict[str, float]]:
    """Return a unit force along each movable coordinate."""
    names = problem.state_names[: len(moments[0].mobility)]
    return [
        {name: 1.0}
        for k, name in enumerate(names)
        if all(one.mobility[k, k] > 0.0 for one in moments)
    ]


def _force(
    problem: Problem, direction: Mapping[str, float], moments: Sequence[_Moment]
) -> tuple[Vector, str]:
    """Return a generalized force ``(n_q,)`` and the unit of its impulse.

    Raises:
        InputError: If a coordinate is unknown, or the force is zero or does not move the mechanism.
    """
    names = problem.state_names[: len(moments[0].mobility)]
    _require_direction(direction, names, "direction")
    force = np.array([float(direction.get(name, 0.0)) for name in names])
    if not all(float(force @ one.mobility @ force) > 0.0 for one in moments):
        wanted = "must move the mechanism at every phase"
        raise InputError(f"Argument `direction` {wanted}, but {dict(direction)} does not.")
    return force, unit_of_push(problem, direction)


def unit_of_push(problem: Problem, direction: Mapping[str, float]) -> str:
    """Return the unit of an impulse along a direction.

    Args:
        problem: The problem.
        direction: Coordinate to entry of the generalized force.
    """
    known = dict(zip(problem.state_names, problem.state_units, strict=True))
    units = {known[name] for name, entry in direction.items() if entry}
    return problem.impulse_unit(units.pop() if len(units) == 1 else "1")
