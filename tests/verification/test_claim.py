"""An orbit's numbers become vectors in the order of its problem, or are refused by name."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from zeno_orbits.errors import InputError
from zeno_orbits.orbits import OrbitImpact, OrbitPhase, PhaseKind, ZenoOrbit
from zeno_orbits.verification.claim import claim_of

NAMES = ("b", "a")
PROBLEM: Any = SimpleNamespace(
    name="toy",
    state_names=NAMES,
    gains=[SimpleNamespace(name="Kp")],
    parameters=[SimpleNamespace(name="m"), SimpleNamespace(name="restitution")],
    state_vector=lambda named: [named[name] for name in NAMES],
)


def _x(a: float, b: float) -> dict[str, float]:
    return {"a": a, "b": b}


HELD = OrbitPhase(
    kind=PhaseKind.ZENO,
    start_time=0.0,
    start_state=_x(1.0, 2.0),
    impacts=(
        OrbitImpact(time=0.3, state_minus=_x(3.0, 4.0)),
        OrbitImpact(time=0.4, state_minus=_x(5.0, 6.0)),
    ),
    zeno_time=0.5,
    zeno_state=_x(7.0, 8.0),
)
STRUCK = OrbitPhase(
    kind=PhaseKind.IMPACT, start_time=0.9, start_state=_x(9.0, 10.0), impacts=HELD.impacts[:1]
)


def _orbit(*phases: OrbitPhase, **entries: Any) -> ZenoOrbit:
    named = {
        "problem": "toy",
        "parameters": {"restitution": 0.5, "m": 1.0},
        "gains": {"Kp": 2.0},
        "period": 1.5,
        "certificate": {},
        "versions": {},
        **entries,
    }
    return ZenoOrbit(phases=phases, **named)


def test_states_come_in_the_order_of_the_problem() -> None:
    later = replace(HELD, start_time=0.8, zeno_time=1.2)
    found = claim_of(_orbit(HELD, later), PROBLEM)
    assert (found.shape.text, found.period) == ("zeno*2", 1.5)
    assert found.start.tolist() == [2.0, 1.0]
    for phase, start_time, zeno_time in zip(found.phases, (0.0, 0.8), (0.5, 1.2), strict=True):
        assert phase.start_time == start_time
        assert phase.start.tolist() == [2.0, 1.0]
        assert [time for time, _ in phase.impacts] == [0.3, 0.4]
        assert [x.tolist() for _, x in phase.impacts] == [[4.0, 3.0], [6.0, 5.0]]
        assert phase.zeno is not None
        assert phase.zeno[0] == zeno_time
        assert phase.zeno[1].tolist() == [8.0, 7.0]


def test_a_phase_that_does_not_rest_has_no_zeno_point() -> None:
    assert [phase.zeno for phase in claim_of(_orbit(STRUCK, STRUCK), PROBLEM).phases] == [None] * 2
    # Half a Zeno point is none.
    for missing in ("zeno_time", "zeno_state"):
        half = replace(HELD, **{missing: None})
        assert claim_of(_orbit(half), PROBLEM).phases[0].zeno is None


def _refusal(*phases: OrbitPhase, **entries: Any) -> str:
    with pytest.raises(InputError) as caught:
        claim_of(_orbit(*phases, **entries), PROBLEM)
    return str(caught.value)


def test_an_orbit_of_another_problem_is_refused_with_both_names() -> None:
    message = _refusal(HELD, problem="other")
    assert "`toy`" in message
    assert "`other`" in message


def test_odd_gains_and_parameters_are_named_in_order() -> None:
    assert "the gains of its problem, but these differ: Kp." in _refusal(HELD, gains={})
    # However many there are.
    odd = dict.fromkeys("zyxwabcd", 1.0)
    assert "these differ: Kp, a, b, c, d, w, x, y, z." in _refusal(HELD, gains=odd)
    message = _refusal(HELD, parameters={"restitution": 0.5, "l": 1.0, "m": 2.0})
    assert "the parameters of its problem, but these differ: l." in message


def test_odd_states_are_named_with_the_entry_that_has_them() -> None:
    odd = {"a": 1.0, "c": 1.0}
    for where, phase in (
        ("release_state", replace(HELD, start_state=odd)),
        ("zeno_state", replace(HELD, zeno_state=odd)),
        ("impacts", replace(HELD, impacts=(OrbitImpact(time=0.1, state_minus=odd),))),
    ):
        assert f"`{where}`, but these differ: b, c." in _refusal(phase)
    # A start is called a release only where the orbit has one of them.
    assert "`start_state`" in _refusal(replace(STRUCK, start_state=odd))
    assert "`start_state`" in _refusal(HELD, replace(HELD, start_state=odd))


@pytest.mark.parametrize("kind", list(PhaseKind))
def test_a_phase_without_an_impact_is_refused_and_told_apart(kind: PhaseKind) -> None:
    none = replace(HELD, kind=kind, impacts=())
    assert "lacks an impact." in _refusal(none)
    assert "lacks an impact in phase 2" in _refusal(replace(none, **_one(kind)), none)


@pytest.mark.parametrize("kind", [PhaseKind.PLASTIC, PhaseKind.IMPACT])
def test_a_phase_that_its_first_impact_ends_has_no_more(kind: PhaseKind) -> None:
    two = replace(HELD, kind=kind)
    assert f"one impact, which is `{kind.value}`, but it has 2" in _refusal(two)
    assert "one impact in phase 2, which" in _refusal(replace(two, **_one(kind)), two)
    assert claim_of(_orbit(replace(two, **_one(kind))), PROBLEM).shape.text == kind.value


def _one(kind: PhaseKind) -> dict[str, Any]:
    """Return the entries that make a phase one of a kind with a single impact."""
    return {"kind": kind, "impacts": HELD.impacts[:1]}
