"""The command `new`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from zeno_orbits.cli.options import YES, add_command, print_json, say_written
from zeno_orbits.errors import InputError
from zeno_orbits.work.files import write_whole

_FORCED = '''\
"""NAME: a mass on a spring, shaken against a stop. Change it line by line into your own problem."""

import casadi as ca

from zeno_orbits.model.drives import no_drive
from zeno_orbits.model.clock import Clock
from zeno_orbits.model.hybrid import complete
from zeno_orbits.model.lagrangian import HybridLagrangian
from zeno_orbits.model.problem import Problem, Quantity, positive, restitution


def model(p):  # p: name to symbol, of every gain and parameter below
    q, v = ca.SX.sym("q"), ca.SX.sym("v")  # SX.sym("q", 2) for two coordinates: q[0], q[1]
    clock = Clock.at(p["omega"])  # cosine and sine of the time; leave it out if nothing shakes
    mechanism = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=p["m"] * v**2 / 2,
        potential=p["k"] * (q + p["pressed"]) ** 2 / 2,
        gap=q,  # of q alone, >= 0; a coordinate that is 0 at the stop keeps most digits
        passive_force=-p["c"] * v,  # friction: one entry a coordinate
        applied_force=p["F"] * clock.cosine,  # from outside: of the clock, q and v
        clock=clock,
    )
    return complete(mechanism, no_drive(mechanism), p["restitution"])


PROBLEM = Problem(
    name="NAME",
    title="a mass on a spring, shaken against a stop",
    source="where the problem and its numbers come from",
    state_names=("x", "dx", "cosine", "sine"),  # coordinates, velocities, currents, clock
    state_units=("m", "m/s", "1", "1"),
    parameters=(  # physical constants; `--set m=2` changes one
        positive("m", 1.0, "kg", "mass"),
        positive("k", 1.0, "N/m", "stiffness of the spring"),
        Quantity(name="pressed", unit="m", meaning="how far the stop presses it", default=0.8),
        Quantity(name="c", unit="N s/m", meaning="friction", default=1.0, lower=0.0),
        positive("F", 1.0, "N", "amplitude of the force"),
        positive("omega", 1.0, "rad/s", "frequency of the force"),
        restitution(0.5),  # of the stop, in [0, 1)
    ),
    gains=(),  # of a feedback law; their ranges are what `search` looks through
    model=model,
    starts=({"cosine": 1.0},),  # where a simulation starts; a state that is not named is 0
    portraits=(("x", "dx"),),  # what `plot` draws against what
    amplitude_of="x",  # what `--objective amplitude=` means
)
'''

_MOTOR = '''\
"""NAME: a flap that a DC motor lifts off its stop. Change it line by line into your own problem."""

import casadi as ca

from zeno_orbits.model.drives import MotorBank, full_drive
from zeno_orbits.model.hybrid import complete
from zeno_orbits.model.lagrangian import HybridLagrangian
from zeno_orbits.model.problem import Problem, Quantity, positive, restitution


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
    return complete(mechanism, full_drive(mechanism, motor), p["restitution"])


PROBLEM = Problem(
    name="NAME",
    title="a flap that a DC motor lifts off its stop",
    source="where the problem and its numbers come from",
    state_names=("angle", "rate", "current"),  # coordinates, velocities, currents, clock
    state_units=("rad", "rad/s", "A"),
    parameters=(  # physical constants; `--set J=1e-3` changes one
        positive("J", 2e-4, "kg m^2", "inertia"),
        positive("preload", 0.05, "N m", "torque that closes the flap"),
        Quantity(name="c", unit="N m s/rad", meaning="friction", default=2e-4, lower=0.0),
        positive("R", 0.5, "ohm", "resistance of the motor circuit"),
        positive("L", 0.1, "H", "inductance of the motor circuit"),
        positive("K_torque", 0.05, "N m/A", "torque constant, equal to the back-EMF constant"),
        positive("V0", 2.0, "V", "voltage on the stop"),
        restitution(0.3),  # of the stop, in [0, 1)
    ),
    gains=(  # of the feedback law; their ranges are what `search` looks through
        Quantity(
            name="Kp", unit="V/rad", meaning="feedback", default=10.0, lower=6.0, upper=20.0
        ),
    ),
    model=model,
    starts=({"angle": 0.0},),  # where a simulation starts; a state that is not named is 0
    portraits=(("angle", "rate"), ("angle", "current")),  # what `plot` draws against what
    amplitude_of="angle",  # what `--objective amplitude=` means
)
'''


def add_new(commands: Any) -> None:
    """Add the command `new`."""
    parser = add_command(
        commands,
        "new",
        _run_new,
        "write a problem that works, to change into your own",
        [
            "zeno-orbits new my_problem",
            "zeno-orbits new my_problem --with-motor",
            "zeno-orbits search ./my_problem.py",
        ],
    )
    parser.add_argument("name", metavar="NAME", help="of the problem; the file is NAME.py")
    parser.add_argument(
        "--with-motor",
        action="store_true",
        help="a DC motor under feedback drives it; else a periodic force does",
    )


def _run_new(options: argparse.Namespace) -> int:
    from zeno_orbits.model.library import bundled_problems

    if not options.name.isidentifier():
        wanted = "must be a word of letters, digits and underscores"
        raise InputError(f"Argument `name` {wanted}, but it is `{options.name}`.")
    if options.name in bundled_problems():
        wanted = "must not be that of a problem which comes with the package"
        raise InputError(f"Argument `name` {wanted}, but `{options.name}` is one.")
    path = Path(f"{options.name}.py")
    if path.exists():
        raise InputError(f"Argument `name` must be of a new file, but `{path}` exists.")
    template = _MOTOR if options.with_motor else _FORCED
    write_whole(path, template.replace("NAME", options.name))
    if options.json:
        print_json({"problem": str(path)})
    else:
        say_written(options, [path])
    return YES
