"""Random machines whose masses rest on some stops while others are struck."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

import zeno_orbits as zo


def shaken(seed: int) -> zo.Problem:
    """Return two or three coupled masses over a shaken floor each, with springs and a lever.

    Closed stops are pressed, pulled and opened by impacts on the others. Some machines have a
    switch that throws all masses up, and a force with a kink.

    Args:
        seed: Seed of the random numbers.
    """
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 4))
    factor = np.eye(n) + rng.uniform(-0.4, 0.4, (n, n))
    masses = factor @ factor.T
    springs = rng.uniform(0.0, 3.0) * np.eye(n) + rng.uniform(0.0, 1.5)
    drive = rng.uniform(0.5, 2.5, n)
    phases = rng.uniform(0.0, 2 * np.pi, n)
    e = rng.uniform(0.0, 0.7, n + 1)
    height = rng.uniform(0.0, 0.3, n) * (rng.uniform(size=n) < 0.6)
    has_lever, has_throw, has_kink = rng.uniform(size=3) < 0.5
    throw = rng.uniform(0.3, 1.5)

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
        clock = zo.Clock.at(p["omega"])
        shake = [
            a * (np.cos(phase) * clock.cosine + np.sin(phase) * clock.sine)
            for a, phase in zip(drive, phases, strict=True)
        ]
        force = ca.vertcat(*shake) - 0.1 * v
        if has_kink:
            force -= ca.vertcat(ca.if_else(q[0] > 0.1, 0.7, 0.0), *(0.0,) * (n - 1))
        stops = [zo.Stop(name=f"floor {k}", gap=q[k], restitution=float(e[k])) for k in range(n)]
        if has_lever:
            stops.append(zo.Stop(name="lever", gap=0.8 - ca.sum1(q) / n, restitution=float(e[n])))
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.bilin(ca.DM(masses), v, v) / 2,
            potential=ca.sum1(q) + ca.bilin(ca.DM(springs), q, q) / 2,
            applied_force=force,
            clock=clock,
            stops=tuple(stops),
        )
        switches = ()
        if has_throw:
            switches = (
                zo.Switch(name="throw", guard=clock.cosine, armed=-v[0] + 0.1, v_after=v + throw),
            )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism), switches=switches)

    places, rates = [f"q{k}" for k in range(n)], [f"v{k}" for k in range(n)]
    return zo.Problem(
        name="shaken",
        title="masses over a shaken floor each",
        source="tests/loop/shaken.py",
        state_names=(*places, *rates, "cosine", "sine"),
        state_units=(*("m",) * n, *("m/s",) * n, "1", "1"),
        parameters=(zo.Quantity(name="omega", unit="rad/s", meaning="frequency", default=3.0),),
        gains=(),
        model=model,
        starts=({"cosine": 1.0, **dict(zip(places, height.tolist(), strict=True))},),
        portraits=((places[0], rates[0]),),
        amplitude_of=places[0],
    )
