"""A co-simulation unit gives the execution of `simulate`, in FMPy and by its plain C functions."""

from __future__ import annotations

import ctypes
import math
import subprocess
import zipfile
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import zeno_orbits as zo
from tests.loop.agreement import needs_compiler
from tests.support.cases import often
from tests.support.commands import MISUSE, YES, ask
from tests.support.nested_kinks import FORCES, half_periods, nested_problem
from tests.support.one_stop import GRAPHS, one_stop_problems
from zeno_orbits.simulation import Execution

pytestmark = [needs_compiler, pytest.mark.usefixtures("here")]

STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off")
OK, ERROR = 0, 3

Export = Callable[..., Path]
"""From a problem and options to the file of its unit."""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a folder of the test's own."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def export(tmp_path_factory: pytest.TempPathFactory) -> Export:
    """Return the file of a unit, exported once: a compiler takes seconds."""
    made: dict[tuple[str, ...], Path] = {}

    def exported(name: str, *options: str) -> Path:
        if (name, *options) not in made:
            folder = tmp_path_factory.mktemp("exported")
            made[name, *options] = _exported(folder, name, *options)
        return made[name, *options]

    return exported


def _exported(folder: Path, name: str, *options: str) -> Path:
    """Return the file of a unit. The slow tests compile machines with all optimizations."""
    with pytest.MonkeyPatch.context() as patch:
        if name == "bouncing_ball":
            plain = (
                "-std=c99",
                "-O0",
                "-fPIC",
                "-shared",
                "-fvisibility=hidden",
                "-ffp-contract=off",
            )
            patch.setattr("zeno_orbits.loop.unit.FLAGS", plain)
        answer = ask("export", name, "--fmu", "-o", str(folder), *options)
    assert answer.code == YES, answer.err
    return folder / f"{name}.fmu"


def _unpacked(file: Path) -> tuple[Path, ElementTree.Element]:
    """Return the library of a unit, and its description."""
    folder = file.with_suffix("")
    if not folder.exists():
        with zipfile.ZipFile(file) as whole:
            whole.extractall(folder)
    library = next((folder / "binaries").glob("*/*"))
    return library, ElementTree.parse(folder / "modelDescription.xml").getroot()


_LOG = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)


class Unit:
    """An instance of a unit, by the functions of the standard."""

    def __init__(self, file: Path, token: str | None = None, library: Path | None = None) -> None:
        own, description = _unpacked(file)
        self._library = ctypes.CDLL(str((library or own).absolute()))
        variables = description.find("ModelVariables")
        assert variables is not None
        self._places = {one.attrib["name"]: int(one.attrib["valueReference"]) for one in variables}
        self._kinds = {one.attrib["name"]: one.tag for one in variables}
        self.messages: list[str] = []
        self._log = _LOG(lambda _e, _s, _c, text: self.messages.append(text.decode()))
        create = self._library.fmi3InstantiateCoSimulation
        create.restype = ctypes.c_void_p
        flag = ctypes.c_bool(False)
        chosen = description.attrib["instantiationToken"] if token is None else token
        self.instance = ctypes.c_void_p(
            create(
                *(b"unit", chosen.encode(), b"", flag, flag, flag, flag, None, ctypes.c_size_t(0)),
                *(None, self._log, None),
            )
        )

    def call(self, name: str, *arguments: Any) -> int:
        """Return the status of a function."""
        return int(getattr(self._library, f"fmi3{name}")(self.instance, *arguments))

    def set(self, name: str, value: float) -> int:
        """Set a variable and return the status."""
        place, values = ctypes.c_uint32(self._places[name]), ctypes.c_double(value)
        one = ctypes.c_size_t(1)
        return self.call("SetFloat64", ctypes.byref(place), one, ctypes.byref(values), one)

    def get(self, name: str) -> float:
        """Return a variable."""
        place, one = ctypes.c_uint32(self._places[name]), ctypes.c_size_t(1)
        is_whole = self._kinds[name] == "Int32"
        value = ctypes.c_int32(0) if is_whole else ctypes.c_double(0.0)
        kind = "Int32" if is_whole else "Float64"
        status = self.call(f"Get{kind}", ctypes.byref(place), one, ctypes.byref(value), one)
        assert status == OK, self.messages
        return float(value.value)

    def initialize(self, stop: float) -> int:
        """Go through the initialization and return its status."""
        no, yes, number = ctypes.c_bool(False), ctypes.c_bool(True), ctypes.c_double
        begun = self.call("EnterInitializationMode", no, number(0), number(0), yes, number(stop))
        return begun or self.call("ExitInitializationMode")

    def step(self, start: float, size: float) -> int:
        """Take a step between communication points and return the status."""
        flags = [ctypes.c_bool(False) for _ in range(3)]
        reached, number = ctypes.c_double(0.0), ctypes.c_double
        return self.call(
            *("DoStep", number(start), number(size), ctypes.c_bool(True)),
            *map(ctypes.byref, (*flags, reached)),
        )

    def states(self, names: Sequence[str]) -> list[float]:
        """Return several variables."""
        return [self.get(name) for name in names]


