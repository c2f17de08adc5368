"""How often fits of transients hold the truth, find wrong models, and agree with recorded drops.

    python benchmarks/transients.py coverage [--count 100] [--seed 1] [--machines NAME ...]
    python benchmarks/transients.py scatter [--count 100] [--seed 1]
    python benchmarks/transients.py wrong [--count 50] [--seed 1]
    python benchmarks/transients.py drops TIMES.csv

`coverage`: every recording has its own truth within 10 % of the problem's values, its own start,
noise of 0.1 to 3 % of the ranges, and a fit that begins 20 % off. A parameter is held if its 95 %
interval contains the truth. The shares have binomial intervals of 95 %.

`scatter`: single drops of a ball whose restitution scatters by 0, 3 and 10 % from impact to
impact, by their closed form.

`wrong`: a constant restitution is fitted to a ball whose restitution falls with the speed, and a
pendulum without friction to one with friction. The motions are closed forms or integrations of
SciPy, not simulations of this package. The share counts verdicts that structure is left. The same
fits of right models count false alarms.

`drops`: a table with the columns `ball,drop,bounce,time [s]`, the times of bounces by a microphone.
The drops of a ball are trials of one fit. The printed values can be compared with a restricted
likelihood of the logarithms of neighbouring flights, which is another method.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.stats import binomtest

import zeno_orbits as zo
from zeno_orbits.experiment import RecordedSignal
from zeno_orbits.work import silent

_OFF = 0.2
"""Relative error of the values at the start of a fit."""
_TRUTH = 0.1
_NOISE = (1e-3, 3e-2)
_SCATTERS = (0.0, 0.03, 0.1)


@dataclass(frozen=True, kw_only=True)
class Machine:
    """A machine whose transients are fitted.

    Attributes:
        problem: Name of the problem.
        signals: Recorded states.
        fit: Fitted parameters, tied ones with ``+``.
        start: Initial state.
        until: Length of the recording [s].
        rate: Samples per second [Hz].
        parameters: Parameters about which the truth is drawn, by default those of the problem.
    """

    problem: str
    signals: tuple[str, ...]
    fit: tuple[str, ...]
    start: Mapping[str, float]
    until: float
    rate: float
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])


MACHINES = {
    "ball": Machine(
        problem="bouncing_ball",
        signals=("height",),
        fit=("restitution", "g"),
        start={"height": 0.8},
        until=3.0,
        rate=200.0,
    ),
    "pendulum": Machine(
        problem="falling_pendulum",
        signals=("angle",),
        fit=("restitution", "I"),
        start={"angle": 1.6},
        until=2.5,
        rate=200.0,
    ),
    "motor pendulum": Machine(
        problem="motor_pendulum",
        signals=("theta1", "theta2"),
        fit=("restitution", "lc2"),
        start={"theta1": 1.0, "theta2": 0.9},
        until=2.0,
        rate=200.0,
    ),
    "motor pendulum with current": Machine(
        problem="motor_pendulum",
        signals=("theta1", "theta2", "current"),
        fit=("restitution", "R", "K_torque+K_emf"),
        start={"theta1": 1.0, "theta2": 0.9},
        until=2.0,
        rate=200.0,
    ),
    "clapper": Machine(
        problem="clapper",
        signals=("place", "speed"),
        fit=("restitution", "k", "c"),
        start={"place": 0.1, "cosine": 1.0},
        until=3.0,
        rate=100.0,
    ),
    "relay": Machine(
        problem="relay",
        signals=("z", "flux"),
        fit=("restitution", "ks", "R"),
        start={},
        until=0.02,
        rate=4e4,
    ),
    "relief valve": Machine(
        problem="relief_valve",
        signals=("lift", "pressure"),
        fit=("restitution", "stiffness"),
        start={"lift": 0.5, "pressure": 10.5},
        until=3.0,
        rate=200.0,
    ),
    "limited pendulum": Machine(
        problem="limited_pendulum",
        signals=("theta1", "theta2"),
        fit=("restitution", "lc2"),
        start={"theta1": 1.0, "theta2": 0.9},
        until=2.0,
        rate=200.0,
    ),
    "sticking pendulum": Machine(
        problem="sticking_pendulum",
        signals=("theta1", "theta2"),
        fit=("T_gear+T_static",),
        start={"theta1": 1.2, "theta2": 0.9, "dtheta1": 2.0},
        until=3.0,
        rate=200.0,
        parameters={"T_gear": 0.05, "T_static": 0.05},
    ),
    "stick slip": Machine(
        problem="stick_slip",
        signals=("x",),
        fit=("T", "T_static"),
        start={"x": 0.2, "v": 0.3},
        until=12.0,
        rate=50.0,
    ),
    "torque pendulum": Machine(
        problem="torque_pendulum",
        signals=("theta1", "theta2"),
        fit=("restitution", "b1"),
        start={"theta1": 1.0, "theta2": 0.9, "cosine": 1.0},
        until=3.0,
        rate=200.0,
    ),
    "forced oscillator": Machine(
        problem="forced_oscillator",
        signals=("distance",),
        fit=("restitution", "k"),
        start={"distance": 1.5, "cosine": 1.0},
        until=8.0,
        rate=50.0,
    ),
}


def main() -> int:
    """Run one of the parts."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("part", choices=["coverage", "scatter", "wrong", "drops"])
    parser.add_argument("table", nargs="?", type=Path)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--machines", nargs="+", choices=list(MACHINES), default=list(MACHINES))
    options = parser.parse_args()
    if options.part == "drops":
        return drops(options.table)
    if options.part == "scatter":
        return scatter(options.count, options.seed)
    if options.part == "wrong":
        return wrong(options.count, options.seed)
    return coverage(options.machines, options.count, options.seed)


