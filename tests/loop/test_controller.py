"""The exported controller beside the machine that it controls."""

from __future__ import annotations

import ctypes
import math
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.loop.agreement import needs_compiler
from tests.support.commands import MISUSE, YES, ask
from tests.support.repelling import KD, START
from zeno_orbits.arrays import Vector
from zeno_orbits.loop import controller_files, controller_of, find_compiler
from zeno_orbits.model import Problem

PERSISTS = 0.01
PENDULUM = zo.hold_inputs(
    "motor_pendulum",
    inputs={"Kd": (-1.83, -1.33)},
    at="release stop",
    gain={"Kd": {"dtheta1": 0.636452854509964, "current": 0.10678544280444771}},
    centre={"dtheta1": START["dtheta1"], "current": START["current"]},
    values={"Kp": 2.5, "Kd": KD},
    start={**START, "dtheta1": 1.0005 * START["dtheta1"]},
)


class Controller:
    """The compiled controller of a machine."""

    def __init__(self, problem: Problem, folder: Path, **window: float) -> None:
        values, state = problem.values(), np.array(problem.initial_state())
        exported = controller_of(problem, values, state, persists=PERSISTS, **window)
        for name, text in controller_files(exported).items():
            (folder / name).write_text(text)
        stem, library = f"{problem.name}_controller", folder / "controller.so"
        strict = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off")
        compiler = find_compiler()
        assert compiler is not None
        command = [*compiler.command, *strict, "-O2", "-shared", "-fPIC", f"{stem}.c", "-lm"]
        subprocess.run([*command, "-o", str(library)], cwd=folder, check=True)
        loaded: Any = ctypes.CDLL(str(library))
        self._step = getattr(loaded, f"{problem.name}_step")
        self._step.argtypes = [ctypes.c_void_p, ctypes.c_double, *[ctypes.c_void_p] * 3]
        self._memory = ctypes.create_string_buffer(4096)
        self._held = list(exported.held)
        getattr(loaded, f"{problem.name}_begin")(self._memory)

    def step(self, time: float, x: Vector, contacts: list[bool]) -> tuple[Vector, Vector]:
        """Return the held states and the voltages after a reading."""
        sensors = np.delete(x, self._held)
        touched, voltages = np.array(contacts, dtype=np.int32), np.full(4, np.nan)
        places = (one.ctypes.data for one in (sensors, touched, voltages))
        self._step(self._memory, time, *places)
        held = np.frombuffer(self._memory.raw, dtype=np.float64, count=len(self._held))
        return held, voltages


def readings(run: zo.Execution) -> Iterator[tuple[float, Vector, bool, Vector | None]]:
    """Yield time, state and contact of a motion, and the state after an event that sets states."""
    for arc in run.arcs:
        if not arc.duration > 0.0 or arc.trajectory is None:
            continue
        times = np.linspace(arc.start_time, arc.end_time, 9)[1:]
        for time, x in zip(times.tolist(), arc.states_at(times), strict=True):
            if time < times[-1] or arc.ending.value != "release":
                yield time, x, bool(arc.closed), None
        for event in run.switches:
            if event.time == arc.end_time:
                yield event.time, event.state_minus, False, event.state_plus


@needs_compiler
@pytest.mark.parametrize("periods", [6, pytest.param(100, marks=pytest.mark.slow)])
def test_the_controller_sets_what_the_machine_sets(periods: int, tmp_path: Path) -> None:
    controller = Controller(PENDULUM, tmp_path)
    run = zo.simulate(PENDULUM, until=periods * 2.1102613)
    names = PENDULUM.state_names
    kd, gain, angle = (names.index(one) for one in ("held_Kd", "dtheta1", "theta1"))
    n_set, last = 0, KD
    for time, x, closed, after in readings(run):
        held, voltages = controller.step(time, x, [closed])
        # A Zeno point and dense output round a constant state.
        n_set, last = (n_set, last) if after is None else (n_set + 1, after[kd])
        assert held[0] == last
        assert voltages[0] == -(held[0] * x[gain] + 2.5 * x[angle])
    assert n_set == len(run.releases) >= periods - 1
    # Disturbances decay by a third in a period, down to rounding.
    assert abs(run.switches[-1].state_plus[kd] - KD) < (1e-3 if periods < 10 else 1e-12)


