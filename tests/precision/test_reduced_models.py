"""Reduced models of a problem: their names, their errors, and what says so beforehand."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.mechanisms import bound, evaluated
from zeno_orbits import (
    HybridLagrangian,
    MotorBank,
    TargetPeriod,
    corrected_drive,
    full_drive,
    hybrid_system,
    quasi_static_drive,
)
from zeno_orbits.cli import main
from zeno_orbits.errors import InputError
from zeno_orbits.model import (
    CompletedSystem,
    Drive,
    HybridDynamics,
    ImpactLaw,
    ParameterValues,
    Problem,
    load_problem,
)
from zeno_orbits.orbits import read_orbit
from zeno_orbits.precision import ReductionCost, errors_of_reduced_models
from zeno_orbits.search import orbit_at_gains, search_orbits
from zeno_orbits.simulation import simulate
from zeno_orbits.verification import verify

QUASI_STATIC, CORRECTED = "quasi_static", "corrected"
LANDMARKS = ("period", "first_impact", "zeno_time", "release", "zeno_state")

PENDULUM = Path(__file__).parents[2] / "problems" / "motor_pendulum"

# -------------------------------------------------------------------- a linear cart in closed form
#
# A cart of mass 1.3 kg on a spring of 5 N/m, driven by a motor with V = -2 x + 1.5 dx, with its
# stop at x = 0. Without contact the full model is x' = A x with a 3 x 3 matrix.

MASS, SPRING, KP, KD, R, K = 1.3, 5.0, 2.0, -1.5, 2.0, 0.8


def _cart(inductance: float) -> tuple[HybridLagrangian, MotorBank]:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    cart = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=MASS * v**2 / 2, potential=SPRING * q**2 / 2, gap=q
    )
    return cart, _bank(ca.SX(1), inductance, -KP * q - KD * v)


def _bank(selection: ca.SX, inductance: float, voltage: ca.SX) -> MotorBank:
    return MotorBank(
        selection=selection,
        resistance=ca.SX(R),
        inductance=ca.SX(inductance),
        torque_constant=ca.SX(K),
        emf_constant=ca.SX(K),
        voltage=voltage,
    )


def _full_matrix(inductance: float) -> NDArray[np.float64]:
    return np.array(
        [
            [0.0, 1.0, 0.0],
            [-SPRING / MASS, 0.0, K / MASS],
            [-KP / inductance, (-KD - K) / inductance, -R / inductance],
        ]
    )


def _slow_pair(inductance: float) -> NDArray[np.complex128]:
    """Return the two eigenvalues of the full cart that stay finite as ``L`` vanishes."""
    values = np.linalg.eigvals(_full_matrix(inductance))
    return np.sort_complex(values[np.argsort(np.abs(values))][:2])


def _reduced_pair(inductance: float, drive_of: object) -> NDArray[np.complex128]:
    cart, bank = _cart(inductance)
    system = hybrid_system(cart, drive_of(cart, bank), ca.SX(0.5))  # type: ignore[operator]
    matrix = evaluated(
        ca.jacobian(system.free_flow, system.state), {"x": (0.0, 0.0)}, x=system.state
    )
    return np.sort_complex(np.linalg.eigvals(matrix))


def _orders(sizes: list[float], errors: list[float]) -> list[float]:
    return [
        math.log(errors[k] / errors[k + 1]) / math.log(sizes[k] / sizes[k + 1])
        for k in range(len(sizes) - 1)
    ]


INDUCTANCES = [1e-2, 1e-3, 1e-4, 1e-5]


@pytest.mark.parametrize(("drive_of", "order"), [(quasi_static_drive, 1), (corrected_drive, 2)])
def test_the_eigenvalues_of_a_cart_show_the_order_of_its_drive(
    drive_of: object, order: int
) -> None:
    errors = [
        float(np.max(np.abs(_reduced_pair(one, drive_of) - _slow_pair(one)))) for one in INDUCTANCES
    ]
    # The eigenvalues are of size 2; rounding of 1e-16 R/L = 2e-11 is below the last error, 3e-10.
    # The next order adds L/R = 5e-3 at most to a slope, times a factor of order one.
    assert _orders(INDUCTANCES, errors) == pytest.approx([order] * 3, abs=0.05)


def _two_carts(inductance: float) -> tuple[HybridLagrangian, MotorBank]:
    """Return two carts on springs, two geared motors between them whose windings couple."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    carts = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=(MASS * v[0] ** 2 + 0.7 * v[1] ** 2 + 0.4 * v[0] * v[1]) / 2,
        potential=(SPRING * ca.sumsqr(q) + 2 * (q[0] - q[1]) ** 2) / 2,
        gap=q[0],
    )
    selection = ca.SX([[1.0, -2.0], [0.0, 2.0]])
    speed = ca.mtimes(selection.T, v)
    unit = ca.SX.eye(2)
    motors = MotorBank(
        selection=selection,
        resistance=R * unit,
        inductance=inductance * ca.SX([[1.0, 0.3], [0.3, 0.8]]),
        torque_constant=K * unit,
        emf_constant=K * unit,
        voltage=-KP * ca.mtimes(selection.T, q) - KD * speed,
    )
    return carts, motors