def coverage(machines: Sequence[str], count: int, seed: int) -> int:
    """Print the share of intervals that contain the truth. Return 0 if chance explains all."""
    total, fine = [0, 0], True
    for name in machines:
        held: dict[str, list[int]] = {label: [0, 0] for label in MACHINES[name].fit}
        times, alarms, lost, wrong_counts = list[float](), 0, 0, 0
        for k in range(count):
            random = np.random.default_rng([seed, k, len(name)])
            begun = time.perf_counter()
            try:
                found, truth, n_impacts = one_fit(MACHINES[name], random)
            except zo.ZenoOrbitsError as error:
                print(f"  {name} {k}: {error}", file=sys.stderr)
                lost += 1
                continue
            times.append(time.perf_counter() - begun)
            detail = found.transient
            alarms += detail is not None and detail.tests.has_structure
            if detail is not None:
                wrong_counts += abs(len(detail.trials[0].impacts) - n_impacts) > 1
            for one in found.fitted:
                if math.isfinite(one.error):
                    label = one.unknown.label
                    held[label][1] += 1
                    held[label][0] += one.low <= truth[label] <= one.high
        for label, (inside, n) in held.items():
            total[0] += inside
            total[1] += n
            fine &= n == 0 or binomtest(inside, n, 0.95).pvalue > 1e-3
            print(f"{name:28s} {label:16s} {share(inside, n)}")
        print(
            f"{name:28s} lost {lost}, structure {alarms}, other counts of impacts {wrong_counts}, "
            f"median {np.median(times):.1f} s, longest {max(times):.1f} s",
            flush=True,
        )
    print(f"{'all':28s} {'':16s} {share(*total)}")
    return 0 if fine else 1


def scatter(count: int, seed: int) -> int:
    """Print the share of intervals of scattering drops that contain the truth."""
    fine = True
    for size in _SCATTERS:
        random, held, found_sizes = np.random.default_rng([seed, 7]), 0, list[float]()
        for _ in range(count):
            e = random.uniform(0.5, 0.8)
            times = np.arange(0.0, 0.32 * (1 + e) / (1 - e) + 0.1, 0.004)
            heights = ball_heights(times, 0.5, (e, 0.0), size, random)
            heights += 1.5e-3 * random.standard_normal(len(times))
            recording = recording_of("bouncing_ball", "height", "m", times, heights)
            found = zo.identify(
                "bouncing_ball", recording, ["restitution"], transient=True, on_progress=silent
            )
            (one,) = found.fitted
            held += one.low <= e <= one.high
            if found.transient is not None and math.isfinite(found.transient.scatter):
                found_sizes.append(found.transient.scatter)
        middle = 100 * float(np.median(found_sizes)) if found_sizes else 0.0
        print(
            f"scatter {100 * size:2.0f} %: {share(held, count)}, mixed model in "
            f"{len(found_sizes)}, median scatter {middle:.1f} %",
            flush=True,
        )
        fine &= binomtest(held, count, 0.95).pvalue > 1e-3
    return 0 if fine else 1


def share(inside: int, n: int) -> str:
    """Return a share with its binomial interval."""
    if not n:
        return "not determined"
    low, high = binomtest(inside, n).proportion_ci(0.95)
    return f"{inside:4d} of {n:4d} = {inside / n:.3f} [{low:.3f}, {high:.3f}]"


