"""Orbit files: every number comes back bit for bit, and what does not fit is named."""

from __future__ import annotations

import json
import math
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.reference.reference_orbit import ORBIT_KEYS
from tests.support.old_orbit_files import old_data
from tests.support.orbits import changed
from zeno_orbits import orbit_from_json, write_orbit
from zeno_orbits.errors import InputError, OrbitFileError
from zeno_orbits.model import Problem
from zeno_orbits.orbits import (
    Orbit,
    OrbitEvent,
    OrbitImpact,
    OrbitPhase,
    PhaseKind,
    digest_of,
    orbit_of_events,
    read_orbit,
    same_equations,
    sequence_of,
)
from zeno_orbits.verification import OrbitCertificate, with_certificate

OLD_KEYS = {"release_state", "impacts", "zeno_time", "zeno_state"}
"""Entries of format 1 alone."""
NEEDED = ORBIT_KEYS - {"certificate", "versions", "shape", "floquet_multipliers"}

STATE = {"height": 0.1, "speed": -1 / 3}
SMALL = Orbit(
    problem="bouncing_ball",
    parameters={"m": 1.0, "g": 9.81, "restitution": 0.8},
    gains={},
    period=math.pi,
    start_state={},
    events=(),
    floquet_multipliers=(complex(0.1, -0.2),),
    certificate={"passed": True, "residuals": {"closure": None}},
    versions={"python": "3"},
).with_phases(
    (
        OrbitPhase(
            kind=PhaseKind.ZENO,
            start_time=0.0,
            start_state=STATE,
            impacts=(OrbitImpact(time=0.1, state_minus=STATE),),
            zeno_time=math.nextafter(2.0, 3.0),
            zeno_state=STATE,
        ),
    )
)
"""No real orbit: enough to be written and read."""


def _round_trip(orbit: Orbit, folder: Path) -> Orbit:
    path = folder / "orbit.json"
    write_orbit(orbit, path)
    return read_orbit(path)


def _bits(value: float) -> bytes:
    return struct.pack("<d", value)


def _refusal(folder: Path, text: str | bytes) -> str:
    """Return the message with which a file is refused."""
    path = folder / "bad.json"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(OrbitFileError) as caught:
        read_orbit(path)
    message = str(caught.value)
    assert caught.value.path == path
    assert "\n" not in message
    assert message.startswith(f"Orbit file `{path}`: ")
    return message


def _changed(*path: str | int, to: Any) -> str:
    """Return the small orbit's file of an older version with one entry changed."""
    data = old_data(SMALL)
    here: Any = data
    for step in path[:-1]:
        here = here[step]
    here[path[-1]] = to
    return json.dumps(data)


def test_a_found_orbit_comes_back_bit_for_bit(
    orbit: Orbit, certificate: OrbitCertificate, tmp_path: Path
) -> None:
    whole = with_certificate(orbit, certificate)
    again = _round_trip(whole, tmp_path)
    assert again == whole
    write_orbit(whole, str(tmp_path / "by_name.json"))
    assert read_orbit(str(tmp_path / "by_name.json")) == whole
    for name, value in whole.release_state.items():
        assert _bits(again.release_state[name]) == _bits(value)
    for mu, same in zip(whole.floquet_multipliers, again.floquet_multipliers, strict=True):
        assert _bits(mu.real) == _bits(same.real)
        assert _bits(mu.imag) == _bits(same.imag)


def test_the_file_has_every_entry_of_the_contract(
    orbit: Orbit, certificate: OrbitCertificate, problem: Problem
) -> None:
    data = json.loads(json.dumps(with_certificate(orbit, certificate).as_json(), allow_nan=False))
    assert set(data) == ORBIT_KEYS | {"problem_digest"}
    assert data["format"] == 3
    assert data["shape"] == "zeno"
    assert data["sequence"] == ["zeno stop", "release stop"]
    assert data["problem"] == problem.name
    assert data["gains"] == {"Kp": 2.5, "Kd": -1.0}
    assert list(data["parameters"]) == [quantity.name for quantity in problem.parameters]
    for state in (data["start_state"], *(event["state"] for event in data["events"])):
        assert tuple(state) == problem.state_names
    assert all(set(event) == {"name", "time", "state"} for event in data["events"])
    assert [data["events"][k]["name"] for k in (0, -2, -1)] == [
        *("impact stop", "zeno stop", "release stop"),
    ]
    assert all(len(pair) == 2 for pair in data["floquet_multipliers"])
    assert {"passed", "residuals", "margins"} <= set(data["certificate"])
    assert {"zeno_orbits", "casadi", "numpy", "python"} <= set(data["versions"])


