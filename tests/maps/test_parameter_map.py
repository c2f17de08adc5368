"""Maps: the grid, what is refused, the file, the command, and a kill in the middle."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import tempfile
import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest

from tests.reference.long_simulation import attractor_of
from tests.support.commands import ask, interrupted_when, raising
from tests.support.processes import Commands, workers_of
from zeno_orbits import StateLimit, work
from zeno_orbits.errors import CheckpointError, InputError, MapFileError, ProblemFileError
from zeno_orbits.maps import (
    Attractor,
    AttractorClass,
    Axis,
    ParameterMap,
    Plane,
    chunk_of,
    map_of_plane,
    read_boundaries,
    read_map,
    require_plane,
    write_map,
)
from zeno_orbits.model import bundled_problems, load_problem, locate_problem
from zeno_orbits.work import Cluster, ExecutionPlan, Workers

YES, NO, MISUSE = 0, 1, 2
CORES = int(joblib.cpu_count())
ONE = ExecutionPlan(place=Workers(count=1), chunk=4)
BALL = ("map", "bouncing_ball", "--x", "m=1:2", "--y", "restitution=0:0.5", "--grid", "3x2")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The finished points of the map of the ball: to start a worker takes a second."""
    kept = tmp_path_factory.mktemp("finished") / "kept"
    assert ask(*BALL, "--workers", "1", "--checkpoint", kept).code == NO
    return kept


needs_two = pytest.mark.skipif(CORES < 2, reason="needs two cores")


def plane(problem: str | Path = "bouncing_ball", **changes: Any) -> Plane:
    whole = Plane(
        source=locate_problem(problem),
        x=Axis(name="m", lower=1.0, upper=2.0, count=3),
        y=Axis(name="restitution", lower=0.0, upper=0.5, count=2),
        start=(1.0, 0.0),
    )
    return replace(whole, **changes)


def pendulum(**changes: Any) -> Plane:
    whole = Plane(
        source=locate_problem("motor_pendulum"),
        x=Axis(name="Kp", lower=2.0, upper=3.0, count=2),
        y=Axis(name="Kd", lower=-3.0, upper=-2.0, count=2),
        start=(0.6, 0.0, 0.0, 0.0, 0.0),
    )
    return replace(whole, **changes)


def computed_here(whole: Plane) -> ParameterMap:
    """Return a map that this process computes by itself."""
    return map_of_plane(replace(whole, source=whole.problem), ONE)


# ---------------------------------------------------------------------------- the grid


def test_the_grid_runs_row_by_row_from_below_and_holds_both_ends() -> None:
    assert plane().points() == (
        *((1.0, 0.0), (1.5, 0.0), (2.0, 0.0)),
        *((1.0, 0.5), (1.5, 0.5), (2.0, 0.5)),
    )


def test_every_point_of_a_map_is_the_long_run_at_its_numbers() -> None:
    problem = load_problem("motor_pendulum")
    found = computed_here(pendulum())
    for (kp, kd), attractor in zip(pendulum().points(), found.attractors, strict=True):
        alone = attractor_of(problem, problem.values(gains={"Kp": kp, "Kd": kd}), pendulum().start)
        # A representation holds every bit, and NaN equals itself.
        assert repr(attractor) == repr(alone)
    assert {one.fate for one in found.attractors} == {AttractorClass.ESCAPE}


def test_parameters_that_others_are_derived_from_are_derived_anew_at_every_point() -> None:
    problem = load_problem("motor_pendulum")
    crossed = pendulum(x=Axis(name="m2", lower=0.1, upper=0.12, count=2))
    values = crossed.values(0.12, -1.0)
    assert values == problem.values(gains={"Kd": -1.0}, parameters={"m2": 0.12})
    assert values.parameters["J_rotor"] != problem.values().parameters["J_rotor"]


def test_a_point_whose_derived_numbers_do_not_exist_fails_by_itself() -> None:
    # The calibration needs lc2 below 0.3558 m, roughly.
    crossed = pendulum(x=Axis(name="lc2", lower=0.15, upper=0.9, count=2))
    found = computed_here(crossed)
    fates = [
        [one.fate is AttractorClass.FAILED for one in found.attractors[k : k + 2]] for k in (0, 2)
    ]
    assert fates == [[False, True], [False, True]]
    assert "no rotor inertia" in found.attractors[1].detail


