"""Random machines with several stops, switches and kinks: are their executions right?

    python benchmarks/random_graphs.py --machines 300 --seed 1

A machine has one to three coordinates, one or two stops, and at random clipped voltages, switched
gains, drag, friction and a switch that resets its state. With `--wide` it has none to three stops,
and at random a waveform, a bumper whose kink lies on a stop, and a second switch, also on the
surface of the first. The reference is the event loop of
`tests/reference/event_loop.py`, which shares no code with the package. Its equations are written
in NumPy from the same random numbers. Every event is compared: kind, stop, order, time and state.

Where rounding decides in the reference, the comparison ends. Exit 1 if an execution differs, or
is refused while the reference continues.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import zeno_orbits as zo
from tests.reference.event_loop import Accuracy, Contact, Event, Machine, Reset, Run, simulated

TIME, STATE = 1e-8, 1e-7
"""Differences of time and state that agree, relative to ``1 + |t|`` and ``1 + |x|``."""
SENSITIVE = 300.0
"""Factor of the difference of two runs of the reference that agrees, if it is larger."""
LOOSE, TIGHT = Accuracy(tolerance=1e-10, slow=6e-3), Accuracy(tolerance=3e-14, slow=1e-3)
JUMPS = ("jump", "other")
"""Names of the switches."""
FORMULAS = ("spring", "push", "damper", "drag", "friction", "clip", "bump", "pulse", "ramp")


@dataclass(frozen=True, kw_only=True)
class Term:
    """A formula with a kink, which acts on one coordinate.

    ``spring``: stiffness beyond a position. ``push``: constant force there. ``damper``: damping
    there. ``drag``: ``-a v |v|``. ``friction``: ``-a sign(v)``. ``clip``: clipped feedback.
    ``bump``: ``-a max(0, q - s)^2``. ``pulse``: a force that the clock switches. ``ramp``: a
    feedback that is nested, ``max(0, min(a, p q))``.
    """

    kind: str
    at: int
    by: int
    size: float
    place: float
    gains: tuple[float, float, float]

    def in_casadi(self, q: ca.SX, v: ca.SX, clock: zo.Clock) -> ca.SX:
        """Return the force as a user writes it."""
        x, w, cosine = q[self.by], v[self.at], clock.cosine
        if self.kind == "pulse":
            return self.size * ca.if_else(clock.sine > self.place, 1, -0.5)
        if self.kind == "ramp":
            return ca.fmax(0, ca.fmin(self.size, self.gains[0] * (x - self.place)))
        if self.kind == "spring":
            return ca.if_else(x > self.place, -self.size * (x - self.place), 0)
        if self.kind == "push":
            return ca.if_else(x > self.place, self.size, -0.3 * self.size)
        if self.kind == "damper":
            return -ca.if_else(x < self.place, self.size, 0.2 * self.size) * w
        if self.kind == "drag":
            return -self.size * w * ca.fabs(w)
        if self.kind == "friction":
            return -0.3 * self.size * ca.sign(w)
        if self.kind == "bump":
            return -self.size * ca.fmax(0, x - self.place) ** 2
        return ca.fmax(-self.size, ca.fmin(self.size, self.law(x, w, cosine)))

    def law(self, x: Any, w: Any, cosine: Any) -> Any:
        """Return the feedback before it is clipped."""
        p, d, a = self.gains
        return a * cosine - p * x - d * w

    @property
    def kinks(self) -> list[tuple[Any, ...]]:
        """What its conditions depend on. Terms with the same condition change together."""
        if self.kind in ("clip", "ramp"):
            return [(self.kind, self.place, side) for side in (1, -1)]
        if self.kind == "pulse":
            return [(self.kind, self.place)]
        return [(self.at,)] if self.kind in ("drag", "friction") else [(self.by, self.place)]

    def conditions(
        self, cosine: Callable[[float], float], sine: Callable[[float], float]
    ) -> list[Callable[..., float]]:
        """Return the conditions in NumPy."""
        at, by, size, place = self.at, self.by, self.size, self.place
        if self.kind == "pulse":
            return [lambda t, _q, _v, _z: sine(t) - place]
        if self.kind == "ramp":
            return [
                lambda _t, q, _v, _z: size - self.gains[0] * (q[by] - place),
                lambda _t, q, _v, _z: self.gains[0] * (q[by] - place),
            ]
        if self.kind in ("drag", "friction"):
            return [lambda _t, _q, v, _z: v[at]]
        if self.kind == "clip":
            return [
                lambda t, q, v, _z: size - self.law(q[by], v[at], cosine(t)),
                lambda t, q, v, _z: size + self.law(q[by], v[at], cosine(t)),
            ]
        return [lambda _t, q, _v, _z: q[by] - place]

    def in_numpy(
        self, q: np.ndarray, v: np.ndarray, cosine: float, branches: tuple[bool, ...]
    ) -> float:
        """Return the force on given branches."""
        beyond, x, w = branches[0], q[self.by], v[self.at]
        if self.kind == "clip":
            if not branches[0]:
                return self.size
            return self.law(x, w, cosine) if branches[1] else -self.size
        if self.kind == "ramp":
            inside = self.gains[0] * (x - self.place) if branches[1] else 0.0
            return inside if branches[0] else self.size
        sign = 1.0 if beyond else -1.0
        return {
            "spring": -self.size * (x - self.place) if beyond else 0.0,
            "pulse": self.size if beyond else -0.5 * self.size,
            "push": self.size if beyond else -0.3 * self.size,
            "damper": -(0.2 if beyond else 1.0) * self.size * w,
            "drag": -sign * self.size * w * w,
            "friction": -sign * 0.3 * self.size,
            "bump": -self.size * (x - self.place) ** 2 if beyond else 0.0,
        }[self.kind]


@dataclass(frozen=True, kw_only=True)
class Wave:
    """A force of two or three levels that switches at phases of the clock: no level, then others.

    Each of its intervals of phases has a level, and both together have their sum.
    """

    at: int
    levels: tuple[float, ...]
    phases: tuple[float, ...]

    @property
    def intervals(self) -> list[tuple[float, float]]:
        """Return the middle and half length of each interval."""
        half = len(self.phases) // 2
        pairs = zip(self.phases[:half], self.phases[half:], strict=True)
        return [((low + high) / 2, (high - low) / 2) for low, high in pairs]

    def in_casadi(self, clock: zo.Clock, omega: float) -> ca.SX:
        """Return the force as a user writes it."""
        first, last = self.levels[0], self.levels[-1]
        levels = (0, first, 0) if len(self.levels) == 1 else (0, first, first + last, last, 0)
        return zo.piecewise(clock, levels, [phase / omega for phase in self.phases])

    def conditions(self, angle: Callable[[float], float]) -> list[Callable[..., float]]:
        """Return the conditions in NumPy."""
        return [
            lambda t, _q, _v, _z, m=m, a=a: math.cos(angle(t) - m) - math.cos(a)
            for m, a in self.intervals
        ]


@dataclass(frozen=True, kw_only=True)
class Barrier:
    """A stop: ``d + a q + b q_0^2 / 2``, or the wall ``d - sum a_j sin q_j``."""

    name: str
    offset: float
    row: np.ndarray
    bend: float
    wall: bool
    restitution: float

    @property
    def parameter(self) -> str:
        """Name of the parameter of its restitution."""
        return "restitution" if self.name == "first" else f"restitution_{self.name}"

    def in_casadi(self, q: ca.SX) -> ca.SX:
        """Return the gap."""
        row = ca.DM(self.row)
        if self.wall:
            return self.offset - ca.dot(row, ca.sin(q))
        return self.offset + ca.dot(row, q) + self.bend * q[0] ** 2 / 2

    def in_numpy(self) -> Contact:
        """Return the stop of the reference."""
        row, first = self.row, np.eye(len(self.row))[0]
        if self.wall:
            return Contact(
                name=self.name,
                gap=lambda q: self.offset - float(row @ np.sin(q)),
                normal=lambda q: -row * np.cos(q),
                bend=lambda q, v: float(row @ (np.sin(q) * v**2)),
                restitution=self.restitution,
            )
        return Contact(
            name=self.name,
            gap=lambda q: self.offset + float(row @ q) + self.bend * q[0] ** 2 / 2,
            normal=lambda q: row + self.bend * q[0] * first,
            bend=lambda _q, v: self.bend * v[0] ** 2,
            restitution=self.restitution,
        )


@dataclass(frozen=True, kw_only=True)
class Jump:
    """A switch: ``side (q_at - place)`` falls through zero while ``side_2 v_by + level > 0``.

    ``scale``: all velocities times `factor`. ``turn``: one velocity times it. ``shift``: one
    coordinate plus it. ``exchange``: the first two coordinates exchange names. ``current``: the
    current times it. ``none``: nothing changes.
    """

    kind: str
    at: int
    side: float
    place: float
    by: int
    side_2: float
    level: float
    factor: float

    def after(self, q: list[Any], v: list[Any], z: list[Any]) -> tuple[list[Any], ...]:
        """Return the state after the switch, of numbers or symbols."""
        q, v, z = list(q), list(v), list(z)
        if self.kind == "scale":
            v = [self.factor * one for one in v]
        elif self.kind == "turn":
            v[self.by] = self.factor * v[self.by]
        elif self.kind == "shift":
            q[self.at] = q[self.at] + self.side * abs(self.factor)
        elif self.kind == "exchange":
            q[0], q[1], v[0], v[1] = q[1], q[0], v[1], v[0]
        elif self.kind == "current":
            z = [self.factor * one for one in z]
        return q, v, z


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """The random numbers of a machine."""

    seed: tuple[int, int]
    n: int
    links: bool
    weights: np.ndarray
    pull: np.ndarray
    stiffness: np.ndarray
    rest: np.ndarray
    damping: np.ndarray
    push: np.ndarray
    omega: float
    phase: float
    terms: tuple[Term, ...]
    barriers: tuple[Barrier, ...]
    jumps: tuple[Jump, ...]
    circuit: tuple[float, ...]
    q: np.ndarray
    v: np.ndarray
    i: tuple[float, ...]
    waves: tuple[Wave, ...] = ()
    bumper: float = 0.0

    @property
    def state(self) -> list[float]:
        """The first state without the clock."""
        return [*self.q, *self.v, *self.i]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the states without the clock."""
        return (
            *(f"q{k}" for k in range(self.n)),
            *(f"v{k}" for k in range(self.n)),
            *(("current",) if self.i else ()),
        )

    def __str__(self) -> str:
        """Describe the machine in a line."""
        kinds = [term.kind for term in self.terms] + (["circuit"] if self.circuit else [])
        stops = [
            f"{b.name}(e={b.restitution:.3g}{', wall' if b.wall else ''}"
            f"{', bent' if b.bend else ''})"
            for b in self.barriers
        ]
        kinds += ["wave"] * len(self.waves) + ["bumper"] * (self.bumper > 0.0)
        jump = "".join(f", switch {one.kind}" for one in self.jumps)
        shape = "links" if self.links else "masses"
        return f"{self.seed}: {self.n} {shape}, {' '.join(stops)}, {' '.join(kinds)}{jump}"