def test_an_orbit_gives_the_numbers_of_its_problem(orbit: Orbit, problem: Problem) -> None:
    assert orbit.values(problem) == problem.values()
    with pytest.raises(InputError, match="unknown gain `Ki`"):
        replace(orbit, gains={"Ki": 1.0}).values(problem)


FINITE = st.floats(allow_nan=False, allow_infinity=False)
POSITIVE = st.floats(min_value=0.0, exclude_min=True, allow_infinity=False)
NAMED = st.dictionaries(
    st.text(st.characters(exclude_categories=("C", "Z")), max_size=8), FINITE, max_size=4
)


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    period=POSITIVE,
    zeno_time=POSITIVE,
    state=NAMED,
    times=st.lists(FINITE, max_size=4),
    pair=st.tuples(FINITE, FINITE),
)
def test_any_finite_numbers_and_names_come_back(
    tmp_path: Path,
    period: float,
    zeno_time: float,
    state: dict[str, float],
    times: list[float],
    pair: tuple[float, float],
) -> None:
    original = changed(
        SMALL,
        period=period,
        zeno_time=zeno_time,
        release_state=state,
        impacts=tuple(OrbitImpact(time=time, state_minus=state) for time in times),
        floquet_multipliers=(complex(*pair),),
    )
    path = tmp_path / "orbit.json"
    path.write_text(json.dumps(old_data(original)), encoding="utf-8")
    again = read_orbit(path)
    assert again == original
    assert {k: _bits(v) for k, v in again.release_state.items()} == {
        k: _bits(v) for k, v in state.items()
    }


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    times=st.lists(POSITIVE, min_size=1, max_size=4),
    state=NAMED,
    name=st.sampled_from(["impact a", "zeno b", "release a", "switch edge"]),
)
def test_events_of_any_finite_numbers_come_back(
    tmp_path: Path,
    times: list[float],
    state: dict[str, float],
    name: str,
) -> None:
    events = tuple(OrbitEvent(name=name, time=time, state=state) for time in sorted(times))
    original = replace(SMALL, phases_as=None, events=events, start_state=state, period=max(times))
    again = _round_trip(original, tmp_path)
    assert again == original
    assert [_bits(event.time) for event in again.events] == [_bits(one.time) for one in events]


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_an_orbit_that_is_not_finite_is_not_written(tmp_path: Path, value: float) -> None:
    with pytest.raises(ValueError, match="JSON"):
        write_orbit(replace(SMALL, period=value), tmp_path / "orbit.json")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", sorted(OLD_KEYS | NEEDED))
def test_a_missing_entry_is_named(tmp_path: Path, name: str) -> None:
    data = old_data(SMALL) if name in OLD_KEYS else SMALL.as_json()
    del data[name]
    message = _refusal(tmp_path, json.dumps(data))
    # The format decides how the others are read.
    told = (
        "must be a positive whole number, but it is missing" if name == "format" else "is missing"
    )
    assert f"`{name}` {told}" in message


@pytest.mark.parametrize("name", ["certificate", "versions"])
def test_an_orbit_that_nobody_checked_may_leave_that_out(tmp_path: Path, name: str) -> None:
    data = SMALL.as_json()
    del data[name]
    path = tmp_path / "orbit.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    assert getattr(read_orbit(path), name) == {}