# ---------------------------------------------------------------------------- refused


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (
            {"x": Axis(name="m", lower=2.0, upper=1.0, count=3)},
            "`x` must have finite bounds LOWER < UPPER",
        ),
        (
            {"x": Axis(name="m", lower=1.0, upper=1.0, count=3)},
            "`x` must have finite bounds LOWER < UPPER",
        ),
        ({"y": Axis(name="m", lower=1.0, upper=2.0, count=3)}, "`y` must be another"),
        ({"x": Axis(name="mass", lower=1.0, upper=2.0, count=3)}, "`x`: unknown name `mass`"),
        ({"x": Axis(name="m", lower=0.0, upper=2.0, count=3)}, "`m` must be greater than 0"),
        ({"y": Axis(name="restitution", lower=0.0, upper=1.1, count=3)}, r"lie in \[0, 1\]"),
        (
            {"x": Axis(name="m", lower=1.0, upper=float("nan"), count=3)},
            "`x` must have finite bounds",
        ),
        ({"x": Axis(name="m", lower=1.0, upper=2.0, count=1)}, "`points` must be at least 2x2"),
        (
            {"x": Axis(name="m", lower=1.0, upper=2.0, count=10_000_000)},
            "`x`: 10000000 values and 2 of `y` make 20000000 points, more than 10000000. Ask",
        ),
        ({"parameters": {"m": 1.0}}, "`x` must name a free quantity, but `m` is"),
        ({"parameters": {"mass": 1.0}}, "unknown parameter `mass`"),
    ],
)
def test_a_plane_that_makes_no_sense_is_refused(changes: Mapping[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        require_plane(plane(**changes))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--x m=2:1 --y restitution=0:0.5", "--x m=2:1: must have finite bounds LOWER < UPPER"),
        ("--x mass=1:2 --y restitution=0:0.5", "Known: m, g, restitution"),
        ("--x m=1 --y restitution=0:0.5", "--x: must be NAME=LOW:HIGH"),
        ("--x m=1:2 --x g=1:2 --y restitution=0:0.5", "--x: must be given once"),
        ("--x m=1:2 --y restitution=0:0.5 --grid 3", "must be NxM"),
        ("--x m=1:2 --y restitution=0:0.5 --grid ②x②", "must be NxM"),
        ("--x m=1:2 --y restitution=0:0.5 --grid 0x3", "positive whole number"),
        (
            "--x m=1:2 --y restitution=0:0.5 --until -1",
            "--until -1: must be a finite, positive number",
        ),
        ("--x m=1:2 --y restitution=0:0.5 --plot map.gif", r"must end in .png"),
        ("--x m=1:2 --y restitution=0:0.5 -o missing/map.json", "must be in a writable folder"),
        (
            f"--x m=1:2 --y restitution=0:0.5 --workers {CORES + 1}",
            f"at most the {CORES} cores of this machine, but it is {CORES + 1}",
        ),
        (
            "--x m=1:2 --y restitution=0:0.5 --workers 1 --scheduler tcp://127.0.0.1:1",
            "--workers 1: must not be given with a scheduler",
        ),
    ],
)
def test_the_command_refuses_what_makes_no_sense(
    words: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    answer = ask("map", "bouncing_ball", *words.split())
    assert answer.code == MISUSE
    assert told in answer.err
    assert answer.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(work, "Cluster", partial(Cluster, patience=0.5))
    answer = ask(*BALL, "--scheduler", "tcp://127.0.0.1:1")
    assert answer.code == MISUSE
    assert "`tcp://127.0.0.1:1` does not answer" in answer.err


# ---------------------------------------------------------------------------- problems by path


@pytest.mark.slow
def test_a_problem_from_a_file_is_loaded_by_the_workers_themselves(tmp_path: Path) -> None:
    problem = tmp_path / "ball.py"
    shutil.copy(bundled_problems()["bouncing_ball"], problem)
    found = map_of_plane(plane(problem), ONE)
    assert {one.fate for one in found.attractors} == {AttractorClass.REST}
    assert found.attractors == map_of_plane(plane(), ONE).attractors


def test_a_problem_whose_file_has_changed_meanwhile_is_refused(tmp_path: Path) -> None:
    problem = tmp_path / "ball.py"
    shutil.copy(bundled_problems()["bouncing_ball"], problem)
    before = plane(problem)
    problem.write_text(problem.read_text() + "\n# another thought\n")
    with pytest.raises(InputError, match="must be the same file for all workers"):
        before.source.load()
    problem.unlink()
    with pytest.raises(InputError):
        before.source.load()


def test_a_problem_file_that_defines_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.py").write_text("")
    with pytest.raises(ProblemFileError):
        locate_problem(tmp_path / "empty.py")


def test_a_reduced_model_can_be_mapped() -> None:
    problem = locate_problem("motor_pendulum@quasi_static")
    assert problem.load().name == "motor_pendulum@quasi_static"
    assert problem.digest == locate_problem("motor_pendulum").digest
    assert set(problem.load().escapes) == {"theta1", "theta2"}


def test_a_problem_that_lets_an_unknown_state_escape_is_refused() -> None:
    problem = load_problem("bouncing_ball")
    with pytest.raises(InputError, match=r"`escapes`: unknown name `x`. Known: height, speed"):
        replace(problem, escapes={"x": StateLimit(beyond=1.0, phrase="x leaves")})


@pytest.mark.slow
def test_a_checkpoint_of_another_problem_of_the_same_name_is_refused(tmp_path: Path) -> None:
    problem, kept = tmp_path / "ball.py", tmp_path / "kept"
    shutil.copy(bundled_problems()["bouncing_ball"], problem)
    map_of_plane(plane(problem), replace(ONE, checkpoint=kept))
    before = {path.name: path.read_bytes() for path in kept.iterdir()}
    problem.write_text(problem.read_text().replace("9.81", "9.82"))
    with pytest.raises(CheckpointError, match="`problem_digest` is"):
        map_of_plane(plane(problem), replace(ONE, checkpoint=kept))
    other = plane(parameters={"g": 9.0})
    with pytest.raises(CheckpointError, match="its `"):
        map_of_plane(other, replace(ONE, checkpoint=kept))
    assert {path.name: path.read_bytes() for path in kept.iterdir()} == before


# ---------------------------------------------------------------------------- files


@pytest.fixture(name="found", scope="module")
def _found() -> ParameterMap:
    return computed_here(plane())


def test_a_map_file_holds_every_bit_of_the_map(found: ParameterMap, tmp_path: Path) -> None:
    odd = replace(
        found,
        attractors=(
            Attractor(
                fate=AttractorClass.ZENO, returns=1, period=0.1 + 0.2, multipliers=(0.1 + 1e-17j,)
            ),
            *found.attractors[1:],
        ),
    )
    write_map(odd, tmp_path / "map.json")
    back = read_map(tmp_path / "map.json")
    assert repr(asdict(back)) == repr(asdict(odd))
    assert json.loads((tmp_path / "map.json").read_text()) == odd.as_json()


@pytest.mark.slow
def test_a_map_file_is_read_in_time_linear_in_its_points(
    found: ParameterMap, tmp_path: Path
) -> None:
    point = Attractor(
        fate=AttractorClass.ZENO,
        returns=1,
        period=0.1,
        multipliers=(0.1 + 0.2j, 0.1 - 0.2j),
        margins={f"margin {k}": 0.1 * k for k in range(6)},
        state={f"state {k}": 0.1 * k for k in range(4)},
        sequence=("impact stop", "zeno stop", "release stop") * 4,
    )

    def seconds(side: int) -> float:
        x, y = (replace(axis, count=side) for axis in (found.x, found.y))
        whole = replace(found, x=x, y=y, attractors=(point,) * side**2)
        write_map(whole, tmp_path / "map.json")
        begin = time.process_time()
        assert len(read_map(tmp_path / "map.json").attractors) == side**2
        return time.process_time() - begin

    # Four times as many points: 4 times as long if linear, 16 times if quadratic.
    assert min(seconds(160) for _ in range(3)) < 9 * min(seconds(80) for _ in range(3))


def test_the_arrays_of_a_map_have_a_row_for_every_y(found: ParameterMap) -> None:
    assert found.shape == (2, 3)
    assert found.numbers("returns").shape == (2, 3)
    assert np.all(np.isnan(found.numbers("period")))
    assert np.all(np.isnan(found.margin("locked_time")))
    assert not found.has_zeno


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda text: text[:-40], "not complete JSON"),
        (lambda _: "[]", "not a JSON object"),
        (lambda text: text.replace('"format": 1', '"format": 2'), "format is 2"),
        (lambda text: text.replace('"fate": "rest"', '"fate": "bliss"', 1), "fate` must be one of"),
        (lambda text: text.replace('"count": 3', '"count": 4'), "not have one entry per point"),
        (lambda text: text.replace('"until"', '"before"'), "`until` is missing"),
    ],
)
def test_a_map_file_that_is_not_whole_is_refused(
    found: ParameterMap, tmp_path: Path, change: Any, told: str
) -> None:
    path = tmp_path / "map.json"
    write_map(found, path)
    path.write_text(change(path.read_text()))
    with pytest.raises(MapFileError, match=told):
        read_map(path)


