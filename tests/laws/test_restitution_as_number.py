"""A restitution that is a number of the file equals one that is a parameter, in every command."""

from pathlib import Path

import pytest

import zeno_orbits as zo
from tests.support.commands import NO, YES, ask

FLAP = Path(__file__).parents[1] / "support" / "machines" / "motor_flap.py"
DECLARED = "        Quantity.restitution(0.3),  # of the stop, in [0, 1]\n"


@pytest.fixture
def number(tmp_path: Path) -> str:
    text = FLAP.read_text()
    assert DECLARED in text
    file = tmp_path / "flap.py"
    file.write_text(text.replace(DECLARED, "").replace('p["restitution"])', "0.3)"))
    return str(file)


def test_it_has_the_orbit_the_multipliers_and_the_fates_of_the_parameter(number: str) -> None:
    pairs = [zo.find_orbit(one).unwrap() for one in (number, str(FLAP))]
    periods = [one.period for one in pairs]
    assert periods[0] == pytest.approx(periods[1], rel=1e-14)
    own, other = (zo.floquet_multipliers(one).values for one in pairs)
    assert own == pytest.approx(other, abs=1e-12)
    assert zo.verify(pairs[0], problem=number).passed
    fates = [
        zo.parameter_map(one, x=("Kp", 8.0, 12.0, 2), y=("R", 0.4, 0.6, 2)).attractors
        for one in (number, str(FLAP))
    ]
    assert [one.phrase for one in fates[0]] == [one.phrase for one in fates[1]]


@pytest.mark.slow
def test_no_command_suggests_a_parameter_that_it_lacks(number: str) -> None:
    failed = ask("search", number, "--set", "V0=0.001")
    assert failed.code == NO
    assert "zeno-orbits map" in failed.out
    assert "restitution" not in failed.out


@pytest.mark.slow
def test_the_orbit_of_a_restitution_that_is_a_number_is_proved(number: str, tmp_path: Path) -> None:
    orbit = str(tmp_path / "orbit.json")
    assert ask("search", number, "-o", orbit).code == YES
    assert ask("prove", orbit, "--problem", number).code == YES
