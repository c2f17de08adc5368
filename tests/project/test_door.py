"""The front door: what `import zeno_orbits` offers and costs, and one call to each result."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import zeno_orbits as zo

ROOT = Path(__file__).parents[2]

# fmt: off
PROMISED = [
    "load_problem", "bundled_problems", "simulate", "find_orbit", "search_gains",
    "find_orbit_by_shooting", "verify", "with_certificate", "floquet_multipliers",
    "continue_orbit", "parameter_map", "read_orbit", "write_orbit", "plot", "__version__",
    "Execution", "SearchResult", "Orbit", "OrbitCertificate", "Continuation", "Family",
    "ParameterMap", "SimulationSettings", "SearchSettings", "TargetPeriod", "TargetAmplitude",
    "MinEnergy", "MinPeak", "MinSpectralRadius", "MaxMargin", "NearestGains", "InputError",
    "OrbitNotFoundError", "SimulationError", "ZenoOrbitsError", "Problem", "Quantity",
    "StateLimit", "Output", "Drawing", "HybridLagrangian", "MotorBank", "full_drive",
    "corrected_drive", "quasi_static_drive", "ideal_torque_drive", "no_drive", "Clock",
    "hybrid_system", "Rig", "Contact", "Friction", "Gear", "HBridge", "PwmSettings",
    "Controller", "Sensors",
]
# fmt: on
"""What others rely on; names may be added, none may go."""

PROBLEMS = sorted([*(ROOT / "problems").rglob("*.py")])


def test_every_promised_name_is_offered() -> None:
    assert set(PROMISED) <= set(zo.__all__)
    assert all(getattr(zo, name) is not None for name in zo.__all__)


def test_the_documented_list_is_the_exported_list() -> None:
    page = (ROOT / "docs" / "reference.md").read_text()
    rows = re.findall(r"^\| (`.*?`) \|", page, re.MULTILINE)
    listed = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    assert sorted(listed) == sorted(zo.__all__)


def test_the_door_opens_without_numpy_and_casadi() -> None:
    code = "import sys, zeno_orbits; print(*{'numpy', 'casadi', 'scipy'} & set(sys.modules))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == ""


@pytest.mark.parametrize("path", PROBLEMS, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_a_bundled_problem_imports_from_the_front_door_alone(path: Path) -> None:
    modules = [
        node.module or ""
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom)
    ]
    ours = {module for module in modules if module.startswith("zeno_orbits")}
    # A hand-written model stands for the numeric functions themselves.
    if "reference" not in path.stem:
        assert ours <= {"zeno_orbits"}


def test_an_orbit_is_found_with_its_certificate_and_multipliers() -> None:
    orbit = zo.find_orbit("vibrating_table", parameters={"restitution": 0.3}).unwrap()
    assert orbit.certificate["passed"]
    assert orbit.parameters["restitution"] == 0.3
    pendulum = zo.find_orbit("motor_pendulum").unwrap()
    assert pendulum.floquet_multipliers[0].real == pytest.approx(-0.0193686, abs=1e-7)
    again = zo.floquet_multipliers(pendulum)
    assert np.allclose(again.values, pendulum.floquet_multipliers, atol=10 * again.error + 1e-12)


def test_a_problem_is_an_object_a_name_or_a_file(tmp_path: Path) -> None:
    path = tmp_path / "ball.py"
    path.write_text((ROOT / "problems" / "bouncing_ball.py").read_text())
    ends = [
        zo.simulate(given, until=1.0, start={"height": 1.0}).end_state
        for given in ("bouncing_ball", zo.load_problem("bouncing_ball"), path, str(path))
    ]
    assert all(np.array_equal(end, ends[0]) for end in ends)


def test_functions_of_an_orbit_take_its_file_and_find_its_problem(
    orbit: zo.Orbit, tmp_path: Path
) -> None:
    path = tmp_path / "orbit.json"
    zo.write_orbit(orbit, str(path))
    assert zo.verify(str(path)).passed
    with pytest.raises(zo.InputError, match="must be the problem `motor_pendulum` of the orbit"):
        zo.verify(path, problem="bouncing_ball")


def test_an_orbit_of_a_problem_that_is_not_bundled_asks_for_its_file(orbit: zo.Orbit) -> None:
    with pytest.raises(zo.InputError, match="Unknown problem `mine`"):
        zo.verify(replace(orbit, problem="mine"))


def test_a_map_of_a_problem_built_in_a_notebook_is_drawn_here() -> None:
    ball = zo.load_problem("vibrating_table")
    found = zo.parameter_map(ball, x=("A", 0.0149, 0.0151, 4), y=("omega", 29.9, 30.1, 4))
    assert found.has_zeno


def test_several_workers_want_a_problem_that_they_can_load() -> None:
    ball = replace(zo.load_problem("vibrating_table"), title="another")
    with pytest.raises(zo.InputError, match="several workers need a file"):
        zo.search_gains(ball, vary={"A": (0.01, 0.02)}, workers=2)


@pytest.mark.slow
def test_an_orbit_with_several_zeno_points_is_continued() -> None:
    gains = {"Kp": 4.3, "Kd": -1.55}
    orbit = zo.find_orbit_by_shooting("motor_pendulum", gains=gains).unwrap()
    assert orbit.sequence == 2 * ("zeno stop", "release stop")
    (family, *_) = zo.continue_orbit(orbit, ("Kp", 4.28, 4.3)).families
    last = min(family.points, key=lambda point: point.value)
    moved = zo.find_orbit_by_shooting("motor_pendulum", gains=gains | {"Kp": last.value}).unwrap()
    assert last.period == pytest.approx(moved.period, rel=1e-9)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (lambda: zo.simulate("no_problem"), "unknown problem `no_problem`"),
        (lambda: zo.simulate("motor_pendulum", gains={"Kx": 1.0}), "unknown gain `Kx`"),
        (lambda: zo.simulate("motor_pendulum", start={"knee": 1.0}), "unknown state `knee`"),
        (lambda: zo.find_orbit("motor_pendulum", parameters={"R": -1.0}), "`R` must"),
        (lambda: zo.plot(3), "`result` must be one of"),
        (lambda: zo.read_orbit("nowhere.json"), "nowhere.json"),
    ],
)
def test_misuse_is_refused_in_one_sentence(wrong: object, told: str) -> None:
    with pytest.raises(zo.InputError, match=told) as refused:
        wrong()  # type: ignore[operator]
    assert "\n" not in str(refused.value)