def _followed(unit: Unit, times: Sequence[float], names: Sequence[str]) -> list[list[float]]:
    rows = [unit.states(names)]
    for start, end in pairwise(times):
        assert unit.step(start, end - start) == OK, unit.messages
        rows.append(unit.states(names))
    return rows


def _execution(name: str, until: float, **parameters: float) -> Execution:
    return zo.simulate(name, until=until, parameters=parameters)


@pytest.mark.slow
def test_fmpy_validates_a_unit_and_runs_it_through_eleven_zeno_points(export: Export) -> None:
    fmpy = pytest.importorskip("fmpy")
    validation = pytest.importorskip("fmpy.validation")
    file = str(export("motor_pendulum", "--until", "20"))
    assert validation.validate_fmu(file) == []
    rows = fmpy.simulate_fmu(file, stop_time=20.0, output_interval=0.01)
    run = zo.simulate("motor_pendulum", until=20.0)
    assert len(rows) == 2001
    assert len(run.zeno_points) == 11
    for row in rows:
        time = min(float(row["time"]), 20.0)
        states = [float(row[name]) for name in run.state_names]
        assert np.max(np.abs(np.array(states) - run.state_at(time))) <= 1e-11
        assert row["impacts"] == sum(event.time <= time for event in run.impacts)
        passed = [event.time for event in run.zeno_points if event.time <= time]
        assert row["zeno_points"] == len(passed)
        assert row["zeno_time"] == passed[-1] if passed else math.isnan(row["zeno_time"])


@pytest.mark.slow
@pytest.mark.parametrize("name", list(one_stop_problems())[::3])
def test_units_of_every_bundled_problem_are_valid_and_give_the_states_of_simulate(
    export: Export, name: str
) -> None:
    validation = pytest.importorskip("fmpy.validation")
    file = export(name, "--until", "4")
    assert validation.validate_fmu(str(file)) == []
    run = _execution(name, 4.0)
    unit = Unit(file)
    assert unit.initialize(4.0) == OK
    times = np.linspace(0.0, 4.0, 301).tolist()
    found = _followed(unit, times, run.state_names)
    expected = np.array([run.state_at(time) for time in times])
    assert np.max(np.abs(np.array(found) - expected) / (1.0 + np.abs(expected))) <= 1e-11
    assert unit.get("impacts") == len(run.impacts)
    assert unit.get("zeno_points") == len(run.zeno_points)


@pytest.mark.slow
@pytest.mark.parametrize("name", often(4, GRAPHS))
def test_units_of_machines_with_several_stops_or_switches_follow_simulate(
    export: Export, name: str
) -> None:
    validation = pytest.importorskip("fmpy.validation")
    until = GRAPHS[name]
    file = export(name, "--until", str(until))
    assert validation.validate_fmu(str(file)) == []
    run = _execution(name, until)
    unit = Unit(file)
    assert unit.initialize(until) == OK
    times = np.linspace(0.0, until, 301).tolist()
    found = _followed(unit, times, run.state_names)
    assert found == [run.state_at(time).tolist() for time in times]
    assert unit.get("impacts") == len(run.impacts)
    assert unit.get("zeno_points") == len(run.zeno_points)
    stops = zo.load_problem(name).graph_dynamics(zo.load_problem(name).values()).stop_names
    closed = run.arcs[-1].closed
    assert unit.get("mode") == sum(2**k for k, stop in enumerate(stops) if stop in closed)
    for stop in stops if len(stops) > 1 else ():
        points = [point.time for point in run.zeno_points if point.stop == stop]
        assert unit.get(f"zeno_points_{stop}") == len(points)
        assert unit.get(f"impacts_{stop}") == sum(one.stop == stop for one in run.impacts)
        assert unit.get(f"zeno_time_{stop}") == points[-1]


