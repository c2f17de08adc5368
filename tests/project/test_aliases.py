"""Former public names: an alias warns, and a removed name is refused with its successor."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import zeno_orbits as zo
from zeno_orbits import aliases
from zeno_orbits.aliases import FORMER

REMOVED = [
    (old, new)
    for old, (new, *_) in FORMER.items()
    if old.isidentifier() and new.partition(".")[0] in zo.__all__
]


@pytest.mark.parametrize(("old", "new"), REMOVED)
def test_a_removed_name_is_refused_with_its_successor(old: str, new: str) -> None:
    assert old not in dir(zo)
    with pytest.raises(AttributeError, match=rf"'{old}'\. Did you mean zeno_orbits\.{new}") as told:
        getattr(zo, old)
    assert "\n" not in str(told.value)
    assert not hasattr(zo, old)


def test_every_successor_exists() -> None:
    assert len(REMOVED) > 20
    for _, new in REMOVED:
        found = zo
        for name in new.removesuffix("()").split("."):
            found = getattr(found, name)
        assert callable(found)


def test_a_name_that_never_existed_has_no_successor() -> None:
    with pytest.raises(AttributeError, match=r"has no attribute 'Motorr'$"):
        _ = zo.Motorr


@pytest.mark.parametrize(("old", "new"), REMOVED)
@pytest.mark.parametrize("form", ["zo.{}", "from zeno_orbits import {}"])
def test_a_problem_file_with_a_removed_name_is_refused_with_its_successor(
    old: str, new: str, form: str, tmp_path: Path
) -> None:
    path = tmp_path / "machine.py"
    path.write_text(f"import zeno_orbits as zo\n\n{form.format(old)}\n")
    with pytest.raises(zo.InputError) as refused:
        zo.load_problem(path)
    assert "line 3: `zeno_orbits` lacks" in str(refused.value)
    assert f"`{old}`. Did you mean `{new}`?" in str(refused.value)


@pytest.mark.parametrize(
    ("function", "old", "new"),
    [
        (zo.search_gains, "free", "vary"),
        (zo.continue_orbit, "box", "parameter"),
        (zo.continue_orbit, "second", "parameter2"),
        (zo.prove, "over", "interval"),
    ],
)
def test_a_removed_argument_is_refused_with_its_successor(
    function: object, old: str, new: str
) -> None:
    with pytest.raises(TypeError, match=rf"argument '{old}'\. Did you mean `{new}`\?$"):
        function("forced_oscillator", **{old: None})  # type: ignore[operator]


def test_an_alias_is_the_object_of_its_new_name_and_warns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(aliases, "ALIASES", {"Formerly": ("Clock", "model.clock:Clock")})
    with pytest.warns(
        DeprecationWarning, match=r"zeno_orbits\.Formerly is now zeno_orbits\.Clock"
    ) as told:
        assert zo.Formerly is zo.Clock
    assert told[0].filename == __file__
    assert "Formerly" not in dir(zo)


@pytest.mark.parametrize(
    ("former", "name"),
    [
        ("ZenoOrbit", "Orbit"),
        ("EventOrbit", "Orbit"),
        ("read_event_orbit", "read_orbit"),
        ("write_event_orbit", "write_orbit"),
    ],
)
def test_the_two_kinds_of_orbits_are_one(former: str, name: str) -> None:
    with pytest.warns(DeprecationWarning, match=rf"{former} is now zeno_orbits\.{name}"):
        assert getattr(zo, former) is getattr(zo, name)


def test_no_alias_is_a_public_name() -> None:
    assert not aliases.ALIASES.keys() & {*zo.__all__}


def former(name: str) -> Callable[..., Any]:
    """Return the object of a former name."""
    return getattr(zo, name)


def test_former_entries_of_a_search_take_their_former_arguments() -> None:
    with pytest.warns(DeprecationWarning, match=r"find_event_orbit is now zeno_orbits\.find_orbit"):
        find = former("find_event_orbit")
    orbit = find("hopper", until=50.0, settings=zo.SimulationSettings())
    assert orbit.certificate["passed"]
    assert orbit == zo.find_orbit("hopper").unwrap()
    with pytest.warns(DeprecationWarning, match="search_event_gains is now"):
        search = former("search_event_gains")
    found = search("hopper", vary={"a": (15.0, 40.0)}, objective=zo.MinImpactLoss(), n_starts=0)
    # The loss is the work a s of the push.
    assert found.value == pytest.approx(15.0 * 0.1, rel=1e-8)
    assert len(found.attempts) == 1
    with pytest.raises(zo.InputError, match="`candidates` must be at least 1, but it is 0"):
        search("hopper", vary={}, candidates=0)
