"""How many of random pendulums' orbits can be proved, and why the others cannot.

    python benchmarks/proofs.py --orbits 40

The pendulums are those of `search_success.py` with restitutions up to a half, of which a long
simulation says that they settle to a periodic orbit. Each orbit is closed by simulation and
handed to the prover; what fails is printed with its reason. Exit 1 if fewer than 90 % are proved,
if a proof takes more than 180 s of processor time, if the median is above 60 s, or if a refusal
takes more than 60 s.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Iterator

from search_success import has_orbit, random_problems

import zeno_orbits as zo

MOST = 0.5
"""Largest restitution."""
GOAL = 0.9
LONGEST, MEDIAN, LONGEST_REFUSAL = 180.0, 60.0, 60.0
"""Processor times of a proof, of the median proof and of a refusal [s]."""


def random_orbits(seed: int) -> Iterator[zo.ParameterValues]:
    """Yield numbers of pendulums that settle to a periodic orbit, without end."""
    for given in random_problems(seed):
        values = zo.ParameterValues(gains=given["gains"], parameters=given["parameters"])
        if values.parameters["restitution"] <= MOST and has_orbit(values):
            yield values


def main() -> int:
    """Print a line an orbit, and how many are proved; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--orbits", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    pendulum, proved = zo.load_problem("motor_pendulum"), 0
    times: dict[bool, list[float]] = {True: [], False: []}
    print("| Kp | Kd | e | R / L [1/s] | spectral radius | period [s] | proved | time [s] |")
    print("|---|---|---|---|---|---|---|---|")
    for _, values in zip(range(options.orbits), random_orbits(options.seed), strict=False):
        numbers = {**values.gains, **values.parameters}
        orbit = zo.find_orbit_by_shooting(
            pendulum, gains=dict(values.gains), parameters=dict(values.parameters)
        ).unwrap()
        radius = zo.verify(orbit, problem=pendulum).spectral_radius
        started = time.process_time()
        proof = zo.prove(orbit)
        seconds = time.process_time() - started
        proved += proof.proved
        times[proof.proved].append(seconds)
        cells = (
            *(f"{numbers[name]:.3f}" for name in ("Kp", "Kd", "restitution")),
            f"{numbers['R'] / numbers['L']:.0f}",
            f"{radius:.3g}",
            f"{orbit.period:.6f}",
            "yes" if proof.proved else "no",
            f"{seconds:.0f}",
        )
        print("|", " | ".join(cells), "|", flush=True)
        if not proof.proved:
            print(f"  {proof.verdict()}", flush=True)
    median, longest = statistics.median(times[True] or [0.0]), max(times[True], default=0.0)
    refused = max(times[False], default=0.0)
    print(f"\n{proved} of {options.orbits} proved, {median:.0f} s in the median")
    print(f"The longest proof took {longest:.0f} s, the longest refusal {refused:.0f} s")
    late = longest > LONGEST or median > MEDIAN or refused > LONGEST_REFUSAL
    return int(late or proved < GOAL * options.orbits)


if __name__ == "__main__":
    sys.exit(main())