# ---------------------------------------------------------------------------- the command


def test_the_command_answers_no_where_nothing_settles_to_a_zeno_orbit(finished: Path) -> None:
    answer = ask(*BALL, "--workers", "1", "--checkpoint", finished)
    assert (answer.code, answer.err) == (NO, "")
    assert "rest" in answer.out
    assert "100.0 %" in answer.out


@pytest.mark.slow
def test_the_command_answers_yes_with_file_and_picture_and_removes_its_checkpoint(
    tmp_path: Path,
) -> None:
    out, picture = tmp_path / "map.json", tmp_path / "map.png"
    words = "--x Kp=2.4:2.6 --y Kd=-1.05:-0.95 --grid 2x2 --set restitution=0 --workers 1"
    answer = ask("map", "motor_pendulum", *words.split(), "-o", out, "--plot", picture)
    assert (answer.code, answer.err) == (YES, "")
    assert "simple periodic orbit" in answer.out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map.json", "map.png"]
    found = read_map(out)
    assert found.has_zeno
    assert found.parameters == {"restitution": 0.0}
    assert np.all(np.isfinite(found.margin("locked_time")))


def test_json_is_the_content_of_the_file(tmp_path: Path, finished: Path) -> None:
    words = ("--json", "-o", tmp_path / "map.json", "--checkpoint", finished)
    answer = ask(*BALL, "--workers", "1", *words)
    assert answer.data == json.loads((tmp_path / "map.json").read_text())


