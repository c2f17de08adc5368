"""Check of a certificate: read it, then prove its start, its records and its claims, one by one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from zeno_orbits.errors import InputError, shortened, shown
from zeno_orbits.model import Problem, load_problem, recorded_problem
from zeno_orbits.proof.checker.balls import (
    Array,
    Ball,
    NotProved,
    entries,
    fitting_together,
    number,
    require,
)
from zeno_orbits.proof.checker.basin import RECORDS as POLYNOMIAL_RECORDS
from zeno_orbits.proof.checker.basin import proved_image
from zeno_orbits.proof.checker.claims import Passage, of_one_orbit, show
from zeno_orbits.proof.checker.enclosure import Enclosure, Mapped, require_enclosed
from zeno_orbits.proof.checker.lanes import orders_of, require_rounding
from zeno_orbits.proof.checker.machine import (
    CertifiedMachine,
    bound_machine,
    read_sides,
    require_first,
    require_reset,
    require_sides,
)
from zeno_orbits.proof.checker.motion import (
    Flow,
    RecordPosition,
    accumulated,
    crossed,
    flows,
    stepped,
    struck,
    switched,
)
from zeno_orbits.proof.checker.section import Box, ContactSection, require_on_section, shown_others
from zeno_orbits.proof.checker.system import System
from zeno_orbits.proof.checker.verdict import ClaimVerdict, ProofVerdict, Theorem
from zeno_orbits.work import ExecutionPlan, checked, parallel_map, read_json

_TOP = (
    *("format", "kind", "problem", "digest", "parameters", "over", "gap_row", "bits", "section"),
    *("passes", "claims", "versions"),
)
_OPTIONAL = ("basin", "problem_file", "machine")
_RECORDS = {
    "step": ("h", "orders"),
    "cross": ("h", "orders", "window", "centre"),
    "impact": (),
    "tail": ("radius", "speed"),
    "switch": (),
}
_FURTHER = {"cross": ("meets",), "impact": ("sides",), "switch": ("sides", "mode", "kept")}
"""Further entries of the records of a machine with several stops, switches or kinks."""
_BEGAN = {"opened": "opened", "thrown": "impact"}
"""Modes after a switch in which a closed stop opens, and the start of the flight that follows."""
_BITS = range(64, 1025)
_MOST = {"passes": 4, "basin": 16, "claims": 20_000, "records": 50_000}
_CHUNK = 300
"""Number of records that a process proves together."""


@checked
def check_proof(
    certificate: str | Path | Mapping[str, Any], problem: Problem | str | Path | None = None
) -> ProofVerdict:
    """Check a certificate, claim by claim, on all cores.

    Args:
        certificate: The path of a certificate, or its content. It is plain data without code.
        problem: The certificate's problem, its name or its file. The default is the bundled problem
            of its name.

    Raises:
        InputError: If the input is not a certificate, or has other formulas, or if the hardware
            numbers of this machine do not round as the bounds assume.
    """
    require_rounding()
    given = load_problem(problem) if isinstance(problem, (str, Path)) else problem
    with fitting_together():
        data = _read(certificate)
        problem = problem_of_certificate(data, given)
        machine, over, theorem = read_machine(data, problem)
        system = machine.first
        section = ContactSection.of(system, data["section"], machine.names)
        passages, verdicts, boxes = list[Passage | str](), list[ClaimVerdict](), list[Box]()
        for k, part in enumerate(_listed(data, "passes")):
            box, start, records = entries(part, "box", "start", "records")
            boxes.append(Box.of(system, section, box, over))
            if not boxes[0].holds(boxes[k]):
                raise InputError("The certificate's boxes must lie in its first box.")
            _listed(part, "records")
            try:
                passage = passage_of(machine, section, boxes[k], start, records)
                passages.append(replace(passage, box_number=k + 1))
                told = f"{len(records)} inclusions"
                verdicts.append(ClaimVerdict(f"motion {k}", True, told, k + 1))
            except NotProved as failure:
                passages.append(str(failure))
                verdicts.append(ClaimVerdict(f"motion {k}", False, str(failure), k + 1))
        claims = _listed(data, "claims")
        verdicts += [_claimed(passages, claim) for claim in claims]
        if not boxes:
            raise InputError("The certificate must have a pass.")
        names = problem.state_names
        theorem = _about(theorem, system, section, boxes, passages, names)
        if "basin" in data and machine.is_graph:
            raise InputError("The certificate's `basin` must be of a machine with one stop.")
        if "basin" in data:
            parts = _listed(data, "basin")
            sets = [Box.of(system, section, part["box"], over) for part in parts]
            found = _basin(machine, section, parts, sets, passages)
            verdicts += found
            theorem = replace(
                theorem,
                basin=_coordinates(section, sets[0], names),
                basin_others=_others(system, section, sets[0], names),
                attracted=len(found) > 1 and found[1].ok,
            )
    return ProofVerdict(theorem=theorem, claims=tuple(verdicts))


_KIND = "zeno_orbits proof"


def read_data(certificate: str | Path | Mapping[str, Any]) -> Any:
    """Return the data of a certificate or its file, unchecked.

    Args:
        certificate: The data, or a path of their file.

    Raises:
        InputError: If the file does not hold data.
    """
    if isinstance(certificate, Mapping):
        return certificate
    try:
        return read_json(Path(certificate))
    except ValueError as error:
        raise InputError(f"File `{Path(certificate)}` is not a certificate ({error}).") from None


def require_form(data: Mapping[str, Any], kind: str, theorem: str) -> None:
    """Refuse another format or accuracy of a certificate.

    Args:
        data: The certificate.
        kind: Its kind.
        theorem: What it proves, for the remedy.

    Raises:
        InputError: If it is of another kind, format or number of bits.
    """
    bits = data["bits"]
    if (data["format"], data["kind"]) != (2, kind) or type(bits) is not int or bits not in _BITS:
        known = "The certificate must be of format 2 and of 64 to 1024 bits"
        raise InputError(f"{known}. Prove the {theorem} again with `zeno-orbits prove`.")


def _read(certificate: str | Path | Mapping[str, Any]) -> Mapping[str, Any]:
    found = read_data(certificate)
    data = cast("Mapping[str, Any]", found)
    is_one = isinstance(found, dict) and data.get("kind") == _KIND
    if not (is_one or isinstance(certificate, Mapping)):
        remedy = "Make one with `zeno-orbits prove ORBIT.json -o FILE`"
        raise InputError(f"File `{Path(certificate)}` is not a certificate. {remedy}.")
    entries(data, *_TOP, *(name for name in _OPTIONAL if name in data))
    require_form(data, _KIND, "orbit")
    for name in ("problem", "problem_file"):
        if not isinstance(data.get(name, ""), str):
            told = f"must be a text, but it is {shown(data[name])}"
            raise InputError(f"The certificate's `{name}` {told}.")
    return data


def problem_of_certificate(data: Mapping[str, Any], given: Problem | None) -> Problem:
    """Return the problem of a certificate. A file that the certificate names is never run.

    Args:
        data: The certificate.
        given: The problem that the caller gives, or None.

    Raises:
        InputError: If the given problem has another name, or no problem is given and the
            certificate does not belong to a bundled problem.
    """
    file = data.get("problem_file", "")
    if given is None and file:
        name, place = shortened(data["problem"]), shortened(Path(file).name)
        remedy = "pass it with --problem FILE.py (`problem=` in Python)"
        raise InputError(f"Problem `{name}`: its file `{place}` is not run by itself, {remedy}.")
    return recorded_problem(data["problem"], given, result="certificate")


def _listed(data: Any, name: str) -> list[Any]:
    """Return a list of a certificate, with a check of its length."""
    found = data[name]
    if not isinstance(found, list) or len(cast("list[Any]", found)) > _MOST[name]:
        raise InputError(f"The certificate's `{name}` must be a list of at most {_MOST[name]}.")
    return cast("list[Any]", found)


def read_machine(
    data: Mapping[str, Any], problem: Problem
) -> tuple[CertifiedMachine, list[tuple[Ball, Ball]], Theorem]:
    """Return the problem at the certificate's parameter values, and the varied parameters.

    Args:
        data: The certificate. Sets and claims are not read, and records for sides of kinks alone.
        problem: Its problem.

    Raises:
        InputError: If the parameter values do not fit the problem.
        NotProved: If a hypothesis of the theorem is not shown.
    """
    bits = data["bits"]
    if tuple(data["parameters"]) != problem.names:
        raise InputError(f"The certificate must have values of {', '.join(problem.names)}.")
    numbers = {name: number(text, bits) for name, text in data["parameters"].items()}
    for name, ball in numbers.items():
        if Fraction(float(ball.ends()[0])) != ball.ends()[0]:
            raise InputError(f"The certificate's `{name}` must be a double.")
    radii = {name: number(text, bits) for name, text in data["over"].items()}
    over = [name for name in numbers if name in radii]
    if over != list(radii) or any(radius.m < 0 for radius in radii.values()):
        raise InputError("The certificate's `over` must be radii of parameters, in their order.")
    ranges = {
        name: Ball(x.m, radii[name].m if name in radii else 0, bits) for name, x in numbers.items()
    }
    for quantity in problem.parameters:
        low, high = ranges[quantity.name].ends()
        out = any(low <= Fraction(x) <= high for x in quantity.excluded)
        if out or low < quantity.lower or high > quantity.upper:
            wanted = f"must be inside its range, {quantity.lower:g} to {quantity.upper:g}"
            raise InputError(f"The certificate's `{quantity.name}` {wanted}.")
    machine = bound_machine(data, problem, numbers, over)
    for view, system in machine.systems.items():
        if system.has_speed_law:
            # It is checked at each impact.
            continue
        z = system.nothing
        z[system.varied] = [ranges[name] for name in over]
        e = system.value("law", z)[0]
        if e.low < 0 or e.high >= 1 << bits or (e.low == 0 and not machine.is_plastic(view)):
            raise InputError("The certificate's restitution must be 0, or between 0 and 1.")
    theorem = Theorem(
        problem=problem.name,
        digest=data["digest"],
        parameters={name: float(ball.ends()[0]) for name, ball in numbers.items()},
        over={name: radius.ends()[0] for name, radius in radii.items()},
    )
    return machine, [(numbers[name], radii[name]) for name in over], theorem


def require_order(data: Mapping[str, Any], problem: Problem) -> None:
    """Check the hypotheses, and the order of the events of each pass.

    Args:
        data: The certificate, or its entries about the system alone.
        problem: Its problem.

    Raises:
        InputError: If the parameter values do not fit the problem, or an event cannot follow.
        NotProved: If a hypothesis of the theorem is not shown.
    """
    machine, _, _ = read_machine(data, problem)
    if "section" in data:
        section = ContactSection.of(machine.first, data["section"], machine.names)
        for part in data["passes"]:
            _stations(machine, section, part["records"], _RECORDS)


def passage_of(
    machine: CertifiedMachine,
    section: ContactSection,
    box: Box,
    start: Any,
    records: Sequence[Any],
    *,
    alone: bool = False,
) -> Passage:
    """Prove the start, each record separately, and the return.

    Args:
        machine: The systems of the certificate.
        section: Its section.
        box: The box of the pass.
        start: Its first set.
        records: Its records.
        alone: True if this process proves all records, as a worker does.

    Raises:
        NotProved: If the start, a record or the return is not proved.
    """
    system = machine.first
    stations = _stations(machine, section, records, _RECORDS)
    sets = [start, *(record["set"] for record in records)]
    first, last = (_set(system, box, data) for data in (sets[0], sets[-1]))
    try:
        require_on_section(system, section, box, first)
        if section.switch >= 0:
            mode = "locked" if section.settled else "free"
            require_first(machine, first.hull, section.switch, mode)
    except NotProved as failure:
        raise NotProved(f"section: {failure}") from failure
    _require_return(section, box, last)
    judge, tasks = partial(_proved, machine, box), list(zip(stations, sets, records, strict=False))
    proved = (
        [one for k in range(0, len(tasks), _CHUNK) for one in judge(tasks[k : k + _CHUNK])]
        if alone or len(tasks) <= _CHUNK
        else parallel_map(judge, tasks, ExecutionPlan(chunk=_CHUNK))
    )
    times = np.array([[Ball(0, 0, system.bits)] * (1 + len(box.spread))])
    events: dict[str, list[Array]] = {"impact_time": [], "zeno_time": []}
    held = [
        record["kind"] == "tail" or (record["kind"] == "impact" and machine.is_plastic(place.view))
        for place, record in zip(stations, records, strict=True)
    ]
    for k, (record, found) in enumerate(zip(records, proved, strict=True)):
        if isinstance(found, str):
            raise NotProved(f"record {k} ({record['kind']}): {found}")
        times = times + np.array([[Ball(m, r, system.bits) for m, r in found]])
        if record["kind"] == "impact":
            events["impact_time"].append(times)
        # A plastic impact is also a Zeno point, since contact starts there.
        if held[k]:
            events["zeno_time"].append(times)
    return Passage(
        places=section.places,
        word=_word(stations, records),
        releases=sum(place.met[0] == "release" for place in stations),
        events=(
            len(events["impact_time"]),
            len(events["zeno_time"]),
            any(held) and not any(record["kind"] == "tail" for record in records),
        ),
        told=_told(machine, stations, records) if machine.is_graph else (),
        box=box,
        box_number=1,
        end=last,
        enclosed={**events, "period": [times], "start_state": [first.whole[: system.n_x]]},
    )


def _require_return(section: ContactSection, box: Box, last: Enclosure) -> None:
    """Prove that the states which the section determines return to the box.

    Raises:
        NotProved: If one does not.
    """
    back = last.hull[section.others] - box.others
    for k, x, reach in zip(section.others, back, box.others_spread, strict=True):
        require(x.size <= reach.r, f"section: state {k} does not return to it")


def _set(system: System, box: Box, data: Any) -> Enclosure:
    return Enclosure.of(data, box.spread, len(system.z), system.bits)


def _stations(
    machine: CertifiedMachine,
    section: ContactSection,
    records: Sequence[Any],
    kinds: Mapping[str, tuple[str, ...]],
) -> list[RecordPosition]:
    """Return the position of each record in the motion, after a check of their order."""
    began = "release" if section.end == "cross" else "impact"
    here, stations = RecordPosition("free", began, machine.start), list[RecordPosition]()
    if section.switch >= 0:
        mode, met = "locked" if section.settled else "free", ("switch", section.switch)
        here = RecordPosition(mode, "", machine.start, met=met)
    first = here
    for k, record in enumerate(records):
        kind = record["kind"]
        further = _FURTHER.get(kind, ()) if machine.is_graph else ()
        possible = {"impact"} if here.mode == "closed" else {"step", "cross"}
        # A plastic stop is met once, so impacts on it do not accumulate.
        if here.mode == "free" and here.began == "impact" and not machine.is_plastic(here.view):
            possible.add("tail")
        if here.switch >= 0:
            possible = {"switch"}
        if kind not in possible:
            raise InputError(f"The certificate's record {k} must be {' or '.join(possible)}.")
        entries(record, "kind", "set", *kinds[kind], *further)
        place, here = _passed(machine, here, record)
        stations.append(place)
    for place in stations:
        # Systems with a held stop are made here, before other processes receive them.
        _ = [machine.systems[view] for view in (place.meets, *machine.closed(*place.contact))]
    ended = here.mode == "free" and here.switch < 0 and here.view == machine.start
    ended = here == first if section.switch >= 0 else ended
    if not records or records[-1]["kind"] != section.end or not ended:
        raise InputError("The certificate's last record must end on the section.")
    return stations


def _passed(
    machine: CertifiedMachine, here: RecordPosition, record: Mapping[str, Any]
) -> tuple[RecordPosition, RecordPosition]:
    """Return the position of a record, and the position after it."""
    kind, sides = record["kind"], here.view.sides
    if kind == "step":
        return here, here._replace(began="", crossed=-1)
    if kind == "cross":
        met = _met(machine, here, record)
        place = here._replace(met=met)
        if met[0] == "switch":
            return place, place._replace(began="", crossed=-1)
        if met[0] == "stop":
            return place, RecordPosition("closed", "", place.meets)
        return place, RecordPosition("free", "release", place.meets)
    if "sides" in record:
        kinks = machine.n_switches - machine.first.n_declared
        sides = read_sides(kinks, record["sides"])
    view = here.view._replace(sides=sides)
    place = here._replace(after=view)
    if kind == "switch":
        _require_other_side(machine, here, sides)
        mode, kept = _after_switch(machine, here, record)
        crossed, began = here.switch if kept else -1, _BEGAN.get(mode, "")
        mode = "free" if mode in _BEGAN else mode
        return place._replace(crossed=crossed), RecordPosition(mode, began, view, crossed)
    held = kind == "tail" or machine.is_plastic(here.view)
    return place, RecordPosition(*(("locked", "") if held else ("free", "impact")), view)


def _require_other_side(
    machine: CertifiedMachine, here: RecordPosition, sides: Sequence[bool]
) -> None:
    """Check that a kink that was crossed is on its other side, and all earlier kinks on theirs."""
    kink, before = here.switch - machine.first.n_declared, here.view.sides
    if kink >= 0 and (sides[kink] == before[kink] or sides[:kink] != before[:kink]):
        raise InputError("The certificate's `sides` must change where a kink is crossed.")


def _after_switch(
    machine: CertifiedMachine, here: RecordPosition, record: Mapping[str, Any]
) -> tuple[str, bool]:
    """Return the mode after a switch, and True if its guard is zero after it.

    Contact lasts, or opens at once, only if gap and gap rate are zero after the switch. A stop is
    left with a speed, as after an impact, only if its gap is zero. The guard is zero after a kink,
    and after a reset that keeps the guard. A held stop stays closed, so the reset moves no gap.
    """
    system, k = machine.systems[here.view], here.switch
    mode, kept = record["mode"], record["kept"]
    declared = k < system.n_declared
    moves, closed = declared and system.moves[k], not declared or system.closed[k]
    require(here.view.held < 0 or not moves, "a switch moves a gap while another stop is closed")
    modes = {"free"} if here.mode == "free" or not closed else {"locked", "opened"}
    if here.mode == "locked" and moves:
        modes |= {"free", "thrown"} if system.rests[k] else {"free"}
    if not isinstance(mode, str) or mode not in modes:
        raise InputError(f"The certificate's `mode` of a switch must be {' or '.join(modes)}.")
    if type(kept) is not int or kept not in ((0, 1) if declared else (1,)):
        raise InputError("The certificate's `kept` of a switch must be 0 or 1, and 1 for a kink.")
    if kept and declared and not system.kept[k]:
        raise InputError("The certificate's `kept` must be 0 for a reset that changes its guard.")
    return mode, bool(kept)


def _met(
    machine: CertifiedMachine, here: RecordPosition, record: Mapping[str, Any]
) -> tuple[str, int]:
    """Return kind and index of the event of a crossing."""
    if not machine.is_graph:
        return "stop" if here.mode == "free" else "release", here.view.stop
    given = record["meets"]
    closed = [view.stop for view in machine.closed(here.view, here.mode)]
    # A third stop is met by no lemma.
    stops = [k for k in range(machine.n_stops) if k not in closed and len(closed) < 2]
    events = {"switch": range(machine.n_switches), "stop": stops, "release": closed}
    known = isinstance(given, list) and len(cast("list[Any]", given)) == 2
    kind, index = cast("list[Any]", given) if known else ("", -1)
    known = isinstance(kind, str) and kind in events and type(index) is int
    if not known or index not in events[kind]:
        raise InputError("The certificate's `meets` must be a stop, a switch or a release.")
    return kind, index


def _told(
    machine: CertifiedMachine, stations: Sequence[RecordPosition], records: Sequence[Any]
) -> tuple[str, ...]:
    """Return the events of a motion in order, in words.

    Impacts on a stop just before its Zeno point belong to it. Impacts on other stops are listed.
    """
    stops, switches = machine.names
    words = list[str]()
    for place, record in zip(stations, records, strict=True):
        released = place.met[0] == "release"
        kind, stop = record["kind"], stops[place.met[1] if released else place.view.stop]
        if kind == "impact":
            words.append(f"impact on {stop}")
        if kind == "tail":
            while words and words[-1] == f"impact on {stop}":
                words.pop()
            words.append(f"Zeno point of {stop}")
        elif kind == "impact" and machine.is_plastic(place.view):
            words[-1] = f"plastic impact on {stop}"
        elif kind == "switch":
            opens = place.mode == "locked" and record["mode"] != "locked"
            release = f" with release of {stop}" if opens else ""
            words.append(f"switch {switches[place.switch]}{release}")
        elif released and kind == "cross":
            words.append(f"release of {stop}")
    return tuple(words)


def _about(
    theorem: Theorem,
    system: System,
    section: ContactSection,
    boxes: Sequence[Box],
    passages: Sequence[Passage | str],
    names: Sequence[str],
) -> Theorem:
    """Return the theorem with its section, its boxes and the numbers of events per period."""
    outer, *inner = (_coordinates(section, box, names) for box in boxes)
    others = tuple(_others(system, section, box, names) for box in boxes)
    theorem = replace(theorem, section=section.text, box=outer, smaller=tuple(inner), others=others)
    first = passages[0]
    if isinstance(first, str):
        return theorem
    impacts, points, plastic = first.events
    return replace(
        theorem,
        followed=True,
        releases=first.releases,
        events=first.told,
        impacts=impacts,
        zeno_points=points,
        plastic=plastic,
        inside=not first.leaves("inclusion"),
    )


def _coordinates(
    section: ContactSection, box: Box, names: Sequence[str]
) -> dict[str, tuple[Fraction, Fraction]]:
    """Return middle and radius of each coordinate of a box."""
    pairs = zip(box.centre, box.spread, strict=True)
    exact = [(centre.ends()[0], spread.ends()[1]) for centre, spread in pairs]
    return dict(zip((names[k] for k in section.places), exact, strict=False))


def _others(
    system: System, section: ContactSection, box: Box, names: Sequence[str]
) -> dict[str, str]:
    """Return the states of a box that are not its coordinates, as decimal intervals."""
    return {names[k]: text for k, text in shown_others(system, section, box).items()}


def _basin(
    machine: CertifiedMachine,
    section: ContactSection,
    parts: Sequence[Any],
    sets: Sequence[Box],
    passages: Sequence[Passage | str],
) -> list[ClaimVerdict]:
    """Check that the return map takes a set into its interior, and then into the first box.

    The image of each set lies in the interior of the set itself or in the next set. The image of
    the last set may lie in the first box, which must be contracted.
    """
    images, failed, system = list[Array](), "", machine.first
    try:
        first = of_one_orbit(passages)[0]
        for k, (part, box) in enumerate(zip(parts, sets, strict=True)):
            entries(part, "degree", "box", "start", "records")
            records = _listed(part, "records")
            stations = _stations(machine, section, records, POLYNOMIAL_RECORDS)
            same = _word(stations, records) == first.word
            require(same, f"set {k} belongs to another return map")
            images.append(proved_image(system, section, box, part, stations))
            away = sets[0].leaves(section, images[0])
            require(not away, away)
    except NotProved as failure:
        failed = f"set {len(images)}: {failure}"
        if len(images) < 1 or sets[0].leaves(section, images[0]):
            return [ClaimVerdict("basin", False, failed)]
    told = f"the return map takes the set into its interior, {len(parts[0]['records'])} inclusions"
    found = [ClaimVerdict("basin", True, told)]
    first = of_one_orbit(passages)[0]
    steps = zip([*sets[1:], first.box], images, strict=False)
    away = next((gone for box, image in steps if (gone := box.leaves(section, image))), "")
    away = failed or away or first.leaves("inclusion")
    # Without further sets, attraction is not claimed.
    if len(parts) > 1 or not away:
        told = away or f"the return map takes the set into box 1 in {len(parts)} steps"
        found.append(ClaimVerdict("attraction", not away, told))
    return found


def _word(stations: Sequence[RecordPosition], records: Sequence[Any]) -> tuple[int, int]:
    """Return the number of releases and switches of a motion, and of impacts after the last one.

    Together with the section, these numbers determine the return map. An execution is
    deterministic, so maps with the same word are equal, for any number of impacts that are proved
    one by one instead of by a tail.
    """
    releases = impacts = 0
    for place, record in zip(stations, records, strict=True):
        if record["kind"] == "cross" and place.met[0] in ("release", "switch"):
            releases, impacts = releases + 1, 0
        impacts += record["kind"] == "impact"
    return releases, impacts if records[-1]["kind"] == "impact" else 0


def _proved(
    machine: CertifiedMachine, box: Box, tasks: Sequence[Any]
) -> list[list[list[int]] | str]:
    """Prove records, each with its position in the motion and the set before it.

    Returns:
        For every record, midpoint and radius of its time and then of the time's derivatives, or the
        reason why it is not proved.
    """
    with fitting_together():
        system = machine.first
        olds = [_set(system, box, before) for _, before, _ in tasks]
        steps = _flows(machine, olds, tasks)
        found = list[list[list[int]] | str]()
        for k, (place, _, record) in enumerate(tasks):
            old, new = olds[k], _set(system, box, record["set"])
            try:
                mapped = _mapped(machine, place, old, record, steps.get(k, ""))
                require_enclosed(old, mapped, new)
                if record["kind"] in ("impact", "switch"):
                    require_sides(machine.systems[place.after], new.hull, place.crossed)
                if record["kind"] == "switch":
                    after = machine.systems[place.after]
                    require_reset(after, new.hull, place.switch, record["mode"])
            except NotProved as failure:
                found.append(str(failure))
                continue
            slope = mapped.time_slope
            times = (mapped.time + slope @ old.Q @ old.E[:, 0], *(slope @ old.whole[:, 1:]))
            found.append([[ball.m, ball.r] for ball in times])
    return found


def _mapped(
    machine: CertifiedMachine,
    place: RecordPosition,
    old: Enclosure,
    record: Mapping[str, Any],
    step: Flow | str,
) -> Mapped:
    """Return the image of the set before a record."""
    system = machine.systems[place.view]
    if record["kind"] == "switch":
        return switched(system, old.hull, old.m, place.switch)
    if record["kind"] == "impact":
        return struck(system, old.hull, old.m)
    if record["kind"] == "tail":
        closed = [machine.systems[view] for view in machine.closed(place.view, "free")]
        return accumulated(system, old.hull, old.m, record, closed)
    if isinstance(step, str):
        raise NotProved(step)
    if record["kind"] == "step":
        return stepped(machine, place, step)
    return crossed(machine, place, step, record)


def _flows(
    machine: CertifiedMachine, olds: Sequence[Enclosure], tasks: Sequence[Any]
) -> dict[int, Flow | str]:
    """Return the flows of all steps and crossings, together for the same mode and orders."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for k, (place, _, record) in enumerate(tasks):
        if "orders" in record:
            high, low = orders_of(record)
            key = place.view, place.mode, record["kind"], high, low
            groups.setdefault(key, []).append(k)
    found: dict[int, Flow | str] = {}
    for (view, mode, kind, *orders), places in groups.items():
        system = machine.systems[view]
        steps = {k: number(tasks[k][2]["h"], system.bits) for k in places}
        found |= dict.fromkeys(places, "the step is not positive")
        steps = {k: step for k, step in steps.items() if step.m > 0}
        if steps:
            sets, whole = [olds[k] for k in steps], kind == "step"
            try:
                made = flows(system, mode, orders, sets, [*steps.values()], whole=whole)
                found |= dict(zip(steps, made, strict=True))
            except NotProved as failure:
                found |= dict.fromkeys(steps, str(failure))
    return found


def _claimed(passages: Sequence[Passage | str], claim: Any) -> ClaimVerdict:
    """Check one claim."""
    name, which = claim["name"], claim["pass"]
    if type(which) is not int or not 0 <= which < len(passages):
        raise InputError("The certificate has a claim for a pass that does not exist.")
    try:
        told = show(of_one_orbit(passages)[which], claim)
        return ClaimVerdict(str(name), True, told, which + 1)
    except NotProved as failure:
        return ClaimVerdict(str(name), False, str(failure), which + 1)
