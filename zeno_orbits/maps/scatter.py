r"""Scatter of an orbit whose restitution differs from impact to impact.

On the section of the orbit, with coordinates `y` around its state, a period is to first order

.. math:: y_{n+1} = A\,y_n + B\,\xi_n + N\,\zeta_{n+1},\qquad t_j = T_j + c_j\,y_n + d_j\,\xi_n

with independent standard normal :math:`\xi_n`, one per impact, and :math:`\zeta_n`, one per noisy
state. A column of `B` is the derivative of the end by the restitution of one impact, times its
standard deviation. The last resolved impact and all impacts after it act along one direction, and
their sum has the standard deviation :math:`2 \sigma w / (|\ddot h|\,(1 - e) \sqrt{1 - e^2})` in the
Zeno time, with the speed `w` after that impact. The covariance of `y` solves
:math:`P = A P A^\top + B B^\top + N N^\top`, and

.. math:: \operatorname{var} t_j = c_j P c_j^\top + d_j d_j^\top

Beside it stands a simulation of many periods (`scattered_motion`), without linearization. It also
counts how often the motion leaves the orbit.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues, spectral_radius
from zeno_orbits.errors import InputError, SimulationError, finite_number, not_known, shown
from zeno_orbits.integrators import Tolerance
from zeno_orbits.maps.scattered_motion import LostError, ScatteredMotion, lasting_times
from zeno_orbits.model import GraphDynamics, Problem
from zeno_orbits.orbits import (
    EventReturn,
    Orbit,
    event_chart,
    event_return,
    orbit_event_name,
    phases_of_events,
)
from zeno_orbits.simulation import (
    Impact,
    SaltationDerivative,
    SimulationSettings,
    SwitchEvent,
    ZenoPoint,
)
from zeno_orbits.work import Columns, Progress, TableRepr, require_kinds, silent, versions

_ACCURATE = SimulationSettings(tolerance=Tolerance(relative=1e-10, absolute=1e-11))
_FORGOTTEN, _LONGEST = 1e-2, 200
"""Part of its start that a motion remembers before it counts, and most periods until then."""
_ROUNDING = 1e-12
"""Part of the size of a state below which its deviation is rounding."""
_RESTITUTION = "restitution"


@dataclass(frozen=True, slots=True, kw_only=True)
class ScatterSettings:
    """Extent of the computation.

    Attributes:
        periods: Number of simulated periods.
        seed: Seed of the simulation.
    """

    periods: int = 1000
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse values without a meaning.

        Raises:
            InputError: If a field is invalid. The message names it.
        """
        require_kinds(self)
        if self.periods < 2:
            raise InputError(
                f"Argument `periods` must be at least 2, but it is {shown(self.periods)}."
            )
        if self.seed < 0:
            raise InputError(f"Argument `seed` must not be negative, but it is {self.seed}.")


