"""How often the 95 % intervals of `identify` hold the truth, on recordings whose truth is known.

    python benchmarks/identification.py [--seeds 20] [--noise 0.01] [--correlated]

Every seed has its own truth, some per cent from the scene's numbers, its own unknown start and its
own noise on angles and current; the fit begins at the scene's numbers. With ``--correlated`` the
noise is that of a filtered sensor, which a fit that counts samples as independent gets wrong.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.closing import close_orbit
from zeno_orbits.cycle_tables import table_of
from zeno_orbits.identification import Sought, identify
from zeno_orbits.problem import load_problem
from zeno_orbits.recordings import Recording, Signal, Source

SCENE = "motor_pendulum"
SIGNALS = ("theta1", "theta2", "current")
SOUGHT = (
    Sought(names=("R",), lower=2.0, upper=4.0),
    Sought(names=("K_torque", "K_emf"), lower=0.02, upper=0.05),
    Sought(names=("restitution",), lower=0.0, upper=0.4),
)
SPREAD = (0.03, 0.02, 0.05)
"""How far the truth is from the scene's numbers: relative standard deviations."""
CYCLES = 12
RATE = 250.0
MEMORY = 8
"""Samples over which a filtered sensor forgets."""


def noise_of(
    rng: np.random.Generator, shape: tuple[int, int], *, correlated: bool
) -> NDArray[np.float64]:
    """Return noise of standard deviation one along the first axis."""
    white = rng.normal(size=shape)
    if not correlated:
        return white
    keep = np.exp(-1.0 / MEMORY)
    found = np.empty(shape)
    found[0] = white[0]
    for k in range(1, shape[0]):
        found[k] = keep * found[k - 1] + np.sqrt(1 - keep**2) * white[k]
    return found


def recorded(
    seed: int, noise: float, *, correlated: bool
) -> tuple[Recording, dict[str, float]] | None:
    """Return a recording and its truth, or nothing if there is no orbit at that truth."""
    rng = np.random.default_rng(seed)
    problem = load_problem(SCENE)
    truth = dict(problem.setting().parameters)
    for one, spread in zip(SOUGHT, SPREAD, strict=True):
        factor = 1.0 + spread * rng.normal()
        truth |= {name: truth[name] * factor for name in one.names}
    orbit = close_orbit(problem, problem.setting(parameters=truth)).orbit
    if orbit is None:
        return None
    table = table_of(orbit, problem, SIGNALS)
    times = np.arange(int(CYCLES * orbit.period * RATE)) / RATE
    values = table.at(times / orbit.period + rng.random())
    values += noise * np.ptp(values, axis=0) * noise_of(rng, values.shape, correlated=correlated)
    units = dict(zip(problem.state_names, problem.state_units, strict=True))
    signals = tuple(
        Signal(name=name, unit=units[name], values=values[:, k].copy())
        for k, name in enumerate(SIGNALS)
    )
    recording = Recording(source=Source.SIMULATED, scene=SCENE, time=times, signals=signals)
    return recording, truth


def main() -> None:
    """Run the benchmark and print one row a seed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--noise", type=float, default=0.01)
    parser.add_argument("--correlated", action="store_true")
    options = parser.parse_args()
    problem = load_problem(SCENE)
    labels = [one.label for one in SOUGHT]
    inside, whole, tried = dict.fromkeys(labels, 0), 0, 0
    scores: list[float] = []
    times: list[float] = []
    print("seed  " + "".join(f"{label:>22}" for label in labels) + "   (error in standard errors)")
    for seed in range(options.seeds):
        made = recorded(seed, options.noise, correlated=options.correlated)
        if made is None:
            print(f"{seed:4d}  no orbit at this truth")
            continue
        recording, truth = made
        began = time.process_time()
        found = identify(problem, problem.setting(), recording, SOUGHT)
        times.append(time.process_time() - began)
        tried += 1
        row, all_in = "", True
        for one in found.fitted:
            true = truth[one.sought.names[0]]
            here = one.low <= true <= one.high
            inside[one.sought.label] += here
            all_in &= here
            scores.append((one.value - true) / one.error)
            row += f"{one.value / true - 1:+14.2e} ({scores[-1]:+.1f})"
        whole += all_in
        print(f"{seed:4d}  {row}{'' if all_in else '   outside'}")
    print(f"\ntruth inside the 95 % interval, of {tried}: {inside}; all three at once: {whole}")
    print(f"root mean square error: {np.sqrt(np.mean(np.square(scores))):.2f} standard errors")
    print(f"median processor time: {statistics.median(times):.1f} s")


if __name__ == "__main__":
    main()