def test_coupled_motors_with_gears_are_corrected_to_second_order() -> None:
    def slow(inductance: float, *, full: bool) -> NDArray[np.complex128]:
        carts, motors = _two_carts(inductance)
        drive = full_drive(carts, motors) if full else corrected_drive(carts, motors)
        system = hybrid_system(carts, drive, ca.SX(0.5))
        at = {"x": np.zeros(system.state.numel())}
        matrix = evaluated(ca.jacobian(system.free_flow, system.state), at, x=system.state)
        values = np.linalg.eigvals(matrix)
        return np.sort_complex(values[np.argsort(np.abs(values))][:4])

    errors = [
        float(np.max(np.abs(slow(one, full=True) - slow(one, full=False)))) for one in INDUCTANCES
    ]
    # The first slope still has the next order, L/R times a rate of 10 1/s, in it.
    assert _orders(INDUCTANCES, errors)[1:] == pytest.approx([2.0] * 2, abs=0.05)


def _after_the_layer(inductance: float, restitution: float) -> float:
    """Return minus the restitution of the full cart that its slow motion shows, exactly.

    On the slow plane at ``x = 0``, unit speed of approach; the reset keeps the current; the slow
    part of what follows is a spectral projection, and its speed at the impact is what is asked.
    """
    matrix = _full_matrix(inductance)
    values, vectors = np.linalg.eig(matrix)
    slow = np.argsort(np.abs(values))[:2]
    plane = vectors[:, slow]
    before = (plane @ np.linalg.solve(plane[:2], np.array([0.0, -1.0]))).real
    after = before * np.array([1.0, -restitution, 1.0])
    shares = np.linalg.solve(vectors, after.astype(complex))
    return float((plane @ shares[slow])[1].real)


@pytest.mark.parametrize("restitution", [0.2, 0.7])
def test_a_corrected_restitution_is_that_of_the_slow_motion_to_second_order(
    restitution: float,
) -> None:
    corrected, bare = [], []
    for inductance in INDUCTANCES:
        cart, bank = _cart(inductance)
        system = hybrid_system(cart, corrected_drive(cart, bank), ca.SX(restitution))
        exact = _after_the_layer(inductance, restitution)
        corrected.append(abs(float(system.restitution) - exact))
        bare.append(abs(restitution - exact))
    assert _orders(INDUCTANCES, bare) == pytest.approx([1.0] * 3, abs=0.05)
    # The projection is right to 1e-16 R/L: the last error, 1e-11 or so, is left out.
    assert _orders(INDUCTANCES[:3], corrected[:3]) == pytest.approx([2.0] * 2, abs=0.05)