@dataclass(frozen=True, slots=True, kw_only=True)
class ScatterRow:
    """Scatter of one quantity.

    Attributes:
        name: ``period``, the name of an event for its time since the start of the period, or the
            name of a state on the section.
        unit: Its unit.
        orbit: Its value on the orbit.
        linear: Standard deviation to first order.
        mean: Mean of the simulated periods.
        deviation: Their standard deviation.
        error: Standard error of the deviation.
        low: Their quantile of 5 %.
        high: Their quantile of 95 %.
    """

    name: str
    unit: str
    orbit: float
    linear: float
    mean: float
    deviation: float
    error: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Scatter(TableRepr):
    """Scatter of an orbit.

    Attributes:
        problem: Name of the problem.
        gains: Gains of the orbit.
        parameters: Parameters of the orbit.
        spread: What scatters, and by how much.
        period: Period of the orbit [s].
        spectral_radius: Spectral radius of the return map.
        rows: The period, the events and the states of the section.
        samples: Name of each row to its values in the simulated periods, ``(n,)``.
        simulated: Number of simulated periods, with those before a motion counts.
        lost: Number of motions that left the orbit.
        reasons: Reasons, with the number of motions.
        settings: Settings.
        versions: Program name to version, for the programs that computed the scatter.
    """

    problem: str
    gains: Mapping[str, float]
    parameters: Mapping[str, float]
    spread: Mapping[str, float]
    period: float
    spectral_radius: float
    rows: tuple[ScatterRow, ...]
    samples: Mapping[str, Vector] = field(repr=False)
    simulated: int
    lost: int
    reasons: Mapping[str, int]
    settings: ScatterSettings
    versions: Mapping[str, str]

    def __repr__(self) -> str:
        """Return one line: the scatter of the period and the number of lost motions."""
        own = self.row("period")
        return (
            f"<Scatter of {self.problem}: period={own.orbit:.6g} s +- {own.deviation:.3g} s, "
            f"periods={self.simulated}, lost={self.lost}>"
        )

    def row(self, name: str) -> ScatterRow:
        """Return the row of a quantity.

        Raises:
            InputError: If the name is unknown.
        """
        for one in self.rows:
            if one.name == name:
                return one
        names = tuple(one.name for one in self.rows)
        raise InputError(f"Argument `name`: {not_known(name, names, 'quantity')}")

    @property
    def periods_until_lost(self) -> float:
        """Mean number of periods until a motion leaves the orbit, infinite if none left it."""
        return self.simulated / self.lost if self.lost else math.inf

    @property
    def periods_until_lost_interval(self) -> tuple[float, float]:
        """Interval of that number with a confidence of 95 %, for losses without memory."""
        # The import takes a fifth of a second.
        from scipy.stats import chi2

        twice, k = 2 * self.simulated, self.lost
        low = twice / float(chi2.ppf(0.975 if k else 0.95, 2 * k + 2))
        return low, twice / float(chi2.ppf(0.025, 2 * k)) if k else math.inf

    def _columns(self) -> Columns:
        """Return the table of all rows."""
        names = ("name", "unit", "orbit", "linear", "mean", "deviation", "error", "low", "high")
        return {name: [getattr(one, name) for one in self.rows] for name in names}

    def as_json(self) -> dict[str, Any]:
        """Return the scatter as plain data. An unbounded number of periods is null."""
        low, high = self.periods_until_lost_interval
        return {
            "problem": self.problem,
            "gains": dict(self.gains),
            "parameters": dict(self.parameters),
            "spread": dict(self.spread),
            "period": self.period,
            "spectral_radius": self.spectral_radius,
            "rows": [{k: getattr(one, k) for k in self._columns()} for one in self.rows],
            "simulated": self.simulated,
            "lost": self.lost,
            "reasons": dict(self.reasons),
            "periods_until_lost": self.periods_until_lost if self.lost else None,
            "periods_until_lost_interval": [low, high if self.lost else None],
            "periods": self.settings.periods,
            "seed": self.settings.seed,
            "versions": dict(self.versions),
        }


def scatter_of(
    problem: Problem,
    orbit: Orbit,
    spread: Mapping[str, float],
    *,
    settings: ScatterSettings | None = None,
    on_progress: Progress = silent,
) -> Scatter:
    """Return the scatter of a stable orbit, to first order and simulated.

    Args:
        problem: The problem of the orbit.
        orbit: The orbit.
        spread: Name to standard deviation: ``restitution`` for every stop and ``STOP.restitution``
            for one, relative and drawn for every impact; the name of a state, absolute and added on
            the section in every period.
        settings: Settings.
        on_progress: Called with the stage and its finished part.

    Raises:
        InputError: If a name is unknown or a value invalid, or if the orbit is not closed or not
            stable.
    """
    settings = settings or ScatterSettings()
    graph = problem.graph_dynamics(orbit.values(problem))
    stops, noise = _spreads(graph, spread)
    model = _linear_model(problem, orbit, graph, stops, noise)
    covariance = model.covariance()
    samples, count, reasons = _simulated(model, settings, on_progress)
    return Scatter(
        problem=problem.name,
        gains=dict(orbit.gains),
        parameters=dict(orbit.parameters),
        spread=dict(spread),
        period=orbit.period,
        spectral_radius=model.radius,
        rows=tuple(_rows(model, covariance, samples, problem)),
        samples=samples,
        simulated=count,
        lost=sum(reasons.values()),
        reasons=reasons,
        settings=settings,
        versions=versions(),
    )


