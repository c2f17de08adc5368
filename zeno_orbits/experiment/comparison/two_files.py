r"""Comparison of two files of one settled motion, on two clocks, with an orbit.

Each file shows the orbit by itself. With the periods :math:`T_1, T_2` that the two clocks show, the
second clock is faster by the part :math:`T_2 / T_1 - 1`. The period counts by the first clock, so
the times of the second file are divided by this ratio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from zeno_orbits.errors import InputError
from zeno_orbits.experiment.comparison.alignment import Alignment
from zeno_orbits.experiment.comparison.comparison import Comparison, compare_recording
from zeno_orbits.experiment.comparison.instruments import InstrumentReading
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Orbit

_MOST = 0.05
"""Largest difference of the rates of two clocks."""


def compare_two_files(
    orbit: Orbit,
    problem: Problem,
    files: tuple[Recording, Recording],
    label: str,
    readings: Sequence[InstrumentReading] = (),
) -> Comparison:
    """Return the comparison of a first file with an orbit, that of a second one inside it.

    Args:
        orbit: The orbit.
        problem: Its problem.
        files: The recordings of one settled motion.
        label: Name of the second file in messages.
        readings: Unknown gains and offsets of channels, which are determined first.

    Raises:
        InputError: If a file has no signal or channel of the problem, a unit measures another
            quantity, or both files have a channel whose gain or offset is unknown.
        SimulationError: If the orbit is not periodic in simulation.
    """
    has = [set(one.names) for one in files]
    for one in readings:
        if one.channel in has[0] & has[1]:
            wanted = f"must name a channel of one file, but both files have `{one.channel}`"
            raise InputError(f"Argument `fit` {wanted}: rename one of the columns.")
    other = [one for one in readings if one.channel in has[1] - has[0]]
    first = compare_recording(
        orbit, problem, files[0], [one for one in readings if one not in other]
    )
    try:
        second = compare_recording(orbit, problem, files[1], other)
        pair = _at(first), _at(second)
        reasons, words = tuple[str, ...](), tuple[str, ...]()
        if pair[0] is not None and pair[1] is not None:
            ratio = pair[1].period / pair[0].period
            if abs(ratio - 1.0) > _MOST:
                reasons = (
                    f"its period is {pair[1].period:.5g} s, and that of the first file "
                    f"{pair[0].period:.5g} s: no two clocks differ by so much",
                )
            else:
                slower = replace(files[1], time=files[1].time / ratio)
                second = compare_recording(orbit, problem, slower, other)
                words = _clock_words((pair[0], pair[1]), files)
    except InputError as error:
        told = str(error).replace("`recording`", "`second_file`")
        raise InputError(told) from error

    def named(rows: Sequence[str]) -> tuple[str, ...]:
        return tuple(f"{label}: {row}" for row in rows)

    return replace(
        first,
        second_file=second,
        reasons=(*first.reasons, *named([*reasons, *second.reasons])),
        unresolved=(*first.unresolved, *named(second.unresolved)),
        remarks=(*first.remarks, *named([*words, *second.remarks])),
        instruments={**first.instruments, **second.instruments},
    )


def _at(found: Comparison) -> Alignment | None:
    """Return the position of the orbit in a recording, unless it shows another motion."""
    return None if found.reasons else found.where


def _clock_words(
    pair: tuple[Alignment, Alignment], files: tuple[Recording, Recording]
) -> tuple[str, ...]:
    """Return what the positions of an orbit in two files tell of the clock of the second one.

    A settled motion repeats, so the offset is known up to whole periods.
    """
    periods = pair[0].period, pair[1].period
    parts = [one.period_error / one.period for one in pair]
    turns = (float(files[0].time[0]) - pair[0].release) / periods[0]
    origin = (float(files[1].time[0]) - pair[1].release) / periods[1]
    ahead = turns + math.ceil(origin - turns)
    phases = pair[0].error / periods[0], pair[1].error / periods[1]
    late = periods[1] * math.hypot(*phases, turns * parts[0], ahead * parts[1])
    rate, unsure = periods[1] / periods[0] - 1.0, math.hypot(*parts) * periods[1] / periods[0]
    return (
        f"its clock shows {pair[1].release + periods[1] * ahead:.7g} +- {late:.2g} s at the "
        f"beginning of the first file, up to whole periods of {periods[1]:.5g} s",
        f"its clock is faster by the part {rate:.3g} +- {unsure:.2g}",
    )
