"""Special points and ends of random families against brute force.

    python benchmarks/special_points.py [--families 60] [--points 500] [--seed 31] [--marginal 40]
        [--workers N] [--checkpoint FOLDER] [--quick]

Six machines: `motor_pendulum` (with the branches of two Zeno points a period), `curved_surface`,
`torque_pendulum`, `relief_valve`, a chain of three masses, and `forced_oscillator` with one impact
a turn and no Zeno point. Numbers, parameter and range of a family are drawn by the seed. Brute
force traces the family in short steps (`support/traced.py`); flights of the oscillator are exact.

A point of brute force that `continue` does not list within the tolerance is missed. A listed point
is false if neither brute force has it nor the multipliers of an orbit traced anew right there are
on the unit circle.

Marginal orbits: the oscillator where the exact spectral radius is 1 plus or minus 1e-6 to 1e-10.
Each must be called stable if it is, not stable if it is not, or undecided.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq, minimize_scalar

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.spreading import add_options, arriving
from support.traced import (
    FLIP,
    FOLD,
    STEPS,
    TORUS,
    LostError,
    Map,
    Point,
    Returned,
    Tracer,
    Vector,
    releases,
)

from tests.reference.linear_impacts import ImpactOscillator
from zeno_orbits.continuation import (
    ContinuationSettings,
    Family,
    SpecialPointKind,
    family_of_impacts,
    family_of_orbit,
)
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model.library import load_problem
from zeno_orbits.orbits import ONE_ZENO
from zeno_orbits.search import orbit_by_shooting
from zeno_orbits.simulation import SimulationSettings

CHAIN = str(Path(__file__).parent / "support" / "chain.py")
OSCILLATOR = "forced_oscillator"


@dataclass(frozen=True, kw_only=True)
class Machine:
    """A machine whose families are traced.

    Attributes:
        problem: Its name or file.
        spread: Numbers that are drawn, and how far: a factor from 1 / (1 + part) to 1 + part.
        parameters: Parameters of which one is followed.
    """

    problem: str
    spread: Mapping[str, float]
    parameters: tuple[str, ...]


MACHINES = (
    Machine(
        problem="motor_pendulum",
        spread={"Kp": 0.8, "Kd": 0.5, "restitution": 0.9, "L": 1.0, "m2": 0.2},
        parameters=("Kd", "Kp", "restitution"),
    ),
    Machine(
        problem="curved_surface",
        spread={"A": 0.15, "rho": 0.5, "c": 1.0, "restitution": 0.6, "lean": 0.5},
        parameters=("A", "omega", "rho", "lean", "restitution"),
    ),
    Machine(
        problem="torque_pendulum",
        spread={"A": 0.3, "omega": 0.2, "b1": 1.0, "restitution": 0.6},
        parameters=("A", "omega", "b1", "restitution"),
    ),
    Machine(
        problem="relief_valve",
        spread={"q": 0.3, "d": 0.3, "b": 0.3, "restitution": 0.6},
        parameters=("q", "d", "b", "restitution"),
    ),
    Machine(
        problem=CHAIN,
        spread={"F": 0.3, "omega": 0.15, "c": 1.0, "restitution": 0.6},
        parameters=("F", "omega", "k", "c"),
    ),
    Machine(
        problem=OSCILLATOR,
        spread={"omega": 0.5, "c": 1.0, "restitution": 0.2},
        parameters=("A", "omega", "stop", "c"),
    ),
)
COCO = {"A": 1.0, "omega": 1.0, "c": 0.1, "stop": 1.0, "restitution": 0.8}
"""The oscillator of which the numbers are drawn."""
SAME = 1e-6
"""Parts of the range by which the same special point may differ."""
END = 1e-4
"""The same for an end, which brute force reaches only as far as orbits can be computed."""
NEARLY = 0.02
"""Arclength before grazing from which an end is extrapolated: Newton's method misses the stop."""
ON_CIRCLE = 1e-6
"""Distance of a multiplier from the unit circle at a special point."""
INSIDE = {
    SpecialPointKind.FOLD: FOLD,
    SpecialPointKind.FLIP: FLIP,
    SpecialPointKind.TORUS: TORUS,
}
STOPPED = {SpecialPointKind.MOST_STEPS, SpecialPointKind.GAVE_UP}