def test_a_braking_motor_makes_a_stop_more_elastic_and_a_driving_one_less() -> None:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    rotor = HybridLagrangian.from_energies(q=q, v=v, kinetic=v**2 / 2, potential=ca.SX(0), gap=q)
    # 1 + e~ = (1 + e) / (1 + K L (D - K) / R^2), by hand for a single rotor of unit inertia.
    for gain in (-3.0, 3.0):
        drive = corrected_drive(rotor, _bank(ca.SX(1), 0.01, gain * v))
        expected = 1.5 / (1 + K * 0.01 * (gain - K) / R**2) - 1
        assert float(hybrid_system(rotor, drive, ca.SX(0.5)).restitution) == pytest.approx(expected)


# ------------------------------------------------------------------------------ what is refused


def _two_joints() -> HybridLagrangian:
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    kinetic = (v[0] ** 2 + v[1] ** 2 + v[0] * v[1] * ca.cos(q[1])) / 2
    return HybridLagrangian.from_energies(q=q, v=v, kinetic=kinetic, potential=ca.SX(0), gap=q[1])


def test_a_motor_that_feeds_back_another_joints_speed_has_no_corrected_drive() -> None:
    joints = _two_joints()
    motors = _bank(ca.SX([1, 0]), 0.01, joints.v[1])
    with pytest.raises(ValueError, match="not symmetric"):
        corrected_drive(joints, motors)


@pytest.mark.parametrize("factor", ["speed", "angle"])
def test_a_speed_gain_that_changes_with_the_state_has_no_corrected_drive(factor: str) -> None:
    joints = _two_joints()
    by = joints.v[0] if factor == "speed" else joints.q[0]
    motors = _bank(ca.SX([1, 0]), 0.01, by * joints.v[0])
    with pytest.raises(ValueError, match="changes with the state"):
        corrected_drive(joints, motors)


def _corrected_two_joints(gap_of: str) -> Drive:
    joints = _two_joints()
    gap = joints.q[0] if gap_of == "shoulder" else joints.q[1]
    joints = replace(joints, gap=gap)
    drive = corrected_drive(joints, _bank(ca.SX([1, 0]), 0.01, joints.v[0]))
    hybrid_system(joints, drive, ca.SX(0.3))
    return drive


def test_a_restitution_that_would_change_along_the_stop_is_refused() -> None:
    # At the knee the inertias are those of one shape; at the shoulder the knee may be anywhere.
    assert _corrected_two_joints("knee").added_inertia.nnz() == 1
    with pytest.raises(ValueError, match="changes with the configuration"):
        _corrected_two_joints("shoulder")


def test_a_correction_as_large_as_what_it_corrects_is_refused_in_one_line() -> None:
    problem = load_problem("motor_pendulum@corrected")
    values = problem.values(gains={"Kd": 8.0}, parameters={"L": 1.0})
    with pytest.raises(InputError, match="use the full problem"):
        problem.dynamics(values)


# ---------------------------------------------------------------------- the pendulum's two rungs


def _numbers(problem: Problem, fidelity: str) -> tuple[Problem, HybridDynamics]:
    reduced = problem.at_fidelity(fidelity)
    return reduced, reduced.dynamics(reduced.shared(problem.values()))


def test_the_corrected_pendulum_is_one_with_more_rotor_less_damping_and_less_bounce(
    problem: Problem,
) -> None:
    values = problem.values().parameters
    resistance, inductance, torque = values["R"], values["L"], values["K_torque"]
    gains = {"Kp": 2.5, "Kd": -1.0}
    _, corrected = _numbers(problem, CORRECTED)
    # By hand: i = (V - K w)/R - L/R d/dt(...) turns Kd into Kd - Kp L/R and adds a rotor.
    added = torque * inductance * (-gains["Kd"] - values["K_emf"]) / resistance**2
    static = problem.at_fidelity(QUASI_STATIC)
    b = values["I2"] + values["m2"] * values["lc2"] ** 2
    known = {name: one for name, one in values.items() if name != "L"}
    by_hand = static.dynamics(
        static.values(
            gains={"Kp": 2.5, "Kd": gains["Kd"] - gains["Kp"] * inductance / resistance},
            parameters={**known, "J_rotor": values["J_rotor"] + added},
        )
    )
    rng = np.random.default_rng(1)
    for x in rng.normal(size=(20, 4)):
        assert corrected.free.rate(x) == pytest.approx(by_hand.free.rate(x), rel=1e-11)
        assert corrected.locked.rate(x) == pytest.approx(by_hand.locked.rate(x), rel=1e-11)
        assert corrected.impulse_direction(x) == pytest.approx(
            by_hand.impulse_direction(x), rel=1e-11
        )
    a = (
        values["I1"]
        + values["m1"] * values["lc1"] ** 2
        + values["m2"] * values["L1"] ** 2
        + values["J_rotor"]
    )
    c = values["m2"] * values["L1"] * values["lc2"]

    def response(rotor: float) -> float:
        return (a + rotor + b + 2 * c) / ((a + rotor) * b - c**2)

    share = response(added) / response(0.0)
    assert corrected.restitution == pytest.approx(1.2 * share - 1, rel=1e-12)
    assert corrected.restitution < values["restitution"]