@pytest.mark.slow
def test_a_named_checkpoint_stays_and_another_map_leaves_it_alone(tmp_path: Path) -> None:
    kept, out = tmp_path / "kept", tmp_path / "map.json"
    assert ask(*BALL, "--workers", "1", "--checkpoint", kept).code == NO
    before = {path.name: path.read_bytes() for path in kept.iterdir()}
    assert ask(*BALL, "--workers", "1", "--checkpoint", kept, "-o", out).code == NO
    answer = ask(*BALL, "--workers", "1", "--checkpoint", kept, "--until", "50", "-o", out)
    assert answer.code == MISUSE
    assert "`until` is" in answer.err
    assert {path.name: path.read_bytes() for path in kept.iterdir()} == before


@pytest.mark.slow
def test_a_checkpoint_of_the_loop_is_refused_by_the_reference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = tmp_path / "kept"
    assert ask(*BALL, "--workers", "1", "--checkpoint", kept).code == NO
    monkeypatch.setenv("ZENO_ORBITS_LOOP", "never")
    answer = ask(*BALL, "--workers", "1", "--checkpoint", kept)
    assert answer.code == MISUSE
    assert "`simulator` is" in answer.err


@pytest.mark.slow
def test_an_interrupt_says_what_is_kept_and_how_to_go_on(tmp_path: Path) -> None:
    out = tmp_path / "map.json"
    with interrupted_when(lambda _, part: part == 1.0):
        answer = ask(*BALL, "--workers", "1", "-o", out)
    assert answer.code == 130
    assert "map.json.checkpoint` keeps the finished work: the same command continues" in answer.err
    assert [path.name for path in tmp_path.iterdir()] == ["map.json.checkpoint"]


