"""Results of a run of a machine: states, forces and voltages over time, contacts, and a record."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, any_number, finite_number, not_known
from zeno_orbits.experiment.recordings.contacts import contact_names
from zeno_orbits.experiment.recordings.recording import RecordedSignal, Recording, Source
from zeno_orbits.experiment.recordings.sampling import require_share
from zeno_orbits.integrators import Automatic, Engine, Tolerance
from zeno_orbits.model import CharacteristicScales, Contact, ParameterValues, Problem, Rig, own_time
from zeno_orbits.work import ByValue, Checked, checked


@dataclass(frozen=True, slots=True, kw_only=True)
class RigSettings(Checked):
    """Accuracy of a run, and the records to keep.

    Attributes:
        engine: The integrator.
        tolerance: Local error of the integrator, by default `rig_tolerance`.
        spacing: Time between two records [s], by default a thousandth of the problem's time scale.
            Contacts are also recorded at every step.
        keep_from: Time before which only contacts are recorded [s].
        most_steps: Largest number of steps between two events before the run is aborted.
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


def rig_tolerance(contact: Contact, own: CharacteristicScales) -> Tolerance:
    r"""Return the local error that resolves a contact's force, in the problem's scales.

    Under a load :math:`F` the stop is compressed by :math:`\delta = (F / k)^{1/n}`. An error of the
    gap causes an error of the force, relative to :math:`\delta`. A stiff stop turns this error into
    vibrations.

    Args:
        contact: The stop.
        own: Characteristic scales of the problem. The load is the scale of the contact force.
    """
    finer = _finer(contact, own)
    return Tolerance(relative=_RELATIVE * finer, absolute=_ABSOLUTE * finer)


def rate_weight(contact: Contact, own: CharacteristicScales, inertia: float) -> float:
    r"""Return the ratio of the velocities' local error in contact to the error of the coordinates.

    The error of the velocities is the same as on a soft stop, but not below :math:`\omega\epsilon`.
    The link vibrates on its stop with :math:`\omega^2 = n k \delta^{n - 1} / m_n`, and the smallest
    error :math:`\epsilon` of the gap excites vibrations of that speed. A smaller error would be
    below rounding.

    Args:
        contact: The stop.
        own: Characteristic scales of the problem.
        inertia: Normal inertia :math:`m_n`.

    Returns:
        The ratio, rounded to a power of ten, so that stops of similar stiffness share formulas.
    """
    frequency = _frequency(contact, own, inertia) * own.time
    rate = max(1.0, frequency * _FINEST / _RELATIVE)
    return 10.0 ** math.floor(math.log10(rate / _finer(contact, own)))


def bounce_time(contact: Contact, own: CharacteristicScales, inertia: float) -> float:
    """Return the duration of an undamped bounce on a stop, half a period of its vibration [s].

    Args:
        contact: The stop.
        own: Characteristic scales of the problem.
        inertia: Normal inertia.
    """
    return math.pi / _frequency(contact, own, inertia)


def _frequency(contact: Contact, own: CharacteristicScales, inertia: float) -> float:
    """Return the angular frequency with which a link vibrates on its stop [1/s]."""
    depth = _depth(contact, own) * own.gap
    stiffness = contact.exponent * contact.stiffness * depth ** (contact.exponent - 1)
    return math.sqrt(stiffness / inertia)


def _finer(contact: Contact, own: CharacteristicScales) -> float:
    """Return the factor by which local errors are smaller than on a soft stop."""
    return max(min(1.0, _OF_DEPTH * _depth(contact, own) / _ABSOLUTE), _FINEST / _RELATIVE)


def _depth(contact: Contact, own: CharacteristicScales) -> float:
    """Return the compression of a stop under load, in units of the gap scale."""
    return (own.multiplier / contact.stiffness) ** (1 / contact.exponent) / own.gap


