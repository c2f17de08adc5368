"""What the commands say of one problem at its own numbers, and of its machine and recordings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import zeno_orbits as zo
from zeno_orbits.experiment import (
    FitParameter,
    RecordedSignal,
    Recording,
    Source,
    compare_cycles,
    fit_parameters,
    settle_rig,
    tabulate_orbit,
)
from zeno_orbits.model import Contact, Rig

NEAR = 1e-3
"""Half the width of the ranges around the problem's own numbers, relative."""
PERIODS = 20
STIFF = 1e-5
"""Part of a period that a contact of the machine with a soft stop lasts, over pi."""
CYCLES, SAMPLES = 6, 400
"""Length of a recording in periods, and its samples in each."""
ONE_RELEASE = ("zeno", "plastic")
"""Shapes with one flight, its impacts and one contact phase."""
OFF = 0.97
"""Restitution at which a fit begins, in units of the true one."""


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


def _simulated(problem: zo.Problem, orbit: zo.Orbit) -> float:
    """Return the mean period of a long simulation, from release to release."""
    start = orbit.phases[0].start_state
    motion = zo.simulate(problem, start=start, until=(PERIODS + 0.5) * orbit.period)
    if orbit.shape.n_releases:
        times = [one.time for one in motion.releases][
            orbit.shape.n_releases - 1 :: orbit.shape.n_releases
        ]
    else:
        times = [one.time for one in motion.impacts][
            orbit.shape.n_phases - 1 :: orbit.shape.n_phases
        ]
    return float((times[-1] - times[0]) / (len(times) - 1))


def _continued(problem: str | Path, orbit: zo.Orbit, range_: tuple[str, float, float]) -> float:
    name, low, high = range_
    family = zo.continue_orbit(orbit, (name, low, high), problem=problem).families[0]
    points = sorted((point.value, point.period) for point in family.points)
    values, periods = np.array(points).T
    middle = (low + high) / 2
    return float(np.interp(middle, values, periods))


@dataclass(frozen=True, kw_only=True)
class DataStory:
    """What a machine and a recording of an orbit tell; NaN where a command does not apply.

    Attributes:
        rig: Relative difference of the period of a machine with a stiff stop.
        identified: Relative error of the restitution found from a recording without noise.
    """

    rig: float
    identified: float


def data_story_of(problem: str | Path) -> DataStory:
    """Return what `rig` and `identify` say of a problem at its own numbers.

    Args:
        problem: Its name or file.
    """
    known = zo.load_problem(problem)
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    return DataStory(rig=_rigged(known, orbit), identified=_identified(known, orbit))


def _rigged(problem: zo.Problem, orbit: zo.Orbit) -> float:
    """Return how far the period of a machine with a stiff stop is off; `rig` takes one release."""
    if orbit.shape.text not in ONE_RELEASE:
        return float("nan")
    dynamics = problem.dynamics(orbit.values(problem))
    inertia = dynamics.normal_inertia(np.array(problem.state_vector(orbit.zeno_state)))
    stop = Contact(stiffness=inertia / (STIFF * orbit.period) ** 2)
    settled = settle_rig(orbit, problem, Rig(contact=stop), cycles=4)
    mean = compare_cycles(orbit, problem, settled).mean
    return abs(mean.period / orbit.period - 1)


def _identified(problem: zo.Problem, orbit: zo.Orbit) -> float:
    """Return the relative error of the restitution that fits samples of the orbit."""
    true = orbit.parameters["restitution"]
    if not (true > 0.0 and orbit.shape.text in ONE_RELEASE):
        return float("nan")
    clock = {problem.state_names[k] for k in problem.compiled().clock}
    units = dict(zip(problem.state_names, problem.state_units, strict=True))
    names = tuple(name for name in problem.state_names if name not in clock)
    times = np.arange(CYCLES * SAMPLES + 0.5) * orbit.period / (SAMPLES + 0.3)
    values = tabulate_orbit(orbit, problem, names).at(times / orbit.period)
    signals = tuple(
        RecordedSignal(name=name, unit=units[name], values=values[:, k])
        for k, name in enumerate(names)
    )
    recording = Recording(
        source=Source.SIMULATED, problem=problem.name, time=times, signals=signals
    )
    begin = problem.values(parameters={"restitution": OFF * true})
    sought = FitParameter(names=("restitution",), lower=true / 2, upper=(1 + true) / 2)
    (found,) = fit_parameters(problem, begin, recording, [sought]).fitted
    return abs(found.value / true - 1)
