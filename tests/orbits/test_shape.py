"""Shapes of orbits: what can be one, how it is written, and which are others gone round again."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zeno_orbits.errors import InputError
from zeno_orbits.orbits import ONE_ZENO, EventSequence, PhaseKind

ZENO, PLASTIC, IMPACT = PhaseKind.ZENO, PhaseKind.PLASTIC, PhaseKind.IMPACT

KINDS = st.one_of(
    st.lists(st.just(ZENO), min_size=1, max_size=9),
    st.lists(st.just(IMPACT), min_size=1, max_size=9),
    st.lists(st.sampled_from([PLASTIC, IMPACT]), max_size=8).map(lambda kinds: [*kinds, PLASTIC]),
)
"""Every kind of period that there is."""


@pytest.mark.parametrize(
    ("text", "kinds"),
    [
        ("zeno", (ZENO,)),
        ("zeno*3", 3 * (ZENO,)),
        ("impact*2", 2 * (IMPACT,)),
        ("impact*2,plastic", (IMPACT, IMPACT, PLASTIC)),
        ("plastic,impact,plastic*2", (PLASTIC, IMPACT, PLASTIC, PLASTIC)),
    ],
)
def test_a_shape_is_read_and_written(text: str, kinds: tuple[PhaseKind, ...]) -> None:
    shape = EventSequence.parsed(text)
    assert shape.phases == kinds
    assert shape.text == text
    assert EventSequence.parsed(text.replace(",", " , ")) == shape


@given(KINDS)
def test_every_shape_is_read_as_it_is_written(kinds: list[PhaseKind]) -> None:
    shape = EventSequence(phases=tuple(kinds))
    assert EventSequence.parsed(shape.text) == shape
    assert shape.n_phases == len(kinds)
    assert shape.n_releases == len(kinds) - kinds.count(IMPACT)


@pytest.mark.slow
@given(KINDS, st.integers(min_value=2, max_value=4))
def test_a_shape_gone_round_again_names_what_it_goes_round(
    kinds: list[PhaseKind], times: int
) -> None:
    shape = EventSequence(phases=tuple(kinds))
    again = EventSequence(phases=times * shape.phases)
    assert shape in again.shorter
    assert all(len(again.phases) % len(one.phases) == 0 for one in again.shorter)
    assert again not in again.shorter


@pytest.mark.parametrize(
    "text",
    ["", "zeno*0", "zeno*-1", "zeno*", "zeno*x", "Zeno", "zeno;zeno", "zeno*1e3", "impact*²", ","],
)
def test_a_text_that_is_no_shape_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="`shape` must be zeno, plastic or impact"):
        EventSequence.parsed(text)


def test_a_slip_of_the_pen_makes_no_period_of_a_million_phases() -> None:
    with pytest.raises(InputError, match="but it is `impact\\*1000000`"):
        EventSequence.parsed("impact*1000000")


@pytest.mark.parametrize(
    ("text", "n"), [("impact*1000", 1000), ("impact*500,impact*499,plastic", 1000)]
)
def test_a_period_has_a_thousand_phases_at_most(text: str, n: int) -> None:
    assert EventSequence.parsed(text).n_phases == n
    with pytest.raises(InputError, match="`shape` must be zeno"):
        EventSequence.parsed(f"impact,{text}")


@pytest.mark.parametrize("text", ["zeno,impact", "plastic,zeno", "impact,zeno,impact"])
def test_impacts_of_an_accumulation_are_no_phases_of_their_own(text: str) -> None:
    with pytest.raises(InputError, match="must not mix zeno"):
        EventSequence.parsed(text)


def test_a_period_with_a_release_starts_at_one() -> None:
    with pytest.raises(InputError, match="must end with the plastic impact"):
        EventSequence.parsed("plastic,impact")
    with pytest.raises(InputError, match="must have a phase"):
        EventSequence(phases=())


def test_the_stop_decides_whether_what_holds_accumulates() -> None:
    assert ONE_ZENO.at_restitution(0.0).text == "plastic"
    assert EventSequence.parsed("plastic*2").at_restitution(0.3).text == "zeno*2"
    assert EventSequence.parsed("impact*2").at_restitution(0.0).text == "impact*2"


def test_a_plastic_shape_agrees_with_an_accumulating_one_and_with_no_other() -> None:
    plastic = EventSequence.parsed("plastic")
    assert plastic.agreed(ONE_ZENO) is plastic
    assert plastic.agreed(None) is plastic
    with pytest.raises(InputError, match="must be the shape `plastic` of the orbit"):
        plastic.agreed(EventSequence.parsed("impact"))


@pytest.mark.parametrize("shape", [ONE_ZENO, EventSequence.parsed("plastic")])
def test_one_phase_that_holds_has_one_release(shape: EventSequence) -> None:
    shape.require_one_release()


@pytest.mark.parametrize("text", ["zeno*2", "impact", "impact,plastic"])
def test_what_needs_one_release_says_which_shape_it_was_given(text: str) -> None:
    shape = EventSequence.parsed(text)
    with pytest.raises(InputError, match="one Zeno point and one release") as caught:
        shape.require_one_release()
    assert f"its shape is `{text}`" in str(caught.value)
