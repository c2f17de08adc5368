"""The certificate of a proof as plain data: exact numbers, one inclusion per record."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import flint

from zeno_orbits.errors import InputError, ProofError
from zeno_orbits.model import ParameterValues, Problem, RecordedFile
from zeno_orbits.proof.arithmetic.balls import (
    ZERO,
    Ball,
    Matrix,
    exact_text,
    half_width,
    mapped,
    matrix,
)
from zeno_orbits.proof.checker.balls import NotProved
from zeno_orbits.proof.checker.certificate import require_order
from zeno_orbits.proof.checker.formulas import joined_digest
from zeno_orbits.proof.integration.ball_system import BallSystem, PeriodStart, SectionKind
from zeno_orbits.proof.integration.machine import BallMachine
from zeno_orbits.proof.integration.polynomial_walk import (
    PolynomialPass,
    PolynomialRecord,
    PolynomialSet,
)
from zeno_orbits.proof.integration.section import SectionStart
from zeno_orbits.proof.integration.sets import BallSet, ProofRecord
from zeno_orbits.proof.integration.walk import ProofPassage
from zeno_orbits.work import versions, write_whole

FORMAT = 2
_CHECK_BITS = 224
"""Bits after the binary point for numbers of ordinary size."""
_EVERYDAY = 1e-3
"""Shortest period for which these bits are enough [s]."""
_OWN_BITS = 180
"""Bits after the leading bit of the smallest parameter."""


class CertificateWriter:
    """Converter of the prover's sets and records to file data in the states of the problem."""

    def __init__(self, system: BallSystem, places: Sequence[int]) -> None:
        """Set up the conversion from the prover's states to the problem's states.

        Args:
            system: The problem in balls.
            places: Indices of the section's coordinates.
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
        """Return a set as data."""
        # The position of the stop needs additional bits.
        with flint.ctx.workprec(2 * flint.ctx.prec + _OWN_BITS):
            m = [x * u + shift for x, u, shift in zip(one.m, self._units, self._shift, strict=True)]
        if not m[self._system.gap].is_exact():
            raise ProofError("certificate", "the position of the stop is not an exact number")
        ones = [1.0] * self._system.n
        return {
            "m": [exact_text(x) for x in m],
            "C": _texts_by(one.C, self._units, self._inputs),
            "Q": _texts_by(one.frame, self._units, ones),
            "r": [exact_text(x.rad()) for x in one.r],
            "R": _texts_by(mapped(one.R, half_width), ones, self._inputs),
        }

    def polynomial_set(self, one: PolynomialSet) -> dict[str, Any]:
        """Return a set of polynomials as data."""
        with flint.ctx.workprec(2 * flint.ctx.prec + _OWN_BITS):
            p = [
                [flint.arb(float(c)) * unit + (0 if k else shift) for k, c in enumerate(x.c)]
                for x, unit, shift in zip(one.p, self._units, self._shift, strict=True)
            ]
        ones = [1.0] * self._system.n
        frame = matrix([[flint.arb(float(x)) for x in row] for row in one.frame], len(ones))
        return {
            "p": [_texts(row) for row in p],
            "Q": _texts_by(frame, self._units, ones),
            "r": [exact_text(flint.arb(float(x))) for x in one.r],
        }

    def polynomial_pass(self, one: PolynomialPass) -> dict[str, Any]:
        """Return the enclosure of one period in polynomials as data."""
        return {
            "degree": one.first.p[0].basis.degree,
            "box": self._box(one.start),
            "start": self.polynomial_set(one.first),
            "records": [self.record(record) for record in one.records],
        }

    def record(self, one: ProofRecord | PolynomialRecord) -> dict[str, Any]:
        """Return a record as data."""
        numbers = {name: _texts(value) for name, value in one.numbers.items()}
        if one.kind == "tail":
            radius, units = zip(one.places, one.numbers["radius"], strict=True), self._system.units
            numbers["radius"] = [exact_text(r * units[k]) for k, r in radius]
            # The units of all gap rates are the same.
            numbers["speed"] = exact_text(one.numbers["speed"] * units[self._system.rate])
        orders = {"orders": list(one.orders)} if one.orders else {}
        set_ = one.result
        result = self.set_of(set_) if isinstance(set_, BallSet) else self.polynomial_set(set_)
        return {"kind": one.kind, **numbers, **one.fields, **orders, "set": result}

    def passage(self, start: SectionStart, passage: ProofPassage) -> dict[str, Any]:
        """Return the enclosure of one period as data."""
        return {
            "box": self._box(start),
            "start": self.set_of(start.at),
            "records": [self.record(one) for one in passage.records],
        }

    def _box(self, start: SectionStart) -> dict[str, Any]:
        """Return the box of a start as data."""
        d, units = len(start.places), self._system.units
        radii = [u.rad() * unit for u, unit in zip(start.at.U[:d], self._inputs, strict=False)]
        centre = [x * unit for x, unit in zip(start.centre, self._inputs, strict=False)]
        around = [x * units[k] for k, x in zip(start.others, start.around, strict=True)]
        others = {
            "centre": [exact_text(x.mid()) for x in around],
            "radius": [exact_text(x.rad()) for x in around],
        }
        return {"centre": _texts(centre), "radius": _texts(radii), "others": others}


def _texts_by(m: Matrix, rows: Sequence[float], columns: Sequence[float]) -> list[list[str]]:
    """Return the entries of an exact matrix in units of rows divided by units of columns."""
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
    machine: BallMachine,
    system: BallSystem,
    passes: Sequence[tuple[SectionStart, ProofPassage]],
    claims: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """Return the certificate of a proof.

    Args:
        problem: The problem.
        values: Its numbers.
        over: Radii of the intervals of parameters that the proof covers.
        machine: The problem in balls.
        system: Its system at the start.
        passes: Enclosures of one period, with their starts.
        claims: The claims, with numbers as texts.
    """
    writer = CertificateWriter(system, passes[0][0].places)
    file = RecordedFile.of(problem)
    return {
        "format": FORMAT,
        "kind": "zeno_orbits proof",
        **system_data(problem, values, over, system),
        **_machine_data(machine, system, passes),
        **({} if file is None else {"problem_file": str(Path(file.path).absolute())}),
        "section": _section_data(machine.section, passes[0][0].places),
        "passes": [writer.passage(start, passage) for start, passage in passes],
        "claims": [dict(claim) for claim in claims],
        "versions": proof_versions(),
    }


def _section_data(section: PeriodStart, places: Sequence[int]) -> dict[str, Any]:
    """Return the section as data."""
    if section.kind is SectionKind.SWITCH:
        on_stop = ["gap", "gap_rate"] if section.locked else []
        conditions = {"conditions": [*on_stop, "guard"], "switch": section.switch}
    elif section.kind is SectionKind.IMPACT:
        conditions = {"conditions": ["gap"]}
    else:
        conditions = {"conditions": ["gap", "gap_rate", "multiplier"]}
    return {**conditions, "places": list(places)}


def _machine_data(
    machine: BallMachine,
    system: BallSystem,
    passes: Sequence[tuple[SectionStart, ProofPassage]],
) -> dict[str, Any]:
    """Return the start of a machine with several stops, switches or kinks, and its digest."""
    if system.view is None:
        return {}
    own = tuple(map(int, system.view.sides))
    held = {"held": system.view.held} if system.view.held >= 0 else {}
    used = {own}
    for _, passage in passes:
        used |= {tuple(record.fields.get("sides", own)) for record in passage.records}
    return {
        "machine": {"stop": system.view.stop, "sides": list(own), **held},
        "digest": joined_digest(
            view.expressions.digest
            for sides in sorted(used)
            for view in machine.views(tuple(map(bool, sides)))
        ),
    }


def system_data(
    problem: Problem, values: ParameterValues, over: Mapping[str, float], system: BallSystem
) -> dict[str, Any]:
    """Return the system data of a certificate.

    Args:
        problem: The problem.
        values: Its numbers.
        over: Radii of the parameters that vary.
        system: The problem in balls.
    """
    named = dict(zip(problem.names, map(float, values.vector), strict=True))
    coordinate = system.expressions.coordinate
    return {
        "problem": problem.name,
        "digest": system.expressions.digest,
        "parameters": {name: exact_text(flint.arb(x)) for name, x in named.items()},
        "over": {name: exact_text(flint.arb(radius)) for name, radius in over.items()},
        "gap_row": None if coordinate is None else coordinate.place,
        "bits": check_bits(system, [*named.values()]),
    }


def require_hypotheses(data: Mapping[str, Any], problem: Problem) -> None:
    """Raise an error if the checker cannot show the hypotheses of the theorem for a problem.

    Args:
        data: The certificate, or its `system_data` for a machine with one stop. Of a certificate
            the order of the events is checked too.
        problem: The problem.

    Raises:
        ProofError: If a hypothesis is not shown.
    """
    try:
        require_order(data, problem)
    except (NotProved, InputError) as error:
        raise ProofError("hypotheses", str(error).removesuffix(".")) from error


def check_bits(system: BallSystem, numbers: Sequence[float]) -> int:
    """Return the number of bits after the binary point for the checker: more for small parameters.

    Args:
        system: The problem in balls.
        numbers: All gains and parameters.
    """
    small = min(*system.units, system.period / _EVERYDAY, 1.0)
    least = min((abs(x) for x in numbers if x), default=1.0)
    needed = max(_CHECK_BITS - 2 * math.log2(small), _OWN_BITS - math.log2(least))
    return min(1024, 32 * math.ceil(needed / 32))


def proof_versions() -> dict[str, str]:
    """Return the versions of the software that a proof depends on, keyed by name."""
    known = versions()
    return {
        "zeno_orbits": known["zeno_orbits"],
        "casadi": known["casadi"],
        "python-flint": flint.__version__,
        "flint": flint.__FLINT_VERSION__,
        "python": platform.python_version(),
    }


def write_certificate(data: Mapping[str, Any], path: Path) -> None:
    """Write a certificate, with the path of its problem file relative to its folder.

    Args:
        data: The certificate.
        path: The file.
    """
    file = data.get("problem_file")
    if isinstance(file, str) and Path(file).is_absolute():
        own = RecordedFile(path=file, near=True)
        data = {**data, "problem_file": own.relative_to(path.parent)}
    write_whole(path, json.dumps(data, separators=(",", ":")) + "\n")
