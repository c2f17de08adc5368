"""Data of a report's plots: plain values, rounded to the resolution of a screen.

Times near the Zeno point are relative to it, so that digits remain after a zoom by ten decades.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Any

from zeno_orbits.arrays import Vector
from zeno_orbits.model import Problem
from zeno_orbits.precision import WorkPrecision
from zeno_orbits.report.motion import GROUND, STOP, frame_of, machine_motion
from zeno_orbits.report.page.subject import Subject
from zeno_orbits.report.paths import ArcPath, drawn_paths, drawn_phases_of, shown_states
from zeno_orbits.report.push_panels import PushPanel, push_panels
from zeno_orbits.report.symbols import direction_symbol, html_symbol
from zeno_orbits.report.trade_lines import front_line, trade_lines
from zeno_orbits.report.zeno_neighbourhood import CloseUp, close_ups
from zeno_orbits.simulation import Execution, Mode

_POINTS = 4000
"""Points on a curve, roughly: shared out among its arcs."""
_TAIL = 1e-4
"""Part of the last resolved impact's speed down to which the flights after it are continued."""
_MOST_TAIL = 60
"""Largest number of these flights: near e = 1 there are thousands."""
_FRAMES = 150
"""Number of frames of the mechanism over a period. Its corners move linearly between two frames."""
_SERIES_DECADES = 5
"""Decades of zoom that the digits of the states over time can bear."""


def curves_of(subject: Subject) -> dict[str, Any]:
    """Return the data of all plots that the subject has, plain and finite."""
    curves: dict[str, Any] = {}
    certificate, execution = subject.certificate, subject.execution
    if certificate.multipliers:
        curves["stability"] = {
            "re": [value.real for value in certificate.multipliers],
            "im": [value.imag for value in certificate.multipliers],
        }
    if subject.trade is not None:
        curves["trade"] = _trade(subject.trade)
    if subject.pushes is not None:
        curves["pushes"] = [_pushes(one) for one in push_panels(subject.pushes)]
    if execution is None:
        return curves
    curves["portraits"] = _portraits(subject.problem, execution)
    curves["series"] = _series(subject, execution)
    if subject.problem.drawing is not None:
        curves["machine"] = _machine(subject, execution)
    zooms = close_ups(execution, subject.dynamics)
    curves["zeno"] = [_zeno(zoom, subject.problem.gap_unit) for zoom in zooms]
    return curves


def _portraits(problem: Problem, execution: Execution) -> list[dict[str, Any]]:
    names, paths = problem.state_names, _paths(execution)
    drawn: list[dict[str, Any]] = []
    for pair in problem.portraits:
        i, k = (names.index(name) for name in pair)
        drawn.append(
            {
                "x": _label(problem, i),
                "y": _label(problem, k),
                "arcs": [
                    {
                        "kind": path.kind,
                        "on": _on(path),
                        "x": _short(path.states[:, i]),
                        "y": _short(path.states[:, k]),
                    }
                    for path in paths
                ],
                "before": _points([impact.state_minus[[i, k]] for impact in execution.impacts]),
                "after": _points([impact.state_plus[[i, k]] for impact in execution.impacts]),
                "zeno": _points([zeno.state[[i, k]] for zeno in execution.zeno_points]),
                "release": _points([release.state[[i, k]] for release in execution.releases]),
                "switch": _points([one.state_minus[[i, k]] for one in execution.switches]),
                "reset": _points([one.state_plus[[i, k]] for one in execution.switches]),
            }
        )
    return drawn


def _series(subject: Subject, execution: Execution) -> dict[str, Any]:
    problem, rows, paths = subject.problem, shown_states(subject.problem), _paths(execution)
    labels = [_label(problem, row) for row in rows]
    entries = [[path.states[:, row] for path in paths] for row in rows]
    if problem.outputs:
        values, n_x = subject.orbit.values(problem), len(problem.state_names)
        outputs = [problem.output_values(values, path.states[:, :n_x]) for path in paths]
        for k, output in enumerate(problem.outputs):
            labels.append(f"{html_symbol(output.name)} [{escape(output.unit)}]")
            entries.append([column[:, k] for column in outputs])
    return {
        "arcs": [
            {"kind": path.kind, "on": _on(path), "t": _short(path.times, 14)} for path in paths
        ],
        "rows": [
            {"label": label, "values": [_short(one, 10) for one in row]}
            for label, row in zip(labels, entries, strict=True)
        ],
        "locked": [
            [phase.start, phase.end]
            for phase in drawn_phases_of(execution)
            if phase.mode is Mode.LOCKED
        ],
        "impacts": [impact.time for impact in execution.impacts],
        "switches": [switch.time for switch in execution.switches],
        "zeno": execution.zeno_points[-1].time if execution.zeno_points else None,
        "end": execution.end_time,
        "decades": _SERIES_DECADES,
    }


