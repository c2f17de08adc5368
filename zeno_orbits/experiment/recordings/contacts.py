"""Contact channels of a recording: 1 while a stop is touched, and 0 off the stop.

The channel of a machine with one stop is named ``contact``. With several stops, the channel of a
stop is named ``contact.STOP``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, not_known
from zeno_orbits.experiment.recordings.recording import Recording

CONTACT = "contact"
"""Name of the contact channel of a machine with one stop."""
_FORBIDDEN = ",;\t[](){}"
"""Characters that a title of a recording's file gives another meaning."""


def contact_names(stops: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the contact channels of a machine.

    Args:
        stops: Names of its stops.

    Raises:
        InputError: If the name of a stop cannot be written into a title.
    """
    if len(stops) == 1:
        return (CONTACT,)
    for name in stops:
        if set(name) & set(_FORBIDDEN):
            wanted = "must be without commas, semicolons, tabs and brackets for a recording"
            raise InputError(f"Argument `name` of the stop `{name}` {wanted}.")
    return tuple(f"{CONTACT}.{name}" for name in stops)


def contact_channels(recording: Recording, stops: Sequence[str]) -> dict[str, Vector]:
    """Return the contact channels of a recording, name of the stop to values, ``(n_t,)``.

    A missing value is NaN. Stops without a channel, or without a value in it, are left out.

    Args:
        recording: The recording.
        stops: Names of the machine's stops.

    Raises:
        InputError: If a channel names no stop, or has values other than 0 and 1.
    """
    known = dict(zip(contact_names(stops), stops, strict=True))
    found: dict[str, Vector] = {}
    for signal in recording.signals:
        name = signal.name
        if name not in known and not name.startswith(f"{CONTACT}.") and name != CONTACT:
            continue
        if name not in known:
            word = (
                f" The file is a recording of `{recording.problem}`." if recording.problem else ""
            )
            told = f"contact channel: {not_known(name, known)}{word}"
            raise InputError(f"Argument `recording`: {told}")
        values = signal.values
        odd = np.isfinite(values) & (values != 0.0) & (values != 1.0)
        if signal.unit != "1" or np.any(odd):
            value = f"{values[odd][0]:.6g}" if np.any(odd) else f"the unit {signal.unit}"
            wanted = f"must have only 0 and 1 in its contact channel `{name}`"
            remedy = "Write 1 where the stop is closed and 0 where it is open, without a unit"
            raise InputError(f"Argument `recording` {wanted}, but it has {value}. {remedy}.")
        if np.any(np.isfinite(values)):
            found[known[name]] = values
    return found
