"""What the commands say of one problem at its own numbers: search, simulate, map, continue."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import zeno_orbits as zo

NEAR = 1e-3
"""Half the width of the ranges around the problem's own numbers, relative."""
PERIODS = 20


@dataclass(frozen=True, kw_only=True)
class Story:
    """One orbit as the commands tell it.

    Attributes:
        shape: Its shape, as the search found it.
        period: Its period, by the search [s].
        verified: Whether the check passed, and the orbit attracts.
        simulated: Mean time between equal releases of a long simulation [s]; NaN without any.
        mapped: Period at the problem's own numbers, by the map [s]; NaN where it names no orbit.
        fates: What the map says around them.
        continued: Period at the problem's own numbers, by its family [s]; NaN if not followed.
    """

    shape: str
    period: float
    verified: bool
    simulated: float
    mapped: float
    fates: frozenset[str]
    continued: float

    def spread(self) -> float:
        """Return how far the periods differ, relative."""
        said = [self.simulated, self.mapped, self.continued]
        known = [period for period in said if not np.isnan(period)]
        return max(abs(period / self.period - 1) for period in known)


def story_of(problem: str | Path, *, follow: bool = True) -> Story:
    """Return what the commands say of a problem at its own numbers.

    Args:
        problem: Its name or file.
        follow: Whether to continue the orbit in a number.
    """
    known = zo.load_problem(problem)
    orbit = zo.find_orbit(problem).unwrap()
    certificate = zo.verify(orbit, problem=problem)
    x, y = (_around(known, name) for name in _two_numbers(known))
    plane = zo.parameter_map(problem, x=x, y=y)
    return Story(
        shape=orbit.shape.text,
        period=orbit.period,
        verified=certificate.passed and certificate.stable,
        simulated=_simulated(known, orbit),
        mapped=plane.attractors[len(plane.attractors) // 2].period,
        fates=frozenset(one.fate.name for one in plane.attractors),
        continued=_continued(problem, orbit, x[:3]) if follow else float("nan"),
    )


def _two_numbers(problem: zo.Problem) -> tuple[str, str]:
    names = [one.name for one in (*problem.gains, *problem.parameters)]
    return tuple(name for name in names if name != "restitution")[:2]  # type: ignore[return-value]


def _around(problem: zo.Problem, name: str) -> tuple[str, float, float, int]:
    value = problem.values().number(name)
    width = NEAR * abs(value) or NEAR
    return name, value - width, value + width, 3


def _simulated(problem: zo.Problem, orbit: zo.ZenoOrbit) -> float:
    """Return the mean period of a long simulation, from release to release."""
    start = orbit.phases[0].start_state
    motion = zo.simulate(problem, start=start, until=(PERIODS + 0.5) * orbit.period)
    if orbit.shape.starts_at_release:
        times = [one.time for one in motion.releases][
            orbit.shape.n_releases - 1 :: orbit.shape.n_releases
        ]
    else:
        times = [one.time for one in motion.impacts][
            orbit.shape.n_phases - 1 :: orbit.shape.n_phases
        ]
    return float((times[-1] - times[0]) / (len(times) - 1))


def _continued(problem: str | Path, orbit: zo.ZenoOrbit, range_: tuple[str, float, float]) -> float:
    name, low, high = range_
    family = zo.continue_orbit(orbit, name, (low, high), problem=problem).families[0]
    points = sorted((point.value, point.period) for point in family.points)
    values, periods = np.array(points).T
    middle = (low + high) / 2
    return float(np.interp(middle, values, periods))
