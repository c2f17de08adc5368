"""Nonsense at every parameter of every public name: one line that names the argument.

The calls are made from the signatures, so a new function or class is covered when it is public.
"""

from __future__ import annotations

import inspect
import random
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.chores import square
from tests.support.orbits import event_orbit, shot_orbit

NONSENSE: tuple[Any, ...] = (
    *(None, "", "no such thing", "\0", "a\nb", b"x", True, -1, 0, 3, -2.5, 1e308, 10**400),
    *(float("nan"), float("inf"), 1j, Decimal("NaN"), object(), int, len, Path("no/such")),
    *([], (), {}, [1, 2], ("a", "b"), [None], {"x": None}, {1: 2}, {"a": {}}, [[1.0], [2.0, 3.0]]),
    *(np.array([]), np.zeros((2, 3)), np.array(["a"]), np.array([np.nan]), np.float64(-3.0)),
    *(ca.SX.sym("s"), ca.SX.sym("m", 2, 3), ca.MX.sym("x"), ca.DM([1, 2]), ca.SX(0, 0)),
)


class _ReportedError(Exception):
    """Ends a sound computation at its first report."""


def _end(_stage: str, _part: float | None = None, /) -> None:
    raise _ReportedError


Q, V = ca.SX.sym("q"), ca.SX.sym("v")
CURRENT, STATE = ca.SX.sym("i"), ca.SX.sym("z")


@cache
def mechanism() -> zo.HybridLagrangian:
    return zo.HybridLagrangian.from_energies(q=Q, v=V, kinetic=V**2 / 2, potential=Q, gap=Q)


@cache
def ball() -> zo.Problem:
    return zo.load_problem("bouncing_ball")


@cache
def motion() -> zo.Execution:
    return zo.simulate(ball(), until=0.5)


@cache
def orbit() -> zo.Orbit:
    return shot_orbit("motor_pendulum")


@cache
def families() -> zo.Continuation:
    return zo.continue_orbit(orbit(), ("Kd", -1.0001, -0.9999))


@cache
def events() -> zo.Orbit:
    return event_orbit("sampled_pendulum")


@cache
def certificate() -> zo.OrbitCertificate:
    return zo.verify(orbit())


@cache
def run() -> zo.RigRun:
    return zo.simulate_rig(ball(), until=0.01)


@cache
def samples() -> zo.Recording:
    return zo.sample_execution(ball(), motion())


@cache
def stability() -> zo.Stability:
    return zo.floquet_multipliers(orbit())


@cache
def returns() -> zo.ReturnMap:
    return zo.return_map(orbit())


@cache
def held() -> zo.Feedback:
    return zo.design_feedback(orbit(), ["Kd"])


def numbers() -> zo.ParameterValues:
    return ball().values()


def shape() -> zo.EventSequence:
    return zo.EventSequence.parsed("zeno")