def _spreads(graph: GraphDynamics, spread: Mapping[str, float]) -> tuple[tuple[float, ...], Vector]:
    """Return the relative deviation of each restitution, and the deviation of each state.

    Raises:
        InputError: If a name is unknown, a value is invalid, or nothing scatters.
    """
    own = {f"{name}.{_RESTITUTION}": k for k, name in enumerate(graph.stop_names) if name}
    states = {name: k for k, name in enumerate(graph.state_names)}
    stops, noise = np.zeros(len(graph.stop_names)), np.zeros(len(states))
    known = (*((_RESTITUTION,) if len(stops) else ()), *own, *states)
    # The deviation of one stop replaces that of all stops.
    for name in sorted(spread, key=lambda one: one != _RESTITUTION):
        if not isinstance(cast("object", name), str):
            wanted = f"must have texts as names, but one is {shown(name)}"
            raise InputError(f"Argument `spread` {wanted}.")
        if name not in known:
            raise InputError(f"Argument `spread`: {not_known(name, known, 'name')}")
        value = finite_number(name, spread[name])
        if value < 0.0 or (name not in states and value >= 1.0):
            wanted = "must not be negative" if name in states else "must lie in [0, 1)"
            raise InputError(f"Argument `spread`: `{name}` {wanted}, but it is {shown(value)}.")
        if name == _RESTITUTION:
            stops[:] = value
        elif name in own:
            stops[own[name]] = value
        else:
            noise[states[name]] = value
    if not (np.any(stops) or np.any(noise)):
        raise InputError("Argument `spread` must have a positive value: nothing scatters.")
    return tuple(stops.tolist()), noise


@dataclass(frozen=True, slots=True, kw_only=True)
class _LinearModel:
    """A period to first order, with what the simulation needs.

    Attributes:
        orbit: The orbit.
        motion: The motion that scatters.
        chart: The chart of the section.
        noise: Deviation of every state on the section, ``(n_x,)``.
        times: Time of the last event of each phase [s].
        slope: `A`, ``(d, d)``.
        ends: `B`, ``(d, m)``.
        noises: `N`, ``(d, n_x)``.
        by_start: :math:`c_j`, ``(n_phases, d)``.
        by_impact: :math:`d_j`, ``(n_phases, m)``.
    """

    orbit: Orbit
    motion: ScatteredMotion
    chart: Any
    noise: Vector
    times: tuple[float, ...]
    slope: Vector
    ends: Vector
    noises: Vector
    by_start: Vector
    by_impact: Vector

    @property
    def radius(self) -> float:
        """Spectral radius of the return map."""
        return spectral_radius(eigenvalues(self.slope))

    def covariance(self) -> Vector:
        """Return the covariance of the section coordinates, ``(d, d)``."""
        if not len(self.slope):
            return np.zeros((0, 0))
        # The import takes a fifth of a second.
        from scipy.linalg import solve_discrete_lyapunov

        added = self.ends @ self.ends.T + self.noises @ self.noises.T
        return np.asarray(solve_discrete_lyapunov(self.slope, added), dtype=np.float64)


def _linear_model(
    problem: Problem,
    orbit: Orbit,
    graph: GraphDynamics,
    spreads: tuple[float, ...],
    noise: Vector,
) -> _LinearModel:
    """Return the period of an orbit to first order.

    Raises:
        InputError: If the orbit is not stable, or its motion has other events or no derivative.
    """
    x = np.array([orbit.start_state[name] for name in graph.state_names])
    try:
        chart = event_chart(graph, orbit, problem.state_units, _ACCURATE)
        found = event_return(
            graph,
            x,
            section=orbit.section,
            n_returns=orbit.n_returns,
            guess=orbit.period,
            settings=_ACCURATE,
            sequence=orbit.sequence,
        )
        columns = [_Column.of(found, *one) for one in _sources(graph, found, spreads)]
        shifts = found.shifts
    except SimulationError as error:
        reason = f"must be closed, but the motion from its start is another: {error}"
        raise InputError(f"Argument `orbit` {reason}") from error
    phases = phases_of_events([orbit_event_name(event) for event in found.events])
    last = [phase[-1] for phase in phases]
    section, n_x = chart.section, len(x)
    lift = chart.surface.reset_derivative(section.centre) @ section.lift
    model = _LinearModel(
        orbit=orbit,
        motion=ScatteredMotion(
            graph=graph,
            spreads=spreads,
            sequence=tuple(orbit.sequence),
            period=orbit.period,
            settings=_ACCURATE,
        ),
        chart=chart,
        noise=noise,
        times=tuple(found.events[k].time for k in last),
        slope=chart.slope,
        ends=_stacked([section.components(one.end) for one in columns], section.dimension),
        noises=section.components(np.diag(noise)),
        by_start=np.array([shifts[k].time[:n_x] @ lift for k in last]),
        by_impact=_stacked([np.array([one.times[k] for k in last]) for one in columns], len(last)),
    )
    if not model.radius < 1.0:
        reason = f"must be stable, but its spectral radius is {model.radius:.6g}"
        raise InputError(f"Argument `orbit` {reason}.")
    return model


