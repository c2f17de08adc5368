"""Attractors at many parameter values of a problem at once: one chunk of a map."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.maps.attempt import Accuracy, Request
from zeno_orbits.maps.attractors import Attractor
from zeno_orbits.maps.point import Point
from zeno_orbits.maps.sure_point import SurePoint
from zeno_orbits.model import OwnScale, ParameterValues, Problem, own_time
from zeno_orbits.simulation import (
    OSCILLATIONS,
    WAITING,
    Batch,
    BatchModel,
    bounds_of,
    model_in_rows,
)
from zeno_orbits.work import Progress, silent

_BOUNCY, _LONGEST = 0.5, 10.0
"""Restitution from which impacts fade so slowly that it takes longer, and how much at most."""
_LANES = 2048
"""Lanes in a batch. More share the cost of a round better, until they leave the cache."""


def attractors_at(
    problem: Problem,
    settings: Sequence[ParameterValues],
    *,
    start: Mapping[str, float] | None = None,
    until: float | None = None,
    bounds: Mapping[str, float] | None = None,
    accuracy: Accuracy | None = None,
    on_progress: Progress = silent,
) -> tuple[Attractor, ...]:
    """Return what the motion from one state settles to, at every setting.

    The result at a setting does not depend on the others in the batch.

    Args:
        problem: The problem.
        settings: Numbers for its gains and parameters, one a point.
        start: Where motions start; the problem's first start by default.
        until: Longest simulated time [s]; by default the `usual_time`.
        bounds: Largest modulus of coordinates by name; beyond it a motion has escaped. By default
            what the problem declares, and 20 pi for the others.
        accuracy: How accurately motions are followed.
        on_progress: Called with the part of the points that is done, whenever it has grown.

    Raises:
        InputError: If a name is unknown or a number out of its range.
    """
    if until is not None and not (math.isfinite(until) and until > 0.0):
        raise InputError(
            f"Argument `until` must be a positive number of seconds, but it is {until}."
        )
    if not settings:
        return ()
    state = np.array(problem.state_vector(problem.starts[0] if start is None else start))
    time = usual_time(problem, settings, state) if until is None else until
    limits = _limits(problem, bounds)
    alike: dict[OwnScale, list[int]] = {}
    for k, values in enumerate(settings):
        alike.setdefault(problem.dynamics(values).own, []).append(k)
    found: dict[int, Attractor] = {}
    for own, places in alike.items():
        model, some = model_in_rows(problem, own), [settings[k] for k in places]
        run = _Run(problem, model, some, state, time, limits, accuracy or Accuracy())
        done = 0
        while run.is_going:
            run.advance()
            if run.n_done > done:
                on_progress("classifying motions", (len(found) + run.n_done) / len(settings))
            done = run.n_done
        found |= {places[k]: one for k, one in run.found.items()}
    return tuple(_in_words(problem, found[k]) for k in range(len(settings)))


def usual_time(
    problem: Problem, settings: Sequence[ParameterValues], start: Sequence[float] | Vector
) -> float:
    """Return how long to wait for motions to settle, in the problem's own time scale [s].

    It is so many turns of the slowest clock or oscillation, to one digit. Without a clock it is
    longer as impacts fade more slowly, by `ln 0.5 / ln e` where `e` is above 0.5.

    Args:
        problem: The problem.
        settings: Numbers for its gains and parameters, at least one.
        start: State at which the motions start, ``(n_x,)``.
    """
    state = np.array(start)
    slowest = max(own_time(problem.dynamics(values), state) for values in settings)
    if problem.compiled().clock:
        return float(f"{WAITING * slowest:.0e}")
    bounciest = max(values.parameters["restitution"] for values in settings)
    longer = math.log(_BOUNCY) / math.log(bounciest) if bounciest > _BOUNCY else 1.0
    return float(f"{min(longer, _LONGEST) * OSCILLATIONS * slowest:.0e}")


def _in_words(problem: Problem, found: Attractor) -> Attractor:
    """Return an attractor whose escape has the words of the problem."""
    if found.escaped not in problem.escapes:
        return found
    return replace(found, detail=problem.escapes[found.escaped].phrase)


def _limits(problem: Problem, bounds: Mapping[str, float] | None) -> Vector:
    declared = {name: escape.beyond for name, escape in problem.escapes.items()}
    declared |= dict(bounds or {})
    problem.state_vector(declared)
    for name, bound in declared.items():
        if not bound > 0.0:
            raise InputError(f"Argument `bounds` must be positive, but `{name}` has {bound:g}.")
    return bounds_of(problem.state_names, problem.state_units, problem.compiled().n_q, declared)


class _Run:
    """The points of a call, and the lanes that they have."""

    def __init__(
        self,
        problem: Problem,
        model: BatchModel,
        settings: Sequence[ParameterValues],
        start: Vector,
        until: float,
        limits: Vector,
        accuracy: Accuracy,
    ) -> None:
        self._numbers = np.array([values.vector for values in settings])
        self._problem = problem
        self._accuracy = accuracy
        self._start, self._until = start, until
        self._usual = model.own.states(model.n_x)
        self._batch = Batch(model, _LANES, bounds=limits)
        self._waiting = deque(range(len(settings)))
        self._points: dict[int, SurePoint] = {}
        self._lanes: dict[int, list[int]] = {}
        self._owner: dict[int, tuple[int, int]] = {}
        self._asked: deque[tuple[int, Request]] = deque()
        self.found: dict[int, Attractor] = {}

    @property
    def is_going(self) -> bool:
        """True while a point has not come to its conclusion."""
        return bool(self._waiting or self._points)

    @property
    def n_done(self) -> int:
        """Points that have."""
        return len(self.found)

    def advance(self) -> None:
        """Give points their lanes, advance these, and tell the points of it."""
        self._admit()
        for event in self._batch.round():
            if event.lane not in self._owner:
                continue
            index, rank = self._owner[event.lane]
            answer = self._points[index].hear(rank, event)
            if answer is None:
                continue
            self._leave(index)
            if isinstance(answer, Attractor):
                self.found[index] = answer
                del self._points[index]
            else:
                self._asked.append((index, answer))

    def _admit(self) -> None:
        """Start the lanes that were asked for, then new points, while there is room."""
        room = self._batch.n_free
        granted: list[tuple[int, Request]] = []
        while self._asked and len(self._asked[0][1].states) <= room:
            room -= len(self._asked[0][1].states)
            granted.append(self._asked.popleft())
        while self._waiting and room > 0 and not self._asked:
            index = self._waiting.popleft()
            dynamics = self._problem.dynamics(self._numbers[index])
            units = self._problem.state_units
            motion = partial(Point, dynamics, units, self._start, self._until, usual=self._usual)
            point = SurePoint(motion, self._accuracy)
            self._points[index] = point
            granted.append((index, point.begin()))
            room -= 1
        kinds = sorted({(r.released, r.led, len(r.states), r.tolerance) for _, r in granted})
        for kind in kinds:
            alike = [
                (index, r)
                for index, r in granted
                if (r.released, r.led, len(r.states), r.tolerance) == kind
            ]
            self._start_lanes(alike, alike[0][1])

    def _start_lanes(self, asked: list[tuple[int, Request]], one: Request) -> None:
        """Start lanes that were asked for in the same way as one of them."""
        n = len(one.states)
        states = np.concatenate([request.states for _, request in asked])
        numbers = np.repeat(self._numbers[[index for index, _ in asked]], n, axis=0)
        until = np.repeat([request.until for _, request in asked], n)
        if one.released:
            lanes = self._batch.resume(
                numbers, states, one.tolerance, until, n_followers=n - 1 if one.led else 0
            )
        else:
            lanes = self._batch.start(numbers, states, one.tolerance, until)
        for (index, _), own in zip(asked, lanes.reshape(-1, n).tolist(), strict=True):
            self._lanes[index] = own
            for rank, lane in enumerate(own):
                self._owner[lane] = (index, rank)

    def _leave(self, index: int) -> None:
        own = self._lanes.pop(index, [])
        self._batch.stop(own)
        for lane in own:
            del self._owner[lane]
