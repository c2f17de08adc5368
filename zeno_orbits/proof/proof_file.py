"""The certificate of a proof as plain data: exact numbers, one inclusion a record."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import casadi as ca
import flint

from zeno_orbits.errors import ProofError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.proof.ball_system import BallSystem
from zeno_orbits.proof.balls import Ball, Matrix, exact_text
from zeno_orbits.proof.expressions import operation_name
from zeno_orbits.proof.section import SectionStart
from zeno_orbits.proof.sets import BallSet
from zeno_orbits.proof.stage import ProofRecord
from zeno_orbits.proof.walk import ProofPassage
from zeno_orbits.work import versions

FORMAT = 1
_CHECK_BITS = 224


def system_digest(problem: Problem) -> str:
    """Return the SHA-256 of the instructions of a problem's equations."""
    symbols = problem.symbols()
    system = problem.model(symbols)
    numbers = ca.vertcat(*symbols.values())
    given: list[Any] = [
        system.free_flow,
        system.locked_flow,
        ca.vertcat(*system.contact),
        system.impulse_direction,
        system.law_numbers,
        system.holonomic,
    ]
    outputs = [ca.densify(ca.SX(one)) for one in given]
    f = ca.Function("system", [system.state, numbers], outputs)
    lines = [f"{system.state.numel()} {numbers.numel()} {system.n_q}"]
    for k in range(f.n_instructions()):
        code = f.instruction_id(k)
        takes, gives = f.instruction_input(k), f.instruction_output(k)
        words = [operation_name(code).upper(), ",".join(map(str, takes)), ",".join(map(str, gives))]
        if code == ca.OP_CONST:
            words.append(float(f.instruction_constant(k)).hex())
        lines.append(" ".join(words))
    return hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()


class CertificateWriter:
    """Turn sets and records of the prover into those of the file, in the problem's own states."""

    def __init__(self, system: BallSystem) -> None:
        """Find out how the prover's gap is a state of the problem."""
        self._system = system
        coordinate = system.expressions.coordinate
        self.gap_row = None if coordinate is None else coordinate.place
        self._sign, self._offset = 1, None
        if coordinate is not None:
            self._sign, self._offset = coordinate.sign, system.gap_offset

    def number_rows(self, m: Matrix) -> list[list[str]]:
        """Return the numbers of an exact matrix."""
        return [[exact_text(x) for x in row] for row in m.table()]

    def set_of(self, one: BallSet) -> dict[str, Any]:
        """Return a set."""
        return {
            "m": [exact_text(x) for x in self._own(one.m)],
            "C": self.number_rows(self._own_rows(one.C)),
            "Q": self.number_rows(self._own_rows(one.frame)),
            "r": [exact_text(x.rad()) for x in one.r],
            "R": [[exact_text(x.rad()) for x in row] for row in one.R.table()],
        }

    def record(self, one: ProofRecord) -> dict[str, Any]:
        """Return a record."""
        numbers = {name: _texts(value) for name, value in one.numbers.items()}
        if one.kind == "tail":
            places = self._tail_places()
            numbers["radius"] = [exact_text(one.numbers["radius"][k]) for k in places]
        orders = {"orders": list(one.orders)} if one.orders else {}
        return {"kind": one.kind, **numbers, **orders, "set": self.set_of(one.result)}

    def passage(self, start: SectionStart, passage: ProofPassage) -> dict[str, Any]:
        """Return a set once around."""
        radii = [exact_text(u.rad()) for u in start.at.U[: len(start.places)]]
        others = {
            "centre": [exact_text(x.mid()) for x in start.around],
            "radius": [exact_text(x.rad()) for x in start.around],
        }
        centre = [exact_text(x) for x in start.centre]
        return {
            "box": {"centre": centre, "radius": radii, "others": others},
            "start": self.set_of(start.at),
            "records": [self.record(one) for one in passage.records],
        }

    def _tail_places(self) -> list[int]:
        """Return the states that a polydisc has radii for: all but a gap that is carried."""
        if self.gap_row is not None:
            return list(range(self._system.n))
        return [k for k in range(self._system.n) if k not in (self._system.gap, self._system.rate)]

    def _own(self, y: Sequence[Ball]) -> list[Ball]:
        """Return the problem's states of the prover's."""
        own = list(y)
        if self.gap_row is not None:
            gap, rate = self._system.gap, self._system.rate
            own[gap], own[rate] = own[gap] - self._offset, own[rate] * self._sign
            own[gap] *= self._sign
            if not own[gap].is_exact():
                raise ProofError("certificate", "the stop is at no exact number")
        return own

    def _own_rows(self, m: Matrix) -> Matrix:
        if self._sign == 1:
            return m
        own = m * 1
        for k in (self._system.gap, self._system.rate):
            for j in range(m.ncols()):
                own[k, j] = -m[k, j]
        return own


def _texts(value: Ball | list[Ball]) -> str | list[str]:
    if isinstance(value, list):
        return [exact_text(x) for x in cast("list[Ball]", value)]
    return exact_text(value)


def certificate(
    problem: Problem,
    values: ParameterValues,
    over: Mapping[str, float],
    system: BallSystem,
    passes: Sequence[tuple[SectionStart, ProofPassage]],
    claims: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """Return the certificate of a proof.

    Args:
        problem: The problem.
        values: Its numbers.
        over: Radii of the parameters for all of whose values it holds.
        system: The problem in balls.
        passes: Sets once around, with their starts.
        claims: What is claimed, its numbers as texts.
    """
    writer = CertificateWriter(system)
    named = dict(zip(problem.names, values.vector, strict=True))
    return {
        "format": FORMAT,
        "kind": "zeno_orbits proof",
        "problem": problem.name,
        "digest": system_digest(problem),
        "parameters": {name: exact_text(flint.arb(float(x))) for name, x in named.items()},
        "over": {name: exact_text(flint.arb(radius)) for name, radius in over.items()},
        "gap_row": writer.gap_row,
        "bits": _CHECK_BITS,
        "section": {
            "conditions": ["gap", "gap_rate", "multiplier"],
            "places": list(passes[0][0].places),
        },
        "passes": [writer.passage(start, passage) for start, passage in passes],
        "claims": [dict(claim) for claim in claims],
        "versions": proof_versions(),
    }


def proof_versions() -> dict[str, str]:
    """Return what a proof stands on: name to version."""
    known = versions()
    return {
        "zeno_orbits": known["zeno_orbits"],
        "casadi": known["casadi"],
        "python-flint": flint.__version__,
        "flint": flint.__FLINT_VERSION__,
        "python": platform.python_version(),
    }


def write_proof(data: Mapping[str, Any], path: Path) -> None:
    """Write a certificate.

    Args:
        data: The certificate.
        path: The file.
    """
    import json

    path.write_text(json.dumps(data, separators=(",", ":")) + "\n", encoding="utf-8")