def _stacked(columns: Sequence[Vector], height: int) -> Vector:
    """Return columns side by side, also of an empty list."""
    return np.array(columns).T if columns else np.zeros((height, 0))


def _sources(
    graph: GraphDynamics, found: EventReturn, spreads: Sequence[float]
) -> list[tuple[int, SaltationDerivative]]:
    """Return the index of every event that scatters, with the deviation just after it.

    The last resolved impact before a Zeno point acts there, with all impacts after it.
    """
    sources: list[tuple[int, SaltationDerivative]] = []
    for place, event in enumerate(found.events):
        if not isinstance(event, Impact | ZenoPoint):
            continue
        spread = spreads[graph.stop_names.index(event.stop)]
        if spread == 0.0:
            continue
        if isinstance(event, Impact):
            following = found.events[place + 1 : place + 2]
            if not any(isinstance(one, ZenoPoint) for one in following):
                sources.append((place, _of_impact(graph, found, event, spread)))
        elif event.tail > 0.0:
            sources.append((place, _of_tail(graph, found, event, spread)))
    return sources


def _shift(n_x: int, time: float, state: Vector, rate: float) -> SaltationDerivative:
    """Return a deviation as the first column of derivatives."""
    first = np.zeros(n_x)
    first[0] = 1.0
    return SaltationDerivative(time=time * first, state=np.outer(state, first), rate=rate * first)


def _of_impact(
    graph: GraphDynamics, found: EventReturn, impact: Impact, spread: float
) -> SaltationDerivative:
    """Return the deviation just after an impact whose restitution scatters."""
    k = graph.stop_names.index(impact.stop)
    before = next(arc for arc in found.execution.arcs if arc.end_time >= impact.time)
    closed, sides = before.mode_in(graph)
    view = graph.view((tuple(j for j in closed if j != k), sides), k)
    speed = -impact.approach_rate
    e = view.speed_after(impact.approach_rate) / speed
    jump = np.asarray(impact.state_plus) - np.asarray(impact.state_minus)
    deviation = spread * e
    return _shift(jump.size, 0.0, deviation * jump / (1 + e), deviation * speed)


