"""Random machines with dry friction, a stop and a motor: are their events right?

    python benchmarks/friction_machines.py --machines 200 --seed 0

A machine is linear between its events. It has one or two parts that stick or slip, on surfaces that
may move, one stop and one motor. The reference is the event loop of
`tests/reference/friction_loop.py`: matrix exponentials, and at every event all combinations of
contact and friction. Kind, order and time of every event are compared, except for impacts. The
compiled loop and the loop in Python must agree in all digits.

A part that sticks and that impacts move has stick phases that accumulate with the impacts. They are
compared up to the last impact that the compiled loop resolves, and counted.

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
from tests.support.linear_friction import PLASTIC, before_limits, events_of_reference, task_of
from zeno_orbits.simulation import by_reference
from zeno_orbits.simulation.compiled.executions import by_loop


def main() -> int:
    """Print how many machines agree, and each that does not."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--machines", type=int, default=200, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the first one")
    parser.add_argument("--until", type=float, default=8.0, metavar="S", help="seconds of motion")
    options = parser.parse_args()
    agreeing, limits, events, begun = 0, 0, Counter[str](), time.process_time()
    for seed in range(options.seed, options.seed + options.machines):
        verdict, names, n_limits = judged(seed, options.until)
        agreeing += not verdict
        limits += n_limits
        events.update(names)
        if verdict:
            print(f"machine {seed}: {verdict}", flush=True)
    print(f"{agreeing} of {options.machines} machines agree in {sum(events.values())} events,")
    print(f"at {limits} Zeno points impacts and events of a part accumulate:")
    print(", ".join(f"{n} {name}" for name, n in sorted(events.items())))
    print(f"{time.process_time() - begun:.0f} s of processor time")
    return 0 if agreeing == options.machines else 1


def judged(seed: int, until: float) -> tuple[str, list[str], int]:
    """Return how a machine differs, or no text, the kinds of the compared events, and limits.

    The limits are the Zeno points at which impacts and events of a part accumulate.
    """
    machine = LinearMachine.random(seed)
    task = task_of(machine, seed, until)
    try:
        found, slow = by_loop(task), by_reference(task)
    except zo.SimulationError as error:
        return f"{type(error).__name__}: {error}", [], 0
    if found is None or not np.array_equal(found.end_state, slow.end_state):
        return "the two loops differ", [], 0
    events, wanted = before_limits(found, events_of_reference(machine, seed, until))
    return compared(events, wanted), [name.split(" ")[0] for _, name in wanted], joint(found)


def joint(found: zo.Execution) -> int:
    """Return how many Zeno points have events of a part in the flight before the last impact."""
    count = 0
    for zeno in found.zeno_points:
        struck = [one.time for one in found.impacts if one.time < zeno.time][-2:]
        count += any(struck[0] <= one.time < struck[-1] for one in found.switches)
    return count


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
