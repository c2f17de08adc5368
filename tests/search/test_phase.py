"""The rows of one phase of an orbit, for a point whose law is simple enough to do them by hand."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.support.hand_made import SCALE, K, compiled, course, rows_of
from zeno_orbits.arrays import Vector
from zeno_orbits.model import GAP, GAP_RATE, ImpactLaw
from zeno_orbits.orbits import RELEASE_ROWS, REST_ROWS, PhaseKind
from zeno_orbits.search import TranscriptionSettings
from zeno_orbits.search.transcription.arc import CollocatedArc
from zeno_orbits.search.transcription.closure import Closure
from zeno_orbits.search.transcription.phase import PhaseWriter, is_rescaled
from zeno_orbits.search.transcription.program import ProgramBuilder

E = 0.5
DIRECTION = np.array([0.25, 1.0])
"""How an impact moves the state for each unit of gap rate."""


def _compiled() -> Any:
    """Return the point of `hand_made` with impacts, a flow on the stop and a power."""
    point = compiled()
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 1)
    rate = ca.Function("locked", [x, p], [ca.vertcat(2 * x[1], p[0])])
    point.impulse = ca.Function("impulse", [x, p], [ca.DM(DIRECTION), p[0]])
    point.locked = SimpleNamespace(rate=rate)
    point.powers = ca.Function("powers", [x, p], [ca.vertcat(p[0] * x[0] + 3, x[1])])
    point.holonomic = lambda at, _: ca.vertcat(10 * at[0] - at[1], 3 * at[1])
    point.free, point.flight = "the free mode", "the flight mode"
    return point


@dataclass
class _Arcs:
    """Transcribes arcs into given states, and keeps what it was asked for.

    Attributes:
        ends: Name to the states at the stages of an arc.
    """

    ends: dict[str, Any]
    asked: dict[str, tuple[Any, ...]] = field(default_factory=dict[str, tuple[Any, ...]])

    def collocate(self, name: str, guess: Any, mode: Any, p: ca.MX, start: ca.MX) -> CollocatedArc:
        self.asked[name] = (guess, mode, p, start)
        k = len(self.asked)
        return CollocatedArc(
            name=name,
            guess=guess,
            mesh=np.array([0.0, 1.0]),
            start=start,
            stages=ca.MX(ca.DM(self.ends[name])),
            duration=ca.MX(float(k)),
            work=ca.MX(10.0**k),
        )


def _flight(gap: float, rate: float = 1.0) -> Any:
    """Return a simulated rescaled flight whose gap reaches a size."""
    state = np.array([1.0, 1.0, -gap, rate])
    return SimpleNamespace(
        duration=1.0,
        flow_state_at=lambda _: state,
        flow_states_at=lambda times: np.tile(state, (len(times), 1)),
    )


def _plain(x: float = 1.0, v: float = 1.0) -> Any:
    """Return a simulated arc in the states themselves, from zero at 5 s to a state at 7 s."""
    still = course((0.0, x), (0.0, v))
    return SimpleNamespace(
        start_time=5.0,
        end_time=7.0,
        duration=2.0,
        state_at=still.state_at,
        flow_state_at=lambda _: still.at(0.0),
    )


def _impacts(*rates: float) -> tuple[Any, ...]:
    return tuple(SimpleNamespace(approach_rate=rate) for rate in rates)


def _writer(arcs: _Arcs, *phases: Any, restitution: float = E) -> Any:
    """Return a writer into an empty program, around what is simulated."""
    point, p = _compiled(), ca.MX([K])
    contact = point.contact
    dynamics: Any = SimpleNamespace(
        restitution=restitution,
        speed_after=lambda rate: -restitution * rate,
        gap=lambda x: float(contact(x, [K])[0]),
        multiplier=lambda x: float(contact(x, [K])[3]),
    )
    cycle: Any = SimpleNamespace(phases=phases, scale=lambda: SCALE)
    law, settings = ImpactLaw(ca.MX(restitution)), TranscriptionSettings()
    writer: Any = PhaseWriter(ProgramBuilder(), point, settings, p, law, (K,), dynamics, cycle)
    assert writer.arcs.settings is settings
    writer.arcs = arcs
    return writer


def _values(writer: Any, *expressions: ca.MX) -> list[list[float]]:
    if not writer.program.blocks:
        writer.program.variable("unused", 0.0)
    return [writer.program.at_guess(one).full().ravel().tolist() for one in expressions]


def _after(state: Vector, rate: float) -> Vector:
    """Return the state after an impact: the rate turns round and is halved."""
    return state - (1 + E) * rate * DIRECTION


# Impacts.

END, SECOND, THIRD = [0.1, -4.0], [0.2, -1.0, 0.05, -0.75], [0.3, -0.5, 0.02, -0.5]


def _three_impacts(nodes: tuple[int, ...]) -> tuple[Any, _Arcs, Any]:
    first, second = _flight(0.4), _flight(0.8)
    arcs = _Arcs(
        {
            "A flight 0": [[9.0, 0.1], [9.0, -4.0]],
            "A flight 1": np.column_stack([np.full(4, 9.0), SECOND]),
            "A flight 2": np.column_stack([np.full(4, 9.0), THIRD]),
        }
    )
    writer = _writer(arcs)
    flight = arcs.collocate("A flight 0", _plain(), "free", writer.p, ca.MX([0.0, 0.0]))
    phase = SimpleNamespace(impacts=_impacts(-4.4, -1.2, -0.5), rescaled_flights=(first, second))
    closure = Closure(n_impacts=3, nodes=nodes, error=0.0)
    return writer, arcs, writer.impacts("A ", flight, phase, closure, 0.5)


def test_each_impact_closes_its_gap_and_turns_the_rate_round() -> None:
    writer, arcs, (hops, _, after) = _three_impacts((0, 2))
    # Guesses of the speeds are those of the simulation, half of 4.4 and of 1.2; the program's own
    # impacts come at -4, and at those speeds times -3/4 and -1/2.
    second, third = -0.75 * 2.2, -0.5 * 0.6
    assert rows_of(writer.program) == {
        "A gap closes at impact 1": [pytest.approx(0.1 / 0.5)],
        "A impact 1 closes the gap": [4.0],
        "A restitution at impact 1": [pytest.approx((2.2 - 2.0) / 2.2)],
        "A gap closes at impact 2": [pytest.approx(0.05 / 0.4)],
        "A impact 2 closes the gap": [pytest.approx(-second)],
        "A restitution at impact 2": [pytest.approx((0.6 + E * second) / 0.6)],
        "A gap closes at impact 3": [pytest.approx(0.02 / 0.8)],
        "A impact 3 closes the gap": [pytest.approx(-third)],
    }
    assert [hop.name for hop in hops] == ["A flight 1", "A flight 2"]
    starts = [_after(np.array(END), -4.0), _after(np.array(SECOND[:2]), second)]
    for k, (start, speed) in enumerate(zip(starts, (2.2, 0.6), strict=True)):
        guess, mode, p, begin = arcs.asked[f"A flight {k + 1}"]
        assert mode == "the flight mode"
        assert guess.flow_state_at(0.0)[-2] == (-0.4, -0.8)[k]
        # Rescaled by the speed, a flight starts from the gap 0 at the rate 1.
        assert _values(writer, p, begin) == [
            pytest.approx([K, speed]),
            pytest.approx([*start, 0.0, 1.0]),
        ]
    assert _values(writer, after) == [pytest.approx(_after(np.array(THIRD[:2]), third))]


def _tail(state: list[float], rate: float, time: float, work: float) -> Vector:
    """Return time, work and state at the end of the flights that follow an impact."""
    resting = np.array(state) - rate * DIRECTION
    # Flights of constant acceleration, each a half of the one before: 2 w / a (1 + 1/2 + ...).
    remaining = 2 * (-E * rate) / (K + resting[0]) * 2
    flow = np.array([2 * resting[1], K])
    power = K * resting[0] + 3
    return np.array([time + remaining, work + remaining * power, *(resting + remaining * flow)])


def test_the_limit_is_extrapolated_from_the_impacts_that_tell_it() -> None:
    writer, _, (_, limit, _) = _three_impacts((0, 2))
    first = _tail(END, -4.0, 1.0, 10.0)
    last = _tail(THIRD[:2], -0.3, 1.0 + 2.0 + 3.0, 10.0 + 100.0 + 1000.0)
    # Estimates differ from their limit by the square of the speed after the impact, 2 and 0.15.
    expected = (2.0**2 * last - 0.15**2 * first) / (2.0**2 - 0.15**2)
    assert _values(writer, limit) == [pytest.approx(expected)]


def test_one_impact_tells_the_limit_by_its_own_tail_and_none_tells_nothing() -> None:
    writer, _, (_, limit, _) = _three_impacts((1,))
    expected = _tail(SECOND[:2], -1.65, 1.0 + 2.0, 10.0 + 100.0)
    assert _values(writer, limit) == [pytest.approx(expected)]
    _, _, (_, nothing, _) = _three_impacts(())
    assert nothing.numel() == 0


def test_a_first_flight_after_an_impact_closes_its_own_scaled_gap() -> None:
    arcs = _Arcs({"flight 0": [[9.0, 0.1], [9.0, -4.0], [9.0, 0.06], [9.0, -0.5]]})
    flight, phase = _flight(0.3), SimpleNamespace(impacts=_impacts(-1.0), rescaled_flights=())
    writer = _writer(arcs)
    phase.flight = flight
    start = writer.program.variable("start", [0.5, 3.0])[:, 0]
    first = writer.first_flight("", phase, start)
    guess, mode, p, begin = arcs.asked["flight 0"]
    assert guess is flight
    assert mode == "the flight mode"
    assert _values(writer, p, begin) == [[K, 3.0], [0.5, 3.0, 0.0, 1.0]]
    # Gap and rate are those of the flight, in units of the speed at which it starts.
    assert _values(writer, *writer.arrival(first, start)) == [[0.06], [-1.5]]
    closure = Closure(n_impacts=1, nodes=(), error=0.0)
    hops, limit, after = writer.impacts("", first, phase, closure, 99.0)
    assert (hops, limit.numel()) == ([], 0)
    rows = rows_of(writer.program)
    assert rows == {
        "gap closes at impact 1": [pytest.approx(0.06 / 0.3)],
        "impact 1 closes the gap": [1.5],
    }
    assert _values(writer, after) == [pytest.approx(_after(np.array([0.1, -4.0]), -1.5))]


def test_a_first_flight_from_a_release_is_in_the_states_themselves() -> None:
    arcs = _Arcs({"A flight 0": [[9.0, 0.1], [9.0, -4.0]]})
    writer = _writer(arcs)
    phase = SimpleNamespace(flight=_plain())
    first = writer.first_flight("A ", phase, ca.MX([0.5, 3.0]))
    guess, mode, p, begin = arcs.asked["A flight 0"]
    assert (guess, mode) == (phase.flight, "the free mode")
    assert _values(writer, p, begin) == [[K], [0.5, 3.0]]
    assert _values(writer, *writer.arrival(first, ca.MX([0.5, 3.0]))) == [[0.1], [-4.0]]


def test_a_rescaled_arc_has_more_states_than_the_problem() -> None:
    assert is_rescaled(_flight(1.0), 2)
    assert not is_rescaled(_plain(), 2)


# Rows of a start.


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (
            RELEASE_ROWS,
            {
                "A release: gap = 0": [0.5 / 0.25],
                "A release: gap rate = 0": [3.0],
                # k x + v, in units of the largest on the stop; it falls with k - v.
                "A release: multiplier = 0": [(K * 0.5 + 3.0) / 7.0],
                "A release: holonomic constraints": [2.0, 9.0],
                "A release: multiplier falls": [K - 3.0],
            },
        ),
        (
            REST_ROWS,
            {
                "A start: gap = 0": [2.0],
                "A start: gap rate = 0": [3.0],
                "A start: holonomic constraints": [2.0, 9.0],
                "A start: the stop is left": [-K - 0.5],
            },
        ),
        (
            (GAP,),
            {
                "A start: gap = 0": [2.0],
                "A start: holonomic constraints": [2.0, 9.0],
                "A start: the stop is left": [3.0],
            },
        ),
    ],
)
def test_a_start_has_the_rows_of_what_ended_the_phase_before(
    rows: tuple[int, ...], expected: dict[str, list[float]]
) -> None:
    locked = (_plain(1.0, -4.0), _plain(2.0, 3.0), _plain(1.0, 1.0))
    writer = _writer(_Arcs({}), *(SimpleNamespace(locked=one) for one in (*locked, None)))
    writer.start("A ", ca.MX([0.5, 3.0]), rows, 0.25)
    assert rows_of(writer.program) == {
        name: [pytest.approx(value) for value in values] for name, values in expected.items()
    }
    equal = {row.names for row in writer.program.equations}
    assert equal == {name for name in [*expected, ""] if "falls" not in name and "left" not in name}


def test_a_period_that_the_stop_never_holds_measures_forces_in_their_own_unit() -> None:
    assert _writer(_Arcs({}), SimpleNamespace(locked=None)).force_scale == 1.0


@pytest.mark.parametrize(
    ("kinds", "restitution", "expected"),
    [
        ((PhaseKind.ZENO, PhaseKind.ZENO), E, [RELEASE_ROWS, RELEASE_ROWS]),
        ((PhaseKind.IMPACT, PhaseKind.IMPACT), E, [(GAP,), (GAP,)]),
        ((PhaseKind.IMPACT, PhaseKind.PLASTIC), 0.0, [RELEASE_ROWS, REST_ROWS]),
    ],
)
def test_a_phase_starts_where_the_one_before_it_ends(
    kinds: tuple[PhaseKind, ...], restitution: float, expected: list[tuple[int, ...]]
) -> None:
    phases = [SimpleNamespace(kind=kind) for kind in kinds]
    writer = _writer(_Arcs({}), *phases, restitution=restitution)
    assert [writer.rows_before(k) for k in range(2)] == expected


# Gaps and forces that do not become negative.


def test_gaps_are_held_at_all_stages_but_the_last() -> None:
    plain = _Arcs({"one": [[0.5, -1.0, 7.0], [1.0, 1.0, 1.0]]})
    scaled = _Arcs({"two": [[1.0] * 3, [1.0] * 3, [0.3, -0.6, 7.0], [1.0] * 3]})
    writer = _writer(plain)
    flights = (
        plain.collocate("one", _plain(), "free", writer.p, ca.MX([0.0, 0.0])),
        scaled.collocate("two", _flight(1.2), "flight", writer.p, ca.MX([0.0, 0.0, 0.0, 1.0])),
    )
    writer.keep_apart("A ", flights, 0.25)
    assert rows_of(writer.program) == {
        "A gap >= 0 in flight 0": pytest.approx([2.0, -4.0]),
        "A gap >= 0 in flight 1": pytest.approx([0.25, -0.5]),
    }
    # They are inequalities all.
    assert [row.names for row in writer.program.equations] == [""]


# Where phases meet.


def test_phases_meet_along_the_section_only() -> None:
    writer = _writer(_Arcs({}))
    writer.compiled.holonomic = lambda *_: ca.SX(0, 1)
    end, start = ca.MX([1.0, 2.0]), ca.MX([5.0, 2.5])
    # On the gap's section the second state alone may differ, by 0.5 of a size of 0.5.
    writer.join("A ", SimpleNamespace(start=SimpleNamespace(state=[0.0, 0.0])), end, start, (GAP,))
    tangent = writer.close([0.0, 0.0], start, end, (GAP_RATE,))
    assert np.abs(tangent) == pytest.approx(np.array([[1.0], [0.0]]))
    rows = rows_of(writer.program)
    assert list(rows) == ["A it starts at the end of the last phase", "the orbit closes"]
    assert np.abs(rows["A it starts at the end of the last phase"]) == pytest.approx([1.0])
    assert rows["the orbit closes"] == pytest.approx([(1.0 - 5.0) / 4.0 * tangent[0, 0]])


def test_a_section_leaves_what_moves_none_of_its_rows_in_scaled_states() -> None:
    writer = _writer(_Arcs({}))
    writer.compiled.holonomic = lambda *_: ca.SX(0, 1)
    # The multiplier k x + v, by scaled states 8 and 1/2.
    tangent = writer._stop_tangent(np.zeros(2), (3,))
    assert tangent.shape == (2, 1)
    assert np.abs(tangent[:, 0]) == pytest.approx(np.array([0.5, 8.0]) / np.hypot(0.5, 8.0))
    assert tangent[0, 0] * tangent[1, 0] < 0.0
    # Whatever else a state must meet is held, too.
    held = _writer(_Arcs({}))
    assert held._stop_tangent(np.zeros(2), (GAP,)).shape == (2, 0)


# Whole phases.


def _phase(held: bool, *rows: int, restitution: float = E) -> tuple[Any, Any, _Arcs]:
    """Return a writer, a phase of one impact written by it, and the arcs."""
    locked = _plain(-3.0, -1.0) if held else None
    arcs = _Arcs(
        {
            "A flight 0": [[0.2, 0.1], [9.0, -4.0]],
            "A locked": [[0.5, 0.25, 7.0], [1.0, -2.0, 8.0]],
        }
    )
    phase: Any = SimpleNamespace(
        start=SimpleNamespace(state=np.array([0.5, 3.0])),
        flight=_plain(0.8, -4.0),
        rescaled_flights=(),
        impacts=_impacts(-4.4),
        zeno=SimpleNamespace(state=np.array([2.0, 1.0])) if held else None,
        locked=locked,
    )
    writer = _writer(arcs, phase, restitution=restitution)
    closure = Closure(n_impacts=1, nodes=(0,) if held else (), error=0.0)
    return writer, writer.phase("A ", phase, closure, rows), arcs


def _reports(program: ProgramBuilder) -> dict[str, list[list[float]]]:
    built = program.build()
    function = ca.Function("told", [built.unknowns], list(built.reports.values()))
    values = function.call([ca.DM(built.guess)])
    return {name: one.full().tolist() for name, one in zip(built.reports, values, strict=True)}


def test_a_phase_that_the_stop_holds_lasts_to_the_end_of_its_locked_arc() -> None:
    writer, written, arcs = _phase(True, *RELEASE_ROWS)
    limit = _tail(END, -4.0, 1.0, 10.0)
    zeno = np.array([2.0, 1.0])
    rows = rows_of(writer.program)
    assert rows["A Zeno point"] == pytest.approx(((zeno - limit[2:]) / SCALE).tolist())
    # The size of the gap is the largest in the first flight, of the force that on the stop.
    assert rows["A gap closes at impact 1"] == pytest.approx([0.1 / 0.8])
    assert rows["A gap >= 0 in flight 0"] == pytest.approx([0.2 / 0.8])
    force = abs(K * -3.0 - 1.0)
    assert rows["A multiplier >= 0 on the stop"] == pytest.approx([2.0 / force, -1.5 / force])
    assert rows["A Zeno point: d2h/dt2 < 0"] == [K + 2.0]
    assert rows["A release: multiplier = 0"] == pytest.approx([(K * 0.5 + 3.0) / force])
    assert [block.name for block in writer.program.blocks] == ["A release state", "A Zeno state"]
    for block in writer.program.blocks:
        assert block.scale.tolist() == SCALE.tolist()
    guess, mode, p, start = arcs.asked["A locked"]
    assert mode is writer.compiled.locked
    assert guess.state_at(7.0).tolist() == [-3.0, -1.0]
    assert _values(writer, p, start) == [[K], [2.0, 1.0]]
    terms = written.terms
    assert (terms.label, written.rows) == ("A ", REST_ROWS)
    assert [arc.name for arc in terms.arcs] == ["A flight 0", "A locked"]
    found = _values(writer, terms.start, terms.zeno, terms.approach_rate, written.end)
    assert found == [[0.5, 3.0], [2.0, 1.0], [-4.0], [7.0, 8.0]]
    totals = _values(writer, written.limit_time, written.duration, written.work)
    assert totals == [[pytest.approx(one)] for one in (limit[0], limit[0] + 2.0, limit[1] + 100.0)]
    told = _reports(writer.program)
    assert told == {"A impact states": [[0.1], [-4.0]], "A flight times": [[1.0]]}


@pytest.mark.parametrize("plastic", [True, False])
def test_a_phase_that_lets_go_ends_with_its_impact(plastic: bool) -> None:
    rate = -4.0
    writer, written, _ = _phase(False, GAP, restitution=0.0 if plastic else E)
    terms = written.terms
    assert (terms.zeno, terms.locked) == (None, None)
    assert [arc.name for arc in terms.arcs] == ["A flight 0"]
    assert written.rows == (REST_ROWS if plastic else (GAP,))
    assert [block.name for block in writer.program.blocks] == ["A start state"]
    found = _values(writer, written.end, written.limit_time, written.duration, written.work)
    after = np.array(END) - rate * DIRECTION if plastic else _after(np.array(END), rate)
    assert found == [pytest.approx(after), [1.0], [1.0], [10.0]]
    assert _values(writer, terms.start, terms.approach_rate) == [[0.5, 3.0], [rate]]
    rows = rows_of(writer.program)
    assert rows["A gap >= 0 in flight 0"] == pytest.approx([0.2 / 0.8])
    assert rows["A start: gap = 0"] == pytest.approx([0.5 / 0.8])
