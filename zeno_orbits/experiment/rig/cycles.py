"""Cycles of a machine's run: from one release to the next, as an orbit of the model counts them.

Zeno points and contact multipliers do not exist in a machine. Its *lock* is a long stretch of
contacts in close succession. Its *release* is the end of that stretch (theory (6.6)).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError, counted
from zeno_orbits.experiment.rig.default_stop import default_rig
from zeno_orbits.experiment.rig.run import RigRun, RigSettings, Touch
from zeno_orbits.experiment.rig.simulator import run_rig
from zeno_orbits.model import Problem, Rig
from zeno_orbits.orbits import Orbit
from zeno_orbits.simulation import AttractorKind, Motion, SectionReturn, outcome_of
from zeno_orbits.work import ByValue, Progress, silent

_CLOSE = 0.02
"""Part of the orbit's contact duration below which a flight does not end a lock."""
_LONG = 0.1
"""Part of the orbit's contact duration from which on contacts, or one alone, are a lock."""
_LIKE_PERIOD = 0.3
"""A cycle's period differs from the orbit's by less than this part of it."""
_FLIGHT = 0.5
"""A cycle's first flight lasts at least this part of the orbit's."""
_SETTLE = 8
"""Number of transient cycles of a machine if the multipliers of its orbit are unknown."""
_FEWEST, _MOST = 4, 60
"""Cycles that it gets at least, and at most."""
_CLOSE_TO = 1e-2
"""Change of a machine's release over some cycles, relative, that counts as repeating."""
_LEFT = 1e-8
"""Part of a deviation that may be left then, if it falls as on the orbit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RigCycle:
    """One cycle of a machine, from release to release.

    Attributes:
        release: When it begins [s].
        release_state: State at that time, ``(n_y,)``.
        impact: The first contact after it.
        impacts: Number of contacts before the sustained contact.
        lock: Start of the sustained contact, which is the end of the chatter [s].
        lock_state: State at that time.
        end: The next release [s].
        end_state: State at that time.
    """

    release: float
    release_state: Vector
    impact: Touch
    impacts: int
    lock: float
    lock_state: Vector
    end: float
    end_state: Vector

    @property
    def period(self) -> float:
        """From release to release [s]."""
        return self.end - self.release


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class SettledRig(ByValue):
    """A machine that has settled, over some cycles.

    Attributes:
        run: Run over the cycles, with times since the first release.
        cycles: The cycles.
    """

    run: RigRun
    cycles: tuple[RigCycle, ...]

    def __repr__(self) -> str:
        """Return one line: the number of cycles and the periods."""
        periods = ", ".join(f"{cycle.period:.7g}" for cycle in self.cycles[:4])
        more = ", ..." if len(self.cycles) > 4 else ""
        return (
            f"<SettledRig of {self.run.problem}: cycles={len(self.cycles)}, "
            f"periods={periods}{more} s>"
        )


def settle_rig(
    orbit: Orbit,
    problem: Problem,
    rig: Rig | None = None,
    *,
    cycles: int = 3,
    settle: int | None = None,
    seed: int = 0,
    settings: RigSettings | None = None,
    on_progress: Progress = silent,
) -> SettledRig:
    """Simulate a machine from the release of an orbit of its model and return its settled cycles.

    Args:
        orbit: The orbit. The machine has its gains and parameters.
        problem: Its problem.
        rig: The parts of the machine, by default the parts that the problem declares.
        cycles: Number of cycles to return.
        settle: Number of cycles to discard first, by default computed from the orbit's multipliers.
        seed: Random seed of the noise.
        settings: Accuracy of the integration and the records to keep.
        on_progress: Called with the part of the time that is simulated.

    Raises:
        InputError: If the rig does not fit the problem, or `cycles` is less than one.
        SimulationError: If the machine does not settle to such cycles.
    """
    if cycles < 1 or (settle is not None and settle < 0):
        least = "must be at least 1, and `settle` at least 0"
        raise InputError(f"Argument `cycles` {least}, but they are {cycles} and {settle}.")
    parts = rig or default_rig(problem, orbit=orbit)
    passed = settling_cycles(orbit) if settle is None else settle
    wanted = passed + cycles
    # A cycle may be a little longer than the orbit's cycle. A run that was too short is repeated.
    for slack in (1.1, 2.0):
        until = orbit.period * (wanted + 1) * slack
        keep_from = 0.8 * passed * orbit.period if slack == 1.1 else 0.0
        run = run_rig(
            problem,
            orbit.values(problem),
            parts,
            problem.state_vector(orbit.release_state),
            until,
            seed=seed,
            settings=replace(settings or RigSettings(), keep_from=keep_from),
            on_progress=on_progress,
        )
        found = cut_cycles(run.touches, orbit)
        if len(found) >= wanted and found[passed].release >= keep_from:
            return _from_first_release(run, found[passed:wanted])
        if 2 * len(found) < wanted:
            # More time will not make them: the machine moves otherwise.
            break
    raise SimulationError(
        f"The machine made {counted(len(found), 'cycle')} with a lasting contact, but "
        f"{wanted} were expected: it {_outcome(run, found, orbit, problem).value}",
        time=until,
        state=tuple(run.states[-1].tolist()),
    )


def periods_near(
    orbit: Orbit,
    problem: Problem,
    rig: Rig | None = None,
    *,
    periods: int = 3,
    settle: int | None = None,
    seed: int = 0,
    settings: RigSettings | None = None,
    on_progress: Progress = silent,
) -> RigRun:
    """Simulate a machine from the start of an orbit of events and return its settled periods.

    Args:
        orbit: The orbit. The machine has its gains and parameters.
        problem: Its problem.
        rig: The parts of the machine, by default the parts that the problem declares.
        periods: Number of periods to return.
        settle: Number of periods to discard first, by default computed from the multipliers.
        seed: Random seed of the noise.
        settings: Accuracy of the integration and the records to keep.
        on_progress: Called with the part of the time that is simulated.

    Raises:
        InputError: If the rig does not fit the problem, or `periods` is less than one.
        SimulationError: If the integration fails.
    """
    if periods < 1 or (settle is not None and settle < 0):
        least = "must be at least 1, and `settle` at least 0"
        raise InputError(f"Argument `periods` {least}, but they are {periods} and {settle}.")
    passed = orbit.period * (settling_cycles(orbit) if settle is None else settle)
    run = run_rig(
        problem,
        orbit.values(problem),
        rig or default_rig(problem, orbit=orbit),
        problem.state_vector(orbit.start_state),
        passed + periods * orbit.period,
        seed=seed,
        settings=replace(settings or RigSettings(), keep_from=passed),
        on_progress=on_progress,
    )
    return run.between(passed, math.inf, zero=passed)


def _outcome(
    run: RigRun, cycles: Sequence[RigCycle], orbit: Orbit, problem: Problem
) -> AttractorKind:
    """Classify the attractor of a machine without cycles that match the orbit."""
    n_x, swing = len(problem.state_names), run.of(problem.amplitude_of)
    edges = np.arange(run.times[0], run.times[-1], orbit.period)
    windows = np.split(swing, np.searchsorted(run.times, edges[1:]))
    touching = bool(run.touches) and math.isinf(run.touches[-1].end)
    motion = Motion(
        units=problem.state_units,
        returns=[SectionReturn(time=one.end, state=one.end_state[:n_x]) for one in cycles],
        amplitudes=[float(np.ptp(window)) for window in windows[:-1]],
        held=touching and float(run.times[-1]) - run.touches[-1].start > orbit.period,
    )
    return outcome_of(motion, close=_CLOSE_TO).outcome


def settling_cycles(orbit: Orbit) -> int:
    """Return after how many cycles a machine near a stable orbit has settled."""
    radius = max((abs(mu) for mu in orbit.floquet_multipliers), default=math.nan)
    if math.isnan(radius):
        return _SETTLE
    if radius >= 1.0:
        return _MOST
    wanted = math.log(_LEFT) / math.log(radius) if radius > 0.0 else 0.0
    return min(max(math.ceil(wanted), _FEWEST), _MOST)


def cut_cycles(touches: Sequence[Touch], orbit: Orbit) -> tuple[RigCycle, ...]:
    """Return the whole cycles in a sequence of contacts.

    Args:
        touches: The contacts in order.
        orbit: The orbit, whose contact phase gives the expected duration of a lock.
    """
    lock_time = orbit.period - orbit.zeno_time
    locks = [
        lock
        for lock in _stretches(touches, lock_time)
        if lock[-1].end - lock[0].start > _LONG * lock_time
    ]
    found: list[RigCycle] = []
    for before, after in _periods(locks, orbit.period):
        released, last = before[-1], after[-1]
        between = [t for t in touches if released.start < t.start <= last.start]
        if between[0].start - released.end < _FLIGHT * orbit.impacts[0].time:
            continue
        sealed = _sealed(after, lock_time)
        found.append(
            RigCycle(
                release=released.end,
                release_state=released.end_state,
                impact=between[0],
                impacts=sum(t.start < sealed.start for t in between),
                lock=sealed.start,
                lock_state=sealed.state,
                end=last.end,
                end_state=last.end_state,
            )
        )
    return tuple(cycle for cycle in found if math.isfinite(cycle.end))


def _periods(
    locks: Sequence[list[Touch]], period: float
) -> Iterator[tuple[list[Touch], list[Touch]]]:
    """Yield each lock and the longest lock that begins about a period later."""
    k = 0
    while k < len(locks):
        begin = locks[k][-1].end
        later = [
            j
            for j in range(k + 1, len(locks))
            if abs(locks[j][-1].end - begin - period) < _LIKE_PERIOD * period
        ]
        if not later:
            k += 1
            continue
        chosen = max(later, key=lambda j: locks[j][-1].end - locks[j][0].start)
        yield locks[k], locks[chosen]
        k = chosen


def _from_first_release(run: RigRun, cycles: Sequence[RigCycle]) -> SettledRig:
    """Return a run over some of its cycles, with time from the first release on."""
    zero = cycles[0].release
    shifted = tuple(
        replace(
            cycle,
            release=cycle.release - zero,
            impact=cycle.impact.earlier(zero),
            lock=cycle.lock - zero,
            end=cycle.end - zero,
        )
        for cycle in cycles
    )
    return SettledRig(run=run.between(zero, cycles[-1].end, zero=zero), cycles=shifted)


def _stretches(touches: Sequence[Touch], lock_time: float) -> list[list[Touch]]:
    """Return contacts in groups that no long flight divides."""
    groups: list[list[Touch]] = []
    for touch in touches:
        if groups and touch.start - groups[-1][-1].end < _CLOSE * lock_time:
            groups[-1].append(touch)
        else:
            groups.append([touch])
    return groups


def _sealed(group: Sequence[Touch], lock_time: float) -> Touch:
    """Return the contact that begins a lock: the first sustained contact, else the longest.

    If vibrations break the lock into pieces, none of its contacts may be long enough.
    """
    lasting = (touch for touch in group if touch.end - touch.start > _LONG * lock_time)
    return next(lasting, max(group, key=lambda touch: touch.end - touch.start))
