r"""Objectives and bounds of a search as rows and costs of a program.

Over corners `c` of uncertain parameters an objective is the epigraph
:math:`\min t` with :math:`J_c \le t`. A bound on a signal holds at every stage and at the extremes
between stages, which are placed by the guess. A program from its own solution places them exactly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Array, Rows
from zeno_orbits.integrators import lagrange_basis, radau_scheme
from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import ENERGY, PERIOD, Bound, course_signal_names
from zeno_orbits.search.objectives import Objective
from zeno_orbits.search.program.elements import LegElement, Terms
from zeno_orbits.search.program.formulas import FALL
from zeno_orbits.search.program.writer import LegPlaces, PeriodProgram
from zeno_orbits.simulation import Impact, SwitchEvent

IMPACT_SPEED, BOUNCE_TIME, ENERGY_LOST = "impact_speed", "bounce_time", "energy_lost"
"""Words of the quantities of a stop that a program has."""
_SAMPLES = 12
"""Samples of an interval in which extremes are looked for."""
_POSITION = 1e-9
"""Error of the place of an extreme. The value has the square of it."""
_WISH = 2e3
"""Weight of a target that is a wish: a deviation of 3 % counts as much as all free values."""
_CLEAR = 1e-7
"""Gap that a stop keeps between stages, in units of its scale. A simulation tells it from none."""


def lacking_terms(graph: GraphDynamics, objective: Objective, bounds: Sequence[Bound]) -> str:
    """Return what a program lacks for an objective and bounds, empty if it has everything.

    Args:
        graph: The graph of modes.
        objective: The objective.
        bounds: The bounds.
    """
    if not objective.is_in_program:
        return f"the objective {objective.wish}"
    words = (IMPACT_SPEED, BOUNCE_TIME, ENERGY_LOST)
    events = [f"{stop}.{word}" for stop in graph.stop_names for word in words]
    known = (PERIOD, ENERGY, *events, *course_signal_names(graph.compiled))
    lacking = [bound.name for bound in bounds if bound.name not in known]
    return f"the bound on `{lacking[0]}`" if lacking else ""


def needs_work(objective: Objective, bounds: Sequence[Bound], graph: GraphDynamics) -> bool:
    """Return True if the electrical work is part of an objective or of a bound.

    Args:
        objective: The objective.
        bounds: The bounds.
        graph: The graph of modes.
    """
    signals = course_signal_names(graph.compiled)
    about = any(bound.name == ENERGY and ENERGY not in signals for bound in bounds)
    return about or objective.needs_source


def signals_of(
    objective: Objective, bounds: Sequence[Bound], graph: GraphDynamics
) -> tuple[str, ...]:
    """Return the signals whose extremes are part of a program. Another round places them anew.

    Args:
        objective: The objective.
        bounds: The bounds.
        graph: The graph of modes.
    """
    known = course_signal_names(graph.compiled)
    names = [bound.name for bound in bounds if bound.name in known]
    return tuple(dict.fromkeys([*names, *objective.signals]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sum:
    """A sum of weighted unknowns and outputs.

    Attributes:
        unknowns: Place to weight.
        outputs: Place to weight.
        guess: Its value at the guess.
    """

    unknowns: Mapping[int, float]
    outputs: Mapping[int, float]
    guess: float

    def terms(self, factor: float = 1.0) -> tuple[list[Terms], list[Terms]]:
        """Return the terms of a row, times a factor."""
        linear: list[Terms] = [
            (np.array([place]), factor * weight) for place, weight in self.unknowns.items()
        ]
        outputs: list[Terms] = [
            (np.array([place]), factor * weight) for place, weight in self.outputs.items()
        ]
        return linear, outputs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mark:
    """Point of a leg, as a weighted sum of the states of an interval and of its start.

    Attributes:
        places: The leg.
        columns: Places of the states, ``(n_x, m)``.
        weights: Their weights, ``(m,)``.
        fraction: The point as a fraction of the leg.
    """

    places: LegPlaces
    columns: Rows
    weights: Array
    fraction: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingPlace:
    """A place between stages.

    Attributes:
        period: Index of the period.
        leg: Index of the leg.
        fraction: The place in the leg, from 0 to 1.
        stop: Index of the stop that is penetrated there, -1 at an extreme of a signal.
    """

    period: int
    leg: int
    fraction: float
    stop: int = -1


def mark_at(period: PeriodProgram, places: LegPlaces, fraction: float) -> Mark:
    """Return a place of a leg.

    Args:
        period: The period of the leg.
        places: The leg.
        fraction: The place, from 0 to 1.
    """
    mesh, n = places.mesh, period.machine.n_x
    s = places.stages.shape[1] // (len(mesh) - 1)
    i = min(max(int(np.searchsorted(mesh, fraction)) - 1, 0), len(mesh) - 2)
    first = places.start if i == 0 else places.stages[:n, i * s - 1]
    columns = np.column_stack([first, places.stages[:n, i * s : (i + 1) * s]])
    at = (fraction - mesh[i]) / (mesh[i + 1] - mesh[i])
    nodes = [0.0, *radau_scheme(s).nodes.tolist()]
    return Mark(
        places=places,
        columns=columns,
        weights=np.array(lagrange_basis(nodes, at)),
        fraction=fraction,
    )


def samples_of_legs(
    period: PeriodProgram, places: LegPlaces, unknowns: Array
) -> tuple[Array, Array]:
    """Return fractions of a leg between and at its stages, and the states of its polynomials.

    Args:
        period: The period of the leg.
        places: The leg.
        unknowns: All unknowns, ``(n,)``.

    Returns:
        The fractions, ``(m,)``, and the states, ``(n_x, m)``.
    """
    mesh, n = places.mesh, period.machine.n_x
    s = places.stages.shape[1] // (len(mesh) - 1)
    nodes = [0.0, *radau_scheme(s).nodes.tolist()]
    inner = np.linspace(0.0, 1.0, _SAMPLES + 1)
    basis = np.array([lagrange_basis(nodes, float(at)) for at in inner])
    fractions: list[Array] = []
    states: list[Array] = []
    for i, (low, high) in enumerate(pairwise(mesh.tolist())):
        first = places.start if i == 0 else places.stages[:n, i * s - 1]
        columns = np.column_stack([first, places.stages[:n, i * s : (i + 1) * s]])
        fractions.append(low + inner * (high - low))
        states.append(unknowns[columns] @ basis.T)
    return np.concatenate(fractions), np.hstack(states)


def leg_values(element: LegElement, states: Array, free: Array, p: Array) -> Array:
    """Return the first output of an element at states, ``(m,)``.

    Args:
        element: An element with the column ``(x, free)``.
        states: The states, ``(n_x, m)``.
        free: The free values.
        p: All values.
    """
    m = states.shape[1]
    columns = np.vstack([states, np.repeat(free[:, None], m, axis=1)])
    constants = np.repeat(p[:, None], m, axis=1)
    found: Any = element.values.map(m)(columns, constants)
    return np.array(ca.DM(found).full())[0]


def signal_along(period: PeriodProgram, places: LegPlaces, name: str) -> tuple[Array, Array]:
    """Return samples of a signal along a leg at the guess: fractions and values.

    Args:
        period: The period of the leg.
        places: The leg.
        name: Name of the signal.
    """
    builder = period.builder
    fractions, states = samples_of_legs(period, places, builder.value(np.arange(builder.n)))
    if name in period.graph.state_names:
        return fractions, states[period.graph.state_names.index(name)]
    element = period.machine.signal(places.leg.mode, name)
    return fractions, leg_values(element, states, builder.value(period.free), period.graph.p)


def extremes_along(period: PeriodProgram, places: LegPlaces, name: str, sign: float) -> list[float]:
    """Return the places of local extremes of a signal along a leg, its ends included.

    Args:
        period: The period of the leg.
        places: The leg.
        name: Name of the signal.
        sign: 1 for the largest values, -1 for the smallest.
    """
    # SciPy's optimizers take a while to import.
    from scipy.optimize import minimize_scalar

    fractions, values = signal_along(period, places, name)
    fractions, kept = np.unique(fractions, return_index=True)
    values = sign * values[kept]
    everything = period.builder.value(np.arange(period.builder.n))

    def below(at: float) -> float:
        mark = mark_at(period, places, at)
        state = (everything[mark.columns] @ mark.weights)[:, None]
        if name in period.graph.state_names:
            return -sign * float(state[period.graph.state_names.index(name), 0])
        element = period.machine.signal(places.leg.mode, name)
        free = everything[period.free]
        return -sign * float(leg_values(element, state, free, period.graph.p)[0])

    found = [0.0, 1.0]
    inside = (values[1:-1] >= values[:-2]) & (values[1:-1] > values[2:])
    for k in (np.flatnonzero(inside) + 1).tolist():
        refined: Any = minimize_scalar(
            below,
            bounds=(float(fractions[k - 1]), float(fractions[k + 1])),
            method="bounded",
            options={"xatol": _POSITION},
        )
        found.append(float(refined.x))
    return found


def extremes_of(
    periods: Sequence[PeriodProgram], signals: Sequence[str]
) -> tuple[ReadingPlace, ...]:
    """Return the places of the extremes of signals between the ends of all legs, at the guess.

    Args:
        periods: The periods of the program.
        signals: Names of the signals.
    """
    return tuple(
        ReadingPlace(period=number, leg=k, fraction=at)
        for number, period in enumerate(periods)
        for k, places in enumerate(period.legs)
        for name in signals
        for sign in (1.0, -1.0)
        for at in extremes_along(period, places, name, sign)
        if 0.0 < at < 1.0
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SearchTerms:
    """The terms of a search in a program.

    Attributes:
        periods: The periods, the first at the search's own parameters, then at each corner.
        free: Name to place of the free values.
        places: Places between stages at which bounds on signals hold, too.
    """

    periods: tuple[PeriodProgram, ...]
    free: Mapping[str, int]
    places: Sequence[ReadingPlace] = ()

    @property
    def _own(self) -> PeriodProgram:
        return self.periods[0]

    def nearest(
        self, origin: Mapping[str, float], sizes: Mapping[str, float], goal: Mapping[str, float]
    ) -> None:
        """Add half the squared distance of the free values from their targets to the objective.

        Args:
            origin: Name to value without a target.
            sizes: Name to unit of a distance.
            goal: Name to target.
        """
        wanted = {**origin, **goal}
        for name, place in self.free.items():
            self._own.builder.cost_of_distance(place, 1 / sizes[name] ** 2, wanted[name])

    def least_work(self) -> None:
        """Minimize the largest work of a period."""
        self._least([self._work(period) for period in self.periods])

    def least_of_impacts(self, stop: str, quantity: str) -> None:
        """Minimize the largest sum of a quantity of impacts in a period.

        Args:
            stop: Name of a stop, or an empty text for all stops.
            quantity: Word of the quantity.
        """
        self._least([self._of_impacts(period, stop, quantity) for period in self.periods])

    def reach(self, name: str, target: float, *, is_wish: bool) -> None:
        """Prescribe a number of the orbit at the search's own parameters.

        Args:
            name: The period, the energy, or a quantity of an event, whose first value counts.
            target: The value.
            is_wish: Whether the target counts by its distance only, beside the free values.
        """
        self._reach(self._bounded(self._own, name)[0], target, is_wish=is_wish)

    def reach_amplitude(self, state: str, target: float, *, is_wish: bool) -> None:
        """Prescribe half the range of a state at the search's own parameters.

        Args:
            state: Name of the state.
            target: The amplitude.
            is_wish: As for `reach`.
        """
        self._reach(self._amplitude(state), target, is_wish=is_wish)

    def _reach(self, reached: Sum, target: float, *, is_wish: bool) -> None:
        builder = self._own.builder
        linear, outputs = reached.terms()
        if not is_wish:
            builder.rows("target", linear=linear, outputs=outputs, constant=-target, size=target)
            return
        off = builder.unknowns([reached.guess], target)
        builder.rows("wish", linear=[*linear, (off, -1.0)], outputs=outputs, size=target)
        builder.cost_of_distance(int(off[0]), _WISH / target**2, target)

    def _least(self, values: Sequence[Sum]) -> None:
        """Minimise the largest of several sums, in units of the first guess."""
        builder = self._own.builder
        size = abs(values[0].guess) or 1.0
        if len(values) == 1:
            builder.cost_of({k: weight / size for k, weight in values[0].outputs.items()})
            builder.cost_of_unknowns({k: weight / size for k, weight in values[0].unknowns.items()})
            return
        worst = builder.unknowns([max(one.guess for one in values)], size)
        builder.cost_of_unknowns({int(worst[0]): 1.0 / size})
        for one in values:
            linear, outputs = one.terms(-1.0)
            builder.rows(
                "worst case",
                linear=[*linear, (worst, 1.0)],
                outputs=outputs,
                size=size,
                upper=math.inf,
            )

    def _work(self, period: PeriodProgram) -> Sum:
        return self._summed(period, {}, period.work)

    def _summed(
        self, period: PeriodProgram, unknowns: Mapping[int, float], outputs: Mapping[int, float]
    ) -> Sum:
        """Return a sum with its value at the guess."""
        builder = period.builder
        value = sum(
            weight * float(builder.value(np.array([k]))[0]) for k, weight in unknowns.items()
        )
        if outputs:
            found = builder.output_values(np.array(list(outputs), dtype=np.intp))
            value += float(found @ np.array(list(outputs.values())))
        return Sum(unknowns=unknowns, outputs=outputs, guess=value)

    def _of_impacts(self, period: PeriodProgram, stop: str, quantity: str) -> Sum:
        unknowns: dict[int, float] = {}
        outputs: dict[int, float] = {}
        for name in (stop,) if stop else period.graph.stop_names:
            for one in self._quantities(period, name, quantity):
                unknowns |= one.unknowns
                outputs |= one.outputs
        return self._summed(period, unknowns, outputs)

    def _quantities(self, period: PeriodProgram, stop: str, word: str) -> list[Sum]:
        """Return the values of a quantity of a stop, in order of time."""
        index, n = period.graph.stop_names.index(stop), period.machine.n_x
        struck = [
            k
            for k, places in enumerate(period.legs)
            if places.leg.strikes and places.leg.index == index
        ]
        if word == ENERGY_LOST:
            lost = {int(period.legs[k].event[3 + n]): 1.0 for k in struck}
            return [self._summed(period, {}, lost)] if struck else []
        if word == IMPACT_SPEED:
            return [
                self._summed(period, {}, {int(period.legs[k].event[FALL]): 1.0})
                for k in struck
                if _first_of(period, k) == k
            ]
        found: list[Sum] = []
        for k in struck:
            if k not in period.tails:
                continue
            unknowns, outputs = {period.tails[k]: 1.0}, dict[int, float]()
            place = _first_of(period, k)
            while place != k:
                place = (place + 1) % len(period.legs)
                own, products = period.legs[place].elapsed
                unknowns |= dict.fromkeys(own, 1.0)
                outputs |= dict.fromkeys(products, 1.0)
            found.append(self._summed(period, unknowns, outputs))
        return found

    # Bounds.

    def keep(self, bound: Bound, size: float) -> None:
        """Add the rows of a bound, in every period.

        Args:
            bound: The bound.
            size: Unit of its distances.
        """
        for period in self.periods:
            if bound.name in course_signal_names(period.graph.compiled):
                self._keep_signal(period, bound, size)
                continue
            for one in self._bounded(period, bound.name):
                linear, outputs = one.terms()
                period.builder.rows(
                    f"bound on {bound.name}",
                    linear=linear,
                    outputs=outputs,
                    size=size,
                    lower=bound.lower / size,
                    upper=bound.upper / size,
                )

    def measured(self, period: PeriodProgram, name: str) -> list[float]:
        """Return the values of a quantity at the guess, in order of time.

        Args:
            period: The period.
            name: The period, the energy or a quantity of an event.
        """
        return [one.guess for one in self._bounded(period, name)]

    def _bounded(self, period: PeriodProgram, name: str) -> list[Sum]:
        if name == PERIOD:
            return [self._summed(period, {period.period: 1.0}, {})]
        if name == ENERGY:
            return [self._work(period)]
        stop, _, word = name.rpartition(".")
        return self._quantities(period, stop, word)

    def _keep_signal(self, period: PeriodProgram, bound: Bound, size: float) -> None:
        label = f"bound on {bound.name}"
        lower, upper = bound.lower / size, bound.upper / size
        for linear, outputs in self._everywhere(period, bound.name):
            period.builder.rows(
                label, linear=linear, outputs=outputs, size=size, lower=lower, upper=upper
            )

    def least_peak(self, name: str) -> None:
        """Minimize the peak of a signal: its largest absolute value in all periods.

        Args:
            name: Name of the signal.
        """
        builder = self._own.builder
        size = max(
            float(np.max(np.abs(signal_along(period, places, name)[1])))
            for period in self.periods
            for places in period.legs
        )
        size = size or 1.0
        peak = builder.unknowns([size], size, 0.0)
        builder.cost_of_unknowns({int(peak[0]): 1.0 / size})
        for period in self.periods:
            for linear, outputs in self._everywhere(period, name):
                n = len((*linear, *outputs)[0][0])
                over = (np.repeat(peak, n), 1.0)
                for sign in (1.0, -1.0):
                    builder.rows(
                        f"peak of {name}",
                        linear=[over, *((k, sign * np.asarray(w)) for k, w in linear)],
                        outputs=[(k, sign * np.asarray(w)) for k, w in outputs],
                        size=size,
                        upper=math.inf,
                    )

    def _amplitude(self, state: str) -> Sum:
        """Return half the range of a state between its highest and its lowest place."""
        period = self._own
        index = period.graph.state_names.index(state)
        sides: dict[int, float] = {}
        for sign in (1.0, -1.0):
            best: tuple[float, Mark] | None = None
            for places in period.legs:
                fractions, values = signal_along(period, places, state)
                for fraction in extremes_along(period, places, state, sign):
                    value = sign * float(np.interp(fraction, fractions, values))
                    if best is None or value > best[0]:
                        best = value, mark_at(period, places, fraction)
            if best is None:
                raise TypeError("A period has at least one leg.")
            for place, weight in zip(best[1].columns[index], best[1].weights, strict=True):
                sides[int(place)] = sides.get(int(place), 0.0) + sign * float(weight) / 2
        return self._summed(period, sides, {})

    # Signals.

    def _everywhere(
        self, period: PeriodProgram, name: str
    ) -> list[tuple[list[Terms], list[Terms]]]:
        """Return the terms of a signal at all stages, starts of legs and extremes."""
        return [terms for places in period.legs for terms in self._along(period, places, name)]

    def _along(
        self, period: PeriodProgram, places: LegPlaces, name: str
    ) -> list[tuple[list[Terms], list[Terms]]]:
        n = period.machine.n_x
        number, k = self.periods.index(period), period.legs.index(places)
        extremes = [
            mark_at(period, places, place.fraction)
            for place in self.places
            if (place.period, place.leg) == (number, k) and 0.0 < place.fraction < 1.0
        ]
        columns = np.column_stack([places.start, places.stages[:n]])
        if name in period.graph.state_names:
            index = period.graph.state_names.index(name)
            found: list[tuple[list[Terms], list[Terms]]] = [([(columns[index], 1.0)], [])]
            for mark in extremes:
                terms = zip(mark.columns[index], mark.weights.tolist(), strict=True)
                found.append(([(np.array([place]), w) for place, w in terms], []))
            return found
        columns = np.column_stack([columns, *(self._state(period, mark) for mark in extremes)])
        element = period.machine.signal(places.leg.mode, name)
        return [([], [(_at_states(period, element, columns), 1.0)])]

    def _state(self, period: PeriodProgram, mark: Mark) -> Rows:
        """Add the state at a place as unknowns, and return their places, ``(n_x,)``."""
        builder, sizes = period.builder, mark.places.sizes[: period.machine.n_x]
        guess = builder.value(mark.columns) @ mark.weights
        state = builder.unknowns(guess, sizes)
        linear: list[Terms] = [(state, -1.0)]
        linear += [(mark.columns[:, k], weight) for k, weight in enumerate(mark.weights.tolist())]
        builder.rows("state between stages", linear=linear, size=sizes)
        return state

    # Contacts.

    def keep_contacts(self, dips: Sequence[ReadingPlace]) -> None:
        """Add rows that keep open stops open and closed stops closed along all legs.

        Args:
            dips: Further places, by `dips_of`.
        """
        for period in self.periods:
            for places in period.legs:
                for stop in range(len(period.graph.stop_names)):
                    self._keep_contact(period, places, stop)
        for dip in dips:
            period = self.periods[dip.period]
            places = period.legs[dip.leg]
            state = self._state(period, mark_at(period, places, dip.fraction))
            element = period.machine.contact(places.leg.mode, dip.stop)
            size = period.graph.view(places.leg.mode, dip.stop).own.gap
            out = _at_states(period, element, state[:, None])
            period.builder.rows(
                "gap between stages",
                outputs=[(out, 1.0)],
                size=size,
                lower=_CLEAR,
                upper=math.inf,
            )

    def _keep_contact(self, period: PeriodProgram, places: LegPlaces, stop: int) -> None:
        leg, n, builder = places.leg, period.machine.n_x, period.builder
        columns = places.stages[:, 1:-1]
        if leg.stop == stop:
            builder.rows("gap", linear=[(columns[n], 1.0)], size=places.sizes[n], upper=math.inf)
            return
        element = period.machine.contact(leg.mode, stop)
        states = builder.value(columns[:n])
        free = builder.value(period.free)
        values = leg_values(element, states, free, period.graph.p)
        size = float(np.max(np.abs(values))) or 1.0
        out = _at_states(period, element, columns[:n])
        name = "contact force" if stop in leg.mode[0] else "gap"
        builder.rows(name, outputs=[(out, 1.0)], size=size, upper=math.inf)


def _at_states(period: PeriodProgram, element: LegElement, columns: Rows) -> Rows:
    """Evaluate an element at states, and return the places of its first output."""
    free = np.repeat(period.free[:, None], columns.shape[1], axis=1)
    return period.builder.outputs(element, np.vstack([columns, free]), period.graph.p)[0]


def _first_of(period: PeriodProgram, k: int) -> int:
    """Return the leg of the first impact of the sequence to which an impact belongs."""
    first, n = k, len(period.legs)
    for back in range(1, n):
        leg, here = period.legs[(k - back) % n].leg, period.legs[first].leg.event
        event = leg.event
        if isinstance(event, SwitchEvent):
            if event.name in period.graph.switch_names[: period.graph.n_declared]:
                break
            continue
        if not (isinstance(event, Impact) and isinstance(here, Impact)):
            break
        is_tail = (k - back) % n in period.tails
        if is_tail or event.stop != here.stop or not here.approach_rate > event.approach_rate:
            break
        first = (k - back) % n
    return first


def dips_of(periods: Sequence[PeriodProgram], unknowns: Array) -> list[ReadingPlace]:
    """Return places between stages at which a solution penetrates an open stop.

    Args:
        periods: The periods of the program.
        unknowns: The solution.
    """
    found: list[ReadingPlace] = []
    for number, period in enumerate(periods):
        free = unknowns[period.free]
        for k, places in enumerate(period.legs):
            fractions, states = samples_of_legs(period, places, unknowns)
            for stop in range(len(period.graph.stop_names)):
                if stop in places.leg.mode[0] or places.leg.stop == stop:
                    continue
                element = period.machine.contact(places.leg.mode, stop)
                size = period.graph.view(places.leg.mode, stop).own.gap
                gaps = leg_values(element, states, free, period.graph.p) / size
                low = (
                    (gaps[1:-1] < _CLEAR / 2) & (gaps[1:-1] <= gaps[:-2]) & (gaps[1:-1] <= gaps[2:])
                )
                at = fractions[1:-1][low]
                found += [
                    ReadingPlace(period=number, leg=k, fraction=float(one), stop=stop) for one in at
                ]
    return found
