"""Replay of a certificate with its problem's hand-written model: evidence in addition to the proof.

An inclusion proves a consequence of the problem's formulas. Whether the formulas describe the
machine is a separate question, for which the hand-written model gives independent evidence. Its
equations are integrated in doubles from the middle of each set over the record, and must arrive at
the middle of the next set. This module also checks whether a certificate belongs to the orbit of a
file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.model import HybridDynamics, ParameterValues, Problem, load_reference
from zeno_orbits.orbits import Orbit
from zeno_orbits.proof.checker.balls import number
from zeno_orbits.proof.checker.certificate import check_proof
from zeno_orbits.proof.checker.verdict import ProofVerdict
from zeno_orbits.proof.integration.orbit_walk import proof_start
from zeno_orbits.work import read_json

_SAME = 1e-9
"""Largest difference of the two models over one record, relative to the size of each state."""
_LOCAL = 1e-13


@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """Result of a replay.

    Attributes:
        n_records: Number of replayed records.
        largest: Largest difference at the end of a record, relative to the size of each state.
        where: Record of the largest difference, such as ``pass 0, record 17 (step)``.
    """

    n_records: int
    largest: float
    where: str

    @property
    def ok(self) -> bool:
        """True if the hand-written model agrees with all records."""
        return self.largest <= _SAME

    def verdict(self) -> str:
        """Return the verdict as one sentence."""
        told = f"{self.n_records} records replayed with the hand-written model"
        if self.ok:
            return f"{told} agree within {self.largest:.1e} of each state."
        return f"{told} do not agree: {self.where} differs by {self.largest:.1e} of a state."


def replay_proof(certificate: Mapping[str, Any], problem: Problem) -> Replay | None:
    """Replay a certificate of a problem, or return None without a hand-written model.

    Args:
        certificate: Content of the certificate file, which fits the problem.
        problem: Its problem.
    """
    if problem.reference is None or "machine" in certificate:
        return None
    bits = certificate["bits"]
    numbers = dict(
        zip(problem.names, doubles(certificate["parameters"].values(), bits), strict=True)
    )
    gains = {gain.name: numbers.pop(gain.name) for gain in problem.gains}
    values = ParameterValues(gains=gains, parameters=numbers)
    machine = load_reference(problem).dynamics(values)
    usual = problem.dynamics(values).own.states(len(problem.state_names))
    largest, where, n_records = 0.0, "", 0
    for k, one in enumerate(certificate["passes"]):
        x = np.array(doubles(one["start"]["m"], bits)[: len(usual)])
        locked = False
        for place, record in enumerate(one["records"]):
            after = np.array(doubles(record["set"]["m"], bits)[: len(usual)])
            found = _replayed(machine, x, record, bits, locked=locked)
            off = float(np.max(np.abs(found - after) / np.maximum(usual, np.abs(after))))
            off = math.inf if math.isnan(off) else off
            if off > largest:
                largest, where = off, f"pass {k}, record {place} ({record['kind']})"
            if record["kind"] == "tail":
                locked = True
            elif record["kind"] == "impact":
                locked = machine.restitution == 0.0
            elif record["kind"] == "cross":
                locked = False
            x, n_records = after, n_records + 1
    return Replay(n_records=n_records, largest=largest, where=where)


def _replayed(
    machine: HybridDynamics, x: Vector, record: Mapping[str, Any], bits: int, *, locked: bool
) -> Vector:
    """Return the state of the hand-written model after a record."""
    if record["kind"] == "impact":
        return machine.reset_map(x, machine.gap_rate(x))
    if record["kind"] == "tail":
        # The remaining impacts move each state by at most their speed. Contact removes this speed.
        rest = machine.impulse_direction(x) * machine.gap_rate(x)
        return x - rest if machine.gap_acceleration(x) < 0.0 else np.full_like(x, np.nan)
    flow = machine.locked if locked else machine.free
    times = record["centre"] if record["kind"] == "cross" else [record["h"]] * 2
    duration = sum(doubles(times, bits)) / 2
    run = solve_ivp(
        lambda _, y: flow.rate(y), (0.0, duration), x, "DOP853", rtol=_LOCAL, atol=_LOCAL * 1e-3
    )
    return run.y[:, -1]


def doubles(texts: Iterable[Any], bits: int) -> list[float]:
    """Return numbers of a certificate, rounded to doubles.

    Args:
        texts: The numbers.
        bits: Number of bits of the certificate's unit.
    """
    return [float(Fraction(number(text, bits, exact=False).m, 1 << bits)) for text in texts]


_CLOSE = 1e-8
"""Largest distance of an orbit's values from both ends of a proved interval, relative to size."""


def check_proof_of(orbit: Orbit, problem: Problem, path: Path) -> ProofVerdict:
    """Check a certificate, and that it belongs to a given orbit.

    Parameters must be equal. For the smallest box, both ends of the enclosures of the start and of
    the period must lie within 1e-8 of the orbit's values, relative to their size. So a wide
    enclosure, which contains many orbits, is rejected.

    Args:
        orbit: The orbit.
        problem: Its problem.
        path: The certificate.

    Raises:
        InputError: If the file is not a certificate, or belongs to another orbit.
    """
    verdict = check_proof(path, problem)
    data = read_json(path)
    bits = data["bits"]
    proved = dict(zip(data["parameters"], doubles(data["parameters"].values(), bits), strict=True))
    own_values = orbit.values(problem)
    for name, known in zip(problem.names, own_values.vector, strict=True):
        if proved[name] != known:
            wanted = f"must be about `{name}` = {known!r}, but it is about {proved[name]!r}"
            raise InputError(f"Argument `proof` {wanted}.")
    state = problem.state_vector(dict(proof_start(orbit).orbit.start_state))
    sizes = problem.dynamics(own_values).own.states(len(state))
    low, high = _last_claim(data, "start_state")
    for name, *ends, y, size in zip(problem.state_names, low, high, state, sizes, strict=True):
        _require_close(f"with `{name}` = {y!r} at its start", ends, y, size)
    (low,), (high,) = _last_claim(data, "period")
    _require_close(f"of period {orbit.period!r} s", (low, high), orbit.period, 0.0)
    return verdict


def _last_claim(data: Mapping[str, Any], name: str) -> tuple[list[float], list[float]]:
    """Return the ends of an enclosure of the last pass, whose box is the smallest."""
    claims = [claim for claim in data["claims"] if claim["name"] == name]
    if not claims:
        raise InputError(f"Argument `proof` lacks a claim `{name}`.")
    claim = max(claims, key=lambda one: one["pass"])
    low, high = (
        doubles([end] if isinstance(end, str) else end, data["bits"])
        for end in (claim["low"], claim["high"])
    )
    return low, high


def _require_close(orbit: str, ends: Sequence[float], value: float, size: float) -> None:
    """Raise an error for an enclosure with an end that is far from a value of the orbit."""
    for end in ends:
        if not abs(end - value) <= _CLOSE * max(size, abs(value)):
            wanted = f"must be about an orbit {orbit}"
            found = f"it encloses {ends[0]!r} to {ends[1]!r}"
            raise InputError(f"Argument `proof` {wanted}, but {found}.")
