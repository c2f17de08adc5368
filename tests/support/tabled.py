"""A mass under a table above a stop, and an oscillator under a record, with its exact motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import expm

import zeno_orbits as zo

Formula = Callable[[ca.SX, ca.SX], ca.SX]
"""From place and speed to a force or a gap."""
C = 0.3
"""Damping of the oscillator."""
FLOW = np.array([[0, 1, 0, 0], [-1, -C, 1, 0], [0, 0, 0, 1], [0, 0, 0, 0]], dtype=float)
"""Matrix of the oscillator's place and speed, its input and the input's rate."""


def mass(
    force: Formula, *, restitution: float = 0.5, gap: Formula | None = None, damping: float = 0.0
) -> zo.Problem:
    """Return a mass above a stop at zero, under a force of its place and speed."""

    def model(p: Any) -> zo.CompletedSystem:
        x, v = ca.SX.sym("x"), ca.SX.sym("v")
        one = zo.HybridLagrangian.from_energies(
            q=x,
            v=v,
            kinetic=v**2 / 2,
            potential=ca.SX(0),
            gap=x if gap is None else gap(x, v),
            passive_force=force(x, v) - damping * v,
        )
        return zo.hybrid_system(one, zo.no_drive(one), p["restitution"])

    return zo.Problem(
        name="mass",
        title="mass under a table",
        source="tests/support/tabled.py",
        state_names=("x", "v"),
        state_units=("m", "m/s"),
        parameters=(zo.Quantity.restitution(restitution),),
        gains=(),
        model=model,
        starts=({"x": 2.0},),
        portraits=(("x", "v"),),
        amplitude_of="x",
    )


def wavy(n: int, low: float = -1.1, high: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """Return knots and the values of a bent spring that pulls to zero."""
    knots = np.linspace(low, high, n)
    return knots, -4.0 - 2.0 * knots - np.sin(2.0 * knots)


def oscillator(record: zo.Record) -> zo.Problem:
    """Return an oscillator under a record, far from its stop."""
    turns = record.period is not None
    clock = zo.Clock.at(ca.SX(record.frequency)) if turns else zo.Time()
    return under(record.at(clock), clock)


def under(force: ca.SX, clock: zo.Clock | zo.Time, name: str = "oscillator") -> zo.Problem:
    """Return an oscillator under a force over time, far from its stop."""
    turns = isinstance(clock, zo.Clock)

    def model(p: Any) -> zo.CompletedSystem:
        x, v = ca.SX.sym("x"), ca.SX.sym("v")
        one = zo.HybridLagrangian.from_energies(
            q=x,
            v=v,
            kinetic=v**2 / 2,
            potential=x**2 / 2,
            passive_force=-C * v,
            applied_force=force,
            clock=clock,
            gap=x + 100,
        )
        return zo.hybrid_system(one, zo.no_drive(one), p["restitution"], switches=())

    return zo.Problem(
        name=name,
        title="oscillator under a force",
        source="tests/support/tabled.py",
        state_names=("x", "v", *(("cosine", "sine") if turns else ("t",))),
        state_units=("m", "m/s", *(("1", "1") if turns else ("s",))),
        parameters=(zo.Quantity.restitution(0.5),),
        gains=(),
        model=model,
        starts=({"cosine": 1.0} if turns else {},),
        portraits=(("x", "v"),),
        amplitude_of="x",
    )


def followed(times: np.ndarray, inputs: np.ndarray, until: float) -> np.ndarray:
    """Return the state at a time from rest, by matrix exponentials."""
    x, v = 0.0, 0.0
    marks = np.array([0.0, *(one for one in times if 0.0 < one < until), until])
    values = np.interp(marks, times, inputs)
    for dt, u, after in zip(np.diff(marks), values[:-1], values[1:], strict=True):
        x, v = (expm(FLOW * dt) @ np.array([x, v, u, (after - u) / dt]))[:2]
    return np.array([x, v])


def moved(force: Any, marks: np.ndarray, until: float) -> np.ndarray:
    """Return the state at a time from rest, by the response to an impulse.

    Args:
        force: A force over time, a polynomial between marks.
        marks: Times around all of the force, ``(n,)``.
        until: The time. Later marks do not count.
    """
    marks = np.append(marks[(marks >= 0.0) & (marks < until)], min(until, float(marks[-1])))
    marks = np.append(0.0, marks) if marks[0] > 0.0 and force(0.0) != 0.0 else marks
    nodes, weights = np.polynomial.legendre.leggauss(8)
    halves = np.diff(marks)[:, None] / 2
    at = (marks[1:] + marks[:-1])[:, None] / 2 + halves * nodes
    shares = force(at) * weights * halves
    turn = math.sqrt(1.0 - C**2 / 4)
    t = until - at
    decay = np.exp(-C * t / 2)
    place = decay * np.sin(turn * t) / turn
    speed = decay * np.cos(turn * t) - C / 2 * place
    return np.array([np.sum(shares * place), np.sum(shares * speed)])
