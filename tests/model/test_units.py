"""Units of a problem: SI, or another length and mass if all numbers are in it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import pytest

import zeno_orbits as zo
from tests.support.units import Units, in_units
from zeno_orbits.model import powers_of, unit_quotient
from zeno_orbits.model.expressions.formula_units import unit_of
from zeno_orbits.model.expressions.units import energy_unit, in_si, is_rate_of, require_coherent

TABLE = zo.load_problem("vibrating_table")


def in_millimetres(*, but: str = "") -> zo.Problem:
    """Return the shaken table in millimetres, one number of which may be declared in metres."""
    table = in_units(TABLE, Units(length=1e3))

    def declared(name: str, unit: str) -> str:
        return unit if name == but else unit.replace("m", "mm", 1) if unit[0] == "m" else unit

    return replace(
        table,
        state_units=("mm", "mm/s", "1", "1"),
        parameters=tuple(
            replace(one, unit=declared(one.name, one.unit)) for one in table.parameters
        ),
        outputs=tuple(replace(one, unit="mm") for one in table.outputs),
    )


def test_a_problem_in_millimetres_has_the_same_orbit() -> None:
    problem = in_millimetres().checked()
    assert problem.energy_unit == "kg mm^2/s^2"
    assert TABLE.energy_unit == "J"
    orbit, wanted = zo.find_orbit(problem).unwrap(), zo.find_orbit(TABLE).unwrap()
    assert orbit.period == pytest.approx(wanted.period, rel=1e-12)
    work = [one.certificate["energies"]["input_work"] for one in (orbit, wanted)]
    assert work[0] == pytest.approx(1e6 * work[1], rel=1e-9)


@pytest.mark.parametrize("name", ["A", "g"])
def test_a_number_in_metres_among_millimetres_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=rf"`height` counts in mm, and `{name}`.* in m\."):
        in_millimetres(but=name)


def test_units_that_hold_no_length_go_with_all() -> None:
    require_coherent({"x": "mm", "k": "N/m", "F": "mN", "c": "kg/s", "angle": "rad"})
    with pytest.raises(ValueError, match=r"`x` counts in mm, and `F` \(`N`\) in m\."):
        require_coherent({"x": "mm", "F": "N"})
    with pytest.raises(ValueError, match=r"`m` counts in g, and `F` \(`N`\) in kg\."):
        require_coherent({"m": "g", "F": "N"})


def test_a_millimetre_is_no_metre() -> None:
    assert powers_of("mm") != powers_of("m")
    assert powers_of("kg mm/s^2") == powers_of("mN")
    assert energy_unit({"m": "g", "x": "mm"}) == "g mm^2/s^2"
    assert energy_unit({"m": "kg", "angle": "rad"}) == "J"


@pytest.mark.parametrize("unit", ["ms", "deg", "min", "rpm", "kN"])
def test_other_times_angles_and_forces_are_no_units_of_a_problem(unit: str) -> None:
    remedy = r"is not a unit(\. Known units are kg, m, s|: convert the value to `N`)"
    with pytest.raises(ValueError, match=remedy):
        powers_of(unit)


@pytest.mark.parametrize(
    ("text", "unit", "factor"),
    [
        ("s", "s", 1.0),
        ("ms", "s", 1e-3),
        ("us", "s", 1e-6),
        ("µs", "s", 1e-6),
        ("min", "s", 60.0),
        ("deg", "rad", math.pi / 180),
        ("°", "rad", math.pi / 180),
        ("rev", "rad", 2 * math.pi),
        ("deg/s", "rad/s", math.pi / 180),
        ("rpm", "rad/s", 2 * math.pi / 60),
        ("rev/min", "rad/s", 2 * math.pi / 60),
        ("mm/s", "m/s", 1e-3),
        ("mm/s^2", "m/s^2", 1e-3),
        ("m/ms^2", "m/s^2", 1e6),
        ("km", "m", 1e3),
        ("cm", "m", 1e-2),
        ("mA", "A", 1e-3),
        ("mV", "V", 1e-3),
        ("N m s/rad", "N m s/rad", 1.0),
        ("1", "1", 1.0),
    ],
)
def test_a_unit_of_an_instrument_is_so_many_of_ours(text: str, unit: str, factor: float) -> None:
    found, scale = in_si(text)
    assert found == unit
    # A product and a quotient round by at most an ulp each.
    assert scale == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("furlong", "`furlong` is not a unit. Known units are kg, .*deg.*mA"),
        ("counts", r"convert to an angle \[deg\], counts \* 360"),
        ("ticks", "ticks per turn"),
        ("LSB", "converter"),
        ("raw", "instrument"),
        ("", "not a unit"),
        ("rpm/s", "`rpm` must stand alone"),
        ("m/s/s", "is not a unit"),
    ],
)
def test_what_is_no_unit_is_refused_with_a_hint(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        in_si(text)


def test_units_multiply_out() -> None:
    assert powers_of("V s/rad") == powers_of("kg m^2/A s^2 rad")
    assert powers_of("N m/A") == powers_of("kg m^2/s^2 A")
    assert powers_of("ohm") == powers_of("V/A")
    assert powers_of("H/ohm") == {"s": 1}
    assert powers_of("1") == {}
    assert powers_of("1/s") == powers_of("Hz")
    assert is_rate_of("rad/s", "rad")
    assert not is_rate_of("m/s", "rad")
    assert not is_rate_of("m s", "m")


# Matrices in place of energies.


X, ANGLE, LENGTH, SPEED, RATIO = (ca.SX.sym(name) for name in "xalvr")
SYMBOLS = ((X, "m"), (ANGLE, "rad"), (LENGTH, "m"), (SPEED, "m/s"), (RATIO, "1"))


@pytest.mark.parametrize(
    ("formula", "unit"),
    [
        (X, "m"),
        (0.05 - 2 * X, "m"),
        (LENGTH * ca.cos(ANGLE) - X, "m"),
        (LENGTH * ANGLE - X, "m"),
        (ANGLE - 0.1, "rad"),
        (RATIO * ANGLE, "rad"),
        (ca.atan2(X, LENGTH), "rad"),
        (ca.sqrt(X**2 + LENGTH**2) - LENGTH, "m"),
        (ca.sqrt(X), "1"),
        (X**2 - LENGTH * X, "m^2"),
        (X / LENGTH - 1, "1"),
        (SPEED / X, "1/s"),
        (SPEED**2 / LENGTH, "m/s^2"),
        (ca.fmax(0.0, X), "m"),
        (ca.if_else(X > 0, X, 2 * LENGTH), "m"),
        (0.3 + 0.5 * X - 0.1 * X**2, "m"),
        (X**3 / LENGTH**2, "m"),
        (ca.SX(1.0), "1"),
    ],
)
def test_the_unit_of_a_gap_follows_from_the_units_of_its_symbols(formula: ca.SX, unit: str) -> None:
    assert unit_of(formula, SYMBOLS) == unit


@pytest.mark.parametrize(
    ("unit", "by", "quotient"),
    [("m", "s", "m/s"), ("m/s", "s", "m/s^2"), ("J", "rad", "J/rad"), ("J", "1", "J")],
)
def test_a_quotient_of_units_has_one_slash(unit: str, by: str, quotient: str) -> None:
    assert unit_quotient(unit, by) == quotient
    powers_of(quotient)


def test_a_stop_may_declare_its_unit() -> None:
    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        x, v = ca.SX.sym("x"), ca.SX.sym("v")
        floor = zo.Stop(name="floor", gap=x, restitution=p["restitution"], unit="mm")
        curve = zo.Stop(name="curve", gap=4 - x**2, restitution=p["restitution"])
        mass = zo.HybridLagrangian.from_energies(
            q=x, v=v, kinetic=v**2 / 2, potential=x, stops=(floor, curve)
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    ball = zo.load_problem("bouncing_ball")
    problem = replace(ball, model=model)
    assert problem.gap_units == {"floor": "mm", "curve": "m^2"}
    with pytest.raises(ValueError, match="must be one for `floor`, but `metre`"):
        zo.Stop(name="floor", gap=X, restitution=0.5, unit="metre")
