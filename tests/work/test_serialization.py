"""Plain data holds every bit of a value, or refuses it."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import pytest

from tests.support import chores
from zeno_orbits.errors import InputError
from zeno_orbits.search import SearchSettings
from zeno_orbits.verification.verifier import VerificationSettings
from zeno_orbits.work.serialization import plain


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
    assert plain(value) == expected
    assert type(plain(value)) is type(expected)
    assert json.loads(json.dumps(plain(value), allow_nan=False)) == expected


def test_a_dataclass_is_told_from_another_with_the_same_fields() -> None:
    @dataclass(frozen=True)
    class Other:
        inside: Any
        count: int = 2

    thing = plain(Thing(inside=Colour.RED))
    assert thing == {"kind": "tests.work.test_serialization.Thing", "inside": "RED", "count": 2}
    assert plain(Other(inside=Colour.RED)) != thing


def test_every_bit_of_a_values_counts() -> None:
    least = math.nextafter(3e-10, 1.0)
    assert plain(SearchSettings()) == plain(SearchSettings())
    assert plain(SearchSettings()) != plain(SearchSettings(agreement=least))
    assert plain(VerificationSettings()) != plain(VerificationSettings(n_periods=4))


@pytest.mark.parametrize("value", [object(), lambda: 0, Thing(inside=object()), {1, 2}])
def test_what_plain_data_cannot_hold_is_refused_and_not_left_out(value: Any) -> None:
    with pytest.raises(InputError, match="`accept` must be made of numbers"):
        plain(value, "accept")
