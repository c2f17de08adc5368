"""What a machine's computer wrote down, as a recording: simulated, and labelled so."""

from __future__ import annotations

from collections.abc import Mapping

from zeno_orbits.problem import Problem
from zeno_orbits.recordings import Recording, Signal, Source
from zeno_orbits.rig.run import RigRun


def recording_of(
    run: RigRun, problem: Problem, notes: Mapping[str, str] | None = None
) -> Recording:
    """Return the record of a run: coordinates and currents as they were read, with their units.

    Args:
        run: The run.
        problem: Its scene.
        notes: What else to say of it.

    Raises:
        ValueError: If the record holds less than two readings.
    """
    n_q, record = run.record.coordinates.shape[1], run.record
    n_motors = record.currents.shape[1]
    ends = [""] if n_motors == 1 else [str(k + 1) for k in range(n_motors)]
    signals = [
        Signal(name=name, unit=unit, values=values)
        for name, unit, values in zip(
            problem.state_names[:n_q], problem.state_units[:n_q], record.coordinates.T, strict=True
        )
    ]
    signals += [
        Signal(name=f"current{end}", unit="A", values=values)
        for end, values in zip(ends, record.currents.T, strict=True)
    ]
    return Recording(
        source=Source.SIMULATED,
        scene=problem.name,
        time=record.times,
        signals=tuple(signals),
        notes={"made by": "the virtual rig; nothing here was measured", **(notes or {})},
    )
