"""A flap that a DC motor lifts off its stop, as a user writes it from the template."""

import casadi as ca

from zeno_orbits import HybridLagrangian, MotorBank, Problem, Quantity, full_drive, hybrid_system


def model(p):  # p: name to symbol, of every gain and parameter below
    q, v = ca.SX.sym("q"), ca.SX.sym("v")  # SX.sym("q", 2) for two coordinates: q[0], q[1]
    mechanism = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=p["J"] * v**2 / 2,
        potential=p["preload"] * q,
        gap=q,  # of q alone, >= 0; a coordinate that is 0 at the stop keeps most digits
        passive_force=-p["c"] * v,  # friction: one entry a coordinate
    )
    motor = MotorBank(  # for two motors: matrices, one column of `selection` a motor
        selection=ca.SX(1),  # which coordinates it turns, and by what gear ratio
        resistance=p["R"],
        inductance=p["L"],
        torque_constant=p["K_torque"],
        emf_constant=p["K_torque"],
        voltage=p["V0"] - p["Kp"] * q,  # the feedback law, of q, v, gains and parameters
    )
    return hybrid_system(mechanism, full_drive(mechanism, motor), p["restitution"])


PROBLEM = Problem(
    name="motor_flap",
    title="a flap that a DC motor lifts off its stop",
    source="these tests",
    state_names=("angle", "rate", "current"),  # coordinates, velocities, currents, clock
    state_units=("rad", "rad/s", "A"),
    parameters=(  # physical constants; `--set J=1e-3` changes one
        Quantity.positive("J", 2e-4, "kg m^2", "inertia"),
        Quantity.positive("preload", 0.05, "N m", "torque that closes the flap"),
        Quantity(name="c", unit="N m s/rad", meaning="friction", default=2e-4, lower=0.0),
        Quantity.positive("R", 0.5, "ohm", "resistance of the motor circuit"),
        Quantity.positive("L", 0.1, "H", "inductance of the motor circuit"),
        Quantity.positive(
            "K_torque", 0.05, "N m/A", "torque constant, equal to the back-EMF constant"
        ),
        Quantity.positive("V0", 2.0, "V", "voltage on the stop"),
        Quantity.restitution(0.3),  # of the stop, in [0, 1]
    ),
    gains=(  # of the feedback law; their ranges are what `search` looks through
        Quantity(name="Kp", unit="V/rad", meaning="feedback", default=10.0, lower=6.0, upper=20.0),
    ),
    model=model,
    starts=({"angle": 0.0},),  # where a simulation starts; a state that is not named is 0
    portraits=(("angle", "rate"), ("angle", "current")),  # what `plot` draws against what
    amplitude_of="angle",  # what `--objective amplitude=` means
)
