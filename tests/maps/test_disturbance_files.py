"""Files of pushes and recoveries: they read back whole, and what does not fit is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.disturbances import pushes_of, recovery_of
from zeno_orbits.maps import read_pushes, read_recovery


def written(found: zo.Pushes | zo.Recovery, path: Path) -> dict[str, Any]:
    """Write a result as the commands do, and return its plain data."""
    path.write_text(json.dumps(found.as_json(), allow_nan=False))
    return json.loads(path.read_text())


@pytest.mark.parametrize("lost", [0.0, 0.7, 1.0])
def test_pushes_read_back(orbit: zo.Orbit, tmp_path: Path, lost: float) -> None:
    path = tmp_path / "pushes.json"
    pushes = pushes_of(orbit, lost=lost)
    data = written(pushes, path)
    found = read_pushes(path)
    assert found.as_json() == data
    assert found.settings == pushes.settings
    for one, two in zip(found.pushes, pushes.pushes, strict=True):
        assert one.largest == two.largest or (math.isnan(one.largest) and math.isnan(two.largest))
        assert (one.direction, one.phase, one.unit) == (two.direction, two.phase, two.unit)


def test_a_direction_that_was_given_twice_or_reversed_reads_back(
    orbit: zo.Orbit, tmp_path: Path
) -> None:
    path = tmp_path / "pushes.json"
    for again in ({"theta1": 1.0}, {"theta1": -1.0}):
        data = written(pushes_of(orbit, directions=({"theta1": 1.0}, again)), path)
        assert read_pushes(path).as_json() == data


@pytest.mark.parametrize("radius", [0.25, 0.0, math.inf])
@pytest.mark.parametrize("size", [0, 1, 2])
def test_a_recovery_reads_back(
    orbit: zo.Orbit, problem: zo.Problem, tmp_path: Path, radius: float, size: int
) -> None:
    path = tmp_path / "recovery.json"
    made = recovery_of(orbit, problem, radius=radius, size=size)
    data = written(made, path)
    found = read_recovery(path)
    assert found.as_json() == data
    assert found.extents == made.extents
    assert found.directions.shape == made.directions.shape == (5, size)
    assert np.array_equal(found.norm, made.norm)
    assert found.settings == made.settings
    assert (found.units, found.tests, found.radius) == (made.units, made.tests, made.radius)


Change = Callable[[dict[str, Any]], Any]


def entry(*names: str | int, value: Any) -> Change:
    """Return a change of one entry."""

    def change(data: Any) -> None:
        for name in names[:-1]:
            data = data[name]
        data[names[-1]] = value

    return change


def refusal(read: Callable[[Path], Any], path: Path, data: Any) -> str:
    """Return the message of a refused file, which must be one line."""
    path.write_text(json.dumps(data))
    with pytest.raises(zo.InputError) as caught:
        read(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.endswith("Run this command again.")
    return message


PUSH_ENTRIES = ("phase", "direction", "mode", "largest", "error", "beyond", "searched", "unit")
"""Of `docs/pushes.md`."""


@pytest.mark.parametrize("name", PUSH_ENTRIES)
def test_a_push_without_an_entry_is_refused_by_its_name(
    orbit: zo.Orbit, tmp_path: Path, name: str
) -> None:
    path = tmp_path / "pushes.json"
    data = written(pushes_of(orbit), path)
    del data["pushes"][3][name]
    assert f"entry `pushes[3].{name}` is missing" in refusal(read_pushes, path, data)


def test_a_file_without_an_entry_is_refused_by_its_name(
    orbit: zo.Orbit, problem: zo.Problem, tmp_path: Path
) -> None:
    path = tmp_path / "file.json"
    for read, made in (
        (read_pushes, pushes_of(orbit)),
        (read_recovery, recovery_of(orbit, problem)),
    ):
        whole = written(made, path)
        for name in whole:
            rest = {key: value for key, value in whole.items() if key != name}
            assert f"entry `{name}` is missing" in refusal(read, path, rest)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (entry("period", value=-1.0), "`period` is -1.0 and not positive"),
        (entry("period", value="1"), "`period` is "),
        (entry("period", value=math.nan), "it holds NaN"),
        (entry("until", value=0.0), "`until`"),
        (entry("spectral_radius", value=1.5), "`spectral_radius` is 1.5"),
        (entry("spectral_radius", value="nan"), "`spectral_radius`"),
        (entry("steps", value=0), "`steps` must be"),
        (entry("steps", value=2.5), "`steps`"),
        (entry("phases", value=4), "`pushes` is incomplete"),
        (entry("phases", value=10**12), "`phases` must be"),
        (entry("error", value=1.0), "`error` must"),
        (entry("gains", "Kp", value=None), "`gains.Kp`"),
        (entry("gains", "Kp", value="nan"), '`gains.Kp` is "nan" and not a finite number'),
        (entry("pushes", 1, "searched", value="inf"), '`pushes[1].searched` is "inf"'),
        (entry("parameters", value=[1.0]), "`parameters`"),
        (entry("versions", "numpy", value=1), "`versions.numpy`"),
        (entry("pushes", value=[]), "`pushes` is empty"),
        (entry("pushes", value={}), "`pushes` is {}"),
        (lambda data: data["pushes"].pop(), "`pushes` is incomplete"),
        (lambda data: data["pushes"].append(data["pushes"][0]), "`pushes` is incomplete"),
        (entry("pushes", 1, "phase", value=1.0), "`pushes[1].phase` is 1.0"),
        (entry("pushes", 1, "direction", value={"theta1": 0.0}), "`pushes[1].direction` is zero"),
        (entry("pushes", 1, "direction", value={}), "`pushes[1].direction` is zero"),
        (entry("pushes", 1, "direction", value={"theta1": "x"}), "`pushes[1].direction.theta1`"),
        (entry("pushes", 1, "mode", value="rest"), "`pushes[1].mode` is rest"),
        (entry("pushes", 1, "searched", value=0.0), "`pushes[1].searched`"),
        (entry("pushes", 1, "unit", value=""), "`pushes[1].unit` is empty"),
        (entry("pushes", 1, "largest", value=9.0), "`pushes[1].largest` is 9.0"),
        (entry("pushes", 1, "largest", value=-0.1), "`pushes[1].largest` is -0.1"),
        (entry("pushes", 1, "largest", value=None), "`pushes[1].error`"),
        (entry("pushes", 1, "error", value=None), "`pushes[1].error`"),
        (entry("pushes", 1, "error", value=-1.0), "`pushes[1].error` is -1.0"),
        (entry("pushes", 1, "error", value=1e308), "`pushes[1].error` is 1e+308"),
        (entry("pushes", 1, "beyond", value=""), "`pushes[1].beyond`"),
        (entry("least", value=None), "`least` is another push"),
        (entry("least", "phase", value=0.123), "`least` is another push"),
    ],
)
def test_pushes_with_a_false_entry_are_refused_by_its_name(
    orbit: zo.Orbit, tmp_path: Path, change: Change, told: str
) -> None:
    path = tmp_path / "pushes.json"
    data = written(pushes_of(orbit, lost=1.0), path)
    read_pushes(path)
    change(data)
    message = refusal(read_pushes, path, data)
    assert told in message
    assert message.startswith("Argument `pushes` must be a file of `zeno-orbits push -o`, but ")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (entry("period", value=0.0), "`period` is 0.0"),
        (entry("contraction", value=1.0), "`contraction` is 1.0"),
        (entry("part", value=2.0), "`part` must be below 1"),
        (entry("periods", value=0), "`periods` is another number"),
        (entry("periods", value=5), "`time`"),
        (entry("time", value=math.inf), "it holds Infinity"),
        (entry("samples", value=0), "`samples` must be at least 1"),
        (entry("samples", value=131), "`lost_share`"),
        (entry("confidence", value=0.95), "`lost_share`"),
        (entry("lost_share", value=None), "`lost_share`"),
        (entry("tests", value=0), "`tests` is another number"),
        (entry("tests", value=3), "`lost_share`"),
        (entry("radius", value=-1.0), "`radius` is -1.0"),
        (entry("radius", value=None), "`extents` is not null"),
        (entry("extents", value=None), "`extents`"),
        (entry("extents", "theta1", value=-1.0), "`extents.theta1` is -1"),
        (entry("extents", "theta1", value=1e308), "`extents.theta1` is 1e+308"),
        (entry("radius", value=1e308), "`extents."),
        (entry("contraction", value=0.37), "`contraction` is less and not at least the spectral"),
        (entry("periods", value=10**400), "`periods` is "),
        (entry("tests", value=10**400), "`tests` is "),
        (entry("extents", "other", value=1.0), "`extents`"),
        (entry("units", value={"theta1": "rad"}), "`directions`"),
        (entry("norm", value=[[1.0]]), "`directions`"),
        (entry("norm", value=[[1.0, 2.0], [1.0]]), "`norm` is not square"),
        (entry("norm", 0, 1, value=0.4), "`norm`"),
        (entry("norm", 0, 0, value=-1.0), "`norm`"),
        (entry("norm", 0, 0, value="a"), "`norm[0][0]`"),
        (entry("directions", 0, value=[1.0]), "`directions`"),
        (entry("directions", 1, 1, value="nan"), "`directions[1][1]`"),
        (entry("parameters", "g", value="inf"), "`parameters.g`"),
        (entry("seed", value=0.5), "`seed`"),
    ],
)
def test_a_recovery_with_a_false_entry_is_refused_by_its_name(
    orbit: zo.Orbit, problem: zo.Problem, tmp_path: Path, change: Change, told: str
) -> None:
    path = tmp_path / "recovery.json"
    data = written(recovery_of(orbit, problem), path)
    read_recovery(path)
    change(data)
    message = refusal(read_recovery, path, data)
    assert told in message
    assert message.startswith(
        "Argument `recovery` must be a file of `zeno-orbits recovery -o`, but "
    )


@pytest.mark.parametrize("text", ["", "[]", '{"pushes": [', "\xff", '{"a": 1, "a": 1}', "[" * 9999])
def test_a_file_that_is_no_object_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "file.json"
    path.write_bytes(text.encode("latin-1"))
    for read in (read_pushes, read_recovery):
        with pytest.raises(zo.InputError) as caught:
            read(path)
        assert "\n" not in str(caught.value)
    with pytest.raises(zo.InputError, match="cannot be read"):
        read_pushes(tmp_path)
