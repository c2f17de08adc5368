"""Judge a certificate: read it, prove its start, its records and its claims, one by one."""

from __future__ import annotations

import json
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem, load_problem
from zeno_orbits.proof.checker.balls import (
    Array,
    Ball,
    NotProved,
    entries,
    number,
    require,
)
from zeno_orbits.proof.checker.claims import CLAIMS, Passage, show
from zeno_orbits.proof.checker.enclosure import Enclosure, require_enclosed
from zeno_orbits.proof.checker.formulas import formulas_of
from zeno_orbits.proof.checker.motion import KINDS, Place
from zeno_orbits.proof.checker.section import Box, Section, require_start
from zeno_orbits.proof.checker.system import LAW, System, bound_system
from zeno_orbits.work import Plan, spread

_TOP = (
    *("format", "kind", "problem", "digest", "parameters", "over", "gap_row", "bits", "section"),
    *("passes", "claims", "versions"),
)
_RECORDS = {
    "step": ("h", "orders"),
    "cross": ("h", "orders", "window", "centre"),
    "impact": (),
    "tail": ("radius", "speed"),
}
_BITS = range(64, 1025)
_CHUNK = 16
"""Records that a process proves before it is asked for more."""
_FEW = 150
"""Records for which no processes are worth their start."""


class ClaimVerdict(NamedTuple):
    """One claim: its name, whether it was proved, and by what, or why not."""

    name: str
    ok: bool
    evidence: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofVerdict:
    """What a check found, claim by claim."""

    problem: str
    claims: tuple[ClaimVerdict, ...]

    @property
    def ok(self) -> bool:
        """True if every claim was proved, and one of them is that there is an orbit."""
        return all(claim.ok for claim in self.claims) and any(
            claim.name == "exists" for claim in self.claims
        )

    def verdict(self) -> str:
        """Return one sentence."""
        failed = next((claim for claim in self.claims if not claim.ok), None)
        if failed is not None:
            return f"Not proved: `{failed.name}`: {failed.evidence}."
        known = {claim.name: claim.evidence for claim in self.claims}
        if not self.ok:
            return "Not proved: no claim says that there is an orbit."
        kind = next((f"{word} " for word in ("stable", "repelling") if word in known), "")
        alone = ", the only one in its box" if "unique" in known else ""
        period = f"; period {known['period']} s" if "period" in known else ""
        return f"Proved: a {kind}periodic orbit of `{self.problem}` exists{alone}{period}."


def check_proof(
    certificate: str | Path | Mapping[str, Any], problem: Problem | None = None
) -> ProofVerdict:
    """Check a certificate, claim by claim, on all cores.

    Args:
        certificate: The path of a certificate, or what is in it.
        problem: What it is about; by default the problem that it names.

    Raises:
        InputError: If it is no certificate, or one of other formulas.
    """
    with _fitting_together():
        data = _read(certificate)
        problem = load_problem(data["problem"]) if problem is None else problem
        system, over = _system(data, problem)
        section = Section.of(system, data["section"])
        passages, verdicts, boxes = list[Passage | str](), list[ClaimVerdict](), list[Box]()
        for k, part in enumerate(data["passes"]):
            box, start, records = entries(part, "box", "start", "records")
            boxes.append(Box.of(system, section, box, over))
            if not boxes[0].holds(boxes[k]):
                raise InputError("The certificate's boxes must lie in the first of them.")
            try:
                passages.append(_passage(system, section, boxes[k], start, records))
                verdicts.append(ClaimVerdict(f"motion {k}", True, f"{len(records)} inclusions"))
            except NotProved as failure:
                passages.append(str(failure))
                verdicts.append(ClaimVerdict(f"motion {k}", False, str(failure)))
        verdicts += [_claimed(passages, claim) for claim in data["claims"]]
    return ProofVerdict(problem=problem.name, claims=tuple(verdicts))


@contextmanager
def _fitting_together() -> Generator[None]:
    """Refuse data of another shape than that of a certificate."""
    try:
        yield
    except InputError:
        raise
    except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        raise InputError(f"The certificate does not fit together ({error!r:.80}).") from error


def _read(certificate: str | Path | Mapping[str, Any]) -> Mapping[str, Any]:
    if not isinstance(certificate, Mapping):
        path = Path(certificate)
        try:
            certificate = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(
                f"File `{path}` must hold a certificate, but it does not ({error})."
            ) from None
    entries(certificate, *_TOP)
    data = cast("Mapping[str, Any]", certificate)
    if (data["format"], data["kind"]) != (1, "zeno_orbits proof") or data["bits"] not in _BITS:
        raise InputError("The certificate must be of format 1 and of 64 to 1024 bits.")
    return data


def _system(data: Mapping[str, Any], problem: Problem) -> tuple[System, list[tuple[Ball, Ball]]]:
    """Return the problem at the certificate's numbers, and its varied parameters."""
    formulas, bits = formulas_of(problem), data["bits"]
    if data["digest"] != formulas.digest:
        raise InputError(f"The certificate is about other formulas than those of `{problem.name}`.")
    if tuple(data["parameters"]) != problem.names:
        raise InputError(f"The certificate must have the numbers {', '.join(problem.names)}.")
    numbers = {name: number(text, bits) for name, text in data["parameters"].items()}
    for name, ball in numbers.items():
        if Fraction(float(Fraction(ball.m, 1 << bits))) != Fraction(ball.m, 1 << bits):
            raise InputError(f"The certificate's `{name}` must be a double.")
    radii = {name: number(text, bits) for name, text in data["over"].items()}
    over = [name for name in numbers if name in radii]
    if over != list(radii) or any(radius.m < 0 for radius in radii.values()):
        raise InputError("The certificate's `over` must be radii of parameters, in their order.")
    row = data["gap_row"]
    if row is not None and (type(row) is not int or not 0 <= row < formulas.n_q):
        raise InputError("The certificate's `gap_row` must be a coordinate.")
    system = bound_system(formulas, numbers, over, row)
    return system, [(numbers[name], radii[name]) for name in over]