@pytest.mark.slow
@pytest.mark.parametrize("name", often(2, FORCES))
def test_units_with_nested_kinks_move_in_closed_form(name: str) -> None:
    Path("nested.py").write_text(nested_problem(FORCES[name][0]), encoding="utf-8")
    answer = ask("export", "nested.py", "--fmu", "-o", name.replace(" ", "_"), "--until", "13")
    assert answer.code == YES, answer.err
    unit = Unit(next(Path(name.replace(" ", "_")).glob("*.fmu")))
    assert unit.initialize(13.0) == OK
    times = np.linspace(0.0, 4 * math.pi, 41).tolist()
    found = _followed(unit, times, ("q", "v"))
    up, down = half_periods(name)
    y = np.array([0.0, 0.0, 1.0])
    for k, half in enumerate((up, down, up, down), start=1):
        y = half @ y
        assert found[10 * k] == pytest.approx(y[:2], abs=1e-9)
    run = zo.simulate("nested.py", until=13.0)
    assert found == [run.state_at(time)[:2].tolist() for time in times]


@pytest.mark.slow
def test_the_waveform_of_a_relay_can_be_another(export: Export) -> None:
    unit = Unit(export("relay_soft", "--until", "0.09"))
    assert unit.set("t1", 1.2e-3) == OK
    assert unit.set("t2", 2.5e-3) == OK
    assert unit.initialize(0.03) == OK
    assert unit.step(0.0, 0.03) == OK
    run = zo.simulate("relay_soft", until=0.03, gains={"t1": 1.2e-3, "t2": 2.5e-3})
    # Sizes that tolerances are measured in are those of the exported gains.
    assert unit.states(run.state_names) == pytest.approx(run.end_state.tolist(), abs=1e-9)
    assert unit.get("impacts_closed") == sum(one.stop == "closed" for one in run.impacts)
    # On a closed contact the run starts anew with other gains, and goes on.
    assert unit.call("Reset") == OK
    assert unit.initialize(0.03) == OK
    assert unit.step(0.0, 0.01) == OK
    assert unit.get("mode") == 1
    reached = dict(zip(run.state_names, unit.states(run.state_names), strict=True))
    assert unit.set("U", 20.0) == ERROR
    assert unit.set("t1", 1.0e-3) == OK
    assert unit.step(0.01, 0.02) == OK
    expected = zo.simulate("relay_soft", until=0.02, gains={"t1": 1.0e-3}, start=reached)
    assert unit.states(run.state_names) == pytest.approx(expected.end_state.tolist(), abs=1e-9)
    assert unit.set("t1", 0.02) == OK
    assert unit.step(0.03, 0.0) == ERROR
    assert unit.messages[-1].startswith("Switching times do not increase at 0.0")


@pytest.mark.slow
def test_a_kept_state_inside_an_arc_is_taken_again(export: Export) -> None:
    unit = Unit(export("clapper", "--until", "30.0"))
    names = ("place", "speed", "impacts_upper", "zeno_points_lower", "mode")
    names = (*zo.load_problem("clapper").state_names[:2], *names[2:])
    assert unit.initialize(30.0) == OK
    assert unit.step(0.0, 7.3) == OK
    kept = ctypes.c_void_p(None)
    assert unit.call("GetFMUState", ctypes.byref(kept)) == OK
    times = [7.3, 7.35, 9.0, 20.0, 30.0]
    rows = [_followed(unit, times, names)]
    assert unit.call("SetFMUState", kept) == OK
    rows.append(_followed(unit, times, names))
    assert rows[0] == rows[1]
    assert unit.call("FreeFMUState", ctypes.byref(kept)) == OK


