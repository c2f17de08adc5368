"""The unknowns of a fit: parameters and errors of instruments, with ranges and initial values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, did_you_mean
from zeno_orbits.experiment.comparison.instruments import (
    InstrumentReading,
    Instruments,
    ReadingKind,
    instruments_of,
    reading_of,
    rough_errors,
)
from zeno_orbits.experiment.recordings.contacts import CONTACT
from zeno_orbits.model import ParameterValues, Problem


@dataclass(frozen=True, slots=True, kw_only=True)
class FitParameter:
    """A parameter or an error of an instrument that a fit determines.

    Attributes:
        names: The fitted parameter, or several parameters that are tied together. The errors are
            ``CHANNEL.gain``, ``CHANNEL.offset`` and ``clock_rate``.
        lower: Smallest value.
        upper: Largest value. The range of an offset may be infinite. It is then as wide as that of
            the channel to both sides.
    """

    names: tuple[str, ...]
    lower: float
    upper: float

    @property
    def label(self) -> str:
        """Name of the unknown: the names of its parameters."""
        return "+".join(self.names)

    @property
    def readings(self) -> tuple[InstrumentReading, ...]:
        """The errors of instruments, empty for parameters."""
        found = map(reading_of, self.names)
        return tuple(one for one in found if one is not None)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Unknowns:
    """The unknowns of a fit, and where they are in gains and parameters.

    The fit itself varies them relative to their scales, and a shift of the phase.

    Attributes:
        base: Gains, then parameters, at the start, ``(n_p,)``.
        places: Indices of the ``m`` parameters that vary.
        ties: Matrix from unknowns to the parameters that vary, ``(m, k)``.
        readings: The errors of instruments that each unknown stands for, none for a parameter.
        start: Initial values of the unknowns, ``(k,)``.
        scale: Scales of the unknowns, ``(k,)``.
        lower: Lower bounds of the unknowns, ``(k,)``.
        upper: Upper bounds of the unknowns, ``(k,)``.
        elsewhere: Channels of another file, which unknowns may name too.
    """

    base: Vector
    places: tuple[int, ...]
    ties: Vector
    readings: tuple[tuple[InstrumentReading, ...], ...]
    start: Vector
    scale: Vector
    lower: Vector
    upper: Vector
    elsewhere: tuple[str, ...] = ()

    @property
    def first(self) -> Vector:
        """Scaled unknowns at the start, ``(k + 1,)``: values divided by scales, and zero shift."""
        return np.append(self.start / self.scale, 0.0)

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        """Least and greatest unknowns, each ``(k + 1,)``."""
        return np.append(self.lower / self.scale, -0.5), np.append(self.upper / self.scale, 0.5)

    def numbers(self, x: Vector) -> Vector:
        """Return the values of the unknowns, ``(k,)``."""
        return x[:-1] * self.scale

    def p_at(self, x: Vector) -> Vector:
        """Return gains and parameters at unknowns of the fit."""
        p = self.base.copy()
        p[list(self.places)] = self.ties @ self.numbers(x)
        return p

    @property
    def additive(self) -> tuple[bool, ...]:
        """Mask of the unknowns whose value lacks a scale of its own: offsets and the clock rate."""
        return tuple(any(one.kind is not ReadingKind.GAIN for one in own) for own in self.readings)

    def instruments(self, channels: Sequence[str]) -> Instruments:
        """Return the errors of the instruments of recorded channels.

        Raises:
            InputError: If an unknown names another channel.
        """
        for own in self.readings:
            for kind, channel in own:
                if channel and channel not in (*channels, *self.elsewhere):
                    has = ", ".join(channels) or "none"
                    wanted = f"must name a recorded channel ({has})"
                    named = f"`{channel}.{kind.value}`"
                    if channel.partition(".")[0] == CONTACT:
                        named += ": a contact channel lacks gain and offset"
                    near = did_you_mean(channel, channels)
                    raise InputError(f"Argument `fit` {wanted}, but it names {named}.{near}")
        return instruments_of(self.readings, channels)

    def near(self, channels: Sequence[str], recorded: Vector, orbit: Vector) -> Unknowns:
        """Return the unknowns with errors of channels at which they are like an orbit's.

        Args:
            channels: Names of the channels, ``n_s``.
            recorded: The channels over whole periods, ``(n, n_s)``, NaN where a sample is missing.
            orbit: The same of the orbit.
        """
        guess = rough_errors(self.instruments(channels), channels, recorded, orbit)
        size = dict(zip(channels, np.ptp(orbit, axis=0).tolist(), strict=True))
        start, scale, lower, upper = (
            row.copy() for row in (self.start, self.scale, self.lower, self.upper)
        )
        for k, own in enumerate(self.readings):
            known = [guess[one] for one in own if one in guess]
            if not known:
                continue
            value = float(np.mean(known))
            if own[0].kind is ReadingKind.OFFSET:
                scale[k] = max(size[one.channel] for one in own) or 1.0
            lower[k] = value - scale[k] if math.isinf(lower[k]) else lower[k]
            upper[k] = value + scale[k] if math.isinf(upper[k]) else upper[k]
            if lower[k] < value < upper[k]:
                start[k] = value
        return replace(self, start=start, lower=lower, upper=upper, scale=scale)


def begin_of(
    problem: Problem, values: ParameterValues, sought: Sequence[FitParameter]
) -> ParameterValues:
    """Return the initial values: every unknown inside its range, tied parameters equal.

    Args:
        problem: The problem.
        values: All parameter values of the problem.
        sought: The unknowns.

    Raises:
        InputError: If a name or a range is invalid.
    """
    if not sought:
        raise InputError("Argument `fit` must name a parameter.")
    taken: list[str] = []
    parameters = dict(values.parameters)
    for one in sought:
        for name in one.names:
            if name in taken:
                raise InputError(f"Argument `fit` must name `{name}` once, not twice.")
            taken.append(name)
        kinds = {_kind_of(name, values) for name in one.names}
        if not one.lower < one.upper:
            bounds = f"[{one.lower:g}, {one.upper:g}]"
            wanted = f"must have a range LOW:HIGH for `{one.label}`"
            raise InputError(f"Argument `fit` {wanted}, but it is {bounds}.")
        if len(kinds) > 1:
            wanted = "must tie parameters, gains or offsets, each with their own kind"
            raise InputError(f"Argument `fit` {wanted}, but it ties `{one.label}`.")
        if None in kinds:
            value = _inside(one, parameters[one.names[0]])
            parameters |= dict.fromkeys(one.names, value)
        if ReadingKind.GAIN in kinds and one.lower <= 0.0:
            wanted = f"must have a range above 0 for `{one.label}`"
            raise InputError(f"Argument `fit` {wanted}, but it is [{one.lower:g}, {one.upper:g}].")
    return problem.values(gains=values.gains, parameters=parameters)


def _kind_of(name: str, values: ParameterValues) -> ReadingKind | None:
    """Return the kind of the error of an instrument that a name is, ``None`` for a parameter.

    Raises:
        InputError: If the name is neither.
    """
    if name in values.parameters:
        return None
    reading = reading_of(name)
    if reading is not None:
        return reading.kind
    known = ", ".join(values.parameters)
    hint = "; gains are known" if name in values.gains else ""
    wanted = f"must name parameters ({known}), CHANNEL.gain, CHANNEL.offset or clock_rate"
    channel, _, kind = name.partition(".")
    meant = [*values.parameters, "clock_rate", *(f"{channel}.{one}" for one in _KINDS if kind)]
    near = did_you_mean(name, meant)
    raise InputError(f"Argument `fit` {wanted}, but it names `{name}`{hint}.{near}")


_KINDS = ("gain", "offset")
"""Errors of the instrument of a channel."""


def _inside(one: FitParameter, value: float) -> float:
    """Return a value, or the middle of the range if it is outside."""
    return value if one.lower < value < one.upper else (one.lower + one.upper) / 2


def unknowns_of(
    problem: Problem, begin: ParameterValues, sought: Sequence[FitParameter]
) -> Unknowns:
    """Return the unknowns as indices into gains and parameters, and errors of instruments.

    Args:
        problem: The problem.
        begin: All initial parameter values.
        sought: The unknowns.
    """
    fitted = [one for one in sought if one.names[0] in begin.parameters]
    names = [name for one in fitted for name in one.names]
    ties = np.array([[float(name in one.names) for one in sought] for name in names])
    ties = ties.reshape(len(names), len(sought))
    start = np.array(
        [
            begin.parameters[one.names[0]]
            if one in fitted
            else _inside(one, float(one.readings[0].kind is ReadingKind.GAIN))
            for one in sought
        ]
    )
    # Errors of instruments have their own sizes: 1, or the range of a channel.
    own = np.array(
        [one in fitted and value != 0.0 for one, value in zip(sought, start, strict=True)]
    )
    return Unknowns(
        base=np.array(begin.vector, dtype=np.float64),
        places=tuple(problem.names.index(name) for name in names),
        ties=ties,
        readings=tuple(() if one in fitted else one.readings for one in sought),
        start=start,
        scale=np.where(own, np.abs(start), 1.0),
        lower=np.array([one.lower for one in sought]),
        upper=np.array([one.upper for one in sought]),
    )