def _of_tail(
    graph: GraphDynamics, found: EventReturn, zeno: ZenoPoint, spread: float
) -> SaltationDerivative:
    r"""Return the deviation of a Zeno point by its last resolved impact and all impacts after it.

    With the speed `w` after that impact the remaining time is :math:`(2 w / |\ddot h|)\,(1 + e_1 +
    e_1 e_2 + \dots)`, and `w` itself has the relative deviation of its restitution.
    """
    k = graph.stop_names.index(zeno.stop)
    after = next(arc for arc in found.execution.arcs if arc.start_time >= zeno.time)
    closed, sides = after.mode_in(graph)
    view = graph.view((tuple(j for j in closed if j != k), sides), k)
    e = view.restitution
    state = np.asarray(zeno.state)
    first = 2 * zeno.last_speed / -view.gap_acceleration(state)
    # The sum of the squares of all terms: of the last one, then a geometric series.
    later = spread * first / (1 - e) * math.sqrt(1 + e**2 / (1 - e**2))
    return _shift(state.size, later, view.locked.rate(state) * later, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Column:
    """The effect of one source on a period.

    Attributes:
        times: Change of the time of every event [s].
        end: Change of the state on the section at the end, ``(n_x,)``.
    """

    times: tuple[float, ...]
    end: Vector

    @classmethod
    def of(cls, found: EventReturn, place: int, shift: SaltationDerivative) -> _Column:
        """Return the effect of a deviation just after an event of a return."""
        events, arcs = found.events, found.execution.arcs
        times, last = [0.0] * len(events), len(events) - 1
        times[place] = float(shift.time[0])
        if place == last:
            return cls(times=tuple(times), end=shift.state[:, 0])
        first = max(k for k, arc in enumerate(arcs) if arc.start_time <= events[place].time)
        places = {id(event): k for k, event in enumerate(events)}
        for passage in found.differentiation.passages(found.execution, shift, first=first):
            for event, before, after in passage.crossings:
                k = places.get(id(event), -1)
                if k > place:
                    times[k] = float(after.time[0])
                if k == last:
                    end = before if isinstance(event, SwitchEvent) else after
                    return cls(times=tuple(times), end=end.state[:, 0])
        raise SimulationError(
            "The last event of a return lacks a derivative",
            time=found.period,
            state=tuple(found.start.tolist()),
        )


def _simulated(
    model: _LinearModel, settings: ScatterSettings, on_progress: Progress
) -> tuple[dict[str, Vector], int, dict[str, int]]:
    """Return the quantities of the simulated periods, their number, and the lost motions."""
    random, reasons = np.random.default_rng(settings.seed), Counter[str]()
    names = _row_names(model)
    radius = model.radius
    waits = 1 if radius <= _FORGOTTEN else math.ceil(math.log(_FORGOTTEN) / math.log(radius))
    waits = min(waits, _LONGEST, settings.periods // 2)
    rows: list[list[float]] = []
    on_section, since = model.chart.section.centre, 0
    for count in range(settings.periods):
        try:
            on_section = _with_noise(model, on_section, random)
            start = model.chart.surface.reset(on_section)
            passed = model.motion.followed(start, random)
            times = lasting_times(passed.names, passed.times, len(model.times))
        except LostError as error:
            reasons[str(error)] += 1
            on_section, since = model.chart.section.centre, 0
            continue
        if since >= waits:
            rows.append([times[-1], *times[:-1], *on_section.tolist()])
        on_section, since = passed.on_section, since + 1
        on_progress("simulating periods", (count + 1) / settings.periods)
    table = np.array(rows).reshape(-1, len(names))
    return dict(zip(names, table.T, strict=True)), settings.periods, dict(reasons)


def _with_noise(model: _LinearModel, x: Vector, random: np.random.Generator) -> Vector:
    """Return a state of the section after its noise.

    Raises:
        LostError: If the section does not reach that far.
    """
    if not np.any(model.noise):
        return x
    chart = model.chart
    moved = x + model.noise * random.standard_normal(x.size)
    try:
        return np.asarray(
            chart.section.root(
                chart.surface.values, chart.section.coordinates(moved), chart.surface.gradient
            )
        )
    except SimulationError as error:
        raise LostError("the noise leaves the section of the orbit") from error


def _row_names(model: _LinearModel) -> list[str]:
    """Return the names of all rows: the period, earlier events, and the states of the section."""
    events = [*model.orbit.sequence[:-1]]
    numbered = [
        name if events.count(name) == 1 else f"{name} ({events[: k + 1].count(name)})"
        for k, name in enumerate(events)
    ]
    return ["period", *numbered, *model.motion.graph.state_names]


def _rows(
    model: _LinearModel, covariance: Vector, samples: Mapping[str, Vector], problem: Problem
) -> list[ScatterRow]:
    """Return the rows of the table. States that do not scatter are left out."""
    by_time = np.sum(model.by_start @ covariance * model.by_start, axis=1)
    by_time += np.sum(model.by_impact**2, axis=1)
    lift, scale = model.chart.section.lift, model.chart.section.scale
    by_state = np.sum(lift @ covariance * lift, axis=1)
    centre = model.chart.section.centre
    times, deviations = [*model.times], [*np.sqrt(np.maximum(by_time, 0.0))]
    orbit = [times[-1], *times[:-1], *centre.tolist()]
    linear = [deviations[-1], *deviations[:-1], *np.sqrt(np.maximum(by_state, 0.0))]
    units = ["s"] * len(times) + [*problem.state_units]
    radius = model.radius
    # Of a sum of squares that forgets by the radius.
    dependent = (1 + radius**2) / (1 - radius**2)
    found: list[ScatterRow] = []
    for k, (name, unit) in enumerate(zip(_row_names(model), units, strict=True)):
        values = samples[name]
        deviation = float(np.std(values, ddof=1)) if values.size > 1 else math.nan
        if k >= len(times) and not linear[k] > _ROUNDING * scale[k - len(times)]:
            continue
        low, high = np.quantile(values, (0.05, 0.95)) if values.size else (math.nan, math.nan)
        found.append(
            ScatterRow(
                name=name,
                unit=unit,
                orbit=orbit[k],
                linear=float(linear[k]),
                mean=float(np.mean(values)) if values.size else math.nan,
                deviation=deviation,
                error=deviation * math.sqrt(dependent / (2 * max(values.size - 1, 1))),
                low=float(low),
                high=float(high),
            )
        )
    return found