@pytest.fixture(scope="module")
def costs(problem: Problem) -> Mapping[tuple[str, float], ReductionCost]:
    """Both reduced models over two decades of inductance."""
    return {
        (word, inductance): cost
        for inductance in (2e-2, 2e-3, 2e-4)
        for word, cost in errors_of_reduced_models(
            problem, _with_inductance(problem, inductance), measure=True
        ).items()
    }


def _with_inductance(problem: Problem, inductance: float, **others: float) -> ParameterValues:
    return problem.values(parameters={"L": inductance, **others})


@pytest.mark.slow
def test_the_orbit_shows_the_order_of_its_drive_over_two_decades(
    costs: Mapping[tuple[str, float], ReductionCost],
) -> None:
    sizes = [2e-2, 2e-3, 2e-4]
    for word, order in ((QUASI_STATIC, 1.0), (CORRECTED, 2.0)):
        for landmark in ("period", "first_impact", "release"):
            errors = [costs[word, size].measured[landmark] for size in sizes]
            assert _orders(sizes, errors) == pytest.approx([order] * 2, abs=0.07), landmark
        # In the tail flights are shorter than the layer: a logarithm comes in (theory (1.12)).
        for landmark in ("zeno_time", "zeno_state"):
            errors = [costs[word, size].measured[landmark] for size in sizes]
            mean = math.log(errors[0] / errors[2]) / math.log(100)
            assert mean == pytest.approx(order, abs=0.35), landmark


def test_the_estimate_is_the_error_of_the_quasi_static_model_to_a_tenth(
    costs: Mapping[tuple[str, float], ReductionCost],
) -> None:
    for size in (2e-2, 2e-3, 2e-4):
        cost = costs[QUASI_STATIC, size]
        for landmark in LANDMARKS:
            # What is left out is the corrected model's own error: 8 % at most, falling with L.
            ratio = cost.estimate[landmark] / cost.measured[landmark]
            assert ratio == pytest.approx(1.0, abs=0.1 * (size / 2e-2) ** 0.5), landmark


def test_the_estimate_of_the_corrected_model_is_right_to_an_order_of_magnitude(
    costs: Mapping[tuple[str, float], ReductionCost],
) -> None:
    for size in (2e-2, 2e-3, 2e-4):
        cost = costs[CORRECTED, size]
        ratios = [cost.estimate[name] / cost.measured[name] for name in LANDMARKS]
        assert all(0.1 < ratio < 10.0 for ratio in ratios), (size, ratios)


def test_no_reduced_model_errs_by_more_than_its_bound(
    costs: Mapping[tuple[str, float], ReductionCost],
) -> None:
    for (word, size), cost in costs.items():
        for name in LANDMARKS:
            assert cost.measured[name] <= cost.bound[name], (word, size, name)
            # A bound that is far too wide would hold as well.
            assert cost.bound[name] <= 100.0 * cost.measured[name], (word, size, name)


