r"""Errors of the instruments as unknowns of a fit: gain and offset of channels, rate of the clock.

Where the machine has :math:`y` at the time `t`, a channel with the gain `g` and the offset `b` of a
recorder with the clock rate `c` reads

.. math:: \tilde y(\tilde t) = g\,y(t) + b, \qquad \tilde t = (1 + c)\,t + \text{const}.

The phase of a sample is a ratio of recorded times, so `c` changes the recorded period alone.
A second file is folded by its own period. Its delay, in periods, is a further unknown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.folding import Fold
from zeno_orbits.experiment.recordings.recording import Recording


class ReadingKind(Enum):
    """Kind of an error of an instrument. The value is the word in the name of an unknown."""

    GAIN = "gain"
    OFFSET = "offset"
    CLOCK_RATE = "clock_rate"
    DELAY = "delay of the second file"


_RANGES = {
    ReadingKind.GAIN: (0.5, 2.0),
    ReadingKind.OFFSET: (-math.inf, math.inf),
    ReadingKind.CLOCK_RATE: (-0.05, 0.05),
    ReadingKind.DELAY: (-0.5, 0.5),
}
"""Ranges of errors by default. The range of an offset is completed from its channel."""


class InstrumentReading(NamedTuple):
    """An error of an instrument.

    Attributes:
        kind: Its kind.
        channel: Name of the channel, an empty string for the clock.
    """

    kind: ReadingKind
    channel: str


def reading_of(name: str) -> InstrumentReading | None:
    """Return the error that ``CHANNEL.gain``, ``CHANNEL.offset`` or ``clock_rate`` names."""
    for clock in (ReadingKind.CLOCK_RATE, ReadingKind.DELAY):
        if name == clock.value:
            return InstrumentReading(clock, "")
    channel, _, kind = name.rpartition(".")
    for one in (ReadingKind.GAIN, ReadingKind.OFFSET):
        if channel and kind == one.value:
            return InstrumentReading(one, channel)
    return None


def default_range(name: str) -> tuple[float, float] | None:
    """Return the range of an error without a range of its own, ``None`` for another name."""
    found = reading_of(name)
    return None if found is None else _RANGES[found.kind]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Instruments:
    """Errors of the instruments as linear functions of the unknowns, in their units.

    Attributes:
        gains: Derivatives of the gains, ``(n_s, k)``. A gain without any is 1.
        offsets: Derivatives of the offsets, ``(n_s, k)``.
        rate: Derivative of the clock rate, ``(k,)``.
        delay: Derivative of the delay of a second file, ``(k,)``.
    """

    gains: Vector
    offsets: Vector
    rate: Vector
    delay: Vector

    @property
    def has_channel_errors(self) -> bool:
        """True if a channel has an unknown gain or offset."""
        return bool(self.gains.any() or self.offsets.any())

    def gain(self, numbers: Vector) -> Vector:
        """Return the gains of the channels at unknowns, ``(n_s,)``."""
        return np.where(self.gains.any(axis=1), self.gains @ numbers, 1.0)

    def stretch(self, numbers: Vector) -> float:
        """Return the ratio of recorded times to times at unknowns."""
        return 1.0 + float(self.rate @ numbers)

    def read(self, values: Vector, numbers: Vector) -> Vector:
        """Return what the channels read where the machine has values, ``(n, n_s)``."""
        return values * self.gain(numbers) + self.offsets @ numbers

    def fold(self, fold: Fold, numbers: Vector) -> Fold:
        """Return an orbit at the phases of samples as the channels read it."""
        slopes = fold.slopes * self.gain(numbers)
        return replace(fold, values=self.read(fold.values, numbers), slopes=slopes)

    def by_numbers(self, values: Vector) -> Vector:
        """Return the derivatives of what the channels read, ``(n, n_s, k)``."""
        return values[:, :, None] * self.gains + self.offsets


def instruments_of(
    readings: Sequence[Sequence[InstrumentReading]], channels: Sequence[str]
) -> Instruments:
    """Return the errors of the instruments that recorded some channels.

    Args:
        readings: The errors that each unknown stands for, none for a parameter.
        channels: Names of the channels.
    """

    def of(kind: ReadingKind, channel: str) -> list[float]:
        return [float(InstrumentReading(kind, channel) in own) for own in readings]

    shape = (len(channels), len(readings))
    return Instruments(
        gains=np.array([of(ReadingKind.GAIN, one) for one in channels]).reshape(shape),
        offsets=np.array([of(ReadingKind.OFFSET, one) for one in channels]).reshape(shape),
        rate=np.array(of(ReadingKind.CLOCK_RATE, "")),
        delay=np.array(of(ReadingKind.DELAY, "")),
    )


def corrected(
    recording: Recording, channels: Sequence[str], instruments: Instruments, numbers: Vector
) -> Recording:
    """Return a recording without the errors of its channels at unknowns.

    Args:
        recording: The recording.
        channels: Names of its channels.
        instruments: The errors.
        numbers: Values of the unknowns, ``(k,)``.
    """
    gain, offset = instruments.gain(numbers), instruments.offsets @ numbers
    known = dict(zip(channels, zip(gain, offset, strict=True), strict=True))
    return replace(
        recording,
        signals=tuple(
            replace(one, values=(one.values - known[one.name][1]) / known[one.name][0])
            if one.name in known
            else one
            for one in recording.signals
        ),
    )


def rough_errors(
    instruments: Instruments, channels: Sequence[str], recorded: Vector, orbit: Vector
) -> dict[InstrumentReading, float]:
    """Return gains and offsets that give recorded channels the size and the mean of an orbit's.

    Args:
        instruments: The errors that are unknown. The other gains are 1, the other offsets 0.
        channels: Names of the channels, ``n_s``.
        recorded: The channels over whole periods, ``(n, n_s)``, NaN where a sample is missing.
        orbit: The same of the orbit.
    """
    found: dict[InstrumentReading, float] = {}
    scaled = np.any(instruments.gains != 0.0, axis=1).tolist()
    moved = np.any(instruments.offsets != 0.0, axis=1).tolist()
    for s, channel in enumerate(channels):
        rows = recorded[np.isfinite(recorded[:, s]), s], orbit[:, s]
        middle, usual = (float(np.mean(row)) if moved[s] else 0.0 for row in rows)
        sizes = [float(np.std(row) if moved[s] else np.sqrt(np.mean(row**2))) for row in rows]
        gain = sizes[0] / sizes[1] if scaled[s] and min(sizes) > 0.0 else 1.0
        found[InstrumentReading(ReadingKind.GAIN, channel)] = gain
        found[InstrumentReading(ReadingKind.OFFSET, channel)] = middle - gain * usual
    return found