def _passage(
    system: System, section: Section, box: Box, start: Any, records: Sequence[Any]
) -> Passage:
    """Prove the start, all records, each by itself, and the return; raise what is not proved."""
    plastic = _is_plastic(system)
    stations = _stations(section, records, plastic=plastic)
    sets = [start, *(record["set"] for record in records)]
    first, last = (_set(system, box, data) for data in (sets[0], sets[-1]))
    try:
        require_start(system, section, box, first)
    except NotProved as failure:
        raise NotProved(f"section: {failure}") from failure
    back = last.hull[section.others] - box.others
    for k, x, reach in zip(section.others, back, box.others_spread, strict=True):
        require(x.size <= reach.r, f"section: state {k} does not return to it")
    judge, tasks = partial(_proved, system, box), list(zip(stations, sets, records, strict=False))
    proved = judge(tasks) if len(tasks) <= _FEW else spread(judge, tasks, Plan(chunk=_CHUNK))
    times = np.array([[Ball(0, 0, system.bits)] * (1 + len(box.spread))])
    events: dict[str, list[Array]] = {"impact_time": [], "zeno_time": []}
    for k, (record, found) in enumerate(zip(records, proved, strict=True)):
        if isinstance(found, str):
            raise NotProved(f"record {k} ({record['kind']}): {found}")
        times = times + np.array([[Ball(m, r, system.bits) for m, r in found]])
        if record["kind"] == "impact":
            events["impact_time"].append(times)
        # A plastic impact is its own Zeno point: the stop holds from there on.
        if record["kind"] == "tail" or (record["kind"] == "impact" and plastic):
            events["zeno_time"].append(times)
    return Passage(
        places=section.places,
        box=box,
        end=last,
        enclosed={**events, "period": [times], "start_state": [first.whole[: system.n_x]]},
    )


def _set(system: System, box: Box, data: Any) -> Enclosure:
    return Enclosure.of(data, box.spread, len(system.z), system.bits)


def _stations(section: Section, records: Sequence[Any], *, plastic: bool) -> list[Place]:
    """Return where in the motion each record stands, if their order is one of a motion."""
    mode, began = section.mode, "release" if section.end == "cross" else "impact"
    stations = list[Place]()
    for k, record in enumerate(records):
        kind = record["kind"]
        entries(record, "kind", "set", *_RECORDS[kind])
        possible = {"impact"} if mode == "closed" else {"step", "cross"}
        if (mode, began) == ("free", "impact"):
            possible.add("tail")
        if kind not in possible:
            raise InputError(f"The certificate's record {k} must be {' or '.join(possible)}.")
        stations.append(Place(mode, began))
        if kind == "step":
            began = ""
        elif kind == "cross":
            mode, began = ("closed", "") if mode == "free" else ("free", "release")
        else:
            held = plastic or kind == "tail"
            mode, began = ("locked", "") if held else ("free", "impact")
    if not records or records[-1]["kind"] != section.end or mode != section.mode:
        raise InputError("The certificate's last record must end on the section.")
    return stations


def _is_plastic(system: System) -> bool:
    """Return True if the restitution is zero, exactly, and not by the value of a state."""
    law = system.outputs[LAW][0]
    varies = not set(system.z).isdisjoint(system.graph.needed([law]))
    return not varies and system.value(LAW, system.nothing)[0].size == 0


def _proved(system: System, box: Box, tasks: Sequence[Any]) -> list[list[list[int]] | str]:
    """Prove records, each with its place and the set before it.

    Returns:
        For every record midpoint and radius of its time and then of the derivatives of that, or why
        it is not proved.
    """
    found = list[list[list[int]] | str]()
    for place, before, record in tasks:
        try:
            with _fitting_together():
                old, new = _set(system, box, before), _set(system, box, record["set"])
                mapped = KINDS[record["kind"]](system, Place(*place), old, record)
                require_enclosed(old, mapped, new)
        except NotProved as failure:
            found.append(str(failure))
            continue
        slope = mapped.time_slope
        times = (mapped.time + slope @ old.Q @ old.E[:, 0], *(slope @ old.whole[:, 1:]))
        found.append([[ball.m, ball.r] for ball in times])
    return found


def _claimed(passages: Sequence[Passage | str], claim: Any) -> ClaimVerdict:
    """Judge one claim."""
    name, which = claim["name"], claim["pass"]
    if name not in CLAIMS or type(which) is not int or not 0 <= which < len(passages):
        raise InputError("The certificate has a claim of no known name, or about no pass.")
    passage = passages[which]
    if isinstance(passage, str):
        return ClaimVerdict(name, False, f"the motion is not proved: {passage}")
    try:
        return ClaimVerdict(name, True, show(passage, claim))
    except NotProved as failure:
        return ClaimVerdict(name, False, str(failure))