@pytest.mark.slow
def test_states_do_not_depend_on_the_communication_points(export: Export) -> None:
    file = export("bouncing_ball")
    rows: list[list[float]] = []
    for n in (4, 64, 1024):
        unit = Unit(file)
        assert unit.initialize(6.0) == OK
        found = _followed(unit, np.linspace(0.0, 6.0, n + 1).tolist(), ("height", "speed"))
        rows.append([number for row in found[:: n // 4] for number in row])
    assert rows[0] == rows[1] == rows[2]


@pytest.mark.slow
def test_parameters_that_are_set_before_the_start_are_obeyed(export: Export) -> None:
    unit = Unit(export("bouncing_ball"))
    fall = math.sqrt(2 * 2.0 / 1.62)
    for name, value in (("restitution", 0.7), ("g", 1.62), ("height", 2.0)):
        assert unit.set(name, value) == OK
    assert unit.initialize(30.0) == OK
    _followed(unit, np.linspace(0.0, 30.0, 61).tolist(), ("height",))
    assert unit.get("zeno_time") == pytest.approx(fall * 1.7 / 0.3, rel=1e-11)
    assert unit.get("mode") == 1


@pytest.mark.slow
def test_a_law_of_the_impact_speed_obeys_its_parameters(export: Export) -> None:
    numbers = {"restitution": 0.55, "fall": 0.3}
    run = _execution("marble_table", 2.0, **numbers)
    unit = Unit(export("marble_table", "--until", "2"))
    for name, value in numbers.items():
        assert unit.set(name, value) == OK
    assert unit.initialize(2.0) == OK
    times = np.linspace(0.0, 2.0, 151).tolist()
    found = np.array(_followed(unit, times, run.state_names))
    expected = np.array([run.state_at(time) for time in times])
    assert np.max(np.abs(found - expected) / (1.0 + np.abs(expected))) <= 1e-11
    assert unit.get("zeno_time") == pytest.approx(run.zeno_points[-1].time, rel=1e-12)
    assert unit.call("Reset") == OK
    assert unit.set("fall", 2.0) == OK
    assert unit.initialize(2.0) == OK
    assert unit.step(0.0, 1.0) == ERROR
    wanted = "The restitution leaves [0, 1] at the speed of an impact at 0.1327"
    assert unit.messages[-1].startswith(wanted)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["measured_valve", "shaken_block"])
def test_a_unit_follows_a_table_and_a_record(export: Export, name: str) -> None:
    run = _execution(name, 2.0)
    unit = Unit(export(name, "--until", "2"))
    assert unit.initialize(2.0) == OK
    times = np.linspace(0.0, 2.0, 81).tolist()
    found = np.array(_followed(unit, times, run.state_names))
    expected = np.array([run.state_at(time) for time in times])
    assert np.max(np.abs(found - expected) / (1.0 + np.abs(expected))) <= 1e-11


@pytest.mark.slow
def test_hundreds_of_impacts_before_a_zeno_point_are_counted(export: Export) -> None:
    unit = Unit(export("bouncing_ball"))
    assert unit.set("restitution", 0.99) == OK
    assert unit.initialize(95.0) == OK
    _followed(unit, np.linspace(0.0, 95.0, 20).tolist(), ("height",))
    assert unit.get("impacts") > 600
    fall = math.sqrt(2 / 9.81)
    assert unit.get("zeno_time") == pytest.approx(fall * 1.99 / 0.01, rel=1e-10)


@pytest.mark.slow
def test_an_input_acts_from_the_communication_point_on(export: Export) -> None:
    unit = Unit(export("bouncing_ball", "--input", "g"))
    assert unit.initialize(1.0) == OK
    assert unit.step(0.0, 0.2) == OK
    assert unit.set("g", 2.0) == OK
    assert unit.step(0.2, 0.3) == OK
    height = 1.0 - 9.81 * 0.2**2 / 2 - 9.81 * 0.2 * 0.3 - 2.0 * 0.3**2 / 2
    assert unit.get("height") == pytest.approx(height, abs=1e-13)
    assert unit.get("speed") == pytest.approx(-9.81 * 0.2 - 2.0 * 0.3, abs=1e-13)


@pytest.mark.slow
def test_a_gain_can_be_tuned_between_steps(export: Export) -> None:
    # On the stop and in a flight: the run starts anew there with the other gain.
    problem = zo.load_problem("motor_pendulum")
    unit = Unit(export("motor_pendulum", "--until", "20"))
    assert unit.initialize(6.0) == OK
    names = problem.state_names
    for start, gain in ((2.0, -0.9), (4.0, -1.1)):
        assert unit.step(start - 2.0, 2.0) == OK
        reached = dict(zip(names, unit.states(names), strict=True))
        assert unit.set("Kd", gain) == OK
    assert unit.step(4.0, 2.0) == OK
    expected = zo.simulate(problem, until=2.0, gains={"Kd": -1.1}, start=reached)
    # Sizes that tolerances are measured in are those of the exported gains.
    assert unit.states(names) == pytest.approx(expected.end_state.tolist(), abs=1e-9)


@pytest.mark.slow
def test_a_kept_state_is_taken_again(export: Export) -> None:
    unit = Unit(export("bouncing_ball"))
    assert unit.initialize(6.0) == OK
    assert unit.step(0.0, 3.0) == OK
    kept = ctypes.c_void_p(None)
    assert unit.call("GetFMUState", ctypes.byref(kept)) == OK
    rows = [_followed(unit, [3.0, 4.5, 6.0], ("height", "speed", "impacts", "mode"))]
    assert unit.call("SetFMUState", kept) == OK
    rows.append(_followed(unit, [3.0, 4.5, 6.0], ("height", "speed", "impacts", "mode")))
    assert rows[0] == rows[1]
    assert unit.call("FreeFMUState", ctypes.byref(kept)) == OK
    assert kept.value is None
    assert unit.call("Reset") == OK
    assert unit.initialize(6.0) == OK
    assert unit.states(("height", "speed", "impacts")) == [1.0, 0.0, 0.0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("g", 2.0, "cannot be set after initialization"),
        ("height", 2.0, "cannot be set after initialization"),
        ("mode", 1.0, "The variable cannot be set"),
        ("time", 1.0, "The variable cannot be set"),
        ("restitution", math.nan, "A value must be finite"),
    ],
)
def test_what_may_not_be_set_is_refused(
    export: Export, name: str, value: float, message: str
) -> None:
    unit = Unit(export("bouncing_ball"))
    assert unit.initialize(2.0) == OK
    assert unit.set(name, value) == ERROR
    assert message in unit.messages[-1]


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("restitution", 2.0, "restitution must lie in [0, 1], but it is 2"),
        ("restitution", -0.1, "restitution must lie in [0, 1], but it is -0.1"),
        ("g", 0.0, "g must be greater than 0, but it is 0"),
        ("m", math.inf, "A value must be finite"),
    ],
)
def test_values_that_simulate_refuses_are_refused_and_change_nothing(
    export: Export, name: str, value: float, message: str
) -> None:
    with pytest.raises(zo.InputError):
        _execution("bouncing_ball", 1.0, **{name: value})
    unit = Unit(export("bouncing_ball"))
    before = unit.get(name)
    assert unit.set(name, value) == ERROR
    assert unit.messages == [message]
    assert unit.get(name) == before
    assert unit.initialize(1.0) == OK


