"""Plain data holds every bit of a value, or refuses it."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support import chores
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import CheckpointError, InputError
from zeno_orbits.search import SearchSettings
from zeno_orbits.verification import OrbitCertificate, VerificationSettings
from zeno_orbits.work import EntryError, from_plain, read_object, to_plain
from zeno_orbits.work.checkpoint import open_checkpoint


class Colour(Enum):
    """A choice."""

    RED = "a sentence about red"


@dataclass(frozen=True)
class Thing:
    """A value of values."""

    inside: Any
    count: int = 2


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (None, None),
        (True, True),
        (0.1, 0.1),
        (math.inf, "inf"),
        (-math.inf, "-inf"),
        (math.nan, "nan"),
        (1.0 - 2.0j, [1.0, -2.0]),
        (Colour.RED, "RED"),
        ({"a": (1, 2.5)}, {"a": [1, 2.5]}),
        (np.array([[1.0, np.nan]]), [[1.0, "nan"]]),
        (np.float64(0.1), 0.1),
        (chores.square, "tests.support.chores.square"),
    ],
)
def test_a_value_becomes_what_json_holds(value: Any, expected: Any) -> None:
    assert to_plain(value) == expected
    assert type(to_plain(value)) is type(expected)
    assert json.loads(json.dumps(to_plain(value), allow_nan=False)) == expected


def test_a_dataclass_is_told_from_another_with_the_same_fields() -> None:
    @dataclass(frozen=True)
    class Other:
        inside: Any
        count: int = 2

    thing = to_plain(Thing(inside=Colour.RED))
    assert thing == {"kind": "tests.work.test_serialization.Thing", "inside": "RED", "count": 2}
    assert to_plain(Other(inside=Colour.RED)) != thing


def test_every_bit_of_a_values_counts() -> None:
    least = math.nextafter(3e-10, 1.0)
    assert to_plain(SearchSettings()) == to_plain(SearchSettings())
    assert to_plain(SearchSettings()) != to_plain(SearchSettings(agreement=least))
    assert to_plain(VerificationSettings()) != to_plain(VerificationSettings(n_periods=4))


@pytest.mark.parametrize("value", [object(), lambda: 0, Thing(inside=object()), {1, 2}])
def test_what_plain_data_cannot_hold_is_refused_and_not_left_out(value: Any) -> None:
    with pytest.raises(InputError, match="`accept` must consist of values"):
        to_plain(value, "accept")


@dataclass(frozen=True)
class Part:
    """What a whole is made of."""

    number: float
    colour: Colour = Colour.RED
    matrix: Vector = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass(frozen=True)
class Whole:
    """All kinds of fields."""

    parts: tuple[Part, ...]
    pair: tuple[int, str]
    roots: Mapping[str, complex]
    by_colour: Mapping[Colour, float]
    either: Part | Thing | None = None


WHOLE = Whole(
    parts=(Part(number=math.nextafter(0.1, 1.0)), Part(number=-math.inf, matrix=np.eye(2))),
    pair=(3, "x"),
    roots={"a": complex(-0.0, 5e-324)},
    by_colour={Colour.RED: math.pi},
    either=Part(number=1.0),
)


def test_every_bit_of_a_value_comes_back_through_json() -> None:
    told = json.loads(json.dumps(to_plain(WHOLE), allow_nan=False))
    back = from_plain(Whole, told)
    assert to_plain(back) == to_plain(WHOLE)
    assert (back.pair, back.roots, back.by_colour) == (WHOLE.pair, WHOLE.roots, WHOLE.by_colour)
    assert math.copysign(1.0, back.roots["a"].real) == -1.0
    assert back.parts[0].number.hex() == WHOLE.parts[0].number.hex()
    assert back.parts[0].matrix.shape == (0, 3)
    np.testing.assert_array_equal(back.parts[1].matrix, np.eye(2))
    assert isinstance(back.either, Part)


def test_the_certificate_of_an_orbit_comes_back(certificate: OrbitCertificate) -> None:
    assert (
        from_plain(OrbitCertificate, json.loads(json.dumps(to_plain(certificate)))) == certificate
    )


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"parts": 3}, "`parts` must be a list, but it is 3"),
        ({"parts": [{}]}, "`parts[0].number` is missing"),
        ({"parts": [{"number": "1"}]}, '`parts[0].number` must be a number, but it is "1"'),
        ({"parts": [{"number": True}]}, "`parts[0].number` must be a number, but it is true"),
        ({"parts": [{"number": 1, "colour": "BLUE"}]}, "`parts[0].colour` must be one of RED"),
        ({"parts": [{"number": 1, "matrix": ["x"]}]}, "`parts[0].matrix` must be a list of num"),
        ({"pair": [1]}, "`pair` must be a list of 2, but it is [1]"),
        ({"pair": [1.5, "x"]}, "`pair[0]` must be a whole number, but it is 1.5"),
        ({"pair": [1, 2]}, "`pair[1]` must be a text, but it is 2"),
        ({"roots": []}, "`roots` must be an object with names, but it is []"),
        ({"roots": {"a": [1]}}, "`roots.a` must be a list of 2, but it is [1]"),
        ({"either": {"kind": "x"}}, '`either` must be of a known kind, but it is "x"'),
    ],
)
def test_an_entry_that_does_not_fit_is_named(change: Mapping[str, Any], told: str) -> None:
    with pytest.raises(EntryError, match=re.escape(told)):
        from_plain(Whole, {**to_plain(WHOLE), **change})


@pytest.mark.parametrize("number", ["inf", "nan", 10**400], ids=["inf", "nan", "huge"])
def test_numbers_that_are_not_finite_are_refused_where_a_result_must_be(number: Any) -> None:
    told = {"number": number}
    assert not math.isfinite(from_plain(Part, told).number)
    with pytest.raises(EntryError, match="`number` must be a finite number"):
        from_plain(Part, told, finite=True)
    with pytest.raises(EntryError, match="`matrix` must be a list of finite numbers"):
        from_plain(Part, {"number": 1.0, "matrix": [1.0, math.inf]}, finite=True)


@pytest.mark.parametrize(
    ("sizes", "told"),
    [
        ({"a": math.inf, "b": -math.inf}, "`a` must be a finite number"),
        ({"a": 1.0, "b": math.nan}, "`b` must be a finite number"),
        ({"a": 1.0, "b": True}, "`b` must be a number"),
        ({"a": 1.0, "b": None}, "`b` must be a number"),
    ],
)
def test_a_wrong_number_among_named_ones_is_refused(sizes: dict[str, Any], told: str) -> None:
    with pytest.raises(EntryError, match=told):
        from_plain(dict[str, float], sizes, finite=True)


def test_named_numbers_are_read_as_floats_even_if_their_sum_is_infinite() -> None:
    found = from_plain(dict[str, float], {"a": 1e308, "b": 1.5e308, "c": 2}, finite=True)
    assert found == {"a": 1e308, "b": 1.5e308, "c": 2.0}
    assert {type(one) for one in found.values()} == {float}
    whole = {"a": 1e308, "b": 1e308}
    read = from_plain(dict[str, float], whole, finite=True)
    assert read == whole
    assert read is not whole


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('{"a": 1, "b": {"c": 1, "c": 1}}', "names `c` twice"),
        ('{"a": 1', "not complete JSON"),
        ("[" * 100_000, "not complete JSON"),
        (" \n", "it is empty"),
        (b"\xff", "not UTF-8 text"),
        (None, r"cannot be read \(No such file"),
    ],
)
def test_a_file_that_is_no_json_says_why(tmp_path: Path, text: Any, told: str) -> None:
    path = tmp_path / "x.json"
    if text is not None:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=told):
        read_object(path)


WORK = {"work": "test"}


def test_a_chunk_in_the_place_of_another_is_refused_though_its_checksum_is_right(
    tmp_path: Path,
) -> None:
    checkpoint = open_checkpoint(tmp_path, WORK, [1, 1])
    checkpoint.save(0, ["first"])
    assert checkpoint.finished() == {0: ["first"]}
    shutil.copy(tmp_path / "chunk-000000.json", tmp_path / "chunk-000001.json")
    with pytest.raises(CheckpointError, match=r"chunk-000001\.json.*other work or another chunk"):
        checkpoint.finished()


@pytest.mark.parametrize("kept", [0, 1, 3])
def test_a_chunk_with_more_or_fewer_results_than_points_is_refused(
    tmp_path: Path, kept: int
) -> None:
    checkpoint = open_checkpoint(tmp_path, WORK, [2])
    checkpoint.save(0, ["one"] * kept)
    with pytest.raises(CheckpointError, match=f"it has {kept} results in place of 2"):
        checkpoint.finished()
