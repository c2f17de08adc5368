"""Siconos: Moreau-Jean time stepping, theta = 1/2, with the mechanism as a compiled plugin.

The charge that has passed the motor is a third coordinate, with the inductance for its mass, so the
machine is one Lagrangian system. Debian has Siconos as `python3-siconos`, which runs under Debian's
own Python. What is asked of it is a step size [s], not a tolerance.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import work
from work import HORIZON, Method, Motion

PLUGIN = r"""
#include <math.h>
/* z: A B C D E g K R L Kp Kd; matrices by columns */
void mass(unsigned n, double *q, double *m, unsigned nz, double *z)
{
  double c = z[2] * cos(q[1]);
  for (int k = 0; k < 9; ++k) m[k] = 0;
  m[0] = z[0] + z[1] + 2 * c; m[1] = m[3] = z[1] + c; m[4] = z[1]; m[8] = z[8];
}
void internal(double t, unsigned n, double *q, double *v, double *f, unsigned nz, double *z)
{
  double s = z[2] * sin(q[1]), pull = z[5] * z[4] * sin(q[0] + q[1]);
  f[0] = z[5] * z[3] * sin(q[0]) + pull - z[6] * v[2] - s * (2 * v[0] + v[1]) * v[1];
  f[1] = s * v[0] * v[0] + pull;
  f[2] = z[9] * q[0] + (z[10] + z[6]) * v[0] + z[7] * v[2];
}
void by_q(double t, unsigned n, double *q, double *v, double *J, unsigned nz, double *z)
{
  double c = z[2] * cos(q[1]), pull = z[5] * z[4] * cos(q[0] + q[1]);
  for (int k = 0; k < 9; ++k) J[k] = 0;
  J[0] = z[5] * z[3] * cos(q[0]) + pull; J[1] = pull; J[2] = z[9];
  J[3] = pull - c * (2 * v[0] + v[1]) * v[1]; J[4] = c * v[0] * v[0] + pull;
}
void by_v(double t, unsigned n, double *q, double *v, double *J, unsigned nz, double *z)
{
  double s = z[2] * sin(q[1]);
  for (int k = 0; k < 9; ++k) J[k] = 0;
  J[0] = -2 * s * v[1]; J[1] = 2 * s * v[0]; J[2] = z[10] + z[6];
  J[3] = -2 * s * (v[0] + v[1]); J[6] = -z[6]; J[8] = z[7];
}
"""
"""Mass matrix and internal forces with their derivatives, in C as Siconos wants them."""


def version() -> str:
    """Return which Siconos it is."""
    try:
        import siconos.kernel  # noqa: F401
    except ImportError:
        raise work.NotInstalledError("Siconos is not installed (Debian: python3-siconos)") from None
    return "Siconos"


def compiled(folder: Path) -> None:
    """Compile the plugin into a folder and load it, so that Siconos finds it by its name."""
    source, library = folder / "pendulumPlugin.c", folder / "pendulumPlugin.so"
    source.write_text(PLUGIN)
    command = ["cc", "-O2", "-shared", "-fPIC", "-Wl,-soname,pendulumPlugin.so"]
    subprocess.run([*command, source, "-o", library, "-lm"], check=True)
    ctypes.CDLL(str(library))


def prepare(
    rate: float, step: float, start: Sequence[float], _locked: bool
) -> Callable[[], Motion]:
    """Return the whole motion as a function without arguments."""
    import numpy as np
    import siconos.kernel as sk

    p = work.pendulum(rate)
    letters = [p.A, p.B, p.C, p.D, p.E, p.g, p.torque_constant, p.resistance, p.inductance]
    numbers = np.array([*letters, p.proportional, p.derivative])

    def follow() -> Motion:
        machine = sk.LagrangianDS(np.array([start[0], start[1], 0.0]), np.array(start[2:]))
        machine.setzPtr(numbers)
        machine.setComputeMassFunction("pendulumPlugin", "mass")
        machine.setComputeFIntFunction("pendulumPlugin", "internal")
        machine.setComputeJacobianFIntqFunction("pendulumPlugin", "by_q")
        machine.setComputeJacobianFIntqDotFunction("pendulumPlugin", "by_v")
        law = sk.NewtonImpactNSL(p.restitution)
        stop = sk.Interaction(law, sk.LagrangianLinearTIR(np.array([[0.0, 1.0, 0.0]])))
        system = sk.NonSmoothDynamicalSystem(0.0, HORIZON)
        system.insertDynamicalSystem(machine)
        system.link(stop, machine)
        clock = sk.TimeDiscretisation(0.0, step)
        stepping = sk.TimeStepping(system, clock, sk.MoreauJeanOSI(0.5), sk.LCP())
        stepping.setNewtonTolerance(1e-9)
        stepping.setNewtonMaxIteration(20)
        for _ in range(round(HORIZON / step)):
            stepping.computeOneStep()
            stepping.nextStep()
        q, v = machine.q(), machine.velocity()
        return Motion(state=[q[0], q[1], v[0], v[1], v[2]])

    return follow


METHODS = [
    Method(
        name="Siconos, steps of",
        accuracies=(1e-3, 1e-4, 2e-5),
        sweep_accuracies=(1e-4,),
        prepare=prepare,
    )
]

if __name__ == "__main__":
    # Siconos writes to stdout's descriptor, which is for the result.
    result = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    sys.stdout = result
    with tempfile.TemporaryDirectory() as folder:
        compiled(Path(folder))
        sys.exit(work.serve(__doc__, METHODS, version))
