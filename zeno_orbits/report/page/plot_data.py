"""The data of a report's plots: plain numbers, rounded to what a screen can show.

Times near the Zeno point are counted from it, so that a zoom by ten decades still finds digits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from itertools import groupby
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import Problem
from zeno_orbits.precision import SAME_WORK, WorkPrecision
from zeno_orbits.report.page.subject import Subject
from zeno_orbits.report.zeno_neighbourhood import CloseUp, close_up
from zeno_orbits.simulation import Ending, Execution, Mode

_POINTS = 4000
"""Points on a curve, roughly: shared out among its arcs."""
_SEEN = 0.004
"""A tail shorter than this part of the motion is too short to see."""
_TAIL = 1e-4
"""Part of the last resolved impact's speed down to which the flights after it are continued."""
_MOST_TAIL = 60
"""Largest number of these flights: near e = 1 there are thousands."""
_SERIES_DECADES = 5
"""Decades of zoom that the digits of the states over time can bear."""
_LEAST = 1e-17
"""Errors below this are drawn at it: the axis is logarithmic."""
_GREEK = {
    "alpha": "α",
    "beta": "β",
    "gamma": "γ",
    "delta": "δ",
    "theta": "θ",
    "phi": "φ",
    "varphi": "φ",
    "psi": "ψ",
    "eta": "η",
    "xi": "ξ",
    "omega": "ω",
}


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
    if execution is None:
        return curves
    curves["portraits"] = _portraits(subject.problem, execution)
    curves["series"] = _series(subject, execution)
    if execution.zeno_points:
        zoom = close_up(execution, subject.dynamics)
        curves["zeno"] = _zeno(zoom, subject.problem.gap_unit)
    return curves


def html_label_of(names: Sequence[str], index: int, unit: str) -> str:
    """Return the label of an axis that shows a state, with its unit, as HTML.

    Args:
        names: Names of all states.
        index: Place of the state among them.
        unit: Its unit.
    """
    name = names[index]
    dotted = name[0] == "d" and name[1:] in names
    stem = name[1:] if dotted else name
    base = stem.rstrip("0123456789")
    number = stem[len(base) :]
    letter = {"current": "i"}.get(base, _GREEK.get(base, base))
    if len(letter) > 1:
        return escape(f"rate of {stem} [{unit}]" if dotted else f"{name} [{unit}]")
    symbol = f"{letter}<sub>{number}</sub>" if number else letter
    return f"d{symbol}/dt [{escape(unit)}]" if dotted else f"{symbol} [{escape(unit)}]"


def _portraits(problem: Problem, execution: Execution) -> list[dict[str, Any]]:
    names, units = problem.state_names, problem.state_units
    paths = _paths(execution)
    drawn: list[dict[str, Any]] = []
    for pair in problem.portraits:
        i, k = (names.index(name) for name in pair)
        impacts = [(impact.state_minus, impact.state_plus) for impact in execution.impacts]
        drawn.append(
            {
                "x": html_label_of(names, i, units[i]),
                "y": html_label_of(names, k, units[k]),
                "title": f"{pair[1]} over {pair[0]}",
                "arcs": [
                    {"kind": kind, "x": _short(states[:, i]), "y": _short(states[:, k])}
                    for kind, _, states in paths
                ],
                "before": _points([before[[i, k]] for before, _ in impacts]),
                "after": _points([after[[i, k]] for _, after in impacts]),
                "zeno": _points([zeno.state[[i, k]] for zeno in execution.zeno_points]),
                "release": _points([release.state[[i, k]] for release in execution.releases]),
            }
        )
    return drawn


def _series(subject: Subject, execution: Execution) -> dict[str, Any]:
    problem, n_q = subject.problem, subject.dynamics.n_q
    names, units = problem.state_names, problem.state_units
    # The clock of a forced problem, states without a unit behind the velocities, tells nothing.
    rows = [*range(2 * n_q), *(k for k in range(2 * n_q, len(names)) if units[k] != "1")]
    paths = _paths(execution)
    labels = [html_label_of(names, row, units[row]) for row in rows]
    entries = [[states[:, row] for _, _, states in paths] for row in rows]
    if problem.outputs:
        values = subject.orbit.values(problem)
        outputs = [problem.output_values(values, x[:, : len(names)]) for _, _, x in paths]
        for k, output in enumerate(problem.outputs):
            labels.append(escape(f"{output.name.replace('_', ' ')} [{output.unit}]"))
            entries.append([column[:, k] for column in outputs])
    return {
        "arcs": [{"kind": kind, "t": _short(times, 14)} for kind, times, _ in paths],
        "rows": [
            {"label": label, "values": [_short(one, 10) for one in row]}
            for label, row in zip(labels, entries, strict=True)
        ],
        "locked": _locked(execution),
        "impacts": [impact.time for impact in execution.impacts],
        "zeno": execution.zeno_points[-1].time if execution.zeno_points else None,
        "end": execution.end_time,
        "decades": _SERIES_DECADES,
    }


