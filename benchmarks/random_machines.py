"""Random forced oscillators with a stop against exact flights: does a map name their attractors?

    python benchmarks/random_machines.py --machines 300 --seed 1

The truth is that of `tests/reference/linear_flights.py`: a motion is periodic if all its impacts
repeat to 1e-9 in the last 100 turns of the clock. Where it is not, the map has to call it chaotic,
or to give the reason why it is undecided.

Exit 1 if an attractor is named wrongly, or a motion that repeats is called unsettled.
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.maps.test_kinds import agrees, found_at, machine_of


def main() -> int:
    """Print how many attractors are named right, and each that is not."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--machines", type=int, default=300, metavar="N")
    parser.add_argument("--turns", type=int, default=500, metavar="N", help="turns of the truth")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed of the machines")
    options = parser.parse_args()
    drawn = random.Random(options.seed)
    answers: Counter[bool | None] = Counter()
    kinds: Counter[str] = Counter()
    seconds = 0.0
    for _ in range(options.machines):
        machine = machine_of(drawn)
        started = time.process_time()
        found = found_at(machine)
        seconds += time.process_time() - started
        answer = agrees(machine, found, options.turns)
        answers[answer] += 1
        kinds[found.phrase] += 1
        if answer is not True:
            truth = "differs from" if answer is False else "is open in"
            print(f"{machine}: {found.phrase} ({found.detail}) {truth} exact flights", flush=True)
    print(f"seed {options.seed}: right {answers[True]}, wrong {answers[False]}, ", end="")
    print(
        f"not settled in the truth {answers[None]}; {1e3 * seconds / options.machines:.1f} ms each"
    )
    for phrase, count in kinds.most_common():
        print(f"{count:5} {phrase}")
    return int(answers[False] > 0)


if __name__ == "__main__":
    sys.exit(main())