def test_the_correction_pays_a_hundredfold_at_the_declared_inductance(
    costs: Mapping[tuple[str, float], ReductionCost],
) -> None:
    crude, fine = costs[QUASI_STATIC, 2e-3].measured, costs[CORRECTED, 2e-3].measured
    # Measured 650, 325, 650, 130 and 90 at the landmarks.
    assert all(fine[name] < crude[name] / 50 for name in LANDMARKS)


def test_the_estimate_holds_on_another_machine(problem: Problem) -> None:
    values = _with_inductance(problem, 6e-3, restitution=0.35)
    cost = errors_of_reduced_models(problem, values, measure=True)[QUASI_STATIC]
    for landmark in LANDMARKS:
        assert cost.estimate[landmark] == pytest.approx(cost.measured[landmark], rel=0.1)


def test_a_plastic_impact_has_no_zeno_state_to_compare(problem: Problem) -> None:
    values = _with_inductance(problem, 2e-3, restitution=0.0)
    cost = errors_of_reduced_models(problem, values, measure=True)[QUASI_STATIC]
    assert set(cost.measured) == set(LANDMARKS) - {"zeno_state"}
    for landmark, error in cost.measured.items():
        assert cost.estimate[landmark] == pytest.approx(error, rel=0.05)


@pytest.mark.parametrize("word", [QUASI_STATIC, CORRECTED])
def test_a_reduced_orbit_balances_its_energy_and_is_that_of_a_hand_written_model(
    word: str, problem: Problem
) -> None:
    reduced = problem.at_fidelity(word)
    orbit = orbit_at_gains(reduced, reduced.values()).unwrap()
    certificate = verify(orbit, reduced)
    assert certificate.passed, certificate.verdict()
    assert certificate.residuals["energy_balance"] < 1e-13
    assert certificate.residuals["impact_energy"] < 1e-13
    # Restitution, inertia and powers of the layer included: two derivations, rounding apart.
    assert certificate.residuals["second_model"] < 1e-13


def test_a_wrong_restitution_of_the_layer_is_refused(problem: Problem) -> None:
    reduced = problem.at_fidelity(CORRECTED)

    def careless(p: Mapping[str, ca.SX]) -> CompletedSystem:
        return replace(reduced.model(p), law=ImpactLaw(ca.SX(p["restitution"])))

    # The manifold's inertia with the bare restitution: an orbit, and a consistent one.
    wrong = replace(reduced, model=careless)
    with pytest.raises(InputError, match="formulas of it are replaced"):
        orbit_at_gains(wrong, wrong.values())


@pytest.mark.slow
def test_gains_are_searched_with_the_restitution_that_they_change(problem: Problem) -> None:
    reduced = problem.at_fidelity(CORRECTED)
    # So large an inductance that a program with the restitution of its start does not get there.
    values = reduced.values(parameters={"L": 0.1})
    boxes = {gain.name: (gain.lower, gain.upper) for gain in reduced.gains}
    result = search_orbits(reduced, values, free=boxes, objective=TargetPeriod(target=1.83))
    assert result.unwrap().period == pytest.approx(1.83, abs=1e-9)


# ------------------------------------------------------------------------------------- by name


@pytest.mark.parametrize("word", [QUASI_STATIC, CORRECTED])
def test_a_reduced_problem_is_named_after_its_problem_and_has_no_current(word: str) -> None:
    problem = load_problem(f"motor_pendulum@{word}")
    assert problem.name == f"motor_pendulum@{word}"
    assert problem.state_names == load_problem("motor_pendulum").state_names[:4]
    assert load_problem(f"{PENDULUM}@{word}").name == problem.name


def test_an_unknown_fidelity_is_refused_with_those_there_are() -> None:
    with pytest.raises(InputError, match="motor_pendulum@corrected, motor_pendulum@quasi_static"):
        load_problem("motor_pendulum@coarse")
    with pytest.raises(InputError, match="`bouncing_ball` lacks them"):
        load_problem("bouncing_ball@quasi_static")


