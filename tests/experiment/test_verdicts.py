"""Verdicts on recordings whose truth is known: the orbit, other values, none, not decidable.

Recordings of orbits are sampled from a simulation; those of none are closed forms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from tests.support.cases import fast
from tests.support.commands import NO, YES, ask
from tests.support.recordings_of import recorded, recording_of
from zeno_orbits import write_orbit, write_recording
from zeno_orbits.experiment import (
    ComparisonVerdict,
    OrbitTable,
    Recording,
    compare_recording,
    tabulate_orbit,
)
from zeno_orbits.model import Problem, load_problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.search import orbit_by_shooting

MACHINES = Path(__file__).parents[1] / "support" / "machines"
GAPS = {"motor_flap": "angle", "juggler": "height", "rocking_block": "tilt"}
SAMPLES = 150.37
"""Samples per period, not a whole number: phases differ from cycle to cycle."""


def orbit_of(name: str, **parameters: float) -> tuple[Problem, Orbit, OrbitTable]:
    """Return a machine of the tests with its orbit at some parameters, tabulated."""
    return _orbit_of(name, tuple(parameters.items()))


@lru_cache
def _orbit_of(
    name: str, parameters: tuple[tuple[str, float], ...]
) -> tuple[Problem, Orbit, OrbitTable]:
    problem = load_problem(MACHINES / f"{name}.py")
    orbit = orbit_by_shooting(problem, problem.values(parameters=dict(parameters))).unwrap()
    signals = [one for one in problem.state_names if one not in {"cosine", "sine"}]
    return problem, orbit, tabulate_orbit(orbit, problem, signals)


def copied(name: str, samples: float = SAMPLES, seed: int = 1, **parameters: float) -> Recording:
    """Return twelve cycles of a machine at some parameters with 0.2 % of noise."""
    problem, orbit, table = orbit_of(name, **parameters)
    return recorded(table, problem, rate=samples / orbit.period, noise=2e-3, seed=seed)


def only_gap(name: str, shape: Callable[[np.ndarray], np.ndarray]) -> Recording:
    """Return a gap of a shape over the phase in [0, 1), as high as the orbit's."""
    problem, orbit, table = orbit_of(name)
    height = float(np.ptp(table.nodes.values[:, 0]))
    time = np.arange(int(12 * SAMPLES)) * orbit.period / SAMPLES
    phase = np.mod(time / orbit.period, 1.0)
    noise = 1e-3 * np.random.default_rng(0).normal(size=len(time))
    return recording_of(problem, (GAPS[name],), time, height * (shape(phase) + noise)[None])


SHAPES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "rectified sine": lambda s: np.maximum(np.sin(2 * math.pi * s), 0.0),
    "clipped triangle": lambda s: np.maximum(np.abs(2 * s - 1) - 0.4, 0.0) / 0.6,
    "full-wave rectified sine": lambda s: np.abs(np.sin(math.pi * s)),
    "sine": lambda s: (1 + np.sin(2 * math.pi * s)) / 2,
    "square": lambda s: (s < 0.4).astype(np.float64),
    "parabola and a plastic impact": lambda s: np.maximum(s * (0.7 - s), 0.0) * 8,
    "elastic hops": lambda s: 4 * s * (1 - s),
}


@pytest.mark.slow
@pytest.mark.parametrize("shape", fast(2, SHAPES))
@pytest.mark.parametrize("name", fast(1, GAPS))
def test_a_periodic_signal_of_another_kind_is_no_orbit(name: str, shape: str) -> None:
    problem, orbit, _ = orbit_of(name)
    found = compare_recording(orbit, problem, only_gap(name, SHAPES[shape]))
    assert found.verdict in {ComparisonVerdict.NO_ORBIT, ComparisonVerdict.UNDECIDED}
    assert found.reasons or found.unresolved