def one_fit(
    machine: Machine, random: np.random.Generator
) -> tuple[zo.Identification, dict[str, float], int]:
    """Return the fit of one simulated transient, the truth, and its number of resolved impacts."""
    problem = zo.load_problem(machine.problem)
    own = {**problem.values().parameters, **machine.parameters}
    truth, begin = dict[str, float](), dict[str, float]()
    for label in machine.fit:
        value = own[label.split("+")[0]] * (1 + _TRUTH * random.uniform(-1, 1))
        for name in label.split("+"):
            truth[name] = value
            begin[name] = value * (1 + _OFF * random.choice([-1, 1]))
    if "restitution" in begin:
        begin["restitution"] = min(begin["restitution"], 0.95)
    start = {
        name: value * (1 + 0.1 * random.uniform(-1, 1)) if name != "cosine" else value
        for name, value in machine.start.items()
    }
    motion = zo.simulate(problem, until=machine.until, parameters=own | truth, start=start or None)
    noise = math.exp(random.uniform(math.log(_NOISE[0]), math.log(_NOISE[1])))
    seed = int(random.integers(2**31))
    sampled = zo.sample_execution(
        problem, motion, parameters=own | truth, rate=machine.rate, noise=noise, seed=seed
    )
    kept = tuple(one for one in sampled.signals if one.name in machine.signals)
    recording = replace(sampled, signals=kept)
    fixed = {name: 0.0 for name in ("current",) if name in problem.state_names}
    found = zo.identify(
        problem,
        recording,
        list(machine.fit),
        # Parameters that the problem derives from others are those of the truth.
        parameters={**problem.values(parameters=own | truth).parameters, **begin},
        start={} if "current" in machine.signals else fixed,
        transient=True,
        on_progress=silent,
    )
    flights = np.diff([*(one.time for one in motion.impacts), math.inf])
    before = np.diff([-math.inf, *(one.time for one in motion.impacts)])
    resolved = (flights > 3.0 / machine.rate) | (before > 3.0 / machine.rate)
    return found, {label: truth[label.split("+")[0]] for label in machine.fit}, int(resolved.sum())


def ball_heights(
    times: NDArray[np.float64],
    height: float,
    law: tuple[float, float],
    scatter: float = 0.0,
    random: np.random.Generator | None = None,
) -> NDArray[np.float64]:
    """Return the heights of a ball with the restitution ``e0 - c v``, by its flights.

    Args:
        times: ``(n,)`` [s].
        height: Initial height [m].
        law: `e0` and `c` [s/m].
        scatter: Relative scatter of the restitution from impact to impact.
        random: Source of the scatter.
    """
    g = 9.81
    begin, speed = math.sqrt(2 * height / g), math.sqrt(2 * g * height)
    found = np.where(times < begin, height - g * times**2 / 2, 0.0)
    while speed > 1e-6:
        luck = 1.0 + scatter * random.standard_normal() if random is not None else 1.0
        speed *= min(max((law[0] - law[1] * speed) * luck, 0.0), 0.99)
        end = begin + 2 * speed / g
        inside = (times >= begin) & (times < end)
        since = times[inside] - begin
        found[inside] = speed * since - g * since**2 / 2
        begin = end
    return found


def pendulum_angles(
    times: NDArray[np.float64], angle: float, friction: float
) -> NDArray[np.float64]:
    """Return the angles of `falling_pendulum` with viscous friction, integrated by SciPy.

    Args:
        times: ``(n,)`` [s].
        angle: Initial angle [rad].
        friction: Viscous friction over the inertia [1/s].
    """
    p = zo.load_problem("falling_pendulum").values().parameters
    frequency = p["m"] * p["g"] * p["lc"] / (p["I"] + p["m"] * p["lc"] ** 2)

    def rate(_: float, x: NDArray[np.float64]) -> list[float]:
        return [x[1], -frequency * math.sin(x[0] + p["stop"]) - friction * x[1]]

    def gap(_: float, x: NDArray[np.float64]) -> float:
        return float(x[0])

    gap.terminal, gap.direction = True, -1.0  # pyright: ignore[reportFunctionMemberAccess]
    found, begin, state = np.zeros(len(times)), 0.0, [angle, 0.0]
    while begin < times[-1] and (abs(state[1]) > 1e-4 or begin == 0.0):
        span = (begin, float(times[-1]) + 1e-9)
        run = solve_ivp(rate, span, state, events=gap, dense_output=True, rtol=1e-10, atol=1e-12)
        end = float(run.t[-1])
        inside = (times >= begin) & (times <= end)
        if inside.any():
            found[inside] = _dense(run)(times[inside])[0]
        begin, state = end, [1e-13, -p["restitution"] * float(run.y[1, -1])]
    return found