def test_elastic_impacts_that_are_set_keep_the_energy(export: Export) -> None:
    unit, fall = Unit(export("bouncing_ball")), math.sqrt(2.0 / 9.81)
    assert unit.set("restitution", 1.0) == OK
    assert unit.initialize(40.0) == OK
    # The ball is at its full height after whole periods.
    rows = _followed(unit, [2 * fall * k for k in range(40)], ("height", "speed", "impacts"))
    assert [row[2] for row in rows] == list(range(40))
    assert np.array(rows)[:, :2] == pytest.approx(np.tile([1.0, 0.0], (40, 1)), abs=1e-9)


def test_the_description_has_the_largest_range_that_simulate_accepts(export: Export) -> None:
    _, description = _unpacked(export("bouncing_ball"))
    variables = description.find("ModelVariables")
    assert variables is not None
    problem, n_ends = zo.load_problem("bouncing_ball"), 0
    for one in variables:
        name = one.attrib["name"]
        for end, beyond in (("min", -math.inf), ("max", math.inf)):
            if end not in one.attrib:
                continue
            n_ends += 1
            inside = float(one.attrib[end])
            assert problem.values(numbers={name: inside}).parameters[name] == inside
            # Next to zero the smallest normal number stands for the smallest number.
            outside = 0.0 if 0.0 < inside < 1e-300 else math.nextafter(inside, beyond)
            with pytest.raises(zo.InputError):
                problem.values(numbers={name: outside})
    assert n_ends == 4


