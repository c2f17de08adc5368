"""Check of the certificate of a branch: its ranges one by one, then their connections.

Each range is a certificate with one pass, whose parameter varies over the range. Two neighbouring
ranges share a value of the parameter. There the fixed point of one of them lies in the box of the
other, which holds exactly one fixed point. So both hold the same fixed point.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem, ProblemFile, load_problem
from zeno_orbits.proof.checker.balls import Ball, NotProved, entries, fitting_together, number
from zeno_orbits.proof.checker.branch_verdict import BranchTheorem, BranchVerdict, CheckedRange
from zeno_orbits.proof.checker.certificate import (
    passage_of,
    problem_of_certificate,
    read_data,
    read_machine,
    require_form,
)
from zeno_orbits.proof.checker.claims import Passage, show
from zeno_orbits.proof.checker.lanes import require_rounding
from zeno_orbits.proof.checker.section import Box, ContactSection
from zeno_orbits.proof.checker.system import System
from zeno_orbits.work import ExecutionPlan, FailedPoint, Progress, checked, parallel_map
from zeno_orbits.work import silent as without_reports

BRANCH_KIND = "zeno_orbits branch proof"
_TOP = (
    *("format", "kind", "problem", "digest", "parameters", "branch", "gap_row", "bits", "section"),
    *("ranges", "versions"),
)
_OPTIONAL = ("problem_file", "machine")
_RANGE = ("value", "radius", "pass", "claims")
_CLAIMS = ("exists", "unique", "stable", "repelling", "multipliers", "period")
_MOST_RANGES, _MOST_RECORDS, _MOST_CLAIMS = 100_000, 50_000, 100


@checked
def check_branch(
    certificate: str | Path | Mapping[str, Any],
    problem: Problem | str | Path | None = None,
    *,
    plan: ExecutionPlan | None = None,
    on_progress: Progress = without_reports,
) -> BranchVerdict:
    """Check the certificate of a branch, range by range.

    Args:
        certificate: The path of a certificate, or its content. It is plain data without code.
        problem: The certificate's problem, its name or its file. The default is the bundled problem
            of its name.
        plan: Executor of the work. None works in this process.
        on_progress: Called with the finished part of the ranges.

    Raises:
        InputError: If the input is not the certificate of a branch, or has other formulas, or if
            the hardware numbers of this machine do not round as the bounds assume.
    """
    require_rounding()
    given = load_problem(problem) if isinstance(problem, (str, Path)) else problem
    with fitting_together():
        data = _read(certificate)
        problem = problem_of_certificate(data, given)
        name, ranges = data["branch"], data["ranges"]
        common = {key: x for key, x in data.items() if key not in ("ranges", "branch")}
        bits = data["bits"]
        ends = [_ends(one, bits) for one in ranges]
        points = [
            {"range": one, "from": ends[k][0], "to": ends[k + 1][0] if k + 1 < len(ends) else None}
            for k, one in enumerate(ranges)
        ]
        gap = _order(ends)
        task = _RangeTask(problem=problem, file=None, common=common, name=name)
        found = list[Any]()
        if gap:
            unchecked: list[Any] = ["motion", False, "not checked"]
            found = [{"claims": [unchecked], "state": [], "events": []} for _ in points]
        elif plan is None or problem.file is None:
            for k, point in enumerate(points):
                on_progress(f"{k} of {len(points)} ranges", k / len(points))
                found += task([point])
        else:
            task = replace(task, problem=None, file=problem.file)
            shared = replace(plan, chunk=4, noun="ranges")
            found = list(parallel_map(task, points, shared, on_progress=on_progress))
        if any(isinstance(one, FailedPoint) for one in found):
            raise InputError("A worker was terminated. Check the certificate with more memory.")
        results = [
            CheckedRange.of(one, low, high) for one, (low, high) in zip(found, ends, strict=True)
        ]
        system, section, boxes = _boxes(problem, common, name, ranges)
        numbers = {key: float(number(x, bits).ends()[0]) for key, x in data["parameters"].items()}
        return BranchVerdict(
            theorem=BranchTheorem(
                problem=problem.name,
                digest=data["digest"],
                parameters={key: x for key, x in numbers.items() if key != name},
                name=name,
                section=section.text,
            ),
            ranges=tuple(results),
            gap=gap or _unconnected(section, boxes, found, system),
            bits=bits,
            unchecked=bool(gap),
        )


def is_branch(data: Any) -> bool:
    """Return True if plain data are the certificate of a branch."""
    return isinstance(data, Mapping) and cast("Mapping[str, Any]", data).get("kind") == BRANCH_KIND


def _read(certificate: str | Path | Mapping[str, Any]) -> Mapping[str, Any]:
    data: Any = read_data(certificate)
    if not is_branch(data):
        remedy = "Make one with `zeno-orbits prove ORBIT.json --branch NAME=LOW:HIGH -o FILE`"
        raise InputError(f"The input is not the certificate of a branch. {remedy}.")
    entries(data, *_TOP, *(name for name in _OPTIONAL if name in data))
    require_form(data, BRANCH_KIND, "branch")
    ranges = data["ranges"]
    if not all(isinstance(data.get(key, ""), str) for key in ("problem", "problem_file", "branch")):
        raise InputError("The certificate's names must be texts.")
    if data["branch"] not in data["parameters"]:
        raise InputError("The certificate's `branch` must be a gain or parameter.")
    if not isinstance(ranges, list) or not 0 < len(cast("list[Any]", ranges)) <= _MOST_RANGES:
        raise InputError(f"The certificate must have 1 to {_MOST_RANGES} `ranges`.")
    for one in cast("list[Any]", ranges):
        _require_range(one)
    return data


def _require_range(one: Any) -> None:
    """Check the entries of a range that are read before its proof."""
    _, _, passage, claims = entries(one, *_RANGE)
    _, _, records = entries(passage, "box", "start", "records")
    if not isinstance(records, list) or len(cast("list[Any]", records)) > _MOST_RECORDS:
        raise InputError(f"A range must have a list of at most {_MOST_RECORDS} `records`.")
    if not isinstance(claims, list) or len(cast("list[Any]", claims)) > _MOST_CLAIMS:
        raise InputError(f"A range must have a list of at most {_MOST_CLAIMS} `claims`.")
    for claim in cast("list[Any]", claims):
        if claim["name"] not in _CLAIMS or claim["pass"] != 0 or type(claim["pass"]) is not int:
            raise InputError(f"A range must have claims of {', '.join(_CLAIMS)}, for pass 0.")


def _ends(one: Mapping[str, Any], bits: int) -> tuple[int, int]:
    """Return both ends of a range, in units."""
    value, radius = number(one["value"], bits), number(one["radius"], bits)
    return value.m - radius.m, value.m + radius.m


def _order(ends: Sequence[tuple[int, int]]) -> str:
    """Return how the ranges are not in order or leave a gap, or an empty text."""
    for k, (a, b) in enumerate(itertools.pairwise(ends)):
        if not (a[0] < b[0] and a[1] < b[1]):
            return f"ranges {k + 1} and {k + 2} are not in order"
        if b[0] > a[1]:
            return f"ranges {k + 1} and {k + 2} leave a gap"
    return ""


def _boxes(
    problem: Problem, common: Mapping[str, Any], name: str, ranges: Sequence[Any]
) -> tuple[System, ContactSection, list[Box]]:
    """Return the boxes of all ranges, on the section that they share."""
    try:
        machine, _, _ = read_machine(_as_proof(common, name, ranges[0]), problem)
    except NotProved as failure:
        raise InputError(f"The certificate's problem cannot be proved: {failure}.") from failure
    system = machine.first
    section = ContactSection.of(system, common["section"], machine.names)
    bits = system.bits
    boxes = [
        Box.of(
            system,
            section,
            one["pass"]["box"],
            [(number(one["value"], bits), number(one["radius"], bits))],
        )
        for one in ranges
    ]
    return system, section, boxes


def _unconnected(
    section: ContactSection, boxes: Sequence[Box], found: Sequence[Any], system: System
) -> str:
    """Return where two neighbouring ranges are not shown to hold the same orbit, or no text."""
    for k, (a, b) in enumerate(itertools.pairwise(found)):
        between = f"ranges {k + 1} and {k + 2}"
        if not a["state"] or not b["state"]:
            return f"{between}: a motion is not proved"
        if a["events"] != b["events"]:
            return f"{between} have different events"
        # Both enclose the fixed point at the lower end of the second range.
        out = boxes[k + 1].leaves(section, _state(a["state"][1], system.bits))
        if out and boxes[k].leaves(section, _state(b["state"][0], system.bits)):
            return f"{between} are not shown to hold the same orbit: {out}"
    return ""


def _state(parts: Sequence[Sequence[int]], bits: int) -> Any:
    return np.array([Ball(m, r, bits) for m, r in parts], dtype=object)


def _as_proof(common: Mapping[str, Any], name: str, one: Mapping[str, Any]) -> dict[str, Any]:
    """Return a range as the certificate of a proof with one pass."""
    return {
        **common,
        "parameters": {**common["parameters"], name: one["value"]},
        "over": {name: one["radius"]},
        "passes": [one["pass"]],
        "claims": one["claims"],
    }


class _Range(NamedTuple):
    """A range that is checked."""

    passage: Passage
    claims: list[list[Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class _RangeTask:
    """Check of ranges. A worker loads the problem itself."""

    problem: Problem | None
    file: ProblemFile | None
    common: Mapping[str, Any]
    name: str

    def __call__(self, points: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Return the results of ranges as plain data."""
        problem = self.file.load() if self.problem is None and self.file else self.problem
        if problem is None:
            raise InputError("Argument `problem` must have a file, but it is missing.")
        return [self._checked(problem, point) for point in points]

    def _checked(self, problem: Problem, point: Mapping[str, Any]) -> dict[str, Any]:
        """Check a range.

        The states are those of the fixed point at the lower end of the range, and at that of the
        next range.
        """
        with fitting_together():
            data = _as_proof(self.common, self.name, point["range"])
            try:
                found = _proved_range(problem, data)
            except NotProved as failure:
                return {"claims": [["motion", False, str(failure)]], "state": [], "events": []}
            passage, bits = found.passage, found.passage.bits
            value = number(point["range"]["value"], bits)
            states = list[Any]()
            for end in (point["from"], point["to"]):
                # After the last range there is no shared value.
                at = point["from"] if end is None else end
                offset = np.array([Ball(int(at) - value.m, 0, bits)], dtype=object)
                states.append([[x.m, x.r] for x in passage.state_at(offset)])
            return {
                "claims": found.claims,
                "state": states,
                "inside": not passage.leaves("inclusion"),
                "events": [
                    *passage.word,
                    passage.releases,
                    passage.events[1],
                    passage.events[2],
                    list(passage.told),
                ],
            }


def _proved_range(problem: Problem, data: Mapping[str, Any]) -> _Range:
    """Return the proved motion of a range, and its claims."""
    machine, over, _ = read_machine(data, problem)
    section = ContactSection.of(machine.first, data["section"], machine.names)
    box, start, records = entries(data["passes"][0], "box", "start", "records")
    passage = passage_of(
        machine,
        section,
        Box.of(machine.first, section, box, over),
        start,
        records,
        alone=True,
    )
    claims = list[list[Any]]()
    for claim in data["claims"]:
        try:
            claims.append([claim["name"], True, show(passage, claim)])
        except NotProved as failure:
            claims.append([claim["name"], False, str(failure)])
    away = passage.leaves_both()
    claims.append(["one fixed point", not away, away])
    return _Range(passage, claims)
