"""The command `trade`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.loop.agreement import needs_compiler
from tests.support.commands import (
    INTERRUPTED,
    NO,
    YES,
    Answer,
    ask,
    contents,
    raising,
)
from zeno_orbits.precision import read_work_precision

pytestmark = pytest.mark.usefixtures("here")


TRADING = (
    *("work-precision", "bouncing_ball", "--quick"),
    *("--set", "restitution=0.5", "--until", "1.5"),
)


@pytest.fixture(name="traded", scope="module")
def _traded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Answer, Path]:
    """What `trade` prints as JSON, and the folder with what it writes."""
    folder = tmp_path_factory.mktemp("traded")
    outputs = ("-o", folder / "trade.json", "--plot", folder / "trade.png")
    return ask(*TRADING, "--json", *outputs), folder


def test_trade_writes_what_it_prints_and_draws_it(traded: tuple[Answer, Path]) -> None:
    answer, folder = traded
    assert answer.code == YES
    assert answer.data == json.loads((folder / "trade.json").read_text())
    assert {"problem", "truth", "truth_error", "trials"} <= set(answer.data)
    assert any(trial["on_front"] for trial in answer.data["trials"])
    assert (folder / "trade.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(contents(folder)) == ["trade.json", "trade.png"]


@pytest.mark.parametrize("problem", ["bouncing_ball", "motor_pendulum", "motor_pendulum@corrected"])
@pytest.mark.slow
def test_trade_shows_the_cheapest_values_of_each_accuracy(problem: str) -> None:
    answer = ask("work-precision", problem, "--quick", "--until", "4.5")
    assert answer.code == YES
    for words in ("cheapest setting", "SciPy LSODA", "plastic below", "Reference: ", "Work: 4.5 s"):
        assert words in answer.out


def test_the_order_of_the_cut_is_that_of_the_events_that_are_compared(
    traded: tuple[Answer, Path],
) -> None:
    # A ball is never released: the cut moves the Zeno point itself, by 2 w / (g (1 - e)).
    assert traded[0].data["compared"] == "Zeno point"
    assert traded[0].data["cut_order"] == pytest.approx(1.0, abs=0.05)
    assert read_work_precision(traded[1] / "trade.json").expected_cut_order == 1


@pytest.mark.slow
def test_the_order_of_the_cut_is_three_for_releases() -> None:
    # The second cut of a quick study leaves an error of rounding, which has no order.
    answer = ask("work-precision", "motor_valve", "--until", "0.6")
    assert answer.code == YES
    assert "(theory: 3, of the releases)" in answer.out
    order = float(answer.out.partition("plastic cuts in their speed: ")[2].split()[0])
    assert order == pytest.approx(3.0, abs=0.2)


def test_trade_where_nothing_happens_so_soon_is_a_no_in_one_line(here: Path) -> None:
    answer = ask(
        "work-precision", "bouncing_ball", "--until", "0.1", "-o", "t.json", "--plot", "t.png"
    )
    assert answer.code == NO
    assert answer.out == ""
    assert answer.err.startswith("zeno-orbits: There is nothing to compare")
    assert answer.err.count("\n") == 1
    assert contents(here) == {}


@pytest.mark.parametrize(
    "where",
    ["precision.measure_work_precision", "report.plots.plot_trade", "report.plots.save_figure"],
)
def test_an_interrupted_trade_writes_nothing(
    where: str, traded: tuple[Answer, Path], here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = read_work_precision(traded[1] / "trade.json")
    monkeypatch.setattr("zeno_orbits.precision.measure_work_precision", lambda *_, **__: measured)
    monkeypatch.setattr(f"zeno_orbits.{where}", raising(KeyboardInterrupt()))
    answer = ask(*TRADING, "-o", "t.json", "--plot", "t.png")
    assert answer.code == INTERRUPTED
    assert answer.out == ""
    assert answer.err == "zeno-orbits: interrupted, nothing was written\n"
    assert contents(here) == {}


@pytest.mark.weekly
@pytest.mark.slow
@needs_compiler
def test_a_trade_shows_the_compiled_loop_beside_the_reference_with_the_same_error(
    tmp_path: Path,
) -> None:
    environment = os.environ | {"ZENO_ORBITS_CACHE": str(tmp_path)}
    command = [sys.executable, "-m", "zeno_orbits", *TRADING, "--json", "--verbose"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    trials = {(one["name"], one["value"]): one for one in json.loads(done.stdout)["trials"]}
    rows = [key for key in trials if key[0].endswith(", interpreted")]
    assert {name for name, _ in rows} == {
        f"{name}, interpreted" for name in ("automatic", "explicit", "implicit")
    }
    for name, value in rows:
        compiled = trials[name.removesuffix(", interpreted"), value]
        # Errors are those of the method: both are far above rounding, or both are rounding.
        assert abs(compiled["error"] - trials[name, value]["error"]) < 1e-13
    assert "executions run in compiled code" in done.stderr
