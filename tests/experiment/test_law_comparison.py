"""Laws of impact compared on event times that a recursion gives."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.commands import MISUSE, YES, ask
from zeno_orbits.errors import InputError

G = 9.81
Law = Callable[[float], float]
HEIGHTS = (0.5, 0.3, 0.7)


def _drop(law: Law, height: float, random: np.random.Generator, scatter: float) -> list[float]:
    """Return the times of the impacts of a ball that falls from rest, with a jitter of 0.2 ms."""
    speed, time = float(np.sqrt(2 * G * height)), 1.5 + float(np.sqrt(2 * height / G))
    times = [time]
    for _ in range(11):
        speed *= law(speed) * (1 + scatter * random.standard_normal())
        time += 2 * speed / G
        times.append(time)
    return [one + 2e-4 * random.standard_normal() for one in times]


def _recorded(law: Law, *, seed: int, scatter: float = 0.0) -> list[str]:
    random = np.random.default_rng(seed)
    names = [f"drop{k}.csv" for k in range(len(HEIGHTS))]
    for name, height in zip(names, HEIGHTS, strict=True):
        lines = [f"{time:.6f}" for time in _drop(law, height, random, scatter)]
        Path(name).write_text("\n".join(["impact [s]", *lines]) + "\n")
    return names


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def _compared(files: list[str], **how: object) -> zo.LawComparison:
    fit = ["restitution"]
    return zo.compare_laws("bouncing_ball", files, fit, initial=["height"], **how)  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_linear_law_is_supported_with_its_values() -> None:
    found = _compared(_recorded(lambda v: 0.8 - 0.06 * v, seed=5))
    assert found.best.law == "linear"
    assert found.verdict == "the recordings support the law `linear`"
    assert [one.is_supported for one in found.fits] == [False, True, False]
    fitted = {one.unknown.label: one for one in found.best.found.fitted}
    assert fitted["restitution"].low < 0.8 < fitted["restitution"].high
    assert fitted["fall"].low < 0.06 < fitted["fall"].high


@pytest.mark.slow
def test_a_power_law_is_supported_with_its_values() -> None:
    first = float(np.sqrt(2 * G * 1.0))
    found = _compared(_recorded(lambda v: min(0.98, 0.7 * (v / first) ** -0.1), seed=6))
    assert found.best.law == "power"
    fitted = {one.unknown.label: one for one in found.best.found.fitted}
    assert fitted["exponent"].low < 0.1 < fitted["exponent"].high


@pytest.mark.slow
@pytest.mark.parametrize("scatter", [0.0, 0.02])
def test_a_constant_restitution_needs_no_further_parameter(scatter: float) -> None:
    found = _compared(_recorded(lambda _: 0.8, seed=7, scatter=scatter))
    assert found.best.law == "constant"
    assert "without a further parameter" in found.verdict
    (one,) = found.best.found.fitted
    assert one.low < 0.8 < one.high


@pytest.mark.slow
def test_command_and_function_agree() -> None:
    files = _recorded(lambda v: 0.8 - 0.06 * v, seed=8)[:1]
    words = ("identify", "bouncing_ball", *files, "--fit", "restitution", "--initial", "height")
    answer = ask(*words, "--law", "constant,linear")
    assert answer.code == YES
    assert answer.out.startswith("Laws of impact: the recordings support the law `linear`.")
    data = ask(*words, "--law", "linear,constant", "--json", "-o", "laws.json").data
    assert data == json.loads(Path("laws.json").read_text())
    assert list(data["laws"]) == ["constant", "linear"]
    found = _compared(files, law=["constant", "linear"])
    assert data == found.as_json()
    assert repr(found).startswith("<LawComparison of bouncing_ball: the recordings support")


def test_wrong_laws_end_in_one_line() -> None:
    files = _recorded(lambda _: 0.8, seed=9)[:1]
    with pytest.raises(InputError, match="must name constant, linear, power, but it names `cubic`"):
        _compared(files, law=["cubic"])
    with pytest.raises(InputError, match="must name at least one"):
        _compared(files, law=[])
    Path("marble.csv").write_text("impact [s]\n0.3\n0.7\n0.9\n")
    with pytest.raises(InputError, match="has the parameter `fall`, and so has `marble_table`"):
        zo.compare_laws("marble_table", "marble.csv", ["restitution"], law=["linear"])
    words = ("identify", "bouncing_ball", *files, "--fit", "restitution")
    answer = ask(*words, "--law", "constant", "--orbit", "orbit.json")
    assert answer.code == MISUSE
    assert "--orbit" in answer.err
    assert "must go without --law" in answer.err
