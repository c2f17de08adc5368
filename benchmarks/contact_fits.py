"""Coverage of the intervals of `identify` from contact channels and a current of a relay.

Each recording is of a relay with random restitution, spring, resistance and turns, 5 to 15 % away
from the start values of the fit. Its channels are closed for a random time after each impact of the
orbit, so the model with hard stops is exact. The current has noise. With `--stiffness` the
recordings are of the rig instead, whose compliant stops no interval contains.

With `--last-step` only the last step of a fit is taken, from the true values, as in
`identification_intervals.py`: place, period, weights, residuals, derivatives and intervals are
those of `identify`, and the search is left out.

    python benchmarks/contact_fits.py                              # 100 recordings at 100 kHz
    python benchmarks/contact_fits.py --last-step --recordings 400
    python benchmarks/contact_fits.py --stiffness 1e7 --recordings 10
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import binom, binomtest

sys.path.insert(0, str(Path(__file__).parent))

from contact_coverage import NOISE, PERIODS, PROBLEM, RATE, SECTION, rig_run
from contact_coverage import recorded as recorded_run

import zeno_orbits as zo
from zeno_orbits.arrays import Vector
from zeno_orbits.experiment import FitParameter, RecordedSignal, Recording, Source, contact_names
from zeno_orbits.experiment.identification.event_period import EventPeriod, event_period
from zeno_orbits.experiment.identification.least_squares import weighed
from zeno_orbits.experiment.identification.prepared import Prepared, prepared
from zeno_orbits.experiment.identification.uncertainty import spread_of
from zeno_orbits.experiment.identification.unknowns import unknowns_of
from zeno_orbits.experiment.orbit_table import measurement
from zeno_orbits.orbits import orbit_event_name
from zeno_orbits.search import settled_return
from zeno_orbits.work import silent

SOUGHT = ("restitution", "ks", "R", "N")
NEAR, FAR = 0.05, 0.15
"""Least and largest relative distance of a true value from the start of the fit."""
CONTACTS = (2e-5, 6e-5)
"""Least and largest duration of a contact that ends with a bounce [s]."""
CHANCE = 0.01
"""Chance below which too few intervals hold."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """A parameter of a fit.

    Attributes:
        off: Deviation of its value from the true value, relative.
        error: Standard error, relative.
        half: Half of the length of the interval, relative.
        holds: Whether the interval holds the true value.
    """

    off: float
    error: float
    half: float
    holds: bool


def random_values(seed: int, names: Sequence[str] = SOUGHT) -> dict[str, float]:
    """Return random true values of parameters.

    Args:
        seed: Random seed.
        names: Names of the parameters.
    """
    random = np.random.default_rng([seed, 1])
    known = zo.load_problem(PROBLEM).values().parameters
    away = random.uniform(NEAR, FAR, len(names)) * random.choice([-1.0, 1.0], len(names))
    return {name: known[name] * (1.0 + part) for name, part in zip(names, away, strict=True)}


def settled_period(
    parameters: dict[str, float],
    signals: Sequence[str] = ("current",),
    *,
    name: str = PROBLEM,
    section: str | None = SECTION,
) -> EventPeriod:
    """Return an orbit with its signals.

    Args:
        parameters: Parameters that differ from their defaults.
        signals: Names of the signals.
        name: Name of the problem.
        section: Name of the event at which the period starts and ends. By default it is chosen.
    """
    problem = zo.load_problem(name)
    values = problem.values(parameters=parameters)
    found = settled_return(problem, values, section=section)
    return event_period(problem.graph_dynamics(values), found, measurement(problem, signals))


def recorded(
    orbit: EventPeriod,
    seed: int,
    *,
    rate: float = RATE,
    noise: float = NOISE,
    periods: float = PERIODS,
    contacts: tuple[float, float] = CONTACTS,
) -> Recording:
    """Return a recording of an orbit that begins at a random time.

    Args:
        orbit: The orbit.
        seed: Random seed of the noise, of the durations of contacts, and of the begin.
        rate: Samples per second [Hz].
        noise: Noise on the signals, relative to their ranges.
        periods: Number of periods.
        contacts: Least and largest duration of a contact that ends with a bounce [s].
    """
    random = np.random.default_rng([seed, 2])
    n = int(periods * orbit.period * rate)
    times = random.uniform(0.0, orbit.period) + np.arange(n) / rate
    values = orbit.at(times / orbit.period)
    values = values + noise * np.ptp(values, axis=0) * random.normal(size=values.shape)
    measured, stops = orbit.measured, orbit.graph.stop_names
    signals = [
        RecordedSignal(name=name, unit=unit, values=column)
        for name, unit, column in zip(measured.names, measured.units, values.T, strict=True)
    ]
    lasts = random.uniform(*contacts)
    channels = [
        RecordedSignal(name=title, unit="1", values=channel(orbit, stop, times, lasts))
        for stop, title in zip(stops, contact_names(stops), strict=True)
    ]
    return Recording(source=Source.SIMULATED, problem="", time=times, signals=(*signals, *channels))


def channel(orbit: EventPeriod, stop: str, times: Vector, lasts: float) -> Vector:
    """Return the contact channel of a stop, closed for a time after each impact, ``(n_t,)``.

    From a Zeno point on it is closed until the release, or until the end of the period.

    Args:
        orbit: The orbit.
        stop: Name of the stop.
        times: Times since the start of a period, ``(n_t,)`` [s].
        lasts: Duration of a contact that ends with a bounce [s].
    """
    events = [(orbit_event_name(event), event.time) for event in orbit.found.events]
    spans = [(time, lasts) for name, time in events if name == f"impact {stop}"]
    releases = [time for name, time in events if name == f"release {stop}"]
    spans += [
        (zeno, min((end - zeno) % orbit.period for end in releases or [orbit.period]))
        for name, zeno in events
        if name == f"zeno {stop}"
    ]
    touched = [(times - begin) % orbit.period < last for begin, last in spans]
    return np.any(touched, axis=0).astype(np.float64)


def recorded_rig(
    parameters: dict[str, float],
    seed: int,
    stiffness: float,
    *,
    rate: float = RATE,
    noise: float = NOISE,
    periods: int = PERIODS,
) -> Recording:
    """Return a recording of the rig that begins at a random time.

    Args:
        parameters: Parameters that differ from their defaults.
        seed: Random seed of the noise and of the begin.
        stiffness: Stiffness of its stops.
        rate: Samples per second [Hz].
        noise: Noise on the current, relative to its range.
        periods: Number of periods.
    """
    orbit = zo.find_orbit(PROBLEM, parameters=parameters, section=SECTION).unwrap()
    run = rig_run(orbit, periods, stiffness)
    random = np.random.default_rng([seed, 2])
    return recorded_run(run, orbit.period, rate, noise, random)


def scores_of(found: zo.Identification, truth: dict[str, float]) -> dict[str, Score]:
    """Return the scores of a fit, by the name of the parameter.

    Args:
        found: The fit.
        truth: The true values.
    """
    return {
        one.unknown.label: Score(
            off=one.value / true - 1.0,
            error=one.error / true,
            half=(one.high - one.low) / 2 / true,
            holds=one.low <= true <= one.high,
        )
        for one in found.fitted
        for true in [truth[one.unknown.label]]
    }


def last_step(recording: Recording, truth: dict[str, float]) -> dict[str, Score]:
    """Return the scores of the last step of a fit from the true values.

    Args:
        recording: The recording.
        truth: The true values.
    """
    problem = zo.load_problem(PROBLEM)
    values = problem.values(parameters=truth)
    sought = [
        FitParameter(names=(name,), lower=true / 2, upper=true * 2) for name, true in truth.items()
    ]
    unknowns = unknowns_of(problem, values, sought)
    whole = prepared(problem, values, unknowns, recording, silent)
    # The shift in phase alone is unknown at first.
    shift = least_shift(whole, unknowns.first)
    data = whole.samples.without_jumps(whole.orbits.table(shift))
    stage = weighed(whole.orbits, data, whole.found, shift, whole.contacts)
    jacobian, residuals = stage.jacobian(shift), stage.residuals(shift)
    step = -np.linalg.lstsq(jacobian, residuals, rcond=None)[0]
    spread = spread_of(jacobian, residuals + jacobian @ step, data)
    return {
        name: Score(
            off=float(step[k]),
            error=float(spread.errors[k]),
            half=float(spread.half[k]),
            holds=abs(float(step[k])) <= float(spread.half[k]),
        )
        for k, name in enumerate(truth)
    }


def least_shift(whole: Prepared, x: Vector) -> Vector:
    """Return unknowns with the shift in phase of the least squares, by two linear steps.

    Args:
        whole: The beginning of a fit.
        x: The unknowns, ``(k + 1,)``.
    """
    for _ in range(2):
        data = whole.samples.without_jumps(whole.orbits.table(x))
        stage = weighed(whole.orbits, data, whole.found, x, whole.contacts)
        late = stage.jacobian(x)[:, -1]
        x = np.append(x[:-1], x[-1] - late @ stage.residuals(x) / (late @ late))
    return x


def main() -> int:
    """Print the table; 1 if the intervals of a parameter hold less often than chance explains."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--rate", type=float, default=RATE, help="samples per second [Hz]")
    parser.add_argument("--noise", type=float, default=NOISE, help="on the current")
    parser.add_argument("--periods", type=int, default=PERIODS)
    parser.add_argument("--stiffness", type=float, help="record the rig with this stiffness")
    parser.add_argument("--seed", type=int, default=0, help="of the first recording")
    parser.add_argument("--last-step", action="store_true", help="leave the search out")
    parser.add_argument("--quick", action="store_true", help="two recordings of three periods")
    parser.add_argument("--verbose", action="store_true", help="print every fit")
    options = parser.parse_args()
    count, periods = (2, 3) if options.quick else (options.recordings, options.periods)
    found: dict[str, list[Score]] = {name: [] for name in SOUGHT}
    refused, begun = 0, time.process_time()
    for seed in range(options.seed, options.seed + count):
        truth = random_values(seed)
        how = {"rate": options.rate, "noise": options.noise}
        if options.stiffness is None:
            recording = recorded(settled_period(truth), seed, periods=periods, **how)
        else:
            recording = recorded_rig(truth, seed, options.stiffness, periods=periods, **how)
        try:
            if options.last_step:
                scores = last_step(recording, truth)
            else:
                scores = scores_of(zo.identify(PROBLEM, recording, SOUGHT), truth)
        except zo.UnfittableError as error:
            refused += 1
            print(f"seed {seed}: {error}", flush=True)
            continue
        for name, score in scores.items():
            found[name].append(score)
        if options.verbose:
            told = ", ".join(
                f"{name} {one.off / one.error:+.2f}{'' if one.holds else ' (outside)'}"
                for name, one in scores.items()
            )
            print(f"seed {seed}: {told} errors off", flush=True)
    worked = time.process_time() - begun
    print("| Parameter | Inside | 95 % of the share | Half interval [%] | Root mean square |")
    print("|---|---|---|---|---|")
    few = False
    for name, scored in found.items():
        n, held = len(scored), sum(one.holds for one in scored)
        if not n:
            continue
        low, high = binomtest(held, n).proportion_ci()
        size = np.sqrt(np.mean([(one.off / one.error) ** 2 for one in scored]))
        half = 100 * np.median([one.half for one in scored])
        print(
            f"| `{name}` | {held} of {n} | {low:.1%} to {high:.1%} | {half:.2g} | {size:.2f} |",
            flush=True,
        )
        few = few or bool(binom.cdf(held, n, 0.95) < CHANCE)
    print(f"refused: {refused} of {count}; {worked / count:.1f} s of processor time per recording")
    return int(few)


if __name__ == "__main__":
    raise SystemExit(main())