def _dense(run: Any) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Return the dense output of an integration."""
    return run.sol


def recording_of(
    problem: str, name: str, unit: str, times: NDArray[np.float64], values: NDArray[np.float64]
) -> zo.Recording:
    """Return one signal as a recording."""
    signal = RecordedSignal(name=name, unit=unit, values=values)
    return zo.Recording(source=None, problem=problem, time=times, signals=(signal,))


def wrong(count: int, seed: int) -> int:
    """Print how often wrong and right models leave structure. Return 0 if the shares are met."""
    rows: dict[str, list[int]] = {}
    for k in range(count):
        for label, is_wrong, found in wrong_fits(np.random.default_rng([seed, k])):
            row = rows.setdefault(f"{label}, {'wrong' if is_wrong else 'right'} model", [0, 0])
            row[0] += found.transient is not None and found.transient.tests.has_structure
            row[1] += 1
    fine = True
    for label, (told, n) in rows.items():
        print(f"{label:44s} structure left in {share(told, n)}")
        fine &= told >= 0.95 * n if "wrong" in label else told <= 0.1 * n + 1
    return 0 if fine else 1


def wrong_fits(random: np.random.Generator) -> Iterator[tuple[str, bool, zo.Identification]]:
    """Yield fits of wrong and right models, with a label and whether the model is wrong."""
    times = np.arange(0.0, 2.5, 0.005)
    noise = float(np.exp(random.uniform(math.log(1e-3), math.log(1e-2))))
    for is_wrong in (True, False):
        c = random.uniform(0.02, 0.06) if is_wrong else 0.0
        clean = ball_heights(times, 0.5, (random.uniform(0.7, 0.85), c))
        heights = clean + noise * 0.5 * random.standard_normal(len(times))
        found = zo.identify(
            "bouncing_ball",
            recording_of("bouncing_ball", "height", "m", times, heights),
            ["restitution"],
            transient=True,
            on_progress=silent,
        )
        yield "ball, restitution of the speed", is_wrong, found
        clean = pendulum_angles(times, 1.6, random.uniform(0.2, 0.6) if is_wrong else 0.0)
        angles = clean + noise * 1.6 * random.standard_normal(len(times))
        found = zo.identify(
            "falling_pendulum",
            recording_of("falling_pendulum", "angle", "rad", times, angles),
            ["restitution", "I"],
            transient=True,
            on_progress=silent,
        )
        yield "pendulum, friction", is_wrong, found


def drops(table: Path) -> int:
    """Print the restitution of each ball of a table of bounce times, and the errors of the ear."""
    balls: dict[str, dict[str, list[float]]] = {}
    with table.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            balls.setdefault(row["ball"], {}).setdefault(row["drop"], []).append(
                float(row["time [s]"])
            )
    errors = [0, 0, 0]
    for ball, rows in balls.items():
        begun = time.perf_counter()
        found = zo.identify(
            "bouncing_ball",
            [_events(np.unique(np.array(times))) for times in rows.values()],
            ["restitution"],
            initial=["height"],
            on_progress=silent,
        )
        detail, one = found.transient, found.fitted[0]
        if detail is None:
            return 1
        own = [
            sum(len(trial.missed) for trial in detail.trials),
            sum(len(trial.false) for trial in detail.trials),
            sum(bool(trial.missed or trial.false) for trial in detail.trials),
        ]
        errors = [a + b for a, b in zip(errors, own, strict=True)]
        print(
            f"{ball:16s} {len(rows):3d} drops: e {one.value:.4f} +- {one.error:.4f}, scatter "
            f"{100 * detail.scatter:.2f} %, jitter {1e3 * detail.jitter:.2f} ms, missed {own[0]}, "
            f"false {own[1]}, in {own[2]} drops, {time.perf_counter() - begun:.0f} s; "
            f"{detail.verdict}",
            flush=True,
        )
    print(f"all: missed {errors[0]}, false {errors[1]}, in {errors[2]} drops")
    return 0


def _events(times: NDArray[np.float64]) -> zo.Recording:
    signal = RecordedSignal(name="impact", unit="s", values=times)
    return zo.Recording(source=None, problem="bouncing_ball", time=times, signals=(signal,))


if __name__ == "__main__":
    raise SystemExit(main())
