"""Which sensors hold a repelling orbit: windows, encoder steps, delays and filters, one at a time.

The held motor pendulum of `docs/feedback.md` runs on a stiff stop. Its controller reads exact
coordinates every millisecond, and filters the rates over 2 ms. Each row changes one number. It
lists how many of the runs are held, and how the rate at the release deviates from the orbit: mean
and standard deviation over the last two thirds of the periods.

Exit 1 if a window of 40 ms does not hold every run, or if runs are held without one.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import zeno_orbits as zo
from tests.support.repelling import GAINS, START

RANGE = {"Kd": (-1.83, -1.33)}
STIFF = zo.Contact(stiffness=1e6)
WINDOW = 0.04
"""Window of the rows that change another number [s]."""
RESTED = 0.1
"""Duration of a contact that ends in a release [s]."""
ROWS: dict[str, dict[str, float]] = {
    "no window": {"sensors.window": 0.0},
    "window 10 ms": {"sensors.window": 0.01},
    "window 20 ms": {"sensors.window": 0.02},
    "window 40 ms": {},
    "window 80 ms": {"sensors.window": 0.08},
    "delay 1 ms": {"controller.delay": 1e-3},
    "filter 4 ms": {"sensors.filter_time": 4e-3},
    "131072 steps per turn": {"sensors.resolution": 2 * np.pi / 131072},
    "32768 steps per turn": {"sensors.resolution": 2 * np.pi / 32768},
    "8192 steps per turn": {"sensors.resolution": 2 * np.pi / 8192},
    "noise 25 urad": {"sensors.noise": 2.5e-5},
    "noise 100 urad": {"sensors.noise": 1e-4},
}


@dataclass(frozen=True)
class Held:
    """Runs of one row.

    Attributes:
        held: Number of runs that kept the orbit.
        runs: Number of runs.
        offset: Mean deviation of the rate at the release, of the runs that kept it [rad/s].
        scatter: Standard deviation of the rate [rad/s].
    """

    held: int
    runs: int
    offset: float
    scatter: float


def held_machine() -> tuple[zo.Problem, zo.Orbit]:
    """Return the machine with its feedback, and the orbit that it keeps."""
    orbit = zo.find_orbit_by_shooting("motor_pendulum", gains=GAINS, start=START).unwrap()
    return zo.design_feedback(orbit, RANGE).machine(), orbit


def changed(changes: Mapping[str, float]) -> zo.Rig:
    """Return a stiff stop with a sampled controller and filtered rates, after changes."""
    rig = zo.Rig(
        contact=STIFF,
        controller=zo.Controller(period=1e-3),
        sensors=zo.Sensors(filter_time=2e-3, window=WINDOW),
    )
    for name, value in changes.items():
        part, _, number = name.partition(".")
        rig = replace(rig, **{part: replace(getattr(rig, part), **{number: value})})
    return rig


def rates_at_release(
    machine: zo.Problem, orbit: zo.Orbit, rig: zo.Rig, periods: int, seed: int
) -> list[float] | None:
    """Return the rate at each release, or None if the orbit is lost."""
    try:
        run = zo.simulate_rig(machine, rig, until=periods * orbit.period, seed=seed)
    except zo.SimulationError:
        return None
    rested = [one for one in run.touches if RESTED < one.end - one.start < np.inf]
    if not periods - 2 <= len(rested) <= periods + 1:
        return None
    place = machine.state_names.index("dtheta1")
    return [float(one.end_state[place]) for one in rested]


def measure(machine: zo.Problem, orbit: zo.Orbit, rig: zo.Rig, periods: int, seeds: int) -> Held:
    """Return how many runs of a rig are held, and how exactly."""
    centre = float(START["dtheta1"])
    found = [rates_at_release(machine, orbit, rig, periods, seed) for seed in range(seeds)]
    late = [np.array(one[len(one) // 3 :]) - centre for one in found if one is not None]
    every = np.concatenate(late) if late else np.array([np.nan])
    return Held(len(late), seeds, float(np.mean(every)), float(np.std(every)))


def main(words: list[str] | None = None) -> int:
    """Measure the rows and print them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", nargs="+", choices=list(ROWS), default=list(ROWS))
    parser.add_argument("--periods", type=int, default=20)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args(words)
    machine, orbit = held_machine()
    found: dict[str, Held] = {}
    for name in options.rows:
        found[name] = measure(machine, orbit, changed(ROWS[name]), options.periods, options.seeds)
        if not options.json:
            one = found[name]
            told = f"offset {one.offset:+.3f}, scatter {one.scatter:.3f} rad/s"
            print(f"{name:20s} held {one.held} of {one.runs}, {told}", flush=True)
    if options.json:
        print(json.dumps({name: asdict(one) for name, one in found.items()}))
    good, bad = found.get("window 40 ms"), found.get("no window")
    failed = (good is not None and good.held < good.runs) or (
        bad is not None and bad.held == bad.runs
    )
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
