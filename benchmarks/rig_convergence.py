"""Does the Zeno orbit predict a machine without a Zeno point? Orders, errors, what else matters.

    python benchmarks/rig_convergence.py [orbit.json] [--picture convergence.png]

A rig with a contact that gives way settles near the reference orbit. As its stop stiffens the
distance falls; the orders are fitted and held against theory (6.6). Then every other part of the
machine alone, near the stiff limit. Everything is simulated.

A distance `d` over stiffnesses `k` is fitted by ``d = c k^-p``. Theory (6.6) expects ``p =
1/(n+1)`` for a contact force of power `n`: 1/2 for a spring, as contacts last that long.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np

from zeno_orbits.experiment import RigSettings, settle_rig
from zeno_orbits.experiment.rig import SettledRig, default_rig
from zeno_orbits.experiment.rig.cycle_comparison import (
    OrbitCurve,
    numbers_of_cycle,
    numbers_of_orbit,
    orbit_curve,
)
from zeno_orbits.integrators.flow import Tolerance
from zeno_orbits.model.declared.rig_parts import Contact, Controller, PwmSettings, Rig
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.problem import Problem
from zeno_orbits.orbits.orbit import Orbit
from zeno_orbits.orbits.orbit_file import read_orbit
from zeno_orbits.search import orbit_by_shooting

FINE = RigSettings(tolerance=Tolerance(relative=1e-12, absolute=1e-14))
LOOSE = RigSettings(tolerance=Tolerance(relative=1e-11, absolute=1e-13))
COARSE = RigSettings(tolerance=Tolerance(relative=1e-8, absolute=1e-10))
PHASES = 4
"""Stiffnesses for every factor 1/e^2, over which the end of the chatter repeats itself."""
QUIET = 0.05
"""After the start of a lock, and before its end, what it began with does not count [s]."""
MISS, CLEAR = 0.02, 1e-3
"""An order may miss theory by this much, and numerical error be this part of a distance."""
CYCLES = 5
"""Cycles of which a distance is the median."""
TAIL = 3.0
"""Decades at the stiff end over which orders are fitted a second time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitDistance:
    """Distances of a machine's cycle from the Zeno orbit of its model; differences are signed.

    Attributes:
        impact_time: First contact less first impact, from release [s].
        impact_rate: Gap rate at the first contact less that at the first impact.
        lock_time: End of the chatter less Zeno time, from release [s].
        lock_angle: The same difference of the coordinate whose amplitude the problem measures.
        release: Largest difference of a state at release, over the state's range on the orbit.
        period: Of the cycle less that of the orbit [s].
        portrait: Largest distance of a point of the cycle from the orbit's curve, resets included
            as straight lines, in states over their ranges.
    """

    impact_time: float
    impact_rate: float
    lock_time: float
    lock_angle: float
    release: float
    period: float
    portrait: float