def _after_contact(
    controller: Controller, readings: Any, x: Vector, times: Vector, end: float
) -> float:
    """Return the gain after a contact with these readings of both angles, and its end."""
    for time, angles in zip(times.tolist(), readings, strict=True):
        controller.step(time, np.concatenate([angles, x[2:]]), [True])
    return float(controller.step(end, x, [False])[0][0])


@needs_compiler
@pytest.mark.parametrize("n", [9, 51])
def test_with_a_window_the_law_acts_on_a_parabola_through_readings(n: int, tmp_path: Path) -> None:
    window, period = 0.02, 1e-3
    controller = Controller(PENDULUM, tmp_path, window=window, period=period)
    names, x = PENDULUM.state_names, np.array(PENDULUM.initial_state())
    assert names[:4] == ("theta1", "theta2", "dtheta1", "dtheta2")
    times, rng = 1.0 + period * np.arange(3 * n), np.random.default_rng(n)
    rate, noise = float(START["dtheta1"]), rng.normal(0.0, 1e-4, (3 * n, 2))
    away = times - times[-1]
    exact = np.stack([0.3 + (rate + 0.05) * away + 3 * away**2, 0 * away], axis=1)
    found = _after_contact(controller, exact + noise, x, times, times[-1] + period)
    used, end = times > times[-1] - window - period / 2, times[-1] + period / 2
    fit = np.polynomial.polynomial.polyfit(times[used] - end, (exact + noise)[used, 0], 2)
    shift = 0.636452854509964 * (fit[1] - rate)
    assert abs(shift) > 1e-3
    assert found == pytest.approx(KD - shift, abs=1e-10)
    # Readings of the flight between two contacts are of another parabola.
    for time in end + period * np.arange(1, 30):
        controller.step(float(time), np.concatenate([[7.0, 7.0], x[2:]]), [False])
    times, end = times + 1.0, times[-1] + 1.0 + period / 2
    again = _after_contact(controller, exact, x, times, float(times[-1] + period))
    slope = rate + 0.05 + 6 * period / 2
    assert again == pytest.approx(KD - 0.636452854509964 * (slope - rate), abs=1e-10)


@needs_compiler
def test_with_a_window_the_clock_is_that_of_the_event(tmp_path: Path) -> None:
    centre = {"distance": 0.0, "cosine": 0.2, "sine": -0.4}
    machine = zo.hold_inputs(
        "forced_oscillator",
        inputs={"k": None},
        at="release stop",
        gain={"k": {"distance": 0.0, "cosine": 3.0, "sine": 5.0}},
        centre=centre,
    )
    window, period, k = 0.02, 1e-3, machine.values().number("k")
    names, omega = machine.state_names, machine.values().number("omega")
    places = [names.index(one) for one in ("cosine", "sine")]
    controller = Controller(machine, tmp_path, window=window, period=period)
    x, held = np.array(machine.initial_state()), np.zeros(1)
    for n in range(31):
        time = 0.7 + n * period
        x[places] = math.cos(omega * time), math.sin(omega * time)
        held, _ = controller.step(time, x, [n < 30])
    end = 0.7 + 29.5 * period
    away = 3.0 * (math.cos(omega * end) - 0.2) + 5.0 * (math.sin(omega * end) + 0.4)
    assert held[0] == pytest.approx(k - away, rel=1e-13)
    assert abs(omega * period / 2 * 5.0) > 1e-4


