"""No structural change of a proof of a machine is accepted: 500 of them, and coinciding events."""

from __future__ import annotations

import copy
import json
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import pytest

import zeno_orbits as zo
from tests.support import switched
from tests.support.cases import often
from zeno_orbits.errors import InputError
from zeno_orbits.model import CompletedSystem, Problem, load_problem
from zeno_orbits.proof import check_proof
from zeno_orbits.proof.checker import certificate as judged
from zeno_orbits.proof.checker.formulas import CheckedView, formulas_of_view, joined_digest

Certificate = dict[str, Any]
Change = Callable[[Certificate, random.Random, Certificate], Any]

MACHINES: dict[str, Callable[[], Problem]] = {
    "wheel": switched.rimless_wheel,
    "relay": switched.relay_loop,
    "block": switched.pushed_block,
    "hopper": lambda: load_problem("hopper"),
}


def _records(c: Certificate, r: random.Random) -> list[Any]:
    return r.choice(c["passes"])["records"]


def _of_kind(c: Certificate, r: random.Random, *kinds: str) -> Any:
    found = [one for part in c["passes"] for one in part["records"] if one["kind"] in kinds]
    return r.choice(found) if found else {}


def _removed(c: Certificate, r: random.Random, _: Certificate) -> None:
    records = _records(c, r)
    del records[r.randrange(len(records))]


def _repeated(c: Certificate, r: random.Random, _: Certificate) -> None:
    records = _records(c, r)
    k = r.randrange(len(records))
    records.insert(k, copy.deepcopy(records[k]))


def _exchanged(c: Certificate, r: random.Random, _: Certificate) -> None:
    records = _records(c, r)
    k = r.randrange(len(records) - 1)
    records[k], records[k + 1] = records[k + 1], records[k]


def _sets_exchanged(c: Certificate, r: random.Random, _: Certificate) -> None:
    a, b = r.sample(_records(c, r), 2)
    a["set"], b["set"] = b["set"], a["set"]


def _without_entry(c: Certificate, r: random.Random, _: Certificate) -> None:
    record = r.choice(_records(c, r))
    places = [c, c["section"], c["machine"], record, record["set"], r.choice(c["claims"])]
    one = r.choice([*places, c["passes"][0], c["passes"][0]["box"]])
    del one[r.choice(sorted(one))]


def _another_kind(c: Certificate, r: random.Random, _: Certificate) -> None:
    record = r.choice(_records(c, r))
    record["kind"] = r.choice([k for k in judged._RECORDS if k != record["kind"]])


def _meets_another(c: Certificate, r: random.Random, _: Certificate) -> None:
    record = _of_kind(c, r, "cross")
    kinds = [[kind, k] for kind in ("stop", "release", "switch") for k in (-1, 0, 1, True)]
    record["meets"] = r.choice([one for one in kinds if one != record["meets"]])


def _another_switch(c: Certificate, r: random.Random, _: Certificate) -> None:
    record = _of_kind(c, r, "switch")
    name = r.choice(("mode", "kept"))
    values: dict[str, list[Any]] = {
        "mode": ["free", "locked", "opened", "closed", None],
        "kept": [0, 1, 2, True, "1"],
    }
    record[name] = r.choice([x for x in values[name] if repr(x) != repr(record[name])])


def _another_side(c: Certificate, r: random.Random, _: Certificate) -> None:
    found = [_of_kind(c, r, "switch", "impact"), c["machine"]]
    one = r.choice([x for x in found if x.get("sides")] or [{"sides": [0]}])
    k = r.randrange(len(one["sides"]))
    one["sides"][k] = r.choice([1 - one["sides"][k], True, 2])


def _another_section(c: Certificate, r: random.Random, _: Certificate) -> None:
    kinds = [["gap"], ["guard"], ["gap", "gap_rate", "multiplier"], ["gap", "gap_rate", "guard"]]
    section, first = c["section"], list(c["section"]["conditions"])
    section["conditions"] = r.choice([one for one in [*kinds, []] if one != first])
    if "guard" in section["conditions"]:
        section["switch"] = r.choice((0, 1, -1))
    else:
        section.pop("switch", None)


def _another_start(c: Certificate, r: random.Random, _: Certificate) -> None:
    change = r.choice(("stop", "gap_row", "places", "switch"))
    if change == "stop":
        c["machine"]["stop"] = r.choice((-1, 1, True))
    elif change == "gap_row":
        c["gap_row"] = r.choice([x for x in (None, 0, 1) if x != c["gap_row"]])
    elif change == "places":
        c["section"]["places"] = c["section"]["places"][1:] + [r.choice((0, 1, 7, -1))] * 2
    else:
        c["section"]["switch"] = r.choice((-1, 5, 1.0, None))