@pytest.mark.parametrize("whole", fast(1, [True, False]), ids=["all signals", "the gap alone"])
@pytest.mark.parametrize("name", fast(1, GAPS))
def test_a_recording_reversed_in_time_is_no_orbit(name: str, whole: bool) -> None:
    problem, orbit, _ = orbit_of(name)
    forward = copied(name)
    signals = forward.signals if whole else forward.signals[:1]
    values = np.stack([signal.values[::-1] for signal in signals])
    names = [signal.name for signal in signals]
    found = compare_recording(orbit, problem, recording_of(problem, names, forward.time, values))
    assert found.verdict is ComparisonVerdict.NO_ORBIT
    assert "runs backward" in found.reasons[0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", fast(1, range(3)))
@pytest.mark.parametrize("name", fast(1, GAPS))
def test_a_copy_shows_this_orbit(name: str, seed: int) -> None:
    problem, orbit, _ = orbit_of(name)
    found = compare_recording(orbit, problem, copied(name, seed=seed))
    assert found.verdict is ComparisonVerdict.THIS_ORBIT, found.differences
    assert not found.differences


OTHERS = [
    ("motor_flap", "restitution", 0.2, {"restitution seen"}),
    ("motor_flap", "J", 3e-4, {"period", "highest of angle"}),
    ("juggler", "A", 0.065, {"highest of height", "first impact speed"}),
    ("juggler", "omega", 13.5, {"period"}),
    ("rocking_block", "restitution", 0.25, {"restitution seen"}),
    ("rocking_block", "slenderness", 0.18, {"highest of tilt", "contact duration"}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "parameter", "value", "differing"), fast(1, OTHERS))
def test_a_machine_with_other_values_is_named_as_such(
    name: str, parameter: str, value: float, differing: set[str]
) -> None:
    problem, orbit, _ = orbit_of(name)
    found = compare_recording(orbit, problem, copied(name, **{parameter: value}))
    assert found.verdict is ComparisonVerdict.OTHER_VALUES, (found.reasons, found.unresolved)
    assert differing <= {one.name for one in found.differences}
    # Five standard errors; the rebounds of another machine are not quite the orbit's, stretched.
    true = value if parameter == "restitution" else orbit.parameters["restitution"]
    seen = found.metric("restitution seen")
    assert abs(seen.data - true) < 5 * seen.error < 0.1


@pytest.mark.slow
def test_a_changed_stop_is_no_mistaken_unit() -> None:
    problem = load_problem("forced_oscillator")
    orbit = orbit_by_shooting(problem, problem.values()).unwrap()
    names = ("distance", "speed")
    for stop in (-0.6, -0.45, -0.3):
        other = orbit_by_shooting(problem, problem.values(parameters={"stop": stop})).unwrap()
        # The distance from the stop is up to eight times as large.
        copy = recorded(tabulate_orbit(other, problem, names), problem, rate=24.0, noise=2e-3)
        found = compare_recording(orbit, problem, copy)
        assert found.verdict is ComparisonVerdict.OTHER_VALUES, found.reasons
        assert "highest of distance" in {one.name for one in found.differences}


@pytest.mark.slow
@pytest.mark.parametrize("name", fast(1, GAPS))
def test_samples_that_cannot_resolve_impacts_decide_nothing(name: str) -> None:
    problem, orbit, _ = orbit_of(name)
    found = compare_recording(orbit, problem, copied(name, samples=12.0))
    assert found.verdict is ComparisonVerdict.UNDECIDED
    assert "not resolved" in found.unresolved[0]
    # Neither does a recording without the gap, if it is not the orbit's in every quantity.
    whole = copied(name, restitution=0.35)
    rate = next(k for k, signal in enumerate(whole.signals) if signal.name != GAPS[name])
    signal = whole.signals[rate]
    alone = recording_of(problem, [signal.name], whole.time, signal.values[None])
    found = compare_recording(orbit, problem, alone)
    assert found.verdict is ComparisonVerdict.UNDECIDED
    assert "were not recorded" in found.unresolved[0]


@pytest.mark.slow
def test_the_command_prints_the_verdict_first_and_leaves_with_its_code(tmp_path: Path) -> None:
    _, orbit, _ = orbit_of("juggler")
    write_orbit(orbit, tmp_path / "orbit.json")
    answers = {
        "The recording shows this orbit": (copied("juggler"), YES),
        "with other values": (copied("juggler", A=0.065), YES),
        "does not show a Zeno orbit": (only_gap("juggler", SHAPES["rectified sine"]), NO),
        "cannot decide": (copied("juggler", samples=12.0), NO),
    }
    file = MACHINES / "juggler.py"
    for words, (recording, code) in answers.items():
        write_recording(recording, tmp_path / "data.csv")
        command = ("compare", tmp_path / "orbit.json", tmp_path / "data.csv", "--problem", file)
        answer = ask(*command)
        assert answer.code == code
        assert words in answer.out.splitlines()[0]
        data = ask(*command, "--json").data
        assert data["agrees"] is (code == YES)
        assert data["verdict"] in {one.value for one in ComparisonVerdict}


@pytest.mark.weekly
@pytest.mark.slow
@pytest.mark.parametrize("name", GAPS)
def test_two_standard_errors_hold_the_truth_in_95_of_100(name: str) -> None:
    problem, orbit, table = orbit_of(name)
    inside: dict[str, list[bool]] = {}
    true = {"restitution seen": orbit.parameters["restitution"]}
    for seed in range(40):
        start = float(np.random.default_rng(seed).random())
        rate = SAMPLES / orbit.period
        copy = recorded(table, problem, n_cycles=30, rate=rate, noise=1e-3, seed=seed, start=start)
        for one in compare_recording(orbit, problem, copy).metrics:
            if math.isfinite(one.data):
                off = abs(one.data - true.get(one.name, one.orbit))
                inside.setdefault(one.name, []).append(off <= 2 * one.error)
    # Of 40 at 95 %, fewer than 33 inside has a chance of 4e-4, for each of thirty quantities.
    assert len(inside) > 15
    for quantity, held in inside.items():
        assert sum(held) >= 0.825 * len(held), quantity