def _zeno(zoom: CloseUp, unit: str) -> dict[str, Any]:
    end, e = zoom.zeno.time, zoom.dynamics.restitution
    arcs: list[dict[str, Any]] = []
    for arc in zoom.arcs:
        times, gaps = zoom.gaps(arc)
        arcs.append({"kind": arc.mode.value, "t": _short(times - end), "h": _short(gaps)})
    tail = zoom.tail(max(_TAIL, e**_MOST_TAIL)) if e > 0.0 else []
    seen = [impact for impact in zoom.impacts if impact.time < end]
    left = [end - impact.time for impact in seen]
    last = min([*left, *(-float(offsets[0]) for offsets, _ in tail)], default=0.0)
    law: dict[str, Any] = {"x": [], "y": []}
    if left:
        reach = np.array([left[0], last])
        law = {"x": _short(reach), "y": _short(zoom.pull * (1 - e) / (2 * e) * reach)}
    start = zoom.arcs[0].start_time
    return {
        "unit": escape(unit),
        "arcs": arcs,
        "tail": [{"t": _short(offsets), "h": _short(gaps)} for offsets, gaps in tail],
        "speeds": {"x": left, "y": [-impact.approach_rate for impact in seen]},
        "law": law,
        "length": left[0] if left else 0.3 * (end - start),
        "start": start - end,
        "end": zoom.arcs[-1].end_time - end,
        "decades": math.floor(math.log10(left[0] / last)) if left else 0,
    }


def _trade(trade: WorkPrecision) -> dict[str, Any]:
    drawn = [t for t in trade.trials if t.sweep in SAME_WORK and math.isfinite(t.error)]
    lines: list[dict[str, Any]] = []
    for label, group in groupby(drawn, key=lambda trial: trial.label):
        trials = sorted(group, key=lambda trial: trial.value)
        lines.append(
            {
                "name": escape(label),
                "engine": trials[0].sweep == "engine",
                "x": [max(trial.error, _LEAST) for trial in trials],
                "y": [1e3 * trial.seconds for trial in trials],
            }
        )
    front = {
        "x": [max(trial.error, _LEAST) for trial in trade.front],
        "y": [1e3 * trial.seconds for trial in trade.front],
    }
    return {"lines": lines, "front": front}


def _paths(execution: Execution) -> list[tuple[str, Vector, Vector]]:
    """Return kind, times and states of every arc; tails too short to see are left out."""
    each = max(12, min(150, _POINTS // len(execution.arcs)))
    least = _SEEN * (execution.end_time - execution.arcs[0].start_time)
    paths: list[tuple[str, Vector, Vector]] = []
    for arc in execution.arcs:
        if arc.ending is not Ending.ZENO:
            paths.append((arc.mode.value, *arc.sampled(each)))
        elif arc.end_time - arc.start_time > least:
            paths.append(("tail", *arc.sampled(2)))
    return paths


def _locked(execution: Execution) -> list[list[float]]:
    """Return start and end of every phase on the stop."""
    phases: list[list[float]] = []
    for arc in execution.arcs:
        if arc.mode is not Mode.LOCKED:
            continue
        if phases and phases[-1][1] == arc.start_time:
            phases[-1][1] = arc.end_time
        else:
            phases.append([arc.start_time, arc.end_time])
    return phases


def _points(pairs: Sequence[Vector]) -> dict[str, list[float]]:
    return {"x": _short([pair[0] for pair in pairs]), "y": _short([pair[1] for pair in pairs])}


def _short(values: Sequence[float] | Vector, digits: int = 8) -> list[float]:
    return [float(f"{value:.{digits}g}") for value in values]
