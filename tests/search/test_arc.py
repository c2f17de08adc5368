"""A transcribed arc against polynomial solutions of its flow, which collocation holds exactly."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import radau_scheme
from zeno_orbits.search import TranscriptionSettings
from zeno_orbits.search.transcription.arc import ArcWriter, CollocatedArc, flow_scale
from zeno_orbits.search.transcription.ipopt import IpoptSettings
from zeno_orbits.search.transcription.program import NonlinearProgram, ProgramBuilder

EXACT = 1e-13
LENGTH = 1.5
K, SPEED = 3.0, 0.5
SCALE = np.array([2.0, 40.0])
MESH_NEEDS = TranscriptionSettings(scheme=radau_scheme(2), mesh_tolerance=1e-3)


def _free() -> Any:
    """Return ``x' = k, v' = x``: from rest ``x = k t``, ``v = k t^2 / 2``."""
    y, p = ca.SX.sym("y", 2), ca.SX.sym("p", 1)
    return SimpleNamespace(rate=ca.Function("free", [y, p], [ca.vertcat(p[0], y[0])]))


def _flight() -> Any:
    """Return a rescaled flight: the same times ``w``, a gap of ``t - t^2`` and its rate."""
    y, p = ca.SX.sym("y", 4), ca.SX.sym("p", 2)
    rate = ca.vertcat(p[1] * p[0], p[1] * y[0], y[3], -2)
    return SimpleNamespace(rate=ca.Function("flight", [y, p], [rate]))


def _compiled() -> Any:
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 1)
    powers = ca.Function("powers", [x, p], [ca.vertcat(p[0] * x[0], x[1], 7.0)])
    return SimpleNamespace(n_x=2, free=_free(), flight=_flight(), powers=powers)


def _flown(t: float) -> Vector:
    return np.array([K * t, K * t**2 / 2])


def _rescaled(t: float) -> Vector:
    slow = SPEED * t
    return np.array([K * slow, K * slow**2 / 2, t - t**2, 1 - 2 * t])


def _many(at: Callable[[float], Vector]) -> Callable[[Vector], Vector]:
    """Return the states at many times."""
    return lambda times: np.array([at(float(t)) for t in times])


def _written(flight: bool = False) -> tuple[CollocatedArc, ArcWriter, NonlinearProgram]:
    """Return an arc on its mesh, its writer, and the program with its work and duration told."""
    compiled, program = _compiled(), ProgramBuilder()
    writer = ArcWriter(program, compiled, MESH_NEEDS, ca.MX([K]), SCALE)
    at = _rescaled if flight else _flown
    length = 1.0 if flight else LENGTH
    steps = np.array([0.0, length])
    guess: Any = SimpleNamespace(duration=length, flow_states_at=_many(at), flow_times=steps)
    mode = compiled.flight if flight else compiled.free
    p = ca.MX([K, SPEED]) if flight else writer.p
    arc = writer.collocate("arc", guess, mode, p, ca.MX(ca.DM(at(0.0))))
    program.report("work", arc.work)
    program.report("duration", arc.duration)
    program.report("end", arc.end)
    return arc, writer, program.build()


def _rows(program: NonlinearProgram, scaled: Vector) -> Vector:
    return ca.Function("rows", [program.unknowns], [program.rows])(scaled).full().ravel()


def _told(program: NonlinearProgram) -> dict[str, list[float]]:
    function = ca.Function("told", [program.unknowns], list(program.reports.values()))
    values = function.call([ca.DM(program.guess)])
    return {
        name: value.full().ravel().tolist()
        for name, value in zip(program.reports, values, strict=True)
    }


def test_an_exact_solution_meets_its_rows_and_gives_its_work() -> None:
    arc, _, program = _written()
    assert arc.mesh.tolist() == [0.0, 1.0]
    assert set(program.row_names) == {"continuity[arc, interval 0]"}
    assert _rows(program, program.guess) == pytest.approx(np.zeros(4), abs=EXACT)
    told = _told(program)
    assert told["end"] == pytest.approx(_flown(LENGTH).tolist())
    assert told["duration"] == [LENGTH]
    # The first of the powers alone, k x = k^2 t.
    assert told["work"] == pytest.approx([(K * LENGTH) ** 2 / 2])
    place, shape = program.names["arc stages"]
    assert (place, shape) == (0, (2, 2))
    assert program.scales.tolist() == [*SCALE, *SCALE, LENGTH]
    assert program.guess[-1] == 1.0


def test_a_rescaled_flight_lasts_and_works_in_units_of_its_speed() -> None:
    _, _, program = _written(flight=True)
    assert _rows(program, program.guess) == pytest.approx(np.zeros(8), abs=EXACT)
    told = _told(program)
    # t - t^2 ends where it starts; the flight is as long as it is fast.
    assert told["end"] == pytest.approx(_rescaled(1.0).tolist(), abs=EXACT)
    assert told["duration"] == [SPEED]
    # The power is that of the state, k x; its integral is by the time that passes, w t.
    assert told["work"] == pytest.approx([(K * SPEED) ** 2 / 2])
    assert program.scales[:4] == pytest.approx([*SCALE, 0.25, 1.0])


@pytest.mark.parametrize(("entry", "size"), [(0, 2.0), (1, 40.0)])
def test_a_defect_is_measured_in_the_size_of_its_state(entry: int, size: float) -> None:
    _, _, program = _written()
    scaled = program.guess.copy()
    # The second stage is the end: a change of it moves its own row, and of x also those of v.
    scaled[2 + entry] += 1e-3
    change = np.zeros(4)
    change[2 + entry] = 1e-3
    if entry == 0:
        matrix = MESH_NEEDS.scheme.matrix
        change[1::2] -= LENGTH * matrix[:, 1] * 1e-3 * SCALE[0] / SCALE[1]
    assert _rows(program, scaled) == pytest.approx(change, abs=EXACT)
    assert size == program.scales[entry]


def test_intervals_follow_each_other_from_the_start_of_the_arc() -> None:
    program = ProgramBuilder()
    compiled = _compiled()
    fine = TranscriptionSettings(scheme=radau_scheme(1), mesh_tolerance=1e-2)
    writer = ArcWriter(program, compiled, fine, ca.MX([K]), np.array([1.0, 2.5]))
    start = program.variable("start", _flown(0.0))[:, 0]
    guess: Any = SimpleNamespace(
        duration=1.0, flow_states_at=_many(_flown), flow_times=np.array([0.0, 1.0])
    )
    arc = writer.collocate("arc", guess, compiled.free, writer.p, start)
    # A chord of k t^2 / 2 over h misses it by k h^2 / 8 half way.
    n = 4
    assert arc.mesh.tolist() == [k / n for k in range(n + 1)]
    assert K / n**2 / 8 <= 1e-2 * 2.5 < K / (n / 2) ** 2 / 8
    program.report("work", arc.work)
    built = program.build()
    assert built.row_names[::2] == tuple(f"continuity[arc, interval {k}]" for k in range(n))
    # The implicit Euler rule: x is exact, v misses by k h^2 / 2 in every interval.
    expected = np.tile([0.0, -K / n**2 / 2 / 2.5], n)
    assert _rows(built, built.guess) == pytest.approx(expected, abs=EXACT)
    # It takes the power at the end of an interval.
    assert _told(built)["work"] == pytest.approx([sum(K**2 * k / n for k in range(1, 5)) / n])
    moved = built.guess.copy()
    moved[0] += 0.1
    assert np.flatnonzero(np.abs(_rows(built, moved) - expected) > EXACT).tolist() == [0]
    moved = built.guess.copy()
    moved[2] += 0.1
    assert np.flatnonzero(np.abs(_rows(built, moved) - expected) > EXACT).tolist() == [0, 1, 2]


def test_a_step_is_made_once_for_all_arcs_of_a_flow() -> None:
    program, compiled = ProgramBuilder(), _compiled()
    writer = ArcWriter(program, compiled, MESH_NEEDS, ca.MX([K]), SCALE)
    first = writer._interval(compiled.free)
    assert writer._interval(compiled.free) is first
    assert writer._interval(compiled.flight) is not first


def test_gap_and_rate_of_a_flight_have_the_size_that_they_reach() -> None:
    arc: Any = SimpleNamespace(duration=1.0, flow_states_at=_many(_rescaled))
    # The rate falls from 1 to -1, and the gap is largest half way.
    assert flow_scale(arc, SCALE).tolist() == [*SCALE, 0.25, 1.0]
    falling: Any = SimpleNamespace(
        duration=2.0, flow_states_at=_many(lambda t: np.array([9.0, 9.0, -3.0 * t, 1.0]))
    )
    assert flow_scale(falling, SCALE).tolist() == [*SCALE, 6.0, 1.0]
    plain: Any = SimpleNamespace(duration=LENGTH, flow_states_at=_many(_flown))
    assert flow_scale(plain, SCALE).tolist() == SCALE.tolist()


def test_an_orbit_is_asked_for_far_below_the_agreement_with_its_simulation() -> None:
    settings = TranscriptionSettings()
    assert settings.scheme.n_stages == 7
    # Ends of intervals are a hundred times better than insides; the closure has no such margin.
    assert settings.mesh_tolerance == 3e-8
    assert settings.closure_tolerance == IpoptSettings().tolerance == 1e-11
