r"""The walker with knees on flat ground: a DC motor at the hip and one at the swing knee.

Mechanism, stop and heel strike are those of `kneed_walker` without slope. With the angle
``hip = q2 - q1`` between the thighs and the flexion ``knee = q2 - q3``, the voltages are

.. math:: V_{hip} = K_p\,(step - hip) - K_d\,\dot{hip}, \qquad
    V_{knee} = -K_{pk}\,(knee + flex \cdot hip) - K_{dk}\,\dot{knee}

So the knee is bent while the swing leg is behind, and pressed on its stop while it is ahead. The
inductance is neglected: its time is far below that of a step. The motor of the stance knee is off.
A negative derivative gain removes a part of the damping by the back-EMF.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    CompletedSystem,
    Drawing,
    MotorBank,
    Problem,
    Quantity,
    StateLimit,
    hybrid_system,
    load_problem,
    quasi_static_drive,
)

PASSIVE = load_problem("kneed_walker")
FLAT = {"slope": ca.SX(0)}


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: ``q = (q1, q2, q3)``, angles from the vertical."""
    passive = PASSIVE.model({**p, **FLAT})
    legs, graph = passive.mechanism, passive.graph
    # The columns are the coordinates that the motors turn: their speeds are selection' v.
    selection = ca.SX([[-1, 0], [1, 1], [0, -1]])
    hip, knee = ca.vertsplit(ca.mtimes(selection.T, legs.q))
    hip_rate, knee_rate = ca.vertsplit(ca.mtimes(selection.T, legs.v))
    one = ca.SX.eye(2)
    motors = MotorBank(
        selection=selection,
        resistance=p["R"] * one,
        inductance=ca.SX(2, 2),
        torque_constant=p["K"] * one,
        emf_constant=p["K"] * one,
        voltage=ca.vertcat(
            p["Kp"] * (p["step"] - hip) - p["Kd"] * hip_rate,
            -p["Kp_knee"] * (knee + p["flex"] * hip) - p["Kd_knee"] * knee_rate,
        ),
    )
    return hybrid_system(legs, quasi_static_drive(legs, motors), switches=graph.switches)


def drawing(x: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> Drawing:
    """Return both legs on the ground, with the stance foot at the origin [m]."""
    assert PASSIVE.drawing is not None
    return PASSIVE.drawing(x, {**p, **FLAT})


def gain(
    name: str, default: float, lower: float, upper: float, unit: str, meaning: str
) -> Quantity:
    """Return a gain with its range."""
    return Quantity(
        name=name, unit=unit, meaning=meaning, default=default, lower=lower, upper=upper
    )


PROBLEM = Problem(
    name="powered_walker",
    title="walker with bouncing knees on flat ground, DC motors at hip and swing knee",
    source="kneed_walker with two motors; motors and gains declared here",
    state_names=PASSIVE.state_names,
    state_units=PASSIVE.state_units,
    parameters=(
        *(one for one in PASSIVE.parameters if one.name not in FLAT),
        Quantity.positive("R", 2.0, "ohm", "resistance of a motor"),
        Quantity.positive("K", 1.0, "N m/A", "torque and back-EMF constant of a geared motor"),
    ),
    gains=(
        gain("Kp", 5.0, 3.0, 10.0, "V/rad", "proportional gain of the hip"),
        gain("Kd", -0.2, -0.6, 0.5, "V s/rad", "derivative gain of the hip"),
        gain("step", 0.42, 0.3, 0.6, "rad", "set-point of the angle between the thighs"),
        gain("Kp_knee", 1.5, 1.0, 4.0, "V/rad", "proportional gain of the knee"),
        gain("Kd_knee", -0.8, -0.9, 0.0, "V s/rad", "derivative gain of the knee"),
        gain("flex", 1.6, 1.0, 3.0, "1", "set-point of the flexion over minus the hip's angle"),
    ),
    model=model,
    starts=({"q1": 0.2, "q2": -0.2, "q3": -0.2, "dq1": -0.9, "dq2": 0.1, "dq3": 0.1},),
    portraits=PASSIVE.portraits,
    amplitude_of="q2",
    escapes={"q1": StateLimit(beyond=1.2, phrase="it falls")},
    drawing=drawing,
)