@pytest.mark.slow
def test_an_interrupt_without_an_output_keeps_what_is_done_in_a_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with interrupted_when(lambda _, part: part == 1.0):
        answer = ask(*BALL, "--workers", "1")
    told = re.search(r"the same command with --checkpoint (\S+) continues from there", answer.err)
    assert told is not None
    with interrupted_when(lambda _, part: 0.0 <= part < 1.0):
        again = ask(*BALL, "--workers", "1", "--checkpoint", told[1])
    assert again.out == ask(*BALL, "--workers", "1").out
    assert [path for path in tmp_path.iterdir() if path != Path(told[1])] == []


@pytest.mark.slow
def test_work_that_fails_leaves_no_temporary_folder_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert ask(*BALL, "--workers", str(CORES + 1)).code == MISUSE
    monkeypatch.setattr("zeno_orbits.report.terminal.print_map", raising(InputError("No.")))
    assert ask(*BALL, "--workers", "1").code == MISUSE
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_an_interrupt_with_nothing_finished_leaves_no_checkpoint_behind(tmp_path: Path) -> None:
    named = tmp_path / "named"
    with interrupted_when(lambda _, __: True):
        for words in ((), ("--checkpoint", named)):
            answer = ask(*BALL, "--workers", "1", "-o", tmp_path / "map.json", *words)
            assert answer.code == 130
            assert answer.err == "zeno-orbits: interrupted, nothing was written\n"
    assert [path.name for path in tmp_path.iterdir()] == ["named"]


LONG = ("map", "motor_pendulum", "--x", "Kp=2:3", "--y", "Kd=-3:-2", "--grid", "8x8")


@needs_two
@pytest.mark.slow
def test_a_map_by_two_workers_one_killed_and_then_all_is_that_of_one_worker(
    tmp_path: Path, commands: Commands
) -> None:
    quiet, killed = tmp_path / "quiet.json", tmp_path / "killed.json"
    assert commands.start(*LONG, "--workers", "1", "-o", quiet).wait(300) == NO
    kept = tmp_path / "killed.json.checkpoint"

    def chunks() -> int:
        return len(list(kept.glob("chunk-*.json")))

    def wait_for(count: int) -> None:
        end = time.monotonic() + 120
        while chunks() < count:
            assert time.monotonic() < end
            time.sleep(0.01)

    program = commands.start(*LONG, "--workers", "2", "-o", killed)
    wait_for(1)
    os.kill(workers_of(program.pid)[0], signal.SIGKILL)
    wait_for(2)
    program.kill()
    program.wait()
    assert not killed.exists()
    assert chunks() < 4
    assert commands.start(*LONG, "--workers", "2", "-o", killed).wait(300) == NO
    assert killed.read_bytes() == quiet.read_bytes()
    assert not kept.exists()


# ---------------------------------------------------------------------------- curves on top


def _curves(path: Path, parameters: list[str]) -> Path:
    curve = {"name": "fold", "parameters": parameters, "x": [1.0, 2.0], "y": [0.0, 0.5]}
    path.write_text(json.dumps({"boundaries": [curve]}))
    return path


def test_curves_of_a_family_file_are_read_whichever_way_round(tmp_path: Path) -> None:
    straight = read_boundaries(_curves(tmp_path / "a.json", ["m", "e"]), "m", "e")
    turned = read_boundaries(_curves(tmp_path / "b.json", ["e", "m"]), "m", "e")
    assert straight[0].points == ((1.0, 0.0), (2.0, 0.5))
    assert turned[0].points == ((0.0, 1.0), (0.5, 2.0))
    bare = tmp_path / "c.json"
    bare.write_text(json.dumps(json.loads((tmp_path / "a.json").read_text())["boundaries"]))
    assert read_boundaries(bare, "m", "e") == straight


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("no JSON", "it is not JSON"),
        ("{}", "curves are missing"),
        ('[{"name": "fold"}]', "curves are missing"),
        (
            '[{"name": "f", "parameters": ["a", "b"], "x": [], "y": []}]',
            "curves over m and e are missing",
        ),
    ],
)
def test_a_file_without_curves_of_the_plane_is_refused(
    tmp_path: Path, text: str, reason: str
) -> None:
    path = tmp_path / "curves.json"
    path.write_text(text)
    with pytest.raises(MapFileError, match=reason):
        read_boundaries(path, "m", "e")