@pytest.mark.parametrize("name", ["time", "state_minus"])
def test_a_missing_entry_of_an_impact_is_named(tmp_path: Path, name: str) -> None:
    data = old_data(SMALL)
    del data["impacts"][0][name]
    assert f"`impacts[0].{name}` is missing" in _refusal(tmp_path, json.dumps(data))


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("format",), "1", "`format` must be a positive whole number, but it is "),
        (("format",), True, "`format` must be a positive whole number, but it is "),
        (("format",), 0, "`format` must be a positive whole number, but it is "),
        (("format",), 1.5, "`format` must be a positive whole number, but it is "),
        (("problem",), 1, "`problem` must be a text, but it is "),
        (("parameters",), [], "`parameters` must be an object with names, but it is "),
        (("parameters", "g"), "9.81", "`parameters.g` must be a number, but it is "),
        (("gains",), None, "`gains` must be an object with names, but it is "),
        (("period",), "1", "`period` must be a number, but it is "),
        (("period",), None, "`period` must be a number, but it is "),
        (("period",), True, "`period` must be a number, but it is "),
        (("period",), -1.0, "`period` must be positive, but it is "),
        (("period",), 0, "`period` must be positive, but it is "),
        (("period",), math.nan, "`period` must be a finite number, but it is "),
        (("period",), math.inf, "`period` must be a finite number, but it is "),
        (("release_state",), 1, "`release_state` must be an object with names, but it is "),
        (("release_state", "speed"), None, "`release_state.speed` must be a number, but it is "),
        (("impacts",), {}, "`impacts` must be a list, but it is "),
        (("impacts", 0), 1, "`impacts[0]` must be an object with names, but it is "),
        (("impacts", 0, "time"), "x", "`impacts[0].time` must be a number, but it is "),
        (("impacts", 0, "time"), math.nan, "`impacts[0].time` must be a finite number, but it is "),
        (
            ("impacts", 0, "state_minus"),
            [],
            "`impacts[0].state_minus` must be an object with names, but it is ",
        ),
        (
            ("impacts", 0, "state_minus", "speed"),
            [],
            "`impacts[0].state_minus.speed` must be a number, but it is ",
        ),
        (("zeno_time",), "x", "`zeno_time` must be a number, but it is "),
        (("zeno_time",), -0.5, "`zeno_time` must be positive, but it is "),
        (("zeno_state",), "x", "`zeno_state` must be an object with names, but it is "),
        (
            ("zeno_state", "height"),
            math.nan,
            "`zeno_state.height` must be a finite number, but it is ",
        ),
        (("floquet_multipliers",), 0.5, "`floquet_multipliers` must be a list, but it is "),
        (
            ("floquet_multipliers", 0),
            0.5,
            "`floquet_multipliers[0]` must be a list of 2, but it is ",
        ),
        (
            ("floquet_multipliers", 0),
            [1, 2, 3],
            "`floquet_multipliers[0]` must be a list of 2, but it is ",
        ),
        (
            ("floquet_multipliers", 0),
            ["a", 2],
            "`floquet_multipliers[0]` must be a number, but it is ",
        ),
        (("certificate",), [], "`certificate` must be an object with names, but it is "),
        (("problem_digest",), 1.0, "`problem_digest` must be a list, but it is "),
        (("problem_digest",), [None], "`problem_digest[0]` must be a number, but it is "),
        (("versions",), "1", "`versions` must be an object with names, but it is "),
    ],
    ids=str,
)
def test_an_entry_of_the_wrong_type_is_named(
    tmp_path: Path, path: tuple[str | int, ...], value: Any, words: str
) -> None:
    assert words in _refusal(tmp_path, _changed(*path, to=value))


def test_a_newer_format_is_refused_before_anything_else(tmp_path: Path) -> None:
    text = json.dumps({"format": 4})
    words = "its format is 4, and the newest this version reads is 3. Update zeno_orbits."
    assert words in _refusal(tmp_path, text)