@pytest.mark.slow
def test_a_path_that_holds_the_sign_is_a_path(tmp_path: Path) -> None:
    folder = tmp_path / "my@problem"
    folder.mkdir()
    for file in PENDULUM.glob("*.py"):
        (folder / file.name).write_text(file.read_text())
    assert load_problem(folder).name == "motor_pendulum"
    assert load_problem(f"{folder}@quasi_static").name == "motor_pendulum@quasi_static"


def test_no_inductance_is_refused_with_the_problem_to_take_instead(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["simulate", "motor_pendulum", "--set", "L=0"]) == 2
    assert "take `motor_pendulum@quasi_static`" in capsys.readouterr().err
    assert main(["simulate", "motor_pendulum@quasi_static", "--until", "1"]) == 0
    # The corrected drive takes it as its limit.
    problem = load_problem("motor_pendulum")
    corrected = problem.at_fidelity(CORRECTED)
    limit = corrected.dynamics(corrected.values(parameters={"L": 0.0}))
    _, static = _numbers(problem, QUASI_STATIC)
    start = (0.6, 0.0, 0.0, 0.0)
    ends = [simulate(one, start, until=3.0).end_state for one in (limit, static)]
    assert ends[0] == pytest.approx(ends[1], rel=1e-11)


@pytest.mark.slow
def test_an_orbit_file_of_a_reduced_problem_is_found_drawn_and_verified(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "orbit.json"
    assert main(["search", "motor_pendulum@quasi_static", "--set", "Kp=2.5", "-o", str(path)]) == 0
    assert read_orbit(path).problem == "motor_pendulum@quasi_static"
    assert main(["verify", str(path)]) == 0
    assert main(["verify", str(path), "--problem", str(PENDULUM)]) == 0
    assert main(["plot", str(path), "--kind", "region", "-o", str(tmp_path)]) == 0
    capsys.readouterr()
    assert main(["verify", str(path), "--problem", f"{PENDULUM}@corrected"]) == 2
    assert "must be the problem `motor_pendulum@quasi_static`" in capsys.readouterr().err


def test_an_orbit_file_that_names_an_unknown_fidelity_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    problem = load_problem("motor_pendulum@quasi_static")
    orbit = orbit_at_gains(problem, problem.values()).unwrap()
    path = tmp_path / "orbit.json"
    path.write_text(json.dumps({**orbit.as_json(), "problem": "motor_pendulum@coarse"}))
    assert main(["verify", str(path)]) == 2
    assert "motor_pendulum@coarse" in capsys.readouterr().err


@pytest.mark.slow
def test_the_commands_list_the_fidelities_and_say_what_they_cost(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["problems", "--json"]) == 0
    names = [entry["name"] for entry in json.loads(capsys.readouterr().out)]
    assert {"motor_pendulum@quasi_static", "motor_pendulum@corrected"} < set(names)
    assert main(["zeno-condition", "motor_pendulum@quasi_static"]) == 0
    assert "dtheta1" in capsys.readouterr().out
    assert main(["reduced-models", "motor_pendulum", "--json"]) == 0
    told = {entry["problem"]: entry for entry in json.loads(capsys.readouterr().out)}
    assert told["motor_pendulum@quasi_static"]["estimate"]["period"] == pytest.approx(
        2.64e-4, rel=0.01
    )
    assert main(["reduced-models", "bouncing_ball"]) == 2


def test_numbers_without_names_keep_a_cart_of_one_motor_in_step() -> None:
    # The corrected cart follows the full one off the stop, once the current has settled.
    cart, bank = _cart(2e-3)
    full = bound(hybrid_system(cart, full_drive(cart, bank), ca.SX(0.5)))
    corrected = bound(hybrid_system(cart, corrected_drive(cart, bank), ca.SX(0.5)))
    settled = simulate(full, (1.0, 0.0, -KP / R), until=0.05).end_state
    ends = (
        simulate(full, settled, until=0.5).end_state[:2],
        simulate(corrected, settled[:2], until=0.5).end_state,
    )
    # (L/R)^2 = 1e-6, times rates of a few 1/s squared.
    assert ends[0] == pytest.approx(ends[1], abs=1e-5)
    assert np.max(np.abs(ends[0] - ends[1])) > 1e-9