def oscillator(numbers: Mapping[str, float]) -> ImpactOscillator:
    """Return the closed form of the oscillator."""
    return ImpactOscillator(
        amplitude=numbers["A"],
        omega=numbers["omega"],
        damping=numbers["c"],
        stop=numbers["stop"],
        restitution=numbers["restitution"],
    )


def impacts(numbers: Mapping[str, float], parameter: str, unit: float) -> Map:
    """Return the exact map from phase and velocity after an impact to those after the next."""

    def landed(z: Vector, one: ImpactOscillator) -> tuple[float, float, Vector]:
        start, speed = z[0] / one.omega, z[1]
        left = np.array([one.stop, speed]) - one.particular(start)
        if not speed < 0.0:
            raise LostError("the impact grazes")
        roots, ways = np.linalg.eig(one.free.astype(complex))
        parts = ways[0] * np.linalg.solve(ways, left)

        def position(t: Any) -> Any:
            response = one.amplitude / complex(1 - one.omega**2, one.damping * one.omega)
            forced = (response * np.exp(1j * one.omega * (start + t))).real
            return forced + (np.exp(np.multiply.outer(t, roots)) @ parts).real - one.stop

        times = np.linspace(0.0, 2.5 * one.period, 2001)[1:]
        heights = position(times)
        # A flight begins below the stop, but rounding may put its first sample on it.
        tops = np.flatnonzero((heights[1:-1] >= heights[:-2]) & (heights[1:-1] > heights[2:])) + 1
        for k in tops[heights[tops] < 0.0]:
            # Near grazing the way beyond the stop lies between two samples.
            near = {"bounds": (times[k - 1], times[k + 1]), "options": {"xatol": 1e-12}}
            top = float(minimize_scalar(lambda t: -float(position(t)), method="bounded", **near).x)
            if position(top) > 0.0:
                times, heights = np.insert(times, k, top), np.insert(heights, k, position(top))
                order = np.argsort(times)
                times, heights = times[order], heights[order]
                break
        beyond = np.flatnonzero((heights[1:] >= 0.0) & (heights[:-1] < 0.0))
        if not beyond.size:
            raise LostError("no impact follows")
        k = int(beyond[0])
        ends = float(times[k]), float(times[k + 1])
        # A single height may round to the other side of the stop than the same one among many.
        touches = [t for t in ends if bool(position(t) >= 0.0) == (t == ends[0])]
        flight = touches[0] if touches else float(brentq(position, *ends, xtol=1e-15, rtol=1e-15))
        state = one.particular(start + flight) + expm(one.free * flight) @ left
        return start + flight, flight, state

    def end_of(z: Vector, s: float) -> Vector:
        one = oscillator({**numbers, parameter: s})
        time, _, state = landed(z, one)
        return np.array([one.omega * time - 2 * math.pi, -one.restitution * state[1]])

    def returned(z: Vector, s: float) -> Returned:
        one = oscillator({**numbers, parameter: s})
        time, flight, state = landed(z, one)
        if not state[1] > 0.0:
            raise LostError("the impact grazes")
        flow = expm(one.free * flight)

        def rate(y: Vector, t: float) -> Vector:
            force = one.amplitude * math.cos(one.omega * t)
            return np.asarray(one.free @ y + np.array([0.0, force]))

        begun = rate(np.array([one.stop, z[1]]), time - flight)
        by_start = np.column_stack([-flow @ begun / one.omega, flow[:, 1]])
        by_time = -by_start[0] / state[1]
        after = -one.restitution * (by_start[1] + rate(state, time)[1] * by_time)
        # The clock's phase at the start is held, so a later start delays the impact as a whole.
        by_phase = np.array([one.omega * by_time, after])
        by_phase[0, 0] = one.omega * by_time[0]
        h = 1e-7 * unit
        ends = [end_of(z, s + k * h) for k in (-2, -1, 1, 2)]
        by_parameter = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)
        return Returned(
            end=np.array([one.omega * time - 2 * math.pi, -one.restitution * state[1]]),
            by_state=by_phase,
            by_parameter=by_parameter,
        )

    return returned