@pytest.mark.parametrize("part", [0.0, 0.1, 0.5, 0.99])
def test_a_file_that_was_cut_short_is_refused(tmp_path: Path, part: float) -> None:
    text = json.dumps(SMALL.as_json())
    said = "it is not complete JSON" if part else "it is empty"
    assert said in _refusal(tmp_path, text[: int(part * len(text))])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("orbit", "it is not JSON. "),
        ("{'format': 1}", "it is not complete JSON"),
        ('{"format": 1} {}', "it is not complete JSON"),
    ],
)
def test_a_file_that_is_no_json_is_refused(tmp_path: Path, text: str, said: str) -> None:
    assert said in _refusal(tmp_path, text)


@pytest.mark.parametrize("text", ["[]", "1", "null", '"orbit"'])
def test_json_without_names_is_refused(tmp_path: Path, text: str) -> None:
    assert "`the file` must be an object with names" in _refusal(tmp_path, text)


def test_binary_garbage_is_refused(tmp_path: Path) -> None:
    assert "it is not UTF-8 text" in _refusal(tmp_path, b"\x80\xff\x00" * 99)


def test_a_number_too_large_for_a_float_is_refused(tmp_path: Path) -> None:
    text = _changed("period", to=1.0).replace('"period": 1.0', '"period": 1' + 400 * "0")
    assert "`period`" in _refusal(tmp_path, text)


@pytest.mark.parametrize("name", ["period", "start_state", "height", "time"])
def test_a_name_that_occurs_twice_is_refused(tmp_path: Path, name: str) -> None:
    text = json.dumps(SMALL.as_json()).replace(f'"{name}": ', f'"{name}": 1.0, "{name}": ', 1)
    words = f"it names `{name}` twice in one object"
    assert words in _refusal(tmp_path, text)


@pytest.mark.parametrize("digest", [(), (0.1, -1 / 3)])
def test_the_digest_of_the_problem_is_optional(tmp_path: Path, digest: tuple[float, ...]) -> None:
    again = _round_trip(replace(SMALL, problem_digest=digest), tmp_path)
    assert again.problem_digest == digest
    assert ("problem_digest" in again.as_json()) == bool(digest)


def test_deep_nesting_is_refused(tmp_path: Path) -> None:
    assert "JSON" in _refusal(tmp_path, 200_000 * "[")


@pytest.mark.parametrize("name", ["missing.json", "."])
def test_what_is_no_file_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(OrbitFileError, match=r"`.*` cannot be read"):
        read_orbit(tmp_path / name)


# Files of other shapes.

BOUNCE = OrbitImpact(time=0.5, state_minus=STATE)
OTHER = SMALL.with_phases(
    (
        OrbitPhase(
            kind=PhaseKind.ZENO,
            start_time=0.0,
            start_state=STATE,
            impacts=(BOUNCE,),
            zeno_time=0.75,
            zeno_state=STATE,
        ),
        OrbitPhase(
            kind=PhaseKind.ZENO,
            start_time=1.0,
            start_state=STATE,
            impacts=(replace(BOUNCE, time=2.0),),
            zeno_time=2.5,
            zeno_state=STATE,
        ),
    ),
)
"""No real orbit either: two phases."""