def _machine(subject: Subject, execution: Execution) -> dict[str, Any]:
    """Return the lines of the machine at even times, the stop first and points last."""
    orbit, problem = subject.orbit, subject.problem
    motion = machine_motion(problem, orbit.values(problem), execution, orbit.period, n=_FRAMES)
    still = (STOP, GROUND)
    order = sorted(
        motion.lines, key=lambda name: (motion.lines[name].shape[1] == 1, name not in still)
    )
    (left, right), (low, high) = frame_of(motion)
    return {
        # Upwards is down on a screen.
        "box": [left, -high, right - left, high - low],
        "period": orbit.period,
        "modes": [mode.value for mode in motion.modes],
        "lines": [
            {
                "stop": name in still,
                "corners": [_short(corners.ravel(), 5) for corners in motion.lines[name]],
            }
            for name in order
        ],
    }


def _zeno(zoom: CloseUp, unit: str) -> dict[str, Any]:
    end, e = zoom.zeno.time, zoom.dynamics.restitution
    arcs: list[dict[str, Any]] = []
    for arc in zoom.arcs:
        times, gaps = zoom.gaps(arc)
        arcs.append({"kind": arc.mode.value, "t": _short(times - end), "h": _short(gaps)})
    tail = zoom.tail(max(_TAIL, e**_MOST_TAIL)) if e > 0.0 else []
    left, speeds = zoom.speeds()
    reach, law = zoom.law(tail)
    start = zoom.arcs[0].start_time
    return {
        "unit": escape(unit),
        "arcs": arcs,
        "tail": [{"t": _short(offsets), "h": _short(gaps)} for offsets, gaps in tail],
        "speeds": {"x": left.tolist(), "y": speeds.tolist()},
        "law": {"x": _short(reach), "y": _short(law)},
        "length": float(left[0]) if left.size else 0.3 * (end - start),
        "start": start - end,
        "end": zoom.arcs[-1].end_time - end,
        "decades": math.floor(math.log10(left[0] / reach[1])) if left.size else 0,
    }


def _trade(trade: WorkPrecision) -> dict[str, Any]:
    *lines, front = [
        {
            "name": escape(line.label),
            "engine": line.is_engine,
            "x": line.errors,
            "y": line.milliseconds,
        }
        for line in (*trade_lines(trade), front_line(trade))
    ]
    return {"lines": lines, "front": front}


def _pushes(panel: PushPanel) -> dict[str, Any]:
    """Return one direction, with phases and impulses as they are in the file."""
    along = direction_symbol(panel.direction, html_symbol)
    return {
        "label": f"impulse along {along} [{escape(panel.unit)}]",
        "range": [panel.phases[0] - panel.step / 2, panel.phases[-1] + panel.step / 2],
        "step": panel.step,
        "contact": list(panel.contact),
        "lost": {
            "x": [phase for phase, _ in panel.lost],
            "y": [impulse for _, impulse in panel.lost],
            "beyond": [escape(beyond) for beyond in panel.beyond],
        },
        "kept": {
            "x": [phase for phase, _ in panel.kept],
            "y": [impulse for _, impulse in panel.kept],
        },
    }


def _on(path: ArcPath) -> str:
    """Return the words that add the names of the closed stops, if they have names."""
    return f": {escape(', '.join(path.closed))}" if path.closed else ""


def _paths(execution: Execution) -> list[ArcPath]:
    return drawn_paths(execution, least=max(12, min(150, _POINTS // len(execution.arcs))))


def _label(problem: Problem, index: int) -> str:
    """Return the label of an axis that shows a state, with its unit, as HTML."""
    symbol = html_symbol(problem.state_names[index], problem.state_names)
    return f"{symbol} [{escape(problem.state_units[index])}]"


def _points(pairs: Sequence[Vector]) -> dict[str, list[float]]:
    return {"x": _short([pair[0] for pair in pairs]), "y": _short([pair[1] for pair in pairs])}


def _short(values: Sequence[float] | Vector, digits: int = 8) -> list[float]:
    return [float(f"{value:.{digits}g}") for value in values]
