"""The return map in named coordinates: closed forms, differences, sections, and wrong input."""

from __future__ import annotations

import cmath
import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.orbits import event_orbit
from tests.support.pages import ROOT, blocks
from zeno_orbits.errors import InputError, SimulationError

HOPPER = {"m": 1.0, "a": 20.0, "s": 0.1, "restitution": 0.5, "g": 9.81}


def _hop(w: complex, p: dict[str, complex]) -> tuple[complex, complex]:
    """Return the speed after the next impact and the time until then, from the one before."""
    up = cmath.sqrt(w**2 + 2 * (p["a"] - p["g"]) * p["s"])
    down = cmath.sqrt(w**2 + 2 * p["a"] * p["s"])
    return p["restitution"] * down, (up - w) / (p["a"] - p["g"]) + (up + down) / p["g"]


def _by_complex_step(w: float, name: str) -> tuple[float, float]:
    p: dict[str, complex] = {**HOPPER}
    start = complex(w)
    if name == "w":
        start += 1e-20j
    else:
        p[name] += 1e-20j
    speed, time = _hop(start, p)
    return speed.imag / 1e-20, time.imag / 1e-20


@pytest.fixture(scope="module")
def hopper() -> zo.ReturnMap:
    assert dict(zo.load_problem("hopper").values().parameters) == HOPPER
    return zo.return_map(event_orbit("hopper"))


def test_map_and_derivatives_of_the_hopper_are_its_closed_forms(hopper: zo.ReturnMap) -> None:
    assert hopper.coordinates == ("speed",)
    for w in (hopper.fixed_point[0], 0.6, 2.5):
        found = hopper.slopes([w])
        speed, time = _hop(w, {**HOPPER})
        assert found.point == pytest.approx([speed.real], rel=1e-12)
        assert hopper.map([w]) == pytest.approx([speed.real], rel=1e-12)
        assert found.time == pytest.approx(time.real, rel=1e-12)
        by_speed, time_by_speed = _by_complex_step(w, "w")
        assert found.jacobian == pytest.approx(np.array([[by_speed]]), rel=1e-10)
        assert found.time_jacobian[0] == pytest.approx(time_by_speed, rel=1e-10)
        for k, name in enumerate(hopper.parameter_names):
            wanted = _by_complex_step(w, name)
            assert found.parameter_jacobian[0, k] == pytest.approx(wanted[0], rel=1e-10, abs=1e-12)
            assert found.time_jacobian[1 + k] == pytest.approx(wanted[1], rel=1e-10, abs=1e-12)


def test_values_of_a_map_hold_until_the_return(hopper: zo.ReturnMap) -> None:
    values = {"a": 25.0, "restitution": 0.4}
    speed, _ = _hop(1.2, {**HOPPER, **values})
    assert hopper.map([1.2], parameters=values) == pytest.approx([speed.real], rel=1e-12)
    full = [{**HOPPER, **values}[name] for name in hopper.parameter_names]
    assert hopper.map([1.2], parameters=full) == hopper.map([1.2], parameters=values)
    assert hopper.map([1.2]) != hopper.map([1.2], parameters=values)


MACHINES: dict[str, dict[str, Any]] = {
    "motor_pendulum": {"gains": {"Kp": 2.5, "Kd": -1.1}},
    "clapper": {},
    "relay": {},
    "relay_soft": {},
    "powered_walker": {},
    "limited_pendulum": {},
    "kneed_walker": {},
    "compass_walker": {},
    "sampled_pendulum": {},
    "impact_oscillator": {},
    "table_juggler": {},
    "slope_walker": {},
    "two_motors": {},
}
"""Three have two stops, and six have switches. The gains of `relay_soft` are switching times."""
WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
"""Of the central difference of the eighth order, at distances 1 to 4."""


def _difference(work: Any, size: float) -> Any:
    """Return a central difference of the eighth order."""
    return sum(w * (work(k * size) - work(-k * size)) for k, w in enumerate(WEIGHTS, 1)) / size