@pytest.mark.slow
@given(
    times=st.lists(POSITIVE, min_size=1, max_size=4, unique=True),
    kind=st.sampled_from([PhaseKind.IMPACT, PhaseKind.ZENO]),
    state=NAMED,
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_phases_of_any_finite_numbers_come_back(
    tmp_path: Path, times: list[float], kind: PhaseKind, state: dict[str, float]
) -> None:
    phases = tuple(
        OrbitPhase(
            kind=kind,
            start_time=time if k else 0.0,
            start_state=state,
            impacts=(OrbitImpact(time=time, state_minus=state),),
            zeno_time=time if kind.holds else None,
            zeno_state=state if kind.holds else None,
        )
        for k, time in enumerate(times)
    )
    original = SMALL.with_phases(phases)
    path = tmp_path / "orbit.json"
    path.write_text(json.dumps(old_data(original)), encoding="utf-8")
    assert read_orbit(path) == original


def test_a_file_without_a_shape_is_read_as_older_versions_wrote_it(tmp_path: Path) -> None:
    data = old_data(SMALL)
    del data["shape"]
    path = tmp_path / "orbit.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    assert read_orbit(path) == SMALL
    # A single impact at the Zeno time itself was a plastic one.
    data["zeno_time"] = data["impacts"][0]["time"]
    path.write_text(json.dumps(data), encoding="utf-8")
    assert read_orbit(path).shape.text == "plastic"


def test_one_format_is_written_for_every_orbit() -> None:
    for one in (SMALL, OTHER, THROWN):
        assert one.as_json()["format"] == 3
    assert OTHER.shape.text == "zeno*2"


def _spoilt(*path: str | int, to: Any) -> str:
    data = old_data(OTHER)
    here: Any = data
    for step in path[:-1]:
        here = here[step]
    if to is None:
        del here[path[-1]]
    else:
        here[path[-1]] = to
    return json.dumps(data)


@pytest.mark.parametrize(
    ("path", "to", "words"),
    [
        (("shape",), "zeno", "its `shape` is `zeno`, but its phases are `zeno*2`"),
        (("shape",), "zeno*3", "its `shape` is `zeno*3`, but its phases are `zeno*2`"),
        (("shape",), 2, "`shape` must be a text, but it is "),
        (("shape",), None, "`shape` is missing"),
        (("phases",), [], "`phases` must be a list of one phase or more, but it is []"),
        (("phases",), {}, "`phases` must be a list of one phase or more, but it is {}"),
        (("phases",), None, "`phases` must be a list of one phase or more, but it is missing"),
        (("phases", 0), 1, "`phases[0]` must be an object with names, but it is "),
        (
            ("phases", 1, "kind"),
            "zenon",
            "`phases[1].kind` must be one of zeno, plastic, impact, but it is ",
        ),
        (("phases", 1, "kind"), "impact", "is `impact`, and yet there is a Zeno point"),
        (("phases", 1, "kind"), "plastic", "its phases are not a valid shape: "),
        (
            ("phases", 1, "zeno_time"),
            None,
            "`phases[1].zeno_time` is missing",
        ),
        (("phases", 1, "zeno_time"), -1.0, "`phases[1].zeno_time` must be positive, but it is "),
        (
            ("phases", 1, "zeno_state"),
            None,
            "`phases[1].zeno_state` is missing",
        ),
        (
            ("phases", 1, "start_time"),
            0.0,
            "`phases[1].start_time` must be later than 0, but it is 0",
        ),
        (("phases", 0, "start_time"), 0.5, "`phases[0].start_time` must be 0, but it is 0.5"),
        (
            ("phases", 1, "start_time"),
            math.nan,
            "`phases[1].start_time` must be a finite number, but it is ",
        ),
        (
            ("phases", 1, "start_state"),
            None,
            "`phases[1].start_state` is missing",
        ),
        (
            ("phases", 1, "impacts", 0, "time"),
            "x",
            "`phases[1].impacts[0].time` must be a number, but it is ",
        ),
        (("format",), 1, "`release_state` is missing"),
        (("format",), 3, "`start_state` is missing"),
    ],
)
def test_a_file_of_several_phases_that_contradicts_itself_is_refused(
    tmp_path: Path, path: tuple[str | int, ...], to: Any, words: str
) -> None:
    assert words in _refusal(tmp_path, _spoilt(*path, to=to))


def test_why_phases_are_no_shape_is_told_with_one_full_stop(tmp_path: Path) -> None:
    message = _refusal(tmp_path, _spoilt("phases", 1, "kind", to="plastic"))
    assert "its phases are not a valid shape: " in message
    assert "`zeno,plastic`. `search" in message


def test_a_file_of_one_release_has_the_shape_of_its_phases(tmp_path: Path) -> None:
    said = old_data(SMALL) | {"shape": "zeno*2"}
    assert "its `shape` is `zeno*2`" in _refusal(tmp_path, json.dumps(said))


THROWN = OTHER.with_phases(
    tuple(
        replace(
            phase,
            kind=PhaseKind.IMPACT,
            zeno_time=None,
            zeno_state=None,
            impacts=(replace(BOUNCE, time=time),),
        )
        for phase, time in zip(OTHER.phases, (0.5, math.pi), strict=True)
    )
)
"""No real orbit either: two impacts that the stop throws off."""


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("start_time", math.inf, "`phases[1].start_time` must be a finite number"),
        ("start_state", {"height": math.nan}, "`phases[1].start_state.height` must be a finite"),
        ("zeno_time", 2.5, "`phases[1].kind` is `impact`, and yet there is a Zeno point"),
        ("zeno_state", STATE, "`phases[1].kind` is `impact`, and yet there is a Zeno point"),
    ],
)
def test_a_phase_without_a_zeno_point_is_read_as_strictly(
    tmp_path: Path, name: str, value: Any, words: str
) -> None:
    assert _round_trip(THROWN, tmp_path) == THROWN
    data = old_data(THROWN)
    data["phases"][1][name] = value
    assert words in _refusal(tmp_path, json.dumps(data))


