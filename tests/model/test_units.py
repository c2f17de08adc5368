"""Units of a problem: SI, or another length and mass if all numbers are in it."""

from __future__ import annotations

from dataclasses import replace

import pytest

import zeno_orbits as zo
from tests.support.units import Units, in_units
from zeno_orbits.model import powers_of
from zeno_orbits.model.units import energy_unit, require_coherent

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
    with pytest.raises(ValueError, match=rf"`height` counts in mm and `{name}`, in m.*, in m\."):
        in_millimetres(but=name)


def test_units_that_hold_no_length_go_with_all() -> None:
    require_coherent({"x": "mm", "k": "N/m", "F": "mN", "c": "kg/s", "angle": "rad"})
    with pytest.raises(ValueError, match="`x` counts in mm and `F`, in N, in m"):
        require_coherent({"x": "mm", "F": "N"})
    with pytest.raises(ValueError, match="`m` counts in g and `F`, in N, in kg"):
        require_coherent({"m": "g", "F": "N"})


def test_a_millimetre_is_no_metre() -> None:
    assert powers_of("mm") != powers_of("m")
    assert powers_of("kg mm/s^2") == powers_of("mN")
    assert energy_unit({"m": "g", "x": "mm"}) == "g mm^2/s^2"
    assert energy_unit({"m": "kg", "angle": "rad"}) == "J"


@pytest.mark.parametrize("unit", ["ms", "deg", "min", "rpm", "kN"])
def test_other_times_angles_and_forces_are_no_units_of_a_problem(unit: str) -> None:
    with pytest.raises(ValueError, match=r"is not a unit\. Known units are kg, m, s"):
        powers_of(unit)