def drawn(index: int, seed: int) -> tuple[Machine, dict[str, float], str, tuple[float, float]]:
    """Return machine, numbers, parameter and range of a family."""
    rng = np.random.default_rng([seed, index])
    machine = MACHINES[index % len(MACHINES)]
    problem = load_problem(machine.problem)
    base = dict(problem.values().numbers) | (COCO if machine.problem == OSCILLATOR else {})
    numbers = {
        name: base[name] * (1 + part) ** rng.uniform(-1, 1) for name, part in machine.spread.items()
    }
    numbers["restitution"] = min(numbers.get("restitution", 0.3), 0.9)
    if machine.problem == OSCILLATOR:
        numbers |= {"stop": float(rng.choice([0.0, 0.5, 1.0])), "A": 1.0}
    parameter = str(rng.choice(machine.parameters))
    value = numbers.get(parameter, base[parameter])
    size = abs(value) or 1.0
    low, high = value - size * rng.uniform(0.2, 1.2), value + size * rng.uniform(0.2, 1.5)
    if base[parameter] > 0.0 and parameter != "stop":
        low = max(low, 0.05 * size)
    if parameter == "restitution":
        low, high = max(low, 0.0), min(high, 0.95)
    return machine, numbers, parameter, (float(low), float(high))


@dataclass(frozen=True, kw_only=True)
class Families:
    """Families, followed and traced.

    Attributes:
        points: Points of brute force for the range of the parameter.
        seed: Of the families.
    """

    points: int
    seed: int

    def __call__(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        """Return what is missed and what is false of each family."""
        return [self._judged(index) for index in indices]

    def _judged(self, index: int) -> dict[str, Any]:
        machine, numbers, parameter, box = drawn(index, self.seed)
        problem = load_problem(machine.problem)
        told = {
            "name": f"{index}: {problem.name} in {parameter} from {box[0]:.5g} to {box[1]:.5g}",
            "numbers": numbers,
        }
        settings = ContinuationSettings(
            # Beside some ends a return stalls at the release: two million steps, 5 s each.
            simulation=SimulationSettings(most_steps=2 * STEPS),
            doublings=int(machine is MACHINES[0]),
        )
        began = time.process_time()
        try:
            values = problem.values(numbers=numbers)
            if machine.problem == OSCILLATOR:
                exact = impacts(values.numbers, parameter, box[1] - box[0])
                first = settled(exact, values.number(parameter))
                state = problem.state_vector(
                    {"speed": -first[1], "cosine": math.cos(first[0]), "sine": math.sin(first[0])}
                )
                found = family_of_impacts(problem, values, state, parameter, box, settings=settings)
            else:
                orbit = orbit_by_shooting(problem, values, shape=ONE_ZENO).orbit
                if orbit is None:
                    return {**told, "none": "no orbit to start from"}
                found = family_of_orbit(problem, orbit, parameter, box, settings=settings)
        except (ZenoOrbitsError, LostError) as error:
            return {**told, "none": str(error)}
        told["seconds"] = time.process_time() - began
        began = time.process_time()
        told["families"] = []
        for family in found.families:
            period = max(point.period for point in family.points)
            if machine.problem == OSCILLATOR:
                tracer = Tracer(returned=exact, scale=np.ones(2), box=box)
                x, s = np.array(first), values.number(parameter)
            else:
                returned = releases(problem, values, parameter, 3 * period, family.n_returns)
                states = np.array([list(point.state.values()) for point in family.points])
                sizes = np.max(np.abs(states), axis=0)
                scale = np.where(sizes > 1e-9, sizes, 1.0)
                tracer = Tracer(returned=returned, scale=scale, box=box)
                middle = family.points[len(family.points) // 2]
                x, s = np.array(list(middle.state.values())), middle.value
                if family.n_returns == 1:
                    x = np.array(problem.state_vector(orbit.release_state))
                    s = values.number(parameter)
            told["families"].append(self._compared(tracer, family, x, s))
        told["brute"] = time.process_time() - began
        return told

    def _compared(self, tracer: Tracer, family: Family, x: Vector, s: float) -> dict[str, Any]:
        start = tracer.start(x, s)
        back = Point(z=start.z, tangent=-start.tangent, multipliers=start.multipliers)
        most = 6 * self.points
        ways = [tracer.trace(one, 1.0 / self.points, most) for one in (start, back)]
        brute = [one for points, _ in ways for one in tracer.special(points)]
        unit = tracer.box[1] - tracer.box[0]
        listed = [(INSIDE[p.kind], p.at.value) for p in family.special if p.kind in INSIDE]
        left = list(listed)
        missed: list[str] = []
        for kind, value in brute:
            same = [one for one in left if one[0] == kind and abs(one[1] - value) < SAME * unit]
            if same:
                left.remove(same[0])
            elif all(
                abs(end.at.value - value) > SAME * unit for end in (family.first, family.last)
            ):
                # At an end itself, where orbits vanish, brute force turns to and fro by rounding.
                missed.append(f"{kind} at {value:.12g}")
        false = [f"{k} at {v:.12g}" for k, v in left if not self._true(tracer, family, k, v)]
        ends = []
        cut = [end for end in (family.first, family.last) if end.kind in STOPPED]
        for points, why in ways:
            value = tracer.value(end_of(points[-1]))
            near = [e for e in (family.first, family.last) if abs(e.at.value - value) < END * unit]
            if why == "points" or (not near and cut):
                ends.append(f"not compared: {why} at {value:.8g}")
            elif not near:
                kinds = [f"{e.kind.value} {e.at.value:.8g}" for e in (family.first, family.last)]
                ends.append(f"missed: {why} at {value:.8g}, listed {kinds}")
        return {
            "n_returns": family.n_returns,
            "listed": dict(Counter(kind for kind, _ in listed)),
            "others": [p.kind.value for p in family.special if p.kind not in INSIDE],
            "ends": [end.kind.value for end in (family.first, family.last)],
            "points": [len(family.points), sum(len(points) for points, _ in ways)],
            "missed": missed,
            "false": false,
            "ends off": ends,
            "more": len(left) - len(false),
        }

    def _true(self, tracer: Tracer, family: Family, kind: str, value: float) -> bool:
        """Return True if an orbit right at a listed point has a multiplier on the unit circle."""
        point = min(family.special, key=lambda one: abs(one.at.value - value)).at
        x = np.array(list(point.state.values()))
        if x.size != tracer.scale.size:
            # The oscillator is traced in phase and velocity.
            x = np.array([math.atan2(x[3], x[2]), -x[1]])
        z = np.append(x / tracer.scale, value / (tracer.box[1] - tracer.box[0]))
        try:
            near = tracer.at(z, np.append(np.ones(tracer.scale.size), 0.0))
        except LostError:
            return False
        goal = {FOLD: 1.0, FLIP: -1.0}.get(kind)
        off = [abs(m - goal) if goal else abs(abs(m) - 1) for m in near.multipliers]
        return min(off) < ON_CIRCLE


def end_of(last: Point) -> Vector:
    """Return where a family ends: the oscillator's where the speed of the impact vanishes."""
    if last.z.size > 3 or not last.tangent[1] > 0.0:
        return last.z
    part = -last.z[1] / last.tangent[1]
    return last.z + part * last.tangent if part < NEARLY else last.z


def settled(returned: Map, s: float) -> Vector:
    """Return the phase and velocity after an impact that many impacts lead to.

    Raises:
        LostError: If they do not repeat.
    """
    z = np.array([0.0, -1.0])
    for _ in range(300):
        after = returned(z, s).end
        after[0] = math.remainder(after[0], 2 * math.pi)
        if np.max(np.abs(after - z)) < 1e-10:
            return after
        z = after
    raise LostError("impacts do not settle to one a turn")


@dataclass(frozen=True, kw_only=True)
class Marginal:
    """Orbits of the oscillator whose exact spectral radius is nearly one."""

    def __call__(self, points: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        """Return what each is called, beside what it is."""
        return [self._called(point) for point in points]

    def _called(self, point: dict[str, Any]) -> dict[str, Any]:
        # The flip of docs/families.md in omega: beyond it the orbit is unstable.
        numbers = {**COCO, "stop": 0.0, "c": point["c"], "omega": 2.3}
        box = (2.2, 3.4)
        returned = impacts(numbers, "omega", box[1] - box[0])
        tracer = Tracer(returned=returned, scale=np.ones(2), box=box)
        start = tracer.start(settled(returned, 2.3), 2.3)
        points, _ = tracer.trace(start, 0.01, 400)

        def radius(point: Point) -> float:
            return float(max(abs(point.multipliers)))

        k = next(k for k, one in enumerate(points) if radius(one) > 1.0)
        a, b = tracer.value(points[k - 1].z), tracer.value(points[k].z)

        def at(s: float) -> Point:
            return tracer.start(points[k - 1].z[:-1], s)

        goal = 1.0 + point["off"]
        omega = float(brentq(lambda s: radius(at(s)) - goal, a, b, xtol=1e-15, rtol=1e-15))
        problem = load_problem(OSCILLATOR)
        values = problem.values(numbers={**numbers, "omega": 2.3})
        begun = start.z
        state = {"speed": -begun[1], "cosine": math.cos(begun[0]), "sine": math.sin(begun[0])}
        settings = ContinuationSettings(doublings=0)
        (family,) = family_of_impacts(
            problem, values, problem.state_vector(state), "omega", (2.25, omega), settings=settings
        ).families
        last = max((family.first, family.last), key=lambda end: end.at.value)
        end = last.at
        word = "undecided" if end.undecided else "stable" if end.stable else "unstable"
        right = word == "undecided" or (word == "stable") == (goal < 1.0)
        return {
            "called": word,
            "right": bool(right and abs(end.value - omega) < 1e-12),
            "error": float(end.multiplier_error),
            "off": float(end.spectral_radius - 1.0),
        }


def sums(found: Sequence[dict[str, Any]]) -> int:
    """Print the sums over families, and return how many of them are not as they should be."""
    each = [family for one in found for family in one["families"]]
    listed = sum((Counter(family["listed"]) for family in each), Counter())
    ends = Counter(end for family in each for end in family["ends"])
    wrong = {
        key: sum(len(family[key]) for family in each) for key in ("missed", "false", "ends off")
    }
    seconds = [one["seconds"] for one in found]
    print(
        f"{len(found)} families with {len(each) - len(found)} branches, "
        f"{sum(family['points'][1] for family in each)} points of brute force: "
        f"{dict(listed)} listed, {wrong['missed']} missed, {wrong['false']} false; "
        f"ends {dict(ends)}, {wrong['ends off']} unlike. "
        f"Processor time {np.median(seconds):.1f} s, at most {max(seconds):.0f} s each."
    )
    return sum(wrong.values())


def main() -> int:
    """Print a row a family and the sums; 1 if one is missed, false or judged wrongly."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--families", type=int, default=60)
    parser.add_argument("--points", type=int, default=500, help="of brute force over the range")
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--marginal", type=int, default=40, help="orbits near the unit circle")
    parser.add_argument("--only", type=int, nargs="+", help="indices of families")
    add_options(parser)
    parser.add_argument("--quick", action="store_true", help="six families of 100 points")
    options = parser.parse_args()
    if options.quick:
        options.families, options.points, options.marginal = 6, 100, 4
    task = Families(points=options.points, seed=options.seed)
    # About every second draw has an orbit to start from.
    indices = options.only or list(range(4 * options.families))
    found: list[dict[str, Any]] = []
    for index, one in zip(indices, arriving("families", task, indices, options), strict=False):
        if "families" not in one:
            print(f"({index}: {one.get('none', one.get('refused'))[:90]})", flush=True)
            continue
        found.append(one)
        print(one["name"], one["numbers"], f"{one['seconds']:.1f} s")
        print(*(f"    {family}" for family in one["families"]), sep="\n", flush=True)
        if len(found) == options.families:
            break
    wrong = sums(found) if found else 1
    rng = np.random.default_rng(options.seed)
    points = [
        {
            "c": float(rng.uniform(0.05, 0.2)),
            "off": float(rng.choice([-1, 1]) * 10 ** rng.uniform(-10, -6)),
        }
        for _ in range(options.marginal)
    ]
    told = list(arriving("marginal", Marginal(), points, options))
    for point, one in zip(points, told, strict=True):
        if not one.get("right"):
            print(f"    {point}: {one}")
    called = Counter(one.get("called", "refused") for one in told)
    n_right = sum(bool(one.get("right")) for one in told)
    print(f"{n_right} of {len(told)} marginal orbits right or undecided: {dict(called)}")
    return 1 if wrong or n_right < len(told) else 0


if __name__ == "__main__":
    raise SystemExit(main())