@pytest.mark.parametrize(
    ("name", "value"), [("zeno_time", math.inf), ("zeno_state", {"height": math.nan})]
)
def test_a_zeno_point_of_a_phase_is_finite(tmp_path: Path, name: str, value: Any) -> None:
    assert f"`phases[1].{name}" in _refusal(tmp_path, _spoilt("phases", 1, name, to=value))


def test_a_long_entry_is_told_by_its_first_forty_characters(tmp_path: Path) -> None:
    text = "0123456789" * 9
    told = f'but it is "{text[:39]}'
    for message in (
        _refusal(tmp_path, json.dumps(text)),
        _refusal(tmp_path, json.dumps(old_data(OTHER) | {"phases": text})),
    ):
        assert told in message
        assert f"{told}{text[39]}" not in message


def test_what_is_found_in_place_of_an_entry_is_told_or_that_it_is_missing(tmp_path: Path) -> None:
    def unformatted(data: dict[str, Any]) -> str:
        del data["format"]
        return json.dumps(data)

    for text, found in (
        (_changed("format", to=1.5), "1.5"),
        (_changed("format", to=None), "null"),
        (unformatted(SMALL.as_json()), "missing"),
        (_spoilt("phases", to=None), "missing"),
        (_spoilt("phases", to=[]), "[]"),
        (_spoilt("shape", to=None), None),
        (_spoilt("phases", 1, "kind", to="zenon"), '"zenon"'),
        (_changed("period", to=-1.5), "-1.5"),
        (json.dumps([1, 2]), "[1, 2]"),
    ):
        told = "`shape` is missing" if found is None else f"but it is {found}"
        assert f"{told}. `search PROBLEM -o FILE`" in _refusal(tmp_path, text)


def test_a_file_is_text_for_eyes_with_an_entry_a_line(tmp_path: Path) -> None:
    path = tmp_path / "orbit.json"
    write_orbit(SMALL, path)
    lines = path.read_text(encoding="utf-8").split("\n")
    assert (lines[0], lines[1], lines[-2], lines[-1]) == ("{", '  "format": 3,', "}", "")
    assert '    "height": 0.1,' in lines


# What an orbit says of itself.


def test_an_orbit_in_one_line_has_its_gains_period_shape_multipliers_and_verdict() -> None:
    orbit = replace(
        SMALL,
        gains={"Kp": 2.5, "Kd": -1 / 3},
        floquet_multipliers=(complex(-0.3, 0.4), complex(0.125, 0.0)),
    )
    assert repr(orbit) == (
        "<Orbit of bouncing_ball: Kp=2.5, Kd=-0.3333333, period=3.141592654 s, "
        "sequence=zeno stop, release stop, multipliers of modulus 0.5, 0.125, verified=True>"
    )
    bare = replace(SMALL, floquet_multipliers=(), certificate={"passed": False})
    assert repr(bare) == (
        "<Orbit of bouncing_ball: period=3.141592654 s, sequence=zeno stop, release stop, "
        "verified=False>"
    )
    assert "verified=False" in repr(replace(SMALL, certificate={}))