@needs_compiler
def test_a_contact_of_three_readings_sets_nothing_with_a_window(tmp_path: Path) -> None:
    x, times = np.array(PENDULUM.initial_state()), np.array([0.0, 5e-3, 1e-2])
    x[2] = START["dtheta1"] + 0.1
    angles, held = np.zeros((3, 2)), list[float]()
    for window in ({}, {"window": 0.05, "period": 5e-3}):
        folder = tmp_path / str(len(window))
        folder.mkdir()
        held.append(
            _after_contact(Controller(PENDULUM, folder, **window), angles, x, times, 1.5e-2)
        )
    assert held[0] == pytest.approx(KD - 0.0636452854509964, rel=1e-12)
    assert held[1] == KD


@needs_compiler
def test_a_sampled_controller_switches_at_its_samples(tmp_path: Path) -> None:
    problem = zo.load_problem("sampled_pendulum")
    controller = Controller(problem, tmp_path)
    run = zo.simulate(problem, until=2.0)
    samples = [one for one in run.switches if one.name == "sample"]
    assert len(samples) > 10
    place = problem.state_names.index("held")
    for sample in samples:
        before = sample.state_minus.copy()
        # A reading just before the sample, and one just after it.
        sine = problem.state_names.index("sine")
        for shift in (-1e-9, 1e-9):
            before[sine] = shift
            held, voltages = controller.step(sample.time + shift, before, [False])
        assert held[0] == sample.state_plus[place]
        assert voltages[0] == held[0]


def test_the_command_writes_the_controller_of_held_states_alone(tmp_path: Path) -> None:
    out = tmp_path / "out"
    answer = ask("export", "sampled_pendulum", "--controller", "-o", str(out))
    assert answer.code == YES
    assert sorted(path.name for path in out.iterdir()) == [
        "sampled_pendulum_controller.c",
        "sampled_pendulum_controller.h",
    ]
    for arguments, told in (
        (("motor_pendulum", "--controller"), "no event sets a held state of `motor_pendulum`"),
        (
            ("sampled_pendulum", "--controller", "--fmu", "--input", "Kd"),
            "--input: must be left out with `--controller`",
        ),
        (("sampled_pendulum", "--persists", "0.1"), "--persists: belongs to `--controller`"),
        (("sampled_pendulum", "--controller", "--persists", "-1"), "--persists: must be positive"),
        (("sampled_pendulum", "--window", "0.1"), "--window: belongs to `--controller`"),
        (("sampled_pendulum", "--controller", "--window", "0.1"), "--window: needs `--period`"),
        (("sampled_pendulum", "--controller", "--period", "0.1"), "--period: needs `--window`"),
        (
            ("sampled_pendulum", "--controller", "--window", "-1", "--period", "0.1"),
            "--window: must be a positive number",
        ),
        (
            ("sampled_pendulum", "--controller", "--window", "0.1", "--period", "0"),
            "--period: must be a positive number",
        ),
        (
            ("sampled_pendulum", "--controller", "--window", "1e9", "--period", "1e-6"),
            "--window: holds 1e+15 readings",
        ),
        (
            ("sampled_pendulum", "--controller", "--window", "0.01", "--period", "0.004"),
            "must hold at least 4 readings, which are 0.004 s apart",
        ),
    ):
        refused = ask("export", *arguments, "-o", str(tmp_path / "none"))
        assert refused.code == MISUSE
        assert told in refused.err
        assert not (tmp_path / "none").exists()


def test_messages_of_the_export_have_a_remedy(tmp_path: Path) -> None:
    words = ("--controller", "-o", str(tmp_path / "out"))
    answer = ask("export", "motor_pendulum", *words)
    assert answer.code == MISUSE
    assert "`feedback ORBIT --input NAME --machine FILE.py` writes a machine" in answer.err
    answer = ask("export", "sampled_pendulum", *words, "--until", "3")
    assert (answer.code, "--until: must be left out" in answer.err) == (MISUSE, True)
    assert not (tmp_path / "out").exists()
