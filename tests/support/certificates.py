"""Certificates of linear oscillators with a stop, made by hand: closed forms in fifty digits.

The state is (distance from the stop, speed, cosine, sine): off the stop it moves by `z' = A z + b`,
on it the clock alone turns. Nothing of the package's prover is used.
"""

from __future__ import annotations

import copy
import hashlib
import operator
import random
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import casadi as ca
import mpmath as mp

from zeno_orbits.model import Problem

BITS = 192
_SLACK = mp.mpf(2) ** -120
_ROUNDING = mp.mpf(2) ** -40
"""Room for derivatives that are found in hardware numbers."""
_N = 4
_FIXED = 400
"""Binary places of the series of a flow: 130 more than its terms are known to."""


def text_of(x: Any) -> str:
    """Return a number as a certificate has it, rounded to the nearest unit."""
    units = int(mp.nint(mp.mpf(x) * mp.mpf(2) ** BITS))
    return f"{'-' if units < 0 else ''}0x{abs(units):x}p-{BITS}"


def texts_of(rows: Sequence[Any]) -> list[Any]:
    return [texts_of(row) if isinstance(row, list) else text_of(row) for row in rows]


def digest_of(problem: Problem) -> str:
    """Return the digest that a certificate names a problem's formulas by."""
    symbols = problem.symbols()
    system = problem.model(symbols)
    contact = ca.vertcat(
        system.gap,
        system.gap_rate,
        system.gap_acceleration,
        system.multiplier,
        system.multiplier_rate,
    )
    outputs = (
        system.free_flow,
        system.locked_flow,
        contact,
        system.impulse_direction,
        system.law_numbers,
        system.holonomic,
    )
    dense = [ca.densify(ca.SX(output)) for output in outputs]
    f = ca.Function("system", [system.state, ca.vertcat(*symbols.values())], dense)
    names: dict[int, str] = {}
    for name in sorted(dir(ca), reverse=True):
        if name.startswith("OP_"):
            names[getattr(ca, name)] = name[3:]
    text = f"{f.numel_in(0)} {f.numel_in(1)} {system.n_q}\n"
    lines, speed = [(f, k) for k in range(f.n_instructions())], ca.SX.sym("speed")
    if system.law.of_speed is not None:
        law = ca.densify(ca.SX(system.law.of_speed(speed)))
        of_speed = ca.Function("law", [ca.vertcat(*symbols.values()), speed], [law])
        lines += [(of_speed, k) for k in range(of_speed.n_instructions())]
    for one, k in lines:
        code = one.instruction_id(k)
        takes, gives = one.instruction_input(k), one.instruction_output(k)
        text += f"{names[code]} {','.join(map(str, takes))} {','.join(map(str, gives))}"
        text += f" {float(one.instruction_constant(k)).hex()}\n" if names[code] == "CONST" else "\n"
    return hashlib.sha256(text.encode()).hexdigest()


