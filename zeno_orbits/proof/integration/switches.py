"""Switches of a set: the reset, the sides of the kinks, and the mode that follows.

A reset may exchange coordinates and change velocities. Gaps and gap rates are then set anew by
their formulas, ``h(R(x))`` and ``dh/dt(R(x))``. If both are zero at a closed stop, the contact
lasts for a negative gap acceleration of the free flow, and opens at once for a positive one. A
stop that is left with a positive gap rate is left as after an impact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from zeno_orbits.errors import ProofError
from zeno_orbits.proof.arithmetic.balls import ZERO, Ball, product
from zeno_orbits.proof.integration.ball_system import require_proved
from zeno_orbits.proof.integration.events import is_clear
from zeno_orbits.proof.integration.machine import BallMachine
from zeno_orbits.proof.integration.sets import Departure, ProofRecord, ProofStage

_MODES = {
    Departure.LOCKED: "locked",
    Departure.OPENED: "opened",
    Departure.FLYING: "free",
    Departure.STRUCK: "thrown",
}
"""Mode after a switch, in the words of the certificate."""


def require_before(machine: BallMachine, stage: ProofStage, switch: int) -> None:
    """Raise an error unless all states of a set are just before a switch, as its section says.

    The guard of the switch falls, and it is armed. All gaps are positive, except that of a closed
    stop, which is under pressure. No other guard is zero, and the kinks are on their sides.

    Args:
        machine: The problem.
        stage: The set on the section.
        switch: Index of the switch.

    Raises:
        ProofError: If this is not proved.
    """
    system, box = machine.view(*stage.view), stage.at.box
    locked, declared = stage.departure is Departure.LOCKED, machine.n_declared
    flow, guards = system.locked if locked else system.free, system.guards(box)
    gradient, speeds = guards[switch][1], flow.rate(box)
    slope = sum((g * f for g, f in zip(gradient, speeds, strict=True)), ZERO)
    met = is_clear(-slope) and (switch >= declared or is_clear(system.armed(box)[switch]))
    require_proved(met, "section", "the switch of the section is not proved to be met from the box")
    for k, view in enumerate(machine.views(stage.sides)):
        apart = k in stage.closed or is_clear(box[view.gap])
        require_proved(apart, "section", "a gap is not proved positive just before the switch")
    forces = (machine.view(*stage.seen(k)).locked.guard(box)[0] for k in stage.closed)
    pressed = all(is_clear(force) for force in forces)
    require_proved(pressed, "section", "a stop is not proved to press just before the switch")
    for k, (value, _) in enumerate(guards):
        sound = k == switch or is_clear(value) or (k < declared and is_clear(-value))
        reason = f"`{machine.switch_names[k]}` is not proved to differ from zero just before it"
        require_proved(sound, "section", reason)


def pass_switch(
    machine: BallMachine, stage: ProofStage, switch: int
) -> tuple[ProofRecord, ProofStage]:
    """Apply a switch and return its record and the set after it.

    Args:
        machine: The problem.
        stage: The set just before the switch.
        switch: Index of the switch.

    Raises:
        ProofError: If the mode after the switch is not proved.
    """
    system, at = machine.view(*stage.view), stage.at
    image, derivative = system.switched(switch, at.m)[0], system.switched(switch, at.box)[1]
    moved = product(derivative, at.deviation)
    box = [a + b for a, b in zip(image, moved, strict=True)]
    kink = switch - machine.n_declared
    sides = machine.sides_at(stage.stop, stage.sides, box, kink if kink >= 0 else None)
    after = machine.view(stage.stop, sides, stage.held)
    departure = _departure(machine, stage, sides, box)
    # A guard that is not zero after the switch is an ordinary guard again.
    kept = kink >= 0 or not bool(after.guards(box)[switch][0] != 0)
    rate = box[system.rate] if departure is Departure.STRUCK else None
    on_stop = departure is not Departure.FLYING
    rows = system.turning_rows(rate) if on_stop else system.moving_rows
    result = at.mapped(image, derivative, rows, stage.metric)
    fields = {
        "sides": [int(side) for side in sides],
        "mode": _MODES[departure],
        "kept": int(kept),
    }
    record = ProofRecord(kind="switch", numbers={}, orders=(), result=result, fields=fields)
    following = stage.next(result, departure, stage.time)
    return record, replace(following, sides=sides, switched=switch if kept else None)


def _departure(
    machine: BallMachine, stage: ProofStage, sides: tuple[bool, ...], box: Sequence[Ball]
) -> Departure:
    """Return the mode after a switch, and the position relative to the stop."""
    system = machine.view(stage.stop, sides, stage.held)
    held = stage.departure is Departure.LOCKED and box[system.gap].is_zero()
    for k, view in enumerate(machine.views(sides)):
        kept = k == stage.held and box[view.gap].is_zero() and box[view.rate].is_zero()
        apart = kept or (held and view.gap == system.gap) or bool(box[view.gap] > 0)
        require_proved(apart, "switch", "a gap is not proved positive just after a switch")
    if not held:
        return Departure.FLYING
    rate = box[system.rate]
    if not rate.is_zero():
        require_proved(is_clear(rate), "switch", "a closed stop is struck just after a switch")
        return Departure.STRUCK
    force = system.locked.guard(box)[0]
    if is_clear(force):
        return Departure.LOCKED
    if is_clear(-force):
        return Departure.OPENED
    raise ProofError("switch", "the contact force may be zero just after a switch")
