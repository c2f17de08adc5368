"""Processor time of a search over the number of gains: waveforms of a relay with 2 to 20 gains.

    python benchmarks/many_gains.py [--gains N ...] [--kinds NAME ...] [--trials N]

`amplitudes` are those of harmonics beside the square wave of `relay`, in pairs for cosine and sine.
`levels` are equal parts of the first 5 ms of the voltage. The objective is the energy lost at the
closed stop, at the worst corner of 5 % in spring and resistance. A trial closes five orbits and
their derivatives. With `--trials` a search ends after this number.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import casadi as ca

import zeno_orbits as zo

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.support.relays import UNCERTAIN, driven_relay

SHAPED = 5e-3
"""Time that is divided into levels [s]."""
Symbols = Mapping[str, ca.SX]


def amplitudes(names: Sequence[str]) -> zo.Problem:
    """Return the relay with harmonics beside its square wave."""

    def voltage(clock: zo.Clock, p: Symbols) -> ca.SX:
        numbers = [p[name] for name in names] + [ca.SX(0)] * (len(names) % 2)
        pairs = zip(numbers[::2], numbers[1::2], strict=True)
        return ca.if_else(clock.sine > 0, p["U"], 0) + zo.harmonics(clock, list(pairs))

    return driven_relay(voltage, [_gain(name, 0.0, -6.0, 6.0) for name in names])


def levels(names: Sequence[str]) -> zo.Problem:
    """Return the relay with levels in the first part of its period."""
    times = [SHAPED * k / len(names) for k in range(1, len(names) + 1)]

    def voltage(clock: zo.Clock, p: Symbols) -> ca.SX:
        values = [*(p[name] for name in names), p["U"], ca.SX(0)]
        return zo.piecewise(clock, values, [*times, clock.period / 2])

    return driven_relay(voltage, [_gain(name, 18.0, 0.0, 24.0) for name in names])


def _gain(name: str, default: float, lower: float, upper: float) -> zo.Quantity:
    return zo.Quantity(
        name=name, unit="V", meaning="voltage", default=default, lower=lower, upper=upper
    )


KINDS = {"amplitudes": amplitudes, "levels": levels}


class Enough(Exception):  # noqa: N818 (it ends a search, and is no error)
    """The number of trials has been reached."""


@dataclass(kw_only=True)
class Stopwatch:
    """Processor time at every trial.

    Attributes:
        most: Number of trials.
        times: Processor time at the start of each [s].
    """

    most: int
    times: list[float] = field(default_factory=list[float])

    def __call__(self, stage: str, _part: float | None) -> None:
        """Note a trial."""
        if stage == "optimizing":
            self.times.append(time.process_time())
            if len(self.times) > self.most:
                raise Enough

    @property
    def per_trial(self) -> float:
        """Mean time of the trials after the first, which also makes the formulas [s]."""
        return (self.times[-1] - self.times[1]) / (len(self.times) - 2)


def measured(kind: str, n: int, most: int) -> tuple[float, str]:
    """Return the time of a trial [s], and the line of a search."""
    watch, begun = Stopwatch(most=most), time.process_time()
    worst = "-"
    try:
        found = zo.search_gains(
            KINDS[kind]([f"u{k}" for k in range(1, n + 1)]),
            objective=zo.MinImpactLoss(stop="closed", uncertain=UNCERTAIN),
            on_progress=watch,
            settings=zo.SearchSettings(n_starts=0),
        )
        worst = f"{found.worst:.4g}"
    except Enough:
        pass
    whole = time.process_time() - begun
    trials = min(len(watch.times), most)
    line = f"{kind:12}{n:6d}{trials:8d}{watch.per_trial:12.3f}{whole:10.1f}  {worst}"
    return watch.per_trial, line


def main() -> int:
    """Print the table, and return 1 if a trial takes more than in proportion to the gains."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--gains", nargs="+", type=int, default=[2, 5, 10, 20])
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--trials", type=int, default=sys.maxsize)
    options = parser.parse_args()
    print("waveform     gains  trials  [s]/trial   all [s]  worst loss [J]")
    linear = True
    for kind in options.kinds:
        first = 0.0
        for n in options.gains:
            each, line = measured(kind, n, options.trials)
            print(line, flush=True)
            first = first or each / n
            linear &= each <= n * first
    return 0 if linear else 1


if __name__ == "__main__":
    sys.exit(main())
