"""Errors of bounce times that `compare` finds in contact channels, against the rig's contacts.

A relay with compliant stops moves in settled periods. Its contacts begin and end at known times.
Recordings begin at random times between two samples and have noise on the current. The share of
values within two standard errors must be 95 % or more.

    python benchmarks/contact_coverage.py                  # 50 recordings at 100 kHz
    python benchmarks/contact_coverage.py --rate 99137     # not synchronous with the period
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.stats import binomtest

import zeno_orbits as zo
from zeno_orbits.experiment import RecordedSignal, Recording, Source
from zeno_orbits.experiment.rig.run import contacts_at

PROBLEM, SECTION = "relay", "zeno open"
RATE, NOISE, PERIODS, STIFFNESS = 1e5, 0.01, 6, 1e7
_FINE = 1e-5
"""Spacing of the current between which it is interpolated [s]. Its noise is much larger."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Settled:
    """A settled relay with compliant stops.

    Attributes:
        orbit: The orbit with hard stops.
        run: The periods of the rig.
        truth: Quantity to its value by the contacts of the rig [s].
    """

    orbit: zo.Orbit
    run: zo.RigRun
    truth: dict[str, float]


@cache
def settled(periods: int = PERIODS, stiffness: float = STIFFNESS) -> Settled:
    """Return the settled relay.

    Args:
        periods: Number of periods.
        stiffness: Stiffness of its stops.
    """
    orbit = zo.find_orbit(PROBLEM, section=SECTION).unwrap()
    run = rig_run(orbit, periods, stiffness)
    truth: dict[str, float] = {"period": orbit.period}
    for stop in run.stop_names:
        begins = np.array([touch.start for touch in run.touches if touch.stop == stop])
        # A flight of a quarter of the period divides the sequences. The second one is whole.
        cuts = np.flatnonzero(np.diff(begins) > orbit.period / 4) + 1
        group = np.split(begins, cuts)[1]
        truth[f"{stop}.bounce_time"] = float(group[-1] - group[0])
        for k, length in enumerate(np.diff(group), start=1):
            truth[f"{stop}.bounce {k}"] = float(length)
    return Settled(orbit=orbit, run=run, truth=truth)


def rig_run(orbit: zo.Orbit, periods: int, stiffness: float) -> zo.RigRun:
    """Return settled periods of the rig near an orbit, and one more.

    Args:
        orbit: The orbit.
        periods: Number of periods.
        stiffness: Stiffness of its stops.
    """
    rig = zo.Rig(contact=zo.Contact(stiffness=stiffness))
    settings = zo.RigSettings(spacing=_FINE)
    return zo.simulate_periods(orbit, rig=rig, periods=periods + 1, settle=2, settings=settings)


def recorded(
    run: zo.RigRun, period: float, rate: float, noise: float, random: np.random.Generator
) -> Recording:
    """Return a recording of current and contacts that begins at a random time.

    Args:
        run: Periods of the rig, and one more.
        period: The period [s].
        rate: Samples per second [Hz].
        noise: Noise on the current, relative to its range.
        random: Source of the noise and of the begin.
    """
    begin = float(random.uniform(0.0, period))
    n = int((run.times[-1] - period) * rate)
    time = begin + np.arange(n) / rate
    current = np.interp(time, run.record.times, run.record.outputs[:, 0])
    current = current + noise * np.ptp(current) * random.normal(size=n)
    contacts = contacts_at(run.touches, run.stop_names, time).T
    channels = [
        RecordedSignal(name=f"contact.{stop}", unit="1", values=values)
        for stop, values in zip(run.stop_names, contacts, strict=True)
    ]
    return Recording(
        source=Source.SIMULATED,
        problem=PROBLEM,
        time=time,
        signals=(RecordedSignal(name="current", unit="A", values=current), *channels),
    )


def scores(one: Settled, rate: float, noise: float, seeds: Sequence[int]) -> dict[str, list[float]]:
    """Return the deviations of the values of recordings in standard errors, by quantity.

    Args:
        one: The relay.
        rate: Samples per second [Hz].
        noise: Noise on the current, relative to its range.
        seeds: Random seed of each recording.
    """
    found: dict[str, list[float]] = {name: [] for name in one.truth}
    for seed in seeds:
        random = np.random.default_rng(seed)
        recording = recorded(one.run, one.orbit.period, rate, noise, random)
        comparison = zo.compare(one.orbit, recording)
        if comparison.unresolved or comparison.reasons:
            raise SystemExit(f"seed {seed}: {comparison!r}")
        for metric in comparison.metrics:
            if metric.name in found:
                off = metric.data - one.truth[metric.name]
                found[metric.name].append(off / metric.error)
    return found


def main() -> int:
    """Print the table; 1 if fewer than 95 % of the bounce times are within two errors."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--recordings", type=int, default=50)
    parser.add_argument("--rate", type=float, default=RATE, help="samples per second [Hz]")
    parser.add_argument("--noise", type=float, default=NOISE, help="on the current")
    parser.add_argument("--periods", type=int, default=PERIODS)
    parser.add_argument("--stiffness", type=float, default=STIFFNESS)
    options = parser.parse_args()
    one = settled(options.periods, options.stiffness)
    found = scores(one, options.rate, options.noise, range(options.recordings))
    print("| Quantity | True value [us] | Within two errors | Root mean square | Greatest |")
    print("|---|---|---|---|---|")
    bounces: list[float] = []
    for name, values in found.items():
        held = int(np.sum(np.abs(values) <= 2.0))
        print(
            f"| {name} | {1e6 * one.truth[name]:.2f} | {held} of {len(values)} | "
            f"{np.sqrt(np.mean(np.square(values))):.2f} | {np.max(np.abs(values)):.1f} |",
            flush=True,
        )
        bounces += values if "bounce" in name else []
    held = int(np.sum(np.abs(bounces) <= 2.0))
    low, high = binomtest(held, len(bounces)).proportion_ci()
    print(
        f"{held} of {len(bounces)} bounce times and lengths are within two errors: "
        f"{held / len(bounces):.1%} ({low:.1%} to {high:.1%})"
    )
    return 0 if held >= 0.95 * len(bounces) else 1


if __name__ == "__main__":
    raise SystemExit(main())
