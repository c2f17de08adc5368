"""Signs by which damping, resistances and motors supply energy, against powers by hand."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.commands import ask
from tests.support.mechanisms import machine_of
from zeno_orbits.arrays import Vector
from zeno_orbits.model import bundled_problems, energy_sources, load_problem

Force = Callable[[ca.SX, ca.SX, ca.SX], ca.SX]

MOTOR_FLAP = Path(__file__).parents[1] / "support" / "machines" / "motor_flap.py"


def _machine(force: Force, n: int = 2, **motor: float) -> zo.Problem:
    """Return masses of 1 kg with a passive force, and a motor on the first if it is given."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=9.81 * q[0],
            gap=q[0],
            passive_force=force(q, v, p["c"]),
        )
        drive = zo.no_drive(mechanism)
        if motor:
            bank = zo.MotorBank(
                selection=ca.SX(np.eye(n)[:, :1]),
                resistance=ca.SX(motor["R"]),
                inductance=ca.SX(0.01),
                torque_constant=ca.SX(motor["torque"]),
                emf_constant=ca.SX(motor["emf"]),
                voltage=ca.SX(1.0),
            )
            drive = zo.full_drive(mechanism, bank)
        return zo.hybrid_system(mechanism, drive, ca.SX(0.5))

    names = [f"q{k}" for k in range(n)] + [f"v{k}" for k in range(n)]
    units = ["m"] * n + ["m/s"] * n
    return zo.Problem(
        name="masses",
        title="masses",
        source="by hand",
        state_names=(*names, *(("current",) if motor else ())),
        state_units=(*units, *(("A",) if motor else ())),
        parameters=(zo.Quantity(name="c", unit="N s/m", meaning="damping", default=0.3),),
        gains=(),
        model=model,
        starts=({"q0": 1.0},),
        portraits=(("q0", "v0"),),
        amplitude_of="q0",
    )


def _damped(matrix: Vector, _q: ca.SX, v: ca.SX, c: ca.SX) -> ca.SX:
    return -c * ca.mtimes(ca.SX(matrix), v)


def _parts(problem: zo.Problem, **parameters: float) -> list[str]:
    values = problem.values(parameters=parameters)
    return [one.part for one in energy_sources(problem, values)]


@pytest.mark.slow
def test_linear_damping_supplies_energy_where_its_symmetric_part_is_not_positive() -> None:
    rng = np.random.default_rng(3)
    supplies = list[bool]()
    for _ in range(20):
        matrix = rng.normal(size=(3, 3)) + 1.5 * np.eye(3)
        least = np.linalg.eigvalsh(matrix + matrix.T)[0]
        found = _parts(_machine(partial(_damped, matrix), 3))
        supplies.append(least < 0)
        assert found == (["passive_force"] if least < 0 else [])
    assert 4 < sum(supplies) < 16


@pytest.mark.parametrize(
    ("force", "supplies"),
    [
        (lambda _q, v, c: -c * ca.fabs(v) * v, False),
        (lambda _q, v, c: c * ca.fabs(v) * v, True),
        (lambda _q, v, c: -c * ca.tanh(v / 0.01), False),
        # Gyroscopic forces and constant ones do no damping.
        (lambda q, v, c: c * ca.vertcat(v[1], -v[0]) * q[0], False),
        (lambda q, v, c: ca.vertcat(5 * c, q[1]) - c * v, False),
        # It supplies energy at small speeds alone.
        (lambda _q, v, c: v * (1e-8 * c - c * v**2), True),
        (lambda q, v, c: -c * (q[0] ** 2 + 1) * v, False),
    ],
)
def test_other_damping_is_evaluated_at_states(force: Force, *, supplies: bool) -> None:
    assert _parts(_machine(force)) == (["passive_force"] if supplies else [])


def test_a_supply_is_told_with_its_power_and_the_value_decides_about_it() -> None:
    machine = _machine(lambda _q, v, c: -c * v, 1)
    assert _parts(machine) == []
    (found,) = energy_sources(machine, machine.values(parameters={"c": -0.3}))
    # P = 0.3 N s/m times (1 m/s)^2.
    assert found.text.startswith("`passive_force` supplies energy: it supplies 0.3 W at v0 = 1.")


@pytest.mark.parametrize(
    ("motor", "part"),
    [
        ({"R": 1.0, "torque": 0.1, "emf": 0.1}, []),
        ({"R": 1.0, "torque": -0.1, "emf": -0.1}, []),
        ({"R": 1.0, "torque": 0.12, "emf": 0.1}, []),
        ({"R": 1.0, "torque": 0.1, "emf": -0.1}, ["emf_constant"]),
        ({"R": -1.0, "torque": 0.1, "emf": 0.1}, ["resistance"]),
    ],
)
def test_the_back_emf_has_the_sign_of_the_torque(motor: dict[str, float], part: list[str]) -> None:
    assert _parts(_machine(lambda _q, v, c: -c * v, **motor)) == part


def _rubbed(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    mass = zo.HybridLagrangian.from_energies(q=q, v=v, kinetic=v**2 / 2, potential=q**2 / 2)
    # The root is undefined at half of the states.
    pad = zo.DryFriction("pad", rate=v, torque=0.1 + p["slope"] * ca.sqrt(q))
    return zo.hybrid_system(mass, (zo.no_drive(mass), pad))


def test_dry_friction_that_pushes_somewhere_is_told() -> None:
    units = {"q": "m", "v": "m/s", "side_pad": "1"}
    machine = machine_of(_rubbed, units, {"slope": 1.0})
    assert _parts(machine) == []
    assert _parts(machine, slope=-1.0) == ["pad"]


@pytest.mark.slow
def test_no_bundled_problem_supplies_energy_by_a_sign() -> None:
    for name in bundled_problems():
        problem = load_problem(name)
        assert energy_sources(problem, problem.values()) == ()


@pytest.mark.slow
def test_every_command_about_a_file_tells_it_and_the_condition_holds_it(
    tmp_path: Path,
) -> None:
    text = MOTOR_FLAP.read_text()
    assert "emf_constant=p" in text
    path = tmp_path / "flap.py"
    path.write_text(text.replace("emf_constant=p", "emf_constant=-p"))
    note = "zeno-orbits: note: `emf_constant` supplies energy: the back EMF of motor 1 drives"
    for words in (("simulate", str(path), "--until", "0.01"), ("zeno-condition", str(path))):
        answer = ask(*words)
        assert answer.code == 0
        assert answer.err.startswith(note)
    assert "motor 1" in zo.zeno_condition(str(path)).sources[0]
    assert zo.zeno_condition(str(MOTOR_FLAP)).sources == ()
