"""Results of a run of a machine: states, forces and voltages over time, contacts, and a record."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.recordings.recording import RecordedSignal, Recording, Source
from zeno_orbits.integrators import Automatic, Engine, Tolerance
from zeno_orbits.model import Contact, OwnScale, Problem, Rig


@dataclass(frozen=True, slots=True, kw_only=True)
class RigSettings:
    """Accuracy of a run, and the part of it to keep.

    Attributes:
        engine: The integrator.
        tolerance: Its local error; by default `rig_tolerance`.
        spacing: Between two records [s], by default a thousandth of the problem's own time;
            contacts are recorded at every step as well.
        keep_from: Nothing earlier is recorded, but contacts are [s].
        most_steps: Steps between two events before the run is given up.
    """

    engine: Engine = field(default_factory=Automatic)
    tolerance: Tolerance | None = None
    spacing: float | None = None
    keep_from: float = 0.0
    most_steps: int = 1_000_000


SPACING = 1e-3
"""Between two records, as a part of the problem's own time."""
_RELATIVE, _ABSOLUTE, _FINEST = 1e-10, 1e-12, 1e-13
"""Local errors of a machine with a soft stop, and the least relative one."""
_OF_DEPTH = 3e-7
"""Part of the depth of a stop under load that an absolute local error of the gap is at most."""


def rig_tolerance(contact: Contact, own: OwnScale) -> Tolerance:
    r"""Return the local error at which a contact's force is known, in the problem's own sizes.

    Under a load :math:`F` the stop gives way by :math:`\delta = (F / k)^{1/n}`. An error of the
    gap is one of the force, relative to :math:`\delta`: a stiff stop turns it into vibrations.

    Args:
        contact: The stop.
        own: Sizes of the problem's numbers; the load is that of the multiplier.
    """
    finer = _finer(contact, own)
    return Tolerance(relative=_RELATIVE * finer, absolute=_ABSOLUTE * finer)


def rate_weight(contact: Contact, own: OwnScale, inertia: float) -> float:
    r"""Return by how much the velocities' local error is larger in contact than the coordinates'.

    It is that of a soft stop, but not below :math:`\omega\epsilon`: the link vibrates on its stop
    with :math:`\omega^2 = n k \delta^{n - 1} / m_n`, and the least error :math:`\epsilon` that a
    gap is held to excites vibrations of that speed. Less would ask for more than rounding leaves.

    Args:
        contact: The stop.
        own: Sizes of the problem's numbers.
        inertia: Normal inertia :math:`m_n`.

    Returns:
        The ratio, a power of ten: stops of like stiffness share compiled steps.
    """
    depth = _depth(contact, own) * own.gap
    stiffness = contact.exponent * contact.stiffness * depth ** (contact.exponent - 1)
    frequency = math.sqrt(stiffness / inertia) * own.time
    rate = max(1.0, frequency * _FINEST / _RELATIVE)
    return 10.0 ** math.floor(math.log10(rate / _finer(contact, own)))


def _finer(contact: Contact, own: OwnScale) -> float:
    """Return by how much local errors are finer than those on a soft stop."""
    return max(min(1.0, _OF_DEPTH * _depth(contact, own) / _ABSOLUTE), _FINEST / _RELATIVE)


def _depth(contact: Contact, own: OwnScale) -> float:
    """Return by how much a stop gives way under load, in units of the own gap."""
    return (own.multiplier / contact.stiffness) ** (1 / contact.exponent) / own.gap


@dataclass(frozen=True, slots=True, kw_only=True)
class Touch:
    """A contact, from its first instant to its last.

    Attributes:
        start: When it begins [s].
        state: State there, ``(n_y,)``.
        approach_rate: Gap rate there, negative unless the run started in contact.
        end: When it ends [s]; infinite if the run ended in it.
        end_state: State there.
        depart_rate: Gap rate there.
    """

    start: float
    state: Vector
    approach_rate: float
    end: float
    end_state: Vector
    depart_rate: float

    def earlier(self, by: float) -> Touch:
        """Return it with times that count from later on."""
        return replace(self, start=self.start - by, end=self.end - by)


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """Readings of the machine's own controller: simulated, not measured.

    Attributes:
        times: ``(n,)`` [s].
        coordinates: As the encoders gave them, ``(n, n_q)``.
        currents: As they were read, ``(n, n_motors)`` [A].
    """

    times: Vector
    coordinates: Vector
    currents: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class RigRun:
    """A simulated run of a machine.

    Attributes:
        problem: Name of the problem.
        rig: The parts of the machine.
        state_names: Name of each state; those of the problem first, then rotors behind gears.
        times: ``(n,)``, not falling [s].
        states: True states, ``(n, n_y)``.
        in_contact: Whether the stop is touched, ``(n,)``.
        contact_force: Force of the stop along the gradient of the gap, ``(n,)``.
        gap: ``(n,)``.
        gap_rate: ``(n,)``.
        current: Of every motor, ``(n, n_motors)`` [A].
        voltage: Over the terminals of every motor, ``(n, n_motors)`` [V].
        touches: Its contacts in order, those before the first record included.
        record: What its computer wrote down, from the first record on.
    """

    problem: str
    rig: Rig
    state_names: tuple[str, ...]
    times: Vector
    states: Vector
    in_contact: Vector
    contact_force: Vector
    gap: Vector
    gap_rate: Vector
    current: Vector
    voltage: Vector
    touches: tuple[Touch, ...]
    record: Record

    def of(self, name: str) -> Vector:
        """Return a state over time by its name, ``(n,)``."""
        return self.states[:, self.state_names.index(name)]

    def between(self, start: float, end: float, *, zero: float = 0.0) -> RigRun:
        """Return the records of a stretch of time; its contacts are those that begin in it.

        Args:
            start: Its beginning [s].
            end: Its end [s].
            zero: Where its own time counts from [s].
        """
        own = slice(bisect_left(self.times, start), bisect_left(self.times, end))
        read = slice(bisect_left(self.record.times, start), bisect_left(self.record.times, end))
        kept = {name: getattr(self, name)[own] for name in _OVER_TIME}
        return replace(
            self,
            **kept,
            times=self.times[own] - zero,
            touches=tuple(t.earlier(zero) for t in self.touches if start <= t.start < end),
            record=Record(
                times=self.record.times[read] - zero,
                coordinates=self.record.coordinates[read],
                currents=self.record.currents[read],
            ),
        )


_OVER_TIME = ("states", "in_contact", "contact_force", "gap", "gap_rate", "current", "voltage")


def recording_of(
    run: RigRun, problem: Problem, notes: Mapping[str, str] | None = None
) -> Recording:
    """Return the record of a run: coordinates and currents as they were read, with their units.

    Args:
        run: The run.
        problem: Its problem.
        notes: What else to say of it.

    Raises:
        ValueError: If the record holds less than two readings.
    """
    n_q, record = run.record.coordinates.shape[1], run.record
    n_motors = record.currents.shape[1]
    ends = [""] if n_motors == 1 else [str(k + 1) for k in range(n_motors)]
    signals = [
        RecordedSignal(name=name, unit=unit, values=values)
        for name, unit, values in zip(
            problem.state_names[:n_q], problem.state_units[:n_q], record.coordinates.T, strict=True
        )
    ]
    signals += [
        RecordedSignal(name=f"current{end}", unit="A", values=values)
        for end, values in zip(ends, record.currents.T, strict=True)
    ]
    return Recording(
        source=Source.SIMULATED,
        problem=problem.name,
        time=record.times,
        signals=tuple(signals),
        notes={"made by": "the virtual rig; nothing here was measured", **(notes or {})},
    )