def system(symbols: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    return zo.hybrid_system(mechanism(), zo.no_drive(mechanism()), symbols["restitution"])


def bank() -> zo.MotorBank:
    one = ca.SX(1)
    return zo.MotorBank(
        selection=one,
        resistance=one,
        inductance=one,
        torque_constant=one,
        emf_constant=one,
        voltage=-V,
    )


def circuit() -> zo.Circuit:
    return zo.Circuit(
        currents=CURRENT, coenergy=CURRENT**2 * (1 + Q), resistance=ca.SX(1), source=ca.SX(2)
    )


SOUND: dict[str, Callable[[], Any]] = {
    "problem": ball,
    "orbit": orbit,
    "execution": motion,
    "first": motion,
    "second": motion,
    "recording": samples,
    "spread": lambda: {"restitution": 0.07},
    "run": run,
    "certificate": certificate,
    "dynamics": lambda: ball().dynamics(ball().values()),
    "figure": lambda: zo.plot(motion()),
    "path": lambda: Path("file.png"),
    "name_or_path": lambda: "bouncing_ball",
    "data": lambda: orbit().as_json(),
    "parameter": lambda: ("Kd", -1.1, -0.9),
    "x": lambda: ("g", 5.0, 10.0, 2),
    "y": lambda: ("m", 1.0, 2.0, 2),
    "fit": lambda: ["restitution"],
    "accuracy": lambda: 1e-3,
    "result": motion,
    "task": lambda: square,
    "points": lambda: [1.0, 2.0],
    "plan": lambda: zo.ExecutionPlan(place=zo.Workers(count=1)),
    "lagrangian": mechanism,
    "mechanism": mechanism,
    "motors": bank,
    "circuit": circuit,
    "selection": lambda: ca.SX(1),
    "torque": lambda: -V,
    "drive": lambda: zo.no_drive(mechanism()),
    "restitution": lambda: 0.5,
    "clock": lambda: zo.Clock.at(ca.SX(2.0)),
    "levels": lambda: [0.0, 1.0],
    "times": lambda: [1.0],
    "knots": lambda: [0.0, 1.0],
    "values": lambda: [1.0, 2.0],
    "time": lambda: [0.0, 1.0],
    "samples": lambda: [1.0, 2.0],
    "column": lambda: "ground",
    "amplitudes": lambda: [(1.0, 0.0)],
    "frequency": lambda: ca.SX(2.0),
    "cosine": lambda: ca.SX.sym("c"),
    "sine": lambda: ca.SX.sym("s"),
    "q": lambda: Q,
    "v": lambda: V,
    "kinetic": lambda: V**2 / 2,
    "potential": lambda: Q,
    "gap": lambda: Q,
    "mass_matrix": lambda: ca.SX(1),
    "coriolis": lambda: ca.SX(0),
    "gravity": lambda: ca.SX(1),
    "states": lambda: STATE,
    "rate": lambda: -STATE,
    "currents": lambda: CURRENT,
    "coenergy": lambda: CURRENT**2,
    "resistance": lambda: ca.SX(1),
    "source": lambda: ca.SX(1),
    "inductance": lambda: ca.SX(1),
    "torque_constant": lambda: ca.SX(1),
    "emf_constant": lambda: ca.SX(1),
    "voltage": lambda: -V,
    "guard": lambda: Q - 1,
    "name": lambda: "one",
    "unit": lambda: "m",
    "meaning": lambda: "a length",
    "default": lambda: 0.5,
    "phrase": lambda: "is over",
    "beyond": lambda: 2.0,
    "formula": lambda: lambda _states, _symbols: Q,
    "target": lambda: 1.0,
    "state": lambda: "theta1",
    "signal": lambda: "theta1",
    "delta": lambda: 0.1,
    "address": lambda: "tcp://127.0.0.1:1",
    "supply": lambda: 12.0,
    "period": lambda: 1.0,
    "rotor_inertia": lambda: 1.0,
    "text": lambda: "zeno",
    "phases": lambda: zo.EventSequence.parsed("zeno").phases,
    "gains": dict,
    "parameters": dict,
}
"""Sound values of parameters without a default, by name."""

OWN: dict[str, dict[str, Callable[[], Any]]] = {
    "simulate_periods": {"orbit": events},
    "largest_push": {"orbit": lambda: replace(orbit(), period=1.0)},
    "with_certificate": {"orbit": orbit},
    "write_orbit": {"orbit": events, "path": lambda: Path("file.json")},
    "write_recording": {"path": lambda: Path("file.csv")},
    "orbit_from_json": {"path": lambda: Path("file.json")},
    "check_proof": {"certificate": lambda: Path("no.json")},
    "check_branch": {"certificate": lambda: Path("no.json")},
    "prove_branch": {"branch": lambda: ("g", 9.0, 10.0)},
    "simulate": {"problem": ball},
    "find_orbit": {"problem": lambda: "motor_pendulum"},
    "find_orbit_by_shooting": {"problem": lambda: "motor_pendulum"},
    "search_gains": {"problem": lambda: "motor_pendulum"},
    "explore": {"problem": lambda: "motor_pendulum"},
    "HybridLagrangian": {
        **{name: (lambda: ca.SX(0)) for name in ("bias", "passive_force", "applied_force")},
        "holonomic": lambda: ca.SX(0, 1),
    },
    "table": {"x": lambda: Q},
    "record": {"period": lambda: None},
    "read_record": {"path": lambda: Path("no.csv")},
    "design_feedback": {"inputs": lambda: ["Kd"]},
    "stabilize": {"found": families, "inputs": lambda: ["g"]},
    "hold_inputs": {
        "inputs": lambda: {"g": None},
        "at": lambda: "impact stop",
        "gain": lambda: {"g": {"v": 0.1}},
        "centre": lambda: {"v": 1.0},
    },
    "DryFriction": {
        "name": lambda: "pad",
        "rate": lambda: ca.SX.sym("v"),
        "torque": lambda: 1.0,
        "static": lambda: None,
    },
    "Hold": {
        "states": lambda: ca.SX.sym("u"),
        "at": lambda: "zeno stop",
        "after": lambda: ca.SX(1.0),
    },
    "scatter": {"spread": lambda: {"restitution": 0.01}},
    "NearestGains": {"target": lambda: {"Kp": 2.0}},
    "Problem": {
        "name": lambda: "ball",
        "title": lambda: "a ball",
        "source": lambda: "",
        "state_names": lambda: ("q", "v"),
        "state_units": lambda: ("m", "m/s"),
        "parameters": lambda: (zo.Quantity.restitution(0.5),),
        "gains": tuple,
        "model": lambda: system,
        "starts": lambda: ({"q": 1.0},),
        "portraits": lambda: (("q", "v"),),
        "amplitude_of": lambda: "q",
    },
}
"""Sound values of single functions and classes."""

RESULTS = (
    *("CompletedSystem", "Comparison", "Continuation", "EnclosedEvent", "EventComparison"),
    *("Orbit", "Execution", "ExecutionWithError", "Family"),
    *("Identification", "OrbitCertificate", "ParameterMap", "PeriodEnclosure", "Proof"),
    *("BranchProof", "BranchVerdict"),
    *("ProofVerdict", "Pushes", "Recording", "Recovery", "RigRun", "SearchResult", "SwitchEvent"),
    *(
        "Feedback",
        "HeldFamilies",
        "HeldMotion",
        "HeldPoint",
        "LoopCorner",
        "ReturnMap",
        "ReturnSlopes",
        "Scatter",
        "Stability",
    ),
    *("LawComparison", "LawFit", "SearchMethod", "TransientComparison", "TransientFit"),
    *(
        "WorkPrecision",
        "ZenoCondition",
        "Orbit",
        "Drawing",
        "Record",
        "SpecialPointKind",
        "PwmSettings",
    ),
)
"""Results, which functions make, and names that are not called."""


METHODS: dict[Callable[[], Any], dict[str, dict[str, Callable[[], Any]]]] = {
    motion: {
        "state_at": {"time": lambda: 0.1},
        "states_at": {"times": lambda: [0.1]},
        "sampled": {},
        "returns": {"period": lambda: 0.1},
    },
    orbit: {
        "values": {"problem": lambda: zo.load_problem("motor_pendulum")},
        "machine": {"problem": lambda: zo.load_problem("motor_pendulum")},
        "with_phases": {"phases": lambda: orbit().phases},
    },
    samples: {"signal": {"name": lambda: samples().names[0]}},
    run: {
        "of": {"name": lambda: run().state_names[0]},
        "between": {"start": lambda: 0.0, "end": lambda: 0.005},
    },
    stability: {"periods_to": {"part": lambda: 0.1}, "time_to": {"part": lambda: 0.1}},
    returns: {
        **{name: {"x": lambda: returns().fixed_point} for name in ("map", "slopes", "state")},
        "jvp": {"x": lambda: returns().fixed_point, "change": lambda: np.zeros(3)},
        "vjp": {"x": lambda: returns().fixed_point, "weights": lambda: np.zeros(3)},
        "point": {"state": lambda: returns().state(returns().fixed_point)},
        "moves_section": {"name": lambda: "Kd"},
        "size_of": {"name": lambda: "Kd"},
    },
    held: {
        "inputs_at": {"x": lambda: returns().fixed_point},
        "run": {"x": lambda: returns().fixed_point, "n": lambda: 1},
        "extent": {"coordinate": lambda: returns().coordinates[0]},
    },
    ball: {
        **{
            name: {"values": lambda: ball().values()}
            for name in (
                *("dynamics", "graph_dynamics", "system", "first_system", "shared"),
                *("require_zeno_points", "admissible_starts"),
            )
        },
        **{
            name: {"values": lambda: ball().values(), "states": lambda: np.zeros((1, 2))}
            for name in ("output_values", "drawn_lines", "inverse_masses")
        },
        "values": {},
        "initial_state": {},
        "state_vector": {"named": dict},
        "impulse_unit": {"unit": lambda: "m"},
        "at_fidelity": {"word": lambda: "point"},
        "quantity": {"name": lambda: "m"},
        "place": {"name": lambda: "m"},
        "require_range": {"name": lambda: "m", "box": lambda: (1.0, 2.0)},
    },
    numbers: {"number": {"name": lambda: "m"}, "replaced": {"numbers": dict}},
    zo.SearchSettings: {"for_accuracy": {"accuracy": lambda: 1e-3}},
    shape: {"agreed": {"wanted": shape}, "at_restitution": {"restitution": lambda: 0.5}},
}
"""Methods of results, by the function that makes one, with sound values of their parameters."""


@dataclass(frozen=True)
class Door:
    """A public function or class, or a method that makes one.

    Attributes:
        name: Its name.
        call: The object.
        sound: Sound values of its parameters that have no default.
    """

    name: str
    call: Callable[..., Any]
    sound: dict[str, Callable[[], Any]]


@cache
def doors() -> tuple[Door, ...]:
    found: dict[str, Callable[..., Any]] = {}
    for name in zo.__all__:
        one = getattr(zo, name)
        if name in RESULTS or not callable(one):
            continue
        if inspect.isclass(one):
            if issubclass(one, BaseException):
                continue
            for key, entry in vars(one).items():
                if isinstance(entry, classmethod) and key[0] != "_":
                    found[f"{name}.{key}"] = getattr(one, key)
        found[name] = one
    doors = list[Door]()
    for name, call in found.items():
        own = OWN.get(name, {})
        known = inspect.signature(call).parameters
        needed = [key for key, one in known.items() if one.default is one.empty]
        sound = {key: own[key] if key in own else SOUND[key] for key in needed}
        if "on_progress" in known:
            sound["on_progress"] = lambda: _end
        doors.append(Door(name, call, sound))
    for make, methods in METHODS.items():
        for name, sound in methods.items():
            one = make()
            doors.append(Door(f"{type(one).__name__}.{name}", getattr(one, name), sound))
    return tuple(doors)


def places() -> list[tuple[Door, str]]:
    """Return every parameter of every door."""
    return [(door, key) for door in doors() for key in inspect.signature(door.call).parameters]


CALLED = ("on_progress", "on_estimate", "task", "formula", "model", "derive", "drawing")
"""Arguments that are functions of the caller."""


def ask(door: Door, key: str, bad: Any) -> str:
    """Call a door with nonsense at one parameter, and return what is wrong with its answer."""
    if callable(bad) and key in CALLED:
        # A function of the caller raises what it likes.
        return ""
    given = {name: make() for name, make in door.sound.items()}
    given[key] = bad
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            door.call(**given)
    except _ReportedError:
        return ""
    except (ValueError, TypeError) as error:
        told = str(error)
        if "\n" in told or len(told) > 1500:
            return f"it is longer than a line: {told[:200]}"
        if "`" not in told and key not in told:
            return f"it names no argument: {type(error).__name__}: {told}"
    except zo.ZenoOrbitsError as error:
        return f"it has several lines: {error}" if "\n" in str(error) else ""
    except Exception as error:  # noqa: BLE001 (this is what must not happen)
        return f"it raises {type(error).__name__}: {str(error)[:200]}"
    return ""


def failures(calls: list[tuple[Door, str, Any]], folder: Path) -> list[str]:
    """Return what is wrong with the answers to calls, made in an empty folder."""
    found = list[str]()
    for door, key, bad in calls:
        fault = ask(door, key, bad)
        # A text is a sound path. What was written must not be read by another call.
        for file in (path for path in folder.iterdir() if path.is_file()):
            file.unlink()
        if fault:
            found.append(f"{door.name}({key}={str(bad)[:40]!r}): {fault}")
    return found


def test_every_parameter_of_every_public_name_has_a_sound_value() -> None:
    assert len(places()) > 250


@pytest.mark.slow
def test_nonsense_is_refused_in_one_line_that_names_the_argument(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    drawn = random.Random(2026)
    known = places()
    calls = [(*known[k % len(known)], drawn.choice(NONSENSE)) for k in range(400)]
    assert failures(calls, tmp_path) == []


@pytest.mark.slow
@pytest.mark.parametrize("bad", range(len(NONSENSE)))
def test_all_nonsense_is_refused_in_one_line_that_names_the_argument(
    bad: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    calls = [(*place, NONSENSE[bad]) for place in places()]
    assert failures(calls, tmp_path) == []
