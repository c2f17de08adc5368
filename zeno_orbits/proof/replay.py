"""A certificate replayed with its problem's hand-written model: evidence beside the proof.

An inclusion proves what the problem's formulas imply. That these are the machine's is another
question, and the hand-written model is another answer: from the middle of each set its equations
are integrated in doubles over the record, and have to arrive at the middle of the next.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from zeno_orbits.arrays import Vector
from zeno_orbits.model import HybridDynamics, ParameterValues, Problem, load_reference
from zeno_orbits.proof.checker.balls import number

_SAME = 1e-9
"""How far the two models may come apart over one record, per size of a state."""
_LOCAL = 1e-13


@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """What a replay found.

    Attributes:
        n_records: Records that were replayed.
        largest: Largest difference at the end of a record, per size of a state.
        where: That record, as in ``pass 0, record 17 (step)``.
    """

    n_records: int
    largest: float
    where: str

    @property
    def ok(self) -> bool:
        """True if the hand-written model agrees with all records."""
        return self.largest <= _SAME

    def verdict(self) -> str:
        """Return one sentence."""
        told = f"{self.n_records} records replayed with the hand-written model"
        if self.ok:
            return f"{told} agree within {self.largest:.1e} of each state."
        return f"{told} do not agree: {self.where} differs by {self.largest:.1e} of a state."


def replay_proof(certificate: Mapping[str, Any], problem: Problem) -> Replay | None:
    """Replay a certificate that fits its problem; None if the problem has no hand-written model.

    Args:
        certificate: What is in its file.
        problem: Its problem.
    """
    if problem.reference is None:
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
        conditions = set(certificate["section"]["conditions"])
        locked = conditions == {"gap", "gap_rate"}
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
    """Return where the hand-written model is after a record."""
    if record["kind"] == "impact":
        return machine.reset_map(x, machine.gap_rate(x))
    if record["kind"] == "tail":
        # What is left of the impacts moves no state by more than their speed; the stop takes that.
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
    """Return numbers of a certificate, rounded.

    Args:
        texts: The numbers.
        bits: Of the certificate.
    """
    return [float(Fraction(number(text, bits, exact=False).m, 1 << bits)) for text in texts]
