"""The attractor at given gains and parameters, as facts and curves that a browser can draw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import Multipliers, Orbit
from zeno_orbits.report.motion import orbit_motion
from zeno_orbits.report.paths import ArcPath, drawn_paths
from zeno_orbits.report.table import shown_multipliers
from zeno_orbits.search import orbit_by_shooting
from zeno_orbits.simulation import Execution, Release, SimulationSettings, ZenoPoint, simulate
from zeno_orbits.verification import multipliers_of

_TRANSIENT, _IMPACTS = 20.0, 60
"""Duration [s] and number of impacts of the motion that is drawn without a periodic orbit."""
_DIGITS = 5
"""Significant digits of drawn coordinates: a hundredth of a pixel."""
_MULTIPLIER_DIGITS = 4
"""Digits of a multiplier."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExploredAttractor:
    """The attractor that a simulation reaches.

    Attributes:
        name: Kind of the attractor, or the reason why the simulation reached none.
        orbit: The periodic orbit, not verified, or ``None`` for another kind of attractor.
        multipliers: Floquet multipliers of the orbit, or ``None`` without an orbit.
        motion: One period of the orbit, or the motion from the initial state. It is ``None`` if the
            motion cannot be continued.
    """

    name: str
    orbit: Orbit | None
    multipliers: Multipliers | None
    motion: Execution | None

    def view(self, problem: Problem) -> dict[str, Any]:
        """Return the data of the browser's view, as plain lists and values.

        Args:
            problem: The problem, whose `portraits` name the axes of the panels.
        """
        return {"name": self.name, "facts": self._facts(), "panels": self._panels(problem)}

    def _facts(self) -> list[list[str]]:
        if self.orbit is None or self.multipliers is None:
            return []
        error = self.multipliers.error
        values = shown_multipliers(self.multipliers.values, error, _MULTIPLIER_DIGITS)
        return [
            ["period", f"{self.orbit.period:.9g} s"],
            ["event sequence", self.orbit.shape.text],
            ["spectral radius", f"{self.multipliers.spectral_radius:.4g}"],
            ["multipliers", values or "none"],
        ]

    def _panels(self, problem: Problem) -> list[dict[str, Any]]:
        if self.motion is None:
            return []
        units = dict(zip(problem.state_names, problem.state_units, strict=True))
        paths = drawn_paths(self.motion)
        return [
            {
                "x": f"{x} [{units[x]}]",
                "y": f"{y} [{units[y]}]",
                **_curves(self.motion, paths, [problem.state_names.index(n) for n in (x, y)]),
            }
            for x, y in problem.portraits
        ]


def attractor_at(
    problem: Problem, values: ParameterValues, *, near: Orbit | None = None
) -> ExploredAttractor:
    """Compute the attractor that a simulation reaches, not verified.

    Args:
        problem: The problem.
        values: Gains and parameters.
        near: Orbit at other values, which is followed to these values while it is stable. If it is
            lost, the simulation starts at its start. By default the simulation starts at the
            starts of the problem.
    """
    followed = None if near is None else _followed(problem, values, near)
    if followed is not None:
        return followed
    # The starts of the problem are the second choice, after a continuation of the last orbit.
    starts = problem.starts if near is None else (near.start_state, *problem.starts)
    moved = replace(problem, starts=starts)
    reached = orbit_by_shooting(moved, values, simulation=SimulationSettings())
    if reached.orbit is None:
        motion = _transient(problem, values)
        return ExploredAttractor(name=reached.detail, orbit=None, multipliers=None, motion=motion)
    return _described(problem, values, reached.orbit)


def _followed(problem: Problem, values: ParameterValues, near: Orbit) -> ExploredAttractor | None:
    """Return the orbit to which Newton's method leads from an orbit at other values, if stable.

    It takes a quarter of the time of a simulation.
    """
    try:
        closed = orbit_by_shooting(problem, values, near=near)
    except InputError:
        # After a large change the state that is moved onto the section may leave a constraint.
        return None
    if closed.orbit is None:
        return None
    found = _described(problem, values, closed.orbit)
    stable = found.multipliers is not None and found.multipliers.spectral_radius < 1.0
    return found if stable else None


def _described(problem: Problem, values: ParameterValues, orbit: Orbit) -> ExploredAttractor:
    motion = orbit_motion(orbit, problem, problem.dynamics(values))
    multipliers = multipliers_of(orbit, problem)
    return ExploredAttractor(
        name=_name(multipliers, orbit),
        orbit=orbit,
        multipliers=multipliers,
        motion=motion,
    )


def _name(multipliers: Multipliers, orbit: Orbit) -> str:
    stable = "Stable" if multipliers.spectral_radius < 1.0 else "Unstable"
    return f"{stable} {orbit.kind}"


def _transient(problem: Problem, values: ParameterValues) -> Execution | None:
    """Simulate from the first start that can be continued, for the picture."""
    dynamics = problem.dynamics(values)
    for start in problem.starts:
        try:
            state = problem.state_vector(start, values)
            return simulate(dynamics, state, until=_TRANSIENT, impacts=_IMPACTS)
        except SimulationError:
            continue
    return None


def _curves(motion: Execution, paths: Sequence[ArcPath], pair: Sequence[int]) -> dict[str, Any]:
    """Return the arcs, resets and marked points of a motion in one plane."""
    zeno = [event.state for event in motion.events if isinstance(event, ZenoPoint)]
    release = [event.state for event in motion.events if isinstance(event, Release)]
    return {
        "paths": [{"kind": path.kind, "points": _points(path.states, pair)} for path in paths],
        "resets": [
            _points([impact.state_minus, impact.state_plus], pair) for impact in motion.impacts
        ],
        "zeno": _points(zeno, pair),
        "release": _points(release, pair),
    }


def _points(states: Sequence[Vector] | Vector, pair: Sequence[int]) -> list[list[float]]:
    return [[float(f"{state[k]:.{_DIGITS}g}") for k in pair] for state in states]