def test_the_table_of_an_orbit_has_the_time_and_the_state_before_every_event() -> None:
    early, late = {"height": 0.5, "speed": -1.0}, {"height": 0.25, "speed": -2.0}
    (phase,) = SMALL.phases
    impacts = tuple(
        OrbitImpact(time=time, state_minus=state) for time, state in ((0.5, early), (1.0, late))
    )
    orbit = SMALL.with_phases((replace(phase, impacts=impacts),))
    assert {name: list(values) for name, values in orbit._columns().items()} == {
        "event": ["impact stop", "impact stop", "zeno stop", "release stop"],
        "time": [0.5, 1.0, math.nextafter(2.0, 3.0), math.pi],
        "height": [0.5, 0.25, 0.1, 0.1],
        "speed": [-1.0, -2.0, -1 / 3, -1 / 3],
    }


@pytest.mark.parametrize("name", ["release_state", "zeno_time", "zeno_state"])
def test_what_belongs_to_one_zeno_point_is_refused_by_an_orbit_of_two(name: str) -> None:
    with pytest.raises(InputError, match="its shape is `zeno\\*2`"):
        getattr(OTHER, name)


def test_the_numbers_of_one_release_are_those_of_its_phase() -> None:
    (phase,) = SMALL.phases
    assert phase.start_time == 0.0
    assert SMALL.zeno_time == phase.zeno_time == math.nextafter(2.0, 3.0)
    other = changed(SMALL, zeno_state={"height": 7.0}, release_state={"height": 8.0})
    assert (other.zeno_state, other.release_state) == ({"height": 7.0}, {"height": 8.0})


@pytest.mark.parametrize(
    ("times", "kind"),
    [
        ((2.0,), PhaseKind.PLASTIC),
        ((1.0,), PhaseKind.ZENO),
        ((1.0, 2.0), PhaseKind.ZENO),
        ((2.0, 2.0), PhaseKind.ZENO),
    ],
)
def test_one_impact_at_the_zeno_time_itself_is_a_plastic_one(
    times: tuple[float, ...], kind: PhaseKind
) -> None:
    # The first files of the first format do not say the kind of their phase.
    impacts = [{"time": time, "state_minus": STATE} for time in times]
    data = old_data(SMALL) | {"impacts": impacts, "zeno_time": 2.0}
    del data["shape"]
    (phase,) = orbit_from_json(data, Path("orbit.json")).phases
    assert phase.kind is kind
    assert [impact.time for impact in phase.impacts] == list(times)


def test_a_state_after_an_impact_is_written_where_a_phase_begins_and_nowhere_else() -> None:
    first, second = OTHER.phases
    start = {**STATE, "speed": 1.5}
    bounce = replace(first, kind=PhaseKind.IMPACT, zeno_time=None, zeno_state=None)
    held = replace(second, kind=PhaseKind.PLASTIC, start_state=start)
    data = OTHER.with_phases((bounce, held)).as_json()
    assert data["shape"] == "impact,plastic"
    assert data["floquet_multipliers"] == [[0.1, -0.2]]
    assert data["events"] == [
        {"name": "impact stop", "time": 0.5, "state": STATE, "after": start},
        {"name": "impact stop", "time": 2.0, "state": STATE},
        {"name": "zeno stop", "time": 2.5, "state": STATE},
        {"name": "release stop", "time": math.pi, "state": STATE},
    ]


@pytest.mark.parametrize("orbit", [SMALL, OTHER, THROWN])
def test_a_file_of_an_older_version_is_the_same_orbit(tmp_path: Path, orbit: Orbit) -> None:
    path = tmp_path / "old.json"
    path.write_text(json.dumps(old_data(orbit)), encoding="utf-8")
    again = read_orbit(path)
    assert again == orbit
    assert again.phases == orbit.phases
    assert _round_trip(again, tmp_path) == orbit


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"shape": "zeno*2"}, "its `shape` is `zeno*2`, but its events are `zeno stop, release"),
        ({"shape": "zenon"}, "`shape` must be phases such as `zeno` or `impact*2`"),
        ({"sequence": ["zeno stop"]}, "its `sequence` is `zeno stop`, but its events are"),
        ({"events": []}, "it must have at least one event"),
        ({"events": [1]}, "`events[0]` must be an object with names"),
    ],
)
def test_a_file_whose_events_contradict_it_is_refused(
    tmp_path: Path, change: dict[str, Any], words: str
) -> None:
    assert words in _refusal(tmp_path, json.dumps(SMALL.as_json() | change))