def _positive_definite(rng: np.random.Generator, n: int, coupled: float) -> np.ndarray:
    A = rng.normal(size=(n, n))
    return np.diag(rng.uniform(0.5, 1.5, n)) + coupled * A @ A.T


def drawn(seed: int, index: int) -> Drawn:
    """Return the random numbers of one machine."""
    rng = np.random.default_rng([seed, index])
    n = int(rng.integers(1, 4))
    links = bool(rng.random() < 0.35)
    n_stops = int(rng.choice([1, 2], p=[0.3, 0.7]))
    n_terms = int(rng.choice([0, 1, 2], p=[0.35, 0.45, 0.2]))
    weights = _positive_definite(rng, n, 0.4)
    omega = rng.uniform(0.7, 2.5)
    terms = tuple(
        Term(
            kind=str(rng.choice(FORMULAS)),
            at=int(rng.integers(n)),
            by=int(rng.integers(n)),
            size=rng.uniform(0.3, 1.5),
            place=rng.uniform(-0.4, 0.4),
            gains=(rng.uniform(0.5, 3), rng.uniform(0.0, 1.0), rng.uniform(0.5, 2.0)),
        )
        for _ in range(n_terms)
    )
    circuit: tuple[float, ...] = ()
    if rng.random() < 0.25:
        circuit = (
            *(rng.uniform(0.2, 1.0), rng.uniform(0.5, 2.0), rng.uniform(0.3, 1.5)),
            *(rng.uniform(0.5, 3.0), rng.uniform(0.3, 1.5), rng.uniform(1.0, 4.0)),
        )
    jump = None
    if rng.random() < 0.35:
        kinds = ["scale", "turn", "shift", "none"]
        kinds += ["exchange"] if n > 1 else []
        kinds += ["current"] if circuit else []
        jump = Jump(
            kind=str(rng.choice(kinds)),
            at=int(rng.integers(n)),
            side=float(rng.choice([-1.0, 1.0])),
            place=rng.uniform(-0.3, 0.3),
            by=int(rng.integers(n)),
            side_2=float(rng.choice([-1.0, 1.0])),
            level=rng.uniform(-0.2, 1.0),
            factor=rng.uniform(-0.6, 0.9),
        )
    barriers = _barriers(rng, n, n_stops, links)
    while True:
        q, v = rng.uniform(-0.6, 0.6, n), rng.uniform(-1.0, 1.0, n)
        if all(b.in_numpy().gap(q) > 0.05 for b in barriers):
            break
    return Drawn(
        seed=(seed, index),
        n=n,
        links=links,
        weights=weights,
        pull=rng.uniform(0.5, 4.0, n) if links else np.zeros(n),
        stiffness=_positive_definite(rng, n, 0.3) * rng.uniform(0.3, 2.0),
        rest=rng.uniform(-0.8, 0.8, n),
        damping=_positive_definite(rng, n, 0.1) * rng.uniform(0.02, 0.3),
        push=rng.uniform(-3.0, 3.0, n),
        omega=omega,
        phase=rng.uniform(0, 2 * math.pi),
        terms=terms,
        barriers=barriers,
        jumps=() if jump is None else (jump,),
        circuit=circuit,
        q=q,
        v=v,
        i=(rng.uniform(-1, 1),) if circuit else (),
    )


