"""The certificate of a proof as plain data: exact numbers, one inclusion a record."""

from __future__ import annotations

import hashlib
import json
import math
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import casadi as ca
import flint

from zeno_orbits.errors import ProofError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.proof.ball_system import BallSystem
from zeno_orbits.proof.balls import ZERO, Ball, Matrix, exact_text, half_width, mapped
from zeno_orbits.proof.expressions import operation_name
from zeno_orbits.proof.section import SectionStart
from zeno_orbits.proof.sets import BallSet
from zeno_orbits.proof.stage import ProofRecord
from zeno_orbits.proof.walk import ProofPassage
from zeno_orbits.work import versions

FORMAT = 1
_CHECK_BITS = 224
"""Bits after the point for numbers of everyday size."""
_EVERYDAY = 1e-3
"""Period for which that is enough [s]."""
_OWN_BITS = 180
"""Bits after the point beyond the first of the smallest parameter."""


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

    def __init__(self, system: BallSystem, places: Sequence[int]) -> None:
        """Find out how the prover's states are those of the problem.

        Args:
            system: The problem in balls.
            places: Places of the section's coordinates.
        """
        self._system, self._units = system, list(system.units)
        self._shift = [ZERO] * system.n
        carried = range(system.n - len(system.carried), system.n)
        self._inputs = [system.units[k] for k in (*places, *carried)]
        coordinate = system.expressions.coordinate
        self.gap_row = None if coordinate is None else coordinate.place
        if coordinate is not None:
            self._units[system.gap] *= coordinate.sign
            self._units[system.rate] *= coordinate.sign
            self._shift[system.gap] = -coordinate.sign * system.gap_offset

    def set_of(self, one: BallSet) -> dict[str, Any]:
        """Return a set."""
        m = [x * u + shift for x, u, shift in zip(one.m, self._units, self._shift, strict=True)]
        if not m[self._system.gap].is_exact():
            raise ProofError("certificate", "the stop is at no exact number")
        ones = [1.0] * self._system.n
        return {
            "m": [exact_text(x) for x in m],
            "C": _texts_by(one.C, self._units, self._inputs),
            "Q": _texts_by(one.frame, self._units, ones),
            "r": [exact_text(x.rad()) for x in one.r],
            "R": _texts_by(mapped(one.R, half_width), ones, self._inputs),
        }

    def record(self, one: ProofRecord) -> dict[str, Any]:
        """Return a record."""
        numbers = {name: _texts(value) for name, value in one.numbers.items()}
        if one.kind == "tail":
            radius, units = one.numbers["radius"], self._system.units
            numbers["radius"] = [exact_text(radius[k] * units[k]) for k in self._tail_places()]
            numbers["speed"] = exact_text(one.numbers["speed"] * units[self._system.rate])
        orders = {"orders": list(one.orders)} if one.orders else {}
        return {"kind": one.kind, **numbers, **orders, "set": self.set_of(one.result)}

    def passage(self, start: SectionStart, passage: ProofPassage) -> dict[str, Any]:
        """Return a set once around."""
        d, units = len(start.places), self._system.units
        radii = [u.rad() * unit for u, unit in zip(start.at.U[:d], self._inputs, strict=False)]
        centre = [x * unit for x, unit in zip(start.centre, self._inputs, strict=False)]
        around = [x * units[k] for k, x in zip(start.others, start.around, strict=True)]
        others = {
            "centre": [exact_text(x.mid()) for x in around],
            "radius": [exact_text(x.rad()) for x in around],
        }
        return {
            "box": {"centre": _texts(centre), "radius": _texts(radii), "others": others},
            "start": self.set_of(start.at),
            "records": [self.record(one) for one in passage.records],
        }

    def _tail_places(self) -> list[int]:
        """Return the states that a polydisc has radii for: all but a gap that is carried."""
        if self.gap_row is not None:
            return list(range(self._system.n))
        return [k for k in range(self._system.n) if k not in (self._system.gap, self._system.rate)]


def _texts_by(m: Matrix, rows: Sequence[float], columns: Sequence[float]) -> list[list[str]]:
    """Return the numbers of an exact matrix from units of rows by units of columns."""
    return [
        [exact_text(x * unit / by) for x, by in zip(row, columns, strict=True)]
        for row, unit in zip(m.table(), rows, strict=True)
    ]


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
    writer = CertificateWriter(system, passes[0][0].places)
    named = dict(zip(problem.names, values.vector, strict=True))
    return {
        "format": FORMAT,
        "kind": "zeno_orbits proof",
        "problem": problem.name,
        "digest": system_digest(problem),
        "parameters": {name: exact_text(flint.arb(float(x))) for name, x in named.items()},
        "over": {name: exact_text(flint.arb(radius)) for name, radius in over.items()},
        "gap_row": writer.gap_row,
        "bits": _check_bits(system, list(named.values())),
        "section": {
            "conditions": ["gap", "gap_rate", "multiplier"],
            "places": list(passes[0][0].places),
        },
        "passes": [writer.passage(start, passage) for start, passage in passes],
        "claims": [dict(claim) for claim in claims],
        "versions": proof_versions(),
    }


def _check_bits(system: BallSystem, numbers: Sequence[float]) -> int:
    """Return how many bits after the point the checker needs: more where numbers are small."""
    small = min(*system.units, system.period / _EVERYDAY, 1.0)
    least = min((abs(x) for x in numbers if x), default=1.0)
    needed = max(_CHECK_BITS - 2 * math.log2(small), _OWN_BITS - math.log2(least))
    return min(1024, 32 * math.ceil(needed / 32))


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
    path.write_text(json.dumps(data, separators=(",", ":")) + "\n", encoding="utf-8")