def orbit_distance(
    orbit: Orbit, problem: Problem, curve: OrbitCurve, settled: SettledRig
) -> OrbitDistance:
    """Return how far the last cycle of a settled machine is from its orbit.

    Args:
        orbit: The orbit.
        problem: Its problem.
        curve: The orbit as a line.
        settled: The machine.
    """
    cycle = settled.cycles[-1]
    known, wanted = asdict(numbers_of_cycle(cycle, problem)), numbers_of_orbit(orbit, problem)
    released = np.array(problem.state_vector(orbit.release_state))
    moved = cycle.end_state[: len(released)] - released
    states = settled.run.between(cycle.release, cycle.end).states[:, : len(problem.state_names)]
    return OrbitDistance(
        **{name: known[name] - value for name, value in asdict(wanted).items()},
        release=float(np.max(np.abs(moved) / curve.ranges)),
        portrait=float(np.max(curve.distances(states))),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """A distance over stiffnesses, fitted by a power.

    Attributes:
        order: :math:`p`.
        error: Standard error of it.
        coefficient: :math:`c`.
        scatter: Root mean square of what is left of ``log d``.
    """

    order: float
    error: float
    coefficient: float
    scatter: float


def fit_order(stiffnesses: Sequence[float], distances: Sequence[float]) -> Order:
    r"""Fit :math:`|d| = c\,k^{-p}` by least squares of the logarithms.

    Args:
        stiffnesses: Three at least.
        distances: Not zero.

    Raises:
        ValueError: If there are too few, or one is zero.
    """
    k, d = np.log(np.asarray(stiffnesses)), np.abs(np.asarray(distances))
    if len(k) < 3 or len(k) != len(d):
        raise ValueError(
            "Argument `distances` must hold one for each of three or more stiffnesses."
        )
    if not np.all(d > 0.0):
        raise ValueError("Argument `distances` must not hold zero: it has no logarithm.")
    away, y = k - k.mean(), np.log(d)
    slope = float(away @ y / (away @ away))
    left = y - y.mean() - slope * away
    spread = float(left @ left)
    return Order(
        order=-slope,
        error=float(np.sqrt(spread / (len(k) - 2) / (away @ away))),
        coefficient=float(np.exp(y.mean() - slope * k.mean())),
        scatter=float(np.sqrt(spread / len(k))),
    )


Row = Mapping[str, float]
NAMES = tuple(field.name for field in fields(OrbitDistance))


def sweep(
    orbit: Orbit,
    problem: Problem,
    curve: OrbitCurve,
    exponent: float,
    stiffnesses: Sequence[float],
) -> tuple[list[Row], list[Row]]:
    """Return distances over stiffnesses, medians of settled cycles, and their numerical errors.

    The error is what tolerances ten times looser change, or the median difference of a cycle
    from the middle one, whichever is more. Periods of single cycles scatter
    by up to 4e-12 s at 1e6 N m/rad, and by up to 1e-9 s at 8e7.
    """
    rows: list[Row] = []
    errors: list[Row] = []
    for stiffness in stiffnesses:
        rig = Rig(contact=Contact(stiffness=stiffness, exponent=exponent))
        fine, loose = (
            settle_rig(orbit, problem, rig, cycles=CYCLES, settle=7, settings=settings)
            for settings in (FINE, LOOSE)
        )
        row, spread = middle(orbit, problem, curve, fine)
        other, _ = middle(orbit, problem, curve, loose)
        rows.append(row)
        errors.append({name: max(abs(row[name] - other[name]), spread[name]) for name in row})
        shown = "  ".join(f"{value:10.3e}" for value in row.values())
        print(f"{stiffness:9.2e}  {fine.cycles[-1].impacts:3d}  {shown}", flush=True)
    return rows, errors


def of_each(orbit: Orbit, problem: Problem, curve: OrbitCurve, settled: SettledRig) -> list[Row]:
    """Return the distances of each cycle."""
    return [
        asdict(orbit_distance(orbit, problem, curve, replace(settled, cycles=(cycle,))))
        for cycle in settled.cycles
    ]


def middle(
    orbit: Orbit, problem: Problem, curve: OrbitCurve, settled: SettledRig
) -> tuple[Row, Row]:
    """Return the medians of the distances of cycles, and their median differences from these."""
    found = of_each(orbit, problem, curve, settled)
    medians = {name: float(np.median([row[name] for row in found])) for name in NAMES}
    spread = {
        name: float(np.median([abs(row[name] - medians[name]) for row in found])) for name in NAMES
    }
    return medians, spread


def show_orders(
    stiffnesses: Sequence[float], rows: Sequence[Row], errors: Sequence[Row], expected: Row
) -> bool:
    """Print the fitted orders over all stiffnesses and over the stiff end.

    Returns:
        Whether those that a power fits are what theory (6.6) says, far above the numerical error.
    """
    sound = True
    stiff = [k >= stiffnesses[-1] / 10**TAIL * 0.999 for k in stiffnesses]
    print(
        f"\n{'distance':>12}  order, all      order, last {TAIL:.0f} decades   expected   scatter"
        "   error / distance, at most"
    )
    for name in rows[0]:
        values = [row[name] for row in rows]
        whole = fit_order(stiffnesses, values)
        end = fit_order(
            [k for k, kept in zip(stiffnesses, stiff, strict=True) if kept],
            [v for v, kept in zip(values, stiff, strict=True) if kept],
        )
        worst = max(e[name] / abs(r[name]) for e, r in zip(errors, rows, strict=True))
        if name not in (*REPEATING, "portrait"):
            sound &= abs(end.order - expected[name]) < MISS and worst < CLEAR
        print(
            f"{name:>12}  {whole.order:.4f} ({whole.error:.4f})   {end.order:.4f} ({end.error:.4f})"
            f"          {expected[name]:.4f}    {whole.scatter:7.4f}   {worst:.1e}"
        )
    return sound


def show_chatter(
    stiffnesses: Sequence[float], rows: Sequence[Row], e: float, inertia: float
) -> None:
    """Compare the end of the chatter with its law: one more contact for every factor 1/e^2."""
    lasting, left = spring_contact(e, 0.0)
    load = 1e-4
    slower = (left - spring_contact(e, load)[1]) / (load * lasting)
    expected = lasting * math.sqrt(inertia) * (1 - 2 * slower / (1 - e))
    print(
        f"\nend of the chatter: from k to k/e^2 there is one contact more; a contact lasts "
        f"{lasting:.5f} sqrt(m_n/k),\nand leaves {slower:.5f} of what a load would do in it "
        f"behind its restitution, so lock_time sqrt(k) should grow by {expected:.5f}"
    )
    scaled = [row["lock_time"] * math.sqrt(k) for row, k in zip(rows, stiffnesses, strict=True)]
    for at in range(len(scaled) - PHASES):
        print(f"   from k = {stiffnesses[at]:9.2e}: by {scaled[at + PHASES] - scaled[at]:.5f}")


def spring_contact(e: float, load: float) -> tuple[float, float]:
    """Return how long a contact of unit speed, inertia and stiffness lasts, and how fast it ends.

    Args:
        e: The restitution that it is damped for.
        load: A constant force that presses into the stop.
    """
    from scipy.integrate import solve_ivp

    from zeno_orbits.experiment.rig import damping_number

    number = damping_number(e)

    def out(_t: float, y: Sequence[float]) -> float:
        return y[0] if y[1] < 0.0 else 1.0

    out.terminal = True
    motion = solve_ivp(
        lambda _t, y: (y[1], -y[0] * (1 + number * y[1]) + load),
        (0.0, 50.0),
        (0.0, 1.0),
        method="DOP853",
        events=out,
        rtol=1e-12,
        atol=1e-14,
    )
    return float(motion.t_events[0][-1]), -float(motion.y_events[0][-1][1])


def show_portrait(orbit: Orbit, problem: Problem) -> None:
    """Print how the distance of the portrait comes to its order, far beyond any real stop."""
    curve = orbit_curve(orbit, problem, n_per_arc=4000)
    settings = RigSettings(tolerance=Tolerance(relative=1e-11, absolute=1e-14))
    print("\nportrait, force ~ penetration: order over a decade, and where in the first contact")
    last = math.nan
    for k in 10.0 ** np.arange(3, 12):
        rig = Rig(contact=Contact(stiffness=float(k)))
        settled = settle_rig(orbit, problem, rig, cycles=1, settle=4, settings=settings)
        away = curve.distances(settled.run.states)
        at, touch = int(np.argmax(away)), settled.cycles[0].impact
        part = (settled.run.times[at] - touch.start) / (touch.end - touch.start)
        order = math.log10(last / away[at])
        print(f"   k = {k:.0e}: {away[at]:.3e}  order {order:6.3f}  at {part:.2f}", flush=True)
        last = float(away[at])


def alone(problem: Problem) -> dict[str, Rig]:
    """Return rigs of one part each on a stiff stop, with the problem's numbers, and one of all."""
    full = default_rig(problem)
    stiff = Rig(contact=Contact(stiffness=1e6))
    bridge, controller, sensors = full.bridge, full.controller, full.sensors
    assert bridge is not None
    assert controller is not None
    assert sensors is not None
    sampled = Controller(period=controller.period)
    bare = replace(bridge, resistance=0.0, dead_time=0.0, diode_drop=0.0)
    return {
        "stiff stop": stiff,
        "soft ball": Rig(contact=full.contact),
        "friction": replace(stiff, friction=full.friction),
        "gear": replace(stiff, gears=full.gears),
        "gear, no play": replace(
            stiff, gears={k: replace(gear, play=0.0) for k, gear in full.gears.items()}
        ),
        "supply 12 V": replace(stiff, bridge=bare),
        "supply 5 V": replace(stiff, bridge=replace(bare, supply=5.0)),
        "MOSFETs": replace(stiff, bridge=replace(bare, resistance=bridge.resistance)),
        "dead time": replace(stiff, bridge=replace(bridge, resistance=0.0)),
        "dead time, exact": replace(
            stiff, bridge=replace(bridge, resistance=0.0, switching=PwmSettings.EXACT)
        ),
        "pulses, exact": replace(stiff, bridge=replace(bare, switching=PwmSettings.EXACT)),
        "sampling 1 kHz": replace(stiff, controller=sampled),
        "delay 1 ms": replace(stiff, controller=controller),
        "delay 5 ms": replace(stiff, controller=replace(controller, delay=5e-3)),
        "delay 10 ms": replace(stiff, controller=replace(controller, delay=10e-3)),
        "rounding": replace(
            stiff, controller=sampled, sensors=replace(sensors, noise=0.0, filter_time=0.0)
        ),
        "filter 2 ms": replace(
            stiff, controller=sampled, sensors=replace(sensors, noise=0.0, resolution=0.0)
        ),
        "noise": replace(
            stiff, controller=sampled, sensors=replace(sensors, resolution=0.0, filter_time=0.0)
        ),
        "soft ball, gear": Rig(contact=full.contact, gears=full.gears),
        "all": full,
    }


def show_alone(orbit: Orbit, problem: Problem, curve: OrbitCurve) -> None:
    """Print what each part does by itself, and where in the cycle the machine is farthest."""
    print(
        f"\n{'part':>18}  {'period':>9}  {'impact':>9}  {'rate':>7}  {'lock':>9}  {'angle':>8}"
        f"   {'apex':>9}  portrait of link 1: flight, chatter, lock [%]  ripple [%]  "
        "breaks   CPU/cycle  farthest"
    )
    for name, rig in alone(problem).items():
        begun = time.process_time()
        few = rig.bridge is not None and rig.bridge.switching is PwmSettings.EXACT
        settle, cycles = (4, 1) if few else (8, 4)
        settled = settle_rig(orbit, problem, rig, cycles=cycles, settle=settle, settings=COARSE)
        spent = (time.process_time() - begun) / (settle + cycles + 1)
        rows = of_each(orbit, problem, curve, settled)
        mean = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
        where, turn = profile(problem, curve, orbit, settled)
        parts = "  ".join(f"{100 * away:6.2f}" for away in where.values())
        print(
            f"{name:>18}  {1e3 * mean['period']:+9.3f}  {1e3 * mean['impact_time']:+9.3f}  "
            f"{mean['impact_rate']:+7.3f}  {1e3 * mean['lock_time']:+9.3f}  "
            f"{1e3 * mean['lock_angle']:+8.2f}   {turn[0]:+9.3f}  {parts}"
            f"   {100 * ripple(settled):22.2f}  {breaks(settled):6d}   {spent:6.2f} s   {turn[1]}",
            flush=True,
        )
    print("times in ms, gap rates in rad/s, angles in mrad; differences from the orbit")
    print(f"ripple: of the contact force from {1e3 * QUIET:.0f} ms into the lock on, over its mean")


def breaks(settled: SettledRig) -> int:
    """Return how often the contact of a lock is lost and found again, over all cycles."""
    starts = [touch.start for touch in settled.run.touches]
    return sum(cycle.lock < at < cycle.end for cycle in settled.cycles for at in starts)


def ripple(settled: SettledRig) -> float:
    """Return how much the contact force of a lock vibrates, less a smooth curve through it."""
    cycle = settled.cycles[-1]
    run = settled.run.between(cycle.lock + QUIET, cycle.end - QUIET)
    smooth = np.polynomial.Polynomial.fit(run.times, run.contact_force, 6)
    return float(np.std(run.contact_force - smooth(run.times)) / np.mean(run.contact_force))


def profile(
    problem: Problem, curve: OrbitCurve, orbit: Orbit, settled: SettledRig
) -> tuple[dict[str, float], tuple[float, str]]:
    """Return the largest distance in the portrait of link 1 in each part of a cycle.

    And how much later the link turns round in flight than on the orbit [ms], and where the machine
    is farthest.
    """
    cycle = settled.cycles[-1]
    run = settled.run.between(cycle.release, cycle.end)
    pair = [problem.state_names.index(name) for name in problem.portraits[0]]
    plane = OrbitCurve(times=curve.times, states=curve.states[:, pair], ranges=curve.ranges[pair])
    t = run.times - cycle.release
    away = np.where(
        run.in_contact & (t < cycle.lock - cycle.release), 0.0, plane.distances(run.states[:, pair])
    )
    flight = t < cycle.impact.start - cycle.release
    locked = t >= cycle.lock - cycle.release
    parts = {"flight": flight, "chatter": ~flight & ~locked, "lock": locked}
    where = {name: float(np.max(away[inside], initial=0.0)) for name, inside in parts.items()}
    at = int(np.argmax(away))
    angle, rate = run.states[at, pair]
    turning = abs(rate) < 0.15 * float(np.max(np.abs(curve.states[:, pair[1]])))
    place = f"t/T = {t[at] / cycle.period:.2f}, {angle:+.2f} rad, {rate:+5.2f} rad/s"
    mine = _turn(t[flight], run.states[flight, pair[1]])
    before = curve.times < orbit.impacts[0].time
    ideal = _turn(curve.times[before], curve.states[before, pair[1]])
    return where, (1e3 * (mine - ideal), place + (", at the apex" if turning else ""))


def _turn(times: Sequence[float], rates: Sequence[float]) -> float:
    """Return when a rate first changes its sign, between two records."""
    for k in range(1, len(times)):
        if (rates[k - 1] < 0.0) != (rates[k] < 0.0):
            part = rates[k - 1] / (rates[k - 1] - rates[k])
            return float(times[k - 1] + part * (times[k] - times[k - 1]))
    return math.nan


def main() -> int:
    """Print the tables, and draw the picture if it is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("orbit", nargs="?", type=Path, help="by default found anew")
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--points", type=int, default=17, help="stiffnesses of a sweep")
    parser.add_argument("--only", choices=("orders", "portrait", "parts"))
    options = parser.parse_args()
    problem = load_problem("motor_pendulum")
    orbit = (
        read_orbit(options.orbit)
        if options.orbit
        else orbit_by_shooting(problem, problem.values()).unwrap()
    )
    curve = orbit_curve(orbit, problem)
    sound = True
    if options.only in {None, "orders"}:
        sound = orders(orbit, problem, curve, options.points, options.picture)
    if options.only in {None, "portrait"}:
        show_portrait(orbit, problem)
    if options.only in {None, "parts"}:
        show_alone(orbit, problem, curve)
    return 0 if sound else 1


def orders(
    orbit: Orbit, problem: Problem, curve: OrbitCurve, points: int, picture: Path | None
) -> bool:
    """Print both sweeps with their orders, draw them, and tell whether theory holds."""
    sound = True
    head = "  ".join(f"{name:>10}" for name in NAMES)
    e = orbit.parameters["restitution"]
    drawn: dict[float, tuple[list[float], list[Row], list[Row]]] = {}
    for exponent, softest in ((1.0, 1e3), (1.5, 1e4)):
        stiffnesses = [softest * e ** (-2 * k / PHASES) for k in range(points)]
        contact, release = 1 / (exponent + 1), 1 / (3 * exponent - 1)
        expected = dict.fromkeys(NAMES, contact)
        if exponent > 1.0:
            expected |= {"impact_time": release, "release": release}
        print(f"\nforce ~ penetration^{exponent:g}\n{'k':>9}  imp  {head}")
        rows, errors = sweep(orbit, problem, curve, exponent, stiffnesses)
        sound &= show_orders(stiffnesses, rows, errors, expected)
        if exponent == 1.0:
            show_chatter(stiffnesses, rows, e, normal_inertia(orbit, problem))
        drawn[exponent] = (stiffnesses, rows, errors)
    if picture is not None:
        draw(drawn, picture)
    return sound


def normal_inertia(orbit: Orbit, problem: Problem) -> float:
    """Return the inertia that the impacts of an orbit feel, at its Zeno point."""
    dynamics = problem.dynamics(orbit.values(problem))
    return dynamics.normal_inertia(np.array(problem.state_vector(orbit.zeno_state)))


REPEATING = ("lock_time", "lock_angle")
"""They go up and down with every contact more, and through zero: no power fits them."""
LABELS = {
    "period": ("period [s]", "o", "#0072B2"),
    "impact_time": ("first impact [s]", "s", "#D55E00"),
    "impact_rate": ("gap rate there [rad/s]", "^", "#009E73"),
    "lock_time": ("end of chatter [s]", "D", "#CC79A7"),
    "lock_angle": ("locked angle [rad]", "v", "#E69F00"),
    "release": ("release state [range]", "P", "#56B4E9"),
    "portrait": ("portrait [range]", "X", "#333333"),
}


def draw(sweeps: Mapping[float, tuple[list[float], list[Row], list[Row]]], path: Path) -> None:
    """Draw the distances over the stiffness, the fits, and the numerical error below them."""
    from zeno_orbits.report.plots.panels import panels_of
    from zeno_orbits.report.plots.style import FULL_WIDTH, save_figure

    panels = panels_of(FULL_WIDTH, len(sweeps), height=3.4, columns=2)
    for ax, (exponent, (stiffnesses, rows, errors)) in zip(panels, sweeps.items(), strict=True):
        for name, (label, marker, colour) in LABELS.items():
            values = np.array([abs(row[name]) for row in rows])
            ax.plot(stiffnesses, values, ls="", marker=marker, ms=3.5, color=colour, label=label)
            if name in REPEATING:
                ax.plot(stiffnesses, values, color=colour, lw=0.6, ls=(0, (1, 2)))
                continue
            fit = fit_order(stiffnesses, values.tolist())
            line = fit.coefficient * np.array(stiffnesses) ** -fit.order
            ax.plot(stiffnesses, line, color=colour, lw=0.8)
        worst = [max(error[name] for name in NAMES if name != "portrait") for error in errors]
        ax.plot(
            stiffnesses,
            worst,
            color="#999999",
            lw=1.0,
            ls=":",
            label="largest numerical error, portrait excluded",
        )
        ax.set_xscale("log")
        ax.set_yscale("log")
        unit = "N m/rad" if exponent == 1.0 else f"N m/rad$^{{{exponent:g}}}$"
        law = r"$k\,\delta$" if exponent == 1.0 else rf"$k\,\delta^{{{exponent:g}}}$"
        ax.set_xlabel(f"stiffness $k$ [{unit}], force {law}")
        ax.set_ylabel("distance from the Zeno orbit")
    save_figure(panels.finished(), path)
    print(f"Written: {path}")


if __name__ == "__main__":
    sys.exit(main())