def _exponential(a: Any) -> Any:
    """Return the exponential of a matrix by its series, in whole multiples of 2^-_FIXED."""
    n = range(a.rows)
    rows = [[int(mp.ldexp(a[i, j], _FIXED)) for j in n] for i in n]
    term = whole = [[int(i == j) << _FIXED for j in n] for i in n]
    k = 0
    while any(map(any, term)):
        k += 1
        unit, columns = k << _FIXED, list(zip(*term, strict=True))
        term = [
            [(sum(map(operator.mul, row, column)) + unit // 2) // unit for column in columns]
            for row in rows
        ]
        whole = [list(map(operator.add, *pair)) for pair in zip(whole, term, strict=True)]
    return mp.matrix([[mp.ldexp(mp.mpf(x), -_FIXED) for x in row] for row in whole])


class HandMade:
    """A certificate while it is made: the set of the moment, and the records so far.

    Args:
        problem: An oscillator.
        z: The state that it starts from.
        C: Its derivative by the section's coordinates.
        spread: Radius of the box of each coordinate.
        exact: Rows that are known exactly at the start.
        wide_slope: By how much the derivative may change over the box.
    """

    def __init__(
        self,
        problem: Problem,
        z: Sequence[Any],
        C: Any,
        spread: Sequence[Any],
        exact: Sequence[int],
        wide_slope: Any = _SLACK,
    ) -> None:
        self.problem = problem
        self.p = {
            name: mp.mpf(float(x))
            for name, x in zip(problem.names, problem.values().vector, strict=True)
        }
        self.z, self.C, self.spread = mp.matrix(list(z)), C, list(spread)
        self.r = mp.matrix([_SLACK] * _N)
        self.R = mp.matrix([[wide_slope] * len(self.spread)] * _N)
        self.time, self.records = mp.mpf(0), list[dict[str, Any]]()
        self._forget(exact)
        self.start = self._set()

    def _set(self) -> dict[str, Any]:
        def rows(a: Any) -> list[Any]:
            return [[a[i, j] for j in range(len(self.spread))] for i in range(_N)]

        eye = [[int(i == j) for j in range(_N)] for i in range(_N)]
        parts = {
            "m": list(self.z),
            "C": rows(self.C),
            "Q": eye,
            "r": list(self.r),
            "R": rows(self.R),
        }
        return {name: texts_of(part) for name, part in parts.items()}

    def _forget(self, exact: Sequence[int]) -> None:
        for k in exact:
            self.r[k] = 0
            for j in range(len(self.spread)):
                self.C[k, j] = self.R[k, j] = 0

    def _flow(self, mode: str, h: Any) -> tuple[Any, Any]:
        """Return the state after a time and its derivative."""
        a, b = self.affine(mode, h)
        return a * self.z + b, a

    def affine(self, mode: str, h: Any) -> tuple[Any, Any]:
        """Return the flow over a time as ``z -> a z + b``."""
        A, b = self._system(mode)
        whole = mp.zeros(_N + 1, _N + 1)
        whole[:_N, :_N], whole[:_N, _N] = A * h, b * h
        turned = _exponential(whole)
        return turned[:_N, :_N], turned[:_N, _N]

    def _system(self, mode: str) -> tuple[Any, Any]:
        p, A, b = self.p, mp.zeros(_N, _N), mp.zeros(_N, 1)
        A[2, 3], A[3, 2] = -p["omega"], p["omega"]
        if mode == "free":
            A[0, 1], b[1] = 1, p["k"] * p["stop"] / p["m"]
            A[1, 0], A[1, 1], A[1, 2] = -p["k"] / p["m"], -p["c"] / p["m"], -p["A"] / p["m"]
        return A, b

    def rate(self, mode: str, z: Any) -> Any:
        A, b = self._system(mode)
        return A * z + b

    def _hand_on(
        self,
        z: Any,
        slope: Any,
        exact: Sequence[int],
        record: dict[str, Any],
        wide: Any = 0,
        wide_slope: Any = 0,
    ) -> None:
        """Append a record, its set wider than the last by what the derivative asks, and more."""
        size = mp.matrix([[abs(slope[i, j]) for j in range(_N)] for i in range(_N)])
        grown = mp.mpf("1.001")
        self.z, self.C = z.copy(), slope * self.C
        self.r = size * self.r * grown + mp.matrix([_SLACK + wide] * _N)
        largest = max([abs(x) for x in self.C] or [0]) * _ROUNDING
        extra = mp.matrix([[_SLACK + wide_slope + largest] * len(self.spread)] * _N)
        self.R = size * self.R * grown + extra
        self._forget(exact)
        self.records.append({**record, "set": self._set()})

    def step(self, mode: str, h: Any) -> None:
        """Flow for a time."""
        z, slope = self._flow(mode, h)
        self.time += h
        record = {"kind": "step", "h": text_of(h), "orders": [30, 20]}
        self._hand_on(z, slope, (0, 1) if mode == "locked" else (), record)

    def cross(self, mode: str, beyond: Any, reach: Any, wide: Any = 0, wide_slope: Any = 0) -> None:
        """Cross the guard before a time; the window reaches this far to each side."""

        root = beyond
        for _ in range(50):
            z = self._flow(mode, root)[0]
            value, rate = (
                (z[0], z[1]) if mode == "free" else (z[2] - self.centre[2], -self.p["omega"] * z[3])
            )
            root -= value / rate
            if abs(value / rate) < mp.mpf(10) ** -60:
                break
        z, slope = self._flow(mode, root)
        rate, gradient = self.rate(mode, z), mp.zeros(1, _N)
        gradient[0, 0 if mode == "free" else 2] = 1
        slope = slope - rate * (gradient * slope) / (gradient * rate)[0]
        tight = mp.mpf(2) ** -130
        if mode == "free":
            z[0] = 0
        record = {
            "kind": "cross",
            "h": text_of(root + 2 * reach),
            "orders": [30, 20],
            "window": [text_of(root - reach), text_of(root + reach)],
            "centre": [text_of(root - tight), text_of(root + tight)],
        }
        self.time += root
        self._hand_on(z, slope, (0,) if mode == "free" else (0, 1), record, wide, wide_slope)

    def impact(self) -> None:
        """Strike the stop."""
        slope = mp.eye(_N)
        slope[1, 1] = -self.p["restitution"]
        self._hand_on(slope * self.z, slope, (0,), {"kind": "impact"})

    def tail(self, radius: Any, speed: Any, loose: Any) -> None:
        """Close the impacts with their Zeno point, known up to ``loose``."""
        z = self.z.copy()
        z[0] = z[1] = 0
        record = {"kind": "tail", "radius": texts_of([radius] * _N), "speed": text_of(speed)}
        self._hand_on(z, mp.eye(_N), (0, 1), record, loose)

    def certificate(
        self, section: Mapping[str, Any], others: Mapping[str, Any], claims: Sequence[Any]
    ) -> dict[str, Any]:
        """Return the certificate: its section, where the others are, and its claims."""
        centre = [text_of(self.centre[k]) for k in section["places"]]
        box = {"centre": centre, "radius": texts_of(self.spread), "others": dict(others)}
        return {
            "format": 2,
            "kind": "zeno_orbits proof",
            "problem": self.problem.name,
            "digest": digest_of(self.problem),
            "parameters": {name: text_of(x) for name, x in self.p.items()},
            "over": {},
            "gap_row": 0,
            "bits": BITS,
            "section": dict(section),
            "passes": [{"box": box, "start": self.start, "records": self.records}],
            "claims": list(claims),
            "versions": {"made by": "hand"},
        }


def around(x: Any, radius: Any) -> dict[str, str]:
    """Return the ends of a claim: all within a radius."""
    return {"low": text_of(x - radius), "high": text_of(x + radius)}


def forced_oscillator(problem: Problem, shift: float = 0.0) -> dict[str, Any]:
    """Return a certificate of the oscillator's Zeno periodic orbit, in closed form.

    Its section has no coordinates: the forcing alone says where the stop lets go.

    Args:
        problem: The oscillator.
        shift: Of the cosine at the release; then the stop lets go at another place than it does.
    """
    with mp.workdps(80):
        cosine = mp.mpf(float(problem.values().parameters["stop"])) + shift
        release = [mp.mpf(0), mp.mpf(0), cosine, mp.sqrt(1 - cosine**2)]
        made = HandMade(problem, release, mp.matrix(_N, 0), (), (0, 1))
        made.centre = release
        h, tiny = mp.mpf(1) / 8, mp.mpf(2) ** -60
        for _ in range(17):
            made.step("free", h)
        made.cross("free", h, tiny)
        made.impact()
        for k in range(34):
            if k == 0:
                made.step("free", h)
            made.cross("free", h, made.z[1] * tiny if k else tiny)
            made.impact()
        made.tail(mp.mpf("1e-4"), mp.mpf("1e-5"), mp.mpf("1e-9"))
        while made.time + 2 * h < 2 * mp.pi / made.p["omega"]:
            made.step("locked", h)
        made.cross("locked", 3 * h, mp.mpf("1e-7"), mp.mpf("1e-13"))
        others = {"centre": texts_of(release[2:]), "radius": texts_of([mp.mpf("1e-6")] * 2)}
        section = {"conditions": ["gap", "gap_rate", "multiplier"], "places": []}
        tolerance = mp.mpf("1e-7")
        zeno = mp.mpf("5.06454057578434876") - mp.acos(mp.mpf("-0.8"))
        first = mp.mpf("4.6665292208296586") - mp.acos(mp.mpf("-0.8"))
        claims = [
            {"name": "exists", "pass": 0, "by": "inclusion"},
            {"name": "unique", "pass": 0},
            {"name": "period", "pass": 0, **around(2 * mp.pi, tolerance)},
            {"name": "zeno_time", "pass": 0, "which": 0, **around(zeno, tolerance)},
            {"name": "impact_time", "pass": 0, "which": 0, **around(first, mp.mpf("1e-15"))},
        ]
        return made.certificate(section, others, claims)


def impact_oscillator(
    problem: Problem, turns: int = 1, radius: float = 1e-9, beside: float = 0.0
) -> dict[str, Any]:
    """Return a certificate of the orbit with one impact a turn, its section just after it.

    Args:
        problem: The oscillator.
        turns: After how many of them the map returns.
        radius: Of the box.
        beside: How far its centre is from the orbit.
    """
    with mp.workdps(80):
        made = HandMade(problem, [0, 0, 0, 0], mp.matrix(_N, 2), (0, 0), ())
        turn, e = 2 * mp.pi / made.p["omega"], made.p["restitution"]
        a, b = made.affine("free", turn)

        def closes(speed: Any, phase: Any) -> tuple[Any, Any]:
            z = a * mp.matrix([0, speed, mp.cos(phase), mp.sin(phase)]) + b
            return z[0], speed + e * z[1]

        # As published: phi = 0.07595216493831239, v = -1.3565863500759056, towards the stop.
        speed, phase = mp.findroot(closes, (mp.mpf("1.35658635"), mp.mpf("0.0759521649")))
        sine = mp.sin(phase) + beside
        start = [mp.mpf(0), speed + beside, mp.sqrt(1 - sine**2), sine]
        C = mp.matrix([[0, 0], [1, 0], [0, -start[3] / start[2]], [0, 1]])
        made = HandMade(problem, start, C, [mp.mpf(radius)] * 2, (0,), mp.mpf("1e-8"))
        made.centre = start
        h = mp.mpf(1) / 2
        for k in range(turns):
            while made.time + h < (k + 1) * turn:
                made.step("free", h)
            made.cross("free", h, mp.mpf("1e-6"), wide_slope=mp.mpf("1e-4"))
            made.impact()
        tolerance, disc = mp.mpf("1e-15"), mp.mpf("1e-3")
        if turns > 1:
            tolerance, disc = mp.mpf("1e-9"), mp.mpf("0.1")
        eigenvalues, vectors = mp.eig(mp.matrix([list(made.C[1, :]), list(made.C[3, :])]))
        basis = {
            part: texts_of([[getattr(vectors[i, j], long) for j in range(2)] for i in range(2)])
            for part, long in (("re", "real"), ("im", "imag"))
        }
        claims = [
            {"name": "exists", "pass": 0, "by": "inclusion"},
            {"name": "exists", "pass": 0, "by": "krawczyk"},
            {"name": "unique", "pass": 0},
            {"name": "stable", "pass": 0, "basis": basis},
            {
                "name": "multipliers",
                "pass": 0,
                "basis": basis,
                "discs": [texts_of([x.real, x.imag, disc]) for x in eigenvalues],
            },
            {"name": "period", "pass": 0, **around(turns * turn, tolerance)},
            {
                "name": "start_state",
                "pass": 0,
                "low": texts_of([x - tolerance for x in start]),
                "high": texts_of([x + tolerance for x in start]),
            },
        ]
        others = {"centre": [text_of(start[2])], "radius": [text_of(mp.mpf("1e-6"))]}
        section = {"conditions": ["gap"], "places": [1, 3]}
        return made.certificate(section, others, claims)


def mutants(
    certificate: Mapping[str, Any], count: int, seed: int, part: str = ""
) -> Iterator[dict[str, Any]]:
    """Yield copies of a certificate with one changed entry, of one part or of the whole."""
    chance = random.Random(seed)
    for _ in range(count):
        mutant: dict[str, Any] = copy.deepcopy(dict(certificate))
        mutate(mutant[part] if part else mutant, chance)
        yield mutant


def mutate(data: Any, chance: random.Random) -> None:
    """Change one entry of plain data, at any depth."""
    while True:
        key: Any = chance.choice(list(data) if isinstance(data, dict) else range(len(data)))
        if not isinstance(data[key], dict | list) or not data[key] or chance.random() < 0.02:
            break
        data = data[key]
    if isinstance(data, list) and chance.random() < 0.1:
        data.insert(key, copy.deepcopy(chance.choice(data)))
    elif chance.random() < 0.1:
        del data[key]
    elif isinstance(data[key], int):
        data[key] += chance.choice([-1, 1])
    elif isinstance(data[key], str):
        place = chance.randrange(len(data[key]))
        data[key] = (
            data[key][:place] + chance.choice("0123456789abcdef-px") + data[key][place + 1 :]
        )
    else:
        data[key] = None