def widened(d: Drawn) -> Drawn:
    """Return a machine with another number of stops, and at random with further parts."""
    rng = np.random.default_rng([*d.seed, 1])
    barriers, jumps, waves = d.barriers, d.jumps, tuple[Wave, ...]()
    chosen = rng.random()
    if chosen < 0.15:
        # A stop beyond reach, as a machine without a stop has.
        barriers = (replace(barriers[0], offset=1e3, bend=0.0),)
    elif chosen < 0.5:
        third = replace(_barriers(rng, d.n, 1, d.links)[0], name="third")
        if third.in_numpy().gap(d.q) > 0.05:
            barriers = (*barriers, third)
    if rng.random() < 0.4:
        n = int(rng.choice([2, 4]))
        phases = np.sort(rng.uniform(0.2, 6.0, n)) + 0.1 * np.arange(n) / n
        levels = tuple(rng.uniform(-2.0, 2.0, n // 2).tolist())
        waves = (Wave(at=int(rng.integers(d.n)), levels=levels, phases=tuple(phases.tolist())),)
    if rng.random() < 0.45:
        first = jumps[0] if jumps else None
        kind = str(rng.choice(["scale", "turn", "shift", "none"]))
        other = Jump(
            kind=kind,
            at=int(rng.integers(d.n)),
            side=float(rng.choice([-1.0, 1.0])),
            place=rng.uniform(-0.3, 0.3),
            by=int(rng.integers(d.n)),
            side_2=float(rng.choice([-1.0, 1.0])),
            level=rng.uniform(-0.2, 1.0),
            factor=rng.uniform(-0.6, 0.9),
        )
        if first is not None and rng.random() < 0.6:
            other = replace(other, at=first.at, side=-first.side, place=first.place)
        jumps = (*jumps, other)
    bumper = rng.uniform(5.0, 40.0) if rng.random() < 0.25 else 0.0
    return replace(d, barriers=barriers, jumps=jumps, waves=waves, bumper=bumper)


def _barriers(rng: np.random.Generator, n: int, n_stops: int, links: bool) -> tuple[Barrier, ...]:
    """Return one or two stops. Two may be on both sides of one link."""
    both = n_stops == 2 and (n == 1 or rng.random() < 0.35)
    found: list[Barrier] = []
    for k, name in enumerate(("first", "second")[:n_stops]):
        wall = links and rng.random() < 0.3
        row = rng.normal(size=n)
        row = row / np.linalg.norm(row)
        if rng.random() < 0.3:
            row = np.eye(n)[int(rng.integers(n))] * rng.choice([-1.0, 1.0])
        if k == 1 and both:
            row, wall = -found[0].row, found[0].wall
        e = 0.0 if rng.random() < 0.12 else rng.uniform(0.2, 0.75)
        found.append(
            Barrier(
                name=name,
                offset=rng.uniform(0.05, 0.6),
                row=row,
                bend=rng.uniform(-0.4, 0.4) if not wall and rng.random() < 0.2 else 0.0,
                wall=wall,
                restitution=float(e),
            )
        )
    return tuple(found)


def reference_machine(d: Drawn) -> Machine:
    """Return the machine of the reference, in NumPy."""

    def cosine(t: float) -> float:
        return math.cos(d.omega * t + d.phase)

    def sine(t: float) -> float:
        return math.sin(d.omega * t + d.phase)

    known: dict[tuple[Any, ...], Callable[..., float]] = {}
    for term in d.terms:
        for key, condition in zip(term.kinks, term.conditions(cosine, sine), strict=True):
            known.setdefault(key, condition)
    places = [[list(known).index(key) for key in term.kinks] for term in d.terms]
    contacts = tuple(b.in_numpy() for b in d.barriers)
    first_wave = len(known)
    for wave in d.waves:
        for k, condition in enumerate(wave.conditions(lambda t: d.omega * t + d.phase)):
            known["wave", k] = condition
    first_bumper = len(known)
    if d.bumper:
        known["bumper",] = lambda _t, q, _v, _z: -contacts[0].gap(q)

    def mass(q: np.ndarray) -> np.ndarray:
        return d.weights * np.cos(q[:, None] - q[None, :]) if d.links else d.weights

    def force(
        t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray, branches: tuple[bool, ...]
    ) -> np.ndarray:
        c = cosine(t)
        f = d.push * c - d.damping @ v - d.stiffness @ (q - d.rest) - d.pull * np.sin(q)
        if d.links:
            f = f - (d.weights * np.sin(q[:, None] - q[None, :])) @ v**2
        for term, at in zip(d.terms, places, strict=True):
            f[term.at] += term.in_numpy(q, v, c, tuple(branches[k] for k in at))
        for wave in d.waves:
            on = branches[first_wave : first_wave + len(wave.levels)]
            f[wave.at] += sum(level for level, is_on in zip(wave.levels, on, strict=True) if is_on)
        if d.bumper and branches[first_bumper]:
            f[0] += d.bumper * contacts[0].gap(q)
        if d.circuit:
            f[0] += d.circuit[2] * z[0]
        return f

    def voltage(t: float, q: np.ndarray) -> float:
        return d.circuit[5] * cosine(t) - d.circuit[3] * q[0]

    def rate(
        t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray, branches: tuple[bool, ...]
    ) -> np.ndarray:
        if not d.circuit:
            return np.empty(0)
        inductance, resistance, constant, _, limit, _ = d.circuit
        below, above = branches[-2:]
        V = voltage(t, q) if below and above else limit if above else -limit
        return np.array([(V - resistance * z[0] - constant * v[0]) / inductance])

    kinks = list(known.values())
    if d.circuit:
        limit = d.circuit[4]
        kinks.append(lambda t, q, _v, _z: limit - voltage(t, q))
        kinks.append(lambda t, q, _v, _z: limit + voltage(t, q))

    def reset(name: str, j: Jump) -> Reset:
        def after(_t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> Any:
            return tuple(np.array(part, dtype=float) for part in j.after([*q], [*v], [*z]))

        return Reset(
            name=name,
            guard=lambda _t, q, _v, _z: j.side * (q[j.at] - j.place),
            armed=lambda _t, _q, v, _z: j.side_2 * v[j.by] + j.level,
            after=after,
        )

    return Machine(
        n=d.n,
        mass=mass,
        force=force,
        rate=rate,
        contacts=contacts,
        kinks=tuple(kinks),
        resets=tuple(map(reset, JUMPS, d.jumps)),
        scale=0.1,
    )


def problem(d: Drawn) -> zo.Problem:
    """Return the machine as a problem of the package."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", d.n), ca.SX.sym("v", d.n)
        clock = zo.Clock.at(ca.SX(d.omega))
        weights: Any = ca.DM(d.weights)
        if d.links:
            weights = weights * ca.cos(ca.repmat(q, 1, d.n) - ca.repmat(q.T, d.n, 1))
        away = q - ca.DM(d.rest)
        passive = -ca.mtimes(ca.DM(d.damping), v)
        applied = ca.DM(d.push) * clock.cosine
        for term in d.terms:
            unit = ca.DM(np.eye(d.n)[term.at])
            f = term.in_casadi(q, v, clock)
            if term.kind in ("drag", "friction", "damper"):
                passive += unit * f
            else:
                applied += unit * f
        for wave in d.waves:
            applied += ca.DM(np.eye(d.n)[wave.at]) * wave.in_casadi(clock, d.omega)
        if d.bumper:
            applied -= ca.DM(np.eye(d.n)[0]) * d.bumper * ca.fmax(-d.barriers[0].in_casadi(q), 0)
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.dot(v, ca.mtimes(weights, v)) / 2,
            potential=ca.dot(away, ca.mtimes(ca.DM(d.stiffness), away)) / 2
            - ca.dot(ca.DM(d.pull), ca.cos(q)),
            passive_force=passive,
            applied_force=applied,
            clock=clock,
            stops=tuple(
                zo.Stop(name=b.name, gap=b.in_casadi(q), restitution=p[b.parameter])
                for b in d.barriers
            ),
        )
        drive: Any = zo.no_drive(mechanism)
        z: list[ca.SX] = []
        if d.circuit:
            inductance, resistance, constant, gain, limit, size = d.circuit
            i = ca.SX.sym("i")
            z = [i]
            source = size * clock.cosine - gain * q[0]
            drive = zo.circuit_drive(
                mechanism,
                zo.Circuit(
                    currents=i,
                    coenergy=inductance * i**2 / 2 + constant * i * q[0],
                    resistance=ca.SX(resistance),
                    source=ca.fmax(-limit, ca.fmin(limit, source)),
                ),
            )
        switches: list[zo.Switch] = []
        for name, j in zip(JUMPS, d.jumps, strict=False):
            q_after, v_after, z_after = j.after(ca.vertsplit(q), ca.vertsplit(v), z)
            given: dict[str, ca.SX] = {}
            if j.kind in ("shift", "exchange"):
                given["q_after"] = ca.vertcat(*q_after)
            if j.kind in ("scale", "turn", "exchange"):
                given["v_after"] = ca.vertcat(*v_after)
            if j.kind == "current":
                given["others_after"] = ca.vertcat(*z_after)
            guard, armed = j.side * (q[j.at] - j.place), j.side_2 * v[j.by] + j.level
            switches.append(zo.Switch(name=name, guard=guard, armed=armed, **given))
        return zo.hybrid_system(mechanism, drive, switches=switches)

    unit = "rad" if d.links else "m"
    return zo.Problem(
        name="random",
        title="random machine",
        source="benchmarks/random_graphs.py",
        state_names=(*d.names, "cosine", "sine"),
        state_units=(
            *([unit] * d.n),
            *([f"{unit}/s"] * d.n),
            *(["A"] if d.circuit else []),
            *("1", "1"),
        ),
        parameters=tuple(
            replace(zo.Quantity.restitution(b.restitution), name=b.parameter) for b in d.barriers
        ),
        gains=(),
        model=model,
        starts=({"cosine": 1.0},),
        portraits=(("q0", "v0"),),
        amplitude_of="q0",
    )


@dataclass(frozen=True, kw_only=True)
class Seen:
    """An event of the package, in the words of the reference."""

    kind: str
    name: str
    time: float
    before: np.ndarray
    after: np.ndarray
    closed: tuple[str, ...] | None


def seen_events(execution: zo.Execution, declared: tuple[str, ...]) -> list[Seen]:
    """Return the events of an execution."""
    found: list[Seen] = []
    starts = np.array([arc.start_time for arc in execution.arcs])
    for event in execution.events:
        kind = type(event).__name__
        name = event.name if kind == "SwitchEvent" else event.stop
        both = kind in ("Impact", "SwitchEvent")
        at = int(np.searchsorted(starts, event.time + 1e-13, side="right")) - 1
        begins = at >= 0 and abs(starts[at] - event.time) < 1e-12
        found.append(
            Seen(
                kind={
                    "Impact": "impact",
                    "ZenoPoint": "zeno",
                    "Release": "release",
                    "SwitchEvent": "switch",
                }[kind],
                name=name if kind != "SwitchEvent" or name in declared else "",
                time=event.time,
                before=np.array(event.state_minus if both else event.state),
                after=np.array(event.state_plus if both else event.state),
                closed=tuple(sorted(execution.arcs[at].closed)) if begins else None,
            )
        )
    return found


@dataclass(slots=True)
class Verdict:
    """How two executions compare.

    Attributes:
        kind: ``agree``, ``refused``, ``disagree`` or ``unsure``.
        text: The reason, or the name of the error.
        compared: Number of events that agree.
        notes: Differences that are no errors.
    """

    kind: str
    text: str
    compared: int = 0
    notes: Counter[str] = field(default_factory=Counter[str])


def _far(a: np.ndarray, b: np.ndarray) -> float:
    n = min(len(a), len(b))
    return float(np.max(np.abs(a[:n] - b[:n]) / (1 + np.abs(b[:n])), initial=0.0))


def _next_limit(events: list[Any], at: int, name: str) -> int | None:
    """Return the index of a limit of the impacts on a stop that these events lead to."""
    while at < len(events):
        event = events[at]
        if event.kind == "zeno":
            return at if event.name == name else None
        if not (
            (event.kind == "impact" and event.name == name)
            or (event.kind == "switch" and not event.name)
        ):
            return None
        at += 1
    return None


def _inside_limit(mine: list[Event], i: int, theirs: list[Seen], j: int) -> bool:
    """Test whether the lists end inside the same sequence of impacts."""
    for one, other in ((mine[i : i + 1], theirs[j : j + 1]), (theirs[j : j + 1], mine[i : i + 1])):
        if one and one[0].kind == "zeno":
            kink = other and other[0].kind == "switch" and not other[0].name
            if not other or kink or other[0].name == one[0].name:
                return True
    return False


def compared(
    run: Run, seen: list[Seen], slack: Callable[[int], tuple[float, float]], end: float
) -> Verdict:
    """Compare the events of the reference with those of the package up to a time."""
    i = j = n = 0
    notes: Counter[str] = Counter()
    mine = [one for one in run.events if one.time < end]
    theirs = [one for one in seen if one.time < end]
    while i < len(mine) or j < len(theirs):
        a = mine[i] if i < len(mine) else None
        b = theirs[j] if j < len(theirs) else None
        same = a is not None and b is not None and (a.kind, a.name) == (b.kind, b.name)
        if a and b and a.kind != b.kind:
            if b.kind == "zeno" and (to := _next_limit(mine, i, b.name)) is not None:
                i = to
                continue
            if a.kind == "zeno" and (to := _next_limit(theirs, j, a.name)) is not None:
                j = to
                continue
        if (a is None or b is None) and _inside_limit(run.events, i, seen, j):
            break
        if a is None or b is None or not same:
            return Verdict("disagree", f"event {n}: {_shown(a)} / {_shown(b)}", n, notes)
        time_slack, state_slack = slack(i)
        off = abs(a.time - b.time) / (1 + a.time)
        if off > time_slack:
            return Verdict(
                "disagree", f"event {n}: time off by {off:.2g}: {_shown(a)} / {_shown(b)}", n, notes
            )
        off = max(_far(b.before, a.before), _far(b.after, a.after))
        if off > state_slack:
            text = f"event {n}: state off by {off:.2g}: {_shown(a)} / {_shown(b)}"
            return Verdict("disagree", text, n, notes)
        last_at_once = i + 1 == len(mine) or mine[i + 1].time > a.time
        known = b.closed is not None and last_at_once and not a.forced
        if known and set(b.closed or ()) != set(a.closed):
            text = f"event {n}: closed {a.closed} / {b.closed}: {_shown(a)}"
            return Verdict("disagree", text, n, notes)
        i, j, n = i + 1, j + 1, n + 1
    return Verdict("agree", "", n, notes)


def _shown(event: Event | Seen | None) -> str:
    return "nothing" if event is None else f"{event.kind} {event.name} at {event.time:.12g}"


def judged(d: Drawn, turns: float) -> tuple[Verdict, Run, list[Seen], tuple[float, float]]:
    """Return the verdict on a machine, both lists of events, and the seconds of both."""
    until = turns * 2 * math.pi / d.omega
    machine = reference_machine(d)
    begun = time.process_time()
    run = simulated(machine, d.state, until)
    middle = time.process_time()
    start = dict(zip(d.names, map(float, d.state), strict=True))
    start |= {"cosine": math.cos(d.phase), "sine": math.sin(d.phase)}
    error: zo.SimulationError | None = None
    try:
        execution = zo.simulate(problem(d), until=until, start=start)
    except zo.SimulationError as raised:
        error, execution = raised, raised.execution
    seconds = (middle - begun, time.process_time() - middle)
    declared = JUMPS[: len(d.jumps)]
    seen = [] if execution is None else seen_events(execution, declared)
    sure = until - 1e-6
    if run.refused or run.unsure:
        # After its last event the reference may be inside a sequence of impacts.
        last = run.events[-1] if run.events else None
        sure = run.end_time - 1e-6
        if last is not None and (last.kind == "impact" or last.name):
            sure = min(sure, last.time + 1e-9)
    end = min(sure, until if error is None else error.time - 1e-6)
    found = compared(run, seen, lambda _: (TIME, STATE), end)
    if found.kind == "disagree":
        loose = simulated(machine, d.state, until, accuracy=LOOSE)
        found = _within_sensitivity(run, loose, seen, end) or found
    if found.kind == "disagree":
        # The reference may be less exact than the package where motions are sensitive.
        exact = simulated(machine, d.state, until, accuracy=TIGHT)
        found = _within_sensitivity(exact, run, seen, end) or found
    if found.kind != "disagree":
        found = _ending(found, run, error, execution)
    elif error is not None:
        found.text += f"; {type(error).__name__}: {error}"
    return found, run, seen, seconds


def _within_sensitivity(run: Run, loose: Run, seen: list[Seen], end: float) -> Verdict | None:
    """Compare with the differences of two runs of the reference as a measure of error."""
    first = [e for e in run.events if e.kind != "impact"]
    second = [e for e in loose.events if e.kind != "impact"]
    worst, last, sure = 0.0, [0.0], end
    for a, b in zip(first, second, strict=False):
        if (a.kind, a.name) != (b.kind, b.name):
            sure = min(sure, a.time - 1e-6)
            break
        worst = max(worst, abs(a.time - b.time), _far(a.before, b.before), _far(a.after, b.after))
        last.append(worst)
        if worst > 1e-5:
            sure = min(sure, a.time)
            break

    times = [0.0, *(a.time for a in first)]

    def slack(i: int) -> tuple[float, float]:
        at = int(np.searchsorted(times, run.events[i].time, side="left"))
        error = SENSITIVE * last[min(at, len(last) - 1)]
        return max(TIME, error), max(STATE, error)

    found = compared(run, seen, slack, sure)
    if found.kind == "disagree":
        return None
    found.notes["a sensitive motion"] += 1
    if sure < end:
        return Verdict("unsure", "the motion is too sensitive", found.compared, found.notes)
    return found


def _kink_in_every_flight(run: Run, time: float) -> bool:
    """Test whether a kink is crossed in the last two flights of a sequence before a time."""
    kinds = [
        "reset" if event.kind == "switch" and event.name else event.kind
        for event in run.events
        if event.time < time + 1e-6
    ]
    while kinds and kinds[-1] == "zeno":
        kinds.pop()
    text = " ".join(kinds[-6:]).removesuffix(" switch").removesuffix(" switch")
    return text.endswith(("impact switch impact", "impact switch switch impact"))


def _ending(
    found: Verdict, run: Run, error: zo.SimulationError | None, execution: zo.Execution | None
) -> Verdict:
    """Compare how two executions end."""
    n, notes = found.compared, found.notes
    if found.kind == "unsure":
        return found
    if error is not None:
        name = type(error).__name__
        names = {run.refused.reason} if run.refused else set[str]()
        # An accumulation may be refused as soon as it is recognized.
        early = 0.1 if names & {"ChatterError", "SimultaneousEventsError"} else 1e-3
        if names == {"ChatterError"}:
            # A switch may leave its guard at zero and falling, or accumulate with impacts.
            names |= {"SimulationError", "SimultaneousEventsError"}
        if run.refused and name in names and run.refused.time < error.time + early:
            return Verdict("refused", name, n, notes)
        if run.unsure and run.unsure.time < error.time + 1e-6:
            return Verdict("unsure", f"{run.unsure}; {name}", n, notes)
        if name == "SimultaneousEventsError" and _kink_in_every_flight(run, error.time):
            return Verdict("refused", f"{name}, a kink in every flight of a sequence", n, notes)
        if run.refused:
            text = f"{error}: the reference says {run.refused}"
            return Verdict("disagree", text, n, notes)
        return Verdict("disagree", f"{name}: {error}, the reference continues", n, notes)
    if run.refused:
        return Verdict("disagree", f"not refused: {run.refused}", n, notes)
    if run.unsure:
        return Verdict("unsure", str(run.unsure), n, notes)
    if execution is not None and not notes["a sensitive motion"]:
        off = _far(np.array(execution.end_state), run.end_state)
        if off > 1e-6:
            return Verdict("disagree", f"the end is off by {off:.2g}", n, notes)
    return found


def main() -> int:
    """Print how many executions agree, and each that does not."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--machines", type=int, default=300, metavar="N")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed of the machines")
    parser.add_argument("--turns", type=float, default=4.0, metavar="N", help="turns of the force")
    parser.add_argument("--wide", action="store_true", help="more stops, waveforms and switches")
    parser.add_argument("--only", type=int, metavar="INDEX", help="one machine, with its events")
    options = parser.parse_args()
    indices = range(options.machines) if options.only is None else (options.only,)
    kinds: Counter[str] = Counter()
    refused: Counter[str] = Counter()
    notes: Counter[str] = Counter()
    events: Counter[str] = Counter()
    seconds = np.zeros(2)
    for index in indices:
        d = drawn(options.seed, index)
        d = widened(d) if options.wide else d
        verdict, run, seen, spent = judged(d, options.turns)
        seconds += spent
        kinds[verdict.kind] += 1
        notes += verdict.notes
        events.update(event.kind for event in run.events)
        if verdict.kind == "refused":
            refused[verdict.text] += 1
        if verdict.kind == "disagree" or options.only is not None:
            print(f"{verdict.kind} {d}\n    {verdict.text}", flush=True)
            first = max(0, verdict.compared - 2) if options.only is None else 0
            last = len(run.events) + len(seen) if options.only is not None else first + 6
            for title, one in (("reference", run.events), ("zeno_orbits", seen)):
                print(f"    {title}: " + "; ".join(map(_shown, one[first:last])), flush=True)
    print(f"seed {options.seed}: " + ", ".join(f"{kind} {n}" for kind, n in kinds.most_common()))
    for title, counted in (("refused", refused), ("events", events), ("notes", notes)):
        for text, n in counted.most_common():
            print(f"{title}: {text} {n}")
    print(f"{seconds[0]:.1f} s for the reference, {seconds[1]:.1f} s for the executions")
    return int(kinds["disagree"] > 0)


if __name__ == "__main__":
    sys.exit(main())