@pytest.mark.parametrize("name", fast(2, MACHINES))
def test_derivatives_are_those_of_differences(name: str) -> None:
    found = zo.return_map(zo.find_orbit(name, **MACHINES[name]).unwrap())
    x, sizes = found.fixed_point, found.sizes
    assert found.map(x) == pytest.approx(x, rel=1e-11, abs=1e-12)
    assert np.all(found.errors * sizes / sizes[:, None] < 1e-7 * (1 + np.abs(found.jacobian)))
    for k, unit in enumerate(np.eye(len(x))):
        seen = _difference(lambda s, e=unit: found.map(x + s * e), 3e-4 * sizes[k])
        assert seen * sizes[k] / sizes == pytest.approx(
            found.jacobian[:, k] * sizes[k] / sizes, rel=1e-8, abs=1e-8
        )
        assert found.jvp(x, unit) == pytest.approx(found.jacobian[:, k], rel=1e-12, abs=1e-12)
    for names, slopes, group in (
        (found.gain_names, found.gain_jacobian, "gains"),
        (found.parameter_names[:3], found.parameter_jacobian, "parameters"),
    ):
        for k, one in enumerate(names):
            own = found.values.number(one)

            def moved(s: float, one: str = one, own: float = own, group: str = group) -> Any:
                values: dict[str, Any] = {group: {one: own + s}}
                return found.map(x, **values)

            scale = abs(own) or 1e-3
            seen = _difference(moved, 3e-4 * scale)
            assert seen * scale / sizes == pytest.approx(
                slopes[:, k] * scale / sizes, rel=1e-8, abs=1e-8
            )


@pytest.fixture(scope="module")
def pendulum() -> zo.Orbit:
    return zo.find_orbit("motor_pendulum", gains={"Kp": 2.5, "Kd": -1.1}).unwrap()


def test_sections_of_an_orbit_have_the_same_multipliers(pendulum: zo.Orbit) -> None:
    maps = [zo.return_map(pendulum, section) for section in ("release stop", "zeno stop")]
    release, zeno = ([mu for mu in one.multipliers if abs(mu) > 1e-9] for one in maps)
    assert release == pytest.approx(zeno, rel=1e-9)
    assert [one.event for one in maps] == ["release stop", "zeno stop"]
    assert zo.floquet_multipliers(pendulum).spectral_radius == pytest.approx(
        abs(release[0]), rel=1e-9
    )


def test_gradients_are_adjoint_to_changes(pendulum: zo.Orbit) -> None:
    found = zo.return_map(pendulum)
    rng = np.random.default_rng(1)
    change, weights = rng.normal(size=(2, len(found.fixed_point)))
    by_gains, by_parameters = {"Kp": 0.3, "Kd": -0.2}, {"restitution": 0.1}
    x = found.fixed_point * 1.001
    moved = found.jvp(x, change, by_gains, by_parameters)
    point, gains, parameters = found.vjp(x, weights)
    place = found.parameter_names.index("restitution")
    told = point @ change + gains @ [0.3, -0.2] + 0.1 * parameters[place]
    assert weights @ moved == pytest.approx(told, rel=1e-10)


def test_a_point_is_a_state_from_which_the_motion_returns(pendulum: zo.Orbit) -> None:
    found = zo.return_map(pendulum)
    x = found.fixed_point * [1.01, 0.99]
    state = found.state(x)
    assert found.point(state) == pytest.approx(x, rel=1e-14)
    motion = zo.simulate(
        "motor_pendulum", until=1.3 * found.period, start=state, gains=pendulum.gains
    )
    release = next(one for one in motion.releases if one.time > 0.5 * found.period)
    names = zo.load_problem("motor_pendulum").state_names
    after = dict(zip(names, release.state, strict=True))
    assert found.point(after) == pytest.approx(found.map(x), rel=1e-9)


