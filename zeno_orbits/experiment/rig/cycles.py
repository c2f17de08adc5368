"""Cycles of a machine's run: from one release to the next, as an orbit of the model counts them.

A machine has no Zeno point and no multiplier. Its *lock* is a long stretch of contacts that follow
one another closely; its *release* is the end of that stretch (theory (53)).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError, counted
from zeno_orbits.experiment.rig.run import RigRun, RigSettings, Touch
from zeno_orbits.experiment.rig.simulator import simulate_rig
from zeno_orbits.model import Contact, Problem, Rig
from zeno_orbits.orbits import ZenoOrbit
from zeno_orbits.simulation import AttractorKind, Motion, SectionReturn, outcome_of
from zeno_orbits.work import Progress, silent

_CLOSE = 0.02
"""Part of the orbit's locked time below which a flight does not end a lock."""
_LONG = 0.1
"""Part of the orbit's locked time from which on contacts, or one alone, are a lock."""
_SETTLE = 8
"""Cycles that a machine gets to settle if its orbit does not tell its multipliers."""
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
        release_state: State there, ``(n_y,)``.
        impact: The first contact after it.
        impacts: Contacts from the first to the one that lasts, that one not counted.
        lock: When the contact begins that lasts: the end of the chatter [s].
        lock_state: State there.
        end: The next release [s].
        end_state: State there.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class SettledRig:
    """A machine that has settled, over some cycles.

    Attributes:
        run: Its run over them; time counts from the first release.
        cycles: The cycles.
    """

    run: RigRun
    cycles: tuple[RigCycle, ...]


def rig_cycles(
    orbit: ZenoOrbit,
    problem: Problem,
    rig: Rig | None = None,
    *,
    cycles: int = 3,
    settle: int | None = None,
    seed: int = 0,
    settings: RigSettings | None = None,
    on_progress: Progress = silent,
) -> SettledRig:
    """Let a machine settle, from the release of an orbit of its model on, and return some cycles.

    Args:
        orbit: The orbit; its gains and parameters are the machine's.
        problem: Its problem.
        rig: The parts of the machine; by default those that the problem declares.
        cycles: How many to return.
        settle: How many to let pass first; by default as many as the orbit's multipliers ask for.
        seed: Of the noise.
        settings: How accurately to follow it, and what to keep.
        on_progress: Called with the part of the time that is simulated.

    Raises:
        InputError: If the rig does not fit the problem, or there is no cycle to return.
        SimulationError: If the machine does not move in such cycles.
    """
    if cycles < 1 or (settle is not None and settle < 0):
        least = "must be at least 1, and `settle` at least 0"
        raise InputError(f"Argument `cycles` {least}, but they are {cycles} and {settle}.")
    parts = rig or default_rig(problem)
    passed = settling_cycles(orbit) if settle is None else settle
    wanted = passed + cycles
    # A cycle may be a little longer than the orbit's; a run that was too short is made again.
    for slack in (1.1, 2.0):
        until = orbit.period * (wanted + 1) * slack
        keep_from = 0.8 * passed * orbit.period if slack == 1.1 else 0.0
        run = simulate_rig(
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
        f"The machine made {counted(len(found), 'cycle')} with a lock where "
        f"{wanted} were expected: it {_outcome(run, found, orbit, problem).value}",
        time=until,
        state=tuple(run.states[-1].tolist()),
    )


def _outcome(
    run: RigRun, cycles: Sequence[RigCycle], orbit: ZenoOrbit, problem: Problem
) -> AttractorKind:
    """Return what a machine settles to that does not move in cycles like the orbit's."""
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


def settling_cycles(orbit: ZenoOrbit) -> int:
    """Return after how many cycles a machine near a stable orbit has settled."""
    radius = max((abs(mu) for mu in orbit.floquet_multipliers), default=math.nan)
    if math.isnan(radius):
        return _SETTLE
    if radius >= 1.0:
        return _MOST
    wanted = math.log(_LEFT) / math.log(radius) if radius > 0.0 else 0.0
    return min(max(math.ceil(wanted), _FEWEST), _MOST)


def default_rig(problem: Problem) -> Rig:
    """Return the parts that a problem declares, else a stop alone, as stiff in its own sizes."""
    if problem.rig is not None:
        return problem.rig
    own, usual = problem.dynamics(problem.values()).own, Contact()
    stiffness = usual.stiffness * own.multiplier / own.gap
    return Rig(contact=Contact(stiffness=stiffness, slowest=usual.slowest * own.gap_rate))


def cut_cycles(touches: Sequence[Touch], orbit: ZenoOrbit) -> tuple[RigCycle, ...]:
    """Return the whole cycles in a sequence of contacts.

    Args:
        touches: The contacts in order.
        orbit: What the cycles are like: how long the lock is that is looked for.
    """
    lock_time = orbit.period - orbit.zeno_time
    locks = [
        lock
        for lock in _stretches(touches, lock_time)
        if lock[-1].end - lock[0].start > _LONG * lock_time
    ]
    found: list[RigCycle] = []
    for before, after in pairwise(locks):
        released, last = before[-1], after[-1]
        between = [t for t in touches if released.start < t.start <= last.start]
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
    """Return the contact with which a lock begins: the first that lasts, else the longest.

    Where vibrations break the lock into pieces, none may last.
    """
    lasting = (touch for touch in group if touch.end - touch.start > _LONG * lock_time)
    return next(lasting, max(group, key=lambda touch: touch.end - touch.start))