def time_scale_of(problem: Problem, values: ParameterValues) -> float:
    """Return the time scale of a problem: rounded for one stop, of the slowest motion for several.

    Args:
        problem: The problem.
        values: Gains and parameters.
    """
    if not problem.has_graph:
        return problem.dynamics(values).own.time
    return own_time(
        problem.graph_dynamics(values).first,
        np.array(problem.state_vector(problem.starts[0], values)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Touch:
    """A contact, from its first instant to its last.

    Attributes:
        start: When it begins [s].
        state: State at that time, ``(n_y,)``.
        approach_rate: Gap rate there, negative unless the run started in contact.
        end: End time [s]. It is infinite if the run ended in the contact.
        end_state: State at that time.
        depart_rate: Gap rate there.
        stop: Name of the stop.
    """

    start: float
    state: Vector
    approach_rate: float
    end: float
    end_state: Vector
    depart_rate: float
    stop: str = "stop"

    def earlier(self, by: float) -> Touch:
        """Return it with times that count from later on."""
        return replace(self, start=self.start - by, end=self.end - by)


def contacts_at(touches: Sequence[Touch], stops: Sequence[str], times: Vector) -> Vector:
    """Return whether each stop is touched at some times: 1 or 0, ``(n, n_stops)``.

    Args:
        touches: Contacts.
        stops: Name of each stop.
        times: Times, ``(n,)`` [s].
    """
    found = np.zeros((len(times), len(stops)))
    for k, name in enumerate(stops):
        own = sorted((one.start, one.end) for one in touches if one.stop == name)
        starts = np.array([start for start, _ in own])
        ends = np.array([-math.inf, *(end for _, end in own)])
        found[:, k] = times < ends[np.searchsorted(starts, times, side="right")]
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class RigRecord:
    """Readings of the machine's own controller: simulated, not measured.

    Attributes:
        times: ``(n,)`` [s].
        coordinates: Readings of the encoders, ``(n, n_q)``.
        currents: Readings of the currents, ``(n, n_motors)`` [A].
        contacts: 1 while a stop is touched and 0 off it, ``(n, n_stops)``.
        outputs: Outputs of the problem in A and V, ``(n, n_outputs)``. Empty with a controller,
            which reads coordinates and currents only.
    """

    times: Vector
    coordinates: Vector
    currents: Vector
    contacts: Vector
    outputs: Vector

    def part(self, rows: slice, zero: float) -> RigRecord:
        """Return some readings.

        Args:
            rows: The readings.
            zero: Time origin of the result [s].
        """
        kept = {one.name: getattr(self, one.name)[rows] for one in fields(self)}
        return replace(RigRecord(**kept), times=self.times[rows] - zero)


_ELECTRIC = ("A", "V")
"""Units of the outputs that an electrical instrument measures."""


def electric_outputs(problem: Problem) -> list[int]:
    """Return the indices of a problem's outputs in A and V."""
    return [k for k, output in enumerate(problem.outputs) if output.unit in _ELECTRIC]


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class RigRun(ByValue):
    """A simulated run of a machine.

    With several stops, gaps, forces and contacts have one column per stop, ``(n, n_stops)``.

    Attributes:
        problem: Name of the problem.
        rig: The parts of the machine.
        state_names: Name of each state: first the states of the problem, then rotors driven through
            gears.
        stop_names: Name of each stop. The stop of a problem with a gap is named ``stop``.
        times: Nondecreasing times, ``(n,)`` [s].
        states: True states, ``(n, n_y)``.
        in_contact: Whether the stop is touched, ``(n,)``.
        contact_force: Force of the stop along the gradient of the gap, ``(n,)``.
        gap: Gap, ``(n,)``.
        gap_rate: Gap rate, ``(n,)``.
        current: Current of every motor, ``(n, n_motors)`` [A].
        voltage: Voltage over the terminals of every motor, ``(n, n_motors)`` [V].
        touches: Contacts in order, including contacts before the first record.
        record: Readings stored by the controller, from the first record.
    """

    problem: str
    rig: Rig
    state_names: tuple[str, ...]
    stop_names: tuple[str, ...]
    times: Vector
    states: Vector
    in_contact: Vector
    contact_force: Vector
    gap: Vector
    gap_rate: Vector
    current: Vector
    voltage: Vector
    touches: tuple[Touch, ...]
    record: RigRecord

    def __repr__(self) -> str:
        """Return one line: the span of time and the number of contacts."""
        return (
            f"<RigRun of {self.problem} from {self.times[0]:g} to {self.times[-1]:.9g} s: "
            f"times={len(self.times)}, touches={len(self.touches)}>"
        )

    @checked
    def of(self, name: str) -> Vector:
        """Return a state over time by its name, ``(n,)``.

        Raises:
            InputError: If no state has this name.
        """
        if name not in self.state_names:
            raise InputError(f"Argument `name`: {not_known(name, self.state_names)}")
        return self.states[:, self.state_names.index(name)]

    def between(self, start: float, end: float, *, zero: float = 0.0) -> RigRun:
        """Return the records of a time interval, with the contacts that begin in it.

        Args:
            start: Start of the interval [s].
            end: End of the interval [s].
            zero: Time origin of the result [s].

        Raises:
            InputError: If a time is not a number.
        """
        start, end = any_number("start", start), any_number("end", end)
        zero = finite_number("zero", zero)
        own = slice(bisect_left(self.times, start), bisect_left(self.times, end))
        read = slice(bisect_left(self.record.times, start), bisect_left(self.record.times, end))
        kept = {name: getattr(self, name)[own] for name in _OVER_TIME}
        return replace(
            self,
            **kept,
            times=self.times[own] - zero,
            touches=tuple(t.earlier(zero) for t in self.touches if start <= t.start < end),
            record=self.record.part(read, zero),
        )


_OVER_TIME = ("states", "in_contact", "contact_force", "gap", "gap_rate", "current", "voltage")


def require_noise(noise: float, rig: Rig) -> None:
    """Refuse noise outside [0, 1), or noise that is added to a controller's readings.

    Args:
        noise: Noise relative to the range of each signal.
        rig: The parts of the machine.

    Raises:
        InputError: If the noise is refused.
    """
    require_share(noise)
    if noise and rig.controller is not None:
        wanted = "must be left out of a machine with a controller, whose sensors have their own"
        raise InputError(f"Argument `noise` {wanted}: --part sensors.noise.")


def recording_of(
    run: RigRun,
    problem: Problem,
    notes: Mapping[str, str] | None = None,
    *,
    noise: float = 0.0,
    seed: int = 0,
) -> Recording:
    """Return the recording of a run: coordinates, currents, and a contact channel of every stop.

    Args:
        run: The run.
        problem: Its problem.
        notes: Further notes of the recording.
        noise: Standard deviation of noise on coordinates, currents and outputs, relative to the
            range of each. Contact channels stay exact.
        seed: Random seed of this noise.

    Raises:
        InputError: If noise is added to the readings of a controller, whose sensors have their own,
            or is not in [0, 1).
        ValueError: If the record holds fewer than two readings.
    """
    record = run.record
    require_noise(noise, run.rig)
    n_q, n_motors = record.coordinates.shape[1], record.currents.shape[1]
    ends = [""] if n_motors == 1 else [str(k + 1) for k in range(n_motors)]
    named: list[tuple[str, str]] = [
        *zip(problem.state_names[:n_q], problem.state_units[:n_q], strict=True),
        *((f"current{end}", "A") for end in ends[:n_motors]),
    ]
    columns: list[Vector] = [*record.coordinates.T, *record.currents.T]
    if record.outputs.shape[1]:
        chosen = [problem.outputs[k] for k in electric_outputs(problem)]
        named += [(one.name, one.unit) for one in chosen]
        columns += [*record.outputs.T]
    if noise:
        random = np.random.default_rng(seed)
        columns = [one + noise * np.ptp(one) * random.normal(size=one.shape) for one in columns]
    named += [(name, "1") for name in contact_names(run.stop_names)]
    columns += [*record.contacts.T]
    return Recording(
        source=Source.SIMULATED,
        problem=problem.name,
        time=record.times,
        signals=tuple(
            RecordedSignal(name=name, unit=unit, values=np.ascontiguousarray(values))
            for (name, unit), values in zip(named, columns, strict=True)
        ),
        notes={
            "made by": "the virtual rig; nothing here was measured",
            **({"noise": f"{noise:g}"} if noise else {}),
            **(notes or {}),
        },
    )