def test_curves_are_drawn_on_top_and_need_a_picture(tmp_path: Path, finished: Path) -> None:
    curves = _curves(tmp_path / "curves.json", ["m", "restitution"])
    answer = ask(*BALL, "--boundaries", curves)
    assert answer.code == MISUSE
    assert "needs --plot" in answer.err
    picture = tmp_path / "map.png"
    words = ("--checkpoint", finished, "--boundaries", curves, "--plot", picture)
    assert ask(*BALL, "--workers", "1", *words).code == NO
    assert picture.stat().st_size > 0


# ---------------------------------------------------------------------------- without a file


TABLE = {"x": Axis(name="A", lower=0.0149, upper=0.0151, count=2), "start": (0.0, 0.0, 1.0, 0.0)}


def table(**changes: Any) -> Plane:
    y = Axis(name="omega", lower=29.9, upper=30.1, count=2)
    return Plane(**{"source": locate_problem("vibrating_table"), "y": y, **TABLE, **changes})


@pytest.mark.slow
def test_a_problem_object_is_mapped_by_this_process_as_its_file_is_by_workers() -> None:
    here = map_of_plane(table(source=replace(load_problem("vibrating_table"))), ONE)
    assert here.as_json() == map_of_plane(table(), ONE).as_json()
    assert {one.fate for one in here.attractors} == {AttractorClass.ZENO}


def test_a_problem_object_is_refused_where_other_processes_or_a_checkpoint_need_its_file(
    tmp_path: Path,
) -> None:
    alone = table(source=load_problem("vibrating_table"))
    for plan in (ExecutionPlan(place=Workers(count=2)), replace(ONE, checkpoint=tmp_path / "kept")):
        with pytest.raises(InputError, match="`problem` must be a name or a file"):
            map_of_plane(alone, plan)
    assert list(tmp_path.iterdir()) == []


def test_motions_are_waited_for_in_turns_of_the_slowest_clock_or_oscillation() -> None:
    # 300 turns of the slower corner, to one digit.
    assert require_plane(table()).time == 60.0
    slow = table(y=Axis(name="omega", lower=0.1, upper=1.0, count=2))
    assert require_plane(slow).time == 20_000.0
    assert require_plane(table(until=7.0)).time == 7.0
    # 115 swings of 2 pi sqrt(1 / 9.81) s, and of a time scale a thousand times as long.
    assert require_plane(plane()).time == 200.0
    heavy = plane(x=Axis(name="g", lower=9.81e-6, upper=9.9e-6, count=2))
    assert require_plane(heavy).time == 200_000.0
    assert require_plane(pendulum()).time == 200.0


@pytest.mark.slow
def test_the_command_finds_the_orbits_of_a_table_that_search_finds() -> None:
    words = "--x A=0.0149:0.0151 --y omega=29.9:30.1 --grid 3x3 --workers 1 --json"
    answer = ask("map", "vibrating_table", *words.split())
    assert answer.code == YES
    assert [point["fate"] for point in answer.data["points"]] == 9 * ["zeno"]


def test_the_chunk_depends_on_the_plane_alone_and_is_neither_small_nor_large() -> None:
    square = table(
        x=Axis(name="A", lower=0.0149, upper=0.0151, count=50),
        y=Axis(name="omega", lower=29.9, upper=30.1, count=50),
    )
    counts = (2, 6, 20, 50, 100, 1000)
    planes = [
        replace(square, x=replace(square.x, count=n), y=replace(square.y, count=n)) for n in counts
    ]
    assert [chunk_of(plane) for plane in planes] == [16, 16, 100, 250, 250, 250]


def test_the_problem_that_new_writes_has_its_orbit_on_a_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert ask("new", "mine").code == YES
    mine = table(
        source=load_problem("mine.py"),
        x=Axis(name="F", lower=0.95, upper=1.05, count=2),
        y=Axis(name="omega", lower=0.98, upper=1.02, count=2),
    )
    start = mine.problem.state_vector(mine.problem.starts[0])
    found = map_of_plane(replace(mine, start=start), ONE)
    assert {one.fate for one in found.attractors} == {AttractorClass.ZENO}