@pytest.mark.slow
def test_a_clock_off_its_circle_is_refused(export: Export) -> None:
    unit = Unit(export("relay", "--until", "0.09"))
    assert unit.set("cosine", 0.6) == OK
    assert unit.initialize(0.09) == ERROR
    assert unit.messages == [
        "cosine and sine must be on the unit circle, as a clock, but they are 0.6 and 0"
    ]
    assert unit.set("sine", 0.8) == OK
    assert unit.call("ExitInitializationMode") == OK


@pytest.mark.slow
def test_a_parameter_is_not_set_without_those_that_are_derived_from_it(export: Export) -> None:
    problem, unit = (
        zo.load_problem("motor_pendulum"),
        Unit(export("motor_pendulum", "--until", "20")),
    )
    values = problem.values(numbers={"m1": 0.35}).parameters
    derived = ("J_rotor", "K_torque", "K_emf")
    for n, missing in enumerate((*derived, "")):
        assert unit.call("Reset") == OK
        for name in ("m1", *derived[:n]):
            assert unit.set(name, values[name]) == OK
        assert unit.initialize(6.0) == (ERROR if missing else OK)
        assert len(unit.messages) == min(n + 1, 3)
        if missing:
            expected = f"m1 was set, and {missing} is derived from it: set that as well"
            assert unit.messages[-1] == expected
    assert unit.step(0.0, 6.0) == OK
    run = _execution("motor_pendulum", 6.0, m1=0.35)
    assert unit.states(run.state_names) == pytest.approx(run.end_state.tolist(), abs=1e-9)


def test_misuse_and_failures_end_in_a_status_with_a_message(export: Export) -> None:
    file = export("bouncing_ball")
    assert Unit(file, token="another").instance.value is None
    unit = Unit(file)
    assert unit.step(0.0, 0.1) == ERROR
    assert unit.set("height", -1.0) == OK
    assert unit.initialize(2.0) == ERROR
    assert unit.messages[-1] == "The state is inside of a stop at 0 s"
    assert unit.call("Reset") == OK
    assert unit.initialize(2.0) == OK
    assert unit.step(0.5, 0.1) == ERROR
    assert unit.messages[-1] == "A step must start where the last one ended"
    assert unit.step(0.0, 2.5) == ERROR
    assert unit.messages[-1] == "The step ends after the stop time"
    assert unit.call("EnterEventMode") == ERROR
    assert unit.messages[-1] == "The unit does not offer fmi3EnterEventMode"


def test_inputs_are_checked_before_anything_is_written() -> None:
    answer = ask("export", "bouncing_ball", "--fmu", "--input", "mass", "-o", "exported")
    assert answer.code == MISUSE
    assert "unknown name `mass`. Known: m, g, restitution" in answer.err
    answer = ask("export", "bouncing_ball", "--input", "g", "-o", "exported")
    assert answer.code == MISUSE
    assert "belongs to `--fmu`" in answer.err
    assert not Path("exported").exists()


@pytest.mark.slow
def test_the_sources_alone_give_the_same_unit(export: Export) -> None:
    # Strict C99 of another level, without Python: the digits are those of the library in the file.
    file = export("bouncing_ball")
    own, _ = _unpacked(file)
    sources = own.parents[2] / "sources"
    words = ["cc", *STRICT, "-O1", "-fPIC", "-shared", str(sources / "fmi3.c"), "-o", "unit.so"]
    done = subprocess.run([*words, "-lm"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = Unit(file, library=Path("unit.so"))
    expected = Unit(file)
    assert found.initialize(6.0) == expected.initialize(6.0) == OK
    times = np.linspace(0.0, 6.0, 61).tolist()
    names = ("height", "speed", "mode", "impacts", "zeno_points")
    assert _followed(found, times, names) == _followed(expected, times, names)


@pytest.mark.slow
def test_the_same_problem_gives_the_same_bytes(export: Export) -> None:
    again = _exported(Path("again"), "bouncing_ball")
    assert again.read_bytes() == export("bouncing_ball").read_bytes()
