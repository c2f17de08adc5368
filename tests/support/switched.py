"""Machines whose periods start just before a switch, with closed forms of their orbits."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca

import zeno_orbits as zo
from zeno_orbits.model import CompletedSystem, Problem

HALF = math.pi / 8
"""Half the angle between two spokes [rad]."""
LEFT = math.cos(2 * HALF)
"""Part of the rate that a strike of a spoke leaves."""
GRAVITY = 9.81


def rimless_wheel() -> Problem:
    """Return a wheel of eight spokes without a rim that rolls down a slope, without a stop."""

    def model(p: Mapping[str, Any]) -> CompletedSystem:
        angle, rate = ca.SX.sym("angle"), ca.SX.sym("rate")
        wheel = zo.HybridLagrangian.from_energies(
            q=angle, v=rate, kinetic=rate**2 / 2, potential=GRAVITY * ca.cos(angle)
        )
        strike = zo.Switch(
            name="strike",
            guard=p["slope"] + HALF - angle,
            armed=rate,
            q_after=angle - 2 * HALF,
            v_after=rate * LEFT,
        )
        return zo.hybrid_system(wheel, zo.no_drive(wheel), switches=(strike,))

    return Problem(
        name="rimless_wheel",
        title="wheel without a rim on a slope",
        source="closed form",
        state_names=("angle", "rate"),
        state_units=("rad", "rad/s"),
        parameters=(zo.Quantity.positive("slope", 0.08, "rad", "slope of the ground"),),
        gains=(),
        model=model,
        starts=({"rate": 1.0},),
        portraits=(("angle", "rate"),),
        amplitude_of="angle",
    )


def relay_loop() -> Problem:
    """Return a damped mass on a spring that a unit force pushes along, without a stop."""

    def model(p: Mapping[str, Any]) -> CompletedSystem:
        q, v = ca.SX.sym("place"), ca.SX.sym("speed")
        mass = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=q**2 / 2,
            passive_force=-p["c"] * v,
            applied_force=ca.if_else(v > 0, 1.0, -1.0),
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    return Problem(
        name="relay_loop",
        title="mass on a spring that is pushed along",
        source="closed form",
        state_names=("place", "speed"),
        state_units=("m", "m/s"),
        parameters=(zo.Quantity.positive("c", 0.5, "N s/m", "damping"),),
        gains=(),
        model=model,
        starts=({"place": 2.0, "speed": 0.5},),
        portraits=(("place", "speed"),),
        amplitude_of="place",
    )


PUSH = 1.2
"""Push over the weight."""


def _block(
    name: str,
    title: str,
    *,
    changed: zo.Quantity,
    start: Mapping[str, float],
    push: Callable[[zo.Clock, Any], ca.SX] | None = None,
    switch: Callable[[ca.SX, ca.SX, zo.Clock, Any], zo.Switch] | None = None,
) -> Problem:
    """Return a block above a table, with a clock, a push, and a switch of height and speed."""

    def model(p: Mapping[str, Any]) -> CompletedSystem:
        height, speed = ca.SX.sym("height"), ca.SX.sym("speed")
        clock = zo.Clock.at(p["omega"])
        block = zo.HybridLagrangian.from_energies(
            q=height,
            v=speed,
            kinetic=speed**2 / 2,
            potential=GRAVITY * height,
            applied_force=push(clock, p) if push else ca.SX(0),
            clock=clock,
            stops=(zo.Stop(name="table", gap=height, restitution=p["restitution"]),),
        )
        switches = (switch(height, speed, clock, p),) if switch else ()
        return zo.hybrid_system(block, zo.no_drive(block), switches=switches)

    return Problem(
        name=name,
        title=title,
        source="closed form",
        state_names=("height", "speed", "cosine", "sine"),
        state_units=("m", "m/s", "1", "1"),
        parameters=(
            zo.Quantity.positive("omega", 3.0, "rad/s", "clock"),
            changed,
            zo.Quantity.restitution(0.3),
        ),
        gains=(),
        model=model,
        starts=({"height": 0.01, **start},),
        portraits=(("height", "speed"),),
        amplitude_of="height",
    )


def pushed_block() -> Problem:
    """Return a block that a force of the clock pushes up from its table, and drops again.

    The push jumps on and off, so that the contact ends at the jump while the stop still presses.
    """

    def push(clock: zo.Clock, p: Any) -> ca.SX:
        return ca.SX(ca.if_else(clock.cosine > p["level"], PUSH * GRAVITY, 0.0))

    level = zo.Quantity.positive("level", 0.9, "1", "cosine above which the block is pushed")
    start = {"cosine": 0.0, "sine": 1.0}
    title = "block that is pushed up and dropped"
    return _block("pushed_block", title, changed=level, start=start, push=push)


def lifted_block() -> Problem:
    """Return a block that falls on its table, and that a switch of the clock lifts at once."""

    def lift(height: ca.SX, _: ca.SX, clock: zo.Clock, p: Any) -> zo.Switch:
        moved = height + p["lift"]
        return zo.Switch(name="lift", guard=clock.cosine, armed=clock.sine, q_after=moved)

    way = zo.Quantity(name="lift", unit="m", meaning="lift", default=0.5, lower=-1.0)
    title = "block that is lifted and falls"
    return _block("lifted_block", title, changed=way, start={"cosine": 1.0}, switch=lift)


def thrown_block() -> Problem:
    """Return a block that rests on its table, and that a switch of the clock throws up."""

    def throw(_: ca.SX, speed: ca.SX, clock: zo.Clock, p: Any) -> zo.Switch:
        faster = speed + p["throw"]
        return zo.Switch(name="throw", guard=clock.cosine, armed=clock.sine, v_after=faster)

    gain = zo.Quantity(name="throw", unit="m/s", meaning="speed", default=4.0, lower=-9.0)
    title = "block that is thrown up from its table"
    return _block("thrown_block", title, changed=gain, start={"cosine": 1.0}, switch=throw)


def two_blocks() -> Problem:
    """Return two blocks on one shaken table, of which both rest at the same time."""

    def model(p: Mapping[str, Any]) -> CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        clock = zo.Clock.at(p["omega"])
        shake = p["A"] * clock.cosine - GRAVITY
        blocks = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.dot(v, v) / 2,
            potential=ca.SX(0),
            applied_force=ca.vertcat(shake, shake),
            clock=clock,
            stops=(
                zo.Stop(name="left", gap=q[0], restitution=p["restitution"]),
                zo.Stop(name="right", gap=q[1], restitution=0.2),
            ),
        )
        return zo.hybrid_system(blocks, zo.no_drive(blocks))

    return Problem(
        name="two_blocks",
        title="two blocks on a shaken table",
        source="written here",
        state_names=("left", "right", "left_speed", "right_speed", "cosine", "sine"),
        state_units=("m", "m", "m/s", "m/s", "1", "1"),
        parameters=(
            zo.Quantity.positive("omega", 20.0, "rad/s", "shaking"),
            zo.Quantity.positive("A", 15.0, "m/s^2", "its acceleration"),
            zo.Quantity.restitution(0.3),
        ),
        gains=(),
        model=model,
        starts=({"left": 0.01, "right": 0.01, "cosine": 1.0},),
        portraits=(("left", "left_speed"),),
        amplitude_of="left",
    )


def returned_block(*, rests: bool) -> Problem:
    """Return a block that slides along a table and that a switch of the clock sends back.

    It flies over the table without gravity, or rests on it. A place that is far to the left pulls
    the resting block up.
    """

    def model(p: Mapping[str, Any]) -> CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        clock = zo.Clock.at(p["omega"])
        down = -(1.0 + q[0]) if rests else ca.SX(0)
        block = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.dot(v, v) / 2,
            potential=ca.SX(0),
            applied_force=ca.vertcat(0.001 * ca.fabs(q[0] + 0.5), down),
            clock=clock,
            stops=(zo.Stop(name="table", gap=q[1], restitution=0.3),),
        )
        height = q[1] if rests else 1 + 0.1 * q[1]
        back = zo.Switch(
            name="back",
            guard=clock.cosine,
            armed=clock.sine,
            q_after=ca.vertcat(0.1 * q[0], height),
            v_after=ca.vertcat(0.1 * v[0], v[1] if rests else 0.1 * v[1]),
        )
        return zo.hybrid_system(block, zo.no_drive(block), switches=(back,))

    return Problem(
        name="returned_block",
        title="block that is sent back",
        source="closed form",
        state_names=("place", "height", "place_speed", "height_speed", "cosine", "sine"),
        state_units=("m", "m", "m/s", "m/s", "1", "1"),
        parameters=(zo.Quantity.positive("omega", 3.0, "rad/s", "clock"),),
        gains=(),
        model=model,
        starts=({"height": 0.0 if rests else 1.0, "cosine": 1.0},),
        portraits=(("place", "place_speed"),),
        amplitude_of="place",
    )