def test_the_map_of_a_section_that_is_a_point_is_empty() -> None:
    found = zo.return_map(event_orbit("vibrating_table"))
    assert found.coordinates == ()
    assert found.map([]).shape == (0,)
    assert found.jacobian.shape == (0, 0)
    assert found.multipliers == ()
    assert found.state([])["height"] == pytest.approx(0.0, abs=1e-12)


def test_plain_data_has_all_matrices(pendulum: zo.Orbit) -> None:
    found = zo.return_map(pendulum)
    data = found.as_json()
    assert data["jacobian"] == found.jacobian.tolist()
    assert data["gains"] == ["Kp", "Kd"]
    assert np.shape(data["gain_jacobian"]) == (2, 2)
    assert np.shape(data["parameter_jacobian"]) == (2, len(data["parameters"]))
    assert np.shape(data["time_jacobian"]) == (4 + len(data["parameters"]),)
    assert "coordinates dtheta1, current" in repr(found)


@pytest.mark.parametrize(
    ("work", "told"),
    [
        (lambda one: zo.return_map(one, "impact stop"), "accumulate: take `zeno stop`"),
        (
            lambda one: zo.return_map(one, "release floor"),
            "`section` must be an event of the orbit",
        ),
        (
            lambda one: zo.return_map(one).map([1.0]),
            "`x` must be a list of 2 finite numbers (dtheta1, current), but it is `[1.0]`",
        ),
        (lambda one: zo.return_map(one).map([1.0, np.nan]), "`x` must be a list of 2 finite"),
        (lambda one: zo.return_map(one).map([1.0, 1.0], {"kp": 2}), "`gains` has no `kp`. Did you"),
        (lambda one: zo.return_map(one).map([1.0, 1.0], [2.0]), "`gains` must be a list of 2"),
        (
            lambda one: zo.return_map(one).map([1.0, 1.0], parameters={"restitution": np.inf}),
            "`restitution` must be a finite number",
        ),
        (lambda one: zo.return_map(one).vjp([1.0, 1.0], [1.0]), "`weights` must be a list of 2"),
        (lambda one: zo.return_map(one).point({"current": 1.0}), "`state` must have `dtheta1`"),
    ],
)
def test_wrong_input_is_named(pendulum: zo.Orbit, work: Any, told: str) -> None:
    with pytest.raises(InputError) as error:
        work(pendulum)
    assert told in str(error.value)


@pytest.mark.parametrize(
    ("values", "told"),
    [({"m": -1.0}, "`m` must be greater than 0"), ({"restitution": 1.5}, "must lie in [0, 1]")],
)
def test_values_that_the_problem_excludes_are_refused(
    hopper: zo.ReturnMap, values: dict[str, float], told: str
) -> None:
    with pytest.raises(InputError) as error:
        hopper.map([1.0], parameters=values)
    assert told in str(error.value)


def test_a_motion_that_does_not_return_is_an_error(pendulum: zo.Orbit) -> None:
    found = zo.return_map(pendulum)
    with pytest.raises(SimulationError):
        found.map(found.fixed_point * 50)


def test_an_orbit_that_is_not_closed_has_no_map(pendulum: zo.Orbit) -> None:
    moved = {**pendulum.start_state, "current": pendulum.start_state["current"] * 1.01}
    with pytest.raises(InputError, match="must be closed"):
        zo.return_map(replace(pendulum, start_state=moved))


def _block_of_page(name: str, known: dict[str, Any]) -> dict[str, Any]:
    """Run the block of the page that imports a package, and return its names."""
    page = ROOT / "docs" / "return_map.md"
    block = next(one for one in blocks(page) if f"import {name}\n" in one.text)
    exec(compile(block.text, str(page), "exec"), known)
    return known


def test_the_map_has_gradients_in_jax(pendulum: zo.Orbit) -> None:
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    found = zo.return_map(pendulum)
    after = _block_of_page("jax", {"returns": found})["after"]
    gains = np.array([2.5, -1.1])
    by_point, by_gains = jax.jacrev(after, argnums=(0, 1))(found.fixed_point, gains)
    assert np.asarray(by_point) == pytest.approx(found.jacobian, rel=1e-12, abs=1e-14)
    assert np.asarray(by_gains) == pytest.approx(found.gain_jacobian, rel=1e-12, abs=1e-14)


