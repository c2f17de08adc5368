"""Measured inputs from files: a column of a CSV file over its times, in SI units."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from zeno_orbits.errors import DataFileError, InputError
from zeno_orbits.experiment.recordings.recording import read_recording
from zeno_orbits.model import Record, in_si, powers_of, record
from zeno_orbits.work import checked


@checked
def read_record(
    path: Path | str,
    column: str,
    *,
    unit: str,
    period: float | None = None,
    kind: str = "linear",
) -> Record:
    """Read a measured input from a column of a file.

    The file is one that `read_recording` reads: titles with units, such as ``time [ms], ground
    [mm]``. Times and samples become SI units.

    Args:
        path: The file.
        column: Name of the column.
        unit: SI unit of the input, such as ``m/s^2``. The recorded unit may have another size.
        period: Period with which the record is repeated [s], or ``None`` to hold its ends.
        kind: Course between samples: ``linear``, ``cubic`` or ``monotone``.

    Raises:
        DataFileError: If the file cannot be read, lacks the column, or holds a gap or another unit.
        InputError: If the unit is not an SI unit, or the samples do not make a record, as for
            `record`.
    """
    path = Path(path)
    try:
        wanted, factor = in_si(unit)
    except ValueError as error:
        raise InputError(f"Argument `unit`: {error}.") from None
    if factor != 1.0:
        raise InputError(
            f"Argument `unit` must be an SI unit, in which the samples are, but it is `{unit}`: "
            f"write `{wanted}`."
        )
    found = read_recording(path, only=(column,))
    signal = next((one for one in found.signals if one.name == column), None)
    if signal is None:
        raise DataFileError(path, f"the column `{column}` is missing: check argument `column`")
    if powers_of(signal.unit or "1") != powers_of(wanted):
        told = f"`{signal.unit}`" if signal.unit else "no unit"
        told = f"column `{column}` has {told}, and the input is in `{unit}`"
        raise DataFileError(path, f"{told}: choose another column, or correct its unit")
    for k in np.flatnonzero(~np.isfinite(signal.values))[:1].tolist():
        raise DataFileError(path, f"column `{column}` is empty at {found.time[k]:g} s: fill it")
    return record(found.time, signal.values, period=period, kind=kind, name=column)