def test_a_last_event_beside_the_end_of_the_period_is_refused(tmp_path: Path) -> None:
    data = replace(SMALL, phases_as=None).as_json() | {"period": 3.0}
    assert "its last event is not at the end of its `period`" in _refusal(
        tmp_path, json.dumps(data)
    )
    # That of phases has a residual of its own in a verification.
    path = tmp_path / "orbit.json"
    path.write_text(json.dumps(SMALL.as_json() | {"period": 3.0}))
    assert read_orbit(path) == replace(SMALL, period=3.0)


@pytest.mark.parametrize(("place", "entry"), [(0, "name"), (1, "name"), (2, "after"), (0, "after")])
def test_names_and_states_after_that_the_shape_does_not_have_are_refused(
    tmp_path: Path, place: int, entry: str
) -> None:
    data = SMALL.as_json()
    event = data["events"][place]
    event[entry] = STATE if entry == "after" else event["name"].replace("stop", "lower")
    data["sequence"] = list(sequence_of([one["name"] for one in data["events"]]))
    assert "its `shape` is `zeno`, but its events are" in _refusal(tmp_path, json.dumps(data))


def test_a_state_after_an_event_needs_a_shape(tmp_path: Path) -> None:
    data = replace(SMALL, phases_as=None).as_json()
    data["events"][0]["after"] = STATE
    assert "an event has `after`, which needs a `shape`" in _refusal(tmp_path, json.dumps(data))


def test_an_orbit_without_events_has_no_section() -> None:
    with pytest.raises(InputError, match="must have an event"):
        _ = replace(SMALL, events=(), phases_as=None).section


def test_an_undefined_number_of_an_older_digest_is_no_difference() -> None:
    known = (1.0, 2.0, 3.0, 0.0, 5.0, 6.0)
    assert same_equations(known, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    assert not same_equations(known, (1.0, 2.0, 3.0, 4.0, 5.0, 6.1))
    # Every other number of a machine may be zero.
    assert not same_equations((0.0, *known[1:]), (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    # A graph has a zero where it has no switch.
    assert not same_equations(4 * known, 4 * (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))


def test_events_out_of_order_are_refused(tmp_path: Path) -> None:
    data = SMALL.as_json()
    data["events"][0]["time"] = 2.5
    assert "its `events` are not in order of time" in _refusal(tmp_path, json.dumps(data))


def test_an_orbit_of_several_stops_has_no_phases(tmp_path: Path) -> None:
    orbit = replace(SMALL, phases_as=None)
    assert not orbit.has_phases
    assert orbit.zeno_time == SMALL.zeno_time
    with pytest.raises(InputError, match="one stop, no switch and no kink, but its events are"):
        _ = orbit.phases
    assert "shape" not in orbit.as_json()
    assert _round_trip(orbit, tmp_path) == orbit


def test_a_new_orbit_is_unverified_and_knows_its_problem_and_packages(problem: Problem) -> None:
    values = problem.values(gains={"Kp": 3.0})
    orbit = orbit_of_events(problem, values, period=1.5, start_state={}, events=())
    orbit = orbit.with_phases(SMALL.phases)
    assert (orbit.problem, orbit.period, orbit.phases) == (problem.name, 1.5, SMALL.phases)
    assert orbit.values(problem) == values
    assert orbit.gains["Kp"] == 3.0
    assert (orbit.certificate, orbit.floquet_multipliers) == ({}, ())
    assert orbit.problem_digest == digest_of(problem)
    assert {"zeno_orbits", "casadi", "numpy", "python"} <= set(orbit.versions)