def test_the_map_has_gradients_in_torch(pendulum: zo.Orbit) -> None:
    torch = pytest.importorskip("torch")
    found = zo.return_map(pendulum)
    after = _block_of_page("torch", {"returns": found})["After"].apply
    inputs = (torch.from_numpy(found.fixed_point), torch.tensor([2.5, -1.1], dtype=torch.float64))
    by_point, by_gains = torch.autograd.functional.jacobian(after, inputs)
    assert by_point.numpy() == pytest.approx(found.jacobian, rel=1e-12, abs=1e-14)
    assert by_gains.numpy() == pytest.approx(found.gain_jacobian, rel=1e-12, abs=1e-14)


# Plastic impacts that let go at once, with kinks in the flight up to the one that holds.


def _thrown() -> zo.Problem:
    """Return a mass on a plastic floor that is thrown thrice a period, and a free oscillator."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        clock = zo.Clock.at(1.0)
        c = clock.cosine
        force = -1 + p["a"] * c + 3 * (4 * c**3 - 3 * c) - 0.3 * ca.fmax(0, q[0] - 0.05)
        mass = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.dot(v, v) / 2,
            potential=q[1] ** 2,
            passive_force=ca.vertcat(0, -0.2 * v[1]),
            applied_force=ca.vertcat(force, c),
            clock=clock,
            stops=(zo.Stop(name="floor", gap=q[0], restitution=0.0),),
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    return zo.Problem(
        name="thrown",
        title="thrown mass",
        source="own",
        state_names=("q", "y", "v", "w", "cosine", "sine"),
        state_units=("m", "m", "m/s", "m/s", "1", "1"),
        parameters=(zo.Quantity.positive("a", 0.5, "N", "force"),),
        gains=(),
        model=model,
        starts=({"q": 0.3, "cosine": 1.0},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )


@pytest.mark.slow
def test_a_plastic_impact_that_lets_go_is_no_part_of_a_later_zeno_point(tmp_path: Path) -> None:
    machine = _thrown()
    orbit = zo.find_orbit(machine, until=100.0).unwrap()
    text = ", ".join([*orbit.sequence, *orbit.sequence])
    assert "impact floor, switch kink 1, switch kink 1, zeno floor, release floor" in text
    assert zo.verify(orbit, problem=machine).passed
    # A former file joined the impact and its kinks to the Zeno point.
    zo.write_orbit(orbit, tmp_path / "orbit.json")
    entries = json.loads((tmp_path / "orbit.json").read_text(encoding="utf-8"))
    kinks = ["switch kink 1"] * 2
    places = range(len(entries["sequence"]) - 3)
    (at,) = [k for k in places if entries["sequence"][k : k + 3] == ["impact floor", *kinks]]
    assert entries["sequence"][at + 3] == "zeno floor"
    del entries["sequence"][at : at + 3]
    (tmp_path / "former.json").write_text(json.dumps(entries), encoding="utf-8")
    assert zo.read_orbit(tmp_path / "former.json").sequence == orbit.sequence
    # Another sequence is refused.
    entries["sequence"].remove("release floor")
    (tmp_path / "false.json").write_text(json.dumps(entries), encoding="utf-8")
    with pytest.raises(zo.InputError, match="its `sequence` is"):
        zo.read_orbit(tmp_path / "false.json")
    # Contact forgets the mass. What is left is the oscillator, y'' + 0.2 y' + 2 y.
    root = complex(-0.1, math.sqrt(2 - 0.01))
    for section in ("switch kink 1", "zeno floor", "release floor"):
        spectrum = zo.return_map(orbit, section, problem=machine).multipliers
        largest = sorted(spectrum, key=abs)[-2:]
        wanted = cmath.exp(root * orbit.period)
        assert min(abs(one - wanted) for one in largest) < 1e-6
