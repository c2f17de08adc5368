"""Random machines with dry friction, a stop and a motor: are their events right?

    python benchmarks/friction_machines.py --machines 200 --seed 0

A machine is linear between its events. It has one or two parts that stick or slip, on surfaces that
may move, one stop and one motor. The reference is the event loop of
`tests/reference/friction_loop.py`: matrix exponentials, and at every event all combinations of
contact and friction. Kind, order and time of every event are compared, except for impacts. The
compiled loop and the loop in Python must agree in all digits.

A part that sticks and that impacts move has stick phases that accumulate with the impacts. Such a
motion is refused by name, and counted if the reference has these phases at the same time.

Exit 1 if an execution differs or ends in another error.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import zeno_orbits as zo
from tests.reference.friction_loop import LinearMachine
from tests.support.linear_friction import PLASTIC, events_of, events_of_reference, task_of
from zeno_orbits.simulation import by_reference
from zeno_orbits.simulation.compiled.executions import by_loop

REFUSED = "stick phases accumulate with impacts, which is refused"
SOON, LEAST = 0.01, 3
"""Time around a refusal in which the reference must have several stick phases [s]."""


def main() -> int:
    """Print how many machines agree, and each that does not."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--machines", type=int, default=200, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the first one")
    parser.add_argument("--until", type=float, default=8.0, metavar="S", help="seconds of motion")
    options = parser.parse_args()
    kinds, events, begun = Counter[str](), Counter[str](), time.process_time()
    for seed in range(options.seed, options.seed + options.machines):
        verdict, names = judged(seed, options.until)
        kinds[verdict or "agrees"] += 1
        events.update(names)
        if verdict:
            print(f"machine {seed}: {verdict}", flush=True)
    agreeing = kinds["agrees"]
    print(f"{agreeing} of {options.machines} machines agree in {sum(events.values())} events:")
    print(f"{kinds[REFUSED]} refused: {REFUSED}")
    print(", ".join(f"{n} {name}" for name, n in sorted(events.items())))
    print(f"{time.process_time() - begun:.0f} s of processor time")
    return 0 if agreeing + kinds[REFUSED] == options.machines else 1


def judged(seed: int, until: float) -> tuple[str, list[str]]:
    """Return how a machine differs, or no text, and the kinds of the events that were compared."""
    machine = LinearMachine.random(seed)
    task = task_of(machine, seed, until)
    try:
        found, slow = by_loop(task), by_reference(task)
    except zo.ChatterError as error:
        at_once = events_of_reference(machine, seed, error.time + SOON)
        sticks = [one for one, name in at_once if "stick" in name and one > error.time - SOON]
        is_known = len(sticks) >= LEAST and "accumulate" in error.reason
        return REFUSED if is_known else f"{type(error).__name__}: {error}", []
    except zo.SimulationError as error:
        return f"{type(error).__name__}: {error}", []
    if found is None or not np.array_equal(found.end_state, slow.end_state):
        return "the two loops differ", []
    wanted = events_of_reference(machine, seed, until)
    return compared(events_of(found), wanted), [name.split(" ")[0] for _, name in wanted]


def compared(found: list[tuple[float, str]], wanted: list[tuple[float, str]]) -> str:
    """Return the first difference of two lists of events, or no text."""
    for (time_found, name), (time_wanted, other) in zip(found, wanted, strict=False):
        if name != other:
            return f"{name} at {time_found:.9g}, the reference has {other} at {time_wanted:.9g}"
        if abs(time_found - time_wanted) > PLASTIC:
            return f"{name} at {time_found:.9g} instead of {time_wanted:.9g}"
    if len(found) != len(wanted):
        return f"{len(found)} events instead of {len(wanted)}"
    return ""


if __name__ == "__main__":
    raise SystemExit(main())