def _from_another_machine(c: Certificate, r: random.Random, other: Certificate) -> None:
    records = _records(c, r)
    k = r.randrange(len(records))
    donor = copy.deepcopy(r.choice(_records(other, r)))
    parts = {
        "record": lambda: records.__setitem__(k, donor),
        "set": lambda: records[k].update(set=donor["set"]),
        "passes": lambda: c.update(passes=copy.deepcopy(other["passes"])),
        "digest": lambda: c.update(digest=other["digest"]),
        "parameters": lambda: c.update(parameters=other["parameters"]),
        "box": lambda: c["passes"][0].update(box=copy.deepcopy(other["passes"][0]["box"])),
    }
    parts[r.choice(sorted(parts))]()


def _rearranged(c: Certificate, r: random.Random, _: Certificate) -> None:
    records = _records(c, r)
    k = r.randrange(1, len(records))
    ways = {
        "cut": lambda: records.__delitem__(slice(k, None)),
        "begun later": lambda: records.__delitem__(slice(0, k)),
        "turned": lambda: records.__setitem__(slice(None), [*records[k:], *records[:k]]),
        "twice": lambda: records.extend(copy.deepcopy(records)),
        "backwards": records.reverse,
        "shuffled": lambda: r.shuffle(records),
        "passes": c["passes"].reverse,
    }
    ways[r.choice(sorted(ways))]()


CHANGES: Sequence[Change] = (
    _removed,
    _repeated,
    _exchanged,
    _sets_exchanged,
    _without_entry,
    _another_kind,
    _meets_another,
    _another_switch,
    _another_side,
    _another_section,
    _another_start,
    _from_another_machine,
    _rearranged,
)


@pytest.fixture(scope="module")
def certificates() -> Mapping[str, Certificate]:
    def one(problem: Problem) -> Certificate:
        proof = zo.prove(zo.find_orbit(problem).unwrap(), problem=problem)
        assert proof.proved, proof.verdict()
        return json.loads(json.dumps(dict(proof.certificate)))

    return {name: one(make()) for name, make in MACHINES.items()}


def _mutants(
    certificates: Mapping[str, Certificate], name: str, count: int
) -> Iterator[tuple[str, Certificate]]:
    """Yield changes that are none of an equal certificate, each with its kind."""
    r, others, made = random.Random(name), sorted(set(certificates) - {name}), 0
    while made < count:
        change = r.choice(CHANGES)
        mutant = copy.deepcopy(certificates[name])
        try:
            change(mutant, r, certificates[r.choice(others)])
        except KeyError:
            continue
        if mutant != certificates[name] or json.dumps(mutant) != json.dumps(certificates[name]):
            made += 1
            yield change.__name__, mutant


@pytest.fixture
def first_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stop a pass at its first false record, and prove no record twice."""
    prove, known = judged._proved, dict[str, Any]()

    def proved(machine: Any, box: Any, tasks: Sequence[Any]) -> list[Any]:
        found = list[Any]()
        where = repr((machine.start, machine.first.constants, box))
        for task in tasks:
            key = where + repr(task)
            if key not in known:
                known[key] = prove(machine, box, [task])[0]
            found.append(known[key])
            if isinstance(found[-1], str):
                break
        return [*found, *["not asked"] * (len(tasks) - len(found))]

    monkeypatch.setattr(judged, "_proved", proved)
    monkeypatch.setattr(judged, "_CHUNK", 10**6)


@pytest.mark.slow
@pytest.mark.parametrize("name", often(2, MACHINES))
@pytest.mark.usefixtures("first_failure")
def test_no_structural_change_of_a_machines_certificate_is_accepted(
    certificates: Mapping[str, Certificate], name: str
) -> None:
    problem = MACHINES[name]()
    assert check_proof(certificates[name], problem).ok
    accepted = list[str]()
    for kind, mutant in _mutants(certificates, name, 125):
        try:
            verdict = check_proof(mutant, problem)
        except InputError:
            continue
        if verdict.ok:
            accepted.append(kind)
    assert not accepted


def _twin_of(problem: Problem) -> Problem:
    """Return the wheel with a second switch at the same time as its strike."""

    def model(p: Mapping[str, Any]) -> CompletedSystem:
        wheel = problem.model(p)
        graph = wheel.graph
        twin = zo.Switch(name="twin", guard=2 * ca.SX(graph.switches[0].guard), armed=1.0)
        legs = wheel.mechanism
        return zo.hybrid_system(legs, zo.no_drive(legs), switches=(*graph.switches, twin))

    return replace(problem, name="twin_wheel", model=model)


@pytest.mark.slow
def test_two_switches_at_the_same_time_are_refused_by_prover_and_checker() -> None:
    problem = switched.rimless_wheel()
    twin, orbit = _twin_of(problem), zo.find_orbit(problem).unwrap()
    proof = zo.prove(replace(orbit, problem=twin.name, problem_digest=()), problem=twin)
    assert not proof.proved
    false = copy.deepcopy(dict(zo.prove(orbit, problem=problem).certificate))
    symbols = twin.symbols()
    graph = twin.model(symbols).graph
    false["problem"] = twin.name
    false["digest"] = joined_digest([formulas_of_view(graph, symbols, CheckedView(0, ())).digest])
    verdict = check_proof(false, twin)
    assert not verdict.ok
    assert "switch 1 may be zero" in verdict.claims[0].evidence
